"""Wheels: tori, with the disc and the sphere as their limits."""

from __future__ import annotations

import math
from dataclasses import dataclass

from slipfree.errors import ModelError


@dataclass(frozen=True)
class Wheel:
    """A torus wheel whose axle is the x axis of the part that carries it.

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
    """

    name: str
    parent: str
    at: tuple[float, float, float]
    r1: float
    r2: float
    driven: bool
    grip: float = 1.0
    mass: float = 0.0

    def __post_init__(self) -> None:
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

    @property
    def radius(self) -> float:
        """Rolling radius ``r1 + r2``. [m]."""
        return self.r1 + self.r2
