"""Checks of figures."""

from __future__ import annotations

from collections.abc import Iterable

from matplotlib.figure import Figure
from matplotlib.text import Text


def assert_inside(figure: Figure, texts: Iterable[Text]) -> None:
    """Assert that texts of a drawn figure do not reach over its edge."""
    width, height = figure.bbox.size
    for text in texts:
        if text.get_text():
            box = text.get_window_extent()
            assert min(box.x0, box.y0) >= -1, text
            assert box.x1 <= width + 1, text
            assert box.y1 <= height + 1, text
