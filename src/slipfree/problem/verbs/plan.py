"""Plans: inputs that reach a goal at least cost, and the resulting motion."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from slipfree.contact.closure import has_exact_closure
from slipfree.control.path_following import follow
from slipfree.dae import Dae, Limit
from slipfree.errors import SlipfreeError
from slipfree.files.toml.errors import ProblemError
from slipfree.geometry.path import Path
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.quasi_statics import quasi_statics
from slipfree.outcome import Outcome
from slipfree.plan.constraints import COST
from slipfree.plan.ipopt import SOLVED_STATUS, STOPPED_STATUS, Iterate
from slipfree.plan.messages import DURATION, missed_words
from slipfree.plan.plan import Plan, PlanProgress, plan
from slipfree.plan.prices import prices_words
from slipfree.plan.problem import bounds_of, limits_of, task_of
from slipfree.plan.starts import further_guesses
from slipfree.plan.verification import simulate_plan
from slipfree.plan.warm_start import ARRAY_PREFIX, SavedPlan, from_arrays
from slipfree.plan.windows import LongPlan
from slipfree.problem.build_common import (
    Setup,
    build_start,
    build_terrain,
    build_vehicle,
    check_names,
    samples,
    wheel_angles_at,
)
from slipfree.problem.build_driver import build_law
from slipfree.problem.build_ground import at, build_ground
from slipfree.problem.build_model import build_model, slip_law
from slipfree.problem.problem import Problem, S
from slipfree.problem.summary import Facts
from slipfree.problem.validation import validated_problem
from slipfree.problem.verbs import plan_schema
from slipfree.problem.verbs.base import RESUME, Quantity, Result, Watch, differences
from slipfree.problem.verbs.driving import DriveVerb, model_attributes
from slipfree.problem.verbs.plan_facts import CHECKS, plan_facts
from slipfree.problem.verbs.plan_goals import (
    Place,
    Ranges,
    facing,
    initial_paths,
    key_of,
    places_of,
    regions,
    spelled,
    way_points_of,
)
from slipfree.problem.verbs.plan_starts import (
    StartResult,
    StartTask,
    is_solved,
    solve_starts,
    start_result,
    starts_words,
)
from slipfree.problem.verbs.plan_windows import (
    check_windows,
    long_plan,
    search_arguments,
    windows_words,
)
from slipfree.records import Array, Label, leaves
from slipfree.routing.reachability import unreachable
from slipfree.routing.regions import Region
from slipfree.routing.traversability import Traversability, extents, traversability
from slipfree.solve.settle import settle
from slipfree.solve.simulate import simulate
from slipfree.solver_codes import ipopt_words
from slipfree.terrain.bicubic import Bicubic
from slipfree.trajectory import (
    PLAN_ACCURACY,
    Column,
    SolverError,
    Stop,
    Trajectory,
    outcome_words,
    path_length,
)
from slipfree.vehicle.tree import Vehicle

if TYPE_CHECKING:
    from slipfree.show.drive_scene import Driven
    from slipfree.show.plots import Plot

MAX_SAMPLES = 401  # largest number of samples of a plan in the viewer
ROUNDING = 1e-6  # largest violation that counts as rounding, in the unit of the limit
SMOOTHINGS = (1.0, 0.3)  # widths of the load law of the first plans [static depths]
STIFFER = 10.0  # factor of stiffness of another simulation of pressed wheels
SLIDING = 0.95  # utilisation above which a wheel counts as sliding
ROUGH = 1e-5  # tolerance of initial guesses [m, rad]
FRICTION_TOLERANCE = 1e-6  # smallest one for quasi-statics, which may not settle below it
LineCallback = Callable[[str, str], None]


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
    starts : tuple of (record, float)
        Inputs and duration of each initial guess. [rad/s, s]
    spec : Plan
        Record of the problem file.
    between : mapping of float to mapping
        Ranges of quantities at the way-points, by fraction of the duration.
    """

    layers: Traversability
    places: tuple[Place, ...]
    keep_out: tuple[Region, ...]
    paths: tuple[Array, ...]
    starts: tuple[tuple[Any, float], ...]
    spec: plan_schema.Plan
    between: Mapping[float, Ranges]


