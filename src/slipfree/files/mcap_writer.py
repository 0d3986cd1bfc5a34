"""Motions as MCAP files of ROS 2 messages, which Foxglove and RViz play."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from slipfree.atomic_files import replace_file
from slipfree.files.ros_messages import definition, ros_package
from slipfree.models.poses import FramePoses, part_poses, wheel_poses
from slipfree.records import Array
from slipfree.trajectory import Trajectory
from slipfree.vehicle.formula import evaluate
from slipfree.vehicle.tree import Vehicle

MAP, BASE = "map", "base_link"  # frames of REP 105
Message = tuple[str, str, dict[str, Any]]  # topic, type, content


def write_mcap(out: Path, run: Trajectory, vehicle: Vehicle) -> None:
    """Write a motion as an MCAP file of ROS 2 messages.

    Frames have x forward, y left, z up (REP 103). Topics are ``/path`` (nav_msgs/Path, once),
    ``/tf`` (tf2_msgs/TFMessage: ``map`` to ``base_link``, the platform, and ``base_link`` to each
    wheel), ``/joint_states`` (sensor_msgs/JointState: moving joints and wheels) and ``/slip/WHEEL``
    (geometry_msgs/Vector3Stamped: x along, y to the left [m/s]). Times are rounded to nanoseconds.

    Parameters
    ----------
    out : Path
        File to write; an existing file is replaced when the new one is complete.
    run : Trajectory
        Motion over terrain, with the pose of the platform, all coordinates and the wheel angles.
    vehicle : Vehicle
        The vehicle.

    Raises
    ------
    DataError
        If the package mcap-ros2-support is not installed, or the file cannot be written.
    ModelError
        If the motion lacks a coordinate of the vehicle.
    """
    ros, times = ros_package(), [round(t * 1e9) for t in run.t.tolist()]
    tracks = [
        _transforms(run, vehicle),
        _joint_states(run, vehicle),
        *(_slip(run, wheel) for wheel in run.wheels),
    ]

    def fill(part: Path) -> None:
        with part.open("wb") as stream:
            writer, schemas = ros.writer.Writer(stream), dict[str, Any]()

            def write(time: int, topic: str, kind: str, content: dict[str, Any]) -> None:
                if kind not in schemas:
                    name = kind.replace("/", "/msg/")
                    schemas[kind] = writer.register_msgdef(name, definition(kind))
                writer.write_message(topic, schemas[kind], content, log_time=time)

            write(times[0], *_path(run, vehicle, times))
            for time, *messages in zip(times, *tracks, strict=True):
                for topic, kind, content in messages:
                    write(time, topic, kind, _stamped(content, time))
            writer.finish()

    replace_file(out, fill)


def _header(time: int, frame: str) -> dict[str, Any]:
    seconds, nanoseconds = divmod(time, 10**9)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame}


def _stamped(content: dict[str, Any], time: int) -> dict[str, Any]:
    """Return the content of a message with a header for each ``frame_id``, at a time [ns]."""
    if "transforms" in content:
        return {"transforms": [_stamped(each, time) for each in content["transforms"]]}
    return {**content, "header": _header(time, content["frame_id"])}


def _rep103(poses: FramePoses) -> tuple[Array, Rotation]:
    """Return origins [m] and rotations of frames with axes x forward, y left, as one long list."""
    right, forward, up = np.moveaxis(poses.rotations, -1, 0)
    turned = np.stack([forward, -right, up], axis=-1)
    return poses.origins, Rotation.from_matrix(turned.reshape(-1, 3, 3))


def _platform(run: Trajectory, vehicle: Vehicle) -> tuple[Array, Rotation]:
    """Return origins, shape (n, 3) [m], and rotations of the platform."""
    poses = part_poses(vehicle, run)
    first = FramePoses(poses.origins[:, :1], poses.rotations[:, :1])
    origins, rotation = _rep103(first)
    return origins[:, 0], rotation


def _vector(values: Sequence[float], names: str = "xyz") -> dict[str, float]:
    return dict(zip(names, values, strict=True))


def _path(run: Trajectory, vehicle: Vehicle, times: Sequence[int]) -> Message:
    """Return the whole path of the platform."""
    origins, rotation = _platform(run, vehicle)
    poses = [
        {
            "header": _header(time, MAP),
            "pose": {"position": _vector(place), "orientation": _vector(turn, "xyzw")},
        }
        for time, place, turn in zip(
            times, origins.tolist(), rotation.as_quat().tolist(), strict=True
        )
    ]
    return "/path", "nav_msgs/Path", {"header": _header(times[0], MAP), "poses": poses}


def _transforms(run: Trajectory, vehicle: Vehicle) -> Iterator[Message]:
    """Yield the poses of platform and wheels at each sample."""
    base, turn = _platform(run, vehicle)
    origins, rotations = _rep103(wheel_poses(vehicle, run))
    n, k = origins.shape[:2]
    inverse = Rotation.from_quat(np.repeat(turn.as_quat(), k, axis=0)).inv()
    local = inverse.apply((origins - base[:, None]).reshape(-1, 3)).reshape(n, k, 3)
    turned = (inverse * rotations).as_quat().reshape(n, k, 4)
    frames = [(MAP, BASE), *((BASE, name) for name in run.wheels)]
    places = np.concatenate([base[:, None], local], axis=1).tolist()
    quaternions = np.concatenate([turn.as_quat()[:, None], turned], axis=1).tolist()
    for row in zip(places, quaternions, strict=True):
        transforms = [
            {
                "frame_id": parent,
                "child_frame_id": child,
                "transform": {"translation": _vector(at), "rotation": _vector(q, "xyzw")},
            }
            for (parent, child), at, q in zip(frames, *row, strict=True)
        ]
        yield "/tf", "tf2_msgs/TFMessage", {"transforms": transforms}


def _joint_states(run: Trajectory, vehicle: Vehicle) -> Iterator[Message]:
    """Yield angles [rad] or displacements [m] of moving joints and wheels, and their rates."""
    moving = [joint for joint in vehicle.joints if joint.coordinates]
    names = [c.name for c in vehicle.coordinates]
    q, rates = ca.SX.sym("q", len(names)), ca.SX.sym("rates", len(names))
    values = dict(zip(names, ca.vertsplit(q), strict=True))
    positions = ca.vertcat(ca.SX(0, 1), *(evaluate(joint.value, values) for joint in moving))
    function = ca.Function("joints", [q, rates], [positions, ca.jtimes(positions, q, rates)])
    known = all(f"{name}_rate" in run.columns for name in names)
    shape = len(names), run.t.size
    columns = np.array([run[name] for name in names]).reshape(shape)
    speeds = np.array([run[f"{name}_rate"] for name in names if known])
    speeds = speeds.reshape(shape) if known else np.zeros(shape)
    placed, moved = function.map(run.t.size)(columns, speeds)
    position = np.column_stack([np.array(placed).T, run["wheel_angle"]]).tolist()
    velocity = np.column_stack([np.array(moved).T, run["wheel_rate"]]).tolist()
    joints = [*(joint.name for joint in moving), *run.wheels]
    for now, rate in zip(position, velocity, strict=True):
        content = {"name": joints, "position": now, "velocity": rate if known else [], "effort": []}
        yield "/joint_states", "sensor_msgs/JointState", {"frame_id": BASE, **content}


def _slip(run: Trajectory, wheel: str) -> Iterator[Message]:
    """Yield the slip of a wheel: along, and to the left [m/s]."""
    along, across = run["slip_along", wheel], run["slip_across", wheel]
    for x, right in zip(along.tolist(), across.tolist(), strict=True):
        content = {"frame_id": BASE, "vector": _vector((x, -right, 0.0))}
        yield f"/slip/{wheel}", "geometry_msgs/Vector3Stamped", content
