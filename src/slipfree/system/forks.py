"""Threads: forks that wait until no other thread computes, properties without locks, one thread.

A forked child has a single thread. Locks of CasADi, functools and the linear algebra library that
other threads held at the fork stay locked in the child forever. OpenBLAS can even hang in ``fork``
itself, since it waits for computing threads. Linear algebra of small matrices is faster in one
thread.
"""

from __future__ import annotations

import functools
import os
import threading
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any, ParamSpec, TypeVar

from slipfree.core.errors import SlipfreeError

P = ParamSpec("P")
R = TypeVar("R")

# environment variables with the number of threads of linear algebra
THREAD_COUNTS = (
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"),
    *("MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"),
)
MAX_WAIT = 10.0  # longest delay of a fork [s]


class _Forks:
    """Record of the threads that compute and of the forks that wait for them.

    ``changed`` is the lock of this record, for whose changes threads wait; ``depths`` the number of
    nested calls of `computing` functions by thread, ``waiting`` the number of forks that wait, and
    ``unsafe`` whether this process was forked while another thread computed.
    """

    def __init__(self) -> None:
        self.changed = threading.Condition()
        self.depths: dict[int, int] = {}
        self.waiting = 0
        self.unsafe = False

    def enter(self) -> None:
        """Count this thread as computing; wait first for forks, unless it computes already."""
        me = threading.get_ident()
        with self.changed:
            if me not in self.depths:
                self.changed.wait_for(lambda: not self.waiting)
            self.depths[me] = self.depths.get(me, 0) + 1

    def leave(self) -> None:
        """End a call of this thread; forks may continue after its outermost one."""
        me = threading.get_ident()
        with self.changed:
            self.depths[me] -= 1
            if not self.depths[me]:
                del self.depths[me]
                self.changed.notify_all()

    def before(self) -> None:
        """Wait before a fork until no other thread computes, for at most 10 s."""
        self.changed.acquire()
        self.waiting += 1
        self.changed.wait_for(self._is_alone, MAX_WAIT)

    def in_parent(self) -> None:
        self.waiting -= 1
        self.changed.notify_all()
        self.changed.release()

    def in_child(self) -> None:
        """Reset the record in a forked child, which has only this thread."""
        me = threading.get_ident()
        unsafe = self.unsafe or not self._is_alone()
        self.changed = threading.Condition()
        self.depths = {each: depth for each, depth in self.depths.items() if each == me}
        self.waiting, self.unsafe = 0, unsafe

    def _is_alone(self) -> bool:
        return self.depths.keys() <= {threading.get_ident()}


_forks = _Forks()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_forks.before, after_in_parent=_forks.in_parent, after_in_child=_forks.in_child
    )


def computing(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function so that forks by other threads wait until its calls end.

    A fork waits for at most 10 s. Raises SlipfreeError if the function is called in a process that
    was forked while another thread computed.
    """

    @functools.wraps(function)
    def alone(*args: P.args, **more: P.kwargs) -> R:
        """Call the function; forks by other threads wait until it returns."""
        if _forks.unsafe:
            raise SlipfreeError(
                "expected a process that was not forked during a computation, found one forked "
                "while another thread computed; start processes with "
                "multiprocessing.get_context('spawn')"
            )
        _forks.enter()
        try:
            return function(*args, **more)
        finally:
            _forks.leave()

    return alone


class cached_property(functools.cached_property[R]):  # noqa: N801 - as in functools
    """`functools.cached_property` without the lock that it has in Python 3.11.

    Two threads may both compute the value; both values are equal.
    """

    def __init__(self, function: Callable[[Any], R]) -> None:
        super().__init__(function)
        self.lock = nullcontext()


def single_thread() -> None:
    """Set the number of threads of linear algebra to one, unless the user has set it.

    This has an effect only before numpy is imported.
    """
    for name in THREAD_COUNTS:
        os.environ.setdefault(name, "1")
