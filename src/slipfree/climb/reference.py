"""Reference speeds of the axles of a vehicle that climbs, from the shape of its body.

The law that Chugo, Kawabata, Kaetsu, Asama and Mishima, "Omni-directional vehicle control based on
body configuration", Industrial Robot 36(5), 2009, are after, in a form that holds in every phase of
a climb, and their laws as printed, which do not. Every axle i moves with speed v_i along its own
direction phi_i, up from the horizontal: 0 on a floor, pi/2 at a wall. With the tilts th_r and th_f
of the bodies, R, M, F for the axles, and the joint d ahead of the middle axle,

    v_R cos(phi_R - th_r) = v_M cos(phi_M - th_r)                             rear link
    v_F cos(phi_F - th_f) = v_M cos(phi_M - th_f) + d th_r' sin(th_f - th_r)  front link
    L th_r' = s sin(phi_M - phi_R)   where   (v_R, v_M) = s (cos(phi_M - th_r), cos(phi_R - th_r))

in which the paper has one angle for all axles: its (6) sees the middle axle on the slope, its (8)
on the floor. Everything here takes SX or numbers, and returns SX or `casadi.DM`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, NamedTuple, get_args

import casadi as ca

from slipfree.climb.vehicle import Climber
from slipfree.errors import ModelError

SLOWEST = 1e-3  # of the middle axle, relative to the others, in a scale that divides by it
CREEPING = 0.05  # rim speed below which directions are not estimated any better [m/s]
STEEPEST = 0.985  # sine of a direction that is estimated
Law = Literal["projective", "fixed", "printed_6_8", "printed_14", "printed_16"]


class PerAxle(NamedTuple):
    """One value for each axle."""

    rear: Any
    middle: Any
    front: Any


class Tilts(NamedTuple):
    """Tilts of the bodies, nose up, or their rates. [rad, rad/s].

    The paper's tilt sensor reads ``rear``, th_b; its potentiometer ``rear - front``, -th_a.
    """

    rear: Any
    front: Any


def ratios(climber: Climber, tilts: Tilts, directions: PerAxle) -> PerAxle:
    """Return the ratios of the speeds at which no wheel slips, without a division.

    Parameters
    ----------
    climber : Climber
        The vehicle.
    tilts : Tilts
        Of its bodies. [rad]
    directions : PerAxle
        Of the motion of its axles. [rad]

    Returns
    -------
    PerAxle
        Speeds of the axles up to a common factor, zero too if no other is possible.
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
    """Return speeds scaled so that the middle axle's is one, but none is above ``cap``.

    At a wall the speeds of the other axles are zero, so that the front one's alone is left.
    """
    column = ca.vertcat(*speeds)
    size = ca.fmax(ca.fabs(column[1]), ca.mmax(ca.fabs(column)) / cap)
    return PerAxle(*ca.vertsplit(column / ca.fmax(size, SLOWEST)))


def reference(
    climber: Climber, tilts: Tilts, directions: PerAxle, law: Law = "projective", cap: float = 1.5
) -> PerAxle:
    """Return the reference speeds of the axles, relative to the vehicle's.

    Parameters
    ----------
    climber : Climber
        The vehicle.
    tilts : Tilts
        Of its bodies. [rad]
    directions : PerAxle
        Of the motion of its axles. [rad]
    law : {"projective", "fixed", "printed_6_8", "printed_14", "printed_16"}
        Without slip in every phase; one for all axles; or, to show that they fail, the paper's
        equations as printed, their one angle alpha the largest of the directions: (6) with (8), the
        pseudo-inverse of (14) that (15) asks for, and (16).
    cap : float
        Largest relative speed, from 1 on; (14) sets its own scale.

    Raises
    ------
    ModelError
        If the law is not known or the cap below one.
    """
    if law not in get_args(Law):
        raise ModelError(f"reference: expected one of {', '.join(get_args(Law))}, found {law!r}")
    if not cap >= 1:
        raise ModelError(f"reference: the cap must be at least 1, found {cap}")
    if law == "fixed":
        return PerAxle(ca.SX(1), ca.SX(1), ca.SX(1))
    if law == "projective":
        return capped(ratios(climber, tilts, directions), cap)
    return _PRINTED[law](tilts, ca.mmax(ca.vertcat(*directions)), cap)


class _Cosines(NamedTuple):
    """Numerators and denominators of the printed ratios (6), rear, and (8), front."""

    rear_over: Any
    rear_under: Any
    front_over: Any
    front_under: Any


