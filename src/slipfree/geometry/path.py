"""Smooth paths in the horizontal plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.system.forks import cached_property

MAX_COORDINATE = 1e12  # larger way-points are input errors [m]
NODES = 64  # nodes of the arc-length table per way-point


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
        symbol = ca.SX.sym("s")
        f = ca.Function("point", [symbol], list(self.symbolic(symbol)))
        return PathPoint(
            *(np.array(row).ravel() for row in f.map(np.size(s))(np.reshape(s, (1, -1))))
        )

    def symbolic(self, s: ca.SX, origin: tuple[float, float] = (0.0, 0.0)) -> PathPoint:
        """Return the point at an arc length as an expression.

        Parameters
        ----------
        s : SX, shape (1, 1)
            Arc length. [m]
        origin : tuple of 2 floats
            Map coordinates of the origin of ``x`` and ``y``; an origin near the path avoids loss
            of digits. [m]
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
        on_path = ca.if_else(ca.fabs(beyond) > 0, 0, curvature)
        return PathPoint(
            x_0 + x - beyond * ca.sin(heading), y_0 + y + beyond * ca.cos(heading), heading, on_path
        )

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        """Arc lengths, shape (n,), and x, y, heading and curvature there, shape (4, n).

        Arc lengths are equally spaced; x and y are relative to the first way-point.
        """
        from scipy.interpolate import CubicSpline  # imported here, since the import takes 0.2 s

        chord = np.concatenate(
            [[0], np.cumsum(np.linalg.norm(np.diff(self.points, axis=0), axis=1))]
        )
        local = self.points - self.points[0]
        spline = CubicSpline(chord, local, bc_type="not-a-knot" if len(chord) > 3 else "natural")
        fine = np.linspace(0, chord[-1], NODES * len(chord) * 4 + 1)
        speed = np.linalg.norm(spline(fine, 1), axis=1)
        middle = np.linalg.norm(spline((fine[1:] + fine[:-1]) / 2, 1), axis=1)
        steps = np.diff(fine) * (speed[1:] + speed[:-1] + 4 * middle) / 6  # Simpson
        length = np.concatenate([[0], np.cumsum(steps)])
        s = np.linspace(0, length[-1], NODES * len(chord) + 1)
        u = CubicSpline(length, fine)(s)
        (x, y), (x_u, y_u), (x_uu, y_uu) = (spline(u, k).T for k in range(3))
        heading = np.unwrap(np.arctan2(-x_u, y_u))
        curvature = (x_u * y_uu - y_u * x_uu) / np.hypot(x_u, y_u) ** 3
        return s, np.stack([x, y, heading, curvature])

    @cached_property
    def _spline(self) -> ca.Function:
        s, rows = self._table
        table = ca.interpolant("path", "bspline", [s.tolist()], rows.ravel(order="F"))
        at = ca.MX.sym("s")
        return ca.Function("path", [at], [table(at)], {"never_inline": True})


def spline_function(name: str, spline: Any) -> ca.Function:
    """Return a SciPy B-spline with vector values as a function of its argument.

    It is not inlined, since SX graphs cannot contain it.
    """
    at, count = ca.MX.sym("t"), spline.t.size - spline.k - 1  # further coefficients are padding
    weights = spline.c[:count].ravel().tolist()
    value = ca.Function.bspline(name, [spline.t.tolist()], weights, [spline.k], spline.c.shape[1])
    return ca.Function(f"{name}_at", [at], [value(at)], {"never_inline": True})
