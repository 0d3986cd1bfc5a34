"""Least coefficient of friction that holds a vehicle, enclosed by certified bounds.

At rest, contact forces ``f_i`` balance the load ``q`` of gravity and springs, ``A' f + q = 0``,
with the derivatives ``A`` of the slip velocities by the free rates. Wanted is the smallest
``sigma`` with ``|tangential f_i| <= sigma m_i normal f_i`` for all wheels, whose relative
coefficients are ``m_i``. For a given ``sigma``, the analytic centre of such forces is dual to the
minimum over virtual rates ``y`` of the convex function

    ``psi(y) = -q.y - 1/2 sum log D_i``, with ``s = A y`` and
    ``D_i = (normal s_i)^2 - sigma^2 |tangential s_i|^2``.

Its Hessian is positive definite, of the number of the rates, and needs no pivots. A level of
``sigma`` is followed by lower ones, with a predictor along the path of centres.

- The forces of a Newton step are in equilibrium exactly, centred or not: their largest ratio of
  tangential to normal force is an upper bound.
- Rates with ``q.y = 0`` and all normal slips positive give the lower bound
  ``min (normal s_i) / |tangential s_i|``, by the kinematic theorem of limit analysis. Rates inside
  the cone of a level on which the load does work prove that no forces exist at that level.
"""

from __future__ import annotations

from functools import reduce
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.batch.evaluator import EvaluatorOf
from slipfree.batch.graph import Graph
from slipfree.core.records import Array, consecutive
from slipfree.models.force_distribution import least_utilisation

STEPS = 8, 4, 12  # each for the intervals that are still wide
ROUNDING = 1e-15
MIN_RESISTANCE = 1e-10  # smallest square of a resistance to sliding, relative to the largest
FIRST_FACTOR, LOAD_STEPS = 1.5, 16  # for given normal forces
FIRST_LEVEL = 1.5  # largest coefficient at which the search starts
START_SHARE = 0.7  # of the coefficient at which the first rates leave their cone
LEVEL_SHARE = 0.1  # next level, from a bound towards the last level
SMALLEST_LEVEL = 1e-3
RELATIVE_GAP, GAP_OFFSET = 1e-4, 0.05  # least distance of a level from the lower bound
PATH_STEP = 10.0  # largest ratio of distances of levels from the lower bound in a prediction
CONE_STEP = 0.7  # of the way to the boundary of the cone
WORKING = 1e-9  # power of the load below which it does not hold the rates back, relative
DECREMENT_OF_BOUND, DECREMENT = 1e3, 1e6  # largest squares of Newton decrements
CROSSING = 1e-9  # of the bounds by rounding
UNKNOWN = 1e9  # upper bound before forces are found
FALLS = (0.0, 0.5, 1.0)  # shares of the way to the lower bound at which forces are tried
TINY = 1e-300


class FrictionGraphs(NamedTuple):
    """Graphs of the search: functions of a column of all rows, to its rows from ``rates`` on."""

    pattern: ca.Sparsity
    start: Graph
    step: Graph


class Terms(NamedTuple):
    """Entries of ``A``, loads, and friction of the wheels, with a column for each pose."""

    slopes: Array
    load: Array
    friction: Array


class SearchRows(NamedTuple):
    """Rows of a search: entries of ``A``, load, virtual rates, level and bounds, best forces."""

    slopes: slice
    load: slice
    rates: slice
    level: slice
    low: slice
    high: slice
    decrement: slice
    forces: slice


def rows_of(pattern: ca.Sparsity) -> SearchRows:
    """Return the rows for a matrix ``A`` of a given pattern, shape (3 n_wheels, n_rates)."""
    m, n = pattern.shape
    return SearchRows(*consecutive(pattern.nnz(), n, n, 1, 1, 1, 1, m))


