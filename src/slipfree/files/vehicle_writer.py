"""Writing of vehicle files in TOML."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from math import isfinite
from typing import Any

import tomlkit

from slipfree.errors import ModelError
from slipfree.files.toml.angles import WithUnit
from slipfree.vehicle.drives import DRIVES, RATE, Drive
from slipfree.vehicle.sections.omni import Omni
from slipfree.vehicle.sections.registry import SECTIONS
from slipfree.vehicle.tree import Body, Coordinate, Joint, Vehicle
from slipfree.vehicle.wheel import ORIGIN, Wheel


def vehicle_text(vehicle: Vehicle, comments: Sequence[str] = ()) -> str:
    """Return the text of a vehicle file, from which `read_vehicle` returns the vehicle.

    Notes of the vehicle are left out.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle, with numbers.
    comments : sequence of str
        Lines of a comment at the beginning of the file.

    Raises
    ------
    ModelError
        If a wheel has a section without a name in files.
    """
    document = tomlkit.document()
    for line in comments:
        document.add(tomlkit.comment(line))
    document.update({"name": vehicle.name, "frame": "paper", **_body(vehicle.body)})
    if vehicle.planar:
        document.add("planar", True)
    tables = {
        "coordinates": [_coordinate(each) for each in vehicle.coordinates],
        "joints": [_joint(each) for each in vehicle.joints],
        "wheels": [_wheel(each) for each in vehicle.wheels],
    }
    document.update({name: each for name, each in tables.items() if each})
    return tomlkit.dumps(document)


def _body(body: Body) -> dict[str, Any]:
    """Return the keys of mass, centre of mass and inertia that differ from their defaults."""
    found = {"mass": body.mass, "center_of_mass": body.at, "inertia": body.inertia}
    defaults = {"mass": 0.0, "center_of_mass": ORIGIN, "inertia": None}
    return {key: value for key, value in found.items() if value != defaults[key]}


def _given(record: Any, *left_out: str) -> dict[str, Any]:
    """Return the fields of a record that differ from their defaults, and finite numbers only."""
    found = {each.name: getattr(record, each.name) for each in fields(record)}
    defaults = {each.name: each.default for each in fields(record)}
    return {
        key: _with_unit(value)
        for key, value in found.items()
        if key not in left_out
        and value != defaults[key]
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
    """Return the key of a drive; none for the default."""
    if drive == RATE:
        return {}
    kind = next(name for name, each in DRIVES.items() if isinstance(drive, each))
    return {"drive": {"kind": kind, **_given(drive)}}


def _coordinate(c: Coordinate) -> dict[str, Any]:
    return {**_given(c, "drive"), **_drive(c.drive)}


def _joint(joint: Joint) -> dict[str, Any]:
    return {**_given(joint, "body"), **_body(joint.body)}


def _wheel(wheel: Wheel) -> dict[str, Any]:
    section = wheel.section
    rollers = {"rollers": True} if isinstance(section, Omni) else {}
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
