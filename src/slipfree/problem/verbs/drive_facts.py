"""Facts of a motion over terrain, and the lines of its summary that show them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from slipfree.core.facts import Fact, Facts
from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory, path_length
from slipfree.models.samples import CLOSEST, has_pressed_wheels, lightest_wheel, rocks
from slipfree.models.single_wheel import RESERVE
from slipfree.problem.verbs.base import FAILED_DIAGNOSTICS, Extremes, duration_fact

FORMULATION = "formulation"  # attribute of results of direct problems
OBSTACLES = "obstacles"  # fact of motions over solids: their ending
FILLED = "filled_samples"  # fact of motions on a map with filled holes
UNIQUE = ("clearance", "relative_curvature")  # not negative if every wheel has one contact point
MAX_ROCKS = 5  # changes of the least loaded wheel that a summary lists
CHECKS = (
    "contact error",
    "integration error",
    "drift of the assembly",
    "conditioning",
    "contact certificate",
    "energy balance",
    "not converged",
    "diagnostics failed",
    "friction",
    "  best distribution",
    "integrator",
)  # lines about accuracy and validity
EXTREMES = Extremes(
    end=("x", "y", "z", "heading", "pitch", "roll", "yaw"),
    largest=(
        *("pitch", "roll", "utilisation", "utilisation_best", "friction_needed", "drive_torque"),
        *("power", "drift_position", "drift_rotation", "closure_residual", "newton_step"),
        *("sinkage", "slip_ratio", "depth", "load_share", "kinetic_energy", "body_load"),
    ),
    greatest=("z", "force_normal", "slip_ratio", "power"),
    least=(
        *("tip_over_margin", "force_normal", "clearance", "relative_curvature", "singular_value"),
        *("clearance_body", "drawbar_reserve", "z", "slip_ratio"),
    ),
    gained=("work", "potential_energy", "lost_energy"),
)
NOT_ANGLES = ("_rate", "_stop", "_torque")  # ends of the names of other quantities of tilting parts


def drive_facts(run: Trajectory) -> dict[str, Fact]:
    """Return the facts of a motion: last values, extremes, path length, slip, energy, rocking."""
    facts = EXTREMES.of(run)
    duration, length = float(run.t[-1] - run.t[0]), path_length(run)
    facts["duration"], facts["path_length"] = Fact(duration, "s"), Fact(length, "m")
    tilts = [name for name in run if name.startswith("tilt_") and not name.endswith(NOT_ANGLES)]
    sizes = {name: float(np.abs(run[name]).max()) for name in tilts}
    facts |= {f"{name}_largest": Fact(size, "rad") for name, size in sizes.items()}
    if sizes:
        facts["tilt_largest"] = Fact(max(sizes.values()), "rad")
    slip = np.hypot(run["slip_along"], run["slip_across"])
    facts["slip_largest"] = Fact(float(slip.max()), "m s-1")
    facts["slip_by_wheel"] = Fact(_slip_rows(run, slip))
    if duration > 0:
        squares = np.trapezoid(slip**2, run.t, axis=0).mean()
        facts["slip_rms"] = Fact(float(np.sqrt(squares / duration)), "m s-1")
    if length > 0:
        total = np.trapezoid(slip, run.t, axis=0).mean()
        facts["slip_per_path"] = Fact(float(total / length), "m m-1")
    for name in ("utilisation", "utilisation_best", "sinkage", "depth"):
        if name in run.columns and not np.isnan(run[name]).all():
            facts[f"{name}_largest"] = _placed(run, name)
    if RESERVE.name in run:
        reserve = run[RESERVE.name].sum(axis=1)
        least = int(np.nanargmin(reserve))
        facts["drawbar_least"] = Fact(float(reserve[least]), "N", f"t = {run.t[least]:.4g} s")
    if has_pressed_wheels(run):
        facts |= _pressed_facts(run)
    if is_dynamic(run):
        energy = run["kinetic_energy"] + run["potential_energy"] + run["contact_energy"]
        work, lost = (run[name] - run[name][0] for name in ("work", "lost_energy"))
        balance = float(np.abs(energy - energy[0] - work + lost).max())
        facts["energy_imbalance"] = Fact(balance, "J")
    steps = np.hypot(np.diff(run["x"]), np.diff(run["y"]))
    facts["sample_distance_largest"] = Fact(float(steps.max(initial=0.0)), "m")
    unknown = {
        name: int(np.isnan(column.values).reshape(run.t.size, -1).any(axis=1).sum())
        for name, column in run.columns.items()
    }
    facts["not_converged"] = Fact({name: count for name, count in unknown.items() if count})
    return facts


def _placed(run: Trajectory, name: str) -> Fact:
    """Return the largest value of a quantity, with its wheel and time as description."""
    column = run.columns[name]
    k, *wheel = np.unravel_index(int(np.nanargmax(column.values)), column.values.shape)
    where = f"wheel {run.wheels[wheel[0]]}, " if wheel else ""
    value = float(column.values[k, *wheel])
    return Fact(value, column.label.unit, f"{where}t = {run.t[k]:.4g} s")


def _slip_rows(run: Trajectory, slip: Array) -> list[dict[str, Any]]:
    along, across = (np.abs(run[f"slip_{axis}"]).max(axis=0) for axis in ("along", "across"))
    rms = np.sqrt(np.mean(slip**2, axis=0))
    names = ("wheel", "along_largest", "across_largest", "rms")
    rows = zip(run.wheels, along.tolist(), across.tolist(), rms.tolist(), strict=True)
    return [dict(zip(names, row, strict=True)) for row in rows]


def _pressed_facts(run: Trajectory) -> dict[str, Fact]:
    """Return facts about pressed wheels: time in the air, lift-offs and rocking."""
    depth, flights = run["depth"], time_in_air(run)
    lifted, heights = (depth < 0).mean(axis=0), -depth.min(axis=0)
    in_air = [
        {"wheel": wheel, "share_of_samples": float(share), "height": float(height)}
        for wheel, share, height in zip(run.wheels, lifted, heights, strict=True)
        if share
    ]
    left = (depth[:-1] >= 0) & (depth[1:] < 0)
    return {
        "time_in_air": Fact(sum(flights), "s"),
        "longest_flight": Fact(max(flights, default=0.0), "s"),
        "wheels_in_air": Fact(in_air),
        "lift_offs": Fact(int(left.sum()), "1"),
        "rocks": Fact([rock._asdict() for rock in rocks(run)]),
    }


def time_in_air(run: Trajectory) -> list[float]:
    """Return the durations of the flights of a vehicle, with all wheels in the air [s]."""
    flying = np.concatenate([[False], (run["depth"] < 0).all(axis=1), [False]])
    edges = np.flatnonzero(np.diff(flying)).reshape(-1, 2)
    ends = np.append(run.t, run.t[-1])
    return [float(ends[last] - run.t[first]) for first, last in edges.tolist()]


def is_quasi_static(run: Trajectory) -> bool:
    """Return whether a motion is of the quasi-static model."""
    return run.attributes.get("model") == "quasi-static"


def is_dynamic(run: Trajectory) -> bool:
    """Return whether a motion is of the dynamic model."""
    return run.attributes.get("model") == "dynamics"


def path_lines(run: Trajectory, facts: Facts) -> Iterator[tuple[str, str]]:
    """Yield the lines about duration, path and end of a motion."""
    value = {name: fact.value for name, fact in facts.items()}
    yield duration_fact(run)
    yield "path length", f"{value['path_length']:.6g} m"
    yield "height along the path", f"{value['z_least']:.4f} to {value['z_greatest']:.4f} m"
    if OBSTACLES in facts:
        yield OBSTACLES, f"{facts[OBSTACLES].value}: {facts[OBSTACLES].words}"
    if FILLED in facts:
        yield "filled ground", _filled_words(run, value)
    yield "end position", ", ".join(f"{name} {value[f'end_{name}']:.3f} m" for name in "xyz")
    names = ("heading", "pitch", "roll")
    angles = ", ".join(f"{name} {value[f'end_{name}']:.6g} rad" for name in names)
    yield "end attitude", f"{angles} (yaw from the x axis {value['end_yaw']:.6g} rad)"


def _filled_words(run: Trajectory, value: Mapping[str, Any]) -> str:
    """Return a text on the parts of wheel paths that lie on filled holes of the map."""
    if not value[FILLED]:
        return f"no wheel on interpolated heights at any of {run.t.size} samples"
    lengths = (
        f"{row['wheel']} {row['length']:.4g} of {row['path_length']:.4g} m"
        for row in value["filled_paths"]
    )
    return (
        f"{value[FILLED]} of {run.t.size} samples have a wheel on interpolated heights; along the "
        f"contact points: {', '.join(lengths)}"
    )


def contact_lines(run: Trajectory, facts: Facts) -> Iterator[tuple[str, str]]:
    """Yield lines about a motion with pressed wheels: depths, wheels in the air and rocking."""
    if not has_pressed_wheels(run):
        return
    value = {name: fact.value for name, fact in facts.items()}
    exact = "" if is_dynamic(run) else "too many for exact contact; "
    yield (
        "compliant contact" if is_dynamic(run) else "pressed wheels",
        f"{exact}depth {value['depth_largest']:.3g} m at most, load up to "
        f"{value['load_share_largest']:.3g} times an equal share of the weight",
    )
    if is_dynamic(run):
        yield (
            "vehicle in the air",
            f"{value['time_in_air']:.3g} s in all, the longest flight "
            f"{value['longest_flight']:.3g} s"
            if value["time_in_air"]
            else "never",
        )
    in_air = (
        f"{row['wheel']} at {row['share_of_samples']:.0%} of the samples, up to "
        f"{row['height']:.2g} m high"
        for row in value["wheels_in_air"]
    )
    yield "wheels in the air", "; ".join(in_air) or "none"
    if "body_load" in run:
        share = float((run["body_load"] > 0).mean())
        yield (
            "body on the ground",
            f"at {share:.0%} of the samples, with up to {value['body_load_largest']:.4g} N"
            if share
            else "never",
        )
    if is_dynamic(run):
        yield "lift-offs", f"{value['lift_offs']}, counted per wheel"
        return
    changes = value["rocks"]
    listed = [f"{r['before']} to {r['after']} at {r['t']:.4g} s" for r in changes[:MAX_ROCKS]]
    more = ["..."] if len(changes) > MAX_ROCKS else []
    count = "once" if len(changes) == 1 else f"{len(changes)} times"
    yield (
        "least loaded wheel",
        f"changes {count}: {', '.join(listed + more)}"
        if changes
        else f"{lightest_wheel(run, 0)[0]} all the time",
    )


def start_lines(poses: Sequence[Trajectory]) -> Iterator[tuple[str, str]]:
    """Yield lines about a start with pressed wheels, the first of its stable poses."""
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


def clearance_lines(facts: Facts) -> Iterator[tuple[str, str]]:
    """Yield the line about the clearance of the vehicle's bodies, if they have shapes."""
    if CLOSEST in facts:
        least = facts["clearance_body_least"].value
        yield "clearance of the body", f"{least:.4g} m, {facts[CLOSEST].words}"


