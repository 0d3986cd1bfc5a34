"""Elements of a program: functions of few unknowns that stand at many places, and derivatives.

What an element looks up of the ground is an argument of its functions, which are then free of
calls: the same for every ground, and as often differentiable as CasADi's expressions are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from slipfree.codegen_cache import compiled_functions
from slipfree.lookups import Lookup, check_order, found_column, needed_lookups
from slipfree.records import Array

Index = npt.NDArray[np.intp]
ORDER = 4  # derivatives of a ground: two in the model, two more in the Hessian


class Question(NamedTuple):
    """A lookup of an element.

    Attributes
    ----------
    question : casadi Function
        ``(v, q, p, c) ->`` argument of the lookup, with the results of those before it.
    function : casadi Function
        From the argument to the result.
    """

    question: ca.Function
    function: ca.Function


class Element(NamedTuple):
    """A function that stands at several places of a program.

    All functions take ``(v, q, p, c)``: unknowns, constants, parameters and results of lookups.
    Derivatives are those by ``v``.

    Attributes
    ----------
    cost, gradient : casadi Function
        The cost; cost and gradient.
    rows, jacobian : casadi Function
        The rows; rows and their Jacobian.
    hessian : casadi Function
        ``(v, q, p, c, s, l) ->`` upper half of the Hessian of ``s cost + l' rows``.
    questions : tuple of Question
        The lookups, in order.
    where : ndarray, shape (n, n_v)
        Which unknowns of the program ``v`` are, at every place.
    places : ndarray, shape (n, n_rows)
        Which rows of the program the rows are.
    constants : ndarray, shape (n, n_q)
        Values of ``q``.
    """

    cost: ca.Function
    gradient: ca.Function
    rows: ca.Function
    jacobian: ca.Function
    hessian: ca.Function
    questions: tuple[Question, ...]
    where: Index
    places: Index
    constants: Array


def element(
    symbols: tuple[ca.SX, ca.SX, ca.SX],
    cost: ca.SX,
    rows: ca.SX,
    lookups: Sequence[Lookup],
    indices: tuple[Index, Index],
    constants: Array,
    *,
    compiled: bool = False,
) -> Element:
    """Return an element with its derivatives.

    Parameters
    ----------
    symbols : tuple of three SX columns
        Unknowns, constants and parameters, ``v, q, p``.
    cost, rows : SX
        A scalar and a column.
    lookups : sequence of Lookup
        What they contain of the ground, at questions in these symbols.
    indices : tuple of two ndarrays
        ``where`` and ``places`` of `Element`.
    constants : ndarray
        See `Element`.
    compiled : bool
        Whether to compile what is large.

    Raises
    ------
    ModelError
        If second derivatives of a lookup are not known.
    """
    lookups = needed_lookups(lookups, [cost, rows])
    check_order(lookups, ORDER, "a plan")
    v, given, shared = symbols[0], [*symbols, found_column(lookups)], {"cse": True}
    cost, rows = ca.densify(cost), ca.cse(ca.densify(rows))

    def large() -> list[ca.Function]:
        s, multipliers = ca.SX.sym("s"), ca.SX.sym("l", rows.numel())
        hessian = ca.triu(ca.hessian(s * cost + ca.dot(multipliers, rows), v)[0])
        return [
            ca.Function("rows", given, [rows], shared),
            ca.Function("jacobian", given, [rows, ca.jacobian(rows, v)], shared),
            ca.Function("hessian", [*given, s, multipliers], [hessian], shared),
        ]

    key = ca.Function("values", given, [cost, rows], shared)
    questions = tuple(
        Question(
            ca.Function("question", [*symbols, found_column(lookups[:k])], [each.question]),
            each.function,
        )
        for k, each in enumerate(lookups)
    )
    names = ("rows", "jacobian", "hessian")
    of_rows, jacobian, hessian = compiled_functions(key, names, large, compiled=compiled)
    return Element(
        ca.Function("cost", given, [cost]),
        ca.Function("gradient", given, [cost, ca.gradient(cost, v)]),
        of_rows,
        jacobian,
        hessian,
        questions,
        *indices,
        constants,
    )
