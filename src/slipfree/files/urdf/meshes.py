"""Meshes of a URDF as round shapes of wheels, and collision geometry as shapes of bodies.

A mesh and a cylinder of a body become the points of a convex hull: some of its corners, and points
on its lower faces, so that a clearance finds ground that rises between the corners.
"""

from __future__ import annotations

import io
import os
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import scipy  # scipy.optimize and scipy.spatial are imported when they are used

from slipfree.core.errors import DataError, missing_package
from slipfree.core.records import Array
from slipfree.files.foreign_formats import check_contents
from slipfree.files.urdf.evidence import UNITS
from slipfree.files.urdf.tree import Geometry, MeshFile, Shape, Tree, UrdfJoint
from slipfree.files.urdf.xacro import package_folders
from slipfree.files.vehicle_toml import MAX_LENGTH, placed, rotation_of, vector_of
from slipfree.system.processes import ProcessDiedError, bounded_call, bounded_read
from slipfree.system.regular_files import read_bytes
from slipfree.vehicle.sections import TriangleMesh
from slipfree.vehicle.shapes import Ball, BodyShape, Box, Hull

FORMATS = (".stl", ".dae", ".obj", ".ply", ".glb")
PACKAGES = ("package", "model")  # schemes of names in a package
SAME_PLANE = 0.05  # smaller offsets along the axle, in radii, are of wheels in one plane
MAX_COORDINATE = 1e6  # of a mesh, also in a wrong unit [m]
OVERLAP = 0.9  # wheels in one plane overlap if closer than this, in sums of their radii
MIN_RADIUS = 0.002  # smallest plausible radius, in largest distances between wheels
USUAL_RADII = 0.05, 0.35  # in largest distances between wheels
ROUND = 0.02  # points of the tread are this close to the largest distance from the axis, in radii
MAX_GAP = np.radians(50.0)  # largest angle about the axis between points on the tread
FIT = 0.01  # largest error of a circle fitted to a rounded tread, in radii
MAX_CORNERS = 32  # largest number of corners that represent a hull
SHRINK = 1e-3  # a hull that shrinks by less needs no further corner [m]
DIRECTIONS = np.array([d for d in product((-1, 0, 1), repeat=3) if any(d)])  # of first corners
RIM_POINTS = 16  # number of points on a rim of a cylinder
FACE_POINTS = 8  # number of intervals along each side of the grid on the lower faces of a hull
TOUCH_HEIGHT = 1e-3  # shapes closer to the level ground of the wheels are left out [m]
SAME = 1e-6  # positions that coincide [m]


def mesh_shape(meshes: Sequence[MeshFile], axis: Array, files: MeshFiles) -> Shape | None:
    """Return the body of revolution that encloses the meshes of a link; None if they are not round.

    The centre is on the axis, in the middle of the tread. The tube radius is that of a circle
    fitted to the outline of the tread; it is zero if the outline is not such a circle, or if the
    circle is larger than the tread's width or the radius.
    """
    points = np.vstack([files.triangles(mesh).vertices for mesh in meshes])
    along = points @ axis
    across = points - along[:, None] * axis
    distance = np.linalg.norm(across, axis=1)
    radius = float(distance.max())
    if radius == 0:
        raise DataError(
            f"expected a mesh around the axis of its joint, found {meshes[0].name!r} with all "
            "points on the axis; correct its scale"
        )
    if not radius <= MAX_LENGTH:
        raise DataError(
            f"expected a mesh in metres, of at most {MAX_LENGTH:g} m, found {meshes[0].name!r} "
            f"with points {radius:g} m from the axis of its joint; "
            f"{unit_words(meshes[0], 1e-3)}"
        )
    rim = across[distance > (1 - ROUND) * radius]
    aside = np.cross(axis, rim[0])
    angles = np.sort(np.arctan2(rim @ aside, rim @ rim[0] * np.linalg.norm(axis)))
    if np.diff([*angles, angles[0] + 2 * np.pi]).max() > MAX_GAP:
        return None
    tread = distance > radius / 2
    middle, tube = _tread(along[tread], distance[tread])
    return Shape("mesh", radius, vector_of(middle * axis), angles_to(axis), tube)


