"""Motor torques: PID control of every wheel's rate, and a common scale factor.

Equations (17) to (19) of Chugo et al. (2009); see `slipfree.control.reference_speeds`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple, Protocol, get_args

import casadi as ca
from annotated_types import Ge, Gt, Lt, Unit, doc

from slipfree.bounds import check_bounds
from slipfree.control.reference_speeds import Law, PerAxle
from slipfree.control.sensor_noise import Noise
from slipfree.errors import ModelError
from slipfree.vehicle.climber import AXLES, Climber

Directions = Literal["contact", "sensors"]


class Driver(Protocol):
    """Protocol of the controllers of a climb.

    The properties determine which states the controller adds to the model.

    `Control` and `slipfree.climb.plan_tracking.Tracking` implement it.
    """

    @property
    def senses(self) -> bool:
        """Whether the controller estimates directions from sensors; the estimates are states."""

    @property
    def proportional(self) -> float:
        """Proportional gain of the wheel-rate control [N m s/rad]."""

    @property
    def integral(self) -> float:
        """Integral gain [N m/rad]; if it is not zero, the integrated errors are states."""

    @property
    def derivative(self) -> float:
        """Derivative gain [N m s2/rad]; if it is not zero, the filtered errors are states."""

    @property
    def lag(self) -> float:
        """Time constant of the low-pass filter of the errors, for the derivative gain [s]."""


@dataclass(frozen=True)
class Control:
    """PID controller of the wheel rates, whose references follow from axle speeds without slip.

    Attributes
    ----------
    law : {"projective", "fixed", "printed_6_8", "printed_14", "printed_16"}
        Law of the reference speeds, see `slipfree.control.reference_speeds.reference`.
    directions : {"sensors", "contact"}
        Source of the directions of the axles: estimates from tilt sensors, potentiometer and
        encoders, or the true directions of the contacts, known only in simulations.
    smoothing : float
        Time constant of the low-pass filter of the estimated directions. [s]
    share : float
        Factor by which the true directions are multiplied if ``directions="contact"``; a value
        below one simulates directions that are estimated too small. [1]
    cap : float
        Largest reference speed of an axle, relative to the speed of the vehicle; at least 1. [1]
    proportional, integral, derivative : float
        PID gains of each wheel rate, (17). [N m s/rad, N m/rad, N m s2/rad]
    lag : float
        Time constant of the filter of the derivative. [s]
    unwinding : float
        Anti-windup gain: decay rate of the part of the integral term that exceeds the torque limit;
        zero, as in the paper, for no anti-windup. [1/s]
    noise : Noise or None
        Noise of the measured tilts, tilt rates and wheel rates; None for exact measurements.

    Raises
    ------
    ModelError
        If a name is unknown or a number is out of range.
    """

    law: Annotated[Law, doc("law of the axles' reference speeds")] = "projective"
    directions: Annotated[
        Directions,
        doc(
            "directions of the axles' motion: estimated from sensors, or true directions of the "
            "contacts"
        ),
    ] = "sensors"
    smoothing: Annotated[
        float, Gt(0), Unit("s"), doc("time constant of the sensors' low-pass filter")
    ] = 0.03
    share: Annotated[
        float,
        Ge(0),
        Lt(math.inf),
        Unit("1"),
        doc("factor that multiplies the true directions of the contacts"),
    ] = 1.0
    cap: Annotated[
        float,
        Ge(1),
        Unit("1"),
        doc("largest reference speed of an axle relative to the vehicle's speed"),
    ] = 1.5
    proportional: Annotated[
        float, Gt(0), Unit("N m s/rad"), doc("proportional gain of the wheel-rate control")
    ] = 4.0
    integral: Annotated[
        float, Gt(0), Unit("N m/rad"), doc("integral gain of the wheel-rate control")
    ] = 40.0
    derivative: Annotated[
        float, Ge(0), Unit("N m s2/rad"), doc("derivative gain of the wheel-rate control")
    ] = 0.0
    lag: Annotated[
        float, Gt(0), Unit("s"), doc("time constant of the filter of the derivative term")
    ] = 0.005
    unwinding: Annotated[
        float,
        Ge(0),
        Unit("1/s"),
        doc("anti-windup: rate at which torque above the limit is removed from the integral term"),
    ] = 0.0
    noise: Noise | None = None

    def __post_init__(self) -> None:
        for name, known in (("law", Law), ("directions", Directions)):
            if getattr(self, name) not in get_args(known):
                raise ModelError(
                    f"control: expected one of {', '.join(get_args(known))} for {name!r}, "
                    f"found {getattr(self, name)!r}; choose one of these names"
                )
        check_bounds(self)

    @property
    def senses(self) -> bool:
        """Whether the law needs directions estimated from sensors."""
        return self.law != "fixed" and self.directions == "sensors"


class Torques(NamedTuple):
    """Motor torques of a controller, before and after limiting.

    Attributes
    ----------
    wanted : PerAxle of SX
        Torque of each wheel of an axle before limiting, (17). [N m]
    out : PerAxle of SX
        Scaled torques, (19). [N m]
    scale : SX
        Common scale factor, (18).
    """

    wanted: PerAxle
    out: PerAxle
    scale: ca.SX


class Commands(NamedTuple):
    """Output of a controller: references [rad/s], torques, and the rates of its states."""

    references: PerAxle
    torques: Torques
    rates: tuple[ca.SX, ...]


def torques(control: Control, limit: float, errors: PerAxle, sums: PerAxle, rises: Any) -> Torques:
    """Return the motor torques of equation (17), scaled to the torque limit by (18) and (19).

    (18) as printed does not limit negative torques; here the absolute value is limited.

    Parameters
    ----------
    control : Control
        The gains.
    limit : float
        Largest torque of a motor. [N m]
    errors, sums : PerAxle
        Errors of the wheels' rates, and their integrals. [rad/s, rad]
    rises : PerAxle or ()
        Rates of the errors; empty without derivative gain. [rad/s2]
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
    """Return motor torques scaled to the torque limit by equations (18) and (19) [N m]."""
    if math.isinf(limit):
        return Torques(wanted, wanted, ca.SX(1))
    scale = limit / ca.fmax(limit, ca.mmax(ca.fabs(ca.vertcat(*wanted))))
    return Torques(wanted, PerAxle(*(scale * torque for torque in wanted)), scale)


