"""Interface between grounds and models, the checked grid of a height map, and friction.

A friction map is the cubic B-spline whose coefficients are the values at the nodes, with the border
repeated. It is twice continuously differentiable and stays between the smallest and the largest
value of the 16 nodes around a point; unlike an interpolating spline it has no negative friction
between ice and rock. Outside the map, the values of the border continue. The spline smooths the
values instead of interpolating them: a jump between two nodes becomes a rise over three cells, with
96 % of it within two cells.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple, Protocol

import casadi as ca
import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.errors import DataError, ModelError
from slipfree.core.lookups import CellBounds, LookupTable
from slipfree.core.records import Array, HtmlRepr, Mask, overview
from slipfree.core.schema import Positive

MAX_BLOCKS = 256  # whose bounds of derivatives are kept; 64 MB
SPAN = 2**31  # blocks along an axis
MAX_HEIGHT = 1e9  # largest absolute height of a ground [m]
UNIFORMITY = 1e-9  # largest deviation of a node from a uniform axis, relative to its length
RESAMPLE = {
    "x": "x_even = np.linspace(x[0], x[-1], x.size); "
    "z = scipy.interpolate.RectBivariateSpline(x, y, z)(x_even, y)",
    "y": "y_even = np.linspace(y[0], y[-1], y.size); "
    "z = scipy.interpolate.RectBivariateSpline(x, y, z)(x, y_even)",
}
FLIP = {"x": "x[::-1] and z[::-1, :]", "y": "y[::-1] and z[:, ::-1]"}
Formula = Callable[[ca.SX, ca.SX], ca.SX | float]  # of two scalars


class Jet(NamedTuple):
    """Height [m], gradient (2, 1) [1] and Hessian (2, 2) [1/m] of a ground at a local point."""

    height: ca.SX
    gradient: ca.SX
    hessian: ca.SX


def jet_of(height: ca.SX, x: ca.SX, y: ca.SX) -> Jet:
    """Return a height expression with its first and second derivatives in ``x`` and ``y``."""
    place = ca.vertcat(x, y)
    gradient = ca.gradient(height, place)
    return Jet(height, gradient, ca.jacobian(gradient, place))


def polynomial_jet(found: ca.SX, orders: Sequence[tuple[int, int]], x: ca.SX, y: ca.SX) -> Jet:
    """Return height, gradient and Hessian at a point, from the derivatives of a polynomial.

    ``found`` are the coordinates of the centre of the polynomial [m], then its derivatives at the
    centre, of the ``orders`` with respect to x and y.
    """
    return Jet(*_polynomial_function(tuple(orders))(found, x, y))


@cache
def _polynomial_function(orders: tuple[tuple[int, int], ...]) -> ca.Function:
    """Return the function of `polynomial_jet`; to build it takes a hundred times a call."""
    found, x, y = ca.SX.sym("found", 2 + len(orders)), ca.SX.sym("x"), ca.SX.sym("y")
    values = dict(zip(orders, ca.vertsplit(found[2:]), strict=True))
    most = max(map(max, orders))
    # along x in every row of derivatives, then along y: Horner's scheme with factorials
    rows = [
        _taylor([values[m, n] for m in range(most + 1) if (m, n) in values], x - found[0])
        for n in range(most + 1)
    ]
    h, h_y, h_yy = _taylor([row[0] for row in rows], y - found[1])
    h_x, h_xy, _ = _taylor([row[1] for row in rows], y - found[1])
    h_xx = _taylor([row[2] for row in rows], y - found[1])[0]
    jet = h, ca.vertcat(h_x, h_y), ca.blockcat([[h_xx, h_xy], [h_xy, h_yy]])
    return ca.Function("jet", [found, x, y], [*jet])


def _taylor(derivatives: Sequence[ca.SX], away: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return a Taylor polynomial and its first two derivatives at a distance from its centre.

    ``derivatives`` are those at the centre, from order zero. Horner's scheme contains the
    factorials: f_0 + d (f_1 + d/2 (f_2 + d/3 f_3)).
    """
    sums = []
    for order in range(3):
        total = ca.SX(0)
        for k in reversed(range(order, len(derivatives))):
            total = derivatives[k] + away / (k - order + 1) * total
        sums.append(total)
    return sums[0], sums[1], sums[2]


