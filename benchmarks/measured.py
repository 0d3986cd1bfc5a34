"""Measurements: robots on level ground, and wheels in soil.

``python benchmarks measured FOLDER [--figures DIR]`` reads public data that are not part of the
project (sources: docs/measured.md, docs/measured_wheels.md):

- ``drive/*.csv.gz``: windows of 2 s of a Husky, and of a Warthog on four surfaces: wheel rates,
  poses of a lidar, turning rates of an inertial unit;
- ``single_wheel/cmu_smooth.csv``: a smooth wheel in sand;
- ``single_wheel/ishigami2005.csv``: two wheels in a regolith simulant;
- ``single_wheel/single_wheel_experiments.csv``: three papers on wheels in soil;
- ``single_wheel/mgru3_gentle_slopes.csv``: a wheel on slopes, which predicts steeper ones.

Nothing is fitted to the points that judge it.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import common  # noqa: F401 - path of the helpers of tests
import numpy as np

from helpers.drives import WHEELS, four_wheels
from slipfree.fit.drive_fit import DriveFit, age_priors, fit_drives, folds_of, manoeuvres_of, rms
from slipfree.fit.drives import (
    DriveLog,
    Lanes,
    Model,
    Predictor,
    Windows,
    held_for,
    windows_of,
    without_holds,
)
from slipfree.fit.estimate import BALANCE, Unknown
from slipfree.fit.wheel_soil import QUANTITIES, fit_soil, repeat_spread
from slipfree.laws.soil import Soil, WheelSize, forces_at_slip, known_soil
from slipfree.models.single_wheel import WheelRuns, motion_at_slip
from slipfree.vehicle.tree import EARTH_GRAVITY

JUMP, TURN_JUMP = 1.5, 0.3  # of rates between windows that do not follow each other [rad/s]
LEAST_SPAN, FASTEST = 14, 6.0  # samples between first and last pose, speed of poses [m/s]
STEADY, TURNING = 0.6, 2.0  # of the rates of the sides: spread, least difference [rad/s]
HUSKY_STEP = 0.05  # time between samples of the log [s]
HUSKY_RADIUS, HUSKY_TRACK, HUSKY_BASE = 0.165, 0.57, 0.51  # of the data sheet [m]
HUSKY_FITTED = 0.139  # rolling radius of a fit [m]
ISHIGAMI_LOAD = 64.68  # as codes that cite the paper assume; the paper does not state it [N]
SEED = 0


# ---------------------------------------------------------------------------------------------
# Robots on level ground


ROBOTS = {
    "husky": (HUSKY_TRACK / 2, HUSKY_BASE / 2),
    "warthog": (0.58, 0.46),
}  # half track, base [m]
USUAL = ("stiffness", "gyration", "delay", "center_of_mass_ahead", "friction", "age")


def columns(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a log."""
    with gzip.open(path, "rt") as file:
        names = file.readline().strip().split(",")
        return dict(zip(names, np.loadtxt(file, delimiter=",", ndmin=2).T, strict=True))


def drive_log(path: Path, name: str, half: tuple[float, float]) -> tuple[DriveLog, Windows]:
    """Return the log of a robot, and its windows between new poses."""
    table = columns(path)
    is_husky = "wl_radps" in table
    keys = ("wl_radps", "wr_radps") if is_husky else ("left_wheel_vel", "right_wheel_vel")
    prefix = "" if is_husky else "icp_"
    left, right = (table[key] for key in keys)
    window = table["window"].astype(int)
    rate = None if is_husky else table["imu_yaw"] * (-1 if name in ("ice", "gravel") else 1)
    step = np.append(0, np.diff(window))
    jump = np.abs(np.diff([left, right], prepend=0, axis=1)).max(axis=0) > JUMP
    if rate is not None:
        jump |= np.abs(np.diff(rate, prepend=0)) > TURN_JUMP
    run = np.cumsum((step > 0) & (jump | is_husky))
    manoeuvre = table["calib_step" if is_husky else "manoeuvre"].astype(int)
    place = table[f"{prefix}x"] + 1j * table[f"{prefix}y"]
    is_new = np.append(False, (np.diff(place) != 0) & (np.diff(window) == 0))
    inputs = np.column_stack([without_holds(side, run)[0] for side in (left, right)])
    log = DriveLog(
        *(name, name, name, HUSKY_STEP, four_wheels(*half), inputs, run, window, manoeuvre, place),
        *(np.ones(run.size, bool), is_new if held_for(is_new) > 1 else np.ones(run.size, bool)),
        np.unwrap(table[f"{prefix}yaw"]),
        rate,
    )
    found = windows_of([log])
    moved = np.abs(place[found.end] - place[found.begin])
    is_short = found.end - found.begin < LEAST_SPAN
    # positions of the lidar that are impossible
    return log, found.take(~is_short & (moved < FASTEST * HUSKY_STEP * (found.end - found.begin)))


