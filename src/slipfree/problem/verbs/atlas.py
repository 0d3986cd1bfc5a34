"""Mobility maps: keys of their problems, and their set-up."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from slipfree.atlas.atlas import (
    HEADINGS,
    TOLERANCE,
    PoseEvaluator,
    bands_of,
    pose_evaluator,
    tiles_of,
)
from slipfree.core.dae import Dae
from slipfree.core.records import Array, Label, leaves
from slipfree.core.trajectory import OFFSET, Frame
from slipfree.files.atlas_files import Site
from slipfree.files.toml.source import Fault, name_errors, problem_error
from slipfree.files.toml.source import Place as KeyPath
from slipfree.files.toml.types import Positive, Range, Record
from slipfree.problem.build import build_model, build_vehicle, law_name, vehicle_facts
from slipfree.problem.build_ground import GroundMap, at, build_ground, ground_facts
from slipfree.problem.problem import Problem
from slipfree.problem.schema import (
    VERB,
    CommonKeys,
    LawKeys,
    TerrainKeys,
    TerrainTable,
    VehicleSource,
)
from slipfree.problem.verbs.base import Lines, Verb
from slipfree.routing.traversability import extents
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.tree import Vehicle

MAX_HEADINGS = 360


class AtlasTable(Record):
    """Headings, nodes and quantities of a mobility map."""

    headings: Annotated[int, Field(ge=1, le=MAX_HEADINGS)] = Field(
        default=HEADINGS, description="number of equally spaced headings"
    )
    every: Annotated[int, Field(ge=1)] = Field(
        default=1, description="distance between nodes of the result, in nodes of the map"
    )
    error: Positive | None = Field(
        default=None,
        description="standard deviation and largest magnitude of errors of the heights, for the "
        "resulting errors of roll, pitch, tip-over margin and clearance of bodies [m]",
    )
    within: dict[str, Range] = Field(
        default={},
        description="bounds of quantities by name: headings at which one is outside are not "
        "allowed [rad, m, 1]",
    )
    speed: float = Field(
        default=0.0,
        description="speed that the driven wheels would have without slip, for the work of the "
        "drives per metre; on soil, the poses are those at this speed [m/s]",
    )
    tolerance: Annotated[float, Field(gt=0, le=0.1)] = Field(
        default=TOLERANCE,
        description="width of the bounds of the least coefficient of friction [1]",
    )
    compiled: bool = Field(
        default=True,
        description="whether to compile the equations; the first compilation for a vehicle takes "
        "up to a minute, its result is cached",
    )


class AtlasKeys(LawKeys, CommonKeys):
    """Mobility map: where and how a vehicle stands at the nodes of a map, for several headings."""

    verb: Literal["atlas"] = Field(description=VERB)
    frame: Frame = Field(
        default="paper", description="axis from which headings are measured: y, or x (REP 103)"
    )
    terrain: TerrainTable = Field(description="the ground")
    vehicle: VehicleSource = Field(description="the vehicle")
    atlas: AtlasTable = Field(default=AtlasTable(), description="headings, nodes and quantities")

    alternatives: ClassVar[Mapping[KeyPath, tuple[str, ...]]] = TerrainKeys.alternatives

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


class AtlasVerb(Verb):
    """Where and how a vehicle stands on a map."""

    schema = AtlasKeys
    commands = ("atlas", "check")


@dataclass(frozen=True, eq=False)
class AtlasSetup:
    """Model, places and inputs of a mobility map."""

    problem: Problem[AtlasKeys]
    ground: GroundMap
    vehicle: Vehicle
    model: Dae
    x: Array  # of the nodes of the result [m]
    y: Array
    heading: Array  # from the y axis [rad]
    inputs: Mapping[str, float]

    @property
    def tiles(self) -> list[tuple[slice, slice]]:
        """Tiles of the map, in the order of the file."""
        return list(tiles_of(self.x.size, self.y.size))

    @property
    def elevation(self) -> Array:
        """Heights of the nodes [m]."""
        every = self.problem.spec.atlas.every
        return self.ground.grid.z[::every, ::every]

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
        return Site(
            self.elevation,
            self._friction,
            spec.atlas.within,
            spec.frame,
            self.ground.coordinates,
            self.ground.crs,
            words,
        )

    @property
    def _friction(self) -> float | None:
        """Coefficient that must hold the vehicle: that of the wheel with the best grip; or 1."""
        mu = self.ground.mu
        if mu is None or isinstance(mu, Grid):  # bounds on a map are relative to the coefficient
            return None if mu is None else 1.0
        return float(mu) * max(float(wheel.grip) for wheel in self.vehicle.wheels)

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
        error, is_moving = self.problem.spec.atlas.error, bool(self.inputs)
        return bands_of(self.poses(compiled=compiled), error=error, is_moving=is_moving)

    def poses(self, *, compiled: bool = True) -> PoseEvaluator:
        """Return the evaluators of the poses."""
        table = self.problem.spec.atlas
        with_errors, compiled = table.error is not None, compiled and table.compiled
        return pose_evaluator(self.model, with_errors=with_errors, compiled=compiled)


def build_atlas(problem: Problem[AtlasKeys]) -> AtlasSetup:
    """Return model, places and inputs of a mobility map; raise ProblemError if it is invalid."""
    spec, table = problem.spec, problem.spec.atlas
    generic: Problem[Any] = problem
    ground = build_ground(generic)
    with at(problem, ("vehicle",)):
        vehicle = build_vehicle(spec.vehicle, problem)
    grid = ground.grid
    most = min(grid.x.size, grid.y.size) - 1
    if table.every > most:
        expected = f"at most {most}, for two nodes along each axis of the map"
        fault = Fault(("atlas", "every"), expected, f"{table.every}; reduce it")
        raise problem_error(problem.source, [fault])
    origin = float(grid.x.mean()), float(grid.y.mean())
    model = build_model(generic, vehicle, Bicubic(grid, origin, ground.mu))
    known = [label.full for label in leaves(model.labels.u)]
    rates = {f"{w.name}_rate": table.speed / w.radius for w in vehicle.wheels if w.driven}
    # without speed nothing moves, and without mass poses do not depend on the rates
    is_moving = bool(table.speed and vehicle.mass)
    inputs = {name: rates[name] for name in known if is_moving and name in rates}
    x, y = grid.x[:: table.every], grid.y[:: table.every]
    count = table.headings
    heading = 2 * np.pi * np.arange(count) / count - OFFSET[spec.frame]
    setup = AtlasSetup(problem, ground, vehicle, model, x, y, heading, inputs)
    if table.within:
        bands = setup.labels(compiled=False)
        if faults := [*name_errors(("atlas", "within"), table.within, list(bands))]:
            raise problem_error(problem.source, faults)
    return setup
