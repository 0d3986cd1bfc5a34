"""Export of results: the path on the map as CSV or GeoJSON, rates for a robot as CSV."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from slipfree.atomic_files import replace_file
from slipfree.errors import DataError
from slipfree.files.netcdf import write_csv
from slipfree.records import Array, Label
from slipfree.regular_files import resolve_links
from slipfree.trajectory import Column, Trajectory

ANGLES = ("heading", "pitch", "roll", "yaw")
NUMBER = r"[-+.\deE]+"
LINE = re.compile(rf"(\w+) = ({NUMBER}) \+ ({NUMBER}) ([xyz])(?:, |$)")
WGS84 = "EPSG:4326"  # default reference system of GeoJSON
RUN_AGAIN = "give the result of a run on terrain"


class _Line(NamedTuple):
    """A coordinate of the map: ``at + scale value`` of one of the ground's x, y, z."""

    name: str
    at: float
    scale: float
    of: str


def export_path(file: Path, out: Path) -> None:
    """Write the platform's path in the coordinates of the map.

    Parameters
    ----------
    file : Path
        A result file.
    out : Path
        ``.csv``: one row per sample with time, x, y, z or longitude, latitude (in degrees), z, and
        the attitude. ``.geojson``: a LineString of the positions, with times; a reference system
        other than WGS 84 is in the member ``crs`` of GeoJSON 2008.

    Raises
    ------
    DataError
        If the file holds no motion over terrain, or the ending is unknown, or ``out`` cannot be
        written.
    """
    run, writers = _motion(file, "xyz"), {".csv": _write_path, ".geojson": _write_geojson}
    _checked(out, file, writers)(run, out)


def export_rates(file: Path, out: Path) -> None:
    """Write the rates of driven wheels and of joints with actuators as CSV, one row per sample.

    Rates between two samples follow by linear interpolation; a jump has two rows of the same time.

    Raises
    ------
    DataError
        If the file holds no such rates, or ``out`` does not end in ``.csv`` or cannot be written.
    """
    run, write = _motion(file, ()), _checked(out, file, {".csv": lambda r, o: write_csv(o, r)})
    names = [name for name in run.attributes.get("inputs", "").split() if name in run.columns]
    if not names:
        raise DataError(
            f"{file}: expected rates of driven wheels, found none; {RUN_AGAIN} by wheels"
        )
    write(replace(run, columns={name: run.columns[name] for name in names}), out)


def _motion(file: Path, needed: str | tuple[str, ...]) -> Trajectory:
    from slipfree.files.netcdf import read

    run = read(file)
    missing = [name for name in needed if name not in run.columns]
    if missing:
        raise DataError(f"{file}: expected a path with x, y, z, found no {missing[0]}; {RUN_AGAIN}")
    return run


Write = Callable[[Trajectory, Path], None]


def _checked(out: Path, file: Path, writers: Mapping[str, Write]) -> Write:
    """Return the function that writes a file, by its ending."""
    if out.suffix.lower() not in writers:
        raise DataError(
            f"{out}: expected a name that ends in {' or '.join(writers)}, found "
            f"{repr(out.suffix) if out.suffix else 'no ending'}"
        )
    if resolve_links(out) == resolve_links(file):
        raise DataError(f"{out}: expected a file of its own, found the result file")
    return writers[out.suffix.lower()]


def map_lines(run: Trajectory) -> list[_Line]:
    """Return the linear functions from coordinates of the ground to those of the map."""
    words = run.attributes.get("map_coordinates", "")
    found = [_Line(name, float(a), float(k), of) for name, a, k, of in LINE.findall(words)]
    return found or [_Line(name, 0.0, 1.0, name) for name in "xyz"]


def _places(run: Trajectory) -> dict[str, tuple[str, Array]]:
    """Return units and values of the map coordinates, by name."""
    lines = map_lines(run)
    return {
        line.name: (
            "degree" if line.name in ("longitude", "latitude") else "m",
            line.at + line.scale * run[line.of],
        )
        for line in lines
    }


def _write_path(run: Trajectory, out: Path) -> None:
    crs = run.attributes.get("map_crs", "no reference system given")
    columns = {
        name: Column(
            Label(name, unit, f"{name} of the platform's centre on the map ({crs})"), place
        )
        for name, (unit, place) in _places(run).items()
    }
    attitude = {name: run.columns[name] for name in ANGLES if name in run.columns}
    write_csv(out, replace(run, columns=columns | attitude))


def _write_geojson(run: Trajectory, out: Path) -> None:
    if run.t.size < 2:
        raise DataError(f"{out}: expected a motion of two samples or more for a line, found one")
    crs = run.attributes.get("map_crs", "")
    places = [values.tolist() for _, values in _places(run).values()]
    feature = {
        "type": "Feature",
        "properties": {
            "title": run.attributes.get("title", "path"),
            "reference_system": crs or "not given: coordinates of the map",
            "time_s": run.t.tolist(),
        },
        "geometry": {"type": "LineString", "coordinates": [*zip(*places, strict=True)]},
    }
    content: dict[str, Any] = {"type": "FeatureCollection", "features": [feature]}
    if crs not in ("", WGS84):
        content["crs"] = {"type": "name", "properties": {"name": _urn(crs)}}

    def fill(part: Path) -> None:
        part.write_text(json.dumps(content) + "\n", encoding="utf-8")

    replace_file(out, fill)


def _urn(crs: str) -> str:
    code = re.fullmatch(r"EPSG:(\d+)", crs)
    return f"urn:ogc:def:crs:EPSG::{code[1]}" if code else crs
