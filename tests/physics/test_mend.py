"""Tests of map operations against closed forms: holes, smoothing, scale, errors."""

import re
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from helpers.cases import ROOT, function_of
from helpers.commands import invoke
from helpers.problem_files import FILE, _read
from slipfree import Grid
from slipfree.core.errors import DataError, ModelError
from slipfree.core.lookups import LookupTable
from slipfree.files import netcdf
from slipfree.files.maps.elevation import geographic_to_metric, read_map
from slipfree.files.toml import ProblemError
from slipfree.problem.build_ground import build_ground, ground_facts
from slipfree.problem.result import motion_facts, run_problem
from slipfree.problem.schema import TerrainTable
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.grid_ops import (
    Heights,
    continue_over_holes,
    cut,
    disturbed,
    fill_holes,
    hole_distance,
    smoothed,
)


def plane(n_x=30, n_y=25, steps=(0.5, 0.25)):
    x, y = steps[0] * np.arange(n_x), 7 + steps[1] * np.arange(n_y)
    return Grid(x, y, 2 + 0.3 * x[:, None] - 0.2 * y)


def holed(grid, *holes):
    z = grid.z.copy()
    for i, j in holes:
        z[i, j] = np.nan
    return Heights(grid.x, grid.y, z)


def test_holes_in_a_plane_are_filled_exactly_and_counted():
    grid = plane()
    found = fill_holes(
        holed(grid, (slice(3, 9), slice(4, 8)), (12, 5), (13, 6), (slice(20, 22), slice(10, 20)))
    )
    assert_allclose(found.z, grid.z, atol=1e-13)
    assert (found.nodes, found.holes) == (24 + 2 + 20, 3)  # touching by a corner is one hole
    assert found.largest == pytest.approx((6 * 0.5, 4 * 0.25))
    whole = fill_holes(holed(grid))
    assert (whole.nodes, whole.holes) == (0, 0)
    assert_array_equal(whole.z, grid.z)


def test_holes_are_filled_from_their_own_rims():
    """Two neighbouring holes on terraces of different height, and many at random."""
    z = np.where(np.arange(30)[:, None] < 15, 1.0, 5.0) + np.zeros((30, 20))
    grid = Grid(np.arange(30.0), np.arange(20.0), z)
    found = fill_holes(holed(grid, (slice(5, 14), slice(5, 15)), (slice(16, 25), slice(5, 15))))
    assert_allclose(found.z, z, rtol=1e-14)
    z = z + np.random.default_rng(0).normal(size=z.shape)
    hole = np.random.default_rng(1).random(z.shape) < 0.3
    hole[[0, -1]] = hole[:, [0, -1]] = False
    found = fill_holes(Heights(grid.x, grid.y, np.where(hole, np.nan, z)))
    assert_array_equal(found.z[~hole], z[~hole])
    assert z[~hole].min() <= found.z.min() <= found.z.max() <= z[~hole].max()


def test_holes_at_the_border_are_not_filled():
    found = fill_holes(holed(plane(), (slice(0, 3), slice(5, 9)), (10, 10)))
    assert (found.nodes, found.holes, np.isnan(found.z).sum()) == (1, 1, 12)
    assert np.isnan(found.z[:3, 5:9]).all()
    whole = fill_holes(holed(plane(), (slice(None), slice(None))))
    assert (whole.nodes, np.isnan(whole.z).all()) == (0, True)


def test_a_plane_is_continued_over_holes():
    grid = plane()
    found = holed(grid, (slice(0, 3), slice(None)), (slice(14, 18), slice(8, 12)), (25, 24))
    assert_allclose(continue_over_holes(found.z), grid.z, atol=1e-13)


