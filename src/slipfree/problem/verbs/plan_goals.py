"""Start, way-points, goal, keep-out regions and routes of a planning problem."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.files.toml.source import ProblemError
from slipfree.geometry.regions import Region
from slipfree.problem.build_common import heading_offset
from slipfree.problem.build_driver import path_points
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem, S
from slipfree.problem.region_table import region_of
from slipfree.problem.verbs.plan_schema import GuideTable, PlanKeys
from slipfree.routing.search import route, routes
from slipfree.routing.traversability import Traversability

Place = tuple[str, float, float]
Ranges = dict[str, tuple[float, float]]
Domain = tuple[float, float, float, float]


def places_of(
    problem: Problem[S], spec: PlanKeys, between: Mapping[float, Ranges], domain: Domain
) -> tuple[tuple[Place, ...], set[str]]:
    """Return start, way-points and goal in map coordinates [m], and the names of exact points.

    An exact point has values for x and y, not ranges. A range is represented by the middle of its
    part on the map. Way-points and goals without x and y are omitted.

    Raises
    ------
    ProblemError
        If x or y of a way-point or of the goal is off the map.
    """
    places = [("start", spec.start.get("x", 0.0), spec.start.get("y", 0.0))]
    exact = {"start"}
    named = [(f"way-point at {part:g}", wanted) for part, wanted in between.items()]
    for name, wanted in (*named, ("goal", spec.goal)):
        at = {}
        for axis, low, high in (("x", *domain[:2]), ("y", *domain[2:])):
            if axis not in wanted:
                continue
            least, most = max(wanted[axis][0], low), min(wanted[axis][1], high)
            if least > most:
                where = problem.source.where((key_of(name),))
                raise ProblemError(
                    f"{where}: expected a {name} on the map, which extends from {low:.10g} to "
                    f"{high:.10g} m in {axis}, found {axis} = {spelled(wanted[axis])} m; "
                    f"move the {name}"
                )
            at[axis] = (least + most) / 2
        if len(at) == 2:
            places.append((name, at["x"], at["y"]))
            if all(wanted[axis][0] == wanted[axis][1] for axis in at):
                exact.add(name)
    return tuple(places), exact


def key_of(place: str) -> str:
    """Return the key of a problem file for the name of a start, way-point or goal."""
    return place if place in ("start", "goal") else "way_points"


def way_points_of(problem: Problem[S], spec: PlanKeys) -> dict[float, Ranges]:
    """Return the ranges of quantities at the way-points, by fraction of the duration.

    Raises
    ------
    ProblemError
        If the key ``at`` of a way-point is missing, a range, or not between 0 and 1 (exclusive), or
        if two way-points have the same fraction.
    """
    found: dict[float, Ranges] = {}
    for index, each in enumerate(spec.way_points):
        wanted = dict(each)
        with at(problem, ("way_points", index)):
            if "at" not in wanted:
                raise ModelError(
                    "way_points: expected the key 'at', a fraction of the duration, found none; "
                    "add it"
                )
            low, high = wanted.pop("at")
            if not 0 < low == high < 1:
                raise ModelError(
                    "way_points: expected one number for 'at', greater than 0 and less than 1, "
                    f"found {spelled((low, high))}; correct this fraction of the duration"
                )
            if low in found:
                raise ModelError(
                    f"way_points: expected at most one way-point at {low:g}, found two; put their "
                    "values into one table"
                )
            found[low] = wanted
    return dict(sorted(found.items()))


def initial_paths(
    problem: Problem[S], spec: PlanKeys, layers: Traversability, places: tuple[Place, ...]
) -> tuple[Array, ...]:
    """Return the paths of the initial guesses: given paths, or routes over the ground.

    Raises
    ------
    ProblemError
        If the keys of the driver contradict each other, a file cannot be read, the goal has no
        position, several routes are requested with way-points, or there is no route.
    """
    driver = spec.driver
    if driver is None or driver.name in ("straight", "reeds-shepp"):
        return ()
    if driver.name == "follow":
        with at(problem, ("driver",)):
            if driver.paths is None:
                return (path_points(problem, driver),)
            if driver.path is not None or driver.file is not None:
                raise ModelError(
                    "driver: expected one of 'path', 'paths' and 'file', found several of them; "
                    "keep one"
                )
            return tuple(np.array(path) for path in driver.paths)
    _check_goal_place(problem, places)
    return _routes(problem, spec, driver, layers, [np.array(place[1:]) for place in places])


def _check_goal_place(problem: Problem[Any], places: tuple[Place, ...]) -> None:
    """Raise ProblemError if the goal does not have both x and y."""
    if places[-1][0] != "goal":
        where, goal = problem.source.where(("goal",)), problem.spec.goal
        missing = " and ".join(name for name in ("x", "y") if name not in goal)
        raise ProblemError(
            f"{where}: expected values for x and y, which the driver needs, found "
            f"{'only ' if goal else ''}{', '.join(goal) or 'none'}; add {missing}"
        )


def cusp_goal(
    problem: Problem[S], spec: PlanKeys, driver: GuideTable, places: tuple[Place, ...]
) -> tuple[float, float, float | None]:
    """Return x, y [m] and heading of the goal, None without heading, for a path with cusps.

    The heading is measured from the y axis. [rad]

    Raises
    ------
    ProblemError
        If the goal has no position.
    ModelError
        If way-points have x and y, the speed is negative, or keys of other drivers are given.
    """
    _check_goal_place(problem, places)
    if len(places) > 2:
        raise ModelError(
            "driver: expected way-points without x and y for name = 'reeds-shepp', found "
            f"{len(places) - 2} with them; remove x and y from [[way_points]]"
        )
    if driver.speed < 0:
        raise ModelError(
            "driver: expected a positive speed with name = 'reeds-shepp', which chooses the gears, "
            f"found {driver.speed:g} m/s; change its sign"
        )
    if driver.path or driver.file or driver.paths or driver.count > 1:
        others = [key for key in ("path", "file", "paths") if getattr(driver, key)]
        others += ["count"] if driver.count > 1 else []
        raise ModelError(
            "driver: expected only 'speed' and 'turning_radius' with name = 'reeds-shepp', found "
            f"also {', '.join(map(repr, others))}; remove {'it' if len(others) == 1 else 'them'}"
        )
    _, x, y = places[-1]
    heading = spec.goal.get("heading")
    return x, y, None if heading is None else sum(heading) / 2 + heading_offset(problem)


def _routes(
    problem: Problem[S],
    spec: PlanKeys,
    driver: GuideTable,
    layers: Traversability,
    places: list[Array],
) -> tuple[Array, ...]:
    """Return the points of routes from start to goal; of one route if there are way-points.

    Raises
    ------
    ProblemError
        If there is no route, or several routes are requested with way-points.
    """
    with at(problem, ("driver",)):
        if len(places) == 2:
            count = max(driver.count, spec.plan.starts)
            found = routes(
                layers, places[0], places[1], count, turning_radius=driver.turning_radius
            )
            return tuple(path.points for path in found)
        if driver.count > 1:
            raise ModelError(
                f"driver: expected count = 1 with way-points, found {driver.count}; set count = 1, "
                "or remove the way-points"
            )
        legs = [
            route(layers, first, second, turning_radius=driver.turning_radius)
            for first, second in pairwise(places)
        ]
        return (np.concatenate([legs[0], *(leg[1:] for leg in legs[1:])]),)


def regions(problem: Problem[S], spec: PlanKeys) -> tuple[Region, ...]:
    """Return the keep-out regions of a problem.

    Raises
    ------
    ProblemError
        If a region is neither a disc nor a valid polygon.
    """
    found: list[Region] = []
    for index, each in enumerate(spec.keep_out):
        with at(problem, ("keep_out", index)):
            found.append(region_of(each))
    return tuple(found)


def spelled(bounds: tuple[float, float]) -> str:
    """Return the text of a range, or of a value if both bounds are equal."""
    low, high = bounds
    return f"{low:.10g}" if low == high else f"{low:.10g} to {high:.10g}"
