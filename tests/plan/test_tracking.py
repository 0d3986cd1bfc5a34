"""Tests of the closed loop along a plan: correct ground, wrong ground, and invalid arguments."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.cases import hills
from slipfree import (
    Analytic,
    Bicubic,
    Grid,
    ModelError,
    catalog,
    direct_kinematics,
    plan,
    settle,
    simulate,
)
from slipfree.plan.mpc import horizon
from slipfree.plan.tracking import track_plan
from slipfree.plan.verification import simulate_plan
from slipfree.terrain.grid_ops import disturbed

GOAL, DURATION = {"x": 0.2, "y": 0.9}, 8.0
VEHICLE = catalog.three_wheeler(axle="fixed")
AXIS = np.arange(-3.0, 4.0, 0.25)
GRID = Grid(AXIS, AXIS, Analytic(hills).elevation(*np.meshgrid(AXIS, AXIS, indexing="ij")))


@pytest.fixture(scope="module")
def window():
    dae = direct_kinematics(VEHICLE, Bicubic(GRID))
    start = settle(dae)
    rates = dae.inputs(right_rate=0.4, left_rate=0.4, steer_rate=0.0)
    found = plan(
        dae,
        start,
        simulate(dae, start, rates, np.linspace(0, DURATION, 30)),
        goal=GOAL,
        costs={"slip": 7e4, "effort": 0.01},
        smooth=0.002,
        duration=DURATION,
        intervals=12,
    )
    return horizon(found, span=3.0, intervals=6)


def missed(run):
    return float(np.hypot(run["x"][-1] - GOAL["x"], run["y"][-1] - GOAL["y"]))


@pytest.mark.slow
def test_on_its_own_ground_a_plan_is_reached(window):
    dae, times = window.program.task.dae, []
    tracked = track_plan(window, dae, settle(dae), period=0.8, progress=times.append)
    assert (tracked.cycles, tracked.failures) == (10, 0)
    np.testing.assert_allclose(times, np.arange(10) * 0.8)
    assert missed(tracked.run) < 1e-4
    assert tracked.run.t[-1] == pytest.approx(DURATION)
    assert (np.diff(tracked.run.t) > 0).all()


@pytest.mark.slow
def test_on_a_wrong_ground_and_beside_the_start_replanning_ends_nearer(window):
    world = direct_kinematics(VEHICLE, Bicubic(disturbed(GRID, 0.02, 1.0, 1)))
    start = settle(world, x=0.04, y=-0.03, heading=0.03)
    alone = simulate_plan(world, start, window.plan, step=0.2)
    tracked = track_plan(window, world, start, period=0.4)
    assert missed(tracked.run) < missed(alone) / 5


@pytest.mark.slow
def test_a_limit_of_the_world_ends_the_motion(window):
    axis = AXIS[(AXIS > -1.5) & (AXIS < 1.5)]
    heights = GRID.z[np.ix_(np.isin(AXIS, axis), np.isin(AXIS, axis))]
    world = direct_kinematics(VEHICLE, Bicubic(Grid(axis, axis, heights)))
    tracked = track_plan(window, world, settle(world), period=0.8)
    assert tracked.run.stop.name.startswith("map_margin")
    assert tracked.run.stop.t == pytest.approx(tracked.run.t[-1])
    assert tracked.run.t[-1] < DURATION


@pytest.mark.slow
def test_wrong_arguments_are_refused(window):
    dae = window.program.task.dae
    with pytest.raises(
        ModelError, match="period: expected a period above 0 and at most 8 s, the duration"
    ):
        track_plan(window, dae, settle(dae), period=0.0)
    other = direct_kinematics(catalog.differential_drive(), Bicubic(GRID))
    with pytest.raises(ModelError, match="world: expected the states and inputs of the plan's"):
        track_plan(window, other, settle(other), period=0.8)
