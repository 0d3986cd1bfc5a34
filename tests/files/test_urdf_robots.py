"""Tests of URDFs in the style of many robots: their wheels, casters, joints and forward axis."""

from math import cos, pi, sin

import numpy as np
import pytest

from helpers.commands import error_of
from helpers.urdf import (
    FOUR,
    MESH,
    ROUND,
    TWO,
    WHEEL,
    joint,
    link,
    rocker_bogie,
    sphere,
    wheel,
    wheels,
    written,
)
from slipfree import Analytic, direct_kinematics, settle
from slipfree.problem.build_vehicle import VehicleError, read_vehicle
from slipfree.vehicle.sections import Omni

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
    return link(name) + joint(f"{name}_joint", kind, parent, name, at, axis, more=more)


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


def test_evidence_that_disagrees_is_a_question_or_a_note(tmp_path):
    for parts, words in (
        (
            wheels("{end}_{side}_wheel", {"front": -0.3, "rear": 0.3}),
            "names of front and rear (-x)",
        ),
        (
            FOUR.replace('xyz="0 1 0"', 'xyz="1 0 0"').replace(
                f'"{pi / 2} 0 0"', f'"0 {pi / 2} 0"'
            ),
            "correct the axes of the wheels, or write",
        ),
        (
            wheels("w{end}{side}", {"1": 0.3, "2": -0.3}, yaw=pi / 2)
            .replace("left", "3")
            .replace("right", "4")
            .replace('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>', 2),
            "no name distinguishes front from rear",
        ),
    ):
        caught = error_of(VehicleError, read_vehicle, written(tmp_path, parts))
        assert words in str(caught)
        line = str(caught).split("write ")[1].split(" or ")[0]
        assert len(read_vehicle(written(tmp_path, parts, line)).wheels) == 4
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
    with pytest.raises(VehicleError) as caught:
        read_vehicle(written(tmp_path, rocker_bogie(mounts=True), line))
    assert words in str(caught.value)


def test_unused_names_of_wheels_are_named(tmp_path):
    notes = read_vehicle(written(tmp_path, FOUR + fixed("spare_wheel", "0 0 0.5", BOX))).notes
    words = "no wheels in spite of their names: spare_wheel_joint; otherwise write wheels.spare"
    assert any(note.startswith(words) for note in notes)
