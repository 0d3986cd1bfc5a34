"""Elements of a program: functions of few unknowns that stand at many places, and derivatives.

An element may call functions that cannot be compiled with it, such as heights of a map. Their
results and derivatives are arguments of the element's functions instead, which are then free of
calls: the same for every ground. In them the result of a call is its Taylor polynomial about its
own arguments, so that derivatives by the unknowns are those of the whole.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from slipfree.calls import Lifted, Taylor, built, column, lifted
from slipfree.records import Array

Index = npt.NDArray[np.intp]


class Parts(NamedTuple):
    """The functions of an element, all with derivatives with respect to ``v``.

    ``c`` are results of calls, ``c1`` and ``c2`` their first and second derivatives.

    Attributes
    ----------
    cost, gradient : casadi Function
        ``(v, q, p, c) ->`` cost; and ``(v, q, p, c, c1) ->`` cost and its gradient.
    rows, jacobian : casadi Function
        The same of the rows.
    hessian : casadi Function
        ``(v, q, p, c, c1, c2, s, l) ->`` upper half of the Hessian of ``s cost + l' rows``.
    """

    cost: ca.Function
    gradient: ca.Function
    rows: ca.Function
    jacobian: ca.Function
    hessian: ca.Function


class Called(NamedTuple):
    """A call in an element.

    Attributes
    ----------
    arguments : casadi Function
        ``(v, q, p, c) ->`` a column of its arguments, with the results of the calls before it.
    orders : tuple of casadi Function
        What is called, from column to column; its Jacobian, and the Jacobian of that, which take
        the results of the functions before them as well. The first alone if derivatives of the
        element do not depend on them.
    """

    arguments: ca.Function
    orders: tuple[ca.Function, ...]


class Element(NamedTuple):
    """A function that stands at several places of a program.

    Attributes
    ----------
    parts : Parts
        Its functions.
    calls : tuple of Called
        What they take the results of, in order.
    where : ndarray, shape (n, n_v)
        Which unknowns of the program ``v`` are, at every place.
    rows : ndarray, shape (n, n_rows)
        Which rows of the program the rows are.
    constants : ndarray, shape (n, n_q)
        Values of ``q``.
    """

    parts: Parts
    calls: tuple[Called, ...]
    where: Index
    rows: Index
    constants: Array


def element(
    symbols: tuple[ca.SX, ca.SX, ca.SX], cost: ca.SX, rows: ca.SX,
    where: Index, places: Index, constants: Array, *, compiled: bool = False,
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
    compiled : bool
        Whether to compile what is large.
    """
    whole = lifted(symbols, [ca.densify(cost), ca.densify(rows)])
    smooth = [whole.matters(k) for k in range(len(whole.calls))]
    calls = tuple(_call(whole, k, smooth[k]) for k in range(len(smooth)))
    taylor = Taylor(whole, smooth)
    large = built(
        whole, smooth, Parts._fields[2:], lambda: _of_rows(whole, taylor), compiled=compiled
    )
    parts = Parts(*_of_cost(whole, taylor), *large)
    return Element(parts, calls, where, places, constants)


def _call(whole: Lifted, k: int, smooth: bool) -> Called:
    before = column(call.results for call in whole.calls[:k])
    arguments = ca.Function("arguments", [*whole.symbols, before], [whole.calls[k].arguments])
    return Called(arguments, tuple(whole.calls[k].orders(2 if smooth else 0)))


def _of_cost(whole: Lifted, taylor: Taylor) -> list[ca.Function]:
    """Return cost, and cost with gradient."""
    cost, given = whole.expressions[0], [*whole.symbols, whole.results]
    gradient = taylor.here(ca.gradient(taylor.linear(cost), whole.symbols[0]))
    return [ca.Function("cost", given, [cost]),
            ca.Function("gradient", [*given, taylor.first], [cost, gradient])]  # fmt: skip


def _of_rows(whole: Lifted, taylor: Taylor) -> list[ca.Function]:
    """Return rows, rows with Jacobian, and the Hessian of everything."""
    v, (cost, rows) = whole.symbols[0], whole.expressions
    s, multipliers = ca.SX.sym("s"), ca.SX.sym("l", rows.numel())
    lagrangian = taylor.square(s * cost + ca.dot(multipliers, rows))
    jacobian = taylor.here(ca.jacobian(taylor.linear(rows), v))
    hessian = taylor.here(ca.triu(ca.hessian(lagrangian, v)[0]))
    given, shared = [*whole.symbols, whole.results], {"cse": True}
    both = [*given, taylor.first, taylor.second, s, multipliers]
    return [
        ca.Function("rows", given, [rows], shared),
        ca.Function("jacobian", [*given, taylor.first], [rows, jacobian], shared),
        ca.Function("hessian", both, [hessian], shared),
    ]
