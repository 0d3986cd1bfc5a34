"""Routes over a large map: where a vehicle can go, and the cheapest way there.

A route is a start for a plan, not a plan: it looks at the ground under the vehicle's footprint in
any heading, and knows neither wheels nor slip.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.interpolate import CubicSpline
from scipy.linalg import solveh_banded
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from slipfree.errors import ModelError
from slipfree.geometry.frame import Pose
from slipfree.geometry.path import Path
from slipfree.named import Array, Mask
from slipfree.plan.region import Region
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic, friction_map
from slipfree.vehicle.chain import Vehicle

Point = tuple[float, float] | Array

# What a metre costs beyond its length. The steepest slope that can be climbed, and friction used
# to the full, are each worth a detour of four times the length: there is no margin left on them.
# Roughness as large as the wheel is an obstacle, worth ten. Ground that is everywhere too hollow
# for the wheels is worth ten too: it may be straddled, but only by luck.
SLOPE = 4.0
FRICTION = 4.0
ROUGHNESS = 10.0
HOLLOW = 10.0
STEEPEST = math.radians(30)  # where nothing says what friction can hold; loose soil slides at 30-35

# Neighbours on the grid and the knight's moves: headings 27 degrees apart, ways at most 2.8 % long.
MOVES = tuple((i, j) for i in range(-2, 3) for j in range(-2, 3) if max(abs(i), abs(j)) and
              (math.gcd(i, j) == 1))  # fmt: skip

CLEAR = 1.2  # distance from blocked nodes that smoothing keeps, in cells: the cell and a margin
TIGHT = 0.97  # part of the largest curvature that smoothing aims at, once it was seen to miss it
TIGHTER = 0.7  # smallest factor on it from round to round
GRAZE = 0.05  # distance between the places where a path is judged, in cells
EASE = 1.02  # factor on the largest curvature up to which a route counts as smooth
FIRM = (1.0, 3.0, 10.0, 30.0, 100.0)  # weights of clearance and curvature against cost, in turn
POINTS = 2000  # of a route while it is smoothed: more take longer than the route is worth
BLUR = 1.0  # standard deviation of the cost's smoothing, in cells: Newton's method needs it
NEWTON = 300  # steps of one round of smoothing at most
TETHER = 1e-3  # the first one that is tried, relative to the stiffness of the chain of points
SETTLED = 1e-6  # relative gain in a step below which smoothing ends
MIDDLE, EDGE, BEND = np.array([0.5, 0.5]), np.array([-1.0, 1.0]), np.array([1.0, -2.0, 1.0])
DEEPER = 4.0  # factor on the cost of an earlier route's surroundings when the next one is sought
TRIES = 4  # how often the factor is raised until a route is another one
WIDE = 0.1  # half width of these surroundings, as a part of the distance to go
LONGEST = 2.0  # cost of an alternative over the cheapest route's beyond which it is none


class Limits(NamedTuple):
    """What the vehicle can do, as the layers were judged.

    Attributes
    ----------
    steepest : float
        Slope that can be climbed. [rad]
    radius : float
        Of the largest wheel: it is the first that a hollow is too narrow for. [m]
    reach : float
        Radius of the circle about the platform's centre that holds all wheels. [m]
    half : float
        Half the side of the square that stands for the footprint in any heading. [m]
    domain : tuple of 4 floats
        ``x_min, x_max, y_min, y_max`` of the map. [m]
    keep_out : tuple of Region
        Where not to go.
    """

    steepest: float
    radius: float
    reach: float
    half: float
    domain: tuple[float, float, float, float]
    keep_out: tuple[Region, ...]


class Traversability(NamedTuple):
    """What it costs a vehicle to be at a place, and why.

    Attributes
    ----------
    x, y : ndarray, shape (n_x,) and (n_y,)
        Axes in map coordinates. [m]
    cost : ndarray, shape (n_x, n_y)
        Of a metre; infinite where the vehicle's centre must not be. [1]
    slope : ndarray, shape (n_x, n_y)
        Of the plane that fits the ground under the footprint. [rad]
    roughness : ndarray, shape (n_x, n_y)
        Root mean square deviation of that ground from its plane. [m]
    hollow : ndarray, shape (n_x, n_y)
        Largest curvature of the ground upwards, in any direction; negative on a dome. [1/m]
    friction : ndarray, shape (n_x, n_y), or None
        Tangent of the slope over the mean friction under the footprint; None if the terrain has
        no friction. [1]
    limits : Limits
        What they were held against.
    """

    x: Array
    y: Array
    cost: Array
    slope: Array
    roughness: Array
    hollow: Array
    friction: Array | None
    limits: Limits

    @property
    def spacing(self) -> tuple[float, float]:
        """Distance between nodes along x and y [m]."""
        return _step(self.x), _step(self.y)


class Route(NamedTuple):
    """A way over the map.

    Attributes
    ----------
    points : ndarray, shape (n, 2)
        Way-points in map coordinates, evenly apart. [m]
    cost : float
        Integral of the map's cost along them. [m]
    length : float
        Of the straight lines between them. [m]
    """

    points: Array
    cost: float
    length: float


def traversability(
    terrain: Bicubic,
    vehicle: Vehicle,
    *,
    keep_out: Iterable[Region] = (),
    steepest: float | None = None,
    spacing: float | None = None,
) -> Traversability:
    """Return where a vehicle can go on a map and at what cost.

    Parameters
    ----------
    terrain : Bicubic
        The ground, with its friction if it has one.
    vehicle : Vehicle
        Its wheels, in its zero configuration, give the footprint.
    keep_out : iterable of Region
        Places that no wheel may touch.
    steepest : float, optional
        Slope that can be climbed; by default what the largest friction can hold, or 30 degrees
        on a ground without friction. [rad]
    spacing : float, optional
        Distance between nodes; by default that of the grid, or a third of half the vehicle's
        smaller extent if that is more. [m]

    Returns
    -------
    Traversability
        Blocked is a node where the slope is steeper than ``steepest`` or than friction can hold in
        any heading, where the ground is more hollow than the largest wheel is round, from where
        a wheel may reach over the edge of the map, or into a region to keep out of.

    Raises
    ------
    ModelError
        If ``steepest`` is not an angle below a right one, or ``spacing`` not positive or too large.

    Notes
    -----
    A metre costs ``1 + 4 (slope / steepest)**2 + 4 friction**2 + 10 (roughness / radius)**2``
    and ten times the share of the ground under the footprint that is too hollow. Hollow ground
    blocks the vehicle's centre; that every wheel stays out of it takes the heading, which a plan
    decides and a route does not. The wheel with the best grip decides what friction can hold.
    """
    right, forward, reach = extents(vehicle)
    half, radius = math.sqrt(right * forward), max(wheel.radius for wheel in vehicle.wheels)
    grip = max(wheel.grip for wheel in vehicle.wheels)
    if spacing is None:
        spacing = max(*terrain.grid.spacing, min(right, forward) / 3)
    x, y = _coarse_axes(terrain.grid, spacing)
    slope, roughness, hollow, share = _ground(terrain.grid, x, y, half, 1 / radius)
    held = _friction(terrain, x, y, half)
    held = None if held is None else held * grip
    if steepest is None:
        steepest = STEEPEST if held is None else math.atan(held.max())
    if not 0 < steepest < math.pi / 2:
        raise ModelError(
            f"traversability: steepest must lie between 0 and pi/2 radians, found {steepest}"
        )
    used = None if held is None else np.tan(slope) / held
    limits = Limits(steepest, radius, reach, half, terrain.domain, tuple(keep_out))
    cost = 1 + SLOPE * (slope / steepest) ** 2 + ROUGHNESS * (roughness / radius) ** 2
    cost += HOLLOW * share
    if used is not None:
        cost += FRICTION * used**2
    layers = Traversability(x, y, cost, slope, roughness, hollow, used, limits)
    cost[_blocked(layers)] = math.inf
    return layers


def reasons(layers: Traversability, x: float, y: float) -> str:
    """Return in words why a vehicle cannot be at a place of the map; empty if it can.

    Parameters
    ----------
    layers : Traversability
        The map.
    x, y : float
        Map coordinates. [m]
    """
    x_min, x_max, y_min, y_max = layers.limits.domain
    beyond = math.hypot(max(x_min - x, x - x_max, 0), max(y_min - y, y - y_max, 0))
    if beyond > 0:
        return f"{beyond:.3g} m outside the map"
    i, j = _node(layers, x, y)
    if math.isfinite(layers.cost[i, j]):
        return ""
    return "; ".join(_why(layers, i, j))


def route(
    layers: Traversability, start: Point, goal: Point, *, turning_radius: float = 0.0
) -> Array:
    """Return the cheapest way from a start to a goal.

    Parameters
    ----------
    layers : Traversability
        The map.
    start, goal : tuple of 2 floats
        Map coordinates. [m]
    turning_radius : float
        Smallest radius of a turn, as far as there is room for it. [m]

    Returns
    -------
    ndarray, shape (n, 2)
        Way-points from the start to the goal, half the vehicle's extent apart, or 1/2000 of the
        way if that is more. The cubic spline through them (`Path`) keeps out of blocked nodes;
        where there is no room for that, they are the nodes of the search. [m]

    Raises
    ------
    ModelError
        If a point is blocked or off the map, or no way leads from one to the other, or the
        turning radius is not a length.
    """
    _check_question(layers, start, goal, turning_radius)
    rough = _search(layers, layers.cost, np.asarray(start, float), np.asarray(goal, float))
    return _smooth(layers, rough, turning_radius)


def routes(
    layers: Traversability,
    start: Point,
    goal: Point,
    count: int,
    *,
    turning_radius: float = 0.0,
) -> list[Route]:
    """Return several ways from a start to a goal, the cheapest first.

    Parameters
    ----------
    layers, start, goal, turning_radius
        As for `route`.
    count : int
        How many at most. There are fewer where no other way is left that keeps a vehicle's width
        from all others at some place and costs at most twice the cheapest.

    Raises
    ------
    ModelError
        As `route` does, or if the count is not positive.
    """
    if count < 1:
        raise ModelError(f"routes: count must be at least 1, found {count}")
    _check_question(layers, start, goal, turning_radius)
    ends = np.asarray(start, float), np.asarray(goal, float)
    found: list[Route] = []
    near = np.zeros_like(layers.cost)
    for attempt in range(count * TRIES):
        # Smoothed at the raised cost too: else it would go back to the route next to it.
        raised = layers._replace(cost=layers.cost * (1 + DEEPER * near))
        rough = _search(layers, raised.cost, *ends)
        points = _smooth(raised, rough, turning_radius)
        new = Route(points, _integral(layers, points), _length(points))
        if _is_another(layers, new, found):
            found.append(new)
        if len(found) == count or attempt + 1 == count * TRIES:
            break
        near += _surroundings(layers, rough, *ends)
    return sorted(found, key=lambda each: each.cost)


# Layers


def extents(vehicle: Vehicle) -> tuple[float, float, float]:
    """Return half the width and the length of the vehicle, and the circle that holds it [m].

    A wheel may be steered and tilted: from its centre it reaches its radius in every direction,
    but counts towards width and length as it stands straight.
    """
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    poses = vehicle.carriers(rest, {c.name: ca.SX(0) for c in vehicle.coordinates})
    at = np.array([np.array(ca.evalf(pose.origin)).ravel()[:2] for pose in poses])
    radius = np.array([wheel.radius for wheel in vehicle.wheels])
    tube = np.array([wheel.r1 for wheel in vehicle.wheels])
    size = np.stack([tube, radius], axis=1)
    right, forward = 0.5 * ((at + size).max(axis=0) - (at - size).min(axis=0))
    return float(right), float(forward), float((np.hypot(*at.T) + radius).max())


def _coarse_axes(grid: Grid, spacing: float) -> tuple[Array, Array]:
    """Return the axes of the cost grid: the grid's own, or even ones about a spacing apart."""
    extent = min(float(np.ptp(grid.x)), float(np.ptp(grid.y)))
    if not 0 < spacing <= extent / 2:
        raise ModelError(
            "traversability: spacing must be positive and at most half the map's extent, "
            f"{extent / 2:.4g} m, found {spacing:.4g} m"
        )
    axes = []
    for axis, h in zip((grid.x, grid.y), grid.spacing, strict=True):
        count = round(float(np.ptp(axis)) / spacing)
        same = abs(spacing - h) < 1e-9 * h
        axes.append(np.array(axis) if same else np.linspace(axis[0], axis[-1], count + 1))
    return axes[0], axes[1]


