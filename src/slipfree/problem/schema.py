"""What a problem file may hold, by its verb: types, ranges, units and meanings, as frozen records.

Tables of the ground are in `slipfree.problem.schema_ground`, those of a climb in
`slipfree.problem.verbs.climb_schema`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, cast

from pydantic import AfterValidator, Field, ModelWrapValidatorHandler, model_validator

from slipfree.files.toml.angles import Quantity
from slipfree.files.toml.types import (
    Angles,
    Column,
    Pair,
    PiecewiseConstant,
    Range,
    TimeFunction,
    not_zero,
)
from slipfree.files.toml.types import NonNegative as NonNegative
from slipfree.files.toml.types import Piecewise as Piecewise
from slipfree.files.toml.types import Place as Place
from slipfree.files.toml.types import Positive as Positive
from slipfree.files.toml.types import Record as Record
from slipfree.frames import Frame
from slipfree.problem.catalog_table import CATALOG, OWN, read_table
from slipfree.problem.schema_ground import Synthetic as Synthetic
from slipfree.problem.schema_ground import Terrain as Terrain
from slipfree.problem.schema_law import Law as Law
from slipfree.problem.schema_law import known_slip
from slipfree.problem.verbs.climb_schema import Approach, Compliance, Control, Friction
from slipfree.problem.verbs.climb_schema import Climber as Climber
from slipfree.problem.verbs.climb_schema import Legs as Legs
from slipfree.problem.verbs.climb_schema import Profile as Profile
from slipfree.solve.options import MIN_TOLERANCE, Method, SolverOptions

SlipName = Annotated[str, AfterValidator(known_slip)]

VERB = "what is asked for"
TOLERANCE = "of the integrator, absolute and relative [1]"
SIZED = "of the integrator, absolute and relative; that of lengths in sizes of the vehicle [1]"
COMPILED = "whether to compile the equations, seconds once a vehicle; they are kept"
MODEL = "kinematics: the slip law determines the rates; quasi-static: the wheel-ground law does"
SLIP = "slip law, for model = 'kinematics': least slip, or rolling without slip"
LAW = "parameters of the slip law or of the wheel-ground law, in a table of its name"
INPUTS = "rates by name: of driven wheels, and of joints that are commanded [rad/s, m/s]"


class Vehicle(Record):
    """A vehicle: of the catalogue, with the keywords of its function, or from a file."""

    catalog: Literal[tuple(CATALOG)] | None = Field(  # type: ignore[valid-type]
        default=None, description="name in the catalogue"
    )
    file: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="a vehicle file or a URDF"
    )
    actuated: Annotated[tuple[str, ...], Field(strict=False)] = Field(
        default=(), description="passive joints that an actuator moves, or holds"
    )

    @model_validator(mode="wrap")
    @classmethod
    def _by_source(cls, data: Any, handler: ModelWrapValidatorHandler[Vehicle]) -> Vehicle:
        """Read the table of a vehicle of the catalogue by the keywords of its function."""
        return cast("Vehicle", read_table(cls, data, handler))

    @property
    def keywords(self) -> dict[str, Any]:
        """What is given to the function of the catalogue."""
        return self.model_dump(exclude_none=True, exclude=set(OWN))


class Driver(Record):
    """A driving law: straight on from the start, or along a path of way-points."""

    name: Literal["straight", "follow"] = Field(description="of the law")
    speed: Annotated[float, AfterValidator(not_zero)] = Field(
        description="forward; negative to reverse [m/s]"
    )
    path: Annotated[tuple[Pair, ...], Field(strict=False)] | None = Field(
        default=None, description="way-points to follow [m]"
    )
    file: str | None = Field(
        default=None, description="a file with the way-points to follow, x and y"
    )


class Time(Record):
    """How long, and how often the motion is sampled."""

    duration: Positive = Field(description="of the motion [s]")
    step: Positive = Field(description="between samples of the result [s]")


class Solver(Record):
    """What is asked of the integrator."""

    tolerance: Annotated[float, Field(ge=MIN_TOLERANCE, lt=1)] = Field(
        default=1e-8, description=SIZED
    )
    compiled: bool = Field(default=False, description=COMPILED)

    @property
    def options(self) -> SolverOptions:
        """Options of the solvers."""
        return SolverOptions(**dict(self))


class Output(Record):
    """Where the result goes."""

    file: Annotated[str, Field(min_length=1)] = Field(
        description="the result file (.nc), in the working folder or the problem's folder"
    )


class Asked(Record):
    """What every problem has: what is asked for, and for what time."""

    verb: str = Field(description=VERB)
    title: str | None = Field(default=None, description="of the result and its figures")
    time: Time = Field(description="how long, and how often sampled")
    solver: Solver = Field(default=Solver(), description="what is asked of the integrator")


class Task(Asked):
    """What every problem has that happens on terrain: a ground, and a start on it."""

    terrain: Terrain = Field(description="the ground")
    start: dict[str, Quantity] = Field(
        description="x, y, heading (counter-clockwise, from the axis that frame names) and joints; "
        "zero by default [m, rad]"
    )


class Motion(Task):
    """What every problem has that asks for the motion of one vehicle."""

    frame: Frame = Field(
        default="paper",
        description="from which axis headings count, also in summaries, exports and figures: y, or "
        "x (REP 103)",
    )
    vehicle: Vehicle = Field(description="what moves")
    output: Output | None = Field(default=None, description="where the result goes")


class Modelled(Motion):
    """Keys of the problems whose model is chosen."""

    model: Literal["kinematics", "quasi-static"] = Field(default="kinematics", description=MODEL)
    slip: SlipName = Field(default="least", description=SLIP)
    law: Law = Field(default=Law.model_construct(), description=LAW)


class Direct(Modelled):
    """Direct kinematics: given rates, or a driving law; the motion is asked for."""

    verb: Literal["direct"] = Field(description=VERB)
    inputs: dict[str, PiecewiseConstant] | None = Field(default=None, description=INPUTS)
    driver: Driver | None = Field(default=None, description="a driving law")
    formulation: Literal["closure", "montana"] = Field(
        default="closure", description="of contact: by positions, or by Montana's rates"
    )


class Path(Record):
    """A path in time: place and heading of the platform's centre, here or in a file."""

    t: Column | None = Field(default=None, description="times, ascending from 0 [s]")
    x: Column | None = Field(default=None, description="at these times [m]")
    y: Column | None = Field(default=None, description="at these times [m]")
    heading: Angles | None = Field(default=None, description="at these times [rad]")
    file: str | None = Field(default=None, description="a file with these four columns")