TAYLOR = tuple((m, n) for n in range(5) for m in range(5 - n))  # orders of derivatives up to four


def taylor_function(formula: Formula) -> ca.Function | None:
    """Return the lookup function of a formula; None for a formula without function calls.

    It maps a point to the point and the derivatives `TAYLOR` there (17, 1): CasADi cannot
    differentiate function calls in SX graphs as often as plans require.
    """
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    height = ca.Function("height", [x, y], [ca.densify(ca.SX(formula(x, y)))])
    if not height.find_functions():
        return None
    at = ca.MX.sym("at", 2)
    values = {(0, 0): height(at[0], at[1])}
    for m, n in TAYLOR[1:]:
        below, k = ((m - 1, n), 0) if m else ((m, n - 1), 1)
        values[m, n] = ca.jacobian(values[below], at)[k]
    column = ca.vertcat(at, *(values[orders] for orders in TAYLOR))
    return ca.Function("taylor", [at], [ca.densify(column)])


class DerivativeBounds(dict[tuple[int, int, float], Array]):
    """Bounds of slope and curvature around cells of a ground, computed in blocks and kept.

    ``compute(i, j, reach)`` returns those of a block of ``side`` times ``side`` cells, or fewer at
    an edge, shape (2, side, side), which hold at distances up to ``reach`` from its cells. The
    ``domain`` of the ground has cells from the ``corner``, of the ``spacing`` along x and y or a
    multiple of the reach. [m, 1, 1/m]
    """

    def __init__(
        self,
        side: int,
        compute: Callable[[int, int, float], Array],
        domain: tuple[float, float, float, float],
        corner: tuple[float, float],
        spacing: Callable[[float], tuple[float, float]],
    ) -> None:
        self._side, self._compute, self._domain = side, compute, domain
        self._corner, self._spacing = corner, spacing

    def at(self, x: Array, y: Array, reach: float) -> tuple[Array, Array]:
        """Return bounds of slope and curvature at n points, infinite beyond the domain less reach.

        Both have shape (n,).
        """
        x_min, x_max, y_min, y_max = self._domain
        inside = np.isfinite(x + y) & (x_min <= x - reach) & (x + reach <= x_max)
        inside &= (y_min <= y - reach) & (y + reach <= y_max)
        bounds = np.full((2, x.size), np.inf)
        at = np.stack([x[inside], y[inside]]) - np.reshape(self._corner, (2, 1))
        cells = np.floor(at / np.reshape(self._spacing(reach), (2, 1))).astype(int)
        found, (a, b) = np.empty(cells.shape), cells // self._side
        blocks = SPAN * a + b
        for number in np.unique(blocks):
            here = np.flatnonzero(blocks == number)
            key = int(a[here[0]]), int(b[here[0]]), reach
            if key not in self:
                if len(self) >= MAX_BLOCKS:
                    self.pop(next(iter(self)))  # the oldest
                known = self._compute(*key)
                self[key] = np.full((2, self._side, self._side), np.inf)
                self[key][:, : known.shape[1], : known.shape[2]] = known
            found[:, here] = self[key][:, *cells[:, here] % self._side]
        bounds[:, inside] = found
        return bounds[0], bounds[1]

    def known(self, reach: float, origin: tuple[float, float, float]) -> CellBounds:
        """Return the bounds that were computed, in local coordinates of a ground."""
        blocks = {key: block for key, block in self.items() if key[2] == reach}
        rows = [(*key[:2], block.ctypes.data) for key, block in blocks.items()]
        x_min, x_max, y_min, y_max = self._domain
        low, high = np.array([x_min, y_min]) + reach, np.array([x_max, y_max]) - reach
        places = np.array([self._corner, low, high]) - origin[:2]
        numbers = self._side, reach, *places[0], *self._spacing(reach), *places[1:].flat
        return CellBounds(np.array(rows, dtype=np.int64), numbers, [*blocks.values()])