def model_of(
    half: tuple[float, float], surfaces: Sequence[str], *names: str, **fixed: float
) -> Model:
    """Return the force balance of a robot with some unknowns."""
    sides = (("radius_left", WHEELS[:2]), ("radius_right", WHEELS[2:]))
    unknowns = [Unknown(name, "radius", own) for name, own in sides if name in names]
    for name in names:
        if not name.startswith("radius"):
            own = surfaces if BALANCE[name].of and len(surfaces) > 1 else [""]
            unknowns += [Unknown(f"{name}_{each}".rstrip("_"), name, of=each) for each in own]
    radii = np.array([fixed.pop(name, 0.3) for name, _ in sides]).repeat(2)
    return Model(tuple(unknowns), {"gyration": 0.35} | fixed, radii, WHEELS, half[0])


class Icr(Predictor):
    """Kinematics: the turning rate is the difference of the sides over a track.

    The centre of rotation is behind the centre of mass, and turns push the vehicle outward by
    ``v omega / (K g)``, the slip of the force balance at small slip.
    """

    def motion(self, lanes: Lanes) -> tuple[np.ndarray, np.ndarray]:
        """Return velocities and turning rates at samples."""
        q = {name: value[:, None] for name, value in lanes.values.items()}
        sides = self._signals(lanes.values)[:, :, self._rows]
        left, right = (lanes.radius[2 * k, :, None] * side for k, side in enumerate(sides))
        v, w = (left + right) / 2, (right - left) / q["track"]
        outward = (q["center_of_mass_ahead"] + v / (EARTH_GRAVITY * q["stiffness"])) * w
        return (v - 1j * outward).swapaxes(0, 1), w.swapaxes(0, 1)


def kinematics_of(half: tuple[float, float], *names: str, **fixed: float) -> Model:
    """Return kinematics of a robot, with wide priors; on ice it would shrink without a bound."""
    known = ("radius_left", "radius_right", "track", "center_of_mass_ahead", "age")
    model = model_of(half, [""], *known, *names, **fixed)
    wide = {"radius": (half[0] / 4, (0.3, 0.3)), "track": (0.1, (2.0, 2.0))}  # bound and prior
    usual = (-np.inf, None)
    rows = ((each, *wide.get(each.quantity, usual)) for each in model.unknowns)
    unknowns = (replace(each, lower=low, prior=prior) for each, low, prior in rows)
    return model._replace(unknowns=tuple(unknowns))


def left_out(
    model: Model, log: DriveLog, windows: Windows, kind: type[Predictor]
) -> tuple[np.ndarray, DriveFit]:
    """Return errors of windows by fits to other manoeuvres, and the fit to all of them."""
    model = model._replace(unknowns=age_priors(model.unknowns, [log]))
    parts, groups = folds_of([log], windows), manoeuvres_of([log], windows)

    def fitted(rows: np.ndarray, *start: np.ndarray) -> DriveFit:
        return fit_drives(model, kind(model, [log], windows.take(rows)), groups[rows], *start)

    whole, errors = fitted(parts >= 0), np.empty((parts.size, 3))
    for part in np.unique(parts):
        own = parts == part
        values = fitted(~own, whole.values, whole.estimate.deviations).values
        errors[own] = kind(model, [log], windows.take(own)).errors(values[None])[:, 0]
    return errors, whole


