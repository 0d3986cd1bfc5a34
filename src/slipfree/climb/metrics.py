"""Metrics of a climb: slip and disturbance as in Chugo et al. (2009), true slip, load shares.

They are averages of absolute values over a time window around the climb; that paper does not define
its window. The samples of a motion must be equally spaced.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slipfree.errors import ModelError
from slipfree.records import Array, Mask
from slipfree.terrain.solids import Profile
from slipfree.trajectory import Trajectory
from slipfree.vehicle.tree import Vehicle

LEAD_TIME, TRAIL_TIME = 0.05, 0.1  # parts of the window before first contact and after climb [s]
EDGE_MARGIN, MAX_SINKAGE = 0.02, 0.003  # distance behind the edge, depth below the top level [m]
MIN_WHEEL_RATE = 0.4  # ratios with smaller wheel rates are ignored [rad/s]
MIN_LOAD = 1.0  # contacts with a smaller normal force are ignored [N]


class Window(NamedTuple):
    """Time window of a climb.

    Attributes
    ----------
    span : slice
        Samples of the window.
    climbed : bool
        Whether the rear axle reaches the top; otherwise the window ends with the motion.
    t : float
        Time at which the rear axle reaches the top, or end of the motion. [s]
    """

    span: slice
    climbed: bool
    t: float


class Metrics(NamedTuple):
    """Averages over the time window of a climb.

    Arrays have shape (3,), for rear, middle and front axle.

    Attributes
    ----------
    window : Window
        Time window of the averages.
    slip : ndarray
        Mean absolute slip ratio, equation (20) of Chugo et al. (2009). Absolute values are clipped
        to one, and samples with a wheel rate below 0.4 rad/s are ignored; NaN if none remain. The
        ratio uses the speed of the middle axle for all wheels; it can therefore be nonzero for a
        wheel that rolls without slip.
    disturbance : ndarray
        Mean absolute relative error of the wheel rate, equation (21) of the same paper, with the
        same clipping and the same ignored samples.
    true_slip : ndarray
        Slip distance of the rim on the most loaded solid, divided by the distance the rim travels.
    effort : ndarray
        Share of the axle in the absolute motor torques of all wheels.
    bearing : ndarray
        Share of the axle in the normal forces.
    limited : float
        Fraction of the time in which the motors' limit scales the torques.
    """

    window: Window
    slip: Array
    disturbance: Array
    true_slip: Array
    effort: Array
    bearing: Array
    limited: float


def climb_metrics(run: Trajectory, vehicle: Vehicle, section: Profile) -> Metrics:
    """Return the averages over a climb.

    Parameters
    ----------
    run : Trajectory
        A motion of `slipfree.control.step_climbing.climbing`.
    vehicle : Vehicle
        Its vehicle, see `slipfree.vehicle.climber.climber_of`.
    section : Profile
        Its ground, see `slipfree.terrain.solids.section_of`.

    Raises
    ------
    ModelError
        If the front wheel touches only the floor.
    """
    window, radius = climb_window(run, vehicle, section), vehicle.wheels[0].radius
    span = window.span
    slip, loads = most_loaded(run, section, "slip")[span], _at_solids(run, section, "load")[:, span]
    torques = np.abs(run["drive_torque"][span]).sum(axis=0)
    return Metrics(
        window,
        _mean_size(slip_ratio(run, vehicle)[span]),
        _mean_size(disturbance_ratio(run)[span]),
        np.nansum(np.abs(slip), axis=0) / np.abs(radius * run["spin"][span]).sum(axis=0),
        torques / torques.sum(),
        loads.sum(axis=(0, 1)) / loads.sum(),
        float(np.mean(run["torque_scale"][span] < 1)),
    )


def most_loaded(run: Trajectory, section: Profile, name: str) -> Array:
    """Return a quantity of each axle's wheels at the solid with the largest load.

    Parameters
    ----------
    run, section : Trajectory, Profile
        The motion and its ground.
    name : {"load", "friction", "slip"}
        Normal force, tangential force, or slip velocity at a solid.

    Returns
    -------
    ndarray, shape (n, 3)
        The quantity; NaN for wheels with a normal force below 1 N. [N or m/s]
    """
    loads, values = (_at_solids(run, section, each) for each in ("load", name))
    found = np.take_along_axis(values, loads.argmax(axis=0)[None], axis=0)[0]
    return np.where(loads.max(axis=0) > MIN_LOAD, found, np.nan)


def _at_solids(run: Trajectory, section: Profile, name: str) -> Array:
    """Return a quantity of each axle's wheels at each solid, shape (n_solids, n, 3)."""
    return np.stack([run[f"solid_{name}_{k}"] for k in range(len(section.solids))])


