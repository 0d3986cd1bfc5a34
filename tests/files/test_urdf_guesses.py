"""Tests of incomplete URDFs: guesses, their notes, contradictions, and the lines offered."""

from dataclasses import replace
from math import pi

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
    link,
    offered,
    rocker_bogie,
    wheel,
    written,
)
from slipfree import Analytic, direct_kinematics, settle, simulate
from slipfree.control.path_following import straight
from slipfree.problem.build_vehicle import VehicleError, read_vehicle
from slipfree.problem.report import describe
from slipfree.vehicle.sections import Omni, Sphere


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
    link("rocker")
    + joint("rocker_pivot", "revolute", "base", "rocker", "0 0.2 0.1")
    + link("post")
    + joint("steer", "revolute", "rocker", "post", "0.3 0 0", axis="0 0 1")
    + wheel("front", "0 0 -0.1", parent="post")
    + wheel("rear", "-0.3 0 -0.1", parent="rocker")
    + wheel("front_right", "0.3 -0.2 0")
    + wheel("rear_right", "-0.3 -0.2 0")
    + link("arm")
    + joint("elbow", "revolute", "base", "arm", "0 0 0.3")
    + link("mast")
    + joint("tilt", "revolute", "base", "mast", more='<limit lower="0" upper="0"/>')
)


def test_kinds_of_joints_follow_from_their_axes_and_wheels(tmp_path):
    vehicle = read_vehicle(written(tmp_path, ROVER))
    kinds = {c.name: c.kind for c in vehicle.coordinates}
    assert kinds == {"rocker_pivot": "suspension", "steer": "commanded"}
    reasons = " ".join(notes(vehicle))
    for words in ("it carries no wheel: elbow", "its limits are equal: tilt", "steers it: steer"):
        assert words in reasons
    given = read_vehicle(written(tmp_path, ROVER, 'joints = { rocker_pivot = "fixed" }'))
    assert [c.name for c in given.coordinates] == ["steer"]


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


BOX = '<collision><geometry><box size="0.02 0.02 0.06"/></geometry></collision>'
CASTERS = [wheel("back_caster", "-0.2 0 -0.06", s, kind="fixed") for s in (BOX, ROUND.format(0.03))]
ON_FIXED = "".join(
    wheel(f"wheel_{k}", f"{x} {y} 0", kind="fixed")
    + f'<transmission name="t{k}"><joint name="wheel_{k}_joint"/></transmission>'
    for k, (x, y) in enumerate([(0.2, 0.2), (0.2, -0.2), (-0.2, 0)])
)


@pytest.mark.slow
@pytest.mark.parametrize(
    "parts", [FOUR, ROVER, "".join(mesh_robot()), TWO + CASTERS[0], ON_FIXED, rocker_bogie()]
)
def test_the_written_completion_has_all_guesses(parts, tmp_path):
    file = written(tmp_path, parts)
    guessed = read_vehicle(file)
    out = tmp_path / "full.toml"
    invoke("vehicle", file, "--write", out, code=0)
    again = read_vehicle(out)
    assert (again.wheels, again.coordinates, again.joints) == (
        guessed.wheels,
        guessed.coordinates,
        guessed.joints,
    )
    assert not notes(again)
    assert "{  }" not in out.read_text()
    assert "--force" in refused("vehicle", file, "--write", out)


def test_steering_hinges_with_turned_frames_steer(tmp_path):
    """The hinge's frame is turned about y, so that its x axis points down."""
    front = "".join(
        link(f"hinge{k}")
        + joint(
            f"steer{k}",
            "revolute",
            "base",
            f"hinge{k}",
            f"0.3 {y} 0",
            axis="-1 0 0",
            rpy="0 1.5707963267948966 0",
        )
        + wheel(f"front{k}", "0 0 0", parent=f"hinge{k}")
        for k, y in enumerate((0.15, -0.15))
    )
    vehicle = read_vehicle(written(tmp_path, TWO + front))
    assert driven_straight(vehicle) == pytest.approx((0.0, 1.0), abs=1e-5)


def test_a_tyre_fixed_to_its_hub_is_the_wheel(tmp_path):
    """Its cylinder is turned in the tyre's frame, which is turned and moved in the hub's."""
    whole = read_vehicle(written(tmp_path, FOUR)).wheels
    tyre = ROUND.format(0.1).replace('rpy="1.5707963267948966 0 0"', 'xyz="0 0 -0.02"')
    parts = "".join(
        wheel(f"{end}_{side}", f"{x} {y} 0", "")
        + link(f"{end}_{side}_tyre", tyre).replace(MASS, "")
        + joint(
            f"{end}_{side}_bolt",
            "fixed",
            f"{end}_{side}",
            f"{end}_{side}_tyre",
            "0 -0.02 0",
            rpy="1.5707963267948966 0 0",
        )
        for end, x in (("front", 0.2), ("rear", -0.2))
        for side, y in (("left", 0.15), ("right", -0.15))
    )
    found = read_vehicle(written(tmp_path, parts)).wheels
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

