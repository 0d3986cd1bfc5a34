"""Correct the samples of a motion by Newton's method, and convert them to a trajectory."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.dae import SampledCheck
from slipfree.errors import ModelError
from slipfree.records import Array, Label, Mask, leaves
from slipfree.solve.initial_conditions import solve_initial_conditions
from slipfree.solve.system import MAX_NEWTON_STEPS, Block, System
from slipfree.trajectory import Column, SolverError, Trajectory

AXIS_NAMES = ("time", "wheel")  # dimensions of results, reserved names

MAX_CORRECTIONS = 10  # Newton steps per sample
SOLVED_RESIDUAL = 1e-12  # residual, without unit, at which a sample needs no further step
UNSOLVED_RESIDUAL = 1e-10  # residual of a sample above which it exceeds rounding
ROUNDING_STEP = 1e-13  # step, in typical sizes, below which only rounding is left


class Samples(NamedTuple):
    """States of a motion in local coordinates, in columns.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times. [s]
    x, z, q, u : ndarray, shape (n_x, n), (n_z, n), (n_q, n) and (n_u, n)
        States, algebraic unknowns, quadratures and values of the inputs.
    """

    t: Array
    x: Array
    z: Array
    q: Array
    u: Array

    def head(self, count: int) -> Samples:
        """Return the first ``count`` samples."""
        return Samples(*(part[..., :count] for part in self))


def correct_samples(system: System, samples: Samples) -> tuple[Samples, dict[str, Array]]:
    """Return the samples with unknowns corrected by Newton's method, and a report of errors.

    The interpolation of the integrator satisfies the algebraic equations only to its tolerance; the
    size of the first Newton step, ``newton_step`` in the report, measures this error. The report
    includes that of `complete_samples`. Without algebraic unknowns the samples are returned
    unchanged, with an empty report.
    """
    if not system.motion_size:
        return samples, {}
    z, n = samples.z.copy(), system.motion_size
    alg, jac = _linearize(system, samples)
    step, size = _newton_steps(jac, alg), _max_abs(alg)
    first = _max_abs(step[system.blocks[0].span])
    rough = np.ones(samples.t.size, dtype=bool)
    for _ in range(MAX_CORRECTIONS):
        z[:n, rough] -= step[:, rough]
        alg = _residuals(system, samples._replace(z=z))
        former, size = size, _max_abs(alg)
        rough &= (size > SOLVED_RESIDUAL) & ~((size < UNSOLVED_RESIDUAL) & (size > former / 2))
        if not rough.any():
            break
        alg, jac = _linearize(system, samples._replace(z=z))
        step = _newton_steps(jac, alg)
    if (astray := ~(size < UNSOLVED_RESIDUAL)).any():
        z = _solve_from_neighbours(system, samples, z, astray)
        alg, jac = _linearize(system, samples._replace(z=z))
    found, report = complete_samples(system, samples._replace(z=z), (alg, jac))
    return found, {"newton_step": first, **report}


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


def _linearize(system: System, samples: Samples) -> tuple[Array, Array]:
    """Return the residuals of the motion, shape (n_m, n), and Jacobians, shape (n, n_m, n_m)."""
    newton, n = system.newton.map(samples.t.size), system.motion_size
    found = newton(samples.t[None], samples.x, samples.z[:n], samples.u)
    alg, jac = (np.array(out) for out in found)
    return alg, _split_matrices(jac, n)


def _residuals(system: System, samples: Samples) -> Array:
    """Return the residuals of the equations of the motion, shape (n_m, n)."""
    core, n = system.core.map(samples.t.size), system.motion_size
    return np.array(core(samples.t[None], samples.x, samples.z[:n], samples.u)[1])


def complete_samples(
    system: System, samples: Samples, known: tuple[Array, Array] | None = None
) -> tuple[Samples, dict[str, Array]]:
    """Return the samples with the unknowns that depend on the motion, and a report of residuals.

    The report contains, at every sample, the smallest singular value of the Jacobian of the
    motion's equations, which is zero at a singular configuration, and the largest residual of each
    block. They are NaN where the equations are not finite. ``known`` are residuals and Jacobians
    from `_linearize`, before or after the last Newton step; they are computed if omitted.
    """
    count, n, z = samples.t.size, system.motion_size, samples.z.copy()
    left, jac = known or _linearize(system, samples)
    jac = jac * system.dae.sizes.z[:n]
    finite = np.isfinite(jac).all(axis=(1, 2))
    if not finite.any():
        raise SolverError(
            "the equations of the motion are not finite at any sample; check the start and the "
            "inputs"
        )
    report = {"singular_value": np.full(count, np.nan)}
    report["singular_value"][finite] = np.linalg.svd(jac[finite], compute_uv=False)[:, -1]
    for block in system.blocks:
        report[f"{block.labels[0].name}_residual"] = _block_residual(
            system, block, left[block.span]
        )
    if system.dependent_blocks:
        guess = system.dae.function("guess", [system.dae.columns()[0]], [system.dae.guess]).map(
            count
        )
        z[n:] = np.array(guess(samples.x))[n:]
    for block in system.dependent_blocks:
        z, rest = _solve_block(block, samples._replace(z=z), system.dae.scale[block.span, None])
        report[f"{block.labels[0].name}_residual"] = _block_residual(system, block, rest)
    return samples._replace(z=z), report


def _block_residual(system: System, block: Block, residual: Array) -> Array:
    """Return the largest residual of a block per sample, in the unit of its first equation."""
    return _max_abs(residual) * system.dae.size_of(block.labels[0])


def _solve_block(block: Block, samples: Samples, size: Array) -> tuple[Array, Array]:
    """Return ``z`` with a block solved by Newton's method at all samples, and its residual.

    No error is raised without a solution: the residual is then large.
    """
    count, n, z = samples.t.size, len(block.labels), samples.z.copy()
    residual, jacobian = block.residual.map(count), block.jacobian.map(count)

    def at(function: ca.Function) -> Array:
        return np.array(
            function(
                samples.t[None], samples.x, z, samples.u, np.full((1, count), block.stages[-1])
            )
        )

    for _ in range(MAX_NEWTON_STEPS):
        step = _newton_steps(_split_matrices(at(jacobian), n), at(residual))
        z[block.span] -= step
        if block.linear or not (np.abs(step) > ROUNDING_STEP * size).any():
            break
    return z, at(residual)


def _split_matrices(side_by_side: Array, n: int) -> Array:
    """Return square matrices, shape (count, n, n), from one of shape (n, count n)."""
    return side_by_side.reshape(n, -1, n).transpose(1, 0, 2)


def _newton_steps(matrices: Array, right: Array) -> Array:
    """Return the solutions of linear systems as columns; least squares if one is singular."""
    try:
        return np.asarray(np.linalg.solve(matrices, right.T[..., None])[..., 0].T)
    except np.linalg.LinAlgError:
        finite, steps = np.isfinite(matrices).all(axis=(1, 2)), np.full(right.T.shape, np.nan)
        inverses = np.linalg.pinv(matrices[finite])
        steps[finite] = (inverses @ right.T[finite][..., None])[..., 0]
        return steps.T


def to_trajectory(system: System, samples: Samples, report: dict[str, Array]) -> Trajectory:
    """Return the samples as a trajectory in map coordinates, with all outputs and margins."""
    dae, labels = system.dae, system.dae.labels
    y, limits, u = (
        np.array(out)
        for out in system.outputs.map(samples.t.size)(samples.t[None], *samples[1:3], samples.u)
    )
    x, z = (part + shift[:, None] for part, shift in zip(samples[1:3], dae.shift, strict=True))
    rows = [
        *zip(leaves(labels.x), x, strict=True),
        *zip(leaves(labels.z), z, strict=True),
        *zip(leaves(labels.q), samples.q, strict=True),
        *zip(leaves(labels.u), u, strict=True),
        *zip(leaves(labels.y), y, strict=True),
        *zip((limit.label for limit in dae.limits), limits, strict=True),
        *((check.label, _check_margins(check, samples)) for check in dae.checks),
        *((_report_label(system, name), values) for name, values in report.items()),
    ]
    return Trajectory(samples.t, *_group_by_quantity(rows))


def _check_margins(check: SampledCheck, samples: Samples) -> Array:
    """Return the margins of a check, NaN at samples at which its linear algebra fails."""
    try:
        return check.margin(samples.x, samples.z)
    except np.linalg.LinAlgError:
        if samples.t.size == 1:
            return np.full(1, np.nan)
        each = (Samples(*(row[..., k : k + 1] for row in samples)) for k in range(samples.t.size))
        return np.concatenate([_check_margins(check, sample) for sample in each])


def _group_by_quantity(
    rows: list[tuple[Label, Array]],
) -> tuple[dict[str, Column], tuple[str, ...]]:
    """Return one column per quantity, with the values of all wheels, and the wheels' names."""
    groups: dict[str, list[tuple[Label, Array]]] = {}
    for label, values in rows:
        group = groups.setdefault(label.name, [])
        if label.name in AXIS_NAMES:
            raise ModelError(
                f"expected no quantity named {label.name!r}, which is a dimension of results; "
                "rename a coordinate of the vehicle or an output"
            )
        if any(_is_same_column(label, each) for each, _ in group):
            raise ModelError(
                f"expected different names of all quantities in a result, found {label.name!r} "
                "twice; rename a coordinate of the vehicle or an output"
            )
        group.append((label, values))
    wheels: tuple[str, ...] = ()
    columns = {}
    for name, members in groups.items():
        label = members[0][0]
        if label.wheel is None:
            columns[name] = Column(label, members[0][1])
            continue
        wheels = tuple(str(each.wheel) for each, _ in members)
        values = np.column_stack([values for _, values in members])
        columns[name] = Column(Label(name, label.unit, _common_words(members)), values)
    return columns, wheels


def _is_same_column(one: Label, other: Label) -> bool:
    """Return whether two labels of one name stand for the same column."""
    return one.wheel is None or other.wheel is None or one.wheel == other.wheel


def _common_words(members: list[tuple[Label, Array]]) -> str:
    """Return the description of a quantity without the name of a wheel."""
    label = members[0][0]
    return label.words.replace(f"wheel {label.wheel}", "the wheel")


def _report_label(system: System, name: str) -> Label:
    blocks = (*system.blocks, *system.dependent_blocks)
    units = {f"{block.labels[0].name}_residual": block.labels[0].unit for block in blocks}
    words = {
        "newton_step": "largest change of a pose coordinate by the first Newton step",
        "singular_value": "smallest singular value of the Jacobian of the algebraic equations; "
        "lengths are divided by the size of the vehicle",
    }
    return Label(
        name,
        units.get(name, "1" if name == "singular_value" else "m"),
        words.get(
            name,
            f"largest residual of equations {name.removesuffix('_residual')!r} after Newton steps",
        ),
    )
