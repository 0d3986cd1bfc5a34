"""Tests of plans: least slip over hills, limits, goals, soil, robust plans, and Pareto fronts."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import binomtest

import slipfree as sf
from helpers.cases import BOUNDED_RATES, PROBLEMS, hills, straight_on
from helpers.commands import invoke, refuses, sets
from slipfree.catalog import three_wheeler
from slipfree.files import netcdf
from slipfree.plan.pareto import FrontPoint, pareto_front
from slipfree.plan.robust import (
    MAX_ROUNDS,
    Bound,
    DisturbedRun,
    Draw,
    Replays,
    added_tightening,
    robust_plan,
)
from slipfree.problem.load import verb_of

PROBLEM = PROBLEMS / "plan_rigid_hills.toml"
GOAL = {"x": 0.6, "y": 2.6}
WEIGHTS = {"slip": 7e4, "effort": 0.01}
VEHICLE = three_wheeler(axle="fixed")
STEER = {"steer": (-1.0, 1.0)}
TWO = sf.Cost("two", ca.SX(2, 1), "m", "")


def asked(*, goal=None, costs=None, duration=20.0, **options):
    dae, start, first = straight_on(VEHICLE, sf.Analytic(hills), 0.45, np.linspace(0, 20, 61))
    return sf.plan(
        dae,
        start,
        first,
        goal=goal or GOAL,
        costs=costs or WEIGHTS,
        duration=duration,
        smooth=0.002,
        inputs=BOUNDED_RATES,
        **options,
    )


def rms_slip(run):
    """Root mean square over time and wheels. [m/s]."""
    squares = run["slip_along"] ** 2 + run["slip_across"] ** 2
    return np.sqrt(np.trapezoid(squares.mean(axis=1), run.t) / (run.t[-1] - run.t[0]))


@pytest.mark.slow
def test_a_rigid_axle_reaches_its_goal_with_least_slip():
    """Slip and place are those of the simulation; more starts of the search in the benchmark."""
    found = asked(limits=STEER)
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
    given = {"limits": STEER, "mesh": sf.Mesh(6, accuracy=0.05)}
    free = asked(costs={"effort": 1.0, "slip": 1e-6}, **given)
    least, run = free.costs["effort"], free.replay
    assert rms_slip(run) > 1e-3  # effort alone slips more
    # Costs are those of the simulation.
    effort = sum(np.trapezoid(run[name] ** 2, run.t) for name in BOUNDED_RATES)
    assert least == pytest.approx(effort, rel=1e-3)
    assert free.costs["slip"] == pytest.approx(3 * run.t[-1] * rms_slip(run) ** 2, rel=2e-3)
    assert least < 8.0
    given["costs"] = {"slip": 1e3}
    found = asked(cost_limits={"effort": 1.03 * least}, **given)
    assert found.success
    assert found.costs["effort"] == pytest.approx(1.03 * least, rel=1e-6)
    none = asked(cost_limits={"effort": 0.5 * least}, **given)
    assert none.run.outcome is sf.Outcome.INFEASIBLE
    assert "cost effort: " in none.run.stop.words


@pytest.mark.slow
def test_a_pose_a_way_point_and_a_range_of_durations():
    found = asked(
        goal={"y": 2.0, "heading": (-0.05, 0.05)},
        way_points={0.5: {"x": 0.2}},
        duration=(5.0, 30.0),
        costs={"slip": 1e3, "time": 0.01},
        accelerations=dict.fromkeys(BOUNDED_RATES, (-1.0, 1.0)),
        mesh=sf.Mesh(20),
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
        ({"limits": {"steer": (1.0, -1.0)}}, "steer.*: expected ascending bounds, found 1.0 to"),
        ({"costs": [TWO]}, r"two: expected a scalar .* shape \(2, 1\); give"),
        ({"way_points": {1.0: {"x": 0.0}}}, "way_points: expected fractions of the duration above"),
        ({"accelerations": {"x": (0, 1)}}, "inputs: expected one of right_rate, .* found 'x'"),
    ],
)
def test_what_is_wrong_is_said(options, words):
    refuses(sf.ModelError, words, asked, **options)


def run_file(*settings, code=None):
    return invoke("run", PROBLEM, "-o", "p.nc", "--no-draw", *sets(*settings), code=code)


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_run_plans_simulates_and_tells():
    run_file("plan.intervals=10", "costs.slip=", code=0)
    shown = invoke("info", "p.nc").stdout
    told = dict(line.split("  ", 1) for line in shown.splitlines() if "  " in line)
    assert told["driven by"].strip().startswith("plan to x 0.6 m, y 2.6 m in 20 s")
    assert "effort" in told["plan"]
    assert "iterations" in told["plan"]
    one_per_unit = r" *differs from the plan by at most [xy] \S+ mm, \w+ \S+ deg; "
    assert re.match(one_per_unit, told["simulated"])
    assert told["optimality"].strip().startswith("a strict local minimum: smallest curvature ")
    assert "duration 20 s: 0.1 s more saves " in told["prices of limits"]
    run = netcdf.read(Path("p.nc"))
    assert run["y"][-1] == pytest.approx(2.6, abs=1e-3)
    assert run.facts["plan_iterations"].value > 0


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_a_goal_that_cannot_be_reached_is_explained_and_the_last_iterate_saved():
    bounds = (f"bounds.{side}_rate=[0, 0.5]" for side in ("right", "left"))
    result = run_file("plan.intervals=10", "costs.slip=", "plan.duration=4.0", *bounds, code=1)
    told = result.stdout.partition("ground ")[0]
    assert told.startswith("outcome ")
    assert "infeasible: the constraints contradict each other where the search ended" in told
    assert "the result is the last iterate\nlargest violations of this result" in told
    assert "y at the goal" in told
    assert "one sufficient set; others may exist" in told
    assert result.stderr == "infeasible; p.nc contains the result so far\n"
    assert netcdf.read(Path("p.nc")).stop.name == "plan"


# A short plan over a sandy slope: limits on slip and sinkage, simulation with inertia

SLOPE = PROBLEMS / "plan_sandy_slope.toml"
SHORT = (
    *("law.soil.regions=", "start={x=0.0, y=1.4, heading=1.1}", "goal.y=1.8"),
    *("driver.path=[[0.0, 1.4], [-1.5, 2.15]]", "time.duration=5", "time.step=0.5"),
    *("limits.slip_ratio=[-0.2, 0.22]", "plan.duration=5", "plan.intervals=4", "plan.degree=2"),
    "plan.accuracy=0.03",
)


@pytest.mark.slow
def test_a_plan_over_sand_keeps_its_limit_on_slip_and_is_confirmed_by_dynamics():
    result = sf.run_problem(sf.load_problem(SLOPE, SHORT))
    run, verb = result.trajectory, verb_of(result.problem)
    assert run.stop is None
    assert run["y"][-1] == pytest.approx(1.8, abs=0.02)
    assert run["slip_ratio"].max() == pytest.approx(0.22, abs=5e-3)  # a steeper path is shorter
    assert run["sinkage"].max() < 0.025
    work = run["work"][-1] - run["work"][0]  # of the drives
    assert run.facts["plan_cost_energy"].value == pytest.approx(work, rel=0.02)
    away = run.facts["soil_end_distance"].value
    assert away < 0.03
    lines = dict(verb.summary(run))
    assert lines["simulated with inertia"].startswith(f"ends {away:.3g} m from the plan")
    assert "drawbar-pull reserve" in lines["soil"]
    assert np.isfinite(run["drawbar_reserve"]).all()
    (plot,) = (each for each in verb.figures(result) if each.name == "contact")
    labels = [ax.get_ylabel() for ax in plot.make().axes]
    assert any("reserve" in each for each in labels), labels


# Robust plans: tightening of limits by replay, with a scalar as plan

SPREAD = 0.1
LIMIT = Bound("utilisation", "upper")
SEEN: list[Sequence[Draw]] = []


def solve(tightening: Mapping[Bound, float], _before: float) -> float:
    """Return the largest value below a tightened bound of 1; none below 0.5."""
    value = 1 - tightening.get(LIMIT, 0.0)
    if value <= 0.5:
        raise sf.ModelError("too tight")
    return value


def replay(values: Sequence[float], draws: Sequence[Draw], spread: float = SPREAD) -> list[Replays]:
    """Return the excess of disturbed values over their bound."""
    SEEN.append(draws)
    errors = [spread * np.random.default_rng(draw).normal() for draw in draws]
    return [
        Replays(tuple(DisturbedRun({LIMIT: value + error - 1}, abs(error)) for error in errors))
        for value in values
    ]


def replays(*excess: dict[Bound, float]) -> Replays:
    """Return simulations with a given excess of bounds."""
    return Replays(tuple(DisturbedRun(each, 0.0) for each in excess))


def test_share_is_reached_at_the_quantile_of_the_disturbance() -> None:
    SEEN.clear()
    found = robust_plan(1.0, solve, replay, share=0.9, draws=400, final_draws=2000, seed=3)
    assert found.before.share == pytest.approx(0.5, abs=0.05)
    assert not found.failure
    assert 0.9 <= found.after.share == pytest.approx(0.95, abs=0.03)  # half of the failures left
    assert found.tightening[LIMIT] == pytest.approx(1.6449 * SPREAD, rel=0.25)
    *tightening, final = SEEN
    assert len(final) == found.before.draws == found.after.draws == 2000
    assert not set(final) & {draw for draws in tightening for draw in draws}
    assert found.after.distances(0.5) == [pytest.approx(0.6745 * SPREAD, rel=0.1)]


def test_plan_that_holds_is_not_changed() -> None:
    found = robust_plan(0.0, solve, replay, share=0.95, draws=20, final_draws=20, seed=0)
    assert (found.plan, found.tightening, found.rounds) == (0.0, {}, 0)
    assert found.after.share == 1


def test_limits_that_cannot_be_tight_enough_are_as_tight_as_possible() -> None:
    def wild(values: Sequence[float], draws: Sequence[Draw]) -> list[Replays]:
        return replay(values, draws, 0.5)

    found = robust_plan(1.0, solve, wild, share=0.95, draws=50, final_draws=50, seed=0)
    assert found.failure == "too tight"
    assert 0.5 < found.plan < 0.9
    assert found.before.share < found.after.share < 0.95


def test_unsolvable_problem_keeps_the_plan() -> None:
    def fail(_tightening: Mapping[Bound, float], _before: float) -> float:
        raise sf.ModelError("no plan")

    found = robust_plan(1.0, fail, replay, share=0.95, draws=50, final_draws=50, seed=0)
    assert (found.plan, found.tightening, found.failure) == (1.0, {}, "no plan")


def test_failed_motions_count_as_violations_but_do_not_tighten() -> None:
    def failing(values: Sequence[float], draws: Sequence[Draw]) -> list[Replays]:
        each = Replays(tuple(DisturbedRun({Bound("motion"): np.inf}, np.nan) for _ in draws))
        return [each for _ in values]

    found = robust_plan(1.0, solve, failing, share=0.9, draws=5, final_draws=5, seed=0)
    assert found.after.held == 0
    assert found.after.violated == {Bound("motion"): 5}
    assert found.tightening == {}
    assert found.rounds < MAX_ROUNDS
    assert np.isnan(found.after.distances(0.5, 0.95)).all()


def test_violated_limits_keep_the_share_together() -> None:
    a, b, c = (Bound(name, "upper") for name in "abc")
    excess = replays(*({a: k - 50.0, b: -1.0, c: 50.0 - k} for k in range(100)))
    # opposed errors: 5 draws at each end may fail; errors in common: the 10 largest
    assert added_tightening(excess, 0.9) == {a: 44.0, c: 45.0}
    common = replays(*({a: k - 50.0, c: 2 * (k - 50.0)} for k in range(100)))
    assert added_tightening(common, 0.9) == {a: 39.0, c: 78.0}


def test_failed_motions_leave_less_of_the_share_for_limits() -> None:
    failed = [{Bound("motion"): np.inf}] * 5
    excess = replays(*failed, *({LIMIT: k - 50.0} for k in range(95)))
    assert added_tightening(excess, 0.9) == {LIMIT: 39.0}  # 90 of 100 draws keep the bound


@pytest.mark.parametrize(("held", "draws"), [(0, 10), (10, 10), (187, 200)])
def test_interval_is_that_of_clopper_and_pearson(held: int, draws: int) -> None:
    found = replays(*({LIMIT: -1.0 if k < held else 1.0} for k in range(draws)))
    expected = binomtest(held, draws).proportion_ci(0.95, "exact")
    assert found.interval == pytest.approx((expected.low, expected.high))


# Pareto fronts with closed forms: convex or not, with local optima or failures

DONE = sf.Outcome.COMPLETE


def convex(bound):
    return 1 / bound


def concave(bound):
    """A quarter of a circle of radius 5; weighted sums find only its ends."""
    return np.sqrt(25 - bound**2)


def front(value, count, high=4.0, change=None):
    def solve(tasks):
        points = [FrontPoint(b, value(b), b, outcome=DONE, solution=b) for _, b, _ in tasks]
        return points if change is None else list(map(change, tasks, points))

    ends = (FrontPoint(b, value(b), b, outcome=DONE, solution=b) for b in (1.0, high))
    return pareto_front(solve, *ends, count)


@pytest.mark.parametrize("value", [convex, concave])
@pytest.mark.parametrize("count", [2, 3, 8])
def test_points_are_on_the_front_at_equal_ratios(value, count):
    found = front(value, count)
    bounds = [point.bound for point in found]
    np.testing.assert_allclose(bounds, np.geomspace(1.01, 4.0, count))
    assert [point.first for point in found] == [value(b) for b in bounds]
    assert not any(point.is_dominated for point in found)


def test_local_optima_are_solved_again_or_marked():
    def stuck(task, point):
        helped = task.number != 2 and task.start.solution > task.bound
        return point if helped or task.number not in (2, 3) else point._replace(first=9.0)

    found = front(convex, 6, change=stuck)
    assert [point.is_dominated for point in found] == [False, False, True, False, False, False]


def test_points_that_are_not_solved_are_kept_with_their_reason():
    def failing(task, point):
        failed = FrontPoint(task.bound, outcome=sf.Outcome.INFEASIBLE, words="why")
        return failed if task.number == 1 else point

    found = front(convex, 5, change=failing)
    assert [point.is_solved for point in found] == [True, False, True, True, True]
    assert found[1].words == "why"
    assert not found[1].is_dominated


def test_without_conflict_the_front_is_one_point():
    assert len(front(convex, 5, high=1.005)) == 1


def test_one_point_is_no_front():
    refuses(sf.ModelError, "expected two points or more, found 1", front, convex, 1)
