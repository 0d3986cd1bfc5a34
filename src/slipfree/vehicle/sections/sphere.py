"""Spherical wheel."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from slipfree.core.schema import Length
from slipfree.vehicle.sections.base import AXLE, Section


@dataclass(frozen=True)
class Sphere(Section):
    """Spherical wheel that rotates about an axle through its centre.

    Attributes
    ----------
    radius : float
        Radius of the ball. [m]
    """

    radius: Length

    @property
    def torus_radii(self) -> tuple[float, float]:
        """Radii of the sphere as a torus [m]."""
        return self.radius, 0.0

    def profile(self, axial: ca.SX, radial: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return axial and radial coordinates of the point with a given outward normal [m]."""
        return self.radius * axial, self.radius * radial

    def support(self, normal: ca.SX, axle: ca.SX = AXLE) -> ca.SX:  # noqa: ARG002
        """Return the point of the surface with a given outward normal, shape (3, 1) [m]."""
        return self.radius * normal

    def tread_radius(self, axial: ca.SX, radial: ca.SX) -> ca.SX:  # noqa: ARG002 - constant
        """Return the radius of the sphere, the same for every normal [m]."""
        return self.radius + 0 * axial  # SX or MX, as the normal
