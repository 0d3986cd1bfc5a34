"""Data of the figures of a sweep."""

from __future__ import annotations

from typing import NamedTuple

from slipfree.core.records import Array


class Varied(NamedTuple):
    """Key that a sweep varies, with its values.

    Attributes
    ----------
    name : str
        Dotted name of the key.
    unit : str
        Unit of the values, as in ``m s-1``; empty if unknown.
    values : tuple of str
        Values as TOML text, or words without quotes.
    numbers : tuple of float or None
        The values as numbers; None if they are not numbers.
    """

    name: str
    unit: str
    values: tuple[str, ...]
    numbers: tuple[float, ...] | None


class Swept(NamedTuple):
    """A metric over the varied keys.

    Attributes
    ----------
    name : str
        Name of the metric.
    unit : str
        Unit of the metric, as in ``m s-1``; empty if unknown.
    axes : tuple of Varied
        Varied keys.
    values : ndarray, shape (n_1, ..., n_repeat)
        One dimension per axis, and one for repetitions; NaN without a value.
    """

    name: str
    unit: str
    axes: tuple[Varied, ...]
    values: Array
