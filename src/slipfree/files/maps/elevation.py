"""Elevation models: maps from files, as rasters, arrays, scattered points or point clouds."""

from __future__ import annotations

import io
import math
import os
import re
import struct
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from pkgutil import iter_modules
from typing import Any, BinaryIO, Literal, NamedTuple

import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.errors import DataError, ModelError, missing_package
from slipfree.core.records import Array, Indices, Mask
from slipfree.files import maps
from slipfree.files.foreign_formats import check_contents, check_ending
from slipfree.files.maps import raster
from slipfree.files.maps.reference_systems import (
    LENGTHS,
    UNKNOWN_ZONE,
    metric_system,
    refuse,
    reprojection,
    scale_facts,
    system_name,
)
from slipfree.files.tables import ALIASES, read_columns, read_names
from slipfree.system.processes import bounded_read
from slipfree.system.regular_files import regular_file
from slipfree.terrain.base import Friction, Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.grid_ops import (
    MAX_COORDINATE,
    MAX_NODES,
    WINDOW_TOLERANCE,
    Heights,
    UniformAxis,
    Window,
    axes_of,
    continue_over_holes,
    fill_holes,
    parts,
)

MAX_HEADER = 2**16  # [bytes]
CLASSES = ("classification", "scalar_classification")  # properties with the classes of LAS
KINDS = {"=": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}  # of PLY
NAMES = ("x", "y", "z")
BLOCK = 2**20  # number of nodes interpolated at once; limits the memory
PACKAGES = {".ply": ("plyfile",), ".pcd": ("pypcd4",)}
CHUNK = 200_000  # number of points of a LAS file read at once
MAX_RECORD = 4096  # largest size of a point [bytes]
GROUND, NOISE = 2, (7, 18)  # classes of points in LAS files
POINTS_PER_CELL = 4.0  # default mean number; with random points, one cell in 55 is empty
ROUGH = 0.25  # largest rounding of coordinates [distance of points, or cells]
MANY_SHARE, STEEP = 0.25, 0.1  # of places with several heights, and their range [distance]
MANY, THICKER = 100_000, 3.0  # points that show the upward axis, and least ratio of shares [1]
COARSE = 64.0  # mean number of points in the cells that measure the covered area
OFF_NODE = 0.02  # largest distance of points of a regular grid from its nodes, by rounding [step]
MARGIN = 4.0  # width of the border around a window that is also read, in cells
MAX_UNNAMED = 16  # largest number of columns without names
MAX_POINTS = 1e8  # largest number of points in memory, 25 bytes each
VERTICAL_UNIT, VERTICAL_SYSTEM, LINEAR_UNIT = 4099, 4096, 3076  # keys of GeoTIFF
UNITS = {9001: "metre", 9002: "foot", 9003: "US survey foot"}  # codes of EPSG
TO_METRES = "pdal translate in.laz out.laz reprojection --filters.reprojection.out_srs={}"
TO_METRIC_HEIGHTS = (
    "multiply them by {0} and state the horizontal system alone: pdal translate in.laz out.laz "
    "assign --filters.assign.value='Z = Z * {0}' --writers.las.a_srs=EPSG:326xx"
)
EARTH_RADIUS = 6371008.8  # mean radius (2 a + b) / 3 of the WGS84 ellipsoid [m]
HEADER = 1e4  # largest header of a numpy array [bytes]
MAX_STRETCH = 0.01  # largest relative error of distances along x of a map in degrees
# semi-major axis [m] and squared eccentricity [1] of the WGS84 ellipsoid
SEMI_MAJOR, ECCENTRICITY_2 = 6378137.0, 6.69437999014e-3
TO_NPZ = "write it with np.savez(path, x=x, y=y, z=z)"
MAX_MEDIAN_SLOPE = 50.0  # a steeper map is taken to be in degrees [1]
HIGHEST = 9000.0  # largest height on the earth [m]
Facts = tuple[tuple[str, str], ...]
KEYS = ("cell", "registration", "spacing")  # arguments of some formats only