def drives(folder: Path) -> Iterator[str]:
    """Yield errors by model and surface, whole manoeuvres left out, and constants."""
    known = dict[str, float]()
    yield "surface, model: yaw rms (median) [deg], position rms (median) [m], CPU [s]"
    for path in sorted((folder / "drive").glob("*.csv.gz")):
        name = path.name.split(".")[0].removeprefix("warthog_")
        half = ROBOTS["husky" if "husky" in name else "warthog"]
        log, windows = drive_log(path, name, half)
        all_names = ("radius_left", "radius_right", "track", *USUAL)
        cases: dict[str, tuple[Model, DriveLog, type[Predictor]]] = {
            "five-parameter ICR": (kinematics_of(half, stiffness=1e4), log, Icr),
            "ICR, lags, sideslip": (kinematics_of(half, "stiffness", "delay", "lag"), log, Icr),
            "force balance": (model_of(half, [name], *all_names), log, Predictor),
            "quasi-static": (model_of(half, [name], *all_names, inertia=0.0), log, Predictor),
        }
        if known and "husky" not in name:
            given = {key: value for key, value in known.items() if key not in ("friction", "age")}
            own = (given.pop("track") / 2, half[1])
            wide = log._replace(chassis=four_wheels(*own))
            for words, more in (("friction", ()), ("friction, radius", ("rolling",))):
                model = model_of(own, [name], "friction", "age", *more, **given)
                cases[f"{words}, rest of asphalt"] = model, wide, Predictor
        for words, (model, own_log, kind) in cases.items():
            began = time.process_time()
            errors, whole = left_out(model, own_log, windows, kind)
            turns, away = np.rad2deg(np.abs(errors[:, 2])), np.hypot(*errors.T[:2])
            yield (
                f"{name:10} {words:33} {rms(turns):.1f} ({np.median(turns):.1f}), {rms(away):.2f} "
                f"({np.median(away):.2f}), {time.process_time() - began:.0f}"
            )
            values = dict(zip((u.name for u in model.unknowns), whole.values.tolist(), strict=True))
            known = values if (words, name) == ("force balance", "asphalt") else known
            if "rest" not in words:
                yield "  " + ", ".join(f"{key} {value:.3f}" for key, value in values.items())


def turning(folder: Path) -> Iterator[str]:
    """Yield the scatter of the turning rate over the difference of the sides, at steady rates."""
    log = columns(folder / "drive/husky_long.csv.gz")
    step, number, left, right, yaw = (
        log[name] for name in ("calib_step", "window", "wl_radps", "wr_radps", "yaw")
    )
    x, y, *commands = (log[name] for name in ("x", "y", "cmd_left", "cmd_right"))
    windows = [np.flatnonzero(number == each) for each in np.unique(number)]
    rates = np.array([[left[k].mean(), right[k].mean()] for k in windows])
    spread = np.array([max(left[k].std(), right[k].std()) for k in windows])
    turned = np.array([np.unwrap(yaw[k])[-1] - yaw[k[0]] for k in windows])
    difference = rates[:, 1] - rates[:, 0]
    lasting = np.array([HUSKY_STEP * (len(k) - 1) for k in windows])
    ratio = turned / lasting / difference
    manoeuvre = np.array([step[k[0]] for k in windows])
    steady = np.flatnonzero((spread < STEADY) & (np.abs(difference) > TURNING))
    mean = ratio[steady].mean()
    near = list[float]()
    for k in steady:
        others = steady[manoeuvre[steady] != manoeuvre[k]]
        closest = np.argsort(np.hypot(*(rates[others] - rates[k]).T))[:10]
        near.append(ratio[k] - ratio[others[closest]].mean())
    yield (
        f"yaw rate over difference of the sides, {steady.size} steady windows: scatter "
        f"{100 * ratio[steady].std() / mean:.0f} %, {100 * np.std(near) / mean:.0f} % about ten "
        "windows of the nearest rates in other manoeuvres"
    )
    for words, apart in (("the same manoeuvre", 0), ("successive manoeuvres", 1)):
        pairs = [
            (ratio[i], ratio[j])
            for i, j in zip(steady, steady[1:] if not apart else steady[3:], strict=False)
            if manoeuvre[j] - manoeuvre[i] == apart
        ]
        correlation = np.corrcoef(np.array(pairs).T)[0, 1]
        yield f"  correlation between windows of {words}: {correlation:.2f}"
    is_opposite = np.array([np.prod([each[k].mean() for each in commands]) < 0 for k in windows])
    moved = np.array([np.hypot(x[k[-1]] - x[k[0]], y[k[-1]] - y[k[0]]) for k in windows])
    moved /= np.abs(rates.mean(axis=1)) * lasting * HUSKY_FITTED
    yield from _turning_by_ratio(rates, difference * lasting, turned, is_opposite, moved)


