"""Values of a URDF's joints, and poses of its links, in a motion of its vehicle."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import casadi as ca
import numpy as np
import scipy  # scipy.spatial is imported when it is used, since this takes 0.1 s

from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.files.urdf.tree import FORWARD_YAW, Tree, UrdfJoint, facing_forward
from slipfree.files.vehicle_toml import rotation_of, to_paper_axes, vector_of
from slipfree.geometry.frame import unit_vector
from slipfree.models.samples import FramePoses, part_poses
from slipfree.vehicle.formula import evaluate
from slipfree.vehicle.tree import Vehicle

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

MAP = "map"  # frame of REP 105
BOUNDED = (  # facts about wheels, the quantity, and its limit in a joint
    ("faster_wheels", "wheel_rate", "max_rate"),
    ("overloaded_wheels", "drive_torque", "max_effort"),
)


class Robot(NamedTuple):
    """The completed URDF of a vehicle, and the axis of its root link that points forward."""

    tree: Tree
    forward: str = "x"

    @property
    def root_turn(self) -> Rotation:
        """Rotation of the root link in the platform's frame (x forward, y left)."""
        return scipy.spatial.transform.Rotation.from_euler("z", -FORWARD_YAW[self.forward])


class LinkPoses(NamedTuple):
    """Poses of a link in its parent's frame over time: origins, shape (n, 3) [m], and rotations."""

    parent: str
    child: str
    origins: Array
    rotation: Rotation


def wheel_name(joint: str) -> str:
    """Return the name of the wheel that a joint of a URDF carries."""
    return re.sub(r"[^\w-]", "_", joint)


def wheel_joints(robot: Robot) -> dict[str, UrdfJoint]:
    """Return the joints of a URDF by the names of the wheels that they may carry."""
    return {wheel_name(joint.name): joint for joint in robot.tree.joints.values()}


def beyond_limits(robot: Robot, run: Trajectory) -> dict[str, list[dict[str, Any]]]:
    """Return the wheels that exceed the rate or the torque of their joints in a motion, by fact.

    Rows contain the wheel, the largest value with its time, and the limit [rad/s, N m, s].
    """
    joints, found = wheel_joints(robot), dict[str, list[dict[str, Any]]]()
    for fact, quantity, limit in BOUNDED:
        for k, wheel in enumerate(run.wheels if quantity in run else ()):
            sizes = np.nan_to_num(np.abs(run[quantity][:, k]))
            most, largest = getattr(joints.get(wheel), limit, np.inf), float(sizes.max())
            if largest > most:
                t = float(run.t[sizes.argmax()])
                row = {"wheel": wheel, "value": largest, "limit": most, "t": t}
                found.setdefault(fact, []).append(row)
    return found


def joint_values(vehicle: Vehicle, robot: Robot | None) -> tuple[ca.SX, dict[str, ca.SX]]:
    """Return the values of moving joints and of wheels, by the name of their joint [rad, m].

    They are functions of the column that precedes them: coordinates, then angles of wheels.
    Joints without effect on the vehicle are at zero, or at the limit closest to zero. Without a
    URDF, whose axes determine signs, angles of wheels are positive forward.
    """
    names, wheels = [c.name for c in vehicle.coordinates], [w.name for w in vehicle.wheels]
    q = ca.SX.sym("q", len(names) + len(wheels))
    values = dict(zip(names, ca.vertsplit(q)[: len(names)], strict=True))
    angles = dict(zip(wheels, ca.vertsplit(q)[len(names) :], strict=True))
    own = {joint.name: evaluate(joint.value, values) for joint in vehicle.joints}
    released = {joint.name for joint in vehicle.joints if joint.coordinates}
    if robot is None:
        return q, {name: value for name, value in own.items() if name in released} | angles
    joints, turned = robot.tree.joints, facing_forward(robot.tree, robot.forward).joints
    signs = dict[str, float]()  # 1 for joints that turn forward if their value increases, else -1
    for joint in turned.values():
        if joint.moves and (name := wheel_name(joint.name)) in wheels:
            axis = vector_of(rotation_of(joint.turned) @ unit_vector(joint.axis))
            axle = unit_vector(vehicle.wheels[wheels.index(name)].axle)
            signs[joint.name] = -float(np.sign(np.dot(to_paper_axes(axis), axle)))

    def value(joint: UrdfJoint) -> ca.SX:
        """Return the value of a joint: of a coordinate, a wheel, or at rest within its limits."""
        (*_, joint), factor, offset = robot.tree.followed(joint, {*own, *signs})
        if joint.name in own:
            return offset + factor * own[joint.name]
        if joint.name in signs:
            return offset + factor * signs[joint.name] * angles[wheel_name(joint.name)]
        still = min(max(0.0, joint.lower), joint.upper) if joint.moves else 0.0
        return ca.SX(offset + factor * still)

    moving = {n: joint for n, joint in joints.items() if joint.moves or n in released}
    return q, {name: value(joint) for name, joint in moving.items()}


