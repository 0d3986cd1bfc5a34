"""Drafts of vehicles read from a file, and the text of vehicle files."""

from __future__ import annotations

import json
import keyword
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import degrees, isfinite
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from slipfree.core.arguments import WithUnit, degrees_question
from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.files.toml.source import ProblemError
from slipfree.files.toml.types import parse_unit
from slipfree.geometry.frame import Vector, in_axes, unit_vector
from slipfree.vehicle.drives import DRIVES, RATE, Drive
from slipfree.vehicle.formula import CONSTANTS, FUNCTIONS
from slipfree.vehicle.sections import SECTIONS, Omni
from slipfree.vehicle.shapes import SHAPES, Ball, BodyShape, Box, Hull
from slipfree.vehicle.tree import Body, Coordinate, Joint, Kind, Vehicle
from slipfree.vehicle.wheel import ORIGIN, Wheel

RESERVED_NAMES = ("x", "y", "z", "heading", "roll", "pitch")  # states of the platform
NO_BODY = Body()
MAX_LENGTH = 100.0  # largest length in a vehicle [m]
# rotation from axes x forward, y left (rep103) to axes x right, y forward
FORWARD_UP = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
Value = float | bool | str | Mapping[str, Any]  # of a key in a vehicle file


class Guess(NamedTuple):
    """A guess of a property that a file does not contain; a vehicle file can override it."""

    table: str  # ``"wheels"`` or ``"joints"`` of the vehicle file, empty for its top level
    name: str  # of the joint, or of the top-level key
    values: Mapping[str, Value]  # guessed values by key
    reason: str  # guessed property, and the reason for the guessed values
    other: str  # line of the vehicle file, at its top level, for the other choice; empty if none

    @property
    def toml(self) -> str:
        """Line with the guessed values, to insert in the table of the guess or at the top level."""
        if self.table:
            return f"{toml_key(self.name)} = {toml_value(self.values)}"
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
class Draft:
    """Parts of a vehicle read from a file, not yet validated as a vehicle."""

    name: str
    coordinates: tuple[Coordinate, ...]
    joints: tuple[Joint, ...]
    wheels: tuple[Wheel, ...]
    body: Body = NO_BODY
    notes: tuple[str, ...] = ()
    guesses: tuple[Guess, ...] = ()  # guesses that the reader made
    planar: bool = False  # whether the vehicle is locked to a plane

    def of(self, kind: Kind) -> tuple[Coordinate, ...]:
        """Return the coordinates of a given kind, in the order of the file."""
        return tuple(c for c in self.coordinates if c.kind == kind)

    def vehicle(self) -> Vehicle:
        """Return the vehicle; raise ModelError if the parts do not form one."""
        parts = self.coordinates, self.joints, self.wheels, self.body, self.notes
        return Vehicle(self.name, *parts, planar=self.planar)


class VehicleError(ProblemError):
    """Error in a vehicle file, with one message per error.

    ``draft`` has the valid parts of the vehicle; None if single values are invalid.
    """

    def __init__(self, *faults: str, draft: Draft | None = None) -> None:
        super().__init__(*faults)
        self.draft = draft


