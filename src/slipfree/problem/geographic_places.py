"""Conversion of positions from longitude and latitude to coordinates of the ground."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import degrees, isfinite
from typing import Any

from slipfree.core.errors import ModelError
from slipfree.files.cf import DEGREES, MapCoordinate
from slipfree.files.maps.elevation import Map
from slipfree.files.maps.reference_systems import from_degrees
from slipfree.files.toml.source import Place as KeyPath
from slipfree.files.toml.types import AngleWithUnit
from slipfree.problem.build_ground import at, read_source
from slipfree.problem.problem import A, Problem
from slipfree.problem.schema import TerrainKeys


def convert_places(problem: Problem[A]) -> Problem[A]:
    """Return a problem with x and y instead of longitude and latitude in all places.

    The reference system is that of the map file, which is read only if a place is in degrees.

    Raises
    ------
    ProblemError
        If a place has only one of longitude and latitude, or also x or y; if a longitude or
        latitude is a range or exceeds 360 or 90 degrees; if the place is outside the domain of the
        map's projection; or if the map cannot be read or has no reference system.
    """
    spec = problem.spec
    if not isinstance(spec, TerrainKeys):
        return problem
    found = [place for place in _places(spec) if any(name in place[1] for name in DEGREES)]
    if not found:
        return problem
    ground, coordinates = read_source(problem)
    for keys, values in found:
        with at(problem, keys):
            spec = _replaced(spec, keys, _in_metres(values, ground, coordinates))
    return replace(problem, spec=spec)


def _places(spec: TerrainKeys) -> Iterator[tuple[KeyPath, dict[str, Any]]]:
    """Yield key and values of start, goal, way-points and keep-out regions of a problem."""
    yield ("start",), spec.start
    if (goal := getattr(spec, "goal", None)) is not None:
        yield ("goal",), goal
    for index, values in enumerate(getattr(spec, "way_points", ())):
        yield ("way_points", index), values
    for index, region in enumerate(getattr(spec, "keep_out", ())):
        yield ("keep_out", index), region.model_dump(exclude_none=True)


def _replaced(spec: Any, keys: KeyPath, values: dict[str, Any]) -> Any:
    """Return the values of a problem with another value of one position."""
    name, old = str(keys[0]), getattr(spec, str(keys[0]))
    if len(keys) == 1:
        return spec.model_copy(update={name: values})
    index = int(keys[1])
    new = values if isinstance(old[index], Mapping) else type(old[index])(**values)
    return spec.model_copy(update={name: (*old[:index], new, *old[index + 1 :])})


def _in_metres(
    values: Mapping[str, Any], ground: Map, coordinates: tuple[MapCoordinate, ...]
) -> dict[str, Any]:
    """Return the values of a place with x and y instead of longitude and latitude.

    Raises
    ------
    ModelError
        If the place cannot be converted; see `convert_places`.
    """
    if {"x", "y"} & {*values} or not {*DEGREES} <= {*values}:
        given = [name for name in ("x", "y", *DEGREES) if name in values]
        raise ModelError(
            f"expected either longitude and latitude, or x and y, found {', '.join(given)}; give "
            "one of these pairs"
        )
    is_range = isinstance(values["longitude"], tuple)
    place = [_degrees(values[name], name) for name in DEGREES]
    if ground.geographic and not ground.crs:
        x, y = place  # those of the file
    elif ground.crs:
        x, y = from_degrees(ground.crs, *place)
    else:
        raise ModelError(
            "expected a map with a reference system for longitude and latitude, found none; give "
            "x and y, or write the system into the map file: gdal_edit.py -a_srs EPSG:326xx in.tif "
            "(xx: the UTM zone; EPSG:327xx south of the equator)"
        )
    if not (isfinite(x) and isfinite(y)):
        raise ModelError(
            f"expected a place in the domain of the map's projection ({ground.crs}), found "
            f"longitude {place[0]:.9g}, latitude {place[1]:.9g}; correct them"
        )
    for each in coordinates:
        x = (x - each.offset) / each.factor if each.axis == "x" else x
        y = (y - each.offset) / each.factor if each.axis == "y" else y
    found = {name: value for name, value in values.items() if name not in DEGREES}
    return {"x": (x, x), "y": (y, y), **found} if is_range else {"x": x, "y": y, **found}


def _degrees(value: float | tuple[float, float], name: str) -> float:
    """Return a longitude or latitude in degrees, from a number or a range with equal ends.

    Raises
    ------
    ModelError
        If the ends of the range differ, or the value is out of range.
    """
    low, high = value if isinstance(value, tuple) else (value, value)
    number, last = (degrees(v) if isinstance(v, AngleWithUnit) else v for v in (low, high))
    bound = 90 if name == "latitude" else 360
    if low != high:
        raise ModelError(
            f"{name}: expected one number, found the range {number:.9g} to {last:.9g} degrees; "
            "give one number"
        )
    if abs(number) > bound:
        raise ModelError(
            f"{name}: expected a number from {-bound} to {bound} degrees, found {number:.9g}; "
            "correct it"
        )
    return float(number)
