"""TOML files: lines of values, settings of the command line, error messages.

Types of the values in TOML files, and the base class of their tables.

Angles and their rates are numbers in radians, or text with a unit as in "30 deg".
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field
from functools import cache, lru_cache
from itertools import pairwise
from math import inf, pi
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    PlainValidator,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    create_model,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from slipfree.core.arguments import MAX_NUMBER, WithUnit, degrees_question
from slipfree.core.errors import DataError, listed, read_table, shortened, similar
from slipfree.core.schema import keys_of, meanings
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
MAX_MEANING = 90  # characters of the meaning of a key in messages
MAX_SHOWN_NUMBER = 1e300  # larger integers are described by their number of bits
ALTERNATIVES = "constrained-", "tuple["  # names of types in places of errors
MAX_VALUE = 1e100  # largest quantity; its squares and cubes are finite
MAX_SHOWN_DEPTH = 3  # nesting up to which arrays are shown
ERRORS = read_table(__file__, "toml_errors.toml")
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
            table = ()
            for part in key[: len(key) - (depth == 2)]:
                table = (*table, part)
                if table in counts:  # an array of tables: its last element
                    table = (*table, counts[table])
            if depth == 2:
                table = (*table, key[-1])
                lines.setdefault(table, line)
                counts[table] = counts.get(table, -1) + 1
                table = (*table, counts[table])
        place = table if depth else (*table, *key)
        for end in range(1, len(place) + 1):
            lines.setdefault(place[:end], line)
        level = index = 0
        for piece in PIECE.findall(statement[match.end() :]) if "{" in statement else ():
            if piece == "{" and level == 1:  # a table in an inline value, numbered as in an array
                lines.setdefault((*place, index), line)
                index += 1
            level += (piece in "[{") - (piece in "]}")
            line += piece.count("\n")
    return lines


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
    # of a value with alternatives, pydantic adds the name of each to the place
    place = tuple(part for part in error["loc"] if not str(part).startswith(ALTERNATIVES))
    kind = error["type"]
    found = "none" if kind == "missing" else format_value(error["input"])
    if kind == "extra_forbidden":
        record, name = record_at(schema, place[:-1], data), place[-1]
        tables = record_at(schema, (), data).model_fields.items()
        parts = ((table, part) for table, key in tables for part in _records(key.annotation))
        owners = sorted({f"[{table}]" for table, part in parts if name in part.model_fields})
        return _unknown(place, record.known_keys(), record.foreign.get(name) or owners)
    if kind == "missing" and isinstance(place[-1], int):
        return Fault(place, "a number", found)
    if kind == "missing":
        wanted = record_at(schema, place[:-1], data).model_fields[place[-1]].annotation
        table = isinstance(wanted, type) and issubclass(wanted, BaseModel)
        table |= str(wanted).startswith("dict")
        meaning = _meaning(schema, place, data)
        return Fault(place, f"a table [{place[-1]}]" if table else f"a value{meaning}", found)
    words = ERRORS["expected"].get(kind)
    details = error.get("ctx", {})
    expected = words.format(**details) if words else error["msg"]
    found = details.get("found", found)
    if isinstance(error["input"], str) and re.match(r"\s*[-+]?\.?\d", error["input"]):
        found += "; write the number alone, in SI units" if expected.startswith("a number") else ""
    if re.fullmatch(r"a (whole |finite )?number[^,]*", expected):
        expected += _meaning(schema, place, data)
    return Fault(place, expected, found)


def _meaning(schema: type[BaseModel], place: Place, data: Any) -> str:
    """Return the meaning of a key in parentheses, if it is known and short."""
    field = record_at(schema, place[:-1], data).model_fields.get(place[-1])
    words = (field and field.description) or ""
    return f" ({words})" if 0 < len(words) <= MAX_MEANING else ""


def _unknown(place: Place, known: Sequence[str], owners: Sequence[str] = ()) -> Fault:
    """Return the error of an unknown key; ``owners`` have such a key."""
    name = str(place[-1])
    expected = f"one of {listed(known)}" if known else "no key"
    owner = f", a key of {' and '.join(owners)}; move it" if owners else ""
    found = f"the unknown key {shortened(name, 40)!r}{owner}"
    return Fault(place, expected, found, "" if owner else similar(name, known))


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
            model = next(_records(annotation), Record)
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
            lines = [*text.split("\n"), ""]
            odd = lines[int(place[2]) - 1][int(place[3]) - 1 :][:1]
            if not odd.isascii():  # quotes, a minus or a blank of a word processor
                raise ProblemError(
                    f"{where}: expected TOML, found {found}; replace the character {odd!r}"
                ) from error
        elif str(error).endswith("(at end of document)"):
            where = f"{path}:{len(text.splitlines()) or 1}"
            found = f"an error at the end: {error}"
        found += next((words for part, words in ERRORS["syntax"].items() if part in str(error)), "")
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
            new, (*tables, last), level = [path], path, data
            for depth, name in enumerate(tables, start=1):
                new += [path[:depth]] * (name not in level)
                level = level.setdefault(name, {})
                if not isinstance(level, dict):
                    raise _KeyPlaceError(
                        f"expected a key of a table, found that {'.'.join(path[:depth])!r} is not "
                        "a table; correct the key"
                    )
            if text.strip():
                level[last] = _value(text)
            elif level.pop(last, None) is None:
                raise _KeyPlaceError("expected a key to remove, found no such key; correct the key")
        except _KeyPlaceError as error:
            faults.append(f"{option} {key.strip()}: {error}")
        except ValueError:
            several = "; for several values use slipfree sweep FILE --vary" * ("," in text)
            faults.append(
                f"{option} {shortened(key.strip())}: expected key=value with a value in TOML or a "
                f"bare word, or key= to remove a key, found {shortened(setting)!r}{several}"
            )
        else:
            places |= dict.fromkeys(new, setting)
    if faults:
        raise ProblemError(*faults)
    return places


class _KeyPlaceError(ValueError):
    """Error for a valid key that cannot be set or removed in the given tables."""


def _value(text: str) -> Any:
    """Return a TOML value, or the text itself if it needs no quotes or is an angle with a unit."""
    try:
        (value,) = load_toml(f"value = {text}").values()
    except ValueError:
        if BARE.fullmatch(text.strip()) or TEXT.fullmatch(text):
            return text.strip()
        raise
    return value


EXAMPLE = 'a number, or text with an angular unit, as in "30 deg" or "5 deg/s"'
PAIRS = "a number, or an array of [time, value] pairs"
TEXT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?)\s*(deg|°|rad)(/s2?)?\s*")
MAX_FRICTION = 10.0  # larger coefficients are probably percent
Piecewise = tuple[tuple[float, float], ...]


class Record(BaseModel):
    """Base class of the tables of TOML files: frozen, without type conversion or unknown keys."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)
    alternatives: ClassVar[tuple[str, ...]] = ()
    """Keys of which a table must have exactly one."""
    foreign: ClassVar[Mapping[str, tuple[str, ...]]] = {}
    """Keys of other files, and these files in words."""

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """Describe the keys as the docstrings of this record and of those above it do."""
        for base in cls.__mro__:
            for name, words in meanings(base).items():
                field = cls.model_fields.get(name)
                if field is not None and (base is cls or field.description is None):
                    field.description = words

    @classmethod
    def schema_for(cls, data: Any) -> type[Record]:  # noqa: ARG003 - for records that depend on it
        """Return the schema for a table with given contents, by default this one."""
        return cls

    @classmethod
    def known_keys(cls) -> list[str]:
        """Return the keys that messages about unknown keys list."""
        return [*cls.model_fields]

    @model_validator(mode="wrap")
    @classmethod
    def _by_contents(cls, data: Any, handler: ModelWrapValidatorHandler[Record]) -> Record:
        """Validate a table by the schema for its contents, and by its alternatives."""
        schema = cls.schema_for(data)
        if schema is not cls:
            return schema.model_validate(data)
        keys = cls.alternatives if isinstance(data, dict) else ()
        present = [key for key in keys if key in data]
        if not keys or len(present) == 1:
            return handler(data)
        found = " and ".join(present) or "none"
        choice = expected_error(f"exactly one of {', '.join(keys)}", found)
        errors: list[InitErrorDetails] = [{"type": choice, "loc": (*present[-1:],), "input": data}]
        try:
            handler(data)
        except ValidationError as error:
            for each in error.errors(include_url=False):
                kind = PydanticCustomError(each["type"], each["msg"], each.get("ctx"))
                errors.append({"type": kind, "loc": each["loc"], "input": each["input"]})
        raise ValidationError.from_exception_data(cls.__name__, errors)


