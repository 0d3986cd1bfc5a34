"""Facts of a motion over terrain, and the rows of its summary that show them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from slipfree.core.facts import Fact, rows
from slipfree.core.trajectory import Trajectory, path_length
from slipfree.models.samples import has_pressed_wheels, lightest_wheel, rocks

FORMULATION = "formulation"  # attribute of results of direct problems
OBSTACLES = "obstacles"  # fact of motions over solids: their ending
FILLED = "filled_samples"  # fact of motions on a map with filled holes
UNIQUE = ("clearance", "relative_curvature")  # not negative if every wheel has one contact point
NOT_ANGLES = ("_rate", "_stop", "_torque")  # ends of the names of other quantities of tilting parts
QUANTITIES = {  # facts about the values of each quantity over time and wheels, see `extremes`
    **dict.fromkeys(("x", "y", "heading", "yaw"), "end"),
    "z": "end least greatest",
    **dict.fromkeys(("pitch", "roll"), "end largest"),
    **dict.fromkeys(("utilisation", "utilisation_best", "sinkage", "depth"), "most"),
    **dict.fromkeys(("friction_needed", "drive_torque", "load_share"), "largest"),
    **dict.fromkeys(("kinetic_energy", "body_load", "closure_residual"), "largest"),
    **dict.fromkeys(("drift_position", "drift_rotation", "newton_step"), "largest"),
    "power": "largest greatest",
    "slip_ratio": "largest least greatest",
    "force_normal": "least greatest",
    **dict.fromkeys(("tip_over_margin", "singular_value", "clearance_body", *UNIQUE), "least"),
    "drawbar_reserve": "least",
    **dict.fromkeys(("work", "potential_energy", "lost_energy"), "gained"),
}
PATH_ROWS = rows(
    """\
duration: {duration:g}, {samples} samples
path length: {path_length:.6g}, heights {z_least.value:.4f} to {z_greatest:.4f}
obstacles: {obstacles}: {obstacles.words}
filled ground: {filled_samples} of {samples} samples have a wheel on interpolated heights; along \
the contact points: <filled_paths> {wheel} {length:.4g} of {path_length:.4g} m
end position: x {end_x:.3f}, y {end_y:.3f}, z {end_z:.3f}
end attitude: heading {end_heading:.4g>deg}, pitch {end_pitch:.4g>deg}, roll {end_roll:.4g>deg} \
(yaw from the x axis {end_yaw:.4g>deg})"""
)
MOTION_ROWS = rows(
    """\
{wheel_contact}: depth {depth_largest:.3g>mm} at most, load up to {load_share_largest:.3g} times \
an equal share of the weight; {lift_offs} lift-offs, counted per wheel
vehicle in the air: {time_in_air:.3g} in all, the longest flight {longest_flight:.3g}
wheels in the air: <wheels_in_air> {wheel} at {share_of_samples:.0%} of the samples, up to \
{height:.2g} m high
body on the ground: at {body_on_ground:.0%} of the samples, with up to {body_load_largest:.4g}
least loaded wheel: {least_loaded} at the start
  changes: {load_changes}: <rocks> {before} to {after} at {t:.4g} s
soil: drawbar-pull reserve {drawbar_least:.3g} at least ({drawbar_least.words})[, slip ratio \
{slip_ratio_least:.3g} to {slip_ratio_greatest:.3g}][, sinkage {sinkage_largest:.3g>mm} at most \
({sinkage_largest.words})]
slip: {slip_law}
  wheel {wheel}: <slip_by_wheel> largest along {along_largest:.3g>mm/s}, across \
{across_largest:.3g>mm/s}, rms {rms:.3g>mm/s}
  mean of the wheels: rms {slip_rms:.3g>mm/s}[, {slip_per_path:.3g>mm/m} of path]
