"""Tests of moving horizons along a plan: they keep to the plan, and return to it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from helpers.cases import hills
from slipfree import (
    Analytic,
    Bicubic,
    Grid,
    ModelError,
    SolverError,
    direct_kinematics,
    settle,
    simulate,
)
from slipfree.catalog import three_wheeler
from slipfree.plan import mpc as module
from slipfree.plan.mpc import cycle_inputs, first_cycle, horizon, replan
from slipfree.plan.plan import plan

GOAL, DURATION, COUNT = {"x": 0.2, "y": 0.9}, 8.0, 12
RATES = {f"{name}_rate": (-2.0, 2.0) for name in ("right", "left", "steer")}


@pytest.fixture(scope="module")
def found():
    axis = np.arange(-3.0, 4.0, 0.25)
    heights = Analytic(hills).elevation(*np.meshgrid(axis, axis, indexing="ij"))
    dae = direct_kinematics(three_wheeler(axle="fixed"), Bicubic(Grid(axis, axis, heights)))
    start = settle(dae)
    rates = dae.inputs(right_rate=0.4, left_rate=0.4, steer_rate=0.0)
    guess = simulate(dae, start, rates, np.linspace(0, DURATION, 30))
    return plan(
        dae,
        start,
        guess,
        goal=GOAL,
        costs={"slip": 7e4, "effort": 0.01},
        smooth=0.002,
        duration=DURATION,
        inputs=RATES,
        limits={"steer": (-1.0, 1.0)},
        intervals=COUNT,
    )


def traverse(found, window, **start):
    """Drive to the end of the plan, one cycle an interval; return the way's end and all cycles."""
    dae, cycle = found.program.task.dae, first_cycle(window)
    here, cycles, times = settle(dae, **start), [], found.motion.ends
    for t, end in pairwise(times):
        cycle = replan(window, cycle, t, dae.rows("x", here, -1))
        here = simulate(dae, here, *cycle_inputs(window, cycle, t, end))
        cycles.append(cycle)
    return here, cycles


def away(run):
    return float(np.hypot(run["x"][-1] - GOAL["x"], run["y"][-1] - GOAL["y"]))


@pytest.mark.slow
def test_the_end_of_a_plan_is_its_end_whatever_was_summed_up(found):
    window = horizon(found, span=DURATION, intervals=COUNT)
    for one, other in zip(
        module._row_bounds(window, DURATION),
        module._row_bounds(window, DURATION - 1e-9),
        strict=True,
    ):
        assert_array_equal(one, other)
    lower, upper = module._row_bounds(window, DURATION - 1.0)
    assert_array_equal(lower[-len(GOAL) :], upper[-len(GOAL) :])


@pytest.mark.slow
def test_where_nothing_disturbs_a_step_stays_on_the_plan(found):
    window = horizon(found, span=DURATION, intervals=COUNT)
    first, count = first_cycle(window), found.motion.layout.duration
    start = found.program.task.start
    cycle = replan(window, first, 0.0, start)
    for one in (first, cycle):
        assert_allclose(one.motion.unknowns[:count], found.motion.unknowns[:count], atol=1e-6)
        assert one.violation < 1e-9


