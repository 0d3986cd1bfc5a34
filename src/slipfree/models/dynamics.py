"""Dynamics: motion of a vehicle at any speed, with inertia and compliant contact.

The model is an explicit ODE. Contact points are found by lookups (`slipfree.contact.touch`), and
the accelerations by an LDL factorisation of the mass matrix in the expression graph. The spin of a
wheel has its own equation: with the spin ``sigma`` relative to fixed axes, the axle ``a``, the
drive's torque ``tau`` and the ground force ``F`` on the point ``P``,
``I_a sigma' = tau - a . ((P - C) x F)``. The carrier bears the rest of the moment.

A prescribed rate of a wheel or a joint is a state with a prescribed acceleration
``(u - rate) / lag`` (hybrid dynamics); the torque that it needs is an output.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca

from slipfree.contact.certify import SecondContact
from slipfree.contact.closure import ContactFrame, has_exact_closure, support_fault
from slipfree.contact.touch import Touch, search_function, touch
from slipfree.dae import Dae, Labels, Standing
from slipfree.errors import ModelError
from slipfree.forks import computing
from slipfree.geometry.frame import Pose, platform, quaternion, rotation_of
from slipfree.laws.compliant import Compliant, GroundForce
from slipfree.laws.least_slip import LeastSlip
from slipfree.laws.protocols import NORMAL, wheel_labels
from slipfree.lookups import LookupTable
from slipfree.models.base import extent, outputs, sizes, touch_function
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.labels import labels_of
from slipfree.models.limits import limits_of
from slipfree.models.multibody import (
    Load,
    Multibody,
    Speeds,
    angular_acceleration,
    bias_forces,
    generalised_forces,
    kinetic_energy,
    mass_matrix,
    multibody,
)
from slipfree.models.pressed_model import pressed_dae
from slipfree.models.quantities import Mechanics, Quantities
from slipfree.models.records import (
    Configuration,
    Dependent,
    ForceOutputs,
    Forces,
    Inputs,
    Outputs,
    Rates,
)
from slipfree.models.tip_over import tip_over_margin
from slipfree.records import Label, leaves, symbols
from slipfree.terrain.base import Terrain
from slipfree.vehicle.drives import Drive, Motor, Rate, Torque
from slipfree.vehicle.tree import GRAVITY, Coordinate, Vehicle

LAG = 1e-3  # time constant of prescribed rates [s]
NORMALISATION = 1.0  # rate at which the norm of the quaternion returns to one [1/s]
STANDING_SMOOTHING = 0.01  # width of the load law of the vehicle at rest [static depths]
EXACT_DEPTH = 1 / 250  # default static depth of vehicles with exact closure [rolling radii]


class DynamicState(NamedTuple):
    """Differential states: pose and speeds of platform, joints and wheels.

    ``attitude`` is the unit quaternion (w, x, y, z) of the platform; ``joints`` are all
    coordinates, ``joint_speeds`` their rates, and ``spins`` the speeds of the wheels. ``drives``
    are the integrals of the speed controllers. [m, rad, m/s, rad/s, N m]
    """

    x: Any
    y: Any
    z: Any
    attitude: tuple[Any, ...]
    joints: tuple[Any, ...]
    velocity: tuple[Any, ...]
    omega: tuple[Any, ...]
    joint_speeds: tuple[Any, ...]
    spins: tuple[Any, ...]
    drives: tuple[Any, ...]


class DynamicTotals(NamedTuple):
    """Quadratures: rotation angles of the wheels [rad], work of the drives and loss of energy [J].

    The sum of kinetic, potential and contact energy is constant if ``work`` is subtracted and
    ``lost`` is added.
    """

    wheels: tuple[Any, ...]
    work: Any
    lost: Any


class DynamicOutputs(NamedTuple):
    """Outputs of a dynamic model; positions are map coordinates."""

    heading: Any
    roll: Any
    pitch: Any
    heading_rate: Any
    roll_rate: Any
    pitch_rate: Any
    contact_x: tuple[Any, ...]
    contact_y: tuple[Any, ...]
    common: Outputs
    normal: tuple[Any, ...]
    slip_ratio: tuple[Any, ...]
    kinetic_energy: Any
    contact_energy: Any


@computing
def dynamics(
    vehicle: Vehicle,
    terrain: Terrain,
    *,
    law: Compliant = Compliant(),  # noqa: B008 - a frozen record
) -> Dae:
    """Return the dynamic model of a vehicle on a ground.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle, with mass. Wheels may leave the ground.
    terrain : Terrain
        The ground, with friction. A motion ends where a contact leaves its domain.
    law : Compliant
        Wheel-ground law.

    Returns
    -------
    Dae
        Inputs are those of the drives: the rate of a wheel with a `Rate` or `Motor`, the torque on
        a wheel with a `Torque`; and the rates of the commanded coordinates.

    Raises
    ------
    ModelError
        If the vehicle has no mass, a wheel whose rate is not prescribed has no inertia, or the
        ground has no coefficient of friction.

    Notes
    -----
    A prescribed rate is reached with a time constant of 1 ms. Settle the model for a start at
    rest: ``settle(model, x=..., y=..., heading=...)``.

    Examples
    --------
    A vehicle accelerates from rest on level ground.

    >>> import numpy as np
    >>> from slipfree import Analytic, catalog, dynamics, settle, simulate
    >>> model = dynamics(catalog.rigid_skid_steer(), Analytic(lambda x, y: 0 * x, mu=0.8))
    >>> inputs = {label.full: 4.0 for label in model.labels.u.wheels}
    >>> run = simulate(model, settle(model), model.inputs(**inputs), np.linspace(0, 1, 11))
    >>> print(run.stop)
    None
    """
    _check(vehicle, terrain)
    vehicle = _with_depths(vehicle)
    labels = _labels(vehicle)
    x, u, lookups = symbols(labels.x), symbols(labels.u), LookupTable()
    body = _multibody(vehicle, x)
    touches = _touches(vehicle, terrain, body, lookups)
    contacts = [
        _contact(vehicle, law, wheel, each)
        for wheel, each in zip(body.wheels, touches, strict=True)
    ]
    motion = _motion(vehicle, x, u, body, contacts)
    q = _quantities(vehicle, terrain, x, u, body, contacts, lookups)
    energy = sum((each.force.energy for each in contacts), ca.SX(0))
    wheel_work = [each * w.rate for each, w in zip(motion.torques, body.wheels, strict=True)]
    commanded = [k for k, c in enumerate(vehicle.coordinates) if c.kind == "commanded"]
    joint_work = [motion.efforts[n] * x.joint_speeds[k] for n, k in enumerate(commanded)]
    work = ca.SX(sum((*wheel_work, *joint_work)))
    lost = q.mechanics.damped + sum(_lost(law_force) for law_force in contacts)
    (scale, shift), size = sizes(vehicle, terrain, labels), extent(vehicle)
    wheels = touch_function(
        x,
        (),
        [
            pose._replace(origin=pose.origin - each.touch.gap * each.touch.frame.normal)
            for pose, each in zip(q.poses, contacts, strict=True)
        ],
        q.contacts,
        lookups,
    )
    return Dae(
        ca.SX.sym("t"),
        x,
        (),
        symbols(labels.q),
        u,
        ode=motion.ode,
        alg=(),
        quad=ca.vertcat(*(wheel.rate for wheel in body.wheels), work, lost),
        y=_outputs(q, body, contacts, motion, work, lost, energy),
        labels=labels,
        limits=limits_of(q._replace(contacts=_in_contact(contacts)), static=False),
        checks=tuple(
            SecondContact(terrain, wheel, pose, size)
            for wheel, pose in zip(vehicle.wheels, wheels, strict=True)
        ),
        guess=ca.SX(0, 1),
        scale=scale,
        shift=shift,
        size=size,
        standing=None if support_fault(vehicle) else _standing(vehicle, terrain, labels),
        lookups=lookups.lookups,
    )


def _check(vehicle: Vehicle, terrain: Terrain) -> None:
    """Raise ModelError if a vehicle or a ground does not suit dynamics."""
    if not vehicle.mass:
        raise ModelError(
            f"dynamics: expected a vehicle with mass, found none in {vehicle.name!r}; give its "
            "platform and its wheels a mass"
        )
    if not terrain.has_friction:
        raise ModelError(
            "dynamics: expected a ground with a coefficient of friction, found none; set the "
            "ground's mu, or terrain.friction in a problem file"
        )
    for wheel in vehicle.wheels:
        if not (wheel.mass or wheel.inertia or _has_rate(wheel)):
            raise ModelError(
                f"dynamics: expected a mass of wheel {wheel.name}, whose rate is not prescribed, "
                "found none; give it a mass"
            )


def _has_rate(wheel: Any) -> bool:
    return wheel.driven and isinstance(wheel.drive, Rate)


def _with_depths(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle whose wheels have static depths."""
    exact = has_exact_closure(vehicle)
    wheels = (
        replace(wheel, static_depth=wheel.radius * EXACT_DEPTH)
        if exact and wheel.static_depth is None
        else replace(wheel, static_depth=wheel.depth)
        for wheel in vehicle.wheels
    )
    return replace(vehicle, wheels=tuple(wheels))


