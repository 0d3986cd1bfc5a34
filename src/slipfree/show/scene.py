"""Scene in 3D: ground, vehicles with their poses, arrows, colours, and lines of a map.

Positions are in scene coordinates: map coordinates minus ``Scene.origin``, z up. Scenes are drawn
as a web page by `slipfree.show.viewer` and as a film by `slipfree.show.film`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from contourpy import contour_generator
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from scipy.spatial.transform import Rotation

from slipfree.core.errors import ModelError
from slipfree.core.facts import SCALES
from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory, stop_words
from slipfree.files.urdf.links import Robot, poses_on_map, wheel_name
from slipfree.geometry.regions import Region
from slipfree.models.samples import CLOSEST, FramePoses, has_friction, part_poses, wheel_poses
from slipfree.routing.traversability import extents, nodes_at, traversability
from slipfree.show import ground_drawing, meshes, style
from slipfree.show.ground_drawing import HEATMAP, Place, Window
from slipfree.show.style import FLAT, STEEP
from slipfree.terrain.base import Grid, Terrain
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.grid_ops import cut
from slipfree.terrain.solids import Prism
from slipfree.vehicle.sections import TriangleMesh
from slipfree.vehicle.tree import Joint, Vehicle, Wheel

BLOCKED = (120, 120, 120)  # colour of blocked nodes
LONGEST = 0.6  # length of the longest arrows [reach of the vehicle]
ROUND = (1, 1.5, 2, 3, 4, 5, 6, 8, 10)  # round scales of arrows, times a power of ten
FULL_SLIP = 0.1  # slip of an arrow of the length `LONGEST`, unless most are twice as long [m/s]
LEAST = {"slip": 1e-4, "force": 1e-3}  # arrows of smaller vectors are omitted [m/s, N]
UNITS = {"slip": "m/s", "force": "N"}
ARROWS = {"slip": (0, 0, 0), "force": (255, 0, 255)}  # different from the colours of runs
FAR = 20.0  # the camera follows vehicles on longer paths [reach of the vehicle]
WORLD = "/world"  # node with the scene; it moves when the camera follows a vehicle
Color = tuple[int, int, int]
Colors = npt.NDArray[np.uint8]
POST = 1.0  # height of the posts at places of a plan, above the names of vehicles [reach]
LIFT = 0.01  # height of lines above the ground, so that it does not hide them [reach]
CONTOURS, CELLS = 12, 8  # maximum number of contours, and of grid cells along the longer side
STEPS = (1, 2, 5, 10)  # round numbers, times a power of ten
SAMPLES = 240  # samples of a grid line
BESIDE = 0.03  # distance of its label from the ground [longer side of the drawn ground]
ARROW = 0.09  # length of the arrow to the north [longer side of the drawn ground]
PLAN_LINES = "keep-out", "path to follow", "places"  # lines that pictures have as well
GRAY, BROWN, RED = (70, 70, 70), (60, 40, 20), (190, 30, 30)
SIDE = 161  # maximum number of nodes of the drawn ground along an axis: 51 200 faces
MARGIN = 0.35  # margin of the drawn ground around the paths [extent of the paths]
NEXT = 3.0  # smallest margin [reach of the vehicle]
FINE = 0.125  # distance of nodes near the paths [reach of the vehicle]
SEEN = 0.1  # larger distances of wheels from the drawn ground cause a warning [wheel radius]
AROUND = 1.6  # half the width of the ground around the vehicle in a film [reach of the vehicle]
PLACE_COLOR = (0, 0, 0)  # of start, way-points and goal of a plan
PATH_COLOR = (120, 40, 140)  # of the path to follow; arrows of slip are black
CLOSEST_COLOR = (120, 0, 160)  # of the place where a body came closest to the ground
ROD, PLATE = 0.07, 0.12  # radius of rods, thickness of the platform [wheel radius]
NARROW = 0.55  # width of the platform [width of the vehicle]
TYRE = (90, 90, 90)
WHEELS = *style.PALETTE[1:], "#000000"  # of wheels in plots; the first motion has the other colour
LARGEST = 1e9  # value in plots over time
SAME = 1e-9  # smaller differences of grounds are rounding [m]


class Plotted(NamedTuple):
    """A quantity in the plots of a page; those whose large values are bad colour tracks."""

    name: str
    unit: str  # that of the plot
    least: float  # smallest upper end of the axis, in that unit
    most: float = np.inf  # largest upper end
    is_margin: bool = False  # whether small values are bad

    def words(self, low: float, high: float) -> str:
        """Return the range of the axis in words."""
        more = " or more" if high == self.most else ""
        low, high = (float(f"{end:.3g}") for end in (low, high))
        return f"{low:g} to {high:g} {self.unit}".rstrip() + more  # without exponents


PLOTTED = (
    Plotted("slip", "mm/s", 1.0),
    Plotted("utilisation", "%", 100.0, 300.0),
    Plotted("friction_needed", "", 1.0, 3.0),
    Plotted("sinkage", "mm", 1.0),
    Plotted("tip_over_margin", "deg", 10.0, is_margin=True),
    Plotted("clearance_body", "m", 0.1, is_margin=True),
    Plotted("clearance", "m", 0.1, 1.0, is_margin=True),
)


class Layer(NamedTuple):
    """A colouring of the ground, or of tracks."""

    name: str  # name of the quantity that determines the colour
    legend: str  # description of the range of values, with unit
    scale: tuple[Color, ...]  # colours of the scale from its lowest to its highest value
    colors: Colors  # shape (..., 3): red, green and blue of the vertices, or of samples


class Lines(NamedTuple):
    """Lines on the ground of a scene."""

    name: str  # displayed name, such as ``"contours"``
    legend: str  # description of the lines, such as their distance
    color: Color  # red, green and blue, from 0 to 255
    segments: Array  # shape (n, 2, 3): starts and ends of straight pieces, in scene coordinates [m]
    labels: tuple[tuple[str, Array], ...] = ()  # texts and their positions, shape (3,) [m]


class SceneGround(NamedTuple):
    """Ground of a scene."""

    mesh: TriangleMesh
    layers: tuple[Layer, ...]  # colourings to choose from
    shade: Array  # shape (n,): brightness of the vertices in a hillshade
    lines: tuple[Lines, ...] = ()  # lines on the surface: contours, grid, arrow to the north

    def colors(self, name: str) -> Colors:
        """Return the colours of the vertices in a layer, with hillshade."""
        colors = next(each.colors for each in self.layers if each.name == name)
        return np.asarray(np.rint(colors * self.shade[:, None]), dtype=np.uint8)


class SceneBody(NamedTuple):
    """A rigid body over time."""

    name: str  # name of the part or the wheel
    # meshes in the frame of the body, with their colours
    meshes: tuple[tuple[TriangleMesh, Color], ...]
    origins: Array  # shape (n, 3): origins of the body's frame in the scene [m]
    rotations: Array  # shape (n, 3, 3): from the body's frame to the scene

    @property
    def quaternions(self) -> Array:
        """Unit quaternions (w, x, y, z) of the rotations, shape (n, 4)."""
        return np.asarray(Rotation.from_matrix(self.rotations).as_quat()[:, [3, 0, 1, 2]])


class Arrows(NamedTuple):
    """Vectors at the contacts."""

    name: str  # of wheels over the ground, or of the ground on wheels: "slip" or "force"
    starts: Array  # shape (n, k, 3): starting points; NaN without contact [m]
    vectors: Array  # shape (n, k, 3): components in scene axes [m/s or N]


class Actor(NamedTuple):
    """One motion of one vehicle."""

    name: str
    color: Color  # red, green and blue of the platform, from 0 to 255
    t: Array  # shape (n,): times of the samples of bodies, contacts and arrows [s]
    bodies: tuple[SceneBody, ...]  # parts of the vehicle, the platform first, and wheels
    contacts: Array  # shape (n, k, 3): contact points; NaN without contact [m]
    arrows: tuple[Arrows, ...]  # slip and forces, if the motion has them
    ghost: bool = False  # whether the motion is a plan, which is drawn as wireframe
    stop: str = ""  # time and reason of an early stop, or outcome of an incomplete plan
    wheels: tuple[str, ...] = ()
    values: Mapping[str, Array] = {}  # quantities of `PLOTTED`, in their units, by name

    def at(self, times: float | Array) -> Actor:
        """Return the actor at given times [s], which are moved into the motion.

        Positions and vectors are linear between samples, rotations have a constant rate. Contacts
        that begin or end between two samples are those of the nearest sample.
        """
        t = np.clip(np.atleast_1d(times), self.t[0], self.t[-1])
        after = np.minimum(np.searchsorted(self.t, t), self.t.size - 1)
        before = np.maximum(after - 1, 0)
        step = self.t[after] - self.t[before]
        share = np.divide(t - self.t[before], step, out=np.ones_like(t), where=step > 0)
        nearest = np.where(share > 0.5, after, before)

        def between(values: Array) -> Array:
            part = share.reshape(-1, *[1] * (values.ndim - 1))
            mixed = (1 - part) * values[before] + part * values[after]
            return np.asarray(np.where(np.isfinite(mixed), mixed, values[nearest]))

        def turned(rotations: Array) -> Array:
            first, last = (Rotation.from_matrix(rotations[ends]) for ends in (before, after))
            turn = share[:, None] * (first.inv() * last).as_rotvec()
            return np.asarray((first * Rotation.from_rotvec(turn)).as_matrix())

        return self._replace(
            t=t,
            bodies=tuple(
                each._replace(origins=between(each.origins), rotations=turned(each.rotations))
                for each in self.bodies
            ),
            contacts=between(self.contacts),
            values={name: between(values) for name, values in self.values.items()},
            arrows=tuple(
                each._replace(starts=between(each.starts), vectors=between(each.vectors))
                for each in self.arrows
            ),
        )


class Backdrop(NamedTuple):
    """Ground of a film: plan view with all paths, and the surroundings of a vehicle."""

    draw: Callable[[Axes], Any]  # draws the ground on axes in map coordinates
    window: Window  # ends of this drawing in x, then in y, in map coordinates [m]
    # ``near(point, half, count)`` returns faces of the ground around a point, with ``count`` nodes
    # per side, and of the solids, each of shape (n, 4, 3) [m]
    near: Callable[[Array, float, int], tuple[Array, Array]]
    half: float  # half the width of the surroundings in the view of the vehicle [m]


class Entry(NamedTuple):
    """Entry of the legend: a part of the scene that can be hidden."""

    group: str  # "ground", "arrows" or "runs"
    name: str
    color: Color
    nodes: tuple[str, ...]  # names of its nodes in a page
    words: str = ""  # scale of arrows, distance of lines, or empty
    ghost: bool = False  # whether it is drawn as wireframe
    stop: str = ""  # time and reason of an early stop

    @property
    def label(self) -> str:
        """Name and words."""
        return f"{self.name}: {self.words}" if self.words else self.name


class Scene(NamedTuple):
    """Ground, motions and notes of a drawing."""

    ground: SceneGround
    actors: tuple[Actor, ...]
    origin: Array  # shape (3,): map coordinates of the scene's origin [m]
    reach: float  # radius of a circle around the largest vehicle [m]
    backdrop: Backdrop  # the ground in films
    scales: dict[str, float]  # length of an arrow per unit; zero without [m s/m, m/N]
    notes: tuple[str, ...]
    warnings: tuple[str, ...] = ()  # notes that are always shown

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Legend of lines on the ground, arrows with their scales, and motions."""
        runs = [f"{WORLD}/run {k}" for k, _ in enumerate(self.actors, 1)]
        lines = (
            Entry("ground", each.name, each.color, (f"{WORLD}/{each.name}",), each.legend)
            for each in self.ground.lines
        )
        words = "1 m of arrow length represents {:.4g} {}"
        arrows = (
            Entry("arrows", name, ARROWS[name], nodes, words.format(1 / scale, UNITS[name]))
            for name, scale in self.scales.items()
            if scale
            for nodes in [tuple(f"{run}/here/{name}" for run in runs)]
        )
        motions = (
            Entry("runs", each.name, each.color, (run,), ghost=each.ghost, stop=each.stop)
            for each, run in zip(self.actors, runs, strict=True)
        )
        return (*lines, *arrows, *motions)

    @property
    def plotted(self) -> dict[Plotted, tuple[float, float]]:
        """Quantities to plot, those of at least one motion, with the limits of their axes."""
        ends = dict[Plotted, tuple[float, float]]()
        for each in PLOTTED:
            known = [np.ravel(a.values[each.name]) for a in self.actors if each.name in a.values]
            values = np.concatenate([*known, np.zeros(1)])
            values = values[np.isfinite(values)]
            if values.size > 1:
                high = min(max(float(values.max()), each.least), each.most)
                ends[each] = min(float(values.min()), 0.0), high
        return ends

    def curves(self, plotted: Plotted) -> Iterator[tuple[str, str, Array, Array]]:
        """Yield name, colour, times and values: of each wheel, or the worst of each motion."""
        actors = [actor for actor in self.actors if plotted.name in actor.values]
        for actor in actors:
            values = actor.values[plotted.name]
            if len(actors) > 1 or values.ndim == 1:
                worst = np.min if plotted.is_margin else np.max
                color = "#{:02x}{:02x}{:02x}".format(*actor.color)
                yield actor.name, color, actor.t, worst(values.reshape(len(values), -1), axis=1)
            else:
                for k, wheel in enumerate(actor.wheels):
                    yield style.words(wheel), WHEELS[k % len(WHEELS)], actor.t, values[:, k]

    def track_layers(self, actor: Actor) -> list[Layer]:
        """Return the colourings of the tracks of a motion, none of a vehicle at rest."""
        return [
            layer(each.name, actor.values[each.name], each.words(low, high), low, high)
            for each, (low, high) in self.plotted.items()
            if not each.is_margin and each.name in actor.values and actor.t.size > 1
        ]

    @property
    def paths(self) -> Array:
        """Positions of all platforms at all times, shape (n, 3) [m]."""
        return np.concatenate([actor.bodies[0].origins for actor in self.actors])

    @property
    def is_far(self) -> bool:
        """Whether the paths are so long that vehicles would be too small in a view of all paths."""
        return float(np.linalg.norm(np.ptp(self.paths, axis=0))) > FAR * self.reach

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of all motions [s]."""
        times = np.concatenate([actor.t for actor in self.actors])
        return float(times.min()), float(times.max())


def arrow_scales(actors: Sequence[Actor], reach: float) -> tuple[dict[str, float], list[str]]:
    """Return the lengths of arrows per unit, zero without arrows, and notes on missing arrows.

    Scales are round. That of slip depends on the size of the vehicle only, so that arrows of
    different motions can be compared, unless arrows would be longer than twice the length below
    which the scale of forces keeps nearly all arrows.
    """
    scales, notes = dict.fromkeys(LEAST, 0.0), []
    for name, least in LEAST.items():
        vectors = [each.vectors for actor in actors for each in actor.arrows if each.name == name]
        lengths = (np.linalg.norm(each, axis=-1).ravel() for each in vectors)
        sizes = np.concatenate([np.zeros(0), *lengths])
        sizes = sizes[np.isfinite(sizes)]
        if not sizes.size:
            notes.append(f"No {name} is drawn: the results contain no {name}.")
        elif sizes.max() < least:
            notes.append(f"No {name} is drawn: it is at most {sizes.max():.1e} {UNITS[name]}.")
        else:
            nearly = float(np.percentile(sizes, 99))
            longest = max(FULL_SLIP, nearly / 2) if name == "slip" else max(nearly, least)
            scales[name] = 1 / round_step(0.999 * longest / (LONGEST * reach), ROUND)
    return scales, notes


def rgb(name: str) -> Color:
    """Return red, green and blue, from 0 to 255, of a colour of Matplotlib."""
    red, green, blue = (round(255 * part) for part in to_rgb(name))
    return red, green, blue


def layer(name: str, values: Array, legend: str, low: float, high: float) -> Layer:
    """Return the colours of values of a quantity; ``low`` and ``high`` end the colour scale."""
    scale = style.HEIGHTS if name == "height" else style.RISK
    parts = np.clip((values - low) / max(high - low, style.FLAT), 0, 1)
    ends = tuple(rgb(scale(part)) for part in np.linspace(0, 1, 9))
    return Layer(name, legend, ends, scale(parts, bytes=True)[..., :3])


def map_lines(
    drawn: Grid, terrain: Terrain, window: Window, origin: Array, reach: float
) -> tuple[Lines, ...]:
    """Return contours, a grid of coordinates and the north arrow of the drawn ground.

    ``window`` has the ends of the drawn ground in x, then in y, and ``origin`` is the origin of the
    scene, both in map coordinates [m]; the lines are in scene coordinates. ``reach`` is the size of
    the vehicle, by which lines are lifted above the ground [m].
    """
    above = origin - np.array([0.0, 0.0, LIFT * reach])
    west, east, south, north = window
    long = max(east - west, north - south)
    step = round_step(long / CELLS)

    def draped(x: Array, y: Array) -> Array:
        x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
        z = np.where(drawn.touches(drawn.holes, x, y), np.nan, terrain.elevation(x, y))
        return np.stack([x, y, z], axis=-1)

    columns = step * np.arange(np.ceil(west / step), np.floor(east / step) + 1)
    rows = step * np.arange(np.ceil(south / step), np.floor(north / step) + 1)
    along_x, along_y = np.linspace(west, east, SAMPLES), np.linspace(south, north, SAMPLES)
    across = [*(draped(np.array(x), along_y) for x in columns)]
    across += [draped(along_x, np.array(y)) for y in rows]
    below, left = np.array([0.0, -BESIDE * long, 0.0]), np.array([-BESIDE * long, 0.0, 0.0])
    labels = [(f"x {x + 0.0:.10g} m", draped(x, np.array(south)) + below) for x in columns]
    labels += [(f"y {y + 0.0:.10g} m", draped(np.array(west), y) + left) for y in rows]
    segments = np.concatenate([np.zeros((0, 2, 3)), *map(_segments, across)])
    shown = tuple((words, place) for words, place in labels if np.isfinite(place).all())
    lines = [contours(drawn), Lines("grid", f"every {step:g} m", GRAY, segments, shown)]
    size = ARROW * long
    tip, head = np.array([east - 0.5 * size, north - 0.3 * size]), 0.3 * size
    outline = [[0, -size], [0, 0], [-0.4 * head, -head], [0, 0], [0.4 * head, -head]]
    corners = tip + np.array(outline)
    arrow = draped(corners[:, 0], corners[:, 1])
    arrow[:, 2] = np.nanmax(arrow[:, 2]) if np.isfinite(arrow[:, 2]).any() else drawn.values.max()
    lines.append(Lines("north", "to +y of the map", RED, _segments(arrow), (("N", arrow[1]),)))
    return tuple(
        each._replace(
            segments=each.segments - above,
            labels=tuple((words, place - above) for words, place in each.labels),
        )
        for each in lines
        if len(each.segments)
    )


def contours(drawn: Grid) -> Lines:
    """Return the contours of a ground at round heights, in map coordinates."""
    low, high = float(drawn.values.min()), float(drawn.values.max())
    step = round_step((high - low) / CONTOURS)
    if high - low < FLAT:
        return Lines("contours", "", BROWN, np.zeros((0, 2, 3)))
    mask = False if drawn.holes is None else drawn.holes.T
    generator: Any = contour_generator(drawn.x, drawn.y, np.ma.array(drawn.z.T, mask=mask))
    levels = step * np.arange(np.ceil(low / step), np.floor(high / step) + 1)
    segments = [
        _segments(np.column_stack([line, np.full(len(line), level)]))
        for level in levels
        for line in generator.lines(level)
    ]
    legend = f"every {step:g} m of height"
    return Lines("contours", legend, BROWN, np.concatenate([np.zeros((0, 2, 3)), *segments]))


def round_step(least: float, steps: Sequence[float] = STEPS) -> float:
    """Return the smallest of round numbers times a power of ten that is at least a positive value.

    By default these numbers are 1, 2 and 5.
    """
    power = 10.0 ** np.floor(np.log10(max(least, FLAT / 10)))
    return float(next(power * step for step in steps if power * step >= least * (1 - 1e-9)))


def _segments(line: Array) -> Array:
    segments = np.stack([line[:-1], line[1:]], axis=1)
    return np.asarray(segments[np.isfinite(segments).all(axis=(1, 2))])


class Driven(NamedTuple):
    """A motion over terrain with its ground and vehicle."""

    name: str
    run: Trajectory
    terrain: Bicubic
    vehicle: Vehicle
    keep_out: tuple[Region, ...] = ()  # of a plan
    places: tuple[Place, ...] = ()  # start, way-points and goal of a plan
    areas: Mapping[str, Window] = {}  # of places that are no points, by name
    wanted: Array | None = None  # points of the path that a driver follows, shape (n, 2)
    plan: Trajectory | None = None  # the plan that the motion simulates, with contact points
    prisms: tuple[Prism, ...] = ()  # solids on the ground
    robot: Robot | None = None  # URDF of the vehicle; None without one
    visuals: Mapping[str, TriangleMesh] = {}  # of links of the URDF, in their frames, by name


def drive_scene(drives: Sequence[Driven], *, with_poses: bool = False) -> Scene:
    """Return the scene of motions over the ground of the first; other grounds are a ModelError.

    The ground can also have colours of the poses of the first vehicle, which take a while.
    """
    first, grid = drives[0], drives[0].terrain.grid
    reach = max(extents(drive.vehicle)[2] for drive in drives)
    window = _window(drives, grid, reach)
    x, y, z = ground_drawing.patch(grid, window, SIDE)
    if (holes := np.isnan(z)).any():
        drawn = Grid(x, y, first.terrain.elevation(x[:, None], y), holes=holes)
    else:
        drawn = Grid(x, y, z)
    ways = [np.stack([run["x"], run["y"]], axis=1) for run in _runs(drives)]
    fine = meshes.surface(drawn, first.terrain, ways, NEXT * reach, FINE * reach)
    origin = np.round([x.mean(), y.mean(), drawn.values.mean()])
    poses = [_pose_layer(drawn, first, window)] if with_poses else []
    low, high = float(drawn.values.min()), float(drawn.values.max())
    slope = np.degrees(np.arctan(np.hypot(*np.gradient(drawn.z, *drawn.spacing)))).ravel()
    layers = [
        each._replace(colors=np.rint(fine.interpolated(each.colors.astype(float))).astype(np.uint8))
        for each in (
            layer("height", drawn.z.ravel(), f"{low:.4g} to {high:.4g} m", low, high),
            layer("slope", slope, f"0 to {STEEP:g} deg and more", 0.0, STEEP),
            *poses,
        )
    ]
    warnings = [*_off(drives, fine, SEEN), *_others(drives), *_missing(drives)]
    (h_x, h_y), (d_x, d_y) = grid.spacing, fine.grid.spacing
    size, whole = (f"{np.ptp(g.x):.4g} x {np.ptp(g.y):.4g} m" for g in (fine.grid, grid))
    near = f" ({fine.spacing:.3g} m near the paths)" if fine.spacing < max(d_x, d_y) else ""
    cropped = (
        f"Drawn ground: {size} of {whole}, node spacing {d_x:.3g} x {d_y:.3g} m{near}; "
        f"node spacing of the map {h_x:.3g} x {h_y:.3g} m."
    )
    notes = [cropped, *_off(drives, fine, 0.0)]
    solids = list[TriangleMesh]()
    for prism in first.prisms:  # above the lowest drawn ground
        if found := ground_drawing.in_window(prism, window, drawn.values.min()):
            corners, (right, left) = found
            away = np.array([prism.x, prism.y, prism.z]) - origin
            outline = np.insert(corners, 1, right, axis=1) @ prism.axes.T + away
            solids.append(meshes.extruded(outline, (left - right) * prism.axes[:, 1]))
    shade = fine.interpolated(ground_drawing.brightness(x, y, drawn.z).reshape(-1, 1)).ravel()
    closest = list[Lines]()  # vertical lines where bodies came closest to the ground
    if places := [each.run.facts[CLOSEST] for each in drives if CLOSEST in each.run.facts]:
        feet = np.array([[each.value[axis] for axis in "xyz"] for each in places]) - origin
        posts, labels = _posts(feet, reach, [each.words for each in places])
        closest.append(Lines("closest", "bodies above the ground", CLOSEST_COLOR, posts, labels))
    plan = _plan_lines(first, window, origin, reach)
    lines = (*map_lines(drawn, first.terrain, window, origin, reach), *closest, *plan)
    gray = np.tile(np.array(BLOCKED, np.uint8), (sum(len(each.vertices) for each in solids), 1))
    ground = SceneGround(
        meshes.joined(fine.mesh(origin), *solids),
        tuple(each._replace(colors=np.concatenate([each.colors, gray])) for each in layers),
        np.append(shade, np.ones(len(gray))),
        lines,
    )
    backdrop = _backdrop(first, window, origin, reach, solids)
    actors = []
    for k, drive in enumerate(drives):
        actors.append(_actor(drive, drive.run, drive.name, k, origin))
        if drive.plan is not None:
            name = f"{drive.name}: plan"
            actors.append(_actor(drive, drive.plan, name, k + len(drives), origin, ghost=True))
    scales, missing = arrow_scales(actors, reach)
    place = ", ".join(f"{value + 0.0:.10g}" for value in origin)  # no minus zero
    notes += [f"The origin of the scene is ({place}) m in map coordinates.", *missing]
    words = tuple(notes), tuple(warnings)
    return Scene(ground, tuple(actors), origin, reach, backdrop, scales, *words)


def _posts(
    feet: Array, height: float, words: Iterable[str]
) -> tuple[Array, tuple[tuple[str, Array], ...]]:
    """Return vertical lines on points, and their labels."""
    tops = feet + np.array([0.0, 0.0, height])
    return np.stack([feet, tops], axis=1), tuple(zip(words, tops, strict=True))


def _plan_lines(first: Driven, window: Window, origin: Array, reach: float) -> Iterator[Lines]:
    """Yield borders of keep-out regions, and posts at start, way-points and goal, of a plan."""

    def draped(points: Array) -> Array:  # within the drawn ground
        x, y = np.clip(points.T, *np.reshape(window, (2, 2)).T[..., None])
        z = first.terrain.elevation(x, y) + LIFT * reach
        return np.asarray(np.stack([x, y, z], axis=-1) - origin)

    borders = list[Array]()
    for region in first.keep_out:
        closed = np.concatenate([region.outline, region.outline[:1]])
        corners = np.arange(len(closed))
        at = np.linspace(0, corners[-1], 20 * len(closed))
        line = draped(np.stack([np.interp(at, corners, closed[:, k]) for k in (0, 1)], axis=1))
        borders.append(_segments(line))
    if borders:
        yield Lines(PLAN_LINES[0], "regions of the plan", RED, np.concatenate(borders))
    if first.wanted is not None:
        x, y, z = (first.run[name][0] for name in "xyz")
        line = draped(first.wanted) + np.array([0.0, 0.0, z - first.terrain.elevation(x, y)])
        ends = np.reshape(window, (2, 2)).T  # low, high
        line[((first.wanted < ends[0]) | (first.wanted > ends[1])).any(axis=1)] = np.nan
        yield Lines(PLAN_LINES[1], "of the driver", PATH_COLOR, _segments(line))
    if first.places:
        names, points = [place[0] for place in first.places], [place[1:] for place in first.places]
        posts, labels = _posts(draped(np.array(points)), POST * reach, names)
        yield Lines(PLAN_LINES[2], "of the plan", PLACE_COLOR, posts, labels)


def _backdrop(
    first: Driven, window: Window, origin: Array, reach: float, solids: Sequence[TriangleMesh]
) -> Backdrop:
    """Return the drawing of the ground on a map and its faces around a point.

    ``window`` has the ends of the map in x, then in y; ``origin`` is that of the scene in map
    coordinates, ``reach`` the size of the vehicle. [m]
    """
    terrain = first.terrain
    blocks = [mesh.vertices[mesh.faces[:, [0, 1, 2, 2]]] for mesh in solids]

    def near(middle: Array, half: float, count: int) -> tuple[Array, Array]:
        """Return faces of ground and solids within ``half`` of a point, in scene coordinates."""
        ends = np.reshape(terrain.domain, (2, 2)).T  # low, high
        x, y = (
            np.clip(np.linspace(at - half, at + half, count) + start, low, high)
            for at, start, low, high in zip(middle, origin, *ends, strict=False)
        )
        x, y = np.meshgrid(x, y, indexing="ij")
        points = np.stack([x, y, terrain.elevation(x, y)], axis=-1) - origin
        corners = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
        faces = np.stack(corners, axis=2).reshape(-1, 4, 3)
        middle_x, middle_y, _ = np.moveaxis(faces.mean(axis=1) + origin, -1, 0)
        whole = ~terrain.grid.touches(terrain.grid.holes, middle_x, middle_y)
        return faces[whole], np.concatenate([faces[:0], *blocks])

    def draw(ax: Axes) -> Axes:
        ground_drawing.relief(*ground_drawing.patch(terrain.grid, window, HEATMAP), ax)
        ground_drawing.solids(first.prisms, ax)
        marks = first.keep_out, first.places, first.areas, first.wanted
        return ground_drawing.plan_marks(ax, *marks)

    return Backdrop(draw, window, near, AROUND * reach)


def _runs(drives: Sequence[Driven]) -> list[Trajectory]:
    return [run for drive in drives for run in (drive.run, drive.plan) if run is not None]


def _window(drives: Sequence[Driven], grid: Grid, reach: float) -> Window:
    """Return the part of the ground to draw: the surroundings of all paths, within the map."""
    x, y = (
        np.concatenate([np.append(run[name], run[f"contact_{name}"]) for run in _runs(drives)])
        for name in "xy"
    )
    around = ground_drawing.about(x, y, grid, MARGIN)
    path = float(x.min()), float(x.max()), float(y.min()), float(y.max())
    near = ground_drawing.padded(path, (NEXT * reach, NEXT * reach), grid)
    (west, south), (east, north) = np.minimum(around, near)[::2], np.maximum(around, near)[1::2]
    return float(west), float(east), float(south), float(north)


def _pose_layer(drawn: Grid, drive: Driven, window: Window) -> Layer:
    """Return the colouring by the poses of a vehicle, grey where no heading is possible."""
    terrain, reach = drive.terrain, extents(drive.vehicle)[2]
    wide_x, wide_y = (2 * reach + 3 * cell for cell in terrain.grid.spacing)
    near = ground_drawing.padded(window, (wide_x, wide_y), terrain.grid)
    part = Bicubic(cut(terrain.grid, near), terrain.center, terrain.mu)
    layers = traversability(part, drive.vehicle, keep_out=drive.keep_out)
    places = np.stack(np.meshgrid(drawn.x, drawn.y, indexing="ij"), axis=-1).reshape(-1, 2)
    costs = layers.cost[:, *nodes_at(layers, places)]
    least = costs.min(axis=0)
    free = np.isfinite(least)
    top = float(np.percentile(least[free], 99)) if free.any() else 1.0
    words = f"cost per metre of path in the best direction, 1 to {top:.3g}; grey: blocked"
    colored = layer("traversability", np.where(free, least, 1.0), words, 1.0, top)
    colored.colors[~free] = BLOCKED
    return colored


def _actor(
    drive: Driven, run: Trajectory, name: str, k: int, origin: Array, ghost: bool = False
) -> Actor:
    """Return a vehicle with its arrows and values; those of a ghost are left out.

    ``k`` is the number of its colour, ``origin`` that of the scene in map coordinates [m].
    """
    vehicle, color = drive.vehicle, rgb(style.PALETTE[k % len(style.PALETTE)])
    contacts = np.stack([run[f"contact_{axis}"] for axis in "xyz"], axis=-1)
    parts, wheels = part_poses(vehicle, run), wheel_poses(vehicle, run)
    bodies = [*_part_bodies(vehicle, parts, wheels, color)]
    for number, wheel in enumerate(vehicle.wheels):
        looks = [(wheel.section.mesh(), TYRE), (meshes.spokes(wheel.radius * 0.97), color)]
        if wheel.rollers:
            looks.append((meshes.roller_axles(wheel.radius, wheel.rollers), color))
        pose = wheels.origins[:, number], wheels.rotations[:, number]
        bodies.append(SceneBody(wheel.name, tuple(looks), *pose))
    if drive.robot is not None and drive.visuals and not ghost:
        bodies = [*_with_visuals(bodies, drive, drive.robot, color)]
    arrows = [] if ghost else _arrows(run, drive, contacts, wheels.rotations[..., 0])
    values = {} if ghost else _plotted(run)
    return Actor(
        name,
        color,
        run.t,
        tuple(b._replace(origins=b.origins - origin) for b in bodies),
        contacts - origin,
        tuple(a._replace(starts=a.starts - origin) for a in arrows),
        ghost,
        stop_words(run),
        run.wheels,
        values,
    )


def _plotted(run: Trajectory) -> dict[str, Array]:
    """Return the quantities of a motion for the plots of a page, in the units of the plots."""
    values = {name: run[name] for name in run}
    if "slip_along" in run:
        values["slip"] = np.hypot(run["slip_along"], run["slip_across"])
    if "utilisation" in run:
        del values["friction_needed" if has_friction(run) else "utilisation"]
    # infinite values cannot be interpolated
    return {
        each.name: np.minimum(SCALES.get(each.unit, 1.0) * values[each.name], LARGEST)
        for each in PLOTTED
        if each.name in values
    }


def _part_bodies(
    vehicle: Vehicle, parts: FramePoses, wheels: FramePoses, color: Color
) -> Iterable[SceneBody]:
    """Yield the bodies of platform and joints: plates, and rods to their joints and wheels."""
    radius = max(wheel.radius for wheel in vehicle.wheels)
    names = ["platform", *(joint.name for joint in vehicle.joints)]
    spans = _plate_spans(vehicle, parts, wheels)
    for number, name in enumerate(names):
        origins, rotations = parts.origins[:, number], parts.rotations[:, number]
        carried: list[Joint | Wheel] = [*vehicle.joints, *vehicle.wheels]
        ends = [np.array(each.at) for each in carried if each.parent == name]
        for joint in vehicle.joints:
            if joint.parent == name and joint.motion == "slide":
                away = parts.origins[:, names.index(joint.name)] - origins
                places = np.einsum("nji,nj->ni", rotations, away)
                ends += [places.min(axis=0), places.max(axis=0)]
        thick = ROD * radius
        forms = [meshes.rod(np.zeros(3), end, thick) for end in ends if np.linalg.norm(end) > thick]
        shapes = [shape for part, shape in vehicle.shapes if part == name]
        forms += map(meshes.shape_mesh, shapes)
        if name in spans and not vehicle.shapes:
            away = wheels.origins[0] - origins[0]
            half = NARROW * float(np.abs((away @ rotations[0])[:, 0]).max())
            forms.append(meshes.plate(half, *spans[name], PLATE * radius))
        if forms or name == "platform":  # which is the first body, as the path is its path
            looks = ((meshes.joined(*forms), color),) if forms else ()
            yield SceneBody(name, looks, origins, rotations)


def _plate_spans(
    vehicle: Vehicle, parts: FramePoses, wheels: FramePoses
) -> dict[str, tuple[float, float]]:
    """Return the rear and the front end of the plates of an articulated vehicle, by part [m].

    The platform has a plate, and each joint that carries wheels on both sides, all ahead of it or
    all behind it: one half of a frame steered in the middle.
    """
    base = parts.rotations[0, 0]
    places, joints = ((each.origins[0] - parts.origins[0, 0]) @ base for each in (wheels, parts))
    radius = max(wheel.radius for wheel in vehicle.wheels)
    halves, above = dict[tuple[bool, ...], int](), {"platform": {"platform"}}
    for joint in vehicle.joints:  # parents before children
        above[joint.name] = above[joint.parent] | {joint.name}
    for number, joint in enumerate(vehicle.joints, 1):
        carried = tuple(joint.name in above[each.parent] for each in vehicle.wheels)
        x, y, _ = places[list(carried)].T
        away = y - joints[number, 1]
        if x.size and x.min() < 0 < x.max() and max(away.min(), -away.max()) > radius:
            halves[carried] = number  # of several joints in a row, the last one
    own = ~np.any([*halves, (False,) * len(places)], axis=0)
    ends = np.append(places[own, 1], joints[list(halves.values()), 1])
    spans = {"platform": (float(ends.min()), float(ends.max()))}
    for carried, number in halves.items():
        away = places[list(carried), 1] - joints[number, 1]
        span = float(away.min(initial=0)), float(away.max(initial=0))
        spans[vehicle.joints[number - 1].name] = span
    return spans


def _with_visuals(
    bodies: Iterable[SceneBody], drive: Driven, robot: Robot, color: Color
) -> Iterable[SceneBody]:
    """Yield links with meshes, and bodies that these do not replace.

    They replace their wheels; those of the root, or of links fixed to it, replace all other parts.
    """
    vehicle, base, names = drive.vehicle, {robot.tree.root}, {w.name for w in drive.vehicle.wheels}
    for joint in robot.tree.joints.values():
        base |= {joint.child} if joint.type == "fixed" and joint.parent in base else set()
        names -= {wheel_name(joint.name)} if joint.child in drive.visuals else set()
    if base.isdisjoint(drive.visuals):  # wheels would float
        names |= {"platform", *(joint.name for joint in vehicle.joints)}
    for body in bodies:
        if body.name == "platform" or body.name in names:
            yield body._replace(meshes=body.meshes if body.name in names else ())
    for link in poses_on_map(drive.run, vehicle, robot):
        if mesh := drive.visuals.get(link.child):
            looks = ((meshes.outward(mesh), color),)
            yield SceneBody(link.child, looks, link.origins, link.rotation.as_matrix())


def _arrows(run: Trajectory, drive: Driven, contacts: Array, axles: Array) -> list[Arrows]:
    """Return arrows of slip and force in axes of the contact: along, across, normal."""
    normals = ground_normals(drive.terrain, contacts)
    height = drive.terrain.elevation(contacts[..., 0], contacts[..., 1])
    nearest = np.abs(contacts[..., 2] - height)
    for prism in drive.prisms:
        away, outward = prism.distance(contacts)
        normals = np.where((np.abs(away) < nearest)[..., None], outward, normals)
        nearest = np.minimum(nearest, np.abs(away))
    along = np.cross(normals, axles)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    frame = {"along": along, "across": np.cross(along, normals), "normal": normals}
    arrows = []
    for name, directions in (("slip", ("along", "across")), ("force", tuple(frame))):
        if {f"{name}_{each}" for each in directions} <= run.columns.keys():
            vectors = sum(run[f"{name}_{each}"][..., None] * frame[each] for each in directions)
            arrows.append(Arrows(name, contacts, np.asarray(vectors)))
    return arrows


def ground_normals(terrain: Bicubic, points: Array) -> Array:
    """Return the upward unit normals of a ground at map points; both have the shape (..., 3)."""
    dz_dx, dz_dy = ground_drawing.gradient(terrain, points[..., 0], points[..., 1])
    normals = np.stack([-dz_dx, -dz_dy, np.ones_like(dz_dx)], axis=-1)
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def _off(drives: Sequence[Driven], fine: meshes.Surface, least: float) -> Iterable[str]:
    """Yield a note on the vertical distance of the drawn ground from the contact points."""
    off = max(
        float(np.abs(fine.height(x, y) - drive.terrain.elevation(x, y)).max())
        for drive in drives
        for x, y in [(drive.run["contact_x"], drive.run["contact_y"])]
    )
    radius = min(wheel.radius for drive in drives for wheel in drive.vehicle.wheels)
    if off >= least * radius:
        sunk = ": wheels may appear below or above the ground" if off >= SEEN * radius else ""
        yield f"Drawn ground and contact points are at most {off:.2g} m apart{sunk}."


def _others(drives: Sequence[Driven]) -> Iterable[str]:
    """Yield notes on further motions; raise ModelError for those on another ground."""
    first = drives[0]
    west, east, south, north = first.terrain.domain
    for drive in drives[1:]:
        x, y = drive.run["contact_x"], drive.run["contact_y"]
        if x.min() < west or x.max() > east or y.min() < south or y.max() > north:
            raise ModelError(
                f"{drive.name}: expected a motion on the ground of {first.name}, found one that "
                "leaves it; show the results separately, or the result on the larger ground first"
            )
        apart = np.abs(first.terrain.elevation(x, y) - drive.terrain.elevation(x, y)).max()
        if apart > min(wheel.radius for wheel in drive.vehicle.wheels):
            raise ModelError(
                f"{drive.name}: expected a ground that differs from that of {first.name} by at "
                f"most the radius of a wheel, found {apart:.3g} m along the motion; show the "
                "results separately"
            )
        if apart > SAME:
            yield (
                f"The drawn ground is that of {first.name}; the ground of "
                f"{drive.name} differs from it by up to {apart:.3g} m along that motion."
            )


def _missing(drives: Iterable[Driven]) -> Iterable[str]:
    """Yield notes on links of URDFs whose shapes cannot be read."""
    for drive in drives:
        links = drive.robot.tree.links.values() if drive.robot is not None else ()
        names = (e.name for e in links if e.visuals and e.name not in drive.visuals)
        if missing := ", ".join(names):
            yield f"{drive.name} is drawn without the links {missing}, whose meshes cannot be read."
