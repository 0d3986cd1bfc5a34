"""Open-loop inputs that drive along arcs on even ground, with stops between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from slipfree.control.path_following import planar_geometry, wheel_rate
from slipfree.core.dae import Dae
from slipfree.core.records import Array, leaves
from slipfree.vehicle.tree import Vehicle

STEERING_STEPS = 20  # number of steps of the fixed-point iteration for the steering
SAME_ANGLE = 1e-9  # smaller changes of commanded coordinates are omitted [rad, m]
Piecewise = tuple[tuple[float, float], ...]


def turning_axis_offset(vehicle: Vehicle) -> float:
    """Return the distance of the platform's centre ahead of the vehicle's turning axis [m].

    Raises
    ------
    ModelError
        If the vehicle has neither steered wheels nor driven wheels on both sides.
    """
    return planar_geometry(vehicle, _symbols(vehicle)).ahead


def arc_inputs(
    dae: Dae,
    vehicle: Vehicle,
    arcs: Sequence[tuple[float, float]],
    coordinates: Mapping[str, float],
    *,
    speed: float,
) -> tuple[dict[str, Piecewise], float]:
    """Return inputs that drive along consecutive arcs, and the duration [s].

    The vehicle stops before every arc until its wheels are steered for it. On even ground the
    middle of the turning axis then follows the arc without slip.

    Parameters
    ----------
    dae : Dae
        The vehicle's direct kinematics.
    vehicle : Vehicle
        Vehicle with steered wheels, or with driven wheels on both sides.
    arcs : sequence of (float, float)
        Length of each arc, negative to drive backwards [m], and its curvature, positive to the
        left [1/m].
    coordinates : mapping of str to float
        Commanded coordinates at the beginning. [rad, m]
    speed : float
        Speed, positive. [m/s]

    Returns
    -------
    inputs : dict of str to tuple of (float, float)
        For each input, pairs of a time [s] and the rate from this time on. [rad/s, m/s]
    duration : float
        Time at the end of the last arc. [s]

    Raises
    ------
    ModelError
        If the vehicle has neither steered wheels nor driven wheels on both sides.
    """
    states = _symbols(vehicle)
    plan, column = planar_geometry(vehicle, states), ca.vertcat(ca.SX(0, 1), *states.values())
    bend, v = ca.SX.sym("bend"), ca.SX.sym("v")
    steering: dict[str, ca.SX] = dict.fromkeys(states, ca.SX(0))
    sizes: dict[str, ca.SX] = dict.fromkeys(states, ca.SX(0))
    for each in plan.steered:
        error = ca.atan2(each.forward * bend, 1 + each.right * bend) - each.angle
        for name, effect in each.effects.items():
            steering[name] += effect * error
            sizes[name] += effect**2
    change = [steering[name] / ca.fmax(sizes[name], SAME_ANGLE) for name in states]
    wheels = [
        wheel_rate(each, v, plan.gain * v * bend, {}) for each in plan.wheels if each.wheel.driven
    ]
    step = ca.Function("step", [column, bend], [ca.vertcat(ca.SX(0, 1), *change)])
    rates = ca.Function("rates", [column, bend, v], [ca.vertcat(*wheels)])
    now = np.array([coordinates[name] for name in states])
    times, rows = [0.0], list[Array]()
    for length, curvature in arcs:
        steered = now
        for _ in range(STEERING_STEPS):
            steered = steered + np.array(step(steered, curvature)).ravel()
        turn = np.abs(steered - now).max(initial=0.0)
        if turn > SAME_ANGLE:
            pause = turn * plan.base / speed
            times.append(times[-1] + pause)
            rows.append(np.concatenate([np.zeros(len(wheels)), (steered - now) / pause]))
        turning = np.array(rates(steered, curvature, np.copysign(speed, length))).ravel()
        times.append(times[-1] + abs(length) / speed)
        rows.append(np.concatenate([turning, np.zeros(now.size)]))
        now = steered
    names = [label.full for label in leaves(dae.labels.u)]
    values = np.array(rows).T.tolist()
    pieces = {
        name: tuple(zip(times[:-1], row, strict=True))
        for name, row in zip(names, values, strict=True)
    }
    return pieces, times[-1]


def _symbols(vehicle: Vehicle) -> dict[str, ca.SX]:
    return {c.name: ca.SX.sym(c.name) for c in vehicle.of("commanded")}
