"""Vehicle of a problem, from its table [vehicle] or from a vehicle file."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from slipfree.errors import DataError, ModelError
from slipfree.files.toml.errors import Fault, name_errors
from slipfree.files.toml.source_lines import Place
from slipfree.files.toml.types import NonNegative, Positive, Record
from slipfree.files.urdf.elements import read_tree
from slipfree.files.urdf.expansion import expanded
from slipfree.files.urdf.guesses import forward_guess
from slipfree.files.urdf.links import Robot
from slipfree.files.urdf.reader import read_urdf
from slipfree.files.urdf.roles import NO_ROLES, JointRole, LinkRole, Roles, WheelRole, completed
from slipfree.files.urdf.tree import Tree
from slipfree.files.vehicle_draft import Draft, Guess, UnfitError
from slipfree.files.vehicle_toml import (
    PARTS,
    At,
    Axis,
    DriveTable,
    File,
    Inertia,
    Length,
    Tables,
    VehicleError,
    WheelInertia,
    open_file,
    read_toml,
    validated,
)
from slipfree.geometry.frame import unit_vector
from slipfree.problem import schema
from slipfree.problem.catalog_table import CATALOG
from slipfree.regular_files import read_bytes
from slipfree.vehicle.drives import RATE
from slipfree.vehicle.tree import Vehicle, actuated
from slipfree.vehicle.wheel import ORIGIN

ROBOTS = (".urdf", ".xacro")  # endings of robot descriptions


class JointTable(Record):
    """Table of a joint in a file that completes a URDF: its kind, and keys of its coordinate.

    A joint that is not in the URDF has the key ``carries``.
    """

    kind: Literal["commanded", "passive", "suspension", "fixed"]
    axis: Axis | None = None
    motion: Literal["turn", "slide"] | None = None
    carries: Annotated[tuple[str, ...], Field(strict=False)] = ()
    at: At = ORIGIN
    words: str | None = None
    lower: float | None = None
    upper: float | None = None
    stiffness: NonNegative | None = None
    rest: float | None = None
    damping: NonNegative | None = None
    bump: NonNegative | None = None
    max_rate: Positive | None = None
    drive: DriveTable = None


class WheelTable(Record):
    """Table of a wheel in a file that completes a URDF: added or overriding properties."""

    driven: bool | None = None
    radius: Length | None = None
    tube: NonNegative | None = None
    grip: Positive = 1.0
    rollers: bool = False
    mass: NonNegative | None = None
    inertia: WheelInertia | None = None
    static_depth: Length | None = None
    drive: DriveTable = RATE


class LinkTable(Record):
    """Table of a link in a file that completes a URDF: mass properties that override the URDF's."""

    mass: NonNegative | None = None
    center_of_mass: At | None = None
    inertia: Inertia | None = None


def _expanded_kind(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


class UrdfTable(Record):
    """Vehicle file with the key ``urdf``, which completes a URDF."""

    urdf: Annotated[str, Field(min_length=1)]
    arguments: dict[str, str] = Field(default_factory=dict)
    name: Annotated[str, Field(min_length=1)] | None = None
    tube: NonNegative = 0.0
    radius: Length | None = None
    forward: Literal["x", "-x", "y", "-y"] | None = None
    joints: dict[str, Annotated[JointTable, BeforeValidator(_expanded_kind)]] = Field(
        default_factory=dict
    )
    wheels: dict[str, WheelTable] = Field(default_factory=dict)
    links: dict[str, LinkTable] = Field(default_factory=dict)

    @property
    def roles(self) -> Roles:
        """Roles of the joints, wheels and links."""
        own = {"kind", "axis", "motion", "carries", "at"}  # no keys of the coordinate
        joints = {
            name: JointRole(
                each.kind,
                {key: value for key, value in each if key not in own and value is not None},
                None if each.axis is None else unit_vector(each.axis),
                each.motion,
                each.carries,
                each.at,
            )
            for name, each in self.joints.items()
        }
        wheels = {name: WheelRole(**dict(each)) for name, each in self.wheels.items()}
        links = {name: LinkRole(**dict(each)) for name, each in self.links.items()}
        return Roles(joints, wheels, links, self.tube, self.radius, self.forward)


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
    DataError
        If its file cannot be read, or its name does not end in .toml, .urdf or .xacro.
    ModelError
        If a keyword of the catalogue is not allowed, or a joint has no free coordinate to actuate.
    """
    if spec.file is not None:
        return actuated(read_vehicle(folder / spec.file), *spec.actuated)
    return actuated(CATALOG[str(spec.catalog)](**spec.keywords), *spec.actuated)


def read_vehicle(path: str | Path) -> Vehicle:
    """Return the vehicle of a vehicle file: TOML, URDF or xacro.

    Raises
    ------
    VehicleError
        If the vehicle is invalid. The exception lists all errors by file and line, and has a draft
        of the valid parts.
    DataError
        If the file cannot be read, or its name does not end in .toml, .urdf or .xacro.
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
    path, roles, arguments = folder / spec.file, NO_ROLES, {}
    if path.suffix.lower() == ".toml":
        file = open_file(path)
        if "urdf" not in file.data:
            return None
        table = _completion(file)
        path, roles, arguments = path.parent / table.urdf, table.roles, table.arguments
    tree = read_tree(*_urdf_text(path, arguments))
    return Robot(completed(tree, roles), roles.forward or forward_guess(tree, roles))


def guessed_completion(path: Path, folder: Path) -> str:
    """Return the text of a vehicle file, to write in a folder, with all guesses about a URDF.

    Raises
    ------
    DataError
        If the file is not a URDF, or its vehicle is invalid.
    """
    if path.suffix.lower() not in ROBOTS:
        raise DataError(
            f"{path}: expected a URDF or xacro file with --write, found another kind of file; "
            "name a URDF, or omit --write"
        )
    tables: dict[str, dict[str, Guess]] = {"": {}, "wheels": {}, "joints": {}}
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
                *([f"[{table}]"] if table else []),
                *(f"{each.toml}  # {each.reason}" for each in found.values()),
            ]
    return "\n".join(lines) + "\n"


