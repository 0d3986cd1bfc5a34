"""Check the optimality of a plan, and compute the shadow prices of its limits.

A solution is a strict local minimum if the Hessian of the Lagrangian is positive definite on the
null space of the active constraints (Nocedal and Wright, Numerical Optimization, 2nd ed., theorem
12.6). The inverse of the KKT matrix contains the inverse of this reduced Hessian. Since inputs and
duration determine the motion, the block of the inverse for them has the same numbers of positive
and negative eigenvalues as the reduced Hessian. The Lanczos method computes its extreme eigenvalues
from a sparse factorisation of the KKT matrix.

A multiplier is the derivative of the optimal cost with respect to its bound (section 12.8). A
limit bounds a quantity at all points of the mesh; its price is the sum of the multipliers there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy

from slipfree.core.dae import Limit
from slipfree.core.records import Array, Label, Mask, with_overview
from slipfree.plan.constraints import (
    COST,
    DURATION,
    EQUATION,
    INPUT,
    LIMIT,
    Constraint,
    constraint,
    constraints_of,
    number,
    subject,
)
from slipfree.plan.ipopt import IPOPT_TOLERANCE, NlpSolution
from slipfree.plan.transcription import Index, Program

# largest distance and relative multiplier of a weakly active bound
WEAK = float(np.sqrt(IPOPT_TOLERANCE))
REGULARISATION = 1e-12  # of the KKT matrix, for dependent constraints
LANCZOS_STEPS = 40  # number of Lanczos steps for the extreme eigenvalues
ROUNDING = 1e-10  # eigenvalues below this fraction of the largest one count as zero
Operator = Callable[[Array], Array]
STEP_FRACTION = 0.01  # change of a bound in messages, relative to its power of ten; in m for goals
MAX_NAMED_PRICES = 5  # number of prices in a message
MIN_SHARE = 1e-4  # smallest reported saving by a step, relative to the cost
AT_MOST, AT_LEAST, VALUE = "at most", "at least", "value"


class ActiveSet(NamedTuple):
    """Active constraints of a solution."""

    rows: Mask  # whether a bound of the row is active, as of all equations
    bounds: Mask  # whether a bound of the unknown is active
    weak: int  # number of inequalities whose distance and multiplier are both near zero


@with_overview
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


def active_set(program: Program, solution: NlpSolution) -> ActiveSet:
    """Return the active constraints of a solution.

    At a solution of an interior point method, the distance of each inequality from its bound or its
    relative multiplier (multiplier over cost) is near zero. An inequality is active if the relative
    multiplier is the larger of the two.
    """
    size = max(abs(solution.cost), IPOPT_TOLERANCE)
    masks, weak = [], 0
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
        masks.append(is_equation | ((pull > distance) & ~is_weak))
        weak += int(is_weak.sum())
    return ActiveSet(masks[0], masks[1], weak)


def check_optimality(program: Program, solution: NlpSolution, weights: Array) -> Optimality:
    """Check the second-order sufficient conditions at a solution."""
    active = active_set(program, solution)
    free = ~active.bounds
    w = solution.unknowns / program.scale
    upper = program.hessian(w, weights, 1.0, solution.row_multipliers).sparse()
    hessian = (upper + scipy.sparse.triu(upper, 1).T).tocsc()
    jacobian = program.jacobian(w, weights)[1].sparse().tocsr()
    h, a = hessian[free][:, free], jacobian[active.rows][:, free]
    n, m = h.shape[0], a.shape[0]
    if n <= m:
        return Optimality(0, np.inf, active.weak)
    if not h.count_nonzero():
        return Optimality(n - m, 0.0, active.weak)
    largest = abs(a).max(axis=1).toarray().ravel()
    # Rows of equal size, so that one REGULARISATION suits all of them.
    a = scipy.sparse.diags(1 / np.where(largest > 0, largest, 1.0)) @ a
    layout, place = program.layout, np.cumsum(free) - 1
    chosen = np.append(layout.inputs.ravel(), layout.duration)
    inputs = scipy.sparse.identity(n).tocsr()[place[chosen[free[chosen]]]]
    try:
        solve = _kkt_solver(h, a)
    except RuntimeError:  # the matrix is singular: the cost does not change in some direction
        return Optimality(n - m, 0.0, active.weak)
    weakest, largest = _extreme_eigenvalues(lambda v: inputs @ solve(inputs.T @ v), inputs.shape[0])
    # Large negative curvatures are lost by rounding in the inverse. IPOPT's last step would have
    # needed a regularisation; its terms of bounds hide them only where bounds are weakly active.
    strongest = 0.0
    if active.weak or solution.regularisation > 0:
        # With the identity as Hessian, the block is the projection onto the null space.
        project = _kkt_solver(scipy.sparse.identity(n), a)
        strongest, _ = _extreme_eigenvalues(lambda v: project(h @ project(v)), n)
    # The eigenvalues of the inverse are reciprocal curvatures: the largest belongs to the smallest.
    positive = 1 / largest if largest > 0 else np.inf
    curvature = 1 / weakest if weakest < 0 else strongest if strongest < 0 else positive
    is_flat = abs(curvature) < REGULARISATION * float(abs(h).max())
    return Optimality(n - m, 0.0 if is_flat else curvature, active.weak)


def _kkt_solver(h: scipy.sparse.spmatrix, a: scipy.sparse.spmatrix) -> Operator:
    """Return a function that multiplies by the upper left block of the inverse KKT matrix."""
    n, m = h.shape[0], a.shape[0]
    below = -REGULARISATION * scipy.sparse.identity(m)
    # LU, since SciPy has no sparse factorisation of symmetric indefinite matrices.
    factors = scipy.sparse.linalg.splu(scipy.sparse.bmat([[h, a.T], [a, below]]).tocsc())

    return lambda v: factors.solve(np.append(v, np.zeros(m)))[:n]


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


@with_overview
class Price(NamedTuple):
    """Shadow price of a limit of a plan: derivative of the optimal cost with respect to its bound.

    Attributes
    ----------
    label : Label
        Label of the limited quantity, without wheel: the price is the sum over all wheels.
    role : str
        Kind of limit: ``"limit"``, ``"input"``, ``"goal"``, ``"duration"``, ``"cost"``, or for a
        way-point its name, for example ``"way-point at 0.5"``.
    side : str
        Side of the bound: ``"at most"``, ``"at least"``, or ``"value"`` for equal bounds.
    bound : float
        Value of the bound as reported (`Dae.reported`), in the label's unit.
    rate : float
        Derivative of the optimal cost with respect to the bound, per unit of the label.
    share : float
        ``rate`` divided by the cost of the plan. [1/unit of the label]
    active : int
        Number of active points, summed over the points of the mesh and the wheels.
    """

    label: Label
    role: str
    side: str
    bound: float
    rate: float
    share: float
    active: int

    @property
    def step(self) -> float:
        """Small change of the bound for which `words` gives the saving, in the label's unit."""
        if self.role not in (LIMIT, INPUT, DURATION, COST) or not self.bound:
            return STEP_FRACTION
        return float(STEP_FRACTION * 10.0 ** np.floor(np.log10(abs(self.bound))))

    @property
    def words(self) -> str:
        """Relative saving of cost for a small change of the bound, as a sentence."""
        side = "" if self.side == VALUE else f" {self.side}"
        more = "more" if self.rate < 0 else "less"
        return (
            f"{subject(self.label, self.role)}{side} {number(self.label, self.bound)}: "
            f"{number(self.label, self.step)} {more} saves "
            f"{100 * abs(self.share) * self.step:.2g} % of the cost"
        )


