"""Synthetic grounds: roughness, craters, rocks and ramps, added to a grid.

Every function takes a grid and returns a new one. Random functions take a seed; the same seed gives
the same ground. Shapes and positions do not depend on the spacing of the grid, so that a ground can
be refined; only `power_law` scales its heights by a mean over the nodes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Gt, Le, Unit

from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.core.schema import Factor, Length, Position
from slipfree.terrain.base import Grid

WAVES = 1000  # number of plane waves of a rough ground
Seed = Annotated[int, Ge(0)]
SIZE_EXPONENT = 2.0  # the number of craters or rocks above a diameter falls with its square


class Rock(NamedTuple):
    """A rock on the ground, round in plan view.

    Attributes
    ----------
    x, y : float
        Centre. [m]
    diameter : float
        Diameter of the circular base. [m]
    height : float
        Height of the top above the ground. [m]
    """

    x: float
    y: float
    diameter: float
    height: float


@checked
def blank(x_range: tuple[float, float], y_range: tuple[float, float], spacing: Length) -> Grid:
    """Return a flat grid at height zero.

    Parameters
    ----------
    x_range, y_range : tuple of 2 floats
        Coordinates of the first and the last node, a whole number of spacings apart. [m]
    spacing : float
        Distance between nodes. [m]

    Raises
    ------
    ModelError
        If the spacing is not positive, or a range is empty or not a multiple of the spacing.
    """
    axes = []
    for name, (first, last) in (("x", x_range), ("y", y_range)):
        cells = (last - first) / spacing
        if not (cells > 0 and abs(cells - round(cells)) < 1e-6):
            raise ModelError(
                f"blank: expected an increasing {name}_range whose length is a multiple of the "
                f"spacing, found {first:g} to {last:g} m with spacing {spacing:g} m; move its end "
                "or choose another spacing"
            )
        axes.append(np.linspace(first, last, round(cells) + 1))
    return Grid(axes[0], axes[1], np.zeros((axes[0].size, axes[1].size)))


@checked
def power_law(
    grid: Grid,
    *,
    rms: Length,
    hurst: Annotated[float, Gt(0), Le(1), Unit("1")],
    longest: Length,
    shortest: Length,
    seed: Seed,
) -> Grid:
    """Return the grid with self-affine roughness added.

    Parameters
    ----------
    grid : Grid
        The ground below.
    rms : float
        Root mean square of the added heights over the nodes, exactly; their mean is zero. [m]
    hurst : float
        Exponent of Hurst in (0, 1], from jagged to smooth; natural ground has 0.5 to 0.9. The
        two-dimensional power spectral density falls as the wave number to the power
        ``-2 (hurst + 1)``. [1]
    longest : float
        Largest wavelength of the roughness. [m]
    shortest : float
        Smallest wavelength of the roughness, at least twice the spacing. [m]
    seed : int
        Seed of the random numbers.

    Raises
    ------
    ModelError
        If the grid is too coarse for the wavelengths, if ``shortest`` is not below ``longest``, or
        if a number is out of range.

    Notes
    -----
    The roughness is a sum of plane waves with random directions and phases and logarithmically
    spaced wave numbers. Unlike a discrete Fourier transform it is not periodic, and its waves do
    not depend on the grid.
    """
    finest = 2 * max(grid.spacing)
    if not shortest < longest:
        raise ModelError(
            f"power_law: expected shortest < longest, found shortest = {shortest:g} m, "
            f"longest = {longest:g} m; correct them"
        )
    if not finest <= shortest:
        raise ModelError(
            f"power_law: expected shortest >= {finest:g} m, twice the spacing, found "
            f"{shortest:g} m; refine the grid or raise shortest"
        )
    rng = np.random.default_rng(seed)
    octave = (np.arange(WAVES) + rng.random(WAVES)) / WAVES
    k = 2 * np.pi / longest * (longest / shortest) ** octave
    direction, phase = rng.uniform(0, 2 * np.pi, (2, WAVES))
    # density k**(-2 H - 2) times the ring k dk, with dk = k d(log k): power k**(-2 H) per wave
    amplitude = k**-hurst * np.exp(1j * phase)
    along_x = np.exp(1j * np.outer(grid.x - grid.x[0], k * np.cos(direction)))
    along_y = np.exp(1j * np.outer(k * np.sin(direction), grid.y - grid.y[0]))
    rough = ((along_x * amplitude) @ along_y).real
    rough -= rough.mean()
    return Grid(grid.x, grid.y, grid.z + rough * (rms / math.sqrt(np.mean(rough**2))))


@checked
def craters(
    grid: Grid,
    *,
    count: Annotated[int, Ge(0)],
    diameters: Annotated[tuple[float, float], Unit("m")],
    seed: Seed,
) -> Grid:
    """Return the grid with scattered fresh craters added.

    Parameters
    ----------
    grid : Grid
        The ground below.
    count : int
        Number of craters; a larger count adds craters to those of a smaller count.
    diameters : tuple of 2 floats
        Smallest and largest diameter, from rim crest to rim crest; the number of craters above
        a diameter falls with its square. [m]
    seed : int
        Seed of the random numbers.

    Raises
    ------
    ModelError
        If the count is negative, or the diameters are not positive and in ascending order.

    Notes
    -----
    A crater of diameter D has a depth of 0.2 D from rim crest to floor, and its rim is 0.04 D above
    the surrounding ground [1]_. The wall is a bowl with a slope of at most 32 degrees; crest and
    floor are rounded.

    References
    ----------
    .. [1] R. J. Pike, "Size-dependence in the shape of fresh impact craters on the Moon", in
       Impact and Explosion Cratering, 1977, pp. 489-509: depth 0.196 D**1.01, rim height
       0.036 D**1.014, in kilometres.
    """
    z = grid.z.copy()
    for x, y, diameter in _scatter("craters", grid, count, diameters, seed):

        def add(part: Array, s: Array, diameter: float = diameter) -> Array:
            bowl = 0.04 - 0.2 * (1 - s**2) ** 2
            rim = 0.04 * np.exp(-4 * (s - 1) ** 2)
            return part + diameter * np.where(s < 1, bowl, rim)

        # at three radii the rim has decayed to 1e-7 of its height
        _stamp(grid, z, (x, y), diameter / 2, 3.0, add)
    return Grid(grid.x, grid.y, z)


@checked
def rocks(
    grid: Grid,
    *,
    count: Annotated[int, Ge(0)],
    diameters: Annotated[tuple[float, float], Unit("m")],
    height_ratio: Factor,
    seed: Seed,
) -> Grid:
    """Return the grid with scattered rocks added.

    Parameters
    ----------
    grid : Grid
        The ground below.
    count : int
        Number of rocks; a larger count adds rocks to those of a smaller count.
    diameters : tuple of 2 floats
        Smallest and largest diameter; the number of rocks above a diameter falls with its
        square. [m]
    height_ratio : float
        Height over diameter. [1]
    seed : int
        Seed of the random numbers.

    Raises
    ------
    ModelError
        If the count is negative, the height ratio is not positive, or the diameters are not
        positive and in ascending order.
    """
    scattered = _scatter("rocks", grid, count, diameters, seed)
    return place_rocks(grid, [Rock(x, y, d, height_ratio * d) for x, y, d in scattered])


def place_rocks(grid: Grid, placed: Iterable[Rock]) -> Grid:
    """Return the grid with rocks at given positions.

    Parameters
    ----------
    grid : Grid
        The ground below.
    placed : iterable of Rock
        The rocks. Each is a cap like half an ellipsoid, but with a smooth transition to the
        ground, added to the heights; where rocks overlap, the higher one counts.

    Raises
    ------
    ModelError
        If a diameter or a height is not positive.
    """
    z = np.zeros_like(grid.z)
    for rock in map(Rock._make, placed):
        if not (rock.diameter > 0 and rock.height > 0):
            raise ModelError(
                f"rocks: diameter and height must be positive, found {rock}; correct or remove it"
            )

        def cover(part: Array, s: Array, height: float = rock.height) -> Array:
            return np.maximum(part, height * np.where(s < 1, (1 - s**4) ** 2, 0))

        _stamp(grid, z, (rock.x, rock.y), rock.diameter / 2, 1.0, cover)
    return Grid(grid.x, grid.y, grid.z + z)


def ramp(
    grid: Grid,
    *,
    start: Position,
    end: Position,
    rise: Position,
    smooth: bool = True,
    rounding: Annotated[float, Ge(0), Unit("m")] = 0.0,
) -> Grid:
    """Return the grid with a ramp along y added.

    Parameters
    ----------
    grid : Grid
        The ground below.
    start : float
        Value of y where the ramp begins. [m]
    end : float
        Value of y where the ramp ends, ``start < end``. [m]
    rise : float
        Height added behind the ramp; the ground before the ramp is unchanged. [m]
    smooth : bool
        Whether slope and curvature are continuous, with a steepest slope of 15/8 of the mean;
        otherwise the slope is constant between two edges.
    rounding : float
        Length of the rounding of each edge, centred at ``start`` or ``end``; zero for kinks. Slope
        and curvature are continuous; the curvature is at most 3/2 of the constant slope divided by
        this length. [m]

    Raises
    ------
    ModelError
        If ``start`` is not below ``end``, if the rounding is negative or longer than the ramp, or
        if a smooth ramp has a rounding.
    """
    if not start < end:
        raise ModelError(
            f"ramp: expected start < end, found start = {start:g} m and end = {end:g} m; for a "
            "descent use a negative rise"
        )
    if not 0 <= rounding <= end - start:
        raise ModelError(
            f"ramp: expected a rounding from 0 to {end - start:g} m, the length of the ramp, found "
            f"{rounding:g} m; choose a value in this range"
        )
    if smooth and rounding:
        raise ModelError(
            "ramp: expected no rounding for a smooth ramp, which has no edges, found "
            f"{rounding:g} m; remove rounding, or set smooth = false"
        )
    if smooth:
        t = np.clip((grid.y - start) / (end - start), 0, 1)
        profile = t**3 * (10 + t * (6 * t - 15))
    else:
        profile = _bend(grid.y - start, rounding) - _bend(grid.y - end, rounding)
        profile /= end - start
    return Grid(grid.x, grid.y, grid.z + rise * profile)


@checked
def ridge(grid: Grid, *, middle: Position, height: Position, width: Length) -> Grid:
    """Return the grid with a Gaussian ridge added, its crest perpendicular to the y axis.

    Parameters
    ----------
    grid : Grid
        The ground below.
    middle : float
        Value of y at the crest. [m]
    height : float
        Height of the crest; negative for a trench. [m]
    width : float
        Distance from the crest at which the height has fallen to 1/e. [m]

    Raises
    ------
    ModelError
        If the width is not positive.
    """
    profile = np.exp(-(((grid.y - middle) / width) ** 2))
    return Grid(grid.x, grid.y, grid.z + height * profile)


def _bend(y: Array, length: float) -> Array:
    """Return heights whose slope rises from zero to one within a given length around y = 0."""
    if not length:
        return np.maximum(y, 0)
    t = np.clip(y / length + 0.5, 0, 1)
    return length * t**3 * (1 - t / 2) + np.maximum(y - length / 2, 0)


def _scatter(
    name: str, grid: Grid, count: int, diameters: tuple[float, float], seed: int
) -> list[tuple[float, float, float]]:
    """Return x, y and diameter [m] of ``count`` random disks, uniform over the grid.

    ``name`` is the name of the disks in messages.
    """
    smallest, largest = diameters
    if not 0 < smallest <= largest:
        raise ModelError(
            f"{name}: expected diameters with 0 < smallest <= largest, found "
            f"[{smallest:g}, {largest:g}] m; correct them"
        )
    u = np.random.default_rng(seed).random((count, 3))
    x = grid.x[0] + u[:, 0] * np.ptp(grid.x)
    y = grid.y[0] + u[:, 1] * np.ptp(grid.y)
    few = (smallest / largest) ** SIZE_EXPONENT  # share of the power law beyond the largest
    diameter = smallest * (1 - u[:, 2] * (1 - few)) ** (-1 / SIZE_EXPONENT)
    return list(zip(x.tolist(), y.tolist(), diameter.tolist(), strict=True))


def _stamp(
    grid: Grid,
    z: Array,
    centre: tuple[float, float],
    radius: float,
    reach: float,
    change: Callable[[Array, Array], Array],
) -> None:
    """Replace heights near a centre, in place.

    ``change(heights, s)`` returns the new heights, with ``s`` the distance from the centre in
    radii; it applies where the distances in x and in y are at most ``reach`` radii.
    """
    parts = [
        slice(*np.searchsorted(axis, (c - reach * radius, c + reach * radius)).tolist())
        for axis, c in zip((grid.x, grid.y), centre, strict=True)
    ]
    s = np.hypot((grid.x[parts[0], None] - centre[0]), (grid.y[parts[1]] - centre[1])) / radius
    z[parts[0], parts[1]] = change(z[parts[0], parts[1]], s)


FEATURES: dict[str, Callable[..., Grid]] = {  # of problem files, in the order of addition
    "ramp": ramp,
    "ridge": ridge,
    "power_law": power_law,
    "craters": craters,
    "rocks": rocks,
}
