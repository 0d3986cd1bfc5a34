"""From an optimal control problem to a nonlinear program, by Radau collocation.

Time is divided into intervals. On each of them the states are polynomials of the degree, with their
values at its beginning and at the Radau points, the last of which is its end; the algebraic
unknowns have values at the points. Equations, limits and costs of an interval are one symbolic
function of its own unknowns, evaluated and differentiated for all intervals at a time; what comes
out is put into the large sparse matrices by index.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt
import scipy.sparse

from slipfree.dae import Dae, Limit
from slipfree.errors import ModelError
from slipfree.named import Array, Label, leaves
from slipfree.solve.loop import Block, Loop, close

Index = npt.NDArray[np.intp]
DEGREES = (1, 2, 3, 4, 5)
Model = Dae[Any, Any, Any, Any, Any]


class Cost(NamedTuple):
    """A term of the cost, integrated over time.

    Attributes
    ----------
    label : Label
        Name and unit of the integral.
    expression : SX, shape (1, 1)
        In the symbols of the model.
    weight : float
        What a unit of the integral costs.
    """

    label: Label
    expression: ca.SX
    weight: float


class Place(NamedTuple):
    """Conditions at one time: the goal at the end, or a way-point.

    Attributes
    ----------
    fraction : float
        Of the duration; one is the end. The nearest end of an interval counts.
    limits : tuple of Limit
        Conditions in the symbols of the model; equal bounds for an equation.
    """

    fraction: float
    limits: tuple[Limit, ...]


@dataclass(frozen=True, eq=False)
class Task:
    """An optimal control problem.

    Attributes
    ----------
    dae : Dae
        The model.
    start : ndarray, shape (n_x,)
        States at the beginning, local.
    duration : tuple of 2 floats
        Least and largest duration; equal for a fixed one. [s]
    costs : tuple of Cost
        Their sum is least.
    places : tuple of Place
        Goal and way-points.
    limits : tuple of Limit
        Along the way.
    inputs : ndarray, shape (n_u, 2)
        Least and largest inputs.
    accelerations : ndarray, shape (n_u, 2)
        Least and largest rates of the inputs, infinite if they may jump at will. [1/s2]
    smooth : float
        Weight of the squared rates of the inputs, integrated over time.
    """

    dae: Model
    start: Array
    duration: tuple[float, float]
    costs: tuple[Cost, ...]
    places: tuple[Place, ...]
    limits: tuple[Limit, ...]
    inputs: Array
    accelerations: Array
    smooth: float


class Mesh(NamedTuple):
    """Intervals and the points on each.

    Attributes
    ----------
    ends : ndarray, shape (n + 1,)
        Fractions of the duration, from zero to one.
    degree : int
        Number of points of an interval.
    """

    ends: Array
    degree: int

    @property
    def points(self) -> Array:
        """Radau points of (0, 1], shape (degree,)."""
        return np.array(ca.collocation_points(self.degree, "radau"))

    @property
    def nodes(self) -> Array:
        """Fractions of the duration: the beginning and all points, shape (1 + n degree,)."""
        inner = self.ends[:-1, None] + np.diff(self.ends)[:, None] * self.points
        return np.append(0.0, inner.ravel())


class Piece(NamedTuple):
    """A function that stands at several places of the program.

    Attributes
    ----------
    values, jacobian, hessian : casadi Function
        ``(v, q, p) -> (cost, rows)``; ``-> Jacobian of the rows``; and with multipliers of cost and
        rows, ``(v, q, p, s, l) -> Hessian of s cost + l' rows``.
    where : ndarray, shape (count, n_v)
        Which unknowns of the program ``v`` are.
    constants : ndarray, shape (n_q, count)
        Values of ``q``.
    labels : tuple of Label
        Of the rows.
    lower, upper : ndarray, shape (n_rows,)
        Bounds of the rows.
    """

    values: ca.Function
    jacobian: ca.Function
    hessian: ca.Function
    where: Index
    constants: Array
    labels: tuple[Label, ...]
    lower: Array
    upper: Array


class Layout(NamedTuple):
    """Where the unknowns of the program are: states, inputs, unknowns by point, and duration.

    Attributes
    ----------
    first : ndarray, shape (n_x,)
        States at the beginning.
    inputs : ndarray, shape (n, n_u)
        Inputs of every interval.
    states, unknowns : ndarray, shape (n, degree, n_x) and (n, degree, n_z)
        At all points.
    duration : int
        The last one.
    """

    first: Index
    inputs: Index
    states: Index
    unknowns: Index
    duration: int


@dataclass(frozen=True, eq=False)
class Program:
    """A nonlinear program: ``f(w, p)`` is least within ``lower <= w <= upper`` and rows' bounds.

    Unknowns are divided by ``scale``; ``p`` are the weights of the costs, the smoothness last.

    Attributes
    ----------
    task, mesh, layout : Task, Mesh, Layout
        What it came from.
    pieces : tuple of Piece
        What its rows are made of, in their order.
    problem : dict
        ``x, p, f, g`` for CasADi.
    jacobian, hessian : casadi Function
        Exact derivatives, in the form that its interface to IPOPT takes.
    scale, lower, upper : ndarray, shape (n_w,)
        Sizes of the unknowns, and their bounds, not scaled.
    g_lower, g_upper : ndarray, shape (n_g,)
        Bounds of the rows.
    """

    task: Task
    mesh: Mesh
    layout: Layout
    pieces: tuple[Piece, ...]
    problem: dict[str, Any]
    jacobian: ca.Function
    hessian: ca.Function
    scale: Array
    lower: Array
    upper: Array
    g_lower: Array
    g_upper: Array


def transcribe(task: Task, mesh: Mesh) -> Program:
    """Return the nonlinear program of a task on a mesh.

    Raises
    ------
    ModelError
        If the degree is not one of 1 to 5.
    """
    if mesh.degree not in DEGREES:
        raise ModelError(f"plan: expected a degree of 1 to 5, found {mesh.degree}")
    loop = close(task.dae, task.dae.inputs(**{
        label.full: 0.0 for label in leaves(task.dae.labels.u)}), 0)  # fmt: skip
    blocks = _needed(task, loop)
    layout = _layout(loop, mesh, blocks[-1].span.stop)
    size = layout.duration + 1
    bounds, rows = _split(task, loop)
    interval = _interval(task, (loop.dae, len(blocks)), mesh, layout, rows)
    pieces = (interval, *_places(task, loop, mesh, layout))
    scale = _scale(task, layout)
    lower, upper = _bounds(task, layout, bounds, size)
    w, p = ca.MX.sym("w", size), ca.MX.sym("p", len(task.costs) + 1)
    f, g = _values(pieces, w * scale, p)
    sigma, multipliers = ca.MX.sym("sigma"), ca.MX.sym("lambda", g.numel())
    return Program(
        task, mesh, layout, pieces, {"x": w, "p": p, "f": f, "g": g},
        ca.Function("jacobian", [w, p], [g, _jacobian(pieces, w, p, scale)]),
        ca.Function("hessian", [w, p, sigma, multipliers],
                    [_hessian(pieces, w, p, scale, sigma, multipliers)]),
        scale, lower, upper,
        np.concatenate([np.tile(each.lower, len(each.where)) for each in pieces]),
        np.concatenate([np.tile(each.upper, len(each.where)) for each in pieces]),
    )  # fmt: skip


def _needed(task: Task, loop: Loop) -> tuple[Block, ...]:
    """Return the blocks of equations that matter: those of the motion, and what is asked for."""
    z = loop.dae.columns()[1][loop.moving :]
    asked = [cost.expression for cost in task.costs]
    asked += [limit.expression for limit in task.limits]
    asked += [limit.expression for place in task.places for limit in place.limits]
    follows = ca.depends_on(ca.vertcat(ca.SX(0, 1), *asked), z) if z.numel() else False
    return (*loop.blocks, *loop.after) if follows else loop.blocks


def _layout(loop: Loop, mesh: Mesh, n_z: int) -> Layout:
    n_x, n_u = loop.dae.ode.numel(), loop.u.shape[0]
    count, degree = mesh.ends.size - 1, mesh.degree
    block = n_u + degree * (n_x + n_z)
    begins = n_x + block * np.arange(count)[:, None]
    inputs = begins + np.arange(n_u)
    states = (begins + n_u + np.arange(degree * n_x)).reshape(count, degree, n_x)
    rest = begins + n_u + degree * n_x + np.arange(degree * n_z)
    unknowns = rest.reshape(count, degree, n_z)
    return Layout(np.arange(n_x), inputs, states, unknowns, n_x + block * count)


def _split(
    task: Task, loop: Loop
) -> tuple[dict[tuple[str, int], tuple[float, float]], list[Limit]]:
    """Return limits that bound a state or an unknown alone, and those that take a row."""
    x, z, _ = loop.dae.columns()
    simple: dict[tuple[str, int], tuple[float, float]] = {}
    rows = []
    for limit in task.limits:
        found = [(kind, k) for kind, column in (("x", x), ("z", z)) for k in range(column.numel())
                 if ca.is_equal(limit.expression, column[k])]  # fmt: skip
        if not found:
            rows.append(limit)
            continue
        low, high = simple.get(found[0], (-np.inf, np.inf))
        simple[found[0]] = max(low, limit.lower), min(high, limit.upper)
    return simple, rows


def _interval(
    task: Task, model: tuple[Model, int], mesh: Mesh, layout: Layout, limits: list[Limit]
) -> Piece:
    """Return what every interval adds: defects, equations, limits, rates of the inputs, costs."""
    degree = mesh.degree
    n_x, n_z, n_u = layout.first.size, layout.unknowns.shape[2], layout.inputs.shape[1]
    lagrange, _, weights = ca.collocation_coeff(mesh.points.tolist())
    first, u, after = ca.SX.sym("first", n_x), ca.SX.sym("u", n_u), ca.SX.sym("after", n_u)
    states, unknowns = ca.SX.sym("states", n_x, degree), ca.SX.sym("unknowns", n_z, degree)
    duration, q = ca.SX.sym("duration"), ca.SX.sym("q", 2)
    p = ca.SX.sym("p", len(task.costs) + 1)
    point = _point(task, model, n_z, limits)
    h = q[1] * duration
    polynomial = ca.horzcat(first, states)
    rows, cost = [], ca.SX(0)
    for j, (at, weight) in enumerate(zip(mesh.points, weights.nonzeros(), strict=True)):
        ode, alg, kept, paid = point((q[0] + at * q[1]) * duration, states[:, j], unknowns[:, j], u)
        slope = ca.reshape(polynomial @ _column(lagrange, j), n_x, 1)
        rows += [slope - h * ode, alg, kept]
        cost += weight * h * sum(p[k] * paid[k] for k in range(len(task.costs)))
    change = (after - u) / h
    jumps = [k for k in range(n_u) if np.isfinite(task.accelerations[k]).any()]
    rows += [change[k] for k in jumps]
    cost += p[-1] * h * ca.sumsqr(change)
    index = _interval_index(layout)
    labels, low, high = _interval_rows(task, model, degree, limits, jumps)
    v = ca.vertcat(first, u, after, ca.vec(states), ca.vec(unknowns), duration)
    constants = np.vstack([mesh.ends[:-1], np.diff(mesh.ends)])
    return _piece((v, q, p), cost, ca.vertcat(*rows), index, constants, (labels, low, high))


def _column(lagrange: Any, j: int) -> ca.DM:
    """Return the derivatives at point ``j`` of the polynomials that are one at each node."""
    return ca.DM(np.array(lagrange)[:, j])


def _point(task: Task, model: tuple[Model, int], n_z: int, limits: list[Limit]) -> ca.Function:
    """Return ``(t, x, z, u) -> (ode, alg, limits, costs)``, with the first unknowns alone."""
    dae, blocks = model
    x, z, u = dae.columns()
    alg = ca.vertcat(*dae.alg[:blocks])
    if dae.easing is not None:
        alg = ca.substitute(alg, dae.easing.symbol, dae.easing.values[-1])
    kept = ca.vertcat(ca.SX(0, 1), *(limit.expression for limit in limits))
    paid = ca.vertcat(ca.SX(0, 1), *(cost.expression for cost in task.costs))
    return ca.Function("point", [dae.t, x, z[:n_z], u], [dae.ode, alg, kept, paid])


def _interval_index(layout: Layout) -> Index:
    count = layout.inputs.shape[0]
    first = np.vstack([layout.first, layout.states[:-1, -1]])
    after = np.vstack([layout.inputs[1:], layout.inputs[-1:]])
    ends = np.full((count, 1), layout.duration)
    parts = [first, layout.inputs, after, layout.states.reshape(count, -1),
             layout.unknowns.reshape(count, -1), ends]  # fmt: skip
    return np.hstack(parts)


def _interval_rows(
    task: Task, model: tuple[Model, int], degree: int, limits: list[Limit], jumps: list[int]
) -> tuple[tuple[Label, ...], Array, Array]:
    dae, blocks = model
    motion = [Label(f"{label.name}_motion", label.unit, f"motion of {label.words}", label.wheel)
              for label in leaves(dae.labels.x)]  # fmt: skip
    equations = [label for block in dae.labels.alg[:blocks] for label in block]
    names = [label.full for label in leaves(dae.labels.u)]
    rates = [Label(f"{names[k]}_change", "s-2", f"rate of {names[k]}") for k in jumps]
    point = [*motion, *equations, *(limit.label for limit in limits)]
    zeros = [0.0] * (len(motion) + len(equations))
    low = [*zeros, *(limit.lower for limit in limits)] * degree
    high = [*zeros, *(limit.upper for limit in limits)] * degree
    low += [task.accelerations[k, 0] for k in jumps]
    high += [task.accelerations[k, 1] for k in jumps]
    return (*(point * degree), *rates), np.array(low), np.array(high)


def _places(task: Task, loop: Loop, mesh: Mesh, layout: Layout) -> list[Piece]:
    """Return what goal and way-points add."""
    pieces = []
    x, z, u = loop.dae.columns()
    z = z[: layout.unknowns.shape[2]]
    p, duration = ca.SX.sym("p", len(task.costs) + 1), ca.SX.sym("duration")
    for place in task.places:
        k = max(int(np.abs(mesh.ends - place.fraction).argmin()) - 1, 0)
        rows = ca.vertcat(*(limit.expression for limit in place.limits))
        rows = ca.substitute(rows, loop.dae.t, float(mesh.ends[k + 1]) * duration)
        index = np.concatenate([layout.inputs[k], layout.states[k, -1], layout.unknowns[k, -1],
                                [layout.duration]])  # fmt: skip
        labels = tuple(limit.label for limit in place.limits)
        low, high = (np.array([getattr(limit, side) for limit in place.limits])
                     for side in ("lower", "upper"))  # fmt: skip
        v = ca.vertcat(u, x, z, duration)
        symbols = (v, ca.SX.sym("q", 0), p)
        pieces.append(_piece(symbols, ca.SX(0), rows, index[None], np.zeros((0, 1)),
                             (labels, low, high)))  # fmt: skip
    return pieces


def _piece(
    symbols: tuple[ca.SX, ca.SX, ca.SX], cost: ca.SX, rows: ca.SX, index: Index, constants: Array,
    bounds: tuple[tuple[Label, ...], Array, Array],
) -> Piece:  # fmt: skip
    """Return a piece with its derivatives, made here so that they are those of one interval."""
    sigma, multipliers = ca.SX.sym("sigma"), ca.SX.sym("lambda", rows.numel())
    lagrangian = sigma * cost + ca.dot(multipliers, rows)
    hessian = ca.hessian(lagrangian, symbols[0])[0]
    given = list(symbols)
    return Piece(
        ca.Function("values", given, [cost, rows]),
        ca.Function("jacobian", given, [ca.jacobian(rows, symbols[0])]),
        ca.Function("hessian", [*given, sigma, multipliers], [hessian]),
        index, constants, *bounds,
    )  # fmt: skip


def _scale(task: Task, layout: Layout) -> Array:
    scale = np.ones(layout.duration + 1)
    scale[layout.unknowns] = task.dae.scale[: layout.unknowns.shape[2]]
    return scale


def _bounds(
    task: Task, layout: Layout, simple: dict[tuple[str, int], tuple[float, float]], size: int
) -> tuple[Array, Array]:
    """Return the bounds of the unknowns."""
    lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
    lower[layout.first] = upper[layout.first] = task.start
    lower[layout.inputs], upper[layout.inputs] = task.inputs[:, 0], task.inputs[:, 1]
    for (kind, k), (low, high) in simple.items():
        where = (layout.states if kind == "x" else layout.unknowns)[:, :, k]
        lower[where], upper[where] = low, high
    lower[layout.duration], upper[layout.duration] = task.duration
    return lower, upper


def _arguments(piece: Piece, w: ca.MX, p: ca.MX) -> list[Any]:
    count, n_v = piece.where.shape
    v = ca.reshape(w[piece.where.ravel().tolist()], n_v, count)
    return [v, ca.DM(piece.constants), ca.repmat(p, 1, count)]


def _values(pieces: Sequence[Piece], w: ca.MX, p: ca.MX) -> tuple[ca.MX, ca.MX]:
    cost, rows = ca.MX(0), []
    for piece in pieces:
        paid, kept = piece.values.map(len(piece.where))(*_arguments(piece, w, p))
        cost += ca.sum2(paid)
        rows.append(ca.vec(kept))
    return cost, ca.vertcat(*rows)


def _jacobian(pieces: Sequence[Piece], w: ca.MX, p: ca.MX, scale: Array) -> ca.MX:
    """Return the Jacobian of all rows, put together from those of the pieces."""
    values, places, begin = [], [], 0
    for piece in pieces:
        count, each = len(piece.where), len(piece.labels)
        found = piece.jacobian.map(count)(*_arguments(piece, w * scale, p))
        row, column = (
            np.array(part, dtype=np.intp) for part in piece.jacobian.sparsity_out(0).get_triplet()
        )
        rows = begin + each * np.arange(count)[:, None] + row
        columns = piece.where[:, column]
        values.append(ca.vec(found.nz[:]) * scale[columns].ravel())
        places.append((rows.ravel(), columns.ravel()))
        begin += each * count
    return _assembled(values, places, (begin, w.numel()))


def _hessian(
    pieces: Sequence[Piece], w: ca.MX, p: ca.MX, scale: Array, sigma: ca.MX, multipliers: ca.MX
) -> ca.MX:
    """Return the upper half of the Lagrangian's Hessian, put together from those of the pieces."""
    values, places, begin = [], [], 0
    for piece in pieces:
        count, each = len(piece.where), len(piece.labels)
        own = ca.reshape(multipliers[begin : begin + each * count], each, count)
        weights = ca.repmat(sigma, 1, count)
        found = piece.hessian.map(count)(*_arguments(piece, w * scale, p), weights, own)
        row, column = (
            np.array(part, dtype=np.intp) for part in piece.hessian.sparsity_out(0).get_triplet()
        )
        rows, columns = piece.where[:, row].ravel(), piece.where[:, column].ravel()
        # Of the two entries of a pair the upper one counts; a pair of equal places keeps both.
        kept = np.flatnonzero(rows <= columns)
        values.append(ca.vec(found.nz[kept.tolist()]) * (scale[rows] * scale[columns])[kept])
        places.append((rows[kept], columns[kept]))
        begin += each * count
    return _assembled(values, places, (w.numel(), w.numel()))


def _assembled(
    values: list[ca.MX], places: list[tuple[Index, Index]], shape: tuple[int, int]
) -> ca.MX:
    """Return a sparse matrix of which several values may share a place."""
    rows, columns = (np.concatenate(part) for part in zip(*places, strict=True))
    key, where = np.unique(columns.astype(np.int64) * shape[0] + rows, return_inverse=True)
    at = (key % shape[0]).tolist(), (key // shape[0]).tolist()
    pattern = ca.Sparsity.triplet(shape[0], shape[1], *at)
    total = scipy.sparse.csc_matrix((np.ones(where.size), (where, np.arange(where.size))))
    starts, inside = total.indptr.tolist(), total.indices.tolist()
    gather = ca.DM(ca.Sparsity(total.shape[0], total.shape[1], starts, inside), total.data)
    return ca.MX(pattern, gather @ ca.vertcat(*values))
