"""Process of a pool: its preparation, and the function that it is sent with each task."""

from __future__ import annotations

import os
import signal
import threading
import warnings
from multiprocessing import parent_process
from multiprocessing.connection import wait

from slipfree.sweep.task import Done, Task


def prepare_process() -> None:
    """Prepare a new process: no Ctrl-C, no output on stdout, end with the parent."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal; the parent decides
    warnings.simplefilter("ignore")  # the parent reports them
    os.dup2(2, 1)  # output of solvers must not get into the summary


def run_task(task: Task) -> Done:
    """Return the result of a task."""
    from slipfree.sweep.worker import work  # with the solvers, which the parent does not need

    return work(task)


def _end_with_parent() -> None:
    """End this process, even in the middle of a run, as soon as its parent ends."""
    if (parent := parent_process()) is not None:
        wait([parent.sentinel])
        os._exit(1)
