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

CORRECTIONS = 10  # Newton steps on a sample at most
ENOUGH = 1e-12  # residual at which a sample needs no further step
UNSOLVED = 1e-10  # residual of a sample that is no rounding any more
FOLLOWING = 25  # Newton steps at most for what follows from a motion
ROUNDING = 1e-13  # step, in typical sizes, that only rounding is left of


class Block(NamedTuple):
    """One block of algebraic equations, as Newton's method uses it.

    Attributes
    ----------
    span : slice
        Its unknowns among those of ``z``.
    residual, jacobian : casadi Function
        Of ``t, x, z, u`` and the easing; the Jacobian is with respect to the unknowns of the
        block.
    linear : bool
        Whether the block is linear in its unknowns.
    stages : tuple of float
        Values of the easing at a start; one if the block does not depend on it.
    labels : tuple of Label
        Names of its equations.
    """

    span: slice
    residual: ca.Function
    jacobian: ca.Function
    linear: bool
    stages: tuple[float, ...]
    labels: tuple[Label, ...]


class Loop(NamedTuple):
    """A DAE whose inputs are numbers or have been replaced by expressions.

    The unknowns of the motion, ``m``, are the first ones of ``z``; the others follow from it.

    Attributes
    ----------
    dae : Dae
        The model.
    u : ndarray, shape (n_u, n)
        Values of the inputs at every interval; unused where an expression rules.
    core : casadi Function
        ``(t, x, m, u) -> (ode, alg)``, the equations of the motion.
    quad : casadi Function
        ``(t, x, m, u) -> quad``.
    blocks, after : tuple of Block
        The algebraic equations of the motion, and those of what follows from it.
    newton : casadi Function
        ``(t, x, m, u) -> (alg, its Jacobian in m)``.
    outputs : casadi Function
        ``(t, x, z, u) -> (outputs, limits, inputs)``.
    margin : casadi Function
        ``(t, x, m, u) ->`` least distance to a limit of the motion, negative beyond one.
    """

    dae: Dae[Any, Any, Any, Any, Any]
    u: Array
    core: ca.Function
    quad: ca.Function
    blocks: tuple[Block, ...]
    after: tuple[Block, ...]
    newton: ca.Function
    outputs: ca.Function
    margin: ca.Function

    @property
    def moving(self) -> int:
        """Number of the unknowns of the motion."""
        return self.blocks[-1].span.stop if self.blocks else 0


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
    easing = ca.SX.sym("easing") if dae.easing is None else dae.easing.symbol
    eased = [dae.ode, dae.quad, pack(dae.y), ca.vertcat(ca.SX(0, 1), *limits), u, *dae.alg]
    eased = ca.substitute(eased, [u], [ca.vertcat(ca.SX(0, 1), *law)])
    meant = ca.SX(dae.easing.values[-1] if dae.easing else 0.0)
    ode, quad, y, bounds, inputs, *parts = ca.substitute(eased, [easing], [meant])
    blocks = _blocks(dae, [dae.t, x, z, u, easing], eased[5:])
    first = _following(ode, parts, z, blocks)
    motion, after = blocks[:first], blocks[first:]
    m = z[: motion[-1].span.stop] if motion else z[:0]
    alg = ca.vertcat(ca.SX(0, 1), *parts[: len(motion)])
    symbols = [dae.t, x, m, u]
    return Loop(
        dae,
        np.zeros((u.numel(), 0)),
        ca.Function("core", symbols, [ode, alg], {"jac_penalty": 0, "cse": True}),
        _quadratures(dae, [dae.t, x, z, u], quad, after),
        motion,
        after,
        ca.Function("newton", symbols, [alg, ca.densify(ca.jacobian(alg, m))]),
        ca.Function("outputs", [dae.t, x, z, u], [y, bounds, inputs]),
        ca.Function("margin", symbols, [_least(dae, bounds, z[m.numel() :])]),
    )


