"""A ground with CasADi's own spline, and the map of hills on which others are compared with it."""

from __future__ import annotations

import casadi as ca
import numpy as np

from slipfree import Bicubic, Grid
from slipfree.core.lookups import LookupTable
from slipfree.terrain.base import Jet, jet_of

EXTENT = 20.0  # side of the map [m]


class Stock:
    """Terrain with CasADi's own spline: a fitted B-spline as one node of the graph."""

    origin = (0.0, 0.0, 0.0)
    has_friction, friction_domain = False, None

    def __init__(self, grid: Grid) -> None:
        nodes = [list(grid.x), list(grid.y)]
        spline = ca.interpolant("spline", "bspline", nodes, grid.z.ravel(order="F"))
        place = ca.MX.sym("place", 2)
        self.function = ca.Function("height", [place], [spline(place)], {"never_inline": True})
        self.domain = (0.0, EXTENT, 0.0, EXTENT)
        self.elevation = Bicubic(grid).elevation  # for the check of the start only

    def height(self, x: ca.SX, y: ca.SX, _lookups: LookupTable | None = None) -> ca.SX:
        """Return the height as a call of the node. [m]."""
        return self.function(ca.vertcat(x, y))

    def jet(self, x: ca.SX, y: ca.SX, _lookups: LookupTable | None = None) -> Jet:
        """Return height, gradient and Hessian, by CasADi's differentiation of the node."""
        return jet_of(self.height(x, y), x, y)

    def friction(self, _x: ca.SX, _y: ca.SX, _lookups: LookupTable) -> ca.SX:
        """Return a coefficient of friction of one, which is never used. [1]."""
        return ca.SX(1)

    def hole_margin(self, _x: ca.SX, _y: ca.SX, _lookups: LookupTable) -> None:
        """Return no distance: the map has no holes."""


def surface(nodes: int) -> Grid:
    """Return hills with shorter waves on them, relief about 0.7 m, on a square map."""
    axis = np.linspace(0, EXTENT, nodes)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    z = 0.3 * np.sin(0.7 * x) * np.cos(0.5 * y) + 0.05 * np.sin(2.1 * x + 1.3 * y)
    return Grid(axis, axis, z)
