"""Tests of point clouds: heights of a known surface, holes, units, formats, damaged files."""

import re
import sys

import laspy
import numpy as np
import pyproj
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from helpers.commands import refuses
from helpers.fuzz_maps import pcd, ply
from slipfree.core.errors import DataError
from slipfree.files.maps.elevation import read_map

pytestmark = pytest.mark.usefixtures("direct_reads")

WEST, SOUTH = 500000.0, 4.5e6


def plane(x, y):
    return 30 + 0.2 * (x - WEST) - 0.1 * (y - SOUTH)


def cloud(path, places=None, z=None, *, kind=None, crs="EPSG:32633", keys=(), scale=1e-3):
    """Write points with millimetres as LAS 1.4, or as LAS 1.2 with GeoTIFF keys.

    By default, they are scattered and lie on the plane.
    """
    places = scattered() if places is None else places
    z = plane(*places.T) if z is None else z
    modern = not keys
    header = laspy.LasHeader(point_format=6 if modern else 1, version="1.4" if modern else "1.2")
    header.scales, header.offsets = [1e-3, 1e-3, scale], [WEST, SOUTH, 0]
    if keys:
        record = laspy.vlrs.known.GeoKeyDirectoryVlr()
        words = np.array([(key, 0, 1, value) for key, value in keys]).reshape(-1)
        words = np.concatenate([[1, 1, 0, len(keys)], words]).astype("<u2")
        record.parse_record_data(words.tobytes())
        header.vlrs.append(record)
    elif crs is not None:
        header.add_crs(pyproj.CRS(crs))
    data = laspy.LasData(header)
    data.x, data.y, data.z = places[:, 0], places[:, 1], z
    data.classification = np.zeros(len(z), np.uint8) if kind is None else kind
    data.write(path)
    return path


def scattered(count=4000, size=20.0):
    """Return places that millimetres represent exactly, except in a square without points."""
    places = np.random.default_rng(1).uniform(0, size, (count, 2)).round(3)
    within = ((places > 8) & (places < 12)).all(axis=1)
    return places[~within] + [WEST, SOUTH]


def assert_plane(grid, atol=1e-3):
    """Assert that the heights are those of the plane, which is written in millimetres."""
    x, y = np.meshgrid(grid.x, grid.y, indexing="ij")
    whole = ~grid.holes
    assert_allclose(grid.z[whole], plane(x, y)[whole], rtol=0, atol=atol)


@pytest.mark.parametrize("ending", ["las", "LAZ"])
def test_a_plane_is_exact_and_cells_without_points_are_holes(tmp_path, ending):
    places = scattered()
    found = read_map(cloud(tmp_path / f"a.{ending}", places), spacing=1.0)
    grid = found.grid
    assert_allclose(grid.x, WEST + np.arange(21), rtol=0, atol=1e-8)
    assert_allclose(grid.y, SOUTH + np.arange(21), rtol=0, atol=1e-8)
    assert found.crs == "EPSG:32633"
    assert_plane(grid)
    assert grid.holes[9:12, 9:12].all()  # cells about nodes from 9 m to 11 m are empty
    inner = grid.holes[1:-1, 1:-1]
    assert np.count_nonzero(inner) == 9
    facts = dict(found.facts)
    assert facts["ground points"].startswith(f"all {len(places)} points, ")
    assert "cells of 1 m; 431 of 441 cells have points" in facts["ground points"]
    assert "1 m of the map is 1.0004" in facts["ground map scale"]


def test_the_mean_density_gives_the_width_of_cells(tmp_path):
    found = read_map(cloud(tmp_path / "a.las"))
    words = dict(found.facts)["ground points"]
    density = float(re.search(r"([\d.]+) per m2", words)[1])
    assert_allclose(density, 10, rtol=0.05)  # the square without points does not count
    width = float(f"{np.sqrt(4 / density):.2g}")
    assert f"cells of {width:g} m, chosen for 4 points in each (override with spacing)" in words
    assert_allclose(found.grid.spacing, width)


@pytest.mark.bounded
def test_noise_is_averaged_and_no_number_depends_on_the_window(tmp_path):
    places = scattered(40000)
    z = plane(*places.T) + np.random.default_rng(3).normal(0, 0.05, len(places))
    path = cloud(tmp_path / "a.laz", places, z)
    whole = read_map(path, spacing=1.0).grid
    x, y = np.meshgrid(whole.x, whole.y, indexing="ij")
    error = (whole.z - plane(x, y))[1:-1, 1:-1][~whole.holes[1:-1, 1:-1]]
    assert 0.002 < np.std(error) < 0.05 / np.sqrt(100) * 1.5  # 100 points in each cell
    part = read_map(path, spacing=1.0, window=(WEST + 3, WEST + 7, SOUTH + 2, SOUTH + 6)).grid
    assert_array_equal(part.x, whole.x[3:8])
    assert_allclose(part.z, whole.z[3:8, 2:7], rtol=0, atol=1e-9)


