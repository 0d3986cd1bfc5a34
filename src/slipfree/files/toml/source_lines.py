"""Origin of the values of a problem: lines of a TOML file, or the command line."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

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
# keys with at least 64 parts: tomllib takes hours for thousands of them
LONG_KEY = re.compile(
    r"""(?m)(?:^|[\[{,])[ \t]*+(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){64}"""
)
MAX_SHOWN = 200  # characters of a setting in a message
MAX_DEPTH = 100  # accepted levels of nested arrays and tables
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


def load_toml(text: str) -> dict[str, Any]:
    """Return the values of a TOML text from a user.

    Raises
    ------
    ValueError
        If the text is not TOML, is nested deeply, or contains an integer of thousands of digits.
        The message may end with ``(at line L, column C)``.
    """
    if (found := LONG_KEY.search(text)) is not None:
        line = text.count("\n", 0, found.start()) + 1
        raise ValueError(f"a key of more than 60 dotted parts (at line {line}, column 1)")
    try:
        values = tomllib.loads(text)
    except RecursionError:
        values = None
    except tomllib.TOMLDecodeError:
        raise
    except ValueError as error:  # Python limits the length of integers
        most = sys.get_int_max_str_digits()
        raise ValueError(f"an integer of more than {most} digits") from error
    if values is None or _is_deep(values):
        raise ValueError(f"arrays or tables of more than {MAX_DEPTH} nested levels")
    return values


def shortened(text: str) -> str:
    """Return a text, or the first characters of a long text and dots, for a message."""
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}..."


def _is_deep(values: dict[str, Any]) -> bool:
    """Return whether arrays and tables have more than `MAX_DEPTH` nested levels."""
    level: list[Any] = [values]
    for _ in range(MAX_DEPTH):
        tables = (each.values() if isinstance(each, dict) else each for each in level)
        level = [v for each in tables for v in each if isinstance(v, dict | list)]
    return bool(level)


@lru_cache(maxsize=64)
def key_path(text: str) -> tuple[str, ...]:
    """Return the parts of a dotted key.

    Raises
    ------
    ValueError
        If the text is not a key.
    """
    node, parts = load_toml(f"{text} = 0"), []
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