def _turning_by_ratio(
    rates: np.ndarray,
    travel: np.ndarray,
    turned: np.ndarray,
    is_opposite: np.ndarray,
    moved: np.ndarray,
) -> Iterator[str]:
    """Yield errors of one gain between rates and turns, by the ratio of the slower to the faster.

    The gain is the median of all windows; ``travel`` is the integral of the difference;
    ``is_opposite`` are windows whose sides are commanded in opposite directions, and ``moved`` are
    distances over the mean travel of the wheels.
    """
    order = np.argsort(np.abs(rates), axis=1)
    slow, fast = np.take_along_axis(rates, order, axis=1).T
    does_turn = np.abs(travel) > 1
    gain = np.median((turned / travel)[does_turn])
    squares = np.where(does_turn, turned - gain * travel, 0) ** 2
    for low, high in pairwise((-1.0, -0.3, 0.05, 1.0)):
        rows = np.flatnonzero(does_turn & (slow / fast >= low) & (slow / fast < high))
        shares = turned[rows] / travel[rows] / gain
        tenths = np.quantile(shares, [0.1, 0.5, 0.9])
        least = rows[shares <= tenths[0]]
        yield (
            f"  slower side {low:+.2f} to {high:+.2f} of the faster: {rows.size} windows, "
            f"{100 * is_opposite[rows].mean():.0f} % commanded in opposite directions, heading "
            f"rms {np.rad2deg(np.sqrt(squares[rows].mean())):.1f} deg, "
            f"{100 * squares[rows].sum() / squares.sum():.0f} % of the squares; gain over the "
            f"median, deciles 1, 5, 9: {', '.join(f'{share:.2f}' for share in tenths)}; distance "
            f"over the wheels' travel {np.median(moved[rows]):.2f}, in the first decile "
            f"{np.median(moved[least]):.2f}"
        )


# ---------------------------------------------------------------------------------------------
# Wheels in soil


class WheelCase(NamedTuple):
    """A wheel in soil: runs, size, constants before the fit, and priors of those to be fitted."""

    words: str
    runs: WheelRuns
    size: WheelSize
    soil: Soil
    priors: dict[str, tuple[float, float]]  # mean and deviation
    folds: int
    regions: dict[str, np.ndarray]  # masks of the points


PUBLISHED, SINKAGE, SHEAR, BOTH = "published law", "slip sinkage", "coupled shear", "both"
RATE = 0.5  # deviation of the priors of the constants of slip sinkage, whose mean is zero


def variants(case: WheelCase) -> Iterator[tuple[str, Soil, list[Unknown]]]:
    """Yield the laws that are compared: name, soil before the fit, unknowns."""
    is_oblique = bool((case.runs.motion[2] != 0).any())
    rates = ["exponent_slip", *(["exponent_skid"] if is_oblique else [])]
    for name in (PUBLISHED, SINKAGE, SHEAR, BOTH) if is_oblique else (PUBLISHED, SINKAGE):
        own = dict(case.priors)
        if name in (SINKAGE, BOTH):
            own |= dict.fromkeys(rates, (0.0, RATE))
        unknowns = [Unknown(k, k, prior=prior) for k, prior in own.items()]
        yield name, replace(case.soil, coupled_shear=name in (SHEAR, BOTH)), unknowns


