"""Origin of the values of a problem: lines of a TOML file, or the command line."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

Place = tuple[str | int, ...]

PIECE = re.compile(
    r'"""(?:\\.|[^\\])*?"{3,5}'  # strings; those of several lines first
    r"|'''.*?'{3,5}"
    r'|"(?:\\.|[^"\\\n])*"'
    r"|'[^'\n]*'"
    r"|\#[^\n]*"
    r"|.",
    re.DOTALL,
)
KEY = re.compile(r"""\s*((?:"(?:\\.|[^"\\])*"|'[^']*'|[^"'=\]])+)""")


@dataclass(frozen=True)
class Source:
    """Text of a problem file, and the origin of its values.

    Attributes
    ----------
    path : Path
        Path of the file.
    text : str
        Text of the file.
    lines : mapping of tuple to int
        Line number of every key and table. A key is a tuple of names, and of indices for elements
        of arrays of tables.
    settings : mapping of tuple to str
        Settings ``key=value`` of the command line, by the keys that they set.
    varied : frozenset of tuple
        Keys of `settings` that the option ``--vary`` sets; the other keys are set by ``--set``.
    """

    path: Path
    text: str
    lines: Mapping[Place, int]
    settings: Mapping[Place, str] = field(default_factory=dict)
    varied: frozenset[Place] = frozenset()

    def where(self, place: Place) -> str:
        """Return the location ``file:line: key``, ``--set key`` or ``--vary key`` of a value."""
        key = spelled(place)
        if (part := _longest(place, self.settings)) is not None:
            option = "--vary" if part in self.varied else "--set"
            return f"{option} {spelled(part)}" + (f": {key}" if part != place else "")
        line = f"{self.path}:{self._line(place)}"
        return f"{line}: {key}" if key else line

    def is_set(self, place: Place) -> bool:
        """Return whether the command line sets a value or its table."""
        return _longest(place, self.settings) is not None

    def order(self, place: Place) -> int:
        """Return the line of a value, as sort key; values of the command line are last."""
        if self.is_set(place):
            return self.text.count("\n") + 2
        return self._line(place)

    def _line(self, place: Place) -> int:
        part = _longest(place, self.lines)
        return 1 if part is None else self.lines[part]


def _longest(place: Place, known: Mapping[Place, object]) -> Place | None:
    """Return the longest prefix of ``place`` in ``known``; None if no prefix is known."""
    parts = (place[:end] for end in range(len(place), 0, -1))
    return next((part for part in parts if part in known), None)


def spelled(place: Place) -> str:
    """Return a sequence of keys in the user's spelling, such as ``inputs.right_rate[2]``."""
    return "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in place).removeprefix(".")


@lru_cache(maxsize=64)
def key_path(text: str) -> tuple[str, ...]:
    """Return the parts of a dotted key.

    Raises
    ------
    tomllib.TOMLDecodeError
        If the text is not a key.
    """
    node, parts = tomllib.loads(f"{text} = 0"), []
    while isinstance(node, dict):
        ((part, node),) = node.items()
        parts.append(part)
    return tuple(parts)


@lru_cache(maxsize=1)
def key_lines(text: str) -> Mapping[Place, int]:
    """Return the line of every key and table of a valid TOML text.

    Keys inside an inline table or an array are not included; their line is that of the key to which
    the table or array belongs.
    """
    found: dict[Place, int] = {}
    counts: dict[Place, int] = {}
    table: Place = ()
    for line, statement in _statements(text):
        opening = re.match(r"\s*(\[{0,2})", statement)
        depth = len(opening[1]) if opening else 0
        match = KEY.match(statement, opening.end() if opening else 0)
        if match is None:
            continue
        key = key_path(match[1])
        if depth:
            table = _resolved(key[: len(key) - (depth == 2)], counts)
            if depth == 2:
                table = (*table, key[-1])
                found.setdefault(table, line)
                counts[table] = counts.get(table, -1) + 1
                table = (*table, counts[table])
        place = table if depth else (*table, *key)
        for end in range(1, len(place) + 1):
            found.setdefault(place[:end], line)
    return found


def _resolved(key: tuple[str, ...], counts: Mapping[Place, int]) -> Place:
    """Return the keys of a table, with the index of the last element after each array of tables."""
    place: Place = ()
    for part in key:
        place = (*place, part)
        if place in counts:
            place = (*place, counts[place])
    return place


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Yield the first line number and the text of every statement, which may span lines."""
    line, start, depth = 1, 1, 0
    pieces: list[str] = []
    for piece in PIECE.findall(text.replace("\r\n", "\n") + "\n"):
        if piece == "\n" and depth == 0:
            if statement := "".join(pieces).strip():
                yield start, statement
            pieces, start = [], line + 1
        elif not piece.startswith("#"):
            pieces.append(piece)
            depth += (piece in "[{") - (piece in "]}")
        line += piece.count("\n")