largest angles: pitch {pitch_largest:.4g>deg}, roll {roll_largest:.4g>deg}[, tilt \
{tilt_largest:.4g>deg}]
clearance of the body: {clearance_body_least:.4g}, {clearance_body_place.words}
!friction: {friction}
!  best distribution: {utilisation_best_largest:.4g} at most ({utilisation_best_largest.words})
normal forces: {force_normal_least.value:.4g} to {force_normal_greatest:.4g}
tip-over margin: {tip_over_margin_least:.4g>deg} at least
drives: torque {drive_torque_largest:.4g} at most, power {power_greatest:.4g} at most, work \
{work:.6g}, potential energy gained {potential_energy:.6g}
energy: lost {lost_energy:.6g}, kinetic energy up to {kinetic_energy_largest:.6g}
!energy balance: closed to {energy_imbalance:.2e}
!drift of the assembly: {drift_position_largest:.2e}, {drift_rotation_largest:.2e} at most
!contact error: {closure_residual_largest:.2e} at most
!integration error: {newton_step_largest:.2e} at most{of_tolerance}; corrected at the samples
!conditioning: smallest singular value {singular_value_least:.4g} at least; at 0 no rates follow
!contact certificate: {contact_certificate}
!not converged: <not_converged> {name} at {fact} of {samples} samples
!diagnostics failed: <failed_diagnostics> {fact}
!integrator: {steps:.0f} steps, {residuals:.0f} evaluations, {cpu_seconds:.3g} s CPU, tolerance \
{tolerance:g}"""
)
START_ROWS = rows(
    """\
