"""Summary of a climb in a few lines, from its samples and averages."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slipfree.climb.plan_tracking import MIN_SPEED
from slipfree.problem.summary import duration_fact
from slipfree.trajectory import Trajectory

ENDING = "climb"  # attribute of a result with the end of the climb
SLOW_CLIMB = "slow_climb"  # attribute with the friction that a quasi-static climb needs
UNBALANCED = 1e-3  # largest unreported error of the energy balance, relative to the motors' work

AVERAGES = {
    "slip": "slip, eq. (20)",
    "true_slip": "true slip",
    "disturbance": "disturbance, eq. (21)",
}
SHARES = {"bearing": "share of the load", "effort": "share of the torques"}
WINDOW = (
    "50 ms before the front wheels first touch the obstacle to {} the rear axle is up; eq. (20) "
    "uses the middle axle's speed for all axles, so that rolling wheels also have slip"
)


def climb_facts(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield the facts of the summary of a climb, pairs of name and text."""
    yield "climb", run.attributes[ENDING]
    yield duration_fact(run)
    tilts = ", ".join(
        f"{name} body {run[f'tilt_{name}'].min():.3f} to {run[f'tilt_{name}'].max():.3f}"
        for name in ("rear", "front")
    )
    yield "tilts, nose up", f"{tilts} rad"
    yield from _averages(run)
    yield from _planned(run)
    yield "slow climb", _slippery(run)
    yield "energy", _energy(run)
    yield "integrator", _cost(run)


def _averages(run: Trajectory) -> Iterator[tuple[str, str]]:
    counts = run.statistics
    if "climb_from" not in counts:
        yield "averages", "none: the front wheels touched only the floor"
        return
    last = "100 ms after" if counts["climb_up"] else "the end, before"
    yield (
        "averages",
        f"of absolute values, t = {counts['climb_from']:.3f} to {counts['climb_to']:.3f} s: from "
        f"{WINDOW.format(last)}",
    )
    for measure, words in (AVERAGES | SHARES).items():
        values = {axle: counts[f"climb_{measure}_{axle}"] for axle in reversed(run.wheels)}
        listed = ", ".join(f"{axle} {100 * value:.1f} %" for axle, value in values.items())
        mean = f"; mean {100 * np.mean(list(values.values())):.1f} %"
        yield f"  {words}", listed + (mean if measure in AVERAGES else "")
    yield "  motors", f"at their limit {100 * counts['climb_limited']:.1f} % of the time"


def _planned(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield the facts of a plan, and the duration of its tracking; nothing without a plan."""
    counts = run.statistics
    if "climb_plan_duration" not in counts:
        return
    yield (
        "plan",
        f"{counts['climb_plan_duration']:.3g} s from the first contact on, at rest at each contact "
        f"with a solid; uses a coefficient of {counts['climb_plan_friction']:.3f}; "
        f"{counts['climb_plan_iterations']:.0f} iterations, {counts['climb_plan_seconds']:.2g} s",
    )
    least = [value for name, value in counts.items() if name.startswith("climb_plan_least_")]
    yield "  least friction", "by leg " + ", ".join(f"{value:.3f}" for value in least)
    took = f"{counts['climb_plan_driven']:.3g} s" if "climb_plan_driven" in counts else "not done"
    yield "  tracked", f"{took}; tracking is not slower than {MIN_SPEED:g} m/s, a plan may be"


def _slippery(run: Trajectory) -> str:
    """Return the description of the friction that a quasi-static climb needs."""
    words = run.attributes.get(SLOW_CLIMB, "not computed")
    if "slow_climb_friction" not in run.statistics:
        return words
    return f"{words}; available: {run.attributes['friction']}"


def _energy(run: Trajectory) -> str:
    work, lost = (run[name] - run[name][0] for name in ("work", "lost_energy"))
    gained = run["energy"] - run["energy"][0]
    missed = float(np.abs(gained - work + lost).max())
    poor = "; this error is large: reduce solver.tolerance or contact.stiffness"
    return (
        f"motors {work[-1]:.4g} J, lost to friction and damping {lost[-1]:.3g} J, gained "
        f"{gained[-1]:.4g} J; balance within {missed:.1e} J"
        + (poor if missed > UNBALANCED * abs(work[-1]) else "")
    )


def _cost(run: Trajectory) -> str:
    counts, duration = run.statistics, run.t[-1] - run.t[0]
    return (
        f"{counts['steps']:.0f} steps, {counts['residuals']:.0f} evaluations, "
        f"{counts['cpu_seconds']:.3g} s CPU, {duration / counts['cpu_seconds']:.3g} x real time, "
        f"tolerance {counts['tolerance']:g}"
    )
