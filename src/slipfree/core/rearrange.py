"""Rearrangement of models: for example, inputs become unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import repeat
from typing import Any

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae, SampledCheck
from slipfree.core.lookups import needed_lookups, substitute_lookups
from slipfree.core.records import Array, Label, leaves, pack, unpack


@dataclass(frozen=True, eq=False)
class ModelVariable:
    """A state, unknown or input of a model."""

    label: Label  # name, unit and description
    symbol: ca.SX  # symbol in the expressions of the model, shape (1, 1)
    rate: ca.SX  # rate of a state; zero for unknowns and inputs, shape (1, 1)
    # initial guess of an unknown as a function of the states; zero for states and inputs
    guess: ca.SX
    scale: float  # typical size, in the label's unit
    shift: float = 0.0  # map value minus local value, in the label's unit


def variables(dae: Dae) -> tuple[Any, Any, Any]:
    """Return the states, unknowns and inputs of a model as three records of `ModelVariable`."""
    zero = repeat(ca.SX(0))
    x = leaves(dae.labels.x), leaves(dae.x), _entries(dae.ode), zero, dae.sizes.x, dae.shift[0]
    z = leaves(dae.labels.z), leaves(dae.z), zero, _entries(dae.guess), dae.scale, dae.shift[1]
    return (
        unpack(dae.x, map(ModelVariable, *x)),
        unpack(dae.z, map(ModelVariable, *z)),
        unpack(dae.u, map(partial(new_variable, dae), leaves(dae.labels.u), leaves(dae.u))),
    )


def _entries(column: ca.SX) -> list[ca.SX]:
    return ca.vertsplit(column) if column.numel() else []


def new_variable(dae: Dae, label: Label, symbol: ca.SX | None = None) -> ModelVariable:
    """Return a variable with rate, guess and shift zero, and the scale of the label's unit."""
    symbol = ca.SX.sym(label.full) if symbol is None else symbol
    return ModelVariable(label, symbol, ca.SX(0), ca.SX(0), dae.size_of(label))


def rearrange(
    dae: Dae, x: Any, z: Any, u: Any, equations: Sequence[tuple[ca.SX, Sequence[Label]]]
) -> Dae:
    """Return a model with rearranged states, unknowns and inputs.

    ``x``, ``z`` and ``u`` are records of `ModelVariable`, with one record per block of unknowns;
    ``equations`` are the residuals of each block as a column, and their labels. Former states that
    are not states of the new model are zero in initial guesses. In numeric checks, former states
    and unknowns that are neither states nor unknowns of the new model are zero.
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
        held=None,
        alg=tuple(rows for rows, _ in equations),
        labels=dae.labels._replace(
            x=labels[0], z=labels[1], u=labels[2], alg=tuple(tuple(names) for _, names in equations)
        ),
        guess=ca.densify(guess),
        lookups=(*dae.lookups, *lookups),
        scale=np.array([each.scale for each in leaves(z)]),
        shift=(_shifts(x), _shifts(z)),
    )
    known = _hashes((new.x, new.z))
    former = [
        [each if each.element_hash() in known else ca.SX(0) for each in leaves(record)]
        for record in (dae.x, dae.z)
    ]
    states = ca.Function("states", list(new.columns()[:2]), [pack(tuple(each)) for each in former])
    return replace(new, checks=tuple(_RearrangedCheck(check, states) for check in dae.checks))


def substitute(dae: Dae, symbols: Sequence[ca.SX], values: Sequence[ca.SX]) -> Dae:
    """Return a model with symbols replaced by values in equations, quadratures, outputs, limits.

    The symbols remain variables of the model until `rearrange` removes them. Lookups must not
    depend on them.
    """
    before, after = ca.vertcat(ca.SX(0, 1), *symbols), ca.vertcat(ca.SX(0, 1), *values)

    def new(expression: ca.SX) -> ca.SX:
        return ca.substitute(expression, before, after)

    return replace(
        dae,
        ode=new(dae.ode),
        held=None,
        pace=new(dae.pace),
        alg=tuple(new(rows) for rows in dae.alg),
        quad=new(dae.quad),
        linear=None if dae.linear is None else (new(dae.linear[0]), new(dae.linear[1])),
        leading_rates=new(dae.leading_rates),
        y=unpack(dae.y, [new(each) for each in leaves(dae.y)]),
        limits=tuple(limit._replace(expression=new(limit.expression)) for limit in dae.limits),
    )


def blocks(dae: Dae) -> list[tuple[ca.SX, tuple[Label, ...]]]:
    """Return the residuals and labels of each block of algebraic equations of a model."""
    return list(zip(dae.alg, dae.labels.alg, strict=True))


def with_outputs(dae: Dae, outputs: Sequence[tuple[Label, ca.SX]]) -> Dae:
    """Return a model with additional outputs, given as labels and expressions."""
    labels, expressions = (tuple(each[k] for each in outputs) for k in (0, 1))
    return replace(
        dae, y=(dae.y, expressions), labels=dae.labels._replace(y=(dae.labels.y, labels))
    )


def _each(record: Any, name: str) -> Any:
    return unpack(record, [getattr(each, name) for each in leaves(record)])


def _shifts(record: Any) -> Array:
    return np.array([each.shift for each in leaves(record)])


def _hashes(record: Any) -> set[int]:
    return {symbol.element_hash() for symbol in leaves(record)}


@dataclass(frozen=True, eq=False)
class _RearrangedCheck:
    """Check of a model, evaluated at states and unknowns of a rearranged model."""

    check: SampledCheck  # of the original model
    # function from ``x`` and ``z`` of the rearranged model to those of the original model
    states: ca.Function

    @property
    def label(self) -> Label:
        """Name, unit and description of the margin."""
        return self.check.label

    def margin(self, x: Array, z: Array) -> Array:
        """Return the margins, shape (n,), of n states in the columns of ``x`` and ``z``."""
        former = self.states.map(x.shape[1])(x, z)
        return self.check.margin(*(np.array(each) for each in former))

    def describe(self, x: Array, z: Array) -> str:
        """Return a message about the violation in a state of shapes (n_x,) and (n_z,)."""
        return self.check.describe(*(np.array(each).ravel() for each in self.states(x, z)))
