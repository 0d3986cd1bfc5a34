"""TOML files: lines of values, settings of the command line, error messages."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from math import inf
from pathlib import Path
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel

from slipfree.core.errors import DataError, listed, shortened, similar
from slipfree.system.regular_files import escape_name, read_bytes, regular_file

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
MAX_DEPTH = 100  # accepted levels of nested arrays and tables
KEY = re.compile(r"""\s*((?:"(?:\\.|[^"\\])*"|'[^']*'|[^"'=\]])+)""")
MAX_ERRORS = 50  # largest number of errors in a message
MAX_SHOWN_NUMBER = 1e300  # larger integers are described by their number of bits
MAX_VALUE = 1e100  # largest quantity; its squares and cubes are finite
MAX_SHOWN_DEPTH = 3  # nesting up to which arrays are shown
EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "string_type": "text in quotes",
    "string_too_short": "text that is not empty",
    "bool_type": "true or false",
    "model_type": "a table",
    "dict_type": "a table",
    "tuple_type": "an array",
    "finite_number": "a finite number",
    "greater_than": "a number greater than {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than": "a number less than {lt:g}",
    "less_than_equal": "a number of at most {le:g}",
    "literal_error": "{expected}",
    "too_long": "an array of {max_length} elements",
}
SYNTAX = {  # remedies by parts of the messages of tomllib
    "Invalid value": "; write text in quotes",
    "Expected newline": "; write key = value once on a line, numbers with a decimal point",
    "Expected '='": "; write key = value on each line",
    "Invalid statement": "; write key = value on each line",
    "Unescaped '\\'": "; write paths with /, or in single quotes",
    "Cannot overwrite": "; keep one of the two",
    "twice": "; keep one of the two",
}
MADE = "# keys of the command line\n"  # first line of a text that is in no file
MAX_BYTES = 10_000_000  # size of the largest accepted TOML file
BARE = re.compile(r"""[^\s"'\[\]{}=,#]+""")  # a value that needs no quotes


@dataclass(frozen=True)
class Source:
    """Text of a problem file, and the origin of its values."""

    path: Path
    text: str
    lines: Mapping[Place, int]  # line of every key, with indices of arrays of tables, and table
    settings: Mapping[Place, str] = field(default_factory=dict)  # ``key=value`` by key
    varied: frozenset[Place] = frozenset()  # keys that ``--vary`` sets; ``--set`` sets the others

    def where(self, place: Place) -> str:
        """Return the location ``file:line: key``, ``--set key`` or ``--vary key`` of a value."""
        key = spelled(place)
        if (part := _longest(place, self.settings)) is not None:
            option = "--vary" if part in self.varied else "--set"
            return f"{option} {spelled(part)}" + (f": {key}" if part != place else "")
        line = f"{self.path}" if self.is_made else f"{self.path}:{self._line(place)}"
        return f"{line}: {key}" if key else line

    @property
    def is_made(self) -> bool:
        """Whether the keys follow from the command line; ``path`` then names its data."""
        return self.text.startswith(MADE)

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
    beginnings = (place[:end] for end in range(len(place), 0, -1))
    return next((part for part in beginnings if part in known), None)


def spelled(place: Place) -> str:
    """Return a sequence of keys in the user's spelling, such as ``inputs.right_rate[2]``."""
    return "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in place).removeprefix(".")


def load_toml(text: str) -> dict[str, Any]:
    """Return the values of a TOML text; the ValueError may end with ``(at line L, column C)``."""
    if (long_key := LONG_KEY.search(text)) is not None:
        line = text.count("\n", 0, long_key.start()) + 1
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
    level: list[Any] = [values]
    for _ in range(MAX_DEPTH if values is not None else 0):
        tables = (each.values() if isinstance(each, dict) else each for each in level)
        level = [v for each in tables for v in each if isinstance(v, dict | list)]
    if values is None or level:
        raise ValueError(f"arrays or tables of more than {MAX_DEPTH} nested levels")
    return values


@lru_cache(maxsize=64)
def key_path(text: str) -> tuple[str, ...]:
    """Return the parts of a dotted key; raise ValueError if the text is not a key."""
    node, parts = load_toml(f"{text} = 0"), []
    while isinstance(node, dict):
        ((part, node),) = node.items()
        parts.append(part)
    return tuple(parts)


