"""The ground as a wheel feels it: hollows too narrow for the wheel bridged."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from slipfree.errors import ModelError
from slipfree.records import Array
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.grid_ops import averaged

NODES = 8  # nodes to a wheel radius
BALL = 1.5  # radius of the closing ball over that of the wheel
BLUR = 0.25  # standard deviation of the Gaussian over the radius of the wheel


@dataclass(frozen=True, eq=False)
class Rolled:
    """A ground made fit for a wheel, and what that changed.

    Attributes
    ----------
    grid : Grid
        The new ground, on nodes at most an eighth of the wheel's radius apart. [m]
    change : Grid
        New height minus the old at the same nodes. [m]
    """

    grid: Grid
    change: Grid

    @property
    def largest(self) -> float:
        """Largest change of height, without its sign [m]."""
        return float(np.abs(self.change.z).max())

    @property
    def rms(self) -> float:
        """Root mean square of the change of height [m]."""
        return math.sqrt(np.mean(self.change.z**2))


def rolled(grid: Grid, radius: float) -> Rolled:
    """Return a ground on which a wheel of the given radius has one contact point nearly anywhere.

    The bicubic surface of the grid is sampled on nodes at most ``radius / 8`` apart, closed by a
    ball of radius ``1.5 radius``, and smoothed by a Gaussian of standard deviation
    ``0.25 radius``.

    Parameters
    ----------
    grid : Grid
        The ground as measured.
    radius : float
        Rolling radius of the largest wheel. [m]

    Raises
    ------
    ModelError
        If the radius is not positive.

    Notes
    -----
    A wheel cannot reach the bottom of a hollow that is curved more tightly than itself: it would
    touch twice, and a model with one contact point a wheel fails there. Closing fills such
    hollows to the surface a rolling ball leaves, and leaves all others as they are. But where
    two positions of the ball meet it leaves a seam, which interpolation sharpens again, so that
    closing alone is not enough; the Gaussian rounds the seams. A Gaussian alone needs to be twice
    as wide, and lowers peaks and fills wide hollows that the wheel would have followed.

    Outside the grid the ground continues as its mirror image about the border node, upside down,
    so that a slope goes on as a slope.
    """
    if not (math.isfinite(radius) and radius > 0):
        raise ModelError(f"rolled: radius must be a positive number of metres, found {radius}")
    extent = min(float(np.ptp(grid.x)), float(np.ptp(grid.y)))
    if BALL * radius > extent / 2:
        raise ModelError(
            f"rolled: radius must be small against the ground, at most {extent / 2 / BALL:.4g} m "
            f"on one of {extent:.4g} m, found {radius:g} m"
        )
    x, y = (_refined(axis, radius / NODES) for axis in (grid.x, grid.y))
    old = Bicubic(grid).elevation(x[:, None], y[None, :])
    steps = (float(x[1] - x[0]), float(y[1] - y[0]))
    new = averaged(_closed(old, steps, BALL * radius), steps, BLUR * radius)
    filled = None if grid.filled is None else grid.touches_filled(x[:, None], y[None, :])
    return Rolled(Grid(x, y, new, filled), Grid(x, y, new - old))


def _refined(axis: Array, spacing: float) -> Array:
    """Return an even axis of the same ends whose nodes are at most ``spacing`` apart."""
    cells = math.ceil(np.ptp(axis) / spacing - 1e-9)
    return np.linspace(axis[0], axis[-1], max(cells, 3) + 1)


def _closed(z: Array, steps: tuple[float, float], radius: float) -> Array:
    """Return heights closed by a ball: raised to what the ball, rolling above, leaves free."""
    reach = [int(radius / step) for step in steps]
    i, j = np.ogrid[-reach[0] : reach[0] + 1, -reach[1] : reach[1] + 1]
    below = radius**2 - (i * steps[0]) ** 2 - (j * steps[1]) ** 2
    ball = np.sqrt(np.maximum(below, 0))
    # A dilation and an erosion: the border is felt two radii inside.
    pad = [(2 * r, 2 * r) for r in reach]
    wide = np.pad(z, pad, mode="reflect", reflect_type="odd")
    closed = ndimage.grey_closing(wide, footprint=below >= 0, structure=ball)
    return _cropped(closed, pad)


def _cropped(wide: Array, pad: list[tuple[int, int]]) -> Array:
    """Return an array without its margins."""
    parts = tuple(
        slice(low, size - high) for (low, high), size in zip(pad, wide.shape, strict=True)
    )
    return np.ascontiguousarray(wide[parts])
