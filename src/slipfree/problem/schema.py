"""Tables that problem files of several verbs share: types, ranges, units and meanings.

Tables of laws, soils and catalogue vehicles are made from annotated dataclasses and functions.
Tables of the ground are in `slipfree.problem.schema_ground`, those of one verb in
`slipfree.problem.verbs`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, cast

from pydantic import AfterValidator, Field, ValidationError, create_model
from pydantic_core import InitErrorDetails, PydanticCustomError

from slipfree import catalog
from slipfree.control import reference_speeds, step_climbing
from slipfree.core.trajectory import Frame
from slipfree.files.toml.source import Fault
from slipfree.files.toml.source import Place as KeyPath
from slipfree.files.toml.types import (
    Pair,
    Positive,
    Quantity,
    Record,
    given_values,
    not_zero,
    one_of,
    record_of,
)
from slipfree.files.toml.types import Piecewise as Piecewise
from slipfree.files.toml.types import Place as Place
from slipfree.laws.registry import CONTACT_LAWS, GROUND_LAWS, SLIP_LAWS
from slipfree.laws.soil import Soil
from slipfree.laws.soil_regions import OF_THE_LAW, SoilRegion
from slipfree.laws.soils import SOILS, known_soil
from slipfree.problem.schema_ground import RegionTable, region_of
from slipfree.problem.schema_ground import Synthetic as Synthetic
from slipfree.problem.schema_ground import TerrainTable as TerrainTable
from slipfree.solve.options import MAX_TOLERANCE, MIN_TOLERANCE, SolverOptions
from slipfree.vehicle.tree import Vehicle

CATALOG: dict[str, Callable[..., Vehicle]] = {
    name: getattr(catalog, name) for name in catalog.__all__
}
OWN = ("catalog", "file", "actuated", "name")  # keys that are not keywords of the function
DEFAULT_SOIL = next(iter(SOILS))
OF_REGIONS = (*RegionTable.model_fields, "width")  # keys of a region that are not of its soil
MAX_SAMPLES = 1_000_000  # largest number of samples of a motion
VERB = "kind of the problem"
SIZED = (
    "tolerance of the integrator, absolute and relative; lengths relative to the vehicle size [1]"
)
COMPILED = (
    "whether to compile the equations; a first compilation takes seconds, its result is cached"
)
MODEL = (
    "kinematics: a slip law determines the rates; quasi-static: a wheel-ground law and "
    "equilibrium without inertia; dynamics: a contact law and inertia"
)
SLIP = "slip law, for model = 'kinematics': 'least' (least slip) or 'rolling' (without slip)"
LAW = "parameters of the law of the model, in a table with the name of the law"
FILE = "file"  # key of [inputs] and [given] that names a file
INPUTS = "rates of driven wheels and commanded joints, by name [rad/s, m/s]"
STEP_CLIMBING = "step-climbing"


class SoilKeys(Record):
    """Name of a soil, and constants that replace those of this soil."""

    name: Annotated[str, one_of(SOILS)] = Field(
        default=DEFAULT_SOIL, description=f"soil of the catalogue: one of {', '.join(SOILS)}"
    )


class SoilRegionKeys(SoilKeys, RegionTable):
    """A region with another soil: a disc or a polygon."""

    width: Positive = Field(
        description="width in which the soil around the region becomes its soil [m]"
    )


NamedSoil: Any = record_of(Soil, SoilKeys)


REGION_MEANING = SoilRegionKeys.__doc__ or ""
SoilRegions: Any = Annotated[
    tuple[record_of(Soil, SoilRegionKeys, omitted=OF_THE_LAW, meaning=REGION_MEANING), ...],  # type: ignore[misc]
    Field(strict=False),
]


class SoilTable(NamedSoil):  # type: ignore[misc]
    """Loose soil under rigid wheels, for dynamics and quasi-statics."""

    regions: SoilRegions = Field(
        default=(), description="regions of other soils; later ones cover earlier ones"
    )


def soil_of(
    *, name: str = DEFAULT_SOIL, regions: tuple[RegionTable, ...] = (), **constants: float
) -> Soil:
    """Return the soil of a table.

    ModelError is raised if a constant is not valid, or a region is neither a disc nor a valid
    polygon.

    Parameters
    ----------
    name : str
        Name in the catalogue.
    regions : tuple of RegionTable
        Records of the regions.
    **constants : float
        Constants that replace those of the catalogue.
    """
    return replace(known_soil(name), regions=tuple(map(_region, regions)), **constants)


def _region(table: Any) -> SoilRegion:
    """Return the region of a table with its soil."""
    given = given_values(table)
    soil = soil_of(**{key: value for key, value in given.items() if key not in OF_REGIONS})
    return SoilRegion(region_of(table), soil, table.width)


def registered_laws() -> dict[str, Any]:
    """Return the laws that have parameters, by name."""
    laws: dict[str, Any] = {**SLIP_LAWS, **GROUND_LAWS, **CONTACT_LAWS}
    return {name: law for name, law in laws.items() if fields(law)}


def table_of(law: type) -> type[Record]:
    """Return the record of the table of a law; that of soil also has names and regions."""
    return SoilTable if law is Soil else record_of(law)


class Law(Record):
    """Parameters of a law, in a table of its name."""

    @classmethod
    def schema_for(cls, data: Any) -> type[Record]:
        """Return the record of all registered laws; they may be added after the import."""
        return law_tables() if cls is Law and isinstance(data, dict) else cls

    def parameters(self, name: str) -> dict[str, Any]:
        """Return the parameters that a problem gives for a law, by name."""
        table = getattr(self, name, None)
        return {} if table is None else given_values(table)


def law_tables() -> type[Law]:
    """Return the record of the tables of all registered laws."""
    keys: dict[str, Any] = {
        name: (
            table_of(law) | None,
            Field(default=None, description=f"parameters of {name}"),
        )
        for name, law in registered_laws().items()
    }
    return cast("type[Law]", create_model("Laws", __base__=Law, __doc__=Law.__doc__, **keys))


SlipName = Annotated[str, one_of(SLIP_LAWS)]


class VehicleSource(Record):
    """A vehicle from the catalogue, with the keywords of its function, or from a file."""

    catalog: Literal[tuple(CATALOG)] | None = Field(  # type: ignore[valid-type]
        default=None, description="name in the catalogue"
    )
    file: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="a vehicle file or a URDF"
    )
    actuated: Annotated[tuple[str, ...], Field(strict=False)] = Field(
        default=(), description="passive joints with an actuator, which moves or holds them"
    )

    @classmethod
    def schema_for(cls, data: Any) -> type[Record]:
        """Return the record with the keywords of the catalogue's function, if there is one."""
        if not isinstance(data, dict) or cls._keywords():
            return cls
        if ("catalog" in data) == ("file" in data):
            context = {
                "words": "exactly one of catalog, file",
                "found": "catalog and file" if "file" in data else "none",
            }
            error = InitErrorDetails(
                type=PydanticCustomError("expected", "{words}", context),
                loc=("file",) if "file" in data else (),
                input=data,
            )
            raise ValidationError.from_exception_data(cls.__name__, [error])
        name = data.get("catalog")
        known: type[Record] = record_of(CATALOG[name], cls) if name in tuple(CATALOG) else cls
        return known

    @classmethod
    def known_keys(cls) -> list[str]:
        """Return the keys of a vehicle; with keywords, without the file."""
        own, keywords = [key for key in OWN if key in cls.model_fields], cls._keywords()
        return [own[0], *keywords, *own[2:]] if keywords else [*cls.model_fields]

    @classmethod
    def _keywords(cls) -> list[str]:
        return [key for key in cls.model_fields if key not in OWN]

    @property
    def keywords(self) -> dict[str, Any]:
        """Keyword arguments of the function of the catalogue."""
        return self.model_dump(exclude_unset=True, exclude=set(OWN))


