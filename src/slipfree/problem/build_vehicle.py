"""Vehicle of a problem, from its table [vehicle] or from a vehicle file."""

from __future__ import annotations

import json
import os
import re
import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from slipfree.contact.closure import check_couplings
from slipfree.core.arguments import checked
from slipfree.core.errors import DataError, ModelError
from slipfree.files.toml import Fault, Place, name_errors
from slipfree.files.urdf import xacro
from slipfree.files.urdf.elements import read_tree
from slipfree.files.urdf.links import Robot
from slipfree.files.urdf.meshes import MeshFiles, solids
from slipfree.files.urdf.reader import forward_guess, read_urdf
from slipfree.files.urdf.tree import NO_ROLES, Tree, UrdfTable, completed
from slipfree.files.urdf.xml import check_ending, is_description, parse_robot
from slipfree.files.vehicle_toml import (
    PARTS,
    Draft,
    File,
    Guess,
    VehicleError,
    couple_errors,
    open_file,
    read_toml,
    validated,
)
from slipfree.problem import schema
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem, shared
from slipfree.problem.schema import CATALOG
from slipfree.show.meshes import joined, shape_mesh
from slipfree.system.regular_files import read_bytes, regular_file
from slipfree.vehicle.sections import TriangleMesh
from slipfree.vehicle.tree import Vehicle, actuated, in_gravity

# values of arguments of xacro that cannot contain programs or names of files in other folders
HARMLESS = re.compile(r"[\w .,+-]*", re.ASCII)

TABLES = "", "wheels", "joints"  # of guesses, in the order of a file


class VehicleFile(NamedTuple):
    """Contents of a vehicle file: the vehicle, and the URDF from which it was read, if any."""

    vehicle: Vehicle
    robot: Robot | None
    visuals: Mapping[str, TriangleMesh] | None = None  # of links, by name; None: not read yet


def build_vehicle(
    problem: Problem[Any], spec: schema.VehicleSource | None = None, place: Place = ("vehicle",)
) -> Vehicle:
    """Return the vehicle of a problem, or of its table ``spec`` at ``place``, in its gravity.

    VehicleError is raised if its file does not contain a valid vehicle; ProblemError if its file
    cannot be read, is not a vehicle file, or is xacro that is not trusted, if a keyword of the
    catalogue is not allowed, a joint has no free coordinate to actuate, or the gravity is not
    valid.
    """
    spec = spec or problem.spec.vehicle
    with at(problem, place):
        vehicle = actuated(vehicle_file(spec, problem).vehicle, *spec.actuated)
    with at(problem, ("gravity",)):
        return in_gravity(vehicle, problem.spec.gravity)


def vehicle_file(spec: schema.VehicleSource, problem: Problem[Any]) -> VehicleFile:
    """Return the contents of a vehicle file of a problem, which is read once."""
    name = spec.file
    if name is None:
        return VehicleFile(CATALOG[str(spec.catalog)](**spec.keywords), None)
    if name not in problem.vehicles:
        path, trusted = problem.folder / name, problem.trusted
        problem.vehicles[name] = shared(
            "vehicle", (path, trusted), lambda: read_vehicle_file(path, trusted)
        )
    contents: VehicleFile = problem.vehicles[name]
    return contents


def visual_meshes(contents: VehicleFile) -> Mapping[str, TriangleMesh]:
    """Return meshes of the visual shapes of a URDF by link, those that can be read."""
    _, robot, visuals = contents
    if robot is None or visuals is not None:
        return visuals or {}
    links, visuals = robot.tree.links.values(), dict[str, TriangleMesh]()
    folder = Path(robot.tree.file).parent
    files = MeshFiles((each for link in links for each in link.visuals), folder)
    for link in links:
        with suppress(DataError):  # the vehicle is then drawn with simple bodies
            if link.visuals:
                drawn = (solid for each in link.visuals for solid in solids(each, files))
                meshes = (s if isinstance(s, TriangleMesh) else shape_mesh(s) for s in drawn)
                visuals[link.name] = joined(*meshes)
    return visuals


