"""Dynamics: motion of a vehicle at any speed, with inertia and compliant contact.

The model is an explicit ODE. Contact points are found by lookups (`slipfree.contact.touch`), and
the accelerations by an LDL factorisation of the mass matrix in the expression graph. The spin of a
wheel has its own equation: with the spin ``sigma`` relative to fixed axes, the axle ``a``, the
drive's torque ``tau`` and the ground force ``F`` on the point ``P``,
``I_a sigma' = tau - a . ((P - C) x F)``. The carrier bears the rest of the moment.

A prescribed rate of a wheel or a joint is a state with a prescribed acceleration
``(u - rate) / LAG`` (hybrid dynamics); the torque that it needs is an output. Other drives exert an
effort on a wheel or a coordinate that is free.

Bodies touch the ground at points of their shapes. The corners of a box and the middles of its edges
and faces, the points of a hull and the lowest point of a ball may press into the ground, with the
normal force and the friction of the law. Ground that rises between these points is not felt; the
clearance of the body then is negative.

The gap of a point is its height above the ground below it times the vertical component of the
ground's normal there: the distance on a plane, and in general up to a relative error of the order
of gap times curvature. For the centre of a ball the error is of the order of
curvature times squared radius times squared slope.

The normal force acts along the gradient of the gap, which differs from the ground's normal by as
much: its work is the change of the elastic energy. A force along the normal would gain or lose
energy where a point slides over curved ground.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Generic, NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.certify import SecondContact, second_contacts
from slipfree.contact.closure import ContactFrame, has_exact_closure, support_fault, without_rolling
from slipfree.contact.nearest_points import frame_of
from slipfree.contact.touch import Touch, plane_of, search_function, solid_touch, touch, tube_radii
from slipfree.core.arguments import checked
from slipfree.core.dae import Dae, HeldTerms, Labels, Limit, Standing
from slipfree.core.errors import ModelError
from slipfree.core.lookups import LookupTable
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Label, T, leaves, pack, symbols, unpack
from slipfree.geometry.frame import (
    FIXED,
    Pose,
    platform,
    quaternion,
    rotation_of,
    translation,
    turn,
)
from slipfree.laws.compliant import Compliant
from slipfree.laws.least_slip import LeastSlip
from slipfree.laws.protocols import (
    BodyLaw,
    BodyTouch,
    ContactLaw,
    GroundForce,
    WheelContact,
    quantity_labels,
    wheel_labels,
    wheel_limits,
)
from slipfree.models import base
from slipfree.models.kinematics import exact_dae, pressed_dae
from slipfree.models.limits import limits_of, tip_over_margin
from slipfree.models.multibody import (
    Load,
    Multibody,
    Speeds,
    WheelMotion,
    angular_acceleration,
    bias_forces,
    generalised_forces,
    kinetic_energy,
    mass_matrix,
    multibody,
)
from slipfree.system.forks import computing
from slipfree.terrain.base import Terrain
from slipfree.terrain.solids import Prism, Solids
from slipfree.vehicle.shapes import Ball, BodyShape, Box, Hull
from slipfree.vehicle.tree import Vehicle

MAX_POINTS = 200  # each adds a lookup of the ground


class BodyContact(NamedTuple):
    """Contact of a point of a body: arm from the part's origin [m], and elastic energy [J]."""

    part: str
    touch: BodyTouch
    arm: ca.SX
    force: GroundForce
    energy: ca.SX

    @property
    def load(self) -> Load:
        """Force of the ground on the part, and its moment about the part's origin."""
        force = self.force.normal * self.touch.normal + self.force.tangential
        return Load(self.part, force, ca.cross(self.arm, force))

    @property
    def dissipation(self) -> ca.SX:
        """Power that the contact dissipates [W]."""
        away = ca.dot(self.touch.normal, self.touch.slip)
        return self.force.elastic * away - ca.dot(self.load.force, self.touch.slip)


def body_contacts(
    vehicle: Vehicle, terrain: Terrain, law: ContactLaw, body: Multibody, lookups: LookupTable
) -> tuple[BodyContact, ...]:
    """Return the contacts of a vehicle's bodies; none if the law lets them end the motion."""
    if not (isinstance(law, BodyLaw) and law.bears_bodies):
        return ()
    points = [(part, *each) for part, shape in vehicle.shapes for each in _points(shape)]
    if len(points) > MAX_POINTS:
        raise ModelError(
            f"dynamics: expected shapes with at most {MAX_POINTS} points, 26 of each box, found "
            f"{len(points)} in {vehicle.name!r}; simplify the shapes, or set 'body_depth' of the "
            "law to 0, with which the motion ends where a body touches the ground"
        )
    contacts = list[BodyContact]()
    for part, frame, radius in points:
        motion = body.parts[part].at(body.parts[part].pose @ frame)
        x, y, z = ca.vertsplit(motion.pose.origin)
        height, gradient, hessian = terrain.jet(x, y, lookups)
        upright = 1 / ca.sqrt(1 + ca.sumsqr(gradient))
        gap = (z - height) * upright - radius
        turning = (z - height) * upright**2 * hessian @ gradient
        slope = upright * ca.vertcat(-gradient - turning, 1)  # gradient of the gap
        steepness = ca.norm_2(slope)
        normal = slope / steepness
        place = motion.pose.origin - radius * normal
        slip = motion.at(Pose(motion.pose.rotation, place)).velocity
        friction = terrain.friction(x, y, lookups)
        # force k d |slope| along the gradient of the elastic energy k d^2 / 2
        weight = steepness * vehicle.weight
        touch = BodyTouch(gap, normal, slip, friction, weight, vehicle.gravity)
        force = law.body_force(touch)
        energy = force.elastic / steepness * ca.fmax(-gap, 0) / 2
        arm = place - body.parts[part].pose.origin
        contacts.append(BodyContact(part, touch, arm, force, energy))
    return tuple(contacts)


