"""Single wheel under a load, at imposed slip ratio and slip angle; reserve of drawbar pull."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Array
from slipfree.core.trajectory import Column, Trajectory
from slipfree.laws.soil import (
    STEADY_CREEP,
    Soil,
    WheelSize,
    check_bearing,
    depth_under_load,
    forces_at_slip,
    forces_at_speeds,
    soil_at,
    wheel_size,
)
from slipfree.vehicle.tree import EARTH_GRAVITY, Vehicle

SLIP_LIMIT = 0.3  # slip ratio at which the largest pull counts [1]
RESERVE = quantity_label("drawbar_reserve", slip=SLIP_LIMIT)
MAX_ANGLE = 1.5  # largest slip angle; the wheel then moves sideways [rad]


class WheelCurves(NamedTuple):
    """Steady forces on a wheel at slip angles (n_angles,) [rad] and slip ratios (n_slips,) [1].

    Depth of the lowest point [m], drawbar pull [N], side force, positive against the sideways
    motion [N], and resistance torque [N m] have the shape (n_angles, n_slips).
    """

    angle: Array
    slip: Array
    sinkage: Array
    pull: Array
    side: Array
    torque: Array


class WheelRuns(NamedTuple):
    """Measured runs of a wheel: n points, of which those with one number belong to one run."""

    motion: Array  # shape (3, n): rim speed, speed along and across, over the largest [1]
    load: Array  # shape (n,) [N]
    values: Array  # shape (n, 4): pull, side force, torque and sinkage; nan if not measured
    run: Array  # shape (n,): number of the run

    def take(self, rows: Array) -> WheelRuns:
        """Return some of the points, by index or mask."""
        return WheelRuns(self.motion[:, rows], self.load[rows], self.values[rows], self.run[rows])


class SteadyForces(NamedTuple):
    """Sinkage, drawbar pull, side force and torque at n points, as in `WheelCurves`."""

    sinkage: Array
    pull: Array
    side: Array
    torque: Array


def single_wheel(
    soil: Soil,
    size: WheelSize,
    load: float,
    slips: Sequence[float] | Array,
    angles: Sequence[float] | Array = (0.0,),
    *,
    gravity: float = EARTH_GRAVITY,
) -> WheelCurves:
    """Return sinkage, drawbar pull, side force and torque of a wheel in steady motion.

    Parameters
    ----------
    soil : Soil
        The soil.
    size : WheelSize
        Radius and width of the wheel.
    load : float
        Vertical load, positive. [N]
    slips : sequence of float
        Slip ratios, -1 to 1. [1]
    angles : sequence of float
        Slip angles, each of magnitude less than pi/2. [rad]
    gravity : float
        Gravitational acceleration, for the soil that the wheel pushes aside. [m/s^2]

    Raises
    ------
    ModelError
        If the load, a slip ratio or a slip angle is outside these bounds, or if the wheel sinks to
        its axle.

    Examples
    --------
    Compute the drawbar pull of a wheel in a soil of the catalogue at a slip of 20 %:

    >>> from slipfree.laws.soil import Soil, WheelSize
    >>> from slipfree.models.single_wheel import single_wheel
    >>> curves = single_wheel(Soil(), WheelSize(radius=0.092, width=0.107), 64.7, [0.2])
    >>> print(f"{curves.pull[0, 0]:.1f} N, {1e3 * curves.sinkage[0, 0]:.1f} mm")
    10.2 N, 15.7 mm
    """
    slip, angle = np.asarray(slips, dtype=float), np.asarray(angles, dtype=float)
    s, beta = (each.ravel() for each in np.meshgrid(slip, angle))
    check_slip(s, beta)
    steady = steady_forces(soil, size, motion_at_slip(s, beta), np.full_like(s, load), gravity)
    return WheelCurves(angle, slip, *(each.reshape(angle.size, slip.size) for each in steady))


def motion_at_slip(slip: Array, angle: Array) -> Array:
    """Return rim speed and speeds along and across for slip ratios and slip angles, shape (3, n).

    The larger of the rim speed and the speed along is one.
    """
    forward, rim = 1 - np.maximum(slip, 0), 1 + np.minimum(slip, 0)
    return np.vstack([rim, forward, forward * np.tan(angle)])


def slip_of_motion(motion: Array) -> tuple[Array, Array]:
    """Return slip ratios and slip angles [rad] of motions, shape (3, n); zero at rest."""
    rim, along, across = motion
    fastest = np.maximum(np.abs(rim), np.abs(along))
    slip = np.divide(rim - along, fastest, out=np.zeros_like(fastest), where=fastest > 0)
    return slip, np.arctan2(across, along)


def steady_forces(
    soil: Soil, size: WheelSize, motion: Array, load: Array, gravity: float = EARTH_GRAVITY
) -> SteadyForces:
    """Return sinkage and forces in n steady motions, shape (3, n), under loads [N].

    A motion is the rim speed and the speeds along and across, over any speed. Errors are those of
    `single_wheel`.
    """
    if not ((load > 0) & (load < np.inf)).all():
        wrong = load[~((load > 0) & (load < np.inf))][0]
        raise ModelError(
            f"load: expected a finite positive force in N, found {wrong:g}; correct it"
        )
    depth, speeds = ca.SX.sym("depth"), ca.SX.sym("speeds", 3)
    parts = speeds[0], speeds[1], speeds[2]
    components = forces_at_speeds(soil, size, depth, *parts, STEADY_CREEP, gravity)
    normal = ca.vertcat(components.normal, ca.jacobian(components.normal, depth))
    forces = ca.Function("forces", [depth, speeds], [normal, *components[1:]])
    borne = forces(np.full((1, load.size), size.radius), motion)[0].full()[0]
    if load.size:
        k = (borne - load).argmin()
        slip, angle = slip_of_motion(motion[:, k])
        where = f", at slip {slip:g} and slip angle {angle:g} rad"
        check_bearing(size, borne[k], load[k], where)
    depths = depth_under_load(lambda h: forces(h[None], motion)[0].full(), size.radius, load)
    _, pull, side, torque = (each.full()[0] for each in forces(depths[None], motion))
    return SteadyForces(depths, pull, -np.sign(motion[2]) * side, torque)


def check_slip(slip: Array, angle: Array) -> None:
    """Raise ModelError if slip ratios or slip angles are outside their bounds."""
    checks = (
        ("slips: expected slip ratios from -1 to 1", slip, np.abs(slip) <= 1),
        (
            "angles: expected slip angles between -pi/2 and pi/2, in radians",
            angle,
            np.abs(angle) < np.pi / 2,
        ),
    )
    for expected, values, good in checks:
        if not good.all() or not values.size:
            found = f"{values[~good][0]:g}; correct it" if values.size else "none; add one"
            raise ModelError(f"{expected}, found {found}")


def drawbar_reserve(vehicle: Vehicle, soil: Soil, run: Trajectory) -> Trajectory:
    """Return a motion in soil with the drawbar-pull reserve of its wheels.

    The reserve of a driven wheel is its pull at the slip ratio `SLIP_LIMIT`, under its load and at
    its slip angle, minus the pull that it transmits in the direction in which it rolls. It is
    negative if the wheel slips more, and nan where the wheel would sink to its axle.
    """
    reserve = np.zeros(run["force_normal"].shape)
    for k, wheel in enumerate(vehicle.wheels):
        if wheel.driven:
            rim = wheel.radius * run["wheel_rate"][:, k]
            forward = run["slip_along"][:, k] + rim
            # The law mirrors front and rear where the sum is negative; at rest, forward counts.
            direction = np.where(rim + forward < 0, -1.0, 1.0)
            sideways = np.abs(run["slip_across"][:, k])
            angle = np.minimum(np.arctan2(sideways, np.abs(forward)), MAX_ANGLE)
            at = run["contact_x"][:, k], run["contact_y"][:, k], angle
            largest = _pull_at_limit(soil, wheel_size(wheel), run["force_normal"][:, k], *at)
            reserve[:, k] = largest - direction * run["force_along"][:, k]
    columns = {**run.columns, RESERVE.name: Column(RESERVE, reserve)}
    return replace(run, columns=columns)


def _pull_at_limit(
    soil: Soil, size: WheelSize, load: Array, x: Array, y: Array, angle: Array
) -> Array:
    """Return the pull under n loads [N] at points in map coordinates and at slip angles [N]."""
    arguments = [ca.SX.sym(name) for name in ("depth", "x", "y", "angle")]
    depth, *place, beta = arguments
    forces = forces_at_slip(soil_at(soil, *place), size, depth, SLIP_LIMIT, beta)
    rows = ca.vertcat(forces.normal, ca.jacobian(forces.normal, depth), forces.pull)
    function = ca.Function("forces", arguments, [ca.densify(rows)])

    def at_depth(depths: Array) -> Array:
        return np.asarray(function(*(v[None] for v in (depths, x, y, angle))).full())

    borne = at_depth(np.full(load.shape, size.radius))[0]
    depths = depth_under_load(lambda depths: at_depth(depths)[:2], size.radius, load)
    return np.where(borne < load, np.nan, at_depth(depths)[2])
