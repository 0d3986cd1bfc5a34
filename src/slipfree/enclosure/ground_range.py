"""Bounds of the heights and slopes of a map over rectangles.

About a point, the spline is its second Taylor polynomial up to a remainder, which the largest third
derivatives of the cells bound: a derivative of a B-spline lies between its smallest and its
largest coefficient. It holds across cells, since the second derivatives are continuous.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from slipfree.core.interval import Intervals, around
from slipfree.core.lookups import pointer
from slipfree.core.records import Array, Indices, Mask
from slipfree.terrain.bicubic import Bicubic, basis

ORDERS = (3, 0), (2, 1), (1, 2), (0, 3), (1, 0), (0, 1)  # of derivatives that have bounds
LEVELS = 7  # windows of 1, 2, 4, ... cells on each side of a cell, for which bounds are kept
# errors of sums of 16 products of coefficients and basis functions, whose sum of magnitudes is at
# most 1, or of their first or second derivatives, with sums of at most 2/h and 6/h^2
EVALUATION_ERRORS = 100 * 2.0**-53 * np.array([1.0, 2.0, 6.0])


class Jets(NamedTuple):
    """Taylor polynomials of the ground about n points, in local coordinates."""

    height: Array  # [m]
    slope: Array  # shape (2, n)
    second: Array  # second derivatives xx, xy, yy, shape (3, n) [1/m]
    error: Array  # of heights, slopes and second derivatives, by rounding, shape (3, n)
    cell: Indices  # indices along x and y, shape (2, n)
    inexact: Array  # distance by which a point is displaced by rounding [m]


class GroundRange:
    """Bounds of a map over rectangles in local coordinates.

    Parameters
    ----------
    ground : Bicubic
        The map.
    """

    def __init__(self, ground: Bicubic) -> None:
        cells, holes = ground.cells, ground.grid.holes
        # `Cells.coefficients` are divided by 36, since `basis` is times six along each axis
        self._table = np.ascontiguousarray(36 * cells.coefficients)
        columns = np.array([cells.place, cells.spacing, cells.node])[..., None]
        self._place, self._spacing, self._node = self._axes = columns  # shape (2, 1) each
        self._counts = np.array(self._table.shape)[:, None] - 3
        h_x, h_y = cells.spacing
        levels = list[Array]()
        for p, q in ORDERS:
            quotients = np.abs(np.diff(np.diff(self._table, p, axis=0), q, axis=1))
            quotients += 64 * 2.0**-53 * np.abs(self._table).max()  # rounding of the differences
            quotients /= h_x**p * h_y**q / (1 + 1e-12)
            levels.append(sliding_window_view(quotients, (4 - p, 4 - q)).max(axis=(-1, -2)))
        missing = np.zeros(ground.grid.z.shape, dtype=bool) if holes is None else holes
        # by level: derivatives (6, cells in x, cells in y), and cells that touch holes
        self._largest = [np.stack(levels)]
        self._missing = [np.asarray(sliding_window_view(missing, (2, 2)).any(axis=(-1, -2)))]

    def jets(self, at: Array) -> Jets:
        """Return the Taylor polynomials about points, shape (2, n); outside they continue."""
        a, cell = self._cell(at)
        inexact = (2.0**-50 * self._spacing * (np.abs(a) + self._node + 2)).max(axis=0)
        scales = self._spacing[:, 0] ** np.arange(4)[:, None]  # by order and axis
        by_x, by_y = np.moveaxis(basis(a - cell), 2, 0) / scales.T[:, :, None, None]
        rows, columns = (cell[axis] + np.arange(4)[:, None] for axis in (0, 1))
        block = self._table[rows[:, None], columns[None]]  # (4, 4, n)
        partial = np.einsum("pan,abn->pbn", by_x[:3], block) / 36  # as above

        def derivative(p: int, q: int) -> Array:
            return np.asarray(np.einsum("bn,bn->n", by_y[q], partial[p]))

        step = self._spacing.min() ** np.arange(3)
        return Jets(
            derivative(0, 0),
            np.stack([derivative(1, 0), derivative(0, 1)]),
            np.stack([derivative(2, 0), derivative(1, 1), derivative(0, 2)]),
            np.abs(block).max(axis=(0, 1)) * (EVALUATION_ERRORS / step)[:, None],
            cell,
            inexact,
        )

    def is_known(self, at: Array, reach: Array) -> tuple[Mask, Mask]:
        """Return which points, and which squares about them, are on the map and in no hole.

        The points ``at`` have the shape (2, n); the squares have the half-sizes ``reach`` (n,) [m].
        """
        a, (i, j) = self._cell(at)
        away = reach / self._spacing + 1e-9
        points = ((a >= 0) & (a <= self._counts)).all(axis=0) & ~self._missing[0][i, j]
        squares = ((a >= away) & (a + away <= self._counts)).all(axis=0)
        level = self._level(reach)
        for k in np.unique(level).tolist():
            here = level == k
            squares[here] &= k <= LEVELS and ~_window(self._missing, k)[i[here], j[here]]
        return points, squares

    def heights(self, jets: Jets, reach: Array) -> Intervals:
        """Return bounds of the heights over rectangles about points; reach (2, n) [m]."""
        dx, dy = reach + jets.inexact
        t = self.third_bounds(jets, reach)
        (gx, gy), (xx, xy, yy) = np.abs(jets.slope), np.abs(jets.second)
        height, slope, second = jets.error
        away = (
            (gx + slope) * dx
            + (gy + slope) * dy
            + ((xx + second) * dx**2 + 2 * (xy + second) * dx * dy + (yy + second) * dy**2) / 2
            + (t[0] * dx**3 + 3 * t[1] * dx**2 * dy + 3 * t[2] * dx * dy**2 + t[3] * dy**3) / 6
        )
        return around(jets.height, (away + height) * (1 + 1e-14))

    def slopes(self, jets: Jets, away: Intervals) -> Intervals:
        """Return bounds of both slopes over rectangles relative to the points, shape (2, n)."""
        low, high = away.low - jets.inexact, away.high + jets.inexact
        box = Intervals(low, high)
        dx, dy = box.magnitude
        t = self.third_bounds(jets, box.magnitude)
        _, slope, second = jets.error
        rest = (t[:2] * dx**2 + 2 * t[1:3] * dx * dy + t[2:] * dy**2) / 2
        rest = (rest + slope + second * (dx + dy)) * (1 + 1e-14)
        linear = box[0] * jets.second[:2] + box[1] * jets.second[1:] + jets.slope
        return linear + Intervals(-rest, rest)

    def compiled(self, level: int) -> tuple[Any, ...]:
        """Return the map and its windows of at least a level as `terrain/kernel.c` takes them."""
        _window(self._largest, level)
        _window(self._missing, level)
        windows = [
            (ctypes.c_void_p * (LEVELS + 1))(*(each.ctypes.data for each in levels))
            for levels in (self._largest, self._missing)
        ]
        return (
            *(pointer(each) for each in (self._table, self._counts, self._axes)),
            ctypes.c_longlong(LEVELS + 1),
            *windows,
        )

    def _cell(self, at: Array) -> tuple[Array, Indices]:
        """Return points in units of cells from the first node, and indices of their cells."""
        a = (at - self._place) / self._spacing + self._node
        cell = np.clip(np.nan_to_num(np.floor(a)), 0, self._counts - 1)
        return a, cell.astype(np.intp)

    def third_bounds(self, jets: Jets, reach: Array) -> Array:
        """Return the largest third derivatives within a reach (2, n) of points, shape (4, n)."""
        return self._within(jets, reach)[:4]

    def steepness(self, jets: Jets, reach: Array) -> Array:
        """Return the largest slope within a reach (2, n) of points, shape (n,)."""
        near = self.slopes(jets, Intervals(-reach, reach)).magnitude
        return np.asarray(np.hypot(*np.fmin(near, self._within(jets, reach)[4:])) * (1 + 1e-14))

    def _within(self, jets: Jets, reach: Array) -> Array:
        """Return the largest derivatives `ORDERS` within a reach (2, n), shape (6, n)."""
        i, j = jets.cell
        bounds = np.full((len(ORDERS), i.size), np.inf)
        level = self._level(reach.max(axis=0) + jets.inexact)
        for k in np.unique(level[level <= LEVELS]).tolist():
            here = level == k
            bounds[:, here] = _window(self._largest, k)[:, i[here], j[here]]
        return bounds

    def _level(self, reach: Array) -> Indices:
        """Return the number of the smallest window that covers a reach [m]."""
        cells = np.maximum(np.ceil(np.nan_to_num(reach, nan=np.inf) / self._spacing.min()), 1)
        return np.asarray(np.minimum(np.ceil(np.log2(cells)) + 1, LEVELS + 1), dtype=np.intp)


def _window(levels: list[Any], level: int) -> Any:
    """Return the maxima over windows of 2^(level - 1) cells to each side of each cell."""
    from scipy.ndimage import maximum_filter  # imported here: the import takes time

    while len(levels) <= level:
        size = 2 ** len(levels) + 1
        sizes = (1,) * (levels[0].ndim - 2) + (size, size)
        levels.append(maximum_filter(levels[0], size=sizes, mode="nearest"))
    return levels[level]


@lru_cache(maxsize=8)
def range_of(ground: Bicubic) -> GroundRange:
    """Return the bounds of a map; cached, since they need the differences of all coefficients."""
    return GroundRange(ground)
