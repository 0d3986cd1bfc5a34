"""Maps from scattered points in text files, and from point clouds (LAS, LAZ, PLY, PCD)."""

from __future__ import annotations

import io
import math
import os
import re
import struct
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from slipfree.core.errors import DataError, missing_package
from slipfree.core.records import Array, Mask
from slipfree.files.maps.missing_values import check_values
from slipfree.files.maps.raster import Reading
from slipfree.files.maps.reference_systems import (
    LENGTHS,
    UNKNOWN_ZONE,
    refuse,
    reprojection,
    scale_facts,
    system_name,
)
from slipfree.files.tables import ALIASES, read_columns, read_names
from slipfree.system.processes import bounded_read
from slipfree.terrain.grid_ops import (
    MAX_COORDINATE,
    WINDOW_TOLERANCE,
    Heights,
    UniformAxis,
    Window,
    parts,
)

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


NAMES = ("x", "y", "z")
BLOCK = 2**20  # number of nodes interpolated at once; limits the memory
PACKAGES = {".ply": ("plyfile",), ".pcd": ("pypcd4",)}
READERS = {".ply": ply_points, ".pcd": pcd_points}  # of endings other than those of LAS
CHUNK = 200_000  # number of points of a LAS file read at once
MAX_RECORD = 4096  # largest size of a point [bytes]
GROUND, NOISE = 2, (7, 18)  # classes of points in LAS files
POINTS_PER_CELL = 4.0  # default mean number; with random points, one cell in 55 is empty
COARSE = 64.0  # mean number of points in the cells that measure the covered area
MARGIN = 4.0  # width of the border around a window that is also read, in cells
MAX_UNNAMED = 16  # largest number of columns without names
MAX_POINTS = 1e8  # largest number of points in memory, 25 bytes each
VERTICAL_UNIT, VERTICAL_SYSTEM, LINEAR_UNIT = 4099, 4096, 3076  # keys of GeoTIFF
UNITS = {9001: "metre", 9002: "foot", 9003: "US survey foot"}  # codes of EPSG
TO_METRES = "pdal translate in.laz out.laz reprojection --filters.reprojection.out_srs={}"
TO_METRIC_HEIGHTS = (
    "convert them to metres and state the horizontal system alone: pdal translate in.laz out.laz "
    "assign --filters.assign.value='Z = Z * METRES_PER_UNIT' --writers.las.a_srs=EPSG:326xx"
)


def read_points(path: Path, ask: Reading) -> Heights:
    """Return the height map interpolated linearly from scattered points; holes outside their hull.

    The first node is at the smallest x and y of all points.
    """
    names = [name.lower() for name in read_names(path, "points")]
    if len(names) > MAX_UNNAMED and names[0] == "1":
        remedy = "name it .asc, after the lines ncols, nrows, xllcorner, yllcorner and cellsize"
        found = f"{len(names)} columns without names, probably a matrix of heights"
        refuse(f"points, with x, y, z in the first of at most {MAX_UNNAMED} columns", found, remedy)
    geographic = any("longitude" in same and same.intersection(names) for same in ALIASES)
    unit = "deg" if geographic else "m"
    columns = {"x": "longitude", "y": "latitude", "z": "z"} if geographic else NAMES
    values, notes, _ = read_columns(path, columns, "points", others=True)
    table = np.column_stack([values[name] for name in NAMES])
    if (farthest := float(np.abs(table).max(initial=0.0))) > MAX_COORDINATE:
        wanted = f"coordinates with absolute values of at most {MAX_COORDINATE:g} m"
        refuse(wanted, f"{farthest:g}", "correct the file")
    check_values(
        table[:, 2],
        lambda k: f"x = {table[k[0], 0]:.9g}, y = {table[k[0], 1]:.9g}",
        lambda _, value: f"remove the lines with z = {value}",
        metres=ask.vertical_scale or 1.0,
    )
    points, repeated, apart = _distinct(table)
    spacing = ask.spacing
    distance = _distance(points[:, :2])
    if spacing is None:
        refuse(
            f"spacing, the distance between grid nodes in {unit}",
            "none",
            f"the median distance of {len(points)} points from their nearest neighbours is "
            f"{distance:.3g} {unit}: set spacing = {distance:.2g}",
        )
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    counts = np.floor((high - low) / spacing + WINDOW_TOLERANCE).astype(int) + 1
    x, y = (UniformAxis(float(a), spacing, int(n)) for a, n in zip(low, counts, strict=True))
    if counts.min() < 4:
        size = f"{counts[0]} by {counts[1]} at spacing = {spacing:g} {unit}"
        remedy = f"set a smaller spacing, such as {distance:.2g}"
        refuse("points that span at least 4 by 4 nodes", size, remedy)
    i, j = parts(x, y, ask.window)
    z = interpolate_points(points, low, spacing, (i, j))
    facts = [
        f"{len(points)}, a median of {distance:.3g} {unit} apart, for {z.size} nodes {spacing:g} "
        f"{unit} apart"
    ]
    if repeated:
        facts.append(
            f"{repeated} at repeated positions averaged, with height differences of at most "
            f"{apart:.3g} m"
        )
    described = ("ground map", "scattered points"), ("ground points", "; ".join([*facts, *notes]))
    return Heights(x.nodes(i), y.nodes(j), z, described, geographic=geographic)


