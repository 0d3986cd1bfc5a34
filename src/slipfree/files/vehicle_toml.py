"""Vehicle files in TOML: drafts of vehicles, decoding in two passes, and text.

Single values are checked first, then the parts together.
"""

from __future__ import annotations

import json
import keyword
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import combinations, starmap
from math import degrees, isfinite
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeVar, cast

import numpy as np
import tomlkit
from pydantic import AfterValidator, ConfigDict, Field, PlainValidator, ValidationError

from slipfree.core.arguments import WithUnit, degrees_question
from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.files import toml
from slipfree.geometry.frame import ORIGIN, Vector, in_axes, unit_vector
from slipfree.vehicle import tree
from slipfree.vehicle.formula import CONSTANTS, FUNCTIONS, names_in
from slipfree.vehicle.sections import SECTIONS, Omni, Section, section_of_radii
from slipfree.vehicle.shapes import SHAPES, Hull
from slipfree.vehicle.tree import DRIVES, RATE, Drive, Wheel

RESERVED_NAMES = ("x", "y", "z", "heading", "roll", "pitch")  # states of the platform
MAX_RADIUS = 3.0  # of a wheel over the sum of the distances of wheels and joints from parents [1]
LARGE, AIR = 0.5, 1.2  # radius above those of most robots [m], and density [kg/m^3]
SAME_PLACE = 0.01  # smallest distance of two wheels [radii]
MAX_WHEEL_MASS = 4e5  # of a radius of 1 m: four balls of osmium, the densest material [kg]
MAX_LENGTH = 100.0  # largest length in a vehicle [m]
# rotation from axes x forward, y left (rep103) to axes x right, y forward
REP103_TO_PAPER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
Value = float | bool | str | Mapping[str, Any]  # of a key in a vehicle file
PARTS = ("coordinates", "joints", "wheels")
FRAMES = "'paper' (x right, y forward, z up) or 'rep103' (x forward, y left, z up)"
SIDEWAYS = {"paper": (1.0, 0.0, 0.0), "rep103": (0.0, -1.0, 0.0)}
ADD = '{{ name = "{}", kind = "passive" }} to "coordinates"'  # a coordinate with a name
T = TypeVar("T")


class Guess(NamedTuple):
    """A guess of a property that a file does not contain; a vehicle file can override it."""

    table: str  # ``"wheels"`` or ``"joints"`` of the vehicle file, empty for its top level
    name: str  # of the joint, or of the top-level key
    values: Mapping[str, Value]  # guessed values by key
    reason: str  # guessed property, and the reason for the guessed values
    other: str  # line of the vehicle file, at its top level, for the other choice; empty if none

    @property
    def toml(self) -> str:
        """Line with the guessed values, to insert at the top level."""
        if self.table:
            return toml_line(self.table, self.name, **self.values)
        return ", ".join(f"{key} = {toml_value(value)}" for key, value in self.values.items())


def toml_key(name: str) -> str:
    """Return a name as a key of TOML, quoted if necessary."""
    return name if re.fullmatch(r"[\w-]+", name, re.ASCII) else json.dumps(name)


