"""Measure plans updated while the vehicle moves: time per cycle, and additional slip.

``python benchmarks/horizon.py`` drives the three-wheeler of `plan.py` over the hills with a moving
horizon of 20 intervals of degree 3, from the start of a plan of 50 intervals and from a few
centimetres beside it. Between cycles the model is simulated. Slip is the root mean square over time
and wheels; the first row is the simulation of the plan.

A second table shows the time of one cycle over the number of intervals.
"""

from __future__ import annotations

import time
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from reference import heading

from plan import DURATION, GOAL, hills, planned, rms_slip
from slipfree import Analytic, settle, simulate
from slipfree.plan.mpc import Cycle, Horizon, cycle_inputs, first_cycle, horizon, replan
from slipfree.plan.plan import Plan
from slipfree.trajectory import joined

SPAN, INTERVALS = 8.0, 20  # of the window [s]
CYCLES, SAMPLES = 50, 3
STARTS = ({}, {"x": 0.03, "y": -0.03, "heading": 0.02}, {"x": -0.03, "heading": -0.03})
SIZES = (20, 40, 80)


class Drive(NamedTuple):
    """Driven motion: rms slip [m/s], distance from the goal [m], times of the cycles [s]."""

    slip: float
    away: float
    seconds: np.ndarray
    violation: float


def drive(found: Plan, window: Horizon, start: dict[str, float]) -> Drive:
    """Return the motion driven with a moving horizon."""
    dae, cycle = found.program.task.dae, first_cycle(window)
    here, seconds, runs, violations = settle(dae, **start), [], [], []
    for t, end in pairwise(np.linspace(0, DURATION, CYCLES + 1)):
        x, clock = dae.rows("x", here, -1), time.perf_counter()
        cycle = replan(window, cycle, t, x)
        seconds.append(time.perf_counter() - clock)
        violations.append(cycle.violation)
        here = between(dae, here, window, cycle, (t, end))
        runs.append(here)
    slip = np.sqrt(np.mean([rms_slip(run) ** 2 for run in runs]))
    away = np.hypot(here["x"][-1] - GOAL[0], here["y"][-1] - GOAL[1])
    return Drive(slip, away, np.array(seconds), max(violations))


def between(dae: Any, here: Any, window: Horizon, cycle: Cycle, span: tuple[float, float]) -> Any:
    """Return the motion from one cycle to the next, as samples of its slip."""
    parts = []
    for first, last in pairwise(np.linspace(*span, SAMPLES + 1)):
        here = simulate(dae, here, *cycle_inputs(window, cycle, first, last))
        parts.append(here)
    return joined(*(part.part(slice(-1)) for part in parts[:-1]), parts[-1])


def table(found: Plan) -> None:
    """Print slip and times of driven motions."""
    print(
        f"{INTERVALS} intervals of degree 3 over {SPAN:g} s, {CYCLES} cycles of "
        f"{DURATION / CYCLES:g} s"
    )
    print(
        f"{'':49}rms slip   from goal  largest    ms a cycle\n"
        f"{'':49}[m/s]      [mm]       violation  median, 95 %"
    )
    away = np.hypot(found.replay["x"][-1] - GOAL[0], found.replay["y"][-1] - GOAL[1])
    print(f"{'the plan':49}{rms_slip(found.replay):.3e}  {1e3 * away:9.4f}")
    for start in STARTS:
        where = ", ".join(f"{name} {value:+g}" for name, value in start.items()) or "on the plan"
        for words, iterations in (("one step", 1), ("to convergence", 100)):
            window = horizon(found, span=SPAN, intervals=INTERVALS, iterations=iterations)
            made = drive(found, window, start)
            median, most = 1e3 * np.quantile(made.seconds, (0.5, 0.95))
            print(
                f"{where + ': ' + words:49}{made.slip:.3e}  {1e3 * made.away:9.4f}  "
                f"{made.violation:.1e}    {median:6.1f} {most:6.1f}"
            )


def growth(found: Plan) -> None:
    """Print the time of a cycle over the number of intervals."""
    print("intervals  ms a cycle, median of 20")
    for size in SIZES:
        window = horizon(found, span=DURATION, intervals=size)
        cycle, seconds = first_cycle(window), []
        x = found.program.task.start
        for number in range(20):
            moved = x + 0.01 * (-1) ** number  # [m, rad]: else there would be nothing to do
            clock = time.perf_counter()
            cycle = replan(window, cycle, 0.0, moved)
            seconds.append(time.perf_counter() - clock)
        print(f"{size:9}  {1e3 * np.median(seconds):6.1f}")


def main() -> None:
    """Print all tables."""
    heading()
    found, _ = planned(Analytic(hills), intervals=50, continuous=True, compiled=True)
    print()
    table(found)
    print()
    growth(found)


if __name__ == "__main__":
    main()
