"""Side view of a motion over solids in the plane x = 0, at regular intervals of time."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from slipfree.core.trajectory import Trajectory
from slipfree.show import style
from slipfree.show.plots import Drive, Plot
from slipfree.show.style import MM, PAGE
from slipfree.terrain.solids import Profile, section_of

POSES = 8  # number of drawn positions of the vehicle
ROOM = 0.04  # margin around the motion [m]
LATEST = 0.85  # used part of the colour scale: its yellow end is too light for lines


def side_plot(drive: Drive) -> Plot | None:
    """Return the side view of a motion; None without solids, or if it leaves the plane x = 0."""
    run = drive.run
    if not drive.prisms or run["x"].any() or any(prism.heading for prism in drive.prisms):
        return None
    section = section_of(drive.prisms, float(drive.grid.z.max()))
    return Plot("side", "Vehicle and solids from the side.", lambda: _side(run, section))


def _side(run: Trajectory, section: Profile) -> Figure:
    y, z = run["center_y"], run["center_z"]
    figure = style.figure(PAGE, PAGE * (np.ptp(z) + 0.2) / (np.ptp(y) + 0.2) + 20 * MM)
    side_view(run, section, figure.subplots())
    return figure


def side_view(run: Trajectory, section: Profile, ax: Axes, count: int = POSES) -> Axes:
    """Draw the solids, the paths of the wheels, and the vehicle at equal intervals of time.

    Parameters
    ----------
    run : Trajectory
        A motion of a planar vehicle.
    section : Profile
        Ground and solids, see `slipfree.terrain.solids.section_of`.
    ax : Axes
        The axes; their aspect becomes equal.
    count : int
        Number of drawn positions of the vehicle.
    """
    for solid in section.solids:
        ax.add_patch(Polygon(solid.points, fc="0.85", ec="0.85", lw=0.3, zorder=0))
    y, z, count = run["center_y"], run["center_z"], max(count, 2)
    away = np.hypot(run["contact_y"] - y, run["contact_z"] - z)
    order = np.argsort(y[0])
    ax.plot(y, z, color="0.5", lw=0.6, zorder=2)
    for number, k in enumerate(np.linspace(0, run.t.size - 1, count).astype(int)):
        color = colormaps["viridis"](LATEST * number / (count - 1))
        ax.plot(y[k, order], z[k, order], "o-", color=color, lw=1.3, ms=2.6, mfc="white", zorder=3)
        for place in zip(y[k], z[k], np.nanmedian(away, axis=0), strict=True):
            ax.add_patch(Circle(place[:2], place[2], fc="none", ec=color, lw=0.9, zorder=3))
    radius = float(np.nanmedian(away))
    ax.set_aspect("equal")
    ax.set(xlabel="forward $y$ [m]", ylabel="height $z$ [m]")
    ax.set_xlim(y.min() - radius - ROOM, y.max() + radius + ROOM)
    ax.set_ylim(z.min() - radius - ROOM, z.max() + radius + ROOM)
    return ax
