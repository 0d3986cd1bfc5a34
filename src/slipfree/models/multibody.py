"""Mechanics of a tree of rigid bodies: mass matrix and bias forces in symbolic form.

Generalised speeds are the velocity of the platform's origin, the platform's angular velocity, both
in fixed axes, and the rates of the vehicle's coordinates. The mass matrix follows from composite
rigid bodies, the bias forces from a recursive Newton-Euler algorithm (Featherstone, Rigid Body
Dynamics Algorithms, 2008, chapters 5 and 6). Vectors are in fixed axes; moments are about the
platform's origin.

A wheel contributes its mass and its transverse inertia to the part that carries it. Its spin is a
separate speed, since a body of revolution has the same inertia in every position.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import casadi as ca

from slipfree.geometry.frame import Pose, unit_vector
from slipfree.vehicle.formula import evaluate
from slipfree.vehicle.tree import Vehicle, body_inertia, body_of
from slipfree.vehicle.wheel import Wheel, wheel_inertia

UP = ca.SX(ca.DM([0, 0, 1]))


class Speeds(NamedTuple):
    """Generalised speeds of the parts of a vehicle, as columns.

    Velocity of the platform's origin [m/s] and angular velocity of the platform [rad/s], rates of
    the coordinates [rad/s, m/s], and speeds of the wheels (``WheelMotion.speed``) [rad/s].
    """

    velocity: ca.SX
    omega: ca.SX
    rates: ca.SX
    wheels: tuple[ca.SX, ...]


class PartMotion(NamedTuple):
    """Pose, velocities and accelerations of a part; these are for constant generalised speeds."""

    pose: Pose
    velocity: ca.SX
    omega: ca.SX
    acceleration: ca.SX
    alpha: ca.SX

    def at(self, pose: Pose) -> PartMotion:
        """Return the motion of another frame that is fixed to the part."""
        arm = pose.origin - self.pose.origin
        swing = ca.cross(self.omega, arm)
        return PartMotion(
            pose,
            self.velocity + swing,
            self.omega,
            self.acceleration + ca.cross(self.alpha, arm) + ca.cross(self.omega, swing),
            self.alpha,
        )


class RigidBody(NamedTuple):
    """A rigid body: part, mass [kg], motion of its centre of mass, inertia tensor [kg m^2]."""

    part: str
    mass: float
    motion: PartMotion
    inertia: ca.SX


class WheelMotion(NamedTuple):
    """Motion of the carrier of a wheel, at the wheel's centre, and the inertia of the wheel.

    The carrier's x axis is the axle. ``axial`` is the moment of inertia about it; ``rotor`` that of
    the drive, added in the equation of the wheel's spin [kg m^2]. ``speed`` is positive forward:
    the rate relative to the carrier if that is prescribed, otherwise the spin relative to fixed
    axes [rad/s]. If the rate is ``prescribed``, the axial inertia belongs to the carrier.
    """

    wheel: Wheel
    motion: PartMotion
    axial: float
    rotor: float
    speed: ca.SX
    prescribed: bool

    @property
    def axle(self) -> ca.SX:
        """Unit vector of the axle, shape (3, 1)."""
        return self.motion.pose.rotation[:, 0]

    @property
    def turning(self) -> ca.SX:
        """Angular velocity of the carrier about the axle [rad/s]."""
        return ca.dot(self.motion.omega, self.axle)

    @property
    def rate(self) -> ca.SX:
        """Rate of the wheel relative to its carrier, positive forward [rad/s]."""
        return self.speed if self.prescribed else self.speed + self.turning

    @property
    def spin(self) -> ca.SX:
        """Rate of the wheel relative to fixed axes, positive forward [rad/s]."""
        return self.rate - self.turning


class Load(NamedTuple):
    """Force on a part [N], and its moment about the platform's origin [N m], in fixed axes."""

    part: str
    force: ca.SX
    moment: ca.SX


class Multibody(NamedTuple):
    """A vehicle as a system of rigid bodies, in the symbols of a model.

    ``parts`` are the motions of the platform and of the parts of all joints, ``parents`` of joints
    are in their order. ``screws`` are the angular velocity of each joint's part and the velocity of
    its point at the platform's origin, for unit rate of the joint. ``gears`` (n_joints,
    n_coordinates) are the derivatives of the joint values with respect to the coordinates,
    ``rotors`` the inertias of their drives [kg m^2, kg]. ``bodies`` are parts with mass, and
    wheels; ``gravity`` acts on them [m/s^2].
    """

    parts: dict[str, PartMotion]
    parents: dict[str, str]
    screws: dict[str, tuple[ca.SX, ca.SX]]
    gears: ca.SX
    rates: ca.SX
    rotors: ca.DM
    bodies: tuple[RigidBody, ...]
    wheels: tuple[WheelMotion, ...]
    gravity: float

    @property
    def origin(self) -> ca.SX:
        """Origin of the platform, shape (3, 1) [m]."""
        return self.parts["platform"].pose.origin


