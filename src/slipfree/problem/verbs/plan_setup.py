"""Plans: keys of their problems, and their set-up: model, goal, costs, limits, initial guess."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from slipfree.contact.closure import has_exact_closure
from slipfree.control.path_following import turning_radius
from slipfree.core.dae import Dae, Limit
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Label
from slipfree.core.trajectory import Trajectory
from slipfree.enclosure.wheel_gaps import pose_graphs
from slipfree.files import toml
from slipfree.geometry.regions import Region
from slipfree.laws.coulomb import Coulomb
from slipfree.laws.linear_creep import LinearCreep
from slipfree.laws.protocols import GroundLaw
from slipfree.models.base import check_mass
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.rigid_dynamics import rigid_dynamics
from slipfree.plan import guess
from slipfree.plan.problem import (
    check_task,
    duration_of,
    free_durations,
    limits_of,
    spelled,
    task_of,
)
from slipfree.plan.robust import robust_plan
from slipfree.plan.search import Search
from slipfree.plan.transcription import SAMPLE_STEP, Mesh, PlanTask
from slipfree.problem import build, schema
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem
from slipfree.problem.schema import STEP_CLIMBING
from slipfree.routing.search import unheld_words, unreachable
from slipfree.routing.traversability import (
    Traversability,
    extents,
    free_space,
    point_text,
    traversability,
)
from slipfree.solve.sampling import input_samples
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.tree import Vehicle

OVERLAP = 1 / 3  # default overlap, relative to the window
MAX_INTERVALS = 2000  # a plan with more needs gigabytes and hours; windows divide it

GuideName = Literal["straight", "follow", "route", "reeds-shepp", "step-climbing"]


class GuideTable(schema.ClimbingDriver):
    """Initial guess of a plan: a driving law along paths or along routes over the ground.

    Attributes
    ----------
    name : str
        Law; 'route': follow a path that a search finds on the map; 'reeds-shepp': drive forwards
        and backwards along the shortest path of a car on even ground; 'step-climbing': plan of a
        step climber over solids.
    turning_radius : float or None
        Smallest turning radius of a route, or of the shortest path of a car; default: that of the
        driving law. [m]
    paths : tuple of tuple of tuple of 2 floats or None
        Several paths of way-points; the plan of least cost is returned. [m]
    count : int
        Number of routes, which pass obstacles on different sides; the plan of least cost is
        returned.
    """

    name: GuideName  # type: ignore[assignment]
    turning_radius: toml.NonNegative | None = None
    paths: Annotated[
        tuple[Annotated[tuple[toml.Pair, ...], Field(strict=False)], ...] | None,
        Field(strict=False, min_length=1),
    ] = None
    count: Annotated[int, Field(ge=1, le=100)] = 1

    def faults(self, model: str) -> Iterator[toml.Fault]:
        """Yield the errors of paths, of a step climber, and of the keys of other laws."""
        yield from super().faults(model)
        if self.name == "reeds-shepp" and self.speed < 0:
            expected = f"a positive speed with name = {self.name!r}, which chooses the gears"
            yield toml.Fault(("driver", "speed"), expected, f"{self.speed:g}; change its sign")
        if self.count > 1 and self.name != "route":
            found = f"{self.name!r}; change it, or remove 'count'"
            yield toml.Fault(("driver", "name"), "'route' with several routes, 'count'", found)


class KeepOut(schema.RegionTable):
    """A region that no wheel may touch: a disc or a polygon.

    Attributes
    ----------
    longitude : float or None
        Longitude, instead of x. [deg]
    latitude : float or None
        Latitude, instead of y. [deg]
    """

    longitude: float | None = None
    latitude: float | None = None


OfRobust: Any = toml.record_of(robust_plan, omitted=("first", "solve", "replay"))


class Robust(OfRobust):  # type: ignore[misc]
    """Random worlds in which a plan is simulated, and the share in which its limits must hold.

    Attributes
    ----------
    map : HeightErrors or None
        Errors of the heights of the map.
    friction : float
        Relative standard deviation of the friction of the ground. [1]
    inputs : float
        Relative standard deviation of the gain of each input. [1]
    goal : float or None
        Tolerance of goals and way-points that are values, not ranges; by default draws may miss
        them. [m, rad]
    """

    map: schema.HeightErrors | None = None
    friction: toml.NonNegative = 0.0
    inputs: toml.NonNegative = 0.0
    goal: toml.Positive | None = None


class PlanTime(schema.Time):
    """Sampling of the motion, and its duration.

    Attributes
    ----------
    duration : float
        Duration of the plan, if plan.duration does not give it, and of the initial guess with
        [inputs]; longest one with a driver, by default up to the goal. [s]
    step : float
        Time between samples. [s]
    """

    duration: toml.Positive = inf
    step: toml.Positive = SAMPLE_STEP


OfMesh: Any = toml.record_of(Mesh, omitted=("step",))
Options: Any = toml.record_of(Search, OfMesh)


class PlanTable(Options):  # type: ignore[misc]
    """Options of the search for a plan.

    Attributes
    ----------
    duration : tuple of 2 floats
        Duration of the plan, or its range; default: time.duration, otherwise half to twice that of
        the initial guess. [s]
    smooth : float
        Weight of the squared rates of the inputs. [1]
    window : float or None
        Length of the windows of a long plan along its route, with 'intervals' each; default: one
        plan for the whole motion. [m]
    overlap : float or None
        Length at the end of a window that is planned again in the next window; default: a third of
        the window. [m]
    robust : Robust or None
        Random worlds in which the plan must satisfy its limits.
    guarantee : float or None
        Distance from the map of all grounds on which the limits of the poses must hold at every
        sample. [m]
    sliding : bool
        With model = 'dynamics': whether wheels may slide, as in a turn of a skid-steered vehicle;
        otherwise they roll within the limits of friction.
    """

    duration: toml.Range = None
    smooth: toml.NonNegative = 0.0
    window: toml.Positive | None = None
    overlap: toml.Positive | None = None
    robust: Robust | None = None
    guarantee: toml.Positive | None = None
    sliding: bool = False

    @property
    def shared_length(self) -> float:
        """Length that two windows share [m]."""
        return OVERLAP * (self.window or 0.0) if self.overlap is None else float(self.overlap)


class PlanKeys(schema.Modelled):
    """Planning problem: the inputs that reach a goal at least cost.

    Attributes
    ----------
    goal : mapping of str to tuple of 2 floats
        Ranges of states or unknowns at the end, by name; also longitude and latitude in degrees, as
        in start. [m, rad]
    costs : mapping of str to float
        Weights of integrals over time: slip, effort, time, energy, or any quantity squared. [1]
    cost_limits : mapping of str to float
        Upper bounds of integrals over time, named as in costs. [1]
    limits : mapping of str to tuple of 2 floats
        Ranges of quantities during the motion, in their units. [m, rad, 1]
    bounds : mapping of str to tuple of 2 floats
        Ranges of the inputs. [rad/s, m/s]
    accelerations : mapping of str to tuple of 2 floats
        Ranges of the time derivatives of the inputs. [rad/s2, m/s2]
    plan : PlanTable
        Options of the search.
    time : PlanTime
        Sampling, and duration of the guess.
    start : mapping of str to float
        As in other problems; zero by default. [m, rad, m/s]
    keep_out : tuple of KeepOut
        Regions that no wheel may touch.
    way_points : tuple of mapping of str to tuple of 2 floats
        Ranges as in the goal, at the fraction 'at' of the duration. [m, rad]
    inputs : mapping of str to float or tuple, or None
        Inputs of the initial guess, rates with any model: rates of driven wheels and commanded
        joints, by name. [rad/s, m/s]
    driver : GuideTable or None
        Driving law of the initial guess, instead of inputs; without both, a law that suits the
        goal.
    """

    verb: Literal["plan"]
    goal: dict[str, toml.Range]
    costs: dict[str, toml.NonNegative]
    cost_limits: dict[str, toml.Positive] = Field(default={})
    limits: dict[str, toml.Range] = Field(default={})
    bounds: dict[str, toml.Range] = Field(default={})
    accelerations: dict[str, toml.Range] = Field(default={})
    plan: PlanTable = PlanTable()
    time: PlanTime = PlanTime()
    start: dict[str, toml.Quantity] = Field(default={})
    keep_out: Annotated[tuple[KeepOut, ...], Field(strict=False)] = ()
    way_points: Annotated[tuple[dict[str, toml.Range], ...], Field(strict=False)] = ()
    inputs: dict[str, toml.PiecewiseConstant] | None = None
    driver: GuideTable | None = None

    @property
    def duration(self) -> toml.Range | float | None:
        """Duration of the plan or its range, None if it follows from the initial guess [s]."""
        is_given = self.time.duration < inf and self.plan.window is None
        return self.plan.duration or (self.time.duration if is_given else None)

    def faults(self) -> Iterator[toml.Fault]:
        """Yield the errors of common keys, and of options that do not suit the model."""
        yield from super().faults()
        search, driver = self.plan, self.driver
        robust, window = search.robust, search.window
        if self.inputs is not None:
            if driver is not None:
                expected = "at most one initial guess, of inputs and driver"
                yield toml.Fault(("driver",), expected, "both; remove one of them")
            if self.time.duration == inf:
                expected = "the duration of the initial guess by [inputs]"
                yield toml.Fault(("time", "duration"), expected, "none; add it, or remove [inputs]")
        if driver and driver.name == STEP_CLIMBING and not self.terrain.obstacles:
            expected = f"solids, [[terrain.obstacles]], with name = {STEP_CLIMBING!r}"
            yield toml.Fault(("driver", "name"), expected, "none; add one")
        if (search.intervals or 0) > MAX_INTERVALS:
            found = f"{search.intervals}; reduce it, or divide a long plan with 'window'"
            yield toml.Fault(("plan", "intervals"), f"at most {MAX_INTERVALS} intervals", found)
        if search.guarantee is not None:
            others = {
                "plan.robust": robust,
                "plan.window": window,
                "terrain.obstacles": self.terrain.obstacles,
            }
            for name in (name for name, value in others.items() if value):
                found = f"{name}; remove one of them"
                yield toml.Fault(("plan", "guarantee"), f"no {name!r} with plan.guarantee", found)
        if robust is not None:
            if robust.map is None and not (robust.friction or robust.inputs):
                expected = "an uncertainty ('map', 'friction' or 'inputs')"
                yield toml.Fault(("plan", "robust"), expected, "none; add one")
            if robust.friction > 0 and self.terrain.friction is None:
                expected = "a ground with friction for the key 'friction'"
                found = "no friction; add 'friction' to [terrain], or remove it from [plan.robust]"
                yield toml.Fault(("plan", "robust"), expected, found)
        if window is None and search.overlap is not None:
            found = "no 'window'; add it to [plan], or remove 'overlap'"
            yield toml.Fault(("plan", "overlap"), "this key only with 'window'", found)
        if window is not None and search.shared_length >= window:
            found = f"{search.shared_length:g} m; reduce the overlap"
            yield toml.Fault(("plan", "overlap"), f"less than the window, {window:g} m", found)
        for place, is_set, advice in (
            (("plan", "duration"), search.duration is not None, "remove one of them"),
            (("plan", "starts"), search.starts > 1, "remove one of them"),
            (("plan", "robust"), robust is not None, "remove one of them"),
            (("way_points",), self.way_points, "remove the way-points, or lead the path there"),
            (("cost_limits",), self.cost_limits, "remove 'cost_limits'"),
        ):
            if is_set and window is not None:
                yield toml.Fault(place, f"no {place[-1]!r} with plan.window", f"both; {advice}")
        if self.model != "dynamics":
            if search.sliding:
                found = f"model = {self.model!r}; set model = 'dynamics', or remove the key"
                yield toml.Fault(
                    ("plan", "sliding"), "model = 'dynamics', where wheels slide", found
                )
            return
        names = ("window", "robust", "guarantee")
        given = [name for name in names if getattr(search, name) is not None]
        for name in given + ["starts"] * (search.starts > 1):
            expected = f"no {name!r} with model = 'dynamics'"
            found = f"the key {name!r}; remove it, or plan without inertia"
            yield toml.Fault(("plan", name), expected, found)


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
            middles = [sum(guess.on_map(name, axis, wanted[axis], domain)) / 2 for axis in axes]
        if len(axes) == 2:
            places.append((name, middles[0], middles[1]))
            if all(wanted[axis][0] == wanted[axis][1] for axis in axes):
                exact.add(name)
    return tuple(places), exact


def areas_of(
    problem: Problem[PlanKeys], domain: Domain
) -> dict[str, tuple[float, float, float, float]]:
    """Return the areas of way-points and goal with extent, by name, on the map [m].

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


