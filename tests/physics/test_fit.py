"""Calibration: derivatives, recovery of known numbers, covariance, undetermined combinations."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.commands import refuses
from slipfree import (
    Analytic,
    Compliant,
    Coulomb,
    LeastSlip,
    ModelError,
    SolverOptions,
    catalog,
    direct_kinematics,
    dynamics,
    quasi_statics,
    settle,
    simulate,
)
from slipfree.core.dae import PiecewiseLinear
from slipfree.core.rearrange import with_values
from slipfree.core.records import Array
from slipfree.fit.body_motion import BodyMotion, body_motion, velocities
from slipfree.fit.estimate import Estimate, Predictor, bootstrap, calibrate, estimate, position_rms
from slipfree.fit.unknowns import Unknown, parametric_model, with_unknowns
from slipfree.fit.windows import Log, Windows, cut, end_poses
from slipfree.laws.soil import Soil

LEVEL = Analytic(lambda x, _: 0 * x, mu=0.6)
SIDES = {end: (f"front_{end}", f"rear_{end}") for end in ("left", "right")}
RADII = tuple(Unknown(f"radius_{end}", "radius", SIDES[end]) for end in SIDES)
SKID = (
    *RADII,
    Unknown("track", "track"),
    Unknown("center_of_mass_ahead", "center_of_mass_ahead"),
    Unknown("creep", "creep"),
)
SENSOR = tuple(Unknown(name, name) for name in ("sensor_right", "sensor_ahead", "sensor_heading"))


def static(vehicle: Any, law: Any) -> Any:
    """Return a quasi-static model on level ground."""
    return quasi_statics(vehicle, LEVEL, law=law)


def kinematic(vehicle: Any, law: Any) -> Any:
    """Return a kinematic model on level ground."""
    return direct_kinematics(vehicle, LEVEL, slip=law)


CASES = {
    "quasi-static": (static, catalog.skid_steer(), Coulomb(0.1), (*SKID, Unknown("grip", "grip"))),
    "closure": (kinematic, catalog.skid_steer(), LeastSlip(), SKID[:3]),
    "pressed": (kinematic, catalog.rigid_skid_steer(), LeastSlip(), SKID[:3]),
    "soil": (
        static,
        catalog.skid_steer(),
        Soil(creep=0.01),
        (*SKID[2:3], Unknown("phi", "friction_angle"), Unknown("c", "cohesion")),
    ),
}


def _rates(motion: BodyMotion, count: int, seed: int = 0) -> Array:
    """Return rates of both sides at samples."""
    left, right = np.random.default_rng(seed).uniform(1, 5, (2, count))
    return np.column_stack([left if "left" in name else right for name in motion.names])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["quasi-static", "pressed", "soil"])
def test_derivatives_of_the_velocity(name: str) -> None:
    build, vehicle, law, unknowns = CASES[name]
    dae = parametric_model(build, vehicle, law, unknowns)
    motion = body_motion(dae)
    given, p = _rates(motion, 5), np.array([each.value for each in dae.p])
    found = velocities(motion, given, p)
    for k, size in enumerate(np.maximum(np.abs(p), 0.1)):
        step = np.zeros(p.size)
        step[k] = 1e-5 * size
        ends = [velocities(motion, given, p + sign * step, found).values for sign in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * step[k])
        assert_allclose(found.slopes[..., k], slope, atol=1e-6 * max(1, np.abs(slope).max()))


@pytest.mark.slow
def test_velocity_is_that_of_a_simulation() -> None:
    build, vehicle, law, unknowns = CASES["pressed"]
    parametric = parametric_model(build, vehicle, law, unknowns)
    motion, dae = body_motion(parametric), build(vehicle, law)
    (given,) = _rates(motion, 1)
    inputs = dae.inputs(**dict(zip(motion.names, given, strict=True)))
    run = simulate(dae, settle(dae), inputs, [0.0, 1.0])
    (forward,) = np.hypot(np.diff(run["x"]), np.diff(run["y"]))
    p = np.array([each.value for each in parametric.p])
    right, ahead, turning = velocities(motion, given[None], p).values[0]
    assert_allclose(run["heading"][-1], turning, rtol=1e-5)
    chord = np.hypot(right, ahead) * np.sin(turning / 2) / (turning / 2)
    assert_allclose(forward, chord, rtol=1e-5)


def test_parameters_change_without_building_again() -> None:
    build, vehicle, law, unknowns = CASES["closure"]
    static_build, _, _, _ = CASES["quasi-static"]
    values = [0.16, 0.14, 0.7]
    dae = parametric_model(build, vehicle, law, unknowns)
    named = {each.name: value for each, value in zip(unknowns, values, strict=True)}
    wheels = [f"{name}_rate" for name in (*SIDES["left"], *SIDES["right"])]
    rates = dict(zip(wheels, (1.0, 1.0, 2.0, 2.0), strict=True))
    for changed, built in (
        (with_values(dae, **named), build(with_unknowns(vehicle, unknowns, values), law)),
        (
            with_values(parametric_model(static_build, vehicle, Coulomb(0.1), SKID), creep=0.02),
            static_build(vehicle, Coulomb(0.02)),
        ),
    ):
        ends = [simulate(m, settle(m), m.inputs(**rates), [0.0, 1.0]) for m in (changed, built)]
        assert_allclose(ends[0]["heading"], ends[1]["heading"], atol=1e-9)
    with pytest.raises(ModelError, match=r"one of radius_left, radius_right, track, found 'mass'"):
        with_values(dae, mass=3.0)
    with pytest.raises(ModelError, match=r"numbers in place of the parameters radius_left"):
        simulate(dae, settle(build(vehicle, law)), dae.inputs(**rates), [0.0, 1.0])


def _windows(motion: BodyMotion, p: Array, sensor: Array | None = None) -> Windows:
    """Return windows of a vehicle with parameters ``p``, without errors."""
    count = 60
    given = np.repeat(_rates(motion, count)[:, None], 3, axis=1)
    speed = velocities(motion, given[:, 0], p).values
    order = np.arange(float(count))
    windows = Windows(order, 3 * order, np.ones((count, 2)), given, np.zeros((count, 3)))
    at = np.zeros(3) if sensor is None else sensor
    end, *_ = end_poses(windows, np.repeat(speed[:, None], 3, axis=1), at)
    return windows._replace(end=end)


TRUTH = np.array([0.155, 0.152, 0.62, 0.04, 0.05])


@cache
def _skid_truth() -> tuple[Any, Windows]:
    dae = parametric_model(static, catalog.skid_steer(), Coulomb(0.1), SKID)
    return dae, _windows(body_motion(dae), TRUTH)


def _skid_windows(noise: float = 0.0, seed: int = 0) -> tuple[Any, Windows]:
    dae, windows = _skid_truth()
    error = np.random.default_rng(seed).normal(size=windows.end.shape) * noise * [1, 1, 0.5]
    return dae, windows._replace(end=windows.end + error)


def _skid_estimate(dae: Any, windows: Windows, **more: Any) -> Estimate:
    return estimate(dae, Coulomb(0.1), SKID, windows, **more)


def test_known_numbers_are_found() -> None:
    found = _skid_estimate(*_skid_windows())
    assert_allclose(found.values, TRUTH, rtol=1e-5)
    assert found.at_bound == (False,) * 5


@pytest.mark.slow
def test_intervals_contain_the_truth() -> None:
    """5 draws with 5 unknowns: 25 intervals, of which 24 are expected to contain the truth."""
    inside = 0
    for seed in range(5):
        dae, windows = _skid_windows(0.01, seed)
        found = _skid_estimate(dae, windows)
        inside += int(((found.intervals[:, 0] <= TRUTH) & (found.intervals[:, 1] >= TRUTH)).sum())
        assert_allclose(found.deviations, [0.01, 0.01, 0.005], rtol=0.4)
    assert 22 <= inside <= 25


def test_outliers_have_little_influence() -> None:
    dae, windows = _skid_windows(0.005)
    end = windows.end.copy()
    end[::10] += [0.5, -0.5, 0.5]
    spoilt = windows._replace(end=end)
    robust, plain = (_skid_estimate(dae, spoilt, loss=loss) for loss in ("soft_l1", "linear"))
    errors = [np.abs(each.values[2] - TRUTH[2]) for each in (robust, plain)]
    assert errors[0] < 0.01
    assert errors[1] > 3 * errors[0]


def test_undetermined_combinations_are_named() -> None:
    """Straight motion determines the radius, but neither the track nor the sensor's position."""
    build, vehicle, law, _ = CASES["pressed"]
    unknowns = (Unknown("radius", "radius"), Unknown("track", "track"), SENSOR[1])
    dae = parametric_model(build, vehicle, law, unknowns)
    motion = body_motion(dae)
    given = np.repeat(np.linspace(1, 4, 20)[:, None, None] * np.ones(4), 2, axis=1)
    order = np.arange(20.0)
    windows = Windows(order, order, np.ones((20, 1)), given, np.zeros((20, 3)))
    speed = velocities(motion, given[:, 0], np.array([0.17, 0.57])).values
    end, *_ = end_poses(windows, np.repeat(speed[:, None], 2, axis=1), np.zeros(3))
    end += np.random.default_rng(1).normal(size=end.shape) * 0.01
    windows = windows._replace(end=end)
    found = estimate(dae, law, unknowns, windows)
    assert_allclose(found.values[0], 0.17, atol=0.002)
    assert np.isfinite(found.intervals[0]).all()
    assert np.isinf(found.intervals[1:]).all()
    assert [np.isinf(each.deviation) for each in found.directions] == [False, True, True]
    prior = (unknowns[0], Unknown("track", "track", prior=(0.6, 0.02)))
    dae = parametric_model(build, vehicle, law, prior)
    known = estimate(dae, law, prior, windows)
    assert_allclose(known.values[1], 0.6, atol=1e-6)
    assert_allclose(np.sqrt(known.covariance[1, 1]), 0.02, rtol=1e-6)


