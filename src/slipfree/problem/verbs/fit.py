"""Fits: a vehicle as a force balance, from logs of inputs and poses, on level ground or a map."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, cast

import numpy as np
import scipy
from pydantic import Field

from slipfree.catalog import rigid_skid_steer
from slipfree.core.errors import DataError, ModelError, check_known
from slipfree.core.facts import Lines
from slipfree.core.records import Array, ComplexArray, Indices, Mask
from slipfree.core.trajectory import Frame, Outcome
from slipfree.core.version import __version__
from slipfree.files.logs import (
    OF_POSES,
    OF_SPEEDS,
    MotionLog,
    check_motion,
    is_continuous,
    longest_gap,
    rate_ratios,
    read_log,
)
from slipfree.files.netcdf import FIT, ORIGIN, open_netcdf
from slipfree.files.tables import ALIASES, PARTS, known_unit, parts_of, read_names, split_unit
from slipfree.files.toml import Angle, Pair, Positive, Quantity, Record, given_values, name_errors
from slipfree.fit.drive_fit import (
    BLOCKS,
    DriveFit,
    Fitted,
    Known,
    Scale,
    Score,
    WindowKind,
    age_priors,
    by_logs,
    judge,
    rms,
    score_kinds,
    sought_of,
)
from slipfree.fit.drives import (
    DriveLog,
    Model,
    Slopes,
    by_runs,
    conditions,
    held_for,
    size_of,
    without_holds,
)
from slipfree.fit.estimate import BALANCE, WEAK, Estimate, Unknown
from slipfree.fit.force_balance import chassis_of, track, with_dimensions
from slipfree.problem.build import moves_sideways
from slipfree.problem.build_ground import at, build_ground
from slipfree.problem.build_vehicle import build_vehicle
from slipfree.problem.problem import Problem
from slipfree.problem.schema import CommonKeys, HeightErrors, TerrainTable, VehicleSource
from slipfree.system.regular_files import replace_file
from slipfree.terrain.base import Grid
from slipfree.terrain.grid_ops import disturbed
from slipfree.vehicle.tree import Vehicle

SHOWN_WEIGHT = 0.2  # smallest weight of an unknown that is named in a direction
JUMP = 0.25  # of positions against measured velocities over a second [m/s]
LEAST_SPEED = 0.1  # commanded speed from which the vehicle drives in one direction [m/s]
FURTHER_MAPS = 4  # with further errors
SQUARE = rigid_skid_steer(half_track=0.5, wheelbase=1.0, r1=0.0, r2=0.2)  # which is scaled
MAX_SHARE = 0.1  # of errors of predictions in the path, for a usable fit
MAX_STEP = 0.1  # longest default time between samples [s]
MANOEUVRE = 20.0  # duration of parts of a log that are left out together [s]
MAX_HOLD = 0.6  # of readings [s]
AS_ITS_PRIOR = "{}, as its prior: not determined by these data"
AS_PRIOR = 0.9  # of the deviation of a prior: an unknown that the logs do not determine
KINDS = WindowKind(0.0, 2.0), WindowKind(0.0, 5.0), WindowKind(5.0), WindowKind(20.0)
SIDES = "left", "right"
LAW_KEYS = {  # keys of problem files with fitted constants
    "friction": ("terrain.friction",),
    "stiffness": ("law.coulomb.slip_stiffness", "law.compliant.slip_stiffness"),
}
CLOCKWISE = -0.5  # correlation of measured turning rates and those of the wheels

Name = Annotated[str, Field(min_length=1)]


class DriveColumns(Record):
    """Columns of a log.

    Attributes
    ----------
    t : str
        Column of the time, in s.
    x : str
        Column of the easting, in m.
    y : str
        Column of the northing, in m.
    heading : str or None
        Column of the heading, from the axis of frame, in rad; by default heading or yaw, if a log
        has it; without headings, courses follow from positions and velocities.
    velocity : tuple of str or None
        Columns of the receiver's velocity along x and y, measured by the Doppler shift, in m/s; by
        default, the derivative of the positions.
    yaw_rate : str or None
        Column of a measured turning rate, in rad/s.
    error : str or None
        Column of the stated error of the position, in m.
    left : str
        Column of the left side.
    right : str
        Column of the right side.
    manoeuvre : str or None
        Column with the number of the manoeuvre, left out as a whole.
    """

    t: str = "t"
    x: str = "x"
    y: str = "y"
    heading: Name | None = None
    velocity: Annotated[tuple[Name, Name], Field(strict=False)] | None = None
    yaw_rate: Name | None = None
    error: Name | None = None
    left: str = "left"
    right: str = "right"
    manoeuvre: Name | None = None


class Data(Record):
    """The logs, and their windows.

    Attributes
    ----------
    file : str or tuple of str
        The log, or several: tables as text, MCAP, or results of slipfree (.nc); those of one folder
        are a campaign, if there are several folders.
    surfaces : tuple of str
        Surface of each log, with its own friction; by default one.
    window : float or str or None
        Duration of the fitted windows, or the column with the number of the window; by default 2 s
        with headings, else 5 m of path. [s]
    step : float or None
        Time between samples; by default that of the logs, at most 0.1. [s]
    inputs : {"readings", "commands"}
        Measured rates, or commands, which are held and which drives follow with a lag.
    unit : {"m/s", "rad/s"}
        Unit of the columns of the sides, a speed or a rate.
    timeout : float or None
        Time after which an input that is not given again counts as zero; by default it is held. [s]
    max_error : float
        Largest stated error of a position, if a column has it; other rows are left out. [m]
    columns : DriveColumns
        Names of the columns.
    rates : mapping of str to str
        Column of each input and commanded joint of the vehicle, by name; by default the column of
        that name. [rad/s, m/s, rad, m]
    """

    file: Name | Annotated[tuple[Name, ...], Field(strict=False, min_length=1)]
    surfaces: Annotated[tuple[Name, ...], Field(strict=False)] = ()
    window: Positive | Name | None = None
    step: Annotated[Positive, Field(le=0.5)] | None = None
    inputs: Literal["readings", "commands"] = "readings"
    unit: Literal["m/s", "rad/s"] = "m/s"
    timeout: Positive | None = None
    max_error: Positive = 0.1
    columns: DriveColumns = DriveColumns()
    rates: dict[str, str] = Field(default={})


class BoundsTable(Record):
    """Bounds and prior of a number to be fitted.

    Attributes
    ----------
    lower : float
        Lower bound, in the unit of the quantity. [m, rad, Pa, 1]
    upper : float
        Upper bound, in the unit of the quantity. [m, rad, Pa, 1]
    prior : tuple of float or None
        Mean and standard deviation before the fit, in the unit of the quantity. [m, rad, Pa, 1]
    """

    lower: Angle = -inf
    upper: Angle = inf
    prior: Annotated[tuple[Angle, Angle], Field(strict=False)] | None = None


class UnknownTable(BoundsTable):
    """A number to be fitted.

    Attributes
    ----------
    wheels : tuple of str
        Wheels that share the number; by default all.
    of : str
        Surface or campaign that has the number; else all.
    """

    quantity: str | None = Field(
        default=None,
        description=f"{', '.join(BALANCE)}, or a constant of soil; by default the name of the "
        "table",
    )
    wheels: Annotated[tuple[str, ...], Field(strict=False)] = ()
    of: str = ""


class Fit(CommonKeys):
    """Fit: a vehicle as a force balance with inertia, from logs of inputs and poses.

    Attributes
    ----------
    model : {"kinematics", "quasi-static", "dynamics"}
        The balance of forces with inertia, 'dynamics', or without it, which is least slip on level
        ground: 'kinematics' and 'quasi-static'.
    frame : Frame
        Axis from which the headings of the logs count: y, or x.
    vehicle : VehicleSource or None
        The vehicle, with nominal values; by default four wheels whose sides are driven.
    terrain : TerrainTable or None
        Map under the logs; by default the ground is level.
    shift : tuple of 2 floats
        Place on the map of the origin of the logs. [m]
    smoothing : float
        Standard deviation over which slopes are averaged. [m]
    map_error : HeightErrors or None
        Error of the map: what it changes in the fit is subtracted.
    data : Data
        The logs.
    constants : mapping of str to float
        Numbers that are not fitted, by quantity. [m, s, 1]
    unknowns : mapping of str to UnknownTable
        Numbers to be fitted, by name, beside the usual ones or in their place. [m, rad, s, 1]
    """

    verb: Literal["fit"]
    model: Literal["kinematics", "quasi-static", "dynamics"] = "dynamics"
    frame: Frame = "paper"
    vehicle: VehicleSource | None = None
    terrain: TerrainTable | None = None
    shift: Pair = (0.0, 0.0)
    smoothing: Quantity = Field(default=0.0, ge=0)
    map_error: HeightErrors | None = None
    data: Data
    constants: dict[str, float] = Field(default={})
    unknowns: dict[str, UnknownTable] = Field(default={})

    @property
    def named_files(self) -> tuple[str, ...]:
        """Names of the logs."""
        return (self.data.file,) if isinstance(self.data.file, str) else self.data.file


class FitResult(NamedTuple):
    """Fitted force balance, errors of predictions, and lines on the rows used of each log."""

    fit: DriveFit | None  # None for predictions with a fit in a file
    fitted: dict[WindowKind, Fitted]
    scores: dict[WindowKind, Score]
    predicted: list[DriveLog]
    rows: Lines

    @property
    def outcome(self) -> Outcome:
        """Outcome: inaccurate if predictions err too much."""
        if self.fit is not None and self.fit.estimate.is_interrupted:
            return Outcome.INTERRUPTED
        is_poor = any(score.share > MAX_SHARE for score in [*self.scores.values()][:1])
        return Outcome.INACCURATE if is_poor else Outcome.COMPLETE


class LogInputs(NamedTuple):
    """Vehicle of logs, and columns of its inputs: rates or sides, and commanded joints."""

    vehicle: Vehicle
    names: tuple[str, ...]
    joints: tuple[str, ...]
    columns: dict[str, str]
    are_speeds: bool  # [m/s], else rates [rad/s]

    @property
    def is_by_sides(self) -> bool:
        """Whether both sides are inputs, not the wheels."""
        return self.names == SIDES

    @property
    def driven(self) -> dict[str, float]:
        """Lateral places of the driven wheels, to the right, by name [m]."""
        places = self.vehicle.centers[:, 0].tolist()
        wheels = zip(self.vehicle.wheels, places, strict=True)
        return {wheel.name: place for wheel, place in wheels if wheel.driven}

    @property
    def places(self) -> Array:
        """Lateral places of the inputs, to the right [m]; -1 and 1 for sides."""
        return np.array([-1.0, 1.0] if self.is_by_sides else [*self.driven.values()])

    @property
    def radii(self) -> Array:
        """Radius of each wheel [m], or 1 for speeds of sides."""
        return np.array([1.0 if self.are_speeds else w.radius for w in self.vehicle.wheels], float)


def inputs_of(problem: Problem[Fit], paths: Sequence[Path] = ()) -> LogInputs:
    """Return the inputs of a vehicle: rates of driven wheels, or its sides."""
    spec, data = problem.spec, problem.spec.data
    own = {name: getattr(data.columns, name) for name in SIDES}
    _, unit = split_unit(data.columns.left)
    are_speeds = (known_unit(unit) or [data.unit])[0] == "m/s"
    if spec.vehicle is None:
        with at(problem, ("data", "rates")):
            if data.rates:
                raise ModelError(
                    "expected a vehicle with these inputs, found none; use data.columns.left, right"
                )
        return LogInputs(SQUARE, SIDES, (), own, are_speeds)
    vehicle = build_vehicle(problem)
    commanded = tuple(each.name for each in vehicle.of("commanded"))
    rates = tuple(f"{wheel.name}_rate" for wheel in vehicle.wheels if wheel.driven)
    problem.refuse(*name_errors(("data", "rates"), data.rates, (*rates, *commanded)))
    path = [*paths, problem.folder / spec.named_files[0]][0]
    if not data.rates and _is_text(path) and not {*rates} <= {*read_names(path, "a log")}:
        own |= {name: name for name in commanded}
        return LogInputs(vehicle, SIDES, commanded, own, are_speeds)
    columns = {name: data.rates.get(name, name) for name in (*rates, *commanded)}
    return LogInputs(vehicle, rates, commanded, columns, are_speeds=False)


def _is_text(path: Path) -> bool:
    return path.suffix.lower() not in (".nc", ".mcap")


def quantities_of(problem: Problem[Fit]) -> tuple[str, ...]:
    """Return the quantities of a fit: logs without a vehicle show its effective track only."""
    other = "track" if problem.spec.vehicle is None else "effective_track"
    return tuple(name for name in BALANCE if name != other)


def own_unknowns(problem: Problem[Fit], names: Sequence[str]) -> list[Unknown]:
    """Return the unknowns of a problem; ``names`` are those of the wheels."""
    found, quantities = list[Unknown](), quantities_of(problem)
    for name, table in problem.spec.unknowns.items():
        with at(problem, ("unknowns", name)):
            found.append(own := Unknown(**{"name": name, "quantity": name, **given_values(table)}))
            checks = [("one of the wheels", each, names) for each in own.wheels]
            checks.insert(0, ("one of the quantities", own.quantity, quantities))
            for words, each, known in checks:
                check_known(f"unknown {name!r}", [each], known, words)
    return found


def model_of(problem: Problem[Fit], inputs: LogInputs, logs: Sequence[DriveLog]) -> Model:
    """Return the model with the usual unknowns and those of the problem."""
    spec, names = problem.spec, tuple(wheel.name for wheel in inputs.vehicle.wheels)
    half, base = track(inputs.vehicle) / 2, float(np.ptp(logs[0].chassis.place.real)) / 2
    gyration: float = ((2 * half) ** 2 + (2 * base + 0.4) ** 2) / 12
    problem.refuse(*name_errors(("constants",), spec.constants, quantities_of(problem)))
    is_known, unknowns, radii = spec.vehicle is not None, list[Unknown](), inputs.radii
    limits = dict[str, tuple[float, float, tuple[float, float]]]()  # bounds and priors
    ratio, wide = (1.0, 1.0) if is_known else size_of(logs)
    if not is_known:
        gyration = wide**2 / 16
        limits["effective_track"] = wide / 3, 3 * wide, (wide, wide / 2)
        limits["center_of_mass_ahead"] = -wide / 6, wide / 6, (0.0, wide / 10)  # between wheels
        if not inputs.are_speeds:
            radii = np.full_like(radii, ratio)
            limits["radius"] = ratio / 2, 2 * ratio, (ratio, ratio / 5)
    fixed = {"inertia": float(spec.model == "dynamics"), "gyration": gyration}
    fixed |= {"effective_track": wide} | spec.constants
    for side, sign in zip(SIDES, (-1, 1), strict=True):
        wheels = tuple(name for name, place in inputs.driven.items() if sign * place > 0)
        unknowns.append(Unknown(f"radius_{side}", "radius", wheels, *limits.get("radius", ())))
    usual = ["track" if is_known else "effective_track", "stiffness", "gyration", "delay"]
    has_headings = all(log.heading is not None for log in logs)
    usual += ["center_of_mass_ahead"] if has_headings else []
    usual += ["lag"] if spec.data.inputs == "commands" else []
    usual += ["turn_slope"] if spec.terrain is not None else []
    unknowns += [Unknown(name, name, (), *limits.get(name, ())) for name in usual]
    for kind in ("friction", "rolling", *(["age"] if has_headings else [])):
        groups = sorted({getattr(log, BALANCE[kind].of) for log in logs})
        if len(groups) > 1:
            unknowns += [Unknown(f"{kind}_{Path(each).name}", kind, of=each) for each in groups]
        elif kind != "rolling":
            unknowns.append(Unknown(kind, kind))
    for own in own_unknowns(problem, names):
        unknowns = [
            each
            for each in unknowns
            if (each.quantity, each.of) != (own.quantity, own.of)
            or (own.wheels and each.wheels and not {*own.wheels} & {*each.wheels})
        ]
        unknowns.append(own)
    kept = tuple(each for each in unknowns if each.quantity not in spec.constants)
    radii = np.full_like(radii, spec.constants.get("radius", radii))
    model = Model(age_priors(kept, logs), fixed, radii, names, half, 1.0 if is_known else 2.0)
    sought_of(model)  # errors of bounds
    return model


def maps_of(problem: Problem[Fit]) -> tuple[tuple[Slopes | None, list[Slopes]], Grid | None]:
    """Return the slopes of the ground, those with further errors of the map, and the map."""
    spec = problem.spec
    if spec.terrain is None:
        return (None, []), None
    grid = build_ground(cast("Any", problem)).grid
    further = list[Slopes]()
    if spec.map_error is not None:
        error = spec.map_error.rms, spec.map_error.correlation
        further = [
            Slopes(disturbed(grid, *error, seed), spec.smoothing) for seed in range(FURTHER_MAPS)
        ]
    return (Slopes(grid, spec.smoothing), further), grid


def fit(problem: Problem[Fit], predict: Sequence[Path] = ()) -> FitResult:
    """Return the fit of a force balance, and errors of predictions.

    Each campaign is predicted by a fit to the others; without two campaigns of each surface, blocks
    of whole manoeuvres take their place. The logs ``predict`` are predicted by a fit to all others.
    ProblemError is raised if the vehicle, an unknown or a log is not valid; ModelError if the logs
    have too few windows.
    """
    spec, rows, inputs = problem.spec, list[tuple[str, str]](), inputs_of(problem)
    own_unknowns(problem, [wheel.name for wheel in inputs.vehicle.wheels])
    maps, grid = maps_of(problem)
    with at(problem, ("data", "file")):
        paths = [problem.folder / name for name in spec.named_files]
        if again := {path.resolve() for path in paths} & {path.resolve() for path in predict}:
            raise ModelError(
                "expected logs to predict that are not fitted, found "
                f"{', '.join(sorted(path.name for path in again))} in both; remove them from one"
            )
        surfaces = spec.data.surfaces
        if surfaces and len(surfaces) not in (len(paths), len(paths) + len(predict)):
            raise ModelError(
                f"expected a surface of each of the {len(paths)} logs, found "
                f"{len(surfaces)} in 'surfaces'; correct them"
            )
        reader = _Reader(problem, inputs, grid, rows)
        logs = reader.read(paths, surfaces[: len(paths)])
        model, window = model_of(problem, inputs, logs), spec.data.window
        named = _known_surfaces(model, surfaces[len(paths) :], predict)
        others = reader.read(predict, named) if predict else []
        first = KINDS[0 if logs[0].heading is not None else 2]
        if window:
            first = WindowKind() if isinstance(window, str) else WindowKind(0.0, window)
        kinds = [first, *(kind for kind in KINDS if kind != first)]  # the first are fitted
        alike = list[Model]()
        if spec.vehicle is None:  # logs hardly show both dimensions: B + L^2 / B is the same
            for width in (0.5, 2.0):
                fixed = {**model.fixed, "track": width}
                alike.append(model._replace(fixed=fixed, effective_track=width + 1 / width))
            words = "none: four wheels of fitted size, with a wheelbase of one track; for the "
            rows.append(("vehicle", f"{words}intervals also of half a track and of two"))
        found, fitted, scores = judge(model, logs, maps, kinds, others, alike)
    return FitResult(found, fitted, scores, others or logs, rows)


def _known_surfaces(
    model: Model, surfaces: Sequence[str], predict: Sequence[Path]
) -> Sequence[str]:
    """Return the surfaces of predicted logs, if several are fitted; else none."""
    fitted = sorted({each.of for each in model.unknowns if each.quantity == "friction"} - {""})
    if predict and fitted and (len(surfaces) != len(predict) or {*surfaces} - {*fitted}):
        raise ModelError(
            f"expected a surface of each predicted log, one of {', '.join(fitted)}, found "
            f"{', '.join(surfaces) or 'none'}; name them with --set data.surfaces=[...], in a fit "
            "after those of its logs"
        )
    return surfaces if fitted else ()


class _Reader(NamedTuple):
    """Reader of logs at equal intervals."""

    problem: Problem[Fit]
    inputs: LogInputs
    grid: Grid | None
    rows: list[tuple[str, str]]  # lines on what is used of each log

    def read(self, paths: Sequence[Path], surfaces: Sequence[str]) -> list[DriveLog]:
        """Return logs at the same intervals."""
        tables = [self._table(path) for path in paths]
        waits = [np.diff(each.t) for each in tables]
        usual = [float(np.median(each[each > 0])) for each in waits if (each > 0).any()]
        step = self.problem.spec.data.step or round(min([MAX_STEP, *usual]), 6)
        alone = len({path.parent for path in paths}) == 1
        names = [path.stem if alone else str(path.parent) for path in paths]
        kinds = surfaces or ["ground"] * len(paths)
        return [self._log(*each, step) for each in zip(tables, names, kinds, strict=True)]

    def _table(self, path: Path) -> MotionLog:
        """Return a log with the columns that the fit requires."""
        data, inputs = self.problem.spec.data, self.inputs
        columns = dict(data.columns)
        vx, vy = columns.pop("velocity") or (None, None)
        if not columns["heading"]:
            names = read_names(path, "a log") if _is_text(path) else ["heading"]
            parts = parts_of("heading", names).values()
            has_heading = any({*PARTS["heading"][1]} <= {*each} for each in parts)
            has_heading |= any(each.lower() in ALIASES[4] for each in names)
            columns["heading"] = "heading" if has_heading else None
        columns |= {"vx": vx, "vy": vy}
        wanted = {name: each for name, each in columns.items() if each and name not in SIDES}
        wanted |= inputs.columns
        wanted |= {"window": data.window} if isinstance(data.window, str) else {}
        units = {"vx": "m/s", "vy": "m/s", "yaw_rate": "rad/s"}
        units |= dict.fromkeys(inputs.names, "m/s" if inputs.are_speeds else "rad/s")
        return read_log(
            path,
            wanted,
            inputs.columns,
            where=self._remedy(),
            units=units,
            is_linear=data.inputs == "readings",
            timeout=data.timeout,
            max_error=data.max_error,
        )

    def _remedy(self) -> str:
        """Return the places in which columns are named, with the remedy for joints without one."""
        tables, unit = "[data.columns] or [data.rates]", ""
        if self.problem.source.is_made:
            rates = "" if self.problem.spec.vehicle is None else " or data.rates"
            tables = f"--set data.columns{rates}, as in --set data.columns.x=east"
            unit = "; the unit of left and right is --set data.unit=rad/s or m/s"
        if joints := self.inputs.joints:
            tables += f', or hold joints that do not move (URDF: joints.{joints[0]} = "fixed")'
        return tables + unit

    def _check(self, log: MotionLog, frame: str) -> None:
        """Raise DataError if columns of a log contradict each other."""
        inputs, spec = self.inputs, self.problem.spec
        radii = inputs.radii[[wheel.driven for wheel in inputs.vehicle.wheels]]
        radii = np.repeat(inputs.radii[:1], 2) if inputs.is_by_sides else radii
        ratios = OF_SPEEDS | OF_POSES if inputs.are_speeds else rate_ratios(radii.tolist())
        place = inputs.places - inputs.places.mean()
        speeds = radii[:, None] * np.array([log.every[name] for name in inputs.names])
        sides = [speeds[own].mean(axis=0) for own in (place < 0, place > 0) if own.any()]
        is_named = any(split_unit(inputs.columns[name])[1] for name in inputs.names)
        is_guessed = spec.vehicle is None and not inputs.are_speeds
        check_motion(
            log,
            zero=0.0 if frame == "rep103" else np.pi / 2,
            speed=speeds.mean(axis=0) if radii.size else None,
            sides=np.array(sides) if len(sides) > 1 and not inputs.joints else None,
            ratios=None if is_named or is_guessed else ratios,
            is_aligned=not moves_sideways(inputs.vehicle),
            may_turn="sensor_heading" in {u.quantity or name for name, u in spec.unknowns.items()},
        )

    def _log(self, log: MotionLog, campaign: str, surface: str, step: float) -> DriveLog:
        """Return a log at equal intervals, and add a line on the rows that are left out."""
        spec, path, t, table = self.problem.spec, log.path, log.t, log.values
        data = spec.data
        frame = {".nc": "paper", ".mcap": "rep103"}.get(path.suffix.lower(), spec.frame)
        if t.size < 2 or np.ptp(t) < 2 * step:
            found = np.ptp(t) if t.size else 0
            raise ModelError(
                f"{path}: expected a log longer than {2 * step:g} s, found {found:g} s; omit it"
            )
        self._check(log, frame)
        once = np.append(True, (np.diff(t) != 0) | (np.diff(table.get("window", t)) != 0))
        t, table = t[once], {name: each[once] for name, each in table.items()}
        of_file, file_t = log.rows[once], log.every["t"]
        z, window = table["x"] + 1j * table["y"], table.get("window", np.zeros(t.size))
        wait, is_other = np.diff(t), np.diff(window) != 0
        follows = is_continuous(t, z, window)
        ends = (wait < 0) | (wait > np.where(is_other, 1.5 * np.median(wait), longest_gap(t)))
        run = np.append(0, np.cumsum(ends))
        parts = [np.flatnonzero(run == number) for number in range(run[-1] + 1)]
        even = [np.arange(t[own[0]], t[own[-1]] + 1e-6 * step, step) for own in parts]
        at_even = np.concatenate(even)
        runs = np.repeat(np.arange(len(even)), [own.size for own in even])
        nearest = list[Indices]()  # row of the run for each sample
        file_run, has_input = np.full(file_t.size, -1), log.has_input.copy()
        has_input[:-1] &= np.diff(file_t) != 0
        for k, (own, ours) in enumerate(zip(parts, even, strict=True)):
            index = np.interp(ours, t[own], np.arange(own.size))
            nearest.append(own[np.ceil(index - 0.5).astype(int)])
            first, last = of_file[own[[0, -1]]]
            file_run[first : last + 1] = k
            has_input[[first, last]] = True
        rows = np.concatenate(nearest)
        pieces = np.append(0, np.cumsum(~follows | ends))
        place, is_fresh, is_held = _places(t, z + complex(*spec.shift), pieces, at_even, rows)
        between = partial(by_runs, at_even, runs, t, run)
        notes = list(log.notes)

        def signal(name: str) -> Array:
            """Return a column at the samples, from all rows: means if many belong to a sample."""
            is_input = name in self.inputs.columns
            own = (file_run >= 0) & (has_input if is_input else np.isfinite(log.every[name]))
            values, of_run, own_t = log.every[name][own], file_run[own], file_t[own]
            usual, hold = float(np.median(np.diff(own_t))) if own.sum() > 1 else step, None
            if is_input and data.inputs == "commands":
                hold = data.timeout or inf
            elif name in self.inputs.names:
                values, period = without_holds(values, of_run, MAX_HOLD / usual)
                words = f"readings new every {period * usual:.3g} s, linear between"
                notes.extend([words] if period > 1 and words not in notes else [])
            width = step if 1.5 * usual < step else 0.0
            return by_runs(at_even, runs, own_t, of_run, values, width, hold)

        signals = [signal(name) for name in self.inputs.names]
        notes += ["poses are held"] if is_held else []
        heading, rate, velocity = None, None, None
        if "heading" in table:
            turned = np.unwrap(table["heading"]) + (np.pi / 2 if frame == "paper" else 0.0)
            heading = turned[rows] if is_held else between(turned)
        if "yaw_rate" in table:
            rate, place_of = signal("yaw_rate"), self.inputs.places
            turn = (place_of - place_of.mean()) @ np.array(signals)  # has its sign
            if float(turn @ rate) < CLOCKWISE * float(np.linalg.norm(turn) * np.linalg.norm(rate)):
                rate = -rate
                notes.append("turning rates are positive clockwise: their sign is reversed")
        if "vx" in table:
            velocity = between(table["vx"]) + 1j * between(table["vy"])
        part = min(MANOEUVRE, float(np.ptp(at_even)) / BLOCKS + step)
        numbers = (at_even - at_even[0]) // part
        speed = np.mean(signals, axis=0)
        bad = self._bad(path, place, velocity, step)
        # a receiver without a fix repeats its last position
        number = np.append(0, np.cumsum(np.diff(place) != 0))
        count, turning = np.bincount(number), np.abs(speed)
        mean = np.bincount(number, turning) / count
        is_frozen = (count * step > longest_gap(t)) & (mean > turning.mean() / 2)
        bad["at a position that is repeated while the wheels turn"] = is_frozen[number]
        vehicle, names, driven = self.inputs.vehicle, self.inputs.names, self.inputs.driven
        signal_of = {
            name: int(place > 0) if self.inputs.is_by_sides else names.index(f"{name}_rate")
            for name, place in driven.items()
        }
        joints = {name: signal(name) for name in self.inputs.joints}
        wheels = [signal_of.get(wheel.name, -1) for wheel in vehicle.wheels]
        drive = DriveLog(
            *(path.stem, campaign, surface, step, chassis_of(vehicle, wheels, joints)),
            np.column_stack(signals),
            runs,
            pieces[rows],
            (table["manoeuvre"][rows] if "manoeuvre" in table else numbers).astype(int),
            place,
            ~np.logical_or.reduce([*bad.values()]),
            is_fresh,
            heading,
            rate,
            velocity,
            np.sign(speed) * (np.abs(speed) > LEAST_SPEED) if data.inputs == "commands" else None,
        )
        no_end = {reason: ~each for reason, each in conditions(drive).items()}
        used, places = (
            ", ".join(f"{each.sum()} {reason}" for reason, each in masks.items() if each.any())
            for masks in ({"samples": at_even > -inf} | bad, no_end)
        )
        leaps = int((~follows & ~is_other).sum())
        parts_of_line = [used, f"{leaps} gaps or leaps of the position" if leaps else ""]
        parts_of_line += [
            f"windows do not begin or end at {places}" if places else "",
            *log.rows_left_out,
        ]
        parts_of_line += [log.hold if log.held[0] > longest_gap(t) else "", *notes]
        self.rows.append((f"log {path.stem}", "; ".join(filter(None, parts_of_line))))
        return drive

    def _bad(
        self, path: Path, place: ComplexArray, velocity: ComplexArray | None, step: float
    ) -> dict[str, Mask]:
        """Return samples whose positions are not reliable, by the reason.

        ``place`` are positions x + iy [m], ``velocity`` measured velocities in the same axes [m/s],
        ``step`` the time between samples [s].
        """
        bad = {"not finite": ~np.isfinite(place)}
        if self.grid is not None:
            west, east, south, north = *self.grid.x[[0, -1]], *self.grid.y[[0, -1]]
            on_map = (place.real >= west) & (place.real <= east)
            on_map &= (place.imag >= south) & (place.imag <= north)
            if not on_map.any():
                raise ModelError(
                    f"{path}: expected positions on the map, x from {west:.10g} to {east:.10g} m "
                    f"and y from {south:.10g} to {north:.10g} m, found none, the first at x = "
                    f"{place[0].real:.10g}, y = {place[0].imag:.10g} m; correct 'shift' or columns"
                )
            bad["beyond the map"] = ~on_map
        if velocity is not None:
            # those about which positions and measured velocities disagree over a second
            half = max(round(0.5 / step), 1)
            wide = np.pad(place, half, mode="reflect", reflect_type="odd")
            chord = np.abs(wide[2 * half :] - wide[: -2 * half]) / (2 * half * step)
            mean = scipy.ndimage.uniform_filter1d(np.abs(velocity), 2 * half + 1, mode="nearest")
            jumps = scipy.ndimage.binary_dilation(
                np.abs(chord - mean) > JUMP, np.ones(2 * half + 1)
            )
            bad["at positions against the velocities"] = np.asarray(jumps, bool)
        return bad


def _places(
    t: Array, z: ComplexArray, pieces: Indices, even: Array, rows: Indices
) -> tuple[ComplexArray, Mask, bool]:
    """Return positions at samples, whether a pose is new there, and whether poses are held.

    ``z`` are positions x + iy at the times ``t`` of rows [m], ``pieces`` the numbers of the runs of
    rows, ``even`` the times of samples and ``rows`` their rows. Poses are held if they repeat
    between new ones; a sample between two new ones is interpolated.
    """
    is_same = np.diff(pieces) == 0
    moved = np.append(False, (np.diff(z) != 0) & is_same)
    is_held = held_for(moved) > 1
    is_new = np.asarray(moved | (not is_held), bool)
    place, own = z[rows].copy(), pieces[rows]
    for number in np.unique(own):
        new, here = np.flatnonzero(is_new & (pieces == number)), own == number
        if new.size > 1:
            place[here] = np.interp(even[here], t[new], z[new])
    step = np.median(np.diff(even)) / 2 + 1e-9
    return place, is_new[rows] & (np.abs(t[rows] - even) <= step), is_held


def facts(result: FitResult) -> Lines:
    """Return the facts of a fit: constants, weak directions, and errors of predictions."""
    verdict = result.outcome.title
    if result.outcome is Outcome.INACCURATE:
        share = next(iter(result.scores.values())).share
        verdict += f": errors of {100 * share:.2g} % of the path; check vehicle, units, columns"
    lines = [("outcome", verdict), *result.rows]
    if fit := result.fit:
        lines.append(("fitted windows", str(len(fit.errors))))
        weak = dict.fromkeys(as_priors(fit), AS_ITS_PRIOR)
        lines += [*estimate_lines(constant_rows(fit), weak), *direction_lines(fit.estimate)]
    return [*lines, *_error_lines(result.scores)]


def estimate_lines(
    rows: Sequence[dict[str, Any]], weak: Mapping[str, str]
) -> Iterator[tuple[str, str]]:
    """Yield estimates with 95 % intervals, from rows of `estimate_rows`.

    ``weak`` are the words on estimates that the data do not determine, by name, with braces in the
    place of the interval.
    """
    for name, unit, before, value, _, low, high, at_bound, *_ in map(dict.values, rows):
        size, reach = max(abs(low), abs(high)), (high - low) / 2
        n = 4  # digits that show the interval
        if np.isfinite(reach) and 0 < reach < size:
            n = int(np.clip(2 - np.floor(np.log10(reach / size)), 4, 12))
        words = weak.get(name, "{}").format(f"95 % interval {low:.{n}g} to {high:.{n}g}")
        words = "at its bound: the data favour values beyond it" if at_bound else words
        after = f"{value:.{n}g}{'' if unit == '1' else f' {unit}'}"
        yield name, f"{after} ({words}), before {before:.4g}"


def direction_lines(estimate: Estimate) -> Iterator[tuple[str, str]]:
    """Yield the combinations of unknowns that the data determine weakly, or not at all."""
    names = [
        label.name
        for label, fixed in zip(estimate.labels, estimate.at_bound, strict=True)
        if not fixed
    ]
    for direction in estimate.directions:
        # weights are relative to the sizes of the unknowns
        terms = [
            f"{weight:+.2g} {name}"
            for weight, name in zip(direction.weights, names, strict=True)
            if abs(weight) > SHOWN_WEIGHT
        ]
        main = names[int(np.abs(direction.weights).argmax())]
        words = main if len(terms) == 1 else " ".join(terms)
        if direction.deviation > WEAK:
            size = f"standard deviation {100 * direction.deviation:.3g} % of its size"
            size = size if np.isfinite(direction.deviation) else "without any information"
            kind = "not determined" if direction.deviation > 1 else "weakly determined"
            yield kind, f"{words}: {size}"


def estimate_rows(estimate: Estimate) -> list[dict[str, Any]]:
    """Return the rows of a table of the estimates, in SI units."""
    deviation = np.sqrt(np.diag(estimate.covariance))
    numbers = estimate.nominal, estimate.values, deviation, *estimate.intervals.T
    columns = [*(each.tolist() for each in numbers), map(int, estimate.at_bound)]
    names = "name", "unit", "nominal", "value", "deviation", "lower", "upper", "at_bound"
    return [
        dict(zip(names, (label.name, label.unit, *own), strict=True))
        for label, *own in zip(estimate.labels, *columns, strict=True)
    ]


def constant_rows(fit: DriveFit) -> list[dict[str, Any]]:
    """Return the rows of a table of the constants, in SI units.

    Radii of sides whose speeds are given are factors.
    """
    estimate, unknowns = fit.estimate, fit.model.unknowns
    scale, deviation = Scale.of(unknowns), np.sqrt(np.diag(estimate.covariance))
    factors = {"radius"} if (fit.model.radii == 1).all() else set()
    pairs = zip(estimate.labels, unknowns, strict=True)
    spread = np.where(scale.is_log, fit.values * deviation, deviation)
    rows = estimate_rows(
        estimate._replace(
            labels=tuple(replace(a, unit="1") if u.quantity in factors else a for a, u in pairs),
            nominal=scale.values(estimate.nominal),
            values=fit.values,
            covariance=np.diag(spread**2),
            intervals=np.column_stack([scale.values(each) for each in estimate.intervals.T]),
        )
    )
    is_as_prior = (deviation > AS_PRIOR * estimate.scales).astype(int).tolist()
    return [row | {"as_prior": each} for row, each in zip(rows, is_as_prior, strict=True)]


def as_priors(fit: DriveFit) -> tuple[str, ...]:
    """Return the unknowns that the logs do not determine: they are as their priors."""
    return tuple(row["name"] for row in constant_rows(fit) if row["as_prior"])


def undetermined(problem: Problem[Fit], fit: DriveFit) -> tuple[str, ...]:
    """Return the unknowns of the file without a prior that the logs do not determine."""
    own = {name for name, table in problem.spec.unknowns.items() if table.prior is None}
    return tuple(name for name in as_priors(fit) if name in own)


def _error_lines(scores: Mapping[WindowKind, Score]) -> Iterator[tuple[str, str]]:
    """Yield errors, intervals and coverage by kind of window."""
    for kind, score in scores.items():
        row = _row(kind, score)
        interval = f" ({row['position_lower']:.3g} to {row['position_upper']:.3g})"
        yield (
            kind.words,
            f"rms {row['position_rms']:.3g} m{interval if row['logs'] > 1 else ''}, "
            f"{100 * score.share:.2g} % of the path, {np.rad2deg(row['turn_rms']):.3g} deg; "
            f"{row['windows']} windows, 90 % intervals +-{row['reach_along']:.2g} m, "
            f"+-{row['reach_across']:.2g} m, +-{np.rad2deg(row['reach_turn']):.2g} deg contain "
            f"{100 * row['coverage_along']:.0f}, {100 * row['coverage_across']:.0f}, "
            f"{100 * row['coverage_turn']:.0f} %; campaigns: {score.campaigns}",
        )
        if count := int(score.is_beyond.sum()):
            low, high = np.rad2deg([score.grade.min(), score.grade.max()])
            yield (
                f"{kind.words}, extrapolated",
                f"{count} of {score.grade.size} windows, with grades from {low:.1f} to {high:.1f} "
                "deg, are beyond those that were fitted; intervals do not hold there",
            )


AXES = "along", "across", "turn"


def _row(kind: WindowKind, score: Score) -> dict[str, Any]:
    """Return errors and intervals of a kind of windows as a row of the table [m, rad]."""
    errors, log = score.errors, score.windows.log
    row: dict[str, Any] = kind._asdict() | {"windows": log.size, "logs": np.unique(log).size}
    row["campaigns"] = score.campaigns
    for name, each in (("position", errors.position), ("turn", errors.turn)):
        value, low, high = by_logs(each, log, rms)
        row |= {f"{name}_rms": value, f"{name}_lower": low, f"{name}_upper": high}
        row[f"{name}_median"] = float(np.median(np.abs(each)))
    row |= {"along_rms": rms(errors.along), "across_rms": rms(errors.across)}
    for axis, reach, share in zip(AXES, score.reach, score.coverage.tolist(), strict=True):
        row |= {f"reach_{axis}": float(reach.mean()), f"coverage_{axis}": share}
    return row


def error_rows(scores: Mapping[WindowKind, Score]) -> list[dict[str, Any]]:
    """Return the rows of a table of the errors by kind of window [m, s, rad]."""
    return [_row(*each) for each in scores.items()]


def window_rows(result: FitResult) -> list[dict[str, Any]]:
    """Return the rows of a table of the predicted windows [m, s, rad]."""
    names = ["length", "duration", "log", "start", "path", "grade", "beyond"]
    names += [f"{kind}_{axis}" for kind in ("error", "reach") for axis in AXES]
    rows = [
        [*kind, log.name, first * log.dt, path, grade, int(is_beyond), *others]
        for kind, (errors, windows, grades, beyond, reach, _) in result.scores.items()
        for k, first, path, grade, is_beyond, *others in zip(
            *(windows.log, windows.first.tolist(), windows.length.tolist(), grades.tolist()),
            *(beyond, *np.vstack([*errors, *reach]).tolist()),
            strict=True,
        )
        for log in [result.predicted[k]]
    ]
    return [dict(zip(names, row, strict=True)) for row in rows]


def fitted_vehicle(problem: Problem[Fit], fit: DriveFit) -> tuple[Vehicle, list[str]]:
    """Return the vehicle with fitted dimensions, and lines of a comment with other constants.

    The moment of inertia of a vehicle stays if the logs do not determine it.
    """
    vehicle, radii = build_vehicle(problem), dict[str, float]()
    others = {name: value for name, value in fit.model.fixed.items() if name in LAW_KEYS}
    width, center = None, dict[int, float]()
    gyration, weak = None, as_priors(fit)
    for unknown, value in zip(fit.model.unknowns, fit.values.tolist(), strict=True):
        if unknown.quantity == "radius":
            for wheel in vehicle.wheels:
                if wheel.name in unknown.wheels or not unknown.wheels:
                    factor = float(wheel.radius) if (fit.model.radii == 1).all() else 1.0
                    radii[wheel.name] = factor * value
        elif unknown.quantity == "track":
            width = value
        elif unknown.quantity.startswith("center_of_mass"):
            center[int(unknown.quantity.endswith("ahead"))] = value
        elif unknown.quantity == "gyration" and unknown.name not in weak:
            gyration = value
        else:
            others[unknown.name] = value
    lines = ["fitted by slipfree fit; keys of a problem file, or of --set:"]
    for name, value in others.items():
        kind, _, surface = name.partition("_")
        on = f"  # on {surface}" if surface else ""
        lines += [f"{key} = {value!r}{on}" for key in LAW_KEYS.get(kind, ())]
    lines += [
        f"{name}: {value:.6g} (not part of vehicle and law)"
        for name, value in others.items()
        if name.partition("_")[0] not in LAW_KEYS
    ]
    return with_dimensions(vehicle, radii, width, center, gyration), lines


def save_fit(path: Path, problem: Problem[Fit], settings: Sequence[str], result: FitResult) -> None:
    """Write a fit as netCDF, with its problem and settings, for predictions of other logs."""
    assert result.fit is not None  # noqa: S101
    model = result.fit.model
    contents = {
        "file": str(problem.source.path.resolve()),
        "text": problem.source.text,
        "settings": [*settings],
        "unknowns": [[u.name, u.quantity, u.wheels, u.of] for u in model.unknowns],
        "model": [dict(model.fixed), model.radii.tolist(), model.wheels, *model[4:]],
        "values": result.fit.values.tolist(),
        "facts": facts(result),
        "fitted": [[kind, [each.tolist() for each in own]] for kind, own in result.fitted.items()],
    }

    def fill(part: Path) -> None:
        with scipy.io.netcdf_file(part, "w", version=2) as file:
            setattr(file, ORIGIN, __version__)
            setattr(file, FIT, json.dumps(contents).encode())

    replace_file(path, fill)


def read_fit(path: Path) -> dict[str, Any]:
    """Return the contents of a fit that `save_fit` wrote; raise DataError for other files."""
    file = open_netcdf(path)
    file.stream.close()
    text = file.attributes.get(FIT)
    if not isinstance(text, str):
        raise DataError(
            f"{path}: expected a fit, found another result; give the file that slipfree fit wrote"
        )
    contents: dict[str, Any] = json.loads(text)
    return contents


def predict_logs(
    problem: Problem[Fit],
    contents: Mapping[str, Any],
    paths: Sequence[Path],
    surfaces: Sequence[str] = (),
) -> FitResult:
    """Return the errors of logs that are predicted with the contents of a fit.

    If it has several surfaces, ``surfaces`` are those of the logs.
    """
    unknowns = tuple(
        Unknown(name, quantity, tuple(wheels), of=of)
        for name, quantity, wheels, of in contents["unknowns"]
    )
    fixed, radii, wheels, *sizes = contents["model"]
    model = Model(unknowns, fixed, np.array(radii), tuple(wheels), *sizes)
    known = Known(model, np.array(contents["values"]))
    (slopes, _), grid = maps_of(problem)
    rows = list[tuple[str, str]]()
    with at(problem, ("data", "surfaces")):
        named = _known_surfaces(model, surfaces, paths)
    logs = _Reader(problem, inputs_of(problem, paths), grid, rows).read(paths, named)
    rests = {
        WindowKind(*kind): Fitted(*map(np.array, errors)) for kind, errors in contents["fitted"]
    }
    return FitResult(None, {}, score_kinds(known, rests, logs, slopes), logs, rows)
