"""Tests of problems with inertia on the command line: results, plans with momentum, and errors."""

from types import SimpleNamespace

import numpy as np
import pytest

from helpers.cases import PROBLEMS
from helpers.commands import invoke, printed, sets
from helpers.dynamics import energy_error
from slipfree import Bicubic, Outcome, Solids, catalog, load_problem, open_result, run_problem
from slipfree.core.trajectory import Stop
from slipfree.problem.build import build_solids
from slipfree.problem.build_ground import build_ground
from slipfree.problem.load import verb_of
from slipfree.problem.verbs.plan import PlanVerb, with_offer
from slipfree.show import plots

ROCKS = str(PROBLEMS / "dynamics_rocks.toml")


@pytest.mark.slow
def test_a_run_tells_contact_and_energy_and_is_reported(tmp_path, monkeypatch):
    file = tmp_path / "r.nc"
    invoke("run", ROCKS, "-o", file, "--set", "time.duration=0.5", "--no-draw", code=0)
    for name in ("compliant contact", "energy balance", "a prediction with"):
        assert name in printed("info", file)
    result = open_result(file)
    run, figures = result.trajectory, verb_of(result.problem).figures(result)
    flies = (run["depth"] < 0).all(axis=1).any()
    assert ("vehicle in the air" in printed("info", file)) == flies
    assert {"contact", "energy", "checks"} <= {each.name for each in figures}
    exchanged = np.abs(run["work"]).max() + run["lost_energy"][-1]
    assert np.abs(energy_error(run)).max() < 100 * 1e-6 * exchanged
    assert run["velocity_x"][0] == pytest.approx(1.0, abs=0.01)  # the initial speed
    monkeypatch.setattr("slipfree.problem.verbs.base.DriveVerb.figures", lambda *_: ())
    invoke("report", file, "-o", tmp_path / "r.html", code=0)
    invoke("show", file, "--html", tmp_path / "page.html", code=0)


@pytest.mark.slow
def test_a_car_jumps_from_a_ledge(tmp_path):
    file = tmp_path / "r.nc"
    name = PROBLEMS / "dynamics_ledge.toml"
    invoke("run", name, "-o", file, "--set", "time.duration=0.8", "--no-draw", code=0)
    told = printed("info", file)
    run = open_result(file).trajectory
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
def test_skid_steering_depends_on_the_model_and_with_inertia_on_the_speed(tmp_path):
    """At half the rates in twice the time, a quarter of the difference is left."""
    file, ends = tmp_path / "r.nc", {}
    for model, factor in (("kinematics", 1), ("quasi-static", 1), ("dynamics", 1), ("dynamics", 2)):
        wheels = [f"{end}_{side}_rate" for end in ("front", "rear") for side in ("left", "right")]
        rates = [f"{name}={factor * (2 if 'left' in name else 4)}" for name in wheels]
        options = [f"model={model}", f"inputs={{{','.join(rates)}}}", f"time.duration={6 / factor}"]
        settings = sets(*options)
        name = PROBLEMS / "dynamics_skid_turn.toml"
        invoke("run", name, "-o", file, "--no-draw", *settings, code=0)
        run = open_result(file).trajectory
        ends[model, factor] = np.array([run["x"][-1], run["y"][-1]])
    still = ends["quasi-static", 1]
    slow, fast = (np.hypot(*(ends["dynamics", k] - still)) for k in (1, 2))
    assert np.hypot(*(ends["kinematics", 1] - still)) > 0.2
    assert slow < 0.03
    assert 3 < fast / slow < 6


@pytest.mark.slow
def test_a_motor_spins_its_wheel_on_ice(tmp_path):
    file = tmp_path / "r.nc"
    done = invoke("run", PROBLEMS / "dynamics_ice.toml", "-o", file, "--no-draw", code=0)
    assert "diagnostics failed" not in done.output
    run = open_result(file).trajectory
    on_ice = run["contact_x", "rear_left"] < 0.2
    assert (run["slip_ratio", "rear_left"][1:][on_ice[1:]] > 0.5).mean() > 0.5
    assert run["slip_ratio", "rear_left"][-1] < 0.01  # off the ice
    assert np.abs(run["slip_along", "rear_right"]).max() < 0.01
    assert run["drive_torque", "rear_right"].max() == pytest.approx(8, abs=1e-6)


