"""Outcomes of motions and plans: complete, or the category of the stop reason."""

from __future__ import annotations

from enum import Enum

INTERRUPTED_EXIT_CODE = 130  # convention of shells for programs ended by Ctrl-C
INCOMPLETE_EXIT_CODE = 1


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
