"""Smooth paths in the horizontal plane."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy

from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.lookups import evaluate
from slipfree.core.records import Array
from slipfree.system.forks import cached_property

MAX_COORDINATE = 1e12  # larger way-points are input errors [m]
NODES = 64  # nodes of the table per way-point


class PathPoint(NamedTuple):
    """A point of a path."""

    # x and y: map coordinates [m]
    x: Any
    y: Any
    heading: Any  # direction of the path, counter-clockwise from +y [rad]
    # derivative of the heading with respect to arc length, positive in left turns [1/m]
    curvature: Any


@checked
@dataclass(frozen=True, eq=False)
class Path:
    """Cubic spline through way-points, parametrised by arc length; two points give a straight line.

    Beyond its ends the path continues straight.

    Attributes
    ----------
    points : ndarray, shape (n, 2)
        Way-points in map coordinates, at least two; consecutive points must differ. [m]

    Raises
    ------
    ModelError
        If there are fewer than two points, if two consecutive points coincide, or if a coordinate
        is not finite or is 1e12 m or larger.

    Examples
    --------
    >>> import numpy as np
    >>> from slipfree import Path
    >>> Path(np.array([[0.0, 0.0], [0.2, 2.0], [0.0, 4.0]]))
    Path: 3 way-points, 4.0239 m, (0, 0) to (0, 4)
    """

    points: Array

    def __repr__(self) -> str:
        ends = (f"({x:.10g}, {y:.10g})" for x, y in self.points[[0, -1]])
        return f"Path: {len(self.points)} way-points, {self.length:.6g} m, {' to '.join(ends)}"

    def __post_init__(self) -> None:
        points = self.points
        if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 2:
            raise ModelError(
                f"path: expected at least two way-points (x, y), shape (n, 2), found shape "
                f"{points.shape}; give a pair for each way-point"
            )
        if not (np.abs(points) < MAX_COORDINATE).all():
            k = int((~(np.abs(points) < MAX_COORDINATE).all(axis=1)).argmax())
            raise ModelError(
                f"path: expected coordinates between -{MAX_COORDINATE:g} and {MAX_COORDINATE:g} m, "
                f"found {points[k]} at way-point {k + 1}; correct or remove it"
            )
        gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if not (gaps > 0).all():
            k = int(gaps.argmin())
            raise ModelError(
                f"path: way-points {k + 1} and {k + 2} coincide at {points[k]}; remove one of them"
            )

    @property
    def length(self) -> float:
        """Arc length [m]."""
        return float(self._table[0][-1])

    @cached_property
    def line(self) -> Array:
        """Points on the path, 64 between two way-points, shape (n, 2), map coordinates [m]."""
        return np.asarray(self.points[0] + self._table[1][:2].T)

    def distance(self, x: Array, y: Array) -> Array:
        """Return the distances of points to the path, which ends at its last way-point.

        Parameters
        ----------
        x, y : ndarray, shape (n,)
            The points, in map coordinates. [m]

        Returns
        -------
        ndarray, shape (n,)
            Distances. [m]
        """
        line, points = self.line, np.stack([x, y], axis=1)
        nearest = scipy.spatial.KDTree(line).query(points)[1]
        first = np.clip(nearest[:, None] + [-1, 0], 0, len(line) - 2)  # of the segments beside it
        away, along = points[:, None] - line[first], line[first + 1] - line[first]
        shares = np.clip((away * along).sum(axis=2) / (along**2).sum(axis=2), 0, 1)
        nearest = np.linalg.norm(away - shares[..., None] * along, axis=2).min(axis=1)
        return np.asarray(nearest)

    def at(self, s: Array) -> PathPoint:
        """Return the points at arc lengths.

        Parameters
        ----------
        s : ndarray, shape (n,)
            Arc lengths from the first point; beyond the ends, the path continues straight. [m]

        Returns
        -------
        PathPoint
            Map coordinates [m], headings from the y axis [rad], curvatures [1/m]; shapes (n,).
        """
        symbol, s = ca.SX.sym("s"), np.array(s, dtype=float).reshape(1, -1)
        f = ca.Function("point", [symbol], list(self.symbolic(symbol)))
        return PathPoint(*(row[0] for row in evaluate(f, s)))

    def symbolic(
        self, s: ca.SX, origin: tuple[float, float] = (0.0, 0.0), *, fade: float = 0.0
    ) -> PathPoint:
        """Return the point at an arc length as an expression.

        Parameters
        ----------
        s : SX, shape (1, 1)
            Arc length. [m]
        origin : tuple of 2 floats
            Map coordinates of the origin of ``x`` and ``y``; an origin near the path avoids loss
            of digits. [m]
        fade : float
            Distance beyond the ends over which the returned curvature decays to zero, as a law of
            steering requires that must not jump; by default it is zero there, as is that of the
            path. [m]
        """
        x_0, y_0 = self.points[0] - np.array(origin)
        if len(self.points) == 2:  # a straight line needs no table
            x, y = self.points[1] - self.points[0]
            heading = ca.SX(np.arctan2(-x, y))
            return PathPoint(
                x_0 - s * ca.sin(heading), y_0 + s * ca.cos(heading), heading, ca.SX(0)
            )
        inside = ca.fmin(ca.fmax(s, 0), self.length)
        x, y, heading, curvature = ca.vertsplit(self._spline(inside))
        beyond = s - inside
        on_path = curvature * (ca.fmax(1 - ca.fabs(beyond) / fade, 0) if fade else beyond == 0)
        return PathPoint(
            x_0 + x - beyond * ca.sin(heading), y_0 + y + beyond * ca.cos(heading), heading, on_path
        )

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        """Arc lengths, shape (n,), and x, y, heading and curvature there, shape (4, n).

        x and y are relative to the first way-point.
        """
        chord = arc_lengths(self.points)
        spline = partial(cubic_spline, chord, self.points - self.points[0])
        fine = np.linspace(0, chord[-1], NODES * len(chord) * 4 + 1)
        speed = np.linalg.norm(spline(fine, 1), axis=1)
        middle = np.linalg.norm(spline((fine[1:] + fine[:-1]) / 2, 1), axis=1)
        steps = np.diff(fine) * (speed[1:] + speed[:-1] + 4 * middle) / 6  # Simpson
        s, u = np.append(0, np.cumsum(steps))[::4], fine[::4]
        (x, y), (x_u, y_u), (x_uu, y_uu) = (spline(u, k).T for k in range(3))
        heading = np.unwrap(np.arctan2(-x_u, y_u))
        curvature = (x_u * y_uu - y_u * x_uu) / np.hypot(x_u, y_u) ** 3
        return s, np.stack([x, y, heading, curvature])

    @cached_property
    def _spline(self) -> ca.Function:
        s, rows = self._table
        return spline_function("path", s, rows.T)


def arc_lengths(points: Array) -> Array:
    """Return the length of a polyline (n, 2) up to each of its points, shape (n,) [m]."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def cubic_spline(at: Array, values: Array, places: Array, order: int = 0) -> Array:
    """Return the cubic spline through values (n, m), or a derivative of it, at places (k,).

    The shape is (k, m). The spline is that of `spline_function`; through two or three values, its
    second derivatives are zero at the ends.
    """
    if at.size == 2:
        at, values = np.linspace(at[0], at[1], 4), np.linspace(values[0], values[1], 4)
    if at.size == 3:  # with its values at the middles, it is also the spline through five values
        h = np.diff(at)[:, None]
        bend = 3 * np.diff(np.diff(values, axis=0) / h, axis=0) / h.sum()
        middle = (values[1:] + values[:-1]) / 2 - bend * h**2 / 16
        values = np.insert(values, [1, 2], middle, axis=0)
        at = np.insert(at, [1, 2], (at[1:] + at[:-1]) / 2)
    inside = np.clip(places, at[0], at[-1])[None]  # CasADi's splines are zero outside
    return evaluate(spline_function("spline", at, values, order=order), inside)[0].T


def spline_function(
    name: str, at: Array, values: Array, degree: int = 3, *, order: int = 0
) -> ca.Function:
    """Return the spline of odd degree through values (n, m), or a derivative of it, as a function.

    There are more places ``at`` than the degree, increasing; the spline is a single polynomial on
    the first and on the last (degree + 1) / 2 intervals. It is zero outside. The function is not
    inlined, since SX graphs cannot contain it.
    """
    place, options = ca.MX.sym("place"), {"degree": [degree]}
    table = ca.interpolant(name, "bspline", [at.tolist()], values.ravel().tolist(), options)
    result = table(place)
    for _ in range(order):
        result = ca.jacobian(result, place)
    return ca.Function(name, [place], [result], {"never_inline": True})
