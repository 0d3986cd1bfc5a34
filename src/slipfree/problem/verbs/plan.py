"""Plans: inputs that reach a goal at least cost, and the resulting motion.

Over solids, the plan of a step climber is a time scaling along the contact path, leg by leg.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slipfree.catalog import check_climber
from slipfree.climb import contact_path
from slipfree.contact.closure import has_exact_closure
from slipfree.control.path_following import follow
from slipfree.control.step_climbing import climbing
from slipfree.core import trajectory
from slipfree.core.dae import Dae, PiecewiseLinear
from slipfree.core.errors import ModelError, SlipfreeError
from slipfree.core.facts import Fact, Facts, named_rows, starting_with
from slipfree.core.records import Array, leaves
from slipfree.core.trajectory import Outcome, Trajectory, ipopt_words
from slipfree.files.netcdf import NOTHING
from slipfree.files.toml import Fault, problem_error
from slipfree.geometry.path import Path
from slipfree.laws.compliant import Compliant
from slipfree.laws.protocols import ContactLaw
from slipfree.laws.soil import Soil
from slipfree.models.dynamics import dynamics
from slipfree.models.kinematics import quasi_statics
from slipfree.plan import ipopt
from slipfree.plan.constraints import COST, DURATION, missed_words
from slipfree.plan.guess import settled_start
from slipfree.plan.optimality import VALUE, Optimality, price_rows, prices_words
from slipfree.plan.plan import Plan
from slipfree.plan.polynomial_motion import ARRAY_PREFIX, SavedPlan, from_arrays, motion_of
from slipfree.plan.problem import spelled
from slipfree.plan.verification import obstacle_words, simulate_plan
from slipfree.plan.windows import LongPlan, plan_windows
from slipfree.problem import build
from slipfree.problem.build import Setup, World, model_law, wheel_angles_at
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem
from slipfree.problem.schema import STEP_CLIMBING, Modelled
from slipfree.problem.verbs import base, plan_search, plan_setup
from slipfree.routing.search import separation_words
from slipfree.solve.sampling import TURN, input_samples
from slipfree.solve.settle import SPEED, settle
from slipfree.solve.simulate import simulate_to_failure
from slipfree.solve.system import SolverOptions
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.solids import Profile
from slipfree.vehicle.tree import Vehicle

if TYPE_CHECKING:
    from slipfree.show.plots import Plot
    from slipfree.show.scene import Driven


DIFFERENCE, VIOLATION, PLAN_COST = "plan_difference_", "plan_violation_", "plan_cost_"
ROUNDING = 1e-6  # smaller violations count as rounding, in the unit of the limit
SLIDING = 0.95  # wheels with a larger utilisation count as sliding
DETOUR = 1.5  # paths that are longer than this number of distances are detours
MOVING = 0.02  # smaller steps of a path, in its largest step, have no direction
UNUSABLE = Outcome.INACCURATE, Outcome.LIMIT  # outcomes of solved plans that cannot be driven
ROWS = named_rows("plan")


def facts_of(plan: Plan | LongPlan, setup: plan_setup.Planning) -> dict[str, Fact]:
    """Return the facts of a plan: iterations, times, costs, and what its simulation has found.

    These are the largest differences between both motions by quantity, and the violations.
    """
    times = [stage.seconds for stage in plan.stages]
    ended = {stage.status for stage in plan.stages} if plan.accurate else set[str]()
    # why an accurate plan may not be the one of least cost: the last reason is stated
    reasons = [why for status, why in ipopt.NOT_LEAST.items() if status in ended]
    differences = dict[str, Fact]()
    for name, size in plan.difference.items():
        key = DIFFERENCE + name.partition("[")[0]  # the largest of the wheels
        if key not in differences or size > differences[key].value:
            differences[key] = Fact(size, plan.units[name])
    return {
        "plan_iterations": Fact(sum(stage.iterations for stage in plan.stages), "1"),
        "plan_seconds": Fact(sum(each["total"] for each in times), "s"),
        "plan_seconds_functions": Fact(sum(each["functions"] for each in times), "s"),
        **{f"{PLAN_COST}{name}": Fact(value) for name, value in plan.costs.items()},
        **differences,
        **{
            VIOLATION + re.sub("[^a-zA-Z0-9.]+", "_", name).strip("_"): Fact(
                size, plan.units[name], name
            )
            for name, size in plan.violation.items()
        },
        "plan_accuracy": Fact(setup.spec.plan.accuracy),
        "plan_compiled": Fact(float(plan.compiled), "1"),
        "plan_intervals": Fact(plan.motion.mesh.ends.size - 1, "1"),
        "plan_searches": Fact([stage.words for stage in plan.stages]),
        **_turns(setup, plan),
        **({"plan_not_least": Fact(reasons[-1])} if reasons else {}),
    }


def _turns(setup: plan_setup.Planning, plan: Plan | LongPlan) -> dict[str, Fact]:
    """Return sentences about angles that differ by whole turns from the goal."""
    sentences = list[str]()
    end = plan.motion.states(np.ones(1))[:, 0] + setup.dae.shift[0] if plan.success else ()
    for label, value in zip(leaves(setup.dae.labels.x), end, strict=False):
        name = label.full
        low, high = setup.spec.goal.get(name, (-np.inf, np.inf))
        reached = float(value) + setup.dae.reported.get(name, 0.0)
        turns = round((reached - (low + high) / 2) / TURN) if high - low < TURN else 0
        if label.unit == "rad" and turns and not low - np.pi < reached < high + np.pi:
            count = "a turn" if abs(turns) == 1 else f"{abs(turns)} turns"
            sentences.append(
                f"{name} is {Fact(reached):.6g>deg} at the end, {count} "
                f"{'more' if turns > 0 else 'less'} than {spelled((low, high), 'rad')}: the same "
                "position, reached the short way"
            )
    return {"plan_turns": Fact(sentences)} if sentences else {}


def optimality_facts(plan: Plan) -> dict[str, Fact]:
    """Return the second-order conditions and the prices of the limits of a solved plan.

    A price is in units of the cost per unit of the bound, which differ from plan to plan; its fact
    has no unit.
    """
    facts = {
        f"plan_price_{price.label.name}": Fact(price.rate)
        for price in plan.prices
        if price.role in (COST, DURATION)
    }
    if plan.optimality is None:
        return facts
    checked = {f"plan_{name}": Fact(v, "1") for name, v in plan.optimality._asdict().items()}
    return {**facts, **checked, "plan_prices": Fact(price_rows(plan.prices))}


def described(run: Trajectory) -> dict[str, Fact]:
    """Return the facts of a plan in words, and its largest violation of limits."""
    facts = run.facts
    sizes = [fact.value for fact in starting_with(VIOLATION, facts).values()]
    violation = max(sizes, default=0.0)
    is_kept = run.stop is None and violation <= facts["plan_accuracy"].value
    is_solved = run.stop is None or run.stop.name != trajectory.PLAN
    texts = {"simulated": _simulated_words(facts, is_solved=is_solved)}
    if not is_solved:
        texts["iterate"] = "the motion is that of an iterate, not of a solution"
    if facts.get("friction_utilisation_largest", Fact(0.0)).value > SLIDING:
        texts["slides"] = "a wheel slides"
    if "plan_windows" in facts:
        rows = facts["plan_windows"].value
        metres, seconds = rows[-1]["end"], sum(row["seconds"] for row in rows)
        inaccurate = ", ".join(f"{row['t']:.6g} s" for row in rows if not row["accurate"])
        texts["windows"] = (
            f"{len(rows)} windows up to {metres:.6g} m of the route, "
            f"{max(row['iterations'] for row in rows)} iterations at most, "
            f"{1e3 * seconds / metres:.3g} s of search per kilometre"
            + (f"; not accurate: those that begin at {inaccurate}" if inaccurate else "")
        )
    if "plan_starts" in facts:
        texts["start_count"] = str(len(facts["plan_starts"].value))
    if "plan_curvature" in facts:
        checked = Optimality(*(facts[f"plan_{name}"].value for name in Optimality._fields))
        prices = facts["plan_prices"].value
        texts |= {"optimality": checked.words, "prices": prices_words(prices)}
        own = [each for each in prices if each["role"] == DURATION and each["side"] != VALUE]
        texts |= {"limited_by": prices_words(own)} if own else {}
    return {
        **{name: Fact(text) for name, text in texts.items()},
        **_path_facts(run),
        "plan_violation": Fact(violation),
        "within_limits": Fact(float(is_kept), "1"),
    }


def _path_facts(run: Trajectory) -> dict[str, Fact]:
    """Return a sentence about a path that reverses, or is much longer than its distance."""
    x, y, yaw = (run[name] for name in ("x", "y", "yaw"))
    ahead = np.diff(x) * np.cos(yaw[1:]) + np.diff(y) * np.sin(yaw[1:])
    signs = np.sign(ahead[np.abs(ahead) > MOVING * np.abs(ahead).max()])
    reversals = np.count_nonzero(np.diff(signs))
    length, distance = trajectory.path_length(run), float(np.hypot(x[-1] - x[0], y[-1] - y[0]))
    words = [f"reverses {reversals} times" if reversals > 1 else "reverses once"][: int(reversals)]
    if length > DETOUR * distance:
        words.append(f"{length:.3g} m long for {distance:.3g} m from start to end")
        if f"{PLAN_COST}slip" in run.facts:
            words.append("a smaller weight costs.slip may shorten it")
    return {"plan_path": Fact("; ".join(words))} if words else {}


def _simulated_words(facts: Facts, *, is_solved: bool) -> str:
    """Return the line on the simulation of a plan: deviations and violations."""
    gaps = starting_with(DIFFERENCE, facts)
    if not gaps:
        return "not yet; the motion is that of the plan"

    def read(fact: Fact) -> str:
        return format(fact, {"m": ".2g>mm", "rad": ".2g>deg"}.get(fact.unit, ".2g"))

    ascending = sorted(gaps.items(), key=lambda each: each[1].value)
    largest = dict.fromkeys((gap.unit for gap in gaps.values()), "")  # in the order of the states
    largest |= {gap.unit: f"{name} {read(gap)}" for name, gap in ascending}
    listed = ", ".join(largest.values())
    words = f"differs from the {'plan' if is_solved else 'iterate'} by at most {listed}"
    if not is_solved:  # the outcome names the violations
        return words
    violations = [f for f in starting_with(VIOLATION, facts).values() if f.value > ROUNDING]
    if not violations:
        return f"{words}; meets all constraints"
    missed = ", ".join(f"{fact.words} by {read(fact)}" for fact in violations)
    accuracy = facts["plan_accuracy"].value
    if all(fact.value <= accuracy for fact in violations):
        return f"{words}; violates constraints by less than plan.accuracy, {accuracy:g}: {missed}"
    return f"{words}; violates {missed}; plan.accuracy allows {accuracy:g}"


# Plans of a step climber over solids: time scaling along the contact path, leg by leg

KEYS = {
    "": {"goal", "costs", "limits", "plan", "driver"},
    "goal": {"y"},
    "costs": {*contact_path.COSTS},
    "limits": {"utilisation"},
    "plan": {"intervals"},
    "driver": {"name", "speed", "control"},
    "driver.control": {"proportional", "torque", "motors"},
}  # supported keys of plans over solids, by table; other keys of plans are errors
LEG_INTERVALS = 40  # default number per leg
OF_PLANS = {*plan_setup.PlanKeys.model_fields} - {*Modelled.model_fields}


class Planned(NamedTuple):
    """Plan of a climb: program, solution and history of every leg, and the solver's effort."""

    parts: tuple[tuple[contact_path.Climb, Array, contact_path.ClimbHistory], ...]
    least: tuple[float, ...]  # smallest sufficient friction of each leg [1]
    iterations: float
    seconds: float  # computing time of the solver [s]
    functions: float  # part of it in functions [s]


