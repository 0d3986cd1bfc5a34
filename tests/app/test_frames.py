"""Tests of ``frame = "rep103"``: headings as given wherever they are printed or exported."""

from __future__ import annotations

import json
from math import pi
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from slipfree.cli import app
from slipfree.files import netcdf
from slipfree.frames import to_problem_frame
from slipfree.problem.load import load_problem
from slipfree.problem.solve import build
from slipfree.problem.verbs.plan_goals import facing
from slipfree.show import motion_figures
from slipfree.sweep.metrics import figures_of

PROBLEM = """\
verb = "direct"
frame = "rep103"

[terrain.synthetic]
x = [-3, 3]
y = [-3, 3]
spacing = 0.5

[vehicle]
catalog = "three_wheeler"

[start]
x = 0.5
heading = 0.3

[inputs]
right_rate = 0.5
left_rate = 0.5
steer_rate = 0.0

[time]
duration = 0.5
step = 0.25
"""


@pytest.fixture
def problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("p.toml").write_text(PROBLEM)
    return Path("p.toml")


def _invoke(*words: str) -> str:
    result = CliRunner().invoke(app, list(words))
    assert result.exit_code == 0, result.output
    return result.output


def test_a_heading_comes_back_as_it_was_given(problem: Path) -> None:
    assert "start                x 0.5, heading 0.3, z" in _invoke("check", str(problem))
    assert "heading 0.3 rad" in _invoke("run", str(problem), "--no-draw", "--csv", "p.csv")
    table = np.genfromtxt("p.csv", delimiter=",", names=True, deletechars="")
    assert_allclose(table["heading"], 0.3, atol=1e-9)
    assert_allclose(np.diff(table["y"]) / np.diff(table["x"]), np.tan(0.3), atol=1e-6)
    assert "heading 0.3 rad" in _invoke("info", "p.nc")
    found = json.loads(_invoke("info", "p.nc", "--json"))["result"]["quantities"]["heading"]
    assert found["last"] == pytest.approx(0.3, abs=1e-9)
    _invoke("export", "p.nc", "--path", "path.csv")
    table = np.genfromtxt("path.csv", delimiter=",", names=True, deletechars="")
    assert_allclose(table["heading"], 0.3, atol=1e-9)


def test_results_hold_headings_from_the_y_axis_and_say_so(problem: Path) -> None:
    _invoke("run", str(problem), "--no-draw")
    run = netcdf.read("p.nc")
    assert (run.attributes["frame"], run.attributes["problem_frame"]) == ("paper", "rep103")
    assert_allclose(run["heading"], 0.3 - pi / 2, atol=1e-9)
    shown = to_problem_frame(run)
    assert_allclose(shown["heading"], 0.3, atol=1e-9)
    assert to_problem_frame(shown) is shown
    assert figures_of(run, load_problem(problem))["end_heading"][0] == pytest.approx(0.3, abs=1e-9)
    axes = motion_figures.history(run, "heading", Figure().subplots())
    assert_allclose(np.asarray(axes.lines[0].get_ydata()), 0.3, atol=1e-9)


def test_a_start_without_heading_faces_along_the_x_axis(problem: Path) -> None:
    setup = build(load_problem(problem, ["start.heading="]))
    assert setup.start["yaw"][0] == pytest.approx(0, abs=1e-12)
    setup = build(load_problem(problem, ["start.heading=", "frame=paper"]))
    assert setup.start["heading"][0] == 0


def test_ranges_of_headings_are_in_the_frame_of_the_problem(problem: Path) -> None:
    wanted = {"heading": (0.1, 0.2), "pitch": (-0.1, 0.1)}
    turned = facing(load_problem(problem), wanted)
    assert turned == {"heading": (0.1 - pi / 2, 0.2 - pi / 2), "pitch": (-0.1, 0.1)}
