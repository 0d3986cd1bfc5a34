"""Dynamics of a climbing vehicle: inertia, contacts and control as one ODE."""

from __future__ import annotations

import math
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.climb.contact import CompliantContact, direction, wheel_contacts
from slipfree.climb.control import Commands, Control, check_period, torques
from slipfree.climb.noise import Noise, measured
from slipfree.climb.plan_tracking import Tracking, tracked
from slipfree.climb.records import OnSolid, Outputs, State, labels_of
from slipfree.climb.reference import PerAxle, estimated_directions, reference
from slipfree.climb.vehicle import AXLES, Climber
from slipfree.dae import Dae, Limit
from slipfree.records import Array, Label, pack, symbols
from slipfree.terrain.solids import Profile
from slipfree.vehicle.tree import GRAVITY

MAX_TILT = 1.4  # a body with a larger tilt has overturned [rad]


class Frame(NamedTuple):
    """Kinematics and dynamics of the two bodies in a state.

    Attributes
    ----------
    q, v : SX, shape (4, 1)
        Position of the joint and tilts (x, z, rear, front) [m, rad], and their rates.
    axles : PerAxle of SX, shape (2, 1)
        Positions of the axles. [m]
    mass : SX, shape (4, 4)
        Mass matrix. [kg, kg m, kg m2]
    energy : SX
        Kinetic and gravitational energy. [J]
    force : SX, shape (4, 1)
        Generalised forces of gravity and inertia. [N, N m]
    """

    q: ca.SX
    v: ca.SX
    axles: PerAxle
    mass: ca.SX
    energy: ca.SX
    force: ca.SX


def climbing(
    climber: Climber,
    profile: Profile,
    control: Control | Tracking = Control(),  # noqa: B008 - a frozen record
    contact: CompliantContact = CompliantContact(),  # noqa: B008
    *,
    period: float | None = None,
) -> Dae:
    """Return the dynamic model of a climbing vehicle with controlled wheels.

    The model has seven degrees of freedom and no constraints: two bodies on a joint and three
    axles. Every wheel has a compliant contact with every solid, so that impacts and the transition
    from floor to wall need no events. The torque of a motor turns its wheel forward and its body
    nose up.

    Parameters
    ----------
    climber : Climber
        The vehicle.
    profile : Profile
        The ground.
    control : Control or Tracking
        Controller of the wheel rates by reference speeds, or controller that tracks a plan.
    contact : CompliantContact
        The contact law.
    period : float, optional
        Sample time of the controller. Its torques are then inputs that hold the values of
        ``y.torques`` between samples, as in `slipfree.solve.zero_order_hold`. [s]

    Returns
    -------
    Dae
        The model, without algebraic unknowns. It is stiff: friction and the inertia of a wheel
        cause decay rates up to 1e5 1/s.

    Raises
    ------
    ModelError
        If the sample time is not positive, or not below `slipfree.climb.control.largest_period`.

    Notes
    -----
    The model neglects contacts of the bodies, roll, play of the side wheels' rollers, and lag of
    the tilt sensors.
    """
    if period is not None:
        check_period(period, control, climber)
    labels = labels_of(profile, control, sampled=period is not None)
    x, q, u, t = symbols(labels.x), symbols(labels.q), symbols(labels.u), ca.SX.sym("t")
    frame = _frame(climber, x)
    velocities = PerAxle(*(ca.jtimes(axle, frame.q, frame.v) for axle in frame.axles))
    contacts = PerAxle(
        *(
            wheel_contacts(profile, contact, climber.radius, axle, velocity, spin)
            for axle, velocity, spin in zip(frame.axles, velocities, x.spins, strict=True)
        )
    )
    seen = PerAxle(*(direction(each) for each in contacts))
    commands = (
        tracked(control, climber, x, frame.axles, velocities, u.speed)
        if isinstance(control, Tracking)
        else _commands(climber, control, _as_measured(control.noise, t, x), seen, u.speed)
    )
    driven = _axle_torques(climber, u.torques or commands.torques.out)
    return Dae(
        t,
        x,
        (),
        q,
        u,
        ode=ca.vertcat(
            frame.v,
            _accelerations(climber, frame, contacts, driven),
            *commands.rates,
        ),
        alg=(),
        quad=ca.vertcat(*x.spins, *_powers(x, contacts, driven)),
        y=_outputs(
            frame,
            velocities,
            contacts,
            seen,
            commands,
            frame.energy + _stored(climber, x, contacts),
        ),
        labels=labels,
        limits=_limits(x),
        checks=(),
        guess=ca.SX(0, 1),
        scale=np.zeros(0),
        shift=(np.zeros(pack(x).numel()), np.zeros(0)),
    )