class PlanVerb(DriveVerb):
    """Planning: inputs that reach a goal at least cost, and the resulting motion."""

    schema = plan_schema.Plan
    options = (RESUME,)
    is_timed = False
    checks = (*DriveVerb.checks, *CHECKS)
    metrics_shown = ("within_limits", "plan_violation", "slip_rms")

    def build(self, problem: Problem[plan_schema.Plan]) -> Planning:
        """Return the model, the settled start and the inputs of the initial guess."""
        spec = problem.spec
        ground = build_ground(problem)
        with at(problem, ("vehicle",)):
            vehicle = build_vehicle(spec.vehicle, problem.folder)
        terrain = build_terrain(problem, ground)
        dae: Dae = build_model(problem, spec, vehicle, terrain)
        check_names(problem, dae, spec.inputs)
        keep_out, between = regions(problem, spec), way_points_of(problem, spec)
        places, exact = places_of(problem, spec, between, terrain.domain)
        layers = traversability(terrain, vehicle, keep_out=keep_out)
        wrong = [each for each in unreachable(layers, places) if each.sure and each.place in exact]
        if wrong:
            where = problem.source.where((key_of(wrong[0].place),))
            raise ProblemError(f"{where}: {'; '.join(each.words for each in wrong)}")
        start, (t, _) = build_start(problem, dae), samples(spec.time, spec.inputs or {})
        paths = initial_paths(problem, spec, layers, places)
        check_windows(problem, spec, vehicle, paths)
        starts = _starts(problem, dae, vehicle, start, paths)
        _check_quantities(problem, dae)
        with at(problem, ("plan",)):
            task_of(
                dae,
                start,
                **_plan_arguments(problem, spec, keep_out, (dae, vehicle, terrain), between),
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
            starts[0][0],
            t,
            f"plan to {goal}",
            layers,
            places,
            keep_out,
            paths,
            starts,
            spec,
            between,
        )

    def drive(
        self,
        problem: Problem[plan_schema.Plan],
        setup: Planning,
        watch: Watch,
        resume: SavedPlan | None,
    ) -> tuple[Trajectory, Mapping[str, Array]]:
        """Return the simulated motion of a plan, and the plan as arrays for a warm start."""
        spec = problem.spec
        progress, table = _iterate_reporter(watch.line), ""
        if spec.plan.window is not None:
            return self._drive_windows(problem, setup, progress, resume)
        if resume is None and spec.plan.starts > 1:
            resume, table, is_interrupted = _best_start(problem, setup, watch)
            progress = _stopped if is_interrupted else progress
        with at(problem, ("driver" if spec.driver else "inputs",)):
            guesses = [] if resume else [_guess(setup, start) for start in setup.starts]
        length = resume.motion.duration if resume else float(guesses[0].t[-1])
        found = find_plan(problem, setup, guesses, resume, progress, length)
        run, stop = found.replay, found.run.stop
        if stop is not None and not found.success:
            run = replace(run, stop=stop._replace(t=float(run.t[-1])))
        attributes = {
            **_optimality(found),
            **_by_stiffness(problem, setup, found),
            **({"plan_starts": table} if table else {}),
        }
        prices = {
            f"plan_price_{price.label.name}": price.rate
            for price in found.prices
            if price.role in (COST, DURATION)
        }
        run = replace(run, statistics={**run.statistics, **prices})
        return _described(spec, setup, found, run, attributes)

    def _drive_windows(
        self,
        problem: Problem[plan_schema.Plan],
        setup: Planning,
        progress: PlanProgress,
        resume: SavedPlan | None,
    ) -> tuple[Trajectory, Mapping[str, Array]]:
        """Return the simulated motion of a plan in windows, and the plan as arrays."""
        spec, model = problem.spec, (setup.dae, setup.vehicle, setup.terrain)
        arguments = _plan_arguments(problem, spec, setup.keep_out, model, setup.between)
        found = long_plan(problem, setup, setup.paths[0], arguments, resume, progress)
        attributes = {"plan_windows": windows_words(found)}
        return _described(spec, setup, found, found.replay, attributes)

    def attributes(self, problem: Problem[Any], setup: Setup) -> dict[str, str]:
        """Return the attributes of the result, including model and law."""
        return super().attributes(problem, setup) | model_attributes(problem.spec)

    def describe_samples(self, problem: Problem[plan_schema.Plan], setup: Setup) -> str:
        """Return the description of the sampling, without the duration, which may be unknown."""
        return f"{problem.spec.time.step:g} s apart or less, depending on the intervals of the plan"

    def own_facts(self, run: Trajectory) -> Facts:
        """Return the facts about costs of the plan and differences of its simulation."""
        return [*plan_facts(run)]

    def verification(self, run: Trajectory) -> dict[str, Quantity]:
        """Return differences of the simulation from the plan, and violations of limits, by name."""
        return differences(run, "plan_difference_", "plan_violation_")

    def metrics(self, run: Trajectory, spec: plan_schema.Plan) -> dict[str, Quantity]:
        """Return the metrics of a motion, including its largest violation of limits."""
        found = super().metrics(run, spec)
        sizes = [v for k, v in run.statistics.items() if k.startswith("plan_violation_")]
        violation = max(sizes, default=0.0)
        is_kept = run.stop is None and violation <= spec.plan.accuracy
        found["plan_violation"] = Quantity(violation, "")
        found["within_limits"] = Quantity(float(is_kept), "1")
        return found

    def figures(self, result: Result) -> tuple[Plot, ...]:
        """Return the figures of a plan and of its motion, the most important first."""
        from slipfree.show.plan_figures import plan_plots

        setup = result.setup or self.build(result.problem)
        plots = plan_plots(
            result.trajectory, setup.ground.grid, setup.layers, **figure_options(setup)
        )
        return *plots, *super().figures(replace(result, setup=setup))

    def shown(self, result: Result, name: str) -> Driven:
        """Return the motion of a result with ground, vehicle, keep-out regions and plan."""
        found, problem = super().shown(result, name), result.problem
        planned = poses_of_plan(result.trajectory, result.arrays, found.terrain)
        return found._replace(keep_out=regions(problem, problem.spec), plan=planned)


