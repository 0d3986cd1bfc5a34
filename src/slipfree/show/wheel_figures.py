"""Figure of a single-wheel test: forces, torque and sinkage over the slip ratio."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slipfree.core.records import Array
from slipfree.show import style
from slipfree.show.plots import MARGIN, PANEL, Plot
from slipfree.show.style import COLUMN, MM

PANELS = (
    ("pull", "drawbar pull [N]", 1.0),
    ("side", "side force [N]", 1.0),
    ("torque", "torque [N m]", 1.0),
    ("sinkage", "sinkage [mm]", 1e3),
)  # quantity, axis label, factor from SI units
SAME_LOAD = 0.01  # relative difference from the load of the curves [1]
SAME_ANGLE = np.deg2rad(0.5)  # measured points within this angle of a curve have its colour [rad]


class DrawnWheel(NamedTuple):
    """Data for the figure of a single-wheel test.

    Attributes
    ----------
    angle : ndarray, shape (n_angles,)
        Slip angles. [rad]
    slip : ndarray, shape (n_slips,)
        Slip ratios. [1]
    load : float
        Vertical load of the curves. [N]
    values : mapping of str and ndarray, shape (n_angles, n_slips)
        Computed quantities by name.
    measured : mapping of str and tuple of 4 ndarrays, shape (n,)
        Slip ratios [1], slip angles [rad], loads [N] and values of measured points, by quantity.
        Those at the load of the curves are circles, others are crosses.
    """

    angle: Array
    slip: Array
    load: float
    values: Mapping[str, Array]
    measured: Mapping[str, tuple[Array, Array, Array, Array]]


def wheel_plot(name: str, test: DrawnWheel) -> Plot:
    """Return the undrawn figure of a single-wheel test, with the name of its file."""
    words = "Drawbar pull, side force, torque and sinkage over the slip ratio."
    return Plot(name, words, partial(wheel_figure, test))


def wheel_figure(test: DrawnWheel) -> Figure:
    """Return the figure of a single-wheel test: a panel per quantity, a line per slip angle."""
    made = style.figure(COLUMN, (len(PANELS) * PANEL + MARGIN) * MM)
    axes = made.subplots(len(PANELS), 1, sharex=True)
    for (name, words, factor), ax in zip(PANELS, axes, strict=True):
        _draw(test, name, factor, ax)
        ax.set_ylabel(words)
    axes[-1].set_xlabel("slip ratio [1]")
    handles, labels = axes[0].get_legend_handles_labels()
    made.legend(handles, labels, loc="outside upper center", ncols=4)
    return style.stacked(made, list(axes))


def _draw(test: DrawnWheel, name: str, factor: float, ax: Axes) -> None:
    """Draw the curves of a quantity, and its measured points."""
    for k, angle in enumerate(test.angle):
        label = f"{np.rad2deg(angle):.3g} deg"
        ax.plot(test.slip, factor * test.values[name][k], label=label, **style.look(k))
        if name in test.measured:
            slip, angles, loads, values = test.measured[name]
            near = np.abs(angles - angle) < SAME_ANGLE
            same = np.abs(loads / test.load - 1) < SAME_LOAD
            for marker, rows in (("o", near & same), ("x", near & ~same)):
                look = {"ms": 2.5, "mfc": "none", "mew": 0.6, "color": style.look(k)["color"]}
                ax.plot(slip[rows], factor * values[rows], marker, ls="", **look)
