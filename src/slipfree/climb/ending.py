"""Ending of a climb: climbed, stalled, slid back or tipped over."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from slipfree.climb.metrics import has_reached_top, touches_obstacle
from slipfree.records import Array
from slipfree.terrain.solids import Profile
from slipfree.trajectory import Trajectory
from slipfree.vehicle.climber import Climber

Ending = Literal["climbs", "stalls", "slides back", "tips over", "unfinished"]
STALL_TIME, STALL_PROGRESS = 1.0, 5e-3  # less progress in this final interval is a stall [s, m]
SLIDE_BACK = 0.03  # a vehicle this far behind its farthest position has slid back [m]


class ClimbEnding(NamedTuple):
    """Ending of a climb; ``str`` returns its name.

    Attributes
    ----------
    name : {"climbs", "stalls", "slides back", "tips over", "unfinished"}
        ``"unfinished"`` if the vehicle still advances when the motion ends, or has not reached an
        obstacle.
    t : float
        Time at which the rear axle reaches the top, the vehicle stalls, or the motion ends. [s]
    words : str
        Explanation of the ending, with time and position.
    """

    name: Ending
    t: float
    words: str

    def __str__(self) -> str:
        """Return the name."""
        return self.name


def climb_ending(run: Trajectory, climber: Climber, profile: Profile) -> ClimbEnding:
    """Return the ending of a climb.

    The vehicle tips over if a tilt exceeds its limit, even on the top. It climbs if the rear axle
    reaches the top as in `slipfree.climb.metrics.climb_window`. Otherwise the progress decides, the
    mean over the axles of position plus height: the vehicle stalls if it advances by less than
    5 mm in the last second, and has slid back if it ends at least 30 mm behind its farthest
    position.

    Parameters
    ----------
    run : Trajectory
        A motion of `slipfree.climb.dynamics.climbing`.
    climber : Climber
        Vehicle of the motion.
    profile : Profile
        Ground of the motion.
    """
    end = float(run.t[-1])
    if run.stop is not None and run.stop.name.endswith("_overturned"):
        return ClimbEnding("tips over", end, f"at t = {end:.3g} s {run.stop.words}")
    met = touches_obstacle(run, profile)
    if not met.any():
        return ClimbEnding(
            "unfinished", end, _unfinished_words(run, "the front wheel touches only the floor")
        )
    up = has_reached_top(run, climber, profile) & (np.cumsum(met) > 0)
    if up.any():
        t = float(run.t[up.argmax()])
        return ClimbEnding(
            "climbs", t, f"at t = {t:.3g} s the rear axle is on top of the obstacle, or behind it"
        )
    progress = (run["center_y"] + run["center_z"]).mean(axis=1)
    return _ending_below_top(run, progress, end)


def _ending_below_top(run: Trajectory, progress: Array, end: float) -> ClimbEnding:
    """Return the ending of a vehicle that did not reach the top."""
    k = int(np.argmax(progress > progress.max() - STALL_PROGRESS))
    t, x = float(run.t[k]), float(run["center_y", "front"][k])
    back = float(progress.max() - progress[-1])
    if t > end - STALL_TIME:
        return ClimbEnding(
            "unfinished", end, _unfinished_words(run, "the vehicle was still advancing")
        )
    words = f"after t = {t:.3g} s the vehicle does not advance (front axle at x = {x:.3g} m)"
    if back > SLIDE_BACK:
        return ClimbEnding(
            "slides back", t, f"{words}; it ends {1e3 * back:.0f} mm behind its farthest position"
        )
    return ClimbEnding("stalls", t, words)


def _unfinished_words(run: Trajectory, words: str) -> str:
    return f"until t = {run.t[-1]:.3g} s {words}" + (f"; {run.stop.words}" if run.stop else "")
