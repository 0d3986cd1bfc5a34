"""Shapes of the bodies of a vehicle: boxes, balls, and convex hulls given by their points.

Every shape is the convex hull of ``points`` in the part's frame, widened by ``radius``. [m]
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from typing import ClassVar

import casadi as ca
import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, field_overview
from slipfree.core.schema import Positive
from slipfree.geometry.frame import ORIGIN, Pose, Vector, translation, turn


@checked
@dataclass(frozen=True)
class Box:
    """A box.

    Attributes
    ----------
    size : tuple of 3 floats
        Edges along the box's x, y and z axes, positive. [m]
    at : tuple of 3 floats
        Centre in the part's frame. [m]
    turned : tuple of 3 floats
        Orientation in the part's frame: angles about the part's x, then y, then z axis (roll,
        pitch, yaw). [rad]

    Raises
    ------
    ModelError
        If an edge is not positive, or a number is not finite.
    """

    radius: ClassVar[float] = 0.0
    size: tuple[Positive, Positive, Positive]
    at: Vector = ORIGIN
    turned: Vector = ORIGIN

    __repr__ = field_overview

    def __str__(self) -> str:
        """Return edges, centre and orientation, for lists of parts."""
        edges = " x ".join(f"{edge:.4g}" for edge in self.size)
        turned = "" if self.turned == ORIGIN else f", turned {_listed(np.degrees(self.turned))} deg"
        return f"box {edges} m at {_listed(self.at)} m{turned}"

    @property
    def pose(self) -> Pose:
        """Pose of the box's axes in the part's frame, with the origin at its centre."""
        x, y, z = self.turned
        return translation(*self.at) @ turn("z", z) @ turn("y", y) @ turn("x", x)

    @property
    def points(self) -> tuple[Vector, ...]:
        """Corners in the part's frame [m]."""
        rotation, origin = (np.array(ca.evalf(each)) for each in self.pose)
        corners = np.array([*product((-0.5, 0.5), repeat=3)]) * self.size
        return tuple((x, y, z) for x, y, z in (corners @ rotation.T + origin.T).tolist())


@checked
@dataclass(frozen=True)
class Ball:
    """A ball.

    Attributes
    ----------
    radius : float
        Radius, positive. [m]
    at : tuple of 3 floats
        Centre in the part's frame. [m]

    Raises
    ------
    ModelError
        If the radius is not positive and finite, or the centre not finite.
    """

    radius: Positive
    at: Vector = ORIGIN

    __repr__ = field_overview

    def __str__(self) -> str:
        """Return radius and centre, for lists of parts."""
        return f"ball of radius {self.radius:.4g} m at {_listed(self.at)} m"

    @property
    def points(self) -> tuple[Vector]:
        """The centre in the part's frame [m]."""
        return (self.at,)


@checked
@dataclass(frozen=True)
class Hull:
    """The convex hull of points; its clearance is that of the points.

    Attributes
    ----------
    points : tuple of tuples of 3 floats
        Points in the part's frame. Further points on faces and edges let the clearance find ground
        that rises between the corners. [m]

    Raises
    ------
    ModelError
        If there is no point, or a number is not finite.
    """

    radius: ClassVar[float] = 0.0
    points: tuple[Vector, ...]

    __repr__ = field_overview

    def __post_init__(self) -> None:
        if not self.points:
            raise ModelError("hull: points: expected at least one point, found none; add points")

    def __str__(self) -> str:
        """Return the number of points and their extent, for lists of parts."""
        sides = ", ".join(
            f"{min(side):.4g} to {max(side):.4g}" for side in zip(*self.points, strict=True)
        )
        return f"hull of {len(self.points)} points, ({sides}) m"


def bounding_box(shape: BodyShape) -> tuple[Pose, Array]:
    """Return the pose of a box in the part's frame, and half of its edges, shape (3,) [m].

    With the radius of the shape added on all sides, it contains the shape.
    """
    if isinstance(shape, Box):
        return shape.pose, np.array(shape.size) / 2
    low, high = np.min(shape.points, axis=0), np.max(shape.points, axis=0)
    return translation(*((low + high) / 2)), (high - low) / 2


def _listed(vector: Iterable[float]) -> str:
    return f"({', '.join(f'{round(each, 6) + 0.0:.4g}' for each in vector)})"


BodyShape = Box | Ball | Hull
SHAPES: dict[str, type[BodyShape]] = {"box": Box, "ball": Ball, "hull": Hull}
