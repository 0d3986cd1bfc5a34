"""What figures of a sweep show, without what draws them."""

from __future__ import annotations

from typing import NamedTuple

from slipfree.records import Array


class Varied(NamedTuple):
    """What was varied.

    Attributes
    ----------
    name : str
        The key.
    unit : str
        Its unit, as in ``m s-1``; empty if not known.
    values : tuple of str
        Its values as they were given.
    numbers : tuple of float or None
        The same as numbers; None if they are not.
    """

    name: str
    unit: str
    values: tuple[str, ...]
    numbers: tuple[float, ...] | None


class Swept(NamedTuple):
    """A quantity over what was varied.

    Attributes
    ----------
    name : str
        Its name.
    unit : str
        Its unit; empty if not known.
    axes : tuple of Varied
        What was varied.
    values : ndarray, shape (n_1, ..., n_repeat)
        One dimension an axis, and one for repetitions; not a number where there is none.
    """

    name: str
    unit: str
    axes: tuple[Varied, ...]
    values: Array
