"""What there is to draw of motions in space: ground, vehicles with their poses, arrows.

Everything is numbers in scene coordinates: map coordinates less ``Scene.origin``, z up. What draws
them is elsewhere: a web page in `slipfree.show.viewer`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from scipy.spatial.transform import Rotation

from slipfree.errors import ModelError
from slipfree.kinematics.poses import Placed, part_poses, wheel_poses
from slipfree.named import Array
from slipfree.plan.region import Region
from slipfree.plan.traversability import extents, nodes_at, traversability
from slipfree.show import relief, style
from slipfree.show.relief import Window
from slipfree.show.shapes import Mesh, joined, plate, rod, sheet, spokes, tyre
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.mend import cut
from slipfree.trajectory import Trajectory
from slipfree.vehicle.chain import Joint, Vehicle
from slipfree.vehicle.wheel import Wheel

SIDE = 161  # nodes of the drawn ground along an axis, at most: 51 200 faces
MARGIN = 0.35  # of the ground around the paths, in parts of their extent
NEXT = 3.0  # least margin, in parts of the vehicle's reach
ROD, PLATE = 0.07, 0.12  # radius of rods, thickness of the platform, in radii of the wheels
NARROW = 0.55  # width of the platform, in that of the vehicle
TYRE = (90, 90, 90)
BLOCKED = (120, 120, 120)  # where traversability says that the vehicle cannot be
LONGEST = 1.2  # length of the longest arrows, in parts of the vehicle's reach
LEAST = {"slip": 1e-6, "force": 1e-3}  # below which nothing is drawn [m/s, N]
UNITS = {"slip": "m/s", "force": "N"}
MAPS = {"height": "viridis", "slope": "cividis", "traversability": "YlGnBu_r"}
SAME = 1e-9  # difference of grounds that is none [m]
Color = tuple[int, int, int]
Colors = npt.NDArray[np.uint8]


class Layer(NamedTuple):
    """One way to color the ground.

    Attributes
    ----------
    name : str
        What the colors mean.
    legend : str
        The ends of the scale, with units.
    scale : tuple of 3-tuples
        Colors of the scale from its low end to its high one.
    colors : ndarray of uint8, shape (n, 3)
        Of every vertex.
    """

    name: str
    legend: str
    scale: tuple[Color, ...]
    colors: Colors


class Ground(NamedTuple):
    """The ground: a surface and the ways to color it."""

    mesh: Mesh
    layers: tuple[Layer, ...]


class Body(NamedTuple):
    """A rigid body over time.

    Attributes
    ----------
    name : str
        Of the part or the wheel.
    meshes : tuple of (Mesh, color)
        What it looks like, in its own frame.
    origins : ndarray, shape (n, 3)
        Of its frame. [m]
    rotations : ndarray, shape (n, 3, 3)
        Columns are its axes.
    """

    name: str
    meshes: tuple[tuple[Mesh, Color], ...]
    origins: Array
    rotations: Array

    @property
    def quaternions(self) -> Array:
        """Unit quaternions (w, x, y, z) of the rotations, shape (n, 4)."""
        return np.asarray(Rotation.from_matrix(self.rotations).as_quat()[:, [3, 0, 1, 2]])


class Arrows(NamedTuple):
    """Vectors at the contacts.

    Attributes
    ----------
    name : {"slip", "force"}
        Velocity of the wheels' material points over the ground, or force of the ground on them.
    starts : ndarray, shape (n, k, 3)
        Where they are drawn; NaN where there is no contact. [m]
    vectors : ndarray, shape (n, k, 3)
        In fixed axes. [m/s or N]
    """

    name: str
    starts: Array
    vectors: Array


class Actor(NamedTuple):
    """One motion of one vehicle.

    Attributes
    ----------
    name : str
        As it is shown.
    color : tuple of 3 ints
        Red, green, blue of its platform, from 0 to 255.
    t : ndarray, shape (n,)
        Times of all that follows. [s]
    bodies : tuple of Body
        Its parts, the platform first, and its wheels.
    contacts : ndarray, shape (n, k, 3)
        Contact points; NaN where there is none. [m]
    arrows : tuple of Arrows
        Slip and forces, as far as the motion has them.
    ghost : bool
        Whether it is a plan, which is drawn as its edges only.
    """

    name: str
    color: Color
    t: Array
    bodies: tuple[Body, ...]
    contacts: Array
    arrows: tuple[Arrows, ...]
    ghost: bool = False


class Scene(NamedTuple):
    """All there is to draw.

    Attributes
    ----------
    ground : Ground
        The ground.
    actors : tuple of Actor
        The motions.
    origin : ndarray, shape (3,)
        Map coordinates of the scene's origin. [m]
    reach : float
        Radius of a circle that holds the largest vehicle. [m]
    scales : dict of str to float
        Length of the arrows by name, for one unit of what they show. [m s/m, m/N]
    notes : tuple of str
        What to know about how it is drawn.
    """

    ground: Ground
    actors: tuple[Actor, ...]
    origin: Array
    reach: float
    scales: dict[str, float]
    notes: tuple[str, ...]

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of all motions [s]."""
        return (min(float(actor.t[0]) for actor in self.actors),
                max(float(actor.t[-1]) for actor in self.actors))  # fmt: skip


