"""What a process gets for a run and gives back, and how it waits for it.

The process that hands out runs needs no solvers, so they are imported where a run is done.
"""

from __future__ import annotations

import os
import signal
import threading
import warnings
from collections.abc import Mapping
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from typing import NamedTuple

from slipfree.files.netcdf import NOTHING
from slipfree.records import Array
from slipfree.sweep.log import Row
from slipfree.trajectory import Trajectory

COMPLETE = "complete"  # figure of every run: 1 if it reached its end


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
    """Do tasks from a pipe until its other end is closed, or the process there has ended."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal; the parent decides
    warnings.simplefilter("ignore")  # which the parent tells
    os.dup2(2, 1)  # what solvers print must not get into the summary
    from slipfree.sweep.worker import work

    try:
        pipe.send(None)  # ready
        while True:
            pipe.send(work(pipe.recv()))
    except (EOFError, OSError):
        return


def _end_with_parent() -> None:
    """End this process, even in the middle of a run, as soon as that which began it ends."""
    if (parent := parent_process()) is not None:
        wait([parent.sentinel])
        os._exit(1)


def nothing(task: Task, outcome: str, words: str, seconds: float = 0.0) -> Done:
    """Return the row of a run that came to nothing: it failed, or was lost."""
    return Done(
        Row(task.run, own_settings(task), outcome, words, None, {COMPLETE: (0.0, "1")}, seconds)
    )


def own_settings(task: Task) -> tuple[str, ...]:
    """Return what is set for this run and not for all."""
    return task.settings[len(task.settings) - task.own :]
