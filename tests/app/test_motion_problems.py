"""Tests of problems with inertia, of rigid vehicles, of step climbers, and of plans."""

import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.patches import Circle, Polygon

from helpers.cases import PROBLEMS
from helpers.climb_cases import AMPLE, RAMP, SENSED, TABLE_I, climb, foot
from helpers.commands import invoke, printed, refused, sets
from helpers.dynamics import energy_error
from helpers.problem_files import rough_ground
from slipfree import Bicubic, Solids, catalog
from slipfree.catalog import step_climber
from slipfree.climb.metrics import climb_metrics
from slipfree.core.trajectory import PLAN, Outcome, Stop
from slipfree.files.netcdf import read, write
from slipfree.files.vehicle_toml import vehicle_text
from slipfree.plan import search as searching
from slipfree.plan.plan import Plan
from slipfree.plan.polynomial_motion import from_arrays
from slipfree.problem.build import build_solids
from slipfree.problem.build_ground import build_ground
from slipfree.problem.load import load_problem, verb_of
from slipfree.problem.result import build, motion_facts, open_result, run_problem
from slipfree.problem.verbs import plan_search as module
from slipfree.problem.verbs.base import Result
from slipfree.problem.verbs.plan import (
    PlanVerb,
    _simulated,
    figure_options,
    initial_speed,
    with_advice,
)
from slipfree.problem.verbs.plan_search import start_motion
from slipfree.problem.verbs.plan_setup import regions
from slipfree.show import plots
from slipfree.show.plan_figures import plan_plots
from slipfree.show.plots import draw
from slipfree.terrain.solids import section_of

FILE = Path("r.nc")


def drove(problem, *settings, code=0):
    """Return what the run of a problem with inertia prints, and its result, kept in a file."""
    problem = PROBLEMS / f"dynamics_{problem}.toml"
    done = invoke("run", problem, "-o", FILE, "--no-draw", *sets(*settings), code=code)
    return done.output, open_result(FILE)


@pytest.mark.slow
def test_a_run_tells_contact_and_energy_and_is_reported(monkeypatch):
    _, result = drove("rocks", "time.duration=0.5")
    for name in ("compliant contact", "energy balance", "a prediction with"):
        assert name in printed("info", FILE)
    run, figures = result.trajectory, verb_of(result.problem).figures(result)
    flies = (run["depth"] < 0).all(axis=1).any()
    assert ("vehicle in the air" in printed("info", FILE)) == flies
    assert {"contact", "energy", "checks"} <= {each.name for each in figures}
    exchanged = np.abs(run["work"]).max() + run["lost_energy"][-1]
    assert np.abs(energy_error(run)).max() < 100 * 1e-6 * exchanged
    assert run["velocity_x"][0] == pytest.approx(1.0, abs=0.01)  # the initial speed
    monkeypatch.setattr("slipfree.problem.verbs.base.DriveVerb.figures", lambda *_: ())
    assert "replaces" not in printed("report", FILE, "-o", "r.html")
    assert "which replaces the earlier file" in printed("show", FILE, "--html", "r.html")


def test_the_torque_of_a_sudden_start_is_told_with_that_after_it():
    told, result = drove("skid_turn", "time.duration=0.3")
    torque, t = np.abs(result.trajectory["drive_torque"]), result.trajectory.t
    assert torque.max() == torque[0].max() > 5 * (later := torque[t > 0.1].max())
    assert f"t = 0 s, as wheels reach their rates; {later:.4g} N m after 0.1 s)" in told


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:slower:UserWarning")
def test_plans_of_pressed_wheels_are_simulated_with_friction_and_inertia():
    """The same motion, from its exported rates, ends as far from the plan."""
    file = PROBLEMS / "plan_rigid_robot.toml"
    told = printed("run", file, "-o", FILE, "--no-draw", *sets("goal.x=1.2", "plan.duration=2"))
    assert "from the plan, with inertia, slips" in told
    printed("export", FILE, "--rates", "rates.csv")
    plan = open_result(FILE).trajectory
    head = file.read_text().split("[goal]")[0].replace('"plan"', '"direct"\nmodel = "dynamics"')
    last = "[inputs]\nfile = 'rates.csv'\n[time]\nduration = 2\nstep = 0.02\n"
    Path("again.toml").write_text(f"{head}speed = {initial_speed(plan.in_frame('paper'))}\n{last}")
    printed("run", "again.toml", "-o", "again.nc", "--no-draw")
    again = open_result(Path("again.nc")).trajectory
    apart = np.hypot(*(again[name][-1] - plan[name][-1] for name in "xy"))
    assert apart == pytest.approx(plan.facts["friction_end_distance"].value, abs=2e-3)


