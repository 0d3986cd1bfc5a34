"""How a climb ends: up, stuck, back down, or overturned."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from slipfree.climb.metrics import come_up, meeting
from slipfree.climb.profile import Profile
from slipfree.climb.vehicle import Climber
from slipfree.records import Array
from slipfree.trajectory import Trajectory

Ending = Literal["climbs", "stalls", "slides back", "tips over", "unfinished"]
LAST, ON = 1.0, 5e-3  # it is stuck if it gets on no farther than so in the last time [s, m]
BACK = 0.03  # from the farthest place, what slides back [m]


class ClimbEnding(NamedTuple):
    """How a climb ends; as text its name.

    Attributes
    ----------
    name : {"climbs", "stalls", "slides back", "tips over", "unfinished"}
        Unfinished is what still gets on when the motion ends, or has met nothing to climb.
    t : float
        When the rear axle comes up, when it gets stuck, or when the motion ends. [s]
    words : str
        What happened.
    """

    name: Ending
    t: float
    words: str

    def __str__(self) -> str:
        """Return the name."""
        return self.name


def climb_ending(run: Trajectory, climber: Climber, profile: Profile) -> ClimbEnding:
    """Return how a climb ends.

    It tips over if a body passes its limit, even after it came up; it climbs if the rear axle comes
    up as in `slipfree.climb.metrics.climb_window`. Else its way, the mean over the axles of place
    and height, tells: it is stuck if it gets on less than 5 mm in the last second, and has slid
    back if it ends 30 mm or more behind where it was farthest.

    Parameters
    ----------
    run : Trajectory
        A motion of `slipfree.climb.dynamics.climbing`.
    climber : Climber
        Its vehicle.
    profile : Profile
        Its ground.
    """
    end = float(run.t[-1])
    if run.stop is not None and run.stop.name.endswith("_overturned"):
        return ClimbEnding("tips over", end, f"at t = {end:.3g} s {run.stop.words}")
    met = meeting(run, profile)
    if not met.any():
        return ClimbEnding(
            "unfinished", end, _ending(run, "the front wheel has met only the floor")
        )
    up = come_up(run, climber, profile) & (np.cumsum(met) > 0)
    if up.any():
        t = float(run.t[up.argmax()])
        return ClimbEnding("climbs", t, f"at t = {t:.3g} s the rear axle is up, or past")
    way = (run["axle_x"] + run["axle_z"]).mean(axis=1)
    return _not_up(run, way, end)


def _not_up(run: Trajectory, way: Array, end: float) -> ClimbEnding:
    """Return how what did not come up ends."""
    k = int(np.argmax(way > way.max() - ON))
    t, x, back = float(run.t[k]), float(run["axle_x", "front"][k]), float(way.max() - way[-1])
    if t > end - LAST:
        return ClimbEnding("unfinished", end, _ending(run, "the vehicle was still getting on"))
    words = f"from t = {t:.3g} s on it gets no farther, the front axle at x = {x:.3g} m"
    if back > BACK:
        return ClimbEnding("slides back", t, f"{words}: it ends {1e3 * back:.0f} mm behind")
    return ClimbEnding("stalls", t, words)


def _ending(run: Trajectory, words: str) -> str:
    return f"until t = {run.t[-1]:.3g} s {words}" + (f"; {run.stop.words}" if run.stop else "")