def _ground(
    grid: Grid, x: Array, y: Array, half: float, sharpest: float
) -> tuple[Array, Array, Array, Array]:
    """Return slope, roughness, hollow, and the share of the footprint that is too hollow."""
    z = grid.z - grid.z.mean()
    p, q, r, s, t = _derivatives(z, grid.spacing)
    hollow = _sharpest(p, q, r, s, t)
    if min(_nodes_within(half, h) for h in grid.spacing) > 0:
        p, q, variance = _plane(z, grid.spacing, half)
    else:
        # Nodes too far apart to fit a plane to: what curvature makes of a square of this size.
        variance = half**4 * ((r**2 + t**2) / 45 + s**2 / 9)
    share = _mean((hollow >= sharpest).astype(float), grid.spacing, half)
    layers = [np.arctan(np.hypot(p, q)), np.sqrt(variance), share]
    slope, roughness, share = (_sampled(layer, grid, x, y) for layer in layers)
    size = [math.ceil(_step(new) / h - 1e-9) for new, h in zip((x, y), grid.spacing, strict=True)]
    largest = (
        hollow if max(size) == 1 else ndimage.maximum_filter(hollow, [2 * n - 1 for n in size])
    )
    nearest = [_nearest(old, new) for old, new in ((grid.x, x), (grid.y, y))]
    return slope, roughness, largest[np.ix_(*nearest)], share


