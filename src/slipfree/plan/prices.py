"""Compute shadow prices of limits: decrease of the optimal cost per unit by which a limit widens.

A multiplier is the derivative of the optimal cost with respect to its bound (Nocedal and Wright,
Numerical Optimization, 2nd ed., section 12.8). A limit bounds a quantity at all points of the mesh;
its price is the sum of the multipliers at these points.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.records import Array, Label, field_overview
from slipfree.plan.constraints import (
    COST,
    EQUATION,
    INPUT,
    LIMIT,
    ConstraintGroup,
    constraint_groups,
)
from slipfree.plan.ipopt import IPOPT_TOLERANCE, Solution
from slipfree.plan.messages import DURATION, number, subject
from slipfree.plan.optimality import active_set
from slipfree.plan.transcription import Index, Program

STEP_FRACTION = 0.01  # change of a bound in messages, relative to its power of ten; in m for goals
MAX_NAMED_PRICES = 5  # number of prices in a message
MIN_SHARE = 1e-4  # smallest reported saving by a step, relative to the cost
AT_MOST, AT_LEAST, VALUE = "at most", "at least", "value"


class Price(NamedTuple):
    """Shadow price of a limit of a plan: derivative of the optimal cost with respect to its bound.

    Attributes
    ----------
    label : Label
        Label of the limited quantity, without wheel: the price is the sum over all wheels.
    role : str
        Kind of limit: ``"limit"``, ``"input"``, ``"goal"``, ``"duration"``, ``"cost"``, or for a
        way-point its name, for example ``"way-point at 0.5"``.
    side : str
        Side of the bound: ``"at most"``, ``"at least"``, or ``"value"`` for equal bounds.
    bound : float
        Value of the bound as reported (`Dae.reported`), in the label's unit.
    rate : float
        Derivative of the optimal cost with respect to the bound, per unit of the label.
    share : float
        ``rate`` divided by the cost of the plan. [1/unit of the label]
    active : int
        Number of active points, summed over the points of the mesh and the wheels.
    """

    label: Label
    role: str
    side: str
    bound: float
    rate: float
    share: float
    active: int

    def __repr__(self) -> str:
        return field_overview(self)

    @property
    def step(self) -> float:
        """Small change of the bound for which `words` gives the saving, in the label's unit."""
        if self.role not in (LIMIT, INPUT, DURATION, COST) or not self.bound:
            return STEP_FRACTION
        return float(STEP_FRACTION * 10.0 ** np.floor(np.log10(abs(self.bound))))

    @property
    def words(self) -> str:
        """Relative saving of cost for a small change of the bound, as a sentence."""
        side = "" if self.side == VALUE else f" {self.side}"
        more = "more" if self.rate < 0 else "less"
        return (
            f"{subject(self.label, self.role)}{side} {number(self.label, self.bound)}: "
            f"{number(self.label, self.step)} {more} saves "
            f"{100 * abs(self.share) * self.step:.2g} % of the cost"
        )


def limit_prices(program: Program, solution: Solution) -> tuple[Price, ...]:
    """Return the shadow prices of the active limits of a solution, largest saving per step first.

    Parameters
    ----------
    program : Program
        From `transcribe`.
    solution : Solution
        Solution of the program; shares are relative to its cost.
    """
    multipliers = np.append(solution.row_multipliers, solution.bound_multipliers / program.scale)
    active = np.append(*active_set(program, solution)[:2])
    found: dict[tuple[str, ...], Price] = {}
    for group in _limit_groups(program):
        for side, bound, where in _sides(program, group, multipliers):
            count = int(active[where].sum())
            if not count:
                continue
            rate = -float(multipliers[where].sum())
            label = replace(group.label, wheel=None)
            share = rate / max(abs(solution.cost), IPOPT_TOLERANCE)
            new = Price(label, group.role, side, bound + group.shift, rate, share, count)
            key = group.role, label.name, side, f"{bound}"
            old = found.get(key)
            if old is not None:
                new = new._replace(
                    rate=old.rate + rate, share=old.share + share, active=old.active + count
                )
            found[key] = new
    return tuple(sorted(found.values(), key=lambda price: -abs(price.share) * price.step))


def price_rows(prices: Sequence[Price]) -> list[dict[str, Any]]:
    """Return prices as rows of a table for files."""
    return [
        {
            "quantity": price.label.name,
            "unit": price.label.unit,
            **{name: getattr(price, name) for name in Price._fields[1:]},
        }
        for price in prices
    ]


def prices_words(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a text with the largest prices in a table, at most five, and the number of the others.

    Prices are omitted if a small change of the bound saves less than 0.01 % of the cost.
    """
    prices = [
        Price(Label(row["quantity"], row["unit"], ""), *(row[name] for name in Price._fields[1:]))
        for row in rows
    ]
    named = [each.words for each in prices if abs(each.share) * each.step >= MIN_SHARE]
    if not named:
        return "no limit increases the cost noticeably"
    more = max(len(named) - MAX_NAMED_PRICES, 0)
    rest = f"; {more} more limit{'s' * (more > 1)}" if more else ""
    return "; ".join(named[:MAX_NAMED_PRICES]) + rest


def _limit_groups(program: Program) -> Iterator[ConstraintGroup]:
    """Yield the constraints of a program except equations, and the bounds of its duration."""
    for group in constraint_groups(program):
        if group.role != EQUATION:
            yield group
    at = np.array([program.g_lower.size + program.layout.duration])
    label, none = Label(DURATION, "s", "duration"), np.zeros(1, dtype=np.intp)
    yield ConstraintGroup(label, DURATION, at, none, np.ones(1), *program.task.duration, 0.0)


def _sides(
    program: Program, group: ConstraintGroup, multipliers: Array
) -> Iterator[tuple[str, float, Index]]:
    """Yield side, bound and indices into rows and unknowns for each side of a limit.

    Points at which the program has a narrower bound are omitted.
    """
    lower = np.append(program.g_lower, program.lower)[group.where]
    upper = np.append(program.g_upper, program.upper)[group.where]
    prices = multipliers[group.where]
    if group.lower == group.upper:
        yield VALUE, group.lower, group.where
        return
    yield AT_LEAST, group.lower, group.where[(lower == group.lower) & (prices < 0)]
    yield AT_MOST, group.upper, group.where[(upper == group.upper) & (prices > 0)]
