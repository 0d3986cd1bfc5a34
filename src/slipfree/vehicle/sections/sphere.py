"""Spherical wheel."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from slipfree.vehicle.sections.base import AXLE, Section


@dataclass(frozen=True)
class Sphere(Section):
    """A ball that turns about an axle.

    Attributes
    ----------
    radius : float
        Its radius. [m]
    """

    radius: float

    def profile(self, axial: ca.SX, radial: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the point of the section with a given outward normal."""
        return self.radius * axial, self.radius * radial

    def support(self, normal: ca.SX, axle: ca.SX = AXLE) -> ca.SX:  # noqa: ARG002
        """Return the normal times the radius, for every axle."""
        return self.radius * normal

    def tread_radius(self, axial: ca.SX, radial: ca.SX) -> ca.SX:  # noqa: ARG002 - constant
        """Return the radius."""
        return ca.SX(self.radius)
