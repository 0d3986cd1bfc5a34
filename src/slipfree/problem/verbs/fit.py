"""Fits: numbers of a vehicle and of a law, calibrated on a log of rates and poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from slipfree.core.dae import Dae
from slipfree.core.errors import DataError, ModelError
from slipfree.core.outcome import Outcome
from slipfree.core.records import Array
from slipfree.core.trajectory import Frame
from slipfree.files.mcap import is_mcap, read_motion_log
from slipfree.files.netcdf import read as read_result
from slipfree.files.tables import Columns, read_columns, split_unit
from slipfree.files.toml.source import name_errors, problem_error
from slipfree.files.toml.types import Positive, Quantity, Record
from slipfree.fit.body_motion import body_motion
from slipfree.fit.calibration import Calibration, bootstrap, calibrate, heading_rms, position_rms
from slipfree.fit.estimate import WEAK, Direction, Estimate
from slipfree.fit.unknowns import (
    QUANTITIES,
    Unknown,
    label_of,
    law_with_unknowns,
    parametric_model,
    value_of,
    with_unknowns,
)
from slipfree.fit.windows import Log, Windows, cut
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.quasi_statics import quasi_statics
from slipfree.problem.build import model_law
from slipfree.problem.build_ground import at
from slipfree.problem.build_vehicle import build_vehicle
from slipfree.problem.problem import Problem
from slipfree.problem.schema import MODEL, VERB, CommonKeys, LawKeys, VehicleSource
from slipfree.problem.units import check_heading_unit, check_sampling, check_travel
from slipfree.problem.verbs.base import Lines, Verb
from slipfree.terrain.analytic import Analytic
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

TIME_SLACK = 1e-6  # of window ends [window]
SHOWN_WEIGHT = 0.2  # smallest weight of an unknown that is named in a direction
OWN_COLUMNS = {"t": "t", "x": "x", "y": "y", "heading": "heading"}  # of results of slipfree


class PoseColumns(Record):
    """Columns of the time and the pose in a table."""

    t: str = Field(default="t", description="column of the time, in s")
    x: str = Field(default="x", description="column of the easting, in m")
    y: str = Field(default="y", description="column of the northing, in m")
    heading: str = Field(
        default="heading", description="column of the heading, from the axis of frame, in rad"
    )


class Data(Record):
    """The log, and its windows."""

    file: Annotated[str, Field(min_length=1)] = Field(
        description="the log: a table as text, MCAP, or a result of slipfree (.nc)"
    )
    window: Positive | Annotated[str, Field(min_length=1)] = Field(
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
        """Name of the log."""
        return (self.data.file,)


class FitVerb(Verb):
    """Calibration on a log."""

    schema = Fit
    commands = ("fit",)


class Fitted(NamedTuple):
    """Result of a fit, with notes on conversions of units in the log."""

    calibration: Calibration
    vehicle: Vehicle  # with fitted values
    constants: dict[str, float]  # of the law
    sensor: dict[str, float]  # pose of the sensor [m, rad]
    notes: tuple[str, ...]


def build_model(
    model: Literal["kinematics", "quasi-static"], ground: Terrain, vehicle: Vehicle, law: Any
) -> Dae:
    """Return the model of a fit."""
    if model == "kinematics":
        return direct_kinematics(vehicle, ground, slip=law)
    return quasi_statics(vehicle, ground, law=law)


def fit(problem: Problem[Fit]) -> Fitted:
    """Return the result of a fit.

    ProblemError is raised if the vehicle, the law, an unknown or the log is not valid; ModelError
    if the log has too few windows, or the model has no motion at its rates.
    """
    spec = problem.spec
    with at(problem, ("vehicle",)):
        vehicle = build_vehicle(spec.vehicle, problem)
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
    radii = {f"{wheel.name}_rate": wheel.radius for wheel in vehicle.wheels if wheel.driven}
    windows, notes = _read_windows(problem, names, [c.name for c in vehicle.of("passive")], radii)
    choice: dict[str, Any] = {"train": spec.train, "seed": spec.seed, "loss": spec.loss}
    calibration = calibrate(build, vehicle, law, unknowns, windows, **choice)
    values = calibration.estimate.values.tolist()
    new = law_with_unknowns(law, unknowns, values)
    pairs = list(zip(unknowns, values, strict=True))
    return Fitted(
        calibration,
        with_unknowns(vehicle, unknowns, values),
        {u.quantity: getattr(new, u.quantity) for u, _ in pairs if hasattr(new, u.quantity)},
        {u.quantity: value for u, value in pairs if u.quantity.startswith("sensor_")},
        notes,
    )


def _read_windows(
    problem: Problem[Fit], names: tuple[str, ...], passive: list[str], radii: Mapping[str, float]
) -> tuple[Windows, tuple[str, ...]]:
    """Return the windows of the log, and notes on its units; passive joints are at zero.

    The ``radii`` of the driven wheels, by the names of their rates, are for a check of units [m].
    """
    data = problem.spec.data
    measured = [name for name in names if name not in passive]
    if faults := list(name_errors(("data", "rates"), data.rates, measured)):
        raise problem_error(problem.source, faults)
    columns = {name: data.rates.get(name, name) for name in measured}
    with at(problem, ("data",)):
        path = problem.folder / data.file
        notes: tuple[str, ...] = ()
        if path.suffix == ".nc":
            table, frame = _read_result(path, columns), "paper"
        elif is_mcap(path):
            table, frame = _read_mcap(path, columns), "rep103"
        else:
            (table, notes), frame = _read_table(path, data, columns), problem.spec.frame
        t, x, y, heading = (table[key] for key in OWN_COLUMNS)
        place = (x, y) if frame == "paper" else (-y, x)
        check_sampling(t)
        check_heading_unit(*place, heading)
        wheels = [name for name in measured if name in radii]
        if wheels and not any(split_unit(columns[name])[1] for name in wheels):
            check_travel(t, x, y, np.mean([table[name] * radii[name] for name in wheels], axis=0))
        inputs = [table[name] if name in table else np.zeros_like(t) for name in names]
        log = Log(t, np.column_stack(inputs), np.column_stack([*place, heading]), table["window"])
        if isinstance(data.window, float):
            log = _divided(log, data.window)
        return cut(log), notes


def _read_table(path: Path, data: Data, columns: Mapping[str, str]) -> Columns:
    """Return the columns of a log in a text file, by name in this module; a column of windows."""
    wanted = {**dict(data.columns), **columns}
    if isinstance(data.window, str):
        wanted["window"] = data.window
    values, notes = read_columns(path, wanted, "a log", where="[data.columns] or [data.rates]")
    return Columns({"window": np.zeros(values["t"].size), **values}, notes)


def _read_result(path: Path, columns: Mapping[str, str]) -> dict[str, Array]:
    """Return the columns of a result of slipfree, with rates and values by name."""
    run = read_result(path).in_frame("paper")
    table = {"t": run.t, **{key: run[key] for key in ("x", "y", "heading")}}
    table["window"] = np.zeros(run.t.size)
    for name, column in columns.items():
        wheel = column.removesuffix("_rate")
        if wheel in run.wheels:
            table[name] = run["wheel_rate", wheel]
        elif wheel in run.columns and column.endswith("_rate"):
            table[name] = np.gradient(run[wheel], run.t)
        elif column in run.columns:
            table[name] = run[column]
        else:
            raise DataError(
                f"{path}: expected the rates of the wheels and joints of the vehicle, found none "
                f"for {column!r}; name another quantity in [data.rates]"
            )
    return table


def _read_mcap(path: Path, columns: Mapping[str, str]) -> dict[str, Array]:
    """Return poses, and rates and values of joints at their times, of an MCAP file by name.

    A column is the name of a joint, with ``_rate`` for its velocity.
    """
    pose, joints = read_motion_log(path)
    t = pose["t"]
    table = {**pose, "window": np.zeros(t.size)}
    for name, column in columns.items():
        joint = column.removesuffix("_rate")
        if joint not in joints:
            raise DataError(
                f"{path}: expected the rates of the wheels and joints of the vehicle, found no "
                f"joint {joint!r} among {', '.join(joints)}; name the joints in [data.rates]"
            )
        states = joints[joint]
        values = states.velocities if name.endswith("_rate") else states.positions
        if not np.isfinite(values).all():
            raise DataError(
                f"{path}: expected values of joint {joint!r} in each message, found messages "
                "without them; record positions and velocities"
            )
        table[name] = np.interp(t, states.t, values)
    return table


def _divided(log: Log, duration: float) -> Log:
    t, slack = log.t - log.t[0], TIME_SLACK * duration
    if np.diff(t).min(initial=0.0) < 0:
        raise ModelError("expected times that do not decrease, found a decrease; sort the log")
    numbers = np.unique(np.floor((t + slack) / duration))
    numbers = numbers[duration * (numbers + 1) <= t[-1] + slack]
    if not numbers.size:
        raise ModelError(
            f"expected a log of at least one window, {duration:g} s, found {t[-1]:g} s; reduce "
            "data.window"
        )
    first = np.searchsorted(t, duration * numbers - slack)
    last = np.searchsorted(t, duration * (numbers + 1) + slack)
    rows = [np.arange(a, b) for a, b in zip(first, last, strict=True)]
    window = np.repeat(numbers, [each.size for each in rows])
    at_rows = np.concatenate(rows)
    return Log(log.t[at_rows], log.given[at_rows], log.pose[at_rows], window)


def facts(fitted: Fitted) -> Lines:
    """Return the facts of a fit: estimates, identifiable directions, and errors of predictions."""
    calibration = fitted.calibration
    train, test = (len(part.measured) for part in (calibration.train, calibration.test))
    outcome = Outcome.INTERRUPTED if calibration.estimate.is_interrupted else Outcome.COMPLETE
    return [
        ("outcome", outcome.title),
        *([("log", "; ".join(fitted.notes))] if fitted.notes else []),
        ("windows", f"{train} for training, {test} others"),
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
