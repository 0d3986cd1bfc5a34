"""Problem files: from TOML to validated records, with all faults at once."""

from __future__ import annotations

import difflib
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar, cast, get_args

from pydantic import BaseModel, ValidationError

from slipfree.errors import DataError
from slipfree.files import escape_name, read_bytes, regular_file
from slipfree.problem.locate import Place, ProblemError, Source, key_lines, key_path
from slipfree.problem.schema import (
    ALTERNATIVES,
    Asked,
    Climb,
    Compare,
    Direct,
    Inverse,
    Motion,
    Plan,
    Task,
)

if TYPE_CHECKING:
    from typing_extensions import TypeIs

LARGEST = 1e300  # number that is shown as one
VAST = 1e100  # no quantity is larger; squares and cubes up to here are numbers
MOST_SAMPLES = 1_000_000
MOST_BYTES = 10_000_000  # of a file of TOML
MOST_KNOWN = 60  # names that are listed in full
DEEPEST = 3  # nesting of an array that is shown
# Python's reader takes hours for keys of very many parts.
LONG_KEY = re.compile(
    r"""(?m)(?:^|[\[{,])[ \t]*+(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){64}"""
)
BARE = re.compile(r"""[^\s"'\[\]{}=,#]+""")  # a --set value that may stand without quotes
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
    "too_long": "an array of {max_length}",
}


COMMANDS: dict[str, tuple[type[Asked], ...]] = {
    "run": (Direct, Inverse, Plan, Climb),
    "compare": (Compare,),
}
S = TypeVar("S", bound=Task)
A = TypeVar("A", bound=Asked)


@dataclass(frozen=True)
class Problem(Generic[A]):
    """A validated problem, and where each of its values comes from."""

    spec: A
    source: Source

    @property
    def folder(self) -> Path:
        """The folder that relative names of input files start from."""
        return self.source.path.parent


class Fault(NamedTuple):
    """One thing wrong with a problem file."""

    place: Place
    expected: str
    found: str


def read(path: str | Path, settings: Sequence[str] = ()) -> Problem[Motion] | Problem[Climb]:
    """Return the problem of a motion in a TOML file, a climb among them; see `read_as`."""
    found = _read(COMMANDS["run"], path, settings)
    return cast("Problem[Motion] | Problem[Climb]", found)


def read_motion(path: str | Path, settings: Sequence[str] = ()) -> Problem[Motion]:
    """Return the problem of a motion over terrain: direct, inverse or a plan; see `read_as`."""
    return _read((Direct, Inverse, Plan), path, settings)


def climbs(problem: Problem[Motion] | Problem[Climb]) -> TypeIs[Problem[Climb]]:
    """Return whether a problem is that of a climb."""
    return isinstance(problem.spec, Climb)


def read_as(schema: type[S], path: str | Path, settings: Sequence[str] = ()) -> Problem[S]:
    """Return the problem in a TOML file.

    Parameters
    ----------
    schema : type
        What the file must hold, by its verb.
    path : str or Path
        The file.
    settings : sequence of str
        Values that replace those of the file, as ``key=value``: dotted keys, values in TOML or
        bare words. ``key=`` with no value takes the key out.

    Raises
    ------
    ProblemError
        If the file cannot be read, or for all that does not fit the schema, sorted by line.
    """
    return _read((schema,), path, settings)


def _read(schemas: Sequence[type[A]], path: str | Path, settings: Sequence[str]) -> Problem[A]:
    """Return the problem in a TOML file, by the schema that its verb names."""
    path = Path(path)
    text = _text(path)
    data = loaded(path, text)
    places = _replaced(data, settings)
    source = Source(path, text, key_lines(text), places)
    schema = _by_verb(schemas, data, source)
    faults = [*_alternatives(schema, data)]
    try:
        spec = schema.model_validate(data)
    except ValidationError as error:
        faults += [_fault(schema, dict(each)) for each in error.errors(include_url=False)]
    else:
        faults += [*vast(data), *_time(spec), *_path(spec)]
        if not faults:
            return Problem(spec, source)
    raise problem_error(source, faults)


def _by_verb(schemas: Sequence[type[A]], data: Mapping[str, Any], source: Source) -> type[A]:
    """Return the schema of the verb, the first if there is none; refuse one of another command."""
    verbs = {_verb(schema): schema for schema in schemas}
    if "verb" not in data:
        return schemas[0]
    for verb, schema in verbs.items():
        if data["verb"] == verb:
            return schema
    hint = next(
        (f"; use slipfree {command} {source.path}"
         for command, others in COMMANDS.items()
         if data["verb"] in [_verb(other) for other in others]),
        "",
    )  # fmt: skip
    expected = f"{' or '.join(map(repr, verbs))} for this command"
    raise problem_error(source, [Fault(("verb",), expected, _shown(data["verb"]) + hint)])


