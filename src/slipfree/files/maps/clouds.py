"""Points of PLY and PCD files: text, binary, and binary compressed by LZF."""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from slipfree.core.records import Array

CHUNK = 200_000  # number of points read at once
MAX_RECORD = 4096  # largest size of a point [bytes]
MAX_HEADER = 2**16  # [bytes]
CLASSES = ("classification", "scalar_classification")  # properties with the classes of LAS
PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
PCD_KINDS = {"I": "1248", "U": "1248", "F": "48"}  # sizes of the types, in bytes
PCD_DATA = ("ascii", "binary", "binary_compressed")
# LZF copies at most 264 bytes for 3 bytes of its own
MAX_EXPANSION = 88


class Points(NamedTuple):
    """Points of a file, with their classes: 0 where the file has none."""

    format: str  # and version, such as "LAS 1.2"
    chunks: Iterator[tuple[Array, Array]]  # places, shape (n, 3), and classes, shape (n,)
    crs: Any = None  # horizontal reference system, rasterio.crs.CRS
    unit: str = ""  # of the heights; empty if unknown


class _Field(NamedTuple):
    """Property of a point: its name, type, as in "<f4", and number of values."""

    name: str
    type: str
    size: int = 1


class _Element(NamedTuple):
    """Rows of a PLY file: their name and number, and their properties; a list has no fixed size."""

    name: str
    rows: int
    fields: list[_Field]
    lists: list[str]


def ply_points(stream: BinaryIO) -> Points:
    """Return the vertices of a PLY file; raise ValueError if it is damaged."""
    head = stream.read(MAX_HEADER)
    end = re.search(rb"end_header[ \t]*(\r\n|\n|\r)", head)
    if not re.match(rb"ply[ \t]*[\r\n]", head) or end is None:
        raise ValueError(f"no header from 'ply' to 'end_header' in its first {MAX_HEADER} bytes")
    kind, elements = _ply_header(head[: end.start()].decode("ascii", "replace").splitlines()[1:])
    names = [element.name for element in elements]
    if "vertex" not in names:
        raise ValueError(f"the elements {', '.join(names) or 'none'} without 'vertex'")
    before, vertex = elements[: names.index("vertex")], elements[names.index("vertex")]
    if vertex.lists:
        raise ValueError(f"vertices with lists: {', '.join(vertex.lists)}")
    start, rows = end.end(), sum(element.rows for element in before)
    if kind == "ascii":
        stream.seek(start)
        lines = (line for line in stream if line.strip())
        chunks = _text_chunks(islice(lines, rows, None), vertex.fields, vertex.rows)
    else:
        if any(element.lists for element in before):
            raise ValueError("lists before the vertices; write the vertices first")
        start += sum(element.rows * _dtype(element.fields).itemsize for element in before)
        chunks = _binary_chunks(stream, start, vertex.fields, vertex.rows)
    return Points(f"PLY ({kind})", chunks)


def _ply_header(lines: Sequence[str]) -> tuple[str, list[_Element]]:
    """Return the format and the elements that the lines of a header declare."""
    kind, elements = "", list[_Element]()
    for line in lines:
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", name, _] if name in ORDERS and not kind:
                kind = name
            case ["element", name, count] if kind:
                elements.append(_Element(name, _count(count, f"element {name}"), [], []))
            case ["property", "list", _, _, name] if elements:
                elements[-1].lists.append(name)
            case ["property", kind_of, name] if elements and kind_of in PLY_TYPES:
                elements[-1].fields.append(_Field(name, ORDERS[kind] + PLY_TYPES[kind_of]))
            case _:
                raise ValueError(f"the line {line[:80]!r} in its header")
    if not kind:
        raise ValueError(f"a header without format, one of {', '.join(ORDERS)}")
    return kind, elements


