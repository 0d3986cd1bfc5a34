"""Tests of scattered points on a grid: exact on linear surfaces, and errors of invalid files."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from slipfree.core.errors import DataError
from slipfree.files.maps.elevation import read_map


def scattered(count=400, size=10.0, offset=(500000.0, 4.5e6)):
    """Return points of a plane, the corners of a square among them."""
    places = np.random.default_rng(1).uniform(0, size, (count, 2))
    places = np.vstack([places, [[0, 0], [0, size], [size, 0], [size, size]]])
    z = 3 + 0.2 * places[:, 0] - 0.1 * places[:, 1]
    return np.column_stack([places + offset, z])


def written(path, points, delimiter=" ", header=""):
    np.savetxt(path, points, delimiter=delimiter, header=header, comments="", fmt="%.17g")
    return path


@pytest.mark.parametrize(
    ("name", "delimiter", "header"),
    [
        ("p.xyz", " ", ""),
        ("p.txt", "\t", "# measured today"),
        ("p.csv", ",", "X, Y, Z"),
        ("p.csv", ";", "easting;northing;height"),
        ("p.csv", ",", "E,N,Up"),
    ],
)
def test_a_plane_is_exact(tmp_path, name, delimiter, header):
    found = read_map(written(tmp_path / name, scattered(), delimiter, header), spacing=0.5)
    x, y = found.grid.x - 500000, found.grid.y - 4.5e6
    assert_allclose(x, np.arange(0, 10.1, 0.5), atol=1e-9)
    assert_allclose(y, np.arange(0, 10.1, 0.5), atol=1e-9)
    assert_allclose(found.grid.z, 3 + 0.2 * x[:, None] - 0.1 * y, atol=1e-8)
    told = dict(found.facts)["ground points"]
    assert told.startswith("404, a median of 0.2")
    assert told.endswith("for 441 nodes 0.5 m apart")


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
    plain = read_map(written(tmp_path / "a.xyz", points), spacing=1.0)
    assert_array_equal(found.grid.z, plain.grid.z)
    is_guessed = text in ("{}", "400\n{}")
    assert ("x, y, z are the first 3 of 4" in dict(found.facts)["ground points"]) == is_guessed


def test_a_matrix_of_heights_is_not_read_as_points(tmp_path, rng):
    np.savetxt(tmp_path / "m.csv", rng.normal(100, 3, (40, 40)), fmt="%.3f", delimiter=",")
    with pytest.raises(DataError, match=r"40 columns without names, probably a matrix.*\.asc"):
        read_map(tmp_path / "m.csv", spacing=1.0)


def test_points_on_a_grid_keep_their_values(tmp_path):
    """At coordinates whose steps are not exact, no node is lost at the border."""
    x, y = 500000.3 + 0.1 * np.arange(30), 4.5e6 + 0.1 * np.arange(20)
    z = np.random.default_rng(2).normal(size=(30, 20))
    points = np.column_stack(
        [*(each.reshape(-1) for each in np.meshgrid(x, y, indexing="ij")), z.reshape(-1)]
    )
    np.random.default_rng(3).shuffle(points)
    found = read_map(written(tmp_path / "p.xyz", points), spacing=0.1).grid
    assert_allclose(found.x, x, atol=1e-8)
    assert_allclose(found.z, z, atol=1e-12)
    part = read_map(tmp_path / "p.xyz", spacing=0.1, window=(500001.25, 500002, 4.5e6, 4.5e6 + 0.5))
    assert_allclose(part.grid.z, z[10:18, :6], atol=1e-12)


def test_nodes_outside_the_hull_are_holes(tmp_path):
    angle = np.random.default_rng(4).uniform(0, 2 * np.pi, 3000)
    radius = 5 * np.sqrt(np.random.default_rng(5).random(3000))
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0.1 * radius])
    path = written(tmp_path / "p.xyz", points)
    grid = read_map(path, spacing=0.5, fill="linear").grid
    inside = np.hypot(grid.x[:, None], grid.y) < 4.8
    assert not grid.holes[inside].any()
    assert grid.holes[np.hypot(grid.x[:, None], grid.y) > 5].all()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "at least 3 points .* found 0"),
        ("0 0 1\n1 0 x\n0 1 1\n", "xyz:2: expected three numbers x,y,z, found '1 0 x'; "),
        ("0 0\n1 0 1\n1 0 2\n", "xyz:1: expected 3 values as in the lines below, found '0 0'"),
        ("a b c d\n0 0 1 5\n1 0 1 5\n", "found no column 'x' among a, b, c, d; name the columns"),
        ("0 0 1\n0 0 1\n1 0 1\n", "at least 3 points with different x, y, found 2"),
        ("1 0 0 1\n2 0 1 1\n3 1 0 1\n", "p.xyz:1: expected .* first column counts or names .* as"),
        ("0,000,0,500,1,250\n", "found '000' between commas, .* separate the columns by semicolon"),
        ('"0,0","0,5","1,2"\n"0,0","1,5","1,2"\n', "xyz:2: expected two or more numbers, found"),
        ("lon lat alt\n0 0 1\n0 1e-5 1\n1e-5 0 1\n", "at spacing = 1 deg; .* such as 1e-05"),
        ("ncols 3\nnrows 2\ncellsize 1\n1 2 3\n4 5 6\n", "an ESRI ASCII grid; rename it to end in"),
        ("\n".join(f"{k} {k} 1" for k in range(9)), "found that they lie on a line"),
        ("0 0 1\n1 0 1\n0 1 1\n", "at least 4 by 4 nodes, found 2 by 2 at spacing = 1 m"),
    ],
)
def test_files_refused(tmp_path, text, words):
    path = tmp_path / "p.xyz"
    path.write_text(text)
    with pytest.raises(DataError, match=rf"p.*{words}"):
        read_map(path, spacing=1.0)


def test_a_missing_spacing_is_suggested(tmp_path):
    with pytest.raises(
        DataError, match=r"expected spacing, .* neighbours is 0.2\d+ m: set spacing"
    ):
        read_map(written(tmp_path / "p.xyz", scattered()))


def test_too_many_nodes_need_a_window(tmp_path):
    path = written(tmp_path / "p.xyz", scattered(offset=(0, 0)))
    with pytest.raises(DataError, match=r"at most 5e\+07 nodes, found 1e\+10 .*window = \[x_min"):
        read_map(path, spacing=1e-4)
    part = read_map(path, spacing=1e-4, window=(5, 5.01, 5, 5.01))
    assert part.grid.z.shape == (101, 101)