def _check_goal_place(problem: Problem[Any], places: tuple[Place, ...]) -> None:
    if places[-1][0] != "goal":
        goal = problem.spec.goal
        missing = " and ".join(name for name in ("x", "y") if name not in goal)
        found = f"{'only ' if goal else ''}{', '.join(goal) or 'none'}; add {missing}"
        problem.refuse(toml.Fault(("goal",), "values for x and y, which the driver needs", found))


def regions(problem: Problem[PlanKeys]) -> tuple[Region, ...]:
    """Return the keep-out regions of a problem."""
    keep_out: list[Region] = []
    for index, table in enumerate(problem.spec.keep_out):
        with at(problem, ("keep_out", index)):
            keep_out.append(schema.region_of(table))
    return tuple(keep_out)


SLIDING_CREEPS = (0.3, 0.1, 0.03)  # creep speeds of consecutive searches of wheels that slide [m/s]
FORCE_LIMITS = {"drive_torque", "utilisation", "friction_needed", "force_normal"}  # need a mass
HOLE_MARGIN = "hole_margin"  # name of the limits that keep wheels off holes
HOLE_CLEARANCE = 2.0  # additional distance of plans from holes, in units of plan.accuracy


def mesh_of(spec: PlanKeys) -> Mesh:
    """Return mesh, accuracy and sampling of a problem."""
    keys = {name: getattr(spec.plan, name) for name in ("intervals", "degree", "continuous")}
    return Mesh(**keys, accuracy=spec.plan.accuracy, step=spec.time.step)


