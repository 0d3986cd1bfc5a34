"""Dynamics of a climbing vehicle with its controller, as one ODE."""

from __future__ import annotations

import math
from dataclasses import replace

import casadi as ca
import numpy as np

from slipfree.climb.plan_tracking import Tracking, tracked
from slipfree.control.climb_records import (
    INPUTS,
    OUTPUTS,
    ControlOutputs,
    ControlState,
    Measured,
    state_labels,
)
from slipfree.control.controlled import Controller, controlled
from slipfree.control.reference_speeds import (
    PerAxle,
    Tilts,
    directions,
    estimated_directions,
    reference,
)
from slipfree.control.sensor_noise import Noise, measured
from slipfree.control.step_climbing import Commands, Control, check_period, torques
from slipfree.dae import Dae, Limit
from slipfree.laws.compliant import Compliant
from slipfree.models.dynamics import dynamics
from slipfree.models.limits import UPRIGHT
from slipfree.records import Array, Label, symbols
from slipfree.terrain.analytic import Analytic
from slipfree.terrain.solids import Prism, Profile, Solids
from slipfree.vehicle.climber import AXLES, FOLD, Climber, side_view
from slipfree.vehicle.tree import GRAVITY

MAX_TILT = 1.4  # a body with a larger tilt has overturned [rad]


def climbing(
    climber: Climber,
    profile: Profile,
    control: Control | Tracking = Control(),  # noqa: B008 - a frozen record
    law: Compliant = Compliant(),  # noqa: B008
    *,
    friction: float = 0.4,
    period: float | None = None,
) -> Dae:
    """Return the dynamic model of a climbing vehicle with controlled wheels.

    It is `slipfree.dynamics` of a planar vehicle, two bodies connected by a joint on three axles,
    on the solids of the profile. Every wheel has a compliant contact with every solid, so that
    impacts and the transition from floor to wall need no events.

    Parameters
    ----------
    climber : Climber
        The vehicle.
    profile : Profile
        The ground. Its x is the map's y.
    control : Control or Tracking
        Controller of the wheel rates by reference speeds, or controller that tracks a plan.
    law : Compliant
        Wheel-ground law.
    friction : float
        Static coefficient of friction. [1]
    period : float, optional
        Sample time of the controller. The torques of the axles are then inputs that hold the values
        of `held_torques` between samples, as in `slipfree.solve.zero_order_hold`. [s]

    Returns
    -------
    Dae
        The model, without algebraic unknowns. It is stiff: friction and the inertia of a wheel
        cause decay rates up to 1e5 1/s.

    Raises
    ------
    ModelError
        If the sample time is not positive, or not below
        `slipfree.control.step_climbing.largest_period`.

    Notes
    -----
    The model neglects contacts of the bodies, roll, play of the side wheels' rollers, and lag of
    the tilt sensors.
    """
    if period is not None:
        check_period(period, control, climber)
    bottom = min(z for solid in profile.solids for _, z in solid.points)
    base = Analytic(lambda x, _y: bottom + 0 * x, mu=friction)
    model = dynamics(side_view(climber), Solids(base, prisms(profile)), law=law)
    controller = _controller(climber, profile, control, model)
    # other limits do not apply: wheels are upright, and their contacts are defined at any depth
    model = replace(model, limits=_limits(controller.y.tilts))
    return controlled(model, controller, sampled=period is not None)


def held_torques(climber: Climber, model: Dae) -> dict[str, ca.SX]:
    """Return the inputs of a climb's model with a sampled controller by name, without the speed."""
    torques = model.y.controller.torques
    return {
        f"{name}_torque": axle.wheels * torque
        for name, axle, torque in zip(AXLES, climber.axles, torques, strict=True)
    }


def prisms(profile: Profile) -> tuple[Prism, ...]:
    """Return the solids of a profile along the map's y."""
    return tuple(Prism(solid) for solid in profile.solids)


