"""Layout of tables in text files: separator, names and units of columns, and cells of a line."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple, TextIO

from slipfree.errors import DataError

SHOWN, LONG = 60, 300  # longest line, and longest list of names, in messages
SAMPLE = 200, 200_000  # most lines and characters from which the layout is inferred
SEPARATORS = (";", "|", "\t", ",", None)  # None: blanks
COMMENTS = ("#", "%", "//")
UNITS = {  # SI unit of a column, and factor to it
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), ("s", 1.0)),
    **dict.fromkeys(("ms", "msec", "milliseconds"), ("s", 1e-3)),
    **dict.fromkeys(("us", "µs", "μs", "usec", "microseconds"), ("s", 1e-6)),
    **dict.fromkeys(("ns", "nsec", "nanosec", "nanoseconds"), ("s", 1e-9)),
    "minutes": ("s", 60.0),
    **dict.fromkeys(("rad", "radians"), ("rad", 1.0)),
    **dict.fromkeys(("deg", "degree", "degrees", "°"), ("rad", math.pi / 180)),
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), ("m", 1.0)),
    "km": ("m", 1e3),
    "cm": ("m", 1e-2),
    "mm": ("m", 1e-3),
    **dict.fromkeys(("ft", "feet"), ("m", 0.3048)),
    **dict.fromkeys(("m/s", "mps"), ("m/s", 1.0)),
    "cm/s": ("m/s", 1e-2),
    "mm/s": ("m/s", 1e-3),
    **dict.fromkeys(("km/h", "kmh", "kph"), ("m/s", 1 / 3.6)),
    "rad/s": ("rad/s", 1.0),
    **dict.fromkeys(("deg/s", "°/s", "dps"), ("rad/s", math.pi / 180)),
    **dict.fromkeys(("rpm", "1/min", "min-1"), ("rad/s", math.pi / 30)),
    "-": ("1", 1.0),
    "%": ("1", 1e-2),
    "N": ("N", 1.0),
    "kN": ("N", 1e3),
    **dict.fromkeys(("N m", "Nm", "N*m"), ("N m", 1.0)),
}
UNIT_IN_NAME = (  # "x [m]", "time(s)"; "t / s"; "yaw_deg"
    re.compile(r"^(.*?)[\s_]*[\[(]\s*(.*?)\s*[\])]$"),
    re.compile(r"^(.*?)\s*/\s*(\S+)$"),
    re.compile(r"^(.*)_([^\W_]+)$"),
)
ALIASES = (  # names of the same quantity
    {"t", "time", "timestamp", "stamp"},
    {"x", "easting", "east", "e"},
    {"y", "northing", "north", "n"},
    {"z", "height", "elevation", "elev", "ele", "altitude", "alt", "up", "u"},
    {"heading", "yaw"},
    {"longitude", "long", "lon", "lng"},
    {"latitude", "lat"},
)


class Layout(NamedTuple):
    """Layout of the text of a table.

    Attributes
    ----------
    separator : str or None
        Separator of the columns; None for blanks.
    first : int
        Number of the first row's line.
    header : str
        Line with the names; empty without one.
    names, units : list of str
        Names of the columns as in the file, and units in the line below them; empty without such
        lines.
    row : list of str
        First row; empty if there is none.
    """

    separator: str | None
    first: int
    header: str
    names: list[str]
    units: list[str]
    row: list[str]


def column_names(layout: Layout) -> list[str]:
    """Return the names of the columns, by default ``"1"``, ``"2"``, ..."""
    return layout.names or [str(k + 1) for k in range(len(layout.row))]


def line_body(line: str, separator: str | None) -> str:
    """Return a line without comment and blanks at its ends; empty tab-separated cells remain."""
    text = line.split("#", 1)[0].strip(" \r\n" if separator == "\t" else None)
    return "" if text.startswith(COMMENTS) or (text[:1] == ";" != separator) else text


def line_cells(text: str, separator: str | None) -> list[str]:
    """Return the cells of a line, without quotes."""
    if '"' in text:
        cells = next(csv.reader([text], delimiter=separator or " ", skipinitialspace=True))
        cells = [cell for cell in cells if cell or separator]
    elif separator is None:  # a unit in brackets belongs to the name before it
        cells = re.sub(r"\s+([\[(][^\])]*[\])])", r"\1", text).split()
    else:
        cells = text.split(separator)
    return [cell.strip().strip("'").strip() for cell in cells]


def cell_number(cell: str, separator: str | None) -> float:
    """Return the number in a cell, in which a comma is a decimal point; raise ValueError."""
    return float(cell if separator == "," else cell.replace(",", ".", 1))


def is_number(cell: str, separator: str | None) -> bool:
    """Return whether a cell is a number; see `cell_number`."""
    try:
        cell_number(cell, separator)
    except ValueError:
        return False
    return True


def table_layout(path: Path, file: TextIO) -> Layout:
    """Return the layout of a table, with the separator that divides most lines alike.

    Raises
    ------
    DataError
        If there are other numbers or names before the table, or decimal commas and points in it.
    """
    lines: list[str] = []
    while len(lines) < SAMPLE[0] and sum(map(len, lines)) < SAMPLE[1] and (line := file.readline()):
        lines.append(line)
    found: list[tuple[int, str | None, int]] = []
    for separator in SEPARATORS:
        rows = [
            line_cells(text, separator) for line in lines if (text := line_body(line, separator))
        ]
        widths = Counter(len(row) for row in rows if len(row) > 1)
        width, count = max(widths.items(), key=lambda item: item[1], default=(0, 0))
        table = [row for row in rows if len(row) == width]
        is_split = not any(_is_row(cell.split(), None) for row in table for cell in row)
        if is_split and any(is_number(cell, separator) for row in table for cell in row):
            found.append((count, separator, width))
    if not found:
        return _layout_of_names(path, lines)
    _, separator, width = max(found, key=lambda item: item[0])
    return _layout_with(path, lines, separator, width)


def _is_row(words: Sequence[str], separator: str | None) -> bool:
    """Return whether words are two or more numbers."""
    return len(words) > 1 and all(is_number(word, separator) for word in words)


def _layout_of_names(path: Path, lines: Sequence[str]) -> Layout:
    """Return the layout of a table without rows; raise DataError for rows that are not numbers."""
    used = [(k, text) for k, line in enumerate(lines, 1) if (text := line_body(line, None))]
    number, text = used[-1] if used else (0, "")
    if len(used) > 1 and re.search(r"\d", text):
        raise DataError(
            f"{path}:{number}: expected two or more numbers, found {text[:SHOWN]!r}; write numbers "
            "as in 1.5 or 1.5e-3, separated by commas, semicolons, tabs or blanks"
        )
    text = used[0][1] if used else ""
    separator = next((each for each in SEPARATORS[:-1] if each in text), None)
    return Layout(separator, 0, text, line_cells(text, separator) if text else [], [], [])


def _layout_with(path: Path, lines: Sequence[str], separator: str | None, width: int) -> Layout:
    """Return the layout of a table of known separator and width."""
    heads: list[tuple[int, str, list[str]]] = []  # lines of words before the first row
    comments: list[str] = []
    rows: list[tuple[int, list[str]]] = []
    for number, line in enumerate(lines, start=1):
        text = line_body(line, separator)
        cells = line_cells(text, separator)
        if rows or (len(cells) == width and any(is_number(cell, separator) for cell in cells)):
            rows.append((number, cells))
        elif not text:
            comments.append(line.strip(" #%/;\r\n"))
        elif _is_row(cells, separator):
            raise DataError(
                f"{path}:{number}: expected {width} values as in the lines below, found {text!r}; "
                "correct the line"
            )
        elif len(cells) > 1 or not is_number(text, separator):  # a number alone counts the rows
            heads.append((number, text, cells))
    table = [cells for _, cells in rows if len(cells) == width]
    if separator == "," and not any(len(head[2]) == width for head in heads):
        _check_commas(path, rows)
    _check_decimals(path, rows, separator)
    while width > 2 and not any(cells[width - 1] for cells in table):  # separators at line ends
        width -= 1
    named = [head for head in heads if has_width(head[2], width)]
    units = []
    if len(named) > 1 and _are_units(named[-1][2]):
        units = named.pop()[2]
    if heads and not named and len(heads[-1][2]) > 1:
        number, text, cells = heads[-1]
        raise DataError(
            f"{path}:{number}: expected {width} names, one for each column, found {len(cells)}: "
            f"{text[:SHOWN]!r}; correct the line, or begin it with '#'"
        )
    names = named[-1][2][:width] if named else _commented_names(comments, separator, width)
    header = named[-1][1] if named else ""
    return Layout(separator, rows[0][0], header, names, units[:width], rows[0][1][:width])


def _are_units(cells: Sequence[str]) -> bool:
    """Return whether cells are known units, besides empty ones."""
    return any(cells) and all(known_unit(cell) for cell in cells if cell)


def has_width(cells: Sequence[str], width: int) -> bool:
    """Return whether cells are as many as columns, besides empty ones at the end."""
    return len(cells) >= width and not any(cells[width:])


def _commented_names(comments: Sequence[str], separator: str | None, width: int) -> list[str]:
    """Return the names in the last comment that has one for each column; empty without one."""
    known = set.union(*ALIASES)
    for text in reversed(comments):
        names = line_cells(text, separator)
        if len(names) == width and any(split_unit(name)[0].lower() in known for name in names):
            return names
    return []


def _check_commas(path: Path, rows: Iterable[tuple[int, Sequence[str]]]) -> None:
    """Raise DataError if commas that separate columns are probably also decimal signs."""
    for number, cells in rows:
        if cell := next((cell for cell in cells if re.fullmatch(r"0\d+", cell)), ""):
            raise DataError(
                f"{path}:{number}: expected numbers with decimal points, found {cell!r} between "
                "commas, probably decimals of a number with a comma; write decimal points, or "
                "separate the columns by semicolons, and give names in the first line"
            )


def _check_decimals(
    path: Path, rows: Iterable[tuple[int, Sequence[str]]], separator: str | None
) -> None:
    """Raise DataError if some numbers have decimal commas and others points."""
    used: dict[str, str] = {}
    for number, cells in rows:
        for cell in cells:
            if separator != "," and is_number(cell, separator):
                used |= {sign: cell for sign in ".," if sign in cell}
        if len(used) > 1:
            raise DataError(
                f"{path}:{number}: expected one decimal sign, found {' and '.join(used.values())}; "
                "write all numbers with decimal points and without separators of thousands"
            )


def known_unit(text: str) -> tuple[str, float] | None:
    """Return the SI unit and the factor of a unit, also in brackets; None if it is not known."""
    text = text.strip("[]() ")
    return UNITS.get(text, UNITS.get(text.lower()))


def split_unit(name: str) -> tuple[str, str]:
    """Return the name and the unit in the name of a column; the unit is empty if it has none."""
    for pattern in UNIT_IN_NAME:
        found = pattern.match(name)
        if found and found[1] and known_unit(found[2]):
            return found[1], found[2]
    return name, ""
