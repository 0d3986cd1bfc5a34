"""Solution of transcribed problems and of nonlinear programs with IPOPT."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.dae import Nlp
from slipfree.core.records import Array, with_overview
from slipfree.core.trajectory import FUTILE_STATUS, SolverError, ipopt_words
from slipfree.plan.constraints import VIOLATION_TOLERANCE
from slipfree.plan.transcription import Program, completed
from slipfree.system.interrupt import InterruptGuard, with_interrupt_guard

INFEASIBLE_STATUS = "Infeasible_Problem_Detected"
SOLVED_STATUS = "Solve_Succeeded"
STOPPED_STATUS = "User_Requested_Stop"  # status after the callback returned False
TIME_STATUS = "Maximum_WallTime_Exceeded"
ITERATIONS_STATUS = "Maximum_Iterations_Exceeded"
SIMULATED_STATUS = "Simulated"  # own status of a plan that is a simulation
NOT_LEAST = {  # by the status of a stage of plans whose cost may not be minimal
    TIME_STATUS: "the search ended early",
    SIMULATED_STATUS: "no plan agreed with its simulation: this simulated motion is the plan; for "
    "less cost, try more plan.intervals",
}
ENDED_STATUSES = (STOPPED_STATUS, TIME_STATUS)  # no further program is solved after them
MAX_FUTILE_ITERATIONS = 150  # without halving the violation; up to 97 in successful searches
RISING_SPAN = 10  # iterations after which a larger violation counts as rising
LEAST_SECONDS = 1e-3  # smallest time limit: IPOPT then evaluates its first iterate
MAX_ITERATIONS = 500
MAX_FIRST_ITERATIONS = 200  # of a search whose solution only begins the next one
MAX_VIOLATION_GROWTH = 10.0  # searches stall more often with larger values
IPOPT_TOLERANCE = 1e-8
WARM_BARRIER = 1e-5  # initial barrier parameter of a start near a solution
WARM_MONOTONE_BARRIER = 1e-3  # the same with the monotone strategy, for models with a replay
NEXT_BARRIER = 1e-4  # the same for a start from the solution of a similar program
MONOTONE_BARRIER = 0.01  # initial barrier parameter of the monotone strategy in cold starts
WARM_PUSH = 1e-9  # smallest distance of scaled unknowns from their bounds in a warm start
WARM_OPTIONS: dict[str, Any] = {
    "warm_start_init_point": "yes",
    **{f"warm_start_{name}_push": WARM_PUSH for name in ("bound", "slack_bound", "mult_bound")},
    "warm_start_bound_frac": WARM_PUSH,
    "warm_start_slack_bound_frac": WARM_PUSH,
}
QUASI_DENSE_ORDERING = 6  # of MUMPS: for a few dense rows, such as that of a free duration
QUIET: dict[str, Any] = {"print_time": False, "error_on_fail": False, "record_time": True}
IPOPT_OPTIONS: dict[str, Any] = {
    "print_level": 0,
    "sb": "yes",
    "tol": IPOPT_TOLERANCE,
    "mumps_permuting_scaling": 0,
}
IterateCallback = Callable[["Iterate"], bool]


class Iterate(NamedTuple):
    """Iterate of IPOPT."""

    number: int  # number of the iteration; zero for the initial guess
    cost: float  # cost, the sum of all weighted terms
    violation: float  # largest violation of the bounds of a row, in its unit
    unknowns: Array  # shape (n_w,): unknowns, not scaled
    program: Program  # the nonlinear program
    is_rising: bool = False  # whether the violation is larger than ten iterations before


@with_overview
class NlpSolution(NamedTuple):
    """Solution of a nonlinear program; if the search failed, its best or last iterate."""

    unknowns: Array  # shape (n_w,): unknowns, not scaled
    rows: Array  # shape (n_g,): values of all rows (constraint functions)
    cost: float  # cost, the sum of all weighted terms
    row_multipliers: Array  # shape (n_g,): lagrange multipliers of the rows
    bound_multipliers: Array  # shape (n_w,): of the bounds of the scaled unknowns
    status: str  # return status of IPOPT
    success: bool  # whether IPOPT reports a solution, or its time ended where all bounds are met
    iterations: int  # number of iterations
    seconds: dict[str, float]  # wall time: total, functions (evaluation) and rest [s]
    # term that IPOPT's last step added to the Hessian; zero if it is positive definite without, on
    # the null space of the equations and with the barrier terms of bounds
    regularisation: float = np.inf


class _IterateWatcher(ca.Callback):
    """CasADi callback that records the best iterate and stops IPOPT.

    The best iterate has the smallest violation or, among those that meet all bounds, least cost.
    """

    def __init__(
        self, program: Program, on_iterate: IterateCallback, guard: InterruptGuard
    ) -> None:
        ca.Callback.__init__(self)
        self.program, self.on_iterate, self.guard = program, on_iterate, guard
        self.violations: list[float] = []
        self.best: tuple[Iterate, Array] | None = None
        n_w, n_g, n_p = program.scale.size, program.g_lower.size, program.problem["p"].numel()
        self.sizes = {"f": 1, "x": n_w, "lam_x": n_w, "g": n_g, "lam_g": n_g, "lam_p": n_p}
        self.construct("watch", {})

    def get_n_in(self) -> int:
        """Return the number of arguments, one for each result of ``nlpsol``."""
        return int(ca.nlpsol_n_out())

    def get_sparsity_in(self, index: int) -> ca.Sparsity:
        """Return the sparsity of an argument: a dense column."""
        return ca.Sparsity.dense(self.sizes[ca.nlpsol_out(index)], 1)

    def eval(self, arguments: Sequence[ca.DM]) -> list[float]:
        """Record and report an iterate; return ``[1.0]`` to stop IPOPT, otherwise ``[0.0]``."""
        try:
            values = dict(zip(ca.nlpsol_out(), arguments, strict=True))
            rows = np.array(values["g"]).ravel()
            unknowns = np.array(values["x"]).ravel() * self.program.scale
            over = largest_violation(self.program, rows)
            count = len(self.violations)
            is_rising = count >= RISING_SPAN and over > self.violations[-RISING_SPAN]
            iterate = Iterate(count, float(values["f"]), over, unknowns, self.program, is_rising)
            if self.best is None or _rank(iterate) < _rank(self.best[0]):
                self.best = iterate, rows
            self.violations.append(over)
            goes_on = self.guard.call(self.on_iterate, iterate)
            return [0.0 if goes_on and not self.is_futile else 1.0]
        except BaseException as error:
            self.guard.keep(error)
            return [1.0]

    @property
    def is_futile(self) -> bool:
        """Whether the last iterations did not halve the violation, and no bounds were met."""
        last = self.violations[-MAX_FUTILE_ITERATIONS:]
        before = min(self.violations[:-MAX_FUTILE_ITERATIONS], default=0.0)
        return before > VIOLATION_TOLERANCE and min(last) > max(before / 2, VIOLATION_TOLERANCE)


def _rank(iterate: Iterate) -> tuple[float, float]:
    violation = max(iterate.violation, VIOLATION_TOLERANCE)
    return violation, iterate.cost if violation == VIOLATION_TOLERANCE else 0.0


def seconds_left(deadline: float) -> float:
    """Return the time until a value of `time.monotonic`, positive even after it [s]."""
    return max(deadline - time.monotonic(), LEAST_SECONDS)


def largest_violation(program: Program, rows: Array) -> float:
    """Return the largest violation of the bounds of all rows, in the unit of the violated row."""
    return float(np.maximum(rows - program.g_upper, program.g_lower - rows).max(initial=0.0))


def solve_program(
    program: Program,
    weights: Array,
    first: Array,
    *,
    warm: NlpSolution | None = None,
    iterations: int = MAX_ITERATIONS,
    on_iterate: IterateCallback | None = None,
) -> NlpSolution:
    """Return the solution of a nonlinear program, warm-started by the multipliers of ``warm``.

    If IPOPT fails, return the iterate with the smallest constraint violation; if it reports an
    infeasible problem, its last iterate. The search ends at the deadline of the task, or after
    `MAX_FUTILE_ITERATIONS` that do not halve the violation. Roots of squared cost terms
    (`stage_functions`) in ``first`` are computed from the other unknowns.
    """
    arguments = {
        "x0": completed(program, first) / program.scale,
        "p": weights,
        "lbx": program.lower / program.scale,
        "ubx": program.upper / program.scale,
        "lbg": program.g_lower,
        "ubg": program.g_upper,
    }
    if warm is not None:
        arguments |= {"lam_g0": warm.row_multipliers, "lam_x0": warm.bound_multipliers}
    ipopt = ({} if warm is None else WARM_OPTIONS) | {
        "max_iter": iterations,
        "max_wall_time": min(seconds_left(program.task.deadline), 1e20),  # IPOPT's default
    }
    if warm is not None and program.task.dae.replay:  # see "mu_strategy" in `_ipopt_solver`
        ipopt["mu_init"] = WARM_MONOTONE_BARRIER
    elif warm is not None and warm.iterations:  # a solution, not only a guess
        ipopt |= {"mu_strategy": "monotone", "mu_init": NEXT_BARRIER}
    with InterruptGuard() as guard:
        watch = _IterateWatcher(program, on_iterate or (lambda _: True), guard)
        solver = _ipopt_solver(program, ipopt, {"iteration_callback": watch})
        solution = _to_solution(program.scale, solver(**arguments), solver.stats())
    if solution.success or solution.status == INFEASIBLE_STATUS or watch.best is None:
        return solution
    if solution.status == STOPPED_STATUS and watch.is_futile:
        solution = solution._replace(status=FUTILE_STATUS)
    best, rows = watch.best
    last = largest_violation(program, solution.rows)
    if _rank(best) < _rank(best._replace(violation=last, cost=solution.cost)):
        solution = solution._replace(unknowns=best.unknowns, rows=rows, cost=best.cost)
    met = largest_violation(program, solution.rows) <= VIOLATION_TOLERANCE
    return solution._replace(success=met and solution.status == TIME_STATUS)


def warm_solver(program: Program, iterations: int) -> ca.Function:
    """Return an IPOPT solver for a start near a solution, without multipliers."""
    ipopt = {"max_iter": iterations, "mu_strategy": "monotone", "mu_init": WARM_BARRIER}
    return _ipopt_solver(program, WARM_OPTIONS | ipopt, {})


def _ipopt_solver(program: Program, ipopt: dict[str, Any], options: dict[str, Any]) -> ca.Function:
    """Return the ``casadi.nlpsol`` function of a program, with options for IPOPT and for CasADi."""
    own: dict[str, Any] = {
        "mu_strategy": "adaptive",
        "honor_original_bounds": "yes",
        "mumps_pivot_order": QUASI_DENSE_ORDERING,
        "theta_max_fact": MAX_VIOLATION_GROWTH,
    }
    if program.task.dae.replay:
        # Contact forces as unknowns require the monotone strategy (docs/decisions.md).
        own |= {"mu_strategy": "monotone", "mu_init": MONOTONE_BARRIER}
    exact: dict[str, Any] = {
        **QUIET,
        "ipopt": IPOPT_OPTIONS | own | ipopt,
        "grad_f": program.gradient,
        "jac_g": program.jacobian,
        "hess_lag": program.hessian,
        "no_nlp_grad": True,
        "calc_lam_p": False,
        "show_eval_warnings": False,
    }
    return ca.nlpsol("plan", "ipopt", program.problem, exact | options)


def _to_solution(scale: Array, results: dict[str, Any], stats: dict[str, Any]) -> NlpSolution:
    """Return the solution of `casadi.nlpsol`, whose unknowns are divided by ``scale``."""
    times = {name: float(value) for name, value in stats.items() if name.startswith("t_wall_")}
    total = times.get("t_wall_total", 0.0)
    functions = sum(value for name, value in times.items() if name.startswith("t_wall_nlp_"))
    return NlpSolution(
        np.array(results["x"]).ravel() * scale,
        np.array(results["g"]).ravel(),
        float(results["f"]),
        np.array(results["lam_g"]).ravel(),
        np.array(results["lam_x"]).ravel(),
        str(stats["return_status"]),
        bool(stats["success"]),
        int(stats["iter_count"]),
        {"total": total, "functions": functions, "rest": total - functions},
        float(stats["iterations"]["regularization_size"][-1]) if stats["iter_count"] else np.inf,
    )


@with_interrupt_guard
def solve_nlp(nlp: Nlp) -> NlpSolution:
    """Return the solution of a nonlinear program, or raise SolverError."""
    ipopt = IPOPT_OPTIONS | {"max_iter": MAX_ITERATIONS, "mu_strategy": "adaptive"}
    problem = {"x": nlp.x, "f": nlp.f, "g": nlp.g}
    solver = ca.nlpsol("nlp", "ipopt", problem, {**QUIET, "ipopt": ipopt})
    results = solver(
        x0=nlp.guess / nlp.scale,
        lbx=nlp.lower / nlp.scale,
        ubx=nlp.upper / nlp.scale,
        lbg=nlp.g_lower,
        ubg=nlp.g_upper,
    )
    solution = _to_solution(nlp.scale, results, solver.stats())
    if not solution.success:
        raise SolverError(
            f"no solution of the nonlinear program was found: {ipopt_words(solution.status)} after "
            f"{solution.iterations} iterations; widen limits that may contradict each other, raise "
            "the friction, or change plan.intervals"
        )
    return solution