class Driven(NamedTuple):
    """A motion over terrain, and what it happened with.

    Attributes
    ----------
    name : str
        As it is to be shown.
    run : Trajectory
        The motion.
    terrain : Bicubic
        The ground.
    vehicle : Vehicle
        What moved.
    keep_out : tuple of Region
        Where a plan must not go.
    plan : Trajectory or None
        The plan that the motion simulates: poses and contact points.
    """

    name: str
    run: Trajectory
    terrain: Bicubic
    vehicle: Vehicle
    keep_out: tuple[Region, ...] = ()
    plan: Trajectory | None = None


def drive_scene(drives: Sequence[Driven]) -> Scene:
    """Return what to draw of motions over one ground, that of the first.

    Parameters
    ----------
    drives : sequence of Driven
        One or more.

    Raises
    ------
    ModelError
        If a motion lacks its poses or is not on the ground of the first one.
    """
    first, grid = drives[0], drives[0].terrain.grid
    reach = max(extents(drive.vehicle)[2] for drive in drives)
    window = _window(drives, grid, reach)
    x, y, z = relief.patch(grid, window, SIDE)
    drawn = Grid(x, y, z)
    origin = np.round([x.mean(), y.mean(), z.mean()])
    points = np.stack(np.broadcast_arrays(x[:, None], y[None, :], z), axis=-1)
    ground = Ground(sheet(points - origin), tuple(_layers(drawn, first, window)))
    actors = []
    for k, drive in enumerate(drives):
        actors.append(_actor(drive, drive.run, drive.name, k, origin))
        if drive.plan is not None:
            actors.append(
                _actor(
                    drive, drive.plan, f"{drive.name}: plan", k + len(drives), origin, ghost=True
                )
            )
    notes = [_cropped(grid, drawn), _off(drives, drawn), *_others(drives, drawn)]
    return framed(ground, actors, origin, reach, notes)


def framed(
    ground: Ground, actors: Iterable[Actor], origin: Array, reach: float, notes: Iterable[str]
) -> Scene:
    """Return a scene with the scales of its arrows."""
    actors = tuple(actors)
    scales = {name: _scale(name, actors, LONGEST * reach) for name in LEAST}
    place = ", ".join(f"{value:.10g}" for value in origin)
    told = [*notes, f"The scene's origin is ({place}) m on the map."]
    for name, scale in scales.items():
        if not scale:
            told.append(f"No {name} is drawn: {_why_none(name, actors)}.")
    return Scene(ground, actors, origin, reach, scales, tuple(told))


def color_of(k: int) -> Color:
    """Return the color of the k-th run, one of a palette for the color-blind."""
    return rgb(style.PALETTE[k % len(style.PALETTE)])


def rgb(name: str) -> Color:
    """Return red, green and blue from 0 to 255 of a color's name."""
    red, green, blue = (round(255 * part) for part in to_rgb(name))
    return red, green, blue


def layer(name: str, values: Array, legend: str, low: float, high: float) -> Layer:
    """Return a way to color vertices by values, shape (n,), on a scale between two of them."""
    scale = colormaps[MAPS[name]]
    parts = np.clip((values - low) / max(high - low, style.FLAT), 0, 1)
    ends = tuple(rgb(scale(part)) for part in np.linspace(0, 1, 9))
    return Layer(name, legend, ends, scale(parts, bytes=True)[:, :3])


def chassis(places: Array, radius: float) -> Mesh:
    """Return the platform of a vehicle whose wheels' centers are at places of its frame.

    Parameters
    ----------
    places : ndarray, shape (k, 3)
        In the platform's frame, x right, y forward. [m]
    radius : float
        Of the wheels. [m]
    """
    half = NARROW * float(np.abs(places[:, 0]).max())
    rear, front = float(places[:, 1].min()), float(places[:, 1].max())
    return plate(half, rear, front, PLATE * radius)


