"""Tests that the direct model reproduces given platform rates of any vehicle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from helpers.cases import DATA, hills
from slipfree import (
    Analytic,
    Bicubic,
    Grid,
    ModelError,
    SolverError,
    SolverOptions,
    direct_kinematics,
    settle,
    simulate,
)
from slipfree.catalog import (
    ackermann,
    articulated,
    differential_drive,
    rocky7,
    skid_steer,
)
from slipfree.cli import app
from slipfree.files import netcdf
from slipfree.models.inverse import inverse_kinematics
from slipfree.models.steering_guide import GAIN, MAX_STEERING_RATE, steering_effects
from slipfree.models.wheel_authority import check_authority, wheel_rates
from slipfree.outcome import Outcome
from slipfree.problem.verbs import inverse as problem
from slipfree.records import leaves
from slipfree.solve.replay import replay, round_trip
from slipfree.solve.trim import apply_inputs, trim_states
from slipfree.trajectory import Stop, Trajectory

PROBLEMS = Path(__file__).parents[2] / "problems"
LIGHT = {"mass": 0.0, "wheel_mass": 0.0}  # no forces: the motion alone
FLAT, HILLS = Analytic(lambda x, _: 0 * x), Analytic(hills)
START = {"x": 2.0, "y": 0.2, "heading": -np.pi / 2 + 0.1}
MOTION = ("velocity_x", "velocity_y", "heading_rate")
CATALOG = {
    "differential_drive": differential_drive(**LIGHT),
    "ackermann": ackermann(**LIGHT),
    "skid_steer": skid_steer(**LIGHT),
    "articulated": articulated(**LIGHT),
    "rocky7": rocky7(**LIGHT),
}


def rough():
    """The ground of wmrde: six header numbers, then heights, x fastest."""
    text = (DATA / "gridsurfdata.txt").read_text()
    values = [float(each) for each in text.split(",") if each.strip()]
    n_x, n_y = int(values[2]), int(values[5])
    x, y = np.linspace(*values[:2], n_x), np.linspace(*values[3:5], n_y)
    return Bicubic(Grid(x, y, np.reshape(values[6:], (n_y, n_x)).T))


def planar(run):
    """Forward, right and yaw rate of samples."""
    heading, x, y = run["heading"], run["velocity_x"], run["velocity_y"]
    return {
        "forward": -np.sin(heading) * x + np.cos(heading) * y,
        "right": np.cos(heading) * x + np.sin(heading) * y,
        "yaw_rate": run["heading_rate"],
    }


def slip(run):
    """Root mean square over the wheels. [m/s]."""
    return np.sqrt(np.mean(run["slip_along"] ** 2 + run["slip_across"] ** 2, axis=1))


def poised(vehicle, terrain, given, **start):
    """The direct and the inverse model, and the latter at the angles that the given rates want."""
    direct = direct_kinematics(vehicle, terrain)
    dae = inverse_kinematics(vehicle, terrain, given=tuple(given))
    joints = list(steering_effects(vehicle, direct))
    errors = [f"{name}_error" for name in joints]
    stand = settle(direct, **(start or START))
    return direct, dae, trim_states(dae, stand, dae.inputs(**given), states=joints, least=errors)


def driven(direct, stand, rates):
    return apply_inputs(direct, stand, direct.inputs(**rates))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["differential_drive", "articulated", "rocky7"])
def test_every_vehicle_moves_over_hills_as_given(name):
    given = {"forward": 0.2, "yaw_rate": 0.1}
    direct, dae, start = poised(CATALOG[name], HILLS, given, x=0.3, y=-0.4, heading=0.7)
    run = simulate(
        dae, start, dae.inputs(**given), np.linspace(0, 1, 6), options=SolverOptions(tolerance=1e-8)
    )
    assert run.stop is None
    assert max(round_trip(direct, run, MOTION).values()) <= 1e-12
    for k in (0, -1):  # and without any of the code that did this at once
        again = driven(
            direct,
            run.part(slice(k, None if k else 1)),
            {label.full: float(run[label.name][k]) for label in leaves(direct.labels.u)},
        )
        for rate, value in given.items():
            assert_allclose(planar(again)[rate], value, rtol=0, atol=1e-12)
    for joint in steering_effects(CATALOG[name], direct):
        assert np.abs(run[f"{joint}_error"]).max() < 2e-3
    # of wheels that cannot be where they should
    assert slip(run).max() < (6e-3 if name == "rocky7" else 1.5e-3)


@pytest.mark.slow
def test_on_the_rough_ground_of_wmrde_the_guide_is_improved_upon():
    rover = rocky7(steered="corners", **LIGHT)
    given = {"forward": 0.2, "yaw_rate": 0.2, "right": 0.0}
    direct, dae, stand = poised(rover, rough(), given)
    joints, slips = list(steering_effects(rover, direct)), ["slip_along", "slip_across"]
    best = trim_states(dae, stand, dae.inputs(**given), states=joints, least=slips)
    for start, least, most in ((stand, 2e-2, 3e-2), (best, 0, 1.2e-2)):
        again = driven(direct, start, wheel_rates(rover, direct, start, **given))
        assert least < slip(again)[0] < most
        for name, value in given.items():
            assert_allclose(planar(again)[name], value, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_wheel_rates_are_those_of_least_slip():
    vehicle, given = CATALOG["articulated"], {"forward": 0.2, "yaw_rate": 0.1}
    direct, _, start = poised(vehicle, HILLS, given)
    rates = wheel_rates(vehicle, direct, start, joints={"bend_rate": 0.4}, **given)
    assert rates["bend_rate"] == 0.4
    names, base = [name for name in rates if name != "bend_rate"], driven(direct, start, rates)
    changes = []
    for name in names:  # what each wheel does to the given rates, by the direct model alone
        other = planar(driven(direct, start, {**rates, name: rates[name] + 1}))
        changes.append([other[each][0] - planar(base)[each][0] for each in given])
    open_ = np.linalg.svd(np.array(changes).T)[2][len(given) :]
    for direction in (*open_, *-open_):
        moved = {n: rates[n] + 0.1 * d for n, d in zip(names, direction, strict=True)}
        other = driven(direct, start, {**rates, **moved})
        for name, value in given.items():
            assert_allclose(planar(other)[name], value, rtol=0, atol=1e-12)
        assert slip(other)[0] > slip(base)[0]


@pytest.mark.slow
def test_straight_ahead_three_rates_are_one_too_many_but_fit():
    vehicle = CATALOG["skid_steer"]
    direct = direct_kinematics(vehicle, FLAT)
    stand = settle(direct)
    rates = wheel_rates(vehicle, direct, stand, forward=0.13, right=0.0, yaw_rate=0.0)
    assert_allclose(list(rates.values()), 0.13 / 0.15, rtol=0, atol=1e-12)
    with pytest.raises(ModelError, match=r"'right', which the nearest motion misses by 0\.1 m/s"):
        wheel_rates(vehicle, direct, stand, forward=0.13, right=0.1, yaw_rate=0.0)
    with pytest.raises(ModelError, match="'right' cannot be imposed: the wheels cannot move"):
        check_authority(vehicle, direct, stand, ("forward", "right", "yaw_rate"))
    with pytest.raises(ModelError, match="no equation determines multiplier_right"):
        settle(inverse_kinematics(vehicle, FLAT, given=("forward", "right", "yaw_rate")))
    with pytest.raises(ModelError, match="violation: platform rate 'right' cannot be imposed"):
        poised(vehicle, HILLS, {"forward": 0.2, "right": 0.1}, x=0.3, heading=0.7)


@pytest.mark.slow
def test_steering_that_is_off_costs_slip_and_decays_while_the_motion_is_exact():
    given, vehicle = {"forward": 0.1, "yaw_rate": 0.06}, CATALOG["ackermann"]
    dae, t = inverse_kinematics(vehicle, FLAT, given=tuple(given)), np.linspace(0, 4, 81)
    start = apply_inputs(dae, settle(dae), dae.inputs(**given))  # with the wheels straight ahead
    run = simulate(dae, start, dae.inputs(**given), t)
    for name, value in given.items():
        assert_allclose(planar(run)[name], value, rtol=0, atol=1e-12)
    assert slip(run)[0] > 1e-2
    assert slip(run)[-1] < 1e-8
    error, rate = run["steer_error"], run["steer_rate"]
    assert_allclose(
        rate, MAX_STEERING_RATE * np.tanh(GAIN / MAX_STEERING_RATE * error), rtol=0, atol=1e-12
    )
    assert np.abs(rate).max() < MAX_STEERING_RATE
    late = t > 1  # the error decays at the gain
    slope = np.polyfit(t[late], np.log(np.abs(error[late])), 1)[0]
    assert_allclose(slope, -GAIN, rtol=0.02)


@pytest.mark.slow
def test_rates_may_jump_or_be_formulas_and_the_replay_agrees():
    vehicle, t = CATALOG["ackermann"], np.linspace(0, 1, 41)
    direct, dae, start = poised(vehicle, HILLS, {"forward": 0.2, "yaw_rate": 0.1}, heading=0.3)
    jump = np.where(t[:-1] < 0.49, 0.1, -0.1)
    inputs = dae.inputs(forward=0.2 + 0.05 * ca.sin(3 * dae.t), yaw_rate=jump)
    run = simulate(dae, start, inputs, t)
    assert_allclose(planar(run)["forward"], 0.2 + 0.05 * np.sin(3 * t), rtol=0, atol=1e-12)
    assert_allclose(planar(run)["yaw_rate"][:-1], jump, rtol=0, atol=1e-12)
    again = replay(direct, run, jumps=[t[20]]).motion
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
    with pytest.raises(ModelError, match=words):
        inverse_kinematics(CATALOG["ackermann"], FLAT, given=given)


@pytest.mark.slow
def test_sought_names_are_checked():
    _, dae, start = poised(CATALOG["ackermann"], FLAT, {"forward": 0.1})
    for states, least in ((["steering"], []), (["steer"], ["slip"])):
        with pytest.raises(ModelError, match=r"(states|least): expected one of .*, found 's"):
            trim_states(dae, start, dae.inputs(forward=0.1), states=states, least=least)


CAR = ("vehicle.steered=", "vehicle.catalog=ackermann", "time.step=0.1")
CART = ("vehicle.steered=", "vehicle.catalog=differential_drive")
SHORT = ("time.duration=0.5", "vehicle.mass=0", "vehicle.wheel_mass=0")


def _invoke(*settings: str) -> Any:
    words = [word for setting in (*settings, *SHORT) for word in ("--set", setting)]
    file = str(PROBLEMS / "rover_inverse.toml")
    result = CliRunner().invoke(app, ["run", file, *words, "-o", "out.nc", "--no-draw"])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


@pytest.fixture
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
@pytest.mark.usefixtures("_folder")
def test_problem_file() -> None:
    result = _invoke("given.yaw_rate=0.1*cos(0.5*t)")
    assert (result.exit_code, result.stderr) == (0, ""), result.output
    for words in (
        "forward 0.1 m/s, yaw_rate 0.1*cos(0.5*t) rad/s",
        "rate of wheel front_right ",
        "steering steer_front_left ",
        " rad at most",
        "round trip  ",
        "wheel middle_left  ",
        "replay by the direct model  differs by at most x ",
        "outcome ",
    ):
        assert words in result.stdout, words
    run = netcdf.read("out.nc")
    assert_allclose(planar(run)["yaw_rate"], 0.1 * np.cos(0.5 * run.t), rtol=0, atol=1e-12)
    assert_allclose(planar(run)["forward"], 0.1, rtol=0, atol=1e-12)
    assert max(run.statistics[f"round_trip_{name}"] for name in MOTION) <= 1e-12
    assert run.statistics["replay_x"] < 1e-4
    assert np.abs(run["steer_front_left_error"][0]) < 1e-9
    assert {"front_right_rate", "steer_rear_left_rate", "right"} < set(run)


@pytest.mark.slow
@pytest.mark.usefixtures("_folder")
def test_a_given_steering_angle_is_kept_rates_jump_and_a_replay_may_fail(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise SolverError("it gave up", None)

    monkeypatch.setattr(problem, "replay", fail)
    jump = "given.forward=[[0, 0.1], [0.3, 0.12]]"
    result = _invoke(*CAR, "start.steer=0.2", "time.step=0.05", jump)
    assert "forward 0.1 then 0.12 m/s" in result.stdout, result.output
    assert "replay stopped early  " in result.stdout
    assert "it gave up" in result.stdout
    run = netcdf.read("out.nc")
    assert_allclose(planar(run)["forward"][run.t < 0.29], 0.1, rtol=0, atol=1e-12)
    assert_allclose(planar(run)["forward"][run.t > 0.29], 0.12, rtol=0, atol=1e-12)
    assert run["steer"][0] == 0.2
    assert run["steer_error"][0] > 0.05


@pytest.mark.slow
@pytest.mark.usefixtures("_folder")
@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            ["given={velocity_x=0.0, velocity_y=0.1, heading_rate=0.0}"],
            "'rocky7' cannot roll without slip, as inverse kinematics with the rates velocity_x, ",
        ),
        (
            ['given={velocity_x=0.0, velocity_y="t", heading_rate=0.0}'],
            "given.velocity_y: expected a number, found a function of time; give a number (only ",
        ),
        (
            [*CAR, "given.yaw_rate=q*t"],
            "given.yaw_rate: formula 'q*t': expected one of the names t, found 'q'",
        ),
        (["given.yaw_rate=true"], "expected a number, an array of [time, value] pairs, or a form"),
        (["steering=rate"], "expected 'angle' with given rates forward"),
        ([*CAR, "start.steer=0.8"], "left positive) reaches its stop"),
        (
            [*CART, "given={forward=0.1, right=0.1}", "terrain.synthetic.power_law="],
            "'differential_drive': platform rate 'right' cannot be imposed: the wheels cannot move",
        ),
    ],
)
def test_what_cannot_be_is_refused(settings: list[str], words: str) -> None:
    result = _invoke(*settings)
    assert result.exit_code == 2, result.output
    assert words in result.stderr


@pytest.mark.slow
@pytest.mark.usefixtures("_folder")
def test_what_the_integrator_reached_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: Any, start: Trajectory, *__: Any, **___: Any) -> None:
        stop = Stop("solver", 0.0, "gave up", Outcome.SOLVER_FAILURE)
        raise SolverError("gave up", replace(start, stop=stop))

    monkeypatch.setattr("slipfree.problem.verbs.base.simulate", fail)
    result = _invoke(*CAR)
    assert result.exit_code == 1
    assert "solver failure at t = 0 s: gave up\n" in result.stdout
    assert netcdf.read("out.nc").t.size == 1
