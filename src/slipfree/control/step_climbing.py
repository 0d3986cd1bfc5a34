"""Driving law of a step climber, and reference speeds of its axles from its body configuration.

The reference speeds follow the law of Chugo, Kawabata, Kaetsu, Asama and Mishima, "Omni-directional
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

The driving law is PI control of every wheel's rate towards these references, and a common factor
that limits the torques: equations (17) to (19) of Chugo et al. (2009), without the derivative term
of (17), whose gain the paper does not give. In a model with a controller, laws replace inputs, and
the controller's states become states.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, NamedTuple, Protocol

import casadi as ca
from annotated_types import Ge, Gt, Unit

from slipfree.catalog import check_climber
from slipfree.control.path_following import driven_vehicle
from slipfree.core.arguments import checked
from slipfree.core.dae import Dae, Limit
from slipfree.core.errors import ModelError
from slipfree.core.quantities import quantity_label
from slipfree.core.rearrange import (
    ModelVariable,
    blocks,
    new_variable,
    rearrange,
    substitute,
    variables,
    with_outputs,
)
from slipfree.core.records import Label, leaves, symbols
from slipfree.core.schema import KEY, NonNegative
from slipfree.models.limits import UPRIGHT
from slipfree.terrain.solids import Profile
from slipfree.vehicle.tree import Vehicle

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


def ratios(climber: Vehicle, tilts: Tilts, directions: PerAxle) -> PerAxle:
    """Return the speed ratios of the axles without slip [1].

    ``directions`` are the directions of the axles' motion [rad]. The common factor is chosen so
    that nothing is divided: all ratios are zero if the axles cannot move without slip.
    """
    behind, to_joint = (-wheel.at[1] for wheel in climber.wheels[:2])
    link = behind - to_joint
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
    climber: Vehicle, tilts: Tilts, directions: PerAxle, law: Law = "projective", cap: float = 1.5
) -> PerAxle:
    """Return the reference speeds of the axles, relative to that of the middle axle [1].

    The law ``"projective"`` is free of slip in every phase, ``"fixed"`` has speed one for all
    axles. The other laws are equations of the paper as printed, for comparison: (6) with (8), the
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


def estimated_directions(climber: Vehicle, tilts: Tilts, rates: Tilts, spins: PerAxle) -> PerAxle:
    """Return estimates of the axles' directions from tilt sensors and encoders [rad].

    The tilt rate of a link gives the vertical speed of its axle; divided by the rim speed it is the
    sine of the direction. The sign of the rear body's tilt rate decides which of its two axles
    climbs. The estimates do not require the slope or height of the obstacle. The controller smooths
    them.
    """
    behind, at_middle, ahead = (wheel.at[1] for wheel in climber.wheels)
    turn = ca.cos(tilts.rear) * rates.rear
    rise = (at_middle - behind) * turn
    swing = ahead * ca.cos(tilts.front) * rates.front
    middle = ca.fmax(0, rise)
    rises = PerAxle(ca.fmax(0, -rise), middle, middle - at_middle * turn + swing)
    sines = (
        rise / ca.fmax(climber.wheels[0].radius * ca.fabs(spin), MIN_RIM_SPEED)
        for rise, spin in zip(rises, spins, strict=True)
    )
    return PerAxle(*(ca.asin(ca.fmin(MAX_SINE, ca.fmax(0, sine))) for sine in sines))


def directions(profile: Profile, radius: float, axles: PerAxle) -> PerAxle:
    """Return the angles above the horizontal in which the axles can move forward [rad].

    The direction of an axle at the position (2, 1) [m] is the steepest upward tangent of the solids
    near its wheels of a radius [m]: wheels that touch floor and wall move up the wall. They
    move downhill, as over an edge, only if no other solid supports them.
    """
    found = list[ca.SX]()
    for axle in axles:
        up, down, free = ca.SX(0), ca.SX(0), ca.SX(1)
        for solid in profile.solids:
            # a smooth weight instead of a contact test, for derivatives at first contact
            distance, normal = solid.gap(axle[0], axle[1])
            near = (1 - ca.tanh((distance - radius - GUIDE_GAP) / GUIDE_WIDTH)) / 2
            slope = ca.atan2(-normal[0], normal[1])
            up = ca.fmax(up, near * slope)
            down = ca.fmin(down, near * slope)
            free *= ca.if_else(slope >= 0, 1 - near, 1)
        found.append(up + down * free)
    return PerAxle(*found)


