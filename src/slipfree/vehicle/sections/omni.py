"""Omni wheel: a wheel with free rollers on its rim."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from slipfree.vehicle.sections.base import AXLE, Section


@dataclass(frozen=True)
class Omni(Section):
    """Omni wheel: free rollers whose common envelope has the shape of a wheel.

    Attributes
    ----------
    rim : Section
        Cross-section of the envelope of all rollers.
    """

    rollers: ClassVar[bool] = True
    rim: Section

    def __str__(self) -> str:
        """Return the kind and dimensions of the rim, followed by "on rollers"."""
        return f"{self.rim} on rollers"

    @property
    def torus_radii(self) -> tuple[float, float] | None:
        """Radii of the rim as a torus; None if it is not one [m]."""
        return self.rim.torus_radii

    def profile(self, axial: ca.SX, radial: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return axial and radial coordinates of the rim's point with an outward normal [m]."""
        return self.rim.profile(axial, radial)

    def support(self, normal: ca.SX, axle: ca.SX = AXLE) -> ca.SX:
        """Return the point of the rim's surface with an outward normal, shape (3, 1) [m]."""
        return self.rim.support(normal, axle)

    def tread_radius(self, axial: ca.SX, radial: ca.SX) -> ca.SX:
        """Return the radius of curvature of the rim's section for an outward normal [m]."""
        return self.rim.tread_radius(axial, radial)
