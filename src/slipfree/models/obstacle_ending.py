"""Ending of a motion with inertia over solids: climbed, stalled or tipped over."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from slipfree.models.limits import UPRIGHT
from slipfree.records import Array, Mask
from slipfree.terrain.solids import Prism
from slipfree.trajectory import Trajectory
from slipfree.vehicle.tree import Vehicle

Ending = Literal["climbs", "stalls", "tips over", "unfinished"]
TOP_SHARE = 0.8  # height of a wheel's centre above the top of a solid that it has climbed [radii]
STALL_TIME = 1.0  # final interval in which a stalled vehicle does not advance [s]
STALL_DISTANCE = 5e-3  # largest displacement of a stalled vehicle in this interval [m]
STALL_SHARE = 0.05  # or, if larger, this share of the distance that the rims travel [1]


class ObstacleEnding(NamedTuple):
    """Ending of a motion over solids.

    Attributes
    ----------
    name : {"climbs", "stalls", "tips over", "unfinished"}
        ``"unfinished"`` if the vehicle still moves when the motion ends, or touched no obstacle.
    t : float
        Time at which the last wheel reaches the top, or the motion ends. [s]
    words : str
        Explanation of the ending.
    """

    name: Ending
    t: float
    words: str

    def __str__(self) -> str:
        """Return the name and the reason."""
        return f"{self.name}: {self.words}"


def obstacle_ending(
    run: Trajectory, vehicle: Vehicle, prisms: Sequence[Prism]
) -> ObstacleEnding | None:
    """Return the ending of a motion over solids; None without solids.

    The vehicle tips over if the motion ends at the limit of a body's inclination. It climbs if,
    after the first contact with an obstacle, each wheel reaches the highest top of the obstacles
    that a wheel touches; later it may leave it. Obstacles are the solids on which the vehicle does
    not stand at the start. It stalls if the platform is displaced by less than 5 mm
    in the last second, or by less than 5 % of the distance that the rims travel.

    Parameters
    ----------
    run : Trajectory
        A motion of `slipfree.dynamics` on `slipfree.Solids`, or of a climb.
    vehicle : Vehicle
        Vehicle of the motion.
    prisms : sequence of Prism
        Solids of the ground.

    Examples
    --------
    A four-wheeler drives over a block of 40 mm.

    >>> import numpy as np
    >>> from slipfree import Analytic, Solids, catalog, dynamics, settle, simulate
    >>> from slipfree.terrain.solids import kerb, placed
    >>> vehicle, prisms = catalog.rigid_skid_steer(), placed(kerb(0.04, 0.3), y=0.5)
    >>> model = dynamics(vehicle, Solids(Analytic(lambda x, y: 0 * x, mu=0.8), prisms))
    >>> inputs = {label.full: 3.0 for label in model.labels.u.wheels}
    >>> run = simulate(model, settle(model), model.inputs(**inputs), np.linspace(0, 3, 61))
    >>> print(obstacle_ending(run, vehicle, prisms).name)
    climbs
    """
    if not prisms:
        return None
    end = float(run.t[-1])
    if run.stop is not None and run.stop.name.endswith(UPRIGHT):
        return ObstacleEnding("tips over", end, f"at t = {end:.3g} s {run.stop.words}")
    loads = [run[f"solid_load_{k}"] > 0 for k in range(1, len(prisms) + 1)]
    touched = [load.any(axis=1) & ~load[0].all() for load in loads]  # all wheels stand on a floor
    tops = [prism.z + max(z for _, z in prism.section.points) for prism in prisms]
    if not np.any(touched):
        return ObstacleEnding("unfinished", end, f"no wheel touched an obstacle{_stop_words(run)}")
    top = max(top for top, met in zip(tops, touched, strict=True) if met.any())
    up = _reached(run, vehicle, top) & (np.cumsum(np.any(touched, axis=0)) > 0)[:, None]
    if up.any(axis=0).all():
        t = float(run.t[up.argmax(axis=0).max()])
        words = f"by t = {t:.3g} s every wheel had reached the top, z = {top:.3g} m"
        return ObstacleEnding("climbs", t, words)
    count = f"{up.any(axis=0).sum()} of {len(vehicle.wheels)} wheels had reached the top"
    words = f"by t = {end:.3g} s {count}, z = {top:.3g} m{_stop_words(run)}"
    return ObstacleEnding("stalls" if _has_stalled(run, vehicle) else "unfinished", end, words)


def _reached(run: Trajectory, vehicle: Vehicle, top: float) -> Mask:
    """Return whether each wheel is as high as on a level top, shape (n, n_wheels)."""
    return np.asarray(run["center_z"] > top + TOP_SHARE * _radii(vehicle))


def _has_stalled(run: Trajectory, vehicle: Vehicle) -> bool:
    """Return whether the platform rests, or advances much less than the rims, at the end."""
    since = run.t[-1] - STALL_TIME
    if since < run.t[0]:
        return False
    away = [run[axis][-1] - np.interp(since, run.t, run[axis]) for axis in "xyz"]
    rims = np.abs(run["wheel_rate"]) @ _radii(vehicle) / len(vehicle.wheels)
    times = np.append(since, run.t[run.t > since])
    travel = np.trapezoid(np.interp(times, run.t, rims), times)
    return bool(np.linalg.norm(away) < max(STALL_DISTANCE, STALL_SHARE * travel))


def _radii(vehicle: Vehicle) -> Array:
    return np.array([wheel.radius for wheel in vehicle.wheels])


def _stop_words(run: Trajectory) -> str:
    return f"; {run.stop.words}" if run.stop is not None else ""