def friction_graphs(pattern: ca.Sparsity) -> FrictionGraphs:
    """Return the graphs of the search for a matrix ``A`` of a given pattern."""
    rows = rows_of(pattern)
    column = ca.SX.sym("column", rows.forces.stop)
    wheels, load = _Wheels(column, rows, pattern), column[rows.load]
    # the start: a translation along the mean normal of the wheels
    normal = reduce(ca.plus, (block[2, :3].T for block in wheels.blocks))
    y = ca.vertcat(normal / ca.norm_2(normal), ca.SX.zeros(load.numel() - 3))
    y = ca.densify(y * (wheels.count / -ca.dot(load, y)))
    steepest = reduce(ca.fmax, (_tangential(s) / s[2] ** 2 for s in wheels.slips(y)))
    level = ca.fmin(FIRST_LEVEL, START_SHARE / ca.sqrt(steepest + 1e-12))
    start = ca.vertcat(y, level, 0, UNKNOWN, 0, ca.SX.zeros(3 * wheels.count))
    graphs = [
        Graph(name, ca.Function(name, [column, ca.SX(0, 1)], [result], {"cse": True}), (), (), ())
        for name, result in (("start", start), ("step", _newton_step(column, rows, pattern)))
    ]
    return FrictionGraphs(pattern, *graphs)


class _Wheels:
    """Slips of the wheels as functions of the virtual rates."""

    def __init__(self, column: ca.SX, rows: SearchRows, pattern: ca.Sparsity) -> None:
        matrix = ca.SX(pattern, column[rows.slopes])
        self.count = pattern.shape[0] // 3
        self.blocks = [matrix[3 * i : 3 * i + 3, :] for i in range(self.count)]

    def slips(self, y: ca.SX) -> list[ca.SX]:
        """Return the slip of each wheel along, across and normal."""
        return [ca.densify(block @ y) for block in self.blocks]

    def power(self, forces: list[ca.SX]) -> ca.SX:
        """Return the generalised forces ``A' f``."""
        terms = (block.T @ force for block, force in zip(self.blocks, forces, strict=True))
        return ca.densify(reduce(ca.plus, terms))