def largest_period(control: Driver, climber: Climber) -> float:
    """Return the sample time above which a sampled controller is unstable [s].

    For a freely spinning wheel of inertia J/n with constant torque during the sample time T,
    error and integral advance by a matrix of trace ``2 - a - b/2`` and determinant ``1 - a + b/2``
    with ``a = T n kp / J`` and ``b = T^2 n ki / J``. It is stable for T below ``2 J / (n kp)`` and
    below ``2 kp / ki``.
    """
    gain = control.proportional + control.derivative / control.lag
    wheels = min(2 * axle.inertia / (axle.wheels * gain) for axle in climber.axles)
    return min(wheels, _integral_period_limit(control))


def _integral_period_limit(control: Driver) -> float:
    """Return the sample time above which the integral gain is unstable, 2 kp / ki [s]."""
    return 2 * control.proportional / control.integral if control.integral else math.inf


def check_period(period: float, control: Driver, climber: Climber) -> None:
    """Raise ModelError for a sample time with unstable wheel rates.

    Raises
    ------
    ModelError
        If the sample time is not positive, or not below `largest_period`.
    """
    most = largest_period(control, climber)
    if 0 < period < most:
        return
    if not period > 0:
        raise ModelError(
            f"period: expected a positive sample time below {most:g} s, found {period:g} s; "
            "increase it"
        )
    if most == _integral_period_limit(control):
        raise ModelError(
            f"period: expected a time between 0 and {most:g} s = 2 kp / ki (kp = "
            f"{control.proportional:g} N m s/rad, ki = {control.integral:g} N m/rad), the "
            f"stability limit of the wheel rates, found {period:g} s; reduce the "
            "sample time or ki"
        )
    gain = control.proportional + control.derivative / control.lag
    slack = [axle.inertia / axle.wheels for axle in climber.axles]
    name = AXLES[slack.index(min(slack))]
    raise ModelError(
        f"period: expected a time between 0 and {most:g} s = 2 J / (n kp), the stability limit of "
        f"the {name} axle (J = {getattr(climber, name).inertia:g} kg m2, n = "
        f"{getattr(climber, name).wheels}, kp = {gain:g} N m s/rad), found "
        f"{period:g} s; reduce the sample time or the gain"
    )
