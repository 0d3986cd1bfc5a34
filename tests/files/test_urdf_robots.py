"""Tests of URDFs as many robots have them, and of incomplete ones: guesses, notes, questions."""

from dataclasses import replace
from math import cos, pi, sin

import numpy as np
import pytest

from helpers.commands import error_of, invoke, refused
from helpers.urdf import (
    FOUR,
    MASS,
    MESH,
    ROUND,
    TWO,
    WHEEL,
    joint,
    limb,
    link,
    offered,
    rocker_bogie,
    sphere,
    wheel,
    wheels,
    written,
)
from slipfree import Analytic, direct_kinematics, settle, simulate
from slipfree.control.path_following import straight
from slipfree.problem.build_vehicle import VehicleError, guessed_completion, read_vehicle
from slipfree.problem.report import describe
from slipfree.vehicle.sections import Omni, Sphere

ENDS = {"front": 0.3, "rear": -0.3}
CORNERS = [(e, x, s, y) for e, x in ENDS.items() for s, y in (("left", 0.2), ("right", -0.2))]
ROLLED = ROUND.format(0.1)  # about y
SMALL = ROUND.format(0.04)
BOX = '<collision><geometry><box size="0.04 0.04 0.06"/></geometry></collision>'


def limit(lower, upper):
    return f'<limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/>'


def fixed(name, at, shape="", parent="base"):
    return wheel(name, at, shape, parent, kind="fixed")


def pivot(name, at="0 0 0", axis="0 0 1", parent="base", kind="continuous", more=""):
    return limb(name, at, axis, parent, kind, more=more)


def steered(name, at, trail=0.0, parent="base"):
    post = pivot(f"{name}_steering", at, parent=parent, kind="revolute", more=limit(-0.6, 0.6))
    return post + wheel(name, f"{-trail} 0 0", parent=f"{name}_steering")


def geared(side, y):
    gear = wheel(f"{side}_gear", f"0 {y} 0", ROUND.format(0.03))
    turned = (
        fixed(f"{e}_{side}_wheel", f"{x} 0 0", WHEEL, f"{side}_gear") for e, x in ENDS.items()
    )
    return gear + "".join(turned)


def rollers(name, at, angle):
    """Return a wheel with rollers as links, at an angle to the plane of the wheel."""
    parts = wheel(name, at, "")
    for k in range(8):
        turn = k * pi / 4
        axis = f"{-sin(turn) * cos(angle)} {sin(angle)} {cos(turn) * cos(angle)}"
        place = f"{0.08 * cos(turn)} 0 {0.08 * sin(turn)}"
        parts += link(f"{name}_{k}", sphere(0.02))
        parts += joint(f"{name}_roller_{k}", "continuous", name, f"{name}_{k}", place, axis)
    return parts


def corners(make):
    return "".join(make(f"{e}_{s}_wheel", f"{x} {y} 0") for e, x, s, y in CORNERS)


def plugin(name, **elements):
    inside = "".join(f"<{key}>{value}</{key}>" for key, value in elements.items())
    return f'<gazebo><plugin filename="{name}" name="p">{inside}</plugin></gazebo>'