class MeshFiles:
    """Files of the meshes among shapes, read in one process with limits: damaged ones may hang."""

    def __init__(self, shapes: Iterable[Geometry], folder: Path) -> None:
        names = dict.fromkeys(each.name for each in shapes if isinstance(each, MeshFile))
        attempts = {name: _attempt(find_mesh, name, folder) for name in names}
        files = {name: path for name, path in attempts.items() if isinstance(path, Path)}
        self._read = {name: error for name, error in attempts.items() if name not in files}
        if files:
            self._read |= zip(files, _read_files([*files.values()]), strict=True)

    def triangles(self, mesh: MeshFile) -> TriangleMesh:
        """Return the triangles of a mesh in the frame of its link, or raise its DataError."""
        read = self._read[mesh.name]
        if isinstance(read, DataError):
            raise read
        with np.errstate(over="ignore", invalid="ignore"):
            vertices: Array = read.vertices * mesh.scale @ rotation_of(mesh.turned).T + mesh.at
        if not np.abs(vertices).max() <= MAX_COORDINATE:  # not for NaN
            raise DataError(
                f"expected a mesh with coordinates from -{MAX_COORDINATE:g} to "
                f"{MAX_COORDINATE:g} m, found {np.abs(vertices).max():g} in {mesh.name!r}; correct "
                "its scale, or export it again"
            )
        is_mirrored = np.prod(mesh.scale) < 0
        return TriangleMesh(vertices, read.faces[:, ::-1] if is_mirrored else read.faces)


def unit_words(mesh: MeshFile, factor: float) -> str:
    """Return a question about the unit of a mesh and the attribute that scales it by a factor."""
    if factor not in UNITS:
        return "correct its scale"
    return f'{UNITS[factor]} write scale="{" ".join(f"{factor * each:g}" for each in mesh.scale)}"'


def unit_factor(radii: Array, centers: Array, axle: Array, own: int) -> float | None:
    """Return the factor that makes the radius of a wheel plausible; None if it is plausible.

    ``radii`` and ``centers`` are those of all wheels [m], ``own`` is the index of the wheel and
    ``axle`` its direction. A radius is implausible if it exceeds the largest distance between
    wheels, if it is less than 0.002 of this distance, or if the wheel overlaps another one in its
    plane, not larger than itself, by more than a tenth. The factor is that of a unit in `UNITS`, or
    1 if none suits.
    """
    radius, offsets = float(radii[own]), centers - centers[own]
    extent = float(np.linalg.norm(centers[:, None] - centers, axis=2).max())
    along = np.abs(offsets @ axle)
    across = np.linalg.norm(np.cross(offsets, axle), axis=1)
    beside = (along < SAME_PLANE * radius) & (across > SAME_PLANE * extent) & (radii <= radius)
    overlaps = bool((beside & (across < OVERLAP * (radius + radii))).any())
    if extent == 0 or (MIN_RADIUS * extent <= radius <= extent and not overlaps):
        return None
    low, high = USUAL_RADII
    return next((unit for unit in UNITS if low <= unit * radius / extent <= high), 1.0)


def _read_files(paths: Sequence[Path]) -> list[TriangleMesh | DataError]:
    """Return the meshes of files, or their errors, from a process with limits.

    If it dies, each file is read in a process of its own, to find the one at which it died.
    """
    if find_spec("trimesh") is None:
        return [DataError(missing_package("trimesh", "urdf")) for _ in paths]
    size = sum(path.stat().st_size for path in paths)
    try:
        return bounded_call(_read_each, paths, seconds=10 + size / 1e6, memory=3e9 + 20 * size)
    except ProcessDiedError:
        return [_attempt(bounded_read, _read_file, path) for path in paths]


def _attempt(read: Callable[..., Any], *arguments: Any) -> Any:
    try:
        return read(*arguments)
    except DataError as error:
        return error


def _read_each(paths: Sequence[Path]) -> list[TriangleMesh | DataError]:
    return [_attempt(_read_file, path) for path in paths]


def _read_file(path: Path) -> TriangleMesh:
    """Return the triangles in a file in metres; raise DataError if it cannot be read."""
    import trimesh

    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise DataError(f"expected a mesh in {', '.join(FORMATS)}, found {path.name!r}; convert it")
    data = io.BytesIO(read_bytes(path, "a mesh"))
    check_contents(path, "mesh", "a mesh")
    try:
        scene: Any = trimesh.load_scene(data, file_type=suffix[1:], skip_materials=True)
        unit = trimesh.units.unit_conversion(scene.units, "meters") if scene.units else 1.0
        merged = scene.to_mesh()
        vertices = unit * np.asarray(merged.vertices, float).reshape(-1, 3)
        faces = np.asarray(merged.faces, np.uint32).reshape(-1, 3)
    except ModuleNotFoundError as error:  # the reader of .dae
        raise DataError(missing_package(str(error.name), "urdf")) from error
    except Exception as error:  # trimesh raises errors of many kinds for a damaged file
        raise DataError(
            f"expected a readable mesh, found {path.name!r}: {error}; export it again"
        ) from error
    if not vertices.size or not np.isfinite(vertices).all():
        raise DataError(
            f"expected a mesh of points with finite coordinates, found none in {path.name!r}; "
            "export it again"
        )
    return TriangleMesh(vertices, faces)


