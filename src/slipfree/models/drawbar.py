"""Drawbar-pull reserve of the wheels in soil, along a motion."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from slipfree.core.records import Array, Label
from slipfree.core.trajectory import Column, Trajectory
from slipfree.laws.soil import Soil, WheelSize, forces_at_slip, wheel_size
from slipfree.laws.soil_regions import soil_at
from slipfree.models.single_wheel import depth_under_load
from slipfree.vehicle.tree import Vehicle

SLIP_LIMIT = 0.3  # slip ratio at which the largest pull counts [1]
RESERVE = Label(
    "drawbar_reserve",
    "N",
    f"drawbar pull at a slip ratio of {SLIP_LIMIT:g} minus the pull used; zero for free wheels",
)
MAX_ANGLE = 1.5  # largest slip angle; the wheel then moves sideways [rad]


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
    found = np.zeros(run["force_normal"].shape)
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
            found[:, k] = largest - direction * run["force_along"][:, k]
    columns = {**run.columns, RESERVE.name: Column(RESERVE, found)}
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
