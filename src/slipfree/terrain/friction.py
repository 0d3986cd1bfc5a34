"""Coefficient of friction of a ground: a number, a formula, or a map.

A friction map is the cubic B-spline whose coefficients are the values at the nodes, with the border
repeated. It is twice continuously differentiable and stays between the smallest and the largest
value of the 16 nodes around a point; unlike an interpolating spline it has no negative friction
between ice and rock. Outside the map, the values of the border continue. The spline smooths the
values instead of interpolating them: a jump between two nodes becomes a rise over three cells, with
96 % of it within two cells.
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from slipfree.core.errors import DataError, ModelError
from slipfree.core.lookups import LookupTable
from slipfree.core.records import Array
from slipfree.terrain.base import (
    TAYLOR,
    Formula,
    Grid,
    Terrain,
    check_formula,
    polynomial_jet,
    taylor_function,
)

# number, function of two SX scalars in map coordinates, or map; None if not given [1]
Friction = float | Formula | Grid | None
BORDER = 2  # repeated rows of nodes around a map that make it constant outside


def check_friction(mu: Friction) -> None:
    """Raise an error for an invalid coefficient of friction.

    Raises
    ------
    ModelError
        If a number is not positive and finite, if a function does not return one scalar that
        depends only on ``x`` and ``y``, or if ``mu`` has another type.
    DataError
        If a map has nodes without a value, or values that are not positive.
    """
    if mu is None:
        return
    if isinstance(mu, Grid):
        _check_map(mu)
    elif callable(mu):
        check_formula(mu, "friction", "coefficient")
    elif not isinstance(mu, float | int) or isinstance(mu, bool):
        raise ModelError(
            "friction: mu must be a number, a function of x and y, or a Grid, found "
            f"{type(mu).__name__}; pass float(mu), or read_map(path).grid for a file"
        )
    elif not 0 < mu < math.inf:
        raise ModelError(
            f"friction: mu must be positive and finite, found {mu}; for ice give a small number"
        )


def coefficient(
    mu: Friction,
    surface: Terrain | None,
    origin: tuple[float, float, float],
    x: ca.SX,
    y: ca.SX,
    lookups: LookupTable,
) -> ca.SX:
    """Return the coefficient of friction at a local point [1].

    ``surface`` is the surface of a friction map in the same local coordinates, ``origin`` the map
    coordinates of the local origin [m].
    """
    if isinstance(mu, float | int):
        return ca.SX(mu)
    if callable(mu):
        here = x + origin[0], y + origin[1]
        taylor = taylor_function(mu)
        if taylor is None:
            return ca.SX(mu(*here))
        return polynomial_jet(
            lookups.find(taylor, ca.vertcat(*here), order=4), TAYLOR, *here
        ).height
    if surface is None:
        return ca.SX(1.0)
    return surface.height(x, y, lookups) + surface.origin[2]


def map_domain(mu: Friction) -> tuple[float, float, float, float] | None:
    """Return ``x_min, x_max, y_min, y_max`` of a friction map; None without a map [m]."""
    return mu.domain if isinstance(mu, Grid) else None


def pad_border(grid: Grid) -> Grid:
    """Return a grid with the values of its border repeated around it.

    The B-spline of the larger grid is constant across the border, in the border cells and outside.
    A point outside, which a solver may evaluate, therefore has a value in the range of the map.
    Rounding errors grow with the third power of the distance, to 1e-9 at 200 cells.
    """
    x, y = (_extend_axis(axis, h) for axis, h in zip((grid.x, grid.y), grid.spacing, strict=True))
    return Grid(x, y, np.pad(grid.z, BORDER, mode="edge"))


def _extend_axis(axis: Array, spacing: float) -> Array:
    room = BORDER * spacing
    return np.linspace(axis[0] - room, axis[-1] + room, axis.size + 2 * BORDER)


def _check_map(grid: Grid) -> None:
    """Raise DataError for a map with nodes without a value, or values that are not positive."""
    if grid.holes is not None and grid.holes.any():
        i, j = np.argwhere(grid.holes)[0]
        raise DataError(
            f"friction: expected a coefficient at every node, found none at "
            f"{np.count_nonzero(grid.holes)} of {grid.z.size}, the first at x = {grid.x[i]:.9g} m, "
            f'y = {grid.y[j]:.9g} m; set fill = "linear" for holes inside the map, and cut off '
            "those at its border"
        )
    bad = ~(grid.z > 0)
    if bad.any():
        i, j = np.argwhere(bad)[0]
        raise DataError(
            f"friction: all coefficients must be positive, found {np.count_nonzero(bad)} of "
            f"{bad.size} that are not, the first z[{i}, {j}] = {grid.z[i, j]:g} at "
            f"x = {grid.x[i]:.9g} m, "
            f"y = {grid.y[j]:.9g} m; for ice give a small number"
        )
