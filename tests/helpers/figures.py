"""Checks of figures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from matplotlib.figure import Figure
from matplotlib.text import Text

from slipfree.core.trajectory import Trajectory


def assert_inside(figure: Figure, texts: Iterable[Text]) -> None:
    """Assert that texts of a drawn figure do not reach over its edge."""
    width, height = figure.bbox.size
    for text in texts:
        if text.get_text():
            box = text.get_window_extent()
            assert min(box.x0, box.y0) >= -1, text
            assert box.x1 <= width + 1, text
            assert box.y1 <= height + 1, text


def moved(run: Trajectory, **by: float) -> Trajectory:
    """Return a motion at another place."""
    columns = {
        name: column._replace(
            values=column.values
            + by.get(name.removeprefix("contact_").removeprefix("center_"), 0.0)
        )
        for name, column in run.columns.items()
    }
    return replace(run, columns=columns)