class DriverTable(Record):
    """A driving law: straight ahead from the start, or along a path."""

    name: Literal["straight", "follow"] = Field(description="name of the law")
    speed: Annotated[float, AfterValidator(not_zero)] = Field(
        description="speed; negative to drive backward [m/s]"
    )
    path: Annotated[tuple[Pair, ...], Field(strict=False)] | None = Field(
        default=None, description="way-points to follow [m]"
    )
    file: str | None = Field(
        default=None, description="a file with the way-points to follow, x and y"
    )


class Time(Record):
    """Duration and sampling of the motion."""

    duration: Positive = Field(description="duration of the motion [s]")
    step: Positive = Field(description="time between samples of the result [s]")


class Solver(Record):
    """Options of the integrator."""

    tolerance: Annotated[float, Field(ge=MIN_TOLERANCE, le=MAX_TOLERANCE)] = Field(
        default=1e-8, description=SIZED
    )
    compiled: bool = Field(default=False, description=COMPILED)

    @property
    def options(self) -> SolverOptions:
        """Options of the solvers, as a `SolverOptions` record."""
        return SolverOptions(**dict(self))


class Output(Record):
    """Destination of the result."""

    file: Annotated[str, Field(min_length=1)] = Field(
        description="the result file (.nc), in the working folder or the problem's folder"
    )