def bounds_of(x: Array, y: Array, xx: Array, xy: Array, yy: Array) -> Array:
    """Return bounds of slope and curvature from magnitudes of derivatives, infinite without them.

    The spectral norm of a matrix is not larger than that of its magnitudes. Where the slope has no
    bound it may jump, and the curvature has none.
    """
    slope, curvature = np.hypot(x, y), (xx + yy) / 2 + np.hypot((xx - yy) / 2, xy)
    known = np.isfinite(slope) & np.isfinite(curvature)
    return np.where(known, [slope, curvature], np.inf)


class Terrain(Protocol):
    """A ground given by its height and its coefficient of friction.

    1. *Map* coordinates are those of the user's data. *Local* coordinates are map coordinates
       minus ``origin``; models use local coordinates to avoid loss of digits.
    2. ``height(x, y, lookups)`` is an SX expression of local coordinates. It is at least twice
       continuously differentiable inside the domain and continues smoothly for a margin outside.
       ``jet(x, y, lookups)`` is the height with its first and second derivatives, for two symbols;
       `jet_of` computes it from a height. A height that is not an expression is looked up:
       `LookupTable.find` returns the results of a function as symbols, and `polynomial_jet`
       computes the height from them.
    3. ``elevation(x, y)`` is the same surface, numeric and vectorised, in map coordinates.
    4. ``friction(x, y, lookups)`` is an SX expression of local coordinates, twice continuously
       differentiable for a map. Without a given coefficient its value is one.
    5. An instance is immutable and can be pickled.
    6. A ground may have the methods ``derivative_bounds``, ``known_bounds`` and ``smallest_gaps``
       of `Bicubic`: they save most of the time of the certificate of a single contact.
    """

    @property
    def origin(self) -> tuple[float, float, float]:
        """Map coordinates of the local origin [m]."""

    @property
    def domain(self) -> tuple[float, float, float, float]:
        """``x_min, x_max, y_min, y_max`` in map coordinates; may be infinite [m]."""

    @property
    def has_friction(self) -> bool:
        """Whether a coefficient of friction was given."""

    @property
    def friction_domain(self) -> tuple[float, float, float, float] | None:
        """``x_min, x_max, y_min, y_max`` of a friction map; None without a map [m]."""

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

    def jet(self, x: ca.SX, y: ca.SX, lookups: LookupTable) -> Jet:
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

    def friction(self, x: ca.SX, y: ca.SX, lookups: LookupTable) -> ca.SX:
        """Return the coefficient of friction at a point.

        Parameters
        ----------
        x, y : SX, shape (1, 1)
            The point, in local coordinates. [m]
        lookups : LookupTable
            Table to which the lookups that the result needs are added.

        Returns
        -------
        SX, shape (1, 1)
            Coefficient, positive. [1]
        """

    def hole_margin(self, x: ca.SX, y: ca.SX, lookups: LookupTable) -> ca.SX | None:
        """Return the distance of a local point from holes of the ground; None without holes [m].

        It is twice continuously differentiable, and not positive in holes, where heights are
        missing.
        """

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


