"""Mechanics of a tree of rigid bodies: mass matrix and bias forces in symbolic form.

Generalised speeds are the velocity of the platform's origin, the platform's angular velocity, both
in fixed axes, and the rates of the vehicle's coordinates; speeds that are zero in a plane are left
out. The mass matrix is the second derivative of the kinetic energy with respect to these speeds.
Generalised forces are those whose power is that of the loads, which reverse differentiation of the
parts' velocities sums from the leaves to the root, as the recursive Newton-Euler algorithm does
(Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 5). Vectors are in fixed axes.

A wheel contributes its mass and its transverse inertia to the part that carries it. Its spin is a
separate speed, since a body of revolution has the same inertia in every position.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import casadi as ca

from slipfree.geometry.frame import Pose, unit_vector
from slipfree.vehicle.formula import evaluate
from slipfree.vehicle.tree import Vehicle, Wheel, body_inertia, body_of, wheel_inertia

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
    """A part with its wheels, as one rigid body.

    Mass [kg]; first moment of mass [kg m] and inertia tensor [kg m^2] about the part's origin.
    """

    mass: float
    first: ca.SX
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
        return self.speed - self.turning if self.prescribed else self.speed


class Load(NamedTuple):
    """Force on a part [N], and its moment about the part's origin [N m], in fixed axes."""

    part: str
    force: ca.SX
    moment: ca.SX


class Multibody(NamedTuple):
    """A vehicle as a system of rigid bodies, in the symbols of a model.

    ``parts`` are the motions of the platform and of the parts of all joints. ``speeds`` are the
    generalised speeds, ``rates`` those of the coordinates, ``rotors`` the inertias of their drives
    [kg m^2, kg]. ``bodies`` are the parts as rigid bodies; ``gravity`` acts on them [m/s^2].
    """

    parts: dict[str, PartMotion]
    speeds: ca.SX
    rates: ca.SX
    rotors: ca.DM
    bodies: dict[str, RigidBody]
    wheels: tuple[WheelMotion, ...]
    gravity: float


