"""Progress of a computation: a bar on a terminal, else occasional lines on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

from slipfree.cli.common import interruptible, throttled
from slipfree.cli.messages import detail, has_bar, is_verbose, say, visible

FIRST_LINE = 2.0  # after which a computation reports for the first time [s]
NEW_PHASE = 1.0  # between two lines of different phases at least [s]
SAME_PHASE = 10.0  # between two lines of the same phase at least [s]
INTEGRATION = "integrated"


class Reports(NamedTuple):
    """Callables by which a computation reports; both raise KeyboardInterrupt after Ctrl-C.

    Attributes
    ----------
    time : callable
        Called with the time reached. [s]
    search : callable
        Called with the phase of a search and a line about its iterate.
    """

    time: Callable[[float], None]
    search: Callable[[str, str], None]


@contextmanager
def reporting(duration: float | None) -> Iterator[Reports]:
    """Give the callables by which a computation reports its progress.

    Details, if wanted, are a line for every iterate; with ``--quiet`` and ``--json`` nothing is
    printed.

    Parameters
    ----------
    duration : float or None
        Duration of the motion; None if a search decides it. [s]
    """
    with interruptible() as poll:
        if is_verbose():
            yield _reports(poll, _detailed(), lambda _, line: detail(line), duration)
        elif not has_bar():
            yield Reports(lambda _: poll(), lambda *_: poll())
        elif sys.stderr.isatty():
            with _bar(poll, duration) as reports:
                yield reports
        else:
            stderr = sys.stderr  # as it is now: messages of integrators are kept from it
            show = _sparse(lambda line: say(line, file=stderr), SAME_PHASE)
            yield _reports(poll, show, show, duration)


def _reports(
    poll: Callable[[], None],
    integration: Callable[[str, str], None],
    search: Callable[[str, str], None],
    duration: float | None,
) -> Reports:
    of = "" if duration is None else f" of {duration:g}"

    def show_time(t: float) -> None:
        poll()
        integration(INTEGRATION, f"{INTEGRATION} to {t:.4g}{of} s")

    def show_search(phase: str, line: str) -> None:
        poll()
        search(phase, line)

    return Reports(show_time, show_search)


def _detailed() -> Callable[[str, str], None]:
    """Return a function that prints that the integration begins, then the time reached."""
    seldom, begun = _sparse(detail, NEW_PHASE), False

    def integrated(phase: str, line: str) -> None:
        nonlocal begun
        if not begun:
            begun = True
            detail("stood the vehicle on its start; integrates")
        seldom(phase, line)

    return integrated


def _sparse(show: Callable[[str], None], apart: float) -> Callable[[str, str], None]:
    """Return a function that shows the first line of a phase, then one at most every so often."""
    last, former = time.monotonic() + FIRST_LINE - NEW_PHASE, ""

    def seldom(phase: str, line: str) -> None:
        nonlocal last, former
        now = time.monotonic()
        if now - last >= (NEW_PHASE if phase != former else apart):
            last, former = now, phase
            show(line)

    return seldom


@contextmanager
def _bar(poll: Callable[[], None], duration: float | None) -> Iterator[Reports]:
    """Give callables that move a bar."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    with Progress(console=Console(file=sys.stderr), transient=True) as bar:
        task = bar.add_task("solving", total=duration)
        move = throttled(lambda t: bar.update(task, completed=t))
        describe = throttled(lambda line: bar.update(task, description=escape(visible(line))))

        def show_time(t: float) -> None:
            poll()
            move(t)

        def show_search(_phase: str, line: str) -> None:
            poll()
            describe(line)

        yield Reports(show_time, show_search)
