"""Tests of vehicle files that change a URDF: joints, springs, masses, drives, forward axis."""

from __future__ import annotations

import numpy as np
import pytest

from helpers.commands import invoke
from helpers.urdf import FOUR, ROUND, joint, link, wheel, written
from slipfree import Motor
from slipfree.contact.closure import has_exact_closure
from slipfree.problem.build_vehicle import VehicleError, read_vehicle

FRONT = 'carries = ["front_left_joint", "front_right_joint"]'
PIVOT = f'axle = {{ kind = "suspension", axis = [1, 0, 0], at = [0.2, 0, 0.05], {FRONT} }}'


def test_a_new_joint_carries_joints_of_the_urdf(tmp_path):
    """A rigid four-wheeler gets a front axle that rolls, so that all wheels can touch."""
    rigid = read_vehicle(written(tmp_path, FOUR))
    given = PIVOT.replace("}", ", stiffness = 30, lower = -0.3, upper = 0.3 }")
    vehicle = read_vehicle(written(tmp_path, FOUR, f"joints.{given}"))
    assert not has_exact_closure(rigid)
    assert has_exact_closure(vehicle)
    (axle,) = vehicle.coordinates
    assert (axle.name, axle.kind, axle.stiffness) == ("axle", "suspension", 30.0)
    assert (axle.lower, axle.upper) == (-0.3, 0.3)
    (pivot,) = vehicle.joints
    assert (pivot.at, pivot.axis) == ((0.0, 0.2, 0.05), (0.0, 1.0, 0.0))  # y is forward
    for wheels in zip(vehicle.wheels, rigid.wheels, strict=True):
        now, then = wheels
        at = np.add(now.at, pivot.at) if now.parent == "axle" else now.at
        assert np.allclose(at, then.at, atol=1e-15)
    assert [each.parent for each in vehicle.wheels] == ["axle", "axle", "platform", "platform"]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (PIVOT.replace("axle =", "base ="), "expected a new name for a joint with 'carries'"),
        (PIVOT.replace("axis = [1, 0, 0], ", ""), "expected an axis of the new joint, found none"),
        (PIVOT.replace("right_joint", "joint"), "found 'front_joint'; correct the names"),
        (PIVOT.replace('"front_left_joint"', '"hub_joint"'), "expected joints with the same paren"),
        (PIVOT + "\njoints.b" + PIVOT, "expected joints that no other new joint carries"),
        ('axle = { kind = "suspension", axis = [1, 0, 0] }', "found the unknown key 'axle'"),
    ],
)
def test_errors_of_new_joints(given, words, tmp_path):
    arm = link("wheel_arm") + joint("arm", "fixed", "base", "wheel_arm")
    parts = FOUR + arm + wheel("hub", "0 0 0", parent="wheel_arm")
    with pytest.raises(VehicleError) as found:
        read_vehicle(written(tmp_path, parts, f"joints.{given}"))
    assert words in str(found.value)
    assert "robot.toml:" in str(found.value)


@pytest.mark.parametrize("motion", ["turn", "slide"])
def test_a_fixed_joint_without_an_axis_is_released(motion, tmp_path):
    arm = link("arm") + '<joint name="hip" type="fixed"><parent link="base"/><child link="arm"/>'
    parts = FOUR.replace('<parent link="base"/><child link="rear_left"/>', "{}", 1)
    parts = parts.format('<parent link="arm"/><child link="rear_left"/>')
    role = f'joints.hip = {{ kind = "suspension", axis = [0, 0, 1], motion = "{motion}" }}'
    vehicle = read_vehicle(written(tmp_path, f"{parts}{arm}</joint>", role))
    (hip,) = vehicle.joints
    assert (hip.motion, hip.axis, hip.value) == (motion, (0.0, 0.0, 1.0), "hip")
    assert any("of type fixed in the URDF" in note for note in vehicle.notes)


INERTIAL = (
    '<inertial><origin xyz="0.1 0 0" rpy="0 0 1.5707963267948966"/><mass value="4"/>'
    '<inertia ixx="0.1" iyy="0.2" izz="0.25" ixy="0.01" ixz="0" iyz="0"/></inertial>'
)


