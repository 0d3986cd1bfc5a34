"""Homotopy classes of routes with respect to the obstacles of a map."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np
import scipy

from slipfree.core.records import Array
from slipfree.routing.smoothing import resample_polyline
from slipfree.routing.traversability import Traversability, node_at, nodes_at

Ray = tuple[slice, slice]  # nodes from an obstacle to the border of the map, along an axis
CORNERS = np.ones((3, 3), dtype=int)  # no move passes between nodes that touch at a corner


def obstacle_points(layers: Traversability) -> Array:
    """Return a point inside each obstacle, shape (n, 2), in map coordinates [m].

    An obstacle is a connected set of blocked nodes. The result omits obstacles that reach the
    border of the map, around which no route leads, and obstacles whose bounding box is smaller in
    both directions than the diameter of the vehicle's circle.
    """
    labels, _ = scipy.ndimage.label(~np.isfinite(layers.cost), CORNERS)
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
    """Return the homotopy class of a path among paths with the same ends.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Vertices of a polyline. [m]
    obstacles : ndarray, shape (m, 2)
        A point inside each obstacle. [m]

    Returns
    -------
    tuple of int
        Reduced word of the path. From each obstacle a ray runs in the positive y direction. A
        crossing of the ray of obstacle ``k``, counted from 1, adds the letter ``k`` if the path
        runs towards positive x there, otherwise ``-k``; neighbouring letters ``k`` and ``-k``
        cancel. Two paths with the same ends that pass through no obstacle can be deformed into
        each other without crossing an obstacle if and only if their words are equal.

    References
    ----------
    S. Bhattacharya and R. Ghrist, "Path homotopy invariants and their application to optimal
    trajectory planning", 2017, arXiv:1710.02871, section 2.
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
    on_path = np.zeros(layers.cost.shape, dtype=bool)
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


def close_rays(cost: Array, rays: Iterable[Ray]) -> Array:
    """Return the costs of a map on which rays are blocked."""
    closed = cost.copy()
    for ray in rays:
        closed[ray] = math.inf
    return closed