def toml_value(value: Value) -> str:
    """Return a value as TOML."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        pairs = ", ".join(f"{toml_key(key)} = {toml_value(each)}" for key, each in value.items())
        return f"{{ {pairs} }}"
    return f'"{value}"' if isinstance(value, str) else repr(value)


def toml_line(table: str, name: str, **values: Value) -> str:
    """Return a line at the top level of a vehicle file that states keys of a joint in a table."""
    return f"{table}.{toml_key(name)} = {toml_value(values)}"


@dataclass(frozen=True)
class Draft(tree.VehicleParts):
    """Parts of a vehicle read from a file, not yet validated as a vehicle."""

    guesses: tuple[Guess, ...] = ()  # guesses that the reader made

    def vehicle(self) -> tree.Vehicle:
        """Return the vehicle; raise ModelError if the parts do not form one."""
        return tree.Vehicle(*(getattr(self, part.name) for part in fields(tree.VehicleParts)))


class VehicleError(toml.ProblemError):
    """Error in a vehicle file, with one message per error.

    ``draft`` has the valid parts of the vehicle; None if single values are invalid.
    """

    def __init__(self, *faults: str, draft: Draft | None = None) -> None:
        super().__init__(*faults)
        self.draft = draft


def misfits(draft: Draft, few: str = "add wheels") -> Iterator[tuple[str, str]]:
    """Yield expected and found numbers of wheels, their masses and suspension coordinates.

    ``few`` is what to do about too few wheels.
    With springs at all suspension coordinates, any number of them is valid, since the springs
    determine the pose of the vehicle.
    """
    places = [joint.at for joint in draft.joints] + [wheel.at for wheel in draft.wheels]
    reach = sum(math.hypot(*place) for place in places)
    for wheel in draft.wheels:
        if len(draft.wheels) > 2 and wheel.radius > (largest := MAX_RADIUS * reach):
            expected = (
                f"a radius of wheel {wheel.name} in m that suits its place, at most {largest:.3g}"
            )
            yield expected, f"{wheel.radius:g} (did you mean millimetres or centimetres?)"
        if wheel.mass > (most := MAX_WHEEL_MASS * wheel.radius**3):
            expected = f"a mass of wheel {wheel.name} in kg, at most {most:.3g} for its radius"
            yield expected, f"{wheel.mass:g} (did you mean grams? write {wheel.mass / 1000:g})"
    mass = sum(body.mass for body in (draft.body, *(joint.body for joint in draft.joints)))
    mass += sum(wheel.mass for wheel in draft.wheels)
    least = AIR * sum(wheel.radius**3 for wheel in draft.wheels)  # about the volume of the wheels
    if 0 < mass < least and any(wheel.radius > LARGE for wheel in draft.wheels):
        expected = f"wheels of a vehicle heavier than air, of more than {least:.3g} kg"
        yield expected, f"{mass:.3g} kg; write lengths in metres and masses in kilograms"
    for one, other in combinations(draft.wheels, 2):
        near = SAME_PLACE * min(one.radius, other.radius)
        if one.parent == other.parent and math.dist(one.at, other.at) < near:
            yield "wheels at different places", f"{one.name} and {other.name} at one; correct them"
    count, names = len(draft.wheels), [c.name for c in draft.of("suspension")]
    if draft.planar:
        return
    if count < 3:
        yield "at least three wheels, so that the vehicle can stand", f"{count}; {few}"
        return
    if all(c.stiffness for c in draft.of("suspension")):
        return
    free = count - 3
    if (more := len(names) - free) > 0:
        remove, whose, stiffen = f"{more} of them", f"the kind of {more} of them", "each"
        if len(names) == 1:
            remove, whose, stiffen = "it", "its kind", "it"
        yield (
            f"at most {free} suspension coordinate{'s' * (free != 1)} for {count} wheels, one for "
            "each wheel beyond three",
            f"{len(names)} ({', '.join(names)}); remove {remove}, set {whose} to 'passive' or "
            f"'commanded', add {more} wheel{'s' * (more > 1)}, or give {stiffen} a stiffness",
        )


def is_symbol(name: str) -> bool:
    """Return whether a name is valid for a coordinate: an identifier that is not reserved."""
    used = (
        name in FUNCTIONS or name in CONSTANTS or name in RESERVED_NAMES or keyword.iskeyword(name)
    )
    return name.isidentifier() and not used


def length_words(value: float) -> str:
    """Return the expected value, in words, for a length that exceeds 100 m in absolute value."""
    limit = f"at most {MAX_LENGTH:g}" if value > 0 else f"at least {-MAX_LENGTH:g}"
    return f"metres, {limit} (did you mean millimetres? write {value / 1000:g})"


def degrees_words(angle: float) -> str:
    """Return a hint for an angle beyond a full turn, which may be degrees; empty for others."""
    return degrees_question(angle, f"{math.radians(angle):.6g}")


def in_order(parents: Mapping[str, str], root: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of a tree, parents first, and the names not connected to the root."""
    done, left = {root}, list(parents)
    ordered: list[str] = []
    while ready := [name for name in left if parents[name] in done]:
        ordered += ready
        done |= set(ready)
        left = [name for name in left if name not in done]
    return tuple(ordered), tuple(left)


