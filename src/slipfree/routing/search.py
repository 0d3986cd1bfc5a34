"""Routes over a large map: paths of least cost between two positions, and their homotopy classes.

A route is an initial guess of a plan, not a plan. Before it is computed, it is checked whether its
positions can be reached on the map. It is then smoothed: low cost, clearance from blocked nodes,
bounded curvature.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import reduce
from itertools import pairwise
from operator import attrgetter, itemgetter
from typing import NamedTuple

import numpy as np
import scipy

from slipfree.atlas.atlas import atlas, least_bounds
from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Mask, with_overview
from slipfree.core.schema import Count, NonNegative
from slipfree.geometry.path import Path, arc_lengths, cubic_spline
from slipfree.geometry.regions import Region
from slipfree.models.kinematics import direct_kinematics
from slipfree.routing.traversability import (
    HEADINGS,
    SLIDING,
    Point,
    Traversability,
    blocking_reasons,
    extents,
    more_friction_words,
    nearest_headings,
    node_at,
    nodes_at,
    out_of_bounds,
    point_text,
    reasons_by_kind,
    to_edge,
    window,
)
from slipfree.terrain.base import axis_step
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.tree import Vehicle

CLEARANCE = 1.2  # clearance from blocked nodes: a cell and a margin, in cells
CURVATURE_TARGET = 0.97  # target after a violation, relative to the allowed curvature
MIN_TARGET_FACTOR = 0.7  # smallest factor by which a round changes that target
DEARER = 1.3  # largest cost of a smoothed route, relative to that which the search found
CHECK_STEP = 0.05  # distance between the points at which a path is checked, in cells
CURVATURE_TOLERANCE = 1.02  # accepted curvature, relative to the allowed curvature
PENALTIES = (1.0, 3.0, 10.0, 30.0, 100.0)  # weights of clearance and curvature, increased in turn
MAX_POINTS = 2000  # points of a route during smoothing; limits the computing time
BLUR = 1.0  # standard deviation of the smoothing of the cost, for Newton's method, in cells
MAX_NEWTON_STEPS = 300  # of one round of smoothing
INITIAL_DAMPING = 1e-3  # of the Newton steps, relative to the stiffness of the chain of points
MIN_RELATIVE_GAIN = 1e-6  # smoothing ends at a step with a smaller gain
MIDDLE, EDGE, BEND = np.array([0.5, 0.5]), np.array([-1.0, 1.0]), np.array([1.0, -2.0, 1.0])


class _CostField(NamedTuple):
    """Part of the map around a route: finite cost, and distance to the nearest blocked node."""

    cost: Array  # shape (n_x, n_y): smoothed cost per metre [1]
    clearance: Array  # shape (n_x, n_y): distance to the nearest blocked node [m]
    origin: Array  # shape (2,): map coordinates of the first node, and distances between nodes [m]
    spacing: Array


class _Objective(NamedTuple):
    """Weights and bounds of the smoothing objective."""

    stiff: float  # weight of the curvature, see `_objective` [m]
    clear: float  # required clearance from blocked nodes [m]
    sharpest: float  # curvature above which a violation is penalised, may be infinite [1/m]
    weight: float  # weight of the violations of clearance and curvature [1]
    step: float  # mean distance between points [m]


def smooth(layers: Traversability, rough: Array, turning_radius: float) -> Array:
    """Return way-points, shape (m, 2), of a smooth route near the rough one that the search found.

    If no smoothed route avoids all blocked nodes, the result is the rough route, if possible with
    equally spaced points whose spline avoids them.
    """
    layers = along(layers, rough)
    step = max(0.25 * layers.limits.half, arc_lengths(rough)[-1] / MAX_POINTS)
    half = max(layers.limits.half, step)
    field = _field(layers, rough, turning_radius)
    sharpest = 1 / turning_radius if turning_radius else math.inf
    dearest = DEARER * path_cost(layers, rough)
    points, best, least = resample_polyline(rough, step), None, math.inf
    for weight in PENALTIES:
        clear = CLEARANCE * max(layers.spacing)
        aim = _Objective(half, clear, sharpest, weight, arc_lengths(points)[-1] / (len(points) - 1))
        points = resample_polyline(_minimise(field, points, aim), step, spline=True)
        candidate = resample_polyline(points, half, spline=True)
        is_free, curvature = _check_path(layers, candidate)
        # where a turn is too narrow for the radius, a wide one may cross what the route avoids
        is_free = is_free and path_cost(layers, candidate) <= dearest
        if is_free and curvature < least:
            best, least = candidate, curvature
        if is_free and curvature * turning_radius <= CURVATURE_TOLERANCE:
            break
        if is_free and turning_radius:
            # at the beginning of a turn, the spline bends more than the polyline
            sharpest *= max(CURVATURE_TARGET / (curvature * turning_radius), MIN_TARGET_FACTOR)
    if best is not None:
        return best
    for spacing in (half, 0.5 * half, 0.25 * half):
        candidate = resample_polyline(rough, spacing)
        if _check_path(layers, candidate)[0]:
            return candidate
    return rough


def along(layers: Traversability, rough: Array) -> Traversability:
    """Return the map with the costs in the direction of the nearest point of a route."""
    if layers.heading.size == 1:
        return layers
    dense = resample_polyline(rough, 0.5 * min(layers.spacing))
    count = math.ceil(2 * layers.limits.half / min(layers.spacing))  # points on half a vehicle
    steps = scipy.ndimage.uniform_filter1d(np.diff(dense, axis=0), count, axis=0, mode="nearest")
    middle = 0.5 * (dense[1:] + dense[:-1])
    off = np.ones(layers.to_hole.shape, dtype=bool)
    owner = np.zeros(off.shape, dtype=np.intp)
    at = nodes_at(layers, middle)
    off[at], owner[at] = False, np.arange(len(middle))
    heading = nearest_headings(layers, steps)[owner[_nearest(off, layers.spacing)]]
    cost = np.take_along_axis(layers.cost, heading[None], axis=0)
    return layers._replace(heading=layers.heading[:1], cost=cost)


def path_cost(layers: Traversability, points: Array) -> float:
    """Return the integral of the cost along a polyline, in its direction, shape (n, 2) [m]."""
    ends = arc_lengths(points)
    crossings = list[Array]()  # of borders between the nearest nodes, where the cost jumps
    for axis, column in zip((layers.x, layers.y), points.T, strict=True):
        at = (column - axis[0]) / axis_step(axis) + 0.5  # borders have whole numbers
        first = np.ceil(np.minimum(at[:-1], at[1:]))
        count = (np.ceil(np.maximum(at[:-1], at[1:])) - first).astype(int)
        k = np.repeat(np.arange(count.size), count)
        border = first[k] + np.arange(k.size) - (np.cumsum(count) - count)[k]
        crossings.append(ends[k] + ((border - at[:-1][k]) / np.diff(at)[k]) * np.diff(ends)[k])
    s = np.unique(np.concatenate([ends, *crossings]))
    dense = np.stack([np.interp(s, ends, column) for column in points.T], axis=1)
    steps, nodes = np.diff(dense, axis=0), nodes_at(layers, 0.5 * (dense[1:] + dense[:-1]))
    cost = layers.cost_toward(np.arctan2(-steps[:, 0], steps[:, 1]), *nodes)
    # beside a heading that is blocked, the cost is that of the nearest one
    near = layers.cost[(nearest_headings(layers, steps), *nodes)]
    return float(np.where(np.isinf(cost), near, cost) @ np.linalg.norm(steps, axis=1))


def _check_path(layers: Traversability, points: Array) -> tuple[bool, float]:
    """Return whether the spline through points is free, and its largest curvature [1/m]."""
    path = Path(points)
    count = math.ceil(path.length / (CHECK_STEP * min(layers.spacing)))
    place = path.at(np.linspace(0, path.length, count + 1))
    i, j = nodes_at(layers, np.stack([place.x, place.y], axis=1))
    return bool(np.isfinite(layers.least_cost[i, j]).all()), float(np.abs(place.curvature).max())


def _field(layers: Traversability, rough: Array, turning_radius: float) -> _CostField:
    """Return cost and clearance on the part of the map that smoothing can reach."""
    (x_min, y_min), (x_max, y_max) = rough.min(axis=0), rough.max(axis=0)
    room = 2 * turning_radius + 4 * layers.limits.half + 4 * max(layers.spacing)
    part = window(layers, (float(x_min), float(x_max), float(y_min), float(y_max)), room)
    cost, h = layers.least_cost[part], layers.spacing
    free = np.isfinite(cost)
    if free.all():
        clearance = np.full(cost.shape, np.inf)
    else:
        to_blocked, nearest = scipy.ndimage.distance_transform_edt(free, h), _nearest(~free, h)
        # Negative inside blocked regions, so that the gradient leads out of them.
        clearance = to_blocked - scipy.ndimage.distance_transform_edt(~free, h)
        # An infinite cost has no gradient: blocked nodes get that of the nearest free node.
        cost = cost[nearest]
    cost = scipy.ndimage.gaussian_filter(cost, BLUR, mode="nearest")
    clearance = np.minimum(clearance, 2 * CLEARANCE * max(h))  # larger clearances have no effect
    origin = np.array([layers.x[part[0]][0], layers.y[part[1]][0]])
    return _CostField(cost, clearance, origin, np.array(h))


def _nearest(off: Mask, h: tuple[float, float]) -> tuple[Array, Array]:
    i, j = scipy.ndimage.distance_transform_edt(off, h, return_distances=False, return_indices=True)
    return i, j


def _minimise(field: _CostField, points: Array, aim: _Objective) -> Array:
    """Return the points that minimise the smoothing objective, with fixed ends.

    Newton's method uses a positive definite part of the Hessian. A gradient method would take
    thousands of steps, because changes propagate slowly along a chain of points.
    """
    if len(points) < 3:
        return points
    p, damping = points - field.origin, 0.0
    total, gradient, bands = _objective(field, p, aim)
    for _ in range(MAX_NEWTON_STEPS):
        # damping limits the step: the quadratic model of costs and obstacles is valid only nearby
        held = bands + np.array([[0.0]] * 5 + [[damping]])
        change = np.zeros_like(p)
        change[1:-1] = -scipy.linalg.solveh_banded(held, gradient[1:-1].ravel()).reshape(-1, 2)
        new = _objective(field, p + change, aim)
        expected = float(np.sum(gradient * change))
        # Armijo rule; a step beyond one cell would leave the model of the bilinear field.
        if np.abs(change).max() > field.spacing.min() or new[0] > total + 0.1 * expected:
            damping = max(4 * damping, INITIAL_DAMPING / aim.step)
            continue
        settled = new[0] > total * (1 - MIN_RELATIVE_GAIN)
        p, damping = p + change, 0.25 * damping
        total, gradient, bands = new
        if settled:
            break
    return np.concatenate([points[:1], p[1:-1] + field.origin, points[-1:]])


def _objective(field: _CostField, p: Array, aim: _Objective) -> tuple[float, Array, Array]:
    """Return the smoothing objective, its gradient, and an approximation of its Hessian.

    The objective is the integral along the route of ``cost + (stiff * curvature)**2 / 2 + 10 *
    weight * (a**2 + b**2) + d**2``, where ``a`` is the relative lack of clearance, ``b`` the
    relative excess of curvature, and ``d`` the deviation of the distance between two points from
    its mean, divided by ``step``. The Hessian is positive definite, of the inner points, in upper
    banded form.
    """
    edge = np.diff(p, axis=0)
    # Lengths and curvatures are divisors, hence never exactly zero.
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
    sharp += (rule / aim.sharpest**2 * (excess > 0))[:, None, None] * _outer_squares(inward)
    hessians = (
        # Second derivatives of clearance and cost are left out: they may be negative.
        (MIDDLE, (rule * (missing > 0))[:, None, None] * _outer_squares(normal)),
        (
            EDGE,
            (cost / length)[:, None, None] * (np.eye(2) - _outer_squares(along))
            + 2 / aim.step * _outer_squares(along),
        ),
        (BEND / aim.step**2, stiff * np.eye(2) + sharp),
    )
    gradient = np.zeros_like(p)
    for weights, part in gradients:
        for k, weight in enumerate(weights):
            gradient[k : k + len(part)] += weight * part
    blocks = np.zeros((3, len(p), 2, 2))  # blocks[o, k] couples point k to point k + o
    for weights, part in hessians:
        for a in range(len(weights)):
            for b in range(a, len(weights)):
                blocks[b - a, a : a + len(part)] += weights[a] * weights[b] * part
    inner = len(p) - 2
    bands = np.zeros((6, 2 * inner))
    for o, c, d in np.ndindex(3, 2, 2):
        if 2 * o + d >= c:
            # The diagonal is the last of the six rows, as LAPACK requires.
            bands[5 - (2 * o + d - c), 2 * o + d :: 2] = blocks[o, 1 : 1 + inner - o, c, d]
    return float(total), gradient, bands


def _outer_squares(vectors: Array) -> Array:
    """Return the outer product of each vector with itself, shape (n, 2, 2)."""
    return np.asarray(vectors[:, :, None] * vectors[:, None, :])


def _bilinear(values: Array, field: _CostField, points: Array) -> tuple[Array, Array]:
    """Return bilinearly interpolated values, shape (n,), and their gradients, shape (n, 2)."""
    cell = np.clip(points / field.spacing, 0, np.array(values.shape) - 1)
    first = np.minimum(cell.astype(np.intp), np.array(values.shape) - 2)
    (u, v), (i, j) = (cell - first).T, first.T
    a, b, c, d = values[i, j], values[i + 1, j], values[i, j + 1], values[i + 1, j + 1]
    low, high = a + u * (b - a), c + u * (d - c)
    by_u = (b - a) + v * ((d - c) - (b - a))
    return low + v * (high - low), np.stack([by_u, high - low], axis=1) / field.spacing


# Lines


def resample_polyline(points: Array, step: float, *, spline: bool = False) -> Array:
    """Return equally spaced points along a polyline or the spline through its points.

    They have the same ends and are about ``step`` apart.
    """
    at = arc_lengths(points)
    s = np.linspace(0, at[-1], max(round(float(at[-1]) / step), 1) + 1)
    even: Array
    if spline:
        even = cubic_spline(at, points - points[0], s) + points[0]
    else:
        even = np.stack([np.interp(s, at, column) for column in points.T], axis=1)
    even[0], even[-1] = points[0], points[-1]
    return even


Ray = tuple[slice, slice]  # nodes from an obstacle to the border of the map, along an axis
CORNERS = np.ones((3, 3), dtype=int)  # no move passes between nodes that touch at a corner
# neighbours on the grid and knight's moves: headings 27 degrees apart, routes at most 2.8 % longer
MOVES = tuple(
    (i, j)
    for i in range(-2, 3)
    for j in range(-2, 3)
    if max(abs(i), abs(j)) and (math.gcd(i, j) == 1)
)
MAX_SEARCHES = 4  # largest number of searches per route
MAX_COST_RATIO = 2.0  # largest cost of an alternative, relative to the cheapest route


def obstacle_points(layers: Traversability) -> Array:
    """Return a point inside each obstacle, shape (n, 2), in map coordinates [m].

    An obstacle is a connected set of blocked nodes, neither at the border of the map nor smaller in
    both directions than the diameter of the vehicle's circle.
    """
    labels, _ = scipy.ndimage.label(~np.isfinite(layers.least_cost), CORNERS)
    border = {*labels[0], *labels[-1], *labels[:, 0], *labels[:, -1]}
    points = [np.empty((0, 2))]
    for number, box in enumerate(scipy.ndimage.find_objects(labels), 1):
        nodes = [part.stop - part.start for part in box]
        sides = [count * h for count, h in zip(nodes, layers.spacing, strict=True)]
        if number in border or max(sides) < 2 * layers.limits.reach:
            continue
        i, j = np.argwhere(labels[box] == number)[0] + [part.start for part in box]
        points.append(np.array([[layers.x[i], layers.y[j]]]))
    return np.concatenate(points)


def homotopy_class(points: Array, obstacles: Array) -> tuple[int, ...]:
    """Return the homotopy class of a path among paths with the same ends, as a reduced word.

    From each obstacle a ray runs in the positive y direction. A crossing of the ray of obstacle
    ``k``, from 1, adds the letter ``k`` towards positive x, otherwise ``-k``; neighbouring letters
    ``k`` and ``-k`` cancel (Bhattacharya and Ghrist 2017, arXiv:1710.02871, section 2).
    """
    x, y = points[:, :1], points[:, 1:]
    sides = (x >= obstacles[:, 0]).astype(int)  # a vertex on a ray counts as beyond it
    steps, numbers = np.nonzero(np.diff(sides, axis=0))
    ahead = obstacles[numbers, 0] - x[steps, 0]
    part = ahead / (x[steps + 1, 0] - x[steps, 0])
    above = y[steps, 0] + part * (y[steps + 1, 0] - y[steps, 0]) > obstacles[numbers, 1]
    word: list[int] = []
    for k in np.lexsort((part, steps)):
        if not above[k]:
            continue
        toward = sides[steps[k] + 1, numbers[k]] - sides[steps[k], numbers[k]]
        letter = int(toward) * (int(numbers[k]) + 1)
        if word and word[-1] == -letter:
            word.pop()
        else:
            word.append(letter)
    return tuple(word)


def crossed_rays(
    layers: Traversability, points: Array, obstacles: Array
) -> Iterator[tuple[float, Ray]]:
    """Yield each crossed ray of a path, after the distance of the crossing from its obstacle [m].

    The rays are parallel to the axis that is more nearly perpendicular to the line between the
    path's ends. A path that may not cross a ray passes its obstacle on the other side.
    """
    on_path = np.zeros(layers.to_hole.shape, dtype=bool)
    on_path[nodes_at(layers, resample_polyline(points, 0.5 * min(layers.spacing)))] = True
    is_along_y = bool(np.subtract(*np.abs(points[-1] - points[0])) >= 0)
    for x, y in obstacles:
        i, j = node_at(layers, x, y)
        for is_after in (False, True):
            first, column, row = i, slice(i, i + 1), slice(j, j + 1)
            if is_along_y:
                first, row = j, slice(j, None) if is_after else slice(0, j + 1)
            else:
                column = slice(i, None) if is_after else slice(0, i + 1)
            hits = np.flatnonzero(on_path[column, row])
            if hits.size:
                cells = hits[0] if is_after else first - hits[-1]
                yield float(layers.spacing[is_along_y] * cells), (column, row)


def close_rays(layers: Traversability, rays: Iterable[Ray]) -> Traversability:
    """Return a map on which rays are blocked."""
    closed = layers.cost.copy()
    for column, row in rays:
        closed[:, column, row] = math.inf
    return layers._replace(cost=closed)


@with_overview
class Route(NamedTuple):
    """A route over the map.

    Attributes
    ----------
    points : ndarray, shape (n, 2)
        Equally spaced way-points in map coordinates. [m]
    cost : float
        Integral of the map's cost along the route. [m]
    length : float
        Length of the polyline through the way-points. [m]
    """

    points: Array
    cost: float
    length: float


@checked
def route(
    layers: Traversability, start: Point, goal: Point, *, turning_radius: NonNegative = 0.0
) -> Array:
    """Return way-points, shape (n, 2), of the route of least cost from a start to a goal [m].

    Their distance is half the side of the footprint's square (`Limits.half`), or 1/2000 of the
    route's length if that is more. The cubic spline through them (`Path`) avoids blocked nodes if
    possible.
    """
    return routes(layers, start, goal, 1, turning_radius=turning_radius)[0].points


@checked
def routes(
    layers: Traversability,
    start: Point,
    goal: Point,
    count: Count,
    *,
    turning_radius: NonNegative = 0.0,
) -> list[Route]:
    """Return several routes of different homotopy classes, in order of cost.

    The first route is the cheapest. To find an alternative, the search blocks a ray from an
    obstacle to the border that an earlier route crosses; the new route then passes the obstacle on
    the other side. Rays that are crossed near their obstacles are blocked first.

    Parameters
    ----------
    layers, start, goal, turning_radius
        As for `route`.
    count : int
        Largest number of routes. They belong to different homotopy classes: none can be deformed
        into another without crossing an obstacle (`slipfree.routing.search`). Every alternative
        costs at most twice as much as the cheapest route.

    Returns
    -------
    list of Route
        From 1 to ``count`` routes.

    Raises
    ------
    ModelError
        As `route` does, or if the count is not positive.
    """
    for name, point in (("start", start), ("goal", goal)):
        if why := blocking_reasons(layers, *map(float, point)):
            raise ModelError(
                f"route: the vehicle cannot be at the {name} {point_text(point)}: {why}; "
                f"move the {name}"
            )
    if np.array_equal(start, goal):
        raise ModelError(
            f"route: expected different start and goal, found both at "
            f"{point_text(start)}; move one of them"
        )
    ends = np.asarray(start, float), np.asarray(goal, float)
    obstacles = obstacle_points(layers) if count > 1 else np.empty((0, 2))
    by_class: dict[tuple[int, ...], Route] = {}
    pending: list[tuple[float, tuple[Ray, ...]]] = [(0.0, ())]
    for _ in range(MAX_SEARCHES * count):
        if not pending or len(by_class) == count:
            break
        _, closed = pending.pop(0)
        rough = _search(close_rays(layers, closed), *ends)
        if not len(rough):
            if not by_class:
                raise ModelError(f"route: {no_route_words(layers, *ends)}")
            continue
        points = smooth(layers, rough, turning_radius)
        kind = homotopy_class(points, obstacles)
        if kind not in by_class:
            cost = path_cost(layers, points)
            by_class[kind] = Route(points, cost, float(arc_lengths(points)[-1]))
        further = crossed_rays(layers, rough, obstacles)
        pending += [(detour, (*closed, ray)) for detour, ray in further]
        pending.sort(key=itemgetter(0))
    least = min(each.cost for each in by_class.values())
    cheap = [each for each in by_class.values() if each.cost <= MAX_COST_RATIO * least]
    return sorted(cheap, key=attrgetter("cost"))


# Search


def _search(layers: Traversability, start: Array, goal: Array) -> Array:
    """Return the cheapest path on the grid with start and goal, shape (n, 2); empty without [m]."""
    shape = layers.to_hole.shape
    first, last = (
        int(np.ravel_multi_index(node_at(layers, *point), shape)) for point in (start, goal)
    )
    # A move costs its length times the mean cost, in its direction, of its two nodes and of the two
    # nodes that it passes between; it neither cuts a blocked corner nor jumps over a blocked node.
    size, h, width = layers.to_hole.size, layers.spacing, layers.y.size
    weights = np.empty((size, len(MOVES)), dtype=np.float32)
    shifts = np.array([i * width + j for i, j in MOVES], dtype=np.int32)
    for column, (i, j) in enumerate(MOVES):
        cost = layers.cost_toward(math.atan2(-i * h[0], j * h[1]))
        padded = np.pad(cost, 2, constant_values=math.inf).astype(np.float32)
        nodes = [(0, 0), (i, j)]
        if i and j:
            k, n = (i, 0) if abs(i) == abs(j) else (int(i / 2), int(j / 2))
            nodes += [(k, n), (i - k, j - n)]
        rows, columns = shape
        shifted = (padded[2 + k : 2 + k + rows, 2 + n : 2 + n + columns] for k, n in nodes)
        total = reduce(np.add, shifted) * (math.hypot(i * h[0], j * h[1]) / len(nodes))
        weights[:, column] = total.ravel()
    free = np.isfinite(weights)
    ends = np.concatenate([[0], np.cumsum(np.count_nonzero(free, axis=1))])
    targets = (np.arange(size, dtype=np.int32)[:, None] + shifts)[free]
    graph = scipy.sparse.csr_matrix((weights[free].astype(float), targets, ends), (size, size))
    lengths, before = scipy.sparse.csgraph.dijkstra(graph, indices=first, return_predecessors=True)
    if not math.isfinite(lengths[last]):
        return np.empty((0, 2))
    path = [last]
    while path[-1] != first:
        path.append(int(before[path[-1]]))
    at = np.unravel_index(path[::-1], shape)
    inner = np.stack([layers.x[at[0]], layers.y[at[1]]], axis=1)
    points = np.concatenate([[start], inner, [goal]])
    fresh = np.concatenate([[True], np.any(np.diff(points, axis=0) != 0, axis=1)])
    return np.asarray(points[fresh])


REMEDIES = {"edge": "use a larger map", "keep_out": "make the keep-out region smaller"}
Ends = tuple[tuple[int, int], tuple[int, int]]  # nodes


def unreachable(
    layers: Traversability, positions: Sequence[tuple[str, float, float]]
) -> dict[str, str]:
    """Return why named positions, the first of which is the start, cannot be part of a motion.

    Texts have numbers and a remedy.

    Positions are off the map or within reach of a keep-out region, or such regions separate them
    from the start. No other reason is sure: a route requires space for every heading, a motion does
    not.
    """
    objections = dict[str, str]()
    for name, x, y in positions:
        reasons = reasons_by_kind(layers, x, y)
        is_off = to_edge(layers.limits, np.asarray(x), np.asarray(y)) < 0
        found = {kind: reasons[kind] for kind in REMEDIES if kind in reasons}
        if not is_off:
            found.pop("edge", None)
        if found:
            remedies = " or ".join([f"move the {name}", *(REMEDIES[kind] for kind in found)])
            words = f"the vehicle cannot be at the {name} {point_text((x, y))}: "
            objections[name] = f"{words}{'; '.join(found.values())}; {remedies}"
    first, *others = positions
    if first[0] in objections:
        return objections
    for name, x, y in others:
        if name not in objections and (why := _keep_out_words(layers, first[1:], (x, y))):
            words = f"the {name} {point_text((x, y))} cannot be reached from the {first[0]} "
            objections[name] = f"{words}{point_text(first[1:])}: {why}"
    return objections


def unheld_words(terrain: Bicubic, vehicle: Vehicle, x: float, y: float) -> str:
    """Return a text if friction certainly holds the vehicle at no heading at a point; else empty.

    Poses are computed only where the mean slope of the ground exceeds the friction.
    """
    if terrain.mu is None or not vehicle.mass:
        return ""
    half = extents(vehicle)[2] / 2
    ends = terrain.elevation(x + half * np.array([1, -1, 0, 0]), y + half * np.array([0, 0, 1, -1]))
    slope = np.hypot(*(ends[::2] - ends[1::2])) / (2 * half)
    grip = max(wheel.grip for wheel in vehicle.wheels)
    limit = float(terrain.mu) * grip if isinstance(terrain.mu, float | int) else 0.0
    if slope <= limit:
        return ""
    model = direct_kinematics(vehicle, terrain)
    poses = atlas(model, headings=HEADINGS, x=np.array([x]), y=np.array([y]), compiled=False)
    bounds = least_bounds(poses)
    if bounds is None or not poses.stands.any():
        return ""
    factor = float(np.nanmin(poses[bounds[0].name])) / (limit or 1.0)
    return more_friction_words(factor) if factor > 1 else ""


def no_route_words(layers: Traversability, start: Array, goal: Array) -> str:
    """Return the text of an error for a goal that cannot be reached."""
    regions = _labels(np.isfinite(layers.least_cost))
    i, j = np.nonzero(regions == regions[node_at(layers, *start)])
    gaps = np.hypot(layers.x[i] - goal[0], layers.y[j] - goal[1])
    best = int(gaps.argmin())
    nearest = np.array([layers.x[i[best]], layers.y[j[best]]])
    ahead = resample_polyline(np.stack([nearest, goal]), 0.5 * min(layers.spacing))
    why = next((w for w in (blocking_reasons(layers, *point) for point in ahead.tolist()) if w), "")
    return (
        f"no route leads from {point_text(start)} to {point_text(goal)}: the ground that can be "
        f"reached ends at {point_text(nearest)}, {gaps[best]:.3g} m from the goal"
        + (f"; beyond it: {why}" if why else "")
        + "; move the start or the goal"
    )


def separation_words(layers: Traversability, places: Sequence[Point], *, by_friction: bool) -> str:
    """Return where the ground that can be reached ends between places; empty if it connects them.

    Blocked are poses that friction does not hold, or else only positions where in some heading a
    wheel could reach over the edge of the map, into a hole or into a keep-out region.
    """
    if len(places) < 2:
        return ""
    blocked = layers.cost >= SLIDING
    if not by_friction:
        blocked = np.logical_or.reduce([*out_of_bounds(layers).values()])[None]
    held = layers._replace(cost=np.where(blocked, np.inf, layers.cost))
    regions = _labels(np.isfinite(held.least_cost))
    for start, goal in pairwise(np.asarray(places)):
        if regions[node_at(held, *start)] != regions[node_at(held, *goal)]:
            return no_route_words(held, start, goal)
    return ""


def _keep_out_words(layers: Traversability, start: Point, goal: Point) -> str:
    """Return which keep-out regions separate start and goal; empty if they do not.

    Without any of these regions, the others do not separate them.
    """
    ends, barrier = (node_at(layers, *start), node_at(layers, *goal)), layers.limits.keep_out
    if not (barrier and _divides(layers, barrier, ends)):
        return ""
    for region in barrier:
        rest = tuple(other for other in barrier if other is not region)
        barrier = rest if rest and _divides(layers, rest, ends) else barrier
    words = " and ".join(region.words for region in barrier)
    verb, one = ("together separate", "one") if barrier[1:] else ("separates", "it")
    return f"the keep-out {words} {verb} them; make {one} smaller or move it"


def _divides(layers: Traversability, regions: tuple[Region, ...], ends: Ends) -> bool:
    """Return whether keep-out regions separate two nodes."""
    limits = layers.limits._replace(keep_out=regions)
    free = ~out_of_bounds(layers._replace(limits=limits))["keep_out"]
    free[ends[0]] = free[ends[1]] = True
    labels = _labels(free)
    return bool(labels[ends[0]] != labels[ends[1]])


def _labels(free: Mask) -> Array:
    """Return labels of the connected regions of free nodes, from 1; 0 for blocked nodes."""
    return np.asarray(scipy.ndimage.label(free)[0])
