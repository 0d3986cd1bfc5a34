"""Scenes as self-contained web pages, and the server that shows them on this machine.

The package viser draws the scenes; it is imported only when a page is made.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from contextlib import redirect_stdout
from typing import TYPE_CHECKING, Any

import numpy as np

from slipfree.core.errors import DataError
from slipfree.core.records import Array
from slipfree.show.html_page import with_legend
from slipfree.show.local_server import HOST, Content, Gate, start_server
from slipfree.show.meshes import joined
from slipfree.show.scene import ARROWS, WORLD, Colors, Scene
from slipfree.system.interrupt import interrupt_arrived
from slipfree.vehicle.sections import TriangleMesh, sheet

if TYPE_CHECKING:
    import viser

RATE = 20.0  # frames per second
LONGEST = 30.0  # maximum duration of a page; longer motions are shown faster [s]
MOST = 400  # maximum number of points of a track
LIFT = 0.006  # height of the last track above the ground; others are higher [reach]
CONTACT_SIZE = 0.05  # [reach of the vehicle]
ARROW = {"shaft_radius": 0.014, "head_radius": 0.035, "head_length": 0.08}  # [reach]
WHITE = (255, 255, 255)  # of contact points, and around tracks
TRACK, CASING = 0.08, 0.13  # widths of tracks, and of their white edge [reach]
VIEW = np.array([0.75, -0.75, 0.65])  # direction to the camera, times its distance
SKY = 0.5  # ambient light, in addition to viser's two lamps
FAR = 1000.0  # far plane of the camera, unless the ground is larger [m]
CLOSE, NEAREST = 3.5, 0.05  # distance of the following camera, and near plane [reach]
PATH: dict[str, Any] = {"thickness": 3.0, "thickness_units": "screen"}  # [pixels]
LINES = {"north": 4.0}  # thickness of lines on the ground, by default 1 [pixels]
POLICY = (  # of a page that asks for nothing: its programs and data are in the page
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob: data:; worker-src blob: "
    "data:; connect-src blob: data:; img-src blob: data:; font-src data:; style-src "
    "'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


def serve(html: str, port: int, warn: Callable[[str], None], ready: Callable[[str], None]) -> None:
    """Show a page on this machine, until Ctrl-C; port zero selects a free one.

    ``warn`` is called, from any thread, with warnings, ``ready`` with the address of the page.
    """
    body = html.encode("utf-8", errors="backslashreplace")
    content = Content(body, "text/html; charset=utf-8", POLICY)
    gate = Gate("slipfree show", warn)
    server = start_server(port, {"/": lambda: content}, {}, gate)
    try:
        ready(gate.url(server.server_port))
        server.serve_forever()
    except KeyboardInterrupt:
        interrupt_arrived()
    finally:
        server.server_close()


def page(scene: Scene, title: str, color: str) -> str:
    """Return a self-contained HTML page that plays a scene, with an initial layer of the ground."""
    server = recorder()
    try:
        first, last = scene.span
        speed = max(1.0, (last - first) / LONGEST)
        count = max(int(np.ceil(RATE * (last - first) / speed)) + 1, 2)
        times = np.linspace(first, last, count)
        world = _add_world(server, scene, color)
        runs = [_RunNodes(server, scene, k, times) for k in range(len(scene.actors))]
        motions = [run for run in runs if run.tracks]
        colored = next(iter(motions[0].tracks)) if len(motions) == 1 else ""
        if colored:
            motions[0].tracks[colored].visible = True
        for run in runs:
            run.show(0)
        recording = server.get_scene_serializer()
        for k in range(times.size):
            for run in runs:
                run.show(k)
            if scene.is_far:  # the world moves so that the first vehicle stays in view
                world.position = runs[0].position(0) - runs[0].position(k)
            recording.insert_sleep((last - first) / speed / (count - 1))
        html = recording.as_html()
    finally:
        stop(server)
    words = [f"Played at {speed:.3g} times real speed."] if speed > 1 else []
    words += [f"The view follows {scene.actors[0].name}."] if scene.is_far else []
    shown = scene._replace(actors=tuple(run.actor for run in runs))
    return with_legend(html, shown, title, color, colored, words)


def recorder() -> viser.ViserServer:
    """Return a server of viser that records a scene, and refuses all requests to its port."""
    import viser
    from websockets.asyncio import server as web

    serve, is_closed = web.serve, False

    def closed(*words: Any, **options: Any) -> Any:
        nonlocal is_closed
        is_closed = True
        options["process_request"] = lambda connection, _: connection.respond(403, "")
        return serve(*words, **options)

    web.serve = closed  # type: ignore[assignment, misc]  # viser has no option for it
    try:
        with redirect_stdout(io.StringIO()):  # viser prints a banner despite verbose=False
            server = viser.ViserServer(host=HOST, port=0, verbose=False)
    finally:
        web.serve = serve  # type: ignore[misc]
    if not is_closed:
        stop(server)
        raise DataError(
            "show: expected a version of viser whose port slipfree can close, found "
            f"{viser.__version__}; install one: python -m pip install 'viser>=1.1,<1.2'"
        )
    return server


def stop(server: viser.ViserServer) -> None:
    """Stop a server and suppress its messages."""
    with redirect_stdout(io.StringIO()):
        server.stop()


def _add_world(server: viser.ViserServer, scene: Scene, color: str) -> Any:
    """Add lights, camera, ground and lines, with the layer ``color``; return the root's frame."""
    server.scene.set_up_direction("+z")
    # with an environment map a page would fade in again at each repetition
    server.scene.configure_environment_map(None)
    server.scene.configure_default_lights(cast_shadow=False)  # slow where there is no GPU
    server.scene.add_light_hemisphere("/sky", intensity=SKY)
    world = server.scene.add_frame(WORLD, show_axes=False)
    for lines in scene.ground.lines:
        root = f"{WORLD}/{lines.name}"
        server.scene.add_frame(root, show_axes=False)
        thickness = LINES.get(lines.name, 1.0)
        drawn = f"{root}/lines {thickness:g}", lines.segments.astype("f4"), np.array(lines.color)
        server.scene.add_line_segments(*drawn, thickness=thickness, thickness_units="screen")
        for k, (words, at) in enumerate(lines.labels, 1):
            look: dict[str, Any] = {"anchor": "center-center", "font_screen_scale": 0.8}
            server.scene.add_label(f"{root}/{k}", words, position=at, **look)
    for layer in scene.ground.layers:
        name, colors = f"{WORLD}/ground {layer.name}", scene.ground.colors(layer.name)
        node = _add_colored(server, name, scene.ground.mesh, colors)
        node.visible = layer.name == color
    low, high = scene.paths.min(axis=0), scene.paths.max(axis=0)
    middle = (low + high) / 2
    away = max(0.7 * float(np.linalg.norm(high - low)), 2.5 * scene.reach)
    if scene.is_far:
        middle, away = scene.actors[0].bodies[0].origins[0], CLOSE * scene.reach
    camera = server.initial_camera
    camera.look_at = middle
    camera.position = middle + away * VIEW
    size = float(np.linalg.norm(np.ptp(scene.ground.mesh.vertices, axis=0)))
    camera.near, camera.far = NEAREST * scene.reach, max(FAR, 10 * size)
    return world