WHEELS = [f"{end}_{side}_joint" for end in ("front", "rear") for side in ("left", "right")]
DRIVEN = dict(zip("abcd", WHEELS, strict=True))  # by a plugin
CONTRADICTING = {"left_joint": WHEELS[1], "right_joint": WHEELS[0], "third_joint": "gone"}
BASE_JOINTS = (
    '<link name="world"/><link name="a"/>'
    + pivot("slide", axis="1 0 0", parent="a", kind="prismatic").replace(
        'value="1"', 'value="1e-3"'
    )
    + joint("fix", "fixed", "world", "a")
    + joint("yaw", "continuous", "slide", "base", axis="0 0 1")
)
FORK = pivot("caster_fork", "-0.2 0 0")
SWIVEL = {"caster_fork_joint": "passive"}
TRAILER = pivot("trailer", "-0.5 0 0") + wheels("trailer_{side}", {"": -0.5}, parent="trailer")
AHEAD = pivot("front", "0.3 0 0") + wheels("front_{side}", {"": 0.3}, parent="front")
ARM = pivot("shoulder", "0 0 0.3") + wheel("wrist", "0.3 0 0.5", SMALL, parent="shoulder")
LOW_ARM = pivot("shoulder") + wheel("hand", "0 0 0", ROLLED, "shoulder", "revolute").replace(
    'xyz="0 1 0"/>', f'xyz="1 0 0"/>{limit(-3.14, 3.14)}'
)
KNUCKLES = steered("left", "0.3 0.2 0") + steered("right", "0.3 -0.2 0").replace(
    "<limit", '<mimic joint="left_steering_joint"/><limit'
)
KIWI = "".join(
    link(f"w{k}", WHEEL)
    + joint(f"j{k}", "continuous", "base", f"w{k}", f"{cos(a)} {sin(a)} 0", rpy=f"0 0 {a - pi / 2}")
    for k, a in enumerate((0, 2 * pi / 3, -2 * pi / 3))
)
STEERING = dict.fromkeys((f"{e}_{s}_wheel_steering_joint" for e, _, s, _ in CORNERS), "commanded")
SPRUNG = "".join(
    pivot(f"{e}_{s}_spring", f"{x} {y} 0", kind="prismatic", more=limit(-0.1, 0.1))
    + wheel(f"{e}_{s}_wheel", "0 0 0", parent=f"{e}_{s}_spring")
    for e, x, s, y in CORNERS
)
GAZEBO = (
    '<gazebo><plugin filename="libgazebo_ros_diff_drive.so"><left_joint>rear_left_joint'
    "</left_joint><right_joint> rear_right_joint </right_joint></plugin><plugin "
    'filename="libgazebo_ros_joint_state_publisher.so"><joint_name>front_left_joint</joint_name>'
    "</plugin></gazebo>"
)
# parts, number of wheels, of driven wheels, and of wheels on rollers; kinds of the coordinates
ROBOTS = {
    "unlimited": (wheels("{e}{s}", ENDS, kind="revolute", more=limit("-inf", 1e16)), 4, 4, 0, {}),
    "no limits": (wheels("{e}{s}", ENDS, kind="revolute"), 4, 4, 0, {}),
    "limits of 2000": (wheels("{e}{s}", ENDS, kind="revolute", more=limit(-2e3, 2e3)), 4, 4, 0, {}),
    "full turn": (wheels("{e}{s}", ENDS, kind="revolute", more=limit(-3.14, 3.14)), 4, 4, 0, {}),
    "equal limits": (wheels("{e}{s}", ENDS, kind="revolute", more=limit(0, 0)), 4, 4, 0, {}),
    "empty limits": (wheels("{s}{e}_wheel", ENDS, kind="revolute", more=limit(0, 0)), 4, 4, 0, {}),
    "world": (FOUR + BASE_JOINTS, 4, 4, 0, {}),
    "ball": (TWO + fixed("ball", "-0.2 0 -0.07", sphere(0.03)), 3, 2, 1, {}),
    "ball on z": (TWO + pivot("a") + wheel("caster", "1 0 -0.07", sphere(0.03), "a"), 3, 2, 1, {}),
    "ball on y": (TWO + wheel("caster", "-0.2 0 -0.07", sphere(0.03)), 3, 2, 1, {}),
    "ball on x and y": (
        TWO + pivot("a", "0.2 0 -0.07", "1 0 0") + wheel("b", "0 0 0", sphere(0.03), "a"),
        3, 2, 1, {},
    ),
    "chain of fixed links": (
        TWO + fixed("caster", "-0.2 0 0", BOX) + fixed("tip", "0 0 -0.06", SMALL, "caster"),
        3, 2, 1, {},
    ),
    "caster with a mesh": (TWO + fixed("caster", "-0.2 0 -0.05", MESH), 3, 2, 1, {}),
    "two casters": (
        TWO + "".join(fixed(f"caster_{k}", f"{x} 0 -0.05", sphere(0.05)) for k, x in ENDS.items()),
        4, 2, 2, {},
    ),
    "swivel": (TWO + FORK + wheel("w", "-0.03 0 -0.06", SMALL, "caster_fork"), 3, 2, 0, SWIVEL),
    "swivel and a fixed wheel": (
        TWO + FORK + fixed("w", "-0.03 0 -0.06", SMALL, "caster_fork"),
        3, 2, 0, SWIVEL,
    ),
    "trailing wheel": (
        TWO + pivot("a", "-0.2 0 0") + wheel("w", "-0.03 0 -0.06", SMALL, "a"),
        3, 2, 0, {"a_joint": "passive"},
    ),
    "caster without a swivel": (TWO + wheel("caster", "-0.3 0 -0.06", SMALL), 3, 2, 1, {}),
    "small third wheel": (TWO + wheel("support", "-0.3 0 -0.06", SMALL), 3, 2, 1, {}),
    "fixed third wheel": (TWO + fixed("wheel_3", "-0.3 0 -0.06", SMALL), 3, 2, 1, {}),
    "ball in a body": (
        fixed("body", "-0.2 0 -0.07", BOX + sphere(0.03)) + TWO.replace('"base"', '"body"')
        .replace("0 0.15 0", "0.2 0.15 0.07").replace("0 -0.15 0", "0.2 -0.15 0.07"),
        3, 2, 1, {},
    ),
    "caster of a mesh and a ball": (
        TWO + fixed("caster", "-0.2 0 -0.07", sphere(0.03) + MESH), 3, 2, 1, {}
    ),
    "floating ball": (TWO + wheel("b", "-0.2 0 -0.07", sphere(0.03), kind="floating"), 3, 2, 1, {}),
    "idle wheels": (FOUR.replace("rear", "idle"), 4, 2, 0, {}),
    "drive of Gazebo": (FOUR + GAZEBO, 4, 2, 0, {}),
    "articulated": (TWO + AHEAD, 4, 4, 0, {"front_joint": "commanded"}),
    "trailer": (FOUR + TRAILER, 6, 4, 0, {"trailer_joint": "passive"}),
    "tricycle": (TWO + steered("front", "0.5 0 0"), 3, 3, 0, {"front_steering_joint": "commanded"}),
    "knuckles": (TWO + KNUCKLES, 4, 4, 0, {"left_steering_joint": "commanded"}),
    "four steered": (corners(steered), 4, 4, 0, STEERING),
    "four steered casters": (corners(lambda n, at: steered(n, at, 0.05)), 4, 4, 0, STEERING),
    "springs": (SPRUNG, 4, 4, 0, {}),
    "gears": (geared("left", 0.2) + geared("right", -0.2), 4, 4, 0, {}),
    "omni wheels": (corners(lambda n, at: rollers(n, at, 0)), 4, 4, 4, {}),
    "mecanum wheels": (corners(lambda n, at: rollers(n, at, pi / 4)), 4, 4, 4, {}),
    "mecanum plugin": (FOUR + plugin("gz-sim-mecanum-drive-system", **DRIVEN), 4, 4, 4, {}),
    "rollers along axles": (corners(lambda n, at: rollers(n, at, pi / 2)), 4, 4, 0, {}),
    "kiwi drive": (KIWI, 3, 3, 3, {}),
    "arm": (FOUR + ARM, 4, 4, 0, {}),
    "low arm": (FOUR + LOW_ARM, 4, 4, 0, {}),
    "rocker": (rocker_bogie(bogies=False), 4, 4, 0, {"left_rocker_joint": "suspension"}),
}  # fmt: skip


