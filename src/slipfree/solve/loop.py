"""A DAE under given inputs, compiled once: what settling, integrating and sampling evaluate."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.named import Array, Label, leaves, pack
from slipfree.trajectory import Column, Trajectory

CORRECTIONS = 3  # Newton steps on a sample at most
ENOUGH = 1e-6  # a step below this leaves an error of its square


class Block(NamedTuple):
    """One block of algebraic equations, as Newton's method uses it.

    Attributes
    ----------
    span : slice
        Its unknowns among those of ``z``.
    residual, jacobian : casadi Function
        Of ``t, x, z, u``; the Jacobian is with respect to the unknowns of the block.
    linear : bool
        Whether the block is linear in its unknowns.
    labels : tuple of Label
        Names of its equations.
    """

    span: slice
    residual: ca.Function
    jacobian: ca.Function
    linear: bool
    labels: tuple[Label, ...]


class Loop(NamedTuple):
    """A DAE whose inputs are numbers or have been replaced by expressions.

    Attributes
    ----------
    dae : Dae
        The model.
    u : ndarray, shape (n_u, n)
        Values of the inputs at every interval; unused where an expression rules.
    core : casadi Function
        ``(t, x, z, u) -> (ode, alg, quad)``.
    blocks : tuple of Block
        The algebraic equations.
    newton : casadi Function
        ``(t, x, z, u) -> (alg, its Jacobian in z)``.
    outputs : casadi Function
        ``(t, x, z, u) -> (outputs, limits, inputs)``.
    margin : casadi Function
        ``(t, x, z, u) ->`` least distance to a limit, negative beyond one.
    """

    dae: Dae[Any, Any, Any, Any, Any]
    u: Array
    core: ca.Function
    blocks: tuple[Block, ...]
    newton: ca.Function
    outputs: ca.Function
    margin: ca.Function


def close(dae: Dae[Any, Any, Any, Any, Any], inputs: Any, intervals: int) -> Loop:
    """Return the DAE under inputs.

    Parameters
    ----------
    dae : Dae
        The model.
    inputs : record
        Numbers, arrays of shape (intervals,) or expressions in the symbols of the model.
    intervals : int
        Number of intervals between samples.

    Raises
    ------
    ModelError
        If an array has another length, a number is not finite, or an expression contains inputs.
    """
    u = dae.columns()[2]
    law, values = list(ca.vertsplit(u)) if u.numel() else [], np.zeros((u.numel(), intervals or 1))
    for index, (label, value) in enumerate(zip(leaves(dae.labels.u), leaves(inputs), strict=True)):
        if isinstance(value, ca.SX):
            law[index] = _checked(dae, label, value)
        else:
            values[index] = _numbers(label, value, intervals)
    ruled = any(isinstance(value, ca.SX) for value in leaves(inputs))
    return (_compiled(dae, law) if ruled else _open(dae))._replace(u=values)


@lru_cache(maxsize=8)
def _open(dae: Dae[Any, Any, Any, Any, Any]) -> Loop:
    """Compile a model whose inputs are numbers; kept, since it serves any start and any numbers."""
    return _compiled(dae, list(leaves(dae.u)))


def _compiled(dae: Dae[Any, Any, Any, Any, Any], law: list[ca.SX]) -> Loop:
    x, z, u = dae.columns()
    limits = [limit.expression for limit in dae.limits]
    expressions = [dae.ode, ca.vertcat(*dae.alg), dae.quad, pack(dae.y),
                   ca.vertcat(ca.SX(0, 1), *limits), u]  # fmt: skip
    symbols = [dae.t, x, z, u]
    ode, alg, quad, y, bounds, inputs = ca.substitute(
        expressions, [u], [ca.vertcat(ca.SX(0, 1), *law)]
    )
    jacobian = ca.jacobian(alg, z)
    return Loop(
        dae,
        np.zeros((u.numel(), 0)),
        ca.Function("core", symbols, [ode, alg, quad], {"jac_penalty": 0, "cse": True}),
        _blocks(dae, symbols, alg, jacobian),
        ca.Function("newton", symbols, [alg, ca.densify(jacobian)]),
        ca.Function("outputs", symbols, [y, bounds, inputs]),
        ca.Function("margin", symbols, [_least(dae, bounds)]),
    )


def _least(dae: Dae[Any, Any, Any, Any, Any], bounds: ca.SX) -> ca.SX:
    least = ca.SX(np.inf)
    for limit, value in zip(dae.limits, ca.vertsplit(bounds) if dae.limits else [], strict=True):
        if np.isfinite(limit.lower):
            least = ca.fmin(least, value - limit.lower)
        if np.isfinite(limit.upper):
            least = ca.fmin(least, limit.upper - value)
    return least


def _checked(dae: Dae[Any, Any, Any, Any, Any], label: Label, law: ca.SX) -> ca.SX:
    x, z, u = dae.columns()
    if law.shape != (1, 1):
        raise ModelError(f"input {label.full}: expected a scalar expression, found {law.shape}")
    if ca.depends_on(law, u):
        raise ModelError(f"input {label.full}: a law cannot contain the inputs themselves")
    free = ca.Function("law", [dae.t, x, z], [law], {"allow_free": True}).free_sx()
    if free:
        raise ModelError(f"input {label.full}: {free[0]} is not a symbol of the model")
    return law


def _numbers(label: Label, value: Any, intervals: int) -> Array:
    if isinstance(value, ca.MX | str) or np.iscomplexobj(value):
        raise ModelError(f"input {label.full}: expected real numbers or SX, found {value!r}")
    numbers = np.asarray(value, dtype=float)
    if numbers.ndim > 1 or (numbers.ndim == 1 and numbers.size != intervals):
        raise ModelError(
            f"input {label.full}: expected a number, an expression or one value for each of the "
            f"{intervals} intervals, found shape {numbers.shape}"
        )
    if not np.isfinite(numbers).all():
        raise ModelError(f"input {label.full}: must be finite, found {numbers}")
    return numbers


def _blocks(
    dae: Dae[Any, Any, Any, Any, Any], symbols: list[ca.SX], alg: ca.SX, jacobian: ca.SX
) -> tuple[Block, ...]:
    blocks, end = [], 0
    for labels in dae.labels.alg:
        span = slice(end, end + len(labels))
        unknowns, rows, own = symbols[2][span], alg[span], jacobian[span, span]
        if ca.jacobian_sparsity(rows, symbols[2][span.stop :]).nnz():
            raise ModelError("a block of equations depends on the unknowns of a later one")
        blocks.append(
            Block(
                span,
                ca.Function("residual", symbols, [rows]),
                ca.Function("jacobian", symbols, [ca.densify(own)]),
                not any(ca.which_depends(rows, unknowns, 2)),
                labels,
            )
        )
        end = span.stop
    return tuple(blocks)


class Samples(NamedTuple):
    """States of a motion in local coordinates, in columns.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times. [s]
    x, z, q, u : ndarray, shape (n_x, n) and so on
        States, algebraic unknowns, quadratures and given inputs.
    """

    t: Array
    x: Array
    z: Array
    q: Array
    u: Array

    def head(self, count: int) -> Samples:
        """Return the first ``count`` samples."""
        return Samples(*(part[..., :count] for part in self))


def corrected(loop: Loop, samples: Samples) -> tuple[Samples, dict[str, Array]]:
    """Return the samples after a Newton step on ``z``, and what that step says.

    The integrator's interpolation leaves the algebraic equations satisfied to its tolerance only;
    the step is as large as that error. Where it is large, another one follows. With it come the
    residual after it, block by block, and the smallest singular value of the Jacobian, the
    distance to a singular configuration.
    """
    count = samples.t.size
    newton = loop.newton.map(count)
    n_z = samples.z.shape[0]

    def evaluate(z: Array) -> tuple[Array, Array]:
        alg, jac = (np.array(out) for out in newton(samples.t[None], samples.x, z, samples.u))
        return alg, jac.reshape(n_z, count, n_z).transpose(1, 0, 2)

    z = samples.z
    sizes: list[Array] = []
    while not sizes or (sizes[-1].max() > ENOUGH and len(sizes) < CORRECTIONS):
        alg, jac = evaluate(z)
        step = np.linalg.solve(jac, alg.T[..., None])[..., 0].T
        z = z - step
        sizes.append(np.abs(step))
    left, jac = evaluate(z)
    first = loop.blocks[0].span
    report = {
        "newton_step": sizes[0][first].max(axis=0),
        "singular_value": np.linalg.svd(jac, compute_uv=False)[:, -1],
    }
    for block in loop.blocks:
        report[f"{block.labels[0].name}_residual"] = np.abs(left[block.span]).max(axis=0)
    return samples._replace(z=z), report


def table(loop: Loop, samples: Samples, report: dict[str, Array]) -> Trajectory:
    """Return the samples as a trajectory in map coordinates, with all outputs and margins."""
    dae, labels = loop.dae, loop.dae.labels
    y, limits, u = (
        np.array(out)
        for out in loop.outputs.map(samples.t.size)(samples.t[None], *samples[1:3], samples.u)
    )
    x, z = (part + shift[:, None] for part, shift in zip(samples[1:3], dae.shift, strict=True))
    rows = [
        *zip(leaves(labels.x), x, strict=True),
        *zip(leaves(labels.z), z, strict=True),
        *zip(leaves(labels.q), samples.q, strict=True),
        *zip(leaves(labels.u), u, strict=True),
        *zip(leaves(labels.y), y, strict=True),
        *zip((limit.label for limit in dae.limits), limits, strict=True),
        *((check.label, check.margin(*samples[1:3])) for check in dae.checks),
        *((_report_label(loop, name), values) for name, values in report.items()),
    ]
    return Trajectory(samples.t, *_columns(rows))


def _columns(rows: list[tuple[Label, Array]]) -> tuple[dict[str, Column], tuple[str, ...]]:
    """Gather the rows that belong to wheels into one column a wheel."""
    groups: dict[str, list[tuple[Label, Array]]] = {}
    for label, values in rows:
        groups.setdefault(label.name, []).append((label, values))
    wheels: tuple[str, ...] = ()
    columns = {}
    for name, members in groups.items():
        label = members[0][0]
        if label.wheel is None:
            columns[name] = Column(label, members[0][1])
            continue
        wheels = tuple(str(each.wheel) for each, _ in members)
        values = np.column_stack([values for _, values in members])
        columns[name] = Column(Label(name, label.unit, _common(members)), values)
    return columns, wheels


def _common(members: list[tuple[Label, Array]]) -> str:
    """Return the words of a quantity with every wheel's own name taken out."""
    label = members[0][0]
    return label.words.replace(f"wheel {label.wheel}", "the wheel")


def _report_label(loop: Loop, name: str) -> Label:
    units = {f"{block.labels[0].name}_residual": block.labels[0].unit for block in loop.blocks}
    words = {
        "newton_step": "largest change of a position by the Newton step on the sample",
        "singular_value": "smallest singular value of the Jacobian of the algebraic equations",
    }
    return Label(
        name,
        units.get(name, "1" if name == "singular_value" else "m"),
        words.get(name, "largest residual of these equations after the Newton step"),
    )