def _distinct(points: Array) -> tuple[Array, int, float]:
    """Return points, shape (n, 3), averaged at equal x and y, repetitions and the largest rise."""
    places, which = np.unique(points[:, :2], axis=0, return_inverse=True)
    which = which.reshape(-1)
    z = np.bincount(which, points[:, 2]) / np.bincount(which)
    repeated = len(points) - len(places)
    high, low = np.full(len(places), -np.inf), np.full(len(places), np.inf)
    np.maximum.at(high, which, points[:, 2])
    np.minimum.at(low, which, points[:, 2])
    single = high == low  # averaging would round these
    z[single] = high[single]
    return np.column_stack([places, z]), repeated, float((high - low).max(initial=0.0))


def _distance(places: Array) -> float:
    """Return the median distance of points from their nearest neighbours [m]."""
    from scipy.spatial import cKDTree  # imported here: the import takes 0.2 s

    if len(places) < 3:
        refuse("at least 3 points with different x, y", f"{len(places)}", "add points")
    return float(np.median(cKDTree(places).query(places, k=2)[0][:, 1]))


def interpolate_points(
    points: Array, low: Array, spacing: float, part: tuple[slice, slice]
) -> Array:
    """Return heights at nodes, interpolated linearly; NaN outside the convex hull of the points.

    The first node is at ``low``; ``part`` are the indices of the wanted nodes along x and y.
    """
    from scipy.interpolate import LinearNDInterpolator  # imported here: the import takes 0.2 s
    from scipy.spatial import QhullError

    cells = (points[:, :2] - low) / spacing  # relative to the first node: less rounding
    nodes = np.rint(cells)
    # points within rounding of nodes are moved there: nodes on the border must be in the hull
    cells = np.where(np.abs(cells - nodes) < WINDOW_TOLERANCE, nodes, cells)
    try:
        surface = LinearNDInterpolator(cells, points[:, 2])
    except QhullError as error:
        raise DataError(
            "expected points that span a surface, found that they lie on a line in x and y; check "
            "their x and y"
        ) from error
    i, j = (np.arange(each.start, each.stop, dtype=np.float64) for each in part)
    step = max(BLOCK // j.size, 1)
    rows = [surface(i[k : k + step, None], j[None]) for k in range(0, i.size, step)]
    return np.concatenate(rows)


class _Cloud(NamedTuple):
    points: Array  # shape (n, 3), heights in the unit of the file [m]
    ground: Mask  # whether a point is classified as ground
    omitted: int  # number of points without finite coordinates
    file: Points


def read_point_cloud(path: Path, ask: Reading) -> Heights:
    """Return the height map of a point cloud (LAS, LAZ, PLY, PCD), with holes in empty cells.

    Points classified as ground are used if there are any. Those of a cell are averaged in x, y and
    z, and heights are interpolated linearly between these averages: a plane is exact.
    """
    for name in PACKAGES.get(path.suffix.lower(), ("laspy", "lazrs")):
        if find_spec(name) is None:
            raise DataError(missing_package(name, "points"))
    # lazrs aborts the process for some damaged files; gridding there keeps the points there
    return bounded_read(_heights, path, ask.spacing, ask.window, rate=1e5, growth=50.0)


def _heights(path: Path, spacing: float | None, window: Window | None) -> Heights:
    """Return the height map of a point cloud; see `read_point_cloud`."""
    near = None
    if window is not None and spacing is not None:  # its border also depends on points outside
        margin = MARGIN * spacing
        near = window[0] - margin, window[1] + margin, window[2] - margin, window[3] + margin
    cloud = _read(path, near)
    middle = np.mean(cloud.points[:, :2], axis=0) if len(cloud.points) else (math.nan, math.nan)
    name, geographic = system_name(cloud.file.crs, TO_METRES, *middle)
    if geographic:
        remedy = reprojection(cloud.file.crs, TO_METRES, *middle)
        refuse("a point cloud in metres", f"degrees ({name})", remedy)
    points = cloud.points[cloud.ground] if cloud.ground.any() else cloud.points
    if len(points) < 3:
        remedy = "use another file" if near is None else "enlarge or move the window"
        refuse("at least 3 points", f"{len(points)}", remedy)
    check_values(
        points[:, 2],
        lambda k: f"x = {points[k][0]:.9g}, y = {points[k][1]:.9g}",
        lambda marker, _: (
            f"remove these points: pdal translate in{path.suffix} out{path.suffix} range "
            f"--filters.range.limits='Z[{marker.low:.9g}:{marker.high:.9g}]'"
        ),
    )
    density = _density(points)
    cell = spacing or float(f"{math.sqrt(POINTS_PER_CELL / density):.2g}")
    first, last = (
        np.rint(ends / cell).astype(np.int64).tolist()
        for ends in (points[:, :2].min(axis=0), points[:, :2].max(axis=0))
    )
    x, y = (UniformAxis(a * cell, cell, b - a + 1) for a, b in zip(first, last, strict=True))
    i, j = parts(x, y, window)
    z, occupied = _gridded(points, x, y, (i, j))
    chosen = ""
    if not spacing:
        chosen = f", chosen for {POINTS_PER_CELL:g} points in each (override with spacing)"
    used = f"{len(points)} classified as ground, of" if cloud.ground.any() else "all"
    words = (
        f"{used} {len(cloud.points)} points, {density:.3g} per m2; cells of {cell:g} m{chosen}; "
        f"{occupied} of {z.size} cells have points"
    )
    if cloud.omitted:
        words += f"; {cloud.omitted} without coordinates left out"
    unit = LENGTHS[cloud.file.unit.lower()]
    heights = "in metres" if cloud.file.unit else "unit not stated: taken as metres"
    if unit != 1:
        heights = f"converted from {cloud.file.unit} ({unit:.9g} m)"
    nodes = x.nodes(i), y.nodes(j)
    facts = (
        ("ground map", f"{cloud.file.format} point cloud, {name or 'CRS not given'}"),
        ("ground points", words),
        ("ground map heights", heights),
        *scale_facts(cloud.file.crs, nodes[0].mean(), nodes[1].mean(), TO_METRES),
    )
    return Heights(*nodes, unit * z, facts, name)


def _read(path: Path, near: Window | None) -> _Cloud:
    """Return the points of a file in ``near`` (default all), except noise and withheld points."""
    points, ground, omitted = [np.empty((0, 3))], [np.empty(0, bool)], 0
    ending = path.suffix.lower()
    try:
        with path.open("rb") as stream:
            file = READERS.get(ending, _las_points)(stream)
            for places, kind in file.chunks:
                known = np.isfinite(places).all(axis=1)
                good = known & ~np.isin(kind, NOISE)
                omitted += int(np.count_nonzero(~known))
                x, y, _ = places.T
                if near is not None:
                    good &= (x >= near[0]) & (x <= near[1]) & (y >= near[2]) & (y <= near[3])
                points.append(places[good])
                ground.append(kind[good] == GROUND)
                if sum(map(len, ground)) > MAX_POINTS:
                    remedy = "set spacing and window, or thin the points"
                    refuse(f"at most {MAX_POINTS:g} points", "more in the file", remedy)
            cloud = np.concatenate(points)
            if (np.abs(cloud) > MAX_COORDINATE).any():
                raise ValueError(f"coordinates that exceed {MAX_COORDINATE:g}")
            return _Cloud(cloud, np.concatenate(ground), omitted, file)
    except (DataError, OSError):
        raise
    except Exception as error:  # the packages raise many kinds for damaged files
        name = ending[1:].upper() if ending in READERS else "LAS or LAZ"
        raise DataError(
            f"expected a readable {name} file, found {str(error).rstrip('.')}; copy, export or "
            "download it again: it may be truncated or damaged"
        ) from error


def _las_points(stream: BinaryIO) -> Points:
    """Return the points of a LAS or LAZ file; withheld points have the class of noise."""
    import laspy

    _check_header(stream)
    file = laspy.open(stream, laz_backend=laspy.LazBackend.Lazrs, closefd=False)

    def chunks() -> Iterator[tuple[Array, Array]]:
        for chunk in file.chunk_iterator(CHUNK):
            places = np.column_stack([np.asarray(each) for each in (chunk.x, chunk.y, chunk.z)])
            if not np.isfinite(places).all():
                raise ValueError("coordinates that are not finite")
            kind = np.asarray(chunk.classification)
            yield places, np.where(np.asarray(chunk.withheld, bool), NOISE[0], kind)

    return Points(f"LAS {file.header.version}", chunks(), *_system(file.header))


def _check_header(stream: BinaryIO) -> None:
    """Raise ValueError if the header announces more records than the file can contain.

    laspy reads as many records as are announced, which may take minutes.
    """
    size = stream.seek(0, os.SEEK_END)
    stream.seek(0)
    head = stream.read(247)
    stream.seek(0)
    if len(head) < 227 or head[:4] != b"LASF":
        raise ValueError("no header of such a file")
    start, records = struct.unpack_from("<II", head, 96)
    if not 54 * records <= start <= size:
        raise ValueError(f"{records} records before the points, which begin at byte {start}")
    if (length := struct.unpack_from("<H", head, 105)[0]) > MAX_RECORD:
        raise ValueError(f"{length} bytes for each point")
    if head[24:26] >= b"\x01\x04" and len(head) == 247:
        start, records = struct.unpack_from("<QI", head, 235)
        if records and not start + 60 * records <= size:
            raise ValueError(f"{records} records from byte {start}, beyond the end of the file")


def _system(header: Any) -> tuple[Any, str]:
    """Return the horizontal reference system of a file, and the unit of its heights."""
    import pyproj
    import rasterio

    keys = {
        key.id: key.value_offset
        for record in header.vlrs.get("GeoKeyDirectoryVlr")
        for key in record.geo_keys
        if key.tiff_tag_location == 0
    }
    crs = header.parse_crs()
    if crs is None:
        if (code := keys.get(LINEAR_UNIT, 9001)) != 9001:
            remedy = f"reproject it to metres: {TO_METRES.format(UNKNOWN_ZONE)}"
            refuse("coordinates in metres", f"the unit {UNITS.get(code, code)!r}", remedy)
        return None, _vertical_unit(keys, None)
    flat = crs.sub_crs_list[0] if crs.is_compound else crs.to_2d()
    vertical = crs.sub_crs_list[1] if crs.is_compound else crs
    if (code := keys.get(VERTICAL_SYSTEM)) is not None and not crs.is_compound:
        vertical = pyproj.CRS.from_epsg(code)
    return rasterio.CRS.from_wkt(flat.to_wkt()), _vertical_unit(keys, vertical)


def _vertical_unit(keys: dict[int, int], vertical: Any) -> str:
    """Return the unit of heights of a file by its GeoTIFF keys or its vertical system."""
    code = keys.get(VERTICAL_UNIT)
    name = UNITS.get(code, f"EPSG unit {code}") if code is not None else ""
    if not name and vertical is not None:
        axes = [axis for axis in vertical.axis_info if axis.direction in ("up", "down")]
        name = axes[0].unit_name if axes else ""
    if name.lower() not in LENGTHS:
        refuse("heights in a unit of length", f"the unit {name!r}", TO_METRIC_HEIGHTS)
    return name


def _density(points: Array) -> float:
    """Return the number of points per area, excluding areas without points [1/m2]."""
    low, extent = points[:, :2].min(axis=0), np.ptp(points[:, :2], axis=0)
    if not extent.prod() > 0:
        refuse("points that span a surface", "that they lie on a line in x and y", "check the file")
    cells = np.maximum(np.rint(extent / math.sqrt(COARSE * extent.prod() / len(points))), 1)
    i, j = np.minimum((points[:, :2] - low) / extent * cells, cells - 1).astype(np.int64).T
    covered = np.unique(i * int(cells[1]) + j).size / cells.prod()
    return float(len(points) / (covered * extent.prod()))


def _gridded(
    points: Array, x: UniformAxis, y: UniformAxis, part: tuple[slice, slice]
) -> tuple[Array, int]:
    """Return heights at nodes, NaN in cells without points, and the number of cells with points."""
    first = np.array([x.first, y.first])
    i, j = np.rint((points[:, :2] - first) / x.step).astype(np.int64).T
    cells, which = np.unique(i * y.size + j, return_inverse=True)
    count = np.bincount(which)
    # relative to the first node: sums of coordinates such as northings would lose digits
    means = [np.bincount(which, column) / count for column in (points[:, :2] - first).T]
    z = np.bincount(which, points[:, 2]) / count
    heights = interpolate_points(np.column_stack([*means, z]), np.zeros(2), x.step, part)
    rows, columns = (
        each - nodes.start for each, nodes in zip(np.divmod(cells, y.size), part, strict=True)
    )
    inside = (rows >= 0) & (rows < heights.shape[0]) & (columns >= 0) & (columns < heights.shape[1])
    occupied = np.zeros(heights.shape, bool)
    occupied[rows[inside], columns[inside]] = True
    return np.where(occupied, heights, np.nan), int(occupied.sum())