@lru_cache(maxsize=1)
def key_lines(text: str) -> Mapping[Place, int]:
    """Return the line of every key and table of a TOML text, also of inline tables in an array.

    Keys inside inline values have no line of their own.
    """
    lines: dict[Place, int] = {}
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
                lines.setdefault(table, line)
                counts[table] = counts.get(table, -1) + 1
                table = (*table, counts[table])
        place = table if depth else (*table, *key)
        for end in range(1, len(place) + 1):
            lines.setdefault(place[:end], line)
        tables = _inline_tables(statement[match.end() :]) if "{" in statement else ()
        for index, below in enumerate(tables):
            lines.setdefault((*place, index), line + below)
    return lines


def _inline_tables(value: str) -> Iterator[int]:
    """Yield the lines of the inline tables of an array, which count from that of the array."""
    line = depth = 0
    for piece in PIECE.findall(value):
        if piece == "{" and depth == 1:
            yield line
        depth += (piece in "[{") - (piece in "]}")
        line += piece.count("\n")


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


class ProblemError(DataError):
    """Error in a TOML file, with one message per invalid value.

    Each of the ``faults`` is a line: location, expected and found value.
    """

    def __init__(self, *faults: str) -> None:
        shown, rest = faults[:MAX_ERRORS], len(faults) - MAX_ERRORS
        more = [f"and {rest} more error{'s' * (rest > 1)}"] if rest > 0 else []
        super().__init__("\n".join((*shown, *more)))
        self.faults = faults


class Fault(NamedTuple):
    """One error in a TOML file."""

    place: Place  # location of the value: names of nested keys, and indices of array elements
    expected: str  # descriptions of the expected and the found value
    found: str
    hint: str = ""  # suggestion at the start of the message, such as a similar key

    @property
    def message(self) -> str:
        """Message without the location."""
        return f"{self.hint}expected {self.expected}, found {self.found}"


def problem_error(source: Source, faults: Iterable[Fault]) -> ProblemError:
    """Return an exception with the messages of all errors, in the order of their lines."""
    ordered = sorted(faults, key=lambda fault: source.order(fault.place))
    return ProblemError(*(f"{source.where(fault.place)}: {fault.message}" for fault in ordered))


def name_errors(place: Place, names: Iterable[str], known: Sequence[str]) -> Iterator[Fault]:
    """Yield an error for each unknown name, with the most similar known name."""
    for name in names:
        if name not in known:
            yield _unknown((*place, name), known)


def value_errors(value: Any, place: Place = ()) -> Iterator[Fault]:
    """Yield an error for each finite number with an absolute value above 1e100."""
    if isinstance(value, Mapping | list):
        parts = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, part in parts:
            yield from value_errors(part, (*place, key))
    elif isinstance(value, float | int) and MAX_VALUE < abs(value) < inf:
        expected = f"a number with an absolute value of at most {MAX_VALUE:g}"
        yield Fault(place, expected, format_value(value))


def validation_fault(schema: type[BaseModel], data: Any, error: dict[str, Any]) -> Fault:
    """Return an error of pydantic in the ``data`` of a file as a `Fault`: key and both values."""
    place, kind = tuple(error["loc"]), error["type"]
    found = "none" if kind == "missing" else format_value(error["input"])
    if kind == "extra_forbidden":
        return _unknown(place, record_at(schema, place[:-1], data).known_keys())
    if kind == "missing" and isinstance(place[-1], int):
        return Fault(place, "a number", found)
    if kind == "missing":
        wanted = record_at(schema, place[:-1], data).model_fields[place[-1]].annotation
        table = isinstance(wanted, type) and issubclass(wanted, BaseModel)
        table |= str(wanted).startswith("dict")
        return Fault(place, f"a table [{place[-1]}]" if table else "a value", found)
    words = EXPECTED.get(kind)
    details = error.get("ctx", {})
    expected = words.format(**details) if words else error["msg"]
    return Fault(place, expected, details.get("found", found))


def _unknown(place: Place, known: Sequence[str]) -> Fault:
    name = str(place[-1])
    expected = f"one of {listed(known)}" if known else "no key"
    return Fault(place, expected, f"the unknown key {shortened(name, 40)!r}", similar(name, known))


def record_at(schema: type[Any], place: Place, data: Any) -> type[Any]:
    """Return the schema of the nested table at ``place`` in the ``data`` of a file."""
    is_container = False
    model: type[Any] = schema.schema_for(data)
    for part in place:
        data = data[part]
        if is_container:  # the part is the index or name of a table
            is_container = False
        else:
            annotation = model.model_fields[str(part)].annotation
            model = next(_records(annotation))
            is_container = isinstance(data, list) or "dict[" in str(annotation)
        if not is_container:
            model = model.schema_for(data)
    return model