def _derivatives(z: Array, h: tuple[float, float]) -> tuple[Array, Array, Array, Array, Array]:
    """Return first and second differences: z_x, z_y [1], z_xx, z_xy, z_yy [1/m]."""
    p: Array = np.gradient(z, h[0], axis=0, edge_order=2)
    q: Array = np.gradient(z, h[1], axis=1, edge_order=2)
    second = [1.0, -2.0, 1.0]
    # Neighbours, not neighbours' neighbours: what lies between two nodes counts in full.
    r = ndimage.correlate1d(z, second, axis=0, mode="nearest") / h[0] ** 2
    t = ndimage.correlate1d(z, second, axis=1, mode="nearest") / h[1] ** 2
    for array, axis in ((r, 0), (t, 1)):  # at the border the same as next to it
        border = np.moveaxis(array, axis, 0)
        border[0], border[-1] = border[1], border[-2]
    s: Array = np.gradient(p, h[1], axis=1)
    return p, q, r, s, t


def _sharpest(p: Array, q: Array, r: Array, s: Array, t: Array) -> Array:
    """Return the largest normal curvature of a surface, upwards positive [1/m]."""
    w = np.sqrt(1 + p**2 + q**2)
    mean = ((1 + q**2) * r - 2 * p * q * s + (1 + p**2) * t) / (2 * w**3)
    total = (r * t - s**2) / w**4
    largest: Array = mean + np.sqrt(np.maximum(mean**2 - total, 0))
    return largest


