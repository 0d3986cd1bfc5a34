"""Search for a plan: continuation, several starts, and limits that hold in drawn worlds.

A drawn world has random errors of the map, of the friction and of the gains of the inputs. A plan
holds in this world if its simulation satisfies all limits.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import cache, lru_cache, partial
from hashlib import sha256
from itertools import count
from operator import attrgetter, itemgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.closure import has_exact_closure
from slipfree.contact.nearest_points import CLEARANCE
from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError, SlipfreeError
from slipfree.core.facts import SCALES, Fact, Facts
from slipfree.core.interval import Intervals, evaluate_interval
from slipfree.core.trajectory import PLAN, PLAN_SHARE, Outcome, Stop, Trajectory
from slipfree.enclosure.guarantee import TIP_OVER, guarantee
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.limits import UPRIGHT
from slipfree.plan.constraints import shift_of, unit_words
from slipfree.plan.guess import guess_motion, settled_start
from slipfree.plan.ipopt import seconds_left
from slipfree.plan.plan import Plan, solve_task
from slipfree.plan.polynomial_motion import PolynomialMotion, SavedPlan
from slipfree.plan.problem import duration_of
from slipfree.plan.robust import (
    CONFIDENCE,
    LOWER,
    MAX_ROUNDS,
    UPPER,
    Bound,
    DisturbedRun,
    Draw,
    Replays,
    RobustPlan,
    Tightening,
    bound_of,
    model_limits,
    replay_of,
    robust_plan,
    tightened_task,
)
from slipfree.plan.search import (
    NOT_SOLVED,
    LocalOptimum,
    PlanProgress,
    Search,
    count_distinct,
    distances,
    further_guesses,
)
from slipfree.plan.transcription import PlanTask
from slipfree.plan.verification import (
    VERIFICATION_TOLERANCE,
    limit_name,
    simulate_plan,
    verify_plan,
)
from slipfree.problem.build import build_model, build_start, in_frame, model_law, solver_options
from slipfree.problem.build_ground import at
from slipfree.problem.inputs import ProblemParts, Recipe, recipe_of
from slipfree.problem.verbs.base import Watch
from slipfree.problem.verbs.plan_setup import (
    OfRobust,
    Planning,
    Robust,
    build_planning,
    mesh_of,
    momentum_models,
    plan_task,
)
from slipfree.solve.system import MIN_TOLERANCE
from slipfree.system.parts import PartsWatch, study
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.grid_ops import disturbed

RUNS = count()  # numbers of recipes in this process
SMOOTHINGS = (1.0, 0.3)  # smoothing widths of the load law in the first plans, in static depths
Report = Callable[[str, str], None]
GAIN = 1.5  # of the tightening of guaranteed plans, relative to the excess
UNTESTED = Stop(
    PLAN_SHARE,
    0.0,
    "the plan is solved and accurate, but not all drawn worlds are simulated; the same command "
    "without --resume repeats the search, and continues with the worlds",
    Outcome.INTERRUPTED,
)


def start_motion(setup: Planning, number: int) -> Trajectory:
    """Return the motion of an initial guess with the model of the plan."""
    drive, options = setup.starts[number], setup.spec.solver.options
    return guess_motion(setup.dae, setup.start, setup.trip, setup.guide, drive, options)


def find_plan(
    setup: Planning,
    guesses: list[Trajectory],
    resume: SavedPlan | None,
    progress: PlanProgress,
    tightening: Tightening = MappingProxyType({}),
    keep: Callable[[Plan], None] | None = None,
) -> Plan:
    """Return the plan of a problem, from guesses or from the plan ``resume``.

    For wheels that press into the ground, plans with smoother load laws are computed first, for
    wheels that slide, plans with larger creep speeds; each search starts from the previous plan. If
    a search fails, the previous plan is returned. A problem without a duration takes that of
    ``resume``; ``progress`` and ``keep`` are as for `plan`.

    ProblemError is raised if start, goal and limits contradict each other, or ``resume`` is a plan
    of another model; SolverError if the plan cannot be simulated from the start.
    """
    problem, spec, found, saved = setup.problem, setup.spec, None, resume
    before = setup.start  # of the model of ``found``
    duration = setup.task.duration
    if resume is not None:
        duration = duration_of(spec.plan.duration or resume.motion.duration)
    smoothed = list[Dae]()
    if resume is None and spec.model == "dynamics":
        smoothed = [make() for make in momentum_models(problem, setup.vehicle, setup.terrain)[:-1]]
    elif resume is None and not has_exact_closure(setup.vehicle):
        world, slip = (setup.vehicle, setup.terrain), model_law(problem)
        models = (direct_kinematics(*world, slip=slip, smoothing=width) for width in SMOOTHINGS)
        smoothed = [in_frame(problem, model) for model in models]
    for dae in (*smoothed, setup.dae):
        is_same = dae is setup.dae or dae.replay is not None  # creep does not change the start
        options = solver_options(problem)
        start = setup.start if is_same else settled_start(dae, setup.start, options)
        keep_own = keep if keep is None or dae is setup.dae else partial(_keep_smoothed, keep)
        with at(problem, ("plan",)):
            task = setup.task if dae is setup.dae else plan_task(problem, dae, start)
            now = solve_task(
                replace(tightened_task(task, tightening), duration=duration),
                start,
                [] if saved else guesses,
                mesh=mesh_of(spec),
                search=Search(
                    resume=saved,
                    progress=progress,
                    keep=keep_own,
                    seconds=seconds_left(setup.deadline),
                ),
                options=options,
                verified=dae is setup.dae,  # the others only lead to it
            )
        if found is not None:
            if not now.success and now.run.outcome is not Outcome.INTERRUPTED:
                # creep differs from the sliding of the simulation
                accuracy = 1.0 if found.program.task.dae.replay else spec.plan.accuracy
                where = found.program, found.solution.unknowns, before
                how: dict[str, Any] = {"step": spec.time.step, "deadline": setup.deadline}
                shown = verify_plan(*where, accuracy=accuracy, **how)._asdict()
                names = "replay", "difference", "violation", "units", "accurate"
                return replace(found, **{name: shown[name] for name in names})
            now = replace(now, stages=(*found.stages, *now.stages))
        if not now.success or dae is setup.dae:
            break
        found, saved, before = now, now.saved, start
    return now


def _keep_smoothed(keep: Callable[[Plan], None], plan: Plan) -> None:
    """Keep a plan of one of the first searches; its stop says that it is not the final one."""
    words = "the search was interrupted; this plan has a smoother load law or a larger creep speed"
    stop = Stop(PLAN, float(plan.replay.t[-1]), words, Outcome.INTERRUPTED)
    keep(replace(plan, replay=replace(plan.replay, stop=stop)))


@lru_cache(1)
def _planning(source: Recipe) -> Planning:
    return build_planning(source.load())


class StartResult(NamedTuple):
    """Plan from one initial guess; without an optimum, the reason."""

    number: int
    optimum: LocalOptimum | None
    saved: SavedPlan | None
    words: str = ""


def best_start(
    setup: Planning, report: Report | None
) -> tuple[SavedPlan | None, dict[str, Fact], bool]:
    """Return the best plan of several starts, their facts, and whether Ctrl-C ended the search.

    The plan is None if no start is solved, unless the time limit has passed. SlipfreeError is
    raised if a process dies, or no start can be simulated; KeyboardInterrupt if ``report``, which
    is called several times per second with the phase and a line, raises it before a start is
    solved.
    """
    count, results = max(setup.spec.plan.starts, len(setup.starts)), list[StartResult]()
    is_interrupted = False

    def poll() -> None:
        if report is not None:
            report("starts", f"starts: {len(results)} of {count} are finished")

    with at(setup.problem, ("plan",)):
        source = recipe_of(setup.problem, run=next(RUNS))
        try:
            with study(solve_start, workers=count, watch=PartsWatch(poll)) as run:
                for _, result in run(range(count), lambda number: (source, number)):
                    results.append(result)
        except KeyboardInterrupt:
            if not any(is_solved(each) for each in results):
                raise
            is_interrupted = True
        ranked = [(each.optimum.rank, each.number, each) for each in results if each.optimum]
        if not ranked:
            raise ModelError(
                "plan: expected an initial guess that can be simulated, found none of "
                f"{len(results)}; guess {results[0].number + 1} failed: {results[0].words}; change "
                "the inputs or the driver"
            )
    results = [each for _, _, each in sorted(ranked, key=itemgetter(0, 1))]
    is_over = time.monotonic() > setup.deadline
    saved = results[0].saved if is_over or is_solved(results[0]) else None
    return saved, starts_facts(results), is_interrupted


def solve_start(task: tuple[Recipe, int]) -> StartResult:
    """Return the plan from an initial guess, by its number; errors are stored in the result."""
    source, number = task
    try:
        setup = _planning(source)
        first, search = start_motion(setup, 0), setup.spec.plan
        missing = search.starts - len(setup.starts)
        if number < len(setup.starts):
            law = setup.guide.name or "inputs"
            name = law if len(setup.starts) == 1 else f"{law} {number + 1}"
            guess = start_motion(setup, number)
        else:
            begin, bounds = (setup.dae, setup.start, first), setup.task.inputs
            further = [*further_guesses(*begin, bounds, missing, search.seed)]
            if number - len(setup.starts) >= len(further):
                return StartResult(number, None, None, "a perturbed guess cannot be simulated")
            name, guess = further[number - len(setup.starts)]
        solved = find_plan(setup, [guess], None, lambda *_: True)
    except SlipfreeError as error:
        return StartResult(number, None, None, str(error))
    return StartResult(number, solved.optima[0]._replace(start=name), solved.saved)


def starts_facts(results: Sequence[StartResult]) -> dict[str, Fact]:
    """Return the table of the starts, the best first, and the number of local optima."""
    optima = [each.optimum for each in results if each.optimum is not None]
    rows = [
        {**optimum._asdict(), "distance": distance}
        for optimum, distance in zip(optima, distances(optima), strict=True)
    ]
    for row in rows:
        del row["path"]
    return {"plan_starts": Fact(rows), "plan_optima": Fact(count_distinct(optima), "1")}


def is_solved(result: StartResult) -> bool:
    """Return whether the search of a start found a plan."""
    return result.optimum is not None and result.optimum.outcome != NOT_SOLVED


class Tested(NamedTuple):
    """A plan, tightened if need be, and results of its simulations in drawn worlds.

    The stop says that too few simulations satisfy the limits, or that Ctrl-C ended them.
    """

    plan: Plan
    stop: Stop | None = None
    facts: Facts = MappingProxyType({})


class ReplayTask(NamedTuple):
    """Simulations of plans in one drawn world, for a process."""

    source: Recipe
    motions: tuple[PolynomialMotion, ...]
    draw: Draw


class DrawFolder(ProblemParts[tuple[DisturbedRun, ...]]):
    """Folder beside an output with the simulations of plans in drawn worlds."""

    def store(self, number: int, result: tuple[DisturbedRun, ...]) -> None:
        """Store the simulations of plans in a world."""
        self.add(number, {"runs": [([*each.excess.items()], each.distance) for each in result]})

    def load(self, number: int) -> tuple[DisturbedRun, ...]:
        """Return the simulations of plans in a world."""
        return tuple(
            DisturbedRun({Bound(*bound): size for bound, size in excess}, distance)
            for excess, distance in self.record(number)["runs"]
        )


def draw_folder(setup: Planning, beside: Path | None) -> AbstractContextManager[DrawFolder | None]:
    """Return the folder beside an output with the simulations of a robust plan, if it has one."""
    robust = setup.spec.plan.robust
    if robust is None or beside is None:
        return nullcontext()
    size = robust.final_draws + MAX_ROUNDS * robust.draws
    return DrawFolder(beside, "robust plan", size, setup.problem)


def solve_tightened(
    setup: Planning, tightening: Tightening, before: Plan, progress: PlanProgress
) -> Plan:
    """Return the accurate plan with tightened limits, from the previous one."""
    solved = find_plan(setup, [], before.saved, progress, tightening)
    if solved.run.outcome is Outcome.INTERRUPTED:
        raise KeyboardInterrupt
    if not solved.accurate:
        away = "the simulation deviates from the plan by more than plan.accuracy"
        raise ModelError(stop.words.splitlines()[0] if (stop := solved.run.stop) else away)
    return replace(solved, stages=(*before.stages, *solved.stages))


def make_robust(
    setup: Planning,
    first: Plan,
    progress: PlanProgress,
    watch: Watch,
    parts: DrawFolder | None = None,
) -> Tested:
    """Tighten the limits of a plan until it holds in the required share of drawn worlds.

    ``parts`` keeps the simulations. After Ctrl-C, the last accurate plan is returned, with an
    interruption as its stop. The line of ``watch`` is called several times per second.
    """
    source, latest = recipe_of(setup.problem, run=next(RUNS)), first
    robust = setup.spec.plan.robust or Robust()

    def solve(tightening: Tightening, before: Plan) -> Plan:
        nonlocal latest
        latest = solve_tightened(setup, tightening, before, progress)
        return latest

    done = dict[int, tuple[DisturbedRun, ...]]()

    def poll() -> None:
        if watch.line is not None:
            words = f"{len(done)} of {total} drawn worlds are simulated"
            watch.line("drawn worlds", f"robust plan: {words}")

    total = 0
    try:
        with study(replay_draw, parts, robust.draws, watch=PartsWatch(poll)) as run:

            def replay(plans: Sequence[Plan], draws: Sequence[Draw]) -> list[Replays]:
                """Return motions of plans in the worlds of draws; stored ones are not repeated."""
                nonlocal total
                done.clear()
                total = len(draws)
                motions = tuple(each.motion for each in plans)
                key = sha256(b"".join(each.unknowns.tobytes() for each in motions)).hexdigest()
                stream = draws[0][1]
                # numbers of stored worlds: the final draws (stream 0), then those of each round
                first = 1 + (stream > 0) * (robust.final_draws + (stream - 1) * robust.draws)
                numbers = range(first, first + total)
                tasks = partial(ReplayTask, source, motions)
                for number, each in run(numbers, lambda k: tasks(draws[k - first]), lambda _: key):
                    done[number] = each
                return [Replays(each) for each in zip(*(done[k] for k in numbers), strict=True)]

            options = {name: getattr(robust, name) for name in OfRobust.model_fields}
            solved = robust_plan(first, solve, replay, **options)
            if parts is not None:
                parts.remove()
    except KeyboardInterrupt:
        return Tested(latest, UNTESTED)
    after, stop = solved.after, None
    if after.share < robust.share:
        bound, count = next(iter(after.violated.items()))
        tighter = f"; tighter limits are not solved: {solved.failure}" if solved.failure else ""
        words = (
            f"the plan holds in {after.held} of {after.draws} drawn worlds, expected at "
            f"least {100 * robust.share:.3g} %; violated most often: {bound} in {count}{tighter}; "
            "widen the limits, or reduce the share or the uncertainty in plan.robust"
        )
        stop = Stop(PLAN_SHARE, 0.0, words, Outcome.INFEASIBLE)
    return Tested(solved.plan, stop, robust_facts(solved, first))


def replay_draw(task: ReplayTask) -> tuple[DisturbedRun, ...]:
    """Simulate plans in a drawn world; return comparisons with the bounds."""
    setup = _planning(task.source)
    spec, robust = setup.spec, setup.spec.plan.robust or Robust()
    is_drawn = robust.map is not None or robust.friction > 0
    tolerance = max(spec.plan.accuracy * VERIFICATION_TOLERANCE, MIN_TOLERANCE)
    options = replace(spec.solver.options, tolerance=tolerance)

    def replayed(planned: PolynomialMotion) -> DisturbedRun:
        """Return the motion of a plan in a drawn world; a failed start violates a bound."""
        try:
            dae, start = _drawn_world(task.source, task.draw if is_drawn else None)
            motion = drawn_motion(planned, task.draw, robust.inputs)
            run = simulate_plan(dae, start, motion, step=spec.time.step, options=options)
        except SlipfreeError as error:
            return DisturbedRun({Bound(f"no motion ({error})"): np.inf}, np.nan)
        if run.outcome is Outcome.INTERRUPTED:
            raise KeyboardInterrupt
        asked, plan = plan_task(setup.problem, dae, start), (setup.dae, planned)
        return replay_of(asked, plan, run, accuracy=spec.plan.accuracy, goal=robust.goal)

    return tuple(map(replayed, task.motions))


@lru_cache(1)
def _drawn_world(source: Recipe, draw: Draw | None) -> tuple[Dae, Trajectory]:
    """Return model and start in a drawn world; without a draw, those of the problem."""
    setup = _planning(source)
    terrain, grid, robust = setup.terrain, setup.ground.grid, setup.spec.plan.robust or Robust()
    if draw is not None:
        if robust.map is not None:
            grid = disturbed(grid, robust.map.rms, robust.map.correlation, _seed(draw, 0))
        friction_rng = np.random.default_rng(_seed(draw, 1))
        factor = np.exp(robust.friction * friction_rng.standard_normal())  # always positive
        mu = scaled_friction(setup.ground.mu, factor)
        terrain = Bicubic(grid, terrain.origin[:2], mu)
    dae = build_model(setup.problem, setup.vehicle, terrain)
    return dae, build_start(setup.problem, dae)


def scaled_friction(mu: Any, factor: float) -> Any:
    """Return a coefficient of friction or a map of it times a factor; None for no friction."""
    return replace(mu, z=mu.z * factor) if isinstance(mu, Grid) else mu and mu * factor


def drawn_motion(motion: PolynomialMotion, draw: Draw, deviation: float) -> PolynomialMotion:
    """Return a plan with each input multiplied by a random gain of mean 1, given its deviation."""
    where = motion.layout.inputs
    errors = np.random.default_rng(_seed(draw, 2)).standard_normal(where.shape[1])
    unknowns = motion.unknowns.copy()
    unknowns[where] *= 1 + deviation * errors
    return motion._replace(unknowns=unknowns)


def _seed(draw: Draw, part: int) -> int:
    """Return the seed of a part of a draw: 0 heights, 1 friction, 2 inputs."""
    return int(np.random.SeedSequence((*draw, part)).generate_state(1)[0])


class BandBound(NamedTuple):
    """Extreme value of a limited quantity on the grounds of a band, at the tightest sample."""

    bound: Bound
    name: str  # of the quantity
    value: float  # as reported
    unit: str
    room: float  # between both, negative if the bound is violated
    place: str  # of the sample

    def __str__(self) -> str:
        is_lower = self.bound.side == LOWER
        value = rounded_words(self.value, self.unit, up=not is_lower)
        return f"{self.name} at {'least' if is_lower else 'most'} {value}, at {self.place}"


class BandLimits(NamedTuple):
    """Limits of a motion on every ground within an error of the map."""

    bounds: list[BandBound]  # the tightest first
    unproved: list[str]  # places and reasons of samples whose poses are not guaranteed
    uncovered: list[str]  # limits of the task that the guarantee does not cover


def band_limits(task: PlanTask, run: Trajectory, error: float) -> BandLimits:
    """Return bounds of limited quantities on every ground within an error [m] of the map.

    Limits on forces, rates and slopes of the ground are not covered: they do not follow from the
    pose. Poses that are not guaranteed are left out.
    """
    dae, found = task.dae, guarantee(task.dae, run, error)
    closed = [name for name in found.low if name not in (TIP_OVER, CLEARANCE.name)]
    states, (x, z, _), known = dae.rows("x", run), dae.columns(), found.is_guaranteed
    coordinates, shift = ca.vertcat(x, z[: len(closed)]), dae.shift[1][: len(closed), None]
    ends = ([end[name] for name in closed] - shift for end in (found.low, found.high))
    poses = Intervals(*(np.concatenate([states, end]) for end in ends))
    ways = np.stack([run["x"], run["y"]], axis=1).round(2) + 0.0  # without -0.00
    places = [f"x = {x:.2f} m, y = {y:.2f} m" for x, y in ways.tolist()]
    bounds, uncovered = list[BandBound](), list[str]()
    for number, limit in enumerate([*task.limits, *model_limits(task)] if known.any() else ()):
        if not ca.depends_on(limit.expression, z):  # of states, which are given
            continue
        name, expression = limit_name(limit), ca.densify(limit.expression)
        margin = TIP_OVER if name == "tip_over" else name
        f = ca.Function("limit", [coordinates], [expression], {"allow_free": True})
        if margin in found.low and margin not in closed:
            low, high = found.low[margin], found.high[margin]
        elif not f.has_free():
            values = evaluate_interval(f, poses)
            low, high = values.low[0], values.high[0]
        else:
            uncovered += [name] * (number < len(task.limits))
            continue
        away = shift_of(task, limit.expression)
        for side, sign, end, value in (LOWER, 1, limit.lower, low), (UPPER, -1, limit.upper, high):
            if not np.isfinite(end) or np.isposinf(value[known]).all():  # a margin from above
                continue
            room = np.where(known, np.nan_to_num(sign * (value - end), nan=-np.inf), np.inf)
            k = int(room.argmin())
            what = bound_of(limit, side, ""), margin, float(value[k] + away), limit.label.unit
            bounds.append(BandBound(*what, float(room[k]), places[k]))
    reasons = [f"{places[k]}: {found.reasons[k]}" for k in np.flatnonzero(~known)]
    return BandLimits(sorted(bounds, key=attrgetter("room")), reasons, uncovered)


def make_guaranteed(setup: Planning, first: Plan, error: float, progress: PlanProgress) -> Tested:
    """Tighten the limits of a plan until they hold on every ground within an error [m].

    The excess of a bound is enlarged: of tightened plans, the bounds are wider.
    """

    @cache
    def limits(plan: Plan) -> BandLimits:
        return band_limits(setup.task, plan.replay, error)

    def excess(plan: Plan) -> DisturbedRun:
        slack = setup.spec.plan.accuracy
        sizes = {each.bound: -each.room for each in limits(plan).bounds}
        sizes = {bound: GAIN * size + slack if size > 0 else size for bound, size in sizes.items()}
        open_poses = {Bound("pose"): np.inf} if limits(plan).unproved else {}
        return DisturbedRun({**sizes, **open_poses}, np.nan)

    solved = robust_plan(
        first,
        lambda tightening, before: solve_tightened(setup, tightening, before, progress),
        lambda plans, _: [Replays((excess(each),)) for each in plans],
        share=0.5,
        draws=1,
        final_draws=1,
    )
    last = limits(solved.plan)
    missed = [each for each in last.bounds if each.room < 0]
    why = ""
    if last.unproved:
        count = f"{len(last.unproved)} of {solved.plan.replay.t.size}"
        why = f"{count} poses are not guaranteed, the first at {last.unproved[0]}"
    elif missed:
        by = rounded_words(-missed[0].room, missed[0].unit, up=True)
        why = f"{missed[0]}, misses its bound by {by}"
    if why and solved.failure:
        why += f"; tighter limits are not solved: {solved.failure}"
    words = (
        f"not guaranteed for every ground within {Fact(error, 'm'):.3g>mm} of the map: {why}; "
        "widen the limits, reduce plan.guarantee, or choose another goal"
    )
    facts = {
        "plan_guarantee": Fact(error, "m"),
        # the platform's inclination has a wide limit, which tells nothing
        "plan_guarantee_bounds": Fact([str(it) for it in last.bounds if it.name != UPRIGHT]),
        "plan_guarantee_uncovered": Fact(last.uncovered),
        **tightening_facts(solved, first),
    }
    stop = Stop(PLAN_SHARE, 0.0, words, Outcome.INFEASIBLE) if why else None
    return Tested(solved.plan, stop, facts)


def rounded_words(value: float, unit: str, *, up: bool) -> str:
    """Return a value with three digits, rounded up or down, in the unit that people read."""
    shown = "deg" if unit == "rad" else "mm" if unit == "m" and abs(value) < 1 else unit_words(unit)
    value *= SCALES.get(shown, 1.0)
    size = 10.0 ** (2 - np.floor(np.log10(max(abs(value), 1e-9))))
    return f"{(np.ceil if up else np.floor)(value * size) / size:.3g} {shown}".rstrip()


def robust_facts(result: RobustPlan[Plan], first: Plan) -> dict[str, Fact]:
    """Return shares, tightening, violations and costs of a robust plan."""
    after, (low, high) = result.after, result.after.interval
    interval = f"{CONFIDENCE:.0%} confidence interval"
    half, most = after.distances(0.5, 0.95)
    facts = {
        "": Fact(after.share, "1"),
        "_first": Fact(result.before.share, "1"),
        "_draws": Fact(after.draws, "1"),
        "_rounds": Fact(result.rounds, "1"),
        "_low": Fact(low, "1", interval),
        "_high": Fact(high, "1", interval),
        "_distance": Fact(half, "m"),
        "_distance_95": Fact(most, "m"),
    }
    violated = [{"bound": str(bound), "draws": count} for bound, count in after.violated.items()]
    return {
        **{f"plan_share{name}": fact for name, fact in facts.items()},
        "plan_violated": Fact(violated),
        **tightening_facts(result, first),
    }


def tightening_facts(result: RobustPlan[Plan], first: Plan) -> dict[str, Fact]:
    """Return the tightening of limits, and costs with and without it."""
    sizes = sorted(result.tightening.items(), key=lambda item: -item[1])
    tightened = []
    for bound, size in sizes:
        unit = first.units.get(bound.name, "1")
        words = "" if unit == "1" else f" {unit}"
        tightened.append({"bound": str(bound), "size": size, "unit": words})
    return {
        "plan_tightened": Fact(tightened),
        "plan_total_cost": Fact(result.plan.solution.cost),
        "plan_untightened_total": Fact(first.solution.cost),
        **{f"plan_untightened_{name}": Fact(cost) for name, cost in first.costs.items()},
        **({"plan_tightening_failure": Fact(result.failure)} if result.failure else {}),
    }