@dataclass(frozen=True, eq=False)
class OverSolids(Setup):
    """Set-up of the simulation of a plan over solids; ``dae`` has the controller that tracks it."""

    plan: Planned


def build_over_solids(problem: Problem[plan_setup.PlanKeys]) -> OverSolids:
    """Return the plan of a problem over solids, and the set-up of its simulation.

    SolverError is raised if a leg needs more friction than is available, or has no plan.
    """
    spec, driver = problem.spec, problem.spec.driver
    faults = [*_faults(spec)]
    if faults or driver is None:
        raise problem_error(problem.source, faults)
    world = build.build_world(problem)
    model = build.build_shared_model(problem, world)
    with at(problem, ("vehicle",)):
        check_climber(world.vehicle)
    with at(problem, ("terrain",)):
        section = build.level_section(world)
        if section is None:
            raise ModelError(
                "plan: expected a level ground below the solids, found another one; make its "
                "heights equal"
            )
    with at(problem, ("plan",)):
        plan = plan_climb(spec, driver, world.vehicle, section)
        tracking = contact_path.Tracking(
            contact_path.tracked_plan([part[:2] for part in plan.parts]),
            **driver.control.model_dump(exclude_unset=True),
        )
    dae = climbing(model, tracking)
    return OverSolids(
        **vars(world),
        model=model,
        dae=dae,
        start=build.build_start(problem, dae),
        inputs=dae.inputs(reference_speed=driver.speed),
        t=input_samples(spec.time.duration, spec.time.step, {})[0],
        driven=f"plan over solids, tracked at {driver.speed:g} m/s before and after it",
        plan=plan,
    )


