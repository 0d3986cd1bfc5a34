"""Solve a planning problem from several initial guesses, in parallel processes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import NamedTuple

from slipfree.core.errors import ModelError, SlipfreeError
from slipfree.core.facts import Fact
from slipfree.plan.ipopt import Iterate
from slipfree.plan.plan import Plan
from slipfree.plan.problem import bounds_of
from slipfree.plan.starts import (
    NOT_SOLVED,
    LocalOptimum,
    count_distinct,
    distances,
    further_guesses,
)
from slipfree.plan.warm_start import SavedPlan
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem
from slipfree.problem.verbs.plan_schema import PlanKeys
from slipfree.problem.verbs.plan_search import find_plan, guess_motion
from slipfree.problem.verbs.plan_setup import (
    Planning,
    PlanSource,
    build_planning,
    problem_from,
    source_of,
)
from slipfree.system.processes import local_tasks


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

    Parameters
    ----------
    problem, setup : Problem, Planning
        The problem and its set-up.
    report : callable or None
        Called several times per second with the phase and a line; may raise KeyboardInterrupt,
        after which the plans found so far are returned if there are any.

    Raises
    ------
    SlipfreeError
        If a process dies, or no start can be simulated.
    KeyboardInterrupt
        If ``report`` raises it before a start is solved.
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

    Raises
    ------
    ModelError
        If no start can be simulated.
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
        found = find_plan(problem, setup, [guess], None, _going_on, float(first.t[-1]))
    except SlipfreeError as error:
        return StartResult(number, None, None, str(error))
    return _start_result(number, name, found)


def _start_name(setup: Planning, number: int) -> str:
    """Return the name of an initial guess: its driving law, or ``inputs``.

    The names of several guesses are numbered.
    """
    name = setup.spec.driver.name if setup.spec.driver else "inputs"
    return name if len(setup.starts) == 1 else f"{name} {number + 1}"


def _going_on(_words: str, _iterate: Iterate) -> bool:
    return True


def _start_result(number: int, name: str, found: Plan) -> StartResult:
    """Return the result of a start: its local optimum, with the name of the start, and its plan."""
    return StartResult(number, found.optima[0]._replace(start=name), found.saved)


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