def cross_validated(case: WheelCase) -> Iterator[str]:
    """Yield rms errors of runs that were left out, by law, region and quantity."""
    runs = case.runs
    count = np.unique(runs.run).size
    yield f"{case.words}: {runs.load.size} points, {count} runs, {case.folds} folds"
    yield "  " + _errors_in_words("deviation of the data", case, None)
    spread = repeat_spread(runs)
    if np.isfinite(spread).any():
        pairs = zip(QUANTITIES, spread, strict=True)
        words = ", ".join(f"{name} {value:.3g}" for name, value in pairs if np.isfinite(value))
        yield f"  deviation between repeats: {words}"
    for k, (name, soil, unknowns) in enumerate(variants(case)):
        fit = fit_soil(soil, case.size, unknowns, runs, folds=case.folds, resamples=0)
        if k == 0:
            before = fit.nominal - runs.values
            yield "  " + _errors_in_words("constants before the fit", case, before)
        yield "  " + _errors_in_words(name, case, fit.validated - runs.values)
        labels = zip(fit.estimate.labels, fit.estimate.intervals, strict=True)
        values = zip(labels, fit.estimate.values, fit.estimate.at_bound, strict=True)
        yield "    " + ", ".join(
            f"{label.name} {value:.3g} ({'at its bound' if edge else f'{low:.3g} to {high:.3g}'})"
            for (label, (low, high)), value, edge in values
        )
        if lost := fit.estimate.undetermined:
            yield f"    not determined: {', '.join(lost)}"


def _errors_in_words(name: str, case: WheelCase, errors: np.ndarray | None) -> str:
    """Return rms errors in each region in words; without errors, the deviation of the data."""
    lines = []
    for region, rows in case.regions.items():
        parts = []
        for k, quantity in enumerate(QUANTITIES):
            measured = case.runs.values[rows, k]
            if np.isfinite(measured).any():
                squares = (measured if errors is None else errors[rows, k]) ** 2
                mean = 0.0 if errors is not None else np.nanmean(measured)
                parts.append(f"{quantity} {np.sqrt(np.nanmean(squares) - mean**2):.3g}")
        lines.append(f"{region} ({rows.sum()}): {', '.join(parts)}")
    return f"{name:26} " + "; ".join(lines)


def table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table; lines that begin with # are comments."""
    lines = (line for line in path.read_text().splitlines() if not line.startswith("#"))
    return list(csv.DictReader(lines))


def cmu(folder: Path) -> Iterator[WheelCase]:
    """Yield the smooth wheel in sand, with the constants that its authors tuned by hand."""
    rows = table(folder / "single_wheel/cmu_smooth.csv")
    column = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    angle, speed = np.deg2rad(column["beta"]), column["avg_Vx"]
    along = np.where(column["beta"] == 90, 0, speed * np.cos(angle))
    motion = np.vstack([column["avg_Vry"], along, speed * np.sin(angle)])
    values = [-column["avg_Fy"], column["avg_Fx"], np.full(angle.size, np.nan)]
    runs = WheelRuns(
        motion / np.abs(motion).max(axis=0),
        -column["avg_Fz"],
        np.column_stack([*values, -column["avg_Z"] / 1000]),
        column["Vry"] * 1000 + column["beta"],
    )
    is_driven = motion[0] >= motion[1]
    steep = column["beta"] == 90
    regions = {
        "all": ~np.zeros_like(steep),
        "driven, up to 45 deg": is_driven & (column["beta"] <= 45),
        "driven, 60 and 75 deg": is_driven & (column["beta"] > 45) & ~steep,
        "braked, up to 75 deg": ~is_driven & ~steep,
        "90 deg": steep,
    }
    tuned = Soil(
        cohesion=1000.0,
        friction_angle=np.deg2rad(29.0),
        cohesive_modulus=0.0,
        frictional_modulus=8e6,
        exponent=1.46,
        shear_along=0.021,
        shear_along_rate=0.0,
        shear_across=0.021,
        shear_across_rate=0.0,
    )
    priors = {
        "cohesion": (200.0, 200.0),
        "friction_angle": (0.56, 0.1),
        "frictional_modulus": (4e6, 4e6),
        "exponent": (1.2, 0.4),
        "shear_along": (0.015, 0.01),
        "shear_across": (0.015, 0.01),
        "exit_depth": (0.8, 0.4),
        "peak": (0.4, 0.15),
    }
    size = WheelSize(0.058, 0.05)
    yield WheelCase("CMU smooth wheel, sand", runs, size, tuned, priors, 2, regions)
    few = regions["driven, up to 45 deg"]
    words = "CMU smooth wheel, sand, fitted only where driven, up to 45 deg"
    yield WheelCase(words, runs.take(few), size, tuned, priors, 2, {"all": few[few]})


