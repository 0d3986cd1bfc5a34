"""Measurements: a robot's log, wheels in soil, and fits of known truth.

``python benchmarks measured FOLDER [--figures DIR]`` reads public data that are not part of the
project (sources: docs/measured.md):

- ``drive/husky_long.csv.gz``: windows of 2 s of a Husky, wheel rates and poses of a lidar;
- ``single_wheel/cmu_smooth.csv``: a smooth wheel in sand;
- ``single_wheel/ishigami2005.csv``: two wheels in a regolith simulant;
- ``single_wheel/single_wheel_experiments.csv``: three papers on wheels in soil.

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
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from scipy.optimize import least_squares

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
from slipfree.fit.body_motion import body_motion
from slipfree.fit.calibration import (
    Calibration,
    bootstrap,
    calibrate,
    heading_median,
    heading_rms,
    position_median,
    position_rms,
)
from slipfree.fit.estimate import estimate
from slipfree.fit.unknowns import Unknown, parametric_model
from slipfree.fit.windows import Log, Windows, cut
from slipfree.laws.soil import Soil, WheelSize, forces_at_slip
from slipfree.laws.soils import known_soil

LEVEL = Analytic(lambda x, _: 0 * x, mu=0.6)
DRAWS, WINDOWS = 200, 60  # of synthetic poses
STEADY, TURNING = 0.6, 2.0  # of the rates of the sides: spread, least difference [rad/s]
HUSKY_STEP = 0.05  # time between samples of the log [s]
HUSKY_RADIUS, HUSKY_TRACK, HUSKY_BASE = 0.165, 0.57, 0.51  # of the data sheet [m]
ISHIGAMI_LOAD = 64.68  # as codes that cite the paper assume; the paper does not state it [N]
PRIOR = 0.5  # deviation of the logarithm of a soil constant before a fit
HALVINGS = 45  # of the interval of the sinkage
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
    exact = estimate(dae, nominal, law, SKID_UNKNOWNS, windows, "linear")
    yield f"{WINDOWS} windows without errors: largest error {np.abs(exact.values - true).max():.1e}"
    rng, found = np.random.default_rng(SEED), []
    for _ in range(DRAWS):
        noise = rng.normal(size=windows.end.shape) * [0.01, 0.01, 0.005]
        found.append(
            estimate(dae, nominal, law, SKID_UNKNOWNS, windows._replace(end=windows.end + noise))
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
        dae = parametric_model(robot.build, robot.vehicle, robot.law, robot.unknowns)
        windows = cut(husky_log(folder, body_motion(dae).names, robot.rates))
        began = time.process_time()
        found = calibrate(robot.build, robot.vehicle, robot.law, robot.unknowns, windows, seed=SEED)
        took = time.process_time() - began
        for words, errors in (("nominal", found.test.nominal), ("fitted", found.test.fitted)):
            yield f"{robot.words:30} {words:8} {_accuracy(errors)}"
        yield from _estimates(found, took)
        if figures and robot.words == "quasi-static friction":
            _save_fit(found, figures)


def turning(folder: Path) -> Iterator[str]:
    """Yield the scatter of the turning rate over the difference of the sides, at steady rates."""
    with gzip.open(folder / "drive/husky_long.csv.gz", "rt") as file:
        rows = list(csv.DictReader(file))
    step, number, left, right, yaw = (
        np.array([float(row[name]) for row in rows])
        for name in ("calib_step", "window", "wl_radps", "wr_radps", "yaw")
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


def _accuracy(errors: np.ndarray) -> str:
    """Return the errors of end poses in words, with bootstrap intervals."""
    place, turn = bootstrap(errors, position_rms), bootstrap(errors, heading_rms)
    low, high = np.rad2deg([turn.lower, turn.upper])
    return (
        f"{place.value:.3f} ({place.lower:.3f} to {place.upper:.3f})      "
        f"{position_median(errors):.3f}   {np.rad2deg(turn.value):5.1f} ({low:.1f} to {high:.1f})"
        f"       {np.rad2deg(heading_median(errors)):.1f}"
    )


def _estimates(found: Calibration, took: float) -> Iterator[str]:
    """Yield the estimates of a fit in words."""
    result = found.estimate
    parts = []
    for k, label in enumerate(result.labels):
        low, high = result.intervals[k]
        edge = "at its bound" if result.at_bound[k] else f"{low:.4f} to {high:.4f}"
        parts.append(f"{label.name} {result.values[k]:.4f} ({edge})")
    yield (
        f"  {len(found.train.measured)} windows, {result.evaluations} evaluations, "
        f"{took:.1f} s CPU: {', '.join(parts)}"
    )


def _save_fit(found: Calibration, figures: Path) -> None:
    """Save the figure of a fit."""
    from slipfree.show.fit_figures import fit_plot
    from slipfree.show.plots import save

    save([fit_plot("measured_husky", found)], figures)


# ---------------------------------------------------------------------------------------------
# Wheels in soil


class Points(NamedTuple):
    """Measured points of a wheel: slip ratio, slip angle [rad], load [N], group, and quantities.

    Values of pull and side [N], torque [N m] and sinkage [m] are NaN where they were not measured.
    Points of one group are fitted or judged together.
    """

    slip: np.ndarray
    angle: np.ndarray
    load: np.ndarray
    group: np.ndarray
    values: dict[str, np.ndarray]

    def take(self, rows: np.ndarray) -> Points:
        """Return some of the points."""
        parts = (each[rows] for each in self[:4])
        return Points(*parts, {name: each[rows] for name, each in self.values.items()})


class WheelCase(NamedTuple):
    """A wheel in soil: points, size, constants before the fit, and names of those to be fitted."""

    words: str
    points: Points
    size: WheelSize
    soil: Soil
    constants: tuple[str, ...]
    regions: dict[str, Callable[[Points], np.ndarray]]


class WheelModel:
    """Forces on a wheel, and their derivatives by the logarithms of soil constants."""

    def __init__(self, case: WheelCase) -> None:
        theta = ca.SX.sym("theta", len(case.constants))
        values = {
            name: getattr(case.soil, name) * ca.exp(theta[k])
            for k, name in enumerate(case.constants)
        }
        at = [ca.SX.sym(name) for name in ("depth", "slip", "angle")]
        normal, pull, side, torque = forces_at_slip(replace(case.soil, **values), case.size, *at)
        rows = ca.vertcat(pull, -side, torque)
        self.radius = case.size.radius
        self.normal = ca.Function("normal", [theta, *at], [normal])
        self.forces = ca.Function(
            "forces",
            [theta, *at],
            [
                rows,
                ca.densify(ca.jacobian(rows, at[0])),
                ca.densify(ca.jacobian(rows, theta)),
                ca.jacobian(normal, at[0]),
                ca.densify(ca.jacobian(normal, theta)),
            ],
        )

    def __call__(self, theta: np.ndarray, points: Points) -> tuple[np.ndarray, np.ndarray]:
        """Return pull, side, torque and sinkage, shape (n, 4), and derivatives (n, 4, n_theta)."""
        count = points.slip.size
        many = np.tile(theta[:, None], count)
        at = points.slip[None], points.angle[None]
        low, high = np.zeros((1, count)), np.full((1, count), self.radius)
        normal = self.normal.map(count)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            deep = normal(many, middle, *at).full() > points.load
            low, high = np.where(deep, low, middle), np.where(deep, middle, high)
        depth = (low + high) / 2
        rows, by_depth, by_theta, stiff, softer = (
            each.full() for each in self.forces.map(count)(many, depth, *at)
        )
        sinking = -softer.reshape(count, -1) / stiff.T
        direct = by_theta.reshape(3, count, -1).transpose(1, 0, 2)
        slopes = direct + by_depth.T[..., None] * sinking[:, None]
        values = np.column_stack([rows.T, depth.T])
        return values, np.concatenate([slopes, sinking[:, None]], axis=1)


QUANTITIES = ("pull", "side", "torque", "sinkage")


def fit_soil(model: WheelModel, case: WheelCase, points: Points) -> np.ndarray:
    """Return the logarithms of the constants, from points; quantities count equally."""
    measured = np.column_stack([points.values[name] for name in QUANTITIES])
    known = np.isfinite(measured)
    size = np.array(
        [np.std(each[k]) if k.any() else 1.0 for each, k in zip(measured.T, known.T, strict=True)]
    )

    def residual(theta: np.ndarray) -> np.ndarray:
        values, _ = model(theta, points)
        return np.append(((values - measured) / size)[known] / 0.2, theta / PRIOR)

    def jacobian(theta: np.ndarray) -> np.ndarray:
        _, slopes = model(theta, points)
        rows = (slopes / size[:, None])[known] / 0.2
        return np.concatenate([rows, np.eye(theta.size) / PRIOR])

    start = np.zeros(len(case.constants))
    top = np.full(start.size, 2.0)
    for k, name in enumerate(case.constants):
        most = {"peak": 0.8, "friction_angle": 0.9, "exit_depth": 1.5, "exponent": 2.5}.get(name)
        if most is not None:
            top[k] = np.log(most / getattr(case.soil, name))
    low = np.full(start.size, -3.0)
    if "peak" in case.constants:
        low[case.constants.index("peak")] = np.log(1.05 * case.soil.peak_rate / case.soil.peak)
    return least_squares(residual, start, jacobian, bounds=(low, top), loss="soft_l1").x


def two_fold(case: WheelCase) -> Iterator[str]:
    """Yield rms errors of points by constants that were fitted to the other half of the points."""
    model, zero = WheelModel(case), np.zeros(len(case.constants))
    groups = np.unique(case.points.group)
    half = np.random.default_rng(SEED).permutation(groups.size) % 2
    side_of = dict(zip(groups.tolist(), half.tolist(), strict=True))
    fold = np.array([side_of[each] for each in case.points.group.tolist()])
    before, _ = model(zero, case.points)
    after, fitted = np.empty_like(before), []
    for k in (0, 1):
        theta = fit_soil(model, case, case.points.take(fold == k))
        after[fold != k] = model(theta, case.points.take(fold != k))[0]
        fitted.append(theta)
    values = [
        getattr(case.soil, name) * np.exp(np.array(fitted)[:, k])
        for k, name in enumerate(case.constants)
    ]
    yield f"{case.words}: constants before, and fitted to each half"
    yield "  " + ", ".join(
        f"{name} {getattr(case.soil, name):.3g} -> {a:.3g} / {b:.3g}"
        for name, (a, b) in zip(case.constants, values, strict=True)
    )
    for words, region in case.regions.items():
        rows = region(case.points)
        for k, name in enumerate(QUANTITIES):
            measured = case.points.values[name][rows]
            known = np.isfinite(measured)
            if known.any():
                errors = [(each[rows, k] - measured)[known] for each in (before, after)]
                rms = [float(np.sqrt(np.mean(each**2))) for each in errors]
                yield (
                    f"  {words:28} {name:8} {known.sum():4} points, range "
                    f"{np.nanmin(measured):8.3g} to {np.nanmax(measured):8.3g}: rms before "
                    f"{rms[0]:8.3g}, fitted on the other half {rms[1]:8.3g}"
                )


def table(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table; lines that begin with # are comments."""
    lines = (line for line in path.read_text().splitlines() if not line.startswith("#"))
    return list(csv.DictReader(lines))


