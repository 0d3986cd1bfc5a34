"""Tests of long plans in windows: transitions, agreement with one plan, interruption, failure."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

import slipfree as sf
from helpers.cases import hills
from slipfree.catalog import three_wheeler
from slipfree.plan.polynomial_motion import first_intervals, joined_motions
from slipfree.plan.verification import simulate_plan
from slipfree.plan.windows import plan_windows

SPEED = 0.3
GOAL = {"x": 0.3, "y": 4.5}
COMMON = {
    "costs": {"slip": 1e4, "effort": 0.01},
    "smooth": 0.002,
    "inputs": dict.fromkeys(("right_rate", "left_rate", "steer_rate"), (-2.0, 2.0)),
}


@pytest.fixture(scope="module")
def case():
    vehicle = three_wheeler(axle="fixed")
    dae = sf.direct_kinematics(vehicle, sf.Analytic(hills))
    start = sf.settle(dae)
    route = sf.Path(np.array([[0.0, 0.0], [0.2, 1.5], [0.35, 3.0], [GOAL["x"], GOAL["y"]]]))
    return dae, partial(sf.follow, dae, speed=SPEED), start, route


def windows(case, **options):
    given = {"speed": SPEED, "length": 1.8, "overlap": 0.6, "goal": GOAL, "mesh": sf.Mesh(8)}
    return plan_windows(*case, **COMMON, **(given | options))


@pytest.fixture(scope="module")
def found(case):
    return windows(case)


def assert_continuous(found, t):
    """Inputs are continuous at the hand-over at time t."""
    around = t / found.motion.duration + np.array([-1e-9, 1e-9])
    before, after = found.motion.inputs(around).T
    assert_allclose(before, after, atol=1e-6)


def assert_repeated(case, found):
    """One simulation of the joined inputs repeats the motion."""
    dae, _, start, _ = case
    options = sf.SolverOptions(tolerance=1e-9)
    again = simulate_plan(dae, start, found.motion, step=0.25, options=options)
    for name in ("x", "y", "heading", "steer"):
        assert_allclose(again[name][-1], found.replay[name][-1], atol=1e-5)


@pytest.mark.slow
def test_the_goal_is_reached_in_several_accurate_windows(case, found):
    assert found.success
    assert found.accurate
    assert len(found.windows) >= 3
    assert found.windows[-1].end == case[-1].length
    run = found.replay
    assert run.stop is None
    assert_allclose([run["x"][-1], run["y"][-1]], list(GOAL.values()), atol=1e-3)
    assert_allclose(run.t[-1], found.motion.duration, rtol=1e-12)
    assert max(found.difference.values()) < 1e-3
    for before, after in pairwise(found.windows):
        assert after.begin < before.end
        assert_allclose(after.t, before.t + before.duration, rtol=1e-12)
        assert_continuous(found, after.t)
    assert_repeated(case, found)


@pytest.mark.slow
def test_windows_cost_little_more_than_one_plan(case, found):
    dae, law, start, route = case
    guess = sf.simulate(dae, start, law(route), np.linspace(0, route.length / SPEED, 61))
    whole = sf.plan(
        dae, start, guess, goal=GOAL, duration=found.motion.duration, mesh=sf.Mesh(36), **COMMON
    )
    assert whole.success

    def total(costs):
        return 1e4 * costs["slip"] + 0.01 * costs["effort"] + 0.002 * costs["smoothness"]

    ratio = total(found.costs) / total(whole.costs)
    assert 0.999 < ratio < 1.1


@pytest.mark.slow
def test_an_interrupted_plan_keeps_its_windows_and_is_resumed(case, found):
    kept = windows(case, progress=lambda words, _iterate: not words.startswith("2 to"))
    assert kept.replay.outcome is sf.Outcome.INTERRUPTED
    assert not kept.success
    assert 1 <= len(kept.windows) < len(found.windows)
    assert kept.replay.t[-1] == pytest.approx(kept.motion.duration)
    resumed = windows(case, resume=kept.saved)
    assert resumed.accurate
    assert_allclose([resumed.replay["x"][-1], resumed.replay["y"][-1]], [0.3, 4.5], atol=1e-3)
    assert_continuous(resumed, kept.motion.duration)
    assert_repeated(case, resumed)
    shared = kept.replay.t.size - 1
    assert_allclose(resumed.replay["y"][:shared], kept.replay["y"][:shared], atol=1e-6)


@pytest.mark.slow
def test_a_window_without_solution_is_named_and_the_others_are_kept(case):
    kept = windows(case, limits={"y": (-1.0, 2.2)}, mesh=sf.Mesh(5))
    assert not kept.success
    assert kept.windows
    assert "m of the route" in kept.replay.stop.words
    assert kept.replay["y"].max() < 2.3


@pytest.mark.slow
def test_parts_of_a_motion_join_to_the_motion(found):
    motion = found.motion
    first = first_intervals(motion, 7)
    assert_allclose(first.duration, motion.ends[7], rtol=1e-12)
    at = np.linspace(0, 1, 20)
    inside = at * first.duration / motion.duration
    assert_allclose(first.states(at), motion.states(inside), atol=1e-12)
    assert_allclose(first.inputs(at), motion.inputs(inside), atol=1e-12)
    twice = joined_motions([first, first])
    assert_allclose(twice.duration, 2 * first.duration)
    assert_allclose(twice.algebraic(at[1:] / 2), first.algebraic(at[1:]), atol=1e-9)


def test_lengths_and_speeds_that_do_not_fit_are_refused(case):
    for change, words in (
        ({"overlap": 1.8}, "overlap shorter than the window"),
        ({"overlap": 0.0}, "overlap shorter than the window"),
        ({"speed": 0.0}, "expected a positive speed, found 0 m/s"),
    ):
        with pytest.raises(sf.ModelError, match=words):
            windows(case, **change)


@pytest.mark.slow
def test_initial_inputs_of_a_plan(case):
    dae, law, start, route = case
    guess = sf.simulate(dae, start, law(route), np.linspace(0, 3, 13))
    goal = {"y": float(guess["y"][-1])}
    still = {"right_rate": 0.0, "left_rate": 0.0, "steer_rate": 0.0}
    found = sf.plan(
        dae, start, guess, goal=goal, duration=4.0, mesh=sf.Mesh(8), initial_inputs=still, **COMMON
    )
    assert found.success
    assert_allclose(found.motion.inputs(np.array([0.0])), 0.0, atol=1e-9)
    with pytest.raises(sf.ModelError, match="initial value of 'left_rate'"):
        sf.plan(
            dae, start, guess, goal=goal, duration=4.0, initial_inputs={"left_rate": 3}, **COMMON
        )
