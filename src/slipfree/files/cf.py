"""Position on the map and CF metadata of motions."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from slipfree.core.errors import DataError
from slipfree.core.quantities import QUANTITIES, quantity_label
from slipfree.core.records import Array, Label
from slipfree.core.trajectory import TIME, Column, Trajectory

DEGREES = ("longitude", "latitude")
MAP_TRANSFORM = "map_transform"  # attribute of a result: its map coordinates as JSON
MAP_CRS = "map_crs"  # attribute of a result: EPSG code or WKT of the map file
TIME_ATTRIBUTES = TIME | {
    "units": "seconds since 2000-01-01 00:00:00",
    "calendar": "standard",
    "units_metadata": "leap_seconds: none",
    "comment": "seconds since the start of the motion; the date is arbitrary",
}
FEATURE = {"featureType": "trajectory"}
TRAJECTORY = "trajectory"  # variable that identifies the motion
TRAJECTORY_ATTRIBUTES = {"long_name": "number of the motion", "cf_role": "trajectory_id"}
CRS = "crs"  # variable with the reference system of the map


class MapCoordinate(NamedTuple):
    """A coordinate of the map file as a linear function of a coordinate of the motion."""

    name: str  # ``"x"``, ``"y"``, ``"z"``, ``"longitude"`` or ``"latitude"``
    offset: float  # value at the origin of the motion's coordinates [m] or [deg]
    factor: float  # change per metre of the motion [1] or [deg/m]
    axis: str  # coordinate of the motion: ``"x"``, ``"y"`` or ``"z"``


def encode_map_coordinates(coordinates: Iterable[MapCoordinate]) -> str:
    """Return map coordinates as JSON text, for an attribute of a result file."""
    return json.dumps([*coordinates])


def map_positions(run: Trajectory) -> dict[str, tuple[str, Array]]:
    """Return units and values, shape (n,), of the map coordinates by name."""
    text = run.attributes.get(MAP_TRANSFORM)
    coordinates = [MapCoordinate(name, 0.0, 1.0, name) for name in "xyz"]
    try:
        if text is not None:
            coordinates = [MapCoordinate(*row) for row in json.loads(text)]
    except (ValueError, TypeError, RecursionError) as error:
        raise DataError(
            f"attribute {MAP_TRANSFORM!r} of the result: expected rows of name, offset, factor and "
            f"axis as JSON, found {text!r}; run the problem again"
        ) from error
    return {
        name: ("degree" if name in DEGREES else "m", offset + factor * run[axis])
        for name, offset, factor, axis in coordinates
    }


def is_trajectory(run: Trajectory) -> bool:
    """Return whether a motion has positions x, y, z in space."""
    return {"x", "y", "z"} <= {*run.columns}


def map_label(name: str, crs: str) -> Label:
    """Return the label of a horizontal coordinate of a map in its reference system."""
    return quantity_label(name if name in DEGREES else f"map_{name}", crs=crs)


def standard_name(name: str) -> dict[str, str]:
    """Return the attribute with the CF standard name of a quantity; empty if it has none."""
    standard = QUANTITIES[name].standard_name if name in QUANTITIES else ""
    return {"standard_name": standard} if standard else {}


def position_columns(run: Trajectory) -> dict[str, Column]:
    """Return columns with the position in the reference system of the map; empty without either."""
    crs = run.attributes.get(MAP_CRS)
    if not crs or not is_trajectory(run):
        return {}
    columns = {}
    for name, (_, values) in map_positions(run).items():
        if name != "z":
            label = map_label(name, crs)
            columns[label.name] = Column(label, values)
    return columns


def coordinate_attributes(run: Trajectory, on_map: Sequence[str], name: str) -> dict[str, str]:
    """Return the CF attributes of a variable: standard name, axis, coordinates, grid mapping."""
    attributes = standard_name(name)
    if not is_trajectory(run):
        return attributes
    axes = dict(zip([*on_map, "z"], "XYZ" if on_map else "Z", strict=True))
    if name in axes:
        return attributes | {"axis": axes[name]} | ({"positive": "up"} if name == "z" else {})
    horizontal = on_map or "xy"  # without an axis, since CF reserves X for longitude and map_x
    if name in horizontal:
        return attributes
    attributes["coordinates"] = " ".join(["time", *horizontal, "z"])
    return attributes | ({"grid_mapping": CRS} if on_map else {})


def grid_mapping(crs: str) -> dict[str, Any]:
    """Return the attributes of the variable ``crs``: WKT for CF and GDAL, and the CF projection."""
    import pyproj

    try:
        system = pyproj.CRS.from_user_input(crs)
    except pyproj.exceptions.CRSError as error:
        raise DataError(
            f"attribute {MAP_CRS!r} of the result: expected an EPSG code or WKT, found {crs!r}; "
            "run the problem again"
        ) from error
    return system.to_cf() | {"spatial_ref": system.to_wkt("WKT1_GDAL")}
