"""Tests of robot commands and of given rates: steering angles and wheel rates, with errors."""

import re
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.cases import DATA, LIGHT, PROBLEMS, hills, rover_ground
from helpers.commands import invoke, refuses, sets
from helpers.problem_files import rough_ground
from helpers.vehicles import four_wheel_steered, skid_steered
from slipfree import (
    Analytic,
    Bicubic,
    ModelError,
    SolverOptions,
    direct_kinematics,
    settle,
    simulate,
)
from slipfree.catalog import (
    ackermann,
    articulated,
    differential_drive,
    open_source_rover,
    rocky7,
    skid_steer,
)
from slipfree.control.path_following import GAIN, track_path
from slipfree.core.records import leaves
from slipfree.files import netcdf
from slipfree.models.given_rates import (
    COMMANDS,
    MAX_STEERING_RATE,
    STOP_CLEARANCE,
    check_authority,
    steering_effects,
)
from slipfree.models.given_rates import GAIN as STEERING_GAIN
from slipfree.models.inverse import inverse_kinematics
from slipfree.problem.inputs import input_files
from slipfree.problem.load import load_problem
from slipfree.solve.replay import apply_inputs, replay, round_trip, trim_states

FINE = SolverOptions(tolerance=1e-8)
FLAT, HILLS = Analytic(lambda x, _: 0 * x), Analytic(hills)
VEHICLES = {
    make.__name__: make(**LIGHT)
    for make in (differential_drive, ackermann, skid_steer, articulated, rocky7, open_source_rover)
} | {"four_wheel_steered": four_wheel_steered()}
GIVEN = {  # forward, right, yaw rate
    "four_wheel_steered": [(0.3, 0.1, 0.0), (0.0, 0.0, 0.4), (-0.2, 0.1, -0.3)],
    "ackermann": [(0.3, 0, -0.2), (-0.2, 0, 0.1)],
    "open_source_rover": [(0.2, 0, 0.3), (0, 0, 0.4), (-0.3, 0, 0.2)],
}
START = {"x": 0.3, "y": -0.4, "heading": 0.7}
MOTION = ("velocity_x", "velocity_y", "heading_rate")


@lru_cache(maxsize=16)
def models(vehicle, terrain):
    """The direct model, and the model of all three commands."""
    direct = direct_kinematics(vehicle, terrain)
    return direct, inverse_kinematics(vehicle, terrain, given=tuple(COMMANDS), exact=False)


def poised(vehicle, terrain, command, **start):
    """Both models, the inputs, and the start with the steering that the command leads to."""
    direct, dae = models(vehicle, terrain)
    inputs = dae.inputs(**dict(zip(COMMANDS, command, strict=True)))
    sought = [name for name in steering_effects(direct) if name not in start]
    errors = [f"{name}_error" for name in sought]
    stand = settle(direct, **(START | start))
    return direct, dae, inputs, trim_states(dae, stand, inputs, states=sought, least=errors)


def planar(run):
    """Forward, right and yaw rate of samples, shape (3, n)."""
    c, s = np.cos(run["heading"]), np.sin(run["heading"])
    x, y = run["velocity_x"], run["velocity_y"]
    return np.array([c * y - s * x, c * x + s * y, run["heading_rate"]])


def named_rates(run):
    return dict(zip(COMMANDS, planar(run), strict=True))


def announced(run):
    """The errors of the given rates, shape (3, n)."""
    return np.array([run[f"{name}_error"] for name in COMMANDS])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "command"), [(n, c) for n, given in GIVEN.items() for c in given])
