"""Tests of the endings of climbs: samples computed by hand, and random climbs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.climb_drawn import drawn, drive, finite
from slipfree.catalog import step_climber
from slipfree.catalog.step_climber import AXLES
from slipfree.core.outcome import Outcome
from slipfree.core.records import Label
from slipfree.core.trajectory import Column, Stop, Trajectory
from slipfree.models.samples import obstacle_ending
from slipfree.terrain.solids import placed, step

N, RADIUS = 401, 0.066  # a sample every 10 ms
T = np.arange(N) * 0.01


def motion(y, z=None, stop=None, touching=True, x=0 * T):
    """The vehicle on the floor, and at a step from 0.5 s on, with its axles at a height z.

    The step is 1 m ahead.
    """
    z = np.full(N, RADIUS) if z is None else z
    columns = {
        **{"x": x, "y": y, "z": z},
        "center_x": np.tile(x[:, None], (1, 3)),
        "center_y": np.tile(y[:, None] - 1.0, (1, 3)),
        "center_z": np.tile(z[:, None], (1, 3)),
        "wheel_rate": np.full((N, 3), 0.1 / RADIUS),
        "solid_load_1": np.where(touching & (T > 0.5), 70.0, 0.0)[:, None] * np.ones(3),
    }
    return Trajectory(T, {k: Column(Label(k, "m", k), v) for k, v in columns.items()}, AXLES, stop)


def ending(*args, **options):
    run = motion(*args, **options)
    return obstacle_ending(run, step_climber(), placed(step(0.09)))


def test_what_comes_up_climbs():
    found = ending(0.25 * T, np.where(T < 2.5, RADIUS, RADIUS + 0.09))
    assert found.name == "climbs"
    assert_allclose(found.t, 2.5)


def test_wheels_on_the_floor_are_not_on_a_low_step():
    """Neither on one that is lower than 0.2 radii."""
    low = placed(step(0.1 * RADIUS))
    assert obstacle_ending(motion(0.1 * T), step_climber(), low).name == "unfinished"
    up = motion(0.1 * T, np.where(T < 2.5, RADIUS, 1.1 * RADIUS))
    found = obstacle_ending(up, step_climber(), low)
    assert (found.name, found.t) == ("climbs", pytest.approx(2.5))


def test_what_gets_no_farther_stalls():
    assert ending(np.minimum(0.1 * T, 0.15)).name == "stalls"
    assert ending(np.minimum(0.1 * T, 0.15) + 0.004 * T).name == "stalls"
    assert ending(0.1 * T).name == "unfinished"


def test_what_slides_at_an_obstacle_moves_along():
    stuck = np.minimum(0.1 * T, 0.15)
    assert ending(stuck, x=0.05 * T).name == "moves along"
    assert ending(stuck, x=0.05 * T, z=RADIUS + 0.01 * T).name == "unfinished"
    assert ending(stuck, x=0.05 * T, touching=False).name == "unfinished"


def test_beside_an_obstacle_it_passes():
    found = ending(0.5 * T)
    assert (found.name, found.t) == ("passes", pytest.approx(2.01))
    assert "crossed the line of the front edge; 0 of 3 wheels had reached" in found.words
    found = ending(0.5 * T, touching=False)
    assert found.name == "passes"
    assert found.words.endswith("no wheel touched an obstacle")
    assert ending(1.5 + 0 * T).name == "stalls"


def test_what_falls_over_tips():
    stop = Stop("rear_upright", 4.0, "the rear body overturns: its tilt: 1.4", Outcome.LIMIT)
    up = 0.25 * T, np.full(N, RADIUS + 0.09)
    assert ending(*up).name == "climbs"
    found = ending(*up, stop=stop)
    assert (found.name, found.t) == ("tips over", 4.0)
    assert "at t = 4 s the rear body overturns" in found.words


def test_a_floor_is_no_obstacle():
    found = ending(0.25 * T, touching=False)
    assert (found.name, found.words) == ("unfinished", "no wheel touched an obstacle")


SEEDS = {  # of a kerb, steps, stairs, ramps; 43 and 84 with noise, 57 sampled
    99: "stalls",
    36: "stalls",
    82: "tips over",
    24: "climbs",
    162: "climbs",
    43: "climbs",
    84: "tips over",
    57: "climbs",
}


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_climbs_at_random(seed):
    case = drawn(seed)
    run = drive(case)
    assert finite(run)
    found = obstacle_ending(run, case.vehicle, placed(case.profile))
    assert found.name == SEEDS[seed], found.words
