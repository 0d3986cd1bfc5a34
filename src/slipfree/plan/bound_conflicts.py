"""What makes a plan impossible before it is sought: bounds that conflict."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.dae import Limit
from slipfree.plan.constraints import (
    GOAL,
    INPUT,
    LIMIT,
    WAY_POINT,
    WITHIN,
    plain_of,
    plainly,
    role_of,
    shift_of,
)
from slipfree.plan.messages import LIMITED, MODEL, bounds_words, number, rate_of, subject
from slipfree.plan.transcription import Place, Task
from slipfree.records import Array, Label, leaves
from slipfree.trajectory import Trajectory

ROUNDING = 1e-9  # by which bounds may miss each other, in their unit
REMEDIES = {
    "start": "start elsewhere",
    LIMIT: "widen the limit",
    INPUT: "widen the bounds of the input",
    GOAL: "move the goal",
    WAY_POINT: "move the way-point",
    MODEL: "change the model",
}


class _Bounds(NamedTuple):
    """What is asked for before there is a program: ``lower <= expression <= upper``.

    ``fraction`` of the duration is the time at which, nan for all along the way; ``shift`` leads to
    map coordinates.
    """

    label: Label
    role: str
    expression: ca.SX
    lower: float
    upper: float
    shift: float
    fraction: float


def conflicts(task: Task, start: Trajectory | None) -> list[str]:
    """Return what makes a plan impossible by itself, one sentence each; none if nothing does.

    Parameters
    ----------
    task : Task
        The problem.
    start : Trajectory or None
        Its last sample is where the plan begins; without it only what depends on nothing but states
        is compared to the start.
    """
    asked = list(_asked(task))
    along = [bounds for bounds in asked if np.isnan(bounds.fraction)]
    begin = np.full(len(task.dae.scale), np.nan) if start is None else task.dae.rows("z", start, -1)
    found = [*_crossed(task), *_outside(task, along, "start", np.append(task.start, begin))]
    for place in task.places:
        formulas = [bounds for bounds in along if plain_of(task, bounds.expression) is None]
        found += _outside(task, formulas, role_of(place.fraction), _known(task, place))
    for one, other in combinations(asked, 2):
        apart = max(one.lower - other.upper, other.lower - one.upper)
        together = np.isnan([one.fraction, other.fraction]).any() or one.fraction == other.fraction
        if apart > ROUNDING and together and ca.is_equal(one.expression, other.expression):
            remedies = dict.fromkeys([_remedy(one.role), _remedy(other.role)])
            found.append(f"{_must(one)}, but {_must(other)}: {' or '.join(remedies)}")
    return found


def _asked(task: Task) -> Iterator[_Bounds]:
    """Yield all bounds but those on rates of inputs, goal and way-points first."""
    for place in task.places:
        for limit in place.limits:
            yield _bounds(task, limit, role_of(place.fraction), place.fraction)
    for limit in task.limits:
        yield _bounds(task, limit, LIMIT)
    for limit in task.dae.limits:
        if not any(
            ca.is_equal(limit.expression, own.expression) and limit.label == own.label
            for own in task.limits
        ):
            yield _bounds(task, limit, MODEL)
    for label, u, (low, high) in zip(
        leaves(task.dae.labels.u), leaves(task.dae.u), task.inputs, strict=True
    ):
        yield _bounds(task, Limit(label, u, low, high), INPUT)


def _bounds(task: Task, limit: Limit, role: str, fraction: float = np.nan) -> _Bounds:
    shift = shift_of(task, limit.expression)
    return _Bounds(
        plainly(limit.label), role, limit.expression, limit.lower, limit.upper, shift, fraction
    )


def _crossed(task: Task) -> Iterator[str]:
    """Yield what is wrong with the bounds of inputs and of their rates by themselves."""
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
                f"{subject(rate, INPUT)} must be {bounds_words(rate, low, high)}, but an input "
                "does not change on the last interval: let the bounds include 0"
            )


def _known(task: Task, place: Place) -> Array:
    """Return the states and unknowns that a place says, nan for the others, shape (n_x + n_z,)."""
    n_x, n_z = task.start.size, task.dae.scale.size
    known = np.full(n_x + n_z, np.nan)
    for limit in place.limits:
        plain = plain_of(task, limit.expression)
        if plain is not None and limit.lower == limit.upper:
            known[plain[1] + (n_x if plain[0] == "z" else 0)] = limit.lower
    return known


def _outside(task: Task, along: list[_Bounds], role: str, known: Array) -> Iterator[str]:
    """Yield which bounds along the way do not hold with the states and unknowns of a place."""
    x, z, u = task.dae.columns()
    xz = ca.vertcat(x, z)
    unknown = ca.vertcat(task.dae.t, u, xz[np.flatnonzero(np.isnan(known)).tolist()])
    for bounds in along:
        if ca.depends_on(bounds.expression, unknown):
            continue
        # What is not known is not in the expression either, but must be a number.
        here = task.dae.function("here", [xz, u, task.dae.t], [bounds.expression])
        value = float(here(np.nan_to_num(known), 0.0, 0.0))
        if max(bounds.lower - value, value - bounds.upper) > WITHIN:
            plain = plain_of(task, bounds.expression) is not None
            what = "" if plain else f" ({bounds.label.words.removesuffix(LIMITED)})"
            yield (
                f"{_must(bounds)}, but the {role} has "
                f"{number(bounds.label, value + bounds.shift)}{what}: {_remedy(role)} or "
                f"{_remedy(bounds.role)}"
            )


def _must(bounds: _Bounds) -> str:
    low, high = bounds.lower + bounds.shift, bounds.upper + bounds.shift
    return f"{subject(bounds.label, bounds.role)} must be {bounds_words(bounds.label, low, high)}"


def _remedy(role: str) -> str:
    return REMEDIES[role.split(" ")[0]]
