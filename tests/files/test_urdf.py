"""Tests of URDF files: equal vehicles in another program, and refused files."""

import re

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.cases import DATA
from helpers.urdf import adam_model
from slipfree import DataError
from slipfree.contact.closure import has_exact_closure
from slipfree.geometry.frame import Pose
from slipfree.problem.build_vehicle import VehicleError, read_vehicle
from slipfree.vehicle.drives import Torque
from slipfree.vehicle.sections import Omni, Sphere, Torus

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
        given = {FILES[name][key]: (values[key], rates[key]) for key in values}
        for follower, (leader, factor) in MIMICS.get(name, {}).items():
            given[follower] = tuple(factor * each for each in given[leader])
        q, dq = np.array([given[joint] for joint in joints]).T
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
    given = {FILES[name][key]: value for key, value in values.items()}
    for follower, (leader, factor) in MIMICS.get(name, {}).items():
        given[follower] = factor * given[leader]
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    masses = vehicle.masses(rest, {key: ca.SX(value) for key, value in values.items()})
    moments = [np.array([1, *np.array(ca.evalf(place)).ravel()]) * m for _, m, place in masses]
    mass, *moment = np.sum(moments, axis=0)
    assert_allclose(mass, oracle.get_total_mass(), rtol=1e-12)
    center = oracle.CoM_position(np.eye(4), np.array([given[joint] for joint in joints]))
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
    with pytest.raises(VehicleError) as caught:
        read_vehicle(path)
    return str(caught.value).replace(f"{path.parent}/", "")


CASTER = '<joint name="caster" type="continuous">'
REVOLUTE = '<joint name="caster" type="revolute"><limit lower="{}" upper="{}"/>'


ENTITY = '<!DOCTYPE robot [<!ENTITY a "a">]><robot name="&a;">'
INCLUDE = '<robot name="cart" xmlns:xacro="x"><xacro:include filename="b"/>'
SLIDING = CASTER.replace("continuous", "prismatic") + '<limit lower="-150" upper="1"/>'
BASE_SWIVEL = '<parent link="base_link"/><child link="swivel"/>'
BASE_LIDAR = '<parent link="base_link"/><child link="lidar"/>'
FORK_WHEEL = '<parent link="fork"/><child link="left_wheel"/>'
WRONG = [
    ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', "cart.urdf:27: joint 'left_drive': expected an"),
    ('<mass value="12"/>', '<mass value="-1"/>', "expected a mass of at least 0 kg"),
    ('xyz="0 0.25 0"', 'xyz="0 250 0"', "expected xyz in metres, from -100 to 100 (did you"),
    (
        CASTER,
        REVOLUTE.format(-90, 90),
        "lower in radians (did you mean -90 degrees? write -1.5708)",
    ),
    (
        CASTER,
        REVOLUTE.format(1, 1),
        "expected a lower limit of caster below the upper one, found 1",
    ),
    (CASTER, REVOLUTE.format(1, 1), '1; in a vehicle file with urdf = "cart.urdf", write caster ='),
    (
        CASTER,
        SLIDING,
        "expected lower in metres, at least -100 (did you mean millimetres? write -0.",
    ),
    (
        '<child link="caster_wheel"/>',
        '<child link="castor"/>',
        "a link of this file as child, found",
    ),
    (BASE_LIDAR, FORK_WHEEL, "link 'left_wheel' is also the child of joint 'left_drive'; cut"),
    (BASE_SWIVEL, BASE_SWIVEL.replace("base_link", "fork"), "found links in a loop: 'swivel', "),
    (CASTER, CASTER.replace("continuous", "planar"), "found 'planar'; replace it with such joints"),
    ('<cylinder radius="0.15" length="0.04"/>', '<mesh filename="a.stl"/>', "the mesh 'a.stl',"),
    ('radius="0.15"', 'radius="150"', "in metres, greater than 0 and at most 100, found 150"),
    ('<robot name="cart">', ENTITY, "cart.urdf:3: expected XML without a document type, found"),
    ('<robot name="cart">', INCLUDE, "cart.urdf:3: expected plain URDF, found xacro,"),
    ('xyz="0 0.25 0"', 'xyz="0 ${a} 0"', "found xacro, '0 ${a} 0' in the attribute 'xyz' of"),
]


