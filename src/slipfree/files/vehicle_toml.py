"""Vehicle files in TOML, checked in two passes: single values, then the parts together."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, fields
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    create_model,
)
from pydantic_core import PydanticCustomError

from slipfree.errors import ModelError
from slipfree.files.toml.angles import (
    WITH_UNIT,
    Angle,
    Quantity,
    bare_words,
    in_radians,
    unit_faults,
)
from slipfree.files.toml.errors import (
    Fault,
    ProblemError,
    listed,
    name_errors,
    validation_fault,
    value_errors,
)
from slipfree.files.toml.reader import parse_toml, read_text
from slipfree.files.toml.source_lines import PIECE, Place, Source, key_lines, spelled
from slipfree.files.toml.types import NonNegative, Positive, Record
from slipfree.files.toml.types import Place as Place3
from slipfree.files.vehicle_draft import (
    MAX_LENGTH,
    Draft,
    from_rep103,
    in_order,
    is_symbol,
    loop_of,
    misfits,
)
from slipfree.geometry.frame import Vector
from slipfree.vehicle.formula import names_in
from slipfree.vehicle.sections.base import Section
from slipfree.vehicle.sections.omni import Omni
from slipfree.vehicle.sections.registry import SECTIONS, section_of_radii
from slipfree.vehicle.tree import Body, Coordinate, Joint, Kind
from slipfree.vehicle.wheel import ORIGIN, Wheel

PARTS = ("coordinates", "joints", "wheels")
FRAMES = "'paper' (x right, y forward, z up) or 'rep103' (x forward, y left, z up)"
SIDEWAYS = {"paper": (1.0, 0.0, 0.0), "rep103": (0.0, -1.0, 0.0)}
PARENT = "the name of the joint that carries it, or 'platform'"
T = TypeVar("T")


class VehicleError(ProblemError):
    """A file does not contain a valid vehicle.

    Attributes
    ----------
    draft : Draft or None
        The parts of the vehicle that are known.
    """

    def __init__(self, *faults: str, draft: Draft | None = None) -> None:
        super().__init__(*faults)
        self.draft = draft


def meters(value: float) -> float:
    """Return a length; raise an error if it is too large for a part of a vehicle."""
    if abs(value) > MAX_LENGTH:
        raise _expected(
            f"metres, at most {MAX_LENGTH:g} (did you mean millimetres? write {value / 1000:g})"
        )
    return value


def _place(value: Vector) -> Vector:
    for each in value:
        meters(each)
    return value


def _radians(value: Vector) -> Vector:
    for each in value:
        in_radians(each)
    return value


def _expected(words: str) -> PydanticCustomError:
    return PydanticCustomError("expected", "{words}", {"words": words})


def _axis(value: Any) -> str | Vector:
    if isinstance(value, str) and value in ("x", "y", "z"):
        return value
    numbers = value if isinstance(value, list) else []
    good = [
        isinstance(n, int | float) and not isinstance(n, bool) and abs(n) < MAX_LENGTH
        for n in numbers
    ]
    if len(good) == 3 and all(good) and math.hypot(*numbers) > 0:
        return float(numbers[0]), float(numbers[1]), float(numbers[2])
    raise PydanticCustomError("expected", "'x', 'y', 'z' or a vector [x, y, z] other than zero")


def _known_section(_: Any) -> None:
    raise PydanticCustomError("expected", "{words}", {"words": f"one of {', '.join(SECTIONS)}"})


Axis = Annotated[Any, PlainValidator(_axis)]
At = Annotated[Place3, AfterValidator(_place)]
Turned = Annotated[tuple[Angle, Angle, Angle], Field(strict=False), AfterValidator(_radians)]
Name = Annotated[str, Field(min_length=1)]


class CoordinateTable(Record):
    """Angle or length of one or more joints."""

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


class JointTable(Record):
    """A part that rotates about an axis of its parent or slides along it."""

    name: Name
    parent: Name
    axis: Axis
    value: str
    at: At = ORIGIN
    motion: Literal["turn", "slide"] = "turn"
    turned: Turned = ORIGIN
    mass: NonNegative = 0.0
    center_of_mass: At = ORIGIN


class AnyWheelTable(Record):
    """Common keys of wheels of every section."""

    name: Name
    parent: Name
    section: str | None = None
    at: At = ORIGIN
    driven: bool = False
    rollers: bool = False
    axle: Axis | None = None
    grip: Positive = 1.0
    mass: NonNegative = 0.0


class WheelTable(AnyWheelTable):
    """A wheel without the key ``section``: a torus, disc or sphere."""

    radius: Annotated[Positive, AfterValidator(meters)]
    tube: NonNegative = 0.0


class UnknownSectionTable(AnyWheelTable):
    """A wheel with an unknown section; its other keys are not checked."""

    model_config = ConfigDict(extra="ignore")
    section: Annotated[Any, PlainValidator(_known_section)]


def wheel_table(data: Any) -> type[AnyWheelTable]:
    """Return the schema of a wheel, which has the fields of its section as keys."""
    if not isinstance(data, dict) or "section" not in data:
        return WheelTable
    section = SECTIONS.get(data["section"]) if isinstance(data["section"], str) else None
    return UnknownSectionTable if section is None else _section_table(section)


@cache
def _section_table(section: type[Section]) -> type[AnyWheelTable]:
    hints = get_type_hints(section)
    keys: dict[str, Any] = {
        each.name: (
            Positive if hints[each.name] is float else hints[each.name],
            ... if each.default is MISSING else each.default,
        )
        for each in fields(section)
    }
    return create_model(f"{section.__name__}Table", __base__=AnyWheelTable, **keys)


def _read_wheel(data: Any, _: ValidatorFunctionWrapHandler) -> AnyWheelTable:
    return wheel_table(data).model_validate(data)


class VehicleTable(Record):
    """A vehicle file."""

    name: Name
    frame: Literal["paper", "rep103"]
    mass: NonNegative = 0.0
    center_of_mass: At = ORIGIN
    coordinates: Annotated[tuple[CoordinateTable, ...], Field(strict=False)] = ()
    joints: Annotated[tuple[JointTable, ...], Field(strict=False)] = ()
    wheels: Annotated[
        tuple[Annotated[AnyWheelTable, WrapValidator(_read_wheel)], ...], Field(strict=False)
    ]


Tables = Mapping[str, Callable[[Any], type[BaseModel]]]  # of the elements of parts, from their data
TABLES: Tables = {
    "coordinates": lambda _: CoordinateTable,
    "joints": lambda _: JointTable,
    "wheels": wheel_table,
}


class File(NamedTuple):
    """Text and values of a vehicle file."""

    source: Source
    data: dict[str, Any]

    def line(self, fault: Fault) -> str:
        """Return the text of an error, with the name of its element."""
        where = f"{self.source.where(fault.place)}{self._who(fault.place)}"
        return f"{where}: {fault.hint}expected {fault.expected}, found {fault.found}"

    def _who(self, place: Place) -> str:
        if len(place) < 2 or not isinstance(place[1], int):
            return ""
        element = self.data[str(place[0])][place[1]]
        name = element.get("name") if isinstance(element, dict) else None
        return f" ({str(place[0])[:-1]} {name!r})" if name else ""

    def error(self, faults: list[Fault], draft: Draft | None = None) -> VehicleError:
        """Return the exception that reports all errors, in the order of their lines."""
        ordered = sorted(faults, key=lambda fault: self.source.order(fault.place))
        return VehicleError(*map(self.line, ordered), draft=draft)


def open_file(path: Path) -> File:
    """Return the contents of a TOML file; raise ProblemError if it cannot be read."""
    text = read_text(path)
    data = parse_toml(path, text)
    lines = key_lines(text)
    for part in PARTS:
        if (part,) in lines and (part, 0) not in lines:
            starts = _element_lines(text, lines[(part,)])
            lines = {**lines, **{(part, index): line for index, line in enumerate(starts)}}
    return File(Source(path, text, lines), data)


def _element_lines(text: str, start: int) -> Iterator[int]:
    """Yield the first lines of the inline tables of an array that begins on a line."""
    line, depth = start, 0
    rest = text.replace("\r\n", "\n").split("\n", start - 1)[-1]
    for piece in PIECE.findall(rest):
        if piece == "{" and depth == 1:
            yield line
        depth += (piece in "[{") - (piece in "]}")
        line += piece.count("\n")
        if depth == 0 and piece == "]":
            return


def validated(model: type[Record], parts: Tables, file: File) -> Any:
    """Return the record in a file; raise VehicleError with all invalid values."""
    try:
        found = model.model_validate(file.data)
    except ValidationError as error:
        errors = error.errors(include_url=False)
        faults = [_worded(model, parts, file.data, dict(each)) for each in errors]
        raise file.error(faults) from error
    if faults := [*value_errors(file.data)]:
        raise file.error(faults)
    return found


def _worded(
    model: type[BaseModel], parts: Tables, data: dict[str, Any], error: dict[str, Any]
) -> Fault:
    place, kind = tuple(error["loc"]), error["type"]
    if kind == "extra_forbidden":
        table = parts[place[0]](data[place[0]][place[1]]) if len(place) > 1 else model
        (unknown,) = name_errors(place[:-1], [str(place[-1])], list(table.model_fields))
        return unknown
    if kind == "missing" and isinstance(place[-1], str):
        expected = {"frame": FRAMES, "parent": PARENT, "wheels": "three wheels or more"}
        return Fault(place, expected.get(place[-1], "a value"), "none")
    return validation_fault(model, error)


def read_toml(file: File) -> Draft:
    """Return the draft of the vehicle in a file, checked to form a vehicle.

    Raises
    ------
    VehicleError
        With all errors by line, and with a draft if the single values are valid.
    """
    table: VehicleTable = validated(VehicleTable, TABLES, file)
    faults = [
        *_name_errors(table),
        *_parent_errors(table),
        *_value_errors(table),
        *_dimension_errors(table),
    ]
    parts, wrong = _build_draft(table)
    draft = parts if table.frame == "paper" else from_rep103(parts)
    faults += wrong
    if len(draft.wheels) == len(table.wheels):
        faults += [Fault((_counted(table),), *words) for words in misfits(draft)]
    if faults:
        raise file.error(faults, draft)
    return draft


def _counted(table: VehicleTable) -> str:
    """Return the key to which errors in numbers of parts belong."""
    return "coordinates" if table.coordinates and len(table.wheels) > 2 else "wheels"


def _name_errors(table: VehicleTable) -> Iterator[Fault]:
    """Yield errors of names: used twice, reserved, or invalid in formulas."""
    seen: dict[str, str] = {}
    for part in ("coordinates", "wheels", "joints"):
        if part == "joints":
            seen = {"platform": "the platform"}
        for index, each in enumerate(getattr(table, part)):
            place = (part, index, "name")
            if each.name in seen:
                expected = "a name of its own"
                yield Fault(place, expected, f"{each.name!r}, the name of {seen[each.name]} too")
            seen.setdefault(each.name, spelled((part, index)))
            if part == "wheels" and not re.fullmatch(r"[\w-]+", each.name):
                yield Fault(place, "a name of letters, digits, _ and -", repr(each.name))
            if part == "coordinates" and not is_symbol(each.name):
                expected = "a name of letters, digits and _, other than a function's or a state's"
                yield Fault(place, expected, repr(each.name))


def _parent_errors(table: VehicleTable) -> Iterator[Fault]:
    """Yield errors of parents: unknown names and loops."""
    parents = {joint.name: joint.parent for joint in table.joints}
    known = ["platform", *parents]
    for part in ("joints", "wheels"):
        for index, each in enumerate(getattr(table, part)):
            if each.parent not in known:
                yield Fault(
                    (part, index, "parent"), f"{PARENT}: {listed(known)}", _near(each.parent, known)
                )
    told: set[str] = set()
    for index, joint in enumerate(table.joints):
        loop = loop_of(joint.name, parents)
        if joint.name in loop and joint.name not in told:
            told |= set(loop)
            found = f"a loop: {' on '.join((*loop, loop[0]))}"
            expected = "a tree that begins at 'platform' (cut the loop at one joint)"
            yield Fault(("joints", index, "parent"), expected, found)


def _near(name: str, known: list[str]) -> str:
    nearest = get_close_matches(name, known, n=1)
    return f"{name!r}" + (f"; did you mean {nearest[0]!r}?" if nearest else "")


def _value_errors(table: VehicleTable) -> Iterator[Fault]:
    """Yield errors of the joints' formulas, and coordinates without joints."""
    known = [c.name for c in table.coordinates]
    motions: dict[str, set[str]] = {name: set() for name in known}
    for index, joint in enumerate(table.joints):
        place = ("joints", index, "value")
        try:
            used = names_in(joint.value)
        except ModelError as error:
            yield Fault(place, "a formula of coordinates, '0' if it is rigid", str(error))
            continue
        for name in sorted(used):
            if name not in motions:
                expected = f"a formula of the coordinates ({', '.join(known) or 'none'})"
                add = f'{_near(name, known)}; add it to coordinates, as {{ name = "{name}", kind = '
                yield Fault(place, expected, f'{add}"passive" }}')
            motions.setdefault(name, set()).add(joint.motion)
    for index, c in enumerate(table.coordinates):
        if not motions[c.name]:
            yield Fault(("coordinates", index), "a joint whose value uses it", "none")
        if len(motions[c.name]) > 1:
            yield Fault(("coordinates", index), "joints that all turn or all slide by it", "both")


