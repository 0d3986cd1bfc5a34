"""Random files that libraries read in a process with limits: point clouds, meshes, MCAP."""

import io
import struct
from collections.abc import Callable
from functools import cache
from random import Random
from typing import Any

import numpy as np

from helpers.fuzz_damage import Case, damaged

COUNTS = (0, 1, 255, 2**16 - 1, 2**31 - 1, 2**32 - 1)
MESHES = ("stl", "dae", "obj", "ply", "glb")
WHEEL = (
    '<link name="{0}"><visual><origin rpy="1.5707963 0 0"/><geometry><mesh filename="wheel.{1}"/>'
    '</geometry></visual></link><joint name="{0}_joint" type="continuous"><parent link="base"/>'
    '<child link="{0}"/><origin xyz="{2}"/><axis xyz="0 1 0"/></joint>'
)
POSE = {
    "header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": "map"},
    "pose": {
        "position": {"x": 1.0, "y": 0.0, "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    },
}
MESSAGES: dict[str, dict[str, Any]] = {
    "nav_msgs/Path": {"header": POSE["header"], "poses": [POSE] * 20},
    "sensor_msgs/JointState": {
        "header": POSE["header"],
        "name": ["left", "right"],
        "position": [1.0, 2.0],
        "velocity": [0.1, 0.2],
        "effort": [],
    },
}


@cache
def _clouds() -> tuple[bytes, ...]:
    """Return a LAZ and a LAS file."""
    import laspy

    found = []
    for version, kind in (("1.2", 1), ("1.4", 6)):
        data = laspy.LasData(laspy.LasHeader(point_format=kind, version=version))
        data.x, data.y, data.z = np.random.default_rng(1).uniform(0, 20, (3, 500))
        for is_compressed in (True, True, False):
            stream = io.BytesIO()
            data.write(stream, do_compress=is_compressed)
            found.append(stream.getvalue())
    return tuple(found)


def cloud(kind: str, rng: Random) -> Case:
    """Return a damaged point cloud."""
    return Case(kind, {"cloud.laz": _hurt(rng.choice(_clouds()), rng)}, "cloud.laz")


@cache
def _mesh(ending: str) -> bytes:
    """Return a wheel as a mesh."""
    import trimesh

    raw = trimesh.creation.cylinder(0.1, 0.05, sections=24).export(file_type=ending)
    return raw.encode() if isinstance(raw, str) else raw


def mesh(kind: str, rng: Random) -> Case:
    """Return a URDF whose wheels are a damaged mesh."""
    ending, places = rng.choice(MESHES), ("0.4 0.3 0", "0.4 -0.3 0", "-0.4 0 0")
    wheels = "".join(WHEEL.format(f"wheel_{k}", ending, at) for k, at in enumerate(places))
    robot = f'<robot name="r"><link name="base"/>{wheels}</robot>'.encode()
    raw = _hurt(_mesh(ending), rng)
    return Case(kind, {"r.urdf": robot, f"wheel.{ending}": raw}, "r.urdf")


@cache
def _logs() -> tuple[bytes, ...]:
    """Return MCAP files of a path and of joints, compressed and not."""
    from mcap.writer import CompressionType
    from mcap_ros2.writer import Writer

    from slipfree.files.mcap import definition

    found = []
    for kind, message in MESSAGES.items():
        for compression in (CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4):
            stream = io.BytesIO()
            writer = Writer(stream, compression=compression)
            schema = writer.register_msgdef(kind.replace("/", "/msg/"), definition(kind))
            writer.write_message("/a", schema, message, log_time=1)
            writer.finish()
            found.append(stream.getvalue())
    return tuple(found)


def log(kind: str, rng: Random) -> Case:
    """Return a damaged MCAP file."""
    return Case(kind, {"log.mcap": _hurt(rng.choice(_logs()), rng)}, "log.mcap")


def _hurt(raw: bytes, rng: Random) -> bytes:
    """Return a file with faults, half of them wrong counts near its beginning."""
    if rng.random() < 0.5:
        return damaged(raw, rng)
    data = bytearray(raw)
    for _ in range(rng.choice([1, 2, 4])):
        at = rng.randrange(max(min(len(data) - 8, rng.choice([100, 700, 10**6])), 1))
        width, form = rng.choice([(2, "<H"), (4, "<I"), (8, "<Q")])
        data[at : at + width] = struct.pack(form, rng.choice(COUNTS) % 256**width)
    return bytes(data)


LIBRARY_KINDS: dict[str, Callable[[str, Random], Case]] = {"laz": cloud, "mesh": mesh, "mcap": log}
