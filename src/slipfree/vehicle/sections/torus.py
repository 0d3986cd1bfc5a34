"""Torus: a wheel with a circular tread section."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from slipfree.core.schema import Length
from slipfree.vehicle.sections.base import AXLE, Section, components


@dataclass(frozen=True)
class Torus(Section):
    """Torus: a wheel with a circular tread section.

    Attributes
    ----------
    r1 : float
        Radius of the tube. [m]
    r2 : float
        Radius of the circle of tube centres; the rolling radius is ``r1 + r2``. [m]
    """

    r1: Length
    r2: Length

    @property
    def torus_radii(self) -> tuple[float, float]:
        """Radii of the tube and of the circle of tube centres [m]."""
        return self.r1, self.r2

    def profile(self, axial: ca.SX, radial: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return axial and radial coordinates of the point with a given outward normal [m]."""
        return self.r1 * axial, self.r2 + self.r1 * radial

    def support(self, normal: ca.SX, axle: ca.SX = AXLE) -> ca.SX:
        """Return the point of the surface with a given outward normal, shape (3, 1) [m].

        It is ``r1 n + r2 e`` with the normal ``n`` and the unit vector ``e`` along the component of
        ``n`` perpendicular to the axle.
        """
        return self.r1 * normal + self.r2 * components(normal, axle)[2]

    def tread_radius(self, axial: ca.SX, radial: ca.SX) -> ca.SX:  # noqa: ARG002 - constant
        """Return the radius of the tube, the same for every normal [m]."""
        return self.r1 + 0 * axial  # SX or MX, as the normal
