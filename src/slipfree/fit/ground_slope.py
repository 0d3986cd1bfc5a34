"""Slope of a height map under a vehicle."""

from __future__ import annotations

import numpy as np

from slipfree.core.records import Array, ComplexArray
from slipfree.terrain.base import Grid
from slipfree.terrain.grid_ops import averaged

STEEPEST = 0.55  # largest sine of a slope: steeper cells of a map are walls, trees or errors


class Slopes:
    """Slope of a height map, averaged over the size of a vehicle; bilinear between the nodes.

    ``smoothing`` is the standard deviation of a Gaussian [m]; ``grid`` has the averaged heights.
    """

    def __init__(self, grid: Grid, smoothing: float) -> None:
        steps = float(grid.x[1] - grid.x[0]), float(grid.y[1] - grid.y[0])
        heights = averaged(grid.z, steps, smoothing) if smoothing else grid.z
        self.grid = Grid(grid.x, grid.y, heights)
        x, y = (np.gradient(heights, step, axis=k) for k, step in enumerate(steps))
        node = np.asarray(x + 1j * y)
        first, right, ahead = node[:-1, :-1], node[1:, :-1], node[:-1, 1:]
        bend = node[1:, 1:] - right - ahead + first
        # of each cell: bilinear in the shares of its sides
        self._cells = np.stack([first, right - first, ahead - first, bend], -1).reshape(-1, 4)
        self._last = np.array(grid.z.shape) - 1
        self._first = np.array([grid.x[0], grid.y[0]])
        self._steps = np.array(steps)

    def tilt(self, place: ComplexArray, heading: Array) -> tuple[Array, Array]:
        """Return the sines of the nose-up and left-up angles of vehicles.

        Places are complex numbers [m], headings count from x [rad]; beyond the map the slope is
        that of its border.
        """
        (x, y), (dx, dy), (nx, ny) = self._first, self._steps, self._last
        f = np.minimum(np.maximum((place.real - x) / dx, 0), nx - 1e-9)
        g = np.minimum(np.maximum((place.imag - y) / dy, 0), ny - 1e-9)
        i, j = f.astype(int), g.astype(int)
        f, g = f - i, g - j
        cell = self._cells[i * int(ny) + j]
        gradient = cell[..., 0] + f * cell[..., 1] + g * (cell[..., 2] + f * cell[..., 3])
        turned = gradient * unit_vectors(-heading)
        ahead, left = turned.real, turned.imag
        square = ahead**2
        along = np.sqrt(1 + square)
        left = left / (along * np.sqrt(1 + square + left**2))
        return _bounded(ahead / along), _bounded(left)


def _bounded(sine: Array) -> Array:
    return np.minimum(np.maximum(sine, -STEEPEST), STEEPEST)


def unit_vectors(angle: Array) -> ComplexArray:
    """Return complex numbers of size one; faster than the complex exponential."""
    direction = np.empty(angle.shape, dtype=complex)
    direction.real, direction.imag = np.cos(angle), np.sin(angle)
    return direction