def pcd_points(stream: BinaryIO) -> Points:
    """Return the points of a PCD file; raise ValueError if it is damaged."""
    head = stream.read(MAX_HEADER)
    end = re.search(rb"^DATA[ \t]+(\w+)[ \t]*\r?\n", head, re.MULTILINE)
    if end is None:
        raise ValueError(f"no header that ends with 'DATA' in its first {MAX_HEADER} bytes")
    data = end[1].decode()
    if data not in PCD_DATA:
        raise ValueError(f"DATA {data}, which is none of {', '.join(PCD_DATA)}")
    entries = dict[str, list[str]]()
    for line in head[: end.start()].decode("ascii", "replace").splitlines():
        key, *words = line.split("#")[0].split() or [""]
        entries[key] = words
    fields, count = _pcd_fields(entries), _pcd_count(entries)
    if data == "ascii":
        stream.seek(end.end())
        chunks = _text_chunks((line for line in stream if line.strip()), fields, count, last=True)
    elif data == "binary":
        chunks = _binary_chunks(stream, end.end(), fields, count)
    else:
        chunks = _compressed_chunks(stream, end.end(), fields, count)
    return Points(f"PCD {' '.join(entries.get('VERSION', ['']))} ({data})", chunks)


def _pcd_fields(entries: dict[str, list[str]]) -> list[_Field]:
    """Return the properties of a point by the entries FIELDS, SIZE, TYPE and COUNT of a header."""
    for key in ("FIELDS", "SIZE", "TYPE"):
        if key not in entries:
            raise ValueError(f"a header without {key}")
    names = entries["FIELDS"]
    counts = entries.get("COUNT", ["1"] * len(names))
    rows = [names, entries["SIZE"], entries["TYPE"], counts]
    if len({len(row) for row in rows}) > 1:
        raise ValueError(f"{' and '.join(str(len(row)) for row in rows)} FIELDS, SIZE, TYPE, COUNT")
    fields = list[_Field]()
    for name, size, kind, number in zip(*rows, strict=True):
        if size not in [*PCD_KINDS.get(kind, "")]:
            raise ValueError(f"the field {name[:40]!r} of TYPE {kind[:9]} and SIZE {size[:9]}")
        fields.append(_Field(name, f"<{kind.lower()}{size}", _count(number, f"COUNT of {name}")))
    return fields


def _pcd_count(entries: dict[str, list[str]]) -> int:
    """Return the number of points by the entries WIDTH, HEIGHT and POINTS of a header."""
    sides, total = [entries.get(key) for key in ("WIDTH", "HEIGHT")], entries.get("POINTS")
    numbers = [_count(" ".join(each or ["1"]), "WIDTH or HEIGHT") for each in sides]
    count = numbers[0] * numbers[1]
    if total is None and None in sides:
        raise ValueError("a header without POINTS")
    if total is None:
        return count
    points = _count(" ".join(total), "POINTS")
    if None not in sides and points != count:
        raise ValueError(f"POINTS {points}, but {numbers[0]} times {numbers[1]} in a grid")
    return points


def _count(text: str, meaning: str) -> int:
    if not re.fullmatch(r"\d{1,15}", text, re.ASCII):
        raise ValueError(f"{text[:20]!r} as number ({meaning[:40]})")
    return int(text)


def _dtype(fields: Sequence[_Field]) -> np.dtype[Any]:
    """Return the type of a point; its fields are numbered, since names may be repeated."""
    size = sum(np.dtype(field.type).itemsize * field.size for field in fields)
    if size > MAX_RECORD:
        raise ValueError(f"{size} bytes for each point")
    return np.dtype([(f"f{k}", each.type, (each.size,)) for k, each in enumerate(fields)])


def _columns(fields: Sequence[_Field]) -> list[int]:
    """Return the indices of x, y, z and, if there are any, of the classes."""
    names = [field.name.lower() for field in fields]
    for name in "xyz":
        if name not in names or fields[names.index(name)].size != 1:
            raise ValueError(f"points with {', '.join(names)[:80] or 'nothing'}, without {name!r}")
    classes = [names.index(name) for name in CLASSES if name in names]
    return [*map(names.index, "xyz"), *classes[:1]]