def _faults(spec: plan_setup.PlanKeys) -> Iterator[Fault]:
    """Yield the keys that a plan over solids requires or does not support."""
    tables = {"": spec, **{name: getattr(spec, name) for name in KEYS if name.isalpha()}}
    if spec.driver is None or spec.driver.name != STEP_CLIMBING:
        found = "another guide; change it"
        yield Fault(("driver", "name"), f"{STEP_CLIMBING!r} for a plan over solids", found)
        return
    if spec.time.duration == inf:
        yield Fault(
            ("time", "duration"), "the duration of the simulation of the plan", "none; add it"
        )
    tables["driver.control"] = spec.driver.control
    for name, table in tables.items():
        keys = {*table} if isinstance(table, Mapping) else table.model_fields_set
        for key in sorted((keys & OF_PLANS if not name else keys) - KEYS[name]):
            place = *filter(None, name.split(".")), key
            known = ", ".join(sorted(KEYS[name]))
            yield Fault(place, f"one of {known} for a plan over solids", f"{key!r}; remove it")
    if sum(weight > 0 for weight in spec.costs.values()) != 1:
        yield Fault(
            ("costs",), f"one cost, of {', '.join(contact_path.COSTS)}", f"{len(spec.costs)}"
        )
    if "utilisation" in spec.limits and spec.costs.get("friction"):
        found = "the limit; remove it, or choose another cost"
        yield Fault(("limits", "utilisation"), "no limit with the cost 'friction'", found)


