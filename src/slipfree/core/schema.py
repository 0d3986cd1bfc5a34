"""Schema of dataclasses and functions: bounds, unit and meaning of numbers, as annotations.

A key is a field of a dataclass or a parameter of a function with such an annotation. Checks of
bounds, tables of TOML files, their reference pages and completion are made from `keys_of`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from numbers import Real
from typing import Annotated, Any, NamedTuple, get_type_hints

import casadi as ca
from annotated_types import DocInfo, Ge, Gt, Unit

from slipfree.core.errors import ModelError

Length = Annotated[float, Gt(0), Unit("m")]
Radius = Annotated[float, Ge(0), Unit("m")]
Position = Annotated[float, Unit("m")]
Angle = Annotated[float, Gt(0), Unit("rad")]
Mass = Annotated[float, Ge(0), Unit("kg")]
Force = Annotated[float, Unit("N")]
Factor = Annotated[float, Gt(0), Unit("1")]
JointConstant = Annotated[float, Ge(0)]  # of springs, dampers and stops: units depend on the joint

BOUNDS: dict[str, tuple[str, Callable[[float, float], bool]]] = {
    "gt": (">", lambda value, edge: value > edge),
    "ge": (">=", lambda value, edge: value >= edge),
    "lt": ("<", lambda value, edge: value < edge),
    "le": ("<=", lambda value, edge: value <= edge),
}


class Key(NamedTuple):
    """Field of a dataclass or parameter of a function."""

    name: str
    hint: Any  # type, with bounds as annotations
    default: Any  # default; ``dataclasses.MISSING`` if a value is required
    unit: str  # unit; empty without one
    meaning: str  # description; empty without one

    @property
    def description(self) -> str:
        """Meaning and unit, as in ``sinkage exponent [1]``."""
        return " ".join(filter(None, [self.meaning, self.unit and f"[{self.unit}]"]))


def keys_of(kind: Callable[..., Any]) -> tuple[Key, ...]:
    """Return the annotated fields of a dataclass, or all parameters of a function."""
    hints = get_type_hints(kind, include_extras=True)
    if is_dataclass(kind):
        defaults = {field.name: field.default for field in fields(kind)}
        defaults = {name: d for name, d in defaults.items() if hasattr(hints[name], "__metadata__")}
    else:
        parameters = inspect.signature(kind).parameters.values()
        defaults = {p.name: MISSING if p.default is p.empty else p.default for p in parameters}
    return tuple(_key(name, hints[name], default) for name, default in defaults.items())


def _key(name: str, hint: Any, default: Any) -> Key:
    notes = getattr(hint, "__metadata__", ())
    unit = next((note.unit for note in notes if isinstance(note, Unit)), "")
    meaning = next((note.documentation for note in notes if isinstance(note, DocInfo)), "")
    return Key(name, hint, default, unit, meaning)


def is_number(value: object) -> bool:
    """Return whether a value is a real number, also one of NumPy."""
    return isinstance(value, Real)


def check_bounds(record: Any) -> None:
    """Raise ModelError if a field of a dataclass violates its annotated bound."""
    for key in keys_of(type(record)):
        value = getattr(record, key.name)
        remedy = "change it" if key.default is MISSING else f"the default is {key.default}"
        if value is None or isinstance(value, ca.SX):  # a parameter
            continue
        for bound in key.hint.__metadata__:
            for name, (sign, holds) in BOUNDS.items():
                edge = getattr(bound, name, None)
                if edge is not None and not (is_number(value) and holds(value, edge)):
                    raise ModelError(
                        f"{type(record).__name__}: {key.name!r}: expected a number {sign} "
                        f"{edge:g}, found {value!r}; {remedy}"
                    )
