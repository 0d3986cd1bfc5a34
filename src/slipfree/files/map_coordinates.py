"""Coordinates of the map file as functions of the coordinates of a motion."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import NamedTuple

from slipfree.errors import DataError
from slipfree.records import Array
from slipfree.trajectory import Trajectory

DEGREES = ("longitude", "latitude")
MAP_TRANSFORM = "map_transform"  # attribute of a result: its map coordinates as JSON
MAP_CRS = "map_crs"  # attribute of a result: EPSG code or WKT of the map file


class MapCoordinate(NamedTuple):
    """A coordinate of the map file as a linear function of a coordinate of the motion.

    Attributes
    ----------
    name : str
        Name of the map coordinate: ``"x"``, ``"y"``, ``"z"``, ``"longitude"`` or ``"latitude"``.
    offset : float
        Value of the map coordinate at the origin of the motion's coordinates. [m] or [deg]
    factor : float
        Change of the map coordinate per metre of the motion. [1] or [deg/m]
    axis : str
        Coordinate of the motion: ``"x"``, ``"y"`` or ``"z"``.
    """

    name: str
    offset: float
    factor: float
    axis: str


def encode_map_coordinates(coordinates: Iterable[MapCoordinate]) -> str:
    """Return map coordinates as JSON text, for an attribute of a result file."""
    return json.dumps([*coordinates])


def _map_coordinates(run: Trajectory) -> list[MapCoordinate]:
    """Return the coordinates of the map file; without them, those of the motion."""
    text = run.attributes.get(MAP_TRANSFORM)
    if text is None:
        return [MapCoordinate(name, 0.0, 1.0, name) for name in "xyz"]
    try:
        return [MapCoordinate(*row) for row in json.loads(text)]
    except (ValueError, TypeError, RecursionError) as error:
        raise DataError(
            f"attribute {MAP_TRANSFORM!r} of the result: expected rows of name, offset, factor and "
            f"axis as JSON, found {text!r}; run the problem again"
        ) from error


def map_positions(run: Trajectory) -> dict[str, tuple[str, Array]]:
    """Return units and values, shape (n,), of the map coordinates by name."""
    return {
        each.name: (
            "degree" if each.name in DEGREES else "m",
            each.offset + each.factor * run[each.axis],
        )
        for each in _map_coordinates(run)
    }