class _RunNodes:
    """Nodes of the motion with index ``k`` of a scene in viser, which show it at given times."""

    def __init__(self, server: viser.ViserServer, scene: Scene, k: int, times: Array) -> None:
        whole, self.scales = scene.actors[k], scene.scales
        root, self.actor, self.end = f"{WORLD}/run {k + 1}", whole.at(times), whole.t[-1]
        server.scene.add_frame(root, show_axes=False)
        self.frames = []
        self.quaternions = [body.quaternions for body in self.actor.bodies]
        for count, body in enumerate(whole.bodies, 1):
            name = f"{root}/body {count}"  # not the part's name, which another node may have
            self.frames.append(server.scene.add_frame(name, show_axes=False))
            look: dict[str, Any] = {"flat_shading": not whole.ghost, "wireframe": whole.ghost}
            for number, (mesh, color) in enumerate(body.meshes):
                drawn = f"{name}/{number}", mesh.vertices, mesh.faces
                server.scene.add_mesh_simple(*drawn, color=color, side="double", **look)
        self.label = server.scene.add_label(f"{root}/name", whole.name, anchor="bottom-center")
        # names at distinct heights
        self.above = np.array([0.0, 0.0, (0.6 + 0.25 * k) * scene.reach])
        # Browsers cull point clouds by their initial position: this node moves with the vehicle.
        self.here = server.scene.add_frame(f"{root}/here", show_axes=False)
        self.contacts = server.scene.add_point_cloud(
            f"{root}/here/contacts",
            np.zeros((1, 3)),
            WHITE,
            point_size=CONTACT_SIZE * scene.reach,
            point_shape="circle",
            precision="float32",
        )
        sizes: dict[str, Any] = {name: size * scene.reach for name, size in ARROW.items()}
        self.arrows: dict[str, Any] = {}  # by name
        for each in whole.arrows:
            if scene.scales[each.name]:
                node = f"{root}/here/{each.name}"
                server.scene.add_frame(node, show_axes=False)  # to hide the arrows at all times
                self.arrows[each.name] = server.scene.add_arrows(
                    f"{node}/arrows", np.zeros((1, 2, 3)), ARROWS[each.name], **sizes
                )
        self.tracks = dict[str, Any]()  # nodes of colourings, by name
        # Tracks of contact points are raised against flicker; those of plans are dashed. Tracks in
        # the colours of quantities lie above the others, hidden, as the path of the overview is.
        root, lift = f"{root}/tracks", LIFT * (len(scene.actors) - k) * scene.reach
        every = max(1, whole.t.size // MOST)
        points, up = whole.contacts[::every], np.array([0.0, 0.0, lift])
        for width, color, height in ((CASING, WHITE, 0.5), (TRACK, whole.color, 1.0)):
            mesh = tracks(points + height * up, width * scene.reach, dashed=whole.ghost)
            drawn = f"{root}/{'edge' if color == WHITE else 'own'}", mesh.vertices, mesh.faces
            server.scene.add_mesh_simple(*drawn, color=color, side="double")
        path = whole.bodies[0].origins[::every]
        lines = np.stack([path[:-1], path[1:]], axis=1, dtype="f4")
        server.scene.add_line_segments(f"{root}/path", lines, whole.color, visible=False, **PATH)
        mesh = tracks(points + 1.5 * up, TRACK * scene.reach, dashed=whole.ghost)
        for layer in scene.track_layers(whole):
            colors = np.repeat(layer.colors[::every].swapaxes(0, 1).reshape(-1, 3), 2, axis=0)
            node = _add_colored(server, f"{root}/{layer.name}", mesh, colors)
            node.visible, self.tracks[layer.name] = False, node

    def position(self, k: int) -> Array:
        return np.asarray(self.actor.bodies[0].origins[k])

    def show(self, k: int) -> None:
        """Move the vehicle to its pose at the k-th time."""
        actor, middle = self.actor, self.position(k)
        for node, body, turned in zip(self.frames, actor.bodies, self.quaternions, strict=True):
            node.position, node.wxyz = body.origins[k], turned[k]
        stopped = actor.stop.partition(":")[0] if actor.t[k] == self.end else ""
        self.label.text = f"{actor.name}, {stopped or f't = {actor.t[k]:.2f} s'}"
        self.label.position = middle + self.above
        self.here.position = middle
        touching = np.isfinite(actor.contacts[k]).all(axis=-1)
        self.contacts.visible = bool(touching.any())
        if touching.any():
            points = actor.contacts[k, touching] - middle
            self.contacts.points = points.astype(np.float32)
        for each in actor.arrows:
            if each.name not in self.arrows:
                continue
            node, vectors = self.arrows[each.name], each.vectors[k] * self.scales[each.name]
            lines = np.stack([each.starts[k], each.starts[k] + vectors], axis=1) - middle
            kept = np.isfinite(lines).all(axis=(1, 2)) & (np.linalg.norm(vectors, axis=-1) > 0)
            lines = lines[kept].astype(np.float32)
            node.visible = len(lines) > 0
            if len(lines):
                node.points = lines


def tracks(points: Array, width: float, *, dashed: bool) -> TriangleMesh:
    """Return the mesh of level ribbons of a width [m] along tracks, shape (n, n_wheels, 3)."""
    ribbons = list[TriangleMesh]()
    for track in points.swapaxes(0, 1):
        ahead = np.gradient(track[:, :2], axis=0) if len(track) > 1 else np.zeros((1, 2))
        ahead = np.nan_to_num(ahead)  # beside points without contact
        size = np.linalg.norm(ahead, axis=1, keepdims=True)
        aside = np.pad(ahead / np.where(size > 0, size, 1.0), ((0, 0), (0, 1)))[:, [1, 0, 2]]
        aside *= (-width / 2, width / 2, 0.0)
        ribbon = sheet(np.stack([track - aside, track + aside], axis=1))
        faces = ribbon.faces.reshape(-1, 2, 3)[:: 2 if dashed else 1]
        faces = faces[np.isfinite(ribbon.vertices[faces]).all(axis=(1, 2, 3))]
        ribbons.append(TriangleMesh(np.nan_to_num(ribbon.vertices), faces.reshape(-1, 3)))
    return joined(*ribbons)


def _add_colored(server: viser.ViserServer, name: str, mesh: TriangleMesh, colors: Colors) -> Any:
    """Add a mesh with colours of its vertices to the scene of the viewer."""
    import trimesh

    def matt(tree: dict[str, Any]) -> None:
        """Set a matt material for all meshes of a glTF tree; the default is metallic and dark."""
        tree["materials"] = [{"pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}]
        for mesh in tree["meshes"]:
            for each in mesh["primitives"]:
                each["material"] = 0

    light = linear(colors)  # glTF expects colours in linear light, not in sRGB
    drawn = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=light, process=False)
    data: Any = drawn.export(file_type="glb", tree_postprocessor=matt)
    return server.scene.add_glb(name, data)


def linear(colors: Colors) -> Colors:
    """Return sRGB colours converted to linear light (IEC 61966-2-1), shape (n, 3)."""
    parts = colors / 255
    light = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.rint(255 * light), dtype=np.uint8)
