"""Relax the bounds of an infeasible program at least cost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy

from slipfree.plan.constraints import (
    EQUATION,
    VIOLATION_TOLERANCE,
    ConstraintGroup,
    Violation,
    bound_of,
    constraint_groups,
    size_of,
    worst_violations,
)
from slipfree.plan.ipopt import Solution, solve_program
from slipfree.plan.messages import DURATION
from slipfree.plan.transcription import Index, Program, completed
from slipfree.records import Array, Label

MAX_RELAXATION_ITERATIONS = 200  # iterations of each of the two searches for a relaxation
MIN_SHARE = 0.05  # smallest reported effect of a bound on the relaxation, per unit of the bound
SIDE_WORDS = {1.0: "at least", -1.0: "at most"}  # by the sign of the missing amount


class OpposingBound(NamedTuple):
    """A bound that was kept and opposes the relaxed ones.

    Attributes
    ----------
    label, role : Label, str
        As in `Violation`; ``"duration"`` is a role as well.
    bound : float
        In the label's unit and in map coordinates.
    side : str
        ``"at least"`` or ``"at most"``; empty for an equation.
    share : float
        By how much less the others would give, relative to their sizes, for each unit of its own
        size by which it were moved.
    """

    label: Label
    role: str
    bound: float
    side: str
    share: float


class Relaxation(NamedTuple):
    """The bounds that were relaxed so that the equations of motion have a solution.

    Attributes
    ----------
    solution : ndarray, shape (n_w,)
        Unknowns that satisfy the equations, and all bounds but the relaxed ones.
    relaxed : list of Violation
        Each bound that gave, by how much, and where first by so much.
    held : list of Held
        The bounds against which they gave, the most important first.
    success : bool
        Whether the search for it ended.
    status : str
        IPOPT's words.
    """

    solution: Array
    relaxed: list[Violation]
    held: list[OpposingBound]
    success: bool
    status: str


def relax(
    program: Program, first: Array, iterations: int = MAX_RELAXATION_ITERATIONS
) -> Relaxation:
    """Return a motion that violates the bounds as little as possible.

    Equations, start and duration hold. Every other bound may move by a slack of its own, the same
    at all times, and the sum of the slacks, relative to the sizes of the bounds, is least; this
    leaves few that are not zero. It is a minimum near the first guess: others may be lower. Of the
    motions with these slacks, one of least cost is returned, if the search for it succeeds.

    Parameters
    ----------
    program : Program
        From `transcribe`.
    first : ndarray, shape (n_w,)
        First guess, not scaled.
    iterations : int
        Most iterations of each search.
    """
    weights = np.array([*(cost.weight for cost in program.task.costs), program.task.smooth])
    first = completed(program, first)
    values = np.append(_row_values(program, first, weights), first)
    soft = [
        (group, sign)
        for group in constraint_groups(program)
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
    found = solve_program(elastic, 0 * weights, np.append(first, over), iterations=iterations)
    unknowns = _least_cost(elastic, found, weights, len(soft), iterations)[: first.size]
    values = np.append(_row_values(program, unknowns, weights), unknowns)
    relaxed = sorted(
        worst_violations(program, values, VIOLATION_TOLERANCE), key=lambda pair: -pair[0]
    )
    gave = {(each.role, each.label.full) for _, each in relaxed}
    held = [
        each
        for each in _opposing_bounds(program, soft, found)
        if each.share > MIN_SHARE and (each.role, each.label.full) not in gave
    ]
    return Relaxation(
        unknowns,
        [each for _, each in relaxed],
        sorted(held, key=lambda each: -each.share) if relaxed else [],
        found.success,
        found.status,
    )


def _least_cost(
    elastic: Program, found: Solution, weights: Array, count: int, iterations: int
) -> Array:
    """Return the unknowns of least cost with no larger slacks, or those found."""
    if not found.success:
        return found.unknowns
    upper = elastic.upper.copy()
    upper[-count:] = np.maximum(found.unknowns[-count:], 0.0) + VIOLATION_TOLERANCE / 2
    cost = abs(float(elastic.gradient(found.unknowns / elastic.scale, weights)[0]))
    again = solve_program(
        replace(elastic, upper=upper),
        weights / max(1.0, cost),
        found.unknowns,
        iterations=iterations,
    )
    return again.unknowns if again.success else found.unknowns


def _opposing_bounds(
    program: Program, soft: list[tuple[ConstraintGroup, float]], found: Solution
) -> Iterator[OpposingBound]:
    """Yield the price of each bound of an elastic program, from its multipliers."""
    counts = [group.where.size for group, _ in soft]
    prices = found.row_multipliers[found.rows.size - sum(counts) :]
    parts = np.split(prices, np.cumsum(counts)[:-1])
    for k, (group, sign) in enumerate(soft):
        equal, price, side = group.lower == group.upper, parts[k], SIDE_WORDS[sign]
        if equal and sign < 0:
            continue
        if equal:
            # The two bounds of an equation push against each other: the difference counts.
            price, side = price + parts[k + 1], ""
        share = float(np.abs(price).sum())
        yield OpposingBound(
            group.label, group.role, bound_of(group, sign) + group.shift, side, share
        )
    at = program.layout.duration
    cost, duration = float(found.bound_multipliers[at]), float(found.unknowns[at])
    label = Label(DURATION, "s", "duration of the plan")
    # Multipliers of upper bounds are positive.
    yield OpposingBound(
        label, DURATION, duration, SIDE_WORDS[-np.sign(cost) or 1.0], abs(cost) * duration
    )


def _elastic_program(
    program: Program, soft: list[tuple[ConstraintGroup, float]], sizes: Array
) -> Program:
    """Return the program with a slack for each bound, behind its unknowns, with given scales.

    Its cost is the sum of the slacks and the program's cost: none if the weights are zero.
    """
    hard = np.concatenate(
        [group.where for group in constraint_groups(program) if group.role == EQUATION]
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
    pick = _sparse_matrix(np.ones(rows.size), np.arange(rows.size), rows, (rows.size, n_all))
    move = _sparse_matrix(signs * sizes[which], own, which, (rows.size, len(soft)))
    problem, gradient, jacobian, hessian = _elastic_functions(program, pick, move)
    lower, upper = (
        _start_bounds(program, side, free)
        for side, free in ((program.lower, -np.inf), (program.upper, np.inf))
    )
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
    """Return functions and derivatives of the elastic program from those of the program.

    Rows are ``pick (rows, unknowns) + move slacks``.
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


def _start_bounds(program: Program, bounds: Array, free: float) -> Array:
    """Return bounds of the unknowns with only those of start and duration."""
    kept = np.full(bounds.size, free)
    for where in (program.layout.first, program.layout.duration):
        kept[where] = bounds[where]
    return kept


def _sparse_matrix(values: Array, rows: Index, columns: Index, shape: tuple[int, int]) -> ca.DM:
    matrix = scipy.sparse.csc_matrix((values, (rows, columns)), shape)
    starts, inside = matrix.indptr.tolist(), matrix.indices.tolist()
    return ca.DM(ca.Sparsity(*shape, starts, inside), matrix.data)


def _row_values(program: Program, unknowns: Array, weights: Array) -> Array:
    """Return the values of all rows, shape (n_g,)."""
    return np.array(program.jacobian(unknowns / program.scale, weights)[0]).ravel()
