"""Tests of URDF files: equal vehicles in another program, and refused files."""

import re

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.cases import DATA, hills
from helpers.urdf import adam_model
from slipfree import Analytic, DataError, direct_kinematics, settle, simulate
from slipfree.catalog import differential_drive
from slipfree.contact.closure import has_exact_closure
from slipfree.geometry.frame import Pose
from slipfree.problem.build_vehicle import VehicleError, is_vehicle_file, read_vehicle
from slipfree.vehicle.drives import Torque
from slipfree.vehicle.sections import Omni, Sphere, Torus
from slipfree.vehicle.tree import Body

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


TWIN = """\
<robot name="twin">
  <link name="base"><inertial><origin xyz="0.1 0 0"/><mass value="20"/></inertial></link>
  <link name="l">{wheel}</link> <link name="r">{wheel}</link> <link name="c">{small}</link>
  <link name="fork"/>
  <joint name="right" type="continuous"><parent link="base"/><child link="r"/>
    <origin xyz="0 -0.25 0"/><axis xyz="0 {way} 0"/></joint>
  <joint name="left" type="continuous"><parent link="base"/><child link="l"/>
    <origin xyz="0 0.25 0"/><axis xyz="0 {way} 0"/></joint>
  <joint name="caster_angle" type="continuous"><parent link="base"/><child link="fork"/>
    <origin xyz="0.35 0 0"/><axis xyz="0 0 1"/></joint>
  <joint name="caster" type="continuous"><parent link="fork"/><child link="c"/>
    <origin xyz="-0.08 0 {drop}"/><axis xyz="0 {way} 0"/></joint>
</robot>
"""
WHEEL = """<inertial><mass value="1"/></inertial><collision><origin rpy="{quarter} 0 0"/>
  <geometry><cylinder radius="{radius}" length="0.05"/></geometry></collision>"""
ROLES = """\
urdf = "twin.urdf"
joints.caster_angle = "passive"
[wheels]
right = { driven = true, tube = 0.03 }
left = { driven = true, tube = 0.03 }
caster = { driven = false, tube = 0.015 }
"""


@pytest.mark.slow
@pytest.mark.parametrize("way", [1, -1])
def test_the_twin_of_a_catalogue_vehicle_moves_like_it(way, tmp_path):
    """A wheel's rate is positive forward, whichever way its axis points in the file."""
    wheel, small = (WHEEL.format(quarter=np.pi / 2, radius=radius) for radius in (0.15, 0.075))
    text = TWIN.format(wheel=wheel, small=small, way=way, drop=-0.075)
    (tmp_path / "twin.urdf").write_text(text)
    (tmp_path / "twin.toml").write_text(ROLES)
    twin = read_vehicle(tmp_path / "twin.toml")
    assert ("opposite" in "".join(twin.notes)) == (way < 0)
    assert twin.body == Body(20.0, (0.0, 0.1, 0.0))
    runs = []
    for vehicle in (differential_drive(caster_scale=0.5), twin):
        dae = direct_kinematics(vehicle, Analytic(hills))
        rates = dae.inputs(right_rate=2.0, left_rate=1.6)
        runs.append(simulate(dae, settle(dae, heading=0.3), rates, np.linspace(0, 2, 11)))
    first, second = runs
    for name in ("x", "y", "z", "heading", "caster_angle", "slip_along", "force_normal"):
        assert_allclose(second[name], first[name], atol=1e-12, rtol=1e-12)
    assert np.ptp(first["y"]) > 0.2


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