LIMIT = '<limit lower="-0.4" upper="0.4" effort="1" velocity="1"/>'
ROCKERS = [f"{side}_{part}_joint" for side in ("left", "right") for part in ("rocker", "bogie")]
WHEELS = [f"{end}_{side}_joint" for end in ("front", "rear") for side in ("left", "right")]

DRIVEN = dict(zip("abcd", WHEELS, strict=True))


def transmission(name, interface):
    kind = f"<hardwareInterface>hardware_interface/{interface}JointInterface</hardwareInterface>"
    return f'<transmission name="t"><joint name="{name}">{kind}</joint></transmission>'


def command(name, interface):
    tag = "state" if interface == "state" else "command"
    interface = f'<{tag}_interface name="{interface}"/>'
    return f'<ros2_control name="c"><joint name="{name}">{interface}</joint></ros2_control>'


def each(names, make, interface):
    return "".join(make(name, interface) for name in names)


def plugin(name, **elements):
    inside = "".join(f"<{key}>{value}</{key}>" for key, value in elements.items())
    return f'<gazebo><plugin filename="{name}" name="p">{inside}</plugin></gazebo>'


def sized(front_left=0.1, front_right=0.1):
    parts = FOUR.split("<link")
    for k, radius in ((1, front_left), (2, front_right)):
        parts[k] = parts[k].replace(WHEEL, ROUND.format(radius))
    return "<link".join(parts)


def arms(word):
    """Return four wheels, of which two are on arms that turn about level axes."""
    return TWO + "".join(
        link(f"{word}_{k}")
        + joint(f"{word}_{k}_pivot", "revolute", "base", f"{word}_{k}", f"0.5 {y} 0", more=LIMIT)
        + wheel(f"wheel_{k}", "0.1 0 0", parent=f"{word}_{k}")
        for k, y in enumerate((0.15, -0.15))
    )


PIVOTS = {word: [f"{word}_{k}_pivot" for k in range(2)] for word in ("part", "leg")}


def car():
    """Return a car whose springs, steering and wheels all have effort transmissions."""
    parts = ""
    for name, x, y in (
        (f"{end}_{side}", x, y)
        for end, x in (("front", 0.5), ("rear", -0.5))
        for side, y in (("left", 0.15), ("right", -0.15))
    ):
        post = f"{name}_shock"
        at = f"{x} {y} 0"
        parts += link(post)
        parts += joint(f"{post}_joint", "prismatic", "base", post, at, "0 0 -1", more=LIMIT)
        parts += transmission(f"{post}_joint", "Effort") + transmission(f"{name}_joint", "Effort")
        if x > 0:
            knuckle = f"{name}_steer"
            parts += link(knuckle) + transmission(knuckle, "Effort")
            parts += joint(knuckle, "revolute", post, knuckle, axis="0 0 1", more=LIMIT)
            post = knuckle
        parts += wheel(name, "0 0 0", parent=post)
    return parts


