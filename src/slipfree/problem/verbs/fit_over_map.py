"""Fits over a map: models of a skid-steered vehicle from logs of commands and positions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, cast

import numpy as np
from pydantic import Field

from slipfree.core.errors import ModelError
from slipfree.core.facts import Lines
from slipfree.core.records import Array, Mask
from slipfree.files.logs import OF_POSES, OF_SPEEDS, check_motion, is_continuous, read_log
from slipfree.files.tables import split_unit
from slipfree.files.toml.source import Fault, problem_error
from slipfree.files.toml.types import Pair, Positive, Quantity, Record
from slipfree.fit.ground_fit import (
    FITTED,
    GroundFit,
    Kind,
    Score,
    by_logs,
    fit_on_uncertain_map,
    judge,
    rms,
)
from slipfree.fit.ground_motion import (
    DRIVES_AND_SENSORS,
    MODELS,
    DriveLog,
    MotionModel,
    Slopes,
    conditions,
    windows_of,
    with_drives_and_sensors,
)
from slipfree.fit.ground_vehicle import vehicle_model
from slipfree.fit.unknowns import QUANTITIES, Unknown, law_constants, with_unknowns
from slipfree.problem.build import model_law
from slipfree.problem.build_ground import at, build_ground
from slipfree.problem.build_vehicle import build_vehicle
from slipfree.problem.problem import Problem
from slipfree.problem.schema import (
    MODEL,
    VERB,
    CommonKeys,
    HeightErrors,
    LawKeys,
    TerrainTable,
    VehicleSource,
)
from slipfree.problem.verbs.fit import (
    LogKeys,
    Name,
    UnknownTable,
    build_model,
    log_paths,
    vehicle_comments,
)
from slipfree.terrain.base import Grid
from slipfree.terrain.grid_ops import disturbed
from slipfree.vehicle.tree import Vehicle

JUMP = 0.25  # of positions against measured velocities over a second [m/s]
LEAST_SPEED = 0.1  # commanded speed from which the vehicle drives in one direction [m/s]
FURTHER_MAPS = 4  # with further errors
VEHICLE = "vehicle"  # name of the model of the vehicle


class DriveColumns(Record):
    """Columns of a log of commands and positions."""

    t: str = Field(default="t", description="column of the time, in s")
    x: str = Field(default="x", description="column of the receiver's x on the map, in m")
    y: str = Field(default="y", description="column of the receiver's y on the map, in m")
    left: str = Field(default="left", description="column of the left side's command, in m/s")
    right: str = Field(default="right", description="column of the right side's command, in m/s")
    velocity: Annotated[tuple[Name, Name], Field(strict=False)] | None = Field(
        default=None,
        description="columns of the receiver's velocity along x and y, measured by the Doppler "
        "shift, in m/s; by default, the derivative of the positions",
    )
    heading: Name | None = Field(
        default=None,
        description="column of the vehicle's heading from x, by a compass or an inertial unit, in "
        "rad; by default, courses follow from positions and velocities",
    )
    error: Name | None = Field(
        default=None, description="column of the stated error of the position, in m"
    )


class DriveData(LogKeys):
    """Logs of commands and positions."""

    files: Annotated[tuple[Name, ...], Field(strict=False, min_length=2)] = Field(
        description="the logs: tables as text; those of one folder are left out together"
    )
    step: Annotated[Positive, Field(le=0.5)] = Field(
        default=0.1, description="time between the samples that are used, at most 0.5 [s]"
    )
    delay: Quantity = Field(default=0.0, ge=0, description="from a command to the motion [s]")
    columns: DriveColumns = Field(default=DriveColumns(), description="names of the columns")


class MapUnknownTable(UnknownTable):
    """A number to be fitted beside the constants of the models."""

    quantity: str | None = Field(
        default=None,
        description=f"of all models: {', '.join(DRIVES_AND_SENSORS)} (turn only of the vehicle); "
        f"of the vehicle: {', '.join(QUANTITIES)}, or a constant of the law; by default the name "
        "of the table",
    )


class FitOverMap(LawKeys, CommonKeys):
    """Fit over a map: models of a skid-steered vehicle from logs of commands and positions."""

    verb: Literal["fit-over-map"] = Field(description=VERB)
    terrain: TerrainTable = Field(description="the ground")
    data: DriveData = Field(description="the logs")
    shift: Pair = Field(
        default=(0.0, 0.0), description="place on the map of the origin of the logs [m]"
    )
    smoothing: Quantity = Field(
        default=0.0, ge=0, description="standard deviation over which slopes are averaged [m]"
    )
    map_error: HeightErrors | None = Field(
        default=None, description="error of the map: what it changes in the fit is subtracted"
    )
    models: Annotated[
        tuple[Literal[tuple(MODELS)], ...],  # type: ignore[valid-type]
        Field(strict=False),
    ] = Field(default=("differential", "icr", "slope"), description=f"models: {', '.join(MODELS)}")
    vehicle: VehicleSource | None = Field(
        default=None, description="a skid-steered vehicle as a further model, with nominal values"
    )
    model: Literal["kinematics", "quasi-static"] = Field(default="kinematics", description=MODEL)
    unknowns: dict[str, MapUnknownTable] = Field(
        default={}, description="further numbers to be fitted, by name [m, rad, s, 1]"
    )
    lengths: Annotated[tuple[Positive, ...], Field(strict=False)] = Field(
        default=(FITTED[0], 20.0), description="lengths of path of the windows [m]"
    )
    duration: Positive = Field(default=5.0, description="duration of further windows [s]")

    @property
    def named_files(self) -> tuple[str, ...]:
        """Names of the logs."""
        return self.data.files


class FittedModels(NamedTuple):
    """Models over a map by name, errors of their predictions, and fits to all logs."""

    models: dict[str, MotionModel]
    scores: dict[str, dict[Kind, Score]]
    fits: dict[str, GroundFit]
    predicted: list[DriveLog]
    rows: Lines  # of each log: what is used of it


def fit_over_map(problem: Problem[FitOverMap], predict: Sequence[Path] = ()) -> FittedModels:
    """Return errors of predictions and fits of the models.

    Each folder of logs is predicted with constants fitted to the others; each log if there is one
    folder. The logs ``predict`` are predicted with constants fitted to all.
    """
    spec = problem.spec
    ground = build_ground(cast("Any", problem))  # a problem without motion
    models = models_of(problem, ground.mu)
    slopes, further = Slopes(ground.grid, spec.smoothing), list[Slopes]()
    if spec.map_error is not None:
        error = spec.map_error.rms, spec.map_error.correlation
        further = [
            Slopes(disturbed(ground.grid, *error, seed), spec.smoothing)
            for seed in range(FURTHER_MAPS)
        ]
    with at(problem, ("data", "files")):
        paths = log_paths(problem, predict)
        alone = len({path.parent for path in paths}) == 1
        groups = [path.name if alone else str(path.parent) for path in paths]
        rows: Lines = []
        read = partial(_read_log, spec, ground.grid, rows)
        logs = [read(*each) for each in zip(paths, groups, strict=True)]
        others = [read(path, path.stem) for path in predict]
        kinds = [*((length, 0.0) for length in spec.lengths), (0.0, spec.duration)]
        scores, folds = judge(logs, slopes, models, kinds, others, further)
        windows = windows_of(logs, *FITTED)
        fits = {
            name: folds[name][-1]
            if others
            else fit_on_uncertain_map(model, logs, windows, (slopes, further))
            for name, model in models.items()
        }
        return FittedModels(models, scores, fits, others or logs, rows)


def models_of(
    problem: Problem[FitOverMap], friction: float | Grid | None
) -> dict[str, MotionModel]:
    """Return the models, with that of the vehicle last."""
    spec, unknowns = problem.spec, list[Unknown]()
    models = {name: MODELS[name] for name in spec.models}
    known = dict.fromkeys(DRIVES_AND_SENSORS)
    vehicle, law = None, None
    if spec.vehicle is not None:
        vehicle = build_vehicle(problem)
        law = model_law(problem)
        known |= dict.fromkeys([*QUANTITIES, *law_constants(law)])
    for name, table in spec.unknowns.items():
        with at(problem, ("unknowns", name)):
            unknowns.append(table.unknown(name))
            if unknowns[-1].quantity not in known:
                remedy = "correct it" if vehicle else "correct it, or add the table [vehicle]"
                raise ModelError(
                    f"unknown {name!r}: expected one of the quantities {', '.join(known)}, found "
                    f"{unknowns[-1].quantity!r}; {remedy}"
                )
    if vehicle is not None:
        with at(problem, ("vehicle",)):
            build = partial(build_model, spec.model)
            words = f"vehicle, {spec.model}"
            models[VEHICLE] = vehicle_model(words, build, vehicle, law, unknowns, friction)
    if not models:
        raise problem_error(
            problem.source, [Fault(("models",), "at least one model, or a vehicle", "none")]
        )
    # the other models have a track or centres of rotation
    common = [each for each in unknowns if each.quantity != "turn"]
    return {
        name: with_drives_and_sensors(each, unknowns if name == VEHICLE else common)
        for name, each in models.items()
    }


def _read_log(spec: FitOverMap, grid: Grid, rows: Lines, path: Path, group: str) -> DriveLog:
    """Return a log at equal intervals; positions are linear between samples, commands are held.

    Samples beyond the map, in gaps, and at leaps of the position are not good; a line on them is
    added to ``rows``.
    """
    data, columns = spec.data, dict(spec.data.columns)
    vx, vy = columns.pop("velocity") or (None, None)
    wanted = {name: each for name, each in (columns | {"vx": vx, "vy": vy}).items() if each}
    speeds = dict.fromkeys(("left", "right", "vx", "vy"), "m/s")
    log = read_log(
        path,
        wanted,
        ("left", "right"),
        where="[data.columns]",
        units=speeds,
        timeout=data.timeout,
        max_error=data.max_error,
    )
    t, table = log.t, log.values
    even = np.arange(t[0], t[-1], data.step)
    if even.size < 2:
        raise ModelError(
            f"{path}: expected a log longer than {data.step:g} s, found {t[-1] - t[0]:g} s; omit it"
        )
    is_named = any(split_unit(columns[side])[1] for side in ("left", "right"))
    check_motion(
        log,
        speed=(table["left"] + table["right"]) / 2,
        turn=table["right"] - table["left"],
        ratios=None if is_named else OF_SPEEDS | OF_POSES,
        may_turn="sensor_heading" in {u.quantity or name for name, u in spec.unknowns.items()},
    )

    def between(*names: str) -> Array:
        return np.column_stack([np.interp(even, t, table[name]) for name in names])

    place = between("x", "y") + spec.shift
    velocity = between("vx", "vy") if vx else np.gradient(place, data.step, axis=0)
    heading = np.interp(even, t, np.unwrap(table["heading"])) if "heading" in table else None
    held = np.searchsorted(t, np.maximum(even - data.delay, t[0]) + 1e-9, side="right") - 1
    sides = np.column_stack([table["left"], table["right"]])[held]
    if data.timeout is not None:
        sides[even - data.delay - t[held] > data.timeout] = 0
    corners = np.array([[grid.x[0], grid.y[0]], [grid.x[-1], grid.y[-1]]])
    on_map = ((place >= corners[0]) & (place <= corners[1])).all(axis=1)
    if not on_map.any():
        (west, south), (east, north) = corners
        raise ModelError(
            f"{path}: expected positions on the map, x from {west:g} to {east:g} m and y from "
            f"{south:g} to {north:g} m, found none, the first at x = {place[0, 0]:g}, "
            f"y = {place[0, 1]:g} m; correct 'shift' or the columns"
        )
    follows = is_continuous(t, table["x"] + 1j * table["y"], np.zeros(t.size))
    later = np.clip(np.searchsorted(t, even, side="right"), 1, t.size - 1)
    speed = np.hypot(*velocity.T)
    bad = {"beyond the map": ~on_map, "in gaps or at leaps of the position": ~follows[later - 1]}
    if vx:
        bad["at positions against the velocities"] = _jumps(place, speed, data.step)
    good = ~np.logical_or.reduce([*bad.values()])
    mean = sides.mean(axis=1)
    direction = np.where(np.abs(mean) > LEAST_SPEED, np.sign(mean), 0.0)
    is_measured = vx is not None
    drive = DriveLog(
        *(path.stem, group, data.step, place, velocity, speed, good, direction, sides),
        is_measured,
        heading,
    )
    no_end = {reason: ~each for reason, each in conditions(drive).items()}
    used, ends = (
        ", ".join(f"{each.sum()} {reason}" for reason, each in masks.items() if each.any())
        for masks in ({"samples": even >= 0} | bad, no_end)
    )
    ends = f"windows do not begin or end at {ends}" if ends else ""
    words = "; ".join(filter(None, [used, ends, *log.rows_left_out, log.hold, *log.notes]))
    rows.append((f"log {path.stem}", words))
    return drive


def _jumps(place: Array, speed: Array, step: float) -> Mask:
    """Return samples about which positions and measured velocities disagree, over a second."""
    half = max(round(0.5 / step), 1)
    wide = np.pad(place, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    chord = np.hypot(*(wide[2 * half :] - wide[: -2 * half]).T) / (2 * half * step)

    def mean(values: Array) -> Array:
        width = 2 * half + 1
        return np.convolve(np.pad(values, half, mode="edge"), np.ones(width) / width, "valid")

    return mean(np.abs(chord - mean(speed)) > JUMP) > 0


def facts(fitted: FittedModels) -> Lines:
    """Return constants and errors of all models as lines."""
    return [*fitted.rows, *_constants(fitted), *_errors(fitted.scores)]


def _constants(fitted: FittedModels) -> Iterator[tuple[str, str]]:
    """Yield the constants of each model with their intervals."""
    words = dict[str, list[str]]()
    for name, key, unit, value, _, low, high, at_bound in constant_rows(fitted)[1]:
        size = f"{key} {value:.4g}{'' if unit == '1' else f' {unit}'}"
        interval = "at its bound" if at_bound else f"{low:.4g} to {high:.4g}"
        words.setdefault(name, []).append(f"{size} ({interval})")
    return ((fitted.models[name].words, ", ".join(each)) for name, each in words.items())


def constant_rows(fitted: FittedModels) -> tuple[list[str], list[list[Any]]]:
    """Return column names and rows of the constants of all models."""
    names = ["model", "name", "unit", "value", "deviation", "lower", "upper", "at_bound"]
    rows = list[list[Any]]()
    for name, fit in fitted.fits.items():
        for key, value in fit.values.items():
            unit, deviation = fitted.models[name].units[key], fit.deviation[key]
            rows.append(
                [name, key, unit, value, deviation, *fit.intervals[key], int(not deviation)]
            )
    return names, rows


def fitted_vehicle(problem: Problem[FitOverMap], fitted: FittedModels) -> tuple[Vehicle, list[str]]:
    """Return the vehicle with fitted values, and lines of a comment with the other constants."""
    values = dict(fitted.fits[VEHICLE].values)
    unknowns = [table.unknown(name) for name, table in problem.spec.unknowns.items()]
    own = [each for each in unknowns if each.quantity in QUANTITIES]
    vehicle = build_vehicle(problem)
    changed = with_unknowns(vehicle, own, [values.pop(each.name) for each in own])
    return changed, vehicle_comments(values)


def _errors(scores: Mapping[str, Mapping[Kind, Score]]) -> Iterator[tuple[str, str]]:
    """Yield the lines on errors of prediction: by distance, by time, and of slip by grade."""
    for kind in next(iter(scores.values())):
        label = f"{kind[0]:g} m of path" if kind[0] else f"{kind[1]:g} s"
        for name, own in scores.items():
            row = dict(zip(COLUMNS, _row(name, kind, own[kind]), strict=True))
            interval = f" ({row['position_lower']:.3g} to {row['position_upper']:.3g})"
            yield (
                f"{label}, {name}",
                f"rms {row['position_rms']:.3g} m{interval if row['logs'] > 1 else ''}, "
                f"{np.rad2deg(row['course_rms']):.3g} deg; {row['windows']} windows, 90 % "
                f"intervals +-{row['reach_along']:.2g} m, +-{row['reach_across']:.2g} m, "
                f"+-{np.rad2deg(row['reach_course']):.2g} deg hold "
                f"{100 * row['coverage_along']:.0f}, {100 * row['coverage_across']:.0f}, "
                f"{100 * row['coverage_course']:.0f} %",
            )
        score = next(iter(scores.values()))[kind]
        if count := int(score.is_beyond.sum()):
            low, high = np.rad2deg([score.grade.min(), score.grade.max()])
            yield (
                f"{label}, extrapolated",
                f"{count} of {score.grade.size} windows, with grades from {low:.1f} to {high:.1f} "
                "deg, are beyond those that were fitted; intervals do not hold there",
            )
    for name, own in scores.items():
        kind = next(each for each in own if not each[0])
        words = (
            f"{np.rad2deg(low):.0f} to {np.rad2deg(high):.0f} deg: {error:+.3f} ({count})"
            for low, high, count, error in own[kind].slip()
        )
        yield f"error of slip, {name}", ", ".join(words)


AXES = "along", "across", "course"
COLUMNS = (
    *("model", "length", "duration", "windows", "logs"),
    *("position_rms", "position_lower", "position_upper", "position_median"),
    *("along_rms", "across_rms", "course_rms", "course_lower", "course_upper"),
    *("reach_along", "reach_across", "reach_course"),
    *("coverage_along", "coverage_across", "coverage_course"),
)


def _row(name: str, kind: Kind, score: Score) -> list[Any]:
    errors, log = score.errors, score.windows.log
    return [
        *(name, *kind, log.size, np.unique(log).size),
        *by_logs(errors.position, log, rms),
        float(np.median(errors.position)),
        *(rms(errors.along), rms(errors.across)),
        *by_logs(errors.course, log, rms),
        *score.reach.mean(axis=1).tolist(),
        *score.coverage.tolist(),
    ]


def error_rows(scores: Mapping[str, Mapping[Kind, Score]]) -> tuple[list[str], list[list[Any]]]:
    """Return column names and rows of the errors of all models [m, s, rad]."""
    rows = [_row(name, kind, score) for name, own in scores.items() for kind, score in own.items()]
    return list(COLUMNS), rows


def window_rows(fitted: FittedModels) -> tuple[list[str], list[list[Any]]]:
    """Return column names and rows of the predicted windows of all models [m, s, rad]."""
    names = ["model", "length", "duration", "log", "start", "path", "grade", "beyond"]
    names += ["displacement", *(f"{kind}_{axis}" for kind in ("error", "reach") for axis in AXES)]
    return names, [
        [name, *kind, log.name, first * log.dt, path, grade, int(is_beyond), size, *errors, *reach]
        for name, own in fitted.scores.items()
        for kind, score in own.items()
        for k, first, path, grade, is_beyond, size, errors, reach in zip(
            score.windows.log.tolist(),
            score.windows.first.tolist(),
            score.windows.length.tolist(),
            score.grade.tolist(),
            score.is_beyond.tolist(),
            score.errors.displacement.tolist(),
            np.column_stack(score.errors[:3]).tolist(),
            score.reach.T.tolist(),
            strict=True,
        )
        for log in [fitted.predicted[k]]
    ]
