"""Drives of wheels: how the input of a driven wheel acts on it in dynamics."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import inf
from typing import ClassVar

import casadi as ca

from slipfree.errors import ModelError


@dataclass(frozen=True)
class Drive:
    """Base class of drives of wheels; it exerts no torque, as for a wheel that is not driven.

    Kinematic and quasi-static models use the rate of every driven wheel.

    Attributes
    ----------
    input : tuple of 3 str
        Name of the input, its unit, and its description, which the wheel's name completes.
    prescribed : bool
        Whether the wheel rotates at the rate of its input; the torque follows from the motion.
    has_integral : bool
        Whether the drive has a controller with an integral term, which is a state of the model.
    """

    input: ClassVar[tuple[str, str, str]] = ("rate", "rad s-1", "rate of")
    prescribed: ClassVar[bool] = False
    has_integral: ClassVar[bool] = False

    @property
    def added_inertia(self) -> float:
        """Moment of inertia of the drive about the axle [kg m^2]."""
        return 0.0

    def torque(self, wanted: ca.SX, rate: ca.SX, integral: ca.SX) -> tuple[ca.SX, ca.SX]:  # noqa: ARG002
        """Return the torque on the wheel and the rate of the integral.

        Parameters
        ----------
        wanted : SX, shape (1, 1)
            The input. [rad/s or N m]
        rate : SX, shape (1, 1)
            Rate of the wheel. [rad/s]
        integral : SX, shape (1, 1)
            Integral of the controller. [N m]

        Returns
        -------
        tuple of 2 SX, shape (1, 1)
            Torque, forward positive [N m], and rate of the integral [N m/s].
        """
        return ca.SX(0), ca.SX(0)


@dataclass(frozen=True)
class Rate(Drive):
    """Ideal drive: the wheel rotates at the rate of its input; the torque follows from that."""

    prescribed: ClassVar[bool] = True


@dataclass(frozen=True)
class Torque(Drive):
    """Drive without controller: the input is the torque on the wheel."""

    input: ClassVar[tuple[str, str, str]] = ("torque", "N m", "torque on")

    def torque(self, wanted: ca.SX, rate: ca.SX, integral: ca.SX) -> tuple[ca.SX, ca.SX]:  # noqa: ARG002
        """Return the input as torque; there is no integral."""
        return wanted, ca.SX(0)


@dataclass(frozen=True)
class Motor(Drive):
    """Direct-current motor with a speed controller: the input is the wanted rate of the wheel.

    The torque is ``kp (wanted - rate) + e``, limited to ``stall min(1, 1 - rate / no_load)``
    forward and ``stall min(1, 1 + rate / no_load)`` backward. The integral ``e`` follows
    ``e' = ki (wanted - rate - (unlimited torque - torque) / kp)``; the last term prevents wind-up.

    Attributes
    ----------
    stall : float
        Largest torque on the wheel, at the output of the gear. [N m]
    no_load : float
        Rate of the wheel at which the torque vanishes. [rad/s]
    kp, ki : float
        Gains of the controller. [N m s/rad, N m/rad]
    rotor_inertia : float
        Moment of inertia of the rotor, times the square of the gear ratio. [kg m^2]

    Raises
    ------
    ModelError
        If a number is not positive and finite; ``ki`` and ``rotor_inertia`` may be zero.
    """

    has_integral: ClassVar[bool] = True
    stall: float
    no_load: float
    kp: float
    ki: float = 0.0
    rotor_inertia: float = 0.0

    def __post_init__(self) -> None:
        for each in fields(self):
            value, least = getattr(self, each.name), each.name in ("ki", "rotor_inertia")
            if not (0 < value < inf or (least and value == 0)):
                words = "finite number of zero or more" if least else "finite positive number"
                raise ModelError(f"motor: {each.name!r}: expected a {words}, found {value}")

    @property
    def added_inertia(self) -> float:
        """Moment of inertia of the rotor, times the square of the gear ratio [kg m^2]."""
        return self.rotor_inertia

    def torque(self, wanted: ca.SX, rate: ca.SX, integral: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the limited torque of the controller, and the rate of its integral."""
        error = wanted - rate
        unlimited = self.kp * error + integral
        forward, backward = (
            self.stall * ca.fmin(1, 1 - sign * rate / self.no_load) for sign in (1, -1)
        )
        torque = ca.fmax(-backward, ca.fmin(forward, unlimited))
        return torque, self.ki * (error - (unlimited - torque) / self.kp)


NO_DRIVE = Drive()  # of wheels that are not driven
RATE = Rate()  # the default of all wheels
DRIVES: dict[str, type[Drive]] = {"rate": Rate, "torque": Torque, "motor": Motor}