@pytest.mark.parametrize("name", ROBOTS)
def test_wheels_and_joints_of_robots(name, tmp_path):
    parts, count, driven, sliding, kinds = ROBOTS[name]
    vehicle = read_vehicle(written(tmp_path, parts))
    assert len(vehicle.wheels) == count
    assert sum(each.driven for each in vehicle.wheels) == driven
    assert sum(isinstance(each.section, Omni) for each in vehicle.wheels) == sliding
    assert {c.name: c.kind for c in vehicle.coordinates} == kinds


@pytest.mark.parametrize("name", [*ROBOTS][::4])
def test_notes_end_with_the_line_of_the_other_choice(name, tmp_path):
    parts = ROBOTS[name][0]
    vehicle = read_vehicle(written(tmp_path, parts))
    lines = [note.split("otherwise write ")[1] for note in vehicle.notes if "otherwise" in note]
    assert lines
    assert all("otherwise" in note for note in vehicle.notes if note.startswith("guessed"))
    for line in lines:
        choice = draft(written(tmp_path, parts, line))
        fields = ("wheels", "joints", "coordinates")
        assert any(getattr(choice, f) != getattr(vehicle, f) for f in fields), line


def draft(path):
    """Return a vehicle, or the draft of an incomplete one, as without a third wheel."""
    try:
        return read_vehicle(path)
    except VehicleError as error:
        return error.draft


X_ON_TOP = {"front_left": 45, "front_right": -45, "rear_left": -45, "rear_right": 45}


def roller_angles(vehicle):
    angles = {"_".join(each.name.split("_")[:2]): each.rollers for each in vehicle.wheels}
    return {name: angle and np.degrees(angle) for name, angle in angles.items()}


@pytest.mark.parametrize("angle", [45, 30, 89.5])
@pytest.mark.parametrize("flipped", [False, True])
def test_angles_of_rollers_are_those_of_their_axes(flipped, angle, tmp_path):
    """On the ground, the roller's axis in front on the left points forward and to the right."""
    expected = {name: np.sign(sign) * angle for name, sign in X_ON_TOP.items()}

    def mecanum(name, at):
        leftward = np.radians(expected[name.removesuffix("_wheel")] - 90)
        return rollers(name, at, leftward)

    parts = corners(mecanum)
    if flipped:  # the axis of a joint has no sense
        parts = parts.replace('xyz="0 1 0"', 'xyz="0 -1 0"')
    vehicle = read_vehicle(written(tmp_path, parts))
    assert roller_angles(vehicle) == pytest.approx(expected, abs=1e-12)
    if angle == 45:
        assert any("with rollers, at the angle of their axes" in note for note in vehicle.notes)
        assert settle(direct_kinematics(vehicle, Analytic(lambda x, _: 0 * x)))["z"][0] > 0


def test_wheels_with_the_name_of_mecanum_wheels_have_the_usual_rollers(tmp_path):
    parts = "".join(wheel(f"{e}_{s}_mecanum", f"{x} {y} 0") for e, x, s, y in CORNERS)
    vehicle = read_vehicle(written(tmp_path, parts))
    assert roller_angles(vehicle) == X_ON_TOP
    assert any("on top of the wheels, their axes form an X" in note for note in vehicle.notes)
    lines = [note.split("otherwise write ")[1] for note in vehicle.notes if "an X" in note]
    assert lines[0] == "wheels.front_left_mecanum_joint = { rollers = false }"
    plain = read_vehicle(written(tmp_path, parts, lines[0]))
    assert roller_angles(plain) == X_ON_TOP | {"front_left": None}
    omni = written(tmp_path, parts.replace("mecanum", "omni"))
    line = '; otherwise wheels.rear_left_omni_joint = { rollers = "-45 deg" }'
    assert f"without rollers, in spite of its name{line}" in guessed_completion(omni, tmp_path)
    mesh = '<visual><geometry><mesh filename="package://a/mecanum.stl"/></geometry></visual>'
    parts = corners(lambda name, at: wheel(name, at, WHEEL + mesh))
    assert roller_angles(read_vehicle(written(tmp_path, parts))) == X_ON_TOP


PATTERNS = (
    "{end}_{side}_wheel",
    "wheel_{e}{s}",
    "{s}{e}_joint",
    "{side}_drive_{end}",
    "rad_{end}_{side}",
    "rueda_{end}_{side}",
)


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize(("yaw", "axis"), [(0, "x"), (pi / 2, "y"), (pi, "-x"), (-pi / 2, "-y")])
def test_names_tell_forward(pattern, yaw, axis, tmp_path):
    """Also if the axes of the wheels point to both sides, so that their rates cancel."""
    parts = wheels(pattern, ENDS, yaw=yaw)
    for stem, names in (("rad_", "vorne hinten links rechts"), ("rueda_", "del tras izq der")):
        for word, own in zip((*ENDS, "left", "right"), names.split(), strict=True):
            parts = parts.replace(word, own) if pattern.startswith(stem) else parts
    cancelling = parts.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>', 2)
    for text in (parts, cancelling):
        vehicle = read_vehicle(written(tmp_path, text))
        places = [each.at for each in vehicle.wheels]  # left and right in front, then behind
        ahead = [(-0.2, 0.3, 0), (0.2, 0.3, 0), (-0.2, -0.3, 0), (0.2, -0.3, 0)]
        assert np.allclose(places, ahead, atol=1e-8)
        assert any("guessed forward" in note for note in vehicle.notes) == (axis != "x")


