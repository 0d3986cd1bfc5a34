"""Wheels: position, drive, cross-section and mass."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.records import field_overview
from slipfree.core.schema import NonNegative, Positive
from slipfree.geometry.frame import Axis, Pose, Vector, translation, turn, unit_vector
from slipfree.system.forks import cached_property
from slipfree.vehicle.drives import NO_DRIVE, RATE, Drive
from slipfree.vehicle.sections import Section

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
        (`slipfree.vehicle.drives`).

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
