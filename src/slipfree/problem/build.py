"""Set-up of problems: start, times, solids, model and driving law."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from inspect import signature
from math import degrees
from typing import Any, TypeVar

import numpy as np

from slipfree.catalog import check_climber
from slipfree.control.path_following import follow, straight
from slipfree.control.step_climbing import StepClimbing, check_period, climbing, held_torques
from slipfree.core.dae import Dae
from slipfree.core.errors import DataError
from slipfree.core.facts import NOTE, Lines
from slipfree.core.records import Array
from slipfree.core.trajectory import Column, Trajectory, heading_column
from slipfree.files.maps.reference_systems import semi_major_axis
from slipfree.files.tables import read_columns
from slipfree.files.toml import Fault, key_path, name_errors, unit_faults
from slipfree.files.toml import Place as KeyPath
from slipfree.geometry.path import Path
from slipfree.models.dynamics import dynamics
from slipfree.models.kinematics import check_driven, check_rollers, direct_kinematics, quasi_statics
from slipfree.problem import schema
from slipfree.problem.build_ground import GroundMap, at, build_ground, ground_facts
from slipfree.problem.build_vehicle import build_vehicle as build_vehicle
from slipfree.problem.problem import Problem, S, shared
from slipfree.solve.settle import SPEED, settle
from slipfree.solve.system import SolverOptions
from slipfree.terrain.base import Terrain
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.solids import Prism, Profile, Solid, Solids, flat, placed, section_of
from slipfree.vehicle.tree import Vehicle, foreign_map_words, gravity_words

DYNAMIC_TOLERANCE = 1e-6  # default tolerance of dynamics, whose motions are less smooth
EVEN = 1e-6  # smaller relative differences of periods count as zero
LAWS: dict[str, Mapping[str, Callable[..., Any]]] = {
    "kinematics": schema.SLIP_LAWS,
    "quasi-static": schema.GROUND_LAWS,
    "dynamics": schema.CONTACT_LAWS,
}  # laws of each model; the first is the default
MAKERS = {"soil": schema.soil_of}  # functions that make a law from a table with further keys
OF_THE_MOTION = {"title", "start", "inputs", "driver", "time", "solver", "output"}
ORIGIN = ("x", "y")  # states at the start that the ground depends on
M = TypeVar("M", bound=schema.Modelled)
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class World:
    """Ground and vehicle of a problem."""

    ground: GroundMap  # heights on a grid
    terrain: Bicubic  # smooth surface, with its local origin at the start
    vehicle: Vehicle
    prisms: tuple[Prism, ...]  # solids on the ground

    @property
    def facts(self) -> Lines:
        """Facts about ground and vehicle: pairs of name and description."""
        return [*ground_facts(self.ground), *vehicle_facts(self.vehicle, self.ground.crs)]


@dataclass(frozen=True, eq=False)
class Setup(World):
    """Set-up of the integration of a problem."""

    model: Dae  # settles the vehicle at its start
    dae: Dae  # to integrate
    start: Trajectory  # one sample, at rest or with the given rates of the platform
    inputs: Any  # constant rates, rates per interval of t, or a driving law
    t: Array  # of the samples, or of the steps of a sampled driving law [s]
    driven: str  # description of the inputs
    every: int = field(default=0, kw_only=True)  # steps per sample; 0: continuous

    @property
    def facts(self) -> Lines:
        """Facts about ground, vehicle and inputs: pairs of name and description."""
        return [*super().facts, ("driven by", self.driven)]


def build_terrain(problem: Problem[S], ground: GroundMap) -> Bicubic:
    """Return the ground as a surface, with its local origin at the start, which it must contain."""
    start, grid = problem.spec.start, ground.grid
    for axis, nodes in (("x", grid.x), ("y", grid.y)):
        place = start.get(axis, 0.0)
        if not nodes[0] <= place <= nodes[-1]:
            extent = f"extends from {nodes[0]:.10g} to {nodes[-1]:.10g} m in {axis}"
            found = f"{axis} = {place:.10g} m; move the start, or enlarge the ground in [terrain]"
            problem.refuse(Fault(("start", axis), f"a start on the map, which {extent}", found))
    return Bicubic(grid, (start.get("x", 0.0), start.get("y", 0.0)), ground.mu)


def heading_offset(problem: Problem[S]) -> float:
    """Return the angle that converts a heading of the problem to one from the y axis [rad]."""
    own = getattr(problem.spec, "frame", "paper")
    return float(heading_column(0.0, "paper", own=own).values)


def in_frame(problem: Problem[S], dae: Dae) -> Dae:
    """Return a model whose conditions, costs and messages have headings of the problem's frame."""
    return replace(dae, reported={"heading": -heading_offset(problem)})


