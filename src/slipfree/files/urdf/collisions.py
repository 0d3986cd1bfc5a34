"""Shapes of bodies from the collision geometry of a URDF, without that of wheels.

A mesh and a cylinder become the points of a convex hull: some of its corners, and points on its
lower faces, so that a clearance finds ground that rises between the corners.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping
from itertools import product
from pathlib import Path

import numpy as np
import scipy  # scipy.optimize and scipy.spatial are imported when they are used

from slipfree.core.errors import DataError
from slipfree.core.records import Array
from slipfree.files.urdf.meshes import MeshFiles
from slipfree.files.urdf.tree import Geometry, MeshFile, Shape, Tree, UrdfJoint
from slipfree.files.vehicle_draft import placed, rotation_of, vector_of
from slipfree.vehicle.shapes import Ball, BodyShape, Box, Hull

MAX_CORNERS = 32  # largest number of corners that represent a hull
SHRINK = 1e-3  # a hull that shrinks by less needs no further corner [m]
DIRECTIONS = np.array([d for d in product((-1, 0, 1), repeat=3) if any(d)])  # of first corners
RIM_POINTS = 16  # number of points on a rim of a cylinder
FACE_POINTS = 8  # number of intervals along each side of the grid on the lower faces of a hull
CLEAR = 1e-3  # shapes closer to the level ground of the wheels are left out [m]
SAME = 1e-6  # positions that coincide [m]


def body_shapes(
    tree: Tree, parts: Collection[str], wheels: Collection[UrdfJoint], ground: float
) -> tuple[dict[str, tuple[BodyShape, ...]], list[str]]:
    """Return the shapes of the bodies of a URDF that faces forward along x, and notes on them.

    The shapes are in the frame of the link, one of ``parts``, that they move with. ``wheels`` are
    the joints of wheels, ``ground`` the height of level ground below them, with all joints at zero,
    in the frame of the root [m].
    """
    on_wheels = {j.child for wheel in wheels for j in [wheel, *tree.below(wheel.child)]}
    links = [link for link in tree.links.values() if link.name not in on_wheels]
    every = [each for link in links for each in link.collisions]
    meshes = [each for each in every if isinstance(each, MeshFile)]
    files = MeshFiles(meshes, Path(tree.file).parent)
    places = [tree.frames[wheel.child][1] for wheel in wheels]
    centers = np.array(places or [np.full(3, np.inf)])
    parent = {joint.child: joint.parent for joint in tree.joints.values()}
    shapes: dict[str, list[BodyShape]] = defaultdict(list)
    touching, unread, reduced = list[str](), dict[str, str](), list[str]()
    for link in links:
        owner = link.name
        while owner not in parts:
            owner = parent[owner]
        for collision in (part for each in link.collisions for part in _parts(each)):
            try:
                shape, reduction = _shape(collision, tree.frames[link.name][0], files)
            except DataError as error:
                unread[str(error)] = link.name
                continue
            in_root = placed(shape, *tree.frames[link.name])
            if isinstance(in_root, Ball) and np.abs(centers - in_root.at).max(axis=1).min() < SAME:
                continue  # the ball of a caster, which is a wheel
            if min(z for _, _, z in in_root.points) - in_root.radius < ground + CLEAR:
                touching.append(link.name)
                continue
            reduced += [f"{link.name} {reduction}"] if reduction else []
            rotation, origin = tree.frames[owner]
            shapes[owner].append(placed(in_root, rotation.T, -rotation.T @ origin))
    by_link = {owner: tuple(of_link) for owner, of_link in shapes.items()}
    return by_link, [*_notes(touching, reduced, unread)]


def _notes(
    touching: Collection[str], reduced: Collection[str], unread: Mapping[str, str]
) -> Iterator[str]:
    if touching:
        yield (
            "collision shapes left out of the clearance, since they reach down to the ground of "
            f"the wheels: {', '.join(dict.fromkeys(touching))}"
        )
    if reduced:
        yield f"collision shapes as points of hulls: {', '.join(reduced)}"
    if unread:
        why, *more = unread
        others = f" (and {len(more)} others)" if more else ""
        yield f"clearance without {', '.join(dict.fromkeys(unread.values()))}: {why}{others}"


def _parts(collision: Geometry) -> Iterator[Geometry]:
    """Yield a collision shape; of a capsule, its cylinder and the spheres at its ends."""
    if not isinstance(collision, Shape) or collision.kind != "capsule":
        yield collision
        return
    half = collision.length / 2 * rotation_of(collision.turned)[:, 2]
    for end in (half, -half):
        yield collision._replace(kind="sphere", at=vector_of(collision.at + end))
    if collision.length > 0:
        yield collision._replace(kind="cylinder")


def _shape(collision: Geometry, rotation: Array, files: MeshFiles) -> tuple[BodyShape, str]:
    """Return the shape of a collision element in its link, and how a hull was reduced.

    ``rotation`` is that of the link in the root's frame. A DataError says why a mesh is not read.
    """
    if isinstance(collision, Box):
        return collision, ""
    if isinstance(collision, MeshFile):
        corners, shrink = reduced_hull(files.triangles(collision).vertices)
    elif collision.kind == "sphere":
        return Ball(collision.radius, collision.at), ""
    else:
        radius, half = collision.radius, collision.length / 2
        angles = 2 * np.pi * np.arange(2 * RIM_POINTS) / RIM_POINTS
        ends = np.repeat((-half, half), RIM_POINTS)
        rims = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), ends])
        corners = rims @ rotation_of(collision.turned).T + collision.at
        shrink = radius * (1 - np.cos(np.pi / RIM_POINTS))
    points = np.vstack([corners, _on_lower_faces(corners, rotation[2])])
    return Hull(tuple(map(vector_of, points))), f"({len(points)} points, {1e3 * shrink:.2g} mm)"


def reduced_hull(vertices: Array) -> tuple[Array, float]:
    """Return some corners of the convex hull of vertices, and by how much it shrinks.

    At most 32 corners are returned, and the largest distance of a vertex from their hull [m].
    """
    corners = _corners(vertices)
    chosen = np.unique((corners @ DIRECTIONS.T).argmax(axis=0)).tolist()
    while True:
        distance = _distances(corners, corners[chosen])
        shrink = float(distance.max())
        if shrink <= SHRINK or len(chosen) >= MAX_CORNERS:
            return corners[chosen], shrink
        chosen.append(int(distance.argmax()))


def _corners(vertices: Array) -> Array:
    """Return the corners of the convex hull of vertices; all vertices if they lie in a plane."""
    vertices = np.unique(vertices, axis=0)
    if np.linalg.matrix_rank(vertices - vertices[0], tol=SAME) < 3:
        return vertices
    return np.asarray(vertices[scipy.spatial.ConvexHull(vertices).vertices])


def _distances(points: Array, corners: Array) -> Array:
    # the nearest convex combination: the heavy last row makes the weights sum to one
    heavy = 1e4 * float(np.ptp(points, axis=0).max())
    matrix = np.vstack([corners.T, np.full(len(corners), heavy)])
    return np.array([scipy.optimize.nnls(matrix, [*point, heavy])[1] for point in points])


def _on_lower_faces(corners: Array, up: Array) -> Array:
    """Return a grid of points on the lower faces of the convex hull of corners, shape (m, 3)."""
    frame = np.linalg.svd(up[None])[2][1:]
    plan = corners @ frame.T
    if len(corners) < 4 or np.linalg.matrix_rank(corners - corners[0], tol=SAME) < 3:
        return np.empty((0, 3))
    planes = scipy.spatial.ConvexHull(corners).equations
    lower = planes[planes[:, :3] @ up < -SAME]
    edge = scipy.spatial.ConvexHull(plan).equations
    lines = [np.linspace(side.min(), side.max(), FACE_POINTS + 1) for side in plan.T]
    grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    grid = grid[(grid @ edge[:, :2].T + edge[:, 2] < -SAME).all(axis=1)] @ frame
    # height at which a vertical line enters the hull: that of the highest lower face
    heights = -(grid @ lower[:, :3].T + lower[:, 3]) / (lower[:, :3] @ up)
    return np.asarray(grid + heights.max(axis=1)[:, None] * up)
