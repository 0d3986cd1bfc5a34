"""Outcomes of motions and plans, and the meanings of the status codes of IPOPT and SUNDIALS."""

from __future__ import annotations

import re
from enum import Enum

INTERRUPTED_EXIT_CODE = 130  # convention of shells for programs ended by Ctrl-C
INCOMPLETE_EXIT_CODE = 1
NO_START = "no consistent initial conditions were found"
SINGULAR = "the Jacobian is singular"
TOO_LONG = "the search reached its time limit"
# own status: IPOPT was stopped, see `MAX_FUTILE_ITERATIONS`
FUTILE_STATUS = "Violation_Not_Reduced"
MALFORMED = "the nonlinear program is malformed: please report this as a bug in slipfree"
IPOPT_STATUSES = {
    "Solve_Succeeded": "the plan is solved",
    "Solved_To_Acceptable_Level": "the plan is solved with reduced accuracy",
    "Feasible_Point_Found": "a motion that meets the constraints was found, but not the best one",
    "Infeasible_Problem_Detected": "the constraints contradict each other where the search ended",
    "Restoration_Failed": "the search could not return to motions that meet the constraints",
    "Maximum_Iterations_Exceeded": "the search reached its maximum number of iterations",
    "Maximum_CpuTime_Exceeded": TOO_LONG,
    "Maximum_WallTime_Exceeded": TOO_LONG,
    "User_Requested_Stop": "the search was stopped",
    FUTILE_STATUS: "the search was given up, since it did not reduce the violation of constraints",
    "Diverging_Iterates": "the unknowns grow without bound: add bounds to quantities in the cost",
    "Search_Direction_Becomes_Too_Small": "the search made no further progress",
    "Error_In_Step_Computation": "the next step of the search could not be computed",
    "Not_Enough_Degrees_Of_Freedom": "there are more equations than unknowns",
    "Invalid_Number_Detected": "a function of the model was not finite during the search",
    "Invalid_Problem_Definition": MALFORMED,
    "Invalid_Option": MALFORMED,
    "Insufficient_Memory": "there is not enough memory: use fewer intervals",
}
SUNDIALS_FLAGS = {  # parts of flags of IDAS and CVODES; the first that a flag contains counts
    "TOO_MUCH_WORK": "too many steps between two samples",
    "TOO_MUCH_ACC": "the tolerance is too small for double precision",
    "QRHS": "an integrated quantity is not finite",
    "RHSFUNC": "the rates are not finite",
    "RES_": "the residuals of the equations are not finite",
    "_ERR_FAIL": "the error test failed at the smallest step",
    "CONV_FAIL": "the equations of a step could not be solved",
    "LINESEARCH_FAIL": NO_START,
    "NO_RECOVERY": NO_START,
    "_LINIT_FAIL": SINGULAR,
    "_LSETUP_FAIL": SINGULAR,
    "_LSOLVE_FAIL": SINGULAR,
    "BAD_EWT": "an unknown is not finite",
    "ILL_INPUT": "an input of the integrator, such as an initial value, is invalid",
    "TOO_CLOSE": "consecutive sample times are too close for double precision",
    "MEM_FAIL": "there is not enough memory",
}
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
