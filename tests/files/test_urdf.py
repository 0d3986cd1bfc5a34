"""Tests of URDF files: equal vehicles in other programs, refusals, and files that change them."""

import io
import re
import tomllib

import casadi as ca
import numpy as np
import pytest
import yourdfpy
from numpy.testing import assert_allclose

from helpers.cases import DATA
from helpers.commands import error_of, invoke, refuses
from helpers.urdf import FOUR, ROUND, adam_model, joint, link, wheel, written
from slipfree import DataError, Motor
from slipfree.contact.closure import has_exact_closure
from slipfree.files.urdf.elements import read_tree
from slipfree.files.urdf.links import Robot, link_poses
from slipfree.geometry.frame import Pose
from slipfree.problem.build_vehicle import VehicleError, read_vehicle
from slipfree.vehicle.sections import Omni, Torus
from slipfree.vehicle.tree import Torque

RIGHT_FORWARD = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # from x forward, y left
FILES = {
    "cart": {"caster": "caster"},
    "bogie": {
        "rocker_left": "rocker-left",
        "bogie_left": "bogie_left",
        "bogie_right": "bogie_right",
        "steer_left": "steer_left",
        "steer_right": "steer_right",
    },
}
MIMICS = {"bogie": {"rocker_right": ("rocker-left", -1.0)}}
LINK_OF = re.compile(r'<joint name="([^"]+)".*?<child link="([^"]+)"', re.DOTALL)


def ours(vehicle, values, rates):
    """Return pose, velocity and angular velocity of every part, in axes x forward, y left."""
    names = list(values)
    q, dq = ca.SX.sym("q", len(names)), ca.SX.sym("dq", len(names))
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    parts = vehicle.parts(rest, dict(zip(names, ca.vertsplit(q), strict=True)))
    wheels = {w.name: parts[w.parent] @ w.mount for w in vehicle.wheels}
    found = {}
    for name, pose in (parts | wheels).items():
        twist = pose.twist(q, dq)
        f = ca.Function("f", [q, dq], [pose.rotation, pose.origin, twist.v, twist.omega])
        now = f(ca.DM(list(values.values())), ca.DM(list(rates.values())))
        rotation, *vectors = (np.array(out) for out in now)
        turned = RIGHT_FORWARD.T @ rotation @ RIGHT_FORWARD
        found[name] = turned, *(RIGHT_FORWARD.T @ vector.ravel() for vector in vectors)
    return found


def by_joint(name, values):
    """Return values of coordinates as those of the joints of the URDF, mimics last."""
    given = {FILES[name][key]: value for key, value in values.items()}
    mimics = [factor * given[leader] for leader, factor in MIMICS.get(name, {}).values()]
    return np.array([*given.values(), *mimics])


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_poses_and_jacobians_are_those_of_adam(name, rng):
    text = (DATA / f"{name}.urdf").read_text()
    vehicle, links = read_vehicle(DATA / f"{name}.toml"), dict(LINK_OF.findall(text))
    joints = [*FILES[name].values(), *MIMICS.get(name, {})]
    oracle = adam_model((DATA / f"{name}.urdf").read_text(), joints)
    assert sorted(c.name for c in vehicle.coordinates) == sorted(FILES[name])
    for _ in range(10):
        values, rates = (
            dict(zip(FILES[name], rng.uniform(-0.8, 0.8, len(FILES[name])), strict=True))
            for _ in range(2)
        )
        q, dq = by_joint(name, values), by_joint(name, rates)
        for part, (rotation, origin, v, omega) in ours(vehicle, values, rates).items():
            if part == "platform":
                continue
            pose = oracle.forward_kinematics(links[part], np.eye(4), q)
            assert_allclose(origin, pose[:3, 3], atol=1e-12)
            if part in {joint.name for joint in vehicle.joints}:
                assert_allclose(rotation, pose[:3, :3], atol=1e-12)
            twist = oracle.jacobian(links[part], np.eye(4), q)[:, 6:] @ dq
            assert_allclose(v, twist[:3], atol=1e-12)
            assert_allclose(omega, twist[3:], atol=1e-12)