def build_start(problem: Problem[S], dae: Dae) -> Trajectory:
    """Return the vehicle settled on the ground at the start of a problem, as one sample."""
    values: dict[str, Any] = dict(problem.spec.start)
    if "heading" in _start_names(dae):
        values["heading"] = values.get("heading", 0.0) + heading_offset(problem)
    with at(problem, ("start",)):
        return settle(dae, options=solver_options(problem), **values)


def solver_options(problem: Problem[S]) -> SolverOptions:
    """Return the solver options of a problem; the default tolerance depends on the model."""
    spec = problem.spec
    options: SolverOptions = spec.solver.options
    is_dynamic = getattr(spec, "model", None) == "dynamics"
    if is_dynamic and "tolerance" not in spec.solver.model_fields_set:
        return replace(options, tolerance=DYNAMIC_TOLERANCE)
    return options


def sampled_times(problem: Problem[Any], key: KeyPath, period: float) -> tuple[Array, int]:
    """Return the times of the steps of a sampled controller, and their number per sample.

    The last step is the last regular sample; ``key`` is that of the ``period`` in s. ProblemError
    is raised if the period does not divide the time between samples, or there are more than a
    million steps.
    """
    time = problem.spec.time
    if time.duration / period > schema.MAX_SAMPLES:
        expected = f"a period with at most {schema.MAX_SAMPLES} steps in {time.duration:g} s"
        problem.refuse(Fault(key, expected, f"{period:g} s; increase it"))
    every = round(time.step / period)
    if every < 1 or abs(every * period - time.step) > EVEN * period:
        expected = f"a multiple of {'.'.join(map(str, key))}, {period:g} s"
        problem.refuse(Fault(("time", "step"), expected, f"{time.step:g}; change one of them"))
    count = every * int(time.duration / time.step + EVEN) + 1
    return period * np.arange(count), every


def check_names(
    problem: Problem[S], dae: Dae, inputs: Iterable[str] | None, driven: Dae | None = None
) -> None:
    """Raise ProblemError for unknown states, unknown or missing inputs, and wrong units.

    Inputs are those of ``driven``, by default of ``dae``; they are not checked if ``inputs``, the
    names of the given inputs, is None.
    """
    faults = [*name_errors(("start",), problem.spec.start, _start_names(dae))]
    if inputs is not None:
        known = (driven or dae).input_names
        faults += name_errors(("inputs",), inputs, known)
        faults += [
            Fault(("inputs", name), "a rate", "none") for name in known if name not in inputs
        ]
    problem.refuse(*faults or check_units(problem.spec, dae))


def _start_names(dae: Dae) -> list[str]:
    standing = dae.standing
    return dae.state_names if standing is None else [*standing.model.state_names, SPEED]


def vehicle_facts(vehicle: Vehicle, crs: str) -> Lines:
    """Return facts about a vehicle, pairs of name and text: wheels, mass, gravity and notes.

    ``crs`` is the reference system of the map; empty if unknown.
    """
    wheels = ", ".join(
        f"{w.name} {w.radius:g} m {'driven' if w.driven else 'free'}" for w in vehicle.wheels
    )
    facts = [("vehicle", f"{vehicle.name}: {wheels}")]
    if rollers := [f"{w.name} {degrees(w.rollers):.4g}" for w in vehicle.wheels if w.rollers]:
        words = "degrees from the wheel's axle; the change from roller to roller is neglected"
        facts.append(("rollers", f"{', '.join(rollers)} {words}"))
    if vehicle.mass:
        facts.append(("mass", f"{vehicle.mass:g} kg, weight {vehicle.weight:.1f} N"))
        hint = foreign_map_words(vehicle.gravity, semi_major_axis(crs))
        facts.append(("gravity", gravity_words(vehicle.gravity) + hint))
    return [*facts, *((NOTE, note) for note in vehicle.notes)]


def wheel_angles_at(run: Trajectory, t: Array) -> Column:
    """Return the column of wheel angles of a motion, interpolated at times ``t`` [s]."""
    turns = run.columns["wheel_angle"]
    values = [np.interp(t, run.t, each) for each in turns.values.T]
    return Column(turns.label, np.stack(values, axis=1))


