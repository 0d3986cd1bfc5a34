"""Forces between wheels and the solids of a profile: compliant, damped, with friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from slipfree.climb.profile import Profile
from slipfree.errors import ModelError

NEAR, FADE = 1.5e-3, 6e-4  # gap at which a solid begins to lead a wheel, and how softly [m]


@dataclass(frozen=True)
class CompliantContact:
    """The law of the contacts.

    Attributes
    ----------
    stiffness : float
        Of a contact. [N/m]
    damping : float
        Of Hunt and Crossley: the normal force is ``k s max(0, 1 + c s')`` at the depth s. [s/m]
    static, dynamic : float
        Coefficients of friction, at rest and at speed.
    creep : float
        Slip speed at which friction is nearly full. [m/s]
    stribeck : float
        Slip speed over which friction falls from the static to the dynamic one. [m/s]

    Raises
    ------
    ModelError
        If a number is not positive, or friction grows with speed.
    """

    stiffness: float = 1.5e5
    damping: float = 10.0
    static: float = 0.4
    dynamic: float = 0.3
    creep: float = 5e-4
    stribeck: float = 0.01

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0 and name != "damping":
                raise ModelError(f"contact: {name} must be positive, found {value}")
        if not (self.damping >= 0 and self.static >= self.dynamic):
            raise ModelError(
                "contact: expected damping from 0 on and static friction not below the dynamic "
                f"one, found {self.damping} s/m, {self.static} and {self.dynamic}"
            )


class Pressed(NamedTuple):
    """What one solid does to one wheel.

    Attributes
    ----------
    gap : SX
        Of its rim to the solid. [m]
    normal : SX, shape (2, 1)
        From the solid.
    tangent : SX, shape (2, 1)
        Forward for a wheel on a floor.
    load, friction : SX
        Forces along normal and tangent. [N]
    slip : SX
        Speed of the rim over the solid along the tangent; negative if the wheel spins. [m/s]
    stored : SX
        Energy of the compression. [J]
    damped : SX
        Power lost to damping. [W]
    """

    gap: ca.SX
    normal: ca.SX
    tangent: ca.SX
    load: ca.SX
    friction: ca.SX
    slip: ca.SX
    stored: ca.SX
    damped: ca.SX


def pressed(
    profile: Profile,
    law: CompliantContact,
    radius: float,
    place: ca.SX,
    velocity: ca.SX,
    spin: ca.SX,
) -> tuple[Pressed, ...]:
    """Return what every solid of a profile does to a wheel.

    Parameters
    ----------
    profile : Profile
        The ground.
    law : CompliantContact
        The law.
    radius : float
        Of the wheel. [m]
    place, velocity : SX, shape (2, 1)
        Of the wheel's center. [m, m/s]
    spin : SX
        Rate of the wheel, forward positive. [rad/s]
    """
    found = []
    for solid in profile.solids:
        distance, normal = solid.gap(place[0], place[1])
        tangent = ca.vertcat(normal[1], -normal[0])
        depth, sinking = radius - distance, -ca.dot(velocity, normal)
        elastic = law.stiffness * ca.fmax(depth, 0)
        load = elastic * ca.fmax(0, 1 + law.damping * sinking)
        slip = ca.dot(velocity, tangent) - radius * spin
        fading = ca.exp(-((slip / law.stribeck) ** 2))
        grip = law.dynamic + (law.static - law.dynamic) * fading
        friction = -grip * load * slip / ca.sqrt(slip**2 + law.creep**2)
        stored = elastic**2 / (2 * law.stiffness)
        damped = (load - elastic) * sinking
        found.append(Pressed(-depth, normal, tangent, load, friction, slip, stored, damped))
    return tuple(found)


def direction(contacts: tuple[Pressed, ...]) -> ca.SX:
    """Return the direction in which the contacts of a wheel let it go forward. [rad].

    The steepest of those that are near: a wheel on the floor at a wall goes up the wall. Downhill,
    as over an edge, only if no other solid holds it up.
    """
    up, down, free = ca.SX(0), ca.SX(0), ca.SX(1)
    for each in contacts:
        near = (1 - ca.tanh((each.gap - NEAR) / FADE)) / 2
        slope = ca.atan2(-each.normal[0], each.normal[1])
        up = ca.fmax(up, near * slope)
        down = ca.fmin(down, near * slope)
        free *= ca.if_else(slope >= 0, 1 - near, 1)
    return up + down * free
