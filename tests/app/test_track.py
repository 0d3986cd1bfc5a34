"""Tests of ``slipfree track``: a plan in a changed world, on the command line."""

import json
from pathlib import Path

import pytest

from helpers.commands import invoke, printed, sets
from slipfree.files.netcdf import read

pytestmark = pytest.mark.slow

PROBLEM = """\
verb = "plan"
vehicle = { catalog = "three_wheeler", axle = "fixed" }
start = {}
inputs = { right_rate = 0.5, left_rate = 0.5, steer_rate = 0.0 }
time = { duration = 4.0, step = 0.2 }

[terrain.synthetic]
x = [-3, 3]
y = [-3, 3]
spacing = 0.5
power_law = { rms = 0.05, hurst = 0.9, longest = 4.0, shortest = 2.0, seed = 1 }
"""
PLAN = """\
goal = { y = 0.8 }
costs = { slip = 1e3, effort = 0.01 }
plan = { intervals = 8, smooth = 0.002 }
"""
CHANGES = [f"terrain.error.{key}" for key in ("rms=0.02", "correlation=1.0", "seed=1")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the result of a plan."""
    where = tmp_path_factory.mktemp("track")
    (where / "p.toml").write_text(PLAN + PROBLEM)
    (where / "q.toml").write_text(PROBLEM.replace('"plan"', '"direct"'))
    for name in "pq":
        printed("run", where / f"{name}.toml", "-o", where / f"{name}.nc", "--no-draw")
    return where


def test_three_ways_to_follow_a_plan_are_compared(folder: Path) -> None:
    settings = sets(*CHANGES)
    out = folder / "t.nc"
    found = json.loads(
        printed("track", folder / "p.nc", *settings, "--period", 0.5, "-o", out, "--json")
    )["facts"]
    assert list(found) == ["plan", "open loop", "quasi-static", "dynamics", "follow", "replanned"]
    without = {name: found.pop(name) for name in ("quasi-static", "dynamics")}
    assert all("not simulated: " in words for words in without.values())  # no friction is given
    assert "coefficient of friction" in without["dynamics"]
    ends = {name: float(words.split()[1]) for name, words in found.items()}
    assert ends["plan"] == 0
    assert ends["replanned"] < ends["open loop"]
    assert "8 cycles, 0 failed" in found["replanned"]
    assert read(out).t[-1] == pytest.approx(4.0)


def test_a_plan_is_driven_with_forces_and_with_inertia(folder: Path) -> None:
    settings = ["--set", "terrain.friction=0.8", "--period", "2", "--json"]
    found = json.loads(printed("track", folder / "p.nc", *settings))["facts"]
    ends = {name: float(words.split()[1]) for name, words in found.items()}
    assert ends["open loop"] < 1e-5 < ends["quasi-static"] < 0.01
    assert ends["quasi-static"] != ends["dynamics"] < 0.05
    assert "rms slip" in found["dynamics"]


def test_the_exit_code_reports_a_motion_that_ends_early(folder: Path) -> None:
    """The changed map ends before the front wheel reaches its place at the goal."""
    window = ["--set", "terrain.synthetic.y=[-2.5,1.5]", "--set", "terrain.synthetic.spacing=0.5"]
    result = invoke("track", str(folder / "p.nc"), *window, code=1)
    assert "leaves the map" in result.stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["q.nc"], "expected the result of a plan"),
        (["p.nc", "--period", "9"], "period: expected a period above 0 and at most 4 s, the durat"),
        (["p.nc", "--window", "5"], "horizon: span: expected a window above 0 and at most"),
    ],
)
def test_wrong_words_are_refused(folder: Path, words: list[str], message: str) -> None:
    file, *rest = words
    assert message in printed("track", folder / file, *rest, code=2)
