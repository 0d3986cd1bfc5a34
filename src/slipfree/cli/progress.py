"""Progress of a computation: a bar on a terminal, otherwise occasional lines on stderr."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

from slipfree.cli.common import throttled
from slipfree.cli.messages import detail, has_bar, is_verbose, print_line, visible
from slipfree.system.interrupt import check_interrupt, held_interrupt

FIRST_LINE = 2.0  # time before the first line of a computation [s]
NEW_PHASE = 1.0  # shortest time between lines of different phases [s]
SAME_PHASE = 10.0  # shortest time between lines of the same phase [s]
INTEGRATION = "integrated"


class Reports(NamedTuple):
    """Callables that report progress; both raise KeyboardInterrupt after Ctrl-C.

    Attributes
    ----------
    time : callable
        Called with the time reached. [s]
    search : callable
        Called with the phase of a search and a line that describes its iterate.
    """

    time: Callable[[float], None]
    search: Callable[[str, str], None]


@contextmanager
def reporting(duration: float | None) -> Iterator[Reports]:
    """Yield callables that report the progress of a computation.

    Ctrl-C is held back inside the context, see `held_interrupt`.
    With ``--verbose`` every iterate is printed; with ``--quiet`` and ``--json`` nothing is printed.

    Parameters
    ----------
    duration : float or None
        Duration of the motion; None for a search over the whole motion. [s]
    """
    with held_interrupt():
        if is_verbose():
            yield _reports(_detailed(), lambda _, line: detail(line), duration)
        elif not has_bar():
            yield Reports(lambda _: check_interrupt(), lambda *_: check_interrupt())
        elif sys.stderr.isatty():
            with _bar(duration) as reports:
                yield reports
        else:
            stderr = sys.stderr  # the current one: integrators redirect sys.stderr
            show = _sparse(lambda line: print_line(line, file=stderr), SAME_PHASE)
            yield _reports(show, show, duration)


def _reports(
    integration: Callable[[str, str], None],
    search: Callable[[str, str], None],
    duration: float | None,
) -> Reports:
    of = "" if duration is None else f" of {duration:g}"

    def show_time(t: float) -> None:
        check_interrupt()
        integration(INTEGRATION, f"{INTEGRATION} to {t:.4g}{of} s")

    def show_search(phase: str, line: str) -> None:
        check_interrupt()
        search(phase, line)

    return Reports(show_time, show_search)


def _detailed() -> Callable[[str, str], None]:
    """Return a callback for ``--verbose`` that prints the start of the integration, then times."""
    seldom, begun = _sparse(detail, NEW_PHASE), False

    def integrated(phase: str, line: str) -> None:
        nonlocal begun
        if not begun:
            begun = True
            detail("settled the vehicle at the start; integrating")
        seldom(phase, line)

    return integrated


def _sparse(show: Callable[[str], None], apart: float) -> Callable[[str, str], None]:
    """Return a callback of phase and line that shows at most one line per ``apart`` seconds.

    The first line of a new phase is shown `NEW_PHASE` seconds after the previous line.
    """
    last, former = time.monotonic() + FIRST_LINE - NEW_PHASE, ""

    def seldom(phase: str, line: str) -> None:
        nonlocal last, former
        now = time.monotonic()
        if now - last >= (NEW_PHASE if phase != former else apart):
            last, former = now, phase
            show(line)

    return seldom


@contextmanager
def _bar(duration: float | None) -> Iterator[Reports]:
    """Yield callables that update a progress bar."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    with Progress(console=Console(file=sys.stderr), transient=True) as bar:
        task = bar.add_task("solving", total=duration)
        move = throttled(lambda t: bar.update(task, completed=t))
        describe = throttled(lambda line: bar.update(task, description=escape(visible(line))))

        def show_time(t: float) -> None:
            check_interrupt()
            move(t)

        def show_search(_phase: str, line: str) -> None:
            check_interrupt()
            describe(line)

        yield Reports(show_time, show_search)
