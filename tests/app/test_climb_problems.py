"""Tests of climb problems: accepted keys, errors with their lines, and results."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from helpers.climb_cases import AMPLE, RAMP, SENSED, TABLE_I, climb, foot
from slipfree.catalog.step_climber import step_climber
from slipfree.cli import app
from slipfree.control.sensor_noise import Noise
from slipfree.files.netcdf import read as read_result
from slipfree.files.netcdf import read_arrays, write
from slipfree.files.toml.source import ProblemError
from slipfree.problem.load import load_problem
from slipfree.problem.result import motion_facts
from slipfree.problem.solve import build, run_problem
from slipfree.vehicle.climber import AXLES

PROBLEMS = Path(__file__).parents[2] / "problems"
RAMP_FILE, STEP_FILE, STAIRS_FILE, PLAN_FILE = (
    PROBLEMS / f"climb_{name}.toml" for name in ("ramp", "step", "stairs", "plan_step")
)
COARSE = ("time.step=0.01",)
SLIPPERY = ("friction.static=0.4", "friction.kinetic=0.3")

SOLIDS = """\
verb = "climb"

[[profile.solids]]
points = [[-5, -1], [5, -1], [5, 0], [-5, 0]]

[[profile.solids]]
points = [[0, -1], [2, -1], [2, 0.09], [0, 0.09]]

[vehicle]
catalog = "seven_wheels"
torque = 8

[vehicle.rear_body]
mass = 13.8

[friction]
static = 0.9
kinetic = 0.675

[control]
speed = 0.25

[start]
distance = 0.05

[time]
duration = 1.0
step = 0.01
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "p.toml").write_text(SOLIDS, encoding="utf-8")
    return tmp_path


def _invoke(*words: str) -> Any:
    return CliRunner().invoke(app, [str(word) for word in words])


def _faults(folder: Path, text: str, *settings: str) -> str:
    path = folder / "p.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ProblemError) as caught:
        build(load_problem(path, settings))
    return str(caught.value).replace(f"{folder}/", "")


# What comes out


@pytest.mark.slow
def test_the_ramp_is_the_library_s_climb():
    found = run_problem(load_problem(RAMP_FILE, ["solver.tolerance=1e-8"])).trajectory
    same = climb(RAMP, SENSED, TABLE_I, torque=AMPLE, tolerance=1e-8)
    counts, averages = found.statistics, same.metrics
    for measure in ("slip", "true_slip", "disturbance", "effort", "bearing"):
        values = [counts[f"climb_{measure}_{axle}"] for axle in AXLES]
        np.testing.assert_allclose(values, getattr(averages, measure), rtol=1e-3)
    np.testing.assert_allclose(found["y"], same.run["y"], atol=1e-6)
    span = averages.window.span
    assert (counts["climb_from"], counts["climb_to"]) == tuple(same.run.t[span][[0, -1]])
    assert found.attributes["climb"].startswith("climbs: by t = 2.63")
    # friction that a slow climb needs, of a study with its own code
    assert counts["slow_climb_friction"] == pytest.approx(0.323, abs=0.005)


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_run_tells_and_keeps_what_matters():
    result = _invoke("run", RAMP_FILE, "--no-draw", "-o", "r.nc", "--csv", "r.csv")
    assert result.exit_code == 0, result.output
    for words in (
        "profile                  ramp of 45 degrees, 0.09 m high",
        "climbs: by t = 2.63",
        "t = 0.150 to 2.958 s: from 50 ms before the front wheels first touch the",
        "  slip, eq. (20)         front 6.1 %, middle 3.2 %, rear 4.7 %; mean 4.6 %",
        "needs a coefficient of 0.323, where the middle wheels climb",
        "available: 0.4 at rest",
        "x real time",
        "balance within",
        "wrote r.nc, r.csv",
    ):
        assert words in result.output, words
    kept = read_result("r.nc")
    assert kept.wheels == AXLES
    assert kept.attributes["climb"].startswith("climbs")
    told = _invoke("info", "r.nc")
    assert told.exit_code == 0
    assert "  true slip              front 3.6 %, middle 3.1 %, rear 4.2 %" in told.output
    assert _invoke("info", "r.nc", "--problem").output == RAMP_FILE.read_text()


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_what_does_not_climb_is_told():
    settings = [word for each in (*SLIPPERY, *COARSE) for word in ("--set", each)]
    result = _invoke("run", STEP_FILE, "--no-draw", *settings)
    assert result.exit_code == 0  # the motion is whole
    assert "stalls: by t = 3.6 s 0 of 3 wheels had reached the top, z = 0.09 m" in result.output
    assert "needs a coefficient of 0.711" in result.output
    result = _invoke(
        "run",
        STEP_FILE,
        "--no-draw",
        "--set",
        "profile.step.height=0.3",
        "--set",
        "friction.static=2",
        "--set",
        "friction.kinetic=2",
    )
    assert result.exit_code == 1
    assert "tips over: at t = 1." in result.output
    assert "climb: the vehicle gets stuck with the front wheels climbing" in result.output
    assert result.stdout.startswith("outcome ")
    assert "limit reached at t = 1." in result.stderr


