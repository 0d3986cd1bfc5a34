"""Tests of scenes: drawn objects are at the positions of the motion."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from numpy.testing import assert_allclose
from PIL import Image, ImageSequence
from scipy.spatial.transform import Rotation

import slipfree as sf
from helpers.cases import DATA, PROBLEMS
from helpers.commands import invoke, refused, refuses, sets, shown
from helpers.figures import moved
from helpers.problem_files import rough_ground
from slipfree.core.trajectory import Stop
from slipfree.files import netcdf
from slipfree.models.samples import measured_slip, part_poses, wheel_poses
from slipfree.show import ground_drawing, meshes
from slipfree.show import scene as scenes
from slipfree.show.film import Film, draw_faces, film_writer, picture, projected
from slipfree.show.html_page import with_legend
from slipfree.show.meshes import MOST, clipped, extruded, plate, rod, roller_axles, spokes
from slipfree.show.scene import Driven, drive_scene
from slipfree.vehicle.sections import Disc, Torus
from slipfree.vehicle.tree import Joint

PROBLEM = (DATA / "scene_of_a_hill.toml").read_text() + rough_ground(
    "[-6, 6]", "[-6, 6]", 0.25, "rms = 0.1, longest = 8.0, shortest = 2.0", 11
)
NAMED = (
    'verb = "direct"\n[terrain]\nfile = "flat.npz"\n[vehicle]\nfile = "cart.urdf"\n'
    '[start]\nheading = 0.2\n[driver]\nname = "straight"\nspeed = 0.3\n'
    "[time]\nduration = 0.4\nstep = 0.1\n"
)
CLIMB = (DATA / "scene_of_a_climb.toml").read_text()


def solved(folder: Path, name: str, text: str, *settings: str) -> Path:
    """Return the result file of a problem."""
    (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    out = folder / f"{name}.nc"
    invoke("run", folder / f"{name}.toml", "-o", out, "--no-draw", *sets(*settings), code=0)
    return out


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return solved(tmp_path_factory.mktemp("scene"), "hills", PROBLEM)


@pytest.fixture(scope="module")
def drive(file: Path) -> Driven:
    found = shown(file, "hills")
    assert isinstance(found, Driven)
    return found


@pytest.fixture(scope="module")
def climb_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return solved(tmp_path_factory.mktemp("scene"), "step", CLIMB)


def volume(mesh: Any) -> float:
    """Return the volume in a closed surface, negative if its faces look inwards."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces.astype(int)], 1, 0)
    return float((a * np.cross(b, c)).sum() / 6)


