"""Test of a plan in a changed world: open loop, path following and replanning compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slipfree.control.path_following import follow
from slipfree.core.dae import Dae
from slipfree.core.errors import DataError, ModelError
from slipfree.core.records import leaves
from slipfree.core.trajectory import SolverError, Trajectory, path_length
from slipfree.files.netcdf import read, read_arrays
from slipfree.geometry.path import Path as GroundPath
from slipfree.laws.soil import Soil
from slipfree.models.dynamics import dynamics
from slipfree.models.quasi_statics import quasi_statics
from slipfree.plan.mpc import horizon, track_plan
from slipfree.plan.plan import Plan
from slipfree.plan.polynomial_motion import from_arrays
from slipfree.plan.verification import simulate_plan
from slipfree.problem.build import build_start, build_world, model_law
from slipfree.problem.problem import Problem
from slipfree.problem.result import problem_of
from slipfree.problem.verbs.plan import FRICTION_TOLERANCE, PlanVerb, initial_speed
from slipfree.problem.verbs.plan_search import find_plan
from slipfree.problem.verbs.plan_setup import build_planning
from slipfree.solve.options import SolverOptions
from slipfree.solve.settle import SPEED, settle
from slipfree.solve.simulate import simulate
from slipfree.system.interrupt import interrupt_requested
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.tree import Vehicle

CYCLES_PER_WINDOW = 20  # default number of periods in a window
WINDOWS_PER_PLAN = 5  # duration of a plan divided by the default window
PATH_SPACING = 20  # samples of a plan between two points of its path


class Followed(NamedTuple):
    """Attempt of a controller to follow a plan in the changed world."""

    name: str  # of the controller
    run: Trajectory | None  # None if it does not suit the vehicle, or fails at the start
    words: str  # facts about the controller, or the error


class TrackingTest(NamedTuple):
    """A plan, simulated on its own ground, and the motions that follow it in the changed world."""

    plan: Trajectory
    motions: tuple[Followed, ...]


class ChangedWorld(NamedTuple):
    """The changed world: vehicle, ground, model, and the vehicle settled at the start."""

    vehicle: Vehicle
    terrain: Bicubic
    dae: Dae
    start: Trajectory


def follow_plan(
    file: Path,
    changes: Sequence[str] = (),
    *,
    period: float | None = None,
    window: float | None = None,
    folder: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> TrackingTest:
    """Follow the plan of a result file in a changed world, with three controllers.

    The plan's inputs are simulated as they are, also with quasi-statics and with dynamics; the
    driving law `slipfree.follow` follows its path at its mean speed; and a moving window replans
    from the measured state at every ``period``. The controllers know the plan's ground and vehicle,
    not the changed ones, whose settings are ``changes``. By default a window lasts a fifth of the
    plan, and a period a twentieth of the window. [s]

    The replanned motion is the last one. After a Ctrl-C held back by `held_interrupt`, the motions
    are those simulated until then. DataError is raised if the file contains no plan or the changed
    problem cannot be built; ModelError if period, window, joints or wheels do not suit the plan;
    SolverError if the first window cannot be solved, or a motion fails before its first sample.
    """
    run = read(file)
    saved = from_arrays(read_arrays(file), str(file))
    planned, real = (problem_of(file, run, folder, each) for each in ((), changes))
    if not isinstance(planned.spec, PlanVerb.schema):
        raise DataError(
            f"{file}: expected the result of a plan, found one with verb = {planned.spec.verb!r}; "
            "give the result of a planning problem"
        )
    if planned.spec.model == "dynamics":
        raise DataError(
            f"{file}: expected a plan without inertia, found model = 'dynamics', whose controllers "
            "are not built; give the result of a plan with model = 'kinematics' or 'quasi-static'"
        )
    setup = build_planning(planned)
    duration = saved.motion.duration
    plan = find_plan(planned, setup, [], saved, lambda *_: True, duration)
    _, terrain, vehicle, _, dae = build_world(real)
    world = ChangedWorld(vehicle, terrain, dae, build_start(real, dae))
    window = duration / WINDOWS_PER_PLAN if window is None else window
    period = window / CYCLES_PER_WINDOW if period is None else period
    frame = horizon(plan, span=window)
    options = planned.spec.solver.options
    tracked = track_plan(
        frame, world.dae, world.start, period=period, options=options, progress=progress
    )
    step = planned.spec.time.step
    cycles = f"{tracked.cycles} cycles, {tracked.failures} failed, window {window:.3g} s"
    others = list[Followed]()
    try:
        run = simulate_plan(world.dae, world.start, plan.motion, step=step, options=options)
        others.append(Followed("open loop", run, "inputs of the plan"))
        others.extend(_with_forces(plan, real, world))
        others.append(_followed(plan, world, step, options))
    except KeyboardInterrupt:
        if not interrupt_requested():
            raise
    return TrackingTest(plan.replay, (*others, Followed("replanned", tracked.run, cycles)))


def _with_forces(plan: Plan, problem: Problem[Any], world: ChangedWorld) -> Iterator[Followed]:
    """Yield the motions under the plan's inputs with quasi-statics and with dynamics."""
    if problem.spec.model != "quasi-static":
        yield _with_model("quasi-static", quasi_statics, plan, problem, world)
    law, speed = model_law(problem), initial_speed(plan.replay)
    model = partial(dynamics, law=law) if isinstance(law, Soil) else dynamics
    yield _with_model("dynamics", model, plan, problem, world, speed=speed)


