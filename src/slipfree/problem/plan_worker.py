"""Process that searches for plans, reports iterates and can be ended at any time."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from slipfree.core.errors import SlipfreeError
from slipfree.core.records import Array
from slipfree.system.processes import for_children, prepare_process

INTERVAL = 0.08  # shortest time between two reported iterates [s]
SAMPLES = 400  # largest number of points of a reported path


class PlanRequest(NamedTuple):
    """Planning problem to solve.

    Attributes
    ----------
    path : Path
        Name of the problem file, for messages and input files.
    text : str
        Text of the problem.
    settings : tuple of str
        Settings ``KEY=VALUE``.
    former : mapping of str to ndarray
        Arrays of a plan for a warm start; empty without it.
    trusted : frozenset of str
        Paths of xacro files that the command line trusts.
    """

    path: Path
    text: str
    settings: tuple[str, ...] = ()
    former: Mapping[str, Array] = {}
    trusted: frozenset[str] = frozenset()


class FoundIterate(NamedTuple):
    """Iterate of a search: a line of text and the path, shape (n, 2) [m]."""

    line: str
    path: Array


class FoundPlan(NamedTuple):
    """Result of a search.

    Attributes
    ----------
    path : ndarray, shape (n, 2)
        Path of the platform in the simulation of the plan. [m]
    is_complete : bool
        Whether the plan is solved and accurate.
    facts : tuple of (str, str)
        Names and values that describe the plan.
    arrays : mapping of str to ndarray
        Arrays of the plan, for a warm start.
    """

    path: Array
    is_complete: bool
    facts: tuple[tuple[str, str], ...]
    arrays: Mapping[str, Array]


class FoundError(NamedTuple):
    """Message of an error that ended a search."""

    words: str


Message = FoundIterate | FoundPlan | FoundError


class PlanWorker:
    """Process that solves one problem at a time; it must be used in the main thread.

    The process is kept for further problems. `cancel` kills it, so that a search ends at once.
    """

    def __init__(self) -> None:
        self._process: Any = None
        self._connection: Connection[Any, Any] | None = None
        self.is_busy = False

    def prepare(self) -> None:
        """Start the process, which loads its packages, so that the first search begins sooner."""
        if self._connection is None or not self._process.is_alive():
            self.cancel()
            self._launch()

    def start(self, request: PlanRequest) -> None:
        """Begin to solve a problem; a search that still runs is cancelled."""
        if self.is_busy:
            self.cancel()
        self.prepare()
        if self._connection is not None:
            self._connection.send(request)
        self.is_busy = True

    def messages(self) -> Iterator[Message]:
        """Yield the messages that have arrived."""
        while self.is_busy and self._connection is not None:
            try:
                if not self._connection.poll():
                    return
                message: Message = self._connection.recv()
            except (EOFError, OSError):
                self.cancel()
                yield FoundError(
                    "expected a running planning process, found that it ended, possibly out of "
                    "memory; plan again, with fewer intervals"
                )
                return
            self.is_busy = isinstance(message, FoundIterate)
            yield message

    def cancel(self) -> None:
        """Kill the process; without one, do nothing."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
        if self._connection is not None:
            self._connection.close()
        self._process, self._connection, self.is_busy = None, None, False

    def _launch(self) -> None:
        context = get_context("spawn")  # CasADi is not safe in forked processes
        self._connection, other = context.Pipe()
        self._process = context.Process(target=_solve_requests, args=(other,), daemon=True)
        with for_children():
            self._process.start()
        other.close()


def _solve_requests(connection: Connection[Any, Any]) -> None:
    """Solve the problems that arrive at a connection until it is closed."""
    import slipfree.problem.solve  # noqa: F401 - loads while the user is editing

    prepare_process()
    while True:
        try:
            request: PlanRequest = connection.recv()
        except EOFError:
            return
        connection.send(_solve(request, connection))


def _solve(request: PlanRequest, connection: Connection[Any, Any]) -> Message:
    """Return the plan of a problem, or the error; send iterates to a connection."""
    from slipfree.plan.polynomial_motion import from_arrays
    from slipfree.problem.load import load_again
    from slipfree.problem.solve import run_problem

    last, line = 0.0, ""

    def keep_line(_phase: str, words: str) -> None:
        nonlocal line
        line = words

    def send_path(path: Array) -> None:
        nonlocal last
        if time.monotonic() - last >= INTERVAL:
            connection.send(FoundIterate(line, path))
            last = time.monotonic()

    begin = time.monotonic()
    try:
        problem = load_again(request.path, request.text, request.settings, request.trusted)
        former = from_arrays(request.former, "the last plan") if request.former else None
        result = run_problem(problem, None, keep_line, former, send_path)
    except SlipfreeError as error:
        return FoundError(str(error))
    except MemoryError:
        return FoundError(
            "expected enough memory for the plan, found none left; use fewer intervals"
        )
    return _plan_of(result, time.monotonic() - begin)


def _plan_of(result: Any, seconds: float) -> FoundPlan:
    """Return path and facts of a result; ``seconds`` is the time of the whole search."""
    import numpy as np

    from slipfree.core.facts import starting_with
    from slipfree.core.trajectory import outcome_words, path_length

    run = result.trajectory
    costs = starting_with("plan_cost_", run.facts)
    slip = np.hypot(run["slip_along"], run["slip_across"])
    facts = [
        ("outcome", outcome_words(run)),
        ("duration", f"{run.t[-1] - run.t[0]:.4g} s"),
        ("path length", f"{path_length(run):.4g} m"),
        *((f"cost {name.replace('_', ' ')}", f"{cost.value:.4g}") for name, cost in costs.items()),
        ("largest slip", f"{slip.max():.3g} m/s"),
        ("iterations", f"{run.facts['plan_iterations'].value:.0f}"),
        ("time of the search", f"{seconds:.1f} s"),
    ]
    chosen = np.unique(np.linspace(0, run.t.size - 1, SAMPLES).round().astype(int))
    path = np.stack([run["x"], run["y"]], axis=1)[chosen]
    return FoundPlan(path, not result.outcome.exit_code, tuple(facts), dict(result.arrays))
