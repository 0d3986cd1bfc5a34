"""Tests of starts from a wheel contact, from an unknown of the pose, and near a given pose."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.cases import case1, closure_model, hills
from slipfree import Analytic, ModelError, settle
from slipfree.catalog import open_source_rover, three_wheeler
from slipfree.solve.settle import settle_contact, settle_exchanged, settle_nearest

HILLS = Analytic(hills)


@pytest.mark.slow
def test_start_from_one_contact(rng):
    for terrain in (HILLS, case1()[0]):
        dae = closure_model(three_wheeler(), terrain)
        for wheel in ("right", "left", "front"):
            names = ("heading", "tilt_right", "tilt_left", "steer")
            joints = dict(zip(names, rng.uniform(-0.2, 0.2, 4), strict=True))
            stood = settle(dae, x=0.4, y=0.2, **joints)
            place = {name: stood[name, wheel][0] for name in ("contact_x", "contact_y")}
            found = settle_contact(dae, wheel, **place, **joints)
            for name in ("x", "y", "z", "heading", "roll", "pitch"):
                assert_allclose(found[name][0], stood[name][0], rtol=0, atol=1e-12, err_msg=name)


def test_nearest_pose_changes_least(rng):
    dae = closure_model(three_wheeler(), HILLS)
    stood = settle(dae, x=0.4, y=0.2, heading=0.5, steer=0.1)
    names = ("x", "y", "z", "heading", "roll", "pitch", "tilt_right", "tilt_left", "steer")
    pose = {name: stood[name][0] for name in names}
    assert settle_nearest(dae, **pose).statistics["change"] < 1e-9
    pose = {name: value + rng.uniform(-0.05, 0.05) for name, value in pose.items()}

    def distance(run):
        return np.sqrt(sum((run[n][0] - pose[n]) ** 2 for n in names))

    found = settle_nearest(dae, **pose)
    change = found.statistics["change"]
    assert_allclose(change, distance(found), rtol=1e-12)
    for _ in range(20):  # no neighbour on the ground is nearer
        states = ("x", "y", "heading", "tilt_right", "tilt_left", "steer")
        moved = {n: found[n][0] + rng.uniform(-1e-3, 1e-3) for n in states}
        assert distance(settle(dae, **moved)) > change
    fixed = ("x", "y", "heading")
    kept = settle_nearest(dae, weights=dict.fromkeys(fixed, np.inf), **pose)
    assert_allclose([kept[n][0] for n in fixed], [pose[n] for n in fixed], atol=1e-12)
    assert kept.statistics["change"] > change


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vehicle", "terrain", "exchange"),
    [
        (three_wheeler(), HILLS, {}),
        (three_wheeler(), HILLS, {"heading": "pitch"}),
        (open_source_rover(), case1()[0], {"x": "z"}),
    ],
    ids=["nothing", "pitch for heading", "z for x on a map"],
)
def test_any_unknown_of_the_pose_takes_the_place_of_a_state(vehicle, terrain, exchange):
    dae, pose = closure_model(vehicle, terrain), {"x": 0.4, "y": 0.2, "heading": 0.3}
    stood = settle(dae, **pose)
    given = {exchange.get(name, name): float(stood[exchange.get(name, name)][0]) for name in pose}
    found = settle_exchanged(dae, exchange, **given)
    for name in ("x", "y", "z", "heading", "roll", "pitch"):
        assert found[name][0] == pytest.approx(stood[name][0], abs=1e-10)
    for name, value in given.items():
        assert found[name][0] == pytest.approx(value, abs=1e-14 if name in pose else 1e-12)
    assert max(found["closure_residual"]) < 1e-13


def test_exchanges_are_checked():
    dae = closure_model(three_wheeler(), HILLS)
    for exchange, words in (
        ({"azimuth": "pitch"}, "expected one of x, y, heading, .*, found 'azimuth'"),
        ({"x": "slip_along[left]"}, "expected one of z, .*, found 'slip_along.left.'"),
        ({"x": "z", "y": "z"}, "expected a different unknown in place of each state, found z, z"),
        ({"x": "pitch"}, "expected an unknown in m in place of x, found pitch in rad"),
    ):
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
    with pytest.raises(ModelError, match="settle_nearest: z: expected a number, found float nan"):
        settle_nearest(dae, z=np.nan)
    with pytest.raises(ModelError, match=r"weights\['z'\]: expected a number >= 0, found -1"):
        settle_nearest(dae, z=2.0, weights={"z": -1.0})
    names = ("x", "y", "z", "heading", "roll", "pitch")
    words = "at rest near x = 0, y = 0, .* = 0, found none .*; give .*, or fewer coordinates with"
    with pytest.raises(ModelError, match=words):
        settle_nearest(dae, **dict.fromkeys(names, 0.0), weights=dict.fromkeys(names, np.inf))
