"""Grounds given by heights on a grid, interpolated by a bicubic spline."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import solve_banded

from slipfree.named import Array
from slipfree.terrain.base import Grid

ON_KNOT = 1e-10  # a point nearer to a knot than this, in cells, lies on it
CHUNK = 8192  # points evaluated at once: the temporaries stay in the cache
LARGE = 2**22  # coefficients above which the table is stored once, not four times


@dataclass(frozen=True, eq=False)
class Bicubic:
    """The bicubic not-a-knot spline through the heights of a grid.

    It is the surface of ``scipy.interpolate.RectBivariateSpline(x, y, z, s=0)``. Height and
    derivatives are polynomials inside a cell. A point on a knot belongs to the cell on its right,
    a point on the last knot to the last cell. Outside the domain the polynomial of the nearest
    cell continues.

    Attributes
    ----------
    grid : Grid
        The nodes.

    Notes
    -----
    CasADi's own spline nodes cannot be used: on a knot their third derivatives write beyond their
    memory, and their fourth derivatives do so everywhere (3.8.2). Here only the 16 spline
    coefficients of a cell are looked up, in a table that is constant for differentiation, and the
    rest is an SX polynomial. Its derivatives exist to any order.

    One instance must not be evaluated by two threads at once; give each its own unpickled copy.
    """

    grid: Grid

    def __getstate__(self) -> dict[str, Grid]:
        """Return the grid; an unpickled copy computes the same coefficients again."""
        return {"grid": self.grid}

    @cached_property
    def origin(self) -> tuple[float, float, float]:
        """Middle of the domain, and mean height. [m]"""
        x_min, x_max, y_min, y_max = self.domain
        return 0.5 * (x_min + x_max), 0.5 * (y_min + y_max), float(self.grid.z.mean())

    @property
    def domain(self) -> tuple[float, float, float, float]:
        """``x_min, x_max, y_min, y_max`` of the nodes. [m]"""
        x, y = self.grid.x, self.grid.y
        return float(x[0]), float(x[-1]), float(y[0]), float(y[-1])

    def height(self, x: ca.SX, y: ca.SX) -> ca.SX:
        """Return the local height at a local point. [m]"""
        a, b = self._cells(x, y)
        i, j = (
            ca.fmin(ca.fmax(ca.floor(position + ON_KNOT), 0), nodes - 2)
            for position, nodes in zip((a, b), self.grid.z.shape, strict=True)
        )
        c = ca.reshape(self._gather(ca.vertcat(i, j)), 4, 4)
        rows, columns = _basis(a - i), _basis(b - j)
        # Two sums of four: half the operations of one sum of sixteen products.
        return sum(
            (
                columns[n] * sum((rows[m] * c[m, n] for m in range(4)), start=ca.SX(0))
                for n in range(4)
            ),
            start=ca.SX(0),
        )

    def elevation(self, x: Array, y: Array) -> Array:
        """Return the heights in map coordinates at map points of equal shape. [m]"""
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        x_0, y_0, z_0 = self.origin
        heights = np.empty(x.size)
        flat_x, flat_y = x.reshape(-1), y.reshape(-1)
        for start in range(0, x.size, CHUNK):
            part = slice(start, start + CHUNK)
            heights[part] = self._numeric(flat_x[part] - x_0, flat_y[part] - y_0)
        return heights.reshape(x.shape) + z_0

    def _cells(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Return a local point counted in cells from the first node."""
        x_0, y_0, _ = self.origin
        h_x, h_y = self.grid.spacing
        return (x - (self.grid.x[0] - x_0)) / h_x, (y - (self.grid.y[0] - y_0)) / h_y

    def _numeric(self, x: Array, y: Array) -> Array:
        """Return the local heights at local points, shape (n,)."""
        n_x, n_y = self.grid.z.shape
        a, b = self._cells(x, y)
        # fmin and fmax put NaN into a valid cell; the polynomial then returns NaN.
        i = np.fmin(np.fmax(np.floor(a + ON_KNOT), 0), n_x - 2)
        j = np.fmin(np.fmax(np.floor(b + ON_KNOT), 0), n_y - 2)
        rows, columns = _basis(a - i), _basis(b - j)
        table = self._coefficients.reshape(-1)
        first = i.astype(np.intp) * (n_y + 2) + j.astype(np.intp)
        heights = np.zeros(x.size)
        for m in range(4):
            line = np.zeros(x.size)
            for n in range(4):
                line += columns[n] * table[first + (m * (n_y + 2) + n)]
            heights += rows[m] * line
        return heights

    @cached_property
    def _coefficients(self) -> Array:
        """Spline coefficients of the local heights over 36, shape (n_x + 2, n_y + 2)."""
        along_x = _solve_not_a_knot(self.grid.z - self.origin[2])
        return np.ascontiguousarray(_solve_not_a_knot(along_x.T).T) / 36

    @cached_property
    def _gather(self) -> ca.Function:
        return _gather(self._coefficients, 4 if self._coefficients.size <= LARGE else 1)