def _window(drives: Sequence[Driven], grid: Grid, reach: float) -> Window:
    """Return the part of the ground to draw: the surroundings of all paths, on the map."""
    runs = [run for drive in drives for run in (drive.run, drive.plan) if run is not None]
    x, y = (np.concatenate([np.append(run[name], run[f"contact_{name}"]) for run in runs])
            for name in "xy")  # fmt: skip
    around = relief.about(x, y, grid, MARGIN)
    least = [x.min() - NEXT * reach, x.max() + NEXT * reach,
             y.min() - NEXT * reach, y.max() + NEXT * reach]  # fmt: skip
    low, high = slice(0, None, 2), slice(1, None, 2)
    whole = np.array(relief.whole(grid))
    found = np.empty(4)
    found[low] = np.maximum(np.minimum(around[low], least[low]), whole[low])
    found[high] = np.minimum(np.maximum(around[high], least[high]), whole[high])
    west, east, south, north = (float(each) for each in found)
    return west, east, south, north


def _layers(drawn: Grid, drive: Driven, window: Window) -> Iterable[Layer]:
    """Yield the ways to color the ground."""
    low, high = float(drawn.z.min()), float(drawn.z.max())
    yield layer("height", drawn.z.ravel(), f"{low:.4g} to {high:.4g} m", low, high)
    slope = np.degrees(np.arctan(np.hypot(*np.gradient(drawn.z, *drawn.spacing)))).ravel()
    yield layer("slope", slope, f"0 to {slope.max():.3g} degrees", 0.0, float(slope.max()))
    yield _traversability(drawn, drive, window)


def _traversability(drawn: Grid, drive: Driven, window: Window) -> Layer:
    """Return what a metre of way costs the first vehicle, gray where it cannot be."""
    terrain, reach = drive.terrain, extents(drive.vehicle)[2]
    wide_x, wide_y = (2 * reach + 3 * cell for cell in terrain.grid.spacing)
    wide = (window[0] - wide_x, window[1] + wide_x, window[2] - wide_y, window[3] + wide_y)
    whole = relief.whole(terrain.grid)
    near = (max(wide[0], whole[0]), min(wide[1], whole[1]),
            max(wide[2], whole[2]), min(wide[3], whole[3]))  # fmt: skip
    part = Bicubic(cut(terrain.grid, near), terrain.center, terrain.mu)
    layers = traversability(part, drive.vehicle, keep_out=drive.keep_out)
    places = np.stack(np.meshgrid(drawn.x, drawn.y, indexing="ij"), axis=-1).reshape(-1, 2)
    cost = layers.cost[nodes_at(layers, places)]
    free = np.isfinite(cost)
    top = float(np.percentile(cost[free], 99)) if free.any() else 1.0
    legend = f"cost of a metre, 1 to {top:.3g}; gray: cannot be there"
    found = layer("traversability", np.where(free, cost, 1.0), legend, 1.0, top)
    found.colors[~free] = BLOCKED
    return found


def _actor(
    drive: Driven, run: Trajectory, name: str, k: int, origin: Array, ghost: bool = False
) -> Actor:
    """Return what to draw of a motion."""
    vehicle, color = drive.vehicle, color_of(k)
    parts, wheels = part_poses(vehicle, run), wheel_poses(vehicle, run)
    contacts = np.stack([run[f"contact_{axis}"] for axis in "xyz"], axis=-1)
    bodies = [*_parts(vehicle, parts, wheels, color), *_wheels(vehicle, wheels, color)]
    axles = wheels.rotations[..., 0]
    arrows = [] if ghost else _arrows(run, drive.terrain, contacts, axles)
    return Actor(
        name, color, run.t, tuple(b._replace(origins=b.origins - origin) for b in bodies),
        contacts - origin, tuple(a._replace(starts=a.starts - origin) for a in arrows), ghost,
    )  # fmt: skip


def _parts(
    vehicle: Vehicle, parts: Placed, wheels: Placed, color: Color
) -> Iterable[Body]:  # fmt: skip
    """Yield the platform and the parts of the joints, as rods to what they carry."""
    radius = max(wheel.radius for wheel in vehicle.wheels)
    names = ["platform", *(joint.name for joint in vehicle.joints)]
    for number, name in enumerate(names):
        origins, rotations = parts.origins[:, number], parts.rotations[:, number]
        carried: list[Joint | Wheel] = [*vehicle.joints, *vehicle.wheels]
        ends = [np.array(each.at) for each in carried if each.parent == name]
        for joint in vehicle.joints:
            if joint.parent == name and joint.motion == "slide":
                away = parts.origins[:, names.index(joint.name)] - origins
                places = np.einsum("nji,nj->ni", rotations, away)
                ends += [places.min(axis=0), places.max(axis=0)]
        meshes = [rod((0.0, 0.0, 0.0), end, ROD * radius) for end in ends
                  if np.linalg.norm(end) > ROD * radius]  # fmt: skip
        if name == "platform":
            away = wheels.origins[0] - origins[0]
            meshes.append(chassis(away @ rotations[0], radius))
        if meshes:
            yield Body(name, ((joined(*meshes), color),), origins, rotations)