def _records(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _records(part)


def format_value(value: Any, deepest: int = MAX_SHOWN_DEPTH) -> str:
    """Return a shortened text of a value for messages."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return repr(shortened(value, 40))
    if isinstance(value, int) and abs(value) >= MAX_SHOWN_NUMBER:
        return f"a whole number of {value.bit_length()} bits"
    if isinstance(value, float | int):
        return f"{value:.12g}"
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list):
        parts = [format_value(each, deepest - 1) for each in value[:4] if deepest]
        return f"[{', '.join([*parts, *['...'] * (len(value) > len(parts))])}]"
    return str(value)


def parse_toml(path: Path, text: str) -> dict[str, Any]:
    """Return the values of a TOML text; raise ProblemError for invalid or deeply nested text."""
    try:
        return load_toml(text)
    except ValueError as error:
        where, found = f"{path}", f"{error}; simplify it"
        place = re.fullmatch(r"(.*) \(at line (\d+), column (\d+)\)", str(error), re.DOTALL)
        if place is not None:
            where, found = f"{path}:{place[2]}", f"an error in column {place[3]}: {place[1]}"
        elif str(error).endswith("(at end of document)"):
            where = f"{path}:{len(text.splitlines()) or 1}"
            found = f"an error at the end: {error}"
        found += next((words for part, words in SYNTAX.items() if part in str(error)), "")
        raise ProblemError(f"{where}: expected TOML, found {found}") from error


def read_text(path: Path, expected: str = "a problem file") -> str:
    """Return the text of a TOML file; messages call it ``expected``."""
    return decode_text(path, read_raw(path, expected))


def read_raw(path: Path, expected: str = "a problem file") -> bytes:
    """Return the bytes of a TOML file; parameters and errors are those of `read_text`."""
    try:
        with regular_file(path, expected) as size:
            if size <= MAX_BYTES:
                return read_bytes(path, expected)
    except DataError as error:
        raise ProblemError(str(error)) from error
    raise ProblemError(
        f"{path}: expected a TOML file of at most {MAX_BYTES / 1e6:g} MB, found "
        f"{size / 1e6:.3g} MB; check the name"
    )


def decode_text(path: Path, raw: bytes) -> str:
    """Return the text of a TOML file without its byte order mark; errors as in `read_text`."""
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ProblemError(
            f"{path}:{line}: expected text in UTF-8, found the byte {raw[error.start]:#04x}; save "
            "the file as UTF-8"
        ) from error


def replace_values(
    data: dict[str, Any], settings: Sequence[str], option: str = "--set"
) -> dict[Place, str]:
    """Replace values in ``data`` by texts ``key=value``; return the setting of each changed key."""
    places: dict[Place, str] = {}
    faults = []
    for setting in settings:
        key, equals, text = setting.partition("=")
        if (readable := escape_name(setting)) != setting:
            faults.append(
                f"{option} {escape_name(key.strip())}: expected text in UTF-8, as in a problem "
                f"file, found {readable}; rename the file if the value is a file name"
            )
            continue
        try:
            path = key_path(key)
            if not equals:
                raise ValueError
            new = _insert(data, path, _value(text)) if text.strip() else _remove(data, path)
        except _KeyPlaceError as error:
            faults.append(f"{option} {key.strip()}: {error}")
        except ValueError:
            faults.append(
                f"{option} {shortened(key.strip())}: expected key=value with a value in TOML or a "
                f"bare word, or key= to remove a key, found {shortened(setting)!r}"
            )
        else:
            places |= dict.fromkeys(new, setting)
    if faults:
        raise ProblemError(*faults)
    return places


class _KeyPlaceError(ValueError):
    """Error for a valid key that cannot be set or removed in the given tables."""


def _value(text: str) -> Any:
    try:
        (value,) = load_toml(f"value = {text}").values()
    except ValueError:
        if BARE.fullmatch(text.strip()):
            return text.strip()
        raise
    return value


def _insert(data: dict[str, Any], path: tuple[str, ...], value: Any) -> list[Place]:
    places: list[Place] = [path]
    *tables, last = path
    for depth, name in enumerate(tables, start=1):
        if name not in data:
            places.append(path[:depth])
        data = data.setdefault(name, {})
        if not isinstance(data, dict):
            raise _KeyPlaceError(
                f"expected a key of a table, found that {'.'.join(path[:depth])!r} is not a table; "
                "correct the key"
            )
    data[last] = value
    return places


def _remove(data: dict[str, Any], path: tuple[str, ...]) -> list[Place]:
    for name in path[:-1]:
        data = data.get(name, {}) if isinstance(data, dict) else {}
    if not isinstance(data, dict) or path[-1] not in data:
        raise _KeyPlaceError("expected a key to remove, found no such key; correct the key")
    del data[path[-1]]
    return [path]
