"""Compare the best of four starts with a single start, on hills and among obstacles.

``python benchmarks/starts.py [hills|obstacles]`` prints rows for ten seeds, and the medians.

- ``hills``: the ground of ``problems/plan_rigid_hills.toml``, twice as rough and with a farther
  goal; no obstacles.
- ``obstacles``: the three-wheeler of ``problems/plan_crater_field.toml`` over 20 m of hills with
  eight keep-out discs; the additional starts are routes of other homotopy classes.

Slip is the slip path in the simulation, per wheel and metre driven.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slipfree import load_problem, run_problem
from slipfree.outcome import Outcome
from slipfree.trajectory import path_length

PROBLEMS = Path(__file__).parents[1] / "problems"
STARTS, TERRAINS, DISCS = 4, 10, 8
ROUGHER = (
    "terrain.synthetic.power_law.rms=0.2",
    "terrain.synthetic.power_law.shortest=1.5",
    "goal={x=1.5, y=4.0}",
    "inputs=",
    "driver={name='route', speed=0.2, turning_radius=1.0}",
    "time.duration=40.0",
    "plan.intervals=25",
)
FIELD = (
    "terrain.synthetic.craters=",
    "terrain.synthetic.power_law.rms=0.2",
    "goal={x=20.0, y=25.0}",
    "driver.turning_radius=2.0",
    "plan.intervals=30",
    "plan.accuracy=5e-3",
)


class Row(NamedTuple):
    """Outcome, cost, slip [mm per wheel and m], wall time [s], and the table of starts."""

    outcome: Outcome
    cost: float
    slip: float
    seconds: float
    table: str


def problem_of(kind: str, seed: int, starts: int):
    """Return the problem of a kind and a seed."""
    more = (f"terrain.synthetic.power_law.seed={seed}", f"plan.starts={starts}")
    if kind == "hills":
        return load_problem(PROBLEMS / "plan_rigid_hills.toml", (*ROUGHER, *more))
    rng = np.random.default_rng(seed)
    places = rng.uniform([12, 11, 0.3], [28, 21, 1.2], (DISCS, 3)).round(3)
    discs = ", ".join(f"{{x={x}, y={y}, radius={radius}}}" for x, y, radius in places)
    return load_problem(PROBLEMS / "plan_crater_field.toml", (*FIELD, *more, f"keep_out=[{discs}]"))


def solved(kind: str, seed: int, starts: int) -> Row:
    """Return the plan on a terrain."""
    problem = problem_of(kind, seed, starts)
    begin = time.perf_counter()
    run = run_problem(problem).trajectory
    seconds = time.perf_counter() - begin
    weights = {**problem.spec.costs, "smoothness": problem.spec.plan.smooth}
    cost = sum(weights[name] * run.statistics[f"plan_cost_{name}"] for name in weights)
    slip = np.trapezoid(np.hypot(run["slip_along"], run["slip_across"]), run.t, axis=0).mean()
    table = run.attributes.get("plan_starts", "")
    return Row(run.outcome, cost, 1e3 * slip / path_length(run), seconds, table)


def words(row: Row) -> str:
    """Return a plan as text."""
    return (
        f"{row.outcome.name.lower()}, cost {row.cost:.4f}, slip {row.slip:.3f} mm/m, "
        f"{row.seconds:.0f} s"
    )


def compare(kind: str) -> None:
    """Print the table of a kind of terrain."""
    found = []
    for seed in range(1, TERRAINS + 1):
        one, several = solved(kind, seed, 1), solved(kind, seed, STARTS)
        optima, *rows = several.table.splitlines()
        print(f"{kind}, seed {seed}: one start {words(one)}", flush=True)
        print(f"  best of {STARTS} {words(several)}", flush=True)
        names = ", ".join(row.partition(", cost")[0] for row in rows)
        print(f"  {optima}, the best first: {names}", flush=True)
        found.append([several[k] / one[k] for k in (1, 2, 3)])
    cost, slip, seconds = np.array(found).T
    print(
        f"{kind}, best of {STARTS} over one start: cheaper on {int((cost < 0.999).sum())} of "
        f"{len(found)}; cost {cost.min():.3f} to {cost.max():.3f}, median {np.median(cost):.3f}; "
        f"slip {slip.min():.3f} to {slip.max():.3f}, median {np.median(slip):.3f}; "
        f"time median {np.median(seconds):.1f}"
    )


if __name__ == "__main__":
    for name in sys.argv[1:] or ("hills", "obstacles"):
        compare(name)
