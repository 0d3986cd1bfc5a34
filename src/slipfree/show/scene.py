"""Scene in 3D: ground, vehicles with their poses, arrows, colours, and lines of a map.

Positions are in scene coordinates: map coordinates minus ``Scene.origin``, z up. Scenes are drawn
as a web page by `slipfree.show.viewer` and as a film by `slipfree.show.film`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from contourpy import contour_generator
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from scipy.spatial.transform import Rotation

from slipfree.core.records import Array
from slipfree.geometry.mesh import TriangleMesh
from slipfree.show import style
from slipfree.show.ground_drawing import Window
from slipfree.show.style import FLAT
from slipfree.terrain.base import Grid, Terrain

BLOCKED = (120, 120, 120)  # colour of blocked nodes
LONGEST = 0.6  # length of the longest arrows [reach of the vehicle]
ROUND = (1, 1.5, 2, 3, 4, 5, 6, 8, 10)  # round scales of arrows, times a power of ten
FULL_SLIP = 0.1  # slip of an arrow of the length `LONGEST`, in all scenes [m/s]
LEAST = {"slip": 1e-4, "force": 1e-3}  # arrows of smaller vectors are omitted [m/s, N]
UNITS = {"slip": "m/s", "force": "N"}
MAPS = {"height": "viridis", "slope": "cividis", "traversability": "YlGnBu_r"}
ARROWS = {"slip": (0, 0, 0), "force": (255, 0, 255)}  # different from the colours of runs
FAR = 20.0  # the camera follows vehicles on longer paths [reach of the vehicle]
WORLD = "/world"  # node with the scene; it moves when the camera follows a vehicle
Color = tuple[int, int, int]
Colors = npt.NDArray[np.uint8]
LIFT = 0.01  # height of lines above the ground, so that it does not hide them [reach]
CONTOURS, CELLS = 12, 8  # maximum number of contours, and of grid cells along the longer side
STEPS = (1, 2, 5, 10)  # round numbers, times a power of ten
SAMPLES = 240  # samples of a grid line
ARROW = 0.09  # length of the arrow to the north [longer side of the drawn ground]
PLAN_LINES = "keep-out", "places"  # lines that pictures have as well
GRAY, BROWN, RED = (70, 70, 70), (60, 40, 20), (190, 30, 30)


class Plotted(NamedTuple):
    """A quantity in the plots of a page; those whose large values are bad colour tracks."""

    name: str
    unit: str  # that of the plot
    least: float  # smallest upper end of the axis, in that unit
    most: float = np.inf  # largest upper end
    is_margin: bool = False  # whether small values are bad


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
    meshes: tuple[
        tuple[TriangleMesh, Color], ...
    ]  # meshes in the frame of the body, with their colours
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
    # ``near(point, half, count)`` returns faces of the ground around a point, each of shape (n, 3)
    # [m], with ``count`` nodes per side
    near: Callable[[Array, float, int], Sequence[Array]]
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
        arrows = (
            Entry(
                "arrows",
                name,
                ARROWS[name],
                tuple(f"{run}/here/{name}" for run in runs),
                f"1 m of arrow length represents {1 / scale:.4g} {UNITS[name]}",
            )
            for name, scale in self.scales.items()
            if scale
        )
        motions = (
            Entry("runs", each.name, each.color, (run,), ghost=each.ghost, stop=each.stop)
            for each, run in zip(self.actors, runs, strict=True)
        )
        return (*lines, *arrows, *motions)

    @property
    def plotted(self) -> dict[Plotted, tuple[float, float]]:
        """Quantities that motions have, with the ends of their axes."""
        ends = dict[Plotted, tuple[float, float]]()
        for each in PLOTTED:
            known = [np.ravel(a.values[each.name]) for a in self.actors if each.name in a.values]
            values = np.concatenate([*known, np.zeros(1)])
            values = values[np.isfinite(values)]
            if values.size > 1:
                high = min(max(float(values.max()), each.least), each.most)
                ends[each] = min(float(values.min()), 0.0), high
        return ends

    def track_layers(self, actor: Actor) -> list[Layer]:
        """Return the colourings of the tracks of a motion."""
        return [
            layer(
                each.name,
                actor.values[each.name],
                f"{low:.3g} to {high:.3g} {each.unit}",
                low,
                high,
            )
            for each, (low, high) in self.plotted.items()
            if not each.is_margin and each.name in actor.values
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
        return (
            min(float(actor.t[0]) for actor in self.actors),
            max(float(actor.t[-1]) for actor in self.actors),
        )


def arrow_scales(actors: Sequence[Actor], reach: float) -> tuple[dict[str, float], list[str]]:
    """Return the lengths of arrows per unit, zero without arrows, and notes on missing arrows.

    Scales are round. That of slip depends on the size of the vehicle only, so that arrows of
    different motions can be compared; that of forces keeps nearly all arrows below a length.
    """
    scales, notes = dict.fromkeys(LEAST, 0.0), []
    for name, least in LEAST.items():
        sizes = np.concatenate(
            [
                np.linalg.norm(each.vectors, axis=-1).ravel()
                for actor in actors
                for each in actor.arrows
                if each.name == name
            ]
            or [np.zeros(0)]
        )
        sizes = sizes[np.isfinite(sizes)]
        if not sizes.size:
            notes.append(f"No {name} is drawn: the results contain no {name}.")
        elif sizes.max() < least:
            notes.append(f"No {name} is drawn: it is at most {sizes.max():.1e} {UNITS[name]}.")
        else:
            longest = FULL_SLIP if name == "slip" else max(float(np.percentile(sizes, 99)), least)
            wanted = longest / (LONGEST * reach)  # per metre of arrow
            power = 10.0 ** np.floor(np.log10(wanted))
            step = min(step for step in ROUND if step * power >= wanted * 0.999)
            scales[name] = float(1 / (power * step))
    return scales, notes


def rgb(name: str) -> Color:
    """Return red, green and blue, from 0 to 255, of a colour of Matplotlib."""
    red, green, blue = (round(255 * part) for part in to_rgb(name))
    return red, green, blue


def layer(name: str, values: Array, legend: str, low: float, high: float) -> Layer:
    """Return the colours of values of a quantity; ``low`` and ``high`` end the colour scale."""
    scale = colormaps[MAPS[name]] if name in MAPS else style.RISK
    parts = np.clip((values - low) / max(high - low, style.FLAT), 0, 1)
    ends = tuple(rgb(scale(part)) for part in np.linspace(0, 1, 9))
    return Layer(name, legend, ends, scale(parts, bytes=True)[..., :3])


def map_lines(
    drawn: Grid, terrain: Terrain, window: Window, origin: Array, reach: float
) -> tuple[Lines, ...]:
    """Return contours, grid and north arrow of the ground within ``reach`` of the vehicle [m]."""
    above = origin - np.array([0.0, 0.0, LIFT * reach])
    lines = [contours(drawn), *_grid_and_north(drawn, terrain, window)]
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


def round_step(least: float) -> float:
    """Return the smallest of 1, 2 and 5 times a power of ten that is at least a positive value."""
    power = 10.0 ** np.floor(np.log10(max(least, FLAT / 10)))
    return float(next(power * step for step in STEPS if power * step >= least * (1 - 1e-9)))


def _grid_and_north(drawn: Grid, terrain: Terrain, window: Window) -> Iterable[Lines]:
    """Yield lines of equal coordinates, and the arrow to the north, in map coordinates."""
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
    lines = [*(draped(np.array(x), along_y) for x in columns)]
    lines += [draped(along_x, np.array(y)) for y in rows]
    labels = [(f"x {x + 0.0:.10g} m", draped(np.array(x), np.array(south))) for x in columns]
    labels += [(f"y {y + 0.0:.10g} m", draped(np.array(west), np.array(y))) for y in rows]
    segments = np.concatenate([np.zeros((0, 2, 3)), *map(_segments, lines)])
    shown = tuple((words, place) for words, place in labels if np.isfinite(place).all())
    yield Lines("grid", f"every {step:g} m", GRAY, segments, shown)
    size = ARROW * long
    tip, head = np.array([east - 0.5 * size, north - 0.3 * size]), 0.3 * size
    corners = tip + np.array(
        [[0, -size], [0, 0], [-0.4 * head, -head], [0, 0], [0.4 * head, -head]]
    )
    arrow = draped(corners[:, 0], corners[:, 1])
    arrow[:, 2] = np.nanmax(arrow[:, 2]) if np.isfinite(arrow[:, 2]).any() else drawn.values.max()
    yield Lines("north", "to +y of the map", RED, _segments(arrow), (("N", arrow[1]),))


def _segments(line: Array) -> Array:
    segments = np.stack([line[:-1], line[1:]], axis=1)
    return np.asarray(segments[np.isfinite(segments).all(axis=(1, 2))])