def _basis(u: Any) -> tuple[Any, Any, Any, Any]:
    """Return the four uniform cubic B-splines of a cell at ``u`` in [0, 1], times six."""
    v = 1 - u
    first, last = v * v * v, u * u * u
    second = 4 + 3 * (last - 2 * u * u)
    return first, second, 6 - first - second - last, last


def _solve_not_a_knot(values: Array) -> Array:
    """Return the uniform B-spline coefficients of interpolating cubics along the first axis.

    Parameters
    ----------
    values : ndarray, shape (n, m)
        Values at n nodes, n >= 4.

    Returns
    -------
    ndarray, shape (n + 2, m)
        Of ``m`` splines whose third derivative is continuous at the second and the last but one
        node.
    """
    n = values.shape[0]
    bands = np.zeros((9, n + 2))  # bands[4 + i - j, j] is entry i, j of the matrix
    bands[5, : n], bands[4, 1 : n + 1], bands[3, 2:] = 1 / 6, 4 / 6, 1 / 6
    # The third derivative is a third difference of coefficients; its jump a fourth.
    for offset, weight in enumerate((1, -4, 6, -4, 1)):
        bands[4 - offset, offset] = weight
        bands[8 - offset, n - 3 + offset] = weight
    right = np.zeros((n + 2, values.shape[1]))
    right[1:-1] = values
    return np.asarray(solve_banded((4, 4), bands, right, overwrite_ab=True, overwrite_b=True))


def _gather(coefficients: Array, run: int) -> ca.Function:
    """Return the look-up of a cell's 16 coefficients, a constant for differentiation.

    Parameters
    ----------
    coefficients : ndarray, shape (n_x + 2, n_y + 2)
        The table.
    run : {1, 4}
        How many neighbours along x are stored together. Four make a cell take 4 look-ups instead
        of 16, at four times the memory.

    Returns
    -------
    Function
        ``[i, j] -> c``, shape (2, 1) to (16, 1), x fastest, of whole numbers. A linear
        interpolant asked at its nodes returns the table's numbers unchanged.
    """
    runs = np.lib.stride_tricks.sliding_window_view(coefficients, run, axis=0)
    nodes = [list(range(size)) for size in runs.shape[:2]]
    values = runs.transpose(1, 0, 2).reshape(-1)
    table = ca.interpolant("table", "linear", nodes, values, {"lookup_mode": ["exact", "exact"]})
    cell, found = ca.MX.sym("cell", 2), ca.MX.sym("found", 16)
    places = [ca.DM([m, n]) for n in range(4) for m in range(0, 4, run)]
    names = (["i0", "out_o0"], ["jac_o0_i0"])
    constant = ca.Function("jac_gather", [cell, found], [ca.MX(16, 2)], *names)
    options = {
        "never_inline": True,
        "enable_forward": False,
        "enable_reverse": False,
        "jac_penalty": 0,
        "custom_jacobian": constant,
    }
    return ca.Function("gather", [cell], [ca.vertcat(*map(table, (cell + p for p in places)))], options)
