"""Explain why a search ended without a plan: violated constraints, and bounds to relax."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slipfree.core.outcome import Outcome
from slipfree.core.records import Array
from slipfree.core.solver_codes import ipopt_words
from slipfree.plan.constraints import EQUATION, VIOLATION_TOLERANCE, Violation, worst_violations
from slipfree.plan.elastic import Relaxation, relax
from slipfree.plan.ipopt import INFEASIBLE_STATUS, STOPPED_STATUS, Solution
from slipfree.plan.messages import number, subject
from slipfree.plan.transcription import Program

MAX_NAMED_VIOLATIONS = 5  # violations that an explanation names


class Explanation(NamedTuple):
    """Outcome of a search without a plan, and its explanation.

    Attributes
    ----------
    outcome : Outcome
        ``INTERRUPTED`` if the search was stopped; ``INFEASIBLE`` if a motion was found only with
        relaxed bounds, or if no relaxation was found and IPOPT reports an infeasible problem;
        otherwise ``SOLVER_FAILURE``.
    words : str
        Explanation, several lines of text.
    """

    outcome: Outcome
    words: str


def violations(
    program: Program, solution: Solution, tolerance: float = VIOLATION_TOLERANCE
) -> list[Violation]:
    """Return the largest violation of each violated constraint, the worst constraint first.

    Violations are sorted by their size relative to the range of the bounds or to a typical size of
    the quantity (`size_of`).

    Parameters
    ----------
    program : Program
        From `transcribe`.
    solution : Solution
        Last or best iterate of the program.
    tolerance : float
        Largest violation of a satisfied constraint, in the unit of its quantity.
    """
    worst: dict[tuple[str, str], tuple[float, Violation]] = {}
    values = np.concatenate([solution.rows, solution.unknowns])
    for size, violation in worst_violations(program, values, tolerance):
        key = violation.role, violation.label.full
        if key not in worst or size > worst[key][0]:
            worst[key] = size, violation
    return [each for _, each in sorted(worst.values(), key=lambda pair: -pair[0])]


def violation_words(violation: Violation) -> str:
    """Return a sentence with the quantity, size, bound and time of a violation."""
    label, role, at = violation.label, violation.role, f"at t = {violation.t:.4g} s"
    size = number(label, violation.size)
    if role == EQUATION:
        return f"{subject(label, role)} ({label.words}) has a residual of {size} {at}"
    side = "below" if violation.value < violation.bound else "above"
    return f"{subject(label, role)} is {size} {side} {number(label, violation.bound)} {at}"


def explanation(program: Program, solution: Solution, first: Array) -> Explanation:
    """Explain the end of a search: IPOPT's status, the violations, and the bounds to relax.

    Parameters
    ----------
    program : Program
        From `transcribe`.
    solution : Solution
        Last or best iterate of the program.
    first : ndarray, shape (n_w,)
        Initial guess of the search, not scaled.
    """
    found = violations(program, solution)
    is_infeasible = solution.status == INFEASIBLE_STATUS
    if found:
        kept = "the last iterate" if is_infeasible else "the iterate of least violation"
    else:
        kept = "a motion that meets all constraints but is not optimal"
    words = ipopt_words(solution.status)
    lines = [f"{words} after {solution.iterations} iterations; the result is {kept}"]
    if found:
        lines.append(f"largest violations of this result ({len(found)} in all):")
        lines += [f"  {violation_words(each)}" for each in found[:MAX_NAMED_VIOLATIONS]]
    if solution.status == STOPPED_STATUS:  # no further search after an interruption
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
            "no motion was found, although all bounds except those of the start and the duration "
            f"could be relaxed: {ipopt_words(relaxation.status)}; try another initial guess"
        ]
    if not relaxation.relaxed:
        return [
            "no bound has to be relaxed: without the costs, a motion that meets all constraints "
            "was found; try another initial guess"
        ]
    lines = ["a motion was found with relaxed bounds (one sufficient set; others may exist):"]
    for each in relaxation.relaxed:
        given, needed = (number(each.label, value) for value in (each.bound, each.value))
        lines.append(
            f"  {subject(each.label, each.role)}: {needed} instead of {given} at t = {each.t:.4g} s"
        )
    if relaxation.opposing:
        lines.append(
            "these bounds were not relaxed; relaxing one of them reduces the relaxations above:"
        )
    for other in relaxation.opposing:
        bound = f"{other.side} {number(other.label, other.bound)}".lstrip()
        lines.append(f"  {subject(other.label, other.role)}: {bound}")
    return lines
