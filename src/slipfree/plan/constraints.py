"""Group the constraints of a program by quantity, and compute their violations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.records import Array, Label, leaves
from slipfree.plan.transcription import Index, PlanTask, Program, RowBlock

VIOLATION_TOLERANCE = 1e-6  # smaller violations count as rounding, in the unit of the quantity
EQUATION, LIMIT, INPUT, GOAL, WAY_POINT = "equation", "limit", "input", "goal", "way-point"
COST = "cost"


class Violation(NamedTuple):
    """Largest violation of a constraint.

    Attributes
    ----------
    label : Label
        Label of the constrained quantity, with its wheel.
    t : float
        Time of the violation. [s]
    interval : int
        Index of the mesh interval that contains this time.
    size : float
        Size of the violation, in the label's unit.
    bound, value : float
        Violated bound and value of the quantity as reported (`Dae.reported`), in the label's unit.
    role : str
        Kind of constraint: ``"equation"``, ``"limit"``, ``"input"``, ``"cost"``, ``"goal"``, or for
        a way-point its name, for example ``"way-point at 0.5"``.
    """

    label: Label
    t: float
    interval: int
    size: float
    bound: float
    value: float
    role: str


class ConstraintGroup(NamedTuple):
    """One constraint of a program: its rows (constraint functions) or unknowns at all n points.

    Attributes
    ----------
    label, role : Label, str
        Constrained quantity and kind of constraint, as in `Violation`.
    where : ndarray, shape (n,)
        Indices into the column of all rows followed by all unknowns.
    intervals : ndarray, shape (n,)
        Index of the mesh interval of each point.
    parts : ndarray, shape (n,)
        Time of each point as a fraction of the duration, 0 to 1.
    lower, upper : float
        Bounds, in the label's unit and in local coordinates.
    shift : float
        Reported value minus local value; zero for quantities that are not coordinates.
    typical : float
        Typical size of the terms of an equation, in the label's unit; zero for other roles.
    """

    label: Label
    role: str
    where: Index
    intervals: Index
    parts: Array
    lower: float
    upper: float
    shift: float
    typical: float = 0.0


def constraint_groups(program: Program) -> Iterator[ConstraintGroup]:
    """Yield the constraints of a program, each with all its rows or unknowns."""
    task, mesh, layout = program.task, program.mesh, program.layout
    n_g, count = program.g_lower.size, mesh.ends.size - 1
    yield from _interval_groups(program, program.row_blocks[0])
    begin = count * len(program.row_blocks[0].labels)
    for condition, row_block in zip(task.conditions, program.row_blocks[1:], strict=True):
        k = int(np.flatnonzero(np.isin(layout.states[:, -1, 0], row_block.where))[0])
        for r, limit in enumerate(condition.limits):
            yield ConstraintGroup(
                quantity_label(limit.label),
                role_of(condition.fraction),
                np.array([begin + r]),
                np.array([k]),
                mesh.ends[[k + 1]],
                limit.lower,
                limit.upper,
                shift_of(task, limit.expression),
            )
        begin += len(row_block.labels)
    for r, (k, highest) in enumerate(task.cost_limits):
        at, last, end = np.array([begin + r]), np.array([count - 1]), mesh.ends[-1:]
        yield ConstraintGroup(task.costs[k].label, COST, at, last, end, -np.inf, highest, 0.0)
    intervals, parts = np.repeat(np.arange(count), mesh.degree), mesh.nodes[1:]
    for limit in task.limits:
        plain = variable_of(task, limit.expression)
        if plain is not None:
            record, k = plain
            where = (layout.states if record == "x" else layout.unknowns)[:, :, k].ravel()
            yield ConstraintGroup(
                quantity_label(limit.label),
                LIMIT,
                n_g + where,
                intervals,
                parts,
                limit.lower,
                limit.upper,
                shift_of(task, limit.expression),
            )
    for k, label in enumerate(leaves(task.dae.labels.u)):
        low, high = task.inputs[k]
        where = layout.inputs[:, k]
        yield ConstraintGroup(
            label,
            INPUT,
            n_g + where,
            np.arange(where.size).clip(max=count - 1),
            mesh.ends[: where.size],
            low,
            high,
            0.0,
        )


def _interval_groups(program: Program, row_block: RowBlock) -> Iterator[ConstraintGroup]:
    """Yield the constraints that are rows of the intervals: equations, limits and input rates."""
    task, mesh = program.task, program.mesh
    each, every = len(row_block.labels), np.arange(len(row_block.where))
    rates = int(np.isfinite(task.accelerations).any(axis=1).sum())
    size = (each - rates) // mesh.degree
    limits = [limit for limit in task.limits if variable_of(task, limit.expression) is None]
    intervals, parts = np.repeat(every, mesh.degree), mesh.nodes[1:]
    points = each * every[:, None] + size * np.arange(mesh.degree)
    n_x, n_z, n_r = (
        part.shape[-1]
        for part in (program.layout.first, program.layout.unknowns, program.layout.roots)
    )
    typical = np.concatenate([np.ones(n_x), task.dae.scale[:n_z], np.ones(n_r)])
    for r in range(size):
        where, limit = (points + r).ravel(), r - (size - len(limits))
        label, role = row_block.labels[r], EQUATION if limit < 0 else LIMIT
        shift = 0.0 if limit < 0 else shift_of(task, limits[limit].expression)
        yield ConstraintGroup(
            quantity_label(label),
            role,
            where,
            intervals,
            parts,
            row_block.lower[r],
            row_block.upper[r],
            shift,
            typical[r] if limit < 0 else 0.0,
        )
    for r in range(each - rates, each):
        label = replace(row_block.labels[r], wheel=None)
        yield ConstraintGroup(
            label,
            INPUT,
            each * every + r,
            every,
            mesh.ends[1:],
            row_block.lower[r],
            row_block.upper[r],
            0.0,
        )


def worst_violations(
    program: Program, values: Array, tolerance: float
) -> Iterator[tuple[float, Violation]]:
    """Yield the largest violation of each violated bound, with its relative size first.

    Parameters
    ----------
    program : Program
        From `transcribe`.
    values : ndarray, shape (n_g + n_w,)
        Values of the rows, then of the unknowns (not scaled).
    tolerance : float
        Largest violation that is ignored, in the unit of the quantity.
    """
    duration = values[program.g_lower.size + program.layout.duration]
    for group in constraint_groups(program):
        size = size_of(group, values)
        for sign in (1.0, -1.0):
            bound, here = bound_of(group, sign), values[group.where]
            over = sign * (bound - here)
            worst = over.max()
            if not worst > tolerance:
                continue
            # The earliest of equally large violations is reported.
            k = int(np.flatnonzero(over >= worst - tolerance)[0])
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
                ),
            )


def bound_of(group: ConstraintGroup, sign: float) -> float:
    """Return the lower bound of a constraint if ``sign`` is positive, otherwise the upper bound."""
    return group.lower if sign > 0 else group.upper


def size_of(group: ConstraintGroup, values: Array) -> float:
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


def variable_of(task: PlanTask, expression: ca.SX) -> tuple[str, int] | None:
    """Return the record (``"x"`` or ``"z"``) and the index of a state or unknown.

    The result is None for an expression that is not a single state or unknown.
    """
    for record, symbols in (("x", task.dae.x), ("z", task.dae.z)):
        for k, symbol in enumerate(leaves(symbols)):
            if ca.is_equal(expression, symbol):
                return record, k
    return None


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


def quantity_label(label: Label) -> Label:
    """Return the label of a limit without the suffix ``_limit`` of its name."""
    return replace(label, name=label.name.removesuffix("_limit"))