def _labels(vehicle: Vehicle) -> Labels:
    """Return the labels of the model."""
    still = labels_of(vehicle, follow=False)
    position, kinds = still.z.position, {c.name: c for c in vehicle.coordinates}
    joints = {label.name: label for label in (*still.x.joints, *position.suspension)}
    inputs = []
    for wheel in vehicle.wheels:
        if wheel.driven:
            name, unit, words = wheel.drive.input
            inputs.append(
                Label(
                    f"{wheel.name}_{name}", unit, f"{words} of wheel {wheel.name}, forward positive"
                )
            )
    x = DynamicState(
        still.x.x,
        still.x.y,
        position.z,
        tuple(
            Label(f"attitude_{k}", "1", f"{k} of the platform's quaternion (x right)")
            for k in "wxyz"
        ),
        tuple(joints[name] for name in kinds),
        _vector("velocity", "m s-1", "velocity of the platform's centre"),
        _vector("omega", "rad s-1", "angular velocity of the platform"),
        tuple(_joint_speed(vehicle, c) for c in vehicle.coordinates),
        wheel_labels(
            vehicle,
            "spin",
            "rad s-1",
            "rate of the wheel, relative to its carrier where the rate is an input, otherwise to "
            "fixed axes",
        ),
        tuple(
            Label("motor_integral", "N m", "integral of the speed controller", wheel.name)
            for wheel in vehicle.wheels
            if wheel.driven and isinstance(wheel.drive, Motor)
        ),
    )
    q = DynamicTotals(
        still.q.wheels,
        still.q.work[0],
        Label("lost_energy", "J", "energy lost in contacts and dampers"),
    )
    y = DynamicOutputs(
        still.x.heading,
        position.roll,
        position.pitch,
        still.z.rates.heading,
        still.z.rates.roll,
        still.z.rates.pitch,
        tuple(each.x for each in position.contacts),
        tuple(each.y for each in position.contacts),
        still.y._replace(
            depth=wheel_labels(
                vehicle, "depth", "m", "depth below the ground; negative in the air"
            ),
            load_share=wheel_labels(
                vehicle, "load_share", "1", "normal force times number of wheels over the weight"
            ),
        ),
        wheel_labels(vehicle, *NORMAL),
        wheel_labels(
            vehicle, "slip_ratio", "1", "excess of the rim's speed over the wheel's, relative"
        ),
        Label("kinetic_energy", "J", "kinetic energy"),
        Label("contact_energy", "J", "elastic energy of the contacts"),
    )
    u = Inputs(tuple(inputs), still.u.joints)
    return Labels(x, (), q, u, y, ())


