"""The table of a sweep, and what to tell about it in a few lines."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from slipfree.errors import DataError
from slipfree.named import Array
from slipfree.problem.summary import Facts
from slipfree.result_file import replaced
from slipfree.show.sweep import Swept, Varied
from slipfree.sweep.figures import COMPLETE, DEFAULT
from slipfree.sweep.grid import Run, Sweep
from slipfree.sweep.log import Row

NAME = "table.csv"
SHOWN = 3  # failures that are told in words
UNITS = {
    r"(power_law|rocks|error)\.rms|longest|shortest|spacing|base|correlation|smooth|rolled|cell|"
    r"rise|rounding|height|depth|length|distance|r1|r2|half_track|wheelbase|trail|radius|"
    r"start\.[xyz]|goal\.[xyz]": "m",
    r"speed|control\.speed": "m s-1",
    r"duration|step|lag|period": "s",
    r"heading|pitch|roll|steer|angle|\w+_stop|tilt_\w+": "rad",
    r"\w+_rate": "rad s-1",
    r"mass|\w+_mass": "kg",
    r"torque": "N m",
    r"friction|hurst|static|kinetic|utilisation|scale|\w+_scale|tolerance|height_ratio|count": "1",
}  # of the last part of a key, or of its last two


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
        "run", *sweep.keys, "outcome", "words", "time reached (s)",
        *(f"{name} ({unit})" if unit else name for name, unit in units.items()),
    ]  # fmt: skip
    lines = [_line(run, done[run.number], units) for run in sweep.runs() if run.number in done]

    def fill(part: Path) -> None:
        with part.open("w", newline="", encoding="utf-8") as open_file:
            writer = csv.writer(open_file, lineterminator="\n")
            writer.writerows([head, *lines])

    replaced(file, fill)


def _line(run: Run, row: Row, names: dict[str, str]) -> list[object]:
    values = [row.figures[name][0] if name in row.figures else "" for name in names]
    time = "" if row.t is None else row.t
    return [run.number, *run.values, *run.seeds, row.outcome, row.words, time, *values]


def chosen(sweep: Sweep, rows: Sequence[Row], names: Sequence[str]) -> tuple[str, ...]:
    """Return the figures to look at: those asked for, or those of the verb that there are.

    Raises
    ------
    DataError
        If a figure is asked for that no run has.
    """
    known = {name for row in rows for name in row.figures}
    if not names:
        return tuple(name for name in DEFAULT[sweep.problem.spec.verb] if name in known)
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
    wrong = sorted((row for row in rows if row.outcome == "failed"), key=lambda row: row.run)
    for row in wrong[:SHOWN]:
        given = f" ({', '.join(row.settings)})" if row.settings else ""
        yield f"  run {row.run} failed", f"{row.words}{given}"
    if len(wrong) > SHOWN:
        yield "  ...", f"{len(wrong) - SHOWN} more; the table has their words"


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
            for value, part in zip(axis.values, parts, strict=True):
                yield f"  {axis.name} = {value}", _spread(part, unit)


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
    axes = tuple(
        Varied(axis.key, unit_of(axis.key), axis.values, axis.numbers) for axis in sweep.axes
    )
    return Swept(name, unit, axes, values.reshape(shape))


def unit_of(key: str) -> str:
    """Return the unit of a key of a problem file; empty if it is not known."""
    *above, last = key.split(".")
    spelled = (last, f"{above[-1]}.{last}" if above else last)
    for pattern, unit in UNITS.items():
        if any(re.fullmatch(pattern, each) for each in spelled):
            return unit
    return ""


def drawn(sweep: Sweep, rows: Sequence[Row], figures: Sequence[str]) -> list[Swept]:
    """Return what to draw: the figures, and the share of complete runs if some are not."""
    short = [] if all(row.outcome == "complete" for row in rows) else [COMPLETE]
    names = dict.fromkeys([*figures, *short])
    found = (swept_of(sweep, rows, name) for name in names)
    return [swept for swept in found if np.isfinite(swept.values).any()]
