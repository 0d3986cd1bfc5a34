"""Figures of the forces between a vehicle with mass and the ground, and of its drives.

Each drawing function draws on the given axes, labels the artists for a legend, and returns the
axes; the caller adds the legend. Functions that end in ``_plot`` compose figures.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.models.samples import has_friction
from slipfree.show import ground_drawing, style
from slipfree.show.plots import Panel, Plot, PlottedDrive, stack
from slipfree.show.style import COLUMN, MM
from slipfree.terrain.base import Grid

COLOURS = "viridis"
OVER = "#D55E00"  # colour of utilisation above one
CEILING = 3.0  # largest drawn utilisation
HEADROOM = 1.25  # height of the axes for the text at the largest utilisation [utilisation]
CROWDED = 0.8  # text at a utilisation between this and 1 would cover the line at 1
EDGES = 0.3  # text at a smaller distance from an edge points away from it [axes]
CASING = "0.15"  # colour of the edge of coloured tracks


def utilisation(run: Trajectory, ax: Axes) -> Axes:
    """Draw the utilisation of friction of every wheel over time, and its largest value."""
    values = run["utilisation"]
    for k, wheel in enumerate(run.wheels):
        ax.plot(run.t, _finite(values[:, k]), label=style.words(wheel), **style.look(k))
    if "utilisation_best" in run:
        best = _finite(run["utilisation_best"])
        ax.plot(run.t, best, color="black", ls=":", lw=0.8, label="optimal distribution of forces")
    words = "friction limit" if has_friction(run) else "a friction coefficient of 1"
    ax.axhline(1, color="0.4", lw=0.8, ls="--", label=words)
    largest = float(values.max())
    ax.set_ylim(0, CEILING if largest > CEILING else HEADROOM * max(1.0, largest))
    ax.set_ylabel(f"{_quantity(run)} [1]")
    style.time_axis(run, ax)
    if largest > CEILING:
        words = "" if np.isfinite(largest) else "; infinite where a wheel bears no load"
        box = {"fc": "white", "ec": "none", "pad": 2}
        place: dict[str, Any] = {
            "transform": ax.transAxes,
            "ha": "right",
            "va": "bottom",
            "bbox": box,
        }
        ax.text(1.0, 1.03, f"not drawn above {CEILING:g}{words}", **place)
    _mark_worst(run, ax)
    return ax


def utilisation_map(run: Trajectory, grid: Grid, ax: Axes) -> Axes:
    """Draw the tracks of contact points in plan view, coloured by utilisation, on grey ground."""
    ground_drawing.muted(grid, ax, ground_drawing.around(run, grid, pad=0.15))
    x, y, values = run["contact_x"], run["contact_y"], run["utilisation"]
    ax.plot(x, y, lw=3, color=CASING, solid_capstyle="round")
    points = np.stack([x, y], axis=-1)
    pieces = np.stack([points[:-1], points[1:]], axis=2).reshape(-1, 2, 2)
    largest = _finite(np.maximum(values[:-1], values[1:])).ravel()
    order = np.argsort(largest, kind="stable")
    scale = colormaps[COLOURS].with_extremes(over=OVER)
    lines = LineCollection(
        list(pieces[order]),
        array=largest[order],
        cmap=scale,
        norm=Normalize(0, 1),
        linewidths=2,
        capstyle="round",
        zorder=3,
    )
    ax.add_collection(lines, autolim=False)
    style.side_bar(lines, ax, f"{_quantity(run)} [1]", "max")
    marks: dict[str, Any] = {"ls": "none", "mec": "black", "zorder": 4}
    ax.plot(x[0], y[0], "o", mfc="white", ms=4, label=f"start, {run.t[0]:.4g} s", **marks)
    k, wheel = _worst(run)
    at = x[k, wheel], y[k, wheel]
    ax.plot(*at, "D", mfc="none", ms=8, label=f"largest, {_worst_words(run)}", **marks)
    if values[k, wheel] > 1:
        words = "above the friction limit" if has_friction(run) else "above 1"
        ax.plot([], [], color=OVER, lw=2, label=words)
    return ax


def utilisation_plot(scene: PlottedDrive) -> Plot | None:
    """Return the figure of the friction that the wheels need; None for a vehicle without mass."""
    run = scene.run
    if "utilisation" not in run:
        return None
    panels = [Panel(partial(utilisation, run), 60)]
    if "tip_over_margin" in run:
        margin = partial(style.history, run, "tip_over_margin", has_zero=True)
        panels.append(Panel(margin, 26, has_legend=False))
    caption = "Friction that every wheel needs over time, and the margin to tipping over."
    return Plot("utilisation", caption, lambda: stack(run, panels))


def utilisation_map_plot(scene: PlottedDrive) -> Plot | None:
    """Return the map of the friction that the wheels need; None for a vehicle without mass."""
    if "utilisation" not in scene.run:
        return None
    caption = "Friction needed along the tracks."
    return Plot("utilisation_map", caption, lambda: _utilisation_map(scene))


def _utilisation_map(scene: PlottedDrive) -> Figure:
    run, grid = scene.run, scene.grid
    west, east, south, north = ground_drawing.around(run, grid, pad=0.15)
    panel = min(85 * MM * (north - south) / (east - west), 110 * MM)
    figure = style.figure(COLUMN, panel + 27 * MM)
    ax = utilisation_map(run, grid, figure.subplots())
    style.finished(figure, run, [ground_drawing.solids(scene.prisms, ax)])
    figure.draw_without_rendering()  # the first layout sees the colour bar of wider axes
    return figure


def _finite(values: Array) -> Array:
    """Return values limited to a large number, so that lines with infinite values are drawn."""
    return np.minimum(values, 1e3 * CEILING)


def _quantity(run: Trajectory) -> str:
    return "utilisation" if has_friction(run) else "friction needed $|f_t|/N$"


def _worst(run: Trajectory) -> tuple[int, int]:
    values = run["utilisation"]
    k, wheel = np.unravel_index(np.argmax(values), values.shape)
    return int(k), int(wheel)


def _worst_words(run: Trajectory) -> str:
    k, wheel = _worst(run)
    value = run["utilisation"][k, wheel]
    number = f"{value:.3g}" if np.isfinite(value) else "infinite"
    return f"{style.words(run.wheels[wheel])}: {number} at {run.t[k]:.4g} s"


def _mark_worst(run: Trajectory, ax: Axes) -> None:
    """Mark the largest utilisation; at the upper edge of the axes if its value is above."""
    k, wheel = _worst(run)
    value, top = run["utilisation"][k, wheel], ax.get_ylim()[1]
    above = value > top
    at = (run.t[k], min(value, top))
    ax.plot(
        *at,
        "^" if above else "o",
        color=style.look(wheel)["color"],
        mec="black",
        ms=5,
        clip_on=False,
        zorder=5,
    )
    part = (run.t[k] - run.t[0]) / max(float(np.ptp(run.t)), 1e-300)
    side = "left" if part < EDGES else "right" if part > 1 - EDGES else "center"
    away = {"left": 7, "center": 0, "right": -7}[side] if above else 0
    clear = 1.0 if CROWDED < value < 1 else at[1]
    ax.annotate(
        _worst_words(run),
        (at[0], clear),
        (away, -4 if above else 6),
        textcoords="offset points",
        ha=side,
        va="top" if above else "bottom",
        fontsize=7,
        zorder=6,
        bbox={"fc": "white", "ec": "none", "alpha": 0.8, "pad": 1},
    )