def _with_model(
    name: str,
    model: Callable[[Vehicle, Bicubic], Dae],
    plan: Plan,
    problem: Problem[Any],
    world: ChangedWorld,
    speed: float | None = None,
) -> Followed:
    """Return the motion under the plan's inputs with another model of the changed world.

    ``speed`` is the initial speed for a model with inertia, None for other models. [m/s]
    """
    options = problem.spec.solver.options
    options = replace(options, tolerance=max(options.tolerance, FRICTION_TOLERANCE))
    names = {**problem.spec.start, "heading": 0.0}
    values: dict[str, Any] = {key: float(world.start[key][0]) for key in names}
    if speed is not None:
        values[SPEED] = speed
    try:
        dae = model(world.vehicle, world.terrain)
        _check_inputs(dae, world.dae)
        start = settle(dae, options=options, **values)
        step = problem.spec.time.step
        run = simulate_plan(dae, start, plan.motion, step=step, options=options)
    except (ModelError, SolverError) as error:
        return Followed(name, None, f"not simulated: {error}")
    return Followed(name, run, "inputs of the plan")


def _check_inputs(dae: Dae, planned: Dae) -> None:
    """Raise ModelError unless a model has the inputs of the plan's model."""
    expected, names = ([label.full for label in leaves(each.labels.u)] for each in (planned, dae))
    if names != expected:
        raise ModelError(
            f"expected the inputs of the plan, {', '.join(expected)}, found {', '.join(names)}; "
            "give the wheels drives whose input is a rate"
        )


def _followed(plan: Plan, world: ChangedWorld, step: float, options: SolverOptions) -> Followed:
    """Return the motion of the driving law along the plan's path at its mean speed."""
    run, name = plan.replay, "follow"
    points = np.column_stack([run["x"], run["y"]])
    points = np.concatenate([points[:-1:PATH_SPACING], points[-1:]])
    duration = plan.motion.duration
    times = np.append(np.arange(0.0, duration - 0.5 * step, step), duration)
    try:
        path = GroundPath(points)
        law = follow(world.dae, world.vehicle, path, speed=path.length / duration)
        run = simulate(world.dae, world.start, law, times, options=options)
        return Followed(name, run, "along the path of the plan")
    except SolverError as error:
        return Followed(name, error.trajectory, str(error))
    except ModelError as error:
        return Followed(name, None, str(error))


def tracking_rows(test: TrackingTest) -> list[dict[str, Any]]:
    """Return for each motion its name, end error [m], slip [m/s], path length [m] and outcome."""
    rows = list[dict[str, Any]]()
    for name, run, words in (Followed("plan", test.plan, "on its own ground"), *test.motions):
        rows.append({"name": name, "words": words})
        if run is None:
            continue
        slip = np.hypot(run["slip_along"], run["slip_across"])
        squares = np.trapezoid(slip**2, run.t, axis=0).mean() / (run.t[-1] - run.t[0])
        end = np.hypot(*(run[axis][-1] - test.plan[axis][-1] for axis in "xy"))
        rows[-1] |= {
            "end_distance": float(end),
            "slip_rms": float(np.sqrt(squares)),
            "path_length": path_length(run),
            "outcome": run.outcome.name.lower(),
            "stop": "" if run.stop is None else f"{run.t[-1]:.4g} s: {run.stop.words}",
        }
    return rows


def tracking_lines(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """Yield the lines that show the rows of `tracking_rows`."""
    for row in rows:
        words = row["words"]
        if "outcome" in row:
            stopped = f"; stopped at {row['stop']}" if row["stop"] else ""
            words = (
                f"ends {row['end_distance']:.3g} m from the plan, rms slip "
                f"{1e3 * row['slip_rms']:.3g} mm/s per wheel, path {row['path_length']:.4g} m; "
                f"{words}{stopped}"
            )
        yield row["name"], words
