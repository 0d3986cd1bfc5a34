"""Facts of the summary of a plan."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slipfree.trajectory import PLAN, Trajectory, path_length

ROBUST = "robust plan"
IN_SOIL = "simulated with inertia"
MOMENTUM, SLOWLY = "simulated with compliant contacts", "driven slowly"
CHECKS = (
    "simulated",
    "optimality",
    ROBUST,
    MOMENTUM,
    SLOWLY,
    "simulated with friction",
    IN_SOIL,
    "with wheels ten times stiffer",
)  # facts about accuracy and validity


def plan_facts(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield the facts of a plan: costs, differences of its simulation, slip, friction."""
    counts = run.statistics
    costs = {
        name.removeprefix("plan_cost_"): value
        for name, value in counts.items()
        if name.startswith("plan_cost_")
    }
    solved = run.stop is None or run.stop.name != PLAN
    plan = "plan" if solved else "iterate"
    yield (
        plan,
        ", ".join(f"{name} {value:.6g}" for name, value in costs.items())
        + (
            f"; {counts['plan_iterations']:.0f} iterations, {counts['plan_seconds']:.3g} s, "
            f"of which {counts['plan_seconds_functions']:.3g} s in functions"
        ),
    )
    if "plan_turns" in run.attributes:
        yield "whole turns", run.attributes["plan_turns"]
    if "plan_windows" in run.attributes:
        yield "windows", run.attributes["plan_windows"]
    if "plan_starts" in run.attributes:
        head, *rows = run.attributes["plan_starts"].splitlines()
        yield "starts", head
        yield from ((f"  {row.partition(': ')[0]}", row.partition(": ")[2]) for row in rows)
    gaps = [
        (name.removeprefix("plan_difference_"), size)
        for name, size in counts.items()
        if name.startswith("plan_difference_")
    ]
    listed = ", ".join(f"{name} {size:.1e} {run.columns[name].label.unit}" for name, size in gaps)
    violated = run.attributes.get("plan_violations", "")
    kept = f"; violates {violated}" if violated else "; meets all constraints"
    if not solved:
        kept = ""  # the outcome names the violations
    if not gaps:
        yield "simulated", "not yet; the motion is that of the plan"
    else:
        yield "simulated", f"differs from the {plan} by at most {listed}{kept}"
    if "plan_optimality" in run.attributes:
        yield "optimality", run.attributes["plan_optimality"]
        yield "prices of limits", run.attributes["plan_prices"]
    if "plan_robust" in run.attributes:
        first, *rest = (line.partition(": ") for line in run.attributes["plan_robust"].splitlines())
        yield first[0], first[2]
        yield from ((f"  {name}", words) for name, _, words in rest)
    slip = np.hypot(run["slip_along"], run["slip_across"])
    duration, length = run.t[-1] - run.t[0], path_length(run)
    total = np.trapezoid(slip, run.t, axis=0)
    squares = np.trapezoid(slip**2, run.t, axis=0)
    yield (
        f"slip of the {plan}",
        f"rms {np.sqrt(squares.mean() / duration):.3g} m/s per wheel, "
        f"{1e3 * total.mean() / length:.3g} mm per wheel and metre",
    )
    if "plan_replay" in run.attributes:
        yield MOMENTUM, run.attributes["plan_replay"]
    if "plan_slow" in run.attributes:
        yield SLOWLY, run.attributes["plan_slow"]
    if "by_friction" in run.attributes:
        yield "simulated with friction", run.attributes["by_friction"]
    if "in_soil" in run.attributes:
        yield IN_SOIL, run.attributes["in_soil"]
    if "by_stiffness" in run.attributes:
        yield "with wheels ten times stiffer", run.attributes["by_stiffness"]