def from_rep103(draft: Draft) -> Draft:
    """Return a draft converted from axes x forward, y left to axes x right, y forward."""
    return replace(
        draft,
        joints=tuple(
            replace(
                joint,
                axis=to_paper_axes(unit_vector(joint.axis)),
                at=to_paper_axes(joint.at),
                turned=angles_of(REP103_TO_PAPER @ rotation_of(joint.turned) @ REP103_TO_PAPER.T)
                if any(joint.turned[:2])  # else a turn about z, the same in both axes
                else joint.turned,
                body=_turned_body(joint.body),
            )
            for joint in draft.joints
        ),
        wheels=tuple(
            replace(wheel, at=to_paper_axes(wheel.at), axle=to_paper_axes(unit_vector(wheel.axle)))
            for wheel in draft.wheels
        ),
        body=_turned_body(draft.body),
    )


def to_paper_axes(vector: Vector) -> Vector:
    """Return a vector converted from axes x forward, y left to axes x right, y forward."""
    forward, left, up = vector
    return 0.0 - left, forward, up


def _turned_body(body: tree.Body) -> tree.Body:
    """Return a body converted from axes x forward, y left to axes x right, y forward."""
    inertia = None if body.inertia is None else in_axes(REP103_TO_PAPER, body.inertia)
    # a box keeps its own axes: x forward, y left
    shapes = tuple(placed(shape, REP103_TO_PAPER, np.zeros(3)) for shape in body.shapes)
    return tree.Body(body.mass, to_paper_axes(body.at), inertia, shapes)


def placed(shape: T, rotation: Array, origin: Array) -> T:
    """Return a shape or a mesh in another frame, in which its frame has a rotation and an origin.

    Parameters
    ----------
    shape : Box, Ball or Hull, or a shape or a mesh of a URDF
        A record with ``points`` or with ``at`` [m], and with ``turned`` unless it is round.
    rotation : array, shape (3, 3)
        Axes of the frame of the shape, in columns.
    origin : array, shape (3,)
        Origin of this frame. [m]
    """
    record, changes = cast("Any", shape), dict[str, Any]()
    if isinstance(shape, Hull):
        changes["points"] = tuple(vector_of(rotation @ point + origin) for point in shape.points)
    else:
        changes["at"] = vector_of(rotation @ record.at + origin)
    if hasattr(record, "turned"):
        changes["turned"] = angles_of(rotation @ rotation_of(record.turned))
    made: T = record._replace(**changes) if isinstance(shape, tuple) else replace(record, **changes)
    return made


def angles_of(rotation: Array) -> Vector:
    """Return the angles about fixed x, then y, then z of a rotation matrix, shape (3, 3) [rad]."""
    z = math.atan2(rotation[1, 0], rotation[0, 0])
    y = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    sin, cos = math.sin(z), math.cos(z)
    x = math.atan2(
        sin * rotation[0, 2] - cos * rotation[1, 2], cos * rotation[1, 1] - sin * rotation[0, 1]
    )
    return x, y, z


def vector_of(array: Array) -> Vector:
    """Return an array of shape (3,) as a tuple of floats."""
    x, y, z = array.tolist()
    return x, y, z


def rotation_of(turned: Vector) -> Array:
    """Return the rotation matrix, shape (3, 3), of angles about fixed x, then y, then z [rad]."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(turned), np.cos(turned)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def vehicle_text(vehicle: tree.Vehicle, comments: Sequence[str] = ()) -> str:
    """Return the text of a vehicle file, without the vehicle's notes and with leading comments."""
    document = tomlkit.document()
    for line in comments:
        document.add(tomlkit.comment(line))
    document.update({"name": vehicle.name, "frame": "paper", **_mass_keys(vehicle.body)})
    if vehicle.planar:
        document.add("planar", True)
    tables = {
        "coordinates": [
            {**_given(c, "drive"), **_drive_keys(c.drive)} for c in vehicle.coordinates
        ],
        "joints": [{**_given(joint, "body"), **_mass_keys(joint.body)} for joint in vehicle.joints],
        "wheels": [_wheel_keys(wheel) for wheel in vehicle.wheels],
    }
    document.update({name: rows for name, rows in tables.items() if rows})
    return tomlkit.dumps(document)