def _described(
    spec: plan_schema.Plan,
    setup: Planning,
    found: Plan | LongPlan,
    run: Trajectory,
    attributes: Mapping[str, str],
) -> tuple[Trajectory, Mapping[str, Array]]:
    """Return the simulation of a plan with its attributes and statistics, and the saved plan."""
    if run.stop is None and not found.accurate:
        run = replace(run, stop=_inaccurate(spec, found))
    attributes = {
        **run.attributes,
        **_violations(found, spec.plan.accuracy),
        **_by_friction(setup, found),
        **attributes,
    }
    statistics = {**run.statistics, **_statistics(found)}
    return replace(run, attributes=attributes, statistics=statistics), found.saved.arrays


def _check_quantities(problem: Problem[plan_schema.Plan], dae: Dae) -> None:
    """Raise ProblemError for goals and limits of unknown quantities."""
    spec = problem.spec
    own = {name for limit in dae.limits for name in (limit.label.name, limit.label.full)}
    for table, values in (("goal", spec.goal), ("limits", spec.limits)):
        for name in values.keys() - own:
            with at(problem, (table, name)):
                dae.named(name)


def _starts(
    problem: Problem[plan_schema.Plan],
    dae: Dae,
    vehicle: Vehicle,
    start: Trajectory,
    paths: tuple[Array, ...],
) -> tuple[tuple[Any, float], ...]:
    """Return inputs and duration [s] of each initial guess."""
    spec = problem.spec
    t, rates = samples(spec.time, spec.inputs or {})
    if spec.driver is None:
        with at(problem, ("inputs",)):
            return ((dae.inputs(**rates), float(t[-1])),)
    if not paths:
        return ((build_law(problem, spec.driver, dae, vehicle, start), float(t[-1])),)
    with at(problem, ("driver",)):
        return tuple(_path_guess(dae, vehicle, path, spec.driver.speed) for path in paths)


def _path_guess(dae: Dae, vehicle: Vehicle, points: Array, speed: float) -> tuple[Any, float]:
    """Return the inputs of a law that follows a path, and the duration of its motion [s]."""
    path = Path(points)
    return follow(dae, vehicle, path, speed=speed), path.length / abs(speed)


def figure_options(setup: Planning) -> dict[str, Any]:
    """Return the keyword arguments of `plan_plots` for a plan."""
    unbounded = {label.name: (-np.inf, np.inf) for label in leaves(setup.dae.labels.u)}
    return {
        "places": setup.places,
        "found": setup.paths,
        "bounds": unbounded | setup.spec.bounds,
        "limits": setup.spec.limits,
    }


