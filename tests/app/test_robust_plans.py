"""Tests of robust plans in problem files: shares, tightening, outcomes, and unsuitable keys."""

from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm

import slipfree as sf
from helpers.cases import PROBLEMS
from helpers.commands import invoke, pressing, refused, sets
from slipfree.files import netcdf
from slipfree.plan.polynomial_motion import from_arrays
from slipfree.problem.inputs import recipe_of
from slipfree.problem.result import build
from slipfree.problem.verbs import plan_search
from slipfree.problem.verbs.base import Watch
from slipfree.problem.verbs.plan_search import ReplayTask, replay_draw

pytestmark = pytest.mark.slow

HILLS = PROBLEMS / "plan_rigid_hills.toml"
TILTS = PROBLEMS / "plan_tilt_limits.toml"
GAIN = 0.02
PLAIN = (  # straight ahead on even ground, at least effort: to the nearest admissible end
    "terrain.synthetic.power_law=",
    "costs={effort=1.0}",
    "goal={x=0.0, y=[2.0, 3.0]}",
    "plan.intervals=4",
    "plan.duration=8.0",
)
FLAT = (*PLAIN, f"plan.robust={{inputs={GAIN}, share=0.8, draws=12, final_draws=12}}")
NEAR = ("goal={x=0.3, y=1.0}", "plan.duration=8.0", "plan.intervals=12")


