"""Tests of bodies that bear load in dynamics: closed forms, energy, hanging and rolling over."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from helpers.dynamics import FLAT, energy_error, four_wheels, moved, states
from slipfree import Analytic, Compliant, ModelError, Solids, dynamics, in_gravity, settle, simulate
from slipfree.laws.soil import Soil
from slipfree.problem.load import find_motion_verb, load_problem
from slipfree.problem.result import run_problem
from slipfree.terrain.solids import placed, step
from slipfree.vehicle.shapes import Ball, Box, Hull

PROBLEMS = Path(__file__).parents[2] / "problems"
DEPTH, WEIGHT = 2e-3, 48 * 9.81
LAW = Compliant(body_depth=DEPTH)
BELLY = Box((0.4, 0.5, 0.2), at=(0.0, 0.35, 0.1))  # its lower face is at the axles


def car(*shapes, **keys):
    """Return a car with shapes on its platform; its centre of mass is above their middle."""
    vehicle = four_wheels(static_depth=1e-4, **keys)
    return replace(vehicle, body=replace(vehicle.body, shapes=shapes))


def sunk(*shapes, mu=0.8, **keys):
    """Return a model of a car whose wheels are above the lowest points of its shapes."""
    return dynamics(car(*shapes, **keys), replace(FLAT, mu=mu), law=LAW)


@pytest.mark.parametrize(
    ("shapes", "share"),
    [
        ((Box((0.4, 0.5, 0.4), at=(0, 0.35, 0)),), 1 / 9),
        ((Hull(tuple((x, y, -0.2) for x in (-0.2, 0.2) for y in (0.1, 0.6))),), 1 / 4),
        (tuple(Ball(0.05, (x, y, -0.15)) for x, y in ((-0.2, 0.1), (0.2, 0.1), (0, 0.6))), 3 / 8),
    ],
)
@pytest.mark.parametrize("gravity", [9.81, 1.62])
def test_a_car_on_its_belly_is_as_deep_as_its_weight_asks(shapes, share, gravity):
    """All points bear the weight; a moon's car with the same depth has softer points."""
    model = dynamics(in_gravity(car(*shapes), gravity), FLAT, law=LAW)
    run = moved(model, states(model, z=0.2), np.linspace(0, 4, 5), 1e-8)
    assert run["body_load"][-1] == pytest.approx(48 * gravity, rel=1e-5)
    assert run["force_normal"][-1] == pytest.approx(0, abs=1e-9)
    middle = run["z"][-1] + 0.35 * np.sin(run["pitch"][-1])
    # on unequal depths the car pitches by 1 mrad, and its centre of mass moves: 4e-4 more
    assert 0.2 - middle == pytest.approx(share * DEPTH, rel=1e-3)
    assert np.abs(energy_error(run)).max() < 1e-5 * 48 * gravity * 0.2


def test_a_car_slides_on_its_belly_as_far_as_friction_lets_it():
    """v^2 / (2 mu g), on points that bear the weight from the beginning."""
    box = Box((0.4, 0.5, 0.4), at=(0, 0.35, 0))
    model = sunk(box, mu=0.5)
    start = states(model, z=0.2 - DEPTH / 9, velocity_y=3.0)
    run = moved(model, start, np.linspace(0, 1.5, 16), 1e-8)
    assert run["y"][-1] == pytest.approx(3.0**2 / (2 * 0.5 * 9.81), rel=3e-3)
    assert np.abs(energy_error(run)).max() < 1e-6 * 24 * 9
    assert run["body_load"][-1] == pytest.approx(WEIGHT, rel=1e-6)
    # pitched by friction on the front corners until it stops
    assert run["body_load"] == pytest.approx(WEIGHT, rel=0.3)


def test_a_ball_bounces_as_a_damped_oscillator_without_friction():
    """Own integration of m z'' = k d max(0, 1 + c d') - m g, one point, no other motion."""
    from scipy.integrate import solve_ivp

    ball = Ball(0.3, (0, 0, 0))
    lone = car(ball)
    body = replace(lone.body, mass=lone.body.mass, at=(0.0, 0.0, 0.0))
    wheels = tuple(
        replace(w, at=(x, y, 0.5))
        for w, (x, y) in zip(lone.wheels, ((1, 1), (-1, 1), (1, -1), (-1, -1)), strict=True)
    )
    vehicle = replace(lone, body=body, wheels=wheels)
    law = Compliant(body_depth=DEPTH, damping_ratio=0.1)
    model = dynamics(vehicle, FLAT, law=law)
    t = np.linspace(0, 1, 201)
    run = moved(model, states(model, z=0.4), t, 1e-9)
    stiffness, damping = WEIGHT / DEPTH, 2 * 0.1 / np.sqrt(9.81 * DEPTH)

    def rates(_t, y):
        load = stiffness * max(0.3 - y[0], 0) * max(0, 1 - damping * y[1])
        return [y[1], load / 48 - 9.81]

    own = solve_ivp(rates, (0, 1), [0.4, 0], t_eval=t, rtol=1e-10, atol=1e-12, max_step=1e-3)
    assert run["z"] == pytest.approx(own.y[0], abs=1e-6)
    assert np.ptp(run["z"]) > 0.09


