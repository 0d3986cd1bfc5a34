"""One run of a sweep, in whatever process it is done."""

from __future__ import annotations

import os
import signal
import tempfile
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

from slipfree.errors import SlipfreeError, SolverError
from slipfree.named import Array
from slipfree.problem.read import Problem, read
from slipfree.problem.run import run as solved
from slipfree.problem.schema import Climb, Motion
from slipfree.result_file import NOTHING
from slipfree.sweep.figures import COMPLETE, figures_of
from slipfree.sweep.log import Row
from slipfree.trajectory import Trajectory

ALONE = threading.Lock()  # CasADi's objects are not made for several threads


class Task(NamedTuple):
    """What a process needs for a run: all of the problem but the files that it names.

    Attributes
    ----------
    run : int
        Its number.
    file : str
        The problem file; input files are found beside it.
    text : str
        What it holds.
    settings : tuple of str
        ``key=value``.
    own : int
        How many of these, the last ones, are not those of all runs.
    keep : bool
        Whether the motion is wanted.
    """

    run: int
    file: str
    text: str
    settings: tuple[str, ...]
    own: int
    keep: bool


class Done(NamedTuple):
    """What came of a task.

    Attributes
    ----------
    row : Row
        For log and table.
    trajectory : Trajectory or None
        The motion, if it is wanted and there is one.
    arrays : mapping of str to ndarray
        From which another plan may start.
    """

    row: Row
    trajectory: Trajectory | None = None
    arrays: Mapping[str, Array] = NOTHING


def serve(pipe: Connection) -> None:
    """Do tasks from a pipe until its other end is closed, be it since that process was killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal; the parent decides
    os.dup2(2, 1)  # what solvers print must not get into the summary
    try:
        pipe.send(None)  # ready
        while True:
            pipe.send(work(pipe.recv()))
    except (EOFError, OSError):
        return


def work(task: Task) -> Done:
    """Return what comes of a task; whatever goes wrong is told in its row."""
    begin = time.perf_counter()
    try:
        with ALONE:
            return _worked(task, begin)
    except SlipfreeError as error:
        words = str(error)
    except Exception as error:  # one bad run must not end hundreds of good ones
        words = f"{type(error).__name__}: {error}"
    folder = str(Path(task.file).parent)
    return failed(task, words.replace(f"{folder}{os.sep}", ""), time.perf_counter() - begin)


def failed(task: Task, words: str, seconds: float = 0.0) -> Done:
    """Return the row of a run that came to nothing."""
    return Done(Row(task.run, _own(task), "failed", words, None, {COMPLETE: (0.0, "1")}, seconds))


def _worked(task: Task, begin: float) -> Done:
    problem = _problem(task)
    try:
        motion, _, arrays = solved(problem)
    except SolverError as error:
        if error.trajectory is None:
            raise
        raise SolverError(f"{error} (reached t = {error.trajectory.t[-1]:.6g} s)") from error
    stop = motion.stop
    row = Row(
        task.run,
        _own(task),
        f"stopped by {stop.name}" if stop else "complete",
        stop.words if stop else motion.attributes.get("outcome", ""),
        float(motion.t[-1]),
        figures_of(motion, problem.spec),
        time.perf_counter() - begin,
    )
    return Done(row, motion, arrays) if task.keep else Done(row)


def _problem(task: Task) -> Problem[Motion] | Problem[Climb]:
    """Return the problem as it was when the sweep began, wherever this is done."""
    path = Path(task.file)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        copy.write_bytes(task.text.encode())
        problem = read(copy, task.settings)
    return replace(problem, source=replace(problem.source, path=path))


def _own(task: Task) -> tuple[str, ...]:
    return task.settings[len(task.settings) - task.own :]