def expected_error(text: str, found: str = "") -> PydanticCustomError:
    """Return an error of pydantic with the expected value, and the found one unless it is shown."""
    context = {"words": text, "found": found} if found else {"words": text}
    return PydanticCustomError("expected", "{words}", context)


class AngleWithUnit(WithUnit):
    """An angle [rad]."""

    unit, words = "rad", "an angle"


class RateWithUnit(WithUnit):
    """An angular rate [rad/s]."""

    unit, words = "rad s-1", "an angular rate"


class _AccelerationWithUnit(WithUnit):
    """An angular acceleration [rad/s2]."""

    unit, words = "rad s-2", "an angular acceleration"


KINDS = {None: AngleWithUnit, "/s": RateWithUnit, "/s2": _AccelerationWithUnit}


def parse_unit(value: Any) -> Any:
    """Return the number of a text such as "30 deg" in SI units; return other values unchanged."""
    match = TEXT.fullmatch(value) if isinstance(value, str) and len(value) < 100 else None
    if match is None:
        return value
    number = float(match[1])
    return KINDS[match[3]](number if match[2] == "rad" else number * pi / 180)


def _reader(unit: type[WithUnit], text: str) -> WrapValidator:
    """Return a validator of numbers, or of text with a number and a ``unit``."""

    def read(value: Any, validate: ValidatorFunctionWrapHandler) -> float:
        parsed = parse_unit(value)
        has_unit = isinstance(parsed, WithUnit)
        if isinstance(parsed, str) or (has_unit and not isinstance(parsed, unit)):
            raise expected_error(text)
        number: float = validate(float(parsed) if has_unit else parsed)
        return parsed if has_unit else number

    return WrapValidator(read)