def _following(ode: ca.SX, parts: list[ca.SX], z: ca.SX, blocks: tuple[Block, ...]) -> int:
    """Return the first of the last blocks on which the motion does not depend."""
    first = len(blocks)
    for index in reversed(range(len(blocks))):
        others = ca.vertcat(ode, *parts[:index])
        if ca.depends_on(others, z[blocks[index].span]):
            break
        first = index
    # A model whose states depend on no unknown is still solved for its first block.
    return max(first, 1)


def _quadratures(
    dae: Dae[Any, Any, Any, Any, Any],
    symbols: list[ca.SX],
    quad: ca.SX,
    after: tuple[Block, ...],
) -> ca.Function:
    """Return the rates of the quadratures from the motion, what follows from it solved for."""
    t, x, z, u = symbols
    count = after[0].span.start if after else z.numel()
    if not after or not ca.depends_on(quad, z[count:]):
        return ca.Function("quad", [t, x, z[:count], u], [quad])
    given = ca.vertcat(t, x, z[:count], u)
    equations = ca.vertcat(*(block.residual(t, x, z, u, 0.0) for block in after))
    problem = {"x": z[count:], "p": given, "g": equations}
    options = {"error_on_fail": False, "max_iter": FOLLOWING, "show_eval_warnings": False}
    solver = ca.rootfinder("following", "newton", problem, options)
    guess = ca.Function("guess", [x], [dae.guess[count:]])
    rates = ca.Function("rates", symbols, [quad])
    parts = [ca.MX.sym(name, part.numel()) for name, part in zip("txmu", (t, x, z[:count], u),
             strict=True)]  # fmt: skip
    found = solver(x0=guess(parts[1]), p=ca.vertcat(*parts))["x"]
    z_found = ca.vertcat(parts[2], found)
    return ca.Function("quad", parts, [rates(parts[0], parts[1], z_found, parts[3])])


def _least(dae: Dae[Any, Any, Any, Any, Any], bounds: ca.SX, following: ca.SX) -> ca.SX:
    least = ca.SX(np.inf)
    for limit, value in zip(dae.limits, ca.vertsplit(bounds) if dae.limits else [], strict=True):
        if ca.depends_on(value, following):
            continue
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
    dae: Dae[Any, Any, Any, Any, Any], symbols: list[ca.SX], parts: list[ca.SX]
) -> tuple[Block, ...]:
    blocks, end, z, easing = [], 0, symbols[2], symbols[4]
    for rows, labels in zip(parts, dae.labels.alg, strict=True):
        span = slice(end, end + len(labels))
        end = span.stop
        if not labels:
            continue
        if ca.depends_on(rows, z[span.stop :]):
            raise ModelError("a block of equations depends on the unknowns of a later one")
        jacobian = ca.densify(ca.jacobian(rows, z[span]))
        eased = dae.easing is not None and ca.depends_on(rows, easing)
        blocks.append(
            Block(
                span,
                ca.Function("residual", symbols, [rows]),
                ca.Function("jacobian", symbols, [jacobian]),
                not any(ca.which_depends(rows, z[span], 2)),
                dae.easing.values if dae.easing and eased else (0.0,),
                labels,
            )
        )
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
    """Return the samples after a Newton step on the motion, and what that step says.

    The integrator's interpolation leaves the algebraic equations satisfied to its tolerance only;
    the step is as large as that error. Where it does not do, others follow. With it comes the
    report of `followed`.
    """
    z, n = samples.z.copy(), loop.moving
    alg, jac = _linearised(loop, samples)
    step, size = _steps(jac, alg), _largest(alg)
    first = _largest(step[loop.blocks[0].span])
    rough = np.ones(samples.t.size, dtype=bool)
    for _ in range(CORRECTIONS):
        z[:n, rough] -= step[:, rough]
        alg, jac = _linearised(loop, samples._replace(z=z))
        former, size = size, _largest(alg)
        rough &= (size > ENOUGH) & ~((size < UNSOLVED) & (size > former / 2))
        if not rough.any():
            break
        step = _steps(jac, alg)
    found, report = followed(loop, samples._replace(z=z), (alg, jac))
    return found, {"newton_step": first, **report}