def _mass_keys(body: tree.Body) -> dict[str, Any]:
    """Return the keys of mass, centre of mass, inertia and shapes that differ from defaults."""
    kinds = {kind: name for name, kind in SHAPES.items()}
    shapes = [{"kind": kinds[type(shape)], **_given(shape)} for shape in body.shapes]
    values = {"mass": body.mass, "center_of_mass": body.at, "inertia": body.inertia}
    keys = {key: value for key, value in values.items() if value not in (0.0, ORIGIN, None)}
    return keys | ({"shapes": shapes} if shapes else {})


def _given(record: Any, *left_out: str) -> dict[str, Any]:
    """Return the fields of a record that differ from their defaults, and finite numbers only."""
    values = {field: getattr(record, field.name) for field in fields(record)}
    return {
        field.name: _with_unit(value)
        for field, value in values.items()
        if field.name not in left_out
        and value != field.default
        and not (isinstance(value, float) and not isfinite(value))
    }


def _with_unit(value: Any) -> Any:
    """Return a value with the unit that it had; without it, a large angle would be refused."""
    if isinstance(value, tuple):
        return tuple(map(_with_unit, value))
    if not isinstance(value, WithUnit):
        return value
    return f"{float(value)!r} {value.unit.replace(' s-1', '/s')}"


def _drive_keys(drive: Drive) -> dict[str, Any]:
    if drive == RATE:
        return {}
    kind = next(name for name, each in DRIVES.items() if isinstance(drive, each))
    return {"drive": {"kind": kind, **_given(drive)}}


def angle_text(angle: float) -> str:
    """Return an angle [rad] as text in degrees, or in radians if degrees would not be exact."""
    text = f"{degrees(angle):g} deg"
    return text if toml.parse_unit(text) == angle else f"{float(angle)!r} rad"


def _wheel_keys(wheel: Wheel) -> dict[str, Any]:
    """Return the table of a wheel, with its shape in the keys that give it without rounding."""
    section = wheel.section
    rollers = {"rollers": angle_text(section.angle)} if isinstance(section, Omni) else {}
    section = section.rim if isinstance(section, Omni) else section
    tube, outer = section.torus_radii or (0.0, 0.0)
    if outer and (tube + outer) - tube == outer:  # exact in the reader
        shape: dict[str, Any] = {"radius": tube + outer, "tube": tube}
    else:
        kind = next((name for name, each in SECTIONS.items() if type(section) is each), None)
        if kind is None:
            raise ModelError(
                f"wheel {wheel.name!r}: expected a section with a name in vehicle files, "
                f"{', '.join(SECTIONS)}, found {section}; use one of these"
            )
        shape = {"section": kind, **{f.name: getattr(section, f.name) for f in fields(section)}}
    return {**_given(wheel, "section", "drive"), **shape, **rollers, **_drive_keys(wheel.drive)}


def _meters(value: float) -> float:
    if abs(value) > MAX_LENGTH:
        raise toml.expected_error(length_words(value))
    return value


def _all(check: Callable[[float], float]) -> AfterValidator:
    return AfterValidator(lambda vector: tuple(map(check, vector)))


def _axis(value: Any) -> str | Vector:
    """Return an axis: the name of a coordinate axis, or a vector."""
    if isinstance(value, str) and value in ("x", "y", "z"):
        return value
    if isinstance(value, list) and len(value) == 3 and all(map(toml.is_number, value)):
        x, y, z = map(float, value)
        if max(map(abs, value)) < MAX_LENGTH and math.hypot(x, y, z) > 0:
            return x, y, z
    raise toml.expected_error(
        "'x', 'y', 'z' or a vector [x, y, z] other than zero, with absolute values below "
        f"{MAX_LENGTH:g}"
    )


def _rollers(value: Any) -> float | bool:
    """Return the angle of rollers [rad], or False for a wheel without rollers."""
    if value is False:
        return False
    angle = toml.parse_unit(value)
    is_bare = isinstance(angle, int | float) and not isinstance(angle, bool | WithUnit)
    is_angle = is_bare or isinstance(angle, toml.AngleWithUnit)
    if is_angle and 0 < abs(toml.in_radians(angle)) <= math.pi / 2:
        return float(angle)
    raise toml.expected_error(
        "the angle from the wheel's axle to the axles of its rollers, not zero and at most 90 "
        'degrees, such as "90 deg" for an omni wheel or a ball, "45 deg" or "-45 deg" for a '
        "mecanum wheel; or false for a wheel without rollers"
    )


