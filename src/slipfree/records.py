"""Named vectors: one record type for symbols, start values and results.

A vector such as the state of a model is declared once, as a ``NamedTuple`` of scalars or of
nested records. The same type then carries CasADi symbols while the model is built and numbers
afterwards, so that ``state.contacts[0].x`` means the same thing everywhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import casadi as ca
import numpy as np
import numpy.typing as npt

R = TypeVar("R")
Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Label:
    """What a scalar of a record is called in messages, tables and files.

    Attributes
    ----------
    name : str
        Name of the quantity, such as ``"tilt_right"`` or ``"slip_along"``.
    unit : str
        Unit as CF spells it: ``"m"``, ``"rad"``, ``"m s-1"``, ``"1"``.
    words : str
        One line that says what the quantity is.
    wheel : str or None
        The wheel it belongs to; labels that differ only in the wheel form one quantity.
    """

    name: str
    unit: str
    words: str
    wheel: str | None = None

    @property
    def full(self) -> str:
        """The name with its wheel, as in ``slip_along[front]``."""
        return self.name if self.wheel is None else f"{self.name}[{self.wheel}]"


def leaves(record: Any) -> Iterator[Any]:
    """Yield the scalars of a record, depth first."""
    if isinstance(record, tuple):
        for item in record:
            yield from leaves(item)
    else:
        yield record


def pack(record: Any) -> ca.SX:
    """Return the scalars of a record of symbols as a column."""
    return ca.vertcat(ca.SX(0, 1), *leaves(record))


def unpack(like: R, rows: Iterable[Any]) -> R:
    """Return a record shaped like ``like`` whose scalars are taken from ``rows``."""
    remaining = iter(rows)

    def build(node: Any) -> Any:
        if isinstance(node, tuple):
            children = [build(item) for item in node]
            return type(node)(*children) if hasattr(node, "_fields") else tuple(children)
        return next(remaining)

    result: R = build(like)
    return result


def symbols(labels: R) -> R:
    """Return a record of SX symbols shaped and named like a record of labels."""
    return unpack(labels, [ca.SX.sym(label.full) for label in leaves(labels)])
