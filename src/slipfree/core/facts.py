"""Facts: results of a computation by name, with units, and the lines that show them.

Summaries, JSON output, sweeps, reports and figures render the same facts. A result file stores
those that cannot be computed from its samples. The lines of a summary are tables of `Row`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from math import pi
from string import Formatter
from typing import Any, NamedTuple

from slipfree.core.errors import read_table

# factors from SI units to the units that people read; those of slip per path length are mm/m
SCALES = {
    **{"deg": 180 / pi, "%": 100.0, "ms": 1e3},
    **{"mm": 1e3, "mm/s": 1e3, "mm/m": 1e3, "mm2/s": 1e6},
}
STATISTICS = "mean", "min", "max"  # keys of the statistics of numbers
ROUNDING = 1e-9  # smaller values in the units that people read are printed as zero
NOTE = "vehicle file"  # name of the facts on the vehicle file
MAX_LISTED = 5  # largest number of table rows in one line


class Fact(NamedTuple):
    """A value with its unit and its meaning."""

    value: Any  # number, text, or table: a list of rows, each a dict of numbers and texts
    # unit in the spelling of the CF conventions; empty for texts, for tables, and where it depends
    # on the problem, as for costs
    unit: str = ""
    words: str = ""  # description, where the name does not say all

    def __format__(self, spec: str) -> str:
        """Return value and unit as text; ``.3g>mm`` converts to the unit behind the sign."""
        spec, _, shown = spec.partition(">")
        value = self.value * SCALES[shown] if shown else self.value
        if shown and abs(value) < ROUNDING:
            value = 0.0
        if isinstance(value, float) and spec:
            spec = f"z{spec}"  # no minus zero
        unit = shown or ("" if self.unit in ("", "1") else printed_unit(self.unit))
        return f"{value:{spec}} {unit}".rstrip()


Facts = Mapping[str, Fact]
Lines = list[tuple[str, str]]  # names and texts of a summary


class Row(NamedTuple):
    """A line of a summary; its texts name facts and other values in braces, as in `str.format`."""

    name: str
    parts: tuple[str, ...]  # of the text; those that mention unknown values are left out
    is_check: bool  # whether the line is about accuracy or validity
    is_main: bool  # whether the line is printed without --verbose
    table: str  # name of a table, whose entries are further values; empty without one
    lead: str  # text before the rows of the table


def rows(text: str) -> tuple[Row, ...]:
    r"""Return the rows of a summary, in lines of the form ``NAME: TEXT``.

    A row is left out if it mentions values that a computation does not have, and so is a part of it
    in brackets. A row about accuracy or validity begins with an exclamation mark; one that commands
    print without ``--verbose`` with an asterisk, before that mark. ``NAME: LEAD <TABLE> TEXT``
    shows the rows of a table: a line for each one if the name depends on it, otherwise all in one
    line. The rows of ``gap_*`` are the facts whose names begin with ``gap_``: ``name`` is the rest
    of the name, ``fact`` the fact.

    Examples
    --------
    >>> table = rows("path: {length:.3g>mm}[, up to {z:.2f}]\ngaps: <gap_*> {name} {fact:.1e}")
    >>> lines(table, {"length": Fact(0.15, "m"), "gap_x": Fact(2e-6, "m")})
    [('path', '150 mm'), ('gaps', 'x 2.0e-06 m')]
    """
    facts = []
    for line in text.splitlines():
        name, _, words = line.lstrip("*!").partition(": ")
        *before, words = re.split(r"<([\w*]+)> ", words)
        lead, table = before or ["", ""]
        parts = tuple(filter(None, re.split(r"[\[\]]", words)))
        is_check, is_main = line.lstrip("*").startswith("!"), line.startswith("*")
        facts.append(Row(name, parts, is_check, is_main, table, lead))
    return tuple(facts)


def named_rows(name: str) -> tuple[Row, ...]:
    """Return the rows of a summary by its name in ``rows.toml``."""
    return rows(read_table(__file__, "rows.toml")[name])


def printed_unit(unit: str) -> str:
    """Return a printed unit: ``m/s`` for ``m s-1``."""
    parts = unit.split()
    over = " ".join(part for part in parts if "-" not in part) or "1"
    return "/".join([over, *(p.replace("-", "").removesuffix("1") for p in parts if "-" in p)])


def lines(rows: Iterable[Row], values: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the lines of a summary, pairs of name and text, from facts and other values."""
    found = list[tuple[str, str]]()
    for name, parts, *_, table, lead in rows:
        entries = [{**values, **entry} for entry in _table(table, values)] if table else [values]
        if not table or "{" in name:
            known = (each for each in entries if _has(name + parts[0], each))
            found += [(name.format_map(each), _text(parts, each)) for each in known]
            continue
        texts = [_text(parts, each) for each in entries]
        if len(texts) > MAX_LISTED + 1:
            texts[MAX_LISTED:] = [f"{len(texts) - MAX_LISTED} more"]
        if texts and _has(lead, values):
            found.append((name, lead.format_map(values) + ", ".join(texts)))
    return found