def _joint_speed(vehicle: Vehicle, c: Coordinate) -> Label:
    """Return the label of the rate of a coordinate; that of an input has the usual name."""
    name, words = ("speed", "actual rate") if c.kind == "commanded" else ("rate", "rate")
    return Label(f"{c.name}_{name}", f"{vehicle.unit(c.name)} s-1", f"{words} of {c.words}")


def _vector(name: str, unit: str, words: str) -> tuple[Label, ...]:
    return tuple(
        Label(f"{name}_{axis}", unit, f"{axis} component of the {words}") for axis in "xyz"
    )


def _multibody(vehicle: Vehicle, x: DynamicState) -> Multibody:
    platform = Pose(rotation_of(ca.vertcat(*x.attitude)), ca.vertcat(x.x, x.y, x.z))
    speeds = Speeds(
        ca.vertcat(*x.velocity),
        ca.vertcat(*x.omega),
        ca.vertcat(ca.SX(0, 1), *x.joint_speeds),
        x.spins,
    )
    names = [c.name for c in vehicle.coordinates]
    coordinates = dict(zip(names, x.joints, strict=True))
    prescribed = [_has_rate(wheel) for wheel in vehicle.wheels]
    return multibody(vehicle, platform, coordinates, speeds, prescribed)


def _touches(
    vehicle: Vehicle, terrain: Terrain, body: Multibody, lookups: LookupTable
) -> list[Touch]:
    """Return the contacts of the wheels; wheels with equal sections share a search."""
    searches = {
        wheel.section: search_function(terrain, wheel.section, wheel.radius)
        for wheel in vehicle.wheels
    }
    return [
        touch(terrain, each.wheel, each.motion.pose, searches[each.wheel.section], lookups)
        for each in body.wheels
    ]