LIDAR = '<joint name="lidar_mount" type="revolute">'
LOST = '<link name="swivel"/><link name="lost"/>'
ENTITY = '<!DOCTYPE robot [<!ENTITY a "a">]><robot name="&a;">'
INCLUDE = '<robot name="cart" xmlns:xacro="x"><xacro:include filename="b"/>'
SLIDING = CASTER.replace("continuous", "prismatic") + '<limit lower="-150" upper="1"/>'
BASE_SWIVEL = '<parent link="base_link"/><child link="swivel"/>'
BASE_LIDAR = '<parent link="base_link"/><child link="lidar"/>'
FORK_WHEEL = '<parent link="fork"/><child link="left_wheel"/>'
WRONG = [
    ('<axis xyz="0 1 0"/>', '<axis xyz="0 0 0"/>', "cart.urdf:27: joint 'left_drive': expected an"),
    (
        '<axis xyz="0 1 0"/>',
        '<axis xyz="0 1"/>',
        "axis: expected three numbers in 'xyz', found '0 1'",
    ),
    ('<mass value="12"/>', '<mass value="many"/>', "link 'base_link': mass: expected a number"),
    ('<mass value="12"/>', '<mass value="-1"/>', "expected a mass of at least 0 kg"),
    ('xyz="0 0.25 0"', 'xyz="0 250 0"', "expected xyz in metres, from -100 to 100 (did you"),
    ('rpy="0.0 0.0 0.4"', 'rpy="0 0 23"', "rpy in radians (did you mean 23 degrees? write"),
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
    (LIDAR, LIDAR.replace("lidar_mount", "caster"), "cart.urdf:45: joint 'caster': expected a"),
    (
        '<child link="caster_wheel"/>',
        '<child link="castor"/>',
        "a link of this file as child, found",
    ),
    (BASE_LIDAR, FORK_WHEEL, "link 'left_wheel' is also the child of joint 'left_drive'; cut"),
    (BASE_SWIVEL, BASE_SWIVEL.replace("base_link", "fork"), "found links in a loop: 'swivel', "),
    ('<link name="swivel"/>', LOST, "expected one root link, found 'base_link', 'lost'"),
    (CASTER, CASTER.replace("continuous", "planar"), "found 'planar'; replace it with such joints"),
    (CASTER, CASTER.replace("continuous", "hinge"), "joint 'caster': expected one of the types"),
    ('<cylinder radius="0.15" length="0.04"/>', '<mesh filename="a.stl"/>', "the mesh 'a.stl',"),
    ('radius="0.15"', 'radius="150"', "in metres, greater than 0 and at most 100, found 150"),
    ('<robot name="cart">', ENTITY, "cart.urdf:3: expected XML without a document type, found"),
    ('<robot name="cart">', "<!DOCTYPE robot><robot>", "cart.urdf:3: expected XML without a"),
    ('<robot name="cart">', INCLUDE, "cart.urdf:3: expected plain URDF, found xacro,"),
    ('xyz="0 0.25 0"', 'xyz="0 ${a} 0"', "found xacro, '0 ${a} 0' in the attribute 'xyz' of"),
    ('version="1.0"?>', 'version="1.0" encoding="klingon"?>', "cart.urdf: expected XML in a known"),
    ('<robot name="cart">', "<sdf>", "cart.urdf:54: expected XML, found mismatched tag"),
]


@pytest.mark.parametrize(("old", "new", "words"), WRONG)
def test_what_is_wrong_is_named(old, new, words, tmp_path):
    assert words in faults(changed(tmp_path, "cart", (old, new)))


FREE = "wheels = { caster_axle = { driven = false } }"
ROLES_REFUSED = [
    ('[joints]\ncastor = "passive"', "cart.toml:3: joints.castor: did you mean 'caster'? expected"),
    ('joints = { caster = "free" }', "cart.toml:2: joints.caster.kind: expected 'commanded',"),
    ("[wheels]\nlidar_mount = { driven = false }", "'lidar_mount': expected the mesh 'lidar.stl',"),
    ("[wheels]\nleft_drive = { tubes = 1 }", "wheels.left_drive.tubes: did you mean 'tube'?"),
    ("tube = 1.0", "expected a tube of at most the radius, 0.15 m,"),
    ("[wheels]\nleft_drive = { radius = 150.0 }", "cart.toml:3: wheels.left_drive.radius:"),
    (f'joints.caster = {{ kind = "passive", upper = 30 }}\n{FREE}', "upper: expected radians (did"),
    (f'joints = {{ caster = "suspension" }}\n{FREE}', "found 1 (caster); remove it"),
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
        (
            'urdf = "cat.urdf"',
            "cat.urdf: expected a URDF (urdf of cart.toml), found that it cannot",
        ),
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
caster_axle = { driven = false, radius = 0.12, tube = 0.03, grip = 0.5, rollers = true }
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
        ((0, 0), ", upper = 0.5", (0, 0.5)),
        ((-0.3, 0.2), "", (-0.3, 0.2)),
        ((-0.3, 0.2), ", lower = -0.5", (-0.5, 0.2)),
        ((-0.3, 0.2), ", upper = 0.5", (-0.3, 0.5)),
        ((-90, 90), ", lower = -0.5, upper = 0.5", (-0.5, 0.5)),
    ],
)
def test_limits_of_the_vehicle_file_override_those_of_the_urdf(in_urdf, in_roles, stops, tmp_path):
    change = (CASTER, REVOLUTE.format(*in_urdf))
    file = changed(tmp_path, "cart", change, roles=FREE_CASTER.format(in_roles))
    (caster,) = read_vehicle(file).coordinates
    assert (caster.lower, caster.upper) == stops


