"""Maps from scattered points: text files with x, y and z of a point in each line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from slipfree.errors import DataError
from slipfree.files.maps.missing_values import check_values
from slipfree.files.maps.raster import Reading
from slipfree.files.table_layout import ALIASES
from slipfree.files.tables import read_columns, read_names
from slipfree.records import Array
from slipfree.terrain.grid_ops import MAX_COORDINATE, WINDOW_TOLERANCE, Axis, Heights, parts

NAMES = ("x", "y", "z")
BLOCK = 2**20  # number of nodes interpolated at once; limits the memory


def read_points(path: Path, ask: Reading) -> Heights:
    """Return the height map interpolated from scattered points.

    Heights are interpolated linearly on a Delaunay triangulation; nodes outside the convex hull of
    the points are holes. The first node is at the smallest x and y of all points.

    Parameters
    ----------
    path : Path
        Text file with x, y and z in each line, see `slipfree.files.tables.read_columns`. Without
        the names x, y and z, they are the first three columns; others, such as colours, are
        ignored. [m]
    ask : Reading
        Window, and the distance between nodes, for None of which the error message suggests a
        value.

    Raises
    ------
    DataError
        If the file is not such a table, if a coordinate exceeds 1e12 m, if ``spacing`` is None, too
        large or too small, if the window contains too few nodes, or if the points lie on a line or
        have fewer than three different positions.
    """
    names = {name.lower() for name in read_names(path, "points")}
    geographic = any("longitude" in same and names & same for same in ALIASES)
    unit = "deg" if geographic else "m"
    columns: Sequence[str] | dict[str, str] = NAMES
    if geographic:
        columns = {"x": "longitude", "y": "latitude", "z": "z"}
    values, notes = read_columns(path, columns, "points", others=True)
    table = np.column_stack([values[name] for name in NAMES])
    if (farthest := float(np.abs(table).max(initial=0.0))) > MAX_COORDINATE:
        raise DataError(
            f"expected coordinates with absolute values of at most {MAX_COORDINATE:g} m, found "
            f"{farthest:g}; correct the file"
        )
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
        raise DataError(
            f"expected spacing, the distance between grid nodes in {unit}, found none; "
            f"the median distance of {len(points)} points from their nearest "
            f"neighbours is {distance:.3g} {unit}: set spacing = {distance:.2g}"
        )
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    counts = np.floor((high - low) / spacing + WINDOW_TOLERANCE).astype(int) + 1
    x, y = (Axis(float(a), spacing, int(n)) for a, n in zip(low, counts, strict=True))
    if counts.min() < 4:
        raise DataError(
            f"expected points that span at least 4 by 4 nodes, found {counts[0]} by "
            f"{counts[1]} at spacing = {spacing:g} {unit}; set a smaller spacing, such as "
            f"{distance:.2g}"
        )
    i, j = parts(x, y, ask.window)
    z = interpolate_points(points, low, spacing, (i, j))
    words = (
        f"{len(points)}, a median of {distance:.3g} {unit} apart, for {z.size} nodes {spacing:g} "
        f"{unit} apart"
    )
    if repeated:
        words += (
            f"; {repeated} at repeated positions averaged, with height differences of at most "
            f"{apart:.3g} m"
        )
    words = "; ".join([words, *notes])
    return Heights(
        x.nodes(i),
        y.nodes(j),
        z,
        (("ground map", "scattered points"), ("ground points", words)),
        geographic=geographic,
    )


def _distinct(points: Array) -> tuple[Array, int, float]:
    """Return points with distinct x and y, from points of shape (n, 3) [m].

    Returns
    -------
    points : ndarray, shape (m, 3)
        Distinct points; heights of points with equal x and y are averaged.
    repeated : int
        Number of points removed by averaging.
    apart : float
        Largest difference of heights at the same x and y. [m]
    """
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
        raise DataError(
            f"expected at least 3 points with different x, y, found {len(places)}; add points"
        )
    return float(np.median(cKDTree(places).query(places, k=2)[0][:, 1]))


def interpolate_points(
    points: Array, low: Array, spacing: float, part: tuple[slice, slice]
) -> Array:
    """Return heights at nodes, interpolated linearly; NaN outside the convex hull of the points.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Distinct points. [m]
    low : ndarray, shape (2,)
        Position of the first node. [m]
    spacing : float
        Distance between nodes. [m]
    part : tuple of 2 slices
        Indices of the nodes along x and y.

    Returns
    -------
    ndarray, shape (n_x, n_y)
        Heights. [m]

    Raises
    ------
    DataError
        If the points lie on a line in x and y.
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