def plan_climb(
    spec: plan_setup.PlanKeys, driver: plan_setup.GuideTable, climber: Vehicle, section: Profile
) -> Planned:
    """Return the plan of a climb; errors are those of `build_over_solids`."""
    cost = next(name for name, weight in spec.costs.items() if weight > 0)
    if not isinstance(spec.terrain.friction, float):
        raise ModelError(
            f"expected a coefficient of friction in [terrain], found {spec.terrain.friction!r}; "
            "give a number"
        )
    most = spec.limits.get("utilisation", (0.0, 1.0))[1] * spec.terrain.friction
    parts = contact_path.legs(climber, section)
    options: dict[str, Any] = {
        "speed": driver.speed,
        "torques": [driver.control.torque * n for n in driver.control.motors],
        "s": (spec.plan.intervals or LEG_INTERVALS) + 1,
    }

    def solved(
        cost: str, mu: float | None
    ) -> Iterator[tuple[contact_path.Climb, Array, contact_path.ClimbHistory, Array]]:
        """Yield plan, unknowns, history and statistics of each leg between stops."""
        for k, leg in enumerate(parts):
            halt = leg is not parts[-1]
            plan = contact_path.climb(climber, section, leg, cost, mu=mu, halt=halt, **options)
            try:
                solution = ipopt.solve_nlp(plan.nlp)
            except trajectory.SolverError as error:
                raise trajectory.SolverError(f"plan, {_leg(k, leg)}: {error}") from error
            costs = np.array([solution.iterations, *solution.seconds.values()])
            yield plan, solution.unknowns, contact_path.history(plan, solution.unknowns), costs

    chosen = [*solved("friction", None)]
    least = tuple(told.mu for _, _, told, _ in chosen)
    if cost != "friction":
        worst = int(np.argmax(least))
        if least[worst] > most:
            raise trajectory.SolverError(
                f"plan, {_leg(worst, parts[worst])}: expected a coefficient of friction of at "
                f"least {least[worst]:.3f}, found {most:g}; lower the obstacle, or increase "
                "terrain.friction or limits.utilisation"
            )
        chosen = [*solved(cost, most)]
    effort = np.sum([costs for *_, costs in chosen], axis=0)[:3]
    return Planned(tuple(each[:3] for each in chosen), least, *effort)


def _leg(number: int, leg: contact_path.Leg) -> str:
    return f"leg {number + 1}, on which the {leg.axle} wheels climb"


def drive_over_solids(
    problem: Problem[plan_setup.PlanKeys], setup: OverSolids, watch: base.Watch
) -> tuple[Trajectory, Mapping[str, Array]]:
    """Return the simulated motion that tracks a plan, with the errors and costs of the plan."""
    spec, plan = problem.spec, setup.plan
    run = base.integrate(setup, build.solver_options(problem), watch)
    low, high = spec.goal.get("y", (-np.inf, np.inf))
    y = float(run["y"][-1])
    missed = max(low - y, y - high, 0.0)
    facts = {
        "plan_iterations": Fact(plan.iterations, "1"),
        "plan_seconds": Fact(plan.seconds, "s"),
        "plan_seconds_functions": Fact(plan.functions, "s"),
        "plan_cost_time": Fact(sum(told.duration for *_, told in plan.parts), "s"),
        "plan_cost_friction": Fact(max(told.mu for *_, told in plan.parts), "1"),
        "plan_violation_y_goal": Fact(missed, "m", "y at the goal"),
        "plan_accuracy": Fact(spec.plan.accuracy),
        **{f"plan_least_friction_{k + 1}": Fact(mu, "1") for k, mu in enumerate(plan.least)},
        **_tracking(setup, run),
    }
    stop = run.stop
    if missed:
        words = missed_words({"y at the goal": missed}, {"y at the goal": "m"})
        reason = f"no usable plan: its simulation misses {words}; see 'obstacles'"
        stop = stop or trajectory.Stop(
            trajectory.PLAN_ACCURACY, float(run.t[-1]), reason, Outcome.INACCURATE
        )
    return replace(run, stop=stop).with_facts(facts), NOTHING


def _tracking(setup: OverSolids, run: Trajectory) -> dict[str, Fact]:
    """Return the time of the motion for the distance of the plan, and its largest errors, by name.

    Both are compared at equal progress, the mean of y + z over the axles, as far as the motion
    reaches; the time is missing if it does not reach the end.
    """
    paths = [plan.middles for plan, *_ in setup.plan.parts]
    planned = np.concatenate([contact_path.progress(path) for path in paths])
    _, z, rear, front = np.concatenate([path.q for path in paths]).T
    reached = np.maximum.accumulate((run["center_y"] + run["center_z"]).mean(axis=1))
    part = planned <= reached[-1]
    pose = {"z": z, "pitch": rear, setup.vehicle.coordinates[0].name: front - rear}
    facts = dict[str, Fact]()
    for name, values in pose.items():
        errors = np.abs(np.interp(planned[part], reached, run[name]) - values[part])
        unit = run.columns[name].label.unit
        facts[f"plan_difference_{name}"] = Fact(float(errors.max(initial=0.0)), unit)
    if part.all():
        begin, end = np.searchsorted(reached, planned[[0, -1]])
        facts["plan_driven"] = Fact(float(run.t[end] - run.t[begin]), "s")
    return facts


MAX_SAMPLES = 401  # largest number of samples of a plan in the viewer
PATH_SAMPLES = 121  # samples of the path of an iterate
OFFER = (
    'no slow motion was found within these limits; set model = "dynamics" to plan with momentum: '
    "inertia then carries the vehicle where its drives alone do not"
)
# of quasi-statics: with 1e-6 near the limit of friction, up to 3.6 times the steps
PRECISE_TOLERANCE = 1e-8
FRICTION_TOLERANCE = 1e-6  # smallest tolerance of quasi-statics, which may fail to settle below it