def multibody(
    vehicle: Vehicle,
    platform: Pose,
    coordinates: Mapping[str, ca.SX],
    speeds: Speeds,
) -> Multibody:
    """Return a vehicle with mass as a system of rigid bodies.

    ``platform`` is the pose of the platform, ``coordinates`` are symbols of all coordinates by
    name.
    """
    still = ca.SX.zeros(3)
    parts = {"platform": PartMotion(platform, speeds.velocity, speeds.omega, still, still)}
    poses, column = vehicle.parts(platform, coordinates), ca.vertcat(*coordinates.values())
    values = ca.vertcat(
        ca.SX(0, 1), *(evaluate(joint.value, coordinates) for joint in vehicle.joints)
    )
    gears = ca.jacobian(values, column)
    rates = gears @ speeds.rates
    changes = ca.jtimes(rates, column, speeds.rates)  # second derivatives at constant rates
    screws, parents = dict[str, tuple[ca.SX, ca.SX]](), dict[str, str]()
    for joint, rate, change in zip(vehicle.joints, _entries(rates), _entries(changes), strict=True):
        pose = poses[joint.name]
        axis, on = pose.rotation @ ca.DM(unit_vector(joint.axis)), parts[joint.parent].at(pose)
        if joint.motion == "turn":
            motion = on._replace(
                omega=on.omega + axis * rate,
                alpha=on.alpha + ca.cross(on.omega, axis) * rate + axis * change,
            )
            screw = axis, ca.cross(pose.origin - platform.origin, axis)
        else:
            motion = on._replace(
                velocity=on.velocity + axis * rate,
                # Coriolis, and the second derivative of the formula of the joint
                acceleration=on.acceleration + 2 * ca.cross(on.omega, axis) * rate + axis * change,
            )
            screw = still, axis
        parts[joint.name], screws[joint.name] = motion, screw
        parents[joint.name] = joint.parent
    bodies, wheels = list[RigidBody](), list[WheelMotion]()
    for part, motion in parts.items():
        body = body_of(vehicle, part)
        if body.mass:
            rotation = motion.pose.rotation
            center = motion.pose.origin + rotation @ ca.DM(body.at)
            tensor = rotation @ ca.sparsify(ca.DM(body_inertia(vehicle, part))) @ rotation.T
            bodies.append(RigidBody(part, body.mass, motion.at(Pose(rotation, center)), tensor))
    for wheel, speed in zip(vehicle.wheels, speeds.wheels, strict=True):
        drive = wheel.acting_drive
        motion = parts[wheel.parent].at(parts[wheel.parent].pose @ wheel.mount)
        axial, across = wheel_inertia(wheel)
        axle = motion.pose.rotation[:, 0]
        about = axle @ axle.T
        tensor = across * (ca.SX.eye(3) - about) + (axial * about if drive.prescribed else 0)
        bodies.append(RigidBody(wheel.parent, wheel.mass, motion, tensor))
        wheels.append(
            WheelMotion(wheel, motion, axial, drive.added_inertia, speed, drive.prescribed)
        )
    rotors = ca.DM([c.acting_drive.added_inertia for c in vehicle.coordinates])
    moving, masses = (speeds.rates, rotors), (tuple(bodies), tuple(wheels))
    return Multibody(parts, parents, screws, gears, *moving, *masses, vehicle.gravity)


def _entries(column: ca.SX) -> list[ca.SX]:
    return list(ca.vertsplit(column)) if column.numel() else []


def generalised_forces(system: Multibody, loads: Iterable[Load]) -> ca.SX:
    """Return the generalised forces of loads on the parts, shape (6 + n_coordinates, 1)."""
    sums = {part: (ca.SX.zeros(3), ca.SX.zeros(3)) for part in system.parts}

    def add(part: str, force: ca.SX, moment: ca.SX) -> None:
        forces, moments = sums[part]
        sums[part] = forces + force, moments + moment

    for load in loads:
        add(*load)
    efforts = list[ca.SX]()
    for joint, parent in reversed(system.parents.items()):
        force, moment = sums[joint]
        turning, moving = system.screws[joint]
        efforts.append(ca.dot(turning, moment) + ca.dot(moving, force))
        add(parent, force, moment)
    joints = ca.vertcat(ca.SX(0, 1), *reversed(efforts))
    return ca.vertcat(*sums["platform"], system.gears.T @ joints)