@pytest.mark.parametrize(
    ("in_roles", "words"),
    [
        (", lower = 0.5", "lower limit of caster below the upper one, found 0.5 and 0.2; in a veh"),
        (
            ", lower = 0, upper = 0",
            "cart.toml:1: coordinate 'caster': the lower stop must be below",
        ),
    ],
)
def test_limits_that_contradict_are_refused(in_roles, words, tmp_path):
    change = (CASTER, REVOLUTE.format(-0.3, 0.2))
    assert words in faults(changed(tmp_path, "cart", change, roles=FREE_CASTER.format(in_roles)))


def test_limits_of_the_vehicle_file_override_those_of_followers(tmp_path):
    text = (DATA / "bogie.toml").read_text()
    role = 'rocker-left = { kind = "suspension", lower = -0.7 }'
    new = re.sub(r'rocker-left = "suspension"', role, text)
    assert new != text
    vehicle = read_vehicle(changed(tmp_path, "bogie", roles=new))
    rocker = next(c for c in vehicle.coordinates if c.name == "rocker_left")
    assert (rocker.lower, rocker.upper) == (-0.7, 0.5)


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


def test_fixed_joints_that_mimic_a_free_one_stay(tmp_path):
    roles = (DATA / "bogie.toml").read_text()
    file = changed(tmp_path, "bogie", fixed("rocker_right"), roles=roles)
    values = {joint.name: joint.value for joint in read_vehicle(file).joints}
    assert (values["rocker-left"], values["rocker_right"]) == ("rocker_left", "0.0")


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


def test_the_lowest_of_two_balls_on_a_fixed_joint_is_the_wheel(tmp_path):
    mesh = '<geometry><mesh filename="lidar.stl"/></geometry>'
    balls = (
        '<geometry><sphere radius="0.1"/></geometry></visual>'
        '<visual><origin xyz="0 0 -0.09"/><geometry><sphere radius="0.05"/></geometry>'
    )
    joint = '<joint name="lidar_mount" type="revolute">'
    roles = (
        'urdf = "cart.urdf"\njoints = { caster = "fixed", caster_axle = "fixed" }\n'
        "wheels.lidar_mount = { driven = false, rollers = true }\n"
    )
    fix = (joint, joint.replace("revolute", "fixed"))
    vehicle = read_vehicle(changed(tmp_path, "cart", (mesh, balls), fix, roles=roles))
    wheel = next(w for w in vehicle.wheels if w.name == "lidar_mount")
    assert (wheel.radius, wheel.at) == (0.05, (0.0, 0.0, -0.09))


def test_endings_count_in_any_case(tmp_path):
    """Of a URDF, of the file that completes it, and of xacro."""
    (tmp_path / "CART.URDF").write_text((DATA / "cart.urdf").read_text())
    text = (DATA / "cart.toml").read_text().replace("cart.urdf", "CART.URDF")
    (tmp_path / "CART.TOML").write_text(text)
    (tmp_path / "CART.XACRO").write_text((DATA / "cart.urdf").read_text())
    assert len(read_vehicle(tmp_path / "CART.TOML").wheels) == 3
    assert len(read_vehicle(tmp_path / "CART.URDF").wheels) == 3
    assert is_vehicle_file(tmp_path / "CART.URDF")
    assert len(read_vehicle(tmp_path / "CART.XACRO").wheels) == 3


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
        'urdf = "cart.urdf"\nwheels.lidar_mount = { driven = false, rollers = true }\n'
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


def test_only_files_of_a_kind_are_read(tmp_path):
    (tmp_path / "cart.txt").write_text("robot")
    with pytest.raises(DataError, match=r"ends in \.toml, \.urdf or \.xacro, found '\.txt'"):
        read_vehicle(tmp_path / "cart.txt")
    with pytest.raises(DataError, match="found that it cannot be read"):
        read_vehicle(tmp_path / "no.urdf")


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