def is_vehicle_file(path: Path) -> bool:
    """Return whether a file is a vehicle file, not a problem file."""
    if path.suffix.lower() in ROBOTS:
        return True
    data = open_file(path).data
    return "verb" not in data and not {*PARTS, "urdf"}.isdisjoint(data)


def _draft(path: Path) -> Draft:
    ending = path.suffix.lower()
    if ending == ".toml":
        file = open_file(path)
        return _completed(file) if "urdf" in file.data else read_toml(file)
    if ending in ROBOTS:
        return _urdf(path)
    raise DataError(
        f"{path}: expected a vehicle file that ends in .toml, .urdf or .xacro, found "
        f"{repr(path.suffix) if path.suffix else 'no ending'}; check the name"
    )


def _completion(file: File) -> UrdfTable:
    """Return the table of a vehicle file that completes a URDF."""
    tables: Tables = {
        "joints": lambda _: JointTable,
        "wheels": lambda _: WheelTable,
        "links": lambda _: LinkTable,
    }
    table: UrdfTable = validated(UrdfTable, tables, file)
    return table


def _completed(file: File) -> Draft:
    """Return the draft of the vehicle in a URDF that a vehicle file completes."""
    table = _completion(file)
    draft = _urdf(file.source.path.parent / table.urdf, (table, file))
    return draft if table.name is None else replace(draft, name=table.name)


def _urdf_text(path: Path, arguments: Mapping[str, str], by: str = "") -> tuple[bytes, str]:
    """Return the text of a URDF, expanded from xacro if necessary, and its name in messages.

    ``by`` names the file that contains the path, in messages.
    """
    if path.suffix.lower() == ".xacro":
        return expanded(path, arguments), f"{path} (expanded)"
    return read_bytes(path, f"a URDF{by}"), str(path)


def _urdf(path: Path, completion: tuple[UrdfTable, File] | None = None) -> Draft:
    """Return the draft of the vehicle in a URDF.

    ``completion`` is the vehicle file that completes it, if any, with its contents; errors in it
    name this file.
    """
    try:
        if completion is None:
            return read_urdf(read_tree(*_urdf_text(path, {})))
        table, file = completion
        by = f" (urdf of {file.source.path})"
        tree = read_tree(*_urdf_text(path, table.arguments, by))
        _check(table, tree, file)
        return read_urdf(tree, table.roles)
    except UnfitError as error:
        raise VehicleError(*error.faults, draft=error.draft) from error
    except DataError as error:
        raise error if isinstance(error, VehicleError) else VehicleError(str(error)) from error
    except ModelError as error:
        where = completion[1].source.path if completion else path
        raise VehicleError(f"{where}:1: {error}") from error


def _check(table: UrdfTable, tree: Tree, file: File) -> None:
    """Raise VehicleError for names that are not in the URDF, and for invalid new joints."""
    faults: list[Fault] = []
    new = {name for name, each in table.joints.items() if each.carries}
    faults += name_errors(("joints",), [n for n in table.joints if n not in new], [*tree.joints])
    faults += name_errors(("wheels",), table.wheels, [*tree.joints])
    faults += name_errors(("links",), table.links, [*tree.links])
    for name in set(table.joints) & set(table.wheels):
        place: Place = ("joints", name)
        faults.append(
            Fault(place, "a joint that is not a wheel", "the same name in [wheels]; remove one")
        )
    carried: list[str] = []
    for name in new:
        place, joint = ("joints", name), table.joints[name]
        faults += [Fault(place, *words) for words in _new_joint_errors(name, joint, tree, carried)]
        carried += joint.carries
    if faults:
        raise file.error(faults)


def _new_joint_errors(
    name: str, joint: JointTable, tree: Tree, carried: Sequence[str]
) -> Iterator[tuple[str, str]]:
    """Yield expected and found value for each error of a joint that is not in the URDF."""
    if name in tree.joints or name in tree.links:
        yield (
            "a new name for a joint with 'carries'",
            f"{name!r}, which is in the URDF; rename the joint, or remove 'carries'",
        )
    if joint.axis is None:
        yield "an axis of the new joint", "none; add 'axis', such as [0, 1, 0] to the left"
    unknown = [each for each in joint.carries if each not in tree.joints]
    if unknown:
        yield (
            f"joints of the URDF in 'carries' ({', '.join(tree.joints)})",
            f"{', '.join(map(repr, unknown))}; correct the names",
        )
        return
    parents = {tree.joints[each].parent for each in joint.carries}
    if len(parents) > 1:
        yield (
            "joints with the same parent link in 'carries'",
            f"the parent links {', '.join(sorted(parents))}; add a new joint for each link",
        )
    if twice := [each for each in joint.carries if each in carried]:
        yield (
            "joints that no other new joint carries",
            f"{', '.join(twice)} in several; keep each joint in one 'carries'",
        )
