"""Sweeps: values of keys, seeds and settings of every run; log, execution, table and summary."""

from __future__ import annotations

import hashlib
import json
import os
import re
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.errors import DataError, SlipfreeError, shortened
from slipfree.core.facts import ROUNDING, STATISTICS, Fact, Lines, numbers
from slipfree.core.records import Array
from slipfree.core.trajectory import SolverError, Trajectory
from slipfree.core.version import __version__
from slipfree.files import toml
from slipfree.files.netcdf import NOTHING, write
from slipfree.files.tables import write_rows
from slipfree.files.urdf.xacro import trusted_paths
from slipfree.problem import inputs
from slipfree.problem.build import unit_of
from slipfree.problem.load import load_again, verb_of
from slipfree.problem.problem import Problem, Shared, sharing
from slipfree.problem.result import run_problem
from slipfree.show.plots import Swept, Varied
from slipfree.system.parts import Identity, Parts, PartsWatch, Workers, study
from slipfree.system.processes import Processes

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
RANGE = re.compile(rf"\s*({NUMBER})\s*:\s*({NUMBER})\s*:\s*(\d+)\s*")
WHOLE = re.compile(r"\s*[+-]?\d+\s*")
DIGITS = 12  # significant digits of the values of a range: 0.3, not 0.30000000000000004
MAX_RUNS = 100_000
SEED = "seed"  # last part of the keys that repetitions change


class Run(NamedTuple):
    """One run of a sweep."""

    number: int  # number of the run; the first is 1
    values: tuple[str, ...]  # one value per varied key
    seeds: tuple[int, ...]  # one seed for each key in `Sweep.seeds`
    # all settings that replace values of the problem file, as ``key=value``
    settings: tuple[str, ...]


@dataclass(frozen=True)
class Sweep:
    """A problem and its varied keys."""

    problem: Problem[Any]  # of the first run
    settings: tuple[str, ...]  # settings of all runs
    axes: tuple[Varied, ...]
    # keys of the seeds that every repetition changes; empty without repetitions
    seeds: tuple[str, ...]
    repeat: int  # number of repetitions of every point of the grid
    seed: int
    files: inputs.FileStates  # all input files

    @property
    def keys(self) -> tuple[str, ...]:
        """The varied keys, then the keys of the seeds."""
        return (*(axis.name for axis in self.axes), *self.seeds)

    @property
    def count(self) -> int:
        """Number of runs."""
        return int(np.prod([len(axis.values) for axis in self.axes], dtype=int)) * self.repeat

    def run(self, number: int) -> Run:
        """Return a run; the seeds vary fastest, then the last key."""
        *at, k = np.unravel_index(
            number - 1, (*(len(each.values) for each in self.axes), self.repeat)
        )
        values = tuple(axis.values[i] for axis, i in zip(self.axes, at, strict=True))
        # each key has seeds of its own: equal seeds would correlate, for example, the random ground
        # and its elevation error
        seeds = tuple(self.seed + int(k) + self.repeat * i for i in range(len(self.seeds)))
        pairs = zip(self.keys, (*values, *map(str, seeds)), strict=True)
        own = (f"{key}={value}" for key, value in pairs)
        return Run(number, values, seeds, (*self.settings, *own))

    @property
    def head(self) -> dict[str, Any]:
        """Identity of the sweep for the first line of the log; equal for comparable results."""
        text = "\n".join(self.problem.source.text.splitlines())
        return {
            "slipfree": __version__,
            "problem": {"": hashlib.sha256(text.encode()).hexdigest()},
            "files": self.files.digests,
            "settings": list(self.settings),
            "vary": {axis.name: list(axis.values) for axis in self.axes},
            "repeat": self.repeat,
            "seeds": dict.fromkeys(self.seeds, self.seed),
        }


