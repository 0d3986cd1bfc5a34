"""Grounds given by heights on a grid, interpolated by a bicubic spline.

Of maps that exceed the memory, heights are read where they are needed. The table of coefficients
has its full size in virtual memory only: `PagedBicubic.load` computes those of a part of the map,
and gives the memory of others back. The effect of a node on a coefficient falls to 0.27 per node,
so that the coefficients are those of the whole map, except for rounding, if the heights of `BORDER`
further nodes are known.
"""

from __future__ import annotations

import math
import mmap
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from slipfree.core.arguments import checked
from slipfree.core.lookups import CellBounds, Cells, LookupTable
from slipfree.core.records import Array, Indices
from slipfree.core.trajectory import Drawable
from slipfree.system.forks import cached_property
from slipfree.terrain import base
from slipfree.terrain.base import REPEATED, Grid, pad_axes
from slipfree.terrain.grid_ops import Window, any_of_four, continue_over_holes, hole_distance
from slipfree.terrain.kernel import Opened, register_ground

KNOT_TOLERANCE = 1e-10  # points closer to a knot count as on it, in cells
HOLE_CLEARANCE = 1 / 3  # smoothing shifts the zero of the distance by less, in cells
BLOCK = 128  # side of a block of cells whose bounds are computed together
CHUNK = 8192  # points evaluated at once, so that temporary arrays stay in the cache
CUBIC = tuple((m, n) for n in range(4) for m in range(4))  # orders of a cell's derivatives
MAX_FOURFOLD_SIZE = 2**21  # larger tables of coefficients are stored once, not four times
COLUMNS_AT_ONCE = 64  # splines solved together; their values stay in the processor's cache


