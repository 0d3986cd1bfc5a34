"""Tasks and rows of a sweep, and the log of its finished runs."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.files.netcdf import NOTHING
from slipfree.problem.load import Recipe
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
    """The finished runs of a sweep, whose rows are read from disk on demand; a context manager.

    ``outcomes`` counts the finished runs by outcome; ``last`` is the last run that finished in this
    process.
    """

    def __init__(
        self, folder: Path, count: int, head: Mapping[str, Any], *, again: bool = False
    ) -> None:
        """Open the folder of a sweep of ``count`` runs.

        Lost runs do not count as finished; with ``again``, neither do failed runs. Errors are those
        of `Parts`.
        """
        self._outcomes: dict[int, str] = {}  # by run
        self._units: dict[str, tuple[int, int, str]] = {}  # by metric: first run, position, unit
        self.outcomes: Counter[str] = Counter()
        self.last: RunRow | None = None
        self._parts = Parts(folder, Identity("sweep", count, head, WORDS))
        for row in self.read(self._parts):
            if row.outcome in (LOST, *([FAILED] if again else [])):
                self._parts.discard(row.run)
            else:
                self._count(row)

    def __len__(self) -> int:
        """Return the number of finished runs."""
        return len(self._outcomes)

    def __contains__(self, run: int) -> bool:
        """Return whether a run is finished."""
        return run in self._outcomes

    def __iter__(self) -> Iterator[RunRow]:
        """Yield the rows in the order of the runs."""
        return self.read(self._parts)

    def __enter__(self) -> Rows:
        """Return the rows."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the log."""
        self._parts.close()

    def read(self, runs: Iterable[int]) -> Iterator[RunRow]:
        """Yield the rows of finished runs with the given numbers, in this order."""
        for run in runs:
            record = self._parts.record(run)
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

    def append(self, row: RunRow) -> None:
        """Write a row and synchronise it to disk; errors are those of `Parts`."""
        record = row._asdict()
        self._parts.add(record.pop("run"), record)
        self._count(row)
        self.last = row

    def _count(self, row: RunRow) -> None:
        self._outcomes[row.run] = sys.intern(row.outcome)
        self.outcomes[row.outcome] += 1
        for k, (name, (_, unit)) in enumerate(row.figures.items()):
            found = self._units.get(name)
            if found is None or (row.run, k) < found[:2]:
                self._units[sys.intern(name)] = row.run, k, sys.intern(unit)


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
