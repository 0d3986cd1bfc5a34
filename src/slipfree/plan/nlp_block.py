"""Blocks of a nonlinear program: functions of few unknowns, repeated at many points.

Results of ground lookups are arguments of these functions. The functions therefore contain no
calls: they are the same for every ground, and CasADi computes their exact derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from slipfree.core.lookups import Lookup, check_order, found_column, needed_lookups
from slipfree.core.records import Array
from slipfree.system.codegen_cache import compiled_functions

Index = npt.NDArray[np.intp]
DERIVATIVE_ORDER = 4  # of the ground height: two in the model, two more in the Hessian


class BlockLookup(NamedTuple):
    """Ground lookup of a block: a function, and the expression of its argument.

    Attributes
    ----------
    argument : casadi Function
        Function ``(v, q, p, c) ->`` argument of the lookup; ``c`` are the results of the preceding
        lookups of the block.
    function : casadi Function
        Function from the argument to the result of the lookup.
    """

    argument: ca.Function
    function: ca.Function


class NlpBlock(NamedTuple):
    """Cost and constraint functions that a program repeats at n points, with derivatives.

    The arguments of all functions are unknowns ``v``, constants ``q``, parameters ``p`` and lookup
    results ``c``; derivatives are with respect to ``v``.

    Attributes
    ----------
    cost : casadi Function
        Function ``(v, q, p, c) -> cost``.
    gradient : casadi Function
        Function ``(v, q, p, c) -> (cost, gradient of the cost)``.
    rows : casadi Function
        Function ``(v, q, p, c) -> rows`` (constraint functions).
    jacobian : casadi Function
        Function ``(v, q, p, c) -> (rows, Jacobian of the rows)``.
    hessian : casadi Function
        Function ``(v, q, p, c, s, l) ->`` upper triangle of the Hessian of ``s cost + l' rows``.
    lookups : tuple of BlockLookup
        Lookups in the order of their evaluation.
    variable_indices : ndarray, shape (n, n_v)
        Indices of ``v`` among the unknowns of the program, for each point.
    row_indices : ndarray, shape (n, n_rows)
        Indices of the rows among all rows of the program, for each point.
    constants : ndarray, shape (n, n_q)
        Values of ``q`` for each point.
    """

    cost: ca.Function
    gradient: ca.Function
    rows: ca.Function
    jacobian: ca.Function
    hessian: ca.Function
    lookups: tuple[BlockLookup, ...]
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
    """Return a block of a program with its derivatives.

    Parameters
    ----------
    symbols : tuple of three SX columns
        Symbols of the unknowns, constants and parameters, ``v, q, p``.
    cost : SX, shape (1, 1)
        Cost at a point, in these symbols.
    rows : SX, shape (n_rows, 1)
        Constraint functions at a point, in these symbols.
    lookups : sequence of Lookup
        Lookups whose results ``cost`` and ``rows`` contain, with arguments in these symbols.
    indices : tuple of two ndarrays
        ``variable_indices`` and ``row_indices`` of `NlpBlock`.
    constants : ndarray, shape (n, n_q)
        Values of ``q`` for each point.
    compiled : bool
        Whether to compile the functions of the rows, their Jacobian and the Hessian.

    Raises
    ------
    ModelError
        If a lookup is exact only up to derivatives of an order below 4.
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
    block_lookups = tuple(
        BlockLookup(
            ca.Function("argument", [*symbols, found_column(lookups[:k])], [each.argument]),
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
        block_lookups,
        *indices,
        constants,
    )