def sweep_of(
    file: Path,
    vary: Sequence[str],
    settings: Sequence[str] = (),
    repeat: int | None = None,
    seed: int = 1,
    progress: Callable[[int, int], None] = lambda _, __: None,
    trust: Sequence[Path] = (),
) -> Sweep:
    """Return the sweep of a problem file, after a check of every value.

    The keys ``vary`` are given as ``key=a:b:n`` for n equally spaced numbers from a to b, or as
    ``key=v1,v2,...`` for values in TOML or words without quotes; all combinations are run. Each
    value is checked separately, with the first values of the other keys; a run with an invalid
    combination fails. ``repeat`` is the number of runs of each combination, with seeds from
    ``seed`` on; by default one run has the seed of the file. ``progress`` is called with the
    numbers of checked and of all values.

    DataError is raised if ``vary`` is invalid, contains a key twice or contains a key of
    ``settings``, if there are more than 100 000 runs, or if the problem has no seed for
    repetitions; a `ProblemError` if a value is invalid.
    """
    axes = tuple(axis_of(each) for each in vary)
    _check_keys(axes, settings)
    sizes = int(np.prod([len(axis.values) for axis in axes], dtype=object)) * (repeat or 1)
    if sizes > MAX_RUNS:
        raise DataError(
            f"sweep: expected at most {MAX_RUNS} runs, found {sizes}; vary fewer values, or "
            "reduce --repeat"
        )
    # the first point of the grid, then those that differ from it in one value
    base = [f"{axis.name}={axis.values[0]}" for axis in axes]
    others = ((k, f"{axis.name}={v}") for k, axis in enumerate(axes) for v in axis.values[1:])
    points = [base, *([*base[:k], value, *base[k + 1 :]] for k, value in others)]
    text = toml.read_text(file)
    problems = (load_again(file, text, settings, varied=varied) for varied in points)
    first = replace(next(problems), trusted=trusted_paths(trust))
    files, count = inputs.input_files(first), sum(len(axis.values) for axis in axes)
    for done, problem in enumerate(problems, 1 + len(axes)):
        if not {*inputs.input_names(problem.spec)} <= files.keys():
            files |= inputs.input_files(problem)
        progress(done, count)
    bare = Sweep(first, tuple(settings), axes, (), 1, seed, inputs.file_states(files))
    if repeat is None:
        return bare
    known = seed_keys(bare.problem.spec.model_dump())
    seeds = tuple(key for key in known if key not in bare.keys)
    if not seeds:
        where = bare.problem.source.path
        raise DataError(
            f"{where}: expected a key that ends in .{SEED} for --repeat, found "
            + (f"only {', '.join(known)}, which --vary changes" if known else "none")
            + "; add a table with a seed, such as [terrain.synthetic.power_law] or "
            "[terrain.error], or omit --repeat"
        )
    return replace(bare, seeds=seeds, repeat=repeat)


def axis_of(text: str) -> Varied:
    """Return the key and the values of ``key=a:b:n`` or ``key=v1,v2,...``.

    Raises DataError if the text has neither form, a value is empty or given twice, or a range is
    not valid.
    """
    key, equals, rest = text.partition("=")
    text = shortened(text)
    try:
        spelled = ".".join(toml.key_path(key))
    except ValueError:
        spelled = ""
    if not (spelled and equals and rest.strip()):
        raise DataError(
            f"--vary {text}: expected key=a:b:n for n numbers from a to b, or key=v1,v2,..., "
            f"found {text!r}; write it in one of these forms"
        )
    values = tuple(part.strip() for part in rest.split(","))
    if match := RANGE.fullmatch(rest):
        values = _range(text, *match.groups())
    else:
        # TOML equals JSON for strings, numbers, booleans and arrays
        with suppress(ValueError, TypeError):
            listed = toml.load_toml(f"values = [{rest}]")["values"]
            if not any(isinstance(value, dict) for value in listed):
                values = tuple(json.dumps(value, ensure_ascii=False) for value in listed)
    if "" in values:
        raise DataError(
            f"--vary {text}: expected values between commas, found an empty value; remove a comma"
        )
    meant: dict[object, str] = {}
    for value in values:
        # equal for values with the same meaning in TOML, as 1 and 1.0, or a word with quotes
        meaning: object = value.strip()
        with suppress(ValueError):
            number = toml.load_toml(f"value = {value}")["value"]
            meaning = number if isinstance(number, str) else repr(number)
            if isinstance(number, int | float) and not isinstance(number, bool):
                meaning = float(number)
        if (same := meant.setdefault(meaning, value)) is not value:
            also = "twice" if same == value else f"and {value}, which are equal"
            raise DataError(
                f"--vary {text}: expected values that differ, found {same} {also}; remove one"
            )
    return Varied(spelled, values)


def seed_keys(spec: Mapping[str, Any], above: str = "") -> tuple[str, ...]:
    """Return the dotted keys of all seeds of a problem, including those not in the file."""
    keys: list[str] = []
    for name, value in spec.items():
        if isinstance(value, Mapping):
            keys += seed_keys(value, f"{above}{name}.")
        elif name == SEED and above:
            keys.append(f"{above}{name}")
    return tuple(keys)


def _check_keys(axes: Sequence[Varied], settings: Sequence[str]) -> None:
    """Raise DataError for varied keys that are repeated, set, or part of another varied key.

    A table may be set and one of its keys varied; the varied values then replace the key's value.
    """
    paths = [toml.key_path(axis.name) for axis in axes]
    for long, short in permutations(paths, 2):
        if long[: len(short)] == short:
            raise DataError(
                f"--vary {'.'.join(long)}: expected keys that do not contain one another, "
                f"found --vary {'.'.join(short)} as well; remove one of the two"
            )
    for setting in settings:
        try:
            set_path = toml.key_path(setting.partition("=")[0])
        except ValueError:
            continue  # reading the problem reports the error
        for path in paths:
            if set_path[: len(path)] == path:
                raise DataError(
                    f"--vary {'.'.join(path)}: expected a key that is not set, found "
                    f"--set {setting}; remove one of the two"
                )


