"""Input files of a problem, their digests, and the inputs that a result file contains.

A result may come from somebody else, so that no vehicle file is read which its problem names, and
maps and meshes only if they are those with which it was computed.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from hashlib import file_digest
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict, ValidationError

from slipfree.core.errors import DataError, ModelError
from slipfree.files.urdf.links import Robot
from slipfree.files.urdf.meshes import find_mesh
from slipfree.files.vehicle_draft import vehicle_text
from slipfree.files.vehicle_toml import file_of, open_file, read_toml
from slipfree.problem.build_vehicle import VehicleFile, vehicle_file
from slipfree.problem.problem import Problem, shared
from slipfree.problem.schema import CommonKeys
from slipfree.system.regular_files import read_bytes, regular_file

TABLES = ("terrain", "vehicle", "driver", "path", "profile")  # tables with input files
DRAWN = ("terrain", "profile")  # tables of the ground
MISSING = "missing"
SIDES = (".prj", ".aux.xml", ".hdr", ".tfw", ".wld", ".ovr", ".msk")  # endings beside maps
URDF = (".urdf", ".xacro", ".xml")
# name in a package, as in package://NAME/meshes/a.stl and $(find NAME)/a.xacro, or a path
FILE_NAME = re.compile(
    r"""filename\s*=\s*["'](?:package://[^/"']*/|file://|[^"']*[)}]/)?([^"']+)"""
)
STORED = "stored_inputs"  # attribute of a result file


def input_names(spec: CommonKeys, tables: Sequence[str] = TABLES) -> tuple[str, ...]:
    """Return the file names in the keys ``file`` and ``friction`` of tables, as written there."""
    records = [getattr(spec, name, None) for name in tables]
    names: list[Any] = [getattr(table, "file", None) for table in records]
    names += [getattr(table, "friction", None) for table in records]
    if tables is TABLES:
        names += spec.named_files
    return tuple(name for name in names if isinstance(name, str))


def input_files(problem: Problem[Any]) -> dict[str, Path]:
    """Return the paths of all input files by name, including the URDF of a vehicle file."""
    names = list(input_names(problem.spec))
    for name in input_names(problem.spec, ["vehicle"]):
        names += _named_urdf(problem.folder, name)
    return {name: problem.folder / name for name in names}


def files_read(problem: Problem[Any]) -> list[Path]:
    """Return the paths of all files of a problem: its own, its inputs, and files that these name.

    Those are the side files of maps, such as ``.prj``, and includes and meshes of a URDF.
    """
    files = [problem.source.path]
    for path in input_files(problem).values():
        sides = [name + ending for name in (path.stem, path.name) for ending in SIDES]
        files += [path, *map(path.with_name, sides), *files_named_in(path)]
    return files


def files_named_in(urdf: Path) -> list[Path]:
    """Return the files that exist of those named in a URDF and in its includes."""
    files, waiting = list[Path](), [urdf] if urdf.suffix in URDF else []
    while waiting:
        file = waiting.pop()
        with suppress(DataError):  # build_vehicle reports errors in the file
            text = read_bytes(file, "a URDF").decode(errors="replace")
            tops = (file.parent, *file.absolute().parents[1:4])  # a package is above its folders
            places = [top / name for name in FILE_NAME.findall(text) for top in tops]
            new = [each for each in dict.fromkeys(places) if each.is_file() and each not in files]
            files += new
            waiting += [each for each in new if each.suffix in URDF]
    return files


def digest(file: Path) -> str:
    """Return the SHA-256 of a file; ``"missing"`` if it cannot be read."""
    try:
        # the file may exceed the memory; some files of /proc are endless, with a size of 0
        with regular_file(file, "an input file") as size, file.open("rb") as stream:
            return file_digest(stream if size else BytesIO(), "sha256").hexdigest()
    except DataError:
        return MISSING


class FileStates(NamedTuple):
    """Files of a computation in parts, as they were when it started."""

    digests: dict[str, str]  # SHA-256 by name
    stamps: dict[Path, tuple[int, int] | None]  # time of the last change, and size

    def check(self) -> None:
        """Raise DataError if a file has changed since, so that parts would not fit together."""
        for path, stamp in self.stamps.items():
            if _stamp(path) != stamp:
                raise DataError(
                    f"{path}: expected an input file that does not change during the computation, "
                    "found that it changed; repeat the command: finished parts are kept for the "
                    "earlier file"
                )


def file_states(files: Mapping[str, Path]) -> FileStates:
    """Return the states of files, by name."""
    stamps = {path: _stamp(path) for path in files.values()}
    return FileStates({name: digest(path) for name, path in sorted(files.items())}, stamps)


def _stamp(path: Path) -> tuple[int, int] | None:
    with suppress(OSError, ValueError):  # a missing file, a null character
        found = path.stat()
        return found.st_mtime_ns, found.st_size
    return None


def _named_urdf(folder: Path, name: str) -> list[str]:
    with suppress(DataError):  # build_vehicle reports errors in the file
        urdf = open_file(folder / name).data.get("urdf")
        if isinstance(urdf, str):
            return [str(Path(name).parent / urdf)]
    return []


class StoredVehicle(BaseModel):
    """Vehicle of a result."""

    model_config = ConfigDict(ser_json_inf_nan="constants")
    file: str  # its name in the problem
    text: str  # the vehicle as a vehicle file in TOML
    notes: tuple[str, ...]  # of the reader
    robot: Robot | None  # URDF, its file relative to the problem's folder
    meshes: dict[str, str]  # SHA-256 of the visible ones, by name


class StoredInputs(BaseModel):
    """Vehicle of a result, None if it is not from a file, and SHA-256 of maps by name."""

    model_config = ConfigDict(ser_json_inf_nan="constants")
    vehicle: StoredVehicle | None
    files: dict[str, str]


def stored_inputs(problem: Problem[Any]) -> str:
    """Return the attribute of a result with its vehicle and the digests of its maps."""
    names = input_names(problem.spec, DRAWN)
    file = _file(problem)
    key = (problem.folder, names, file, problem.trusted)
    return shared("stored", key, lambda: _stored(problem, names, file))


def _stored(problem: Problem[Any], names: tuple[str, ...], file: str | None) -> str:
    vehicle = None
    if file is not None:
        built, robot, _ = vehicle_file(file, problem)
        text, meshes = vehicle_text(built), _meshes(robot)
        if robot is not None:
            place = os.path.relpath(robot.tree.file, problem.folder)
            robot = robot._replace(tree=replace(robot.tree, file=place))
        vehicle = StoredVehicle(file=file, text=text, notes=built.notes, robot=robot, meshes=meshes)
    files = {name: digest(problem.folder / name) for name in names}
    return StoredInputs(vehicle=vehicle, files=files).model_dump_json()


def _file(problem: Problem[Any]) -> str | None:
    name: str | None = getattr(getattr(problem.spec, "vehicle", None), "file", None)
    return name


def _meshes(robot: Robot | None) -> dict[str, str]:
    """Return the SHA-256 of the visible meshes of a URDF by name; missing ones are omitted."""
    if robot is None:
        return {}
    folder, digests = Path(robot.tree.file).parent, dict[str, str]()
    for name in {mesh.name for link in robot.tree.links.values() for mesh in link.visuals}:
        with suppress(DataError):  # the vehicle is drawn with simple bodies
            digests[name] = digest(find_mesh(name, folder))
    return digests


def read_stored(file: Path, text: str | None, problem: Problem[Any]) -> StoredInputs:
    """Return the stored inputs in an attribute of the result ``file``, with its problem.

    DataError is raised if the attribute is missing although the problem names files, or is damaged.
    """
    names, vehicle = input_names(problem.spec, DRAWN), _file(problem)
    if text is None and not names and vehicle is None:
        return StoredInputs(vehicle=None, files={})
    try:
        inputs = StoredInputs.model_validate_json(text or "")
    except ValidationError as error:
        raise _incomplete(file) from error
    stored = None if inputs.vehicle is None else inputs.vehicle.file
    if stored != vehicle or not {*names} <= {*inputs.files}:
        raise _incomplete(file)
    return inputs


def restored_vehicle(file: Path, stored: StoredVehicle, folder: Path) -> VehicleFile:
    """Return the vehicle that the result ``file`` contains; meshes are searched in a folder."""
    try:
        draft = read_toml(file_of(file, stored.text))
        vehicle = replace(draft.vehicle(), notes=stored.notes)
    except (DataError, ModelError) as error:
        raise DataError(f"{file}: expected a valid stored vehicle, found: {error}") from error
    robot = stored.robot
    if robot is not None:
        if not _is_tree(robot):
            raise _incomplete(file)
        robot = robot._replace(tree=replace(robot.tree, file=str(folder / robot.tree.file)))
    return VehicleFile(vehicle, robot, stored.meshes)


def _is_tree(robot: Robot) -> bool:
    """Return whether the joints of a URDF connect its links, parents before children."""
    known = {robot.tree.root}
    for name, joint in robot.tree.joints.items():
        if name != joint.name or joint.parent not in known or joint.child in known:
            return False
        known.add(joint.child)
    return known == {*robot.tree.links}


def _incomplete(file: Path) -> DataError:
    return DataError(
        f"{file}: expected a result that contains its vehicle and digests of its maps, found one "
        "without them; run the problem again"
    )
