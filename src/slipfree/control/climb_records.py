"""Records of a climb's controller, and their labels."""

from __future__ import annotations

from typing import Any, NamedTuple

from slipfree.control.reference_speeds import PerAxle, Tilts
from slipfree.control.step_climbing import Driver
from slipfree.records import Label
from slipfree.vehicle.climber import AXLES


class Measured(NamedTuple):
    """Quantities that the sensors of the controller measure.

    Attributes
    ----------
    tilts, rates : Tilts
        Tilts of the bodies, nose up, and their rates. [rad, rad/s]
    spins : PerAxle
        Rates of the wheels, forward positive. [rad/s]
    """

    tilts: Tilts
    rates: Tilts
    spins: PerAxle


class ControlState(NamedTuple):
    """States of the controller.

    Attributes
    ----------
    integrals : PerAxle or ()
        Integrals of the errors of the wheel rates. [rad]
    directions : PerAxle or ()
        Smoothed estimates of the axles' directions. [rad]
    lagging : PerAxle or ()
        Filtered errors of the wheel rates, for the derivative gain. [rad/s]
    """

    integrals: PerAxle | tuple[()]
    directions: PerAxle | tuple[()]
    lagging: PerAxle | tuple[()]


class ControlInputs(NamedTuple):
    """Input of the controller: the reference speed of the vehicle [m/s]."""

    speed: Any


class ControlOutputs(NamedTuple):
    """Outputs of the controller along a motion.

    Attributes
    ----------
    tilts : Tilts
        Tilts of the bodies. [rad]
    directions : PerAxle
        Angles of the directions in which the axles can move over their contacts. [rad]
    references : PerAxle
        Reference rates of the wheels. [rad/s]
    torques : PerAxle
        Torques of the motors, one per wheel. [N m]
    scale : SX
        Factor by which the torque limit of the motors scales all torques. [1]
    energy : SX
        Kinetic and potential energy of the vehicle, and elastic energy of the contacts. [J]
    """

    tilts: Tilts
    directions: PerAxle
    references: PerAxle
    torques: PerAxle
    scale: Any
    energy: Any


def _each(name: str, unit: str, words: str) -> PerAxle:
    return PerAxle(*(Label(name, unit, words, axle) for axle in AXLES))


def state_labels(control: Driver) -> ControlState:
    """Return the labels of the states of a controller."""
    return ControlState(
        _each("error_sum", "rad", "integral of the wheel-rate error") if control.integral else (),
        _each("direction_seen", "rad", "smoothed estimate of the axle's direction from sensors")
        if control.senses
        else (),
        _each("error_lag", "rad s-1", "filtered wheel-rate error, for the derivative gain")
        if control.derivative
        else (),
    )


INPUTS = ControlInputs(Label("speed", "m s-1", "reference speed of the vehicle"))
OUTPUTS = ControlOutputs(
    Tilts(
        *(
            Label(f"tilt_{name}", "rad", f"tilt of the {name} body, nose up positive")
            for name in ("rear", "front")
        )
    ),
    _each("direction", "rad", "direction in which the axle can move over its contacts"),
    _each("reference", "rad s-1", "reference rate of the wheels"),
    _each("motor_torque", "N m", "commanded motor torque of a wheel"),
    Label("torque_scale", "1", "factor by which the torque limit scales all torques"),
    Label("energy", "J", "kinetic and potential energy, including the springs of the contacts"),
)