def link_poses(robot: Robot, values: Mapping[str, Array]) -> Iterator[LinkPoses]:
    """Yield the poses of all links but the root, for values of moving joints, shape (n,)."""
    n = next((value.size for value in values.values()), 1)
    rotations = scipy.spatial.transform.Rotation
    for joint in robot.tree.joints.values():
        value = values.get(joint.name, np.zeros(n))
        axis = unit_vector(joint.axis) if joint.name in values else np.zeros(3)
        moved, still = value[:, None] * axis, np.zeros((n, 3))
        slid, turned = (moved, still) if joint.type == "prismatic" else (still, moved)
        turn = rotations.from_matrix(rotation_of(joint.turned))
        origins = np.asarray(joint.at) + turn.apply(slid)
        yield LinkPoses(joint.parent, joint.child, origins, turn * rotations.from_rotvec(turned))


def to_rep103(poses: FramePoses) -> tuple[Array, Rotation]:
    """Return origins [m] and rotations of frames with axes x forward, y left."""
    right, forward, up = np.moveaxis(poses.rotations, -1, 0)
    turned = np.stack([forward, -right, up], axis=-1)
    return poses.origins, scipy.spatial.transform.Rotation.from_matrix(turned.reshape(-1, 3, 3))


def platform_poses(run: Trajectory, vehicle: Vehicle) -> tuple[Array, Rotation]:
    """Return origins, shape (n, 3) [m], and rotations of the platform."""
    poses = part_poses(vehicle, run)
    origins, rotation = to_rep103(FramePoses(poses.origins[:, :1], poses.rotations[:, :1]))
    return origins[:, 0], rotation


def joint_motion(
    run: Trajectory, vehicle: Vehicle, robot: Robot | None
) -> dict[str, tuple[Array, Array | None]]:
    """Return values [rad, m] of moving joints and wheels, and their rates, None if unknown."""
    (q, values), names = joint_values(vehicle, robot), [c.name for c in vehicle.coordinates]
    rates = ca.SX.sym("rates", q.numel())
    joints = ca.vertcat(*values.values())
    function = ca.Function("joints", [q, rates], [joints, ca.jtimes(joints, q, rates)])
    is_known = all(f"{name}_rate" in run.columns for name in names)
    columns = np.array([*(run[name] for name in names), *run["wheel_angle"].T])
    speeds = np.zeros((q.numel(), run.t.size))
    if is_known:
        speeds = np.array([*(run[f"{name}_rate"] for name in names), *run["wheel_rate"].T])
    rows = zip(*(np.array(out) for out in function.map(run.t.size)(columns, speeds)), strict=True)
    return {
        name: (value, rate if is_known else None)
        for name, (value, rate) in zip(values, rows, strict=True)
    }


def poses_on_map(run: Trajectory, vehicle: Vehicle, robot: Robot) -> Iterator[LinkPoses]:
    """Yield the poses of all links of a URDF on the map, the root link first."""
    origins, turn = platform_poses(run, vehicle)
    poses = {robot.tree.root: (origins, turn * robot.root_turn)}
    yield LinkPoses(MAP, robot.tree.root, *poses[robot.tree.root])
    values = {name: value for name, (value, _) in joint_motion(run, vehicle, robot).items()}
    for link in link_poses(robot, values):
        at, rotation = poses[link.parent]
        poses[link.child] = at + rotation.apply(link.origins), rotation * link.rotation
        yield LinkPoses(MAP, link.child, *poses[link.child])
