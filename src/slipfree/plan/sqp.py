"""Sequential quadratic programming for a transcribed plan with fixed duration.

A step solves the quadratic program of the linearised rows and of the Hessian of the Lagrangian
function. At each collocation point, the linearised equations determine the algebraic unknowns and
roots from states and inputs; on each interval, the collocation equations determine the states from
those at its beginning and from the inputs. What remains has few unknowns per interval. The
multipliers of the eliminated equations follow from those of the small program, so that steps
converge as Newton's method does.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.linalg import LinAlgError
from scipy import sparse
from scipy.linalg.lapack import dgbsv

from slipfree.core.lookups import run_buffered
from slipfree.core.records import Array, Mask
from slipfree.plan.transcription import Index, Program, bounded_rates

Bounds = tuple[Array, Array]
BOUND_TOLERANCE = 1e-8  # of scaled unknowns and of rows in a quadratic program
QP_OPTIONS = {
    "error_on_fail": False,
    "max_iter": 50,  # active sets
    **dict.fromkeys(("print_time", "print_iter", "print_header", "print_info"), False),
}


class Step(NamedTuple):
    """Step of a program."""

    change: Array  # shape (n_w,): change of the scaled unknowns
    multipliers: Array  # shape (n_g,): multipliers of the rows after the step


class StageProgramSolver:
    """Solver of quadratic programs for the states and inputs at the ends of n intervals (nodes).

    The arguments are indices: ``nodes``, shape (n + 1, n_x + n_u), of the unknowns of the nodes,
    ``stages``, shape (n, n_q), of those of the stages, and ``rows``, shape (n, n_own), of the rows
    of the stages, of which the first n_x are equations for the states that follow.
    """

    def __init__(self, nodes: Index, stages: Index, rows: Index, n_x: int) -> None:
        n, n_own, n_nodes = *rows.shape, nodes.shape[1]
        follow = rows[:, :n_x], nodes[1:, :n_x]
        in_a = np.hstack([_pairs(rows[:, :, None], stages[:, None]), _pairs(*follow)])
        in_h = _pairs(stages[:, :, None], stages[:, None])
        a, self._in_a = _pattern(in_a, (rows.size, nodes.size))
        h, self._in_h = _pattern(in_h, (nodes.size, nodes.size))
        self._solver = ca.conic("step", "qrqp", {"h": h, "a": a}, QP_OPTIONS)
        self._pairs, self._n_rows, size = in_a, rows.size, rows.size + nodes.size
        # Ordered by time, at a node inputs before states, conditions of optimality have a narrow
        # band of coefficients.
        begins = (n_nodes + n_own) * np.arange(n + 1)[:, None]
        at_nodes = begins + (np.arange(n_nodes) - n_x) % n_nodes
        at_rows = begins[:-1] + n_nodes + np.arange(n_own)
        self._places = np.concatenate([at_rows.ravel(), at_nodes.ravel()])
        self._order = np.argsort(self._places)
        below, diagonal = np.stack([in_a[0], in_a[1] + rows.size]), [np.arange(size)] * 2
        self._of, self._to = np.hstack([below, below[::-1], in_h + rows.size, diagonal])
        self._is_diagonal = np.arange(self._of.size) >= self._of.size - size

    def solve(
        self, h: Array, gradient: Array, entries: Array, least: Array, most: Array
    ) -> tuple[Array, Array]:
        """Return unknowns and multipliers of the rows, or raise LinAlgError.

        ``h``, shape (n, n_q, n_q), are Hessians of the stages, and ``entries`` coefficients of the
        rows in the unknowns of their stages, then in the states that follow; ``least`` and ``most``
        are bounds of rows, then of unknowns.
        """
        # First without bounds, so that rows that are not equations have no multipliers.
        n_rows, is_equal = self._n_rows, least == most
        is_kept, is_given = is_equal.copy(), is_equal.copy()
        is_kept[n_rows:], is_given[:n_rows] = True, False
        numbers = (np.cumsum(is_kept[self._order]) - 1)[self._places]
        counted = is_kept[self._of] & is_kept[self._to] & (is_given[self._of] == self._is_diagonal)
        of, to = numbers[self._of[counted]], numbers[self._to[counted]]
        values = np.concatenate([entries, entries, h.ravel(), np.ones(is_equal.size)])[counted]
        width, size = int(np.abs(of - to).max()), int(is_kept.sum())
        where = (3 * width + 1) * to + 2 * width + of - to  # with the room that LAPACK needs
        band = np.bincount(where, values, (3 * width + 1) * size).reshape(size, -1).T
        right, free = np.empty(size), np.append(np.zeros(n_rows), -gradient)
        right[numbers[is_kept]] = np.where(is_equal, least, free)[is_kept]
        *_, found, failed = dgbsv(width, width, band, right, overwrite_ab=True, overwrite_b=True)
        if failed:
            raise LinAlgError("the quadratic program without bounds is singular")
        prices, solution = np.split(np.where(is_kept, found[numbers], 0.0), [n_rows])
        values = np.append(
            np.bincount(self._pairs[0], entries * solution[self._pairs[1]]), solution
        )
        if np.maximum(least - values, values - most).max() < BOUND_TOLERANCE:
            return solution, prices
        # Where limits are active, the solver needs stages that are convex.
        curvatures, vectors = np.linalg.eigh(h)
        h = vectors * np.maximum(curvatures, 0.0)[:, None] @ np.swapaxes(vectors, 1, 2)
        matrices = np.bincount(self._in_h, h.ravel()), np.bincount(self._in_a, entries)
        (low, lower), (high, upper) = (np.split(side, [n_rows]) for side in (least, most))
        given = matrices[0], gradient, matrices[1], low, high, lower, upper
        columns = {k: np.asarray(each, dtype=float)[:, None] for k, each in enumerate(given)}
        buffer = run_buffered(self._solver, columns, {0: solution, 2: prices})
        if not buffer.stats()["success"]:
            raise LinAlgError("the quadratic program is not solved")
        return solution, prices


class StepSolver:
    """Solver of the quadratic programs of a nonlinear program.

    The unknowns of an interval are, in this order: states at its beginning, inputs, inputs that
    follow, states at its points, algebraic unknowns and roots at its points. The first three are
    those of a stage of the quadratic program; the others are eliminated by the equations of the
    interval (condensing), and follow from the solution. An index of -1 stands for an unknown or a
    row that does not exist.
    """

    def __init__(self, program: Program) -> None:
        layout = program.layout
        n, degree, n_x = layout.states.shape
        n_u, n_rows = layout.inputs.shape[1], len(program.row_blocks[0].labels)
        inputs: Index = np.full((n + 1, n_u), -1)  # the last ones exist if they are continuous
        inputs[: len(layout.inputs)] = layout.inputs
        begin = np.vstack([layout.first, layout.states[:-1, -1]])
        later = np.concatenate([layout.unknowns, layout.roots], axis=2)
        outer = np.hstack([begin, inputs[:-1], inputs[1:], layout.states.reshape(n, -1)])
        own = np.hstack([outer, later.reshape(n, -1)])
        n_q, n_points = n_x + 2 * n_u, n_rows - len(bounded_rates(program.task))
        rows = n_rows * np.arange(n)[:, None] + np.arange(n_rows)
        at_points = rows[:, :n_points].reshape(n, degree, -1)
        equations, limits = np.split(at_points, [n_x + later.shape[2]], axis=2)
        goal: Index = np.full((n, program.g_lower.size - rows.size), -1)
        goal[-1] = np.arange(rows.size, program.g_lower.size)
        others = np.hstack([limits.reshape(n, -1), rows[:, n_points:], goal])
        bounded = (np.isfinite(program.lower) | np.isfinite(program.upper))[own[:, n_q:]]
        self._sizes, self._own, self._equations, self._others = (n_x, n_u), own, equations, others
        self._bounded = n_q + np.flatnonzero(bounded.any(axis=0))
        # All derivatives in one call, whose results follow each other in memory after a zero, which
        # is the entry of what does not exist.
        at, prices = [program.problem[name] for name in "xp"], ca.MX.sym("l", program.g_lower.size)
        of_rows = program.jacobian.call(at, True, False)
        of_cost = program.gradient.call(at, True, False)
        of_both = program.hessian.call([*at, 1.0, prices], True, False)
        results = [of_rows[1], of_rows[0], of_cost[1], *of_both]
        self._derivatives = ca.Function("derivatives", [*at, prices], results)
        begins = np.cumsum([1, *(each.nnz() for each in results)]).tolist()
        self._parts = [slice(*part) for part in pairwise(begins)]
        jacobian, hessian = of_rows[1].sparsity(), of_both[0].sparsity()
        columns = np.concatenate([later, np.repeat(outer[:, None], degree, axis=1)], axis=2)
        of_equations = _entries(jacobian, equations[..., None], columns[:, :, None])
        # The last column is for the residuals.
        self._of_equations = np.append(of_equations, begins[1] + equations[..., None], axis=3)
        self._of_others = _entries(jacobian, others[..., None], own[:, None])
        # Blocks of equations of a point determine their own unknowns one after the other.
        size = later.shape[2]
        is_full: Mask = np.asarray(of_equations[:, :, n_x:, :size].any(axis=(0, 1)))
        ends = {*np.cumsum([0, *map(len, program.task.dae.labels.alg)]).tolist(), size}
        self._ends = sorted(k for k in ends if k <= size and not is_full[:k, k:].any())
        # Unknowns and pairs of unknowns count on the first interval that contains them.
        counts = _first_occurrences(own) & (own >= 0)
        self._of_gradient = np.where(counts, begins[2] + own, 0)
        pairs = np.broadcast_arrays(own[:, :, None], own[:, None])
        entries = _entries(hessian, np.minimum(*pairs), np.maximum(*pairs))
        entries *= _first_occurrences(pairs[0] * (program.scale.size + 1) + pairs[1])
        interval, left, right = entries.nonzero()
        places = own.shape[1] * interval + left, own.shape[1] * interval + right
        self._hessian = sparse.csr_array((entries[entries > 0], places), (own.size, own.size))
        self._of_hessian = begins[3] - 1 + self._hessian.data
        nodes = np.arange((n + 1) * (n_x + n_u)).reshape(n + 1, -1)
        self._nodes, self._stages = nodes, np.hstack([nodes[:-1], nodes[1:, n_x:]])
        conditions = np.arange(n * (n_x + self._bounded.size + others.shape[1])).reshape(n, -1)
        self._solver = StageProgramSolver(nodes, self._stages, conditions, n_x)
        # indices of the bounds of rows and nodes among zero, those of unknowns, infinity, and those
        # of rows; zero for the equations and unknowns, infinity for the rows that do not exist
        first_row = program.scale.size + 2
        of_nodes: Index = np.full(nodes.shape, first_row - 1)
        of_nodes[0, :n_x], of_nodes[:, n_x:] = 1 + layout.first, 1 + inputs
        of_own, of_limits = 1 + own[:, self._bounded], first_row + others
        self._of_bounds = np.append(np.hstack([0 * own[:, :n_x], of_own, of_limits]), of_nodes)
        self._constant = np.tile(np.eye(n_q + 1), (n, 1, 1))

    def step(
        self, w: Array, p: Array, bounds: Bounds, row_bounds: Bounds, multipliers: Array
    ) -> Step:
        """Return the step from scaled unknowns.

        Parameters
        ----------
        w : ndarray, shape (n_w,)
            Unknowns of the program, divided by their scale, with the given states at the beginning
            and the given duration.
        p : ndarray, shape (n_p,)
            Parameters of the program: weights of the costs.
        bounds : tuple of ndarray, each of shape (n_w,)
            Smallest and largest values of the scaled unknowns.
        row_bounds : tuple of ndarray, each of shape (n_g,)
            Smallest and largest values of the rows.
        multipliers : ndarray, shape (n_g,)
            Multipliers of the rows, for the Hessian.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the program has no finite derivatives, or the quadratic program is not solved.
        """
        own, (n_x, n_u) = self._own, self._sizes
        n, n_q = len(own), n_x + 2 * n_u
        values = np.empty(self._parts[-1].stop)
        values[0] = 0.0
        results = {k: values[part] for k, part in enumerate(self._parts)}
        run_buffered(self._derivatives, dict(enumerate((w, p, multipliers))), results)
        if not np.isfinite(values.sum()):
            raise LinAlgError("the derivatives are not finite")
        self._hessian.data = values[self._of_hessian]
        # In matrices that map the unknowns of a stage, the last column is constant.
        rows = values[self._of_equations]
        motion, points = rows[:, :, :n_x], rows[:, :, n_x:]
        n_v = points.shape[2]
        of_points = inverse_by_blocks(points[..., :n_v], self._ends)
        later = -of_points @ points[..., n_v:]
        from_points = motion[..., :n_v]
        motion = (motion[..., n_v:] + from_points @ later).reshape(n, -1, later.shape[3])
        of_motion = np.linalg.inv(motion[:, :, n_q:-1])
        states = -of_motion @ np.concatenate([motion[..., :n_q], motion[..., -1:]], axis=2)
        outer = np.concatenate([self._constant[:, :-1], states, self._constant[:, -1:]], axis=1)
        n_o = outer.shape[1] - 1
        inner = (later @ outer[:, None]).reshape(n, -1, n_q + 1)
        whole = np.concatenate([outer[:, :-1], inner], axis=1)
        curved = (self._hessian @ whole.reshape(own.size, -1)).reshape(whole.shape)
        curvature = np.swapaxes(whole[..., :n_q], 1, 2) @ curved
        slopes = values[self._of_gradient]
        slope = (slopes[:, None] @ whole)[:, 0, :n_q] + curvature[..., n_q]
        of_others = values[self._of_others]
        others = of_others @ whole
        others[..., n_q] += np.append(values[self._parts[1]], 0.0)[self._others]
        conditions = np.concatenate([states[:, -n_x:], whole[:, self._bounded], others], axis=1)
        constant = np.append(conditions[..., n_q], np.zeros(self._nodes.size))
        sides = [
            np.concatenate([[0.0], side - w, [none], row_side])[self._of_bounds] - constant
            for side, row_side, none in zip(bounds, row_bounds, (-np.inf, np.inf), strict=True)
        ]
        entries = np.append(conditions[..., :n_q], np.full(n * n_x, -1.0))
        linear = np.asarray(np.bincount(self._stages.ravel(), slope.ravel()), dtype=float)
        solution, prices = self._solver.solve(curvature[..., :n_q], linear, entries, *sides)
        stages = np.column_stack([solution[self._stages], np.ones(n)])[..., None]
        change, found = np.zeros(w.size + 1), np.zeros(multipliers.size + 1)
        change[own] = (whole @ stages)[..., 0]
        # The Lagrangian function is stationary: from the last interval back, for states and points.
        of_bounds, of_rows = np.split(prices.reshape(n, -1)[:, n_x:], [self._bounded.size], axis=1)
        pulls = slopes + (of_rows[:, None] @ of_others)[:, 0] + (curved @ stages)[..., 0]
        pulls[:, self._bounded] += of_bounds
        along, price = (pulls[:, None] @ whole)[:, 0], np.zeros(n_x)
        for k in reversed(range(n)):
            pulls[k, n_o - n_x : n_o] += price
            price = along[k, :n_x] + price @ states[k, -n_x:, :n_x]
        at_points = pulls[:, n_o:].reshape(n, -1, 1, n_v)
        at_states = pulls[:, n_q:n_o] + (at_points @ later)[:, :, 0, n_q:-1].sum(axis=1)
        of_states = -(at_states[:, None] @ of_motion).reshape(n, -1, 1, n_x)
        of_algebraic = -(at_points + of_states @ from_points) @ of_points
        found[self._equations] = np.concatenate([of_states, of_algebraic], axis=3)[:, :, 0]
        found[self._others] = of_rows
        return Step(change[:-1], found[:-1])


def _entries(sparsity: ca.Sparsity, rows: Index, columns: Index) -> Index:
    """Return the numbers of nonzeros of a matrix, from 1; zero where it has none."""
    pointers, inside = sparsity.get_ccs()
    shape = sparsity.size1() + 1, sparsity.size2() + 1  # index -1: an empty row or column
    numbers = np.arange(1, len(inside) + 1)
    matrix = sparse.csc_array((numbers, inside, [*pointers, len(inside)]), shape)
    rows, columns = np.broadcast_arrays(rows, columns)
    found = matrix[rows.ravel(), columns.ravel()] if rows.size else np.zeros(0)
    return np.asarray(found, dtype=np.intp).reshape(rows.shape)


def _first_occurrences(values: Index) -> Mask:
    """Return where values occur for the first time."""
    first = np.zeros(values.size, dtype=bool)
    first[np.unique(values, return_index=True)[1]] = True
    return first.reshape(values.shape)


def _pairs(rows: Index, columns: Index) -> Index:
    """Return the pairs of indices that are broadcast together, shape (2, n)."""
    return np.stack(np.broadcast_arrays(rows, columns)).reshape(2, -1)


def _pattern(pairs: Index, shape: tuple[int, int]) -> tuple[ca.Sparsity, Index]:
    """Return the sparsity of a matrix that sums entries, and the number of each one's nonzero."""
    keys, numbers = np.unique(pairs[1] * shape[0] + pairs[0], return_inverse=True)
    places = (keys % shape[0]).tolist(), (keys // shape[0]).tolist()
    return ca.Sparsity.triplet(*shape, *places), numbers


def inverse_by_blocks(matrices: Array, ends: list[int]) -> Array:
    """Return inverses of matrices, shape (..., m, m), whose blocks above the diagonal are zero.

    ``ends`` are the ends of the blocks, from 0 to m.
    """
    found = np.zeros(matrices.shape)
    for a, b in pairwise(ends):
        own = found[..., a:b, a:b] = np.linalg.inv(matrices[..., a:b, a:b])
        found[..., a:b, :a] = -own @ (matrices[..., a:b, :a] @ found[..., :a, :a])
    return found