class KindTable(toml.Record):
    """Table with a key ``kind``, on which its other keys depend."""

    tables: ClassVar[Mapping[str, type[toml.Record]]]  # records with the keys of each kind
    kind: str

    @classmethod
    def schema_for(cls, data: Any) -> type[toml.Record]:
        """Return the record with the keys of the kind."""
        if "tables" not in vars(cls):  # a record of one kind
            return cls
        kind = data.get("kind") if isinstance(data, dict) else None
        if not isinstance(kind, str) or kind not in cls.tables:
            words = ", ".join(map(repr, cls.tables))
            raise toml.expected_error(f"a table whose 'kind' is one of {words}")
        return cls.tables[kind]


class DriveKind(KindTable):
    """Table of a drive."""


_drives: Mapping[str, Any] = DRIVES
DriveKind.tables = {kind: toml.record_of(drive, DriveKind) for kind, drive in _drives.items()}


def _drive(data: Any) -> Drive:
    parameters = toml.given_values(DriveKind.model_validate(data))
    return DRIVES[parameters.pop("kind")](**parameters)


Axis = Annotated[Any, PlainValidator(_axis)]
Rollers = Annotated[Any, PlainValidator(_rollers)]
At = Annotated[toml.Point, _all(_meters)]
Turned = Annotated[
    tuple[toml.Angle, toml.Angle, toml.Angle], Field(strict=False), _all(toml.in_radians)
]
Name = Annotated[str, Field(min_length=1)]
Inertia = Annotated[tuple[float, float, float, float, float, float], Field(strict=False)]
WheelInertia = Annotated[tuple[toml.Positive, toml.Positive], Field(strict=False)]
Length = Annotated[toml.Positive, AfterValidator(_meters)]
DriveTable: Any = Annotated[DriveKind | Any, PlainValidator(_drive)]


class AnyShapeTable(KindTable):
    """Table of a shape of a body."""


class BoxTable(AnyShapeTable):
    """Table of a box: edges, centre, and orientation in the part's frame."""

    size: Annotated[tuple[Length, Length, Length], Field(strict=False)]
    at: At = ORIGIN
    turned: Turned = ORIGIN


class BallTable(AnyShapeTable):
    """Table of a ball: radius, and centre in the part's frame."""

    radius: Length
    at: At = ORIGIN


class HullTable(AnyShapeTable):
    """Table of a convex hull: its points in the part's frame."""

    points: Annotated[tuple[At, ...], Field(strict=False, min_length=1)]


AnyShapeTable.tables = {"box": BoxTable, "ball": BallTable, "hull": HullTable}
Shapes = Annotated[tuple[AnyShapeTable, ...], Field(strict=False)]


class CoordinateKeys(toml.Record):
    """Table of a coordinate: an angle or length that determines the motion of joints."""

    name: Name
    kind: tree.Kind
    words: str | None = None
    drive: DriveTable = RATE


CoordinateTable: Any = toml.record_of(
    tree.Coordinate, CoordinateKeys, meaning=CoordinateKeys.__doc__ or ""
)


class JointTable(toml.Record):
    """Table of a joint: a part that rotates about an axis of its parent or slides along it."""

    name: Name
    parent: Name
    axis: Axis
    value: str
    at: At = ORIGIN
    motion: Literal["turn", "slide"] = "turn"
    turned: Turned = ORIGIN
    mass: toml.NonNegative = 0.0
    center_of_mass: At = ORIGIN
    inertia: Inertia | None = None
    shapes: Shapes = ()


class AnyWheelTable(toml.Record):
    """Table of a wheel: the keys that do not depend on its section."""

    name: Name
    parent: Name
    section: str | None = None
    at: At = ORIGIN
    driven: bool = False
    rollers: Rollers = False
    axle: Axis | None = None
    grip: toml.Positive = 1.0
    mass: toml.NonNegative = 0.0
    static_depth: Length | None = None
    inertia: WheelInertia | None = None
    drive: DriveTable = RATE

    @classmethod
    def schema_for(cls, data: Any) -> type[toml.Record]:
        """Return the record with the dimensions of the section."""
        if cls is not AnyWheelTable:
            return cls
        if not isinstance(data, dict) or "section" not in data:
            return WheelTable
        name = data["section"]
        section = SECTIONS.get(name) if isinstance(name, str) else None
        schema: type[toml.Record] = toml.record_of(section, cls) if section else UnknownSectionTable
        return schema


