"""What a problem file may hold: types, ranges and units, as frozen records."""

from __future__ import annotations

from itertools import pairwise
from math import inf, pi
from typing import Annotated, Any, Literal, cast

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    PlainValidator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from slipfree.climb.control import Directions
from slipfree.climb.reference import Law
from slipfree.problem.catalog import CATALOG, OWN, read_table

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


class ElevationError(Record):
    """A random error of the heights of a map."""

    rms: Length
    correlation: Length
    seed: Count


class Terrain(Record):
    """The ground: a file, the sample that matplotlib ships, or a made one; and its friction."""

    file: str | None = None
    sample: Literal["jacksboro"] | None = None
    synthetic: Synthetic | None = None
    cell: Length | None = None
    registration: Literal["area", "point"] | None = None
    spacing: Length | None = None
    geographic: Literal["local"] | None = None
    fill: Literal["linear"] | None = None
    scale: Length = 1.0
    horizontal_scale: Length = 1.0
    vertical_scale: Length = 1.0
    window: Window | None = None
    smooth: Length | None = None
    error: ElevationError | None = None
    rolled: Length | None = None
    friction: Annotated[float | str | None, PlainValidator(_friction)] = None


class Vehicle(Record):
    """A vehicle: of the catalogue, with the keywords of its function, or from a file."""

    catalog: Literal[tuple(CATALOG)] | None = None  # type: ignore[valid-type]
    file: Annotated[str, Field(min_length=1)] | None = None
    actuated: Annotated[tuple[str, ...], Field(strict=False)] = ()

    @model_validator(mode="wrap")
    @classmethod
    def _by_source(cls, data: Any, handler: ModelWrapValidatorHandler[Vehicle]) -> Vehicle:
        """Read the table of a vehicle of the catalogue by the keywords of its function."""
        return cast("Vehicle", read_table(cls, data, handler))

    @property
    def keywords(self) -> dict[str, Any]:
        """What is given to the function of the catalogue."""
        return self.model_dump(exclude_none=True, exclude=set(OWN))


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


class Asked(Record):
    """What every problem has: what is asked for, and for what time."""

    verb: str
    title: str | None = None
    time: Time
    solver: Solver = Solver()


class Task(Asked):
    """What every problem has that happens on terrain: a ground, and a start on it."""

    terrain: Terrain
    start: dict[str, float]


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


def _course(value: Any) -> float | Piecewise | str:
    """Return a rate as `_rate` does, or a formula of the time."""
    if isinstance(value, str) and value:
        return value
    if not _is_number(value) and not isinstance(value, list):
        expected = "a number, an array of [time, value] pairs, or a formula of t in quotes"
        raise PydanticCustomError("expected", expected)
    return _rate(value)


Course = Annotated[Any, PlainValidator(_course)]


class Inverse(Motion):
    """Inverse kinematics: given rates of the platform, or its path; wheel rates are asked for."""

    verb: Literal["inverse"]
    given: dict[str, Course] | None = None
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


class Incline(Record):
    """A ramp up to a plateau, from x = 0 on."""

    angle: Annotated[float, Field(gt=0, le=pi / 2)]
    height: Length


class Step(Record):
    """A plateau, from x = 0 on."""

    height: Length


class Kerb(Record):
    """A block, from x = 0 on."""

    height: Length
    length: Length


class Stairs(Record):
    """Stairs, from x = 0 on, the last step a plateau."""

    height: Length
    depth: Length
    count: Annotated[int, Field(ge=1)]


class Solid(Record):
    """A convex polygon of the ground."""

    points: Annotated[tuple[Pair, ...], Field(strict=False)]


class Profile(Record):
    """The ground of a climb: a floor with one obstacle, or solids, here or in a file."""

    ramp: Incline | None = None
    step: Step | None = None
    kerb: Kerb | None = None
    stairs: Stairs | None = None
    solids: Annotated[tuple[Solid, ...], Field(strict=False)] | None = None
    file: str | None = None


class ClimberBody(Record):
    """A body of a vehicle that climbs; the defaults are the catalogue's."""

    mass: Length | None = None
    ahead: float | None = None
    above: float | None = None
    inertia: Length | None = None


class ClimberAxle(Record):
    """Wheels of a vehicle that climbs; the defaults are the catalogue's."""

    ahead: float | None = None
    wheels: Annotated[int, Field(ge=1)] | None = None
    inertia: Length | None = None


class Climber(Record):
    """A vehicle that climbs, of the catalogue, and its dimensions."""

    catalog: Literal["seven_wheels"]
    joint: float = 0.0
    torque: Length = inf
    radius: Length | None = None
    rear_body: ClimberBody = ClimberBody()
    front_body: ClimberBody = ClimberBody()
    rear: ClimberAxle = ClimberAxle()
    middle: ClimberAxle = ClimberAxle()
    front: ClimberAxle = ClimberAxle()


class Friction(Record):
    """Coefficients of friction of a climb: at rest, and at speed."""

    static: Length
    kinetic: Length


class Compliance(Record):
    """How contacts give way; the defaults are those of `slipfree.climb.contact.Contact`."""

    stiffness: Length | None = None
    damping: Radius | None = None
    creep: Length | None = None
    stribeck: Length | None = None


class Noise(Record):
    """Noise of a climb's sensors; the defaults are those of `slipfree.climb.noise.Noise`."""

    tilt: Radius | None = None
    tilt_rate: Radius | None = None
    wheel_rate: Radius | None = None
    band: Length | None = None
    seed: Count | None = None


class Control(Record):
    """How wheels are driven; the defaults are those of `slipfree.climb.control.Control`."""

    speed: Length
    law: Law | None = None
    directions: Directions | None = None
    smoothing: Length | None = None
    share: Radius | None = None
    cap: Annotated[float, Field(ge=1)] | None = None
    proportional: Length | None = None
    integral: Length | None = None
    derivative: Radius | None = None
    lag: Length | None = None
    unwinding: Radius | None = None
    period: Length | None = None
    noise: Noise | None = None


class Approach(Record):
    """Where a climb begins: how far the front wheels are from the obstacle, and how fast."""

    distance: float
    speed: Radius | None = None


class Stiff(Solver):
    """What is asked of the integrator of a stiff motion."""

    tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-6
    method: Literal["cvodes", "idas"] | None = None


class Legs(Record):
    """What a climb is planned for, leg by leg."""

    cost: Literal["time", "friction", "slip"] = "time"
    nodes: Annotated[int, Field(ge=20)] = 60
    friction: Length | None = None
    speed: Length | None = None


class Climb(Asked):
    """A vehicle of two bodies climbs an obstacle: the motion under control of its wheels."""

    verb: Literal["climb"]
    solver: Stiff = Stiff()
    profile: Profile
    vehicle: Climber
    friction: Friction
    contact: Compliance = Compliance()
    control: Control
    start: Approach
    plan: Legs | None = None
    output: Output | None = None


GROUNDS = ("file", "sample", "synthetic")
ALTERNATIVES: dict[type[Asked], dict[tuple[str, ...], tuple[str, ...]]] = {
    Direct: {(): ("inputs", "driver"), ("terrain",): GROUNDS},
    Plan: {(): ("inputs", "driver"), ("terrain",): GROUNDS},
    Inverse: {(): ("given", "path"), ("terrain",): GROUNDS, ("path",): ("t", "file")},
    Compare: {("terrain",): GROUNDS},
    Climb: {("profile",): ("ramp", "step", "kerb", "stairs", "solids", "file")},
}  # of each of these keys a table has exactly one
