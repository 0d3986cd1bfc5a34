"""Motions as MCAP files of ROS 2 messages, which Foxglove and RViz play."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.files.mcap_reader import ros_package
from slipfree.files.urdf.links import (
    MAP,
    LinkPoses,
    Robot,
    joint_motion,
    link_poses,
    platform_poses,
    to_rep103,
)
from slipfree.models.samples import wheel_poses
from slipfree.system.atomic_files import replace_file
from slipfree.vehicle.tree import Vehicle

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

DEFINITIONS = {  # as in ROS 2, without comments
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "geometry_msgs/Transform": (
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation"
    ),
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform"
    ),
    "geometry_msgs/Vector3Stamped": "std_msgs/Header header\ngeometry_msgs/Vector3 vector",
    "nav_msgs/Path": "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses",
    "sensor_msgs/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
        "float64[] effort"
    ),
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
}
BASE = "base_link"  # frame of REP 105
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
    base = robot.tree.root if robot else BASE
    origins, rotation = platform_poses(run, vehicle)
    joints = joint_motion(run, vehicle, robot)
    if robot is None:
        frames = [LinkPoses(MAP, BASE, origins, rotation), *_wheel_frames(run, vehicle)]
    else:
        root = LinkPoses(MAP, base, origins, rotation * robot.root_turn)
        frames = [root, *link_poses(robot, {name: value for name, (value, _) in joints.items()})]
    slips = (_slip(run, wheel, base) for wheel in run.wheels)
    tracks = [_transforms(frames), _joint_states(joints, base, run.t.size), *slips]

    def fill(part: Path) -> None:
        with part.open("wb") as stream:
            writer, schemas = ros.writer.Writer(stream), dict[str, Any]()

            def write(time: int, topic: str, kind: str, content: dict[str, Any]) -> None:
                if kind not in schemas:
                    name = kind.replace("/", "/msg/")
                    schemas[kind] = writer.register_msgdef(name, definition(kind))
                writer.write_message(topic, schemas[kind], content, log_time=time)

            write(times[0], *_path(origins, rotation, times))
            for time, *messages in zip(times, *tracks, strict=True):
                for topic, kind, content in messages:
                    write(time, topic, kind, _stamped(content, time))
            writer.finish()

    replace_file(out, fill)


def definition(name: str) -> str:
    """Return the definition of a message, followed by those of the messages that it contains."""
    others = [f"{'=' * 80}\nMSG: {part}\n{DEFINITIONS[part]}" for part in dict(_contained(name))]
    return "\n".join([DEFINITIONS[name], *others])


def _contained(name: str) -> Iterator[tuple[str, None]]:
    """Yield the names of the messages that a message contains, at any depth."""
    for part in re.findall(r"^\w+/\w+", DEFINITIONS[name], re.MULTILINE):
        yield part, None
        yield from _contained(part)


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


def _path(origins: Array, rotation: Rotation, times: Sequence[int]) -> Message:
    rows = zip(times, origins.tolist(), rotation.as_quat().tolist(), strict=True)
    poses = [
        {
            "header": _header(time, MAP),
            "pose": {"position": _vector(place), "orientation": _vector(turn, "xyzw")},
        }
        for time, place, turn in rows
    ]
    return "/path", "nav_msgs/Path", {"header": _header(times[0], MAP), "poses": poses}


def _transforms(frames: Sequence[LinkPoses]) -> Iterator[Message]:
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
    base, turn = platform_poses(run, vehicle)
    origins, rotations = to_rep103(wheel_poses(vehicle, run))
    for k, name in enumerate(run.wheels):
        local = turn.inv().apply(origins[:, k] - base)
        yield LinkPoses(BASE, name, local, turn.inv() * rotations[k :: len(run.wheels)])


def _joint_states(
    joints: Mapping[str, tuple[Array, Array | None]], frame: str, size: int
) -> Iterator[Message]:
    """Yield values [rad, m] of moving joints and wheels, and their rates."""
    positions = np.column_stack([value for value, _ in joints.values()]).tolist()
    known = [rate for _, rate in joints.values() if rate is not None]
    rates = np.column_stack(known).tolist() if known else [[]] * size
    for position, velocity in zip(positions, rates, strict=True):
        content = {"name": [*joints], "position": position, "velocity": velocity, "effort": []}
        yield "/joint_states", "sensor_msgs/JointState", {"frame_id": frame, **content}


def _slip(run: Trajectory, wheel: str, frame: str) -> Iterator[Message]:
    """Yield the slip of a wheel: along, and to the left [m/s]."""
    along, across = run["slip_along", wheel], run["slip_across", wheel]
    for x, right in zip(along.tolist(), across.tolist(), strict=True):
        content = {"frame_id": frame, "vector": _vector((x, -right, 0.0))}
        yield f"/slip/{wheel}", "geometry_msgs/Vector3Stamped", content
