"""Bounds of numbers in records, as annotations of their fields."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from typing import Any, get_type_hints

import casadi as ca

from slipfree.core.errors import ModelError

BOUNDS: dict[str, tuple[str, Callable[[float, float], bool]]] = {
    "gt": (">", lambda value, edge: value > edge),
    "ge": (">=", lambda value, edge: value >= edge),
    "lt": ("<", lambda value, edge: value < edge),
    "le": ("<=", lambda value, edge: value <= edge),
}


def check_bounds(record: Any) -> None:
    """Raise ModelError if a field of a dataclass violates its annotated bound.

    Each field must have a default, which the message contains.
    """
    hints = get_type_hints(type(record), include_extras=True)
    for field in fields(record):
        value, annotation = getattr(record, field.name), hints[field.name]
        if isinstance(value, ca.SX):  # a parameter
            continue
        for bound in getattr(annotation, "__metadata__", ()):
            for key, (sign, holds) in BOUNDS.items():
                edge = getattr(bound, key, None)
                if edge is not None and not holds(value, edge):
                    raise ModelError(
                        f"{type(record).__name__}: {field.name!r}: expected a number {sign} "
                        f"{edge:g}, found {value}; the default is {field.default}"
                    )
