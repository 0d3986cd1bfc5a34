"""Best of four starts against a single start, on ten terrains: cost, slip and time.

``python benchmarks/starts.py`` prints rows for ten seeds of the ground of
``problems/plan_rigid_hills.toml``, twice as rough and with a farther goal, and the medians.
Slip is that of the simulation, its path per wheel and metre driven.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slipfree import load_problem, run_problem
from slipfree.outcome import Outcome
from slipfree.trajectory import path_length

PROBLEM = Path(__file__).parents[1] / "problems" / "plan_rigid_hills.toml"
STARTS, TERRAINS = 4, 10
ROUGHER = (
    "terrain.synthetic.power_law.rms=0.2",
    "terrain.synthetic.power_law.shortest=1.5",
    "goal={x=1.5, y=4.0}",
    "inputs=",
    "driver={name='route', speed=0.2, turning_radius=1.0}",
    "time.duration=40.0",
    "plan.intervals=25",
)


class Row(NamedTuple):
    """Outcome, cost, slip [mm per wheel and m], wall time [s], and the table of starts."""

    outcome: Outcome
    cost: float
    slip: float
    seconds: float
    table: str


def solved(seed: int, starts: int) -> Row:
    """Return the plan on a terrain."""
    settings = (*ROUGHER, f"terrain.synthetic.power_law.seed={seed}", f"plan.starts={starts}")
    problem = load_problem(PROBLEM, settings)
    begin = time.perf_counter()
    run = run_problem(problem).trajectory
    seconds = time.perf_counter() - begin
    weights = {**problem.spec.costs, "smoothness": problem.spec.plan.smooth}
    cost = sum(weights[name] * run.statistics[f"plan_cost_{name}"] for name in weights)
    slip = np.trapezoid(np.hypot(run["slip_along"], run["slip_across"]), run.t, axis=0).mean()
    table = run.attributes.get("plan_starts", "")
    return Row(run.outcome, cost, 1e3 * slip / path_length(run), seconds, table)


def words(row: Row) -> str:
    """Return a plan in words."""
    return (
        f"{row.outcome.name.lower()}, cost {row.cost:.4f}, slip {row.slip:.3f} mm/m, "
        f"{row.seconds:.0f} s"
    )


def main() -> None:
    """Print the table."""
    found = []
    for seed in range(1, TERRAINS + 1):
        one, several = solved(seed, 1), solved(seed, STARTS)
        optima, best = several.table.splitlines()[:2]
        print(f"seed {seed}: one start {words(one)}", flush=True)
        print(f"  best of {STARTS} {words(several)}", flush=True)
        print(f"  {optima}; the best from '{best.partition(':')[0]}'", flush=True)
        found.append([several[k] / one[k] for k in (1, 2, 3)])
    cost, slip, seconds = np.array(found).T
    print(
        f"best of {STARTS} over one start: cheaper on {int((cost < 0.999).sum())} of {len(found)}; "
        f"cost {cost.min():.3f} to {cost.max():.3f}, median {np.median(cost):.3f}; "
        f"slip {slip.min():.3f} to {slip.max():.3f}, median {np.median(slip):.3f}; "
        f"time median {np.median(seconds):.1f}"
    )


if __name__ == "__main__":
    main()