class WheelTable(AnyWheelTable):
    """Table of a wheel without the key ``section``: a torus, disc or sphere."""

    radius: Length
    tube: toml.NonNegative = 0.0


class UnknownSectionTable(AnyWheelTable):
    """Table of a wheel with an unknown section; further keys are not checked."""

    model_config = ConfigDict(extra="ignore")
    section: Literal[tuple(SECTIONS)]  # type: ignore[valid-type]


class VehicleTable(toml.Record):
    """Contents of a vehicle file."""

    name: Name
    frame: Literal["paper", "rep103"]
    mass: toml.NonNegative = 0.0
    center_of_mass: At = ORIGIN
    inertia: Inertia | None = None
    shapes: Shapes = ()
    couple: dict[str, float] = Field(default_factory=dict)
    planar: bool = False
    coordinates: Annotated[tuple[CoordinateTable, ...], Field(strict=False)] = ()
    joints: Annotated[tuple[JointTable, ...], Field(strict=False)] = ()
    wheels: Annotated[tuple[AnyWheelTable, ...], Field(strict=False)]


class File(NamedTuple):
    """Contents of a vehicle file: text with line numbers, and values."""

    source: toml.Source
    data: dict[str, Any]

    def error(self, faults: list[toml.Fault], draft: Draft | None = None) -> VehicleError:
        """Return an exception with the messages of all errors, in the order of their lines."""

        def who(place: toml.Place) -> str:  # name of the element, as in " (joint 'boom')"
            if len(place) < 2 or not isinstance(place[1], int):
                return ""
            elements = self.data.get(str(place[0]))
            is_there = isinstance(elements, list) and place[1] < len(elements)
            element: Any = elements[place[1]] if elements and is_there else None
            name = element.get("name") if isinstance(element, dict) else None
            return f" ({str(place[0])[:-1]} {name!r})" if name else ""

        ordered = sorted(faults, key=lambda fault: self.source.order(fault.place))
        lines = (f"{self.source.where(f.place)}{who(f.place)}: {f.message}" for f in ordered)
        return VehicleError(*lines, draft=draft)


def open_file(path: Path) -> File:
    """Return the contents of a TOML file; raise ProblemError if it cannot be read."""
    return file_of(path, toml.read_text(path, "a vehicle file"))


@lru_cache(maxsize=4)  # a command asks several times for the file of its vehicle
def file_of(path: Path, text: str) -> File:
    """Return the contents of a text, with ``path`` as its file; errors as in `open_file`."""
    data = toml.parse_toml(path, text)
    return File(toml.Source(path, text, toml.key_lines(text)), data)


def validated(model: type[toml.Record], file: File) -> Any:
    """Return the contents of a file as a record of type ``model``, or raise VehicleError."""
    try:
        table = model.model_validate(file.data)
    except ValidationError as error:
        faults = list[toml.Fault]()
        words = {"frame": FRAMES, "parent": tree.PARENT, "wheels": "at least three wheels"}
        for each in error.errors(include_url=False):
            place = tuple(each["loc"])
            if each["type"] == "missing" and isinstance(place[-1], str):
                faults.append(toml.Fault(place, words.get(place[-1], "a value"), "none"))
            else:
                faults.append(toml.validation_fault(model, file.data, dict(each)))
        raise file.error(faults) from error
    if faults := [*toml.value_errors(file.data)]:
        raise file.error(faults)
    return table


