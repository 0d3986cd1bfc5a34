"""Several starts of a planning problem, each in a process of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from multiprocessing import parent_process
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

from slipfree.errors import ModelError
from slipfree.plan.plan import Plan
from slipfree.plan.starts import NOT_SOLVED, LocalOptimum, count_distinct, optima_words
from slipfree.plan.warm_start import SavedPlan
from slipfree.problem.problem import Problem
from slipfree.processes import Processes, available_cores, finish_tasks


class StartTask(NamedTuple):
    """A start for a process: the problem file with its text and settings, and the number."""

    path: Path
    text: str
    settings: tuple[str, ...]
    number: int


class StartResult(NamedTuple):
    """Plan from one initial guess.

    Attributes
    ----------
    number : int
        Index of the initial guess.
    optimum : LocalOptimum or None
        Its row in the table of optima; None if the guess does not exist or cannot be used.
    saved : SavedPlan or None
        The plan; None without optimum.
    words : str
        Error message; empty without error.
    """

    number: int
    optimum: LocalOptimum | None
    saved: SavedPlan | None
    words: str = ""


def solve_starts(
    problem: Problem[Any],
    count: int,
    solve: Callable[[StartTask], StartResult],
    report: Callable[[str, str], None] | None,
) -> tuple[list[StartResult], bool]:
    """Return the plans of all starts, the best first, and whether Ctrl-C ended the search.

    A process that is one of a sweep solves them one after the other.

    Parameters
    ----------
    problem : Problem
        The problem.
    count : int
        Number of starts.
    solve : callable
        Function of a module that solves a start.
    report : callable or None
        Called several times a second with the phase and a line; may raise KeyboardInterrupt, after
        which the plans found so far are returned if there are any.

    Raises
    ------
    SlipfreeError
        If a process dies, or no start can be simulated.
    """
    source = problem.source
    settings = tuple(dict.fromkeys(source.settings.values()))
    tasks = [StartTask(source.path, source.text, settings, number) for number in range(count)]
    found: list[StartResult] = []
    is_interrupted = False

    def poll() -> None:
        if report is not None:
            report("starts", f"starts: {len(found)} of {count} are solved")

    try:
        if parent_process() is not None or min(available_cores(), count) == 1:
            for task in tasks:
                poll()
                found.append(solve(task))
        else:
            with closing(Processes(min(available_cores(), count), solve)) as pool:
                for result in finish_tasks(tasks, pool, poll):
                    found.append(result)
    except KeyboardInterrupt:
        if not any(is_solved(each) for each in found):
            raise
        is_interrupted = True
    ranked = [(each.optimum.rank, each.number, each) for each in found if each.optimum is not None]
    if not ranked:
        raise ModelError(
            f"plan: expected an initial guess that can be simulated, found none of {len(found)}; "
            f"the first one failed: {found[0].words}; change the inputs or the driver"
        )
    return [each for _, _, each in sorted(ranked, key=itemgetter(0, 1))], is_interrupted


def start_result(number: int, name: str, found: Plan) -> StartResult:
    """Return the plan of a start as it is sent to the parent."""
    return StartResult(number, found.optima[0]._replace(start=name), found.saved)


def starts_words(results: Sequence[StartResult]) -> str:
    """Return the number of local optima, and their table, a line each."""
    optima = [each.optimum for each in results if each.optimum is not None]
    found = count_distinct(optima)
    head = f"{found} local {'optimum' if found == 1 else 'optima'} from {len(optima)} starts"
    return f"{head}\n{optima_words(optima)}"


def is_solved(result: StartResult) -> bool:
    """Return whether the search of a start found a plan."""
    return result.optimum is not None and result.optimum.outcome != NOT_SOLVED
