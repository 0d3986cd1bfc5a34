"""Meshes of simple bodies, for drawings of vehicles and grounds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slipfree.core.records import Array
from slipfree.geometry.mesh import Mesh, sheet

ROD = 8  # faces around a rod
SPOKES, SPOKE = 4, 0.06  # number of spokes of a wheel, and their radius [wheel radius]
NEAR = 1e-9  # smaller lengths count as zero [m]


def joined(*meshes: Mesh) -> Mesh:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(each.vertices) for each in meshes)])
    faces = [each.faces + np.uint32(start) for each, start in zip(meshes, starts, strict=False)]
    return Mesh(np.concatenate([each.vertices for each in meshes]), np.concatenate(faces))


def spokes(radius: float) -> Mesh:
    """Return the mesh of four spokes about the x axis, one of them thicker, for a radius [m]."""
    angles = 2 * np.pi * np.arange(SPOKES) / SPOKES
    ends = [(0.0, float(radius * np.cos(a)), float(radius * np.sin(a))) for a in angles]
    sizes = [2 * SPOKE, *[SPOKE] * (SPOKES - 1)]
    return joined(
        *(rod((0.0, 0.0, 0.0), end, size * radius) for end, size in zip(ends, sizes, strict=True))
    )


def rod(start: Sequence[float] | Array, end: Sequence[float] | Array, radius: float) -> Mesh:
    """Return the mesh of an eight-sided prism between two points [m]."""
    ends = np.array([start, end], dtype=float)
    along = ends[1] - ends[0]
    length = float(np.linalg.norm(along))
    along = along / length if length > NEAR else np.array([0.0, 0.0, 1.0])
    side = np.cross(along, np.eye(3)[int(np.abs(along).argmin())])
    side /= np.linalg.norm(side)
    angles = 2 * np.pi * np.arange(ROD) / ROD
    round_ = np.outer(np.cos(angles), side) + np.outer(np.sin(angles), np.cross(along, side))
    return extruded(ends[0] + radius * round_, ends[1] - ends[0])


def extruded(outline: Array, along: Sequence[float] | Array) -> Mesh:
    """Return the mesh of a convex outline extruded along a vector, with closed ends.

    Parameters
    ----------
    outline : ndarray, shape (n, 3)
        Corners, counter-clockwise when viewed from the end of the vector. [m]
    along : array_like, shape (3,)
        Direction and length of the extrusion. [m]
    """
    n = len(outline)
    side = sheet(np.stack([outline, outline + np.asarray(along)], axis=1), closed=(True, False))
    k = np.arange(1, n - 1)
    fan = np.stack([np.zeros_like(k), k, k + 1], axis=1)
    # Each end has vertices of its own, so that edges stay sharp when normals are averaged.
    caps = [
        Mesh(outline, fan[:, ::-1].astype(np.uint32)),
        Mesh(outline + np.asarray(along), fan.astype(np.uint32)),
    ]
    return joined(side, *caps)


def plate(half_width: float, rear: float, front: float, thickness: float) -> Mesh:
    """Return the mesh of a flat plate, x right, y forward, pointed at the front; lengths in m."""
    shoulder = front - 0.25 * (front - rear)
    corners = (
        (-half_width, rear),
        (half_width, rear),
        (half_width, shoulder),
        (0.0, front),
        (-half_width, shoulder),
    )
    outline = np.array([(x, y, -thickness / 2) for x, y in corners])
    return extruded(outline, (0.0, 0.0, thickness))


def clipped(
    points: Sequence[tuple[float, float]], low: tuple[float, float], high: tuple[float, float]
) -> Array:
    """Return the corners of the part of a convex polygon inside a box, shape (n, 2).

    The result has no rows for a polygon outside the box.
    """
    found = np.array(points, dtype=float)
    for axis in (0, 1):
        for bound, sign in ((low[axis], 1.0), (high[axis], -1.0)):
            found = _cut(found, axis, bound, sign)
    return found


def _cut(points: Array, axis: int, bound: float, sign: float) -> Array:
    """Return the part of a convex polygon where ``sign * (coordinate - bound) >= 0`` on an axis."""
    heights = sign * (points[:, axis] - bound)
    kept: list[Array] = []
    for k in range(len(points)):
        before, here = heights[k - 1], heights[k]
        if (before < 0) != (here < 0):
            kept.append(points[k - 1] + before / (before - here) * (points[k] - points[k - 1]))
        if here >= 0:
            kept.append(points[k])
    return np.array(kept).reshape(-1, 2)
