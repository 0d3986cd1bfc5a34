"""Meshes of vehicles and solids, and of a ground with more points near the paths of vehicles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from math import ceil
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy  # scipy.spatial and scipy.interpolate are imported when they are used

from slipfree.core.records import Array
from slipfree.terrain.base import Grid, Terrain
from slipfree.vehicle.sections import Sphere, TriangleMesh, sheet
from slipfree.vehicle.shapes import Ball, BodyShape

ROD = 8  # faces around a rod
SPOKES, SPOKE = 4, 0.06  # number of spokes of a wheel, and their radius [wheel radius]
ROLLERS, ROLLER = 9, 0.25  # number of rollers of a wheel, and half their length [wheel radius]
FINEST = 1e-3  # smallest cells of simplified meshes [extent]
NEAR = 1e-9  # smaller lengths count as zero [m]
WELD = 1e-6  # distance of vertices that are merged [extent]
MOST = 60_000  # maximum number of added points


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(each.vertices) for each in meshes)])
    faces = [each.faces + np.uint32(start) for each, start in zip(meshes, starts, strict=False)]
    return TriangleMesh(np.concatenate([each.vertices for each in meshes]), np.concatenate(faces))


def reduced(meshes: Mapping[str, TriangleMesh], most: int) -> dict[str, TriangleMesh]:
    """Return meshes by name with at most ``most`` faces in all, and vertices moved together."""
    merged = dict(meshes)
    cell = FINEST * max((float(np.ptp(each.vertices)) for each in meshes.values()), default=0.0)
    while sum(len(each.faces) for each in merged.values()) > most:
        for name, mesh in meshes.items():  # one vertex per cubic cell, and faces that remain
            cells = np.round(mesh.vertices / cell)
            _, first, number = np.unique(cells, axis=0, return_index=True, return_inverse=True)
            faces = number.reshape(-1)[mesh.faces].astype(np.uint32)
            kept = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
            merged[name] = TriangleMesh(mesh.vertices[first], faces[kept])
        cell *= 1.5
    return {name: each for name, each in merged.items() if len(each.faces)}


def outward(mesh: TriangleMesh) -> TriangleMesh:
    """Return a mesh with faces that are counter-clockwise seen from outside.

    The volume of a closed part, the sum of the signed volumes of the tetrahedra from any point to
    its faces, is negative if the part is inside out. A part is closed if the directed edges of its
    faces cancel, as they do still after vertices are merged; faces of other parts get both sides.
    """
    cell = WELD * float(np.ptp(mesh.vertices, axis=0).max())
    _, welded = np.unique(np.round(mesh.vertices / cell), axis=0, return_inverse=True)
    faces, corners = welded.reshape(-1)[mesh.faces], mesh.vertices[mesh.faces]
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    graph = scipy.sparse.coo_array((np.ones(len(edges)), edges.T))
    part = scipy.sparse.csgraph.connected_components(graph, directed=False)[1][faces[:, 0]]
    _, edge = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    left = np.abs(np.bincount(edge.reshape(-1), np.sign(edges[:, 1] - edges[:, 0])))
    is_open = np.bincount(part.repeat(3), left[edge.reshape(-1)])[part] > 0
    volume = np.bincount(part, np.linalg.det(corners - corners.mean(axis=(0, 1))))[part]
    faces = np.where((volume < 0)[:, None], mesh.faces[:, ::-1], mesh.faces)
    return mesh._replace(faces=np.concatenate([faces, faces[is_open, ::-1]]))


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
    """Return the mesh of an eight-sided prism between two different points [m]."""
    ends = np.array([start, end], dtype=float)
    along = ends[1] - ends[0]
    along /= np.linalg.norm(along)
    side = np.cross(along, np.eye(3)[int(np.abs(along).argmin())])
    side /= np.linalg.norm(side)
    angles = 2 * np.pi * np.arange(ROD) / ROD
    round_ = np.outer(np.cos(angles), side) + np.outer(np.sin(angles), np.cross(along, side))
    return extruded(ends[0] + radius * round_, ends[1] - ends[0])


def extruded(outline: Array, along: Sequence[float] | Array) -> TriangleMesh:
    """Return the closed prism of a convex outline, shape (n, 3), along a vector [m].

    Faces point outward if the outline turns counter-clockwise about the vector.
    """
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
    points = np.array(shape.points)
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
    return extruded(np.array([(x, y, -thickness / 2) for x, y in corners]), (0.0, 0.0, thickness))


def clipped(
    points: Sequence[tuple[float, float]], low: tuple[float, float], high: tuple[float, float]
) -> Array:
    """Return the corners of the part of a convex polygon inside a box, shape (n, 2)."""
    from matplotlib.path import Path  # motions without figures do without Matplotlib
    from matplotlib.transforms import Bbox

    corners = np.asarray(Path(points).clip_to_bbox(Bbox([low, high])).vertices)
    is_last = np.all(np.isclose(corners, corners[:1], rtol=0, atol=NEAR), axis=1)
    return np.concatenate([corners[:1], corners[~is_last]])


class Surface(NamedTuple):
    """Drawn ground: triangles through the nodes of a grid, and through more points near paths."""

    grid: Grid
    points: Array  # shape (n, 3): nodes of the grid, then other points [m]
    triangles: scipy.spatial.Delaunay  # of x and y relative to the first node
    spacing: float  # distance between points near paths, the larger of x and y [m]

    def mesh(self, origin: Array) -> TriangleMesh:
        """Return the surface relative to an origin, without cells between four holes."""
        faces, holes = self.triangles.simplices, self.grid.holes
        if holes is not None:
            empty = holes[:-1, :-1] & holes[1:, :-1] & holes[:-1, 1:] & holes[1:, 1:]
            middle = self.points[faces, :2].mean(axis=1)
            faces = faces[~empty[cells(self.grid, middle)]]
        return TriangleMesh(self.points - origin, faces.astype(np.uint32))

    def interpolated(self, values: Array) -> Array:
        """Return values at the nodes of the grid, shape (n, k), interpolated at all points."""
        whole = values.reshape(*self.grid.z.shape, -1).astype(float)
        nodes = self.grid.x, self.grid.y
        interpolated = scipy.interpolate.RegularGridInterpolator(nodes, whole)(self.points[:, :2])
        return np.asarray(interpolated)

    def height(self, x: Array, y: Array) -> Array:
        """Return the height of the surface, NaN outside [m]."""
        heights = scipy.interpolate.LinearNDInterpolator(self.triangles, self.points[:, 2])
        return np.asarray(heights(x - self.points[0, 0], y - self.points[0, 1]))


def cells(grid: Grid, points: Array) -> tuple[npt.NDArray[np.int_], npt.NDArray[np.int_]]:
    """Return the indices, along x and along y, of the cells nearest to points, shape (n, 2)."""
    steps = (points - (grid.x[0], grid.y[0])) / grid.spacing
    i, j = np.clip(np.floor(steps), 0, (grid.x.size - 2, grid.y.size - 2)).astype(int).T
    return i, j


def surface(
    grid: Grid, terrain: Terrain, paths: Iterable[Array], margin: float, spacing: float
) -> Surface:
    """Return the surface of a grid whose cells near paths are divided to a desired spacing.

    At most about 60 000 points are added: the spacing becomes larger, or no cell is divided.
    """
    nodes = np.stack(np.meshgrid(grid.x, grid.y, indexing="ij"), axis=-1).reshape(-1, 2)
    places, parts, cell = [nodes], 1, float(max(grid.spacing))
    if cell > spacing:
        near = np.zeros((grid.x.size - 1, grid.y.size - 1), bool)
        aside = np.linspace(-margin, margin, 2 * ceil(margin / min(grid.spacing)) + 1)
        for path in paths:
            lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
            count = max(2, ceil(2 * lengths[-1] / min(cell, margin)) + 1)
            at = np.linspace(0, lengths[-1], count)
            points = np.stack([np.interp(at, lengths, each) for each in path.T], axis=1)
            for away in product(aside, repeat=2):
                near[cells(grid, points + away)] = True
        parts = max(1, min(ceil(cell / spacing), int(np.sqrt(MOST / near.sum() + 1))))
        corners = nodes.reshape(*grid.z.shape, 2)[:-1, :-1][near]
        shares = list(product(np.arange(parts) / parts, repeat=2))[1:]
        places += [corners + np.multiply(share, grid.spacing) for share in shares]
    x, y = np.concatenate(places).T
    heights = np.append(grid.z.ravel(), terrain.elevation(x[len(nodes) :], y[len(nodes) :]))
    triangles = scipy.spatial.Delaunay(np.stack([x - x[0], y - y[0]], axis=1))
    return Surface(grid, np.stack([x, y, heights], axis=1), triangles, cell / parts)
