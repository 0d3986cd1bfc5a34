"""Compliant contacts with damping and friction between wheels and solids such as steps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from slipfree.errors import ModelError
from slipfree.terrain.solids import Profile

GUIDE_GAP, GUIDE_WIDTH = 1.5e-3, 6e-4  # gap below which a solid guides a wheel, and transition [m]


@dataclass(frozen=True)
class CompliantContact:
    """Compliant contact law with Hunt-Crossley damping and Stribeck friction.

    Attributes
    ----------
    stiffness : float
        Stiffness of a contact. [N/m]
    damping : float
        Damping ``c`` of Hunt and Crossley: the normal force at depth ``s`` is ``k s max(0, 1 + c
        s')``, with the stiffness ``k``. [s/m]
    static, dynamic : float
        Static and kinetic coefficients of friction. [1]
    creep : float
        Slip speed at which friction is almost fully developed. [m/s]
    stribeck : float
        Slip speed over which friction decreases from the static to the kinetic value. [m/s]

    Raises
    ------
    ModelError
        If the damping is negative, another number is not positive, or the kinetic friction exceeds
        the static friction.
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
                raise ModelError(
                    f"contact: expected a positive number as {name!r}, found {value}; increase it"
                )
        if not (self.damping >= 0 and self.static >= self.dynamic):
            raise ModelError(
                "contact: expected a damping of at least 0 and a static friction not below the "
                f"kinetic friction, found damping {self.damping} s/m, static {self.static}, "
                f"kinetic {self.dynamic}; change these numbers"
            )


class SolidContact(NamedTuple):
    """Contact of one wheel with one solid.

    Attributes
    ----------
    gap : SX
        Distance of the rim from the solid, negative in contact. [m]
    normal : SX, shape (2, 1)
        Outward unit normal of the solid.
    tangent : SX, shape (2, 1)
        Unit tangent, forward on a floor.
    load, friction : SX
        Forces along normal and tangent. [N]
    slip : SX
        Velocity of the rim over the solid along the tangent; negative if the wheel turns too fast.
        [m/s]
    stored : SX
        Elastic energy. [J]
    damped : SX
        Power dissipated by damping. [W]
    """

    gap: ca.SX
    normal: ca.SX
    tangent: ca.SX
    load: ca.SX
    friction: ca.SX
    slip: ca.SX
    stored: ca.SX
    damped: ca.SX


def wheel_contacts(
    profile: Profile,
    law: CompliantContact,
    radius: float,
    place: ca.SX,
    velocity: ca.SX,
    spin: ca.SX,
) -> tuple[SolidContact, ...]:
    """Return the contacts of a wheel with all solids of a profile.

    Parameters
    ----------
    profile : Profile
        The ground.
    law : CompliantContact
        The contact law.
    radius : float
        Radius of the wheel. [m]
    place, velocity : SX, shape (2, 1)
        Position and velocity of the wheel's centre. [m, m/s]
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
        found.append(SolidContact(-depth, normal, tangent, load, friction, slip, stored, damped))
    return tuple(found)


def direction(contacts: tuple[SolidContact, ...]) -> ca.SX:
    """Return the direction in which a wheel can move forward, upward from the horizontal [rad].

    It is the steepest upward tangent of the solids near the wheel: a wheel that touches floor and
    wall moves up the wall. A wheel moves downhill, as over an edge, only if no other solid supports
    it.
    """
    up, down, free = ca.SX(0), ca.SX(0), ca.SX(1)
    for each in contacts:
        near = (1 - ca.tanh((each.gap - GUIDE_GAP) / GUIDE_WIDTH)) / 2
        slope = ca.atan2(-each.normal[0], each.normal[1])
        up = ca.fmax(up, near * slope)
        down = ca.fmin(down, near * slope)
        free *= ca.if_else(slope >= 0, 1 - near, 1)
    return up + down * free
