"""Tests of angles and rates with units in files, and of bare numbers that look like degrees."""

from __future__ import annotations

import pickle
from math import pi
from pathlib import Path

import pytest

from slipfree.files.toml.source import ProblemError
from slipfree.files.toml.types import AngleWithUnit, RateWithUnit, parse_unit
from slipfree.files.vehicle_toml import open_file, read_toml
from slipfree.problem.load import load_problem
from slipfree.problem.result import build

ROOT = Path(__file__).parents[2]
PROBLEM = """\
verb = "direct"
terrain.synthetic = { x = [-3, 3], y = [-3, 3], spacing = 0.5 }
vehicle = { catalog = "three_wheeler", tilt_stop = "30 deg" }
start = { x = 0.5, heading = "90 deg" }
time = { duration = 1, step = 0.5 }

[inputs]
right_rate = "90 deg/s"
left_rate = [[0, "45 deg/s"], [0.5, 1.0]]
steer_rate = "0.1 rad/s"
"""
PLAN = """\
verb = "plan"
terrain.synthetic = { x = [-3, 3], y = [-3, 3], spacing = 0.5 }
vehicle = { catalog = "three_wheeler" }
start = { heading = 0.0 }
inputs = { right_rate = 0.5, left_rate = 0.5, steer_rate = 0.0 }
goal = { y = 0.5, heading = "1 deg" }
costs = { slip = 1 }
limits = { pitch = ["-20 deg", "20 deg"] }
bounds = { right_rate = ["-200 deg/s", "200 deg/s"] }
accelerations = { right_rate = ["-90 deg/s2", "90 deg/s2"] }
time = { duration = 1, step = 0.5 }
"""
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


def _refused(tmp_path: Path, text: str, *settings: str) -> str:
    path = tmp_path / "p.toml"
    path.write_text(text)
    with pytest.raises(ProblemError) as caught:
        build(load_problem(path, settings))
    return str(caught.value).replace(f"{tmp_path}/", "")


def test_text_with_a_unit_is_a_number_in_si_units() -> None:
    assert parse_unit("-30 deg") == pytest.approx(-pi / 6)
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
    path.write_text(PROBLEM)
    spec = load_problem(path).spec
    setup = build(load_problem(path))
    assert setup.start["heading"][0] == pytest.approx(pi / 2)
    assert setup.vehicle.coordinates[0].upper == pytest.approx(pi / 6)
    assert spec.inputs["right_rate"] == pytest.approx(pi / 2)
    assert spec.inputs["left_rate"] == ((0.0, pytest.approx(pi / 4)), (0.5, 1.0))


def test_a_plan_and_commands_in_degrees(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(PLAN)
    spec = build(load_problem(path)).spec
    assert spec.goal["heading"] == pytest.approx((pi / 180, pi / 180))
    assert spec.limits["pitch"] == pytest.approx((-pi / 9, pi / 9))
    assert spec.accelerations["right_rate"] == pytest.approx((-pi / 2, pi / 2))
    path.write_text(INVERSE)
    assert load_problem(path).spec.given["yaw_rate"] == pytest.approx(pi / 90)
    build(load_problem(path))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "setting", "words"),
    [
        (PROBLEM, "start.heading=90", "--set start.heading: expected radians (did you mean 90 deg"),
        (PROBLEM, 'start.heading="5 deg/s"', "expected a number in rad, found an angular rate"),
        (PROBLEM, 'start.heading="5 dog"', 'text with an angular unit, as in "30 deg" or "5 deg'),
        (PLAN, "goal.heading=45", 'write "45 deg"), found 45'),
        (PLAN, "limits.pitch=[-20, 20]", 'write "-20 deg"), found -20'),
        (PLAN, 'way_points=[{at=0.5, heading="1 rad/s"}]', "in rad, found an angular rate"),
    ],
)
def test_other_units_and_bare_degrees_are_refused(
    tmp_path: Path, text: str, setting: str, words: str
) -> None:
    assert words in _refused(tmp_path, text, setting)


def test_bare_rates_and_large_angles_with_a_unit_are_accepted(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(PROBLEM)
    setup = build(load_problem(path, ['start.heading="450 deg"', "inputs.right_rate=8"]))
    assert setup.start["heading"][0] == pytest.approx(2.5 * pi)
    path.write_text(PLAN)
    build(load_problem(path, ["bounds.right_rate=[-100, 100]", "limits.wheel_rate=[-10, 10]"]))


def test_a_vehicle_file_in_degrees(tmp_path: Path) -> None:
    path = tmp_path / "v.toml"
    path.write_text(VEHICLE)
    swivel = read_toml(open_file(path)).coordinates[0]
    assert (swivel.lower, swivel.upper) == pytest.approx((-pi / 4, pi / 4))
    assert swivel.max_rate == pytest.approx(pi / 6)
    for old, new, words in (
        ('"45 deg"', '"45 deg/s"', "expected a number in rad, found an angular rate"),
        ('"45 deg"', "45", 'expected radians (did you mean 45 degrees? write "45 deg"), found 45'),
        ('"30 deg/s"', '"30 deg"', "expected a number in rad/s, found an angle"),
    ):
        path.write_text(VEHICLE.replace(old, new))
        with pytest.raises(ProblemError) as caught:
            read_toml(open_file(path))
        assert words in str(caught.value)
