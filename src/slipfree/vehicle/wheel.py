"""Wheels: where they are, how they are driven, and their cross-section."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from slipfree.errors import ModelError
from slipfree.geometry.frame import Axis, Pose, Vector, check_vector, translation, turn, unit_vector
from slipfree.records import field_overview
from slipfree.vehicle.sections.base import Section

ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Wheel:
    """A wheel, a body of revolution about its axle.

    Attributes
    ----------
    name : str
        Unique in the vehicle.
    parent : str
        The joint that carries it, or ``"platform"``.
    at : tuple of 3 floats
        Its centre in the parent's frame. [m]
    section : Section
        Its cross-section, such as ``Torus(0.05, 0.25)``; on free rollers ``Omni(...)``.
    driven : bool
        Whether its rate is an input; a free wheel turns as the ground makes it.
    grip : float
        What its tread makes of the ground's coefficient of friction, as a factor. [1]
    mass : float
        Mass, at its centre. [kg]
    axle : {"x", "y", "z"} or tuple of 3 floats
        Direction of its axle in the parent's frame, to the right of its forward direction.
    """

    name: str
    parent: str
    at: Vector
    section: Section
    driven: bool
    grip: float = 1.0
    mass: float = 0.0
    axle: Axis = "x"

    def __repr__(self) -> str:
        return field_overview(self)

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[\w-]+", self.name):
            raise ModelError(
                f"wheel {self.name!r}: expected a name of letters, digits, _ and -, as results "
                "use it"
            )
        check_vector(f"wheel {self.name}: at", self.at)
        if not 0 < self.grip < math.inf:
            raise ModelError(f"wheel {self.name}: grip must be positive, found {self.grip}")
        if not 0 <= self.mass < math.inf:
            raise ModelError(
                f"wheel {self.name}: mass must be zero or more kilograms, found {self.mass}"
            )

        try:
            unit_vector(self.axle)
        except ModelError as error:
            raise ModelError(f"wheel {self.name}: axle: {error}") from error

    @property
    def mount(self) -> Pose:
        """Pose of its carrier, at its centre with the axle as x axis, in the parent's frame.

        The parent's axes, turned the shortest way.
        """
        x, y, z = unit_vector(self.axle)
        across = math.hypot(y, z)
        if across == 0 and x > 0:
            return translation(*self.at)
        shortest = (0.0, -z, y) if across > 0 else (0.0, 0.0, 1.0)
        return translation(*self.at) @ turn(shortest, math.atan2(across, x))

    @cached_property
    def radius(self) -> float:
        """Rolling radius: distance from the axle to the middle of the tread. [m]."""
        return float(self.section.outline(np.array(np.pi / 2))[1])

    @cached_property
    def half_width(self) -> float:
        """Largest distance of its surface from the plane of the wheel. [m]."""
        return float(np.abs(self.section.outline(np.array([0, np.pi]))[0]).max())

    @property
    def rollers(self) -> bool:
        """Whether free rollers let it move along its axle."""
        return self.section.rollers
