"""Dimensions of articulated step climbers: two bodies on a joint, three axles, in their plane.

The rear body, the platform, carries the rear and the middle axle, the front body the front axle.
x is forward, z up; tilts are nose-up from the horizontal. Positions on a body are distances ahead
of the joint, along the body, and above the joint.
"""

from __future__ import annotations

from typing import NamedTuple

from slipfree.core.errors import ModelError
from slipfree.vehicle import tree
from slipfree.vehicle.sections.disc import Disc
from slipfree.vehicle.tree import Vehicle
from slipfree.vehicle.wheel import ORIGIN

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
    inertia : float
        Moment of inertia of all wheels and rotors about the axle. [kg m2]
    """

    ahead: float
    inertia: float


class Climber(NamedTuple):
    """Dimensions of an articulated step climber.

    Attributes
    ----------
    radius : float
        Radius of all wheels. [m]
    rear_body, front_body : Body
        The bodies.
    rear, middle, front : Axle
        The axles; rear and middle on the rear body, front on the front body.
    """

    radius: float
    rear_body: Body
    front_body: Body
    rear: Axle
    middle: Axle
    front: Axle

    @property
    def axles(self) -> tuple[Axle, Axle, Axle]:
        """Rear, middle and front axle."""
        return self.rear, self.middle, self.front

    @property
    def mass(self) -> float:
        """Mass of the vehicle [kg]."""
        return self.rear_body.mass + self.front_body.mass


def climber_of(vehicle: Vehicle) -> Climber:
    """Return the dimensions of a vehicle that is an articulated step climber.

    Raises
    ------
    ModelError
        If the vehicle is not locked to a plane, or is not of two bodies on a joint with three axles
        of equal driven discs, in the order rear, middle, front.
    """
    expected = _misfit(vehicle)
    if expected:
        raise ModelError(
            f"{vehicle.name!r}: expected a step climber, with {expected}, found another vehicle; "
            "use 'step_climber' of the catalogue, or a vehicle file like it"
        )
    rear, middle, front = (Axle(w.at[1], (w.inertia or ORIGIN)[0]) for w in vehicle.wheels)
    rear_body, front_body = (_body(each) for each in (vehicle.body, vehicle.joints[0].body))
    return Climber(vehicle.wheels[0].radius, rear_body, front_body, rear, middle, front)


def _body(body: tree.Body) -> Body:
    return Body(body.mass, body.at[1], body.at[2], (body.inertia or ORIGIN)[0])


def _misfit(vehicle: Vehicle) -> str:
    """Return the property of a step climber that a vehicle lacks; empty if it has all."""
    wheels, joints, coordinates = vehicle.wheels, vehicle.joints, vehicle.coordinates
    if not vehicle.planar:
        return "a platform that is locked to a plane"
    if [w.parent for w in wheels] != ["platform", "platform", *(joint.name for joint in joints)]:
        return "two wheels on the platform and a third on the only joint"
    joint = joints[0]
    turns = (joint.axis, joint.at, joint.turned, joint.motion) == ("x", ORIGIN, ORIGIN, "turn")
    if not turns or [(c.name, c.kind) for c in coordinates] != [(joint.value, "suspension")]:
        return "a joint about x at the platform's origin, whose value is a suspension coordinate"
    if not all(isinstance(w.section, Disc) and w.driven and w.drive.takes_effort for w in wheels):
        return "discs as wheels, driven by torques"
    if len({w.radius for w in wheels}) > 1 or any(w.at[2] for w in wheels):
        return "wheels of equal radius at the height of the joint"
    if not all(w.inertia and not w.mass for w in wheels):
        return "wheels with inertia whose mass is a part of that of the bodies"
    if not all(body.mass and body.inertia for body in (vehicle.body, joint.body)):
        return "bodies with mass and inertia"
    rear, middle, front = (w.at[1] for w in wheels)
    if not rear < middle <= 0 < front:
        return "the axles rear, middle and front in this order, the joint between the last two"
    return ""
