"""Facts of the summary of a motion over terrain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from slipfree.models.drawbar import RESERVE
from slipfree.models.rocking import has_pressed_wheels, lightest_wheel, rocks
from slipfree.problem.summary import duration_fact
from slipfree.problem.verbs.base import FAILED_DIAGNOSTICS
from slipfree.trajectory import Trajectory, path_length

FORMULATION = "formulation"  # attribute of results of direct problems
OBSTACLES = "obstacles"  # attribute of motions over solids: their ending
UNIQUE = ("clearance", "relative_curvature")  # not negative if every wheel has one contact point
MAX_ROCKS = 5  # changes of the least loaded wheel that a summary lists
CHECKS = (
    "closure residual",
    "Newton step",
    "drift of the assembly",
    "singular value",
    "contact certificate",
    "energy balance",
    "not converged",
    "diagnostics failed",
    "friction",
    "  best distribution",
    "integrator",
)  # facts about accuracy and validity


def path_facts(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield the facts about duration, path and end of a motion."""
    z = run["z"]
    yield duration_fact(run)
    yield "path length", f"{path_length(run):.6g} m"
    yield "height along the path", f"{z.min():.4f} to {z.max():.4f} m"
    place = ", ".join(f"{name} {run[name][-1]:.3f} m" for name in "xyz")
    if OBSTACLES in run.attributes:
        yield OBSTACLES, run.attributes[OBSTACLES]
    if "filled_ground" in run.attributes:
        yield "filled ground", run.attributes["filled_ground"]
    yield "end position", place
    angles = ", ".join(f"{name} {run[name][-1]:.6g} rad" for name in ("heading", "pitch", "roll"))
    yield "end attitude", f"{angles} (yaw from the x axis {run['yaw'][-1]:.6g} rad)"


def is_quasi_static(run: Trajectory) -> bool:
    """Return whether a motion is of the quasi-static model."""
    return run.attributes.get("model") == "quasi-static"


def is_dynamic(run: Trajectory) -> bool:
    """Return whether a motion is of the dynamic model."""
    return run.attributes.get("model") == "dynamics"


