"""Lines on the ground of a scene: contours, a grid with coordinates, and an arrow to the north."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from contourpy import contour_generator

from slipfree.core.records import Array
from slipfree.show.ground_drawing import Window
from slipfree.show.scene import Lines
from slipfree.show.style import FLAT, LARGE
from slipfree.terrain.base import Grid, Terrain

LIFT = 0.01  # height of lines above the ground, so that it does not hide them [reach]
CONTOURS, CELLS = 12, 8  # maximum number of contours, and of grid cells along the longer side
STEPS = (1, 2, 5, 10)  # round numbers, times a power of ten
SAMPLES = 240  # samples of a grid line
ARROW = 0.09  # length of the arrow to the north [longer side of the drawn ground]
GRAY, BROWN, RED = (70, 70, 70), (60, 40, 20), (190, 30, 30)


def map_lines(
    drawn: Grid, terrain: Terrain, window: Window, origin: Array, reach: float
) -> tuple[Lines, ...]:
    """Return contours, grid and north arrow of the drawn ground.

    Parameters
    ----------
    drawn : Grid
        Heights at the nodes of the drawn ground.
    terrain : Terrain
        The ground.
    window : tuple of 4 floats
        Drawn part: ``x_min, x_max, y_min, y_max``. [m]
    origin : ndarray, shape (3,)
        Map coordinates of the scene's origin. [m]
    reach : float
        Radius of a circle around the vehicle. [m]
    """
    above = origin - np.array([0.0, 0.0, LIFT * reach])
    found = [contours(drawn), *_grid_and_north(drawn, terrain, window)]
    return tuple(
        each._replace(
            segments=each.segments - above,
            labels=tuple((words, place - above) for words, place in each.labels),
        )
        for each in found
        if len(each.segments)
    )


def contours(drawn: Grid) -> Lines:
    """Return the contours of a ground at round heights, in map coordinates."""
    low, high = float(drawn.values.min()), float(drawn.values.max())
    step = round_step((high - low) / CONTOURS)
    if high - low < FLAT:
        return Lines("contours", "", BROWN, np.zeros((0, 2, 3)))
    mask = False if drawn.holes is None else drawn.holes.T
    generator: Any = contour_generator(drawn.x, drawn.y, np.ma.array(drawn.z.T, mask=mask))
    levels = step * np.arange(np.ceil(low / step), np.floor(high / step) + 1)
    segments = [
        _segments(np.column_stack([line, np.full(len(line), level)]))
        for level in levels
        for line in generator.lines(level)
    ]
    legend = f"every {step:g} m of height"
    return Lines("contours", legend, BROWN, np.concatenate([np.zeros((0, 2, 3)), *segments]))


def round_step(least: float) -> float:
    """Return the smallest of 1, 2 and 5 times a power of ten that is at least a positive value."""
    power = 10.0 ** np.floor(np.log10(max(least, FLAT / 10)))
    return float(next(power * step for step in STEPS if power * step >= least * (1 - 1e-9)))


def _grid_and_north(drawn: Grid, terrain: Terrain, window: Window) -> Iterable[Lines]:
    """Yield lines of equal coordinates, and the arrow to the north, in map coordinates."""
    west, east, south, north = window
    long = max(east - west, north - south)
    step = round_step(long / CELLS)

    def draped(x: Array, y: Array) -> Array:
        x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        z = np.where(drawn.touches(drawn.holes, x, y), np.nan, terrain.elevation(x, y))
        return np.stack([x, y, z], axis=-1)

    columns = step * np.arange(np.ceil(west / step), np.floor(east / step) + 1)
    rows = step * np.arange(np.ceil(south / step), np.floor(north / step) + 1)
    along_x, along_y = np.linspace(west, east, SAMPLES), np.linspace(south, north, SAMPLES)
    lines = [*(draped(np.array(x), along_y) for x in columns)]
    lines += [draped(along_x, np.array(y)) for y in rows]
    labels = [(_coordinate("x", x), draped(np.array(x), np.array(south))) for x in columns]
    labels += [(_coordinate("y", y), draped(np.array(west), np.array(y))) for y in rows]
    segments = np.concatenate([np.zeros((0, 2, 3)), *map(_segments, lines)])
    shown = tuple((words, place) for words, place in labels if np.isfinite(place).all())
    yield Lines("grid", f"every {step:g} m", GRAY, segments, shown)
    size = ARROW * long
    tip, head = np.array([east - 0.5 * size, north - 0.3 * size]), 0.3 * size
    corners = tip + np.array(
        [[0, -size], [0, 0], [-0.4 * head, -head], [0, 0], [0.4 * head, -head]]
    )
    arrow = draped(corners[:, 0], corners[:, 1])
    arrow[:, 2] = np.nanmax(arrow[:, 2]) if np.isfinite(arrow[:, 2]).any() else drawn.values.max()
    yield Lines("north", "to +y of the map", RED, _segments(arrow), (("N", arrow[1]),))


def _coordinate(name: str, value: float) -> str:
    """Return the label of a grid line; large coordinates are shortened to the last three digits."""
    is_large = abs(value) >= LARGE
    return f"{name} ...{value % 1000:03g} m" if is_large else f"{name} {value + 0.0:g} m"


def _segments(line: Array) -> Array:
    """Return the segments between consecutive points, shape (n, 2, 3); NaN ends are omitted."""
    found = np.stack([line[:-1], line[1:]], axis=1)
    return np.asarray(found[np.isfinite(found).all(axis=(1, 2))])
