"""Tests of starts from a wheel contact, from an unknown of the pose, and near a given pose."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.cases import case1, closure_model, hills
from slipfree import Analytic, ModelError, settle
from slipfree.catalog import open_source_rover, three_wheeler
from slipfree.problem.contact_start import settle_contact
from slipfree.solve.starts import settle_exchanged, settle_nearest

HILLS = Analytic(hills)


@pytest.mark.slow
def test_start_from_one_contact(rng):
    for terrain in (HILLS, case1()[0]):
        dae = closure_model(three_wheeler(), terrain)
        for wheel in ("right", "left", "front"):
            joints = dict(
                zip(
                    ("heading", "tilt_right", "tilt_left", "steer"),
                    rng.uniform(-0.2, 0.2, 4),
                    strict=True,
                )
            )
            stood = settle(dae, x=0.4, y=0.2, **joints)
            place = {name: stood[name, wheel][0] for name in ("contact_x", "contact_y")}
            found = settle_contact(dae, wheel, **place, **joints)
            for name in ("x", "y", "z", "heading", "roll", "pitch"):
                assert_allclose(found[name][0], stood[name][0], rtol=0, atol=1e-12, err_msg=name)


def test_start_from_the_contact_of_the_paper():
    """Left contact at (-1, 0), no tilt, no steering; the heading is ours to choose."""
    dae = closure_model(three_wheeler(), HILLS)
    found = settle_contact(dae, "left", contact_x=-1.0, contact_y=0.0)
    assert found["contact_x", "left"][0] == pytest.approx(-1, abs=1e-14)
    assert found["heading"][0] == 0


def test_nearest_pose_changes_least(rng):
    dae = closure_model(three_wheeler(), HILLS)
    stood = settle(dae, x=0.4, y=0.2, heading=0.5, steer=0.1)
    names = ("x", "y", "z", "heading", "roll", "pitch", "tilt_right", "tilt_left", "steer")
    pose = {name: stood[name][0] for name in names}
    assert settle_nearest(dae, **pose).statistics["change"] < 1e-9
    pose = {name: value + rng.uniform(-0.05, 0.05) for name, value in pose.items()}
    found = settle_nearest(dae, **pose)
    change = found.statistics["change"]
    assert_allclose(change, np.sqrt(sum((found[n][0] - pose[n]) ** 2 for n in names)), rtol=1e-12)
    for _ in range(20):  # no neighbour on the ground is nearer
        moved = {
            n: found[n][0] + rng.uniform(-1e-3, 1e-3)
            for n in names
            if n in ("x", "y", "heading", "tilt_right", "tilt_left", "steer")
        }
        other = settle(dae, **moved)
        assert np.sqrt(sum((other[n][0] - pose[n]) ** 2 for n in names)) > change
    kept = settle_nearest(dae, weights={"x": np.inf, "y": np.inf, "heading": np.inf}, **pose)
    assert_allclose(
        [kept[n][0] for n in ("x", "y", "heading")],
        [pose["x"], pose["y"], pose["heading"]],
        atol=1e-12,
    )
    assert kept.statistics["change"] > change


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", [three_wheeler(), open_source_rover()], ids=lambda v: v.name)
@pytest.mark.parametrize("terrain", [HILLS, case1()[0]], ids=["hills", "map"])
@pytest.mark.parametrize(("state", "unknown"), [("heading", "pitch"), ("x", "z")])
def test_any_unknown_of_the_pose_takes_the_place_of_a_state(vehicle, terrain, state, unknown):
    dae, pose = closure_model(vehicle, terrain), {"x": 0.4, "y": 0.2, "heading": 0.3}
    stood = settle(dae, **pose)
    given = {name: value for name, value in pose.items() if name != state}
    value = float(stood[unknown][0])
    found = settle_exchanged(dae, {state: unknown}, **given, **{unknown: value})
    assert found[unknown][0] == pytest.approx(value, abs=1e-12)
    for name, value in given.items():
        assert found[name][0] == pytest.approx(value, abs=1e-14)
    assert max(found["closure_residual"]) < 1e-13


def test_nothing_exchanged_is_a_start_from_all_states():
    dae = closure_model(three_wheeler(), HILLS)
    found, stood = settle_exchanged(dae, {}, x=0.4, heading=0.3), settle(dae, x=0.4, heading=0.3)
    for name in ("z", "roll", "pitch"):
        assert_allclose(found[name], stood[name], rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("exchange", "words"),
    [
        ({"azimuth": "pitch"}, "expected one of x, y, heading, .*, found 'azimuth'"),
        ({"x": "azimuth"}, "expected one of z, .*, found 'azimuth'"),
        ({"x": "slip_along[left]"}, "found 'slip_along.left.'"),
        ({"x": "z", "y": "z"}, "expected a different unknown in place of each state, found z, z"),
        ({"x": "pitch"}, "expected an unknown in m in place of x, found pitch in rad"),
    ],
)
def test_exchanges_are_checked(exchange, words):
    dae = closure_model(three_wheeler(), HILLS)
    with pytest.raises(ModelError, match=words):
        settle_exchanged(dae, exchange)


def test_starts_from_a_contact_are_checked():
    dae = closure_model(three_wheeler(), HILLS)
    with pytest.raises(ModelError, match=r"front, left, right.*, found 'rear'"):
        settle_contact(dae, "rear", contact_x=0.0, contact_y=0.0)
    with pytest.raises(ModelError, match="which follow from the contact point, found y"):
        settle_contact(dae, "left", contact_x=0.0, contact_y=0.0, y=1.0)
    with pytest.raises(ModelError, match="found the unknown 'azimuth'"):
        settle_contact(dae, "left", contact_x=0.0, contact_y=0.0, azimuth=1.0)


def test_poses_are_checked():
    dae = closure_model(three_wheeler(), HILLS)
    with pytest.raises(
        ModelError, match=r"settle_nearest: expected names of states .*, found 'azimuth'"
    ):
        settle_nearest(dae, azimuth=1.0)
    with pytest.raises(ModelError, match="settle_nearest: z: expected a finite value, found nan"):
        settle_nearest(dae, z=np.nan)
    with pytest.raises(ModelError, match="weight of at least 0 for 'z', found -1"):
        settle_nearest(dae, z=2.0, weights={"z": -1.0})
    names = ("x", "y", "z", "heading", "roll", "pitch")
    words = "at rest near x = 0, y = 0, .* = 0, found none .*; give .*, or fewer coordinates with"
    with pytest.raises(ModelError, match=words):
        settle_nearest(dae, **dict.fromkeys(names, 0.0), weights=dict.fromkeys(names, np.inf))
