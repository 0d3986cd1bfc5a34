"""Tests of initial guesses that plans make, and of the arguments of `plan`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import slipfree as sf
from slipfree.core.trajectory import PLAN, Stop
from slipfree.files.toml.source import ProblemError
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
    guess, duration = initial_guess(task, start, {}, sf.SolverOptions())
    assert guess["y"][-1] == pytest.approx(0.7, abs=0.2)
    assert guess["x"][-1] == pytest.approx(0.0, abs=0.1)
    assert duration >= guess.t[-1]


def test_a_goal_and_costs_suffice(model):
    found = sf.plan(*model, goal={"x": 0.05, "y": 1.5}, costs=COSTS, mesh=sf.Mesh(4))
    assert found.accurate
    low, high = found.program.task.duration
    assert high == pytest.approx(4 * low)
    assert found.motion.duration == pytest.approx(
        high, rel=1e-4
    )  # effort alone: as slowly as possible
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
        (
            {"goal": (1.0, 2.0)},
            r"goal\[0\]: expected Limit, found float 1.0; give values by name",
        ),
        ({"goal": {"y": "1"}}, r"goal\['y'\]: expected a number or 2 numbers, found str '1'"),
        ({"costs": ["slip"]}, r"costs\[0\]: expected Cost, found str 'slip'; give weights by name"),
        ({"costs": {"slip": "1"}}, r"costs\['slip'\]: expected a number, found str '1'"),
        ({"guess": 1.0}, "guess: expected Trajectory or a sequence of Trajectory, found float"),
        (
            {"mesh": 20},
            r"mesh: expected Mesh, found int 20; give a record, as in Mesh\(intervals=20\)",
        ),
        ({"duration": "9 s"}, "duration: expected a number or 2 numbers, found str '9 s'"),
        (
            {"goal": {"x": 100.0}},
            "x: expected a goal and way-points on the map, which extends from",
        ),
        ({"smooth": "a"}, "smooth: expected a number, found str 'a'"),
        ({"inputs": [1]}, "inputs: expected a mapping, found list"),
        ({"model": VEHICLE}, "model: expected Dae, found Vehicle; build a model"),
    ],
)
def test_arguments_of_wrong_types_are_refused_with_a_remedy(model, change, words):
    dae, start = model
    given = {"model": dae, "start": start, "goal": {"y": 1.0}, "costs": COSTS} | change
    with pytest.raises(sf.ModelError, match=words):
        sf.plan(**given)


def test_a_problem_file_needs_ground_vehicle_goal_and_costs(tmp_path: Path):
    file = tmp_path / "p.toml"
    file.write_text(PROBLEM)
    setup = build(sf.load_problem(file))
    assert setup.guide.name == "follow"
    assert setup.duration == free_durations([setup.starts[0][1][-1]])
    inputs = "inputs={right_rate=1.0, left_rate=1.0, steer_rate=0.0}"
    with pytest.raises(ProblemError, match=r"time\.duration: expected the duration of the initial"):
        sf.load_problem(file, [inputs])
    driver = "driver={name='straight', speed=1.0}"
    with pytest.raises(ProblemError, match="driver: expected at most one initial guess"):
        sf.load_problem(file, [inputs, driver, "time.duration=2.0"])