class PlanVerb(base.DriveVerb):
    """Planning: inputs that reach a goal at least cost, and the resulting motion."""

    schema = plan_setup.PlanKeys
    options = (base.RESUME,)
    is_timed = False
    own_rows = ROWS
    verified = (DIFFERENCE, VIOLATION)
    metrics_shown = ("within_limits", "slip_rms", "duration")

    def build(self, problem: Problem[plan_setup.PlanKeys]) -> Setup:
        """Return the set-up of the search; over solids, that of the simulation of a plan."""
        if problem.spec.terrain.obstacles:
            return build_over_solids(problem)
        return plan_setup.build_planning(problem)

    def drive(
        self,
        problem: Problem[plan_setup.PlanKeys],
        setup: plan_setup.Planning | OverSolids,
        watch: base.Watch,
        resume: SavedPlan | None,
    ) -> tuple[Trajectory, Mapping[str, Array]]:
        """Return the simulated motion of a plan, and the plan as arrays for a warm start."""
        if isinstance(setup, OverSolids):
            return drive_over_solids(problem, setup, watch)
        spec = problem.spec
        progress, facts = _iterate_reporter(watch, setup), dict[str, Fact]()
        if resume is None and spec.plan.starts > 1:
            resume, facts, is_interrupted = plan_search.best_start(setup, watch.line)
            progress = (lambda *_: False) if is_interrupted else progress
        guesses: list[Trajectory] = []
        if not resume and not spec.plan.window:
            watch.begin("driving the initial guess")
            with at(problem, ("driver" if spec.driver else "inputs",)):
                guesses = [plan_search.start_motion(setup, k) for k in range(len(setup.starts))]

        def with_plan(
            plan: Plan | LongPlan, run: Trajectory
        ) -> tuple[Trajectory, Mapping[str, Array]]:
            """Return a run with facts and, if inaccurate, a stop; the plan as arrays."""
            stop = _inaccurate(setup, plan) if run.stop is None and not plan.accurate else run.stop
            if stop is not None and plan.success and stop.outcome in UNUSABLE:
                stop = stop._replace(words=stop.words + _separation_words(setup))
            run = replace(run, stop=stop)
            run = run.with_facts({**facts_of(plan, setup), **facts})
            if isinstance(plan, LongPlan):
                windows = Fact([window._asdict() for window in plan.windows])
                return run.with_facts({"plan_windows": windows}), plan.saved.arrays
            lines = [np.stack([guess["x"], guess["y"]], axis=1) for guess in guesses]
            drawn = _lines_as_arrays("guess", lines) | _lines_as_arrays("route", setup.guide.paths)
            return run, {**plan.saved.arrays, **drawn}

        def keep(plan: Plan | LongPlan) -> None:
            watch.keep(*with_plan(plan, plan.replay))

        if spec.plan.window is not None:
            guide = setup.guide
            with at(problem, ("plan",)):
                long = plan_windows(
                    setup.task,
                    partial(follow, setup.dae, speed=guide.speed),
                    setup.start,
                    Path(guide.paths[0]),
                    speed=abs(guide.speed),
                    length=spec.plan.window,
                    overlap=spec.plan.shared_length,
                    mesh=plan_setup.mesh_of(spec),
                    options=spec.solver.options,
                    resume=resume,
                    progress=progress,
                    keep=keep,
                    seconds=ipopt.seconds_left(setup.deadline),
                )
            run, arrays = with_plan(long, long.replay)
            checks = {"by_friction": lambda run: run.with_facts(_by_friction(setup, long))}
            return base.with_diagnostics(run, checks, watch, arrays), arrays
        # locked before a result is written, which may be that of another process
        with plan_search.draw_folder(setup, watch.beside) as parts:
            watch.begin("setting up the search")
            plan = plan_search.find_plan(setup, guesses, resume, progress, keep=keep)
            tested = plan_search.Tested(plan)
            if spec.plan.robust is not None and plan.accurate:
                # kept in case the search for a robust plan is interrupted
                keep(replace(plan, replay=replace(plan.replay, stop=plan_search.UNTESTED)))
                tested = plan_search.make_robust(setup, plan, progress, watch, parts)
            elif spec.plan.guarantee is not None and plan.accurate:
                tested = plan_search.make_guaranteed(setup, plan, spec.plan.guarantee, progress)
            elif parts is not None:
                parts.remove()
        plan = tested.plan
        run, stop = plan.replay, tested.stop or with_advice(setup, plan, guesses)
        if stop is not None and (tested.stop or not plan.success):
            run = replace(run, stop=stop._replace(t=float(run.t[-1])))
        facts |= tested.facts
        run, arrays = with_plan(plan, run)
        diagnostics: dict[str, base.Diagnostic] = {
            "optimality": lambda run: run.with_facts(optimality_facts(plan)),
            "by_friction": lambda run: run.with_facts(_by_friction(setup, plan)),
            "with_inertia": lambda run: run.with_facts(_in_soil(setup, plan)),
            "momentum": lambda run: run.with_facts(_momentum(setup, plan)),
        }
        return base.with_diagnostics(run, diagnostics, watch, arrays), arrays

    def attributes(self, problem: Problem[Any], setup: Setup) -> dict[str, str]:
        """Return the attributes of the result, including model and law."""
        return super().attributes(problem, setup) | base.model_attributes(problem.spec)

    def describe_samples(self, problem: Problem[plan_setup.PlanKeys], setup: Setup) -> str:
        """Return the description of the sampling, without the duration, which may be unknown."""
        return f"{problem.spec.time.step:g} s apart or less, depending on the intervals of the plan"

    def facts(self, run: Trajectory) -> dict[str, Fact]:
        """Return the facts of a motion, including its largest violation of limits."""
        return super().facts(run) | described(run)

    def figures(self, result: base.Result) -> tuple[Plot, ...]:
        """Return the figures of a plan and of its motion, the most important first."""
        from slipfree.show.plan_figures import plan_plots

        if result.problem.spec.terrain.obstacles:
            return super().figures(result)
        world = base.world_of(result)
        options, setup = figure_options(result, world), result.setup
        layers = setup and setup.layers
        if layers is None:
            layers = plan_setup.build_layers(
                result.problem, world.terrain, world.vehicle, options["places"]
            )
        plots = plan_plots(result.trajectory, world.ground.grid, layers, **options)
        others = super().figures(result)
        if all(name.endswith("_rate") for name in options["bounds"]):  # in the figure of the plan
            others = tuple(plot for plot in others if plot.name != "rates")
        return *plots, *others

    def shown(self, result: base.Result, name: str) -> Driven:
        """Return the motion of a result with ground, vehicle, keep-out regions and plan."""
        driven = super().shown(result, name)
        return driven._replace(plan=poses_of_plan(result.trajectory, result.arrays, driven.terrain))

    def marks(self, problem: Problem[Any], domain: plan_setup.Domain) -> dict[str, Any]:
        """Return keep-out regions, places, and the areas of places with extent."""
        places, _ = plan_setup.places_of(problem, domain)
        return {
            "keep_out": plan_setup.regions(problem),
            "places": places,
            "areas": plan_setup.areas_of(problem, domain),
        }