class CommonKeys(Record):
    """Common keys of all problems: verb and title."""

    verb: str = Field(description=VERB)
    title: str | None = Field(default=None, description="title of the result and its figures")

    alternatives: ClassVar[Mapping[KeyPath, tuple[str, ...]]] = {}
    """Keys of which exactly one is required, by table."""

    @property
    def named_files(self) -> tuple[str, ...]:
        """Names of input files other than those in the keys ``file`` and ``friction`` of tables."""
        return ()

    def faults(self) -> Iterator[Fault]:
        """Yield an error for each value that contradicts another one."""
        yield from ()


class Timed(CommonKeys):
    """Common keys of problems with motions: time and solver."""

    time: Time = Field(description="duration and sampling")
    solver: Solver = Field(default=Solver(), description="options of the integrator")

    def faults(self) -> Iterator[Fault]:
        """Yield an error for each value that contradicts another one."""
        yield from super().faults()
        time = self.time
        if time.step > time.duration:
            expected = f"at most the duration, {time.duration:g} s"
            yield Fault(("time", "step"), expected, f"{time.step:g} s; reduce the step")
        elif time.duration / time.step > MAX_SAMPLES:
            expected = f"a step with at most {MAX_SAMPLES} samples in {time.duration:g} s"
            yield Fault(("time", "step"), expected, f"{time.step:g} s; increase the step")


class Runnable(Timed):
    """Common keys of the problems that ``slipfree run`` solves."""

    output: Output | None = Field(default=None, description="destination of the result")


class TerrainKeys(Timed):
    """Common keys of problems on terrain: ground and start."""

    terrain: TerrainTable = Field(description="the ground")
    start: dict[str, Quantity] = Field(
        description="x, y (or longitude, latitude in degrees, on a map with a reference system), "
        "heading (counter-clockwise, from the axis of frame), joints, and with model = 'dynamics' "
        "the speed along the forward axis; zero by default [m, rad, m/s]"
    )

    alternatives: ClassVar[Mapping[KeyPath, tuple[str, ...]]] = {
        ("terrain",): ("file", "sample", "synthetic")
    }

    def faults(self) -> Iterator[Fault]:
        """Yield the errors of common keys, and an error for obstacles without dynamics."""
        yield from super().faults()
        model, able = getattr(self, "model", "kinematics"), ("direct", "plan")
        if self.terrain.obstacles and (self.verb not in able or model != "dynamics"):
            expected = "obstacles only with verb = 'direct' or 'plan' and model = 'dynamics'"
            found = f"verb = {self.verb!r}, model = {model!r}; change them, or remove the obstacles"
            yield Fault(("terrain", "obstacles"), expected, found)


class MotionKeys(TerrainKeys, Runnable):
    """Common keys of problems with the motion of one vehicle."""

    frame: Frame = Field(
        default="paper",
        description="axis from which headings are measured, also in summaries, exports, figures: "
        "y, or x (REP 103)",
    )
    vehicle: VehicleSource = Field(description="the vehicle")


class LawKeys(Record):
    """Model and law of a problem."""

    model: Literal["kinematics", "quasi-static", "dynamics"] = Field(
        default="kinematics", description=MODEL
    )
    slip: SlipName = Field(default="least", description=SLIP)
    law: Law = Field(default=Law.model_construct(), description=LAW)


class Modelled(LawKeys, MotionKeys):
    """Keys of problems with a choice of model."""


if TYPE_CHECKING:
    Noise = Record
else:
    Noise = record_of(reference_speeds.Noise)


class NoisyControl(Record):
    """Key of the control of a step climber that is not a parameter of the controller."""

    noise: Noise | None = Field(
        default=None, description="noise of the sensors; without this table, exact measurements"
    )


if TYPE_CHECKING:
    Control = Any
else:
    Control = record_of(step_climbing.StepClimbing, NoisyControl)


class ClimbingDriver(DriverTable):
    """A driving law, with the control of the wheels of a step climber."""

    control: Control = Field(
        default=Control(), description=f"control of the wheels, with name = {STEP_CLIMBING!r}"
    )

    def climbing_faults(self, model: str) -> Iterator[Fault]:
        """Yield errors of the driver of a step climber, and of its keys with another driver."""
        if self.name != STEP_CLIMBING:
            if "control" in self.model_fields_set:
                found = f"{self.name!r}; change it, or remove [driver.control]"
                yield Fault(("driver", "name"), f"{STEP_CLIMBING!r} with [driver.control]", found)
            return
        if model != "dynamics":
            expected = f"'dynamics' with driver.name = {STEP_CLIMBING!r}"
            yield Fault(("model",), expected, f"{model!r}; change it")
        if self.speed < 0:
            expected = f"a positive speed with name = {STEP_CLIMBING!r}"
            yield Fault(("driver", "speed"), expected, f"{self.speed:g}; change it")
        for key in ("path", "file"):
            if getattr(self, key) is not None:
                expected = f"no path with name = {STEP_CLIMBING!r}"
                yield Fault(("driver", key), expected, f"{key!r}; remove it")
