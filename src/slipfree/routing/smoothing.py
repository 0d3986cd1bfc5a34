"""Smoothing of routes: low cost, clearance from blocked nodes, bounded curvature."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import scipy

from slipfree.core.records import Array, Mask
from slipfree.geometry.path import Path
from slipfree.routing.traversability import (
    Traversability,
    axis_step,
    nearest_headings,
    nodes_at,
    window,
)

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
    step = max(0.25 * layers.limits.half, polyline_length(rough) / MAX_POINTS)
    half = max(layers.limits.half, step)
    field = _field(layers, rough, turning_radius)
    sharpest = 1 / turning_radius if turning_radius else math.inf
    dearest = DEARER * path_cost(layers, rough)
    points, best, least = resample_polyline(rough, step), None, math.inf
    for weight in PENALTIES:
        clear = CLEARANCE * max(layers.spacing)
        aim = _Objective(half, clear, sharpest, weight, polyline_length(points) / (len(points) - 1))
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
    ends = np.append(0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
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
    return float(total), gradient, _banded(hessians, len(p))


def _outer_squares(vectors: Array) -> Array:
    """Return the outer product of each vector with itself, shape (n, 2, 2)."""
    return np.asarray(vectors[:, :, None] * vectors[:, None, :])


def _banded(terms: Iterable[tuple[Array, Array]], count: int) -> Array:
    """Return the Hessian of the inner points in upper banded form, shape (6, 2 count - 4)."""
    blocks = np.zeros((3, count, 2, 2))  # blocks[o, k] couples point k to point k + o
    for weights, part in terms:
        for a in range(len(weights)):
            for b in range(a, len(weights)):
                blocks[b - a, a : a + len(part)] += weights[a] * weights[b] * part
    inner = count - 2
    bands = np.zeros((6, 2 * inner))
    for o, c, d in np.ndindex(3, 2, 2):
        if 2 * o + d >= c:
            # The diagonal is the last of the six rows, as LAPACK requires.
            bands[5 - (2 * o + d - c), 2 * o + d :: 2] = blocks[o, 1 : 1 + inner - o, c, d]
    return bands


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


def polyline_length(points: Array) -> float:
    """Return the length of a polyline [m]."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def resample_polyline(points: Array, step: float, *, spline: bool = False) -> Array:
    """Return equally spaced points along a polyline or the spline through its points.

    They have the same ends and are about ``step`` apart.
    """
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    at = np.concatenate([[0], np.cumsum(gaps)])
    count = max(round(float(at[-1]) / step), 1)
    s = np.linspace(0, at[-1], count + 1)
    if spline:
        from scipy.interpolate import CubicSpline  # imported here: the import takes 0.2 s

        even = np.asarray(CubicSpline(at, points - points[0])(s) + points[0])
    else:
        even = np.stack([np.interp(s, at, column) for column in points.T], axis=1)
    even[0], even[-1] = points[0], points[-1]
    return even
