"""Loading of problem files, and the registry of their verbs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from slipfree.core.arguments import checked
from slipfree.files import toml
from slipfree.files.urdf.xacro import trusted_paths
from slipfree.problem.build_ground import convert_places
from slipfree.problem.problem import Problem, validated_problem
from slipfree.problem.schema import CommonKeys, Runnable
from slipfree.problem.verbs.base import DriveVerb, Verb
from slipfree.problem.verbs.direct import DirectVerb
from slipfree.problem.verbs.inverse import InverseVerb
from slipfree.problem.verbs.plan import PlanVerb

VERBS: tuple[Verb, ...] = (
    DirectVerb(),
    InverseVerb(),
    PlanVerb(),
    Verb("slipfree.problem.verbs.compare", "Compare", "compare"),
    Verb("slipfree.problem.verbs.fit", "Fit", "fit"),
    Verb("slipfree.problem.verbs.atlas", "AtlasKeys", "atlas", "check"),
)
REMOVED_VERBS = {"fit-over-map": "use 'fit', the map as [terrain], data.inputs = 'commands'"}


def find_verb(name: object) -> Verb | None:
    """Return the verb with a name; None for an unknown name."""
    return next((verb for verb in VERBS if verb.name == name), None)


def find_motion_verb(name: object) -> DriveVerb | None:
    """Return the verb with a name if ``slipfree run`` solves its problems, otherwise None."""
    verb = find_verb(name)
    return verb if isinstance(verb, DriveVerb) else None


def verb_of(problem: Problem[Runnable]) -> DriveVerb:
    """Return the verb of a problem that ``slipfree run`` solves."""
    return cast("DriveVerb", find_verb(problem.spec.verb))


def check_option(problem: Problem[Any], option: str) -> None:
    """Raise ProblemError, with the verbs that do, if a verb does not support an option of run."""
    if option in verb_of(problem).options:
        return
    able = [v.name for v in VERBS if isinstance(v, DriveVerb) and option in v.options]
    expected = f"{' or '.join(map(repr, able))} for --{option}"
    problem.refuse(toml.Fault(("verb",), expected, f"{problem.spec.verb!r}; omit --{option}"))


@checked
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
    return load_again(path, toml.read_text(path), settings, trusted_paths(trust), command=command)


def load_again(
    path: Path,
    text: str,
    settings: Sequence[str],
    trusted: frozenset[str] = frozenset(),
    *,
    command: str = "run",
    varied: Sequence[str] = (),
    grounds: Mapping[str, Any] = {},
) -> Problem[Any]:
    """Return the problem in a text, with ``path`` as its file; errors as in `load_problem`.

    ``trusted`` are the paths of xacro files that the command line trusts (`Problem.trusted`),
    ``varied`` settings of ``--vary``, ``grounds`` the ground in a result (`Problem.grounds`).
    """

    def schema_of(data: Mapping[str, Any], source: toml.Source) -> type[CommonKeys]:
        """Return the schema of the verb in the tables of a file; raise ProblemError without one."""
        able, name = [verb for verb in VERBS if command in verb.commands], data.get("verb")
        found = find_verb(name)
        if found in able:
            return found.schema
        hint = REMOVED_VERBS.get(str(name), "correct the verb")
        if found:
            hint = f"use slipfree {found.commands[0]} {source.path}; others: slipfree examples"
        expected = f"{' or '.join(repr(verb.name) for verb in able)} for this command"
        words = "none; add the key" if name is None else f"{toml.format_value(name)}; {hint}"
        raise toml.problem_error(source, [toml.Fault(("verb",), expected, words)])

    problem = validated_problem(schema_of, path, text, settings, varied)
    return convert_places(replace(problem, trusted=trusted, grounds=grounds))
