"""Driving law of a step climber: wheel rates that follow from the configuration of its bodies.

PID control of every wheel's rate, and a common factor that limits the torques: equations (17) to
(19) of Chugo et al. (2009). The references are those of `slipfree.control.reference_speeds`. In a
model with a controller, laws replace inputs, and the controller's states become states.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, NamedTuple, Protocol

import casadi as ca
import numpy as np
from annotated_types import Ge, Gt, Lt, Unit, doc

from slipfree.catalog.step_climber import Climber, climber_of
from slipfree.control.reference_speeds import (
    Law,
    Noise,
    PerAxle,
    Tilts,
    directions,
    estimated_directions,
    measured,
    reference,
)
from slipfree.core.arguments import checked
from slipfree.core.dae import Dae, Labels, Limit
from slipfree.core.errors import ModelError
from slipfree.core.records import Label, leaves, pack, symbols, unpack
from slipfree.models.limits import UPRIGHT
from slipfree.terrain.solids import Profile
from slipfree.vehicle.tree import Vehicle


@dataclass(frozen=True, eq=False)
class Controller:
    """Controller of a model, as expressions of symbols of the model and of the controller.

    States, inputs, outputs and their labels are records; ``rates`` are those of the states,
    ``laws`` the values of the model's inputs in their order.
    """

    x: Any
    u: Any
    rates: tuple[ca.SX, ...]
    laws: tuple[ca.SX, ...]
    y: Any
    labels_x: Any
    labels_u: Any
    labels_y: Any


class WithController(NamedTuple):
    """Variables of a model, and those of its controller."""

    model: Any
    controller: Any


def controlled(model: Dae, controller: Controller, *, sampled: bool = False) -> Dae:
    """Return a model with a controller: states, inputs and outputs of the model, then its own.

    With ``sampled`` the inputs of the model remain inputs, which
    `slipfree.solve.zero_order_hold.simulate_sampled` sets to the values of the laws. ModelError is
    raised if the number of laws is not the number of inputs, or the model has numeric checks.
    """
    inputs = pack(model.u)
    if len(controller.laws) != inputs.numel():
        raise ModelError(
            f"controlled: expected {inputs.numel()} laws, one per input of the model, found "
            f"{len(controller.laws)}; give one for each input"
        )
    if model.checks:
        raise ModelError(
            "controlled: expected a model without numeric checks at the samples, found "
            f"{len(model.checks)}; use a plane ground"
        )

    def driven(expressions: Sequence[ca.SX]) -> list[ca.SX]:
        if sampled:
            return list(expressions)
        laws = ca.vertcat(ca.SX(0, 1), *controller.laws)
        return list(ca.substitute([ca.SX(each) for each in expressions], [inputs], [laws]))

    y = unpack(model.y, driven([*leaves(model.y)]))
    pairs = zip(model.limits, driven([each.expression for each in model.limits]), strict=True)
    limits: tuple[Limit, ...] = tuple(limit._replace(expression=each) for limit, each in pairs)
    rates = ca.vertcat(ca.SX(0, 1), *controller.rates)
    labels, own, standing = model.labels, np.zeros(rates.numel()), model.standing
    if standing is not None:  # the controller starts with states of zero
        standing = standing._replace(x=ca.vertcat(standing.x, ca.SX.zeros(rates.shape)))
    held = model.held
    if held is not None:
        held = held._replace(ode=ca.vertcat(*driven([held.ode]), rates))
    return replace(
        model,
        x=WithController(model.x, controller.x),
        u=WithController(model.u if sampled else (), controller.u),
        ode=ca.vertcat(*driven([model.ode]), rates),
        alg=tuple(driven(model.alg)),
        quad=driven([model.quad])[0],
        y=WithController(y, controller.y),
        labels=Labels(
            WithController(labels.x, controller.labels_x),
            labels.z,
            labels.q,
            WithController(labels.u if sampled else (), controller.labels_u),
            WithController(labels.y, controller.labels_y),
            labels.alg,
        ),
        limits=limits,
        pace=driven([model.pace])[0],
        shift=(np.concatenate([model.shift[0], own]), model.shift[1]),
        standing=standing,
        held=held,
    )


MAX_TILT = 1.4  # a body with a larger tilt has overturned [rad]
Directions = Literal["contact", "sensors"]
Motors = tuple[int, int, int]


class Sensed(NamedTuple):
    """Quantities of a model that a controller may use.

    Tilts are nose-up [rad, rad/s], ``spins`` the rates of the wheels [rad/s], ``axles`` and
    ``velocities`` columns (2, 1) [m, m/s]. ``directions()`` are the true directions in which the
    axles can move, upward from the horizontal [rad].
    """

    t: ca.SX
    tilts: Tilts
    rates: Tilts
    spins: PerAxle
    axles: PerAxle
    velocities: PerAxle
    directions: Callable[[], PerAxle]


class ControlState(NamedTuple):
    """States of the controller, each per axle or empty.

    Integrals of the errors of the wheel rates [rad], smoothed estimates of the axles' directions
    [rad], and filtered errors of the wheel rates, for the derivative gain [rad/s].
    """

    integrals: Any = ()
    directions: Any = ()
    lagging: Any = ()


class ControlInputs(NamedTuple):
    """Input of the controller: the reference speed of the vehicle [m/s]."""

    speed: Any


class ControlOutputs(NamedTuple):
    """Outputs: reference rates [rad/s], torques of the motors [N m], factor of the limit [1]."""

    references: PerAxle
    torques: PerAxle
    scale: Any


INPUTS = ControlInputs(Label("reference_speed", "m s-1", "reference speed of the vehicle"))


class Torques(NamedTuple):
    """Torques of the motors before (17) and after limiting (19) [N m], and the factor (18) [1]."""

    wanted: PerAxle
    out: PerAxle
    scale: ca.SX


class Commands(NamedTuple):
    """Output of a controller: references [rad/s], torques, and the rates of its states."""

    references: PerAxle
    torques: Torques
    rates: tuple[ca.SX, ...]


class WheelControl(Protocol):
    """Protocol of the controllers of a step climber."""

    @property
    def motors(self) -> Motors:
        """Numbers of motors of the axles."""

    def labels(self, wheels: Sequence[str]) -> ControlState:
        """Return the labels of the states for the names of the wheels."""

    def commands(self, climber: Climber, at: Sensed, x: ControlState, speed: ca.SX) -> Commands:
        """Return reference rates, torques and the rates of the states for a speed [m/s]."""


@checked
@dataclass(frozen=True)
class StepClimbing:
    """PID controller of the wheel rates, whose references follow from axle speeds without slip.

    The laws are those of `slipfree.control.reference_speeds.reference`, the gains those of (17).
    True directions of the contacts are known only in simulations; a ``share`` below one simulates
    directions that are estimated too small. The paper has no anti-windup: ``unwinding`` is zero.
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
    torque: Annotated[float, Gt(0), Unit("N m"), doc("largest torque of a motor")] = math.inf
    motors: Annotated[
        Motors, doc("numbers of wheels on the rear, middle and front axle, with one motor each")
    ] = (2, 1, 2)
    noise: Noise | None = None

    def __post_init__(self) -> None:
        if min(self.motors) < 1:
            raise ModelError(
                "step-climbing: expected one motor or more per axle as 'motors', found "
                f"{self.motors}; change the numbers"
            )

    @property
    def senses(self) -> bool:
        """Whether the law needs directions estimated from sensors."""
        return self.law != "fixed" and self.directions == "sensors"

    def labels(self, wheels: Sequence[str]) -> ControlState:
        """Return the labels of the states for the names of the wheels."""
        estimate = "smoothed estimate of the axle's direction from sensors"
        filtered = "filtered wheel-rate error, for the derivative gain"
        return ControlState(
            _labels(wheels, "error_sum", "rad", "integral of the wheel-rate error"),
            _labels(wheels, "direction_seen", "rad", estimate) if self.senses else (),
            _labels(wheels, "error_lag", "rad s-1", filtered) if self.derivative else (),
        )

    def commands(self, climber: Climber, at: Sensed, x: ControlState, speed: ca.SX) -> Commands:
        """Return reference rates, torques and the rates of the states for a speed [m/s]."""
        tilts, rates, spins = at.tilts, at.rates, at.spins
        if self.noise is not None:
            tilts, rates, spins = measured(self.noise, at.t, tilts, rates, spins)
        used = x.directions if self.senses else [self.share * phi for phi in at.directions()]
        relative = reference(climber, tilts, PerAxle(*used), self.law, self.cap)
        wanted = PerAxle(*(speed / climber.radius * ratio for ratio in relative))
        errors = PerAxle(*(aim - spin for aim, spin in zip(wanted, spins, strict=True)))
        rises = [(now - late) / self.lag for now, late in zip(errors, x.lagging, strict=False)]
        motors = torques(self, errors, x.integrals, rises)
        # back-calculation: torque cut off by the limit drains the integral, so that a wheel held
        # at an obstacle does not release stored torque when it breaks free
        unwinding = self.unwinding / self.integral
        changes = [
            error - unwinding * (torque - out)
            for error, torque, out in zip(errors, motors.wanted, motors.out, strict=True)
        ]
        if self.senses:
            raw = estimated_directions(climber, tilts, rates, spins)
            changes += [
                (new - old) / self.smoothing for new, old in zip(raw, x.directions, strict=True)
            ]
        return Commands(wanted, motors, (*changes, *rises))