def ishigami(folder: Path) -> Iterator[WheelCase]:
    """Yield both wheels of Ishigami with the published constants; their load is assumed."""
    soil = known_soil("regolith_simulant")
    names = {"Fx_N": "pull", "Fy_N": "side"}
    for wheel, words in (("B", "paddles"), ("A", "smooth")):
        rows = [
            row
            for row in table(folder / "single_wheel/ishigami2005.csv")
            if row["wheel"] == wheel and row["figure"] in ("Fig7", "Fig9")
        ]
        slip = np.array([float(row["slip"]) for row in rows])
        degrees = np.array([float(row["slip_angle_deg"]) for row in rows])
        values = np.full((slip.size, 4), np.nan)
        for k, row in enumerate(rows):
            values[k, list(QUANTITIES).index(names[row["quantity"]])] = float(row["value"])
        runs = WheelRuns(
            motion_at_slip(slip, np.deg2rad(degrees)),
            np.full(slip.size, ISHIGAMI_LOAD),
            values,
            np.round(10 * slip) + 1000 * degrees,
        )
        priors = {
            name: (getattr(soil, name), deviation)
            for name, deviation in (
                ("friction_angle", 0.1),
                ("shear_along", 0.02),
                ("shear_along_rate", 0.03),
                ("shear_across", 0.01),
                ("shear_across_rate", 0.03),
                ("exit_depth", 0.3),
                ("peak", 0.1),
            )
        }
        regions = {"all": slip > -2, "slip <= 0.5": slip <= 0.5}
        yield WheelCase(f"Ishigami, {words}", runs, WheelSize(0.09, 0.11), soil, priors, 2, regions)


PAPERS = "drawbar_pull_n", "torque_nm", "sinkage_m"  # columns of measured values


def papers(folder: Path) -> Iterator[WheelCase]:
    """Yield the wheels of three papers, with the constants that the collection states."""
    simulants = {row["simulant"]: row for row in table(folder / "single_wheel/soil_simulants.csv")}
    rows = table(folder / "single_wheel/single_wheel_experiments.csv")
    for source, grousers in dict.fromkeys((row["source"], row["grouser_height_m"]) for row in rows):
        own = [
            row for row in rows if (row["source"], row["grouser_height_m"]) == (source, grousers)
        ]
        size = WheelSize(float(own[0]["wheel_radius_m"]), float(own[0]["wheel_width_m"]))
        shear = float(own[0]["soil_shear_modulus_k_m"])
        soil = replace(
            simulant(simulants[own[0]["soil_simulant"]], size.width),
            shear_along=shear,
            shear_across=shear,
            grouser_height=float(grousers),
        )
        slip, load, pull, torque, sinkage = (
            np.array([float(row[name] or "nan") for row in own])
            for name in ("slip", "vertical_load_n", *(f"meas_{name}" for name in PAPERS))
        )
        values = np.column_stack([pull, np.full(slip.size, np.nan), torque, sinkage])
        runs = WheelRuns(motion_at_slip(slip, 0 * slip), load, values, np.arange(float(slip.size)))
        priors = {
            "friction_angle": (soil.friction_angle, 0.1),
            "frictional_modulus": (soil.frictional_modulus, soil.frictional_modulus),
            "shear_along": (shear, shear),
        }
        words = f"{source}, grousers {1e3 * float(grousers):g} mm"
        regions = {"all": slip > -2}
        yield WheelCase(words, runs, size, soil, priors, slip.size, regions)