def _dimension_errors(table: VehicleTable) -> Iterator[Fault]:
    """Yield errors of stops and of wheel sections."""
    slides = {
        name for joint in table.joints if joint.motion == "slide" for name in _names_in(joint.value)
    }
    for index, c in enumerate(table.coordinates):
        for key in ("lower", "upper", "rest"):
            value = getattr(c, key) or 0.0
            if c.name in slides and abs(value) > MAX_LENGTH:
                expected = f"metres, at most {MAX_LENGTH:g}"
                yield Fault(("coordinates", index, key), expected, f"{value:g}")
            elif c.name not in slides and (expected := bare_words(value)):
                yield Fault(("coordinates", index, key), expected, f"{value:g}")
        values = {key: getattr(c, key) for key in ("lower", "upper", "rest", "max_rate")}
        unit = "m" if c.name in slides else "rad"
        units = dict.fromkeys(values, unit) | {"max_rate": f"{unit} s-1"}
        yield from unit_faults(("coordinates", index), values, units)
    for index, wheel in enumerate(table.wheels):
        if isinstance(wheel, WheelTable) and wheel.tube > wheel.radius:
            expected = f"at most the radius, {wheel.radius:g} m (a ball)"
            yield Fault(("wheels", index, "tube"), expected, f"{wheel.tube:g}")
            continue
        try:
            _section_of(wheel)
        except ModelError as error:
            yield Fault(("wheels", index, "section"), "dimensions of a section", str(error))