def _labels(wheels: Sequence[str], name: str, unit: str, text: str) -> PerAxle:
    return PerAxle(*(Label(name, unit, text, wheel) for wheel in wheels))


def torques(control: StepClimbing, errors: PerAxle, sums: PerAxle, rises: Any) -> Torques:
    """Return the motor torques of equation (17), scaled to the torque limit by (18) and (19).

    ``errors`` and ``sums`` are the errors of the wheels' rates and their integrals [rad/s, rad],
    ``rises`` the rates of the errors, empty without derivative gain [rad/s2].
    """
    wanted = [
        control.proportional * error + control.integral * total
        for error, total in zip(errors, sums, strict=True)
    ]
    if control.derivative:
        wanted = [
            torque + control.derivative * rise for torque, rise in zip(wanted, rises, strict=True)
        ]
    return limited(control.torque, PerAxle(*wanted))


def limited(limit: float, wanted: PerAxle) -> Torques:
    """Return motor torques scaled to the torque limit by equations (18) and (19) [N m].

    (18) as printed does not limit negative torques; here the absolute value is limited.
    """
    if math.isinf(limit):
        return Torques(wanted, wanted, ca.SX(1))
    scale = limit / ca.fmax(limit, ca.mmax(ca.fabs(ca.vertcat(*wanted))))
    return Torques(wanted, PerAxle(*(scale * torque for torque in wanted)), scale)


