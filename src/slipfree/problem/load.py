"""Problem files: from TOML to validated records, with all faults at once."""

from __future__ import annotations

import re
import shlex
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast, get_args

from pydantic import ValidationError

from slipfree.files.toml.angles import bare_words
from slipfree.files.toml.errors import (
    Fault,
    ProblemError,
    format_value,
    problem_error,
    validation_fault,
    vast,
)
from slipfree.files.toml.reader import parse_toml, read_text
from slipfree.files.toml.source_lines import Place, Source, key_lines, key_path
from slipfree.problem.old_keys import upgrade_keys
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
from slipfree.regular_files import escape_name

if TYPE_CHECKING:
    from typing_extensions import TypeIs

MOST_SAMPLES = 1_000_000
BARE = re.compile(r"""[^\s"'\[\]{}=,#]+""")  # a --set value that may stand without quotes


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

    def __repr__(self) -> str:
        return f"Problem: {self.spec.verb}, {self.source.path}"

    @property
    def folder(self) -> Path:
        """The folder that relative names of input files start from."""
        return self.source.path.parent


def load_problem(
    path: str | Path, settings: Sequence[str] = ()
) -> Problem[Motion] | Problem[Climb]:
    """Return the problem of a motion in a TOML file, a climb among them; see `read_as`."""
    found = _read(COMMANDS["run"], path, settings)
    return cast("Problem[Motion] | Problem[Climb]", found)


def read_earlier(
    path: str | Path, settings: Sequence[str] = ()
) -> Problem[Motion] | Problem[Climb]:
    """Return a problem that this or an earlier version has run; see `read_as`."""
    found = _read(COMMANDS["run"], path, settings, earlier=True)
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


def _read(
    schemas: Sequence[type[A]],
    path: str | Path,
    settings: Sequence[str],
    *,
    earlier: bool = False,
) -> Problem[A]:
    """Return the problem in a TOML file, by the schema that its verb names.

    Keys of earlier versions are errors, unless ``earlier`` accepts them.
    """
    path = Path(path)
    text = read_text(path)
    data = parse_toml(path, text)
    places = _replaced(data, settings)
    source = Source(path, text, key_lines(text), places)
    schema = _by_verb(schemas, data, source)
    data, replaced = upgrade_keys(data)
    faults = [*_alternatives(schema, data), *([] if earlier else _with_remedy(source, replaced))]
    try:
        spec = schema.model_validate(data)
    except ValidationError as error:
        faults += [validation_fault(schema, dict(each)) for each in error.errors(include_url=False)]
    else:
        faults += [*vast(data), *_time(spec), *_path(spec)]
        if not faults:
            return Problem(spec, source)
    raise problem_error(source, faults)


def _with_remedy(source: Source, faults: Sequence[Fault]) -> Iterator[Fault]:
    """Yield errors of old keys with the command that rewrites the file, if they are in the file."""
    remedy = f"; rewrite the file: slipfree migrate {shlex.quote(str(source.path))}"
    for fault in faults:
        yield fault if source.is_set(fault.place) else fault._replace(found=fault.found + remedy)


def _by_verb(schemas: Sequence[type[A]], data: Mapping[str, Any], source: Source) -> type[A]:
    """Return the schema of the verb, the first if there is none; refuse one of another command."""
    verbs = {_verb(schema): schema for schema in schemas}
    if "verb" not in data:
        return schemas[0]
    for verb, schema in verbs.items():
        if data["verb"] == verb:
            return schema
    hint = next(
        (
            f"; use slipfree {command} {source.path}"
            for command, others in COMMANDS.items()
            if data["verb"] in [_verb(other) for other in others]
        ),
        "",
    )
    expected = f"{' or '.join(map(repr, verbs))} for this command"
    raise problem_error(source, [Fault(("verb",), expected, format_value(data["verb"]) + hint)])


def _verb(schema: type[Asked]) -> str:
    (verb,) = get_args(schema.model_fields["verb"].annotation)
    return str(verb)


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


def _path(spec: Asked) -> Iterator[Fault]:
    """Yield the faults of a path: columns beside a file, missing, or not as long as the times."""
    path = spec.path if isinstance(spec, Inverse) else None
    if path is None:
        return
    times = path.t or ()
    if path.heading and (words := bare_words(path.heading[0])):
        yield Fault(("path", "heading"), words, format_value(path.heading[0]))
    for name in ("x", "y", "heading"):
        place, column = ("path", name), getattr(path, name)
        if path.file is not None and column is not None:
            yield Fault(place, "no array beside a file", format_value(list(column)))
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
