"""Ctrl-C, and what callbacks raise, while code runs in which exceptions get lost.

CasADi turns an exception out of a callback, or out of the handler of a signal that arrives in its
own code, into an error of its own, a step that is tried again, an end of the search, or nothing.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from types import FrameType, TracebackType
from typing import Any, ParamSpec, Self, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class InterruptGuard:
    """A context that keeps what the handler of SIGINT raises, and raises it at its end.

    There it comes in place of any other ``Exception``. A handler that raises nothing, as one that
    only remembers, stays what it is. A context within another shares what it keeps. Outside the
    main thread, where no handler runs, only what callbacks raise is kept.
    """

    def __init__(self) -> None:
        self._kept: list[BaseException] = []  # one at most
        self._former: Callable[[int, FrameType | None], Any] | None = None

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            former = signal.getsignal(signal.SIGINT)
            around = getattr(former, "__self__", None)
            if isinstance(around, InterruptGuard):
                self._kept = around._kept
            elif callable(former):
                self._former = former
                signal.signal(signal.SIGINT, self._handle)
        return self

    def __exit__(
        self, _: type[BaseException] | None, error: BaseException | None, __: TracebackType | None
    ) -> None:
        if self._former is not None:
            signal.signal(signal.SIGINT, self._former)
        if (error is None or isinstance(error, Exception)) and error not in self._kept:
            self.check()
        self._kept.clear()

    def check(self) -> None:
        """Raise what was raised before and got lost, if anything did."""
        if self._kept:
            error = self._kept.pop()
            raise error from error.__cause__

    def call(self, function: Callable[P, R], *args: P.args, **more: P.kwargs) -> R:
        """Return what a function returns, called in a callback: what it raises is kept.

        What was raised before ends the callback at once. What is raised in the function and dealt
        with there is forgotten.
        """
        if self._kept:
            raise self._kept[0]
        try:
            result = function(*args, **more)
        except BaseException as error:
            self.keep(error)
            raise
        self._kept.clear()
        return result

    def keep(self, error: BaseException) -> None:
        """Keep what was raised in a callback; it may be what became of an interruption."""
        if not self._kept or not isinstance(error, Exception):
            self._kept[:] = [error]

    def _handle(self, number: int, frame: FrameType | None) -> None:
        try:
            if self._former is not None:
                self._former(number, frame)
        except BaseException as error:
            self._kept[:] = [error]
            # Raised there, it would keep a handler from its place, which Python code puts there.
            while frame is not None:
                if frame.f_code in (_ENTER, _EXIT):
                    return
                frame = frame.f_back
            raise


_ENTER, _EXIT = InterruptGuard.__enter__.__code__, InterruptGuard.__exit__.__code__


def heeded(function: Callable[P, R]) -> Callable[P, R]:
    """Return the same function, in which no Ctrl-C gets lost."""

    @wraps(function)
    def within(*args: P.args, **more: P.kwargs) -> R:
        with InterruptGuard():
            return function(*args, **more)

    return within


@contextmanager
def ended_by_interrupt(end: Callable[[], object]) -> Iterator[None]:
    """Call a function at Ctrl-C, before its handler, and raise KeyboardInterrupt at the end.

    Also where the handler raises nothing: for waiting, in which nobody asks whether it was pressed.
    """
    former, pressed = signal.getsignal(signal.SIGINT), False
    if threading.current_thread() is not threading.main_thread() or not callable(former):
        yield
        return

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal pressed
        pressed = True
        end()
        former(number, frame)

    signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, former)
        if pressed:
            raise KeyboardInterrupt