stable poses: <stable_poses> pitch {pitch:.3f}, roll {roll:.3f} rad with {wheel} least loaded, \
{share:.2g} of an equal share of the weight
!contact certificate: {contact_certificate}
clearance of the body: {clearance_body_least:.4g}, {clearance_body_place.words}"""
)


def extremes(run: Trajectory, quantities: Mapping[str, str]) -> dict[str, Fact]:
    """Return facts about quantities of a motion, with wheel and time of extremes as description.

    Parameters
    ----------
    run : Trajectory
        The motion. Quantities that it does not have, or not as numbers, have no facts.
    quantities : mapping of str to str
        Facts of each quantity, separated by blanks: ``end`` (last value), ``gained`` (change from
        the first to the last value), ``least``, ``greatest``, ``largest`` (absolute value) or
        ``most`` (greatest value under the name of the largest).
    """
    facts = dict[str, Fact]()
    for name, kinds in quantities.items():
        if name not in run.columns or np.isnan(values := run[name]).all():
            continue
        unit = run.columns[name].label.unit
        for kind in kinds.split():
            if kind == "end":
                facts[f"end_{name}"] = Fact(float(values[-1]), unit)
            elif kind == "gained":
                facts[name] = Fact(float(values[-1] - values[0]), unit)
            else:
                sizes = {"largest": np.abs(values), "least": -values}.get(kind, values)
                k, *wheel = np.unravel_index(int(np.nanargmax(sizes)), values.shape)
                value = float(values[k, *wheel])
                where = f"wheel {run.wheels[wheel[0]]}, " if wheel else ""
                facts[f"{name}_{kind.replace('most', 'largest')}"] = Fact(
                    abs(value) if kind == "largest" else value, unit, f"{where}t = {run.t[k]:.4g} s"
                )
    return facts


def drive_facts(run: Trajectory) -> dict[str, Fact]:
    """Return the facts of a motion: last values, extremes, path length, slip, energy, rocking."""
    facts = extremes(run, QUANTITIES)
    duration, length = float(run.t[-1] - run.t[0]), path_length(run)
    facts["duration"], facts["path_length"] = Fact(duration, "s"), Fact(length, "m")
    tilts = [name for name in run if name.startswith("tilt_") and not name.endswith(NOT_ANGLES)]
    if largest := extremes(run, dict.fromkeys(tilts, "largest")):
        facts |= largest
        facts["tilt_largest"] = Fact(max(fact.value for fact in largest.values()), "rad")
    slip = np.hypot(run["slip_along"], run["slip_across"])
    facts["slip_largest"] = Fact(float(slip.max()), "m s-1")
    facts["slip_by_wheel"] = Fact(
        [
            {
                "wheel": wheel,
                "along_largest": float(np.abs(run["slip_along", wheel]).max()),
                "across_largest": float(np.abs(run["slip_across", wheel]).max()),
                "rms": float(np.sqrt(np.mean(slip[:, k] ** 2))),
            }
            for k, wheel in enumerate(run.wheels)
        ]
    )
    if duration > 0:
        squares = np.trapezoid(slip**2, run.t, axis=0).mean()
        facts["slip_rms"] = Fact(float(np.sqrt(squares / duration)), "m s-1")
    if length > 0:
        total = np.trapezoid(slip, run.t, axis=0).mean()
        facts["slip_per_path"] = Fact(float(total / length), "m m-1")
    steps = np.hypot(np.diff(run["x"]), np.diff(run["y"]))
    facts["sample_distance_largest"] = Fact(float(steps.max(initial=0.0)), "m")
    unknown = {
        name: int(np.isnan(column.values).reshape(run.t.size, -1).any(axis=1).sum())
        for name, column in run.columns.items()
    }
    facts["not_converged"] = Fact({name: count for name, count in unknown.items() if count})
    if "drawbar_reserve" in run:
        reserve = run["drawbar_reserve"].sum(axis=1)
        least = int(np.nanargmin(reserve))
        facts["drawbar_least"] = Fact(float(reserve[least]), "N", f"t = {run.t[least]:.4g} s")
    if "body_load" in run:
        facts["body_on_ground"] = Fact(float((run["body_load"] > 0).mean()), "1")
    if "utilisation_largest" in facts:
        facts["friction"] = Fact(_friction(run, facts["utilisation_largest"]))
    if has_pressed_wheels(run):
        facts |= _pressed_facts(run)
    model, law = run.attributes.get("model"), run.attributes.get("law", "least")
    meaning = f"by the slip law {law!r}, not a prediction"
    if law == "least":
        meaning = "the least that kinematics allows: a lower bound, not a prediction"
    if model == "dynamics":
        energy = run["kinetic_energy"] + run["potential_energy"] + run["contact_energy"]
        work, lost = (run[name] - run[name][0] for name in ("work", "lost_energy"))
        balance = float(np.abs(energy - energy[0] - work + lost).max())
        facts["energy_imbalance"] = Fact(balance, "J")
        meaning = f"a prediction with inertia, by the wheel-ground law {law!r}"
    else:
        facts["contact_certificate"] = Fact(_certificate(run, facts))
    if model == "quasi-static":
        meaning = f"a quasi-static prediction by the wheel-ground law {law!r}"
    facts["slip_law"] = Fact(meaning)
    return facts


def _pressed_facts(run: Trajectory) -> dict[str, Fact]:
    """Return facts about pressed wheels: time in the air, lift-offs and rocking."""
    depth = run["depth"]
    flying = np.concatenate([[False], (depth < 0).all(axis=1), [False]])
    ends = np.append(run.t, run.t[-1])  # of flights, with all wheels in the air
    edges = np.flatnonzero(np.diff(flying)).reshape(-1, 2).tolist()
    flights = [float(ends[last] - run.t[first]) for first, last in edges]
    lifted, heights = (depth < 0).mean(axis=0), -depth.min(axis=0)
    in_air = [
        {"wheel": wheel, "share_of_samples": float(share), "height": float(height)}
        for wheel, share, height in zip(run.wheels, lifted, heights, strict=True)
        if share
    ]
    changes = [rock._asdict() for rock in rocks(run)]
    facts = {
        "time_in_air": Fact(sum(flights), "s"),
        "longest_flight": Fact(max(flights, default=0.0), "s"),
        "wheels_in_air": Fact(in_air),
        "lift_offs": Fact(int(((depth[:-1] >= 0) & (depth[1:] < 0)).sum()), "1"),
        "rocks": Fact(changes),
        "wheel_contact": Fact("compliant contact"),
    }
    if run.attributes.get("model") == "dynamics":
        return facts
    return facts | {
        "wheel_contact": Fact("pressed wheels"),
        "least_loaded": Fact(lightest_wheel(run, 0)[0]),
        "load_changes": Fact(str(len(changes))),
    }


def _friction(run: Trajectory, used: Fact) -> str:
    """Return the largest utilisation of friction, or without friction the coefficient needed."""
    where = f"{used:.4g} at most ({used.words})"
    if "ground_friction" not in run.attributes:
        return f"coefficient needed {where}; the ground has no given coefficient"
    spread = ", for the forces that this motion needs"
    if "utilisation_best" in run.columns:
        spread += ", distributed by load"
    if run.attributes.get("model") in ("quasi-static", "dynamics"):
        spread = f" by the law {run.attributes['law']!r}"
    enough = "" if used.value <= 1 else "; friction is not sufficient for this motion"
    coefficient = run.attributes["ground_friction"]
    return f"utilisation {where}, of a coefficient of {coefficient}{spread}{enough}"


def _certificate(run: Trajectory, facts: Mapping[str, Fact]) -> str:
    """Return the text of the contact certificate: whether each wheel has a single contact point.

    It begins with "clean" if this is certain at all samples, otherwise with "broken".
    """
    if UNIQUE[0] not in run:
        return "clean: the ground is a plane"
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


def pose_row(pose: Trajectory) -> dict[str, Any]:
    """Return a stable pose at the start, with its least loaded wheel."""
    wheel, share, depth = lightest_wheel(pose, 0)
    angles = {name: float(pose[name][0]) for name in ("pitch", "roll")}
    return {**angles, "wheel": wheel, "share": share, "depth": depth}