@pytest.mark.slow
def test_a_step_of_the_shifted_window_leads_to_its_solution(found):
    window, many = (
        horizon(found, span=DURATION / 2, intervals=COUNT // 2, iterations=count)
        for count in (1, 50)
    )
    t, ends, first = found.motion.ends[1], found.motion.mesh.ends, first_cycle(window)
    x = found.motion.states(ends[1:2])[:, 0]
    whole, once = (replan(each, first, t, x) for each in (many, window))
    twice = replan(window, once, t, x)
    parts = np.linspace(0, 1, 9)
    before, after = (
        np.abs(each.motion.states(parts) - whole.motion.states(parts)).max()
        for each in (once, twice)
    )
    assert before < 0.1
    assert after < before / 3
    assert once.violation < 1e-3
    assert once.motion.duration == whole.motion.duration == DURATION / 2
    at_end = found.motion.states(np.array([(t + DURATION / 2) / DURATION]))
    for each in (once, whole):
        assert_allclose(each.motion.states(np.ones(1))[:2], at_end[:2], atol=1e-8)


@pytest.mark.slow
def test_steps_converge(found):
    """From a start beside the plan, without moving: to what many iterations find at once."""
    window, many = (
        horizon(found, span=DURATION, intervals=COUNT, iterations=count) for count in (1, 50)
    )
    start = found.program.task.start + np.array([0.02, -0.02, 0.03, 0.0])
    cycle, misses = first_cycle(window), []
    whole = replan(many, cycle, 0.0, start)
    for _ in range(8):
        cycle = replan(window, cycle, 0.0, start)
        misses.append(np.abs(cycle.motion.unknowns - whole.motion.unknowns).max())
    assert misses[-1] < 1e-4
    assert misses[1] < misses[0] / 3
    assert cycle.violation < 1e-6


@pytest.mark.slow
def test_steps_lead_back_to_the_plan_and_end_at_its_goal(found):
    span = DURATION / 2
    once, many = (
        horizon(found, span=span, intervals=COUNT // 2, iterations=count) for count in (1, 50)
    )
    off = {"x": 0.02, "y": -0.02, "heading": 0.03}
    (end, cycles), (converged, _) = (traverse(found, each, **off) for each in (once, many))
    assert away(end) < 1e-3
    assert away(converged) < 1e-3
    assert np.hypot(end["x"][-1] - converged["x"][-1], end["y"][-1] - converged["y"][-1]) < 1e-3
    assert cycles[-1] is cycles[-2]  # what is left of the last one that decides is driven on


@pytest.mark.slow
def test_inputs_keep_to_their_bounds(found):
    window = horizon(found, span=DURATION / 2, intervals=COUNT // 2)
    start = found.program.task.start.copy()
    start[1] -= 0.5  # metres behind
    cycle = first_cycle(window)
    for _ in range(8):
        cycle = replan(window, cycle, 0.0, start)
    rates = cycle.motion.unknowns[cycle.motion.layout.inputs]
    assert np.abs(rates).max() <= 2.0 + 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("period", [0.3, 0.7])
def test_a_period_that_does_not_divide_the_duration_ends_at_the_goal(found, period):
    """The last part is as long as what is left."""
    window, here, t = horizon(found, span=4.0, intervals=6), settle(found.program.task.dae), 0.0
    cycle = first_cycle(window)
    while t < DURATION:
        cycle = replan(window, cycle, t, found.program.task.dae.rows("x", here, -1))
        inputs, times = cycle_inputs(window, cycle, t, t + period)
        here = simulate(found.program.task.dae, here, inputs, times)
        t += period
    assert_allclose(times[-1], DURATION - cycle.t, atol=1e-9)
    assert away(here) < 1e-3
    with pytest.raises(ModelError, match=r"expected 'begin' from .* to below 8 s"):
        cycle_inputs(window, cycle, 8.5, 9.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"span": 9.0}, "at most 8 s, the duration of the plan, found 9"),
        ({"span": 4.0, "intervals": 0}, "intervals: expected 1 or more, found 0"),
        ({"span": 4.0, "iterations": -1}, "iterations: expected 1 or more, found -1"),
    ],
)
def test_what_is_no_window_is_refused(found, given, words):
    with pytest.raises(ModelError, match=words):
        horizon(found, **given)


@pytest.mark.slow
def test_what_depends_on_time_is_refused(found):
    """A window counts time from its own beginning."""
    task = found.program.task
    cost = task.costs[0]._replace(expression=task.costs[0].expression * task.dae.t)
    late = replace(found.program, task=replace(task, costs=(cost,)))
    with pytest.raises(ModelError, match="a goal that do not depend on time"):
        horizon(replace(found, program=late), span=4.0)


@pytest.mark.slow
def test_states_that_are_none_and_steps_that_fail_are_told(found):
    window = horizon(found, span=4.0, intervals=6)
    first, start = first_cycle(window), found.program.task.start
    for state in (start[:-1], start * np.nan, start[0]):
        with pytest.raises(ModelError, match="expected a time and 4 states, all finite"):
            replan(window, first, 0.0, state)
    with pytest.raises(ModelError, match="found t = nan"):
        replan(window, first, np.nan, start)
    with pytest.raises(ModelError, match="expected a time t of at least 1 s"):
        replan(window, first._replace(t=1.0), 0.5, start)
    with pytest.raises(SolverError, match="the inputs of the previous cycle may still be used"):
        replan(window, first, 0.0, start + np.array([0, 1e308, 0, 0]))
    assert replan(window, first, 0.0, start).violation < 1e-6
