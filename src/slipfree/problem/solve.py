"""Solution of validated problems."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from slipfree.core.outcome import Outcome
from slipfree.core.records import Array
from slipfree.core.trajectory import Stop
from slipfree.plan.warm_start import SavedPlan
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem
from slipfree.problem.schema import MotionKeys, Runnable
from slipfree.problem.stored_inputs import STORED, stored_inputs
from slipfree.problem.verbs.base import (
    CROSS_CHECK,
    VERB_ATTRIBUTE,
    CrossCheck,
    MotionVerb,
    Result,
    VerbSetup,
    VerbSolution,
    Watch,
)
from slipfree.problem.verbs.registry import check_option, verb_of
from slipfree.system.forks import computing
from slipfree.system.regular_files import escape_name


@computing
def build(problem: Problem[Runnable]) -> Any:
    """Return the set-up of a problem: model, start and inputs.

    Raises
    ------
    ProblemError
        If the ground cannot be read or made, names are unknown, or the vehicle cannot stand at the
        start or move from there as the problem specifies.
    """
    return verb_of(problem).build(problem)


@computing
def run_problem(
    problem: Problem[Runnable],
    progress: Callable[[float], None] | None = None,
    tell: Callable[[str, str], None] | None = None,
    resume: SavedPlan | None = None,
    path: Callable[[Array], None] | None = None,
    keep: Callable[[Result], None] = lambda _: None,
) -> Result:
    """Solve a problem and return its motion.

    After Ctrl-C, or after an error in a diagnostic, the result is what was computed before.

    Parameters
    ----------
    problem : Problem
        Result of `load_problem`.
    progress : callable, optional
        Called with the time reached by the integrator. [s]
    tell : callable, optional
        Called for every iterate of a plan with the phase of the search and a line of text.
    resume : SavedPlan, optional
        Plan for a warm start; only for planning problems.
    path : callable, optional
        Called for every iterate of a plan with the path of the platform, shape (n, 2). [m]
    keep : callable, optional
        Called with what is computed so far, such as a solved plan that is not verified.

    Returns
    -------
    Result
        The motion, complete or up to its stop.

    Raises
    ------
    ProblemError
        If the problem cannot be built, or cannot be solved from its start, for example because
        start, goal and limits of a plan contradict each other.
    SolverError
        If the integrator fails before the first sample; a later failure is the stop of
        the trajectory.
    KeyboardInterrupt
        After Ctrl-C before anything is computed.
    """
    verb, kept = verb_of(problem), list[Result]()

    def store(found: VerbSolution) -> None:
        kept[:] = [_result(problem, verb, found, stored)]
        keep(kept[-1])

    setup = build(problem)
    stored = stored_inputs(problem)  # before a long search, in which files may change
    try:
        with at(problem, ("start",)):
            found = verb.solve(problem, setup, Watch(progress, tell, path, store), resume)
        return _result(problem, verb, found, stored)
    except KeyboardInterrupt:
        if not kept:
            raise
    except Exception as error:
        if not kept:
            raise
        kept[-1] = _failed(kept[-1], error)
    return kept[-1]


def _result(
    problem: Problem[Runnable], verb: MotionVerb, found: VerbSolution, stored: str
) -> Result:
    """Return the result of a solution, with the attributes of its problem."""
    attributes = {
        **found.trajectory.attributes,
        **_attributes(problem, verb, found.setup),
        STORED: stored,
    }
    run = replace(found.trajectory, attributes=attributes)
    if isinstance(problem.spec, MotionKeys):
        run = run.in_frame(problem.spec.frame)
    return Result(
        verb.name, run, verb.verification(run), found.setup, found.arrays, lambda: problem
    )


def _failed(result: Result, error: Exception) -> Result:
    """Return a result whose stop reports an error after its computation."""
    run = result.trajectory
    before = f"{run.stop.words}; " if run.stop else ""
    words = f"{before}{type(error).__name__}: {error}"
    stop = Stop("solver", float(run.t[-1]), words, Outcome.SOLVER_FAILURE)
    return replace(result, trajectory=replace(run, stop=stop))


@computing
def cross_check(result: Result) -> CrossCheck:
    """Solve the problem of a result in the other formulation of contact and compare the motions.

    Raises
    ------
    ProblemError
        If the verb of the problem does not offer a cross-check.
    """
    problem = result.problem
    check_option(problem, CROSS_CHECK)
    return verb_of(problem).cross_check(result)


def _attributes(problem: Problem[Any], verb: MotionVerb, setup: VerbSetup) -> dict[str, str]:
    """Return the attributes of a result file that describe its problem."""
    source = problem.source
    settings = {"settings": "\n".join(dict.fromkeys(source.settings.values()))}
    found = {
        "title": problem.spec.title or source.path.stem,
        VERB_ATTRIBUTE: verb.name,
        "problem_file": source.path.name,
        "problem_folder": str(source.path.parent),  # as given
        "problem": source.text,
        **(settings if source.settings else {}),
        **verb.attributes(problem, setup),
        **{name.replace(" ", "_"): words for name, words in setup.facts},
    }
    return {name: escape_name(words) for name, words in found.items()}
