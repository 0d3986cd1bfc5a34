"""Measurements: a robot's log, wheels in soil, and fits of known truth.

``python benchmarks measured FOLDER [--figures DIR]`` reads public data that are not part of the
project (sources: docs/measured.md, docs/measured_wheels.md):

- ``drive/husky_long.csv.gz``: windows of 2 s of a Husky, wheel rates and poses of a lidar;
- ``single_wheel/cmu_smooth.csv``: a smooth wheel in sand;
- ``single_wheel/ishigami2005.csv``: two wheels in a regolith simulant;
- ``single_wheel/single_wheel_experiments.csv``: three papers on wheels in soil;
- ``single_wheel/mgru3_gentle_slopes.csv``: a wheel on slopes, which predicts steeper ones.

Nothing is fitted to the points that judge it. Without FOLDER, only the fits of synthetic data with
known truth are made: bias, and coverage of the 95 % intervals.
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
import numpy as np

from slipfree import (
    Analytic,
    Coulomb,
    LeastSlip,
    catalog,
    direct_kinematics,
    quasi_statics,
    settle,
    simulate,
)
from slipfree.fit import estimate as fits
from slipfree.fit.body_motion import body_motion
from slipfree.fit.unknowns import Unknown, parametric_model
from slipfree.fit.wheel_soil import QUANTITIES, fit_soil, repeat_spread
from slipfree.fit.windows import Log, Windows, cut
from slipfree.laws.soil import Soil, WheelSize, forces_at_slip
from slipfree.laws.soils import known_soil
from slipfree.models.single_wheel import WheelRuns, motion_at_slip

LEVEL = Analytic(lambda x, _: 0 * x, mu=0.6)
DRAWS, WINDOWS = 200, 60  # of synthetic poses
STEADY, TURNING = 0.6, 2.0  # of the rates of the sides: spread, least difference [rad/s]
HUSKY_STEP = 0.05  # time between samples of the log [s]
HUSKY_RADIUS, HUSKY_TRACK, HUSKY_BASE = 0.165, 0.57, 0.51  # of the data sheet [m]
HUSKY_FITTED = 0.139  # rolling radius of a fit [m]
ISHIGAMI_LOAD = 64.68  # as codes that cite the paper assume; the paper does not state it [N]
SEED = 0


# ---------------------------------------------------------------------------------------------
# Fits of known truth


def sides(end: str) -> tuple[str, str]:
    """Return the names of the wheels on one side."""
    return f"front_{end}", f"rear_{end}"


SKID_UNKNOWNS = (
    Unknown("radius_left", "radius", sides("left")),
    Unknown("radius_right", "radius", sides("right")),
    Unknown("track", "track"),
    Unknown("center_of_mass_ahead", "center_of_mass_ahead", lower=-0.25, upper=0.25),
    Unknown("creep", "creep"),
)


def kinematic(vehicle: Any, law: Any) -> Any:
    """Return a kinematic model on level ground."""
    return direct_kinematics(vehicle, LEVEL, slip=law)


def static(vehicle: Any, law: Any) -> Any:
    """Return a quasi-static model on level ground."""
    return quasi_statics(vehicle, LEVEL, law=law)


def true_windows(names: Sequence[str]) -> Windows:
    """Return windows of the simulated motion of a skid-steer cart with other numbers.

    The rates of both sides are constant within a window.
    """
    truth = catalog.skid_steer(half_track=0.31, r2=0.125, center_of_mass=(0.0, 0.04, 0.0))
    model, rng = static(truth, Coulomb(0.05)), np.random.default_rng(SEED)
    left, right = rng.uniform(-6, 6, (2, WINDOWS))
    rates = {name: left if "left" in name else right for name in names}
    times = 2.0 * np.arange(WINDOWS + 1)
    run = simulate(model, settle(model), model.inputs(**rates), times)
    rows = np.column_stack([np.arange(WINDOWS), np.arange(1, WINDOWS + 1)]).ravel()
    given = np.column_stack([np.repeat(rates[name], 2) for name in names])
    pose = np.column_stack([run[key] for key in ("x", "y", "heading")])
    return _cut_at(run.t[rows], given, pose[rows])


def _cut_at(t: np.ndarray, given: np.ndarray, pose: np.ndarray) -> Windows:
    """Return windows of two samples each; headings may turn by more than half a turn."""
    found = cut(Log(t, given, pose, np.repeat(np.arange(len(t) // 2), 2)))
    turned = pose[1::2, 2] - pose[::2, 2]
    return found._replace(end=np.column_stack([found.end[:, :2], turned]))


def synthetic() -> Iterator[str]:
    """Yield bias and coverage of fits of synthetic windows with normal errors of the end poses."""
    true = np.array([0.155, 0.155, 0.62, 0.04, 0.05])
    nominal, law = catalog.skid_steer(), Coulomb(0.1)
    dae = parametric_model(static, nominal, law, SKID_UNKNOWNS)
    windows = true_windows(body_motion(dae).names)
    exact = fits.estimate(dae, law, SKID_UNKNOWNS, windows, "linear")
    yield f"{WINDOWS} windows without errors: largest error {np.abs(exact.values - true).max():.1e}"
    rng, found = np.random.default_rng(SEED), []
    for _ in range(DRAWS):
        noise = rng.normal(size=windows.end.shape) * [0.01, 0.01, 0.005]
        found.append(
            fits.estimate(dae, law, SKID_UNKNOWNS, windows._replace(end=windows.end + noise))
        )
    values = np.array([each.values for each in found])
    inside = np.mean(
        [(each.intervals[:, 0] <= true) & (true <= each.intervals[:, 1]) for each in found], axis=0
    )
    spread = values.std(axis=0, ddof=1)
    stated = np.mean([np.sqrt(np.diag(each.covariance)) for each in found], axis=0)
    yield f"{DRAWS} draws, errors of 10 mm and 5 mrad: bias, deviation, stated, coverage of 95 %"
    for k, unknown in enumerate(SKID_UNKNOWNS):
        bias, error = values[:, k].mean() - true[k], spread[k] / np.sqrt(DRAWS)
        yield (
            f"  {unknown.name:21} truth {true[k]:5.3f}, bias {bias:+.1e} (standard error "
            f"{error:.1e}), deviation {spread[k]:.2e}, stated {stated[k]:.2e}, coverage "
            f"{100 * inside[k]:.1f} %"
        )
    yield f"  all {values.shape[1]}: {100 * inside.mean():.1f} % inside"


# ---------------------------------------------------------------------------------------------
# Husky


class Robot(NamedTuple):
    """A model of the Husky, and its unknowns."""

    words: str
    vehicle: Any
    law: Any
    build: Callable[[Any, Any], Any]
    unknowns: tuple[Unknown, ...]
    rates: str = "measured"


SHAPE = {"half_track": HUSKY_TRACK / 2, "r1": 0.05, "r2": HUSKY_RADIUS - 0.05}
RIGID = catalog.rigid_skid_steer(wheelbase=HUSKY_BASE, **SHAPE)
ROCKING = catalog.skid_steer(
    wheelbase=HUSKY_BASE, mass=42.0, center_of_mass=(0.0, 0.0, 0.05), **SHAPE
)
CART = catalog.differential_drive(caster_scale=0.3, **SHAPE)
SENSOR = (Unknown("sensor_right", "sensor_right"), Unknown("sensor_ahead", "sensor_ahead"))
CART_UNKNOWNS = (
    Unknown("radius_left", "radius", ("left",)),
    Unknown("radius_right", "radius", ("right",)),
    Unknown("track", "track"),
)
ROBOTS = (
    Robot("differential drive", CART, LeastSlip(), kinematic, CART_UNKNOWNS),
    Robot("differential drive, commands", CART, LeastSlip(), kinematic, CART_UNKNOWNS, "commanded"),
    Robot("least slip", RIGID, LeastSlip(), kinematic, SKID_UNKNOWNS[:3]),
    Robot("least slip, sensor", RIGID, LeastSlip(), kinematic, (*SKID_UNKNOWNS[:3], *SENSOR)),
    Robot("quasi-static friction", ROCKING, Coulomb(0.1), static, SKID_UNKNOWNS),
)


def husky_log(folder: Path, names: Sequence[str], rates: str) -> Log:
    """Return the log of the Husky for the inputs of a model."""
    with gzip.open(folder / "drive/husky_long.csv.gz", "rt") as file:
        rows = list(csv.DictReader(file))
    column = {name: np.array([float(row[name]) for row in rows]) for name in rows[0] if name != "z"}
    keys = ("wl_radps", "wr_radps") if rates == "measured" else ("cmd_left", "cmd_right")
    left, right = (column[key] for key in keys)
    inputs = {True: left, False: right}
    given = np.column_stack(
        [inputs["left" in name] if name.endswith("_rate") else 0 * left for name in names]
    )
    pose = np.column_stack([-column["y"], column["x"], column["yaw"]])
    return Log(HUSKY_STEP * column["k"], given, pose, column["window"])


def husky(folder: Path, figures: Path | None) -> Iterator[str]:
    """Yield the errors of end poses of the nominal and of the fitted models."""
    yield (
        f"{'model':30} {'values':8} {'position rms (95 %) [m]':27} {'median':7} "
        f"{'heading rms (95 %) [deg]':25} {'median':6}"
    )
    for robot in ROBOTS:
        known = robot.build, robot.vehicle, robot.law, robot.unknowns
        dae = parametric_model(*known)
        windows = cut(husky_log(folder, body_motion(dae).names, robot.rates))
        began = time.process_time()
        found = fits.calibrate(*known, windows, seed=SEED)
        took = time.process_time() - began
        for words, errors in (("nominal", found.test.nominal), ("fitted", found.test.fitted)):
            yield f"{robot.words:30} {words:8} {_accuracy(errors)}"
        yield from _estimates(found, took)
        if figures and robot.words == "quasi-static friction":
            from slipfree.show.fit_figures import fit_plot
            from slipfree.show.plots import save

            save([fit_plot("measured_husky", found)], figures)


def turning(folder: Path) -> Iterator[str]:
    """Yield the scatter of the turning rate over the difference of the sides, at steady rates."""
    with gzip.open(folder / "drive/husky_long.csv.gz", "rt") as file:
        rows = list(csv.DictReader(file))
    names = (
        "calib_step",
        "window",
        "wl_radps",
        "wr_radps",
        "yaw",
        "x",
        "y",
        "cmd_left",
        "cmd_right",
    )
    step, number, left, right, yaw, x, y, *commands = (
        np.array([float(row[name]) for row in rows]) for name in names
    )
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


def _accuracy(errors: np.ndarray) -> str:
    """Return the errors of end poses in words, with bootstrap intervals."""
    statistics = fits.position_rms, fits.heading_rms
    place, turn = (fits.bootstrap(errors, each) for each in statistics)
    low, high = np.rad2deg([turn.lower, turn.upper])
    away, off = np.median([np.hypot(*errors.T[:2]), np.abs(errors[:, 2])], axis=1)
    return (
        f"{place.value:.3f} ({place.lower:.3f} to {place.upper:.3f})      "
        f"{away:.3f}   {np.rad2deg(turn.value):5.1f} ({low:.1f} to {high:.1f})"
        f"       {np.rad2deg(off):.1f}"
    )


def _estimates(found: fits.Calibration, took: float) -> Iterator[str]:
    """Yield the estimates of a fit in words."""
    result = found.estimate
    parts = []
    for k, label in enumerate(result.labels):
        low, high = result.intervals[k]
        edge = "at its bound" if result.at_bound[k] else f"{low:.4f} to {high:.4f}"
        parts.append(f"{label.name} {result.values[k]:.4f} ({edge})")
    yield (f"  {len(found.train.measured)} windows, {took:.1f} s CPU: {', '.join(parts)}")


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
FOLDINGS = 1  # random partitions of the runs


def variants(case: WheelCase) -> Iterator[tuple[str, Soil, list[Unknown]]]:
    """Yield the laws that are compared: name, soil before the fit, unknowns."""
    is_oblique = bool((case.runs.motion[2] != 0).any())
    rates = ["exponent_slip", *(["exponent_skid"] if (case.runs.motion[2] != 0).any() else [])]
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
        computed = []
        for seed in range(FOLDINGS if case.folds < runs.load.size else 1):
            fit = fit_soil(
                soil, case.size, unknowns, runs, folds=case.folds, resamples=0, seed=seed
            )
            computed.append(fit.validated - runs.values)
        if k == 0:
            before = [fit.nominal - runs.values]
            yield "  " + _errors_in_words("constants before the fit", case, before)
        yield "  " + _errors_in_words(name, case, computed)
        labels = zip(fit.estimate.labels, fit.estimate.intervals, strict=True)
        values = zip(labels, fit.estimate.values, fit.estimate.at_bound, strict=True)
        yield "    " + ", ".join(
            f"{label.name} {value:.3g} ({'at its bound' if edge else f'{low:.3g} to {high:.3g}'})"
            for (label, (low, high)), value, edge in values
        )
        if lost := fit.estimate.undetermined:
            yield f"    not determined: {', '.join(lost)}"


def _errors_in_words(name: str, case: WheelCase, errors: list[np.ndarray] | None) -> str:
    """Return rms errors in each region in words; without errors, the deviation of the data."""
    lines = []
    for region, rows in case.regions.items():
        parts = []
        for k, quantity in enumerate(QUANTITIES):
            measured = case.runs.values[rows, k]
            if np.isfinite(measured).any():
                squares = [np.nanmean(e[rows, k] ** 2) for e in errors or ()]
                value = np.sqrt(np.mean(squares)) if errors else np.nanstd(measured)
                parts.append(f"{quantity} {value:.3g}")
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
            for name in (
                "slip",
                "vertical_load_n",
                "meas_drawbar_pull_n",
                "meas_torque_nm",
                "meas_sinkage_m",
            )
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
            low, middle, high = weighted_quantiles(blurred, weight[kept], (0.025, 0.5, 0.975))
            stuck = weight[kept][slip >= SLIPS[-1]].sum() / weight[kept].sum()
            yield (
                f"    {slope:5.1f} deg: slip {middle:.3f} (95 % interval {low:.3f} to "
                f"{min(high, 1):.3f}), cannot climb with probability {stuck:.2f}"
            )
        narrowed = {
            key: weighted_deviation(values, weight) / values.std()
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


def weighted_quantiles(
    values: np.ndarray, weight: np.ndarray, levels: tuple[float, ...]
) -> np.ndarray:
    """Return quantiles of weighted values."""
    order = np.argsort(values)
    share = np.cumsum(weight[order]) / weight.sum()
    return np.interp(levels, share, values[order])


def weighted_deviation(values: np.ndarray, weight: np.ndarray) -> float:
    """Return the standard deviation of weighted values."""
    mean = (weight * values).sum() / weight.sum()
    return float(np.sqrt((weight * (values - mean) ** 2).sum() / weight.sum()))


def main() -> None:
    """Print the comparison with measurements."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--figures", type=Path)
    parser.add_argument("--wheels", action="store_true", help="only wheels in soil")
    given = parser.parse_args()
    if given.wheels and not given.folder:
        parser.error("expected a folder for --wheels")
    parts: list[Iterator[str]] = [synthetic()]
    if given.folder:
        parts = [
            husky(given.folder, given.figures),
            turning(given.folder),
            *(
                cross_validated(case)
                for cases in (cmu, ishigami, papers)
                for case in cases(given.folder)
            ),
            slopes(given.folder),
            *parts,
        ]
    if given.wheels:
        parts = parts[2:-1]
    for part in parts:
        for line in part:
            print(line, flush=True)
        print()
