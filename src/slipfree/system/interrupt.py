"""Preservation of Ctrl-C and of exceptions in callbacks while CasADi runs.

CasADi does not propagate an exception from a callback or from a signal handler that runs inside its
code. Instead it raises another error, retries the step, ends the search, or ignores the exception.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from types import FrameType, TracebackType
from typing import Any, ParamSpec, Self, TypeVar

REPEAT = 0.3  # time after which an interruption that has not ended the command is repeated [s]
P = ParamSpec("P")
R = TypeVar("R")


class InterruptGuard:
    """Context manager that preserves exceptions of callbacks and of the SIGINT handler.

    It stores such an exception and raises it when the context ends, in place of any other
    ``Exception`` that ends the context. SIGINT handlers that raise no exception are called
    unchanged. Nested contexts share the stored exception. Outside the main thread, where no signal
    handler runs, only exceptions of callbacks are stored.
    """

    def __init__(self) -> None:
        self._kept: list[BaseException] = []  # the stored exception, at most one
        self._former: Callable[[int, FrameType | None], Any] | None = None

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            former = signal.getsignal(signal.SIGINT)
            around = getattr(former, "__self__", None)
            if isinstance(around, InterruptGuard):  # nested: its handler serves this one too
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
        """Raise the stored exception, if there is one."""
        if self._kept:
            error = self._kept.pop()
            raise error from error.__cause__

    def call(self, function: Callable[P, R], *args: P.args, **more: P.kwargs) -> R:
        """Return the result of a function called in a callback; store the exception that it raises.

        An exception stored earlier is raised without calling the function. When the function
        returns, exceptions stored during its call are discarded.
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
        """Store an exception of a callback.

        An ``Exception`` does not replace a stored one, of which it may be a consequence.
        """
        if not self._kept or not isinstance(error, Exception):
            self._kept[:] = [error]

    def _handle(self, number: int, frame: FrameType | None) -> None:
        """Handle SIGINT by the former handler; store and raise the exception that it raises."""
        try:
            if self._former is not None:
                self._former(number, frame)
        except BaseException as error:
            self._kept[:] = [error]
            # no exception inside __enter__ and __exit__, which must finish changing the handler
            while frame is not None:
                if frame.f_code in (_ENTER, _EXIT):
                    return
                frame = frame.f_back
            raise


class _Hold:
    """Ctrl-C held back by `held_interrupt`, and whether the computation asks and has asked for it.

    ``is_held`` is false as long as Ctrl-C is not held back.
    """

    def __init__(self, *, is_held: bool) -> None:
        self.pressed = self.delivered = False
        self.is_held = is_held


_holds: list[_Hold] = []


@contextmanager
def held_interrupt(*, from_first_poll: bool = False) -> Iterator[None]:
    """Hold back the first Ctrl-C, so that a computation can end where its results are consistent.

    Computations inside the context ask for it with `interrupt_requested` or `check_interrupt`. If
    none has, the end of the context raises KeyboardInterrupt. A second Ctrl-C is not held back, and
    with ``from_first_poll`` neither is one before the computation asks for the first time: it has
    no results yet, and its preparations may take long. The context has no effect outside the main
    thread or without a Python handler of SIGINT.
    """
    former = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(former):
        yield
        return
    hold = _Hold(is_held=not from_first_poll)

    def remember(number: int, frame: FrameType | None) -> None:
        if hold.pressed or not hold.is_held:
            former(number, frame)
            raise KeyboardInterrupt  # an outer context may have held it back
        hold.pressed = True

    _holds.append(hold)
    signal.signal(signal.SIGINT, remember)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, former)
        _holds.remove(hold)
    if hold.pressed and not hold.delivered:
        former(signal.SIGINT, None)


def interrupt_requested() -> bool:
    """Return whether Ctrl-C was pressed inside the contexts `held_interrupt` around the caller."""
    pressed = [hold for hold in _holds if hold.pressed]
    for hold in _holds:
        hold.is_held = True
    for hold in pressed:
        hold.delivered = True
    return bool(pressed)


def check_interrupt() -> None:
    """Raise KeyboardInterrupt if Ctrl-C was pressed inside `held_interrupt`."""
    if interrupt_requested():
        raise KeyboardInterrupt


_received: list[int] = []  # signals that raised KeyboardInterrupt
_ended: list[bool] = []  # not empty as soon as one of them has ended the command


def interrupted() -> bool:
    """Return whether a handler of `interrupt_at_signals` has raised KeyboardInterrupt."""
    return bool(_received)


def interrupt_arrived() -> None:
    """Note that a KeyboardInterrupt has ended the command: no signal raises another one."""
    _ended.append(True)


def interrupt_at_signals() -> None:
    """Let SIGTERM and SIGHUP interrupt this process as Ctrl-C does, even if it ignores Ctrl-C."""
    is_ignored = signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    _received.clear()
    _ended.clear()

    def repeat_signal() -> None:
        """Repeat the last signal until its exception has ended the command.

        CasADi and the garbage collector drop exceptions that are raised while they call Python.
        """
        time.sleep(REPEAT)
        while not _ended:
            os.kill(os.getpid(), _received[-1])
            time.sleep(REPEAT)

    def interrupt(number: int, _frame: FrameType | None) -> None:
        if not _ended and (number != signal.SIGINT or not is_ignored):
            if not _received:
                threading.Thread(target=repeat_signal, daemon=True).start()
            _received.append(number)
            raise KeyboardInterrupt

    def forward(number: int, frame: FrameType | None) -> None:
        handler = signal.getsignal(signal.SIGINT)  # perhaps that of a guard
        (handler if callable(handler) else interrupt)(number, frame)

    former = sys.unraisablehook

    def report(lost: sys.UnraisableHookArgs) -> None:
        if lost.exc_type is not KeyboardInterrupt or not _received:  # else it is repeated
            former(lost)

    sys.unraisablehook = report
    signal.signal(signal.SIGINT, interrupt)
    for name in ("SIGTERM", "SIGHUP"):  # Windows has no SIGHUP
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, forward)


_ENTER, _EXIT = InterruptGuard.__enter__.__code__, InterruptGuard.__exit__.__code__


def with_interrupt_guard(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that runs inside an `InterruptGuard`."""

    @wraps(function)
    def within(*args: P.args, **more: P.kwargs) -> R:
        with InterruptGuard():
            return function(*args, **more)

    return within


@contextmanager
def ended_by_interrupt(end: Callable[[], object]) -> Iterator[None]:
    """Call ``end()`` at Ctrl-C, before the SIGINT handler, to end a wait inside this context.

    After Ctrl-C the end of the context raises KeyboardInterrupt, even if the handler raises no
    exception. The context has no effect outside the main thread or without a Python handler of
    SIGINT.
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
