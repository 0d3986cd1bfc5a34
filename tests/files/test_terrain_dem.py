"""Tests of reading elevation models: layout, orientation, and errors of invalid files."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.cbook import get_sample_data
from numpy.testing import assert_allclose, assert_array_equal

from slipfree.core.errors import DataError
from slipfree.files.maps.elevation import geographic_to_metric, jacksboro, read_map

HEADER = "ncols 5\nNROWS 4\nxllcorner 100\nyllcorner 200\ncellsize 10\nNODATA_value -9999\n"
ROWS = "\n".join(" ".join(str(10 * row + column) for column in range(5)) for row in range(4))


def refuses(path, words, **keys):
    with pytest.raises(DataError, match=words):
        read_map(path, **keys)


def written(tmp_path, text, name="map.asc"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_asc_orientation_and_corner_registration(tmp_path):
    grid = read_map(written(tmp_path, HEADER + ROWS + "\n")).grid
    assert_allclose(grid.x, [105, 115, 125, 135, 145])
    assert_allclose(grid.y, [205, 215, 225, 235])
    # Row 0 of the file is the northernmost: heights fall by 10 to the north, rise by 1 to the east.
    assert_allclose(grid.z, np.add.outer(np.arange(5.0), [30, 20, 10, 0]))


def test_asc_centre_registration_and_case(tmp_path):
    text = (HEADER + ROWS).replace("corner", "center").upper()
    grid = read_map(str(written(tmp_path, text, "MAP.ASC"))).grid
    assert_allclose(grid.x, [100, 110, 120, 130, 140])
    assert_allclose(grid.y, [200, 210, 220, 230])


def test_asc_of_cells_that_are_not_square(tmp_path):
    header = HEADER.replace("cellsize 10", "dx 10\ndy 2.5")
    grid = read_map(written(tmp_path, header + ROWS)).grid
    assert_allclose(grid.spacing, (10, 2.5))
    assert (grid.x[0], grid.y[0]) == (105, 201.25)


def test_asc_window_and_rows_that_run_over_lines(tmp_path):
    heights = np.arange(90).reshape(10, 9)
    header = "ncols 9\nnrows 10\nxllcenter 0\nyllcenter 0\ncellsize 1\n"
    path = written(tmp_path, header + "\n".join(map(str, heights.ravel())))
    found = read_map(path, window=(2, 6.5, -5, 3))
    assert_allclose(found.grid.x, [2, 3, 4, 5, 6])
    assert_allclose(found.grid.y, [0, 1, 2, 3])
    assert_array_equal(found.grid.z, heights[6:, 2:7][::-1].T)
    path = written(tmp_path, path.read_text().replace("\n20\n", "\n?\n"))
    assert_array_equal(read_map(path, window=(2, 6.5, -5, 3)).grid.z, found.grid.z)
    refuses(path, r"expected numbers in line 26, found '\?'")


def test_maps_too_large_without_a_window(tmp_path):
    text = HEADER.replace("ncols 5", "ncols 100000").replace("NROWS 4", "nrows 100000") + ROWS
    path = written(tmp_path, text)
    refuses(path, r"at most 5e\+07 nodes, found 1e\+10 .* window = \[x_min")


@pytest.mark.parametrize(
    ("window", "words"),
    [
        ((0, 5, 5, 0), r"x_min < x_max and y_min < y_max, found \[0, 5, 5, 0\]; correct it: the m"),
        ((500, 600, 0, 100), r"at least 4 nodes .* found 0 by 0 .* from 105 to 145 in x"),
        ((105, 125, 205, 235), "at least 4 nodes along x and along y, found 3 by 4"),
        ((106, 144, 0, 1e9), "found 3 by 4"),
    ],
)
def test_windows_refused(tmp_path, window, words):
    refuses(written(tmp_path, HEADER + ROWS), words, window=window)


def test_degrees_taken_for_metres_are_refused(tmp_path):
    step = 1 / 3600
    x, y = 15 + step * np.arange(20), 47 + step * np.arange(20)
    z = 500 + np.add.outer(np.arange(20.0), np.arange(20.0))  # 5 %
    np.savez(tmp_path / "map.npz", x=x, y=y, z=z)
    refuses(tmp_path / "map.npz", r"seems to be in degrees: x from 15 to 15.0.*gdalwarp")
    found = read_map(tmp_path / "map.npz", geographic="local")
    assert_allclose(found.grid.x, geographic_to_metric(x, y, z).x)
    assert "errors of distances are up to" in dict(found.facts)["ground degrees"]
    np.savez(tmp_path / "map.npz", x=1e3 * x, y=1e3 * y, z=z)
    refuses(
        tmp_path / "map.npz", "expected a map in degrees, found a map in metres", geographic="local"
    )


def test_the_error_told_of_local_metres_is_that_of_the_ellipsoid(tmp_path):
    """Lengths of a degree on the WGS 84 ellipsoid at 45 degrees: 111132 m and 78847 m."""
    step = 1 / 3600
    x, y = 10 + step * np.arange(5), 45 + step * (np.arange(5) - 2)
    np.savez(tmp_path / "map.npz", x=x, y=y, z=np.add.outer(np.arange(5.0), np.arange(5.0)))
    found = read_map(tmp_path / "map.npz", geographic="local")
    lengths = np.array(found.grid.spacing) * 3600
    wrong = np.abs(lengths / [78847, 111132] - 1).max()
    assert 0.002 < wrong < 0.0028
    assert "up to 0.28 % everywhere" in dict(found.facts)["ground degrees"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "map.asc: expected a readable ESRI ASCII grid, found .*copy or download it again"),
        (HEADER.replace("xllcorner", "x") + ROWS, "xllcorner and yllcorner, .*, found yllcorner"),
        ("nodata_value 0\n" + HEADER + ROWS, "begin the file with the lines ncols, nrows, xllcorn"),
        (HEADER.replace("cellsize 10", "cellsize -1") + ROWS, "expected rows that run along x"),
        (HEADER + ROWS + "\n1 2 3 4 5", "expected 20 heights, ncols times nrows, found 25"),
        (HEADER + ROWS.replace("12", "1,2"), "expected numbers in line 8, found '1,2'"),
        (HEADER + ROWS.replace("22", "inf"), r"map.asc: grid: .* z\[2, 1\] = inf"),
        (HEADER + " ".join(["-9999"] * 20), "expected heights, found none at any node"),
    ],
)
def test_asc_refuses(tmp_path, text, words):
    refuses(written(tmp_path, text), words)


def test_heights_that_an_asc_lacks_stay_holes(tmp_path):
    text = HEADER + ROWS.replace("12", "-9999").replace("22", "nan")
    assert np.argwhere(read_map(written(tmp_path, text)).grid.holes).tolist() == [[2, 1], [2, 2]]


def test_npz(tmp_path):
    x, y = np.arange(5), np.arange(4.0, dtype=np.float32)
    z = np.arange(20, dtype=np.int16).reshape(5, 4)
    np.savez(tmp_path / "map.npz", x=x, y=y, z=z)
    grid = read_map(tmp_path / "map.npz").grid
    assert grid.z.dtype == np.float64
    assert_allclose(grid.z, z)


def test_npz_refuses(tmp_path):
    path = tmp_path / "map.npz"
    x = np.arange(5.0)
    np.savez(path, x=x, height=x)
    refuses(path, r"found \['height', 'x'\] without \['y', 'z'\]; write")
    np.savez(path, x=x, y=x, z=np.zeros((5, 4)))
    refuses(path, r"map.npz: grid: z must have .* \(5, 5\), found \(5, 4\)")
    np.savez(path, x=x, y=x, z=np.full((5, 5), "a"))
    refuses(path, "expected numbers in the array 'z', found <U1")
    np.savez(path, x=x, y=x, z=np.full((5, 5), None))
    refuses(path, "expected a numpy archive, found a file that cannot be read")
    for content in (b"", b"no archive", path.read_bytes()[:200]):
        path.write_bytes(content)
        refuses(path, "expected a numpy archive, found a file that cannot be")
    with path.open("wb") as file:
        np.save(file, x)
    refuses(path, "expected an archive of arrays x, y, z, found a single array")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("map.sdat", r"ending in .npz, .tif, .* found '.sdat', a part of a map; header and .*tran"),
        ("map.tif", "map.tif: expected a map, found that it cannot be read"),
        ("a.zip", "unpack it: unzip a.zip"),
        ("a.shp", "contours to a raster: gdal_grid .* a.shp out.tif"),
    ],
)
def test_other_files(tmp_path, name, words):
    refuses(tmp_path / name, words)


def test_geographic_to_metric_against_great_circles():
    longitude, latitude = -84 + 0.01 * np.arange(9), 36 + 0.01 * np.arange(7)
    z = np.add.outer(np.arange(9.0), 10 * np.arange(7.0))
    grid = geographic_to_metric(longitude, latitude, z)
    assert (grid.x[0], grid.y[0]) == (0, 0)
    np.testing.assert_array_equal(grid.z, z)
    # Haversine along the middle parallel, and along a meridian.
    half = np.deg2rad(0.08) / 2
    east = 2 * 6371008.8 * np.arcsin(np.cos(np.deg2rad(36.03)) * np.sin(half))
    assert_allclose(grid.x[-1], east, rtol=1e-6)
    assert_allclose(grid.y[-1], 6371008.8 * np.deg2rad(0.06), rtol=1e-9)


def test_jacksboro():
    grid = jacksboro()
    assert_allclose(grid.spacing, (74.4, 92.7), rtol=1e-3)
    assert grid.z.shape == (403, 344)
    assert (grid.x[0], grid.y[0]) == (0, 0)
    assert (grid.z.min(), grid.z.max()) == (236, 1076)
    # As drawn with the first row on top: the north-west is high, the south-east low.
    corners = {"sw": grid.z[0, 0], "se": grid.z[-1, 0], "nw": grid.z[0, -1], "ne": grid.z[-1, -1]}
    assert corners == {"sw": 545, "se": 272, "nw": 483, "ne": 444}
    with np.load(get_sample_data("jacksboro_fault_dem.npz", asfileobj=False)) as file:
        for i, j in np.random.default_rng(0).integers(0, 344, (50, 2)):
            assert grid.z[i, j] == file["elevation"][343 - j, i]