def limit_prices(program: Program, solution: NlpSolution) -> tuple[Price, ...]:
    """Return the shadow prices of the active limits of a solution, largest saving first."""
    multipliers = np.append(solution.row_multipliers, solution.bound_multipliers / program.scale)
    active = np.append(*active_set(program, solution)[:2])
    prices: dict[tuple[str, ...], Price] = {}
    for group in _limit_groups(program):
        for side, bound, where in _sides(program, group, multipliers):
            count = int(active[where].sum())
            if not count:
                continue
            rate = -float(multipliers[where].sum())
            label = replace(group.label, wheel=None)
            share = rate / max(abs(solution.cost), IPOPT_TOLERANCE)
            new = Price(label, group.role, side, bound + group.shift, rate, share, count)
            key = group.role, label.name, side, f"{bound}"
            old = prices.get(key)
            if old is not None:
                new = new._replace(
                    rate=old.rate + rate, share=old.share + share, active=old.active + count
                )
            prices[key] = new
    return tuple(sorted(prices.values(), key=lambda price: -abs(price.share) * price.step))


def price_rows(prices: Sequence[Price]) -> list[dict[str, Any]]:
    """Return prices as rows of a table for files."""
    return [
        {
            "quantity": price.label.name,
            "unit": price.label.unit,
            **{name: getattr(price, name) for name in Price._fields[1:]},
        }
        for price in prices
    ]


def prices_words(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a text with at most five of the prices that save at least 0.01 % of the cost."""
    prices = [
        Price(Label(row["quantity"], row["unit"], ""), *(row[name] for name in Price._fields[1:]))
        for row in rows
    ]
    named = [each.words for each in prices if abs(each.share) * each.step >= MIN_SHARE]
    if not named:
        return "no limit increases the cost noticeably"
    more = max(len(named) - MAX_NAMED_PRICES, 0)
    rest = f"; {more} more limit{'s' * (more > 1)}" if more else ""
    return "; ".join(named[:MAX_NAMED_PRICES]) + rest


def _limit_groups(program: Program) -> Iterator[Constraint]:
    """Yield the constraints of a program except equations, and the bounds of its duration."""
    for group in constraints_of(program):
        if group.role != EQUATION:
            yield group
    at, label = program.g_lower.size + program.layout.duration, Label(DURATION, "s", "duration")
    bounds = Limit(label, ca.SX(0), *program.task.duration)
    yield constraint(program.task, bounds, DURATION, np.ones(1), np.zeros(1, int), np.array([at]))


def _sides(
    program: Program, group: Constraint, multipliers: Array
) -> Iterator[tuple[str, float, Index]]:
    """Yield side, bound and indices into rows and unknowns, except where others are narrower."""
    lower = np.append(program.g_lower, program.lower)[group.where]
    upper = np.append(program.g_upper, program.upper)[group.where]
    prices = multipliers[group.where]
    if group.lower == group.upper:
        yield VALUE, group.lower, group.where
        return
    yield AT_LEAST, group.lower, group.where[(lower == group.lower) & (prices < 0)]
    yield AT_MOST, group.upper, group.where[(upper == group.upper) & (prices > 0)]