def climb_window(run: Trajectory, vehicle: Vehicle, section: Profile) -> Window:
    """Return the window of a climb.

    It begins 50 ms before the front wheel first touches an obstacle and ends 100 ms after the rear
    axle has reached the top: 20 mm behind the edge of the highest level, at most 3 mm below its
    height there, or behind all solids that stand on the floor.

    Raises
    ------
    ModelError
        If the front wheel touches only the floor.
    """
    touching = touches_obstacle(run, section)
    if not touching.any():
        raise ModelError(
            "climb: the front wheel touches only the floor until "
            f"t = {run.t[-1]:g} s; simulate longer or start nearer to the obstacle"
        )
    up = has_reached_top(run, vehicle, section)
    climbed = bool(up.any())
    end = float(run.t[up.argmax()]) if climbed else float(run.t[-1])
    begin = float(run.t[touching.argmax()])
    ends = np.searchsorted(run.t, [begin - LEAD_TIME - 1e-9, end + TRAIL_TIME - 1e-9])
    return Window(slice(int(ends[0]), int(ends[1])), climbed, end)


def touches_obstacle(run: Trajectory, section: Profile) -> Mask:
    """Return the mask of samples at which the front wheel touches an obstacle, shape (n,)."""
    touching = np.zeros(run.t.size, dtype=bool)
    for k in range(1, len(section.solids)):  # the first is the ground
        touching |= run[f"solid_gap_{k}", run.wheels[-1]] < 0
    return touching


def has_reached_top(run: Trajectory, vehicle: Vehicle, section: Profile) -> Mask:
    """Return the mask of samples with the rear axle on top, as in `climb_window`, shape (n,)."""
    edge, top = section.summit
    x, z = (run[f"center_{axis}"][:, 0] for axis in "yz")
    up: Mask = (x > edge + EDGE_MARGIN) & (z > top + vehicle.wheels[0].radius - MAX_SINKAGE)
    return up | (x > section.end + EDGE_MARGIN)


def slip_ratio(run: Trajectory, vehicle: Vehicle) -> Array:
    """Return the slip ratios ``(r w - v) / (r w)`` by (20), shape (n, 3); NaN for wheels near rest.

    ``r`` and ``w`` are the radius and the rate of a wheel, ``v`` is the speed of the middle axle.
    """
    speed = axle_speeds(run, vehicle)[:, 1]
    rate = _turning_rates(run)
    return np.asarray(1 - speed[:, None] / (vehicle.wheels[0].radius * rate))


def axle_speeds(run: Trajectory, vehicle: Vehicle) -> Array:
    """Return the speeds of the axles, shape (n, 3) [m/s]."""
    front = run["omega_x"] + run[f"{vehicle.coordinates[0].name}_rate"]
    turning = np.stack([run["omega_x"], run["omega_x"], front], axis=1)
    arm_y, arm_z = (run[f"center_{axis}"] - run[axis][:, None] for axis in "yz")
    velocity_y = run["velocity_y"][:, None] - turning * arm_z
    return np.asarray(np.hypot(velocity_y, run["velocity_z"][:, None] + turning * arm_y))


def disturbance_ratio(run: Trajectory) -> Array:
    """Return the relative rate errors of the axles, shape (n, 3), NaN at low wheel rates.

    The error is ``(w_ref - w) / w``, equation (21) of Chugo et al. (2009).
    """
    return np.asarray((run["reference"] - run["spin"]) / _turning_rates(run))


def _turning_rates(run: Trajectory) -> Array:
    rate = run["spin"]
    return np.where(np.abs(rate) < MIN_WHEEL_RATE, np.nan, rate)


def _mean_size(ratios: Array) -> Array:
    """Return the means of absolute values clipped to one, ignoring NaN; NaN if all are NaN."""
    sizes = np.minimum(np.abs(ratios), 1)
    known: Mask = ~np.isnan(sizes)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(known, sizes, 0).sum(axis=0) / known.sum(axis=0))
