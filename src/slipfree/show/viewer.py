"""Scenes as web pages: served to a browser on this machine, or saved as one file.

The package viser draws the scenes; it is imported only when a page is made.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slipfree.core.records import Array
from slipfree.show.html_page import legend, swatch, warned, with_legend
from slipfree.show.local_server import Guard, stop
from slipfree.show.scene import (
    ARROWS,
    WORLD,
    Colors,
    Scene,
    SceneGround,
)
from slipfree.system.interrupt import interrupt_arrived

if TYPE_CHECKING:
    import viser

RATE = 25.0  # frames per second
SPEEDS = ("0.1x", "0.25x", "0.5x", "1x", "2x", "5x", "10x", "50x")
LONGEST = 60.0  # maximum duration of a saved page; longer motions are shown faster [s]
MOST = 400  # maximum number of points of a track
LIFT = 0.006  # height of the first track above the ground; others are higher [reach]
SPREAD = 1.8  # distance of motions side by side [reach]
STEP = 0.02  # step of the arrow keys [duration]
KEYS = "space: play or pause; left, right: step; up, down: speed; home, end: first and last time"
CONTACT_SIZE = 0.05  # [reach of the vehicle]
ARROW = {"shaft_radius": 0.014, "head_radius": 0.035, "head_length": 0.08}  # [reach]
CONTACT = (255, 255, 255)
SKY = 0.5  # ambient light, in addition to viser's two lamps
FAR = 1000.0  # far plane of the camera, unless the ground is larger [m]
CLOSE, NEAREST = 3.5, 0.05  # distance of the following camera, and near plane [reach]
LINES = {"north": 4.0}  # thickness of lines on the ground, by default 1 [pixels]


def serve(
    scene: Scene,
    title: str,
    color: str,
    port: int,
    warn: Callable[[str], None],
    ready: Callable[[str], None],
) -> None:
    """Show a scene in a web page on this machine, until Ctrl-C; port zero selects a free one.

    ``warn`` is called, from any thread, with warnings, ``ready`` with the address of the page.
    """
    guard = Guard(warn)
    server = guard.start(port)
    try:
        stage = Stage(server, scene, color)
        panel = _Controls(server, stage, scene, title, color)
        ready(guard.gate.url(server.get_port()))
        while True:
            time.sleep(1 / RATE)
            panel.advance(1 / RATE)
    except KeyboardInterrupt:
        interrupt_arrived()
    finally:
        stop(server)


def page(scene: Scene, title: str, color: str) -> str:
    """Return a self-contained HTML page that plays a scene, with an initial layer of the ground."""
    server = Guard(lambda _: None).start(0)
    try:
        stage = Stage(server, scene, color, others=True)
        first, last = scene.span
        speed = max(1.0, (last - first) / LONGEST)
        times = np.arange(first, last + speed / RATE, speed / RATE)
        recording = server.get_scene_serializer()
        for t in times:
            stage.show(min(float(t), last))
            recording.insert_sleep(1 / RATE)
        html = recording.as_html()
    finally:
        stop(server)
    words = [f"Played at {speed:.3g} times real speed."] if speed > 1 else []
    words += [f"The view follows {scene.actors[0].name}."] if scene.is_far else []
    return with_legend(html, scene, title, color, words)


class Stage:
    """Nodes of a scene in viser, with methods to show them; ``others`` adds hidden layers."""

    def __init__(
        self, server: viser.ViserServer, scene: Scene, color: str, *, others: bool = False
    ) -> None:
        self.server, self.scene, self._lock = server, scene, threading.Lock()
        server.scene.set_up_direction("+z")
        # with an environment map a saved page would fade in again at each repetition
        server.scene.configure_environment_map(None)
        server.scene.configure_default_lights(cast_shadow=False)  # slow where there is no GPU
        server.scene.add_light_hemisphere("/sky", intensity=SKY)
        self.world = server.scene.add_frame(WORLD, show_axes=False)
        self.grounds: dict[str, Any] = {}
        for lines in scene.ground.lines:
            root = f"{WORLD}/{lines.name}"
            server.scene.add_frame(root, show_axes=False)
            server.scene.add_line_segments(
                f"{root}/lines",
                lines.segments.astype(np.float32),
                np.array(lines.color),
                thickness=LINES.get(lines.name, 1.0),
                thickness_units="screen",
            )
            for k, (words, at) in enumerate(lines.labels):
                server.scene.add_label(
                    f"{root}/{k + 1}",
                    words,
                    position=at,
                    anchor="center-center",
                    font_screen_scale=0.8,
                )
        for name in (*(layer.name for layer in scene.ground.layers if others), color):
            self.paint(name, shaded=True)
        self.actors = [_RunNodes(server, scene, k) for k in range(len(scene.actors))]
        self.anchor: Array | None = None
        low, high = scene.paths.min(axis=0), scene.paths.max(axis=0)
        middle, away = (
            (low + high) / 2,
            max(0.7 * float(np.linalg.norm(high - low)), 2.5 * scene.reach),
        )
        if scene.is_far:
            middle, away = scene.actors[0].bodies[0].origins[0], CLOSE * scene.reach
        camera = server.initial_camera
        camera.look_at = middle
        camera.position = middle + away * np.array([0.75, -0.75, 0.65])
        size = float(np.linalg.norm(np.ptp(scene.ground.mesh.vertices, axis=0)))
        camera.near, camera.far = NEAREST * scene.reach, max(FAR, 10 * size)
        self.show(scene.span[0])
        self.follow(scene.is_far)

    def spread(self, enabled: bool) -> None:
        """Move motions apart sideways, or back; a plan stays with its simulation."""
        first = self.scene.actors[0].bodies[0].origins
        along = (first[-1] - first[0])[:2]
        size = float(np.linalg.norm(along))
        side = np.array([along[1], -along[0], 0.0]) / size if size > 0 else np.array([1.0, 0, 0])
        gap = SPREAD * self.scene.reach if enabled else 0.0
        count = -1
        with self._lock, self.server.atomic():
            for drawn in self.actors:
                count += not drawn.actor.ghost
                drawn.root.position = count * gap * side

    def show(self, t: float) -> None:
        """Move all nodes to a time [s]."""
        with self._lock, self.server.atomic():
            for actor in self.actors:
                actor.show(t)
            self._center_vehicle()

    def follow(self, enabled: bool) -> None:
        """Make the camera follow the first vehicle, or stop following it."""
        with self._lock, self.server.atomic():
            self.anchor = self.actors[0].position + self.world.position if enabled else None
            self._center_vehicle()

    def _center_vehicle(self) -> None:
        """Move the world so that the followed vehicle stays at its position in view."""
        anchor = self.anchor
        self.world.position = np.zeros(3) if anchor is None else anchor - self.actors[0].position

    def paint(self, color: str, *, shaded: bool) -> None:
        """Show the layer of the ground with the given name, with or without hillshade."""
        name = color if shaded else f"{color} without hillshade"
        with self.server.atomic():
            if name not in self.grounds:
                colors = self.scene.ground.colors(color, shaded=shaded)
                self.grounds[name] = _add_ground(self.server, self.scene.ground, name, colors)
            for each, node in self.grounds.items():
                node.visible = each == name

    def switch(self, nodes: Sequence[str], visible: bool) -> None:
        """Show or hide nodes; those that the scene does not have are ignored."""
        for name in nodes:
            if node := self.server.scene.get_handle_by_name(name):
                node.visible = visible


class _RunNodes:
    """Nodes of the motion with index ``k`` of a scene in viser."""

    def __init__(self, server: viser.ViserServer, scene: Scene, k: int) -> None:
        actor, self.scales = scene.actors[k], scene.scales
        root, self.actor, self.now = f"{WORLD}/run {k + 1}", actor, actor.at(actor.t[0])
        self.root = server.scene.add_frame(root, show_axes=False)
        self.frames = []
        for count, body in enumerate(actor.bodies, 1):
            name = f"{root}/body {count}"  # not the part's name, which another node may have
            self.frames.append(server.scene.add_frame(name, show_axes=False))
            for number, (mesh, color) in enumerate(body.meshes):
                server.scene.add_mesh_simple(
                    f"{name}/{number}",
                    mesh.vertices,
                    mesh.faces,
                    color=color,
                    side="double",
                    flat_shading=not actor.ghost,
                    wireframe=actor.ghost,
                )
        self.label = server.scene.add_label(f"{root}/name", actor.name, anchor="bottom-center")
        self.above = np.array(
            [0.0, 0.0, (0.6 + 0.25 * k) * scene.reach]
        )  # names at distinct heights
        # Browsers cull point clouds by their initial position: this node moves with the vehicle.
        self.here = server.scene.add_frame(f"{root}/here", show_axes=False)
        self.contacts = server.scene.add_point_cloud(
            f"{root}/here/contacts",
            np.zeros((1, 3)),
            CONTACT,
            point_size=CONTACT_SIZE * scene.reach,
            point_shape="circle",
            precision="float32",
        )
        sizes: dict[str, Any] = {name: size * scene.reach for name, size in ARROW.items()}
        self.arrows: dict[str, Any] = {}  # by name
        for each in actor.arrows:
            if scene.scales[each.name]:
                node = f"{root}/here/{each.name}"
                server.scene.add_frame(node, show_axes=False)  # to hide the arrows at all times
                self.arrows[each.name] = server.scene.add_arrows(
                    f"{node}/arrows", np.zeros((1, 2, 3)), ARROWS[each.name], **sizes
                )
        # tracks of contact points, raised against flicker; those of plans are dashed
        every = max(1, actor.t.size // MOST)
        points = actor.contacts[::every] + np.array([0.0, 0.0, LIFT * (1 + k) * scene.reach])
        lines = np.stack([points[:-1], points[1:]], axis=2)[:: 2 if actor.ghost else 1]
        lines = lines.reshape(-1, 2, 3)
        lines = lines[np.isfinite(lines).all(axis=(1, 2))]
        if len(lines):
            server.scene.add_line_segments(
                f"{root}/tracks",
                lines.astype(np.float32),
                np.array(actor.color),
                thickness=2.0,
                thickness_units="screen",
            )

    @property
    def position(self) -> Array:
        return np.asarray(self.now.bodies[0].origins[0])

    def show(self, t: float) -> None:
        """Move the vehicle to its pose at a time [s]."""
        self.now = actor = self.actor.at(t)
        for node, body in zip(self.frames, actor.bodies, strict=True):
            node.position, node.wxyz = body.origins[0], body.quaternions[0]
        stopped = actor.stop.partition(":")[0] if actor.t[0] == self.actor.t[-1] else ""
        self.label.text = f"{actor.name}, {stopped or f't = {actor.t[0]:.2f} s'}"
        self.label.position = self.position + self.above
        self.here.position = self.position
        touching = np.isfinite(actor.contacts[0]).all(axis=-1)
        self.contacts.visible = bool(touching.any())
        if touching.any():
            points = actor.contacts[0, touching] - self.position
            self.contacts.points = points.astype(np.float32)
        for each in actor.arrows:
            if each.name not in self.arrows:
                continue
            node, vectors = self.arrows[each.name], each.vectors[0] * self.scales[each.name]
            lines = np.stack([each.starts[0], each.starts[0] + vectors], axis=1) - self.position
            kept = np.isfinite(lines).all(axis=(1, 2)) & (np.linalg.norm(vectors, axis=-1) > 0)
            lines = lines[kept].astype(np.float32)
            node.visible = len(lines) > 0
            if len(lines):
                node.points = lines


def _add_ground(server: viser.ViserServer, ground: SceneGround, name: str, colors: Colors) -> Any:
    import trimesh

    # glTF expects colours in linear light, not in sRGB
    mesh = trimesh.Trimesh(
        ground.mesh.vertices, ground.mesh.faces, vertex_colors=linear(colors), process=False
    )
    data: Any = mesh.export(file_type="glb", tree_postprocessor=_matt)
    return server.scene.add_glb(f"{WORLD}/ground {name}", data)


def _matt(tree: dict[str, Any]) -> None:
    """Set a matt material for all meshes of a glTF tree; the default is metallic and dark."""
    tree["materials"] = [{"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}]
    for mesh in tree["meshes"]:
        for each in mesh["primitives"]:
            each["material"] = 0


def linear(colors: Colors) -> Colors:
    """Return sRGB colours converted to linear light (IEC 61966-2-1), shape (n, 3)."""
    parts = colors / 255
    light = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.rint(255 * light), dtype=np.uint8)


class _Action(NamedTuple):
    """Command of the page: label, key, button (empty: none), and the function that it calls."""

    label: str
    key: Any
    button: str
    act: Callable[[], None]


class _Controls:
    """Controls of the page: time, speed, ground, arrows and runs."""

    def __init__(
        self, server: viser.ViserServer, stage: Stage, scene: Scene, title: str, color: str
    ) -> None:
        gui: Any = server.gui
        first, last = scene.span
        gui.configure_theme(
            show_logo=False, show_share_button=False
        )  # sharing would contact another host
        gui.main_panel.dock_right()
        gui.set_panel_label(title)
        self.stage, self.color, self.ends = stage, color, (first, last)
        step = max(1e-3, (last - first) / 5000)
        self.time: Any = gui.add_slider("time [s]", first, max(last, first + step), step, first)
        self.time.on_update(lambda _: stage.show(self.time.value))
        self.playing: Any = gui.add_checkbox("play", False)
        self.speed: Any = gui.add_dropdown("speed", SPEEDS, initial_value="1x")
        actions = self._actions()
        buttons = gui.add_button_group("", tuple(each.button for each in actions if each.button))
        by_button = {each.button: each.act for each in actions}
        buttons.on_click(lambda _: by_button[buttons.value]())
        for each in actions:  # the page also lists them in its command palette
            command = gui.add_command(each.label, hotkey=each.key)
            command.on_trigger(lambda _, act=each.act: act())
        self.following = gui.add_checkbox(f"follow {scene.actors[0].name}", scene.is_far)
        self.following.on_update(lambda _: stage.follow(self.following.value))
        if scene.warnings:
            gui.add_html(warned(scene))
        for group in dict.fromkeys(["ground", *(entry.group for entry in scene.entries)]):
            with gui.add_folder(group):
                if group == "ground":
                    self._choose_ground(gui, scene)
                for entry in scene.entries:
                    if entry.group == group:
                        gui.add_html(swatch(entry.color, entry.stop, ghost=entry.ghost))
                        box = gui.add_checkbox(entry.label, True)
                        box.on_update(
                            lambda _, box=box, nodes=entry.nodes: stage.switch(nodes, box.value)
                        )
                if group == "runs" and sum(not actor.ghost for actor in scene.actors) > 1:
                    spread = gui.add_checkbox("side by side (off the ground)", False)
                    spread.on_update(lambda _, box=spread: stage.spread(box.value))
        with gui.add_folder("notes", expand_by_default=False):
            notes = (*scene.notes, f"Keys: {KEYS}.")
            gui.add_html("".join(f"<p>{escape(note)}</p>" for note in notes))

    def advance(self, seconds: float) -> None:
        if self.playing.value:
            first, last = self.ends
            t = max(first, self.time.value)  # a page may send any number
            t += seconds * float(self.speed.value.removesuffix("x"))
            self.time.value = first if t > last else t

    def jump(self, share: float) -> None:
        """Move the time by a share of the duration, and pause; infinite shares reach the ends."""
        first, last = self.ends
        self.playing.value = False
        move = share if np.isinf(share) else share * (last - first)
        self.time.value = float(np.clip(self.time.value + move, first, last))

    def hurry(self, steps: int) -> None:
        """Select the speed that is ``steps`` places further in the list of speeds."""
        k = SPEEDS.index(self.speed.value) + steps
        self.speed.value = SPEEDS[min(max(k, 0), len(SPEEDS) - 1)]

    def toggle(self) -> None:
        self.playing.value = not self.playing.value

    def _actions(self) -> tuple[_Action, ...]:
        return (
            _Action("first time", "home", "|<", lambda: self.jump(-np.inf)),
            _Action("step back", "arrowleft", "<", lambda: self.jump(-STEP)),
            _Action("play or pause", "space", "", self.toggle),
            _Action("step forward", "arrowright", ">", lambda: self.jump(STEP)),
            _Action("last time", "end", ">|", lambda: self.jump(np.inf)),
            _Action("faster", "arrowup", "", lambda: self.hurry(1)),
            _Action("slower", "arrowdown", "", lambda: self.hurry(-1)),
        )

    def _choose_ground(self, gui: Any, scene: Scene) -> None:
        layers = {layer.name: layer for layer in scene.ground.layers}
        chosen = gui.add_dropdown("color", tuple(layers), initial_value=self.color)
        words = gui.add_html(legend(layers[chosen.value]))
        shading = gui.add_checkbox("hillshade", True, visible=scene.ground.shade is not None)

        def paint(_: Any) -> None:
            self.stage.paint(chosen.value, shaded=shading.value)
            words.content = legend(layers[chosen.value])

        chosen.on_update(paint)
        shading.on_update(paint)