def test_shapes_are_closed_and_look_outwards() -> None:
    assert_allclose(volume(Torus(0.05, 0.25).mesh()), 2 * np.pi**2 * 0.25 * 0.05**2, rtol=0.06)
    assert_allclose(np.linalg.norm(Disc(0.3).mesh().vertices[:, 1:], axis=1).max(), 0.3)
    assert_allclose(volume(rod((1, 2, 3), (1, 2, 5), 0.1)), 4 * np.sqrt(2) * 0.1**2)
    assert_allclose(volume(plate(1.0, -1.0, 3.0, 0.1)), 0.1 * (2 * 3 + 1))
    square = np.array([(0.0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    assert_allclose(volume(block := extruded(square, (0, 0, 2))), 2)
    inside_out, beside = block._replace(faces=block.faces[:, ::-1]), rod((5, 0, 0), (5, 1, 0), 0.1)
    whole = meshes.joined(inside_out, beside)
    for mesh in (whole, meshes.reduced({"": whole}, len(whole.faces) - 4)[""]):
        assert volume(meshes.outward(mesh)) == pytest.approx(2 + volume(beside), abs=0.02)
    sides = meshes.outward(block._replace(faces=block.faces[2:]))  # an open one
    assert (len(sides.faces), volume(sides)) == (2 * len(block.faces) - 4, 0)
    assert volume(spokes(0.3)) > 0
    points = roller_axles(0.3, np.pi / 4).vertices.reshape(9, -1, 3)
    centers = points.mean(axis=1)
    np.testing.assert_allclose(np.hypot(*centers[:, 1:].T), 0.3)
    for rod_points, center in zip(points, centers, strict=True):
        along = np.linalg.svd(rod_points - center)[2][0]
        forward = np.cross([1, 0, 0], center / 0.3)
        assert np.arctan(along @ forward / along[0]) == pytest.approx(np.pi / 4, abs=1e-9)
    assert_allclose(clipped([(0, 0), (4, 0), (0, 4)], (1, 1), (9, 9)), [(1, 1), (3, 1), (1, 3)])
    assert clipped([(0, 0), (1, 0), (0, 1)], (2, 2), (3, 3)).shape == (0, 2)


def test_poses_are_those_of_the_motion(drive: Driven) -> None:
    run, vehicle = drive.run, drive.vehicle
    parts, wheels = part_poses(vehicle, run), wheel_poses(vehicle, run)
    assert_allclose(parts.origins[:, 0], np.stack([run[name] for name in "xyz"], axis=1))
    centers = np.stack([run[f"center_{axis}"] for axis in "xyz"], axis=-1)
    assert_allclose(wheels.origins, centers, atol=1e-12)
    bodies = {body.name: body for body in drive_scene([drive]).actors[0].bodies}
    whole = Rotation.from_quat(np.stack([run[f"quaternion_{each}"] for each in "xyzw"], axis=1))
    forward, platform = whole.apply([1, 0, 0]), bodies["platform"]
    assert_allclose(platform.rotations[:, :, 1], forward, atol=1e-12)
    turned = Rotation.from_quat(platform.quaternions[:, [1, 2, 3, 0]]).apply([0, 1, 0])
    assert_allclose(turned, forward, atol=1e-12)
    assert {"left", "right", "front"} <= {*bodies}


def test_arrows_are_slip_and_forces(drive: Driven) -> None:
    scene = drive_scene([drive])
    slip, force = scene.actors[0].arrows
    assert (slip.name, force.name) == ("slip", "force")
    assert np.abs(slip.vectors).max() > 1e-4
    assert_allclose(slip.vectors[2:-2], measured_slip(drive.vehicle, drive.run), atol=2e-6)
    weight = np.broadcast_to([0, 0, drive.vehicle.weight], (drive.run.t.size, 3))
    assert_allclose(force.vectors.sum(axis=1), weight, atol=2e-3)
    longest = np.linalg.norm(force.vectors, axis=-1).max() * scene.scales["force"]
    assert 0.4 * scene.reach < longest < 0.65 * scene.reach
    assert "force: 1 m of arrow length represents 150 N" in [each.label for each in scene.entries]
    speeds = 1e3 * np.linalg.norm(slip.vectors, axis=-1)
    assert_allclose(scene.actors[0].values["slip"], speeds, rtol=1e-6, atol=1e-9)
    fast, full = 1 + 0 * slip.vectors, scene.scales["slip"]
    for vectors, scale in ((10 * slip.vectors, full), (fast, full / 10), (0 * fast + 3e-5, 0)):
        changed = scene.actors[0]._replace(arrows=(slip._replace(vectors=vectors),))
        assert scenes.arrow_scales([changed], scene.reach)[0]["slip"] == scale


def test_the_ground_is_that_of_the_motion(drive: Driven) -> None:
    scene = drive_scene([drive])
    points = scene.ground.mesh.vertices + scene.origin
    heights = drive.terrain.elevation(points[:, 0], points[:, 1])
    assert_allclose(points[:, 2], heights, atol=1e-4)  # the spline of nodes near by
    assert len(scene.ground.mesh.faces) <= 2 * scenes.SIDE**2
    by_name = {layer.name: layer for layer in scene.ground.layers}
    assert list(by_name) == ["height", "slope"]
    order = np.argsort(points[:, 2])
    lightness = by_name["height"].colors[order].astype(float) @ (0.3, 0.6, 0.1)
    assert (np.diff(lightness) > -2).all()  # they grow lighter, for every eye
    assert scene.notes[0].startswith("Drawn ground: ")
    assert (
        f"{np.ptp(points[:, 0]):.4g} x {np.ptp(points[:, 1]):.4g} m of 12 x 12 m" in scene.notes[0]
    )
    contacts = scene.actors[0].contacts + scene.origin
    normals = scenes.ground_normals(drive.terrain, contacts)
    assert_allclose(np.linalg.norm(normals, axis=-1), 1)
    assert (normals[..., 2] > 0.8).all()


def test_blocked_ground_is_gray(drive: Driven) -> None:
    from slipfree.geometry.regions import Region

    plan = drive._replace(keep_out=(Region.disc(1.5, 0.0, 0.5),), places=(("goal", 0.5, 1.0),))
    scene = drive_scene([plan], with_poses=True)
    border = (scene.ground.lines[-2].segments + scene.origin)[..., :2] - (1.5, 0.0)
    assert_allclose(np.linalg.norm(border, axis=-1), 0.5, rtol=2e-3)
    assert [layer.name for layer in scene.ground.layers[2:]] == ["traversability"]
    away = np.hypot(*(scene.ground.mesh.vertices + scene.origin)[:, :2].T - [[1.5], [0.0]])
    gray = (scene.ground.layers[2].colors == scenes.BLOCKED).all(axis=1)
    assert gray[away < 1.5].all()
    assert not gray.all()
    texts = {each.get_text(): each for each in picture(scene, "title").make().axes[0].texts}
    assert texts["goal"].get_visible()


def test_relief_is_lit_from_the_north_west_in_all_pictures() -> None:
    """Pixels of a map, brightness of scenes, and faces of films: of a hill with a round foot."""
    x = np.linspace(-6, 6, 41)
    z = 0.7 * np.exp(-(x[:, None] ** 2 + x**2) / 6)
    canvas = FigureCanvasAgg(Figure(figsize=(2, 2)))
    ground_drawing.relief(x, x, z, canvas.figure.add_axes((0, 0, 1, 1)))
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[::-1, :, 0].T  # from the south-western corner
    points = np.stack([*np.meshgrid(x, x, indexing="ij"), z], axis=-1)
    corners = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    faces, film = np.stack(corners, axis=2).reshape(-1, 4, 3), PolyCollection([])
    draw_faces(film, faces, np.ones((1600, 3)), np.zeros(3))
    order = np.argsort(projected(faces, np.zeros(3))[..., 2].mean(axis=1))
    lit = film.get_facecolor()[np.argsort(order), 0].reshape(40, 40)
    for light in (pixels, ground_drawing.brightness(x, x, z), lit):
        low, high = int(0.38 * len(light)), int(0.62 * len(light))
        assert light[low, high] > 1.05 * light[low, low] > 1.1 * light[high, low], light.shape
    draw_faces(film, faces[:, ::-1], np.ones((1600, 3)), np.zeros(3))  # seen from below
    assert not film.get_paths()  # the other sides of bodies would cover those that are seen


def test_labels_of_a_grid_differ_and_are_complete(drive: Driven) -> None:
    grid = drive.terrain.grid
    large = sf.Bicubic(sf.Grid(500_000 + 1000 * grid.x, 4_512_000 + 1000 * grid.y, grid.z))
    lines = scenes.map_lines(large.grid, large, large.grid.domain, np.zeros(3), 1.0)
    labels = [words for words, _ in next(each for each in lines if each.name == "grid").labels]
    assert {"x 500000 m", "y 4512000 m"} <= {*labels}
    assert len({*labels}) == len(labels) > 8


def test_poses_between_samples_are_interpolated(drive: Driven) -> None:
    actor = drive_scene([drive]).actors[0]
    now, wheel = actor.at(0.7 * actor.t[20] + 0.3 * actor.t[21]).bodies[-1], actor.bodies[-1]
    assert_allclose(now.origins[0], (0.7, 0.3) @ wheel.origins[20:22], atol=1e-12)
    ends = Rotation.from_matrix(wheel.rotations[20:22])
    angles = (ends.inv() * Rotation.from_matrix(now.rotations)).magnitude()
    assert_allclose(angles, np.array([0.3, 0.7]) * angles.sum(), atol=1e-9)


def test_runs_share_a_ground_and_say_where_it_differs(drive: Driven) -> None:
    scene = drive_scene([drive, lifted(drive, 0.01)])
    assert [actor.name for actor in scene.actors] == ["hills", "other"]
    assert scene.actors[0].color != scene.actors[1].color
    said = (
        "The drawn ground is that of hills; the ground of other differs from it by up to 0.01 m "
        "along that motion."
    )
    assert scene.warnings == (said,)
    assert said in with_legend("<body></body>", scene, "title", "height", "", [])
    radius = drive.vehicle.wheels[0].radius
    high = lifted(drive, 1.01 * radius)
    refuses(sf.ModelError, "differs from that of hills by at most", drive_scene, [drive, high])
    grid = drive.terrain.grid
    far = sf.Bicubic(sf.Grid(grid.x + 100, grid.y, grid.z))
    away = drive._replace(name="other", terrain=far, run=moved(drive.run, x=100))
    message = "hills: expected a motion on the ground of other, found one that leaves it"
    refuses(sf.ModelError, message, drive_scene, [away, drive])


def lifted(drive: Driven, by: float) -> Driven:
    """Return a motion as it would have been on ground that is higher throughout. [m]."""
    grid = drive.terrain.grid
    higher = sf.Bicubic(sf.Grid(grid.x, grid.y, grid.z + by), drive.terrain.center)
    return drive._replace(name="other", terrain=higher, run=moved(drive.run, z=by))


def test_a_long_way_is_drawn_finely_and_followed(drive: Driven) -> None:
    """A vehicle of one metre on a map of kilometres stands on the ground that is drawn."""
    x = np.linspace(-3000, 3000, 601)
    waves = 5 * np.sin(x / 20)[:, None] * np.cos(x / 25)
    large = sf.Bicubic(sf.Grid(x, x, waves))
    way = np.linspace(-2000, 2000, drive.run.t.size)
    run = moved(drive.run, x=0.0)
    columns = dict(run.columns)
    for name, shift in (("x", way), ("y", 0.7 * way)):
        for each in (name, f"contact_{name}"):
            values = run[each] - run[each][:1]
            values = values + (shift if values.ndim == 1 else shift[:, None])
            columns[each] = run.columns[each]._replace(values=values)
    height = large.elevation(columns["contact_x"].values, columns["contact_y"].values)
    columns["contact_z"] = run.columns["contact_z"]._replace(values=height)
    far = drive._replace(terrain=large, run=replace(run, columns=columns))
    scene = drive_scene([far])
    assert scene.is_far
    assert not drive_scene([drive]).is_far
    points = scene.ground.mesh.vertices + scene.origin
    fine = points[scenes.SIDE**2 :]
    assert 10_000 < len(fine) <= MOST
    assert all(len(layer.colors) == len(points) for layer in scene.ground.layers)
    x, y = fine[:, 0], fine[:, 1]
    beside = fine[(np.abs(0.7 * x - y) < 3) & (np.abs(x) < 1990)]
    assert len(beside) > 1000
    assert_allclose(beside[:, 2], large.elevation(beside[:, 0], beside[:, 1]), atol=1e-9)
    first = [part[0] for part in (columns["x"].values, columns["y"].values)]
    assert np.hypot(*(fine[:, :2] - first).T).min() < 5
    corners = scene.ground.mesh.vertices[scene.ground.mesh.faces.astype(int)][:, :, :2]
    (a, b), (c, d) = corners[:, 1].T - corners[:, 0].T, corners[:, 2].T - corners[:, 0].T
    covered = 0.5 * (a * d - b * c).sum()  # once, without holes
    assert_allclose(covered, np.prod(np.ptp(points[:, :2], axis=0)), rtol=1e-9)
    off = float(next(note for note in scene.notes if "apart" in note).split()[8])
    assert off < 0.1
    assert scene.warnings == () or off > 0.1 * 0.3


def test_a_motion_that_stopped_says_so(drive: Driven) -> None:
    run = replace(drive.run, stop=Stop("grip", 1.0, "a wheel has no grip", sf.Outcome.LIMIT))
    scene = drive_scene([drive._replace(run=run)])
    assert scene.actors[0].stop == "stopped at t = 1 s: a wheel has no grip"
    assert scene.actors[0].stop in with_legend("<body></body>", scene, "title", "height", "", [])
    assert drive_scene([drive]).actors[0].stop == ""


@pytest.mark.slow
def test_a_solved_plan_is_where_its_simulation_is(tmp_path: Path) -> None:
    """Every quantity, of every wheel, by the layout that the planner itself saves."""
    text = (PROBLEMS / "plan_rigid_hills.toml").read_text()
    small = ["plan.intervals=4", "time.duration=10.0", "goal.x=0.1", "goal.y=1.3", "costs.slip="]
    found = shown(solved(tmp_path, "plan", text, *small), "plan")
    assert found.plan is not None
    run = found.run
    for name in ("x", "y", "z", "heading", "pitch", "contact_x", "contact_y", "contact_z"):
        replayed = [np.interp(found.plan.t, run.t, each) for each in np.atleast_2d(run[name].T)]
        assert_allclose(np.atleast_2d(found.plan[name].T), replayed, atol=2e-3)
    motion, plan = drive_scene([found]).actors
    assert (plan.name, plan.ghost, motion.ghost) == ("plan: plan", True, False)
    for actor in (motion, plan):  # no wheel touches the ground far from itself
        wheels = np.stack([body.origins for body in actor.bodies[-3:]], axis=1)
        assert np.linalg.norm(actor.contacts - wheels, axis=-1).max() < 0.31


def test_a_planar_vehicle_is_drawn_on_solids(climb_file: Path) -> None:
    found = shown(climb_file, "step")
    scene = drive_scene([found])
    (actor,), run = scene.actors, found.run
    bodies = {body.name: body for body in actor.bodies}
    assert_allclose(bodies["front"].origins[:, 1] + scene.origin[1], run["center_y", "front"])
    assert_allclose(bodies["platform"].rotations[:, 2, 1], np.sin(run["pitch"]), atol=1e-12)
    assert_allclose((actor.contacts + scene.origin)[..., 2], 0, atol=1e-3)  # pressed in a little
    forces = np.nansum(actor.arrows[1].vectors, axis=1)
    assert_allclose(forces[0, 2], 9.81 * 21.6, rtol=1e-2)
    assert_allclose(scene.ground.mesh.vertices[:, 2].max() + scene.origin[2], 0.09)


def unseen(*words: object) -> str:
    """Return the error of a command that refuses to show a result."""
    return refused("show", *words, "--no-browser")


def test_what_cannot_be_shown_is_refused(file: Path, tmp_path: Path) -> None:
    run, arrays = netcdf.read(file), netcdf.read_arrays(file)
    bare = tmp_path / "bare.nc"
    attributes = {name: words for name, words in run.attributes.items() if name != "problem"}
    netcdf.write(bare, replace(run, attributes=attributes))
    assert "expected a result that contains its problem, found none" in unseen(bare)
    old = {**run.attributes, "problem": PROBLEM.replace("speed", "pace")}
    netcdf.write(bare, replace(run, attributes=old), arrays)
    assert "correct these errors and run the problem again:\nhills.toml:" in unseen(bare)
    assert "expected a separate file, found the input" in unseen(file, "--html", file)


@pytest.mark.slow
def test_films_and_pictures(file: Path, climb_file: Path, tmp_path: Path) -> None:
    for each, count in ((file, 21), (climb_file, 3)):
        out = tmp_path / f"{each.stem}.gif"
        invoke("show", each, "--animation", out, code=0)
        with Image.open(out) as film:
            frames = [np.array(e.convert("RGB"), dtype=int) for e in ImageSequence.Iterator(film)]
        first, *_, last = frames
        assert len(frames) == count
        assert (np.abs(first - last).max(axis=2) > 30).sum() > 20
        assert (np.ptp(last[-18:], axis=2) < 20).all()  # no brown ground
        assert out.stat().st_size < 20_000 * count
    pictures = []
    for time in ("0", "0.5"):
        invoke("show", file, "--picture", tmp_path / "p.png", "--at", time, code=0)
        pictures.append(np.asarray(Image.open(tmp_path / "p.png").convert("RGB"), dtype=int))
    assert (np.abs(pictures[1] - pictures[0]).max(axis=2) > 30).sum() > 200


def test_places_are_checked_before_anything_is_drawn(
    file: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "d.html").mkdir()
    monkeypatch.setattr("slipfree.problem.result.read", lambda _: pytest.fail("read"))
    for option, name, said in (
        ("--animation", "a.avi", "a name that ends in .mp4 or .gif, found '.avi'; use a.mp4"),
        ("--animation", "gone/a.gif", "expected a folder gone to write to, found none"),
        ("--animation", str(file), "expected a separate file, found the input"),
        ("--html", "a.gif", "expected a name that ends in .html"),
        ("--html", "d.html", "expected the name of a file to write, found a folder"),
    ):
        assert said in unseen(file, option, name)
    assert {path.name for path in folder.iterdir()} == {"d.html"}


def test_pictures_have_fine_ground_a_scale_and_paths_on_the_ground(drive: Driven) -> None:
    """As far as the ground is drawn, which is finer than in films."""
    scene = drive_scene([drive._replace(places=(("goal", 0.5, 1.0),), wanted=np.eye(2))])
    ax = picture(scene, "title").make().axes[0]
    ground = ax.collections[0]
    assert 0.9 * 89**2 < len(ground.get_paths()) <= 89**2  # without faces seen from below
    assert ground.get_clip_on()
    (bar,), (words, goal) = ax.lines, ax.texts
    path, *arrows = (each.get_color() for each in ax.get_legend().legend_handles)
    assert path not in arrows == [(0, 0, 0), (1, 0, 1)]
    _, posts, *_ = (each for each in ax.collections if each.get_zorder() == 1)
    assert_allclose(goal.get_position(), posts.get_segments()[0][1])
    assert words.get_text() == f"{np.ptp(bar.get_xdata()):g} m"
    body = scene.actors[0].bodies[0]
    body = body._replace(origins=body.origins + np.linspace(0, 90, len(body.origins))[:, None])
    far = scene.actors[0]._replace(bodies=(body,))
    away = scene._replace(actors=(far, far._replace(ghost=True)))  # the plan lies below
    ax = picture(away, "title", 0.0).make().axes[0]
    *_, edge, path = (each for each in ax.collections if each.get_zorder() == 1)
    assert 0 < np.nanmax(np.abs(edge.get_segments()[0])) < 2 * ax.get_xlim()[1]
    assert len(path.get_segments()) == len(path.get_colors()) == drive.run.t.size - 1


def test_plots_say_where_they_end_and_their_lines_differ(drive: Driven) -> None:
    """In pages and films; lines at the end of an axis are not cut."""
    (actor,), far = drive_scene([drive]).actors, np.full((drive.run.t.size, 6), 2.0)
    values = {"clearance": far, "slip": far, "tip_over_margin": far[:, 0]}
    wheels = tuple(f"wheel_{k}" for k in range(6))
    scene = drive_scene([drive])._replace(actors=(actor._replace(wheels=wheels, values=values),))
    html = with_legend("<body></body>", scene, "title", "height", "", [])
    assert all(end in html for end in ("clearance, 0 to 1 m or more:", "margin, 0 to "))
    curves = [curve for each in scene.plotted for curve in scene.curves(each)]
    assert len({color for _, color, *_ in curves}) == 7
    axes = Film(Figure(layout="constrained"), scene, "title", 1.0).canvas.figure.axes
    shown = [ax for ax in axes if ax.get_xlabel().endswith("over time [s]")]
    assert all(line.get_ydata().max() < ax.get_ylim()[1] for ax in shown for line in ax.lines[:-1])


def test_an_interrupted_film_leaves_nothing(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "film.gif"
    out.write_bytes(b"the film before")
    seen = []

    def show(_: Any, t: float) -> None:
        seen.append(t)
        if len(seen) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr("slipfree.show.film.Film.show", show)
    invoke("show", file, "--animation", out, code=130)
    assert out.read_bytes() == b"the film before"
    assert list(tmp_path.iterdir()) == [out]


def test_without_ffmpeg_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FFMpegWriter, "isAvailable", classmethod(lambda _: False))
    refuses(sf.DataError, "program ffmpeg, found none; install it", film_writer, Path("f.mp4"), 20)


def test_holes_are_drawn_empty(drive: Driven) -> None:
    grid = drive.terrain.grid
    holes = np.zeros(grid.z.shape, bool)
    holes[:6] = True
    terrain = sf.Bicubic(sf.Grid(grid.x, grid.y, grid.z, holes=holes), drive.terrain.center)
    drawn = drive_scene([drive._replace(terrain=terrain)])
    mesh = drawn.ground.mesh
    x, _, _ = (mesh.vertices[mesh.faces].mean(axis=1) + drawn.origin).T
    assert len(x) > 1000
    assert x.min() > grid.x[6] - np.ptp(grid.x) / scenes.SIDE
    around, _ = drawn.backdrop.near(np.array([grid.x[6], 0.0, 0.0]) - drawn.origin, 1.0, 24)
    assert 0 < len(around) < len(drive_scene([drive]).backdrop.near(np.zeros(3), 1.0, 24)[0])


@pytest.mark.usefixtures("direct_reads")
def test_meshes_of_a_urdf_are_drawn(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    text = (Path(__file__).parents[1] / "data" / "cart.urdf").read_text(encoding="utf-8")
    body = '<link name="base_link">\n    <visual><origin xyz="0.1 0 0.2"/><geometry>'
    body += '<mesh filename="body.stl" scale="0.5 0.5 0.5"/></geometry></visual>'
    wheel = '<visual><geometry><mesh filename="wheel.stl"/></geometry></visual>'
    text = text.replace('<link name="base_link">', body).replace(
        left := '<link name="left_wheel">', left + wheel
    )
    text = text.replace(
        '<origin xyz="0 0.25 0"/>', '<origin xyz="0 0.25 0"/><limit velocity="1" effort="1e-6"/>'
    )
    fork = '"fork"><collision><geometry><sphere radius="0.01"/></geometry></collision>'
    (tmp_path / "cart.urdf").write_text(text.replace('"fork">', fork), encoding="utf-8")
    trimesh.creation.box((1.0, 0.6, 0.2)).export(tmp_path / "body.stl")
    trimesh.creation.icosphere(radius=0.15).export(tmp_path / "wheel.stl")  # lidar.stl is missing
    x = np.linspace(-3, 3, 13)
    np.savez(tmp_path / "flat.npz", x=x, y=x, z=np.zeros((13, 13)))
    found = shown(solved(tmp_path, "cart", NAMED), "cart")
    assert isinstance(found, Driven)
    (faster,) = found.run.facts["faster_wheels"].value
    assert (faster["wheel"], faster["limit"], faster["value"] > 1) == ("left_drive", 1.0, True)
    assert [each["wheel"] for each in found.run.facts["overloaded_wheels"].value] == ["left_drive"]
    (actor,), origin = (scene := drive_scene([found])).actors, scene.origin
    bodies = {each.name: each for each in actor.bodies}
    assert actor.bodies[0].name == "platform"
    assert {*bodies} == {"platform", "base_link", "left_wheel", "right_drive", "caster_wheel"}
    assert_allclose(np.ptp(bodies["caster_wheel"].meshes[0][0].vertices, 0), (0.2, 0.03, 0.2))
    ((mesh, color),) = bodies["base_link"].meshes
    assert color == actor.color
    assert_allclose(np.ptp(mesh.vertices, axis=0), (0.5, 0.3, 0.1), atol=1e-6)
    assert_allclose(mesh.vertices.mean(axis=0), (0.1, 0.0, 0.2), atol=1e-6)
    wheels, names = wheel_poses(found.vehicle, found.run), [w.name for w in found.vehicle.wheels]
    left = wheels.origins[:, names.index("left_drive")]
    assert_allclose(bodies["left_wheel"].origins, left - origin, atol=1e-9)
    forward = bodies["base_link"].rotations[:, :, 0]
    assert_allclose(forward, bodies["platform"].rotations[:, :, 1], atol=1e-9)
    assert "cart is drawn without the links lidar, whose" in scene.warnings[0]
    few = drive_scene([found._replace(visuals={"left_wheel": found.visuals["left_wheel"]})])
    assert "without the links base_link, caster_wheel, lidar," in few.warnings[0]
    (plain,) = drive_scene([found._replace(robot=None)]).actors
    assert few.actors[0].bodies[0].meshes
    assert len(plain.bodies[0].meshes[0][0].vertices) % 32 == 0  # rods, without a plate
    base, onto = Joint("base", "platform", "x", (0.0, 0.0, 0.0), "0"), {"platform": "base"}
    joints, wheels = (
        [replace(each, parent=onto.get(each.parent, each.parent)) for each in kind]
        for kind in (found.vehicle.joints, found.vehicle.wheels)
    )
    empty = replace(found.vehicle, joints=(base, *joints), wheels=tuple(wheels))
    (moved_actor,) = drive_scene([found._replace(vehicle=empty)]).actors
    assert moved_actor.bodies[0].name == "platform"  # which has no shapes
