"""Profile of the ground of a climb: a union of convex solids in the plane of the motion.

x is forward, z up. The distance of a wheel's centre from a convex solid is continuously
differentiable, also around its corners. Therefore a wheel has one contact with each solid, and the
same equations hold on a floor, on a floor and against a wall together, and over an edge.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
import numpy.typing as npt

from slipfree.errors import ModelError
from slipfree.records import Array

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
        """Return whether the solid touches another one: no face of either separates them."""
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
        place = ca.vertcat(x, z)
        distance, normal = ca.SX(-np.inf), ca.SX.zeros(2)
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
        return distance, normal

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
        place = np.stack(np.broadcast_arrays(np.asarray(x, float), np.asarray(z, float)), axis=-1)
        from_corners = place[..., None, :] - np.array(self.points)
        faces = (from_corners * self.normals).sum(axis=-1)
        past = (from_corners * np.roll(self.edges, 1, axis=0)).sum(axis=-1) > 0
        before = (from_corners * self.edges).sum(axis=-1) < 0
        away = np.linalg.norm(from_corners, axis=-1)
        corners = np.where(past & before, away, -np.inf)
        all_of_them = np.concatenate([faces, corners], axis=-1)
        directions = np.concatenate(
            [
                np.broadcast_to(self.normals, from_corners.shape),
                from_corners / np.maximum(away, math.sqrt(ROOT_OFFSET))[..., None],
            ],
            axis=-2,
        )
        nearest = all_of_them.argmax(axis=-1)[..., None]
        normal = np.take_along_axis(directions, nearest[..., None], axis=-2)[..., 0, :]
        return np.take_along_axis(all_of_them, nearest, axis=-1)[..., 0], normal


@dataclass(frozen=True)
class Profile:
    """A union of convex solids; the first one is the floor from which a climb starts.

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
        """First highest point of the solids that stand on the floor, (x, z) [m]."""
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


def flat() -> Profile:
    """Return a level floor at height zero."""
    return Profile((_block(-FLOOR_LENGTH, 0.0, FLOOR_LENGTH),))


def ramp(angle: float, height: float) -> Profile:
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
    _positive(height=height)
    if not 0 < angle <= math.pi / 2:
        raise ModelError(
            f"ramp: expected an angle above 0 and at most pi/2 rad, found {angle} rad; give a "
            "positive angle in radians"
        )
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


def step(height: float) -> Profile:
    """Return a floor with a plateau of a given height from x = 0 on [m].

    Raises
    ------
    ModelError
        If the height is not positive and finite.
    """
    _positive(height=height)
    return Profile((*flat().solids, _block(0.0, height, FLOOR_LENGTH)))


def kerb(height: float, length: float) -> Profile:
    """Return a floor with a block of a given height and length from x = 0 on [m].

    Raises
    ------
    ModelError
        If the height or the length is not positive and finite.
    """
    _positive(height=height, length=length)
    return Profile((*flat().solids, _block(0.0, height, length)))


def stairs(height: float, depth: float, count: int) -> Profile:
    """Return a floor with stairs from x = 0 on; the last step is a plateau.

    Parameters
    ----------
    height, depth : float
        Height and depth of a step. [m]
    count : int
        Number of steps.

    Raises
    ------
    ModelError
        If a number is not positive.
    """
    _positive(height=height, depth=depth, count=count)
    blocks = (_block(k * depth, (k + 1) * height, FLOOR_LENGTH) for k in range(count))
    return Profile((*flat().solids, *blocks))


def _block(start: float, height: float, length: float) -> Solid:
    end = start + length if length < FLOOR_LENGTH else FLOOR_LENGTH
    return Solid(((start, -ROOT_DEPTH), (end, -ROOT_DEPTH), (end, height), (start, height)))


def _positive(**sizes: float) -> None:
    for name, value in sizes.items():
        if not (value > 0 and math.isfinite(value)):
            raise ModelError(
                f"profile: expected a positive and finite number as {name!r}, found {value}; "
                "change it"
            )


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
        raise ModelError(f"solid: point {k}, {points[k]}, is not a corner: remove it")
    turns = np.arctan2(sines, cosines)
    sign = 1.0 if turns.sum() > 0 else -1.0
    if (sign * turns < 0).any():
        k = int(np.argmin(sign * turns))
        raise ModelError(
            f"solid: not convex at point {k}, {points[k]}: divide it into convex solids"
        )
    if abs(turns.sum()) > 2 * np.pi + 1e-6:
        raise ModelError(
            "solid: its faces cross; give the corners in order around the solid, each once"
        )
    return list(points if sign > 0 else points[::-1])
