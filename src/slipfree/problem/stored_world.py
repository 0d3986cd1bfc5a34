"""Ground and vehicle in a result file, which needs no other file.

The ground is that of the motion, with its friction. A map with more than `MAX_NODES` nodes is cut
to the surroundings of the motion; the spline through the rest is the same, since the influence of
a node decreases to a quarter from one node to the next. A vehicle from the catalogue is named in
the problem. Any other is stored as a vehicle file, with the meshes of its links, which are
simplified if they have more than `MAX_FACES` faces.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from slipfree.core.errors import DataError, ModelError
from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.files.netcdf import MapCoordinate
from slipfree.files.urdf.links import Robot
from slipfree.files.vehicle_toml import file_of, read_toml, vehicle_text
from slipfree.geometry.mesh import TriangleMesh
from slipfree.problem.build import World
from slipfree.problem.build_ground import GroundMap, ground_table
from slipfree.problem.build_vehicle import VehicleFile, vehicle_file, visual_meshes
from slipfree.problem.problem import Problem, shared
from slipfree.routing.traversability import extents
from slipfree.show.meshes import reduced
from slipfree.terrain.base import Grid
from slipfree.terrain.grid_ops import cut

STORED = "stored_world"  # attribute of a result file
MAX_NODES = 2**18  # of a map that is stored whole, with 2 MB
MAX_FACES = 100_000  # of all links of a vehicle, with 2 MB
MARGIN, NEXT, CELLS = 1.0, 6.0, 32  # of a cut map [extent of the motion, reach of the vehicle, 1]
GROUND, FRICTION = "ground", "friction"  # beginnings of the names of arrays
MASKS = "filled", "holes"
Grounds = dict[str, tuple[float | str | None, GroundMap]]  # as in `Problem`


class StoredVehicle(BaseModel):
    """Vehicle of a result from a file, without the meshes of its links."""

    model_config = ConfigDict(ser_json_inf_nan="constants")
    file: str  # its name in the problem
    text: str  # the vehicle as a vehicle file in TOML
    notes: tuple[str, ...]  # of the reader
    robot: Robot | None


class StoredWorld(BaseModel):
    """Ground and vehicle of a result without arrays; None for a vehicle of the catalogue."""

    model_config = ConfigDict(ser_json_inf_nan="constants")
    ground: str  # keys on which the heights depend, as JSON
    friction: float | str | None  # value of the key
    coordinates: tuple[MapCoordinate, ...]  # as in `GroundMap`
    crs: str
    vehicle: StoredVehicle | None


def store_world(
    problem: Problem[Any], world: World, run: Trajectory, further: Mapping[str, Array]
) -> tuple[str, dict[str, Array]]:
    """Return the attribute and the arrays with which a result keeps ground and vehicle.

    Maps are cut to the surroundings of the motion and of the positions in ``further`` arrays.
    """
    spec, ground, vehicle = problem.spec, world.ground, None
    reach = extents(world.vehicle)[2]
    arrays = _arrays(GROUND, ground.grid, reach, run, further)
    if isinstance(ground.mu, Grid):
        arrays |= _arrays(FRICTION, ground.mu, reach, run, further)
    if (name := spec.vehicle.file) is not None:
        contents = vehicle_file(spec.vehicle, problem)
        key = problem.folder / name, problem.trusted
        visuals = shared("visuals", key, lambda: reduced(visual_meshes(contents), MAX_FACES))
        built, robot, _ = problem.vehicles[name] = contents._replace(visuals=visuals)
        if robot is not None:
            robot = robot._replace(tree=replace(robot.tree, file=Path(robot.tree.file).name))
            for k, link in enumerate(robot.tree.links):
                if link in visuals:
                    arrays[f"link{k}_vertices"] = visuals[link].vertices.astype("f4")
                    arrays[f"link{k}_faces"] = visuals[link].faces.astype(float)
        text = vehicle_text(built)
        vehicle = StoredVehicle(file=name, text=text, notes=built.notes, robot=robot)
    stored = StoredWorld(
        ground=ground_table(spec.terrain),
        friction=spec.terrain.friction,
        coordinates=ground.coordinates,
        crs=ground.crs,
        vehicle=vehicle,
    )
    return stored.model_dump_json(), arrays


def _arrays(
    name: str, grid: Grid, reach: float, run: Trajectory, further: Mapping[str, Array]
) -> dict[str, Array]:
    """Return the arrays of a map by name, cut to the surroundings of motion, guess and routes."""
    if grid.z.size > MAX_NODES:
        window = list[float]()
        places = [
            np.concatenate([run[axis], run[f"contact_{axis}"].ravel(), *others])
            for axis in "xy"
            for others in [[v for k, v in further.items() if k.endswith(f"_{axis}")]]
        ]
        extent = max(float(np.nanmax(each) - np.nanmin(each)) for each in places)
        for each, cell in zip(places, grid.spacing, strict=True):
            away = MARGIN * extent + NEXT * reach + CELLS * cell
            window += [float(np.nanmin(each)) - away, float(np.nanmax(each)) + away]
        grid = cut(grid, (window[0], window[1], window[2], window[3]))
    fields = {key: getattr(grid, key) for key in ("x", "y", "z", *MASKS)}
    return {f"{name}_{k}": v.astype(float) for k, v in fields.items() if v is not None}


def read_world(
    file: Path, run: Trajectory, arrays: Mapping[str, Array]
) -> tuple[Grounds, dict[str, VehicleFile]]:
    """Return ground and vehicle of the result ``file``; raise DataError if they are damaged."""
    try:
        stored = StoredWorld.model_validate_json(run.attributes.get(STORED, ""))
        vehicle, vehicles = stored.vehicle, dict[str, VehicleFile]()
        friction = stored.friction
        mu = _grid(FRICTION, arrays) if isinstance(friction, str) else friction
        words = "" if friction is None else str(friction)
        place = stored.coordinates, stored.crs
        ground = GroundMap(_grid(GROUND, arrays), str(file), None, mu, words, [], *place)
        if vehicle is not None:
            built = replace(read_toml(file_of(file, vehicle.text)).vehicle(), notes=vehicle.notes)
            visuals = {} if vehicle.robot is None else _visuals(vehicle.robot, arrays)
            vehicles[vehicle.file] = VehicleFile(built, vehicle.robot, visuals)
    except (ValidationError, KeyError, DataError, ModelError) as error:
        found = f"others ({str(error).splitlines()[0]}); run the problem again"
        if STORED not in run.attributes or isinstance(error, KeyError):
            found = "none; run the problem again, and write the arrays of the result as well"
        raise DataError(
            f"{file}: expected a result with its ground and vehicle as slipfree run stores them, "
            f"found {found}"
        ) from error
    return {stored.ground: (friction, ground)}, vehicles


def _grid(name: str, arrays: Mapping[str, Array]) -> Grid:
    x, y, z = (arrays[f"{name}_{key}"] for key in "xyz")
    filled, holes = (arrays.get(f"{name}_{key}") for key in MASKS)
    return Grid(x, y, z, *(None if mask is None else mask != 0 for mask in (filled, holes)))


def _visuals(robot: Robot, arrays: Mapping[str, Array]) -> dict[str, TriangleMesh]:
    """Return the meshes of the links of a URDF, by name, and check its tree."""
    known, visuals = {robot.tree.root}, dict[str, TriangleMesh]()
    for name, joint in robot.tree.joints.items():
        if name != joint.name or joint.parent not in known or joint.child in known:
            raise DataError(f"the joint {name!r} in a loop, or before its parent")
        known.add(joint.child)
    if known != {*robot.tree.links}:
        raise DataError("links without a joint")
    for k, link in enumerate(robot.tree.links):
        if f"link{k}_vertices" in arrays:
            vertices, faces = (arrays[f"link{k}_{each}"] for each in ("vertices", "faces"))
            shapes = vertices.shape[1:], faces.shape[1:]
            if shapes != ((3,), (3,)) or not 0 <= faces.min() <= faces.max() < len(vertices):
                raise DataError(f"an invalid mesh of the link {link!r}")
            visuals[link] = TriangleMesh(vertices, faces.astype(np.uint32))
    return visuals
