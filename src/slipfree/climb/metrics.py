"""How well a vehicle climbed: slip and disturbance of the paper, true slip, shares of the load.

Averages of sizes over a window around the climb; that of Chugo et al. (2009) is not given. The
samples of a motion are taken to be evenly spaced.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slipfree.climb.profile import Profile
from slipfree.climb.vehicle import Climber
from slipfree.errors import ModelError
from slipfree.records import Array, Mask
from slipfree.trajectory import Trajectory

BEFORE, AFTER = 0.05, 0.1  # of the window, before the first contact and after the climb [s]
PAST, BELOW = 0.02, 0.003  # a rear axle that is up: past the edge, and sunk at most so far [m]
SLOWEST = 0.4  # rate of a wheel below which ratios to it say nothing [rad/s]
LOADED = 1.0  # normal force of a contact that counts [N]


class Window(NamedTuple):
    """The part of a motion that counts as the climb.

    Attributes
    ----------
    span : slice
        Of the samples.
    climbed : bool
        Whether the rear axle comes up; if not, the window ends with the motion.
    t : float
        When it comes up, or the end. [s]
    """

    span: slice
    climbed: bool
    t: float


class Metrics(NamedTuple):
    """Averages over the window; arrays are of shape (3,), rear, middle and front axle.

    Attributes
    ----------
    window : Window
        What they are averages of.
    slip : ndarray
        Size of (20), which relates every wheel to the speed of the middle axle and is not zero for
        wheels that roll.
    disturbance : ndarray
        Size of (21), error of the wheel's rate.
    true_slip : ndarray
        Way that the rim slips on the solid that bears more, over the way that the rim goes.
    effort : ndarray
        Share of the axle in the sizes of the motors' torques, all wheels counted.
    bearing : ndarray
        Share of the axle in the normal forces.
    limited : float
        Part of the time in which a motor's limit scales the torques.
    """

    window: Window
    slip: Array
    disturbance: Array
    true_slip: Array
    effort: Array
    bearing: Array
    limited: float


def metrics(run: Trajectory, climber: Climber, profile: Profile) -> Metrics:
    """Return the averages over a climb.

    Parameters
    ----------
    run : Trajectory
        A motion of `slipfree.climb.dynamics.climbing`.
    climber : Climber
        Its vehicle.
    profile : Profile
        Its ground.

    Raises
    ------
    ModelError
        If the front wheel touches nothing but the floor.
    """
    window = climb_window(run, climber, profile)
    solids, span = range(len(profile.solids)), window.span
    rim = climber.radius * run["wheel_rate"][span]
    loads = np.array([run[f"load_{k}"][span] for k in solids])
    slips = np.array([run[f"slip_{k}"][span] for k in solids])
    bearing = loads.max(axis=0) > LOADED
    slip = np.take_along_axis(np.abs(slips), loads.argmax(axis=0)[None], axis=0)[0]
    motors = np.abs(run["torque"][span]) * [axle.wheels for axle in climber.axles]
    return Metrics(
        window,
        _average(slip_ratio(run, climber)[span]),
        _average(disturbance_ratio(run)[span]),
        np.where(bearing, slip, 0).sum(axis=0) / np.abs(rim).sum(axis=0),
        motors.sum(axis=0) / motors.sum(),
        loads.sum(axis=(0, 1)) / loads.sum(),
        float(np.mean(run["torque_scale"][span] < 1)),
    )


def climb_window(run: Trajectory, climber: Climber, profile: Profile) -> Window:
    """Return the window of a climb.

    It begins 50 ms before the front wheel first touches more than the floor and ends 100 ms after
    the rear axle has come up: 20 mm past the edge of the highest level, at its height, 3 mm less at
    most; or past all that stands on the floor.

    Raises
    ------
    ModelError
        If the front wheel touches nothing but the floor.
    """
    touching = meeting(run, profile)
    if not touching.any():
        raise ModelError(
            "metrics: the front wheel touches nothing but the floor until "
            f"t = {run.t[-1]:g} s; simulate longer or start nearer"
        )
    up = come_up(run, climber, profile)
    climbed = bool(up.any())
    end = float(run.t[up.argmax()]) if climbed else float(run.t[-1])
    begin = float(run.t[touching.argmax()])
    ends = np.searchsorted(run.t, [begin - BEFORE - 1e-9, end + AFTER - 1e-9])
    return Window(slice(int(ends[0]), int(ends[1])), climbed, end)


def meeting(run: Trajectory, profile: Profile) -> Mask:
    """Return when the front wheel touches more than the floor, shape (n,)."""
    touching = np.zeros(run.t.size, dtype=bool)
    for k in range(1, len(profile.solids)):
        touching |= run[f"gap_{k}", "front"] < 0
    return touching


def come_up(run: Trajectory, climber: Climber, profile: Profile) -> Mask:
    """Return when the rear axle is up, as `climb_window` has it, shape (n,)."""
    edge, top = profile.summit
    x, z = run["axle_x", "rear"], run["axle_z", "rear"]
    up: Mask = (x > edge + PAST) & (z > top + climber.radius - BELOW)
    return up | (x > profile.end + PAST)


def slip_ratio(run: Trajectory, climber: Climber) -> Array:
    """Return ``(r w - v) / (r w)`` over time, (20), shape (n, 3); nan for wheels near rest.

    ``v`` is the speed of the middle axle, for all wheels.
    """
    speed = np.hypot(run["axle_velocity_x", "middle"], run["axle_velocity_z", "middle"])
    rate = _turning(run)
    return np.asarray(1 - speed[:, None] / (climber.radius * rate))


def disturbance_ratio(run: Trajectory) -> Array:
    """Return ``(w_ref - w) / w`` over time, (21), shape (n, 3); nan for wheels near rest."""
    return np.asarray((run["reference"] - run["wheel_rate"]) / _turning(run))


def _turning(run: Trajectory) -> Array:
    rate = run["wheel_rate"]
    return np.where(np.abs(rate) < SLOWEST, np.nan, rate)


def _average(ratios: Array) -> Array:
    """Return the means of sizes, one at most each, of what is not nan; nan if nothing is."""
    sizes = np.minimum(np.abs(ratios), 1)
    known: Mask = ~np.isnan(sizes)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(known, sizes, 0).sum(axis=0) / known.sum(axis=0))
