"""Smooth ways near a rough one, over a map of costs: cheap, clear of what is blocked, not sharp."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.linalg import solveh_banded

from slipfree.geometry.path import Path
from slipfree.records import Array, Mask
from slipfree.routing.traversability import Traversability, nodes_at, window

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


def smooth(layers: Traversability, rough: Array, turning_radius: float) -> Array:
    """Return a smooth way near a rough one; the rough one if there is no room for smoothness.

    Parameters
    ----------
    layers : Traversability
        The map.
    rough : ndarray, shape (n, 2)
        The way of a search over its nodes. [m]
    turning_radius : float
        Smallest radius of a turn, as far as there is room for it. [m]

    Returns
    -------
    ndarray, shape (m, 2)
        Way-points as `slipfree.routing.search.route` returns them. [m]
    """
    step = max(0.25 * layers.limits.half, way_length(rough) / POINTS)
    half = max(layers.limits.half, step)
    field = _field(layers, rough, turning_radius)
    sharpest = 1 / turning_radius if turning_radius else math.inf
    points, best, least = evenly(rough, step), None, math.inf
    for weight in FIRM:
        clear = CLEAR * max(layers.spacing)
        aim = _Aim(half, clear, sharpest, weight, way_length(points) / (len(points) - 1))
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
        candidate = evenly(rough, spacing)
        if _judged(layers, candidate)[0]:
            return candidate
    return rough


def _judged(layers: Traversability, points: Array) -> tuple[bool, float]:
    """Return whether the path through points is free, and its largest curvature [1/m]."""
    path = Path(points)
    count = math.ceil(path.length / (GRAZE * min(layers.spacing)))
    place = path.at(np.linspace(0, path.length, count + 1))
    i, j = nodes_at(layers, np.stack([place.x, place.y], axis=1))
    return bool(np.isfinite(layers.cost[i, j]).all()), float(np.abs(place.curvature).max())


def _field(layers: Traversability, rough: Array, turning_radius: float) -> _Field:
    """Return the part of the map that smoothing can get to."""
    (x_min, y_min), (x_max, y_max) = rough.min(axis=0), rough.max(axis=0)
    room = 2 * turning_radius + 4 * layers.limits.half + 4 * max(layers.spacing)
    part = window(layers, (float(x_min), float(x_max), float(y_min), float(y_max)), room)
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
        (
            EDGE,
            (cost / length)[:, None, None] * (np.eye(2) - _squares(along))
            + 2 / aim.step * _squares(along),
        ),
        (BEND / aim.step**2, stiff * np.eye(2) + sharp),
    )
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


# Lines


def way_length(points: Array) -> float:
    """Return the length of the straight lines between points [m]."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def evenly(points: Array, step: float) -> Array:
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
    from scipy.interpolate import CubicSpline  # imported where it is used: it takes 0.2 s

    gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    at = np.concatenate([[0], np.cumsum(gaps)])
    count = max(round(float(at[-1]) / step), 1)
    even = np.asarray(CubicSpline(at, points - points[0])(np.linspace(0, at[-1], count + 1)))
    even += points[0]
    even[0], even[-1] = points[0], points[-1]
    return even
