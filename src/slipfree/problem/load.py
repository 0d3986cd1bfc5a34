"""Loading of problem files by their verb."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from slipfree.files.toml.errors import (
    Fault,
    format_value,
    problem_error,
)
from slipfree.files.toml.reader import read_text
from slipfree.files.toml.source_lines import Source
from slipfree.files.urdf.expansion import trusted_paths
from slipfree.problem.geographic_places import convert_places
from slipfree.problem.problem import Problem
from slipfree.problem.schema import CommonKeys, Runnable
from slipfree.problem.validation import validated_problem
from slipfree.problem.verbs.base import Verb
from slipfree.problem.verbs.registry import find_verb, verbs_of


def load_problem(
    path: str | Path,
    settings: Sequence[str] = (),
    *,
    command: str = "run",
    trust: Sequence[str | Path] = (),
) -> Problem[Runnable]:
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
    trust : sequence of str or Path
        Xacro files that may be expanded. Xacro is a program: name only files that you would
        execute.

    Raises
    ------
    ProblemError
        If the file cannot be read, its verb is unknown or belongs to another command, a setting has
        no valid form, or values do not fit the schema of the verb; all errors, sorted by line.
    DataError
        If a file of ``trust`` does not exist.
    """
    path = Path(path)
    problem = _from_text(verbs_of(command), path, read_text(path), settings)
    return replace(problem, trusted=trusted_paths(trust))


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


def load_again(
    path: Path, text: str, settings: Sequence[str], trusted: frozenset[str] = frozenset()
) -> Problem[Any]:
    """Return the problem in a text, with ``path`` as its file; errors as in `load_problem`.

    ``trusted`` are the paths of xacro files that the command line trusts (`Problem.trusted`).
    """
    return replace(_from_text(verbs_of("run"), path, text, settings), trusted=trusted)


def _from_text(
    verbs: Sequence[Verb],
    path: Path,
    text: str,
    settings: Sequence[str],
    varied: Sequence[str] = (),
) -> Problem[Any]:
    """Return the problem in the text of a TOML file, by the schema of its verb.

    ``settings`` and ``varied`` are those of the options ``--set`` and ``--vary``.
    """

    def schema_of(data: Mapping[str, Any], source: Source) -> type[CommonKeys]:
        return _by_verb(verbs, data, source).schema

    return convert_places(validated_problem(schema_of, path, text, settings, varied))


def _by_verb(verbs: Sequence[Verb], data: Mapping[str, Any], source: Source) -> Verb:
    """Return the verb of a problem, by default the first of ``verbs``.

    Raises
    ------
    ProblemError
        If the verb is unknown, or if another command solves it.
    """
    if "verb" not in data:
        return verbs[0]
    for verb in verbs:
        if data["verb"] == verb.name:
            return verb
    other = find_verb(data["verb"])
    hint = f"; use slipfree {other.commands[0]} {source.path}" if other else "; correct the verb"
    expected = f"{' or '.join(repr(verb.name) for verb in verbs)} for this command"
    raise problem_error(source, [Fault(("verb",), expected, format_value(data["verb"]) + hint)])
