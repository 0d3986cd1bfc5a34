"""What there is to draw of a motion is where the motion was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter
from numpy.testing import assert_allclose
from PIL import Image
from typer.testing import CliRunner

from slipfree import result_file
from slipfree.cli import app
from slipfree.errors import DataError, ModelError
from slipfree.kinematics.poses import part_poses, wheel_poses
from slipfree.kinematics.slip import measured_slip
from slipfree.plan.saved import Saved
from slipfree.plan.transcribe import Mesh, positions
from slipfree.problem.shown import shown
from slipfree.show.climb_scene import climb_scene
from slipfree.show.film import film_writer
from slipfree.show.scene import BLOCKED, SIDE, Driven, drive_scene, ground_normals, scale_words
from slipfree.show.shapes import clipped, extruded, plate, rod, spokes, tyre

PROBLEM = """\
verb = "direct"
slip = "traction"

[terrain]
friction = 0.6

[terrain.synthetic]
x = [-6, 6]
y = [-6, 6]
spacing = 0.25
power_law = { rms = 0.1, hurst = 0.9, longest = 8.0, shortest = 2.0, seed = 11 }

[vehicle]
catalog = "three_wheeler"
stiffness = 60.0

[traction]
creep = 1e-3

[start]
x = 0.0
y = -2.0
heading = 0.4

[driver]
name = "straight"
speed = 0.3

[time]
duration = 1.0
step = 0.02
"""
CLIMB = """\
verb = "climb"

[profile.step]
height = 0.09

[friction]
static = 0.8
kinetic = 0.6

[vehicle]
catalog = "seven_wheels"

[control]
speed = 0.25

[start]
distance = 0.05