def _lines_as_arrays(name: str, lines: Sequence[Array]) -> dict[str, Array]:
    """Return lines in map coordinates [m] as arrays for a file, with NaN between them."""
    gap = np.full((1, 2), np.nan)
    points = np.concatenate([part for line in lines for part in (line, gap)]) if lines else gap[:0]
    return {f"{name}_{axis}": points[:, k] for k, axis in enumerate("xy") if lines}


def _line_points(name: str, arrays: Mapping[str, Array]) -> Array:
    """Return the points of lines stored with a result, shape (n, 2), with NaN between them [m]."""
    empty = np.zeros(0)
    return np.stack([arrays.get(f"{name}_{axis}", empty) for axis in "xy"], axis=1)


def figure_options(result: base.Result, world: World) -> dict[str, Any]:
    """Return the keyword arguments of `plan_plots`, from the arrays and attributes of a result."""
    problem, arrays = result.problem, result.arrays
    spec, run = problem.spec, result.trajectory
    unbounded = dict.fromkeys(run.attributes["inputs"].split(), (-np.inf, np.inf))
    routes, grid = _line_points("route", arrays), world.ground.grid
    ends = np.flatnonzero(np.isnan(routes[:, 0]))
    marks = PlanVerb().marks(problem, grid.domain)
    return {
        **{name: marks[name] for name in ("places", "areas")},
        "found": [line[~np.isnan(line[:, 0])] for line in np.split(routes, ends)[:-1]],
        "guess": _line_points("guess", arrays),
        "bounds": unbounded | spec.bounds,
        "limits": spec.limits,
    }


def _inaccurate(setup: plan_setup.Planning, plan: Plan | LongPlan) -> trajectory.Stop:
    """Return the stop of a plan that its simulation misses by more than the accuracy."""
    spec = setup.spec
    obstacle = obstacle_words(setup.task, plan.replay, spec.plan.accuracy)
    sizes = plan.difference | plan.violation
    missed = {name: size for name, size in sizes.items() if size > spec.plan.accuracy}
    worst = missed_words(missed, plan.units) or "a narrow limit"
    last = plan.stages[-1]
    why = {
        ipopt.SOLVED_STATUS: "its refined meshes did not suffice; raise plan.intervals or "
        "plan.accuracy",
        ipopt.STOPPED_STATUS: "the refinement of its mesh was stopped",
        ipopt.TIME_STATUS: "the time limit ended the refinement of its mesh; raise plan.seconds",
    }.get(
        last.status,
        f"with {last.words} {ipopt_words(last.status)}; change the initial guess or the limits",
    )
    words = (
        f"no usable plan: its simulation misses {worst}; plan.accuracy allows "
        f"{spec.plan.accuracy:g}: {why}"
        + (f"; it exceeds the limit of {obstacle}" if obstacle else "")
    )
    outcome = Outcome.INTERRUPTED if last.status == ipopt.STOPPED_STATUS else Outcome.INACCURATE
    return trajectory.Stop(trajectory.PLAN_ACCURACY, float(plan.replay.t[-1]), words, outcome)


def _separation_words(setup: plan_setup.Planning) -> str:
    """Return a line about where the mobility map separates places of a plan; empty if nowhere."""
    places = [place[1:] for place in setup.places]
    obstacle = separation_words(setup.layers, places, by_friction=setup.needs_friction)
    return f"\non the mobility map {obstacle}" if obstacle else ""


def _iterate_reporter(
    watch: base.Watch, setup: plan_setup.Planning
) -> Callable[[str, ipopt.Iterate], bool]:
    """Return a callback that reports each iterate, and returns False after Ctrl-C to stop.

    Ctrl-C before the first iterate raises KeyboardInterrupt, since there is no plan to save.
    """
    begun, start = False, time.monotonic()

    def progress(words: str, iterate: ipopt.Iterate) -> bool:
        """Show an iteration; return whether the search may go on.

        Ctrl-C ends the search after the first iteration, so that it has a result to keep.
        """
        nonlocal begun
        line = (
            f"{words}: iteration {iterate.number}, constraints off by {iterate.violation:.2g}"
            f"{' (rising)' if iterate.is_rising else ''}, cost {iterate.cost:.6g}, "
            f"{time.monotonic() - start:.0f} s"
        )
        try:
            if watch.line is not None:
                watch.line(words, line)
            if watch.path is not None:
                motion = motion_of(iterate.program, iterate.unknowns)
                states = motion.states(np.linspace(0, 1, PATH_SAMPLES))
                local = states[setup.dae.state_rows("x", "y")].T
                watch.path(local + setup.terrain.origin[:2])
        except KeyboardInterrupt:
            if not begun:
                raise
            return False
        begun = True
        return True

    return progress