@pytest.mark.slow
def test_a_car_jumps_from_a_ledge():
    run = drove("ledge", "time.duration=0.8")[1].trajectory
    told = printed("info", FILE)
    flying = (run["depth"] < 0).all(axis=1)
    t = run.t[flying]
    assert f"{t[-1] - t[0] + 0.005:.3g} s in all" in told
    assert "4 lift-offs, counted per wheel" in told
    lifted = run["depth"] < 0
    for quantity in ("slip_along", "slip_across", "slip_ratio", "force_normal"):
        assert np.abs(run[quantity][lifted]).max() == 0
    travel = run["front_left_travel"]
    assert travel[lifted[:, 2]].min() < -0.02  # the spring pushes the wheel down in the air
    assert travel.max() > 0.02  # and yields at the landing


@pytest.mark.slow
def test_skid_steering_depends_on_the_model_and_with_inertia_on_the_speed():
    """At half the rates in twice the time, a quarter of the difference is left."""
    ends = {}
    for model, factor in (("kinematics", 1), ("quasi-static", 1), ("dynamics", 1), ("dynamics", 2)):
        wheels = [f"{end}_{side}_rate" for end in ("front", "rear") for side in ("left", "right")]
        rates = [f"{name}={factor * (2 if 'left' in name else 4)}" for name in wheels]
        options = [f"model={model}", f"inputs={{{','.join(rates)}}}", f"time.duration={6 / factor}"]
        told, result = drove("skid_turn", *options)
        assert ("without the friction of sliding wheels" in told) == (model == "kinematics")
        run = result.trajectory
        ends[model, factor] = np.array([run["x"][-1], run["y"][-1]])
    still = ends["quasi-static", 1]
    slow, fast = (np.hypot(*(ends["dynamics", k] - still)) for k in (1, 2))
    assert np.hypot(*(ends["kinematics", 1] - still)) > 0.2
    assert slow < 0.03
    assert 3 < fast / slow < 6


@pytest.mark.slow
def test_a_motor_spins_its_wheel_on_ice():
    told, result = drove("ice")
    assert "diagnostics failed" not in told
    run = result.trajectory
    on_ice = run["contact_x", "rear_left"] < 0.2
    assert (run["slip_ratio", "rear_left"][1:][on_ice[1:]] > 0.5).mean() > 0.5
    assert run["slip_ratio", "rear_left"][-1] < 0.01  # off the ice
    assert np.abs(run["slip_along", "rear_right"]).max() < 0.01
    assert run["drive_torque", "rear_right"].max() == pytest.approx(8, abs=1e-6)


@pytest.mark.slow
def test_a_car_that_tips_over_stops_at_a_named_limit():
    told, result = drove("tip_over", code=1)
    assert "(upright): the platform overturns: it is inclined by more than 84.3 deg" in told
    assert result.trajectory["tip_over_margin"][-1] < 0
    rates = [f"inputs.rear_{side}_rate=13.3" for side in ("left", "right")]
    drove("tip_over", "start.speed=2", *rates)


@pytest.mark.slow
def test_a_sampled_driver_ends_near_the_continuous_one():
    ends = []
    for sampled in ([], ["driver.period=0.01"]):
        run = drove("rocks", "time.duration=0.8", "time.step=0.02", *sampled)[1].trajectory
        assert ("driver straight, every 0.01 s" in printed("info", FILE)) == bool(sampled)
        assert run.t == pytest.approx(0.02 * np.arange(41))
        ends.append(np.array([run["x"][-1], run["y"][-1], run["z"][-1]]))
    assert 1e-7 < np.linalg.norm(ends[0] - ends[1]) < 1e-3


