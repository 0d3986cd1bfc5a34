"""Process of a pool: it receives tasks from its parent and sends their results."""

from __future__ import annotations

import os
import signal
import threading
import warnings
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait


def serve(pipe: Connection) -> None:
    """Do tasks from a pipe until its other end is closed, or the process there has ended."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal; the parent decides
    warnings.simplefilter("ignore")  # which the parent tells
    os.dup2(2, 1)  # what solvers print must not get into the summary
    from slipfree.sweep.worker import work  # with the solvers, which the parent does not need

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