def everything(points: Points) -> np.ndarray:
    """Return the mask of all points."""
    return np.ones(points.slip.size, dtype=bool)


def cmu(folder: Path) -> Iterator[WheelCase]:
    """Yield the smooth wheel in sand, with the constants that its authors tuned by hand."""
    rows = [row for row in table(folder / "single_wheel/cmu_smooth.csv") if float(row["beta"]) < 80]
    column = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    angle = np.deg2rad(column["beta"])
    forward, rim = column["avg_Vx"] * np.cos(angle), column["avg_Vry"]
    points = Points(
        (rim - forward) / np.maximum(rim, forward),
        angle,
        -column["avg_Fz"],
        column["Vry"] * 1000 + column["beta"],
        {
            "pull": -column["avg_Fy"],
            "side": column["avg_Fx"],
            "torque": np.full(angle.size, np.nan),
            "sinkage": -column["avg_Z"] / 1000,
        },
    )
    regions = {
        "all": everything,
        "driven, slip angle <= 45 deg": lambda p: (p.slip >= 0) & (p.angle < 0.8),
        "driven, slip angle > 45 deg": lambda p: (p.slip >= 0) & (p.angle > 0.8),
        "braked": lambda p: p.slip < 0,
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
    constants = (
        "cohesion",
        "friction_angle",
        "frictional_modulus",
        "exponent",
        "shear_along",
        "shear_across",
        "exit_depth",
        "peak",
    )
    size, driven = WheelSize(0.058, 0.05), "driven, slip angle <= 45 deg"
    yield WheelCase("CMU smooth wheel, sand", points, size, tuned, constants, regions)
    few = points.take(regions[driven](points))
    words = f"CMU smooth wheel, sand, fitted only where {driven}"
    yield WheelCase(words, few, size, tuned, constants, {"all": everything})


def ishigami(folder: Path) -> Iterator[WheelCase]:
    """Yield both wheels of Ishigami with the published constants."""
    soil = known_soil("regolith_simulant")
    names = {"Fx_N": "pull", "Fy_N": "side"}
    regions = {"slip <= 0.5": lambda p: p.slip <= 0.5, "all": everything}
    for wheel, words in (("B", "paddles"), ("A", "smooth")):
        rows = [
            row
            for row in table(folder / "single_wheel/ishigami2005.csv")
            if row["wheel"] == wheel and row["figure"] in ("Fig7", "Fig9")
        ]
        slip = np.array([float(row["slip"]) for row in rows])
        degrees = np.array([float(row["slip_angle_deg"]) for row in rows])
        values = {
            name: np.array(
                [float(row["value"]) if names[row["quantity"]] == name else np.nan for row in rows]
            )
            if name in names.values()
            else np.full(slip.size, np.nan)
            for name in QUANTITIES
        }
        group = np.round(10 * slip) + 1000 * degrees
        load = np.full(slip.size, ISHIGAMI_LOAD)
        points = Points(slip, np.deg2rad(degrees), load, group, values)
        constants = (
            "friction_angle",
            "shear_along",
            "shear_along_rate",
            "shear_across",
            "shear_across_rate",
            "exit_depth",
            "peak",
        )
        yield WheelCase(
            f"Ishigami, {words}", points, WheelSize(0.09, 0.11), soil, constants, regions
        )


def papers(folder: Path) -> Iterator[WheelCase]:
    """Yield the wheels of three papers, with the constants that the collection states."""
    simulants = {row["simulant"]: row for row in table(folder / "single_wheel/soil_simulants.csv")}
    rows = table(folder / "single_wheel/single_wheel_experiments.csv")
    kinds = dict.fromkeys((row["source"], row["grouser_height_m"]) for row in rows)
    for source, grousers in kinds:
        own = [
            row for row in rows if (row["source"], row["grouser_height_m"]) == (source, grousers)
        ]
        first, known = own[0], simulants[own[0]["soil_simulant"]]
        width = float(first["wheel_width_m"])
        stiffness = 1e3 * (
            float(known["k_c_kN_per_m_n_plus_1"]) / width + float(known["k_phi_kN_per_m_n_plus_2"])
        )
        shear = float(first["soil_shear_modulus_k_m"])
        soil = Soil(
            cohesion=1e3 * float(known["cohesion_kPa"]),
            friction_angle=np.deg2rad(float(known["friction_angle_deg"])),
            cohesive_modulus=0.0,
            frictional_modulus=stiffness,
            exponent=float(known["n"]),
            shear_along=shear,
            shear_along_rate=0.0,
            shear_across=shear,
            shear_across_rate=0.0,
            density=float(known["density_kg_per_m3"]),
            grouser_height=float(grousers),
        )

        def numbers(name: str, own: list[dict[str, str]] = own) -> np.ndarray:
            return np.array([float(row[name] or "nan") for row in own])

        slip = numbers("slip")
        points = Points(
            slip,
            np.zeros(slip.size),
            numbers("vertical_load_n"),
            slip,
            {
                "pull": numbers("meas_drawbar_pull_n"),
                "side": np.full(slip.size, np.nan),
                "torque": numbers("meas_torque_nm"),
                "sinkage": numbers("meas_sinkage_m"),
            },
        )
        size = WheelSize(float(first["wheel_radius_m"]), width)
        words = f"{source}, grousers {1e3 * float(grousers):g} mm"
        constants = ("friction_angle", "frictional_modulus", "shear_along", "exit_depth", "peak")
        yield WheelCase(words, points, size, soil, constants, {"all": everything})


def main() -> None:
    """Print the comparison with measurements."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--figures", type=Path)
    given = parser.parse_args()
    parts: list[Iterator[str]] = [synthetic()]
    if given.folder:
        parts = [
            husky(given.folder, given.figures),
            turning(given.folder),
            *(two_fold(case) for cases in (ishigami, cmu, papers) for case in cases(given.folder)),
            *parts,
        ]
    for part in parts:
        for line in part:
            print(line, flush=True)
        print()
