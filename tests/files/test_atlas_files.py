"""Tests of mobility maps in GeoTIFF and netCDF: place, orientation, units and reasons."""

import numpy as np
import pytest
import rasterio
import xarray

from helpers.commands import refuses
from slipfree import Bicubic, DataError, Grid, catalog, direct_kinematics
from slipfree.atlas.atlas import SLIDES, UNDECIDED, Atlas, Band, atlas, verdicts
from slipfree.core.records import Label
from slipfree.files.atlas_files import Site, open_atlas, tiles_in, write_atlas, write_geotiff
from slipfree.files.netcdf import MapCoordinate

X, Y = np.linspace(0.0, 18.0, 19), np.linspace(0.0, 12.0, 13)
UTM = "EPSG:32633"


def ridge():
    """Return a ground with a ridge in its north-eastern quadrant."""
    x, y = X[:, None], Y[None, :]
    return Grid(X, Y, 1.5 * np.exp(-((x - 14) ** 2 + (y - 9) ** 2) / 4))


@pytest.fixture(scope="module")
def poses():
    model = direct_kinematics(catalog.three_wheeler(), Bicubic(ridge(), mu=0.4))
    return atlas(model, headings=4, compiled=False)


@pytest.fixture(scope="module")
def site():
    place = (MapCoordinate("x", 500_000.0, 2.0, "x"), MapCoordinate("y", 5e6, 2.0, "y"))
    return Site(ridge().z, 0.4, {"roll": (-0.5, 0.5)}, "rep103", place, UTM, {"title": "Ridge"})


def test_geotiff_is_in_the_place_of_the_map(tmp_path, poses, site):
    write_geotiff(tmp_path / "a.tif", X, Y, site, tiles_in(poses))
    with rasterio.open(tmp_path / "a.tif") as file:
        assert file.crs == rasterio.crs.CRS.from_user_input(UTM)
        assert np.isnan(file.nodata)
        assert file.tags()["AREA_OR_POINT"] == "Point"
        assert file.tags()["title"] == "Ridge"
        assert file.tags()["frame"] == "rep103"
        names = {text.split(" [")[0]: k for k, text in enumerate(file.descriptions, 1)}
        heights = file.read(names["elevation"])
        row, column = np.unravel_index(heights.argmax(), heights.shape)
        assert row < file.height / 2 < file.width / 2 < column  # north-east
        assert file.xy(row, column) == (500_028.0, 5_000_018.0)  # the node (14, 9), scaled by 2
        assert file.units[names["roll_largest"] - 1] == "rad"
        assert file.units[names["heading_worst"] - 1] == "degree"
        expected = np.abs(poses["roll"])[:, 12, 8].max()
        (value,) = file.sample([(500_024.0, 5_000_016.0)], names["roll_largest"])
        assert value[0] == pytest.approx(expected, rel=1e-6)
        assert np.isnan(file.read(names["roll_largest"])[0, 0])  # the corner of the map
        share = file.read(names["share_allowed"])
        assert share[-3, 3] == 1  # level ground in the south-west
        assert share[4, 12] < 1  # the slope of the ridge
        meanings = file.tags(names["limit"])["long_name"]
        assert SLIDES in meanings
        assert "roll is not within its bounds" in meanings


@pytest.mark.parametrize(("frame", "axis", "turn"), [("paper", "y", 0), ("rep103", "x", 90)])
def test_headings_of_both_files_are_in_the_frame(tmp_path, poses, site, frame, axis, turn):
    site = site._replace(frame=frame)
    write_atlas(tmp_path / "a.nc", poses, site)
    write_geotiff(tmp_path / "a.tif", X, Y, site, tiles_in(poses))
    words = f"counter-clockwise angle of the forward axis from the {axis} axis"
    with xarray.open_dataset(tmp_path / "a.nc", engine="scipy") as found:
        assert found.attrs["frame"] == frame
        assert found["heading"].attrs["long_name"] == words
        np.testing.assert_allclose(np.rad2deg(found["heading"] - poses.heading), turn)
        best = found["heading"][poses["least_friction_high"][:, 12, 8].argmin()].item()
    with rasterio.open(tmp_path / "a.tif") as file:
        assert file.tags()["frame"] == frame
        (k,) = (k for k, text in enumerate(file.descriptions, 1) if text.startswith("heading_best"))
        assert file.tags(k)["long_name"].endswith(words)
        assert file.read(k)[4, 12] == pytest.approx(np.rad2deg(best) % 360)


def test_equal_maps_give_equal_files(tmp_path, poses, site):
    for name in ("a.tif", "b.tif"):
        write_geotiff(tmp_path / name, X, Y, site, tiles_in(poses))
    for name in ("a.nc", "b.nc"):
        write_atlas(tmp_path / name, poses, site)
    for end in ("tif", "nc"):
        first, second = ((tmp_path / f"{name}.{end}").read_bytes() for name in "ab")
        assert first == second


def test_netcdf_reads_back(tmp_path, poses, site):
    write_atlas(tmp_path / "a.nc", poses, site)
    again, ground = open_atlas(tmp_path / "a.nc")
    for name in ("x", "y"):
        np.testing.assert_array_equal(getattr(again, name), getattr(poses, name))
    np.testing.assert_allclose(again.heading, poses.heading, rtol=0, atol=4 * np.spacing(np.pi))
    assert again.reasons == poses.reasons
    assert list(again.bands) == list(poses.bands)
    for name, band in poses.bands.items():
        assert again.bands[name].label == band.label
        np.testing.assert_array_equal(again[name], band.values)
    np.testing.assert_array_equal(ground.elevation, site.elevation)
    assert ground[1:6] == site[1:6]


def test_xarray_knows_the_axes(tmp_path, poses, site):
    write_atlas(tmp_path / "a.nc", poses, site)
    with xarray.open_dataset(tmp_path / "a.nc", engine="scipy") as found:
        assert found["roll"].dims == ("heading", "y", "x")
        assert found["roll"].attrs["units"] == "rad"
        assert found["map_x"].attrs["standard_name"] == "projection_x_coordinate"
        assert found["map_x"].values[14] == 500_028.0
        flags = found["reason"].attrs
        assert len(flags["flag_meanings"].split()) == len(flags["flag_values"])


@pytest.mark.parametrize("damage", ["reasons", "bands"])
def test_a_damaged_file_is_an_error(tmp_path, poses, site, damage):
    file = tmp_path / "a.nc"
    write_atlas(file, poses, site)
    file.write_bytes(file.read_bytes().replace(damage.encode(), b"_" * len(damage)))
    refuses(DataError, "expected a result file of slipfree", open_atlas, file)


def test_verdicts_have_three_values():
    """Held, proved not to be held, and undecided; in this order of reasons."""
    reason, low, high = np.zeros((4, 1, 1)), [0.1, 0.5, 0.7, 0.1], [0.2, 0.7, 0.8, 0.2]
    reason[3] = 1
    columns = {"reason": reason}
    for name, values in (("low", low), ("high", high)):
        columns[f"least_friction_{name}"] = np.reshape(values, (4, 1, 1))
    bands = {name: Band(Label(name, "1", ""), values) for name, values in columns.items()}
    poses = Atlas(np.zeros(1), np.zeros(1), np.arange(4.0), bands, ("stands", "falls"))
    found = verdicts(poses, friction=0.6, within={})
    reasons = [found.reasons[code] for code in found.codes.ravel()]
    assert reasons == ["stands", UNDECIDED, SLIDES, "falls"]
    assert found.allowed == 0.25
    assert found.reasons[found.limit.item()] == "falls"  # the first of equally frequent ones