def _newton_step(column: ca.SX, rows: SearchRows, pattern: ca.Sparsity) -> ca.SX:
    """Return the rows from ``rates`` on after a Newton step for ``psi`` of the module.

    The step is taken at the present level of ``sigma``; then the rates are predicted at the next,
    lower level. Bounds are improved by the rates and forces on the way.
    """
    wheels, load = _Wheels(column, rows, pattern), column[rows.load]
    level, low, high = (column[each] for each in (rows.level, rows.low, rows.high))
    y = column[rows.rates]
    y *= wheels.count / ca.fmax(-ca.dot(load, y), 1e-12)  # least psi along the ray: -q.y = count
    slips = wheels.slips(y)
    cones = [_Cone(s, level) for s in slips]
    forces, tangents = [cone.force for cone in cones], [cone.tangent for cone in cones]
    gradient = load + wheels.power(forces)
    hessian = reduce(
        ca.plus, (b.T @ cone.matrix @ b for b, cone in zip(wheels.blocks, cones, strict=True))
    )
    right = ca.horzcat(gradient, wheels.power(tangents))
    newton, path = ca.horzsplit(ca.ldl_solve(right, *ca.ldl(hessian, False)))
    decrement = ca.dot(gradient, newton)
    # lower bound: rates without power of the load
    rates = -path
    rates += (ca.dot(load, rates) / wheels.count) * y
    squared_bound, least = ca.SX(UNKNOWN), ca.SX(UNKNOWN)
    for s in wheels.slips(rates):
        squared_bound = ca.fmin(squared_bound, s[2] ** 2 / (_tangential(s) + TINY))
        least = ca.fmin(least, s[2])
    valid = ca.logic_and(least > 0, decrement < DECREMENT_OF_BOUND)
    low = ca.fmax(low, ca.if_else(valid, ca.sqrt(squared_bound), 0))
    height, best = level - low, column[rows.forces]
    # upper bound: forces of the Newton step, and of steps along the path
    steps = zip(cones, wheels.slips(newton), wheels.slips(path), strict=True)
    at = [(c.force - c.along(one), c.tangent - c.along(two)) for c, one, two in steps]
    for fall in FALLS:
        forces = [f - fall * height * by_level for f, by_level in at]
        used, valid = ca.SX(0), ca.SX(1)
        for f in forces:  # fmax drops NaN; comparisons with it are false
            squared = _tangential(f) / f[2] ** 2
            valid = ca.logic_and(valid, ca.logic_and(f[2] > 0, squared < UNKNOWN**2))
            used = ca.fmax(used, squared)
        bound = ca.if_else(valid, ca.sqrt(used), UNKNOWN)
        best = ca.if_else(bound < high, ca.vertcat(*forces), best)
        high = ca.fmin(high, bound)
    # the next level: above a known upper bound, at which forces surely exist
    above = high + LEVEL_SHARE * ca.fmin(high - low, ca.fmax(level - high, 0))
    lowest = ca.fmax(SMALLEST_LEVEL, low + RELATIVE_GAP * (low + GAP_OFFSET))
    above = ca.fmax(ca.fmax(above, low + LEVEL_SHARE * (level - low)), lowest)
    following = ca.fmin(level, above)
    stretch = ca.fmin(ca.fmax(height / ca.fmax(following - low, 1e-12), 1), PATH_STEP)
    move = newton - path * (height * (stretch - 1))
    moved = y + _length_inside(wheels, slips, move, following) * move
    alive = ca.logic_and(low < level, decrement < DECREMENT)
    holds = -ca.dot(load, moved) > WORKING * ca.fabs(ca.dot(load, y))
    goes = ca.logic_and(alive, holds)
    fails = ca.logic_and(alive, ca.logic_not(holds))  # no forces exist at the following level
    return ca.vertcat(
        ca.if_else(goes, moved, y),
        ca.if_else(goes, following, level),
        ca.if_else(fails, ca.fmax(low, following), low),
        high,
        decrement,
        best,
    )


class _Cone:
    """Force of a wheel at slips inside its cone, and its derivatives."""

    def __init__(self, slip: ca.SX, level: ca.SX) -> None:
        square = level**2
        self.inverse = 1 / (slip[2] ** 2 - square * _tangential(slip))
        self.signs = ca.vertcat(-square, -square, 1)
        self.force = self.signs * slip * self.inverse
        growth = 2 * level * _tangential(slip) * self.inverse
        by_level = ca.vertcat(-2 * level * slip[:2], 0) * self.inverse
        self.tangent = by_level + self.force * growth  # derivative by the level
        outer = 2 * self.force @ self.force.T
        self.matrix = outer - ca.diag(self.signs * self.inverse)

    def along(self, move: ca.SX) -> ca.SX:
        """Return ``matrix @ move``."""
        return 2 * self.force * ca.dot(self.force, move) - self.signs * self.inverse * move


def _tangential(slip: ca.SX) -> ca.SX:
    return slip[0] ** 2 + slip[1] ** 2


def _length_inside(wheels: _Wheels, slips: list[ca.SX], move: ca.SX, level: ca.SX) -> ca.SX:
    """Return the largest step, at most 1, that stays within `CONE_STEP` of the cones of a level."""
    length, square = ca.SX(1), level**2
    for s, d in zip(slips, wheels.slips(move), strict=True):
        a = d[2] ** 2 - square * _tangential(d)
        b = s[2] * d[2] - square * (s[0] * d[0] + s[1] * d[1])
        c = s[2] ** 2 - square * _tangential(s)
        discriminant = b * b - a * c
        below = ca.sqrt(ca.fmax(discriminant, 0)) - b
        leaves = ca.logic_and(discriminant > 0, below > 0)
        length = ca.fmin(length, ca.if_else(leaves, CONE_STEP * c / ca.fmax(below, TINY), 1))
    return length


