"""Drawings of the ground in plan view, and of motions over solids from the side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle

from slipfree.core.errors import ModelError
from slipfree.core.lookups import LookupTable, lookup_function
from slipfree.core.records import Array, Mask
from slipfree.core.trajectory import Trajectory
from slipfree.geometry.regions import Region
from slipfree.show import style
from slipfree.show.meshes import clipped
from slipfree.show.plots import Plot, PlottedDrive
from slipfree.show.style import COLUMN, MM, PAGE
from slipfree.terrain.base import Grid, Terrain
from slipfree.terrain.bicubic import basis, coefficients_of
from slipfree.terrain.solids import Prism, Profile, section_of

HEATMAP = 601  # samples of a drawn map along an axis
DIGITS = 9  # decimals of drawn heights, so that flat ground looks flat [m]
STEEP_SHADE, MAX_EXAGGERATION = 0.7, 20.0  # exaggerated slope of steep parts, largest factor
LEVEL, DARKEST = 0.9, 0.45  # brightness of level ground and of the darkest slopes
LIGHT = np.array([-0.5, 0.5, np.sqrt(0.5)])  # direction to the light: north-west, 45 degrees high
HATCH = "//////"
TALLEST = 152 * MM  # height of figures of maps [in]
INSIDE = 0.44  # largest distance of text on a map from its middle [width of the map]

SOLID: dict[str, Any] = {"fc": (0.55, 0.55, 0.55, 0.45), "ec": "black", "lw": 0.8, "zorder": 2}

Window = tuple[float, float, float, float]
Place = tuple[str, float, float]
MARKERS = {"start": ("o", 5), "goal": ("*", 9)}  # shapes and sizes of places of a plan [points]
WAY_POINT = "D", 4
FAR = 0.6  # of a motion with a smaller extent only a part of the map is drawn [map]
POSES = 8  # number of drawn positions of the vehicle
ROOM = 0.04  # margin around the motion [m]
LATEST = 0.85  # used part of the colour scale: its yellow end is too light for lines


def extent(x: Array, y: Array) -> dict[str, Any]:
    """Return arguments of ``imshow`` for an image of values at nodes with coordinates x, y [m]."""
    dx, dy = (x[-1] - x[0]) / (x.size - 1), (y[-1] - y[0]) / (y.size - 1)
    return {
        "extent": (x[0] - dx / 2, x[-1] + dx / 2, y[0] - dy / 2, y[-1] + dy / 2),
        "origin": "lower",
        "interpolation": "bilinear",
    }


def relief(x: Array, y: Array, z: Array, ax: Axes) -> ScalarMappable:
    """Draw heights z, shape (n_x, n_y), in colours with a hillshade, and return their scale."""
    low, high = np.nanmin(z), np.nanmax(z)
    scale = ScalarMappable(Normalize(low, max(high, low + style.FLAT)), style.HEIGHTS)
    scale.set_array(z.T)
    colors = scale.to_rgba(z.T)
    colors[..., :3] *= np.nan_to_num(brightness(x, y, z).T)[..., None]
    colors[..., 3] = np.isfinite(z.T)  # nothing over holes
    ax.imshow(colors, **extent(x, y))
    map_axes(x, y, ax)
    return scale


def map_axes(x: Array, y: Array, ax: Axes) -> Axes:
    """Limit axes of equal scale to the nodes of a map with coordinates x, y [m]; label them."""
    ax.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]), aspect="equal")
    style.position_axis(ax.xaxis, "x", x[0])
    style.position_axis(ax.yaxis, "y", y[0])
    return ax


def brightness(x: Array, y: Array, z: Array) -> Array:
    """Return the brightness of nodes in a hillshade, shape (n_x, n_y); flat ground has `LEVEL`.

    The light comes from the north-west in all pictures of a ground. Heights are exaggerated so
    that the steep parts appear to slope by about 35 degrees.
    """
    slopes = np.gradient(z, x, y)
    steep = float(np.nanpercentile(np.hypot(*slopes), 95))
    factor = np.clip(STEEP_SHADE / max(steep, 1e-9), 1.0, MAX_EXAGGERATION)
    dz_dx, dz_dy = (factor * slope for slope in slopes)
    normals = np.stack([-dz_dx, -dz_dy, np.ones_like(z)], axis=-1)
    facing = normals @ LIGHT / np.linalg.norm(normals, axis=-1)
    return np.asarray(np.clip(LEVEL + facing - LIGHT[2], DARKEST, 1.0))


def muted(grid: Grid, ax: Axes, window: Window) -> Axes:
    """Draw a part of the ground in pale colours, below coloured content."""
    relief(*patch(grid, window, HEATMAP), ax)
    return contours(grid, ax, window)


def contours(grid: Grid, ax: Axes, window: Window) -> Axes:
    """Draw contour lines of a part of the ground with their heights, on axes of equal scale."""
    x, y, z = patch(grid, window, HEATMAP)
    map_axes(x, y, ax)
    if np.nanmax(z) > np.nanmin(z):
        # samples are little more than a pixel apart: every second one suffices for lines
        made = ax.contour(x[::2], y[::2], z.T[::2, ::2], 10, colors="0.5", linewidths=0.4, zorder=1)
        look: dict[str, Any] = {"fontsize": 5, "fmt": "%g m", "inline_spacing": 2, "zorder": 3.5}
        for words in ax.clabel(made, np.asarray(made.levels)[::2], colors="0.15", **look):
            words.set_path_effects(style.halo(1.5))
            inside = ax.transAxes.inverted().transform(ax.transData.transform(words.get_position()))
            words.set_visible(bool(np.all(np.abs(inside - 0.5) < INSIDE)))
    return ax


def solids(prisms: Sequence[Prism], ax: Axes) -> Axes:
    """Draw the outlines of solids and of their faces above the ground, in plan view."""
    window = *ax.get_xlim(), *ax.get_ylim()
    for prism in prisms:
        if (found := in_window(prism, window, prism.z)) is None:
            continue
        corners, sides = found
        axes, place = prism.axes[:2, :2], np.array([prism.x, prism.y])
        for first, last in pairwise(np.unique(np.round(corners[:, 0], DIGITS)).tolist()):
            face = np.array([(u, v) for u in (first, last) for v in sides])[[0, 1, 3, 2]]
            outline = Polygon(face @ axes.T + place, label="solids", **SOLID)
            outline.set_path_effects(style.halo(2.0))
            ax.add_patch(outline)
    return ax


def plan_marks(
    ax: Axes,
    keep_out: Sequence[Region] = (),
    places: Sequence[Place] = (),
    areas: Mapping[str, Window] = {},
    wanted: Array | None = None,
) -> Axes:
    """Draw keep-out regions, start, way-points and goal of a plan in plan view, within the axes.

    ``places`` are names, x and y; those with an area by their name in ``areas`` are drawn as areas.
    ``wanted`` are the points of the path that a driver follows, shape (n, 2), None without one.
    """
    west, east, south, north = *ax.get_xlim(), *ax.get_ylim()
    if wanted is not None:
        ax.plot(*wanted.T, color="black", ls=(0, (4, 2)), lw=1.0, zorder=2, label="path to follow")
    for region in keep_out:
        x_min, x_max, y_min, y_max = region.bounds
        if x_min < east and x_max > west and y_min < north and y_max > south:
            looks: dict[str, Any] = {"fill": False, "ec": "black", "lw": 1.0, "hatch": "////"}
            ax.add_patch(Polygon(region.outline, label="keep-out region", zorder=2, **looks))
    for name, (x_min, x_max, y_min, y_max) in areas.items():
        look: dict[str, Any] = {"fill": False, "ls": "--", "lw": 1.0, "zorder": 4, "label": name}
        outline = Rectangle((x_min, y_min), x_max - x_min, y_max - y_min, **look)
        outline.set_path_effects(style.halo(2.2))
        ax.add_patch(outline)
    for name, x, y in (place for place in places if place[0] not in areas):
        shape, size = MARKERS.get(name, WAY_POINT)
        marks: dict[str, Any] = {"ls": "none", "mfc": "white", "mec": "black", "zorder": 6}
        ax.plot(x, y, shape, ms=size, label=name, **marks)
    return ax


def map_figure(x: Array, y: Array, grid: Grid, pad: float) -> tuple[Figure, Axes, Window]:
    """Return a figure of a map, to be cropped, its axes, and its window around positions [m].

    The window is that of `about`, or the whole ground unless this is much larger.
    """
    window, (west, east, south, north) = about(x, y, grid, pad), grid.domain
    width, height = window[1] - window[0], window[3] - window[2]
    if max(width / (east - west), height / (north - south)) >= FAR:
        window = grid.domain
    figure = style.figure(COLUMN, TALLEST)
    return figure, figure.subplots(), window


def in_window(
    prism: Prism, window: Window, bottom: float
) -> tuple[Array, tuple[float, float]] | None:
    """Return corners of the section above ``bottom``, and sides, of the part near a window [m]."""
    west, east, south, north = window
    reach = float(np.hypot(east - west, north - south)) / 2
    away = (west + east) / 2 - prism.x, (south + north) / 2 - prism.y
    along, right = away @ prism.axes[:2, :2]
    low = along - reach, bottom - prism.z
    corners = clipped(prism.section.points, low, (along + reach, np.inf))
    sides = np.clip([right - reach, right + reach], -prism.half_width, prism.half_width)
    if len(corners) < 3 or sides[0] == sides[1]:
        return None
    return corners, (float(sides[0]), float(sides[1]))


def hatch(grid: Grid, nodes: Mask | None, window: Window, words: str, color: str, ax: Axes) -> Axes:
    """Hatch the cells that touch marked nodes, with an entry for the legend."""
    x, y = np.linspace(*window[:2], HEATMAP), np.linspace(*window[2:], HEATMAP)
    marked = grid.touches(nodes, x[:, None], y[None, :])
    if marked.any():
        area = ax.contourf(x, y, marked.T, levels=(0.5, 1.5), colors="none", hatches=[HATCH])
        area.set_edgecolor(color)
        look: dict[str, Any] = {"fill": False, "ec": color, "lw": 0, "hatch": HATCH}
        ax.add_patch(Rectangle((x[0], y[0]), 0, 0, label=words, **look))
    return ax


def padded(window: Window, by: tuple[float, float], grid: Grid) -> Window:
    """Return a window with margins along x and y on the ground [m]."""
    x_min, x_max, y_min, y_max = grid.domain
    return (
        max(window[0] - by[0], x_min),
        min(window[1] + by[0], x_max),
        max(window[2] - by[1], y_min),
        min(window[3] + by[1], y_max),
    )


def about(x: Array, y: Array, grid: Grid, pad: float) -> Window:
    """Return the window around positions, with the proportions of the map if possible [m].

    ``pad`` is the margin on each side, in extents of the positions.
    """
    west, east, south, north = grid.domain
    sides = []
    for name, at, low, high in (("x", x, west, east), ("y", y, south, north)):
        if at.max() < low or at.min() > high:
            raise ModelError(
                f"expected a motion on this ground, {name} from {low:.10g} to {high:.10g} m, found "
                f"{name} from {at.min():.10g} to {at.max():.10g} m; use the ground of the motion"
            )
        sides.append((float(at.min() + at.max()) / 2, float(np.ptp(at)) * (1 + 2 * pad), low, high))
    ratio = float(np.clip((east - west) / (north - south), 0.5, 2.0))
    width = max(sides[0][1], sides[1][1] * ratio)
    window: list[float] = []
    for (middle, _, low, high), wanted in zip(sides, (width, width / ratio), strict=True):
        size = min(wanted, high - low)
        start = min(max(middle - size / 2, low), high - size)
        window += [start, start + size]
    return window[0], window[1], window[2], window[3]


def patch(grid: Grid, window: Window, count: int) -> tuple[Array, Array, Array]:
    """Return x, y and heights of a window at ``count`` nodes per side, NaN in holes [m]."""
    kept, fine, weights = [], [], []
    for axis, low, high in ((grid.x, *window[:2]), (grid.y, *window[2:])):
        last = min(int(np.searchsorted(axis, high)) + 3, axis.size)
        first = max(min(int(np.searchsorted(axis, low)) - 3, last - 4), 0)
        kept.append(np.arange(first, last, -(-(last - first) // count)))  # at most count nodes
        fine.append(np.linspace(low, high, count))
        at = np.interp(fine[-1], axis[kept[-1]], np.arange(kept[-1].size))  # in cells
        cell = np.minimum(at.astype(int), kept[-1].size - 2)
        weights.append(np.zeros((kept[-1].size + 2, count)))
        weights[-1][cell + np.arange(4)[:, None], np.arange(count)] = basis(at - cell)[0]
    table = coefficients_of(grid.z[np.ix_(*kept)], through=True)
    z = np.round(weights[0].T @ table @ weights[1], DIGITS)
    z[grid.touches(grid.holes, fine[0][:, None], fine[1][None, :])] = np.nan
    return fine[0], fine[1], z


def gradient(ground: Terrain, x: Array, y: Array) -> Array:
    """Return the derivatives of the height along x and y at map points, shape (2, ...) [1]."""
    at = ca.SX.sym("x"), ca.SX.sym("y")
    lookups = LookupTable()
    expressions = [ca.densify(ground.jet(*at, lookups).gradient)]
    derivatives = lookup_function(lookups.lookups, "gradient", at, expressions)
    x_0, y_0, _ = ground.origin
    values = derivatives(ca.DM(np.ravel(x - x_0)).T, ca.DM(np.ravel(y - y_0)).T)
    return np.array(values).reshape(2, *np.shape(x))


def side_plot(drive: PlottedDrive) -> Plot | None:
    """Return the side view of a motion; None without solids, or if it leaves the plane x = 0."""
    run = drive.run
    if not drive.prisms or run["x"].any() or any(prism.heading for prism in drive.prisms):
        return None
    section = section_of(drive.prisms, float(drive.grid.z.max()))

    def make() -> Figure:
        height, length = (float(np.ptp(run[f"center_{axis}"])) + 0.2 for axis in "zy")
        figure = style.figure(PAGE, PAGE * height / length + 20 * MM)
        side_view(run, section, ax := figure.subplots())
        return style.finished(figure, run, [ax])

    return Plot("side", "Vehicle and solids from the side, at several times.", make)


def side_view(run: Trajectory, section: Profile, ax: Axes, count: int = POSES) -> None:
    """Draw solids, paths of the wheels, and a planar vehicle at ``count`` times."""
    for solid in section.solids:
        ax.add_patch(Polygon(solid.points, fc="0.85", ec="0.85", lw=0.3, zorder=0))
    y, z = run["center_y"], run["center_z"]
    away = np.hypot(run["contact_y"] - y, run["contact_z"] - z)
    order = np.argsort(y[0])
    ax.plot(y, z, color="0.5", lw=0.6, zorder=2)
    for number, k in enumerate(np.linspace(0, run.t.size - 1, count).astype(int)):
        look: dict[str, Any] = {"color": colormaps["viridis"](LATEST * number / max(1, count - 1))}
        words = f"{run.t[k]:.3g} s"
        ax.plot(y[k, order], z[k, order], "o-", lw=1.3, ms=2.6, mfc="white", label=words, **look)
        for place in zip(y[k], z[k], np.nanmedian(away, axis=0), strict=True):
            ax.add_patch(Circle(place[:2], place[2], fill=False, lw=0.9, zorder=3, **look))
    radius = float(np.nanmedian(away))
    ax.set(xlabel="forward $y$ [m]", ylabel="height $z$ [m]", aspect="equal")
    ax.set_xlim(y.min() - radius - ROOM, y.max() + radius + ROOM)
    ax.set_ylim(z.min() - radius - ROOM, z.max() + radius + ROOM)
