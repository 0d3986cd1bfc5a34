"""Vehicle files in TOML, checked in two passes: single values, then the parts together."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from functools import lru_cache
from itertools import starmap
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from pydantic import AfterValidator, ConfigDict, Field, PlainValidator, ValidationError

from slipfree.core.arguments import WithUnit
from slipfree.core.errors import ModelError
from slipfree.files.toml.source import (
    PIECE,
    Fault,
    Place,
    Source,
    key_lines,
    name_errors,
    parse_toml,
    read_text,
    spelled,
    validation_fault,
    value_errors,
)
from slipfree.files.toml.types import (
    WITH_UNIT,
    Angle,
    AngleWithUnit,
    NonNegative,
    Positive,
    Quantity,
    Record,
    bare_words,
    expected_error,
    given_values,
    in_radians,
    parse_unit,
    record_of,
    unit_faults,
)
from slipfree.files.toml.types import Place as Place3
from slipfree.files.vehicle_draft import (
    MAX_LENGTH,
    Draft,
    VehicleError,
    from_rep103,
    in_order,
    is_symbol,
    length_words,
    loop_of,
    misfits,
)
from slipfree.geometry.frame import Vector
from slipfree.vehicle.drives import DRIVES, RATE, Drive
from slipfree.vehicle.formula import names_in
from slipfree.vehicle.sections import SECTIONS, Omni, Section, section_of_radii
from slipfree.vehicle.shapes import SHAPES
from slipfree.vehicle.tree import PARENT, Body, Coordinate, Joint, Kind, part_faults
from slipfree.vehicle.wheel import ORIGIN, Wheel

PARTS = ("coordinates", "joints", "wheels")
FRAMES = "'paper' (x right, y forward, z up) or 'rep103' (x forward, y left, z up)"
SIDEWAYS = {"paper": (1.0, 0.0, 0.0), "rep103": (0.0, -1.0, 0.0)}
ADD = '{{ name = "{}", kind = "passive" }} to "coordinates"'  # a coordinate with a name
T = TypeVar("T")


def _meters(value: float) -> float:
    if abs(value) > MAX_LENGTH:
        raise expected_error(length_words(value))
    return value


def _all(check: Callable[[float], float]) -> AfterValidator:
    return AfterValidator(lambda vector: tuple(map(check, vector)))


def _axis(value: Any) -> str | Vector:
    if isinstance(value, str) and value in ("x", "y", "z"):
        return value
    numbers = value if isinstance(value, list) and len(value) == 3 else [True]
    if not any(isinstance(n, bool) or not isinstance(n, int | float) for n in numbers):
        x, y, z = numbers
        if max(map(abs, numbers)) < MAX_LENGTH and math.hypot(*numbers) > 0:
            return float(x), float(y), float(z)
    raise expected_error(
        "'x', 'y', 'z' or a vector [x, y, z] other than zero, with absolute values below "
        f"{MAX_LENGTH:g}"
    )


def _rollers(value: Any) -> float | bool:
    if value is False:
        return False
    angle = parse_unit(value)
    is_bare = isinstance(angle, int | float) and not isinstance(angle, bool | WithUnit)
    is_angle = is_bare or isinstance(angle, AngleWithUnit)
    if is_angle and 0 < abs(in_radians(angle)) <= math.pi / 2:
        return float(angle)
    raise expected_error(
        "the angle from the wheel's axle to the axles of its rollers, not zero and at most 90 "
        'degrees, such as "90 deg" for an omni wheel, "45 deg" or "-45 deg" for a mecanum wheel; '
        "or false for a wheel without rollers"
    )


def _known_section(_: Any) -> None:
    raise expected_error(f"one of {', '.join(map(repr, SECTIONS))}")


def _kind_in(data: Any, kinds: Collection[str]) -> str:
    """Return the kind that a table states, which must be one of some."""
    kind = data.get("kind") if isinstance(data, dict) else None
    if not isinstance(kind, str) or kind not in kinds:
        raise expected_error(f"a table whose 'kind' is one of {', '.join(map(repr, kinds))}")
    return kind


class DriveKind(Record):
    """Key of the table of a drive that is not a parameter of its kind."""

    kind: str

    @classmethod
    def schema_for(cls, data: Any) -> type[Record]:
        """Return the record with the parameters of the kind."""
        if cls is not DriveKind:
            return cls
        drive: Any = DRIVES[_kind_in(data, DRIVES)]
        schema: type[Record] = record_of(drive, DriveKind)
        return schema


def _drive(data: Any) -> Drive:
    parameters = given_values(DriveKind.model_validate(data))
    return DRIVES[parameters.pop("kind")](**parameters)


Axis = Annotated[Any, PlainValidator(_axis)]
Rollers = Annotated[Any, PlainValidator(_rollers)]
At = Annotated[Place3, _all(_meters)]
Turned = Annotated[tuple[Angle, Angle, Angle], Field(strict=False), _all(in_radians)]
Name = Annotated[str, Field(min_length=1)]
Inertia = Annotated[tuple[float, float, float, float, float, float], Field(strict=False)]
WheelInertia = Annotated[tuple[Positive, Positive], Field(strict=False)]
Length = Annotated[Positive, AfterValidator(_meters)]
DriveTable: Any = Annotated[DriveKind | Any, PlainValidator(_drive)]


class AnyShapeTable(Record):
    """Table of a shape of a body: the key that all kinds have."""

    kind: str

    @classmethod
    def schema_for(cls, data: Any) -> type[Record]:
        """Return the record with the dimensions of the kind."""
        if cls is not AnyShapeTable:
            return cls
        return SHAPE_TABLES[_kind_in(data, SHAPE_TABLES)]


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


SHAPE_TABLES: dict[str, type[AnyShapeTable]] = {
    "box": BoxTable,
    "ball": BallTable,
    "hull": HullTable,
}
Shapes = Annotated[tuple[AnyShapeTable, ...], Field(strict=False)]


class CoordinateTable(Record):
    """Table of a coordinate: an angle or length that determines the motion of joints."""

    name: Name
    kind: Kind
    words: str | None = None
    lower: Quantity | None = None
    upper: Quantity | None = None
    stiffness: NonNegative = 0.0
    rest: Quantity = 0.0
    damping: NonNegative = 0.0
    bump: NonNegative = 0.0
    max_rate: Annotated[Positive, WITH_UNIT] | None = None
    drive: DriveTable = RATE


class JointTable(Record):
    """Table of a joint: a part that rotates about an axis of its parent or slides along it."""

    name: Name
    parent: Name
    axis: Axis
    value: str
    at: At = ORIGIN
    motion: Literal["turn", "slide"] = "turn"
    turned: Turned = ORIGIN
    mass: NonNegative = 0.0
    center_of_mass: At = ORIGIN
    inertia: Inertia | None = None
    shapes: Shapes = ()


class AnyWheelTable(Record):
    """Table of a wheel: the keys that do not depend on its section."""

    name: Name
    parent: Name
    section: str | None = None
    at: At = ORIGIN
    driven: bool = False
    rollers: Rollers = False
    axle: Axis | None = None
    grip: Positive = 1.0
    mass: NonNegative = 0.0
    static_depth: Length | None = None
    inertia: WheelInertia | None = None
    drive: DriveTable = RATE

    @classmethod
    def schema_for(cls, data: Any) -> type[Record]:
        """Return the record with the dimensions of the section."""
        if cls is not AnyWheelTable:
            return cls
        if not isinstance(data, dict) or "section" not in data:
            return WheelTable
        name = data["section"]
        section = SECTIONS.get(name) if isinstance(name, str) else None
        schema: type[Record] = record_of(section, cls) if section else UnknownSectionTable
        return schema


class WheelTable(AnyWheelTable):
    """Table of a wheel without the key ``section``: a torus, disc or sphere."""

    radius: Length
    tube: NonNegative = 0.0


class UnknownSectionTable(AnyWheelTable):
    """Table of a wheel with an unknown section; further keys are not checked."""

    model_config = ConfigDict(extra="ignore")
    section: Annotated[Any, PlainValidator(_known_section)]


class VehicleTable(Record):
    """Contents of a vehicle file."""

    name: Name
    frame: Literal["paper", "rep103"]
    mass: NonNegative = 0.0
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

    source: Source
    data: dict[str, Any]

    def error(self, faults: list[Fault], draft: Draft | None = None) -> VehicleError:
        """Return an exception with the messages of all errors, in the order of their lines."""

        def who(place: Place) -> str:  # name of the element, as in " (joint 'boom')"
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
    return file_of(path, read_text(path, "a vehicle file"))


@lru_cache(maxsize=4)  # a command asks several times for the file of its vehicle
def file_of(path: Path, text: str) -> File:
    """Return the contents of a text, with ``path`` as its file; errors as in `open_file`."""
    data = parse_toml(path, text)
    lines = key_lines(text)
    for part in PARTS:
        if (part,) in lines and (part, 0) not in lines:
            starts = _element_lines(text, lines[(part,)])
            lines = {**lines, **{(part, index): line for index, line in enumerate(starts)}}
    return File(Source(path, text, lines), data)


def _element_lines(text: str, start: int) -> Iterator[int]:
    """Yield the line numbers of the inline tables in an array that begins on line ``start``."""
    line, depth = start, 0
    rest = text.replace("\r\n", "\n").split("\n", start - 1)[-1]
    for piece in PIECE.findall(rest):
        if piece == "{" and depth == 1:
            yield line
        depth += (piece in "[{") - (piece in "]}")
        line += piece.count("\n")
        if depth == 0 and piece == "]":
            return


def validated(model: type[Record], file: File) -> Any:
    """Return the contents of a file as a record of type ``model``, or raise VehicleError."""
    try:
        table = model.model_validate(file.data)
    except ValidationError as error:
        errors = error.errors(include_url=False)
        faults = [_worded(model, file.data, dict(each)) for each in errors]
        raise file.error(faults) from error
    if faults := [*value_errors(file.data)]:
        raise file.error(faults)
    return table


def _worded(model: type[Record], data: dict[str, Any], error: dict[str, Any]) -> Fault:
    """Return a validation error of pydantic as a `Fault`, with descriptions for this file."""
    place, kind = tuple(error["loc"]), error["type"]
    if kind == "missing" and isinstance(place[-1], str):
        expected = {"frame": FRAMES, "parent": PARENT, "wheels": "at least three wheels"}
        return Fault(place, expected.get(place[-1], "a value"), "none")
    return validation_fault(model, data, error)


def read_toml(file: File) -> Draft:
    """Return the draft of a vehicle in a TOML file; a VehicleError has all messages and a draft."""
    table: VehicleTable = validated(VehicleTable, file)
    faults = [
        *_name_errors(table),
        *starmap(Fault, part_faults(table.coordinates, table.joints, table.wheels, ADD)),
        *_loop_errors(table),
        *_dimension_errors(table),
        *couple_errors(table.couple, [joint.name for joint in table.joints]),
    ]
    faults += [] if faults else _differential_errors(table)
    parts, wrong = _build_draft(table)
    parts = parts if faults else _coupled(parts, table.couple)
    draft = parts if table.frame == "paper" else from_rep103(parts)
    faults += wrong
    if len(draft.wheels) == len(table.wheels):
        part = "coordinates" if table.coordinates and len(table.wheels) > 2 else "wheels"
        faults += [Fault((part,), *words) for words in misfits(draft)]
    if faults:
        raise file.error(faults, draft)
    return draft


def couple_errors(couple: Mapping[str, float], known: Sequence[str]) -> Iterator[Fault]:
    """Yield the errors in the key ``couple``, whose names must be among ``known``."""
    if couple and (len(couple) != 2 or not all(couple.values())):
        found = ", ".join(f"{name} = {value:g}" for name, value in couple.items())
        expected = "two joints with coefficients other than zero, as in { left = 1, right = 1 }"
        yield Fault(("couple",), expected, f"{found}; correct it")
    yield from name_errors(("couple",), couple, known)


def _differential_errors(table: VehicleTable) -> Iterator[Fault]:
    """Yield an error for each coupled joint that has no coordinate of its own."""
    values = {joint.name: joint.value for joint in table.joints}
    coordinates = {c.name: c for c in table.coordinates}
    uses = [name for joint in table.joints for name in _names_in(joint.value)]
    for name in table.couple:
        if values[name] not in coordinates or uses.count(values[name]) > 1:
            expected = "a joint whose value is a coordinate that no other joint uses"
            yield Fault(("couple", name), expected, f"value = {values[name]!r}; correct the value")
    for name in [*table.couple][1:]:
        c = coordinates.get(values[name])
        if c is not None and c.model_fields_set - {"name", "kind", "words"}:
            keys = ", ".join(sorted(c.model_fields_set - {"name", "kind", "words"}))
            expected = "the keys of the common coordinate in that of the first joint"
            found = f"{keys} in {c.name!r}; move them to {values[next(iter(table.couple))]!r}"
            yield Fault(("couple", name), expected, found)


def _coupled(draft: Draft, couple: Mapping[str, float]) -> Draft:
    if not couple:
        return draft
    (first, ahead), (second, behind) = couple.items()
    values = {joint.name: joint.value for joint in draft.joints}
    factor = -ahead / behind
    value = f"-{values[first]}" if factor == -1 else f"{factor!r}*{values[first]}"
    joints = tuple(
        replace(joint, value=value) if joint.name == second else joint for joint in draft.joints
    )
    free = tuple(c for c in draft.coordinates if c.name != values[second])
    return replace(draft, joints=joints, coordinates=free)


def _name_errors(table: VehicleTable) -> Iterator[Fault]:
    """Yield an error for row name that is not unique, is reserved, or has invalid characters."""
    seen: dict[str, str] = {}
    for part in ("coordinates", "wheels", "joints"):
        if part == "joints":
            seen = {"platform": "the platform"}
        for index, row in enumerate(getattr(table, part)):
            place = (part, index, "name")
            if row.name in seen:
                remedy = "it" if seen[row.name] == "the platform" else "one of them"
                found = f"{row.name!r}, also the name of {seen[row.name]}; rename {remedy}"
                yield Fault(place, "a unique name", found)
            seen.setdefault(row.name, spelled((part, index)))
            if part == "wheels" and not re.fullmatch(r"[\w-]+", row.name):
                yield Fault(place, "a name of letters, digits, _ and -", f"{row.name!r}; rename it")
            if part == "coordinates" and not is_symbol(row.name):
                expected = "a name of letters, digits and _ that does not begin with a digit"
                if row.name.isidentifier():
                    expected = "a name other than those of functions, constants, states of the "
                    expected += "platform and Python keywords"
                yield Fault(place, expected, f"{row.name!r}; rename it")


def _loop_errors(table: VehicleTable) -> Iterator[Fault]:
    """Yield an error for each loop of parents."""
    parents = {joint.name: joint.parent for joint in table.joints}
    reported: set[str] = set()
    for index, joint in enumerate(table.joints):
        loop = loop_of(joint.name, parents)
        if joint.name in loop and joint.name not in reported:
            reported |= set(loop)
            found = f"a loop: {' on '.join((*loop, loop[0]))}; cut the loop at one joint"
            yield Fault(("joints", index, "parent"), "a tree with the root 'platform'", found)


def _dimension_errors(table: VehicleTable) -> Iterator[Fault]:
    """Yield errors in the limits of coordinates and their units, and in dimensions of wheels."""
    slides = {
        name for joint in table.joints if joint.motion == "slide" for name in _names_in(joint.value)
    }
    for index, c in enumerate(table.coordinates):
        for key in ("lower", "upper", "rest"):
            value = getattr(c, key) or 0.0
            if c.name in slides and abs(value) > MAX_LENGTH:
                yield Fault(("coordinates", index, key), length_words(value), f"{value:g}")
            elif c.name not in slides and (expected := bare_words(value)):
                yield Fault(("coordinates", index, key), expected, f"{value:g}")
        values = {key: getattr(c, key) for key in ("lower", "upper", "rest", "max_rate")}
        unit = "m" if c.name in slides else "rad"
        units = dict.fromkeys(values, unit) | {"max_rate": f"{unit} s-1"}
        yield from unit_faults(("coordinates", index), values, units)
    for index, wheel in enumerate(table.wheels):
        if isinstance(wheel, WheelTable) and wheel.tube > wheel.radius:
            expected = f"at most the radius, {wheel.radius:g} m (a ball)"
            yield Fault(("wheels", index, "tube"), expected, f"{wheel.tube:g}; reduce it")
            continue
        try:
            _section_of(wheel)
        except ModelError as error:
            yield Fault(("wheels", index, "section"), "valid dimensions of a section", str(error))


def _names_in(formula: str) -> frozenset[str]:
    try:
        return names_in(formula)
    except ModelError:
        return frozenset()


def _build_draft(table: VehicleTable) -> tuple[Draft, list[Fault]]:
    """Return the draft of the valid parts, and the errors of coordinates and inertias."""
    faults: list[Fault] = []

    def build(part: str, make: Callable[[Any], T]) -> tuple[T, ...]:
        made = []
        for index, each in enumerate(getattr(table, part)):
            try:
                made.append(make(each))
            except ModelError as error:
                faults.append(Fault((part, index), f"a valid {part[:-1]}", str(error)))
        return tuple(made)

    def coordinate(table: CoordinateTable) -> Coordinate:
        keys = {key: value for key, value in table if value is not None}
        return Coordinate(**{"words": table.name.replace("_", " "), **keys})

    def joint(table: JointTable) -> Joint:
        keys = table.model_dump(exclude={"mass", "center_of_mass", "inertia", "shapes"})
        return Joint(**keys, body=next(bodies))

    coordinates = build("coordinates", coordinate)
    bodies = iter([_body(part, faults, ("joints", k)) for k, part in enumerate(table.joints)])
    joints = {joint.name: joint for joint in build("joints", joint)}
    parents = {name: joint.parent for name, joint in joints.items()}
    hung, loose = in_order(parents, "platform")
    wheels = build("wheels", lambda each: _wheel(each, SIDEWAYS[table.frame]))
    body = _body(table, faults, ())
    ordered = tuple(joints[name] for name in (*hung, *loose))
    draft = Draft(table.name, coordinates, ordered, wheels, body, planar=table.planar)
    return draft, [f for f in faults if f.place[0] == "coordinates" or f.place[-1] == "inertia"]


def _body(table: JointTable | VehicleTable, faults: list[Fault], place: Place) -> Body:
    shapes = tuple(SHAPES[s.kind](**s.model_dump(exclude={"kind"})) for s in table.shapes)
    try:
        return Body(table.mass, table.center_of_mass, table.inertia, shapes)
    except ModelError as error:
        faults.append(Fault((*place, "inertia"), "a valid inertia", str(error)))
        return Body(table.mass, table.center_of_mass, shapes=shapes)


def _wheel(table: AnyWheelTable, sideways: Vector) -> Wheel:
    keys = table.model_dump(include={field.name for field in fields(Wheel)})
    axle = sideways if table.axle is None else table.axle
    return Wheel(**keys | {"section": _section_of(table), "axle": axle, "drive": table.drive})


def _section_of(table: AnyWheelTable) -> Section:
    if isinstance(table, WheelTable):
        tube, rollers = table.tube, table.rollers or None
        return section_of_radii(tube, table.radius - tube, rollers=rollers)
    kind = SECTIONS[str(table.section)]
    section = kind(**{each.name: getattr(table, each.name) for each in fields(kind)})
    return Omni(section, table.rollers) if table.rollers else section
