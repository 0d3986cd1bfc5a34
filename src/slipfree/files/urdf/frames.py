"""Frames of the links of a URDF with all joints at zero."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from slipfree.files.urdf.tree import Shape, Tree, UrdfJoint
from slipfree.files.vehicle_draft import rotation_of
from slipfree.geometry.frame import Vector, unit_vector
from slipfree.geometry.tensor import in_axes
from slipfree.records import Array

WHEEL = re.compile("wheel|tire|tyre", re.IGNORECASE)
MIRROR = 0.05  # largest distance from a mirror image, in distances from the root's origin
MAX_ECCENTRICITY = 1e-3  # largest distance of a wheel's centre from its axis, in radii
STEEP = 0.5  # largest vertical component of a level axis, such as an axle
FORWARD_YAW = {"x": 0.0, "y": np.pi / 2, "-x": np.pi, "-y": -np.pi / 2}  # of the axes [rad]


def lowest(shape: Shape, rotation: Array) -> float:
    """Return the height of a shape's lowest point above its link's origin [m]."""
    upward = 0.0
    if shape.kind != "sphere":
        upward = min(1.0, abs(float((rotation @ rotation_of(shape.turned))[2, 2])))
    return float(rotation[2] @ shape.at) - shape.radius * math.sqrt(1 - upward**2)


def eccentricity(shape: Shape, axis: Vector) -> float:
    """Return the distance of a shape's centre from an axis through its link's origin [radii]."""
    return float(np.linalg.norm(np.cross(shape.at, axis))) / shape.radius


def is_about(shape: Shape, axis: Vector) -> bool:
    """Return whether a shape is rotationally symmetric about an axis through its link's origin."""
    along = float(rotation_of(shape.turned)[:, 2] @ axis)
    parallel = shape.kind == "sphere" or math.isclose(abs(along), 1, abs_tol=MAX_ECCENTRICITY)
    return parallel and eccentricity(shape, axis) <= MAX_ECCENTRICITY


def is_level(tree: Tree, joint: UrdfJoint) -> bool:
    """Return whether the axis of a joint is nearly level, with all joints at zero."""
    rotation, _ = tree.frames[joint.child]
    return abs(float((rotation @ unit_vector(joint.axis))[2])) <= STEEP


def is_last(tree: Tree, joint: UrdfJoint) -> bool:
    """Return whether no joint below a joint moves."""
    return not any(below.moves for below in tree.below(joint.child))


def steered(tree: Tree) -> frozenset[str]:
    """Return the names of the joints below joints that turn about steep axes."""
    return frozenset(
        below.name
        for joint in tree.joints.values()
        if joint.type in ("continuous", "revolute") and not is_level(tree, joint)
        for below in tree.below(joint.child)
    )


def fixed_to_wheels(tree: Tree) -> frozenset[str]:
    """Return the names of the joints below joints that turn about a level axis, if none moves.

    A round shape whose axis is beside that of the joint above does not turn with it, as a wheel
    beside the gear that drives it.
    """
    frames, found = tree.frames, set()
    for joint in tree.joints.values():
        if joint.type != "continuous" or not is_last(tree, joint) or not is_level(tree, joint):
            continue
        rotation, origin = frames[joint.child]
        axis, hub = rotation @ unit_vector(joint.axis), radius_of(tree, joint)
        for below in tree.below(joint.child):
            offset = np.linalg.norm(np.cross(frames[below.child][1] - origin, axis))
            is_beside = (
                offset > max(hub, radius_of(tree, below) / 2) and tree.links[below.child].shapes
            )
            if not is_beside or not WHEEL.search(f"{below.name} {below.child}"):
                found.add(below.name)
    return frozenset(found)


def radius_of(tree: Tree, joint: UrdfJoint) -> float:
    """Return the largest radius of the round shapes of a joint's link; zero without any [m]."""
    return max((shape.radius for shape in tree.links[joint.child].shapes), default=0.0)


def mirror_image(tree: Tree, joint: UrdfJoint, others: Iterable[UrdfJoint]) -> UrdfJoint | None:
    """Return the joint whose link is at the mirror image of a joint's link, on the other side.

    The root faces forward along x. The plane is midway between the outermost links that turn about
    level axes. The result is None without such a joint, and for links in the plane; of several
    joints it is the last.
    """
    frames = tree.frames
    turning = [j for j in tree.joints.values() if j.type == "continuous" and is_level(tree, j)]
    sides = [float(frames[each.child][1][1]) for each in turning] or [0.0]
    x, y, z = frames[joint.child][1] - (0, (max(sides) + min(sides)) / 2, 0)
    near = MIRROR * float(np.linalg.norm((x, y, z)))
    image = frames[joint.child][1] - (0, 2 * y, 0)
    found = [other for other in others if np.linalg.norm(frames[other.child][1] - image) <= near]
    return found[-1] if found and abs(y) > near else None


def facing_forward(tree: Tree, forward: str) -> Tree:
    """Return a URDF with its root rotated so that the forward axis, such as ``"-y"``, becomes x."""
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
    inertia = None if root.inertia is None else in_axes(back, root.inertia)
    links = tree.links | {tree.root: root._replace(center=turned(root.center), inertia=inertia)}
    return replace(tree, links=links, joints=joints)
