"""Tables of numbers in text files: separators, comments, names and units of columns.

Tables of paths and commands are also read from MCAP files (`slipfree.files.mcap`).
"""

from __future__ import annotations

import csv
import io
import math
import operator as op
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from functools import partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np

from slipfree.core.errors import DataError, read_table
from slipfree.core.quantities import QUANTITIES
from slipfree.core.records import Array
from slipfree.files.foreign_formats import check_contents, check_ending
from slipfree.files.mcap import is_mcap, read_mcap, yaw_of
from slipfree.system.regular_files import read_bytes, replacing

SHOWN, LONG = 60, 300  # longest line, and longest list of names, in messages
SAMPLE = 200, 200_000  # most lines and characters from which the layout is inferred
SEPARATORS = (";", "|", "\t", ",", None)  # None: blanks
# no colour within a line, as of points, and no error of a spreadsheet, as in #N/A
COMMENT = re.compile(r"^\s*#|#(?![0-9a-fA-F]{6}\b|N/A|NV\b|[A-Z/0]+[!?])")
COMMENTS = ("#", "%", "//")
UNIT_TABLE = read_table(__file__, "units.toml")
REMEDIES: dict[str, str] = UNIT_TABLE.pop("remedies")
# names of the same quantity, in the order t, x, y, z, heading, longitude, latitude
ALIASES = tuple({*names.split(", ")} for names in UNIT_TABLE.pop("aliases"))
UNIT_FACTORS = {  # factors to SI units, by the SI unit, or "heights", and the name of the unit
    unit: {name: float(factor) for names, factor in rows.items() for name in names.split(", ")}
    for unit, rows in UNIT_TABLE.items()
}
UNITS = {  # SI unit of a column, and factor to it
    name: (unit.replace("heights", "m"), factor)
    for unit, factors in UNIT_FACTORS.items()
    for name, factor in factors.items()
}
UNIT_IN_NAME = (  # "x [m]", "time(s)"; "t / s"; "left_rad_s", "vx_m_per_s"; "yaw_deg"
    re.compile(r"^(.*?)[\s_]*[\[(]\s*(.*?)\s*[\])]$"),
    re.compile(r"^(.*?)\s*/\s*(\S+)$"),
    re.compile(r"^(.*?)_([^\W_]+_(?:per_)?[sh])$"),
    re.compile(r"^(.*)_([^\W_]+)$"),
)
HEAD = 1 << 16  # bytes from which the encoding is inferred
COUNTS = {2: "two", 3: "three", 4: "four"}
DAY, TIME_OF_DAY = 86400.0, 10957  # length of a day [s], and that of times of day since 1970 [1]
EPOCH = 1e8  # smallest time that counts from a fixed date, not from the start of a log [s]
# cells without a number, in small letters
MISSING = ("", "nan", "na", "n/a", "#n/a", "#nv", "null", "none", "-")
PARTS = {  # columns from which a quantity follows: pattern of stem and part, and required parts
    "t": (re.compile(r"(.*?)((?:nano|n)?sec(?:s|onds)?)$", re.IGNORECASE), "sn"),
    "heading": (
        re.compile(r"(.*(?:q|quat(?:ernion)?|orientation|rotation)[._[]?)([xyzw0-4])]?$", re.I),
        "zw",
    ),
}
UNIT_LENGTH = 0.1  # largest error of the square of a quaternion's length
TILT, TILTED = 0.15, 0.1  # of 45 deg, and share of such rows that is of another order [1]
DATES = "write dates as in 2026-03-01T12:00:00.5, or times in s"
# units of times that count from a fixed date
LARGE_TIMES = {"ns": "nanoseconds", "us": "microseconds", "ms": "milliseconds"}