@dataclass(frozen=True, eq=False)
class Planning(build.Setup):
    """Set-up of the search for a plan."""

    layers: Traversability
    task: PlanTask  # optimal control problem, of the model ``dae``
    places: tuple[Place, ...]  # start, way-points, goal on the map [m]
    starts: tuple[guess.Drive, ...]  # inputs and sample times of each guess [s]
    problem: Problem[PlanKeys]
    trip: guess.Trip  # its model moves along the guesses: a kinematic one for plans with inertia
    guide: guess.Guide  # driving law of the guesses; without a name for guesses by [inputs]
    deadline: float  # value of `time.monotonic` at which the search ends [s]

    @property
    def spec(self) -> PlanKeys:
        """Values of the problem."""
        return self.problem.spec

    @property
    def needs_friction(self) -> bool:
        """Whether friction must hold the vehicle at rest in each pose: the plan limits forces."""
        return self.spec.model == "quasi-static" or not FORCE_LIMITS.isdisjoint(self.spec.limits)


def build_planning(problem: Problem[PlanKeys]) -> Planning:
    """Return the set-up of a planning problem.

    ProblemError is raised if its values are not valid, the goal cannot be reached, or limits,
    windows, drawn worlds or initial guess do not suit vehicle and ground.
    """
    spec, deadline = problem.spec, time.monotonic() + problem.spec.plan.seconds
    world = build.build_world(problem)
    terrain, vehicle = world.terrain, world.vehicle
    is_dynamic = spec.model == "dynamics"
    dae: Dae = (
        momentum_models(problem, vehicle, terrain)[-1]()
        if is_dynamic
        else build.build_model(problem, vehicle, terrain)
    )
    driven: Dae = direct_kinematics(vehicle, terrain) if is_dynamic else dae
    build.check_names(problem, dae, spec.inputs, driven)
    places, exact = places_of(problem, terrain.domain)
    space = free_space(terrain, vehicle, keep_out=regions(problem))
    wrong = {name: why for name, why in unreachable(space, places).items() if name in exact}
    if wrong:
        where = problem.source.where((key_of(next(iter(wrong))),))
        raise toml.ProblemError(f"{where}: {'; '.join(wrong.values())}")
    for name, x, y in places:
        if name in exact and (why := unheld_words(terrain, vehicle, x, y)):
            where = problem.source.where((key_of(name),))
            raise toml.ProblemError(
                f"{where}: the vehicle cannot be at the {name} {point_text((x, y))}: {why}; move "
                f"the {name} or give the ground more friction"
            )
    if spec.plan.guarantee is not None:
        with at(problem, ("plan", "guarantee")):
            pose_graphs(dae)  # raises errors for models without guarantees
    start = build.build_start(problem, dae)
    own = {name for limit in dae.all_limits for name in (limit.label.name, limit.label.full)}
    for table, values in (("goal", spec.goal), ("limits", spec.limits)):
        for name in values.keys() - own:
            with at(problem, (table, name)):
                if name in FORCE_LIMITS:
                    check_mass(vehicle, name)
                dae.named(name)
    with at(problem, ("plan",)):
        task = plan_task(problem, dae, start)
        check_task(task, start)
    begin = guess.settled_start(driven, start, spec.solver.options) if is_dynamic else start
    trip = guess.trip_of(task, driven, begin)
    layers = build_layers(problem, terrain, vehicle, places)
    guide, starts = _guesses(problem, trip, layers, places)
    duration = duration_of(spec.duration or free_durations([t[-1] for _, t in starts]))
    goal = ", ".join(f"{n} {spelled(v, dae.units.get(n, ''))}" for n, v in spec.goal.items())
    words = f"plan to {goal} in {spelled(duration)} s"
    if guide.name:
        words += f"; initial guess: {guide.name} at {guide.speed:.3g} m/s"
    return Planning(
        deadline=deadline,
        **vars(world),
        model=dae,
        dae=dae,
        start=start,
        inputs=starts[0][0],
        t=starts[0][1],
        driven=words,
        layers=layers,
        task=replace(task, duration=duration),
        places=places,
        starts=starts,
        problem=problem,
        trip=trip,
        guide=guide,
    )


