"""Routes over a large map: paths of least cost between two positions, and their homotopy classes.

A route is an initial guess of a plan, not a plan. Before it is computed, it is checked whether its
positions can be reached on the map.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from operator import attrgetter, itemgetter
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from slipfree.atlas.atlas import atlas, least_bounds
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Mask, with_overview
from slipfree.geometry.regions import Region
from slipfree.models.kinematics import direct_kinematics
from slipfree.routing.smoothing import path_cost, polyline_length, resample_polyline, smooth
from slipfree.routing.traversability import (
    HEADINGS,
    SLIDING,
    Point,
    Traversability,
    blocking_reasons,
    extents,
    more_friction_words,
    node_at,
    nodes_at,
    out_of_bounds,
    point_text,
    reasons_by_kind,
    to_edge,
)
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.tree import Vehicle

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


def route(
    layers: Traversability, start: Point, goal: Point, *, turning_radius: float = 0.0
) -> Array:
    """Return way-points, shape (n, 2), of the route of least cost from a start to a goal [m].

    Their distance is half the side of the footprint's square (`Limits.half`), or 1/2000 of the
    route's length if that is more. The cubic spline through them (`Path`) avoids blocked nodes if
    possible.
    """
    return routes(layers, start, goal, 1, turning_radius=turning_radius)[0].points


def routes(
    layers: Traversability, start: Point, goal: Point, count: int, *, turning_radius: float = 0.0
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
    if count < 1:
        raise ModelError(f"routes: expected a count of at least 1, found {count}; increase it")
    _check_ends(layers, start, goal, turning_radius)
    ends = np.asarray(start, float), np.asarray(goal, float)
    obstacles = obstacle_points(layers)
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
            by_class[kind] = Route(points, cost, polyline_length(points))
        further = crossed_rays(layers, rough, obstacles)
        pending += [(detour, (*closed, ray)) for detour, ray in further]
        pending.sort(key=itemgetter(0))
    least = min(each.cost for each in by_class.values())
    cheap = [each for each in by_class.values() if each.cost <= MAX_COST_RATIO * least]
    return sorted(cheap, key=attrgetter("cost"))


# Search


def _check_ends(layers: Traversability, start: Point, goal: Point, turning_radius: float) -> None:
    for name, point in (("start", start), ("goal", goal)):
        x, y = (float(each) for each in point)
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ModelError(
                f"route: expected finite coordinates of the {name}, found {point_text(point)}; "
                "correct them"
            )
        why = blocking_reasons(layers, x, y)
        if why:
            raise ModelError(
                f"route: the vehicle cannot be at the {name} {point_text(point)}: {why}; "
                f"move the {name}"
            )
    if np.array_equal(start, goal):
        raise ModelError(
            f"route: expected different start and goal, found both at "
            f"{point_text(start)}; move one of them"
        )
    if not 0 <= turning_radius < math.inf:
        raise ModelError(
            "route: expected a finite 'turning_radius' of at least 0, found "
            f"{turning_radius} m; give 0 for no minimum"
        )


def _search(layers: Traversability, start: Array, goal: Array) -> Array:
    """Return the cheapest path on the grid with start and goal, shape (n, 2); empty without [m]."""
    shape = layers.to_hole.shape
    first, last = (
        int(np.ravel_multi_index(node_at(layers, *point), shape)) for point in (start, goal)
    )
    lengths, before = scipy.sparse.csgraph.dijkstra(
        _graph(layers), indices=first, return_predecessors=True
    )
    if not math.isfinite(lengths[last]):
        return np.empty((0, 2))
    nodes = [last]
    while nodes[-1] != first:
        nodes.append(int(before[nodes[-1]]))
    i, j = np.unravel_index(nodes[::-1], shape)
    inner = np.stack([layers.x[i], layers.y[j]], axis=1)
    points = np.concatenate([[start], inner, [goal]])
    fresh = np.concatenate([[True], np.any(np.diff(points, axis=0) != 0, axis=1)])
    return np.asarray(points[fresh])


def _graph(layers: Traversability) -> scipy.sparse.csr_matrix:
    """Return the costs of moves between free nodes, shape (n_x n_y, n_x n_y) [m].

    A move costs its length times the mean cost, in its direction, of its two nodes and of the two
    nodes that it passes between; it neither cuts a blocked corner nor jumps over a blocked node.
    """
    size, h, width = layers.to_hole.size, layers.spacing, layers.y.size
    weights = np.empty((size, len(MOVES)), dtype=np.float32)
    shifts = np.array([i * width + j for i, j in MOVES], dtype=np.int32)
    for column, (i, j) in enumerate(MOVES):
        cost = layers.cost_toward(math.atan2(-i * h[0], j * h[1]))
        padded = np.pad(cost, 2, constant_values=math.inf).astype(np.float32)
        passed = _passed(i, j)
        total = _shifted(padded, 0, 0) + _shifted(padded, i, j)
        for each in passed:
            total = total + _shifted(padded, *each)
        weights[:, column] = (total * (math.hypot(i * h[0], j * h[1]) / (2 + len(passed)))).ravel()
    free = np.isfinite(weights)
    ends = np.concatenate([[0], np.cumsum(np.count_nonzero(free, axis=1))])
    targets = (np.arange(size, dtype=np.int32)[:, None] + shifts)[free]
    return scipy.sparse.csr_matrix((weights[free].astype(float), targets, ends), shape=(size, size))


def _passed(i: int, j: int) -> tuple[tuple[int, int], ...]:
    """Return the two nodes between which a move passes, relative to its start; none if straight."""
    if 0 in (i, j):
        return ()
    if abs(i) == abs(j):
        return (i, 0), (0, j)
    half = (i // 2, 0) if abs(i) == 2 else (0, j // 2)
    return half, (i - half[0], j - half[1])


def _shifted(padded: npt.NDArray[np.float32], i: int, j: int) -> npt.NDArray[np.float32]:
    rows, columns = padded.shape
    return padded[2 + i : rows - 2 + i, 2 + j : columns - 2 + j]


REMEDIES = {
    "edge": "use a larger map",
    "keep_out": "make the keep-out region smaller",
}
Ends = tuple[tuple[int, int], tuple[int, int]]  # nodes


class Objection(NamedTuple):
    """Reason why a position cannot be part of a motion."""

    name: str  # name of the position, such as ``"goal"``
    words: str  # the reason with numbers, and a remedy


def unreachable(
    layers: Traversability, positions: Sequence[tuple[str, float, float]]
) -> list[Objection]:
    """Return the objections to named positions, the first of which is the start.

    Positions are off the map or within reach of a keep-out region, or such regions separate them
    from the start. No other reason is sure: a route requires space for every heading, a motion does
    not.
    """
    objections = [
        each for position in positions if (each := _position_objection(layers, *position))
    ]
    off = {each.name for each in objections}
    first, *others = positions
    if first[0] in off:
        return objections
    for name, x, y in others:
        if name not in off and (why := _keep_out_words(layers, first[1:], (x, y))):
            words = (
                f"the {name} {point_text((x, y))} cannot be reached from the {first[0]} "
                f"{point_text(first[1:])}: {why}"
            )
            objections.append(Objection(name, words))
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


def _position_objection(layers: Traversability, name: str, x: float, y: float) -> Objection | None:
    """Return the reason why the vehicle cannot be at a position, or None."""
    is_off = to_edge(layers.limits, np.asarray(x), np.asarray(y)) < 0
    kinds = ("edge", "keep_out") if is_off else ("keep_out",)
    reasons = reasons_by_kind(layers, x, y)
    why = {kind: reasons[kind] for kind in kinds if kind in reasons}
    if not why:
        return None
    remedies = " or ".join([f"move the {name}", *(REMEDIES[kind] for kind in why)])
    place = point_text((x, y))
    words = f"the vehicle cannot be at the {name} {place}: {'; '.join(why.values())}; {remedies}"
    return Objection(name, words)


def _keep_out_words(layers: Traversability, start: Point, goal: Point) -> str:
    """Return which keep-out regions separate start and goal; empty if they do not."""
    ends = node_at(layers, *start), node_at(layers, *goal)
    regions = layers.limits.keep_out
    if not _divides(layers, regions, ends):
        return ""
    alone = [region for region in regions if _divides(layers, (region,), ends)]
    if alone:
        words = " and ".join(region.words for region in alone)
        if len(alone) > 1:
            return (
                f"each of the keep-out regions {words} separates them; make these regions smaller "
                "or move them"
            )
        return (
            f"the keep-out {words} lies between them, and no route leads around it; make "
            "it smaller or move it"
        )
    needed = [
        region
        for region in regions
        if not _divides(layers, tuple(other for other in regions if other is not region), ends)
    ]
    words = ", ".join(region.words for region in needed or regions)
    return f"several keep-out regions together separate them: {words}; make one smaller or move it"


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
