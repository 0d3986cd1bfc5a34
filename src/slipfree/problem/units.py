"""Units: of keys of a problem, of named values, and of times and headings in tables."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from slipfree.core.arguments import FULL_TURN
from slipfree.core.dae import Dae
from slipfree.core.errors import DataError
from slipfree.core.records import Array
from slipfree.files.toml.source import Fault, key_path
from slipfree.files.toml.types import unit_faults
from slipfree.problem import schema
from slipfree.problem.schema import CommonKeys

UNIT = re.compile(r"\[([^\],]+)\]$")  # a single unit at the end of a description
BARE = ("start", "goal", "limits")  # tables with angles
MAX_INTERVAL = 10.0  # largest median time between samples of a log [s]
MAX_INTERVALS = 10.0  # largest median time between rows of a table [duration of the motion]
CHORDS = 200  # number of parts of a path whose directions are compared with headings
ALIKE, NEAR = 0.9, 0.25  # least cosine of similar speeds, and tolerance of the ratio of units [1]
RATIOS = {  # motion relative to the travel of the wheels if units are not named [1]
    "rates in rpm, as in 'left [rpm]'": np.pi / 30,
    "rates in deg/s, as in 'left [deg/s]'": np.pi / 180,
    "times in ms, as in 't [ms]'": 1e-3,
    "positions in cm, as in 'x [cm]'": 1e2,
    "positions in mm, as in 'x [mm]'": 1e3,
}
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


def check_sampling(t: Array) -> None:
    """Raise DataError if the times of a log are too far apart for seconds [s]."""
    interval = float(np.median(np.diff(t))) if t.size > 1 else 0.0
    if interval > MAX_INTERVAL:
        raise DataError(
            f"expected samples of a log at most {MAX_INTERVAL:g} s apart, found {interval:g} s "
            "(median); if the times are in other units, name them in [data.columns], as in "
            "t = 't [ms]'"
        )


def check_time_unit(t: Array, duration: float) -> None:
    """Raise DataError if rows of a table are too far apart for the duration of a motion [s]."""
    interval = float(np.median(np.diff(t))) if t.size > 2 else 0.0
    if interval > MAX_INTERVALS * duration:
        raise DataError(
            f"expected times in s for a motion of {duration:g} s, found rows {interval:g} s apart "
            "(median); if the times are in other units, name them in the first line, as in "
            "'t [ms]', else increase the duration"
        )


def check_travel(t: Array, x: Array, y: Array, speed: Array) -> None:
    """Raise DataError if the motion in a log is as far from the wheels' as other units are from SI.

    Times and positions have shape (n,), as has the mean speed of the driven wheels' treads. [s, m,
    m/s]
    """
    rolled = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 * np.diff(t))])
    step = max(1, t.size // CHORDS)
    dx, dy, turned = (each[step:] - each[:-step] for each in (x, y, rolled))
    moved, turned = np.hypot(dx, dy), np.abs(turned)
    size = float(np.linalg.norm(moved) * np.linalg.norm(turned))
    if not moved @ turned > ALIKE * size > 0:
        return
    ratio = float(moved @ turned / (turned @ turned))
    for words, expected in RATIOS.items():
        if abs(ratio / expected - 1) < NEAR:
            raise DataError(
                "expected times in s, positions in m and rates in rad/s, found a motion of "
                f"{ratio:.3g} times the travel of the wheels, probably {words}; name the unit with "
                "the column in [data.columns] or [data.rates]; if the slip is so large, name "
                "'[rad/s]' with the rates"
            )


def check_heading_unit(x: Array, y: Array, heading: Array, *, zero: float = 0.0) -> None:
    """Raise DataError if the headings of a motion are probably in degrees.

    They are if they exceed a full turn and agree with the directions of motion, forward or
    backward, as degrees but not as radians: headings that continue over turns are valid. Headings
    count from ``zero``, an angle from the y axis. [rad]
    """
    if np.abs(heading).max(initial=0.0) <= FULL_TURN:
        return
    step = max(1, x.size // CHORDS)
    dx, dy = (each[step:] - each[:-step] for each in (x, y))
    middle, length = heading[step // 2 :][: dx.size], np.hypot(dx, dy)
    course = np.arctan2(-dx, dy) - zero
    radians, degrees = (
        float((length * np.cos(2 * (course - angle))).sum() / max(length.sum(), 1e-300))
        for angle in (middle, np.deg2rad(middle))
    )
    if degrees > 0.8 and degrees > radians + 0.3:
        raise DataError(
            f"expected headings in rad, found values up to {np.abs(heading).max():g} that agree "
            "with the direction of motion as degrees; name their unit with the column, as in "
            "'heading [deg]'"
        )
