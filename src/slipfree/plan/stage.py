"""Build the equations, limits and costs of a model at one collocation point.

For each squared term in a cost, such as slip, the squared expression (the root of the term) becomes
an additional unknown with an equation. The cost is then quadratic in the unknowns, and IPOPT
needs a third of the iterations (Albersmeyer and Diehl, The lifted Newton method, SIAM J. Optim. 20,
2010).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.dae import Limit
from slipfree.core.lookups import Lookup, found_column, needed_lookups
from slipfree.core.records import Array, Label, leaves, with_overview
from slipfree.solve.system import System


@with_overview
class Cost(NamedTuple):
    """Term of the cost of a plan: an expression integrated over time.

    Attributes
    ----------
    name : str
        Name of the term in ``Plan.costs``.
    expression : SX, shape (1, 1)
        The integrand, in the model's symbols: ``model.x``, ``z``, ``u`` and ``y``. Positions in
        ``x`` and ``z`` are local: map coordinates minus ``ground.origin``
        (:ref:`local-and-map-coordinates`).
    unit : str
        Unit of the integral, such as ``"m2 s"``.
    words : str
        Description of the term.
    weight : float
        Factor of the integral in the cost.

    Examples
    --------
    >>> from slipfree import Analytic, Cost, catalog, direct_kinematics
    >>> model = direct_kinematics(catalog.three_wheeler(), Analytic(lambda x, y: 0 * x))
    >>> Cost("rolling", model.z.rates.roll**2, "rad2 s-1", "squared roll rate", weight=10.0).name
    'rolling'
    """

    name: str
    expression: ca.SX
    unit: str
    words: str
    weight: float = 1.0

    @property
    def label(self) -> Label:
        """Label with the name, unit and description of the term."""
        return Label(self.name, self.unit, self.words)


class StageFunctions(NamedTuple):
    """Equations, limits and costs of a model at one collocation point."""

    # ``(t, x, z, r, u, c) -> (rates of the states, rows, costs)`` of time, states, algebraic
    # unknowns on which the plan depends, roots, inputs, and lookup results
    function: ca.Function
    symbols: tuple[ca.SX, ...]  # symbols ``t, x, z, r, u``
    lookups: tuple[Lookup, ...]  # lookups whose results are ``c``, with arguments in these symbols
    sizes: tuple[int, int, int]  # numbers of states, algebraic unknowns and inputs
    roots: int  # number of roots of squared cost terms
    labels: tuple[Label, ...]  # of collocation, equations, roots, limits
    lower: Array  # shape (n_rows,): bounds of these rows
    upper: Array


def stage_functions(
    system: System, costs: Sequence[Cost], limits: Sequence[Limit], conditions: Sequence[ca.SX]
) -> StageFunctions:
    """Return the equations, limits and costs at a collocation point.

    If ``conditions``, the expressions of limits, way-points and goal, or costs contain dependent
    unknowns of the model, these are unknowns of the plan too.
    """
    wanted = [*conditions, *(cost.expression for cost in costs)]
    dae, blocks = system.dae, system.blocks
    x, z, u = dae.columns()
    later = z[system.motion_size :]
    if later.numel() and ca.depends_on(ca.vertcat(ca.SX(0, 1), *wanted), later):
        blocks = (*blocks, *system.dependent_blocks)
    z = z[: blocks[-1].span.stop]
    alg = ca.vertcat(*dae.alg[: len(blocks)])
    r, equations, paid = _split_costs(costs, ca.vertcat(x, z))
    kept = ca.vertcat(ca.SX(0, 1), *(limit.expression for limit in limits))
    motion = [
        replace(each, name=f"{each.name}_motion", words=f"collocation equation of {each.words}")
        for each in leaves(dae.labels.x)
    ]
    model = [label for block in dae.labels.alg[: len(blocks)] for label in block]
    own = [Label(f"{label.name}_root", "1", f"root of {label.words}") for label, _ in equations]
    zeros = np.zeros(len(motion) + len(model) + len(own))
    rows = ca.vertcat(alg, *(each for _, each in equations), kept)
    symbols = dae.t, x, z, r, u
    results = dae.without_continuation([dae.ode, rows, paid])
    lookups = needed_lookups(dae.lookups, results)
    return StageFunctions(
        ca.Function("point", [*symbols, found_column(lookups)], results),
        symbols,
        lookups,
        (x.numel(), z.numel(), u.numel()),
        r.numel(),
        (*motion, *model, *own, *(limit.label for limit in limits)),
        np.append(zeros, [limit.lower for limit in limits]),
        np.append(zeros, [limit.upper for limit in limits]),
    )


def _split_costs(
    costs: Sequence[Cost], motion: ca.SX
) -> tuple[ca.SX, list[tuple[Label, ca.SX]], ca.SX]:
    """Return the symbols of roots, their labelled equations, and the costs in terms of roots."""
    roots, equations, paid = ca.SX(0, 1), list[tuple[Label, ca.SX]](), ca.SX(0, 1)
    for cost in costs:
        terms = ca.SX(0)
        for term in _summands(cost.expression):
            inner = term.dep(0) if term.op() == ca.OP_SQ else None
            if inner is None or inner.is_symbolic() or not ca.depends_on(inner, motion):
                terms += term  # no square, or that of one variable
                continue
            root = ca.SX.sym("root")
            roots = ca.vertcat(roots, root)
            equations.append((cost.label, inner - root))
            terms += root**2
        paid = ca.vertcat(paid, terms)
    return roots, equations, paid


def _summands(expression: ca.SX) -> list[ca.SX]:
    if expression.op() != ca.OP_ADD:
        return [expression]
    return [term for k in range(2) for term in _summands(expression.dep(k))]