def test_level_ground_against_closed_forms(name, command):
    vehicle, (forward, right, yaw_rate) = VEHICLES[name], command
    _, _, _, start = poised(vehicle, FLAT, command, heading=0.0)
    for k, wheel in enumerate(vehicle.wheels):
        x, y = (start[f"center_{axis}"][0, k] - start[axis][0] for axis in "xy")
        velocity = np.array([right - yaw_rate * y, forward + yaw_rate * x])
        angle = start[f"steer_{wheel.name}"][0] if f"steer_{wheel.name}" in start else 0.0
        if name == "ackermann" and "front" in wheel.name:
            length, half = 0.7, 0.3 * (1 if "right" in wheel.name else -1)
            tangent = np.tan(start["steer"][0])
            assert_allclose(tangent * forward, length * yaw_rate, rtol=0, atol=1e-9)
            angle = np.arctan2(length * tangent, length + half * tangent)
        along, across = np.array([[-np.sin(angle), np.cos(angle)], [np.cos(angle), np.sin(angle)]])
        assert_allclose(velocity @ across, 0, rtol=0, atol=1e-9)
        rate = velocity @ along / wheel.radius
        assert_allclose(start["wheel_rate"][0, k], rate, rtol=0, atol=1e-9)
    assert_allclose(announced(start), 0, rtol=0, atol=1e-9)
    assert_allclose(planar(start)[:, 0], command, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "command"),
    [("four_wheel_steered", (0.25, 0.0, 0.1)), ("open_source_rover", (0.2, 0.1, 0.05))],
)
def test_on_hills_the_platform_follows_within_the_announced_error(name, command):
    direct, dae, inputs, start = poised(VEHICLES[name], HILLS, command)
    run = simulate(dae, start, inputs, np.linspace(0, 2, 21), options=FINE)
    assert run.stop is None
    assert max(round_trip(direct, run, MOTION).values()) < 1e-11
    again = replay(direct, run)[0]  # wheel and joint rates alone
    assert again.t.size == run.t.size
    missed = np.array(command)[:, None] - planar(again)
    assert_allclose(missed, announced(run), rtol=0, atol=1e-4)
    if name == "four_wheel_steered":  # can do all of them
        assert np.abs(missed).max() < 5e-3
        assert np.hypot(run["slip_along"], run["slip_across"]).max() < 5e-3
    assert np.abs(run["wheel_rate"]).max() < 1.7 * max(1.0, np.abs(start["wheel_rate"]).max())


def test_the_steering_turns_from_given_angles_and_errors_vanish():
    vehicle = VEHICLES["four_wheel_steered"]
    straight = dict.fromkeys(steering_effects(models(vehicle, FLAT)[0]), 0.0)
    _, dae, inputs, start = poised(vehicle, FLAT, (0.0, 0.0, 0.3), **straight)
    run = simulate(dae, start, inputs, np.linspace(0, 5, 51))
    error = np.abs(announced(run)) * np.array([[1.0], [1.0], [0.5]])
    slip = np.hypot(run["slip_along"], run["slip_across"])
    assert error[:, 0].max() > 0.05
    assert error[:, -1].max() < 1e-7
    assert slip[-1].max() < 1e-6
    assert np.abs(run["wheel_rate"]).max() < 1.2 * 0.3 * 0.5 / 0.15
    assert_allclose(
        [run[name][-1] for name in straight], np.array([1, -1, -1, 1]) * np.arctan2(4, 3), atol=1e-6
    )


def test_a_vehicle_that_cannot_comes_as_near_as_it_can():
    vehicle = differential_drive(**LIGHT)
    _, dae, inputs, start = poised(vehicle, FLAT, (0.2, 0.1, 0.1))
    assert_allclose(announced(start)[:, 0], [0.0, 0.1, 0.0], atol=1e-9)  # its axle is its centre
    assert simulate(dae, start, inputs, [0.0, 0.5]).stop is None