def _plane(z: Array, h: tuple[float, float], half: float) -> tuple[Array, Array, Array]:
    """Return the slopes [1] of the least-squares plane of a square, and the variance left [m^2]."""
    left = _mean(z**2, h, half) - _mean(z, h, half) ** 2
    slopes = []
    for axis in (0, 1):
        m = _nodes_within(half, h[axis])
        offset = h[axis] * np.arange(-m, m + 1)
        weights = offset / (offset @ offset)
        others = _mean(z, h, half, axes=(1 - axis,))
        slope = ndimage.correlate1d(others, weights, axis=axis, mode="nearest")
        left -= slope**2 * np.mean(offset**2)
        slopes.append(slope)
    return slopes[0], slopes[1], np.maximum(left, 0)


def _mean(z: Array, h: tuple[float, float], half: float, axes: tuple[int, ...] = (0, 1)) -> Array:
    """Return the means over squares of the footprint's size."""
    for axis in axes:
        size = 2 * _nodes_within(half, h[axis]) + 1
        z = ndimage.uniform_filter1d(z, size, axis=axis, mode="nearest")
    return z


def _nodes_within(half: float, h: float) -> int:
    """Return the nodes on either side of the middle of a square: their cells fill it."""
    return round(half / h - 0.5)


def _sampled(layer: Array, grid: Grid, x: Array, y: Array) -> Array:
    """Return a layer at new nodes, interpolated linearly."""
    for axis, (old, new) in enumerate(((grid.x, x), (grid.y, y))):
        if old.size == new.size:
            continue
        cell = (new - old[0]) / _step(old)
        first = np.clip(np.floor(cell).astype(np.intp), 0, old.size - 2)
        weight = np.expand_dims(cell - first, 1 - axis)
        low, high = np.take(layer, first, axis), np.take(layer, first + 1, axis)
        layer = low + weight * (high - low)
    return layer


def _friction(terrain: Bicubic, x: Array, y: Array, half: float) -> Array | None:
    """Return the mean friction under the footprint, None if the terrain has none [1]."""
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
    return _mean(at_nodes, (_step(x), _step(y)), half)


def _formula(function: Callable[[ca.SX, ca.SX], ca.SX], x: Array, y: Array) -> Array:
    """Return the values of a formula on a grid, one line along y after the other."""
    at, line = ca.SX.sym("x"), ca.SX.sym("y", y.size)
    values = [ca.SX(function(at, line[j])) for j in range(y.size)]
    f = ca.Function("friction", [at, line], [ca.vertcat(*values)])
    return np.array([np.array(f(float(each), y)).ravel() for each in x])


def _blocked(layers: Traversability) -> Mask:
    """Return where the vehicle's centre must not be."""
    x, y, limits = layers.x[:, None], layers.y[None, :], layers.limits
    blocked: Mask = layers.slope > limits.steepest
    blocked |= layers.hollow * limits.radius >= 1
    if layers.friction is not None:
        blocked |= layers.friction >= 1
    blocked |= _to_edge(limits, x, y) < limits.reach
    for region in limits.keep_out:
        part = _window(layers, region.bounds, limits.reach)
        inside = region.distance(*np.broadcast_arrays(x[part[0]], y[:, part[1]])) < limits.reach
        blocked[part] |= inside
    return blocked


def _to_edge(limits: Limits, x: Array, y: Array) -> Array:
    """Return the distance from points of the map to its edge [m]."""
    x_min, x_max, y_min, y_max = limits.domain
    to_edge: Array = np.minimum(np.minimum(x - x_min, x_max - x), np.minimum(y - y_min, y_max - y))
    return to_edge


def _window(
    layers: Traversability, bounds: tuple[float, float, float, float], room: float
) -> tuple[slice, slice]:
    """Return the part of the grid within some room of a rectangle."""
    i = np.searchsorted(layers.x, (bounds[0] - room, bounds[1] + room)).tolist()
    j = np.searchsorted(layers.y, (bounds[2] - room, bounds[3] + room)).tolist()
    return slice(*i), slice(*j)