def contact_facts(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield facts about a motion with pressed wheels: depths, wheels in the air and rocking."""
    if not has_pressed_wheels(run):
        return
    depth = run["depth"]
    name, why = (
        ("compliant contact", "")
        if is_dynamic(run)
        else ("pressed wheels", "too many for exact contact; ")
    )
    yield (
        name,
        f"{why}depth {depth.max():.3g} m at most, load up to "
        f"{run['load_share'].max():.3g} times an equal share of the weight",
    )
    if is_dynamic(run):
        flights = time_in_air(run)
        yield (
            "vehicle in the air",
            f"{sum(flights):.3g} s in all, the longest flight {max(flights):.3g} s"
            if flights
            else "never",
        )
    lifted = (depth < 0).mean(axis=0)
    words = [
        f"{name} at {share:.0%} of the samples, up to {-gap:.2g} m high"
        for name, share, gap in zip(run.wheels, lifted, depth.min(axis=0), strict=True)
        if share
    ]
    yield "wheels in the air", "; ".join(words) or "none"
    if is_dynamic(run):
        left = ((depth[:-1] >= 0) & (depth[1:] < 0)).sum()
        yield "lift-offs", f"{left}, counted per wheel"
        return
    found = rocks(run)
    listed = [f"{r.before} to {r.after} at {r.t:.4g} s" for r in found[:MAX_ROCKS]]
    more = ["..."] if len(found) > MAX_ROCKS else []
    yield (
        "least loaded wheel",
        f"changes {'once' if len(found) == 1 else f'{len(found)} times'}: "
        f"{', '.join(listed + more)}"
        if found
        else f"{lightest_wheel(run, 0)[0]} all the time",
    )


def time_in_air(run: Trajectory) -> list[float]:
    """Return the durations of the flights of a vehicle, with all wheels in the air [s]."""
    flying = np.concatenate([[False], (run["depth"] < 0).all(axis=1), [False]])
    edges = np.flatnonzero(np.diff(flying)).reshape(-1, 2)
    ends = np.append(run.t, run.t[-1])
    return [float(ends[last] - run.t[first]) for first, last in edges.tolist()]


def start_facts(poses: Sequence[Trajectory]) -> Iterator[tuple[str, str]]:
    """Yield facts about a start with pressed wheels: its wheel of least load, other stable poses.

    Parameters
    ----------
    poses : sequence of Trajectory
        Stable poses at the start, that of the motion first.
    """
    if not has_pressed_wheels(poses[0]):
        return
    name, share, depth = lightest_wheel(poses[0], 0)
    where = f"{-depth:.2g} m above the ground" if depth < 0 else f"{depth:.2g} m deep"
    yield "least loaded wheel", f"{name}, {share:.2g} of an equal share of the weight, {where}"
    if len(poses) > 1:
        others = [
            f"pitch {pose['pitch'][0]:.4g}, roll {pose['roll'][0]:.4g} rad with "
            f"{lightest_wheel(pose, 0)[0]} least loaded"
            for pose in poses[1:]
        ]
        yield "other stable poses", "; ".join(others)


def soil_facts(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield the fact about sinkage, slip ratios and drawbar-pull reserve of a motion in soil."""
    if RESERVE.name not in run:
        return
    depth, slip = run["sinkage" if "sinkage" in run else "depth"], run["slip_ratio"]
    k, i = np.unravel_index(int(depth.argmax()), depth.shape)
    reserve = run[RESERVE.name].sum(axis=1)
    least = int(np.nanargmin(reserve))
    yield (
        "soil",
        f"sinkage {1e3 * depth[k, i]:.3g} mm at most (wheel {run.wheels[i]}, t = {run.t[k]:.4g} s)"
        f", slip ratio {slip.min():.3g} to {slip.max():.3g}, drawbar-pull reserve "
        f"{reserve[least]:.3g} N at least (t = {run.t[least]:.4g} s)",
    )


def slip_facts(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield the facts about the slip of each wheel, and the law that determined it."""
    law = run.attributes.get("law", "least")
    if is_dynamic(run):
        yield "slip", f"a prediction with inertia, by the wheel-ground law {law!r}"
    elif is_quasi_static(run):
        yield "slip", f"a quasi-static prediction by the wheel-ground law {law!r}"
    elif law == "least":
        yield "least slip", "the least that kinematics allows: a lower bound, not a prediction"
    else:
        yield "slip", f"by the slip law {law!r}, not a prediction"
    for wheel in run.wheels:
        along, across = run["slip_along", wheel], run["slip_across", wheel]
        rms = np.sqrt(np.mean(along**2 + across**2))
        yield (
            f"  wheel {wheel}",
            f"largest along {np.abs(along).max():.2e}, across {np.abs(across).max():.2e}, "
            f"rms {rms:.2e} m/s",
        )


def angle_facts(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield the fact about the largest angles of the platform and the tilting joints."""
    largest = {name: np.abs(run[name]).max() for name in ("pitch", "roll")}
    largest |= {
        name: np.abs(run[name]).max()
        for name in run
        if name.startswith("tilt_") and not name.endswith(("_rate", "_stop"))
    }
    yield "largest angles", ", ".join(f"{name} {value:.4g} rad" for name, value in largest.items())


def force_facts(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield the facts about friction, normal forces, tip-over margin and drives, if computed."""
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
    """Return the description of the largest utilisation of friction, with wheel and time.

    On a ground without coefficient of friction, describe the largest coefficient needed.
    """
    used = run["utilisation"]
    k, i = np.unravel_index(int(used.argmax()), used.shape)
    where = f"at most (wheel {run.wheels[i]}, t = {run.t[k]:.4g} s)"
    value = f"{used[k, i]:.4g}"
    if "ground_friction" not in run.attributes:
        return f"coefficient needed {value} {where}; the ground has no given coefficient"
    words = f"utilisation {value} {where}, of a coefficient of {run.attributes['ground_friction']}"
    spread = ", for the forces that this motion needs"
    if "utilisation_best" in run.columns:
        spread += ", distributed by load"
    by_law = is_quasi_static(run) or is_dynamic(run)
    spread = f" by the law {run.attributes['law']!r}" if by_law else spread
    return f"{words}{spread}" + (
        "" if used[k, i] <= 1 else "; friction is not sufficient for this motion"
    )


def trust_facts(run: Trajectory, tolerance: float | None) -> Iterator[tuple[str, str]]:
    """Yield the facts about residuals, conditioning and the contact certificate.

    For a dynamic motion, yield those about the energy balance instead. Diagnostics that did not
    converge are listed for all motions.

    Parameters
    ----------
    run : Trajectory
        The motion.
    tolerance : float or None
        Tolerance of its integrator; None if it was not integrated.
    """
    if is_dynamic(run):
        yield from _energy_facts(run)
        yield from _missing(run)
        return
    if run.attributes.get(FORMULATION) == "montana":
        drift, turned = (run[f"drift_{name}"].max() for name in ("position", "rotation"))
        yield "drift of the assembly", f"{drift:.2e} m, {turned:.2e} rad at most"
    else:
        yield "closure residual", f"{run['closure_residual'].max():.2e} m at most"
        if "newton_step" in run:  # a plan that is not simulated has none
            step = run["newton_step"].max()
            # The integrator's error test ignores the unknowns of pressed wheels.
            tested = tolerance and not has_pressed_wheels(run)
            of_it = f", {step / tolerance:.3g} x the tolerance" if tested else ""
            yield "Newton step", f"{step:.2e} m at most{of_it}"
    yield "singular value", f"{np.fmin.reduce(run['singular_value']):.4g} at least"
    yield "contact certificate", certificate(run)
    yield from _missing(run)


def _energy_facts(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield the facts about the energy balance of a dynamic motion."""
    energy = run["kinetic_energy"] + run["potential_energy"] + run["contact_energy"]
    work, lost = (run[name] - run[name][0] for name in ("work", "lost_energy"))
    yield (
        "energy",
        f"work of the drives {work[-1]:.6g} J, lost {lost[-1]:.6g} J, kinetic energy up to "
        f"{run['kinetic_energy'].max():.6g} J",
    )
    imbalance = np.abs(energy - energy[0] - work + lost).max()
    yield "energy balance", f"closed to {imbalance:.2e} J"


def _missing(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield the facts about diagnostics that did not converge at some samples, or failed."""
    counts = {}
    for name, column in run.columns.items():
        unknown = np.isnan(column.values).reshape(run.t.size, -1).any(axis=1)
        counts[name] = int(unknown.sum())
    listed = [
        f"{name} at {count} of {run.t.size} samples" for name, count in counts.items() if count
    ]
    if listed:
        yield "not converged", ", ".join(listed)
    if FAILED_DIAGNOSTICS in run.attributes:
        yield "diagnostics failed", run.attributes[FAILED_DIAGNOSTICS]


def certificate(run: Trajectory) -> str:
    """Return the text of the contact certificate: whether each wheel has a single contact point.

    The text begins with "clean" if this is certain at all samples, otherwise with "broken", and
    contains the least margins.
    """
    if UNIQUE[0] not in run:
        return "clean: the ground is a plane"
    clearance, curvature = (run[name].min() for name in UNIQUE)
    clean = "clean" if min(clearance, curvature) >= 0 else "broken"
    if run.stop is not None and run.stop.name.partition("[")[0] in UNIQUE:
        clean += " up to the stop"
    room = (
        "no other part of the ground near the wheels"
        if np.isinf(clearance)
        else f"clearance beside the contacts {clearance:.4g} m at least"
    )
    words = f"{clean}: {room}, relative curvature {curvature:.4g} 1/m at least"
    if run.t.size == 1:
        return words
    return f"{words}; samples at most {_sample_distance(run):.3g} m apart"


def _sample_distance(run: Trajectory) -> float:
    """Return the largest horizontal distance between consecutive samples [m]."""
    steps = np.hypot(np.diff(run["x"]), np.diff(run["y"]))
    return float(steps.max(initial=0.0))
