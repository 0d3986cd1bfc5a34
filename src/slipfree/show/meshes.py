"""Meshes of vehicles and solids, and of a ground that is finer near the paths of vehicles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from math import ceil
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt
import scipy  # scipy.spatial is imported when it is used

from slipfree.core.records import Array
from slipfree.geometry.mesh import TriangleMesh, sheet
from slipfree.terrain.base import Grid, Terrain
from slipfree.vehicle.sections import Sphere
from slipfree.vehicle.shapes import Ball, BodyShape, Box, Hull

ROD = 8  # faces around a rod
SPOKES, SPOKE = 4, 0.06  # number of spokes of a wheel, and their radius [wheel radius]
ROLLERS, ROLLER = 9, 0.25  # number of rollers of a wheel, and half their length [wheel radius]
FINEST = 1e-3  # smallest cells of simplified meshes [extent]
NEAR = 1e-9  # smaller lengths count as zero [m]
MOST = 60_000  # maximum number of added nodes


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(each.vertices) for each in meshes)])
    faces = [each.faces + np.uint32(start) for each, start in zip(meshes, starts, strict=False)]
    return TriangleMesh(np.concatenate([each.vertices for each in meshes]), np.concatenate(faces))


def reduced(meshes: Mapping[str, TriangleMesh], most: int) -> dict[str, TriangleMesh]:
    """Return meshes by name with at most ``most`` faces in all, and vertices moved together."""
    found = dict(meshes)
    cell = FINEST * max((float(np.ptp(each.vertices)) for each in meshes.values()), default=0.0)
    while sum(len(each.faces) for each in found.values()) > most:
        found, cell = {name: _merged(each, cell) for name, each in meshes.items()}, 1.5 * cell
    return {name: each for name, each in found.items() if len(each.faces)}


def _merged(mesh: TriangleMesh, cell: float) -> TriangleMesh:
    """Return a mesh with one vertex per cubic cell [m], without faces that thereby vanish."""
    cells = np.round(mesh.vertices / cell)
    _, first, number = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    faces = number.reshape(-1)[mesh.faces].astype(np.uint32)
    kept = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return TriangleMesh(mesh.vertices[first], faces[kept])


def spokes(radius: float) -> TriangleMesh:
    """Return the mesh of four spokes about the x axis, one of them thicker, for a radius [m]."""
    angles = 2 * np.pi * np.arange(SPOKES) / SPOKES
    ends = [(0.0, float(radius * np.cos(a)), float(radius * np.sin(a))) for a in angles]
    sizes = [2 * SPOKE, *[SPOKE] * (SPOKES - 1)]
    return joined(
        *(rod((0.0, 0.0, 0.0), end, size * radius) for end, size in zip(ends, sizes, strict=True))
    )


def roller_axles(radius: float, angle: float) -> TriangleMesh:
    """Return the mesh of the axles of rollers around the x axis, on the tread of a wheel.

    The angle from the wheel's axle is that of `slipfree.vehicle.sections.Omni` [rad].
    """
    rods = []
    for around in 2 * np.pi * np.arange(ROLLERS) / ROLLERS:
        out = np.array([0.0, np.cos(around), np.sin(around)])
        half = np.cos(angle) * np.eye(3)[0] + np.sin(angle) * np.cross(np.eye(3)[0], out)
        start, end = (radius * (out + sign * ROLLER * half) for sign in (-1, 1))
        rods.append(rod(start, end, SPOKE * radius))
    return joined(*rods)


def rod(
    start: Sequence[float] | Array, end: Sequence[float] | Array, radius: float
) -> TriangleMesh:
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


def extruded(outline: Array, along: Sequence[float] | Array) -> TriangleMesh:
    """Return the mesh of a convex outline extruded along a vector, with closed ends [m]."""
    n = len(outline)
    side = sheet(np.stack([outline, outline + np.asarray(along)], axis=1), closed=(True, False))
    k = np.arange(1, n - 1)
    fan = np.stack([np.zeros_like(k), k, k + 1], axis=1)
    # Each end has vertices of its own, so that edges stay sharp when normals are averaged.
    caps = [
        TriangleMesh(outline, fan[:, ::-1].astype(np.uint32)),
        TriangleMesh(outline + np.asarray(along), fan.astype(np.uint32)),
    ]
    return joined(side, *caps)


def shape_mesh(shape: BodyShape) -> TriangleMesh:
    """Return the mesh of a shape of a body, in the frame of its part."""
    if isinstance(shape, Ball):
        ball = Sphere(shape.radius).mesh()
        return ball._replace(vertices=ball.vertices + shape.at)
    points = np.array(shape.points if isinstance(shape, Hull) else shape.support_points)
    if isinstance(shape, Box):
        rotation, origin = (np.array(ca.evalf(each)) for each in shape.pose)
        points = points @ rotation.T + origin.T
    if np.linalg.matrix_rank(points - points[0], tol=NEAR) < 3:  # no surface
        return TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.uint32))
    hull = scipy.spatial.ConvexHull(points)
    corners = points[hull.simplices]
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (sides * hull.equations[:, :3]).sum(axis=1) < 0
    corners[inward] = corners[inward, ::-1]
    # faces have vertices of their own, so that edges stay sharp when normals are averaged
    return TriangleMesh(
        corners.reshape(-1, 3), np.arange(corners.size // 3, dtype=np.uint32).reshape(-1, 3)
    )


def plate(half_width: float, rear: float, front: float, thickness: float) -> TriangleMesh:
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
    """Return the corners of the part of a convex polygon inside a box, shape (n, 2)."""
    corners = np.array(points, dtype=float)
    for axis in (0, 1):
        for bound, sign in ((low[axis], 1.0), (high[axis], -1.0)):
            corners = _cut(corners, axis, bound, sign)
    return corners


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


class Refined(NamedTuple):
    """A grid with divided cells."""

    grid: Grid
    near: npt.NDArray[np.bool_]  # shape (n_x - 1, n_y - 1): mask of the divided cells
    parts: int  # number of intervals on each side of a divided cell; 1 if no cell is divided
    terrain: Terrain  # ground that gives the heights inside divided cells

    @property
    def spacing(self) -> float:
        """Distance between nodes in divided cells, the larger of x and y [m]."""
        return float(max(self.grid.spacing)) / self.parts

    def mesh(self, origin: Array) -> TriangleMesh:
        """Return the surface relative to an origin: nodes of the grid, then of divided cells."""
        x, y, z = self.grid.x, self.grid.y, self.grid.z
        points = np.stack(np.broadcast_arrays(x[:, None], y[None, :], z), axis=-1)
        whole, empty = sheet(points - origin), self._empty()
        kept = np.repeat(~(self.near | empty).ravel(), 2)  # a cell has two faces
        if not self.near.any():
            return TriangleMesh(whole.vertices, whole.faces[kept])
        x, y = self._places()
        tiles = np.stack([x, y, self._sealed(self.terrain.elevation(x, y))], axis=-1) - origin
        return joined(TriangleMesh(whole.vertices, whole.faces[kept]), *map(sheet, tiles))

    def spread(self, colors: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Return colours of all nodes of the mesh, interpolated from those of the grid."""
        return np.asarray(np.rint(self.interpolated(colors.astype(float))), dtype=np.uint8)

    def interpolated(self, values: Array) -> Array:
        """Return values, shape (n, k), at all nodes, interpolated from those of the grid."""
        whole = values.reshape(*self.grid.z.shape, -1)
        i, j = np.nonzero(self.near)
        a, b = self._shares()
        corners = [
            (whole[i + p, j + q], (a if p else 1 - a) * (b if q else 1 - b))
            for p, q in product((0, 1), repeat=2)
        ]
        parts = [value[:, None, None, :] * share[None, :, :, None] for value, share in corners]
        mixed = np.sum(parts, axis=0)
        return np.concatenate([values, mixed.reshape(-1, whole.shape[-1])])

    def height(self, x: Array, y: Array) -> Array:
        """Return the height of the drawn surface, bilinear between its nodes [m]."""
        at, (h_x, h_y) = self._cells(x, y), self.grid.spacing
        i, j = at
        k = np.where(self.near[i, j], self.parts, 1)
        u, v = (x - self.grid.x[i]) * k / h_x, (y - self.grid.y[j]) * k / h_y
        s, t = (np.clip(np.floor(each), 0, k - 1) for each in (u, v))
        total = np.zeros(np.shape(x))
        for p, q in product((0, 1), repeat=2):
            fine = self.terrain.elevation(
                self.grid.x[i] + (s + p) * h_x / k, self.grid.y[j] + (t + q) * h_y / k
            )
            corner = np.where(k > 1, fine, self.grid.z[i + p, j + q])
            share = (u - s if p else 1 - u + s) * (v - t if q else 1 - v + t)
            total += share * corner
        return total

    def _empty(self) -> npt.NDArray[np.bool_]:
        holes = self.grid.holes
        if holes is None:
            return np.zeros_like(self.near)
        return np.asarray(holes[:-1, :-1] & holes[1:, :-1] & holes[:-1, 1:] & holes[1:, 1:])

    def _sealed(self, heights: Array) -> Array:
        """Return the heights of divided cells, linear along edges to undivided cells."""
        i, j = np.nonzero(self.near)
        beside, share = np.pad(self.near, 1), np.arange(self.parts + 1) / self.parts
        for along, last in product((0, 1), repeat=2):
            there = (i + 1 + (2 * last - 1), j + 1) if along else (i + 1, j + 1 + (2 * last - 1))
            edge = ~beside[there]
            ends = [self.grid.z[(i + last, j + k) if along else (i + k, j + last)] for k in (0, 1)]
            line = ends[0][:, None] * (1 - share) + ends[1][:, None] * share
            side = (edge, -last) if along else (edge, slice(None), -last)
            heights[side] = line[edge]
        return heights

    def _cells(self, x: Array, y: Array) -> tuple[npt.NDArray[np.int_], npt.NDArray[np.int_]]:
        """Return the indices, along x and along y, of the cells nearest to points."""
        h_x, h_y = self.grid.spacing
        i, j = np.floor((x - self.grid.x[0]) / h_x), np.floor((y - self.grid.y[0]) / h_y)
        n, m = self.near.shape
        return np.clip(i, 0, n - 1).astype(int), np.clip(j, 0, m - 1).astype(int)

    def _shares(self) -> tuple[Array, Array]:
        """Return x and y of a cell's nodes, from 0 to 1, shape (parts + 1, parts + 1) each."""
        share = np.arange(self.parts + 1) / self.parts
        a, b = np.meshgrid(share, share, indexing="ij")
        return a, b

    def _places(self) -> tuple[Array, Array]:
        """Return x and y of the divided cells' nodes, shape (n, parts + 1, parts + 1) [m]."""
        (i, j), (a, b), (h_x, h_y) = np.nonzero(self.near), self._shares(), self.grid.spacing
        return (self.grid.x[i][:, None, None] + a * h_x, self.grid.y[j][:, None, None] + b * h_y)


def refined(
    grid: Grid, terrain: Terrain, paths: Iterable[Array], margin: float, spacing: float
) -> Refined:
    """Return a grid whose cells near paths are divided to a desired spacing.

    At most about 60 000 nodes are added: the spacing becomes larger, or no cell is divided.
    """
    whole = Refined(grid, np.zeros((grid.x.size - 1, grid.y.size - 1), bool), 1, terrain)
    cell = float(max(grid.spacing))
    if cell <= spacing:
        return whole
    near = whole.near.copy()
    aside = np.linspace(-margin, margin, 2 * ceil(margin / min(grid.spacing)) + 1)
    for path in paths:
        points = _dense(path, min(cell, margin) / 2)
        for dx, dy in product(aside, repeat=2):
            near[whole._cells(points[:, 0] + dx, points[:, 1] + dy)] = True
    parts = min(ceil(cell / spacing), int(np.sqrt(MOST / near.sum())) - 1)
    return whole._replace(near=near, parts=parts) if parts > 1 else whole


def _dense(path: Array, step: float) -> Array:
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    at = np.linspace(0, lengths[-1], max(2, ceil(lengths[-1] / step) + 1))
    return np.stack([np.interp(at, lengths, each) for each in path.T], axis=1)
