"""Averages over a climb: slip and disturbance as in Chugo et al. (2009), true slip, load shares.

They are averages of absolute values over a time window around the climb; that paper does not define
its window. The samples of a motion must be equally spaced.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Mask
from slipfree.core.trajectory import Trajectory
from slipfree.terrain.solids import Profile
from slipfree.vehicle.tree import Vehicle

LEAD_TIME, TRAIL_TIME = 0.05, 0.1  # parts of the window before first contact and after climb [s]
EDGE_MARGIN, MAX_SINKAGE = 0.02, 0.003  # distance behind the edge, depth below the top level [m]
MIN_WHEEL_RATE = 0.4  # ratios with smaller wheel rates are ignored [rad/s]
MIN_LOAD = 1.0  # contacts with a smaller normal force are ignored [N]


class ClimbWindow(NamedTuple):
    """Samples of a climb, whether the rear axle reaches the top, and when it does.

    Otherwise the window ends with the motion, and ``t`` is its end [s].
    """

    span: slice
    climbed: bool
    t: float


class Metrics(NamedTuple):
    """Averages over the time window of a climb, for rear, middle and front axle, shape (3,).

    ``slip`` and ``disturbance`` are mean absolute values of `slip_ratio` and `disturbance_ratio`,
    at most one each; NaN if the wheels are near rest all the time. ``true_slip`` is the slip
    distance of the rim at the most loaded contact, divided by the distance the rim travels;
    ``effort`` and ``bearing`` are the axle's shares in the absolute torques and in the normal
    forces; ``limited`` is the fraction of the time in which the limit scales the torques. [1]
    """

    window: ClimbWindow
    slip: Array
    disturbance: Array
    true_slip: Array
    effort: Array
    bearing: Array
    limited: float


def climb_metrics(run: Trajectory, vehicle: Vehicle, section: Profile) -> Metrics:
    """Return the averages over a climb.

    ``run`` is a motion of `slipfree.control.step_climbing.climbing`, ``section`` its ground
    (`slipfree.terrain.solids.section_of`). ModelError is raised if the front wheel touches only the
    floor.
    """
    window = climb_window(run, vehicle, section)
    span, rim = window.span, np.abs(vehicle.wheels[0].radius * run["spin"])
    slip, loads = most_loaded(run, section, "slip")[span], _at_solids(run, section, "load")[:, span]
    torques = np.abs(run["drive_torque"][span]).sum(axis=0)
    return Metrics(
        window,
        _mean_size(slip_ratio(run, vehicle)[span]),
        _mean_size(disturbance_ratio(run)[span]),
        np.nansum(np.abs(slip), axis=0) / rim[span].sum(axis=0),
        torques / torques.sum(),
        loads.sum(axis=(0, 1)) / loads.sum(),
        float(np.mean(run["torque_scale"][span] < 1)),
    )


def most_loaded(run: Trajectory, section: Profile, name: str) -> Array:
    """Return a quantity of each axle at its most loaded contact, shape (n, 3) [N or m/s].

    ``name`` is "load", "friction" or "slip"; wheels with a normal force below 1 N have NaN.
    """
    loads, values = (_at_solids(run, section, each) for each in ("load", name))
    chosen = np.take_along_axis(values, loads.argmax(axis=0)[None], axis=0)[0]
    return np.where(loads.max(axis=0) > MIN_LOAD, chosen, np.nan)


def _at_solids(run: Trajectory, section: Profile, name: str) -> Array:
    return np.stack([run[f"solid_{name}_{k}"] for k in range(len(section.solids))])


def climb_window(run: Trajectory, vehicle: Vehicle, section: Profile) -> ClimbWindow:
    """Return the window of a climb.

    It begins 50 ms before the front wheel first touches an obstacle and ends 100 ms after the rear
    axle has reached the top: 20 mm behind the edge of the highest level, at most 3 mm below its
    height there, or behind all solids that stand on the floor.
    """
    obstacles = range(1, len(section.solids))  # the first solid is the floor
    touching = np.any([run[f"solid_gap_{k}"][:, -1] < 0 for k in obstacles], axis=0)
    if not touching.any():
        raise ModelError(
            "climb: the front wheel touches only the floor until "
            f"t = {run.t[-1]:g} s; simulate longer or start nearer to the obstacle"
        )
    y, z = (run[f"center_{axis}"][:, 0] for axis in "yz")
    edge, top = section.summit
    up: Mask = (y > edge + EDGE_MARGIN) & (z > top + vehicle.wheels[0].radius - MAX_SINKAGE)
    up |= y > section.end + EDGE_MARGIN
    climbed = bool(up.any())
    end = float(run.t[up.argmax()]) if climbed else float(run.t[-1])
    ends = run.t[touching.argmax()] - LEAD_TIME, end + TRAIL_TIME
    first, last = np.searchsorted(run.t, np.array(ends) - 1e-9).tolist()
    return ClimbWindow(slice(first, last), climbed, end)


def slip_ratio(run: Trajectory, vehicle: Vehicle) -> Array:
    """Return the slip ratios ``(r w - v) / (r w)`` by (20), shape (n, 3); NaN for wheels near rest.

    ``r`` and ``w`` are the radius and the rate of a wheel, ``v`` is the speed of the middle axle;
    the ratio can therefore be nonzero for a wheel that rolls without slip.
    """
    speed = axle_speeds(run, vehicle)[:, 1]
    return np.asarray(1 - speed[:, None] / (vehicle.wheels[0].radius * _wheel_rates(run)))


def axle_speeds(run: Trajectory, vehicle: Vehicle) -> Array:
    """Return the speeds of the axles of a step climber, shape (n, 3) [m/s].

    The front axle turns with the first joint, the others with the platform.
    """
    front = run["omega_x"] + run[f"{vehicle.coordinates[0].name}_rate"]
    turning = np.stack([run["omega_x"], run["omega_x"], front], axis=1)
    arm_y, arm_z = (run[f"center_{axis}"] - run[axis][:, None] for axis in "yz")
    velocity_y = run["velocity_y"][:, None] - turning * arm_z
    return np.asarray(np.hypot(velocity_y, run["velocity_z"][:, None] + turning * arm_y))


def disturbance_ratio(run: Trajectory) -> Array:
    """Return the rate errors ``(w_ref - w) / w`` by (21), shape (n, 3); NaN near rest."""
    return np.asarray((run["reference"] - run["spin"]) / _wheel_rates(run))


def _wheel_rates(run: Trajectory) -> Array:
    return np.where(np.abs(run["spin"]) < MIN_WHEEL_RATE, np.nan, run["spin"])


def _mean_size(ratios: Array) -> Array:
    """Return the means of absolute values clipped to one, ignoring NaN; NaN if all are NaN."""
    sizes = np.ma.masked_invalid(np.minimum(np.abs(ratios), 1))
    return np.ma.filled(sizes.mean(axis=0), np.nan)
