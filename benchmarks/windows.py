"""Measure plans over kilometres in windows: time and memory, and slip against `follow`.

``python benchmarks/windows.py`` plans ``problems/plan_long_dem.toml`` with goals 0.4, 1.3 and
3.5 km away, each in a separate process, and simulates the driving law along the same routes. Slip
is the slip path in the simulations, per wheel and metre driven.
"""

from __future__ import annotations

import multiprocessing
import resource
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from reference import heading

from slipfree import load_problem, run_problem
from slipfree.problem.verbs.base import Watch
from slipfree.problem.verbs.driving import integrate
from slipfree.trajectory import Trajectory, path_length

PROBLEM = Path(__file__).parents[1] / "problems" / "plan_long_dem.toml"
GOALS = {"0.4 km": (900.0, 2900.0), "1.3 km": (1400.0, 2000.0), "3.5 km": (2600.0, 600.0)}


def words(run: Trajectory) -> str:
    """Return slip and utilisation of a motion as text."""
    slip = np.trapezoid(np.hypot(run["slip_along"], run["slip_across"]), run.t, axis=0).mean()
    slip = 1e3 * slip / path_length(run)
    return (
        f"{run.outcome.name.lower()}, {path_length(run):.0f} m, slip {slip:.4f} mm/m, "
        f"utilisation at most {run['utilisation'].max():.3f}"
    )


def planned(name: str) -> None:
    """Plan to a goal and print a row."""
    x, y = GOALS[name]
    problem = load_problem(PROBLEM, (f"goal.x={x}", f"goal.y={y}"))
    begin = time.perf_counter()
    result = run_problem(problem)
    seconds, run = time.perf_counter() - begin, result.trajectory
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{name}: plan {words(run)}", flush=True)
    print(f"  {run.attributes['plan_windows']}", flush=True)
    violation = result.verification
    worst = max((v.value for k, v in violation.items() if "violation" in k), default=0.0)
    print(
        f"  {seconds:.0f} s in all, {1e3 * seconds / path_length(run):.0f} s/km; peak memory "
        f"{memory:.0f} MB; largest violation {worst:.1e}",
        flush=True,
    )
    law, times = result.setup.starts[0]
    setup = replace(result.setup, inputs=law, t=np.arange(0.0, times[-1], 1.0))
    print(f"  follow {words(integrate(setup, problem.spec.solver.options, Watch()))}", flush=True)


def main() -> None:
    """Print the table."""
    heading()
    context = multiprocessing.get_context("spawn")
    for name in GOALS:
        process = context.Process(target=planned, args=(name,))
        process.start()
        process.join()


if __name__ == "__main__":
    main()