def _range(text: str, first: str, last: str, count: str) -> tuple[str, ...]:
    """Return equally spaced numbers as text; integers if the ends and the step are integers.

    ``text`` is the option, for messages; ``first``, ``last`` and ``count`` are its parts.
    """
    low, high, n = float(first), float(last), int(count)
    if not 2 <= n <= MAX_RUNS:
        raise DataError(
            f"--vary {text}: expected 2 to {MAX_RUNS} values, found {count}; correct the last "
            "number"
        )
    if not (low != high and isfinite(low) and isfinite(high)):
        raise DataError(
            f"--vary {text}: expected two different finite ends, found {first} and {last}; correct "
            "the first two numbers"
        )
    numbers = [float(f"{value:.{DIGITS}g}") for value in np.linspace(low, high, n)]
    whole = WHOLE.fullmatch(first) and WHOLE.fullmatch(last) and (high - low) % (n - 1) == 0
    return tuple(str(round(value)) if whole else str(value) for value in numbers)


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
    recipe: inputs.Recipe  # its problem
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
        return {name: unit for row in self for name, (_, unit) in row.figures.items()}

    def file(self, number: int) -> Path:
        """Return the path of the result file of a run."""
        return self.folder / f"run_{number:0{max(4, len(str(self.size)))}d}.nc"

    def is_whole(self, number: int, written: str | None) -> bool:
        """Return whether the result file of a run, unless it was removed, is as it was written."""
        return not self.file(number).exists() or super().is_whole(number, written)

    def store(self, number: int, result: Done) -> None:
        """Write the motion of a run, if it is kept, and its row; errors are those of `Parts`."""
        row, run, arrays = result
        record = row._asdict()
        del record["run"]
        self.add(number, record, None if run is None else lambda part: write(part, run, arrays))
        self._count(row)
        self.last = row

    def _count(self, row: RunRow) -> None:
        self._outcomes[row.run] = sys.intern(row.outcome)
        self.outcomes[row.outcome] += 1


def work(task: RunTask) -> Done:
    """Execute a task; return its result, whose row reports every error.

    The outcome is ``lost`` after an error of the operating system, such as a full disk, or if the
    memory is exhausted.
    """
    begin = time.perf_counter()
    try:
        with ALONE, sharing(KEPT, task.files):
            problem = task.recipe.load()
            try:
                result = run_problem(problem)
            except SolverError as error:
                if error.trajectory is None:
                    raise
                reached = f"{error} (reached t = {error.trajectory.t[-1]:.6g} s)"
                raise SolverError(reached) from error
            motion = result.trajectory
            stop = motion.stop
            outcome = f"stopped by {stop.name}" if stop else "complete"
            words = stop.words if stop else verb_of(problem).describe_end(motion)
            try:
                figures = figures_of(motion, problem)
            except Exception as error:  # failed metrics must not lose the motion
                outcome, words, figures = FAILED, f"metrics: {type(error).__name__}: {error}", {}
            end, seconds = float(motion.t[-1]), time.perf_counter() - begin
            row = RunRow(task.run, task.own, outcome, words, end, figures, seconds)
            return Done(row, motion, result.arrays) if task.keep else Done(row)
    except SlipfreeError as error:
        outcome, words = FAILED, str(error)
    except (OSError, MemoryError) as error:
        outcome, words = LOST, f"{type(error).__name__}: {error}"
    except Exception as error:  # a failed run must not end the sweep
        outcome, words = FAILED, f"{type(error).__name__}: {error}"
    words = words.replace(f"{task.recipe.path.parent}{os.sep}", "")
    return without_motion(task, words, outcome, time.perf_counter() - begin)


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
REMEDIES = {FAILED: "--again repeats runs that failed", LOST: "the same command repeats lost runs"}


def write_table(file: Path, sweep: Sweep, rows: Rows) -> None:
    """Write one line per finished run, in the order of the runs.

    The columns are number, varied keys, seeds, outcome, words, time reached [s] and metrics in the
    units of the log; values that a run does not have are empty. Wall times are only in the log, so
    that the same sweep gives the same table. Raises DataError if the file cannot be written.
    """
    units = rows.units
    head = ["run", *sweep.keys, "outcome", "words", "time_reached", *units]
    lines = (
        [row.run, *run.values, *run.seeds, row.outcome, _line_of(row.words)]
        + ["" if row.t is None else row.t]
        + [row.figures[name][0] if name in row.figures else "" for name in units]
        for row in rows
        for run in [sweep.run(row.run)]
    )
    write_rows(file, head, lines)