def test_a_spline_beside_a_hole_is_nearly_that_of_the_whole_map():
    """It differs by less than a tenth of a second difference of the heights."""
    x = 0.25 * np.arange(60)
    whole = np.sin(x)[:, None] * np.cos(0.8 * x)
    z = whole.copy()
    z[20:30, 20:40] = np.nan
    holes = np.isnan(z)
    found, at = Bicubic(Grid(x, x, continue_over_holes(z), holes=holes)), np.linspace(0, 14, 500)
    off = found.elevation(at[:, None], at) - Bicubic(Grid(x, x, whole)).elevation(at[:, None], at)
    off[found.grid.touches(holes, at[:, None], at)] = 0
    assert np.abs(off).max() < 0.25**2 / 10


def test_the_margin_is_negative_in_every_cell_with_a_missing_height():
    rng, at = np.random.default_rng(6), (ca.SX.sym("x"), ca.SX.sym("y"))
    for share, steps in ((0.01, (1.0, 1.0)), (0.05, (0.5, 2.0)), (0.3, (1.0, 1.0))):
        grid = plane(24, 20, steps)
        grid = Grid(grid.x, grid.y, grid.z, holes=rng.random(grid.z.shape) < share)
        x, y = (rng.uniform(axis[0], axis[-1], 20_000) for axis in (grid.x, grid.y))
        ground = Bicubic(grid)
        margin = function_of(at, lambda lookups, ground=ground: [ground.hole_margin(*at, lookups)])
        found = np.array(margin((x - ground.origin[0])[None], (y - ground.origin[1])[None]))[0]
        assert found[grid.touches(grid.holes, x, y)].max() < 0
    assert Bicubic(plane()).hole_margin(*at, LookupTable()) is None


def test_the_distance_from_a_hole_is_that_of_its_cells():
    grid = plane(9, 8, (1.0, 1.0))
    holes = np.zeros(grid.z.shape, bool)
    holes[4, 3] = True
    found = hole_distance(Grid(grid.x, grid.y, grid.z, holes=holes))
    assert found[4, 3] == -1
    assert_array_equal(found[3:6, 2], 0)
    assert found[0, 0] == np.hypot(3, 2)
    assert found[7, 3] == 2
    with pytest.raises(DataError, match="heights at its four corners, found none"):
        hole_distance(Grid(grid.x, grid.y, grid.z, holes=~holes))


def test_a_motion_ends_at_a_hole(tmp_path: Path) -> None:
    x, y = 0.25 * np.arange(-20, 21), 0.25 * np.arange(-20, 41)
    z = np.zeros((x.size, y.size))
    z[:, 30:] = np.nan  # from y = 2.5: cells without a height begin at 2.25
    np.savez(tmp_path / "g.npz", x=x, y=y, z=z)
    run = run_problem(_read(tmp_path, FILE, "time.duration=60")).trajectory
    assert run.stop is not None
    assert run.stop.name == "hole_margin[front]"
    assert "reaches a hole in the map" in run.stop.words
    assert run["contact_y", "front"][-1] == pytest.approx(2.25 - 0.25 / 3, abs=1e-6)
    _, facts = _grounds(tmp_path, z=z, x=x, y=y)
    assert facts["ground holes"].startswith("1271 of 2501 nodes have no height")
    assert facts["ground height"] == "0.000 to 0.000 m"


def test_smoothing_lowers_waves_by_the_gaussian_transfer_and_keeps_slopes():
    x, y, length, deviation = 0.125 * np.arange(321), 0.25 * np.arange(161), 10.0, 1.5
    wave = np.cos(2 * np.pi * x / length)[:, None] + np.zeros(y.size)
    found = smoothed(Grid(x, y, wave), deviation)
    kept = np.exp(-2 * (np.pi * deviation / length) ** 2)
    inner = slice(100, -100)  # away from where the ground is continued
    assert_allclose(found.grid.z[inner], kept * wave[inner], atol=2e-4)  # cut at four deviations
    change = found.grid.z - wave
    assert found.rms == pytest.approx(np.sqrt(np.mean(change**2)))
    assert found.largest == np.abs(change).max()
    assert_allclose(smoothed(plane(), 0.7).grid.z, plane().z, atol=1e-12)
    with pytest.raises(ModelError, match=r"at most 0.75 m, an eighth of the ground, found 1 m"):
        smoothed(plane(), 1.0)


