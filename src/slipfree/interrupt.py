"""Ctrl-C, and what callbacks raise, while code runs in which exceptions get lost.

CasADi turns an exception out of a callback, or out of the handler of a signal that arrives in its
own code, into an error of its own, a step that is tried again, an end of the search, or nothing.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from functools import wraps
from types import FrameType, TracebackType
from typing import Any, ParamSpec, Self, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class Heed:
    """A context that keeps what the handler of SIGINT raises, and raises it at its end.

    There it comes in place of any other ``Exception``. A handler that raises nothing, as one that
    only remembers, stays what it is. Outside the main thread, where no handler runs, only what
    callbacks raise is kept.

    Attributes
    ----------
    raised : BaseException or None
        What was raised, and was not dealt with.
    """

    def __init__(self) -> None:
        self.raised: BaseException | None = None
        self._former: Callable[[int, FrameType | None], Any] | None = None
        self._within = False

    def __enter__(self) -> Self:
        former = signal.getsignal(signal.SIGINT)
        if threading.current_thread() is threading.main_thread() and callable(former):
            self._former = former
            signal.signal(signal.SIGINT, self._handle)
        self._within = True
        return self

    def __exit__(
        self, _: type[BaseException] | None, error: BaseException | None, __: TracebackType | None
    ) -> None:
        self._within = False  # what came now would keep the former handler from its place
        if self._former is not None:
            signal.signal(signal.SIGINT, self._former)
        if error is None or (isinstance(error, Exception) and error is not self.raised):
            self.check()

    def check(self) -> None:
        """Raise what was raised before and got lost, if anything did."""
        if self.raised is not None:
            raised, self.raised = self.raised, None
            raise raised from raised.__cause__

    def call(self, function: Callable[P, R], *args: P.args, **more: P.kwargs) -> R:
        """Return what a function returns, called in a callback: what it raises is kept.

        What was raised before ends the callback at once. What is raised in the function and dealt
        with there is forgotten.
        """
        if self.raised is not None:
            raise self.raised
        try:
            result = function(*args, **more)
        except BaseException as error:
            self.keep(error)
            raise
        self._forget()
        return result

    def keep(self, error: BaseException) -> None:
        """Keep what was raised in a callback; it may be what became of an interruption."""
        if self.raised is None or not isinstance(error, Exception):
            self.raised = error

    def _handle(self, number: int, frame: FrameType | None) -> None:
        try:
            if self._former is not None:
                self._former(number, frame)
        except BaseException as error:
            self.raised = error
            if self._within:
                raise

    def _forget(self) -> None:
        """Forget what was raised, here and in the contexts around this one, which kept it too."""
        self.raised = None
        around = getattr(self._former, "__self__", None)
        if isinstance(around, Heed):
            around._forget()


def heeded(function: Callable[P, R]) -> Callable[P, R]:
    """Return the same function, in which no Ctrl-C gets lost."""

    @wraps(function)
    def within(*args: P.args, **more: P.kwargs) -> R:
        with Heed():
            return function(*args, **more)

    return within
