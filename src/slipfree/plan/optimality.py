"""Check the second-order sufficient conditions of optimality at the solution of a program.

A solution is a strict local minimum if the Hessian of the Lagrangian is positive definite on the
null space of the active constraints (Nocedal and Wright, Numerical Optimization, 2nd ed., theorem
12.6). The inverse of the KKT matrix contains the inverse of this reduced Hessian. Since inputs and
duration determine the motion, the block of the inverse for them has the same numbers of positive
and negative eigenvalues as the reduced Hessian. The Lanczos method computes its extreme eigenvalues
from a sparse factorisation of the KKT matrix.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import casadi as ca
import numpy as np
import scipy

from slipfree.core.records import Array, Mask, field_overview
from slipfree.plan.ipopt import IPOPT_TOLERANCE, Solution
from slipfree.plan.transcription import Program

WEAK = float(
    np.sqrt(IPOPT_TOLERANCE)
)  # largest distance and relative multiplier of a weakly active bound
REGULARISATION = 1e-12  # of the KKT matrix, for dependent constraints
LANCZOS_STEPS = 40  # number of Lanczos steps for the extreme eigenvalues
ROUNDING = 1e-10  # eigenvalues below this fraction of the largest one count as zero
Operator = Callable[[Array], Array]


class ActiveSet(NamedTuple):
    """Active constraints of a solution.

    Attributes
    ----------
    rows, bounds : ndarray of bool, shapes (n_g,) and (n_w,)
        True for rows and unknowns whose bound is active, including equations and fixed unknowns.
    weak : int
        Number of inequalities without strict complementarity: the distance from the bound and the
        multiplier are both near zero.
    """

    rows: Mask
    bounds: Mask
    weak: int


class Optimality(NamedTuple):
    """Result of the check of the second-order conditions at a solution.

    Attributes
    ----------
    directions : int
        Dimension of the null space of the active constraints.
    curvature : float
        Smallest curvature of the Lagrangian in this null space, per squared change of the inputs
        and the duration: positive at a strict local minimum, infinite if the null space has
        dimension zero.
    weak : int
        Number of inequalities without strict complementarity, which are treated as inactive.
    """

    directions: int
    curvature: float
    weak: int

    def __repr__(self) -> str:
        return field_overview(self)

    @property
    def is_minimum(self) -> bool:
        """Whether the second-order sufficient conditions hold."""
        return self.curvature > 0

    @property
    def words(self) -> str:
        """Result of the check as text for the summary."""
        bounds, directions = (
            f"{count} {noun}" + "s" * (count != 1)
            for count, noun in ((self.weak, "bound"), (self.directions, "free direction"))
        )
        weak = f"; strict complementarity fails at {bounds}" if self.weak else ""
        if not self.directions:
            return f"the active constraints determine the plan{weak}"
        where = f"smallest curvature {self.curvature:.2g} in {directions}"
        if self.is_minimum:
            return f"a strict local minimum: {where}{weak}"
        return f"not shown to be a minimum: {where}; start from other guesses{weak}"


def active_set(program: Program, solution: Solution) -> ActiveSet:
    """Return the active constraints of a solution.

    At a solution of an interior point method, the distance of each inequality from its bound or its
    relative multiplier (multiplier over cost) is near zero. An inequality is active if the relative
    multiplier is the larger of the two.
    """
    size = max(abs(solution.cost), IPOPT_TOLERANCE)
    found, weak = [], 0
    for values, low, high, multipliers in (
        (solution.rows, program.g_lower, program.g_upper, solution.row_multipliers),
        (
            solution.unknowns / program.scale,
            program.lower / program.scale,
            program.upper / program.scale,
            solution.bound_multipliers,
        ),
    ):
        distance = np.minimum(values - low, high - values)
        pull = np.abs(multipliers) / size
        is_equation = low == high
        is_weak = ~is_equation & (np.maximum(distance, pull) < WEAK)
        found.append(is_equation | ((pull > distance) & ~is_weak))
        weak += int(is_weak.sum())
    return ActiveSet(found[0], found[1], weak)


def check_optimality(program: Program, solution: Solution, weights: Array) -> Optimality:
    """Check the second-order sufficient conditions at a solution.

    Parameters
    ----------
    program : Program
        From `transcribe`.
    solution : Solution
        Solution of the program.
    weights : ndarray, shape (n_costs + 1,)
        Weights of the costs; the last one is the weight of the smoothness.
    """
    active = active_set(program, solution)
    free = ~active.bounds
    hessian, jacobian = _derivatives(program, solution, weights)
    h, a = hessian[free][:, free], jacobian[active.rows][:, free]
    n, m = h.shape[0], a.shape[0]
    if n <= m:
        return Optimality(0, np.inf, active.weak)
    if not h.count_nonzero():
        return Optimality(n - m, 0.0, active.weak)
    largest = abs(a).max(axis=1).toarray().ravel()
    a = scipy.sparse.diags(1 / np.where(largest > 0, largest, 1.0)) @ a
    layout, place = program.layout, np.cumsum(free) - 1
    chosen = np.append(layout.inputs.ravel(), layout.duration)
    inputs = place[chosen[free[chosen]]]
    try:
        solve = _kkt_solver(h, a)
    except RuntimeError:  # the matrix is singular: the cost does not change in some direction
        return Optimality(n - m, 0.0, active.weak)

    def inverse(v: Array) -> Array:
        full = np.zeros(n)
        full[inputs] = v
        found: Array = solve(full)[inputs]
        return found

    project = _kkt_solver(scipy.sparse.identity(n), a)
    weakest, largest = _extreme_eigenvalues(inverse, inputs.size)
    # Large negative curvatures are lost by rounding in the inverse.
    strongest, _ = _extreme_eigenvalues(lambda v: project(h @ project(v)), n)
    positive = 1 / largest if largest > 0 else np.inf
    curvature = 1 / weakest if weakest < 0 else strongest if strongest < 0 else positive
    is_flat = abs(curvature) < REGULARISATION * float(abs(h).max())
    return Optimality(n - m, 0.0 if is_flat else curvature, active.weak)


def _derivatives(
    program: Program, solution: Solution, weights: Array
) -> tuple[scipy.sparse.csc_matrix, scipy.sparse.csr_matrix]:
    """Return the Hessian of the Lagrangian and the Jacobian of the rows, for scaled unknowns."""
    w = solution.unknowns / program.scale
    upper = _sparse(program.hessian(w, weights, 1.0, solution.row_multipliers))
    _, jacobian = program.jacobian(w, weights)
    whole = upper + scipy.sparse.triu(upper, 1).T
    return whole.tocsc(), _sparse(jacobian).tocsr()


def _sparse(matrix: ca.DM) -> scipy.sparse.csc_matrix:
    columns, rows = matrix.sparsity().get_ccs()
    return scipy.sparse.csc_matrix((np.array(matrix.nonzeros()), rows, columns), matrix.shape)


def _kkt_solver(h: scipy.sparse.spmatrix, a: scipy.sparse.spmatrix) -> Operator:
    """Return a function that multiplies by the upper left block of the inverse KKT matrix.

    The KKT matrix has the Hessian ``h`` and the Jacobian ``a`` of the active constraints.
    """
    n, m = h.shape[0], a.shape[0]
    below = -REGULARISATION * scipy.sparse.identity(m)
    factors = scipy.sparse.linalg.splu(scipy.sparse.bmat([[h, a.T], [a, below]]).tocsc())

    def solve(v: Array) -> Array:
        found: Array = factors.solve(np.append(v, np.zeros(m)))[:n]
        return found

    return solve


def _extreme_eigenvalues(operator: Operator, size: int) -> tuple[float, float]:
    """Return the smallest and the largest eigenvalue of a symmetric operator.

    Eigenvalues within rounding are returned as zero. The Lanczos method with full
    orthogonalisation needs ten times fewer products here than `scipy.sparse.linalg.eigsh`, because
    the active constraints give many eigenvalues near zero.
    """
    steps = min(size, LANCZOS_STEPS)
    basis = np.zeros((steps, size))
    products = np.zeros((steps, size))
    new = np.random.default_rng(1).standard_normal(size)
    for k in range(steps):
        for _ in range(2):  # one pass leaves rounding errors
            new = new - basis[:k].T @ (basis[:k] @ new)
        length = float(np.linalg.norm(new))
        if k and length <= ROUNDING * float(np.linalg.norm(products[k - 1])):
            basis, products = basis[:k], products[:k]
            break
        basis[k] = new / length
        products[k] = new = operator(basis[k])
    small = basis @ products.T
    values = np.linalg.eigvalsh((small + small.T) / 2)
    noise = ROUNDING * float(np.abs(values).max())
    low, high = (float(value) if abs(value) > noise else 0.0 for value in values[[0, -1]])
    return low, high