@checked
@dataclass(frozen=True, eq=False)
class Bicubic(Drawable, base.GroundFriction):
    """The bicubic not-a-knot spline through the heights of a grid.

    It is the surface of ``scipy.interpolate.RectBivariateSpline(x, y, z, s=0)``. Height and
    derivatives are polynomials inside a cell. A point on a knot belongs to the cell on its right,
    a point on the last knot to the last cell. Outside the domain the polynomial of the nearest
    cell continues.

    With ``through=False`` the surface is the cubic B-spline whose coefficients are the values of
    the nodes, with the border repeated. It is twice continuously differentiable, stays between the
    smallest and the largest value of the 16 surrounding nodes, and is smoother than the values:
    a jump between two nodes becomes a rise over three cells, with 96 % of it within two cells.

    Attributes
    ----------
    grid : Grid
        Nodes of the spline, and their heights. [m]
    center : tuple of 2 floats or None
        Map coordinates of the local origin, by default the middle of the domain. On a large map,
        an origin near the motion avoids loss of digits. [m]
    mu : float, callable, Grid or None
        Coefficient of friction: a number, a function of two SX scalars in map coordinates, or a
        map, interpolated as in `slipfree.terrain.base`; None for a ground without coefficient
        of friction. [1]
    through : bool
        Whether the surface interpolates the values of the nodes; otherwise it smooths them.

    Raises
    ------
    ModelError
        If ``mu`` is of another type, a number that is not positive and finite, or a function that
        does not return one scalar that depends only on ``x`` and ``y``.
    DataError
        If a friction map has nodes without a coefficient, or coefficients that are not positive.

    Notes
    -----
    CasADi's own splines cannot be used: CasADi 3.8.2 writes outside its arrays when it evaluates
    fourth derivatives, or third derivatives at knots. Here the centre of the cell and the 16
    derivatives there are looked up (`slipfree.core.lookups`); the height is then an SX polynomial.

    If a compiler was found at installation, the C code of `slipfree.terrain.kernel` does the
    lookup. Otherwise, and for a ground that was created while 64 others were in use, a CasADi
    interpolant does it.

    Two threads must not evaluate the same instance at the same time; give each thread an unpickled
    copy.

    Examples
    --------
    >>> import numpy as np
    >>> from slipfree import Bicubic, Grid
    >>> x, y = np.linspace(0, 10, 41), np.linspace(0, 20, 81)
    >>> ground = Bicubic(Grid(x, y, 0.1 * np.sin(x)[:, None] * np.cos(y)), mu=0.6)
    >>> ground.elevation(np.array([1.0, 2.0]), np.array([0.0, 3.0])).round(4)
    array([ 0.0841, -0.09  ])
    """

    grid: Grid
    center: tuple[float, float] | None = None
    mu: base.Friction = None
    through: bool = field(default=True, kw_only=True)

    def __repr__(self) -> str:
        friction = "from a map" if isinstance(self.mu, Grid) else self.mu
        return (
            f"{self.grid!r}".replace("Grid", type(self).__name__, 1) + f"\n  friction: {friction}"
        )

    def __post_init__(self) -> None:
        base.check_friction(self.mu)

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields for pickling; an unpickled copy computes the coefficients again."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    @property
    def ground(self) -> Bicubic:
        """The ground itself, for `plot`."""
        return self

    @cached_property
    def origin(self) -> tuple[float, float, float]:
        """Local origin in map coordinates: the centre, and the mean height [m]."""
        x_min, x_max, y_min, y_max = self.domain
        x, y = self.center or (0.5 * (x_min + x_max), 0.5 * (y_min + y_max))
        return x, y, float(self.grid.values.mean())

    @property
    def domain(self) -> tuple[float, float, float, float]:
        """``x_min, x_max, y_min, y_max`` of the nodes [m]."""
        return self.grid.domain

    @property
    def is_level(self) -> bool:
        """Whether all nodes have the same height, without holes."""
        return self.grid.holes is None and bool(np.ptp(self.grid.z) == 0)

    def height(self, x: ca.SX, y: ca.SX, lookups: LookupTable) -> ca.SX:
        """Return the height at a point.

        Parameters
        ----------
        x, y : SX, shape (1, 1)
            The point, in local coordinates. [m]
        lookups : LookupTable
            Table to which the lookups that the result needs are added.

        Returns
        -------
        SX, shape (1, 1)
            Height above ``origin[2]``. [m]
        """
        return self.jet(x, y, lookups).height

    def jet(self, x: ca.SX, y: ca.SX, lookups: LookupTable) -> base.Jet:
        """Return the height at a point with its first and second derivatives.

        Parameters
        ----------
        x, y : SX, shape (1, 1)
            The point, in local coordinates. [m]
        lookups : LookupTable
            Table to which the lookups that the result needs are added.

        Returns
        -------
        Jet
            Height (1, 1) above ``origin[2]`` [m], gradient (2, 1) [1] and Hessian (2, 2) [1/m].
        """
        cell, key = self._cell
        coefficients = lookups.find(cell, ca.vertcat(x, y, key), cells=self.cells)
        return base.polynomial_jet(coefficients, CUBIC, x, y)

    def nearest_point(self, r1: float, r2: float, radius: float) -> ca.Function | None:
        """Return the compiled search for the ground point nearest to a torus; None without kernel.

        It equals `slipfree.contact.touch.search_function`; parameters are the radii of the tube
        and of the circle of tube centres, and the rolling radius. [m]
        """
        if self._kernel is None:
            return None
        asked = ca.MX.sym("asked", 6)
        question = ca.vertcat(asked, ca.DM([r1, r2, radius, self._kernel.key]))
        return ca.Function("search", [asked], [self._kernel.nearest(question)])

    def hole_margin(self, x: ca.SX, y: ca.SX, lookups: LookupTable) -> ca.SX | None:
        """Return the distance of a local point from cells with a missing height [m].

        A third of a cell is subtracted, and the distance is smoothed as by ``through=False``, so
        that it is twice continuously differentiable, and negative in every cell with a corner
        without a height. The result is None for a grid without holes.
        """
        margin = self._margin
        return None if margin is None else margin.height(x, y, lookups) + margin.origin[2]

    def elevation(self, x: Array, y: Array) -> Array:
        """Return the heights at points.

        Parameters
        ----------
        x, y : ndarray, broadcastable shapes
            The points, in map coordinates. [m]

        Returns
        -------
        ndarray, of the common shape
            Heights in map coordinates. [m]
        """
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        x_0, y_0, z_0 = self.origin
        flat_x, flat_y, heights = x.reshape(-1), y.reshape(-1), np.empty(x.size)
        local_heights = self._kernel.heights if self._kernel else self._local_heights
        for start in range(0, x.size, CHUNK):
            part = slice(start, start + CHUNK)
            heights[part] = local_heights(flat_x[part] - x_0, flat_y[part] - y_0)
        return heights.reshape(x.shape) + z_0

    @property
    def smallest_gaps(self) -> Callable[..., tuple[Array, Indices]] | None:
        """`slipfree.terrain.kernel.Opened.smallest_gaps`; None without kernel."""
        return None if self._kernel is None else self._kernel.smallest_gaps

    def derivative_bounds(self, x: Array, y: Array, reach: float) -> tuple[Array, Array]:
        """Return upper bounds of the slope and of the curvature around points.

        Parameters
        ----------
        x, y : ndarray, shape (n,)
            Points in map coordinates. [m]
        reach : float
            Distance in x and y within which the bounds hold. [m]

        Returns
        -------
        slope, curvature : ndarray, shape (n,)
            Bounds of the norm of the gradient [1] and of the spectral norm of the Hessian [1/m];
            infinite for points whose surroundings are not inside the domain.

        Notes
        -----
        A derivative of a B-spline is a B-spline of a lower degree. Its coefficients are difference
        quotients of the coefficients of the spline, and it lies between the smallest and the
        largest of those that belong to a cell. Points of a cell share their bounds; those of a
        block of cells are computed together, when the first of them is asked for.
        """
        return self._known_bounds.at(x, y, reach)

    def known_bounds(self, reach: float) -> CellBounds:
        """Return the results of `derivative_bounds` that were computed for a reach.

        Parameters
        ----------
        reach : float
            Distance in x and y within which the bounds hold. [m]

        Returns
        -------
        CellBounds
            Bounds of slope [1] and curvature [1/m] by cell.
        """
        return self._known_bounds.known(reach, self.origin)

    def _block_bounds(self, i: int, j: int, reach: float) -> Array:
        """Return the bounds of `derivative_bounds` for the cells of a block."""
        h_x, h_y = self.grid.spacing
        around = [math.ceil(reach / h) for h in (h_x, h_y)]
        parts = list[Array]()
        for k, n, count in zip((i, j), around, self._table.shape, strict=True):
            cells = np.arange(BLOCK * k - n, min(BLOCK * (k + 1), count - 3) + n + 3)
            parts.append(np.clip(cells, 0, count - 1))
        table = 36 * self._table[np.ix_(*parts)]
        along_x, along_y = np.diff(table, axis=0) / h_x, np.diff(table, axis=1) / h_y

        def largest(derivative: Array, orders: tuple[int, int]) -> Array:
            """Return the largest magnitude in the cells around each cell."""
            for axis, (n, order) in enumerate(zip(around, orders, strict=True)):
                size = 2 * n + 4 - order
                derivative = sliding_window_view(np.abs(derivative), size, axis).max(axis=-1)
            return derivative

        xx = largest(np.diff(along_x, axis=0) / h_x, (2, 0))
        yy = largest(np.diff(along_y, axis=1) / h_y, (0, 2))
        xy = largest(np.diff(along_x, axis=1) / h_y, (1, 1))
        return base.bounds_of(largest(along_x, (1, 0)), largest(along_y, (0, 1)), xx, xy, yy)

    @cached_property
    def _known_bounds(self) -> base.DerivativeBounds:
        x_min, _, y_min, _ = self.domain
        corner, spacing = (x_min, y_min), self.grid.spacing
        return base.DerivativeBounds(
            BLOCK, self._block_bounds, self.domain, corner, lambda _: spacing
        )

    def _in_cells(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Return a local point in units of cells from the node nearest to the local origin.

        With this reference, points near the origin lose no digits on a map of any size.
        """
        (x_0, y_0), (h_x, h_y) = self.cells.place, self.cells.spacing
        return (x - x_0) / h_x, (y - y_0) / h_y

    def _local_heights(self, x: Array, y: Array) -> Array:
        """Return the local heights at local points, shape (n,)."""
        a, b = self._in_cells(x, y)
        (i_0, j_0), (i_last, j_last) = self.cells.node, self.cells.last
        # a point within rounding before a knot belongs to the cell behind it; points outside the
        # map belong to the border cells, whose polynomials continue
        # fmin and fmax assign NaN to a valid cell, whose polynomial then returns NaN
        i = np.fmin(np.fmax(np.floor(a + KNOT_TOLERANCE), -i_0), i_last - i_0)
        j = np.fmin(np.fmax(np.floor(b + KNOT_TOLERANCE), -j_0), j_last - j_0)
        rows, columns = _basis(a - i), _basis(b - j)
        table = self._table
        width = table.shape[1]
        first = (i + i_0).astype(np.intp) * width + (j + j_0).astype(np.intp)
        heights = np.zeros(x.size)
        for m, row in enumerate(rows):
            line = np.zeros(x.size)
            for n, column in enumerate(columns):
                line += column * table.reshape(-1).take(first + (m * width + n))
            heights += row * line
        return heights

    @cached_property
    def _table(self) -> Array:
        """Spline coefficients, shape (n_x + 2, n_y + 2) [m]."""
        return coefficients_of(self.grid.z - self.origin[2], through=self.through)

    @cached_property
    def cells(self) -> Cells:
        """Cells of the spline, in local coordinates."""
        x, y, (h_x, h_y), (x_0, y_0, _) = self.grid.x, self.grid.y, self.grid.spacing, self.origin
        i = int(np.clip(np.rint((x_0 - x[0]) / h_x), 0, x.size - 1))
        j = int(np.clip(np.rint((y_0 - y[0]) / h_y), 0, y.size - 1))
        place = float(x[i] - x_0), float(y[j] - y_0)
        # the last cell begins at the last but one node
        return Cells(self._table, place, (h_x, h_y), (i, j), (x.size - 2, y.size - 2))

    @cached_property
    def _kernel(self) -> Opened | None:
        return register_ground(self.cells)

    @cached_property
    def _cell(self) -> tuple[ca.Function, float]:
        """Lookup function of a cell with the arguments x, y and key, and the value of the key."""
        if self._kernel is not None:
            return self._kernel.function, self._kernel.key
        # without `kernel.c`, CasADi interpolants look up the coefficients
        (i_0, j_0), (i_last, j_last) = self.cells.node, self.cells.last
        (x_0, y_0), (h_x, h_y) = self.cells.place, self.cells.spacing
        at = ca.MX.sym("at", 3)
        a, b = self._in_cells(at[0], at[1])
        i = ca.fmin(ca.fmax(ca.floor(a + KNOT_TOLERANCE), -i_0), i_last - i_0)
        j = ca.fmin(ca.fmax(ca.floor(b + KNOT_TOLERANCE), -j_0), j_last - j_0)
        c = ca.reshape(_gather_function(self._table)(ca.vertcat(i + i_0, j + j_0)), 4, 4)
        left, right = (ca.DM(basis(0.5) / h ** np.arange(4)[:, None]) for h in (h_x, h_y))
        center = x_0 + (i + 0.5) * h_x, y_0 + (j + 0.5) * h_y
        return ca.Function("cell", [at], [ca.vertcat(*center, ca.vec(left @ c @ right.T))]), 0.0

    @cached_property
    def _margin(self) -> Bicubic | None:
        """Surface of the distance from cells with a missing height; None without holes."""
        if self.grid.holes is None:
            return None
        distance = hole_distance(self.grid) - HOLE_CLEARANCE * max(self.grid.spacing)
        return Bicubic(Grid(self.grid.x, self.grid.y, distance), self.origin[:2], through=False)

    @cached_property
    def _friction_map(self) -> Bicubic | None:
        return friction_map(self.mu, self.origin[:2])


def coefficients_of(values: Array, *, through: bool) -> Array:
    """Return the coefficients of the spline of heights (n_x, n_y), shape (n_x + 2, n_y + 2)."""
    if through:
        along_x = _solve_not_a_knot(values)
        coefficients = np.ascontiguousarray(_solve_not_a_knot(along_x.T).T)
    else:
        coefficients = np.ascontiguousarray(np.pad(values, 1, mode="edge"))
    coefficients /= 36  # instead of the factors 1/6 of the basis functions
    return coefficients


def friction_map(mu: base.Friction, center: tuple[float, float]) -> Bicubic | None:
    """Return the surface of a friction map in local coordinates about a centre; None without a map.

    Its local height is the coefficient minus ``origin[2]``, the mean over the nodes.
    """
    return Bicubic(base.pad_border(mu), center, through=False) if isinstance(mu, Grid) else None


def _basis(u: Any) -> tuple[Any, Any, Any, Any]:
    """Return the four uniform cubic B-splines of a cell at ``u`` in [0, 1], times six."""
    v = 1 - u
    first, last = v * v * v, u * u * u
    # the third function is six minus the others: their sum is exactly that of a constant surface
    second = 4 + 3 * (last - 2 * (u * u))
    return first, second, 6 - first - second - last, last


def _solve_not_a_knot(values: Array) -> Array:
    """Return the uniform B-spline coefficients of interpolating cubics along the first axis.

    For n >= 4 values there are n + 2 coefficients; third derivatives are continuous at the second
    and the last but one node.
    """
    from scipy.linalg import solve_banded  # imported here: the import takes 0.2 s

    n = values.shape[0]
    bands = np.zeros((9, n + 2))  # entry i, j of the matrix is bands[4 + i - j, j]
    bands[5, :n], bands[4, 1:-1], bands[3, 2:] = 1 / 6, 4 / 6, 1 / 6
    # the third derivative is a third difference of coefficients, its jump a fourth difference
    for column, weight in enumerate((1, -4, 6, -4, 1)):
        bands[4 - column, column] = weight
        bands[8 - column, n - 3 + column] = weight
    solution = np.empty((n + 2, values.shape[1]))
    for start in range(0, values.shape[1], COLUMNS_AT_ONCE):
        part = values[:, start : start + COLUMNS_AT_ONCE]
        right = np.zeros((n + 2, part.shape[1]))
        right[1:-1] = part
        solution[:, start : start + COLUMNS_AT_ONCE] = solve_banded((4, 4), bands, right)
    return solution


def basis(u: Any) -> Array:
    """Return the four B-splines of a cell at ``u`` in [0, 1], times six, and their derivatives.

    The shape is (4, 4) and that of ``u``, with one row per order; derivatives are with respect to
    cell coordinates.
    """
    v = 1 - u
    one = u + v
    return np.array(
        [
            [v**3, 4 + 3 * (u**3 - 2 * u**2), 4 + 3 * (v**3 - 2 * v**2), u**3],
            [-3 * v**2, 3 * u * (3 * u - 4), 3 * v * (4 - 3 * v), 3 * u**2],
            [6 * v, 18 * u - 12, 18 * v - 12, 6 * u],
            [-6 * one, 18 * one, -18 * one, 6 * one],
        ]
    )


def _gather_function(table: Array) -> ca.Function:
    """Return the lookup function of the 16 table entries of a cell.

    It maps integers ``[i, j]`` to ``table[i : i + 4, j : j + 4]`` as a column; i changes fastest.
    """
    # neighbours along i are stored together: 4 lookups instead of 16
    run = 4 if table.size <= MAX_FOURFOLD_SIZE else 1
    runs = sliding_window_view(np.ascontiguousarray(table.T), run, axis=1)
    axes = [list(range(runs.shape[1])), list(range(runs.shape[0]))]
    # a linear interpolant returns the exact values at its nodes
    exact = {"lookup_mode": ["exact", "exact"]}
    interpolant = ca.interpolant("table", "linear", axes, runs.reshape(-1), exact)
    cell = ca.MX.sym("cell", 2)
    parts = [interpolant(cell + ca.DM([m, n])) for n in range(4) for m in range(0, 4, run)]
    return ca.Function("gather", [cell], [ca.vertcat(*parts)], {"never_inline": True})


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