class FrictionBounds(NamedTuple):
    """Bounds of the least friction, shape (n,).

    No forces hold the vehicle below ``low``; forces were found at ``high``, which is infinite
    otherwise. [1]
    """

    low: Array
    high: Array


def least_friction(
    evaluate: EvaluatorOf[Any], graphs: FrictionGraphs, terms: Terms, tolerance: float
) -> FrictionBounds:
    """Return bounds of the least factor of the wheels' friction that holds the vehicle.

    Intervals wider than a tolerance take further `STEPS`; those that remain wider are computed by
    `least_utilisation`. Others take none: at the optimum, rounding lets the bounds cross.
    """
    rows, pattern = rows_of(graphs.pattern), graphs.pattern
    tangential = np.array(pattern.row()) % 3 < 2
    wheel = np.array(pattern.row()) // 3
    column = np.zeros((rows.forces.stop, terms.load.shape[1]))
    column[rows.slopes] = terms.slopes * np.where(tangential[:, None], terms.friction[wheel], 1.0)
    column[rows.load] = terms.load
    column[rows.rates.start :] = evaluate(graphs.start, column)
    wide = np.arange(column.shape[1])
    for count in STEPS:
        if not wide.size:
            break
        part = column[:, wide]
        for _ in range(count):
            part[rows.rates.start :] = evaluate(graphs.step, part)
        column[:, wide] = part
        low, high = column[rows.low][0], column[rows.high][0]
        # bounds that cross have lost digits, where the forces are near the borders of their cones
        wide = np.flatnonzero(~((high - low <= tolerance) & (low - high <= CROSSING)))
    high[high >= UNKNOWN] = np.inf
    low, high = np.nan_to_num(low, nan=0.0), np.nan_to_num(high, nan=np.inf)
    wide = wide[np.isfinite(column[rows.slopes][:, wide]).all(axis=0) & (low[wide] < FIRST_LEVEL)]
    if wide.size:
        matrix = np.zeros((wide.size, *pattern.shape))
        matrix[:, pattern.row(), pattern.get_col()] = terms.slopes[:, wide].T
        load, friction = terms.load[:, wide].T, terms.friction[:, wide].T
        exact = least_utilisation(matrix.swapaxes(1, 2), load, friction).utilisation
        known = ~np.isnan(exact)
        low[wide[known]] = high[wide[known]] = exact[known]
    return FrictionBounds(low, high)


def least_friction_of_loads(terms: Terms, tolerance: float) -> FrictionBounds:
    """Return bounds of the least factor of the friction limits for given normal forces.

    Tangential forces ``f_i = limit_i v_i`` balance the load, ``C' v + load = 0``; wanted is the
    smallest largest ``|v_i|``. For a factor ``sigma``, the centre ``v(y)`` maximises the sum of
    ``log(sigma^2 - |v_i|^2)``; it is a function of ``s = C y`` alone. Forces of a Newton step for
    ``y`` balance the load exactly and give an upper bound; ``load.y / sum |s_i|`` is a lower bound
    for every ``y``.
    ``terms`` are all entries of the matrix of the slips along and across, column by column; loads;
    and friction limits over the weight. Intervals below ``tolerance`` need no further steps.
    """
    load, limit = terms.load.T, terms.friction.T
    n, k = load.shape
    columns = terms.slopes.reshape(k, limit.shape[1], 2, n)
    c = columns.transpose(3, 1, 2, 0) * limit[:, :, None, None]
    square = np.einsum("nikw,nikv->nwv", c, c)
    interval = FrictionBounds(np.zeros(n), np.full(n, np.inf))
    wide = np.flatnonzero(np.isfinite(square).all(axis=(1, 2)) & np.isfinite(load).all(axis=1))
    sizes = np.linalg.eigvalsh(square[wide])
    # a rate that no wheel under load resists is not balanced by any forces
    wide = wide[sizes[:, 0] > MIN_RESISTANCE * sizes[:, -1]]
    first = np.einsum("nikw,nw->nik", c[wide], _solved(square[wide], load[wide]))
    interval.high[wide] = _largest(first)  # of least norm
    y, level = np.zeros((n, k)), FIRST_FACTOR * interval.high + SMALLEST_LEVEL
    for _ in range(LOAD_STEPS):
        low, high = (bound[wide] for bound in interval)
        y[wide], level[wide], *bounds = _load_step(
            c[wide], load[wide], y[wide], level[wide], low, high
        )
        for bound, new in zip(interval, bounds, strict=True):
            bound[wide] = new
        wide = wide[~(interval.high[wide] - interval.low[wide] <= tolerance)]
        if not wide.size:
            break
    interval.high[np.isnan(interval.high)] = np.inf
    return interval


