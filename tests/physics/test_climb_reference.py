"""Tests of the axles' reference speeds: no slip in any phase, and the laws as printed."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.climb_cases import dimensions
from slipfree.control.reference_speeds import (
    PerAxle,
    Tilts,
    estimated_directions,
    ratios,
    reference,
)
from slipfree.control.step_climbing import StepClimbing, largest_period, torques
from slipfree.errors import ModelError

ALPHA, TH_A, TH_B = np.radians([45, 12, 7])
TILTS = Tilts(TH_B, TH_A + TH_B)


def numbers(record):
    return np.array([float(ca.DM(each)) for each in record])


def closure(climber, tilts, directions):
    """The closure of both bodies in v_R, v_M, v_F and the tilt rates: one motion is left."""
    link, d = climber.middle.ahead - climber.rear.ahead, -climber.middle.ahead
    along = [np.array([np.cos(a), np.sin(a)]) for a in directions]
    rear, front = (np.array([-np.sin(a), np.cos(a)]) for a in tilts)
    rows = np.zeros((4, 5))
    rows[:2, 0], rows[:2, 1], rows[:2, 3] = -along[0], along[1], -link * rear
    rows[2:, 1], rows[2:, 2] = -along[1], along[2]
    rows[2:, 3], rows[2:, 4] = -d * rear, -climber.front.ahead * front
    return np.linalg.svd(rows)[2][-1]


def test_the_law_is_the_one_motion_without_slip():
    rng, worst = np.random.default_rng(0), 0.0
    vehicles = [dimensions(joint) for joint in (0.0, 0.06, 0.126)]
    for _ in range(2000):
        climber = vehicles[rng.integers(3)]
        tilts = Tilts(*rng.uniform(-0.6, 0.6, 2))
        directions = PerAxle(*rng.uniform(-0.3, np.pi / 2, 3))
        speeds = numbers(ratios(climber, tilts, directions))
        null = closure(climber, tilts, directions)[:3]
        speeds, null = speeds / np.linalg.norm(speeds), null / np.linalg.norm(null)
        worst = max(worst, np.abs(speeds - np.sign(speeds @ null) * null).max())
    assert worst < 1e-12


@pytest.mark.parametrize(
    ("directions", "expected"),
    [
        ((0, 0, 1), (1, 1 / 0.95058)),
        ((0, 1, 0), (0.79392, 0.95058)),
        ((0, 1, 1), None),
        ((1, 0, 0), (1.25957, 1)),
    ],
)
def test_phases_of_a_climb(directions, expected):
    """Figures of the lab for alpha = 45, th_a = 12, th_b = 7 degrees; (6) and (8) are one each."""
    speeds = numbers(ratios(dimensions(), TILTS, PerAxle(*(ALPHA * d for d in directions))))
    speeds = speeds[[0, 2]] / speeds[1]
    six = np.cos(ALPHA - TH_B) / np.cos(TH_B)
    eight = np.cos(TH_A + TH_B) / np.cos(ALPHA - TH_A - TH_B)
    if expected is not None:
        assert_allclose(speeds, expected, atol=1e-4)
    if directions[1]:
        assert_allclose(speeds[0], six, rtol=1e-12)
    if directions == (0, 0, 1):
        assert_allclose(speeds[1], eight, rtol=1e-12)
        assert abs(speeds[0] - six) > 0.2
    # The middle axle is on the slope in (6) and on the floor in (8): never both.
    assert not np.allclose(speeds, [six, eight], atol=0.05)


def test_at_a_wall_the_front_axle_goes_alone():
    climber, level = dimensions(), Tilts(0.0, 0.0)
    wall = PerAxle(0.0, 0.0, np.pi / 2)
    speeds = numbers(reference(climber, level, wall, cap=1.5))
    assert_allclose(speeds, [0, 0, 1.5], atol=1e-12)
    tilted = numbers(reference(climber, Tilts(0.0, 0.4), wall, cap=1.5))
    assert_allclose(tilted[2], 1.5)
    assert_allclose(tilted[1], 1.5 * np.tan(0.4))
    assert_allclose(numbers(reference(climber, TILTS, wall, law="fixed")), 1)
    flat = numbers(reference(climber, level, PerAxle(0.0, 0.0, 0.0)))
    assert_allclose(flat, 1)


# As printed


def printed(law, cap=10.0):
    directions = PerAxle(0.0, 0.0, ALPHA)
    return numbers(reference(dimensions(), TILTS, directions, law=law, cap=cap))


def test_printed_references():
    """(16) slows the wheel that climbs where (6) and (8) say the contrary."""
    assert_allclose(printed("printed_6_8"), [0.7939, 1, 1.0520], atol=1e-4)
    assert_allclose(printed("printed_16"), [1 / 0.79392, 1, 0.95058], atol=1e-4)
    rear = np.cos(ALPHA - TH_B) / np.cos(TH_B) / 5
    front = np.cos(TH_A + TH_B) / np.cos(ALPHA - TH_A - TH_B) / 5
    forward = np.array([rear, 0, -rear, 1 / 5, front, 0, -front])  # row of (14) with k = r = 1
    inverse = np.linalg.pinv(forward[None])
    assert_allclose(printed("printed_14"), inverse[[0, 3, 4], 0], rtol=1e-12)
    wall = PerAxle(0.0, 0.0, np.pi / 2)
    for law in ("printed_6_8", "printed_14", "printed_16"):
        assert np.isfinite(numbers(reference(dimensions(), Tilts(0.0, 0.0), wall, law=law))).all()


# Directions that the sensors see


@pytest.mark.parametrize("directions", [(0, 0, 0), (0, 0, 0.8), (0, 0.6, 0), (0.7, 0, 0)])
def test_sensors_see_the_direction_of_the_axle_that_climbs(directions):
    for joint in (0.0, 0.06):
        climber = dimensions(joint)
        tilts = Tilts(0.1, 0.25)
        motion = closure(climber, tilts, directions)
        motion *= 0.25 / motion[1]
        spins = PerAxle(*(motion[:3] / climber.radius))
        seen = numbers(estimated_directions(climber, tilts, Tilts(*motion[3:]), spins))
        assert_allclose(seen, directions, atol=1e-12)


def test_sensors_see_no_more_than_they_can():
    climber = dimensions()
    fast = estimated_directions(climber, Tilts(0, 0), Tilts(0, 5.0), PerAxle(1, 1, 1))
    assert_allclose(numbers(fast), [0, 0, np.arcsin(0.985)])
    at_rest = estimated_directions(climber, Tilts(0, 0), Tilts(0, 0), PerAxle(0, 0, 0))
    assert_allclose(numbers(at_rest), 0)


# Torques


def test_torques_are_scaled_together():
    control = StepClimbing(proportional=2.0, integral=10.0, derivative=0.5)
    errors, sums, rises = PerAxle(1.0, 0.5, -3.0), PerAxle(0.1, 0.0, -0.2), PerAxle(2.0, 0.0, 4.0)
    expected = np.array([2 + 1 + 1, 1, -6 - 2 + 2])
    free = torques(control, errors, sums, rises)
    assert_allclose(numbers(free.out), expected)
    assert float(free.scale) == 1
    # The largest is negative: (18) as printed would let it pass.
    held = torques(replace(control, torque=3.0), errors, sums, rises)
    assert_allclose(float(ca.DM(held.scale)), 0.5)
    assert_allclose(numbers(held.out), expected / 2)
    assert_allclose(numbers(held.wanted), expected)
    assert float(ca.DM(torques(replace(control, torque=7.0), errors, sums, rises).scale)) == 1


def test_largest_period_of_a_sampled_controller():
    assert_allclose(largest_period(StepClimbing(), dimensions()), 2.5e-3)
    assert_allclose(largest_period(StepClimbing(motors=(1, 1, 1)), dimensions()), 2.5e-3)
    assert_allclose(largest_period(StepClimbing(proportional=32.0), dimensions()), 2.5e-3 / 8)
    assert_allclose(largest_period(StepClimbing(integral=4000.0), dimensions()), 2e-3)
    with_derivative = StepClimbing(derivative=0.02, lag=0.005)
    assert_allclose(largest_period(with_derivative, dimensions()), 1.25e-3)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"law": "best"}, "expected one of projective, .* for 'law'"),
        ({"directions": "eyes"}, "expected one of contact, sensors for 'directions'"),
        ({"smoothing": 0.0}, "'smoothing': expected a number > 0, found 0"),
        ({"unwinding": -1.0}, "'unwinding': expected a number >= 0, found -1"),
        ({"cap": 0.9}, "'cap': expected a number >= 1, found 0.9"),
        ({"share": np.inf}, "'share': expected a number < inf"),
        ({"motors": (2, 0, 2)}, "expected one motor or more per axle as 'motors', found"),
    ],
)
def test_unusable_controls_are_refused(values, words):
    with pytest.raises(ModelError, match=words):
        StepClimbing(**values)