def simulant(row: dict[str, str], width: float) -> Soil:
    """Return a soil of the table of simulants; both moduli of sinkage are one for the width."""
    cohesive, frictional = (
        1e3 * float(row[name]) for name in ("k_c_kN_per_m_n_plus_1", "k_phi_kN_per_m_n_plus_2")
    )
    return Soil(
        cohesion=1e3 * float(row["cohesion_kPa"]),
        friction_angle=np.deg2rad(float(row["friction_angle_deg"])),
        cohesive_modulus=0.0,
        frictional_modulus=cohesive / width + frictional,
        exponent=float(row["n"]),
        shear_along_rate=0.0,
        shear_across_rate=0.0,
        density=float(row["density_kg_per_m3"]),
    )


# ---------------------------------------------------------------------------------------------
# A wheel on slopes that it has not seen


SLOPE_LOAD, SLOPE_SIZE = 17.5 * 9.81, WheelSize(0.225, 0.2)  # the width is an assumption [N], [m]
PREDICTED_SLOPES = (15.0, 20.0, 25.0)  # [deg]
SLIP_DEVIATION = 0.02  # of a measured slip ratio: digitising and repeats
SLIPS = np.concatenate([np.linspace(-0.04, 0.4, 15), np.linspace(0.46, 0.98, 8)])
SAMPLES = 4000  # of the prior
PRIORS: dict[str, Callable[[Any, int], np.ndarray]] = {  # about the constants of GRC-1
    "cohesion": lambda rng, n: 250.0 * np.exp(rng.normal(0, 0.5, n)),
    "friction_angle": lambda rng, n: np.deg2rad(np.clip(rng.normal(38, 4, n), 20, 50)),
    "frictional_modulus": lambda rng, n: 508.5e3 * np.exp(rng.normal(0, 0.5, n)),
    "exponent": lambda rng, n: np.clip(rng.normal(0.8, 0.15, n), 0.4, 1.4),
    "shear_along": lambda rng, n: 0.015 * np.exp(rng.normal(0, 0.5, n)),
    "exit_depth": lambda rng, n: rng.uniform(0.0, 1.2, n),
    "peak": lambda rng, n: rng.uniform(0.2, 0.6, n),
    "grouser_height": lambda rng, n: rng.uniform(0.0, 0.03, n),
    "exponent_slip": lambda rng, n: rng.uniform(0.0, 0.8, n),  # as fitted to wheels of two papers
}


def slopes(folder: Path) -> Iterator[str]:
    """Yield the slip predicted on steep slopes from gentle ones, by both laws.

    Constants are drawn from the prior and weighted by the likelihood of the measured slips. On a
    slope, the wheel pulls its weight's part along it, and bears the part across it.
    """
    rows = table(folder / "single_wheel/mgru3_gentle_slopes.csv")
    measured = np.array([[float(row["slope_deg"]), float(row["slip"])] for row in rows])
    yield (
        f"MGRU3, {SLOPE_LOAD:.1f} N, width assumed {SLOPE_SIZE.width:g} m: slips "
        + ", ".join(f"{slip:.3f} at {slope:.1f} deg" for slope, slip in measured)
    )
    for name, without in ((PUBLISHED, ("exponent_slip",)), (SINKAGE, ())):
        rng = np.random.default_rng(SEED)
        drawn = {key: draw(rng, SAMPLES) for key, draw in PRIORS.items()}
        constants = {key: values for key, values in drawn.items() if key not in without}
        model = slope_model(tuple(constants))
        theta = np.array(list(constants.values()))
        computed = np.array([slip_on_slope(model, theta, slope) for slope in measured[:, 0]])
        misfit = ((computed - measured[:, 1:]) / SLIP_DEVIATION) ** 2
        weight = np.exp(-misfit.sum(axis=0) / 2)
        evidence, weight = weight.mean(), weight / weight.sum()
        kept = weight > 1e-4 * weight.max()
        effective = 1 / (weight**2).sum()
        yield f"  {name}: {effective:.0f} effective of {SAMPLES} samples, evidence {evidence:.3g}"
        for slope in (*measured[:, 0], *PREDICTED_SLOPES):
            slip = slip_on_slope(model, theta[:, kept], slope)
            blurred = slip + rng.normal(0, SLIP_DEVIATION, slip.size)
            levels, shares = (0.025, 0.5, 0.975), weight[kept]
            low, middle, high = np.quantile(blurred, levels, weights=shares, method="inverted_cdf")
            stuck = weight[kept][slip >= SLIPS[-1]].sum() / weight[kept].sum()
            yield (
                f"    {slope:5.1f} deg: slip {middle:.3f} (95 % interval {low:.3f} to "
                f"{min(high, 1):.3f}), cannot climb with probability {stuck:.2f}"
            )
        narrowed = {
            key: np.sqrt(np.cov(values, aweights=weight, ddof=0)) / values.std()
            for key, values in constants.items()
        }
        words = ", ".join(f"{key} {ratio:.2f}" for key, ratio in narrowed.items())
        yield f"    deviation after over before: {words}"
        open_ = [key for key, ratio in narrowed.items() if ratio > 0.9]
        yield f"    not determined by these slopes: {', '.join(open_)}"


