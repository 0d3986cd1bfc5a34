"""Computation of one run of a sweep, and its metrics."""

from __future__ import annotations

import os
import threading
import time
from math import isfinite
from typing import Any

from slipfree.core.errors import SlipfreeError
from slipfree.core.facts import Fact, numbers
from slipfree.core.trajectory import SolverError, Trajectory
from slipfree.problem.load import verb_of
from slipfree.problem.problem import Problem, Shared, sharing
from slipfree.problem.result import run_problem
from slipfree.sweep.log import (
    COMPLETE,
    FAILED,
    LOST,
    Done,
    RunRow,
    RunTask,
    without_motion,
)

ALONE = threading.Lock()  # CasADi's objects are not thread-safe
KEPT: Shared = {}  # map and model of the latest run
Figures = dict[str, tuple[float, str]]
CLOCK = "seconds"  # statistics with this in their names are not reproducible


def work(task: RunTask) -> Done:
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
    words = words.replace(f"{task.recipe.path.parent}{os.sep}", "")
    return without_motion(task, words, outcome, time.perf_counter() - begin)


def _worked(task: RunTask, begin: float) -> Done:
    problem = task.recipe.load()
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
    row = RunRow(
        task.run,
        task.own,
        outcome,
        words,
        float(motion.t[-1]),
        figures,
        time.perf_counter() - begin,
    )
    return Done(row, motion, result.arrays) if task.keep else Done(row)


def figures_of(run: Trajectory, problem: Problem[Any]) -> Figures:
    """Return the metrics of a motion by name: value and unit.

    Values are those at the end (``end_x``), extremes over time and wheels (``pitch_largest``, of
    absolute values; ``clearance_least``), ``slip_rms`` over time and wheels, ``tilt_largest`` of
    all tilt angles, differences between end and start (``work``), and the solver's statistics
    except computing times. Values that are not finite are omitted. ``complete`` is 1 if the motion
    reached its end. ``within_limits`` of a plan is 1 if its simulation is complete and violates no
    limit by more than ``plan.accuracy``.
    """
    verb = verb_of(problem)
    found = {COMPLETE: Fact(float(run.stop is None), "1")}
    found |= numbers(verb.facts(run))
    found |= {name: Fact(value) for name, value in run.statistics.items()}
    return {
        name: (float(fact.value), fact.unit)
        for name, fact in found.items()
        if CLOCK not in name and isfinite(fact.value)
    }
