"""Keys of the problems with ``verb = "plan"``, and their goals, costs and limits."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.files.toml.source import Fault, ProblemError
from slipfree.files.toml.types import (
    NonNegative,
    Pair,
    PiecewiseConstant,
    Positive,
    Quantity,
    Range,
    Record,
    record_of,
)
from slipfree.geometry.regions import Region
from slipfree.plan.guess import ground_routes, on_map
from slipfree.plan.problem import spelled
from slipfree.plan.search import Search
from slipfree.plan.transcription import SAMPLE_STEP, Mesh
from slipfree.problem.build import check_without_path, path_points
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem
from slipfree.problem.schema import (
    INPUTS,
    STEP_CLIMBING,
    VERB,
    ClimbingDriver,
    HeightErrors,
    Modelled,
    RegionTable,
    Time,
    region_of,
)
from slipfree.routing.traversability import Traversability

OVERLAP = 1 / 3  # default overlap, relative to the window
MAX_INTERVALS = 2000  # a plan with more needs gigabytes and hours; windows divide it

GuideName = Literal["straight", "follow", "route", "reeds-shepp", "step-climbing"]


class GuideTable(ClimbingDriver):
    """Initial guess of a plan: a driving law along paths or along routes over the ground."""

    name: GuideName = Field(  # type: ignore[assignment]
        description="law; 'route': follow a path that a search finds on the map; 'reeds-shepp': "
        "drive forwards and backwards along the shortest path of a car on even ground; "
        "'step-climbing': plan of a step climber over solids"
    )
    turning_radius: NonNegative | None = Field(
        default=None,
        description="smallest turning radius of a route, or of the shortest path of a car; "
        "default: that of the driving law [m]",
    )
    paths: Annotated[
        tuple[Annotated[tuple[Pair, ...], Field(strict=False)], ...] | None,
        Field(strict=False, min_length=1),
    ] = Field(
        default=None,
        description="several paths of way-points; the plan of least cost is returned [m]",
    )
    count: Annotated[int, Field(ge=1, le=100)] = Field(
        default=1,
        description="number of routes, which pass obstacles on different sides; the plan of least "
        "cost is returned",
    )


class KeepOut(RegionTable):
    """A region that no wheel may touch: a disc or a polygon."""

    longitude: float | None = Field(default=None, description="longitude, instead of x [deg]")
    latitude: float | None = Field(default=None, description="latitude, instead of y [deg]")


class Robust(Record):
    """Random worlds in which a plan is simulated, and the share in which its limits must hold."""

    share: Annotated[float, Field(gt=0, lt=1)] = Field(
        default=0.95, description="share of draws for which the plan must satisfy its limits [1]"
    )
    draws: Annotated[int, Field(ge=1, le=100_000)] = Field(
        default=50, description="number of draws that determine the tightening of a round"
    )
    final_draws: Annotated[int, Field(ge=1, le=100_000)] = Field(
        default=200, description="number of further draws, which determine the final share"
    )
    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="seed of all draws")
    map: HeightErrors | None = Field(default=None, description="errors of the heights of the map")
    friction: NonNegative = Field(
        default=0.0, description="relative standard deviation of the friction of the ground [1]"
    )
    inputs: NonNegative = Field(
        default=0.0, description="relative standard deviation of the gain of each input [1]"
    )
    goal: Positive | None = Field(
        default=None,
        description="tolerance of goals and way-points that are values, not ranges; by default "
        "draws may miss them [m, rad]",
    )


class PlanTime(Time):
    """Sampling of the motion, and its duration."""

    duration: Positive = Field(
        default=inf,
        description="duration of the plan, if plan.duration does not give it, and of the initial "
        "guess with [inputs]; longest one with a driver, by default up to the goal [s]",
    )
    step: Positive = Field(default=SAMPLE_STEP, description="time between samples [s]")


OfMesh: Any = record_of(Mesh, omitted=("step",))
Options: Any = record_of(Search, OfMesh)


class PlanTable(Options):  # type: ignore[misc]
    """Options of the search for a plan."""

    duration: Range = Field(
        default=None,
        description="duration of the plan, or its range; default: time.duration, otherwise half to "
        "twice that of the initial guess [s]",
    )
    smooth: NonNegative = Field(
        default=0.0, description="weight of the squared rates of the inputs [1]"
    )
    window: Positive | None = Field(
        default=None,
        description="length of the windows of a long plan along its route, with 'intervals' each; "
        "default: one plan for the whole motion [m]",
    )
    overlap: Positive | None = Field(
        default=None,
        description="length at the end of a window that is planned again in the next window; "
        "default: a third of the window [m]",
    )
    robust: Robust | None = Field(
        default=None, description="random worlds in which the plan must satisfy its limits"
    )
    sliding: bool = Field(
        default=False,
        description="with model = 'dynamics': whether wheels may slide, as in a turn of a "
        "skid-steered vehicle; otherwise they roll within the limits of friction",
    )

    @property
    def shared_length(self) -> float:
        """Length that two windows share [m]."""
        return OVERLAP * (self.window or 0.0) if self.overlap is None else float(self.overlap)


class PlanKeys(Modelled):
    """Planning problem: the inputs that reach a goal at least cost."""

    verb: Literal["plan"] = Field(description=VERB)
    goal: dict[str, Range] = Field(
        description="ranges of states or unknowns at the end, by name; also longitude and latitude "
        "in degrees, as in start [m, rad]"
    )
    costs: dict[str, NonNegative] = Field(
        description="weights of integrals over time: slip, effort, time, energy, or any quantity "
        "squared [1]"
    )
    cost_limits: dict[str, Positive] = Field(
        default={}, description="upper bounds of integrals over time, named as in costs [1]"
    )
    limits: dict[str, Range] = Field(
        default={}, description="ranges of quantities during the motion, in their units [m, rad, 1]"
    )
    bounds: dict[str, Range] = Field(default={}, description="ranges of the inputs [rad/s, m/s]")
    accelerations: dict[str, Range] = Field(
        default={}, description="ranges of the time derivatives of the inputs [rad/s2, m/s2]"
    )
    plan: PlanTable = Field(default=PlanTable(), description="options of the search")
    time: PlanTime = Field(default=PlanTime(), description="sampling, and duration of the guess")
    start: dict[str, Quantity] = Field(
        default={}, description="as in other problems; zero by default [m, rad, m/s]"
    )
    keep_out: Annotated[tuple[KeepOut, ...], Field(strict=False)] = Field(
        default=(), description="regions that no wheel may touch"
    )
    way_points: Annotated[tuple[dict[str, Range], ...], Field(strict=False)] = Field(
        default=(),
        description="ranges as in the goal, at the fraction 'at' of the duration [m, rad]",
    )
    inputs: dict[str, PiecewiseConstant] | None = Field(
        default=None, description=f"inputs of the initial guess, rates with any model: {INPUTS}"
    )
    driver: GuideTable | None = Field(
        default=None,
        description="driving law of the initial guess, instead of inputs; without both, a law that "
        "suits the goal",
    )

    @property
    def duration(self) -> Range | float | None:
        """Duration of the plan or its range, None if it follows from the initial guess [s]."""
        is_given = self.time.duration < inf and self.plan.window is None
        return self.plan.duration or (self.time.duration if is_given else None)

    def faults(self) -> Iterator[Fault]:
        """Yield the errors of common keys, and of options that do not suit the model."""
        yield from super().faults()
        search, driver = self.plan, self.driver
        if self.inputs is not None:
            if driver is not None:
                expected = "at most one initial guess, of inputs and driver"
                yield Fault(("driver",), expected, "both; remove one of them")
            if self.time.duration == inf:
                expected = "the duration of the initial guess by [inputs]"
                yield Fault(("time", "duration"), expected, "none; add it, or remove [inputs]")
        if driver is not None:
            yield from driver.climbing_faults(self.model)
            if driver.name == STEP_CLIMBING and not self.terrain.obstacles:
                expected = f"solids, [[terrain.obstacles]], with name = {STEP_CLIMBING!r}"
                yield Fault(("driver", "name"), expected, "none; add one")
        if (search.intervals or 0) > MAX_INTERVALS:
            found = f"{search.intervals}; reduce it, or divide a long plan with 'window'"
            yield Fault(("plan", "intervals"), f"at most {MAX_INTERVALS} intervals", found)
        yield from self._search_faults()
        if self.model != "dynamics":
            if search.sliding:
                found = f"model = {self.model!r}; set model = 'dynamics', or remove the key"
                yield Fault(("plan", "sliding"), "model = 'dynamics', where wheels slide", found)
            return
        conflicts = {
            "window": search.window is not None,
            "robust": search.robust is not None,
            "starts": search.starts > 1,
        }
        for name in (name for name, is_set in conflicts.items() if is_set):
            expected = f"no {name!r} with model = 'dynamics'"
            yield Fault(("plan", name), expected, "it; remove it, or plan without inertia")

    def _search_faults(self) -> Iterator[Fault]:
        """Yield the errors of options that do not suit windows or drawn worlds."""
        search, robust, window = self.plan, self.plan.robust, self.plan.window
        if robust is not None:
            if robust.map is None and not (robust.friction or robust.inputs):
                expected = "an uncertainty ('map', 'friction' or 'inputs')"
                yield Fault(("plan", "robust"), expected, "none; add one")
            if robust.friction > 0 and self.terrain.friction is None:
                expected = "a ground with friction for the key 'friction'"
                found = "no friction; add 'friction' to [terrain], or remove it from [plan.robust]"
                yield Fault(("plan", "robust"), expected, found)
        if window is None:
            if search.overlap is not None:
                found = "no 'window'; add it to [plan], or remove 'overlap'"
                yield Fault(("plan", "overlap"), "this key only with 'window'", found)
            return
        if self.plan.shared_length >= window:
            found = f"{self.plan.shared_length:g} m; reduce the overlap"
            yield Fault(("plan", "overlap"), f"less than the window, {window:g} m", found)
        for place, is_set, advice in (
            (("plan", "duration"), search.duration is not None, "remove one of them"),
            (("plan", "starts"), search.starts > 1, "remove one of them"),
            (("plan", "robust"), robust is not None, "remove one of them"),
            (("way_points",), self.way_points, "remove the way-points, or lead the path there"),
            (("cost_limits",), self.cost_limits, "remove 'cost_limits'"),
        ):
            if is_set:
                yield Fault(place, f"no {place[-1]!r} with plan.window", f"both; {advice}")


Place = tuple[str, float, float]
Ranges = dict[str, tuple[float, float]]
Domain = tuple[float, float, float, float]


def wanted_places(problem: Problem[PlanKeys]) -> list[tuple[str, Ranges]]:
    """Return names and ranges of the way-points, in order of time, and of the goal."""
    between = way_points_of(problem).items()
    return [*((f"way-point at {at:g}", each) for at, each in between), ("goal", problem.spec.goal)]


def places_of(problem: Problem[PlanKeys], domain: Domain) -> tuple[tuple[Place, ...], set[str]]:
    """Return start, way-points and goal in map coordinates [m], and the names of exact points.

    An exact point has values for x and y, not ranges. A range is represented by the middle of its
    part on the map. Way-points and goals without x and y are omitted.
    """
    spec = problem.spec
    places = [("start", spec.start.get("x", 0.0), spec.start.get("y", 0.0))]
    exact = {"start"}
    for name, wanted in wanted_places(problem):
        axes = [axis for axis in "xy" if axis in wanted]
        with at(problem, (key_of(name),)):
            middles = [sum(on_map(name, axis, wanted[axis], domain)) / 2 for axis in axes]
        if len(axes) == 2:
            places.append((name, middles[0], middles[1]))
            if all(wanted[axis][0] == wanted[axis][1] for axis in axes):
                exact.add(name)
    return tuple(places), exact


def areas_of(
    problem: Problem[PlanKeys], domain: Domain
) -> dict[str, tuple[float, float, float, float]]:
    """Return the areas of way-points and goal that are no points, by name, on the map [m].

    An area is x_min, x_max, y_min, y_max; a coordinate without a value extends over the map.
    """
    areas = {}
    for name, wanted in wanted_places(problem):
        (west, east), (south, north) = (
            np.clip(wanted.get(axis, (-np.inf, np.inf)), *ends).tolist()
            for axis, ends in (("x", domain[:2]), ("y", domain[2:]))
        )
        if {"x", "y"} & wanted.keys() and (west, south) != (east, north):
            areas[name] = west, east, south, north
    return areas


def key_of(place: str) -> str:
    """Return the key of a problem file for the name of a start, way-point or goal."""
    return place if place in ("start", "goal") else "way_points"


def way_points_of(problem: Problem[PlanKeys]) -> dict[float, Ranges]:
    """Return the ranges of quantities at the way-points, by fraction of the duration."""
    between: dict[float, Ranges] = {}
    for index, way_point in enumerate(problem.spec.way_points):
        wanted = dict(way_point)
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
            if low in between:
                raise ModelError(
                    f"way_points: expected at most one way-point at {low:g}, found two; put their "
                    "values into one table"
                )
            between[low] = wanted
    return dict(sorted(between.items()))


def guide_paths(
    problem: Problem[PlanKeys],
    driver: GuideTable,
    layers: Traversability,
    places: tuple[Place, ...],
    radius: float,
) -> tuple[Array, ...]:
    """Return the paths of the initial guesses: given paths, or routes over the ground."""
    with at(problem, ("driver",)):
        if driver.name == "straight":
            check_without_path(driver)
            return ()
        if driver.name == "reeds-shepp":
            _check_cusps(problem, driver, places)
            return ()
        if driver.name == "follow":
            if driver.paths is None:
                return (path_points(problem, driver),)
            if driver.path is not None or driver.file is not None:
                raise ModelError(
                    "driver: expected one of 'path', 'paths' and 'file', found several of them; "
                    "keep one"
                )
            return tuple(np.array(path) for path in driver.paths)
    _check_goal_place(problem, places)
    with at(problem, ("driver",)):
        count = max(driver.count, problem.spec.plan.starts if len(places) == 2 else 1)
        ends = np.array([place[1:] for place in places])
        return ground_routes(layers, ends, turning_radius=radius, count=count)


def _check_goal_place(problem: Problem[Any], places: tuple[Place, ...]) -> None:
    if places[-1][0] != "goal":
        where, goal = problem.source.where(("goal",)), problem.spec.goal
        missing = " and ".join(name for name in ("x", "y") if name not in goal)
        raise ProblemError(
            f"{where}: expected values for x and y, which the driver needs, found "
            f"{'only ' if goal else ''}{', '.join(goal) or 'none'}; add {missing}"
        )


def _check_cusps(problem: Problem[PlanKeys], driver: GuideTable, places: tuple[Place, ...]) -> None:
    """Raise an error for keys that do not suit a driver along a path with cusps."""
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


def regions(problem: Problem[PlanKeys]) -> tuple[Region, ...]:
    """Return the keep-out regions of a problem."""
    keep_out: list[Region] = []
    for index, table in enumerate(problem.spec.keep_out):
        with at(problem, ("keep_out", index)):
            keep_out.append(region_of(table))
    return tuple(keep_out)