def build_layers(
    problem: Problem[PlanKeys], terrain: Bicubic, vehicle: Vehicle, places: tuple[Place, ...]
) -> Traversability:
    """Return the nodes that the vehicle can reach, with costs of poses if a route is searched.

    No route is searched if inputs or a driver with a given path are the initial guess. ``places``
    are start, way-points and goal with their names.
    """
    spec, driver, keep_out = problem.spec, problem.spec.driver, regions(problem)
    if spec.inputs is not None or (driver is not None and driver.name != "route"):
        return free_space(terrain, vehicle, keep_out=keep_out)
    points = np.array([place[1:] for place in places])
    backwards = driver is not None and driver.speed < 0
    return traversability(
        terrain,
        vehicle,
        keep_out=keep_out,
        backwards=backwards,
        places=points,
        seconds=spec.plan.seconds,
    )


def momentum_models(
    problem: Problem[PlanKeys], vehicle: Vehicle, terrain: Bicubic
) -> list[Callable[[], Dae]]:
    """Return functions that make the models of a plan with inertia, in the order of the searches.

    The last one is that of the plan. For wheels that slide, searches with larger creep speeds come
    first.
    """
    spec, contact = problem.spec, build.model_law(problem)
    with at(problem, ("model",)):
        stiffness = getattr(contact, "slip_stiffness", inf)  # of soil, which the model refuses
        laws: list[GroundLaw] = [LinearCreep(contact.creep, stiffness)]
        if spec.plan.sliding:
            laws = [Coulomb(creep, slip_stiffness=stiffness) for creep in SLIDING_CREEPS]

    def make(law: GroundLaw) -> Dae:
        with at(problem, ("model",)):
            model: Dae = rigid_dynamics(vehicle, terrain, law=law, contact=contact)
            return build.in_frame(problem, model)

    return [partial(make, law) for law in laws]


