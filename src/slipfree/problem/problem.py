"""A validated problem, the origin of each value, and objects that consecutive problems share."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from slipfree.files.toml.source import Source
from slipfree.problem.schema import CommonKeys, TerrainKeys

T = TypeVar("T")
Shared = dict[str, tuple[Hashable, Any]]

_SHARED: ContextVar[tuple[Shared, str] | None] = ContextVar("_SHARED", default=None)


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


S = TypeVar("S", bound=TerrainKeys)
A = TypeVar("A", bound=CommonKeys)


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
