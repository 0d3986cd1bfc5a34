"""Tests of the endings of climbs: samples computed by hand, and random climbs."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.climb_drawn import drawn, drive, finite
from slipfree.catalog.step_climber import step_climber
from slipfree.climb.ending import climb_ending
from slipfree.outcome import Outcome
from slipfree.records import Label
from slipfree.terrain.solids import Profile, Solid, step
from slipfree.trajectory import Column, Stop, Trajectory
from slipfree.vehicle.climber import AXLES

N, RADIUS = 401, 0.066  # a sample every 10 ms
T = np.arange(N) * 0.01


def motion(x, z=None, stop=None, touching=True):
    """The axles at places x of the front one, 0.2 m apart, over time; all as high as z."""
    z = np.full(N, RADIUS) if z is None else z
    columns = {
        "center_y": x[:, None] - [0.4, 0.2, 0.0],
        "center_z": np.tile(z[:, None], (1, 3)),
        "solid_gap_2": np.where(touching & (T > 0.5), -1e-4, 0.1)[:, None] * np.ones(3),
    }
    return Trajectory(T, {k: Column(Label(k, "m", k), v) for k, v in columns.items()}, AXLES, stop)


def ending(*args, **options):
    return climb_ending(motion(*args, **options), step_climber(), step(0.09))


def test_what_comes_up_climbs():
    found = ending(0.25 * T, np.where(T < 2.5, RADIUS, RADIUS + 0.09))
    assert (str(found), found.name) == ("climbs", "climbs")
    assert_allclose(found.t, 2.5)
    # The rear axle on the wheels' height, but in front of the edge.
    assert str(ending(0.05 * T, np.full(N, RADIUS + 0.09))) == "unfinished"


def test_what_is_past_a_bump_has_climbed_it():
    bump = Solid(((0, -0.1), (0.3, -0.1), (0.3, 0.0), (0.15, 0.05), (0, 0.0)))
    ground = Profile((*step(0.09).solids[:1], bump))
    found = climb_ending(motion(0.25 * T), step_climber(), ground)
    assert str(found) == "climbs"
    assert_allclose(found.t, 4 * (0.15 + 0.02 + 0.4) + 0.01, atol=0.011)


def test_what_gets_no_farther_stalls_or_slides_back():
    stuck = ending(np.minimum(0.1 * T, 0.15))
    assert str(stuck) == "stalls"
    assert_allclose(stuck.t, 1.46)  # 5 mm before it is farthest
    assert "(front axle at x = 0.146 m)" in stuck.words
    creeping = np.minimum(0.1 * T, 0.15) + 0.004 * T
    assert str(ending(creeping)) == "stalls"
    back = ending(np.minimum(0.1 * T, 0.15) - 0.05 * np.maximum(T - 3, 0))
    assert str(back) == "slides back"
    assert "it ends 50 mm behind" in back.words
    bouncing = np.minimum(0.1 * T, 0.15), RADIUS + 0.02 * np.abs(np.sin(5 * T))
    assert str(ending(*bouncing)) == "stalls"


def test_what_falls_over_tips():
    stop = Stop("rear_overturned", 4.0, "the rear body overturns: its tilt: 1.4", Outcome.LIMIT)
    up = 0.25 * T, np.full(N, RADIUS + 0.09)
    assert str(ending(*up)) == "climbs"
    found = ending(*up, stop=stop)
    assert (str(found), found.t) == ("tips over", 4.0)
    assert "at t = 4 s the rear body overturns" in found.words


def test_what_goes_on_is_not_finished():
    found = ending(
        0.1 * T, stop=Stop("solver", 4.0, "the integrator stopped", Outcome.SOLVER_FAILURE)
    )
    assert str(found) == "unfinished"
    assert found.words == "until t = 4 s the vehicle was still advancing; the integrator stopped"
    assert "touches only the floor" in ending(0.25 * T, touching=False).words


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


@pytest.mark.parametrize("seed", SEEDS)
def test_climbs_at_random(seed):
    case = drawn(seed)
    run = drive(case)
    assert finite(run)
    assert str(climb_ending(run, case.climber, case.profile)) == SEEDS[seed]