class Points(NamedTuple):
    """Points of a file, with their classes: 0 where the file has none."""

    format: str  # and version, such as "LAS 1.2"
    chunks: Iterable[tuple[Array, Array]]  # places, shape (n, 3), and classes, shape (n,)
    crs: Any = None  # horizontal reference system, rasterio.crs.CRS
    unit: str = ""  # of the heights; empty if unknown
    rounding: float = 0.0  # largest step of coordinates; 0 if unknown [unit of the file]


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
    plane = np.column_stack([rows[names[name]] for name in "xy"])
    plane = plane[np.isfinite(plane).all(axis=1)]
    if plane.dtype == np.float32 and (plane % 1).any():  # whole numbers are exact
        largest, area = np.abs(plane).max(), float(np.ptp(plane, axis=0).prod())
        if (rounding := float(np.spacing(largest))) > ROUGH * math.sqrt(area / len(plane)):
            refuse(
                "x and y that resolve the spacing of the points",
                f"{largest:.9g} in single precision, a multiple of {rounding:.2g}",
                "write x and y in double precision, or subtract an origin from them first",
            )
    return np.column_stack([rows[names[name]].astype(np.float64) for name in "xyz"]), kinds


CLOUDS = {".ply": ply_points, ".pcd": pcd_points}  # readers of endings other than those of LAS