def _largest(rows: Array) -> Array:
    return np.asarray(np.abs(rows).max(axis=0))


def _linearised(loop: Loop, samples: Samples) -> tuple[Array, Array]:
    """Return the residuals of the motion's equations in columns, and their Jacobians."""
    newton, n = loop.newton.map(samples.t.size), loop.moving
    found = newton(samples.t[None], samples.x, samples.z[:n], samples.u)
    alg, jac = (np.array(out) for out in found)
    return alg, _each(jac, n)


def followed(
    loop: Loop, samples: Samples, known: tuple[Array, Array] | None = None
) -> tuple[Samples, dict[str, Array]]:
    """Return the samples with what follows from their motion, and how well all equations hold.

    The report holds the smallest singular value of the Jacobian of the motion's equations, the
    distance to a singular configuration, and the residuals block by block. ``known`` are residuals
    and Jacobians of the samples, if they are at hand.
    """
    count, n, z = samples.t.size, loop.moving, samples.z.copy()
    left, jac = known or _linearised(loop, samples)
    report = {"singular_value": np.asarray(np.linalg.svd(jac, compute_uv=False)[:, -1])}
    for block in loop.blocks:
        report[f"{block.labels[0].name}_residual"] = _largest(left[block.span])
    if loop.after:
        guess = ca.Function("guess", [loop.dae.columns()[0]], [loop.dae.guess]).map(count)
        z[n:] = np.array(guess(samples.x))[n:]
    for block in loop.after:
        z, rest = _solved(block, samples._replace(z=z), loop.dae.scale[block.span, None])
        report[f"{block.labels[0].name}_residual"] = _largest(rest)
    return samples._replace(z=z), report


def _solved(block: Block, samples: Samples, size: Array) -> tuple[Array, Array]:
    """Return ``z`` with a block solved by Newton's method at all samples, and its residual.

    Where the equations have no solution the residual says so.
    """
    count, n, z = samples.t.size, len(block.labels), samples.z.copy()
    residual, jacobian = block.residual.map(count), block.jacobian.map(count)

    def at(function: ca.Function) -> Array:
        return np.array(
            function(
                samples.t[None], samples.x, z, samples.u, np.full((1, count), block.stages[-1])
            )
        )

    for _ in range(FOLLOWING):
        step = _steps(_each(at(jacobian), n), at(residual))
        z[block.span] -= step
        if block.linear or not (np.abs(step) > ROUNDING * size).any():
            break
    return z, at(residual)


def _each(side_by_side: Array, n: int) -> Array:
    """Return square matrices, shape (count, n, n), from one of shape (n, count n)."""
    return side_by_side.reshape(n, -1, n).transpose(1, 0, 2)


def _steps(matrices: Array, right: Array) -> Array:
    """Return the solutions of many linear systems in columns; least squares if one is singular."""
    try:
        return np.asarray(np.linalg.solve(matrices, right.T[..., None])[..., 0].T)
    except np.linalg.LinAlgError:
        return np.asarray((np.linalg.pinv(matrices) @ right.T[..., None])[..., 0].T)


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
    blocks = (*loop.blocks, *loop.after)
    units = {f"{block.labels[0].name}_residual": block.labels[0].unit for block in blocks}
    words = {
        "newton_step": "largest change of a position by the Newton step on the sample",
        "singular_value": "smallest singular value of the Jacobian of the algebraic equations",
    }
    return Label(
        name,
        units.get(name, "1" if name == "singular_value" else "m"),
        words.get(name, "largest residual of these equations after the Newton step"),
    )