def test_no_averages_before_the_obstacle_is_met():
    found = run_problem(load_problem(STEP_FILE, ["time.duration=0.1"])).trajectory
    assert found.attributes["climb"].startswith("unfinished: no wheel touched an obstacle")
    assert not [name for name in found.statistics if name.startswith("climb_")]


@pytest.mark.parametrize("path", [RAMP_FILE, STEP_FILE], ids=["ramp", "step"])
def test_distance_to_the_obstacle(path):
    setup = build(load_problem(path))
    assert setup.start["center_y", "front"][0] == pytest.approx(foot(setup.profile), abs=1e-9)
    assert setup.start["solid_gap_2"][0].min() > 0.03
    start = build(load_problem(path, ["start.distance=0", "start.speed=0"])).start
    assert start["solid_gap_2", "front"][0] == pytest.approx(
        0, abs=5e-4
    )  # sunk in under its weight
    assert start["velocity_y"][0] == 0


@pytest.mark.slow
def test_solids_here_and_in_a_file_are_a_step(folder):
    corners = "0,-5,-1\n0,5,-1\n0,5,0\n0,-5,0\n1,0,-1\n1,2,-1\n1,2,0.09\n1,0,0.09\n"
    (folder / "s.csv").write_text("solid,x,z\n" + corners)
    step = run_problem(load_problem(STEP_FILE, ["time.duration=0.5", *COARSE])).trajectory
    here = run_problem(load_problem(folder / "p.toml", ["time.duration=0.5"])).trajectory
    there = run_problem(
        load_problem(folder / "p.toml", ["time.duration=0.5", "profile={file='s.csv'}"])
    ).trajectory
    np.testing.assert_allclose(here["center_z"], step["center_z"], atol=1e-6)
    np.testing.assert_array_equal(here["center_z"], there["center_z"])
    assert there.attributes["profile"] == "convex solids of s.csv"


def test_what_the_vehicle_s_table_replaces():
    setup = build(
        load_problem(
            STEP_FILE,
            [
                "vehicle.joint=0.06",
                "vehicle.radius=0.07",
                "vehicle.rear_body={mass=10, above=0}",
                "vehicle.front={wheels=4}",
                "vehicle.torque=",
            ],
        )
    )
    plain = step_climber(0.06)
    assert setup.climber.radius == 0.07
    assert setup.climber.torque == math.inf
    assert setup.climber.rear_body == plain.rear_body._replace(mass=10, above=0)
    assert setup.climber.front == plain.front._replace(wheels=4)
    assert setup.climber.middle == plain.middle