def largest_period(control: StepClimbing, climber: Climber) -> float:
    """Return the sample time above which a sampled controller is unstable [s].

    For a freely spinning wheel of inertia J/n with constant torque during the sample time T,
    error and integral advance by a matrix of trace ``2 - a - b/2`` and determinant ``1 - a + b/2``
    with ``a = T n kp / J`` and ``b = T^2 n ki / J``. It is stable for T below ``2 J / (n kp)`` and
    below ``2 kp / ki``.
    """
    gain = control.proportional + control.derivative / control.lag
    wheels = (
        2 * axle.inertia / (count * gain)
        for axle, count in zip(climber.axles, control.motors, strict=True)
    )
    return min(*wheels, 2 * control.proportional / control.integral)


def check_period(period: float, control: StepClimbing, climber: Climber) -> None:
    """Raise ModelError for a sample time that is not below `largest_period`, or not positive."""
    most = largest_period(control, climber)
    if not 0 < period < most:
        raise ModelError(
            f"period: expected a time between 0 and {most:g} s, the stability limit of the wheel "
            "rates (the least of 2 J / (n kp) of the axles and of 2 kp / ki), found "
            f"{period:g} s; change it, or reduce the gains"
        )


def climbing(
    model: Dae,
    vehicle: Vehicle,
    control: WheelControl,
    section: Profile | None = None,
    *,
    sampled: bool = False,
) -> Dae:
    """Return the dynamic model of a step climber with controlled wheels.

    ``model`` is the result of `slipfree.dynamics` for the vehicle
    (`slipfree.catalog.step_climber.climber_of`), ``control`` a `StepClimbing` or
    `slipfree.climb.time_scaling.Tracking`. Controllers with ``directions="contact"`` require the
    section of the ground (`slipfree.terrain.solids.section_of`). With ``sampled`` the torques of
    the axles remain inputs, for a sampled controller; `held_torques` are their values. The other
    input is the ``reference_speed`` of the vehicle [m/s]. A motion ends where the front body
    overturns.
    """
    climber = climber_of(vehicle)
    wheels = tuple(wheel.name for wheel in vehicle.wheels)
    labels = control.labels(wheels)
    x, u = symbols(labels), symbols(INPUTS)
    at = _sensed(climber, model, section)
    command = control.commands(climber, at, x, u.speed)
    tilt = Label(f"front_{UPRIGHT}", "rad", "the front body overturns (tilt)")
    limit = Limit(tilt, at.tilts.front, -MAX_TILT, MAX_TILT)
    model = replace(model, limits=(*model.limits, limit))
    motors = command.torques
    controller = Controller(
        x=x,
        u=u,
        rates=command.rates,
        laws=tuple(n * tau for n, tau in zip(control.motors, motors.out, strict=True)),
        y=ControlOutputs(command.references, motors.out, motors.scale),
        labels_x=labels,
        labels_u=INPUTS,
        labels_y=ControlOutputs(
            _labels(wheels, "reference", "rad s-1", "reference rate of the wheels"),
            _labels(wheels, "motor_torque", "N m", "torque of a wheel's motor"),
            Label("torque_scale", "1", "factor by which the torque limit scales all torques"),
        ),
    )
    return controlled(model, controller, sampled=sampled)


