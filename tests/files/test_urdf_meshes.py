"""Tests of shapes in URDFs: wheels from the points of meshes, bodies from collision geometry."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from helpers.commands import error_of, invoke
from helpers.urdf import FOUR, WHEEL, joint, link, offered, wheel, written
from slipfree import Analytic, direct_kinematics, settle
from slipfree.core.errors import DataError
from slipfree.files.urdf.meshes import reduced_hull
from slipfree.problem.build_vehicle import VehicleError, read_vehicle
from slipfree.vehicle.sections import Disc, Sphere, Torus
from slipfree.vehicle.shapes import Ball, Box, Hull

pytestmark = pytest.mark.usefixtures("direct_reads")

TURN = 'rpy="1.5707963267948966 0 0"'  # from the z axis of a mesh to an axle to the left
TYRE = trimesh.creation.torus(0.25, 0.05, major_sections=64, minor_sections=32)
PLATE = trimesh.creation.cylinder(0.1, 0.04, sections=48)


def mesh(name, origin=TURN, scale="1 1 1"):
    return (
        f'<visual><origin {origin}/><geometry><mesh filename="{name}" scale="{scale}"/>'
        "</geometry></visual>"
    )


def tricycle(shape, **more):
    places = ("0.4 0.3 0", "0.4 -0.3 0", "-0.4 0 0")
    return "".join(wheel(f"part_{k}", at, shape, **more) for k, at in enumerate(places))


@pytest.mark.parametrize(
    ("made", "name", "scale", "section"),
    [
        (TYRE, "tyre.obj", "0.5 0.5 0.5", Torus(0.025, 0.125)),
        (TYRE, "tyre.dae", "1 1 1", Torus(0.05, 0.25)),
        (TYRE, "tyre.glb", "1 1 1", Torus(0.05, 0.25)),
        (PLATE, "plate.stl", "1 1 2", Disc(0.1)),
        (trimesh.creation.icosphere(4, 0.2), "ball.stl", "1 1 1", Sphere(0.2)),
    ],
)
def test_a_mesh_has_the_radius_and_tube_of_its_body(made, name, scale, section, tmp_path):
    (tmp_path / name).write_bytes(exported(made, name))
    vehicle = read_vehicle(written(tmp_path, tricycle(mesh(name, scale=scale))))
    for each in vehicle.wheels:
        assert type(each.section) is type(section)
        assert np.allclose(radii(each.section), radii(section), rtol=1e-3)
        assert each.driven
    assert any("a wheel: a round mesh" in note for note in vehicle.notes)


def exported(made, name):
    data = made.export(file_type=Path(name).suffix[1:])
    return data.encode() if isinstance(data, str) else data


def radii(section):
    return list(vars(section).values())


def test_the_unit_of_a_collada_file_counts(tmp_path):
    large = trimesh.creation.torus(250, 50, major_sections=64, minor_sections=32)
    text = exported(large, "tyre.dae").replace(
        b"<up_axis>", b'<unit name="millimeter" meter="0.001"/><up_axis>'
    )
    (tmp_path / "tyre.dae").write_bytes(text)
    vehicle = read_vehicle(written(tmp_path, tricycle(mesh("tyre.dae"))))
    assert vehicle.wheels[0].radius == pytest.approx(0.3, rel=1e-3)


def test_the_wheel_is_in_the_middle_of_the_tread(tmp_path):
    (tmp_path / "plate.stl").write_bytes(exported(PLATE, "plate.stl"))
    shape = mesh("plate.stl", f'{TURN} xyz="0 0.07 0"')
    wheels = read_vehicle(written(tmp_path, tricycle(shape))).wheels
    at = np.array([each.at for each in wheels])  # x right, y forward
    assert np.allclose(at, [[-0.37, 0.4, 0], [0.23, 0.4, 0], [-0.07, -0.4, 0]], atol=1e-6)


def test_a_package_is_found_in_a_folder_above(tmp_path, monkeypatch):
    urdf = tmp_path / "robots" / "my_robot" / "urdf"
    urdf.mkdir(parents=True)
    (urdf.parent / "meshes").mkdir()
    (urdf.parent / "meshes" / "plate.stl").write_bytes(exported(PLATE, "plate.stl"))
    inside = written(urdf, tricycle(mesh("package://my_robot/meshes/plate.stl")))
    assert read_vehicle(inside).wheels[0].radius == pytest.approx(0.1)
    (tmp_path / "else").mkdir()
    outside = written(tmp_path / "else", tricycle(mesh("package://my_robot/meshes/plate.stl")))
    with pytest.raises(VehicleError, match=r"no such file; put its package into .* or a folder"):
        read_vehicle(outside)
    (urdf / "package.xml").write_text("<package><name>other</name></package>")
    (urdf / "meshes").symlink_to(urdf.parent / "meshes")
    named = written(urdf, tricycle(mesh("package://other/meshes/plate.stl")))
    assert read_vehicle(named).wheels[0].radius == pytest.approx(0.1)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "robots"))
    assert read_vehicle(outside).wheels[0].radius == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("wheel.stl", b"junk", "finite coordinates, found none in 'wheel.stl'"),
        ("wheel.dae", b"junk", "expected a readable mesh, found 'wheel.dae'"),
        ("wheel.stl", b"version https://git-lfs.github.com/spec/v1", "fetch it: git lfs pull"),
        ("wheel.step", b"junk", "expected a mesh in .stl, .dae, .obj, .ply, .glb, found"),
        ("wheel.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "expected a mesh that is round"),
        (
            "wheel.stl",
            exported(trimesh.creation.box((0.1, 0.2, 0.3)), "wheel.stl"),
            "expected a mesh that is round about the axis of its joint, found 'wheel.stl'",
        ),
        ("wheel.obj", b"v 0 0 1e200\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "from -1e+06 to 1e+06 m"),
        (
            "wheel.stl",
            exported(trimesh.creation.cylinder(200, 50), "wheel.stl"),
            "found 'wheel.stl' with points 200 m from the axis of its joint; is it in millimetres?",
        ),
    ],
)
def test_a_mesh_that_is_no_wheel_is_named(name, data, words, tmp_path):
    (tmp_path / name).write_bytes(data)
    parts = tricycle(mesh(name)).replace("part_", "wheel_")
    found = error_of(VehicleError, read_vehicle, written(tmp_path, parts))
    assert words in str(found)
    (line,) = offered(str(found))
    assert len(read_vehicle(written(tmp_path, parts, line)).wheels) == 3
    given = read_vehicle(written(tmp_path, parts, "radius = 0.12"))
    assert [each.radius for each in given.wheels] == [0.12] * 3


@pytest.mark.parametrize(
    ("unit", "scale", "words"),
    [
        (1e3, "1 1 1", 'is it in millimetres? write scale="0.001 0.001 0.001"'),
        (1 / 0.0254, "1 1 1", 'is it in inches? write scale="0.0254 0.0254 0.0254"'),
        (1.0, "10 10 10", "correct its scale"),
        (1.0, "0.001 0.001 0.001", 'write scale="1 1 1"'),
    ],
)
def test_wheels_that_do_not_suit_their_distances_are_refused(unit, scale, words, tmp_path):
    made = trimesh.creation.cylinder(0.033 * unit, 0.02 * unit, sections=48)
    (tmp_path / "wheel.stl").write_bytes(exported(made, "wheel.stl"))
    parts = FOUR.replace(WHEEL, mesh("wheel.stl", scale=scale))
    found = error_of(VehicleError, read_vehicle, written(tmp_path, parts))
    assert "suits the distances between the wheels, found a radius of" in str(found)
    assert "in link 'front_left'; mesh 'wheel.stl': " in str(found)
    assert words in str(found)
    (line,) = offered(str(found))
    given = read_vehicle(written(tmp_path, parts, line))
    if "correct its scale" not in words:
        assert [each.radius for each in given.wheels] == [0.033] * 4


@pytest.mark.parametrize(
    ("name", "scale", "radius"),
    [
        ("meshes/Plate A.STL", "1 1 1", 0.1),
        ("meshes\\Plate A.STL", "0.5", 0.05),
        ("file://meshes/Plate%20A.STL", "0.5, 0.5, 0.5", 0.05),
        ("{folder}/meshes/Plate A.STL", "1 1 1 1", 0.1),
        ("model://robot/meshes/Plate A.STL", "1 1 1", 0.1),
    ],
)
def test_names_and_scales_of_meshes(name, scale, radius, tmp_path):
    folder = tmp_path / "robot"
    (folder / "meshes").mkdir(parents=True)
    (folder / "meshes" / "Plate A.STL").write_bytes(exported(PLATE, "plate.stl"))
    shape = mesh(name.format(folder=folder), scale=scale)
    vehicle = read_vehicle(written(folder, tricycle(shape)))
    assert vehicle.wheels[0].radius == pytest.approx(radius)


@pytest.mark.parametrize(
    ("name", "scale", "words"),
    [
        ("http://a.org/plate.stl", "1 1 1", "a local file, found 'http://a.org/plate.stl'; downl"),
        ("package://robot/plate.stl", "1 1 1", "no such file; put its package"),
        ("plate.stl", "0", "expected factors other than zero in 'scale', found '0'"),
        ("plate.stl", "1 1", "expected three numbers in 'scale', found '1 1'"),
        ("plate.stl", "1 nan 1", "expected three numbers in 'scale', found '1 nan 1'"),
    ],
)
def test_wrong_names_and_scales_of_meshes_are_refused(name, scale, words, tmp_path):
    (tmp_path / "plate.stl").write_bytes(exported(PLATE, "plate.stl"))
    parts = tricycle(mesh(name, scale=scale)).replace("part_", "wheel_")
    assert words in str(error_of((VehicleError, DataError), read_vehicle, written(tmp_path, parts)))


@pytest.mark.bounded
def test_the_written_completion_has_radius_and_tube_of_the_meshes(tmp_path):
    (tmp_path / "tyre.stl").write_bytes(exported(TYRE, "tyre.stl"))
    file = written(tmp_path, tricycle(mesh("tyre.stl", f'{TURN} xyz="0 0.03 0"')))
    out = tmp_path / "full.toml"
    invoke("vehicle", file, "--write", out, code=0)
    assert read_vehicle(out).wheels == read_vehicle(file).wheels
    assert "radius = 0.3" in out.read_text()


# The shapes of bodies from the collision geometry of URDFs

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
