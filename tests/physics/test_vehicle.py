"""Tests of vehicles: validation at construction, and frames against textbook rotations."""

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import slipfree as sf
from helpers.vehicles import four_wheels
from slipfree.catalog import three_wheeler
from slipfree.contact.closure import has_exact_closure
from slipfree.geometry.frame import Pose, platform, quaternion, translation, turn
from slipfree.vehicle.sections import Disc, Omni, Torus

VEHICLE = three_wheeler()


def numbers(expression):
    return np.array(ca.evalf(ca.SX(expression)))


def test_rotations_are_those_of_scipy(rng):
    heading, roll, pitch = angles = rng.uniform(-1, 1, 3)
    pose = platform(1.0, 2.0, 3.0, heading, roll, pitch)
    expected = Rotation.from_euler("ZYX", angles).as_matrix()
    assert_allclose(numbers(pose.rotation), expected, atol=1e-15)
    assert_allclose(numbers(pose.origin).ravel(), [1, 2, 3])
    pose = sf.Joint("arm", "platform", "z", (0.1, 0.2, 0.3), "0", turned=tuple(angles)).pose({})
    expected = Rotation.from_euler("xyz", angles).as_matrix()
    assert_allclose(numbers(pose.rotation), expected, atol=1e-15)
    assert_allclose(numbers(pose.origin).ravel(), [0.1, 0.2, 0.3])
    for rotation in Rotation.random(20, rng=rng):
        angle, axis = rotation.magnitude(), rotation.as_rotvec()
        found = numbers(turn(tuple(axis), angle).rotation)
        assert_allclose(found, rotation.as_matrix(), atol=1e-15)
        expected = rotation.as_quat(canonical=True)
        assert_allclose(numbers(quaternion(ca.SX(ca.DM(found)))).ravel(), expected, atol=1e-14)


def test_twist_is_the_composition_of_velocities(rng):
    q, rates = ca.SX.sym("q", 3), ca.SX.sym("rates", 3)
    wheel = translation(q[0], 0.0, 0.0) @ turn("z", q[1]) @ translation(0.5, 0.2, 0.0)
    wheel = wheel @ turn("z", q[2])
    twist = wheel.twist(q, rates)
    now, speed = rng.normal(size=3), rng.normal(size=3)
    v, omega, arm = (
        np.array(a).ravel()
        for a in ca.Function("f", [q, rates], [*twist, wheel.origin])(now, speed)
    )
    arm = arm - [now[0], 0, 0]
    assert_allclose(omega, [0, 0, speed[1] + speed[2]], atol=1e-14)
    assert_allclose(v, [speed[0] - speed[1] * arm[1], speed[1] * arm[0], 0], atol=1e-14)


def test_three_wheeler_is_the_papers():
    rest, zero = Pose(ca.SX.eye(3), ca.SX.zeros(3)), ca.SX(0)
    poses = VEHICLE.carriers(rest, {c.name: zero for c in VEHICLE.coordinates})
    places = np.array([numbers(pose.origin).ravel() for pose in poses])
    assert_allclose(places, [[1, -0.5, 0], [-1, -0.5, 0], [0, 1, 0]])
    assert {wheel.radius for wheel in VEHICLE.wheels} == {0.3}
    values = {"tilt_right": ca.SX(0.1), "tilt_left": zero, "steer": ca.SX(0.2)}
    right, _, front = VEHICLE.carriers(rest, values)
    assert numbers(right.rotation)[0, 2] > 0  # a positive tilt leans the top of the wheel along x
    assert_allclose(numbers(front.rotation)[:2, 1], [-np.sin(0.2), np.cos(0.2)])  # to the left


def test_only_vehicles_with_enough_freedom_can_be_made_to_roll():
    with pytest.raises(sf.ModelError, match=r"expected 5 passive joints and free .*, found 2"):
        sf.direct_kinematics(
            four_wheels(rock=True), sf.Analytic(lambda x, _: 0 * x), slip=sf.Rolling()
        )
    assert not has_exact_closure(four_wheels(rock=False))
    assert has_exact_closure(four_wheels(rock=True))


def test_a_sliding_joint_moves_its_part_along_its_axis():
    axle = sf.Joint("axle", "platform", "x", (0.1, 0.2, 0.3), "reach", "slide")
    assert_allclose(numbers(axle.pose({"reach": ca.SX(0.5)}).origin).ravel(), [0.6, 0.2, 0.3])
    vehicle = replace(
        VEHICLE, joints=(replace(VEHICLE.joints[0], motion="slide"), *VEHICLE.joints[1:])
    )
    assert vehicle.unit("tilt_right") == "m"
    assert vehicle.unit("steer") == "rad"


def changed(**parts):
    return lambda: replace(VEHICLE, **parts)