@pytest.mark.slow
def test_a_sampled_controller_climbs_as_the_continuous_one():
    brief = ["time.duration=0.5", "time.step=0.004"]
    sampled = run_problem(load_problem(STAIRS_FILE, brief)).trajectory
    continuous = run_problem(load_problem(STAIRS_FILE, [*brief, "control.period="])).trajectory
    np.testing.assert_allclose(sampled.t, 0.004 * np.arange(126), atol=1e-12)
    np.testing.assert_allclose(sampled["center_y"], continuous["center_y"], atol=5e-3)
    assert "rear_torque" in sampled.columns
    assert sampled.attributes["control"].endswith("every 0.002 s")


def test_sensors_may_be_noisy():
    noisy = load_problem(RAMP_FILE, ["control.noise={tilt=0.01, band=20.0, seed=3}"])
    assert build(noisy).control.noise == Noise(tilt=0.01, band=20.0, seed=3)


@pytest.mark.slow
def test_stairs_are_climbed():
    found = run_problem(load_problem(STAIRS_FILE, ["control.period=", *COARSE])).trajectory
    assert found.attributes["climb"].startswith("climbs")
    np.testing.assert_allclose(found["center_z"][-1], 3 * 0.06 + 0.066, atol=1e-3)


# Plans


@pytest.mark.slow
def test_a_plan_climbs_where_references_do_not(tmp_path):
    problem = load_problem(PLAN_FILE, COARSE)
    found = run_problem(problem)
    counts = found.trajectory.statistics
    assert found.trajectory.attributes["climb"].startswith("climbs")
    # least friction of every leg, of a study with its own code
    least = [counts[f"climb_plan_least_{k}"] for k in (1, 2, 3)]
    np.testing.assert_allclose(least, [0.579, 0.630, 0.677], atol=0.01)
    assert counts["climb_plan_friction"] == pytest.approx(0.7)
    assert counts["climb_plan_driven"] == pytest.approx(counts["climb_plan_duration"], rel=0.05)
    assert counts["climb_true_slip_front"] < 0.02
    write(tmp_path / "r.nc", found.trajectory, found.arrays)
    plan = read_arrays(tmp_path / "r.nc")
    assert plan["plan_time"][-1] == pytest.approx(counts["climb_plan_duration"], rel=0.02)
    for axle in AXLES:
        assert (
            np.abs(plan[f"plan_friction_{axle}"]) <= 0.7 * plan[f"plan_load_{axle}"] + 1e-5
        ).all()
    told = dict(motion_facts(found.trajectory))
    assert "uses a coefficient of 0.700" in told["plan"]
    assert told["  least friction"].startswith("by leg 0.579, 0.6")
    for settings in (["plan="], ["plan=", "control.law=fixed"]):
        stuck = run_problem(load_problem(PLAN_FILE, [*settings, *COARSE])).trajectory
        assert stuck.attributes["climb"].startswith("stalls"), settings


@pytest.mark.usefixtures("folder")
def test_there_is_no_plan_without_enough_friction():
    result = _invoke("run", PLAN_FILE, "--no-draw", "--set", "plan.friction=0.6")
    assert result.exit_code == 1
    assert (
        "plan, leg 3, on which the rear wheels climb: expected a coefficient of friction of "
        "at least 0.67"
    ) in result.stderr


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        (
            "plan.friction=2",
            "--set plan.friction: expected at most friction.static, 0.75, found 2; reduce it, or "
            "increase friction.static",
        ),
        (
            "control.law=fixed",
            "--set control.law: expected only the keys 'speed' and "
            "'proportional' in [control] with a [plan], found 'law'; remove it",
        ),
        ("plan.cost=fee", "--set plan.cost: expected 'time', 'friction' or 'slip', found 'fee'"),
        ("plan.nodes=19", "--set plan.nodes: expected a number of at least 20, found 19"),
    ],
)
def test_plans_that_cannot_be(setting, words):
    with pytest.raises(ProblemError) as caught:
        build(load_problem(PLAN_FILE, [setting]))
    assert str(caught.value) == words


def test_the_least_friction_takes_no_coefficient():
    with pytest.raises(
        ProblemError, match=r"climb_plan_step.toml:\d+: plan: climb: expected a coe"
    ):
        run_problem(load_problem(PLAN_FILE, ["plan.cost=friction"]))


