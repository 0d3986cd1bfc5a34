"""Formats that are not read, recognized by the ending or the first bytes of a file; converters.

They are rows of ``formats.toml``.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, NamedTuple

from slipfree.core.errors import DataError, read_table

HEAD = 512  # bytes that are compared
TABLE: dict[str, Any] = read_table(__file__, "formats.toml")
REMEDIES: dict[str, str] = TABLE["remedies"]
Purpose = Literal["map", "table", "mesh"]


class Format(NamedTuple):
    """A format that is not read: remedies have ``{}`` for the name of the file."""

    name: str
    endings: tuple[str, ...]  # of the names of such files
    roots: tuple[str, ...]  # names of root elements of XML
    magic: tuple[bytes, ...]  # first bytes; empty if they are not characteristic
    map: str  # remedy where a map is expected; empty for formats that GDAL reads
    table: str  # remedies where a table and a robot description are expected
    robot: str
    packed: str  # remedy for archives and downloads, wherever a file is expected

    def remedy(self, purpose: Purpose) -> str:
        """Return the remedy where a map, a table or a mesh is expected; empty if none is needed."""
        remedies: dict[str, str] = self._asdict()
        return remedies.get(purpose, "") or self.packed


FORMATS = [
    Format(
        row["name"],
        tuple(row.get("endings", "").split()),
        tuple(row.get("roots", "").split()),
        tuple(text.encode("latin1") for text in row.get("magic", ())),
        *(REMEDIES.get(row.get(key, ""), row.get(key, "")) for key in Format._fields[4:]),
    )
    for row in TABLE["formats"]
]


def check_ending(path: Path, purpose: Purpose, expected: str, read: tuple[str, ...] = ()) -> None:
    """Raise DataError if a file ends as a known format; files with endings in ``read`` are read."""
    ending = path.suffix.lower()
    if ending not in read:
        known = (each for each in FORMATS if ending in each.endings)
        _refuse(path, purpose, expected, f"{ending!r}, ", known)


def check_contents(path: Path, purpose: Purpose, expected: str) -> None:
    """Raise DataError if a file begins as a known format that is not read; see `check_ending`."""
    with path.open("rb") as file:
        head = file.read(HEAD)
    known = (each for each in FORMATS if head.startswith(each.magic))
    _refuse(path, purpose, expected, "", known)
    if purpose == "table" and b"\0" in head and not head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise DataError(f"{path}: expected {expected}, found binary data; {REMEDIES['csv']}")


def _refuse(
    path: Path, purpose: Purpose, expected: str, found: str, known: Iterator[Format]
) -> None:
    for each in known:
        if remedy := each.remedy(purpose).format(path.name):
            raise DataError(f"{path}: expected {expected}, found {found}{each.name}; {remedy}")
