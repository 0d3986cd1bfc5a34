"""Transcribe an optimal control problem into a nonlinear program by Radau collocation.

Time is divided into intervals. On each interval the states are polynomials of the given degree,
represented by their values at its beginning and at the Radau points, the last of which is its end;
the algebraic unknowns are represented by their values at the points. Equations, limits and costs at
a point are functions of the unknowns at this point and of the states at all points of its interval;
input rates are functions of the inputs of an interval.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import casadi as ca
import numpy as np
from annotated_types import Ge, Gt, Le, Unit

from slipfree.core.arguments import checked
from slipfree.core.dae import Dae, Limit
from slipfree.core.lookups import evaluate, found_column, needed_lookups, substitute_lookups
from slipfree.core.records import Array, Label, Mask, field_overview, leaves
from slipfree.core.schema import Flag
from slipfree.plan.sparse_assembly import Index as Index
from slipfree.plan.sparse_assembly import NlpBlock, assemble, nlp_block
from slipfree.plan.stage import Cost, StageFunctions, stage_functions
from slipfree.solve.system import SolverOptions, with_inputs

SAMPLE_STEP = 0.25  # largest time between samples of the simulation [s]


class TimedCondition(NamedTuple):
    """Conditions at one time: the goal at the end, or a way-point."""

    fraction: float  # of the duration; the nearest end of a mesh interval is used
    limits: tuple[Limit, ...]  # local; equal bounds fix a value


@dataclass(frozen=True, eq=False)
class PlanTask:
    """Optimal control problem of a plan."""

    dae: Dae  # model of the vehicle on its ground
    start: Array  # shape (n_x,): states at the beginning, in local coordinates
    # smallest and largest duration, equal if fixed; infinite before a guess determines it [s]
    duration: tuple[float, float]
    costs: tuple[Cost, ...]  # terms of the cost; their weighted sum is minimised
    conditions: tuple[TimedCondition, ...]  # way-points, then the goal
    limits: tuple[Limit, ...]  # limits at all times, in local coordinates
    inputs: Array  # shape (n_u, 2): smallest and largest values, may be infinite
    accelerations: Array  # shape (n_u, 2): bounds of their rates [1/s2]
    smooth: float  # weight of the squared rates of the inputs, integrated over time
    continuous: bool = False  # linear on every interval; else constant
    cost_limits: tuple[tuple[int, float], ...] = ()  # of their integrals, by index of the term
    initial_inputs: Array | None = None  # shape (n_u, 2): at the beginning
    periodic: Mask = field(default_factory=lambda: np.zeros(0, dtype=bool))  # in whole turns
    deadline: float = np.inf  # value of `time.monotonic` at which its solution ends [s]

    __repr__ = field_overview


@checked
@dataclass(frozen=True)
class Mesh:
    """First mesh of a plan, and the accuracy to which it is refined.

    Attributes
    ----------
    intervals : int or None
        Number of intervals; by default one per two vehicle sizes (`Dae.size`) of the path of the
        first guess, and at least 40.
    degree : int
        Number of collocation points per interval, 1 to 5.
    continuous : bool
        Whether inputs are continuous and linear on every interval; otherwise they are constant.
    accuracy : float
        Largest admissible difference of the simulation from the plan, in the unit of the quantity.
        The admissible violation of a limit is the smaller of ``accuracy`` and 1 % of its range; for
        equal bounds it is ``accuracy``. The mesh is refined where they are exceeded.
    step : float
        Largest time between samples of the simulation. [s]

    Raises
    ------
    ModelError
        If a number is out of its range.
    """

    intervals: Annotated[int | None, Ge(1)] = None
    degree: Annotated[int, Ge(1), Le(5)] = 3
    continuous: Flag = True
    accuracy: Annotated[float, Gt(0), Le(1), Unit("m, rad")] = 1e-3
    step: Annotated[float, Gt(0), Unit("s")] = SAMPLE_STEP


class CollocationMesh(NamedTuple):
    """Mesh of n intervals with the same number of Radau points each."""

    ends: Array  # shape (n + 1,): ends of the intervals as fractions of the duration, from 0 to 1
    degree: int  # degree of the polynomials and number of points per interval

    @property
    def points(self) -> Array:
        """Radau points of an interval as fractions of its length, shape (degree,)."""
        return np.array(ca.collocation_points(self.degree, "radau"))

    @property
    def nodes(self) -> Array:
        """Beginning and all points as fractions of the duration, shape (1 + n degree,)."""
        inner = self.ends[:-1, None] + np.diff(self.ends)[:, None] * self.points
        return np.append(0.0, inner.ravel())


class RowBlock(NamedTuple):
    """Rows (constraint functions) of the program, repeated per interval, or once."""

    where: Index  # shape (count, n_v): indices of the unknowns on which each repetition depends
    labels: tuple[Label, ...]
    lower: Array  # shape (n_rows,): bounds of the rows
    upper: Array


class VariableLayout(NamedTuple):
    """Indices of states, inputs, algebraic unknowns, roots and duration among all unknowns."""

    first: Index  # shape (n_x,): indices of the states at the beginning
    inputs: Index  # shape (n, n_u): of intervals or, if continuous, of their ends
    states: Index  # shape (n, degree, n_x): indices of the states at all points
    unknowns: Index  # shape (n, degree, n_z): indices of the algebraic unknowns at all points
    duration: int  # index of the duration, after all of these
    roots: Index = np.zeros((0, 0, 0), dtype=np.intp)  # shape (n, degree, n_r)


@dataclass(frozen=True, eq=False)
class Program:
    """Nonlinear program: minimise ``f(x, p)`` within bounds of the unknowns and of ``g(x, p)``.

    The unknowns ``x`` are divided by ``scale``; the parameters ``p`` are the weights of the costs,
    with the weight of the smoothness last.
    """

    task: PlanTask  # optimal control problem, mesh, and indices of the unknowns
    mesh: CollocationMesh
    layout: VariableLayout
    options: SolverOptions  # of the functions and of the simulation
    row_blocks: tuple[RowBlock, ...]  # of intervals, way-points and goal; limited costs follow
    problem: dict[str, Any]  # as ``casadi.nlpsol`` takes it
    gradient: ca.Function  # as ``casadi.nlpsol`` takes ``grad_f``
    jacobian: ca.Function  # ``jac_g``
    hessian: ca.Function  # ``hess_lag``
    scale: Array  # shape (n_w,): typical sizes of the unknowns
    lower: Array  # shape (n_w,): bounds of the unknowns, not scaled
    upper: Array
    g_lower: Array  # shape (n_g,): bounds of the rows
    g_upper: Array
    roots: ca.Function  # function ``x ->`` roots of squared cost terms
    compiled: bool  # whether the functions at the points are compiled

    __repr__ = field_overview


def transcribe(
    task: PlanTask, mesh: CollocationMesh, options: SolverOptions = SolverOptions()
) -> Program:
    """Return the nonlinear program of an optimal control problem on a mesh."""
    system = with_inputs(task.dae, task.dae.zero_inputs, 0, options)
    bounds, limits = _split(task)
    conditions = [
        *task.limits,
        *(limit for condition in task.conditions for limit in condition.limits),
    ]
    point = stage_functions(system, task.costs, limits, [each.expression for each in conditions])
    layout = variable_layout(mesh, point.sizes, continuous=task.continuous)
    shape = *layout.states.shape[:2], point.roots
    roots = layout.duration + 1 + np.arange(np.prod(shape)).reshape(shape)
    layout = layout._replace(roots=roots)
    scale = np.ones(layout.duration + 1 + layout.roots.size)
    scale[layout.unknowns] = task.dae.scale[: layout.unknowns.shape[2]]
    row_blocks = [_interval_rows(task, point, mesh, layout)]
    begin, at_conditions = len(row_blocks[0].where) * len(row_blocks[0].labels), list[NlpBlock]()
    for condition in task.conditions:
        rows, block = _condition_block(task, condition, mesh, layout, begin)
        row_blocks.append(rows)
        at_conditions.append(block)
        begin += len(rows.labels)
    points = _stage_block(task, point, mesh, layout, begin, compiled=options.compiled)
    rates = _rate_block(task, mesh, layout, len(row_blocks[0].labels))
    made = assemble([points, rates, *at_conditions], scale, len(task.costs) + 1)
    # Roots are their values plus the residuals of their rows.
    first_root = layout.first.size + layout.unknowns.shape[2]
    of_roots = points.row_indices[:, first_root : first_root + point.roots].ravel().tolist()
    all_rows = ca.Function("rows", [made.w, made.p], [made.g])(made.w, 0)
    root_values = made.w[layout.roots.ravel().tolist()] + all_rows[of_roots]
    lower, upper = np.full(scale.size, -np.inf), np.full(scale.size, np.inf)
    lower[layout.first] = upper[layout.first] = task.start
    lower[layout.inputs], upper[layout.inputs] = task.inputs.T
    if task.initial_inputs is not None:
        lower[layout.inputs[0]], upper[layout.inputs[0]] = task.initial_inputs.T
    for (kind, k), (low, high) in bounds.items():
        where = (layout.states if kind == "x" else layout.unknowns)[:, :, k]
        lower[where], upper[where] = low, high
    lower[layout.duration], upper[layout.duration] = task.duration
    highest = np.array([value for _, value in task.cost_limits])
    lowest = np.full(highest.size, -np.inf)
    return Program(
        task,
        mesh,
        layout,
        options,
        tuple(row_blocks),
        {"x": made.w, "p": made.p, "f": made.f, "g": made.g},
        made.gradient,
        made.jacobian,
        made.hessian,
        scale,
        lower,
        upper,
        np.concatenate([*(np.tile(each.lower, len(each.where)) for each in row_blocks), lowest]),
        np.concatenate([*(np.tile(each.upper, len(each.where)) for each in row_blocks), highest]),
        ca.Function("roots", [made.w], [root_values]),
        not points.rows.is_a("SXFunction"),
    )


def completed(program: Program, unknowns: Array) -> Array:
    """Return unscaled unknowns with their roots recomputed from the other unknowns."""
    full, n_w = unknowns.copy(), program.roots.size1_in(0)
    (roots,) = evaluate(program.roots, (unknowns[:n_w] / program.scale[:n_w])[:, None])
    full[program.layout.roots.ravel()] = roots.ravel()
    return full


def variable_layout(
    mesh: CollocationMesh, counts: tuple[int, int, int], *, continuous: bool
) -> VariableLayout:
    """Return the layout without roots; ``counts`` are numbers of states, unknowns and inputs."""
    n_x, n_z, n_u = counts
    count, degree = mesh.ends.size - 1, mesh.degree
    block = n_u + degree * (n_x + n_z)
    begins = n_x + block * np.arange(count + continuous)[:, None]
    inputs = begins + np.arange(n_u)
    begins = begins[:count]
    states = (begins + n_u + np.arange(degree * n_x)).reshape(count, degree, n_x)
    rest = begins + n_u + degree * n_x + np.arange(degree * n_z)
    unknowns = rest.reshape(count, degree, n_z)
    duration = n_x + block * count + n_u * continuous
    return VariableLayout(np.arange(n_x), inputs, states, unknowns, duration)


def _split(task: PlanTask) -> tuple[dict[tuple[str, int], tuple[float, float]], list[Limit]]:
    """Return bounds of single states and unknowns, by record and index, and all other limits."""
    simple: dict[tuple[str, int], tuple[float, float]] = {}
    rows = []
    for limit in task.limits:
        variable = variable_of(task, limit.expression)
        if variable is None:
            rows.append(limit)
            continue
        low, high = simple.get(variable, (-np.inf, np.inf))
        simple[variable] = max(low, limit.lower), min(high, limit.upper)
    return simple, rows


def variable_of(task: PlanTask, expression: ca.SX) -> tuple[str, int] | None:
    """Return the record (``"x"`` or ``"z"``) and index of a state or unknown; None for others."""
    for record, symbols in (("x", task.dae.x), ("z", task.dae.z)):
        for k, symbol in enumerate(leaves(symbols)):
            # of one symbol; `ca.is_equal` takes 20 times as long
            if expression.element_hash() == symbol.element_hash():
                return record, k
    return None


def rate_of(label: Label) -> Label:
    """Return the label of the rate of an input, in 1/s2."""
    return Label(f"{label.full}_change", "s-2", f"rate of {label.full}")


def _interval_rows(
    task: PlanTask, point: StageFunctions, mesh: CollocationMesh, layout: VariableLayout
) -> RowBlock:
    """Return the rows of the intervals: those of the points, then the bounded input rates."""
    inputs, jumps = list(leaves(task.dae.labels.u)), bounded_rates(task)
    rates = [rate_of(inputs[k]) for k in jumps]
    low, high = (
        np.append(np.tile(bounds, mesh.degree), task.accelerations[jumps, side])
        for side, bounds in enumerate((point.lower, point.upper))
    )
    return RowBlock(_whole(layout, mesh), (*(point.labels * mesh.degree), *rates), low, high)


def bounded_rates(task: PlanTask) -> list[int]:
    """Return the indices of the inputs whose rates are bounded."""
    return [k for k, bounds in enumerate(task.accelerations) if np.isfinite(bounds).any()]


def _whole(layout: VariableLayout, mesh: CollocationMesh) -> Index:
    """Return the indices of all unknowns of every interval, one row per interval."""
    count = mesh.ends.size - 1
    inner = [each.reshape(count, -1) for each in (layout.unknowns, layout.roots)]
    last = np.full((count, 1), layout.duration)
    return np.hstack([_nodes(layout), *_ends(layout, mesh), *inner, last])


def _nodes(layout: VariableLayout) -> Index:
    """Return the indices of the states at the beginning and the points of every interval."""
    first = np.vstack([layout.first, layout.states[:-1, -1]])
    return np.hstack([first, layout.states.reshape(len(first), -1)])


def _ends(layout: VariableLayout, mesh: CollocationMesh) -> tuple[Index, Index]:
    """Return the indices of the inputs of every interval, and of the inputs that follow them."""
    count = mesh.ends.size - 1
    # After the last interval, inputs that are constant on intervals keep their values.
    after = np.vstack([layout.inputs[1:], layout.inputs[-1:]])
    return layout.inputs[:count], after[:count]


def _stage_block(
    task: PlanTask,
    point: StageFunctions,
    mesh: CollocationMesh,
    layout: VariableLayout,
    first_limit: int,
    *,
    compiled: bool,
) -> NlpBlock:
    """Return the block of the collocation points; limited costs are rows from ``first_limit``."""
    n_x, n_z, n_u = point.sizes
    count, degree = mesh.ends.size - 1, mesh.degree
    nodes, x, z = (ca.SX.sym(*of) for of in (("nodes", n_x, 1 + degree), ("x", n_x), ("z", n_z)))
    r, duration = ca.SX.sym("r", point.roots), ca.SX.sym("duration")
    u, after = ca.SX.sym("u", n_u), ca.SX.sym("after", n_u)
    q, p = ca.SX.sym("q", 5 + degree), ca.SX.sym("p", len(task.costs) + 1)
    begin, length, at, weight, slopes = q[0], q[1], q[2], q[3], q[4:]
    here = (1 - at) * u + at * after if task.continuous else u
    values = [(begin + at * length) * duration, x, z, r, here]
    lookups, _, _ = substitute_lookups(point.lookups, point.symbols, values)
    ode, rows, paid = point.function(*values, found_column(lookups))
    h = length * duration
    inner = np.repeat(np.arange(count), degree)
    where = np.hstack(
        [
            _nodes(layout)[inner],
            layout.states.reshape(-1, n_x),
            layout.unknowns.reshape(-1, n_z),
            layout.roots.reshape(inner.size, -1),
            *(each[inner] for each in _ends(layout, mesh)),
            np.full((inner.size, 1), layout.duration),
        ]
    )
    each = len(point.labels)
    jumps = inner[:, None] * len(bounded_rates(task))
    row_indices = each * np.arange(inner.size)[:, None] + jumps + np.arange(each)
    limited = [k for k, _ in task.cost_limits]
    shared = np.tile(first_limit + np.arange(len(limited)), (inner.size, 1))
    integrals = [weight * h * paid[k] for k in limited]
    return nlp_block(
        (ca.vertcat(ca.vec(nodes), x, z, r, u, after, duration), q, p),
        weight * h * sum((p[k] * paid[k] for k in range(len(task.costs))), ca.SX(0)),
        ca.vertcat(nodes @ slopes - h * ode, rows, *integrals),
        lookups,
        (where, np.hstack([row_indices, shared])),
        _point_constants(mesh),
        compiled=compiled,
    )


def _point_constants(mesh: CollocationMesh) -> Array:
    """Return the constants of each point, shape (n degree, 5 + degree).

    Columns: beginning and length of the interval as fractions of the duration, position of the
    point as a fraction of the interval, its quadrature weight, and the weights of the values at all
    nodes in the derivative at the point.
    """
    lagrange, _, weights = ca.collocation_coeff(mesh.points.tolist())
    own = np.column_stack([mesh.points, weights.nonzeros(), np.array(lagrange).T])
    spans = np.column_stack([mesh.ends[:-1], np.diff(mesh.ends)])
    return np.hstack([np.repeat(spans, mesh.degree, axis=0), np.tile(own, (len(spans), 1))])


def _rate_block(
    task: PlanTask, mesh: CollocationMesh, layout: VariableLayout, each: int
) -> NlpBlock:
    """Return the block of input rates: smoothness cost, and rows after those of the points."""
    n_u, jumps = layout.inputs.shape[1], bounded_rates(task)
    u, after, duration = ca.SX.sym("u", n_u), ca.SX.sym("after", n_u), ca.SX.sym("duration")
    length, p = ca.SX.sym("length"), ca.SX.sym("p", len(task.costs) + 1)
    h = length * duration
    change = (after - u) / h
    count = mesh.ends.size - 1
    where = np.hstack([*_ends(layout, mesh), np.full((count, 1), layout.duration)])
    row_indices = each * np.arange(1, count + 1)[:, None] + np.arange(-len(jumps), 0)
    return nlp_block(
        (ca.vertcat(u, after, duration), length, p),
        p[-1] * h * ca.sumsqr(change),
        ca.vertcat(ca.SX(0, 1), *(change[k] for k in jumps)),
        (),
        (where, row_indices),
        np.diff(mesh.ends)[:, None],
    )


def _condition_block(
    task: PlanTask,
    condition: TimedCondition,
    mesh: CollocationMesh,
    layout: VariableLayout,
    begin: int,
) -> tuple[RowBlock, NlpBlock]:
    """Return rows and block of a goal or a way-point, whose first row has the index ``begin``.

    The conditions are on inputs, states and unknowns at the end of the nearest interval.
    """
    k = max(int(np.abs(mesh.ends - condition.fraction).argmin()) - 1, 0)
    parts = layout.states[k, -1], layout.unknowns[k, -1], layout.inputs[k + task.continuous]
    where = np.concatenate([*parts, [layout.duration]])[None]
    limits = condition.limits
    low, high = (
        np.array([getattr(limit, side) for limit in limits]) for side in ("lower", "upper")
    )
    x, z, u = task.dae.columns()
    p, duration = ca.SX.sym("p", len(task.costs) + 1), ca.SX.sym("duration")
    rows = ca.vertcat(ca.SX(0, 1), *(limit.expression for limit in limits))
    time = mesh.ends[k + 1] * duration
    lookups, before, after = substitute_lookups(
        needed_lookups(task.dae.lookups, [rows]), [task.dae.t], [time]
    )
    (rows,) = ca.substitute([rows], before, after)
    block = nlp_block(
        (ca.vertcat(x, z[: layout.unknowns.shape[2]], u, duration), ca.SX.sym("q", 0), p),
        ca.SX(0),
        rows,
        lookups,
        (where, begin + np.arange(len(limits))[None]),
        np.zeros((1, 0)),
    )
    return RowBlock(where, tuple(limit.label for limit in limits), low, high), block
