"""Tests of point clouds in PLY and PCD: encodings, orders, omitted points, damaged files."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.fuzz_maps import pcd, ply
from slipfree.core.errors import DataError
from slipfree.files.maps.elevation import read_map

pytestmark = pytest.mark.usefixtures("direct_reads")
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
    path.write_bytes(ply(PLANE, kind, real=real, newline=newline, faces=3))
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


def test_elements_before_the_vertices_are_skipped(tmp_path):
    for kind in PLY_KINDS:
        (tmp_path / "a.ply").write_bytes(ply(PLANE, kind, before=5))
        heights(tmp_path / "a.ply")


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
    with pytest.raises(
        DataError, match=rf"(?s){name}: expected a readable {kind} file, found.*({words})"
    ):
        read_map(path)


def test_large_coordinates_are_refused(tmp_path):
    (tmp_path / "a.ply").write_bytes(ply(PLANE * 1e30, "ascii", real="double"))
    with pytest.raises(DataError, match="found coordinates that exceed"):
        read_map(tmp_path / "a.ply")


@pytest.mark.parametrize("name", ["a.ply", "a.pcd"])
def test_randomly_damaged_files_are_read_or_refused(tmp_path, name):
    rng, refused, make, kinds = (
        Random(4),
        [],
        *((ply, PLY_KINDS) if "ply" in name else (pcd, PCD_KINDS)),
    )
    path = tmp_path / name
    for k in range(60):
        data = bytearray(make(PLANE[:60], kinds[k % 3]))
        for _ in range(rng.choice([1, 2, 5])):
            data[rng.randrange(200 if rng.random() < 0.7 else len(data))] = rng.randrange(256)
        path.write_bytes(data if rng.random() < 0.8 else data[: rng.randrange(len(data))])
        try:
            read_map(path)
        except DataError as error:
            refused.append(str(error))
    assert len(refused) > 20
    assert all(words.startswith(f"{path}: expected") for words in refused)


def test_a_cloud_with_another_ending_is_named(tmp_path):
    for name, data in (("ply", PLY), ("pcd", PCD)):
        (tmp_path / f"{name}.dat").write_bytes(data)
        with pytest.raises(DataError, match=rf"rename it to end in \.{name}"):
            read_map(tmp_path / f"{name}.dat")