class ControlLaw(NamedTuple):
    """Control law of a model, in symbols of the model and of its own.

    States have rates; ``laws`` are the values of the model's inputs in their order.
    """

    states: tuple[ModelVariable, ...]
    inputs: tuple[ModelVariable, ...]
    laws: tuple[ca.SX, ...]
    outputs: tuple[tuple[Label, ca.SX], ...]


def controlled(model: Dae, controller: ControlLaw, *, sampled: bool = False) -> Dae:
    """Return a model with a controller: states, inputs and outputs of the model, then its own.

    With ``sampled`` the inputs of the model remain inputs, which
    `slipfree.simulate` sets to the values of the laws if ``sampled``. ModelError is
    raised if the number of laws is not the number of inputs.
    """
    inputs, laws = [*leaves(model.u)], list(controller.laws)
    if len(laws) != len(inputs):
        raise ModelError(
            f"controlled: expected {len(inputs)} laws, one per input of the model, found "
            f"{len(laws)}; give one for each input"
        )
    laws = inputs if sampled else laws
    driven, standing, held = substitute(model, inputs, laws), model.standing, model.held
    x, z, u = variables(driven)
    own = (x, controller.states), z, (u if sampled else (), controller.inputs)
    dae = with_outputs(rearrange(driven, *own, blocks(driven)), controller.outputs)
    if standing is not None:  # the controller starts with states of zero
        zeros = ca.SX.zeros(len(controller.states))
        standing = standing._replace(x=ca.vertcat(standing.x, zeros))
    if held is not None:
        (ode,) = ca.substitute([held.ode], [ca.vertcat(*inputs)], [ca.vertcat(*laws)])
        held = held._replace(ode=ca.vertcat(ode, *(each.rate for each in controller.states)))
    return replace(dae, standing=standing, held=held)


MAX_TILT = 1.4  # a body with a larger tilt has overturned [rad]
SMOOTHING = 0.03  # time constant of the low-pass filter of estimated directions [s]
Directions = Literal["contact", "sensors"]
Motors = tuple[int, int, int]


class Sensed(NamedTuple):
    """Quantities of a model that a controller may use.

    Tilts are nose-up [rad, rad/s], ``spins`` the rates of the wheels [rad/s], ``axles`` and
    ``velocities`` columns (2, 1) [m, m/s]. ``directions()`` are the true directions in which the
    axles can move, upward from the horizontal [rad].
    """

    tilts: Tilts
    rates: Tilts
    spins: PerAxle
    axles: PerAxle
    velocities: PerAxle
    directions: Callable[[], PerAxle]


class ControlState(NamedTuple):
    """States of the controller, each per axle or empty.

    Integrals of the errors of the wheel rates [rad], and smoothed estimates of the directions of
    the axles [rad].
    """

    integrals: Any = ()
    directions: Any = ()


REFERENCE_SPEED = quantity_label("reference_speed")


class Commands(NamedTuple):
    """Outputs of a controller: reference rates [rad/s], torques of the motors, rates of its states.

    ``torques`` are those of the motors after limiting (19) [N m], ``scale`` the factor (18) [1].
    """

    references: PerAxle
    torques: PerAxle
    scale: Any
    rates: tuple[ca.SX, ...] = ()


