"""Frames of the links of a URDF with all joints at zero."""

from __future__ import annotations

import numpy as np

from slipfree.files.urdf.tree import Tree, UrdfJoint
from slipfree.files.vehicle_draft import rotation_of
from slipfree.geometry.frame import Vector, unit_vector
from slipfree.geometry.tensor import in_axes
from slipfree.records import Array

STEEP = 0.5  # largest vertical component of a level axis, such as an axle
FORWARD_YAW = {"x": 0.0, "y": np.pi / 2, "-x": np.pi, "-y": -np.pi / 2}  # of the axes [rad]


def link_frames(tree: Tree) -> dict[str, tuple[Array, Array]]:
    """Return rotation and origin [m] of each link in the root's frame, with all joints at zero."""
    frames = {tree.root: (np.eye(3), np.zeros(3))}
    for joint in tree.joints.values():
        rotation, origin = frames[joint.parent]
        frames[joint.child] = (
            rotation @ rotation_of(joint.turned),
            origin + rotation @ np.asarray(joint.at),
        )
    return frames


def is_level(tree: Tree, joint: UrdfJoint) -> bool:
    """Return whether the axis of a joint is nearly level, with all joints at zero."""
    rotation, _ = link_frames(tree)[joint.child]
    return abs(float((rotation @ unit_vector(joint.axis))[2])) <= STEEP


def is_last(tree: Tree, joint: UrdfJoint) -> bool:
    """Return whether no joint below a joint moves."""
    return not any(below.moves for below in tree.below(joint.child))


def fixed_to_turning(tree: Tree) -> frozenset[str]:
    """Return the names of the joints below continuous joints, if none of them moves."""
    turning = [j for j in tree.joints.values() if j.type == "continuous" and is_last(tree, j)]
    return frozenset(below.name for joint in turning for below in tree.below(joint.child))


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
    return tree._replace(links=links, joints=joints)
