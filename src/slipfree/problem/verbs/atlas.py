"""Mobility maps: keys of their problems, their set-up, and their computation in tiles.

Processes compute tiles; each is stored in a folder as soon as it is finished, so that a killed
computation continues where it was, with equal files. Files are written tile by tile.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from slipfree.atlas import atlas
from slipfree.core.dae import Dae
from slipfree.core.errors import DataError
from slipfree.core.facts import Fact, Lines, as_attributes, lines, rows
from slipfree.core.records import Array, Label
from slipfree.core.trajectory import Frame, heading_column
from slipfree.files.atlas_files import EMPTY, Site, Tiles, write_atlas, write_geotiff
from slipfree.files.toml import Fault, Positive, Range, Record, name_errors
from slipfree.problem import schema
from slipfree.problem.build import World, build_model, build_vehicle, law_name
from slipfree.problem.build_ground import Extremes, build_ground
from slipfree.problem.inputs import (
    FileStates,
    ProblemParts,
    Recipe,
    file_states,
    files_read,
    recipe_of,
)
from slipfree.problem.problem import Problem
from slipfree.routing.traversability import extents
from slipfree.system.parts import PartsWatch, Workers, study
from slipfree.terrain.bicubic import Bicubic, Elevation, Outline, PagedBicubic, parts_of
from slipfree.vehicle.tree import Vehicle

if TYPE_CHECKING:
    from slipfree.show.atlas_figures import AtlasView

MAX_HEADINGS = 360
ROOM = 3.0  # width of the ground that is known around places [radius of the vehicle]
DRAWN = 1000  # largest number of nodes along an axis of a figure
WIDE = 0.01  # difference of bounds of the least friction that is reported [1]

ROWS = rows(
    f"""\
