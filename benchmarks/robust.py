"""Measure robust plans: share of drawn worlds on which a plan holds, and change of cost.

``python benchmarks/robust.py`` plans ``problems/plan_crater_field.toml``, with a limit of the
utilisation, and ``problems/plan_climb_ramp.toml``. The worlds have errors of the heights with a
correlation length of 1 m, errors of the friction, and inexact gains of the inputs. In each round,
50 draws tighten the limits; 200 other draws, equal for both plans, give the shares.
"""

from __future__ import annotations

import time
from pathlib import Path

from reference import heading

from slipfree import load_problem, run_problem

PROBLEMS = Path(__file__).parents[1] / "problems"
DRAWN = "friction={friction}, inputs={inputs}, map={{rms={rms}, correlation=1.0}}"
WIDE = ("terrain.synthetic.x=[-8.0, 8.0]",)  # room for the detours of the ramp
CASES = (
    ("plan_crater_field", 0.05, 0.01, 0.02, ("limits.utilisation=[0.0, 0.5]",)),
    ("plan_climb_ramp", 0.02, 0.002, 0.002, WIDE),
    ("plan_climb_ramp", 0.05, 0.01, 0.005, WIDE),
)


def main() -> None:
    """Print the table."""
    heading()
    for name, friction, inputs, rms, settings in CASES:
        drawn = DRAWN.format(friction=friction, inputs=inputs, rms=rms)
        problem = load_problem(PROBLEMS / f"{name}.toml", (*settings, f"plan.robust={{{drawn}}}"))
        begin = time.perf_counter()
        run = run_problem(problem).trajectory
        print(f"{name}, {drawn}: {run.outcome.title}, {time.perf_counter() - begin:.0f} s")
        for line in run.attributes["plan_robust"].splitlines():
            print(f"  {line}", flush=True)


if __name__ == "__main__":
    main()
