"""Tables of comma-separated values: one line of names, then numbers."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from math import isfinite
from pathlib import Path

from slipfree.atomic_files import replace_file
from slipfree.errors import DataError
from slipfree.regular_files import read_bytes

COUNTS = {2: "two", 3: "three", 4: "four"}


def write_rows(path: Path, names: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table; the file appears under its name when it is complete.

    Raises
    ------
    DataError
        If the file cannot be written.
    """

    def fill(part: Path) -> None:
        with part.open("w", newline="", encoding="utf-8", errors="backslashreplace") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(names)
            writer.writerows(rows)

    replace_file(path, fill)


def read_names(path: Path, expected: str) -> list[str]:
    """Return the names in the first line of a table; ``t`` stands for ``time`` as well.

    Raises
    ------
    DataError
        If the file cannot be read.
    """
    text = read_bytes(path, f"{expected} as CSV").decode("utf-8-sig", "replace")
    return _names(text.partition("\n")[0])


def _names(line: str) -> list[str]:
    cells = (cell.strip() for cell in line.split(","))
    return ["t" if cell == "time" else cell for cell in cells]  # as results call it


def read_columns(
    path: Path, columns: Sequence[str], expected: str = "way-points"
) -> list[tuple[float, ...]]:
    """Return columns of a table of numbers, row by row.

    Parameters
    ----------
    path : Path
        A first line of names may give another order and further columns, as tables that slipfree
        writes do; without it the file has these columns alone. ``t`` may be called ``time``.
    columns : sequence of str
        Names of the columns.
    expected : str
        Contents that the caller expects, for messages.

    Raises
    ------
    DataError
        If the file cannot be read, or a line does not hold as many finite numbers.
    """
    try:
        text = read_bytes(path, f"{expected} as CSV").decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: expected {expected} as CSV, found no text file") from error
    rows, order, width = [], list(range(len(columns))), len(columns)
    wanted = f"{COUNTS.get(width, width)} numbers {','.join(columns)}"
    for number, line in enumerate(text.splitlines(), 1):
        cells = [cell.strip() for cell in line.split(",")]
        if not line.strip():
            continue
        if number == 1 and {*columns} <= {*(names := _names(line))}:
            order, width = [names.index(name) for name in columns], len(names)
            continue
        try:
            row = [float(cells[k]) for k in order] if len(cells) == width else []
        except ValueError:
            row = []
        if not row or not all(map(isfinite, row)):
            raise DataError(f"{path}:{number}: expected {wanted}, found {line.strip()!r}")
        rows.append(tuple(row))
    return rows