def test_an_estimate_at_its_bound_is_marked() -> None:
    dae, windows = _skid_windows(0.005)
    unknowns = (*SKID[:2], Unknown("track", "track", upper=0.61), *SKID[3:])
    found = estimate(dae, Coulomb(0.1), unknowns, windows)
    assert found.at_bound == (False, False, True, False, False)
    assert found.covariance[2, 2] == 0


def test_pose_of_the_sensor_is_found() -> None:
    build, vehicle, law, _ = CASES["closure"]
    unknowns = (*SKID[:3], *SENSOR)
    dae = parametric_model(build, vehicle, law, unknowns)
    sensor = np.array([0.05, 0.3, -0.1])
    windows = _windows(body_motion(dae), np.array([0.155, 0.152, 0.62]), sensor)
    found = estimate(dae, law, unknowns, windows)
    assert_allclose(found.values, [0.155, 0.152, 0.62, *sensor], atol=1e-5)


def test_calibration_judges_by_other_windows() -> None:
    dae, windows = _skid_windows(0.01)
    found = calibrate(static, catalog.skid_steer(), Coulomb(0.1), SKID, windows, train=0.6)
    assert (len(found.train.measured), len(found.test.measured)) == (36, 24)
    before, after = (
        bootstrap(each, position_rms) for each in (found.test.nominal, found.test.fitted)
    )
    assert after.upper < before.lower
    assert after.lower < 0.01 * np.sqrt(2) < after.upper
    assert dae.p[0].label.name == "radius_left"


