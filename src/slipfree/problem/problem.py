"""Validated problems, the origin of each value, and objects that consecutive problems share."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from copy import deepcopy
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import ValidationError

from slipfree.files import toml
from slipfree.problem.schema import CommonKeys, FileKeys, TerrainKeys

T = TypeVar("T")
Shared = dict[str, tuple[Hashable, Any]]

_SHARED: ContextVar[tuple[Shared, str] | None] = ContextVar("_SHARED", default=None)
S = TypeVar("S", bound=TerrainKeys)
A = TypeVar("A", bound=CommonKeys)


@contextmanager
def sharing(kept: Shared, files: str) -> Iterator[None]:
    """Let the problems of the block share the objects that `shared` returns.

    ``kept`` has the latest object of each kind, also for later blocks. ``files`` identifies the
    content of all input files, which must not change within the block.
    """
    token = _SHARED.set((kept, files))
    try:
        yield
    finally:
        _SHARED.reset(token)


def shared(kind: str, key: Hashable, make: Callable[[], T]) -> T:
    """Return an object, made now or, within `sharing`, kept from an earlier call.

    At most one object of each ``kind`` is kept. ``key`` has all values on which it depends, except
    the content of input files.
    """
    sharing_now = _SHARED.get()
    if sharing_now is None:
        return make()
    kept, files = sharing_now
    key = files, key
    if kind not in kept or kept[kind][0] != key:
        kept.pop(kind, None)  # so that at most one exists
        kept[kind] = key, make()
    value: T = kept[kind][1]
    return value


@dataclass(frozen=True)
class Problem(Generic[A]):
    """A validated problem, and the origin of each value."""

    spec: A  # values of the file, a record of the schema of its verb
    source: toml.Source  # file, lines and settings of the values
    trusted: frozenset[str] = frozenset()  # xacro files; only the command line can trust them
    # contents of the vehicle files that were read, by name; of a result those stored in it
    vehicles: dict[str, Any] = field(default_factory=dict, compare=False, repr=False)
    # smallest and largest values of large maps, by file, which are then read by windows
    extremes: dict[str, Any] | None = field(default=None, compare=False, repr=False)
    # ground in a result, and the key 'friction' that belongs to it, by its table as JSON
    grounds: Mapping[str, Any] = field(default_factory=dict, compare=False, repr=False)

    def __repr__(self) -> str:
        return f"Problem: {self.spec.verb}, {self.source.path}"

    @property
    def folder(self) -> Path:
        """Folder of the problem file, to which the names of input files are relative."""
        return self.source.path.parent

    def refuse(self, *faults: toml.Fault) -> None:
        """Raise ProblemError with the messages of all errors, sorted by line, if there are any."""
        if faults:
            raise toml.problem_error(self.source, faults)


def validated_problem(
    schema_of: Callable[[Mapping[str, Any], toml.Source], type[FileKeys]],
    path: Path,
    text: str,
    settings: Sequence[str],
    varied: Sequence[str] = (),
) -> Problem[Any]:
    """Return the problem in the text of a TOML file; ``varied`` are settings of ``--vary``.

    ``schema_of(data, source)`` returns the schema of a file with the given data. ProblemError is
    raised if the text is not TOML, a setting has no valid form, or values do not fit the schema;
    all errors of values, sorted by line.
    """
    data = deepcopy(_parsed(path, text))
    places = toml.replace_values(data, settings)
    varied_places = toml.replace_values(data, varied, "--vary")
    source = toml.Source(
        path, text, toml.key_lines(text), places | varied_places, frozenset(varied_places)
    )
    schema = schema_of(data, source)
    faults = list[toml.Fault]()
    try:
        spec = schema.model_validate(data)
    except ValidationError as error:
        wrong = dict[toml.Place, toml.Fault]()
        for each in error.errors(include_url=False):
            fault = toml.validation_fault(schema, data, dict(each))
            if other := wrong.get(fault.place):  # the error of another alternative
                fault = other._replace(expected=f"{other.expected}, or {fault.expected}")
            wrong[fault.place] = fault
        faults += wrong.values()
    else:
        faults += [*toml.value_errors(data), *spec.faults()]
        if not faults:
            return Problem(spec, source)
    raise toml.problem_error(source, faults)


_parsed = lru_cache(maxsize=1)(toml.parse_toml)  # all variants of a problem have the same text