@pytest.mark.slow
def test_rates_and_stops_of_the_steering_are_kept_and_do_not_end_the_motion():
    vehicle = ackermann(**LIGHT)
    steer = [c for c in vehicle.coordinates if c.name == "steer"]
    others = [c for c in vehicle.coordinates if c.name != "steer"]
    vehicle = replace(vehicle, coordinates=(*others, replace(steer[0], max_rate=0.3)))
    _, dae, inputs, start = poised(vehicle, HILLS, (0.1, 0.0, 0.4), steer=-0.2)
    run = simulate(dae, start, inputs, np.linspace(0, 6, 121))
    assert run.stop is None
    assert 0.299 < run["steer_rate"].max() <= 0.3
    assert_allclose(run["steer"][-1], 0.7 - STOP_CLEARANCE, atol=1e-7)
    assert run["steer"].max() <= 0.7
    assert np.abs(announced(run)[:, -1]).max() > 0.01  # the stop costs the command
    _, _, _, start = poised(vehicle, HILLS, (0.1, 0.0, 0.4))
    assert_allclose(start["steer"], 0.7 - STOP_CLEARANCE, atol=1e-7)
    # exact: the wheels slip more
    dae = inverse_kinematics(vehicle, HILLS, given=("forward", "yaw_rate"))
    inputs = dae.inputs(forward=0.1, yaw_rate=0.4)
    run = simulate(dae, apply_inputs(dae, start, inputs), inputs, [0.0, 1.0])
    assert run.stop is None
    assert_allclose(planar(run)[[0, 2]], [[0.1, 0.1], [0.4, 0.4]], rtol=0, atol=1e-9)


def test_a_wheel_points_backward_if_that_alone_is_within_its_stops():
    vehicle = four_wheel_steered(lower=-1.0, upper=2.0)
    direct, _, _, start = poised(vehicle, FLAT, (0.1, 0.3, 0.0))
    angles = [start[name][0] for name in steering_effects(direct)]
    assert_allclose(angles, np.pi - np.arctan2(0.3, 0.1), rtol=0, atol=1e-9)
    assert_allclose(start["wheel_rate"], -np.hypot(0.3, 0.1) / 0.15, rtol=0, atol=1e-9)
    assert_allclose(announced(start), 0, rtol=0, atol=1e-9)


@pytest.mark.slow
def test_a_wheel_turns_back_where_its_target_passes_the_stop():
    vehicle, t = four_wheel_steered(lower=-1.9, upper=1.9), np.linspace(0, 6, 61)
    direct, dae, _, start = poised(vehicle, HILLS, (0.2, 0.0, 0.0))
    inputs = dae.inputs(forward=0.2 * ca.cos(dae.t / 2), right=0.2 * ca.sin(dae.t / 2), yaw_rate=0)
    run = simulate(dae, start, inputs, t, options=SolverOptions(tolerance=1e-6))
    assert run.stop is None
    for name in steering_effects(direct):
        assert run[name].min() < -1.7
        assert run[name][-1] > 0
        assert np.abs(run[name]).max() < 1.9
    assert np.abs(announced(run)[:, t > 5.8]).max() < 0.03  # of the lag of 0.2 s


@pytest.mark.slow
def test_commands_may_jump_and_reverse():
    vehicle, t = VEHICLES["four_wheel_steered"], np.linspace(0, 4, 81)
    direct, dae, _, start = poised(vehicle, HILLS, (0.2, 0.0, 0.0))
    early = t[:-1] < 1.99
    inputs = dae.inputs(
        forward=np.where(early, 0.2, -0.2), right=np.where(early, 0.0, 0.1), yaw_rate=0.0
    )
    run = simulate(dae, start, inputs, t)
    assert np.abs(announced(run)[:, t < 1.99]).max() < 2e-3
    assert np.abs(announced(run)[:, -1]).max() < 2e-3
    assert np.abs(run["steer_rear_left_rate"]).max() < MAX_STEERING_RATE
    again = replay(direct, run, jumps=[t[40]])[0]
    assert_allclose(again["x"], run["x"], atol=1e-4)
    assert_allclose(again["y"], run["y"], atol=1e-4)