SWIVEL = (
    TWO + each(["left_wheel_joint", "right_wheel_joint"], command, "velocity") + link("caster")
    + joint("swivel", "continuous", "base", "caster", "-0.3 0 0", "0 0 1")
    + transmission("swivel", "Effort")
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
        dict.fromkeys(("front_left_steer", "front_right_steer"), "commanded"),
        "with so few wheels, it and its counterpart cannot follow the ground",
    ),
    "caster with an effort": (SWIVEL, {"swivel": "passive"}, "a caster or a trailer swivels"),
    "articulated frame": (
        TWO + link("hitch") + wheel("rear", "-0.3 0 0", parent="hitch")
        + joint("articulation_joint", "revolute", "base", "hitch", axis="0 0 1", more=LIMIT),
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
    "twin tyres": (
        FOUR.replace(WHEEL, WHEEL.replace('rpy="1', 'xyz="0 0.05 0" rpy="1')
                     + WHEEL.replace('rpy="1', 'xyz="0 -0.05 0" rpy="1')),
        {},
        "several shapes (2 cylinders of 0.1 m)",
    ),
    "tracks with wheels": (
        FOUR + link("left_track") + joint("belt", "fixed", "base", "left_track"),
        {},
        "tracks are not modelled (left_track)",
    ),
    "unknown shapes": (
        FOUR + link("hood", "<collision><geometry><ellipsoid/></geometry></collision>")
        + joint("hood_joint", "fixed", "base", "hood"),
        {},
        "link 'hood': a <ellipsoid> as <collision>",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_a_clear_choice_is_read_with_a_note(name, tmp_path):
    parts, kinds, words = READ[name]
    vehicle = read_vehicle(written(tmp_path, parts))
    assert {c.name: c.kind for c in vehicle.coordinates} == kinds
    assert any(words in note for note in vehicle.notes)
    if len(vehicle.wheels) == 4 and not kinds:
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


# parts, number of lines, of wheels and of coordinates by line
ASKED = {
    "named rockers with positions": (
        rocker_bogie() + each(ROCKERS, transmission, "Position"), 6, (3, 4)
    ),
    "arms with efforts": (arms("part") + each(PIVOTS["part"], transmission, "Effort"), 4, (0, 2)),
    "two placeholders": (sized(0.01, 0.05), 4, (0, 0)),
    "names along the axles": (
        FOUR.replace('xyz="0 1 0"', 'xyz="1 0 0"').replace(f'"{pi / 2} 0 0"', f'"0 {pi / 2} 0"'),
        4, (0, 0),
    ),
    "a wheel in the air": (FOUR.replace("0.2 -0.15 0", "0.2 -0.15 0.3", 1), 4, (0, 0)),
}  # fmt: skip


@pytest.mark.parametrize("name", ASKED)
def test_a_contradiction_asks_with_lines_that_answer(name, tmp_path):
    parts, count, coordinates = ASKED[name]
    caught = error_of(VehicleError, read_vehicle, written(tmp_path, parts))
    lines = offered(str(caught))
    assert len(lines) == 2
    for line, number in zip(lines, coordinates, strict=True):
        path = written(tmp_path, parts, line)
        vehicle = read_vehicle(path)
        assert len(vehicle.wheels) in (count, 3)
        assert len(vehicle.coordinates) == number
        assert min(each.radius for each in vehicle.wheels) >= 0.05
        assert not describe(path).faults
    assert not offered("\n".join(caught.draft.notes))


BARE = FOUR.replace(WHEEL, "").replace("continuous", "fixed").replace("_left", "_left_wheel")
BARE = BARE.replace("_right", "_right_wheel")
STEERING = "".join(
    wheel(f"w{k}", f"{x} {y} 0").replace('xyz="0 1 0"', 'xyz="0 0 1"')
    for k, (x, y) in enumerate(((0.2, 0.2), (0.2, -0.2), (-0.2, 0.2), (-0.2, -0.2)))
)
TRACKS = "".join(
    link(f"{side}Track") + joint(f"{side}_joint", "fixed", "base", f"{side}Track", f"0 {y} 0")
    for side, y in (("left", 0.3), ("right", -0.3))
)
LEGS = "".join(
    link(f"leg_{k}") + joint(f"hip_{k}", "revolute", "base", f"leg_{k}", more=LIMIT)
    for k in range(4)
)


@pytest.mark.parametrize(
    ("parts", "words", "count"),
    [
        (STEERING, "the axles of the wheels are missing: w0_joint, w1_joint", 0),
        (TRACKS, "tracks are not modelled (leftTrack, rightTrack): describe each as a row of", 0),
        (plugin("libTrackedVehicle.so"), "tracks are not modelled (libTrackedVehicle.so)", 0),
        (LEGS, "legs are not modelled (hip_0, hip_1, hip_2, hip_3)", 0),
        (TWO, "add wheels to the URDF", 0),
        (BARE, "add wheels to the URDF", 1),
    ],
)
def test_what_is_missing_is_named_and_remedies_work(parts, words, count, tmp_path):
    caught = error_of(VehicleError, read_vehicle, written(tmp_path, parts))
    assert words in str(caught)
    lines = offered(str(caught))
    assert len(lines) == count
    for line in lines:
        assert len(read_vehicle(written(tmp_path, parts, line)).wheels) == 4


def test_mecanum_wheels_of_a_plugin_have_rollers(tmp_path):
    joints = dict(zip("abcd", WHEELS, strict=True))
    vehicle = read_vehicle(
        written(tmp_path, FOUR + plugin("gz-sim-mecanum-drive-system", **joints))
    )
    assert all(isinstance(each.section, Omni) for each in vehicle.wheels)


def test_an_idle_wheel_with_an_actuator_is_driven_with_a_note(tmp_path):
    parts = FOUR.replace("rear", "idle") + each(["idle_left_joint"], command, "velocity")
    vehicle = read_vehicle(written(tmp_path, parts))
    driven = {each.name for each in vehicle.wheels if each.driven}
    assert driven == {"idle_left_joint"}
    assert any("it has an actuator; against it: its name (free)" in n for n in vehicle.notes)
