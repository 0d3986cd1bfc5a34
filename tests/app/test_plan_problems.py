"""Tests of plans in problem files: routes, keep-out regions, cusps, windows, and errors."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from helpers.cases import PROBLEMS
from slipfree.core.trajectory import Outcome
from slipfree.files.netcdf import write
from slipfree.plan import search as searching
from slipfree.plan.ipopt import SOLVED_STATUS
from slipfree.plan.polynomial_motion import from_arrays
from slipfree.problem.load import load_problem
from slipfree.problem.result import build, motion_facts, open_result, run_problem
from slipfree.problem.verbs.base import Result
from slipfree.problem.verbs.plan import PlanVerb, figure_options
from slipfree.problem.verbs.plan_search import start_motion
from slipfree.problem.verbs.plan_setup import regions
from slipfree.show.plan_figures import plan_plots
from slipfree.show.plots import draw

FIELD = PROBLEMS / "plan_crater_field.toml"
HILLS = FIELD.with_name("plan_rigid_hills.toml")
SHORT = (
    *("start.y=14.0", "goal.y=24.0", "plan.intervals=12", "plan.duration=20.0", "costs.slip="),
    *("start.x=17.5", "goal.x=17.5", "solver.tolerance=1e-6"),
)


@pytest.mark.slow
def test_a_route_around_a_place_to_keep_out_of_is_planned_and_simulated():
    problem = load_problem(FIELD, SHORT)
    motion = run_problem(problem).trajectory
    assert motion.stop is None
    assert np.hypot(motion["x"][-1] - 17.5, motion["y"][-1] - 24.0) < 0.01
    (disc,) = regions(problem)
    reach = np.hypot(1.0, 0.5) + 0.3  # of the rear wheels; the front one reaches 1.3 m
    # between the points of 12 intervals
    assert disc.distance(motion["x"], motion["y"]).min() > reach - 0.02


PARKING = FIELD.with_name("plan_parking.toml")
WINDOWS = (
    "plan.duration=",
    "driver={name='follow', speed=0.25, path=[[0.0, 0.0], [0.2, 1.5], [0.6, 2.6]]}",
    *("plan.window=1.2", "plan.overlap=0.4", "plan.intervals=5"),
)


def test_several_routes_start_the_search():
    level = "terrain.synthetic.craters=", "terrain.synthetic.power_law="
    setup = build(load_problem(FIELD, (*level, "plan.starts=2")))
    assert len(setup.guide.paths) == len(setup.starts) == 2


@pytest.mark.slow
def test_the_law_of_friction_plans_a_gentle_ground():
    """The motion is a prediction then, so that nothing is left to drive by friction again."""
    law = "model='quasi-static'", "law.coulomb.creep=1e-2", "terrain.friction=0.6"
    motion = run_problem(load_problem(HILLS, [*QUICK, *law])).trajectory
    assert motion.stop is None
    assert "friction_used_along" in motion.columns
    assert not any(name.startswith("friction_") for name in motion.facts)
    assert abs(motion["y"][-1] - 1.3) < 1e-4


@pytest.mark.slow
def test_a_plan_of_tilting_wheels_keeps_to_their_limits():
    motion = run_problem(load_problem(FIELD.with_name("plan_tilt_limits.toml"))).trajectory
    assert motion.stop is None
    for wheel in ("right", "left"):
        assert np.abs(motion[f"tilt_{wheel}"]).max() < 0.031
    assert np.hypot(motion["slip_along"], motion["slip_across"]).max() < 1e-12


QUICK = (
    *("plan.intervals=8", "plan.duration=10.0", "goal.x=0.1", "goal.y=1.3", "costs.slip=1e3"),
    "solver.tolerance=1e-6",
)


@pytest.mark.slow
def test_the_conditions_of_a_goal_are_made_once(monkeypatch):
    module, made = sys.modules["slipfree.plan.problem"], []

    def counted(dae, name, bounds, original=module._conditions):
        made.append(name)
        return original(dae, name, bounds)

    monkeypatch.setattr(module, "_conditions", counted)
    assert run_problem(load_problem(HILLS, QUICK)).trajectory.stop is None
    assert sorted(name for name in made if name in ("x", "y")) == ["x", "y"]


@pytest.fixture(scope="module")
def bounded() -> Result:
    """Return a plan past a way-point, with one bounded input."""
    between = "way_points=[{ at = 0.5, x = 0.35, y = [1.0, 1.6] }]"
    bounds = "bounds={ left_rate = [-1.0, 1.0] }"
    return run_problem(load_problem(HILLS, [*QUICK, between, bounds]))


@pytest.mark.slow
def test_a_way_point_is_passed(bounded):
    motion = bounded.trajectory
    assert motion.stop is None
    x, y = (np.interp(motion.t[-1] / 2, motion.t, motion[name]) for name in "xy")
    assert abs(x - 0.35) < 0.01
    assert 1.0 - 0.01 < y < 1.6 + 0.01
    assert [name for name, *_ in bounded.setup.places] == ["start", "way-point at 0.5", "goal"]


@pytest.mark.slow
def test_all_inputs_are_drawn_however_many_are_bounded(bounded):
    motion, setup = bounded.trajectory, bounded.setup
    drawn = draw(
        plan_plots(motion, setup.ground.grid, setup.layers, **figure_options(bounded, setup))
    )
    panel = drawn["plan"].axes[0]
    names = ["right rate", "left rate", "steer rate", "bound", "bound"]
    assert panel.get_legend_handles_labels()[1] == names
    np.testing.assert_array_equal(panel.lines[1].get_ydata(), motion["left_rate"])


@pytest.mark.slow
def test_work_of_the_drives_is_planned_with():
    motion = run_problem(load_problem(HILLS, [*QUICK, "costs.energy=1.0"])).trajectory
    energy = motion.facts["plan_cost_energy"].value
    powers = np.maximum(motion["drive_torque"] * motion["wheel_rate"], 0.0).sum(axis=1)
    work = np.trapezoid(powers, motion.t)
    assert abs(energy - work) < 0.1 * 2 * 10.0  # blended by 0.1 W a wheel
    assert energy > 0


@pytest.mark.slow
def test_limits_have_names_and_of_a_range_what_lies_on_the_map_counts():
    limits = {"map_margin": (1, 30), "tip_over_margin": (0.9, 3.0), "slip_across": (-1e-3, 1e-3)}
    settings = [f"limits.{name}=[{low}, {high}]" for name, (low, high) in limits.items()]
    problem = load_problem(HILLS, [*QUICK, *settings, "goal.y=[1.2, 60.0]"])
    motion = run_problem(problem).trajectory
    assert motion.stop is None
    assert motion["y"][-1] > 1.2 - 1e-4
    for name, (low, _) in limits.items():
        assert motion[name].min() > low - 1e-3 * abs(low), name


@pytest.mark.slow
def test_an_accuracy_that_is_missed_is_an_early_stop_with_its_reason(monkeypatch):
    monkeypatch.setattr(searching, "MAX_REFINEMENTS", 1)
    told = "slipfree.problem.verbs.plan.separation_words"
    monkeypatch.setattr(told, lambda *_, by_friction: f"no route leads: {by_friction}")
    settings = [*QUICK, "plan.degree=1", "plan.intervals=1", "plan.accuracy=1e-7", "costs.slip="]
    stop = run_problem(load_problem(HILLS, settings)).trajectory.stop
    assert (stop.name, stop.outcome) == ("plan_accuracy", Outcome.INACCURATE)
    misses = "no usable plan: its simulation misses x by .* m, .*; plan.accuracy allows 1e-07: "
    assert re.match(f"{misses}refinements of its mesh did not suffice", stop.words)
    assert stop.words.endswith("\non the mobility map no route leads: False")


@pytest.mark.slow
def test_a_time_limit_that_ended_the_search_is_in_the_summary(bounded, monkeypatch):
    assert "time limit" not in dict(motion_facts(bounded.trajectory))
    monkeypatch.setattr("slipfree.problem.verbs.plan.TIME_STATUS", SOLVED_STATUS)
    told = dict(motion_facts(run_problem(load_problem(HILLS, QUICK)).trajectory))["time limit"]
    assert told.endswith("the plan meets all constraints, its cost may not be least")


@pytest.mark.slow
def test_the_initial_guess_is_stored_and_drawn(tmp_path):
    found = run_problem(load_problem(HILLS, QUICK))
    write(tmp_path / "hills.nc", found.trajectory, found.arrays)
    result = open_result(tmp_path / "hills.nc")
    run = result.trajectory
    assert run.facts["plan_searches"].value[:2] == ["without slip cost", "with slip cost"]
    figures = {plot.name: plot for plot in PlanVerb().figures(result)}
    drawn = draw([figures["traversability"]])
    lines = {line.get_label(): line for line in drawn["traversability"].axes[0].lines}
    guess = lines["initial guess"].get_xydata()
    np.testing.assert_allclose(guess[0], [run["x"][0], run["y"][0]], atol=1e-9)
    assert np.hypot(*(guess[-2] - guess[0])) > 1.0


def _driven(folder: Path, goal: str, duration: float) -> Result:
    """Return the result of a plan of a differential drive on level ground."""
    file = folder / "p.toml"
    file.write_text(
        'verb = "plan"\nframe = "rep103"\ncosts = { slip = 1.0, effort = 0.1 }\n'
        f"goal = {goal}\nplan = {{ intervals = 20 }}\n"
        'driver = { name = "straight", speed = 0.25 }\n'
        f"time = {{ duration = {duration}, step = 0.5 }}\n"
        'vehicle = { catalog = "differential_drive" }\n'
        "terrain.synthetic = { x = [-5.0, 5.0], y = [-5.0, 5.0], spacing = 0.5 }\n"
    )
    return run_problem(load_problem(file))


def test_a_goal_a_turn_away_is_reached_the_short_way(tmp_path: Path):
    result = _driven(tmp_path, '{ x = 1.5, heading = "370 deg" }', 6.0)
    motion = result.trajectory
    assert motion.stop is None
    assert motion["heading"][-1] == pytest.approx(np.deg2rad(10), abs=1e-3)
    assert dict(motion_facts(motion))["whole turns"] == (
        "heading is 10 deg at the end, a turn less than 370 deg: the same position, "
        "reached the short way"
    )


@pytest.mark.slow
def test_a_caster_that_ends_a_turn_from_the_plan_is_in_the_same_position(tmp_path: Path):
    result = _driven(tmp_path, "{ x = -2.0, y = 0.0, heading = 3.1416 }", 8.0)
    motion = result.trajectory
    assert result.outcome is Outcome.COMPLETE
    assert motion.t.size < 400  # no finer mesh
    assert motion.facts["plan_difference_caster_angle"].value < 1e-3
    (turned,) = motion.facts["plan_turns"].value
    assert (turned["angle"], abs(turned["turns"]), turned["than"]) == ("caster_angle", 1, "plan")


@pytest.mark.slow
def test_parking_has_cusps():
    run = run_problem(load_problem(PARKING)).trajectory
    assert run.outcome is Outcome.COMPLETE
    end = [run[name][-1] for name in ("x", "y", "heading")]
    assert end == pytest.approx([2.0, 0.0, 0.0], abs=1e-3)
    forward = np.cos(run["heading"]) * np.gradient(run["y"]) - np.sin(run["heading"]) * np.gradient(
        run["x"]
    )
    gears = np.sign(forward[np.abs(forward) > 1e-4])
    assert (np.diff(gears) != 0).sum() >= 2  # cusps


@pytest.mark.parametrize("goal", ["{x=-1.0, y=-3.0, heading=0.5}", "{x=-1.0, y=-3.0}"])
def test_guess_with_cusps_ends_at_the_goal_on_even_ground(goal):
    setup = build(load_problem(PARKING, ("terrain.synthetic.power_law=", f"goal={goal}")))
    run = start_motion(setup, 0)
    assert (run["x"][-1], run["y"][-1]) == pytest.approx((-1.0, -3.0), abs=1e-3)
    assert setup.guide.paths == ()


@pytest.mark.slow
def test_ctrl_c_keeps_the_windows_before_it_and_the_plan_goes_on_from_there():
    problem = load_problem(HILLS, WINDOWS)

    def interrupt(phase, _):
        if not phase.startswith("0 to"):
            raise KeyboardInterrupt

    kept = run_problem(problem, tell=interrupt)
    run = kept.trajectory
    assert run.outcome is Outcome.INTERRUPTED
    assert "m of the route" in run.stop.words
    assert 0 < run.t[-1] < 10
    rest = run_problem(problem, resume=from_arrays(kept.arrays, "kept")).trajectory
    assert rest.outcome is Outcome.COMPLETE
    assert np.hypot(rest["x"][-1] - 0.6, rest["y"][-1] - 2.6) < 2e-3
    assert re.match(
        r"\d windows up to 2\.68\d* m of the route", dict(motion_facts(rest))["windows"]
    )
