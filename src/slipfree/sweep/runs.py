"""Runs of a sweep: their tasks, computation, metrics, rows, and the log of the finished ones."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

from slipfree.core.errors import SlipfreeError
from slipfree.core.facts import Fact, numbers
from slipfree.core.records import Array
from slipfree.core.trajectory import SolverError, Trajectory
from slipfree.files.netcdf import NOTHING, write
from slipfree.problem.inputs import Recipe
from slipfree.problem.load import verb_of
from slipfree.problem.problem import Problem, Shared, sharing
from slipfree.problem.result import run_problem
from slipfree.system.parts import Identity, Parts

COMPLETE = "complete"  # figure of every run: 1 if it reached its end
FAILED, LOST = "failed", "lost"
WORDS = {
    "slipfree": "version of slipfree",
    "problem": "problem file",
    "files": "input file",
    "settings": "--set",
    "vary": "--vary",
    "repeat": "--repeat",
    "seeds": "--seed",
}
ALONE = threading.Lock()  # CasADi's objects are not thread-safe
KEPT: Shared = {}  # map and model of the latest run
Figures = dict[str, tuple[float, str]]
CLOCK = "seconds"  # statistics with this in their names are not reproducible


class RunRow(NamedTuple):
    """Result of a run."""

    run: int  # its number
    settings: tuple[str, ...]  # settings of this run that are not settings of all runs
    # ``"complete"``, ``"stopped by NAME"``, ``"failed"``, or ``"lost"`` if its process died or the
    # disk or memory was full
    outcome: str
    words: str  # reason of the stop or failure, or description of the end of a complete run
    t: float | None  # time reached by the motion; None for a failed or lost run [s]
    figures: Mapping[str, tuple[float, str]]  # values and units of its metrics, by name
    seconds: float  # wall time of the run [s]


class RunTask(NamedTuple):
    """Task for a process: one run."""

    run: int  # its number
    recipe: Recipe  # its problem
    own: tuple[str, ...]  # settings of this run that are not settings of all runs
    keep: bool = False  # whether to return the motion
    # identifier of the content of the input files. Runs of one process share maps and models if it
    # is the same
    files: str = ""


class Done(NamedTuple):
    """The result of a task."""

    row: RunRow  # row for log and table
    trajectory: Trajectory | None = None  # the motion, if it is requested and exists
    # arrays of a plan for a warm start; empty for other motions
    arrays: Mapping[str, Array] = NOTHING


def without_motion(task: RunTask, words: str, outcome: str = LOST, seconds: float = 0.0) -> Done:
    """Return the result of a failed or lost run, with the reason; it has no motion."""
    return Done(RunRow(task.run, task.own, outcome, words, None, {COMPLETE: (0.0, "1")}, seconds))


class Rows(Parts[Done]):
    """The finished runs of a sweep, whose rows are read from disk on demand; a context manager.

    ``outcomes`` counts the finished runs by outcome; ``last`` is the last run that finished in this
    process.
    """

    def __init__(
        self,
        folder: Path,
        count: int,
        head: Mapping[str, Any],
        *,
        again: bool = False,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        """Open the folder of a sweep of ``count`` runs.

        Lost runs do not count as finished; with ``again``, neither do failed runs. ``check`` and
        errors are those of `Parts`.
        """
        super().__init__(folder, Identity("sweep", count, head, WORDS), check=check)
        self._outcomes: dict[int, str] = {}  # by run
        self._units: dict[str, tuple[int, int, str]] = {}  # by metric: first run, position, unit
        self.outcomes: Counter[str] = Counter()
        self.last: RunRow | None = None
        for row in self:
            if row.outcome in (LOST, *([FAILED] if again else [])):
                self.discard(row.run)
            else:
                self._count(row)

    def __iter__(self) -> Iterator[RunRow]:
        """Yield the rows in the order of the runs."""
        return self.read(self.finished)

    def read(self, runs: Iterable[int]) -> Iterator[RunRow]:
        """Yield the rows of finished runs with the given numbers, in this order."""
        for run in runs:
            record = self.record(run)
            figures = {name: (value, unit) for name, (value, unit) in record["figures"].items()}
            more = {"figures": figures, "settings": tuple(record["settings"])}
            yield RunRow(run, **{**record, **more})

    def ended(self, *outcomes: str) -> list[int]:
        """Return the numbers of the runs with one of the given outcomes, in ascending order."""
        return sorted(run for run, outcome in self._outcomes.items() if outcome in outcomes)

    @property
    def units(self) -> dict[str, str]:
        """Units of all metrics by name, in the order of the first run that has them."""
        ordered = sorted(self._units.items(), key=lambda each: each[1])
        return {name: unit for name, (_, _, unit) in ordered}

    def result_path(self, run: int) -> Path:
        """Return the path of the result file of a run."""
        return self.folder / f"run_{run:0{max(4, len(str(self.size)))}d}.nc"

    def store(self, number: int, result: Done) -> None:
        """Write the motion of a run, if it is kept, and its row; errors are those of `Parts`."""
        if result.trajectory is not None:
            write(self.result_path(number), result.trajectory, result.arrays)
        self.append(result.row)

    def append(self, row: RunRow) -> None:
        """Write a row and synchronise it to disk."""
        record = row._asdict()
        self.add(record.pop("run"), record)
        self._count(row)
        self.last = row

    def _count(self, row: RunRow) -> None:
        self._outcomes[row.run] = sys.intern(row.outcome)
        self.outcomes[row.outcome] += 1
        for k, (name, (_, unit)) in enumerate(row.figures.items()):
            earlier = self._units.get(name)
            if earlier is None or (row.run, k) < earlier[:2]:
                self._units[sys.intern(name)] = row.run, k, sys.intern(unit)


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
    """Return the row of a solved run, and its motion if it is kept."""
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
    facts = {COMPLETE: Fact(float(run.stop is None), "1")}
    facts |= numbers(verb.facts(run))
    facts |= {name: Fact(value) for name, value in run.statistics.items()}
    return {
        name: (float(fact.value), fact.unit)
        for name, fact in facts.items()
        if CLOCK not in name and isfinite(fact.value)
    }
