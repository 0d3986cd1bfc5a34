"""MCAP files of ROS 2 messages: tables of commands, paths and joints, and motions for players."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import nan
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

import numpy as np

from slipfree.core.errors import DataError, missing_package, read_table
from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.files.urdf import links
from slipfree.models.samples import wheel_poses
from slipfree.system.processes import bounded_read
from slipfree.system.regular_files import read_bytes, regular_file, replacing
from slipfree.vehicle.tree import Vehicle

Rows = Mapping[str, Array]
T = TypeVar("T")
MAX_LISTED = 6  # topics in a message
JOINT_STATE = "sensor_msgs/msg/JointState"
MESSAGES = {  # types of the messages from which a table is read, by the names of its columns
    ("v_x", "v_y", "omega_z"): ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"),
    ("x", "y", "heading"): ("nav_msgs/msg/Path", "nav_msgs/msg/Odometry"),
}
DEFINITIONS: dict[str, str] = read_table(__file__, "messages.toml")
BASE = "base_link"  # frame of REP 105
Message = tuple[str, str, dict[str, Any]]  # topic, type, content


class JointCommands(NamedTuple):
    """Commands of a joint over time."""

    t: Array  # shape (n,): times since the first message of the topic [s]
    positions: Array  # [rad or m], NaN where a message has none
    velocities: Array  # [rad/s or m/s], NaN where a message has none


def ros_package() -> ModuleType:
    """Return the package ``mcap_ros2``; raise DataError if it is not installed."""
    try:
        import mcap_ros2.decoder
        import mcap_ros2.writer
    except ImportError as error:
        raise DataError(missing_package("mcap-ros2-support", "ros")) from error
    return mcap_ros2


def is_mcap(path: Path) -> bool:
    """Return whether a file name is that of an MCAP file."""
    return path.suffix.lower() == ".mcap"


def read_mcap(path: Path, name: str) -> Rows:
    """Return a table of commands or of a path from the messages in an MCAP file.

    ``name`` is one of its columns: ``t, v_x, v_y, omega_z`` of Twist or TwistStamped, or ``t, x, y,
    heading`` of the last Path or of Odometry; frames have x forward, y left (REP 103).
    """
    names = next((names for names in MESSAGES if name in names), None)
    if names is None:
        raise DataError(
            f"{path}: expected a CSV file, found MCAP, from which only paths and commands are "
            "read; write the values as CSV"
        )
    return _bounded(_table, path, names)[1]


def read_joint_commands(path: Path) -> dict[str, JointCommands]:
    """Return the joint commands in the JointState messages of an MCAP file, by name of joint."""
    return _bounded(_joint_commands, path)


def read_motion_log(path: Path) -> tuple[Rows, dict[str, JointCommands]]:
    """Return poses and joint states in an MCAP file: one topic of poses, and one of JointState.

    Poses are those of `read_mcap`; times of joints, by name, count from the first pose.
    """
    return _bounded(_motion_log, path)


def _bounded(read: Callable[..., T], path: Path, *arguments: Any) -> T:
    """Return the result of a reader in a process with limits, since chunks may be bombs."""
    with regular_file(path, "messages as MCAP"):
        return bounded_read(read, path, *arguments)


def _motion_log(path: Path) -> tuple[Rows, dict[str, JointCommands]]:
    """Return poses by time, and the commands of joints, from an MCAP file."""
    first, table = _table(path, ("x", "y", "heading"))
    return table, _joint_commands(path, first)


def _table(path: Path, names: tuple[str, str, str]) -> tuple[int, Rows]:
    """Return the time of the first row [ns], and columns with times from it [s]."""
    topic, messages = _only_topic(path, MESSAGES[names])
    with _standard_fields(path, topic):
        stamped = [*_rows(messages)]
        table = np.array([((t - stamped[0][0]) / 1e9, *row) for t, *row in stamped], dtype=float)
    if not table.size:
        raise DataError(
            f"{path}: expected poses in the last message of topic {topic!r}, found none; record "
            "the topic again"
        )
    if not np.isfinite(table).all():
        raise DataError(
            f"{path}: expected finite numbers in topic {topic!r}, found infinite ones or NaN; "
            "record the topic again"
        )
    if "heading" in names:
        table[:, -1] = np.unwrap(table[:, -1])
    return stamped[0][0], dict(zip(("t", *names), table.T, strict=True))


def _joint_commands(path: Path, first: int | None = None) -> dict[str, JointCommands]:
    """Return the joints in messages JointState, with times since ``first``, or the first [ns]."""
    topic, messages = _only_topic(path, (JOINT_STATE,))
    rows: dict[str, list[tuple[float, float, float]]] = {}
    with _standard_fields(path, topic):
        for recorded, message in messages:
            absolute = _time(message, recorded)
            first = absolute if first is None else first
            for k, name in enumerate(message.name):
                position, velocity = (
                    float(values[k]) if k < len(values) else nan
                    for values in (message.position, message.velocity)
                )
                row = ((absolute - first) / 1e9, position, velocity)
                rows.setdefault(str(name), []).append(row)
    joints = {name: JointCommands(*np.array(table).T) for name, table in rows.items()}
    if any(np.diff(joint.t, prepend=-np.inf).min() <= 0 for joint in joints.values()):
        raise DataError(
            f"{path}: expected increasing times of each joint in topic {topic!r}, found equal or "
            "decreasing ones; divide the recording where they decrease, and keep one per time"
        )
    return joints


def _only_topic(path: Path, kinds: Sequence[str]) -> tuple[str, list[tuple[int, Any]]]:
    """Return the only topic with messages of the given types, and the messages with times [ns]."""
    ros = ros_package()
    from mcap.reader import make_reader

    topics: dict[str, list[tuple[int, Any]]] = {}
    others: dict[str, str] = {}
    content, factory = read_bytes(path, "messages as MCAP"), ros.decoder.DecoderFactory()
    try:
        for schema, channel, record in make_reader(io.BytesIO(content), True).iter_messages():
            if schema is None or schema.name not in kinds:
                others[channel.topic] = schema.name if schema else channel.message_encoding
                continue
            decode = factory.decoder_for(channel.message_encoding, schema)
            if decode is None:
                raise DataError(
                    f"{path}: expected messages of ROS 2 (CDR), found {channel.message_encoding!r} "
                    f"with definitions in {schema.encoding!r} in topic {channel.topic!r}; convert "
                    "the file"
                )
            topics.setdefault(channel.topic, []).append((record.log_time, decode(record.data)))
    except DataError:
        raise
    except Exception as error:  # also errors of its parsers and codecs
        raise DataError(
            f"{path}: expected messages as MCAP, found a file that is damaged or of another "
            f"format ({type(error).__name__}); repair it with 'mcap recover', or record it again"
        ) from error
    if len(topics) != 1:
        listed = ", ".join(sorted(topics)) or "none"
        if others and not topics:
            some = [f"{topic} ({kind})" for topic, kind in sorted(others.items())[:MAX_LISTED]]
            listed += f" among {', '.join(some)}{', ...' * (len(others) > MAX_LISTED)}"
        raise DataError(
            f"{path}: expected one topic with messages of type {' or '.join(kinds)}, found "
            f"{listed}; record or extract one such topic"
        )
    return next(iter(topics.items()))


@contextmanager
def _standard_fields(path: Path, topic: str) -> Iterator[None]:
    """Raise DataError if messages lack the fields of their type, which the file defines itself."""
    try:
        yield
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise DataError(
            f"{path}: expected messages in topic {topic!r} with the fields that ROS 2 defines for "
            f"their type, found a file that defines others ({error}); record them with "
            "the standard definition"
        ) from error


def _rows(messages: list[tuple[int, Any]]) -> Iterator[tuple[int, float, float, float]]:
    """Yield time [ns] and pose (x, y, yaw) or twist (forward, left, yaw rate) of messages."""
    last = messages[-1][1]
    if type(last).__name__ == "Path":
        messages = [(_time(pose, 0), pose) for pose in last.poses]
    for recorded, message in messages:
        time = _time(message, recorded)
        kind = type(message).__name__
        if kind in ("Odometry", "PoseStamped"):
            pose = message.pose.pose if kind == "Odometry" else message.pose
            q = pose.orientation
            yield time, pose.position.x, pose.position.y, float(yaw_of(q.x, q.y, q.z, q.w))
        else:
            twist = message.twist if kind == "TwistStamped" else message
            yield time, twist.linear.x, twist.linear.y, twist.angular.z


def yaw_of(x: Any, y: Any, z: Any, w: Any) -> Any:
    """Return the yaw of unit quaternions, numbers or arrays [rad]."""
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _time(message: Any, recorded: int) -> int:
    if not hasattr(message, "header"):
        return recorded
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def write_mcap(
    out: Path, run: Trajectory, vehicle: Vehicle, robot: links.Robot | None = None
) -> None:
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
    origins, rotation = links.platform_poses(run, vehicle)
    joints = links.joint_motion(run, vehicle, robot)
    if robot is None:
        frames = [links.LinkPoses(links.MAP, BASE, origins, rotation)]
        places, turns = links.to_rep103(wheel_poses(vehicle, run))
        for k, name in enumerate(run.wheels):
            local, turn = rotation.inv().apply(places[:, k] - origins), turns[k :: len(run.wheels)]
            frames.append(links.LinkPoses(BASE, name, local, rotation.inv() * turn))
    else:
        root = links.LinkPoses(links.MAP, base, origins, rotation * robot.root_turn)
        frames = [
            root,
            *links.link_poses(robot, {name: value for name, (value, _) in joints.items()}),
        ]
    slips = (_slip(run, wheel, base) for wheel in run.wheels)
    tracks = [_transforms(frames), _joint_states(joints, base, run.t.size), *slips]
    with replacing(out) as part, part.open("wb") as stream:
        writer, schemas = ros.writer.Writer(stream), dict[str, Any]()

        def write(time: int, topic: str, kind: str, content: dict[str, Any]) -> None:
            if kind not in schemas:
                schemas[kind] = writer.register_msgdef(kind.replace("/", "/msg/"), definition(kind))
            writer.write_message(topic, schemas[kind], content, log_time=time)

        rows = zip(times, origins.tolist(), rotation.as_quat().tolist(), strict=True)
        poses = [
            {
                "header": _header(time, links.MAP),
                "pose": {"position": _vector(place), "orientation": _vector(turn, "xyzw")},
            }
            for time, place, turn in rows
        ]
        path = {"header": _header(times[0], links.MAP), "poses": poses}
        write(times[0], "/path", "nav_msgs/Path", path)
        for time, *messages in zip(times, *tracks, strict=True):
            for topic, kind, content in messages:
                write(time, topic, kind, _stamped(content, time))
        writer.finish()


def definition(name: str) -> str:
    """Return the definition of a message, followed by those of the messages that it contains."""
    names = [name]
    for each in names:  # the list grows
        contained = re.findall(r"^\w+/\w+", DEFINITIONS[each], re.MULTILINE)
        names += [part for part in dict.fromkeys(contained) if part not in names]
    others = [f"{'=' * 80}\nMSG: {part}\n{DEFINITIONS[part]}" for part in names[1:]]
    return "\n".join([DEFINITIONS[name], *others])


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


def _transforms(frames: Sequence[links.LinkPoses]) -> Iterator[Message]:
    """Yield the messages of /tf: the poses of all links at each sample."""
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
    along, across = run["slip_along", wheel], run["slip_across", wheel]
    for x, right in zip(along.tolist(), across.tolist(), strict=True):
        content = {"frame_id": frame, "vector": _vector((x, -right, 0.0))}
        yield f"/slip/{wheel}", "geometry_msgs/Vector3Stamped", content
