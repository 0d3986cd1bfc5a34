"""Articulated step-climbing vehicles in the plane of their motion.

A passive joint connects two bodies: the rear body carries the rear and the middle axle, the front
body the front axle. x is forward, z up; tilts are nose-up from the horizontal. Positions on a body
are distances ahead of the joint, along the body, and above the joint.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from slipfree.errors import ModelError
from slipfree.vehicle import tree
from slipfree.vehicle.drives import Torque
from slipfree.vehicle.sections.disc import Disc
from slipfree.vehicle.tree import GRAVITY, Coordinate, Joint, Vehicle, planar
from slipfree.vehicle.wheel import Wheel

AXLES = ("rear", "middle", "front")
FOLD = "fold"  # coordinate of the joint between the bodies


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
    stiffness : float
        Stiffness of the contacts of an axle's wheels with the ground. [N/m]

    Raises
    ------
    ModelError
        If a mass, inertia, radius, torque, stiffness or number of wheels is not positive, the
        radius is not below the distance of front and rear axle, or axles and joint are not in their
        order.
    """

    radius: float
    rear_body: Body
    front_body: Body
    rear: Axle
    middle: Axle
    front: Axle
    torque: float = math.inf
    stiffness: float = 1.5e5

    def __post_init__(self) -> None:
        sizes = {name: getattr(self, name) for name in ("radius", "torque", "stiffness")}
        for name in ("rear_body", "front_body"):
            body = getattr(self, name)
            sizes |= {f"{name}.mass": body.mass, f"{name}.inertia": body.inertia}
        for name in AXLES:
            axle = getattr(self, name)
            sizes |= {f"{name}.inertia": axle.inertia, f"{name}.wheels": axle.wheels}
        for name, value in sizes.items():
            if not value > 0:
                raise ModelError(
                    f"climber: expected a positive number for {name!r}, found {value}; increase it"
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

    @property
    def static_depth(self) -> float:
        """Depth of an axle's wheels in the ground under a third of the weight [m]."""
        return self.mass * GRAVITY / len(AXLES) / self.stiffness


def side_view(climber: Climber) -> Vehicle:
    """Return a step climber as a planar vehicle with one driven disc per axle.

    The platform is the rear body; its origin is the joint. The inputs in dynamics are the total
    torques of the axles.

    Parameters
    ----------
    climber : Climber
        The step climber.
    """
    parts = ("platform", "platform", "front_body")
    wheels = tuple(
        Wheel(
            name,
            part,
            (0.0, axle.ahead, 0.0),
            Disc(climber.radius),
            driven=True,
            drive=Torque(),
            static_depth=climber.static_depth,
            inertia=(axle.inertia, axle.inertia),  # the second has no effect in the plane
        )
        for name, part, axle in zip(AXLES, parts, climber.axles, strict=True)
    )
    rear, front = (
        tree.Body(each.mass, (0.0, each.ahead, each.above), 3 * (each.inertia,) + 3 * (0.0,))
        for each in (climber.rear_body, climber.front_body)
    )
    fold = Coordinate(FOLD, "suspension", "pitch of the front body relative to the rear body")
    joint = Joint("front_body", "platform", "x", (0.0, 0.0, 0.0), FOLD, body=front)
    return planar(Vehicle("step_climber", (fold,), (joint,), wheels, rear))
