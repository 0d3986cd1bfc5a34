"""Evaluation graphs of a model: Newton's step of its positions, its rates, limits and outputs.

Each graph is an SX function without calls and branches. Linear systems are solved by elimination
inside the graph. The order of the pivots is chosen once, for several states together:
Markowitz's count of new entries decides among the entries that are large enough in every state.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.dae import Continuation, Dae, PlacedCheck, WheelCheck
from slipfree.core.errors import ModelError
from slipfree.core.lookups import Lookup, dense, evaluate, found_column, needed_lookups
from slipfree.core.records import Array, consecutive, leaves, pack

SAMPLES = 13  # states at which pivots are chosen: one at rest, and pairs of opposite ones
PLACING_STEPS = 20  # Newton steps to their positions
MIN_PIVOT = 0.02  # smallest pivot, relative to the largest entry of its row
MIN_PIVOT_ON_DIAGONAL = 1e-4  # smaller ones are sought elsewhere
GUESS_SPREAD = 0.1  # of unknowns other than rates [typical size]
PLACED = 1e-6  # last Newton step of the position of a sample [size]
MAX_STEP = 0.25  # largest Newton step of a rate without projection [typical size]
TILT_SPREAD = 0.02  # of states that relax [m, rad]
JOINT_SPREAD = 0.5  # standard deviation of the random joint angles [rad]
Solve = Callable[[ca.SX, ca.SX], ca.SX]


class Graph(NamedTuple):
    """A function of the rows of a state."""

    name: str
    # SX function of two columns, the rows of a state and the results of the lookups, to a column
    function: ca.Function
    lookups: tuple[Lookup, ...]  # the lookups, in a valid order of evaluation
    # arguments of each lookup, as functions of the same two columns
    arguments: tuple[ca.Function, ...]
    parts: tuple[slice, ...]  # rows of each result in the column


class StateRows(NamedTuple):
    """Rows of a state: an array with a row for each variable and a column for each lane.

    ``x``, ``p`` and ``q`` are integrated: the states, the positions (first block of the unknowns),
    and the quadratures that do not depend on forces. ``w`` are the other unknowns of the motion,
    ``f`` the unknowns that follow from it, ``u`` the inputs, ``v`` the inputs before a sample,
    ``c`` the parameters of the model, ``stage`` the continuation parameter of a law without
    projection, ``lag`` the lag of a model whose last states relax, and ``t`` is the time.
    """

    x: slice
    p: slice
    q: slice
    w: slice
    f: slice
    u: slice
    v: slice
    c: slice
    stage: slice
    lag: slice
    t: slice

    @property
    def z(self) -> tuple[slice, slice, slice]:
        """Rows of all algebraic unknowns, in their order in the model."""
        return self.p, self.w, self.f


class Graphs(NamedTuple):
    """Graphs of a model."""

    dae: Dae
    rows: StateRows  # rows of its states
    state: ca.SX  # symbols of a state, shape (n_rows, 1)
    quadratures: tuple[int, ...]  # indices of the quadratures that are integrated
    guess: Graph  # initial guesses of ``p``, ``w`` and ``f``, and of the states that relax
    # one Newton step of the positions: new ``p``, and the sum of its changes in typical sizes
    place: Graph
    # one Newton step of the positions, and the rates there: derivatives of the integrated rows, new
    # ``p``, new ``w``, the sum of the changes of ``p`` in typical sizes, that of the errors of
    # ``w``, and the speed over the ground [m/s]
    motion: Graph
    # the results of ``motion``, then new ``f`` by one Newton step, a number that is positive if
    # another is needed, and the distances to the bounds of the limits in sizes of the quantities;
    # for linear rates without relaxation, also the derivatives with the inputs ``v``
    checked: Graph
    # for linear rates without relaxation, the derivatives of the states alone: two of the five
    # evaluations of a step, those of its error, need no more
    slopes: Graph
    bounds: tuple[int, ...]  # index of the limit to which each distance belongs
    limits: Graph  # values of the limits
    outputs: Graph
    checks: tuple[PlacedCheck, ...]  # of samples
    wheels: dict[int, WheelCheck]  # those of wheels, by their indices
    placing: Graph  # expressions on which the checks of samples depend, one result for each check
    linear: bool  # whether the rates are the solution of linear equations

    @property
    def places(self) -> list[int]:
        """Rows of ``x``, ``y`` and ``heading``."""
        return self.dae.state_rows("x", "y", "heading")

    @property
    def stages(self) -> tuple[float, ...]:
        """Values of the continuation parameter; none if it is not a row of the states."""
        continuation = _continuation(self.dae)
        return () if continuation is None else continuation.values

    @property
    def every(self) -> tuple[Graph, ...]:
        """All graphs."""
        return tuple(each for each in self if isinstance(each, Graph))


@lru_cache(maxsize=8)
def graphs_of(dae: Dae) -> Graphs:
    """Return the graphs of a model; cached, since they serve all motions.

    ModelError is raised for models other than kinematics with least slip and quasi-statics.
    """
    checks = tuple(check for check in dae.checks if isinstance(check, PlacedCheck))
    other = dae.standing is not None or len(dae.alg) < 3 or len(checks) < len(dae.checks)
    if other or (dae.rest.numel() and dae.linear is None):
        raise ModelError(
            "batch: expected a model of kinematics or quasi-statics, found another one; use "
            "method='simulate'"
        )
    blocks = dae.block_rows
    p, w, f = (dae.columns()[1][each] for each in blocks)
    late = [ca.depends_on(rate, f) for rate in ca.vertsplit(dae.quad)] if dae.quad.numel() else []
    kept = tuple(k for k, is_late in enumerate(late) if not is_late)
    linear = not ca.depends_on(ca.jacobian(dae.residuals[1], w), w)
    n_before = dae.columns()[2].numel() if linear and dae.lag is None else 0
    rows, state = state_of(dae, (p, w, f), len(kept), n_before)
    eliminate = elimination(dae, state, rows)
    quad = [dae.quad[k] for k in kept]
    distances, bounds = list[ca.SX](), list[int]()
    for k, limit in enumerate(dae.limits):
        for bound, sign in ((limit.lower, 1.0), (limit.upper, -1.0)):
            if np.isfinite(bound):
                distance = sign * (limit.expression - bound)
                distances.append(distance / dae.size_of(limit.label))
                bounds.append(k)
    scale = ca.DM(dae.scale)
    new_p, moved = _moved(dae, (p, w), quad, eliminate)
    # sums, since maxima would ignore what is not a number
    change = ca.norm_1((new_p - p) / scale[blocks[0]])
    forces = f
    if f.numel():
        forces = f - eliminate(ca.jacobian(dae.residuals[2], f), dae.residuals[2])
    doubt = _doubt(forces - f, ca.DM(dae.scale[blocks[2]]), distances, f)
    watched = ca.vertcat(forces, *_with([doubt, *distances], f, forces))
    (watched,) = _with([watched], w, moved[1])
    before = _with([moved[0]], state[rows.u], state[rows.v])[0] if n_before else ca.SX(0, 1)
    derivatives, rates, error, speed, watched, before = _with([*moved, watched, before], p, new_p)
    motion = derivatives, new_p, rates, change, error, speed
    n_f = f.numel()

    def graph(name: str, *results: ca.SX) -> Graph:
        return graph_of(dae, state, name, results)

    return Graphs(
        dae,
        rows,
        state,
        kept,
        graph("guess", *(dae.guess[each] for each in blocks), dae.rest),
        graph("place", new_p, change),
        graph("motion", *motion),
        graph("checked", *motion, watched[:n_f], watched[n_f], watched[n_f + 1 :], before),
        graph("slopes", derivatives[: rows.x.stop if n_before else 0]),
        tuple(bounds),
        graph("limits", pack(tuple(each.expression for each in dae.limits))),
        graph("outputs", pack(dae.y)),
        checks,
        {k: check for k, check in enumerate(checks) if isinstance(check, WheelCheck)},
        graph("placing", *(check.placing for check in checks)),
        linear,
    )


def state_of(
    dae: Dae, unknowns: tuple[ca.SX, ca.SX, ca.SX], quadratures: int = 0, inputs_before: int = 0
) -> tuple[StateRows, ca.SX]:
    """Return the rows of a state and its symbols; ``unknowns`` are ``p``, ``w`` and ``f``."""
    (x, _, u), (p, w, f) = dae.columns(), unknowns
    parameters = ca.vertcat(ca.SX(0, 1), *(each.symbol for each in dae.p))
    lag = ca.SX(0, 1) if dae.lag is None else dae.lag
    continuation = _continuation(dae)
    stage = ca.SX(0, 1) if continuation is None else continuation.symbol
    q, v = ca.SX.sym("q", quadratures), ca.SX.sym("v", inputs_before)
    columns = [x, p, q, w, f, u, v, parameters, stage, lag, dae.t]
    return StateRows(*consecutive(*(each.numel() for each in columns))), ca.vertcat(*columns)


def _continuation(dae: Dae) -> Continuation | None:
    """Return the continuation that jumps may need: that of laws without projection into discs."""
    return None if dae.discs else dae.continuation


def _moved(
    dae: Dae, unknowns: tuple[ca.SX, ca.SX], quad: list[ca.SX], eliminate: Solve
) -> tuple[ca.SX, tuple[ca.SX, ca.SX, ca.SX, ca.SX]]:
    """Return new positions; derivatives, rates, their residual and the speed at given positions.

    The positions follow the states as ``J p' = -d(closure)/dx x'``; integrated with the states,
    they are predicted so well that one Newton step corrects them at every stage.
    """
    p, w = unknowns
    x, closure = dae.columns()[0], dae.residuals[0]
    jacobian = ca.jacobian(closure, p)
    rates, error = _rates(dae, w, eliminate)
    ode, *quad = _with([dae.ode, *quad], w, rates)
    (leading,) = _with([dae.leading_rates], w, rates)
    k = leading.numel()
    drift = ca.jtimes(closure, ca.vertcat(x, p[:k]), ca.vertcat(ode, leading))
    follow = ca.vertcat(leading, -eliminate(jacobian[:, k:], drift))
    v_x, v_y, turn = (ode[k] for k in dae.state_rows("x", "y", "heading"))
    # a contact may be much faster than the platform, as under a wheel that is almost flat
    places = [k for k, label in enumerate(leaves(dae.labels.z[0])) if label.name == "contact_x"]
    fast = [ca.hypot(follow[k], follow[k + 1]) for k in places]
    speed = ca.mmax(ca.vertcat(ca.hypot(v_x, v_y) + dae.size * ca.fabs(turn), *fast))
    return p - eliminate(jacobian, closure), (ca.vertcat(ode, follow, *quad), rates, error, speed)


def _rates(dae: Dae, w: ca.SX, eliminate: Solve) -> tuple[ca.SX, ca.SX]:
    """Return the rates at given positions, and the sum of their errors.

    Linear equations are solved; the error is their relative residual. For others the result is one
    Newton step from ``w``, and the error the square of its length in typical sizes. Pairs of
    unknowns are then projected into the unit disc, as in the primal-dual Newton method for sums of
    norms (K. D. Andersen et al., SIAM J. Sci. Comput. 22 (2000)): without it the method fails where
    friction is used up at small slip. The projection changes nothing at a solution.
    """
    law = dae.residuals[1]
    matrix = ca.jacobian(law, w)
    if dae.linear is not None or not ca.depends_on(matrix, w):
        matrix, right = dae.linear or (matrix, -_with([law], w, ca.SX.zeros(w.shape))[0])
        rates = eliminate(matrix, right)
        if dae.lag is not None:  # a wheel in the air has almost no weight: pivots lose digits
            rates += eliminate(matrix, right - matrix @ rates)
        return rates, ca.norm_1(matrix @ rates - right) / (1 + ca.norm_1(rates))
    rates = w - eliminate(matrix, law)
    index = {symbol.element_hash(): k for k, symbol in enumerate(ca.vertsplit(w))}
    for pair in dae.discs:
        i, j = (index[symbol.element_hash()] for symbol in pair)
        size = ca.fmax(1, ca.hypot(rates[i], rates[j]))
        rates[i] /= size
        rates[j] /= size
    count = dae.alg[0].numel()
    step = (rates - w) / ca.DM(dae.scale)[count : count + w.numel()]
    if _continuation(dae) is not None:
        rates = w + (rates - w) * ca.fmin(1, MAX_STEP / ca.norm_inf(step))
    return rates, ca.norm_1(step) ** 2


def _doubt(step: ca.SX, scale: ca.DM, distances: list[ca.SX], f: ca.SX) -> ca.SX:
    """Return a number that is positive if the forces need another Newton step.

    The error after a step is about the square of the step, with forces in typical sizes. It matters
    if it exceeds the distance to a limit of a force.
    """
    if not f.numel():
        return ca.SX(-1)
    near = [each / ca.mmax(scale) for each in distances if ca.depends_on(each, f)]
    return ca.norm_1(step / scale) ** 2 - ca.mmin(ca.vertcat(*near, 1))


def _with(expressions: list[ca.SX], symbols: ca.SX, values: ca.SX) -> list[ca.SX]:
    return list(ca.substitute(expressions, [symbols], [values])) if symbols.numel() else expressions


def graph_of(dae: Dae, state: ca.SX, name: str, results: Sequence[ca.SX]) -> Graph:
    """Return the graph of expressions of a model; ``state`` is the column of all its symbols."""
    if _continuation(dae) is None:
        results = dae.without_continuation(results)
    column = ca.densify(ca.vertcat(*results))
    lookups = needed_lookups(dae.lookups, [column])
    inputs = [state, found_column(lookups)]
    return Graph(
        name,
        ca.Function(name, inputs, [column], {"cse": True}),
        lookups,
        tuple(
            ca.Function(f"{name}_{k}", inputs, [ca.densify(each.argument)])
            for k, each in enumerate(lookups)
        ),
        tuple(consecutive(*(each.numel() for each in results))),
    )


def elimination(dae: Dae, state: ca.SX, rows: StateRows) -> Solve:
    """Return a function that solves linear systems of expressions by elimination.

    A system has at least n equations for n unknowns; surplus equations are ignored.
    """
    samples = _sampled_states(dae, state, rows)

    def solve(matrix: ca.SX, right: ca.SX) -> ca.SX:
        """Return the solution as an expression, by elimination with the fewest operations.

        Pivots are chosen from the numbers of the samples; those on the diagonal of a symmetric
        matrix, if they are large enough.
        """
        (values,) = evaluate(dae.function("matrix", [state], [ca.densify(ca.vec(matrix))]), samples)
        (m, n), solution = matrix.shape, None
        numbers = values.T[np.isfinite(values).all(axis=0)].reshape(-1, n, m).transpose(0, 2, 1)
        with np.errstate(all="ignore"):
            # pivots on the diagonal of a symmetric matrix need half the operations; those of the
            # least-slip condition can be chosen there, since rates precede multipliers
            if m == n and np.allclose(numbers, numbers.transpose(0, 2, 1), rtol=1e-12, atol=0):
                solution = _eliminated(matrix, right, numbers.copy(), symmetric=True)
            if solution is None:
                solution = _eliminated(matrix, right, numbers, symmetric=False)
        if solution is None:
            raise ModelError("batch: expected equations with one solution, found dependent ones")
        return solution

    return solve


def _sampled_states(dae: Dae, state: ca.SX, rows: StateRows) -> Array:
    """Return states near rest, shape (n_rows, `SAMPLES`), at which pivots are chosen.

    The first state is level and at rest, the last ones are opposite to those before. Random numbers
    are those of the name of a variable, so that other variables do not change the pivots.
    """
    names = [symbol.name().encode() for symbol in ca.vertsplit(state)]
    size = JOINT_SPREAD, SAMPLES // 2
    half = np.array([np.random.default_rng([*name]).normal(0.0, *size) for name in names])
    samples = np.hstack([np.zeros((len(half), 1)), half, -half])
    for k, label in enumerate(leaves(dae.labels.x)):
        if label.name == "heading":
            samples[k] *= np.pi / JOINT_SPREAD
        elif label.name not in ("x", "y"):
            samples[k, ::2] = 0.0  # level, where entries may vanish
    guess = dae.function(
        "guess",
        [dae.columns()[0], ca.vertcat(*(each.symbol for each in dae.p))],
        [ca.densify(dae.guess), ca.densify(dae.rest)],
    )
    samples[rows.c] = np.reshape([each.value for each in dae.p], (-1, 1))
    _, rest = evaluate(guess, samples[rows.x], samples[rows.c])
    relaxing = slice(rows.x.stop - dae.rest.numel(), rows.x.stop)
    samples[relaxing] = rest + TILT_SPREAD * samples[relaxing]  # most wheels bear load
    continuation = _continuation(dae)
    if continuation is not None:
        samples[rows.stage] = continuation.values[0]
    guessed, _ = evaluate(guess, samples[rows.x], samples[rows.c])
    unknowns = [guessed[each] for each in consecutive(*(each.stop - each.start for each in rows.z))]
    samples[rows.p], samples[rows.f] = unknowns[0], unknowns[2]
    # apart from the ground, entries that vanish in contact would become pivots
    closure, placed = dae.residuals[0], samples.copy()
    jacobian = ca.densify(ca.jacobian(closure, state[rows.p]))
    newton = dae.function("closure", [state], [ca.densify(closure), jacobian])
    change = np.zeros(placed[rows.p].shape)
    for _ in range(PLACING_STEPS):
        placed[rows.p] -= change
        residual, slopes = evaluate(newton, placed)
        slopes = np.nan_to_num(dense(slopes, jacobian.sparsity()))
        change = (np.linalg.pinv(slopes) @ np.nan_to_num(residual.T)[..., None])[..., 0].T
        change /= np.maximum(1.0, np.abs(change).max(axis=0, initial=0.0) / (MAX_STEP * dae.size))
    is_placed = np.abs(change).max(axis=0, initial=0.0) < PLACED * dae.size
    if is_placed.any():
        chosen = np.resize(np.flatnonzero(is_placed), SAMPLES)
        samples, unknowns = placed[:, chosen], [each[:, chosen] for each in unknowns]
    # moving, under load: other unknowns than rates, such as depths, stay near their guess
    spread = [
        1.0 if label.unit.endswith("s-1") else GUESS_SPREAD * scale
        for label, scale in zip(leaves(dae.labels.z), dae.scale, strict=True)
    ]
    first = rows.p.stop - rows.p.start
    within = np.array(spread)[first : first + rows.w.stop - rows.w.start, None]
    samples[rows.w] = unknowns[1] + within * samples[rows.w]
    samples[rows.lag] = np.abs(samples[rows.lag])
    return samples


def _eliminated(matrix: ca.SX, right: ca.SX, numbers: Array, *, symmetric: bool) -> ca.SX | None:
    """Return the solution.

    ``numbers`` are values of the matrix (n_samples, m, n), changed here; ``symmetric`` chooses
    pivots on the diagonal. None if one of these is too small, or equations are dependent.
    """
    m, n = matrix.shape
    a = {(i, j): matrix[i, j] for i, j in zip(*matrix.sparsity().get_triplet(), strict=True)}
    b = ca.vertsplit(ca.densify(right))
    rows, columns, order = set(range(m)), set(range(n)), list[tuple[int, int]]()
    for _ in range(n):
        i, j, pivot = _pivot(a, numbers, rows, columns, symmetric=symmetric)
        if (i, j) not in a or (symmetric and pivot < MIN_PIVOT_ON_DIAGONAL):
            return None
        rows.remove(i)
        columns.remove(j)
        order.append((i, j))
        inverse = 1 / a[i, j]
        for k in rows:
            if (k, j) not in a:
                continue
            factor = a[k, j] * inverse
            numbers[:, k] -= (numbers[:, k, j] / numbers[:, i, j])[:, None] * numbers[:, i]
            b[k] = b[k] - factor * b[i]
            for c in columns:
                if (i, c) not in a or (symmetric and c < k):
                    continue
                a[k, c] = a[k, c] - factor * a[i, c] if (k, c) in a else -factor * a[i, c]
                if symmetric:
                    a[c, k] = a[k, c]
    solution = dict[int, ca.SX]()
    for i, j in reversed(order):
        total = b[i]
        for c, value in solution.items():
            if (i, c) in a:
                total = total - a[i, c] * value
        solution[j] = total / a[i, j]
    return ca.vertcat(*(solution[j] for j in range(n)))


def _pivot(
    a: dict[tuple[int, int], ca.SX],
    numbers: Array,
    rows: set[int],
    columns: set[int],
    *,
    symmetric: bool,
) -> tuple[int, int, float]:
    """Return the entry with the fewest new entries among those that are large in every sample.

    ``a`` are the entries that are not zero, ``numbers`` their values (n_samples, m, n), ``rows``
    and ``columns`` those that are left. The last result is the smallest value of the entry relative
    to its row.
    """
    r, c = sorted(rows), sorted(columns)
    left = np.abs(numbers[:, r][:, :, c])
    relative = (left / np.maximum(left.max(axis=2, keepdims=True), 1e-300)).min(axis=0)
    filled = np.array([[(i, j) in a for j in c] for i in r])
    relative = np.where(filled & np.isfinite(relative), relative, 0.0)
    if symmetric:
        relative *= np.eye(len(r))
    cost = np.outer(filled.sum(axis=1) - 1, filled.sum(axis=0) - 1).astype(float)
    allowed = relative >= min(MIN_PIVOT, relative.max())
    cost = np.where(allowed, cost - 0.5 * relative, np.inf)  # of equal ones, the largest
    i, j = np.unravel_index(int(cost.argmin()), cost.shape)
    return r[int(i)], c[int(j)], float(relative[i, j])
