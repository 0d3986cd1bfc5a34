"""Tables that problem files of several verbs share: types, ranges, units and meanings.

Tables of the ground are in `slipfree.problem.schema_ground`, those of one verb in
`slipfree.problem.verbs`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal, cast

from pydantic import AfterValidator, Field, ModelWrapValidatorHandler, model_validator

from slipfree.files.toml.angles import Quantity
from slipfree.files.toml.errors import Fault
from slipfree.files.toml.source_lines import Place as KeyPath
from slipfree.files.toml.types import Pair, not_zero
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
from slipfree.solve.options import MIN_TOLERANCE, SolverOptions

SlipName = Annotated[str, AfterValidator(known_slip)]

MOST_SAMPLES = 1_000_000  # largest number of samples of a motion
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

    alternatives: ClassVar[Mapping[KeyPath, tuple[str, ...]]] = {}
    """Tables with several keys each of which exactly one is required."""

    @property
    def named_files(self) -> tuple[str, ...]:
        """Names of input files besides those that the keys 'file' and 'friction' of tables name."""
        return ()

    def faults(self) -> Iterator[Fault]:
        """Yield the errors of values that do not fit each other."""
        time = self.time
        if time.step > time.duration:
            expected = f"at most the duration, {time.duration:g} s"
            yield Fault(("time", "step"), expected, f"{time.step:g}")
        elif time.duration / time.step > MOST_SAMPLES:
            expected = f"a step with at most {MOST_SAMPLES} samples in {time.duration:g} s"
            yield Fault(("time", "step"), expected, f"{time.step:g}")


class Runnable(Asked):
    """Keys of the problems that ``slipfree run`` solves."""

    output: Output | None = Field(default=None, description="where the result goes")


class Task(Asked):
    """What every problem has that happens on terrain: a ground, and a start on it."""

    terrain: Terrain = Field(description="the ground")
    start: dict[str, Quantity] = Field(
        description="x, y, heading (counter-clockwise, from the axis that frame names) and joints; "
        "zero by default [m, rad]"
    )

    alternatives: ClassVar[Mapping[KeyPath, tuple[str, ...]]] = {
        ("terrain",): ("file", "sample", "synthetic")
    }


class Motion(Task, Runnable):
    """What every problem has that asks for the motion of one vehicle."""

    frame: Frame = Field(
        default="paper",
        description="from which axis headings count, also in summaries, exports and figures: y, or "
        "x (REP 103)",
    )
    vehicle: Vehicle = Field(description="what moves")


class Modelled(Motion):
    """Keys of the problems whose model is chosen."""

    model: Literal["kinematics", "quasi-static"] = Field(default="kinematics", description=MODEL)
    slip: SlipName = Field(default="least", description=SLIP)
    law: Law = Field(default=Law.model_construct(), description=LAW)
