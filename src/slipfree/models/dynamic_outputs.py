"""States, inputs and outputs of dynamic models, and contact of bodies with the ground.

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
from itertools import product
from typing import Any, Generic, NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.closure import ContactFrame
from slipfree.contact.nearest_points import frame_of
from slipfree.contact.touch import Touch, tube_radii
from slipfree.core.dae import Dae, Labels, Limit
from slipfree.core.errors import ModelError
from slipfree.core.lookups import LookupTable
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Label, T, leaves, unpack
from slipfree.geometry.frame import FIXED, Pose, translation
from slipfree.laws.protocols import (
    BodyLaw,
    BodyTouch,
    ContactLaw,
    GroundForce,
    quantity_labels,
    wheel_labels,
)
from slipfree.models.base import (
    Configuration,
    Dependent,
    ForceOutputs,
    Forces,
    Inputs,
    Mechanics,
    Outputs,
    Quantities,
    Rates,
    VehicleState,
    effort_label,
    labels_of,
    outputs,
    pressed_labels,
    slip_ratios,
    tangential_components,
)
from slipfree.models.limits import tip_over_margin
from slipfree.models.multibody import Load, Multibody, kinetic_energy
from slipfree.terrain.base import Terrain
from slipfree.vehicle.shapes import Ball, BodyShape, Box, Hull
from slipfree.vehicle.tree import Coordinate, Vehicle
from slipfree.vehicle.wheel import Wheel

MAX_POINTS = 200  # each adds a lookup of the ground


class BodyContact(NamedTuple):
    """Contact of a point of a body: arm from the platform's origin [m], and elastic energy [J]."""

    part: str
    touch: BodyTouch
    arm: ca.SX
    force: GroundForce
    energy: ca.SX

    @property
    def load(self) -> Load:
        """Force of the ground on the part, and its moment about the platform's origin."""
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
        contacts.append(BodyContact(part, touch, place - body.origin, force, energy))
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
    common: Outputs[T]
    kinetic_energy: T
    contact_energy: T
    body_load: tuple[T, ...]
    solids: tuple[OnSolid[T], ...]


DynamicDae = Dae[DynamicState[ca.SX], tuple[()], Inputs[ca.SX], DynamicOutputs[ca.SX]]


def dynamic_labels(vehicle: Vehicle, solids: int = 0, *, bears: bool = False) -> Labels:
    """Return the labels of the dynamic model of a vehicle with mass, for a number of solids.

    ``bears`` is whether bodies bear load.
    """
    still = labels_of(vehicle, follow=False)
    q = still.q._replace(lost=(quantity_label("lost_energy"),))
    joints = zip(vehicle.of("commanded"), still.u.joints, strict=True)
    u = Inputs(
        tuple(_wheel_input(wheel) for wheel in vehicle.wheels if wheel.driven),
        tuple(effort_label(vehicle, c) if c.drive.takes_effort else rate for c, rate in joints),
    )
    position, rates = still.z.position, still.z.rates
    forces: Any = still.y.forces
    forces = forces._replace(joint_effort=output_efforts(vehicle, forces.joint_effort))
    y = _outputs(
        vehicle,
        (still.x, position, rates),
        position.contacts,
        still.y._replace(
            forces=forces,
            **pressed_labels(vehicle),
            slip_ratio=quantity_labels(vehicle, "slip_ratio"),
        ),
        quantity_label("kinetic_energy"),
        quantity_label("contact_energy"),
        (quantity_label("body_load"),) if bears else (),
        tuple(_solid_labels(vehicle, k) for k in range(solids + 1 if solids else 0)),
    )
    return Labels(_state_labels(vehicle, still), (), q, u, y, ())


