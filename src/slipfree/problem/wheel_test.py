"""Wheel files of ``slipfree wheel``: a wheel, its load, a soil, slip ratios and slip angles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from slipfree.core.errors import DataError
from slipfree.core.records import Array
from slipfree.files.tables import read_columns, read_names
from slipfree.files.toml.source import Fault, read_text
from slipfree.files.toml.types import Angle, Positive, Record, given_values
from slipfree.laws.soil import Soil, WheelSize
from slipfree.models.single_wheel import WheelCurves, single_wheel, steady_forces
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem, validated_problem
from slipfree.problem.schema import GRAVITY, FileKeys, Gravity, NamedSoil, soil_of
from slipfree.problem.verbs.base import Lines
from slipfree.vehicle.gravity import gravity_of, gravity_words

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


class WheelFile(FileKeys):
    """Wheel file; the table ``[soil]`` has the constants of `Soil`."""

    title: str | None = Field(default=None, description="title of the summary")
    gravity: Gravity = Field(default="earth", description=GRAVITY)
    wheel: TestedWheelTable = Field(description="the wheel")
    soil: NamedSoil = Field(default=NamedSoil(), description="the soil")
    test: TestTable = Field(default=TestTable(), description="the test")

    def faults(self) -> Iterator[Fault]:
        """Yield an error for each value that contradicts another one."""
        low, high = self.test.slip
        if low >= high:
            expected = "two slip ratios in ascending order"
            yield Fault(("test", "slip"), expected, f"[{low:g}, {high:g}]; exchange them")
        count = self.test.points * len(self.test.slip_angles)
        if count > MAX_POINTS:
            expected = f"at most {MAX_POINTS} slip ratios times slip angles"
            yield Fault(("test", "points"), expected, f"{count}; reduce the number of points")


class Measured(NamedTuple):
    """Measured points: slip ratio [1], slip angle [rad], load [N] and a value, shape (n,)."""

    slip: Array
    angle: Array
    load: Array
    value: Array


class WheelTest(NamedTuple):
    """Result of a wheel file."""

    title: str  # by default the name of the file
    soil: Soil
    size: WheelSize
    load: float  # vertical [N]
    gravity: float  # [m/s^2]
    curves: WheelCurves
    measured: dict[str, Measured]  # by quantity
    errors: dict[str, tuple[float, float]]  # computed minus measured: root mean square, mean
    files: list[Path]  # those read


def run_wheel_file(path: Path, settings: Sequence[str] = ()) -> WheelTest:
    """Return the curves of a wheel file, and their difference from its measured points.

    ProblemError is raised if the file cannot be read, or values do not fit its schema; DataError if
    the file of measured points cannot be read; ModelError if the wheel sinks to its axle, or the
    soil is not valid.
    """
    text = read_text(path, "a wheel file")
    problem: Problem[Any] = validated_problem(lambda *_: WheelFile, path, text, settings)
    spec: WheelFile = problem.spec
    with at(problem, ("gravity",)):
        gravity = gravity_of(spec.gravity)
    soil = soil_of(**given_values(spec.soil))
    size = WheelSize(spec.wheel.radius, spec.wheel.width)
    low, high = spec.test.slip
    slips = np.linspace(low, high, spec.test.points)
    angles = spec.test.slip_angles
    curves = single_wheel(soil, size, spec.wheel.load, slips, angles, gravity=gravity)
    measured, files = {}, [path]
    if spec.test.measured is not None:
        files.append(path.parent / spec.test.measured)
        measured = _read_measured(files[-1], spec.wheel.load)
    errors = {name: _error(soil, size, name, points, gravity) for name, points in measured.items()}
    title = spec.title or path.stem
    load = spec.wheel.load
    return WheelTest(title, soil, size, load, gravity, curves, measured, errors, files)


def _read_measured(path: Path, load: float) -> dict[str, Measured]:
    """Return the measured points in a CSV file, by quantity; ``load`` is that of the wheel file."""
    names = read_names(path, "measured points")
    quantities = [name for name in QUANTITIES if name in names]
    if not ("slip" in names and quantities):
        raise DataError(
            f"{path}: expected a first line with 'slip' and one of {', '.join(QUANTITIES)}, found "
            f"{', '.join(names)}; add the names of the columns"
        )
    points = ["slip", *(name for name in ("slip_angle", "load") if name in names)]
    columns = read_columns(path, [*points, *quantities], "measured points").values
    slip = columns["slip"]
    angle = columns.get("slip_angle", np.zeros_like(slip))
    loads = columns.get("load", np.full_like(slip, load))
    return {name: Measured(slip, angle, loads, columns[name]) for name in quantities}


def _error(
    soil: Soil, size: WheelSize, name: str, points: Measured, gravity: float
) -> tuple[float, float]:
    """Return root mean square and mean of computed minus measured values."""
    forces = steady_forces(soil, size, points.load, points.slip, points.angle, gravity)
    misses = getattr(forces, name) - points.value
    return float(np.sqrt(np.mean(misses**2))), float(np.mean(misses))


def wheel_facts(test: WheelTest) -> Lines:
    """Return the facts about a wheel test: wheel, soil, curves, and difference from measurement."""
    curves, soil = test.curves, test.soil
    size = f"radius {test.size.radius:g} m, width {test.size.width:g} m, load {test.load:g} N"
    facts = [
        ("wheel", size),
        ("gravity", gravity_words(test.gravity)),
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
        unit, count = COLUMNS[name], test.measured[name].slip.size
        error = f"computed minus measured rms {rms:.3g} {unit}, mean {mean:.3g} {unit}"
        facts.append((f"measured {name}", f"{count} points, {error}"))
    return facts


def wheel_rows(curves: WheelCurves) -> tuple[list[str], list[list[float]]]:
    """Return column names and rows of the curves, in SI units; angles in radians."""
    rows = [
        [float(angle), float(slip), *(float(getattr(curves, name)[k, i]) for name in QUANTITIES)]
        for k, angle in enumerate(curves.angle)
        for i, slip in enumerate(curves.slip)
    ]
    return ["slip_angle", "slip", *QUANTITIES], rows
