"""Thin disc: a wheel that touches the ground with its edge."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from slipfree.core.schema import Length
from slipfree.vehicle.sections.base import Section


@dataclass(frozen=True)
class Disc(Section):
    """A thin disc.

    Attributes
    ----------
    radius : float
        Radius of the edge. [m]
    """

    radius: Length

    @property
    def torus_radii(self) -> tuple[float, float]:
        """Radii of the disc as a torus [m]."""
        return 0.0, self.radius

    def profile(self, axial: ca.SX, radial: ca.SX) -> tuple[ca.SX, ca.SX]:  # noqa: ARG002 - an edge
        """Return axial and radial coordinates of the edge, the same for every normal [m]."""
        return 0 * axial, self.radius + 0 * axial  # SX or MX, as the normal
