"""Tests of angles, frames and places of problem files: as given wherever they are printed."""

import json
import pickle
import re
from collections.abc import Iterator
from math import pi
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pyproj
import pytest
import xarray
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from helpers.cases import DATA, ROOT
from helpers.commands import invoke, printed, refuses
from helpers.problem_files import PROBLEM
from helpers.rasters import from_origin, geotiff
from slipfree.core.facts import Fact
from slipfree.files import netcdf
from slipfree.files.maps.elevation import read_map
from slipfree.files.mcap import read_mcap
from slipfree.files.toml import AngleWithUnit, ProblemError, RateWithUnit, parse_unit
from slipfree.files.vehicle_toml import open_file, read_toml
from slipfree.plan.problem import costs_of
from slipfree.problem.load import load_problem
from slipfree.problem.result import build
from slipfree.show import style
from slipfree.sweep import figures_of

FRAMES_PROBLEM = """\
verb = "direct"
frame = "rep103"
terrain.synthetic = { x = [-3, 3], y = [-3, 3], spacing = 0.5 }
vehicle = { catalog = "three_wheeler" }
start = { x = 0.5, heading = 0.3 }
inputs = { right_rate = 0.5, left_rate = 0.5, steer_rate = 0.0 }
time = { duration = 0.5, step = 0.25 }
"""


@pytest.fixture
def problem(folder: Path) -> Path:
    (folder / "p.toml").write_text(FRAMES_PROBLEM)
    return Path("p.toml")


def test_a_heading_comes_back_as_it_was_given(problem):
    assert "start                x 0.500 m, heading 17.19 deg, z" in printed("check", str(problem))
    assert "heading 17.19 deg" in printed("run", str(problem), "--no-draw")
    run = netcdf.read("p.nc")
    assert_allclose(np.diff(run["y"]) / np.diff(run["x"]), np.tan(0.3), atol=1e-6)
    assert_allclose(run.in_frame("paper")["heading"], 0.3 - pi / 2, atol=1e-9)
    assert run.in_frame("rep103") is run
    assert figures_of(run, load_problem(problem))["end_heading"][0] == pytest.approx(0.3, abs=1e-9)


@pytest.mark.parametrize(("frame", "axis", "turn"), [("paper", "y", -pi / 2), ("rep103", "x", 0.0)])
def test_every_file_of_a_motion_has_the_headings_of_its_frame(problem, frame, axis, turn):
    """One motion in both frames, in every format; the yaw always counts from the x axis."""
    settings = [f"--set=frame={frame}", f"--set=start.heading={0.3 + turn}"]
    printed("run", str(problem), *settings, "--no-draw", "--csv", "run.csv")
    printed("export", "p.nc", "--path", "path.csv")
    printed("export", "p.nc", "--path", "path.geojson")
    printed("export", "p.nc", "--mcap", "path.mcap")
    printed("report", "p.nc")
    words = f"counter-clockwise angle of the forward axis from the {axis} axis"
    with xarray.open_dataset("p.nc", engine="scipy") as file:
        assert file.attrs["frame"] == frame
        assert file["heading"].attrs["long_name"] == words
        found = {"netCDF": file["heading"].values}
    (line,) = json.loads(Path("path.geojson").read_text())["features"]
    assert line["properties"]["frame"] == frame
    shown = json.loads(printed("info", "p.nc", "--json"))["result"]["quantities"]["heading"]
    assert shown["words"] == words
    axes = style.history(netcdf.read("p.nc"), "heading", Figure().subplots())
    found |= {"GeoJSON": line["properties"]["heading_rad"], "JSON": shown["last"]}
    found |= {"figure": axes.lines[0].get_ydata()}
    for name in ("run.csv", "path.csv"):
        table = np.genfromtxt(name, delimiter=",", names=True, deletechars="")
        found[name] = table["heading"]
        assert_allclose(table["yaw"], 0.3, atol=1e-9)
    for name, values in found.items():
        assert_allclose(values, 0.3 + turn, atol=1e-9, err_msg=name)
    assert_allclose(read_mcap(Path("path.mcap"), "heading")["heading"], 0.3, atol=1e-9)
    assert f"heading {np.rad2deg(0.3 + turn):.4g} deg" in Path("p.html").read_text()