class _TextTable(NamedTuple):
    """A table as text, and its layout."""

    path: Path
    file: TextIO
    separator: str | None  # of the columns; None for blanks
    first: int  # number of the first row's line
    header: str  # line with the names; empty without one
    names: list[str]  # of the columns as in the file; empty without such a line
    units: list[str]  # in the line below the names; empty without such a line
    row: list[str]  # first row; empty if there is none

    @property
    def columns(self) -> list[str]:
        return self.names or [str(k + 1) for k in range(len(self.row))]

    def lines(self, wanted: str) -> Iterator[tuple[int, str]]:
        """Yield number and text of the line of each row; DataError for a row of another width."""
        separator, width = self.separator, len(self.row)
        self.file.seek(0)
        for number, line in enumerate(self.file, start=1):
            text = _line_body(line, separator)
            if not text or number < self.first or text == self.header:  # repeated in joined files
                continue
            count = 0 if separator is None or '"' in text else text.count(separator) + 1
            if count != width and not _has_width(_line_cells(text, separator), width):
                raise self.error(number, text, wanted, "correct or remove the line")
            yield number, text

    def error(self, number: int, text: str, wanted: str, remedy: str) -> DataError:
        """Return the error of a line."""
        found = text[:SHOWN]
        return DataError(f"{self.path}:{number}: expected {wanted}, found {found!r}; {remedy}")


class Columns(NamedTuple):
    """Columns of a table, in SI units."""

    values: dict[str, Array]  # shape (n,): values by requested name
    notes: tuple[str, ...] = ()  # conversions and choices that were made
    start: float = 0.0  # first time, if times since a date count from it [s]

    def rows(self) -> list[tuple[float, ...]]:
        """Return the rows of the table."""
        return [*zip(*(column.tolist() for column in self.values.values()), strict=True)]