@checked
@dataclass(frozen=True, eq=False)
class Grid(HtmlRepr):
    """Heights or friction coefficients on a uniform grid, ``z[i, j]`` at ``(x[i], y[j])``.

    Attributes
    ----------
    x, y : ndarray, shape (n_x,) and (n_y,)
        Increasing axes with at least four nodes each, uniform to 1e-9 of their length. [m]
    z : ndarray, shape (n_x, n_y)
        Heights [m] or coefficients of friction [1], all finite.
    filled : ndarray of bool, shape (n_x, n_y), or None
        True at nodes in holes of the data, which have interpolated values.
    holes : ndarray of bool, shape (n_x, n_y), or None
        True at nodes without a value. Their numbers in ``z`` only continue the surface: a motion
        ends at cells with such a node at a corner, and routes avoid these cells.

    Raises
    ------
    DataError
        If an axis, the values or a mask do not satisfy these conditions, or a value exceeds 1e9.

    Examples
    --------
    >>> import numpy as np
    >>> from slipfree import Grid
    >>> x, y = np.linspace(0, 10, 41), np.linspace(0, 20, 81)
    >>> Grid(x, y, 0.1 * np.sin(x)[:, None] * np.cos(y))
    Grid: 41 x 81 nodes, 0.25 m by 0.25 m apart
      x: 0 to 10 m
      y: 0 to 20 m
      z: -0.0999293 to 0.099841
    """

    x: Array
    y: Array
    z: Array
    filled: Mask | None = None
    holes: Mask | None = None

    def __repr__(self) -> str:
        x_min, x_max, y_min, y_max = self.domain
        filled = "".join(
            f", {int(mask.sum())} {words}"
            for mask, words in ((self.filled, "filled"), (self.holes, "without a value"))
            if mask is not None
        )
        values = self.values
        return overview(
            f"Grid: {self.x.size} x {self.y.size} nodes{filled}, "
            f"{self.spacing[0]:.6g} m by {self.spacing[1]:.6g} m apart",
            x=(f"{x_min:.9g} to {x_max:.9g} m",),
            y=(f"{y_min:.9g} to {y_max:.9g} m",),
            z=(f"{values.min():.6g} to {values.max():.6g}",),
        )

    def __post_init__(self) -> None:
        for name in ("x", "y", "z"):
            array = getattr(self, name)
            # A read-only view: the checks below stay true for the life of the grid.
            view = array.view()
            view.flags.writeable = False
            object.__setattr__(self, name, view)
        _check_axis("x", self.x)
        _check_axis("y", self.y)
        _check_heights(self.x, self.y, self.z)
        for name, mask in (("filled", self.filled), ("holes", self.holes)):
            if mask is not None and mask.shape != self.z.shape:
                raise DataError(
                    f"grid: {name} must have the shape of z, {self.z.shape}, found {mask.shape}; "
                    "reshape it"
                )

    @property
    def domain(self) -> tuple[float, float, float, float]:
        """``x_min, x_max, y_min, y_max`` of the nodes [m]."""
        return float(self.x[0]), float(self.x[-1]), float(self.y[0]), float(self.y[-1])

    @property
    def spacing(self) -> tuple[float, float]:
        """Distances between neighbouring nodes along x and along y [m]."""
        return axis_step(self.x), axis_step(self.y)

    @property
    def values(self) -> Array:
        """Values of the nodes outside holes, shape (n,)."""
        return self.z.reshape(-1) if self.holes is None else self.z[~self.holes]

    def scaled(self, horizontal: float, vertical: float) -> Grid:
        """Return the grid with scaled coordinates and values.

        Parameters
        ----------
        horizontal : float
            Factor of ``x`` and ``y``, positive. [1]
        vertical : float
            Factor of ``z``, positive. [1]

        Returns
        -------
        Grid
            Grid with the same masks of filled nodes and of holes.
        """
        if horizontal == vertical == 1:
            return self
        x, y, z = horizontal * self.x, horizontal * self.y, vertical * self.z
        return replace(self, x=x, y=y, z=z)

    def touches(self, nodes: Mask | None, x: Array, y: Array) -> Mask:
        """Return the mask of points in cells with a marked node at a corner.

        Parameters
        ----------
        nodes : ndarray of bool, shape (n_x, n_y), or None
            Marked nodes, such as ``filled`` or ``holes``; None for no node.
        x, y : ndarray
            Map coordinates, of shapes that broadcast; points outside belong to the nearest
            cell. [m]
        """
        x, y = np.broadcast_arrays(x, y)
        if nodes is None:
            return np.zeros(x.shape, dtype=bool)
        cells = [
            np.clip((place - axis[0]) / step, 0, axis.size - 2).astype(np.intp)
            for place, axis, step in zip((x, y), (self.x, self.y), self.spacing, strict=True)
        ]
        i, j = cells
        found: Mask = np.zeros(x.shape, dtype=bool)
        for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
            found |= nodes[i + a, j + b]
        return found


def axis_step(axis: Array) -> float:
    """Return the step of a uniform axis, in its unit."""
    return float(np.ptp(axis) / (axis.size - 1))