def _points(shape: BodyShape) -> Sequence[tuple[Pose, float]]:
    """Return the poses of the points of a shape in its part, and the radius about them [m]."""
    frame = frame_of(shape, FIXED)
    if isinstance(shape, Ball):
        return [(frame, shape.radius)]
    points: Iterable[Sequence[float]] = shape.points if isinstance(shape, Hull) else []
    if isinstance(shape, Box):
        half = np.array(shape.size) / 2
        points = [(half * signs).tolist() for signs in product((-1, 0, 1), repeat=3) if any(signs)]
    return [(frame @ translation(*point), 0.0) for point in points]


class DynamicState(NamedTuple, Generic[T]):
    """Differential states: pose and speeds of platform, joints and wheels.

    ``attitude`` is the unit quaternion (w, x, y, z) of the platform. A planar vehicle has no ``x``,
    its ``attitude`` is the pitch angle, ``velocity`` has the components y and z, and ``omega`` the
    component x. ``joints`` are all coordinates, ``joint_speeds`` their rates, and ``spins`` the
    speeds of the wheels
    (`slipfree.models.multibody.WheelMotion`). ``drives`` and ``joint_drives`` are the
    integrals of the speed controllers of wheels and of commanded coordinates.
    [m, rad, m/s, rad/s, N m, N]
    """

    x: T
    y: T
    z: T
    attitude: tuple[T, ...]
    joints: tuple[T, ...]
    velocity: tuple[T, ...]
    omega: tuple[T, ...]
    joint_speeds: tuple[T, ...]
    spins: tuple[T, ...]
    drives: tuple[T, ...]
    joint_drives: tuple[T, ...]


class OnSolid(NamedTuple, Generic[T]):
    """Contacts of all wheels with one solid, or with the ground below the solids.

    Gap [m], normal force, friction force along the direction of travel [N], and slip velocity along
    it [m/s].
    """

    gap: tuple[T, ...]
    load: tuple[T, ...]
    friction: tuple[T, ...]
    slip: tuple[T, ...]


class DynamicOutputs(NamedTuple, Generic[T]):
    """Outputs of a dynamic model; positions are map coordinates.

    ``x`` is empty if it is a state, and ``pitch`` if it is a state, that is, for planar vehicles.
    ``body_load`` is empty if bodies do not bear load.
    """

    x: T
    heading: T
    roll: T
    pitch: T
    heading_rate: T
    roll_rate: T
    pitch_rate: T
    contact_x: tuple[T, ...]
    contact_y: tuple[T, ...]
    common: base.Outputs[T]
    kinetic_energy: T
    contact_energy: T
    body_load: tuple[T, ...]
    solids: tuple[OnSolid[T], ...]


DynamicDae = Dae[DynamicState[ca.SX], tuple[()], base.Inputs[ca.SX], DynamicOutputs[ca.SX]]


def dynamic_labels(vehicle: Vehicle, solids: int = 0, *, bears: bool = False) -> Labels:
    """Return the labels of the dynamic model of a vehicle with mass, for a number of solids.

    ``bears`` is whether bodies bear load.
    """
    still = base.labels_of(vehicle, follow=False)
    q = still.q._replace(lost=(quantity_label("lost_energy"),))
    joints = zip(vehicle.of("commanded"), still.u.joints, strict=True)
    wheels = list[Label]()
    for wheel in vehicle.wheels:
        name, words = wheel.name, f"wheel {wheel.name}, positive forward"
        if wheel.driven and wheel.drive.takes_effort:
            wheels.append(Label(f"{name}_torque", "N m", f"torque on {words}"))
        elif wheel.driven:
            wheels.append(Label(f"{name}_rate", "rad s-1", f"rate of {words}"))
    u = base.Inputs(
        tuple(wheels),
        tuple(
            base.effort_label(vehicle, c) if c.drive.takes_effort else rate for c, rate in joints
        ),
    )
    along, on_solids = "along the direction of travel", list[OnSolid]()
    for k in range(solids + 1 if solids else 0):
        name = f"solid {k}" if k else "the ground"
        rows = (
            ("gap", "m", f"gap between the wheel and {name}"),
            ("load", "N", f"normal force of {name} on the wheel"),
            ("friction", "N", f"friction of {name} on the wheel {along}"),
            ("slip", "m s-1", f"slip of the wheel on {name} {along}"),
        )
        each = (wheel_labels(vehicle, f"solid_{q}_{k}", *others) for q, *others in rows)
        on_solids.append(OnSolid(*each))
    position, rates = still.z.position, still.z.rates
    forces: Any = still.y.forces
    forces = forces._replace(joint_effort=output_efforts(vehicle, forces.joint_effort))
    y = _outputs(
        vehicle,
        (still.x, position, rates),
        position.contacts,
        still.y._replace(
            forces=forces,
            **base.pressed_labels(vehicle),
            slip_ratio=quantity_labels(vehicle, "slip_ratio"),
        ),
        quantity_label("kinetic_energy"),
        quantity_label("contact_energy"),
        (quantity_label("body_load"),) if bears else (),
        tuple(on_solids),
    )
    return Labels(_state_labels(vehicle, still), (), q, u, y, ())


def _outputs(
    vehicle: Vehicle,
    motion: tuple[base.Configuration, base.Dependent, base.Rates],
    contacts: Sequence[Sequence[Any]],
    *others: Any,
) -> DynamicOutputs:
    """Return the outputs, or their labels, from those of kinematic models and contact points."""
    x, position, rates = motion
    angles = x.heading, position.roll, () if vehicle.planar else position.pitch
    turning = rates.heading, rates.roll, rates.pitch
    places: Any = zip(*contacts, strict=True)
    return DynamicOutputs(x.x if vehicle.planar else (), *angles, *turning, *places, *others)