def _verb(schema: type[Asked]) -> str:
    (verb,) = get_args(schema.model_fields["verb"].annotation)
    return str(verb)


def problem_error(source: Source, faults: Iterable[Fault]) -> ProblemError:
    """Return the error that reports all faults, in the order of their lines."""
    ordered = sorted(faults, key=lambda fault: source.order(fault.place))
    return ProblemError(
        *(f"{source.where(f.place)}: expected {f.expected}, found {f.found}" for f in ordered)
    )


def names(place: Place, given: Iterable[str], known: Sequence[str]) -> Iterator[Fault]:
    """Yield a fault for every given name that is not known, with the nearest that is."""
    for name in given:
        if name not in known:
            yield _unknown((*place, name), known)


def loaded(path: Path, text: str) -> dict[str, Any]:
    """Return what a text in TOML holds; ProblemError if it is none, or nested beyond reason."""
    if (found := LONG_KEY.search(text)) is not None:
        line = text.count("\n", 0, found.start()) + 1
        raise ProblemError(
            f"{path}:{line}: expected keys of a few parts, found one of more than 60 parts"
        )
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ProblemError(_syntax(path, text, str(error))) from error
    except RecursionError as error:
        raise ProblemError(
            f"{path}: expected arrays and tables nested a few deep, found them hundreds deep"
        ) from error
    except ValueError as error:  # of a number
        raise ProblemError(f"{path}: expected numbers, found one that is none: {error}") from error


def _text(path: Path) -> str:
    try:
        with regular_file(path, "a problem file") as size:
            if size > MOST_BYTES:
                raise DataError(
                    f"{path}: expected a file of TOML of at most {MOST_BYTES / 1e6:g} MB, found "
                    f"{size / 1e6:.3g} MB; check the name"
                )
            raw = read_bytes(path, "a problem file")
    except DataError as error:
        raise ProblemError(str(error)) from error
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ProblemError(
            f"{path}:{line}: expected text in UTF-8, found the byte {raw[error.start]:#04x}"
        ) from error


def _syntax(path: Path, text: str, message: str) -> str:
    """Return tomllib's message with the line in front; before Python 3.14 only its text has it."""
    found = re.fullmatch(r"(.*) \(at line (\d+), column (\d+)\)", message, re.DOTALL)
    if found is None:
        last = len(text.splitlines()) or 1
        return f"{path}:{last}: expected TOML, found an error at the end: {message}"
    return f"{path}:{found[2]}: expected TOML, found an error in column {found[3]}: {found[1]}"


def _replaced(data: dict[str, Any], settings: Sequence[str]) -> dict[Place, str]:
    """Put settings into the data; return where."""
    places: dict[Place, str] = {}
    faults = []
    for setting in settings:
        key, equals, text = setting.partition("=")
        if (readable := escape_name(setting)) != setting:
            faults.append(
                f"--set {escape_name(key.strip())}: expected text in UTF-8, as in a problem file, "
                f"found {readable}; rename the file if it is a name"
            )
            continue
        try:
            path = key_path(key)
            if not equals:
                raise ValueError
            new = _put(data, path, _value(text)) if text.strip() else _taken_out(data, path)
        except ValueError:
            faults.append(
                f"--set {key.strip()}: expected key=value with a value in TOML or a bare word, or "
                f"key= to take out a key that is there, found {setting!r}"
            )
        else:
            places |= dict.fromkeys(new, setting)
    if faults:
        raise ProblemError(*faults)
    return places


def _value(text: str) -> Any:
    try:
        found = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        if BARE.fullmatch(text.strip()):
            return text.strip()
        raise
    if len(found) > 1:
        raise ValueError(text)
    return found["value"]


def _put(data: dict[str, Any], path: tuple[str, ...], value: Any) -> list[Place]:
    """Put a value into nested tables; return its place and those of new tables on the way."""
    places: list[Place] = [path]
    *tables, last = path
    for depth, name in enumerate(tables, start=1):
        if name not in data:
            places.append(path[:depth])
        data = data.setdefault(name, {})
        if not isinstance(data, dict):
            raise ValueError(name)
    data[last] = value
    return places


def _taken_out(data: dict[str, Any], path: tuple[str, ...]) -> list[Place]:
    """Remove a key of nested tables; return its place."""
    for name in path[:-1]:
        data = data.get(name, {})
    if not isinstance(data, dict) or path[-1] not in data:
        raise ValueError(path)
    del data[path[-1]]
    return [path]


