"""Poses of a vehicle's parts and wheels at the samples of a motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.geometry.frame import Pose, platform
from slipfree.vehicle.tree import Vehicle

POSITION = ("x", "y", "z", "heading", "roll", "pitch")


class FramePoses(NamedTuple):
    """Poses of frames over time, in map coordinates.

    Attributes
    ----------
    origins : ndarray, shape (n, k, 3)
        Origins of k frames at n samples. [m]
    rotations : ndarray, shape (n, k, 3, 3)
        Columns are the frames' axes. [1]
    """

    origins: Array
    rotations: Array


def part_poses(vehicle: Vehicle, run: Trajectory) -> FramePoses:
    """Return the poses of the platform and of the parts of all joints, in this order.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    run : Trajectory
        Its motion, with the pose of the platform and the value of every coordinate.

    Raises
    ------
    ModelError
        If the motion lacks the platform's pose or a coordinate.
    """

    def parts(place: Pose, values: Mapping[str, ca.SX]) -> Sequence[Pose]:
        return tuple(vehicle.parts(place, values).values())

    return _frame_poses(vehicle, run, parts)


def wheel_poses(vehicle: Vehicle, run: Trajectory) -> FramePoses:
    """Return the poses of the wheels, rotated about their axles (x axes).

    Parameters and errors are those of `part_poses`; the motion must also have the wheel angles.
    """
    found = _frame_poses(vehicle, run, vehicle.carriers)
    return found._replace(rotations=spun(found.rotations, run["wheel_angle"]))


def spun(rotations: Array, angles: Array) -> Array:
    """Return rotations, shape (..., 3, 3), rotated forward about their x axes by angles [rad]."""
    cosine, sine = np.cos(angles), np.sin(angles)
    turned = np.zeros(rotations.shape)  # about the axle, which points right, by minus the angle
    turned[..., 0, 0] = 1
    turned[..., 1, 1] = turned[..., 2, 2] = cosine
    turned[..., 1, 2], turned[..., 2, 1] = sine, -sine
    return np.asarray(rotations @ turned)


def _frame_poses(
    vehicle: Vehicle,
    run: Trajectory,
    frames: Callable[[Pose, Mapping[str, ca.SX]], Sequence[Pose]],
) -> FramePoses:
    """Return the poses of frames over a motion.

    ``frames`` returns their poses from the platform's pose and the values of coordinates by name.
    """
    names = (*POSITION, *(c.name for c in vehicle.coordinates))
    q = ca.SX.sym("q", len(names))
    place, values = ca.vertsplit(q)[:6], dict(zip(names[6:], ca.vertsplit(q)[6:], strict=True))
    found = frames(platform(*place), values)
    run = run.in_frame("paper")
    columns = np.column_stack([run[name] for name in names]).T
    out = [
        ca.horzcat(*(pose.origin for pose in found)),
        ca.horzcat(*(ca.vec(pose.rotation) for pose in found)),
    ]
    function = ca.Function("poses", [q], [ca.vec(each) for each in out])
    origins, rotations = (np.array(each).T for each in function.map(run.t.size)(columns))
    shape = run.t.size, len(found)
    by_column = rotations.reshape(*shape, 3, 3)
    return FramePoses(origins.reshape(*shape, 3), by_column.transpose(0, 1, 3, 2))
