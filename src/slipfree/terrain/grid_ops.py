"""What may be done to a map before it is a ground: cut, filled, scaled, smoothed, disturbed.

Every function is pure: it returns a new map and, where heights change, by how much.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from slipfree.errors import DataError, ModelError
from slipfree.records import Array, Mask
from slipfree.terrain.base import Grid

MOST_NODES = 5e7  # of a ground: 400 MB an array
FARTHEST = 1e12  # place that a map may have [m] or [deg]
RESOLVED = 1e-14  # least step of an axis, as a part of the farthest place
NEAR = 1e-6  # part of a cell by which a node may miss a window
TAIL = 4.0  # standard deviations after which a Gaussian is cut off
WAVES = 1000  # plane waves that make up an elevation error
AROUND = np.ones((3, 3), dtype=bool)  # a node and its eight neighbours
Window = tuple[float, float, float, float]


class Axis(NamedTuple):
    """Even nodes along x or y.

    Attributes
    ----------
    first, step : float
        Place of the first node, and what lies between two. [m] or [deg]
    size : int
        How many there are.
    """

    first: float
    step: float
    size: int

    def nodes(self, part: slice) -> Array:
        """Return the places of some of the nodes. [m] or [deg]."""
        first, last = (self.first + self.step * k for k in (part.start, part.stop - 1))
        return np.linspace(first, last, part.stop - part.start)


class Heights(NamedTuple):
    """A map as a file holds it.

    Attributes
    ----------
    x, y : ndarray, shape (n_x,) and (n_y,)
        Ascending, uniform axes. [m] or [deg]
    z : ndarray, shape (n_x, n_y)
        Heights at ``(x[i], y[j])``, NaN in holes. [m]
    told : tuple of (str, str)
        Name and value of what to tell about the file.
    crs : str
        Its coordinate reference system such as ``"EPSG:32633"``; empty if unknown.
    geographic : bool
        Whether the file says that x and y are degrees.
    placed : bool
        Whether the file itself says where its nodes lie.
    """

    x: Array
    y: Array
    z: Array
    told: tuple[tuple[str, str], ...] = ()
    crs: str = ""
    geographic: bool = False
    placed: bool = True


class Filled(NamedTuple):
    """Heights without holes, and what was filled.

    Attributes
    ----------
    z : ndarray, shape (n_x, n_y)
        Heights. [m]
    nodes, holes : int
        How many nodes had no height, and in how many connected holes they lie.
    largest : tuple of 2 floats
        Extents along x and y of the hole of most nodes. [m] or [deg]
    """

    z: Array
    nodes: int
    holes: int
    largest: tuple[float, float]


class Smoothed(NamedTuple):
    """A smoothed ground, and what that changed.

    Attributes
    ----------
    grid : Grid
        The new ground. [m]
    rms, largest : float
        Root mean square and largest size of the change of height. [m]
    """

    grid: Grid
    rms: float
    largest: float


def parts(x: Axis, y: Axis, window: Window | None) -> tuple[slice, slice]:
    """Return which nodes along x and along y lie in a window, borders among them; all without.

    Raises
    ------
    DataError
        If the window is empty, holds too few nodes, or if there are too many to be kept.
    """
    _check_axes(x, y)
    found = slice(0, x.size), slice(0, y.size)
    reach = f"the map reaches from {_reach(x)} in x and from {_reach(y)} in y"
    if window is not None:
        if not (window[0] < window[1] and window[2] < window[3]):
            raise DataError(
                "window: expected [x_min, x_max, y_min, y_max] with x_min < x_max and "
                f"y_min < y_max, found {_spelled(window)}; {reach}"
            )
        found = _part(x, *window[:2]), _part(y, *window[2:])
        sizes = [max(part.stop - part.start, 0) for part in found]
        if min(sizes) < 4:
            raise DataError(
                f"window: expected a part of the map with at least 4 nodes along x and along y, "
                f"found {sizes[0]} by {sizes[1]} in {_spelled(window)}; {reach}, "
                f"a node every {x.step:.9g} and {y.step:.9g}"
            )
    nodes = math.prod(part.stop - part.start for part in found)
    if nodes > MOST_NODES:
        raise DataError(
            f"expected at most {MOST_NODES:g} nodes, found {float(nodes):.3g} "
            f"({x.size} by {y.size} in the file); name the part that is needed as "
            f"window = [x_min, x_max, y_min, y_max]: {reach}"
        )
    return found


def _check_axes(x: Axis, y: Axis) -> None:
    """Refuse maps of too few nodes, and those beyond the reach of numbers."""
    if min(x.size, y.size) < 4:
        raise DataError(
            f"expected a map of at least 4 nodes along x and along y, found {x.size} by {y.size}"
        )
    for name, axis in (("x", x), ("y", y)):
        size = min(axis.size, 10**18)  # a header may claim any
        farthest = max(abs(axis.first), abs(axis.first + axis.step * size))
        if not (farthest < FARTHEST and axis.step > RESOLVED * farthest):
            raise DataError(
                f"expected places up to {FARTHEST:g} that numbers can tell apart, found "
                f"{float(size):.3g} nodes from {name} = {axis.first:g}, {axis.step:g} apart"
            )


def _part(axis: Axis, low: float, high: float) -> slice:
    ends = [np.clip((end - axis.first) / axis.step, -1, axis.size) for end in (low, high)]
    first, last = math.ceil(ends[0] - NEAR), math.floor(ends[1] + NEAR)
    return slice(max(first, 0), min(last + 1, axis.size))


def _reach(axis: Axis) -> str:
    return f"{axis.first:.9g} to {axis.first + axis.step * (axis.size - 1):.9g}"


def _spelled(window: Window) -> str:
    return f"[{', '.join(f'{each:.9g}' for each in window)}]"


def axes_of(x: Array, y: Array) -> tuple[Axis, Axis]:
    """Return uniform axes as their first node, step and count."""
    first, second = (
        Axis(float(axis[0]), float(np.ptp(axis)) / (axis.size - 1), axis.size) for axis in (x, y)
    )
    return first, second


def cut(grid: Grid, window: Window) -> Grid:
    """Return the part of a ground whose nodes lie in a window, borders among them.

    Raises
    ------
    DataError
        If it has less than four nodes in a direction, or the window is empty.
    """
    i, j = parts(*axes_of(grid.x, grid.y), window)
    filled = None if grid.filled is None else grid.filled[i, j]
    return Grid(grid.x[i], grid.y[j], np.ascontiguousarray(grid.z[i, j]), filled)


def check_whole(found: Heights) -> None:
    """Refuse a map with holes.

    Raises
    ------
    DataError
        Says how many there are, where the first is, and how to fill them.
    """
    holes = np.isnan(found.z)
    if holes.any():
        i, j = np.argwhere(holes)[0]
        raise DataError(
            f"all heights must be finite, found {np.count_nonzero(holes)} of {holes.size} nodes "
            f"without one, the first at x = {found.x[i]:.9g}, y = {found.y[j]:.9g}; ask for "
            'fill = "linear", or cut the map by window to a part without holes'
        )


def fill_holes(found: Heights) -> Filled:
    """Return heights with holes interpolated linearly between the nodes around them.

    Raises
    ------
    DataError
        If a hole reaches the border, where nothing lies around it; the message names a window
        that such holes do not reach.

    Notes
    -----
    The rims of the holes, every node that is one of the eight neighbours of a hole, are joined to
    triangles by Delaunay's rule. A rim is a closed chain whose links are edges of these triangles,
    so that no hole is filled from the rim of another. A plane is filled exactly.
    """
    from scipy.interpolate import LinearNDInterpolator  # imported where it is used: it takes 0.2 s

    holes = np.isnan(found.z)
    numbers, count = ndimage.label(holes, AROUND)
    if not count:
        return Filled(found.z, 0, 0, (0.0, 0.0))
    _check_closed(found, numbers)
    rim = ndimage.binary_dilation(holes, AROUND) & ~holes
    z = found.z.copy()
    surface = LinearNDInterpolator(np.argwhere(rim).astype(np.float64), z[rim])
    z[holes] = surface(np.argwhere(holes).astype(np.float64))
    most = int(np.argmax(np.bincount(numbers.reshape(-1))[1:]))
    extent = ndimage.find_objects(numbers)[most]
    largest = [
        (part.stop - part.start) * axis.step
        for part, axis in zip(extent, axes_of(found.x, found.y), strict=True)
    ]
    return Filled(z, int(np.count_nonzero(holes)), int(count), (largest[0], largest[1]))


def _check_closed(found: Heights, numbers: Array) -> None:
    """Refuse holes that reach the border of the map."""
    borders = numbers[0], numbers[-1], numbers[:, 0], numbers[:, -1]
    open_ones = np.unique(np.concatenate(borders))
    open_ones = open_ones[open_ones > 0]
    if open_ones.size:
        nodes = int(np.isin(numbers, open_ones).sum())
        window = _closed_window(np.isnan(found.z))
        remedy = "use another map"
        if window is not None:
            i, j = window
            ends = found.x[i.start], found.x[i.stop - 1], found.y[j.start], found.y[j.stop - 1]
            remedy = (
                "cut the map to a part that they do not reach, for example (in the coordinates of "
                f"the file) window = {_spelled(ends)}"
            )
        raise DataError(
            "fill: expected holes with heights all around, found "
            f"{open_ones.size} of {nodes} nodes that reach the border of the map, where they "
            f"could only be extrapolated; {remedy}"
        )


def _closed_window(holes: Mask) -> tuple[slice, slice] | None:
    """Return a part of a map without holes at its border: the worst border goes until none is."""
    i, j = slice(0, holes.shape[0]), slice(0, holes.shape[1])
    while min(i.stop - i.start, j.stop - j.start) >= 4:
        part = holes[i, j]
        worst = [float(line.mean()) for line in (part[0], part[-1], part[:, 0], part[:, -1])]
        if max(worst) == 0:
            return i, j
        match int(np.argmax(worst)):
            case 0:
                i = slice(i.start + 1, i.stop)
            case 1:
                i = slice(i.start, i.stop - 1)
            case 2:
                j = slice(j.start + 1, j.stop)
            case _:
                j = slice(j.start, j.stop - 1)
    return None


def scaled(grid: Grid, horizontal: float, vertical: float) -> Grid:
    """Return a ground with x and y multiplied by one number and heights by another. [1]."""
    if horizontal == vertical == 1:
        return grid
    return replace(grid, x=horizontal * grid.x, y=horizontal * grid.y, z=vertical * grid.z)


def smoothed(grid: Grid, deviation: float) -> Smoothed:
    """Return a ground averaged with Gaussian weights.

    Outside the grid the ground continues as its mirror image about the border node, upside down,
    so that a slope stays a slope.

    Parameters
    ----------
    grid : Grid
        The ground.
    deviation : float
        Standard deviation of the weights; waves of length w keep exp(-2 (pi deviation / w)**2) of
        their height. [m]

    Raises
    ------
    ModelError
        If it is not positive, or more than an eighth of the ground.
    """
    extent = min(float(np.ptp(grid.x)), float(np.ptp(grid.y)))
    if not 0 < deviation <= extent / 8:
        raise ModelError(
            f"smooth: expected a standard deviation above 0 and of at most {extent / 8:.4g} m, an "
            f"eighth of the ground, found {deviation:g} m"
        )
    z = averaged(grid.z, grid.spacing, deviation)
    change = z - grid.z
    return Smoothed(replace(grid, z=z), math.sqrt(np.mean(change**2)), float(np.abs(change).max()))


def averaged(z: Array, steps: tuple[float, float], deviation: float) -> Array:
    """Return heights averaged with Gaussian weights, continued outside as `smoothed` has it.

    Parameters
    ----------
    z : ndarray, shape (n_x, n_y)
        Heights. [m]
    steps : tuple of 2 floats
        Distances of nodes along x and y. [m]
    deviation : float
        Standard deviation of the weights. [m]
    """
    sigma = [deviation / step for step in steps]
    pad = [math.ceil(TAIL * each) + 1 for each in sigma]
    wide = np.pad(z, [(n, n) for n in pad], mode="reflect", reflect_type="odd")
    mean = ndimage.gaussian_filter(wide, sigma, truncate=TAIL)
    return np.ascontiguousarray(mean[pad[0] : -pad[0], pad[1] : -pad[1]])


def disturbed(grid: Grid, rms: float, correlation: float, seed: int) -> Grid:
    """Return a ground with a random error of its heights added.

    Parameters
    ----------
    grid : Grid
        The ground.
    rms : float
        Standard deviation of the error over all seeds; on one map it is about that, the nearer
        the more correlation lengths it spans. [m]
    correlation : float
        Distance d at which the correlation exp(-(d / correlation)**2) is down to 1/e. [m]
    seed : int
        Of the random numbers.

    Raises
    ------
    ModelError
        If a number is not positive.

    Notes
    -----
    A sum of plane waves of random phase whose wave vectors are normally distributed, the spectrum
    of that correlation (Shinozuka and Deodatis, "Simulation of stochastic processes by spectral
    representation", Applied Mechanics Reviews 44, 1991). It is a function of the place alone: a
    window or another spacing sees the same error.
    """
    if not (rms > 0 and correlation > 0):
        raise ModelError(
            f"error: expected rms and correlation above 0 m, found {rms:g} m and {correlation:g} m"
        )
    rng = np.random.default_rng(seed)
    # A variance of 2 / correlation**2 a component makes E cos(k d) = exp(-(d / correlation)**2).
    k_x, k_y = rng.standard_normal((2, WAVES)) * (math.sqrt(2) / correlation)
    wave = np.exp(1j * rng.uniform(0, 2 * np.pi, WAVES))
    along_x = np.exp(1j * np.outer(grid.x, k_x)) * wave
    along_y = np.exp(1j * np.outer(k_y, grid.y))
    # Only the real part of the product is needed: two real products instead of four.
    error = along_x.real @ along_y.real - along_x.imag @ along_y.imag
    return replace(grid, z=grid.z + rms * math.sqrt(2 / WAVES) * error)
