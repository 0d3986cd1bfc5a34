"""Explain why a search ended without a plan: violations, and bounds to relax."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slipfree.outcome import Outcome
from slipfree.plan.constraints import EQUATION, VIOLATION_TOLERANCE, Violation, worst_violations
from slipfree.plan.elastic import Relaxation, relax
from slipfree.plan.ipopt import INFEASIBLE_STATUS, STOPPED_STATUS, Solution
from slipfree.plan.messages import number, subject
from slipfree.plan.transcription import Program
from slipfree.records import Array
from slipfree.solver_codes import ipopt_words

MAX_NAMED_VIOLATIONS = 5  # violations that an explanation names


class Explanation(NamedTuple):
    """Outcome of a search without a plan, and its explanation.

    Attributes
    ----------
    outcome : Outcome
        Infeasible if IPOPT found so, or the bounds must be relaxed; interrupted; or a failure of
        the solver.
    words : str
        Lines of text.
    """

    outcome: Outcome
    words: str


def violations(
    program: Program, solution: Solution, tolerance: float = VIOLATION_TOLERANCE
) -> list[Violation]:
    """Return the largest violation of each violated constraint, the worst constraint first.

    They are in the order of their size relative to the range of their bounds or to a typical size.

    Parameters
    ----------
    program : Program
        From `transcribe`.
    solution : Solution
        Where its iteration ended.
    tolerance : float
        Violation up to which a constraint holds, in the unit of the quantity.
    """
    worst: dict[tuple[str, str], tuple[float, Violation]] = {}
    values = np.concatenate([solution.rows, solution.unknowns])
    for size, violation in worst_violations(program, values, tolerance):
        key = violation.role, violation.label.full
        if key not in worst or size > worst[key][0]:
            worst[key] = size, violation
    return [each for _, each in sorted(worst.values(), key=lambda pair: -pair[0])]


def violation_words(violation: Violation) -> str:
    """Return a violation as a sentence."""
    label, role, at = violation.label, violation.role, f"at t = {violation.t:.4g} s"
    size = number(label, violation.size)
    if role == EQUATION:
        return f"{subject(label, role)} ({label.words}) is not met by {size} {at}"
    side = "below" if violation.value < violation.bound else "above"
    return f"{subject(label, role)} is {size} {side} {number(label, violation.bound)} {at}"


def explanation(program: Program, solution: Solution, first: Array) -> Explanation:
    """Explain the end of a search: its result, its violations, and the bounds to relax.

    Parameters
    ----------
    program : Program
        From `transcribe`.
    solution : Solution
        Where its iteration ended.
    first : ndarray, shape (n_w,)
        Where it began, not scaled.
    """
    found = violations(program, solution)
    is_infeasible = solution.status == INFEASIBLE_STATUS
    if found:
        kept = "the last iterate" if is_infeasible else "the iterate of least violation"
    else:
        kept = "a motion that meets all constraints, not the one of least cost"
    words = ipopt_words(solution.status)
    lines = [f"{words} after {solution.iterations} iterations; kept is {kept}"]
    if found:
        lines.append(f"largest violations there, of {len(found)} violated constraints:")
        lines += [f"  {violation_words(each)}" for each in found[:MAX_NAMED_VIOLATIONS]]
    if solution.status == STOPPED_STATUS:  # who stops a search does not wait for another
        return Explanation(Outcome.INTERRUPTED, "\n".join(lines))
    relaxation = relax(program, first)
    lines += _relaxation_lines(relaxation)
    if relaxation.success:
        is_infeasible = bool(relaxation.relaxed)
    outcome = Outcome.INFEASIBLE if is_infeasible else Outcome.SOLVER_FAILURE
    return Explanation(outcome, "\n".join(lines))


def _relaxation_lines(relaxation: Relaxation) -> list[str]:
    if not relaxation.success:
        return [
            f"no relaxation of the bounds was found: {ipopt_words(relaxation.status)}, even with "
            "all bounds but the start and the duration free; try another guess"
        ]
    if not relaxation.relaxed:
        return [
            "no bound must be relaxed: a motion within all constraints was found without the "
            "costs; try it as a guess, or more iterations"
        ]
    lines = ["a motion was found with relaxed bounds (one sufficient set; others may exist):"]
    for each in relaxation.relaxed:
        given, needed = (number(each.label, value) for value in (each.bound, each.value))
        lines.append(
            f"  {subject(each.label, each.role)}: {needed} instead of {given} at t = {each.t:.4g} s"
        )
    if relaxation.held:
        lines.append("these bounds were kept; relaxing one of them relaxes those above less:")
    for held in relaxation.held:
        bound = f"{held.side} {number(held.label, held.bound)}".lstrip()
        lines.append(f"  {subject(held.label, held.role)}: {bound}")
    return lines