# What is refused


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "[2, 0.09], [0, 0.09]",
            "[1, -0.5], [2, 0.09], [0, 0.09]",
            "p.toml:6: profile.solids[1]: solid: not convex at point 2",
        ),
        (
            "[2, -1], [2, 0.09]",
            "[2, 0.09], [2, -1]",
            "p.toml:6: profile.solids[1]: solid: not convex at point",
        ),  # two faces cross
        (
            "[[0, -1], [2, -1], [2, 0.09], [0, 0.09]]",
            "[[0, 1], [0.6, -0.8], [-1, 0.3], [1, 0.3], [-0.6, -0.8]]",
            "p.toml:6: profile.solids[1]: solid: its faces cross",
        ),
        ("[2, 0.09], [0, 0.09]", "[2, -1]", "p.toml:6: profile.solids[1]: solid: points 1 and 2"),
        (
            "mass = 13.8",
            "mass = -1",
            "p.toml:14: vehicle.rear_body.mass: expected a number greater than 0, found -1",
        ),
        (
            "static = 0.9",
            "static = 0",
            "p.toml:17: friction.static: expected a number greater than 0, found 0",
        ),
        (
            "kinetic = 0.675",
            "kinetic = 1",
            "p.toml:18: friction.kinetic: expected at most friction.static, 0.9, found 1; "
            "reduce it",
        ),
        (
            "speed = 0.25",
            "speed = 0.25\nperiod = 0.005",
            "p.toml:22: control.period: "
            "expected a time between 0 and 0.0025 s = 2 J / (n kp), the stability limit of the",
        ),
        (
            "speed = 0.25",
            "speed = 0.25\nperiod = 0.0015",
            "p.toml:29: time.step: expected a multiple of control.period, 0.0015 s, found 0.01",
        ),
        (
            "speed = 0.25",
            "speed = 0.25\nperiod = 0.002\n[solver]\nmethod = 'idas'",
            "p.toml:24: solver.method: expected 'cvodes' for a sampled controller, found 'idas'",
        ),
        (
            "distance = 0.05",
            "distance = -0.02",
            "p.toml:24: start.distance: expected at least 0 m, "
            "so that the vehicle starts outside all solids, found -0.02 m: the front wheels, at "
            "x = -0.046 m, 20 mm inside solid 1",
        ),
        (
            "distance = 0.05",
            "distance = -1",
            "the front wheels, at x = 0.934 m, 90.4 mm inside solid 1",
        ),
        ("torque = 8", "joint = 0.3", "p.toml:9: vehicle: climber: expected the rear axle behind"),
        (
            "[control]",
            "[contact]\nstiffness = 1e3\n[control]",
            "p.toml:21: contact.stiffness: "
            "expected at least 4.69e+04 N/m, so that wheels sink in by at most 2 mm, found 1000",
        ),
        (
            "torque = 8",
            "torque = 8\nradius = 66",
            "p.toml:9: vehicle: climber: expected a radius "
            "below the distance of front and rear axle, 0.47 m, found 66 m; give lengths in metres",
        ),
        (
            "[2, 0.09], [0, 0.09]]",
            "[2, 0.09], [0, 0.09]]\nheight = 1",
            "p.toml:8: profile.solids[1].height: expected one of points, found the unknown key",
        ),
        (
            "points = [[0, -1]",
            "corners = [[0, -1]",
            "profile.solids[1].points: expected a value, found none",
        ),
        (
            "[2, 0.09], [0, 0.09]",
            "[1e9, 0.09], [0, 0.09]",
            "p.toml:6: profile.solids[1]: solid: expected coordinates from -10000 to 10000 m",
        ),
        (
            "speed = 0.25",
            "speed = 0.25\nintegral = 8000\nperiod = 0.002",
            "expected a time between 0 and 0.001 s = 2 kp / ki",
        ),
        (
            "speed = 0.25",
            "speed = 0.25\nnoise = { tilt = -1 }",
            "control.noise.tilt: expected a number of at least 0, found -1",
        ),
        (
            "mass = 13.8",
            "mass = 13.8\nahead = 0.1",
            "p.toml:9: vehicle: expected centres of mass "
            "such that all axles bear load on a level floor, found -63 N on the rear axle",
        ),
        ("torque = 8", "torque = 0", "p.toml:11: vehicle.torque: expected a number greater than 0"),
        (
            "[5, 0], [-5, 0]",
            "[5, 0.1], [-5, 0.1]",
            "p.toml:3: profile: expected a floor as first solid, level and at height 0 under the "
            "vehicle, found the front wheels, at x = -0.116 m, 100 mm inside it",
        ),
        (
            "[2, 0.09], [0, 0.09]",
            "[2, -0.1], [0, -0.1]",
            "p.toml:3: profile: expected a solid that wheels on the floor (the first solid, level "
            "at height 0) can touch, found none among the 1 others",
        ),
        (
            "[-5, -1], [5, -1], [5, 0], [-5, 0]",
            "[-0.2, -1], [5, -1], [5, 0], [-0.2, 0]",
            "p.toml:3: profile: expected a floor as first solid, level and at height 0 under the "
            "vehicle, found the middle wheels, at x = -0.371 m, 118 mm above it",
        ),
        (
            'verb = "climb"\n',
            'verb = "climb"\nprofile.step = { height = 0.1 }\n',
            "expected exactly one of ramp, step, kerb, stairs, solids, file, found step and solids",
        ),
    ],
)
def test_refused_by_name_with_its_bound(old, new, words, tmp_path):
    assert SOLIDS.count(old) == 1, old
    assert words in _faults(tmp_path, SOLIDS.replace(old, new))


