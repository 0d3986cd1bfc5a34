"""Commands, paths and joints in MCAP files of ROS 2 messages, as tables."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import atan2, nan
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

import numpy as np

from slipfree.core.errors import DataError, missing_package
from slipfree.core.records import Array
from slipfree.system.processes import bounded_read
from slipfree.system.regular_files import read_bytes, regular_file

Rows = Mapping[str, Array]
T = TypeVar("T")
MAX_LISTED = 6  # topics in a message
JOINT_STATE = "sensor_msgs/msg/JointState"
MESSAGES = {  # types of the messages from which a table is read, by the names of its columns
    ("v_x", "v_y", "omega_z"): ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"),
    ("x", "y", "heading"): ("nav_msgs/msg/Path", "nav_msgs/msg/Odometry"),
}


class JointCommands(NamedTuple):
    """Commands of a joint over time."""

    t: Array  # shape (n,): times since the first message of the topic [s]
    positions: Array  # [rad or m], NaN where a message has none
    velocities: Array  # [rad/s or m/s], NaN where a message has none


class MotionLog(NamedTuple):
    """Poses as in `read_mcap`, and joints by name, with times since the first pose [s]."""

    pose: Rows
    joints: dict[str, JointCommands]


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


def read_motion_log(path: Path) -> MotionLog:
    """Return poses and joint states in an MCAP file: one topic of poses, and one of JointState."""
    return _bounded(_motion_log, path)


def _bounded(read: Callable[..., T], path: Path, *arguments: Any) -> T:
    """Return the result of a reader in a process with limits, since chunks may be bombs."""
    with regular_file(path, "messages as MCAP"):
        return bounded_read(read, path, *arguments)


def _motion_log(path: Path) -> MotionLog:
    first, table = _table(path, ("x", "y", "heading"))
    return MotionLog(table, _joint_commands(path, first))


def _table(path: Path, names: tuple[str, str, str]) -> tuple[int, Rows]:
    """Return the first time [ns] and the table of `read_mcap` with the given columns."""
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
    if any(np.diff(joint.t, prepend=-1.0).min() <= 0 for joint in joints.values()):
        raise DataError(
            f"{path}: expected increasing times of each joint in topic {topic!r}, found equal or "
            "decreasing ones; sort the messages, and keep one per time"
        )
    return joints


def _only_topic(path: Path, kinds: Sequence[str]) -> tuple[str, list[tuple[int, Any]]]:
    """Return the only topic with messages of the given types, and the messages with times [ns]."""
    topics: dict[str, list[tuple[int, Any]]] = {}
    others: dict[str, str] = {}
    for topic, time, message in _messages(path, kinds, others):
        topics.setdefault(topic, []).append((time, message))
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
            f"their type, found a file that defines others ({error}); convert the messages"
        ) from error


def _messages(
    path: Path, kinds: Sequence[str], others: dict[str, str]
) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, time [ns] and content of messages; add other topics and types to ``others``."""
    ros = ros_package()
    from mcap.reader import make_reader

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
            yield channel.topic, record.log_time, decode(record.data)
    except DataError:
        raise
    except Exception as error:  # also errors of its parsers and codecs
        raise DataError(
            f"{path}: expected messages as MCAP, found a file that is damaged or of another "
            f"format ({type(error).__name__}); repair it with 'mcap recover', or record it again"
        ) from error


def _rows(messages: list[tuple[int, Any]]) -> Iterator[tuple[int, float, float, float]]:
    last = messages[-1][1]
    if type(last).__name__ == "Path":
        messages = [(_time(pose, 0), pose) for pose in last.poses]
    for recorded, message in messages:
        time = _time(message, recorded)
        kind = type(message).__name__
        if kind in ("Odometry", "PoseStamped"):
            pose = message.pose.pose if kind == "Odometry" else message.pose
            q = pose.orientation
            yaw = atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))
            yield time, pose.position.x, pose.position.y, yaw
        else:
            twist = message.twist if kind == "TwistStamped" else message
            yield time, twist.linear.x, twist.linear.y, twist.angular.z


def _time(message: Any, recorded: int) -> int:
    if not hasattr(message, "header"):
        return recorded
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)
