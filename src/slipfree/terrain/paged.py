"""Bicubic grounds of maps that exceed the memory: heights are read where they are needed.

The table of coefficients has its full size in virtual memory only: `PagedBicubic.load` computes
those of a part of the map, and gives the memory of others back. The effect of a node on a
coefficient falls to 0.27 per node, so that the coefficients are those of the whole map, except for
rounding, if the heights of `BORDER` further nodes are known.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from slipfree.core.records import Array
from slipfree.system.forks import cached_property
from slipfree.terrain.base import REPEATED, Grid, pad_axes
from slipfree.terrain.bicubic import HOLE_CLEARANCE, Bicubic, coefficients_of, friction_map
from slipfree.terrain.grid_ops import Window, any_of_four, continue_over_holes, hole_distance

BORDER = 64  # nodes around a part that are read with it
SPAN = 1024  # nodes along the side of the largest part that is loaded
Read = Callable[[slice, slice], Array]  # values of nodes, NaN where they are missing


@dataclass(frozen=True, eq=False)
class Outline(Grid):
    """Nodes of a map whose values are read by windows.

    ``z`` and ``holes`` are placeholders: zero everywhere, and None without holes. ``values`` are
    only the extremes, ``missing`` counts the nodes without a value.
    """

    read: Read = field(kw_only=True)
    extremes: tuple[float, float] = field(kw_only=True)
    missing: int = field(kw_only=True)

    def __post_init__(self) -> None:
        """Check nothing: axes of rasters are uniform, and values are checked when they are read."""

    @property
    def values(self) -> Array:
        """Smallest and largest value of the nodes outside holes."""
        return np.array(self.extremes)

    def scaled(self, horizontal: float, vertical: float) -> Outline:
        """Return the outline with scaled x and y (``horizontal``) and values (``vertical``)."""
        low, high = self.extremes
        axes = horizontal * self.x, horizontal * self.y
        extremes = vertical * low, vertical * high
        return outline(axes, lambda i, j: vertical * self.read(i, j), extremes, self.missing)


def outline(
    axes: tuple[Array, Array], read: Read, extremes: tuple[float, float], missing: int = 0
) -> Outline:
    """Return the outline of a map."""
    (x, y), shape = axes, (axes[0].size, axes[1].size)
    z, holes = np.broadcast_to(0.0, shape), np.broadcast_to(False, shape) if missing else None
    return Outline(x, y, z, None, holes, read=read, extremes=extremes, missing=missing)


@dataclass(frozen=True, eq=False)
class Elevation:
    """Heights of every n-th node of a map, which are read when they are asked for."""

    grid: Outline
    every: int

    def __getitem__(self, part: tuple[slice, slice]) -> Array:
        """Return the heights of a part, shape (n_x, n_y) [m]; NaN in holes."""
        sizes = (axis[:: self.every].size for axis in (self.grid.x, self.grid.y))
        i, j = (slice(*each.indices(n)[:2]) for each, n in zip(part, sizes, strict=True))
        z = np.empty((i.stop - i.start, j.stop - j.start))
        for at in parts_of(*z.shape, self.every):
            nodes = (
                slice((first + a.start) * self.every, (first + a.stop - 1) * self.every + 1)
                for first, a in zip((i.start, j.start), at, strict=True)
            )
            z[at] = self.grid.read(*nodes)[:: self.every, :: self.every]
        return z


def parts_of(n_x: int, n_y: int, every: int = 1) -> Iterator[tuple[slice, slice]]:
    """Yield slices of every n-th node along x and y, which span at most `SPAN` nodes of the map."""
    side = max(1, SPAN // every)
    for i in range(0, n_x, side):
        for j in range(0, n_y, side):
            yield slice(i, min(i + side, n_x)), slice(j, min(j + side, n_y))


@dataclass(frozen=True, eq=False)
class PagedBicubic(Bicubic):
    """The surface of `Bicubic`, known only in the part of the map that was loaded last.

    Needs `slipfree.terrain.kernel`, which looks coefficients up where they are.
    """

    grid: Outline

    @property
    def is_level(self) -> bool:
        """False: the heights are not known."""
        return False

    def load(self, window: Window) -> None:
        """Compute the coefficients in a part of the map [m], and forget those of others."""
        for surface in (self, self._margin, self._friction_map):
            if isinstance(surface, PagedBicubic):
                surface._fill(window)

    def _fill(self, window: Window) -> None:
        """Replace the coefficients in memory by those of a window of the map."""
        self._known_bounds.clear()
        if hasattr(mmap, "MADV_DONTNEED"):  # pages of a private mapping are freed
            self._memory.madvise(mmap.MADV_DONTNEED)
        wide, here, inner = [], [], []
        for axis, h, ends in zip(
            (self.grid.x, self.grid.y), self.grid.spacing, (window[:2], window[2:]), strict=True
        ):
            first, last = (int(np.clip((at - axis[0]) / h, 0, axis.size - 2)) for at in ends)
            start = max(0, first - BORDER)
            wide.append(slice(start, min(axis.size, last + 2 + BORDER)))
            here.append(slice(first, last + 4))  # four coefficients for each cell
            inner.append(slice(first - start, last + 4 - start))
        z = self.grid.read(*wide)
        missing = np.isnan(z)
        if missing.any():
            z = np.full(z.shape, self.origin[2]) if missing.all() else continue_over_holes(z)
        coefficients = coefficients_of(z - self.origin[2], through=self.through)
        self._table[*here] = coefficients[*inner]

    @cached_property
    def _memory(self) -> mmap.mmap:
        n_x, n_y = self.grid.z.shape
        size = 8 * (n_x + 2) * (n_y + 2)
        if not hasattr(mmap, "MAP_PRIVATE"):
            return mmap.mmap(-1, size)
        return mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)

    @cached_property
    def _table(self) -> Array:
        return np.frombuffer(self._memory).reshape(self.grid.x.size + 2, -1)

    @cached_property
    def _margin(self) -> PagedBicubic | None:
        if self.grid.holes is None:
            return None
        margins = outline((self.grid.x, self.grid.y), self._hole_margins, (0.0, 0.0))
        return PagedBicubic(margins, self.origin[:2], through=False)

    def _hole_margins(self, i: slice, j: slice) -> Array:
        """Return the margins of nodes to holes, at most the width of the border [m]."""
        holes = np.isnan(self.grid.read(i, j))
        cells, width = any_of_four(holes), max(self.grid.spacing)
        if cells.all() or not cells.any():
            return np.full(holes.shape, BORDER * width * (1 if not cells.any() else -1))
        part = Grid(self.grid.x[i], self.grid.y[j], np.zeros(holes.shape), None, holes)
        return hole_distance(part) - HOLE_CLEARANCE * width

    @cached_property
    def _friction_map(self) -> Bicubic | None:
        mu = self.mu
        if not isinstance(mu, Outline):
            return friction_map(mu, self.origin[:2])
        padded = outline(pad_axes(mu), partial(_read_padded, mu), mu.extremes)
        return PagedBicubic(padded, self.origin[:2], through=False)


def _read_padded(grid: Outline, i: slice, j: slice) -> Array:
    """Return values of a map with the values of its border repeated, as `pad_border` does."""
    rows, columns = (
        np.clip(np.arange(part.start, part.stop) - REPEATED, 0, size - 1)
        for part, size in zip((i, j), grid.z.shape, strict=True)
    )
    z = grid.read(slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    return z[np.ix_(rows - rows[0], columns - columns[0])]
