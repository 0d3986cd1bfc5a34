"""Tests of the shapes of bodies from the collision geometry of URDFs."""

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from helpers.urdf import FOUR, joint, link, wheel, written
from slipfree import Analytic, direct_kinematics, settle
from slipfree.files.urdf.collisions import reduced_hull
from slipfree.problem.build_vehicle import read_vehicle
from slipfree.vehicle.shapes import Ball, Box, Hull

pytestmark = pytest.mark.usefixtures("direct_reads")
FLAT = Analytic(lambda x, _: 0 * x)


def collision(shape, at="0 0 0", rpy="0 0 0"):
    return f'<collision><origin xyz="{at}" rpy="{rpy}"/><geometry>{shape}</geometry></collision>'


def on_base(folder, *shapes, parts="", **options):
    """Read a cart of four wheels of radius 0.1 m, whose link ``deck`` has collision shapes."""
    deck = link("deck", "".join(shapes)) + joint("deck_joint", "fixed", "base", "deck", "0 0 0.1")
    return read_vehicle(written(folder, FOUR + deck + parts, **options))


def clearance(vehicle):
    return settle(direct_kinematics(vehicle, FLAT))["clearance_body"][0]


@pytest.mark.parametrize(
    ("shape", "kind", "expected"),
    [
        ('<box size="0.4 0.2 0.1"/>', Box, 0.2 - 0.05),
        ('<sphere radius="0.08"/>', Ball, 0.2 - 0.08),
        ('<cylinder radius="0.1" length="0.06"/>', Hull, 0.2 - 0.03),
    ],
)
def test_the_clearance_is_that_of_the_drawing(shape, kind, expected, tmp_path):
    """The deck is 0.2 m above the ground; wheels' own shapes touch it and do not count."""
    vehicle = on_base(tmp_path, collision(shape))
    ((name, found),) = vehicle.shapes
    assert (name, type(found)) == ("deck_joint", kind)
    assert_allclose(clearance(vehicle), expected, atol=5e-3)  # wheels press in by 2 mm


@pytest.mark.parametrize("pitch", [0.0, np.pi / 2])
def test_a_capsule_has_round_ends(pitch, tmp_path):
    """Its length is that between the centres of its ends."""
    shape = '<capsule radius="0.03" length="0.1"/>'
    vehicle = on_base(tmp_path, collision(shape, rpy=f"0 {pitch!r} 0"))
    length = 0.1 / 2 if pitch == 0 else 0.0
    assert [type(found) for _, found in vehicle.shapes] == [Ball, Ball, Hull]
    assert_allclose(clearance(vehicle), 0.2 - 0.03 - length, atol=5e-3)


def test_origins_and_moving_joints_place_the_shapes(tmp_path):
    """A box on an arm: its centre is where the frames of the URDF say."""
    box = collision('<box size="0.2 0.1 0.05"/>', "0.1 0.02 0.3", "0 0 1.5707963267948966")
    arm = link("arm", box) + joint("arm_joint", "revolute", "base", "arm", "0.05 0.1 0.2", "0 1 0")
    vehicle = on_base(tmp_path, parts=arm)
    ((name, found),) = vehicle.shapes
    assert name == "arm_joint"
    assert_allclose(found.at, (-0.02, 0.1, 0.3), atol=1e-12)  # x right, y forward
    assert_allclose(clearance(vehicle), 0.1 + 0.2 + 0.3 - 0.025, atol=5e-3)


def test_shapes_on_the_ground_of_the_wheels_are_left_out_and_noted(tmp_path):
    whole = collision('<box size="0.6 0.4 0.4"/>')
    vehicle = on_base(tmp_path, whole)
    assert not vehicle.shapes
    assert any("left out of the clearance" in note and "deck" in note for note in vehicle.notes)


def test_a_caster_ball_is_a_wheel_and_no_body(tmp_path):
    ball = collision('<sphere radius="0.1"/>', "-0.3 0 0")
    two = wheel("left_wheel", "0 0.15 0") + wheel("right_wheel", "0 -0.15 0")
    parts = two + link("plate", ball) + joint("plate_joint", "fixed", "base", "plate")
    vehicle = read_vehicle(written(tmp_path, parts))
    assert len(vehicle.wheels) == 3
    assert not vehicle.shapes
    assert not any("left out" in note for note in vehicle.notes)


def test_a_mesh_becomes_few_points_of_its_hull(tmp_path):
    """The lowest point of an ellipsoid is kept to a millimetre; a missing mesh is noted."""
    ball = trimesh.creation.icosphere(3, 1.0)
    ball.apply_scale((0.2, 0.1, 0.05))
    ball.export(tmp_path / "deck.stl")
    vehicle = on_base(tmp_path, collision('<mesh filename="deck.stl"/>'))
    ((_, hull),) = vehicle.shapes
    assert len(hull.points) < 100
    assert_allclose(clearance(vehicle), 0.2 - 0.05, atol=5e-3)
    assert any("as points of hulls: deck (" in note for note in vehicle.notes)
    missing = on_base(tmp_path, collision('<mesh filename="none.stl"/>'))
    assert not missing.shapes
    assert any(note.startswith("clearance without deck: expected") for note in missing.notes)


def test_the_stated_shrinkage_of_a_hull_is_an_upper_bound(rng):
    """No direction has a support that shrinks by more; a box keeps its corners exactly."""
    points = rng.normal(size=(4000, 3))
    points *= [[0.3, 0.2, 0.1]] / np.linalg.norm(points, axis=1, keepdims=True)  # an ellipsoid
    corners, shrink = reduced_hull(points)
    assert len(corners) <= 32
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lost = (points @ directions.T).max(axis=0) - (corners @ directions.T).max(axis=0)
    assert 0.3 * shrink < lost.max() <= shrink + 1e-9
    box = np.array([(x, y, z) for x in (0, 1) for y in (0, 2) for z in (0, 3)])
    inside = rng.uniform((0, 0, 0), (1, 2, 3), (50, 3))
    corners, shrink = reduced_hull(np.vstack([box, inside]))
    assert len(corners) == 8
    assert shrink < 1e-9
