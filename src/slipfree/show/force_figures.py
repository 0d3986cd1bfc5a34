"""Figures of the forces between a vehicle with mass and the ground, and of its drives.

Each drawing function draws on the given axes, labels the artists for a legend, and returns the
axes; the caller adds the legend. Functions that end in ``_plot`` compose figures.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize

from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.models.samples import has_friction
from slipfree.show import style
from slipfree.show.plots import Panel, Plot, PlottedDrive, stack

OVER = "#67001F"  # colour of utilisation above one
CEILING = 3.0  # largest drawn utilisation
HEADROOM = 1.1  # height of the axes over the largest utilisation
LEAST_SLIP = 1.0  # smallest end of the colours of slip [mm/s]


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
        ax.plot([], [], " ", label=f"not drawn above {CEILING:g}{words}")
    k, worst = _worst(run)
    height = min(float(values[k, worst]), ax.get_ylim()[1])
    mark: dict[str, Any] = {"color": style.look(worst)["color"], "mec": "black", "ms": 5}
    ax.plot(
        run.t[k], height, "o", label=_worst_words(run), ls="none", clip_on=False, zorder=5, **mark
    )
    return ax


def tracks(run: Trajectory, ax: Axes) -> Axes:
    """Draw the tracks of contact points in plan view, coloured by utilisation, or by slip.

    The largest utilisation is marked.
    """
    if "utilisation" in run:
        values, top, label = run["utilisation"], 1.0, f"{_quantity(run)} [1]"
    else:
        values = 1e3 * np.hypot(run["slip_along"], run["slip_across"])
        top, label = max(float(values.max()), LEAST_SLIP), "slip [mm/s]"
    x, y = run["contact_x"], run["contact_y"]
    ax.plot(x, y, lw=3, color="white", solid_capstyle="round", zorder=2)
    points = np.stack([x, y], axis=-1)
    pieces = np.stack([points[:-1], points[1:]], axis=2).reshape(-1, 2, 2)
    largest = _finite(np.maximum(values[:-1], values[1:])).ravel()
    order = np.argsort(largest, kind="stable")
    look: dict[str, Any] = {"linewidths": 2, "capstyle": "round", "zorder": 3}
    colors: dict[str, Any] = {
        "cmap": style.RISK.with_extremes(over=OVER),
        "norm": Normalize(0, top),
    }
    lines = LineCollection(list(pieces[order]), array=largest[order], **colors, **look)
    ax.add_collection(lines, autolim=False)
    style.side_bar(lines, ax, label, "max")
    if "utilisation" in run:
        k, wheel = _worst(run)
        mark: dict[str, Any] = {"ls": "none", "mfc": "none", "mec": "black", "zorder": 4}
        ax.plot(x[k, wheel], y[k, wheel], "D", ms=8, label=_worst_words(run), **mark)
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
    return f"largest, {style.words(run.wheels[wheel])}: {number} at {run.t[k]:.4g} s"
