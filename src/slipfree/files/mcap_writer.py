"""Motions as MCAP files of ROS 2 messages, which Foxglove and RViz play."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from slipfree.atomic_files import replace_file
from slipfree.files.ros_messages import definition, ros_package
from slipfree.files.urdf.link_motion import joint_motion, platform_poses, to_rep103
from slipfree.files.urdf.links import LinkPoses, Robot, link_poses
from slipfree.models.poses import wheel_poses
from slipfree.trajectory import Trajectory
from slipfree.vehicle.tree import Vehicle

MAP, BASE = "map", "base_link"  # frames of REP 105
Message = tuple[str, str, dict[str, Any]]  # topic, type, content


def write_mcap(out: Path, run: Trajectory, vehicle: Vehicle, robot: Robot | None = None) -> None:
    """Write a motion as an MCAP file of ROS 2 messages.

    Frames have x forward, y left, z up (REP 103). Topics are ``/path`` (nav_msgs/Path, once),
    ``/tf`` (tf2_msgs/TFMessage: ``map`` to ``base_link``, the platform, and ``base_link`` to each
    wheel; with a URDF, ``map`` to its root link, and all its links), ``/joint_states``
    (sensor_msgs/JointState: moving joints and wheels) and ``/slip/WHEEL``
    (geometry_msgs/Vector3Stamped: slip velocity of the wheel, x along its rolling direction, y to
    the left [m/s]). Times are rounded to nanoseconds.

    Parameters
    ----------
    out : Path
        File to write; an existing file is replaced when the new one is complete.
    run : Trajectory
        Motion over terrain, with the pose of the platform, all coordinates and the wheel angles.
    vehicle : Vehicle
        The vehicle.
    robot : Robot, optional
        The URDF of the vehicle, whose axes determine the signs of the joint values. Without it,
        angles of wheels are positive forward.

    Raises
    ------
    DataError
        If the package mcap-ros2-support is not installed, or the file cannot be written.
    ModelError
        If the motion lacks the pose, a coordinate, or the angles or the slip of the wheels.
    """
    ros, times = ros_package(), [round(t * 1e9) for t in run.t.tolist()]
    tracks = [
        _transforms(run, vehicle, robot),
        _joint_states(run, vehicle, robot),
        *(_slip(run, wheel, robot.tree.root if robot else BASE) for wheel in run.wheels),
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


def _vector(values: Sequence[float], names: str = "xyz") -> dict[str, float]:
    return dict(zip(names, values, strict=True))


def _path(run: Trajectory, vehicle: Vehicle, times: Sequence[int]) -> Message:
    """Return the whole path of the platform."""
    origins, rotation = platform_poses(run, vehicle)
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


def _transforms(run: Trajectory, vehicle: Vehicle, robot: Robot | None) -> Iterator[Message]:
    """Yield the poses of the platform, and of wheels or links, at each sample."""
    base, turn = platform_poses(run, vehicle)
    if robot is None:
        frames = [LinkPoses(MAP, BASE, base, turn), *_wheel_frames(run, vehicle)]
    else:
        root = LinkPoses(MAP, robot.tree.root, base, turn * robot.root_turn)
        values = {name: placed for name, (placed, _) in joint_motion(run, vehicle, robot).items()}
        frames = [root, *link_poses(robot, values)]
    places = np.stack([frame.origins for frame in frames], axis=1).tolist()
    quaternions = np.stack([frame.rotation.as_quat() for frame in frames], axis=1).tolist()
    for row in zip(places, quaternions, strict=True):
        transforms = [
            {
                "frame_id": frame.parent,
                "child_frame_id": frame.child,
                "transform": {"translation": _vector(at), "rotation": _vector(q, "xyzw")},
            }
            for frame, at, q in zip(frames, *row, strict=True)
        ]
        yield "/tf", "tf2_msgs/TFMessage", {"transforms": transforms}


def _wheel_frames(run: Trajectory, vehicle: Vehicle) -> Iterator[LinkPoses]:
    """Yield the poses of the wheels in the platform's frame."""
    base, turn = platform_poses(run, vehicle)
    origins, rotations = to_rep103(wheel_poses(vehicle, run))
    turns = rotations.as_quat().reshape(*origins.shape[:2], 4)
    for k, name in enumerate(run.wheels):
        local = turn.inv().apply(origins[:, k] - base)
        yield LinkPoses(BASE, name, local, turn.inv() * Rotation.from_quat(turns[:, k]))


def _joint_states(run: Trajectory, vehicle: Vehicle, robot: Robot | None) -> Iterator[Message]:
    """Yield values [rad, m] of moving joints and wheels, and their rates."""
    joints, frame = joint_motion(run, vehicle, robot), robot.tree.root if robot else BASE
    positions = np.column_stack([place for place, _ in joints.values()]).tolist()
    known = [rate for _, rate in joints.values() if rate is not None]
    rates = np.column_stack(known).tolist() if known else [[]] * run.t.size
    for position, velocity in zip(positions, rates, strict=True):
        content = {"name": [*joints], "position": position, "velocity": velocity, "effort": []}
        yield "/joint_states", "sensor_msgs/JointState", {"frame_id": frame, **content}


def _slip(run: Trajectory, wheel: str, frame: str) -> Iterator[Message]:
    """Yield the slip of a wheel: along, and to the left [m/s]."""
    along, across = run["slip_along", wheel], run["slip_across", wheel]
    for x, right in zip(along.tolist(), across.tolist(), strict=True):
        content = {"frame_id": frame, "vector": _vector((x, -right, 0.0))}
        yield f"/slip/{wheel}", "geometry_msgs/Vector3Stamped", content