def _guesses(
    problem: Problem[PlanKeys], trip: guess.Trip, layers: Traversability, places: tuple[Place, ...]
) -> tuple[guess.Guide, tuple[guess.Drive, ...]]:
    """Return the driving law of the initial guesses, that of the problem or one that suits.

    Inputs and sample times of each guess follow. ProblemError is raised if the vehicle or the
    number of paths does not suit windows.
    """
    spec, driver, time = problem.spec, problem.spec.driver, problem.spec.time
    if spec.inputs is not None:
        guide = guess.Guide("", 0.0, 0.0)
    elif driver is None:
        with at(problem, ("vehicle",)):
            guide = guess.choose_guide(trip, spec.bounds, layers, count=spec.plan.starts)
    else:
        radius = driver.turning_radius
        radius = turning_radius(trip.vehicle) if radius is None else radius
        paths: tuple[Array, ...] = ()  # given ones, or routes over the ground
        with at(problem, ("driver",)):
            if driver.name == "reeds-shepp":
                _check_goal_place(problem, places)
                if between := len(places) - 2:
                    expected = "way-points without x and y for name = 'reeds-shepp'"
                    found = f"{between} with them; remove x and y from [[way_points]]"
                    problem.refuse(toml.Fault(("driver", "name"), expected, found))
            elif driver.paths is not None:
                paths = tuple(map(np.array, driver.paths))
            elif driver.name == "follow":
                paths = (build.path_points(problem, driver),)
            elif driver.name == "route":
                _check_goal_place(problem, places)
                count = max(driver.count, spec.plan.starts if len(places) == 2 else 1)
                ends = np.array([place[1:] for place in places])
                paths = guess.ground_routes(layers, ends, turning_radius=radius, count=count)
        guide = guess.Guide(driver.name, driver.speed, radius, paths)
    if spec.plan.window is not None:
        with at(problem, ("plan", "window")):
            if len(guide.paths) != 1:
                raise ModelError(
                    "expected a driver that follows one path (name = 'route' with count = 1, or "
                    f"'follow' with 'path' or 'file'), found {len(guide.paths) or 'no'} paths; use "
                    "such a driver, or remove 'window'"
                )
            if not has_exact_closure(trip.vehicle):
                raise ModelError(
                    "expected a vehicle with exact contact of all wheels, found "
                    f"{trip.vehicle.name}, whose wheels press into the ground; remove 'window'"
                )
    if spec.inputs is not None:
        t, rates = input_samples(time.duration, time.step, spec.inputs)
        with at(problem, ("inputs",)):
            return guide, ((trip.dae.inputs(**rates), t),)
    with at(problem, ("driver",)):
        return guide, guess.guide_drives(trip, guide, step=time.step, longest=time.duration)