def test_windows_of_a_log() -> None:
    """An arc of radius 1 m: a log in two windows, the second with fewer samples."""
    angle = np.array([0.0, 0.1, 0.2, 3.0, 3.2])
    pose = np.column_stack([np.cos(angle), np.sin(angle), angle - 2 * np.pi * (angle > 3.1)])
    log = Log(angle, np.ones((5, 1)), pose, np.array([0, 0, 0, 1, 1]))
    found = cut(log)
    assert_allclose(found.dt, [[0.1, 0.1], [0.2, 0.0]])
    arc = [np.cos(0.2) - 1, np.sin(0.2), 0.2]
    assert_allclose(found.end, [arc, arc], atol=1e-12)
    speed = np.broadcast_to([0.0, 1.0, 1.0], (2, 3, 3))
    assert_allclose(end_poses(found, speed, np.zeros(3))[0], found.end, atol=1e-12)
    with pytest.raises(ModelError, match="times that do not decrease"):
        cut(log._replace(t=angle[::-1]))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"lower": 1.0, "upper": 0.5}, "a lower bound below the upper one"),
        ({"prior": (0.5, 0.0)}, "positive standard deviation of the prior"),
        ({"quantity": "mass"}, "one of the quantities radius, track, .*, found 'mass'"),
        (
            {"quantity": "radius", "wheels": ("nose",)},
            "wheels of the vehicle, front_right, .*'nose'",
        ),
        ({"lower": 0.7}, "a nominal value within the bounds, 0.7 to inf"),
    ],
)
def test_unknowns_are_checked(options: dict[str, Any], words: str) -> None:
    build, vehicle, law, _ = CASES["closure"]
    given = {"name": "unknown", "quantity": "track"} | options
    with pytest.raises(ModelError, match=words):
        calibrate(build, vehicle, law, [Unknown(**given)], _skid_windows()[1])


