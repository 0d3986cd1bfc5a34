"""Sparse functions with exact derivatives, put together from small elements that repeat.

An element is a symbolic function of few unknowns that stands at many places, such as what happens
at one point of time. It is differentiated once, and evaluated for all its places at a time: each
of its operations becomes one on a column of numbers. What comes out is put into large sparse
matrices by index.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt
import scipy.sparse

from slipfree.named import Array

Index = npt.NDArray[np.intp]
Columns = Sequence[ca.MX]


class Element(NamedTuple):
    """A function that stands at several places of a program.

    Attributes
    ----------
    values, jacobian, hessian : casadi Function
        ``(v, q, p) -> (cost, rows)``; ``-> (rows, their Jacobian)``; and with multipliers of cost
        and rows, ``(v, q, p, s, l) ->`` upper half of the Hessian of ``s cost + l' rows``; all
        with respect to ``v``.
    where : ndarray, shape (n, n_v)
        Which unknowns of the program ``v`` are, at every place.
    rows : ndarray, shape (n, n_rows)
        Which rows of the program the rows are.
    constants : ndarray, shape (n, n_q)
        Values of ``q``.
    """

    values: ca.Function
    jacobian: ca.Function
    hessian: ca.Function
    where: Index
    rows: Index
    constants: Array


class Functions(NamedTuple):
    """A program ``f(w, p), g(w, p)`` and its derivatives.

    Attributes
    ----------
    w, p, f, g : MX
        Unknowns, parameters, cost and rows.
    jacobian : casadi Function
        ``(w, p) -> (g, its Jacobian)``.
    hessian : casadi Function
        ``(w, p, s, l) ->`` upper half of the Hessian of ``s f + l' g``.
    """

    w: ca.MX
    p: ca.MX
    f: ca.MX
    g: ca.MX
    jacobian: ca.Function
    hessian: ca.Function


def element(
    symbols: tuple[ca.SX, ca.SX, ca.SX], cost: ca.SX, rows: ca.SX,
    where: Index, places: Index, constants: Array,
) -> Element:  # fmt: skip
    """Return an element with its derivatives.

    Parameters
    ----------
    symbols : tuple of three SX columns
        Unknowns, constants and parameters, ``v, q, p``.
    cost, rows : SX
        A scalar and a column.
    where, places, constants : ndarray
        See `Element`.
    """
    sigma, multipliers = ca.SX.sym("sigma"), ca.SX.sym("lambda", rows.numel())
    lagrangian = sigma * cost + ca.dot(multipliers, rows)
    hessian = ca.triu(ca.hessian(lagrangian, symbols[0])[0])
    given, shared = list(symbols), {"cse": True}
    return Element(
        ca.Function("values", given, [ca.densify(cost), ca.densify(rows)], shared),
        ca.Function("jacobian", given, [ca.densify(rows), ca.jacobian(rows, symbols[0])], shared),
        ca.Function("hessian", [*given, sigma, multipliers], [hessian], shared),
        where, places, constants,
    )  # fmt: skip


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
    n_g = sum(each.rows.size for each in elements)
    w, p = ca.MX.sym("w", scale.size), ca.MX.sym("p", n_p)
    sigma, multipliers = ca.MX.sym("sigma"), ca.MX.sym("lambda", n_g)
    v = w * scale
    f, g = _values(elements, v, p)
    return Functions(
        w, p, f, g,
        ca.Function("jacobian", [w, p], [*_jacobian(elements, v, p, scale)]),
        ca.Function("hessian", [w, p, sigma, multipliers],
                    [_hessian(elements, v, p, scale, (sigma, multipliers))]),
    )  # fmt: skip


def _arguments(each: Element, v: ca.MX, p: ca.MX) -> list[Columns]:
    """Return what the functions of an element take, a column over all places for each scalar."""
    return [_picked(v, each.where), [ca.MX(ca.DM(column)) for column in each.constants.T],
            ca.vertsplit(p)]  # fmt: skip


def _picked(values: ca.MX, where: Index) -> Columns:
    return [values[column.tolist()] for column in where.T]


def _values(elements: Sequence[Element], v: ca.MX, p: ca.MX) -> tuple[ca.MX, ca.MX]:
    cost, parts = ca.MX(0), []
    for each in elements:
        paid, rows = _columns(each.values, _arguments(each, v, p), len(each.where))
        cost += ca.sum1(paid)
        parts.append(rows)
    return cost, _ordered(elements, parts)


def _ordered(elements: Sequence[Element], parts: Sequence[ca.MX]) -> ca.MX:
    """Return the rows of all elements in the order of the program."""
    order = np.argsort(np.concatenate([each.rows.T.ravel() for each in elements]))
    return ca.vertcat(*parts)[order.tolist()]


def _jacobian(elements: Sequence[Element], v: ca.MX, p: ca.MX, scale: Array) -> tuple[ca.MX, ca.MX]:
    """Return all rows and their Jacobian."""
    parts, values, places, factors = [], [], [], []
    for each in elements:
        own, found = _columns(each.jacobian, _arguments(each, v, p), len(each.where))
        row, column = _pattern(each.jacobian.sparsity_out(1))
        rows, columns = each.rows.T[row].ravel(), each.where.T[column].ravel()
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
        given = [*_arguments(each, v, p), [prices[0]], _picked(prices[1], each.rows)]
        (found,) = _columns(each.hessian, given, len(each.where))
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


def _columns(f: ca.Function, arguments: Sequence[Columns], count: int) -> list[ca.MX]:
    """Return the results of a function at all places, entry by entry, each a column of all."""
    found = vectorized(f, arguments)
    return [ca.vertcat(ca.MX(0, 1), *(each if each.numel() == count else ca.repmat(each, count)
                                      for each in entries)) for entries in found]  # fmt: skip


def vectorized(f: ca.Function, arguments: Sequence[Columns]) -> list[list[ca.MX]]:
    """Return the results of an SX function for columns of arguments, operation by operation.

    A compiled loop over a column takes less than a tenth of the time that the interpreter of an SX
    function takes for as many numbers.

    Parameters
    ----------
    f : casadi Function
        Of SX; functions that it calls are evaluated column by column.
    arguments : sequence of sequences of MX
        For each argument of ``f`` and each of its entries a column, or a number for all.

    Returns
    -------
    list of lists of MX
        For each result of ``f`` and each of its nonzero entries a column, or a number for all.
    """
    expressions = f.instructions_sx()
    work: dict[int, ca.MX] = {}
    found: list[list[ca.MX]] = [[ca.MX()] * f.nnz_out(k) for k in range(f.n_out())]
    for k in range(f.n_instructions()):
        kind = f.instruction_id(k)
        source, target = f.instruction_input(k), f.instruction_output(k)
        if kind == ca.OP_INPUT:
            work[target[0]] = arguments[source[0]][source[1]]
        elif kind == ca.OP_OUTPUT:
            found[target[0]][target[1]] = work[source[0]]
        elif kind == ca.OP_CONST:
            work[target[0]] = ca.MX(f.instruction_constant(k))
        elif kind == ca.OP_CALL:
            results = _called(expressions[k].which_function(), [work[i] for i in source])
            work.update(zip(target, results, strict=True))
        elif len(source) == 1:
            work[target[0]] = ca.MX.unary(kind, work[source[0]])
        else:
            work[target[0]] = ca.MX.binary(kind, work[source[0]], work[source[1]])
    return found


def _called(f: ca.Function, entries: Columns) -> Any:
    """Return the results of a called function for columns of entries of all its arguments."""
    count = max(each.numel() for each in entries)
    full = [each if each.numel() == count else ca.repmat(each, count) for each in entries]
    ends = np.cumsum([0, *(f.nnz_in(k) for k in range(f.n_in()))]).tolist()
    given = [ca.reshape(ca.horzcat(*full[a:b]).T, f.size1_in(k), f.size2_in(k) * count)
             for k, (a, b) in enumerate(pairwise(ends))]  # fmt: skip
    found = [ca.reshape(each, -1, count).T for each in f.map(count).call(given)]
    return [column for each in found for column in ca.horzsplit(each)]


def _sum(
    values: Sequence[ca.MX], places: Sequence[tuple[Index, Index]], factors: Sequence[Array],
    shape: tuple[int, int],
) -> ca.MX:  # fmt: skip
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
