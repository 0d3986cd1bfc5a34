"""Tests of shipped problem files, and of the alternatives in the comments of starters."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from helpers.commands import build_errors
from slipfree.cli import app
from slipfree.problem.load import load_problem
from slipfree.problem.result import run_problem

PROBLEMS = Path(__file__).parents[2] / "problems"
HALF_RADIUS = 0.15


def motion(name, *settings):
    return run_problem(load_problem(PROBLEMS / f"{name}.toml", settings)).trajectory


def test_kilometres_over_a_real_map():
    trajectory = motion("real_dem_direct", "time.step=10.0")
    x, y, z = (trajectory[name] for name in "xyz")
    assert trajectory.stop is None
    assert np.hypot(x[-1] - x[0], y[-1] - y[0]) > 3000
    assert np.ptp(x) / 74.4 + np.ptp(y) / 92.7 > 30  # cells of the map
    assert np.ptp(z) > 200
    assert trajectory["closure_residual"].max() < 1e-12


def rocks_on_tracks(trajectory, rocks):
    """Count the rocks higher than half a wheel radius that a contact passes over."""
    return sum(
        height > HALF_RADIUS
        and np.hypot(trajectory["contact_x"] - x, trajectory["contact_y"] - y).min() < diameter / 4
        for x, y, diameter, height in rocks
    )


@pytest.mark.slow
def test_rocks_stop_a_rigid_wheel_and_are_crossed_as_it_feels_them():
    problem = load_problem(PROBLEMS / "rover_rocks_direct.toml")
    crossed = run_problem(problem).trajectory
    assert rocks_on_tracks(crossed, problem.spec.terrain.synthetic.placed_rocks) >= 5
    assert crossed.stop is None
    assert crossed["clearance"].min() >= 0
    assert crossed["relative_curvature"].min() > 0
    bare = motion("rover_rocks_direct", "terrain.rolled=")
    assert bare.stop.name == "clearance[right]"
    assert "wheel right touches a second time at (1.0" in bare.stop.words


def test_a_mecanum_platform_carries_out_commands_without_slip():
    trajectory = motion("mecanum_inverse")
    assert trajectory.stop is None
    assert np.hypot(trajectory["slip_along"], trajectory["slip_across"]).max() < 1e-12
    for name in ("forward", "right", "yaw_rate"):
        assert np.abs(trajectory[f"{name}_error"]).max() < 1e-12
    assert max(trajectory.facts[f"replay_{name}"].value for name in ("x", "y")) < 1e-4
    assert trajectory["utilisation"].max() < 0.3


def test_three_models_of_a_mecanum_platform_agree():
    """Friction, least slip, and inertia with compliant contacts, sideways over uneven ground."""
    friction = motion("mecanum_direct")
    least = motion("mecanum_direct", "model=kinematics", "law=")
    inertia = motion("mecanum_direct", "model=dynamics", "law=", "solver.tolerance=1e-6")
    for run in (friction, least, inertia):
        assert run.stop is None
        assert 1.59 < np.hypot(run["x"], run["y"])[-1] < 1.61  # 0.2 m/s in 8 s
        assert np.abs(run["heading"] - run["heading"][0]).max() < 5e-3
    slips = (
        np.sqrt(np.mean(run["slip_along"] ** 2 + run["slip_across"] ** 2, axis=0))
        for run in (friction, inertia)
    )
    np.testing.assert_allclose(*slips, rtol=0.03)
    start = inertia.t > 0.5  # started at rest
    np.testing.assert_allclose(
        inertia["utilisation"][start], friction["utilisation"][start], rtol=0, atol=0.02
    )


@pytest.mark.slow
def test_a_rover_with_four_steered_wheels_carries_out_commands():
    trajectory = motion("crab_inverse")
    assert trajectory.stop is None
    assert trajectory.facts["replay_x"].value < 1e-3
    steering = [name for name in trajectory if name.startswith("steer_") and name[-6:] == "_error"]
    assert len(steering) == 4
    settled = np.max([np.abs(trajectory[name]) for name in steering], axis=0) < 0.02
    assert settled.mean() > 0.6
    for name in ("forward", "right", "yaw_rate"):
        assert np.abs(trajectory[f"{name}_error"][settled]).max() < 5e-3
    assert np.abs(trajectory["steer_rear_left_rate"]).max() <= 1.5


# Starters: each alternative in their comments is accepted literally

ROOT = Path(__file__).parents[2]
STARTERS = ROOT / "src" / "slipfree" / "starters"
MAP = "terrain.synthetic=", "terrain.file=map.npz"
TIMES = "[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]"
RATES = "left_rate=0.4, steer_rate=0.1"
OTHERS = [('vehicle={catalog="rocky7"}',), ('vehicle={file="vehicle.toml"}',)]
WAYS = {  # kind and beginning of a comment: settings of each alternative that it describes
    ("direct", "of both tables"): [MAP],
    ("atlas", "of both tables"): [MAP],
    ("atlas", "another vehicle of the catalogue"): OTHERS,
    ("direct", "another vehicle of the catalogue"): OTHERS,
    ("direct", "[inputs]"): [
        ("driver=", f"inputs={{right_rate=0.4, {RATES}}}"),
        ("driver=", f"inputs={{right_rate=[[0.0, 0.4], [2.0, 0.3]], {RATES}}}"),
    ],
    ("inverse", "of both tables"): [MAP],
    ("inverse", "[path]"): [
        (
            "given=",
            f"path={{t={TIMES}, x=[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], y={TIMES}, "
            "heading=[NORTH, NORTH, NORTH, NORTH, NORTH, NORTH]}".replace("NORTH", repr(np.pi / 2)),
            "time.duration=5",
        ),
        ("given=", 'path={file="path.csv"}', "time.duration=5"),
    ],
    ("plan", "of both tables"): [MAP],
    ("plan", "[driver]"): [('driver={name="route", speed=0.2}',)],
}


def comments() -> list[tuple[str, str]]:
    """Return the kinds of the starters, and the alternatives in their comments."""
    pattern = re.compile(r"^# Instead:? (.*)", re.MULTILINE)
    files = sorted(STARTERS.glob("*.toml"))
    return [(file.stem, words) for file in files for words in pattern.findall(file.read_text())]


@pytest.fixture
def folder(folder):
    axis = np.linspace(-5.0, 8.0, 27)
    np.savez("map.npz", x=axis, y=axis, z=0.05 * np.sin(axis)[:, None] * np.cos(axis))
    Path("vehicle.toml").write_text((ROOT / "problems" / "vehicles" / "trailer.toml").read_text())
    rows = "".join(f"{t},0.0,{0.2 * t},{np.pi / 2}\n" for t in range(6))
    Path("path.csv").write_text(f"t,x,y,heading\n{rows}")
    floor, step = "1,-5,-1\n1,5,-1\n1,5,0\n1,-5,0\n", "2,0,0\n2,4,0\n2,4,0.06\n2,0,0.06\n"
    Path("solids.csv").write_text(f"solid,x,z\n{floor}{step}")
    return folder


def test_every_other_way_is_tried() -> None:
    found = comments()
    for kind, words in found:
        assert [key for key in WAYS if key[0] == kind and words.startswith(key[1])], words
    assert len(found) == len(WAYS)


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("key", WAYS)
def test_a_starter_goes_the_other_way(key: tuple[str, str]) -> None:
    kind, beginning = key
    (words,) = (text for name, text in comments() if name == kind and text.startswith(beginning))
    runner = CliRunner()
    assert runner.invoke(app, ["new", kind, "mine"]).exit_code == 0
    for settings in WAYS[key]:
        if name := re.search(r'name = "(\w+)"', words):
            assert name[1] in " ".join(settings)
        options = [part for each in settings for part in ("--set", each)]
        result = runner.invoke(app, ["check", "mine.toml", *options])
        assert (result.exit_code, result.stdout[-3:]) == (0, "ok\n"), (settings, result.output)


REFUSED = tomllib.loads((Path(__file__).parents[1] / "data/refused_settings.toml").read_text())
SLOW = [
    *("plan_crater_field", "plan_parking", "plan_rigid_robot"),
    "dynamics_rocks",
    "rover_inverse",
]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        pytest.param(name, words, marks=[pytest.mark.slow] * (name.removesuffix(".toml") in SLOW))
        for name, table in REFUSED.items()
        for words in table
    ],
)
def test_settings_that_cannot_be_built_are_refused(name, words):
    errors = build_errors(PROBLEMS / name, REFUSED[name][words])
    assert words in " ".join(errors.split())