def plan_task(problem: Problem[PlanKeys], dae: Dae, start: Trajectory) -> PlanTask:
    """Return the optimal control problem of a planning problem with a model from its start."""
    spec, reach, place = problem.spec, extents(dae.vehicle)[2], dae.shift[0]
    limits = [*limits_of(dae, spec.limits)]
    for k, region in enumerate(regions(problem)):
        label = Label(f"keep_out_{k}", "m", f"the circle around the wheels touches {region.words}")
        away = region.outside(dae.x.x + place[0], dae.x.y + place[1])
        limits.append(Limit(label, away, reach, np.inf))
    # from the beginning: a first plan that crosses a hole leads the later searches across it, too
    for limit in dae.limits:
        own = {limit.label.name, limit.label.full} & {*spec.limits}
        if limit.label.name == HOLE_MARGIN and not own:
            lower = limit.lower + HOLE_CLEARANCE * spec.plan.accuracy
            limits.append(limit._replace(lower=lower))
    return task_of(
        dae,
        start,
        goal=spec.goal,
        costs=spec.costs,
        duration=spec.duration,
        smooth=spec.plan.smooth,
        continuous=spec.plan.continuous,
        limits=limits,
        way_points=way_points_of(problem),
        inputs=spec.bounds,
        accelerations=spec.accelerations,
        cost_limits=spec.cost_limits,
    )