def test_moments_of_inertia_are_those_of_the_urdf_in_axes_of_the_vehicle(tmp_path):
    """The inertial's x axis points to the link's y, and the link's y to the vehicle's -x."""
    base = link("base").replace('<inertial><mass value="1"/></inertial>', INERTIAL)
    file = written(tmp_path, FOUR)
    file.write_text(file.read_text().replace(link("base"), base))
    body = read_vehicle(file).body
    assert body.at == (0.0, 0.1, 0.0)
    assert np.allclose(body.inertia, [0.1, 0.2, 0.25, 0.01, 0, 0])
    spun = INERTIAL.replace('rpy="0 0 1.5707963267948966"', "")
    file.write_text(file.read_text().replace(INERTIAL, spun))
    assert np.allclose(read_vehicle(file).body.inertia, [0.2, 0.1, 0.25, -0.01, 0, 0])
    file.write_text(file.read_text().replace('izz="0.25"', 'izz="2.5"'))
    found = read_vehicle(file)  # no body has a moment that exceeds the sum of the others
    assert found.body.inertia is None
    assert any("moments of inertia of a box" in note for note in found.notes)


def test_a_wheel_has_the_moments_of_its_link_about_and_across_the_axle(tmp_path):
    inertial = '<inertial><mass value="2"/><inertia ixx="0.03" iyy="0.05" izz="0.034"/></inertial>'
    text = FOUR.replace('<inertial><mass value="1"/></inertial>', inertial)
    for each in read_vehicle(written(tmp_path, text)).wheels:
        assert each.mass == 2
        assert np.allclose(each.inertia, [0.05, 0.032])


def test_masses_and_drives_of_the_vehicle_file_override_those_of_the_urdf(tmp_path):
    more = (
        "links.base = { mass = 20, center_of_mass = [0.1, 0.02, 0.3], "
        "inertia = [1, 2, 2.5, 0.1, 0, 0] }\n"
        "wheels.front_left_joint = { mass = 3, inertia = [0.02, 0.01], static_depth = 0.004, "
        'drive = { kind = "motor", stall = 5, no_load = 20, kp = 2 } }'
    )
    vehicle = read_vehicle(written(tmp_path, FOUR, more))
    assert (vehicle.body.mass, vehicle.body.at) == (20, (-0.02, 0.1, 0.3))
    assert np.allclose(vehicle.body.inertia, [2, 1, 2.5, -0.1, 0, 0])
    first, second = vehicle.wheels[:2]
    assert (first.mass, first.inertia, first.static_depth) == (3, (0.02, 0.01), 0.004)
    assert first.drive == Motor(5, 20, 2)
    assert (second.mass, second.static_depth) == (1, None)
    with pytest.raises(VehicleError, match=r"robot.toml:2: links.bas: did you mean 'base'"):
        read_vehicle(written(tmp_path, FOUR, "links.bas = { mass = 20 }"))


SIDEWAYS = ROUND.format(0.1).replace("1.5707963267948966 0 0", "0 1.5707963267948966 0")


@pytest.mark.parametrize(("axis", "forward"), [("1 0 0", "-y"), ("-1 0 0", "y")])
def test_axles_along_x_tell_that_y_is_forward(axis, forward, tmp_path):
    """Positive rates of the joints roll the wheels forward."""
    parts = "".join(
        link(f"w{k}", SIDEWAYS) + joint(f"j{k}", "continuous", "base", f"w{k}", at, axis=axis)
        for k, at in enumerate(("0.2 0 0", "-0.2 0 0", "0 0.3 0"))
    )
    file = written(tmp_path, parts)
    vehicle = read_vehicle(file)
    (note,) = [note for note in vehicle.notes if "guessed forward" in note]
    assert note.startswith(f"guessed forward along {forward}: signs of the wheels' axes")
    assert not any("opposite to the sign" in note for note in vehicle.notes)
    out = tmp_path / "full.toml"
    invoke("vehicle", file, "--write", out, code=0)
    assert f'forward = "{forward}"' in out.read_text()
    assert read_vehicle(out).wheels == vehicle.wheels


def test_xacro_below_no_wheel_is_left_out_with_its_links(tmp_path):
    camera = link("camera").replace('value="1"', 'value="${m}"')
    lens = link("lens") + joint("lens_joint", "fixed", "camera", "lens")
    parts = FOUR + camera + joint("mount", "fixed", "base", "camera") + lens
    vehicle = read_vehicle(written(tmp_path, parts))
    assert vehicle.mass == pytest.approx(5)
    assert any("xacro that is not expanded: camera, lens" in note for note in vehicle.notes)
    spun = camera + joint("mount", "continuous", "base", "camera")
    for wrong in (FOUR.replace('value="1"', 'value="${m}"', 1), FOUR + spun):
        with pytest.raises(VehicleError, match="which may belong to the drive train; xacro is"):
            read_vehicle(written(tmp_path, wrong))