@pytest.mark.parametrize("name", FILES)
def test_centres_of_mass_are_those_of_adam(name, rng):
    vehicle = read_vehicle(DATA / f"{name}.toml")
    joints = [*FILES[name].values(), *MIMICS.get(name, {})]
    oracle = adam_model((DATA / f"{name}.urdf").read_text(), joints)
    values = dict(zip(FILES[name], rng.uniform(-0.8, 0.8, len(FILES[name])), strict=True))
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    masses = vehicle.masses(rest, {key: ca.SX(value) for key, value in values.items()})
    moments = [np.array([1, *np.array(ca.evalf(place)).ravel()]) * m for _, m, place in masses]
    mass, *moment = np.sum(moments, axis=0)
    assert_allclose(mass, oracle.get_total_mass(), rtol=1e-12)
    center = oracle.CoM_position(np.eye(4), by_joint(name, values))
    assert_allclose(RIGHT_FORWARD.T @ moment / mass, center, atol=1e-12)


def changed(folder, name, *changes, roles=None):
    """Return a vehicle file whose URDF, or whose own text, is changed."""
    text = (DATA / f"{name}.urdf").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    (folder / f"{name}.urdf").write_text(text)
    file = folder / f"{name}.toml"
    file.write_text((DATA / f"{name}.toml").read_text() if roles is None else roles)
    return file


def faults(path):
    caught = error_of(VehicleError, read_vehicle, path)
    return str(caught).replace(f"{path.parent}/", "")


CASTER = '<joint name="caster" type="continuous">'
REVOLUTE = '<joint name="caster" type="revolute"><limit lower="{}" upper="{}"/>'

WRONG = tomllib.loads((DATA / "wrong_urdfs.toml").read_text())["wrong"]


@pytest.mark.parametrize(("old", "new", "words"), WRONG)
def test_what_is_wrong_is_named(old, new, words, tmp_path):
    assert words in faults(changed(tmp_path, "cart", (old, new)))


FREE = "wheels = { caster_axle = { driven = false } }"
ROLES_REFUSED = [
    ('joints = { caster = "free" }', "cart.toml:2: joints.caster.kind: expected 'commanded',"),
    ("tube = 1.0", "expected a tube of at most the radius, 0.15 m,"),
    (f'joints.caster = {{ kind = "commanded", stiffness = 3 }}\n{FREE}', "cannot have a spring"),
    ('joints = { caster = "passive", bracket = "suspension" }', 'in { kind = "suspension", axis ='),
    ("wheels = { caster = { radius = 0.1 } }", "joints below it, found 'caster_axle'; make it"),
    ("wheels = { caster = { radius = 0.1 } }", "'caster_axle': expected the parent of a wheel to"),
    ('joints.caster = "passive"\nwheels.caster = {}', "a joint that is not a wheel, found"),
]


@pytest.mark.parametrize(
    ("roles", "words"),
    [
        *((f'urdf = "cart.urdf"\n{keys}', words) for keys, words in ROLES_REFUSED),
        (r'urdf = "a\u0000b.urdf"', "(urdf of cart.toml), found that it cannot be read (embedded"),
        ('urdf = "cat.urdf"', "cat.urdf: expected a URDF (urdf of cart.toml), found that it canno"),
    ],
)
def test_what_the_file_cannot_say_is_asked(roles, words, tmp_path):
    assert words in faults(changed(tmp_path, "cart", roles=roles))


def test_a_joint_has_a_drive(tmp_path):
    joint = 'joints.caster = { kind = "commanded", stiffness = 2, drive = { kind = "torque" } }'
    roles = f'urdf = "cart.urdf"\nwheels.caster_axle = {{ driven = false }}\n{joint}\n'
    (caster,) = read_vehicle(changed(tmp_path, "cart", roles=roles)).coordinates
    assert (caster.stiffness, caster.drive) == (2.0, Torque())