def bias_forces(system: Multibody) -> ca.SX:
    """Return the generalised inertial forces at constant speeds, minus the forces of gravity.

    The equations of motion are ``M u' + bias = Q``, with the generalised forces ``Q`` of drives,
    springs and ground. The shape is (6 + n_coordinates, 1).
    """
    loads = list[Load]()
    for body in system.bodies:
        motion = body.motion
        force = body.mass * (motion.acceleration + system.gravity * UP)
        moment = body.inertia @ motion.alpha
        moment += ca.cross(motion.omega, body.inertia @ motion.omega)
        arm = motion.pose.origin - system.origin
        loads.append(Load(body.part, force, moment + ca.cross(arm, force)))
    for wheel in system.wheels:
        # the wheel's angular momentum, -axial * speed * axle, turns with its carrier
        moment = -wheel.axial * wheel.speed * ca.cross(wheel.motion.omega, wheel.axle)
        loads.append(Load(wheel.wheel.parent, ca.SX.zeros(3), moment))
    return generalised_forces(system, loads)


def mass_matrix(system: Multibody) -> ca.SX:
    """Return the mass matrix, shape (6 + n_coordinates, 6 + n_coordinates).

    The rows are those of velocity, angular velocity and coordinates.
    """
    eye = ca.SX.eye(3)
    composites = {part: (ca.SX(0), ca.SX.zeros(3), ca.SX.zeros(3, 3)) for part in system.parts}

    def add(part: str, mass: ca.SX, first: ca.SX, second: ca.SX) -> None:
        masses, firsts, seconds = composites[part]
        composites[part] = masses + mass, firsts + first, seconds + second

    for body in system.bodies:
        arm = body.motion.pose.origin - system.origin
        about = body.inertia + body.mass * (ca.sumsqr(arm) * eye - arm @ arm.T)
        add(body.part, ca.SX(body.mass), body.mass * arm, about)
    joints = list(system.parents)
    between, base = ca.SX(len(joints), len(joints)), ca.SX(6, len(joints))
    for k in reversed(range(len(joints))):
        mass, first, second = composites[joints[k]]
        turning, moving = system.screws[joints[k]]
        force = mass * moving + ca.cross(turning, first)
        moment = second @ turning + ca.cross(first, moving)
        part = joints[k]
        while part != "platform":
            i = joints.index(part)
            turns, moves = system.screws[part]
            between[i, k] = between[k, i] = ca.dot(turns, moment) + ca.dot(moves, force)
            part = system.parents[part]
        base[:, k] = ca.vertcat(force, moment)
        add(system.parents[joints[k]], mass, first, second)
    mass, first, second = composites["platform"]
    arms = ca.skew(first)
    platform = ca.blockcat([[mass * eye, -arms], [arms, second]])
    across = base @ system.gears
    inner = system.gears.T @ between @ system.gears + ca.diag(system.rotors)
    return ca.sparsify(ca.blockcat([[platform, across], [across.T, inner]]))


def angular_acceleration(system: Multibody, part: str, accelerations: ca.SX) -> ca.SX:
    """Return the angular acceleration of a part for rates of the generalised speeds, (3, 1)."""
    total = system.parts[part].alpha + accelerations[3:6]
    joints, rates = list(system.parents), system.gears @ accelerations[6:]
    while part != "platform":
        total += system.screws[part][0] * rates[joints.index(part)]
        part = system.parents[part]
    return total


def kinetic_energy(system: Multibody) -> ca.SX:
    """Return the kinetic energy [J]."""
    total = ca.dot(system.rotors, system.rates**2) / 2
    for body in system.bodies:
        motion = body.motion
        total += body.mass / 2 * ca.sumsqr(motion.velocity)
        total += ca.dot(motion.omega, body.inertia @ motion.omega) / 2
    for wheel in system.wheels:
        # the inertia of a body includes that of a prescribed wheel, as if it did not spin
        carried = wheel.turning**2 if wheel.prescribed else 0
        total += wheel.axial / 2 * (wheel.spin**2 - carried) + wheel.rotor / 2 * wheel.spin**2
    return total
