"""Wheels: position, drive, cross-section and mass; drives: how an input acts in dynamics.

Commanded coordinates have drives, too.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from math import inf
from typing import Annotated, Any, ClassVar

import casadi as ca
import numpy as np
from annotated_types import Ge, Gt, Lt, Unit, doc

from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.records import field_overview
from slipfree.core.schema import NonNegative, Positive
from slipfree.geometry.frame import Axis, Pose, Vector, translation, turn, unit_vector
from slipfree.system.forks import cached_property
from slipfree.vehicle.sections import Section


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


ORIGIN = (0.0, 0.0, 0.0)


@checked
@dataclass(frozen=True)
class Wheel:
    """A wheel, a body of revolution about its axle.

    Attributes
    ----------
    name : str
        Name, unique among the wheels.
    parent : str
        Name of the joint that carries the wheel, or ``"platform"``.
    at : tuple of 3 floats
        Centre of the wheel in the parent's frame. [m]
    section : Section
        Cross-section, such as ``Torus(0.05, 0.25)``; ``Omni(...)`` for an omni or mecanum wheel.
    driven : bool
        Whether the wheel's rate is an input; the rate of a free wheel follows from the motion.
    grip : float
        Factor that multiplies the ground's coefficient of friction. [1]
    mass : float
        Mass; its centre is the wheel's centre. [kg]
    axle : {"x", "y", "z"} or tuple of 3 floats
        Direction of the axle in the parent's frame; to the right for a wheel that rolls forward.
    static_depth : float or None
        Depth of the wheel in the ground under an equal share of the weight, for vehicles whose
        wheels cannot all touch a rigid ground, and for dynamics; None for 1/50 of the rolling
        radius, or 1/250 in the dynamics of vehicles whose wheels can all touch a rigid ground. [m]
    inertia : tuple of 2 floats or None
        Moments of inertia about the axle and about a perpendicular axis through the centre; None
        for those of a homogeneous cylinder. [kg m^2]
    drive : Drive
        Drive of a driven wheel, such as ``Rate()``, ``Torque()`` or ``Motor(...)``, for dynamics
        (`slipfree.vehicle.wheel`).

    Raises
    ------
    ModelError
        If the name has other characters than letters, digits, _ and -, or if a number or the
        direction of the axle is invalid.
    """

    name: str
    parent: str
    at: Vector
    section: Section
    driven: bool
    grip: Positive = 1.0
    mass: NonNegative = 0.0
    axle: Axis = "x"
    static_depth: Positive | None = None
    inertia: tuple[Positive, Positive] | None = None
    drive: Drive = RATE

    __repr__ = field_overview

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[\w-]+", self.name):
            raise ModelError(
                f"wheel {self.name!r}: expected a name of letters, digits, _ and -, since it is "
                "part of names in results; rename the wheel"
            )
        try:
            unit_vector(self.axle)
        except ModelError as error:
            raise ModelError(f"wheel {self.name!r}: axle: {error}") from error

    @property
    def mount(self) -> Pose:
        """Pose of the carrier in the parent's frame: origin at the centre, x axis along the axle.

        The orientation is the smallest rotation that aligns the parent's x axis with the axle.
        """
        x, y, z = unit_vector(self.axle)
        across = math.hypot(y, z)
        if across == 0 and x > 0:
            return translation(*self.at)
        shortest = (0.0, -z, y) if across > 0 else (0.0, 0.0, 1.0)
        return translation(*self.at) @ turn(shortest, math.atan2(across, x))

    @property
    def depth(self) -> float:
        """Value of ``static_depth``, or 1/50 of the rolling radius if it is None [m]."""
        return self.radius / 50 if self.static_depth is None else self.static_depth

    @property
    def acting_drive(self) -> Drive:
        """Drive of the wheel; a drive without effort if the wheel is not driven."""
        return self.drive if self.driven else NO_DRIVE

    @cached_property
    def radius(self) -> float:
        """Rolling radius: distance from the axle to the middle of the tread [m].

        An expression in parameters if the section contains one.
        """
        radius: Any = ca.SX(self.section.profile(ca.SX(0), ca.SX(1))[1])
        return float(radius) if radius.is_constant() else radius

    @cached_property
    def half_width(self) -> float:
        """Largest distance of the wheel's surface from the wheel's plane [m]."""
        return float(np.abs(self.section.outline(np.array([0, np.pi]))[0]).max())

    @property
    def rollers(self) -> float | None:
        """Angle from the wheel's axle to the axles of free rollers; None without rollers [rad]."""
        return self.section.rollers


def wheel_inertia(wheel: Wheel) -> tuple[float, float]:
    """Return the moments of inertia of a wheel about its axle and across it [kg m^2].

    Without given numbers they are those of a homogeneous cylinder of the wheel's radius and width.
    """
    if wheel.inertia is not None:
        return wheel.inertia
    axial = wheel.mass * wheel.radius**2 / 2
    return axial, axial / 2 + wheel.mass * wheel.half_width**2 / 3
