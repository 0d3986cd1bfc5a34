"""Tests of ``slipfree track``: a plan in a changed world, on the command line."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from helpers.commands import invoke, pressing, printed
from helpers.problem_files import rough_ground
from slipfree.files.netcdf import read
from slipfree.plan import tracking

pytestmark = pytest.mark.slow

PROBLEM = """\
verb = "plan"
vehicle = { catalog = "three_wheeler", axle = "fixed" }
start = {}
inputs = { right_rate = 0.5, left_rate = 0.5, steer_rate = 0.0 }
time = { duration = 4.0, step = 0.2 }
""" + rough_ground("[-3, 3]", "[-3, 3]", 0.5, "rms = 0.05, longest = 4.0, shortest = 2.0", 1)
PLAN = """\
goal = { y = 0.8 }
costs = { slip = 1e3, effort = 0.01 }
plan = { intervals = 8, smooth = 0.002, duration = 4.0 }
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the result of a plan."""
    where = tmp_path_factory.mktemp("track")
    (where / "p.toml").write_text(PLAN + PROBLEM)
    (where / "q.toml").write_text(PROBLEM.replace('"plan"', '"direct"'))
    for name in "pq":
        printed("run", where / f"{name}.toml", "-o", where / f"{name}.nc", "--no-draw")
    return where


def tracked(folder: Path, *words: object) -> dict[str, dict[str, Any]]:
    """Return the rows of the table by name."""
    found = json.loads(printed("track", folder / "p.nc", *words, "--json"))["motions"]
    return {row["name"]: row for row in found}


def test_four_ways_meet_the_same_world(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLIPFREE_CACHE", str(folder.parent.parent / "compiled"))
    out = folder / "t.nc"
    worse = ["--disturb", "heights=0.02", "--disturb", "inputs=0.05"]
    found = tracked(folder, *worse, "--period", 0.5, "--window", 2, "-o", out)
    assert list(found) == ["plan", "inputs", "follow", "replan", "sampling"]
    assert all(row["complete"] == row["seeds"] == 1 for row in list(found.values())[1:])
    # 5 % of 0.8 m, to the side as well, which only feedback corrects
    assert found["replan"]["end_distance"] < found["inputs"]["end_distance"] / 3
    assert found["sampling"]["end_distance"] < 0.05
    assert found["replan"]["cycles"] == 8
    (folder / "alone").mkdir()
    alone = Path(shutil.copy(out, folder / "alone"))
    assert "ground friction" not in printed("info", alone)
    assert "figures: " not in printed("report", alone)
    # the ground is the disturbed one, so that no wheel is above or below it
    assert "warning" not in printed("show", alone, "--html", folder / "t.html")
    assert found["replan"]["failed_cycles"] == 0
    assert read(out).t[-1] == pytest.approx(4.0)
    assert out.with_suffix(".png").stat().st_size > 10_000


def test_disturbances_act_on_the_motion_of_the_inputs(folder: Path) -> None:
    """The unchanged world repeats the plan; each disturbance moves the end by what it should."""
    alone = ["--by", "inputs", "--period", 0.5]
    assert tracked(folder, *alone)["inputs"]["end_distance"] < 1e-5
    text = printed("track", folder / "p.nc", *alone, "--disturb", "radii=0.05", "--seeds", 2)
    words = next(line for line in text.splitlines() if line.split()[:1] == ["inputs"]).split()
    assert words[1:4] == ["2", "of", "2"]
    assert 0.003 < float(words[4]) < float(words[5]) < 0.2  # of a path of 0.8 m, two draws
    # the vehicle stands for the first of eight periods, at a fifth of a metre per second
    late = tracked(folder, *alone, "--disturb", "latency=0.5")["inputs"]["end_distance"]
    assert 0.05 < late < 0.15


def test_an_interrupted_test_continues(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pressed, driven = pressing(tracking.track_plan, at=2)
    words = ["--by", "inputs", "--by", "follow", "--period", 0.5, "--seeds", 2]
    whole = tracked(folder, *words)
    monkeypatch.setattr(tracking, "track_plan", pressed)
    monkeypatch.chdir(folder)
    assert "repeat the command to continue" in printed("track", "p.nc", *words, code=130)
    found = tracked(folder, *words)
    assert [each.name for each, *_ in driven] == ["inputs", *["follow"] * 2, "inputs", "follow"]
    for name in ("inputs", "follow"):
        assert found[name]["end_distance"] == whole[name]["end_distance"]
    assert [*folder.glob("*_parts_*")] == []


def test_a_plan_is_driven_with_forces_and_with_inertia(folder: Path) -> None:
    words = ["--set", "terrain.friction=0.8", "--period", 2, "--by", "inputs", "--disturb"]
    ends = {
        (model, change): tracked(folder, *words, f"friction={change}", "--set", f"model={model}")[
            "inputs"
        ]["end_distance"]
        for model, change in (("quasi-static", 0), ("quasi-static", 0.2), ("dynamics", 0))
    }
    assert 1e-5 < ends["quasi-static", 0] < 0.01
    assert ends["quasi-static", 0] != ends["quasi-static", 0.2] < 0.01
    assert ends["quasi-static", 0] != ends["dynamics", 0] < 0.05


def test_the_exit_code_reports_a_motion_that_ends_early(folder: Path) -> None:
    """The changed map ends before the front wheel reaches its place at the goal."""
    window = ["--set", "terrain.synthetic.y=[-2.5,1.5]", "--set", "terrain.synthetic.spacing=0.5"]
    result = invoke("track", str(folder / "p.nc"), "--by", "replan", *window, code=1)
    assert "leaves the map" in result.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["q.nc"], "expected the result of a plan"),
        (["p.nc", "--window", "5"], "horizon: span: expected a window above 0 and at most"),
        (["p.nc", "--by", "hope"], "by: expected one of inputs, follow, replan, sampling, found"),
        (["p.nc", "--disturb", "wind=1"], "disturb: expected one of heights, friction, radii"),
        (["p.nc", "--disturb", "radii"], "--disturb: expected NAME=SIZE with a size of at least 0"),
        (["p.nc", "--disturb", "friction=1.5"], "friction: expected a relative change below 1"),
        (["p.nc", "--disturb", "radii=1"], "radii: expected a relative change below 0.2"),
    ],
)
def test_wrong_words_are_refused(folder: Path, words: list[str], message: str) -> None:
    file, *rest = words
    assert message in printed("track", folder / file, *rest, code=2)
