"""Fits: numbers of a vehicle and of a law, calibrated on a log of rates and poses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.facts import Lines
from slipfree.core.outcome import Outcome
from slipfree.core.trajectory import Frame
from slipfree.files.logs import (
    GAP,
    check_motion,
    is_continuous,
    longest_gap,
    rate_ratios,
    read_log,
)
from slipfree.files.tables import split_unit
from slipfree.files.toml.source import name_errors, problem_error
from slipfree.files.toml.types import Positive, Quantity, Record
from slipfree.fit.body_motion import body_motion
from slipfree.fit.estimate import (
    WEAK,
    Calibration,
    Direction,
    Estimate,
    bootstrap,
    calibrate,
    heading_rms,
    position_rms,
)
from slipfree.fit.unknowns import (
    QUANTITIES,
    SENSOR,
    Unknown,
    label_of,
    lateral_places,
    law_with_unknowns,
    parametric_model,
    value_of,
    with_unknowns,
)
from slipfree.fit.windows import Log, Windows, cut, divide, joined
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.quasi_statics import quasi_statics
from slipfree.problem.build import model_law
from slipfree.problem.build_ground import at
from slipfree.problem.build_vehicle import build_vehicle
from slipfree.problem.problem import Problem
from slipfree.problem.schema import MODEL, VERB, CommonKeys, LawKeys, VehicleSource
from slipfree.problem.units import moves_sideways
from slipfree.terrain.analytic import Analytic
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

SHOWN_WEIGHT = 0.2  # smallest weight of an unknown that is named in a direction


Name = Annotated[str, Field(min_length=1)]


class PoseColumns(Record):
    """Columns of the time and the pose in a table."""

    t: str = Field(default="t", description="column of the time, in s")
    x: str = Field(default="x", description="column of the easting, in m")
    y: str = Field(default="y", description="column of the northing, in m")
    heading: str = Field(
        default="heading", description="column of the heading, from the axis of frame, in rad"
    )
    error: Name | None = Field(
        default=None, description="column of the stated error of the position, in m"
    )


class LogKeys(Record):
    """What of a log is used."""

    timeout: Positive | None = Field(
        default=None,
        description="time after which a command or rate that is not given again counts as zero; by "
        "default it is held [s]",
    )
    max_error: Positive = Field(
        default=0.1,
        description="largest stated error of a position, if a column has it; other rows are left "
        "out [m]",
    )


class Data(LogKeys):
    """The log, and its windows."""

    file: Name | Annotated[tuple[Name, ...], Field(strict=False, min_length=1)] = Field(
        description="the log, or several: tables as text, MCAP, or results of slipfree (.nc)"
    )
    window: Positive | Name = Field(
        description="duration of the windows, or the column with the number of the window [s]"
    )
    columns: PoseColumns = Field(
        default=PoseColumns(), description="names of the columns of the pose"
    )
    rates: dict[str, str] = Field(
        default={},
        description="column of each input and commanded joint, by name; by default the column of "
        "that name [rad/s, m/s, rad, m]",
    )


class UnknownTable(Record):
    """A number to be fitted."""

    quantity: str | None = Field(
        default=None,
        description=f"{', '.join(QUANTITIES)}, sensor_right, sensor_ahead, sensor_heading, or a "
        "constant of the law; by default the name of the table",
    )
    wheels: Annotated[tuple[str, ...], Field(strict=False)] = Field(
        default=(), description="wheels that share the number; by default all"
    )
    lower: Quantity | None = Field(
        default=None, description="lower bound, in the unit of the quantity [m, rad, 1]"
    )
    upper: Quantity | None = Field(
        default=None, description="upper bound, in the unit of the quantity [m, rad, 1]"
    )

    def unknown(self, name: str) -> Unknown:
        """Return the unknown of a table with a name."""
        lower = -inf if self.lower is None else self.lower
        upper = inf if self.upper is None else self.upper
        return Unknown(name, self.quantity or name, self.wheels, lower, upper)


class PriorUnknownTable(UnknownTable):
    """A number to be fitted, of which something may be known before."""

    prior: Annotated[tuple[float, Positive], Field(strict=False)] | None = Field(
        default=None,
        description="mean and standard deviation before the fit, in the unit of the quantity "
        "[m, rad, 1]",
    )

    def unknown(self, name: str) -> Unknown:
        """Return the unknown of a table with a name."""
        return replace(super().unknown(name), prior=self.prior)


class Fit(LawKeys, CommonKeys):
    """Fit: numbers of a vehicle and of a law, calibrated on a log of rates and poses."""

    verb: Literal["fit"] = Field(description=VERB)
    frame: Frame = Field(
        default="paper", description="axis from which the headings of the log count: y, or x"
    )
    vehicle: VehicleSource = Field(description="the vehicle, with nominal values")
    model: Literal["kinematics", "quasi-static"] = Field(default="kinematics", description=MODEL)
    friction: Positive = Field(
        default=0.6, description="coefficient of friction of the ground, which is level [1]"
    )
    data: Data = Field(description="the log")
    unknowns: Annotated[dict[str, PriorUnknownTable], Field(min_length=1)] = Field(
        description="the numbers to be fitted, by name [m, rad, 1]"
    )
    train: Annotated[float, Field(gt=0, lt=1)] = Field(
        default=0.7, description="share of the windows from which the numbers are estimated [1]"
    )
    seed: Annotated[int, Field(ge=0)] = Field(
        default=0, description="seed of the random choice of these windows"
    )
    loss: Literal["soft_l1", "linear"] = Field(
        default="soft_l1", description="loss of a residual: robust to outliers, or its square"
    )

    @property
    def named_files(self) -> tuple[str, ...]:
        """Names of the logs."""
        return (self.data.file,) if isinstance(self.data.file, str) else self.data.file


class Fitted(NamedTuple):
    """Result of a fit, with notes on units and rows of the logs."""

    calibration: Calibration
    vehicle: Vehicle  # with fitted values
    others: dict[str, float]  # constants of the law, and pose of the sensor [m, rad]
    notes: tuple[str, ...]
    left_out: Counter[str]  # numbers of windows, by reason


def build_model(
    model: Literal["kinematics", "quasi-static"], ground: Terrain, vehicle: Vehicle, law: Any
) -> Dae:
    """Return the model of a fit."""
    if model == "kinematics":
        return direct_kinematics(vehicle, ground, slip=law)
    return quasi_statics(vehicle, ground, law=law)


def log_paths(problem: Problem[Any], predict: Sequence[Path] = ()) -> list[Path]:
    """Return the paths of the fitted logs; ModelError is raised if one is also to be predicted."""
    paths = [problem.folder / name for name in problem.spec.named_files]
    if again := {path.resolve() for path in paths} & {path.resolve() for path in predict}:
        raise ModelError(
            "expected logs to predict that are not fitted, found "
            f"{', '.join(sorted(path.name for path in again))} in both; remove them from one"
        )
    return paths


def fit(problem: Problem[Fit], predict: Sequence[Path] = ()) -> Fitted:
    """Return the result of a fit.

    The logs ``predict`` are predicted with numbers that are estimated from all windows of the
    others; by default, a part of these windows is left out and predicted. ProblemError is raised if
    the vehicle, the law, an unknown or the log is not valid; ModelError if the log has too few
    windows, or the model has no motion at its rates.
    """
    spec = problem.spec
    vehicle = build_vehicle(problem)
    law: Any = model_law(problem)
    unknowns, ground = list[Unknown](), Analytic(lambda x, _: 0 * x, mu=spec.friction)
    build = partial(build_model, spec.model, ground)

    for name, table in spec.unknowns.items():
        with at(problem, ("unknowns", name)):
            unknowns.append(table.unknown(name))
            label_of(unknowns[-1], law)
            with_unknowns(vehicle, unknowns[-1:], [value_of(unknowns[-1], vehicle, law)])
    dae = parametric_model(build, vehicle, law, unknowns)
    names = body_motion(dae).names
    notes, left_out, windows = list[str](), Counter[str](), list[Windows]()
    with at(problem, ("data",)):
        for paths in filter(None, (log_paths(problem, predict), predict)):
            logs = [_read_log(problem, path, names, vehicle) for path in paths]
            windows.append(cut(joined([log for log, *_ in logs])))
            for path, (_, words, counts) in zip(paths, logs, strict=True):
                notes += [f"{path.name}: {each}" if len(paths) > 1 else each for each in words]
                left_out += counts
    choice: dict[str, Any] = {"train": spec.train, "seed": spec.seed, "loss": spec.loss}
    calibration = calibrate(build, vehicle, law, unknowns, *windows, **choice)
    values = calibration.estimate.values.tolist()
    new = law_with_unknowns(law, unknowns, values)
    pairs = list(zip(unknowns, values, strict=True))
    return Fitted(
        calibration,
        with_unknowns(vehicle, unknowns, values),
        {u.quantity: getattr(new, u.quantity) for u, _ in pairs if hasattr(new, u.quantity)}
        | {u.quantity: value for u, value in pairs if u.quantity in SENSOR},
        tuple(notes),
        left_out,
    )


def _read_log(
    problem: Problem[Fit], path: Path, names: tuple[str, ...], vehicle: Vehicle
) -> tuple[Log, list[str], Counter[str]]:
    """Return a log, notes on its rows, and numbers of windows that are left out, by reason.

    Passive joints are at zero.
    """
    spec, data = problem.spec, problem.spec.data
    passive = {each.name for each in vehicle.of("passive")}
    measured = [name for name in names if name not in passive]
    if faults := list(name_errors(("data", "rates"), data.rates, measured)):
        raise problem_error(problem.source, faults)
    columns = {name: data.rates.get(name, name) for name in measured}
    sides = [each for each in lateral_places(vehicle) if f"{each[0].name}_rate" in columns]
    wheels = [wheel for wheel, _ in sides if wheel.driven]
    wanted = {name: column for name, column in data.columns if column} | columns
    wanted |= {"window": data.window} if isinstance(data.window, str) else {}
    log = read_log(
        path,
        wanted,
        columns,
        where="[data.columns] or [data.rates]",
        units={f"{wheel.name}_rate": "rad/s" for wheel in wheels},
        is_linear=True,
        timeout=data.timeout,
        max_error=data.max_error,
    )
    frame = {".nc": "paper", ".mcap": "rep103"}.get(path.suffix.lower(), spec.frame)
    t, values = log.t, log.values
    speeds = np.array([values[f"{wheel.name}_rate"] * wheel.radius for wheel in wheels])
    places = np.array([place for wheel, place in sides if wheel.driven])
    is_named = any(split_unit(columns[f"{wheel.name}_rate"])[1] for wheel in wheels)
    check_motion(
        log,
        zero=0.0 if frame == "rep103" else np.pi / 2,
        speed=speeds.mean(axis=0) if wheels else None,
        turn=(places - places.mean()) @ speeds if len(measured) == len(wheels) else None,
        ratios=None if is_named else rate_ratios([wheel.radius for wheel in wheels]),
        is_aligned=not moves_sideways(vehicle),
        may_turn="sensor_heading" in {u.quantity or name for name, u in spec.unknowns.items()},
    )
    window = values.get("window", np.zeros(t.size))
    steps = np.append(0.0, np.diff(t))
    is_first = np.append(True, ~is_continuous(t, values["x"] + 1j * values["y"], window))
    rows = np.arange(t.size)
    if isinstance(data.window, float):
        rows, window = divide(t, data.window)
    inside = is_first[rows] & np.append(False, np.diff(window) == 0)
    is_gap = inside & (steps[rows] > longest_gap(t))
    left_out = Counter({"with a gap": np.unique(window[is_gap]).size})
    lost = np.unique(window[inside])
    left_out["with a leap of the position"] = lost.size - left_out["with a gap"]
    kept = ~np.isin(window, lost)
    if not kept.any():
        raise ModelError(
            f"expected windows without gaps and leaps, found none of {np.unique(window).size}; use "
            "a longer log or shorter windows"
        )
    place = (values["x"], values["y"]) if frame == "paper" else (-values["y"], values["x"])
    inputs = [values.get(name, np.zeros(t.size)) for name in names]
    given, pose = np.column_stack(inputs), np.column_stack([*place, values["heading"]])
    notes = [*log.notes, *log.rows_left_out, *([log.hold] if log.held[0] > GAP else [])]
    rows = rows[kept]
    return Log(t[rows], given[rows], pose[rows], window[kept]), notes, +left_out


def facts(fitted: Fitted) -> Lines:
    """Return the facts of a fit: estimates, identifiable directions, and errors of predictions."""
    calibration = fitted.calibration
    train, test = (len(part.measured) for part in (calibration.train, calibration.test))
    left_out = [f"{count} left out {reason}" for reason, count in fitted.left_out.items()]
    outcome = Outcome.INTERRUPTED if calibration.estimate.is_interrupted else Outcome.COMPLETE
    return [
        ("outcome", outcome.title),
        *([("log", "; ".join(fitted.notes))] if fitted.notes else []),
        ("windows", "; ".join([f"{train} for training, {test} others", *left_out])),
        *estimate_lines(calibration.estimate),
        *direction_lines(calibration.estimate),
        *map(_error_line, error_rows(fitted)),
    ]


def estimate_lines(estimate: Estimate) -> Iterator[tuple[str, str]]:
    """Yield the estimates, with 95 % intervals."""
    for k, label in enumerate(estimate.labels):
        unit = "" if label.unit == "1" else f" {label.unit}"
        low, high = estimate.intervals[k]
        if estimate.at_bound[k]:
            words = "at its bound: the data favour values beyond it"
        elif label.name in estimate.undetermined:
            words = "not determined by these data"
        else:
            words = f"95 % interval {low:.5g} to {high:.5g}"
        yield (
            label.name,
            f"{estimate.values[k]:.5g}{unit} ({words}), before {estimate.nominal[k]:.5g}",
        )


def direction_lines(estimate: Estimate) -> Iterator[tuple[str, str]]:
    """Yield the combinations of unknowns that the data determine best, weakly, or not at all."""
    names = [
        label.name
        for label, fixed in zip(estimate.labels, estimate.at_bound, strict=True)
        if not fixed
    ]
    for k, direction in enumerate(estimate.directions):
        words = _combination(direction, names)
        if direction.deviation > WEAK:
            size = (
                "without any information"
                if not np.isfinite(direction.deviation)
                else f"standard deviation {100 * direction.deviation:.3g} % of its size"
            )
            kind = "not determined" if direction.deviation > 1 else "weakly determined"
            yield kind, f"{words}: {size}"
        elif k == 0:
            yield "determined best", f"{words}: to {100 * direction.deviation:.2g} %"


def _combination(direction: Direction, names: list[str]) -> str:
    """Return a combination of unknowns in words, with weights relative to their sizes."""
    terms = [
        f"{weight:+.2g} {name}"
        for weight, name in zip(direction.weights, names, strict=True)
        if abs(weight) > SHOWN_WEIGHT
    ]
    return names[int(np.abs(direction.weights).argmax())] if len(terms) == 1 else " ".join(terms)


def _error_line(row: Mapping[str, Any]) -> tuple[str, str]:
    position, heading = row["position_rms"], row["heading_rms"]
    value, low, high = (np.rad2deg(heading[key]) for key in ("value", "lower", "upper"))
    words = {"train": "training windows", "test": "other windows"}[row["set"]]
    return (
        f"{words}, {row['when']}",
        f"rms {position['value']:.4g} m ({position['lower']:.4g} to {position['upper']:.4g}), "
        f"{value:.3g} deg ({low:.3g} to {high:.3g})",
    )


def estimate_rows(estimate: Estimate) -> tuple[list[str], list[list[Any]]]:
    """Return column names and rows of the estimates, in SI units."""
    deviation = np.sqrt(np.diag(estimate.covariance))
    names = ["name", "unit", "nominal", "value", "deviation", "lower", "upper", "at_bound"]
    return names, [
        [
            label.name,
            label.unit,
            *(float(each[k]) for each in (estimate.nominal, estimate.values, deviation)),
            *(float(each) for each in estimate.intervals[k]),
            int(estimate.at_bound[k]),
        ]
        for k, label in enumerate(estimate.labels)
    ]


def error_rows(fitted: Fitted) -> list[dict[str, Any]]:
    """Return errors of end poses with bootstrap intervals, before and after the fit [m, rad]."""
    sets = (("train", fitted.calibration.train), ("test", fitted.calibration.test))
    return [
        {
            "set": name,
            "when": when,
            "position_rms": bootstrap(values, position_rms)._asdict(),
            "heading_rms": bootstrap(values, heading_rms)._asdict(),
        }
        for name, errors in sets
        for when, values in (("before", errors.nominal), ("after", errors.fitted))
    ]


def window_rows(fitted: Fitted) -> tuple[list[str], list[list[Any]]]:
    """Return column names and rows of the windows: measured ends and errors [m, rad]."""
    axes = ("right", "ahead", "heading")
    names = ["set", *(f"{kind}_{a}" for kind in ("measured", "before", "after") for a in axes)]
    calibration = fitted.calibration
    return names, [
        [words, *np.concatenate(row).tolist()]
        for words, errors in (("train", calibration.train), ("test", calibration.test))
        for row in zip(*errors, strict=True)
    ]


def vehicle_comments(others: Mapping[str, float]) -> list[str]:
    """Return fitted numbers that are not in a vehicle file, as lines of a comment."""
    lines = (f"{name} = {value!r} (not part of the vehicle)" for name, value in others.items())
    return ["fitted by slipfree fit", *lines]
