"""Facts for the summaries of motions of all kinds: pairs of a name and a text."""

from __future__ import annotations

import numpy as np

from slipfree.core.trajectory import Trajectory, outcome_words

Lines = list[tuple[str, str]]


def ranges(run: Trajectory) -> Lines:
    """Return the facts about the range of every quantity over time and wheels.

    On a ground without a friction coefficient, ``utilisation`` equals ``friction_needed`` and is
    omitted.
    """
    facts = []
    for name, column in run.columns.items():
        if name == "utilisation" and not has_friction(run):
            continue
        low, high = (float(end.reduce(column.values, axis=None)) for end in (np.fmin, np.fmax))
        unit = column.label.unit
        span = _number(low) if low == high else f"{_number(low)} to {_number(high)}"
        facts.append((name, span if unit == "1" or np.isinf(low) else f"{span} {unit}"))
    return facts


def _number(value: float) -> str:
    return "infinite" if np.isinf(value) else f"{value:.6g}"


def has_friction(run: Trajectory) -> bool:
    """Return whether the ground of a motion has a friction coefficient, according to its result."""
    given = "ground_friction" in run.attributes
    return given or not np.array_equal(run["utilisation"], run["friction_needed"])


def plain_facts(run: Trajectory) -> Lines:
    """Return the facts about duration and cost of a motion."""
    return [duration_fact(run), integrator_fact(run)]


def outcome_fact(run: Trajectory) -> tuple[str, str]:
    """Return the fact about the outcome of a motion, the first line of every summary."""
    return "outcome", outcome_words(run)


def duration_fact(run: Trajectory) -> tuple[str, str]:
    """Return the fact about duration and number of samples of a motion."""
    return "duration", f"{run.t[-1] - run.t[0]:g} s, {run.t.size} samples"


def integrator_fact(run: Trajectory) -> tuple[str, str]:
    """Return the fact about the cost of the integration."""
    counts = run.statistics
    if "steps" not in counts:
        return "integrator", "not used"
    return (
        "integrator",
        f"{counts['steps']:.0f} steps, {counts['residuals']:.0f} evaluations, "
        f"{counts['cpu_seconds']:.3g} s CPU, tolerance {counts['tolerance']:g}",
    )