@pytest.mark.slow
def test_a_sampled_driver_stops_at_a_limit():
    settings = ("driver.period=0.005", "terrain.synthetic.x=[-3.0, 0.7]", "time.step=0.02")
    run = drove("rocks", *settings, code=1)[1].trajectory
    assert run.t[:-1] == pytest.approx(0.02 * np.arange(run.t.size - 1))
    assert run.t[-2] < run.t[-1] == run.stop.t


@pytest.mark.slow
def test_a_rover_meets_a_step():
    told, result = drove("step", "time.duration=4")
    assert "not converged" not in told
    assert "obstacles unfinished: by t = 4 s" in " ".join(told.split())
    run = result.trajectory
    assert run["solid_load_1"].max() > 10
    maps = [each for each in verb_of(result.problem).figures(result) if each.name == "map"]
    for name, figure in plots.draw(maps).items():
        for ax in (ax for ax in figure.axes if ax.get_xlabel()):
            (outline,) = [each for each in ax.patches if each.get_label() == "solids"]
            corners = outline.get_xy()
            assert corners[:, 1].min() == pytest.approx(0.6), name
            assert corners[:, 1].max() > ax.get_ylim()[1], name
    assert run["contact_z"].max() > 0.05
    invoke("show", FILE, "--html", "page.html", code=0)


def test_an_obstacle_stands_where_the_file_says():
    """A kerb along y, in a file whose headings count from x, on ground at 2 m."""
    kerb = "kerb={height=0.1, length=0.5}, y=1.0, heading='90 deg', half_width=0.3"
    settings = ["terrain.synthetic.base=2.0", f"terrain.obstacles=[{{{kerb}}}]"]
    problem = load_problem(PROBLEMS / "dynamics_step.toml", settings)
    terrain = Bicubic(build_ground(problem).grid, (0.0, 0.0), 0.9)
    (prism,) = build_solids(problem, terrain)
    x, y = np.array([0.1, 0.4, 0.1]), np.array([1.2, 1.2, 1.6])
    tops = Solids(terrain, (prism,)).elevation(x, y)
    assert tops == pytest.approx([2.1, 2.0, 2.0])


# Problem files for plans with momentum

MOMENTUM = PROBLEMS / "plan_momentum.toml"
SHORT = ("goal.y=1.5", "time.duration=1.25", "plan.intervals=6", "plan.degree=2")


@pytest.mark.slow
def test_a_plan_with_momentum_is_simulated_in_the_same_run():
    problem = load_problem(MOMENTUM, SHORT)
    run = run_problem(problem).trajectory
    assert run.stop is None
    assert run.attributes["model"] == "dynamics"
    lines = dict(PlanVerb().summary(run))
    assert "the platform stays within" in lines["simulated with compliant contacts"]
    assert "without inertia the same path needs torques" in lines["driven slowly"]
    assert max(run.facts[f"plan_difference_{axis}"].value for axis in "xyz") < 0.01
    assert abs(run["y"][-1] - 1.5) < 0.01


def test_an_infeasible_slow_plan_offers_momentum():
    """The guess needs 30 N m at y = 2.5 m, and four wheels with 6.5 N m give 26 N m."""
    places = {"x": np.zeros(3), "y": np.array([0.0, 2.5, 4.0])}
    guess = places | {"drive_torque": np.array([[1.0] * 4, [7.5] * 4, [2.0] * 4])}
    stop = Stop("plan", 0.0, "infeasible: no motion", Outcome.INFEASIBLE)
    setup = SimpleNamespace(
        spec=SimpleNamespace(model="quasi-static", limits={"drive_torque": (-6.5, 6.5)}),
        vehicle=catalog.skid_steer(),
        **{"layers": None, "places": [("start", 0.0, 0.0)], "needs_friction": True},
    )
    found = SimpleNamespace(run=SimpleNamespace(stop=stop))
    words = with_advice(setup, found, [guess]).words
    assert "needs torques of 30 N m in all (at x = 0.00 m, y = 2.50 m)" in words
    assert "limits.drive_torque allows 26 N m" in words
    assert 'set model = "dynamics" to plan with momentum' in words
    setup.spec.limits = {"drive_torque": (-8.0, 8.0)}
    assert "needs torques" not in with_advice(setup, found, [guess]).words
    setup.needs_friction = False
    assert with_advice(setup, found, [guess]) == stop