[time]
duration = 0.1
step = 0.01
"""


def solved(folder: Path, name: str, text: str, *settings: str) -> Path:
    """Return the result file of a problem."""
    (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    out = folder / f"{name}.nc"
    words = ["run", str(folder / f"{name}.toml"), "-o", str(out), "--no-draw"]
    words += [word for each in settings for word in ("--set", each)]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
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
    assert_allclose(volume(tyre(0.05, 0.25)), 2 * np.pi**2 * 0.25 * 0.05**2, rtol=0.06)
    assert_allclose(np.linalg.norm(tyre(0.0, 0.3).vertices[:, 1:], axis=1).max(), 0.3)
    octagon = 2 * np.sqrt(2) * 0.1**2
    assert_allclose(volume(rod((1, 2, 3), (1, 2, 5), 0.1)), 2 * octagon)
    assert_allclose(volume(plate(1.0, -1.0, 3.0, 0.1)), 0.1 * (2 * 3 + 1))
    square = np.array([(0.0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    assert_allclose(volume(extruded(square, (0, 0, 2))), 2)
    assert volume(spokes(0.3)) > 0
    assert_allclose(clipped([(0, 0), (4, 0), (0, 4)], (1, 1), (9, 9)), [(1, 1), (3, 1), (1, 3)])
    assert clipped([(0, 0), (1, 0), (0, 1)], (2, 2), (3, 3)).shape == (0, 2)


def test_poses_are_those_of_the_motion(drive: Driven) -> None:
    run, vehicle = drive.run, drive.vehicle
    parts, wheels = part_poses(vehicle, run), wheel_poses(vehicle, run)
    assert_allclose(parts.origins[:, 0], np.stack([run[name] for name in "xyz"], axis=1))
    centers = np.stack([run[f"center_{axis}"] for axis in "xyz"], axis=-1)
    assert_allclose(wheels.origins, centers, atol=1e-12)
    bodies = {body.name: body for body in drive_scene([drive]).actors[0].bodies}
    x, y, z, w = (run[f"quaternion_{name}"] for name in "xyzw")
    forward = np.stack([1 - 2 * (y**2 + z**2), 2 * (x * y + z * w), 2 * (x * z - y * w)], axis=1)
    assert_allclose(bodies["platform"].rotations[:, :, 1], forward, atol=1e-12)
    w, x, y, z = bodies["platform"].quaternions.T  # takes the y axis forward
    turned = np.stack([2 * (x * y - z * w), 1 - 2 * (x**2 + z**2), 2 * (y * z + x * w)], axis=1)
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
    assert 0.5 * scene.reach < longest < 1.3 * scene.reach
    assert scale_words(scene, "force") == "an arrow of 1 m is 100 N"


def test_the_ground_is_that_of_the_motion(drive: Driven) -> None:
    scene = drive_scene([drive])
    points = scene.ground.mesh.vertices + scene.origin
    heights = drive.terrain.elevation(points[:, 0], points[:, 1])
    assert_allclose(points[:, 2], heights, atol=1e-4)  # the spline of nodes near by
    assert len(scene.ground.mesh.faces) <= 2 * SIDE**2
    by_name = {layer.name: layer for layer in scene.ground.layers}
    assert list(by_name) == ["height", "slope", "traversability"]
    order = np.argsort(points[:, 2])
    lightness = by_name["height"].colors[order].astype(float) @ (0.3, 0.6, 0.1)
    assert (np.diff(lightness) > -2).all()  # viridis grows lighter, for every eye
    assert scene.notes[0].startswith("Ground drawn: ")
    assert (
        f"{np.ptp(points[:, 0]):.4g} x {np.ptp(points[:, 1]):.4g} m of 12 x 12 m" in scene.notes[0]
    )
    contacts = scene.actors[0].contacts + scene.origin
    normals = ground_normals(drive.terrain, contacts)
    assert_allclose(np.linalg.norm(normals, axis=-1), 1)
    assert (normals[..., 2] > 0.8).all()


def test_blocked_ground_is_gray(drive: Driven) -> None:
    from slipfree.plan.region import Disc

    at = (1.5, 0.0)
    scene = drive_scene([drive._replace(keep_out=(Disc(*at, 0.5),))])
    away = np.hypot(*(scene.ground.mesh.vertices + scene.origin)[:, :2].T - np.array(at)[:, None])
    gray = (scene.ground.layers[2].colors == BLOCKED).all(axis=1)
    assert gray[away < 1.5].all()
    assert not gray.all()


def test_a_small_part_of_a_large_map_is_drawn(drive: Driven) -> None:
    from slipfree.terrain.base import Grid
    from slipfree.terrain.bicubic import Bicubic

    x = np.linspace(-500, 500, 1001)
    large = Bicubic(Grid(x, x, 0.05 * x[:, None] + 0 * x))
    run = drive.run
    columns = {**run.columns, "contact_z": run.columns["contact_z"]._replace(
        values=0.05 * run["contact_x"])}  # fmt: skip
    scene = drive_scene([drive._replace(terrain=large, run=replace(run, columns=columns))])
    assert len(scene.ground.mesh.faces) <= 2 * SIDE**2
    assert np.ptp(scene.ground.mesh.vertices[:, 0]) < 12
    assert scene.ground.layers[1].legend == "0 to 2.86 degrees"
    assert "Drawn ground and contact points are" in scene.notes[1]
    assert float(scene.notes[1].split()[6]) < 1e-9


def test_runs_share_a_ground_and_say_where_it_differs(drive: Driven) -> None:
    from slipfree.terrain.base import Grid
    from slipfree.terrain.bicubic import Bicubic

    grid = drive.terrain.grid
    higher = Bicubic(Grid(grid.x, grid.y, grid.z + 0.01), drive.terrain.center)
    scene = drive_scene([drive, drive._replace(name="other", terrain=higher)])
    assert [actor.name for actor in scene.actors] == ["hills", "other"]
    assert scene.actors[0].color != scene.actors[1].color
    assert "The ground is that of hills; that of other differs by 0.01 m at most." in scene.notes
    far = Bicubic(Grid(grid.x + 100, grid.y, grid.z))
    with pytest.raises(ModelError, match="other is on other ground than hills"):
        drive_scene([drive, drive._replace(name="other", terrain=far)])


def test_a_plan_is_drawn_beside_its_simulation(file: Path, tmp_path: Path) -> None:
    """The unknowns of a plan, laid out as a plan saves them, lead back to its poses."""
    run = result_file.read(file)
    states = ["x", "y", "heading", "tilt_right", "tilt_left", "steer"]
    unknowns = ["z", "roll", "pitch", "contact_x", "contact_y"]
    mesh = Mesh(np.linspace(0, 1, 11), 3)
    layout = positions(mesh, (6, 9, 1), continuous=False)
    values = np.zeros(layout.duration + 1)
    values[layout.duration] = 1.0
    at = mesh.nodes[1:].reshape(10, 3)

    def sampled(names: list[str], t: Any) -> np.ndarray:
        columns = [column for name in names for column in np.atleast_2d(run[name].T)]
        return np.stack([np.interp(t, run.t, column) for column in columns], axis=-1)

    shift = np.zeros(15)
    shift[0] = 0.25  # the plan's own coordinates begin elsewhere
    values[layout.first] = sampled(states, 0.0) - shift[:6]
    values[layout.states] = sampled(states, at) - shift[:6]
    values[layout.unknowns] = sampled(unknowns, at)
    sizes = np.array([3.0, 6, 9, 1, 0])
    saved = Saved(mesh.ends, sizes, values, values, values, shift, np.zeros(1))
    out = tmp_path / "planned.nc"
    result_file.write(out, run, saved.arrays)
    found = shown(out, "planned")
    assert found.plan is not None
    for name in ("x", "heading", "pitch", "contact_y", "contact_z", "wheel_angle"):
        for column, wanted in zip(found.plan[name].T.reshape(-1, found.plan.t.size),
                                  run[name].T.reshape(-1, run.t.size), strict=True):  # fmt: skip
            assert_allclose(column, np.interp(found.plan.t, run.t, wanted), atol=2e-4)
    motion, plan = drive_scene([found]).actors
    assert (plan.name, plan.ghost, motion.ghost) == ("planned: plan", True, False)
    assert plan.arrows == ()


def test_a_climb_is_drawn_with_a_width(climb_file: Path) -> None:
    found = shown(climb_file, "step")
    scene = climb_scene([found])
    (actor,), run = scene.actors, found.run
    bodies = {body.name: body for body in actor.bodies}
    assert len(bodies) == 2 + sum(axle.wheels for axle in found.climber.axles)
    assert_allclose(bodies["front 1"].origins[:, 0] + scene.origin[0], run["axle_x", "front"])
    tilt = run["tilt_rear"]
    assert_allclose(bodies["rear body"].rotations[:, 2, 1], np.sin(tilt), atol=1e-12)
    contacts = actor.contacts + scene.origin
    touching = np.isfinite(contacts).all(axis=-1)
    assert touching.any(axis=1).all()
    assert_allclose(contacts[touching][:, 2], 0, atol=1e-3)  # on the floor, sunk in a little
    forces = np.nansum(actor.arrows[1].vectors, axis=1)
    assert_allclose(forces[0, 2], 9.81 * found.climber.mass, rtol=1e-2)
    top = scene.ground.mesh.vertices[:, 2] + scene.origin[2]
    assert_allclose(top.max(), 0.09)
    assert volume(scene.ground.mesh) > 0
    other = replace(found.profile, solids=found.profile.solids[:1])
    with pytest.raises(ModelError, match="other climbs another profile than step"):
        climb_scene([found, found._replace(name="other", profile=other)])


def test_a_planned_climb_starts_when_the_motion_is_there(climb_file: Path, tmp_path: Path) -> None:
    run = result_file.read(climb_file)
    come = (run["axle_x"] + run["axle_z"]).mean(axis=1)
    arrays = {f"plan_{name}": run[name][4:] for name in ("x", "z", "tilt_rear", "tilt_front")}
    arrays |= {"plan_time": run.t[4:] - run.t[4], "plan_progress": come[4:] - 1e-9}
    out = tmp_path / "planned.nc"
    result_file.write(out, run, arrays)
    found = shown(out, "planned")
    assert found.plan is not None
    assert_allclose(found.plan.t, run.t[4:], atol=1e-12)
    for name in ("axle_x", "axle_z", "wheel_angle"):
        assert_allclose(found.plan[name], run[name][4:], atol=1e-9)
    ghost = climb_scene([found]).actors[1]
    assert ghost.ghost
    assert not np.isfinite(ghost.contacts).any()


def refused(*words: str) -> str:
    done = CliRunner().invoke(app, ["show", *words, "--no-browser"])
    assert done.exit_code == 2
    return str(done.stderr)


def test_what_cannot_be_shown_is_refused(
    file: Path, climb_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "motions over terrain or climbs alone, found both" in refused(str(file), str(climb_file))
    run = result_file.read(file)
    bare = tmp_path / "bare.nc"
    attributes = {name: words for name, words in run.attributes.items() if name != "problem"}
    result_file.write(bare, replace(run, attributes=attributes))
    assert "expected a result with its problem in it, found none" in refused(str(bare))
    text = PROBLEM.replace("[terrain]\n", '[terrain]\nfile = "hills.npz"\n')
    text = text[: text.index("[terrain.synthetic]")] + text[text.index("[vehicle]") :]
    named = tmp_path / "named.nc"
    result_file.write(named, replace(run, attributes={**run.attributes, "problem": text}))
    monkeypatch.chdir(tmp_path)
    words = refused(str(named))
    assert "its problem needs hills.npz" in words
    assert "--folder DIR" in words
    data = file.parent / "data"
    data.mkdir()
    grid = shown(file, "hills").terrain.grid
    np.savez(data / "hills.npz", x=grid.x, y=grid.y, z=grid.z)
    assert_allclose(shown(named, "named", data).terrain.grid.z, grid.z)
    old = {**run.attributes, "problem": PROBLEM.replace("speed", "pace")}
    result_file.write(bare, replace(run, attributes=old))
    assert "its problem is not one of this version:\nhills.toml:" in refused(str(bare))
    assert "expected a file of its own, found a result file" in refused(
        str(file), "--html", str(file)
    )


def test_films(file: Path, climb_file: Path, tmp_path: Path) -> None:
    for each, count in ((file, 21), (climb_file, 2)):
        out = tmp_path / f"{each.stem}.gif"
        done = CliRunner().invoke(app, ["show", str(each), "--animation", str(out)])
        assert done.exit_code == 0, done.output
        with Image.open(out) as film:
            assert film.n_frames == count
            first = np.asarray(film.convert("RGB"), dtype=int)
            film.seek(count - 1)
            last = np.asarray(film.convert("RGB"), dtype=int)
        assert (np.abs(first - last).max(axis=2) > 30).sum() > 20
    assert "expected a name that ends in .gif or .mp4" in refused(
        str(file), "--animation", str(tmp_path / "a.avi")
    )


@pytest.mark.skipif(not FFMpegWriter.isAvailable(), reason="needs the program ffmpeg")
def test_a_film_in_mp4(climb_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "step.mp4"
    done = CliRunner().invoke(app, ["show", str(climb_file), "--animation", str(out)])
    assert done.exit_code == 0, done.output
    assert out.read_bytes()[4:8] == b"ftyp"


def test_without_ffmpeg_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FFMpegWriter, "isAvailable", classmethod(lambda _: False))
    with pytest.raises(DataError, match=r"need the program ffmpeg, found none; install it"):
        film_writer(Path("film.mp4"), 20)
