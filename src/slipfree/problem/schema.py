"""Tables that problem files of several verbs share: types, ranges, units and meanings.

Tables of laws, soils, catalogue vehicles, obstacles and features of synthetic grounds are made from
annotated dataclasses and functions; those of one verb are in `slipfree.problem.verbs`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from math import inf
from typing import Annotated, Any, Literal, cast

from pydantic import AfterValidator, Field, PlainValidator, create_model

from slipfree import catalog
from slipfree.control import step_climbing
from slipfree.core.errors import ModelError
from slipfree.core.trajectory import Frame
from slipfree.files import toml
from slipfree.files.urdf.tree import UrdfTable
from slipfree.files.vehicle_toml import VehicleTable
from slipfree.geometry.regions import Region
from slipfree.laws.compliant import Compliant
from slipfree.laws.coulomb import Coulomb
from slipfree.laws.least_slip import LeastSlip
from slipfree.laws.linear_creep import LinearCreep
from slipfree.laws.protocols import ContactLaw, GroundLaw, SlipLaw
from slipfree.laws.rolling import Rolling
from slipfree.laws.soil import OF_THE_LAW, SOILS, Soil, SoilRegion, known_soil
from slipfree.solve.system import SolverOptions
from slipfree.terrain import solids
from slipfree.terrain.solids import Profile
from slipfree.terrain.synthetic import FEATURES
from slipfree.vehicle.tree import BODIES, Vehicle

CATALOG: dict[str, Callable[..., Vehicle]] = {
    name: getattr(catalog, name) for name in catalog.__all__
}
OWN = ("catalog", "file", "actuated", "name")  # keys that are not keywords of the function
DEFAULT_SOIL = next(iter(SOILS))
MAX_SAMPLES = 1_000_000  # largest number of samples of a motion
Gravity = Any  # checked by `gravity_of`
GRAVITY = f"gravity, or the body with that gravity: {', '.join(BODIES)} [m/s^2]"
FILE = "file"  # key of [inputs] and [given] that names a file
STEP_CLIMBING = "step-climbing"
PATHS = ("path", "paths", "file")  # keys of a driver that give the path to follow
OBSTACLES: dict[str, tuple[Callable[..., Profile], str]] = {  # and their descriptions
    "ramp": (solids.ramp, "a ramp up to a plateau, which begins at x = 0"),
    "step": (solids.step, "a vertical step at x = 0 up to a plateau"),
    "kerb": (solids.kerb, "a rectangular block, which begins at x = 0"),
    "stairs": (solids.stairs, "stairs up to a plateau, which begin at x = 0"),
}
KINDS = (*OBSTACLES, "points")


class RegionTable(toml.Record):
    """A region of the ground: a disc or a polygon.

    Attributes
    ----------
    x : float or None
        Coordinate of the centre of a disc. [m]
    y : float or None
        Coordinate of the centre of a disc. [m]
    radius : float or None
        Radius of a disc. [m]
    points : tuple of tuple of 2 floats or None
        Corners of a polygon. [m]
    """

    x: float | None = None
    y: float | None = None
    radius: toml.Positive | None = None
    points: Annotated[tuple[toml.Pair, ...], Field(strict=False)] | None = None


def region_of(table: RegionTable) -> Region:
    """Return the region of a table; raise ModelError if it is neither a disc nor a polygon."""
    disc = (table.x, table.y, table.radius)
    if table.points is not None and disc == (None, None, None):
        return Region.polygon(table.points)
    if table.points is None and None not in disc:
        return Region.disc(*(float(value or 0.0) for value in disc))
    keys = ("x", "y", "radius", "points")
    found = ", ".join(repr(key) for key in keys if getattr(table, key) is not None)
    raise ModelError(
        "expected either 'x', 'y' and 'radius' (a disc), or 'points' (a polygon), found "
        f"{found or 'none'}; add the missing keys or remove the others"
    )


def _optional(kind: Callable[..., Any], meaning: str) -> Any:
    """Return the definition of an optional table with the parameters of a function."""
    record = toml.record_of(kind, omitted=("grid",), meaning=f"{meaning[:1].upper()}{meaning[1:]}.")
    return record | None, Field(default=None, description=meaning)


Shapes: Any = create_model(
    "Shapes",
    __base__=toml.Record,
    __doc__="Obstacles of which a problem gives one.",
    **{name: _optional(*entry) for name, entry in OBSTACLES.items()},
)


class Obstacle(Shapes):  # type: ignore[misc]
    """An obstacle on the ground: a profile with vertical sides, at a position and heading.

    Attributes
    ----------
    points : tuple of tuple of 2 floats or None
        Corners of a convex polygon: distance along the heading, and height. [m]
    x : float
        x of the point where the profile begins. [m]
    y : float
        y of the point where the profile begins. [m]
    heading : float
        Direction of the profile, counter-clockwise from the axis of frame. [rad]
    half_width : float
        Half the width across the heading; infinite by default. [m]
    """

    points: Annotated[tuple[toml.Pair, ...], Field(strict=False)] | None = None
    x: float = 0.0
    y: float = 0.0
    heading: toml.Angle = 0.0
    half_width: toml.Positive = inf
    alternatives = KINDS


class MadeGround(toml.Record):
    """A synthetic ground: a level grid, to which features are added in the order of these keys.

    Attributes
    ----------
    x : tuple of 2 floats
        x of the first and the last node. [m]
    y : tuple of 2 floats
        y of the first and the last node. [m]
    spacing : float
        Distance between nodes. [m]
    base : float
        Height of the level grid. [m]
    placed_rocks : tuple of tuple of 4 floats
        Rocks at given positions, added last. [m]
    """

    x: toml.Pair
    y: toml.Pair
    spacing: toml.Positive
    base: float = 0.0
    placed_rocks: Annotated[tuple[toml.Rock, ...], Field(strict=False)] = ()


Synthetic: Any = create_model(
    "Synthetic",
    __base__=MadeGround,
    __doc__=MadeGround.__doc__,
    **{
        name: _optional(feature, summary.removesuffix(".").replace(" added", ""))
        for name, feature in FEATURES.items()
        # the noun of "Return the grid with ... added."
        for summary in [(feature.__doc__ or "").partition("\n")[0].partition("the grid with ")[2]]
    },
)


class HeightErrors(toml.Record):
    """Random errors of the heights of a map.

    Attributes
    ----------
    rms : float
        Standard deviation. [m]
    correlation : float
        Distance at which the correlation has fallen to 1/e. [m]
    """

    rms: toml.Positive
    correlation: toml.Positive


class ElevationError(HeightErrors):
    """A random error of the heights of a map.

    Attributes
    ----------
    seed : int
        Seed of the random numbers.
    """

    seed: toml.Count


class TerrainTable(toml.Record):
    """Ground of a problem, from a map file, a sample map or a description, and its friction.

    Attributes
    ----------
    file : str or None
        Map file, relative to the problem file.
    sample : {"jacksboro"} or None
        The sample map of matplotlib.
    synthetic : Synthetic or None
        a synthetic ground.
    cell : float or None
        Width of a cell, for pictures without coordinates. [m]
    registration : {"area", "point"} or None
        'area': values of a picture are at cell centres; 'point': at nodes.
    spacing : float or None
        Distance between nodes, for scattered points. [m]
    geographic : {"local"} or None
        Conversion of degrees to metres; by default degrees are an error.
    fill : {"linear"} or None
        Interpolation of holes inside the map; wheels must not touch other holes.
    scale : float
        Factor of x, y and heights. [1]
    horizontal_scale : float
        Further factor of x and y. [1]
    vertical_scale : float
        Further factor of heights. [1]
    window : tuple of 4 floats or None
        Part of the scaled ground to use. [m]
    smooth : float or None
        Standard deviation of a Gaussian filter of the heights. [m]
    error : ElevationError or None
        a random error of the heights.
    rolled : float or None
        Radius of the largest wheel; hollows that it cannot touch are filled. [m]
    friction : float or str or None
        Coefficient of friction, or the name of a friction map. [1]
    obstacles : tuple of Obstacle
        Solids on the ground, for model = 'dynamics'.
    """

    file: str | None = None
    sample: Literal["jacksboro"] | None = None
    synthetic: Synthetic | None = None
    cell: toml.Positive | None = None
    registration: Literal["area", "point"] | None = None
    spacing: toml.Positive | None = None
    geographic: Literal["local"] | None = None
    fill: Literal["linear"] | None = None
    scale: toml.Positive = 1.0
    horizontal_scale: toml.Positive = 1.0
    vertical_scale: toml.Positive = 1.0
    window: toml.Window | None = None
    smooth: toml.Positive | None = None
    error: ElevationError | None = None
    rolled: toml.Positive | None = None
    friction: Annotated[float | str | None, PlainValidator(toml.coefficient)] = None
    obstacles: Annotated[tuple[Obstacle, ...], Field(strict=False)] = ()
    alternatives = "file", "sample", "synthetic"


class SoilKeys(toml.Record):
    """Name of a soil, and constants that replace those of this soil."""

    name: Annotated[str, toml.one_of(SOILS)] = Field(
        default=DEFAULT_SOIL, description=f"soil of the catalogue: one of {', '.join(SOILS)}"
    )


class SoilRegionKeys(SoilKeys, RegionTable):
    """A region with another soil: a disc or a polygon.

    Attributes
    ----------
    width : float
        Width in which the soil around the region becomes its soil. [m]
    """

    width: toml.Positive


NamedSoil: Any = toml.record_of(Soil, SoilKeys)
REGION_MEANING = (SoilRegionKeys.__doc__ or "").partition("\n")[0]
SoilRegions: Any = Annotated[
    tuple[toml.record_of(Soil, SoilRegionKeys, omitted=OF_THE_LAW, meaning=REGION_MEANING), ...],  # type: ignore[misc]
    Field(strict=False),
]


class SoilTable(NamedSoil):  # type: ignore[misc]
    """Loose soil under rigid wheels, for dynamics and quasi-statics.

    Attributes
    ----------
    regions : SoilRegions
        Regions of other soils; later ones cover earlier ones.
    """

    regions: SoilRegions = ()


OF_REGIONS = (*RegionTable.model_fields, "width")  # keys of a region that are not of its soil


def soil_of(*, name: str = DEFAULT_SOIL, regions: tuple[Any, ...] = (), **constants: Any) -> Soil:
    """Return the soil of a table: one of the catalogue, with other constants and regions."""
    found = list[SoilRegion]()
    for table in regions:
        own = {key: each for key, each in toml.given_values(table).items() if key not in OF_REGIONS}
        found.append(SoilRegion(region_of(table), soil_of(**own), table.width))
    return replace(known_soil(name), regions=tuple(found), **constants)


class Law(toml.Record):
    """Parameters of a law, in a table of its name."""

    @classmethod
    def schema_for(cls, data: Any) -> type[toml.Record]:
        """Return the record of all registered laws; they may be added after the import."""
        return law_tables() if cls is Law and isinstance(data, dict) else cls

    def parameters(self, name: str) -> dict[str, Any]:
        """Return the parameters that a problem gives for a law, by name."""
        table = getattr(self, name, None)
        return {} if table is None else toml.given_values(table)


# Laws by their names in problem files: one line for each
SLIP_LAWS: dict[str, type[SlipLaw]] = {"least": LeastSlip, "rolling": Rolling}
GROUND_LAWS: dict[str, type[GroundLaw]] = {
    "coulomb": Coulomb,
    "linear_creep": LinearCreep,
    "soil": Soil,
}
CONTACT_LAWS: dict[str, type[ContactLaw]] = {"compliant": Compliant, "soil": Soil}


def law_tables() -> type[Law]:
    """Return the record of the tables of all registered laws that have parameters."""
    laws: dict[str, Any] = {**SLIP_LAWS, **GROUND_LAWS, **CONTACT_LAWS}
    keys: dict[str, Any] = {}
    for name, law in laws.items():
        if fields(law):
            table: Any = SoilTable if law is Soil else toml.record_of(law)
            keys[name] = table | None, Field(default=None, description=f"parameters of {name}")
    return cast("type[Law]", create_model("Laws", __base__=Law, __doc__=Law.__doc__, **keys))


SlipName = Annotated[str, toml.one_of(SLIP_LAWS)]


class VehicleSource(toml.Record):
    """A vehicle from the catalogue, with the keywords of its function, or from a file.

    Attributes
    ----------
    catalog : str or None
        Name in the catalogue.
    file : str or None
        a vehicle file or a URDF.
    actuated : tuple of str
        Passive joints with an actuator, which moves or holds them.
    """

    catalog: Literal[tuple(CATALOG)] | None = None  # type: ignore[valid-type]
    file: Annotated[str, Field(min_length=1)] | None = None
    actuated: Annotated[tuple[str, ...], Field(strict=False)] = ()
    alternatives = "catalog", "file"
    foreign = dict.fromkeys(
        (*VehicleTable.model_fields, *UrdfTable.model_fields, "driven", "rollers"),
        ("a vehicle file, as slipfree vehicle FILE.urdf --write NAME.toml makes one",),
    )

    @classmethod
    def schema_for(cls, data: Any) -> type[toml.Record]:
        """Return the record with the keywords of the catalogue's function, if there is one."""
        if not isinstance(data, dict) or cls._keywords():
            return cls
        name = data.get("catalog")
        schema: type[toml.Record] = (
            toml.record_of(CATALOG[name], cls) if name in tuple(CATALOG) else cls
        )
        return schema

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


