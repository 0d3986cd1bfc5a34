"""Ending of a motion with inertia over solids, by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from slipfree.core.records import Mask
from slipfree.core.trajectory import Trajectory
from slipfree.models.limits import UPRIGHT
from slipfree.terrain.solids import HEIGHT_TOLERANCE, Prism
from slipfree.vehicle.tree import Vehicle

Ending = Literal["climbs", "passes", "moves along", "stalls", "tips over", "unfinished"]
TOP_SHARE = 0.8  # height of a wheel's centre above the top of a solid that it has climbed [radii]
STALL_TIME = 1.0  # final interval in which a stalled vehicle does not advance [s]
STALL_DISTANCE = 5e-3  # largest displacement of a stalled vehicle in this interval [m]
STALL_SHARE = 0.05  # or, if larger, this share of the distance that the rims travel [1]


class ObstacleEnding(NamedTuple):
    """Ending of a motion over solids.

    Attributes
    ----------
    name : {"climbs", "passes", "moves along", "stalls", "tips over", "unfinished"}
        ``"unfinished"`` if the vehicle is before the obstacles or on them, and still advances.
    t : float
        Time at which the last wheel reaches the top or passes its front, or the motion ends. [s]
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

    Obstacles are the solids on which the vehicle does not stand at the start. The vehicle

    - *tips over* if the motion ends at the limit of a body's inclination,
    - *climbs* if, after the first contact with an obstacle, each wheel reaches the highest top of
      the obstacles that a wheel touches; later it may leave it,
    - *passes* if each wheel crosses the vertical plane of this top's front edge, some beside the
      obstacle, or of the highest obstacle's if none is touched,
    - *stalls* if the platform is displaced by less than 5 mm in the last second, or by less than
      5 % of the distance that the rims travel,
    - *moves along* an obstacle that it touches in the last second if only the displacement parallel
      to the obstacle's front is not as small.

    Parameters
    ----------
    run : Trajectory
        A motion of `slipfree.dynamics` on `slipfree.Solids`.
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
    loads = (run[f"solid_load_{k}"] > 0 for k in range(1, len(prisms) + 1))
    obstacles = [  # all wheels stand on a floor at the start
        (prism, np.asarray(load.any(axis=1)))
        for prism, load in zip(prisms, loads, strict=True)
        if not load[0].all()
    ]
    touched = [(prism, met) for prism, met in obstacles if met.any()]
    highest = max((prism for prism, _ in touched or obstacles), key=_top, default=None)
    if highest is None:
        return ObstacleEnding("unfinished", end, f"there is no obstacle{_stop_words(run)}")
    met = np.cumsum(np.any([met for _, met in obstacles], axis=0)) > 0
    up = is_on_top(run, vehicle, _top(highest)) & met[:, None]
    if up.any(axis=0).all():
        t = _last_time(run, up)
        words = f"by t = {t:.3g} s every wheel had reached the top, z = {_top(highest):.3g} m"
        return ObstacleEnding("climbs", t, words)
    count = f"{up.any(axis=0).sum()} of {len(vehicle.wheels)} wheels had reached the top"
    count = f"{count}, z = {_top(highest):.3g} m" if touched else "no wheel touched an obstacle"
    past = _is_past_front(run, highest)
    if past.any(axis=0).all() and not past[0].all():
        t = _last_time(run, past)
        words = f"by t = {t:.3g} s every wheel had crossed the line of the front edge; {count}"
        return ObstacleEnding("passes", t, words)
    if not touched:
        return ObstacleEnding("unfinished", end, f"{count}{_stop_words(run)}")
    is_final = run.t > end - STALL_TIME
    name = _final_motion(run, vehicle, [each for each, met in touched if met[is_final].any()])
    return ObstacleEnding(name, end, f"by t = {end:.3g} s {count}{_stop_words(run)}")


def _top(prism: Prism) -> float:
    """Return the height of the top of a prism [m]."""
    return prism.z + max(z for _, z in prism.section.points)


def is_on_top(run: Trajectory, vehicle: Vehicle, top: float) -> Mask:
    """Return whether each wheel is as high as on a level top.

    Its centre may be 0.2 radii lower, but not lower than half-way from its height at the start.

    Parameters
    ----------
    run : Trajectory
        A motion with the heights of the wheels' centres.
    vehicle : Vehicle
        Vehicle of the motion.
    top : float
        Height of the top. [m]

    Returns
    -------
    ndarray of bool, shape (n, n_wheels)
        Whether a wheel is on top, at each sample.
    """
    radii = np.array([wheel.radius for wheel in vehicle.wheels])
    rise = top + radii - run["center_z"][0]
    below = np.minimum((1 - TOP_SHARE) * radii, np.where(rise > 0, rise / 2, np.inf))
    return np.asarray(run["center_z"] > top + radii - below)


def _is_past_front(run: Trajectory, prism: Prism) -> Mask:
    """Return whether each wheel's centre is past the front edge of a top, shape (n, n_wheels)."""
    top = _top(prism) - prism.z - HEIGHT_TOLERANCE
    front = min(x for x, z in prism.section.points if z > top)
    forward, _, _ = prism.axes.T
    x, y = run["center_x"] - prism.x, run["center_y"] - prism.y
    return np.asarray(forward[0] * x + forward[1] * y > front)


def _last_time(run: Trajectory, reached: Mask) -> float:
    """Return the time at which the last wheel first reaches something, from (n, n_wheels) [s]."""
    return float(run.t[reached.argmax(axis=0).max()])


def _final_motion(run: Trajectory, vehicle: Vehicle, touched: Sequence[Prism]) -> Ending:
    """Return the ending by the motion in the last second, in which obstacles are touched."""
    since = run.t[-1] - STALL_TIME
    if since < run.t[0]:
        return "unfinished"
    away = np.array([run[axis][-1] - np.interp(since, run.t, run[axis]) for axis in "xyz"])
    rims = np.abs(run["wheel_rate"]) @ [w.radius for w in vehicle.wheels] / len(vehicle.wheels)
    times = np.append(since, run.t[run.t > since])
    travel = np.trapezoid(np.interp(times, run.t, rims), times)
    small = max(STALL_DISTANCE, STALL_SHARE * travel)
    if np.linalg.norm(away) < small:
        return "stalls"
    advances = [np.linalg.norm((away @ prism.axes)[[0, 2]]) for prism in touched]
    return "moves along" if min(advances, default=np.inf) < small else "unfinished"


def _stop_words(run: Trajectory) -> str:
    return f"; {run.stop.words}" if run.stop is not None else ""
