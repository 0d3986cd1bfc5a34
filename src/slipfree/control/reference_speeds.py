"""Reference speeds of the axles of a climbing vehicle, from its body configuration.

This module implements the law of Chugo, Kawabata, Kaetsu, Asama and Mishima, "Omni-directional
vehicle control based on body configuration", Industrial Robot 36(5), 2009, in a form that is valid
in every phase of a climb, and, for comparison, the equations as printed, which are not. Every axle
i moves with speed v_i along its own direction phi_i, upward from the horizontal: 0 on a floor, pi/2
at a wall. With the tilts th_r and th_f of the bodies, the indices R, M and F of the rear, middle
and front axle, and the joint at distance d ahead of the middle axle,

    v_R cos(phi_R - th_r) = v_M cos(phi_M - th_r)                             rear link
    v_F cos(phi_F - th_f) = v_M cos(phi_M - th_f) + d th_r' sin(th_f - th_r)  front link
    L th_r' = s sin(phi_M - phi_R)   where   (v_R, v_M) = s (cos(phi_M - th_r), cos(phi_R - th_r))

where L is the distance of the rear and middle axle and s a common factor. The paper has one angle
for all axles: (6) assumes the middle axle on the slope, (8) on the floor. All functions take SX or
numbers, and return SX or `casadi.DM`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import casadi as ca

from slipfree.terrain.solids import Profile
from slipfree.vehicle.climber import Climber

MIN_MIDDLE_SPEED = 1e-3  # lower bound of the middle axle's relative speed as a divisor
GUIDE_GAP, GUIDE_WIDTH = 1.5e-3, 6e-4  # gap below which a solid guides a wheel, and transition [m]
MIN_RIM_SPEED = 0.05  # lower bound of the rim speed in the estimates of directions [m/s]
MAX_SINE = 0.985  # largest sine of an estimated direction
Law = Literal["projective", "fixed", "printed_6_8", "printed_14", "printed_16"]


class PerAxle(NamedTuple):
    """One value for each axle."""

    rear: Any
    middle: Any
    front: Any


class Tilts(NamedTuple):
    """Tilts of the bodies, nose up, or their rates [rad, rad/s].

    In the paper, the tilt sensor measures ``rear`` (th_b), the potentiometer ``rear - front``
    (-th_a).
    """

    rear: Any
    front: Any


def ratios(climber: Climber, tilts: Tilts, directions: PerAxle) -> PerAxle:
    """Return the speed ratios of the axles without slip, computed without divisions.

    Parameters
    ----------
    climber : Climber
        The vehicle.
    tilts : Tilts
        Tilts of its bodies. [rad]
    directions : PerAxle
        Directions of motion of its axles. [rad]

    Returns
    -------
    PerAxle
        Speeds of the axles up to a common factor; all zero if the axles cannot move without slip.
    """
    to_joint = -climber.middle.ahead
    link = climber.middle.ahead - climber.rear.ahead
    rear = ca.cos(directions.rear - tilts.rear)
    middle = ca.cos(directions.middle - tilts.rear)
    front = ca.cos(directions.front - tilts.front)
    turning = ca.sin(directions.middle - directions.rear) * ca.sin(tilts.front - tilts.rear)
    ahead = rear * ca.cos(directions.middle - tilts.front) + to_joint / link * turning
    return PerAxle(middle * front, rear * front, ahead)


def capped(speeds: PerAxle, cap: float) -> PerAxle:
    """Return axle speeds relative to that of the middle axle, none above ``cap``.

    If the speed of another axle exceeds ``cap`` times that of the middle axle, all speeds are
    reduced by a common factor; that of the middle axle is zero if it cannot move, as with the front
    axle at a wall.
    """
    column = ca.vertcat(*speeds)
    size = ca.fmax(ca.fabs(column[1]), ca.mmax(ca.fabs(column)) / cap)
    return PerAxle(*ca.vertsplit(column / ca.fmax(size, MIN_MIDDLE_SPEED)))


def reference(
    climber: Climber, tilts: Tilts, directions: PerAxle, law: Law = "projective", cap: float = 1.5
) -> PerAxle:
    """Return the reference speeds of the axles, relative to the vehicle's speed.

    Parameters
    ----------
    climber : Climber
        The vehicle.
    tilts : Tilts
        Tilts of its bodies. [rad]
    directions : PerAxle
        Directions of motion of its axles. [rad]
    law : {"projective", "fixed", "printed_6_8", "printed_14", "printed_16"}
        ``"projective"``: no slip in every phase; ``"fixed"``: speed one for all axles. The other
        laws are equations of the paper as printed, for comparison: (6) with (8), the pseudo-inverse
        (15) of (14), and (16). Their single angle alpha is the largest direction.
    cap : float
        Largest relative speed, at least 1; not used by ``"printed_14"``.
    """
    if law == "fixed":
        return PerAxle(ca.SX(1), ca.SX(1), ca.SX(1))
    if law == "projective":
        return capped(ratios(climber, tilts, directions), cap)
    return _PRINTED[law](tilts, ca.mmax(ca.vertcat(*directions)), cap)


def _cosines(tilts: Tilts, alpha: Any) -> tuple[Any, Any, Any, Any]:
    """Return numerator and denominator of (6), then of (8), with tilts th_b and th_a + th_b."""
    rear = ca.cos(alpha - tilts.rear), ca.cos(tilts.rear)
    return *rear, ca.cos(tilts.front), ca.cos(alpha - tilts.front)


def _printed_6_8(tilts: Tilts, alpha: Any, cap: float) -> PerAxle:
    a, b, c, d = _cosines(tilts, alpha)
    return capped(PerAxle(a / b * d, d, c), cap)


def _printed_14(tilts: Tilts, alpha: Any, _cap: float) -> PerAxle:
    """Return the speed ratios of the axles by equation (15), from (14) as printed."""
    a, b, c, d = _cosines(tilts, alpha)
    first, square = a / b, d**2
    size = 5 / (2 * first**2 * square + square + 2 * c**2)
    return PerAxle(first * square * size, square * size, c * d * size)


def _printed_16(tilts: Tilts, alpha: Any, cap: float) -> PerAxle:
    a, b, c, d = _cosines(tilts, alpha)
    return capped(PerAxle(b / a * c, c, d), cap)


_PRINTED: dict[str, Callable[[Tilts, Any, float], PerAxle]] = {
    "printed_6_8": _printed_6_8,
    "printed_14": _printed_14,
    "printed_16": _printed_16,
}


def estimated_directions(climber: Climber, tilts: Tilts, rates: Tilts, spins: PerAxle) -> PerAxle:
    """Return estimates of the axles' directions from tilt sensors and encoders.

    The tilt rate of a link gives the vertical speed of its axle; divided by the rim speed it is the
    sine of the direction. The sign of the rear body's tilt rate decides which of its two axles
    climbs. The estimates do not require the slope or height of the obstacle. The controller smooths
    them.

    Parameters
    ----------
    climber : Climber
        The vehicle.
    tilts, rates : Tilts
        Tilts of its bodies and their rates. [rad, rad/s]
    spins : PerAxle
        Rates of its wheels. [rad/s]
    """
    link = climber.middle.ahead - climber.rear.ahead
    turn = ca.cos(tilts.rear) * rates.rear
    middle = ca.fmax(0, link * turn)
    swing = climber.front.ahead * ca.cos(tilts.front) * rates.front
    rises = PerAxle(ca.fmax(0, -link * turn), middle, middle - climber.middle.ahead * turn + swing)
    sines = (
        rise / ca.fmax(climber.radius * ca.fabs(spin), MIN_RIM_SPEED)
        for rise, spin in zip(rises, spins, strict=True)
    )
    return PerAxle(*(ca.asin(ca.fmin(MAX_SINE, ca.fmax(0, sine))) for sine in sines))


def directions(profile: Profile, radius: float, axles: PerAxle) -> PerAxle:
    """Return the angles above the horizontal in which the axles can move forward [rad].

    The direction of an axle is the steepest upward tangent of the solids near its wheels: wheels
    that touch floor and wall move up the wall. They move downhill, as over an edge, only if no
    other solid supports them.

    Parameters
    ----------
    profile : Profile
        The ground.
    radius : float
        Radius of the wheels. [m]
    axles : PerAxle of SX, shape (2, 1)
        Positions of the axles. [m]
    """
    return PerAxle(*(_direction(profile, radius, axle) for axle in axles))


def _direction(profile: Profile, radius: float, axle: ca.SX) -> ca.SX:
    up, down, free = ca.SX(0), ca.SX(0), ca.SX(1)
    for solid in profile.solids:
        distance, normal = solid.gap(axle[0], axle[1])
        near = (1 - ca.tanh((distance - radius - GUIDE_GAP) / GUIDE_WIDTH)) / 2
        slope = ca.atan2(-normal[0], normal[1])
        up = ca.fmax(up, near * slope)
        down = ca.fmin(down, near * slope)
        free *= ca.if_else(slope >= 0, 1 - near, 1)
    return up + down * free
