"""Messages about incomplete motions, and the command that resumes a plan."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from slipfree.cli.messages import is_quiet, print_error
from slipfree.core.outcome import Outcome

if TYPE_CHECKING:
    from slipfree.core.trajectory import Trajectory


def print_incomplete(run: Trajectory, out: Path, go_on: str) -> None:
    """Print the outcome of an incomplete motion, its file, and the command that resumes it.

    With ``--quiet``, which omits the summary, print also the reason of the outcome. ``go_on`` is
    the command, empty if there is none.
    """
    from slipfree.core.trajectory import outcome_title, outcome_words

    words = outcome_words(run) if is_quiet() else outcome_title(run)
    print_error(f"{words}; {out} contains the result so far")
    if go_on:
        print_error(f"to resume: {go_on}")


def resume_command(run: Trajectory, out: Path, *options: str) -> str:
    """Return the command that resumes an interrupted plan; empty for other motions."""
    from slipfree.problem.load import find_motion_verb
    from slipfree.problem.verbs.base import RESUME, VERB_ATTRIBUTE

    found = run.attributes
    verb = find_motion_verb(found.get(VERB_ATTRIBUTE))
    if run.outcome is not Outcome.INTERRUPTED or verb is None or RESUME not in verb.options:
        return ""
    file = Path(found["problem_folder"]) / found["problem_file"]
    settings = [part for each in found.get("settings", "").splitlines() for part in ("--set", each)]
    return shlex.join(["slipfree", "run", str(file), *settings, *options, "--resume", str(out)])
