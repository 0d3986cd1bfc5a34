"""Tests of driving laws: they keep a vehicle on its path and its wheels upright."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import CubicSpline

import slipfree as sf
from helpers.cases import closure_model, hills
from helpers.commands import refuses
from helpers.vehicles import all_steered, skid_steered
from slipfree.catalog import ackermann, rocky7, skid_steer, three_wheeler
from slipfree.control import path_following as laws
from slipfree.geometry.path import cubic_spline
from slipfree.terrain.synthetic import blank, power_law

WAY = np.array([(0, 0), (25, 3), (50, 0), (75, -3), (100, 0)], dtype=float)
FLAT = sf.Analytic(lambda x, _: 0 * x)
# number of way-points, and place of the turning axis: a ball is a fixed wheel
WITHOUT_STEERED_AXLE = [(skid_steered(), 2, -0.2), (all_steered(), 3, 0.0)]


def largest_tilt(run):
    return max(np.abs(run["tilt_right"]).max(), np.abs(run["tilt_left"]).max())


def heading_at_start(path, ahead=0.5):
    place = path.at(np.zeros(1))
    return float(place.heading[0] - np.arctan(ahead * place.curvature[0]))


def test_path_is_by_arc_length():
    angle = np.linspace(0, np.pi, 25)
    circle = sf.Path(np.column_stack([5 * np.cos(angle), 5 * np.sin(angle)]))
    assert_allclose(circle.length, 5 * np.pi, rtol=1e-4)
    s = np.linspace(0, circle.length, 101)
    place = circle.at(s)
    assert_allclose(np.hypot(place.x, place.y), 5, atol=1e-3)
    assert_allclose(place.curvature[10:-10], 0.2, atol=2e-3)
    assert_allclose(place.heading, s / 5, atol=2e-3)  # north at first, turning left
    moved = np.hypot(np.diff(place.x), np.diff(place.y))
    assert_allclose(moved, np.diff(s), rtol=5e-4)
    assert_allclose(circle.distance(np.array([5.0, -6.0]), np.array([-3.0, 0.0])), [3, 1])


@pytest.mark.parametrize("count", [2, 3, 4, 30])
def test_splines_are_those_of_scipy(count, rng):
    at, values = np.cumsum(rng.uniform(0.5, 2.0, count)), rng.normal(size=(count, 2))
    places = np.linspace(at[0], at[-1], 41)
    spline = CubicSpline(at, values, bc_type="natural" if count < 4 else "not-a-knot")
    for order in range(3):
        found = cubic_spline(at, values, places, order)
        assert_allclose(found, spline(places, order), atol=1e-11)


def test_path_goes_straight_on_beyond_its_ends():
    for points in ([(1.0, 2.0), (1.0, 5.0)], [(1.0, 2.0), (1.0, 3.0), (1.0, 5.0)]):
        place = sf.Path(np.array(points)).at(np.array([-1.0, 2.0, 4.0, 7.0]))
        assert_allclose(place.x, 1.0, atol=1e-12)
        assert_allclose(place.y, [1.0, 4.0, 6.0, 9.0], atol=1e-12)
        assert_allclose(place.curvature, [0.0] * 4)


def test_path_is_checked():
    for points, words in (
        ([(0.0, 0.0)], "at least two way-points"),
        ([0.0, 1.0], "at least two way-points"),
        ([(0.0, 0.0), (1.0, np.nan)], r"found \[ 1. nan\] at way-point 2"),
        ([(0.0, 0.0), (0.0, 1.0), (0.0, 1e160)], r"coordinates between -1e\+12 and 1e\+12 m"),
        ([(0.0, 0.0), (1.0, 1.0), (1.0, 1.0)], "way-points 2 and 3 coincide"),
    ):
        refuses(sf.ModelError, words, sf.Path, np.array(points))


@pytest.mark.slow
def test_straight_keeps_its_line_and_its_wheels_up():
    dae = closure_model(three_wheeler(), sf.Analytic(hills))
    start = sf.settle(dae, x=1.0, y=-2.0, heading=0.3)
    for speed in (0.5, -0.5):
        run = sf.simulate(dae, start, sf.straight(dae, start, speed=speed), np.linspace(0, 60, 301))
        off = -(run["x"] - 1.0) * np.cos(0.3) - (run["y"] + 2.0) * np.sin(0.3)
        assert np.abs(off).max() < 0.06
        assert largest_tilt(run) < 0.03
        assert_allclose(np.hypot(run["x"][-1] - 1.0, run["y"][-1] + 2.0), 30, atol=0.1)


@pytest.mark.slow
def test_100_m_of_hills_and_the_same_without_the_tilt_term(monkeypatch):
    ground = blank((-10.0, 110.0), (-30.0, 30.0), 0.25)
    ground = power_law(ground, rms=0.15, hurst=0.9, longest=20.0, shortest=6.0, seed=4)
    vehicle, path = three_wheeler(), sf.Path(WAY)
    dae = closure_model(vehicle, sf.Bicubic(ground))
    start = sf.settle(dae, heading=heading_at_start(path))
    t = np.linspace(0, path.length / 0.5, 401)
    run = sf.simulate(dae, start, sf.follow(dae, path, speed=0.5), t)
    assert run.stop is None
    assert largest_tilt(run) <= 0.05
    assert path.distance(run["x"], run["y"]).max() <= 0.05
    monkeypatch.setattr(laws, "TILT_GAIN", 0.0)
    without = sf.simulate(dae, start, sf.follow(dae, path, speed=0.5), t)
    assert largest_tilt(without) > 3 * largest_tilt(run)


def test_friction_begins_at_three_metres_per_second():
    ground = sf.Analytic(lambda x, y: x / 10 + y / 20, mu=0.7)
    start = sf.settle(model := sf.quasi_statics(rocky7(steered="corners"), ground))
    law = sf.straight(model, start, speed=3.0)
    assert sf.simulate(model, start, law, np.array([0.0, 0.1])).stop is None


def test_an_error_at_the_start_decays():
    vehicle, path = three_wheeler(), sf.Path(np.array([(0.0, 0.0), (0.0, 40.0)]))
    dae = closure_model(vehicle, FLAT)
    start = sf.settle(dae, x=0.5, heading=-0.3)
    run = sf.simulate(dae, start, sf.follow(dae, path, speed=0.4), np.linspace(0, 60, 61))
    assert_allclose([run[name][-1] for name in ("x", "heading")], 0, atol=1e-3)
    assert_allclose(run["y"][-1], 24, atol=1e-2)


@pytest.mark.parametrize(("vehicle", "count", "ahead"), WITHOUT_STEERED_AXLE)
def test_vehicles_without_a_steered_axle_follow_too(vehicle, count, ahead):
    dae, path = closure_model(vehicle, FLAT), sf.Path(WAY[:count])
    assert laws.turning_axis_offset(vehicle) == pytest.approx(ahead)
    start = sf.settle(dae, heading=heading_at_start(path, ahead))
    run = sf.simulate(dae, start, sf.follow(dae, path, speed=0.3), np.linspace(0, 60, 61))
    assert path.distance(run["x"], run["y"]).max() < 0.05
    assert np.abs(run["slip_across"][10:]).max() < 1e-2


def test_laws_name_what_they_need():
    dae = closure_model(three_wheeler(), FLAT)
    for speed in (0.0, np.inf):
        with pytest.raises(sf.ModelError, match="speed: expected a finite"):
            sf.straight(dae, sf.settle(dae), speed=speed)
    trailer = skid_steered()
    wheels = tuple(replace(wheel, driven=False) for wheel in trailer.wheels)
    dae = closure_model(replace(trailer, name="trailer", wheels=wheels), FLAT)
    words = "driven wheels on both sides, found neither in 'trailer'"
    refuses(sf.ModelError, words, sf.follow, dae, sf.Path(WAY), speed=1.0)


def test_commands_are_met_on_a_plane():
    """A skid-steer turns as commanded; a car by less, since its steering is limited smoothly."""
    for vehicle, lag in ((skid_steer(), 0.0), (ackermann(), 0.065)):
        model = sf.commanded(sf.direct_kinematics(vehicle, FLAT), speed=0.5)
        turn = model.inputs(forward=0.5, yaw_rate=0.15)
        run = sf.simulate(model, sf.settle(model), turn, np.linspace(0, 10, 51))
        assert_allclose(np.diff(run["heading"])[25:], (1 - lag) * 0.15 * 0.2, rtol=2e-3)
        speed = np.hypot(np.diff(run["x"]), np.diff(run["y"])) / 0.2
        assert_allclose(speed[25:], 0.5, rtol=0.02)
    for value in (0.0, -1.0, np.inf):
        with pytest.raises(sf.ModelError, match="speed: expected a"):
            sf.commanded(sf.direct_kinematics(vehicle, FLAT), speed=value)


@pytest.mark.parametrize("vehicle", [rocky7(steered="corners"), skid_steer()])
def test_a_vehicle_that_points_away_turns_to_its_path_and_drives_on_beyond_a_curved_end(vehicle):
    """It is never faster than twice the speed, and its inputs do not jump with the curvature."""
    path = sf.Path(np.array([(0.0, 0.0), (0.3, 2.0), (0.0, 4.0), (0.0, 8.0)]))
    dae, reached = closure_model(vehicle, FLAT), path.at(np.array([10.0]))  # the end: at 8.1 m
    start = sf.settle(dae, heading=np.radians(170))
    run = sf.simulate(dae, start, sf.follow(dae, path, speed=0.4), np.linspace(0, 25, 251))
    assert np.hypot(run["velocity_x"], run["velocity_y"]).max() < 0.85
    assert_allclose((run["x"][-1], run["y"][-1]), (reached.x[0], reached.y[0]), atol=0.02)