def find_mesh(name: str, folder: Path) -> Path:
    """Return the file of a mesh, relative to the folder of its URDF or in a package."""
    scheme, separator, inside = name.partition("://")
    if separator and scheme not in (*PACKAGES, "file"):
        raise DataError(
            f"expected the mesh in a local file, found {name!r}; download it, and name the file"
        )
    plain = unquote(inside) if separator else name
    if "\\" in plain and not os.path.isfile(folder / plain):  # noqa: PTH113
        plain = plain.replace("\\", "/")  # of Windows
    if scheme in PACKAGES and separator:
        package, _, rest = plain.partition("/")
        tried = [root / rest for root in package_folders(package, folder)]
        remedy = f"put its package into {str(folder)!r} or a folder above it"
    else:
        tried = [folder / plain.removeprefix("localhost" if separator else "")]
        remedy = f"correct the name, which is relative to {str(folder)!r}"
    for path in tried:
        if os.path.isfile(path):  # noqa: PTH113 - False for names that are too long, too
            return path
    raise DataError(f"expected the mesh {name!r}, found no such file; {remedy}")


def _tread(along: Array, distance: Array) -> tuple[float, float]:
    """Return the middle of a tread along the axis, and its tube radius, zero if it is flat [m]."""
    low, high = float(along.min()), float(along.max())
    middle, width, radius = (low + high) / 2, high - low, float(distance.max())
    central = np.abs(along - middle) <= 0.4 * width
    profile = zip((along[central] - middle).tolist(), distance[central].tolist(), strict=True)
    outline: list[tuple[float, float]] = []  # upper convex hull
    for a2, d2 in sorted(profile):
        while len(outline) > 1:
            (a0, d0), (a1, d1) = outline[-2:]
            if (a1 - a0) * (d2 - d0) < (d1 - d0) * (a2 - a0):  # the middle point is above the line
                break
            outline.pop()
        outline.append((a2, d2))
    if len(outline) < 4:
        return middle, 0.0
    # circle about (s, c) of radius t: 2 s a + 2 c d + (t^2 - s^2 - c^2) = a^2 + d^2
    a, d = np.transpose(outline)
    s, c, rest = np.linalg.lstsq(np.column_stack([2 * a, 2 * d, np.ones_like(a)]), a * a + d * d)[0]
    tube = float(np.sqrt(max(rest + s * s + c * c, 0.0)))
    error = np.abs(np.hypot(a - s, d - c) - tube).max()
    if error > FIT * radius or tube > min(width, (1 + FIT) * radius):
        return middle, 0.0
    return middle, radius if tube > (1 - FIT) * radius else tube


def angles_to(axis: Array) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a frame whose z axis is a unit vector [rad]."""
    x, y, z = axis.tolist()
    return float(np.arctan2(-y, np.hypot(x, z))), float(np.arctan2(x, z)), 0.0


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
    files = MeshFiles(every, Path(tree.file).parent)
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
            if min(z for _, _, z in in_root.points) - in_root.radius < ground + TOUCH_HEIGHT:
                touching.append(link.name)
                continue
            reduced += [f"{link.name} {reduction}"] if reduction else []
            rotation, origin = tree.frames[owner]
            shapes[owner].append(placed(in_root, rotation.T, -rotation.T @ origin))
    notes = list[str]()
    if touching:
        notes.append(
            "collision shapes left out of the clearance, since they reach down to the ground of "
            f"the wheels: {', '.join(dict.fromkeys(touching))}"
        )
    if reduced:
        notes.append(f"collision shapes as points of hulls: {', '.join(reduced)}")
    if unread:
        why, *more = unread
        others = f" (and {len(more)} others)" if more else ""
        names = ", ".join(dict.fromkeys(unread.values()))
        notes.append(f"clearance without {names}: {why}{others}")
    return {owner: tuple(of_link) for owner, of_link in shapes.items()}, notes


def solids(shape: Geometry, files: MeshFiles) -> list[TriangleMesh | BodyShape]:
    """Return a shape in the frame of its link: a mesh, or shapes of bodies; see `MeshFiles`."""
    if isinstance(shape, MeshFile):
        return [files.triangles(shape)]
    return [_shape(part, np.eye(3), files)[0] for part in _parts(shape)]


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
    corners = np.unique(vertices, axis=0)
    if np.linalg.matrix_rank(corners - corners[0], tol=SAME) == 3:  # not all in a plane
        corners = corners[scipy.spatial.ConvexHull(corners).vertices]
    # the nearest convex combination: the heavy last row makes the weights sum to one
    heavy = 1e4 * float(np.ptp(corners, axis=0).max())
    chosen = np.unique((corners @ DIRECTIONS.T).argmax(axis=0)).tolist()
    while True:
        matrix = np.vstack([corners[chosen].T, np.full(len(chosen), heavy)])
        distance = np.array([scipy.optimize.nnls(matrix, [*p, heavy])[1] for p in corners])
        shrink = float(distance.max())
        if shrink <= SHRINK or len(chosen) >= MAX_CORNERS:
            return corners[chosen], shrink
        chosen.append(int(distance.argmax()))


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
