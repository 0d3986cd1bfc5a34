"""Guesses that complete a URDF: wheels without a round shape, casters, kinds of joints."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slipfree.files.urdf.frames import STEEP, fixed_to_turning, is_last, is_level, link_frames
from slipfree.files.urdf.roles import Roles
from slipfree.files.urdf.tree import Box, Tree, UrdfJoint
from slipfree.files.vehicle_draft import rotation_of
from slipfree.geometry.frame import unit_vector
from slipfree.records import Array
from slipfree.vehicle.tree import Kind

WHEEL = re.compile("wheel|tire|tyre", re.IGNORECASE)
CASTER = re.compile("cast[eo]r", re.IGNORECASE)
FOOTPRINT = re.compile("footprint", re.IGNORECASE)  # link on the ground, by REP 120
BALL = "a caster on a fixed joint slides freely as a ball"
ALONG = 0.9  # if the components of all axles along x are at least this large, y or -y is forward


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


def wheel_guesses(
    tree: Tree, joints: Sequence[UrdfJoint], radius: float | None
) -> dict[str, WheelGuess]:
    """Return the wheels that joints probably carry, by name of the joint.

    A name such as "wheel" or "caster" counts only together with a shape, a height or a radius, and
    only if no joint moves below. All wheels with a radius from the height have that of the lowest
    one.

    Parameters
    ----------
    tree : Tree
        The URDF.
    joints : sequence of UrdfJoint
        Joints whose links are not known to be wheels.
    radius : float or None
        Rolling radius of wheels whose link has no round shape; None if unknown. [m]
    """
    frames, on_hubs = link_frames(tree), fixed_to_turning(tree)
    grounds = [frames[each][1][2] for each in tree.links if FOOTPRINT.search(each)]
    found: dict[str, WheelGuess] = {}
    heights: dict[str, float] = {}
    for joint in joints:
        link, name = tree.links[joint.child], f"{joint.name} {joint.child}"
        rotation, origin = frames[joint.child]
        if joint.type not in ("fixed", "continuous") or not is_last(tree, joint):
            continue
        if joint.name in on_hubs:
            continue
        if not joint.moves and CASTER.search(name):
            depth = max((_depth(box, rotation) for box in link.boxes), default=0.0)
            if link.shapes:
                found[joint.name] = WheelGuess(None, True, f"{BALL}, with the radius of its shape")
            elif depth > 0:
                reason = f"{BALL}, with the radius to its lowest point"
                found[joint.name] = WheelGuess(depth, True, reason)
        elif joint.moves and (abs(float((rotation @ unit_vector(joint.axis))[2])) > STEEP):
            continue
        elif joint.moves and radius and link.meshes and not link.shapes:
            found[joint.name] = WheelGuess(radius, False, "a mesh, with the given radius")
        elif WHEEL.search(name) and link.shapes:
            found[joint.name] = WheelGuess(None, False, "its name and a round shape")
        elif WHEEL.search(name) and link.meshes and grounds and origin[2] > grounds[0]:
            heights[joint.name] = float(origin[2] - grounds[0])
    lowest = min(heights.values(), default=0.0)
    reason = "its name, without a round shape; radius from the least height above the footprint"
    return found | {name: WheelGuess(lowest, False, reason) for name in heights}


def _depth(box: Box, rotation: Array) -> float:
    """Return the depth of the lowest point of a box below the origin of its link [m]."""
    half = np.abs((rotation @ rotation_of(box.turned))[2]) @ np.asarray(box.size) / 2
    return float(half - rotation[2] @ np.asarray(box.at))


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
        Number of suspension coordinates that the vehicle can have in addition to the existing ones.
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


def forward_guess(tree: Tree, roles: Roles) -> str:
    """Return the axis of the root link that probably points forward: ``"x"``, ``"y"`` or ``"-y"``.

    It is ``"y"`` or ``"-y"`` if the axles of all wheels but casters are along x. Then the wheels
    roll forward for positive rates of most joints.
    """
    frames = link_frames(tree)
    axles = [
        float((frames[joint.child][0] @ unit_vector(joint.axis))[0])
        for joint in tree.joints.values()
        if joint.type == "continuous"
        and joint.name not in roles.joints
        and is_last(tree, joint)
        and (tree.links[joint.child].shapes or tree.links[joint.child].meshes)
        and not CASTER.search(f"{joint.name} {joint.child}")
        and is_level(tree, joint)
    ]
    if not axles or min(map(abs, axles)) < ALONG:
        return "x"
    return "-y" if sum(axles) > 0 else "y"
