"""Tests that motions are equal at any size of vehicle and ground."""

from dataclasses import replace
from functools import lru_cache

import pytest
from numpy.testing import assert_allclose

from helpers.scale_cases import CASES, TOLERANCE, difference, formula, scaled
from slipfree import ModelError, direct_kinematics, settle
from slipfree.catalog import three_wheeler
from slipfree.core.dae import power_of_length

MOST = 1.0  # tolerances
AMPLIFIED = {"inverse, steering rate": 50.0}  # rounding changes the steps, and so the error
at_scale_one = lru_cache(lambda name: CASES[name](1.0))


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_scaled_problem_has_the_scaled_motion(name):
    scale = 1e3
    first, run = at_scale_one(name), CASES[name](scale)
    assert (run.stop and run.stop.name) == (first.stop and first.stop.name)
    assert_allclose(run.t[-1], first.t[-1], rtol=0, atol=2e-6)
    quantity, gap = difference(first, run, scale)
    assert gap < AMPLIFIED.get(name, MOST), quantity


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_extreme_scales_are_not_singular(scale):
    dae = direct_kinematics(scaled(three_wheeler(), scale), formula(scale))
    found, expected = settle(dae, heading=0.2), _stand()
    for name in ("roll", "pitch", "singular_value"):
        assert_allclose(found[name], expected[name], rtol=0, atol=TOLERANCE, err_msg=name)
    for name in ("z", "contact_x", "contact_y"):
        assert_allclose(found[name] / scale, expected[name], rtol=0, atol=TOLERANCE, err_msg=name)


@pytest.mark.slow
def test_tolerance_of_lengths_counts_in_sizes_of_the_vehicle():
    """As many steps at every scale: the error test sees the same numbers."""
    steps = [CASES["direct, map"](scale).statistics["steps"] for scale in (1e-3, 1e3)]
    assert_allclose(steps, at_scale_one("direct, map").statistics["steps"], atol=2)


@pytest.mark.parametrize(
    ("unit", "power"), [("m", 1), ("rad", 0), ("m s-1", 1), ("m2 s-1", 2), ("m-1", -1), ("N m", 1)]
)
def test_power_of_length(unit, power):
    assert power_of_length(unit) == power


@lru_cache
def _stand():
    return settle(direct_kinematics(three_wheeler(), formula(1.0)), heading=0.2)


def test_size_is_a_positive_length():
    dae = direct_kinematics(three_wheeler(), formula(1.0))
    assert dae.size == 1.0  # the paper's vehicle: tolerances in metres
    with pytest.raises(
        ModelError, match="size: expected a positive, finite length in metres, found 0"
    ):
        replace(dae, size=0.0)