REAR_STEERED = TWO.replace("left", "a").replace("right", "b") + steered("c", "-0.5 0 0")


def test_steered_wheels_in_the_rear_are_noted_against_the_names(tmp_path):
    (note,) = [n for n in read_vehicle(written(tmp_path, REAR_STEERED)).notes if "forward" in n]
    assert "steered wheels (-x)" in note
    assert note.endswith('otherwise write forward = "-x"')


ASIDE = FOUR.replace(" 0.15 0", " 0.45 0").replace(" -0.15 0", " 0.15 0")  # of the root


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (WHEEL, ""),
        (WHEEL, BOX),
        ('name="rear_right_joint" type="continuous"', 'name="rear_right_joint" type="fixed"'),
        ('rpy="0 0 0"/><axis xyz="0 1 0"', 'rpy="0 0 0"/><axis xyz="0 0 1"'),
    ],
)
def test_opposite_wheels_are_alike(old, new, tmp_path):
    aside = ASIDE
    head, last = aside.rsplit('<link name="rear_right">', 1)
    assert old in last
    whole = read_vehicle(written(tmp_path, aside))
    parts = f'{head}<link name="rear_right">{last.replace(old, new)}'
    vehicle = read_vehicle(written(tmp_path, parts))
    assert [w.at for w in vehicle.wheels] == [w.at for w in whole.wheels]
    assert [w.section for w in vehicle.wheels] == [w.section for w in whole.wheels]
    assert any("its counterpart on the other side, rear_left_joint" in n for n in vehicle.notes)


SAME, OPPOSITE = ("0 1 0", "0 1 0"), ("0 -1 0", "0 1 0")


@pytest.mark.parametrize("mounts", [False, True])
@pytest.mark.parametrize("axes", [SAME, OPPOSITE])
def test_opposite_rockers_have_a_differential(axes, mounts, tmp_path):
    parts = rocker_bogie(axes=axes, mounts=mounts)
    vehicle = read_vehicle(written(tmp_path, parts))
    factor = -1 if axes == SAME else 1
    head, last = parts.rsplit("<limit", 2)[0], parts[len(parts.rsplit("<limit", 2)[0]) :]
    mimic = f'<mimic joint="left_rocker_joint" multiplier="{factor}"/>'
    given = read_vehicle(written(tmp_path, head + mimic + last))
    assert (vehicle.coordinates, vehicle.joints) == (given.coordinates, given.joints)
    couple = f"couple = {{ left_rocker_joint = 2, right_rocker_joint = {-2 * factor} }}"
    declared = read_vehicle(written(tmp_path, parts, couple))
    assert (declared.coordinates, declared.joints) == (given.coordinates, given.joints)
    assert sum("differential" in note for note in vehicle.notes) == 1
    assert not any("differential" in note for note in declared.notes)


@pytest.mark.parametrize(
    ("follower", "leader", "couple"),
    [
        ("right_rocker_joint", "left_rocker_joint", ""),
        ("", "", "couple = { left_rocker_joint = 1, right_rocker_joint = -1 }"),
        ("", "", "couple = { left_bogie_joint = 1, right_bogie_joint = 1 }"),
    ],
)
def test_rockers_that_turn_alike_are_refused_with_the_right_coupling(
    follower, leader, couple, tmp_path
):
    parts = rocker_bogie()
    if follower:
        head, last = parts.split(f'<joint name="{follower}"')
        mimic = f'<mimic joint="{leader}"/><limit'
        parts = f'{head}<joint name="{follower}"{last.replace("<limit", mimic, 1)}'
    with pytest.raises(VehicleError, match="opposite angles") as caught:
        read_vehicle(written(tmp_path, parts, couple))
    line = str(caught.value).split("write ")[1].split(", in a vehicle file")[0]
    right = read_vehicle(written(tmp_path, rocker_bogie()))
    names = {c.name for c in read_vehicle(written(tmp_path, parts, line)).coordinates}
    assert len(names) == len(right.coordinates)


@pytest.mark.parametrize(
    ("more", "count"), [("", 3), (", stiffness = 500.0", 4), (", lower = -0.2", 4)]
)
def test_declared_rockers_have_a_differential_unless_they_have_own_keys(more, count, tmp_path):
    sides = (
        f'joints.{s}_rocker_joint = {{ kind = "suspension"{more} }}' for s in ("left", "right")
    )
    vehicle = draft(written(tmp_path, rocker_bogie(), "\n".join(sides)))
    assert len([c for c in vehicle.coordinates if "rocker" in c.name]) == count - 2
    assert any("differential" in note for note in vehicle.notes) == (not more)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("couple = { left_rocker_joint = 1 }", "expected two joints with coefficients other than"),
        ("couple = { left_rocker_joint = 1, left_mount_joint = 1 }", "a joint of type 'fixed'"),
        (
            "couple = { left_rocker_joint = 1, right_rocker_joint = 1 }\n"
            'joints.right_rocker_joint = { kind = "suspension", lower = -1 }',
            "at the first of the coupled joints, found lower; move them",
        ),
    ],
)
def test_wrong_couplings_are_named(line, words, tmp_path):
    path = written(tmp_path, rocker_bogie(mounts=True), line)
    assert words in str(error_of(VehicleError, read_vehicle, path))


