"""Export of results: the path on the map as CSV or GeoJSON, rates for a robot as CSV."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from slipfree.core.errors import DataError
from slipfree.core.records import Label
from slipfree.core.trajectory import FRAME, Column, Trajectory
from slipfree.files.netcdf import map_positions, read, write_csv
from slipfree.system.regular_files import replace_file, resolve_links

ANGLES = ("heading", "pitch", "roll", "yaw")
WGS84 = "EPSG:4326"  # default reference system of GeoJSON
RUN_AGAIN = "give a result of slipfree run with the verb 'direct', 'inverse' or 'plan'"


def export_path(file: Path, out: Path) -> None:
    """Write the path of the platform in the coordinates of the map file.

    Parameters
    ----------
    file : Path
        A result file.
    out : Path
        File to write. ``.csv``: one row per sample with time [s], x, y, z [m] or longitude,
        latitude [degrees], z [m], and the attitude [rad]. ``.geojson``: a LineString of the
        positions, with times; the member ``crs`` of GeoJSON 2008 names a reference system other
        than WGS 84.

    Raises
    ------
    DataError
        If the result cannot be read or has no x, y, z, if ``out`` has another ending or is the
        result file, if a GeoJSON path has a single sample, or if ``out`` cannot be written.
    """
    run, writers = read(file), {".csv": _write_path, ".geojson": _write_geojson}
    check_motion(file, run, "xyz")
    check_name(out, file, writers)
    writers[out.suffix.lower()](run, out)


def export_rates(file: Path, out: Path) -> None:
    """Write the rates of driven wheels and of joints with actuators as CSV, one row per sample.

    Rates are linear between samples; a jump has two rows with the same time. Units are rad/s and
    m/s.

    Parameters
    ----------
    file : Path
        A result file.
    out : Path
        File to write, ending in ``.csv``.

    Raises
    ------
    DataError
        If the result cannot be read or has no such rates, or if ``out`` has another ending, is the
        result file, or cannot be written.
    """
    run = read(file)
    check_name(out, file, (".csv",))
    inputs = run.attributes.get("inputs", "").split()
    names = [
        name
        for name in inputs
        if name in run.columns and run.columns[name].label.unit in ("rad s-1", "m s-1")
    ]
    if not names:
        raise DataError(
            f"{file}: expected rates of driven wheels or actuated joints, found none; {RUN_AGAIN}"
        )
    write_csv(out, replace(run, columns={name: run.columns[name] for name in names}))


def check_motion(file: Path, run: Trajectory, needed: Iterable[str]) -> None:
    """Raise DataError if the motion in a result file lacks a needed quantity."""
    names = list(needed)
    missing = [name for name in names if name not in run.columns]
    if missing:
        listed = ", ".join(names)
        raise DataError(
            f"{file}: expected a motion with {listed}, found no {missing[0]!r}; {RUN_AGAIN}"
        )


def check_name(out: Path, file: Path, endings: Iterable[str]) -> None:
    """Raise DataError unless ``out`` has one of the endings and is not the result file."""
    if out.suffix.lower() not in endings:
        raise DataError(
            f"{out}: expected a name that ends in {' or '.join(endings)}, found "
            f"{repr(out.suffix) if out.suffix else 'no ending'}; choose another name"
        )
    if resolve_links(out) == resolve_links(file):
        raise DataError(
            f"{out}: expected a separate file, found the result file; choose another name"
        )


def _write_path(run: Trajectory, out: Path) -> None:
    crs = run.attributes.get("map_crs", "no reference system given")
    columns = {
        name: Column(
            Label(name, unit, f"{name} of the platform's centre on the map ({crs})"), values
        )
        for name, (unit, values) in map_positions(run).items()
    }
    attitude = {name: run.columns[name] for name in ANGLES if name in run.columns}
    write_csv(out, replace(run, columns=columns | attitude))


def _write_geojson(run: Trajectory, out: Path) -> None:
    """Write the path as a GeoJSON LineString in map coordinates."""
    if run.t.size < 2:
        raise DataError(
            f"{out}: expected a motion of at least two samples for a LineString, found one; "
            "write a .csv file instead"
        )
    crs = run.attributes.get("map_crs", "")
    positions = [values.tolist() for _, values in map_positions(run).values()]
    feature = {
        "type": "Feature",
        "properties": {
            "title": run.attributes.get("title", "path"),
            "reference_system": crs or "not given: coordinates of the map file",
            "time_s": run.t.tolist(),
            FRAME: run.attributes.get(FRAME, "paper"),
            **{f"{n}_rad": run[n].tolist() for n in ANGLES if n in run.columns},
        },
        "geometry": {"type": "LineString", "coordinates": [*zip(*positions, strict=True)]},
    }
    content: dict[str, Any] = {"type": "FeatureCollection", "features": [feature]}
    if crs not in ("", WGS84):
        code = re.fullmatch(r"EPSG:(\d+)", crs)
        name = f"urn:ogc:def:crs:EPSG::{code[1]}" if code else crs
        content["crs"] = {"type": "name", "properties": {"name": name}}

    def fill(part: Path) -> None:
        part.write_text(json.dumps(content) + "\n", encoding="utf-8")

    replace_file(out, fill)
