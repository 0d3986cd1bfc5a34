"""Tests of ``slipfree atlas``: two files, a problem, tiles that continue, and refused input."""

import gc
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import distributed
import numpy as np
import pytest
import rasterio

from helpers.cases import ROOT
from helpers.commands import pressing, printed, refused, sets
from helpers.rasters import from_origin, geotiff
from slipfree import Bicubic, catalog, direct_kinematics, read_map
from slipfree.atlas import atlas as core
from slipfree.files.atlas_files import open_atlas
from slipfree.problem import build_ground
from slipfree.problem.verbs import atlas as verb
from slipfree.system import processes
from slipfree.terrain import bicubic

INTERPRETED = sets("atlas.compiled=false")
ATLAS = "site_three_wheeler_atlas.tif"
QUICK = *INTERPRETED, "--no-draw", "--headings", "2"


pytestmark = pytest.mark.usefixtures("site")


@pytest.fixture
def site(folder):
    """Return a hilly map of 14 x 10 nodes with a reference system, and tiles of 8 x 8 nodes."""
    rows, columns = np.mgrid[:10, :14]
    z = (0.2 * np.sin(columns / 2) * np.cos(rows / 2)).astype("f4")
    write_map(z)
    return folder


@pytest.fixture
def small_tiles(monkeypatch):
    """Return a command that computes a map in six tiles."""
    monkeypatch.setattr(core, "TILE", 32)  # half of it on small maps
    write_map((0.1 * np.sin(np.arange(40 * 20) / 3)).reshape(40, 20).astype("f4"))
    return "atlas", "site.tif", "three_wheeler", *QUICK, "--headings", "1", "-j", "1"


def write_map(z, **more):
    geotiff(Path("site.tif"), z, from_origin(5e5, 5e6, 1.0), **more)


def bands(name):
    with rasterio.open(name) as file:
        return {t.split(" [")[0]: file.read(k) for k, t in enumerate(file.descriptions, 1)}


def test_a_map_and_a_vehicle_are_enough():
    out = printed("atlas", "site.tif", "three_wheeler", "--friction", "0.5", *QUICK)
    assert all(words in out for words in ("280: 14 x 10 nodes, 2 headings", f"wrote {ATLAS}"))
    found = bands(ATLAS)
    assert {"share_standing", "share_allowed", "limit", "least_friction_worst_high"} <= {*found}
    with rasterio.open("site.tif") as first, rasterio.open(ATLAS) as second:
        assert first.transform == second.transform
        assert first.crs == second.crs
    assert not [*Path().glob("site_*_parts*")]


def test_a_problem_gives_the_same_and_figures():
    Path("p.toml").write_text(
        'verb = "atlas"\n[terrain]\nfile = "site.tif"\nfriction = 0.5\n'
        '[vehicle]\ncatalog = "three_wheeler"\n[atlas]\nheadings = 2\ncompiled = false\n'
    )
    assert "280: 14 x 10 nodes" in printed("check", "p.toml")
    out = json.loads(printed("atlas", "p.toml", "--json", "-o", "p.tif", "-o", "p.nc"))
    printed("atlas", "site.tif", "three_wheeler", "--friction", "0.5", *QUICK)
    mine, other = bands("p.tif"), bands(ATLAS)
    assert mine.keys() == other.keys()
    for name, values in mine.items():
        np.testing.assert_array_equal(values, other[name])
    pictures = [f"p_figures/{name}.png" for name in ("headings", "friction", "limit")]
    assert out["files"] == ["p.tif", "p.nc", *pictures]
    assert 0 < out["atlas"]["allowed_share"]["value"] < 1
    poses, ground = open_atlas("p.nc")
    assert poses["roll"].shape == (2, 14, 10)
    assert ground.friction == 0.5
    assert "use slipfree atlas p.toml" in refused("run", "p.toml")
    assert "a mobility map, which has no motion" in refused("export", "p.nc", "--path", "p.csv")
    printed("report", "p.nc")
    assert "least friction" in Path("p.html").read_text()
    assert "280: 14 x 10 nodes" in printed("info", "p.nc")


def test_poses_of_a_rigid_vehicle_are_those_of_the_function():
    words = "atlas", "site.tif", "rigid_skid_steer", *QUICK, "--headings", "1", "--every", "4"
    printed(*words, "--error", "0.01", "--friction", "0.4", "-o", "rigid.nc")
    found, site = open_atlas("rigid.nc")
    terrain = Bicubic(read_map("site.tif").grid, (5e5 + 7, 5e6 - 5), 0.4)
    np.testing.assert_allclose(site.elevation, terrain.grid.z[::4, ::4])
    model = direct_kinematics(catalog.rigid_skid_steer(), terrain)
    more = {"x": found.x, "y": found.y, "error": 0.01, "compiled": False}
    expected = core.atlas(model, headings=1, **more)
    assert "rests" in found.bands
    assert list(found.bands) == list(expected.bands)
    for name in expected.bands:
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-5, atol=1e-6)


