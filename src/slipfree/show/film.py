"""Films and pictures of scenes: all paths in plan view, and a view of the first vehicle.

The view is a parallel projection of triangles that are sorted from back to front. Only what moves
is drawn for each frame of a film, over a picture of the rest.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any, cast

import numpy as np
from matplotlib import rc_context
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from PIL import Image

from slipfree.core.errors import DataError
from slipfree.core.records import Array
from slipfree.show import style
from slipfree.show.ground_drawing import DARKEST, LIGHT
from slipfree.show.plots import Plot
from slipfree.show.scene import ARROWS, PLAN_LINES, Actor, Color, Scene, round_step
from slipfree.show.style import MM, PAGE, STYLE, words
from slipfree.system.regular_files import check_ending, replace_file

FRAMES, FILM_DPI = 20, 110  # frames per second, and dots per inch
FILM_COLORS, OCTREE = 128, Image.Quantize.FASTOCTREE  # of a GIF; keeps the few pixels of arrows
MOST = 160  # maximum number of frames of a film; longer motions are shown faster
COLUMNS = {"width_ratios": (2, 3)}  # widths of the two axes
ROWS = (5, 2)  # heights of the views and of the curves
ROOM = 1.05  # end of the axis of curves over that of the quantity: lines at the end are not cut
FILM_HEIGHT, PICTURE_HEIGHT = 125.0, 110.0  # [mm]
HEIGHT = 0.62  # height of the view over its width
WIDE = 2.2  # width of the ground in a picture over that in a film [1]
FILM_NODES, PICTURE_NODES = 40, 90  # nodes of the ground per side
GROUND = (0.90, 0.85, 0.77)  # colour of the ground
SOLID = {"lw": 1.4}  # look of lines
TOP = 0.9  # highest place of a name [half the height of the view]
SCALE = 0.3  # least length of the scale bar [half the width of the view]
CAMERA = np.radians((28.0, -55.0))  # elevation and azimuth of the viewer
TITLE = 80  # number of characters in a line of the title
HEAD = 0.3, 0.4  # length of an arrow's head over the arrow's, and its width over its length
WIDTH = 125  # number of characters in a line below the film
LEFT: dict[str, Any] = {"x": 0.02, "ha": "left", "parse_math": False}  # of texts above and below
HEAD_LINE = {**LEFT, "fontsize": 9, "weight": "bold"}
BELOW = {**LEFT, "fontsize": 7, "bbox": {"fc": "white", "ec": "none", "pad": 1.5}}


def film_writer(file: Path, rate: int) -> AbstractMovieWriter:
    """Return the writer of a ``.gif`` or ``.mp4`` file with ``rate`` frames per second."""
    check_ending(file, (".mp4", ".gif"))
    if file.suffix.lower() == ".gif":
        return _GifWriter(fps=rate)
    if not FFMpegWriter.isAvailable():
        raise DataError(
            f"{file}: films in MP4 need the program ffmpeg, found none; install it (Debian: apt "
            "install ffmpeg; conda: conda install ffmpeg) or write a .gif"
        )
    return FFMpegWriter(fps=rate)


class _GifWriter(PillowWriter):
    """Writer of films whose frames have one palette without dithering, and need less space."""

    def finish(self) -> None:
        """Write the file."""
        frames: list[Image.Image] = [each.convert("RGB") for each in self._frames]  # type: ignore[attr-defined]
        palette = frames[len(frames) // 2].quantize(FILM_COLORS, OCTREE)
        drawn = [each.quantize(palette=palette, dither=Image.Dither.NONE) for each in frames]
        look: dict[str, Any] = {"duration": int(1000 / self.fps), "loop": 0}
        drawn[0].save(self.outfile, save_all=True, append_images=drawn[1:], **look)


def animate(
    scene: Scene,
    file: str | Path,
    title: str = "",
    progress: Callable[[int, int], object] | None = None,
) -> str:
    """Write the motions of a scene as a ``.gif`` or ``.mp4`` film; return its speed in words."""
    writer, (first, last) = film_writer(Path(file), FRAMES), scene.span
    count = int(np.clip(np.ceil(FRAMES * (last - first)) + 1, 2, MOST))
    speed = max(1.0, FRAMES * (last - first) / count)
    with rc_context(STYLE):
        figure = _FilmFigure(figsize=(PAGE, FILM_HEIGHT * MM), layout="constrained", dpi=FILM_DPI)
        film = Film(figure, scene, title, speed)

        def fill(part: Path) -> None:
            with writer.saving(figure, str(part), FILM_DPI):
                for step, t in enumerate(np.linspace(first, last, count).tolist(), 1):
                    film.show(t)
                    writer.grab_frame()
                    if progress is not None:
                        progress(step, count)

        try:
            replace_file(Path(file), fill)
        except CalledProcessError as error:
            if isinstance(error.__context__, KeyboardInterrupt):  # Ctrl-C ended ffmpeg as well
                raise error.__context__ from None
            raise DataError(
                f"{file}: cannot be written (ffmpeg: {error}); choose another name or folder"
            ) from error
    return f"{speed:.3g} times real speed"


def picture(scene: Scene, title: str, time: float | None = None) -> Plot:
    """Return the picture of the first vehicle of a scene on its ground, by default at the end."""
    at = scene.span[1] if time is None else time

    def make() -> Figure:
        """Draw the picture: the vehicles at one time, with the values of quantities below."""
        figure = style.figure(PAGE, PICTURE_HEIGHT * MM)
        is_level = np.ptp(scene.ground.mesh.vertices[:, 2]) < style.FLAT
        wide = (1.0 if is_level else WIDE) * scene.backdrop.half
        view = View(figure.subplots(), wide, PICTURE_NODES)
        view.add_paths(scene)
        view.show(scene, at)
        figure.suptitle(title, **HEAD_LINE)
        figure.supxlabel("; ".join([f"t = {at:.4g} s", *_told(scene)]), **BELOW)
        return figure

    return Plot("vehicle", "The vehicle on its ground.", make)


class _FilmFigure(Figure):
    """A figure whose saved frames are the pixels of its canvas, as they were drawn."""

    def savefig(self, fname: Any, **_: Any) -> None:
        """Write the pixels as red, green, blue and opacity."""
        fname.write(self.canvas.buffer_rgba())  # type: ignore[attr-defined]  # of Agg's canvas


class Film:
    """Artists of a film: positions in plan view, and the view of the first vehicle."""

    def __init__(self, figure: Figure, scene: Scene, title: str, speed: float) -> None:
        self.canvas = cast("Any", FigureCanvasAgg(figure))  # most of its methods have no types
        self.scene = scene
        parts: Any = figure.subfigures(2, 1, height_ratios=ROWS)
        above, below = parts
        flat, space = above.subplots(1, 2, gridspec_kw=COLUMNS)
        self.view = View(space, scene.backdrop.half, FILM_NODES)
        self.view.add_paths(scene)
        self.markers = _draw_paths(flat, scene)
        self.cursors = _draw_curves(below, scene)
        head = textwrap.fill(title, TITLE) or " "  # keeps the line of the clock free
        above.suptitle(head, **HEAD_LINE)
        self.clock = figure.text(0.98, 0.98, "", ha="right", va="top", fontsize=9)
        told = [*_told(scene), *([f"{speed:.3g} times real speed"] if speed > 1 else [])]
        lines = ["; ".join(told), *scene.warnings]
        lines += [f"{actor.name} {actor.stop}" for actor in scene.actors if actor.stop]
        caption = "\n".join(textwrap.fill(line, WIDTH) for line in lines)
        below.supxlabel(caption, **BELOW)
        self.moving = [*self.markers, *self.cursors, *self.view.artists, self.clock]
        for artist in self.moving:
            artist.set_animated(True)
        for _ in range(2):  # passes of the layout
            figure.draw_without_rendering()
        figure.set_layout_engine("none")
        beside = Bbox([[flat.bbox.x1 + 2, below.bbox.y1], [figure.bbox.x1, figure.bbox.y1]])
        for artist in self.view.artists:
            artist.set_clip_box(beside)
        self.canvas.draw()
        self.still = self.canvas.copy_from_bbox(figure.bbox)

    def show(self, t: float) -> None:
        """Draw the scene at a time [s]."""
        for actor, marker in zip(self.scene.actors, self.markers, strict=True):
            x, y, _ = actor.at(t).bodies[0].origins[0] + self.scene.origin
            marker.set_data([x], [y])
        for cursor in self.cursors:
            cursor.set_xdata([t, t])
        self.view.show(self.scene, t)
        self.clock.set_text(f"t = {t:.2f} s")
        self.canvas.restore_region(self.still)
        for artist in self.moving:
            artist.draw(self.canvas.get_renderer())


class View:
    """View of a vehicle on its ground from above, ahead and the left."""

    def __init__(self, ax: Axes, half: float, count: int) -> None:
        self.ax, self.half, self.count = ax, half, count
        ax.set_axis_off()
        high = HEIGHT * half
        ax.set(xlim=(-half, half), ylim=(-high, high), aspect="equal")
        self.grounds = PolyCollection([], lw=0.4), PolyCollection([], lw=0.4)  # ground, solids
        self.paths = list[tuple[Array, LineCollection]]()
        self.labels = list[tuple[Array, Text]]()
        self.vehicle = PolyCollection([], lw=0.3)
        self.arrows = LineCollection([], lw=1.4)
        self.artists: list[Any] = [*self.grounds, self.vehicle, self.arrows]
        for number, artist in enumerate(self.artists):
            artist.set_zorder(2 * number - 2)
            ax.add_collection(artist, autolim=False)
        length, low = round_step(SCALE * half), -0.98 * high
        ax.plot([-half, length - half], [low, low], color="black", lw=1.5, solid_capstyle="butt")
        ax.text(-half, low + 0.03 * half, f"{length:g} m", fontsize=7)

    def add_paths(self, scene: Scene) -> None:
        """Add the paths of all platforms, keep-out regions, start and goal, and the legend."""
        named = [e for e in scene.entries if e.group == "arrows" or e.name in PLAN_LINES[:2]]
        keys = [Line2D([], [], color=_shares(each.color), label=each.label) for each in named]
        self.artists.append(self.ax.legend(handles=keys, loc="lower left", bbox_to_anchor=(0, 1)))
        plan = [each for each in scene.ground.lines if each.name in PLAN_LINES]
        for name, point in (label for each in plan for label in each.labels):
            look: dict[str, Any] = {"ha": "center", "va": "bottom", "parse_math": False}
            text = self.ax.text(0, 0, name, fontsize=7, **look)
            self.labels.append((point, text))
            self.artists.append(text)
        for points, colors, look in [
            *((each.segments, [_shares(each.color)], SOLID) for each in plan),
            # plans below the motions that simulate them
            *(drawn for actor in scene.actors[::-1] for drawn in _path(scene, actor)),
        ]:
            line = LineCollection([], colors=colors, zorder=1, **look)
            self.ax.add_collection(line, autolim=False)
            self.paths.append((points, line))
            self.artists.insert(1 + len(self.paths), line)  # above the ground

    def show(self, scene: Scene, t: float) -> None:
        """Draw the first vehicle of a scene at a time [s] on the ground around it."""
        actor = scene.actors[0].at(t)
        middle = actor.bodies[0].origins[0]
        near = scene.backdrop.near(middle, self.half, self.count)
        for artist, faces in zip(self.grounds, near, strict=True):
            draw_faces(artist, faces, np.tile(GROUND, (len(faces), 1)), middle)
        for path, line in self.paths:  # as far as the ground
            is_near = (np.abs(path - middle)[..., :2] <= self.half).all(axis=-1, keepdims=True)
            line.set_segments([*projected(np.where(is_near, path, np.nan), middle)[..., :2]])
        for point, text in self.labels:
            text.set_visible(bool((np.abs(point - middle)[:2] <= self.half).all()))
            x, y, _ = projected(point, middle)
            text.set_position((x, min(y, TOP * HEIGHT * self.half)))
        parts, colors = list[Array](), list[Array]()
        for body in actor.bodies:
            for mesh, color in body.meshes:
                points = mesh.vertices @ body.rotations[0].T + body.origins[0]
                parts.append(points[mesh.faces])
                colors.append(np.tile(_shares(color), (len(mesh.faces), 1)))
        draw_faces(self.vehicle, np.concatenate(parts), np.concatenate(colors), middle)
        lines, looks = list[Array](), list[tuple[float, float, float]]()
        for each in actor.arrows:
            segments = arrow_lines(each.starts[0], scene.scales[each.name] * each.vectors[0], SIGHT)
            lines += [*projected(segments, middle)[..., :2]]
            looks += [_shares(ARROWS[each.name])] * len(segments)
        self.arrows.set_segments(lines)
        self.arrows.set_color(looks)


_ELEVATION, _AZIMUTH = CAMERA
_LEVEL = np.array([np.cos(_AZIMUTH), np.sin(_AZIMUTH), 0.0])
SIGHT = np.cos(_ELEVATION) * _LEVEL + np.sin(_ELEVATION) * np.eye(3)[2]  # to the viewer
RIGHT = np.array([-np.sin(_AZIMUTH), np.cos(_AZIMUTH), 0.0])
AXES = np.stack([RIGHT, np.cross(SIGHT, RIGHT), SIGHT], axis=1)


def projected(points: Array, middle: Array) -> Array:
    """Return positions in the picture, right and up, and distances towards the viewer [m]."""
    return np.asarray((points - middle) @ AXES)


def draw_faces(artist: PolyCollection, faces: Array, colors: Array, middle: Array) -> None:
    """Draw faces of given colours, shaded, from back to front: those that look at the viewer."""
    corners = faces[:, [0, 1, 2, -1]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    seen = normals @ SIGHT > 0  # those inside a body could lie on its large faces
    lit = normals[seen] @ LIGHT / np.linalg.norm(normals[seen], axis=1)
    shade = DARKEST + (1 - DARKEST) * np.clip(lit, 0, 1)
    places = projected(corners[seen], middle)
    order = np.argsort(places[..., 2].mean(axis=1))
    artist.set_verts(places[order, :, :2])  # type: ignore[arg-type]  # faster than a list
    artist.set_color((shade[:, None] * colors[seen])[order])


def _told(scene: Scene) -> list[str]:
    """Return the scale of the colours of the first track."""
    tracks = (each for actor in scene.actors for each in scene.track_layers(actor))
    return [f"{words(each.name)}, green to red: {each.legend}" for each in [*tracks][:1]]


def arrow_lines(starts: Array, vectors: Array, sight: Array) -> Array:
    """Return shafts and heads of arrows, shape (m, 2, 3), perpendicular to ``sight``."""
    drawn = np.isfinite(starts + vectors).all(axis=1) & (vectors != 0).any(axis=1)
    starts, vectors = starts[drawn], vectors[drawn]
    tips, back = starts + vectors, -HEAD[0] * vectors
    aside = np.cross(vectors, sight)
    sizes = np.linalg.norm(aside, axis=1, keepdims=True)
    aside = aside / np.where(sizes > 0, sizes, 1.0)  # none for an arrow towards the camera
    aside = aside * HEAD[1] * np.linalg.norm(back, axis=1, keepdims=True)
    sides = [np.stack([tips, tips + back + sign * aside], axis=1) for sign in (-1, 1)]
    return np.concatenate([np.stack([starts, tips], axis=1), *sides])


def _path(scene: Scene, actor: Actor) -> Iterator[tuple[Array, Any, dict[str, Any]]]:
    """Yield lines, shape (n, k, 3), colours and looks: the path of a motion, and its white edge.

    A motion has the colours of its largest slip of a wheel, or of the first other risk.
    """
    path = actor.bodies[0].origins
    if not actor.ghost:
        yield path[None], ["white"], {"lw": 3.0}
    worst = {name: each.reshape(len(each), -1).max(axis=1) for name, each in actor.values.items()}
    colored = [] if actor.ghost else scene.track_layers(actor._replace(values=worst))
    if colored:
        yield np.stack([path[:-1], path[1:]], axis=1), colored[0].colors[1:] / 255, SOLID
    else:
        yield path[None], [_shares(actor.color)], {"lw": 1.4, "ls": "--" if actor.ghost else "-"}


def _draw_curves(figure: Any, scene: Scene) -> list[Line2D]:
    """Draw the first risk and the first margin over time; return cursors, which are moved."""
    kinds = [[each for each in scene.plotted if each.is_margin == kind] for kind in (False, True)]
    shown = [kind[0] for kind in kinds if kind]
    cursors = list[Line2D]()
    axes = figure.subplots(1, len(shown) or 1, squeeze=False)[0]
    for ax, plotted in zip(axes, shown, strict=False):
        for name, color, t, values in scene.curves(plotted):
            ax.plot(t, values, color=color, lw=0.8, label=name)
        unit = f" [{plotted.unit}]" if plotted.unit else ""
        over = f"{words(plotted.name)}{unit} over time [s]"
        ax.set(xlim=scene.span, ylim=np.multiply(ROOM, scene.plotted[plotted]), xlabel=over)
        cursors.append(ax.axvline(scene.span[0], color="black", lw=0.8))
    if cursors:
        handles, names = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside upper left", ncols=6)
    return cursors


def _draw_paths(ax: Axes, scene: Scene) -> list[Any]:
    """Draw ground, paths and legend on a map; return the markers of the vehicles."""
    scene.backdrop.draw(ax)
    markers = []
    for actor in scene.actors:
        color = _shares(actor.color)
        for lines, colors, look in _path(scene, actor):
            flat = (lines + scene.origin)[..., :2]
            at = {"zorder": 2 if actor.ghost else 3}
            ax.add_collection(LineCollection([*flat], colors=colors, **at, **look))
        look = {"mfc": color, "mec": "white", "ms": 5, "zorder": 4}
        markers += ax.plot([], [], "o", label=actor.name, **look)
    entries = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))  # each once
    ax.legend(entries.values(), entries, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return markers


def _shares(color: Color) -> tuple[float, float, float]:
    """Return red, green and blue, from 0 to 1, of a colour with components from 0 to 255."""
    red, green, blue = color
    return red / 255, green / 255, blue / 255
