"""Sequential quadratic programming for a transcribed plan with fixed duration.

A step solves the quadratic program of the linearised rows and of the Hessian of the Lagrangian
function. At each collocation point, the linearised equations determine the algebraic unknowns and
roots from states and inputs; on each interval, the collocation equations determine the states from
those at its beginning and from the inputs. What remains has few unknowns per interval. The
multipliers of the eliminated equations follow from those of the small program, so that steps
converge as Newton's method does.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np
from scipy import sparse

from slipfree.core.lookups import evaluate, run_buffered
from slipfree.core.records import Array, Mask
from slipfree.plan.transcription import Index, Program, bounded_rates

Bounds = tuple[Array, Array]
MAX_ACTIVE_SETS = 50  # of a quadratic program
QP_OPTIONS = {
    "error_on_fail": False,
    **dict.fromkeys(("print_time", "print_iter", "print_header", "print_info"), False),
}


class Step(NamedTuple):
    """Step of a program."""

    change: Array  # shape (n_w,): change of the scaled unknowns
    multipliers: Array  # shape (n_g,): multipliers of the rows after the step


class StepSolver:
    """Solver of the quadratic programs of a nonlinear program.

    The unknowns of an interval are, in this order: states at its beginning, inputs, inputs that
    follow, states at its points, algebraic unknowns and roots at its points. The first three are
    those of a stage of the quadratic program. An index of -1 stands for an unknown or a row that
    does not exist.
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
        self._program, self._sizes, self._inputs = program, (n_x, n_u), inputs
        self._own, self._equations, self._others = own, equations, others
        self._bounded = n_q + np.flatnonzero(bounded.any(axis=0))
        jacobian, hessian = program.jacobian.sparsity_out(1), program.hessian.sparsity_out(0)
        columns = np.concatenate([later, np.repeat(outer[:, None], degree, axis=1)], axis=2)
        self._of_equations = _entries(jacobian, equations[..., None], columns[:, :, None])
        self._of_others = _entries(jacobian, others[..., None], own[:, None])
        # Unknowns and pairs of unknowns count on the first interval that contains them.
        self._counts = _first_occurrences(own)
        pairs = np.broadcast_arrays(own[:, :, None], own[:, None])
        entries = _entries(hessian, np.minimum(*pairs), np.maximum(*pairs))
        entries *= _first_occurrences(pairs[0] * (program.scale.size + 1) + pairs[1])
        interval, left, right = entries.nonzero()
        places = own.shape[1] * interval + left, own.shape[1] * interval + right
        self._hessian = sparse.csr_array((entries[entries > 0], places), (own.size, own.size))
        nodes = np.arange((n + 1) * (n_x + n_u)).reshape(n + 1, -1)
        self._nodes, self._stages = nodes, np.hstack([nodes[:-1], nodes[1:, n_x:]])
        count = n_x + self._bounded.size + others.shape[1]
        conditions = np.arange(n * count).reshape(n, -1)
        blocks = [
            (conditions[:, :, None], self._stages[:, None]),
            (conditions[:, :n_x], nodes[1:, :n_x]),
        ]
        a, self._in_a = _pattern(blocks, (conditions.size, nodes.size))
        blocks = [(self._stages[:, :, None], self._stages[:, None])]
        h, self._in_h = _pattern(blocks, (nodes.size, nodes.size))
        self._solvers = [
            ca.conic("step", "qrqp", {"h": h, "a": a}, QP_OPTIONS | {"max_iter": most})
            for most in (1, MAX_ACTIVE_SETS)
        ]

    def step(
        self, w: Array, p: Array, bounds: Bounds, row_bounds: Bounds, multipliers: Array
    ) -> Step | None:
        """Return the step from scaled unknowns, or None if the quadratic program is not solved.

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
        """
        program, own, (n_x, n_u) = self._program, self._own, self._sizes
        at, n, n_q = (w[:, None], p[:, None]), len(own), n_x + 2 * n_u
        g, jacobian = (each.ravel() for each in evaluate(program.jacobian, *at))
        gradient = evaluate(program.gradient, *at)[1].ravel()
        of_hessian = np.ones((1, 1)), multipliers[:, None]
        second = evaluate(program.hessian, *at, *of_hessian)[0].ravel()
        if not all(np.isfinite(each).all() for each in (g, jacobian, gradient, second)):
            return None
        jacobian, structure = np.append(0.0, jacobian), self._hessian
        second = second[structure.data - 1]
        hessian = sparse.csr_array((second, structure.indices, structure.indptr), structure.shape)
        # In matrices that map the unknowns of a stage, the last column is constant.
        residuals = g[self._equations][..., None]
        rows = np.concatenate([jacobian[self._of_equations], residuals], axis=3)
        motion, points = rows[:, :, :n_x], rows[:, :, n_x:]
        n_v = points.shape[2]
        try:
            of_points = np.linalg.inv(points[..., :n_v])
            later = -of_points @ points[..., n_v:]
            from_points = motion[..., :n_v]
            motion = motion[..., n_v:] + from_points @ later
            motion = motion.reshape(n, -1, motion.shape[3])
            of_motion = np.linalg.inv(motion[:, :, n_q:-1])
        except np.linalg.LinAlgError:
            return None
        states = -of_motion @ np.delete(motion, np.s_[n_q:-1], axis=2)
        same = np.tile(np.eye(n_q + 1), (n, 1, 1))
        outer = np.concatenate([same[:, :-1], states, same[:, -1:]], axis=1)
        n_o = outer.shape[1] - 1
        inner = (later @ outer[:, None]).reshape(n, -1, n_q + 1)
        whole = np.concatenate([outer[:, :-1], inner], axis=1)
        curved = (hessian @ whole.reshape(own.size, -1)).reshape(whole.shape)
        curvature = np.swapaxes(whole[..., :n_q], 1, 2) @ curved
        slopes = np.where(self._counts, np.append(gradient, 0.0)[own], 0.0)
        slope = (slopes[:, None] @ whole)[:, 0, :n_q] + curvature[..., n_q]
        of_others = jacobian[self._of_others]
        others = of_others @ whole
        others[..., n_q] += np.append(g, 0.0)[self._others]
        conditions = np.concatenate([states[:, -n_x:], whole[:, self._bounded], others], axis=1)
        sides = []
        for side, row_side, none in zip(bounds, row_bounds, (-np.inf, np.inf), strict=True):
            apart = np.append(side - w, 0.0)
            limits = apart[own[:, self._bounded]], np.append(row_side, none)[self._others]
            of_rows = np.hstack([np.zeros((n, n_x)), *limits]) - conditions[..., n_q]
            of_unknowns = np.full(self._nodes.shape, none)
            of_unknowns[0, :n_x], of_unknowns[:, n_x:] = apart[own[0, :n_x]], apart[self._inputs]
            sides.append((of_rows.ravel(), of_unknowns.ravel()))
        (low, least), (high, most) = sides
        entries = np.append(conditions[..., :n_q], np.full(n * n_x, -1.0))
        linear = np.bincount(self._stages.ravel(), slope.ravel(), least.size)
        solution, prices = np.empty(least.size), np.empty(low.size)

        quadratic = curvature[..., :n_q]
        for solver in self._solvers:
            matrices = np.bincount(self._in_h, quadratic.ravel()), np.bincount(self._in_a, entries)
            given = matrices[0], linear, matrices[1], low, high, least, most
            columns = {k: each[:, None] for k, each in enumerate(given)}
            buffer = run_buffered(solver, columns, {0: solution, 2: prices})
            if buffer.stats()["success"]:
                break
            # Where limits are active, the solver needs stages that are convex.
            values, vectors = np.linalg.eigh(quadratic)
            quadratic = vectors * np.maximum(values, 0.0)[:, None] @ np.swapaxes(vectors, 1, 2)
        else:
            return None
        stages = np.column_stack([solution[self._stages], np.ones(n)])
        steps = (whole @ stages[..., None])[..., 0]
        change, found = np.zeros(w.size + 1), np.zeros(g.size + 1)
        change[own] = steps
        # The Lagrangian function is stationary: from the last interval back, for states and points.
        of_bounds, of_rows = np.split(prices.reshape(n, -1)[:, n_x:], [self._bounded.size], axis=1)
        pulls = slopes + (of_rows[:, None] @ of_others)[:, 0]
        pulls[:, self._bounded] += of_bounds
        pulls += (hessian @ steps.ravel()).reshape(steps.shape)
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


def _pattern(
    blocks: list[tuple[Index, Index]], shape: tuple[int, int]
) -> tuple[ca.Sparsity, Index]:
    """Return the sparsity of a sum of dense blocks, and the number of each entry's nonzero."""
    pairs = [np.broadcast_arrays(*block) for block in blocks]
    rows, columns = (np.concatenate([each[k].ravel() for each in pairs]) for k in range(2))
    keys, numbers = np.unique(columns * shape[0] + rows, return_inverse=True)
    places = (keys % shape[0]).tolist(), (keys // shape[0]).tolist()
    return ca.Sparsity.triplet(*shape, *places), numbers
