"""Elements of a program: functions of few unknowns that stand at many places, and derivatives.

An element may call functions that cannot be compiled with it, such as heights of a map. Their
results and derivatives are arguments of the element's functions instead, which are then free of
calls: the same for every ground. In them the result of a call is its Taylor polynomial about its
own arguments, so that derivatives by the unknowns are those of the whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from slipfree import compiled
from slipfree.calls import without_calls
from slipfree.errors import ModelError
from slipfree.named import Array

Index = npt.NDArray[np.intp]
LARGE = 300  # operations from which on an element is compiled


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


class Call(NamedTuple):
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
    calls : tuple of Call
        What they take the results of, in order.
    where : ndarray, shape (n, n_v)
        Which unknowns of the program ``v`` are, at every place.
    rows : ndarray, shape (n, n_rows)
        Which rows of the program the rows are.
    constants : ndarray, shape (n, n_q)
        Values of ``q``.
    """

    parts: Parts
    calls: tuple[Call, ...]
    where: Index
    rows: Index
    constants: Array


class _Lifted(NamedTuple):
    """An element with symbols in place of what calls return; ``functions`` is what they call."""

    symbols: tuple[ca.SX, ca.SX, ca.SX]
    cost: ca.SX
    rows: ca.SX
    results: tuple[ca.SX, ...]
    arguments: tuple[ca.SX, ...]
    functions: tuple[ca.Function, ...]


