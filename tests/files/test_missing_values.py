"""Undeclared markers of missing heights are refused with a remedy that works; no honest map is."""

from __future__ import annotations

import numpy as np
import pytest
import rasterio
import scipy

from helpers.rasters import from_origin, geotiff
from slipfree import DataError
from slipfree.files.maps import missing_values
from slipfree.files.maps.elevation import jacksboro, read_map

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
    monkeypatch.setattr(missing_values, "MAX_SORTED", 100)
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