class _Contact(NamedTuple):
    """Contact of a wheel, its slip velocity, and the force of the ground on it."""

    touch: Touch
    slip: ca.SX
    force: GroundForce

    @property
    def total(self) -> ca.SX:
        """Force of the ground on the wheel, shape (3, 1) [N]."""
        return self.force.normal * self.touch.frame.normal + self.force.tangential


def _contact(vehicle: Vehicle, law: Compliant, wheel: Any, at: Touch) -> _Contact:
    motion, share = wheel.motion, vehicle.weight / len(vehicle.wheels)
    omega = motion.omega - wheel.rate * wheel.axle
    slip = motion.velocity + ca.cross(omega, at.frame.point - motion.pose.origin)
    if wheel.wheel.rollers:
        slip -= at.frame.across * ca.dot(at.frame.across, slip)
    return _Contact(at, slip, law.force(at, slip, share, wheel.wheel.depth))


class _Motion(NamedTuple):
    """Rates of the states, torques of all wheels' drives, and efforts of commanded joints."""

    ode: ca.SX
    torques: tuple[ca.SX, ...]
    efforts: tuple[ca.SX, ...]


def _motion(
    vehicle: Vehicle, x: DynamicState, u: Inputs, body: Multibody, contacts: list[_Contact]
) -> _Motion:
    """Return the equations of motion."""
    inputs, integrals = iter(u.wheels), iter(x.drives)
    loads, drives = list[Load](), list[_Drive]()
    for wheel, contact in zip(body.wheels, contacts, strict=True):
        drive = _drive(wheel, inputs, integrals)
        center, part = wheel.motion.pose.origin, wheel.wheel.parent
        moment = ca.cross(contact.touch.frame.point - center, contact.total)
        about = ca.dot(wheel.axle, moment)
        carried = (
            wheel.axial * drive.acceleration if wheel.prescribed else drive.torque - about
        ) * wheel.axle
        arm = ca.cross(center - body.origin, contact.total)
        loads.append(Load(part, contact.total, arm + moment + carried))
        drives.append(drive._replace(resisting=about))
    forces = generalised_forces(body, loads) - bias_forces(body)
    fixed, given = list[int](), list[ca.SX]()
    commands = iter(u.joints)
    for k, (c, value, rate) in enumerate(
        zip(vehicle.coordinates, x.joints, x.joint_speeds, strict=True)
    ):
        if c.kind == "commanded":
            fixed.append(6 + k)
            given.append((next(commands) - rate) / LAG)
        elif c.is_loaded:
            forces[6 + k] -= ca.gradient(c.potential(value), value) + c.damping * rate
    matrix = mass_matrix(body)
    free = [k for k in range(matrix.shape[0]) if k not in fixed]
    accelerations = ca.SX.zeros(matrix.shape[0])
    for k, each in zip(fixed, given, strict=True):
        accelerations[k] = each
    right = forces[free] - matrix[free, fixed] @ accelerations[fixed]
    accelerations[free] = ca.ldl_solve(right, *ca.ldl(matrix[free, free]))
    efforts = matrix[fixed, :] @ accelerations - forces[fixed]
    spins, torques, integral_rates = list[ca.SX](), list[ca.SX](), list[ca.SX]()
    for wheel, drive in zip(body.wheels, drives, strict=True):
        if wheel.prescribed:
            alpha = angular_acceleration(body, wheel.wheel.parent, accelerations)
            spin_rate = drive.acceleration - ca.dot(alpha, wheel.axle)
            spins.append(drive.acceleration)
            torques.append(wheel.axial * spin_rate + drive.resisting)
        else:
            spins.append((drive.torque - drive.resisting) / (wheel.axial + drive.rotor))
            torques.append(drive.torque)
        integral_rates.extend(drive.integral_rate)
    attitude = ca.vertcat(*x.attitude)
    ode = ca.vertcat(
        *x.velocity,
        _attitude_rate(attitude, ca.vertcat(*x.omega)),
        *x.joint_speeds,
        accelerations,
        *spins,
        *integral_rates,
    )
    return _Motion(ode, tuple(torques), tuple(ca.vertsplit(efforts)) if fixed else ())