WITH_UNIT = _reader(WithUnit, EXAMPLE)
Quantity = Annotated[float, WITH_UNIT]  # `unit_faults` checks the unit, which depends on the key
IN_RADIANS = _reader(AngleWithUnit, 'a number, or text as in "30 deg"')
IN_RADIANS_PER_SECOND = _reader(RateWithUnit, 'a number, or text as in "5 deg/s"')
Angle = Annotated[float, IN_RADIANS]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=0)]
# arrays are read as tuples; types of elements are not converted
Pair = Annotated[tuple[float, float], Field(strict=False)]
Point = Annotated[tuple[float, float, float], Field(strict=False)]
Column = Annotated[tuple[float, ...], Field(strict=False)]
Angles = Annotated[tuple[Angle, ...], Field(strict=False)]
Window = Annotated[tuple[float, float, float, float], Field(strict=False)]
Rock = Annotated[tuple[float, float, float, float], Field(strict=False)]


def unit_faults(
    place: Place, values: Mapping[str, Any], units: Mapping[str, str], *, bare: bool = False
) -> Iterator[Fault]:
    """Yield an error for each value with another unit, and if ``bare`` for angles above a turn."""
    for name, value in values.items():
        unit = units.get(name, "")
        for number in _numbers(value) if unit else ():
            if isinstance(number, WithUnit) and number.unit != unit:
                wanted = unit.replace(" s-", "/s").replace("/s1", "/s")
                found = f"{number.words}; correct the unit"
                yield Fault((*place, name), f"a number in {wanted}", found)
                break
            if bare and unit == "rad" and (hint := bare_words(number)):
                yield Fault((*place, name), hint, format_value(number))
                break


def bare_words(value: float) -> str:
    """Return the expected value for an angle above a full turn without unit, in words; else ""."""
    question = degrees_question(value, f'"{value:.6g} deg"')
    return question and f"radians ({question})"


def in_radians(value: float) -> float:
    """Return an angle unchanged; raise an error if it has no unit and exceeds a full turn."""
    if hint := bare_words(value):
        raise expected_error(hint)
    return value


ANGULAR = {  # angles and rates may have a unit; a bare angle of more than a full turn is an error
    "rad": (IN_RADIANS, AfterValidator(in_radians)),
    "rad/s": (IN_RADIANS_PER_SECOND,),
    "rad or m": (WITH_UNIT,),  # `unit_faults` checks the unit
    "rad/s or m/s": (WITH_UNIT,),
}