@pytest.mark.slow
def test_a_path_with_a_heading_is_followed():
    vehicle, t = VEHICLES["four_wheel_steered"], np.linspace(0, 12, 25)
    direct, dae = models(vehicle, HILLS)
    path = 0.3 * np.sin(0.3 * t), 0.15 * t, 0.2 * np.sin(0.4 * t)
    dae, inputs = track_path(dae, t, *path)
    sought = list(steering_effects(direct))
    stand, errors = settle(direct, x=0.1), [f"{each}_error" for each in sought]  # beside the path
    run = simulate(dae, trim_states(dae, stand, inputs, states=sought, least=errors), inputs, t)
    assert run.stop is None
    apart = np.hypot(run["x"] - path[0], run["y"] - path[1])
    assert_allclose(run["path_error"], apart, rtol=0, atol=1e-9)
    assert_allclose(run["heading_error"], path[2] - run["heading"], rtol=0, atol=1e-9)
    assert_allclose(apart[0], 0.1)
    assert apart[t > 6 / GAIN].max() < 0.01
    assert np.abs(run["heading_error"][t > 6]).max() < 0.01


def test_exactness_is_refused_in_words_that_name_the_remedy():
    words = r"no more given rates than driven wheels \(2\).*or set exact = false"
    given = {"given": tuple(COMMANDS)}
    refuses(ModelError, words, inverse_kinematics, VEHICLES["ackermann"], FLAT, **given)


FOUR_WHEELS = (DATA / "crab.toml").read_text()
PROBLEM = """\
verb = "inverse"
frame = "rep103"
vehicle = { file = "crab.toml" }
start = { heading = 1.5707963267948966 }
given = { v_x = 0.2, v_y = 0.1, omega_z = 0.0 }
time = { duration = 1.0, step = 0.1 }
solver = { tolerance = 1e-6 }
""" + rough_ground("[-2, 2]", "[-2, 2]", 0.1, "rms = 0.02, longest = 3.0, shortest = 1.0", 3)


@pytest.fixture
def folder(folder):
    (folder / "crab.toml").write_text(FOUR_WHEELS)
    (folder / "p.toml").write_text(PROBLEM)
    (folder / "cmd.csv").write_text("t,omega_z,v_x,v_y\n0,0.0,0.2,0.1\n\n0.5,0.3,0.1,-0.1\n")
    return folder


def _run(*settings: str, code: int = 0) -> Any:
    words = ["--no-draw"] if code else ["--no-draw", "-v"]
    result = invoke("run", "p.toml", "-o", "p.nc", *words, *sets(*settings), code=code)
    return result.stderr if code else (result.stdout, netcdf.read("p.nc"))


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_a_robots_command_counts_left_positive():
    words, run = _run()
    assert "v_x 0.2 m/s, v_y 0.1 m/s, omega_z 0 rad/s" in words
    errors = re.findall(r"(?m)^errors  .*", words)[0]
    assert all(f" {name} " in errors for name in COMMANDS)
    assert "margin" not in words.split("contact error")[0].replace("tip-over margin", "")
    assert_allclose(run["right"], -0.1)
    assert run["x"][-1] < -0.05  # the heading is that of +y: left is west
    _, same = _run("given={forward=0.2, right=-0.1, yaw_rate=0.0}")
    assert_allclose(same["x"], run["x"], rtol=0, atol=0)
    _, formula = _run("given.v_y='0.1*cos(0*t)'")
    assert_allclose(formula["x"], run["x"], rtol=0, atol=1e-9)


def test_the_summary_names_the_steering_that_is_held_at_its_stop(folder):
    (folder / "crab.toml").write_text(
        FOUR_WHEELS.replace("lower = -2, upper = 2", "lower = -0.3, upper = 0.3")
    )
    words, run = _run("given.v_x=-0.2", "given.v_y=-0.1")
    assert re.findall(r"steering (\w+) .* reaches its stop", words) == ["rl"]
    assert_allclose(run["rl"], 0.3, rtol=0, atol=2 * STOP_CLEARANCE)