def _alternatives(schema: type[Asked], data: dict[str, Any]) -> Iterator[Fault]:
    """Yield a fault where a table has none, or several, of keys that exclude each other."""
    for place, keys in ALTERNATIVES[schema].items():
        table: Any = data
        for part in place:
            table = table.get(part)
        if not isinstance(table, Mapping):
            continue
        given = [key for key in keys if key in table]
        expected = f"exactly one of {', '.join(keys)}"
        if len(given) != 1:
            yield Fault((*place, *given[-1:]), expected, " and ".join(given) or "none")


def vast(value: Any, place: Place = ()) -> Iterator[Fault]:
    """Yield a fault for every number with which there is no reckoning."""
    if isinstance(value, Mapping | list):
        parts = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, part in parts:
            yield from vast(part, (*place, key))
    elif isinstance(value, float | int) and VAST < abs(value) < inf:
        yield Fault(place, f"a number of at most {VAST:g} in size", _shown(value))


def _path(spec: Asked) -> Iterator[Fault]:
    """Yield the faults of a path: columns beside a file, missing, or not as long as the times."""
    path = spec.path if isinstance(spec, Inverse) else None
    if path is None:
        return
    times = path.t or ()
    for name in ("x", "y", "heading"):
        place, column = ("path", name), getattr(path, name)
        if path.file is not None and column is not None:
            yield Fault(place, "no array beside a file", _shown(list(column)))
        elif path.file is None and len(column or ()) != len(times):
            expected = f"an array of {len(times)} numbers, one for each of t"
            yield Fault(place, expected, f"{len(column)}" if column is not None else "none")


def _time(spec: Asked) -> Iterator[Fault]:
    time = spec.time
    if time.step > time.duration:
        yield Fault(
            ("time", "step"), f"at most the duration, {time.duration:g} s", f"{time.step:g}"
        )
    elif time.duration / time.step > MOST_SAMPLES:
        expected = f"a step that makes at most {MOST_SAMPLES} samples of {time.duration:g} s"
        yield Fault(("time", "step"), expected, f"{time.step:g}")


def _fault(schema: type[BaseModel], error: dict[str, Any]) -> Fault:
    """Return what pydantic found, in our words."""
    place, kind = tuple(error["loc"]), error["type"]
    found = "none" if kind == "missing" else _shown(error["input"])
    if kind == "extra_forbidden":
        model = _model(schema, place[:-1])
        return _unknown(place, list(model.model_fields))
    if kind == "missing" and isinstance(place[-1], int):
        return Fault(place, "a number", found)
    if kind == "missing":
        wanted = _model(schema, place[:-1]).model_fields[place[-1]].annotation
        table = isinstance(wanted, type) and issubclass(wanted, BaseModel)
        table |= str(wanted).startswith("dict")
        return Fault(place, f"a table [{place[-1]}]" if table else "a value", found)
    words = EXPECTED.get(kind)
    return Fault(place, words.format(**error.get("ctx", {})) if words else error["msg"], found)


def _unknown(place: Place, known: Sequence[str]) -> Fault:
    name = str(place[-1])
    nearest = difflib.get_close_matches(name, known, n=1)
    hint = f"; did you mean {nearest[0]!r}?" if nearest else ""
    return Fault(place, f"one of {listed(known)}", f"the unknown key {_cut(name)!r}{hint}")


def listed(known: Sequence[str]) -> str:
    """Return names one after the other, the first ones of very many."""
    more = len(known) - MOST_KNOWN
    return ", ".join(known[:MOST_KNOWN]) + (f" and {more} more" if more > 0 else "")


def _model(schema: type[BaseModel], place: Place) -> type[BaseModel]:
    """Return the record that describes a table."""
    model = schema
    for part in place:
        if isinstance(part, int):
            continue  # of an array of tables
        model = next(_records(model.model_fields[str(part)].annotation))
    return model


def _records(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the records in an annotation, such as an array of them or none."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _records(part)


def _cut(text: str) -> str:
    return text if len(text) < 40 else text[:37] + "..."


def _shown(value: Any, deepest: int = DEEPEST) -> str:
    """Return a value as TOML would have it, shortened."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return repr(_cut(value))
    if isinstance(value, int) and abs(value) >= LARGEST:
        return f"a whole number of {value.bit_length()} bits"
    if isinstance(value, float | int):
        return f"{value:.12g}"
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list):
        parts = [_shown(each, deepest - 1) for each in value[:4] if deepest]
        return f"[{', '.join([*parts, *['...'] * (len(value) > len(parts))])}]"
    return str(value)