class DriverTable(toml.Record):
    """A driving law: straight ahead from the start, or along a path.

    Attributes
    ----------
    name : {"straight", "follow"}
        Name of the law.
    speed : float
        Speed; negative to drive backward. [m/s]
    path : tuple of tuple of 2 floats or None
        Way-points to follow. [m]
    file : str or None
        a file with the way-points to follow, x and y.
    """

    name: Literal["straight", "follow"]
    speed: Annotated[float, AfterValidator(toml.not_zero)]
    path: Annotated[tuple[toml.Pair, ...], Field(strict=False)] | None = None
    file: str | None = None

    def faults(self, model: str) -> Iterator[toml.Fault]:  # noqa: ARG002 - for further drivers
        """Yield an error for each key that does not suit the name, or the model."""
        given = [key for key in PATHS if getattr(self, key, None) is not None]
        if self.name != "follow":
            for key in given:
                found = f"{key!r}; use name = 'follow', or remove the key"
                yield toml.Fault(("driver", key), f"no path with name = {self.name!r}", found)
        elif len(given) != 1:
            keys = [key for key in PATHS if key in type(self).model_fields]
            expected = f"exactly one of {', '.join(keys)} with name = 'follow'"
            yield toml.Fault(("driver",), expected, " and ".join(given) or "none")


