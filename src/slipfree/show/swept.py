"""Metrics of a sweep over its varied keys, to be summarised and drawn."""

from __future__ import annotations

from typing import NamedTuple

from slipfree.core.records import Array


class Varied(NamedTuple):
    """Key that a sweep varies, with its values."""

    name: str  # dotted name
    values: tuple[str, ...]  # as TOML text, or words without quotes
    unit: str = ""  # of the values, as in ``m s-1``; empty if unknown

    @property
    def numbers(self) -> tuple[float, ...] | None:
        """The values as numbers; None if one of them is not a number."""
        try:
            return tuple(map(float, self.values))
        except ValueError:
            return None


class Swept(NamedTuple):
    """A metric over the varied keys."""

    name: str
    unit: str  # as in ``m s-1``; empty if unknown
    axes: tuple[Varied, ...]
    values: Array  # one dimension per axis, and one for repetitions; NaN without a value