def test_guaranteed_bounds_are_bands_of_the_file():
    words = "atlas", "site.tif", "three_wheeler", *QUICK, "--headings", "1", "--every", "4"
    told = printed(*words, "--guarantee", "0.01", "-o", "proved.nc", "-o", "proved.tif")
    assert "of the poses that stand, for every ground near the map" in told
    found, _ = open_atlas("proved.nc")
    assert {"roll_low", "roll_high", "pitch_low", "pitch_high", "proved"} <= {*found.bands}
    proved = found["proved"] == 1
    assert proved.any()
    assert (found["roll_low"][proved] < found["roll"][proved]).all()
    assert (found["roll"][proved] < found["roll_high"][proved]).all()
    assert np.isnan(found["roll_low"][~proved]).all()
    told = refused("atlas", "site.tif", "rigid_skid_steer", *QUICK, "--guarantee", "0.01")
    assert "guarantee: expected a vehicle whose wheels can all touch a rigid ground" in told


def test_a_killed_map_continues_and_gives_equal_files(small_tiles, monkeypatch):
    printed(*small_tiles, "-o", "whole.tif")
    pressed, computed = pressing(verb.atlas.tile_of, at=3)  # inside the third tile, which it ends
    monkeypatch.setattr(verb.atlas, "tile_of", pressed)
    told = printed(*small_tiles, "-o", "part.tif", code=130)
    assert "contains 2 of 6 tiles; repeat the command to continue" in told
    printed(*small_tiles, "-o", "part.tif")
    assert len(computed) == 3 + 4
    assert Path("whole.tif").read_bytes() == Path("part.tif").read_bytes()


def test_only_tiles_as_they_were_written_are_used(small_tiles, monkeypatch):
    """Tiles of zeros, of another shape, truncated, foreign or exchanged are computed again.

    What a killed process left of a tile is removed.
    """
    kept = pytest.MonkeyPatch()
    kept.setattr(verb.TileFolder, "remove", lambda _: None)
    printed(*small_tiles, "-o", "a.tif")
    whole = Path("a.tif").read_bytes()
    (folder,) = Path().glob("a_parts_*")
    files = sorted(folder.glob("*.npy"))
    np.save(files[0], 0 * np.load(files[0]))
    np.save(files[1], np.load(files[1])[:1])
    files[2].write_bytes(files[2].read_bytes()[:-9])
    for file in (files[3], folder / ".0123456789ab.part.npy", folder / "part_of_mine.npy"):
        file.write_bytes(b"foreign")
    first, last = files[4].read_bytes(), files[5].read_bytes()
    files[4].write_bytes(last)
    files[5].write_bytes(first)
    computed, store = [], verb.TileFolder.store
    monkeypatch.setattr(
        verb.TileFolder,
        "store",
        lambda folder, *tile: computed.append(tile[0]) or store(folder, *tile),
    )
    kept.undo()
    printed(*small_tiles, "-o", "a.tif")
    assert computed == [*range(1, 7)]
    assert Path("a.tif").read_bytes() == whole
    assert [file.name for file in folder.iterdir()] == ["part_of_mine.npy"]


def test_a_tile_that_is_no_file_is_named_and_the_log_is_closed(monkeypatch):
    words = "atlas", "site.tif", "three_wheeler", *QUICK, "-o", "a.tif"
    with monkeypatch.context() as kept:
        kept.setattr(verb.TileFolder, "remove", lambda _: None)
        printed(*words)
    (tile,) = Path().glob("a_parts_*/*.npy")
    tile.unlink()
    tile.mkdir()
    assert f"{tile}: expected the name of a file to write, found a folder" in refused(*words)
    tile.rmdir()
    tile.symlink_to("/dev/zero")
    assert f"{tile}: expected the name of a file to write, found a device" in refused(*words)
    gc.collect()  # a log that is open would be an error


def test_other_problems_have_other_tiles_and_one_has_one_command(monkeypatch):
    monkeypatch.setattr(verb.TileFolder, "remove", lambda _: None)
    told, store = [], verb.TileFolder.store

    def stored(*tile):
        told.append(refused("atlas", "site.tif", "three_wheeler", *words, "-o", "a.tif"))
        store(*tile)

    monkeypatch.setattr(verb.TileFolder, "store", stored)
    for words in (QUICK, (*QUICK, "--headings", "1")):
        printed("atlas", "site.tif", "three_wheeler", *words, "-o", "a.tif")
    assert len([*Path().glob("a_parts_*")]) == 2
    assert ["found one in use" in each for each in told] == [True, True]


