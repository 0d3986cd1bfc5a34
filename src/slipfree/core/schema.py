"""Schema of dataclasses and functions: bounds and units of numbers, as annotations, and meanings.

A key is a field of a dataclass or a parameter of a function with such an annotation. Its meaning is
that in the docstring. Checks of bounds, tables of TOML files, their reference pages and completion
are made from `keys_of`.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from math import inf
from typing import Annotated, Any, NamedTuple, get_type_hints

from annotated_types import Ge, Gt, Le, Lt, Unit

from slipfree.core.errors import descriptions

Finite = Annotated[float, Gt(-inf), Lt(inf)]
Positive = Annotated[float, Gt(0), Lt(inf)]
NonNegative = Annotated[float, Ge(0), Lt(inf)]
Count = Annotated[int, Ge(1), Le(1_000_000)]
Length = Annotated[Positive, Unit("m")]
Radius = Annotated[NonNegative, Unit("m")]
Position = Annotated[Finite, Unit("m")]
Angle = Annotated[float, Gt(0), Unit("rad")]
Mass = Annotated[NonNegative, Unit("kg")]
Force = Annotated[Finite, Unit("N")]
Factor = Annotated[Positive, Unit("1")]
Stiffness = Annotated[Positive, Unit("N/m")]
KEY = "key"  # annotates a field without bounds and unit, so that it is a key
Flag = Annotated[bool, KEY]
JointConstant = NonNegative  # of springs, dampers and stops: units depend on the joint

BOUNDS: dict[str, tuple[str, Callable[[Any, float], Any]]] = {
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
    known, keys = meanings(kind), list[Key]()
    for name, default in defaults.items():
        notes = getattr(hints[name], "__metadata__", ())
        unit = next((note.unit for note in notes if isinstance(note, Unit)), "")
        meaning = re.split(r"\. | \[[^][]*\]$", known.get(name, ""))[0]
        keys.append(Key(name, hints[name], default, unit, meaning))
    return tuple(keys)


def meanings(kind: Callable[..., Any]) -> dict[str, str]:
    """Return the descriptions of parameters or attributes in a docstring, as phrases, by name.

    Units follow in brackets, as in ``sinkage exponent [1]``.
    """
    found = dict[str, str]()
    for name, words in descriptions(kind).items():
        words = re.sub(r"\.( \[[^][]*\])?$", r"\1", words.replace("`", ""))
        found[name] = words[:1].lower() + words[1:] if re.match("[A-Z][a-z]", words) else words
    return found