def read_toml(file: File) -> Draft:
    """Return the draft of a vehicle in a TOML file; a VehicleError has all messages and a draft."""
    table: VehicleTable = validated(VehicleTable, file)
    faults = [
        *starmap(toml.Fault, tree.part_faults(table.coordinates, table.joints, table.wheels, ADD)),
        *_part_errors(table),
        *couple_errors(table.couple, [joint.name for joint in table.joints]),
    ]
    faults += [] if faults else _differential_errors(table)
    parts, wrong = _build_draft(table)
    if table.couple and not faults:
        (first, ahead), (second, behind) = table.couple.items()
        values = {joint.name: joint.value for joint in parts.joints}
        factor = -ahead / behind
        value = f"-{values[first]}" if factor == -1 else f"{factor!r}*{values[first]}"
        joints = (replace(j, value=value) if j.name == second else j for j in parts.joints)
        free = tuple(c for c in parts.coordinates if c.name != values[second])
        parts = replace(parts, joints=tuple(joints), coordinates=free)
    draft = parts if table.frame == "paper" else from_rep103(parts)
    faults += wrong
    if len(draft.wheels) == len(table.wheels):
        part = "coordinates" if table.coordinates and len(table.wheels) > 2 else "wheels"
        for expected, found in misfits(draft):
            place = "wheels" if re.match(".* of wheel |wheels ", expected) else part
            faults.append(toml.Fault((place,), expected, found))
    if faults:
        raise file.error(faults, draft)
    return draft


def couple_errors(couple: Mapping[str, float], known: Sequence[str]) -> Iterator[toml.Fault]:
    """Yield the errors in the key ``couple``, whose names must be among ``known``."""
    if couple and (len(couple) != 2 or not all(couple.values())):
        found = ", ".join(f"{name} = {value:g}" for name, value in couple.items())
        expected = "two joints with coefficients other than zero, as in { left = 1, right = 1 }"
        yield toml.Fault(("couple",), expected, f"{found}; correct it")
    yield from toml.name_errors(("couple",), couple, known)


def _differential_errors(table: VehicleTable) -> Iterator[toml.Fault]:
    """Yield an error for each coupled joint that has no coordinate of its own."""
    values = {joint.name: joint.value for joint in table.joints}
    coordinates = {c.name: c for c in table.coordinates}
    uses = [name for joint in table.joints for name in _names_in(joint.value)]
    for name in table.couple:
        if values[name] not in coordinates or uses.count(values[name]) > 1:
            expected = "a joint whose value is a coordinate that no other joint uses"
            yield toml.Fault(
                ("couple", name), expected, f"value = {values[name]!r}; correct the value"
            )
    for name in [*table.couple][1:]:
        c = coordinates.get(values[name])
        if c is not None and c.model_fields_set - {"name", "kind", "words"}:
            keys = ", ".join(sorted(c.model_fields_set - {"name", "kind", "words"}))
            expected = "the keys of the common coordinate in that of the first joint"
            found = f"{keys} in {c.name!r}; move them to {values[next(iter(table.couple))]!r}"
            yield toml.Fault(("couple", name), expected, found)


def _part_errors(table: VehicleTable) -> Iterator[toml.Fault]:
    """Yield errors in names, limits of coordinates and their units, parents, sizes of wheels."""
    slides = {
        name for joint in table.joints if joint.motion == "slide" for name in _names_in(joint.value)
    }
    for index, c in enumerate(table.coordinates):
        if not is_symbol(c.name):
            expected = "a name of letters, digits and _ that does not begin with a digit"
            if c.name.isidentifier():
                expected = "a name other than those of functions, constants, states of the "
                expected += "platform and Python keywords"
            yield toml.Fault(("coordinates", index, "name"), expected, f"{c.name!r}; rename it")
        values = toml.given_values(c)
        for key in (each for each in ("lower", "upper", "rest") if each in values):
            value = values[key]
            if c.name in slides and abs(value) > MAX_LENGTH:
                yield toml.Fault(("coordinates", index, key), length_words(value), f"{value:g}")
            elif c.name not in slides and (expected := toml.bare_words(value)):
                yield toml.Fault(("coordinates", index, key), expected, f"{value:g}")
        unit = "m" if c.name in slides else "rad"
        units = dict.fromkeys(("lower", "upper", "rest"), unit) | {"max_rate": f"{unit} s-1"}
        yield from toml.unit_faults(("coordinates", index), values, units)
    parents = {joint.name: joint.parent for joint in table.joints}
    in_loops: set[str] = set()
    for index, joint in enumerate(table.joints):
        chain = [joint.name]
        while parents.get(chain[-1]) not in (None, *chain):
            chain.append(parents[chain[-1]])
        if parents.get(chain[-1]) == joint.name and joint.name not in in_loops:
            in_loops |= set(chain)
            found = f"a loop: {' on '.join((*chain, joint.name))}; cut the loop at one joint"
            yield toml.Fault(("joints", index, "parent"), "a tree with the root 'platform'", found)
    for index, wheel in enumerate(table.wheels):
        if not re.fullmatch(r"[\w-]+", wheel.name):
            expected = "a name of letters, digits, _ and -"
            yield toml.Fault(("wheels", index, "name"), expected, f"{wheel.name!r}; rename it")
        if isinstance(wheel, WheelTable) and wheel.tube > wheel.radius:
            expected = f"at most the radius, {wheel.radius:g} m (a ball)"
            yield toml.Fault(("wheels", index, "tube"), expected, f"{wheel.tube:g}; reduce it")
            continue
        try:
            _section_of(wheel)
        except ModelError as error:
            yield toml.Fault(
                ("wheels", index, "section"), "valid dimensions of a section", str(error)
            )


