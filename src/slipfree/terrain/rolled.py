"""Rolled ground: hollows too narrow for a wheel are filled."""

from __future__ import annotations

import math

import numpy as np
import scipy

from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.core.schema import Length
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.grid_ops import Changed, averaged

NODES = 8  # nodes per wheel radius
BALL = 1.5  # radius of the closing ball, in wheel radii
BLUR = 0.25  # standard deviation of the Gaussian, in wheel radii


@checked
def rolled(grid: Grid, radius: Length) -> Changed:
    """Return a ground whose hollows are filled for a wheel of the given radius.

    The wheel then has a single contact point almost everywhere. The nodes of the result are at most
    an eighth of the radius apart.

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
        If the radius is not positive and finite, or exceeds a third of the ground's extent.

    Notes
    -----
    A wheel cannot reach the bottom of a hollow with a smaller radius of curvature: it would touch
    at two points, and a model with one contact point per wheel fails there. Morphological closing
    by a ball fills such hollows up to the ball and does not change wider ones. Where two positions
    of the ball meet, the closing leaves seams, which interpolation sharpens; the Gaussian rounds
    them. A Gaussian alone would have to be twice as wide; it would lower peaks and fill wide
    hollows that the wheel can follow.

    Outside the grid the ground continues by point reflection about the border node, which preserves
    slopes.
    """
    extent = min(float(np.ptp(grid.x)), float(np.ptp(grid.y)))
    if BALL * radius > extent / 2:
        raise ModelError(
            f"rolled: radius must be at most {extent / 2 / BALL:.4g} m, a third of the ground's "
            f"extent of {extent:.4g} m, found {radius:g} m; use a larger ground or a smaller radius"
        )
    cells = (math.ceil(np.ptp(axis) / (radius / NODES) - 1e-9) for axis in (grid.x, grid.y))
    counts = zip((grid.x, grid.y), cells, strict=True)
    x, y = (np.linspace(axis[0], axis[-1], max(n, 3) + 1) for axis, n in counts)
    old = Bicubic(grid).elevation(x[:, None], y[None, :])
    steps = (float(x[1] - x[0]), float(y[1] - y[0]))
    new = averaged(_close_by_ball(old, steps, BALL * radius), steps, BLUR * radius)
    filled, holes = (
        None if nodes is None else grid.touches(nodes, x[:, None], y[None, :])
        for nodes in (grid.filled, grid.holes)
    )
    return Changed(Grid(x, y, new, filled, holes), Grid(x, y, new - old, holes=holes))


def _close_by_ball(z: Array, steps: tuple[float, float], radius: float) -> Array:
    """Return heights after morphological closing by a ball that rolls above them."""
    reach = [int(radius / step) for step in steps]
    i, j = np.ogrid[-reach[0] : reach[0] + 1, -reach[1] : reach[1] + 1]
    below = radius**2 - (i * steps[0]) ** 2 - (j * steps[1]) ** 2
    ball = np.sqrt(np.maximum(below, 0))
    # a dilation and an erosion: the border has influence up to two radii inside
    pad = [(2 * r, 2 * r) for r in reach]
    wide = np.pad(z, pad, mode="reflect", reflect_type="odd")
    closed = scipy.ndimage.grey_closing(wide, footprint=below >= 0, structure=ball)
    return np.ascontiguousarray(closed[tuple(slice(low, -high) for low, high in pad)])
