"""Tests of plans: least slip over hills, limits, goals, keys of files, and early ends."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.cases import hills
from helpers.commands import build_errors, invoke, sets
from slipfree import Analytic, ModelError, SolverOptions, direct_kinematics, settle, simulate
from slipfree.catalog import three_wheeler
from slipfree.core.outcome import Outcome
from slipfree.files import netcdf
from slipfree.models.samples import measured_slip
from slipfree.plan.plan import plan
from slipfree.plan.transcription import Mesh
from slipfree.plan.verification import inputs_along

PROBLEM = Path(__file__).parents[2] / "problems" / "plan_rigid_hills.toml"
RATES = {f"{name}_rate": (-2.0, 2.0) for name in ("right", "left", "steer")}
GOAL = {"x": 0.6, "y": 2.6}
WEIGHTS = {"slip": 7e4, "effort": 0.01}
VEHICLE = three_wheeler(axle="fixed")
STEER = {"steer": (-1.0, 1.0)}


def asked(vehicle=VEHICLE, *, goal=None, costs=None, duration=20.0, **options):
    dae = direct_kinematics(vehicle, Analytic(hills))
    start = settle(dae)
    rates = dae.inputs(right_rate=0.45, left_rate=0.45, steer_rate=0.0)
    first = simulate(dae, start, rates, np.linspace(0, 20, 61))
    found = plan(
        dae,
        start,
        first,
        goal=goal or GOAL,
        costs=costs or WEIGHTS,
        duration=duration,
        smooth=0.002,
        inputs=RATES,
        **options,
    )
    return dae, start, found


def rms_slip(run):
    """Root mean square over time and wheels. [m/s]."""
    squares = run["slip_along"] ** 2 + run["slip_across"] ** 2
    return np.sqrt(np.trapezoid(squares.mean(axis=1), run.t) / (run.t[-1] - run.t[0]))


@pytest.mark.slow
def test_a_rigid_axle_reaches_its_goal_with_least_slip():
    """Slip and place are those of the simulation; more starts of the search in the benchmark."""
    _, _, found = asked(limits=STEER)
    assert found.success
    replay = found.replay
    assert replay.stop is None
    assert rms_slip(replay) < 7e-5
    assert found.costs["effort"] < 9.0
    assert_allclose([replay["x"][-1], replay["y"][-1]], [0.6, 2.6], atol=1e-5)
    assert max(found.difference.values()) < 1e-5
    assert np.abs(found.run["steer"]).max() <= 1.0 + 1e-8


@pytest.mark.slow
def test_a_limited_cost_is_at_its_limit():
    """A limit on a term without weight; below the least value the explanation names the cost."""
    given = {"limits": STEER, "mesh": Mesh(6, accuracy=0.05)}
    _, _, free = asked(costs={"effort": 1.0}, **given)
    least = free.costs["effort"]
    assert rms_slip(free.replay) > 1e-3  # effort alone slips more
    assert least < 8.0
    given["costs"] = {"slip": 1e3}
    _, _, found = asked(cost_limits={"effort": 1.03 * least}, **given)
    assert found.success
    assert found.costs["effort"] == pytest.approx(1.03 * least, rel=1e-6)
    _, _, none = asked(cost_limits={"effort": 0.5 * least}, **given)
    assert none.run.outcome is Outcome.INFEASIBLE
    assert "cost effort: " in none.run.stop.words


@pytest.mark.slow
def test_tilting_wheels_keep_to_their_limit_without_slip():
    """Slip is measured on the poses of the simulation."""
    vehicle, parts, count, duration = three_wheeler(), 20, 10, 10.0
    dae, start, found = asked(
        vehicle,
        goal={"x": 0.3, "y": 1.3},
        duration=duration,
        mesh=Mesh(count),
        costs={"effort": 0.01, "tilt_right": 1.0, "tilt_left": 1.0},
        limits={"tilt_right": (-0.35, 0.35), "tilt_left": (-0.35, 0.35), "steer": (-1.0, 1.0)},
    )
    assert found.success
    for name in ("tilt_right", "tilt_left"):
        assert np.abs(found.replay[name]).max() < 0.35 + 1e-5
    even = np.linspace(0, duration, count * parts + 1)
    run = simulate(
        dae,
        start,
        inputs_along(dae, found.motion, even),
        even,
        options=SolverOptions(tolerance=1e-11),
    )
    slip = np.linalg.norm(measured_slip(vehicle, run), axis=2)
    inside = np.array([2 <= k % parts <= parts - 2 for k in range(2, run.t.size - 2)])
    assert slip[inside].max() < 1e-7  # at a kink of the inputs difference quotients are less exact


@pytest.mark.slow
def test_a_pose_a_way_point_and_a_range_of_durations():
    _, _, found = asked(
        goal={"y": 2.0, "heading": (-0.05, 0.05)},
        way_points={0.5: {"x": 0.2}},
        duration=(5.0, 30.0),
        costs={"slip": 1e3, "time": 0.01},
        accelerations=dict.fromkeys(RATES, (-1.0, 1.0)),
        mesh=Mesh(20),
    )
    assert found.success
    assert found.run["y"][-1] == pytest.approx(2.0, abs=1e-6)
    assert abs(found.run["heading"][-1]) < 0.05 + 1e-8
    assert found.run["x"][30] == pytest.approx(0.2, abs=1e-6)
    assert 5.0 <= found.run.t[-1] < 30.0
    ends = found.run.t[::3]
    rates = np.diff(found.run["right_rate"][::3]) / np.diff(ends)
    assert np.abs(rates).max() <= 1.0 + 1e-6


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"goal": {"z_": 1.0}}, "found 'z_'; did you mean"),
        ({"costs": {"slop": 1.0}}, "found 'slop'; use one of"),
        ({"costs": {"slip": -1.0}}, "costs.'slip'.: expected a number >= 0, found -1"),
        ({"cost_limits": {"effort": 0.0}}, "cost_limits.'effort'.: expected a number > 0"),
        ({"duration": 0.0}, "expected a positive, finite duration"),
        (
            {"limits": {"steer": (1.0, -1.0)}},
            "steer.*: expected ascending bounds, found 1.0 to -1.0",
        ),
        ({"way_points": {1.0: {"x": 0.0}}}, "way_points: expected fractions of the duration above"),
        ({"accelerations": {"x": (0, 1)}}, "inputs: expected one of right_rate, .* found 'x'"),
    ],
)
def test_what_is_wrong_is_said(options, words):
    with pytest.raises(ModelError, match=words):
        asked(**options)


def run_file(*settings):
    words = sets(*settings)
    return invoke("run", str(PROBLEM), "-o", "p.nc", "--no-draw", *words)


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_run_plans_simulates_and_tells():
    result = run_file("plan.intervals=10", "costs.slip=")
    assert result.exit_code == 0, result.output
    told = dict(line.split("  ", 1) for line in result.stdout.splitlines() if "  " in line)
    assert told["driven by"].strip().startswith("plan to x 0.6, y 2.6 in 20 s")
    assert "effort" in told["plan"]
    assert "iterations" in told["plan"]
    assert told["simulated"].strip().startswith("differs from the plan by at most x ")
    assert told["optimality"].strip().startswith("a strict local minimum: smallest curvature ")
    assert "duration 20 s: 0.1 s more saves " in told["prices of limits"]
    run = netcdf.read(Path("p.nc"))
    assert run["y"][-1] == pytest.approx(2.6, abs=1e-3)
    assert run.facts["plan_iterations"].value > 0


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_a_goal_that_cannot_be_reached_is_explained_and_the_last_iterate_saved():
    bounds = (f"bounds.{side}_rate=[0, 0.5]" for side in ("right", "left"))
    result = run_file("plan.intervals=10", "costs.slip=", "plan.duration=4.0", *bounds)
    assert result.exit_code == 1, result.output
    told = result.stdout.partition("ground ")[0]
    assert told.startswith("outcome ")
    assert "infeasible: the constraints contradict each other where the search ended" in told
    assert "the result is the last iterate\nlargest violations of this result" in told
    assert "y at the goal" in told
    assert "one sufficient set; others may exist" in told
    assert result.stderr == "infeasible; p.nc contains the result so far\n"
    assert netcdf.read(Path("p.nc")).stop.name == "plan"


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("goal.q=1", "goal.q: expected a quantity of the model, found 'q'"),
        ("goal.x=[2, 1]", "goal.x: expected a number, or [low, high] in ascending order"),
        ("plan.degree=6", "plan.degree: expected"),
        ("bounds.wheel=[0, 1]", "found 'wheel'"),
    ],
)
def test_what_is_wrong_in_a_file_is_told_with_its_place(setting, words):
    assert words in build_errors(PROBLEM, [setting])