def test_models_and_logs_that_do_not_suit_are_refused() -> None:
    dae = dynamics(catalog.skid_steer(), LEVEL, law=Compliant())
    refuses(ModelError, "found one with inertia", body_motion, dae)
    times = 1.7e18 + 1e8 * np.arange(20.0)
    log = Log(times, np.ones((20, 1)), np.zeros((20, 3)), np.arange(20))
    refuses(ModelError, r"samples are 1e\+08 s apart .* correct the unit", cut, log)
    window = np.append(np.zeros(4000), np.arange(1, 400).repeat(2))
    count = window.size
    log = Log(np.arange(count) / 10, np.ones((count, 1)), np.zeros((count, 3)), window)
    refuses(ModelError, "found 400 windows of up to 4000 samples", cut, log)


RIGID = catalog.rigid_skid_steer(half_track=0.54, wheelbase=0.914, r1=0.08, r2=0.22)


@cache
def _rigid() -> Any:
    return parametric_model(kinematic, RIGID, LeastSlip(), SKID[:3])


def test_a_velocity_does_not_depend_on_other_values() -> None:
    """The narrow track of a trial led to equilibrium on two wheels, at a roll of 1.07 rad."""
    motion = body_motion(_rigid())
    given = np.array([[2.0 if "left" in name else 3.0 for name in motion.names]])
    cold = velocities(motion, given, (p := np.array([0.28532, 0.28608, 0.914])))
    narrow = velocities(motion, given, np.array([0.28532053, 0.2860784, 0.09191936]), cold)
    back = velocities(motion, given, p, narrow)
    assert_allclose(back.values, cold.values, rtol=1e-9, atol=1e-12)
    start = settle(with_values(_rigid(), **dict(zip(motion.parameters, p.tolist(), strict=True))))
    assert_allclose(back.z[0, 1], start["roll"][0], atol=1e-8)
    with pytest.raises(ModelError, match="the vehicle would fall from the pose"):
        velocities(motion, given, np.array([0.3, 0.3, 0.05]))


def _turning_windows(names: tuple[str, ...], effective: float) -> Windows:
    """Return noisy windows of a differential drive with radius 0.28 m and a given track."""
    rng, count, time = np.random.default_rng(1), 60, 2.0
    left, right = rng.uniform(-8, 8, (2, count))
    turn, ahead = 0.28 * time * (right - left) / effective, 0.28 * time * (left + right) / 2
    half = np.sinc(turn / 2 / np.pi)
    end = np.column_stack(
        [-ahead * half * np.sin(turn / 2), ahead * half * np.cos(turn / 2), turn]
    ) + rng.normal(size=(count, 3)) * [0.1, 0.1, 0.05]
    given = np.column_stack([left if "left" in name else right for name in names])
    order = np.arange(float(count))
    return Windows(
        order, 10 * order, np.full((count, 1), time), given[:, None].repeat(2, axis=1), end
    )


def test_a_log_that_turns_faster_than_the_model_is_refused() -> None:
    """The model turns fastest with a track equal to its wheelbase: as with a track of 1.828 m."""
    dae = _rigid()
    slower, faster = (_turning_windows(body_motion(dae).names, track) for track in (1.9, 1.75))
    found = estimate(dae, LeastSlip(), SKID[:3], slower)
    assert_allclose(found.values[:2], 0.28, rtol=0.02)
    assert not found.undetermined
    words = r"turns fastest with track = 0\.91\d* m and the log turns faster: .* in window \d+, "
    with pytest.raises(ModelError, match=words):
        estimate(dae, LeastSlip(), SKID[:3], faster)


