"""Rocking of vehicles with pressed wheels: changes of the wheel with the least load."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slipfree.core.trajectory import Trajectory


class Rock(NamedTuple):
    """A change of the wheel that carries the least load.

    Attributes
    ----------
    t : float
        Time, interpolated between samples. [s]
    before, after : str
        Name of the wheel with the least load before the change, and after it.
    """

    t: float
    before: str
    after: str


def has_pressed_wheels(run: Trajectory) -> bool:
    """Return whether a motion was computed with pressed wheels."""
    return "depth" in run.columns


def rocks(run: Trajectory) -> list[Rock]:
    """Return the changes of the wheel with the least load in a motion with pressed wheels.

    At each change the vehicle rocks from one set of supporting wheels to another, which may take
    only a few hundredths of a second.

    Parameters
    ----------
    run : Trajectory
        A motion with pressed wheels; see `has_pressed_wheels`.
    """
    loads, found = run["load_share"], list[Rock]()
    lightest = loads.argmin(axis=1)
    for k in np.flatnonzero(np.diff(lightest)).tolist():
        before, after = lightest[k : k + 2]
        more, less = loads[k : k + 2, before] - loads[k : k + 2, after]
        t = (
            run.t[k] + more / (more - less) * (run.t[k + 1] - run.t[k])
            if more != less
            else run.t[k]
        )
        found.append(Rock(float(t), run.wheels[before], run.wheels[after]))
    return found


def lightest_wheel(run: Trajectory, sample: int) -> tuple[str, float, float]:
    """Return the name, load share and depth of the wheel with the least load at a sample.

    The load share is the load times the number of wheels, divided by the weight [1]. The depth is
    negative in the air [m].
    """
    loads = run["load_share"][sample]
    k = int(loads.argmin())
    return run.wheels[k], float(loads[k]), float(run["depth"][sample, k])
