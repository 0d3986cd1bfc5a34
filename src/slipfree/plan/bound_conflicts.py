"""Find contradictory bounds of an optimal control problem before it is solved."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.dae import Limit
from slipfree.core.records import Array, Label, leaves
from slipfree.core.trajectory import Trajectory
from slipfree.plan.constraints import (
    GOAL,
    INPUT,
    LIMIT,
    VIOLATION_TOLERANCE,
    WAY_POINT,
    quantity_label,
    role_of,
    shift_of,
    variable_of,
)
from slipfree.plan.messages import LIMITED_SUFFIX, MODEL, bounds_words, number, rate_of, subject
from slipfree.plan.transcription import PlanTask, TimedCondition

BOUND_TOLERANCE = 1e-9  # largest gap between consistent bounds, in their unit
REMEDIES = {
    "start": "start elsewhere",
    LIMIT: "widen the limit",
    INPUT: "widen the bounds of the input",
    GOAL: "move the goal",
    WAY_POINT: "move the way-point",
    MODEL: "adapt vehicle or ground",
}


class _Bounds(NamedTuple):
    """Bounds of an expression before transcription: ``lower <= expression <= upper``.

    ``fraction`` is the time at which the bounds apply as a fraction of the duration, nan if they
    apply at all times. ``shift`` is the reported value minus the local value.
    """

    label: Label
    role: str
    expression: ca.SX
    lower: float
    upper: float
    shift: float
    fraction: float


def conflicts(task: PlanTask, start: Trajectory | None) -> list[str]:
    """Return one sentence for each pair of contradictory bounds.

    Parameters
    ----------
    task : PlanTask
        Optimal control problem.
    start : Trajectory or None
        Trajectory whose last sample is the start of the plan. If it is None, the algebraic unknowns
        at the start are not known, and only bounds on functions of the states are compared with
        the start.
    """
    asked = list(_all_bounds(task))
    along = [bounds for bounds in asked if np.isnan(bounds.fraction)]
    begin = np.full(len(task.dae.scale), np.nan) if start is None else task.dae.rows("z", start, -1)
    found = [
        *_input_conflicts(task),
        *_value_conflicts(task, along, "start", np.append(task.start, begin)),
    ]
    for condition in task.conditions:
        formulas = [bounds for bounds in along if variable_of(task, bounds.expression) is None]
        found += _value_conflicts(
            task, formulas, role_of(condition.fraction), _condition_values(task, condition)
        )
    for one, other in combinations(asked, 2):
        apart = max(one.lower - other.upper, other.lower - one.upper)
        together = np.isnan([one.fraction, other.fraction]).any() or one.fraction == other.fraction
        if apart > BOUND_TOLERANCE and together and ca.is_equal(one.expression, other.expression):
            remedies = dict.fromkeys([_remedy_words(one.role), _remedy_words(other.role)])
            found.append(f"{_bound_words(one)}, but {_bound_words(other)}: {' or '.join(remedies)}")
    return found


def _all_bounds(task: PlanTask) -> Iterator[_Bounds]:
    """Yield the bounds of way-points, goal, limits, model and inputs, but not of input rates."""
    for condition in task.conditions:
        for limit in condition.limits:
            yield _to_bounds(task, limit, role_of(condition.fraction), condition.fraction)
    for limit in task.limits:
        yield _to_bounds(task, limit, LIMIT)
    for limit in task.dae.limits:
        if not any(
            ca.is_equal(limit.expression, own.expression) and limit.label == own.label
            for own in task.limits
        ):
            yield _to_bounds(task, limit, MODEL)
    for label, u, (low, high) in zip(
        leaves(task.dae.labels.u), leaves(task.dae.u), task.inputs, strict=True
    ):
        yield _to_bounds(task, Limit(label, u, low, high), INPUT)


def _to_bounds(task: PlanTask, limit: Limit, role: str, fraction: float = np.nan) -> _Bounds:
    shift = shift_of(task, limit.expression)
    return _Bounds(
        quantity_label(limit.label),
        role,
        limit.expression,
        limit.lower,
        limit.upper,
        shift,
        fraction,
    )


def _input_conflicts(task: PlanTask) -> Iterator[str]:
    """Yield a sentence for each contradiction in the bounds of an input and of its rate."""
    for k, label in enumerate(leaves(task.dae.labels.u)):
        rate = rate_of(label)
        for own, (low, high) in ((label, task.inputs[k]), (rate, task.accelerations[k])):
            if not low <= high:
                yield (
                    f"{subject(own, INPUT)} must be at least {number(own, low)} and at most "
                    f"{number(own, high)}: exchange its bounds"
                )
        low, high = task.accelerations[k]
        if low <= high and not low <= 0 <= high and not task.continuous:
            yield (
                f"{subject(rate, INPUT)} must be {bounds_words(rate, low, high)}, but all inputs "
                "are constant on the last interval: widen the bounds so that they include 0"
            )


def _condition_values(task: PlanTask, condition: TimedCondition) -> Array:
    """Return states and unknowns fixed by a condition, nan if not fixed, shape (n_x + n_z,)."""
    n_x, n_z = task.start.size, task.dae.scale.size
    known = np.full(n_x + n_z, np.nan)
    for limit in condition.limits:
        plain = variable_of(task, limit.expression)
        if plain is not None and limit.lower == limit.upper:
            known[plain[1] + (n_x if plain[0] == "z" else 0)] = limit.lower
    return known


def _value_conflicts(
    task: PlanTask, along: list[_Bounds], role: str, known: Array
) -> Iterator[str]:
    """Yield a message for each bound that known values of states and algebraic unknowns violate.

    ``known`` contains these values, and NaN where none is known, shape (n_x + n_z,).
    """
    x, z, u = task.dae.columns()
    xz = ca.vertcat(x, z)
    unknown = ca.vertcat(task.dae.t, u, xz[np.flatnonzero(np.isnan(known)).tolist()])
    for bounds in along:
        if ca.depends_on(bounds.expression, unknown):
            continue
        # Unknown values are not in the expression, but arguments must be numbers.
        here = task.dae.function("here", [xz, u, task.dae.t], [bounds.expression])
        value = float(here(np.nan_to_num(known), 0.0, 0.0))
        if max(bounds.lower - value, value - bounds.upper) > VIOLATION_TOLERANCE:
            plain = variable_of(task, bounds.expression) is not None
            details = "" if plain else f" ({bounds.label.words.removesuffix(LIMITED_SUFFIX)})"
            yield (
                f"{_bound_words(bounds)}, but the {role} has "
                f"{number(bounds.label, value + bounds.shift)}{details}: {_remedy_words(role)} or "
                f"{_remedy_words(bounds.role)}"
            )


def _bound_words(bounds: _Bounds) -> str:
    low, high = bounds.lower + bounds.shift, bounds.upper + bounds.shift
    return f"{subject(bounds.label, bounds.role)} must be {bounds_words(bounds.label, low, high)}"


def _remedy_words(role: str) -> str:
    return REMEDIES[role.split(" ")[0]]
