"""Outcomes of motions and plans, and the meanings of the status codes of IPOPT and SUNDIALS."""

from __future__ import annotations

import re
import tomllib
from enum import Enum
from pathlib import Path

INTERRUPTED_EXIT_CODE = 130  # convention of shells for programs ended by Ctrl-C
INCOMPLETE_EXIT_CODE = 1
FUTILE_STATUS = "Violation_Not_Reduced"  # own status: IPOPT was stopped
TABLES = tomllib.loads(Path(__file__).with_name("statuses.toml").read_text("utf-8"))
IPOPT_STATUSES, SUNDIALS_FLAGS = (  # meanings of status codes
    {code: words for words, codes in table.items() for code in codes.split()}
    for table in TABLES.values()
)
NO_START = SUNDIALS_FLAGS["NO_RECOVERY"]
FLAG = re.compile(r"\b(IDA|CV)_[A-Z_]+\b")
SOURCE = re.compile(r"^\S+\.[ch]pp:\d+: ")  # line of CasADi's source code in a message


class Outcome(Enum):
    """Outcome of a motion or a plan: complete, or the category of the stop reason.

    The value of a member is the title in summaries, a colon, and an explanation. Result files
    contain the name of the member in lower case.
    """

    COMPLETE = "complete: the motion reaches its end, or an event that ends it"
    LIMIT = "limit reached: a limit of the vehicle, the ground or the model ends the motion early"
    NO_EQUILIBRIUM = "no equilibrium: the forces that friction allows cannot continue the motion"
    INFEASIBLE = "infeasible: the search ended without a plan that meets all constraints"
    INACCURATE = "inaccurate: the simulation deviates from the plan by more than the tolerance"
    TIME_LIMIT = "time limit reached: the search ended without a plan; what it found is kept"
    INTERRUPTED = "interrupted: Ctrl-C or a progress callable ended the run; its samples are kept"
    SOLVER_FAILURE = "solver failure: the solver found no solution; earlier samples are kept"

    @property
    def title(self) -> str:
        """Title of the outcome in summaries, such as ``"limit reached"``."""
        return self.value.partition(":")[0]

    @property
    def exit_code(self) -> int:
        """Exit code of a command with this outcome: 0 if complete, 130 if interrupted, else 1."""
        if self is Outcome.COMPLETE:
            return 0
        return INTERRUPTED_EXIT_CODE if self is Outcome.INTERRUPTED else INCOMPLETE_EXIT_CODE


def ipopt_words(status: str) -> str:
    """Return the meaning of a status of IPOPT, followed by the status in parentheses."""
    words = IPOPT_STATUSES.get(status, "the search failed")
    return words if status == FUTILE_STATUS else f"{words} (IPOPT: {status})"


def sundials_words(message: str) -> str:
    """Return the meaning of the SUNDIALS flag in an error message of CasADi, and the flag.

    For a message without a flag, return its last line.
    """
    if found := FLAG.search(message):
        meanings = (words for part, words in SUNDIALS_FLAGS.items() if part in found[0])
        return f"{next(meanings, 'the integrator failed')} ({found[0]})"
    return SOURCE.sub("", message.strip().splitlines()[-1])