@pytest.mark.slow
def test_commands_in_time_from_a_file(folder):
    words, run = _run("given={file='cmd.csv'}", "time.step=0.05")
    assert "omega_z, v_x, v_y of cmd.csv" in words
    assert "while the steering is at its target" in words
    late = run.t > 0.49
    assert_allclose(run["yaw_rate"], np.where(late, 0.3, 0.0), rtol=0, atol=0)
    assert_allclose(run["right"], np.where(late, 0.1, -0.1), rtol=0, atol=0)
    assert run.facts["replay_x"].value < 1e-4
    assert 0.45 < np.abs(run["fr_rate"]).max() <= 0.5 < np.abs(run["fl_rate"]).max()
    problem = load_problem(folder / "p.toml", ["given={file='cmd.csv'}"])
    assert set(input_files(problem)) == {"crab.toml", "cmd.csv"}
    words, run = _run("given={file='cmd.csv'}", "time.step=0.5")
    assert "replay stopped early" in words
    assert "reduce 'step' in [time]" in words
    (folder / "cmd.csv").write_text("t,v_x\n0,0.2\n")
    _, run = _run("given={file='cmd.csv', v_y=[[0, 0.1], [0.5, 0.0]], omega_z=0}")
    assert_allclose(run["right"], np.where(late[::2], 0.0, -0.1), rtol=0, atol=0)


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_a_path_in_a_problem():
    path = (
        "path={t=[0,1,2,3,4,5], x=[0,-0.1,-0.2,-0.3,-0.4,-0.5], y=[0,0.1,0.2,0.3,0.4,0.5], heading="
    )
    words, run = _run("given=", path + "[1.5707963267948966, 1.57, 1.56, 1.55, 1.54, 1.53]}")
    assert "path of 6 way-points in 5 s" in words
    assert re.search(r"errors .* path .* m at the end\), heading .* rad at the end", words)
    assert run["path_error"].max() < 3e-3
    assert np.abs(run["heading_error"]).max() < 3e-3
    assert_allclose([run["x"][-1], run["y"][-1]], [-0.1, 0.1], atol=3e-3)


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["exact=true"], "platform rate 'right' cannot be imposed: with the current steering ang"),
        (["given={file='late.csv'}"], "late.csv: expected 0 as the first time, found 1 s"),
        (["given={file='back.csv'}"], "back.csv: expected increasing times, found 1 s after 2 s"),
        (["given={file='names.csv'}"], "names.csv: expected one or more rows of numbers, found"),
        (["given={file='cmd.csv', v_x=0.1}"], "expected only rates that are not in the CSV file"),
        (["given={file='cmd.csv', forward=0.1}"], "rates of the same kind as omega_z, v_x, v_y in"),
    ],
)
def test_what_is_wrong_is_refused(settings, words):
    Path("late.csv").write_text("t,v_x\n1,0.2\n")
    Path("back.csv").write_text("t,v_x\n0,0.2\n2,0.1\n1,0.2\n")
    Path("names.csv").write_text("t,v_x\n")
    assert words in _run(*settings, code=2)


def test_without_steering_all_but_the_velocity_across_is_met():
    direct, dae, inputs, start = poised(skid_steered(), HILLS, (0.3, 0.0, 0.2))
    run = simulate(dae, start, inputs, np.linspace(0, 2, 21), options=FINE)
    assert run.stop is None
    missed = np.array([[0.3], [0.0], [0.2]]) - planar(run)
    assert_allclose(missed[[0, 2]], 0, rtol=0, atol=1e-9)
    assert_allclose(announced(run), missed, rtol=0, atol=1e-9)
    again = planar(replay(direct, run)[0])
    assert_allclose(again[[0, 2]], [[0.3] * run.t.size, [0.2] * run.t.size], rtol=0, atol=1e-6)


# Given rates, exactly


def slip(run):
    """Root mean square over the wheels. [m/s]."""
    return np.sqrt(np.mean(run["slip_along"] ** 2 + run["slip_across"] ** 2, axis=1))


def poised_exactly(vehicle, terrain, given, **start):
    """The direct and the inverse model, and the latter at the angles that the given rates want."""
    direct = direct_kinematics(vehicle, terrain)
    dae = inverse_kinematics(vehicle, terrain, given=tuple(given))
    joints = list(steering_effects(direct))
    errors = [f"{name}_error" for name in joints]
    stand = settle(direct, **(start or {"x": 2.0, "y": 0.2, "heading": 0.1 - np.pi / 2}))
    return direct, dae, trim_states(dae, stand, dae.inputs(**given), states=joints, least=errors)