def _integral(name: str, unit: str) -> Label:
    return Label(f"{name}_motor_integral", unit, f"integral of the controller of {name}")


def _state_labels(vehicle: Vehicle, still: Labels) -> DynamicState:
    """Return the labels of the states, from those of a model without inertia."""
    joints = {label.name: label for label in (*still.x.joints, *still.z.position.suspension)}
    words = "{} of the platform's quaternion (x right)"
    attitude = tuple(Label(f"attitude_{k}", "1", words.format(k)) for k in "wxyz")
    turning = "angular velocity of the platform about"
    omega = tuple(Label(f"omega_{axis}", "rad s-1", f"{turning} {axis}") for axis in "xyz")
    velocity, planar = tuple(still.z.rates[:3]), vehicle.planar
    speeds = list[Label]()
    for c in vehicle.coordinates:
        name, rate = ("speed", "actual rate") if c.kind == "commanded" else ("rate", "rate")
        unit = f"{vehicle.unit(c.name)} s-1"
        speeds.append(Label(f"{c.name}_{name}", unit, f"{rate} of {c.words}"))
    return DynamicState(
        () if planar else still.x.x,
        still.x.y,
        still.z.position.z,
        (still.z.position.pitch,) if planar else attitude,
        tuple(joints[c.name] for c in vehicle.coordinates),
        velocity[1:] if planar else velocity,
        omega[:1] if planar else omega,
        tuple(speeds),
        quantity_labels(vehicle, "spin"),
        tuple(
            _integral(each.name, "N m") for each in vehicle.wheels if each.acting_drive.has_integral
        ),
        tuple(
            _integral(c.name, base.effort_label(vehicle, c).unit)
            for c in vehicle.coordinates
            if c.acting_drive.has_integral
        ),
    )


def in_space(vehicle: Vehicle, x: DynamicState) -> DynamicState:
    """Return the states of a vehicle with those that a planar vehicle lacks, which are zero."""
    if not vehicle.planar:
        return x
    zero = ca.SX(0)
    return x._replace(x=zero, velocity=(zero, *x.velocity), omega=(*x.omega, zero, zero))


def output_efforts(vehicle: Vehicle, efforts: Sequence[T]) -> tuple[T, ...]:
    """Return the efforts of those commanded coordinates whose efforts are outputs, not inputs."""
    pairs = zip(vehicle.of("commanded"), efforts, strict=True)
    return tuple(effort for c, effort in pairs if not c.drive.takes_effort)


class Contact(NamedTuple):
    """Contact of a wheel, and the force of the ground on it.

    ``slip`` is the velocity of the wheel's material point at the contact [m/s], ``spin`` the
    angular velocity about the axle relative to fixed axes, positive forward [rad/s].
    """

    touch: Touch
    slip: ca.SX
    spin: ca.SX
    force: GroundForce

    @property
    def total(self) -> ca.SX:
        """Force of the ground on the wheel, shape (3, 1) [N]."""
        return self.force.normal * self.touch.frame.normal + self.force.tangential

    def moment(self, center: ca.SX) -> ca.SX:
        """Return the moment of the ground on the wheel about a point, shape (3, 1) [N m]."""
        arm = self.touch.frame.point - center
        return ca.cross(arm, self.total) + self.force.moment * self.touch.frame.axle

    @property
    def energy(self) -> ca.SX:
        """Elastic energy of the contact [J]."""
        return self.force.elastic * ca.fmax(-self.touch.gap, 0) / 2

    @property
    def dissipation(self) -> ca.SX:
        """Power that the contact dissipates [W]."""
        away = ca.dot(self.touch.frame.normal, self.slip)
        braking = self.force.moment * self.spin
        return self.force.elastic * away - ca.dot(self.total, self.slip) + braking


def deepest(contacts: Sequence[Contact]) -> Contact:
    """Return the contact of a wheel that has the smallest gap."""
    nearest, *others = contacts
    for other in others:
        pairs = zip(leaves(nearest), leaves(other), strict=True)
        nearer = other.touch.gap < nearest.touch.gap
        nearest = unpack(nearest, [ca.if_else(nearer, new, old) for old, new in pairs])
    return nearest


class MovingVehicle(NamedTuple):
    """A vehicle on a ground as moving rigid bodies, in the symbols of a dynamic model."""

    vehicle: Vehicle
    terrain: Terrain
    lookups: LookupTable
    x: DynamicState
    u: base.Inputs
    body: Multibody


class Contacts(NamedTuple):
    """Contacts of each wheel with the ground and with solids, and contacts of points of bodies."""

    wheels: Sequence[tuple[Contact, ...]]
    bodies: Sequence[BodyContact] = ()

    @property
    def all(self) -> tuple[Contact | BodyContact, ...]:
        """All contacts, those of the wheels first."""
        return *(each for touching in self.wheels for each in touching), *self.bodies


class Effort(NamedTuple):
    """Torques of the drives of all wheels [N m], and efforts of commanded coordinates [N m, N]."""

    torques: tuple[ca.SX, ...]
    actuators: tuple[ca.SX, ...]


