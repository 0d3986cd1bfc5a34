"""Guesses of what a URDF does not say: wheels without a round shape, casters, kinds of joints."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slipfree.files.urdf.tree import Box, Tree, UrdfJoint
from slipfree.files.vehicle_draft import rotation_of
from slipfree.geometry.frame import Vector, unit_vector
from slipfree.records import Array
from slipfree.vehicle.tree import Kind

WHEEL = re.compile("wheel|tire|tyre", re.IGNORECASE)
CASTER = re.compile("cast[eo]r", re.IGNORECASE)
FOOTPRINT = re.compile("footprint", re.IGNORECASE)  # link on the ground, by REP 120
BALL = "a caster on a fixed joint slides freely as a ball"
FORWARD_YAW = {"x": 0.0, "y": np.pi / 2, "-x": np.pi, "-y": -np.pi / 2}  # of the axes [rad]
STEEP = 0.5  # smallest vertical component of the axis of a steering joint


class WheelGuess(NamedTuple):
    """A wheel that a URDF does not describe completely.

    Attributes
    ----------
    radius : float or None
        Rolling radius; None for that of the shape in the URDF. [m]
    is_ball : bool
        Whether the wheel slides freely in all directions, as a caster on a fixed joint does.
    reason : str
        Reason for the guess.
    """

    radius: float | None
    is_ball: bool
    reason: str


def link_frames(tree: Tree) -> dict[str, tuple[Array, Array]]:
    """Return rotation and origin [m] of each link in the root, with all joints at zero."""
    frames = {tree.root: (np.eye(3), np.zeros(3))}
    for joint in tree.joints.values():
        rotation, origin = frames[joint.parent]
        frames[joint.child] = (
            rotation @ rotation_of(joint.turned),
            origin + rotation @ np.asarray(joint.at),
        )
    return frames


def wheel_guesses(
    tree: Tree, joints: Sequence[UrdfJoint], radius: float | None
) -> dict[str, WheelGuess]:
    """Return the wheels that joints probably carry, by name of the joint.

    Names count only together with a shape, a height or a radius, and only if no joint moves below.
    All wheels with a radius from the height have that of the lowest one.

    Parameters
    ----------
    tree : Tree
        The URDF.
    joints : sequence of UrdfJoint
        Joints whose links are not known to be wheels.
    radius : float or None
        Rolling radius of wheels whose link has no round shape; None if unknown. [m]
    """
    frames = link_frames(tree)
    grounds = [frames[each][1][2] for each in tree.links if FOOTPRINT.search(each)]
    found: dict[str, WheelGuess] = {}
    heights: dict[str, float] = {}
    for joint in joints:
        link, name = tree.links[joint.child], f"{joint.name} {joint.child}"
        rotation, origin = frames[joint.child]
        if joint.type not in ("fixed", "continuous") or any(
            below.moves for below in tree.below(joint.child)
        ):
            continue
        if not joint.moves and CASTER.search(name):
            depth = max((_depth(box, rotation) for box in link.boxes), default=0.0)
            if link.shapes:
                found[joint.name] = WheelGuess(None, True, f"{BALL}, with its radius")
            elif depth > 0:
                found[joint.name] = WheelGuess(depth, True, f"{BALL}, as high as its shape")
        elif joint.moves and (abs(float((rotation @ unit_vector(joint.axis))[2])) > STEEP):
            continue
        elif joint.moves and radius and link.meshed and not link.shapes:
            found[joint.name] = WheelGuess(radius, False, "a mesh, with the given radius")
        elif WHEEL.search(name) and link.shapes:
            found[joint.name] = WheelGuess(None, False, "its name and a round shape")
        elif WHEEL.search(name) and link.meshed and grounds and origin[2] > grounds[0]:
            heights[joint.name] = float(origin[2] - grounds[0])
    lowest = min(heights.values(), default=0.0)
    reason = "meshes are not read; radius from the least height above the footprint"
    return found | {name: WheelGuess(lowest, False, reason) for name in heights}


def _depth(box: Box, rotation: Array) -> float:
    """Return the depth of the lowest point of a box below the origin of its link [m]."""
    half = np.abs((rotation @ rotation_of(box.turned))[2]) @ np.asarray(box.size) / 2
    return float(half - rotation[2] @ np.asarray(box.at))


def is_level(tree: Tree, joint: UrdfJoint) -> bool:
    """Return whether the axis of a joint is nearly level, with all joints at zero."""
    rotation, _ = link_frames(tree)[joint.child]
    return abs(float((rotation @ unit_vector(joint.axis))[2])) <= STEEP


def joint_guess(
    tree: Tree, joint: UrdfJoint, wheels: frozenset[str], most: int
) -> tuple[Kind | None, str]:
    """Return the probable kind of a joint without a role, None for fixed, and the reason.

    Parameters
    ----------
    tree : Tree
        The URDF.
    joint : UrdfJoint
        The joint.
    wheels : frozenset of str
        Names of the joints that carry wheels.
    most : int
        Number of suspension coordinates that the vehicle can have besides those already guessed.
    """
    carried = [each for each in tree.below(joint.child) if each.name in wheels]
    if not carried:
        return None, "it carries no wheel"
    if not is_level(tree, joint):
        if CASTER.search(f"{joint.name} {joint.child}"):
            return "passive", "a caster swivels"
        return "commanded", "a steep axis above a wheel steers it"
    if most > 0:
        return "suspension", "a level axis above wheels follows the ground"
    return None, "with so few wheels, a level axis above them cannot follow the ground"


def facing_forward(tree: Tree, forward: str) -> Tree:
    """Return a URDF whose root is turned so that an axis of it, such as ``"-y"``, becomes x."""
    yaw = FORWARD_YAW[forward]
    back = rotation_of((0.0, 0.0, -yaw))

    def turned(at: Vector) -> Vector:
        x, y, z = (float(each) for each in back @ np.asarray(at))
        return x, y, z

    joints = {
        name: joint._replace(
            at=turned(joint.at),
            turned=(joint.turned[0], joint.turned[1], joint.turned[2] - yaw),
        )
        if joint.parent == tree.root
        else joint
        for name, joint in tree.joints.items()
    }
    root = tree.links[tree.root]
    links = tree.links | {tree.root: root._replace(center=turned(root.center))}
    return tree._replace(links=links, joints=joints)
