"""Wheels: tori, with the disc and the sphere as their limits."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from slipfree.errors import ModelError
from slipfree.geometry.frame import Axis, Pose, Vector, check_vector, translation, turn, unit_vector

ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Wheel:
    """A torus wheel.

    Attributes
    ----------
    name : str
        Unique in the vehicle.
    parent : str
        The joint that carries it, or ``"platform"``.
    at : tuple of 3 floats
        Its centre in the parent's frame. [m]
    r1 : float
        Radius of the tube, zero for a disc. [m]
    r2 : float
        Radius of the circle of tube centres, zero for a sphere; the rolling radius is
        ``r1 + r2``. [m]
    driven : bool
        Whether its rate is an input; a free wheel turns as the ground makes it.
    grip : float
        What its tread makes of the ground's coefficient of friction, as a factor. [1]
    mass : float
        Mass, at its centre. [kg]
    axle : {"x", "y", "z"} or tuple of 3 floats
        Direction of its axle in the parent's frame, to the right of its forward direction.
    rollers : bool
        Whether free rollers on its rim leave it free to move along its axle (an omni wheel): slip
        across it then costs nothing and no force acts across it.
    """

    name: str
    parent: str
    at: Vector
    r1: float
    r2: float
    driven: bool
    grip: float = 1.0
    mass: float = 0.0
    axle: Axis = "x"
    rollers: bool = False

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[\w-]+", self.name):
            raise ModelError(
                f"wheel {self.name!r}: expected a name of letters, digits, _ and -, as results "
                "use it"
            )
        check_vector(f"wheel {self.name}: at", self.at)
        for key, radius in (("r1", self.r1), ("r2", self.r2)):
            if not (math.isfinite(radius) and radius >= 0):
                raise ModelError(
                    f"wheel {self.name}: {key} must be a radius of zero or more metres, "
                    f"found {radius}"
                )
        if self.radius <= 0:
            raise ModelError(f"wheel {self.name}: r1 + r2 must be positive, found {self.radius}")
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

    @property
    def radius(self) -> float:
        """Rolling radius ``r1 + r2``. [m]."""
        return self.r1 + self.r2
