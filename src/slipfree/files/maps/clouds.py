"""Points of PLY and PCD files, read by plyfile and pypcd4."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from slipfree.core.records import Array

MAX_HEADER = 2**16  # [bytes]
CLASSES = ("classification", "scalar_classification")  # properties with the classes of LAS
KINDS = {"=": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}  # of PLY


class Points(NamedTuple):
    """Points of a file, with their classes: 0 where the file has none."""

    format: str  # and version, such as "LAS 1.2"
    chunks: Iterable[tuple[Array, Array]]  # places, shape (n, 3), and classes, shape (n,)
    crs: Any = None  # horizontal reference system, rasterio.crs.CRS
    unit: str = ""  # of the heights; empty if unknown


def ply_points(stream: BinaryIO) -> Points:
    """Return the vertices of a PLY file; raise an exception if it is damaged."""
    from plyfile import PlyData

    data = PlyData.read(io.BytesIO(_without_comments(stream, b"comment", b"end_header")))
    names = [element.name for element in data.elements]
    if "vertex" not in names:
        raise ValueError(f"the elements {', '.join(names) or 'none'} without 'vertex'")
    return Points(f"PLY ({KINDS[data.byte_order]})", [_columns(data["vertex"].data)])


def pcd_points(stream: BinaryIO) -> Points:
    """Return the points of a PCD file; raise an exception if it is damaged."""
    from pypcd4.pypcd4 import PointCloud

    head, data = _without_comments(stream, b"#", b"DATA").split(b"DATA", 1)
    fields, counts = (
        re.search(rb"^%b(.*)" % key, head, re.MULTILINE) for key in (b"FIELDS", b"COUNT")
    )
    if counts is None and fields:  # one value each, as older writers imply
        head += b"COUNT" + b" 1" * len(fields[1].split()) + b"\n"
    elif counts and sum(map(int, counts[1].split())) > len(data):
        raise ValueError(
            f"{counts[0].decode()[:80]}, more values of a point than the file has bytes"
        )
    if data.split(maxsplit=1)[0] == b"ascii":  # pypcd4 expects one blank between values
        data = b"\n".join(b" ".join(line.split()) for line in data.split(b"\n"))
    cloud = PointCloud.from_fileobj(io.BufferedReader(io.BytesIO(head + b"DATA " + data.lstrip())))
    about, found = cloud.metadata, cloud.pc_data
    if len(found) != about.points or about.points != about.width * about.height:
        raise ValueError(
            f"{len(found)} points where {about.points} were announced, {about.width} times "
            f"{about.height} in a grid"
        )
    return Points(f"PCD {about.version} ({about.data.value})", [_columns(found)])


def _without_comments(stream: BinaryIO, mark: bytes, last: bytes) -> bytes:
    """Return a file without the comments of its header, which may be in any encoding."""
    data = stream.read()
    end = re.search(rb"^%b\b" % last, data[:MAX_HEADER], re.MULTILINE)
    if end is None:
        raise ValueError(f"no header that ends with {last.decode()!r}")
    head = re.sub(rb"^%b.*\n" % mark, b"", data[: end.start()], flags=re.MULTILINE)
    return head + data[end.start() :]


def _columns(rows: Any) -> tuple[Array, Array]:
    """Return the places and the classes in an array of named columns."""
    names = {name.lower(): name for name in rows.dtype.names}
    if missing := [name for name in "xyz" if name not in names]:
        raise ValueError(f"points with {', '.join(names)[:80]}, without {missing[0]!r}")
    kinds = next((rows[names[name]] for name in CLASSES if name in names), np.zeros(len(rows)))
    return np.column_stack([rows[names[name]].astype(np.float64) for name in "xyz"]), kinds
