"""Derivatives of expressions that call functions, such as a ground's compiled evaluator.

CasADi differentiates an SX graph direction by direction, and calls the Jacobian of a called
function once for each; where the calls are taken out first, once is enough, and zeros stay zeros.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np


class Call(NamedTuple):
    """A call in an SX graph.

    Attributes
    ----------
    function : casadi Function
        What is called.
    arguments : tuple of SX
        They may contain the results of earlier calls.
    results : tuple of SX
        Symbols that stand for what it returns.
    """

    function: ca.Function
    arguments: tuple[ca.SX, ...]
    results: tuple[ca.SX, ...]

    def slopes(self, changes: Sequence[ca.SX]) -> list[ca.SX]:
        """Return how the results change, from how the arguments do, each of shape (m, n)."""
        given = [*self.arguments, *self.results]
        blocks = self.function.jacobian().call(given, False, True)  # never inlined
        count, n = len(changes), changes[0].shape[1]
        found = []
        for k, result in enumerate(self.results):
            total = ca.SX(result.numel(), n)
            for block, change in zip(blocks[k * count :], changes, strict=False):
                if block.nnz() and change.nnz():
                    total += block @ change
            found.append(ca.sparsify(total))
        return found


def without_calls(
    function: ca.Function, symbols: Sequence[ca.SX]
) -> tuple[list[ca.SX], list[Call]]:
    """Return the results of an SX function with its calls taken out, and these in their order.

    Parameters
    ----------
    function : casadi Function
        Of SX, with dense arguments.
    symbols : sequence of SX
        Its arguments.
    """
    nodes, made, calls = function.instructions_sx(), dict[int, ca.SX](), list[Call]()
    given = [ca.vertsplit(ca.vec(each)) if each.numel() else [] for each in symbols]
    results = [[ca.SX(0)] * function.nnz_out(k) for k in range(function.n_out())]
    for k in range(function.n_instructions()):
        kind = function.instruction_id(k)
        source, target = function.instruction_input(k), function.instruction_output(k)
        if kind == ca.OP_INPUT:
            made[target[0]] = given[source[0]][source[1]]
        elif kind == ca.OP_OUTPUT:
            results[target[0]][target[1]] = made[source[0]]
        elif kind == ca.OP_CONST:
            made[target[0]] = ca.SX(function.instruction_constant(k))
        elif kind == ca.OP_CALL:
            calls.append(_call(nodes[k].which_function(), [made[i] for i in source], len(calls)))
            found = ca.vertcat(ca.SX(0, 1), *(_entries(each) for each in calls[-1].results))
            made.update(zip(target, ca.vertsplit(found), strict=True))
        elif len(source) == 1:
            made[target[0]] = ca.SX.unary(kind, made[source[0]])
        else:
            made[target[0]] = ca.SX.binary(kind, made[source[0]], made[source[1]])
    return [ca.SX(function.sparsity_out(k), ca.vertcat(ca.SX(0, 1), *parts))
            for k, parts in enumerate(results)], calls  # fmt: skip


def _call(function: ca.Function, entries: Sequence[ca.SX], number: int) -> Call:
    ends = np.cumsum([0, *(function.nnz_in(k) for k in range(function.n_in()))]).tolist()
    arguments = tuple(ca.SX(function.sparsity_in(k), ca.vertcat(ca.SX(0, 1), *entries[a:b]))
                      for k, (a, b) in enumerate(pairwise(ends)))  # fmt: skip
    # Symbols of one name are one to CasADi's search for common subexpressions.
    results = tuple(ca.SX.sym(f"call{number}_{k}", function.sparsity_out(k))
                    for k in range(function.n_out()))  # fmt: skip
    return Call(function, arguments, results)


def with_calls(expressions: Sequence[ca.SX], calls: Sequence[Call]) -> list[ca.SX]:
    """Return expressions with the calls in place of the symbols of their results."""
    symbols, values = list[ca.SX](), list[ca.SX]()
    for call in calls:
        arguments = ca.substitute(list(call.arguments), symbols, values)
        symbols += [_entries(each) for each in call.results]
        values += [_entries(each) for each in call.function.call(arguments, False, True)]
    return list(ca.substitute(list(expressions), symbols, values))


def _entries(matrix: ca.SX) -> ca.SX:
    return ca.SX(ca.vec(matrix).nz[:])


def jacobian(rows: ca.SX, symbols: ca.SX) -> ca.SX:
    """Return the Jacobian of a column of an SX graph that may contain calls.

    Parameters
    ----------
    rows : SX, shape (n, 1)
        What is differentiated.
    symbols : SX, shape (m, 1)
        By which.
    """
    known = {each.element_hash() for each in ca.vertsplit(_entries(symbols))}
    others = [each for each in ca.symvar(rows) if each.element_hash() not in known]
    given = [symbols, ca.vertcat(ca.SX(0, 1), *others)]
    function = ca.Function("rows", given, [ca.densify(rows)])
    (plain,), calls = without_calls(function, given)
    slopes: list[ca.SX] = []
    for k, call in enumerate(calls):
        changes = [_total(ca.vec(each), symbols, calls[:k], slopes) for each in call.arguments]
        slopes.append(ca.vertcat(*call.slopes(changes)))
    (total,) = with_calls([_total(plain, symbols, calls, slopes)], calls)
    return ca.SX(total)


def _total(rows: ca.SX, symbols: ca.SX, calls: Sequence[Call], slopes: Sequence[ca.SX]) -> ca.SX:
    """Return the total derivative of rows that depend on the symbols also through calls."""
    total = ca.jacobian(rows, symbols)
    for call, slope in zip(calls, slopes, strict=True):
        if slope.nnz():
            results = ca.vertcat(*(ca.vec(each) for each in call.results))
            total += ca.jacobian(rows, results) @ slope
    return ca.sparsify(total)
