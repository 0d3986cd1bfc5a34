"""Constraints of a plan: groups of rows, violations, messages, and contradictory bounds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.dae import Limit
from slipfree.core.facts import printed_unit
from slipfree.core.records import Array, Label, leaves
from slipfree.core.trajectory import Trajectory
from slipfree.plan.transcription import (
    Index,
    PlanTask,
    Program,
    bounded_rates,
    rate_of,
    variable_of,
)

VIOLATION_TOLERANCE = 1e-6  # smaller violations count as rounding, in the unit of the quantity
EQUATION, LIMIT, INPUT, GOAL, WAY_POINT = "equation", "limit", "input", "goal", "way-point"
COST = "cost"
MODEL = "model"  # role of limits of the model that the program does not contain yet
DURATION = "duration"
LIMITED_SUFFIX = " is limited by the plan"  # end of the description of a limit of the plan
FIXED_POINT_FROM = 1000.0  # larger values have three decimals, since four digits are too few
LIMIT_CLEARANCE = 1e-5  # distance of plans from limits of the model, in their units
BOUND_TOLERANCE = 1e-9  # largest gap between consistent bounds, in their unit
ATTITUDE = "upright", "tip_over"  # names of limits of the model
REMEDIES = {
    "start": "start elsewhere",
    LIMIT: "widen the limit",
    INPUT: "widen the bounds of the input",
    GOAL: "move the goal",
    WAY_POINT: "move the way-point",
    MODEL: "adapt vehicle or ground",
}


class Violation(NamedTuple):
    """Largest violation of a constraint."""

    label: Label  # label of the constrained quantity, with its wheel
    t: float  # time of the violation [s]
    interval: int  # index of the mesh interval that contains this time
    size: float  # size of the violation, in the label's unit
    bound: float  # violated bound as reported (`Dae.reported`), in the label's unit
    value: float  # value of the quantity, likewise
    role: str  # "equation", "limit", "input", "cost", "goal" or name of a way-point
    place: str  # text with time and position on the map, if the model has a position


class Constraint(NamedTuple):
    """One constraint of a plan: ``lower <= expression <= upper``.

    Before transcription, ``parts`` is empty if it applies at all times. In a program, it has rows
    (constraint functions) or unknowns at n points.
    """

    label: Label  # constrained quantity and kind of constraint, as in `Violation`
    role: str
    expression: ca.SX
    lower: float  # bounds, in the label's unit and in local coordinates
    upper: float
    shift: float  # reported value minus local value; zero for quantities that are not coordinates
    parts: Array = np.zeros(0)  # shape (n,): time of each point as a fraction of the duration
    intervals: Index = np.zeros(0, np.intp)  # shape (n,): mesh interval of each point
    where: Index = np.zeros(0, np.intp)  # shape (n,): indices of all rows, then all unknowns
    typical: float = 0.0  # of the terms of an equation, in the label's unit; else zero


def with_clearance(limit: Limit, clearance: float = LIMIT_CLEARANCE) -> Limit:
    """Return a limit that is narrower by a clearance on both sides, in the unit of its label."""
    return limit._replace(lower=limit.lower + clearance, upper=limit.upper - clearance)


def with_first_limits(task: PlanTask) -> PlanTask:
    """Return a task with the limits of the model that its first search needs.

    They are the limits of single states, the stops of joints: as bounds of unknowns they add no
    rows, and without them joints fold at cusps of a guess, from where later searches do not return.
    Vehicles whose wheels press into the ground could overturn during a search; for these, the
    limits include those of the attitude.
    """
    have, added = {limit.label.full for limit in task.limits}, list[Limit]()
    attitude = ATTITUDE if task.dae.rest.numel() else ()
    for limit in task.dae.all_limits:
        is_state = (variable_of(task, limit.expression) or "")[:1] == ("x",)
        if (is_state or limit.label.name in attitude) and limit.label.full not in have:
            added.append(with_clearance(limit))
    return replace(task, limits=(*task.limits, *added))


def constraint(task: PlanTask, limit: Limit, role: str, *places: Any) -> Constraint:
    """Return a limit as a constraint of a plan; ``places`` are the fields after ``shift``."""
    label = replace(limit.label, name=limit.label.name.removesuffix("_limit"))
    shift = shift_of(task, limit.expression)
    return Constraint(label, role, *limit[1:4], shift, *places)


def constraints_of(program: Program) -> Iterator[Constraint]:
    """Yield the constraints of a program, each with all its rows or unknowns."""
    task, mesh, layout = program.task, program.mesh, program.layout
    rows, n_g, count = program.row_blocks[0], program.g_lower.size, mesh.ends.size - 1
    each, every, dae = len(rows.labels), np.arange(count), task.dae
    points = mesh.nodes[1:], np.repeat(every, mesh.degree)
    inputs, jumps = [*zip(leaves(dae.labels.u), leaves(dae.u), strict=True)], bounded_rates(task)
    size = (each - len(jumps)) // mesh.degree
    limits = [limit for limit in task.limits if variable_of(task, limit.expression) is None]
    n_x, n_z, n_r = (part.shape[-1] for part in (layout.first, layout.unknowns, layout.roots))
    typical = np.concatenate([np.ones(n_x), dae.scale[:n_z], np.ones(n_r)])
    for r, label in enumerate(rows.labels[:size]):
        where = (each * every[:, None] + size * np.arange(mesh.degree) + r).ravel()
        if r < size - len(limits):
            equation = Limit(label, ca.SX(0), 0.0, 0.0)
            yield constraint(task, equation, EQUATION, *points, where, typical[r])
        else:
            yield constraint(task, limits[r - size + len(limits)], LIMIT, *points, where)
    for r, k in enumerate(jumps, each - len(jumps)):
        rate = Limit(replace(rate_of(inputs[k][0]), wheel=None), ca.SX(0), *task.accelerations[k])
        yield constraint(task, rate, INPUT, mesh.ends[1:], every, each * every + r)
    begin = each * count
    for condition, row_block in zip(task.conditions, program.row_blocks[1:], strict=True):
        k = int(np.flatnonzero(np.isin(layout.states[:, -1, 0], row_block.where))[0])
        for limit in condition.limits:
            place = mesh.ends[[k + 1]], np.array([k]), np.array([begin])
            yield constraint(task, limit, role_of(condition.fraction), *place)
            begin += 1
    for k, highest in task.cost_limits:
        limit = Limit(task.costs[k].label, ca.SX(0), -np.inf, highest)
        yield constraint(task, limit, COST, mesh.ends[-1:], every[-1:], np.array([begin]))
        begin += 1
    for limit in task.limits:
        plain = variable_of(task, limit.expression)
        if plain is not None:
            where = (layout.states if plain[0] == "x" else layout.unknowns)[:, :, plain[1]]
            yield constraint(task, limit, LIMIT, *points, n_g + where.ravel())
    for where, (label, u), bounds in zip(layout.inputs.T, inputs, task.inputs, strict=True):
        place = mesh.ends[: where.size], np.arange(where.size).clip(max=count - 1), n_g + where
        yield constraint(task, Limit(label, u, *bounds), INPUT, *place)


def worst_violations(program: Program, values: Array) -> Iterator[tuple[float, Violation]]:
    """Yield the relative size and the largest violation of each violated bound.

    ``values`` are those of the constraint functions, then of the unknowns, as in
    `Constraint.where`.
    """
    duration = values[program.g_lower.size + program.layout.duration]
    for group in constraints_of(program):
        size = size_of(group, values)
        for sign in (1.0, -1.0):
            bound, here = bound_of(group, sign), values[group.where]
            over = sign * (bound - here)
            worst = over.max()
            if not worst > VIOLATION_TOLERANCE:
                continue
            # The earliest of equally large violations is reported.
            k = int(np.flatnonzero(over >= worst - VIOLATION_TOLERANCE)[0])
            yield (
                worst / size,
                Violation(
                    group.label,
                    float(group.parts[k] * duration),
                    int(group.intervals[k]),
                    float(worst),
                    float(bound + group.shift),
                    float(here[k] + group.shift),
                    group.role,
                    place_words(program, values, group.parts[k]),
                ),
            )


def place_words(program: Program, values: Array, fraction: float) -> str:
    """Return time and map coordinates of a motion at the node nearest to a fraction of time."""
    dae, layout, n_g = program.task.dae, program.layout, program.g_lower.size
    node = int(np.abs(program.mesh.nodes - fraction).argmin())
    where = n_g + np.vstack([layout.first, layout.states.reshape(-1, layout.first.size)])[node]
    named = dict(zip(dae.state_names, values[where] + dae.shift[0], strict=True))
    words = [f"{axis} = {named[axis]:.2f} m" for axis in ("x", "y") if axis in named]
    return ", ".join([f"t = {fraction * values[n_g + layout.duration]:.4g} s", *words])


def bound_of(group: Constraint, sign: float) -> float:
    """Return the lower bound of a constraint if ``sign`` is positive, otherwise the upper bound."""
    return group.lower if sign > 0 else group.upper


def size_of(group: Constraint, values: Array) -> float:
    """Return the divisor that makes violations of a constraint comparable with others.

    It is the typical size of the quantity if known, else the width of the range between the bounds,
    else the largest absolute value; at least 1, except for the width. It is 1 for equal bounds.
    """
    if group.typical:
        return max(1.0, group.typical)
    width = group.upper - group.lower
    if 0 < width < np.inf:
        return float(width)
    # Violations of equal bounds are absolute, in metres and radians.
    one_sided = np.abs(values[group.where]).max() if width else 1.0
    return float(max(1.0, one_sided))


def shift_of(task: PlanTask, expression: ca.SX) -> float:
    """Return reported minus local value of a state or unknown, zero for other expressions."""
    plain = variable_of(task, expression)
    if plain is None:
        return 0.0
    labels: list[Label] = list(leaves(getattr(task.dae.labels, plain[0])))
    label = labels[plain[1]]
    shift = float(task.dae.shift[plain[0] == "z"][plain[1]])
    return shift + float(task.dae.reported.get(label.full, 0.0))


def role_of(fraction: float) -> str:
    """Return ``"goal"`` for the fraction 1 of the duration, otherwise ``"way-point at ..."``."""
    return GOAL if fraction == 1 else f"{WAY_POINT} at {fraction:g}"


def subject(label: Label, role: str) -> str:
    """Return a text for a constrained quantity, such as ``input right_rate``."""
    whose = "the vehicle" if label.wheel is None else f"wheel {label.wheel}"
    if role == INPUT:
        return f"input {label.full}"
    if role == DURATION:
        return "duration"
    if role == COST:
        return f"cost {label.name}"
    if role in (LIMIT, EQUATION, MODEL):
        kind = "equation " if role == EQUATION else "model's own " if role == MODEL else ""
        return f"{kind}{label.name} of {whose}"
    return f"{label.full} at the {role}"


def number(label: Label, value: float) -> str:
    """Return a text for a value with the unit of its label, such as ``0.5 rad/s``."""
    unit = unit_words(label.unit)
    return f"{_digits(value)}{unit and ' '}{unit}"


def missed_words(sizes: Mapping[str, float], units: Mapping[str, str]) -> str:
    """Return violations as text, such as ``x at the goal by 3.1e-04 m``, of wheels the largest."""
    worst = dict[str, str]()  # name of the largest one, by quantity
    for name in sizes:
        quantity = name.partition("[")[0]
        worst[quantity] = max(name, worst.get(quantity, name), key=sizes.__getitem__)
    return ", ".join(
        f"{name} by {sizes[name]:.1e} {unit_words(units[name])}".rstrip() for name in worst.values()
    )


def _digits(value: float) -> str:
    """Return a value as text: four significant digits, or three decimals from 1000 on."""
    value = round(value, 9) + 0.0
    return f"{value:.4g}" if abs(value) < FIXED_POINT_FROM else f"{round(value, 3):.15g}"


def bounds_words(label: Label, low: float, high: float) -> str:
    """Return bounds as text with unit, such as ``0 to 1 m``, ``at most 1 m``, ``1 m`` if equal."""
    if low == high:
        return number(label, low)
    if np.isfinite(low) and np.isfinite(high):
        return f"{_digits(low)} to {number(label, high)}"
    return (
        f"at least {number(label, low)}" if np.isfinite(low) else f"at most {number(label, high)}"
    )


def unit_words(unit: str) -> str:
    """Return a printed unit, such as ``"rad/s"`` for ``"rad s-1"``; empty for ``"1"``."""
    return "" if unit in ("", "1") else printed_unit(unit)


def conflicts(task: PlanTask, start: Trajectory | None) -> list[str]:
    """Return a sentence for each bound that contradicts another one, or a known value.

    Known are values of x and z at the start, way-points and goal. Without ``start``, a settled
    pose, only the states are known at the start.
    """
    all_bounds = list(_all_bounds(task))
    throughout = [bounds for bounds in all_bounds if not bounds.parts.size]
    start_unknowns = np.full(len(task.dae.scale), np.nan)
    if start is not None:
        start_unknowns = task.dae.rows("z", start, -1)
    sentences = [*_input_conflicts(task)]
    sentences += _value_conflicts(task, throughout, "start", np.append(task.start, start_unknowns))
    formulas = [bounds for bounds in throughout if variable_of(task, bounds.expression) is None]
    for condition in task.conditions:
        # States and unknowns fixed by a condition, nan if not fixed, shape (n_x + n_z,).
        n_x, n_z = task.start.size, task.dae.scale.size
        known = np.full(n_x + n_z, np.nan)
        for limit in condition.limits:
            plain = variable_of(task, limit.expression)
            if plain is not None and limit.lower == limit.upper:
                known[plain[1] + (n_x if plain[0] == "z" else 0)] = limit.lower
        sentences += _value_conflicts(task, formulas, role_of(condition.fraction), known)
    for one, other in combinations(all_bounds, 2):
        apart = max(one.lower - other.upper, other.lower - one.upper)
        together = not (one.parts.size and other.parts.size) or one.parts == other.parts
        if apart > BOUND_TOLERANCE and together and ca.is_equal(one.expression, other.expression):
            remedies = dict.fromkeys([_remedy_words(one.role), _remedy_words(other.role)])
            both = f"{_bound_words(one)}, but {_bound_words(other)}"
            sentences.append(f"{both}: {' or '.join(remedies)}")
    return sentences


def _all_bounds(task: PlanTask) -> Iterator[Constraint]:
    """Yield the bounds of way-points, goal, limits, model and inputs, but not of input rates."""
    for condition in task.conditions:
        for limit in condition.limits:
            fraction = np.array([condition.fraction])
            yield constraint(task, limit, role_of(condition.fraction), fraction)
    for limit in task.limits:
        yield constraint(task, limit, LIMIT)
    for limit in task.dae.all_limits:
        if not any(
            ca.is_equal(limit.expression, own.expression) and limit.label == own.label
            for own in task.limits
        ):
            yield constraint(task, limit, MODEL)
    for label, u, (low, high) in zip(
        leaves(task.dae.labels.u), leaves(task.dae.u), task.inputs, strict=True
    ):
        yield constraint(task, Limit(label, u, low, high), INPUT)


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


def _value_conflicts(
    task: PlanTask, throughout: list[Constraint], role: str, known: Array
) -> Iterator[str]:
    """Yield a message for each bound that ``known`` values of x and z violate; NaN if not known."""
    x, z, u = task.dae.columns()
    xz = ca.vertcat(x, z)
    unknown = ca.vertcat(task.dae.t, u, xz[np.flatnonzero(np.isnan(known)).tolist()])
    for bounds in throughout:
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


def _bound_words(bounds: Constraint) -> str:
    low, high = bounds.lower + bounds.shift, bounds.upper + bounds.shift
    return f"{subject(bounds.label, bounds.role)} must be {bounds_words(bounds.label, low, high)}"


def _remedy_words(role: str) -> str:
    return REMEDIES[role.split(" ")[0]]
