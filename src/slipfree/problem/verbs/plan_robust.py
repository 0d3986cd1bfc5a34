"""Plans that satisfy their limits in a required share of drawn worlds.

A drawn world has random errors of the map, of the friction and of the gains of the inputs. A plan
holds in this world if its simulation satisfies all limits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError, SlipfreeError
from slipfree.core.facts import Fact, Facts
from slipfree.core.outcome import Outcome
from slipfree.core.trajectory import PLAN_SHARE, Stop, Trajectory
from slipfree.plan.plan import Plan
from slipfree.plan.polynomial_motion import PolynomialMotion
from slipfree.plan.robust import (
    CONFIDENCE,
    Bound,
    DisturbedRun,
    Draw,
    Replays,
    RobustPlan,
    Tightening,
    replay_of,
    robust_plan,
)
from slipfree.plan.search import PlanProgress
from slipfree.plan.verification import VERIFICATION_TOLERANCE, simulate_plan
from slipfree.problem.build import build_model, build_start
from slipfree.problem.problem import Problem
from slipfree.problem.verbs.plan_schema import PlanKeys, Robust
from slipfree.problem.verbs.plan_search import find_plan
from slipfree.problem.verbs.plan_setup import (
    Planning,
    PlanSource,
    build_planning,
    plan_arguments,
    problem_from,
    source_of,
)
from slipfree.solve.options import MIN_TOLERANCE
from slipfree.system.processes import local_tasks
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.grid_ops import disturbed

Report = Callable[[str, str], None]
UNTESTED = Stop(
    PLAN_SHARE,
    0.0,
    "the plan is solved and accurate, but not all drawn worlds are simulated",
    Outcome.INTERRUPTED,
)


class Tested(NamedTuple):
    """A plan, and results of its simulations in drawn worlds.

    Attributes
    ----------
    plan : Plan
        The plan, with tightened limits if too few simulations of the first one satisfied them.
    stop : Stop or None
        Reason why too few simulations satisfy the limits, or interruption by Ctrl-C.
    facts : mapping of str to Fact
        Shares of the simulations that satisfy all limits, and what tightening changed; empty
        without simulations, and after Ctrl-C.
    """

    plan: Plan
    stop: Stop | None = None
    facts: Facts = MappingProxyType({})


class ReplayTask(NamedTuple):
    """Simulations of plans in one drawn world, for a process."""

    source: PlanSource
    motions: tuple[PolynomialMotion, ...]
    draw: Draw


class DrawnWorld(NamedTuple):
    """A drawn world: the problem, the model of the plan, and model, start and limits in the world.

    Attributes
    ----------
    problem : Problem
        The problem, whose robust plan draws the world.
    planned : Dae
        Model of the plan.
    dae : Dae
        Model of the vehicle in the drawn world.
    start : Trajectory
        Start of the motion in the drawn world.
    arguments : mapping
        Arguments of `slipfree.plan` for ``dae``.
    """

    problem: Problem[PlanKeys]
    planned: Dae
    dae: Dae
    start: Trajectory
    arguments: Mapping[str, Any]


def make_robust(
    problem: Problem[PlanKeys],
    setup: Planning,
    first: Plan,
    robust: Robust,
    progress: PlanProgress,
    report: Report | None,
) -> Tested:
    """Tighten the limits of a plan until it holds in the required share of drawn worlds.

    After Ctrl-C, the last accurate plan is returned, with an interruption as its stop.

    Parameters
    ----------
    problem, setup : Problem, Planning
        The problem and its set-up.
    first : Plan
        Plan with the limits as given.
    robust : Robust
        Uncertainties of the drawn worlds, numbers of draws, and required share.
    progress : callable
        As for `plan`.
    report : callable or None
        Called several times per second with the phase and a line during simulations.
    """
    source, latest = source_of(problem), first

    def solve(tightening: Tightening, before: Plan) -> Plan:
        nonlocal latest
        length = before.motion.duration
        found = find_plan(problem, setup, [], before.saved, progress, length, tightening)
        if found.run.outcome is Outcome.INTERRUPTED:
            raise KeyboardInterrupt
        if not found.accurate:
            stop = found.run.stop
            raise ModelError(
                stop.words.splitlines()[0]
                if stop
                else "the simulation deviates from the plan by more than plan.accuracy"
            )
        latest = replace(found, stages=(*before.stages, *found.stages))
        return latest

    try:
        with local_tasks(replay_draw, robust.draws) as finish:

            def replay(plans: Sequence[Plan], draws: Sequence[Draw]) -> list[Replays]:
                done: dict[Draw, tuple[DisturbedRun, ...]] = {}

                def poll() -> None:
                    if report is not None:
                        words = f"{len(done)} of {len(draws)} drawn worlds are simulated"
                        report("drawn worlds", f"robust plan: {words}")

                motions = tuple(each.motion for each in plans)
                tasks = [ReplayTask(source, motions, draw) for draw in draws]
                for draw, each in finish(tasks, poll):
                    done[draw] = each
                return [Replays(each) for each in zip(*(done[draw] for draw in draws), strict=True)]

            found = robust_plan(
                first,
                solve,
                replay,
                share=robust.share,
                draws=robust.draws,
                final_draws=robust.final_draws,
                seed=robust.seed,
            )
    except KeyboardInterrupt:
        return Tested(latest, UNTESTED)
    return Tested(found.plan, _stop(found, robust), robust_facts(found, first))


def replay_draw(task: ReplayTask) -> tuple[Draw, tuple[DisturbedRun, ...]]:
    """Simulate plans in a drawn world; return the draw and a comparison with the bounds for each.

    The world is built once for all plans, and once for all draws if only the inputs are drawn.
    """
    robust = _planning(task.source)[0].spec.plan.robust or Robust()
    is_drawn = robust.map is not None or robust.friction > 0
    try:
        world = _drawn_world(task.source, task.draw if is_drawn else None)
    except SlipfreeError as error:
        return task.draw, (_without_motion(error),) * len(task.motions)
    return task.draw, tuple(_replay_in(world, robust, motion, task.draw) for motion in task.motions)


@lru_cache(1)
def _drawn_world(source: PlanSource, draw: Draw | None) -> DrawnWorld:
    """Return a drawn world, or the world of the problem if there is no draw."""
    problem, setup = _planning(source)
    spec = problem.spec
    terrain = setup.terrain
    if draw is not None:
        terrain = drawn_terrain(setup, draw, spec.plan.robust or Robust())
    dae = build_model(problem, spec, setup.vehicle, terrain)
    model = (dae, setup.vehicle, terrain)
    arguments = plan_arguments(spec, setup.keep_out, model, setup.between)
    return DrawnWorld(problem, setup.dae, dae, build_start(problem, dae), arguments)


def _replay_in(
    world: DrawnWorld, robust: Robust, planned: PolynomialMotion, draw: Draw
) -> DisturbedRun:
    spec = world.problem.spec
    tolerance = max(spec.plan.accuracy * VERIFICATION_TOLERANCE, MIN_TOLERANCE)
    options = replace(spec.solver.options, tolerance=tolerance)
    motion = drawn_motion(planned, draw, robust.inputs)
    try:
        run = simulate_plan(world.dae, world.start, motion, step=spec.time.step, options=options)
    except SlipfreeError as error:
        return _without_motion(error)
    return replay_of(
        world.dae,
        world.arguments,
        (world.planned, planned),
        run,
        accuracy=spec.plan.accuracy,
        goal=robust.goal,
    )


def _without_motion(error: SlipfreeError) -> DisturbedRun:
    return DisturbedRun({Bound(f"no motion ({error})"): np.inf}, np.nan)


@lru_cache(1)
def _planning(source: PlanSource) -> tuple[Problem[PlanKeys], Planning]:
    problem = problem_from(source)
    return problem, build_planning(problem)


def drawn_terrain(setup: Planning, draw: Draw, robust: Robust) -> Bicubic:
    """Return the ground of a problem with drawn errors of heights and of friction."""
    map_seed, friction_rng = _seed(draw, 0), np.random.default_rng(_seed(draw, 1))
    grid, mu = setup.ground.grid, setup.ground.mu
    if robust.map is not None:
        grid = disturbed(grid, robust.map.rms, robust.map.correlation, map_seed)
    factor = np.exp(robust.friction * friction_rng.standard_normal())  # always positive
    if isinstance(mu, Grid):
        mu = replace(mu, z=mu.z * factor)
    elif mu is not None:
        mu = mu * factor
    return Bicubic(grid, setup.terrain.origin[:2], mu)


def drawn_motion(motion: PolynomialMotion, draw: Draw, deviation: float) -> PolynomialMotion:
    """Return a plan with each input multiplied by a random gain of mean 1.

    ``deviation`` is the standard deviation of the gains.
    """
    where = motion.layout.inputs
    errors = np.random.default_rng(_seed(draw, 2)).standard_normal(where.shape[1])
    unknowns = motion.unknowns.copy()
    unknowns[where] *= 1 + deviation * errors
    return motion._replace(unknowns=unknowns)


def _seed(draw: Draw, part: int) -> int:
    """Return the seed of a part of a draw: 0 heights, 1 friction, 2 inputs."""
    return int(np.random.SeedSequence((*draw, part)).generate_state(1)[0])


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
    sizes = sorted(result.tightening.items(), key=lambda item: -item[1])
    tightened = [
        {"bound": str(bound), "size": size, "unit": _unit(first, bound)} for bound, size in sizes
    ]
    violated = [{"bound": str(bound), "draws": count} for bound, count in after.violated.items()]
    return {
        **{f"plan_share{name}": fact for name, fact in facts.items()},
        "plan_tightened": Fact(tightened),
        "plan_violated": Fact(violated),
        "plan_total_cost": Fact(result.plan.solution.cost),
        "plan_untightened_total": Fact(first.solution.cost),
        **{f"plan_untightened_{name}": Fact(cost) for name, cost in first.costs.items()},
        **({"plan_tightening_failure": Fact(result.failure)} if result.failure else {}),
    }


def _unit(plan: Plan, bound: Bound) -> str:
    unit = plan.units.get(bound.name, "1")
    return "" if unit == "1" else f" {unit}"


def _stop(result: RobustPlan[Plan], robust: Robust) -> Stop | None:
    """Return the stop of a plan that holds in too few drawn worlds, otherwise None."""
    after = result.after
    if after.share >= robust.share:
        return None
    bound, count = next(iter(after.violated.items()))
    tighter = f"; tighter limits are not solved: {result.failure}" if result.failure else ""
    words = (
        f"the plan holds in {after.held} of {after.draws} drawn worlds, expected at "
        f"least {100 * robust.share:.3g} %; violated most often: {bound} in {count}{tighter}; "
        "widen the limits, or reduce the share or the uncertainty in plan.robust"
    )
    return Stop(PLAN_SHARE, 0.0, words, Outcome.INFEASIBLE)