def soil_lines(run: Trajectory, facts: Facts) -> Iterator[tuple[str, str]]:
    """Yield the line about sinkage, slip ratios and drawbar-pull reserve of a motion in soil."""
    if RESERVE.name not in run:
        return
    sinkage = facts["sinkage_largest" if "sinkage" in run else "depth_largest"]
    reserve = facts["drawbar_least"]
    yield (
        "soil",
        f"sinkage {1e3 * sinkage.value:.3g} mm at most ({sinkage.words}), slip ratio "
        f"{facts['slip_ratio_least'].value:.3g} to {facts['slip_ratio_greatest'].value:.3g}, "
        f"drawbar-pull reserve {reserve.value:.3g} N at least ({reserve.words})",
    )


def slip_lines(run: Trajectory, facts: Facts) -> Iterator[tuple[str, str]]:
    """Yield the lines about the slip of each wheel, and the law that determined it."""
    law = run.attributes.get("law", "least")
    if is_dynamic(run):
        yield "slip", f"a prediction with inertia, by the wheel-ground law {law!r}"
    elif is_quasi_static(run):
        yield "slip", f"a quasi-static prediction by the wheel-ground law {law!r}"
    elif law == "least":
        yield "least slip", "the least that kinematics allows: a lower bound, not a prediction"
    else:
        yield "slip", f"by the slip law {law!r}, not a prediction"
    for row in facts["slip_by_wheel"].value:
        yield (
            f"  wheel {row['wheel']}",
            f"largest along {row['along_largest']:.2e}, across {row['across_largest']:.2e}, "
            f"rms {row['rms']:.2e} m/s",
        )


