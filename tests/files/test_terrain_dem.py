"""Tests of elevation models and scattered points: layout, missing heights, and invalid files."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
import rasterio
import scipy
from matplotlib.cbook import get_sample_data
from numpy.testing import assert_allclose, assert_array_equal

from helpers.cases import DATA
from helpers.rasters import from_origin, geotiff, refuses
from slipfree import DataError
from slipfree.files.maps import raster
from slipfree.files.maps.elevation import geographic_to_metric, jacksboro, read_map

HEADER = "ncols 5\nNROWS 4\nxllcorner 100\nyllcorner 200\ncellsize 10\nNODATA_value -9999\n"
GRASS = "north: 240\nsouth: 200\neast: 150\nwest: 100\nrows: 4\ncols: 5\nnull: -9999\n"
SURFER = "DSAA\n5 4\n105 145\n205 235\n0 34\n"
EXCHANGED = "expected 5 rows of 4 heights, found 4 rows of 5; exchange the numbers"
ROWS = "\n".join(" ".join(str(10 * row + column) for column in range(5)) for row in range(4))


def written(tmp_path, text, name="map.asc"):
    path = tmp_path / name
    path.write_text(text)
    return path


CENTRES = HEADER.replace("corner", "center").upper()
OBLONG = HEADER.replace("cellsize 10", "dx 10\ndy 2.5")


@pytest.mark.parametrize(
    ("header", "x", "y", "step"),
    [
        *((header, 105, 205, 10) for header in (HEADER, GRASS, SURFER)),
        (CENTRES, 100, 200, 10),
        (OBLONG, 105, 201.25, 2.5),
    ],
)
def test_places_of_heights_of_maps_as_text(tmp_path, header, x, y, step):
    """Heights fall by 10 to the north and rise by 1 to the east; those of Surfer begin south."""
    rows = ROWS.replace("12", "12.25").splitlines()[:: -1 if header == SURFER else 1]
    grid = read_map(str(written(tmp_path, header + "\n".join(rows) + "\n", "MAP.ASC"))).grid
    assert_allclose(grid.x, x + 10 * np.arange(5))
    assert_allclose(grid.y, y + step * np.arange(4))
    heights = np.add.outer(np.arange(5.0), [30, 20, 10, 0])
    heights[2, 2] = 12.25
    assert_allclose(grid.z, heights)


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
        (HEADER.replace("xllcorner 100\n", "") + ROWS, "xllcorner and yllco.*, found yllcorner"),
        (
            HEADER.replace(" 5", " 100000").replace("S 4", "S 100000") + ROWS,
            r"at most 5e\+07 nodes",
        ),
        ("nodata_value 0\n" + HEADER + ROWS, "begin the file with the lines ncols, nrows, xllcorn"),
        (HEADER.replace("cellsize 10", "cellsize -1") + ROWS, "expected rows that run along x"),
        (HEADER + ROWS + "\n1 2 3 4 5", "expected 20 heights, ncols times nrows, found 25"),
        (HEADER + ROWS.replace("12", "1,2"), "8, found '1,2'; .*: tr , . < map.asc > points.asc"),
        (HEADER + ROWS.replace("12", "1.0,2.0"), "8, found '1.0,2.0'; .*: tr ', ' ' ' < map.asc"),
        (HEADER + ROWS.replace("12", "1_2"), "expected numbers in line 8, found '1_2'"),
        (HEADER.replace("100", "1D2") + ROWS, "line 3, or a key with its number .ncols .*'1D2'"),
        (HEADER + "# heights\n" + ROWS, "numbers in line 7, or a key with its number .*found '#'"),
        (HEADER + "nodata -1\n" + ROWS, "numbers in line 7, or a key .*nodata_value..*'nodata'"),
        (HEADER + "cellsize 1\n" + ROWS, "one 'cellsize' in the header, found another in line 7"),
        (HEADER.replace("5\nNROWS 4", "4\nNROWS 5") + ROWS, EXCHANGED),
        (GRASS + ROWS.replace("12", "*"), r"expected numbers in line 9, found '\*'"),
        (SURFER + ROWS.replace("12", "x"), "expected numbers in line 7, found 'x'"),
        (SURFER + ROWS + "\n1 2 3 4 5", "expected 20 heights, ncols times nrows, found 25"),
        (SURFER.replace("5 4", "4 5") + ROWS, EXCHANGED),
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


# Scattered points on a grid: exact on linear surfaces, and errors of invalid files


def scattered(count=400, size=10.0, offset=(500000.0, 4.5e6)):
    """Return points of a plane, the corners of a square among them."""
    places = np.random.default_rng(1).uniform(0, size, (count, 2))
    places = np.vstack([places, [[0, 0], [0, size], [size, 0], [size, size]]])
    z = 3 + 0.2 * places[:, 0] - 0.1 * places[:, 1]
    return np.column_stack([places + offset, z])


def written_scattered(path, points, delimiter=" ", header=""):
    np.savetxt(path, points, delimiter=delimiter, header=header, comments="", fmt="%.17g")
    return path


@pytest.mark.parametrize(
    ("name", "delimiter", "header"),
    [
        ("p.xyz", " ", ""),
        ("p.txt", "\t", "# measured today"),
        ("p.csv", ",", "X, Y, Z"),
        ("p.csv", ";", "easting;northing;height"),
        ("p.csv", ",", "E,N,h"),
    ],
)
def test_a_plane_is_exact(tmp_path, name, delimiter, header):
    found = read_map(
        written_scattered(tmp_path / name, scattered(), delimiter, header), spacing=0.5
    )
    x, y = found.grid.x - 500000, found.grid.y - 4.5e6
    assert_allclose(x, np.arange(0, 10.1, 0.5), atol=1e-9)
    assert_allclose(y, np.arange(0, 10.1, 0.5), atol=1e-9)
    assert_allclose(found.grid.z, 3 + 0.2 * x[:, None] - 0.1 * y, atol=1e-8)
    told = dict(found.facts)["ground points"]
    assert told.startswith("404, a median of 0.2")
    assert told.endswith("for 441 nodes 0.5 by 0.5 m apart")


@pytest.mark.parametrize(
    "text", ["X,Y,Z,R,G,B\n{}", "//X Y Z Intensity\n{}", "{}", "400\n{}", "r;z;y [m];x;i\n{}"]
)
def test_further_columns_are_ignored(tmp_path, text):
    """Colours and intensities: x, y, z by name, else the first three columns."""
    points = np.round(scattered(396, offset=(500000, 4.5e6)), 3)
    others = np.arange(400)[:, None] % 256
    separator = "," if "," in text else ";" if ";" in text else " "
    columns = [others, points[:, 2:], points[:, 1::-1], others]
    if separator != ";":
        columns = [points, others] + [others, others] * (separator == ",")
    np.savetxt(tmp_path / "q.xyz", np.hstack(columns), delimiter=separator, fmt="%.3f")
    (tmp_path / "p.xyz").write_text(text.format((tmp_path / "q.xyz").read_text()))
    found = read_map(tmp_path / "p.xyz", spacing=1.0)
    plain = read_map(written_scattered(tmp_path / "a.xyz", points), spacing=1.0)
    assert_array_equal(found.grid.z, plain.grid.z)
    is_guessed = text in ("{}", "400\n{}")
    assert ("x, y, z are the first 3 of 4" in dict(found.facts)["ground points"]) == is_guessed


def test_a_matrix_of_heights_is_not_read_as_points(tmp_path, rng):
    np.savetxt(tmp_path / "m.csv", rng.normal(100, 3, (40, 40)), fmt="%.3f", delimiter=",")
    words = r"40 columns without names, probably a matrix.*\.asc"
    refuses(tmp_path / "m.csv", words, spacing=1.0)


def test_points_on_a_grid_keep_their_values(tmp_path):
    """At coordinates whose steps are not exact, no node is lost at the border."""
    x, y = 500000.3 + 0.1 * np.arange(30), 4.5e6 + 0.1 * np.arange(20)
    z = np.random.default_rng(2).normal(size=(30, 20))
    points = np.column_stack(
        [*(each.reshape(-1) for each in np.meshgrid(x, y, indexing="ij")), z.reshape(-1)]
    )
    np.random.default_rng(3).shuffle(points)
    found = read_map(written_scattered(tmp_path / "p.xyz", points), spacing=0.1).grid
    assert_allclose(found.x, x, atol=1e-8)
    assert_allclose(found.z, z, atol=1e-12)
    part = read_map(tmp_path / "p.xyz", spacing=0.1, window=(500001.25, 500002, 4.5e6, 4.5e6 + 0.5))
    assert_allclose(part.grid.z, z[10:18, :6], atol=1e-12)


def test_nodes_outside_the_hull_are_holes(tmp_path):
    angle = np.random.default_rng(4).uniform(0, 2 * np.pi, 3000)
    radius = 5 * np.sqrt(np.random.default_rng(5).random(3000))
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0.1 * radius])
    path = written_scattered(tmp_path / "p.xyz", points)
    grid = read_map(path, spacing=0.5, fill="linear").grid
    inside = np.hypot(grid.x[:, None], grid.y) < 4.8
    assert not grid.holes[inside].any()
    assert grid.holes[np.hypot(grid.x[:, None], grid.y) > 5].all()


@pytest.mark.parametrize(
    ("text", "words"), tomllib.loads((DATA / "refused_points.toml").read_text())["points"]
)
def test_files_refused(tmp_path, text, words):
    path = tmp_path / "p.xyz"
    path.write_text(text)
    refuses(path, f"p.*{words}", spacing=1.0)


def test_a_missing_spacing_is_suggested(tmp_path, rng):
    words = r"expected spacing, .* neighbours is 0.2\d+ m: set spacing = 0.2\d* \(--set terrain.s"
    refuses(written_scattered(tmp_path / "p.xyz", scattered()), words)
    nodes = np.column_stack([X.ravel(), Y.ravel(), HILLS.ravel()])
    apart = nodes + [0.05, 0, 0] * rng.uniform(-1, 1, (X.size, 1))
    turned = nodes @ [[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1]]
    twice = np.vstack([nodes, nodes[0] + 1e-3])
    few = rng.permutation(nodes)[: X.size // 2]
    for points in (apart, turned, twice, few):
        refuses(written_scattered(tmp_path / "p.xyz", points), "expected spacing")


@pytest.mark.parametrize("form", ["%.17g", "%.3f"])
@pytest.mark.parametrize("order", ["west to east", "north to south", "shuffled"])
def test_points_on_a_regular_grid_equal_the_raster(tmp_path, rng, order, form):
    """Also with missing nodes, and coordinates that are rounded in a projection or in print."""
    z = HILLS.copy()
    z[:3, :2] = z[20:25, -1] = z[-1, 7] = z[10, 10] = -9999.0
    place = from_origin(5e5, 5e6, 1 / 3)
    raster = read_map(
        geotiff(tmp_path / "m.tif", z.T[::-1], place, dtype="float64", nodata=-9999.0)
    )
    x, y = np.meshgrid(raster.grid.x, raster.grid.y, indexing="ij")
    points = np.column_stack([x[z > 0], y[z > 0], z[z > 0]])
    points[:, :2] += rng.uniform(-1e-8, 1e-8, (len(points), 2))
    if order != "west to east":
        by_rows = np.lexsort((points[:, 0].round(3), -points[:, 1].round(3)))
        points = points[by_rows] if order == "north to south" else rng.permutation(points)
    np.savetxt(tmp_path / "p.csv", points, delimiter=",", fmt=[form, form, "%.17g"])
    found = read_map(tmp_path / "p.csv")
    assert_allclose(found.grid.x, raster.grid.x, rtol=0, atol=1e-3)
    assert_allclose(found.grid.y, raster.grid.y, rtol=0, atol=1e-3)
    assert_array_equal(found.grid.z, raster.grid.z)
    assert_array_equal(found.grid.holes, raster.grid.holes)
    assert "1187, a median of 0.333 m apart, for 1200 nodes 0.3333" in str(found.facts)
    window = (5e5 + 3, 5e5 + 9, 5e6 - 9, 5e6 - 3)
    part = read_map(tmp_path / "p.csv", window=window).grid
    assert_array_equal(part.z, read_map(tmp_path / "m.tif", window=window).grid.z)


def test_too_many_nodes_need_a_window(tmp_path):
    path = written_scattered(tmp_path / "p.xyz", scattered(offset=(0, 0)))
    refuses(path, r"at most 5e\+07 nodes, found 1e\+10 .*window = \[x_min", spacing=1e-4)
    part = read_map(path, spacing=1e-4, window=(5, 5.01, 5, 5.01))
    assert part.grid.z.shape == (101, 101)


# Undeclared markers of missing heights are refused with a remedy that works; no honest map is

X, Y = np.meshgrid(np.arange(40.0), np.arange(30.0), indexing="ij")
HILLS = 100 + 0.1 * np.sin(X / 4) * np.cos(Y / 5)
MOUNTAINS = 1500 + 600 * np.sin(X / 9) * np.cos(Y / 8)
NODES = np.random.default_rng(4).permutation(X.size)[:16]
HOLES = np.isin(np.arange(X.size), NODES).reshape(X.shape)
MARKERS = (-9999, -32768, -32767, 32767, -99999, 65535, 9999, -500, -1, 0, -999.25, -9999.9)
HUGE = (-3.4028234663852886e38, 1e30, 1e20, -1.7976931348623157e308)


def _geotiff(path, z, dtype="float64", **options):
    return geotiff(path, z[:, ::-1].T, from_origin(5e5, 5e6, 1), dtype=dtype, **options)


def _marked(z, value):
    return np.where(HOLES, value, z)


def _refused(path, **options):
    with pytest.raises(DataError, match=r"expected heights, found the value .*") as error:
        read_map(path, **options)
    return str(error.value)


@pytest.mark.parametrize("value", [*MARKERS, *HUGE])
def test_markers_of_a_geotiff(tmp_path, value):
    """The message has value, number, place and remedy: the command declares the value."""
    kind = "float32" if value in (-3.4028234663852886e38, -9999.9) else "float64"
    path = _geotiff(tmp_path / "map.tif", _marked(MOUNTAINS if value else HILLS, value), dtype=kind)
    words = _refused(path)
    i, j = np.argwhere(HOLES)[0]
    assert f"at 16 of 1200 nodes, first at x = {500000.5 + i}, y = {5e6 - 29.5 + j}" in words
    declared = words.split("gdal_edit.py -a_nodata ")[1].removesuffix(" map.tif")
    assert float(np.dtype(kind).type(declared)) == float(np.dtype(kind).type(value))
    with rasterio.open(path, "r+") as file:  # as gdal_edit.py does
        file.nodata = float(declared)
    np.testing.assert_array_equal(read_map(path).grid.holes, HOLES)


def test_markers_of_other_formats(tmp_path):
    """ASCII grid, netCDF, numpy archive, text and picture: each has its own remedy."""
    rows = "\n".join(
        " ".join(map(repr, row)) for row in _marked(HILLS, -9999.0)[:, ::-1].T.tolist()
    )
    head = "ncols 40\nnrows 30\nxllcorner 0\nyllcorner 0\ncellsize 1\n"
    path = tmp_path / "map.asc"
    path.write_text(head + rows)
    assert "by the line NODATA_value -9999 at the end of the header" in _refused(path)
    path.write_text(f"{head}NODATA_value -9999\n{rows}")
    np.testing.assert_array_equal(read_map(path).grid.holes, HOLES)
    path.write_text(f"{head}NODATA_value -1\n{rows}")
    assert '--calc="numpy.where(A == -9999, -1, A)" --NoDataValue=-1' in _refused(path)
    np.savez(tmp_path / "map.npz", x=X[:, 0], y=Y[0], z=_marked(HILLS, -9999.0))
    assert "set them to NaN: z[z == -9999] = numpy.nan" in _refused(tmp_path / "map.npz")
    points = np.column_stack([X.ravel(), Y.ravel(), _marked(HILLS, -9999.0).ravel()])
    np.savetxt(tmp_path / "map.xyz", points)
    assert "at 16 of 1200 points" in _refused(tmp_path / "map.xyz", spacing=1.0)
    keys = {"cell": 1.0, "registration": "area", "vertical_scale": 0.01}
    levels = np.round(100 * _marked(HILLS, 0))
    _geotiff(tmp_path / "map.png", levels, driver="PNG", dtype="uint16", crs=None)
    (tmp_path / "map.png.aux.xml").unlink(missing_ok=True)
    assert "gdal_translate -a_nodata 0 map.png out.tif" in _refused(tmp_path / "map.png", **keys)


def test_only_the_window_is_judged(tmp_path):
    z = HILLS.copy()
    z[30:, 20:] = -9999
    path = _geotiff(tmp_path / "map.tif", z)
    assert "at 100 of 1200 nodes" in _refused(path)
    low = 5e6 - 30
    assert read_map(path, window=(5e5, 5e5 + 29, low, low + 30)).grid.holes is None
    assert "at 9 of " in _refused(path, window=(5e5, 5e5 + 33, low, low + 23))


def test_two_markers_and_most_nodes_missing(tmp_path):
    z = np.full(X.shape, -32768.0)
    z[:6, :6], z[:6, 6] = MOUNTAINS[:6, :6], -9999
    words = _refused(_geotiff(tmp_path / "map.tif", z))
    assert "-32768 at 1158 of 1200 nodes" in words


def test_markers_of_a_large_map(monkeypatch, tmp_path):
    """Of large maps, only extremes and a part of the heights are sorted."""
    monkeypatch.setattr(raster, "MAX_SORTED", 100)
    for value in (-32768, 0, 65535):
        z = np.where((X == 7) & (Y == 9), value, MOUNTAINS)
        assert f"the value {value} at 1 of 1200" in _refused(_geotiff(tmp_path / "map.tif", z))
    read_map(_geotiff(tmp_path / "map.tif", MOUNTAINS))


@pytest.mark.parametrize(("value", "factor"), [(-9999, 2), (-32768, 5), (1e30, 3), (65535, 4)])
def test_interpolated_markers(tmp_path, value, factor):
    """A map that was resampled has values between marker and heights; -9999 may not occur."""
    z = scipy.ndimage.zoom(_marked(MOUNTAINS, value), factor, order=1)[1:-1, 1:-1]
    with pytest.raises(DataError, match=r"interpolated; declare their value before resampling"):
        read_map(_geotiff(tmp_path / "map.tif", np.where(z == value, z + 0.5 * np.sin(z), z)))


NOISE = 0.05 * np.random.default_rng(1).normal(size=X.shape)
INSIDE = (abs(X - 20) < 4) & (abs(Y - 15) < 4)
HONEST = {
    "pole": np.where((X == 20) & (Y == 15), 12.0, NOISE),
    "tower": np.where(INSIDE, 828.0, NOISE),
    "well": np.where((X == 20) & (Y == 15), -40.0, NOISE),
    "sea below cliffs": np.where(X < 12, 0.0, 100 + NOISE),
    "sea below high cliffs": np.where(X < 12, 0.0, 250 + 100 * np.sin(X / 9)),
    "islands": np.maximum(0.0, 900 * np.exp(-((X - 20) ** 2 + (Y - 15) ** 2) / 60) - 50),
    "lake": np.maximum(400.0, 410 + 30 * np.sin(X / 9)),
    "step": np.where(X < 20, 0.0, 1.0),
    "stairs": np.floor(X / 8) * 5,
    "canyon": np.where(abs(X - 20) < 5, 800.0, 2000.0) + NOISE,
    "level": 0 * X,
    "below the sea": -3000 + 60 * X,
    "few coarse nodes": MOUNTAINS[::8, ::8],
    "random coarse nodes": 2000 * np.random.default_rng(2).random((4, 5)),
    "whole metres": np.round(MOUNTAINS),
    "sample": jacksboro().z,
}


@pytest.mark.parametrize("name", HONEST)
def test_honest_maps_are_read(tmp_path, name):
    path = _geotiff(tmp_path / "map.tif", HONEST[name])
    np.testing.assert_array_equal(read_map(path).grid.z, HONEST[name])
