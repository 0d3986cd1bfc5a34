"""Lines of the summary of inverse kinematics."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slipfree.core.facts import starting_with
from slipfree.core.records import Mask
from slipfree.core.trajectory import Trajectory
from slipfree.models.given_rates import COMMANDS
from slipfree.models.inverse import steering_note

ROUND_TRIP, REPLAY = "round_trip_", "replay_"  # beginnings of the names of differences
METHOD, COLLOCATION = "solved_by", "collocation"  # attribute of a result, and one of its values
STEERED = 0.02  # largest error of a steering coordinate at its target [rad, m]
CHECKS = (
    "margin",
    "round trip",
    "replay by the direct model",
    "replay stopped early",
    "collocation",
)  # facts about accuracy and validity


def is_collocated(run: Trajectory) -> bool:
    """Return whether the steering of a motion was computed by collocation."""
    return run.attributes.get(METHOD) == COLLOCATION


def steering_warning(run: Trajectory) -> str:
    """Return the warning about an unstable integrated steering; empty if it is stable."""
    if "steering_growth" not in run.columns or is_collocated(run):
        return ""
    return steering_note(run)


def inverse_lines(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield the lines of an inverse motion: rates, steering, margin and errors."""
    commanded = [name for name in COMMANDS if f"{name}_error" in run.columns]
    for wheel in run.wheels:
        if (name := f"{wheel}_rate") in run.columns:
            first, last = run[name][[0, -1]]
            yield f"rate of wheel {wheel}", f"{first:.6g} at the start, {last:.6g} rad/s at the end"
    for name in ("steer", "steer_rate"):
        if name in run.columns:
            low, high, unit = run[name].min(), run[name].max(), run.columns[name].label.unit
            words = "steering angle" if unit == "rad" else "steering rate"
            yield words, f"{low:.6g} to {high:.6g} {unit.replace(' s-1', '/s')}"
    if "inverse_margin" in run.columns:
        margin = run["inverse_margin"]
        worst = int(margin.argmin())
        words = run.columns["inverse_margin"].label.words
        yield "margin", f"{margin[worst]:.4g} at least (t = {run.t[worst]:.4g} s): {words}"
    known = {*COMMANDS, "path", "heading"}
    held = run.facts["held_at_stop"].value if "held_at_stop" in run.facts else ()
    steered = [name for name in run if f"{name}_error" in run.columns and name not in known]
    for name in steered:
        low, high, off = run[name].min(), run[name].max(), np.abs(run[f"{name}_error"]).max()
        unit = run.columns[name].label.unit
        at_stop = "; reaches its stop" if name in held else ""
        words = f"{low:.6g} to {high:.6g} {unit}, off by {off:.1e} {unit} at most{at_stop}"
        yield f"steering {name}", words
    errors = [np.abs(run[f"{name}_error"]) for name in steered]
    is_turning = np.max([np.zeros(run.t.size), *errors], axis=0) > STEERED
    for name in commanded:
        yield f"error of {name}", _largest_error(run, f"{name}_error", is_turning)
    for name in ("path_error", "heading_error"):
        if name in run.columns:
            yield name.replace("_", " "), _largest_error(run, name)
    if "steering_slip" in run.columns:
        yield (
            "steering slip",
            f"{run['steering_slip'].max():.2e} m/s at most (steering lever times steering rate)",
        )
    if warning := steering_warning(run):
        yield "warning", warning
    trip = [gap.value for gap in starting_with(ROUND_TRIP, run.facts).values()]
    if trip:
        yield (
            "round trip",
            f"{max(trip):.1e} at most: difference of the platform rates from those of the direct "
            "model at the same wheel and joint rates",
        )


def _largest_error(run: Trajectory, name: str, is_turning: Mask | None = None) -> str:
    """Return a text about the absolute error of a command or path.

    The text contains the largest error and its time. For a path, where errors accumulate, it adds
    the error at the end. For a command, it adds the largest error while the steering is at its
    target, if the steering is off its target at some samples.

    Parameters
    ----------
    run : Trajectory
        The motion.
    name : str
        Name of the error in the motion.
    is_turning : ndarray of bool, shape (n,), or None
        Whether the steering is off its target, by sample; None for a path.
    """
    error, unit = np.abs(run[name]), run.columns[name].label.unit.replace(" s-1", "/s")
    worst = int(error.argmax())
    words = f"{error[worst]:.1e} {unit} at most (t = {run.t[worst]:.4g} s)"
    if is_turning is None:
        return f"{words}, {error[-1]:.1e} {unit} at the end"
    if is_turning.all():
        return f"{words}; the steering is never within {STEERED:g} rad of its target"
    if is_turning.any():
        return f"{words}, {error[~is_turning].max():.1e} {unit} while the steering is at its target"
    return words


def collocation_line(run: Trajectory) -> tuple[str, str]:
    """Return the line about the cost of the collocation along a path."""
    counts = run.statistics
    return (
        "collocation",
        f"{counts['elements']:.0f} elements of degree {counts['degree']:.0f}, "
        f"{counts['cpu_seconds']:.3g} s CPU, steering error {counts['sought_error']:.1e} rad",
    )


def replay_lines(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield the lines about the differences of the replay by the direct model, if computed."""
    gaps = starting_with(REPLAY, run.facts)
    listed = ", ".join(f"{name} {gap.value:.1e} {gap.unit}" for name, gap in gaps.items())
    if gaps:
        yield "replay by the direct model", f"differs by at most {listed}"
    if "stopped_replay" in run.facts:
        yield "replay stopped early", run.facts["stopped_replay"].value