def _load_step(
    c: Array, load: Array, y: Array, level: Array, low: Array, high: Array
) -> tuple[Array, Array, Array, Array]:
    """Return virtual rates, level and bounds after a Newton step and one along the path.

    ``c`` are the slips of virtual rates, times the friction limits, shape (n, n_wheels, 2,
    n_rates); ``load`` and the virtual rates ``y`` have the shape (n, n_rates). ``level`` is the
    factor sigma of `least_friction_of_loads`, ``low`` and ``high`` are its bounds so far.
    """
    s = np.einsum("nikw,nw->nik", c, y)
    size, sigma = (s**2).sum(axis=-1), level[:, None]
    root = np.sqrt(1 + 4 * sigma**2 * size)
    gain = 2 * sigma**2 / (1 + root)  # v = -gain s
    bend = -4 * sigma**4 / (root * (1 + root) ** 2)  # derivative of the gain by the size
    slope = gain[..., None, None] * np.eye(2)
    slope = slope + 2 * bend[..., None, None] * s[..., :, None] * s[..., None, :]
    reach = np.matmul(slope, c)
    hessian = np.einsum("nikw,nikv->nwv", c, reach)
    trace = np.trace(hessian, axis1=1, axis2=2)[:, None, None]
    hessian += (ROUNDING * trace + TINY) * np.eye(y.shape[1])
    residual = load - np.einsum("nikw,nik->nw", c, gain[..., None] * s)
    by_level = (gain * (2 / sigma - 4 * sigma * size / (root * (1 + root))))[..., None] * s
    newton = _solved(hessian, residual)
    path = -_solved(hessian, np.einsum("nikw,nik->nw", c, by_level))
    for rates in (y, y + newton, -path):
        slips = np.linalg.norm(np.einsum("nikw,nw->nik", c, rates), axis=-1)
        low = np.fmax(low, (load * rates).sum(axis=-1) / (slips.sum(axis=-1) + TINY))
    centre = -gain[..., None] * s - np.einsum("nikw,nw->nik", reach, newton)
    drift = by_level + np.einsum("nikw,nw->nik", reach, path)
    for fall in FALLS:
        high = np.fmin(high, _largest(centre + (fall * (level - low))[:, None, None] * drift))
    following = np.fmax(high + LEVEL_SHARE * (high - low), low + LEVEL_SHARE * (level - low))
    following = np.fmin(level, following)
    ratio = np.clip((level - low) / np.fmax(following - low, 1e-12), 1, PATH_STEP)
    damping = 1 + np.sqrt(np.fmax((residual * newton).sum(axis=-1), 0))
    move = newton / damping[:, None] - path * ((level - low) * (ratio - 1))[:, None]
    return y + move, following, low, high


def _solved(matrix: Array, right: Array) -> Array:
    return np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0])


def _largest(forces: Array) -> Array:
    return np.asarray(np.linalg.norm(forces, axis=-1).max(axis=-1))