def test_roles_complete_and_override(tmp_path):
    roles = """urdf = "cart.urdf"
name = "my cart"
joints.caster = { kind = "passive", words = "swivel", upper = 0.5, stiffness = 2, max_rate = 3 }
[wheels]
caster_axle = { driven = false, radius = 0.12, tube = 0.03, grip = 0.5, rollers = "90 deg" }
left_drive = { driven = false }
"""
    vehicle = read_vehicle(changed(tmp_path, "cart", roles=roles))
    (caster,) = vehicle.coordinates
    assert (vehicle.name, caster.words, caster.kind) == ("my cart", "swivel", "passive")
    assert (caster.lower, caster.upper, caster.stiffness) == (-np.inf, 0.5, 2.0)
    assert caster.max_rate == 3.0
    wheels = {wheel.name: wheel for wheel in vehicle.wheels}
    axle = wheels["caster_axle"]
    assert (axle.section, axle.grip) == (Omni(Torus(0.03, 0.12 - 0.03)), 0.5)
    driven = [wheel.driven for wheel in vehicle.wheels]
    assert driven == [False, True, False]
    assert list(wheels) == ["left_drive", "right_drive", "caster_axle"]


@pytest.mark.parametrize(
    ("mimic", "words"),
    [
        ("rear_left", "expected a mimic of an independent joint, found 'rear_left', a wheel; c"),
        ("rocker", "found 'rocker', no joint of that name; correct"),
        ("rocker_right", "found 'rocker_right', a joint that follows this one; remove one"),
    ],
)
def test_mimics_that_lead_nowhere(mimic, words, tmp_path):
    old = '<mimic joint="rocker-left"'
    assert words in faults(changed(tmp_path, "bogie", (old, f'<mimic joint="{mimic}"')))


FREE_CASTER = """urdf = "cart.urdf"
joints = {{ caster = {{ kind = "passive"{} }} }}
wheels = {{ caster_axle = {{ driven = false }} }}
"""


@pytest.mark.parametrize(
    ("in_urdf", "in_roles", "stops"),
    [
        ((0, 0), ", lower = -0.5, upper = 0.5", (-0.5, 0.5)),
        ((-0.3, 0.2), "", (-0.3, 0.2)),
        ((-0.3, 0.2), ", lower = -0.5", (-0.5, 0.2)),
    ],
)
def test_limits_of_the_vehicle_file_override_those_of_the_urdf(in_urdf, in_roles, stops, tmp_path):
    change = (CASTER, REVOLUTE.format(*in_urdf))
    file = changed(tmp_path, "cart", change, roles=FREE_CASTER.format(in_roles))
    (caster,) = read_vehicle(file).coordinates
    assert (caster.lower, caster.upper) == stops


def fixed(name):
    """Return the change that makes a joint of the bogie fixed."""
    text = (DATA / "bogie.urdf").read_text()
    head, old, tail = re.search(
        rf'(<joint name="{name}" type=")(revolute|continuous)(".*?</joint>)', text, re.DOTALL
    ).groups()
    return head + old + tail, head + "fixed" + tail


def test_roles_of_fixed_joints_are_honoured(tmp_path):
    """A differential that a program fixed turns again, as the same URDF that never was."""
    free = read_vehicle(DATA / "bogie.toml")
    vehicle = read_vehicle(changed(tmp_path, "bogie", fixed("rocker-left"), fixed("rocker_right")))
    assert (vehicle.coordinates, vehicle.joints) == (free.coordinates, free.joints)
    (note,) = [note for note in vehicle.notes if note.startswith("of type fixed")]
    assert note.endswith('in "joints": rocker-left, rocker_right')