def check_formula(function: Formula, owner: str, value: str) -> None:
    """Check that a function of two SX scalars returns one scalar expression of them.

    ``owner`` and ``value`` name the function's owner and its result in the message of the
    ModelError.
    """
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    try:
        expr = ca.SX(function(x, y))
        if expr.is_constant() and not expr.is_regular():  # as of math.sin(x)
            raise ValueError(f"the result is {expr}")
    except Exception as error:  # of the user's function
        raise ModelError(
            f"{owner}: expected a function of x and y that returns one {value}, built from "
            f"operators and CasADi functions, found that it cannot be evaluated with symbols "
            f"({type(error).__name__}: {str(error).partition(chr(10))[0][:200]}); use casadi.fmax, "
            "casadi.if_else and casadi.sin instead of max, if and math.sin"
        ) from error
    if expr.shape != (1, 1):
        raise ModelError(
            f"{owner}: function must return one {value}, found shape {expr.shape}; return a scalar"
        )
    foreign = [s for s in ca.symvar(expr) if not (ca.is_equal(s, x) or ca.is_equal(s, y))]
    if foreign:
        raise ModelError(
            f"{owner}: the {value} may depend only on x and y, found the symbols {foreign}; "
            "replace them by numbers"
        )


def _check_axis(name: str, axis: Array) -> None:
    """Raise DataError unless an axis is increasing and uniform, with at least four nodes."""
    if axis.ndim != 1:
        raise DataError(
            f"grid: axis {name} must have one dimension, found shape {axis.shape}; "
            "pass the axes, not the meshgrid"
        )
    if axis.size < 4:
        raise DataError(
            f"grid: axis {name} must have at least 4 nodes for a cubic spline, found {axis.size}; "
            "use a larger or finer grid"
        )
    if not np.isfinite(axis).all():
        node = int(np.argmin(np.isfinite(axis)))
        raise DataError(
            f"grid: axis {name} must be finite, found {name}[{node}] = {axis[node]}; correct it"
        )
    steps = np.diff(axis)
    if (steps < 0).all():
        raise DataError(
            f"grid: axis {name} must increase, found it decreasing from {axis[0]:.9g} to "
            f"{axis[-1]:.9g}; flip axis and heights together: {FLIP[name]}"
        )
    if not (steps > 0).all():
        node = int(np.argmin(steps > 0)) + 1
        raise DataError(
            f"grid: axis {name} must increase, found {name}[{node - 1}] = {axis[node - 1]:.9g} "
            f"followed by {name}[{node}] = {axis[node]:.9g}; sort axis and heights together, and "
            "remove repeated nodes"
        )
    tolerance = UNIFORMITY * (axis[-1] - axis[0])
    if np.abs(axis - np.linspace(axis[0], axis[-1], axis.size)).max() <= tolerance:
        return
    usual = float(np.median(steps))
    off = np.abs(steps - usual)
    # small errors of the steps may add up to a drift: report the largest one
    node = int(np.argmax(off > min(tolerance, 0.5 * off.max()))) + 1
    raise DataError(
        f"grid: axis {name} must be uniform to {UNIFORMITY:g} of its length, found a step of "
        f"{steps[node - 1]:.12g} m before node {node} at {name} = {axis[node]:.12g} m, where the "
        f"median step is {usual:.12g} m; resample: {RESAMPLE[name]}"
    )


def _check_heights(x: Array, y: Array, z: Array) -> None:
    """Raise DataError for heights that do not match the axes or are not all finite."""
    expected = (x.size, y.size)
    if z.shape != expected:
        hint = "rows must run along x: pass z.T" if z.shape == expected[::-1] else "reshape z"
        raise DataError(
            f"grid: z must have the shape (x.size, y.size) = {expected}, found {z.shape}; {hint}"
        )
    if np.abs(z[np.isfinite(z)]).max(initial=0.0) > MAX_HEIGHT:
        raise DataError(
            f"grid: z must lie between -{MAX_HEIGHT:g} and {MAX_HEIGHT:g}, found "
            f"{z.flat[np.nanargmax(np.abs(z))]:g}; such values usually mark holes: fill them, or "
            "crop the grid"
        )
    bad = ~np.isfinite(z)
    if bad.any():
        raise DataError(
            f"grid: all values of z must be finite, found {_nodes_text(bad, x, y, z)}; fill the "
            "gaps or cut the grid to its finite part"
        )


