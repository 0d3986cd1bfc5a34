"""Wheel files of ``slipfree wheel``: a wheel, its load, a soil, slip ratios and slip angles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field, ValidationError, create_model

from slipfree.core.errors import DataError
from slipfree.core.records import Array
from slipfree.files.tables import read_columns, read_names
from slipfree.files.toml.source import (
    Fault,
    Source,
    key_lines,
    parse_toml,
    problem_error,
    read_text,
    replace_values,
    validation_fault,
    value_errors,
)
from slipfree.files.toml.types import Angle, Positive, Record, given_values
from slipfree.laws.soil import Soil, WheelSize
from slipfree.models.single_wheel import WheelCurves, single_wheel, steady_forces
from slipfree.problem.schema import NamedSoil, soil_of
from slipfree.problem.verbs.base import Lines

COLUMNS = {"pull": "N", "side": "N", "torque": "N m", "sinkage": "m"}
QUANTITIES = tuple(COLUMNS)
MAX_POINTS = 100_000  # slip ratios times slip angles


class TestedWheelTable(Record):
    """Table ``[wheel]``: dimensions and load of the wheel."""

    radius: Positive = Field(description="radius, without grousers [m]")
    width: Positive = Field(description="width [m]")
    load: Positive = Field(description="vertical load [N]")


SlipRatio = Annotated[float, Field(ge=-1, le=1)]
SlipAngle = Annotated[Angle, Field(gt=-np.pi / 2, lt=np.pi / 2)]


class TestTable(Record):
    """Table ``[test]``: slip ratios, slip angles and measured points."""

    slip: Annotated[tuple[SlipRatio, SlipRatio], Field(strict=False)] = Field(
        default=(0.0, 0.8), description="lowest and highest slip ratio [1]"
    )
    points: Annotated[int, Field(ge=2, le=10_000)] = Field(
        default=81, description="number of slip ratios"
    )
    slip_angles: Annotated[tuple[SlipAngle, ...], Field(strict=False, min_length=1)] = Field(
        default=(0.0,), description='slip angles [rad], or text as in "15 deg"'
    )
    measured: str | None = Field(
        default=None,
        description="CSV file of measured points: a column 'slip', one of "
        f"{', '.join(QUANTITIES)}, and, where they are not zero and wheel.load, columns "
        "'slip_angle' [rad] and 'load' [N]",
    )


@cache
def wheel_file() -> type[Record]:
    """Return the schema of a wheel file; the table ``[soil]`` has the constants of `Soil`."""
    tables: dict[str, Any] = {
        "title": (str | None, Field(default=None, description="title of the summary")),
        "wheel": (TestedWheelTable, Field(description="the wheel")),
        "soil": (NamedSoil, Field(default=NamedSoil(), description="the soil")),
        "test": (TestTable, Field(default=TestTable(), description="the test")),
    }
    return create_model("WheelFile", __base__=Record, **tables)


class Measured(NamedTuple):
    """Measured points: slip ratio [1], slip angle [rad], load [N] and a value, shape (n,)."""

    slip: Array
    angle: Array
    load: Array
    value: Array


class WheelTest(NamedTuple):
    """Result of a wheel file.

    Attributes
    ----------
    title : str
        Title in the file; by default the name of the file.
    soil : Soil
        The soil.
    size : WheelSize
        Radius and width of the wheel.
    load : float
        Vertical load. [N]
    curves : WheelCurves
        Computed curves.
    measured : dict of str and Measured
        Measured points, by quantity.
    errors : dict of str and tuple of 2 floats
        Root mean square, and mean, of computed minus measured values, by quantity.
    files : list of Path
        The wheel file, and the file of measured points if there is one.
    """

    title: str
    soil: Soil
    size: WheelSize
    load: float
    curves: WheelCurves
    measured: dict[str, Measured]
    errors: dict[str, tuple[float, float]]
    files: list[Path]


def run_wheel_file(path: Path, settings: Sequence[str] = ()) -> WheelTest:
    """Return the curves of a wheel file, and their difference from its measured points.

    ProblemError is raised if the file cannot be read, or values do not fit its schema; DataError if
    the file of measured points cannot be read; ModelError if the wheel sinks to its axle, or the
    soil is not valid.

    Parameters
    ----------
    path : Path
        The file.
    settings : sequence of str
        Values that replace those of the file, as ``key=value``.
    """
    spec: Any = _read(path, settings)
    soil = soil_of(**given_values(spec.soil))
    size = WheelSize(spec.wheel.radius, spec.wheel.width)
    low, high = spec.test.slip
    slips = np.linspace(low, high, spec.test.points)
    curves = single_wheel(soil, size, spec.wheel.load, slips, spec.test.slip_angles)
    measured, files = {}, [path]
    if spec.test.measured is not None:
        files.append(path.parent / spec.test.measured)
        measured = _read_measured(files[-1], spec.wheel.load)
    errors = {name: _error(soil, size, name, points) for name, points in measured.items()}
    title = spec.title or path.stem
    return WheelTest(title, soil, size, spec.wheel.load, curves, measured, errors, files)


def _read(path: Path, settings: Sequence[str]) -> Any:
    """Return the validated values of a wheel file."""
    text = read_text(path, "a wheel file")
    data = parse_toml(path, text)
    places = replace_values(data, settings)
    source = Source(path, text, key_lines(text), places)
    schema = wheel_file()
    try:
        spec: Any = schema.model_validate(data)
    except ValidationError as error:
        errors = error.errors(include_url=False)
        faults = [validation_fault(schema, data, dict(each)) for each in errors]
        raise problem_error(source, faults) from error
    faults = [*value_errors(data), *_faults(spec)]
    if faults:
        raise problem_error(source, faults)
    return spec


def _faults(spec: Any) -> Iterator[Fault]:
    """Yield an error for each value that contradicts another one."""
    low, high = spec.test.slip
    if low >= high:
        expected = "two slip ratios in ascending order"
        yield Fault(("test", "slip"), expected, f"[{low:g}, {high:g}]; exchange them")
    count = spec.test.points * len(spec.test.slip_angles)
    if count > MAX_POINTS:
        expected = f"at most {MAX_POINTS} slip ratios times slip angles"
        yield Fault(("test", "points"), expected, f"{count}; reduce the number of points")


def _read_measured(path: Path, load: float) -> dict[str, Measured]:
    """Return the measured points in a CSV file, by quantity; ``load`` is that of the wheel file."""
    names = read_names(path, "measured points")
    found = [name for name in QUANTITIES if name in names]
    if not ("slip" in names and found):
        raise DataError(
            f"{path}: expected a first line with 'slip' and one of {', '.join(QUANTITIES)}, found "
            f"{', '.join(names)}; add the names of the columns"
        )
    given = ["slip", *(name for name in ("slip_angle", "load") if name in names)]
    columns = read_columns(path, [*given, *found], "measured points").values
    slip = columns["slip"]
    angle = columns.get("slip_angle", np.zeros_like(slip))
    loads = columns.get("load", np.full_like(slip, load))
    return {name: Measured(slip, angle, loads, columns[name]) for name in found}


def _error(soil: Soil, size: WheelSize, name: str, points: Measured) -> tuple[float, float]:
    """Return root mean square and mean of computed minus measured values."""
    found = steady_forces(soil, size, points.load, points.slip, points.angle)
    misses = getattr(found, name) - points.value
    return float(np.sqrt(np.mean(misses**2))), float(np.mean(misses))


def wheel_facts(test: WheelTest) -> Lines:
    """Return the facts about a wheel test: wheel, soil, curves, and difference from measurement."""
    curves, soil = test.curves, test.soil
    facts = [
        (
            "wheel",
            f"radius {test.size.radius:g} m, width {test.size.width:g} m, load {test.load:g} N",
        ),
        (
            "soil",
            f"cohesion {soil.cohesion:g} Pa, friction angle {np.rad2deg(soil.friction_angle):.4g} "
            f"deg, sinkage exponent {soil.exponent:g}",
        ),
    ]
    for k, angle in enumerate(curves.angle):
        best = curves.pull[k].argmax()
        depth = 1e3 * curves.sinkage[k]
        facts.append(
            (
                f"slip angle {np.rad2deg(angle):g} deg",
                f"drawbar pull {curves.pull[k].min():.4g} to {curves.pull[k].max():.4g} N (largest "
                f"at slip {curves.slip[best]:.3g}), side force {curves.side[k].min():.4g} to "
                f"{curves.side[k].max():.4g} N, torque {curves.torque[k].min():.4g} to "
                f"{curves.torque[k].max():.4g} N m, sinkage {depth.min():.4g} to "
                f"{depth.max():.4g} mm",
            )
        )
    for name, (rms, mean) in test.errors.items():
        unit = COLUMNS[name]
        count = test.measured[name].slip.size
        words = (
            f"{count} points, computed minus measured rms {rms:.3g} {unit}, mean {mean:.3g} {unit}"
        )
        facts.append((f"measured {name}", words))
    return facts


def wheel_rows(curves: WheelCurves) -> tuple[list[str], list[list[float]]]:
    """Return column names and rows of the curves, in SI units; angles in radians."""
    rows = [
        [float(angle), float(slip), *(float(getattr(curves, name)[k, i]) for name in QUANTITIES)]
        for k, angle in enumerate(curves.angle)
        for i, slip in enumerate(curves.slip)
    ]
    return ["slip_angle", "slip", *QUANTITIES], rows
