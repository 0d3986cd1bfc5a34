"""Tasks and rows of a sweep, and its log: a line of JSON per finished run, synchronised to disk.

Complete lines are kept if the sweep is killed. An incomplete line is removed when the sweep
continues, and its run is repeated.
"""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple

from slipfree.core.errors import DataError
from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.files.netcdf import NOTHING
from slipfree.system.regular_files import regular_file

try:
    import fcntl
except ImportError:  # Windows has no such lock: the user must avoid two sweeps at a time
    fcntl = None  # type: ignore[assignment]

COMPLETE = "complete"  # figure of every run: 1 if it reached its end
NAME = "runs.jsonl"
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


class Rows:
    """The finished runs in a log, read from disk on demand.

    ``outcomes`` counts the finished runs by outcome; ``last`` is the last run that finished in this
    process.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offsets: dict[int, tuple[int, str]] = {}  # by run: byte in the file, outcome
        self._units: dict[str, tuple[int, int, str]] = {}  # by metric: first run, position, unit
        self.outcomes: Counter[str] = Counter()
        self.last: RunRow | None = None

    def __len__(self) -> int:
        """Return the number of finished runs."""
        return len(self._offsets)

    def __contains__(self, run: int) -> bool:
        """Return whether a run is finished."""
        return run in self._offsets

    def __iter__(self) -> Iterator[RunRow]:
        """Yield the rows in the order of the runs."""
        return self.read(sorted(self._offsets))

    def read(self, runs: Iterable[int]) -> Iterator[RunRow]:
        """Yield the rows of finished runs with the given numbers, in this order."""
        with self._path.open("rb") as file:
            for run in runs:
                file.seek(self._offsets[run][0])
                yield row_of(json.loads(file.readline()))

    def ended(self, *outcomes: str) -> list[int]:
        """Return the numbers of the runs with one of the given outcomes, in ascending order."""
        return sorted(run for run, (_, outcome) in self._offsets.items() if outcome in outcomes)

    @property
    def units(self) -> dict[str, str]:
        """Units of all metrics by name, in the order of the first run that has them."""
        ordered = sorted(self._units.items(), key=lambda each: each[1])
        return {name: unit for name, (_, _, unit) in ordered}

    def add(self, row: RunRow, offset: int) -> None:
        """Add a finished run whose line begins at byte ``offset``; replace its earlier result."""
        self.discard(row.run)
        self._offsets[row.run] = offset, sys.intern(row.outcome)
        self.outcomes[row.outcome] += 1
        for k, (name, (_, unit)) in enumerate(row.figures.items()):
            found = self._units.get(name)
            if found is None or (row.run, k) < found[:2]:
                self._units[sys.intern(name)] = row.run, k, sys.intern(unit)

    def discard(self, run: int) -> None:
        """Remove the result of a run, if there is one."""
        if run in self._offsets:
            self.outcomes[self._offsets.pop(run)[1]] -= 1


def row_of(line: Mapping[str, Any]) -> RunRow:
    """Return the row of a line of the log.

    A TypeError, ValueError, AttributeError or OverflowError says that the line describes no run.
    """
    row = RunRow(**line)
    if not all(isinstance(each, str) for each in (row.outcome, row.words, *row.settings)):
        raise TypeError("outcome, words and settings are not texts")
    figures = {name: (float(value), str(unit)) for name, (value, unit) in row.figures.items()}
    t = None if row.t is None else float(row.t)
    head = RunRow(int(row.run), tuple(row.settings), row.outcome, row.words, t, figures, 0.0)
    return head._replace(seconds=float(row.seconds))


class RunLog:
    """The open log of a sweep; a context manager."""

    def __init__(
        self,
        path: Path,
        head: Mapping[str, Any],
        settings_of: Callable[[int], tuple[str, ...]] | None = None,
        *,
        again: bool = False,
    ) -> None:
        """Open or create a log.

        ``settings_of`` returns the settings that the line of a run must have, and raises ValueError
        for a number without a run. Lost runs do not count as finished; with
        ``again``, neither do failed runs. DataError is raised if the file cannot be written, is not
        a regular file, is used by another process, is damaged, or belongs to another sweep.
        """
        self._settings_of = settings_of
        self.path, self._open = path, {LOST, *([FAILED] if again else [])}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.exists():
                with regular_file(path, "the log of a sweep"):  # not a pipe, which does not open
                    pass
            self._file: IO[bytes] = path.open("a+b")
        except OSError as error:
            raise self._unwritable(error) from error
        try:
            self._lock()
            self.rows = Rows(path)
            self._read(head)
        except BaseException:
            with suppress(OSError):  # the error of the write is reported
                self._file.close()
            raise

    def append(self, row: RunRow) -> None:
        """Write a row and synchronise it to disk.

        Raises DataError if the file cannot be written.
        """
        self.rows.add(row, self._write(row._asdict()))
        self.rows.last = row

    def __enter__(self) -> RunLog:
        """Return the log."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file, which releases its lock."""
        with suppress(OSError):  # the error of the write was reported
            self._file.close()

    def _lock(self) -> None:
        """Lock the file for other processes until it is closed or this process ends."""
        if fcntl is None:
            return
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise DataError(
                f"{self.path}: expected a log that no other process writes, found one in use; wait "
                "until the other sweep ends, or choose another folder with -o"
            ) from error

    def _read(self, head: Mapping[str, Any]) -> None:
        """Read the finished runs; remove an incomplete line; write the head of an empty log."""
        self._file.seek(0)
        offset = 0
        for number, line in enumerate(self._file, 1):
            if not line.endswith(b"\n"):
                self._file.truncate(offset)
                break
            found = self._parsed(number, line)
            if number == 1:
                self._check(found, head)
            else:
                self._add(number, found, offset)
            offset += len(line)
        if not offset:
            self._write(dict(head))

    def _parsed(self, number: int, line: bytes) -> dict[str, Any]:
        try:
            found = json.loads(line)
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, dict):
            raise self._damaged(number)
        return found

    def _add(self, number: int, line: Mapping[str, Any], offset: int) -> None:
        try:
            row = row_of(line)
            if self._settings_of is not None and row.settings != self._settings_of(row.run):
                raise ValueError("the settings are those of another run")
        except (TypeError, ValueError, AttributeError, OverflowError) as error:
            raise self._damaged(number) from error
        if row.outcome in self._open:
            self.rows.discard(row.run)  # the run was repeated
        else:
            self.rows.add(row, offset)

    def _damaged(self, number: int) -> DataError:
        if number == 1:
            return DataError(
                f"{self.path}:1: expected the description of a sweep in JSON, found something "
                "else; choose another folder with -o"
            )
        return DataError(
            f"{self.path}:{number}: expected one line of JSON for a run of this sweep, with its "
            "settings, found something else; remove the line, and repeat the command to repeat the "
            "run"
        )

    def _check(self, found: Mapping[str, Any], head: Mapping[str, Any]) -> None:
        for key, words in WORDS.items():
            if found.get(key) != head[key]:
                raise DataError(
                    f"{self.path}: expected results of this sweep, found some with another {words}"
                    f"{_how(key, found.get(key), head[key])}; choose another folder with -o, or "
                    "remove this file"
                )

    def _write(self, what: Mapping[str, Any]) -> int:
        """Write a line of JSON; return the byte at which it begins; raise DataError on failure."""
        try:
            offset = self._file.seek(0, os.SEEK_END)
            self._file.write(json.dumps(what, allow_nan=False).encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise self._unwritable(error) from error
        return offset

    def _unwritable(self, error: OSError) -> DataError:
        return DataError(
            f"{self.path}: cannot be written ({error.strerror}); free disk space or choose another "
            "folder with -o; finished runs are kept"
        )


def _how(key: str, old: Any, new: Any) -> str:
    """Return a text with the former and the new value of a key in the first line of a log."""
    if key == "problem":
        return ""
    if key == "files":
        names = {**(old or {}), **new}
        return ": " + ", ".join(name for name in names if (old or {}).get(name) != new.get(name))
    return f": {_short(old)}, now {_short(new)}"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


class RunTask(NamedTuple):
    """Task for a process: one run, with the text of the problem but not its input files."""

    run: int  # its number
    file: str  # path of the problem file; input files are read relative to its folder
    text: str  # of the problem file
    settings: tuple[str, ...]  # settings as ``key=value``
    own: int  # number of settings that are specific to this run; they are the last ones
    keep: bool  # whether to return the motion
    # identifier of the content of the input files. Runs of one process share maps and models if it
    # is the same
    files: str
    trusted: frozenset[str] = frozenset()  # paths of xacro files that the command line trusts


class Done(NamedTuple):
    """The result of a task."""

    row: RunRow  # row for log and table
    trajectory: Trajectory | None = None  # the motion, if it is requested and exists
    # arrays of a plan for a warm start; empty for other motions
    arrays: Mapping[str, Array] = NOTHING


def without_motion(task: RunTask, outcome: str, words: str, seconds: float = 0.0) -> Done:
    """Return the result of a failed or lost run, with the reason; it has no motion."""
    return Done(
        RunRow(task.run, own_settings(task), outcome, words, None, {COMPLETE: (0.0, "1")}, seconds)
    )


def own_settings(task: RunTask) -> tuple[str, ...]:
    """Return the settings of a task that are specific to its run."""
    return task.settings[len(task.settings) - task.own :]