@checked
def read_vehicle(
    path: str | Path, *, trust: Sequence[str | os.PathLike[str]] | bool = ()
) -> Vehicle:
    """Return the vehicle of a vehicle file: TOML, URDF or xacro.

    Parameters
    ----------
    path : str or Path
        The file.
    trust : sequence of path, or bool
        Xacro files that may be expanded; True for ``path`` itself. Xacro is a program: expand only
        files that you would execute.

    Raises
    ------
    VehicleError
        If the vehicle is invalid. The exception lists all errors by file and line, and has a draft
        of the valid parts.
    DataError
        If the file cannot be read, is not a vehicle file, or is xacro that is not trusted.
    """
    files = ([path] if trust else []) if isinstance(trust, bool) else trust
    return read_vehicle_file(Path(path), xacro.trusted_paths(files)).vehicle


def read_vehicle_file(path: Path, trusted: frozenset[str]) -> VehicleFile:
    """Return the contents of a vehicle file; errors as in `read_vehicle`."""
    draft, robot = _draft(path, trusted)
    try:
        vehicle = draft.vehicle()
        check_couplings(vehicle)
        return VehicleFile(vehicle, robot)
    except ModelError as error:
        raise VehicleError(f"{path}:1: {error}", draft=draft) from error


def guessed_completion(path: Path, folder: Path, trust: Sequence[Path] = ()) -> str:
    """Return the text of a vehicle file, to write in a folder, with all guesses about a URDF.

    ``trust`` are xacro files that may be expanded. DataError is raised if the file is not a URDF,
    or its vehicle is invalid.
    """
    if not is_description(path):
        raise DataError(
            f"{path}: expected a URDF or xacro file with --write, found another kind of file; "
            "name a URDF, or omit --write"
        )
    guesses = dict[tuple[str, str], Guess]()
    for guess in _draft(path, xacro.trusted_paths(trust))[0].guesses:
        known, reason = guesses.get(guess[:2]), guess.reason
        reason += f"; otherwise {guess.other}" if guess.other else ""
        if known is not None:
            guess = guess._replace(values={**known.values, **guess.values})
            reason = f"{known.reason}; {reason}"
        guesses[guess[:2]] = guess._replace(reason=reason)
    name = Path(os.path.relpath(path, folder)).as_posix()
    lines = [f"urdf = {json.dumps(name, ensure_ascii=False)}"]
    ordered = sorted(guesses.values(), key=lambda guess: TABLES.index(guess.table))
    lines += [f"{guess.toml}  # {guess.reason}" for guess in ordered]
    return "\n".join(lines) + "\n"


def is_vehicle_file(path: Path) -> bool:
    """Return whether a file is a vehicle file, not a problem file."""
    if is_description(path):
        return True
    data = open_file(path).data
    return "verb" not in data and not {*PARTS, "urdf"}.isdisjoint(data)


def _draft(path: Path, trusted: frozenset[str]) -> tuple[Draft, Robot | None]:
    """Return the draft of a vehicle, and the URDF from which it was read, if any."""
    if is_description(path):
        return _urdf(path, trusted)
    if path.suffix.lower() == ".toml":
        file = open_file(path)
        if "urdf" not in file.data:
            return read_toml(file), None
        table: UrdfTable = validated(UrdfTable, file)  # it completes a URDF
        draft, robot = _urdf(path.parent / table.urdf, trusted, (table, file))
        return draft if table.name is None else replace(draft, name=table.name), robot
    raise DataError(
        f"{path}: expected a vehicle file that ends in .toml, .urdf or .xacro, found "
        f"{repr(path.suffix) if path.suffix else 'no ending'}; check the name"
    )


def _tree(path: Path, trusted: frozenset[str], table: UrdfTable | None, file: File | None) -> Tree:
    """Return the links and joints of a URDF, or of a xacro file, expanded if it is trusted."""
    by = "" if file is None else f" (urdf of {file.source.path})"
    with regular_file(path, f"a URDF{by}") as size:
        if size > xacro.MAX_BYTES:
            raise DataError(
                f"{path}: expected a URDF of at most {xacro.MAX_BYTES / 1e6:g} MB, found "
                f"{size / 1e6:.3g} MB; check the name of the file"
            )
        data = read_bytes(path, f"a URDF{by}")
    check_ending(data, path)
    arguments = {} if table is None else table.arguments
    if not xacro.is_trusted(path, trusted):
        return read_tree(data, str(path), arguments)
    xacro.check_macro_calls(parse_robot(data, str(path)), str(path))
    if file is not None and not xacro.is_trusted(file.source.path, trusted):
        # others could contain programs or names of files
        name = shlex.quote(str(file.source.path))
        expected = (
            "letters, digits, blanks and . , + - _, since xacro executes arguments as a part "
        )
        expected += "of its program"
        found = f"other characters; change it, or trust this file, too: --trust {name}"
        wrong = [key for key, value in arguments.items() if not HARMLESS.fullmatch(value)]
        if wrong:
            raise file.error([Fault(("arguments", key), expected, found) for key in wrong])
    expansion, macros = xacro.expanded(path, arguments)
    return read_tree(expansion, f"{path} (expanded)", macros=macros)