def element(
    symbols: tuple[ca.SX, ca.SX, ca.SX], cost: ca.SX, rows: ca.SX,
    where: Index, places: Index, constants: Array, *, compile: bool = False,
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
    compile : bool
        Whether to compile what is large; what is in the cache is used anyway.
    """
    lifted = _lifted(symbols, ca.densify(cost), ca.densify(rows))
    smooth = tuple(_matters(lifted, k) for k in range(len(lifted.results)))
    calls = tuple(_call(lifted, k, smooth[k]) for k in range(len(smooth)))
    taylor = _taylor(lifted, smooth)
    made = cache(lambda: _of_rows(lifted, taylor))
    # What is a number among the arguments may be another one next time, as the key of a ground is.
    free = [each for each in _scalars(_column(lifted.arguments)) if not each.is_constant()]
    values = ca.Function(
        "values",
        [*symbols, taylor.c],
        [lifted.cost, lifted.rows, ca.vertcat(ca.SX(0, 1), *free)],
        {"cse": True},
    )
    found = None
    if values.n_instructions() >= LARGE:
        text = f"{Path(__file__).read_text()}\n{smooth}\n{compiled.source([values])}"
        found = compiled.library(text, Parts._fields[2:], made, build=compile)
    parts = Parts(*_of_cost(lifted, taylor), *(found or made()))
    return Element(parts, calls, where, places, constants)


def _lifted(symbols: tuple[ca.SX, ca.SX, ca.SX], cost: ca.SX, rows: ca.SX) -> _Lifted:
    """Return an element with symbols for the results of its calls."""
    f = ca.Function("plain", list(symbols), [cost, rows], {"cse": True})
    plain, calls = without_calls(f, symbols)
    # CasADi takes symbols of one name for each other when it looks for common subexpressions.
    former = [_column(call.results) for call in calls]
    results = tuple(ca.SX.sym(f"result{k}", each.numel()) for k, each in enumerate(former))
    cost, rows, *arguments = (
        _with(each, former, results)
        for each in [*plain, *(_column(call.arguments) for call in calls)]
    )
    functions = tuple(call.function for call in calls)
    return _Lifted(symbols, cost, rows, results, tuple(arguments), functions)


def _column(matrices: Sequence[ca.SX]) -> ca.SX:
    entries: list[Any] = [entry for each in matrices for entry in each.nonzeros()]
    return ca.SX(ca.vertcat(ca.SX(0, 1), *entries))


def _scalars(column: ca.SX) -> list[ca.SX]:
    return ca.vertsplit(column) if column.numel() else []


def _matters(lifted: _Lifted, k: int) -> bool:
    """Return whether derivatives depend on the result of a call: not if they are rounded off."""
    all_of_it = ca.vertcat(lifted.cost, lifted.rows, *lifted.arguments)
    return bool(ca.sparsify(ca.jacobian(all_of_it, lifted.results[k])).nnz())


def _call(lifted: _Lifted, k: int, smooth: bool) -> Call:
    before = ca.vertcat(ca.SX(0, 1), *lifted.results[:k])
    arguments = ca.Function("arguments", [*lifted.symbols, before], [lifted.arguments[k]])
    f = _of_column(lifted.functions[k])
    if not smooth:
        return Call(arguments, (f,))
    first = f.jacobian()
    second = first.jacobian()
    if second.nnz_out(1):
        raise ModelError(
            f"plan: expected called functions whose Jacobian follows from their arguments alone, "
            f"found {f.name()}, whose Jacobian takes its results; write it as an expression"
        )
    return Call(arguments, (f, first, second))


def _of_column(f: ca.Function) -> ca.Function:
    """Return a function as one of a column of all its arguments, to a column of all its results."""
    alone = f.n_in() == f.n_out() == 1 and f.size2_in(0) == f.size2_out(0) == 1
    if alone and f.sparsity_in(0).is_dense() and f.sparsity_out(0).is_dense():
        return f
    ends = np.cumsum([0, *(f.nnz_in(k) for k in range(f.n_in()))]).tolist()
    column = ca.MX.sym("a", ends[-1])
    parts = ca.vertsplit(column, ends)
    full = [ca.MX(f.sparsity_in(k), part) for k, part in enumerate(parts)]
    return ca.Function(
        "call", [column], [ca.vertcat(*(ca.vec(each).nz[:] for each in f.call(full)))]
    )


class _Taylor(NamedTuple):
    """Polynomials for results of calls, linear and square: symbols ``c, c1, c2``, places ``at``."""

    linear: list[ca.SX]
    square: list[ca.SX]
    at: list[ca.SX]
    c: ca.SX
    c1: ca.SX
    c2: ca.SX


def _taylor(lifted: _Lifted, smooth: Sequence[bool]) -> _Taylor:
    at, linear, square, none = list[ca.SX](), list[ca.SX](), list[ca.SX](), ca.SX(0, 1)
    firsts, seconds = [none], [none]
    for c, own, is_smooth in zip(lifted.results, lifted.arguments, smooth, strict=True):
        if not is_smooth:
            linear.append(c)
            square.append(c)
            at.append(own)
            continue
        n_a, n_c, k = own.numel(), c.numel(), len(at)
        at.append(ca.vertcat(*(each if each.is_constant() else ca.SX.sym(f"at{k}_{j}")
                               for j, each in enumerate(_scalars(own)))))  # fmt: skip
        firsts.append(ca.SX.sym(f"first{k}", n_c * n_a))
        seconds.append(ca.SX.sym(f"second{k}", n_c * n_a * n_a))
        slopes = ca.reshape(firsts[-1], n_c, n_a)
        away = _with(own, lifted.results[: len(linear)], linear) - at[-1]
        linear.append(c + slopes @ away)
        away = _with(own, lifted.results[: len(square)], square) - at[-1]
        bend = ca.reshape(ca.reshape(seconds[-1], n_c * n_a, n_a) @ away, n_c, n_a)
        square.append(c + (slopes + bend / 2) @ away)
    return _Taylor(linear, square, at, ca.vertcat(none, *lifted.results), ca.vertcat(*firsts),
                   ca.vertcat(*seconds))  # fmt: skip


def _of_cost(lifted: _Lifted, taylor: _Taylor) -> list[ca.Function]:
    """Return cost, and cost with gradient."""
    cost = _with(lifted.cost, lifted.results, taylor.linear)
    gradient = _at(ca.gradient(cost, lifted.symbols[0]), lifted, taylor)
    given = [*lifted.symbols, taylor.c]
    return [ca.Function("cost", given, [lifted.cost]),
            ca.Function("gradient", [*given, taylor.c1], [lifted.cost, gradient])]  # fmt: skip


def _of_rows(lifted: _Lifted, taylor: _Taylor) -> list[ca.Function]:
    """Return rows, rows with Jacobian, and the Hessian of everything."""
    v = lifted.symbols[0]
    rows = _with(lifted.rows, lifted.results, taylor.linear)
    s, multipliers = ca.SX.sym("s"), ca.SX.sym("l", rows.numel())
    lagrangian = s * lifted.cost + ca.dot(multipliers, lifted.rows)
    lagrangian = _with(lagrangian, lifted.results, taylor.square)
    jacobian, hessian = (_at(each, lifted, taylor) for each in
                         (ca.jacobian(rows, v), ca.triu(ca.hessian(lagrangian, v)[0])))  # fmt: skip
    given, shared = [*lifted.symbols, taylor.c], {"cse": True}
    return [
        ca.Function("rows", given, [lifted.rows], shared),
        ca.Function("jacobian", [*given, taylor.c1], [lifted.rows, jacobian], shared),
        ca.Function("hessian", [*given, taylor.c1, taylor.c2, s, multipliers], [hessian], shared),
    ]


def _at(expression: ca.SX, lifted: _Lifted, taylor: _Taylor) -> ca.SX:
    """Return an expression with the arguments of calls for the places of their polynomials."""
    pairs = [pair for a, own in zip(taylor.at, lifted.arguments, strict=True)
             for pair in zip(_scalars(a), _scalars(own), strict=True)
             if pair[0].is_symbolic()]  # fmt: skip
    return _with(expression, [a for a, _ in pairs], [own for _, own in pairs])


def _with(expression: ca.SX, symbols: Sequence[ca.SX], values: Sequence[ca.SX]) -> ca.SX:
    """Return an expression with values in place of symbols."""
    return ca.substitute([expression], list(symbols), list(values))[0] if symbols else expression