def _nodes_text(bad: Mask, x: Array, y: Array, z: Array) -> str:
    """Return the number of bad nodes, and the value and place of the first."""
    i, j = np.argwhere(bad)[0]
    return (
        f"{np.count_nonzero(bad)} of {z.size} that are not, the first z[{i}, {j}] = {z[i, j]:g} at "
        f"x = {x[i]:.9g} m, y = {y[j]:.9g} m"
    )


# number, function of two SX scalars in map coordinates, or map; None if not given [1]
Friction = Positive | Formula | Grid | None
REPEATED = 2  # repeated rows of nodes around a map that make it constant outside


def check_friction(mu: Friction) -> None:
    """Raise an error for an invalid coefficient of friction.

    ModelError: a number is not positive and finite, a function does not return one scalar that
    depends only on ``x`` and ``y``, or ``mu`` has another type. DataError: a map has nodes without
    a value, or values that are not positive.
    """
    if mu is None:
        return
    if isinstance(mu, Grid):
        if mu.holes is not None and mu.holes.any():
            i, j = np.argwhere(mu.holes)[0]
            raise DataError(
                f"friction: expected a coefficient at every node, found none at "
                f"{np.count_nonzero(mu.holes)} of {mu.z.size}, the first at x = {mu.x[i]:.9g} m, "
                f'y = {mu.y[j]:.9g} m; set fill = "linear" for holes inside the map, and cut off '
                "those at its border"
            )
        if not mu.values.min() > 0:
            found = _nodes_text(~(mu.z > 0), mu.x, mu.y, mu.z)
            raise DataError(
                f"friction: all coefficients must be positive, found {found}; for ice give a small "
                "number"
            )
    elif callable(mu):
        check_formula(mu, "friction", "coefficient")


class GroundFriction(HtmlRepr):
    """Friction of a ground: its coefficient ``mu``, or the surface of a map of coefficients."""

    mu: Friction

    @property
    @abstractmethod
    def origin(self) -> tuple[float, float, float]:
        """Map coordinates of the local origin [m]."""

    @property
    @abstractmethod
    def _friction_map(self) -> Terrain | None:
        """Surface of a friction map in local coordinates; None without a map."""

    @property
    def has_friction(self) -> bool:
        """Whether a coefficient of friction was given."""
        return self.mu is not None

    @property
    def friction_domain(self) -> tuple[float, float, float, float] | None:
        """``x_min, x_max, y_min, y_max`` of a friction map; None without a map [m]."""
        return self.mu.domain if isinstance(self.mu, Grid) else None

    def friction(self, x: ca.SX, y: ca.SX, lookups: LookupTable) -> ca.SX:
        """Return the coefficient of friction at a local point; 1 without a coefficient [1]."""
        mu, surface = self.mu, self._friction_map
        if isinstance(mu, float | int):
            return ca.SX(mu)
        if callable(mu):
            here = x + self.origin[0], y + self.origin[1]
            taylor = taylor_function(mu)
            if taylor is None:
                return ca.SX(mu(*here))
            values = lookups.find(taylor, ca.vertcat(*here), order=4)
            return polynomial_jet(values, TAYLOR, *here).height
        return ca.SX(1.0) if surface is None else surface.height(x, y, lookups) + surface.origin[2]


def pad_border(grid: Grid) -> Grid:
    """Return a grid with the values of its border repeated around it.

    The B-spline of the larger grid is constant across the border, in the border cells and outside.
    A point outside, which a solver may evaluate, therefore has a value in the range of the map.
    Rounding errors grow with the third power of the distance, to 1e-9 at 200 cells.
    """
    return Grid(*pad_axes(grid), np.pad(grid.z, REPEATED, mode="edge"))


def pad_axes(grid: Grid) -> tuple[Array, Array]:
    """Return the axes of a grid with the nodes of `pad_border` around it [m]."""
    x, y = (
        np.linspace(axis[0] - REPEATED * h, axis[-1] + REPEATED * h, axis.size + 2 * REPEATED)
        for axis, h in zip((grid.x, grid.y), grid.spacing, strict=True)
    )
    return x, y
