"""Films of motions by matplotlib: the path from above, and the vehicle close up."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from slipfree.records import Array
from slipfree.routing.traversability import extents
from slipfree.show import ground_drawing, style
from slipfree.show.drive_scene import Driven, drive_scene
from slipfree.show.film import FRAMES, film_writer, write_film
from slipfree.show.scene import ARROWS, Actor, Color, Scene, scale_words
from slipfree.show.style import MM, PAGE, STYLE

MOST = 400  # largest number of frames; a longer motion is accelerated
NEAR = 1.6  # half of the ground around the vehicle [reach of the vehicle]
CELLS = 24  # cells of that ground along a side
WIDTH = 150  # characters per line of the note


def animate_drives(drives: Sequence[Driven], file: str | Path) -> str:
    """Write motions over one ground as a film.

    Parameters
    ----------
    drives : sequence of Driven
        One or more; the first one is shown close up.
    file : str or Path
        Its name ends in ``.gif`` or ``.mp4``.

    Returns
    -------
    str
        Description of the playback speed.

    Raises
    ------
    DataError
        If the ending is unknown, or ffmpeg is missing.
    """
    writer, scene = film_writer(Path(file), FRAMES), drive_scene(drives)
    first, last = scene.span
    count = int(np.clip(FRAMES * (last - first) + 1, 2, MOST))
    speed = max(1.0, FRAMES * (last - first) / count)
    with rc_context(STYLE):  # type: ignore[arg-type]  # its keys are a literal type
        figure = style.figure(PAGE, 82 * MM)
        FigureCanvasAgg(figure)
        film = _Film(figure, scene, drives, speed)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # nothing moves from one picture to the next
        times = np.linspace(first, last, count).tolist()
        write_film(writer, figure, Path(file), film.show, times)
    return f"{speed:.3g} times as fast as it happened"


class _Film:
    """The artists of a film: positions on a map, and the first vehicle in space."""

    def __init__(
        self, figure: Figure, scene: Scene, drives: Sequence[Driven], speed: float
    ) -> None:
        plan, space = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2, projection="3d")
        self.scene, self.space, self.terrain = scene, space, drives[0].terrain
        self.reach = NEAR * extents(drives[0].vehicle)[2]
        self.places = _draw_map(plan, scene, drives)
        self.title = figure.suptitle("", x=0.98, ha="right", fontsize=8)
        told = [f"{name}: {words}" for name in scene.scales if (words := scale_words(scene, name))]
        told += [f"{speed:.3g} times as fast"] if speed > 1 else []
        lines = ["; ".join(told), *scene.warnings]
        lines += [f"{actor.name} {actor.stop}" for actor in scene.actors if actor.stop]
        words = "\n".join(textwrap.fill(line, WIDTH) for line in lines)
        figure.supxlabel(words, x=0.02, ha="left", fontsize=7, parse_math=False)
        space.set_axis_off()
        space.computed_zorder = False  # the vehicle is always in front of its ground
        space.view_init(elev=28, azim=-55)
        self.drawn: list[Any] = []

    def show(self, t: float) -> None:
        """Move all artists to a time."""
        for actor, place in zip(self.scene.actors, self.places, strict=True):
            at = actor.bodies[0].origins[_sample(actor, t)] + self.scene.origin
            place.set_data(at[:1], at[1:2])
        for artist in self.drawn:
            artist.remove()
        actor = self.scene.actors[0]
        k = _sample(actor, t)
        middle = actor.bodies[0].origins[k]
        self.drawn = [self._ground(middle), *self._vehicle(actor, k), *self._arrows(actor, k)]
        for axis, value in zip("xyz", middle, strict=True):
            height = 0.6 if axis == "z" else 1.0
            getattr(self.space, f"set_{axis}lim")(
                value - height * self.reach, value + height * self.reach
            )
        self.space.set_box_aspect((1, 1, 0.6), zoom=1.35)
        self.title.set_text(f"$t$ = {t:.2f} s")

    def _ground(self, middle: Array) -> Any:
        """Draw the ground around the vehicle, as far as the map goes."""
        west, east, south, north = self.terrain.domain
        x, y = (
            np.clip(np.linspace(at - self.reach, at + self.reach, CELLS) + origin, low, high)
            for at, origin, low, high in zip(
                middle, self.scene.origin, (west, south), (east, north), strict=False
            )
        )
        x, y = np.meshgrid(x, y, indexing="ij")
        z = self.terrain.elevation(x, y)
        o_x, o_y, o_z = self.scene.origin
        return self.space.plot_surface(
            x - o_x,
            y - o_y,
            z - o_z,
            color="0.95",
            lw=0.2,
            edgecolor="0.65",
            rcount=CELLS,
            ccount=CELLS,
            zorder=0,
        )

    def _vehicle(self, actor: Actor, k: int) -> list[Any]:
        """Draw the faces of the vehicle's parts, the nearest last."""
        faces, colors = [], []
        for body in actor.bodies:
            for mesh, color in body.meshes:
                points = mesh.vertices @ body.rotations[k].T + body.origins[k]
                faces.append(points[mesh.faces])
                colors += [_shares(color)] * len(mesh.faces)
        shape = Poly3DCollection(np.concatenate(faces), facecolors=colors, shade=True, zorder=1)
        return [self.space.add_collection3d(shape)]

    def _arrows(self, actor: Actor, k: int) -> list[Any]:
        """Draw slip and forces as lines that begin at the contact points."""
        found = []
        for each in actor.arrows:
            if scale := self.scene.scales[each.name]:
                lines = np.stack([each.starts[k], each.starts[k] + scale * each.vectors[k]], axis=1)
                lines = lines[np.isfinite(lines).all(axis=(1, 2))]
                style_ = Line3DCollection(
                    lines, colors=_shares(ARROWS[each.name]), lw=1.2, zorder=2
                )
                found.append(self.space.add_collection3d(style_))
        return found


def _sample(actor: Actor, t: float) -> int:
    return int(np.clip(np.searchsorted(actor.t, t), 0, actor.t.size - 1))


def _draw_map(ax: Axes, scene: Scene, drives: Sequence[Driven]) -> list[Any]:
    """Draw ground and paths of all motions from above; return the markers of their positions."""
    mesh = scene.ground.mesh.vertices + scene.origin
    window = (*_ends(mesh[:, 0]), *_ends(mesh[:, 1]))
    ground_drawing.muted(drives[0].terrain.grid, ax, window)
    places = []
    for actor in scene.actors:
        way, color = actor.bodies[0].origins + scene.origin, _shares(actor.color)
        ax.plot(
            way[:, 0],
            way[:, 1],
            color=color,
            lw=1,
            ls="--" if actor.ghost else "-",
            label=actor.name,
            zorder=3,
        )
        places += ax.plot([], [], "o", mfc=color, mec="white", ms=5, zorder=4)
    for name in scene.scales:
        if scene.scales[name]:
            ax.plot([], [], color=_shares(ARROWS[name]), label=f"{name} (arrows)")
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return places


def _shares(color: Color) -> tuple[float, ...]:
    """Return red, green and blue from 0 to 1."""
    return tuple(part / 255 for part in color)


def _ends(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())
