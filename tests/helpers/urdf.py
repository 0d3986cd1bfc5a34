"""URDFs in the form that an independent library accepts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree

import adam.numpy


def adam_model(urdf: str, joints: Sequence[str]) -> Any:
    """Return adam's model of a URDF, completed with all elements that adam requires."""
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