def _names_in(formula: str) -> frozenset[str]:
    try:
        return names_in(formula)
    except ModelError:
        return frozenset()


def _build_draft(table: VehicleTable) -> tuple[Draft, list[toml.Fault]]:
    """Return the draft of the valid parts, and the errors of coordinates and inertias."""
    faults: list[toml.Fault] = []

    def build(part: str, make: Callable[[Any], T]) -> tuple[T, ...]:
        """Return the parts of the tables of a kind; add the errors of invalid ones."""
        made = []
        for index, each in enumerate(getattr(table, part)):
            try:
                made.append(make(each))
            except ModelError as error:
                faults.append(toml.Fault((part, index), f"a valid {part[:-1]}", str(error)))
        return tuple(made)

    def coordinate(table: CoordinateKeys) -> tree.Coordinate:
        return tree.Coordinate(**{"words": table.name.replace("_", " ")} | toml.given_values(table))

    def joint(table: JointTable) -> tree.Joint:
        keys = table.model_dump(exclude={"mass", "center_of_mass", "inertia", "shapes"})
        return tree.Joint(**keys, body=next(bodies))

    def wheel(each: AnyWheelTable) -> Wheel:
        keys = each.model_dump(include={field.name for field in fields(Wheel)})
        axle = SIDEWAYS[table.frame] if each.axle is None else each.axle
        return Wheel(**keys | {"section": _section_of(each), "axle": axle, "drive": each.drive})

    coordinates = build("coordinates", coordinate)
    bodies = iter([_body(part, faults, ("joints", k)) for k, part in enumerate(table.joints)])
    joints = {joint.name: joint for joint in build("joints", joint)}
    parents = {name: joint.parent for name, joint in joints.items()}
    hung, loose = in_order(parents, "platform")
    wheels = build("wheels", wheel)
    body = _body(table, faults, ())
    ordered = tuple(joints[name] for name in (*hung, *loose))
    draft = Draft(table.name, coordinates, ordered, wheels, body, planar=table.planar)
    return draft, [f for f in faults if f.place[0] == "coordinates" or f.place[-1] == "inertia"]


def _body(
    table: JointTable | VehicleTable, faults: list[toml.Fault], place: toml.Place
) -> tree.Body:
    """Return the body of a table, without its inertia if that is invalid; add the error."""
    shapes = tuple(SHAPES[s.kind](**s.model_dump(exclude={"kind"})) for s in table.shapes)
    try:
        return tree.Body(table.mass, table.center_of_mass, table.inertia, shapes)
    except ModelError as error:
        faults.append(toml.Fault((*place, "inertia"), "a valid inertia", str(error)))
        return tree.Body(table.mass, table.center_of_mass, shapes=shapes)


def _section_of(table: AnyWheelTable) -> Section:
    """Return the section of the table of a wheel."""
    if isinstance(table, WheelTable):
        tube, rollers = table.tube, table.rollers or None
        return section_of_radii(tube, table.radius - tube, rollers=rollers)
    kind = SECTIONS[str(table.section)]
    section = kind(**{each.name: getattr(table, each.name) for each in fields(kind)})
    return Omni(section, table.rollers) if table.rollers else section