class WheelControl(Protocol):
    """Protocol of the controllers of a step climber."""

    @property
    def motors(self) -> Motors:
        """Numbers of motors of the axles."""

    def labels(self, wheels: Sequence[str]) -> ControlState:
        """Return the labels of the states for the names of the wheels."""

    def commands(self, climber: Vehicle, at: Sensed, x: ControlState, speed: ca.SX) -> Commands:
        """Return reference rates, torques and the rates of the states for a speed [m/s]."""


@checked
@dataclass(frozen=True)
class StepClimbing:
    """PI controller of the wheel rates, whose references follow from axle speeds without slip.

    The laws are those of `slipfree.control.step_climbing.reference`, the gains those of (17).
    True directions of the contacts are known only in simulations; a ``share`` below one simulates
    directions that are estimated too small. The paper has no anti-windup.

    Attributes
    ----------
    law : {"projective", "fixed", "printed_6_8", "printed_14", "printed_16"}
        Law of the axles' reference speeds.
    directions : {"contact", "sensors"}
        Directions of the axles' motion: estimated from sensors, or true directions of the contacts.
    share : float
        Factor that multiplies the true directions of the contacts. [1]
    cap : float
        Largest reference speed of an axle relative to the vehicle's speed. [1]
    proportional : float
        Proportional gain of the wheel-rate control. [N m s/rad]
    integral : float
        Integral gain of the wheel-rate control. [N m/rad]
    torque : float
        Largest torque of a motor. [N m]
    motors : tuple of 3 int
        Numbers of wheels on the rear, middle and front axle, with one motor each.

    Raises
    ------
    ModelError
        If a number is out of its range, or an axle has no motor.
    """

    law: Annotated[Law, KEY] = "projective"
    directions: Annotated[Directions, KEY] = "sensors"
    share: Annotated[NonNegative, Unit("1")] = 1.0
    cap: Annotated[float, Ge(1), Unit("1")] = 1.5
    proportional: Annotated[float, Gt(0), Unit("N m s/rad")] = 4.0
    integral: Annotated[float, Gt(0), Unit("N m/rad")] = 40.0
    torque: Annotated[float, Gt(0), Unit("N m")] = math.inf
    motors: Annotated[Motors, KEY] = (2, 1, 2)

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
        return ControlState(
            _labels(wheels, "error_sum"), _labels(wheels, "direction_seen") if self.senses else ()
        )

    def commands(self, climber: Vehicle, at: Sensed, x: ControlState, speed: ca.SX) -> Commands:
        """Return reference rates, torques and the rates of the states for a speed [m/s]."""
        used = x.directions if self.senses else [self.share * phi for phi in at.directions()]
        relative = reference(climber, at.tilts, PerAxle(*used), self.law, self.cap)
        wanted = PerAxle(*(speed / climber.wheels[0].radius * ratio for ratio in relative))
        changes = [aim - spin for aim, spin in zip(wanted, at.spins, strict=True)]
        torques = [
            self.proportional * error + self.integral * total
            for error, total in zip(changes, x.integrals, strict=True)
        ]
        if self.senses:
            raw = estimated_directions(climber, at.tilts, at.rates, at.spins)
            changes += [(new - old) / SMOOTHING for new, old in zip(raw, x.directions, strict=True)]
        return Commands(wanted, *limited(self.torque, PerAxle(*torques)), tuple(changes))


def _labels(wheels: Sequence[str], name: str) -> PerAxle:
    return PerAxle(*(quantity_label(name, wheel) for wheel in wheels))


def limited(limit: float, wanted: PerAxle) -> tuple[PerAxle, ca.SX]:
    """Return motor torques scaled to the torque limit by (18) and (19) [N m], and the factor [1].

    (18) as printed does not limit negative torques; here the absolute value is limited.
    """
    if math.isinf(limit):
        return wanted, ca.SX(1)
    scale = limit / ca.fmax(limit, ca.mmax(ca.fabs(ca.vertcat(*wanted))))
    return PerAxle(*(scale * torque for torque in wanted)), scale