def _names_in(formula: str) -> frozenset[str]:
    try:
        return names_in(formula)
    except ModelError:
        return frozenset()


def _build_draft(table: VehicleTable) -> tuple[Draft, list[Fault]]:
    """Return the draft of the valid parts, parents before children, and the errors of others."""
    faults: list[Fault] = []

    def build(part: str, make: Callable[[Any], T]) -> tuple[T, ...]:
        made = []
        for index, each in enumerate(getattr(table, part)):
            try:
                made.append(make(each))
            except ModelError as error:
                faults.append(Fault((part, index), "a valid one of its kind", str(error)))
        return tuple(made)

    coordinates = build("coordinates", _coordinate)
    joints = {joint.name: joint for joint in build("joints", _joint)}
    parents = {name: joint.parent for name, joint in joints.items()}
    hung, loose = in_order(parents, "platform")
    wheels = build("wheels", lambda each: _wheel(each, SIDEWAYS[table.frame]))
    body = Body(table.mass, table.center_of_mass)
    ordered = tuple(joints[name] for name in (*hung, *loose))
    draft = Draft(table.name, coordinates, ordered, wheels, body)
    return draft, [f for f in faults if f.place[0] == "coordinates"]  # the others are told


def _coordinate(table: CoordinateTable) -> Coordinate:
    given = table.model_dump(exclude_none=True)
    return Coordinate(**{"words": table.name.replace("_", " "), **given})


def _joint(table: JointTable) -> Joint:
    given = table.model_dump(exclude={"mass", "center_of_mass"})
    return Joint(**given, body=Body(table.mass, table.center_of_mass))


def _wheel(table: AnyWheelTable, sideways: Vector) -> Wheel:
    given = table.model_dump(include={"name", "parent", "at", "driven", "grip", "mass"})
    axle = sideways if table.axle is None else table.axle
    return Wheel(**given, section=_section_of(table), axle=axle)


def _section_of(table: AnyWheelTable) -> Section:
    if isinstance(table, WheelTable):
        tube, rollers = table.tube, table.rollers
        return section_of_radii(tube, table.radius - tube, rollers=rollers)
    kind = SECTIONS[str(table.section)]
    section = kind(**{each.name: getattr(table, each.name) for each in fields(kind)})
    return Omni(section) if table.rollers else section
