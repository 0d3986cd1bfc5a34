"""Operations on height maps: crop, fill, scale, smooth, perturb.

The functions return new maps and do not change their arguments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy

from slipfree.core.arguments import checked
from slipfree.core.errors import DataError, ModelError
from slipfree.core.records import Array, Mask
from slipfree.core.schema import Length
from slipfree.terrain.base import Grid, axis_step

MAX_NODES = 5e7  # largest number of nodes of a ground; an array then takes 400 MB
MAX_COORDINATE = 1e12  # largest absolute coordinate of a map [m] or [deg]
MIN_RELATIVE_STEP = 1e-14  # smallest step of an axis, relative to its largest coordinate
WINDOW_TOLERANCE = 1e-6  # nodes outside a window by less count as inside, in cells
GAUSSIAN_CUTOFF = 4.0  # half-width of a truncated Gaussian, in standard deviations
WAVES = 1000  # number of plane waves of an elevation error
NEIGHBOURHOOD = np.ones((3, 3), dtype=bool)  # a node and its eight neighbours
Window = tuple[float, float, float, float]


class UniformAxis(NamedTuple):
    """Uniform axis along x or y."""

    first: float  # coordinate of the first node [m or deg]
    step: float
    size: int

    def nodes(self, part: slice) -> Array:
        """Return the coordinates of a slice of the nodes [m or deg]."""
        first, last = (self.first + self.step * k for k in (part.start, part.stop - 1))
        return np.linspace(first, last, part.stop - part.start)


class Heights(NamedTuple):
    """Heights of a map file."""

    x: Array  # increasing and uniform coordinates of the nodes [m or deg]
    y: Array
    z: Array  # (n_x, n_y), NaN in holes [m]
    facts: tuple[tuple[str, str], ...] = ()  # for summaries: pairs of name and description
    crs: str = ""  # reference system such as "EPSG:32633"; empty if unknown
    geographic: bool = False  # whether x and y are degrees according to the file
    placed: bool = True  # whether the file contains the coordinates of its nodes
    gray: bool = False  # whether the heights are gray levels of a picture, of unknown length


class Filled(NamedTuple):
    """Heights with filled holes, and counts of the filling."""

    z: Array  # NaN in holes at the border [m]
    nodes: int  # filled
    holes: int  # connected
    largest: tuple[float, float]  # extents of the hole with the most nodes; or zero [m or deg]


@dataclass(frozen=True, eq=False)
class Changed:
    """A ground with other heights, and the change of its heights."""

    grid: Grid
    change: Grid  # new minus old heights at the same nodes [m]

    @property
    def largest(self) -> float:
        """Largest absolute change of height [m]."""
        return float(np.abs(self.change.values).max())

    @property
    def rms(self) -> float:
        """Root mean square of the change of height [m]."""
        return math.sqrt(np.mean(self.change.values**2))


def parts(
    x: UniformAxis, y: UniformAxis, window: Window | None, most: float = MAX_NODES
) -> tuple[slice, slice]:
    """Return the slices of nodes along x and y that lie in a window, borders included.

    Without a window, all nodes are returned.

    DataError is raised if the window is empty, the map or the window has fewer than 4 nodes along
    an axis, more than ``most`` are selected, or rounding would lose the distances of the nodes.
    """
    if min(x.size, y.size) < 4:
        raise DataError(
            f"expected a map of at least 4 nodes along x and along y, found {x.size} by {y.size}; "
            "use a larger map"
        )
    for name, axis in (("x", x), ("y", y)):
        size = min(axis.size, 10**18)  # a header may contain any number
        farthest = max(abs(axis.first), abs(axis.first + axis.step * size))
        if not (farthest < MAX_COORDINATE and axis.step > MIN_RELATIVE_STEP * farthest):
            raise DataError(
                f"expected node coordinates up to {MAX_COORDINATE:g} with a step above "
                f"{MIN_RELATIVE_STEP:g} of the largest, found "
                f"{float(size):.3g} nodes from {name} = {axis.first:g} with step {axis.step:g}; "
                "correct the coordinates of the map"
            )
    selected = slice(0, x.size), slice(0, y.size)
    reach = f"the map extends from {_extent(x)} in x and from {_extent(y)} in y"
    if window is not None:
        if not (window[0] < window[1] and window[2] < window[3]):
            raise DataError(
                "window: expected [x_min, x_max, y_min, y_max] with x_min < x_max and "
                f"y_min < y_max, found {_window_text(window)}; correct it: {reach}"
            )
        selected = _part(x, *window[:2]), _part(y, *window[2:])
        sizes = [max(part.stop - part.start, 0) for part in selected]
        if min(sizes) < 4:
            raise DataError(
                f"window: expected a part of the map with at least 4 nodes along x and along y, "
                f"found {sizes[0]} by {sizes[1]} in {_window_text(window)}; enlarge or move it: "
                f"{reach}, its nodes are {x.step:.9g} and {y.step:.9g} apart"
            )
    nodes = math.prod(part.stop - part.start for part in selected)
    if nodes > most:
        raise DataError(
            f"expected at most {most:g} nodes, found {float(nodes):.3g} "
            f"({x.size} by {y.size} in the file); select a part by "
            f"window = [x_min, x_max, y_min, y_max]: {reach}"
        )
    return selected


def _part(axis: UniformAxis, low: float, high: float) -> slice:
    ends = [np.clip((end - axis.first) / axis.step, -1, axis.size) for end in (low, high)]
    first, last = math.ceil(ends[0] - WINDOW_TOLERANCE), math.floor(ends[1] + WINDOW_TOLERANCE)
    return slice(max(first, 0), min(last + 1, axis.size))


def _extent(axis: UniformAxis) -> str:
    return f"{axis.first:.9g} to {axis.first + axis.step * (axis.size - 1):.9g}"


def _window_text(window: Window) -> str:
    return f"[{', '.join(f'{each:.9g}' for each in window)}]"


def axes_of(x: Array, y: Array) -> tuple[UniformAxis, UniformAxis]:
    """Return the first node, step and size of two uniform axes."""
    first, second = (UniformAxis(float(each[0]), axis_step(each), each.size) for each in (x, y))
    return first, second


def cut(grid: Grid, window: Window) -> Grid:
    """Return the part of a ground inside a window, borders included.

    Raises
    ------
    DataError
        If the window is empty, or has fewer than four nodes of the ground along x or y.
    """
    i, j = parts(*axes_of(grid.x, grid.y), window)
    masks = [None if mask is None else mask[i, j] for mask in (grid.filled, grid.holes)]
    return Grid(grid.x[i], grid.y[j], np.ascontiguousarray(grid.z[i, j]), *masks)


def fill_holes(heights: Heights) -> Filled:
    """Return heights with holes filled by linear interpolation between the surrounding nodes.

    Holes that reach the border of the map remain: their heights could only be extrapolated.

    Notes
    -----
    The rim of a hole consists of the valid nodes among the eight neighbours of its nodes. A
    Delaunay triangulation of all rims is interpolated. A rim is a closed chain of edges of these
    triangles, so that no hole is filled from the rim of another. A plane is reproduced exactly.
    """
    from scipy.interpolate import LinearNDInterpolator  # imported here: the import takes 0.2 s

    numbers, _ = scipy.ndimage.label(np.isnan(heights.z), NEIGHBOURHOOD)
    borders = numbers[0], numbers[-1], numbers[:, 0], numbers[:, -1]
    numbers[np.isin(numbers, np.concatenate(borders))] = 0
    holes, count = numbers > 0, np.unique(numbers[numbers > 0]).size
    if not count:
        return Filled(heights.z, 0, 0, (0.0, 0.0))
    rim = scipy.ndimage.binary_dilation(holes, NEIGHBOURHOOD) & ~holes
    z = heights.z.copy()
    surface = LinearNDInterpolator(np.argwhere(rim).astype(np.float64), z[rim])
    z[holes] = surface(np.argwhere(holes).astype(np.float64))
    most = int(np.argmax(np.bincount(numbers.reshape(-1))[1:]))
    extent = scipy.ndimage.find_objects(numbers)[most]
    largest = [
        (part.stop - part.start) * axis.step
        for part, axis in zip(extent, axes_of(heights.x, heights.y), strict=True)
    ]
    return Filled(z, int(np.count_nonzero(holes)), int(count), (largest[0], largest[1]))


def hole_distance(grid: Grid) -> Array:
    """Return the distance of every node from cells with a missing height, negative inside [m].

    DataError is raised if no cell has heights at its four corners.
    """
    # the point of a set of cells that is nearest to a node is itself a node
    missing = np.zeros(grid.z.shape, bool) if grid.holes is None else grid.holes
    cells = any_of_four(missing)
    if cells.all():
        raise DataError(
            "expected a cell of the map with heights at its four corners, found none; use another "
            "map or a finer grid"
        )
    closed, still_open = any_of_four(np.pad(cells, 1)), any_of_four(np.pad(~cells, 1))
    distance = scipy.ndimage.distance_transform_edt
    found: Array = distance(~closed, grid.spacing) - distance(~still_open, grid.spacing)
    return found


def any_of_four(mask: Mask) -> Mask:
    """Return whether any of four neighbouring entries is marked, shape (n_x - 1, n_y - 1)."""
    cells: Mask = mask[:-1, :-1] | mask[1:, :-1] | mask[:-1, 1:] | mask[1:, 1:]
    return cells


def continue_over_holes(z: Array) -> Array:
    """Return heights continued smoothly into holes, as placeholders for the spline.

    Heights in holes (NaN) become those of the point reflection about the nearest node with a
    height, or the height of that node if the reflected node has none. The reflection preserves
    slopes, so that the spline beside a hole is nearly that of the whole map; the influence of a
    node on the spline falls to a quarter per cell. DataError is raised if no node has a height.
    """
    holes = np.isnan(z)
    if holes.all():
        raise DataError("expected heights, found none at any node; use another map or window")
    nearest = scipy.ndimage.distance_transform_edt(
        holes, return_distances=False, return_indices=True
    )[:, holes]
    mirrored = 2 * nearest - np.argwhere(holes).T
    inside = ((mirrored >= 0) & (mirrored < np.array(z.shape)[:, None])).all(axis=0)
    edge = z[tuple(nearest)]
    beyond = np.where(inside, z[tuple(np.where(inside, mirrored, 0))], np.nan)
    continued = z.copy()
    continued[holes] = np.where(np.isnan(beyond), edge, 2 * edge - beyond)
    return continued


def smoothed(grid: Grid, deviation: float) -> Changed:
    """Return a ground averaged with Gaussian weights, and the size of the change.

    Outside the grid the ground continues by point reflection about the border node, which preserves
    slopes.

    Parameters
    ----------
    grid : Grid
        The ground.
    deviation : float
        Standard deviation of the weights; the height of waves of length w is multiplied by
        exp(-2 (pi deviation / w)**2). [m]

    Raises
    ------
    ModelError
        If the deviation is not positive, or exceeds an eighth of the ground's extent.
    """
    extent = min(float(np.ptp(grid.x)), float(np.ptp(grid.y)))
    if not 0 < deviation <= extent / 8:
        raise ModelError(
            f"smooth: expected a standard deviation above 0 and at most {extent / 8:.4g} m, an "
            f"eighth of the ground, found {deviation:g} m; choose a value in this range"
        )
    z = averaged(grid.z, grid.spacing, deviation)
    return Changed(replace(grid, z=z), Grid(grid.x, grid.y, z - grid.z, holes=grid.holes))


def averaged(z: Array, steps: tuple[float, float], deviation: float) -> Array:
    """Return heights averaged with Gaussian weights of a standard deviation [m]; see `smoothed`."""
    sigma = [deviation / step for step in steps]
    pad = [math.ceil(GAUSSIAN_CUTOFF * each) + 1 for each in sigma]
    wide = np.pad(z, [(n, n) for n in pad], mode="reflect", reflect_type="odd")
    mean = scipy.ndimage.gaussian_filter(wide, sigma, truncate=GAUSSIAN_CUTOFF)
    return np.ascontiguousarray(mean[pad[0] : -pad[0], pad[1] : -pad[1]])


@checked
def disturbed(grid: Grid, rms: Length, correlation: Length, seed: int) -> Grid:
    """Return a ground with a random elevation error added.

    Parameters
    ----------
    grid : Grid
        The ground.
    rms : float
        Standard deviation of the error over all seeds. The standard deviation on a single map
        approaches it if the map is many correlation lengths long. [m]
    correlation : float
        Correlation length: the correlation at a distance d is exp(-(d / correlation)**2). [m]
    seed : int
        Seed of the random numbers.

    Raises
    ------
    ModelError
        If ``rms`` or ``correlation`` is not positive.

    Notes
    -----
    The error is a sum of plane waves with random phases and normally distributed wave vectors,
    which have the spectrum of that correlation (Shinozuka and Deodatis, "Simulation of stochastic
    processes by spectral representation", Applied Mechanics Reviews 44, 1991). It is a function of
    position only, independent of the window and of the spacing of the grid.
    """
    rng = np.random.default_rng(seed)
    # variance 2 / correlation**2 of each component: E cos(k d) = exp(-(d / correlation)**2)
    k_x, k_y = rng.standard_normal((2, WAVES)) * (math.sqrt(2) / correlation)
    wave = np.exp(1j * rng.uniform(0, 2 * np.pi, WAVES))
    along_x = np.exp(1j * np.outer(grid.x, k_x)) * wave
    along_y = np.exp(1j * np.outer(k_y, grid.y))
    # only the real part of the product is needed: two real products instead of four
    error = along_x.real @ along_y.real - along_x.imag @ along_y.imag
    return replace(grid, z=grid.z + rms * math.sqrt(2 / WAVES) * error)
