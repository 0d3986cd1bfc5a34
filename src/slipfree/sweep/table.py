"""The table of a sweep, and what to tell about it in a few lines."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from slipfree.atomic_files import replace_file
from slipfree.errors import DataError
from slipfree.problem.units import unit_of
from slipfree.problem.verbs.registry import verb_of
from slipfree.records import Array
from slipfree.show.sweep_results import Swept, Varied
from slipfree.sweep.grid import Run, Sweep
from slipfree.sweep.log import FAILED, LOST, Row
from slipfree.sweep.task import COMPLETE

if TYPE_CHECKING:
    from slipfree.problem.summary import Facts

NAME = "table.csv"
SHOWN = 3  # failures that are told in words
MOST_VALUES = 10  # of a key whose figures are told
MOST_LETTERS = 300  # of the words of a run; the log has all
REMEDIES = {
    FAILED: "--again repeats runs that failed",
    LOST: "the same command does runs that were lost again",
}


def write_table(file: Path, sweep: Sweep, rows: Sequence[Row]) -> None:
    """Write one line a finished run, in the order of the runs.

    The columns are number, varied keys, seeds, outcome, words, time reached and figures with their
    units; what a run does not have is empty. Wall times are left to the log, so that the same
    sweep gives the same table.

    Raises
    ------
    DataError
        If the file cannot be written.
    """
    done = {row.run: row for row in rows}
    ordered = [done[number] for number in sorted(done)]
    units = {name: unit for row in ordered for name, (_, unit) in row.figures.items()}
    head = [
        "run",
        *sweep.keys,
        "outcome",
        "words",
        "time reached (s)",
        *(f"{name} ({unit})" if unit else name for name, unit in units.items()),
    ]
    lines = [_line(run, done[run.number], units) for run in sweep.runs() if run.number in done]

    def fill(part: Path) -> None:
        with part.open("w", newline="", encoding="utf-8", errors="backslashreplace") as open_file:
            writer = csv.writer(open_file, lineterminator="\n")
            writer.writerows([head, *lines])

    replace_file(file, fill)


def _line(run: Run, row: Row, names: dict[str, str]) -> list[object]:
    values = [row.figures[name][0] if name in row.figures else "" for name in names]
    time = "" if row.t is None else row.t
    return [run.number, *run.values, *run.seeds, row.outcome, _line_of(row.words), time, *values]


def _line_of(words: str) -> str:
    """Return words as one line that is not too long."""
    joined = " ".join(words.split())
    return joined if len(joined) <= MOST_LETTERS else f"{joined[: MOST_LETTERS - 3]}..."


def chosen(sweep: Sweep, rows: Sequence[Row], names: Sequence[str]) -> tuple[str, ...]:
    """Return the figures to look at: those asked for, or those of the verb that there are.

    Raises
    ------
    DataError
        If a figure is asked for that no run has.
    """
    known = {name for row in rows for name in row.figures}
    if not names:
        return tuple(name for name in verb_of(sweep.problem).metrics_shown if name in known)
    for name in names:
        if name not in known:
            raise DataError(
                f"--figure {name}: expected a figure of these runs, one of "
                f"{', '.join(sorted(known)) or 'none'}; the runs are kept, and the same command "
                "with another figure only tells and draws"
            )
    return tuple(names)


def facts(sweep: Sweep, rows: Sequence[Row], figures: Sequence[str]) -> Facts:
    """Return name and value of what matters about a sweep, ready to print."""
    return [*_outcomes(sweep, rows), *_kept(rows), *_spreads(sweep, rows, figures)]


def _outcomes(sweep: Sweep, rows: Sequence[Row]) -> Iterator[tuple[str, str]]:
    counts = Counter(row.outcome for row in rows)
    listed = ", ".join(f"{count} {outcome}" for outcome, count in counts.most_common())
    yield "runs", f"{len(rows)} of {sweep.count}" + (f": {listed}" if listed else "")
    for i, key in enumerate(sweep.seeds):
        first = sweep.seed + i * sweep.repeat
        yield f"  {key}", f"{first} to {first + sweep.repeat - 1}"
    for outcome, remedy in REMEDIES.items():
        wrong = sorted((row for row in rows if row.outcome == outcome), key=lambda row: row.run)
        for row in wrong[:SHOWN]:
            given = f" ({', '.join(row.settings)})" if row.settings else ""
            yield f"  run {row.run} {outcome}", f"{_line_of(row.words)}{given}"
        more = f"{len(wrong) - SHOWN} more; the table has their words; " * (len(wrong) > SHOWN)
        if wrong:
            yield "  ...", f"{more}{remedy}"


def _kept(rows: Sequence[Row]) -> Iterator[tuple[str, str]]:
    """Yield the share of plans that keep to their limits."""
    if not any("within_limits" in row.figures for row in rows):
        return
    kept = sum(row.figures.get("within_limits", (0.0, ""))[0] for row in rows)
    yield (
        "within limits",
        f"{kept:.0f} of {len(rows)} runs ({100 * kept / len(rows):.0f} %): solved, and their "
        "simulation keeps goal and limits to plan.accuracy",
    )


def _spreads(
    sweep: Sweep, rows: Sequence[Row], figures: Sequence[str]
) -> Iterator[tuple[str, str]]:
    """Yield mean and range of figures: over all runs, and for every value of every key."""
    for name in figures:
        swept = swept_of(sweep, rows, name)
        unit = "" if swept.unit in ("1", "") else f" {swept.unit}"
        yield name, f"{_spread(swept.values, unit)}"
        for k, axis in enumerate(swept.axes):
            parts = np.moveaxis(swept.values, k, 0)
            for value, part in list(zip(axis.values, parts, strict=True))[:MOST_VALUES]:
                yield f"  {axis.name} = {value}", _spread(part, unit)
            if len(parts) > MOST_VALUES:
                yield "  ...", f"{len(parts) - MOST_VALUES} more values; {NAME} has all"


def _spread(values: Array, unit: str) -> str:
    there = values[np.isfinite(values)]
    if not there.size:
        return "no run"
    return (
        f"mean {there.mean():.5g}, {there.min():.5g} to {there.max():.5g}{unit} "
        f"({there.size} {'run' if there.size == 1 else 'runs'})"
    )


def swept_of(sweep: Sweep, rows: Sequence[Row], name: str) -> Swept:
    """Return a figure over the grid and the repetitions; not a number where a run has none."""
    shape = (*(len(axis.values) for axis in sweep.axes), sweep.repeat)
    values, unit = np.full(int(np.prod(shape)), np.nan), ""
    for row in rows:
        if name in row.figures:
            values[row.run - 1], unit = row.figures[name]
    spec = sweep.problem.spec
    axes = tuple(
        Varied(axis.key, unit_of(spec, axis.key), axis.values, axis.numbers) for axis in sweep.axes
    )
    return Swept(name, unit, axes, values.reshape(shape))


def drawn(sweep: Sweep, rows: Sequence[Row], figures: Sequence[str]) -> list[Swept]:
    """Return what to draw: the figures, and the share of complete runs if some are not."""
    short = [] if all(row.outcome == "complete" for row in rows) else [COMPLETE]
    names = dict.fromkeys([*figures, *short])
    found = (swept_of(sweep, rows, name) for name in names)
    return [swept for swept in found if np.isfinite(swept.values).any()]
