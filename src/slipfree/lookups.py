"""Lookups: numbers of a ground that are symbols of a model.

Inside a cell a bicubic ground is a polynomial. Its coefficients are symbols of the model; a lookup
function returns them for a position and is constant within each cell. CasADi takes its derivatives
as zero. The model is therefore an SX graph without calls, whose derivatives of any order CasADi
computes. Any other function is looked up as its Taylor polynomial about the position itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf
from typing import Any, NamedTuple

import casadi as ca

from slipfree.errors import ModelError


class Lookup(NamedTuple):
    """A lookup function, its argument in a model, and the symbols of its result.

    Attributes
    ----------
    question : SX, shape (n, 1)
        Argument of the function, in the symbols of the model and of earlier lookups.
    found : SX, shape (m, 1)
        Symbols of the result, constant with respect to all others.
    function : casadi Function
        Function from the argument to the result, constant for CasADi.
    order : float
        Highest order of derivatives by the argument up to which expressions of the result are
        exact; infinite for cells of a bicubic ground.
    """

    question: ca.SX
    found: ca.SX
    function: ca.Function
    order: float


class LookupTable:
    """Table of the lookups of a model under construction; equal arguments share a lookup.

    Attributes
    ----------
    lookups : tuple of Lookup
        The lookups in the order of their creation.
    """

    def __init__(self) -> None:
        self._known: dict[tuple[float, ...], tuple[Lookup, ca.Function]] = {}

    @property
    def lookups(self) -> tuple[Lookup, ...]:
        """All lookups, each after those that its argument contains."""
        return tuple(lookup for lookup, _ in self._known.values())

    def find(self, function: ca.Function, question: ca.SX, *, order: float = inf) -> ca.SX:
        """Return the symbols of the result of a function.

        Parameters
        ----------
        function : casadi Function
            Function from one dense column to one dense column.
        question : SX, shape (n, 1)
            Its argument, in the symbols of the model and of earlier lookups.
        order : float
            See `Lookup`.
        """
        question = ca.densify(question)
        entries = (entry.element_hash() for entry in ca.vertsplit(question))
        key = (hash(function), order, *entries)
        if key not in self._known:
            found = ca.SX.sym(f"found{len(self._known)}", function.numel_out(0))
            lookup = Lookup(question, found, _constant(function), order)
            self._known[key] = lookup, function  # keeps the function alive, and with it the hash
        return self._known[key][0].found


def _constant(function: ca.Function) -> ca.Function:
    """Return a function with zero derivatives, so that CasADi does not differentiate it."""
    at = ca.MX.sym("at", function.sparsity_in(0))
    alone: dict[str, Any] = {"is_diff_in": [False], "is_diff_out": [False], "never_inline": True}
    return ca.Function("lookup", [at], function.call([at]), alone)


def found_column(lookups: Sequence[Lookup]) -> ca.SX:
    """Return the symbols of the results of lookups as a column."""
    return ca.vertcat(ca.SX(0, 1), *(each.found for each in lookups))


def needed_lookups(lookups: Sequence[Lookup], expressions: Sequence[ca.SX]) -> tuple[Lookup, ...]:
    """Return the lookups on which expressions depend, directly or through other lookups."""
    used = _symbols(ca.veccat(ca.SX(0, 1), *expressions))
    needed = list[Lookup]()
    for lookup in reversed(lookups):
        if not used.isdisjoint(_symbols(lookup.found)):
            needed.append(lookup)
            used |= _symbols(lookup.question)
    return tuple(reversed(needed))


def _symbols(expression: ca.SX) -> set[int]:
    """Return the hashes of the symbols of an expression."""
    return {symbol.element_hash() for symbol in ca.symvar(expression)}


def check_order(lookups: Sequence[Lookup], order: int, purpose: str) -> None:
    """Raise ModelError if lookups are not differentiable up to an order."""
    least = min((each.order for each in lookups), default=inf)
    if least < order:
        raise ModelError(
            f"{purpose} needs derivatives of the ground up to order {order}, found a lookup with "
            f"derivatives up to order {least:g}; use a ground given by a formula or a map"
        )


def substitute_lookups(
    lookups: Sequence[Lookup], symbols: Sequence[ca.SX], values: Sequence[ca.SX]
) -> tuple[tuple[Lookup, ...], list[ca.SX], list[ca.SX]]:
    """Return lookups with symbols replaced by values, and the substitution of their results.

    Returns
    -------
    lookups : tuple of Lookup
        New lookups with new symbols of their results.
    symbols, values : list of SX
        The given symbols and values, extended by the results of the given and of the new lookups.
    """
    before, after, new = [*symbols], [*values], list[Lookup]()
    for lookup in lookups:
        (question,) = ca.substitute([lookup.question], before, after)
        found = ca.SX.sym("found", lookup.found.numel())
        new.append(lookup._replace(question=question, found=found))
        before.append(lookup.found)
        after.append(found)
    return tuple(new), before, after


def lookup_results(
    lookups: Sequence[Lookup], symbols: Sequence[ca.SX], given: Sequence[ca.MX]
) -> ca.MX:
    """Return the results of lookups for given values of a model's symbols, as a column."""
    found = ca.MX(0, 1)
    for group in _stages(lookups):
        before = found_column(lookups[: group.start])
        inputs = [*symbols, before]
        questions = ca.Function("questions", inputs, [lookups[k].question for k in group])
        asked = questions.call([*given, found])
        results = (lookups[k].function(at) for k, at in zip(group, asked, strict=True))
        found = ca.vertcat(found, *results)
    return found


def _stages(lookups: Sequence[Lookup]) -> Iterator[range]:
    """Yield ranges of lookups whose arguments contain no results of the same range."""
    start, found = 0, set[int]()
    for k, lookup in enumerate(lookups):
        if not found.isdisjoint(_symbols(lookup.question)):
            yield range(start, k)
            start, found = k, set()
        found |= _symbols(lookup.found)
    if lookups:
        yield range(start, len(lookups))


def lookup_function(
    lookups: Sequence[Lookup],
    name: str,
    symbols: Sequence[ca.SX],
    expressions: Sequence[ca.SX],
    options: dict[str, Any] | None = None,
) -> ca.Function:
    """Return expressions as a function that evaluates the required lookups.

    Parameters
    ----------
    lookups : sequence of Lookup
        Lookups of the model; those on which the expressions do not depend are omitted.
    name : str
        Name of the function.
    symbols, expressions : sequence of SX
        Its arguments and its results.
    options : dict, optional
        Options of the casadi Function.
    """
    needed = needed_lookups(lookups, expressions)
    if not needed:
        return ca.Function(name, [*symbols], [*expressions], options or {})
    plain = ca.Function(
        name,
        [*symbols, found_column(needed)],
        [*expressions],
        {"is_diff_in": [*(True for _ in symbols), False], **(options or {})},
    )
    given = [ca.MX.sym("given", *each.shape) for each in symbols]
    return ca.Function(name, given, plain.call([*given, lookup_results(needed, symbols, given)]))
