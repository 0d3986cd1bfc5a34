"""Rearrangement of models, such as inputs that become unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from slipfree.dae import Dae, SampledCheck
from slipfree.lookups import needed_lookups, substitute_lookups
from slipfree.records import Array, Label, leaves, pack, unpack


@dataclass(frozen=True, eq=False)
class Variable:
    """A symbol of a model with its label and numbers.

    Attributes
    ----------
    label : Label
        Name, unit and description.
    symbol : SX, shape (1, 1)
        The symbol.
    rate, guess : SX, shape (1, 1)
        Rate of a state, and initial guess of an unknown from the states; zero for others.
    scale : float
        Typical size, in the label's unit.
    shift : float
        Map minus local value, in the label's unit.
    """

    label: Label
    symbol: ca.SX
    rate: ca.SX
    guess: ca.SX
    scale: float
    shift: float = 0.0


def variables(dae: Dae) -> tuple[Any, Any, Any]:
    """Return the records of states, unknowns and inputs of a model as records of variables."""
    x = zip(leaves(dae.labels.x), leaves(dae.x), _entries(dae.ode), dae.shift[0], strict=True)
    z = zip(
        leaves(dae.labels.z),
        leaves(dae.z),
        _entries(dae.guess),
        dae.scale,
        dae.shift[1],
        strict=True,
    )
    u = zip(leaves(dae.labels.u), leaves(dae.u), strict=True)
    zero = ca.SX(0)
    return (
        unpack(dae.x, [Variable(n, s, rate, zero, dae.size_of(n), o) for n, s, rate, o in x]),
        unpack(dae.z, [Variable(n, s, zero, guess, size, o) for n, s, guess, size, o in z]),
        unpack(dae.u, [new_variable(dae, label, symbol) for label, symbol in u]),
    )


def _entries(column: ca.SX) -> list[ca.SX]:
    return ca.vertsplit(column) if column.numel() else []


def new_variable(dae: Dae, label: Label, symbol: ca.SX | None = None) -> Variable:
    """Return a variable with a typical scale for a model, by default with a new symbol."""
    symbol = ca.SX.sym(label.full) if symbol is None else symbol
    return Variable(label, symbol, ca.SX(0), ca.SX(0), dae.size_of(label))


def rearrange(
    dae: Dae,
    x: Any,
    z: Any,
    u: Any,
    equations: Sequence[tuple[ca.SX, Sequence[Label]]],
) -> Dae:
    """Return a model with rearranged states, unknowns and inputs.

    Rates, guesses, scales and shifts follow their symbols. In guesses, symbols that are no longer
    states are zero. In checks, symbols that are no longer states or unknowns are zero.

    Parameters
    ----------
    dae : Dae
        The model.
    x, z, u : record of Variable
        States, unknowns in blocks, and inputs.
    equations : sequence of (SX, sequence of Label)
        Residuals of each block of ``z``, and their labels.
    """
    symbols = [_each(record, "symbol") for record in (x, z, u)]
    labels = [_each(record, "label") for record in (x, z, u)]
    kept = _hashes(symbols[0])
    lost = [symbol for symbol in leaves(dae.x) if symbol.element_hash() not in kept]
    guesses = [pack(_each(z, "guess"))]
    needed = needed_lookups(dae.lookups, guesses) if lost else ()
    lookups, before, after = substitute_lookups(needed, lost, [ca.SX(0)] * len(lost))
    guess = ca.substitute(guesses, before, after)[0] if lost else guesses[0]
    new = replace(
        dae,
        x=symbols[0],
        z=symbols[1],
        u=symbols[2],
        ode=pack(_each(x, "rate")),
        alg=tuple(rows for rows, _ in equations),
        labels=dae.labels._replace(
            x=labels[0],
            z=labels[1],
            u=labels[2],
            alg=tuple(tuple(names) for _, names in equations),
        ),
        guess=ca.densify(guess),
        lookups=(*dae.lookups, *lookups),
        scale=np.array([each.scale for each in leaves(z)]),
        shift=(_shifts(x), _shifts(z)),
    )
    return replace(new, checks=_rearranged_checks(dae, new))


def substitute(dae: Dae, symbols: Sequence[ca.SX], values: Sequence[ca.SX]) -> Dae:
    """Return a model with symbols replaced by values in its equations, outputs and limits.

    Lookups must not depend on the symbols. `rearrange` removes the symbols from the inputs.
    """
    before, after = ca.vertcat(ca.SX(0, 1), *symbols), ca.vertcat(ca.SX(0, 1), *values)

    def put(expression: ca.SX) -> ca.SX:
        return ca.substitute(expression, before, after)

    return replace(
        dae,
        ode=put(dae.ode),
        alg=tuple(put(rows) for rows in dae.alg),
        quad=put(dae.quad),
        y=unpack(dae.y, [put(each) for each in leaves(dae.y)]),
        limits=tuple(limit._replace(expression=put(limit.expression)) for limit in dae.limits),
    )


def blocks(dae: Dae) -> list[tuple[ca.SX, tuple[Label, ...]]]:
    """Return the blocks of equations of a model with their labels."""
    return list(zip(dae.alg, dae.labels.alg, strict=True))


def with_outputs(dae: Dae, outputs: Sequence[tuple[Label, ca.SX]]) -> Dae:
    """Return a model with additional outputs."""
    labels, expressions = (tuple(each[k] for each in outputs) for k in (0, 1))
    return replace(
        dae,
        y=(dae.y, expressions),
        labels=dae.labels._replace(y=(dae.labels.y, labels)),
    )


def _each(record: Any, name: str) -> Any:
    """Return the record of an attribute of a record of variables."""
    return unpack(record, [getattr(each, name) for each in leaves(record)])


def _shifts(record: Any) -> Array:
    return np.array([each.shift for each in leaves(record)])


def _hashes(record: Any) -> set[int]:
    return {symbol.element_hash() for symbol in leaves(record)}


@dataclass(frozen=True, eq=False)
class _RearrangedCheck:
    """Check of a model in terms of the states and unknowns of a rearranged model."""

    check: SampledCheck
    states: ca.Function

    @property
    def label(self) -> Label:
        """Name, unit and description of the margin."""
        return self.check.label

    def margin(self, x: Array, z: Array) -> Array:
        """Return the margins of states in columns, shape (n,)."""
        found = self.states.map(x.shape[1])(x, z)
        return self.check.margin(*(np.array(each) for each in found))

    def describe(self, x: Array, z: Array) -> str:
        """Return the description of a violation in a state."""
        return self.check.describe(*(np.array(each).ravel() for each in self.states(x, z)))


def _rearranged_checks(dae: Dae, new: Dae) -> tuple[SampledCheck, ...]:
    """Return the checks of a model for its rearrangement."""
    known = _hashes((new.x, new.z))
    former = [
        [each if each.element_hash() in known else ca.SX(0) for each in leaves(record)]
        for record in (dae.x, dae.z)
    ]
    states = ca.Function("states", list(new.columns()[:2]), [pack(tuple(each)) for each in former])
    return tuple(_RearrangedCheck(check, states) for check in dae.checks)