def _frame(climber: Climber, x: State) -> Frame:
    """Return the positions, mass matrix, energy and forces of the two bodies in a state."""
    q = ca.vertcat(x.x, x.z, *x.tilts)
    v = ca.vertcat(x.velocity_x, x.velocity_z, *x.rates)
    bodies = (climber.rear_body, climber.front_body)
    joint, tilts = q[:2], (x.tilts.rear, x.tilts.front)
    axles = PerAxle(
        *(
            _at(joint, tilt, axle.ahead, 0.0)
            for axle, tilt in zip(climber.axles, (tilts[0], *tilts), strict=True)
        )
    )
    mass, height = ca.SX(ca.diag([0, 0, *(body.inertia for body in bodies)])), ca.SX(0)
    for body, tilt in zip(bodies, tilts, strict=True):
        center = _at(joint, tilt, body.ahead, body.above)
        arm = ca.jacobian(center, q)
        mass = mass + body.mass * arm.T @ arm
        height += body.mass * GRAVITY * center[1]
    kinetic = ca.dot(v, mass @ v) / 2
    turning = ca.jtimes(mass @ v, q, v) - ca.gradient(kinetic, q)
    force = -ca.gradient(height, q) - turning
    return Frame(q, v, axles, mass, kinetic + height, force)


def _at(joint: ca.SX, tilt: ca.SX, ahead: float, above: float) -> ca.SX:
    cosine, sine = ca.cos(tilt), ca.sin(tilt)
    place: ca.SX = joint + ca.vertcat(ahead * cosine - above * sine, ahead * sine + above * cosine)
    return place


def _axle_torques(climber: Climber, wheel: PerAxle) -> PerAxle:
    """Return the total motor torques of the axles [N m]."""
    return PerAxle(
        *(axle.wheels * torque for axle, torque in zip(climber.axles, wheel, strict=True))
    )


def _accelerations(climber: Climber, frame: Frame, contacts: PerAxle, driven: PerAxle) -> ca.SX:
    """Return the accelerations of the joint's position, the two tilts and the wheels' angles."""
    force = frame.force + ca.vertcat(0, 0, driven.rear + driven.middle, driven.front)
    spins = []
    for axle, place, touches, torque in zip(
        climber.axles, frame.axles, contacts, driven, strict=True
    ):
        ground = sum(each.load * each.normal + each.friction * each.tangent for each in touches)
        rubbing = sum(each.friction for each in touches)
        force += ca.jtimes(place, frame.q, ground, True)
        spins.append((torque - climber.radius * rubbing) / axle.inertia)
    found: ca.SX = ca.vertcat(ca.inv(frame.mass) @ force, *spins)
    return found


def _as_measured(noise: Noise | None, t: ca.SX, x: State) -> State:
    """Return the states as the sensors of the controller measure them."""
    if noise is None:
        return x
    tilts, rates, spins = measured(noise, t, x.tilts, x.rates, x.spins)
    return x._replace(tilts=tilts, rates=rates, spins=spins)


def _commands(
    climber: Climber, control: Control, x: State, seen: PerAxle, speed: ca.SX
) -> Commands:
    """Return reference rates, torques and the rates of the controller's states.

    ``seen`` are the directions of the axles [rad], ``speed`` the reference speed of the vehicle
    [m/s].
    """
    used = x.directions if control.senses else PerAxle(*(control.share * each for each in seen))
    relative = reference(climber, x.tilts, PerAxle(*used), control.law, control.cap)
    wanted = PerAxle(*(speed / climber.radius * each for each in relative))
    errors = PerAxle(*(aim - spin for aim, spin in zip(wanted, x.spins, strict=True)))
    rises = [(now - late) / control.lag for now, late in zip(errors, x.lagging, strict=False)]
    motors = torques(control, climber.torque, errors, PerAxle(*x.integrals), rises)
    unwinding = control.unwinding / control.integral
    rates = [
        error - unwinding * (torque - out)
        for error, torque, out in zip(errors, motors.wanted, motors.out, strict=True)
    ]
    if control.senses:
        raw = estimated_directions(climber, x.tilts, x.rates, x.spins)
        rates += [
            (new - old) / control.smoothing for new, old in zip(raw, x.directions, strict=True)
        ]
    return Commands(wanted, motors, (*rates, *rises))