def _why(layers: Traversability, i: int, j: int) -> list[str]:
    """Return in words all reasons why a node is blocked."""
    limits, slope, words = layers.limits, float(layers.slope[i, j]), []
    x, y = layers.x[i], layers.y[j]
    to_edge = float(_to_edge(limits, x, y))
    if to_edge < limits.reach:
        words.append(
            f"{to_edge:.3g} m from the edge of the map, where wheels reach {limits.reach:.3g} m"
        )
    if slope > limits.steepest:
        words.append(
            f"slope of {math.degrees(slope):.3g} degrees, at most "
            f"{math.degrees(limits.steepest):.3g} can be climbed"
        )
    if layers.friction is not None and layers.friction[i, j] >= 1:
        words.append(
            f"friction of {math.tan(slope) / layers.friction[i, j]:.3g} cannot hold a slope of "
            f"{math.degrees(slope):.3g} degrees in any heading"
        )
    if layers.hollow[i, j] * limits.radius >= 1:
        words.append(
            f"hollow of {1 / layers.hollow[i, j]:.3g} m radius, too narrow for a wheel of "
            f"{limits.radius:.3g} m"
        )
    for region in limits.keep_out:
        distance = float(region.distance(x, y))
        if distance < 0:
            words.append(f"inside the keep-out {region.words}")
        elif distance < limits.reach:
            words.append(
                f"{distance:.3g} m from the keep-out {region.words}, where wheels reach "
                f"{limits.reach:.3g} m"
            )
    return words


# Search


def _check_question(
    layers: Traversability, start: Point, goal: Point, turning_radius: float
) -> None:
    """Refuse ends where the vehicle cannot be, and what is no turning radius."""
    for name, point in (("start", start), ("goal", goal)):
        x, y = (float(each) for each in point)
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ModelError(f"route: the {name} must be finite, found {_at(point)}")
        why = reasons(layers, x, y)
        if why:
            raise ModelError(f"route: the vehicle cannot be at the {name} {_at(point)}: {why}")
    if np.array_equal(start, goal):
        raise ModelError(f"route: start and goal coincide at {_at(start)}")
    if not 0 <= turning_radius < math.inf:
        raise ModelError(
            f"route: turning_radius must be zero or more metres, found {turning_radius}"
        )


def _search(layers: Traversability, cost: Array, start: Array, goal: Array) -> Array:
    """Return the cheapest way along the grid: start, nodes, goal. Shape (n, 2) [m]."""
    first, last = (
        int(np.ravel_multi_index(_node(layers, *point), cost.shape)) for point in (start, goal)
    )
    lengths, before = dijkstra(
        _graph(cost, layers.spacing), indices=first, return_predecessors=True
    )
    if not math.isfinite(lengths[last]):
        raise ModelError(_no_way(layers, lengths, start, goal))
    nodes = [last]
    while nodes[-1] != first:
        nodes.append(int(before[nodes[-1]]))
    i, j = np.unravel_index(nodes[::-1], cost.shape)
    inner = np.stack([layers.x[i], layers.y[j]], axis=1)
    points = np.concatenate([[start], inner, [goal]])
    fresh = np.concatenate([[True], np.any(np.diff(points, axis=0) != 0, axis=1)])
    return np.asarray(points[fresh])


def _graph(cost: Array, h: tuple[float, float]) -> csr_matrix:
    """Return what the moves between free nodes cost, shape (n_x n_y, n_x n_y) [m].

    A move costs its length times the mean of its two nodes and of the two that it passes between:
    it neither cuts a blocked corner nor jumps over a blocked node.
    """
    size = cost.size
    padded = np.pad(cost, 2, constant_values=math.inf).astype(np.float32)
    weights = np.empty((size, len(MOVES)), dtype=np.float32)
    shifts = np.array([i * cost.shape[1] + j for i, j in MOVES], dtype=np.int32)
    for column, (i, j) in enumerate(MOVES):
        passed = _passed(i, j)
        total = _shifted(padded, 0, 0) + _shifted(padded, i, j)
        for each in passed:
            total = total + _shifted(padded, *each)
        weights[:, column] = (total * (math.hypot(i * h[0], j * h[1]) / (2 + len(passed)))).ravel()
    free = np.isfinite(weights)
    ends = np.concatenate([[0], np.cumsum(np.count_nonzero(free, axis=1))])
    targets = (np.arange(size, dtype=np.int32)[:, None] + shifts)[free]
    return csr_matrix((weights[free].astype(float), targets, ends), shape=(size, size))