def build_solids(problem: Problem[S], terrain: Bicubic) -> tuple[Prism, ...]:
    """Return the obstacles of a ground as prisms that stand on it.

    Height zero of an obstacle's profile is the height of the ground where the profile begins.
    """
    prisms = list[Prism]()
    for k, spec in enumerate(problem.spec.terrain.obstacles):
        place = ("terrain", "obstacles", k)
        (kind,) = spec.model_fields_set & {*schema.KINDS}
        shape = getattr(spec, kind)
        with at(problem, (*place, kind)):
            profile = (
                Profile((*flat().solids, Solid(shape)))
                if kind == "points"
                else schema.OBSTACLES[kind][0](**dict(shape))
            )
        west, east, south, north = terrain.domain
        if not (west <= spec.x <= east and south <= spec.y <= north):
            expected = f"x from {west:.10g} to {east:.10g} m, y from {south:.10g} to {north:.10g} m"
            found = f"x = {spec.x:.10g} m, y = {spec.y:.10g} m, off the map; move the obstacle"
            problem.refuse(Fault(place, expected, found))
        heading = spec.heading + heading_offset(problem)
        z = float(terrain.elevation(np.array(spec.x), np.array(spec.y)))
        where: dict[str, Any] = {"x": spec.x, "y": spec.y, "z": z, "heading": heading}
        prisms += placed(profile, **where, half_width=spec.half_width)
    return tuple(prisms)


def build_model(
    problem: Problem[M], vehicle: Vehicle, terrain: Terrain, prisms: tuple[Prism, ...] = ()
) -> Dae:
    """Return the model of a problem for a vehicle on a ground; ``prisms`` are for dynamics."""
    spec, law = problem.spec, model_law(problem)
    with at(problem, ("vehicle",)):
        if spec.model == "kinematics":
            check_driven(vehicle)
        if spec.model != "dynamics":
            check_rollers(vehicle)
    with at(problem, ("slip",) if spec.model == "kinematics" else ("model",)):
        if spec.model == "kinematics":
            return in_frame(problem, direct_kinematics(vehicle, terrain, slip=law))
        if spec.model == "quasi-static":
            return in_frame(problem, quasi_statics(vehicle, terrain, law=law))
        ground = Solids(terrain, prisms) if prisms else terrain
        return in_frame(problem, dynamics(vehicle, ground, law=law))


def law_name(spec: schema.LawKeys) -> str:
    """Return the name of the law of a problem's model: the given one, or the default."""
    if spec.model == "kinematics":
        return spec.slip
    return next(iter(sorted(spec.law.model_fields_set)), next(iter(LAWS[spec.model])))


def model_law(problem: Problem[Any]) -> Any:
    """Return the law of a problem's model: a slip law, a wheel-ground law or a contact law.

    ProblemError is raised if a given law or the key ``slip`` does not belong to the model, several
    laws are given, or a parameter is missing or invalid.
    """
    spec: schema.LawKeys = problem.spec
    name, known = law_name(spec), LAWS[spec.model]
    if spec.model != "kinematics" and "slip" in spec.model_fields_set:
        expected = f"no slip law with model = {spec.model!r}, where forces determine the slip"
        problem.refuse(Fault(("slip",), expected, f"{spec.slip!r}; remove the key"))
    for other in spec.law.model_fields_set - ({name} & set(known)):
        expected = f"slip = {other!r}, where this law applies"
        if other not in known:
            model = next(model for model, laws in LAWS.items() if other in laws)
            expected = f"model = {model!r}, where this law applies"
            found = f"model = {spec.model!r}; set it to {model!r}, or remove the table"
        elif spec.model == "kinematics":
            found = f"slip = {spec.slip!r}; set slip = {other!r}, or remove the table"
        else:
            expected = f"one law with model = {spec.model!r}, of {', '.join(known)}"
            found = f"{', '.join(sorted(spec.law.model_fields_set))}; keep one of these tables"
        problem.refuse(Fault(("law", other), expected, found))
    make: Any = MAKERS.get(name, known[name])
    values = spec.law.parameters(name)
    for key, parameter in signature(make).parameters.items():
        optional = (
            parameter.kind is parameter.VAR_KEYWORD or parameter.default is not parameter.empty
        )
        if not optional and key not in values:
            problem.refuse(Fault(("law", name, key), "a value", "none"))
    with at(problem, ("law", name)):
        return make(**values)


def build_world(problem: Problem[Any]) -> World:
    """Return ground and vehicle of a problem.

    Consecutive runs of a sweep share them, unless a key changes on which they depend.
    """

    def build() -> World:
        ground = build_ground(problem)
        vehicle = build_vehicle(problem)
        terrain = build_terrain(problem, ground)
        return World(ground, terrain, vehicle, build_solids(problem, terrain))

    return _shared("world", problem, build)


def build_shared_model(problem: Problem[M], world: World) -> Dae:
    """Return the model of a problem, which consecutive runs of a sweep share like its world."""
    return _shared(
        "model", problem, lambda: build_model(problem, world.vehicle, world.terrain, world.prisms)
    )


def _shared(kind: str, problem: Problem[Any], build: Callable[[], T]) -> T:
    spec = problem.spec
    rest = spec.model_dump_json(exclude=OF_THE_MOTION, exclude_unset=True, serialize_as_any=True)
    origin = tuple(spec.start.get(name) for name in ORIGIN)
    return shared(kind, (problem.folder, rest, origin), build)


