"""Computation of one run of a sweep."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

from slipfree.core.errors import SlipfreeError
from slipfree.core.trajectory import SolverError
from slipfree.problem.load import load_again, verb_of
from slipfree.problem.problem import Shared, sharing
from slipfree.problem.result import run_problem
from slipfree.sweep.log import FAILED, LOST, Row
from slipfree.sweep.metrics import figures_of
from slipfree.sweep.task import Done, Task, own_settings, without_motion

ALONE = threading.Lock()  # CasADi's objects are not thread-safe
KEPT: Shared = {}  # map and model of the latest run


def work(task: Task) -> Done:
    """Execute a task; return its result, whose row reports every error.

    The outcome is ``lost`` after an error of the operating system, such as a full disk, or if the
    memory is exhausted.
    """
    begin = time.perf_counter()
    try:
        with ALONE, sharing(KEPT, task.files):
            return _worked(task, begin)
    except SlipfreeError as error:
        outcome, words = FAILED, str(error)
    except (OSError, MemoryError) as error:
        outcome, words = LOST, f"{type(error).__name__}: {error}"
    except Exception as error:  # a failed run must not end the sweep
        outcome, words = FAILED, f"{type(error).__name__}: {error}"
    folder = str(Path(task.file).parent)
    words = words.replace(f"{folder}{os.sep}", "")
    return without_motion(task, outcome, words, time.perf_counter() - begin)


def _worked(task: Task, begin: float) -> Done:
    problem = load_again(Path(task.file), task.text, task.settings, task.trusted)
    try:
        result = run_problem(problem)
    except SolverError as error:
        if error.trajectory is None:
            raise
        raise SolverError(f"{error} (reached t = {error.trajectory.t[-1]:.6g} s)") from error
    motion = result.trajectory
    stop = motion.stop
    outcome = f"stopped by {stop.name}" if stop else "complete"
    words = stop.words if stop else verb_of(problem).describe_end(motion)
    try:
        figures = figures_of(motion, problem)
    except Exception as error:  # failed metrics must not lose the motion
        outcome, words, figures = FAILED, f"metrics: {type(error).__name__}: {error}", {}
    row = Row(
        task.run,
        own_settings(task),
        outcome,
        words,
        float(motion.t[-1]),
        figures,
        time.perf_counter() - begin,
    )
    return Done(row, motion, result.arrays) if task.keep else Done(row)
