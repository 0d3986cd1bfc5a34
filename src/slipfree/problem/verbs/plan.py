"""Plans: inputs that reach a goal at least cost, and the resulting motion."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from slipfree.contact.closure import has_exact_closure
from slipfree.dae import Dae
from slipfree.errors import SlipfreeError
from slipfree.laws.soil import Soil
from slipfree.models.dynamics import dynamics
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.quasi_statics import quasi_statics
from slipfree.outcome import Outcome
from slipfree.plan.constraints import COST
from slipfree.plan.convergence import convergence_arrays, convergence_from
from slipfree.plan.ipopt import SOLVED_STATUS, STOPPED_STATUS, Iterate
from slipfree.plan.messages import DURATION, missed_words
from slipfree.plan.plan import Plan, PlanProgress
from slipfree.plan.polynomial_motion import motion_of
from slipfree.plan.prices import prices_words
from slipfree.plan.verification import simulate_plan
from slipfree.plan.warm_start import ARRAY_PREFIX, SavedPlan, from_arrays
from slipfree.plan.windows import LongPlan
from slipfree.problem.build_common import (
    Setup,
    wheel_angles_at,
)
from slipfree.problem.build_ground import at
from slipfree.problem.build_model import model_law
from slipfree.problem.problem import Problem
from slipfree.problem.summary import Facts
from slipfree.problem.verbs import plan_schema
from slipfree.problem.verbs.base import (
    RESUME,
    Quantity,
    Result,
    Solution,
    Watch,
    differences,
    with_diagnostics,
)
from slipfree.problem.verbs.driving import Diagnostic, DriveVerb, model_attributes
from slipfree.problem.verbs.plan_facts import CHECKS, plan_facts
from slipfree.problem.verbs.plan_goals import regions, spelled
from slipfree.problem.verbs.plan_over_solids import (
    OverSolids,
    build_over_solids,
    drive_over_solids,
)
from slipfree.problem.verbs.plan_robust import UNTESTED, Tested, make_robust
from slipfree.problem.verbs.plan_search import find_plan, guess_motion
from slipfree.problem.verbs.plan_setup import (
    Planning,
    build_planning,
    plan_arguments,
    settled_start,
)
from slipfree.problem.verbs.plan_starts import best_start
from slipfree.problem.verbs.plan_windows import (
    long_plan,
    windows_words,
)
from slipfree.records import Array, leaves
from slipfree.solve.options import SolverOptions
from slipfree.solve.settle import SPEED, settle
from slipfree.solve.simulate import simulate
from slipfree.solve.whole_turns import TURN
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

if TYPE_CHECKING:
    from slipfree.show.drive_scene import Driven
    from slipfree.show.plots import Plot

MAX_SAMPLES = 401  # largest number of samples of a plan in the viewer
PATH_SAMPLES = 121  # samples of the path of an iterate
ROUNDING = 1e-6  # smaller violations count as rounding, in the unit of the limit
STIFFER = 10.0  # factor of the stiffness in a second simulation of pressed wheels
SLIDING = 0.95  # wheels with a larger utilisation count as sliding
FORCE_LIMITS = {"drive_torque", "utilisation", "friction_needed", "force_normal"}
OFFER = (
    'no slow motion was found within these limits; set model = "dynamics" to plan with momentum: '
    "inertia then carries the vehicle where its drives alone do not"
)
GUESS_ARRAYS = ("guess_x", "guess_y")  # names of the arrays in a file
FRICTION_TOLERANCE = 1e-6  # smallest tolerance of quasi-statics, which may fail to settle below it


class PlanVerb(DriveVerb):
    """Planning: inputs that reach a goal at least cost, and the resulting motion."""

    schema = plan_schema.Plan
    options = (RESUME,)
    is_timed = False
    checks = (*DriveVerb.checks, *CHECKS)
    metrics_shown = ("within_limits", "plan_violation", "slip_rms")

    def build(self, problem: Problem[plan_schema.Plan]) -> Setup:
        """Return the model, the settled start and the inputs of the initial guess.

        Over solids, return the plan and the set-up of its simulation.
        """
        if problem.spec.terrain.obstacles:
            return build_over_solids(problem)
        return build_planning(problem)

    def drive(
        self,
        problem: Problem[plan_schema.Plan],
        setup: Planning | OverSolids,
        watch: Watch,
        resume: SavedPlan | None,
    ) -> tuple[Trajectory, Mapping[str, Array]]:
        """Return the simulated motion of a plan, and the plan as arrays for a warm start."""
        if isinstance(setup, OverSolids):
            return drive_over_solids(problem, setup, watch)
        spec = problem.spec
        progress, table = _iterate_reporter(watch, setup), ""
        if spec.plan.window is not None:
            return self._drive_windows(problem, setup, watch, progress, resume)
        if resume is None and spec.plan.starts > 1:
            resume, table, is_interrupted = best_start(problem, setup, watch.line)
            progress = _stopped if is_interrupted else progress
        with at(problem, ("driver" if spec.driver else "inputs",)):
            guesses = [] if resume else [guess_motion(setup, start) for start in setup.starts]
        length = resume.motion.duration if resume else float(guesses[0].t[-1])
        attributes = {"plan_starts": table} if table else {}

        def described(found: Plan, run: Trajectory) -> tuple[Trajectory, Mapping[str, Array]]:
            run, arrays = _described(spec, setup, found, run, attributes)
            return run, {**arrays, **_guess_arrays(guesses)}

        def keep(found: Plan) -> None:
            run, arrays = described(found, found.replay)
            watch.keep(Solution(run, setup, arrays))

        found = find_plan(problem, setup, guesses, resume, progress, length, keep=keep)
        tested = Tested(found)
        if spec.plan.robust is not None and found.accurate:
            keep(replace(found, replay=replace(found.replay, stop=UNTESTED)))
            tested = make_robust(problem, setup, found, spec.plan.robust, progress, watch.line)
            found = tested.plan
        run, stop = found.replay, tested.stop or with_offer(setup, found, guesses)
        if stop is not None and (tested.stop or not found.success):
            run = replace(run, stop=stop._replace(t=float(run.t[-1])))
        attributes |= {"plan_robust": tested.words} if tested.words else {}
        run = replace(run, statistics={**run.statistics, **tested.statistics})
        run, arrays = described(found, run)
        diagnostics: dict[str, Diagnostic] = {
            "optimality": partial(_with_optimality, found),
            "by_friction": lambda run: _with_words(run, _by_friction(setup, found)),
            "by_stiffness": lambda run: _with_words(run, _by_stiffness(problem, setup, found)),
            "in_soil": lambda run: _with_words(run, _in_soil(problem, setup, found)),
            "momentum": lambda run: _with_words(run, _momentum(setup, found)),
        }
        run = with_diagnostics(
            run, diagnostics, lambda run: watch.keep(Solution(run, setup, arrays))
        )
        return run, arrays

    def _drive_windows(
        self,
        problem: Problem[plan_schema.Plan],
        setup: Planning,
        watch: Watch,
        progress: PlanProgress,
        resume: SavedPlan | None,
    ) -> tuple[Trajectory, Mapping[str, Array]]:
        """Return the simulated motion of a plan in windows, and the plan as arrays."""
        spec, model = problem.spec, (setup.dae, setup.vehicle, setup.terrain)
        arguments = plan_arguments(spec, setup.keep_out, model, setup.between)

        def described(found: LongPlan) -> tuple[Trajectory, Mapping[str, Array]]:
            attributes = {"plan_windows": windows_words(found)}
            return _described(spec, setup, found, found.replay, attributes)

        def keep(found: LongPlan) -> None:
            run, arrays = described(found)
            watch.keep(Solution(run, setup, arrays))

        found = long_plan(problem, setup, setup.paths[0], arguments, resume, progress, keep)
        run, arrays = described(found)
        diagnostics = {"by_friction": lambda run: _with_words(run, _by_friction(setup, found))}
        run = with_diagnostics(
            run, diagnostics, lambda run: watch.keep(Solution(run, setup, arrays))
        )
        return run, arrays

    def attributes(self, problem: Problem[Any], setup: Setup) -> dict[str, str]:
        """Return the attributes of the result, including model and law."""
        return super().attributes(problem, setup) | model_attributes(problem.spec)

    def describe_samples(self, problem: Problem[plan_schema.Plan], setup: Setup) -> str:
        """Return the description of the sampling, without the duration, which may be unknown."""
        return f"{problem.spec.time.step:g} s apart or less, depending on the intervals of the plan"

    def own_facts(self, run: Trajectory) -> Facts:
        """Return the facts about the plan: costs, simulation, optimality, slip and friction."""
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
        from slipfree.show.plan_figures import convergence_plots, plan_plots

        if result.problem.spec.terrain.obstacles:
            return super().figures(result)
        setup, run = result.setup or build_planning(result.problem), result.trajectory
        guess = [result.arrays[name] for name in GUESS_ARRAYS if name in result.arrays]
        options = figure_options(setup) | ({"guess": np.stack(guess, axis=1)} if guess else {})
        plots = plan_plots(run, setup.ground.grid, setup.layers, **options)
        names = run.attributes.get("plan_searches", "").splitlines()
        searches = convergence_plots(run, convergence_from(result.arrays), names)
        motion = super().figures(replace(result, setup=setup))
        if run.stop is not None:  # the search explains why there is no plan
            return *plots, *searches, *motion
        return *plots, *motion, *searches

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
    """Return the simulation of a plan with attributes and statistics, and the plan as arrays.

    If the plan is not accurate, the motion gets a stop that says so.
    """
    if run.stop is None and not found.accurate:
        run = replace(run, stop=_inaccurate(spec, found))
    attributes = {
        **run.attributes,
        **_turns(spec, setup, found),
        **_violations(found, spec.plan.accuracy),
        **attributes,
        "plan_searches": "\n".join(stage.words for stage in found.stages),
    }
    statistics = {**run.statistics, **_statistics(found)}
    arrays = convergence_arrays([stage.convergence for stage in found.stages])
    return replace(run, attributes=attributes, statistics=statistics), found.saved.arrays | arrays


def _guess_arrays(guesses: Sequence[Trajectory]) -> dict[str, Array]:
    """Return the paths of the initial guesses in map coordinates [m], with NaN between them."""
    gap = np.array([np.nan])
    return {
        name: np.concatenate([part for run in guesses for part in (run[axis], gap)])
        for name, axis in zip(GUESS_ARRAYS, "xy", strict=True)
        if guesses
    }


def figure_options(setup: Planning) -> dict[str, Any]:
    """Return the keyword arguments of `plan_plots` for a plan."""
    unbounded = {label.name: (-np.inf, np.inf) for label in leaves(setup.dae.labels.u)}
    return {
        "places": setup.places,
        "found": setup.paths,
        "bounds": unbounded | setup.spec.bounds,
        "limits": setup.spec.limits,
    }


def _turns(spec: plan_schema.Plan, setup: Planning, found: Plan | LongPlan) -> dict[str, str]:
    """Return the description of angles that differ by whole turns from the goal or the plan."""
    words = []
    end = found.motion.states(np.ones(1))[:, 0] + setup.dae.shift[0] if found.success else ()
    for label, value in zip(leaves(setup.dae.labels.x), end, strict=False):
        if label.unit != "rad":
            continue
        name = label.full
        apart = round((float(found.replay.of(label)[-1]) - value) / TURN)
        if apart and found.accurate:
            words.append(
                f"{name} ends {_turn_words(apart)} in the simulation than in the plan: the same "
                "position, after a swing to the other side"
            )
        low, high = spec.goal.get(name, (-np.inf, np.inf))
        reached = float(value) + setup.dae.reported.get(name, 0.0)
        turns = round((reached - (low + high) / 2) / TURN) if high - low < TURN else 0
        if turns and not low - np.pi < reached < high + np.pi:
            words.append(
                f"{name} is {reached:.6g} rad at the end, {_turn_words(turns)} than "
                f"{spelled((low, high))}: the same position, reached the short way"
            )
    return {"plan_turns": "; ".join(words)} if words else {}


def _turn_words(turns: int) -> str:
    count = "a turn" if abs(turns) == 1 else f"{abs(turns)} turns"
    return f"{count} {'more' if turns > 0 else 'less'}"


def _violations(found: Plan | LongPlan, accuracy: float) -> dict[str, str]:
    """Return the description of violations in the simulation, as an attribute; empty if none."""
    sizes = {name: size for name, size in found.violation.items() if size > ROUNDING}
    if not sizes:
        return {}
    words = missed_words(sizes, found.units)
    return {"plan_violations": f"{words}; plan.accuracy allows {accuracy:g}"}


def _with_words(run: Trajectory, attributes: Mapping[str, str]) -> Trajectory:
    """Return a motion with further attributes."""
    return replace(run, attributes={**run.attributes, **attributes})


def _with_optimality(found: Plan, run: Trajectory) -> Trajectory:
    """Return a motion with second-order conditions and prices of its plan, if it is solved."""
    prices = {
        f"plan_price_{price.label.name}": price.rate
        for price in found.prices
        if price.role in (COST, DURATION)
    }
    run = replace(run, statistics={**run.statistics, **prices})
    if found.optimality is None:
        return run
    words = {"plan_optimality": found.optimality.words, "plan_prices": prices_words(found.prices)}
    return _with_words(run, words)


def _inaccurate(spec: plan_schema.Plan, found: Plan | LongPlan) -> Stop:
    """Return the stop of a solved plan whose simulation misses the required accuracy."""
    sizes = found.difference | found.violation
    parts = {name: size for name, size in sizes.items() if size > spec.plan.accuracy}
    worst = missed_words(parts, found.units) or "a narrow limit"
    last = found.stages[-1]
    advice = "raise plan.intervals or plan.accuracy"
    further = f"its mesh was not refined any further; {advice}"
    if last.words.endswith("intervals"):
        further = "refinements of its mesh did not suffice; raise plan.accuracy"
    why = {
        SOLVED_STATUS: further,
        STOPPED_STATUS: "the refinement of its mesh was stopped",
    }.get(last.status, f"with {last.words} {ipopt_words(last.status)}; {advice}")
    words = (
        f"the plan is solved, but its simulation misses {worst}; plan.accuracy allows "
        f"{spec.plan.accuracy:g}: {why}"
    )
    outcome = Outcome.INTERRUPTED if last.status == STOPPED_STATUS else Outcome.INACCURATE
    return Stop(PLAN_ACCURACY, float(found.replay.t[-1]), words, outcome)


def _iterate_reporter(watch: Watch, setup: Planning) -> Callable[[str, Iterate], bool]:
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
            if watch.line is not None:
                watch.line(words, line)
            if watch.path is not None:
                watch.path(_path_of(iterate, setup))
        except KeyboardInterrupt:
            if not begun:
                raise
            return False
        begun = True
        return True

    return progress


def _path_of(iterate: Iterate, setup: Planning) -> Array:
    """Return the path of the platform in an iterate, in map coordinates, shape (n, 2) [m]."""
    names = [label.full for label in leaves(setup.dae.labels.x)]
    states = motion_of(iterate.program, iterate.unknowns).states(np.linspace(0, 1, PATH_SAMPLES))
    local = np.stack([states[names.index("x")], states[names.index("y")]], axis=1)
    return np.asarray(local + setup.terrain.origin[:2])


def _by_friction(setup: Planning, found: Plan | LongPlan) -> dict[str, str]:
    """Return the description of the quasi-static motion under the plan's inputs, as an attribute.

    The result is empty without mass, friction or exact contact, for plans with forces, and for
    plans that are not solved.
    """
    able = has_exact_closure(setup.vehicle) and setup.vehicle.mass and setup.terrain.has_friction
    if not (found.success and able and setup.spec.model == "kinematics"):
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
    """Return the description of the motion with stiffer wheels under the plan's inputs.

    The description is an attribute: the distance between the ends of plan and motion. The result is
    empty for a vehicle with exact contact, a plan with inertia, and a plan that is not solved.
    """
    if has_exact_closure(setup.vehicle) or not found.success or setup.spec.model == "dynamics":
        return {}
    wheels = tuple(replace(w, static_depth=w.depth / STIFFER) for w in setup.vehicle.wheels)
    stiff, slip = replace(setup.vehicle, wheels=wheels), model_law(problem, problem.spec)
    model: Dae = direct_kinematics(stiff, setup.terrain, slip=slip)
    step, options = setup.spec.time.step, setup.spec.solver.options
    try:
        start = settled_start(model, setup)
        run = simulate_plan(model, start, found.motion, step=step, options=options)
    except SlipfreeError as error:  # the plan is valid without it
        return {"by_stiffness": f"not simulated: {error}"}
    if run.stop is not None:
        return {"by_stiffness": outcome_words(run)}
    apart = np.hypot(*(run[name][-1] - found.replay[name][-1] for name in "xy"))
    return {"by_stiffness": f"ends {apart:.3g} m from the plan"}


def _in_soil(problem: Problem[plan_schema.Plan], setup: Planning, found: Plan) -> dict[str, str]:
    """Return the description of the motion in soil with inertia under the plan's inputs.

    The description is an attribute: the distance between the ends of plan and motion, and slip,
    sinkage and work of both. The result is empty for other plans, and for plans that are not
    solved.
    """
    law = model_law(problem, problem.spec)
    if not (found.success and setup.spec.model == "quasi-static" and isinstance(law, Soil)):
        return {}
    step, options = setup.spec.time.step, setup.spec.solver.options
    values: dict[str, Any] = {
        name: float(setup.start[name][0]) for name in {**setup.spec.start, "heading": 0.0}
    }
    try:
        model: Dae = dynamics(setup.vehicle, setup.terrain, law=law)
        values[SPEED] = initial_speed(found.replay)
        start = settle(model, options=options, **values)
        run = simulate_plan(model, start, found.motion, step=step, options=options)
    except SlipfreeError as error:  # the plan is valid without it
        return {"in_soil": f"not simulated: {error}"}
    if run.stop is not None:
        return {"in_soil": outcome_words(run)}
    apart = np.hypot(*(run[name][-1] - found.replay[name][-1] for name in "xy"))
    works = [each["work"][-1] - each["work"][0] for each in (run, found.replay)]
    words = (
        f"ends {apart:.3g} m from the plan, slip ratio {run['slip_ratio'].max():.3g} at most, "
        f"sinkage {1e3 * run['depth'].max():.3g} mm at most, work {works[0]:.4g} J (plan: "
        f"{found.replay['slip_ratio'].max():.3g}, {1e3 * found.replay['sinkage'].max():.3g} mm, "
        f"{works[1]:.4g} J)"
    )
    return {"in_soil": words}


def initial_speed(run: Trajectory) -> float:
    """Return the speed of a motion along the forward axis of the platform at its start [m/s]."""
    heading, pitch = run["heading"][0], run["pitch"][0]
    level = run["velocity_y"][0] * np.cos(heading) - run["velocity_x"][0] * np.sin(heading)
    return float(level * np.cos(pitch) + run["velocity_z"][0] * np.sin(pitch))


def with_offer(setup: Planning, found: Plan, guesses: Sequence[Trajectory]) -> Stop | None:
    """Return the stop of a plan; after a failed slow plan, it suggests a plan with momentum."""
    stop, spec = found.run.stop, setup.spec
    slow = spec.model == "quasi-static" or FORCE_LIMITS & {*spec.limits}
    if stop is None or not slow or stop.outcome not in (Outcome.INFEASIBLE, Outcome.SOLVER_FAILURE):
        return stop
    needs = [words for words in (_torque_need(setup, guess) for guess in guesses[:1]) if words]
    return stop._replace(words="\n".join([stop.words, *needs, OFFER]))


def _torque_need(setup: Planning, guess: Trajectory) -> str:
    """Return a text on the torques of an initial guess that exceed their limit, or an empty one."""
    bounds = setup.spec.limits.get("drive_torque")
    if bounds is None or "drive_torque" not in guess:
        return ""
    needed = guess["drive_torque"].sum(axis=1)
    k, most = int(needed.argmax()), bounds[1] * sum(wheel.driven for wheel in setup.vehicle.wheels)
    if needed[k] <= most:
        return ""
    return (
        f"slow driving along the initial guess needs torques of {needed[k]:.3g} N m in all (at x = "
        f"{guess['x'][k]:.2f} m, y = {guess['y'][k]:.2f} m), limits.drive_torque allows {most:.3g} "
        "N m"
    )


def _momentum(setup: Planning, found: Plan) -> dict[str, str]:
    """Return the descriptions of the simulation of a plan with inertia, as attributes.

    They are the distance from the plan, the loads of the wheels, and the torques that the same path
    needs without inertia. The result is empty for other plans.
    """
    if setup.spec.model != "dynamics":
        return {}
    run, replay = found.run, found.replay
    away = max(found.difference[name] for name in "xyz")
    loads = [(each["force_normal"].min(axis=0), each.wheels) for each in (run, replay)]
    planned, simulated = (
        f"{least.min():.3g} N ({names[least.argmin()]})" for least, names in loads
    )
    words = (
        f"on compliant contacts the platform stays within {1e3 * away:.2g} mm of the plan; least "
        f"normal force of a wheel {planned} in the plan, {simulated} in the simulation"
    )
    return {"plan_replay": words, **({"plan_slow": _slowly(setup, found)} if found.success else {})}


def _slowly(setup: Planning, found: Plan) -> str:
    """Return the description of the quasi-static motion at the wheel rates of a plan."""
    run = found.run
    try:
        model: Dae = quasi_statics(setup.vehicle, setup.terrain)
        start = settled_start(model, setup)
        wheels = [
            name for name, w in zip(run.wheels, setup.vehicle.wheels, strict=True) if w.driven
        ]
        rates = {f"{name}_rate": run["wheel_rate", name] for name in wheels}
        for c in setup.vehicle.of("commanded"):
            rates[f"{c.name}_rate"] = run[f"{c.name}_speed"]
        middles = {name: (rate[1:] + rate[:-1]) / 2 for name, rate in rates.items()}
        options = SolverOptions(tolerance=FRICTION_TOLERANCE)
        slow = simulate(model, start, model.inputs(**middles), run.t, options=options)
    except SolverError as error:
        if error.trajectory is None:
            return f"not simulated: {error}"
        slow = error.trajectory
    except (SlipfreeError, np.linalg.LinAlgError) as error:  # the plan is valid without it
        return f"not simulated: {error}"
    needed, used = (np.abs(each["drive_torque"].sum(axis=1)) for each in (slow, run))
    k = int(needed.argmax())
    words = (
        f"without inertia the same path needs torques of {needed[k]:.3g} N m in all (at x = "
        f"{slow['x'][k]:.2f} m, y = {slow['y'][k]:.2f} m); the plan needs at most "
        f"{used.max():.3g} N m"
    )
    return words if slow.stop is None else f"{words}; {outcome_words(slow)}"


def _stopped(_words: str, _iterate: Iterate) -> bool:
    return False


def _statistics(found: Plan | LongPlan) -> dict[str, float]:
    """Return the statistics of a plan: iterations, times, costs, and errors of its simulation."""
    times = [stage.seconds for stage in found.stages]
    return {
        "plan_iterations": float(sum(stage.iterations for stage in found.stages)),
        "plan_seconds": sum(each["total"] for each in times),
        "plan_seconds_functions": sum(each["functions"] for each in times),
        **{f"plan_cost_{name}": value for name, value in found.costs.items()},
        **{f"plan_difference_{name}": value for name, value in _by_quantity(found).items()},
        **{
            f"plan_violation_{re.sub('[^a-zA-Z0-9.]+', '_', name).strip('_')}": size
            for name, size in found.violation.items()
        },
        "plan_compiled": float(found.compiled),
        "plan_intervals": float(found.motion.mesh.ends.size - 1),
    }


def _by_quantity(found: Plan | LongPlan) -> dict[str, float]:
    """Return the largest difference of each quantity, over the wheels for quantities of wheels."""
    sizes = dict[str, float]()
    for name, size in found.difference.items():
        quantity = name.partition("[")[0]
        sizes[quantity] = max(size, sizes.get(quantity, 0.0))
    return sizes


def poses_of_plan(
    run: Trajectory, arrays: Mapping[str, Array], terrain: Bicubic
) -> Trajectory | None:
    """Return the poses of the plan that a motion simulates; None if no plan is stored.

    The result is also None for a plan with inertia, which has other unknowns than its simulation.

    The first quantities of the simulation, up to the contacts, are states and algebraic unknowns of
    the plan in the same order. The wheel angles are those of the simulation.
    """
    if f"{ARRAY_PREFIX}unknowns" not in arrays or "kinetic_energy" in run:
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