def _line_of(words: str) -> str:
    return shortened(" ".join(words.split()), MAX_CHARACTERS)


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
                "command again; finished parts are kept"
            )
    return tuple(names)


def grids(sweep: Sweep, rows: Rows, figures: Sequence[str]) -> dict[str, Swept]:
    """Return metrics over the grid and the repetitions, by name; NaN for runs without them.

    The arrays have one axis per varied key and a last one for the repetitions. The result also
    contains ``complete`` and, for plans, ``within_limits``. Speeds of the size of rounding are
    zero.
    """
    names = dict.fromkeys([*figures, COMPLETE, WITHIN_LIMITS])
    units = {name: unit for name, unit in rows.units.items() if name in names}
    values = {name: np.full(sweep.count, np.nan) for name in names if name in units}
    for row in rows:
        for name in row.figures.keys() & values.keys():
            value = row.figures[name][0]
            is_zero = units[name] == "m s-1" and abs(value) < ROUNDING
            values[name][row.run - 1] = value * (not is_zero)
    shape = (*(len(axis.values) for axis in sweep.axes), sweep.repeat)
    spec = sweep.problem.spec
    axes = tuple(axis._replace(unit=unit_of(spec, axis.name)) for axis in sweep.axes)
    return {k: Swept(k, units[k], axes, each.reshape(shape)) for k, each in values.items()}


def sweep_facts(sweep: Sweep, rows: Rows, tables: Mapping[str, Swept]) -> Lines:
    """Return the facts of the summary of a sweep, pairs of name and text."""
    counts = ((outcome, count) for outcome, count in rows.outcomes.most_common() if count)
    listed = ", ".join(f"{count} {outcome}" for outcome, count in counts)
    facts = [("runs", f"{len(rows)} of {sweep.count}" + (f": {listed}" if listed else ""))]
    facts += seed_facts(sweep)
    for outcome, remedy in REMEDIES.items():
        wrong = rows.ended(outcome)
        for row in rows.read(wrong[:MAX_FAILURES]):
            given = f" ({', '.join(row.settings)})" if row.settings else ""
            facts.append((f"  run {row.run} {outcome}", f"{_line_of(row.words)}{given}"))
        more = f"{len(wrong) - MAX_FAILURES} more, see the table; " * (len(wrong) > MAX_FAILURES)
        facts += [("  ...", f"{more}{remedy}")] if wrong else []
    if (kept := tables.get(WITHIN_LIMITS)) is not None:
        good, count = np.nansum(kept.values), len(rows)
        words = f"{good:.0f} of {count} runs ({100 * good / count:.0f} %): solved, and the "
        words += "simulation satisfies goal and limits within plan.accuracy"
        facts.append(("within limits", words))
    return facts


def sweep_rows(tables: Sequence[Swept]) -> list[dict[str, Any]]:
    """Return rows with statistics of metrics, for each value of each key and over all runs."""
    parts = list[tuple[str, str, list[Array]]]()
    for k, axis in enumerate(tables[0].axes):
        whole = [np.moveaxis(each.values, k, 0) for each in tables]
        parts += [(axis.name, v, [each[j] for each in whole]) for j, v in enumerate(axis.words)]
    rows = list[dict[str, Any]]()
    for key, value, values in [*parts, ("", "all runs", [each.values for each in tables])]:
        rows.append({"key": key, "value": value})
        for each, swept in zip(values, tables, strict=True):
            there = each[np.isfinite(each)]
            if there.size:
                ends = {name: float(getattr(there, name)()) for name in STATISTICS}
                rows[-1][swept.name] = {"runs": there.size, **ends}
    return rows


def seed_facts(sweep: Sweep) -> Iterator[tuple[str, str]]:
    """Yield the range of seeds of every key that the repetitions change, as facts."""
    for i, key in enumerate(sweep.seeds):
        first = sweep.seed + i * sweep.repeat
        yield f"  {key}", f"{first} to {first + sweep.repeat - 1}"


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
        few, many = axis.words, len(axis.values)
        if many > MAX_VALUES:
            few = (*few[:3], "...", few[-1])
        count = "1 value" if many == 1 else f"{many} values"
        facts.append((f"  {axis.name}", f"{', '.join(few)} ({count})"))
    return [*facts, *seed_facts(sweep)]


def run_sweep(
    sweep: Sweep,
    rows: Rows,
    workers: Workers = 1,
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
    recipe, files = inputs.recipe_of(sweep.problem), json.dumps(sweep.files.digests)
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