class Inverse(Motion):
    """Inverse kinematics: given rates of the platform, or its path; wheel rates are asked for."""

    verb: Literal["inverse"] = Field(description=VERB)
    given: dict[str, TimeFunction] | None = Field(
        default=None,
        description="rates of the platform by name, or the name of a CSV file of them in "
        "time [m/s, rad/s]",
    )
    exact: bool | None = Field(
        default=None,
        description="whether rates in the heading frame are met exactly or refused; else their "
        "errors are the least; by default unless all three are given",
    )
    path: Path | None = Field(default=None, description="a path in time instead")
    steering: Literal["rate", "angle"] = Field(default="angle", description="what of it is unknown")


class Guide(Driver):
    """What starts the search: a driving law, along paths or along routes over the ground."""

    name: Literal["straight", "follow", "route"] = Field(  # type: ignore[assignment]
        description="of the law; a route is sought over the map"
    )
    turning_radius: NonNegative = Field(default=1.0, description="of a route, at least [m]")
    paths: Annotated[
        tuple[Annotated[tuple[Pair, ...], Field(strict=False)], ...] | None,
        Field(strict=False, min_length=1),
    ] = Field(default=None, description="several paths of way-points: the cheapest plan counts [m]")
    count: Annotated[int, Field(ge=1)] = Field(
        default=1, description="of routes: of the plans they lead to the cheapest counts"
    )


class KeepOut(Record):
    """A place that the vehicle must not touch: a disc, or a polygon."""

    x: float | None = Field(default=None, description="of a disc's middle [m]")
    y: float | None = Field(default=None, description="of a disc's middle [m]")
    radius: Positive | None = Field(default=None, description="of a disc [m]")
    points: Annotated[tuple[Pair, ...], Field(strict=False)] | None = Field(
        default=None, description="corners of a polygon [m]"
    )


