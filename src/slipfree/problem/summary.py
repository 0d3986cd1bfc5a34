"""What to tell about a motion in a few lines."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slipfree.contact.certify import NONE
from slipfree.frames import to_problem_frame
from slipfree.models.given_rates import COMMANDS
from slipfree.models.inverse import steering_note
from slipfree.problem.verbs.climb_summary import climb_facts, is_climb
from slipfree.records import Mask
from slipfree.trajectory import Trajectory, path_length

UNIQUE = ("clearance", "relative_curvature")  # what certifies that every wheel touches once
ROUNDING = 1e-6  # of a limit that a plan keeps to, in its unit
STEERED = 0.02  # error of a steering angle within which it is at its target [rad, m]
Facts = list[tuple[str, str]]


def motion_facts(run: Trajectory) -> Facts:
    """Return name and value of what matters about a motion, ready to print."""
    if is_climb(run):
        return [*climb_facts(run)]
    run = to_problem_frame(run)
    return [
        *_way(run),
        *_inverse(run),
        *_planned(run),
        *_slip(run),
        *_tilt(run),
        *_forces(run),
        *_trust(run),
        *_cost(run),
        *_end(run),
    ]


def ranges(run: Trajectory) -> Facts:
    """Return every quantity with its range, over the wheels as well.

    Without friction of the ground ``utilisation`` is but ``friction_needed`` again, and left out.
    """
    facts = []
    for name, column in to_problem_frame(run).columns.items():
        if name == "utilisation" and not has_friction(run):
            continue
        low, high = (float(end.reduce(column.values, axis=None)) for end in (np.fmin, np.fmax))
        unit = column.label.unit
        span = f"{low:.6g}" if low == high else f"{low:.6g} to {high:.6g}"
        facts.append((name, span if unit == "1" else f"{span} {unit}"))
    return facts


def has_friction(run: Trajectory) -> bool:
    """Return whether the ground of a motion has friction, as far as its result tells."""
    given = "ground_friction" in run.attributes
    return given or not np.array_equal(run["utilisation"], run["friction_needed"])


def _way(run: Trajectory) -> Iterator[tuple[str, str]]:
    duration, z = run.t[-1] - run.t[0], run["z"]
    yield "duration", f"{duration:g} s, {run.t.size} samples"
    yield "path length", f"{path_length(run):.6g} m"
    yield "height along the path", f"{z.min():.4f} to {z.max():.4f} m"
    place = ", ".join(f"{name} {run[name][-1]:.3f} m" for name in "xyz")
    if "filled_ground" in run.attributes:
        yield "filled ground", run.attributes["filled_ground"]
    yield "end place", place
    angles = ", ".join(f"{name} {run[name][-1]:.6g} rad" for name in ("heading", "pitch", "roll"))
    yield "end attitude", f"{angles} (yaw from the x axis {run['yaw'][-1]:.6g} rad)"


def steering_warning(run: Trajectory) -> str:
    """Return the warning that the steering was integrated and is unstable; empty if not so."""
    if "steering_growth" not in run.columns or "elements" in run.statistics:
        return ""
    return steering_note(run)


def _inverse(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield what an inverse motion was sought for, and how well it is determined."""
    commanded = [name for name in COMMANDS if f"{name}_error" in run.columns]
    if "inverse_margin" not in run.columns and not commanded:
        return
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
    steered = [name for name in run if f"{name}_error" in run.columns and name not in known]
    for name in steered:
        low, high, off = run[name].min(), run[name].max(), np.abs(run[f"{name}_error"]).max()
        unit = run.columns[name].label.unit
        held = (
            "; held at its stop" if name in run.attributes.get("held_at_stop", "").split() else ""
        )
        words = f"{low:.6g} to {high:.6g} {unit}, off by {off:.1e} {unit} at most{held}"
        yield f"steering {name}", words
    errors = [np.abs(run[f"{name}_error"]) for name in steered]
    is_turning = np.max([np.zeros(run.t.size), *errors], axis=0) > STEERED
    for name in commanded:
        yield f"error of {name}", _largest_error(run, f"{name}_error", is_turning)
    for name in ("path_error", "heading_error"):
        if name in run.columns:
            yield name.replace("_", " "), _largest_error(run, name)
    if "steering_slip" in run.columns:
        yield "steering slip", f"{run['steering_slip'].max():.2e} m/s at most: lever times rate"
    if warning := steering_warning(run):
        yield "warning", warning
    trip = [size for name, size in run.statistics.items() if name.startswith("round_trip_")]
    if trip:
        yield (
            "round trip",
            f"{max(trip):.1e} at most: rates of the direct model at the samples, from those of "
            "wheels and joints",
        )