def _outputs(
    vehicle: Vehicle,
    motion: tuple[Configuration, Dependent, Rates],
    contacts: Sequence[Sequence[Any]],
    *others: Any,
) -> DynamicOutputs:
    """Return the outputs, or their labels, from those of kinematic models and contact points."""
    x, position, rates = motion
    angles = x.heading, position.roll, () if vehicle.planar else position.pitch
    turning = rates.heading, rates.roll, rates.pitch
    places: Any = zip(*contacts, strict=True)
    return DynamicOutputs(x.x if vehicle.planar else (), *angles, *turning, *places, *others)


def _wheel_input(wheel: Wheel) -> Label:
    words = f"wheel {wheel.name}, positive forward"
    if wheel.drive.takes_effort:
        return Label(f"{wheel.name}_torque", "N m", f"torque on {words}")
    return Label(f"{wheel.name}_rate", "rad s-1", f"rate of {words}")


def _integral(name: str, unit: str) -> Label:
    return Label(f"{name}_motor_integral", unit, f"integral of the controller of {name}")


def _state_labels(vehicle: Vehicle, still: Labels) -> DynamicState:
    """Return the labels of the states, from those of a model without inertia."""
    joints = {label.name: label for label in (*still.x.joints, *still.z.position.suspension)}
    words = "{} of the platform's quaternion (x right)"
    attitude = tuple(Label(f"attitude_{k}", "1", words.format(k)) for k in "wxyz")
    velocity = _vector("velocity", "m s-1", "velocity of the platform's centre")
    omega = _vector("omega", "rad s-1", "angular velocity of the platform")
    planar = vehicle.planar
    return DynamicState(
        () if planar else still.x.x,
        still.x.y,
        still.z.position.z,
        (still.z.position.pitch,) if planar else attitude,
        tuple(joints[c.name] for c in vehicle.coordinates),
        velocity[1:] if planar else velocity,
        omega[:1] if planar else omega,
        tuple(_joint_speed(vehicle, c) for c in vehicle.coordinates),
        quantity_labels(vehicle, "spin"),
        tuple(
            _integral(each.name, "N m") for each in vehicle.wheels if each.acting_drive.has_integral
        ),
        tuple(
            _integral(c.name, effort_label(vehicle, c).unit)
            for c in vehicle.coordinates
            if c.acting_drive.has_integral
        ),
    )