# Rigid vehicles: summary of a drive, and plans with sharper load laws

DRIVE = """\
verb = "direct"
vehicle = { catalog = "rigid_skid_steer" }
start = {}
time = { duration = 2.0, step = 0.05 }

[inputs]
front_right_rate = 4.0
front_left_rate = 4.0
rear_right_rate = 4.0
rear_left_rate = 4.0
""" + rough_ground("[-2, 2]", "[-2, 4]", 0.1, "rms = 0.04, longest = 3.0, shortest = 1.0", 4)
GOAL = """
goal = { y = 1.2 }
costs = { slip = 100.0, effort = 0.001 }
plan = { intervals = 8, smooth = 1e-4, accuracy = 0.01 }
"""


@pytest.fixture
def plan_file(folder: Path) -> str:
    """Write the problem of a plan into an empty current folder."""
    (folder / "p.toml").write_text(DRIVE.replace('"direct"', f'"plan"{GOAL}'))
    return "p.toml"


def run(file: str, *words: str, code: int = 0) -> str:
    result = invoke("run", file, "--no-draw", "-v", *words, code=code)
    return result.stdout


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_a_summary_has_wheels_in_the_air_and_rocks():
    Path("d.toml").write_text(DRIVE)
    facts = run("d.toml")
    for name in ("pressed wheels", "wheels in the air", "least loaded wheel"):
        assert f"\n{name} " in facts
    assert "x the tolerance" not in facts  # the error test ignores the unknowns


@pytest.mark.slow
def test_a_plan_is_made_with_three_widths(plan_file, monkeypatch):
    models = observed(monkeypatch)
    run(plan_file)
    assert len(models) == 1 + len(module.SMOOTHINGS)
    assert read(Path("p.nc")).outcome is Outcome.COMPLETE


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fails", "outcome"), [(Outcome.SOLVER_FAILURE, Outcome.COMPLETE), 2 * (Outcome.INTERRUPTED,)]
)
def test_a_plan_survives_the_failure_of_a_sharper_law(plan_file, monkeypatch, fails, outcome):
    models = observed(monkeypatch, fails=fails)
    run(plan_file, code=outcome.exit_code)
    assert len(models) == 2
    assert read(Path("p.nc")).outcome is outcome


FIRST: list[Plan] = []  # the plan with the widest law, which all tests begin with


def observed(monkeypatch: pytest.MonkeyPatch, fails: Outcome | None = None) -> list[Any]:
    """Record the models of all plans; the second one ends with an outcome."""
    models, solve_task = list[Any](), module.solve_task

    def planned(task: Any, *words: Any, **more: Any) -> Plan:
        models.append(task.dae)
        if len(models) == 1:
            if not FIRST:
                FIRST.append(solve_task(task, *words, **more))
            return FIRST[0]
        if fails is None:
            return solve_task(task, *words, **more)
        run = FIRST[0].run
        stop = Stop(PLAN, float(run.t[-1]), "made up", fails)
        return replace(FIRST[0], success=False, run=replace(run, stop=stop))

    monkeypatch.setattr(module, "solve_task", planned)
    return models


@pytest.mark.usefixtures("folder")
def test_remedies_for_a_rigid_vehicle_are_values_of_the_file():
    """Quasi-statics cannot place a rigid vehicle; each model that its message names can."""
    text = DRIVE.replace('"direct"', '"direct"\nmodel = "quasi-static"\nterrain.friction = 0.8')
    Path("p.toml").write_text(text)
    remedies = re.findall(r"'(\w+)'", refused("run", "p.toml", "--no-draw").split(";")[-1])
    assert remedies == ["dynamics", "kinematics"]
    for model in remedies:
        run("p.toml", "--set", f"model={model}", "--set", "time.duration=0.2")