def test_wheels_inside_what_is_behind(tmp_path):
    post = "\n[[profile.solids]]\npoints = [[-0.7, -1], [-0.5, -1], [-0.5, 0.01], [-0.7, 0.01]]\n"
    text = SOLIDS.replace("\n[vehicle]", f"{post}\n[vehicle]")
    assert "found -0.05 m: the front wheels" in _faults(tmp_path, text, "start.distance=-0.05")
    # the post is met first: behind it the vehicle would have to start inside of it
    words = _faults(tmp_path, text, "start.distance=-0.5")
    assert "start: expected a vehicle that starts outside all solids, found the middle " in words
    assert "at x = -0.4899 m, 9.72 mm inside solid 2" in words  # by hand: 9.717


@pytest.mark.usefixtures("folder")
def test_commands_for_other_problems_say_so():
    path = str(RAMP_FILE)
    for words, expected in (
        (
            ("check", path, "--set", "control.period=0.005"),
            "--set control.period: expected a time between 0 and 0.0025 s",
        ),
        (("vehicle", path), "use slipfree run"),
        (("run", path, "--cross-check"), "expected 'direct' for --cross-check, found 'climb'"),
        (("run", path, "--animation", "a.mp4"), "a.mp4: expected a name that ends in .gif"),
        (("run", path, "--animation", path), "expected a separate file"),
        (
            ("run", str(PROBLEMS / "paper_direct.toml"), "--animation", "a.gif"),
            "expected 'climb' for --animation, found 'direct'",
        ),
        (
            ("run", "p.toml", "--set", "profile={file='x.csv'}", "--csv", "x.csv"),
            "found the input x.csv",
        ),
        (
            ("check", "p.toml", "--set", "profile={file='x.csv'}"),
            "--set profile: profile.file: x.csv: expected corners of solids as text, found that it "
            "cannot be read (No such file or directory)",
        ),
    ):
        result = _invoke(*words)
        assert result.exit_code == 2, (words, result.output)
        assert expected in result.stderr, words


@pytest.mark.usefixtures("folder")
def test_check_stands_the_vehicle_before_the_obstacle():
    result = _invoke("check", "p.toml")
    assert result.exit_code == 0
    assert "start     y -0.371, z 0.0653745, velocity_y 0.25 (m, m/s)" in result.output
    assert result.output.endswith("ok\n")