def _simulated(
    prefix: str,
    setup: plan_setup.Planning,
    plan: Plan | LongPlan,
    build: Callable[[], tuple[Dae, Trajectory]],
    options: SolverOptions,
    more: Callable[[Trajectory], dict[str, Fact]] = lambda _: {},
) -> dict[str, Fact]:
    """Return the facts of a simulation of a plan with another model; the plan is valid without it.

    ``build`` returns the model and its start. The names of the facts begin with the prefix:
    ``end_distance``, the distance from the end of the plan's own simulation, and those of ``more``;
    or ``failure``.
    """
    if time.monotonic() > setup.deadline:
        return {f"{prefix}_failure": Fact("not simulated: the time limit has passed")}
    try:
        model, start = build()
        given: dict[str, Any] = {"step": setup.spec.time.step, "deadline": setup.deadline}
        run = simulate_plan(model, start, plan.motion, options=options, **given)
    except (SlipfreeError, np.linalg.LinAlgError) as error:
        return {f"{prefix}_failure": Fact(f"not simulated: {error}")}
    if run.stop is not None:
        return {f"{prefix}_failure": Fact(trajectory.outcome_words(run))}
    apart = float(np.hypot(*(run[name][-1] - plan.replay[name][-1] for name in "xy")))
    facts = {"end_distance": Fact(apart, "m"), **more(run)}
    return {f"{prefix}_{name}": fact for name, fact in facts.items()}


def _by_friction(setup: plan_setup.Planning, plan: Plan | LongPlan) -> dict[str, Fact]:
    """Return the facts of the motion with friction under the plan's inputs.

    It is quasi-static, or has inertia if wheels press into the ground. There are no facts without
    mass or friction, and for plans with forces.
    """
    able = setup.vehicle.mass and setup.terrain.has_friction
    if not (plan.success and able and setup.spec.model == "kinematics"):
        return {}

    def build() -> tuple[Dae, Trajectory]:
        if not has_exact_closure(setup.vehicle):
            return _with_inertia(setup, plan, options, Compliant())
        model: Dae = quasi_statics(setup.vehicle, setup.terrain)
        return model, settle(model, options=options, **start_values(setup.spec, setup.start))

    def slip(run: Trajectory) -> dict[str, Fact]:
        facts, names = base.drive_facts(run), ("slip_per_path", "utilisation_largest")
        known = {name: facts[name] for name in names if name in facts}
        return known | ({"model": Fact("with inertia")} if "kinetic_energy" in run else {})

    options, facts = setup.spec.solver.options, dict[str, Fact]()
    for least in (PRECISE_TOLERANCE, FRICTION_TOLERANCE):
        options = replace(options, tolerance=max(options.tolerance, least))
        facts = _simulated("friction", setup, plan, build, options, slip)
        if "friction_failure" not in facts:
            break
    return facts


def start_values(spec: plan_setup.PlanKeys, start: Trajectory) -> dict[str, Any]:
    """Return the values of a problem's start by name, with the heading, from the settled start."""
    return {name: float(start[name][0]) for name in {**spec.start, "heading": 0.0}}


def _with_inertia(
    setup: plan_setup.Planning, plan: Plan | LongPlan, options: SolverOptions, law: ContactLaw
) -> tuple[Dae, Trajectory]:
    """Return the dynamic model and its start with the speed of the plan."""
    model: Dae = dynamics(setup.vehicle, setup.terrain, law=law)
    values = start_values(setup.spec, setup.start) | {SPEED: initial_speed(plan.replay)}
    return model, settle(model, options=options, **values)


def _in_soil(setup: plan_setup.Planning, plan: Plan) -> dict[str, Fact]:
    """Return the facts of the motion in soil with inertia under the plan's inputs.

    Slip, sinkage and work are also those of the plan's own simulation.
    """
    law = model_law(setup.problem)
    if not (plan.success and setup.spec.model == "quasi-static" and isinstance(law, Soil)):
        return {}
    options = setup.spec.solver.options

    def compared(run: Trajectory) -> dict[str, Fact]:
        """Return facts of the motion in soil, and the same of the plan."""
        return {
            f"{name}{which}": fact
            for motion, which, depth in ((run, "", "depth"), (plan.replay, "_plan", "sinkage"))
            for name, fact in {
                "slip_ratio_largest": Fact(float(motion["slip_ratio"].max()), "1"),
                "sinkage_largest": Fact(float(motion[depth].max()), "m"),
                "work": Fact(float(motion["work"][-1] - motion["work"][0]), "J"),
            }.items()
        }

    build = partial(_with_inertia, setup, plan, options, law)
    return _simulated("soil", setup, plan, build, options, compared)