def test_ground_points_are_preferred_and_noise_is_left_out(tmp_path):
    places = scattered()
    kind = np.random.default_rng(2).choice(np.array([2, 5, 7], np.uint8), len(places))
    z = plane(*places.T) + np.where(kind == 2, 0.0, 15.0)
    found = read_map(cloud(tmp_path / "a.las", places, z, kind=kind), spacing=2.0)
    assert_plane(found.grid)
    counts = np.bincount(kind)
    words = f"{counts[2]} classified as ground, of {counts[2] + counts[5]} points"
    assert dict(found.facts)["ground points"].startswith(words)


@pytest.mark.parametrize(
    ("crs", "keys", "length", "words"),
    [
        ("EPSG:32633+8228", (), 0.3048, "converted from foot (0.3048 m)"),
        ("EPSG:32633+5703", (), 1.0, "in metres"),
        (None, ((3072, 32633), (4099, 9003)), 1200 / 3937, "converted from US survey foot"),
        (None, ((3072, 32633), (4096, 6360)), 1200 / 3937, "converted from US survey foot"),
        (None, ((3072, 32633),), 1.0, "unit not stated: taken as metres"),
        (None, (), 1.0, "unit not stated: taken as metres"),
    ],
)
def test_the_unit_of_heights_is_that_of_the_file(tmp_path, crs, keys, length, words):
    places = scattered()
    path = cloud(tmp_path / "a.las", places, plane(*places.T) / length, crs=crs, keys=keys)
    found = read_map(path, spacing=1.0)
    assert found.crs == ("EPSG:32633" if crs or keys else "")
    assert dict(found.facts)["ground map"].endswith(f"cloud, {found.crs or 'CRS not given'}")
    assert words in dict(found.facts)["ground map heights"]
    assert_plane(found.grid, 2e-3)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"crs": "EPSG:4326"}, r"a point cloud in metres, found degrees .*pdal translate"),
        ({"keys": ((3076, 9002), (3072, 32767))}, r"in metres, found the unit 'foot'"),
        ({"crs": "EPSG:32633+5715"}, r"upward, found depths, .*'Z = Z \* -1'"),
        ({"scale": 0.3}, "a cell, 1 m, found the scale 0.3 m .*; set spacing = 1.2 or more"),
        ({"places": scattered()[:2]}, "at least 3 points, found 2; use another file"),
        ({"places": scattered() * [0, 1] + [WEST, 0]}, "a surface, found that they lie on a l"),
    ],
)
def test_points_are_refused_with_a_remedy(tmp_path, options, words):
    path = cloud(tmp_path / "a.las", **options)
    refuses(DataError, rf"a\.las: expected .*{words}", read_map, path, spacing=1.0)


@pytest.mark.bounded
def test_a_file_that_aborts_its_reader_is_refused(tmp_path):
    path = cloud(tmp_path / "a.laz", scattered(100))
    data = bytearray(path.read_bytes())
    points = int.from_bytes(data[96:100], "little")
    table = int.from_bytes(data[points : points + 8], "little")
    data[table + 4 : table + 8] = b"\xff" * 4  # number of chunks, for which lazrs allocates memory
    path.write_bytes(data)
    refuses(DataError, r"a\.laz: expected a readable file, found that its reader", read_map, path)


def test_a_header_with_too_many_records_is_refused_at_once(tmp_path):
    path = cloud(tmp_path / "a.las", scattered(100))
    data = bytearray(path.read_bytes())
    data[100:104] = b"\xff" * 4  # number of records before the points
    path.write_bytes(data)
    refuses(DataError, "expected a readable LAS or LAZ file, found 42949672", read_map, path)


def test_without_the_package_the_message_says_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "laspy", None)
    (tmp_path / "a.laz").write_bytes(b"LASF")
    with pytest.raises(DataError, match=r"package 'laspy', .*pip install 'laspy>=.*'plyfile>="):
        read_map(tmp_path / "a.laz")


# Point clouds in PLY and PCD: encodings, orders, omitted points, damaged files

PLACES = np.random.default_rng(1).uniform(0, 20, (4000, 2))
PLANE = np.column_stack([PLACES, 3 + 0.2 * PLACES[:, 0] - 0.1 * PLACES[:, 1]])
PLY_KINDS = ("ascii", "binary_little_endian", "binary_big_endian")
PCD_KINDS = ("ascii", "binary", "binary_compressed")