class _Drive(NamedTuple):
    """Action of a drive: torque, or acceleration of a prescribed rate, and a controller's state.

    ``resisting`` is the moment of the ground about the axle.
    """

    torque: ca.SX
    acceleration: ca.SX = ca.SX(0)
    rotor: float = 0.0
    integral_rate: tuple[ca.SX, ...] = ()
    resisting: ca.SX = ca.SX(0)


def _drive(wheel: Any, inputs: Any, integrals: Any) -> _Drive:
    """Return the action of the drive of a wheel; inputs and integrals are in wheel order."""
    if not wheel.wheel.driven:
        return _Drive(ca.SX(0))
    drive: Drive = wheel.wheel.drive
    if isinstance(drive, Torque):
        return _Drive(next(inputs))
    if isinstance(drive, Motor):
        error, integral = next(inputs) - wheel.rate, next(integrals)
        wanted = drive.kp * error + integral
        speed = wheel.rate / drive.no_load
        most, least = (drive.stall * ca.fmin(1, 1 - sign * speed) for sign in (1, -1))
        torque = ca.fmax(-least, ca.fmin(most, wanted))
        rate = drive.ki * (error - (wanted - torque) / drive.kp)
        return _Drive(torque, rotor=drive.rotor_inertia, integral_rate=(rate,))
    return _Drive(ca.SX(0), (next(inputs) - wheel.speed) / LAG)


def _attitude_rate(attitude: ca.SX, omega: ca.SX) -> ca.SX:
    """Return the rate of a quaternion (w, x, y, z), with a return of its norm to one [1/s]."""
    scalar, vector = attitude[0], attitude[1:]
    turning = ca.vertcat(-ca.dot(omega, vector), scalar * omega + ca.cross(omega, vector)) / 2
    return turning + NORMALISATION * (1 - ca.sumsqr(attitude)) * attitude


def _quantities(
    vehicle: Vehicle,
    terrain: Terrain,
    x: DynamicState,
    u: Inputs,
    body: Multibody,
    contacts: list[_Contact],
    lookups: LookupTable,
) -> Quantities:
    """Return the quantities from which limits and outputs are computed."""
    r = body.parts["platform"].pose.rotation
    kinds = list(zip(vehicle.coordinates, x.joints, x.joint_speeds, strict=True))
    place = Configuration(
        x.x,
        x.y,
        ca.atan2(r[1, 0], r[0, 0]),
        tuple(value for c, value, _ in kinds if c.kind != "suspension"),
    )
    position = Dependent(
        x.z,
        ca.asin(ca.fmax(-1, ca.fmin(1, -r[2, 0]))),
        ca.atan2(r[2, 1], r[2, 2]),
        tuple(value for c, value, _ in kinds if c.kind == "suspension"),
        (),
    )
    frames = tuple(each.touch.frame for each in contacts)
    height = sum(each.mass * each.motion.pose.origin[2] for each in body.bodies)
    springs = sum(c.potential(value) for c, value, _ in kinds if c.is_loaded)
    damped = sum(c.damping * rate**2 for c, _, rate in kinds if c.kind != "commanded")
    forces = [
        tuple(
            ca.dot(axis, each.force.tangential) for axis, each in zip(axes, contacts, strict=True)
        )
        for axes in ([f.along for f in frames], [f.across for f in frames])
    ]
    none = ca.SX(0, 0)
    return Quantities(
        vehicle,
        terrain,
        place,
        position,
        _rates(vehicle, x, place, position.roll),
        Forces(forces[0], forces[1], tuple(each.force.normal for each in contacts)),
        u,
        tuple(wheel.motion.pose for wheel in body.wheels),
        frames,
        tuple(each.slip for each in contacts),
        tuple(wheel.rate for wheel in body.wheels),
        Mechanics(
            none,
            none,
            none,
            none,
            tuple(each.touch.friction for each in contacts),
            vehicle.weight,
            ca.SX(GRAVITY * height + springs),
            ca.SX(damped),
        ),
        tip_over_margin(vehicle, place, position, frames),
        lookups,
    )


def _rates(vehicle: Vehicle, x: DynamicState, place: Configuration, roll: ca.SX) -> Rates:
    """Return the rates of the coordinates of kinematic models."""
    across, along = ca.cos(place.heading), ca.sin(place.heading)
    omega_x, omega_y, omega_z = x.omega
    pitch_rate = (across * omega_x + along * omega_y) / ca.cos(roll)
    kinds = list(zip(vehicle.coordinates, x.joint_speeds, strict=True))
    return Rates(
        x.velocity[0],
        x.velocity[1],
        x.velocity[2],
        omega_z + ca.sin(roll) * pitch_rate,
        across * omega_y - along * omega_x,
        pitch_rate,
        tuple(rate for c, rate in kinds if c.kind == "suspension"),
        tuple(rate for c, rate in kinds if c.kind == "passive"),
        (),
        (),
    )


