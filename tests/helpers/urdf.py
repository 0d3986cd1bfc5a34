"""URDFs as text, and in the form accepted by an independent library."""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

ROUND = (
    '<collision><origin rpy="1.5707963267948966 0 0"/>'
    '<geometry><cylinder radius="{}" length="0.05"/></geometry></collision>'
)
WHEEL = ROUND.format(0.1)
MESH = '<visual><geometry><mesh filename="package://a/wheel.dae"/></geometry></visual>'
MASS = '<inertial><mass value="1"/></inertial>'


def link(name, shape=""):
    return f'<link name="{name}">{MASS}{shape}</link>'


def joint(name, kind, parent, child, at="0 0 0", axis="0 1 0", rpy="0 0 0", more=""):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at}" rpy="{rpy}"/><axis xyz="{axis}"/>{more}</joint>'
    )


def limb(
    name, at="0 0 0", axis="0 1 0", parent="base", kind="revolute", shape="", rpy="0 0 0", more=""
):
    """Return a link and the joint that carries it, with the name of the link and ``_joint``."""
    carrier = joint(f"{name}_joint", kind, parent, name, at, axis, rpy, more)
    return link(name, shape) + carrier


def wheel(name, at, shape=WHEEL, parent="base", kind="continuous"):
    return limb(name, at, parent=parent, kind=kind, shape=shape)


FOUR = "".join(
    wheel(f"{end}_{side}", f"{x} {y} 0")
    for end, x in (("front", 0.2), ("rear", -0.2))
    for side, y in (("left", 0.15), ("right", -0.15))
)
TWO = wheel("left_wheel", "0 0.15 0") + wheel("right_wheel", "0 -0.15 0")


def sphere(radius):
    return f'<collision><geometry><sphere radius="{radius}"/></geometry></collision>'


def wheels(
    name, ends, *, track=0.4, radius=0.1, yaw=0.0, parent="base", kind="continuous", more=""
):
    """Return wheels at both sides of axles: ``name`` has the fields ``end`` and ``side``.

    ``ends`` has the coordinate of each axle along the robot; the robot is turned by ``yaw`` in the
    frame of its parent.
    """
    sin, cos = round(math.sin(yaw), 9), round(math.cos(yaw), 9)
    parts = ""
    for end, along in ends.items():
        for side, y in (("left", track / 2), ("right", -track / 2)):
            full = name.format(end=end, side=side, e=end[:1], s=side[0])
            at = f"{along * cos - y * sin} {along * sin + y * cos} 0"
            turned = f"0 0 {yaw}"
            parts += link(f"{full}_link", ROUND.format(radius))
            parts += joint(full, kind, parent, f"{full}_link", at, rpy=turned, more=more)
    return parts


def rocker_bogie(bogies=True, axes=("0 1 0", "0 1 0"), mounts=False):
    """Return a rover without a differential: rockers, bogies and six wheels, or four wheels."""
    parts = ""
    for side, y, axis in (("left", 0.3, axes[0]), ("right", -0.3, axes[1])):
        carrier, at = "base", f"0 {y} 0.1"
        if mounts:
            parts += limb(f"{side}_mount", at, kind="fixed")
            carrier, at = f"{side}_mount", "0 0 0"
        limit = '<limit lower="-0.5" upper="0.5" effort="0" velocity="1"/>'
        parts += limb(f"{side}_rocker", at, axis, carrier, more=limit)
        parts += wheel(f"{side}_front", "0.35 0 -0.2", parent=f"{side}_rocker")
        if not bogies:
            parts += wheel(f"{side}_rear", "-0.35 0 -0.2", parent=f"{side}_rocker")
            continue
        parts += limb(f"{side}_bogie", "-0.2 0 -0.1", axis, f"{side}_rocker", more=limit)
        for end, x in (("mid", 0.15), ("rear", -0.15)):
            parts += wheel(f"{side}_{end}", f"{x} 0 -0.1", parent=f"{side}_bogie")
    return parts


KEY = "(?:forward|radius|tube|couple|joints|wheels)"
LINE = re.compile(
    rf"(?:write|or) ({KEY}[^ ]* = .+?)(?= or {KEY}|; |, the |, in a |$)", re.MULTILINE
)


def offered(text: str) -> list[str]:
    """Return the lines of vehicle files that messages and notes offer."""
    return LINE.findall(text)


def written(folder: Path, parts: str, completion: str | None = None) -> Path:
    """Write a robot with a link ``base`` and further parts, and a vehicle file if given."""
    file = folder / "robot.urdf"
    file.write_text(f'<robot name="r">{link("base")}{parts}</robot>')
    if completion is None:
        return file
    (folder / "robot.toml").write_text(f'urdf = "robot.urdf"\n{completion}')
    return folder / "robot.toml"


def adam_model(urdf: str, joints: Sequence[str]) -> Any:
    """Return adam's model of a URDF, completed with all elements that adam requires."""
    import adam.numpy  # takes a second

    robot = ElementTree.fromstring(urdf)
    for each in [*robot.findall("transmission"), *robot.findall("ros2_control")]:
        robot.remove(each)
    inertials = robot.findall("link/inertial")
    for each in [*robot.findall("joint"), *inertials]:
        if each.find("origin") is None:
            ElementTree.SubElement(each, "origin")
    for each in robot.findall("joint"):
        if each.find("axis") is None:
            ElementTree.SubElement(each, "axis", xyz="1 0 0")
    for each in robot.iter("origin"):
        each.attrib = {"xyz": "0 0 0", "rpy": "0 0 0"} | each.attrib
    for each in inertials:
        moments = {"ixx": "1", "iyy": "1", "izz": "1", "ixy": "0", "ixz": "0", "iyz": "0"}
        ElementTree.SubElement(each, "inertia", moments)
    return adam.numpy.KinDynComputations(ElementTree.tostring(robot, encoding="unicode"), [*joints])