@pytest.mark.parametrize(("old", "new", "words"), WRONG)
def test_what_is_wrong_is_named(old, new, words, tmp_path):
    assert words in faults(changed(tmp_path, "cart", (old, new)))


FREE = "wheels = { caster_axle = { driven = false } }"
ROLES_REFUSED = [
    ('joints = { caster = "free" }', "cart.toml:2: joints.caster.kind: expected 'commanded',"),
    ("tube = 1.0", "expected a tube of at most the radius, 0.15 m,"),
    (f'joints.caster = {{ kind = "commanded", stiffness = 3 }}\n{FREE}', "cannot have a spring"),
    ('joints = { caster = "passive", bracket = "suspension" }', 'in { kind = "suspension", axis ='),
    (
        "wheels = { caster = { radius = 0.1 } }",
        "joints below it, found 'caster_axle'; remove it or",
    ),
    ("wheels = { caster = { radius = 0.1 } }", "'caster_axle': expected the parent of a wheel to"),
    (
        'joints.caster = "passive"\nwheels.caster = {}',
        "expected a joint that is not a wheel, found",
    ),
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
        (note,) = [note for note in vehicle.notes if note.startswith("several shapes")]
        assert f"(1 sphere of 0.02 m, 1 cylinder of {smaller} m, 1 cylinder of 0.15 m)" in note
        other = f"left_drive = {{ radius = {smaller if radius == 0.15 else 0.15} }}"
        assert note.endswith(f"radius, {radius} m: left_drive; otherwise write wheels.{other}")
    roles = (
        'urdf = "cart.urdf"\njoints = { caster = "passive" }\n[wheels]\n'
        "caster_axle.driven = false\nleft_drive.radius = 0.11\n"
    )
    vehicle = read_vehicle(changed(tmp_path, "cart", roles=roles))
    assert vehicle.wheels[0].radius == 0.11
    assert not any("several shapes" in note for note in vehicle.notes)


def test_limits_become_stops_of_the_one_that_is_mimicked():
    rocker = next(c for c in read_vehicle(DATA / "bogie.toml").coordinates if c.name[0] == "r")
    assert (rocker.lower, rocker.upper, rocker.max_rate) == (-0.6, 0.5, 1.0)
    assert (rocker.name, rocker.kind) == ("rocker_left", "suspension")


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
    assert any(
        note.startswith("without mass, since the URDF does not contain it: base_link")
        for note in vehicle.notes
    )


def test_a_ball_on_a_fixed_joint_is_a_caster(tmp_path):
    """A ball that slides freely: it turns with the ground, and costs no slip across."""
    ball = '<geometry><sphere radius="0.1"/></geometry>'
    roles = (
        'urdf = "cart.urdf"\nwheels.lidar_mount = { driven = false, rollers = "90 deg" }\n'
        'joints.caster = "fixed"\nwheels.caster_axle = { driven = false }'
    )
    file = changed(
        tmp_path,
        "cart",
        ('<geometry><mesh filename="lidar.stl"/></geometry>', ball),
        ('<joint name="lidar_mount" type="revolute">', '<joint name="lidar_mount" type="fixed">'),
        roles=roles,
    )
    vehicle = read_vehicle(file)
    wheel = next(w for w in vehicle.wheels if w.name == "lidar_mount")
    assert (wheel.section, wheel.axle) == (Omni(Sphere(0.1)), (1.0, 0.0, 0.0))
    assert not vehicle.coordinates


def test_many_errors_are_counted_instead_of_listed(tmp_path):
    names = [f"l{k}" for k in range(60) for _ in range(3)]
    links = "\n".join(f'<link name="{name}"/>' for name in names)
    (tmp_path / "many.urdf").write_text(f'<robot name="r">\n{links}\n</robot>')
    with pytest.raises(DataError) as caught:
        read_vehicle(tmp_path / "many.urdf")
    *lines, last = str(caught.value).splitlines()
    assert len(lines) == 50
    assert "link 'l0': expected a unique name, found 3 links with it" in lines[0]
    assert last == "and 10 more errors"
    assert len(caught.value.faults) == 60