def _powers(x: State, contacts: PerAxle, driven: PerAxle) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the powers of the motors, of friction and of damping [W]."""
    turning = [spin + rate for spin, rate in zip(x.spins, (x.rates[0], *x.rates), strict=True)]
    motors = sum(torque * rate for torque, rate in zip(driven, turning, strict=True))
    touches = [each for on_axle in contacts for each in on_axle]
    rubbed = -sum(each.friction * each.slip for each in touches)
    return motors, rubbed, sum(each.damped for each in touches)


def _stored(climber: Climber, x: State, contacts: PerAxle) -> ca.SX:
    """Return the energy of spinning wheels and compressed contacts [J]."""
    stored: ca.SX = sum(each.stored for on_axle in contacts for each in on_axle)
    for axle, spin in zip(climber.axles, x.spins, strict=True):
        stored += axle.inertia * spin**2 / 2
    return stored


def _outputs(
    frame: Frame,
    velocities: PerAxle,
    contacts: PerAxle,
    seen: PerAxle,
    commands: Commands,
    energy: ca.SX,
) -> Outputs:
    solids = tuple(
        OnSolid(
            *(
                PerAxle(*(getattr(each, name) for each in touches))
                for name in ("gap", "load", "friction", "slip")
            )
        )
        for touches in zip(*contacts, strict=True)
    )
    return Outputs(
        axle_x=PerAxle(*(place[0] for place in frame.axles)),
        axle_z=PerAxle(*(place[1] for place in frame.axles)),
        axle_velocity_x=PerAxle(*(velocity[0] for velocity in velocities)),
        axle_velocity_z=PerAxle(*(velocity[1] for velocity in velocities)),
        directions=seen,
        references=commands.references,
        torques=commands.torques.out,
        scale=commands.torques.scale,
        solids=solids,
        energy=energy,
    )


def _limits(x: State) -> tuple[Limit, ...]:
    return tuple(
        Limit(
            Label(f"{name}_overturned", "rad", f"the {name} body overturns: its tilt"),
            tilt,
            -MAX_TILT,
            MAX_TILT,
        )
        for name, tilt in zip(("rear", "front"), x.tilts, strict=True)
    )


def standing(
    climber: Climber, contact: CompliantContact, front: float, speed: float = 0.0
) -> dict[str, float]:
    """Return the states of a vehicle on a level floor at height zero, at rest or rolling, by name.

    Parameters
    ----------
    climber : Climber
        The vehicle.
    contact : CompliantContact
        The contact law, which determines the penetration depth of the wheels.
    front : float
        Position of the front axle. [m]
    speed : float
        Forward speed of the vehicle; its wheels roll without slip. [m/s]
    """
    rear, middle, ahead = (
        climber.radius - load / contact.stiffness for load in floor_loads(climber)
    )
    link = climber.middle.ahead - climber.rear.ahead
    tilt_rear = math.asin((middle - rear) / link)
    joint = middle - climber.middle.ahead * math.sin(tilt_rear)
    tilt_front = math.asin((ahead - joint) / climber.front.ahead)
    spin = speed / climber.radius
    return {
        "x": front - climber.front.ahead * math.cos(tilt_front),
        "z": joint,
        "tilt_rear": tilt_rear,
        "tilt_front": tilt_front,
        "velocity_x": speed,
        **{f"wheel_rate[{axle}]": spin for axle in AXLES},
    }


def floor_loads(climber: Climber) -> Array:
    """Return the loads of rear, middle and front axle at rest on a level floor, shape (3,) [N].

    They follow from the moments of each body about the joint and from the total weight.
    """
    rear, front = climber.rear_body, climber.front_body
    arms = [[climber.rear.ahead, climber.middle.ahead, 0], [0, 0, climber.front.ahead], [1, 1, 1]]
    moments = [rear.mass * rear.ahead, front.mass * front.ahead, climber.mass]
    return np.asarray(GRAVITY * np.linalg.solve(np.array(arms), np.array(moments)))
