"""Solve nonlinear programs of other transcriptions, such as that of climbs."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from slipfree.core.nlp import Nlp
from slipfree.core.solver_codes import ipopt_words
from slipfree.core.trajectory import SolverError
from slipfree.plan.ipopt import IPOPT_TOLERANCE, MAX_ITERATIONS, Solution
from slipfree.system.interrupt import with_interrupt_guard


@with_interrupt_guard
def solve_nlp(nlp: Nlp, iterations: int = MAX_ITERATIONS) -> Solution:
    """Return the solution of a nonlinear program, found by IPOPT with exact derivatives.

    Parameters
    ----------
    nlp : Nlp
        Nonlinear program; its cost and rows are functions of the scaled unknowns.
    iterations : int
        Maximum number of iterations.

    Returns
    -------
    Solution
        Unknowns in their units, values of the rows, and multipliers.

    Raises
    ------
    SolverError
        If IPOPT finds no solution.
    """
    options: dict[str, Any] = {
        "ipopt": {
            "print_level": 0,
            "sb": "yes",
            "tol": IPOPT_TOLERANCE,
            "max_iter": iterations,
            "mu_strategy": "adaptive",
            "mumps_permuting_scaling": 0,
        },
        "print_time": False,
        "error_on_fail": False,
        "record_time": True,
    }
    solver = ca.nlpsol("nlp", "ipopt", {"x": nlp.x, "f": nlp.f, "g": nlp.g}, options)
    found = solver(
        x0=nlp.guess / nlp.scale,
        lbx=nlp.lower / nlp.scale,
        ubx=nlp.upper / nlp.scale,
        lbg=nlp.g_lower,
        ubg=nlp.g_upper,
    )
    stats = solver.stats()
    status, count = str(stats["return_status"]), int(stats["iter_count"])
    if not stats["success"]:
        raise SolverError(
            f"no solution of the nonlinear program was found: {ipopt_words(status)} after "
            f"{count} iterations; widen limits that may contradict each other, or change the "
            "number of nodes or the initial guess"
        )
    times = {name: float(value) for name, value in stats.items() if name.startswith("t_wall_")}
    functions = sum(value for name, value in times.items() if name.startswith("t_wall_nlp_"))
    total = times.get("t_wall_total", 0.0)
    x, rows, row_multipliers, bound_multipliers = (
        np.array(found[name]).ravel() for name in ("x", "g", "lam_g", "lam_x")
    )
    return Solution(
        x * nlp.scale,
        rows,
        float(found["f"]),
        row_multipliers,
        bound_multipliers,
        status,
        True,
        count,
        {"total": total, "functions": functions, "rest": total - functions},
    )
