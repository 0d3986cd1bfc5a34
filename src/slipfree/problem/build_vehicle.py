"""Vehicle of a problem, from its table [vehicle] or from a vehicle file."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from slipfree.errors import DataError, ModelError
from slipfree.files.toml.errors import Fault, name_errors
from slipfree.files.toml.source_lines import Place
from slipfree.files.toml.types import NonNegative, Positive, Record
from slipfree.files.urdf.links import Robot
from slipfree.files.urdf.reader import JointRole, Roles, WheelRole, read_urdf
from slipfree.files.urdf.tree import read_tree
from slipfree.files.vehicle_draft import Draft, Guess, UnfitError
from slipfree.files.vehicle_toml import (
    PARTS,
    File,
    Tables,
    VehicleError,
    meters,
    open_file,
    read_toml,
    validated,
)
from slipfree.problem import schema
from slipfree.problem.catalog_table import CATALOG
from slipfree.regular_files import read_bytes
from slipfree.vehicle.tree import Vehicle, actuated


class JointTable(Record):
    """Table of a joint in a file that completes a URDF: its kind, and keys of its coordinate."""

    kind: Literal["commanded", "passive", "suspension", "fixed"]
    words: str | None = None
    lower: float | None = None
    upper: float | None = None
    stiffness: NonNegative | None = None
    rest: float | None = None
    damping: NonNegative | None = None
    bump: NonNegative | None = None
    max_rate: Positive | None = None


class WheelTable(Record):
    """Table of a wheel in a file that completes a URDF: properties that URDF does not have."""

    driven: bool | None = None
    radius: Annotated[Positive, AfterValidator(meters)] | None = None
    tube: NonNegative | None = None
    grip: Positive = 1.0
    rollers: bool = False


def _expanded_kind(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


class UrdfTable(Record):
    """Vehicle file with the key ``urdf``, which completes a URDF."""

    urdf: Annotated[str, Field(min_length=1)]
    name: Annotated[str, Field(min_length=1)] | None = None
    tube: NonNegative = 0.0
    radius: Annotated[Positive, AfterValidator(meters)] | None = None
    forward: Literal["x", "-x", "y", "-y"] = "x"
    joints: dict[str, Annotated[JointTable, BeforeValidator(_expanded_kind)]] | None = None
    wheels: dict[str, WheelTable] | None = None


def build_vehicle(spec: schema.Vehicle, folder: Path) -> Vehicle:
    """Return the vehicle of a problem.

    Parameters
    ----------
    spec : Vehicle
        Table [vehicle] of the problem.
    folder : Path
        Folder to which file names are relative.

    Raises
    ------
    VehicleError
        If its file does not contain a valid vehicle.
    ModelError
        If a keyword of the catalogue is not allowed, or a joint has no free coordinate to actuate.
    """
    if spec.file is not None:
        return actuated(read_vehicle(folder / spec.file), *spec.actuated)
    return actuated(CATALOG[str(spec.catalog)](**spec.keywords), *spec.actuated)


def read_vehicle(path: str | Path) -> Vehicle:
    """Return the vehicle of a vehicle file, TOML or URDF.

    Raises
    ------
    VehicleError
        If the vehicle is invalid; it has all errors by file and line, and a draft of valid parts.
    DataError
        If the file name does not end in .toml or .urdf.
    """
    draft = _draft(Path(path))
    try:
        return draft.vehicle()
    except ModelError as error:
        raise VehicleError(f"{path}:1: {error}", draft=draft) from error


def read_robot(spec: schema.Vehicle, folder: Path) -> Robot | None:
    """Return the URDF of the vehicle of a problem; None if it has another source.

    Parameters and errors are those of `build_vehicle`.
    """
    if spec.file is None:
        return None
    path, forward = folder / spec.file, "x"
    if path.suffix.lower() == ".toml":
        file = open_file(path)
        if "urdf" not in file.data:
            return None
        table = _completion(file)
        path, forward = path.parent / table.urdf, table.forward
    return Robot(read_tree(read_bytes(path, "a URDF"), str(path)), forward)


def guessed_completion(path: Path, folder: Path) -> str:
    """Return the text of a vehicle file, to write in a folder, with all guesses about a URDF.

    Raises
    ------
    DataError
        If the file is not a URDF, or its vehicle is invalid.
    """
    if path.suffix.lower() != ".urdf":
        raise DataError(f"{path}: expected a URDF, whose guesses can be written; name a URDF")
    tables: dict[str, dict[str, Guess]] = {"wheels": {}, "joints": {}}
    for guess in _draft(path).guesses:
        known = tables[guess.table].get(guess.name)
        if known is not None:
            values, reason = {**known.values, **guess.values}, f"{known.reason}; {guess.reason}"
            guess = guess._replace(values=values, reason=reason)
        tables[guess.table][guess.name] = guess
    name = Path(os.path.relpath(path, folder)).as_posix()
    lines = [f"urdf = {json.dumps(name, ensure_ascii=False)}"]
    for table, found in tables.items():
        if found:
            lines += [
                "",
                f"[{table}]",
                *(f"{each.toml}  # {each.reason}" for each in found.values()),
            ]
    return "\n".join(lines) + "\n"


def is_vehicle_file(path: Path) -> bool:
    """Return whether a file is a vehicle file, not a problem file."""
    if path.suffix.lower() in (".urdf", ".xacro"):
        return True
    data = open_file(path).data
    return "verb" not in data and not {*PARTS, "urdf"}.isdisjoint(data)


def _draft(path: Path) -> Draft:
    ending = path.suffix.lower()
    if ending == ".toml":
        file = open_file(path)
        return _completed(file) if "urdf" in file.data else read_toml(file)
    if ending == ".urdf":
        return _urdf(path, Roles({}, {}))
    hint = "expand it first: xacro FILE > robot.urdf" if ending == ".xacro" else "check the name"
    raise DataError(
        f"{path}: expected a vehicle file that ends in .toml or .urdf, found "
        f"{repr(path.suffix) if path.suffix else 'no ending'}; {hint}"
    )


def _completion(file: File) -> UrdfTable:
    """Return the table of a vehicle file that completes a URDF."""
    tables: Tables = {"joints": lambda _: JointTable, "wheels": lambda _: WheelTable}
    table: UrdfTable = validated(UrdfTable, tables, file)
    return table


def _completed(file: File) -> Draft:
    """Return the draft of the vehicle in a URDF that a vehicle file completes."""
    table = _completion(file)
    joints = {
        name: JointRole(each.kind, each.model_dump(exclude_none=True, exclude={"kind"}))
        for name, each in (table.joints or {}).items()
    }
    given = table.wheels or {}
    wheels = {name: WheelRole(**each.model_dump()) for name, each in given.items()}
    path = file.source.path.parent / table.urdf
    draft = _urdf(path, Roles(joints, wheels, table.tube, table.radius, table.forward), file)
    return draft if table.name is None else replace(draft, name=table.name)


def _urdf(path: Path, roles: Roles, file: File | None = None) -> Draft:
    """Return the draft of the vehicle in a URDF.

    ``file`` is the vehicle file with the roles, if any; errors in the roles name this file.
    """
    by = f" (urdf of {file.source.path})" if file else ""
    try:
        data = read_bytes(path, f"a URDF{by}")
        tree = read_tree(data, str(path))
        if file is not None:
            _check(roles, list(tree.joints), file)
        return read_urdf(tree, roles)
    except UnfitError as error:
        raise VehicleError(*error.faults, draft=error.draft) from error
    except DataError as error:
        raise error if isinstance(error, VehicleError) else VehicleError(str(error)) from error
    except ModelError as error:
        raise VehicleError(f"{file.source.path if file else path}:1: {error}") from error


def _check(roles: Roles, known: list[str], file: File) -> None:
    """Raise VehicleError for joints that are not in the URDF, or that are also wheels."""
    faults: list[Fault] = []
    for table, given in (("joints", roles.joints), ("wheels", roles.wheels)):
        faults += name_errors((table,), given, known)
    for name in set(roles.joints) & set(roles.wheels):
        place: Place = ("joints", name)
        faults.append(
            Fault(place, "a joint that is not a wheel", "the same name in [wheels]; remove one")
        )
    if faults:
        raise file.error(faults)