@pytest.mark.slow
def test_a_car_that_tips_over_stops_at_a_named_limit(tmp_path):
    file, problem = tmp_path / "r.nc", PROBLEMS / "dynamics_tip_over.toml"
    done = invoke("run", problem, "-o", file, "--no-draw", code=1)
    assert "(upright): the platform overturns" in done.output
    assert open_result(file).trajectory["tip_over_margin"][-1] < 0
    rates = [f"inputs.rear_{side}_rate=13.3" for side in ("left", "right")]
    settings = sets("start.speed=2", *rates)
    invoke("run", problem, "-o", file, "--no-draw", *settings, code=0)


@pytest.mark.slow
def test_a_sampled_driver_ends_near_the_continuous_one(tmp_path):
    ends = []
    for name, sampled in (("continuous", []), ("sampled", ["--set", "driver.period=0.01"])):
        file = tmp_path / f"{name}.nc"
        short = ["--set", "time.duration=0.8", "--set", "time.step=0.02"]
        invoke("run", ROCKS, "-o", file, "--no-draw", *short, *sampled, code=0)
        assert ("driver straight, every 0.01 s" in printed("info", file)) == (name == "sampled")
        run = open_result(file).trajectory
        assert run.t == pytest.approx(0.02 * np.arange(41))
        ends.append(np.array([run["x"][-1], run["y"][-1], run["z"][-1]]))
    assert 1e-7 < np.linalg.norm(ends[0] - ends[1]) < 1e-3


@pytest.mark.slow
def test_a_sampled_driver_stops_at_a_limit(tmp_path):
    file = tmp_path / "r.nc"
    settings = ("driver.period=0.005", "terrain.synthetic.x=[-3.0, 0.7]", "time.step=0.02")
    options = sets(*settings)
    invoke("run", ROCKS, "-o", file, "--no-draw", *options, code=1)
    run = open_result(file).trajectory
    assert run.t == pytest.approx(0.02 * np.arange(run.t.size))
    assert 0 <= run.stop.t - run.t[-1] < 0.02


STEP = PROBLEMS / "dynamics_step.toml"


@pytest.mark.slow
def test_a_rover_meets_a_step(tmp_path):
    file = tmp_path / "r.nc"
    done = invoke("run", STEP, "-o", file, "--set", "time.duration=4", "--no-draw", code=0)
    assert "not converged" not in done.output
    assert "obstacles unfinished: by t = 4 s" in " ".join(done.output.split())
    result = open_result(file)
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
    invoke("show", file, "--html", tmp_path / "page.html", code=0)


def test_an_obstacle_stands_where_the_file_says():
    """A kerb along y, in a file whose headings count from x, on ground at 2 m."""
    problem = load_problem(
        STEP,
        settings=[
            "terrain.synthetic.base=2.0",
            "terrain.obstacles=[{kerb = {height = 0.1, length = 0.5}, y = 1.0, "
            "heading = '90 deg', half_width = 0.3}]",
        ],
    )
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
        **{"layers": None, "places": [("start", 0.0, 0.0)]},
    )
    found = SimpleNamespace(run=SimpleNamespace(stop=stop))
    words = with_offer(setup, found, [guess]).words
    assert "needs torques of 30 N m in all (at x = 0.00 m, y = 2.50 m)" in words
    assert "limits.drive_torque allows 26 N m" in words
    assert 'set model = "dynamics" to plan with momentum' in words
    setup.spec.limits = {"drive_torque": (-8.0, 8.0)}
    assert "needs torques" not in with_offer(setup, found, [guess]).words
    setup.spec.model, setup.spec.limits = "kinematics", {}
    assert with_offer(setup, found, [guess]) == stop