def test_unused_names_of_wheels_are_named(tmp_path):
    notes = read_vehicle(written(tmp_path, FOUR + fixed("spare_wheel", "0 0 0.5", BOX))).notes
    words = "no wheels in spite of their names: spare_wheel_joint; otherwise write wheels.spare"
    assert any(note.startswith(words) for note in notes)


# Incomplete URDFs: guesses, their notes, contradictions, and the lines offered


def notes(vehicle):
    return [note for note in vehicle.notes if note.startswith("guessed")]


def driven_straight(vehicle):
    """Return the end of 5 s at 0.2 m/s on level ground."""
    dae = direct_kinematics(vehicle, Analytic(lambda x, y: 0 * x * y))
    start = settle(dae)
    run = simulate(dae, start, straight(dae, start, speed=0.2), np.linspace(0, 5, 11))
    return run["x"][-1], run["y"][-1]


def test_wheels_without_actuators_are_driven(tmp_path):
    """Also those that mimic others, which is not read."""
    mimic = '<mimic joint="rear_left_joint"/><axis'
    vehicle = read_vehicle(written(tmp_path, FOUR.replace("<axis", mimic, 1)))
    assert [each.driven for each in vehicle.wheels] == [True] * 4
    assert "in spite of <mimic>: give equal ones: front_left_joint" in str(vehicle.notes)
    (note,) = notes(vehicle)
    assert note.startswith("guessed driven: no wheel has an actuator: front_left_joint, ")
    free = read_vehicle(written(tmp_path, FOUR, note.split("otherwise write ")[1]))
    assert [each.driven for each in free.wheels] == [False, True, True, True]


BALL = 'wheels.mount_joint = { driven = false, rollers = "90 deg" }'


@pytest.mark.parametrize(
    ("name", "at", "shape", "line"),
    [
        ("caster", "0 0 0", '<sphere radius="0.04"/>', ""),
        ("caster", "0 0 -0.01", '<box size="0.02 0.02 0.06"/>', ""),
        ("mount", "0 0 0.01", '<sphere radius="0.04"/>', BALL),
    ],
)
def test_a_fixed_caster_is_a_ball(name, at, shape, line, tmp_path):
    """Also a sphere whose place does not suggest one, if the vehicle file declares it."""
    shape = f'<collision><origin xyz="{at}"/><geometry>{shape}</geometry></collision>'
    caster = wheel(name, "-0.2 0 -0.06", shape, kind="fixed")
    vehicle = read_vehicle(written(tmp_path, TWO + caster, line))
    ball = vehicle.wheels[-1]
    assert (ball.section, ball.axle) == (Omni(Sphere(0.04)), (1.0, 0.0, 0.0))
    assert not ball.driven
    assert driven_straight(vehicle)[1] == pytest.approx(1.0, abs=1e-6)


def mesh_robot():
    foot = link("base_footprint") + joint("foot", "fixed", "base_footprint", "base", "0 0 0.12")
    wheels = "".join(
        wheel(f"wheel_{k}", f"{x} {y} {z}", MESH)
        for k, (x, y, z) in enumerate([(0.2, 0.2, 0), (0.2, -0.2, 0), (-0.2, 0, -0.02)])
    )
    return foot, wheels


def test_mesh_wheels_have_the_least_height_above_the_footprint_as_radius(tmp_path):
    foot, wheels = mesh_robot()
    vehicle = read_vehicle(written(tmp_path, foot + wheels))
    assert [each.radius for each in vehicle.wheels] == pytest.approx([0.1] * 3)
    assert any("its name, without a round shape" in note for note in vehicle.notes)


def test_one_line_gives_the_radius_of_mesh_wheels(tmp_path):
    _, wheels = mesh_robot()
    caught = error_of(VehicleError, read_vehicle, written(tmp_path, wheels))
    (line,) = offered(str(caught))
    for vehicle in (read_vehicle(written(tmp_path, wheels, line)), caught.draft):
        assert [f"radius = {each.radius}" for each in vehicle.wheels] == [line] * 3


ROVER = (
    limb("rocker", "0 0.2 0.1")
    + limb("post", "0.3 0 0", "0 0 1", "rocker")
    + wheel("front", "0 0 -0.1", parent="post")
    + wheel("rear", "-0.3 0 -0.1", parent="rocker")
    + wheel("front_right", "0.3 -0.2 0")
    + wheel("rear_right", "-0.3 -0.2 0")
    + limb("arm", "0 0 0.3")
    + limb("mast", more=limit(0, 0))
)


def test_kinds_of_joints_follow_from_their_axes_and_wheels(tmp_path):
    vehicle = read_vehicle(written(tmp_path, ROVER))
    kinds = {c.name: c.kind for c in vehicle.coordinates}
    assert kinds == {"rocker_joint": "suspension", "post_joint": "commanded"}
    reasons = " ".join(notes(vehicle))
    for words in ("it carries no wheel: arm_", "its limits are equal: mast_", "steers it: post_"):
        assert words in reasons
    given = read_vehicle(written(tmp_path, ROVER, 'joints = { rocker_joint = "fixed" }'))
    assert [c.name for c in given.coordinates] == ["post_joint"]


