"""Tests of the CF metadata of result files: feature type, position on the map, reference system."""

from __future__ import annotations

import numpy as np
import pytest
from rasterio.crs import CRS
from scipy.io import netcdf_file

from slipfree.core.errors import DataError
from slipfree.core.records import Label
from slipfree.core.trajectory import Column, Trajectory
from slipfree.files import netcdf
from slipfree.files.cf import grid_mapping


def _motion(**attributes):
    rng = np.random.default_rng(0)
    columns = {n: Column(Label(n, "m", n), rng.random(4)) for n in ("x", "y", "z", "pitch")}
    columns["slip"] = Column(Label("slip", "m s-1", "slip"), rng.random((4, 2)))
    return Trajectory(np.arange(4.0), columns, ("a", "b"), attributes=attributes)


def _written(run, path):
    """Return the attributes of the variables of a written motion, and its own under ''."""
    netcdf.write(path, run)
    with netcdf_file(str(path), mmap=False) as file:
        assert file.variables["slip"].dimensions == ("wheel", "time")
        return {n: v._attributes for n, v in file.variables.items()} | {"": file._attributes}


def test_a_motion_without_a_map_is_a_trajectory_over_x_y_z(tmp_path):
    found = _written(_motion(), tmp_path / "a.nc")
    assert found[""]["featureType"] == b"trajectory"
    assert found["trajectory"]["cf_role"] == b"trajectory_id"
    assert found["slip"]["coordinates"] == b"time x y z"
    assert found["pitch"]["standard_name"] == b"platform_pitch_fore_up"
    assert "crs" not in found
    assert "grid_mapping" not in found["slip"]
    run = netcdf.read(tmp_path / "a.nc")
    assert list(run.columns) == ["x", "y", "z", "pitch", "slip"]
    np.testing.assert_array_equal(run["slip"], _motion()["slip"])


def test_a_motion_on_a_map_has_its_reference_system(tmp_path):
    rows = '[["x", 5e5, 2, "y"], ["y", 4e6, -1, "x"], ["z", 0, 1, "z"]]'
    run = _motion(map_crs="EPSG:32633", map_transform=rows)
    found = _written(run, tmp_path / "a.nc")
    assert found["slip"]["coordinates"] == b"time map_x map_y z"
    assert found["slip"]["grid_mapping"] == b"crs"
    assert found["map_x"]["standard_name"] == b"projection_x_coordinate"
    assert CRS.from_wkt(found["crs"]["spatial_ref"].decode()) == CRS.from_epsg(32633)
    assert CRS.from_wkt(found["crs"]["crs_wkt"].decode()) == CRS.from_epsg(32633)
    with netcdf_file(str(tmp_path / "a.nc"), mmap=False) as file:
        np.testing.assert_array_equal(file.variables["map_x"][:], 5e5 + 2 * run["y"])
        np.testing.assert_array_equal(file.variables["map_y"][:], 4e6 - run["x"])
    assert list(netcdf.read(tmp_path / "a.nc").columns) == [*run.columns]


def test_a_motion_on_a_map_in_degrees(tmp_path):
    rows = '[["longitude", 15, 1e-5, "x"], ["latitude", 47, 1e-5, "y"], ["z", 0, 1, "z"]]'
    found = _written(_motion(map_crs="EPSG:4326", map_transform=rows), tmp_path / "a.nc")
    assert found["crs"]["grid_mapping_name"] == b"latitude_longitude"
    assert found["longitude"]["units"] == b"degrees_east"
    assert found["pitch"]["coordinates"] == b"time longitude latitude z"


PROJECTIONS = {
    32633: {
        "grid_mapping_name": "transverse_mercator",
        "latitude_of_projection_origin": 0, "longitude_of_central_meridian": 15,
        "scale_factor_at_central_meridian": 0.9996, "false_easting": 500000, "false_northing": 0,
    },
    2154: {
        "grid_mapping_name": "lambert_conformal_conic", "standard_parallel": (49, 44),
        "latitude_of_projection_origin": 46.5, "longitude_of_central_meridian": 3,
        "false_easting": 700000, "false_northing": 6600000,
    },
    3857: {},  # the conventions have no name for it: WKT alone
}  # fmt: skip


@pytest.mark.parametrize(("code", "expected"), PROJECTIONS.items())
def test_projections_have_the_names_of_the_conventions(code, expected):
    found = grid_mapping(f"EPSG:{code}")
    assert {k: found.get(k) for k in expected} == expected
    assert ("grid_mapping_name" in found) == bool(expected)


def test_an_unknown_reference_system(tmp_path):
    with pytest.raises(DataError, match="expected an EPSG code or WKT, found 'EPSG:0'"):
        netcdf.write(tmp_path / "a.nc", _motion(map_crs="EPSG:0"))