@cache
def record_of(
    kind: Callable[..., Any],
    base: type[Record] = Record,
    *,
    omitted: tuple[str, ...] = (),
    meaning: str = "",
) -> type[Any]:
    """Return the record of a dataclass or function, with the keys of ``base`` before its own.

    The fields or parameters ``omitted`` are no keys; ``meaning`` replaces the first line of the
    docstring as the meaning of the table.
    """
    keys: dict[str, Any] = {}
    for key in keys_of(kind):
        if key.name not in omitted:
            plain = getattr(key.hint, "__origin__", key.hint)
            read = ANGULAR.get(key.unit, (Field(),))
            if tuple in (plain, get_origin(plain)):
                read = (Field(strict=False),)
            default = ... if key.default is MISSING else key.default
            known = Field(default=default, description=key.description)
            keys[key.name] = Annotated[key.hint, *read], known
    meaning = meaning or (kind.__doc__ or "").partition("\n")[0]
    name = kind.__name__
    name = name if isinstance(kind, type) else name.title().replace("_", "")
    return create_model(name, __base__=base, __doc__=meaning, **keys)


def decoded(kind: Callable[..., Any]) -> Any:
    """Return the type of a table that is decoded into a dataclass with annotated fields."""
    made = AfterValidator(lambda table: kind(**given_values(table)))
    return Annotated[record_of(kind), made]


def given_values(table: Record) -> dict[str, Any]:
    """Return the values that a file gives for the keys of a table, without defaults."""
    return {name: getattr(table, name) for name in table.model_fields_set}


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, float):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from _numbers(part)


def is_number(value: Any) -> bool:
    """Return whether a value is a number that fits a float; a bool is not."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return abs(value) <= MAX_NUMBER  # integers may exceed all floats


def _number(value: Any) -> float:
    return value if isinstance(value, WithUnit) else float(value)


def _piecewise_constant(value: Any, expected: str = PAIRS) -> float | Piecewise:
    """Return a number, or the (time, value) pairs of a piecewise-constant function."""
    value = parse_unit(value)
    if is_number(value):
        return _number(value)
    if not isinstance(value, list):
        raise expected_error(expected)
    if not value or not all(isinstance(pair, list) and len(pair) == 2 for pair in value):
        raise expected_error(PAIRS)
    pairs = [(time, parse_unit(rate)) for time, rate in value]
    if not all(map(is_number, (number for pair in pairs for number in pair))):
        raise expected_error(PAIRS)
    times = [time for time, _ in pairs]
    if times[0] != 0 or any(b <= a for a, b in pairwise(times)):
        raise expected_error("[time, value] pairs whose times ascend from 0")
    return tuple((float(t), _number(rate)) for t, rate in pairs)


def _or_text(expected: str) -> PlainValidator:
    """Return a validator of a piecewise-constant function, or a text that names or describes it."""

    def read(value: Any) -> float | Piecewise | str:
        is_text = isinstance(value, str) and value and parse_unit(value) is value
        return value if is_text else _piecewise_constant(value, expected)

    return PlainValidator(read)


def _range(value: Any) -> tuple[float, float]:
    """Return the ends of a range in ascending order; both are the number of a single one."""
    value = [*map(parse_unit, value)] if isinstance(value, list) else parse_unit(value)
    ends = value if isinstance(value, list) else [value, value]
    if len(ends) == 2 and all(map(is_number, ends)):
        low, high = map(_number, ends)
        if low <= high:
            return low, high
    raise expected_error("a number, or [low, high] in ascending order")


def coefficient(value: Any) -> float | str:
    """Return a coefficient of friction, or the name of a friction map file."""
    if isinstance(value, str) and value:
        return value
    if is_number(value) and 0 < value <= MAX_FRICTION:
        return float(value)
    percent = ""
    if is_number(value) and value > MAX_FRICTION:
        percent = f"at most {MAX_FRICTION:g} (did you mean percent? write {value / 100:g}), "
    raise expected_error(f"a number greater than 0, {percent}or the name of a file in quotes")


def one_of(known: Collection[str]) -> AfterValidator:
    """Return a validator that accepts the names among ``known``, which may change later."""

    def check(name: str) -> str:
        if name not in known:
            raise expected_error(f"one of {', '.join(known)}")
        return name

    return AfterValidator(check)


def not_zero(value: float) -> float:
    """Return a speed unchanged; raise an error for zero."""
    if value == 0:
        raise expected_error("a speed other than zero")
    return value


PiecewiseConstant = Annotated[Any, PlainValidator(_piecewise_constant)]
PiecewiseConstantOrFile = Annotated[Any, _or_text(PAIRS)]
TimeFunction = Annotated[
    Any, _or_text("a number, an array of [time, value] pairs, or a formula of t in quotes")
]
Range = Annotated[Any, PlainValidator(_range)]