class Search(Record):
    """How a plan is sought."""

    intervals: Annotated[int, Field(ge=1)] = Field(
        default=40, description="of the mesh, to begin with"
    )
    degree: Annotated[int, Field(ge=1, le=5)] = Field(
        default=3, description="of the polynomials on an interval"
    )
    duration: Range = Field(
        default=None, description="of the plan; default: that of the motion it starts from [s]"
    )
    smooth: NonNegative = Field(
        default=0.0, description="weight of the squared rates of the inputs [1]"
    )
    continuous: bool = Field(
        default=True, description="inputs are linear on an interval without jumps; else constant"
    )
    accuracy: Positive = Field(
        default=1e-3,
        description="by which the simulation may miss the plan and its limits [m, rad]",
    )


class Plan(Modelled):
    """A plan: the inputs that reach a goal at the least cost; a driving law starts the search."""

    verb: Literal["plan"] = Field(description=VERB)
    goal: dict[str, Range] = Field(description="at the end, any state or unknown by name [m, rad]")
    costs: dict[str, NonNegative] = Field(
        description="weights of integrals over time: slip, effort, time, energy, or any quantity "
        "squared [1]"
    )
    limits: dict[str, Range] = Field(
        default={}, description="along the way, any quantity of the result, in its unit [m, rad, 1]"
    )
    bounds: dict[str, Range] = Field(default={}, description="of the inputs [rad/s, m/s]")
    accelerations: dict[str, Range] = Field(
        default={}, description="bounds of the inputs' rates [rad/s2, m/s2]"
    )
    plan: Search = Field(default=Search(), description="how it is sought")
    keep_out: Annotated[tuple[KeepOut, ...], Field(strict=False)] = Field(
        default=(), description="places that no wheel may touch"
    )
    way_points: Annotated[tuple[dict[str, Range], ...], Field(strict=False)] = Field(
        default=(), description="like the goal, each at a part of the duration [m, rad]"
    )
    inputs: dict[str, PiecewiseConstant] | None = Field(
        default=None, description=f"of the motion that starts the search: {INPUTS}"
    )
    driver: Guide | None = Field(default=None, description="what starts the search instead")


class Compared(Vehicle):
    """One of several vehicles, and what to call it."""

    name: Annotated[str, Field(min_length=1)] = Field(description="of the vehicle")


class Compare(Task):
    """Several vehicles on one ground: at the same rates, and at those of a driving law."""

    verb: Literal["compare"] = Field(description=VERB)
    vehicles: Annotated[tuple[Compared, ...], Field(strict=False, min_length=1)] = Field(
        description="what is compared"
    )
    inputs: dict[str, Quantity] = Field(description=INPUTS)
    driver: Driver = Field(description="the driving law")


class Stiff(Solver):
    """What is asked of the integrator of a stiff motion."""

    tolerance: Annotated[float, Field(ge=MIN_TOLERANCE, lt=1)] = Field(
        default=1e-6, description=TOLERANCE
    )
    method: Method | None = Field(default=None, description="which integrator")


class Climb(Asked):
    """A vehicle of two bodies climbs an obstacle: the motion under control of its wheels."""

    verb: Literal["climb"] = Field(description=VERB)
    solver: Stiff = Field(default=Stiff(), description="what is asked of the integrator")
    profile: Profile = Field(description="the ground, in the plane")
    vehicle: Climber = Field(description="what climbs")
    friction: Friction = Field(description="between wheels and ground")
    contact: Compliance = Field(default=Compliance(), description="how contacts give way")
    control: Control = Field(description="how wheels are driven")
    start: Approach = Field(description="where it begins")
    plan: Legs | None = Field(
        default=None, description="what it is planned for; without it it is not"
    )
    output: Output | None = Field(default=None, description="where the result goes")


GROUNDS = ("file", "sample", "synthetic")
ALTERNATIVES: dict[type[Asked], dict[tuple[str, ...], tuple[str, ...]]] = {
    Direct: {(): ("inputs", "driver"), ("terrain",): GROUNDS},
    Plan: {(): ("inputs", "driver"), ("terrain",): GROUNDS},
    Inverse: {(): ("given", "path"), ("terrain",): GROUNDS, ("path",): ("t", "file")},
    Compare: {("terrain",): GROUNDS},
    Climb: {("profile",): ("ramp", "step", "kerb", "stairs", "solids", "file")},
}  # of each of these keys a table has exactly one