def quantities(moving: MovingVehicle, contacts: Sequence[Contact]) -> base.Quantities:
    """Return the quantities from which limits and outputs are computed."""
    vehicle, terrain, lookups, x, u, body = moving
    x = in_space(vehicle, x)
    r = body.parts["platform"].pose.rotation
    values = [(c.kind, value) for c, value in zip(vehicle.coordinates, x.joints, strict=True)]
    place = base.Configuration(
        x.x,
        x.y,
        ca.atan2(r[1, 0], r[0, 0]),
        tuple(value for kind, value in values if kind != "suspension"),
    )
    position = base.Dependent(
        x.z,
        ca.asin(ca.fmax(-1, ca.fmin(1, -r[2, 0]))),
        ca.atan2(r[2, 1], r[2, 2]),
        tuple(value for kind, value in values if kind == "suspension"),
        (),
    )
    frames = tuple(each.touch.frame for each in contacts)
    along, across = base.tangential_components(frames, [each.force.tangential for each in contacts])
    height = sum(
        each.mass * body.parts[part].pose.origin[2] + each.first[2]
        for part, each in body.bodies.items()
    )
    loaded = [
        (c, value, rate)
        for c, value, rate in zip(vehicle.coordinates, x.joints, x.joint_speeds, strict=True)
        if c.is_loaded
    ]
    springs = sum(c.potential(value) for c, value, _ in loaded)
    damped = sum(c.damping * rate**2 for c, _, rate in loaded)
    none, friction = ca.SX(0, 0), tuple(each.touch.friction for each in contacts)
    energy = ca.SX(vehicle.gravity * height + springs)
    across_heading, along_heading = ca.cos(place.heading), ca.sin(place.heading)
    omega_x, omega_y, omega_z = x.omega
    pitch_rate = (across_heading * omega_x + along_heading * omega_y) / ca.cos(position.roll)
    kinds = list(zip(vehicle.coordinates, x.joint_speeds, strict=True))
    rates = base.Rates(
        x.velocity[0],
        x.velocity[1],
        x.velocity[2],
        omega_z + ca.sin(position.roll) * pitch_rate,
        across_heading * omega_y - along_heading * omega_x,
        pitch_rate,
        tuple(rate for c, rate in kinds if c.kind == "suspension"),
        tuple(rate for c, rate in kinds if c.kind == "passive"),
        (),
        (),
    )
    state = base.VehicleState(vehicle, terrain, lookups, place, position, rates, u)
    return base.Quantities(
        *state,
        base.Forces(along, across, tuple(each.force.normal for each in contacts)),
        tuple(wheel.motion.pose for wheel in body.wheels),
        frames,
        tuple(each.slip for each in contacts),
        tuple(wheel.rate for wheel in body.wheels),
        base.Mechanics(none, none, none, none, friction, vehicle.weight, energy, ca.SX(damped)),
        tip_over_margin(state, frames),
    )


def limit_quantities(q: base.Quantities, contacts: Sequence[Contact]) -> base.Quantities:
    """Return the quantities for limits: wheels in the air satisfy every limit on contacts."""
    frames = list[ContactFrame]()
    for each in contacts:
        frame, on_ground = each.touch.frame, each.touch.gap < 0
        upright = ca.if_else(on_ground, frame.uprightness, 1)
        hessian = ca.if_else(on_ground, frame.hessian, ca.SX.zeros(2, 2))
        frames.append(frame._replace(uprightness=upright, hessian=hessian))
    return q._replace(contacts=tuple(frames))


def dynamic_outputs(
    q: base.Quantities,
    body: Multibody,
    shown: Sequence[Contact],
    contacts: Contacts,
    forces: base.ForceOutputs,
) -> DynamicOutputs:
    """Return the outputs of the model; the slip of a wheel in the air is zero.

    ``shown`` is the contact of each wheel with the least gap.
    """
    o_x, o_y, _ = q.terrain.origin
    normal, wheels = q.forces.normal, contacts.wheels
    slips = tuple(ca.if_else(each.touch.gap < 0, each.slip, 0) for each in shown)
    q, solids = q._replace(slips=slips), list[OnSolid]()
    for touching in zip(*wheels, strict=True) if len(wheels[0]) > 1 else ():
        frames = [each.touch.frame for each in touching]
        vectors = [each.force.tangential for each in touching], [each.slip for each in touching]
        solids.append(
            OnSolid(
                tuple(each.touch.gap for each in touching),
                tuple(each.force.normal for each in touching),
                *(base.tangential_components(frames, each)[0] for each in vectors),
            )
        )
    return _outputs(
        q.vehicle,
        (q.x, q.position, q.rates),
        [(each.point[0] + o_x, each.point[1] + o_y) for each in q.contacts],
        base.outputs(q, forces)._replace(
            depth=tuple(-each.touch.gap for each in shown),
            load_share=tuple(each * len(normal) / q.vehicle.weight for each in normal),
            force_normal=normal,
            slip_ratio=base.slip_ratios(q),
        ),
        kinetic_energy(body),
        sum((each.energy for each in contacts.all), ca.SX(0)),
        (sum(each.force.normal for each in contacts.bodies),) if contacts.bodies else (),
        tuple(solids),
    )


def solid_limits(vehicle: Vehicle, contacts: Sequence[tuple[Contact, ...]]) -> Iterator[Limit]:
    """Yield the limit of the depth of each wheel in solids; none without solids."""
    for wheel, (_, *on_solids) in zip(vehicle.wheels, contacts, strict=True):
        if on_solids:
            gap = ca.mmin(ca.vertcat(*(each.touch.gap for each in on_solids)))
            label = quantity_label("solid_gap", wheel.name)
            yield Limit(label, gap, -tube_radii(wheel)[0], np.inf)


def depth_limits(
    vehicle: Vehicle, law: ContactLaw, contacts: Sequence[tuple[Contact, ...]]
) -> Iterator[Limit]:
    """Yield the limit of each wheel's depth up to which a law is valid, if the law has one."""
    for wheel, touching in zip(vehicle.wheels, contacts, strict=True):
        most = law.max_depth(wheel)
        if most < np.inf:
            depth = -ca.mmin(ca.vertcat(*(each.touch.gap for each in touching)))
            label = quantity_label("sunk", wheel.name, quantity="depth")
            yield Limit(label, depth, -np.inf, most)