def heights(path, **options):
    """Return the map of a cloud on the plane, after a check of its heights."""
    found = read_map(path, spacing=1.0, **options)
    x, y = np.meshgrid(found.grid.x, found.grid.y, indexing="ij")
    whole = ~found.grid.holes if found.grid.holes is not None else np.ones(x.shape, bool)
    assert_allclose(found.grid.z[whole], (3 + 0.2 * x - 0.1 * y)[whole], rtol=0, atol=2e-5)
    assert whole.sum() > 300
    return found


@pytest.mark.parametrize("kind", PLY_KINDS)
@pytest.mark.parametrize("real", ["float", "double"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_vertices_of_a_ply_are_points(tmp_path, kind, real, newline):
    path = tmp_path / "a.PLY"
    before = 5 if newline == "\n" else 0  # elements
    path.write_bytes(ply(PLANE, kind, real=real, newline=newline, faces=3, before=before))
    facts = dict(heights(path).facts)
    assert facts["ground map"] == f"PLY ({kind}) point cloud, CRS not given"
    assert facts["ground points"].startswith("all 4000 points, ")
    assert facts["ground map heights"] == "unit not stated: taken as metres"


@pytest.mark.parametrize("kind", PCD_KINDS)
@pytest.mark.parametrize("real", ["F 4", "F 8"])
def test_points_of_a_pcd(tmp_path, kind, real):
    path = tmp_path / "a.pcd"
    path.write_bytes(pcd(PLANE, kind, real=real))
    facts = dict(heights(path).facts)
    assert facts["ground map"] == f"PCD 0.7 ({kind}) point cloud, CRS not given"


def test_points_without_coordinates_are_left_out(tmp_path):
    points = PLANE.copy()
    points[::7] = np.nan
    points[3] = np.inf
    for name, data in (
        ("a.pcd", pcd(points, "ascii")),
        ("b.pcd", pcd(points, "binary")),
        ("a.ply", ply(points, "binary_big_endian")),
        ("b.ply", ply(points, "ascii")),
    ):
        (tmp_path / name).write_bytes(data)
        facts = dict(heights(tmp_path / name).facts)
        assert facts["ground points"].endswith("; 573 without coordinates left out")


def test_classes_of_a_ply_are_those_of_las(tmp_path):
    """Ground points are preferred, noise is left out."""
    kinds = np.random.default_rng(2).choice([2, 5, 7], len(PLANE))
    points = PLANE + np.where(kinds == 2, 0, 15.0)[:, None] * [0, 0, 1]
    for kind in PLY_KINDS:
        path = tmp_path / f"{kind}.ply"
        path.write_bytes(ply(points, kind, classes=kinds))
        found = read_map(path, spacing=2.0)
        words = dict(found.facts)["ground points"]
        assert words.startswith(f"{np.count_nonzero(kinds == 2)} classified as ground, of ")
        x, y = np.meshgrid(found.grid.x, found.grid.y, indexing="ij")
        assert np.abs(found.grid.z - (3 + 0.2 * x - 0.1 * y))[1:-1, 1:-1].max() < 1e-4


def test_comments_in_other_encodings_are_left_out(tmp_path):
    """The byte 85 is a new line in Latin-1."""
    comment = b"comment from Z\xfcrich\x85and Gen\xe8ve\n"
    data = ply(PLANE, "binary_little_endian").replace(b"element", comment + b"element", 1)
    (tmp_path / "a.ply").write_bytes(data)
    heights(tmp_path / "a.ply")
    data = pcd(PLANE, "binary").replace(b"DATA", b"# from Z\xfcrich\x85FIELDS y\nDATA", 1)
    (tmp_path / "a.pcd").write_bytes(data)
    heights(tmp_path / "a.pcd")


def test_counts_and_single_blanks_are_no_duty_of_a_pcd(tmp_path):
    head, text = pcd(PLANE, "ascii").split(b"ascii\n")
    data = cut(head, b"COUNT 1 1 1\n", b"") + b"ascii\n" + text.replace(b" ", b" \t ")
    (tmp_path / "a.pcd").write_bytes(data)
    heights(tmp_path / "a.pcd")


@pytest.mark.bounded
def test_a_window_reads_the_same_heights(tmp_path):
    path = tmp_path / "a.pcd"
    path.write_bytes(pcd(PLANE, "binary_compressed"))
    whole, part = (read_map(path, spacing=1.0, window=w).grid for w in (None, (3, 9, 4, 12)))
    assert_allclose(part.z, whole.z[3:10, 4:13], rtol=0, atol=1e-9)


def cut(data, old, new):
    assert old in data
    return data.replace(old, new, 1)


PLY, PCD = ply(PLANE[:50], "binary_little_endian"), pcd(PLANE[:50], "binary")
TEXT, TEXT_PCD = ply(PLANE[:50], "ascii"), pcd(PLANE[:50], "ascii")
PACKED = pcd(PLANE[:50], "binary_compressed")


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.ply", b"", "no header that ends with 'end_header'"),
        ("a.ply", b"ply\nformat ascii 1.0\n" + bytes(10**6), "no header that ends"),
        ("a.ply", cut(PLY, b"property float y", b"property half y"), "field type"),
        ("a.ply", cut(PLY, b"property float y", b"property float why"), "without 'y'"),
        ("a.ply", cut(PLY, b"element vertex", b"element vortex"), "the elements vortex without"),
        ("a.ply", PLY[:-1], "early end-of-file"),
        ("a.ply", cut(TEXT, b"vertex 50", b"vertex 51"), "early end-of-file"),
        ("a.ply", cut(TEXT, b"end_header\n", b"end_header\nx "), "malformed input"),
        ("a.pcd", b"", "no header that ends with 'DATA'"),
        ("a.pcd", cut(PCD, b"DATA binary", b"DATA packed"), "'packed'"),
        ("a.pcd", cut(PCD, b"FIELDS x y z", b"FIELDS x y w"), "points with x, y, w, without 'z'"),
        ("a.pcd", cut(PCD, b"SIZE 4 4 4", b"SIZE 4 4 3"), "'F', 3"),
        ("a.pcd", cut(PCD, b"TYPE F F F", b"TYPE F F Q"), "'F', 'U' or 'I'"),
        ("a.pcd", cut(TEXT_PCD, b"COUNT 1 1 1", b"COUNT 1 1 9"), "columns"),
        ("a.pcd", cut(PCD, b"COUNT 1 1 1", b"COUNT 1 1 999999999"), "more values of a point"),
        ("a.pcd", cut(PCD, b"POINTS 50", b"POINTS 49"), "49 were announced, 50 times 1 in a grid"),
        ("a.pcd", cut(PCD, b"POINTS 50", b"").replace(b"WIDTH 50", b""), "points"),
        ("a.pcd", PCD[:-12], "49 points where 50 were announced"),
        ("a.pcd", TEXT_PCD + b"1 2 3\n", "51 points where 50 were announced"),
        ("a.pcd", PACKED[:-1], "."),
    ],
)
def test_damaged_files_are_refused_by_name(tmp_path, name, data, words):
    path = tmp_path / name
    path.write_bytes(data)
    kind = name[2:].upper()
    refuses(
        DataError, rf"(?s){name}: expected a readable {kind} file, found.*({words})", read_map, path
    )