def _momentum(setup: plan_setup.Planning, plan: Plan) -> dict[str, Fact]:
    """Return the facts of the motion with inertia beside the plan, and of its path without."""
    if setup.spec.model != "dynamics" or not plan.difference:
        return {}
    facts = {"momentum_distance": Fact(max(plan.difference[name] for name in "xyz"), "m")}
    for name, run in (("_plan", plan.run), ("", plan.replay)):
        least = run["force_normal"].min(axis=0)
        wheel = run.wheels[int(least.argmin())]
        facts[f"momentum_force_normal{name}"] = Fact(float(least.min()), "N", wheel)
    if not plan.success:
        return facts
    run = plan.run
    try:  # the torques that the same path needs without inertia
        model: Dae = quasi_statics(setup.vehicle, setup.terrain)
        start = settled_start(model, setup.start, setup.spec.solver.options)
        wheels = [
            name for name, w in zip(run.wheels, setup.vehicle.wheels, strict=True) if w.driven
        ]
        rates = {f"{name}_rate": run["wheel_rate", name] for name in wheels}
        for c in setup.vehicle.of("commanded"):
            rates[f"{c.name}_rate"] = run[f"{c.name}_speed"]
        lines = {name: PiecewiseLinear.through(run.t, rate) for name, rate in rates.items()}
        options = SolverOptions(tolerance=FRICTION_TOLERANCE)
        slow = simulate_to_failure(model, start, model.inputs(**lines), run.t, options)
    except (SlipfreeError, np.linalg.LinAlgError) as error:  # the plan is valid without it
        return {**facts, "slow_failure": Fact(f"not simulated: {error}")}
    needed, used = (np.abs(each["drive_torque"].sum(axis=1)) for each in (slow, run))
    k = int(needed.argmax())
    return {
        **facts,
        "slow_torque": Fact(float(needed[k]), "N m"),
        "slow_torque_plan": Fact(float(used.max()), "N m"),
        **{f"slow_{axis}": Fact(float(slow[axis][k]), "m") for axis in "xy"},
        **({} if slow.stop is None else {"slow_failure": Fact(trajectory.outcome_words(slow))}),
    }


def initial_speed(run: Trajectory) -> float:
    """Return the speed of a motion along the forward axis of the platform at its start [m/s]."""
    heading, pitch = run["heading"][0], run["pitch"][0]
    level = run["velocity_y"][0] * np.cos(heading) - run["velocity_x"][0] * np.sin(heading)
    return float(level * np.cos(pitch) + run["velocity_z"][0] * np.sin(pitch))


def with_advice(
    setup: plan_setup.Planning, plan: Plan, guesses: Sequence[Trajectory]
) -> trajectory.Stop | None:
    """Return the stop of a plan; after a failed search, with the obstacle and a suggestion.

    The obstacle is where the ground that can be reached on the mobility map ends between the places
    of the plan; the suggestion is a plan with momentum, after a slow plan that was not ended by the
    time limit.
    """
    stop, spec = plan.run.stop, setup.spec
    if stop is None or stop.outcome is Outcome.INTERRUPTED:
        return stop
    words, bounds = [stop.words + _separation_words(setup)], spec.limits.get("drive_torque")
    if not setup.needs_friction or stop.outcome is Outcome.TIME_LIMIT:  # only slow plans need it
        return stop._replace(words="\n".join(words))
    if bounds is not None and guesses and "drive_torque" in guesses[0]:
        guess, needed = guesses[0], guesses[0]["drive_torque"].sum(axis=1)
        k, most = int(needed.argmax()), bounds[1] * sum(w.driven for w in setup.vehicle.wheels)
        if needed[k] > most:
            words.append(
                f"slow driving along the initial guess needs torques of {needed[k]:.3g} N m in all "
                f"(at x = {guess['x'][k]:.2f} m, y = {guess['y'][k]:.2f} m), limits.drive_torque "
                f"allows {most:.3g} N m"
            )
    return stop._replace(words="\n".join([*words, OFFER]))


def poses_of_plan(
    run: Trajectory, arrays: Mapping[str, Array], terrain: Bicubic
) -> Trajectory | None:
    """Return the poses of the plan that a motion simulates; None if no plan is stored.

    The result is also None for a plan with inertia, which has other unknowns than its simulation.
    """
    if f"{ARRAY_PREFIX}unknowns" not in arrays or "kinetic_energy" in run:
        return None
    saved = from_arrays(arrays, "result")
    course = saved.motion
    places = np.linspace(0, 1, min(MAX_SAMPLES, 10 * course.mesh.ends.size))
    rows = np.concatenate([course.states(places), course.algebraic(places)])
    rows = rows + saved.shift[: len(rows), None]
    columns, t, first = {}, run.t[0] + places * course.duration, 0
    # up to the contacts, the quantities of the simulation are the unknowns of the plan, in order
    for name, column in run.columns.items():
        if name == "contact_x":
            break
        columns[name] = trajectory.Column(column.label, rows[first])
        first += 1
    # contacts are unknowns wheel by wheel: x and y of the first wheel, then of the next
    pairs = rows[first : first + 2 * len(run.wheels)].reshape(len(run.wheels), 2, -1)
    for axis, name in enumerate(("contact_x", "contact_y")):
        columns[name] = trajectory.Column(run.columns[name].label, pairs[:, axis].T)
    columns["wheel_angle"] = wheel_angles_at(run, t)
    height = terrain.elevation(columns["contact_x"].values, columns["contact_y"].values)
    columns["contact_z"] = trajectory.Column(run.columns["contact_z"].label, height)
    return Trajectory(t, columns, run.wheels)