def with_joint(k, **parts):
    def build():
        joints = list(VEHICLE.joints)
        joints[k] = replace(joints[k], **parts)
        return replace(VEHICLE, joints=tuple(joints))

    return build


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: three_wheeler(r1=-0.1), "r1: expected a number >= 0, found -0.1"),
        (lambda: three_wheeler(r1=0.0, r2=0.0), "r1, r2: expected a positive radius"),
        (lambda: three_wheeler(wheelbase=0.0), "wheelbase: expected a number > 0, found 0.0"),
        (lambda: three_wheeler(tilt_stop=-0.1), "tilt_stop: expected a number > 0, found -0.1"),
        (changed(wheels=()), "expected 1 to 100 wheels, found 0; add"),
        (
            changed(wheels=tuple(replace(VEHICLE.wheels[0], name=f"w{k}") for k in range(101))),
            "expected 1 to 100 wheels, found 101; remove",
        ),
        (changed(joints=VEHICLE.joints[::-1][:1] * 2), "'fork': name: expected a unique"),
        (with_joint(0, parent="fork"), "right_hub': parent: expected one of platform, found"),
        (with_joint(0, at=(0, 0, np.nan)), "right_hub': at[2]: expected a number, found float nan"),
        (with_joint(0, turned=(0, 0)), "joint 'right_hub': turned: expected 3 numbers"),
        (with_joint(0, value="a b"), "joint 'right_hub': formula 'a b'"),
        (
            lambda: replace(VEHICLE.wheels[0], axle=(0, 0, 0)),
            "wheel 'right': axle: expected 'x', 'y', 'z'",
        ),
        (
            lambda: replace(VEHICLE.wheels[0], name="a b"),
            "wheel 'a b': expected a name of letters, digits, _ and -",
        ),
    ],
)
def test_faults_are_named(build, words):
    with pytest.raises(sf.ModelError, match=re.escape(words)):
        build()


def test_an_axle_may_point_anywhere():
    for axle in ((1, 0, 0), (-1, 0, 0), (0.3, 0.4, -0.5)):
        wheel = sf.Wheel("wheel", "platform", (1.0, 2.0, 3.0), Disc(0.2), driven=True, axle=axle)
        rotation = numbers(wheel.mount.rotation)
        assert_allclose(rotation[:, 0], np.array(axle) / np.linalg.norm(axle), atol=1e-15)
        assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-15)
        assert np.linalg.det(rotation) == pytest.approx(1)
        assert_allclose(numbers(wheel.mount.origin).ravel(), [1, 2, 3])


def test_a_joint_follows_a_formula_of_coordinates():
    """A differential and a camera mast: two parts by one coordinate, one by two."""
    mirror = sf.Joint("mirror", "platform", "x", (0, 0, 0), "-0.5*steer + tilt_left")
    values = {"steer": ca.SX(0.3), "tilt_left": ca.SX(0.1), "tilt_right": ca.SX(0)}
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    parts = replace(VEHICLE, joints=(*VEHICLE.joints, mirror)).parts(rest, values)
    expected = Rotation.from_euler("x", -0.05).as_matrix()
    assert_allclose(numbers(parts["mirror"].rotation), expected, atol=1e-15)


def omni_cart():
    """Three wheels at 120 degrees, each driven along the rim of the platform."""
    section, wheels = Omni(Torus(0.02, 0.08)), []
    for k in range(3):
        axle = (np.cos(2 * np.pi * k / 3), np.sin(2 * np.pi * k / 3), 0.0)
        at = tuple(0.4 * each for each in axle)
        wheels.append(sf.Wheel(f"w{k}", "platform", at, section, driven=True, mass=1.0, axle=axle))
    return sf.Vehicle("omni_cart", (), (), tuple(wheels), sf.Body(10.0))


def test_rollers_bear_no_force_across_them_on_a_side_slope():
    """Across a slope only the wheel whose rim points downhill can hold, as much as friction."""
    slope = 0.05
    ground = sf.Analytic(lambda x, _: slope * x, mu=0.5)
    dae = sf.quasi_statics(omni_cart(), ground)
    start = sf.settle(dae)
    weight = 13 * 9.81 * np.sin(np.arctan(slope))
    assert_allclose(start["force_across"], 0, atol=1e-12)
    uphill = -start["force_along"][-1] @ np.sin(2 * np.pi * np.arange(3) / 3)
    assert uphill == pytest.approx(weight, rel=1e-6)


def test_rollers_are_refused_where_they_are_not_modelled():
    flat = sf.Analytic(lambda x, _: 0 * x)
    with pytest.raises(sf.ModelError, match="'omni_cart': expected wheels without rollers"):
        sf.direct_kinematics(omni_cart(), flat, slip=sf.Rolling())
    with pytest.raises(sf.ModelError, match="Montana's form: expected wheels without rollers"):
        sf.montana_kinematics(omni_cart(), flat)


@pytest.mark.parametrize("name", ["friction_needed", "time"])
def test_coordinates_that_results_could_not_tell_apart_are_refused(name):
    joints = (*VEHICLE.joints[:2], replace(VEHICLE.joints[2], value=name))
    coordinates = (*VEHICLE.coordinates[:2], replace(VEHICLE.coordinates[2], name=name))
    vehicle = replace(VEHICLE, coordinates=coordinates, joints=joints)
    with pytest.raises(sf.ModelError, match=r"rename a coordinate"):
        sf.settle(sf.direct_kinematics(vehicle, sf.Analytic(lambda x, _: 0 * x, mu=0.5)))
