"""Validated problems, the origin of each value, and objects that consecutive problems share."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import ValidationError

from slipfree.files.toml.source import (
    Fault,
    Source,
    key_lines,
    parse_toml,
    problem_error,
    replace_values,
    validation_fault,
    value_errors,
)
from slipfree.problem.schema import CommonKeys, TerrainKeys

T = TypeVar("T")
Shared = dict[str, tuple[Hashable, Any]]

_SHARED: ContextVar[tuple[Shared, str] | None] = ContextVar("_SHARED", default=None)
S = TypeVar("S", bound=TerrainKeys)
A = TypeVar("A", bound=CommonKeys)


@contextmanager
def sharing(kept: Shared, files: str) -> Iterator[None]:
    """Let the problems of the block share the objects that `shared` returns.

    Parameters
    ----------
    kept : dict
        The latest object of each kind; the same dictionary serves several blocks.
    files : str
        Identifier of the content of all input files, which must not change within the block.
    """
    token = _SHARED.set((kept, files))
    try:
        yield
    finally:
        _SHARED.reset(token)


def shared(kind: str, key: Hashable, make: Callable[[], T]) -> T:
    """Return an object, made now or, within `sharing`, kept from an earlier call.

    Parameters
    ----------
    kind : str
        Kind of the object; at most one of each kind is kept.
    key : hashable
        Values that the object depends on, except the content of input files.
    make : callable
        Function that returns the object.
    """
    sharing_now = _SHARED.get()
    if sharing_now is None:
        return make()
    kept, files = sharing_now
    key = files, key
    if kind not in kept or kept[kind][0] != key:
        kept.pop(kind, None)  # so that at most one exists
        kept[kind] = key, make()
    found: T = kept[kind][1]
    return found


@dataclass(frozen=True)
class Problem(Generic[A]):
    """A validated problem, and the origin of each value.

    Attributes
    ----------
    spec : CommonKeys
        Values of the problem file, a record of the schema of its verb.
    source : Source
        File, lines and settings of the values.
    trusted : frozenset of str
        Paths of xacro files that the command line allows to be expanded; no file can do so.
    vehicles : dict
        Contents of the vehicle files that were read, by name. Those of a result are stored in it,
        so that none is read.
    """

    spec: A
    source: Source
    trusted: frozenset[str] = frozenset()
    vehicles: dict[str, Any] = field(default_factory=dict, compare=False, repr=False)

    def __repr__(self) -> str:
        return f"Problem: {self.spec.verb}, {self.source.path}"

    @property
    def folder(self) -> Path:
        """Folder of the problem file, to which the names of input files are relative."""
        return self.source.path.parent


def validated_problem(
    schema_of: Callable[[Mapping[str, Any], Source], type[CommonKeys]],
    path: Path,
    text: str,
    settings: Sequence[str],
    varied: Sequence[str] = (),
) -> Problem[Any]:
    """Return the problem in the text of a TOML file.

    ProblemError is raised if the text is not TOML, a setting has no valid form, or values do not
    fit the schema; all errors of values, sorted by line.

    Parameters
    ----------
    schema_of : callable
        ``schema_of(data, source)`` returns the schema of a file with the given data.
    path, text : Path and str
        Path and text of the file.
    settings, varied : sequence of str
        Settings of the options ``--set`` and ``--vary``.
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
        faults += [
            validation_fault(schema, data, dict(each)) for each in error.errors(include_url=False)
        ]
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