def test_energy_balances_where_points_slide_over_a_ridge():
    """Forces along the ground's normal instead of the gap's gradient would gain 0.05 J."""
    ridge = Analytic(
        lambda x, y: 0.05 * ca.exp(-(((y - 1.2) / 0.15) ** 2) - (x / 0.4) ** 2), mu=0.3
    )
    runners = Hull(tuple((x, y, -0.2) for x in (-0.2, 0.2) for y in (0.1, 0.6)))
    model = dynamics(car(runners), ridge, law=Compliant(body_depth=5e-3))
    start = states(model, z=0.2 - 5e-3 / 4, velocity_y=3.0)
    run = moved(model, start, np.linspace(0, 0.6, 31), 1e-8)
    assert run["body_load"].max() > 3 * WEIGHT
    assert np.abs(energy_error(run)).max() < 100 * 1e-8 * run["kinetic_energy"][0]


@pytest.mark.slow
def test_a_rover_hangs_on_a_ridge():
    """It drives onto a ridge higher than its belly until its front wheels lift and it stops."""
    ridge = Analytic(lambda x, y: 0.3 * ca.exp(-((x / 0.15) ** 2) - ((y - 2) / 0.4) ** 2), mu=0.5)
    vehicle = car(BELLY)
    model = dynamics(vehicle, ridge, law=LAW)
    inputs = model.inputs(**{label.full: 6.0 for label in model.labels.u.wheels})
    run = simulate(model, settle(model, y=0.0), inputs, np.linspace(0, 4, 81))
    assert run.stop is None
    assert run["body_load"][-1] > 0.4 * WEIGHT
    assert (run["force_normal"][-1][:2] == 0).all()
    assert abs(run["velocity_y"][-1]) < 1e-2
    ended = simulate(dynamics(vehicle, ridge), settle(model, y=0.0), inputs, run.t)
    assert "the platform touches the ground" in ended.stop.words


def test_a_roll_over_ends_on_the_roof():
    """A car dropped upside down, tilted, comes to rest on the corners of its roof."""
    box = Box((0.7, 0.9, 0.5), at=(0.0, 0.35, 0.25))
    model = sunk(box)
    half = np.deg2rad(150) / 2
    start = states(model, z=0.9, attitude_w=np.cos(half), attitude_y=np.sin(half))
    run = moved(model, start, np.linspace(0, 6, 61), 1e-8)
    assert run["body_load"][-1] == pytest.approx(WEIGHT, rel=1e-3)
    assert run["force_normal"][-1] == pytest.approx(0, abs=1e-9)
    assert run["z"][-1] == pytest.approx(0.5, abs=2e-3)  # the roof is 0.5 m above the axles
    up = 1 - 2 * (run["attitude_x"][-1] ** 2 + run["attitude_y"][-1] ** 2)
    assert up == pytest.approx(-1, abs=1e-4)
    assert run["kinetic_energy"][-1] < 1e-4
    assert np.abs(energy_error(run)).max() < 1e-4 * WEIGHT


def test_without_a_depth_the_motion_ends_at_a_touch():
    box = Box((0.4, 0.5, 0.4), at=(0, 0.35, 0))
    for law in (Compliant(), Soil()):
        model = dynamics(car(box), FLAT, law=law)
        assert [check.label.name for check in model.checks][-1] == "clearance_body"
        assert not model.labels.y.body_load
    model = sunk(box)
    assert not model.checks
    assert "upright" not in [limit.label.name for limit in model.limits]


def test_a_start_that_touches_is_refused():
    model = sunk(Box((0.4, 0.5, 0.2), at=(0, 0.35, -0.1)))
    with pytest.raises(ModelError, match="the platform touches the ground"):
        settle(model)


def test_too_many_points_are_refused():
    points = tuple((0.0, 0.0, 0.001 * k) for k in range(201))
    with pytest.raises(ModelError, match="at most 200 points, 26 of each box, found 201 in 'car'"):
        sunk(Hull(points))
    assert dynamics(car(BELLY), Solids(FLAT, placed(step(0.1))), law=LAW).labels.y.body_load


def test_the_robot_of_the_shipped_problem_hangs_up():
    problem = load_problem(PROBLEMS / "dynamics_hang_up.toml")
    result = run_problem(problem)
    run = result.trajectory
    assert run.stop is None
    assert run["body_load"][-1] > 34 * 9.81 / 2
    assert (run["force_normal"][-1][:2] == 0).all()  # front wheels
    assert abs(run["velocity_y"][-1]) < 1e-3
    assert run["slip_along"][-1][2:] == pytest.approx(-0.4, abs=0.01)  # rear wheels turn in place
    summary = dict(find_motion_verb(result.kind).summary(run))
    assert summary["body on the ground"].startswith("at ")
    assert summary["energy balance"].startswith("closed to ")