def _binary_chunks(
    stream: BinaryIO, start: int, fields: Sequence[_Field], count: int
) -> Iterator[tuple[Array, Array]]:
    """Yield the points of a binary file, point by point from byte ``start``."""
    indices, kind = _columns(fields), _dtype(fields)
    size = stream.seek(0, os.SEEK_END)
    if start + count * kind.itemsize > size:
        raise ValueError(
            f"{size - start} bytes where {count} points of {kind.itemsize} bytes were announced"
        )
    stream.seek(start)
    for first in range(0, count, CHUNK):
        number = min(CHUNK, count - first)
        rows = np.frombuffer(stream.read(number * kind.itemsize), kind)
        yield _split(np.hstack([rows[f"f{k}"].astype(np.float64) for k in indices]))


def _compressed_chunks(
    stream: BinaryIO, start: int, fields: Sequence[_Field], count: int
) -> Iterator[tuple[Array, Array]]:
    """Yield the points of a file whose fields are stored one after the other, compressed."""
    indices, kind = _columns(fields), _dtype(fields)
    size = stream.seek(0, os.SEEK_END)
    stream.seek(start)
    sizes = stream.read(8)
    packed, whole = struct.unpack("<II", sizes) if len(sizes) == 8 else (0, 0)
    if start + 8 + packed > size or whole > MAX_EXPANSION * packed:
        raise ValueError(f"{size - start} bytes where {packed} and 8 were announced")
    if whole != count * kind.itemsize:
        raise ValueError(f"{whole} bytes for {count} points of {kind.itemsize} bytes")
    data = decompress_lzf(stream.read(packed), whole)
    offsets = np.cumsum([0, *(np.dtype(f.type).itemsize * f.size * count for f in fields)])
    columns = [np.frombuffer(data, fields[k].type, count, int(offsets[k])) for k in indices]
    for first in range(0, count, CHUNK):
        part = slice(first, first + CHUNK)
        yield _split(np.column_stack([column[part].astype(np.float64) for column in columns]))


def _text_chunks(
    lines: Iterator[bytes], fields: Sequence[_Field], count: int, *, last: bool = False
) -> Iterator[tuple[Array, Array]]:
    """Yield the points in ``count`` lines; after the ``last`` of a file there must be none."""
    sizes = np.cumsum([0, *(field.size for field in fields)])
    columns = sizes[_columns(fields)].tolist()
    for first in range(0, count, CHUNK):
        part = [*islice(lines, min(CHUNK, count - first))]
        if len(part) < min(CHUNK, count - first):
            raise ValueError(f"{first + len(part)} points where {count} were announced")
        yield _split(np.loadtxt(part, usecols=columns, ndmin=2, comments=None, encoding="latin-1"))
    if last and next(lines, None) is not None:
        raise ValueError(f"more than the announced {count} points")


def _split(table: Array) -> tuple[Array, Array]:
    """Return the places and the classes in the columns x, y, z and, if there is one, class."""
    kinds = table[:, 3] if table.shape[1] > 3 else np.zeros(len(table))
    return table[:, :3], kinds


def decompress_lzf(data: bytes, size: int) -> bytes:
    """Return the ``size`` bytes that LZF compressed to ``data``; ValueError if it is damaged."""
    out, i = bytearray(), 0
    try:
        while i < len(data):
            control = data[i]
            i += 1
            if control < 32:  # this number of bytes, and one more, follow as they are
                out += data[i : i + control + 1]
                i += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += data[i]
                i += 1
            length += 2
            back = ((control & 31) << 8) + data[i] + 1
            i += 1
            if back > len(out) or len(out) + length > size:
                break
            # a copy may overlap with itself: it then repeats its beginning
            out += (out[-back:] * (length // back + 1))[:length]
    except IndexError:
        pass
    if i != len(data) or len(out) != size:
        raise ValueError(f"compressed data that end after {len(out)} of {size} bytes")
    return bytes(out)
