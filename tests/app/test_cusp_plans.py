"""Tests of plans from initial guesses with cusps: parking, and unsuitable settings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slipfree.core.outcome import Outcome
from slipfree.files.toml.source import ProblemError
from slipfree.problem.load import load_problem
from slipfree.problem.result import build, run_problem
from slipfree.problem.verbs.plan_search import guess_motion

PARKING = Path(__file__).parents[2] / "problems" / "plan_parking.toml"


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
    run = guess_motion(setup, setup.starts[0])
    assert (run["x"][-1], run["y"][-1]) == pytest.approx((-1.0, -3.0), abs=1e-3)
    assert setup.paths == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("driver.speed=-0.4",), "expected a positive speed"),
        (("goal={heading=0.5}",), "expected values for x and y, which the driver needs"),
        (("goal={x=0.0, y=0.0, heading=0.0}", "keep_out="), "expected a goal apart from the start"),
        (("way_points=[{at=0.5, x=1.0, y=0.5}]", "keep_out="), "expected way-points without x and"),
    ],
)
def test_settings_that_do_not_suit_are_refused(settings, words):
    with pytest.raises(ProblemError, match=words):
        build(load_problem(PARKING, settings))
