"""Units: of keys of a problem, of named values, and of times in tables."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.errors import DataError
from slipfree.core.records import Array
from slipfree.files.toml.source import Fault, key_path
from slipfree.files.toml.types import unit_faults
from slipfree.problem import schema
from slipfree.problem.schema import CommonKeys
from slipfree.vehicle.tree import Vehicle

UNIT = re.compile(r"\[([^\],]+)\]$")  # a single unit at the end of a description
BARE = ("start", "goal", "limits")  # tables with angles
MAX_INTERVALS = 10.0  # largest median time between rows of a table [duration of the motion]
TABLES = (*BARE, "inputs", "bounds")


def unit_of(spec: CommonKeys, key: str) -> str:
    """Return the unit of a dotted key of a problem, such as ``m/s``; empty without a unit."""
    table: Any = spec
    description = ""
    for part in key_path(key):
        if not isinstance(table, dict):
            field = getattr(type(table), "model_fields", {}).get(part)
            description = (field.description or "") if field else ""
        table = table.get(part) if isinstance(table, dict) else getattr(table, part, None)
    unit = UNIT.search(description)
    return unit[1] if unit else ""


def check_units(spec: schema.TerrainKeys, dae: Dae) -> Iterator[Fault]:
    """Yield an error for each value whose unit differs from that of the model's quantity."""
    units = dae.units
    for name in TABLES:
        yield from unit_faults((name,), getattr(spec, name, None) or {}, units, bare=name in BARE)
    for index, wanted in enumerate(getattr(spec, "way_points", ())):
        yield from unit_faults(("way_points", index), wanted, units, bare=True)
    rates = {name: _rate(unit) for name, unit in units.items()}
    yield from unit_faults(("accelerations",), getattr(spec, "accelerations", {}), rates)


def _rate(unit: str) -> str:
    return unit.replace(" s-1", " s-2") if " s-1" in unit else f"{unit} s-1"


def check_time_unit(t: Array, duration: float) -> None:
    """Raise DataError if rows of a table are too far apart for the duration of a motion [s]."""
    interval = float(np.median(np.diff(t))) if t.size > 2 else 0.0
    if interval > MAX_INTERVALS * duration:
        raise DataError(
            f"expected times in s for a motion of {duration:g} s, found rows {interval:g} s apart "
            "(median); if the times are in other units, name them in the first line, as in "
            "'t [ms]', else increase the duration"
        )


def moves_sideways(vehicle: Vehicle) -> bool:
    """Return whether a vehicle can move across its heading: rollers, or all wheels steered."""
    commanded = {each.name for each in vehicle.of("commanded")}
    steered = {joint.name for joint in vehicle.joints if joint.coordinates & commanded}
    return any(w.rollers for w in vehicle.wheels) or all(
        w.parent in steered for w in vehicle.wheels
    )