def dynamic_forces(
    q: base.Quantities, contacts: Contacts, x: DynamicState, effort: Effort
) -> base.ForceOutputs:
    """Return forces, powers and energies; a wheel in the air needs no friction."""
    along, across, normal, _ = q.forces
    needed = tuple(
        ca.if_else(n > 0, ca.hypot(a, c) / n, 0)
        for a, c, n in zip(along, across, normal, strict=True)
    )
    used = tuple(each / mu for each, mu in zip(needed, q.mechanics.friction, strict=True))
    commanded = [
        rate
        for c, rate in zip(q.vehicle.coordinates, x.joint_speeds, strict=True)
        if c.kind == "commanded"
    ]
    efforts, rates = ca.vertcat(*effort.torques, *effort.actuators), (*q.spins, *commanded)
    return base.ForceOutputs(
        along,
        across,
        needed,
        used,
        effort.torques,
        output_efforts(q.vehicle, effort.actuators),
        ca.dot(efforts, ca.vertcat(*rates)),
        q.mechanics.damped + sum(each.dissipation for each in contacts.all),
        q.mechanics.potential,
        q.tip_over_margin,
    )


STANDING_SMOOTHING = 0.01  # width of the load law of the vehicle at rest [static depths]


def planar_start(
    moving: MovingVehicle, labels: Labels, contacts: Sequence[tuple[Contact, ...]]
) -> Standing:
    """Return the equilibrium of a planar vehicle, and the states of the dynamic model there.

    The driven wheels hold the vehicle on a slope, with friction in proportion to their loads.
    """
    vehicle, terrain, lookups, x, _, body = moving
    share = ca.SX.sym("share")
    holds_all, loads = not any(wheel.driven for wheel in vehicle.wheels), list[Load]()
    for each, (at, *_) in zip(body.wheels, contacts, strict=True):
        frame, pull = at.touch.frame, share if each.wheel.driven or holds_all else 0
        force = at.force.normal * (frame.normal + pull * frame.along)
        arm = frame.point - body.parts[each.wheel.parent].pose.origin
        loads.append(Load(each.wheel.parent, force, ca.cross(arm, force)))
    forces = generalised_forces(body, loads) - bias_forces(body)
    for k, c in enumerate(vehicle.coordinates):
        if c.is_loaded:
            forces[3 + k] -= ca.gradient(c.potential(x.joints[k]), x.joints[k])
    free = [k for k, c in enumerate(vehicle.coordinates) if c.kind == "suspension"]
    held = [k for k in range(len(vehicle.coordinates)) if k not in free]
    speeds = ca.vertcat(*leaves(x[5:]))  # with the integrals
    least_gaps = (ca.mmin(ca.vertcat(np.inf, *(at.touch.gap for at in c[1:]))) for c in contacts)
    rows, gaps = ca.substitute(
        [forces[[0, 1, 2, *(3 + k for k in free)]] / vehicle.weight, ca.vertcat(*least_gaps)],
        [speeds],
        [ca.SX.zeros(speeds.shape)],
    )
    # given are y and the joints that are not suspension; unknown are the share of friction, z,
    # pitch and the suspension
    joints = tuple(x.joints[k] for k in held)
    pose = (share, x.z, *x.attitude, *(x.joints[k] for k in free))
    names: Any = labels.x
    unknowns = (
        Label("friction_share", "1", "friction of the wheels at rest over their loads"),
        names.z,
        *names.attitude,
        *(names.joints[k] for k in free),
    )
    balance = tuple(
        Label(f"balance_{each.name}", "1", f"balance of {each.name}") for each in unknowns
    )
    known = names.y, tuple(names.joints[k] for k in held)
    still = Labels(known, (unknowns,), (), (), (), (balance,))
    (scale, shift), speed = base.sizes(vehicle, terrain, still), ca.SX.sym("speed")
    given = base.Configuration(ca.SX(0), x.y, ca.SX(0), joints)
    position = base.Dependent(x.z, ca.SX(0), x.attitude[0], tuple(x.joints[k] for k in free), ())
    heights, _ = base.level_heights(base.VehicleState(vehicle, terrain, lookups, given, position))
    lowest = ca.mmin(heights) - max(wheel.depth for wheel in vehicle.wheels)
    limits = wheel_limits(vehicle, "start_gap", ca.vertsplit(gaps), 0.0, np.inf)
    model = Dae(
        ca.SX.sym("t"),
        (x.y, joints),
        (pose,),
        (),
        (),
        ode=ca.SX.zeros(1 + len(held)),
        alg=(rows,),
        quad=ca.SX(0, 1),
        y=(),
        labels=still,
        limits=tuple(limits) if len(contacts[0]) > 1 else (),
        checks=(),
        guess=ca.vertcat(0, lowest, ca.SX.zeros(1 + len(free))),
        scale=scale,
        shift=shift,
        size=base.extent(vehicle),
        lookups=lookups.lookups,
    )
    forward = turn("x", x.attitude[0]).rotation[1:, 1]
    states = _rolling_states(vehicle, labels, [*leaves(x[:5])], forward, speed)
    return Standing(model, None, speed, states)


def _rolling_states(
    vehicle: Vehicle, labels: Labels, pose: Sequence[ca.SX], forward: ca.SX, speed: ca.SX
) -> ca.SX:
    """Return the states of a vehicle in a pose that rolls straight ahead at a speed."""
    rest = ca.SX.zeros((1 if vehicle.planar else 3) + len(vehicle.coordinates))
    rolling = [speed / wheel.radius for wheel in vehicle.wheels]
    motors = ca.SX.zeros(len(labels.x.drives) + len(labels.x.joint_drives))
    return ca.vertcat(*pose, speed * forward, rest, *rolling, motors)