def test_a_wheel_has_the_radius_of_the_shape_that_touches_first(tmp_path):
    """Of two coaxial cylinders the larger, wherever it stands; lugs off the axis do not count."""
    rim = (
        '<collision><origin rpy="1.5707963267948966 0 0"/><geometry>'
        '<cylinder radius="{}" length="0.07"/></geometry></collision>'
    )
    lug = (
        '<collision><origin xyz="0.16 0 0"/><geometry><sphere radius="0.02"/></geometry>'
        "</collision>"
    )
    link = '<link name="left_wheel">'
    for smaller, radius in ((0.12, 0.15), (0.17, 0.17)):
        file = changed(tmp_path, "cart", (link, link + lug + rim.format(smaller)))
        vehicle = read_vehicle(file)
        assert vehicle.wheels[0].radius == radius
        (note,) = [note for note in vehicle.notes if "several shapes" in note]
        assert f"(1 sphere of 0.02 m, 1 cylinder of {smaller} m, 1 cylinder of 0.15 m)" in note
        other = f"left_drive = {{ radius = {smaller if radius == 0.15 else 0.15} }}"
        assert note.startswith(f"radius {radius} m of ")
        assert note.endswith(f"ground first: left_drive; otherwise write wheels.{other}")
    roles = (
        'urdf = "cart.urdf"\njoints = { caster = "passive" }\n[wheels]\n'
        "caster_axle.driven = false\nleft_drive.radius = 0.11\n"
    )
    vehicle = read_vehicle(changed(tmp_path, "cart", roles=roles))
    assert vehicle.wheels[0].radius == 0.11
    assert not any("several shapes" in note for note in vehicle.notes)


def test_limits_become_stops_of_the_one_that_is_mimicked_and_notes_on_wheels(tmp_path):
    (c,) = (c for c in read_vehicle(DATA / "bogie.toml").coordinates if c.name == "rocker_left")
    assert (c.kind, c.lower, c.upper, c.max_rate) == ("suspension", -0.6, 0.5, 1.0)
    file = changed(tmp_path, "cart", ("<axis", '<limit velocity="8"/><axis'))
    assert any("velocity>, 8 rad/s, unless" in note for note in read_vehicle(file).notes)


def test_mimics_of_mimics_multiply(tmp_path):
    old = '<axis xyz="0 1 0"/><limit effort="1" velocity="1"/>\n  </joint>\n  <joint name="steer'
    new = old.replace("<limit", '<mimic joint="rocker_right" multiplier="0.5" offset="0.1"/><limit')
    roles = 'urdf = "bogie.urdf"\njoints = { rocker-left = "suspension", bogie_left = "passive" }'
    vehicle = read_vehicle(changed(tmp_path, "bogie", (old, new), roles=roles))
    assert not has_exact_closure(vehicle)  # one suspension coordinate for six wheels
    values = {joint.name: joint.value for joint in vehicle.joints}
    assert values["bogie_right"] == "-0.5*rocker_left + 0.1"


def test_inertials_and_origins_may_be_missing(tmp_path):
    text = (DATA / "cart.urdf").read_text()
    bare = re.sub(r"<inertial>.*?</inertial>", "", text)
    bare = bare.replace('<origin xyz="0 0.25 0"/>', "")
    (tmp_path / "cart.urdf").write_text(bare)
    (tmp_path / "cart.toml").write_text((DATA / "cart.toml").read_text())
    vehicle = read_vehicle(tmp_path / "cart.toml")
    assert vehicle.mass == 0
    assert vehicle.wheels[0].at == (0.0, 0.0, 0.0)
    words = "without mass, since the URDF does not contain it: base_link"
    assert any(note.startswith(words) for note in vehicle.notes)


def test_many_errors_are_counted_instead_of_listed(tmp_path):
    names = [f"l{k}" for k in range(60) for _ in range(3)]
    links = "\n".join(f'<link name="{name}"/>' for name in names)
    (tmp_path / "many.urdf").write_text(f'<robot name="r">\n{links}\n</robot>')
    caught = error_of(DataError, read_vehicle, tmp_path / "many.urdf")
    *lines, last = str(caught).splitlines()
    assert len(lines) == 50
    assert "link 'l0': expected a unique name, found 3 links with it" in lines[0]
    assert last == "and 10 more errors"
    assert len(caught.faults) == 60


