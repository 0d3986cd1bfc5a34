"""Regions of a map: discs and polygons."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.core.schema import Finite, Positive
from slipfree.system.forks import cached_property

TIP_ROUNDING = 1e-3  # rounding of the distance at the centre of a disc, in radii
CORNER_ROUNDING = 1e-12  # rounding of the distance at a corner of a polygon, relative to its size
MIN_TURN_SINE = 1e-9  # a point with a smaller sine of its turn is not a corner
OUTLINE_POINTS = 96  # points on the outline of a disc


class Region(ABC):
    """A region of a map, in map coordinates: keep-out, or of another soil.

    Models use coordinates relative to ``ground.origin`` instead
    (:ref:`local-and-map-coordinates`).

    Examples
    --------
    >>> from slipfree import Region
    >>> crater = Region.disc(10.0, 5.0, radius=2.0)
    >>> fence = Region.polygon([(0, 0), (4, 0), (4, 1)])
    >>> crater.distance([10.0, 10.0], [5.0, 8.0]).tolist()
    [-2.0, 1.0]
    """

    @staticmethod
    def disc(x: float, y: float, radius: float) -> Region:
        """Return a region in the shape of a disc.

        Parameters
        ----------
        x, y : float
            Centre in map coordinates. [m]
        radius : float
            Radius. [m]

        Raises
        ------
        ModelError
            If the centre is not finite, or the radius is not positive and finite.
        """
        return _Disc(x, y, radius)

    @staticmethod
    def polygon(points: Sequence[Sequence[float]]) -> Region:
        """Return a region in the shape of a simple polygon.

        Parameters
        ----------
        points : sequence of (x, y)
            At least three points in map coordinates, clockwise or counter-clockwise; an edge
            connects the last point to the first. The polygon may be concave. [m]

        Raises
        ------
        ModelError
            If there are fewer than three points, if points are not finite or coincide, or if edges
            cross, touch or fold back.
        """
        return _Polygon(tuple((x, y) for x, y in points))

    def __repr__(self) -> str:
        return f"Region: {self.words}"

    @property
    @abstractmethod
    def words(self) -> str:
        """Shape and position, for messages."""

    @property
    @abstractmethod
    def bounds(self) -> tuple[float, float, float, float]:
        """``x_min, x_max, y_min, y_max`` in map coordinates [m]."""

    @property
    @abstractmethod
    def outline(self) -> Array:
        """Points of the border in order, shape (n, 2), map coordinates [m]."""

    @abstractmethod
    def outside(self, x: ca.SX, y: ca.SX) -> ca.SX:
        """Return the signed distance of a point from the region, negative inside [m].

        Parameters
        ----------
        x, y : SX, shape (1, 1)
            Map coordinates. [m]
        """

    @abstractmethod
    def distance(self, x: Array, y: Array) -> Array:
        """Return the signed distances of points to the border.

        Parameters
        ----------
        x, y : ndarray, broadcastable shapes
            The points, in map coordinates. [m]

        Returns
        -------
        ndarray, of the common shape
            Distances, negative inside the region. [m]
        """


@checked
@dataclass(frozen=True, repr=False)
class _Disc(Region):
    """Disc with a centre ``(x, y)`` and a radius, in map coordinates [m]."""

    x: Finite
    y: Finite
    radius: Positive

    @property
    def words(self) -> str:
        return f"disc at ({self.x:.10g}, {self.y:.10g}) of {self.radius:.4g} m radius"

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        return (
            self.x - self.radius,
            self.x + self.radius,
            self.y - self.radius,
            self.y + self.radius,
        )

    @property
    def outline(self) -> Array:
        turn = np.linspace(0, 2 * np.pi, OUTLINE_POINTS, endpoint=False)
        circle = np.array([np.cos(turn), np.sin(turn)]).T
        return np.array([self.x, self.y]) + self.radius * circle

    def outside(self, x: ca.SX, y: ca.SX) -> ca.SX:
        """Return the signed distance of a point from the region, negative inside [m].

        It is smoothed near the centre, so that it has derivatives there, and exact on the circle;
        outside the circle it deviates by at most 5e-7 radii.
        """
        soft = (TIP_ROUNDING * self.radius) ** 2
        from_center = ca.sqrt((x - self.x) ** 2 + (y - self.y) ** 2 + soft)
        return ca.SX(from_center - math.sqrt(self.radius**2 + soft))

    def distance(self, x: Array, y: Array) -> Array:
        """Return distances from the circle, negative inside [m]."""
        distance: Array = np.hypot(np.subtract(x, self.x), np.subtract(y, self.y)) - self.radius
        return distance


@checked
@dataclass(frozen=True, repr=False)
class _Polygon(Region):
    """Interior of a simple polygon with ``points`` in map coordinates [m]."""

    points: tuple[tuple[Finite, Finite], ...]

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=float)
        if len(points) < 3:
            raise ModelError(
                f"polygon: expected at least three points (x, y), found {len(points)}; give one "
                "pair for each corner"
            )
        _check_simple(points - points[0])

    @property
    def words(self) -> str:
        x, y = np.mean(self.points, axis=0)
        return f"polygon of {len(self.points)} points about ({x:.10g}, {y:.10g})"

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        (x_min, y_min), (x_max, y_max) = np.min(self.points, axis=0), np.max(self.points, axis=0)
        return float(x_min), float(x_max), float(y_min), float(y_max)

    @property
    def outline(self) -> Array:
        return np.array(self.points)

    def outside(self, x: ca.SX, y: ca.SX) -> ca.SX:
        """Return the signed distance of a point from the region, negative inside [m].

        It is smooth across the edges, where its gradient is the normal of the edge; it has kinks
        only where two parts of the border are equally near.

        The nearest part of the border determines the sign: for an edge, the side of the edge; for a
        corner, whether the corner is convex. There is no square root of a distance that vanishes on
        an edge, so that derivatives are exact there.
        """
        corners, tips = self._corners
        x, y = x - self.points[0][0], y - self.points[0][1]
        soft = (CORNER_ROUNDING * float(np.ptp(corners, axis=0).max())) ** 2
        nearest, signed = ca.SX(math.inf), ca.SX(math.inf)
        ends, end_tips = np.roll(corners, -1, axis=0), np.roll(tips, -1)
        for (a_x, a_y), (b_x, b_y), tip_a, tip_b in zip(corners, ends, tips, end_tips, strict=True):
            length = math.hypot(b_x - a_x, b_y - a_y)
            e_x, e_y = (b_x - a_x) / length, (b_y - a_y) / length
            along = (x - a_x) * e_x + (y - a_y) * e_y
            across = (x - a_x) * e_y - (y - a_y) * e_x  # to the right, which is outside
            to_a = tip_a * ca.sqrt((x - a_x) ** 2 + (y - a_y) ** 2 + soft)
            to_b = tip_b * ca.sqrt((x - b_x) ** 2 + (y - b_y) ** 2 + soft)
            here = ca.if_else(along < 0, to_a, ca.if_else(along > length, to_b, across))
            signed = ca.if_else(ca.fabs(here) < nearest, here, signed)
            nearest = ca.fmin(nearest, ca.fabs(here))
        return signed

    def distance(self, x: Array, y: Array) -> Array:
        """Return distances from the polygon, negative inside [m]."""
        x_0, y_0 = self.points[0]
        x, y = np.broadcast_arrays(np.subtract(x, x_0), np.subtract(y, y_0))
        corners = self._corners[0]
        square, inside = np.full(x.shape, np.inf), np.zeros(x.shape, dtype=bool)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            e = b - a
            along = np.clip(((x - a[0]) * e[0] + (y - a[1]) * e[1]) / (e @ e), 0, 1)
            d_x, d_y = x - a[0] - along * e[0], y - a[1] - along * e[1]
            np.minimum(square, d_x**2 + d_y**2, out=square)
            if a[1] != b[1]:  # a ray to the right crosses the edge at most once
                crosses = (a[1] > y) != (b[1] > y)
                inside ^= crosses & (x < a[0] + (y - a[1]) * (e[0] / e[1]))
        signed: Array = np.where(inside, -1.0, 1.0) * np.sqrt(square)
        return signed

    @cached_property
    def _corners(self) -> tuple[Array, Array]:
        """Corners in counter-clockwise order, and the signs of their turns.

        Corners (n, 2) are relative to the first point [m], without points on straight edges; the
        sign is 1 for a convex corner, -1 for a concave one.
        """
        local = np.asarray(self.points, dtype=float) - self.points[0]
        turns = _turns(local)
        # omit points on straight edges: rounding would decide their sign
        corner = np.abs(turns) > MIN_TURN_SINE
        local, turns = local[corner], turns[corner]
        if _products(local).sum() < 0:
            local, turns = local[::-1], -turns[::-1]
        return local, np.sign(turns)


def _turns(points: Array) -> Array:
    """Return the sine of the turning angle at every point, positive for a left turn."""
    e = points - np.roll(points, 1, axis=0)
    return _products(e / np.linalg.norm(e, axis=1, keepdims=True))


def _products(vectors: Array) -> Array:
    """Return the cross product of each vector and the next one: of corners, twice the area."""
    after = np.roll(vectors, -1, axis=0)
    return np.asarray(vectors[:, 0] * after[:, 1] - vectors[:, 1] * after[:, 0])


def _check_simple(points: Array) -> None:
    """Raise ModelError if edges of a polygon coincide, fold back or meet each other."""
    count = len(points)
    edges = np.roll(points, -1, axis=0) - points
    for k in range(count):
        if not edges[k].any():
            raise ModelError(
                f"polygon: points {k + 1} and {(k + 1) % count + 1} coincide; remove one (the last "
                "point is connected to the first automatically)"
            )
    before = np.roll(edges, 1, axis=0)
    folded = (np.abs(_turns(points)) <= MIN_TURN_SINE) & (np.sum(edges * before, axis=1) < 0)
    if folded.any():
        raise ModelError(
            f"polygon: the edges at point {int(folded.argmax()) + 1} fold back onto each other; "
            "remove this point"
        )
    for first in range(count - 2):
        for second in range(first + 2, count - (first == 0)):
            a, b = points[first], points[(first + 1) % count]
            c, d = points[second], points[(second + 1) % count]
            is_apart = np.maximum(a, b) < np.minimum(c, d), np.maximum(c, d) < np.minimum(a, b)
            if np.any(is_apart):
                continue
            if _side(a, b, c) * _side(a, b, d) <= 0 and _side(c, d, a) * _side(c, d, b) <= 0:
                raise ModelError(
                    f"polygon: edge {_edge(first, count)} crosses or touches edge "
                    f"{_edge(second, count)}; give the points in order along a border that does "
                    "not meet itself"
                )


def _edge(k: int, count: int) -> str:
    return f"{k + 1}-{(k + 1) % count + 1}"


def _side(a: Array, b: Array, p: Array) -> float:
    """Return 1 for a point left of the line from ``a`` to ``b``, -1 right of it, 0 on it."""
    e, f = b - a, p - a
    return float(np.sign(e[0] * f[1] - e[1] * f[0]))