def test_a_start_without_heading_faces_along_the_x_axis(problem):
    setup = build(load_problem(problem, ["start.heading="]))
    assert setup.start["yaw"][0] == pytest.approx(0, abs=1e-12)
    setup = build(load_problem(problem, ["start.heading=", "frame=paper"]))
    assert setup.start["heading"][0] == 0


PLAN = """\
verb = "plan"
frame = "{frame}"
goal = {{ x = 1.0, y = 0.2, heading = {goal} }}
limits = {{ heading = [{low}, {high}] }}
costs = {{ effort = 0.1 }}
driver = {{ name = "straight", speed = 0.25 }}
plan = {{ intervals = 4 }}
time = {{ duration = 4.0, step = 0.5 }}
start = {{ heading = {start} }}
vehicle = {{ catalog = "differential_drive" }}

[terrain.synthetic]
x = [-5.0, 5.0]
y = [-5.0, 5.0]
spacing = 0.5

[[way_points]]
at = 0.5
heading = [{low}, 0.3]
"""


def _plan(frame: str, *commands: str, **headings: float) -> tuple[int, str]:
    """Return exit code and output of a command for a plan whose headings count from the x axis."""
    values = {"start": 0.3, "goal": 0.3, "low": -0.5, "high": 0.9} | headings
    offset = 0.0 if frame == "rep103" else -pi / 2
    text = PLAN.replace("0.3]", "{mid}]").format(
        frame=frame, mid=0.5 + offset, **{key: value + offset for key, value in values.items()}
    )
    Path("p.toml").write_text(text)
    result = invoke(commands[0], "p.toml", *commands[1:])
    return result.exit_code, result.output


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield all texts and numbers of a JSON value with their keys."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value)
    for key, each in pairs:
        if isinstance(each, dict | list):
            yield from _leaves(each, f"{name}/{key}")
        else:
            yield f"{name}/{key}", each


def _headings(text: str) -> list[float]:
    """Return the numbers in a text that are headings, not differences of headings."""
    found = re.findall(
        r"heading (?:at the [a-z-]+(?: at 0.5)?(?: at (?:least|most))? )?"
        r"([-+]?[0-9.]+)(?: rad|$|,)",
        text,
    )
    return [float(each) for each in found]


@pytest.mark.usefixtures("folder")
def test_a_plan_reports_all_headings_in_the_frame_of_the_problem():
    found = []
    for frame in ("rep103", "paper"):
        code, output = _plan(frame, "run", "--no-draw", "--json", "--csv", "p.csv")
        assert code == 0, output
        table = np.genfromtxt("p.csv", delimiter=",", names=True, deletechars="")
        found.append((dict(_leaves(json.loads(output))), table))
    (first, table), (second, other) = found
    assert first.keys() == second.keys()
    assert_allclose(table["heading"] - other["heading"], pi / 2, atol=1e-9)
    prices = [each["/facts/prices of limits"] for each in (first, second)]
    assert "heading at the goal 0.3 rad" in prices[0]
    assert "heading at the goal -1.271 rad" in prices[1]
    for key, value in first.items():
        if isinstance(value, float) and "/quantities/" in key:
            turn = pi / 2 if "/heading/" in key else 0.0
            assert value - second[key] == pytest.approx(turn, abs=1e-5), key
        elif isinstance(value, str):
            for one, two in zip(_headings(value), _headings(second[key]), strict=True):
                assert one - two == pytest.approx(pi / 2, abs=1e-3), (key, value)


