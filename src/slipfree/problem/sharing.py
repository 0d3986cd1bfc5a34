"""Maps and models that consecutive problems share, as the runs of a sweep do."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

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
