"""Registry of the verbs of problem files."""

from __future__ import annotations

from typing import Any, cast

from slipfree.files.toml.errors import ProblemError
from slipfree.problem.problem import Problem
from slipfree.problem.schema import Runnable
from slipfree.problem.verbs.base import MotionVerb, Verb
from slipfree.problem.verbs.compare import CompareVerb
from slipfree.problem.verbs.direct import DirectVerb
from slipfree.problem.verbs.fit import FitVerb
from slipfree.problem.verbs.inverse import InverseVerb
from slipfree.problem.verbs.plan import PlanVerb

VERBS: tuple[Verb, ...] = (
    DirectVerb(),
    InverseVerb(),
    PlanVerb(),
    CompareVerb(),
    FitVerb(),
)


def verbs_of(command: str) -> tuple[Verb, ...]:
    """Return the verbs that a command accepts."""
    return tuple(verb for verb in VERBS if command in verb.commands)


def find_verb(name: object) -> Verb | None:
    """Return the verb with a name; None for an unknown name."""
    return next((verb for verb in VERBS if verb.name == name), None)


def motion_verbs() -> tuple[MotionVerb, ...]:
    """Return the verbs of the problems that ``slipfree run`` solves."""
    return cast("tuple[MotionVerb, ...]", verbs_of("run"))


def find_motion_verb(name: object) -> MotionVerb | None:
    """Return the verb with a name if ``slipfree run`` solves its problems, otherwise None."""
    return next((verb for verb in motion_verbs() if verb.name == name), None)


def verb_of(problem: Problem[Runnable]) -> MotionVerb:
    """Return the verb of a problem that ``slipfree run`` solves."""
    return cast("MotionVerb", find_verb(problem.spec.verb))


def check_option(problem: Problem[Any], option: str) -> None:
    """Check that the verb of a problem supports an option of ``slipfree run``.

    Raises
    ------
    ProblemError
        If the verb does not support the option; the message names the verbs that do.
    """
    if option in verb_of(problem).options:
        return
    able = [verb.name for verb in motion_verbs() if option in verb.options]
    raise ProblemError(
        f"{problem.source.where(('verb',))}: expected {' or '.join(map(repr, able))} for "
        f"--{option}, found {problem.spec.verb!r}; omit --{option}"
    )
