"""Summary of a plan."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slipfree.trajectory import Trajectory, path_length

ROUNDING = 1e-6  # of a limit that a plan keeps to, in its unit
CHECKS = ("simulated", "driven by friction")  # facts about accuracy and validity


def plan_facts(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield what a plan promised, and how the simulated motion differs from it."""
    counts = run.statistics
    costs = {
        name.removeprefix("plan_cost_"): value
        for name, value in counts.items()
        if name.startswith("plan_cost_")
    }
    yield (
        "plan",
        ", ".join(f"{name} {value:.6g}" for name, value in costs.items())
        + (
            f"; {counts['plan_iterations']:.0f} iterations, {counts['plan_seconds']:.3g} s, of it "
            f"{counts['plan_seconds_functions']:.3g} s in functions"
        ),
    )
    gaps = [
        (name.removeprefix("plan_difference_"), size)
        for name, size in counts.items()
        if name.startswith("plan_difference_")
    ]
    listed = ", ".join(f"{name} {size:.1e} {run.columns[name].label.unit}" for name, size in gaps)
    over = [
        f"{name.removeprefix('plan_violation_')} by {size:.1e}"
        for name, size in counts.items()
        if name.startswith("plan_violation_") and size > ROUNDING
    ]
    kept = f"; it goes beyond {', '.join(over)}" if over else "; it keeps to all limits"
    if run.stop is not None and run.stop.name == "plan":
        kept = ""  # which limits matter the reasons say
    yield "simulated", f"differs from the plan by at most {listed}{kept}"
    slip = np.hypot(run["slip_along"], run["slip_across"])
    duration, length = run.t[-1] - run.t[0], path_length(run)
    total = np.trapezoid(slip, run.t, axis=0)
    squares = np.trapezoid(slip**2, run.t, axis=0)
    yield (
        "slip of the plan",
        f"rms {np.sqrt(squares.mean() / duration):.3g} m/s a wheel, "
        f"{1e3 * total.mean() / length:.3g} mm a wheel and metre",
    )
    if "by_friction" in run.attributes:
        yield "driven by friction", run.attributes["by_friction"]