allowed poses: {{allowed_share:.3g>%}}
allowed headings: all at {{all_headings_share:.3g>%}} of the nodes, some at \
{{some_headings_share:.3g>%}}, none at {{no_headings_share:.3g>%}}
least friction best: {{least_friction_best_high_median:.3g}} (median of the nodes)
least friction worst: {{least_friction_worst_high_median:.3g}} (median of the nodes)
least utilisation best: {{least_utilisation_best_high_median:.3g}} (median of the nodes)
least utilisation worst: {{least_utilisation_worst_high_median:.3g}} (median of the nodes)
proved: bounds of {{proved_share:.3g>%}} of the poses that stand, for every ground near the map
!bounds of friction: wider than {WIDE:g} at {{loose_bounds_share:.3g>%}} of the poses"""
)


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

    headings: Annotated[int, Field(ge=1, le=MAX_HEADINGS)] = atlas.HEADINGS
    every: Annotated[int, Field(ge=1)] = 1
    error: Positive | None = None
    guarantee: Positive | None = None
    within: dict[str, Range] = Field(default={})
    speed: float = 0.0
    tolerance: Annotated[float, Field(gt=0, le=0.1)] = atlas.TOLERANCE
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
class AtlasSetup(World):
    """Model, places and inputs of a mobility map."""

    problem: Problem[AtlasKeys]
    model: Dae
    x: Array  # of the nodes of the result [m]
    y: Array
    heading: Array  # from the y axis [rad]
    inputs: Mapping[str, float]
    known: Mapping[str, Extremes]  # of large maps, by file

    @property
    def tiles(self) -> list[tuple[slice, slice]]:
        """Tiles of the map, in the order of the file."""
        return list(atlas.tiles_of(self.x.size, self.y.size))

    @property
    def elevation(self) -> Array | Elevation:
        """Heights of the nodes, shape (n_x, n_y), NaN in holes [m]."""
        grid, every = self.ground.grid, self.problem.spec.atlas.every
        if isinstance(grid, Outline):
            return Elevation(grid, every)
        z = grid.z if grid.holes is None else np.where(grid.holes, np.nan, grid.z)
        return z[::every, ::every]

    @property
    def site(self) -> Site:
        """Ground and conditions for the files of the map."""
        spec, source = self.problem.spec, self.problem.source
        settings = "\n".join(dict.fromkeys(source.settings.values()))
        words = {
            "title": spec.title or f"Mobility of {self.vehicle.name}",
            **({"problem": source.text} if source.text else {}),
            **({"settings": settings} if settings else {}),
            **as_attributes(self.facts),
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
        return [*super().facts, ("poses", size)]

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
        return atlas.bands_of(poses, **options, is_moving=bool(self.inputs))

    def poses(self, *, compiled: bool = True) -> atlas.PoseEvaluator:
        """Return the evaluators of the poses."""
        table = self.problem.spec.atlas
        return atlas.pose_evaluator(
            self.model, with_corners=table.error is not None, compiled=compiled and table.compiled
        )

    def bands(self, i: slice, j: slice) -> dict[str, Array]:
        """Return the bands at slices of the nodes, shape (n_headings, n_x, n_y)."""
        table, x, y = self.problem.spec.atlas, self.x[i], self.y[j]
        args = self.heading, self.inputs, table.error, table.tolerance, table.guarantee
        poses, ground = self.poses(), self.terrain
        if not isinstance(ground, PagedBicubic):
            return atlas.tile_of(poses, x, y, *args)
        shape = self.heading.size, x.size, y.size
        found: dict[str, Array] = {name: np.empty(shape, np.float32) for name in self.labels()}
        for a, b in parts_of(x.size, y.size, table.every):
            load_around(ground, x[a], y[b], self.vehicle)
            for name, values in atlas.tile_of(poses, x[a], y[b], *args).items():
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
    world = ground, terrain, vehicle, ()
    setup = AtlasSetup(*world, problem, model, x, y, heading, inputs, extremes)
    if table.within:
        bands = setup.labels(compiled=False)
        problem.refuse(*name_errors(("atlas", "within"), table.within, list(bands)))
    return setup


class TileTask(NamedTuple):
    """Set-up and number of a tile, for a process."""

    recipe: Recipe
    digests: tuple[tuple[str, str], ...]  # of all input files, by name
    known: tuple[tuple[str, Extremes], ...]  # of large maps, by file
    number: int  # from 1


def compute_tile(task: TileTask) -> Array:
    """Return the values of the bands in a tile, shape (n_bands, n_headings, n_x, n_y)."""
    return _tile(_setup(task._replace(number=0)), task.number)


@lru_cache(maxsize=1)  # a process computes many tiles
def _setup(task: TileTask) -> AtlasSetup:
    """Return the setup of an atlas in a worker; its input files must be those of the start."""
    problem = task.recipe.load()
    setup = build_atlas(problem, dict(task.known))
    if input_states(problem).digests != dict(task.digests):
        raise DataError(
            f"{task.recipe.path}: expected the input files with which the computation started, "
            "found others; copy them to all workers, and repeat the command"
        )
    return setup


def _tile(setup: AtlasSetup, number: int) -> Array:
    bands = setup.bands(*setup.tiles[number - 1])
    return np.stack([bands[name] for name in setup.labels()]).astype(np.float32)


def input_states(problem: Problem[Any]) -> FileStates:
    """Return the states of the input files of a mobility map."""
    files = (file for file in files_read(problem)[1:] if file.is_file())
    return file_states({os.path.relpath(file, problem.folder): file for file in files})


class TileFolder(ProblemParts[Array]):
    """Folder beside an output with the finished tiles of a mobility map; a context manager.

    ``states`` are those of the input files before the set-up was built.
    """

    def __init__(self, out: Path, setup: AtlasSetup, states: FileStates) -> None:
        count, problem = len(setup.tiles), setup.problem
        self._setup = setup
        # before the log is opened, which an error would leave open
        self._labels, self._reasons = setup.labels(), setup.poses().reasons
        super().__init__(out, "mobility map", count, problem, ".npy", states)

    def store(self, number: int, result: Array) -> None:
        """Store a tile; raise DataError if an input file has changed since the start."""
        self.add(number, {}, lambda part: np.save(part, result))

    def tiles(self) -> Tiles:
        """Yield the places and poses of all tiles."""
        setup = self._setup
        for number, (i, j) in enumerate(setup.tiles, 1):
            values = zip(self._labels.items(), np.load(self.file(number)), strict=True)
            bands = {name: atlas.Band(label, each) for (name, label), each in values}
            yield i, j, atlas.Atlas(setup.x[i], setup.y[j], setup.heading, bands, self._reasons)

    def whole(self) -> atlas.Atlas:
        """Return the poses of all tiles."""
        setup = self._setup
        shape = setup.heading.size, setup.x.size, setup.y.size
        bands = {
            name: atlas.Band(label, np.empty(shape, np.float32))
            for name, label in self._labels.items()
        }
        for i, j, tile in self.tiles():
            for name, band in bands.items():
                band.values[:, i, j] = tile[name]
        return atlas.Atlas(setup.x, setup.y, setup.heading, bands, self._reasons)


def run_tiles(setup: AtlasSetup, folder: TileFolder, workers: Workers, watch: PartsWatch) -> None:
    """Compute the missing tiles of a map, and store each as soon as it is finished.

    The other arguments are those of `study`.
    """
    digests, known = tuple(folder.states.digests.items()), tuple(setup.known.items())
    recipe = recipe_of(setup.problem)
    recipe = recipe._replace(path=recipe.path.absolute())
    # without a poll, Ctrl-C is not held back and ends a tile, which is stored as a whole or not
    with study(compute_tile, folder, workers, watch=PartsWatch(progress=watch.progress)) as solve:
        watch.progress(len(folder), folder.size)
        for number in folder.missing[:1]:  # here: it compiles the equations, and errors are raised
            folder.store(number, _tile(setup, number))
        for _ in solve(folder.missing, lambda number: TileTask(recipe, digests, known, number)):
            pass


def write_file(path: Path, setup: AtlasSetup, folder: TileFolder) -> None:
    """Write a map from its finished tiles: all poses to a file ending in ``.nc``, else a GeoTIFF.

    A netCDF file needs memory for all poses.
    """
    if path.suffix.lower() == ".nc":
        write_atlas(path, folder.whole(), setup.site)
    else:
        write_geotiff(path, setup.x, setup.y, setup.site, folder.tiles())


def overview(x: Array, y: Array, site: Site, tiles: Tiles) -> tuple[AtlasView, dict[str, Fact]]:
    """Return contents of the figures, and facts by name, of a map from its tiles."""
    from slipfree.show.atlas_figures import AtlasView, friction_maps

    step = max(1, -(-max(x.size, y.size) // DRAWN))
    shape = -(-x.size // step), -(-y.size // step)
    maps, reasons = dict[str, atlas.Band](), tuple[str, ...]()
    counts: Array = np.zeros(1)
    least, wide = np.zeros(3), 0  # nodes where all, some and no headings are allowed
    proved = np.zeros(2)  # poses with proved bounds, and those that stand
    for i, j, poses in tiles:
        drawn, found = site.summary_of(poses, i, j)
        reasons = found.reasons
        codes = np.bincount(found.codes.ravel(), minlength=len(reasons))
        counts = counts + codes  # all tiles have the same reasons
        share = found.allowed
        least += [(share == 1).sum(), ((share > 0) & (share < 1)).sum(), (share == 0).sum()]
        if (bounds := atlas.least_bounds(poses)) is not None:
            low, high = (poses[label.name] for label in bounds)
            wide += int((high - low > WIDE).sum())
        if atlas.PROVED.name in poses.bands:
            proved += [(poses[atlas.PROVED.name] == 1).sum(), poses.stands.sum()]
        a, b = (slice(-each.start % step, None, step) for each in (i, j))
        for name, (label, values) in drawn.items():
            if name not in maps:
                maps[name] = atlas.Band(label, np.full(shape, np.nan, dtype=np.float32))
            part = values[a, b]
            at = [-(-each.start // step) for each in (i, j)]
            maps[name].values[at[0] : at[0] + part.shape[0], at[1] : at[1] + part.shape[1]] = part
    view = AtlasView(x[::step], y[::step], maps, reasons, poses.heading.size, site)
    count = float(counts.sum())
    words = ("all headings are allowed", "some are", "none is")
    facts = {"allowed_share": Fact(counts[0] / count, "1", "share of the poses that are allowed")}
    for name, number, meaning in zip(("all", "some", "no"), least, words, strict=True):
        of_nodes = float(number / least.sum())
        facts[f"{name}_headings_share"] = Fact(of_nodes, "1", f"share of the nodes where {meaning}")
    if proved[1]:
        of_poses = float(proved[0] / proved[1])
        meaning = "share of the standing poses whose bounds are proved"
        facts["proved_share"] = Fact(of_poses, "1", meaning)
    friction = friction_maps(maps)
    for label, values in friction:
        known = values[np.isfinite(values)]
        if known.size:
            facts[f"{label.name}_median"] = Fact(float(np.median(known)), "1", label.words)
    if friction:
        meaning = f"poses whose bounds of the least friction differ by more than {WIDE:g}"
        facts["loose_bounds_share"] = Fact(wide / count, "1", f"share of the {meaning}")
    excluded = [
        {"reason": text, "share": float(number / count)}
        for text, number in zip(reasons, counts, strict=True)
        if number and text != reasons[0]
    ]
    facts["reasons"] = Fact(sorted(excluded, key=lambda row: -float(row["share"])))
    return view, facts


def summary_lines(facts: Mapping[str, Fact]) -> Lines:
    """Return the summary of a mobility map, pairs of name and text, which show its facts."""
    reasons = facts["reasons"].value
    excluded = [f"{100 * row['share']:.3g} %: {row['reason']}" for row in reasons]
    return [*lines(ROWS, facts), *(("  not allowed", words) for words in excluded)]
