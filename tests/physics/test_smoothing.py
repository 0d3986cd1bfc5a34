"""Smoothed absolute values and maxima: without offset far from the kink, without jump at it."""

from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from slipfree.catalog import rigid_skid_steer
from slipfree.geometry.regions import Region
from slipfree.laws import soil
from slipfree.models.kinematics import press
from slipfree.plan import problem

X = ca.SX.sym("x")
CART = rigid_skid_steer()
DEPTH = CART.numeric.wheels[0].depth


def work(power):
    dae = SimpleNamespace(named=lambda name: [power if name == "drive_torque" else 1.0])
    return problem._driving_power(dae)


def load(depth):
    return 4 * DEPTH * press(CART, ca.repmat(depth, 4, 1), 0.1).load[0]


def ramp(x):
    return max(x, 0.0)


CASES = {  # expression, exact function, width of the transition
    "ratio on soil": (soil._smooth_size(X**2), abs, soil.RATIO_SMOOTHING),
    "positive power": (work(X), ramp, problem.BLENDED_POWER),
    "load of a pressed wheel": (load(X), ramp, 0.1 * DEPTH),
    "distance from a disc": (Region.disc(0, 0, 1).outside(X, ca.SX(0)) + 1, abs, 1e-3),
    "distance from a corner": (
        Region.polygon(((0, 0), (-1, 1), (-1, -1))).outside(X, ca.SX(0)),
        lambda x: x if x > 0 else np.nan,
        1e-3,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_a_smoothing_has_no_offset_far_from_its_kink(name):
    expression, exact, width = CASES[name]
    smooth = ca.Function("smooth", [X], [expression, ca.jacobian(expression, X)])
    for x in (-1e5 * width, -1e3 * width, 1e3 * width, 1e5 * width):
        value, slope = map(float, smooth(x))
        if np.isfinite(exact(x)):
            assert value == pytest.approx(exact(x), abs=2e-3 * width)
            assert slope == pytest.approx((exact(1.1 * x) - exact(x)) / (0.1 * x), abs=1e-3)
    assert np.isfinite(np.array(list(map(float, smooth(0.0))))).all()