@pytest.mark.parametrize("height", [0.0, 0.3])
def test_a_gear_is_no_wheel(height, tmp_path):
    gear = wheel("gear", f"0 0 {height}", ROUND.format(0.02))
    vehicle = read_vehicle(written(tmp_path, FOUR + gear))
    assert [each.name for each in vehicle.wheels] == [
        f"{e}_{s}_joint" for e in ("front", "rear") for s in ("left", "right")
    ]
    assert any("far above the lowest wheel: gear_joint" in note for note in notes(vehicle))
    given = read_vehicle(written(tmp_path, FOUR + gear, "wheels = { gear_joint = {} }"))
    assert len(given.wheels) == 5


def test_commas_and_xacro_outside_the_parts_are_accepted(tmp_path):
    text = FOUR.replace("0.2 0.15 0", "0.2, 0.15, 0")
    ignored = '<gazebo reference="${prefix}base"/><xacro:property name="a" value="${b}"/>'
    file = written(tmp_path, text + ignored)
    file.write_text(file.read_text().replace("<robot ", '<robot xmlns:xacro="x" '))
    assert len(read_vehicle(file).wheels) == 4


CASTER = fixed("back_caster", "-0.2 0 -0.06", BOX)
ON_FIXED = "".join(
    wheel(f"wheel_{k}", f"{x} {y} 0", kind="fixed")
    + f'<transmission name="t{k}"><joint name="wheel_{k}_joint"/></transmission>'
    for k, (x, y) in enumerate([(0.2, 0.2), (0.2, -0.2), (-0.2, 0)])
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "parts", [FOUR, ROVER, "".join(mesh_robot()), TWO + CASTER, ON_FIXED, rocker_bogie()]
)
def test_the_written_completion_has_all_guesses(parts, tmp_path):
    file = written(tmp_path, parts)
    guessed = read_vehicle(file)
    out = tmp_path / "full.toml"
    invoke("vehicle", file, "--write", out, code=0)
    again = read_vehicle(out)
    for field in ("wheels", "coordinates", "joints"):
        assert getattr(again, field) == getattr(guessed, field)
    assert not notes(again)
    assert "{  }" not in out.read_text()
    assert "--force" in refused("vehicle", file, "--write", out)


def test_steering_hinges_with_turned_frames_steer(tmp_path):
    """The hinge's frame is turned about y, so that its x axis points down."""
    front = "".join(
        limb(f"hinge{k}", f"0.3 {y} 0", "-1 0 0", rpy=f"0 {pi / 2} 0")
        + wheel(f"front{k}", "0 0 0", parent=f"hinge{k}")
        for k, y in enumerate((0.15, -0.15))
    )
    vehicle = read_vehicle(written(tmp_path, TWO + front))
    assert driven_straight(vehicle) == pytest.approx((0.0, 1.0), abs=1e-5)


def test_a_tyre_fixed_to_its_hub_is_the_wheel(tmp_path):
    """Its cylinder is turned in the tyre's frame, which is turned and moved in the hub's."""
    tyre = ROUND.format(0.1).replace('rpy="1.5707963267948966 0 0"', 'xyz="0 0 -0.02"')
    bolt = {"kind": "fixed", "shape": tyre, "rpy": f"{pi / 2} 0 0"}

    def hub(name, at):
        mounted = limb(f"{name}_tyre", "0 -0.02 0", parent=name, **bolt)
        return wheel(name, at, "") + mounted.replace(MASS, "")

    whole = read_vehicle(written(tmp_path, corners(wheel))).wheels
    found = read_vehicle(written(tmp_path, corners(hub))).wheels
    for one, other in zip(found, whole, strict=True):
        assert one.at == pytest.approx((other.at[0], other.at[1], 0), abs=1e-15)
        assert (one.radius, one.driven) == (other.radius, other.driven)


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_the_world_is_no_platform(kind, tmp_path):
    world = '<link name="world"/>' + joint("free", kind, "world", "base")
    vehicle = read_vehicle(written(tmp_path, FOUR + world))
    assert vehicle.notes[0] == "omitted, since they move the robot as a whole: free"
    assert replace(vehicle, notes=()) == replace(read_vehicle(written(tmp_path, FOUR)), notes=())


# URDFs whose names, actuators, places and shapes disagree, and of the lines offered

LIMIT = limit(-0.4, 0.4)
ROCKERS = [f"{side}_{part}_joint" for side in ("left", "right") for part in ("rocker", "bogie")]


def transmission(name, interface):
    kind = f"<hardwareInterface>hardware_interface/{interface}JointInterface</hardwareInterface>"
    return f'<transmission name="t"><joint name="{name}">{kind}</joint></transmission>'


def command(name, interface):
    tag = "state" if interface == "state" else "command"
    interface = f'<{tag}_interface name="{interface}"/>'
    return f'<ros2_control name="c"><joint name="{name}">{interface}</joint></ros2_control>'


def each(names, make, interface):
    return "".join(make(name, interface) for name in names)


def sized(front_left=0.1, front_right=0.1):
    parts = FOUR.split("<link")
    for k, radius in ((1, front_left), (2, front_right)):
        parts[k] = parts[k].replace(WHEEL, ROUND.format(radius))
    return "<link".join(parts)


def arms(word):
    """Return four wheels, of which two are on arms that turn about level axes."""
    return TWO + "".join(
        limb(f"{word}_{k}", f"0.5 {y} 0", more=LIMIT)
        + wheel(f"wheel_{k}", "0.1 0 0", parent=f"{word}_{k}")
        for k, y in enumerate((0.15, -0.15))
    )