class Time(toml.Record):
    """Duration and sampling of the motion.

    Attributes
    ----------
    duration : float
        Duration of the motion. [s]
    step : float
        Time between samples of the result. [s]
    """

    duration: toml.Positive
    step: toml.Positive


OfSolver: Any = toml.record_of(SolverOptions)


class Solver(OfSolver):  # type: ignore[misc]
    """Options of the integrator."""

    @property
    def options(self) -> SolverOptions:
        """Options of the solvers, as a `SolverOptions` record."""
        return SolverOptions(**dict(self))


class Output(toml.Record):
    """Destination of the result.

    Attributes
    ----------
    file : str
        The result file (.nc), in the working folder or the problem's folder.
    """

    file: Annotated[str, Field(min_length=1)]


class FileKeys(toml.Record):
    """Keys of a file, with the errors of values that contradict each other."""

    def faults(self) -> Iterator[toml.Fault]:
        """Yield an error for each value that contradicts another one."""
        yield from ()


class CommonKeys(FileKeys):
    """Common keys of all problems: verb, title and gravity.

    Attributes
    ----------
    verb : str
        Kind of the problem.
    title : str or None
        Title of the result and its figures.
    """

    verb: str
    title: str | None = None
    gravity: Gravity = Field(default="earth", description=GRAVITY)


