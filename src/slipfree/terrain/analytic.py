"""Grounds given by formulas."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.interval import Intervals, evaluate_interval
from slipfree.core.lookups import CellBounds, LookupTable
from slipfree.core.records import Array, field_overview
from slipfree.system.forks import cached_property
from slipfree.terrain import base
from slipfree.terrain.bicubic import Bicubic, friction_map

CHUNK = 4096  # points per call of a mapped function, which has a fixed number of points
BLOCK = 16  # side of a block of cells whose bounds of derivatives are computed together
CELL = 0.25  # side of a cell, as a share of the distance from it up to which its bounds hold
EVERYWHERE = (-math.inf, math.inf, -math.inf, math.inf)


@checked
@dataclass(frozen=True)
class Analytic(base.GroundFriction):
    """A ground whose height is a formula.

    Its local coordinates are equal to its map coordinates.

    Attributes
    ----------
    function : callable
        ``function(x, y)`` of two SX scalars that returns the height, built from operators and
        CasADi functions, at least twice continuously differentiable. [m]
    domain : tuple of 4 floats
        ``x_min, x_max, y_min, y_max`` of the region where the formula is valid; the whole plane
        by default. [m]
    mu : float, callable, Grid or None
        Coefficient of friction: a number, a function of two SX scalars, or a map, interpolated
        as in `slipfree.terrain.base`. None if the ground has no friction coefficient. [1]

    Raises
    ------
    ModelError
        If the domain is empty, if a function does not return one scalar that depends only on ``x``
        and ``y``, or if ``mu`` is of another type or a number that is not positive and finite.
    DataError
        If a friction map has nodes without a coefficient, or coefficients that are not positive.

    Notes
    -----
    An instance can be pickled if its functions can: define them at the top level of a module.
    A formula should not call ``casadi.interpolant`` with ``"bspline"``: CasADi 3.8.2 writes outside
    its arrays when it evaluates fourth derivatives, or third derivatives at knots. Use `Bicubic`.

    Examples
    --------
    >>> import casadi as ca
    >>> from slipfree import Analytic
    >>> ground = Analytic(lambda x, y: 0.1 * ca.sin(x) * ca.cos(y))
    """

    function: base.Formula
    domain: tuple[float, float, float, float] = EVERYWHERE
    mu: base.Friction = None

    __repr__ = field_overview

    def __post_init__(self) -> None:
        x_min, x_max, y_min, y_max = self.domain
        if not (x_min < x_max and y_min < y_max):
            raise ModelError(
                "terrain: domain must be (x_min, x_max, y_min, y_max) in metres with x_min < x_max "
                f"and y_min < y_max, found {self.domain}; correct the limits"
            )
        base.check_formula(self.function, "terrain", "height")
        base.check_friction(self.mu)

    def __getstate__(self) -> dict[str, Any]:
        """Return the arguments of the ground; compiled functions are rebuilt on demand."""
        return {"function": self.function, "domain": self.domain, "mu": self.mu}

    @property
    def origin(self) -> tuple[float, float, float]:
        """Map coordinates of the local origin: zero [m]."""
        return (0.0, 0.0, 0.0)

    def height(self, x: ca.SX, y: ca.SX, lookups: LookupTable) -> ca.SX:
        """Return the height at a point.

        Parameters
        ----------
        x, y : SX, shape (1, 1)
            The point, in local coordinates. [m]
        lookups : LookupTable
            Table to which the lookups that the result needs are added.

        Returns
        -------
        SX, shape (1, 1)
            Height above ``origin[2]``. [m]
        """
        return (
            ca.SX(self.function(x, y)) if self._taylor is None else self.jet(x, y, lookups).height
        )

    def jet(self, x: ca.SX, y: ca.SX, lookups: LookupTable) -> base.Jet:
        """Return the height at a point with its first and second derivatives.

        Parameters
        ----------
        x, y : SX, shape (1, 1)
            The point, in local coordinates. [m]
        lookups : LookupTable
            Table to which the lookups that the result needs are added.

        Returns
        -------
        Jet
            Height (1, 1) above ``origin[2]`` [m], gradient (2, 1) [1] and Hessian (2, 2) [1/m].
        """
        if self._taylor is None:
            if x.is_symbolic() and y.is_symbolic():
                return base.jet_of(ca.SX(self.function(x, y)), x, y)
            # derivatives are taken with respect to symbols only
            u, v = ca.SX.sym("u"), ca.SX.sym("v")
            jet = base.jet_of(ca.SX(self.function(u, v)), u, v)
            return base.Jet(*ca.substitute([*jet], [u, v], [x, y]))
        return base.polynomial_jet(
            lookups.find(self._taylor, ca.vertcat(x, y), order=4), base.TAYLOR, x, y
        )

    def hole_margin(self, x: ca.SX, y: ca.SX, lookups: LookupTable) -> None:
        """Return None: a formula has no holes."""

    def elevation(self, x: Array, y: Array) -> Array:
        """Return the heights at points.

        Parameters
        ----------
        x, y : ndarray, broadcastable shapes
            The points, in map coordinates. [m]

        Returns
        -------
        ndarray, of the common shape
            Heights in map coordinates. [m]
        """
        x, y = np.broadcast_arrays(x, y)
        count = -(-x.size // CHUNK)
        padded = [np.resize(each.reshape(-1), (max(count, 1), 1, CHUNK)) for each in (x, y)]
        heights = [np.array(self._numeric(*rows)) for rows in zip(*padded, strict=True)]
        return np.concatenate(heights, axis=None)[: x.size].reshape(x.shape)

    def derivative_bounds(self, x: Array, y: Array, reach: float) -> tuple[Array, Array]:
        """Return upper bounds of the slope and of the curvature around points.

        Parameters and results are those of `slipfree.Bicubic.derivative_bounds`. Interval
        arithmetic bounds the derivatives of the formula in squares around the points; without
        bounds of an operation, the results are infinite.
        """
        if self._taylor is not None:
            return np.full(x.size, np.inf), np.full(x.size, np.inf)
        return self._known_bounds.at(x, y, reach)

    def known_bounds(self, reach: float) -> CellBounds:
        """Return the results of `derivative_bounds` that were computed for a reach.

        Parameters
        ----------
        reach : float
            Distance in x and y within which the bounds hold. [m]

        Returns
        -------
        CellBounds
            Bounds of slope [1] and curvature [1/m] by cell.
        """
        return self._known_bounds.known(reach, self.origin)

    def _block_bounds(self, i: int, j: int, reach: float) -> Array:
        """Return bounds of slope [1] and curvature [1/m], shape (2, BLOCK, BLOCK).

        They hold in the cells of block i, j and up to ``reach`` [m] beside them on all sides.
        """
        sides = [CELL * reach * np.arange(BLOCK * k, BLOCK * (k + 1)) for k in (i, j)]
        low = np.stack([each.ravel() for each in np.meshgrid(*sides, indexing="ij")]) - reach
        boxes = Intervals(low, low + (2 + CELL) * reach)
        magnitudes = evaluate_interval(self._derivatives, boxes).magnitude
        return base.bounds_of(*magnitudes).reshape(2, BLOCK, BLOCK)

    @cached_property
    def _known_bounds(self) -> base.DerivativeBounds:
        return base.DerivativeBounds(
            BLOCK, self._block_bounds, self.domain, (0.0, 0.0), lambda reach: (CELL * reach,) * 2
        )

    @cached_property
    def _derivatives(self) -> ca.Function:
        """First and second derivatives of the formula: x, y, xx, xy, yy."""
        at = ca.SX.sym("at", 2)
        hessian, gradient = ca.hessian(ca.SX(self.function(at[0], at[1])), at)
        column = ca.vertcat(gradient, hessian[0, 0], hessian[0, 1], hessian[1, 1])
        return ca.Function("derivatives", [at], [ca.densify(column)])

    @cached_property
    def _friction_map(self) -> Bicubic | None:
        return friction_map(self.mu, (0.0, 0.0))

    @cached_property
    def _taylor(self) -> ca.Function | None:
        """Lookup function of the height formula if it contains function calls, else None."""
        return base.taylor_function(self.function)

    @cached_property
    def _numeric(self) -> ca.Function:
        x, y = ca.SX.sym("x"), ca.SX.sym("y")
        return ca.Function("elevation", [x, y], [ca.densify(ca.SX(self.function(x, y)))]).map(CHUNK)