PIVOTS = {word: [f"{word}_{k}_joint" for k in range(2)] for word in ("part", "leg")}


def car():
    """Return a car whose springs, steering and wheels all have effort transmissions."""
    parts = ""
    for end, x, side, y in CORNERS:
        name, post = f"{end}_{side}", f"{end}_{side}_shock"
        parts += pivot(post, f"{x} {y} 0", "0 0 -1", kind="prismatic", more=LIMIT)
        parts += transmission(f"{post}_joint", "Effort") + transmission(f"{name}_joint", "Effort")
        if x > 0:
            parts += limb(f"{name}_knuckle", "0 0 0", "0 0 1", post, more=LIMIT)
            parts += transmission(f"{name}_knuckle_joint", "Effort")
            post = f"{name}_knuckle"
        parts += wheel(name, "0 0 0", parent=post)
    return parts


FORCED = (
    TWO + each(["left_wheel_joint", "right_wheel_joint"], command, "velocity")
    + pivot("caster", "-0.3 0 0") + transmission("caster_joint", "Effort")
    + wheel("roll", "-0.04 0 -0.06", ROUND.format(0.04), parent="caster")
)  # fmt: skip
FREE_ROCKERS = {name: "suspension" for name in ROCKERS if name != "right_rocker_joint"}
SWAPPED = FOUR.replace("front_left", "old").replace("front_right", "front_left")
SPRING = '<gazebo reference="{}"><springStiffness>9</springStiffness></gazebo>'
# parts, kinds of the coordinates, words of a note
READ = {
    "rockers with efforts": (
        rocker_bogie() + each(ROCKERS, transmission, "Effort"),
        FREE_ROCKERS,
        "against it: effort transmission (commanded)",
    ),
    "rockers with efforts of ros2": (
        rocker_bogie() + each(ROCKERS, command, "effort"),
        FREE_ROCKERS,
        "against it: effort command interface (commanded)",
    ),
    "rockers with states": (
        rocker_bogie()
        + each(ROCKERS, transmission, "JointState") + each(ROCKERS, command, "state"),
        FREE_ROCKERS,
        "guessed suspension",
    ),
    "rockers with springs": (
        rocker_bogie() + "".join(map(SPRING.format, ROCKERS)) + each(ROCKERS, command, "position"),
        FREE_ROCKERS,
        "a spring in the simulator",
    ),
    "one side with an effort": (
        rocker_bogie() + each(ROCKERS[:2], transmission, "Effort"), FREE_ROCKERS, "differential"
    ),
    "car with efforts": (
        car(),
        dict.fromkeys(("front_left_knuckle_joint", "front_right_knuckle_joint"), "commanded"),
        "with so few wheels, it and its counterpart cannot follow the ground",
    ),
    "caster with an effort": (FORCED, {"caster_joint": "passive"}, "a caster or a trailer swivels"),
    "articulated frame": (
        TWO + limb("articulation", axis="0 0 1", more=LIMIT)
        + wheel("rear", "-0.3 0 0", parent="articulation"),
        {"articulation_joint": "commanded"},
        "no wheel has an actuator: left_wheel_joint",
    ),
    "actuated arms": (
        arms("leg") + each(PIVOTS["leg"], command, "position"),
        dict.fromkeys(PIVOTS["leg"], "commanded"),
        "guessed commanded",
    ),
    "swapped names": (
        SWAPPED.replace("old", "front_right"),
        {},
        "names of left and right disagree with the places of front_left_joint, front_right_joint",
    ),
    "one placeholder": (sized(0.02), {}, "shape of front_left_joint (0.02 m)"),
    "one large wheel": (sized(0.14), {}, "of radius 0.1 m: height above the ground of the other"),
    "radii that nearly agree": (sized(0.09), {}, "opposite wheels with different radii"),
    "radius of a plugin": (
        FOUR.replace(WHEEL, MESH)
        + plugin("libgazebo_ros_diff_drive.so", wheel_diameter=0.2, **DRIVEN),
        {},
        "its radius in a plugin of a simulator",
    ),
    "drive that contradicts": (
        FOUR + plugin("diff_drive", wheel_separation=0.6, wheel_radius=0.2, **CONTRADICTING),
        {},
        "a radius of 0.2 m instead of 0.1 m, a track of 0.6 m instead of 0.3 m, the wheels on the "
        "left as right ones, joints that are not in the file, gone",
    ),
    "long cylinders": (FOUR.replace('"0.05"', '"0.22"'), {}, "are radius and length exchanged"),
    "diameters": (FOUR.replace('"0.1"', '"0.3"'), None, "are they diameters"),
    "twin tyres": (
        FOUR.replace(WHEEL, WHEEL.replace('rpy="1', 'xyz="0 0.05 0" rpy="1')
                     + WHEEL.replace('rpy="1', 'xyz="0 -0.05 0" rpy="1')),
        {},
        "several shapes (2 cylinders of 0.1 m)",
    ),
    "tracks with wheels": (
        FOUR + fixed("left_track", "0 0 0"),
        {},
        "tracks are not modelled (left_track)",
    ),
    "unknown shapes": (
        FOUR + fixed("hood", "0 0 0", "<collision><geometry><ellipsoid/></geometry></collision>"),
        {},
        "link 'hood': a <ellipsoid> as <collision>",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_a_clear_choice_is_read_with_a_note(name, tmp_path):
    parts, kinds, words = READ[name]
    vehicle = read_vehicle(written(tmp_path, parts))
    assert {c.name: c.kind for c in vehicle.coordinates} == (kinds or {})
    assert any(words in note for note in vehicle.notes)
    if len(vehicle.wheels) == 4 and kinds == {}:
        assert [each.radius for each in vehicle.wheels[1:]] == [0.1] * 3
        assert np.allclose([abs(each.at[0]) for each in vehicle.wheels], 0.15)
    for line in offered("\n".join(vehicle.notes)):
        assert read_vehicle(written(tmp_path, parts, line)).wheels


@pytest.mark.slow
@pytest.mark.parametrize("name", READ)
def test_vehicles_of_offered_lines_stand_on_level_ground(name, tmp_path):
    parts, _, _ = READ[name]
    for line in offered("\n".join(read_vehicle(written(tmp_path, parts)).notes)):
        assert not describe(written(tmp_path, parts, line)).faults, line


BARE = FOUR.replace(WHEEL, "").replace("continuous", "fixed").replace("_left", "_left_wheel")
BARE = BARE.replace("_right", "_right_wheel")
UPRIGHT_AXLES = corners(wheel).replace('xyz="0 1 0"', 'xyz="0 0 1"')
TRACKS = fixed("leftTrack", "0 0.3 0") + fixed("rightTrack", "0 -0.3 0")
INCHES = wheels("{e}{s}", {"f": 9, "r": -9}, track=9, radius=3).replace('"1"', '"99"')
LEGS = "".join(limb(f"leg_{k}", more=LIMIT) for k in range(4))


# parts, words of the error, numbers of wheels and of coordinates by line
PLAIN = ((4, 0), (4, 0))
ASKED = {
    "named rockers with positions": (
        rocker_bogie() + each(ROCKERS, transmission, "Position"), "", ((6, 3), (6, 4))
    ),
    "arms with efforts": (
        arms("part") + each(PIVOTS["part"], transmission, "Effort"), "", ((4, 0), (4, 2))
    ),
    "two placeholders": (sized(0.01, 0.05), "", PLAIN),
    "names along the axles": (
        FOUR.replace('xyz="0 1 0"', 'xyz="1 0 0"').replace(f'"{pi / 2} 0 0"', f'"0 {pi / 2} 0"'),
        "correct the axes of the wheels, or write", PLAIN,
    ),
    "names against the axles": (
        wheels("{end}_{side}_wheel", {"front": -0.3, "rear": 0.3}),
        "names of front and rear (-x)", PLAIN,
    ),
    "numbers along the axles": (
        wheels("w{end}{side}", {"1": 0.3, "2": -0.3}, yaw=pi / 2).replace("left", "3")
        .replace("right", "4").replace('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>', 2),
        "no name distinguishes front from rear", PLAIN,
    ),
    "a wheel in the air": (FOUR.replace("0.2 -0.15 0", "0.2 -0.15 0.3", 1), "", ((4, 0), (3, 0))),
    "a wheel above the others": (
        corners(wheel).replace("-0.3 -0.2 0", "-0.3 -0.2 0.1"), "", ((4, 0), (3, 0))
    ),
    "a wheel in another": (FOUR.replace("-0.2 -0.15 0", "-0.2 0.15 0"), "at different places", ()),
    "centimetres": (wheels("{e}{s}", {"f": 9, "r": -9}, track=9, radius=2), "heavier than air", ()),
    "inches": (INCHES, "are all lengths in millimetres, centimetres or inches", ((4, 0),)),
    "upright axles": (
        UPRIGHT_AXLES, "the axles of the wheels are missing: front_left_wheel_joint, ", ()
    ),
    "tracks": (
        TRACKS, "tracks are not modelled (leftTrack, rightTrack): describe each as a row of", ()
    ),
    "plugin of tracks": (
        plugin("libTrackedVehicle.so"), "tracks are not modelled (libTrackedVehicle.so)", ()
    ),
    "legs": (
        LEGS, "legs are not modelled (leg_0_joint, leg_1_joint, leg_2_joint, leg_3_joint)", ()
    ),
    "two wheels": (TWO, "add wheels to the URDF", ()),
    "wheels by name alone": (BARE, "add wheels to the URDF", ((4, 0),)),
}  # fmt: skip


@pytest.mark.parametrize("name", ASKED)
def test_what_is_missing_or_contradicts_asks_with_lines_that_answer(name, tmp_path):
    parts, words, numbers = ASKED[name]
    caught = error_of(VehicleError, read_vehicle, written(tmp_path, parts))
    assert words in str(caught)
    lines = offered(str(caught))
    for line, counts in zip(lines, numbers, strict=True):
        path = written(tmp_path, parts, line)
        vehicle = read_vehicle(path)
        assert (len(vehicle.wheels), len(vehicle.coordinates)) == counts
        assert min(each.radius for each in vehicle.wheels) >= 0.05
        assert not describe(path).faults
    assert not offered("\n".join(caught.draft.notes))


def test_an_idle_wheel_with_an_actuator_is_driven_with_a_note(tmp_path):
    parts = FOUR.replace("rear", "idle") + each(["idle_left_joint"], command, "velocity")
    vehicle = read_vehicle(written(tmp_path, parts))
    driven = {each.name for each in vehicle.wheels if each.driven}
    assert driven == {"idle_left_joint"}
    assert any("it has an actuator; against it: its name (free)" in n for n in vehicle.notes)