def multibody(
    vehicle: Vehicle, platform: Pose, coordinates: Mapping[str, ca.SX], speeds: Speeds
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
    rates = ca.jtimes(values, column, speeds.rates)
    changes = ca.jtimes(rates, column, speeds.rates)  # second derivatives at constant rates
    for joint, rate, change in zip(vehicle.joints, _entries(rates), _entries(changes), strict=True):
        pose = poses[joint.name]
        axis, on = pose.rotation @ ca.DM(unit_vector(joint.axis)), parts[joint.parent].at(pose)
        if joint.motion == "turn":
            parts[joint.name] = on._replace(
                omega=on.omega + axis * rate,
                alpha=on.alpha + ca.cross(on.omega, axis) * rate + axis * change,
            )
        else:
            parts[joint.name] = on._replace(
                velocity=on.velocity + axis * rate,
                # Coriolis, and the second derivative of the formula of the joint
                acceleration=on.acceleration + 2 * ca.cross(on.omega, axis) * rate + axis * change,
            )
    bodies, wheels = dict[str, RigidBody](), list[WheelMotion]()
    for part, motion in parts.items():
        body, rotation, eye = body_of(vehicle, part), motion.pose.rotation, ca.SX.eye(3)
        masses = [(body.mass, ca.SX(ca.DM(body.at)), ca.SX(ca.DM(body_inertia(vehicle, part))))]
        for wheel in (each for each in vehicle.wheels if each.parent == part):
            axial, across = wheel_inertia(wheel)
            about = wheel.mount.rotation[:, 0] @ wheel.mount.rotation[:, 0].T
            own = across * (eye - about) + axial * about * wheel.acting_drive.prescribed
            masses.append((wheel.mass, wheel.mount.origin, own))
        first = sum((mass * at for mass, at, _ in masses), ca.SX.zeros(3))
        tensor = sum(own + mass * (ca.sumsqr(at) * eye - at @ at.T) for mass, at, own in masses)
        turned = rotation @ ca.sparsify(tensor) @ rotation.T
        bodies[part] = RigidBody(sum(mass for mass, *_ in masses), rotation @ first, turned)
    for wheel, speed in zip(vehicle.wheels, speeds.wheels, strict=True):
        drive, carrier = wheel.acting_drive, parts[wheel.parent]
        moving = wheel, carrier.at(carrier.pose @ wheel.mount), wheel_inertia(wheel)[0]
        wheels.append(WheelMotion(*moving, drive.added_inertia, speed, drive.prescribed))
    rotors = ca.DM([c.acting_drive.added_inertia for c in vehicle.coordinates])
    every = ca.vertsplit(ca.vertcat(speeds.velocity, speeds.omega, speeds.rates))
    free = ca.vertcat(*(each for each in every if each.is_symbolic()))
    return Multibody(parts, free, speeds.rates, rotors, bodies, tuple(wheels), vehicle.gravity)


def _entries(column: ca.SX) -> list[ca.SX]:
    return list(ca.vertsplit(column)) if column.numel() else []


def generalised_forces(system: Multibody, loads: Iterable[Load]) -> ca.SX:
    """Return the generalised forces of loads on the parts, a column as the generalised speeds."""
    sums = {part: (ca.SX.zeros(3), ca.SX.zeros(3)) for part in system.parts}
    for part, force, moment in loads:
        forces, moments = sums[part]
        sums[part] = forces + force, moments + moment
    twists = [vector for each in system.parts.values() for vector in (each.velocity, each.omega)]
    wrenches = [vector for both in sums.values() for vector in both]
    found = ca.jtimes(ca.vertcat(*twists), system.speeds, ca.vertcat(*wrenches), True)
    return ca.densify(found)


def bias_forces(system: Multibody) -> ca.SX:
    """Return the generalised inertial forces at constant speeds, minus the forces of gravity.

    The equations of motion are ``M u' + bias = Q``, with the generalised forces ``Q`` of drives,
    springs and ground.
    """
    loads = list[Load]()
    for part, (mass, first, inertia) in system.bodies.items():
        _, _, omega, acceleration, alpha = system.parts[part]
        lifted = acceleration + system.gravity * UP
        force = mass * lifted + ca.cross(alpha, first) + ca.cross(omega, ca.cross(omega, first))
        moment = ca.cross(first, lifted) + inertia @ alpha + ca.cross(omega, inertia @ omega)
        loads.append(Load(part, force, moment))
    for wheel in system.wheels:
        # the wheel's angular momentum, -axial * speed * axle, turns with its carrier
        moment = -wheel.axial * wheel.speed * ca.cross(wheel.motion.omega, wheel.axle)
        loads.append(Load(wheel.wheel.parent, ca.SX.zeros(3), moment))
    return generalised_forces(system, loads)


def mass_matrix(system: Multibody) -> ca.SX:
    """Return the mass matrix; its rows are in the order of the generalised speeds."""
    return ca.sparsify(ca.hessian(kinetic_energy(system), system.speeds)[0])


def angular_acceleration(system: Multibody, part: str, accelerations: ca.SX) -> ca.SX:
    """Return the angular acceleration of a part for rates of the generalised speeds, (3, 1)."""
    motion = system.parts[part]
    return motion.alpha + ca.jtimes(motion.omega, system.speeds, accelerations)


def kinetic_energy(system: Multibody) -> ca.SX:
    """Return the kinetic energy [J]."""
    total = ca.dot(system.rotors, system.rates**2) / 2
    for part, (mass, first, inertia) in system.bodies.items():
        _, velocity, omega, *_ = system.parts[part]
        total += mass / 2 * ca.sumsqr(velocity) + ca.dot(velocity, ca.cross(omega, first))
        total += ca.dot(omega, inertia @ omega) / 2
    for wheel in system.wheels:
        # the inertia of a body includes that of a prescribed wheel, as if it did not spin
        carried = wheel.turning**2 if wheel.prescribed else 0
        total += wheel.axial / 2 * (wheel.spin**2 - carried) + wheel.rotor / 2 * wheel.spin**2
    return total
