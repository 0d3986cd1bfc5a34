"""Loading of problem files: TOML to validated records, with all errors at once."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from slipfree.files.toml.errors import (
    Fault,
    format_value,
    problem_error,
    validation_fault,
    value_errors,
)
from slipfree.files.toml.reader import parse_toml, read_text
from slipfree.files.toml.settings import replace_values
from slipfree.files.toml.source_lines import Source, key_lines
from slipfree.problem.old_keys import upgrade_keys
from slipfree.problem.problem import Problem
from slipfree.problem.schema import CommonKeys
from slipfree.problem.verbs.base import Verb
from slipfree.problem.verbs.registry import find_verb, verbs_of


def load_problem(
    path: str | Path, settings: Sequence[str] = (), *, command: str = "run"
) -> Problem[Any]:
    """Return the problem in a TOML file.

    Parameters
    ----------
    path : str or Path
        The file.
    settings : sequence of str
        Values that replace those of the file, as ``key=value``: dotted keys, values in TOML or
        bare words. ``key=`` without a value removes the key.
    command : str
        The command of ``slipfree`` that solves it: ``"run"``, ``"compare"``, or ``"vehicle"`` for
        problems with a vehicle on terrain.

    Raises
    ------
    ProblemError
        If the file cannot be read, has another command's verb, or does not fit the schema of its
        verb: all errors, sorted by line.
    """
    return _load(verbs_of(command), path, settings)


def load_variants(
    path: str | Path, settings: Sequence[str], variants: Iterable[Sequence[str]]
) -> Iterator[Problem[Any]]:
    """Yield the variants of the problem in a TOML file, which is read once.

    Parameters
    ----------
    path : str or Path
        The file.
    settings : sequence of str
        Settings of all variants; see `load_problem`.
    variants : iterable of sequence of str
        Further settings of each variant, from the option ``--vary``.

    Raises
    ------
    ProblemError
        As in `load_problem`.
    """
    text = read_text(Path(path))
    for varied in variants:
        yield _from_text(verbs_of("run"), Path(path), text, settings, varied)


def load_again(path: Path, text: str, settings: Sequence[str]) -> Problem[Any]:
    """Return a problem from the text that its file had; see `load_problem`."""
    return _from_text(verbs_of("run"), path, text, settings)


def load_earlier(path: str | Path, settings: Sequence[str] = ()) -> Problem[Any]:
    """Return a problem that this or an earlier version has run; see `load_problem`."""
    return _load(verbs_of("run"), path, settings, earlier=True)


def _load(
    verbs: Sequence[Verb],
    path: str | Path,
    settings: Sequence[str],
    *,
    earlier: bool = False,
) -> Problem[Any]:
    """Return the problem in a TOML file, by the schema of its verb.

    Keys of earlier versions are errors, unless ``earlier`` accepts them.
    """
    path = Path(path)
    return _from_text(verbs, path, read_text(path), settings, earlier=earlier)


def _from_text(
    verbs: Sequence[Verb],
    path: Path,
    text: str,
    settings: Sequence[str],
    varied: Sequence[str] = (),
    *,
    earlier: bool = False,
) -> Problem[Any]:
    """Return the problem in a text; see `_load` and `load_variants`."""
    data = _copy(_parsed(path, text))
    places = replace_values(data, settings)
    varied_places = replace_values(data, varied, "--vary")
    source = Source(path, text, key_lines(text), places | varied_places, frozenset(varied_places))
    schema = _by_verb(verbs, data, source).schema
    data, replaced = upgrade_keys(data)
    faults = [*_alternatives(schema, data), *([] if earlier else _with_remedy(source, replaced))]
    try:
        spec = schema.model_validate(data)
    except ValidationError as error:
        faults += [validation_fault(schema, dict(each)) for each in error.errors(include_url=False)]
    else:
        faults += [*value_errors(data), *spec.faults()]
        if not faults:
            return Problem(spec, source)
    raise problem_error(source, faults)


@lru_cache(maxsize=1)
def _parsed(path: Path, text: str) -> dict[str, Any]:
    """Return the data in a text; variants of one problem share it."""
    return parse_toml(path, text)


def _copy(value: Any) -> Any:
    """Return a copy of parsed TOML."""
    if isinstance(value, dict):
        return {key: _copy(each) for key, each in value.items()}
    return [*map(_copy, value)] if isinstance(value, list) else value


def _with_remedy(source: Source, faults: Sequence[Fault]) -> Iterator[Fault]:
    """Yield errors of old keys with the command that rewrites the file, if they are in the file."""
    remedy = f"; rewrite the file: slipfree migrate {shlex.quote(str(source.path))}"
    for fault in faults:
        yield fault if source.is_set(fault.place) else fault._replace(found=fault.found + remedy)


def _by_verb(verbs: Sequence[Verb], data: Mapping[str, Any], source: Source) -> Verb:
    """Return the verb of a problem, the first by default; raise for verbs of other commands."""
    if "verb" not in data:
        return verbs[0]
    for verb in verbs:
        if data["verb"] == verb.name:
            return verb
    other = find_verb(data["verb"])
    hint = f"; use slipfree {other.commands[0]} {source.path}" if other else ""
    expected = f"{' or '.join(repr(verb.name) for verb in verbs)} for this command"
    raise problem_error(source, [Fault(("verb",), expected, format_value(data["verb"]) + hint)])


def _alternatives(schema: type[CommonKeys], data: dict[str, Any]) -> Iterator[Fault]:
    """Yield an error for a table with none or several of mutually exclusive keys."""
    for place, keys in schema.alternatives.items():
        table: Any = data
        for part in place:
            table = table.get(part)
        if not isinstance(table, Mapping):
            continue
        given = [key for key in keys if key in table]
        expected = f"exactly one of {', '.join(keys)}"
        if len(given) != 1:
            yield Fault((*place, *given[-1:]), expected, " and ".join(given) or "none")