def _controller(
    climber: Climber, profile: Profile, control: Control | Tracking, model: Dae
) -> Controller:
    """Return the controller of a climb's model."""
    labels = state_labels(control)
    x, u, moving = symbols(labels), symbols(INPUTS), model.x
    (rear,), (fold,), (rate,), (fold_rate,) = (
        moving.attitude,
        moving.joints,
        moving.omega,
        moving.joint_speeds,
    )
    true = Measured(Tilts(rear, rear + fold), Tilts(rate, rate + fold_rate), PerAxle(*moving.spins))
    q, v = (
        ca.vertcat(moving.y, moving.z, rear, fold),
        ca.vertcat(*moving.velocity, rate, fold_rate),
    )
    common = model.y.common
    axles = PerAxle(
        *(ca.vertcat(*each) for each in zip(common.center_y, common.center_z, strict=True))
    )
    seen = directions(profile, climber.radius, axles)
    if isinstance(control, Tracking):
        velocities = PerAxle(*(ca.jtimes(place, q, v) for place in axles))
        commands = tracked(control, climber, true.spins, axles, velocities, u.speed)
    else:
        commands = _commands(
            climber, control, x, _as_measured(control.noise, model.t, true), seen, u.speed
        )
    motors, y = commands.torques, model.y
    energy = y.kinetic_energy + common.forces.potential_energy + y.contact_energy
    return Controller(
        x=x,
        u=u,
        rates=commands.rates,
        laws=tuple(each.wheels * tau for each, tau in zip(climber.axles, motors.out, strict=True)),
        y=ControlOutputs(true.tilts, seen, commands.references, motors.out, motors.scale, energy),
        labels_x=labels,
        labels_u=INPUTS,
        labels_y=OUTPUTS,
    )


def _as_measured(noise: Noise | None, t: ca.SX, true: Measured) -> Measured:
    """Return the quantities measured by the controller's sensors."""
    return true if noise is None else Measured(*measured(noise, t, *true))


def _commands(
    climber: Climber,
    control: Control,
    x: ControlState,
    found: Measured,
    seen: PerAxle,
    speed: ca.SX,
) -> Commands:
    """Return reference rates, torques and the rates of the controller's states.

    ``seen`` are the directions of the axles [rad], ``speed`` the reference speed of the vehicle
    [m/s].
    """
    used = x.directions if control.senses else PerAxle(*(control.share * each for each in seen))
    relative = reference(climber, found.tilts, PerAxle(*used), control.law, control.cap)
    wanted = PerAxle(*(speed / climber.radius * each for each in relative))
    errors = PerAxle(*(aim - spin for aim, spin in zip(wanted, found.spins, strict=True)))
    rises = [(now - late) / control.lag for now, late in zip(errors, x.lagging, strict=False)]
    motors = torques(control, climber.torque, errors, PerAxle(*x.integrals), rises)
    unwinding = control.unwinding / control.integral
    rates = [
        error - unwinding * (torque - out)
        for error, torque, out in zip(errors, motors.wanted, motors.out, strict=True)
    ]
    if control.senses:
        raw = estimated_directions(climber, *found)
        rates += [
            (new - old) / control.smoothing for new, old in zip(raw, x.directions, strict=True)
        ]
    return Commands(wanted, motors, (*rates, *rises))


def _limits(tilts: Tilts) -> tuple[Limit, ...]:
    return tuple(
        Limit(
            Label(f"{name}_{UPRIGHT}", "rad", f"the {name} body overturns (tilt)"),
            tilt,
            -MAX_TILT,
            MAX_TILT,
        )
        for name, tilt in zip(("rear", "front"), tilts, strict=True)
    )


def standing(climber: Climber, front: float, speed: float = 0.0) -> dict[str, float]:
    """Return the states of a vehicle on a level floor at height zero, at rest or rolling, by name.

    Parameters
    ----------
    climber : Climber
        The vehicle.
    front : float
        Position of the front axle. [m]
    speed : float
        Forward speed of the vehicle; its wheels roll without slip. [m/s]
    """
    rear, middle, ahead = (
        climber.radius - load / climber.stiffness for load in floor_loads(climber)
    )
    link = climber.middle.ahead - climber.rear.ahead
    tilt_rear = math.asin((middle - rear) / link)
    joint = middle - climber.middle.ahead * math.sin(tilt_rear)
    tilt_front = math.asin((ahead - joint) / climber.front.ahead)
    spin = speed / climber.radius
    return {
        "y": front - climber.front.ahead * math.cos(tilt_front),
        "z": joint,
        "pitch": tilt_rear,
        FOLD: tilt_front - tilt_rear,
        "velocity_y": speed,
        **{f"spin[{axle}]": spin for axle in AXLES},
    }


def floor_loads(climber: Climber) -> Array:
    """Return the loads of rear, middle and front axle at rest on a level floor, shape (3,) [N].

    They follow from the moments of each body about the joint and from the total weight.
    """
    rear, front = climber.rear_body, climber.front_body
    arms = [[climber.rear.ahead, climber.middle.ahead, 0], [0, 0, climber.front.ahead], [1, 1, 1]]
    moments = [rear.mass * rear.ahead, front.mass * front.ahead, climber.mass]
    return np.asarray(GRAVITY * np.linalg.solve(np.array(arms), np.array(moments)))
