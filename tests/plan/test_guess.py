"""Tests of initial guesses, of the arguments of `plan`, and of plans with inertia."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import slipfree as sf
from helpers.commands import refuses
from slipfree.core.records import leaves
from slipfree.core.trajectory import PLAN, Stop
from slipfree.files.toml import ProblemError
from slipfree.models.rigid_dynamics import dynamic_guess
from slipfree.plan.guess import choose_guide, initial_guess, trip_of
from slipfree.plan.problem import free_durations, task_of
from slipfree.problem.result import build
from slipfree.routing.traversability import free_space

VEHICLE = sf.catalog.three_wheeler(axle="fixed")
AXIS = np.linspace(-6.0, 6.0, 25)
GROUND = sf.Bicubic(sf.Grid(AXIS, AXIS, 0.01 * AXIS[:, None] * AXIS[None, :]), (0.0, 0.0))
DISC = sf.Region.disc(0.2, 2.0, 0.2)
FORWARD = dict.fromkeys(("right_rate", "left_rate"), (0.0, 2.0))
COSTS = {"effort": 0.01}
PROBLEM = """
verb = "plan"
terrain.synthetic = { x = [-6.0, 6.0], y = [-6.0, 6.0], spacing = 0.5 }
vehicle = { catalog = "three_wheeler", axle = "fixed" }
goal = { x = 0.1, y = 2.0 }
costs = { effort = 0.01 }
"""


@pytest.fixture(scope="module")
def model():
    dae = sf.direct_kinematics(VEHICLE, GROUND)
    return dae, sf.settle(dae)


@pytest.fixture(scope="module")
def layers():
    return free_space(GROUND, VEHICLE, keep_out=[DISC])


def guide_to(model, goal, bounds=None, layers=None):
    dae, start = model
    task = task_of(dae, start, goal=goal, costs=COSTS, duration=1.0)
    trip = trip_of(task, dae, start)
    return choose_guide(trip, bounds or {}, layers)


def test_the_guide_suits_goal_ground_and_bounds(model, layers):
    ahead, beside = {"x": 0.0, "y": 4.4}, {"x": 2.0, "y": 0.0, "heading": 0.0}
    route = guide_to(model, ahead, layers=layers)
    assert route.name == "route"
    assert np.abs(route.paths[0][:, 0]).max() > 0.5  # around the disc
    assert guide_to(model, {"x": 0.0, "y": 0.3}, layers=layers).name == "follow"  # directly
    assert guide_to(model, ahead).name == "follow"  # without map
    assert guide_to(model, beside).name == "reeds-shepp"
    assert guide_to(model, beside, FORWARD).name == "follow"
    assert guide_to(model, {"x": 0.0, "y": -3.0}).name == "reeds-shepp"
    assert guide_to(model, {"steer": 0.2}).name == "straight"
    assert guide_to(model, ahead, FORWARD).speed == pytest.approx(VEHICLE.wheels[0].radius)


def test_the_guess_ends_near_a_range_and_a_coordinate_without_range_stays(model):
    dae, start = model
    task = task_of(dae, start, goal={"y": (0.4, 1.0)}, costs=COSTS, duration=1.0)
    guess, duration = initial_guess(task, start, sf.SolverOptions())
    assert guess["y"][-1] == pytest.approx(0.7, abs=0.2)
    assert guess["x"][-1] == pytest.approx(0.0, abs=0.1)
    assert duration >= guess.t[-1]


def test_a_goal_and_costs_suffice(model):
    found = sf.plan(*model, goal={"x": 0.05, "y": 1.5}, costs=COSTS, mesh=sf.Mesh(4))
    assert found.accurate
    low, high = found.program.task.duration
    assert high == pytest.approx(4 * low)
    # effort alone: as slowly as possible
    assert found.motion.duration == pytest.approx(high, rel=1e-4)
    stop = Stop(PLAN, 0.0, "no plan: contradiction", sf.Outcome.INFEASIBLE)
    failed = replace(found, success=False, run=replace(found.run, stop=stop))
    assert repr(failed).startswith("no plan: contradiction\nPlan: not solved")


def test_a_model_without_vehicle_needs_a_guess(model):
    dae, start = model
    with pytest.raises(sf.ModelError, match="guess: expected at least one motion"):
        sf.plan(replace(dae, vehicle=None), start, goal={"y": 1.0}, costs=COSTS)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"goal": (1.0, 2.0)}, r"goal\[0\]: expected Limit, found float 1.0; give values by name"),
        ({"goal": {"y": "1"}}, r"goal\['y'\]: expected a number or 2 numbers, found str '1'"),
        ({"costs": ["slip"]}, r"costs\[0\]: expected Cost, found str 'slip'; give weights by name"),
        ({"costs": {"slip": "1"}}, r"costs\['slip'\]: expected a number, found str '1'"),
        ({"guess": 1.0}, "guess: expected Trajectory or a sequence of Trajectory, found float"),
        (
            {"mesh": 20},
            r"mesh: expected Mesh, found int 20; give a record, as in Mesh\(intervals=20\)",
        ),
        ({"duration": "9 s"}, "duration: expected a number or 2 numbers, found str '9 s'"),
        ({"goal": {"x": 100.0}}, "goal: expected a goal on the map, which extends from"),
        ({"smooth": "a"}, "smooth: expected a number, found str 'a'"),
        ({"inputs": [1]}, "inputs: expected a mapping, found list"),
        ({"model": VEHICLE}, "model: expected Dae, found Vehicle; build a model"),
    ],
)
def test_arguments_of_wrong_types_are_refused_with_a_remedy(model, change, words):
    dae, start = model
    given = {"model": dae, "start": start, "goal": {"y": 1.0}, "costs": COSTS} | change
    refuses(sf.ModelError, words, sf.plan, **given)


def test_a_problem_file_needs_ground_vehicle_goal_and_costs(tmp_path: Path):
    file = tmp_path / "p.toml"
    file.write_text(PROBLEM)
    setup = build(sf.load_problem(file))
    assert setup.guide.name == "follow"
    assert setup.task.duration == free_durations([setup.starts[0][1][-1]])
    inputs = "inputs={right_rate=1.0, left_rate=1.0, steer_rate=0.0}"
    with pytest.raises(ProblemError, match=r"time\.duration: expected the duration of the initial"):
        sf.load_problem(file, [inputs])


# Plans with inertia: rigid model, initial guess, and simulation of the plans

RADIUS = 0.15
CLOSE = {"rtol": 1e-6, "atol": 1e-9}


def with_torques(vehicle):
    wheels = tuple(replace(wheel, drive=sf.Torque()) for wheel in vehicle.wheels)
    return replace(vehicle, wheels=wheels)


def car():
    return with_torques(
        sf.catalog.skid_steer(wheelbase=0.7, mass=40.0, center_of_mass=(0.0, 0.0, 0.07))
    )


def ridge(height):
    return sf.Analytic(lambda x, y: height * ca.exp(-(((y - 0.9) / 0.2) ** 2)) + 0 * x, mu=0.8)


def straight_guess(model, vehicle, ground, speed, duration):
    start, still = sf.settle(model), sf.direct_kinematics(vehicle, ground)
    rates = {label.full: speed / RADIUS for label in still.labels.u.wheels}
    times, options = np.linspace(0, duration, 21), sf.SolverOptions(tolerance=1e-5)
    run = sf.simulate(still, sf.settle(still), still.inputs(**rates), times, options=options)
    return dynamic_guess(model, start, run), start


def assert_planned(model, guess, start, most, **options):
    """Plan to go 1.5 m in least time with limited torques; the simulation agrees."""
    found = sf.plan(
        model,
        start,
        guess,
        goal={"y": (1.5, 2.0)},
        costs={"time": 1.0},
        duration=(0.5, 5.0),
        smooth=1e-4,
        inputs={label.full: (-most, most) for label in model.labels.u.wheels},
        mesh=sf.Mesh(12, continuous=False, accuracy=5e-3),
        **options,
    )
    assert found.success
    assert found.accurate
    assert max(found.difference[axis] for axis in "xyz") < 5e-3
    assert found.replay.stop is None
    return found


@pytest.fixture(scope="module")
def crossing():
    """Return ground, vehicle, model, initial guess and start of a drive over a ridge."""
    ground, vehicle = ridge(0.12), car()
    model = sf.rigid_dynamics(vehicle, ground)
    return ground, vehicle, model, *straight_guess(model, vehicle, ground, 0.9, 1.7)


@pytest.mark.slow
def test_states_and_accelerations_at_rest_are_those_of_compliant_dynamics():
    ground = sf.Analytic(lambda x, y: 0.2 * y + 0.1 * x, mu=0.8)
    rigid, compliant = sf.rigid_dynamics(car(), ground), sf.dynamics(car(), ground)
    here, there = sf.settle(rigid), sf.settle(compliant)
    for label in leaves(compliant.labels.x):
        np.testing.assert_allclose(here.of(label), there.of(label), **CLOSE)
    np.testing.assert_allclose(here["depth"], there["depth"], rtol=1e-6)
    np.testing.assert_allclose(here["force_normal"], there["force_normal"], rtol=1e-6)


@pytest.mark.slow
def test_acceleration_on_level_ground():
    """Torques T on all wheels: (m + 4 I / R^2) a = 4 T / R."""
    vehicle = car()
    model = sf.rigid_dynamics(
        vehicle, sf.Analytic(lambda x, y: 0 * x * y, mu=0.8), law=sf.LinearCreep(1e-5)
    )
    inputs = model.inputs(**{label.full: 3.0 for label in model.labels.u.wheels})
    run = sf.simulate(model, sf.settle(model), inputs, np.linspace(0, 0.5, 6))
    axial = sum(wheel.mass * RADIUS**2 / 2 for wheel in vehicle.wheels)
    expected = 4 * 3.0 / RADIUS / (vehicle.mass + axial / RADIUS**2)
    # the static depth R / 250 shortens no lever: the contact point is on the wheel's surface
    np.testing.assert_allclose(run["velocity_y"][-1], expected * 0.5, rtol=1e-3)
    np.testing.assert_allclose(run["force_normal"].sum(axis=1), vehicle.weight, rtol=1e-2)


def test_linear_creep_is_coulomb_friction_at_small_slip():
    ground = sf.Analytic(lambda x, y: 0.1 * x + 0.05 * y, mu=0.8)
    runs = []
    for law in (sf.LinearCreep(1e-3), sf.Coulomb(1e-3)):
        model = sf.quasi_statics(sf.catalog.three_wheeler(axle="fixed"), ground, law=law)
        inputs = model.inputs(right_rate=0.5, left_rate=0.5, steer_rate=0.0)
        runs.append(sf.simulate(model, sf.settle(model), inputs, np.linspace(0, 1, 3)))
    linear, coulomb = (run["force_along"] for run in runs)
    # p sqrt(s^2 + eps^2) = eps p sqrt(1 + (s / eps)^2): relative difference below p^2
    used = runs[0]["utilisation"].max()
    np.testing.assert_allclose(linear, coulomb, rtol=2 * used**2, atol=1e-2)


def test_model_refuses_what_it_cannot_plan():
    ground = sf.Analytic(lambda x, y: 0 * x * y, mu=0.8)
    two = replace(sf.catalog.rigid_skid_steer(), wheels=sf.catalog.rigid_skid_steer().wheels[:2])
    refuses(sf.ModelError, "expected at least 3 wheels, found 2", sf.rigid_dynamics, two, ground)
    with pytest.raises(sf.ModelError, match="linear creep: expected a ground with a coefficient"):
        sf.LinearCreep().check(car(), sf.Analytic(lambda x, y: 0 * x * y))
    with pytest.raises(sf.ModelError, match="expected a ground with a coefficient of friction"):
        sf.rigid_dynamics(car(), sf.Analytic(lambda x, y: 0 * x * y))


@pytest.mark.slow
def test_guess_follows_the_kinematic_motion(crossing):
    *_, guess, start = crossing
    assert abs(guess["y"][0] - start["y"][0]) < 1e-9
    assert abs(guess["y"][-1] - 1.53) < 0.06  # the path is longer over the ridge
    attitude = np.stack([guess[f"attitude_{axis}"] for axis in "wxyz"])
    np.testing.assert_allclose(np.linalg.norm(attitude, axis=0), 1.0, atol=1e-12)
    speeds = np.gradient(guess["y"], guess.t)
    np.testing.assert_allclose(guess["velocity_y"], speeds, atol=1e-9)
    pitch = 2 * np.arcsin(guess["attitude_x"])
    np.testing.assert_allclose(guess["omega_x"][1:-1], np.gradient(pitch, guess.t)[1:-1], atol=0.05)


@pytest.mark.slow
def test_plan_with_momentum_agrees_with_compliant_contact(crossing):
    """Torques too small for slow driving over the ridge carry the car over it with momentum."""
    ground, vehicle, model, guess, start = crossing
    most, slow = 3.0, sf.quasi_statics(vehicle, ground)
    rates = {label.full: 0.6 / RADIUS for label in slow.labels.u.wheels}
    t, options = np.linspace(0, 2, 81), sf.SolverOptions(tolerance=1e-5)
    run = sf.simulate(slow, sf.settle(slow), slow.inputs(**rates), t, options=options)
    assert run["drive_torque"].sum(axis=1).max() > 4 * most
    found = assert_planned(model, guess, start, most, limits={"force_normal": (5.0, 1e4)})
    assert found.run["force_normal"].min() > 5 - 1e-6
    used = np.hypot(found.run["friction_used_along"], found.run["friction_used_across"])
    assert used.max() < 1 + 1e-6
    assert "kinetic_energy" in found.replay


@pytest.mark.slow
def test_rigid_four_wheeler_stands_on_soft_contacts():
    """At the same depths, loads of the soft contact follow from those of the compliant one."""
    vehicle = sf.catalog.rigid_skid_steer()
    share = vehicle.weight / 4
    for slope in (0.0, 0.1):
        ground = sf.Analytic(lambda x, y, s=slope: s * (x + y), mu=0.8)
        loads, compliant = (
            sf.settle(make(vehicle, ground))["force_normal"]
            for make in (sf.rigid_dynamics, sf.dynamics)
        )
        pressed = compliant / share - 1 / 4
        np.testing.assert_allclose(loads, share * (pressed + np.hypot(pressed, 1)) / 2, rtol=1e-3)


@pytest.mark.slow
def test_plan_of_a_rigid_four_wheeler_with_momentum():
    vehicle, ground = with_torques(sf.catalog.rigid_skid_steer()), ridge(0.06)
    model = sf.rigid_dynamics(vehicle, ground)
    assert_planned(model, *straight_guess(model, vehicle, ground, 0.9, 1.9), 4.0)