def _solid_labels(vehicle: Vehicle, k: int) -> OnSolid:
    along, name = "along the direction of travel", f"solid {k}" if k else "the ground"
    return OnSolid(
        wheel_labels(vehicle, f"solid_gap_{k}", "m", f"gap between the wheel and {name}"),
        wheel_labels(vehicle, f"solid_load_{k}", "N", f"normal force of {name} on the wheel"),
        wheel_labels(
            vehicle, f"solid_friction_{k}", "N", f"friction of {name} on the wheel {along}"
        ),
        wheel_labels(vehicle, f"solid_slip_{k}", "m s-1", f"slip of the wheel on {name} {along}"),
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


def _joint_speed(vehicle: Vehicle, c: Coordinate) -> Label:
    name, words = ("speed", "actual rate") if c.kind == "commanded" else ("rate", "rate")
    return Label(f"{c.name}_{name}", f"{vehicle.unit(c.name)} s-1", f"{words} of {c.words}")


def _vector(name: str, unit: str, words: str) -> tuple[Label, ...]:
    return tuple(
        Label(f"{name}_{axis}", unit, f"{axis} component of the {words}") for axis in "xyz"
    )


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
    u: Inputs
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


def quantities(moving: MovingVehicle, contacts: Sequence[Contact]) -> Quantities:
    """Return the quantities from which limits and outputs are computed."""
    vehicle, terrain, lookups, x, u, body = moving
    x = in_space(vehicle, x)
    r = body.parts["platform"].pose.rotation
    values = [(c.kind, value) for c, value in zip(vehicle.coordinates, x.joints, strict=True)]
    place = Configuration(
        x.x,
        x.y,
        ca.atan2(r[1, 0], r[0, 0]),
        tuple(value for kind, value in values if kind != "suspension"),
    )
    position = Dependent(
        x.z,
        ca.asin(ca.fmax(-1, ca.fmin(1, -r[2, 0]))),
        ca.atan2(r[2, 1], r[2, 2]),
        tuple(value for kind, value in values if kind == "suspension"),
        (),
    )
    frames = tuple(each.touch.frame for each in contacts)
    along, across = tangential_components(frames, [each.force.tangential for each in contacts])
    height = sum(each.mass * each.motion.pose.origin[2] for each in body.bodies)
    loaded = [
        (c, value, rate)
        for c, value, rate in zip(vehicle.coordinates, x.joints, x.joint_speeds, strict=True)
        if c.is_loaded
    ]
    springs = sum(c.potential(value) for c, value, _ in loaded)
    damped = sum(c.damping * rate**2 for c, _, rate in loaded)
    none, friction = ca.SX(0, 0), tuple(each.touch.friction for each in contacts)
    energy = ca.SX(vehicle.gravity * height + springs)
    rates = _rates(vehicle, x, place, position.roll)
    state = VehicleState(vehicle, terrain, lookups, place, position, rates, u)
    return Quantities(
        *state,
        Forces(along, across, tuple(each.force.normal for each in contacts)),
        tuple(wheel.motion.pose for wheel in body.wheels),
        frames,
        tuple(each.slip for each in contacts),
        tuple(wheel.rate for wheel in body.wheels),
        Mechanics(none, none, none, none, friction, vehicle.weight, energy, ca.SX(damped)),
        tip_over_margin(state, frames),
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


def limit_quantities(q: Quantities, contacts: Sequence[Contact]) -> Quantities:
    """Return the quantities for limits: wheels in the air satisfy every limit on contacts."""
    frames = list[ContactFrame]()
    for each in contacts:
        frame, on_ground = each.touch.frame, each.touch.gap < 0
        upright = ca.if_else(on_ground, frame.uprightness, 1)
        hessian = ca.if_else(on_ground, frame.hessian, ca.SX.zeros(2, 2))
        frames.append(frame._replace(uprightness=upright, hessian=hessian))
    return q._replace(contacts=tuple(frames))


def dynamic_outputs(
    q: Quantities,
    body: Multibody,
    shown: Sequence[Contact],
    contacts: Contacts,
    forces: ForceOutputs,
) -> DynamicOutputs:
    """Return the outputs of the model; the slip of a wheel in the air is zero.

    ``shown`` is the contact of each wheel with the least gap.
    """
    o_x, o_y, _ = q.terrain.origin
    normal, wheels = q.forces.normal, contacts.wheels
    slips = tuple(ca.if_else(each.touch.gap < 0, each.slip, 0) for each in shown)
    q = q._replace(slips=slips)
    return _outputs(
        q.vehicle,
        (q.x, q.position, q.rates),
        [(each.point[0] + o_x, each.point[1] + o_y) for each in q.contacts],
        outputs(q, forces)._replace(
            depth=tuple(-each.touch.gap for each in shown),
            load_share=tuple(each * len(normal) / q.vehicle.weight for each in normal),
            force_normal=normal,
            slip_ratio=slip_ratios(q),
        ),
        kinetic_energy(body),
        sum((each.energy for each in contacts.all), ca.SX(0)),
        (sum(each.force.normal for each in contacts.bodies),) if contacts.bodies else (),
        tuple(map(_on_solid, zip(*wheels, strict=True))) if len(wheels[0]) > 1 else (),
    )


def _on_solid(contacts: Sequence[Contact]) -> OnSolid:
    frames = [each.touch.frame for each in contacts]
    return OnSolid(
        tuple(each.touch.gap for each in contacts),
        tuple(each.force.normal for each in contacts),
        tangential_components(frames, [each.force.tangential for each in contacts])[0],
        tangential_components(frames, [each.slip for each in contacts])[0],
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
    q: Quantities, contacts: Contacts, x: DynamicState, effort: Effort
) -> ForceOutputs:
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
    return ForceOutputs(
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
