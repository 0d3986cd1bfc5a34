"""Articulated step-climbing vehicles in the plane of their motion.

A passive joint connects two bodies: the rear body carries the rear and the middle axle, the front
body the front axle. x is forward, z up; tilts are nose-up from the horizontal. Positions on a body
are distances ahead of the joint, along the body, and above the joint.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.catalog import step_climber
from slipfree.errors import ModelError
from slipfree.geometry.frame import Pose, unit_vector
from slipfree.records import Array
from slipfree.vehicle.tree import Joint, Vehicle
from slipfree.vehicle.wheel import Wheel

LENGTH_TOLERANCE = 1e-9  # smaller lengths count as zero [m]
AXLES = ("rear", "middle", "front")


class Body(NamedTuple):
    """A rigid body connected to the joint.

    Attributes
    ----------
    mass : float
        Mass, wheels included. [kg]
    ahead, above : float
        Centre of mass relative to the joint. [m]
    inertia : float
        Moment of inertia about the centre of mass, without the rotation of the wheels. [kg m2]
    """

    mass: float
    ahead: float
    above: float
    inertia: float


class Axle(NamedTuple):
    """Axle of wheels that rotate at the same rate.

    Attributes
    ----------
    ahead : float
        Distance ahead of the joint along the body that carries it, at the height of the joint. [m]
    wheels : int
        Number of wheels, with one motor each.
    inertia : float
        Moment of inertia of all wheels and rotors about the axle. [kg m2]
    """

    ahead: float
    wheels: int
    inertia: float


@dataclass(frozen=True)
class Climber:
    """A vehicle of two bodies and three axles.

    Attributes
    ----------
    radius : float
        Radius of all wheels. [m]
    rear_body, front_body : Body
        The bodies.
    rear, middle, front : Axle
        The axles; rear and middle on the rear body, front on the front body.
    torque : float
        Largest torque of a wheel's motor; infinite for no limit. [N m]

    Raises
    ------
    ModelError
        If a mass, inertia, radius, torque or number of wheels is not positive, the radius is not
        below the distance of front and rear axle, or axles and joint are not in their order.
    """

    radius: float
    rear_body: Body
    front_body: Body
    rear: Axle
    middle: Axle
    front: Axle
    torque: float = math.inf

    def __post_init__(self) -> None:
        sizes = {"radius": self.radius, "torque": self.torque}
        for name in ("rear_body", "front_body"):
            body = getattr(self, name)
            sizes |= {f"{name}.mass": body.mass, f"{name}.inertia": body.inertia}
        for name in AXLES:
            axle = getattr(self, name)
            sizes |= {f"{name}.inertia": axle.inertia, f"{name}.wheels": axle.wheels}
        for name, value in sizes.items():
            if not value > 0:
                raise ModelError(
                    f"climber: expected a positive number as {name!r}, found {value}; increase it"
                )
        if not self.radius < self.front.ahead - self.rear.ahead:
            raise ModelError(
                "climber: expected a radius below the distance of front and rear axle, "
                f"{self.front.ahead - self.rear.ahead:g} m, found {self.radius:g} m; give lengths "
                "in metres"
            )
        order = [self.rear.ahead, self.middle.ahead, self.front.ahead]
        if not (order[0] < order[1] < order[2] and order[2] > 0 and order[1] <= 0):
            raise ModelError(
                "climber: expected the rear axle behind the middle axle, the middle axle not ahead "
                "of the joint and the front axle ahead of the joint, found axles "
                f"{order} m ahead of the joint; correct 'ahead' of the axles"
            )

    @property
    def axles(self) -> tuple[Axle, Axle, Axle]:
        """Rear, middle and front axle."""
        return self.rear, self.middle, self.front

    @property
    def mass(self) -> float:
        """Mass of the vehicle [kg]."""
        return self.rear_body.mass + self.front_body.mass


def seven_wheels(joint: float = 0.0, torque: float = math.inf) -> Climber:
    """Return the step climber of Chugo et al. (2009), in the plane.

    It is the side view of `slipfree.catalog.seven_wheels`. The paper gives no moments of inertia:
    those of the bodies are assumed to be those of boxes 250 mm high; those of the wheels with their
    rotors are estimates.

    Parameters
    ----------
    joint : float
        Distance of the joint ahead of the middle axle. [m]
    torque : float
        Largest torque of a wheel's motor. [N m]
    """
    height, lengths, masses = 0.25, (0.400, 0.195), (13.8, 7.8)
    inertias = [
        mass * (length**2 + height**2) / 12 for mass, length in zip(masses, lengths, strict=True)
    ]
    return planar(
        step_climber.seven_wheels(joint=joint),
        (inertias[0], inertias[1]),
        (0.010, 0.005, 0.010),
        torque,
    )


def planar(
    vehicle: Vehicle,
    inertias: tuple[float, float],
    spins: tuple[float, float, float],
    torque: float = math.inf,
) -> Climber:
    """Return the planar climber of a vehicle with two bodies and three axles.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle. Its platform is the rear body; the front body pitches on one suspension
        coordinate. Wheels whose axles point forward are ignored, as they do not roll in the plane.
    inertias : tuple of 2 floats
        Moments of inertia of the rear and the front body about their centres of mass, without the
        rotation of the wheels. [kg m2]
    spins : tuple of 3 floats
        Moments of inertia of the wheels and rotors of the rear, middle and front axle about the
        axle. [kg m2]
    torque : float
        Largest torque of a wheel's motor. [N m]

    Raises
    ------
    ModelError
        If the vehicle does not have three axles of equal wheels at the height of the joint, two of
        them on the rear body, or if no coordinate pitches a front body.
    """
    joint, carried = _front_body(vehicle)
    values = {c.name: ca.SX(0) for c in vehicle.coordinates}
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    hinge = _numbers(vehicle.parts(rest, values)[joint.name].origin)
    axles: dict[tuple[float, bool], list[Wheel]] = {}
    for wheel, pose in zip(vehicle.wheels, vehicle.carriers(rest, values), strict=True):
        if abs(_numbers(pose.rotation[:, 0])[0]) > 0.5:
            _, y, z = _numbers(pose.origin) - hinge
            if abs(z) > LENGTH_TOLERANCE:
                raise ModelError(
                    "planar: expected all wheels at the height of the joint, found wheel "
                    f"{wheel.name!r} {z:g} m above it; move the wheel or the joint"
                )
            axles.setdefault((round(y, 9), wheel.parent in carried), []).append(wheel)
    places = sorted(axles)
    radii = {wheel.radius for wheels in axles.values() for wheel in wheels}
    if [front for _, front in places] != [False, False, True] or len(radii) != 1:
        raise ModelError(
            "planar: expected three axles of equal wheels, two of them on the rear body, found "
            f"axles {[y for y, _ in places]} m ahead of the joint, radii {sorted(radii)} m; change "
            "the positions or radii of the wheels"
        )
    rear, middle, front = (
        Axle(y, len(axles[y, on_front]), spin)
        for (y, on_front), spin in zip(places, spins, strict=True)
    )
    bodies = [
        Body(mass, float(center[1] - hinge[1]), float(center[2] - hinge[2]), inertia)
        for (mass, center), inertia in zip(
            _bodies(vehicle, carried, rest, values), inertias, strict=True
        )
    ]
    return Climber(radii.pop(), bodies[0], bodies[1], rear, middle, front, torque)


def _front_body(vehicle: Vehicle) -> tuple[Joint, set[str]]:
    """Return the joint on which the front body pitches, and all parts that it carries."""
    yielding = {c.name for c in vehicle.of("suspension")}
    pitching = [
        joint
        for joint in vehicle.joints
        if joint.motion == "turn"
        and joint.coordinates & yielding
        and abs(unit_vector(joint.axis)[0]) == 1
    ]
    if len(pitching) != 1:
        raise ModelError(
            "planar: expected one turning joint of the suspension with an axis exactly along x "
            "(sideways), which pitches the front body, found "
            f"{[joint.name for joint in pitching] or 'none'} in {vehicle.name!r}; give the vehicle "
            "one such joint"
        )
    carried = {pitching[0].name}
    for joint in vehicle.joints:
        if joint.parent in carried:
            carried.add(joint.name)
    return pitching[0], carried


def _bodies(
    vehicle: Vehicle, carried: set[str], rest: Pose, values: dict[str, ca.SX]
) -> Iterator[tuple[float, Array]]:
    """Yield mass and centre of mass of the rear body and of the front body."""
    for on_front in (False, True):
        masses = [
            (mass, _numbers(at))
            for part, mass, at in vehicle.masses(rest, values)
            if (part in carried) == on_front
        ]
        total = sum(mass for mass, _ in masses)
        yield total, np.sum([mass * at for mass, at in masses], axis=0) / total


def _numbers(vector: ca.SX) -> Array:
    return np.array(ca.evalf(vector)).ravel()