class Timed(CommonKeys):
    """Common keys of problems with motions: time and solver.

    Attributes
    ----------
    time : Time
        Duration and sampling.
    solver : Solver
        Options of the integrator.
    """

    time: Time
    solver: Solver = Solver()

    def faults(self) -> Iterator[toml.Fault]:
        """Yield an error for each value that contradicts another one."""
        yield from super().faults()
        time = self.time
        if time.step > time.duration:
            expected = f"at most the duration, {time.duration:g} s"
            yield toml.Fault(("time", "step"), expected, f"{time.step:g} s; reduce the step")
        elif inf > time.duration > MAX_SAMPLES * time.step:
            expected = f"a step with at most {MAX_SAMPLES} samples in {time.duration:g} s"
            yield toml.Fault(("time", "step"), expected, f"{time.step:g} s; increase the step")


class Runnable(Timed):
    """Common keys of the problems that ``slipfree run`` solves.

    Attributes
    ----------
    output : Output or None
        Destination of the result.
    """

    output: Output | None = None


class TerrainKeys(Timed):
    """Common keys of problems on terrain: ground and start.

    Attributes
    ----------
    terrain : TerrainTable
        The ground.
    start : mapping of str to float
        x, y (or longitude, latitude in degrees, on a map with a reference system), heading
        (counter-clockwise, from the axis of frame), joints, and with model = 'dynamics' the speed
        along the forward axis; zero by default. [m, rad, m/s]
    """

    terrain: TerrainTable
    start: dict[str, toml.Quantity]

    def faults(self) -> Iterator[toml.Fault]:
        """Yield the errors of common keys and of a driver, and of obstacles without dynamics."""
        yield from super().faults()
        model, able = getattr(self, "model", "kinematics"), ("direct", "plan")
        if driver := getattr(self, "driver", None):
            yield from driver.faults(model)
        if self.terrain.obstacles and (self.verb not in able or model != "dynamics"):
            expected = "obstacles only with verb = 'direct' or 'plan' and model = 'dynamics'"
            found = f"verb = {self.verb!r}, model = {model!r}; change them, or remove the obstacles"
            yield toml.Fault(("terrain", "obstacles"), expected, found)


