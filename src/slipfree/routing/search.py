"""Routes over a large map: the cheapest ways from one place to another.

A route is a start for a plan, not a plan.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import ndimage
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from slipfree.errors import ModelError
from slipfree.records import Array, field_overview
from slipfree.routing.reachability import no_way
from slipfree.routing.smoothing import evenly, smooth, way_length
from slipfree.routing.traversability import (
    Point,
    Traversability,
    node_at,
    nodes_at,
    placed,
    reasons,
)

# Neighbours on the grid and the knight's moves: headings 27 degrees apart, ways at most 2.8 % long.
MOVES = tuple(
    (i, j)
    for i in range(-2, 3)
    for j in range(-2, 3)
    if max(abs(i), abs(j)) and (math.gcd(i, j) == 1)
)

DEEPER = 4.0  # factor on the cost of an earlier route's surroundings when the next one is sought
TRIES = 4  # how often in a row a route may be none that is new
WIDE = 0.1  # half width of these surroundings, as a part of the distance to go
LONGEST = 2.0  # cost of an alternative over the cheapest route's beyond which it is none


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

    def __repr__(self) -> str:
        return field_overview(self)


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
    return smooth(layers, rough, turning_radius)


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
    failed = 0
    while len(found) < count and failed < TRIES:
        # Smoothed at the raised cost too: else it would go back to the route next to it.
        raised = layers._replace(cost=layers.cost * (1 + DEEPER * near))
        rough = _search(layers, raised.cost, *ends)
        points = smooth(raised, rough, turning_radius)
        new = Route(points, _integral(layers, points), way_length(points))
        is_new = _is_another(layers, new, found)
        found += [new] if is_new else []
        failed = 0 if is_new else failed + 1
        near += _surroundings(layers, rough, *ends)
    return sorted(found, key=lambda each: each.cost)


# Search


def _check_question(
    layers: Traversability, start: Point, goal: Point, turning_radius: float
) -> None:
    """Refuse ends where the vehicle cannot be, and what is no turning radius."""
    for name, point in (("start", start), ("goal", goal)):
        x, y = (float(each) for each in point)
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ModelError(f"route: the {name} must be finite, found {placed(point)}")
        why = reasons(layers, x, y)
        if why:
            raise ModelError(f"route: the vehicle cannot be at the {name} {placed(point)}: {why}")
    if np.array_equal(start, goal):
        raise ModelError(f"route: start and goal coincide at {placed(start)}")
    if not 0 <= turning_radius < math.inf:
        raise ModelError(
            f"route: turning_radius must be zero or more metres, found {turning_radius}"
        )


def _search(layers: Traversability, cost: Array, start: Array, goal: Array) -> Array:
    """Return the cheapest way along the grid: start, nodes, goal. Shape (n, 2) [m]."""
    first, last = (
        int(np.ravel_multi_index(node_at(layers, *point), cost.shape)) for point in (start, goal)
    )
    lengths, before = dijkstra(
        _graph(cost, layers.spacing), indices=first, return_predecessors=True
    )
    if not math.isfinite(lengths[last]):
        reached = np.isfinite(lengths).reshape(cost.shape)
        raise ModelError(f"route: {no_way(layers, reached, start, goal)}")
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


# Several


def _is_another(layers: Traversability, new: Route, found: Sequence[Route]) -> bool:
    """Return whether a route leaves all earlier ones by a vehicle's width, at a bearable cost."""
    fine, width = 0.25 * layers.limits.half, 2 * layers.limits.reach
    for old in found:
        gaps, _ = cKDTree(evenly(old.points, fine)).query(evenly(new.points, fine))
        if gaps.max() <= width:
            return False
    return not found or new.cost <= LONGEST * min(each.cost for each in found)


def _surroundings(layers: Traversability, points: Array, start: Array, goal: Array) -> Array:
    """Return how near nodes are to a route: one on it, falling to zero; zero at its ends [1]."""
    width = max(2 * layers.limits.reach, WIDE * float(np.linalg.norm(goal - start)))
    off = np.ones(layers.cost.shape, dtype=bool)
    off[nodes_at(layers, evenly(points, 0.5 * min(layers.spacing)))] = False
    near = np.exp(-((ndimage.distance_transform_edt(off, sampling=layers.spacing) / width) ** 2))
    for end in (start, goal):  # all routes have their ends in common
        away = np.hypot(layers.x[:, None] - end[0], layers.y[None, :] - end[1])
        near *= np.minimum(away / (2 * width), 1)
    return np.asarray(near)


def _integral(layers: Traversability, points: Array) -> float:
    """Return the integral of the cost along a line; the cost of the nearest nodes [m]."""
    dense = evenly(points, 0.25 * min(layers.spacing))
    middle = 0.5 * (dense[1:] + dense[:-1])
    return float(
        layers.cost[nodes_at(layers, middle)] @ np.linalg.norm(np.diff(dense, axis=0), axis=1)
    )
