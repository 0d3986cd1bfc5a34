"""Facts: what a computation found out, by name, with units.

Summaries, JSON output, sweeps, reports and figures render the same facts. A result file stores
those that cannot be computed from its samples.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NamedTuple


class Fact(NamedTuple):
    """A value with its unit and what it is the value of."""

    value: Any  # number, text, or table: a list of rows, each a dict of numbers and texts
    # unit in the spelling of the CF conventions; empty for texts, for tables, and where it depends
    # on the problem, as for costs
    unit: str = ""
    words: str = ""  # description, where the name does not say all


Facts = Mapping[str, Fact]


def encode(facts: Facts) -> str:
    """Return facts as JSON text."""
    return json.dumps(facts)


def decode(text: str) -> dict[str, Fact]:
    """Return the facts in a text of `encode`; raise ValueError for other texts."""
    try:
        return {
            str(name): Fact(value, str(unit), str(words))
            for name, (value, unit, words) in json.loads(text).items()
        }
    except (AttributeError, TypeError, RecursionError) as error:
        raise ValueError(f"expected facts as JSON, found {text[:40]!r}") from error


def numbers(facts: Facts) -> dict[str, Fact]:
    """Return the facts whose values are numbers."""
    return {name: fact for name, fact in facts.items() if isinstance(fact.value, int | float)}


def starting_with(prefix: str, facts: Facts) -> dict[str, Fact]:
    """Return the facts whose names begin with a prefix, by the rest of their names."""
    return {
        name.removeprefix(prefix): fact for name, fact in facts.items() if name.startswith(prefix)
    }
