"""Errors of a pose that follow from errors of the heights of a map, to first order.

The adjoint of the closure equations ``r(p, c) = 0`` gives the derivatives of a quantity ``q`` by
the coefficients ``c`` of the spline under the wheels: with ``(dr/dp)' y = dq/dp``, they are
``dq/dc - (dr/dc)' y``. Coefficients follow from all heights by the inverse of the filter
(1, 4, 1)/6 along both axes; its kernel ``sqrt(3) z^|k|``, ``z = sqrt(3) - 2``, is cut off where it
is below a thousandth. On a smoothing ground (``through=False``) heights are the coefficients. The
sum of the absolute derivatives by the heights times an error of each is the worst case; their root
sum of squares times a standard deviation is that of the quantity, for independent errors of the
nodes.

The pose of pressed wheels also follows from the balance of forces, whose equations are added.

The clearance of bodies changes as the distance of the nearest pair of points would, if it moved
with body and ground: to first order, another pair has no effect.
"""

from __future__ import annotations

from math import factorial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.batch.evaluator import EvaluatorOf
from slipfree.batch.graph import Graph, Graphs, elimination, graph_of
from slipfree.batch.many import columns_of
from slipfree.contact.clearance import BodyClearance, ClearanceSlopes
from slipfree.core.lookups import Cells, needed_lookups
from slipfree.core.records import Array, leaves
from slipfree.terrain.bicubic import middle_basis

POLE = np.sqrt(3.0) - 2.0
MARGIN = 6  # nodes around those under the wheels: the kernel has fallen to 6e-4
FOLLOWED = "roll", "pitch", "tip_over_margin"


class Errors(NamedTuple):
    """Errors of quantities for a unit error of the heights, shape (n_quantities, n).

    Standard deviation for independent errors of unit standard deviation, and worst case for errors
    of magnitude one. [unit of the quantity per metre]
    """

    deviation: Array
    worst: Array


class SensitivityGraph(NamedTuple):
    """Centres of the cells under the wheels, and derivatives of quantities by their coefficients.

    ``names`` are those of the quantities. The last one is the clearance of bodies if there is a
    check of it; the weights of its expression follow the state in the column of the graph.
    """

    graph: Graph
    names: tuple[str, ...]
    cells: Cells
    check: BodyClearance | None


def sensitivity_graph(graphs: Graphs) -> SensitivityGraph | None:
    """Return the graph of the sensitivities of a model.

    None if its ground is not a map. The pose of pressed wheels follows from closure, the balance of
    forces, and states that are at rest.
    """
    dae, rows = graphs.dae, graphs.rows
    equations, p = dae.residuals[0], graphs.state[rows.p]
    lookups = [each for each in needed_lookups(dae.lookups, [equations]) if each.cells is not None]
    if not lookups or len({id(each.cells) for each in lookups}) > 1:
        return None
    if resting := dae.rest.numel():
        p = ca.vertcat(p, graphs.state[rows.w], graphs.state[rows.x][-resting:])
        equations = ca.vertcat(equations, dae.residuals[1], dae.ode[-resting:])
    labels = [label.name for label in leaves((dae.labels.x, dae.labels.z, dae.labels.y))]
    values = list(leaves((dae.x, dae.z, dae.y)))
    names = tuple(name for name in FOLLOWED if name in labels)
    followed = [values[labels.index(name)] for name in names]
    state = graphs.state
    check = next((each for each in dae.checks if isinstance(each, BodyClearance)), None)
    if check is not None:
        weights = ca.SX.sym("weights", check.placing.numel())
        followed.append(ca.dot(weights, check.placing))
        names, state = (*names, check.label.name), ca.vertcat(state, weights)
    solve = elimination(dae, graphs.state, rows)
    jacobian = ca.jacobian(equations, p)
    derivatives = ca.vertcat(*(each.found[2:] for each in lookups))
    slopes = ca.jacobian(equations, derivatives)
    results = [ca.vertcat(*(each.found[:2] for each in lookups))]
    for quantity in followed:
        adjoint = solve(jacobian.T, ca.densify(ca.gradient(quantity, p)))
        results.append(ca.densify(ca.gradient(quantity, derivatives) - slopes.T @ adjoint))
    cells: Any = lookups[0].cells
    graph = graph_of(dae, state, "sensitivity", results)
    return SensitivityGraph(graph, names, cells, check)