def held_torques(model: Dae, control: WheelControl) -> dict[str, ca.SX]:
    """Return the torques of the axles by name, for the model of a sampled controller [N m]."""
    torques, names = model.y.controller.torques, leaves(model.labels.u.model.wheels)
    return {
        label.full: count * torque
        for label, count, torque in zip(names, control.motors, torques, strict=True)
    }


def _sensed(climber: Climber, model: Dae, section: Profile | None) -> Sensed:
    """Return the quantities of a model that its controller may use."""
    x, common = model.x, model.y.common
    (rear,), (fold,), (rate,), (fold_rate,) = x.attitude, x.joints, x.omega, x.joint_speeds
    q = ca.vertcat(x.y, x.z, rear, fold)
    v = ca.vertcat(*x.velocity, rate, fold_rate)
    axles = PerAxle(
        *(ca.vertcat(*each) for each in zip(common.center_y, common.center_z, strict=True))
    )

    def seen() -> PerAxle:
        if section is None:
            raise ModelError(
                "step-climbing: expected solids on a level ground for directions = 'contact', "
                "found another ground; use directions = 'sensors'"
            )
        return directions(section, climber.radius, axles)

    return Sensed(
        model.t,
        Tilts(rear, rear + fold),
        Tilts(rate, rate + fold_rate),
        PerAxle(*x.spins),
        axles,
        PerAxle(*(ca.jtimes(place, q, v) for place in axles)),
        seen,
    )
