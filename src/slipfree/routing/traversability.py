"""Traversability of a map: costs for a vehicle, and blocked positions.

The costs depend on the ground under the vehicle's footprint in any heading; single wheels and slip
are not considered.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt
import scipy

from slipfree.contact.nearest_points import lowest_point
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Mask
from slipfree.geometry.frame import Pose
from slipfree.geometry.regions import Region
from slipfree.terrain.base import Formula, Grid
from slipfree.terrain.bicubic import Bicubic, friction_map
from slipfree.terrain.grid_ops import hole_distance
from slipfree.vehicle.tree import Vehicle

Point = tuple[float, float] | Array
# Costs per metre, added to the cost 1 of level ground. The steepest slope that can be climbed, full
# use of the friction, and ground as high as the body leave no margin: each adds 4. Roughness as
# large as the wheel radius is an obstacle and adds 10; so does a footprint that is too concave
# everywhere, which the wheels can straddle only by chance.
SLOPE = 4.0
FRICTION = 4.0
ROUGHNESS = 10.0
HOLLOW = 10.0
CLEARANCE = 4.0
ROUNDING = 1e-9  # smallest clearance [m]
MAX_SLOPE = math.radians(30)  # on ground without friction coefficient; loose soil slides at 30-35


def coarse_axes(grid: Grid, spacing: float) -> tuple[Array, Array]:
    """Return the axes of the cost grid; the axes of the ground if they have the given spacing."""
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
    """Return slope, roughness, concavity and concave fraction under the footprint at every node."""
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
    """Return the larger principal curvature of a surface, positive if concave upward [1/m]."""
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


class Limits(NamedTuple):
    """Limits of the vehicle from which the layers were computed.

    Attributes
    ----------
    steepest : float
        Steepest slope that can be climbed. [rad]
    radius : float
        Radius of the largest wheel; hollows that are not wider block the vehicle. [m]
    reach : float
        Radius of the circle about the platform's centre that contains all wheels. [m]
    half : float
        Half the side of the square that represents the footprint in any heading. [m]
    domain : tuple of 4 floats
        ``x_min, x_max, y_min, y_max`` of the map. [m]
    keep_out : tuple of Region
        Keep-out regions.
    clearance : float
        Clearance of the lowest body on level ground, with all joints at zero; infinite without
        shapes. [m]
    """

    steepest: float
    radius: float
    reach: float
    half: float
    domain: tuple[float, float, float, float]
    keep_out: tuple[Region, ...]
    clearance: float = math.inf


class Traversability(NamedTuple):
    """Cost of a map for a vehicle, and the layers from which it was computed."""

    x: Array  # shape (n_x,): axes in map coordinates [m]
    y: Array
    cost: Array  # shape (n_x, n_y): per metre; infinite where the centre must not be [1]
    slope: Array  # shape (n_x, n_y): of the plane fitted under the footprint [rad]
    roughness: Array  # shape (n_x, n_y): root mean square deviation from that plane [m]
    hollow: Array  # shape (n_x, n_y): largest concavity; negative on a dome [1/m]
    # shape (n_x, n_y): tangent of the slope, divided by the mean friction coefficient of the ground
    # under the footprint and by the largest ``grip`` of a wheel [1]
    friction: Array | None
    to_hole: Array  # shape (n_x, n_y): distance to a missing height, negative inside [m]
    limits: Limits
    # shape (n_x, n_y): how far the ground under the lowest body rises above the mean height under
    # the footprint; None for a vehicle without shapes [m]
    rise: Array | None = None

    @property
    def spacing(self) -> tuple[float, float]:
        """Distances between neighbouring nodes along x and along y [m]."""
        return axis_step(self.x), axis_step(self.y)


def traversability(
    terrain: Bicubic,
    vehicle: Vehicle,
    *,
    keep_out: Iterable[Region] = (),
    steepest: float | None = None,
    spacing: float | None = None,
) -> Traversability:
    """Return the traversability of a map for a vehicle.

    Parameters
    ----------
    terrain : Bicubic
        The ground, with or without a friction coefficient.
    vehicle : Vehicle
        The vehicle; its wheels in the zero configuration determine the footprint.
    keep_out : iterable of Region
        Regions that no wheel may touch.
    steepest : float, optional
        Steepest slope that can be climbed; by default the slope that the largest friction can
        hold, or 30 degrees on a ground without a friction coefficient. [rad]
    spacing : float, optional
        Distance between nodes; by default a sixth of the smaller of the vehicle's width and length,
        but not less than the node spacing of the ground. [m]

    Returns
    -------
    Traversability
        The cost and its layers. A node is blocked if the slope is steeper than ``steepest`` or
        than friction can hold, if the roughness reaches the radius of the largest wheel, if the
        ground is concave with a radius of curvature of at most that radius, if it rises in every
        heading up to the lowest body of the vehicle, or if in any heading a wheel could reach over
        the edge of the map, into a hole or into a keep-out region.

    Raises
    ------
    ModelError
        If ``steepest`` is not above 0 and below pi/2, or ``spacing`` is not positive or more than
        half the smaller side of the map.

    Notes
    -----
    The cost per metre is ``1 + 4 (slope / steepest)**2 + 4 friction**2 + 10 (roughness /
    radius)**2`` plus ten times the fraction of the ground under the footprint that is too concave,
    and, for a vehicle with shapes, ``4 (rise / clearance)**2``.
    Concave ground blocks only the vehicle's centre: whether a wheel enters it depends on the
    heading, which a plan determines and a route does not. The friction coefficient is that of
    the wheel with the largest ``grip``.
    """
    right, forward, reach = extents(vehicle)
    half, radius = math.sqrt(right * forward), max(wheel.radius for wheel in vehicle.wheels)
    grip = max(wheel.grip for wheel in vehicle.wheels)
    if spacing is None:
        spacing = max(*terrain.grid.spacing, min(right, forward) / 3)
    x, y = coarse_axes(terrain.grid, spacing)
    slope, roughness, hollow, share = ground_properties(terrain.grid, x, y, half, 1 / radius)
    held = _friction(terrain, x, y, half)
    held = None if held is None else held * grip
    if steepest is None:
        steepest = MAX_SLOPE if held is None else math.atan(held.max())
    if not 0 < steepest < math.pi / 2:
        raise ModelError(
            "traversability: expected 'steepest' above 0 and below pi/2 rad, found "
            f"{steepest}; give it in radians, or omit it for the default"
        )
    used = None if held is None else np.tan(slope) / held
    clear, inner = level_clearance(vehicle)
    limits = Limits(steepest, radius, reach, half, terrain.domain, tuple(keep_out), clear)
    cost = 1 + SLOPE * (slope / steepest) ** 2 + ROUGHNESS * (roughness / radius) ** 2
    cost += HOLLOW * share
    if used is not None:
        cost += FRICTION * used**2
    rise = None
    if clear < math.inf:
        rise = _rise(terrain.grid, x, y, half, inner)
        cost += CLEARANCE * (np.maximum(rise, 0) / max(clear, ROUNDING)) ** 2
    to_hole = np.full(slope.shape, math.inf)
    if terrain.grid.holes is not None:
        to_hole = interpolate_layer(hole_distance(terrain.grid), terrain.grid, x, y)
    layers = Traversability(x, y, cost, slope, roughness, hollow, used, to_hole, limits, rise)
    cost[np.logical_or.reduce([*blocked_by(layers).values()])] = math.inf
    return layers


def blocking_reasons(layers: Traversability, x: float, y: float) -> str:
    """Return the reasons why a vehicle cannot be at a position, as text; empty if it can."""
    off = to_edge(layers.limits, np.asarray(x), np.asarray(y)) < 0
    i, j = node_at(layers, x, y)
    if not off and math.isfinite(layers.cost[i, j]):
        return ""
    at = (x, y) if off else (float(layers.x[i]), float(layers.y[j]))
    return "; ".join(reasons_by_kind(layers, *at).values())


def level_clearance(vehicle: Vehicle) -> tuple[float, float]:
    """Return the clearance of the lowest body on level ground, and half its least width [m].

    All joints are at zero. The clearance is infinite for a vehicle without shapes.
    """
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    values = {c.name: ca.SX(0) for c in vehicle.coordinates}
    poses, parts = vehicle.carriers(rest, values), vehicle.parts(rest, values)
    bottoms = [
        float(pose.origin[2]) - wheel.radius
        for wheel, pose in zip(vehicle.wheels, poses, strict=True)
    ]
    lows = [
        (float(low) - min(bottoms), width)
        for name, shape in vehicle.shapes
        for low, width in [lowest_point(shape, parts[name])]
    ]
    return min(lows, default=(math.inf, 0.0))


def _rise(grid: Grid, x: Array, y: Array, half: float, inner: float) -> Array:
    """Return how far the ground rises above its mean under the footprint, at every node [m].

    It is the largest rise within the distance ``inner`` of the node, where the body is above the
    ground in every heading.
    """
    relief = grid.z - footprint_mean(grid.z, grid.spacing, half)
    # a node of the coarse grid stands for its cell
    sides = [
        max(2 * _nodes_within(inner, h) + 1, 2 * math.ceil(axis_step(new) / h / 2) + 1)
        for new, h in zip((x, y), grid.spacing, strict=True)
    ]
    highest = scipy.ndimage.maximum_filter(relief, sides)
    nearest = [nearest_nodes(old, new) for old, new in ((grid.x, x), (grid.y, y))]
    return np.asarray(highest[np.ix_(*nearest)])


def extents(vehicle: Vehicle) -> tuple[float, float, float]:
    """Return half the width and half the length of a vehicle, and the radius of its circle [m].

    The circle about the platform's centre encloses all wheels, each as a sphere, since a wheel may
    be steered and tilted.
    """
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    poses = vehicle.carriers(rest, {c.name: ca.SX(0) for c in vehicle.coordinates})
    at = np.array([np.array(ca.evalf(pose.origin)).ravel()[:2] for pose in poses])
    radius = np.array([wheel.radius for wheel in vehicle.wheels])
    half_width = np.array([wheel.half_width for wheel in vehicle.wheels])
    size = np.stack([half_width, radius], axis=1)
    right, forward = 0.5 * ((at + size).max(axis=0) - (at - size).min(axis=0))
    return float(right), float(forward), float((np.hypot(*at.T) + radius).max())


# Layers


def _friction(terrain: Bicubic, x: Array, y: Array, half: float) -> Array | None:
    """Return the mean friction coefficient under the footprint [1]; None if the ground has none."""
    mu = terrain.mu
    if mu is None:
        return None
    if isinstance(mu, float | int):
        return np.full((x.size, y.size), float(mu))
    if isinstance(mu, Grid):
        surface = friction_map(mu, terrain.origin[:2])
        at_nodes = surface.elevation(x[:, None], y[None, :]) if surface else np.empty(0)
    else:
        at_nodes = _formula(mu, x, y)
    return footprint_mean(at_nodes, (axis_step(x), axis_step(y)), half)


def _formula(function: Formula, x: Array, y: Array) -> Array:
    """Return the values of a formula on a grid, computed for one x at a time."""
    at, line = ca.SX.sym("x"), ca.SX.sym("y", y.size)
    values = [ca.SX(function(at, line[j])) for j in range(y.size)]
    f = ca.Function("friction", [at, line], [ca.vertcat(*values)])
    return np.array([np.array(f(float(each), y)).ravel() for each in x])


def blocked_by(layers: Traversability) -> dict[str, Mask]:
    """Return the masks of blocked nodes, by reason; a node may have several.

    A wheel could reach over the ``"edge"`` of the map, into a ``"hole"`` or into a ``"keep_out"``
    region. The ground has a ``"slope"`` that is too steep or that ``"friction"`` cannot hold, a
    ``"roughness"`` of at least the wheel radius, a ``"hollow"`` whose radius is at most the wheel
    radius, or a rise up to the body of the vehicle, whose ``"clearance"`` it exceeds.
    """
    x, y, limits = layers.x[:, None], layers.y[None, :], layers.limits
    keep_out = np.zeros(layers.cost.shape, dtype=bool)
    for region in limits.keep_out:
        part = window(layers, region.bounds, limits.reach)
        inside = region.distance(*np.broadcast_arrays(x[part[0]], y[:, part[1]])) < limits.reach
        keep_out[part] |= inside
    return {
        "edge": to_edge(limits, x, y) < limits.reach,
        "hole": layers.to_hole < limits.reach,
        "slope": layers.slope > limits.steepest,
        "friction": np.zeros_like(keep_out) if layers.friction is None else layers.friction >= 1,
        "roughness": layers.roughness >= limits.radius,
        "hollow": layers.hollow * limits.radius >= 1,
        "clearance": np.zeros_like(keep_out)
        if layers.rise is None
        else layers.rise >= limits.clearance,
        "keep_out": keep_out,
    }


def to_edge(limits: Limits, x: Array, y: Array) -> Array:
    """Return the distance from points of the map to its edge, negative outside [m]."""
    x_min, x_max, y_min, y_max = limits.domain
    inside = np.minimum(np.minimum(x - x_min, x_max - x), np.minimum(y - y_min, y_max - y))
    outside = np.hypot(
        np.maximum(np.maximum(x_min - x, x - x_max), 0),
        np.maximum(np.maximum(y_min - y, y - y_max), 0),
    )
    return np.asarray(np.where(inside < 0, -outside, inside))


def window(
    layers: Traversability, bounds: tuple[float, float, float, float], margin: float
) -> tuple[slice, slice]:
    """Return the slices of the grid inside a rectangle extended by a margin [m]."""
    i = np.searchsorted(layers.x, (bounds[0] - margin, bounds[1] + margin)).tolist()
    j = np.searchsorted(layers.y, (bounds[2] - margin, bounds[3] + margin)).tolist()
    return slice(*i), slice(*j)


def reasons_by_kind(layers: Traversability, x: float, y: float) -> dict[str, str]:
    """Return the reasons why a vehicle cannot be at a position; keys as in `blocked_by`."""
    limits, words = layers.limits, {}
    inside = float(to_edge(limits, np.asarray(x), np.asarray(y)))
    if inside < 0:
        return {"edge": f"{-inside:.3g} m outside the map"}
    if inside < limits.reach:
        words["edge"] = (
            f"{inside:.3g} m from the edge of the map, and wheels reach {limits.reach:.3g} m"
        )
    words |= _ground_reasons(layers, *node_at(layers, x, y))
    near = [
        f"inside the keep-out {region.words}"
        if distance < 0
        else f"{distance:.3g} m from the keep-out {region.words}, and wheels reach "
        f"{limits.reach:.3g} m"
        for region in limits.keep_out
        if (distance := float(region.distance(np.asarray(x), np.asarray(y)))) < limits.reach
    ]
    return words | ({"keep_out": "; ".join(near)} if near else {})


def _ground_reasons(layers: Traversability, i: int, j: int) -> dict[str, str]:
    """Return the reasons why the ground at a node is blocked."""
    limits, words, slope = layers.limits, {}, float(layers.slope[i, j])
    used = 0.0 if layers.friction is None else float(layers.friction[i, j])
    if layers.to_hole[i, j] < limits.reach:
        words["hole"] = (
            f"{max(layers.to_hole[i, j], 0):.3g} m from a hole in the map, where heights are "
            f"missing, and wheels reach {limits.reach:.3g} m"
        )
    if used >= 1:
        words["friction"] = (
            f"slope of {math.degrees(slope):.3g} degrees needs a friction coefficient of "
            f"{math.tan(slope):.3g}, the ground offers {math.tan(slope) / used:.3g}"
        )
    elif slope > limits.steepest:
        words["slope"] = (
            f"slope of {math.degrees(slope):.3g} degrees, steeper than the "
            f"{math.degrees(limits.steepest):.3g} degrees that the vehicle can climb"
        )
    if layers.roughness[i, j] >= limits.radius:
        words["roughness"] = (
            f"roughness of {layers.roughness[i, j]:.3g} m, not less than the wheel radius of "
            f"{limits.radius:.3g} m"
        )
    if layers.hollow[i, j] * limits.radius >= 1:
        words["hollow"] = (
            f"hollow of {1 / layers.hollow[i, j]:.3g} m radius, too narrow for the wheel radius of "
            f"{limits.radius:.3g} m"
        )
    if layers.rise is not None and layers.rise[i, j] >= limits.clearance:
        words["clearance"] = (
            f"rise of {layers.rise[i, j]:.3g} m above the mean height under the vehicle, whose "
            f"body clears {limits.clearance:.3g} m on level ground"
        )
    return words


# Nodes


def nodes_at(
    layers: Traversability, points: Array
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return the indices of the nodes nearest to points in map coordinates, shape (n, 2)."""
    return nearest_nodes(layers.x, points[:, 0]), nearest_nodes(layers.y, points[:, 1])


def node_at(layers: Traversability, x: float, y: float) -> tuple[int, int]:
    """Return the indices of the node nearest to a position."""
    i, j = nodes_at(layers, np.array([[x, y]]))
    return int(i[0]), int(j[0])


def point_text(point: Point) -> str:
    """Return the coordinates of a point as text, rounded to 0.01 m."""
    x, y = (round(float(each), 2) for each in point)
    return f"({x:.10g}, {y:.10g})"
