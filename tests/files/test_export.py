"""Tests of exports: paths in the coordinates of their map, and rates for a robot."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.rasters import from_origin, geotiff
from slipfree.core.errors import DataError
from slipfree.files import netcdf
from slipfree.files.export import export_path, export_rates
from slipfree.problem.load import load_problem
from slipfree.problem.result import run_problem

PROBLEM = """\
verb = "direct"
vehicle.catalog = "three_wheeler"
start = {{ x = {x}, y = {y}, heading = 0.3 }}
inputs = {{ right_rate = [[0, 0.5], [0.5, 0.4]], left_rate = 0.4, steer_rate = 0.01 }}
time = {{ duration = 1, step = 0.25 }}
[terrain]
file = "map.tif"
{terrain}
"""


def _solved(folder, crs, transform, **asked):
    """Solve a problem on a GeoTIFF of a plane, write its result, and return it."""
    rows = 100 + 0.1 * np.arange(40.0)[:, None] + np.zeros(40)
    geotiff(folder / "map.tif", rows, transform, crs=crs, dtype="float64")
    (folder / "p.toml").write_text(PROBLEM.format(**asked))
    found = run_problem(load_problem(folder / "p.toml")).trajectory
    netcdf.write(folder / "out.nc", found)
    return found


def _rows(path):
    with path.open() as file:
        head, *rows = csv.reader(file)
    return head, np.array(rows, dtype=float)


def _path(folder):
    export_path(folder / "out.nc", folder / "path.csv")
    return _rows(folder / "path.csv")


def _geojson(folder):
    export_path(folder / "out.nc", folder / "path.geojson")
    return json.loads((folder / "path.geojson").read_text())


def _utm(folder, terrain="", x=500010.0, y=4499990.0):
    place = from_origin(500000, 4.5e6, 0.5)
    return _solved(folder, "EPSG:32633", place, terrain=terrain, x=x, y=y)


def test_a_path_on_a_projected_map(tmp_path):
    found = _utm(tmp_path)
    assert found.attributes["map_crs"] == "EPSG:32633"
    assert "pixel is area" in found.attributes["ground_map"]
    head, rows = _path(tmp_path)
    assert head == ["time", "x", "y", "z", "heading", "pitch", "roll", "yaw"]
    names = ("x", "y", "z", "heading", "pitch", "roll", "yaw")
    assert_allclose(rows, np.column_stack([found.t, *(found[name] for name in names)]), rtol=1e-15)

    content = _geojson(tmp_path)
    assert content["crs"] == {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32633"}}
    (feature,) = content["features"]
    assert feature["geometry"]["type"] == "LineString"
    assert_allclose(feature["geometry"]["coordinates"], rows[:, 1:4], rtol=1e-15)
    assert feature["properties"]["time_s"] == found.t.tolist()


def test_a_path_on_a_scaled_map_is_where_the_file_says(tmp_path):
    terrain = "scale = 0.5\nvertical_scale = 1.5"
    small = _utm(tmp_path, terrain, 250005.0, 2249995.0)
    _, rows = _path(tmp_path)
    assert_allclose(rows[:, 1], 2 * small["x"], rtol=1e-14)
    assert_allclose(rows[:, 3], small["z"] / 0.75, rtol=1e-14)
    assert_allclose(rows[0, 1:3], [500010, 4499990], rtol=1e-14)


def test_a_path_on_a_map_in_degrees(tmp_path):
    step = 1 / 3600 / 64  # half a metre
    place = from_origin(15, 47, step)
    found = _solved(tmp_path, "EPSG:4326", place, terrain='geographic = "local"', x=5.0, y=10.0)
    assert "treated as a sphere" in found.attributes["ground_degrees"]
    head, rows = _path(tmp_path)
    assert head[1:4] == ["longitude", "latitude", "z"]
    # The origin is the middle of the south-western cell; a degree of the sphere is 111195.08 m.
    assert_allclose(rows[:, 2], 47 - 39.5 * step + found["y"] / 111195.08, rtol=0, atol=1e-11)
    east = found["x"] / (111195.08 * np.cos(np.deg2rad(47 - 20 * step)))
    assert_allclose(rows[:, 1], 15 + 0.5 * step + east, rtol=0, atol=1e-11)
    content = _geojson(tmp_path)
    assert "crs" not in content  # GeoJSON means WGS 84 then
    assert_allclose(content["features"][0]["geometry"]["coordinates"], rows[:, 1:4], rtol=1e-15)


def test_rates_that_a_robot_plays(tmp_path):
    found = _utm(tmp_path)
    export_rates(tmp_path / "out.nc", tmp_path / "rates.csv")
    head, rows = _rows(tmp_path / "rates.csv")
    assert head == ["time", "right_rate", "left_rate", "steer_rate"]
    assert_allclose(rows[:, 0], found.t)
    assert set(rows[:, 1]) == {0.5, 0.4}
    assert set(rows[:, 3]) == {0.01}


def test_what_cannot_be_exported(tmp_path):
    found = _utm(tmp_path)
    out = tmp_path / "out.nc"
    for name, words in (
        ("path.kml", r"path.kml: expected a name that ends in .csv or .geojson, found '.kml'"),
        ("path", "found no ending"),
        ("none/path.csv", r"path.csv: cannot be written \(No such file"),
    ):
        with pytest.raises(DataError, match=words):
            export_path(out, tmp_path / name)
    with pytest.raises(DataError, match=r"ends in .csv, found '.geojson'"):
        export_rates(out, tmp_path / "rates.geojson")
    assert {each.name for each in tmp_path.iterdir()} == {"map.tif", "p.toml", "out.nc"}
    taken = tmp_path / "out.csv"
    out.rename(taken)
    with pytest.raises(DataError, match="expected a separate file, found the result file"):
        export_path(taken, taken)

    netcdf.write(out, replace(found, columns={"x": found.columns["x"]}))
    with pytest.raises(DataError, match="expected rates of driven wheels or"):
        export_rates(out, tmp_path / "rates.csv")
    with pytest.raises(DataError, match=r"expected a motion with .*, found no 'y'"):
        export_path(out, tmp_path / "path.csv")
    netcdf.write(out, found.part(slice(1)))
    with pytest.raises(DataError, match="at least two samples for a LineString, found one"):
        export_path(out, tmp_path / "path.geojson")
    damaged = {**found.attributes, "map_transform": "[[1]]"}
    with pytest.raises(DataError, match="expected rows of name, offset, factor and axis as JSON"):
        netcdf.write(out, replace(found, attributes=damaged))
    del damaged["map_crs"]
    netcdf.write(out, replace(found, attributes=damaged))
    with pytest.raises(DataError, match="expected rows of name, offset, factor and axis as JSON"):
        export_path(out, tmp_path / "path.geojson")


def test_without_a_reference_system_geojson_says_so(tmp_path):
    found = _utm(tmp_path)
    attributes = {k: v for k, v in found.attributes.items() if k != "map_crs"}
    netcdf.write(tmp_path / "out.nc", replace(found, attributes=attributes))
    content = _geojson(tmp_path)
    assert "crs" not in content
    assert content["features"][0]["properties"]["reference_system"].startswith("not given")
