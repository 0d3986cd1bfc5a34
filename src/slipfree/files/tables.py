"""Tables of comma-separated values: a line of column names, then lines of numbers.

Tables of paths and commands are also read from MCAP files (`slipfree.files.mcap_reader`).
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from math import isfinite
from pathlib import Path

from slipfree.atomic_files import replace_file
from slipfree.errors import DataError
from slipfree.files.mcap_reader import is_mcap, read_mcap
from slipfree.regular_files import read_bytes

COUNTS = {2: "two", 3: "three", 4: "four"}


def write_rows(path: Path, names: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write a table of comma-separated values; an existing file is replaced when it is complete.

    Parameters
    ----------
    path : Path
        File to write.
    names : sequence of str
        Names of the columns, written as the first line.
    rows : iterable of sequence
        Values of each line.

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
    """Return the column names in the first line of a table; ``time`` is returned as ``t``.

    For an MCAP file, return those of its commands (`slipfree.files.mcap_reader.read_mcap`).

    Parameters
    ----------
    path : Path
        The table.
    expected : str
        Description of the expected contents in messages, such as ``"way-points"``.

    Raises
    ------
    DataError
        If the file cannot be read, or is an MCAP file without commands.
    """
    if is_mcap(path):
        return [*read_mcap(path, "v_x")]
    text = read_bytes(path, f"{expected} as CSV").decode("utf-8-sig", "replace")
    return _names(text.partition("\n")[0])


def _names(line: str) -> list[str]:
    """Return the names in a line, with ``t`` for the ``time`` of results."""
    cells = (cell.strip() for cell in line.split(","))
    return ["t" if cell == "time" else cell for cell in cells]


def read_columns(
    path: Path, columns: Sequence[str], expected: str = "way-points"
) -> list[tuple[float, ...]]:
    """Return the rows of a table of numbers, each with the values of the requested columns.

    Parameters
    ----------
    path : Path
        The table. If its first line contains the requested names (``time`` counts as ``t``), other
        columns are ignored and the order is free. Otherwise the table must have exactly the
        requested columns in their order.
    columns : sequence of str
        Names of the requested columns.
    expected : str
        Description of the expected contents in messages.

    Raises
    ------
    DataError
        If the file cannot be read, if the number of values in a line differs from the number of
        columns, if a value is not a finite number, or if an MCAP file has no such table.
    """
    if is_mcap(path):
        table = read_mcap(path, columns[-1])
        return [*zip(*(table[name].tolist() for name in columns), strict=True)]
    try:
        text = read_bytes(path, f"{expected} as CSV").decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataError(
            f"{path}: expected {expected} as CSV, found a file that is not UTF-8 text; save it "
            "as UTF-8"
        ) from error
    rows, order, width = [], list(range(len(columns))), len(columns)
    wanted = f"{COUNTS.get(width, width)} numbers {','.join(columns)}"
    for number, line in enumerate(text.splitlines(), 1):
        cells = [cell.strip() for cell in line.split(",")]
        if not line.strip():
            continue
        if number == 1 and {*columns} <= {*(names := _names(line))}:
            order, width = [names.index(name) for name in columns], len(names)
            wanted = f"{COUNTS.get(width, width)} numbers {','.join(names)}"
            if width > len(columns):
                wanted = f"{width} values as in line 1, with numbers for {','.join(columns)}"
            continue
        try:
            row = [float(cells[k]) for k in order] if len(cells) == width else []
        except ValueError:
            row = []
        if not row or not all(map(isfinite, row)):
            raise DataError(
                f"{path}:{number}: expected {wanted}, found {line.strip()!r}; correct the line"
            )
        rows.append(tuple(row))
    return rows
