"""Outcomes: whether a motion is complete, and if not, the kind of reason."""

from __future__ import annotations

from enum import Enum

INTERRUPTED_EXIT_CODE = 130  # of shells after Ctrl-C
INCOMPLETE_EXIT_CODE = 1


class Outcome(Enum):
    """Outcome of a motion.

    The value is its help text: the title that summaries print, a colon, and the meaning. Result
    files store the name in lower case.
    """

    COMPLETE = "complete: the motion reaches its end, or an event that was given to end it"
    LIMIT = "limit reached: a limit of the vehicle, the ground or the model ends the motion early"
    NO_EQUILIBRIUM = "no equilibrium: the forces that friction allows cannot continue the motion"
    INFEASIBLE = "infeasible: no plan meets all constraints where the search ended"
    INACCURATE = "inaccurate: the plan is solved, but its simulation misses it by more than asked"
    INTERRUPTED = "interrupted: Ctrl-C, or a progress callable, ended it; what was found is kept"
    SOLVER_FAILURE = "solver failure: the solver found no answer; what it reached is kept"

    @property
    def title(self) -> str:
        """Name in words, as summaries print it."""
        return self.value.partition(":")[0]

    @property
    def exit_code(self) -> int:
        """Exit code of a command: 0 if complete, 130 if interrupted, else 1."""
        if self is Outcome.COMPLETE:
            return 0
        return INTERRUPTED_EXIT_CODE if self is Outcome.INTERRUPTED else INCOMPLETE_EXIT_CODE