def _table(name: str, values: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the rows of a fact with a table, or of the facts that ``name*`` selects."""
    if name.endswith("*"):
        chosen = starting_with(name[:-1], values)
        return [{"name": rest, "fact": fact} for rest, fact in chosen.items()]
    table = values[name].value if name in values else []
    if isinstance(table, dict):
        return [{"name": rest, "fact": value} for rest, value in table.items()]
    rows = [{"fact": each} if isinstance(each, str) else each for each in table]
    # numbers of a table have no units; as facts they are converted to the units that people read
    return [{k: Fact(v) if isinstance(v, float) else v for k, v in row.items()} for row in rows]


def _text(parts: Iterable[str], values: Mapping[str, Any]) -> str:
    return "".join(part.format_map(values) for part in parts if _has(part, values))


def _has(text: str, values: Mapping[str, Any]) -> bool:
    """Return whether all names in the braces of a text are known."""
    fields = (name for _, name, _, _ in Formatter().parse(text) if name)
    return all(name.partition(".")[0] in values for name in fields)


class TableColumn(NamedTuple):
    """Column of a printed table, with the numbers or texts of one key of its rows."""

    head: str
    key: str
    spec: str = ""  # format of its numbers
    shown: str = ""  # unit of its numbers in the table, if not that of the rows: a key of `SCALES`
    risk: int = 0  # 1 if small numbers are good, -1 if large ones are


def table(columns: Iterable[TableColumn], rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the lines of a table, with a rule below the heads."""
    texts = cells(columns, rows)
    widths = [max(map(len, each)) for each in zip(*texts, strict=True)]
    texts.insert(1, ["-" * width for width in widths])
    return ["  ".join(map(str.ljust, row, widths)).rstrip() for row in texts]


def cells(columns: Iterable[TableColumn], rows: Iterable[Mapping[str, Any]]) -> list[list[str]]:
    """Return the texts of a table, heads first; values that a row does not have are dashes."""
    columns = list(columns)
    texts = ([_cell(column, row.get(column.key)) for column in columns] for row in rows)
    return [[column.head for column in columns], *texts]


def _cell(column: TableColumn, value: Any) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        mean, low, high = (f"{value[key]:.3g}" for key in STATISTICS)
        return mean if low == high else f"{mean} ({low} to {high})"
    if hasattr(value, "__iter__"):
        return " ".join(_cell(column, each) for each in value)
    if value is None or value != value:  # NaN
        return "-"
    return format(SCALES[column.shown] * value if column.shown else value, column.spec)


def best_text(column: TableColumn, rows: Iterable[Mapping[str, Any]]) -> str | None:
    """Return the text of the best value of a column; None if all are equal or have no risk."""
    values = [row[column.key] for row in rows if column.risk and row.get(column.key) is not None]
    numbers = [each["mean"] if isinstance(each, Mapping) else each for each in values]
    worths = [column.risk * (max(n) if hasattr(n, "__iter__") else n) for n in numbers]
    best = min(worths, default=0.0, key=lambda worth: (worth != worth, worth))  # NaN last
    return _cell(column, values[worths.index(best)]) if len({*worths}) > 1 else None


def decode(text: str) -> dict[str, Fact]:
    """Return the facts in a JSON text of a mapping; raise ValueError for other texts."""
    try:
        return {
            str(name): Fact(value, str(unit), str(words))
            for name, (value, unit, words) in json.loads(text).items()
        }
    except (AttributeError, TypeError, RecursionError) as error:
        raise ValueError(f"expected facts as JSON, found {text[:40]!r}") from error


def numbers(facts: Facts) -> dict[str, Fact]:
    """Return the facts whose values are numbers."""
    return {name: fact for name, fact in facts.items() if isinstance(fact.value, int | float)}


def starting_with(prefix: str, facts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the facts whose names begin with a prefix, by the rest of their names."""
    return {
        name.removeprefix(prefix): fact for name, fact in facts.items() if name.startswith(prefix)
    }


def in_short(facts: Lines) -> Lines:
    """Return facts with guesses and other choices on a vehicle in short, without other notes."""
    notes = [text.partition("; otherwise") for name, text in facts if name == NOTE]
    shown = [t for t, other, _ in notes if other or t.startswith(("guess", "clearance w", "drive"))]
    file = "lines for a vehicle file, which --write NAME.toml makes"
    count = f"all {len(notes)} notes in full, and the tree of parts"
    shown += [f"{count}, with {file}: slipfree vehicle FILE -v"]
    others = [each for each in facts if each[0] != NOTE]
    return others + [(NOTE, text) for text in shown * bool(notes)]


def guesses(attributes: Mapping[str, str]) -> Lines:
    """Return the line with the guesses that the reader made about a vehicle.

    Of a note such as "guessed driven: no wheel has an actuator: left, right; otherwise write x" it
    has "driven (no wheel has an actuator)", without the parts and the other choice. Details in
    brackets and reasons that begin with "since" are left out.
    """
    notes = attributes.get(NOTE.replace(" ", "_"), "").split("\n")
    choices = [note.partition("; otherwise")[0] for note in notes if "; otherwise" in note]
    made = [choice.removeprefix("guessed ").rpartition(": ")[0] for choice in choices]
    short = [
        re.sub(r": (.*)", r" (\1)", re.split(r" \(|, since ", each)[0])
        for each in made[:MAX_LISTED]
    ]
    where = f"slipfree vehicle {attributes.get('problem_file', 'FILE')} -v"
    text = f"guessed: {'; '.join(short)}; all {len(notes)} notes: {where}"
    return [(NOTE, text)] if made else []


def as_attributes(facts: Lines) -> dict[str, str]:
    """Return facts as attributes of a file; one with several lines if names are the same."""
    texts = dict[str, str]()
    for name, text in facts:
        key = name.replace(" ", "_")
        texts[key] = f"{texts[key]}\n{text}" if key in texts else text
    return texts


def of_attributes(attributes: Mapping[str, str]) -> Lines:
    """Return attributes of a file as facts, one for each line of a text."""
    return [
        (name.replace("_", " "), line)
        for name, text in attributes.items()
        for line in text.split("\n")
    ]