def test_maps_are_scaled_and_cut_with_their_border():
    grid = plane()
    found = grid.scaled(2.0, 0.5)
    for name, factor in (("x", 2), ("y", 2), ("z", 0.5)):
        assert_array_equal(getattr(found, name), factor * getattr(grid, name))
    part = cut(grid, (0.5, 3.0, 8.0, 9.1))
    assert part.domain == (0.5, 3.0, 8.0, 9.0)
    assert_array_equal(part.z, grid.z[1:7, 4:9])


def test_elevation_errors_have_the_asked_rms_and_correlation():
    grid = Grid(np.arange(0.0, 60), np.arange(0.0, 50), np.zeros((60, 50)))
    fields = np.array([disturbed(grid, 0.1, 5.0, seed).z for seed in range(60)])
    # 60 maps of about 100 independent patches: the variance is known to 2 %, three times that here.
    assert np.mean(fields**2) == pytest.approx(0.01, rel=0.06)
    for lag in (3, 5, 8):
        expected = 0.01 * np.exp(-((lag / 5) ** 2))
        for pair in ((fields[:, lag:], fields[:, :-lag]), (fields[..., lag:], fields[..., :-lag])):
            assert np.mean(pair[0] * pair[1]) == pytest.approx(expected, abs=6e-4)
    assert np.mean(fields[:, 8:, 8:] * fields[:, :-8, :-8]) == pytest.approx(
        0.01 * np.exp(-2 * (8 / 5) ** 2), abs=6e-4
    )


def test_elevation_errors_depend_on_place_and_seed_alone():
    grid = plane()
    whole = disturbed(grid, 0.1, 2.0, 3)
    assert_array_equal(whole.z, disturbed(grid, 0.1, 2.0, 3).z)
    assert np.abs(whole.z - disturbed(grid, 0.1, 2.0, 4).z).max() > 0.05
    window = (2.0, 6.0, 8.0, 10.0)
    assert_allclose(disturbed(cut(grid, window), 0.1, 2.0, 3).z, cut(whole, window).z, atol=1e-14)
    with pytest.raises(ModelError, match=r"disturbed: rms: expected a number > 0, found 0\.0"):
        disturbed(grid, 0.0, 2.0, 3)


# ------------------------------------------------------------------------------------ problem files


def _grounds(folder: Path, *settings: str, **arrays: object) -> tuple[Grid, dict[str, str]]:
    grid = plane(40, 40, (0.25, 0.25))
    np.savez(folder / "g.npz", **{"x": grid.x - 4, "y": grid.y - 12, "z": grid.z} | arrays)
    found = build_ground(_read(folder, FILE, *settings))
    return found.grid, dict(ground_facts(found))


def test_scales_of_a_problem(tmp_path: Path) -> None:
    plain, _ = _grounds(tmp_path)
    grid, facts = _grounds(
        tmp_path, "terrain.scale=2", "terrain.horizontal_scale=3", "terrain.vertical_scale=0.5"
    )
    assert_array_equal(grid.x, 6 * plain.x)
    assert_array_equal(grid.z, plain.z)
    assert facts["ground"] == "g.npz scaled by 6 in x and y, by 1 in height"
    assert facts["file coordinates"] == (
        "x_file = 0.166666667 x, y_file = 0.166666667 y, z_file = z; x, y, z are those of "
        "results, in metres"
    )
    part, _ = _grounds(tmp_path, "terrain.scale=2", "terrain.window=[-4, 2, -6, 1]")
    assert part.domain == (-4, 2, -6, 1)


CHANGES = [
    "terrain.fill=linear",
    "terrain.smooth=0.5",
    "terrain.error={rms = 0.1, correlation = 1, seed = 5}",
]


