"""Elevation models: height grids from files, and from degrees of longitude and latitude."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slipfree.errors import DataError
from slipfree.named import Array
from slipfree.terrain.base import Grid

EARTH_RADIUS = 6371008.8  # mean radius (2 a + b) / 3 of the WGS84 ellipsoid [m]
UNREADABLE = (  # what reading a damaged numpy archive raises
    ValueError, EOFError, OSError, RuntimeError, NotImplementedError, MemoryError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def read_grid(path: str | Path) -> Grid:
    """Return the grid of heights in a file.

    Parameters
    ----------
    path : str or Path
        ``.npz``: numpy arrays ``x`` of shape (n_x,), ``y`` of shape (n_y,) and ``z`` of shape
        (n_x, n_y), all in metres. ``.asc``: an ESRI ASCII grid in a metric projection, one line a
        row, the northernmost first; with ``xllcorner`` and ``yllcorner`` the first node lies half
        a cell inside the corner, with ``xllcenter`` and ``yllcenter`` on the given point.

    Raises
    ------
    DataError
        If the file cannot be read, or does not hold a complete uniform grid.
    """
    path = Path(path)
    readers = {".npz": _read_npz, ".asc": _read_asc}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise DataError(
            f"{path}: expected a file ending in .npz or .asc, found {path.suffix or 'no ending'!r}"
            "; convert it, for example: gdal_translate -of AAIGrid in.tif out.asc"
        )
    if not path.is_file():
        raise DataError(f"{path}: expected a file, found none; check the path")
    x, y, z = reader(path)
    try:
        return Grid(x, y, z)
    except DataError as error:
        raise DataError(f"{path}: {error}") from error


def geographic_to_metric(longitude: Array, latitude: Array, z: Array) -> Grid:
    """Return a grid in metres, its south-western node at (0, 0), from one in degrees.

    Parameters
    ----------
    longitude : ndarray, shape (n_x,)
        Ascending to the east. [deg]
    latitude : ndarray, shape (n_y,)
        Ascending to the north. [deg]
    z : ndarray, shape (n_x, n_y)
        Heights at ``(longitude[i], latitude[j])``. [m]

    Notes
    -----
    Equirectangular: ``x = R cos(middle) (longitude - longitude[0])`` and
    ``y = R (latitude - latitude[0])`` in radians, with the mean radius R = 6371008.8 m and the
    ``middle`` of the first and the last latitude. Distances along x are true there and wrong by
    ``tan(middle)`` times the distance from it in radians elsewhere: 0.2 % at 36 degrees north,
    15 km off.
    """
    middle = np.deg2rad(0.5 * (latitude[0] + latitude[-1]))
    x = EARTH_RADIUS * np.cos(middle) * np.deg2rad(longitude - longitude[0])
    return Grid(x, EARTH_RADIUS * np.deg2rad(latitude - latitude[0]), z)


def jacksboro(scale: float = 1.0) -> Grid:
    """Return the elevation model of the Jacksboro fault, Tennessee, that matplotlib ships.

    403 by 344 nodes of 74.4 m by 92.7 m, heights from 236 m to 1076 m, x to the east, y to the
    north, origin at the south-western node.

    Parameters
    ----------
    scale : float
        Multiplies all three directions: slopes stay, lengths change. [1]

    Notes
    -----
    The file holds rows from north to south of cells 3 seconds of arc wide; its ``ymin`` and
    ``ymax`` are exchanged. Degrees become metres by `geographic_to_metric`.
    """
    from matplotlib.cbook import get_sample_data

    with np.load(get_sample_data("jacksboro_fault_dem.npz", asfileobj=False)) as file:
        rows = file["elevation"].astype(np.float64)
        d_x, d_y = float(file["dx"]), float(file["dy"])
        west, south = float(file["xmin"]), float(min(file["ymin"], file["ymax"]))
    n_y, n_x = rows.shape
    # The limits are outer borders of cells: the nodes are the middles.
    longitude = west + d_x * (np.arange(n_x) + 0.5)
    latitude = south + d_y * (np.arange(n_y) + 0.5)
    grid = geographic_to_metric(longitude, latitude, rows[::-1].T)
    return Grid(scale * grid.x, scale * grid.y, scale * grid.z)


def _read_npz(path: Path) -> tuple[Array, Array, Array]:
    """Return x, y, z of a numpy archive."""
    try:
        with path.open("rb") as stream:
            file = np.load(stream, allow_pickle=False)
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise DataError(f"{path}: expected an archive, found one array; use np.savez")
            missing = sorted({"x", "y", "z"} - set(file.files))
            if missing:
                raise DataError(
                    f"{path}: expected the arrays x, y, z, found {sorted(file.files)} without "
                    f"{missing}; write it with np.savez(path, x=x, y=y, z=z)"
                )
            arrays = {name: file[name] for name in ("x", "y", "z")}
    except UNREADABLE as error:
        if isinstance(error, DataError):
            raise
        raise DataError(
            f"{path}: expected a numpy archive, found none that can be read ({error}); write it "
            "with np.savez(path, x=x, y=y, z=z)"
        ) from error
    for name, array in arrays.items():
        if array.dtype.kind not in "iuf":
            raise DataError(f"{path}: expected numbers in {name}, found {array.dtype}")
    x, y, z = (array.astype(np.float64) for array in arrays.values())
    return x, y, z


class _Entry(NamedTuple):
    """A value of a header, and the line it stands on."""

    line: int
    value: float


class _Header(NamedTuple):
    """What the first lines of an ESRI ASCII grid say; x, y are of the south-western node [m]."""

    columns: int
    rows: int
    x: float
    y: float
    cell: float
    nodata: float | None


def _read_asc(path: Path) -> tuple[Array, Array, Array]:
    """Return x, y, z of an ESRI ASCII grid."""
    # Bytes that are no text become signs that are no numbers, and are reported as such.
    with path.open(encoding="ascii", errors="replace") as file:
        lines = [(n, line) for n, line in enumerate(file, start=1) if line.strip()]
    start = next((k for k, (_, line) in enumerate(lines) if _is_number(line.split()[0])), None)
    entries = dict(_entries(path, lines[:start]))
    header = _header(path, entries)
    body = [] if start is None else lines[start:]
    if len(body) != header.rows:
        last = lines[-1][0]
        raise DataError(
            f"{path}: line {last}: expected {header.rows} rows as nrows says, found {len(body)} "
            "when the file ended; is it cut off, or not one row a line?"
        )
    heights = np.stack([_row(path, n, line, header.columns) for n, line in body])
    if header.nodata is not None:
        _check_nodata(path, heights, header.nodata, [n for n, _ in body])
    x = header.x + header.cell * np.arange(header.columns, dtype=np.float64)
    y = header.y + header.cell * np.arange(header.rows, dtype=np.float64)
    return x, y, np.ascontiguousarray(heights[::-1].T)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _entries(path: Path, lines: list[tuple[int, str]]) -> Iterator[tuple[str, _Entry]]:
    """Yield the keys of a header, in lower case, and what stands there."""
    for n, line in lines:
        words = line.split()
        if len(words) != 2 or not _is_number(words[1]):
            raise DataError(
                f"{path}: line {n}: expected a key and a number such as 'ncols 100', "
                f"found {line.strip()[:60]!r}; is this an ESRI ASCII grid?"
            )
        yield words[0].lower(), _Entry(n, float(words[1]))


def _header(path: Path, entries: dict[str, _Entry]) -> _Header:
    """Return the header with the lower left corner moved to a node."""

    def entry(*keys: str) -> _Entry:
        for key in keys:
            if key in entries:
                return entries[key]
        raise DataError(
            f"{path}: line 1: expected {' or '.join(keys)} in the header, found "
            f"{list(entries) or 'no header'}; an ESRI ASCII grid begins with ncols, nrows, "
            "xllcorner, yllcorner, cellsize"
        )

    checked = {key: entry(key) for key in ("ncols", "nrows", "cellsize")}
    for key, (line, value) in checked.items():
        whole = key != "cellsize"
        if not 0 < value < np.inf or (whole and value != int(value)):
            raise DataError(
                f"{path}: line {line}: expected {key} to be a positive "
                f"{'whole number' if whole else 'number'}, found {value:g}; correct the header"
            )
    columns, rows, cell = (entry.value for entry in checked.values())
    x, y = entry("xllcenter", "xllcorner").value, entry("yllcenter", "yllcorner").value
    x += 0.5 * cell * ("xllcenter" not in entries)
    y += 0.5 * cell * ("yllcenter" not in entries)
    nodata = entries["nodata_value"].value if "nodata_value" in entries else None
    return _Header(int(columns), int(rows), x, y, cell, nodata)


def _row(path: Path, n: int, line: str, columns: int) -> Array:
    """Return the heights of one line."""
    words = line.split()
    if len(words) != columns:
        raise DataError(
            f"{path}: line {n}: expected {columns} heights as ncols says, found {len(words)}; "
            "is the file cut off, or not one row a line?"
        )
    try:
        return np.array(words, dtype=np.float64)
    except ValueError:
        word = next(word for word in words if not _is_number(word))
        raise DataError(f"{path}: line {n}: expected numbers, found {word!r}; correct it") from None


def _check_nodata(path: Path, heights: Array, nodata: float, lines: list[int]) -> None:
    """Refuse a grid with gaps."""
    gaps = heights == nodata
    if gaps.any():
        row, column = np.argwhere(gaps)[0]
        raise DataError(
            f"{path}: line {lines[row]}: expected a height in every cell, found "
            f"{np.count_nonzero(gaps)} with NODATA_value {nodata:g}, the first in row {row}, "
            f"column {column}; fill them, for example: gdal_fillnodata.py in.asc out.tif"
        )