@pytest.mark.parametrize("law", [Coulomb(), pytest.param(Soil(creep=0.01), marks=pytest.mark.slow)])
def test_fast_slip_is_solved(law: Any) -> None:
    """Rates and creep speed that are ten times as large give ten times the velocity."""
    left, right = np.array([[3.4, -0.5, 0.5409, 3.0], [0.16, 6.6, -3.007, 3.0]])
    slow_law, found = replace(law, creep=law.creep / 10), []
    for factor, each in ((10, law), (1, slow_law)):
        motion = body_motion(parametric_model(static, catalog.skid_steer(), each, SKID[2:3]))
        given = factor * np.column_stack([left if "left" in n else right for n in motion.names])
        found.append(velocities(motion, given, np.array([0.6])).values / factor)
    assert_allclose(found[0], found[1], rtol=1e-6, atol=1e-9)
    dae = static(catalog.skid_steer(), slow_law)
    inputs = dae.inputs(**dict(zip(motion.names, given[0], strict=True)))
    run = simulate(dae, settle(dae), inputs, [0.0, 0.01])
    assert_allclose(found[0][0, 2] * 0.01, run["heading"][-1], rtol=1e-5)


def test_samples_without_motion_are_named() -> None:
    dae, windows = _skid_windows()
    fast = windows.take(np.arange(8))
    fast.given[7, 1] = 1e12
    with pytest.raises(ModelError, match=r"window 7, t = 22 s: expected a motion .*no solution"):
        Predictor(dae, SKID, fast)(TRUTH)


def test_a_search_that_ends_where_a_wheel_lifts_off_is_refused() -> None:
    """The poses are continued beyond the centre of mass at which a wheel lifts off."""
    unknowns = (Unknown("ahead", "center_of_mass_ahead"),)
    dae = parametric_model(static, catalog.skid_steer(), Coulomb(0.1), unknowns)
    windows = _windows(body_motion(dae), np.zeros(1))
    predict = Predictor(dae, unknowns, windows)
    ends = [predict(np.array([at])).values for at in (0.0, 0.1)]
    beyond = windows._replace(end=ends[0] + 3 * (ends[1] - ends[0]))
    with pytest.raises(
        ModelError, match=r"the log favours values beyond it: .*window \d+, t = .*lifts off"
    ):
        estimate(dae, Coulomb(0.1), unknowns, beyond, "linear")


RATES = {"left": lambda t: 4 + 3 * np.sin(2 * t), "right": lambda t: 3 + 4 * np.cos(1.7 * t + 1)}


@cache
def _cart() -> Any:
    return parametric_model(kinematic, catalog.differential_drive(), LeastSlip(), SKID[2:3])


def _predicted_end(times: Array) -> tuple[BodyMotion, Array, Array]:
    """Return the model of a cart, rates at samples of smooth motion, and the predicted end."""
    motion = body_motion(_cart())
    rates = {name: RATES[name.removesuffix("_rate")](times) for name in ("left_rate", "right_rate")}
    given = np.column_stack([rates.get(name, 0 * times) for name in motion.names])
    log = Log(times, given, np.zeros((times.size, 3)), np.zeros(times.size))
    end = Predictor(_cart(), SKID[2:3], cut(log))(np.array([_cart().p[0].value])).values[0]
    return motion, given, end


def test_rates_are_linear_between_samples() -> None:
    """Unequal intervals, from which samples are missing, against a simulation."""
    times = np.array([0.0, 0.1, 0.5, 0.9, 1.0, 1.3, 2.1, 2.2, 3.0])
    motion, given, end = _predicted_end(times)
    dae = kinematic(catalog.differential_drive(), LeastSlip())
    slopes = np.diff(given, axis=0) / np.diff(times)[:, None]
    inputs = {
        name: PiecewiseLinear(given[:-1, k] - slopes[:, k] * times[:-1], slopes[:, k])
        for k, name in enumerate(motion.names)
        if name.endswith("_rate")
    }
    run = simulate(dae, settle(dae), dae.inputs(**inputs), times, options=SolverOptions(1e-9))
    assert_allclose(end, [run[name][-1] for name in ("x", "y", "heading")], atol=2e-7)


def test_errors_fall_with_the_square_of_the_interval() -> None:
    """A dense log of a known motion, of which samples at longer intervals are used."""
    exact, coarse, fine = (
        _predicted_end(np.linspace(0, 4, count + 1))[2] for count in (1280, 10, 20)
    )
    errors = [np.hypot(*(end - exact)[:2]) for end in (coarse, fine)]
    assert 3.5 < errors[0] / errors[1] < 4.5
