"""Single wheel under a load, at imposed slip ratio and slip angle; reserve of drawbar pull."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Label
from slipfree.core.trajectory import Column, Trajectory
from slipfree.laws.soil import Soil, WheelSize, forces_at_slip, wheel_size
from slipfree.laws.soil_regions import soil_at
from slipfree.vehicle.tree import EARTH_GRAVITY, Vehicle

STEPS = 60  # number of bisection steps for the sinkage
SLIP_LIMIT = 0.3  # slip ratio at which the largest pull counts [1]
RESERVE = Label(
    "drawbar_reserve",
    "N",
    f"drawbar pull at a slip ratio of {SLIP_LIMIT:g} minus the pull used; zero for free wheels",
)
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
    steady = steady_forces(soil, size, np.full_like(s, load), s, beta, gravity)
    return WheelCurves(angle, slip, *(each.reshape(angle.size, slip.size) for each in steady))


def steady_forces(
    soil: Soil,
    size: WheelSize,
    load: Array,
    slip: Array,
    angle: Array,
    gravity: float = EARTH_GRAVITY,
) -> SteadyForces:
    """Return sinkage and forces of a wheel in n steady motions; errors as `single_wheel`."""
    _check(load, slip, angle)
    s, beta = slip[None], angle[None]
    forces = _forces(soil, size, gravity)
    borne = forces(np.full_like(s, size.radius), s, beta)[0].full()[0]
    if (borne < load).any():
        k = (borne - load).argmin()
        raise ModelError(
            "expected a sinkage smaller than the wheel's radius, "
            f"{size.radius:g} m, found that the soil bears only {borne[k]:.4g} N of "
            f"{load[k]:.4g} N at that depth, at slip {slip[k]:g} and slip angle {angle[k]:g} rad; "
            "reduce the load, or use a larger wheel"
        )
    depth = depth_under_load(
        lambda depths: forces(depths, s, beta)[0].full(), size.radius, load[None]
    )
    _, pull, side, torque = (each.full()[0] for each in forces(depth, s, beta))
    return SteadyForces(depth[0], pull, -np.sign(angle) * side, torque)


def depth_under_load(normal: Callable[[Array], Array], radius: float, load: Array) -> Array:
    """Return the depths at which soil bears loads [N], by bisection; at most the radius [m]."""
    low, high = np.zeros_like(load), np.full_like(load, radius)
    for _ in range(STEPS):
        middle = (low + high) / 2
        deep = normal(middle) > load
        low, high = np.where(deep, low, middle), np.where(deep, middle, high)
    return np.asarray((low + high) / 2)


def _check(load: Array, slip: Array, angle: Array) -> None:
    """Raise ModelError if an argument of `steady_forces` is outside its bounds."""
    checks = (
        ("load: expected a finite positive force in N", load, (load > 0) & (load < np.inf)),
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


def _forces(soil: Soil, size: WheelSize, gravity: float) -> ca.Function:
    """Return the forces on a wheel as a function of depth, slip ratio and slip angle."""
    arguments = depth, slip, angle = [ca.SX.sym(name) for name in ("depth", "slip", "angle")]
    forces = forces_at_slip(soil, size, depth, slip, angle, gravity)
    return ca.Function("forces", arguments, [*forces])


def drawbar_reserve(vehicle: Vehicle, soil: Soil, run: Trajectory) -> Trajectory:
    """Return a motion in soil with the drawbar-pull reserve of its wheels.

    The reserve of a driven wheel is its pull at the slip ratio `SLIP_LIMIT`, under its load and at
    its slip angle, minus the pull that it transmits in the direction in which it rolls. It is
    negative if the wheel slips more, and nan where the wheel would sink to its axle.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    soil : Soil
        The soil of the motion.
    run : Trajectory
        The motion, of `quasi_statics` or `dynamics`.
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
    function = ca.Function("forces", arguments, [forces.normal, forces.pull])

    def at_depth(depths: Array) -> tuple[Array, Array]:
        return tuple(each.full().ravel() for each in function(*(v[None] for v in (depths, *rest))))

    rest = x, y, angle
    borne, _ = at_depth(np.full(load.shape, size.radius))
    depths = depth_under_load(lambda depths: at_depth(depths)[0], size.radius, load)
    return np.where(borne < load, np.nan, at_depth(depths)[1])