def standing_start(
    vehicle: Vehicle, terrain: Terrain, prisms: Sequence[Prism], labels: Labels
) -> Standing:
    """Return the model of the vehicle at rest, and the states of the dynamic model there.

    At rest, no wheel touches a solid.
    """
    model = pressed_dae(vehicle, terrain, LeastSlip(), STANDING_SMOOTHING)
    still: Any = model.x
    values = {
        label.name: value
        for label, value in zip(leaves(model.labels.x), leaves(model.x), strict=True)
    }
    level = platform(still.x, still.y, still.z, still.heading, still.roll, still.pitch)
    x, y, z, w = ca.vertsplit(quaternion(level.rotation))
    poses = vehicle.carriers(level, {c.name: values[c.name] for c in vehicle.coordinates})
    if prisms:
        pairs = zip(vehicle.wheels, poses, strict=True)
        gaps = [
            [solid_touch(each, terrain, *pair, LookupTable()).gap for each in prisms]
            for pair in pairs
        ]
        least = (ca.mmin(ca.vertcat(*each)) for each in gaps)
        clear = wheel_limits(vehicle, "start_gap", least, 0.0, np.inf)
        model = replace(model, limits=(*model.limits, *clear))
    joints, speed = [values[c.name] for c in vehicle.coordinates], ca.SX.sym("speed")
    guess = None
    if has_exact_closure(vehicle):
        guess = replace(exact_dae(vehicle, terrain, LeastSlip()), limits=(), checks=())
    pose = [still.x, still.y, still.z, w, x, y, z, *joints]
    states = _rolling_states(vehicle, labels, pose, level.rotation[:, 1], speed)
    return Standing(model, guess, speed, states)


MIN_INERTIA = 1e-15  # smaller generalised masses count as zero [kg, kg m^2]
LAG = 1e-3  # time constant of prescribed rates [s]
NORMALISATION = 1.0  # rate at which the norm of the quaternion returns to one [1/s]
STEP_SHARE = 1 / 8  # largest distance that a wheel travels in a step of the integrator [radii]
EXACT_DEPTH = 1 / 250  # default static depth of vehicles with exact closure [rolling radii]


@checked
@computing
def dynamics(
    vehicle: Vehicle,
    ground: Terrain | Solids,
    *,
    law: ContactLaw = Compliant(),  # noqa: B008 - a frozen record
) -> DynamicDae:
    """Return the dynamic model of a vehicle on a ground.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle, with mass. Wheels may leave the ground.
    ground : Terrain or Solids
        The ground, with friction. A motion ends where a contact leaves its domain.
    law : ContactLaw
        Wheel-ground law: `Compliant`, or `Soil`, which needs no friction of the ground.

    Returns
    -------
    Dae
        Inputs are those of the drives of wheels and commanded coordinates: the rate of a `Rate` or
        `Motor`, the torque or force of a `Torque`.

    Raises
    ------
    ModelError
        If the vehicle has no mass, if a wheel whose rate is not prescribed has neither mass nor
        inertia, if a coordinate whose rate is not prescribed moves no mass, if the law cannot be
        used with the vehicle or the ground, or if a wheel on solids is not a torus, a disc or a
        sphere.

    Notes
    -----
    A prescribed rate is reached with a time constant of 1 ms. Settle the model for a start at
    rest: ``settle(model, x=..., y=..., heading=...)``. The vehicle then stands on the base of
    solids, and must not touch them.

    A wheel may touch the base and several solids at once. Its outputs are those of the contact with
    the least gap; the outputs of solid ``k`` are ``solid_gap_k``, ``solid_load_k`` and others, with
    ``k = 0`` for the base.

    For a planar vehicle, give `settle` the position ``y`` and the values of joints that are not
    suspension.

    Examples
    --------
    Accelerate a vehicle from rest on level ground:

    >>> import numpy as np
    >>> from slipfree import Analytic, catalog, dynamics, settle, simulate
    >>> model = dynamics(catalog.rigid_skid_steer(), Analytic(lambda x, y: 0 * x, mu=0.8))
    >>> inputs = {label.full: 4.0 for label in model.labels.u.wheels}
    >>> run = simulate(model, settle(model), model.inputs(**inputs), np.linspace(0, 1, 11))
    >>> print(run.stop)
    None
    """
    terrain, prisms = (ground.base, ground.prisms) if isinstance(ground, Solids) else (ground, ())
    check_dynamic(vehicle)
    law.check(vehicle, terrain)
    made_from = vehicle
    vehicle = with_depths(vehicle)
    share = vehicle.weight / len(vehicle.wheels)  # static depths of the law, under equal shares
    sunk = (replace(w, static_depth=law.static_depth(w, share)) for w in vehicle.wheels)
    vehicle = replace(vehicle, wheels=tuple(sunk))
    bears = isinstance(law, BodyLaw) and law.bears_bodies and bool(vehicle.shapes)
    labels = dynamic_labels(vehicle, len(prisms), bears=bears)
    moving = moving_vehicle(vehicle, terrain, labels)
    x, body = moving.x, moving.body
    wheels = _contacts(moving, prisms, law)
    contacts = Contacts(wheels, body_contacts(vehicle, terrain, law, body, moving.lookups))
    inertia = mass_matrix(body), bias_forces(body)
    check_inertia(vehicle, labels, x, inertia[0])
    ode, effort = equations_of_motion(moving, contacts, *inertia)
    shown = [deepest(each) for each in wheels]
    q = quantities(moving, shown)
    forces = dynamic_forces(q, contacts, x, effort)
    y = dynamic_outputs(q, body, shown, contacts, forces)
    on_base = [each[0] for each in wheels]
    frames = tuple(each.touch.frame for each in on_base)
    checks: tuple[SecondContact, ...] = ()
    if not plane_of(terrain):  # a wheel touches a plane only once
        raised = base.raised_poses(q.poses, frames, tuple(-each.touch.gap for each in on_base))
        checks = second_contacts(q._replace(contacts=frames), x, (), raised, base.extent(vehicle))
    pairs = [ca.SX.sym("held", each.sparsity()) for each in inertia], inertia
    held_ode, _ = equations_of_motion(moving, contacts, *pairs[0])
    standing: Standing | None = None  # where contacts and springs hold the vehicle
    if vehicle.planar:
        still = moving_vehicle(vehicle, terrain, labels)
        standing = planar_start(still, labels, _contacts(still, prisms, law))
    elif not support_fault(vehicle):
        standing = standing_start(vehicle, terrain, prisms, labels)
    return base.vehicle_dae(
        q,
        labels,
        x,
        (),
        (),
        forces,
        ode=ode,
        y=y,
        limits=(
            *limits_of(limit_quantities(q, on_base), static=False, overturns=bears),
            *solid_limits(vehicle, wheels),
            *depth_limits(vehicle, law, wheels),
        ),
        checks=checks if bears else (*checks, *base.body_checks(q, x, ())),
        guess=ca.SX(0, 1),
        pace=ca.SX(0) if plane_of(terrain) and not prisms else _pace(body, moving.u),
        standing=standing,
        held=HeldTerms(held_ode, *(ca.vertcat(*(each.nz[:] for each in pair)) for pair in pairs)),
        vehicle=made_from,
        ground=ground,
    )


