"""Tests of ``frame = "rep103"``: headings as given wherever they are printed or exported."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from math import pi
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from helpers.commands import invoke, printed
from slipfree.core.facts import Fact
from slipfree.files import netcdf
from slipfree.files.mcap import read_mcap
from slipfree.plan.problem import costs_of
from slipfree.problem.load import load_problem
from slipfree.problem.result import build
from slipfree.show import style
from slipfree.sweep.runs import figures_of

PROBLEM = """\
verb = "direct"
frame = "rep103"
terrain.synthetic = { x = [-3, 3], y = [-3, 3], spacing = 0.5 }
vehicle = { catalog = "three_wheeler" }
start = { x = 0.5, heading = 0.3 }
inputs = { right_rate = 0.5, left_rate = 0.5, steer_rate = 0.0 }
time = { duration = 0.5, step = 0.25 }
"""


@pytest.fixture
def problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("p.toml").write_text(PROBLEM)
    return Path("p.toml")


def test_a_heading_comes_back_as_it_was_given(problem):
    assert "start                x 0.5, heading 0.3, z" in printed("check", str(problem))
    assert "heading 17.19 deg" in printed("run", str(problem), "--no-draw", "--csv", "p.csv")
    table = np.genfromtxt("p.csv", delimiter=",", names=True, deletechars="")
    assert_allclose(table["heading"], 0.3, atol=1e-9)
    assert_allclose(np.diff(table["y"]) / np.diff(table["x"]), np.tan(0.3), atol=1e-6)
    assert "heading 17.19 deg" in printed("info", "p.nc")
    found = json.loads(printed("info", "p.nc", "--json"))["result"]["quantities"]["heading"]
    assert found["last"] == pytest.approx(0.3, abs=1e-9)
    printed("export", "p.nc", "--path", "path.csv")
    table = np.genfromtxt("path.csv", delimiter=",", names=True, deletechars="")
    assert_allclose(table["heading"], 0.3, atol=1e-9)


def test_results_hold_headings_in_the_frame_of_the_problem_and_say_so(problem):
    printed("run", str(problem), "--no-draw")
    run = netcdf.read("p.nc")
    assert run.attributes["frame"] == "rep103"
    assert_allclose(run["heading"], 0.3, atol=1e-9)
    assert_allclose(run.in_frame("paper")["heading"], 0.3 - pi / 2, atol=1e-9)
    assert run.in_frame("rep103") is run
    assert figures_of(run, load_problem(problem))["end_heading"][0] == pytest.approx(0.3, abs=1e-9)
    axes = style.history(run, "heading", Figure().subplots())
    assert_allclose(np.asarray(axes.lines[0].get_ydata()), 0.3, atol=1e-9)


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