@pytest.mark.parametrize("height", [0.0, 1.0, 9.0])
def test_a_surface_whose_y_is_upward_is_refused(tmp_path, height):
    (x, y, z), path = PLANE.T, tmp_path / "a.ply"
    z = z + height * np.sin(x) * np.cos(y)
    for order, words in (
        ((x, y, z), ""),
        ((x, z, -y), "z is upward, found .*; turn it, with y = -z"),
    ):
        path.write_bytes(ply(np.column_stack(order), "ascii"))
        np.savetxt(tmp_path / "a.xyz", np.column_stack(order))
        if words:
            refuses(DataError, words, read_map, path)
            refuses(DataError, words, read_map, tmp_path / "a.xyz", spacing=1.0)
        else:
            read_map(path)


def test_coordinates_beyond_their_digits_are_refused(tmp_path):
    """A float32 has steps of 0.5 m at 5e6 m; whole numbers are exact."""
    far, path, coarse = np.array([5e5, 5e6, 0]), tmp_path / "a.ply", "single precision, a multiple"
    for points, real, words in (
        (PLANE * 1e30, "double", "found coordinates that exceed"),
        (PLANE + far, "double", ""),
        (np.round(PLANE) + far, "float", ""),
        (PLANE + far, "float", rf"found 50000\d+(\.5)? in {coarse} of 0.5; write x and y in"),
    ):
        path.write_bytes(ply(points, "binary_little_endian", real=real))
        if words:
            refuses(DataError, words, read_map, path)
        else:
            assert read_map(path, spacing=1.0).grid.y[-1] == 5000020


def test_a_cloud_with_another_ending_is_named(tmp_path):
    for name, data in (("ply", PLY), ("pcd", PCD)):
        (tmp_path / f"{name}.dat").write_bytes(data)
        refuses(DataError, rf"rename it to end in \.{name}", read_map, tmp_path / f"{name}.dat")