def _pace(body: Multibody, u: base.Inputs) -> ca.SX:
    """Return the number of `STEP_SHARE` radii that the fastest wheel travels per second [1/s].

    The wanted rates of drives count as well, so that the pace is known at a start from rest.
    """
    inputs, fastest = iter(u.wheels), ca.SX(0)
    for each in body.wheels:
        wheel = each.wheel
        speed = ca.norm_2(each.motion.velocity) / wheel.radius
        wanted = next(inputs) if wheel.driven else ca.SX(0)
        rate = ca.SX(0) if wheel.acting_drive.takes_effort else ca.fabs(wanted)
        fastest = ca.fmax(fastest, ca.fmax(speed, rate))
    return fastest / STEP_SHARE


def check_dynamic(vehicle: Vehicle) -> None:
    """Raise ModelError if a vehicle cannot be used in dynamics."""
    base.check_mass(vehicle, "dynamics")
    for wheel in vehicle.wheels:
        if not (wheel.mass or wheel.inertia or wheel.acting_drive.prescribed):
            raise ModelError(
                f"dynamics: wheel {wheel.name!r}: expected a mass or a moment of inertia, since "
                "its rate is not prescribed, found neither; set its 'mass' or 'inertia'"
            )


def check_inertia(vehicle: Vehicle, labels: Labels, x: DynamicState, matrix: ca.SX) -> None:
    """Raise ModelError for a coordinate without inertia, with all coordinates at zero."""
    still = [float(label.name == "attitude_w") for label in leaves(labels.x)]
    values = np.diag(np.array(ca.Function("mass", [pack(x)], [matrix])(still)))
    own = values[values.size - len(vehicle.coordinates) :]
    for c, value in zip(vehicle.coordinates, own, strict=True):
        if not (c.acting_drive.prescribed or value > MIN_INERTIA):
            raise ModelError(
                f"dynamics: coordinate {c.name!r}: expected a part or a wheel with mass that it "
                "moves, found none; give a part or a wheel that it carries a mass"
            )


