"""What a problem file may hold: types, ranges and units, as frozen records."""

from __future__ import annotations

from itertools import pairwise
from math import inf
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PlainValidator
from pydantic_core import PydanticCustomError

from slipfree.vehicle.catalog import Axle

Piecewise = tuple[tuple[float, float], ...]
Length = Annotated[float, Field(gt=0)]
Radius = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=0)]
# Arrays are read as tuples; what is in them stays strict.
Pair = Annotated[tuple[float, float], Field(strict=False)]
Place = Annotated[tuple[float, float, float], Field(strict=False)]
Column = Annotated[tuple[float, ...], Field(strict=False)]
Window = Annotated[tuple[float, float, float, float], Field(strict=False)]
Rock = Annotated[tuple[float, float, float, float], Field(strict=False)]


class Record(BaseModel):
    """A table of a problem file: nothing converted, nothing unknown, nothing changed later."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < inf


def _rate(value: Any) -> float | Piecewise:
    """Return a constant, or times and values of a piecewise constant."""
    if _is_number(value):
        return float(value)
    pairs = value if isinstance(value, list) else []
    if not pairs or not all(
        isinstance(pair, list) and len(pair) == 2 and all(map(_is_number, pair)) for pair in pairs
    ):
        raise PydanticCustomError("expected", "a number, or an array of [time, value] pairs")
    times = [pair[0] for pair in pairs]
    if times[0] != 0 or any(b <= a for a, b in pairwise(times)):
        raise PydanticCustomError("expected", "[time, value] pairs whose times ascend from 0")
    return tuple((float(t), float(rate)) for t, rate in pairs)


Rate = Annotated[Any, PlainValidator(_rate)]


class PowerLaw(Record):
    """Roughness that falls with the wave number by a power, added to the ground."""

    rms: Length
    hurst: Annotated[float, Field(gt=0, le=1)]
    longest: Length
    shortest: Length
    seed: Count


class Craters(Record):
    """Craters scattered over the ground."""

    count: Count
    diameters: Pair
    seed: Count


class Rocks(Record):
    """Rocks scattered over the ground."""

    count: Count
    diameters: Pair
    height_ratio: Length
    seed: Count


class Ramp(Record):
    """A ramp along y."""

    start: float
    end: float
    rise: float
    smooth: bool = True
    rounding: Radius = 0.0


class Synthetic(Record):
    """A made ground: a level grid, and what is added to it in the order of these keys."""

    x: Pair
    y: Pair
    spacing: Length
    base: float = 0.0
    ramp: Ramp | None = None
    power_law: PowerLaw | None = None
    craters: Craters | None = None
    rocks: Rocks | None = None
    placed_rocks: Annotated[tuple[Rock, ...], Field(strict=False)] = ()


def _friction(value: Any) -> float | str:
    """Return a coefficient of friction, or the name of a file that holds a map of it."""
    if isinstance(value, str) and value:
        return value
    if _is_number(value) and value > 0:
        return float(value)
    raise PydanticCustomError("expected", "a number greater than 0, or a file's name in quotes")


class Terrain(Record):
    """The ground: a file, the sample that matplotlib ships, or a made one; and its friction."""

    file: str | None = None
    sample: Literal["jacksboro"] | None = None
    synthetic: Synthetic | None = None
    scale: Length = 1.0
    window: Window | None = None
    rolled: Length | None = None
    friction: Annotated[float | str | None, PlainValidator(_friction)] = None


class Vehicle(Record):
    """A vehicle of the catalogue and its dimensions; the defaults are the catalogue's."""

    catalog: Literal["three_wheeler"]
    axle: Axle | None = None
    half_track: Length | None = None
    wheelbase: Length | None = None
    r1: Radius | None = None
    r2: Radius | None = None
    tilt_stop: Length | None = None
    slide_stop: Length | None = None
    stiffness: Radius | None = None
    damping: Radius | None = None
    bump: Radius | None = None
    mass: Radius | None = None
    center_of_mass: Place | None = None
    wheel_mass: Radius | None = None
    grip: Length | None = None
    actuated: Annotated[tuple[str, ...], Field(strict=False)] = ()


def _not_zero(value: float) -> float:
    if value == 0:
        raise PydanticCustomError("expected", "a speed other than zero")
    return value


class Driver(Record):
    """A driving law: straight on from the start, or along a path of way-points."""

    name: Literal["straight", "follow"]
    speed: Annotated[float, AfterValidator(_not_zero)]
    path: Annotated[tuple[Pair, ...], Field(strict=False)] | None = None
    file: str | None = None


class Time(Record):
    """How long, and how often the motion is sampled."""

    duration: Length
    step: Length