def height_errors(
    sensitivity: SensitivityGraph, graphs: Graphs, evaluate: EvaluatorOf[Any], states: Array
) -> Errors:
    """Return the errors of quantities at solved states, shape (n_rows, n)."""
    graph, _, cells, check = sensitivity
    slopes = None
    if check is not None:
        slopes = check.slopes(*columns_of(graphs, states)[:2])
        states = np.concatenate([states, slopes.by_placing])
    values = evaluate(graph, states)
    count, n = (graph.parts[0].stop - graph.parts[0].start) // 2, values.shape[1]
    centers = values[graph.parts[0]].reshape(count, 2, n)
    by_coefficient = np.stack([values[part] for part in graph.parts[1:]])
    by_coefficient = by_coefficient.reshape(-1, count, 4, 4, n)  # wheel, order in y, order in x
    if slopes is not None:
        center, block = _ground_block(cells, slopes)
        centers = np.concatenate([centers, center[None]])
        others = np.zeros((len(by_coefficient) - 1, *block.shape))
        more = np.concatenate([others, block[None]])
        by_coefficient = np.concatenate([by_coefficient, more[:, None]], axis=1)
        count += 1
    bases, kernels = [], []
    for axis, (place, h) in enumerate(zip(cells.place, cells.spacing, strict=True)):
        at = np.rint((centers[:, axis] - place) / h - 0.5)
        offset = np.nan_to_num(at - at.min(axis=0)).T  # (n, count)
        nodes = np.arange(int(offset.max(initial=0)) + 4 + 2 * MARGIN)
        coefficients = offset[..., None] + MARGIN + np.arange(4)
        away = np.abs(nodes - coefficients[..., None])  # (n, count, 4, nodes)
        # cut off, so that a pose does not depend on the spread of the wheels of others
        filtered = np.where(away <= MARGIN, np.sqrt(3.0) * POLE**away, 0.0)
        kernels.append(filtered if cells.is_interpolated else (away == 0).astype(float))
        bases.append(middle_basis() / 6 / h ** np.arange(4)[:, None])
    deviation, worst = np.empty((2, len(by_coefficient), n))
    for k, derivatives in enumerate(by_coefficient):
        blocks = np.einsum("wyxn,xa,yb->nwab", derivatives, *bases, optimize=True)
        left = np.matmul(blocks.swapaxes(2, 3), kernels[0])  # (n, count, 4, nodes in x)
        shape = n, 4 * count, -1
        by_height = np.matmul(left.reshape(shape).swapaxes(1, 2), kernels[1].reshape(shape))
        deviation[k] = np.sqrt((by_height**2).sum(axis=(1, 2)))
        worst[k] = np.abs(by_height).sum(axis=(1, 2))
    return Errors(deviation, worst)


def _ground_block(cells: Cells, slopes: ClearanceSlopes) -> tuple[Array, Array]:
    """Return the centre of the cell under the foot, (2, n), and the clearance's derivatives there.

    They are those by the coefficients of the cell's polynomial, (order in y, order in x, n).
    """
    center = np.empty_like(slopes.foot)
    powers = []
    for axis, (place, h) in enumerate(zip(cells.place, cells.spacing, strict=True)):
        center[axis] = place + (np.floor((slopes.foot[axis] - place) / h) + 0.5) * h
        away = slopes.foot[axis] - center[axis]
        powers.append(np.stack([away**k / factorial(k) for k in range(4)]))
    return center, -slopes.upright * powers[1][:, None] * powers[0]