def _largest_error(run: Trajectory, name: str, is_turning: Mask | None = None) -> str:
    """Return the largest error and its time, and the largest with the steering at its target.

    Errors along a path accumulate: the last one instead.
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


def _planned(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield what a plan promised, and how the simulated motion differs from it."""
    counts = run.statistics
    if "plan_iterations" not in counts:
        return
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


def _is_quasi_static(run: Trajectory) -> bool:
    """Return whether a wheel-ground law determined a motion."""
    model = "quasi-static" if "friction_used_along" in run.columns else "kinematics"  # before 0.2
    return run.attributes.get("model", model) == "quasi-static"


def _law(run: Trajectory) -> str:
    """Return the name of the law that determined a motion; results before 0.2 do not have it."""
    return run.attributes.get("law", "coulomb" if _is_quasi_static(run) else "least")


def _slip(run: Trajectory) -> Iterator[tuple[str, str]]:
    law = _law(run)
    if _is_quasi_static(run):
        yield "slip", f"a quasi-static prediction by the wheel-ground law {law!r}"
    elif law == "least":
        yield "least slip", "what kinematics allows: a lower bound, not a prediction"
    else:
        yield "slip", f"of the slip law {law!r}, not a prediction"
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


def _forces(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield what the motion takes of the ground and of the drives, quasi-statically."""
    if "utilisation" not in run.columns:
        return
    yield "friction", friction_words(run)
    if "utilisation_best" in run.columns:
        best = run["utilisation_best"]
        if not np.isnan(best).all():
            k = int(np.nanargmax(best))
            yield "  best distribution", f"{best[k]:.4g} at most (t = {run.t[k]:.4g} s)"
    normal, margin = run["force_normal"], run["tip_over_margin"]
    yield "normal forces", f"{normal.min():.4g} to {normal.max():.4g} N"
    yield "tip-over margin", f"{margin.min():.4g} rad at least"
    torque = np.abs(run["drive_torque"]).max()
    gained = run["potential_energy"][-1] - run["potential_energy"][0]
    yield (
        "drives",
        f"torque {torque:.4g} N m at most, power {run['power'].max():.4g} W at most, work "
        f"{run['work'][-1] - run['work'][0]:.6g} J, potential energy gained {gained:.6g} J",
    )


def friction_words(run: Trajectory) -> str:
    """Return the largest use of friction, where and when, and what it means."""
    used = run["utilisation"]
    k, i = np.unravel_index(int(used.argmax()), used.shape)
    where = f"at most (wheel {run.wheels[i]}, t = {run.t[k]:.4g} s)"
    value = f"{used[k, i]:.4g}"
    if "ground_friction" not in run.attributes:
        return f"coefficient needed {value} {where}; the ground's is not given"
    words = f"utilisation {value} {where}, of a coefficient of {run.attributes['ground_friction']}"
    spread = " in the load-weighted distribution" if "utilisation_best" in run.columns else ""
    spread = f" by the law {_law(run)!r}" if _is_quasi_static(run) else spread
    return f"{words}{spread}" + ("" if used[k, i] <= 1 else "; friction does not hold this motion")


def _trust(run: Trajectory) -> Iterator[tuple[str, str]]:
    if "drift_position" in run.columns:
        drift, turned = (run[f"drift_{name}"].max() for name in ("position", "rotation"))
        yield "drift of the assembly", f"{drift:.2e} m, {turned:.2e} rad at most"
    else:
        yield "closure residual", f"{run['closure_residual'].max():.2e} m at most"
        step, tolerance = run["newton_step"].max(), run.statistics.get("tolerance")
        if "elements" in run.statistics:
            tolerance = None  # which was asked of the steering
        of_it = f", {step / tolerance:.3g} x the tolerance" if tolerance else ""
        yield "Newton step", f"{step:.2e} m at most{of_it}"
    yield "singular value", f"{np.fmin.reduce(run['singular_value']):.4g} at least"
    yield "contact certificate", certificate(run)
    yield from _missing(run)


def _missing(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield the diagnostics that did not converge, with the number of samples, or failed."""
    counts = {}
    for name, column in run.columns.items():
        unknown = np.isnan(column.values).reshape(run.t.size, -1).any(axis=1)
        counts[name] = int(unknown.sum())
    listed = [
        f"{name} at {count} of {run.t.size} samples" for name, count in counts.items() if count
    ]
    if listed:
        yield "not converged", ", ".join(listed)
    if "failed_diagnostics" in run.attributes:
        yield "diagnostics failed", run.attributes["failed_diagnostics"]


def certificate(run: Trajectory) -> str:
    """Return whether every wheel touched the ground at one point only, and by what margin."""
    clearance, curvature = (run[name].min() for name in UNIQUE)
    clean = "clean" if min(clearance, curvature) >= 0 else "broken"
    if run.stop is not None and run.stop.name.partition("[")[0] in UNIQUE:
        clean += " up to the stop"
    room = (
        "no second place where the ground comes near"
        if clearance >= NONE
        else f"clearance beside the contacts {clearance:.4g} m at least"
    )
    words = f"{clean}: {room}, relative curvature {curvature:.4g} 1/m at least"
    if run.t.size == 1:
        return words
    return f"{words}; a sample every {_apart(run):.3g} m of way or less"


def _apart(run: Trajectory) -> float:
    """Return the largest distance between the platform's places at two samples [m]."""
    steps = np.hypot(np.diff(run["x"]), np.diff(run["y"]))
    return float(steps.max(initial=0.0))


def _cost(run: Trajectory) -> Iterator[tuple[str, str]]:
    counts = run.statistics
    if "elements" in counts:
        yield from _collocated(run)
    elif "steps" not in counts:
        yield "integrator", "not used"
    else:
        yield (
            "integrator",
            f"{counts['steps']:.0f} steps, {counts['residuals']:.0f} evaluations, "
            f"{counts['cpu_seconds']:.3g} s CPU, tolerance {counts['tolerance']:g}",
        )
        yield from _replayed(run)


def _collocated(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield what the search along a path cost, and how far its replay is from it."""
    counts = run.statistics
    yield (
        "collocation",
        f"{counts['elements']:.0f} elements of degree {counts['degree']:.0f}, "
        f"{counts['cpu_seconds']:.3g} s CPU, steering to {counts['sought_error']:.1e} rad",
    )
    yield from _replayed(run)


def _replayed(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield how far a replay by the direct model is from the motion, if there was one."""
    gaps = {
        name.removeprefix("replay_"): size
        for name, size in run.statistics.items()
        if name.startswith("replay_")
    }
    listed = ", ".join(
        f"{name} {size:.1e} {run.columns[name].label.unit}" for name, size in gaps.items()
    )
    if gaps:
        yield "replay by the direct model", f"differs by at most {listed}"
    if "replay_stopped" in run.attributes:
        yield "replay stopped early", run.attributes["replay_stopped"]


def _end(run: Trajectory) -> Iterator[tuple[str, str]]:
    if run.stop is not None:
        yield "stopped early", f"at {run.stop.t:.6g} s by {run.stop.name}: {run.stop.words}"
    elif {"steps", "elements"} & set(run.statistics):
        yield "end", "reached the time asked for"
