"""Sparse functions with exact derivatives, put together from small elements that repeat.

What an element is at all its places comes out at a time. Where it is compiled, its functions run
from place to place; else each of their operations becomes one on a column of numbers. What comes
out is put into large sparse matrices by index.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse

from slipfree.errors import ModelError
from slipfree.plan.nlp_block import Element, Index
from slipfree.records import Array

Columns = Sequence[ca.MX]


class Functions(NamedTuple):
    """A program ``f(w, p), g(w, p)`` and its derivatives.

    Attributes
    ----------
    w, p, f, g : MX
        Unknowns, parameters, cost and rows.
    gradient : casadi Function
        ``(w, p) -> (f, its gradient)``.
    jacobian : casadi Function
        ``(w, p) -> (g, its Jacobian)``.
    hessian : casadi Function
        ``(w, p, s, l) ->`` upper half of the Hessian of ``s f + l' g``.
    """

    w: ca.MX
    p: ca.MX
    f: ca.MX
    g: ca.MX
    gradient: ca.Function
    jacobian: ca.Function
    hessian: ca.Function


def assembled(elements: Sequence[Element], scale: Array, n_p: int) -> Functions:
    """Return the program that is the sum of elements.

    Parameters
    ----------
    elements : sequence of Element
        Each row of the program belongs to one of them.
    scale : ndarray, shape (n_w,)
        What unknowns of the program are multiplied by to get those of the elements.
    n_p : int
        Number of parameters.
    """
    n_g = sum(each.places.size for each in elements)
    w, p = ca.MX.sym("w", scale.size), ca.MX.sym("p", n_p)
    sigma, multipliers = ca.MX.sym("sigma"), ca.MX.sym("lambda", n_g)
    v = w * scale
    f, g = _cost(elements, v, p), _rows(elements, v, p)
    return Functions(
        w,
        p,
        f,
        g,
        ca.Function("gradient", [w, p], [*_gradient(elements, v, p, scale)]),
        ca.Function("jacobian", [w, p], [*_jacobian(elements, v, p, scale)]),
        ca.Function(
            "hessian",
            [w, p, sigma, multipliers],
            [_hessian(elements, v, p, scale, (sigma, multipliers))],
        ),
    )


def _arguments(each: Element, v: ca.MX, p: ca.MX) -> list[ca.MX]:
    """Return what the functions of an element take, ``v, q, p`` and what it looks up.

    One row a place; ``p`` is the same for all.
    """
    count = len(each.where)
    given, found = [_picked(v, each.where), ca.MX(ca.DM(each.constants)), p.T], ca.MX(count, 0)
    for question, function in each.questions:
        asked = _columns(_replayed(question, [*map(_split, [*given, found])]), count)[0]
        results = function.map(count)(ca.reshape(asked, count, -1).T)
        found = ca.horzcat(found, results.T)
    return [*given, found]


def _replayed(function: ca.Function, arguments: Sequence[Columns]) -> list[list[ca.MX]]:
    """Return the results of an SX function for columns of arguments, operation by operation.

    Parameters
    ----------
    function : casadi Function
        Of SX, without calls.
    arguments : sequence of sequences of MX
        For each argument each of its entries.

    Returns
    -------
    list of lists of MX
        For each result each of its nonzero entries.

    Raises
    ------
    ModelError
        If the function calls others.
    """
    if function.find_functions():
        name = function.find_functions()[0].name()
        raise ModelError(
            f"plan: expected lookups whose questions are formulas, found a call of {name!r}; write "
            "it as an expression"
        )
    work: dict[int, ca.MX] = {}
    results = [[ca.MX(0)] * function.nnz_out(k) for k in range(function.n_out())]
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        source, target = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_INPUT:
            work[target[0]] = arguments[source[0]][source[1]]
        elif operation == ca.OP_OUTPUT:
            results[target[0]][target[1]] = work[source[0]]
        elif operation == ca.OP_CONST:
            work[target[0]] = ca.MX(function.instruction_constant(k))
        elif len(source) == 1:
            work[target[0]] = ca.MX.unary(operation, work[source[0]])
        else:
            work[target[0]] = ca.MX.binary(operation, work[source[0]], work[source[1]])
    return results


def _picked(values: ca.MX, where: Index) -> ca.MX:
    """Return values by index, one row a place."""
    return ca.reshape(values[where.T.ravel().tolist()], *where.shape)


def _split(rows: ca.MX) -> Columns:
    return ca.horzsplit(rows) if rows.shape[1] else []


def _at_places(f: ca.Function, each: Element, arguments: Sequence[ca.MX]) -> list[ca.MX]:
    """Return the results of a function of an element, entry by entry, each a column of places."""
    count = len(each.where)
    if f.is_a("SXFunction") and not f.find_functions():
        # A loop over a column takes a tenth of the interpreter's time for as many numbers.
        return _columns(_replayed(f, [*map(_split, arguments)]), count)
    same = [k for k, rows in enumerate(arguments) if rows.shape[0] == 1 < count]
    found = f.map("all", "serial", count, same, []).call([rows.T for rows in arguments])
    return [ca.vec(ca.reshape(part.nz[:], -1, count).T) for part in found]


def _cost(elements: Sequence[Element], v: ca.MX, p: ca.MX) -> ca.MX:
    return sum(
        (ca.sum1(_at_places(each.cost, each, _arguments(each, v, p))[0]) for each in elements),
        ca.MX(0),
    )


def _rows(elements: Sequence[Element], v: ca.MX, p: ca.MX) -> ca.MX:
    return _ordered(
        elements, [_at_places(each.rows, each, _arguments(each, v, p))[0] for each in elements]
    )


def _gradient(elements: Sequence[Element], v: ca.MX, p: ca.MX, scale: Array) -> tuple[ca.MX, ca.MX]:
    """Return the cost and its gradient."""
    cost, values, places, factors = ca.MX(0), [], [], []
    for each in elements:
        own, found = _at_places(each.gradient, each, _arguments(each, v, p))
        which, _ = _pattern(each.gradient.sparsity_out(1))
        rows = each.where.T[which].ravel()
        cost += ca.sum1(own)
        values.append(found)
        places.append((rows, np.zeros_like(rows)))
        factors.append(scale[rows])
    return cost, ca.densify(_sum(values, places, factors, (scale.size, 1)))


def _ordered(elements: Sequence[Element], parts: Sequence[ca.MX]) -> ca.MX:
    """Return the rows of all elements in the order of the program."""
    order = np.argsort(np.concatenate([each.places.T.ravel() for each in elements]))
    return ca.vertcat(*parts)[order.tolist()]


def _jacobian(elements: Sequence[Element], v: ca.MX, p: ca.MX, scale: Array) -> tuple[ca.MX, ca.MX]:
    """Return all rows and their Jacobian."""
    parts, values, places, factors = [], [], [], []
    for each in elements:
        own, found = _at_places(each.jacobian, each, _arguments(each, v, p))
        row, column = _pattern(each.jacobian.sparsity_out(1))
        rows, columns = each.places.T[row].ravel(), each.where.T[column].ravel()
        parts.append(own)
        values.append(found)
        places.append((rows, columns))
        factors.append(scale[columns])
    g = _ordered(elements, parts)
    return g, _sum(values, places, factors, (g.numel(), scale.size))


def _hessian(
    elements: Sequence[Element], v: ca.MX, p: ca.MX, scale: Array, prices: tuple[ca.MX, ca.MX]
) -> ca.MX:
    """Return the upper half of the Lagrangian's Hessian."""
    values, places, factors = [], [], []
    for each in elements:
        given = [*_arguments(each, v, p), prices[0], _picked(prices[1], each.places)]
        (found,) = _at_places(each.hessian, each, given)
        row, column = _pattern(each.hessian.sparsity_out(0))
        rows, columns = each.where.T[row].ravel(), each.where.T[column].ravel()
        # Where two of its unknowns are one of the program, both entries of the pair meet.
        twice = np.repeat(row != column, len(each.where)) & (rows == columns)
        values.append(found)
        places.append((np.minimum(rows, columns), np.maximum(rows, columns)))
        factors.append(scale[rows] * scale[columns] * (1 + twice))
    return _sum(values, places, factors, (scale.size, scale.size))