def with_depths(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle whose wheels have static depths."""
    exact = has_exact_closure(replace(vehicle, planar=False))
    wheels = (
        replace(wheel, static_depth=wheel.radius * EXACT_DEPTH)
        if exact and wheel.static_depth is None
        else replace(wheel, static_depth=wheel.depth)
        for wheel in vehicle.wheels
    )
    return replace(vehicle, wheels=tuple(wheels))


def moving_vehicle(vehicle: Vehicle, terrain: Terrain, labels: Labels) -> MovingVehicle:
    """Return the vehicle as a system of rigid bodies, with symbols for states and inputs."""
    x: DynamicState = symbols(labels.x)
    whole = in_space(vehicle, x)
    attitude = ca.vertcat(*x.attitude)
    rotation = turn("x", attitude).rotation if vehicle.planar else rotation_of(attitude)
    placed = Pose(rotation, ca.vertcat(whole.x, x.y, x.z))
    rates = ca.vertcat(ca.SX(0, 1), *x.joint_speeds)
    speeds = Speeds(ca.vertcat(*whole.velocity), ca.vertcat(*whole.omega), rates, x.spins)
    names = [c.name for c in vehicle.coordinates]
    body = multibody(vehicle, placed, dict(zip(names, x.joints, strict=True)), speeds)
    return MovingVehicle(vehicle, terrain, LookupTable(), x, symbols(labels.u), body)


def _contacts(
    moving: MovingVehicle, prisms: Sequence[Prism], law: ContactLaw
) -> list[tuple[Contact, ...]]:
    """Return the contacts of each wheel: with the terrain, then with each solid.

    Wheels with equal sections share a search on the terrain.
    """
    vehicle, terrain, lookups = moving[:3]
    radii = {wheel.section: wheel.radius for wheel in vehicle.wheels}
    searches = {each: search_function(terrain, each, radius) for each, radius in radii.items()}
    found, share = list[tuple[Contact, ...]](), vehicle.weight / len(vehicle.wheels)
    origin = ca.DM(terrain.origin[:2])
    for each in moving.body.wheels:
        wheel, pose = each.wheel, each.motion.pose
        touches = [
            touch(terrain, wheel, pose, searches[wheel.section], lookups),
            *(solid_touch(prism, terrain, wheel, pose, lookups) for prism in prisms),
        ]
        on_wheel = list[Contact]()
        for at in touches:
            slip = slip_velocity(each, at)
            place = at.frame.point[:2] + origin
            motion = slip, each.spin, pose.origin, place
            state = WheelContact(wheel, at, *motion, share, vehicle.gravity)
            on_wheel.append(Contact(at, slip, each.spin, law.force(state)))
        found.append(tuple(on_wheel))
    return found


def slip_velocity(wheel: WheelMotion, at: Touch) -> ca.SX:
    """Return the velocity of the wheel's material point at its contact, shape (3, 1) [m/s].

    On rollers, it has no component across their axles.
    """
    omega = wheel.motion.omega - wheel.rate * wheel.axle
    slip = wheel.motion.velocity + ca.cross(omega, at.frame.point - wheel.motion.pose.origin)
    return without_rolling(wheel.wheel, at.frame, slip)


def equations_of_motion(
    moving: MovingVehicle, contacts: Contacts, matrix: ca.SX, bias: ca.SX
) -> tuple[ca.SX, Effort]:
    """Return the rates of the states, and the efforts of drives and actuators.

    ``matrix`` is the mass matrix, ``bias`` are the inertial forces at constant speeds less gravity.
    """
    vehicle, x, body = moving.vehicle, moving.x, moving.body
    inputs, integrals, zero = iter(moving.u.wheels), iter(x.drives), ca.SX(0)
    loads, integral_rates = list[Load](), list[ca.SX]()
    on_wheels = list[tuple[ca.SX, ca.SX, ca.SX]]()  # resisting moment, torque, prescribed rate
    for wheel, touching in zip(body.wheels, contacts.wheels, strict=True):
        drive = wheel.wheel.acting_drive
        wanted = next(inputs) if wheel.wheel.driven else zero
        integral = next(integrals) if drive.has_integral else zero
        torque, rate = drive.effort(wanted, wheel.rate, integral)
        integral_rates += [rate] * drive.has_integral
        center = wheel.motion.pose.origin
        force = sum((each.total for each in touching), ca.SX.zeros(3))
        moment = sum((each.moment(center) for each in touching), ca.SX.zeros(3))
        resisting, acceleration = ca.dot(wheel.axle, moment), zero
        about = torque - resisting  # the reaction of the drive instead of the axial moment
        if wheel.prescribed:
            acceleration = (wanted - wheel.speed) / LAG
            about = wheel.axial * acceleration
        arm = ca.cross(center - body.parts[wheel.wheel.parent].pose.origin, force)
        loads.append(Load(wheel.wheel.parent, force, arm + moment + about * wheel.axle))
        on_wheels.append((resisting, torque, acceleration))
    loads += [each.load for each in contacts.bodies]
    forces = generalised_forces(body, loads) - bias
    accelerations, actuators, joint_integrals = _accelerations(moving, matrix, forces)
    spins, torques = list[ca.SX](), list[ca.SX]()
    for wheel, (resisting, torque, acceleration) in zip(body.wheels, on_wheels, strict=True):
        if wheel.prescribed:
            alpha = angular_acceleration(body, wheel.wheel.parent, accelerations)
            spins.append(acceleration)
            spin_rate = acceleration - ca.dot(alpha, wheel.axle)
            torques.append(wheel.axial * spin_rate + resisting)
        else:
            spins.append((torque - resisting) / (wheel.axial + wheel.rotor))
            torques.append(torque)
    attitude = ca.vertcat(*x.omega)
    if not vehicle.planar:  # the rate of the quaternion
        quaternion, omega = ca.vertcat(*x.attitude), attitude
        scalar, vector = quaternion[0], quaternion[1:]
        change = ca.vertcat(-ca.dot(omega, vector), scalar * omega + ca.cross(omega, vector)) / 2
        attitude = change + NORMALISATION * (1 - ca.sumsqr(quaternion)) * quaternion
    speeds = *x.velocity, attitude, *x.joint_speeds
    ode = ca.vertcat(*speeds, accelerations, *spins, *integral_rates, *joint_integrals)
    return ode, Effort(tuple(torques), actuators)


def _accelerations(
    moving: MovingVehicle, matrix: ca.SX, forces: ca.SX
) -> tuple[ca.SX, tuple[ca.SX, ...], tuple[ca.SX, ...]]:
    """Return the rates of the generalised speeds, and efforts and integrals' rates of actuators.

    ``forces`` are those of contacts, drives of wheels, gravity and inertia at constant speeds.
    Springs, dampers and efforts of drives act on the coordinates whose rates are not prescribed.
    """
    vehicle, x = moving.vehicle, moving.x
    count = matrix.shape[0]
    found, efforts, first = ca.SX.zeros(count), ca.SX.zeros(count), count - len(x.joints)
    inputs, integrals, integral_rates = iter(moving.u.joints), iter(x.joint_drives), list[ca.SX]()
    fixed, free = list[int](), [*range(first)]
    columns = vehicle.coordinates, x.joints, x.joint_speeds
    for k, (c, value, rate) in enumerate(zip(*columns, strict=True), first):
        drive = c.acting_drive
        (fixed if drive.prescribed else free).append(k)
        wanted = next(inputs) if c.kind == "commanded" else ca.SX(0)
        if drive.prescribed:
            found[k] = (wanted - rate) / LAG
        integral = next(integrals) if drive.has_integral else ca.SX(0)
        efforts[k], integral_rate = drive.effort(wanted, rate, integral)
        if drive.has_integral:
            integral_rates.append(integral_rate)
        if c.is_loaded:
            forces[k] -= ca.gradient(c.potential(value), value) + c.damping * rate
    right = forces[free] + efforts[free] - matrix[free, fixed] @ found[fixed]
    found[free] = ca.ldl_solve(right, *ca.ldl(matrix[free, free]))
    efforts[fixed] = matrix[fixed, :] @ found - forces[fixed]
    pairs = zip(vehicle.coordinates, ca.vertsplit(efforts)[first:], strict=True)
    actuators = tuple(effort for c, effort in pairs if c.kind == "commanded")
    return found, actuators, tuple(integral_rates)