class MotionKeys(TerrainKeys, Runnable):
    """Common keys of problems with the motion of one vehicle.

    Attributes
    ----------
    frame : Frame
        Axis from which headings are measured, also in summaries, exports, figures: y, or x (REP
        103).
    vehicle : VehicleSource
        The vehicle.
    """

    frame: Frame = "paper"
    vehicle: VehicleSource


class LawKeys(toml.Record):
    """Model and law of a problem.

    Attributes
    ----------
    model : {"kinematics", "quasi-static", "dynamics"}
        kinematics: a slip law determines the rates; quasi-static: a wheel-ground law and
        equilibrium without inertia; dynamics: a contact law and inertia.
    slip : str
        Slip law, for model = 'kinematics': 'least' (least slip) or 'rolling' (without slip).
    law : Law
        Parameters of the law of the model, in a table with the name of the law.
    """

    model: Literal["kinematics", "quasi-static", "dynamics"] = "kinematics"
    slip: SlipName = "least"
    law: Law = Law.model_construct()


class Modelled(LawKeys, MotionKeys):
    """Keys of problems with a choice of model."""


Control: Any = toml.record_of(step_climbing.StepClimbing)


class ClimbingDriver(DriverTable):
    """A driving law, with the control of the wheels of a step climber."""

    control: Control = Field(
        default=Control(), description=f"control of the wheels, with name = {STEP_CLIMBING!r}"
    )

    def faults(self, model: str) -> Iterator[toml.Fault]:
        """Yield the errors of paths and of a driver of a step climber."""
        yield from super().faults(model)
        if self.name != STEP_CLIMBING:
            if "control" in self.model_fields_set:
                found = f"{self.name!r}; change it, or remove [driver.control]"
                yield toml.Fault(
                    ("driver", "name"), f"{STEP_CLIMBING!r} with [driver.control]", found
                )
            return
        if model != "dynamics":
            expected = f"'dynamics' with driver.name = {STEP_CLIMBING!r}"
            yield toml.Fault(("model",), expected, f"{model!r}; change it")
        if self.speed < 0:
            expected = f"a positive speed with name = {STEP_CLIMBING!r}"
            yield toml.Fault(("driver", "speed"), expected, f"{self.speed:g}; change it")
