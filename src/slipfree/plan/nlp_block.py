"""Blocks of a program: functions of few unknowns, repeated at many points, with derivatives.

Results of ground lookups are arguments of these functions, which are then free of calls: the same
for every ground, and as often differentiable as CasADi's expressions are.
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
DERIVATIVE_ORDER = 4  # derivatives of a ground: two in the model, two more in the Hessian


class Question(NamedTuple):
    """A lookup of a block.

    Attributes
    ----------
    question : casadi Function
        ``(v, q, p, c) ->`` argument of the lookup, with the results of those before it.
    function : casadi Function
        From the argument to the result.
    """

    question: ca.Function
    function: ca.Function


class NlpBlock(NamedTuple):
    """A function that a program repeats at several points.

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
    variable_indices : ndarray, shape (n, n_v)
        Indices of ``v`` among the unknowns of the program, at every point.
    row_indices : ndarray, shape (n, n_rows)
        Indices of the rows among those of the program.
    constants : ndarray, shape (n, n_q)
        Values of ``q``.
    """

    cost: ca.Function
    gradient: ca.Function
    rows: ca.Function
    jacobian: ca.Function
    hessian: ca.Function
    questions: tuple[Question, ...]
    variable_indices: Index
    row_indices: Index
    constants: Array


def nlp_block(
    symbols: tuple[ca.SX, ca.SX, ca.SX],
    cost: ca.SX,
    rows: ca.SX,
    lookups: Sequence[Lookup],
    indices: tuple[Index, Index],
    constants: Array,
    *,
    compiled: bool = False,
) -> NlpBlock:
    """Return a block with its derivatives.

    Parameters
    ----------
    symbols : tuple of three SX columns
        Unknowns, constants and parameters, ``v, q, p``.
    cost, rows : SX
        A scalar and a column.
    lookups : sequence of Lookup
        Lookups that they contain, at questions in these symbols.
    indices : tuple of two ndarrays
        ``variable_indices`` and ``row_indices`` of `NlpBlock`.
    constants : ndarray
        See `NlpBlock`.
    compiled : bool
        Whether to compile its larger functions.

    Raises
    ------
    ModelError
        If second derivatives of a lookup are not known.
    """
    lookups = needed_lookups(lookups, [cost, rows])
    check_order(lookups, DERIVATIVE_ORDER, "a plan")
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
            ca.Function("question", [*symbols, found_column(lookups[:k])], [each.argument]),
            each.function,
        )
        for k, each in enumerate(lookups)
    )
    names = ("rows", "jacobian", "hessian")
    of_rows, jacobian, hessian = compiled_functions(key, names, large, compiled=compiled)
    return NlpBlock(
        ca.Function("cost", given, [cost]),
        ca.Function("gradient", given, [cost, ca.gradient(cost, v)]),
        of_rows,
        jacobian,
        hessian,
        questions,
        *indices,
        constants,
    )
