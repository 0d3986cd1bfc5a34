"""Tests of positions in longitude and latitude: agreement with pyproj in all tables, and errors."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pyproj
import pytest
from numpy.testing import assert_allclose

from helpers.commands import invoke
from helpers.problem_files import PROBLEM
from helpers.rasters import from_origin, geotiff
from slipfree.files.maps.elevation import read_map
from slipfree.files.toml.source import ProblemError
from slipfree.problem.load import load_problem

WEST, NORTH, CELL = 440720.0, 5100320.0, 0.5
BEGIN = PROBLEM.index("[terrain")
END = PROBLEM.index("[vehicle]")
PLAN = """
verb = "plan"
costs = { slip = 1.0 }
goal = { longitude = 14.2350, latitude = 46.0538, heading = 0.1 }
way_points = [{ at = 0.5, longitude = 14.2349, latitude = 46.0537 }]
keep_out = [
  { longitude = 14.2348, latitude = 46.0536, radius = 0.5 },
  { x = 1, y = 2, radius = 1 },
]
terrain.file = "map.tif"
vehicle.catalog = "three_wheeler"
start = { longitude = "14.2347 deg", latitude = 46.0535 }
driver = { name = "route", speed = 0.5 }
time = { duration = 10, step = 1 }
"""


def write_map(folder: Path, crs: str | None = "EPSG:32633", cell=CELL, place=(WEST, NORTH)) -> None:
    """Write a map of hills."""
    x, y = np.meshgrid(np.arange(60.0), np.arange(50.0))
    rows = 0.1 * np.sin(0.3 * x) * np.cos(0.3 * y)
    geotiff(folder / "map.tif", rows, from_origin(*place, cell), crs=crs)


def problem(folder: Path, start: str, terrain: str = "") -> Path:
    path = folder / "p.toml"
    text = f'{PROBLEM[:BEGIN]}[terrain]\nfile = "map.tif"\n{terrain}\n{PROBLEM[END:]}'
    path.write_text(text.replace("heading = 0\n", f"heading = 0.3\n{start}\n"), encoding="utf-8")
    return path


def of_pyproj(crs: str, longitude: float, latitude: float) -> tuple[float, float]:
    return pyproj.Transformer.from_crs(4326, crs, always_xy=True).transform(longitude, latitude)


def degrees_at(x: float, y: float) -> str:
    found = pyproj.Transformer.from_crs("EPSG:32633", 4326, always_xy=True).transform(x, y)
    return "longitude = {!r}\nlatitude = {!r}".format(*found)


def test_a_start_is_the_place_of_pyproj(tmp_path: Path) -> None:
    write_map(tmp_path)
    path = problem(tmp_path, degrees_at(WEST + 10, NORTH - 12))
    start = load_problem(path).spec.start
    assert [*start] == ["x", "y", "heading"]
    assert_allclose((start["x"], start["y"]), (WEST + 10, NORTH - 12), rtol=0, atol=1e-6)
    invoke("check", str(path), code=0)
    scaled = load_problem(path, ["terrain.horizontal_scale=0.5"]).spec.start
    assert_allclose((2 * scaled["x"], 2 * scaled["y"]), (start["x"], start["y"]), rtol=1e-12)


def test_goals_way_points_and_keep_outs(tmp_path: Path) -> None:
    write_map(tmp_path)
    (tmp_path / "p.toml").write_text(PLAN)
    spec = load_problem(tmp_path / "p.toml").spec
    x, y = of_pyproj("EPSG:32633", 14.2350, 46.0538)
    assert [*spec.goal] == ["x", "y", "heading"]
    assert_allclose([spec.goal["x"], spec.goal["y"]], [(x, x), (y, y)], rtol=0, atol=1e-6)
    x, y = of_pyproj("EPSG:32633", 14.2349, 46.0537)
    (point,) = spec.way_points
    assert_allclose([point["x"], point["y"]], [(x, x), (y, y)], rtol=0, atol=1e-6)
    assert point["at"] == (0.5, 0.5)
    disc, other = spec.keep_out
    expected = of_pyproj("EPSG:32633", 14.2348, 46.0536)
    assert_allclose((disc.x, disc.y), expected, rtol=0, atol=1e-6)
    assert (disc.longitude, disc.radius, other.x) == (None, 0.5, 1)
    expected = of_pyproj("EPSG:32633", 14.2347, 46.0535)
    assert_allclose((spec.start["x"], spec.start["y"]), expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:4258", None])
def test_a_map_in_degrees_is_in_local_metres(tmp_path: Path, crs: str | None) -> None:
    write_map(tmp_path, crs, 1e-5, (14.2, 46.1))
    path = problem(tmp_path, "longitude = 14.2003\nlatitude = 46.0998", 'geographic = "local"')
    start = load_problem(path).spec.start
    frame = read_map(tmp_path / "map.tif", geographic="local").frame
    assert_allclose(frame.x0 + frame.kx * start["x"], 14.2003, rtol=0, atol=1e-10)
    assert_allclose(frame.y0 + frame.ky * start["y"], 46.0998, rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ("longitude = 14.2", "start: expected either longitude and latitude, or x and y, found lo"),
        ("longitude = 14.2\nlatitude = 146", "latitude: expected a number from -90 to 90 degrees"),
        ("longitude = 14.2\nlatitude = 46", r"start\.\w: expected a start on the map"),
        ("longitude = 105\nlatitude = 0", r"domain of the map's projection \(EPSG:32633\)"),
    ],
)
def test_wrong_places_are_refused(tmp_path: Path, start: str, words: str) -> None:
    write_map(tmp_path)
    found = invoke("check", str(problem(tmp_path, start)), code=2)
    assert "p.toml" in found.output
    assert re.search(words, " ".join(found.output.split()))


def test_a_map_without_a_system_is_refused(tmp_path: Path) -> None:
    write_map(tmp_path, None)
    place = "longitude = 14.2\nlatitude = 46.1"
    with pytest.raises(ProblemError, match=r"p\.toml:10: start: .* reference system .*gdal_edit"):
        load_problem(problem(tmp_path, place))
    (tmp_path / "p.toml").write_text(PROBLEM.replace("heading = 0\n", f"{place}\n"))
    with pytest.raises(ProblemError, match="start: expected a map with a reference system"):
        load_problem(tmp_path / "p.toml")