def read_points(path: Path, ask: raster.Reading) -> Heights:
    """Return the height map interpolated linearly from scattered points; holes outside their hull.

    The first node is at the smallest x and y of all points. Points on a regular grid need no
    spacing: they are its nodes, and nodes without a point are holes.
    """
    from scipy.spatial import cKDTree  # imported here: the import takes 0.2 s

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
    raster.check_values(
        table[:, 2],
        lambda k: f"x = {table[k[0], 0]:.9g}, y = {table[k[0], 1]:.9g}",
        lambda _, value: f"remove the lines with z = {value}",
        metres=ask.vertical_scale or 1.0,
    )
    # points at equal x and y are averaged, unless that would only round their height
    places, which = np.unique(table[:, :2], axis=0, return_inverse=True)
    which = which.reshape(-1)
    z = np.bincount(which, table[:, 2]) / np.bincount(which)
    top, bottom = np.full(len(places), -np.inf), np.full(len(places), np.inf)
    np.maximum.at(top, which, table[:, 2])
    np.minimum.at(bottom, which, table[:, 2])
    points = np.column_stack([places, np.where(top == bottom, top, z)])
    repeated, apart = len(table) - len(points), float((top - bottom).max(initial=0.0))
    if len(points) < 3:
        refuse("at least 3 points with different x, y", f"{len(points)}", "add points")
    nodes = None if ask.spacing else regular_nodes(places)
    # median distance from the nearest neighbours
    distance = float(np.median(cKDTree(places).query(places, k=2)[0][:, 1]))
    if np.mean(top - bottom > STEEP * distance) > MANY_SHARE and not geographic:
        refuse(
            "points at different x, y",
            f"{repeated} of {len(table)} at places of others, with heights up to {apart:.3g} m "
            "apart",
            "write x and y with more digits if they are rounded, or keep one surface of several",
        )
    _check_upward(table[:: len(table) // MANY + 1])
    if nodes is None and ask.spacing is None:
        refuse(
            f"spacing, the distance between grid nodes in {unit}",
            "none",
            f"the median distance of {len(points)} points from their nearest neighbours is "
            f"{distance:.3g} {unit}: set spacing = {distance:.2g} "
            f"(--set terrain.spacing={distance:.2g})",
        )
    low, extent = places.min(axis=0), np.ptp(places, axis=0)
    steps = np.full(2, ask.spacing) if nodes is None else extent / nodes.max(axis=0)
    counts = np.floor(extent / steps + WINDOW_TOLERANCE).astype(int) + 1
    x, y = map(UniformAxis, low.tolist(), steps.tolist(), counts.tolist())
    if counts.min() < 4:
        size = f"{counts[0]} by {counts[1]} at spacing = {x.step:g} {unit}"
        remedy = f"set a smaller spacing, such as {distance:.2g}"
        if not x.step > distance:
            remedy = "add points farther along x and y"
        elif np.abs(places).max() <= 360 and not geographic:  # largest longitude
            remedy += "; if x and y are degrees, name the columns longitude and latitude"
        refuse("points that span at least 4 by 4 nodes", size, remedy)
    i, j = parts(x, y, ask.window)
    if nodes is None:
        kind, z = "scattered points", interpolate_points(points - (*low, 0), x.step, (i, j))
    else:
        kind, z = "points on a regular grid, whose spacing is found", np.full(counts, np.nan)
        z[*nodes.T] = points[:, 2]
        z = z[i, j]
    words = (
        f"{len(points)}, a median of {distance:.3g} {unit} apart, for {z.size} nodes {x.step:g} "
        f"by {y.step:g} {unit} apart"
    )
    if repeated:
        words += f"; {repeated} at repeated positions averaged, at most {apart:.3g} m apart in z"
    described = ("ground map", kind), ("ground points", "; ".join([words, *notes]))
    return Heights(x.nodes(i), y.nodes(j), z, described, geographic=geographic)


def regular_nodes(places: Array) -> Indices | None:
    """Return the nodes of a regular grid at which places lie, both of shape (n, 2).

    The result is None if some lie elsewhere or at the same node, or if half of the nodes have none.
    """
    gaps = [np.diff(np.unique(values)) for values in places.T]  # steps, or rounding of coordinates
    counts = np.array([np.count_nonzero(gap > 0.5 * gap.max(initial=0.0)) + 1 for gap in gaps])
    if counts.min() < 4 or counts.prod() >= 2 * len(places):
        return None
    cells = (places - places.min(axis=0)) / np.ptp(places, axis=0) * (counts - 1)
    nodes: Indices = np.rint(cells).astype(np.intp)
    is_single = np.unique(nodes @ (counts[1], 1)).size == len(nodes)
    return nodes if is_single and np.abs(cells - nodes).max() < OFF_NODE else None


def interpolate_points(points: Array, spacing: float, part: tuple[slice, slice]) -> Array:
    """Return heights at nodes, interpolated linearly; NaN outside the convex hull of the points.

    The first node is at x = y = 0, since coordinates such as northings would lose digits; ``part``
    are the indices of the wanted nodes along x and y.
    """
    from scipy.interpolate import LinearNDInterpolator  # imported here: the import takes 0.2 s
    from scipy.spatial import QhullError

    cells = points[:, :2] / spacing
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
    return np.concatenate([surface(i[k : k + step, None], j[None]) for k in range(0, i.size, step)])


def read_point_cloud(path: Path, ask: raster.Reading) -> Heights:
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
    every, ground, omitted, file = _read(path, near)
    middle = np.mean(every[:, :2], axis=0) if len(every) else (math.nan, math.nan)
    name, geographic = system_name(file.crs, TO_METRES, *middle)
    if geographic:
        remedy = reprojection(file.crs, TO_METRES, *middle)
        refuse("a point cloud in metres", f"degrees ({name})", remedy)
    points = every[ground] if ground.any() else every
    if len(points) < 3:
        remedy = "use another file" if near is None else "enlarge or move the window"
        refuse("at least 3 points", f"{len(points)}", remedy)
    raster.check_values(
        points[:, 2],
        lambda k: f"x = {points[k][0]:.9g}, y = {points[k][1]:.9g}",
        lambda marker, _: (
            f"remove these points: pdal translate in{path.suffix} out{path.suffix} range "
            f"--filters.range.limits='Z[{marker.low:.9g}:{marker.high:.9g}]'"
        ),
    )
    # density: number of points per area, excluding areas without points [1/m2]
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    extent = high - low
    if not extent.prod() > 0:
        refuse("points that span a surface", "that they lie on a line in x and y", "check the file")
    _check_upward(points[:: len(points) // MANY + 1])
    cells = np.maximum(np.rint(extent / math.sqrt(COARSE * extent.prod() / len(points))), 1)
    a, b = np.minimum((points[:, :2] - low) / extent * cells, cells - 1).astype(np.int64).T
    covered = np.unique(a * int(cells[1]) + b).size / cells.prod()
    density = float(len(points) / (covered * extent.prod()))
    cell = spacing or float(f"{math.sqrt(POINTS_PER_CELL / density):.2g}")
    if file.rounding > ROUGH * cell:
        refuse(
            f"coordinates rounded to less than a quarter of a cell, {cell:g} m",
            f"the scale {file.rounding:g} m in the header",
            f"set spacing = {file.rounding / ROUGH:g} or more, or write the original points with "
            "--writers.las.scale_x=0.001 --writers.las.scale_y=0.001 --writers.las.scale_z=0.001",
        )
    first, last = (np.rint(end / cell).astype(np.int64).tolist() for end in (low, high))
    x, y = (UniformAxis(a * cell, cell, b - a + 1) for a, b in zip(first, last, strict=True))
    i, j = parts(x, y, window)
    # heights at nodes, NaN in cells without points; means relative to the first node, since sums of
    # coordinates such as northings would lose digits
    first_node = np.array([x.first, y.first])
    columns = np.rint((points[:, :2] - first_node) / x.step).astype(np.int64).T
    cells, which = np.unique(columns[0] * y.size + columns[1], return_inverse=True)
    count = np.bincount(which)
    means = [np.bincount(which, column) / count for column in (points[:, :2] - first_node).T]
    means.append(np.bincount(which, points[:, 2]) / count)
    z = interpolate_points(np.column_stack(means), x.step, (i, j))
    numbers = np.add.outer(np.arange(i.start, i.stop) * y.size, np.arange(j.start, j.stop))
    is_occupied = np.isin(numbers, cells)
    z, occupied = np.where(is_occupied, z, np.nan), int(is_occupied.sum())
    chosen = f", chosen for {POINTS_PER_CELL:g} points in each (override with spacing)"
    used = f"{len(points)} classified as ground, of" if ground.any() else "all"
    words = (
        f"{used} {len(every)} points, {density:.3g} per m2; "
        f"cells of {cell:g} m{chosen * (not spacing)}; {occupied} of {z.size} cells have points"
    )
    if omitted:
        words += f"; {omitted} without coordinates left out"
    unit = LENGTHS[file.unit.lower()]
    heights = "in metres" if file.unit else "unit not stated: taken as metres"
    if unit != 1:
        heights = f"converted from {file.unit} ({unit:.9g} m)"
    nodes = x.nodes(i), y.nodes(j)
    facts = (
        ("ground map", f"{file.format} point cloud, {name or 'CRS not given'}"),
        ("ground points", words),
        ("ground map heights", heights),
        *scale_facts(file.crs, nodes[0].mean(), nodes[1].mean(), TO_METRES),
    )
    return Heights(*nodes, unit * z, facts, name)


def _check_upward(points: Array) -> None:
    """Raise DataError if points are a surface over x and z, as where y points up, not over x, y."""
    if not np.ptp(points, axis=0).all():
        return
    shares = []  # mean range of the heights in a cell over that of all, with z and with y upward
    for up, flat in ((2, [0, 1]), (1, [0, 2])):
        width = math.sqrt(POINTS_PER_CELL * np.ptp(points[:, flat], axis=0).prod() / len(points))
        where = np.unique(points[:, flat] // width, axis=0, return_inverse=True)[1].reshape(-1)
        heights = points[order := np.lexsort((points[:, up], where)), up]
        ends = np.flatnonzero(np.diff(where[order], prepend=-1, append=-1))
        shares.append(float(np.mean(heights[ends[1:] - 1] - heights[ends[:-1]]) / np.ptp(heights)))
    if shares[0] > THICKER * shares[1]:
        refuse(
            "points whose z is upward",
            "a surface over x and z, whose y is probably upward",
            "turn it, with y = -z and z = y: pdal translate in.ply out.ply transformation "
            "--filters.transformation.matrix='1 0 0 0  0 0 -1 0  0 1 0 0  0 0 0 1'",
        )


def _read(path: Path, near: Window | None) -> tuple[Array, Mask, int, Points]:
    """Return the points of a file in ``near`` (default all), except noise and withheld points.

    The results are points in the unit of the file (n, 3), whether each is classified as ground, the
    number of points without finite coordinates, and the file.
    """
    points, ground, omitted = [np.empty((0, 3))], [np.empty(0, bool)], 0
    ending = path.suffix.lower()
    try:
        with path.open("rb") as stream:
            file = CLOUDS.get(ending, _las_points)(stream)
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
            return cloud, np.concatenate(ground), omitted, file
    except (DataError, OSError):
        raise
    except Exception as error:  # the packages raise many kinds for damaged files
        name = ending[1:].upper() if ending in CLOUDS else "LAS or LAZ"
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
        """Yield points (n, 3) and their classes; withheld points count as noise."""
        for chunk in file.chunk_iterator(CHUNK):
            places = np.column_stack([np.asarray(each) for each in (chunk.x, chunk.y, chunk.z)])
            if not np.isfinite(places).all():
                raise ValueError("coordinates that are not finite")
            kind = np.asarray(chunk.classification)
            yield places, np.where(np.asarray(chunk.withheld, bool), NOISE[0], kind)

    rounding = float(max(file.header.scales))
    return Points(f"LAS {file.header.version}", chunks(), *_system(file.header), rounding)


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
        if axes and axes[0].direction == "down":
            refuse(
                "heights that are positive upward",
                "depths, positive downward",
                TO_METRIC_HEIGHTS.format(-1),
            )
    if name.lower() not in LENGTHS:
        refuse(
            "heights in a unit of length",
            f"the unit {name!r}",
            TO_METRIC_HEIGHTS.format("METRES_PER_UNIT"),
        )
    return name


class DegreesError(DataError):
    """A map in degrees is read without their conversion to metres."""


class Frame(NamedTuple):
    """Linear relation between ground and map file: file coordinates ``x0 + kx x, y0 + ky y``."""

    x0: float = 0.0  # origin of the ground in coordinates of the file [m] or [deg]
    kx: float = 1.0  # units of the file per metre of the ground [1] or [deg/m]
    y0: float = 0.0
    ky: float = 1.0


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Map(Bicubic):
    """A ground from a height map in metres, and facts about its file.

    Attributes
    ----------
    grid, center, mu, through
        Heights of the ground, and other attributes of `Bicubic`.
    frame : Frame
        Relation between the coordinates of the grid and of the file.
    crs : str
        Coordinate reference system of the file such as ``"EPSG:32633"``; empty if unknown.
    geographic : bool
        Whether the coordinates of the file are longitude and latitude in degrees.
    facts : tuple of (str, str)
        Facts about the file for summaries: pairs of name and description.
    gray : bool
        Whether the heights are gray levels of a picture, not metres.
    """

    frame: Frame = field(default_factory=Frame)
    crs: str = ""
    geographic: bool = False
    facts: Facts = ()
    gray: bool = False


@checked
def read_map(
    path: str | Path,
    *,
    window: Window | None = None,
    cell: float | None = None,
    registration: raster.Registration | None = None,
    spacing: float | None = None,
    geographic: Literal["local"] | Frame | None = None,
    fill: Literal["linear"] | None = None,
    vertical_scale: float | None = None,
    friction: Friction = None,
) -> Map:
    """Return the ground of a height map in a file.

    Parameters
    ----------
    path : str or Path
        ``.npz``: numpy arrays ``x`` of shape (n_x,), ``y`` of shape (n_y,) and ``z`` of shape
        (n_x, n_y), all in metres, NaN in holes. ``.xyz``, ``.txt``, ``.csv``: see `read_points`.
        ``.las``, ``.laz``, ``.ply``, ``.pcd``: see `read_point_cloud`. Files with other endings are
        rasters that GDAL reads from one file: see `read_raster`.
    window : tuple of 4 floats, optional
        Part to read, x_min, x_max, y_min, y_max in the coordinates of the file; by default the
        whole map. Only this part of a raster is kept in memory. [m] or [deg]
    cell : float, optional
        Width of a cell; required for rasters without coordinates, not allowed for other files. [m]
    registration : {"area", "point"}, optional
        Position of the values in their cells, required together with ``cell``: see `Reading`.
    spacing : float, optional
        Node spacing; required for scattered points, chosen by default for point clouds, not
        allowed for other files. [m]
    geographic : {"local"} or Frame, optional
        Conversion of degrees to metres, required for maps in degrees: ``"local"`` for that of
        `geographic_to_metric`, or the frame of another map for its coordinates.
    fill : {"linear"}, optional
        Method of filling holes that do not reach the border (see `fill_holes`); by default no hole
        is filled, and no wheel may touch one.
    vertical_scale : float, optional
        Metres per unit of the heights, if they are not metres: they are not converted, but markers
        of missing heights are recognized by their distance from the others in metres.
    friction : float, callable or Grid, optional
        Coefficient of friction, as ``mu`` of `slipfree.Bicubic`. [1]

    Returns
    -------
    Map
        A ground, as `slipfree.Bicubic`, with the frame that leads back to the file.

    Raises
    ------
    DataError
        If the file cannot be read, or does not contain a complete uniform grid, if it contains
        markers of missing heights such as -9999 that it does not declare, or if an argument is
        missing or not allowed for this file.
    """
    path = Path(path)
    ending = path.suffix.lower()
    reading = raster.Reading(window, cell, registration, spacing, vertical_scale)
    with raster.naming(path):
        for key in KEYS:
            value = getattr(reading, key)
            if value is not None and not takes_key(ending, key):
                kind = f"a {ending} file" if ending else "a file without an ending"
                remedy = f"remove it ({key!r} is for {', '.join(_endings(key))})"
                refuse(f"no {key!r} for {kind}", f"{value!r}", remedy)
        check_ending(path, "map", _expected_endings(), _endings())
        with regular_file(path, "a map"):
            heights = _reader(ending).read(path, reading)
        check_degrees(heights, local=geographic is not None)
        facts: Facts = heights.facts
        mask, missing = None, np.isnan(heights.z)
        if fill is not None:
            filled = fill_holes(heights)
            unit = "m" if geographic is None else "deg"
            size = " x ".join(f"{each:.6g}" for each in filled.largest)
            words = (
                f"{filled.nodes} nodes in {filled.holes} holes, the largest {size} {unit}, linearly"
            )
            facts += (("ground holes filled", words if filled.nodes else "none found"),)
            left = np.isnan(filled.z)
            mask, missing = missing & ~left if filled.nodes else None, left
            heights = heights._replace(z=filled.z)
        holes = missing if missing.any() else None
        if holes is not None:
            facts += (("ground holes", hole_words(int(holes.sum()), holes.size)),)
            heights = heights._replace(z=continue_over_holes(heights.z))
        if geographic is None:
            grid = Grid(heights.x, heights.y, heights.z, mask, holes)
            return Map(grid, mu=friction, crs=heights.crs, facts=facts, gray=heights.gray)
        frame = local_frame(heights.x, heights.y) if geographic == "local" else geographic
        x, y = (heights.x - frame.x0) / frame.kx, (heights.y - frame.y0) / frame.ky
        facts += (("ground degrees", _degrees_words(heights.y, frame)),)
        if (wrong := _stretch(heights.y, frame)) > MAX_STRETCH:
            raise DataError(
                "geographic: expected a map with errors of distances along x of at most "
                f"{100 * MAX_STRETCH:g} %, found {100 * wrong:.2g} % at its northern or southern "
                "border; set a window, or reproject it to metres: gdalwarp -t_srs "
                f"{metric_system(float(heights.x.mean()), float(heights.y.mean()))} in out.tif"
            )
        grid = Grid(x, y, heights.z, mask, holes)
        return Map(grid, mu=friction, frame=frame, crs=heights.crs, geographic=True, facts=facts)


def takes_key(ending: str, key: str) -> bool:
    """Return whether a key of [terrain] applies to files with an ending such as ``".tif"``."""
    return key not in KEYS or key in _reader(ending).keys


def readers() -> Iterator[MapReader]:
    """Yield the readers of map files: those in ``READERS`` of the modules of this package."""
    for each in iter_modules(maps.__path__):
        yield from getattr(import_module(f"{maps.__name__}.{each.name}"), "READERS", ())


def _reader(ending: str) -> MapReader:
    return next((each for each in readers() if ending in each.endings), RASTERS)


def _endings(key: str = "") -> tuple[str, ...]:
    """Return the endings of files that are read, or of those to which a key applies."""
    return tuple(e for reader in readers() if not key or key in reader.keys for e in reader.endings)


def _expected_endings() -> str:
    endings = ", ".join(_endings())
    return f"a file ending in {endings}, or another single-file raster that GDAL reads"


def check_degrees(heights: Heights, *, local: bool) -> None:
    """Raise DataError if degrees would be used as metres or metres as degrees."""
    reach = (
        f"x from {heights.x[0]:.9g} to {heights.x[-1]:.9g}, y from {heights.y[0]:.9g} to "
        f"{heights.y[-1]:.9g}"
    )
    fits = max(abs(heights.x[[0, -1]])) <= 360 and max(abs(heights.y[[0, -1]])) <= 90
    if local and not (heights.geographic or (heights.placed and fits and not heights.crs)):
        raise DataError(
            f"geographic: expected a map in degrees, found {heights.crs or 'a map in metres'} with "
            f"{reach}; remove geographic"
        )
    new = metric_system(float(heights.x.mean()), float(heights.y.mean()))
    systems = f"-t_srs {new}" if heights.crs else f"-s_srs EPSG:4326 -t_srs {new}"
    warp = f"gdalwarp {systems} in out.tif"
    remedy = f'; set geographic = "local", or reproject it to metres: {warp}'
    system = f" ({heights.crs})" if heights.crs else ""
    if heights.geographic and not local:
        raise DegreesError(f"expected a map in metres, found degrees{system}: {reach}{remedy}")
    if local or heights.crs or not (heights.placed and fits):
        return
    z = np.where(np.isinf(heights.z), np.nan, heights.z)
    rise = np.abs(np.diff(z, axis=1))
    rise = rise[rise > 0]  # neither holes nor lakes
    steep = float(np.median(rise)) / axes_of(heights.x, heights.y)[1].step if rise.size else 0.0
    if steep > MAX_MEDIAN_SLOPE and np.nanmax(np.abs(z)) < HIGHEST:  # else heights are not in m
        raise DegreesError(
            f"expected a map in metres, found one that seems to be in degrees: {reach}, with "
            f"slopes of {steep:.2g} along y (median){remedy}; if x and y are in metres, check the "
            "unit of the heights"
        )


def hole_words(count: int, size: int) -> str:
    """Return the description of nodes in holes."""
    return f"{count} of {size} nodes have no height: wheels must not touch them"


def _degrees_words(latitude: Array, frame: Frame) -> str:
    """Return the description of the conversion from degrees to metres and of its error."""
    middle, edge = np.arccos(frame.ky / frame.kx), _stretch(latitude, frame)
    # Radii of curvature of the ellipsoid along the meridian and across it.
    w = np.sqrt(1 - ECCENTRICITY_2 * np.sin(middle) ** 2)
    radii = SEMI_MAJOR * (1 - ECCENTRICITY_2) / w**3, SEMI_MAJOR / w
    shape = max(abs(radius / EARTH_RADIUS - 1) for radius in radii)
    return (
        f"converted to metres from longitude {frame.x0:.9g}, latitude {frame.y0:.9g} deg (the "
        f"origin): errors of distances are up to {100 * edge:.2g} % along x at the northern and "
        f"southern border, and up to {100 * shape:.2g} % everywhere, since the earth is treated as "
        "a sphere"
    )


def _stretch(latitude: Array, frame: Frame) -> float:
    """Return the largest relative error of distances along x; it occurs at a border [1]."""
    return float(max(abs(np.cos(np.deg2rad(latitude[[0, -1]])) * frame.kx / frame.ky - 1)))


def local_frame(longitude: Array, latitude: Array) -> Frame:
    """Return the frame of `geographic_to_metric`, with its origin at the first node [deg]."""
    middle = np.deg2rad(0.5 * (latitude[0] + latitude[-1]))
    degree = EARTH_RADIUS * np.deg2rad(1.0)
    x0, kx = float(longitude[0]), float(1 / (degree * np.cos(middle)))
    return Frame(x0, kx, float(latitude[0]), float(1 / degree))


def geographic_to_metric(longitude: Array, latitude: Array, z: Array) -> Grid:
    """Return a grid converted from degrees to metres; its south-western node is at (0, 0).

    The projection is equirectangular, ``x = R cos(middle) (longitude - longitude[0])`` with the
    mean radius R = 6371008.8 m: distances along x are exact at the middle latitude; elsewhere their
    relative error is ``tan(middle)`` times the angular distance from it, 0.2 % at 36 degrees north
    in 15 km.
    """
    frame = local_frame(longitude, latitude)
    return Grid((longitude - frame.x0) / frame.kx, (latitude - frame.y0) / frame.ky, z)


def jacksboro(scale: float = 1.0) -> Grid:
    """Return the elevation model of the Jacksboro fault, Tennessee, shipped with matplotlib.

    It has 403 by 344 nodes with spacings of 74.4 m and 92.7 m, and heights from 236 m to 1076 m;
    x points to the east, y to the north; the origin is the south-western node.

    Parameters
    ----------
    scale : float
        Factor of x, y and z, which does not change slopes. [1]

    Notes
    -----
    The file has rows from north to south with cells of 3 arc seconds; its ``ymin`` and ``ymax`` are
    exchanged. Degrees are converted to metres by `geographic_to_metric`.
    """
    from matplotlib.cbook import get_sample_data

    with np.load(get_sample_data("jacksboro_fault_dem.npz", asfileobj=False)) as file:
        rows = file["elevation"].astype(np.float64)
        d_x, d_y = float(file["dx"]), float(file["dy"])
        west, south = float(file["xmin"]), float(min(file["ymin"], file["ymax"]))
    n_y, n_x = rows.shape
    # the limits are outer borders of cells; nodes are at the centres of cells
    longitude = west + d_x * (np.arange(n_x) + 0.5)
    latitude = south + d_y * (np.arange(n_y) + 0.5)
    grid = geographic_to_metric(longitude, latitude, rows[::-1].T)
    return Grid(scale * grid.x, scale * grid.y, scale * grid.z)


def _read_npz(path: Path, ask: raster.Reading) -> Heights:
    """Return heights from a numpy archive of the arrays x, y and z."""
    try:
        with path.open("rb") as stream, warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of files written by Python 2
            file = np.load(stream, allow_pickle=False)
            if not isinstance(file, np.lib.npyio.NpzFile):
                refuse("an archive of arrays x, y, z", "a single array", TO_NPZ)
            largest = max((each.file_size for each in zipfile.ZipFile(path).infolist()), default=0)
            if largest > 8 * MAX_NODES + HEADER:
                remedy = "crop it, or convert it to GeoTIFF and set a window"
                size = f"an array of {largest / 1e9:.3g} GB"
                refuse(f"at most {MAX_NODES:g} nodes", size, remedy)
            missing = sorted({"x", "y", "z"} - set(file.files))
            if missing:
                refuse("the arrays x, y, z", f"{sorted(file.files)} without {missing}", TO_NPZ)
            arrays = {name: file[name] for name in ("x", "y", "z")}
    except DataError:
        raise
    except Exception as error:  # numpy raises errors of many kinds for a damaged archive
        raise DataError(
            f"expected a numpy archive, found a file that cannot be read "
            f"({str(error).split(': ')[0]}); {TO_NPZ}"
        ) from error
    for name, array in arrays.items():
        if array.dtype.kind not in "iuf":
            refuse(f"numbers in the array {name!r}", f"{array.dtype}", "convert it to float")
    x, y, z = (array.astype(np.float64) for array in arrays.values())
    try:
        grid = Grid(x, y, np.where(np.isnan(z), 0.0, z))  # checks axes and shapes
    except ModelError as error:
        raise DataError(str(error).removeprefix("Grid: ")) from error
    axes = axes_of(x, y)
    i, j = parts(*axes, ask.window)
    raster.check_values(
        z[i, j],
        lambda k: f"x = {x[i][k[0]]:.9g}, y = {y[j][k[1]]:.9g}",
        lambda _, value: f"set them to NaN: z[z == {value}] = numpy.nan",
        metres=ask.vertical_scale or 1.0,
        steps=(axes[0].step, axes[1].step),
    )
    facts = (("ground map", "numpy archive, CRS not given, heights at nodes"),)
    return Heights(grid.x[i], grid.y[j], np.ascontiguousarray(z[i, j]), facts)


class MapReader(NamedTuple):
    """Reader of map files of one format."""

    endings: tuple[str, ...]  # endings of the names of such files, in lower case, with the dot
    read: Callable[[Path, raster.Reading], Heights]  # ``read(path, reading)`` returns the heights
    keys: tuple[str, ...] = ()  # fields of `Reading`, besides ``window``, that the format uses


def _read_raster(path: Path, ask: raster.Reading) -> Heights:
    """Return the heights in a raster; the error for an unknown format names the known ones."""
    try:
        return raster.read_raster(path, ask)
    except DataError as error:
        if raster.UNKNOWN in str(error):
            check_contents(path, "map", _expected_endings())
        if path.suffix.lower() in raster.FORMATS or raster.UNKNOWN not in str(error):
            raise
        ending = repr(path.suffix) if path.suffix else "no ending"
        raise DataError(
            f"expected {_expected_endings()}, found {ending} with unknown contents; check that it "
            f"is a map, and convert it: gdal_translate {path.name} out.tif"
        ) from error


RASTERS = MapReader(tuple(raster.FORMATS), _read_raster, ("cell", "registration"))
READERS: tuple[MapReader, ...] = (
    MapReader((".npz",), _read_npz),
    RASTERS,
    MapReader((".xyz", ".txt", ".csv"), read_points, ("spacing",)),
    MapReader((".las", ".laz", ".ply", ".pcd"), read_point_cloud, ("spacing",)),
)
