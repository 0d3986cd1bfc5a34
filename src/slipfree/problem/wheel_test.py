"""Wheel files: a wheel, its load, a soil, slip ratios and slip angles; measured points and fits.

``slipfree wheel`` computes the forces on the wheel; ``slipfree fit``, or ``--fit``, fits the soil
to the points. A table of measured points takes the place of a file whose other keys are options.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from slipfree.core.errors import DataError
from slipfree.core.facts import Lines
from slipfree.core.records import Array
from slipfree.core.trajectory import Outcome
from slipfree.files import toml
from slipfree.files.tables import read_columns, read_names
from slipfree.files.vehicle_toml import toml_value
from slipfree.fit.estimate import Unknown, law_constants
from slipfree.fit.wheel_soil import QUANTITIES, SoilFit, check_constant, fit_soil
from slipfree.laws.soil import Soil, WheelSize
from slipfree.models import single_wheel
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem, validated_problem
from slipfree.problem.schema import GRAVITY, FileKeys, Gravity, NamedSoil, soil_of
from slipfree.problem.verbs.fit import (
    AS_ITS_PRIOR,
    AS_PRIOR,
    BoundsTable,
    direction_lines,
    estimate_lines,
    estimate_rows,
)
from slipfree.vehicle.tree import gravity_of, gravity_words

UNDETERMINED = "not determined by these data"
PRIOR_SHARES = {  # deviation over mean of the priors of constants that are fitted by default
    "cohesion": 1.0,
    "friction_angle": 0.15,
    "frictional_modulus": 1.0,
    "exponent": 0.3,
    "shear_along": 1.0,
    "shear_across": 1.0,  # with slip angles
}
MAX_POINTS = 100_000  # slip ratios times slip angles


class TestedWheelTable(toml.Record):
    """Table ``[wheel]``: dimensions and load of the wheel.

    Attributes
    ----------
    radius : float
        Radius, without grousers. [m]
    width : float
        Width. [m]
    load : float
        Vertical load. [N]
    """

    radius: toml.Positive
    width: toml.Positive
    load: toml.Positive


SlipRatio = Annotated[float, Field(ge=-1, le=1)]
SlipAngle = Annotated[toml.Angle, Field(gt=-np.pi / 2, lt=np.pi / 2)]


class TestTable(toml.Record):
    """Table ``[test]``: slip ratios, slip angles and measured points.

    Attributes
    ----------
    slip : tuple of float
        Lowest and highest slip ratio. [1]
    points : int
        Number of slip ratios.
    slip_angles : tuple of float
        Slip angles [rad], or text as in "15 deg".
    """

    slip: Annotated[tuple[SlipRatio, SlipRatio], Field(strict=False)] = (0.0, 0.8)
    points: Annotated[int, Field(ge=2, le=10_000)] = 81
    slip_angles: Annotated[tuple[SlipAngle, ...], Field(strict=False, min_length=1)] = (0.0,)
    measured: str | None = Field(
        default=None,
        description="CSV file of measured points: a column 'slip', or 'rim_speed' and 'speed' "
        f"[m/s], and one of {', '.join(QUANTITIES)}; where they are not zero and wheel.load, "
        "columns 'slip_angle' [rad] and 'load' [N]; numbers of runs and their repeats in 'run'",
    )


NOT_KEYS = ("soil", "size", "unknowns", "runs", "gravity")
OfFit: Any = toml.record_of(fit_soil, FileKeys, omitted=NOT_KEYS)  # options of a fit


class WheelFile(OfFit):  # type: ignore[misc]
    """Wheel file; the table ``[soil]`` has the constants of `Soil`.

    Attributes
    ----------
    title : str or None
        Title of the summary.
    wheel : TestedWheelTable
        The wheel.
    soil : NamedSoil
        The soil.
    test : TestTable
        The test.
    unknowns : mapping of str to BoundsTable
        Constants of the soil that slipfree fit estimates, by name; by default the usual ones, with
        priors.
    """

    title: str | None = None
    gravity: Gravity = Field(default="earth", description=GRAVITY)
    wheel: TestedWheelTable
    soil: NamedSoil = NamedSoil()
    test: TestTable = TestTable()
    unknowns: dict[str, BoundsTable] = Field(default={})

    def faults(self) -> Iterator[toml.Fault]:
        """Yield an error for each value that contradicts another one."""
        low, high = self.test.slip
        if low >= high:
            expected = "two slip ratios in ascending order"
            yield toml.Fault(("test", "slip"), expected, f"[{low:g}, {high:g}]; exchange them")
        count = self.test.points * len(self.test.slip_angles)
        if count > MAX_POINTS:
            expected = f"at most {MAX_POINTS} slip ratios times slip angles"
            yield toml.Fault(("test", "points"), expected, f"{count}; reduce the number of points")


class WheelContents(NamedTuple):
    """Contents of a wheel file."""

    spec: WheelFile
    title: str  # by default the name of the file
    soil: Soil
    size: WheelSize
    gravity: float  # [m/s^2]
    runs: single_wheel.WheelRuns | None
    files: list[Path]  # those read
    problem: Problem[Any]


class WheelTest(NamedTuple):
    """Result of a wheel file."""

    file: WheelContents
    curves: single_wheel.WheelCurves
    errors: dict[str, tuple[int, float, float]]  # points; computed minus measured: rms, mean


class FittedWheel(NamedTuple):
    """Result of a fit of a soil to the measured points of a wheel file."""

    file: WheelContents
    runs: single_wheel.WheelRuns
    fit: SoilFit
    priors: dict[str, float]  # deviations of priors, by constant


def run_wheel_file(path: Path, settings: Sequence[str] = ()) -> WheelTest:
    """Return the curves of a wheel file, and their difference from its measured points.

    ProblemError is raised if the file cannot be read, or values do not fit its schema; DataError if
    the file of measured points cannot be read; ModelError if the wheel sinks to its axle, or the
    soil is not valid.
    """
    file = read_wheel_file(path, settings)
    spec, soil, size, gravity = file.spec, file.soil, file.size, file.gravity
    low, high = spec.test.slip
    slips = np.linspace(low, high, spec.test.points)
    curves = single_wheel.single_wheel(
        soil, size, spec.wheel.load, slips, spec.test.slip_angles, gravity=gravity
    )
    errors = {}
    if file.runs is not None:
        forces = single_wheel.steady_forces(soil, size, file.runs.motion, file.runs.load, gravity)
        for k, name in enumerate(QUANTITIES):
            missed = getattr(forces, name) - file.runs.values[:, k]
            if (known := np.isfinite(missed)).any():
                rms = float(np.sqrt(np.mean(missed[known] ** 2)))
                errors[name] = int(known.sum()), rms, float(missed[known].mean())
    return WheelTest(file, curves, errors)


def fit_wheel_file(file: WheelContents) -> FittedWheel:
    """Return the fit of the soil of a wheel file to its measured points.

    ProblemError is raised if the file has no measured points, or an unknown is not valid; other
    errors are those of `fit_soil`.
    """
    spec = file.spec
    if file.runs is None:
        fault = toml.Fault(("test", "measured"), "a CSV file of measured points", "none; add it")
        raise toml.problem_error(file.problem.source, [fault])
    unknowns = list[Unknown]()
    for name, share in PRIOR_SHARES.items() if not spec.unknowns else ():
        # points without motion to the side do not depend on it
        if name != "shear_across" or file.runs.motion[2].any():
            mean = float(getattr(file.soil, name))
            unknowns.append(Unknown(name, name, prior=(mean, share * mean)))
    for name, table in spec.unknowns.items():
        with at(file.problem, ("unknowns", name)):
            unknowns.append(Unknown(name, name, **toml.given_values(table)))
            check_constant(unknowns[-1], file.soil)
    options = {name: getattr(spec, name) for name in OfFit.model_fields}
    if "folds" not in spec.model_fields_set:
        options["folds"] = min(spec.folds, np.unique(file.runs.run).size)
    world = file.soil, file.size, unknowns, file.runs
    fit = fit_soil(*world, gravity=file.gravity, **options)
    return FittedWheel(file, file.runs, fit, {u.name: u.prior[1] for u in unknowns if u.prior})


def is_wheel_file(path: Path) -> bool:
    """Return whether a file of ``slipfree fit`` is a wheel file, by its table ``[wheel]``."""
    return re.search(r"^\s*(\[wheel\]|wheel\s*=|wheel\.)", toml.read_text(path), re.M) is not None


def read_wheel_file(path: Path, settings: Sequence[str]) -> WheelContents:
    """Return the contents of a wheel file, and of its file of measured points.

    A file with another ending than .toml is that of the measured points.
    """
    if path.suffix.lower() == ".toml":
        text = toml.read_text(path, "a wheel file")
    else:
        text = f"{toml.MADE}test.measured = {toml_value(path.name)}\n"
        if "load" in read_names(path, "measured points"):
            load = np.median(read_columns(path, ["load"], "measured points").values["load"])
            text += f"wheel.load = {float(load)!r}\n"
    problem: Problem[Any] = validated_problem(lambda *_: WheelFile, path, text, settings)
    spec: WheelFile = problem.spec
    with at(problem, ("gravity",)):
        gravity = gravity_of(spec.gravity)
    soil = soil_of(**toml.given_values(spec.soil))
    size = WheelSize(spec.wheel.radius, spec.wheel.width)
    runs, files = None, [path]
    if spec.test.measured is not None:
        files.append(path.parent / spec.test.measured)
        files = [*dict.fromkeys(files)]
        runs = _read_measured(files[-1], spec.wheel.load)
    return WheelContents(spec, spec.title or path.stem, soil, size, gravity, runs, files, problem)


def _read_measured(path: Path, load: float) -> single_wheel.WheelRuns:
    """Return measured runs of a wheel; missing loads are ``load``, missing quantities NaN."""
    names = read_names(path, "measured points")
    quantities = [name for name in QUANTITIES if name in names]
    speeds: list[str] = [name for name in ("rim_speed", "speed") if name in names]
    if not (("slip" in names or len(speeds) > 1) and quantities):
        raise DataError(
            f"{path}: expected a first line with 'slip', or 'rim_speed' and 'speed', and one of "
            f"{', '.join(QUANTITIES)}, found {', '.join(names)}; add the names of the columns"
        )
    kinds = [*speeds] if len(speeds) > 1 else ["slip"]
    points = kinds + [name for name in ("slip_angle", "load", "run") if name in names]
    columns = read_columns(path, [*points, *quantities], "measured points").values
    first = columns[kinds[0]]
    angle = columns.get("slip_angle", np.zeros_like(first))
    if kinds == ["slip"]:
        single_wheel.check_slip(first, angle)
        motion = single_wheel.motion_at_slip(first, angle)
    else:
        speed = columns["speed"]
        # exactly zero at a right angle, where the cosine is not
        along = np.where(np.isclose(np.abs(angle), np.pi / 2), 0, speed * np.cos(angle))
        motion = np.vstack([first, along, speed * np.sin(angle)])
        largest = np.abs(motion).max(axis=0)
        if not largest.all():
            raise DataError(
                f"{path}: expected moving wheels, found rim speed and speed zero in "
                f"point {int(largest.argmin()) + 1}; remove it"
            )
        motion /= largest
    values = [columns.get(name, np.full_like(first, np.nan)) for name in QUANTITIES]
    return single_wheel.WheelRuns(
        motion,
        columns.get("load", np.full_like(first, load)),
        np.column_stack(values),
        columns.get("run", np.arange(first.size, dtype=float)),
    )


def wheel_facts(test: WheelTest) -> Lines:
    """Return the facts about a wheel test: wheel, soil, curves, and difference from measurement."""
    curves, file, soil = test.curves, test.file, test.file.soil
    size = f"radius {file.size.radius:g} m, width {file.size.width:g} m"
    facts = [
        ("wheel", f"{size}, load {file.spec.wheel.load:g} N"),
        ("gravity", gravity_words(file.gravity)),
        (
            "soil",
            f"cohesion {soil.cohesion:g} Pa, friction angle {np.rad2deg(soil.friction_angle):.4g} "
            f"deg, sinkage exponent {soil.exponent:g}",
        ),
    ]
    for k, angle in enumerate(curves.angle):
        ranges = (curves.pull[k], curves.side[k], curves.torque[k], 1e3 * curves.sinkage[k])
        pull, side, torque, depth = (f"{each.min():.4g} to {each.max():.4g}" for each in ranges)
        best = curves.slip[curves.pull[k].argmax()]
        words = f"drawbar pull {pull} N (largest at slip {best:.3g}), side force {side} N, torque "
        words += f"{torque} N m, sinkage {depth} mm"
        facts.append((f"slip angle {np.rad2deg(angle):g} deg", words))
    for name, (count, rms, mean) in test.errors.items():
        unit = QUANTITIES[name]
        error = f"computed minus measured rms {rms:.3g} {unit}, mean {mean:.3g} {unit}"
        facts.append((f"measured {name}", f"{count} points, {error}"))
    return facts


def wheel_rows(curves: single_wheel.WheelCurves) -> list[dict[str, float]]:
    """Return the rows of a table of the curves, in SI units; angles in radians."""
    return [
        {"slip_angle": float(angle), "slip": float(slip)}
        | {name: float(getattr(curves, name)[k, i]) for name in QUANTITIES}
        for k, angle in enumerate(curves.angle)
        for i, slip in enumerate(curves.slip)
    ]


def measured_points(
    runs: single_wheel.WheelRuns | None,
) -> dict[str, tuple[Array, Array, Array, Array]]:
    """Return slip ratios, slip angles [rad], loads [N] and values of the measured quantities."""
    if runs is None:
        return {}
    slip, angle = single_wheel.slip_of_motion(runs.motion)
    return {
        name: (slip, angle, runs.load, runs.values[:, k])
        for k, name in enumerate(QUANTITIES)
        if np.isfinite(runs.values[:, k]).any()
    }


def fit_facts(fitted: FittedWheel) -> Lines:
    """Return the facts of a fit of a soil: constants, directions, and errors of the quantities."""
    file, runs, fit, priors = fitted
    rows = estimate_rows(fit.estimate)
    weak = dict.fromkeys(fit.estimate.undetermined, UNDETERMINED)
    weak |= {
        row["name"]: AS_ITS_PRIOR
        for row in rows
        if row["deviation"] > AS_PRIOR * priors.get(row["name"], np.inf)
    }
    outcome = Outcome.INTERRUPTED if fit.estimate.is_interrupted else Outcome.COMPLETE
    facts = [
        ("outcome", outcome.title),
        ("wheel", f"radius {file.size.radius:g} m, width {file.size.width:g} m"),
        ("gravity", gravity_words(file.gravity)),
        ("measured", f"{runs.load.size} points of {np.unique(runs.run).size} runs"),
        *estimate_lines(rows, weak),
        *direction_lines(fit.estimate),
    ]
    if np.isfinite(fit.excess):
        facts.append(("residuals", f"{fit.excess:.3g} times the deviation between repeats"))
    for each in fit.errors:
        before, after = (
            f"{found.value:.3g} ({found.lower:.3g} to {found.upper:.3g})"
            for found in (each.nominal, each.validated)
        )
        words = f"rms error {before} {QUANTITIES[each.name]} before, {after} of runs left out; "
        words += f"deviation of the data {each.variation:.3g}"
        words += f", between repeats {each.repeats:.3g}" if np.isfinite(each.repeats) else ""
        facts.append((each.name, words))
    if fit.sunk:
        words = f"at {fit.sunk} points the wheel sinks to its axle, beyond which the law is not "
        facts.append(("sinkage", f"{words}valid"))
    return facts


def constant_rows(fit: SoilFit) -> list[dict[str, Any]]:
    """Return the rows of a table of the fitted constants, with intervals by resampling."""
    pairs = zip(estimate_rows(fit.estimate), fit.resampled.tolist(), strict=True)
    return [row | {"resampled_lower": low, "resampled_upper": high} for row, (low, high) in pairs]


def point_rows(fitted: FittedWheel) -> list[dict[str, float]]:
    """Return the rows of a table of the points: measured, and computed before and after."""
    runs, fit = fitted.runs, fitted.fit
    slip, angle = single_wheel.slip_of_motion(runs.motion)
    kinds = {"measured": runs.values, "before": fit.nominal}
    kinds |= {"fitted": fit.fitted, "left_out": fit.validated}
    columns = {"run": runs.run, "slip": slip, "slip_angle": angle, "load": runs.load}
    for k, name in enumerate(QUANTITIES):
        columns |= {f"{name}_{kind}": values[:, k] for kind, values in kinds.items()}
    table = np.column_stack([*columns.values()]).tolist()
    return [dict(zip(columns, row, strict=True)) for row in table]


def error_rows(fit: SoilFit) -> list[dict[str, Any]]:
    """Return the errors of the quantities as objects."""
    rows = [each._asdict() | {"unit": QUANTITIES[each.name]} for each in fit.errors]
    for row in rows:
        row |= {name: row[name]._asdict() for name in ("nominal", "validated")}
    return rows


def soil_text(fitted: FittedWheel) -> str:
    """Return the fitted soil as a TOML table, with the intervals of the constants in comments."""
    estimate = fitted.fit.estimate
    intervals = dict(zip((x.name for x in estimate.labels), estimate.intervals, strict=True))
    lines = [
        f"# {fitted.file.title}: soil fitted by slipfree fit",
        "# of a problem file; in a wheel file, write [soil]",
        "[law.soil]",
    ]
    default = Soil()
    for label in law_constants(default).values():
        value = getattr(fitted.fit.soil, label.name)
        if label.name in intervals:
            low, high = intervals[label.name]
            lines.append(f"{label.name} = {value!r}  # 95 % interval {low:.4g} to {high:.4g}")
        elif value != getattr(default, label.name):
            lines.append(f"{label.name} = {str(value).lower()}")
    return "\n".join([*lines, ""])
