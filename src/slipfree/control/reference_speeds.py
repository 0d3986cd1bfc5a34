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

Measurements of a controller may contain sensor noise: smooth, band-limited and reproducible by its
seed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple

import casadi as ca
import numpy as np
from annotated_types import Ge, Gt, Lt, Unit, doc

from slipfree.catalog.step_climber import Climber
from slipfree.core.arguments import checked
from slipfree.terrain.solids import Profile

MIN_MIDDLE_SPEED = 1e-3  # lower bound of the middle axle's relative speed as a divisor
GUIDE_GAP, GUIDE_WIDTH = 1.5e-3, 6e-4  # gap below which a solid guides a wheel, and transition [m]
MIN_RIM_SPEED = 0.05  # lower bound of the rim speed in the estimates of directions [m/s]
MAX_SINE = 0.985  # largest sine of an estimated direction
Law = Literal["projective", "fixed", "printed_6_8", "printed_14", "printed_16"]
TONES = 24  # number of tones in the noise of a sensor


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
    """Return the speed ratios of the axles without slip [1].

    ``directions`` are the directions of the axles' motion [rad]. The common factor is chosen so
    that nothing is divided: all ratios are zero if the axles cannot move without slip.
    """
    to_joint = -climber.middle.ahead
    link = climber.middle.ahead - climber.rear.ahead
    rear = ca.cos(directions.rear - tilts.rear)
    middle = ca.cos(directions.middle - tilts.rear)
    front = ca.cos(directions.front - tilts.front)
    turning = ca.sin(directions.middle - directions.rear) * ca.sin(tilts.front - tilts.rear)
    # right side of the front link for s = 1; its left factor multiplies the other two speeds
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
    """Return the reference speeds of the axles, relative to the vehicle's speed [1].

    The law ``"projective"`` has no slip in every phase, ``"fixed"`` has speed one for all axles.
    The other laws are equations of the paper as printed, for comparison: (6) with (8), the
    pseudo-inverse (15) of (14), and (16). Their single angle alpha is the largest of the axles'
    directions of motion [rad]. ``cap``, at least 1, is the largest relative speed; ``"printed_14"``
    does not use it.
    """
    if law == "fixed":
        return PerAxle(ca.SX(1), ca.SX(1), ca.SX(1))
    if law == "projective":
        return capped(ratios(climber, tilts, directions), cap)
    alpha = ca.mmax(ca.vertcat(*directions))
    # numerator and denominator of (6), then of (8), with the tilts th_b and th_a + th_b
    rear_over, rear_under = ca.cos(alpha - tilts.rear), ca.cos(tilts.rear)
    front_over, front_under = ca.cos(tilts.front), ca.cos(alpha - tilts.front)
    if law == "printed_14":  # the speed ratios are (15)
        first, square = rear_over / rear_under, front_under**2
        size = 5 / (2 * first**2 * square + square + 2 * front_over**2)
        return PerAxle(first * square * size, square * size, front_over * front_under * size)
    if law == "printed_6_8":
        return capped(PerAxle(rear_over / rear_under * front_under, front_under, front_over), cap)
    return capped(PerAxle(rear_under / rear_over * front_over, front_over, front_under), cap)


def estimated_directions(climber: Climber, tilts: Tilts, rates: Tilts, spins: PerAxle) -> PerAxle:
    """Return estimates of the axles' directions from tilt sensors and encoders [rad].

    The tilt rate of a link gives the vertical speed of its axle; divided by the rim speed it is the
    sine of the direction. The sign of the rear body's tilt rate decides which of its two axles
    climbs. The estimates do not require the slope or height of the obstacle. The controller smooths
    them.
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

    The direction of an axle at the position (2, 1) [m] is the steepest upward tangent of the solids
    near its wheels of a radius [m]: wheels that touch floor and wall move up the wall. They
    move downhill, as over an edge, only if no other solid supports them.
    """
    return PerAxle(*(_direction(profile, radius, axle) for axle in axles))


def _direction(profile: Profile, radius: float, axle: ca.SX) -> ca.SX:
    up, down, free = ca.SX(0), ca.SX(0), ca.SX(1)
    for solid in profile.solids:
        # a smooth weight instead of a contact test: integrators need derivatives at first contact
        distance, normal = solid.gap(axle[0], axle[1])
        near = (1 - ca.tanh((distance - radius - GUIDE_GAP) / GUIDE_WIDTH)) / 2
        slope = ca.atan2(-normal[0], normal[1])
        up = ca.fmax(up, near * slope)
        down = ca.fmin(down, near * slope)
        free *= ca.if_else(slope >= 0, 1 - near, 1)
    return up + down * free


@checked
@dataclass(frozen=True)
class Noise:
    """Root mean squares, frequency band and seed of the sensor noise.

    The noise of a sensor is a sum of tones of equal amplitude with random phases and frequencies
    distributed over the band, from a hundredth of its largest frequency; it is a smooth function of
    time, which integrators can follow. Tilt rates are measured separately from tilts.
    """

    tilt: Annotated[
        float, Ge(0), Lt(math.inf), Unit("rad"), doc("root mean square for the bodies' tilts")
    ] = 0.0
    tilt_rate: Annotated[
        float, Ge(0), Lt(math.inf), Unit("rad/s"), doc("root mean square for the tilt rates")
    ] = 0.0
    wheel_rate: Annotated[
        float, Ge(0), Lt(math.inf), Unit("rad/s"), doc("root mean square for the wheel rates")
    ] = 0.0
    band: Annotated[float, Gt(0), Lt(math.inf), Unit("Hz"), doc("largest frequency")] = 50.0
    seed: Annotated[int, Ge(0), doc("seed of the random numbers")] = 0


def measured(
    noise: Noise, t: Any, tilts: Tilts, rates: Tilts, spins: PerAxle
) -> tuple[Tilts, Tilts, PerAxle]:
    """Return tilts, tilt rates and wheel rates with sensor noise, at a time ``t`` [s]."""
    rng = np.random.default_rng(noise.seed)

    def noisy(size: float, values: Iterable[Any]) -> list[Any]:
        return [value + size * _unit(rng, noise.band, t) for value in values]

    return (
        Tilts(*noisy(noise.tilt, tilts)),
        Tilts(*noisy(noise.tilt_rate, rates)),
        PerAxle(*noisy(noise.wheel_rate, spins)),
    )


def _unit(rng: np.random.Generator, band: float, t: Any) -> Any:
    """Return the value at time ``t`` of noise with unit rms and largest frequency ``band``."""
    edges = np.linspace(0.01 * band, band, TONES + 1)
    turning = 2 * np.pi * rng.uniform(edges[:-1], edges[1:])
    phases = rng.uniform(0, 2 * np.pi, TONES)
    return math.sqrt(2 / TONES) * ca.sum1(ca.sin(ca.DM(turning) * t + ca.DM(phases)))