def misfits(draft: Draft, few: str = "add wheels") -> Iterator[tuple[str, str]]:
    """Yield expected and found numbers for too few wheels or too many suspension coordinates.

    ``few`` is what to do about too few wheels.
    With springs at all suspension coordinates, any number of them is valid, since the springs
    determine the pose of the vehicle.
    """
    count, names = len(draft.wheels), [c.name for c in draft.of("suspension")]
    if draft.planar:
        return
    if count < 3:
        yield "at least three wheels, so that the vehicle can stand", f"{count}; {few}"
        return
    if all(c.stiffness for c in draft.of("suspension")):
        return
    most = count - 3
    if (more := len(names) - most) > 0:
        remove, whose, stiffen = f"{more} of them", f"the kind of {more} of them", "each"
        if len(names) == 1:
            remove, whose, stiffen = "it", "its kind", "it"
        yield (
            f"at most {most} suspension coordinate{'s' * (most != 1)} for {count} wheels, one for "
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


def loop_of(name: str, parents: Mapping[str, str]) -> tuple[str, ...]:
    """Return the loop that repeated steps from a name to its parent reach; empty without a loop."""
    chain = [name]
    while parents.get(chain[-1]) not in (None, *chain):
        chain.append(parents[chain[-1]])
    last = parents.get(chain[-1])
    return tuple(chain[chain.index(last) :]) if last in chain else ()


def from_rep103(draft: Draft) -> Draft:
    """Return a draft converted from axes x forward, y left to axes x right, y forward."""
    return replace(
        draft,
        joints=tuple(
            replace(
                joint,
                axis=turned_right(unit_vector(joint.axis)),
                at=turned_right(joint.at),
                turned=angles_of(FORWARD_UP @ rotation_of(joint.turned) @ FORWARD_UP.T)
                if any(joint.turned[:2])
                else joint.turned,
                body=_body(joint.body),
            )
            for joint in draft.joints
        ),
        wheels=tuple(
            replace(wheel, at=turned_right(wheel.at), axle=turned_right(unit_vector(wheel.axle)))
            for wheel in draft.wheels
        ),
        body=_body(draft.body),
    )


def turned_right(vector: Vector) -> Vector:
    """Return a vector converted from axes x forward, y left to axes x right, y forward."""
    forward, left, up = vector
    return 0.0 - left, forward, up


def _body(body: Body) -> Body:
    inertia = None if body.inertia is None else in_axes(FORWARD_UP, body.inertia)
    # a box keeps its own axes: x forward, y left
    shapes = tuple(placed(shape, FORWARD_UP, np.zeros(3)) for shape in body.shapes)
    return Body(body.mass, turned_right(body.at), inertia, shapes)


def placed(shape: BodyShape, rotation: Array, origin: Array) -> BodyShape:
    """Return a shape in another frame, in which its frame has a rotation and an origin [m]."""
    points = [vector_of(rotation @ np.asarray(point) + origin) for point in shape.points]
    if isinstance(shape, Hull):
        return Hull(tuple(points))
    if isinstance(shape, Ball):
        return Ball(shape.radius, points[0])
    at = vector_of(rotation @ np.asarray(shape.at) + origin)
    return Box(shape.size, at, angles_of(rotation @ rotation_of(shape.turned)))


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


def vehicle_text(vehicle: Vehicle, comments: Sequence[str] = ()) -> str:
    """Return the text of a vehicle file, without the vehicle's notes and with leading comments."""
    document = tomlkit.document()
    for line in comments:
        document.add(tomlkit.comment(line))
    document.update({"name": vehicle.name, "frame": "paper", **_mass_keys(vehicle.body)})
    if vehicle.planar:
        document.add("planar", True)
    tables = {
        "coordinates": [{**_given(c, "drive"), **_drive(c.drive)} for c in vehicle.coordinates],
        "joints": [{**_given(joint, "body"), **_mass_keys(joint.body)} for joint in vehicle.joints],
        "wheels": [_wheel(wheel) for wheel in vehicle.wheels],
    }
    document.update({name: rows for name, rows in tables.items() if rows})
    return tomlkit.dumps(document)


def _mass_keys(body: Body) -> dict[str, Any]:
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


def _drive(drive: Drive) -> dict[str, Any]:
    if drive == RATE:
        return {}
    kind = next(name for name, each in DRIVES.items() if isinstance(drive, each))
    return {"drive": {"kind": kind, **_given(drive)}}


def angle_text(angle: float) -> str:
    """Return an angle [rad] as text in degrees, or in radians if degrees would not be exact."""
    text = f"{degrees(angle):g} deg"
    return text if parse_unit(text) == angle else f"{float(angle)!r} rad"


def _wheel(wheel: Wheel) -> dict[str, Any]:
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
                f"{', '.join(SECTIONS)}, found {section}"
            )
        shape = {"section": kind, **{f.name: getattr(section, f.name) for f in fields(section)}}
    return {**_given(wheel, "section", "drive"), **shape, **rollers, **_drive(wheel.drive)}
