"""Convex solids with vertical faces: profiles in a plane, and prisms on a ground.

In a profile, x is forward and z up. The distance of a point from a convex solid is continuously
differentiable, also around its corners. Therefore a wheel has one contact with each solid, and the
same equations hold on a floor, on a floor and against a wall together, and over an edge.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated

import casadi as ca
import numpy as np
import numpy.typing as npt
from annotated_types import Ge, Gt, Le, Unit

from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.lookups import evaluate
from slipfree.core.records import Array
from slipfree.core.schema import Finite, Length
from slipfree.system.forks import cached_property
from slipfree.terrain.base import Terrain

Point = tuple[float, float]
FLOOR_LENGTH = 100.0  # length of the floor and of plateaus [m]
ROOT_DEPTH = 0.5  # depth of solids below the floor, which hides their lower corners [m]
HEIGHT_TOLERANCE = 1e-4  # smaller height differences and gaps between solids count as zero [m]
MAX_COORDINATE = 1e4  # largest coordinate of a corner [m]
MIN_TURN_SINE = 1e-9  # a point with a smaller sine of its turn is not a corner
ROOT_OFFSET = 1e-24  # keeps the derivative of a square root finite [m2]


@dataclass(frozen=True)
class Solid:
    """A convex polygon.

    Attributes
    ----------
    points : tuple of (x, z), three or more
        Corners, clockwise or counter-clockwise; stored counter-clockwise. [m]

    Raises
    ------
    ModelError
        If there are fewer than three points, if they are not finite, or if they do not bound
        a convex polygon.
    """

    points: tuple[Point, ...]

    def __post_init__(self) -> None:
        points = np.asarray(self.points, dtype=float)
        if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 3:
            raise ModelError(
                f"solid: expected three or more points (x, z), found shape {points.shape}; "
                "give one pair for each corner"
            )
        if not (np.abs(points) <= MAX_COORDINATE).all():
            raise ModelError(
                f"solid: expected coordinates from {-MAX_COORDINATE:g} to {MAX_COORDINATE:g} m, "
                f"found points {points.tolist()}; give them in metres"
            )
        stored = tuple((float(x), float(z)) for x, z in _counter_clockwise(points))
        object.__setattr__(self, "points", stored)

    @cached_property
    def edges(self) -> Array:
        """Unit vectors along the faces, shape (n, 2); face i begins at point i."""
        points = np.array(self.points)
        edges = np.roll(points, -1, axis=0) - points
        return np.asarray(edges / np.linalg.norm(edges, axis=1, keepdims=True))

    @cached_property
    def normals(self) -> Array:
        """Outward unit normals of the faces, shape (n, 2)."""
        return np.stack([self.edges[:, 1], -self.edges[:, 0]], axis=1)

    def meets(self, other: Solid) -> bool:
        """Return whether the solid touches another one, so that no face of either separates them.

        Parameters
        ----------
        other : Solid
            Another convex solid, in the same coordinates along x and z.

        Returns
        -------
        bool
            True also for solids that touch within the rounding of their corners.
        """
        for one, two in ((self, other), (other, self)):
            heights = (np.array(two.points) @ one.normals.T).min(axis=0)
            own = (np.array(one.points) * one.normals).sum(axis=1)
            if (heights > own + HEIGHT_TOLERANCE).any():
                return False
        return True

    def gap(self, x: ca.SX, z: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the distance of a point from the solid, negative inside, and its gradient.

        The distance is the largest of the distances from the lines of the faces and, within their
        normal cones, from the corners: each is a lower bound, attained by the nearest feature.

        Parameters
        ----------
        x, z : SX
            The point. [m]

        Returns
        -------
        distance : SX, shape (1, 1)
            Distance, continuously differentiable outside the solid. [m]
        normal : SX, shape (2, 1)
            Outward unit vector.
        """
        distance, normal, _ = self.nearest(x, z)
        return distance, normal

    def nearest(self, x: ca.SX, z: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return the results of `gap`, and whether the nearest feature is a corner.

        Parameters
        ----------
        x, z : SX
            The point. [m]

        Returns
        -------
        distance : SX, shape (1, 1)
            Distance, negative inside. [m]
        normal : SX, shape (2, 1)
            Outward unit vector.
        is_corner : SX, shape (1, 1)
            One if the nearest feature is a corner, zero if it is a face.
        """
        place = ca.vertcat(x, z)
        distance, normal, is_corner = ca.SX(-np.inf), ca.SX.zeros(2), ca.SX(0)
        for point, outward in zip(self.points, self.normals, strict=True):
            face = ca.dot(place - ca.DM(point), ca.DM(outward))
            normal = ca.if_else(face > distance, ca.DM(outward), normal)
            distance = ca.fmax(face, distance)
        for k, point in enumerate(self.points):
            from_corner = place - ca.DM(point)
            past = ca.dot(from_corner, ca.DM(self.edges[k - 1])) > 0
            before = ca.dot(from_corner, ca.DM(self.edges[k])) < 0
            away = ca.sqrt(ca.sumsqr(from_corner) + ROOT_OFFSET)
            in_cone = ca.logic_and(past, before)
            distance = ca.if_else(in_cone, away, distance)
            normal = ca.if_else(in_cone, from_corner / away, normal)
            is_corner = ca.logic_or(is_corner, in_cone)
        return distance, normal, is_corner

    def distance(self, x: npt.ArrayLike, z: npt.ArrayLike) -> tuple[Array, Array]:
        """Return the distances and normals of `gap` for arrays of points.

        Parameters
        ----------
        x, z : array_like, shape (...)
            Points. [m]

        Returns
        -------
        distance : ndarray, shape (...)
            Distances, negative inside. [m]
        normal : ndarray, shape (..., 2)
            Outward unit vectors.
        """
        points = np.stack(np.broadcast_arrays(np.asarray(x, float), np.asarray(z, float)), axis=-1)
        return _gaps(lambda place: self.gap(place[0], place[1]), points)


def _gaps(gap: Callable[[ca.SX], tuple[ca.SX, ca.SX]], points: Array) -> tuple[Array, Array]:
    """Return distances, shape (...), and normals, shape (..., n), at points, shape (..., n)."""
    place = ca.SX.sym("place", points.shape[-1])
    function = ca.Function("gap", [place], [ca.densify(each) for each in gap(place)])
    distance, normal = evaluate(function, points.reshape(-1, points.shape[-1]).T)
    return distance.reshape(points.shape[:-1]), normal.T.reshape(points.shape)


@dataclass(frozen=True)
class Profile:
    """A union of convex solids; the first one is the ground below the others.

    Attributes
    ----------
    solids : tuple of Solid
        The floor, and the obstacles, which may overlap it and each other.

    Raises
    ------
    ModelError
        If there is no solid.
    """

    solids: tuple[Solid, ...]

    def __post_init__(self) -> None:
        if not self.solids:
            raise ModelError(
                "profile: expected one solid or more, found none; give at least a floor, as in "
                "Profile((Solid(points),))"
            )

    @property
    def summit(self) -> Point:
        """Highest point of the solids that stand on the floor, the first if several, (x, z) [m]."""
        points = [point for solid in self.standing for point in solid.points]
        top = max(z for _, z in points)
        return min(x for x, z in points if z > top - HEIGHT_TOLERANCE), top

    @property
    def end(self) -> float:
        """Largest x of the solids that stand on the floor; infinite without such solids [m]."""
        floor = max(z for _, z in self.solids[0].points)
        above = [x for solid in self.standing[1:] for x, z in solid.points if z > floor]
        return max(above, default=math.inf)

    @cached_property
    def standing(self) -> tuple[Solid, ...]:
        """The floor, and the solids connected to it by contacts."""
        found, rest = [self.solids[0]], list(self.solids[1:])
        for solid in found:
            near = [other for other in rest if solid.meets(other)]
            rest = [other for other in rest if other not in near]
            found += near
        return tuple(found)


@checked
@dataclass(frozen=True)
class Prism:
    """A convex polygon in a vertical plane, extruded horizontally to both sides.

    Attributes
    ----------
    section : Solid
        The polygon; its first coordinate is along ``heading``, its second upward. [m]
    x, y, z : float
        Position of the polygon's origin in map coordinates. [m]
    heading : float
        Direction of the polygon's first coordinate, counter-clockwise from the y axis. [rad]
    half_width : float
        Half the width, on both sides of the polygon; infinite by default. [m]

    Raises
    ------
    ModelError
        If a number is not finite, or the half-width is not positive.
    """

    section: Solid
    x: Finite = 0.0
    y: Finite = 0.0
    z: Finite = 0.0
    heading: Finite = 0.0
    half_width: Annotated[float, Gt(0)] = math.inf

    @property
    def axes(self) -> Array:
        """Unit vectors along the heading, to the right and upward: columns, shape (3, 3)."""
        s, c = math.sin(self.heading), math.cos(self.heading)
        return np.array([[-s, c, 0.0], [c, s, 0.0], [0.0, 0.0, 1.0]])

    def gap(self, place: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the distance of a point from the prism, negative inside, and its gradient.

        Parameters
        ----------
        place : SX, shape (3, 1)
            The point, in map coordinates. [m]

        Returns
        -------
        distance : SX, shape (1, 1)
            Distance, continuously differentiable outside the prism. [m]
        normal : SX, shape (3, 1)
            Outward unit vector.
        """
        distance, normal, _ = self.expansion(place, ca.SX.zeros(3, 2))
        return distance, normal

    def expansion(self, place: ca.SX, plane: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return the results of `gap`, and the Hessian of half the squared distance in a plane.

        Outside the prism, half the squared distance is a convex, piecewise quadratic function.

        Parameters
        ----------
        place : SX, shape (3, 1)
            The point, in map coordinates. [m]
        plane : SX, shape (3, 2)
            Perpendicular unit vectors in the plane.

        Returns
        -------
        distance : SX, shape (1, 1)
            Distance. [m]
        normal : SX, shape (3, 1)
            Outward unit vector.
        hessian : SX, shape (2, 2)
            Second derivatives of half the squared distance along these vectors. [1]
        """
        axes = ca.DM(self.axes)
        along, right, up = ca.vertsplit(axes.T @ (place - ca.DM([self.x, self.y, self.z])))
        distance, normal, is_corner = self.section.nearest(along, up)
        rows = axes.T @ plane
        within, sideways = rows[[0, 2], :], rows[1, :]
        slope = normal.T @ within
        hessian = ca.if_else(is_corner, within.T @ within, slope.T @ slope)
        outward = ca.vertcat(normal[0], 0, normal[1])
        if not math.isfinite(self.half_width):
            return distance, axes @ outward, hessian
        beyond = ca.fabs(right) - self.half_width
        aside = ca.vertcat(0, ca.if_else(right < 0, -1, 1), 0)
        edge = ca.sqrt(distance**2 + beyond**2 + ROOT_OFFSET)
        at_edge = ca.logic_and(distance > 0, beyond > 0)
        at_side = beyond > distance
        slanted = (distance * outward + beyond * aside) / edge
        of_side = ca.logic_or(at_edge, at_side) * (sideways.T @ sideways)
        of_section = ca.if_else(ca.logic_or(at_edge, ca.logic_not(at_side)), hessian, 0)
        return (
            ca.if_else(at_edge, edge, ca.fmax(distance, beyond)),
            axes @ ca.if_else(at_edge, slanted, ca.if_else(at_side, aside, outward)),
            of_section + of_side,
        )

    def distance(self, points: Array) -> tuple[Array, Array]:
        """Return the distances and normals of `gap` for an array of points.

        Parameters
        ----------
        points : ndarray, shape (..., 3)
            Points in map coordinates. [m]

        Returns
        -------
        distance : ndarray, shape (...)
            Distances, negative inside. [m]
        normal : ndarray, shape (..., 3)
            Outward unit vectors.
        """
        return _gaps(self.gap, points)

    def top(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Return the heights of the top of the prism at map points; minus infinity beside it [m].

        ``x`` and ``y`` are broadcast; the result has their common shape.
        """
        x, y = np.broadcast_arrays(np.asarray(x, float) - self.x, np.asarray(y, float) - self.y)
        along, right = (axis[0] * x + axis[1] * y for axis in self.axes.T[:2])
        corners, normals = np.array(self.section.points), self.section.normals
        height = np.full(x.shape, np.inf)
        for corner, normal in zip(corners, normals, strict=True):
            if normal[1] > MIN_TURN_SINE:  # an upper face
                face = corner[1] - normal[0] / normal[1] * (along - corner[0])
                height = np.minimum(height, face)
        inside = (along >= corners[:, 0].min()) & (along <= corners[:, 0].max())
        inside &= np.abs(right) <= self.half_width
        return np.where(inside, self.z + height, -np.inf)


def placed(
    profile: Profile,
    *,
    x: float = 0.0,
    y: float = 0.0,
    z: float = 0.0,
    heading: float = 0.0,
    half_width: float = math.inf,
) -> tuple[Prism, ...]:
    """Return the solids of a profile, without its floor, as prisms on a ground.

    The profile's origin is at the map point (x, y, z) [m], and its x axis has the given heading,
    counter-clockwise from the map's y axis [rad]. The prisms extend ``half_width`` to both sides of
    the profile [m].

    Examples
    --------
    A step of 90 mm, one metre ahead of the map's origin.

    >>> from slipfree import Analytic, Solids
    >>> from slipfree.terrain.solids import placed, step
    >>> ground = Solids(Analytic(lambda x, y: 0 * x, mu=0.8), placed(step(0.09), y=1.0))
    """
    return tuple(Prism(each, x, y, z, heading, half_width) for each in profile.solids[1:])


def section_of(prisms: Sequence[Prism], floor: float = 0.0) -> Profile:
    """Return the section of solids in the plane x = 0 of the map, in which planar vehicles move.

    Parameters
    ----------
    prisms : sequence of Prism
        The solids.
    floor : float
        Height of the level ground below them. [m]

    Returns
    -------
    Profile
        Its x is the map's y; its first solid is the ground.

    Raises
    ------
    ModelError
        If a solid does not cross the plane at right angles.
    """
    end = FLOOR_LENGTH + min((each.y for each in prisms), default=0.0)  # not beyond plateaus
    low, high = (-FLOOR_LENGTH, floor - ROOT_DEPTH), (end, floor)
    solids = [Solid((low, (end, low[1]), high, (low[0], floor)))]
    for prism in prisms:
        forward, right, _ = prism.axes.T
        if abs(forward[1] - 1) > MIN_TURN_SINE or abs(right[0] * prism.x) > prism.half_width:
            raise ModelError(
                "solids: expected solids across the plane x = 0, in which the vehicle moves, with "
                f"the heading of y, found one at x = {prism.x:g} m, heading {prism.heading:g} rad "
                "from y; turn or move it"
            )
        points = tuple((x + prism.y, z + prism.z) for x, z in prism.section.points)
        solids.append(Solid(points))
    return Profile(tuple(solids))


@checked
@dataclass(frozen=True)
class Solids:
    """A ground with convex solids on it, for `slipfree.dynamics`.

    Every wheel may touch the base and each solid at the same time. Only wheels touch: the model has
    no contacts of the vehicle's body.

    Attributes
    ----------
    base : Terrain
        Ground under the solids. Its friction is that of the solids as well.
    prisms : tuple of Prism
        The solids; they may overlap the base and each other.
    """

    base: Terrain
    prisms: tuple[Prism, ...]

    def elevation(self, x: npt.ArrayLike, y: npt.ArrayLike) -> Array:
        """Return the heights of the highest surface, of the ground or of a solid, at points.

        Parameters
        ----------
        x, y : ndarray, broadcastable shapes
            The points, in map coordinates. [m]

        Returns
        -------
        ndarray, of the common shape
            Heights in map coordinates. [m]
        """
        x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        tops = (each.top(x, y) for each in self.prisms)
        return np.asarray(np.maximum.reduce([self.base.elevation(x, y), *tops]))


def flat() -> Profile:
    """Return a level floor at height zero."""
    return Profile((_block(-FLOOR_LENGTH, 0.0, FLOOR_LENGTH),))


@checked
def ramp(angle: Annotated[float, Gt(0), Le(math.pi / 2), Unit("rad")], height: Length) -> Profile:
    """Return a floor with a ramp to a plateau, from x = 0 on.

    Parameters
    ----------
    angle : float
        Angle of the ramp, above zero and at most a right angle. [rad]
    height : float
        Height of the plateau. [m]

    Raises
    ------
    ModelError
        If the angle or the height is out of range.
    """
    slope = math.cos(angle) / math.sin(angle)
    if ROOT_DEPTH * slope > FLOOR_LENGTH / 2 or height * slope > FLOOR_LENGTH / 2:
        least = math.degrees(math.atan(2 * max(height, ROOT_DEPTH) / FLOOR_LENGTH))
        raise ModelError(
            f"ramp: expected an angle of at least {least:.3g} degrees for a height of {height:g} "
            f"m, found {math.degrees(angle):.3g} degrees; use a steeper or a lower ramp"
        )
    edge = height * slope
    wedge = Solid(
        (
            (-ROOT_DEPTH * slope, -ROOT_DEPTH),
            (FLOOR_LENGTH, -ROOT_DEPTH),
            (FLOOR_LENGTH, height),
            (edge, height),
        )
    )
    return Profile((*flat().solids, wedge))


@checked
def step(height: Length) -> Profile:
    """Return a floor with a step to a plateau, at x = 0.

    Parameters
    ----------
    height : float
        Height of the plateau. [m]

    Raises
    ------
    ModelError
        If the height is not positive and finite.
    """
    return Profile((*flat().solids, _block(0.0, height, FLOOR_LENGTH)))


@checked
def kerb(height: Length, length: Length) -> Profile:
    """Return a floor with a block from x = 0 on.

    Parameters
    ----------
    height : float
        Height of the block. [m]
    length : float
        Length of the block along x. [m]

    Raises
    ------
    ModelError
        If the height or the length is not positive and finite.
    """
    return Profile((*flat().solids, _block(0.0, height, length)))


@checked
def stairs(height: Length, depth: Length, count: Annotated[int, Ge(1), Le(1000)]) -> Profile:
    """Return a floor with stairs from x = 0 on; the last step is a plateau.

    Parameters
    ----------
    height : float
        Height of a step. [m]
    depth : float
        Depth of a step along x. [m]
    count : int
        Number of steps.

    Raises
    ------
    ModelError
        If a number is not positive.
    """
    blocks = (_block(k * depth, (k + 1) * height, FLOOR_LENGTH) for k in range(count))
    return Profile((*flat().solids, *blocks))


def _block(start: float, height: float, length: float) -> Solid:
    end = start + length if length < FLOOR_LENGTH else FLOOR_LENGTH
    return Solid(((start, -ROOT_DEPTH), (end, -ROOT_DEPTH), (end, height), (start, height)))


def _counter_clockwise(points: Array) -> Sequence[Array]:
    """Return the corners counter-clockwise; raise ModelError unless the polygon is convex."""
    edges = np.roll(points, -1, axis=0) - points
    lengths = np.linalg.norm(edges, axis=1)
    if not (lengths > 0).all():
        k = int(np.argmin(lengths))
        raise ModelError(
            f"solid: points {k} and {(k + 1) % len(points)} coincide at {points[k]}; remove one"
        )
    before, after = np.roll(edges / lengths[:, None], 1, axis=0), edges / lengths[:, None]
    sines = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    cosines = (before * after).sum(axis=1)
    if (np.abs(sines) < MIN_TURN_SINE).any():
        k = int(np.argmin(np.abs(sines)))
        raise ModelError(f"solid: point {k}, {points[k]}, is not a corner; remove it")
    turns = np.arctan2(sines, cosines)
    sign = 1.0 if turns.sum() > 0 else -1.0
    if (sign * turns < 0).any():
        k = int(np.argmin(sign * turns))
        raise ModelError(
            f"solid: not convex at point {k}, {points[k]}; divide it into convex solids"
        )
    if abs(turns.sum()) > 2 * np.pi + 1e-6:
        raise ModelError(
            "solid: its faces cross; give the corners in order around the solid, each once"
        )
    return list(points if sign > 0 else points[::-1])
