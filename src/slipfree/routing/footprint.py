"""Ground under a vehicle's footprint: slope, roughness and concavity on a map."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import scipy

from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.terrain.base import Grid


def coarse_axes(grid: Grid, spacing: float) -> tuple[Array, Array]:
    """Return the axes of the cost grid; the axes of the ground if they have the given spacing.

    Raises
    ------
    ModelError
        If the spacing is not positive or more than half the smaller side of the map.
    """
    extent = min(float(np.ptp(grid.x)), float(np.ptp(grid.y)))
    if not spacing > 0:
        raise ModelError(
            f"traversability: expected a positive 'spacing', found {spacing:.4g} m; give a "
            "positive length, or omit it for the default"
        )
    if spacing > extent / 2:
        raise ModelError(
            "traversability: expected a 'spacing' of at most half the smaller side of the map, "
            f"{extent / 2:.4g} m, found {spacing:.4g} m; use a smaller spacing or a larger map"
        )
    axes = []
    for axis, h in zip((grid.x, grid.y), grid.spacing, strict=True):
        count = round(float(np.ptp(axis)) / spacing)
        same = abs(spacing - h) < 1e-9 * h
        axes.append(np.array(axis) if same else np.linspace(axis[0], axis[-1], count + 1))
    return axes[0], axes[1]


def ground_properties(
    grid: Grid, x: Array, y: Array, half: float, sharpest: float
) -> tuple[Array, Array, Array, Array]:
    """Return slope, roughness and concavity of the ground under the footprint at every node.

    Parameters
    ----------
    grid : Grid
        The ground.
    x, y : ndarray, shape (n_x,) and (n_y,)
        Axes of the map. [m]
    half : float
        Half the side of the square that represents the footprint. [m]
    sharpest : float
        Smallest curvature at which the ground counts as too concave. [1/m]

    Returns
    -------
    four ndarrays, shape (n_x, n_y)
        Slope [rad], roughness [m] and concavity [1/m] as in `Traversability`, and the fraction of
        the footprint that is too concave [1].
    """
    z = grid.z - grid.z.mean()
    p, q, r, s, t = _derivatives(z, grid.spacing)
    hollow = _largest_curvature(p, q, r, s, t)
    if min(_nodes_within(half, h) for h in grid.spacing) > 0:
        p, q, variance = _plane(z, grid.spacing, half)
    else:
        # too few nodes to fit a plane: use the deviation of a curved square of this size
        variance = half**4 * ((r**2 + t**2) / 45 + s**2 / 9)
    share = footprint_mean((hollow >= sharpest).astype(float), grid.spacing, half)
    layers = [np.arctan(np.hypot(p, q)), np.sqrt(variance), share]
    slope, roughness, share = (interpolate_layer(layer, grid, x, y) for layer in layers)
    size = [
        math.ceil(axis_step(new) / h - 1e-9) for new, h in zip((x, y), grid.spacing, strict=True)
    ]
    largest = (
        hollow
        if max(size) == 1
        else scipy.ndimage.maximum_filter(hollow, [2 * n - 1 for n in size])
    )
    nearest = [nearest_nodes(old, new) for old, new in ((grid.x, x), (grid.y, y))]
    return slope, roughness, largest[np.ix_(*nearest)], share


def _derivatives(z: Array, h: tuple[float, float]) -> tuple[Array, Array, Array, Array, Array]:
    """Return first and second differences: z_x, z_y [1], z_xx, z_xy, z_yy [1/m]."""
    p: Array = np.gradient(z, h[0], axis=0, edge_order=2)
    q: Array = np.gradient(z, h[1], axis=1, edge_order=2)
    second = [1.0, -2.0, 1.0]
    # differences of direct neighbours, so that a bump between two nodes counts in full
    r = scipy.ndimage.correlate1d(z, second, axis=0, mode="nearest") / h[0] ** 2
    t = scipy.ndimage.correlate1d(z, second, axis=1, mode="nearest") / h[1] ** 2
    for array, axis in ((r, 0), (t, 1)):  # the border repeats its neighbours
        border = np.moveaxis(array, axis, 0)
        border[0], border[-1] = border[1], border[-2]
    s: Array = np.gradient(p, h[1], axis=1)
    return p, q, r, s, t


def _largest_curvature(p: Array, q: Array, r: Array, s: Array, t: Array) -> Array:
    """Return the larger principal curvature of a surface, positive if concave upward [1/m].

    The arguments are the first derivatives z_x and z_y [1], and the second derivatives z_xx, z_xy
    and z_yy [1/m].
    """
    w = np.sqrt(1 + p**2 + q**2)
    mean = ((1 + q**2) * r - 2 * p * q * s + (1 + p**2) * t) / (2 * w**3)
    total = (r * t - s**2) / w**4
    largest: Array = mean + np.sqrt(np.maximum(mean**2 - total, 0))
    return largest


def _plane(z: Array, h: tuple[float, float], half: float) -> tuple[Array, Array, Array]:
    """Return slopes [1] and residual variance [m^2] of the plane fitted to each square."""
    left = footprint_mean(z**2, h, half) - footprint_mean(z, h, half) ** 2
    slopes = []
    for axis in (0, 1):
        m = _nodes_within(half, h[axis])
        offset = h[axis] * np.arange(-m, m + 1)
        weights = offset / (offset @ offset)
        others = footprint_mean(z, h, half, axes=(1 - axis,))
        slope = scipy.ndimage.correlate1d(others, weights, axis=axis, mode="nearest")
        left -= slope**2 * np.mean(offset**2)
        slopes.append(slope)
    return slopes[0], slopes[1], np.maximum(left, 0)


def footprint_mean(
    z: Array, h: tuple[float, float], half: float, axes: tuple[int, ...] = (0, 1)
) -> Array:
    """Return the mean of ``z`` over a square of the footprint's size around every node."""
    for axis in axes:
        size = 2 * _nodes_within(half, h[axis]) + 1
        z = scipy.ndimage.uniform_filter1d(z, size, axis=axis, mode="nearest")
    return z


def _nodes_within(half: float, h: float) -> int:
    """Return the number of nodes between the centre and an edge of a square, rounded."""
    return round(half / h - 0.5)


def interpolate_layer(layer: Array, grid: Grid, x: Array, y: Array) -> Array:
    """Return a layer at new nodes by linear interpolation."""
    for axis, (old, new) in enumerate(((grid.x, x), (grid.y, y))):
        if old.size == new.size:
            continue
        cell = (new - old[0]) / axis_step(old)
        first = np.clip(np.floor(cell).astype(np.intp), 0, old.size - 2)
        weight = np.expand_dims(cell - first, 1 - axis)
        low, high = np.take(layer, first, axis), np.take(layer, first + 1, axis)
        layer = low + weight * (high - low)
    return layer


def axis_step(axis: Array) -> float:
    """Return the step of a uniform axis [m]."""
    return float(np.ptp(axis) / (axis.size - 1))


def nearest_nodes(axis: Array, at: Array) -> npt.NDArray[np.intp]:
    """Return the indices of the nodes of a uniform axis nearest to positions."""
    cells = np.rint((at - axis[0]) / axis_step(axis))
    return np.asarray(np.clip(cells, 0, axis.size - 1), dtype=np.intp)