def test_everything_that_is_changed_is_told(tmp_path: Path) -> None:
    z = plane(40, 40, (0.25, 0.25)).z.copy()
    plain, told = _grounds(tmp_path, z=z)
    assert not {"ground holes filled", "file coordinates", "map crs"} & set(told)
    z[10:12, 20] = np.nan
    grid, facts = _grounds(tmp_path, *CHANGES, z=z)
    assert facts["ground map"] == "numpy archive, CRS not given, heights at nodes"
    assert facts["ground holes filled"] == "2 nodes in 1 holes, the largest 0.5 x 0.25 m, linearly"
    assert facts["ground changed by smooth"].endswith("(Gaussian of 0.5 m)")
    assert "rms 0.1 m (on this ground 0.0985 m)" in facts["ground error added"]
    assert "correlated over 1 m, seed 5" in facts["ground error added"]
    assert np.abs(grid.z - plain.z).max() > 0.1


def test_filled_nodes_are_remembered_whatever_is_changed(tmp_path: Path) -> None:
    z = plane(40, 40, (0.25, 0.25)).z.copy()
    whole, _ = _grounds(tmp_path, "terrain.fill=linear", z=z)
    assert whole.filled is None
    z[10:12, 20] = np.nan
    grid, _ = _grounds(tmp_path, *CHANGES, "terrain.scale=2", z=z)
    assert grid.filled is not None
    assert_array_equal(np.argwhere(grid.filled), [[10, 20], [11, 20]])
    assert grid.spacing == pytest.approx((0.5, 0.5))
    x, y = grid.x[0] + 0.5 * np.array([8.7, 9.1, 11.9, 12.3]), grid.y[0] + 0.5 * 19.1
    assert_array_equal(grid.touches(grid.filled, x, y), [False, True, True, False])
    assert_array_equal(grid.touches(grid.filled, x, y - 0.1), [False] * 4)
    assert not whole.touches(whole.filled, x, y).any()
    fine, _ = _grounds(tmp_path, *CHANGES, "terrain.scale=2", "terrain.rolled=0.4", z=z)
    assert_array_equal(fine.touches(fine.filled, x, y), [False, True, True, False])
    part = cut(grid, (grid.x[2], grid.x[-1], grid.y[3], grid.y[-1]))
    assert part.filled is not None
    assert_array_equal(part.filled, grid.filled[2:, 3:])
    with pytest.raises(DataError, match="filled must have the shape of z"):
        Grid(grid.x, grid.y, grid.z, grid.filled.T[1:])


@pytest.mark.slow
def test_a_summary_states_how_far_filled_ground_is_driven_on(tmp_path: Path) -> None:
    """On a plane the left wheel crosses 1.25 m of cells that touch a hole; the others do not."""
    x, y = 0.25 * np.arange(-20, 21), 0.25 * np.arange(-20, 41)
    z = np.zeros((x.size, y.size))
    z[14:18, 22:26] = np.nan  # x from -1.5 to -0.75, y from 0.5 to 1.25
    np.savez(tmp_path / "g.npz", x=x, y=y, z=z)
    settings = ["terrain.fill=linear", "start={x = 0, y = 0, heading = 0}", "time.duration=20"]
    motion = run_problem(_read(tmp_path, FILE, *settings)).trajectory
    words = dict(motion_facts(motion))["filled ground"]
    found = re.fullmatch(
        r"(\d+) of 81 samples have a wheel on interpolated heights; along the contact points: "
        r"right 0 of 3 m, left ([\d.]+) of 3 m, front 0 of 3 m",
        words,
    )
    assert found, words
    step = 3.0 / 80
    assert float(found[2]) == pytest.approx(1.25, abs=step)
    assert int(found[1]) * step == pytest.approx(1.25, abs=2 * step)
    netcdf.write(tmp_path / "run.nc", motion)
    told = invoke("info", tmp_path / "run.nc").stdout
    assert told.count("interpolated heights") == 1
    away = run_problem(_read(tmp_path, FILE, *settings, "start.x=2")).trajectory
    assert away.facts["filled_samples"].value == 0


