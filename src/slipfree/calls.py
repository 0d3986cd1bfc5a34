"""Expressions that call functions, such as a ground's compiled evaluator, and their derivatives.

CasADi differentiates an SX graph direction by direction, and calls the Jacobian of a called
function once for each. Here the results of calls are symbols instead. For derivatives a result is
its Taylor polynomial about the arguments of the call, so that they are those of the whole; what
stands in the polynomials is asked for once a place.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.codegen_cache import library, source
from slipfree.errors import ModelError

LARGE = 300  # operations from which on functions are worth compiling


class Call(NamedTuple):
    """A call in an SX graph.

    Attributes
    ----------
    function : casadi Function
        What is called, from one dense column to one.
    arguments : SX column
        They may contain the results of earlier calls.
    results : SX column
        Symbols that stand for what it returns.
    """

    function: ca.Function
    arguments: ca.SX
    results: ca.SX

    def orders(self, order: int) -> list[ca.Function]:
        """Return what is called and its Jacobians up to an order.

        Each takes the arguments and the results of those before it.

        Raises
        ------
        ModelError
            If second derivatives depend on more than the arguments.
        """
        found = [self.function]
        for _ in range(order):
            found.append(found[-1].jacobian())
        if order > 1 and found[-1].nnz_out(1):
            raise ModelError(
                "expected called functions whose Jacobian follows from their arguments alone, "
                f"found {self.function.name()}, whose Jacobian takes its results; write it as an "
                "expression"
            )
        return found


class Lifted(NamedTuple):
    """Expressions with symbols for what their calls return.

    Attributes
    ----------
    symbols : tuple of SX
        What the expressions depend on, besides the results of calls.
    expressions : tuple of SX
        Without calls.
    calls : tuple of Call
        In their order.
    """

    symbols: tuple[ca.SX, ...]
    expressions: tuple[ca.SX, ...]
    calls: tuple[Call, ...]

    @property
    def results(self) -> ca.SX:
        """The symbols of all results, a column."""
        return column(call.results for call in self.calls)

    @property
    def arguments(self) -> ca.SX:
        """What the calls take, a column without numbers.

        A number may be another one next time, as the key of a ground is.
        """
        return column(entry for call in self.calls for entry in _entries(call.arguments)
                      if not entry.is_constant())  # fmt: skip

    @property
    def layout(self) -> str:
        """How the columns of results and arguments are divided into calls, in words."""
        return "; ".join(
            f"{call.results.numel()} of {[each.is_constant() for each in _entries(call.arguments)]}"
            for call in self.calls
        )

    def matters(self, k: int) -> bool:
        """Return whether derivatives depend on the results of a call: not if they are rounded."""
        everything = column([*self.expressions, *(call.arguments for call in self.calls)])
        return bool(ca.sparsify(ca.jacobian(everything, self.calls[k].results)).nnz())


def column(parts: Any) -> ca.SX:
    """Return the nonzero entries of SX matrices as one column."""
    entries: list[Any] = [entry for each in parts for entry in each.nonzeros()]
    return ca.SX(ca.vertcat(ca.SX(0, 1), *entries))


def replayed(
    function: ca.Function, arguments: Sequence[Sequence[Any]], kind: Any,
    called: Callable[[ca.Function, list[Any]], list[Any]] | None = None,
) -> list[list[Any]]:  # fmt: skip
    """Return the results of an SX function for other arguments, operation by operation.

    Parameters
    ----------
    function : casadi Function
        Of SX.
    arguments : sequence of sequences
        For each argument each of its entries.
    kind : type
        Of the entries, ``ca.SX`` or ``ca.MX``.
    called : callable, optional
        Returns the results of a call from its arguments, both entry by entry.

    Returns
    -------
    list of lists
        For each result each of its nonzero entries.
    """
    work: dict[int, Any] = {}
    nodes: Any = function.instructions_sx() if called else []
    results: list[list[Any]] = [[kind(0)] * function.nnz_out(k) for k in range(function.n_out())]
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        source, target = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_INPUT:
            work[target[0]] = arguments[source[0]][source[1]]
        elif operation == ca.OP_OUTPUT:
            results[target[0]][target[1]] = work[source[0]]
        elif operation == ca.OP_CONST:
            work[target[0]] = kind(function.instruction_constant(k))
        elif operation == ca.OP_CALL and called:
            found = called(nodes[k].which_function(), [work[i] for i in source])
            work.update(zip(target, found, strict=True))
        elif len(source) == 1:
            work[target[0]] = kind.unary(operation, work[source[0]])
        else:
            work[target[0]] = kind.binary(operation, work[source[0]], work[source[1]])
    return results


def lifted(symbols: Sequence[ca.SX], expressions: Sequence[ca.SX]) -> Lifted:
    """Return expressions of symbols with their calls taken out.

    Parameters
    ----------
    symbols, expressions : sequence of SX
        Dense columns, and what depends on them.
    """
    function = ca.Function("plain", list(symbols), list(expressions))
    if not function.find_functions():
        return Lifted(tuple(symbols), tuple(expressions), ())
    calls, known = list[Call](), dict[tuple[int, ...], Call]()

    def called(f: ca.Function, entries: list[ca.SX]) -> list[ca.SX]:
        key = (hash(f), *(entry.element_hash() for entry in entries))
        if key in known:
            return _entries(known[key].results)
        of_column = _of_column(f)
        results = ca.SX.sym(f"result{len(calls)}", of_column.numel_out(0))
        known[key] = Call(of_column, ca.vertcat(ca.SX(0, 1), *entries), results)
        calls.append(known[key])
        return _entries(results)

    results = replayed(function, [_entries(ca.vec(each)) for each in symbols], ca.SX, called)
    plain = [ca.SX(function.sparsity_out(k), ca.vertcat(ca.SX(0, 1), *parts))
             for k, parts in enumerate(results)]  # fmt: skip
    return Lifted(tuple(symbols), tuple(plain), tuple(calls))


def _entries(rows: ca.SX) -> list[ca.SX]:
    return ca.vertsplit(rows) if rows.numel() else []


def _of_column(f: ca.Function) -> ca.Function:
    """Return a function as one of a column of all its arguments, to a column of all its results."""
    alone = f.n_in() == f.n_out() == 1 and f.size2_in(0) == f.size2_out(0) == 1
    if alone and f.sparsity_in(0).is_dense() and f.sparsity_out(0).is_dense():
        return f
    ends = np.cumsum([0, *(f.nnz_in(k) for k in range(f.n_in()))]).tolist()
    given = ca.MX.sym("a", ends[-1])
    full = [ca.MX(f.sparsity_in(k), given[a:b]) for k, (a, b) in enumerate(pairwise(ends))]
    results = [ca.vec(each).nz[:] for each in f.call(full)]
    return ca.Function("call", [given], [ca.vertcat(*results)], {"never_inline": True})


class Taylor:
    """Expressions in which the results of calls are polynomials about their arguments.

    Parameters
    ----------
    whole : Lifted
        The expressions.
    smooth : sequence of bool
        Whether derivatives depend on each call's results; else these are constants.

    Attributes
    ----------
    firsts, seconds : list of SX
        Symbols of the first and second derivatives of every smooth call, a column each.
    first, second : SX
        All of them, a column each.
    """

    def __init__(self, whole: Lifted, smooth: Sequence[bool]) -> None:
        self.whole = whole
        self._smooth = smooth
        calls = [call for call, each in zip(whole.calls, smooth, strict=True) if each]
        sizes = [(call.results.numel(), call.arguments.numel()) for call in calls]
        self.firsts = [ca.SX.sym(f"first{k}", n * m) for k, (n, m) in enumerate(sizes)]
        self.seconds = [ca.SX.sym(f"second{k}", n * m * m) for k, (n, m) in enumerate(sizes)]
        self.first, self.second = (ca.SX(ca.vertcat(ca.SX(0, 1), *each))
                                   for each in (self.firsts, self.seconds))  # fmt: skip
        self._at = [
            ca.vertcat(ca.SX(0, 1), *(each if each.is_constant() else ca.SX.sym(f"at{k}_{j}")
                                      for j, each in enumerate(_entries(call.arguments))))
            for k, call in enumerate(calls)
        ]  # fmt: skip

    def linear(self, expression: ca.SX) -> ca.SX:
        """Return an expression of polynomials of the first degree."""
        return substituted(expression, self._symbols, self._linear)

    def square(self, expression: ca.SX) -> ca.SX:
        """Return an expression of polynomials of the second degree."""
        return substituted(expression, self._symbols, self._square)

    def here(self, expression: ca.SX) -> ca.SX:
        """Return a derivative of one of these expressions at the place it is asked for."""
        calls = [call for call, each in zip(self.whole.calls, self._smooth, strict=True) if each]
        pairs = [pair for call, at in zip(calls, self._at, strict=True)
                 for pair in zip(_entries(at), _entries(call.arguments), strict=True)
                 if pair[0].is_symbolic()]  # fmt: skip
        return substituted(expression, [at for at, _ in pairs], [own for _, own in pairs])

    @property
    def _symbols(self) -> list[ca.SX]:
        return [call.results for call in self.whole.calls]

    @cached_property
    def _linear(self) -> list[ca.SX]:
        return self._polynomials(bent=False)

    @cached_property
    def _square(self) -> list[ca.SX]:
        return self._polynomials(bent=True)

    def _polynomials(self, *, bent: bool) -> list[ca.SX]:
        found, k = list[ca.SX](), 0
        for call, smooth in zip(self.whole.calls, self._smooth, strict=True):
            if not smooth:
                found.append(call.results)
                continue
            n, m = call.results.numel(), call.arguments.numel()
            away = substituted(call.arguments, self._symbols[: len(found)], found) - self._at[k]
            slopes = ca.reshape(self.firsts[k], n, m)
            if bent:
                bend = ca.reshape(self.seconds[k], n * m, m) @ away
                slopes += ca.reshape(bend, n, m) / 2
            found.append(call.results + slopes @ away)
            k += 1
        return found


def built(
    whole: Lifted, smooth: Sequence[bool], names: Sequence[str],
    make: Callable[[], Sequence[ca.Function]], *, compiled: bool,
) -> tuple[ca.Function, ...]:  # fmt: skip
    """Return functions that follow from expressions, compiled if that is asked for and worth it.

    Parameters
    ----------
    whole, smooth
        The expressions, and which calls' results matter to derivatives.
    names : sequence of str
        Of the functions.
    make : callable
        Returns them.
    compiled : bool
        Whether to compile them where a compiler is found.
    """
    if not compiled:
        return tuple(make())
    given, results = [*whole.symbols, whole.results], [*whole.expressions, whole.arguments]
    values = ca.Function("values", given, results, {"cse": True})
    if values.n_instructions() < LARGE:
        return tuple(make())
    code = [Path(inspect.getfile(each)).read_text(encoding="utf-8") for each in (built, make)]
    text = [*code, whole.layout, str([*smooth]), source([values])]
    return library("\n".join(text), names, make) or tuple(make())


def substituted(expression: ca.SX, symbols: Sequence[ca.SX], values: Sequence[ca.SX]) -> ca.SX:
    """Return an expression with values in place of symbols."""
    return ca.substitute([expression], list(symbols), list(values))[0] if symbols else expression


def jacobian(rows: ca.SX, symbols: ca.SX) -> ca.SX:
    """Return the Jacobian of a column of an SX graph that may contain calls.

    Parameters
    ----------
    rows : SX, shape (n, 1)
        What is differentiated.
    symbols : SX, shape (m, 1)
        By which.
    """
    return jacobians([rows], [symbols])[0]


def jacobians(parts: Sequence[ca.SX], by: Sequence[ca.SX]) -> list[ca.SX]:
    """Return the Jacobian of each of some columns that have calls in common.

    Parameters
    ----------
    parts, by : sequence of SX
        What is differentiated, and by which symbols each.
    """
    free = ca.vertcat(ca.SX(0, 1), *ca.symvar(ca.vertcat(ca.SX(0, 1), *parts)))
    whole = lifted([free], [ca.densify(rows) for rows in parts])
    taylor = Taylor(whole, [True] * len(whole.calls))
    names, values = list[ca.SX](), list[ca.SX]()
    for call, first in zip(whole.calls, taylor.firsts, strict=True):
        found = [substituted(call.arguments, names, values)]
        for function, symbol in zip(call.orders(1), (call.results, first), strict=True):
            found.append(ca.vec(ca.densify(function.call(found, False, True)[0])))  # not inlined
            names.append(symbol)
            values.append(found[-1])
    slopes = (taylor.here(ca.jacobian(taylor.linear(rows), symbols))
              for rows, symbols in zip(whole.expressions, by, strict=True))  # fmt: skip
    return [ca.sparsify(substituted(each, names, values)) for each in slopes]
