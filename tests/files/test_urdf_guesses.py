"""Tests of incomplete URDFs: guesses, their notes, and the vehicle file that contains them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from helpers.commands import invoke, refused
from helpers.urdf import (
    FOUR,
    MASS,
    MESH,
    ROUND,
    TWO,
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
from slipfree.vehicle.sections import Omni


def notes(vehicle):
    return [note for note in vehicle.notes if note.startswith("guessed")]


def driven_straight(vehicle):
    """Return the end of 5 s at 0.2 m/s on level ground."""
    dae = direct_kinematics(vehicle, Analytic(lambda x, y: 0 * x * y))
    start = settle(dae)
    run = simulate(dae, start, straight(dae, start, speed=0.2), np.linspace(0, 5, 11))
    return run["x"][-1], run["y"][-1]


def test_wheels_without_actuators_are_driven(tmp_path):
    vehicle = read_vehicle(written(tmp_path, FOUR))
    assert [each.driven for each in vehicle.wheels] == [True] * 4
    (note,) = notes(vehicle)
    assert note.startswith("guessed driven: no wheel has an actuator: front_left_joint, ")
    free = read_vehicle(written(tmp_path, FOUR, note.split("otherwise write ")[1]))
    assert [each.driven for each in free.wheels] == [False, True, True, True]


@pytest.mark.parametrize(
    ("shape", "radius"),
    [
        ('<collision><geometry><sphere radius="0.04"/></geometry></collision>', 0.04),
        (
            '<collision><origin xyz="0 0 -0.01"/>'
            '<geometry><box size="0.02 0.02 0.06"/></geometry></collision>',
            0.04,
        ),
    ],
)
def test_a_fixed_caster_is_a_ball(shape, radius, tmp_path):
    caster = wheel("back_caster", "-0.2 0 -0.06", shape, kind="fixed")
    vehicle = read_vehicle(written(tmp_path, TWO + caster))
    ball = vehicle.wheels[-1]
    assert isinstance(ball.section, Omni)
    assert ball.radius == pytest.approx(radius)
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
    with pytest.raises(VehicleError) as caught:
        read_vehicle(written(tmp_path, wheels))
    (line,) = offered(str(caught.value))
    vehicle = read_vehicle(written(tmp_path, wheels, line))
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
