"""Films of scenes: all paths in plan view, and a 3D view of the first vehicle."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any, TypeVar

import numpy as np
from matplotlib import rc_context
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from slipfree.core.errors import DataError
from slipfree.core.records import Array
from slipfree.show import style
from slipfree.show.scene import ARROWS, Actor, Color, Scene, scale_words
from slipfree.show.style import MM, PAGE, STYLE
from slipfree.system.regular_files import replace_file

FRAMES, FILM_DPI = 20, 110  # frames per second, and dots per inch
ENDINGS = (".gif", ".mp4")
MOST = 400  # maximum number of frames of a film; longer motions are shown faster
COLUMNS = {"width_ratios": (2, 3)}  # widths of the two axes
FILM_HEIGHT = 90.0  # [mm]
HEIGHT, ZOOM = 0.6, 1.55  # height of the 3D view, in widths, and its magnification
CAMERA = 28.0, -55.0  # elevation and azimuth of the 3D view [deg]
TITLE = 80  # number of characters in a line of the title
HEAD = 0.3, 0.4  # length of an arrow's head over the arrow's, and its width over its length
WIDTH = 150  # number of characters in a line below the film
BELOW = {"fc": "white", "ec": "none", "pad": 1.5}  # behind the text below a film
T = TypeVar("T")


def film_writer(file: Path, rate: int) -> AbstractMovieWriter:
    """Return the writer of a ``.gif`` or ``.mp4`` file with ``rate`` frames per second."""
    if file.suffix not in ENDINGS:
        raise DataError(
            f"{file}: expected a name that ends in {' or '.join(ENDINGS)} for a film, found "
            f"{repr(file.suffix) if file.suffix else 'no ending'}; choose another name"
        )
    if file.suffix == ".gif":
        return PillowWriter(fps=rate)
    if not FFMpegWriter.isAvailable():
        raise DataError(
            f"{file}: films in MP4 need the program ffmpeg, found none; install it (Debian: apt "
            "install ffmpeg; conda: conda install ffmpeg) or write a .gif"
        )
    return FFMpegWriter(fps=rate)


def write_film(
    writer: AbstractMovieWriter,
    figure: Figure,
    file: Path,
    show: Callable[[T], None],
    steps: Iterable[T],
) -> None:
    """Write a film with one frame per step, drawn by ``show(step)``."""

    def fill(part: Path) -> None:
        with writer.saving(figure, str(part), FILM_DPI):
            for step in steps:
                show(step)
                writer.grab_frame()

    try:
        replace_file(file, fill)
    except CalledProcessError as error:
        if isinstance(error.__context__, KeyboardInterrupt):  # Ctrl-C ended ffmpeg as well
            raise error.__context__ from None
        raise DataError(
            f"{file}: cannot be written (ffmpeg: {error}); choose another name or folder"
        ) from error


def animate(scene: Scene, file: str | Path, title: str = "") -> str:
    """Write the motions of a scene as a ``.gif`` or ``.mp4`` film; return its speed in words."""
    writer, (first, last) = film_writer(Path(file), FRAMES), scene.span
    count = int(np.clip(np.ceil(FRAMES * (last - first)) + 1, 2, MOST))
    speed = max(1.0, FRAMES * (last - first) / count)
    with rc_context(STYLE):  # type: ignore[arg-type]  # its keys are a literal type
        figure = style.figure(PAGE, FILM_HEIGHT * MM)
        FigureCanvasAgg(figure)
        film = Film(figure, scene, title, speed)
        figure.draw_without_rendering()
        figure.set_layout_engine(None)  # axes must not move between frames
        times = np.linspace(first, last, count).tolist()
        write_film(writer, figure, Path(file), film.show, times)
    return f"{speed:.3g} times real speed"


class Film:
    """Artists of a film: positions in plan view, and a 3D view of the first vehicle."""

    def __init__(self, figure: Figure, scene: Scene, title: str, speed: float) -> None:
        grid = figure.add_gridspec(1, 2, **COLUMNS)
        flat, space = figure.add_subplot(grid[0]), figure.add_subplot(grid[1], projection="3d")
        self.scene, self.space = scene, space
        self.markers = _draw_paths(flat, scene)
        head = textwrap.fill(title, TITLE) or " "  # keeps the line of the clock free
        self.head = figure.suptitle(
            head, x=0.02, ha="left", fontsize=9, weight="bold", parse_math=False
        )
        self.clock = figure.text(0.98, 0.98, "", ha="right", va="top", fontsize=9)
        told = [f"{name}: {words}" for name in scene.scales if (words := scale_words(scene, name))]
        told += [f"{speed:.3g} times real speed"] if speed > 1 else []
        lines = ["; ".join(told), *scene.warnings]
        lines += [f"{actor.name} {actor.stop}" for actor in scene.actors if actor.stop]
        words = "\n".join(textwrap.fill(line, WIDTH) for line in lines)
        figure.supxlabel(words, x=0.02, ha="left", fontsize=7, parse_math=False, bbox=BELOW)
        space.set_axis_off()
        space.computed_zorder = False  # the vehicle is always in front of its ground
        space.view_init(*CAMERA)
        self.drawn: list[Any] = []

    def show(self, t: float) -> None:
        """Show the scene at a time [s]."""
        for actor, marker in zip(self.scene.actors, self.markers, strict=True):
            x, y, _ = actor.bodies[0].origins[_sample(actor, t)] + self.scene.origin
            marker.set_data([x], [y])
        for artist in self.drawn:
            artist.remove()
        actor = self.scene.actors[0]
        k = _sample(actor, t)
        middle, half = actor.bodies[0].origins[k], self.scene.backdrop.half
        ground = self.scene.backdrop.near(middle, half)
        self.drawn = [self._ground(ground), *self._vehicle(actor, k), *self._arrows(actor, k)]
        for axis, value in zip("xyz", middle, strict=True):
            part = half * (HEIGHT if axis == "z" else 1.0)
            getattr(self.space, f"set_{axis}lim")(value - part, value + part)
        self.space.set_box_aspect((1, 1, HEIGHT), zoom=ZOOM)
        self.clock.set(text=f"t = {t:.2f} s", y=self.head.get_position()[1])

    def _ground(self, faces: Iterable[Array]) -> Any:
        look: dict[str, Any] = {"facecolors": "0.95", "edgecolors": "0.65", "lw": 0.2}
        return self._add(Poly3DCollection(list(faces), shade=True, zorder=0, **look))

    def _add(self, shape: Any) -> Any:
        """Add a collection to the 3D view, also where it exceeds the square of the axes."""
        shape.set_clip_on(False)
        return self.space.add_collection3d(shape)

    def _vehicle(self, actor: Actor, k: int) -> list[Any]:
        """Draw the faces of the vehicle's parts at sample ``k``; return the artists."""
        faces, colors = [], []
        for body in actor.bodies:
            for mesh, color in body.meshes:
                points = mesh.vertices @ body.rotations[k].T + body.origins[k]
                faces.append(points[mesh.faces])
                colors += [_shares(color)] * len(mesh.faces)
        shape = Poly3DCollection(np.concatenate(faces), facecolors=colors, shade=True, zorder=1)
        return [self._add(shape)]

    def _arrows(self, actor: Actor, k: int) -> list[Any]:
        """Draw slip and forces at sample ``k`` as arrows from the contact points; return them."""
        artists = []
        elevation, azimuth = np.radians(CAMERA)
        sight = np.array([np.cos(azimuth), np.sin(azimuth), np.tan(elevation)])
        for each in actor.arrows:
            lines = arrow_lines(
                each.starts[k], self.scene.scales[each.name] * each.vectors[k], sight
            )
            if lines.size:
                look: dict[str, Any] = {"colors": _shares(ARROWS[each.name]), "lw": 1.4}
                artists.append(self._add(Line3DCollection(lines, zorder=2, **look)))
        return artists


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


def _sample(actor: Actor, t: float) -> int:
    return int(np.clip(np.searchsorted(actor.t, t), 0, actor.t.size - 1))


def _draw_paths(ax: Axes, scene: Scene) -> list[Any]:
    """Draw the ground and the paths of all motions; return the markers of current positions."""
    scene.backdrop.draw(ax)
    markers = []
    for actor in scene.actors:
        path, color = actor.bodies[0].origins + scene.origin, _shares(actor.color)
        look: dict[str, Any] = {"lw": 1, "ls": "--" if actor.ghost else "-", "zorder": 3}
        ax.plot(*path.T[:2], color=color, label=actor.name, **look)
        markers += ax.plot([], [], "o", mfc=color, mec="white", ms=5, zorder=4)
    for name in scene.scales:
        if scene.scales[name]:
            ax.plot([], [], color=_shares(ARROWS[name]), label=f"{name} (arrows)")
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return markers


def _shares(color: Color) -> tuple[float, ...]:
    """Return red, green and blue, from 0 to 1, of a colour with components from 0 to 255."""
    return tuple(part / 255 for part in color)
