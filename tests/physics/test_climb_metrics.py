"""Tests of averages over a climb, with samples computed by hand."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from slipfree.catalog import step_climber
from slipfree.catalog.step_climber import AXLES
from slipfree.climb.metrics import climb_metrics, disturbance_ratio, slip_ratio
from slipfree.core.errors import ModelError
from slipfree.core.records import Label
from slipfree.core.trajectory import Column, Trajectory
from slipfree.terrain.solids import step

N, RADIUS = 101, 0.066  # a sample every 10 ms
PER_AXLE = {
    "spin": (4.0, 5.0, 0.2),
    "reference": (5.0, 4.0, 4.0),
    "drive_torque": (2.0, -2.0, 6.0),
    "solid_load_0": (30.0, 0.0, 10.0),
    "solid_load_1": (0.0, 0.5, 60.0),
    "solid_slip_0": (-0.033, 1.0, 1.0),
    "solid_slip_1": (1.0, 1.0, 0.00132),
}


def motion(**changes):
    """Constants, but that the front wheel touches at 0.3 s and the rear axle is up at 0.6 s."""
    t = np.arange(N) * 0.01
    columns = {name: np.tile(values, (N, 1)) for name, values in PER_AXLE.items()}
    columns["solid_gap_1"] = np.where(t < 0.295, 0.01, -0.01)[:, None] * [0, 0, 1.0]
    columns["center_y"] = np.where(t < 0.595, 0.0, 0.03)[:, None] * [1.0, 1, 1]
    columns["center_z"] = np.full((N, 3), 0.09 + RADIUS - 0.002)
    # The middle axle is 0.1 m behind the joint, whose velocity is (0.15, 0.1) m/s.
    columns["y"], columns["z"] = columns["center_y"][:, 1] + 0.1, columns["center_z"][:, 1]
    constants = {"velocity_y": 0.15, "velocity_z": 0.1, "omega_x": -1.0, "fold_rate": 9.0}
    columns |= {name: np.full(N, value) for name, value in constants.items()}
    columns["torque_scale"] = np.where(t < 0.395, 1.0, 0.5)
    columns |= changes
    return Trajectory(t, {k: Column(Label(k, "1", k), v) for k, v in columns.items()}, wheels=AXLES)


def averages(run):
    return climb_metrics(run, step_climber(), step(0.09))


def test_averages():
    found = averages(motion())
    assert (found.window.span, found.window.climbed) == (slice(25, 70), True)
    assert_allclose(found.window.t, 0.6)
    speed = 0.25
    # The front wheel is too slow for ratios.
    assert_allclose(
        found.slip, [1 - speed / (4 * RADIUS), 1 - speed / (5 * RADIUS), np.nan], atol=1e-12
    )
    assert_allclose(found.disturbance, [1 / 4, 1 / 5, np.nan])
    # On the solid that bears more; nothing where none bears a newton.
    assert_allclose(found.true_slip, [0.033 / (4 * RADIUS), 0, 0.00132 / (0.2 * RADIUS)])
    assert_allclose(found.effort, np.array([2, 2, 6]) / 10)
    assert_allclose(found.bearing, np.array([30, 0.5, 70]) / 100.5)
    assert_allclose(found.limited, 30 / 45)


def test_ratios_are_signed_but_averages_count_at_most_one():
    run = motion(spin=np.tile((-4.0, 0.5, 0.5), (N, 1)))
    ratios = slip_ratio(run, step_climber())
    assert_allclose(ratios[0], 1 - 0.25 / (RADIUS * np.array([-4, 0.5, 0.5])))
    assert_allclose(disturbance_ratio(run)[0], [-9 / 4, 7, 7])
    assert_allclose(averages(run).slip, 1)
    assert_allclose(averages(run).disturbance, 1)


def test_what_does_not_come_up_is_averaged_to_its_end():
    found = averages(motion(center_y=np.zeros((N, 3))))
    assert (found.window.span, found.window.climbed) == (slice(25, N), False)
    assert_allclose(found.window.t, 1.0)


def test_what_does_not_touch_is_refused():
    with pytest.raises(ModelError, match=r"touches only the floor until t = 1 s"):
        averages(motion(solid_gap_1=np.ones((N, 3))))
