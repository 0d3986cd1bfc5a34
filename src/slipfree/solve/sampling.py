"""Correct samples of a motion and complete them with outputs; angles that differ by whole turns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae, Limit, SampledCheck
from slipfree.core.errors import ModelError
from slipfree.core.lookups import dense, evaluate
from slipfree.core.newton import solve_linear
from slipfree.core.quantities import QUANTITIES, quantity_label
from slipfree.core.records import Array, Label, Mask, by_quantity, leaves
from slipfree.core.trajectory import Column, SolverError, Trajectory
from slipfree.solve.system import Block, System, solve_initial_conditions

AXIS_NAMES = ("time", "wheel")  # dimensions of results, reserved names

MAX_CORRECTIONS = 25  # Newton steps per sample
STRIDE = 16  # samples per singular value, which would take as long as all other results
SOLVED_RESIDUAL = 1e-12  # residual, without unit, at which a sample needs no further step
UNSOLVED_RESIDUAL = 1e-10  # residual of a sample above which it exceeds rounding
TIME_TOLERANCE = 1e-9  # relative difference of times that count as equal
TURN = 2 * np.pi
ROUNDING = 1e-7  # relative difference of expressions that counts as rounding
Piecewise = tuple[tuple[float, float], ...]


def input_samples(
    duration: float, step: float, inputs: Mapping[str, float | Piecewise]
) -> tuple[Array, dict[str, float | Array]]:
    """Return the sample times, including jumps of the inputs, and the rates by interval.

    The times are from zero to the duration, shape (n,) [s]. An input is a constant rate, or pairs
    of the time at which a rate begins and the rate; its rates are constant, or have shape (n - 1,)
    [rad/s, m/s].
    """
    near = TIME_TOLERANCE * duration
    regular = step * np.arange(int(duration / step) + 1)
    jumps = [pair[0] for value in inputs.values() if isinstance(value, tuple) for pair in value]
    t = np.sort(np.concatenate([regular, [duration], jumps]))
    t = t[t <= duration]
    t = t[np.append(True, np.diff(t) > near)]
    t[-1] = duration
    middles = (t[1:] + t[:-1]) / 2

    def by_interval(value: float | Piecewise) -> float | Array:
        if not isinstance(value, tuple):
            return value
        times, rates = (np.array(column) for column in zip(*value, strict=True))
        return np.asarray(rates[np.searchsorted(times, middles, side="right") - 1])

    return t, {name: by_interval(value) for name, value in inputs.items()}


class Samples(NamedTuple):
    """States of a motion in local coordinates, in columns."""

    t: Array  # shape (n,) [s]
    # states, algebraic unknowns, quadratures and values of the inputs, a column for each time
    x: Array
    z: Array
    q: Array
    u: Array

    def at(self, k: slice | list[int] | Mask) -> Samples:
        """Return the samples with the given indices."""
        return Samples(*(row[..., k] for row in self))


def join_samples(parts: Sequence[Samples]) -> Samples:
    """Return the joined samples of parts; each starts at the last sample of the previous part."""
    rows = zip(*(part.at(slice(-1)) for part in parts[:-1]), parts[-1], strict=True)
    return Samples(*(np.concatenate(row, axis=-1) for row in rows))


def integrate_samples(t: Array, rates: Array) -> Array:
    """Return integrals of rates (m, n) from the first of n times by the trapezoidal rule.

    Corrected by slopes from three samples, its error has the fourth order in the time between them.
    """
    h, slopes = np.diff(t), np.gradient(rates, t, axis=1, edge_order=2 if t.size > 2 else 1)
    gains = h / 2 * (rates[:, :-1] + rates[:, 1:]) - h**2 / 12 * np.diff(slopes, axis=1)
    return np.cumsum(np.append(0 * rates[:, :1], gains, axis=1), axis=1)


def correct_samples(system: System, samples: Samples) -> tuple[Samples, dict[str, Array]]:
    """Return the samples with unknowns corrected by Newton's method, and a report of errors.

    The interpolation of the integrator satisfies the algebraic equations only to its tolerance; the
    size of the first Newton step, ``newton_step`` in the report, measures this error. The report
    includes that of `complete_samples`. Without algebraic unknowns the samples are returned
    unchanged, with an empty report.
    """
    if not system.motion_size:
        return samples, {}
    z, steps, errors = samples.z.copy(), list[Array](), list[Array]()
    for block in system.blocks:
        z, step, left = _correct_block(block, samples._replace(z=z))
        steps.append(step)
        errors.append(left)
    size = np.max([_max_abs(left) for left in errors], axis=0)
    # The negation also selects residuals that are NaN.
    if (astray := ~(size < UNSOLVED_RESIDUAL)).any():
        z, errors = _solve_from_neighbours(system, samples, z, astray), []
    found, report = complete_samples(system, samples._replace(z=z), errors)
    return found, {"newton_step": steps[0], **report}


def _correct_block(block: Block, samples: Samples) -> tuple[Array, Array, Array]:
    """Return ``z`` after Newton steps on a block, the first step and the last residual of each.

    Each Jacobian serves for two steps: another residual costs less than another Jacobian.
    """
    z, rough = samples.z.copy(), np.ones(samples.t.size, dtype=bool)
    (left, jacobian), first = linearize(block, samples), np.zeros(samples.t.size)
    for k in range(MAX_CORRECTIONS):
        step, former = solve_linear(jacobian, left.T).T, _max_abs(left)
        z[block.span, rough] -= step[:, rough]
        first = first if k else _max_abs(step)
        (left,) = _evaluate_block(block.residual, block, samples._replace(z=z))
        size = _max_abs(left)
        # Rounding limits a small residual that a step does not halve.
        rough &= (size > SOLVED_RESIDUAL) & ~((size < UNSOLVED_RESIDUAL) & (size > former / 2))
        if not rough.any():
            break
        left, jacobian = linearize(block, samples._replace(z=z))
    return z, first, left


def _solve_from_neighbours(system: System, samples: Samples, z: Array, astray: Mask) -> Array:
    """Return ``z`` after a second attempt at the samples in ``astray``, where Newton failed.

    Their neighbours are the initial guesses. Full Newton steps may cycle where the equations are
    strongly nonlinear, such as friction at small slip. Samples without a solution, for example
    where all friction is used, keep the values of the integrator.
    """
    z = z.copy()
    z[:, astray] = samples.z[:, astray]
    for k in np.flatnonzero(astray):
        for j in (k - 1, k + 1):
            # A later sample that is astray too has not been solved yet.
            if not 0 <= j < astray.size or (astray[j] and j > k):
                continue
            point = (float(samples.t[k]), samples.x[:, k], z[:, j], samples.u[:, k])
            try:
                z[:, k] = solve_initial_conditions(system, *point, continuation=False)
                break
            except ModelError:  # the report contains the large residual
                continue
    return z


def _max_abs(rows: Array) -> Array:
    return np.asarray(np.abs(rows).max(axis=0))


def linearize(block: Block, samples: Samples) -> tuple[Array, Array]:
    """Return the residuals of a block, shape (m, n), and its Jacobians, shape (n, m, m)."""
    left, slopes = _evaluate_block(block.newton, block, samples)
    return left, dense(slopes, block.newton.sparsity_out(1))


def _evaluate_block(function: ca.Function, block: Block, samples: Samples) -> tuple[Array, ...]:
    stage = np.full((1, samples.t.size), block.stages[-1])
    return evaluate(function, samples.t[None], samples.x, samples.z, samples.u, stage)


def _singular_values(system: System, samples: Samples) -> Array:
    """Return the smallest singular value of the Jacobian of the motion's equations, shape (n,).

    It is computed at every 16th sample and at the last, and interpolated between them. It is NaN
    where the equations are not finite.
    """
    chosen = np.unique(np.append(np.arange(0, samples.t.size, STRIDE), samples.t.size - 1))
    t, x, z, _, u = (row[..., chosen] for row in samples)
    n, found = system.motion_size, np.full(chosen.size, np.nan)
    slopes = evaluate(system.jacobian, t[None], x, z[:n], np.zeros((0, t.size)), u)[3]
    jac = dense(slopes, system.jacobian.sparsity_out(3)) * system.dae.sizes.z[:n]
    finite = np.isfinite(jac).all(axis=(1, 2))
    if not finite.any():
        raise SolverError(
            "the equations of the motion are not finite at any sample; check the start and the "
            "inputs"
        )
    found[finite] = np.linalg.svd(jac[finite], compute_uv=False)[:, -1]
    return np.asarray(np.interp(np.arange(samples.t.size), chosen, found))


def complete_samples(
    system: System, samples: Samples, errors: Sequence[Array] = ()
) -> tuple[Samples, dict[str, Array]]:
    """Return the samples with the unknowns that depend on the motion, and a report of residuals.

    The report contains the smallest singular value of the Jacobian of the motion's equations, which
    is zero at a singular configuration, and the largest residual of each block. They are NaN where
    the equations are not finite. ``errors`` are the residuals of the blocks of the motion; they are
    computed if omitted.
    """
    n, z = system.motion_size, samples.z.copy()
    report = {"singular_value": _singular_values(system, samples)}
    errors = errors or [_evaluate_block(b.residual, b, samples)[0] for b in system.blocks]
    for block, left in zip(system.blocks, errors, strict=True):
        report[f"{block.labels[0].name}_residual"] = _block_residual(system, block, left)
    if system.dependent_blocks:
        z[n:] = evaluate(guess_function(system.dae), samples.x)[0][n:]
    for block in system.dependent_blocks:
        z, _, rest = _correct_block(block, samples._replace(z=z))
        report[f"{block.labels[0].name}_residual"] = _block_residual(system, block, rest)
    return samples._replace(z=z), report


@lru_cache(maxsize=8)
def guess_function(dae: Dae) -> ca.Function:
    """Return the initial guess of ``z`` as a function of ``x``; cached."""
    return dae.function("guess", [dae.columns()[0]], [ca.densify(dae.guess)])


def _block_residual(system: System, block: Block, residual: Array) -> Array:
    """Return the largest residual of a block per sample, in the unit of its first equation."""
    return _max_abs(residual) * system.dae.size_of(block.labels[0])


def to_trajectory(system: System, samples: Samples, report: dict[str, Array]) -> Trajectory:
    """Return the samples as a trajectory in map coordinates, with all outputs and margins."""
    dae = system.dae
    y, limits, u = evaluate(system.outputs, samples.t[None], *samples[1:3], samples.u)
    x, z = (part + shift[:, None] for part, shift in zip(samples[1:3], dae.shift, strict=True))
    for k, label in enumerate(leaves(dae.labels.y)):
        if label.name == "heading":  # computed from an attitude, which does not count turns
            y[k] = np.unwrap(y[k])
    checks = (_check_margins(check, samples) for check in dae.checks)
    rows = [*x, *z, *samples.q, *u, *y, *limits, *checks, *report.values()]
    groups, wheels = _group_by_quantity(dae, tuple(report))
    columns = dict[str, Column]()
    for label, indices, of_wheels in groups:
        samples_of = [rows[k] for k in indices]
        values = np.stack(samples_of, axis=1) if of_wheels else samples_of[0]
        columns[label.name] = Column(label, values)
    return Trajectory(samples.t, columns, wheels, ground=dae.ground)


def _check_margins(check: SampledCheck, samples: Samples) -> Array:
    """Return the margins of a check at samples, NaN where its matrix is singular."""
    try:
        return check.margin(samples.x, samples.z)
    except np.linalg.LinAlgError:
        if samples.t.size == 1:
            return np.full(1, np.nan)
        each = (Samples(*(row[..., k : k + 1] for row in samples)) for k in range(samples.t.size))
        return np.concatenate([_check_margins(check, sample) for sample in each])


@lru_cache(maxsize=8)
def _group_by_quantity(
    dae: Dae, report: tuple[str, ...]
) -> tuple[tuple[tuple[Label, tuple[int, ...], bool], ...], tuple[str, ...]]:
    """Return the quantities of a model and its report, in the order of rows, and the wheels.

    A quantity has a label, the indices of its rows, and whether it is one of wheels.
    """
    labels = [
        *leaves(dae.labels[:5]),
        *(limit.label for limit in dae.limits),
        *(check.label for check in dae.checks),
    ]
    units = {f"{each[0].name}_residual": each[0].unit for each in dae.labels.alg if each}
    for name in report:
        equations = name.removesuffix("_residual")
        words = f"largest residual of equations {equations!r} after Newton steps"
        own = quantity_label(name, stride=STRIDE) if name in QUANTITIES else None
        labels.append(own or Label(name, units.get(name, "m"), words))
    wheels, found = tuple[str, ...](), list[tuple[Label, tuple[int, ...], bool]]()
    for name, (label, indices) in by_quantity(labels).items():
        if name in AXIS_NAMES:
            raise ModelError(
                f"expected no quantity named {name!r}, which is a dimension of results; "
                "rename a coordinate of the vehicle or an output"
            )
        on = [labels[k].wheel for k in indices]
        if len(on) > 1 and len({*on} - {None}) < len(on):
            raise ModelError(
                f"expected different names of all quantities in a result, found {name!r} "
                "twice; rename a coordinate of the vehicle or an output"
            )
        wheels = wheels if None in on else tuple(map(str, on))
        found.append((label, tuple(indices), None not in on))
    return tuple(found), wheels


def periodic_states(dae: Dae, x: Array, limits: Iterable[Limit] = ()) -> Mask:
    """Return which states are angles that mean the same after a whole turn, shape (n_x,).

    Such states are headings, and joints without stop and spring, such as casters. Rates, equations
    and limits of the model, and further limits, are compared at a state in local coordinates and
    one turn further.
    """
    angles = np.array([label.unit == "rad" for label in leaves(dae.labels.x)], dtype=bool)
    expressions = (limit.expression for limit in (*dae.limits, *limits))
    rows = ca.vertcat(dae.ode, *dae.alg, *expressions)
    evaluate = dae.function("turned", [dae.t, *dae.columns()], [rows])
    others = np.ones_like(dae.scale), np.ones(len(list(leaves(dae.u))))
    first = np.array(evaluate(0.0, x, *others)).ravel()
    for k in np.flatnonzero(angles):
        turned = np.array(evaluate(0.0, x + TURN * (np.arange(x.size) == k), *others)).ravel()
        size = np.nan_to_num(np.abs(first)).max(initial=1.0)
        angles[k] = np.allclose(turned, first, rtol=0, atol=ROUNDING * size, equal_nan=True)
    return angles


def same_turn(values: Array, near: Array, periodic: Mask) -> Array:
    """Return states with whole turns added to the periodic ones, nearest to other states.

    Both have the shape (n_x, n).
    """
    turns = TURN * np.round((near - values) / TURN)
    return np.where(periodic[:, None], values + np.nan_to_num(turns), values)