def driven(direct, sample):
    """The instant of the direct model under the rates of a sample of another model."""
    rates = {label.full: float(sample[label.name][-1]) for label in leaves(direct.labels.u)}
    return apply_inputs(direct, sample, direct.inputs(**rates))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["differential_drive", "articulated", "rocky7"])
def test_every_vehicle_moves_over_hills_as_given(name):
    given = {"forward": 0.2, "yaw_rate": 0.1}
    direct, dae, start = poised_exactly(VEHICLES[name], HILLS, given, x=0.3, y=-0.4, heading=0.7)
    run = simulate(dae, start, dae.inputs(**given), np.linspace(0, 1, 6), options=FINE)
    assert run.stop is None
    assert max(round_trip(direct, run, MOTION).values()) <= 1e-12
    for k in (0, -1):  # and without any of the code that did this at once
        again = driven(direct, run.part(slice(k, None if k else 1)))
        for rate, value in given.items():
            assert_allclose(named_rates(again)[rate], value, rtol=0, atol=1e-12)
    for joint in steering_effects(direct):
        assert np.abs(run[f"{joint}_error"]).max() < 2e-3
    # of wheels that cannot be where they should
    assert slip(run).max() < (6e-3 if name == "rocky7" else 1.5e-3)


@pytest.mark.slow
def test_on_the_rough_ground_of_wmrde_the_guide_is_improved_upon():
    rover = rocky7(steered="corners", **LIGHT)
    given = {"forward": 0.2, "yaw_rate": 0.2, "right": 0.0}
    direct, dae, stand = poised_exactly(rover, Bicubic(rover_ground()), given)
    joints, slips = list(steering_effects(direct)), ["slip_along", "slip_across"]
    best = trim_states(dae, stand, dae.inputs(**given), states=joints, least=slips)
    for start, least, most in ((stand, 2e-2, 3e-2), (best, 0, 1.2e-2)):
        again = driven(direct, start)
        assert least < slip(again)[0] < most
        for name, value in given.items():
            assert_allclose(named_rates(again)[name], value, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_three_rates_are_one_too_many_for_two_sides():
    vehicle = VEHICLES["skid_steer"]
    direct = direct_kinematics(vehicle, FLAT)
    stand = settle(direct)
    with pytest.raises(ModelError, match="'right' cannot be imposed: the wheels cannot move"):
        check_authority(direct, stand, ("forward", "right", "yaw_rate"))
    with pytest.raises(ModelError, match="no equation determines multiplier_right"):
        settle(inverse_kinematics(vehicle, FLAT, given=("forward", "right", "yaw_rate")))
    with pytest.raises(ModelError, match="violation: platform rate 'right' cannot be imposed"):
        poised_exactly(vehicle, HILLS, {"forward": 0.2, "right": 0.1}, x=0.3, heading=0.7)


@pytest.mark.slow
def test_steering_that_is_off_costs_slip_and_decays_while_the_motion_is_exact():
    given, vehicle = {"forward": 0.1, "yaw_rate": 0.06}, VEHICLES["ackermann"]
    dae, t = inverse_kinematics(vehicle, FLAT, given=tuple(given)), np.linspace(0, 4, 81)
    start = apply_inputs(dae, settle(dae), dae.inputs(**given))  # with the wheels straight ahead
    run = simulate(dae, start, dae.inputs(**given), t)
    for name, value in given.items():
        assert_allclose(named_rates(run)[name], value, rtol=0, atol=1e-12)
    assert slip(run)[0] > 1e-2
    assert slip(run)[-1] < 1e-8
    error, rate = run["steer_error"], run["steer_rate"]
    assert_allclose(
        rate,
        MAX_STEERING_RATE * np.tanh(STEERING_GAIN / MAX_STEERING_RATE * error),
        rtol=0,
        atol=1e-12,
    )
    assert np.abs(rate).max() < MAX_STEERING_RATE
    late = t > 1  # the error decays at the gain
    slope = np.polyfit(t[late], np.log(np.abs(error[late])), 1)[0]
    assert_allclose(slope, -STEERING_GAIN, rtol=0.02)


@pytest.mark.slow
def test_rates_may_jump_or_be_formulas_and_the_replay_agrees():
    vehicle, t = VEHICLES["ackermann"], np.linspace(0, 1, 41)
    direct, dae, start = poised_exactly(
        vehicle, HILLS, {"forward": 0.2, "yaw_rate": 0.1}, heading=0.3
    )
    jump = np.where(t[:-1] < 0.49, 0.1, -0.1)
    inputs = dae.inputs(forward=0.2 + 0.05 * ca.sin(3 * dae.t), yaw_rate=jump)
    run = simulate(dae, start, inputs, t)
    assert_allclose(named_rates(run)["forward"], 0.2 + 0.05 * np.sin(3 * t), rtol=0, atol=1e-12)
    assert_allclose(named_rates(run)["yaw_rate"][:-1], jump, rtol=0, atol=1e-12)
    again = replay(direct, run, jumps=[t[20]])[0]
    assert_allclose(again.t, t)
    assert_allclose(again["x"], run["x"], rtol=0, atol=1e-5)
    assert_allclose(again["y"], run["y"], rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (("forward", "left"), "only names from forward, right, yaw_rate, found 'left'"),
        (("forward", "forward"), "different rates, found forward, forward"),
        ((), "different rates, found none"),
        (("forward", "right", "yaw_rate"), "driven wheels .2., found 3: .*; remove 'right'"),
    ],
)
def test_given_rates_are_checked(given, words):
    refuses(ModelError, words, inverse_kinematics, VEHICLES["ackermann"], FLAT, given=given)


