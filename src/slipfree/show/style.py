"""Common style of all figures: sizes, colours, legends, axes and notes."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_params_from_file
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.ticker import MaxNLocator, ScalarFormatter

from slipfree.core.facts import SCALES, printed_unit
from slipfree.core.quantities import QUANTITIES, QuantityRow
from slipfree.core.trajectory import Trajectory, stop_words

MM = 1 / 25.4  # [in]
COLUMN, PAGE = 120 * MM, 180 * MM  # widths of the figures [in]
SHEET = Path(__file__).with_name("slipfree.mplstyle")
STYLE = rc_params_from_file(SHEET, use_default_template=False)
DPI = 200
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe and Ito
# from good to bad: no colour is pale, since tracks have a white edge; also the colour-blind can
# tell its halves apart, since the green is bluish and the red is darker
RISK = LinearSegmentedColormap.from_list("risk", ["#009e73", "#f7cf30", "#b30018"])
# of heights in all pictures, below a hillshade; pale, so that tracks and risks stand out
HEIGHTS = LinearSegmentedColormap.from_list("heights", ["#a08560", "#cfbd9a", "#f7f0e2"])
STEEP = 40.0  # end of the colour scale of slopes [deg]
DASHES = ("-", "--", ":", "-.")  # for lines beyond the palette
PLATFORM = "black"
STOPPED = "#D55E00"
LARGE = 1e4  # larger map coordinates are drawn relative to a round number [m]
TINY = 1e-16  # smallest drawn residual, in its unit
KINDS = {
    **{"rad": "angle", "rad s-1": "rate", "m s-1": "rate", "m": "length"},
    **{"N m": "torque", "N": "force", "J": "energy since the start", "W": "power"},
}  # of several quantities in one panel, by their unit
FLAT = 1e-3  # smallest drawn range of heights and angles [m, rad]


def figure(width: float, height: float) -> Figure:
    """Return an empty figure of a size in inches, with automatic layout."""
    # layouts and drawing share the renderer of a canvas, which stores the sizes of texts
    return FigureCanvasAgg(Figure(figsize=(width, height), layout="constrained")).figure


def lay_out(figure: Figure) -> None:
    """Place the axes and legends of a figure with automatic layout, for good, without drawing it.

    Otherwise drawing would begin with a layout of its own.
    """
    if figure.axes and (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)


def cropped(figure: Figure, ax: Axes) -> Figure:
    """Lay out the figure of a map, and remove the height that its equal scales leave free.

    The layout is found once, with axes that fill their room: of smaller ones matplotlib
    underestimates the margins. Axes, legend and note keep their distances from the edges.
    """
    ax.set_aspect("auto", share=True)
    lay_out(figure)
    ax.set_aspect("equal", share=True)
    room, (width, height) = ax.get_position(original=True), figure.get_size_inches()
    new = min(height - room.height * height + room.width * width * ax.get_data_ratio(), height)
    figure.set_figheight(new)
    for each in figure.axes:
        x, y, across, up = each.get_position(original=True).bounds
        each.set_position((x, y * height / new, across, 1 - (1 - up) * height / new))
    return figure


def finished(
    figure: Figure, run: Trajectory | None, legends: Sequence[Axes], note: str = ""
) -> Figure:
    """Add a legend at the top of a figure, and a note with the reason of a stop below."""
    entries: dict[str, Any] = {}
    for ax in legends:
        handles, labels = ax.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    width = float(figure.get_figwidth())
    if entries:
        columns = max(1, int(width * 18) // (max(map(len, entries)) + 8))
        rows = -(-len(entries) // columns)
        look: dict[str, Any] = {"loc": "outside upper center", "ncols": -(-len(entries) // rows)}
        figure.legend(entries.values(), entries, **look)
    if run is not None and run.stop is not None:
        reason = stop_words(run)
        note = f"{reason[0].upper()}{reason[1:]}\n{note}".strip()
    if note:
        lines = [textwrap.fill(line, int(width * 19)) for line in note.splitlines()]
        figure.supxlabel("\n".join(lines), x=0.02, ha="left", fontsize=7, parse_math=False)
    return figure


def look(k: int) -> dict[str, Any]:
    """Return arguments of ``plot`` for the k-th line: colour and dashes."""
    dashes = DASHES[k // len(PALETTE) % len(DASHES)]
    return {"color": PALETTE[k % len(PALETTE)], "ls": dashes}


def side_bar(drawn: Any, ax: Axes, label: str, extend: str = "neither") -> Any:
    """Add a colour bar to the right of axes whose scale is fixed, and return it."""
    figure: Any = ax.figure
    place = ax.inset_axes((1.03, 0.0, 0.04, 1.0))
    return figure.colorbar(drawn, cax=place, extend=extend, label=label)


def halo(width: float) -> list[AbstractPathEffect]:
    """Return the path effect of a white edge, for lines on any background; width in points."""
    return [withStroke(linewidth=width, foreground="white")]


def row(name: str) -> QuantityRow:
    """Return the row of a quantity in the table of quantities; an empty one for others."""
    return QUANTITIES.get(name) or QuantityRow(name, "", "")


def words(name: str) -> str:
    """Return the printed name of a quantity or a wheel."""
    return row(name).title or name.replace("_", " ")


def position_axis(axis: Any, name: str, low: float) -> None:
    """Label an axis of x, y or z; large coordinates are drawn relative to a round number."""
    start = 1000 * np.floor(low / 1000) if abs(low) >= LARGE else 0.0
    words = {"x": "east $x$", "y": "north $y$", "z": "height $z$"}[name]
    axis.set_label_text(f"{words} - {start:.0f} [m]" if start else f"{words} [m]")
    axis.set_major_locator(ticks(5))
    axis.set_major_formatter(ScalarFormatter(useOffset=start or False))
    axis.offsetText.set_visible(False)


def ticks(count: int) -> MaxNLocator:
    """Return a locator of about ``count`` round ticks."""
    return MaxNLocator(count, steps=[1, 2, 2.5, 5, 10])


def history(
    run: Trajectory, names: str | Sequence[str], ax: Axes, *, has_zero: bool = False
) -> Axes:
    """Draw quantities over time: one of wheels with a line per wheel, or others; and zero."""
    names, k = [names] if isinstance(names, str) else list(names), 0
    for name in names:
        values = SCALES.get(row(name).shown, 1.0) * run[name]
        if run.columns[name].label.unit == "J":
            values = values - values[0]
        values = np.maximum(values, TINY) if row(name).is_residual else values
        lines = dict(zip(run.wheels, values.T, strict=True)) if values.ndim == 2 else {name: values}
        for line, own in lines.items():
            alone = {"color": PLATFORM} if values.ndim == 1 and len(names) == 1 else {}
            ax.plot(run.t, own, label=words(line), **look(k) | alone)
            k += 1
    units = dict.fromkeys(run.columns[name].label.unit for name in names)
    what = words(names[0]) if len(names) == 1 else KINDS.get(next(iter(units)), "value")
    shown = row(names[0]).shown or ", ".join(map(printed_unit, units))
    ax.set_ylabel(f"{textwrap.fill(what, 14)} [{shown}]")
    if row(names[0]).is_residual:
        ax.set_yscale("log")
        if "tolerance" in run.statistics:
            ax.axhline(run.statistics["tolerance"], color="0.4", lw=0.8, ls="--", label="tolerance")
    elif has_zero:
        ax.axhline(0, color="0.4", lw=0.6, zorder=1)  # below the other lines
    if [*units] == ["rad"]:
        degrees(ax)
    return time_axis(run, ax)


def time_axis(run: Trajectory, ax: Axes) -> Axes:
    """Label the time axis, and mark the time of a stop."""
    ax.set_xlabel("time $t$ [s]")
    ax.margins(x=0.02)
    if run.stop is not None:
        ax.axvline(run.stop.t, color=STOPPED, ls=":", lw=1)
    return ax


def degrees(ax: Axes) -> Axes:
    """Add an axis in degrees on the right; the range of angles becomes at least 0.001 rad."""
    low, high = ax.get_ylim()
    room = max(FLAT - (high - low), 0.0) / 2
    ax.set_ylim(low - room, high + room)
    turned: tuple[Callable[[Any], Any], Callable[[Any], Any]] = (np.rad2deg, np.deg2rad)
    ax.secondary_yaxis("right", functions=turned).set_ylabel("[deg]")
    return ax