def _urdf(
    path: Path, trusted: frozenset[str], completion: tuple[UrdfTable, File] | None = None
) -> tuple[Draft, Robot | None]:
    """Return the draft of the vehicle in a URDF, and the URDF."""
    table, file = completion or (None, None)
    try:
        tree, roles = _tree(path, trusted, table, file), NO_ROLES
        if table is not None and file is not None:
            _check(table, tree, file)
            roles = table
        draft = read_urdf(tree, roles)
        whole = completed(tree, roles)
        forward = roles.forward or forward_guess(whole, roles.joints).choice
        return draft, Robot(whole, forward)
    except DataError as error:
        raise error if isinstance(error, VehicleError) else VehicleError(str(error)) from error
    except ModelError as error:
        where = file.source.path if file else path
        raise VehicleError(f"{where}:1: {error}") from error


def _check(table: UrdfTable, tree: Tree, file: File) -> None:
    """Raise VehicleError for names that are not in the URDF, and for invalid new joints."""
    faults: list[Fault] = []
    new = [name for name, each in table.joints.items() if each.carries]
    faults += name_errors(("joints",), [n for n in table.joints if n not in new], [*tree.joints])
    faults += name_errors(("wheels",), table.wheels, [*tree.joints])
    faults += name_errors(("links",), table.links, [*tree.links])
    faults += couple_errors(table.couple, [*tree.joints])
    for index, name in enumerate(table.couple):
        role, known = table.joints.get(name), tree.joints.get(name)
        if role is None and known is not None and not known.moves:
            expected = "a joint that moves, or one with a kind in 'joints'"
            faults.append(
                Fault(("couple", name), expected, "a joint of type 'fixed'; add its kind")
            )
        if index == 0:
            continue
        keys = set() if role is None else {*role.keywords} | ({"motion"} if role.motion else set())
        if keys:
            expected = "the keys of the common coordinate at the first of the coupled joints"
            found = ", ".join(sorted(keys))
            faults.append(Fault(("joints", name), expected, f"{found}; move them"))
    for name in set(table.joints) & set(table.wheels):
        place: Place = ("joints", name)
        faults.append(
            Fault(place, "a joint that is not a wheel", "the same name in [wheels]; remove one")
        )
    carried: list[str] = []
    for name in new:
        joint, wrong = table.joints[name], list[tuple[str, str]]()
        if name in tree.joints or name in tree.links:
            found = f"{name!r}, which is in the URDF; rename the joint, or remove 'carries'"
            wrong.append(("a new name for a joint with 'carries'", found))
        if joint.axis is None:
            found = "none; add 'axis', such as [0, 1, 0] to the left"
            wrong.append(("an axis of the new joint", found))
        there = [each for each in joint.carries if each in tree.joints]
        if unknown := [each for each in joint.carries if each not in there]:
            expected = f"joints of the URDF in 'carries' ({', '.join(tree.joints)})"
            wrong.append((expected, f"{', '.join(map(repr, unknown))}; correct the names"))
        elif len(parents := {tree.joints[each].parent for each in there}) > 1:
            found = f"the parent links {', '.join(sorted(parents))}; add a new joint for each link"
            wrong.append(("joints with the same parent link in 'carries'", found))
        if (twice := [each for each in there if each in carried]) and not unknown:
            found = f"{', '.join(twice)} in several; keep each joint in one 'carries'"
            wrong.append(("joints that no other new joint carries", found))
        faults += [Fault(("joints", name), *words) for words in wrong]
        carried += joint.carries
    if faults:
        raise file.error(faults)