def _in_contact(contacts: list[_Contact]) -> tuple[ContactFrame, ...]:
    """Return contact frames for limits, which do not apply to wheels in the air."""
    frames = list[ContactFrame]()
    for each in contacts:
        frame, on_ground = each.touch.frame, each.touch.gap < 0
        upright = ca.if_else(on_ground, frame.uprightness, 1)
        hessian = ca.if_else(on_ground, frame.hessian, ca.SX.zeros(2, 2))
        frames.append(frame._replace(uprightness=upright, hessian=hessian))
    return tuple(frames)


def _lost(contact: _Contact) -> ca.SX:
    """Return the power that a contact dissipates [W]."""
    elastic = ca.if_else(contact.force.energy > 0, 2 * contact.force.energy / -contact.touch.gap, 0)
    away = ca.dot(contact.touch.frame.normal, contact.slip)
    return -ca.dot(contact.total, contact.slip) + elastic * away


def _outputs(
    q: Quantities,
    body: Multibody,
    contacts: list[_Contact],
    motion: _Motion,
    work: ca.SX,
    lost: ca.SX,
    energy: ca.SX,
) -> DynamicOutputs:
    """Return the outputs of the model."""
    o_x, o_y, _ = q.terrain.origin
    along, across, normal, _ = q.forces
    needed = [
        ca.if_else(n > 0, ca.sqrt(a**2 + c**2) / ca.fmax(n, 1e-12), 0)
        for a, c, n in zip(along, across, normal, strict=True)
    ]
    forces = ForceOutputs(
        along,
        across,
        tuple(needed),
        tuple(each / mu for each, mu in zip(needed, q.mechanics.friction, strict=True)),
        motion.torques,
        motion.efforts,
        work,
        lost,
        q.mechanics.potential,
        q.tip_over_margin,
    )
    rims = [wheel.rate * wheel.wheel.radius for wheel in body.wheels]
    slips = [ca.dot(each.touch.frame.along, each.slip) for each in contacts]
    ratios = [
        -slip / ca.fmax(ca.fmax(ca.fabs(rim), ca.fabs(rim + slip)), 1e-6)
        for slip, rim in zip(slips, rims, strict=True)
    ]
    return DynamicOutputs(
        q.x.heading,
        q.position.roll,
        q.position.pitch,
        q.rates.heading,
        q.rates.roll,
        q.rates.pitch,
        tuple(each.point[0] + o_x for each in q.contacts),
        tuple(each.point[1] + o_y for each in q.contacts),
        outputs(q, forces)._replace(
            depth=tuple(-each.touch.gap for each in contacts),
            load_share=tuple(each * len(normal) / q.vehicle.weight for each in normal),
        ),
        normal,
        tuple(ratios),
        kinetic_energy(body),
        energy,
    )


def _standing(vehicle: Vehicle, terrain: Terrain, labels: Labels) -> Standing:
    """Return the model of the vehicle at rest, and the states of the dynamic model there."""
    model = pressed_dae(vehicle, terrain, LeastSlip(), STANDING_SMOOTHING)
    still: Any = model.x
    values = {
        label.name: value
        for label, value in zip(leaves(model.labels.x), leaves(model.x), strict=True)
    }
    base = platform(still.x, still.y, still.z, still.heading, still.roll, still.pitch)
    x, y, z, w = ca.vertsplit(quaternion(base.rotation))
    joints = [values[c.name] for c in vehicle.coordinates]
    count, speed = len(joints), ca.SX.sym("speed")
    rolling = [speed / wheel.radius for wheel in vehicle.wheels]
    motors = ca.SX.zeros(len(labels.x.drives))
    exact = has_exact_closure(vehicle)
    guess = replace(direct_kinematics(vehicle, terrain), limits=(), checks=()) if exact else None
    return Standing(
        model,
        guess,
        speed,
        ca.vertcat(
            *(still.x, still.y, still.z, w, x, y, z, *joints),
            speed * base.rotation[:, 1],
            ca.SX.zeros(3 + count),
            *rolling,
            motors,
        ),
    )