SHORT = ("time.duration=0.5", "vehicle.mass=0", "vehicle.wheel_mass=0")


def _run_rover(*settings: str) -> Any:
    file = PROBLEMS / "rover_inverse.toml"
    return invoke("run", file, "-o", "p.nc", "--no-draw", *sets(*settings, *SHORT))


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_problem_file():
    result = _run_rover("given.yaw_rate=0.1*cos(0.5*t)")
    assert (result.exit_code, result.stderr) == (0, ""), result.output
    result = invoke("info", "p.nc")
    for words in (
        *("forward 0.1 m/s, yaw_rate 0.1*cos(0.5*t) rad/s", "rate of wheel front_right "),
        *("steering steer_front_left ", " rad at most", "round trip  ", "wheel middle_left  "),
        *("replay by the direct model  differs by at most x ", "outcome "),
    ):
        assert words in result.stdout, words
    run = netcdf.read("p.nc")
    assert_allclose(named_rates(run)["yaw_rate"], 0.1 * np.cos(0.5 * run.t), rtol=0, atol=1e-12)
    assert_allclose(named_rates(run)["forward"], 0.1, rtol=0, atol=1e-12)
    assert max(run.facts[f"round_trip_{name}"].value for name in MOTION) <= 1e-12
    assert run.facts["replay_x"].value < 1e-4
    assert np.abs(run["steer_front_left_error"][0]) < 1e-9
    assert {"front_right_rate", "steer_rear_left_rate", "right"} < set(run)


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_a_given_steering_angle_is_kept_and_rates_jump():
    car = ("vehicle.steered=", "vehicle.catalog=ackermann", "start.steer=0.2", "time.step=0.05")
    _run_rover(*car, "given.forward=[[0, 0.1], [0.3, 0.12]]")
    assert "forward 0.1 then 0.12 m/s" in invoke("info", "p.nc").stdout
    run = netcdf.read("p.nc")
    assert_allclose(named_rates(run)["forward"][run.t < 0.29], 0.1, rtol=0, atol=1e-12)
    assert_allclose(named_rates(run)["forward"][run.t > 0.29], 0.12, rtol=0, atol=1e-12)
    assert run["steer"][0] == 0.2
    assert run["steer_error"][0] > 0.05
