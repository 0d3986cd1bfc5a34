"""Explanation of a failed search: violated constraints, and the smallest relaxation that helps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy

from slipfree.core.records import Array, Label
from slipfree.core.trajectory import Outcome, ipopt_words
from slipfree.plan.constraints import (
    DURATION,
    EQUATION,
    VIOLATION_TOLERANCE,
    Constraint,
    Violation,
    bound_of,
    constraints_of,
    number,
    size_of,
    subject,
    worst_violations,
)
from slipfree.plan.ipopt import (
    INFEASIBLE_STATUS,
    STOPPED_STATUS,
    TIME_STATUS,
    NlpSolution,
    solve_program,
)
from slipfree.plan.transcription import Program, completed

MAX_RELAXATION_ITERATIONS = 200  # of each of the two searches for a relaxation
MANY_NODES = 81  # of a mesh; programs with more are planned sooner in parts of the way
MIN_SHARE = 0.05  # smallest reported effect of a bound on the relaxation, per unit of the bound
SIDE_WORDS = {1.0: "at least", -1.0: "at most"}  # lower bounds have sign 1, upper ones -1
MAX_NAMED_VIOLATIONS = 5  # violations that an explanation names


class OpposingBound(NamedTuple):
    """Bound that was not relaxed and conflicts with the relaxed bounds."""

    label: Label  # bounded quantity
    role: str  # as in `Violation`, or ``"duration"``
    bound: float  # value of the bound, in the label's unit and in map coordinates
    side: str  # ``"at least"`` or ``"at most"``; empty if lower and upper bound are equal
    # decrease of the sum of all relative relaxations per unit of the label by which this bound is
    # relaxed; for the duration, per relative change of it
    share: float


class Relaxation(NamedTuple):
    """Relaxed bounds with which the equations of motion have a solution."""

    solution: Array  # shape (n_w,): unknowns that satisfy the relaxed bounds
    relaxed: list[Violation]  # largest violation of each relaxed bound, relatively sorted
    opposing: list[OpposingBound]  # conflicting bounds, the largest share first
    success: bool  # whether the search for the smallest relaxation converged
    status: str  # IPOPT's return status of this search


def relax(program: Program, first: Array) -> Relaxation:
    """Find the smallest relaxation of the bounds with which a program has a solution.

    The equations, the start and the bounds of the duration are kept. Each other bound is relaxed by
    a slack that is the same at all times. The sum of the slacks, each relative to the size of its
    bound (`size_of`), is minimised; most slacks are then zero. This is a local minimum. Among the
    motions with these slacks, a second search minimises the cost, if it succeeds.
    """
    weights = np.array([*(cost.weight for cost in program.task.costs), program.task.smooth])
    first = completed(program, first)
    values = np.append(_row_values(program, first, weights), first)
    soft = [
        (group, sign)
        for group in constraints_of(program)
        if group.role != EQUATION
        for sign in (1.0, -1.0)
        if np.isfinite(bound_of(group, sign))
    ]
    sizes = np.array([size_of(group, values) for group, _ in soft])
    over = [
        (sign * (bound_of(group, sign) - values[group.where])).max(initial=0.0)
        for group, sign in soft
    ]
    elastic = _elastic_program(program, soft, sizes)
    most, begin = MAX_RELAXATION_ITERATIONS, np.append(first, over)
    solution = solve_program(elastic, 0 * weights, begin, iterations=most)
    unknowns = _least_cost(elastic, solution, weights, len(soft))[: first.size]
    values = np.append(_row_values(program, unknowns, weights), unknowns)
    relaxed = sorted(worst_violations(program, values), key=lambda pair: -pair[0])
    gave = {(each.role, each.label.full) for _, each in relaxed}
    opposing = [
        each
        for each in _opposing_bounds(program, soft, solution)
        if each.share > MIN_SHARE and (each.role, each.label.full) not in gave
    ]
    return Relaxation(
        unknowns,
        [each for _, each in relaxed],
        sorted(opposing, key=lambda each: -each.share) if relaxed else [],
        solution.success,
        solution.status,
    )


def _least_cost(elastic: Program, solution: NlpSolution, weights: Array, count: int) -> Array:
    """Return the unknowns of least cost with no larger slacks; those of the solution on failure."""
    if not solution.success:
        return solution.unknowns
    upper = elastic.upper.copy()
    upper[-count:] = np.maximum(solution.unknowns[-count:], 0.0) + VIOLATION_TOLERANCE / 2
    cost = abs(float(elastic.gradient(solution.unknowns / elastic.scale, weights)[0]))
    again = solve_program(
        replace(elastic, upper=upper),
        weights / max(1.0, cost),
        solution.unknowns,
        iterations=MAX_RELAXATION_ITERATIONS,
    )
    return again.unknowns if again.success else solution.unknowns


def _opposing_bounds(
    program: Program, soft: list[tuple[Constraint, float]], solution: NlpSolution
) -> Iterator[OpposingBound]:
    """Yield each relaxable bound and the duration, with shares computed from multipliers."""
    counts = [group.where.size for group, _ in soft]
    prices = solution.row_multipliers[solution.rows.size - sum(counts) :]
    prices_by_bound = np.split(prices, np.cumsum(counts)[:-1])
    for k, (group, sign) in enumerate(soft):
        equal, price, side = group.lower == group.upper, prices_by_bound[k], SIDE_WORDS[sign]
        if equal and sign < 0:
            continue
        if equal:
            # Multipliers of the two equal bounds have opposite signs.
            price, side = price + prices_by_bound[k + 1], ""
        share = float(np.abs(price).sum())
        yield OpposingBound(
            group.label, group.role, bound_of(group, sign) + group.shift, side, share
        )
    at = program.layout.duration
    cost, duration = float(solution.bound_multipliers[at]), float(solution.unknowns[at])
    label = Label(DURATION, "s", "duration of the plan")
    # Multipliers of upper bounds are positive.
    yield OpposingBound(
        label, DURATION, duration, SIDE_WORDS[-np.sign(cost) or 1.0], abs(cost) * duration
    )


def _elastic_program(
    program: Program, soft: list[tuple[Constraint, float]], sizes: Array
) -> Program:
    """Return the program with a scaled slack for each bound in ``soft``, whose sum is a cost."""
    hard = np.concatenate(
        [group.where for group in constraints_of(program) if group.role == EQUATION]
    )
    rows = np.concatenate([hard, *(group.where for group, _ in soft)])
    counts = [group.where.size for group, _ in soft]
    which = np.repeat(np.arange(len(soft)), counts)
    own = hard.size + np.arange(which.size)
    signs, sides = (
        np.array(part)[which]
        for part in zip(*((sign, bound_of(group, sign)) for group, sign in soft), strict=True)
    )
    n_all = program.g_lower.size + program.scale.size
    pick, move = (
        ca.DM(scipy.sparse.csc_matrix((values, at), (rows.size, columns)))
        for values, at, columns in (
            (np.ones(rows.size), (np.arange(rows.size), rows), n_all),
            (signs * sizes[which], (own, which), len(soft)),
        )
    )
    problem, gradient, jacobian, hessian = _elastic_functions(program, pick, move)
    lower, upper = np.full(program.lower.size, -np.inf), np.full(program.upper.size, np.inf)
    for kept in (program.layout.first, program.layout.duration):
        lower[kept], upper[kept] = program.lower[kept], program.upper[kept]
    zeros = np.zeros(hard.size)
    return replace(
        program,
        problem=problem,
        gradient=gradient,
        jacobian=jacobian,
        hessian=hessian,
        scale=np.append(program.scale, sizes),
        lower=np.append(lower, np.zeros(len(soft))),
        upper=np.append(upper, np.full(len(soft), np.inf)),
        g_lower=np.append(zeros, np.where(signs > 0, sides, -np.inf)),
        g_upper=np.append(zeros, np.where(signs > 0, np.inf, sides)),
    )


def _elastic_functions(
    program: Program, pick: ca.DM, move: ca.DM
) -> tuple[dict[str, Any], ca.Function, ca.Function, ca.Function]:
    """Return the functions of the elastic program and its derivatives.

    Its rows are ``pick @ (rows, unknowns) + move @ slacks``, with the rows and unknowns of
    ``program``.
    """
    n_w, n_g, n_s = program.scale.size, program.g_lower.size, move.shape[1]
    x, p = ca.MX.sym("x", n_w + n_s), program.problem["p"]
    w, s = x[:n_w], x[n_w:]
    cost = ca.Function(
        "cost", [program.problem[name] for name in "xp"], [program.problem[name] for name in "fg"]
    )
    f, g = cost(w, p)
    total = ca.sum1(s) + f
    steep = ca.vertcat(program.gradient(w, p)[1], ca.MX.ones(n_s))
    rows = pick @ ca.vertcat(g, w * program.scale) + move @ s
    inner = program.jacobian(w, p)[1]
    slopes = pick @ ca.vertcat(inner, ca.MX(ca.diag(ca.DM(program.scale))))
    sigma, multipliers = ca.MX.sym("sigma"), ca.MX.sym("lambda", rows.numel())
    curved = program.hessian(w, p, sigma, pick[:, :n_g].T @ multipliers)
    return (
        {"x": x, "p": p, "f": total, "g": rows},
        ca.Function("gradient", [x, p], [total, steep]),
        ca.Function("jacobian", [x, p], [rows, ca.horzcat(slopes, ca.MX(move))]),
        ca.Function("hessian", [x, p, sigma, multipliers], [ca.diagcat(curved, ca.MX(n_s, n_s))]),
    )


def _row_values(program: Program, unknowns: Array, weights: Array) -> Array:
    """Return the values of all rows for unknowns that are not scaled, shape (n_g,)."""
    return np.array(program.jacobian(unknowns / program.scale, weights)[0]).ravel()


class Explanation(NamedTuple):
    """Outcome of a search without a plan, and its explanation."""

    outcome: Outcome  # infeasible only if a relaxation or IPOPT confirms it
    words: str  # explanation, several lines of text


def violations(program: Program, solution: NlpSolution) -> list[Violation]:
    """Return the largest violation of each violated constraint, by relative size (`size_of`)."""
    worst: dict[tuple[str, str], Violation] = {}
    values = np.concatenate([solution.rows, solution.unknowns])
    for _, each in sorted(worst_violations(program, values), key=lambda pair: -pair[0]):
        worst.setdefault((each.role, each.label.full), each)
    return [*worst.values()]


def violation_words(violation: Violation) -> str:
    """Return a sentence with the quantity, size, bound and time of a violation."""
    label, role, at = violation.label, violation.role, f"at {violation.place}"
    size = number(label, violation.size)
    if role == EQUATION:
        return f"{subject(label, role)} ({label.words}) has a residual of {size} {at}"
    side = "below" if violation.value < violation.bound else "above"
    return f"{subject(label, role)} is {size} {side} {number(label, violation.bound)} {at}"


def more_time(program: Program) -> str:
    """Return how a search that its time limit ended may succeed."""
    is_long = program.mesh.ends.size > MANY_NODES
    return "raise plan.seconds" + ", or plan the way in (shorter) parts: plan.window" * is_long


def explanation(
    program: Program, solution: NlpSolution, first: Array, relaxation: Relaxation | None = None
) -> Explanation:
    """Explain the end of a search: IPOPT's status, the violations, and the bounds to relax.

    Without a ``relaxation``, it is searched from ``first``, unless the search was stopped.
    """
    missed = violations(program, solution)
    is_infeasible = solution.status == INFEASIBLE_STATUS
    kept, lines = "a motion that meets all constraints but is not optimal", list[str]()
    if missed:
        kept = "the last iterate" if is_infeasible else "the iterate of least violation"
        lines.append(f"largest violations of this result ({len(missed)} in all):")
        lines += [f"  {violation_words(each)}" for each in missed[:MAX_NAMED_VIOLATIONS]]
    words = f"{ipopt_words(solution.status)} after {solution.iterations} iterations"
    lines = [f"{words}; the result is {kept}", *lines]
    if solution.status == STOPPED_STATUS:  # no further search after an interruption
        return Explanation(Outcome.INTERRUPTED, "\n".join(lines))
    relaxation = relax(program, first) if relaxation is None else relaxation
    is_late = TIME_STATUS in (solution.status, relaxation.status)
    advice = more_time(program) if is_late else "plan.starts = 4 tries other initial guesses"
    if not relaxation.success:
        lines.append(
            "no motion was found, although all bounds except those of the start and the duration "
            f"could be relaxed: {ipopt_words(relaxation.status)}; {advice}"
        )
    elif relaxation.relaxed:
        lines.append(
            "a motion was found with relaxed bounds (one sufficient set; others may exist):"
        )
    else:
        lines.append(
            "no bound has to be relaxed: without the costs, a motion that meets all constraints "
            f"was found; {advice}"
        )
    for each in relaxation.relaxed if relaxation.success else ():
        given, needed = (number(each.label, value) for value in (each.bound, each.value))
        change = f"{needed} instead of {given}"
        if needed == given:  # as far as their digits tell
            side = "above" if each.value > each.bound else "below"
            change = f"{number(each.label, abs(each.value - each.bound))} {side} {given}"
        lines.append(f"  {subject(each.label, each.role)}: {change} at {each.place}")
    if relaxation.success and relaxation.opposing:
        lines.append(
            "these bounds were not relaxed; relaxing one of them reduces the relaxations above:"
        )
        for other in relaxation.opposing:
            bound = f"{other.side} {number(other.label, other.bound)}".lstrip()
            lines.append(f"  {subject(other.label, other.role)}: {bound}")
    is_infeasible = bool(relaxation.relaxed) if relaxation.success else is_infeasible
    outcome = Outcome.INFEASIBLE if is_infeasible else Outcome.SOLVER_FAILURE
    return Explanation(outcome, "\n".join(lines))