def _pattern(sparsity: ca.Sparsity) -> tuple[Index, Index]:
    row, column = (np.array(part, dtype=np.intp) for part in sparsity.get_triplet())
    return row, column


def _columns(found: Sequence[Columns], count: int) -> list[ca.MX]:
    """Return results at all places in columns, numbers that hold for all of them repeated."""
    return [
        ca.vertcat(
            ca.MX(0, 1),
            *(each if each.numel() == count else ca.repmat(each, count) for each in entries),
        )
        for entries in found
    ]


def _sum(
    values: Sequence[ca.MX],
    places: Sequence[tuple[Index, Index]],
    factors: Sequence[Array],
    shape: tuple[int, int],
) -> ca.MX:
    """Return a sparse matrix of values times factors, those of the same place added up."""
    rows, columns = (np.concatenate(part) for part in zip(*places, strict=True))
    weights = np.concatenate(factors)
    key, where = np.unique(columns.astype(np.int64) * shape[0] + rows, return_inverse=True)
    at = (key % shape[0]).tolist(), (key // shape[0]).tolist()
    pattern = ca.Sparsity.triplet(shape[0], shape[1], *at)
    total = scipy.sparse.csc_matrix((weights, (where, np.arange(where.size))))
    starts, inside = total.indptr.tolist(), total.indices.tolist()
    gather = ca.DM(ca.Sparsity(key.size, where.size, starts, inside), total.data)
    return ca.MX(pattern, gather @ ca.vertcat(*values))