@pytest.mark.usefixtures("folder")
def test_contradictory_headings_are_named_in_the_frame_of_the_problem():
    code, words = _plan("rep103", "check", goal=1.2, start=1.0)
    assert code == 2
    assert "heading at the goal must be 1.2 rad" in words
    assert "heading of the vehicle must be -0.5 to 0.9 rad, but the start has 1 rad" in words


def test_a_weight_of_the_heading_is_one_of_that_of_the_problem(problem):
    for frame, offset in (("rep103", pi / 2), ("paper", 0.0)):
        dae = build(load_problem(problem, [f"frame={frame}"])).dae
        (cost,) = costs_of(dae, {"heading": 1.0})
        squared = ca.Function("cost", [dae.x.heading], [cost.expression])
        assert float(squared(0.3)) == pytest.approx((0.3 + offset) ** 2)


def test_facts_of_other_types_are_refused_by_name(problem):
    printed("run", str(problem), "--no-draw")
    run = netcdf.read("p.nc").with_facts({"slip_by_wheel": Fact([["front", 1.0]])})
    netcdf.write("p.nc", run)
    done = invoke("info", "p.nc", code=2)
    assert done.stderr.startswith("p.nc: expected facts as slipfree run writes them, found others")


# Angles and rates with units in files, and of bare numbers that look like degrees

ANGLES_PROBLEM = (DATA / "direct_in_degrees.toml").read_text()
ANGLES_PLAN = (DATA / "plan_in_degrees.toml").read_text()
INVERSE = """\
verb = "inverse"
terrain.synthetic = { x = [-3, 3], y = [-3, 3], spacing = 0.5 }
vehicle = { catalog = "three_wheeler" }
start = {}
given = { forward = 0.1, yaw_rate = "2 deg/s" }
time = { duration = 1, step = 0.5 }
"""
TRAILER = (ROOT / "problems" / "vehicles" / "trailer.toml").read_text(encoding="utf-8")
STOPS = 'lower = "-45 deg", upper = "45 deg", max_rate = "30 deg/s"'
VEHICLE = TRAILER.replace("lower = -1.2, upper = 1.2", STOPS)


def test_text_with_a_unit_is_a_number_in_si_units() -> None:
    assert parse_unit("-30 deg") == parse_unit("-30°") == pytest.approx(-pi / 6)
    assert parse_unit("1.5e1deg/s2") == pytest.approx(pi / 12)
    assert parse_unit(" .5 rad ") == 0.5
    assert isinstance(parse_unit("5 deg/s"), RateWithUnit)
    for text in ("30", "deg", "30 degrees", "3*t deg", "1e9999 deg", "1 deg/s3", "nan deg"):
        assert parse_unit(text) == text
    copy = pickle.loads(pickle.dumps(parse_unit("30 deg")))
    assert isinstance(copy, AngleWithUnit)
    assert copy == pytest.approx(pi / 6)


