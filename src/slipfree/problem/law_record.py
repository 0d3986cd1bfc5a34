"""Schema of the parameters of a law or controller, from the annotations of its dataclass."""

from __future__ import annotations

from dataclasses import MISSING, fields
from functools import cache
from typing import Annotated, Any, get_origin, get_type_hints

from annotated_types import DocInfo, Unit
from pydantic import Field, create_model

from slipfree.files.toml.angles import IN_RADIANS, IN_RADIANS_PER_SECOND
from slipfree.files.toml.types import Record

ANGULAR = {"rad": IN_RADIANS, "rad/s": IN_RADIANS_PER_SECOND}


@cache
def law_record(law: type, base: type[Record] = Record) -> type[Record]:
    """Return the record of a law's parameters, from the annotated fields of its dataclass.

    Keys of ``base`` come first.
    """
    hints = get_type_hints(law, include_extras=True)
    keys: dict[str, Any] = {
        each.name: (
            _with_unit(hints[each.name]),
            Field(
                default=... if each.default is MISSING else each.default,
                description=_description(hints[each.name]),
            ),
        )
        for each in fields(law)
        if hasattr(hints[each.name], "__metadata__")
    }
    words = (law.__doc__ or "").partition("\n")[0]
    return create_model(law.__name__, __base__=base, __doc__=words, **keys)


def _with_unit(hint: Any) -> Any:
    """Return the annotation of a parameter; angles accept "30 deg" as well, and tuples arrays."""
    if get_origin(getattr(hint, "__origin__", None)) is tuple:
        return Annotated[hint, Field(strict=False)]
    for each in getattr(hint, "__metadata__", ()):
        if isinstance(each, Unit) and each.unit in ANGULAR:
            return Annotated[hint, ANGULAR[each.unit]]
    return hint


def _description(hint: Any) -> str:
    """Return the description and unit in the annotation of a parameter."""
    metadata = getattr(hint, "__metadata__", ())
    words = [each.documentation for each in metadata if isinstance(each, DocInfo)]
    return " ".join([*words, *(f"[{each.unit}]" for each in metadata if isinstance(each, Unit))])


def given_values(table: Record) -> dict[str, Any]:
    """Return the values that a file gives for the keys of a table, without defaults."""
    return {name: getattr(table, name) for name in table.model_fields_set}
