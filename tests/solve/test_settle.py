"""Tests of settling: the pose of the vehicle on the ground, or the reason of a failure."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.cases import hills
from helpers.commands import refuses
from slipfree import Analytic, ModelError, direct_kinematics, settle
from slipfree.catalog import three_wheeler


@pytest.fixture(scope="module")
def on_hills():
    return direct_kinematics(three_wheeler(), Analytic(hills))


@pytest.mark.slow
def test_poor_starts_settle_to_the_right_root(on_hills, rng):
    """The explicit closure has no root with a wheel under the ground."""
    for _ in range(20):
        x, y, heading = *rng.uniform(-3, 3, 2), rng.uniform(-np.pi, np.pi)
        nominal = settle(on_hills, x=x, y=y, heading=heading)
        guess = {name: nominal[name][0] + rng.uniform(-0.4, 0.4) for name in ("roll", "pitch")}
        guess["z"] = nominal["z"][0] + rng.uniform(-0.2, 0.2)
        for wheel in nominal.wheels:
            for name in ("contact_x", "contact_y"):
                guess[f"{name}[{wheel}]"] = nominal[name, wheel][0] + rng.uniform(-0.2, 0.2)
        found = settle(on_hills, guess=guess, x=x, y=y, heading=heading)
        for name in ("z", "roll", "pitch"):
            assert_allclose(found[name], nominal[name], atol=1e-10)
        ground = Analytic(hills).elevation(found["center_x"], found["center_y"])
        assert (found["center_z"] > ground).all()
        assert found["closure_residual"][0] < 1e-12


def test_stands_at_rest(on_hills):
    run = settle(on_hills, x=0.3, heading=1.0, tilt_right=0.1)
    assert run["tilt_right"][0] == 0.1
    assert_allclose([run[f"velocity_{axis}"][0] for axis in "xyz"], 0, atol=1e-15)


def test_plane_is_exact():
    """On a plane a level vehicle lies parallel to it, a rolling radius above."""
    slope = 0.25
    dae = direct_kinematics(three_wheeler(), Analytic(lambda _, y: slope * y))
    run = settle(dae, x=2.0, y=1.0)
    assert_allclose(run["pitch"][0], np.arctan(slope), atol=1e-13)
    assert_allclose(run["roll"][0], 0, atol=1e-13)
    assert_allclose(run["z"][0], slope * 1.0 + 0.3 * np.hypot(1, slope), atol=1e-12)
    assert_allclose(run["uprightness"][0], 1, atol=1e-12)


PIT = Analytic(lambda x, y: -0.4 * ca.exp(-((x - 1) ** 2 + (y + 0.5) ** 2) / 0.05))


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ({"azimuth": 0.1}, "start: expected values only for 'x', 'y', .*, found the unknown 'azim"),
        ({"guess": {"height": 1.0}}, "guess: expected names of unknowns of the model, z, roll"),
        ({"x": np.nan}, "x: expected a number, found float nan"),
        ({"tilt_left": 0.3}, r"tilt_left .* reaches its stop: 0.3, allowed -0.2 to 0.2 rad"),
        ({"x": 4.5}, r"wheel right leaves the map.*-0\.49\d*, allowed at least 0 m"),
    ],
)
def test_starts_that_are_none_are_refused(start, words):
    ground = Analytic(hills, (-5.0, 5.0, -5.0, 5.0))
    dae = direct_kinematics(three_wheeler(tilt_stop=0.2), ground)
    refuses(ModelError, words, settle, dae, **start)


def test_a_wheel_stands_on_the_rim_of_a_pit_and_is_refused_upside_down(on_hills):
    run = settle(direct_kinematics(three_wheeler(), PIT))
    assert run["clearance", "right"][0] >= 0
    words = r"tilt_right .* reaches its stop: .* allowed -1.5 to 1.5 rad"
    refuses(ModelError, words, settle, on_hills, tilt_right=3.2)


def test_uprightness_of_a_tilted_wheel():
    """The sine of axle to normal, with the pitch by which the lowered rear end tips the axle."""
    dae = direct_kinematics(three_wheeler(tilt_stop=2.0), Analytic(lambda x, _: 0 * x))
    for tilt in (0.0, 1.2, 1.56):
        run = settle(dae, tilt_right=tilt, tilt_left=tilt)
        expected = np.sqrt(1 - (np.sin(tilt) * np.cos(run["pitch"][0])) ** 2)
        assert_allclose(run["uprightness", "right"][0], expected, atol=1e-12)
