"""Lookups: numbers that a model takes from a ground, as symbols of the model.

Inside a cell a bicubic ground is a polynomial. Its coefficients are symbols of the model; a
function finds them for every place, and is constant in each cell. Its derivatives are zero, so that
the model is an SX graph without calls and its derivatives, of any order, are CasADi's own. Any
other function is looked up as its Taylor polynomial about the place itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import inf
from typing import Any, NamedTuple

import casadi as ca

from slipfree.errors import ModelError


class Lookup(NamedTuple):
    """An argument of a function in a model, and the symbols of the result.

    Attributes
    ----------
    question : SX, shape (n, 1)
        Argument of the function, in the symbols of the model and of earlier lookups.
    found : SX, shape (m, 1)
        Symbols of the result, constant with respect to all others.
    function : casadi Function
        From the question to the result; CasADi takes it for constant.
    order : float
        Number of derivatives by the question up to which expressions of the result are those of
        what is looked up: infinite for cells of a bicubic ground.
    """

    question: ca.SX
    found: ca.SX
    function: ca.Function
    order: float


class LookupTable:
    """The lookups of a model while it is made; identical questions share one.

    Attributes
    ----------
    lookups : tuple of Lookup
        In the order in which they were made.
    """

    def __init__(self) -> None:
        self._known: dict[tuple[float, ...], tuple[Lookup, ca.Function]] = {}

    @property
    def lookups(self) -> tuple[Lookup, ...]:
        """All lookups, each after those that its question contains."""
        return tuple(lookup for lookup, _ in self._known.values())

    def find(self, function: ca.Function, question: ca.SX, *, order: float = inf) -> ca.SX:
        """Return the symbols of the result of a function.

        Parameters
        ----------
        function : casadi Function
            From one dense column to one.
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
            self._known[key] = lookup, function  # the hash is that of a living function
        return self._known[key][0].found


def _constant(function: ca.Function) -> ca.Function:
    """Return a function that CasADi takes for constant: it would differentiate through others."""
    at = ca.MX.sym("at", function.sparsity_in(0))
    alone: dict[str, Any] = {"is_diff_in": [False], "is_diff_out": [False], "never_inline": True}
    return ca.Function("lookup", [at], function.call([at]), alone)


def found_column(lookups: Sequence[Lookup]) -> ca.SX:
    """Return the symbols of the results of lookups, a column."""
    return ca.vertcat(ca.SX(0, 1), *(each.found for each in lookups))


def needed_lookups(lookups: Sequence[Lookup], expressions: Sequence[ca.SX]) -> tuple[Lookup, ...]:
    """Return the lookups that expressions depend on, by themselves or by way of questions."""
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
    """Raise ModelError if expressions of lookups do not have derivatives up to an order."""
    least = min((each.order for each in lookups), default=inf)
    if least < order:
        raise ModelError(
            f"{purpose} needs derivatives of the ground up to order {order}, found a lookup whose "
            f"derivatives are right up to order {least:g}; give the ground as a formula or a map"
        )


def substitute_lookups(
    lookups: Sequence[Lookup], symbols: Sequence[ca.SX], values: Sequence[ca.SX]
) -> tuple[tuple[Lookup, ...], list[ca.SX], list[ca.SX]]:
    """Return lookups with values in place of symbols, and the substitution of their results.

    Returns
    -------
    lookups : tuple of Lookup
        With symbols of their own.
    symbols, values : list of SX
        The given ones, and the results of the given lookups with those of the new ones.
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
    """Return the results of lookups where the symbols of a model have given values, a column."""
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
    """Yield ranges of lookups whose questions contain no results of their own range."""
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
    """Return expressions as a function that looks up what they need.

    Parameters
    ----------
    lookups : sequence of Lookup
        Of the model; those that the expressions do not depend on are left out.
    name : str
        Of the function.
    symbols, expressions : sequence of SX
        Its arguments, and its results.
    options : dict, optional
        Of the casadi Function of the expressions.
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
