"""Tests of problem files for plans with momentum."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from slipfree import Outcome, catalog, load_problem, run_problem
from slipfree.core.trajectory import Stop
from slipfree.problem.verbs.plan import PlanVerb, with_offer

MOMENTUM = Path(__file__).parents[2] / "problems" / "plan_momentum.toml"
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
    )
    found = SimpleNamespace(run=SimpleNamespace(stop=stop))
    words = with_offer(setup, found, [guess]).words
    assert "needs torques of 30 N m in all (at x = 0.00 m, y = 2.50 m)" in words
    assert "limits.drive_torque allows 26 N m" in words
    assert 'set model = "dynamics" to plan with momentum' in words
    setup.spec.limits = {"drive_torque": (-8.0, 8.0)}
    assert "needs torques" not in with_offer(setup, found, [guess]).words
    setup.spec.model, setup.spec.limits = "kinematics", {}
    assert with_offer(setup, found, [guess]) is stop