def _passed(i: int, j: int) -> tuple[tuple[int, int], ...]:
    """Return the nodes that a move passes between."""
    if 0 in (i, j):
        return ()
    if abs(i) == abs(j):
        return (i, 0), (0, j)
    half = (i // 2, 0) if abs(i) == 2 else (0, j // 2)
    return half, (i - half[0], j - half[1])


def _shifted(padded: npt.NDArray[np.float32], i: int, j: int) -> npt.NDArray[np.float32]:
    rows, columns = padded.shape
    return padded[2 + i : rows - 2 + i, 2 + j : columns - 2 + j]


def _no_way(layers: Traversability, lengths: Array, start: Array, goal: Array) -> str:
    """Return in words how far towards the goal the ground that can be reached goes."""
    i, j = np.nonzero(np.isfinite(lengths).reshape(layers.cost.shape))
    gaps = np.hypot(layers.x[i] - goal[0], layers.y[j] - goal[1])
    best = int(gaps.argmin())
    nearest = np.array([layers.x[i[best]], layers.y[j[best]]])
    ahead = _even(np.stack([nearest, goal]), 0.5 * min(layers.spacing))
    why = next((w for w in (reasons(layers, *point) for point in ahead.tolist()) if w), "")
    return (
        f"route: no way leads from {_at(start)} to {_at(goal)}: the ground that can be reached "
        f"ends at {_at(nearest)}, {gaps[best]:.3g} m from the goal"
        + (f"; beyond it: {why}" if why else "")
    )


def _is_another(layers: Traversability, new: Route, found: Sequence[Route]) -> bool:
    """Return whether a route leaves all earlier ones by a vehicle's width, at a bearable cost."""
    fine, width = 0.25 * layers.limits.half, 2 * layers.limits.reach
    for old in found:
        gaps, _ = cKDTree(_even(old.points, fine)).query(_even(new.points, fine))
        if gaps.max() <= width:
            return False
    return not found or new.cost <= LONGEST * min(each.cost for each in found)


def _surroundings(layers: Traversability, points: Array, start: Array, goal: Array) -> Array:
    """Return how near nodes are to a route: one on it, falling to zero; zero at its ends [1]."""
    width = max(2 * layers.limits.reach, WIDE * float(np.linalg.norm(goal - start)))
    off = np.ones(layers.cost.shape, dtype=bool)
    off[_nodes(layers, _even(points, 0.5 * min(layers.spacing)))] = False
    near = np.exp(-((ndimage.distance_transform_edt(off, sampling=layers.spacing) / width) ** 2))
    for end in (start, goal):  # all routes have their ends in common
        away = np.hypot(layers.x[:, None] - end[0], layers.y[None, :] - end[1])
        near *= np.minimum(away / (2 * width), 1)
    return np.asarray(near)


# Smoothing


class _Field(NamedTuple):
    """Part of the map about a route: cost without its infinities, and distance to what is blocked.

    ``cost`` [1] and ``clearance`` [m], shape (n_x, n_y); ``origin`` in map coordinates and
    ``spacing``, [m].
    """

    cost: Array
    clearance: Array
    origin: Array
    spacing: Array


class _Aim(NamedTuple):
    """What smoothing holds against each other; weights without unit, lengths [m]."""

    stiff: float
    clear: float
    sharpest: float
    weight: float
    step: float


def _smooth(layers: Traversability, rough: Array, turning_radius: float) -> Array:
    """Return a smooth way near a rough one; the rough one if there is no room for smoothness."""
    step = max(0.25 * layers.limits.half, _length(rough) / POINTS)
    half = max(layers.limits.half, step)
    field = _field(layers, rough, turning_radius)
    sharpest = 1 / turning_radius if turning_radius else math.inf
    points, best, least = _even(rough, step), None, math.inf
    for weight in FIRM:
        clear = CLEAR * max(layers.spacing)
        aim = _Aim(half, clear, sharpest, weight, _length(points) / (len(points) - 1))
        points = _curved(_relaxed(field, points, aim), step)
        candidate = _curved(points, half)
        is_free, curvature = _judged(layers, candidate)
        if is_free and curvature < least:
            best, least = candidate, curvature
        if is_free and curvature * turning_radius <= EASE:
            break
        if is_free and turning_radius:
            # Where the way begins to turn, the spline bends more than its points do.
            sharpest *= max(TIGHT / (curvature * turning_radius), TIGHTER)
    if best is not None:
        return best
    for spacing in (half, 0.5 * half, 0.25 * half):
        candidate = _even(rough, spacing)
        if _judged(layers, candidate)[0]:
            return candidate
    return rough


def _judged(layers: Traversability, points: Array) -> tuple[bool, float]:
    """Return whether the path through points is free, and its largest curvature [1/m]."""
    path = Path(points)
    count = math.ceil(path.length / (GRAZE * min(layers.spacing)))
    place = path.at(np.linspace(0, path.length, count + 1))
    i, j = _nodes(layers, np.stack([place.x, place.y], axis=1))
    return bool(np.isfinite(layers.cost[i, j]).all()), float(np.abs(place.curvature).max())


def _field(layers: Traversability, rough: Array, turning_radius: float) -> _Field:
    """Return the part of the map that smoothing can get to."""
    (x_min, y_min), (x_max, y_max) = rough.min(axis=0), rough.max(axis=0)
    room = 2 * turning_radius + 4 * layers.limits.half + 4 * max(layers.spacing)
    part = _window(layers, (float(x_min), float(x_max), float(y_min), float(y_max)), room)
    cost, h = layers.cost[part], layers.spacing
    free = np.isfinite(cost)
    if free.all():
        clearance = np.full(cost.shape, np.inf)
    else:
        to_blocked, nearest = ndimage.distance_transform_edt(free, h), _nearest_free(free, h)
        clearance = to_blocked - ndimage.distance_transform_edt(~free, h)
        cost = cost[nearest]
    cost = ndimage.gaussian_filter(cost, BLUR, mode="nearest")
    clearance = np.minimum(clearance, 2 * CLEAR * max(h))  # more than enough is enough
    origin = np.array([layers.x[part[0]][0], layers.y[part[1]][0]])
    return _Field(cost, clearance, origin, np.array(h))


def _nearest_free(free: Mask, h: tuple[float, float]) -> tuple[Array, Array]:
    """Return the indices of the free node nearest to every node."""
    found = ndimage.distance_transform_edt(~free, h, return_distances=False, return_indices=True)
    return found[0], found[1]


def _relaxed(field: _Field, points: Array, aim: _Aim) -> Array:
    """Return points moved to where the way is cheap and smooth; its ends stay.

    Newton's method with what is sure to be positive of the second derivatives: gradients alone
    would take thousands of steps, because a chain of points gives way slowly to what is far.
    """
    if len(points) < 3:
        return points
    p, tether = points - field.origin, 0.0
    total, gradient, bands = _effort(field, p, aim)
    for _ in range(NEWTON):
        # A tether holds every point where it is: away from there neither costs nor what is blocked
        # are known, and a string would cut through both to be straight.
        held = bands + np.array([[0.0]] * 5 + [[tether]])
        change = np.zeros_like(p)
        change[1:-1] = -solveh_banded(held, gradient[1:-1].ravel()).reshape(-1, 2)
        new = _effort(field, p + change, aim)
        expected = float(np.sum(gradient * change))
        if np.abs(change).max() > field.spacing.min() or new[0] > total + 0.1 * expected:
            tether = max(4 * tether, TETHER / aim.step)
            continue
        settled = new[0] > total * (1 - SETTLED)
        p, tether = p + change, 0.25 * tether
        total, gradient, bands = new
        if settled:
            break
    return np.concatenate([points[:1], p[1:-1] + field.origin, points[-1:]])


def _effort(field: _Field, p: Array, aim: _Aim) -> tuple[float, Array, Array]:
    """Return cost plus bending plus what breaks the rules, its gradient and its Hessian.

    The integral over the way of ``cost + (stiff curvature)**2 / 2`` and of ``weight`` times the
    squares of clearance and of curvature, relative to what is aimed at, where they miss it.

    Returns
    -------
    float, ndarray, shape (n, 2), ndarray, shape (6, 2 n - 4)
        The integral [m], its gradient by the points [1], and a positive definite approximation
        of the Hessian by the inner points, in upper banded form [1/m].
    """
    edge = np.diff(p, axis=0)
    length = np.linalg.norm(edge, axis=1) + 1e-9 * aim.step
    along, middle = edge / length[:, None], 0.5 * (p[1:] + p[:-1])
    cost, by_middle = _bilinear(field.cost, field, middle)
    clearance, normal = _bilinear(field.clearance, field, middle)
    normal = normal / aim.clear
    missing = np.maximum(1 - clearance / aim.clear, 0)
    uneven = (length - length.mean()) / aim.step
    bend = np.diff(p, 2, axis=0) / aim.step**2
    curvature = np.linalg.norm(bend, axis=1) + 1e-9 / aim.step
    excess = np.maximum(curvature / aim.sharpest - 1, 0)
    rule, stiff = 20 * aim.weight * aim.step, aim.step * aim.stiff**2
    total = cost @ length + 0.5 * rule * (missing @ missing + excess @ excess)
    total += 0.5 * stiff * np.sum(bend**2) + aim.step * (uneven @ uneven)
    inward = bend / curvature[:, None]
    gradients = (
        (MIDDLE, by_middle * length[:, None] - (rule * missing)[:, None] * normal),
        (EDGE, (cost + 2 * uneven)[:, None] * along),
        (BEND / aim.step**2, stiff * bend + (rule / aim.sharpest * excess)[:, None] * inward),
    )
    sharp = rule / aim.sharpest * (excess / curvature)[:, None, None] * np.eye(2)
    sharp += (rule / aim.sharpest**2 * (excess > 0))[:, None, None] * _squares(inward)
    hessians = (
        (MIDDLE, (rule * (missing > 0))[:, None, None] * _squares(normal)),
        (EDGE, (cost / length)[:, None, None] * (np.eye(2) - _squares(along))
         + 2 / aim.step * _squares(along)),
        (BEND / aim.step**2, stiff * np.eye(2) + sharp),
    )  # fmt: skip
    return float(total), _gathered(gradients, p), _banded(hessians, len(p))


def _squares(vectors: Array) -> Array:
    """Return the dyads of vectors with themselves, shape (n, 2, 2)."""
    return np.asarray(vectors[:, :, None] * vectors[:, None, :])


def _gathered(parts: Iterable[tuple[Array, Array]], p: Array) -> Array:
    """Return the gradient by the points of parts that depend on weighted sums of neighbours."""
    gradient = np.zeros_like(p)
    for weights, part in parts:
        for k, weight in enumerate(weights):
            gradient[k : k + len(part)] += weight * part
    return gradient


def _banded(parts: Iterable[tuple[Array, Array]], count: int) -> Array:
    """Return the Hessian by the inner points in upper banded form, shape (6, 2 count - 4)."""
    blocks = np.zeros((3, count, 2, 2))  # blocks[o, k] couples point k to point k + o
    for weights, part in parts:
        for a in range(len(weights)):
            for b in range(a, len(weights)):
                blocks[b - a, a : a + len(part)] += weights[a] * weights[b] * part
    inner = count - 2
    bands = np.zeros((6, 2 * inner))
    for o, c, d in np.ndindex(3, 2, 2):
        if 2 * o + d >= c:
            bands[5 - (2 * o + d - c), 2 * o + d :: 2] = blocks[o, 1 : 1 + inner - o, c, d]
    return bands


def _bilinear(values: Array, field: _Field, points: Array) -> tuple[Array, Array]:
    """Return values between nodes, shape (n,), and their gradients, shape (n, 2)."""
    cell = np.clip(points / field.spacing, 0, np.array(values.shape) - 1)
    first = np.minimum(cell.astype(np.intp), np.array(values.shape) - 2)
    (u, v), (i, j) = (cell - first).T, first.T
    a, b, c, d = values[i, j], values[i + 1, j], values[i, j + 1], values[i + 1, j + 1]
    low, high = a + u * (b - a), c + u * (d - c)
    by_u = (b - a) + v * ((d - c) - (b - a))
    return low + v * (high - low), np.stack([by_u, high - low], axis=1) / field.spacing


# Nodes and lines


def _step(axis: Array) -> float:
    """Return the distance between the nodes of an even axis [m]."""
    return float(np.ptp(axis) / (axis.size - 1))


def _nearest(axis: Array, at: Array) -> npt.NDArray[np.intp]:
    """Return the nearest nodes of an even axis."""
    cells = np.rint((at - axis[0]) / _step(axis))
    return np.asarray(np.clip(cells, 0, axis.size - 1), dtype=np.intp)


def _nodes(
    layers: Traversability, points: Array
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return the nodes nearest to points, shape (n, 2)."""
    return _nearest(layers.x, points[:, 0]), _nearest(layers.y, points[:, 1])


def _node(layers: Traversability, x: float, y: float) -> tuple[int, int]:
    i, j = _nodes(layers, np.array([[x, y]]))
    return int(i[0]), int(j[0])


def _length(points: Array) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def _even(points: Array, step: float) -> Array:
    """Return points evenly along a line, about a step apart; the ends are kept."""
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    at = np.concatenate([[0], np.cumsum(gaps)])
    count = max(round(float(at[-1]) / step), 1)
    s = np.linspace(0, at[-1], count + 1)
    even = np.stack([np.interp(s, at, column) for column in points.T], axis=1)
    even[0], even[-1] = points[0], points[-1]
    return even


def _curved(points: Array, step: float) -> Array:
    """Return points evenly along the smooth curve through points, about a step apart."""
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    at = np.concatenate([[0], np.cumsum(gaps)])
    count = max(round(float(at[-1]) / step), 1)
    even = np.asarray(CubicSpline(at, points - points[0])(np.linspace(0, at[-1], count + 1)))
    even += points[0]
    even[0], even[-1] = points[0], points[-1]
    return even


def _integral(layers: Traversability, points: Array) -> float:
    """Return the integral of the cost along a line; the cost of the nearest nodes [m]."""
    dense = _even(points, 0.25 * min(layers.spacing))
    middle = 0.5 * (dense[1:] + dense[:-1])
    return float(
        layers.cost[_nodes(layers, middle)] @ np.linalg.norm(np.diff(dense, axis=0), axis=1)
    )


def _at(point: Point) -> str:
    return f"({float(point[0]):.9g}, {float(point[1]):.9g})"