def test_friction_lies_where_the_ground_does(tmp_path: Path) -> None:
    """A picture of friction beside a ground in degrees, and one in degrees itself."""
    step = 2e-5
    x, y = 15 + step * np.arange(9), 47 + step * np.arange(9)
    np.savez(tmp_path / "mu.npz", x=x[2:], y=y[3:], z=np.full((7, 6), 0.5))
    _, facts = _grounds(
        tmp_path, "terrain.geographic=local", "terrain.friction=mu.npz", x=x, y=y, z=np.ones((9, 9))
    )
    assert facts["ground friction"].startswith("mu.npz, 0.5 to 0.5; degrees converted to metres")
    ground = build_ground(
        _read(tmp_path, FILE, "terrain.geographic=local", "terrain.friction=mu.npz")
    )
    metres = geographic_to_metric(x, y, np.ones((9, 9)))
    assert isinstance(ground.mu, Grid)
    assert_allclose(ground.mu.x, metres.x[2:], atol=1e-8)
    assert_allclose(ground.mu.y, metres.y[3:], atol=1e-8)
    Image.fromarray(np.full((8, 8), 200, np.uint8)).save(tmp_path / "mu.png")
    settings = ["terrain.cell=2", "terrain.registration=point", "terrain.friction=mu.png"]
    settings += ["terrain.file=", "terrain.sample=jacksboro"]
    mu = build_ground(_read(tmp_path, FILE, *settings)).mu
    assert isinstance(mu, Grid)
    assert mu.domain == (0, 14, 0, 14)


def test_every_key_is_documented() -> None:
    text = (ROOT / "docs" / "elevation.md").read_text()
    for key in TerrainTable.model_fields:
        assert f"`{key}`" in text or key in ("sample", "synthetic"), key


def test_a_window_in_degrees_has_its_own_origin(tmp_path: Path) -> None:
    x = 15 + 1e-5 * np.arange(60)
    places = np.meshgrid(np.linspace(1, 9, 60), np.linspace(8, 12, 60), indexing="ij")
    np.savez(tmp_path / "d.npz", x=x, y=x + 30, z=Bicubic(plane()).elevation(*places))
    found = read_map(tmp_path / "d.npz", geographic="local", window=(15.0002, 15.0004, 45, 45.0003))
    assert (found.grid.x[0], found.grid.y[0]) == (0, 0)
    assert (found.frame.x0, found.frame.y0) == pytest.approx((15.0002, 45), abs=1e-12)
    assert_allclose(found.frame.x0 + found.frame.kx * found.grid.x, x[20:41], atol=1e-12)


def test_a_picture_needs_the_metres_of_a_gray_level(tmp_path: Path) -> None:
    Image.fromarray(np.full((40, 40), 7, np.uint8)).save(tmp_path / "g.png")
    settings = ["terrain.file=g.png", "terrain.cell=0.5", "terrain.registration=area"]
    with pytest.raises(ProblemError, match="vertical_scale, the metres per gray level"):
        _grounds(tmp_path, *settings)
    grid, _ = _grounds(tmp_path, *settings, "terrain.vertical_scale=0.01")
    assert_allclose(grid.z, 0.07)


def test_heights_that_are_no_metres_on_earth_need_a_scale(tmp_path: Path) -> None:
    z = 29000 + plane(40, 40, (0.25, 0.25)).z
    with pytest.raises(ProblemError, match=r"heights from -12000 to 9000 m, .*found 28998.*0\.01"):
        _grounds(tmp_path, z=z)
    for setting, factor in (
        ("vertical_scale=0.01", 0.01),
        ("vertical_scale=1", 1),
        ("scale=0.3", 0.3),
    ):
        grid, _ = _grounds(tmp_path, f"terrain.{setting}", z=z)
        assert_allclose(grid.z, factor * z)
