"""Drives of wheels and commanded coordinates: how an input acts on them in dynamics."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Annotated, ClassVar

import casadi as ca
from annotated_types import Ge, Gt, Lt, Unit, doc

from slipfree.core.arguments import checked


@dataclass(frozen=True)
class Drive:
    """Base class of drives; it exerts no effort, as for a wheel that is not driven.

    A drive acts on a wheel or on a commanded coordinate. Its effort is a torque on a wheel or on a
    coordinate that turns, and a force on a coordinate that slides, with the units N and m instead
    of N m and rad. Kinematic and quasi-static models use the rate of every drive.

    Attributes
    ----------
    prescribed : bool
        Whether the input is the rate, and the effort follows from the motion.
    takes_effort : bool
        Whether the input is the effort; otherwise it is a rate.
    has_integral : bool
        Whether the drive has a controller with an integral term, which is a state of the model.
    """

    prescribed: ClassVar[bool] = False
    takes_effort: ClassVar[bool] = False
    has_integral: ClassVar[bool] = False

    @property
    def added_inertia(self) -> float:
        """Inertia of the drive, which is added to that of the wheel or the coordinate [kg m^2]."""
        return 0.0

    def effort(self, wanted: ca.SX, rate: ca.SX, integral: ca.SX) -> tuple[ca.SX, ca.SX]:  # noqa: ARG002
        """Return the effort and the rate of the integral.

        Parameters
        ----------
        wanted : SX, shape (1, 1)
            The input. [rad/s or N m]
        rate : SX, shape (1, 1)
            Rate of the wheel or the coordinate. [rad/s]
        integral : SX, shape (1, 1)
            Integral of the controller. [N m]

        Returns
        -------
        tuple of 2 SX, shape (1, 1)
            Effort in the sense of the rate [N m], and rate of the integral [N m/s].
        """
        return ca.SX(0), ca.SX(0)


@dataclass(frozen=True)
class Rate(Drive):
    """Ideal drive: the input is the rate; the effort follows from the motion."""

    prescribed: ClassVar[bool] = True


@dataclass(frozen=True)
class Torque(Drive):
    """Drive without controller: the input is the effort, a torque or a force."""

    takes_effort: ClassVar[bool] = True

    def effort(self, wanted: ca.SX, rate: ca.SX, integral: ca.SX) -> tuple[ca.SX, ca.SX]:  # noqa: ARG002
        """Return the input as effort; there is no integral."""
        return wanted, ca.SX(0)


@checked
@dataclass(frozen=True)
class Motor(Drive):
    """Direct-current motor with a speed controller: the input is the reference rate.

    The effort is ``kp (wanted - rate) + e``, limited to ``stall min(1, 1 - rate / no_load)``
    forward and ``stall min(1, 1 + rate / no_load)`` backward. The integral ``e`` follows
    ``e' = ki (wanted - rate - (unlimited effort - effort) / kp)``; the last term prevents wind-up.
    Units are those of a rotation; for a coordinate that slides, N and m replace N m and rad.

    Attributes
    ----------
    stall : float
        Largest effort, at the output of the gear. [N m]
    no_load : float
        Rate at which the effort vanishes. [rad/s]
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
    stall: Annotated[float, Gt(0), Lt(inf), Unit("N m"), doc("largest effort, behind the gear")]
    no_load: Annotated[float, Gt(0), Lt(inf), Unit("rad/s"), doc("rate without effort")]
    kp: Annotated[float, Gt(0), Lt(inf), Unit("N m s/rad"), doc("proportional gain")]
    ki: Annotated[float, Ge(0), Lt(inf), Unit("N m/rad"), doc("integral gain")] = 0.0
    rotor_inertia: Annotated[
        float, Ge(0), Lt(inf), Unit("kg m^2"), doc("inertia of the rotor, behind the gear")
    ] = 0.0

    @property
    def added_inertia(self) -> float:
        """Moment of inertia of the rotor, times the square of the gear ratio [kg m^2]."""
        return self.rotor_inertia

    def effort(self, wanted: ca.SX, rate: ca.SX, integral: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the limited effort of the controller, and the rate of its integral."""
        error = wanted - rate
        unlimited = self.kp * error + integral
        forward, backward = (
            self.stall * ca.fmin(1, 1 - sign * rate / self.no_load) for sign in (1, -1)
        )
        effort = ca.fmax(-backward, ca.fmin(forward, unlimited))
        return effort, self.ki * (error - (unlimited - effort) / self.kp)


NO_DRIVE = Drive()  # of wheels that are not driven, and of coordinates that are not commanded
RATE = Rate()  # the default
DRIVES: dict[str, type[Drive]] = {"rate": Rate, "torque": Torque, "motor": Motor}