def write_rows(path: Path, names: Sequence[str], rows: Iterable[Iterable[object]]) -> None:
    """Write a table of comma-separated values; an existing file is replaced when it is complete."""
    with (
        replacing(path) as part,
        part.open("w", newline="", encoding="utf-8", errors="backslashreplace") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(rows)


def write_records(path: Path, records: Sequence[Mapping[str, object]]) -> None:
    """Write a table whose rows are records with the same names, as `write_rows` does."""
    write_rows(path, [*next(iter(records), {})], (record.values() for record in records))


def read_names(path: Path, expected: str) -> list[str]:
    """Return the names of a table's columns without units; ``"1"``, ``"2"``, ... if it has none."""
    if is_mcap(path):
        return [*read_mcap(path, "v_x")]
    layout = _opened(path, expected)
    bases = [split_unit(name)[0] for name in layout.columns]
    return ["t" if base.lower() in ALIASES[0] else base for base in bases]


def read_columns(
    path: Path,
    columns: Sequence[str] | Mapping[str, str],
    expected: str = "way-points",
    *,
    where: str = "the first line",
    others: bool = False,
    units: Mapping[str, str] | None = None,
    optional: Collection[str] = (),
) -> Columns:
    """Return columns of a table of numbers, in SI units.

    A mapping ``columns`` has the name in the file of each name in the result: it may have a unit,
    which replaces that of the file, and may be the number of the column if the table has no names.
    Without names, the table must have exactly these columns, or more if ``others``. ``units`` are
    SI units of further quantities by name in the result. Cells of the ``optional`` columns without
    a number are NaN. Times follow from columns of seconds and nanoseconds, headings from a
    quaternion, if there is no column of them.

    In messages, ``expected`` is the kind of the table and ``where`` the place at which its columns
    are named.
    """
    names = dict(columns) if isinstance(columns, Mapping) else {name: name for name in columns}
    if is_mcap(path):
        table = read_mcap(path, [*names][-1])
        return Columns({key: table[name] for key, name in names.items()})
    layout = _opened(path, expected)
    width, count = len(layout.row), len(names)
    wanted = f"{COUNTS.get(count, count)} numbers {','.join(names)}"
    notes = []
    if not isinstance(columns, Mapping) and not layout.names:
        chosen = {name: (k, "") for k, name in enumerate(names)}
        if width > count and others:
            # the first column may count or name the rows
            cells = [_line_cells(text, layout.separator)[0] for _, text in layout.lines(wanted)]
            first, size = cells[0], len(cells)
            least = int(first) if first.isdigit() else 0
            counts = [str(k) for k in range(least, least + size)]
            if (size > 1 and cells == counts) or not _is_number(first, layout.separator):
                raise DataError(
                    f"{path}:{layout.first}: expected {wanted} in the first columns, found "
                    f"that the first column counts or names the rows, from {first!r}; name "
                    f"the columns in {where}, as in number,{wanted.split()[-1]}"
                )
            notes = [f"{', '.join(names)} are the first {count} of {width} columns"]
        elif width != count and layout.row:
            text = (layout.separator or " ").join(layout.row)
            remedy = f"name the columns in {where}, or correct the line"
            raise layout.error(layout.first, text, wanted, remedy)
    else:
        chosen = _choose(layout, names, where)
    if width > count:  # of rows that are too short
        wanted = f"{width} values as in the first row, with numbers for {','.join(names)}"
    free = {key for key in chosen if key.split(":")[0] in optional}
    read = dict(zip(chosen, _read_numbers(layout, chosen, wanted, free).T, strict=True))
    if "t:s" in read:
        read["t"], chosen["t"] = 1e9 * read["t:s"] + read["t:n"], (chosen["t:s"][0], "ns")
    if "heading:z" in read:
        q = [read.get(f"heading:{part}", 0 * read["heading:z"]) for part in "xyzw"]
        is_turn = np.abs(np.square(q).sum(axis=0) - 1) < UNIT_LENGTH
        if np.mean(np.square(q[:2]).sum(axis=0) > TILT) > TILTED:
            found = f"tilts of more than 45 degrees in more than {TILTED:.0%} of the rows"
            remedy = "correct the names of the four parts: w is probably another one"
            wanted = "quaternions of a vehicle that stands upright"
            raise DataError(f"{path}: expected {wanted}, found {found}; {remedy}")
        read["heading"] = np.where(is_turn, yaw_of(*q), np.nan)
        chosen["heading"] = chosen["heading:z"][0], "rad"
    values, start = {}, 0.0
    si_units = {n: QUANTITIES[n].unit for n in ("x", "y", "heading")} | {"t": "s", **(units or {})}
    for name in names:
        index, unit = chosen[name]
        is_own = layout.names and not any(key.startswith(f"{name}:") for key in chosen)
        title = layout.names[index] if is_own else name
        symbol, factor = (unit and known_unit(unit)) or (si_units.get(name, ""), 1.0)
        if symbol != si_units.get(name, symbol):
            remedy = REMEDIES.get(f"{symbol} to {si_units[name]}", REMEDIES["units"])
            raise DataError(
                f"{path}: expected values in {si_units[name]} in the column {title!r}, found "
                f"{unit}; {remedy}"
            )
        notes += [f"{title} converted from {unit} to {symbol}"] if factor != 1 else []
        column = read[name]
        if name in ALIASES[0] and column.size:
            if np.ptp(column // DAY) == 0 and column[0] // DAY == TIME_OF_DAY:
                column = column + DAY * np.cumsum(np.diff(column, prepend=column[0]) < -DAY / 2)
            largest = float(np.abs(column).max())
            for short, word in LARGE_TIMES.items():
                if not unit and largest >= EPOCH / UNITS[short][1]:
                    raise DataError(
                        f"{path}: expected times in s, found values up to {largest:.3g} in the "
                        f"column {title!r}, probably {word}; name it {f'{title} [{short}]'!r} in "
                        f"{where}"
                    )
            if factor * column.min() >= EPOCH:
                start = factor * float(column[0])
                notes.append(f"{title} counts from the first time, {start:.10g} s")
                column = column - column[0]  # before the conversion: less rounding
        values[name] = factor * column
    return Columns(values, tuple(notes), start)


def line_of(path: Path, row: int) -> int:
    """Return the number of the line of a row of a table, which counts from zero."""
    if path.suffix.lower() in (".mcap", ".nc"):
        return row + 1
    return next(islice(_opened(path, "a table").lines("numbers"), row, None))[0]


def known_unit(text: str) -> tuple[str, float] | None:
    """Return the SI unit and the factor of a unit, also in brackets; None if it is not known."""
    text = re.sub("_(per_)?", "/", text.strip("[]() "))
    text = re.sub(r"[ .·*]s(\^?-1|⁻¹)$", "/s", text)
    return UNITS.get(text, UNITS.get(text.lower()))


def split_unit(name: str) -> tuple[str, str]:
    """Return the name and the unit in the name of a column; the unit is empty if it has none."""
    for pattern in UNIT_IN_NAME:
        match = pattern.match(name)
        if match and match[1] and known_unit(match[2]):
            return match[1], match[2]
    return name, ""


def parts_of(key: str, names: Sequence[str]) -> dict[str, dict[str, int]]:
    """Return the numbers of the columns of the parts of a quantity, by what precedes the part.

    Parts are those of `PARTS`: s, n; w, x, y, z, or numbers from 0 or from 1 in this order.
    """
    stems = defaultdict[str, dict[str, int]](dict)
    for k, name in enumerate(names):
        if match := PARTS[key][0].match(name):
            stems[match[1]][match[2][0].lower()] = k
    for stem, parts in stems.items():
        order = str.maketrans("1234" if "4" in parts else "0123", "wxyz")
        stems[stem] = {part.translate(order): k for part, k in parts.items()}
    return stems


def _opened(path: Path, expected: str) -> _TextTable:
    """Return a table, with the separator that divides most lines alike."""
    content = read_bytes(path, f"{expected} as text")
    check_ending(path, "table", f"{expected} as text")
    check_contents(path, "table", f"{expected} as text")
    encoding = "utf-8-sig"
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    else:
        try:
            content[:HEAD].decode()
        except UnicodeDecodeError as error:
            if error.start <= len(content[:HEAD]) - 4:  # else only the last character is cut
                encoding = "cp1252"
    file = io.TextIOWrapper(io.BytesIO(content), encoding=encoding, errors="replace")
    lines: list[str] = []
    while len(lines) < SAMPLE[0] and sum(map(len, lines)) < SAMPLE[1] and (line := file.readline()):
        lines.append(line)
    candidates: list[tuple[tuple[int, int], str | None, int]] = []
    for separator in SEPARATORS:
        texts = [text for line in lines if (text := _line_body(line, separator))]
        rows = [_line_cells(text, separator) for text in texts]
        widths = Counter(len(row) for row in rows if len(row) > 1)
        width, count = max(widths.items(), key=lambda item: item[1], default=(0, 0))
        cells = [cell for row in rows if len(row) == width for cell in row]
        is_split = not any(_is_row(cell.split(), None) for cell in cells)
        numbers = sum(_is_number(cell, separator) for cell in cells)
        if is_split and numbers:
            candidates.append(((count, numbers), separator, width))
    if not candidates:  # a table without rows, or rows that are not numbers
        used = [(k, text) for k, line in enumerate(lines, 1) if (text := _line_body(line, None))]
        if not used:
            raise DataError(f"{path}: expected a table, found an empty file; write it again")
        for number, text in used[1:]:
            if re.search(r"\d", text):
                raise DataError(
                    f"{path}:{number}: expected two or more numbers, found {text[:SHOWN]!r}; write "
                    "numbers as in 1.5 or 1.5e-3, separated by commas, semicolons, tabs or blanks"
                )
        text = used[0][1]
        separator = next((each for each in SEPARATORS[:-1] if each in text), None)
        return _TextTable(path, file, separator, 0, text, _line_cells(text, separator), [], [])
    _, separator, width = max(candidates, key=lambda candidate: candidate[0])
    return _layout_with(path, file, lines, separator, width)


def _line_body(line: str, separator: str | None) -> str:
    """Return a line without comment and blanks at its ends; empty tab-separated cells remain."""
    text = COMMENT.split(line, maxsplit=1)[0] if "#" in line else line
    text = text.strip(" \r\n" if separator == "\t" else None)
    return "" if text.startswith(COMMENTS) or (text[:1] == ";" != separator) else text


def _line_cells(text: str, separator: str | None) -> list[str]:
    """Return the cells of a line without quotes; None as separator stands for blanks."""
    if '"' in text:
        cells = next(csv.reader([text], delimiter=separator or " ", skipinitialspace=True))
        cells = [cell for cell in cells if cell or separator]
    elif separator is None:  # a unit in brackets belongs to the name before it
        cells = re.sub(r"\s+([\[(][^\])]*[\])])", r"\1", text).split()
    else:
        cells = text.split(separator)
    return [cell.strip().strip("'").strip() for cell in cells]


def _number(cell: str, separator: str | None) -> float:
    """Return the number in a cell, in which a comma is a decimal point; raise ValueError."""
    return float(cell if separator == "," else cell.replace(",", ".", 1))


def _is_number(cell: str, separator: str | None) -> bool:
    return _converts(_number, cell, separator)


def _converts(convert: Callable[..., float], *arguments: str | None) -> bool:
    try:
        convert(*arguments)
    except ValueError:
        return False
    return True


def _is_row(words: Sequence[str], separator: str | None) -> bool:
    return len(words) > 1 and all(_is_number(word, separator) for word in words)


def _layout_with(
    path: Path, file: TextIO, lines: Sequence[str], separator: str | None, width: int
) -> _TextTable:
    """Return the layout of a table of known separator and width."""
    heads: list[tuple[int, str, list[str]]] = []  # lines of words before the first row
    comments: list[str] = []
    rows: list[tuple[int, list[str]]] = []
    for number, line in enumerate(lines, start=1):
        text = _line_body(line, separator)
        cells = _line_cells(text, separator)
        if rows or (len(cells) == width and any(_is_number(cell, separator) for cell in cells)):
            rows.append((number, cells))
        elif not text:
            comments.append(line.strip(" #%/;\r\n"))
        elif _is_row(cells, separator) and separator == "," and heads:
            raise DataError(f"{path}:{number}: {REMEDIES['commas'].format(text[:SHOWN])}")
        elif _is_row(cells, separator):
            raise DataError(
                f"{path}:{number}: expected {width} values as in the lines below, found {text!r}; "
                "correct the line"
            )
        elif len(cells) > 1 or not _is_number(text, separator):  # a number alone counts the rows
            heads.append((number, text, cells))
    is_named = any(len(cells) == width for _, _, cells in heads)
    few = min((len(cells) for _, _, cells in heads if len(cells) > 1), default=width)
    for number, cells in rows if separator == "," and not is_named else ():
        text = ",".join(cells)[:SHOWN]
        if width > 2 * few - 2 or any(re.fullmatch(r"0\d+", cell) for cell in cells):
            raise DataError(f"{path}:{number}: {REMEDIES['commas'].format(text)}")
    table = [cells for _, cells in rows if len(cells) == width]
    while width > 2 and not any(cells[width - 1] for cells in table):  # separators at line ends
        width -= 1
    named = [head for head in heads if _has_width(head[2], width)]
    units: list[str] = []
    if len(named) > 1 and any(named[-1][2]) and all(not c or known_unit(c) for c in named[-1][2]):
        units = named.pop()[2]
    if heads and not named and len(heads[-1][2]) > 1:
        number, text, cells = heads[-1]
        raise DataError(
            f"{path}:{number}: expected {width} names, one for each column, found {len(cells)}: "
            f"{text[:SHOWN]!r}; correct the line, or begin it with '#'"
        )
    # without a line of names, the last comment that has one for each column
    known = set.union(*ALIASES)
    _, header, names = named[-1] if named else (0, "", list[str]())
    for text in reversed(comments if not named else []):
        cells = _line_cells(text, separator)
        if len(cells) == width and any(split_unit(name)[0].lower() in known for name in cells):
            names = cells
            break
    return _TextTable(
        path, file, separator, rows[0][0], header, names[:width], units[:width], rows[0][1][:width]
    )


def _has_width(cells: Sequence[str], width: int) -> bool:
    return len(cells) >= width and not any(cells[width:])


def _choose(
    layout: _TextTable, requested: Mapping[str, str], where: str
) -> dict[str, tuple[int, str]]:
    """Return the column and the unit of each requested quantity; DataError if it is not unique."""
    names = layout.columns
    bases = [split_unit(name) for name in names]
    chosen, faults = dict[str, tuple[int, str]](), list[str]()
    for key, name in requested.items():
        base, unit = (part.lower() for part in split_unit(name))
        same = next((aliases for aliases in ALIASES if base in aliases), {base})
        position = re.compile(rf"(.*[^a-z])?pos(ition)?[._ ]{re.escape(base)}")
        ranks = (
            [k for k, title in enumerate(names) if title == name],
            [k for k, (title, _) in enumerate(bases) if title.lower() == base],
            [k for k, (title, _) in enumerate(bases) if title.lower() in same],
            [k for k, (title, _) in enumerate(bases) if position.fullmatch(title.lower())],
        )
        indices = next((rank for rank in ranks if rank), [])
        # the columns from which a quantity follows, by its name and part, if they are clear
        stems = parts_of(key, names) if key in PARTS and len(indices) != 1 else {}
        complete = [
            parts
            for stem, parts in stems.items()
            if stem.startswith(name * (name != key)) and {*PARTS[key][1]} <= {*parts}
        ]
        if len(complete) == 1:
            chosen |= {f"{key}:{part}": (k, "") for part, k in complete[0].items()}
            continue
        if len(indices) != 1:
            fault = f"{len(indices)} columns {name!r}" if indices else f"no column {name!r}"
            with_unit = re.compile(rf"{re.escape(base)}\s*[\[(]", re.IGNORECASE)
            if "x" in same and any({*map(str.lower, names)} & each for each in ALIASES[-2:]):
                fault += " (project longitude and latitude to metres)"
            if not indices and (odd := next(filter(with_unit.match, names), "")):
                fault += f" (the unit of {odd!r} is unknown: convert it to an SI unit)"
            faults.append(fault)
            continue
        k = indices[0]
        chosen[key] = k, unit or bases[k][1] or (layout.units[k] if layout.units else "")
    if faults:
        columns = ", ".join(dict.fromkeys(requested.values()))
        raise DataError(
            f"{layout.path}: expected the columns {columns}, found {', '.join(faults)} among "
            f"{', '.join(names)[:LONG]}; name the columns in {where}"
        )
    return chosen


def _read_numbers(
    layout: _TextTable, chosen: Mapping[str, tuple[int, str]], wanted: str, free: Collection[str]
) -> Array:
    """Return the numbers of the chosen columns, shape (n, n_chosen); NaN if missing and free."""
    if not layout.row:
        return np.empty((0, len(chosen)))
    separator, indices = layout.separator, [index for index, _ in chosen.values()]
    converters: dict[int | str, Callable[[str], float]] = {
        k: _timestamp
        for k in indices
        if not _is_number(layout.row[k], separator) and _converts(_timestamp, layout.row[k])
    }
    optional = [key in free for key in chosen]
    lines = (text for _, text in layout.lines(wanted))
    try:
        numbers: Array = np.loadtxt(
            (text if separator == "," or "." in text else text.replace(",", ".") for text in lines),
            delimiter=separator,
            usecols=indices,
            quotechar='"',
            comments=None,
            converters=converters or None,
            ndmin=2,
        )
        if np.isfinite(numbers).all():
            return numbers
    except ValueError:
        pass
    rows = []  # read again, to name the line or to accept what numpy does not
    for number, text in layout.lines(wanted):
        cells = _line_cells(text, separator)
        is_missing = [
            may and cells[k].lower() in MISSING for k, may in zip(indices, optional, strict=True)
        ]
        try:
            values = [
                math.nan
                if missing
                else converters.get(k, partial(_number, separator=separator))(cells[k])
                for k, missing in zip(indices, is_missing, strict=True)
            ]
        except ValueError:
            values = [math.inf]
        if not all(map(op.or_, map(math.isfinite, values), is_missing)):
            remedy = "correct or remove the line"
            if re.match(r"\d+[-/.:]\d+[-/.:]\d{2}", text):
                remedy = DATES
            elif any(re.search(r"\d[.,]\d{3}[.,]\d", cells[k]) for k in indices):
                remedy = "write numbers without separators of thousands"
            raise layout.error(number, text, wanted, remedy)
        signs = {sign for k in indices for sign in ",." if sign in cells[k] and k not in converters}
        if separator != "," and len(signs) > 1:
            remedy = "write all numbers with decimal points and without separators of thousands"
            raise layout.error(number, text, "one decimal sign", remedy)
        rows.append(values)
    return np.array(rows)


def _timestamp(text: str) -> float:
    """Return the seconds since 1970 of a time such as ``2026-03-01T12:00:00.5``, in UTC."""
    text = text.strip(" \"'")  # times of day have the same date
    text = f"00:{text}" if re.fullmatch(r"\d\d:\d\d\.\d+", text) else text  # not hours and minutes
    time = datetime.fromisoformat(f"2000-01-01T{text}" if text[2:3] == ":" else text)
    return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()
