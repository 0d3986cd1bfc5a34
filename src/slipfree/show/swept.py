"""Metrics of a sweep over its varied keys, to be summarised and drawn."""

from __future__ import annotations

from typing import NamedTuple

from slipfree.core.records import Array


class Varied(NamedTuple):
    """Key that a sweep varies, with its values."""

    name: str  # dotted name
    unit: str  # of the values, as in ``m s-1``; empty if unknown
    values: tuple[str, ...]  # as TOML text, or words without quotes
    numbers: tuple[float, ...] | None  # the values, if they are numbers


class Swept(NamedTuple):
    """A metric over the varied keys."""

    name: str
    unit: str  # as in ``m s-1``; empty if unknown
    axes: tuple[Varied, ...]
    values: Array  # one dimension per axis, and one for repetitions; NaN without a value