def build_law(problem: Problem[S], driver: schema.DriverTable, dae: Dae, start: Trajectory) -> Any:
    """Return the inputs that the driving law of a problem computes from state and time."""
    with at(problem, ("driver",)):
        if driver.name == "straight":
            return straight(dae, start, speed=driver.speed)
        points, (west, east, south, north) = path_points(problem, driver), dae.ground.domain
        beyond = ((points < [west, south]) | (points > [east, north])).any(axis=1)
        if beyond.any():
            x, y = points[beyond.argmax()]
            raise DataError(
                f"expected way-points on the map, which extends from x = {west:.10g}, y = "
                f"{south:.10g} to x = {east:.10g}, y = {north:.10g} m, found one at x = {x:.10g}, "
                f"y = {y:.10g}; move it"
            )
        return follow(dae, Path(points), speed=driver.speed)


def build_climbing(problem: Problem[Any], world: World, model: Dae) -> tuple[Dae, Any]:
    """Return the model of a step climber with its controller, and the inputs of this model."""
    driver = problem.spec.driver
    with at(problem, ("driver", "control")):
        control = StepClimbing(**dict(driver.control))
    with at(problem, ("vehicle",)):
        check_climber(world.vehicle)
    if driver.period is not None:
        with at(problem, ("driver", "period")):
            check_period(driver.period, control, world.vehicle)
    with at(problem, ("driver", "control", "directions")):
        sampled = driver.period is not None
        dae = climbing(model, control, level_section(world), sampled=sampled)
    held = held_torques(dae, control) if sampled else {}
    return dae, dae.inputs(reference_speed=driver.speed, **held)


def level_section(world: World) -> Profile | None:
    """Return the section of level ground and solids in the vehicle's plane; None without it."""
    if not world.terrain.is_level:
        return None
    return section_of(world.prisms, float(world.terrain.grid.z[0, 0]))


def path_points(problem: Problem[S], driver: schema.DriverTable) -> Array:
    """Return the points of the path that a driving law follows, shape (n, 2) [m]."""
    if driver.path is not None:
        return np.array(driver.path)
    return np.array(read_columns(problem.folder / str(driver.file), "xy").rows())


UNIT = re.compile(r"\[([^\],]+)\]$")  # a single unit at the end of a description
BARE = ("start", "goal", "limits")  # tables with angles
MAX_INTERVALS = 10.0  # largest median time between rows of a table [duration of the motion]
TABLES = (*BARE, "inputs", "bounds")


def unit_of(spec: schema.CommonKeys, key: str) -> str:
    """Return the unit of a dotted key of a problem, such as ``m/s``; empty without a unit."""
    table: Any = spec
    description = ""
    for part in key_path(key):
        if not isinstance(table, dict):
            field = getattr(type(table), "model_fields", {}).get(part)
            description = (field.description or "") if field else ""
        table = table.get(part) if isinstance(table, dict) else getattr(table, part, None)
    unit = UNIT.search(description)
    return unit[1] if unit else ""


def check_units(spec: schema.TerrainKeys, dae: Dae) -> Iterator[Fault]:
    """Yield an error for each value whose unit differs from that of the model's quantity."""
    units = dae.units
    for name in TABLES:
        yield from unit_faults((name,), getattr(spec, name, None) or {}, units, bare=name in BARE)
    for index, wanted in enumerate(getattr(spec, "way_points", ())):
        yield from unit_faults(("way_points", index), wanted, units, bare=True)
    rates = {
        name: unit.replace(" s-1", " s-2") if " s-1" in unit else f"{unit} s-1"
        for name, unit in units.items()
    }
    yield from unit_faults(("accelerations",), getattr(spec, "accelerations", {}), rates)


def check_time_unit(t: Array, duration: float) -> None:
    """Raise DataError if rows of a table are too far apart for the duration of a motion [s]."""
    interval = float(np.median(np.diff(t))) if t.size > 2 else 0.0
    if interval > MAX_INTERVALS * duration:
        raise DataError(
            f"expected times in s for a motion of {duration:g} s, found rows {interval:g} s apart "
            "(median); if the times are in other units, name them in the first line, as in "
            "'t [ms]', else increase the duration"
        )


def moves_sideways(vehicle: Vehicle) -> bool:
    """Return whether a vehicle can move across its heading: rollers, or all wheels steered."""
    commanded = {each.name for each in vehicle.of("commanded")}
    steered = {joint.name for joint in vehicle.joints if joint.coordinates & commanded}
    return any(w.rollers for w in vehicle.wheels) or all(
        w.parent in steered for w in vehicle.wheels
    )
