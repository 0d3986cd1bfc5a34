"""Set-up of planning problems: model, start, arguments of the search, initial guesses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path as File
from typing import Any, NamedTuple

import numpy as np

from slipfree.control.path_following import arc_inputs, follow, turning_axis_offset
from slipfree.core.dae import Dae, Limit
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Label, leaves
from slipfree.core.trajectory import Trajectory
from slipfree.files.toml.source import ProblemError
from slipfree.geometry.path import Path
from slipfree.geometry.regions import Region
from slipfree.laws.coulomb import Coulomb
from slipfree.laws.linear_creep import LinearCreep
from slipfree.laws.protocols import GroundLaw
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.rigid_dynamics import rigid_dynamics
from slipfree.plan.problem import limits_of, task_of
from slipfree.problem.build_common import (
    Setup,
    build_start,
    build_terrain,
    build_vehicle,
    check_names,
    in_frame,
    samples,
)
from slipfree.problem.build_driver import build_law
from slipfree.problem.build_ground import at, build_ground
from slipfree.problem.build_model import build_model, model_law
from slipfree.problem.geographic_places import convert_places
from slipfree.problem.problem import Problem
from slipfree.problem.validation import validated_problem
from slipfree.problem.verbs.plan_goals import (
    Place,
    Ranges,
    cusp_goal,
    initial_paths,
    key_of,
    places_of,
    regions,
    spelled,
    way_points_of,
)
from slipfree.problem.verbs.plan_schema import Guide, Plan
from slipfree.problem.verbs.plan_windows import check_windows
from slipfree.routing.reachability import unreachable
from slipfree.routing.reeds_shepp import reeds_shepp
from slipfree.routing.traversability import Traversability, extents, traversability
from slipfree.solve.settle import settle
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.tree import Vehicle

SLIDING_CREEPS = (0.3, 0.1, 0.03)  # creep speeds of consecutive searches of wheels that slide [m/s]
HOLE_MARGIN = "hole_margin"  # name of the limits that keep wheels off holes
HOLE_CLEARANCE = 2.0  # additional distance of plans from holes, in units of plan.accuracy
RUNS = count()


@dataclass(frozen=True, eq=False)
class Planning(Setup):
    """Set-up of the search for a plan.

    Attributes
    ----------
    layers : Traversability
        Traversability of the map.
    places : tuple of (str, float, float)
        Names and map coordinates of start, way-points and goal. [m]
    keep_out : tuple of Region
        Keep-out regions.
    paths : tuple of ndarray, shape (n, 2)
        Paths of the initial guesses; empty if the guesses follow no path. [m]
    starts : tuple of (record, ndarray)
        Inputs and times of the samples of each initial guess. [rad/s or m/s, s]
    spec : Plan
        Record of the problem file.
    between : mapping of float to mapping
        Ranges of quantities at the way-points, by fraction of the duration.
    guide, guide_start : Dae, Trajectory
        Model that moves along the initial guesses, and its start: a kinematic model for plans with
        inertia, otherwise the planned model.
    """

    layers: Traversability
    places: tuple[Place, ...]
    keep_out: tuple[Region, ...]
    paths: tuple[Array, ...]
    starts: tuple[tuple[Any, Array], ...]
    spec: Plan
    between: Mapping[float, Ranges]
    guide: Dae
    guide_start: Trajectory


def build_planning(problem: Problem[Plan]) -> Planning:
    """Return the set-up of a planning problem.

    Raises
    ------
    ProblemError
        If ground, vehicle or start are not valid, names are unknown, the goal cannot be reached,
        or limits, windows, drawn worlds or initial guess do not suit vehicle and ground.
    """
    spec = problem.spec
    ground = build_ground(problem)
    with at(problem, ("vehicle",)):
        vehicle = build_vehicle(spec.vehicle, problem)
    terrain = build_terrain(problem, ground)
    is_dynamic = spec.model == "dynamics"
    dae: Dae = (
        momentum_models(problem, vehicle, terrain)[-1]
        if is_dynamic
        else build_model(problem, spec, vehicle, terrain)
    )
    guide: Dae = direct_kinematics(vehicle, terrain) if is_dynamic else dae
    check_names(problem, dae, spec.inputs, guide)
    keep_out, between = regions(problem, spec), way_points_of(problem, spec)
    places, exact = places_of(problem, spec, between, terrain.domain)
    layers = traversability(terrain, vehicle, keep_out=keep_out)
    wrong = [each for each in unreachable(layers, places) if each.sure and each.name in exact]
    if wrong:
        where = problem.source.where((key_of(wrong[0].name),))
        raise ProblemError(f"{where}: {'; '.join(each.words for each in wrong)}")
    start = build_start(problem, dae)
    guide_start = _same_start(guide, start, spec) if is_dynamic else start
    paths = initial_paths(problem, spec, layers, places)
    check_windows(problem, spec, vehicle, paths)
    check_robust(problem, spec, terrain.has_friction)
    starts = _starts(problem, guide, vehicle, guide_start, paths, places)
    _check_quantities(problem, dae)
    with at(problem, ("plan",)):
        task_of(
            dae,
            start,
            **plan_arguments(spec, keep_out, (dae, vehicle, terrain), between),
            duration=spec.plan.duration or spec.time.duration,
        )
    goal = ", ".join(f"{name} {spelled(value)}" for name, value in spec.goal.items())
    return Planning(
        ground,
        terrain,
        vehicle,
        dae,
        dae,
        start,
        *starts[0],
        f"plan to {goal}",
        layers,
        places,
        keep_out,
        paths,
        starts,
        spec,
        between,
        guide,
        guide_start,
    )


def momentum_models(problem: Problem[Plan], vehicle: Vehicle, terrain: Bicubic) -> list[Dae]:
    """Return the models of plans with inertia, one for each search; the last one is the plan's.

    For wheels that slide, searches with larger creep speeds come first.
    """
    spec, contact = problem.spec, model_law(problem, problem.spec)
    with at(problem, ("model",)):
        laws: list[GroundLaw] = [LinearCreep(contact.creep)]
        if spec.plan.sliding:
            laws = [Coulomb(creep) for creep in SLIDING_CREEPS]
        models = (rigid_dynamics(vehicle, terrain, law=law, contact=contact) for law in laws)
        return [in_frame(problem, model) for model in models]


def check_robust(problem: Problem[Plan], spec: Plan, has_friction: bool) -> None:
    """Raise ProblemError for a table ``plan.robust`` that cannot be used.

    The table needs at least one uncertainty, a ground with friction if the friction is uncertain,
    and a plan without windows.
    """
    robust = spec.plan.robust
    if robust is None:
        return
    with at(problem, ("plan", "robust")):
        if robust.map is None and not (robust.friction or robust.inputs):
            raise ModelError(
                "expected an uncertainty ('map', 'friction' or 'inputs'), found none; add one"
            )
        if robust.friction > 0 and not has_friction:
            raise ModelError(
                "expected a ground with friction for the key 'friction', found no friction; add "
                "'friction' to [terrain], or remove it from [plan.robust]"
            )
        if spec.plan.window is not None:
            raise ModelError(
                "expected a plan without windows, found the key plan.window; remove it, or remove "
                "[plan.robust]"
            )


def _check_quantities(problem: Problem[Plan], dae: Dae) -> None:
    """Raise ProblemError for goals and limits of unknown quantities."""
    spec = problem.spec
    own = {name for limit in dae.limits for name in (limit.label.name, limit.label.full)}
    for table, values in (("goal", spec.goal), ("limits", spec.limits)):
        for name in values.keys() - own:
            with at(problem, (table, name)):
                dae.named(name)


def _starts(
    problem: Problem[Plan],
    dae: Dae,
    vehicle: Vehicle,
    start: Trajectory,
    paths: tuple[Array, ...],
    places: tuple[Place, ...],
) -> tuple[tuple[Any, Array], ...]:
    """Return inputs and times of the samples [s] of each initial guess."""
    spec = problem.spec
    t, rates = samples(spec.time, spec.inputs or {})
    if spec.driver is None:
        with at(problem, ("inputs",)):
            return ((dae.inputs(**rates), t),)
    if spec.driver.name == "reeds-shepp":
        return (_cusp_guess(problem, spec.driver, dae, vehicle, start, places),)
    if not paths:
        return ((build_law(problem, spec.driver, dae, vehicle, start), t),)
    with at(problem, ("driver",)):
        return tuple(_path_guess(dae, vehicle, path, spec.driver.speed, t) for path in paths)


def _path_guess(
    dae: Dae, vehicle: Vehicle, points: Array, speed: float, t: Array
) -> tuple[Any, Array]:
    """Return the inputs of a law that follows a path, and sample times up to the end of the path.

    The times are those of ``t`` in s; ``speed`` is in m/s.
    """
    path = Path(points)
    count = int((t <= path.length / abs(speed)).sum())
    return follow(dae, vehicle, path, speed=speed), t[: max(count, 2)]


def _cusp_guess(
    problem: Problem[Plan],
    driver: Guide,
    dae: Dae,
    vehicle: Vehicle,
    start: Trajectory,
    places: tuple[Place, ...],
) -> tuple[Any, Array]:
    """Return the inputs along the shortest path with cusps to the goal, and times of samples [s].

    Raises
    ------
    ProblemError
        If the driver, the goal or the duration do not suit such a path.
    """
    spec = problem.spec
    with at(problem, ("driver",)):
        goal = cusp_goal(problem, spec, driver, places)
        first = (float(start["x"][-1]), float(start["y"][-1]), float(start["heading"][-1]))
        arcs = reeds_shepp(first, goal, driver.turning_radius, turning_axis_offset(vehicle))
        if not arcs:
            raise ModelError(
                "driver: expected a goal apart from the start, found one at the start; move "
                "the goal"
            )
        values = {c.name: float(start[c.name][-1]) for c in vehicle.of("commanded")}
        pieces, duration = arc_inputs(dae, vehicle, arcs, values, speed=driver.speed)
    if duration > spec.time.duration:
        with at(problem, ("time", "duration")):
            raise ModelError(
                f"expected at least {duration:.6g} s, which the path with cusps takes, found "
                f"{spec.time.duration:g} s; increase the duration"
            )
    t, rates = samples(spec.time.model_copy(update={"duration": duration}), pieces)
    return dae.inputs(**rates), t


def plan_arguments(
    spec: Plan,
    keep_out: tuple[Region, ...],
    model: tuple[Dae, Vehicle, Bicubic],
    between: Mapping[float, Ranges],
) -> dict[str, Any]:
    """Return the arguments of `plan` for a problem: goal, costs, limits, way-points and bounds.

    Parameters
    ----------
    spec : Plan
        Record of the problem.
    keep_out : tuple of Region
        Keep-out regions.
    model : tuple of Dae, Vehicle and Bicubic
        Model, vehicle and ground.
    between : mapping of float to mapping
        Ranges of quantities at the way-points, by fraction of the duration.

    Raises
    ------
    ModelError
        If a limit has an unknown name.
    """
    limits = (
        *limits_of(model[0], spec.limits),
        *_kept_out(keep_out, *model),
        *_kept_off_holes(spec, model[0]),
    )
    return {
        "goal": spec.goal,
        "costs": spec.costs,
        "smooth": spec.plan.smooth,
        "continuous": spec.plan.continuous,
        "limits": limits,
        "way_points": between,
        "inputs": spec.bounds,
        "accelerations": spec.accelerations,
        "cost_limits": spec.cost_limits,
    }


def _kept_out(
    keep_out: tuple[Region, ...], dae: Dae, vehicle: Vehicle, terrain: Bicubic
) -> list[Limit]:
    """Return the limits that keep the circle around the wheels out of regions."""
    x, y = dae.x.x, dae.x.y
    o_x, o_y, _ = terrain.origin
    _, _, reach = extents(vehicle)
    return [
        Limit(
            Label(f"keep_out_{k}", "m", f"the circle around the wheels touches {region.words}"),
            region.outside(x + o_x, y + o_y),
            reach,
            np.inf,
        )
        for k, region in enumerate(keep_out)
    ]


def _kept_off_holes(spec: Plan, dae: Dae) -> Iterator[Limit]:
    """Yield the limits that keep wheels off holes of the map, unless the problem has its own.

    The search has these limits from its beginning: otherwise its first plan may cross a hole, and
    the later searches, which start from it, do not find a way around.
    """
    for limit in dae.limits:
        own = {limit.label.name, limit.label.full} & {*spec.limits}
        if limit.label.name == HOLE_MARGIN and not own:
            yield limit._replace(lower=limit.lower + HOLE_CLEARANCE * spec.plan.accuracy)


def settled_start(dae: Dae, setup: Planning) -> Trajectory:
    """Return the start of a plan, settled for another model ``dae`` of the vehicle.

    Raises
    ------
    ModelError
        If the vehicle cannot stand there.
    """
    return _same_start(dae, setup.start, setup.spec)


def _same_start(dae: Dae, start: Trajectory, spec: Plan) -> Trajectory:
    """Return a start, settled for another model ``dae`` of the vehicle."""
    values: dict[str, Any] = {
        label.full: float(start.of(label)[-1]) for label in leaves(dae.labels.x)
    }
    return settle(dae, options=spec.solver.options, **values)


class PlanSource(NamedTuple):
    """Source of a planning problem, for other processes.

    Attributes
    ----------
    path, text : Path, str
        Path and text of the problem file.
    settings : tuple of str
        Settings of the option ``--set``.
    trusted : frozenset of str
        Paths of xacro files that the command line trusts.
    run : int
        Number of the run in this process. It distinguishes sources of different runs in caches, so
        that input files are read again.
    """

    path: File
    text: str
    settings: tuple[str, ...]
    trusted: frozenset[str]
    run: int


def source_of(problem: Problem[Plan]) -> PlanSource:
    """Return the source of a problem, with a new run number."""
    source = problem.source
    settings = tuple(dict.fromkeys(source.settings.values()))
    return PlanSource(source.path, source.text, settings, problem.trusted, next(RUNS))


def problem_from(source: PlanSource) -> Problem[Plan]:
    """Return the problem of a source; errors are those of `slipfree.problem.load.load_problem`."""
    problem: Problem[Plan] = validated_problem(
        lambda *_: Plan, source.path, source.text, source.settings
    )
    return replace(convert_places(problem), trusted=source.trusted)