def test_a_problem_in_degrees_is_that_in_radians(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(ANGLES_PROBLEM)
    spec = load_problem(path).spec
    setup = build(load_problem(path))
    assert setup.start["heading"][0] == pytest.approx(pi / 2)
    assert setup.vehicle.coordinates[0].upper == pytest.approx(pi / 6)
    assert spec.inputs["right_rate"] == pytest.approx(pi / 2)
    assert spec.inputs["left_rate"] == ((0.0, pytest.approx(pi / 4)), (0.5, 1.0))


def test_a_plan_and_commands_in_degrees(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(ANGLES_PLAN)
    spec = build(load_problem(path)).spec
    assert spec.goal["heading"] == pytest.approx((pi / 180, pi / 180))
    assert spec.limits["pitch"] == pytest.approx((-pi / 9, pi / 9))
    assert spec.accelerations["right_rate"] == pytest.approx((-pi / 2, pi / 2))
    path.write_text(INVERSE)
    assert load_problem(path).spec.given["yaw_rate"] == pytest.approx(pi / 90)
    build(load_problem(path))


def test_bare_rates_and_large_angles_with_a_unit_are_accepted(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(ANGLES_PROBLEM)
    setup = build(load_problem(path, ["start.heading=450 deg", "inputs.right_rate=8"]))
    assert setup.start["heading"][0] == pytest.approx(2.5 * pi)
    path.write_text(ANGLES_PLAN)
    build(load_problem(path, ["bounds.right_rate=[-100, 100]", "limits.wheel_rate=[-10, 10]"]))


def test_a_vehicle_file_in_degrees(tmp_path: Path) -> None:
    path = tmp_path / "v.toml"
    path.write_text(VEHICLE)
    swivel = read_toml(open_file(path)).coordinates[0]
    assert (swivel.lower, swivel.upper) == pytest.approx((-pi / 4, pi / 4))
    assert swivel.max_rate == pytest.approx(pi / 6)
    path.write_text(VEHICLE.replace('"30 deg/s"', '"30 deg"'))
    words = "expected a number in rad/s, found an angle"
    refuses(ProblemError, words, read_toml, open_file(path))


# Positions in longitude and latitude: agreement with pyproj in all tables, and errors

WEST, NORTH, CELL = 440720.0, 5100320.0, 0.5
BEGIN = PROBLEM.index("[terrain")
END = PROBLEM.index("[vehicle]")
PLACES_PLAN = """
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


def problem_places(folder: Path, start: str, terrain: str = "") -> Path:
    path = folder / "p.toml"
    text = f'{PROBLEM[:BEGIN]}[terrain]\nfile = "map.tif"\n{terrain}\n{PROBLEM[END:]}'
    path.write_text(text.replace("heading = 0\n", f"heading = 0.3\n{start}\n"), encoding="utf-8")
    return path


def of_pyproj(crs: str, longitude: float, latitude: float) -> tuple[float, float]:
    return pyproj.Transformer.from_crs(4326, crs, always_xy=True).transform(longitude, latitude)


def test_a_start_is_the_place_of_pyproj(tmp_path: Path) -> None:
    write_map(tmp_path)
    to_degrees = pyproj.Transformer.from_crs("EPSG:32633", 4326, always_xy=True)
    place = to_degrees.transform(WEST + 10, NORTH - 12)
    path = problem_places(tmp_path, "longitude = {!r}\nlatitude = {!r}".format(*place))
    start = load_problem(path).spec.start
    assert [*start] == ["x", "y", "heading"]
    assert_allclose((start["x"], start["y"]), (WEST + 10, NORTH - 12), rtol=0, atol=1e-6)
    invoke("check", str(path), code=0)
    scaled = load_problem(path, ["terrain.horizontal_scale=0.5"]).spec.start
    assert_allclose((2 * scaled["x"], 2 * scaled["y"]), (start["x"], start["y"]), rtol=1e-12)


def test_goals_way_points_and_keep_outs(tmp_path: Path) -> None:
    write_map(tmp_path)
    (tmp_path / "p.toml").write_text(PLACES_PLAN)
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
    path = problem_places(
        tmp_path, "longitude = 14.2003\nlatitude = 46.0998", 'geographic = "local"'
    )
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
    found = invoke("check", str(problem_places(tmp_path, start)), code=2)
    assert "p.toml" in found.output
    assert re.search(words, " ".join(found.output.split()))


def test_a_map_without_a_system_is_refused(tmp_path: Path) -> None:
    write_map(tmp_path, None)
    place = "longitude = 14.2\nlatitude = 46.1"
    with pytest.raises(ProblemError, match=r"p\.toml:10: start: .* reference system .*gdal_edit"):
        load_problem(problem_places(tmp_path, place))
    (tmp_path / "p.toml").write_text(PROBLEM.replace("heading = 0\n", f"{place}\n"))
    with pytest.raises(ProblemError, match="start: expected a map with a reference system"):
        load_problem(tmp_path / "p.toml")