@pytest.fixture(autouse=True)
def one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulate drawn worlds in this process: the problems are small."""
    monkeypatch.setattr("slipfree.system.processes.available_cores", lambda: 1)


def test_a_command_leaves_the_result_to_another_one_that_runs(tmp_path):
    file = tmp_path / "robust.nc"
    file.write_bytes(b"of the other command")
    with plan_search.draw_folder(build(sf.load_problem(HILLS, FLAT)), file):
        words = refused("run", HILLS, "-o", file, "--no-draw", *sets(*FLAT))
    assert "found one in use; wait until the other robust plan ends" in words
    assert file.read_bytes() == b"of the other command"


def test_gains_of_the_inputs_tighten_the_goal_by_their_quantile(tmp_path, monkeypatch):
    file, (pressed, begun) = tmp_path / "robust.nc", pressing(plan_search.replay_draw, at=9)
    monkeypatch.setattr(plan_search, "replay_draw", pressed)
    command = ["run", str(HILLS), "-o", str(file), "--no-draw", *sets(*FLAT)]
    assert "without --resume" in invoke(*command, code=130).stdout
    result = invoke(*command, "-v", code=0)
    draws = [task.draw for (task,) in begun]
    assert [draws.count(draw) for draw in draws[:8]] == [1] * 8
    assert [each.name for each in tmp_path.iterdir()] == ["robust.nc"]
    assert "robust plan  " in result.stdout
    assert "lower bound of y at the goal by 0.0" in result.stdout
    found = netcdf.read(file)
    facts, y = found.facts, float(found["y"][-1])
    assert facts["plan_share_first"].value == pytest.approx(0.5, abs=0.3)  # ends on the bound
    assert facts["plan_share"].value >= 0.8
    # mean gain of two wheels with independent errors; level 0.9: half of the failures left
    assert y - 2.0 == pytest.approx(2.0 * norm.ppf(0.9) * GAIN / np.sqrt(2), rel=0.5)


def test_an_interruption_keeps_the_last_accurate_plan(monkeypatch):
    def interrupted(first, solve, *_, **__):
        solve({}, first)
        raise KeyboardInterrupt

    monkeypatch.setattr(plan_search, "robust_plan", interrupted)
    monkeypatch.setattr(plan_search, "solve_tightened", lambda *_: "tightened")
    problem = sf.load_problem(HILLS, FLAT)
    setup = SimpleNamespace(problem=problem, spec=problem.spec)
    assert plan_search.make_robust(setup, "first", None, Watch()).plan == "tightened"


def test_draws_are_the_same_in_processes_of_their_own(monkeypatch):
    few = (*FLAT, "plan.robust.draws=2", "plan.robust.final_draws=2")
    alone = sf.run_problem(sf.load_problem(HILLS, few)).trajectory
    monkeypatch.setattr("slipfree.system.processes.available_cores", lambda: 2)
    apart = sf.run_problem(sf.load_problem(HILLS, few)).trajectory
    names = [name for name in alone.facts if name.startswith("plan_share")]
    assert len(names) > 5
    assert [apart.facts[name] for name in names] == [alone.facts[name] for name in names]


def test_world_without_errors_keeps_the_bounds_of_the_plan():
    exact = (*PLAIN, "plan.robust.map={rms=1e-9, correlation=1.0}", "plan.robust.goal=0.01")
    motion = from_arrays(sf.run_problem(sf.load_problem(HILLS, PLAIN)).arrays, "first").motion
    task = ReplayTask(recipe_of(sf.load_problem(HILLS, exact)), (motion,), (0, 0, 0))
    (replay,) = replay_draw(task)
    assert replay.holds
    assert replay.distance < 1e-3
    assert {"x at the goal", "y at the goal", "steer"} <= {bound.name for bound in replay.excess}


def test_a_share_out_of_reach_is_infeasible_and_the_plan_is_kept(tmp_path):
    settings = (
        *NEAR,
        "plan.intervals=6",
        "plan.robust={draws=4, final_draws=4, goal=0.001, map={rms=0.02, correlation=0.5}}",
    )
    file = tmp_path / "missed.nc"
    told = invoke("run", HILLS, "-o", file, "--no-draw", *sets(*settings), code=1).stdout
    assert "infeasible: the plan holds in 0 of 4 drawn worlds, expected at least 95 %" in told
    assert "violated most often: " in told
    assert "x at the goal" in told
    assert file.exists()


def test_ctrl_c_during_the_drawn_worlds_keeps_the_plan():
    def interrupt(phase, _):
        if phase == "drawn worlds":
            raise KeyboardInterrupt

    found = sf.run_problem(sf.load_problem(HILLS, FLAT), tell=interrupt)
    assert found.outcome is sf.Outcome.INTERRUPTED
    assert "drawn worlds" in found.trajectory.stop.words
    assert found.trajectory["y"][-1] == pytest.approx(2.0, abs=1e-3)


def test_limits_of_a_guaranteed_plan_hold_with_the_ground_under_the_wheels_shifted():
    error, least = 0.005, -0.062
    problem = sf.load_problem(TILTS, [f"limits.pitch=[{least}, 0.2]", f"plan.guarantee={error}"])
    found, setup = sf.run_problem(problem).trajectory, build(problem)
    k, grid, pitch = int(found["pitch"].argmin()), setup.terrain.grid, list[float]()
    x, y = (found[f"contact_{axis}"][k] for axis in "xy")
    nearest = np.hypot(grid.x[:, None, None] - x, grid.y[:, None] - y).argmin(axis=-1)
    for sides in product([-0.95, 0.95], repeat=3):  # the spline overshoots where the sign changes
        ground = sf.Bicubic(replace(grid, z=grid.z + error * np.take(sides, nearest)))
        model = sf.direct_kinematics(setup.vehicle, ground)
        pose = sf.settle(model, **{name: float(found[name][k]) for name in model.state_names})
        pitch.append(float(pose["pitch"][0]))
    assert least < min(pitch) < least + 0.3 * (found["pitch"][k] - least)
    costs = found.facts["plan_total_cost"], found.facts["plan_untightened_total"]
    assert costs[0].value > 1.002 * costs[1].value


def test_poses_of_a_plan_that_are_not_guaranteed_are_counted(folder):
    told = invoke("run", TILTS, "--no-draw", *sets("plan.guarantee=0.3"), code=1).stdout
    assert "poses are not guaranteed, the first at x = 0.00 m, y = 0.00 m: " in told
    assert (folder / "plan_tilt_limits.nc").exists()
