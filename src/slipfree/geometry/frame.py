"""Poses of frames, their twists by differentiation, and symmetric tensors."""

from __future__ import annotations

from math import hypot, inf
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.core.schema import Finite

Vector = tuple[Finite, Finite, Finite]
ORIGIN: Vector = (0.0, 0.0, 0.0)
Axis = str | Vector
AXES: dict[str, Vector] = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def unit_vector(axis: Axis) -> Vector:
    """Return the unit vector of an axis given by its name or by a vector.

    ModelError is raised for an unknown name, and for a vector that is zero, not finite or not of
    length three.
    """
    given = AXES.get(axis) if isinstance(axis, str) else axis
    size = hypot(*given) if given is not None and len(given) == 3 else 0.0
    if given is None or not 0 < size < inf:
        raise ModelError(
            f"expected 'x', 'y', 'z' or a nonzero vector of three finite numbers, found {axis!r}; "
            "correct the axis"
        )
    x, y, z = (each / size for each in given)
    return x, y, z


class Twist(NamedTuple):
    """Velocity of a frame's origin and angular velocity of the frame, in fixed axes."""

    v: ca.SX
    omega: ca.SX


class Pose(NamedTuple):
    """Orientation and position of a frame in fixed axes.

    The columns of the rotation matrix (3, 3) are the frame's axes; the origin (3, 1) is in m.
    """

    rotation: ca.SX
    origin: ca.SX

    def __matmul__(self, other: Pose) -> Pose:
        """Return the pose ``other``, given relative to this frame, in fixed axes."""
        return Pose(self.rotation @ other.rotation, self.origin + self.rotation @ other.origin)

    def twist(self, q: ca.SX, rates: ca.SX) -> Twist:
        """Return the twist of a pose that depends on ``q`` (n, 1), for rates of ``q`` (n, 1)."""
        turning = ca.jtimes(self.rotation, q, rates) @ self.rotation.T
        return Twist(ca.jtimes(self.origin, q, rates), ca.inv_skew(turning))


def translation(x: ca.SX | float, y: ca.SX | float, z: ca.SX | float) -> Pose:
    """Return the pose of a frame translated along the fixed axes [m]."""
    return Pose(ca.SX.eye(3), ca.SX(ca.vertcat(x, y, z)))


FIXED = translation(0, 0, 0)  # pose of the fixed axes


def turn(axis: Axis, angle: ca.SX | float) -> Pose:
    """Return the pose of a frame rotated about a fixed axis by a right-handed angle [rad]."""
    k = ca.skew(ca.SX(ca.DM(unit_vector(axis))))
    rotation = ca.sparsify(ca.SX.eye(3) + ca.sin(angle) * k + (1 - ca.cos(angle)) * (k @ k))
    return Pose(ca.densify(rotation), ca.SX.zeros(3))


def platform(
    x: ca.SX, y: ca.SX, z: ca.SX, heading: ca.SX | float, roll: ca.SX | float, pitch: ca.SX | float
) -> Pose:
    """Return the pose of a platform: ``R = Rz(heading) Ry(roll) Rx(pitch)``.

    The platform's axes are x right, y forward, z up. Heading is counter-clockwise from the fixed
    y axis; roll is positive with the right side down, pitch with the nose up. [m, rad]
    """
    place = translation(x, y, z)
    return place @ turn("z", heading) @ turn("y", roll) @ turn("x", pitch)


def rotation_of(attitude: ca.SX) -> ca.SX:
    """Return the rotation matrix of a quaternion ``(w, x, y, z)`` of any norm, shape (3, 3).

    The result is orthogonal even if numerical integration has changed the norm of the quaternion.
    """
    w, x, y, z = ca.vertsplit(attitude)
    s = 2 / ca.sumsqr(attitude)
    return ca.vertcat(
        ca.horzcat(1 - s * (y**2 + z**2), s * (x * y - w * z), s * (x * z + w * y)),
        ca.horzcat(s * (x * y + w * z), 1 - s * (x**2 + z**2), s * (y * z - w * x)),
        ca.horzcat(s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x**2 + y**2)),
    )


def quaternion(rotation: ca.SX) -> ca.SX:
    """Return the unit quaternion ``(x, y, z, w)`` of a rotation, ``w >= 0``, shape (4, 1).

    The largest of the four components is computed first, which avoids cancellation.
    """
    trace, twice, axis = ca.trace(rotation), rotation + rotation.T, 2 * ca.inv_skew(rotation)
    # four times the product of the quaternion and its transpose
    product = ca.blockcat([[twice + (1 - trace) * ca.SX.eye(3), axis], [axis.T, 1 + trace]])
    rows = ca.horzsplit(ca.densify(product))
    best, size = rows[0], rows[0][0]
    for index in (1, 2, 3):
        larger = rows[index][index] > size
        best = ca.if_else(larger, rows[index], best)
        size = ca.fmax(size, rows[index][index])
    q = best / ca.norm_2(best)
    return q * ca.if_else(q[3] < 0, -1, 1)


TRIANGLE = 1e-3  # relative error of the triangle inequality from rounded moments of inertia
Elements = tuple[Finite, Finite, Finite, Finite, Finite, Finite]


def tensor(elements: Elements) -> Array:
    """Return the symmetric matrix, shape (3, 3), of the elements xx, yy, zz, xy, xz, yz."""
    xx, yy, zz, xy, xz, yz = elements
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def is_inertia(given: Elements) -> bool:
    """Return whether a body has these moments of inertia: none is above the sum of the others."""
    least, middle, most = np.linalg.eigvalsh(tensor(given))
    return bool(least > 0 and most <= (1 + TRIANGLE) * (least + middle))


def elements(matrix: Array) -> Elements:
    """Return the elements xx, yy, zz, xy, xz, yz of a symmetric matrix, shape (3, 3)."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = matrix.tolist()
    return xx, yy, zz, xy, xz, yz


def in_axes(rotation: Array, given: Elements) -> Elements:
    """Return the elements of a tensor in other axes.

    ``rotation`` is the matrix from the axes of ``given`` to the other axes.
    """
    return elements(rotation @ tensor(given) @ rotation.T)