def _cosines(tilts: Tilts, alpha: Any) -> _Cosines:
    """Return the cosines of (6) and (8): th_b is the rear tilt, th_a + th_b the front one."""
    return _Cosines(
        ca.cos(alpha - tilts.rear),
        ca.cos(tilts.rear),
        ca.cos(tilts.front),
        ca.cos(alpha - tilts.front),
    )


def _printed_6_8(tilts: Tilts, alpha: Any, cap: float) -> PerAxle:
    a, b, c, d = _cosines(tilts, alpha)
    return capped(PerAxle(a / b * d, d, c), cap)


def _printed_14(tilts: Tilts, alpha: Any, _cap: float) -> PerAxle:
    """Return the first column of the Moore-Penrose inverse of (14): its rows are orthogonal."""
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


class Base(NamedTuple):
    """What the seven wheels share in the plane of the floor; wheels are numbered as in the paper.

    1 and 3 are on the rear axle, 4 on the middle one, 5 and 7 on the front one; 2 and 6 roll
    sideways. Motors of a pair turn against each other as the vehicle goes ahead, (2) and (3).

    Attributes
    ----------
    radius : float
        Of the wheels. [m]
    gear : float
        Rate of a wheel over that of its motor, k in (1).
    along : float
        Arm of the wheels 2 and 6 about the vertical, R1. [m]
    aside : float
        Arm of the wheels 1, 3, 5 and 7, R2. [m]
    """

    radius: float
    gear: float
    along: float
    aside: float


def motors(base: Base, speeds: PerAxle) -> Any:
    """Return the matrix A of shape (7, 3) in ``V = A (x', y', theta')``, (16) corrected.

    Parameters
    ----------
    base : Base
        The wheels.
    speeds : PerAxle
        Relative speeds of the axles, of `reference`.

    Returns
    -------
    SX or DM
        Motor rates [rad/s] of a speed ahead, one sideways [m/s], and a turn [rad/s].
    """
    rear, middle, front = speeds
    along, aside = base.along, base.aside
    rows = [
        [rear, 0, aside],
        [0, -1, along],
        [-rear, 0, aside],
        [middle, 0, 0],
        [front, 0, aside],
        [0, 1, along],
        [-front, 0, aside],
    ]
    return ca.vertcat(*(ca.horzcat(*row) for row in rows)) / (base.gear * base.radius)


def odometry(base: Base, speeds: PerAxle) -> Any:
    """Return the matrix J of shape (3, 7) in ``(x', y', theta') = J V``, with ``J A = I``.

    The least-squares inverse of `motors`. Unlike (10) it divides by no speed of an axle.

    Parameters
    ----------
    base : Base
        The wheels.
    speeds : PerAxle
        Relative speeds of the axles, of `reference`.
    """
    matrix = motors(base, speeds)  # of orthogonal columns
    return ca.vertcat(*(column.T / ca.sumsqr(column) for column in ca.horzsplit(matrix)))


def printed_jacobian(base: Base, tilts: Tilts, alpha: float) -> Any:
    """Return the matrix of (14) as printed, gamma zero, shape (3, 7)."""
    a, b, c, d = _cosines(tilts, alpha)
    rear, front, turn, side = a / b / 5, c / d / 5, 1 / (6 * base.aside), 1 / (6 * base.along)
    rows = [
        [rear, 0, -rear, 1 / 5, front, 0, -front],
        [0, -1 / 2, 0, 0, 0, 1 / 2, 0],
        [turn, side, turn, 0, turn, side, turn],
    ]
    return base.gear * base.radius * ca.vertcat(*(ca.horzcat(*row) for row in rows))


def printed_inverse(base: Base, tilts: Tilts, alpha: float) -> Any:
    """Return the matrix of (16) as printed, times 1/(k r), shape (7, 3)."""
    a, b, c, d = _cosines(tilts, alpha)
    return motors(base, PerAxle(b / a, 1, d / c))


def seen_directions(climber: Climber, tilts: Tilts, rates: Tilts, spins: PerAxle) -> PerAxle:
    """Return the directions of the axles as tilt sensors and encoders see them.

    An axle that rises with the speed its link's tilt rate says, while its wheel turns, moves up
    along the direction whose sine is the ratio. Of the two axles of the rear body the one is taken
    to climb that the sign of its tilt rate names. Neither slope nor height of what is climbed is
    needed. The controller smooths this over time.

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
        rise / ca.fmax(climber.radius * ca.fabs(spin), CREEPING)
        for rise, spin in zip(rises, spins, strict=True)
    )
    return PerAxle(*(ca.asin(ca.fmin(STEEPEST, ca.fmax(0, sine))) for sine in sines))
