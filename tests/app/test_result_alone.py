"""A result that is moved alone to an empty folder is shown, reported, exported and tracked."""

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyproj
import pytest
from numpy.testing import assert_allclose

import slipfree as sf
from helpers.cases import PROBLEMS
from helpers.commands import invoke, printed, refused, refuses
from helpers.rasters import from_origin, geotiff
from slipfree.core.records import Array
from slipfree.files import netcdf
from slipfree.problem.build_ground import build_ground
from slipfree.problem.result import STORED, build, problem_of
from slipfree.problem.verbs.base import world_of
from slipfree.show.meshes import reduced
from slipfree.vehicle.sections import sheet

DRIVE = """
start = { heading = 0.2 }
driver = { name = "straight", speed = 0.3 }
time = { duration = 0.4, step = 0.1 }
vehicle.file = "parts/trike.toml"
"""
FLAT = "terrain.synthetic = { x = [-3, 3], y = [-3, 3], spacing = 0.25, base = 1.5 }"
HILLS = f"""{DRIVE}
verb = "direct"
[terrain]
file = "hills.npz"
friction = "ice.asc"
error = {{ rms = 0.01, correlation = 0.5, seed = 3 }}
"""
GEOGRAPHIC = """
verb = "direct"
terrain.file = "map.tif"
vehicle.catalog = "three_wheeler"
start = { PLACE }
driver = { name = "straight", speed = 0.3 }
time = { duration = 0.4, step = 0.1 }
"""
INVERSE = f"""{DRIVE.replace('driver = { name = "straight", speed = 0.3 }', "")}
verb = "inverse"
given = {{ forward = 0.2, yaw_rate = 0.0 }}
exact = false
{FLAT}
"""
place = pyproj.Transformer.from_crs(32633, 4326, always_xy=True).transform(440735.0, 5100308.0)
GEOGRAPHIC = GEOGRAPHIC.replace("PLACE", "longitude = {}, latitude = {}".format(*place))
SHIPPED = {"step": "climb_step", "plan": "plan_rigid_hills"}
CASES = {"hills": HILLS, "geographic": GEOGRAPHIC, "inverse": INVERSE} | {
    name: (PROBLEMS / f"{file}.toml").read_text() for name, file in SHIPPED.items()
}
SMALL = {
    "step": ("time.duration=0.1",),
    "plan": ("plan.intervals=4", "time.duration=10", "goal.x=0.1", "goal.y=1.3", "costs.slip="),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with problems, and with the files that they name."""
    place = tmp_path_factory.mktemp("made")
    (place / "parts").mkdir()
    shutil.copy(PROBLEMS / "vehicles" / "trike.toml", place / "parts")
    shutil.copy(PROBLEMS / "ice.asc", place)
    x = np.linspace(-4, 4, 33)
    np.savez(place / "hills.npz", x=x, y=x, z=0.1 * np.sin(x)[:, None] * np.cos(x))
    rows = 0.1 * np.sin(0.3 * np.arange(60.0)) * np.cos(0.3 * np.arange(50.0))[:, None]
    geotiff(place / "map.tif", rows, from_origin(440720.0, 5100320.0, 0.5), crs="EPSG:32633")
    for name, text in CASES.items():
        (place / f"{name}.toml").write_text(text)
    return place


def solved(folder: Path, name: str, out: Path, *settings: str) -> Path:
    """Return the result of a problem, moved to an empty folder."""
    result = sf.run_problem(sf.load_problem(folder / f"{name}.toml", settings))
    netcdf.write(out / f"{name}.nc", result.trajectory, result.arrays)
    return out / f"{name}.nc"


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "plan")) for name in CASES]
)
def test_a_result_alone_has_ground_vehicle_and_model(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    file = solved(folder, name, tmp_path, *SMALL.get(name, ()))
    first = build(sf.load_problem(folder / f"{name}.toml", SMALL.get(name, ())))
    monkeypatch.chdir(tmp_path)
    result = sf.open_result(file)
    again = build(result.problem)
    assert_allclose(again.ground.grid.z, first.ground.grid.z, rtol=0, atol=0)
    assert again.vehicle == world_of(result).vehicle == first.vehicle
    for key in first.start.columns:
        assert_allclose(again.start[key], first.start[key], rtol=0, atol=1e-12)
    assert again.ground.coordinates == first.ground.coordinates
    assert again.ground.crs == first.ground.crs
    invoke("info", file, code=0)
    for words in (
        *(["report"], ["show", "--html", "a.html"], ["show", "--picture", "a.png"]),
        *(["export", "--path", f"a.{end}"] for end in ("csv", "geojson")),
        *([] if name == "step" else [["export", "--rates", "b.csv"]]),
        ["export", "--mcap", "a.mcap"],
        *([["track", "--by", "follow", "--set", "terrain.friction=0.5"]] * (name == "plan")),
    ):
        assert "figures: " not in printed(words[0], file, *words[1:])


def test_a_file_of_the_problem_is_neither_read_nor_replaced(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    (tmp_path / "parts").mkdir()
    for name in ("hills.npz", "parts/trike.toml"):
        (tmp_path / name).write_text("not what it was")
    file = solved(folder, "hills", tmp_path)
    assert '"hills.npz": "' in printed("info", file)
    words = refused("export", file, "--path", folder / "hills.npz")
    assert "expected a separate file, found the input" in words
    invoke("report", file, code=0)


def test_changes_apply_to_the_ground_of_a_result(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As for ``track --set``: files are read only where the heights change."""
    monkeypatch.chdir(tmp_path)
    file = solved(folder, "hills", tmp_path)
    run, arrays = netcdf.read(file), netcdf.read_arrays(file)

    def changed(*changes: str) -> Any:
        return build_ground(problem_of(file, run, arrays, changes))

    stored = changed()
    assert changed("terrain.friction=0.3")[2:4] == (None, 0.3)
    assert_allclose(changed("terrain.friction=0.3").grid.z, stored.grid.z, rtol=0)
    refuses(sf.DataError, r"hills.npz: expected", changed, "terrain.error.rms=0.02")
    other = f'terrain.file="{folder / "hills.npz"}"'
    assert np.ptp(changed(other, "terrain.error=", "terrain.friction=").grid.z) > 0.1


@pytest.mark.parametrize(
    ("old", "new", "arrays", "words"),
    [
        ("radius = 0.25", "radius = -1", {}, r"found others \(.*radius"),
        ("wheels", "wheel", {}, r"found others \(.*wheel"),
        ('"vehicle"', '"vehicles"', {}, r"found others \(.* validation error"),
        ("hills.npz", "other.npz", {}, "with the ground and vehicle of its problem, found others"),
        ("parts/trike.toml", "a.toml", {}, "ground and vehicle of its problem, found others"),
        ('name = \\"left\\"', 'name = \\"other\\"', {}, "wheels rear, left, right, found"),
        ("", "", {"ground_z": np.zeros((3, 3))}, r"found others \(grid: "),
        ("", "", {"friction_z": np.full((3, 3), np.nan)}, r"found others \(grid: "),
    ],
)
def test_a_damaged_world_is_refused(
    folder: Path, tmp_path: Path, old: str, new: str, arrays: dict[str, Array], words: str
) -> None:
    file = solved(folder, "hills", tmp_path)
    run = netcdf.read(file)
    assert old in run.attributes[STORED]
    run.attributes[STORED] = run.attributes[STORED].replace(old, new)
    netcdf.write(file, run, netcdf.read_arrays(file) | arrays)
    for command in (["show", "--html"], ["export", "--mcap"]):
        out = tmp_path / f"a.{command[1][2:]}"
        assert re.search(words, refused(command[0], file, command[1], out))


def test_a_large_map_is_cut_to_the_motion(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slipfree.problem.result.MAX_NODES", 4000)
    settings = ("terrain.synthetic.x=[-50,50]", "terrain.synthetic.y=[-40,60]", "start.x=7.0")
    settings += ("terrain.synthetic.power_law={rms=0.05,hurst=0.9,longest=4,shortest=2,seed=1}",)
    file = solved(folder, "inverse", tmp_path, *settings)
    whole = sf.load_problem(folder / "inverse.toml", settings)
    result = sf.open_result(file)
    part, run = build_ground(result.problem).grid, result.trajectory
    assert part.z.size < 0.2 * build_ground(whole).grid.z.size
    surfaces = [sf.Bicubic(grid) for grid in (part, build_ground(whole).grid)]
    heights = [each.elevation(run["contact_x"], run["contact_y"]) for each in surfaces]
    assert_allclose(heights[0], heights[1], rtol=0, atol=1e-14)
    invoke("report", file, code=0)


def test_meshes_are_simplified() -> None:
    u, v = np.meshgrid(np.linspace(0, np.pi, 201), np.linspace(0, 2 * np.pi, 201))
    ball = sheet(np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], axis=-1))
    found = reduced({"ball": ball, "small": ball._replace(vertices=1e-9 * ball.vertices)}, 20_000)
    assert [*found] == ["ball"]
    assert 5_000 < len(found["ball"].faces) <= 20_000
    assert_allclose(np.linalg.norm(found["ball"].vertices, axis=1), 1)
    assert reduced({}, 1) == {}
