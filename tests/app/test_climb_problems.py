"""Tests of step climbers in direct problems and plans: results, errors and figures."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.patches import Circle, Polygon

from helpers.cases import PROBLEMS
from helpers.climb_cases import AMPLE, RAMP, SENSED, TABLE_I, climb, foot
from helpers.commands import invoke, sets
from slipfree.catalog import step_climber
from slipfree.climb.metrics import climb_metrics
from slipfree.files.netcdf import read as read_result
from slipfree.files.vehicle_toml import vehicle_text
from slipfree.problem.load import load_problem
from slipfree.problem.result import build, motion_facts, run_problem
from slipfree.show.plots import draw
from slipfree.terrain.solids import section_of

pytestmark = pytest.mark.usefixtures("folder")
RAMP_FILE, STEP_FILE, STAIRS_FILE, PLAN_FILE = (
    PROBLEMS / f"climb_{name}.toml" for name in ("ramp", "step", "stairs", "plan_step")
)
COARSE = ("time.step=0.01",)


@pytest.mark.slow
def test_the_ramp_is_the_climb_of_the_library():
    found = run_problem(load_problem(RAMP_FILE, ["solver.tolerance=1e-8"]))
    same = climb(RAMP, SENSED, TABLE_I, torque=AMPLE, tolerance=1e-8)
    run, section = found.trajectory, section_of(found.setup.prisms)
    averages = climb_metrics(run, found.setup.vehicle, section)
    for measure in ("slip", "true_slip", "disturbance", "effort", "bearing"):
        np.testing.assert_allclose(
            getattr(averages, measure), getattr(same.metrics, measure), rtol=1e-3
        )
    np.testing.assert_allclose(run["y"], same.run["y"], atol=1e-6)
    assert run.facts["obstacles"].words.startswith("by t = 2.63")


@pytest.mark.slow
def test_outcomes_of_climbs():
    settings = sets("terrain.friction=0.4", *COARSE)
    result = invoke("run", STEP_FILE, "-o", "r.nc", *settings)
    assert result.exit_code == 0  # the motion is complete
    assert "stalls: by t = 3.6 s 0 of 3 wheels had reached the top, z = 0.09 m" in result.output
    assert "drew side, map" in result.output
    assert read_result("r.nc").wheels == ("rear", "middle", "front")
    settings = ["--set", "terrain.obstacles=[{step={height=0.3}}]", "--set", "terrain.friction=2"]
    result = invoke("run", STEP_FILE, "--no-draw", *settings, code=1)
    assert "tips over: at t = 1." in result.output
    assert "limit reached at t = 1." in result.stderr


def test_a_step_that_is_not_met_is_unfinished():
    run = run_problem(load_problem(STEP_FILE, ["time.duration=0.1"])).trajectory
    assert run.facts["obstacles"].words.startswith("no wheel touched an obstacle")


def test_the_start_is_at_rest_on_the_floor_and_rolls():
    start = build(load_problem(RAMP_FILE)).start
    assert start["center_y", "front"][0] == pytest.approx(foot(RAMP), abs=1e-6)
    assert start["velocity_y"][0] == pytest.approx(0.25, abs=1e-6)
    assert start["force_normal"].sum() == pytest.approx(21.6 * 9.81, rel=5e-3)


@pytest.mark.slow
def test_stairs_are_climbed():
    run = run_problem(load_problem(STAIRS_FILE, ["driver.period=", *COARSE])).trajectory
    assert run.facts["obstacles"].value == "climbs"
    np.testing.assert_allclose(run["center_z"][-1], 3 * 0.06 + 0.066, atol=1e-3)


@pytest.mark.slow
def test_a_sampled_controller_climbs_as_the_continuous_one():
    brief = ["time.duration=0.5", "time.step=0.004"]
    sampled = run_problem(load_problem(STAIRS_FILE, brief)).trajectory
    continuous = run_problem(load_problem(STAIRS_FILE, [*brief, "driver.period="])).trajectory
    np.testing.assert_allclose(sampled.t, 0.004 * np.arange(126), atol=1e-12)
    np.testing.assert_allclose(sampled["center_y"], continuous["center_y"], atol=5e-3)
    assert "rear_torque" in sampled.columns


def test_a_vehicle_file_climbs_as_the_catalogue():
    Path("climber.toml").write_text(vehicle_text(step_climber()))
    brief = ["time.duration=0.5", *COARSE]
    same = run_problem(load_problem(STEP_FILE, brief)).trajectory
    text = STEP_FILE.read_text().replace('catalog = "step_climber"', 'file = "climber.toml"')
    Path("p.toml").write_text(text)
    run = run_problem(load_problem(Path("p.toml"), brief)).trajectory
    np.testing.assert_allclose(run["center_z"], same["center_z"], atol=1e-9)
    assert "11: y, z, pitch, fold" in invoke("vehicle", "climber.toml", "--verbose").output


def test_the_side_view_shows_vehicle_and_solids():
    result = run_problem(load_problem(STEP_FILE, ["time.duration=0.2", *COARSE]))
    from slipfree.problem.load import verb_of

    figures = draw(verb_of(result.problem).figures(result)[:1])
    (ax,) = figures["side"].axes
    solids = [patch for patch in ax.patches if isinstance(patch, Polygon)]
    wheels = [patch for patch in ax.patches if isinstance(patch, Circle)]
    assert len(solids) == 2
    assert {round(wheel.radius, 3) for wheel in wheels} == {0.066}
    np.testing.assert_allclose(wheels[0].center[0], result.trajectory["center_y"][0, 0])
    assert ax.get_aspect() == 1


# Plans


@pytest.mark.slow
def test_a_plan_climbs_where_references_do_not():
    found = run_problem(load_problem(PLAN_FILE, COARSE))
    run, plan = found.trajectory, found.setup.plan
    counts = {name: fact.value for name, fact in run.facts.items()}
    assert run.facts["obstacles"].value == "climbs"
    # least friction of every leg, of a study with its own code
    np.testing.assert_allclose(plan.least, [0.579, 0.630, 0.677], atol=0.01)
    assert counts["plan_cost_friction"] == pytest.approx(0.7)
    assert counts["plan_driven"] == pytest.approx(counts["plan_cost_time"], rel=0.05)
    for *_, told in plan.parts:
        assert (np.abs(told.friction) <= 0.7 * told.load + 1e-5).all()
    averages = climb_metrics(run, found.setup.vehicle, section_of(found.setup.prisms))
    assert averages.true_slip[2] < 0.02
    facts = dict(motion_facts(run))
    assert "; time 3.3" in facts["plan"]
    assert facts["simulated"].endswith("meets all constraints")
    for law in ("projective", "fixed"):
        settings = ["terrain.friction=0.75", f"driver.control.law={law}", *COARSE]
        stuck = run_problem(load_problem(STEP_FILE, settings)).trajectory
        assert stuck.facts["obstacles"].value == "stalls", law


def test_a_goal_that_is_not_reached_is_inaccurate():
    settings = ["--set", "goal.y=[3, 4]", "--set", "time.duration=0.2"]
    result = invoke("run", PLAN_FILE, "--no-draw", *settings, code=1)
    assert "its simulation misses y at the goal by 3.3e+00 m" in result.output


def test_there_is_no_plan_without_enough_friction():
    settings = ["--set", "limits.utilisation=[0, 0.8]"]
    result = invoke("run", PLAN_FILE, "--no-draw", *settings, code=1)
    assert (
        "plan, leg 3, on which the rear wheels climb: expected a coefficient of friction of "
        "at least 0.67"
    ) in result.stderr