# Vehicle files that change a URDF: joints, springs, masses, drives, forward axis

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
    found = error_of(VehicleError, read_vehicle, written(tmp_path, parts, f"joints.{given}"))
    assert words in str(found)
    assert "robot.toml:" in str(found)


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
    text, moments = file.read_text(), 'ixx="0.1" iyy="0.2" izz="0.25"'
    # no body has a moment that exceeds the sum of the others; the second ones are in kg mm^2
    units = (f'ixx="1{unit}" iyy="2{unit}" izz="2.5{unit}"' for unit in ("e5", "e-4"))
    for wrong in (moments.replace("0.25", "2.5"), *units):
        file.write_text(text.replace(moments, wrong))
        found = read_vehicle(file)
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
    path, words = written(tmp_path, FOUR, "links.bas = { mass = 20 }"), "2: links.bas: did you mean"
    refuses(VehicleError, words, read_vehicle, path)


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


# Link poses of random URDFs against an independent library

TREES_INERTIAL = '<inertial><origin xyz="0 0 0"/><mass value="1"/></inertial>'


def random_urdf(rng, count):
    """Return a URDF of random joints, the names of its independent joints, and its mimics."""
    parts, free, mimics = [f'<link name="l0">{TREES_INERTIAL}</link>'], [], {}
    for k in range(1, count):
        kind = rng.choice(["fixed", "revolute", "continuous", "prismatic"])
        at, turned = rng.uniform(-1, 1, 3), rng.uniform(-3, 3, 3)
        axis, more = rng.normal(size=3), ""
        axis /= np.linalg.norm(axis)
        if kind != "fixed" and free and rng.random() < 0.3:
            factor, offset = rng.uniform(-2, 2, 2)
            mimics[f"j{k}"] = str(rng.choice(free)), factor, offset
            more = '<mimic joint="{}" multiplier="{}" offset="{}"/>'.format(*mimics[f"j{k}"])
        elif kind != "fixed":
            free.append(f"j{k}")
        parts += [
            f'<link name="l{k}">{TREES_INERTIAL}</link>',
            f'<joint name="j{k}" type="{kind}"><parent link="l{rng.integers(k)}"/>'
            f'<child link="l{k}"/><origin xyz="{spelled(at)}" rpy="{spelled(turned)}"/>'
            f'<axis xyz="{spelled(axis)}"/><limit lower="-3" upper="3" effort="1" velocity="1"/>'
            f"{more}</joint>",
        ]
    return f'<robot name="r">{"".join(parts)}</robot>', free, mimics


def spelled(numbers):
    return " ".join(map(repr, numbers.tolist()))


@pytest.mark.parametrize("count", [8, 60])
def test_poses_of_links_are_those_of_yourdfpy(count, rng):
    text, free, mimics = random_urdf(rng, count)
    oracle = yourdfpy.URDF.load(io.StringIO(text), build_scene_graph=True, load_meshes=False)
    robot = Robot(read_tree(text.encode(), "robot.urdf"))
    for _ in range(5):
        values = dict(zip(free, rng.uniform(-3, 3, len(free)), strict=True))
        oracle.update_cfg(values)
        for name, (leader, factor, offset) in mimics.items():
            values[name] = offset + factor * values[leader]
        poses = {"l0": np.eye(4)}
        arrays = {name: np.array([value]) for name, value in values.items()}
        for each in link_poses(robot, arrays):
            own = np.eye(4)
            own[:3, :3], own[:3, 3] = each.rotation.as_matrix()[0], each.origins.ravel()
            poses[each.child] = poses[each.parent] @ own
        for name, pose in poses.items():
            assert np.abs(pose - oracle.get_transform(name, "l0")).max() < 1e-9
