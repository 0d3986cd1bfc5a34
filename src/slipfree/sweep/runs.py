"""Sweeps: their runs and the log of the finished ones, execution, table and summary."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slipfree.core.errors import DataError, SlipfreeError
from slipfree.core.facts import Fact, numbers
from slipfree.core.records import Array
from slipfree.core.trajectory import SolverError, Trajectory
from slipfree.files.netcdf import NOTHING, write
from slipfree.files.tables import write_rows
from slipfree.problem.build import unit_of
from slipfree.problem.inputs import Recipe, recipe_of
from slipfree.problem.load import verb_of
from slipfree.problem.problem import Problem, Shared, sharing
from slipfree.problem.result import run_problem
from slipfree.show.swept import Swept
from slipfree.sweep.grid import Run, Sweep
from slipfree.system.parts import Identity, Parts, PartsWatch, study
from slipfree.system.processes import Pool, Processes

if TYPE_CHECKING:
    from slipfree.core.facts import Lines


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


TABLE = "table.csv"
MAX_FAILURES = 3  # number of printed failures
MAX_VALUES = 10  # number of printed values of a key
MAX_CHARACTERS = 300  # longest text of a run in the table; the log has the complete text
WITHIN_LIMITS = "within_limits"  # metric of plans: 1 if they satisfy their limits
REMEDIES = {
    FAILED: "--again repeats runs that failed",
    LOST: "the same command repeats lost runs",
}


def write_table(file: Path, sweep: Sweep, rows: Rows) -> None:
    """Write one line per finished run, in the order of the runs.

    The columns are number, varied keys, seeds, outcome, words, time reached [s] and metrics in the
    units of the log; values that a run does not have are empty. Wall times are only in the log, so
    that the same sweep gives the same table. Raises DataError if the file cannot be written.
    """
    units = rows.units
    head = ["run", *sweep.keys, "outcome", "words", "time_reached", *units]
    write_rows(file, head, (_line(sweep.run(row.run), row, units) for row in rows))


def _line(run: Run, row: RunRow, names: Iterable[str]) -> list[object]:
    values = [row.figures[name][0] if name in row.figures else "" for name in names]
    time = "" if row.t is None else row.t
    return [run.number, *run.values, *run.seeds, row.outcome, _line_of(row.words), time, *values]


def _line_of(words: str) -> str:
    joined = " ".join(words.split())
    return joined if len(joined) <= MAX_CHARACTERS else f"{joined[: MAX_CHARACTERS - 3]}..."


def choose_figures(sweep: Sweep, rows: Rows, names: Sequence[str]) -> tuple[str, ...]:
    """Return the requested metrics, by default the usual metrics of the verb.

    Raises DataError if no run has a requested metric.
    """
    known = rows.units
    if not names:
        return tuple(name for name in verb_of(sweep.problem).metrics_shown if name in known)
    for name in names:
        if name not in known:
            raise DataError(
                f"--figure {name}: expected one of the metrics of these runs "
                f"({', '.join(sorted(known)) or 'none'}); change or omit the option and run the "
                "command again; finished runs are kept"
            )
    return tuple(names)


def grids(sweep: Sweep, rows: Rows, figures: Sequence[str]) -> dict[str, Swept]:
    """Return metrics over the grid and the repetitions, by name; NaN for runs without them.

    The arrays have one axis per varied key and a last one for the repetitions. The result also
    contains ``complete`` and, for plans, ``within_limits``.
    """
    names = dict.fromkeys([*figures, COMPLETE, WITHIN_LIMITS])
    units = {name: unit for name, unit in rows.units.items() if name in names}
    values = {name: np.full(sweep.count, np.nan) for name in names if name in units}
    for row in rows:
        for name in row.figures.keys() & values.keys():
            values[name][row.run - 1] = row.figures[name][0]
    shape = (*(len(axis.values) for axis in sweep.axes), sweep.repeat)
    spec = sweep.problem.spec
    axes = tuple(axis._replace(unit=unit_of(spec, axis.name)) for axis in sweep.axes)
    return {k: Swept(k, units[k], axes, each.reshape(shape)) for k, each in values.items()}


def sweep_facts(
    sweep: Sweep, rows: Rows, tables: Mapping[str, Swept], figures: Sequence[str]
) -> Lines:
    """Return the facts of the summary of a sweep, pairs of name and text."""
    spreads = (fact for name in figures for fact in _spreads(tables[name]))
    return [
        *_outcomes(sweep, rows),
        *_within_limits(len(rows), tables.get(WITHIN_LIMITS)),
        *spreads,
    ]


def _outcomes(sweep: Sweep, rows: Rows) -> Iterator[tuple[str, str]]:
    counts = ((outcome, count) for outcome, count in rows.outcomes.most_common() if count)
    listed = ", ".join(f"{count} {outcome}" for outcome, count in counts)
    yield "runs", f"{len(rows)} of {sweep.count}" + (f": {listed}" if listed else "")
    yield from seed_facts(sweep)
    for outcome, remedy in REMEDIES.items():
        wrong = rows.ended(outcome)
        for row in rows.read(wrong[:MAX_FAILURES]):
            given = f" ({', '.join(row.settings)})" if row.settings else ""
            yield f"  run {row.run} {outcome}", f"{_line_of(row.words)}{given}"
        more = f"{len(wrong) - MAX_FAILURES} more, see the table; " * (len(wrong) > MAX_FAILURES)
        if wrong:
            yield "  ...", f"{more}{remedy}"


def seed_facts(sweep: Sweep) -> Iterator[tuple[str, str]]:
    """Yield the range of seeds of every key that the repetitions change, as facts."""
    for i, key in enumerate(sweep.seeds):
        first = sweep.seed + i * sweep.repeat
        yield f"  {key}", f"{first} to {first + sweep.repeat - 1}"


def _within_limits(count: int, kept: Swept | None) -> Iterator[tuple[str, str]]:
    """Yield the number and share of runs that satisfy goal and limits, if there are any plans."""
    if kept is None:
        return
    good = np.nansum(kept.values)
    yield (
        "within limits",
        f"{good:.0f} of {count} runs ({100 * good / count:.0f} %): solved, and the "
        "simulation satisfies goal and limits within plan.accuracy",
    )


def _spreads(swept: Swept) -> Iterator[tuple[str, str]]:
    """Yield mean and range of a metric, over all runs and for every value of every key."""
    unit = "" if swept.unit in ("1", "") else f" {swept.unit}"
    yield swept.name, f"{_spread(swept.values, unit)}"
    for k, axis in enumerate(swept.axes):
        parts = np.moveaxis(swept.values, k, 0)
        for value, part in list(zip(axis.values, parts, strict=True))[:MAX_VALUES]:
            short = f"{float(value):.6g}" if axis.numbers else value
            yield f"  {axis.name} = {short}", _spread(part, unit)
        if len(parts) > MAX_VALUES:
            yield "  ...", f"{len(parts) - MAX_VALUES} more values; {TABLE} lists all"


def _spread(values: Array, unit: str) -> str:
    there = values[np.isfinite(values)]
    if not there.size:
        return "no run"
    if there.size == 1:
        return f"{there[0]:.5g}{unit} (1 run)"
    spread = f"mean {there.mean():.5g}, {there.min():.5g} to {there.max():.5g}"
    return f"{spread}{unit} ({there.size} runs)"


def drawn_grids(rows: Rows, tables: Mapping[str, Swept], figures: Sequence[str]) -> list[Swept]:
    """Return the metrics to draw, and the share of complete runs if not all are complete."""
    is_complete = rows.outcomes["complete"] == len(rows)
    names = dict.fromkeys([*figures, *([] if is_complete else [COMPLETE])])
    swept = (tables[name] for name in names if name in tables)
    return [each for each in swept if np.isfinite(each.values).any()]


def plan_facts(sweep: Sweep) -> Lines:
    """Return the facts of a sweep before it runs: number of runs, values and seeds."""
    sizes = [len(axis.values) for axis in sweep.axes] + [sweep.repeat] * bool(sweep.seeds)
    times = f" = {' x '.join(map(str, sizes))}" if len(sizes) > 1 else ""
    facts = [("runs", f"{sweep.count}{times}")]
    for axis in sweep.axes:
        few = (
            axis.values
            if len(axis.values) <= MAX_VALUES
            else (*axis.values[:3], "...", axis.values[-1])
        )
        count = "1 value" if len(axis.values) == 1 else f"{len(axis.values)} values"
        facts.append((f"  {axis.name}", f"{', '.join(few)} ({count})"))
    return [*facts, *seed_facts(sweep)]


def run_sweep(
    sweep: Sweep,
    rows: Rows,
    workers: int | Callable[[Callable[..., Any]], Pool[Any, Any]] = 1,
    *,
    keep: bool = False,
    watch: PartsWatch = PartsWatch(),
) -> None:
    """Execute the unfinished runs of a sweep.

    Tasks are created when the pool accepts them, and results are kept on disk. The required memory
    does not depend on the number of metrics. A line of ``parts.jsonl`` is written to the folder
    when a run is finished, ``table.csv`` at the end and after an interruption, and with ``keep``
    the motion of every run, to ``run_0001.nc`` and so on.

    ``workers`` and ``watch`` are those of `study`; each run has a process that may
    die. DataError is raised if the folder cannot be written; SlipfreeError if the pool fails.
    """
    pool = partial(Processes, workers) if isinstance(workers, int) else workers
    recipe, files = recipe_of(sweep.problem), json.dumps(sweep.files.digests)
    recipe = recipe._replace(path=recipe.path.resolve())

    def task(number: int) -> RunTask:
        settings = sweep.run(number).settings
        own = settings[len(sweep.settings) :]
        return RunTask(number, recipe._replace(settings=settings), own, keep, files)

    try:
        with study(work, rows, pool, lost=without_motion, watch=watch) as solve:
            for _ in solve(rows.missing, task):
                pass
    finally:
        write_table(rows.folder / TABLE, sweep, rows)


def missing_results(rows: Rows) -> list[int]:
    """Return the numbers of the runs that have a motion but no result file in their folder."""
    moved = rows.ended(*(set(rows.outcomes) - {FAILED, LOST}))
    return [run for run in moved if not rows.result_path(run).exists()]
