"""Layouts of the vehicles of the catalogue, from ``vehicles.toml`` and the keywords of a call."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca

from slipfree.vehicle.drives import DRIVES
from slipfree.vehicle.formula import evaluate
from slipfree.vehicle.sections import section_of_radii
from slipfree.vehicle.tree import Body, Coordinate, Joint, Vehicle
from slipfree.vehicle.wheel import Wheel

SIDES = {"right": {"sign": 1.0, "plus": "+"}, "left": {"sign": -1.0, "plus": "-"}}
TEXTS = ("name", "kind", "words", "parent", "axis", "axle", "value", "motion", "drive")


def described(name: str, keywords: Mapping[str, Any]) -> Vehicle:
    """Return a vehicle of the catalogue with given keywords of its function."""
    table, known = _tables()[name], dict(keywords)
    for key, value in keywords.items():
        if isinstance(value, tuple):
            known |= {f"{key}_{axis}": each for axis, each in zip("xyz", value, strict=True)}
    for key, value in table.get("let", {}).items():
        known[key] = _value("", value, known)
    common = table.get("wheel", {})
    return Vehicle(
        name,
        tuple(Coordinate(**row) for row in _rows(table.get("coordinates", ()), known)),
        tuple(Joint(body=_body(row), **row) for row in _rows(table.get("joints", ()), known)),
        tuple(map(_wheel, _rows(({**common, **row} for row in table["wheels"]), known))),
        _body({key: _value(key, value, known) for key, value in table["body"].items()}),
        planar=table.get("planar", False),
    )


@cache
def _tables() -> dict[str, Any]:
    return tomllib.loads(Path(__file__).with_name("vehicles.toml").read_text("utf-8"))


def _rows(rows: Iterable[dict[str, Any]], known: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the rows of a table for given keywords, once for each side, with their values."""
    for row in rows:
        conditions = row.get("when", {}).items()
        if all(known[key] in values for key, values in conditions):
            for side, signs in SIDES.items() if "{side}" in row["name"] else [("", {})]:
                names = {**known, "side": side, **signs}
                yield {key: _value(key, row[key], names) for key in row if key != "when"}


def _value(key: str, value: Any, known: Mapping[str, Any]) -> Any:
    """Return a value of a row, with formulas replaced by numbers, and names in texts by values."""
    if isinstance(value, list):
        return tuple(_value(key, each, known) for each in value)
    if isinstance(value, str) and key in TEXTS:
        return value.format(**known)
    if isinstance(value, str) and value not in known:
        numbers = {name: ca.SX(x) for name, x in known.items() if isinstance(x, int | float)}
        return float(ca.evalf(evaluate(value, numbers)))
    value = known.get(value, value)
    return float(value) if type(value) is int else value


def _body(row: dict[str, Any]) -> Body:
    """Return the body of a row, whose keys are removed; without mass, it has no inertia."""
    mass, inertia = row.pop("mass", 0.0), row.pop("inertia", None)
    return Body(mass, row.pop("center_of_mass", (0.0, 0.0, 0.0)), inertia if mass else None)


def _wheel(row: dict[str, Any]) -> Wheel:
    section = section_of_radii(*row.pop("radii"), rollers=row.pop("rollers", None))
    if "drive" in row:
        row["drive"] = DRIVES[row["drive"]]()
    return Wheel(**row, section=section)
