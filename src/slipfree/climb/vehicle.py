"""Articulated vehicles that climb steps, in the plane of their motion.

Two bodies share a passive joint: the rear one carries the rear and the middle axle, the front one
the front axle. x is forward, z up; tilts count nose-up from the horizontal. Places on a body are
given by distances ahead of the joint along it and above it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from slipfree.errors import ModelError

GRAVITY = 9.81  # [m/s2]
AXLES = ("rear", "middle", "front")


class Body(NamedTuple):
    """A rigid body on the joint.

    Attributes
    ----------
    mass : float
        With its wheels. [kg]
    ahead, above : float
        Of its centre of mass, from the joint. [m]
    inertia : float
        About its centre of mass, its wheels' spin left out. [kg m2]
    """

    mass: float
    ahead: float
    above: float
    inertia: float


class Axle(NamedTuple):
    """Wheels side by side that turn alike.

    Attributes
    ----------
    ahead : float
        Of the joint, along the body that carries it; at the joint's height. [m]
    wheels : int
        How many wheels, a motor each.
    inertia : float
        Of all of them and their rotors, about the axle. [kg m2]
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
        Of all wheels. [m]
    rear_body, front_body : Body
        The bodies.
    rear, middle, front : Axle
        The first two on the rear body, the last on the front body.
    torque : float
        Largest torque of a wheel's motor; infinite if it never limits. [N m]

    Raises
    ------
    ModelError
        If a mass, inertia, radius, torque or number of wheels is not positive, or the axles are not
        in the order of their names.
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
                raise ModelError(f"climber: {name} must be positive, found {value}")
        if not self.radius < self.front.ahead - self.rear.ahead:
            raise ModelError(
                "climber: expected a radius below the distance of front and rear axle, "
                f"{self.front.ahead - self.rear.ahead:g} m, found {self.radius:g} m; in metres?"
            )
        order = [self.rear.ahead, self.middle.ahead, self.front.ahead]
        if not (order[0] < order[1] < order[2] and order[2] > 0 and order[1] <= 0):
            raise ModelError(
                "climber: expected the rear axle behind the middle one, that not ahead of the "
                f"joint, and the front axle ahead of it, found {order} m ahead of the joint"
            )

    @property
    def axles(self) -> tuple[Axle, Axle, Axle]:
        """Rear, middle and front axle."""
        return self.rear, self.middle, self.front

    @property
    def mass(self) -> float:
        """Mass of the whole [kg]."""
        return self.rear_body.mass + self.front_body.mass


def seven_wheels(joint: float = 0.0, torque: float = math.inf) -> Climber:
    """Return the step climber of Chugo et al. (2009), in the plane.

    Wheel radius, spacings and masses are those of the paper. What its text leaves open is assumed:
    bodies whose ends are flush with the tyres, with their centres of mass in the middle, 50 mm
    above the axles, inertias of boxes 250 mm high, and the wheels' inertias with their rotors'.

    Parameters
    ----------
    joint : float
        How far the joint is ahead of the middle axle. [m]
    torque : float
        Largest torque of a wheel's motor. [N m]
    """
    radius, behind, ahead = 0.066, 0.215, 0.255
    lengths, masses, height, above = (0.400, 0.195), (13.8, 7.8), 0.25, 0.05
    inertias = [mass * (length**2 + height**2) / 12
                for mass, length in zip(masses, lengths, strict=True)]  # fmt: skip
    rear_center = -(behind + joint) - radius + lengths[0] / 2
    front_center = ahead - joint + radius - lengths[1] / 2
    return Climber(
        radius,
        Body(masses[0], rear_center, above, inertias[0]),
        Body(masses[1], front_center, above, inertias[1]),
        Axle(-(behind + joint), 2, 0.010),
        Axle(-joint, 1, 0.005),
        Axle(ahead - joint, 2, 0.010),
        torque,
    )