def _plan_arguments(
    problem: Problem[S],
    spec: plan_schema.Plan,
    keep_out: tuple[Region, ...],
    model: tuple[Dae, Vehicle, Bicubic],
    between: Mapping[float, Ranges],
) -> dict[str, Any]:
    """Return the arguments of `plan` for a problem."""
    limits = (*limits_of(model[0], facing(problem, spec.limits)), *_kept_out(keep_out, *model))
    return {
        "goal": facing(problem, spec.goal),
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


def _violations(found: Plan | LongPlan, accuracy: float) -> dict[str, str]:
    """Return the description of violations in the simulation, as an attribute if there are any."""
    sizes = {name: size for name, size in found.violation.items() if size > ROUNDING}
    if not sizes:
        return {}
    words = missed_words(sizes, found.units)
    return {"plan_violations": f"{words}; plan.accuracy allows {accuracy:g}"}


def _optimality(found: Plan) -> dict[str, str]:
    """Return the descriptions of second-order conditions and prices of a solved plan."""
    if found.optimality is None:
        return {}
    return {
        "plan_optimality": found.optimality.words,
        "plan_prices": prices_words(found.prices),
    }


def _inaccurate(spec: plan_schema.Plan, found: Plan | LongPlan) -> Stop:
    """Return the stop of a solved plan whose simulation misses the required accuracy."""
    sizes = found.difference | found.violation
    parts = {name: size for name, size in sizes.items() if size > spec.plan.accuracy}
    worst = missed_words(parts, found.units) or "a narrow limit"
    last = found.stages[-1]
    advice = "raise plan.intervals or plan.accuracy"
    why = {
        SOLVED_STATUS: f"its mesh was not refined any further; {advice}",
        STOPPED_STATUS: "the refinement of its mesh was stopped",
    }.get(last.status, f"with {last.words} {ipopt_words(last.status)}; {advice}")
    words = (
        f"the plan is solved, but its simulation misses {worst}; plan.accuracy allows "
        f"{spec.plan.accuracy:g}: {why}"
    )
    outcome = Outcome.INTERRUPTED if last.status == STOPPED_STATUS else Outcome.INACCURATE
    return Stop(PLAN_ACCURACY, float(found.replay.t[-1]), words, outcome)


def _guess(setup: Planning, start: tuple[Any, float]) -> Trajectory:
    """Return the motion at the inputs of an initial guess, simulated with a rough tolerance.

    If the guess follows a path and the goal has x and y, the motion ends at its sample nearest to
    the goal; ranges of x and y are represented by their middle. If the integrator fails after the
    first sample, the motion ends where the integrator stopped.
    """
    law, lasts = start
    t = setup.t[: max(int((setup.t <= lasts).sum()), 2)]  # not beyond the end of the path
    try:
        rough = replace(setup.spec.solver.options, tolerance=ROUGH)
        run = simulate(setup.dae, setup.start, law, t, options=rough)
    except SolverError as error:
        if error.trajectory is None:
            raise
        run = error.trajectory
    if not setup.paths or setup.places[-1][0] != "goal":
        return run
    _, x, y = setup.places[-1]
    away = np.hypot(run["x"] - x, run["y"] - y)
    return run.part(slice(max(int(away.argmin()), 1) + 1))


def _iterate_reporter(report: LineCallback | None) -> Callable[[str, Iterate], bool]:
    """Return a callback that reports each iterate and stops the search after Ctrl-C.

    It returns False to stop. Ctrl-C before the first iterate raises KeyboardInterrupt, since there
    is no plan to save.
    """
    begun = False

    def progress(words: str, iterate: Iterate) -> bool:
        nonlocal begun
        line = (
            f"{words}: iteration {iterate.number}, cost {iterate.cost:.6g}, violation "
            f"{iterate.violation:.1e}"
        )
        try:
            if report is not None:
                report(words, line)
        except KeyboardInterrupt:
            if not begun:
                raise
            return False
        begun = True
        return True

    return progress


def _best_start(
    problem: Problem[plan_schema.Plan], setup: Planning, watch: Watch
) -> tuple[SavedPlan | None, str, bool]:
    """Return the best plan of several starts, their table, and whether Ctrl-C ended the search.

    The plan is None if no start is solved.
    """
    count = max(problem.spec.plan.starts, len(setup.starts))
    with at(problem, ("plan",)):
        found, is_interrupted = solve_starts(problem, count, solve_start, watch.line)
    saved = found[0].saved if is_solved(found[0]) else None
    return saved, starts_words(found), is_interrupted


def solve_start(task: StartTask) -> StartResult:
    """Return the plan of one of several starts of a problem."""
    path, text, settings, number = task
    try:
        problem = validated_problem(lambda *_: PlanVerb.schema, path, text, settings)
        setup = PlanVerb().build(problem)
        first = _guess(setup, setup.starts[0])
        missing = problem.spec.plan.starts - len(setup.starts)
        if number < len(setup.starts):
            name, guess = _start_name(setup, number), _guess(setup, setup.starts[number])
        else:
            bounds = bounds_of(setup.dae, problem.spec.bounds)
            seed = problem.spec.plan.seed
            further = [*further_guesses(setup.dae, setup.start, first, bounds, missing, seed)]
            if number - len(setup.starts) >= len(further):
                return StartResult(number, None, None, "a perturbed guess cannot be simulated")
            name, guess = further[number - len(setup.starts)]
        found = find_plan(problem, setup, [guess], None, _going_on, float(first.t[-1]))
    except SlipfreeError as error:
        return StartResult(number, None, None, str(error))
    return start_result(number, name, found)


def _start_name(setup: Planning, number: int) -> str:
    """Return the name of an initial guess: its driving law, or ``inputs``, numbered if several."""
    name = setup.spec.driver.name if setup.spec.driver else "inputs"
    return name if len(setup.starts) == 1 else f"{name} {number + 1}"


def _going_on(_words: str, _iterate: Iterate) -> bool:
    return True


def _stopped(_words: str, _iterate: Iterate) -> bool:
    return False


def find_plan(
    problem: Problem[plan_schema.Plan],
    setup: Planning,
    guesses: list[Trajectory],
    resume: SavedPlan | None,
    progress: Callable[[str, Iterate], bool],
    length: float,
) -> Plan:
    """Return the plan of a problem; pressed wheels start from smoother load laws.

    Each plan starts from the one before. If a sharper law fails, the plan before it is returned.
    """
    spec, found, saved = problem.spec, None, resume
    for dae in (*([] if resume else _smoothed_models(problem, setup)), setup.dae):
        start = setup.start if dae is setup.dae else _settled_at(dae, setup)
        with at(problem, ("plan",)):
            now = plan(
                dae,
                start,
                [] if saved else guesses,
                **_plan_arguments(
                    problem,
                    spec,
                    setup.keep_out,
                    (dae, setup.vehicle, setup.terrain),
                    setup.between,
                ),
                **search_arguments(spec),
                duration=spec.plan.duration or (length, length),
                resume=saved,
                progress=progress,
            )
        if found is not None:
            if not now.success and now.run.outcome is not Outcome.INTERRUPTED:
                return found
            now = replace(now, stages=(*found.stages, *now.stages))
        if not now.success or dae is setup.dae:
            break
        found, saved = now, now.saved
    return now


def _smoothed_models(problem: Problem[plan_schema.Plan], setup: Planning) -> list[Dae]:
    """Return models of a rigid vehicle whose wheels lose their load over wider depths.

    The list is empty for a vehicle with exact contact.
    """
    if has_exact_closure(setup.vehicle):
        return []
    slip = slip_law(problem, problem.spec)
    return [
        direct_kinematics(setup.vehicle, setup.terrain, slip=slip, smoothing=width)
        for width in SMOOTHINGS
    ]


def _settled_at(dae: Dae, setup: Planning) -> Trajectory:
    """Return the start of a plan, settled for another model of the vehicle."""
    values: dict[str, Any] = {
        label.full: float(setup.start.of(label)[-1]) for label in leaves(dae.labels.x)
    }
    return settle(dae, options=setup.spec.solver.options, **values)


def _by_friction(setup: Planning, found: Plan | LongPlan) -> dict[str, str]:
    """Return the description of the quasi-static motion under the plan's inputs, if possible."""
    able = has_exact_closure(setup.vehicle) and setup.vehicle.mass and setup.terrain.has_friction
    if not (found.success and able and setup.spec.model != "quasi-static"):
        return {}
    model: Dae = quasi_statics(setup.vehicle, setup.terrain)
    options = setup.spec.solver.options
    options = replace(options, tolerance=max(options.tolerance, FRICTION_TOLERANCE))
    values: dict[str, Any] = {
        name: float(setup.start[name][0]) for name in {**setup.spec.start, "heading": 0.0}
    }
    try:
        start = settle(model, options=options, **values)
        run = simulate_plan(
            model,
            start,
            found.motion,
            step=setup.spec.time.step,
            options=options,
        )
    except (SlipfreeError, np.linalg.LinAlgError) as error:  # the plan is valid without it
        return {"by_friction": f"not simulated: {error}"}
    if run.stop is not None:
        return {"by_friction": outcome_words(run)}
    apart = np.hypot(*(run[name][-1] - found.replay[name][-1] for name in "xy"))
    slip = np.hypot(run["slip_along"], run["slip_across"])
    sliding = 1e3 * np.trapezoid(slip, run.t, axis=0).mean() / path_length(run)
    used = run["utilisation"].max()
    slides = " (a wheel slides)" if used > SLIDING else ""
    words = (
        f"ends {apart:.3g} m from the plan, slips {sliding:.3g} mm per wheel and metre, "
        f"utilisation at most {used:.3g}{slides}"
    )
    return {"by_friction": words}


def _by_stiffness(
    problem: Problem[plan_schema.Plan], setup: Planning, found: Plan
) -> dict[str, str]:
    """Return how far the motion with stiffer wheels ends from a plan with pressed wheels."""
    if has_exact_closure(setup.vehicle) or not found.success:
        return {}
    wheels = tuple(replace(w, static_depth=w.depth / STIFFER) for w in setup.vehicle.wheels)
    stiff, slip = replace(setup.vehicle, wheels=wheels), slip_law(problem, problem.spec)
    model: Dae = direct_kinematics(stiff, setup.terrain, slip=slip)
    step, options = setup.spec.time.step, setup.spec.solver.options
    try:
        start = _settled_at(model, setup)
        run = simulate_plan(model, start, found.motion, step=step, options=options)
    except SlipfreeError as error:  # the plan is valid without it
        return {"by_stiffness": f"not simulated: {error}"}
    if run.stop is not None:
        return {"by_stiffness": outcome_words(run)}
    apart = np.hypot(*(run[name][-1] - found.replay[name][-1] for name in "xy"))
    return {"by_stiffness": f"ends {apart:.3g} m from the plan"}


def _statistics(found: Plan | LongPlan) -> dict[str, float]:
    """Return the costs of a plan, and the errors of its simulation."""
    times = [stage.seconds for stage in found.stages]
    return {
        "plan_iterations": float(sum(stage.iterations for stage in found.stages)),
        "plan_seconds": sum(each["total"] for each in times),
        "plan_seconds_functions": sum(each["functions"] for each in times),
        **{f"plan_cost_{name}": value for name, value in found.costs.items()},
        **{f"plan_difference_{name}": value for name, value in found.difference.items()},
        **{
            f"plan_violation_{re.sub('[^a-zA-Z0-9.]+', '_', name).strip('_')}": size
            for name, size in found.violation.items()
        },
        "plan_compiled": float(found.compiled),
        "plan_intervals": float(found.motion.mesh.ends.size - 1),
    }


def poses_of_plan(
    run: Trajectory, arrays: Mapping[str, Array], terrain: Bicubic
) -> Trajectory | None:
    """Return the poses of the plan that a motion simulates; None if no plan is stored.

    The first quantities of the simulation, up to the contacts, are states and algebraic unknowns of
    the plan in the same order. The wheel angles are those of the simulation.
    """
    if f"{ARRAY_PREFIX}unknowns" not in arrays:
        return None
    saved = from_arrays(arrays, "result")
    course = saved.motion
    places = np.linspace(0, 1, min(MAX_SAMPLES, 10 * course.mesh.ends.size))
    rows = np.concatenate([course.states(places), course.algebraic(places)])
    rows = rows + saved.shift[: len(rows), None]
    columns, t, first = {}, run.t[0] + places * course.duration, 0
    for name, column in run.columns.items():
        if name == "contact_x":
            break
        columns[name] = Column(column.label, rows[first])
        first += 1
    # contacts are unknowns wheel by wheel: x and y of the first wheel, then of the next
    pairs = rows[first : first + 2 * len(run.wheels)].reshape(len(run.wheels), 2, -1)
    for axis, name in enumerate(("contact_x", "contact_y")):
        columns[name] = Column(run.columns[name].label, pairs[:, axis].T)
    columns["wheel_angle"] = wheel_angles_at(run, t)
    height = terrain.elevation(columns["contact_x"].values, columns["contact_y"].values)
    columns["contact_z"] = Column(run.columns["contact_z"].label, height)
    return Trajectory(t, columns, run.wheels)
