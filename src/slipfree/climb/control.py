"""Torques of the wheels' motors: PID control of every wheel's rate, and one scale for all.

Equations (17) to (19) of Chugo et al. (2009); see `slipfree.climb.reference`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol, get_args

import casadi as ca

from slipfree.climb.noise import Noise
from slipfree.climb.reference import Law, PerAxle
from slipfree.climb.vehicle import AXLES, Climber
from slipfree.errors import ModelError

Directions = Literal["contact", "sensors"]


class Driver(Protocol):
    """What a model of a climb asks of whatever drives its wheels: which states that has, and gains.

    See `Control` for them, and `slipfree.climb.plan_tracking.Tracking`.
    """

    @property
    def senses(self) -> bool:
        """Whether directions that sensors see are states."""

    @property
    def proportional(self) -> float:
        """Gain of the wheels' rates. [N m s/rad]."""

    @property
    def integral(self) -> float:
        """Gain of their integrals; these are states unless it is zero. [N m/rad]."""

    @property
    def derivative(self) -> float:
        """Gain of their derivatives; filters are states unless it is zero. [N m s2/rad]."""

    @property
    def lag(self) -> float:
        """Time constant of the filters. [s]."""


@dataclass(frozen=True)
class Control:
    """How the wheels are driven.

    Attributes
    ----------
    law : {"projective", "fixed", "printed_6_8", "printed_14", "printed_16"}
        Reference speeds, see `slipfree.climb.reference.reference`.
    directions : {"sensors", "contact"}
        What the law takes for the directions of the axles: what tilt sensors, potentiometer and
        encoders say, or those of the contacts, which only a simulation knows.
    smoothing : float
        Time constant of the sensors' low pass. [s]
    share : float
        Part of the directions of the contacts that the law is told: below one to underestimate.
    cap : float
        Largest reference speed, relative to the vehicle's.
    proportional, integral, derivative : float
        Gains of (17), for each wheel. [N m s/rad, N m/rad, N m s2/rad]
    lag : float
        Time constant of the filter behind the derivative. [s]
    unwinding : float
        Rate at which torque beyond the limit is taken back from the integral; none if zero, as in
        the paper. [1/s]
    noise : Noise or None
        Of the sensors of tilts and rates, on which references and torques depend.

    Raises
    ------
    ModelError
        If a name is not known or a number out of range.
    """

    law: Law = "projective"
    directions: Directions = "sensors"
    smoothing: float = 0.03
    share: float = 1.0
    cap: float = 1.5
    proportional: float = 4.0
    integral: float = 40.0
    derivative: float = 0.0
    lag: float = 0.005
    unwinding: float = 0.0
    noise: Noise | None = None

    def __post_init__(self) -> None:
        for name, known in (("law", Law), ("directions", Directions)):
            if getattr(self, name) not in get_args(known):
                raise ModelError(
                    f"control: expected {name} one of {', '.join(get_args(known))}, "
                    f"found {getattr(self, name)!r}"
                )
        for name in ("smoothing", "proportional", "integral", "lag"):
            if not getattr(self, name) > 0:
                raise ModelError(f"control: {name} must be positive, found {getattr(self, name)}")
        for name in ("derivative", "unwinding"):
            if not getattr(self, name) >= 0:
                raise ModelError(
                    f"control: {name} must not be negative, found {getattr(self, name)}"
                )
        if not (0 <= self.share < math.inf and self.cap >= 1):
            raise ModelError(
                f"control: expected a share from 0 on and a cap from 1 on, found {self.share} and "
                f"{self.cap}"
            )

    @property
    def senses(self) -> bool:
        """Whether the law needs directions that sensors see."""
        return self.law != "fixed" and self.directions == "sensors"


class Torques(NamedTuple):
    """What the controller asks of the motors.

    Attributes
    ----------
    wanted : PerAxle of SX
        Torque of each wheel of an axle, (17). [N m]
    out : PerAxle of SX
        The same, scaled, (19). [N m]
    scale : SX
        The one scale, (18).
    """

    wanted: PerAxle
    out: PerAxle
    scale: ca.SX


class Commands(NamedTuple):
    """What the controller does: references [rad/s], torques, and the rates of its own states."""

    references: PerAxle
    torques: Torques
    rates: tuple[ca.SX, ...]


def torques(control: Control, limit: float, errors: PerAxle, sums: PerAxle, rises: Any) -> Torques:
    """Return the torques of the wheels, (17), within the motors' limit, (18) and (19).

    (18) as printed lets negative torques pass; here their size counts.

    Parameters
    ----------
    control : Control
        Gains.
    limit : float
        Largest torque of a motor. [N m]
    errors, sums : PerAxle
        Errors of the wheels' rates, and their integrals. [rad/s, rad]
    rises : PerAxle or ()
        Rates of the errors; nothing without derivative gain. [rad/s2]
    """
    found = [
        control.proportional * error + control.integral * total
        for error, total in zip(errors, sums, strict=True)
    ]
    if control.derivative:
        found = [
            torque + control.derivative * rise for torque, rise in zip(found, rises, strict=True)
        ]
    return limited(limit, PerAxle(*found))


def limited(limit: float, wanted: PerAxle) -> Torques:
    """Return torques of the wheels within the motors' limit, (18) and (19). [N m]."""
    if math.isinf(limit):
        return Torques(wanted, wanted, ca.SX(1))
    scale = limit / ca.fmax(limit, ca.mmax(ca.fabs(ca.vertcat(*wanted))))
    return Torques(wanted, PerAxle(*(scale * torque for torque in wanted)), scale)


def largest_period(control: Driver, climber: Climber) -> float:
    """Return the sample time from which on a sampled controller is unstable. [s].

    Of a wheel that spins freely, of inertia J/n, under torque held from sample to sample, error and
    integral advance by a matrix of trace ``2 - a - b/2`` and determinant ``1 - a + b/2`` with ``a =
    T n kp / J`` and ``b = T^2 n ki / J``: stable below ``2 J / (n kp)`` and below ``2 kp / ki``.
    """
    gain = control.proportional + control.derivative / control.lag
    wheels = min(2 * axle.inertia / (axle.wheels * gain) for axle in climber.axles)
    return min(wheels, _longest(control))


def _longest(control: Driver) -> float:
    """Return the sample time from which on the integral makes wheels swing up, 2 kp / ki. [s]."""
    return 2 * control.proportional / control.integral if control.integral else math.inf


def check_period(period: float, control: Driver, climber: Climber) -> None:
    """Refuse a sample time at which the wheels' rates would swing up.

    Raises
    ------
    ModelError
        If it is not positive, or not below `largest_period`; it names the axle.
    """
    most = largest_period(control, climber)
    if 0 < period < most:
        return
    if most == _longest(control):
        raise ModelError(
            f"period: expected a time between 0 and {most:g} s = 2 kp / ki (kp = "
            f"{control.proportional:g} N m s/rad, ki = {control.integral:g} N m/rad), at which the "
            f"wheels begin to swing up, found {period:g} s: sample faster or lower ki"
        )
    gain = control.proportional + control.derivative / control.lag
    slack = [axle.inertia / axle.wheels for axle in climber.axles]
    name = AXLES[slack.index(min(slack))]
    raise ModelError(
        f"period: expected a time between 0 and {most:g} s = 2 J / (n kp), at which the "
        f"{name} axle (J = {getattr(climber, name).inertia:g} kg m2, n = "
        f"{getattr(climber, name).wheels}, kp = {gain:g} N m s/rad) begins to swing up, found "
        f"{period:g} s: sample faster or lower the gain"
    )