def angle_lines(run: Trajectory, facts: Facts) -> Iterator[tuple[str, str]]:
    """Yield the line about the largest angles of the platform and the tilting joints."""
    names = ["pitch", "roll"]
    names += [name for name in run if name.startswith("tilt_") and f"{name}_largest" in facts]
    sizes = (f"{name} {facts[f'{name}_largest'].value:.4g} rad" for name in names)
    yield "largest angles", ", ".join(sizes)


def force_lines(run: Trajectory, facts: Facts) -> Iterator[tuple[str, str]]:
    """Yield the lines about friction, normal forces, tip-over margin and drives, if computed."""
    if "utilisation" not in run.columns:
        return
    value = {name: fact.value for name, fact in facts.items()}
    yield "friction", friction_words(run, facts)
    if best := facts.get("utilisation_best_largest"):
        yield "  best distribution", f"{best.value:.4g} at most ({best.words})"
    low, high = value["force_normal_least"], value["force_normal_greatest"]
    yield "normal forces", f"{low:.4g} to {high:.4g} N"
    yield "tip-over margin", f"{value['tip_over_margin_least']:.4g} rad at least"
    yield (
        "drives",
        f"torque {value['drive_torque_largest']:.4g} N m at most, power "
        f"{value['power_greatest']:.4g} W at most, work {value['work']:.6g} J, potential energy "
        f"gained {value['potential_energy']:.6g} J",
    )