def slope_model(names: tuple[str, ...]) -> ca.Function:
    """Return normal force with its derivative by the depth, and pull, for constants and slips."""
    theta = ca.SX.sym("theta", len(names))
    depth, slip = ca.SX.sym("depth"), ca.SX.sym("slip")
    values: dict[str, Any] = {name: theta[k] for k, name in enumerate(names)}
    base = Soil(cohesive_modulus=0.0, shear_along_rate=0.0, shear_across_rate=0.0, density=1620.0)
    forces = forces_at_slip(replace(base, **values), SLOPE_SIZE, depth, slip, 0.0)
    stiffness = ca.jacobian(forces.normal, depth)
    return ca.Function("forces", [theta, depth, slip], [forces.normal, stiffness, forces.pull])


def slip_on_slope(model: ca.Function, theta: np.ndarray, degrees: float) -> np.ndarray:
    """Return the slip ratios with which a wheel climbs a slope, shape (n,); 1 if it cannot."""
    count, angle = theta.shape[1], np.deg2rad(degrees)
    load, needed = SLOPE_LOAD * np.cos(angle), SLOPE_LOAD * np.sin(angle)
    many = np.repeat(theta, SLIPS.size, axis=1)
    slip = np.tile(SLIPS, count)[None]
    radius = SLOPE_SIZE.radius
    low, high = np.zeros_like(slip), np.full_like(slip, radius)
    depth = np.full_like(slip, 0.1 * radius)
    for _ in range(10):
        normal, stiffness, pull = (each.full() for each in model(many, depth, slip))
        low, high = np.where(normal > load, low, depth), np.where(normal > load, depth, high)
        new = depth - (normal - load) / stiffness
        depth = np.where((new > low) & (new < high), new, (low + high) / 2)
    pull = np.where(depth > 0.999 * radius, -np.inf, pull).reshape(count, SLIPS.size)
    enough = pull >= needed
    first = enough.argmax(axis=1)
    rows, before = np.arange(count), np.maximum(first - 1, 0)
    a, b = pull[rows, before], pull[rows, first]
    share = np.where(first > 0, (needed - a) / np.where(b > a, b - a, 1), 0)
    found = SLIPS[before] + share * (SLIPS[first] - SLIPS[before])
    return np.where(enough.any(axis=1), found, 1.0)


def main() -> None:
    """Print the comparison with measurements."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--wheels", action="store_true", help="only wheels in soil")
    given = parser.parse_args()
    parts = [
        drives(given.folder),
        turning(given.folder),
        *(
            cross_validated(case)
            for cases in (cmu, ishigami, papers)
            for case in cases(given.folder)
        ),
        slopes(given.folder),
    ]
    if given.wheels:
        parts = parts[2:]
    for part in parts:
        for line in part:
            print(line, flush=True)
        print()
