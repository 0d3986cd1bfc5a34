"""Poses of platform, joints and links of a URDF in a motion of its vehicle."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from slipfree.files.urdf.links import LinkPoses, Robot, joint_values, link_poses
from slipfree.models.poses import FramePoses, part_poses
from slipfree.records import Array
from slipfree.trajectory import Trajectory
from slipfree.vehicle.tree import Vehicle

MAP = "map"


def to_rep103(poses: FramePoses) -> tuple[Array, Rotation]:
    """Return origins [m] and rotations of frames with axes x forward, y left.

    The rotations of all samples and frames are in one dimension.
    """
    right, forward, up = np.moveaxis(poses.rotations, -1, 0)
    turned = np.stack([forward, -right, up], axis=-1)
    return poses.origins, Rotation.from_matrix(turned.reshape(-1, 3, 3))


def platform_poses(run: Trajectory, vehicle: Vehicle) -> tuple[Array, Rotation]:
    """Return origins, shape (n, 3) [m], and rotations of the platform."""
    poses = part_poses(vehicle, run)
    first = FramePoses(poses.origins[:, :1], poses.rotations[:, :1])
    origins, rotation = to_rep103(first)
    return origins[:, 0], rotation


def joint_motion(
    run: Trajectory, vehicle: Vehicle, robot: Robot | None
) -> dict[str, tuple[Array, Array | None]]:
    """Return values [rad, m] of moving joints and wheels, and their rates, None if unknown."""
    names, wheels = [c.name for c in vehicle.coordinates], [w.name for w in vehicle.wheels]
    size = len(names) + len(wheels)
    q, rates = ca.SX.sym("q", size), ca.SX.sym("rates", size)
    values = dict(zip(names, ca.vertsplit(q)[: len(names)], strict=True))
    angles = dict(zip(wheels, ca.vertsplit(q)[len(names) :], strict=True))
    found = joint_values(vehicle, robot, values, angles)
    placed = ca.vertcat(*found.values())
    function = ca.Function("joints", [q, rates], [placed, ca.jtimes(placed, q, rates)])
    known = all(f"{name}_rate" in run.columns for name in names)
    columns = [*(run[name] for name in names), *run["wheel_angle"].T]
    speeds = [*(run[f"{name}_rate"] for name in names if known), *run["wheel_rate"].T]
    given = np.array(speeds) if known else np.zeros((size, run.t.size))
    placed_at, moved = (np.array(out) for out in function.map(run.t.size)(np.array(columns), given))
    return {
        name: (place, rate if known else None)
        for name, place, rate in zip(found, placed_at, moved, strict=True)
    }


def poses_on_map(run: Trajectory, vehicle: Vehicle, robot: Robot) -> Iterator[LinkPoses]:
    """Yield the poses of all links of a URDF on the map, the root link first."""
    origins, turn = platform_poses(run, vehicle)
    known = {robot.tree.root: (origins, turn * robot.root_turn)}
    yield LinkPoses(MAP, robot.tree.root, *known[robot.tree.root])
    values = {name: placed for name, (placed, _) in joint_motion(run, vehicle, robot).items()}
    for link in link_poses(robot, values):
        at, rotation = known[link.parent]
        known[link.child] = at + rotation.apply(link.origins), rotation * link.rotation
        yield LinkPoses(MAP, link.child, *known[link.child])
