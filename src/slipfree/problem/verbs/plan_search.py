"""Search for a plan: continuation, meshes, and several starts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from operator import itemgetter
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from slipfree.contact.closure import has_exact_closure
from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError, SlipfreeError
from slipfree.core.facts import Fact
from slipfree.core.outcome import Outcome
from slipfree.core.records import Array
from slipfree.core.trajectory import PLAN, SolverError, Stop, Trajectory
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.rigid_dynamics import dynamic_guess
from slipfree.plan.ipopt import Iterate
from slipfree.plan.plan import Plan, plan
from slipfree.plan.polynomial_motion import SavedPlan
from slipfree.plan.problem import bounds_of
from slipfree.plan.robust import Tightening, tightened_arguments
from slipfree.plan.search import (
    NOT_SOLVED,
    LocalOptimum,
    count_distinct,
    distances,
    further_guesses,
)
from slipfree.problem.build import in_frame, model_law, solver_options
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem
from slipfree.problem.verbs.plan_schema import PlanKeys
from slipfree.problem.verbs.plan_setup import (
    Planning,
    PlanSource,
    build_planning,
    momentum_models,
    plan_arguments,
    problem_from,
    search_arguments,
    settled_start,
    source_of,
)
from slipfree.solve.simulate import simulate
from slipfree.system.processes import local_tasks

SMOOTHINGS = (1.0, 0.3)  # smoothing widths of the load law in the first plans, in static depths
ROUGH = 1e-5  # tolerance of initial guesses [m, rad]


def guess_motion(setup: Planning, start: tuple[Any, Array]) -> Trajectory:
    """Return the motion under the inputs of an initial guess, simulated with a loose tolerance.

    If the guess follows a path and the goal has x and y, the motion ends at its sample nearest to
    the goal; ranges of x and y are represented by their middle. If the integrator fails after the
    first sample, the motion ends where the integrator stopped.

    SolverError is raised if the integrator fails before the first sample.

    Parameters
    ----------
    setup : Planning
        Set-up of the problem.
    start : tuple of (record, ndarray)
        Inputs of the guess, and times of its samples. [s]
    """
    law, t = start
    try:
        rough = replace(setup.spec.solver.options, tolerance=ROUGH)
        run = simulate(setup.guide, setup.guide_start, law, t, options=rough)
    except SolverError as error:
        if error.trajectory is None:
            raise
        run = error.trajectory
    if setup.paths and setup.places[-1][0] == "goal":
        _, x, y = setup.places[-1]
        away = np.hypot(run["x"] - x, run["y"] - y)
        run = run.part(slice(max(int(away.argmin()), 1) + 1))
    if setup.guide is setup.dae:
        return run
    return dynamic_guess(setup.dae, setup.vehicle, setup.start, run)


def find_plan(
    problem: Problem[PlanKeys],
    setup: Planning,
    guesses: list[Trajectory],
    resume: SavedPlan | None,
    progress: Callable[[str, Iterate], bool],
    length: float,
    tightening: Tightening = MappingProxyType({}),
    keep: Callable[[Plan], None] | None = None,
) -> Plan:
    """Return the plan of a problem.

    For wheels that press into the ground, plans with smoother load laws are computed first, for
    wheels that slide, plans with larger creep speeds; each search starts from the previous plan.
    If a search fails, the previous plan is returned.

    ProblemError is raised if start, goal and limits contradict each other, or ``resume`` is a plan
    of another model; SolverError if the plan cannot be simulated from the start.

    Parameters
    ----------
    problem, setup : Problem, Planning
        The problem and its set-up.
    guesses : list of Trajectory
        Initial guesses; empty with ``resume``.
    resume : SavedPlan or None
        Plan from which the search starts.
    progress : callable
        As for `plan`.
    length : float
        Duration of the plan if the problem gives none. [s]
    tightening : mapping of Bound to float
        Distance of each tightened bound from the given one, in the unit of the quantity.
    keep : callable, optional
        As for `plan`.
    """
    spec, found, saved = problem.spec, None, resume
    for dae in (*([] if resume else _smoothed_models(problem, setup)), setup.dae):
        is_same = dae is setup.dae or dae.replay is not None  # creep does not change the start
        start = setup.start if is_same else settled_start(dae, setup)
        model = (dae, setup.vehicle, setup.terrain)
        arguments = plan_arguments(spec, setup.keep_out, model, setup.between)
        search = search_arguments(spec) | {"options": solver_options(problem)}
        if dae.replay and dae is not setup.dae:  # only the last creep speed has to be accurate
            search["accuracy"] = np.inf
        with at(problem, ("plan",)):
            now = plan(
                dae,
                start,
                [] if saved else guesses,
                **tightened_arguments(dae, arguments, tightening),
                **search,
                duration=spec.plan.duration or (length, length),
                resume=saved,
                progress=progress,
                keep=keep if keep is None or dae is setup.dae else partial(_keep_smoothed, keep),
            )
        if found is not None:
            if not now.success and now.run.outcome is not Outcome.INTERRUPTED:
                return found
            now = replace(now, stages=(*found.stages, *now.stages))
        if not now.success or dae is setup.dae:
            break
        found, saved = now, now.saved
    return now


def _keep_smoothed(keep: Callable[[Plan], None], plan: Plan) -> None:
    """Keep a plan of one of the first searches; its stop says that it is not the final one."""
    words = "the search was interrupted; this plan has a smoother load law or a larger creep speed"
    stop = Stop(PLAN, float(plan.replay.t[-1]), words, Outcome.INTERRUPTED)
    keep(replace(plan, replay=replace(plan.replay, stop=stop)))


def _smoothed_models(problem: Problem[PlanKeys], setup: Planning) -> list[Dae]:
    """Return models for searches before that of the plan, the smoothest first.

    They have smoothed load laws of wheels that press into the ground, or, with inertia, larger
    creep speeds of wheels that slide. The list is empty for other vehicles.
    """
    if problem.spec.model == "dynamics":
        return momentum_models(problem, setup.vehicle, setup.terrain)[:-1]
    if has_exact_closure(setup.vehicle):
        return []
    slip = model_law(problem, problem.spec)
    return [
        in_frame(
            problem, direct_kinematics(setup.vehicle, setup.terrain, slip=slip, smoothing=width)
        )
        for width in SMOOTHINGS
    ]


class StartResult(NamedTuple):
    """Plan from one initial guess.

    Attributes
    ----------
    number : int
        Index of the initial guess.
    optimum : LocalOptimum or None
        Entry in the table of local optima; None if the guess does not exist or cannot be used.
    saved : SavedPlan or None
        The plan; None if there is no optimum.
    words : str
        Error message; empty without error.
    """

    number: int
    optimum: LocalOptimum | None
    saved: SavedPlan | None
    words: str = ""


def best_start(
    problem: Problem[PlanKeys], setup: Planning, report: Callable[[str, str], None] | None
) -> tuple[SavedPlan | None, dict[str, Fact], bool]:
    """Return the best plan of several starts, their facts, and whether Ctrl-C ended the search.

    The plan is None if no start is solved.

    SlipfreeError is raised if a process dies, or no start can be simulated; KeyboardInterrupt if
    ``report`` raises it before a start is solved.

    Parameters
    ----------
    problem, setup : Problem, Planning
        The problem and its set-up.
    report : callable or None
        Called several times per second with the phase and a line; may raise KeyboardInterrupt,
        after which the plans found so far are returned if there are any.
    """
    count = max(problem.spec.plan.starts, len(setup.starts))
    with at(problem, ("plan",)):
        found, is_interrupted = _solve_starts(source_of(problem), count, report)
    saved = found[0].saved if is_solved(found[0]) else None
    return saved, starts_facts(found), is_interrupted


def _solve_starts(
    source: PlanSource, count: int, report: Callable[[str, str], None] | None
) -> tuple[list[StartResult], bool]:
    """Return the plans of all starts, the best first, and whether Ctrl-C ended the search.

    ModelError is raised if no start can be simulated.
    """
    found: list[StartResult] = []
    is_interrupted = False

    def poll() -> None:
        if report is not None:
            report("starts", f"starts: {len(found)} of {count} are finished")

    try:
        with local_tasks(solve_start, count) as finish:
            for result in finish([(source, number) for number in range(count)], poll):
                found.append(result)
    except KeyboardInterrupt:
        if not any(is_solved(each) for each in found):
            raise
        is_interrupted = True
    ranked = [(each.optimum.rank, each.number, each) for each in found if each.optimum is not None]
    if not ranked:
        raise ModelError(
            "plan: expected an initial guess that can be simulated, found none of "
            f"{len(found)}; guess {found[0].number + 1} failed: {found[0].words}; change the "
            "inputs or the driver"
        )
    return [each for _, _, each in sorted(ranked, key=itemgetter(0, 1))], is_interrupted


def solve_start(task: tuple[PlanSource, int]) -> StartResult:
    """Return the plan from one of several initial guesses; errors are stored in the result.

    ``task`` contains the source of the problem and the number of the guess.
    """
    source, number = task
    try:
        problem = problem_from(source)
        setup = build_planning(problem)
        first = guess_motion(setup, setup.starts[0])
        missing = problem.spec.plan.starts - len(setup.starts)
        if number < len(setup.starts):
            name, guess = _start_name(setup, number), guess_motion(setup, setup.starts[number])
        else:
            bounds = bounds_of(setup.dae, problem.spec.bounds)
            seed = problem.spec.plan.seed
            further = [*further_guesses(setup.dae, setup.start, first, bounds, missing, seed)]
            if number - len(setup.starts) >= len(further):
                return StartResult(number, None, None, "a perturbed guess cannot be simulated")
            name, guess = further[number - len(setup.starts)]
        found = find_plan(problem, setup, [guess], None, lambda *_: True, float(first.t[-1]))
    except SlipfreeError as error:
        return StartResult(number, None, None, str(error))
    return StartResult(number, found.optima[0]._replace(start=name), found.saved)


def _start_name(setup: Planning, number: int) -> str:
    """Return the name of an initial guess: its driving law, or ``inputs``.

    The names of several guesses are numbered.
    """
    name = setup.spec.driver.name if setup.spec.driver else "inputs"
    return name if len(setup.starts) == 1 else f"{name} {number + 1}"


def starts_facts(results: Sequence[StartResult]) -> dict[str, Fact]:
    """Return the table of the starts, the best first, and the number of local optima."""
    optima = [each.optimum for each in results if each.optimum is not None]
    rows = [
        {
            "start": optimum.start,
            "outcome": optimum.outcome,
            "cost": optimum.cost,
            "terms": optimum.terms,
            "duration": optimum.duration,
            "distance": distance,
            "seconds": optimum.seconds,
        }
        for optimum, distance in zip(optima, distances(optima), strict=True)
    ]
    return {"plan_starts": Fact(rows), "plan_optima": Fact(count_distinct(optima), "1")}


def is_solved(result: StartResult) -> bool:
    """Return whether the search of a start found a plan."""
    return result.optimum is not None and result.optimum.outcome != NOT_SOLVED
