"""Validation of problem files by the schema of their verb, with all errors at once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from slipfree.files.toml.errors import Fault, problem_error, validation_fault, value_errors
from slipfree.files.toml.reader import parse_toml
from slipfree.files.toml.settings import replace_values
from slipfree.files.toml.source_lines import Source, key_lines
from slipfree.problem.problem import Problem
from slipfree.problem.schema import CommonKeys


def validated_problem(
    schema_of: Callable[[Mapping[str, Any], Source], type[CommonKeys]],
    path: Path,
    text: str,
    settings: Sequence[str],
    varied: Sequence[str] = (),
) -> Problem[Any]:
    """Return the problem in the text of a TOML file.

    Parameters
    ----------
    schema_of : callable
        ``schema_of(data, source)`` returns the schema of a file with the given data.
    path, text : Path and str
        Path and text of the file.
    settings, varied : sequence of str
        Settings of the options ``--set`` and ``--vary``.

    Raises
    ------
    ProblemError
        If the text is not TOML, a setting has no valid form, or values do not fit the schema; all
        errors of values, sorted by line.
    """
    data = _copy(_parsed(path, text))
    places = replace_values(data, settings)
    varied_places = replace_values(data, varied, "--vary")
    source = Source(path, text, key_lines(text), places | varied_places, frozenset(varied_places))
    schema = schema_of(data, source)
    faults = [*_alternatives(schema, data)]
    try:
        spec = schema.model_validate(data)
    except ValidationError as error:
        faults += [validation_fault(schema, dict(each)) for each in error.errors(include_url=False)]
    else:
        faults += [*value_errors(data), *spec.faults()]
        if not faults:
            return Problem(spec, source)
    raise problem_error(source, faults)


@lru_cache(maxsize=1)
def _parsed(path: Path, text: str) -> dict[str, Any]:
    """Return the data in a TOML text, cached because all variants of a problem have this text."""
    return parse_toml(path, text)


def _copy(value: Any) -> Any:
    """Return a copy of parsed TOML."""
    if isinstance(value, dict):
        return {key: _copy(each) for key, each in value.items()}
    return [*map(_copy, value)] if isinstance(value, list) else value


def _alternatives(schema: type[CommonKeys], data: dict[str, Any]) -> Iterator[Fault]:
    """Yield an error for each table that does not have exactly one of its alternative keys."""
    for place, keys in schema.alternatives.items():
        table: Any = data
        for part in place:
            table = table.get(part)
        if not isinstance(table, Mapping):
            continue
        given = [key for key in keys if key in table]
        expected = f"exactly one of {', '.join(keys)}"
        if len(given) != 1:
            yield Fault((*place, *given[-1:]), expected, " and ".join(given) or "none")