# Step climbers

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
    assert read("r.nc").wheels == ("rear", "middle", "front")
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
    words = "plan, leg 3, on which the rear wheels climb: expected a coefficient of friction of "
    assert f"{words}at least 0.67" in result.stderr


# Plans: routes, keep-out regions, cusps, windows

FIELD = PROBLEMS / "plan_crater_field.toml"
HILLS = FIELD.with_name("plan_rigid_hills.toml")
AROUND = (
    *("start.y=14.0", "goal.y=24.0", "plan.intervals=12", "plan.duration=20.0", "costs.slip="),
    *("start.x=17.5", "goal.x=17.5", "solver.tolerance=1e-6"),
)


@pytest.mark.slow
def test_a_route_around_a_place_to_keep_out_of_is_planned_and_simulated():
    problem = load_problem(FIELD, AROUND)
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
def test_after_the_time_limit_a_plan_is_not_simulated_with_other_models(bounded):
    late = replace(bounded.setup, deadline=0.0)
    (told,) = _simulated("stiff", late, None, None, None).values()
    assert told.value == "not simulated: the time limit has passed"


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
    assert re.match(f"{misses}its refined meshes did not suffice; raise plan.int", stop.words)
    assert stop.words.endswith("\non the mobility map no route leads: False")


@pytest.mark.slow
def test_a_time_limit_that_ended_the_search_is_in_the_summary(bounded, monkeypatch):
    assert "cost" not in dict(motion_facts(bounded.trajectory))
    words = {searching.ipopt.SOLVED_STATUS: "the search ended early"}
    monkeypatch.setattr(searching.ipopt, "NOT_LEAST", words)
    told = dict(motion_facts(run_problem(load_problem(HILLS, QUICK)).trajectory))["cost"]
    assert told.startswith("may not be least: the search ended early; the plan meets all")


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
def test_a_plan_with_a_smoother_load_law_is_verified_if_the_next_search_fails(monkeypatch):
    solve, plans = module.solve_task, []

    def second_fails(*args, **options):
        plans.append(solve(*args, **options))
        return replace(plans[-1], success=len(plans) < 2)

    monkeypatch.setattr(module, "solve_task", second_fails)
    settings = ("vehicle={catalog='rigid_skid_steer'}", "goal={x=0.0, y=1.0}", "bounds=", "limits=")
    run = run_problem(load_problem(PROBLEMS / "plan_rigid_hills.toml", settings)).trajectory
    assert len(plans) == 2
    assert run.t[-1] == pytest.approx(plans[0].motion.duration)
    assert run.facts["plan_difference_x"].value < 1e-3


@pytest.mark.slow
def test_a_plan_with_a_caster_that_swings_to_the_other_side_is_its_simulation(tmp_path: Path):
    """A caster driven backwards is unstable: by rounding it swings to either side, on any mesh."""
    result = _driven(tmp_path, "{ x = -2.0, y = 0.0, heading = 3.1416 }", 8.0)
    motion = result.trajectory
    assert result.outcome is Outcome.COMPLETE
    assert motion.facts["plan_difference_caster_angle"].value < 1e-3
    assert "this simulated motion is the plan" in dict(motion_facts(motion))["cost"]


@pytest.mark.slow
def test_parking_has_cusps():
    run = run_problem(load_problem(PARKING)).trajectory
    assert run.outcome is Outcome.COMPLETE
    end = [run[name][-1] for name in ("x", "y", "heading")]
    assert end == pytest.approx([2.0, 0.0, 0.0], abs=1e-3)
    way = np.gradient(run["x"]), np.gradient(run["y"])
    forward = np.cos(run["heading"]) * way[1] - np.sin(run["heading"]) * way[0]
    gears = np.sign(forward[np.abs(forward) > 1e-4])
    words = f"reverses {np.count_nonzero(np.diff(gears))} times; 6.06 m long for 2 m from start"
    assert dict(motion_facts(run))["path"].startswith(words)


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