def largest_period(control: StepClimbing, climber: Vehicle) -> float:
    """Return the sample time above which a sampled controller is unstable [s].

    For a freely spinning wheel of inertia J/n with constant torque during the sample time T,
    error and integral advance by a matrix of trace ``2 - a - b/2`` and determinant ``1 - a + b/2``
    with ``a = T n kp / J`` and ``b = T^2 n ki / J``. It is stable for T below ``2 J / (n kp)`` and
    below ``2 kp / ki``.
    """
    wheels = (
        2 * (wheel.inertia or (0.0,))[0] / (count * control.proportional)
        for wheel, count in zip(climber.wheels, control.motors, strict=True)
    )
    return min(*wheels, 2 * control.proportional / control.integral)


def check_period(period: float, control: StepClimbing, climber: Vehicle) -> None:
    """Raise ModelError for a sample time that is not below `largest_period`, or not positive."""
    most = largest_period(control, climber)
    if not 0 < period < most:
        raise ModelError(
            f"period: expected a time between 0 and {most:g} s, the stability limit of the wheel "
            "rates (the least of 2 J / (n kp) of the axles and of 2 kp / ki), found "
            f"{period:g} s; change it, or reduce the gains"
        )


def climbing(
    model: Dae, control: WheelControl, section: Profile | None = None, *, sampled: bool = False
) -> Dae:
    """Return the dynamic model of a step climber with controlled wheels.

    ``model`` is the result of `slipfree.dynamics` for a step climber
    (`slipfree.catalog`), ``control`` a `StepClimbing` or
    `slipfree.climb.contact_path.Tracking`. Controllers with ``directions="contact"`` require the
    section of the ground (`slipfree.terrain.solids.section_of`). With ``sampled`` the torques of
    the axles remain inputs, for a sampled controller; `held_torques` are their values. The other
    input is the ``reference_speed`` of the vehicle [m/s]. A motion ends where the front body
    overturns.
    """
    vehicle = driven_vehicle(model)
    check_climber(vehicle)
    wheels = tuple(wheel.name for wheel in vehicle.wheels)
    labels = control.labels(wheels)
    x, speed = symbols(labels), new_variable(model, REFERENCE_SPEED)
    at = _sensed(vehicle, model, section)
    command = control.commands(vehicle, at, x, speed.symbol)
    tilt = Label(f"front_{UPRIGHT}", "rad", "the front body overturns (tilt)")
    limit = Limit(tilt, at.tilts.front, -MAX_TILT, MAX_TILT)
    model = replace(model, limits=(*model.limits, limit))
    states = [new_variable(model, *each) for each in zip(leaves(labels), leaves(x), strict=True)]
    names = (
        *_labels(wheels, "reference"),
        *_labels(wheels, "motor_torque"),
        quantity_label("torque_scale"),
    )
    outputs = *command.references, *command.torques, command.scale
    controller = ControlLaw(
        tuple(replace(s, rate=r) for s, r in zip(states, command.rates, strict=True)),
        (speed,),
        tuple(n * tau for n, tau in zip(control.motors, command.torques, strict=True)),
        tuple(zip(names, outputs, strict=True)),
    )
    return controlled(model, controller, sampled=sampled)


def held_torques(model: Dae, control: WheelControl) -> dict[str, ca.SX]:
    """Return the torques of the axles by name, for the model of a sampled controller [N m]."""
    columns = leaves(model.labels.u[0].wheels), control.motors, model.named("motor_torque")
    return {label.full: n * torque for label, n, torque in zip(*columns, strict=True)}


def _sensed(climber: Vehicle, model: Dae, section: Profile | None) -> Sensed:
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
                "found none; use directions = 'sensors'"
            )
        return directions(section, climber.wheels[0].radius, axles)

    return Sensed(
        Tilts(rear, rear + fold),
        Tilts(rate, rate + fold_rate),
        PerAxle(*x.spins),
        axles,
        PerAxle(*(ca.jtimes(place, q, v) for place in axles)),
        seen,
    )
