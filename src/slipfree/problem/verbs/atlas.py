"""Mobility maps: keys of their problems, and their set-up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from slipfree.atlas.atlas import (
    HEADINGS,
    TOLERANCE,
    PoseEvaluator,
    bands_of,
    pose_evaluator,
    tile_of,
    tiles_of,
)
from slipfree.core.dae import Dae
from slipfree.core.facts import Lines
from slipfree.core.records import Array, Label
from slipfree.core.trajectory import Frame, heading_column
from slipfree.files.atlas_files import EMPTY, Site
from slipfree.files.toml import Fault, Positive, Range, Record, name_errors
from slipfree.files.toml import Place as KeyPath
from slipfree.problem import schema
from slipfree.problem.build import build_model, build_vehicle, law_name, vehicle_facts
from slipfree.problem.build_ground import Extremes, GroundMap, build_ground, ground_facts
from slipfree.problem.problem import Problem
from slipfree.routing.traversability import extents
from slipfree.terrain.bicubic import Bicubic, Elevation, Outline, PagedBicubic, parts_of
from slipfree.vehicle.tree import Vehicle

MAX_HEADINGS = 360
ROOM = 3.0  # width of the ground that is known around places [radius of the vehicle]


class AtlasTable(Record):
    """Headings, nodes and quantities of a mobility map.

    Attributes
    ----------
    headings : int
        Number of equally spaced headings.
    every : int
        Distance between nodes of the result, in nodes of the map.
    error : float or None
        Largest difference between the ground and the map, for computed extremes of pose, tip-over
        margin, clearance of bodies and least friction. [m]
    guarantee : float or None
        Largest difference between the ground and the map, for bounds of the poses that are proved
        for every such ground. [m]
    within : mapping of str to tuple of 2 floats
        Bounds of quantities by name: headings at which one is outside are not allowed. [rad, m, 1]
    speed : float
        Speed that the driven wheels would have without slip, for the work of the drives per metre;
        on soil, the poses are those at this speed. [m/s]
    tolerance : float
        Width of the bounds of the least coefficient of friction. [1]
    compiled : bool
        Whether to compile the equations; the first compilation for a vehicle takes up to a minute,
        its result is cached.
    """

    headings: Annotated[int, Field(ge=1, le=MAX_HEADINGS)] = HEADINGS
    every: Annotated[int, Field(ge=1)] = 1
    error: Positive | None = None
    guarantee: Positive | None = None
    within: dict[str, Range] = Field(default={})
    speed: float = 0.0
    tolerance: Annotated[float, Field(gt=0, le=0.1)] = TOLERANCE
    compiled: bool = True


class AtlasKeys(schema.LawKeys, schema.CommonKeys):
    """Mobility map: where and how a vehicle stands at the nodes of a map, for several headings.

    Attributes
    ----------
    frame : Frame
        Axis from which headings are measured: y, or x (REP 103).
    terrain : TerrainTable
        The ground.
    vehicle : VehicleSource
        The vehicle.
    atlas : AtlasTable
        Headings, nodes and quantities.
    """

    verb: Literal["atlas"]
    frame: Frame = "paper"
    terrain: schema.TerrainTable
    vehicle: schema.VehicleSource
    atlas: AtlasTable = AtlasTable()

    alternatives: ClassVar[Mapping[KeyPath, tuple[str, ...]]] = schema.TerrainKeys.alternatives

    def faults(self) -> Iterator[Fault]:
        """Yield errors for dynamics and obstacles."""
        yield from super().faults()
        if self.model == "dynamics":
            expected = "'kinematics' or 'quasi-static' with verb = 'atlas'"
            yield Fault(
                ("model",), expected, "'dynamics'; the vehicle stands still or drives slowly"
            )
        if self.terrain.obstacles:
            expected, found = "no obstacles with verb = 'atlas'", "some; remove them"
            yield Fault(("terrain", "obstacles"), expected, found)


@dataclass(frozen=True, eq=False)
class AtlasSetup:
    """Model, places and inputs of a mobility map."""

    problem: Problem[AtlasKeys]
    ground: GroundMap
    vehicle: Vehicle
    terrain: Bicubic
    model: Dae
    x: Array  # of the nodes of the result [m]
    y: Array
    heading: Array  # from the y axis [rad]
    inputs: Mapping[str, float]
    known: Mapping[str, Extremes]  # of large maps, by file

    @property
    def tiles(self) -> list[tuple[slice, slice]]:
        """Tiles of the map, in the order of the file."""
        return list(tiles_of(self.x.size, self.y.size))

    @property
    def elevation(self) -> Array | Elevation:
        """Heights of the nodes, shape (n_x, n_y) [m]."""
        grid, every = self.ground.grid, self.problem.spec.atlas.every
        return Elevation(grid, every) if isinstance(grid, Outline) else grid.z[::every, ::every]

    @property
    def site(self) -> Site:
        """Ground and conditions for the files of the map."""
        spec, source, facts = self.problem.spec, self.problem.source, dict(self.facts)
        settings = "\n".join(dict.fromkeys(source.settings.values()))
        words = {
            "title": spec.title or f"Mobility of {self.vehicle.name}",
            **({"problem": source.text} if source.text else {}),
            **({"settings": settings} if settings else {}),
            **{name.replace(" ", "_"): text for name, text in facts.items()},
        }
        friction = None if self.ground.mu is None else 1.0  # bounds on a map are relative to it
        if isinstance(self.ground.mu, float | int):  # at the wheel with the best grip
            friction = self.ground.mu * max(float(wheel.grip) for wheel in self.vehicle.wheels)
        return Site(
            self.elevation,
            friction,
            spec.atlas.within,
            spec.frame,
            self.ground.coordinates,
            self.ground.crs,
            words,
        )

    @property
    def facts(self) -> Lines:
        """Facts about ground, vehicle and size of the map: pairs of name and text."""
        n_x, n_y, count = self.x.size, self.y.size, self.heading.size
        headings = f"{count} heading{'s' * (count > 1)}"
        size = f"{n_x * n_y * count}: {n_x} x {n_y} nodes, {headings}"
        return [
            *ground_facts(self.ground),
            *vehicle_facts(self.vehicle, self.ground.crs),
            ("poses", size),
        ]

    @property
    def warnings(self) -> list[str]:
        """Warnings about bands that the map lacks, and about a map that is too small."""
        words = list[str]()
        if not self.vehicle.mass:
            words.append("the vehicle has no mass: the map has no bands of friction; give its mass")
        elif self.ground.mu is None and law_name(self.problem.spec) != "soil":
            words.append(
                "the ground has no coefficient of friction: the map has the least coefficient, but "
                "headings that slide are allowed; give one: friction in [terrain], or --friction"
            )
        size = extents(self.vehicle)[2]
        grid = self.ground.grid
        width = min(float(np.ptp(grid.x)), float(np.ptp(grid.y)))
        if width < 2 * size:
            words.append(
                f"the map is {width:.3g} m wide, and the vehicle reaches {size:.3g} m from its "
                "centre: wheels leave the map"
            )
        return words

    def labels(self, *, compiled: bool = True) -> dict[str, Label]:
        """Return the labels of the bands, in their order."""
        table, poses = self.problem.spec.atlas, self.poses(compiled=compiled)
        options = {"error": table.error, "guarantee": table.guarantee}
        return bands_of(poses, **options, is_moving=bool(self.inputs))

    def poses(self, *, compiled: bool = True) -> PoseEvaluator:
        """Return the evaluators of the poses."""
        table = self.problem.spec.atlas
        return pose_evaluator(
            self.model,
            with_corners=table.error is not None,
            compiled=compiled and table.compiled,
        )

    def bands(self, i: slice, j: slice) -> dict[str, Array]:
        """Return the bands at slices of the nodes, shape (n_headings, n_x, n_y)."""
        table, x, y = self.problem.spec.atlas, self.x[i], self.y[j]
        args = self.heading, self.inputs, table.error, table.tolerance, table.guarantee
        poses, ground = self.poses(), self.terrain
        if not isinstance(ground, PagedBicubic):
            return tile_of(poses, x, y, *args)
        shape = self.heading.size, x.size, y.size
        found: dict[str, Array] = {name: np.empty(shape, np.float32) for name in self.labels()}
        for a, b in parts_of(x.size, y.size, table.every):
            load_around(ground, x[a], y[b], self.vehicle)
            for name, values in tile_of(poses, x[a], y[b], *args).items():
                found[name][:, a, b] = values
        return found


def load_around(ground: PagedBicubic, x: Array, y: Array, vehicle: Vehicle) -> None:
    """Load the ground around places, with room for the search of poses."""
    reaches = (
        float(np.linalg.norm(shape.points, axis=1).max()) + shape.radius
        for _, shape in vehicle.shapes
    )
    bodies = max(reaches, default=0.0)
    room = ROOM * (extents(vehicle)[2] + bodies) + 8 * max(ground.grid.spacing)
    ground.load((x[0] - room, x[-1] + room, y[0] - room, y[-1] + room))


def build_atlas(problem: Problem[AtlasKeys], known: Mapping[str, Extremes] = EMPTY) -> AtlasSetup:
    """Return model, places and inputs of a mobility map; raise ProblemError if it is invalid.

    ``known`` are the extremes of large maps, by file; otherwise these are read once.
    """
    spec, table, extremes = problem.spec, problem.spec.atlas, dict(known)
    problem = replace(problem, extremes=extremes)
    generic: Problem[Any] = problem
    ground = build_ground(generic)
    vehicle = build_vehicle(problem)
    grid = ground.grid
    most = min(grid.x.size, grid.y.size) - 1
    if table.every > most:
        expected = f"at most {most}, for two nodes along each axis of the map"
        problem.refuse(Fault(("atlas", "every"), expected, f"{table.every}; reduce it"))
    origin = float(grid.x.mean()), float(grid.y.mean())
    terrain = Bicubic(grid, origin, ground.mu)
    if isinstance(grid, Outline):
        terrain = PagedBicubic(grid, origin, ground.mu)
        load_around(terrain, np.array([origin[0]]), np.array([origin[1]]), vehicle)
    model = build_model(generic, vehicle, terrain)
    rates = {f"{w.name}_rate": table.speed / w.radius for w in vehicle.wheels if w.driven}
    # without speed nothing moves, and without mass poses do not depend on the rates
    is_moving = bool(table.speed and vehicle.mass)
    inputs = {name: rates[name] for name in model.input_names if is_moving and name in rates}
    x, y = grid.x[:: table.every], grid.y[:: table.every]
    count = table.headings
    heading = heading_column(2 * np.pi * np.arange(count) / count, "paper", own=spec.frame).values
    setup = AtlasSetup(problem, ground, vehicle, terrain, model, x, y, heading, inputs, extremes)
    if table.within:
        bands = setup.labels(compiled=False)
        problem.refuse(*name_errors(("atlas", "within"), table.within, list(bands)))
    return setup
