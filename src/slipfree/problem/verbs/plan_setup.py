"""Set-up of plans: model, goal, costs, limits, initial guess and windows."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np

from slipfree.contact.closure import has_exact_closure
from slipfree.control.path_following import turning_radius
from slipfree.core.dae import Dae, Limit
from slipfree.core.errors import ModelError
from slipfree.core.records import Label
from slipfree.core.trajectory import Trajectory
from slipfree.files.toml.source import ProblemError
from slipfree.laws.coulomb import Coulomb
from slipfree.laws.linear_creep import LinearCreep
from slipfree.laws.protocols import GroundLaw
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.rigid_dynamics import rigid_dynamics
from slipfree.plan.guess import (
    Drive,
    Guide,
    Trip,
    choose_guide,
    guide_drives,
    settled_start,
    trip_of,
)
from slipfree.plan.problem import (
    check_task,
    duration_of,
    free_durations,
    limits_of,
    spelled,
    task_of,
)
from slipfree.plan.transcription import Mesh, PlanTask
from slipfree.problem.build import (
    Setup,
    build_model,
    build_start,
    build_world,
    check_names,
    in_frame,
    model_law,
)
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem
from slipfree.problem.verbs.plan_schema import (
    Place,
    PlanKeys,
    guide_paths,
    key_of,
    places_of,
    regions,
    way_points_of,
)
from slipfree.routing.reachability import unheld_words, unreachable
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

SLIDING_CREEPS = (0.3, 0.1, 0.03)  # creep speeds of consecutive searches of wheels that slide [m/s]
HOLE_MARGIN = "hole_margin"  # name of the limits that keep wheels off holes
HOLE_CLEARANCE = 2.0  # additional distance of plans from holes, in units of plan.accuracy


def mesh_of(spec: PlanKeys, accuracy: float | None = None) -> Mesh:
    """Return mesh, accuracy and sampling of a problem, by default with its own accuracy."""
    keys = {name: getattr(spec.plan, name) for name in ("intervals", "degree", "continuous")}
    return Mesh(**keys, accuracy=accuracy or spec.plan.accuracy, step=spec.time.step)


@dataclass(frozen=True, eq=False)
class Planning(Setup):
    """Set-up of the search for a plan."""

    layers: Traversability
    task: PlanTask  # optimal control problem, of the model ``dae``
    places: tuple[Place, ...]  # start, way-points, goal on the map [m]
    starts: tuple[Drive, ...]  # inputs and sample times of each guess [s]
    problem: Problem[PlanKeys]
    trip: Trip  # its model moves along the guesses: a kinematic one for plans with inertia
    guide: Guide  # driving law of the guesses; without a name for guesses by [inputs]
    deadline: float  # value of `time.monotonic` at which the search ends [s]

    @property
    def spec(self) -> PlanKeys:
        """Values of the problem."""
        return self.problem.spec


def build_planning(problem: Problem[PlanKeys]) -> Planning:
    """Return the set-up of a planning problem.

    ProblemError is raised if its values are not valid, the goal cannot be reached, or limits,
    windows, drawn worlds or initial guess do not suit vehicle and ground.
    """
    spec, deadline = problem.spec, time.monotonic() + problem.spec.plan.seconds
    world = build_world(problem)
    terrain, vehicle = world.terrain, world.vehicle
    is_dynamic = spec.model == "dynamics"
    dae: Dae = (
        momentum_models(problem, vehicle, terrain)[-1]
        if is_dynamic
        else build_model(problem, vehicle, terrain)
    )
    driven: Dae = direct_kinematics(vehicle, terrain) if is_dynamic else dae
    check_names(problem, dae, spec.inputs, driven)
    places, exact = places_of(problem, terrain.domain)
    space = free_space(terrain, vehicle, keep_out=regions(problem))
    wrong = [each for each in unreachable(space, places) if each.name in exact]
    if wrong:
        where = problem.source.where((key_of(wrong[0].name),))
        raise ProblemError(f"{where}: {'; '.join(each.words for each in wrong)}")
    for name, x, y in places:
        if name in exact and (why := unheld_words(terrain, vehicle, x, y)):
            where = problem.source.where((key_of(name),))
            raise ProblemError(
                f"{where}: the vehicle cannot be at the {name} {point_text((x, y))}: {why}; move "
                f"the {name} or give the ground more friction"
            )
    start = build_start(problem, dae)
    own = {name for limit in dae.all_limits for name in (limit.label.name, limit.label.full)}
    for table, values in (("goal", spec.goal), ("limits", spec.limits)):
        for name in values.keys() - own:
            with at(problem, (table, name)):
                dae.named(name)
    with at(problem, ("plan",)):
        task = plan_task(problem, dae, start)
        check_task(task, start)
    begin = settled_start(driven, start, spec.solver.options) if is_dynamic else start
    trip = trip_of(task, driven, begin)
    layers = build_layers(problem, terrain, vehicle, places)
    guide, starts = _guesses(problem, trip, layers, places)
    duration = duration_of(spec.duration or free_durations([t[-1] for _, t in starts]))
    goal = ", ".join(f"{name} {spelled(value)}" for name, value in spec.goal.items())
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
    """Return where the vehicle can be; with costs of its poses if a route may be searched."""
    spec, driver, keep_out = problem.spec, problem.spec.driver, regions(problem)
    if spec.inputs is not None or (driver is not None and driver.name != "route"):
        return free_space(terrain, vehicle, keep_out=keep_out)
    points = np.array([place[1:] for place in places])
    backwards = driver is not None and driver.speed < 0
    return traversability(terrain, vehicle, keep_out=keep_out, backwards=backwards, places=points)


def momentum_models(problem: Problem[PlanKeys], vehicle: Vehicle, terrain: Bicubic) -> list[Dae]:
    """Return the models of plans with inertia, one for each search; the last one is the plan's.

    For wheels that slide, searches with larger creep speeds come first.
    """
    spec, contact = problem.spec, model_law(problem)
    with at(problem, ("model",)):
        laws: list[GroundLaw] = [LinearCreep(contact.creep)]
        if spec.plan.sliding:
            laws = [Coulomb(creep) for creep in SLIDING_CREEPS]
        models = (rigid_dynamics(vehicle, terrain, law=law, contact=contact) for law in laws)
        return [in_frame(problem, model) for model in models]


def _guesses(
    problem: Problem[PlanKeys], trip: Trip, layers: Traversability, places: tuple[Place, ...]
) -> tuple[Guide, tuple[Drive, ...]]:
    """Return the driving law of the initial guesses, that of the problem or one that suits.

    Inputs and sample times of each guess follow. ProblemError is raised if the vehicle or the
    number of paths does not suit windows.
    """
    spec, driver, time = problem.spec, problem.spec.driver, problem.spec.time
    if spec.inputs is not None:
        guide = Guide("", 0.0, 0.0)
    elif driver is None:
        with at(problem, ("vehicle",)):
            guide = choose_guide(trip, spec.bounds, layers, count=spec.plan.starts)
    else:
        radius = driver.turning_radius
        radius = turning_radius(trip.vehicle) if radius is None else radius
        paths = guide_paths(problem, driver, layers, places, radius)
        guide = Guide(driver.name, driver.speed, radius, paths)
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
        return guide, guide_drives(trip, guide, step=time.step, longest=time.duration)


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
