"""What to tell about a motion in a few lines."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slipfree.contact.certify import NONE
from slipfree.trajectory import Trajectory, path_length

UNIQUE = ("clearance", "relative_curvature")  # what certifies that every wheel touches once
Facts = list[tuple[str, str]]


def motion_facts(run: Trajectory) -> Facts:
    """Return name and value of what matters about a motion, ready to print."""
    return [*_way(run), *_slip(run), *_tilt(run), *_trust(run), *_cost(run)]


def ranges(run: Trajectory) -> Facts:
    """Return every quantity with its range, over the wheels as well."""
    facts = []
    for name, column in run.columns.items():
        low, high, unit = column.values.min(), column.values.max(), column.label.unit
        span = f"{low:.6g}" if low == high else f"{low:.6g} to {high:.6g}"
        facts.append((name, span if unit == "1" else f"{span} {unit}"))
    return facts


def _way(run: Trajectory) -> Iterator[tuple[str, str]]:
    duration, z = run.t[-1] - run.t[0], run["z"]
    yield "duration", f"{duration:g} s, {run.t.size} samples"
    yield "path length", f"{path_length(run):.6g} m"
    yield "height along the path", f"{z.min():.4f} to {z.max():.4f} m"
    place = ", ".join(f"{name} {run[name][-1]:.3f} m" for name in "xyz")
    yield "end place", place
    angles = ", ".join(f"{name} {run[name][-1]:.6g} rad" for name in ("heading", "pitch", "roll"))
    yield "end attitude", f"{angles} (yaw from the x axis {run['yaw'][-1]:.6g} rad)"


def _slip(run: Trajectory) -> Iterator[tuple[str, str]]:
    yield "least slip", "what kinematics allows: a lower bound, not a prediction"
    for wheel in run.wheels:
        along, across = run["slip_along", wheel], run["slip_across", wheel]
        rms = np.sqrt(np.mean(along**2 + across**2))
        yield (
            f"  wheel {wheel}",
            f"largest along {np.abs(along).max():.2e}, across {np.abs(across).max():.2e}, "
            f"rms {rms:.2e} m/s",
        )


def _tilt(run: Trajectory) -> Iterator[tuple[str, str]]:
    largest = {name: np.abs(run[name]).max() for name in ("pitch", "roll")}
    largest |= {
        name: np.abs(run[name]).max()
        for name in run
        if name.startswith("tilt_") and not name.endswith(("_rate", "_stop"))
    }
    yield "largest angles", ", ".join(f"{name} {value:.4g} rad" for name, value in largest.items())


def _trust(run: Trajectory) -> Iterator[tuple[str, str]]:
    if "drift_position" in run.columns:
        drift, turned = (run[f"drift_{name}"].max() for name in ("position", "rotation"))
        yield "drift of the assembly", f"{drift:.2e} m, {turned:.2e} rad at most"
    else:
        yield "closure residual", f"{run['closure_residual'].max():.2e} m at most"
        step, tolerance = run["newton_step"].max(), run.statistics.get("tolerance")
        of_it = f", {step / tolerance:.3g} x the tolerance" if tolerance else ""
        yield "Newton step", f"{step:.2e} m at most{of_it}"
    yield "singular value", f"{run['singular_value'].min():.4g} at least"
    yield "contact certificate", certificate(run)


def certificate(run: Trajectory) -> str:
    """Return whether every wheel touched the ground at one point only, and by what margin."""
    clearance, curvature = (run[name].min() for name in UNIQUE)
    clean = "clean" if min(clearance, curvature) >= 0 else "broken"
    if run.stop is not None and run.stop.name.partition("[")[0] in UNIQUE:
        clean += " up to the stop"
    room = "more than a metre" if clearance >= NONE else f"{clearance:.4g} m at least"
    return (
        f"{clean}: clearance beside the contacts {room}, relative curvature {curvature:.4g} 1/m "
        f"at least; looked at every {_apart(run):.3g} m or less"
    )


def _apart(run: Trajectory) -> float:
    """Return the largest distance between the platform's places at two samples [m]."""
    steps = np.hypot(np.diff(run["x"]), np.diff(run["y"]))
    return float(steps.max(initial=0.0))


def _cost(run: Trajectory) -> Iterator[tuple[str, str]]:
    counts = run.statistics
    if "steps" not in counts:
        yield "integrator", "not used"
        return
    yield (
        "integrator",
        f"{counts['steps']:.0f} steps, {counts['residuals']:.0f} evaluations, "
        f"{counts['cpu_seconds']:.3g} s CPU, tolerance {counts['tolerance']:g}",
    )
    if run.stop is None:
        yield "end", "reached the time asked for"
    else:
        yield "stopped early", f"at {run.stop.t:.6g} s by {run.stop.name}: {run.stop.words}"
