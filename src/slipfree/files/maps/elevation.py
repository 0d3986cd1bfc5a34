"""Elevation models: maps from files, and conversion of degrees to metres."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.errors import DataError, ModelError
from slipfree.core.records import Array
from slipfree.files.foreign_formats import check_contents, check_ending
from slipfree.files.maps.missing_values import check_values
from slipfree.files.maps.points import read_point_cloud, read_points
from slipfree.files.maps.raster import (
    FORMATS,
    UNKNOWN,
    Reading,
    Registration,
    naming,
    read_raster,
)
from slipfree.files.maps.reference_systems import metric_system, refuse
from slipfree.system.regular_files import regular_file
from slipfree.terrain.base import Friction, Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.grid_ops import (
    MAX_NODES,
    Heights,
    Window,
    axes_of,
    continue_over_holes,
    fill_holes,
    parts,
)

EARTH_RADIUS = 6371008.8  # mean radius (2 a + b) / 3 of the WGS84 ellipsoid [m]
HEADER = 1e4  # largest header of a numpy array [bytes]
MAX_STRETCH = 0.01  # largest relative error of distances along x of a map in degrees
# semi-major axis [m] and squared eccentricity [1] of the WGS84 ellipsoid
SEMI_MAJOR, ECCENTRICITY_2 = 6378137.0, 6.69437999014e-3
TO_NPZ = "write it with np.savez(path, x=x, y=y, z=z)"
MAX_MEDIAN_SLOPE = 50.0  # a steeper map is taken to be in degrees [1]
Facts = tuple[tuple[str, str], ...]


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
    registration: Registration | None = None,
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
    reading = Reading(window, cell, registration, spacing, vertical_scale)
    with naming(path):
        for key in KEYS:
            value = getattr(reading, key)
            if value is not None and not takes_key(ending, key):
                kind = f"a {ending} file" if ending else "a file without an ending"
                remedy = f"remove it ({key!r} is for {', '.join(_endings(key))})"
                refuse(f"no {key!r} for {kind}", f"{value!r}", remedy)
        if geographic not in (None, "local") and not isinstance(geographic, Frame):
            remedy = "give 'local' for a map in degrees, None for one in metres"
            refuse("geographic of 'local', a Frame or None", f"{geographic!r}", remedy)
        check_ending(path, "map", _expected_endings(), _endings())
        with regular_file(path, "a map"):
            heights = _reader(ending).read(path, reading)
        check_degrees(heights, local=geographic is not None)
        return _mapped(heights, geographic, fill, friction)


def takes_key(ending: str, key: str) -> bool:
    """Return whether a key of [terrain] applies to files with an ending such as ``".tif"``."""
    return key not in KEYS or key in _reader(ending).keys


def _reader(ending: str) -> MapReader:
    return next((each for each in READERS if ending in each.endings), RASTERS)


def _endings(key: str = "") -> tuple[str, ...]:
    """Return the endings of files that are read, or of those to which a key applies."""
    return tuple(e for reader in READERS if not key or key in reader.keys for e in reader.endings)


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
    remedy = (
        f'; set geographic = "local", or reproject it to metres: gdalwarp -t_srs {new} in out.tif'
    )
    system = f" ({heights.crs})" if heights.crs else ""
    if heights.geographic and not local:
        raise DegreesError(f"expected a map in metres, found degrees{system}: {reach}{remedy}")
    if local or heights.crs or not (heights.placed and fits):
        return
    rise = np.abs(np.diff(np.where(np.isinf(heights.z), np.nan, heights.z), axis=1))
    rise = rise[rise > 0]  # neither holes nor lakes
    steep = float(np.median(rise)) / axes_of(heights.x, heights.y)[1].step if rise.size else 0.0
    if steep > MAX_MEDIAN_SLOPE:
        raise DegreesError(
            f"expected a map in metres, found one that seems to be in degrees: {reach}, with "
            f"slopes of {steep:.2g} along y (median){remedy}; if x and y are in metres, check the "
            "unit of the heights"
        )


def _mapped(
    heights: Heights,
    geographic: Literal["local"] | Frame | None,
    fill: Literal["linear"] | None,
    friction: Friction,
) -> Map:
    """Return the map of heights that were read: holes filled, degrees converted to metres."""
    facts: Facts = heights.facts
    mask, missing = None, np.isnan(heights.z)
    if fill is not None:
        filled = fill_holes(heights)
        unit = "m" if geographic is None else "deg"
        size = " x ".join(f"{each:.6g}" for each in filled.largest)
        words = f"{filled.nodes} nodes in {filled.holes} holes, the largest {size} {unit}, linearly"
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


def _read_npz(path: Path, ask: Reading) -> Heights:
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
            expected = f"numbers in the array {name!r}"
            refuse(expected, f"{array.dtype}", "convert it to float")
    x, y, z = (array.astype(np.float64) for array in arrays.values())
    try:
        grid = Grid(x, y, np.where(np.isnan(z), 0.0, z))  # checks axes and shapes
    except ModelError as error:
        raise DataError(str(error).removeprefix("Grid: ")) from error
    axes = axes_of(x, y)
    i, j = parts(*axes, ask.window)
    check_values(
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
    read: Callable[[Path, Reading], Heights]  # ``read(path, reading)`` returns the heights
    keys: tuple[str, ...] = ()  # fields of `Reading`, besides ``window``, that the format uses


def _read_raster(path: Path, ask: Reading) -> Heights:
    """Return the heights in a raster; the error for an unknown format names the known ones."""
    try:
        return read_raster(path, ask)
    except DataError as error:
        if UNKNOWN in str(error):
            check_contents(path, "map", _expected_endings())
        if path.suffix.lower() in FORMATS or UNKNOWN not in str(error):
            raise
        ending = repr(path.suffix) if path.suffix else "no ending"
        raise DataError(
            f"expected {_expected_endings()}, found {ending} with unknown contents; convert it: "
            "gdal_translate in out.tif, or check that it is a map"
        ) from error


RASTERS = MapReader(tuple(FORMATS), _read_raster, ("cell", "registration"))
READERS: tuple[MapReader, ...] = (
    MapReader((".npz",), _read_npz),
    RASTERS,
    MapReader((".xyz", ".txt", ".csv"), read_points, ("spacing",)),
    MapReader((".las", ".laz", ".ply", ".pcd"), read_point_cloud, ("spacing",)),
)
KEYS = ("cell", "registration", "spacing")  # arguments of some formats only