def test_a_map_that_changes_during_the_computation_ends_it(small_tiles, monkeypatch):
    z = np.zeros((40, 20), "f4")
    write_map(z)
    store = verb.TileFolder.store
    monkeypatch.setattr(verb.TileFolder, "store", lambda *words: store(*words) or write_map(z + 1))
    words = refused(*small_tiles)
    assert "expected the input files with which the computation started, found others" in words
    assert not Path(ATLAS).exists()


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of the size of files")
def test_a_full_disk_keeps_the_earlier_file_and_the_tiles():
    """The tiles fit, the GeoTIFF does not."""
    Path("a.tif").write_bytes(b"earlier")
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (9000, 9000)); "
        "from slipfree.__main__ import main; main()"
    )
    words = "atlas", "site.tif", "three_wheeler", *QUICK, "--headings", "1", "-o", "a.tif"
    done = subprocess.run(
        [sys.executable, "-B", "-c", code, *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, done.stderr
    assert "a.tif: cannot be written" in done.stderr
    assert Path("a.tif").read_bytes() == b"earlier"
    (folder,) = Path().glob("a_parts_*")
    assert [*folder.glob("*.npy")]


def test_windows_of_a_large_map_give_the_same(monkeypatch):
    """Heights, holes, friction and scale are those of the map that is read as a whole."""
    rows, columns = np.mgrid[:24, :400]
    z = (0.3 * np.sin(columns / 3) * np.cos(rows / 4)).astype("f4")
    z[11:14, 118:123] = -9999
    write_map(z, nodata=-9999)
    mu = (0.5 + 0.2 * np.cos(columns / 5)).astype("f4")
    geotiff(Path("mu.tif"), mu[:, 30:], from_origin(5e5 + 30, 5e6, 1.0))
    words = "atlas", "site.tif", "three_wheeler", *QUICK, "--every", "11", "--headings", "1"
    words = *words, "--friction", "mu.tif"
    words = *words, *sets("terrain.scale=0.7", "terrain.window=[3.5e5, 3.51e5, 3e6, 4e6]")
    printed(*words, "-o", "whole.nc")
    monkeypatch.setattr(build_ground, "LARGE", 100)
    monkeypatch.setattr(bicubic, "SPAN", 44)
    assert "15 of 9600 nodes have no height" in printed(*words, "-o", "parts.nc", "-v")
    (whole, ground), (parts, other) = map(open_atlas, ("whole.nc", "parts.nc"))
    assert whole.reasons == parts.reasons
    assert np.unique(whole["reason"]).size > 2
    for name in whole.bands:
        np.testing.assert_allclose(parts[name], whole[name], rtol=1e-6, atol=1e-12, err_msg=name)
    known = ~np.isnan(other.elevation)
    np.testing.assert_allclose(other.elevation[known], ground.elevation[known], rtol=1e-12)
    write_map(z)  # the missing heights are not declared
    assert "probably missing heights" in refused(*words, "-o", "parts.nc")


def strip(length, nodes):
    """Return the words of a command for a map that is narrower than a tile."""
    x = np.linspace(0.0, length, nodes)
    np.savez("map.npz", x=x, y=x[:5], z=0.1 * np.sin(x)[:, None] * np.cos(x[:5]))
    return "atlas", "map.npz", "three_wheeler", *QUICK, "--headings", "1"


def test_two_processes_give_the_same_file_as_one():
    for count in ("1", "2"):
        printed(*strip(32.0, 66), "-j", count, "-o", f"{count}.tif")
    assert Path("1.tif").read_bytes() == Path("2.tif").read_bytes()


@pytest.mark.slow  # starts workers
def test_workers_of_dask_give_the_same_file_if_one_is_killed(monkeypatch):
    words = strip(120.0, 300)  # five tiles
    printed(*words, "-o", "here.tif")
    more = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "threads_per_worker": 1}
    with distributed.LocalCluster(n_workers=2, **more) as local:
        first, store, killed = local.workers[0].pid, verb.TileFolder.store, []

        def kills(folder, *tile):
            store(folder, *tile)
            if not killed and len(folder.missing) < 4:  # a worker has finished a tile
                killed.append(first)
                os.kill(first, signal.SIGKILL)

        monkeypatch.setattr(verb.TileFolder, "store", kills)
        printed(*words, "-o", "there.tif", "--scheduler", local.scheduler_address)
    assert killed
    assert Path("here.tif").read_bytes() == Path("there.tif").read_bytes()


def test_a_vehicle_without_mass_has_no_bands_of_friction():
    Path("light.toml").write_text(LIGHT)
    out = printed("atlas", "site.tif", "light.toml", "--friction", "0.5", *QUICK)
    assert "the vehicle has no mass" in out
    found = bands("site_light_atlas.tif")
    assert "share_standing" in found
    assert not any("friction" in name for name in found)


def test_without_friction_the_coefficient_is_mapped():
    out = printed("atlas", "site.tif", "three_wheeler", *QUICK)
    assert "the ground has no coefficient of friction" in out
    found = bands(ATLAS)
    assert "share_allowed" not in found
    assert np.nanmax(found["least_friction_worst_high"]) > 0


def test_bounds_of_quantities_exclude_headings():
    printed("atlas", "site.tif", "three_wheeler", *QUICK, "--within", "roll=-0.05..0.05")
    found = bands(ATLAS)
    assert (found["share_allowed"] <= found["share_standing"]).all()
    alone = found["roll_largest"] <= 0.05
    np.testing.assert_array_equal(found["share_allowed"][alone], found["share_standing"][alone])
    assert (found["share_allowed"] < found["share_standing"]).any()


def test_a_map_smaller_than_the_vehicle_says_so():
    write_map(np.zeros((4, 4), "f4"))
    out = printed("atlas", "site.tif", "three_wheeler", *QUICK, *sets("terrain.scale=0.2"))
    assert "wheels leave the map" in out
    assert "no pose is allowed" in out


def test_holes_exclude_headings_by_name():
    z = np.zeros((14, 14), "f4")
    z[7, 7] = -9999
    write_map(z, nodata=-9999)
    out = printed("atlas", "site.tif", "three_wheeler", *QUICK)
    assert "hole" in out
    found = bands(ATLAS)
    assert found["share_standing"][7, 7] == 0
    assert found["share_standing"][2, 2] == 1


@pytest.mark.parametrize(
    ("z", "more", "expected"),
    [
        (np.full((9, 9), np.nan, "f4"), {}, "height"),
        (np.full((9, 9), -9999, "f4"), {"nodata": -9999}, "height"),
        (np.zeros((1, 30), "f4"), {}, "at least 4 nodes"),
        (np.zeros((1, 1), "f4"), {}, "at least"),
        (np.where(np.eye(9), 2e9, 0).astype("f4"), {}, "MAP"),
    ],
    ids=["nan", "holes", "row", "cell", "spikes"],
)
@pytest.mark.parametrize("most", [build_ground.LARGE, 0], ids=["whole", "windows"])
def test_hostile_maps_are_refused(z, more, expected, most, monkeypatch):
    monkeypatch.setattr(build_ground, "LARGE", most)
    write_map(z, **more)
    words = refused("atlas", "site.tif", "three_wheeler", *QUICK)
    assert words.startswith("MAP: site.tif:")
    assert expected in words


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("three_whealer",), "VEHICLE: expected a vehicle file, or one of"),
        (("none.toml",), "none.toml: expected a vehicle file"),
        ((), "found no vehicle"),
        (("three_wheeler", "--headings", "361"), "--headings: expected a number of at most 360"),
        (("three_wheeler", "--every", "10"), "--every: expected at most 9"),
        (("three_wheeler", "--within", "rol=-1..1"), "--within rol: did you mean 'roll'?"),
        (("three_wheeler", "--within", "roll"), "expected NAME=LOW..HIGH"),
        (("three_wheeler", "--within", "roll=2..1"), "in ascending order"),
        (("three_wheeler", "--friction", "0"), "--friction: expected a number greater than 0"),
        (("three_wheeler", "--scheduler", "x", "-j", "2"), "found both"),
        pytest.param(
            ("three_wheeler", *INTERPRETED, "--scheduler", "tcp://127.0.0.1:1"),
            "a running Dask scheduler",
            marks=pytest.mark.slow,
        ),
        (("three_wheeler", "-o", "out.png"), "found '.png'; use out.tif"),
        (("three_wheeler", "-o", "site.tif"), "found the input"),
        (("three_wheeler", "-o", "."), ".: expected the name of a file to write, found a folder"),
        (("three_wheeler", *sets("model=dynamics")), "'kinematics' or 'quasi-static'"),
    ],
)
def test_wrong_arguments_are_named(words, expected, monkeypatch):
    monkeypatch.setattr(processes, "CONNECT", 0.3)
    assert expected in refused("atlas", "site.tif", *words)


def test_the_example_of_the_page_runs(capsys):
    page = (ROOT / "docs" / "howto" / "atlas.md").read_text()
    code = re.findall(r"```python\n(.*?)```", page, re.DOTALL)[-1]
    exec(compile(code, "atlas.md", "exec"), {})
    assert re.match(r"held at \d\d% of the poses, slides at \d+%", capsys.readouterr().out)


LIGHT = """\
name = "light"
frame = "rep103"
wheels = [{ name = "left", parent = "platform", at = [0, 0.3, 0], radius = 0.1, driven = true },
    { name = "right", parent = "platform", at = [0, -0.3, 0], radius = 0.1, driven = true },
    { name = "front", parent = "platform", at = [0.5, 0, 0], radius = 0.1 }]
"""
