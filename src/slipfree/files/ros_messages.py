"""Definitions of the ROS 2 messages that MCAP files of slipfree contain."""

from __future__ import annotations

import re
from collections.abc import Iterator
from types import ModuleType

from slipfree.errors import DataError, missing_package

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


def definition(name: str) -> str:
    """Return the definition of a message, followed by those of the messages that it contains."""
    parts = dict.fromkeys(_contained(name))
    others = [f"{'=' * 80}\nMSG: {part}\n{DEFINITIONS[part]}" for part in parts]
    return "\n".join([DEFINITIONS[name], *others])


def _contained(name: str) -> Iterator[str]:
    """Yield the names of the messages that a message contains, at any depth."""
    for part in re.findall(r"^\w+/\w+", DEFINITIONS[name], re.MULTILINE):
        yield part
        yield from _contained(part)


def ros_package() -> ModuleType:
    """Return the package ``mcap_ros2``; raise DataError if it is not installed."""
    try:
        import mcap_ros2.decoder
        import mcap_ros2.writer
    except ImportError as error:
        raise DataError(missing_package("mcap-ros2-support", "ros")) from error
    return mcap_ros2
