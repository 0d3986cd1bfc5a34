"""Error messages for TOML files: location, expected value and found value."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import inf
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel

from slipfree.errors import DataError
from slipfree.files.toml.source_lines import Place, Source


class ProblemError(DataError):
    """Error in a TOML file, with one message per invalid value.

    Attributes
    ----------
    faults : tuple of str
        One line per error: location, expected and found value.
    """

    def __init__(self, *faults: str) -> None:
        shown, rest = faults[:MAX_ERRORS], len(faults) - MAX_ERRORS
        more = [f"and {rest} more error{'s' * (rest > 1)}"] if rest > 0 else []
        super().__init__("\n".join((*shown, *more)))
        self.faults = faults


MAX_ERRORS = 50  # largest number of errors in a message
MAX_SHOWN_NUMBER = 1e300  # larger integers are described by their number of bits
MAX_VALUE = 1e100  # largest quantity; its squares and cubes are finite
MAX_LISTED = 60  # largest number of names in a message
MAX_SHOWN_DEPTH = 3  # nesting up to which arrays are shown
EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "string_type": "text in quotes",
    "string_too_short": "text that is not empty",
    "bool_type": "true or false",
    "model_type": "a table",
    "dict_type": "a table",
    "tuple_type": "an array",
    "finite_number": "a finite number",
    "greater_than": "a number greater than {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than": "a number less than {lt:g}",
    "less_than_equal": "a number of at most {le:g}",
    "literal_error": "{expected}",
    "too_long": "an array of {max_length} elements",
}


class Fault(NamedTuple):
    """One error in a TOML file.

    Attributes
    ----------
    place : tuple of str or int
        Location of the value: names of nested keys, and indices of array elements.
    expected, found : str
        Descriptions of the expected and the found value.
    hint : str
        Suggestion at the start of the message, such as a similar key; empty without one.
    """

    place: Place
    expected: str
    found: str
    hint: str = ""


def problem_error(source: Source, faults: Iterable[Fault]) -> ProblemError:
    """Return an exception with the messages of all errors, in the order of their lines."""
    ordered = sorted(faults, key=lambda fault: source.order(fault.place))
    return ProblemError(
        *(
            f"{source.where(f.place)}: {f.hint}expected {f.expected}, found {f.found}"
            for f in ordered
        )
    )


def name_errors(place: Place, given: Iterable[str], known: Sequence[str]) -> Iterator[Fault]:
    """Yield an error for each unknown name, with the most similar known name."""
    for name in given:
        if name not in known:
            yield _unknown((*place, name), known)


def value_errors(value: Any, place: Place = ()) -> Iterator[Fault]:
    """Yield an error for each finite number with an absolute value above 1e100."""
    if isinstance(value, Mapping | list):
        parts = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, part in parts:
            yield from value_errors(part, (*place, key))
    elif isinstance(value, float | int) and MAX_VALUE < abs(value) < inf:
        expected = f"a number with an absolute value of at most {MAX_VALUE:g}"
        yield Fault(place, expected, format_value(value))


def validation_fault(schema: type[BaseModel], error: dict[str, Any]) -> Fault:
    """Return a validation error of pydantic as a `Fault`: key, expected and found value."""
    place, kind = tuple(error["loc"]), error["type"]
    found = "none" if kind == "missing" else format_value(error["input"])
    if kind == "extra_forbidden":
        model = record_at(schema, place[:-1])
        return _unknown(place, list(model.model_fields))
    if kind == "missing" and isinstance(place[-1], int):
        return Fault(place, "a number", found)
    if kind == "missing":
        wanted = record_at(schema, place[:-1]).model_fields[place[-1]].annotation
        table = isinstance(wanted, type) and issubclass(wanted, BaseModel)
        table |= str(wanted).startswith("dict")
        return Fault(place, f"a table [{place[-1]}]" if table else "a value", found)
    words = EXPECTED.get(kind)
    details = error.get("ctx", {})
    expected = words.format(**details) if words else error["msg"]
    return Fault(place, expected, found, details.get("hint", ""))


def _unknown(place: Place, known: Sequence[str]) -> Fault:
    """Return the error for an unknown key."""
    name = str(place[-1])
    expected = f"one of {listed(known)}" if known else "no key"
    return Fault(place, expected, f"the unknown key {_cut(name)!r}", similar_hint(name, known))


def similar_hint(name: str, known: Sequence[str]) -> str:
    """Return a suggestion of the most similar known name; empty without a similar one."""
    nearest = difflib.get_close_matches(name, known, n=1)
    return f"did you mean {nearest[0]!r}? " if nearest else ""


def listed(known: Sequence[str]) -> str:
    """Return names separated by commas: at most 60, then the number of further names."""
    more = len(known) - MAX_LISTED
    return ", ".join(known[:MAX_LISTED]) + (f" and {more} more" if more > 0 else "")


def record_at(schema: type[BaseModel], place: Place) -> type[BaseModel]:
    """Return the schema of the nested table at ``place`` in the schema of a file."""
    model = schema
    for part in place:
        if isinstance(part, int):
            continue  # index in an array of tables
        model = next(_records(model.model_fields[str(part)].annotation))
    return model


def _records(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the record types in an annotation, such as an optional array of records."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _records(part)


def _cut(text: str) -> str:
    return text if len(text) < 40 else text[:37] + "..."


def format_value(value: Any, deepest: int = MAX_SHOWN_DEPTH) -> str:
    """Return a shortened text of a value for messages."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return repr(_cut(value))
    if isinstance(value, int) and abs(value) >= MAX_SHOWN_NUMBER:
        return f"a whole number of {value.bit_length()} bits"
    if isinstance(value, float | int):
        return f"{value:.12g}"
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list):
        parts = [format_value(each, deepest - 1) for each in value[:4] if deepest]
        return f"[{', '.join([*parts, *['...'] * (len(value) > len(parts))])}]"
    return str(value)