def _wheels(vehicle: Vehicle, wheels: Placed, color: Color) -> Iterable[Body]:
    for k, wheel in enumerate(vehicle.wheels):
        looks = ((tyre(wheel.r1, wheel.r2), TYRE), (spokes(wheel.radius * 0.97), color))
        yield Body(wheel.name, looks, wheels.origins[:, k], wheels.rotations[:, k])


def _arrows(run: Trajectory, terrain: Bicubic, contacts: Array, axles: Array) -> list[Arrows]:
    """Return slip and forces, from their parts along, across and normal to the ground."""
    normals = ground_normals(terrain, contacts)
    along = np.cross(normals, axles)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    frame = {"along": along, "across": np.cross(along, normals), "normal": normals}
    found = []
    for name, directions in (("slip", ("along", "across")), ("force", tuple(frame))):
        if all(f"{name}_{each}" in run.columns for each in directions):
            vectors = sum(run[f"{name}_{each}"][..., None] * frame[each] for each in directions)
            found.append(Arrows(name, contacts, np.asarray(vectors)))
    return found


def ground_normals(terrain: Bicubic, points: Array) -> Array:
    """Return upward unit normals of a ground at points of it, shape (..., 3)."""
    slopes = []
    for axis, cell in enumerate(terrain.grid.spacing):
        step = 1e-3 * cell
        away = np.zeros(2)
        away[axis] = step
        ahead, behind = points[..., :2] + away, points[..., :2] - away
        rise = terrain.elevation(*np.moveaxis(ahead, -1, 0))
        rise = rise - terrain.elevation(*np.moveaxis(behind, -1, 0))
        slopes.append(rise / (2 * step))
    normals = np.stack([-slopes[0], -slopes[1], np.ones_like(slopes[0])], axis=-1)
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def _sizes(name: str, actors: Iterable[Actor]) -> Array:
    """Return the lengths of all vectors of a name that can be drawn."""
    found = [np.linalg.norm(each.vectors, axis=-1).ravel() for actor in actors
             for each in actor.arrows if each.name == name]  # fmt: skip
    sizes = np.concatenate([*found, np.zeros(0)])
    return np.asarray(sizes[np.isfinite(sizes)])


def _scale(name: str, actors: Iterable[Actor], longest: float) -> float:
    """Return a round scale at which nearly all arrows are no longer than given; zero if none."""
    sizes = _sizes(name, actors)
    if not sizes.size or sizes.max() < LEAST[name]:
        return 0.0
    wanted = longest / max(float(np.percentile(sizes, 99)), LEAST[name])
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1, 2, 5) if step * power <= wanted * 1.001))


def _why_none(name: str, actors: Iterable[Actor]) -> str:
    sizes = _sizes(name, actors)
    if not sizes.size:
        return "the results hold none"
    return f"it is {sizes.max():.1e} {UNITS[name]} at most"


def scale_words(scene: Scene, name: str) -> str:
    """Return what a metre of arrow means, as ``1 m is 0.02 m/s``; empty if there are none."""
    scale = scene.scales[name]
    return f"an arrow of 1 m is {1 / scale:.4g} {UNITS[name]}" if scale else ""


def _cropped(grid: Grid, drawn: Grid) -> str:
    (h_x, h_y), (d_x, d_y) = grid.spacing, drawn.spacing
    sizes = [f"{np.ptp(each.x):.4g} x {np.ptp(each.y):.4g} m" for each in (drawn, grid)]
    return (
        f"Ground drawn: {sizes[0]} of {sizes[1]}, a node every {d_x:.3g} x {d_y:.3g} m; "
        f"the map has one every {h_x:.3g} x {h_y:.3g} m."
    )


def _off(drives: Sequence[Driven], drawn: Grid) -> str:
    """Return in words how far the drawn ground is from the true one, where wheels touch it."""
    off = [np.abs(relief.height(drawn, run["contact_x"], run["contact_y"]) - run["contact_z"])
           for run in (drive.run for drive in drives[:1])]  # fmt: skip
    return f"Drawn ground and contact points are {np.nanmax(off):.2g} m apart at most."


def _others(drives: Sequence[Driven], drawn: Grid) -> Iterable[str]:
    """Yield in words how the ground of other motions differs from the one that is drawn."""
    x, y = np.meshgrid(drawn.x, drawn.y, indexing="ij")
    heights = drives[0].terrain.elevation(x, y)
    for drive in drives[1:]:
        west, east, south, north = drive.terrain.domain
        both = (x >= west) & (x <= east) & (y >= south) & (y <= north)
        if not both.any():
            raise ModelError(
                f"{drive.name} is on other ground than {drives[0].name}: show them one by one"
            )
        apart = float(np.abs(drive.terrain.elevation(x, y) - heights)[both].max())
        if apart > SAME:
            yield (f"The ground is that of {drives[0].name}; that of {drive.name} differs by "
                   f"{apart:.3g} m at most.")  # fmt: skip