def friction_words(run: Trajectory, facts: Facts) -> str:
    """Return the largest utilisation of friction, or without friction the coefficient needed."""
    used = facts["utilisation_largest"]
    where, value = f"at most ({used.words})", f"{used.value:.4g}"
    if "ground_friction" not in run.attributes:
        return f"coefficient needed {value} {where}; the ground has no given coefficient"
    words = f"utilisation {value} {where}, of a coefficient of {run.attributes['ground_friction']}"
    spread = ", for the forces that this motion needs"
    if "utilisation_best" in run.columns:
        spread += ", distributed by load"
    by_law = is_quasi_static(run) or is_dynamic(run)
    spread = f" by the law {run.attributes['law']!r}" if by_law else spread
    enough = "" if used.value <= 1 else "; friction is not sufficient for this motion"
    return f"{words}{spread}{enough}"


def trust_lines(
    run: Trajectory, facts: Facts, tolerance: float | None
) -> Iterator[tuple[str, str]]:
    """Yield the lines about residuals, conditioning and certificate, or about the energy balance.

    ``tolerance`` is that of the integrator, None without one.
    """
    value = {name: fact.value for name, fact in facts.items()}
    if is_dynamic(run):
        yield (
            "energy",
            f"work of the drives {value['work']:.6g} J, lost {value['lost_energy']:.6g} J, kinetic "
            f"energy up to {value['kinetic_energy_largest']:.6g} J",
        )
        yield "energy balance", f"closed to {value['energy_imbalance']:.2e} J"
    else:
        if run.attributes.get(FORMULATION) == "montana":
            drift, turned = (value[f"drift_{name}_largest"] for name in ("position", "rotation"))
            yield "drift of the assembly", f"{drift:.2e} m, {turned:.2e} rad at most"
        else:
            yield "contact error", f"{value['closure_residual_largest']:.2e} m at most"
            if "newton_step" in run:  # a plan that is not simulated has none
                step = value["newton_step_largest"]
                # The integrator's error test ignores the unknowns of pressed wheels.
                tested = tolerance and not has_pressed_wheels(run)
                of_it = f", {step / tolerance:.3g} x the tolerance" if tested else ""
                yield "integration error", f"{step:.2e} m at most{of_it}; corrected at the samples"
        least = value["singular_value_least"]
        yield "conditioning", f"smallest singular value {least:.4g} at least; at 0 no rates follow"
        yield "contact certificate", certificate(run)
    if listed := value["not_converged"]:
        counts = (f"{name} at {count} of {run.t.size} samples" for name, count in listed.items())
        yield "not converged", ", ".join(counts)
    if FAILED_DIAGNOSTICS in facts:
        yield "diagnostics failed", "; ".join(value[FAILED_DIAGNOSTICS])


def certificate(run: Trajectory) -> str:
    """Return the text of the contact certificate: whether each wheel has a single contact point.

    It begins with "clean" if this is certain at all samples, otherwise with "broken".
    """
    if UNIQUE[0] not in run:
        return "clean: the ground is a plane"
    facts = drive_facts(run)
    clearance, curvature = (facts[f"{name}_least"].value for name in UNIQUE)
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
    return f"{words}; samples at most {facts['sample_distance_largest'].value:.3g} m apart"
