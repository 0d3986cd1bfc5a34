"""Tests of problems planned in windows: result, summary, continuation, and unsuitable keys."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from slipfree.core.outcome import Outcome
from slipfree.files.toml.source import ProblemError
from slipfree.plan.polynomial_motion import from_arrays
from slipfree.problem.load import load_problem
from slipfree.problem.result import build, motion_facts, run_problem

HILLS = Path(__file__).parents[2] / "problems" / "plan_rigid_hills.toml"
WINDOWS = (
    "inputs=",
    "driver={name='follow', speed=0.25, path=[[0.0, 0.0], [0.2, 1.5], [0.6, 2.6]]}",
    "plan.window=1.2",
    "plan.overlap=0.4",
    "plan.intervals=5",
)


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


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("plan.window=",), "plan.overlap: expected this key only with 'window', found no"),
        (("time.duration=5.0",), "time.duration: expected at least 10.7"),
        (
            ("driver=", "inputs={right_rate=0.4, left_rate=0.4, steer_rate=0.0}"),
            "expected a driver that follows",
        ),
    ],
)
def test_keys_that_do_not_suit_windows_are_refused(settings, words):
    with pytest.raises(ProblemError) as error:
        build(load_problem(HILLS, (*WINDOWS, *settings)))
    assert words in str(error.value)


def test_wheels_pressed_into_the_ground_are_refused():
    settings = (
        "inputs=",
        "driver={name='follow', speed=0.5, path=[[0.0, 0.0], [5.0, 0.5]]}",
        "plan.window=2.0",
        "time.duration=12.0",
    )
    problem = load_problem(HILLS.with_name("plan_rigid_robot.toml"), settings)
    with pytest.raises(ProblemError, match="found rigid_skid_steer, whose wheels press"):
        build(problem)
