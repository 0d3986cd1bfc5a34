"""Figures as records of a name, a caption and a drawing function, drawn only on request.

Most figures are stacks of panels over a common axis; a panel is a function that draws on given axes
and labels the artists for the legend.
"""

from __future__ import annotations

import gc
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backend_bases import FigureCanvasBase
from matplotlib.figure import Figure

from slipfree.core.errors import check_known
from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.show import style
from slipfree.show.style import COLUMN, DPI, MM, PAGE, STYLE
from slipfree.system.regular_files import make_folder, replace_file
from slipfree.terrain.base import Grid, Terrain
from slipfree.terrain.solids import Prism

COMPRESSION = {"compress_level": 3}  # files larger by 5 % in 0.6 of the time
MAIN_COUNT = 4  # number of figures that are drawn unless all are requested
PANEL = 38.0  # height of a panel [mm]
WRAP = 20  # characters of a line of labels and legends beside axes
MARGIN = 24.0  # height of legend, axis and note of a figure [mm]


class Panel(NamedTuple):
    """One of the axes in a figure."""

    draw: Callable[[Axes], Any]
    height: float = PANEL  # height of the axes [mm]
    has_legend: bool = True  # whether its artists appear in the legend of the figure


class Plot(NamedTuple):
    """A figure that has not been drawn yet."""

    name: str  # also of its file, without ending
    caption: str
    make: Callable[[], Figure]  # draws and returns the figure


class PlottedDrive(NamedTuple):
    """Data for the figures of a motion over terrain."""

    run: Trajectory
    grid: Grid
    surface: Terrain  # surface of the ground as used by the model
    prisms: tuple[Prism, ...] = ()
    # keyword arguments of `slipfree.show.ground_drawing.plan_marks`: regions and places of a plan
    marks: Mapping[str, Any] = {}


def stack(run: Trajectory | None, panels: Sequence[Panel], note: str = "") -> Figure:
    """Return a figure of panels over one axis, with one legend and a note.

    Of a motion, the note states the reason of an early stop.
    """
    heights = [panel.height for panel in panels]
    figure = style.figure(COLUMN if run is None else PAGE, (sum(heights) + MARGIN) * MM)
    axes = list(
        figure.subplots(len(panels), 1, sharex=True, height_ratios=heights, squeeze=False).ravel()
    )
    for panel, ax in zip(panels, axes, strict=True):
        panel.draw(ax)
        if ax is not axes[-1]:
            ax.set_xlabel("")
    figure.align_ylabels(axes)
    legends = [ax for panel, ax in zip(panels, axes, strict=True) if panel.has_legend]
    return style.finished(figure, run, legends, note)


def beside(draw: Callable[[Axes], Any]) -> Callable[[Axes], None]:
    """Return a drawing function that adds a legend of its own colours beside the panel."""

    def drawn(ax: Axes) -> None:
        """Draw a panel with wrapped words and a legend beside it."""
        draw(ax)
        ax.set_ylabel(textwrap.fill(ax.get_ylabel(), WRAP))
        entries = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
        lines = {textwrap.fill(words, WRAP): handle for words, handle in entries.items()}
        if lines:
            right = 1.11 if ax.child_axes else 1.01  # of the axis in degrees
            ax.legend(lines.values(), lines, loc="center left", bbox_to_anchor=(right, 0.5))

    return drawn


def draw(plots: Iterable[Plot]) -> dict[str, Figure]:
    """Draw figures and return them by name."""
    with rc_context(STYLE):
        return {plot.name: plot.make() for plot in plots}


def save(
    plots: Iterable[Plot], folder: str | Path, formats: Sequence[str] = ("png",)
) -> list[Path]:
    """Draw figures, write them to a folder in formats such as ``"png"``, and return their paths."""
    known = FigureCanvasBase.get_supported_filetypes()
    check_known("formats", formats, sorted(known), "some of")
    make_folder(Path(folder))
    files = list[Path]()
    # Figures are reference cycles that hold images of several megabytes; without a search for
    # cycles, the figures of one or two motions stay in memory until Python happens to collect
    # them. What exists already is left out of the search, which would take 0.1 s.
    gc.freeze()
    try:
        for plot in plots:
            with rc_context({"figure.dpi": DPI, **STYLE}):
                figure = plot.make()
                style.lay_out(figure)
                for end in formats:
                    more: dict[str, Any] = {"pil_kwargs": COMPRESSION} if end == "png" else {}
                    files.append(Path(folder) / f"{plot.name}.{end}")
                    replace_file(files[-1], partial(figure.savefig, dpi=DPI, **more))
            del figure
    finally:
        gc.collect()
        gc.unfreeze()
    return files


class Varied(NamedTuple):
    """Key that a sweep varies, with its values."""

    name: str  # dotted name
    values: tuple[str, ...]  # as TOML text, or words without quotes
    unit: str = ""  # of the values, as in ``m s-1``; empty if unknown

    @property
    def numbers(self) -> tuple[float, ...] | None:
        """The values as numbers; None if one of them is not a number."""
        try:
            return tuple(map(float, self.values))
        except ValueError:
            return None

    @property
    def words(self) -> tuple[str, ...]:
        """The values with as many digits as tell them apart, at least four."""
        numbers = self.numbers or ()  # such as northings with seven digits before the point
        n = next(n for n in range(4, 18) if len({f"{x:.{n}g}" for x in numbers}) == len({*numbers}))
        return tuple(f"{x:.{n}g}" for x in numbers) or self.values


class Swept(NamedTuple):
    """A metric over the varied keys."""

    name: str
    unit: str  # as in ``m s-1``; empty if unknown
    axes: tuple[Varied, ...]
    values: Array  # one dimension per axis, and one for repetitions; NaN without a value
