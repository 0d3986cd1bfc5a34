"""Explain why a search ended without a plan: violations, and bounds to relax."""

from __future__ import annotations

import numpy as np

from slipfree.plan.constraints import EQUATION, VIOLATION_TOLERANCE, Violation, worst_violations
from slipfree.plan.elastic import Relaxation, relax
from slipfree.plan.ipopt import Solution
from slipfree.plan.messages import number, subject
from slipfree.plan.transcription import Program
from slipfree.records import Array

MAX_NAMED_VIOLATIONS = 5  # violations that an explanation names
STATUS_WORDS = {  # meaning of IPOPT's status for a plan
    "Solve_Succeeded": "the plan is solved",
    "Solved_To_Acceptable_Level": "the plan is solved, to a lesser accuracy",
    "Infeasible_Problem_Detected": "the constraints contradict each other where the search ended",
    "Restoration_Failed": "the search found no way back to the constraints",
    "Maximum_Iterations_Exceeded": "the search did not end within its iterations",
    "Maximum_CpuTime_Exceeded": "the search did not end within its time",
    "Maximum_WallTime_Exceeded": "the search did not end within its time",
    "User_Requested_Stop": "the search was stopped",
    "Diverging_Iterates": "the search ran away: something that pays has no bound",
    "Search_Direction_Becomes_Too_Small": "the search made no more progress",
    "Error_In_Step_Computation": "the search found no next step",
    "Not_Enough_Degrees_Of_Freedom": "there are more equations than unknowns",
    "Invalid_Number_Detected": "a function of the model has no value where the search looked",
}


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
        return f"{subject(label, role)} is not met by {size} {at}"
    side = "below" if violation.value < violation.bound else "above"
    return f"{subject(label, role)} is {size} {side} {number(label, violation.bound)} {at}"


def explanation(program: Program, solution: Solution, first: Array) -> str:
    """Return lines that state how a search ended, its violations, and the relaxed bounds.

    Parameters
    ----------
    program : Program
        From `transcribe`.
    solution : Solution
        Where its iteration ended.
    first : ndarray, shape (n_w,)
        Where it began, not scaled.
    """
    meant = STATUS_WORDS.get(solution.status, "the search ended")
    lines = [f"{meant} ({solution.status}, after {solution.iterations} iterations)"]
    found = violations(program, solution)
    if found:
        lines.append(f"violated most there, of {len(found)} constraints:")
        lines += [f"  {violation_words(each)}" for each in found[:MAX_NAMED_VIOLATIONS]]
    # Who stopped a search does not wait for another.
    if not solution.success and solution.status != "User_Requested_Stop":
        lines += _relaxation_lines(relax(program, first))
    return "\n".join(lines)


def _relaxation_lines(relaxation: Relaxation) -> list[str]:
    if not relaxation.success:
        meant = STATUS_WORDS.get(relaxation.status, "it ended")
        return [
            f"no relaxation of the bounds was found: {meant} ({relaxation.status}), even with all "
            "bounds but the start and the duration free; try another guess"
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
