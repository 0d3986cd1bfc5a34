"""Figure of a Pareto front: slip over the second objective."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slipfree.core.records import Array, Mask
from slipfree.show import style
from slipfree.show.plots import MARGIN, PANEL
from slipfree.show.style import COLUMN, MM, PALETTE, STOPPED

WIDE = 30.0  # smallest ratio of values drawn on a logarithmic axis
TANGENT = 0.06  # length of a tangent on each side [second objective]
FAILED_HEIGHT = 0.03  # height of the marks of unsolved points [axes]


class DrawnFront(NamedTuple):
    """Data for the figure of a Pareto front of n points.

    Attributes
    ----------
    name, unit : str
        Name and unit of the second objective.
    bounds, second : ndarray, shape (n,)
        Bound and value of the second objective, in its unit; the value is NaN for unsolved points.
    objective, slopes : ndarray, shape (n,)
        Minimised objective, and its derivative with respect to the bound. [m2/s, m2/s per unit of
        the bound]
    slip : ndarray, shape (n,)
        Slip per wheel and metre of path. [m/m]
    is_dominated : ndarray of bool, shape (n,)
        Whether another point of the front dominates the point.
    given : tuple of 3 floats
        Second objective, first objective [m2/s] and slip [m/m] of the plan with the costs of the
        problem.
    """

    name: str
    unit: str
    bounds: Array
    second: Array
    objective: Array
    slopes: Array
    slip: Array
    is_dominated: Mask
    given: tuple[float, float, float]


def front_figure(front: DrawnFront) -> Figure:
    """Return the figure of a front: minimised objective with tangents, and slip per metre."""
    made = style.figure(COLUMN, (2 * PANEL + MARGIN) * MM)
    upper, lower = made.subplots(2, 1, sharex=True)
    _draw_points(front, 1e6 * front.objective, 1e6 * front.given[1], upper)
    _draw_tangents(front, upper)
    upper.set_ylabel("squared slip and\nsmoothness [mm$^2$/s]")
    _draw_points(front, 1e3 * front.slip, 1e3 * front.given[2], lower)
    lower.set_ylabel("slip [mm per\nwheel and metre]")
    lower.set_xlabel(f"{style.words(front.name)} [{style.unit(front.unit)}]")
    handles, labels = upper.get_legend_handles_labels()
    made.legend(handles, labels, loc="outside upper center", ncols=3)
    return style.stacked(made, [upper, lower])


def _draw_points(front: DrawnFront, values: Array, given: float, ax: Axes) -> None:
    """Draw the values of solved points, and marks at the bounds of unsolved points."""
    solved = np.isfinite(values)
    kept = solved & ~front.is_dominated
    shown = np.append(values[solved], given)
    if shown.min() > 0 and shown.max() > WIDE * shown.min():
        ax.set_yscale("log")
    ax.plot(front.second[kept], values[kept], "o-", ms=4, color=PALETTE[0], label="front")
    worse = solved & front.is_dominated
    if worse.any():
        ax.plot(
            front.second[worse],
            values[worse],
            "o",
            ms=4,
            mfc="none",
            color=PALETTE[0],
            label="dominated",
        )
    if not solved.all():
        heights = np.full((~solved).sum(), FAILED_HEIGHT)
        ax.plot(
            front.bounds[~solved],
            heights,
            "x",
            color=STOPPED,
            label="not solved",
            transform=ax.get_xaxis_transform(),
        )
    ax.plot(
        front.given[0], given, "*", ms=8, color=PALETTE[1], label="costs of the problem", zorder=3
    )


def _draw_tangents(front: DrawnFront, ax: Axes) -> None:
    """Draw a short tangent at each solved point, by the derivative with respect to the bound."""
    label = "slope (price)"
    for k in np.flatnonzero(np.isfinite(front.objective) & (front.slopes < 0)):
        away = TANGENT * front.second[k] * np.array([-1.0, 1.0])
        values = 1e6 * (front.objective[k] + front.slopes[k] * away)
        if values.min() > 0:
            ax.plot(front.second[k] + away, values, lw=2.5, alpha=0.5, color="0.4", label=label)
            label = ""