class Solver(Record):
    """What is asked of the integrator."""

    tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-8


class Output(Record):
    """Where the result goes."""

    file: Annotated[str, Field(min_length=1)]


class Task(Record):
    """What every problem has: a ground, a start on it, and a time."""

    verb: str
    title: str | None = None
    terrain: Terrain
    start: dict[str, float]
    time: Time
    solver: Solver = Solver()


class Motion(Task):
    """What every problem has that asks for the motion of one vehicle."""

    frame: Literal["paper", "rep103"] = "paper"
    vehicle: Vehicle
    output: Output | None = None


class Traction(Record):
    """The law of friction."""

    creep: Length = 1e-4
    reserve: Radius = 0.0


class Direct(Motion):
    """Direct kinematics: given rates, or a driving law; the motion is asked for."""

    verb: Literal["direct"]
    inputs: dict[str, Rate] | None = None
    driver: Driver | None = None
    formulation: Literal["closure", "montana"] = "closure"
    slip: Literal["least", "rolling", "traction"] = "least"
    traction: Traction | None = None


class Path(Record):
    """A path in time: place and heading of the platform's centre, here or in a file."""

    t: Column | None = None
    x: Column | None = None
    y: Column | None = None
    heading: Column | None = None
    file: str | None = None


class Inverse(Motion):
    """Inverse kinematics: given rates of the platform, or its path; wheel rates are asked for."""

    verb: Literal["inverse"]
    given: dict[str, float] | None = None
    path: Path | None = None
    steering: Literal["rate", "angle"] = "angle"


def _bound(value: Any) -> tuple[float, float]:
    """Return a range from a number or from two that ascend."""
    if _is_number(value):
        return float(value), float(value)
    if isinstance(value, list) and len(value) == 2 and all(map(_is_number, value)):
        low, high = map(float, value)
        if low <= high:
            return low, high
    raise PydanticCustomError("expected", "a number, or [low, high] that ascend")


Bound = Annotated[Any, PlainValidator(_bound)]


class Guide(Driver):
    """What starts the search: a driving law, along paths or along routes over the ground."""

    name: Literal["straight", "follow", "route"]  # type: ignore[assignment]
    turning_radius: Radius = 1.0
    paths: Annotated[tuple[Annotated[tuple[Pair, ...], Field(strict=False)], ...] | None,
                     Field(strict=False, min_length=1)] = None  # fmt: skip
    count: Annotated[int, Field(ge=1)] = 1


class KeepOut(Record):
    """A place that the vehicle must not touch: a disc, or a polygon."""

    x: float | None = None
    y: float | None = None
    radius: Length | None = None
    points: Annotated[tuple[Pair, ...], Field(strict=False)] | None = None


class Search(Record):
    """How a plan is sought."""

    intervals: Annotated[int, Field(ge=1)] = 40
    degree: Annotated[int, Field(ge=1, le=5)] = 3
    duration: Bound = None
    smooth: Radius = 0.0
    continuous: bool = True
    accuracy: Length = 1e-3


class Plan(Motion):
    """A plan: the inputs that reach a goal at the least cost; a driving law starts the search."""

    verb: Literal["plan"]
    goal: dict[str, Bound]
    costs: dict[str, Radius]
    limits: dict[str, Bound] = {}
    bounds: dict[str, Bound] = {}
    accelerations: dict[str, Bound] = {}
    plan: Search = Search()
    keep_out: Annotated[tuple[KeepOut, ...], Field(strict=False)] = ()
    way_points: Annotated[tuple[dict[str, Bound], ...], Field(strict=False)] = ()
    inputs: dict[str, Rate] | None = None
    driver: Guide | None = None
    slip: Literal["least", "rolling", "traction"] = "least"
    traction: Traction | None = None


class Compared(Vehicle):
    """One of several vehicles, and what to call it."""

    name: Annotated[str, Field(min_length=1)]


class Compare(Task):
    """Several vehicles on one ground: at the same rates, and at those of a driving law."""

    verb: Literal["compare"]
    vehicles: Annotated[tuple[Compared, ...], Field(strict=False, min_length=1)]
    inputs: dict[str, float]
    driver: Driver


GROUNDS = ("file", "sample", "synthetic")
ALTERNATIVES: dict[type[Task], dict[tuple[str, ...], tuple[str, ...]]] = {
    Direct: {(): ("inputs", "driver"), ("terrain",): GROUNDS},
    Plan: {(): ("inputs", "driver"), ("terrain",): GROUNDS},
    Inverse: {(): ("given", "path"), ("terrain",): GROUNDS, ("path",): ("t", "file")},
    Compare: {("terrain",): GROUNDS},
}  # of each of these keys a table has exactly one
