"""Tests of result files: exact round trip, metadata, other readers, exports, and damaged files."""

import csv
import json
import struct
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray
from numpy.testing import assert_allclose
from rasterio.crs import CRS
from scipy.io import netcdf_file

from helpers.commands import refuses
from helpers.rasters import from_origin, geotiff
from slipfree.core.errors import DataError, ModelError
from slipfree.core.records import Label
from slipfree.core.trajectory import Column, Outcome, Stop, Trajectory, thin
from slipfree.files import netcdf
from slipfree.files.netcdf import export_path, export_rates, grid_mapping
from slipfree.problem.load import load_problem
from slipfree.problem.result import run_problem

N = 7


@pytest.fixture
def motion(rng):
    columns = {
        "x": Column(Label("x", "m", "easting of the platform's centre"), rng.normal(size=N)),
        "slip": Column(Label("slip", "m s-1", "slip of the wheel"), rng.normal(size=(N, 3))),
        "pitch": Column(Label("pitch", "rad", "Nickwinkel, größer = höher"), rng.normal(size=N)),
    }
    columns["pitch"].values[3] = np.nan
    return Trajectory(
        np.linspace(0.0, 1.0 / 3.0, N),
        columns,
        ("right", "left", "front"),
        Stop("map_margin[front]", 1.0 / 3.0, "wheel front leaves — das Ende", Outcome.LIMIT),
        {"steps": 12.0, "tolerance": 1e-8},
        {"title": "Übung", "problem": 'verb = "direct"\n# 中文 ü\n', "remark": ""},
    )


def _assert_same(found, motion):
    np.testing.assert_array_equal(found.t, motion.t)
    assert list(found.columns) == list(motion.columns)
    for name, column in motion.columns.items():
        assert found.columns[name].label == column.label
        np.testing.assert_array_equal(found[name], column.values)
        assert found[name].dtype == np.float64
    assert found.wheels == motion.wheels
    assert found.stop == motion.stop
    assert found.statistics == motion.statistics


def test_round_trip_is_exact(motion, tmp_path):
    netcdf.write(tmp_path / "a.nc", motion)
    found = netcdf.read(tmp_path / "a.nc")
    _assert_same(found, motion)
    assert found.attributes.items() >= motion.attributes.items()
    netcdf.write(tmp_path / "b.nc", found)
    again = netcdf.read(tmp_path / "b.nc")
    _assert_same(again, motion)
    assert again.attributes == found.attributes
    assert [p.name for p in sorted(tmp_path.iterdir())] == ["a.nc", "b.nc"]


def test_round_trip_without_wheels_and_stop(motion, tmp_path):
    columns = {"x": motion.columns["x"]}
    plain = replace(motion, columns=columns, wheels=(), stop=None, statistics={}, attributes={})
    netcdf.write(tmp_path / "a.nc", plain)
    _assert_same(netcdf.read(tmp_path / "a.nc"), plain)


def test_provenance(motion, tmp_path):
    netcdf.write(tmp_path / "a.nc", motion)
    found = netcdf.read(tmp_path / "a.nc").attributes
    assert found["numpy_version"] == np.__version__
    assert found["python_version"] == "{}.{}.{}".format(*sys.version_info)
    assert {"slipfree_version", "casadi_version", "scipy_version", "history"} <= set(found)
    assert found["date_created"].endswith("Z")


def test_xarray_opens_it(motion, tmp_path):
    netcdf.write(tmp_path / "a.nc", motion)
    with xarray.open_dataset(tmp_path / "a.nc", engine="scipy") as dated:
        assert np.issubdtype(dated.time.dtype, np.datetime64)
    with xarray.open_dataset(tmp_path / "a.nc", engine="scipy", decode_times=False) as data:
        data.load()
    assert data.sizes == {"time": N, "wheel": 3}
    assert data.time.dtype == np.float64
    assert data.time.attrs["units"] == "seconds since 2000-01-01 00:00:00"
    assert data.time.attrs["standard_name"] == "time"
    assert data.slip.dims == ("wheel", "time")
    assert data.slip.attrs == {"units": "m s-1", "long_name": "slip of the wheel"}
    assert list(data.wheel.values) == ["right", "left", "front"]
    assert data.attrs["Conventions"] == "CF-1.11"
    assert data.attrs["problem"] == motion.attributes["problem"]
    assert data.attrs["statistics_tolerance"] == 1e-8
    assert data.attrs["stop_name"] == "map_margin[front]"
    np.testing.assert_array_equal(data.slip.sel(wheel="left"), motion["slip", "left"])
    same = motion.to_xarray()
    xarray.testing.assert_equal(same, data.transpose("time", "wheel"))
    assert same.time.attrs["units"] == "s"
    for name in ("wheel", "slip"):
        assert same[name].attrs == data[name].attrs
    assert same.attrs == {name: data.attrs[name] for name in same.attrs}
    assert {"stop_name", "stop_time", "statistics_tolerance", "problem"} <= set(same.attrs)


def test_pandas_frame_is_indexed_as_the_motion(motion):
    frame = motion.to_pandas()
    np.testing.assert_array_equal(frame.index, motion.t)
    assert (frame.index.name, frame.columns.names) == ("time", ["quantity", "wheel"])
    np.testing.assert_array_equal(frame["pitch"], motion["pitch"])
    np.testing.assert_array_equal(frame["slip", "left"], motion["slip", "left"])
    np.testing.assert_array_equal(frame["slip"][list(motion.wheels)], motion["slip"])
    assert frame.attrs["units"] == {"x": "m", "slip": "m s-1", "pitch": "rad"}
    assert frame.attrs["long_name"]["slip"] == "slip of the wheel"
    assert frame.attrs["stop_name"] == "map_margin[front]"
    plain = replace(motion, columns={"x": motion.columns["x"]}, wheels=(), stop=None)
    np.testing.assert_array_equal(plain.to_pandas()["x"], motion["x"])
    assert plain.to_xarray().sizes == {"time": N}


def test_csv(motion, tmp_path):
    netcdf.write_csv(tmp_path / "a.csv", motion)
    with (tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    assert head[:3] == ["time", "x", "slip[right]"]
    table = np.array(rows, dtype=float)
    expected = np.column_stack([motion.t, motion["x"], motion["slip"], motion["pitch"]])
    np.testing.assert_array_equal(table, expected)


def test_names_that_cannot_be_used(motion, tmp_path):
    path = tmp_path / "a.nc"
    with pytest.raises(ModelError, match="at least one sample, found none"):
        netcdf.write(path, motion.part(slice(0)))
    column = {"time": Column(Label("time", "s", "another time"), motion.t)}
    with pytest.raises(ModelError, match="reserved in result files, found 'time'"):
        netcdf.write(path, replace(motion, columns=column))
    with pytest.raises(ModelError, match="reserved in result files, found 'statistics_a'"):
        netcdf.write(path, replace(motion, attributes={"statistics_a": "1"}))
    with pytest.raises(ModelError, match="does not use, found 'variables'"):
        netcdf.write(path, replace(motion, attributes={"variables": "1"}))
    assert not list(tmp_path.iterdir())


def test_every_truncation_is_found(motion, tmp_path):
    netcdf.write(tmp_path / "a.nc", motion)
    data, cut = (tmp_path / "a.nc").read_bytes(), tmp_path / "cut.nc"
    for size in range(len(data)):
        cut.write_bytes(data[:size])
        refuses(
            DataError, r"cut\.nc: .* netCDF file that is truncated or damaged", netcdf.read, cut
        )


@pytest.mark.parametrize(
    ("head", "words"),
    [
        (b"verb = 1", "found a file that is not netCDF"),
        (b"\x89HDF\r\n\x1a\n", "a format other than netCDF-3; convert it: nccopy"),
        (b"CDF\x05" + bytes(40), "a format other than netCDF-3; convert it: nccopy"),
    ],
)
def test_other_files(head, words, tmp_path):
    (tmp_path / "a.nc").write_bytes(head)
    refuses(DataError, words, netcdf.read, tmp_path / "a.nc")


def _foreign(path, **attributes):
    with netcdf_file(str(path), "w") as file:
        for name, value in attributes.items():
            setattr(file, name, value)
        file.createDimension("time", None)
        file.createVariable("time", "f8", ("time",))[:] = np.arange(3.0)
        file.createDimension("level", 2)
        file.createVariable("level", "i4", ("level",))[:] = [1, 2]
    return path


def test_a_foreign_netcdf_file(tmp_path):
    with pytest.raises(DataError, match="a netCDF file of another program; give a file that"):
        netcdf.read(_foreign(tmp_path / "a.nc"))


def test_a_file_changed_by_others(motion, tmp_path):
    path = _foreign(tmp_path / "a.nc", slipfree_version=b"0.2.0")
    refuses(DataError, "the empty or unlimited dimension 'time'", netcdf.read, path)
    netcdf.write(path, motion)
    data = path.read_bytes()
    for old, new, words in [
        (b"units", b"unite", "without the attribute 'units'"),
        (b"\0\0\0\4time\0\0", b"\0\0\0\4tine\0\0", "found no variable 'time'"),
        (b"x slip pitch", b"x slip patch", "found no variable 'patch'"),
        (struct.pack(">II", 11, 5), struct.pack(">II", 13, 5), "truncated or damaged"),
    ]:
        assert old in data
        path.write_bytes(data.replace(old, new))
        refuses(DataError, words, netcdf.read, path)


@pytest.mark.slow
def test_any_damaged_byte_of_the_header_gives_no_other_error(motion, tmp_path):
    path = tmp_path / "a.nc"
    netcdf.write(path, motion)
    data = path.read_bytes()
    for at in range(len(data) - 8 * N * 6):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x5A]) + data[at + 1 :])
        try:
            netcdf.read(path)
        except DataError:
            continue


@pytest.fixture
def outcome_files(tmp_path: Path) -> list[Path]:
    """Return a result for each outcome."""
    x = {"x": Column(Label("x", "m", "position"), np.zeros(2))}
    motions = [
        Trajectory(np.arange(2.0), x, stop=Stop("a", 1.0, "b", outcome)) for outcome in Outcome
    ]
    for outcome, motion in zip(Outcome, motions, strict=True):
        netcdf.write(tmp_path / f"{outcome.name}.nc", motion)
    return [tmp_path / f"{outcome.name}.nc" for outcome in Outcome]


def test_outcomes_are_stored(outcome_files: list[Path]) -> None:
    assert [netcdf.read(file).outcome for file in outcome_files] == list(Outcome)
    codes = {outcome.name: outcome.exit_code for outcome in Outcome if outcome.exit_code != 1}
    assert codes == {"COMPLETE": 0, "INTERRUPTED": 130}


def test_unknown_outcomes_are_refused(outcome_files: list[Path]) -> None:
    data = outcome_files[1].read_bytes()
    assert b"limit\0\0\0" in data
    outcome_files[1].write_bytes(data.replace(b"limit\0\0\0", b"limbo\0\0\0"))
    refuses(DataError, "the unknown outcome 'limbo'", netcdf.read, outcome_files[1])


def test_quantities_read_one_by_one_are_the_same(tmp_path, motion):
    path = tmp_path / "a.nc"
    netcdf.write(path, motion)
    found = netcdf.read(path, lazy=True)
    _assert_same(found, motion)
    netcdf.write(path, motion.part(slice(1)))  # another file of that name
    _assert_same(found, motion)
    with pytest.raises(KeyError):
        found.columns["other"]


def test_fewer_samples_keep_all_extremes(rng):
    values = rng.normal(size=(2000, 2))
    values[:10] = np.nan
    columns = {
        "x": Column(Label("x", "m", "x"), rng.normal(size=2000)),
        "slip": Column(Label("slip", "m s-1", "slip"), values),
        "unknown": Column(Label("unknown", "1", "unknown"), np.full(2000, np.nan)),
    }
    run = Trajectory(np.arange(2000.0), columns, ("left", "right"))
    few = thin(run, 50)
    assert 50 <= few.t.size <= 56
    assert few.t[[0, -1]].tolist() == [0, 1999]
    for name in ("x", "slip"):
        for end in (np.nanmin, np.nanmax):
            np.testing.assert_array_equal(end(few[name], axis=0), end(run[name], axis=0))
    np.testing.assert_array_equal(few["slip"], values[few.t.astype(int)])
    assert thin(run, 2000) is run


# The CF metadata of result files: feature type, position on the map, reference system


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


# Exports: paths in the coordinates of their map, and rates for a robot

PROBLEM = """\
verb = "direct"
vehicle.catalog = "three_wheeler"
start = {{ x = {x}, y = {y}, heading = 0.3 }}
inputs = {{ right_rate = [[0, 0.5], [0.5, 0.4]], left_rate = 0.4, steer_rate = 0.01 }}
time = {{ duration = 1, step = 0.25 }}
[terrain]
file = "map.tif"
{terrain}
"""


def _solved(folder, crs, transform, **asked):
    """Solve a problem on a GeoTIFF of a plane, write its result, and return it."""
    rows = 100 + 0.1 * np.arange(40.0)[:, None] + np.zeros(40)
    geotiff(folder / "map.tif", rows, transform, crs=crs, dtype="float64")
    (folder / "p.toml").write_text(PROBLEM.format(**asked))
    found = run_problem(load_problem(folder / "p.toml")).trajectory
    netcdf.write(folder / "out.nc", found)
    return found


def _rows(path):
    with path.open() as file:
        head, *rows = csv.reader(file)
    return head, np.array(rows, dtype=float)


def _path(folder):
    export_path(folder / "out.nc", folder / "path.csv")
    return _rows(folder / "path.csv")


def _geojson(folder):
    export_path(folder / "out.nc", folder / "path.geojson")
    return json.loads((folder / "path.geojson").read_text())


def _utm(folder, terrain="", x=500010.0, y=4499990.0):
    place = from_origin(500000, 4.5e6, 0.5)
    return _solved(folder, "EPSG:32633", place, terrain=terrain, x=x, y=y)


def test_a_path_on_a_projected_map(tmp_path):
    found = _utm(tmp_path)
    assert found.attributes["map_crs"] == "EPSG:32633"
    assert "pixel is area" in found.attributes["ground_map"]
    head, rows = _path(tmp_path)
    assert head == ["time", "x", "y", "z", "heading", "pitch", "roll", "yaw"]
    names = ("x", "y", "z", "heading", "pitch", "roll", "yaw")
    assert_allclose(rows, np.column_stack([found.t, *(found[name] for name in names)]), rtol=1e-15)

    content = _geojson(tmp_path)
    assert content["crs"] == {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32633"}}
    (feature,) = content["features"]
    assert feature["geometry"]["type"] == "LineString"
    assert_allclose(feature["geometry"]["coordinates"], rows[:, 1:4], rtol=1e-15)
    assert feature["properties"]["time_s"] == found.t.tolist()


def test_a_path_on_a_scaled_map_is_where_the_file_says(tmp_path):
    terrain = "scale = 0.5\nvertical_scale = 1.5"
    small = _utm(tmp_path, terrain, 250005.0, 2249995.0)
    _, rows = _path(tmp_path)
    assert_allclose(rows[:, 1], 2 * small["x"], rtol=1e-14)
    assert_allclose(rows[:, 3], small["z"] / 0.75, rtol=1e-14)
    assert_allclose(rows[0, 1:3], [500010, 4499990], rtol=1e-14)


def test_a_path_on_a_map_in_degrees(tmp_path):
    step = 1 / 3600 / 64  # half a metre
    place = from_origin(15, 47, step)
    found = _solved(tmp_path, "EPSG:4326", place, terrain='geographic = "local"', x=5.0, y=10.0)
    assert "treated as a sphere" in found.attributes["ground_degrees"]
    head, rows = _path(tmp_path)
    assert head[1:4] == ["longitude", "latitude", "z"]
    # The origin is the middle of the south-western cell; a degree of the sphere is 111195.08 m.
    assert_allclose(rows[:, 2], 47 - 39.5 * step + found["y"] / 111195.08, rtol=0, atol=1e-11)
    east = found["x"] / (111195.08 * np.cos(np.deg2rad(47 - 20 * step)))
    assert_allclose(rows[:, 1], 15 + 0.5 * step + east, rtol=0, atol=1e-11)
    content = _geojson(tmp_path)
    assert "crs" not in content  # GeoJSON means WGS 84 then
    assert_allclose(content["features"][0]["geometry"]["coordinates"], rows[:, 1:4], rtol=1e-15)


def test_rates_that_a_robot_plays(tmp_path):
    found = _utm(tmp_path)
    export_rates(tmp_path / "out.nc", tmp_path / "rates.csv")
    head, rows = _rows(tmp_path / "rates.csv")
    assert head == ["time", "right_rate", "left_rate", "steer_rate"]
    assert_allclose(rows[:, 0], found.t)
    assert set(rows[:, 1]) == {0.5, 0.4}
    assert set(rows[:, 3]) == {0.01}


def test_what_cannot_be_exported(tmp_path):
    found = _utm(tmp_path)
    out = tmp_path / "out.nc"
    for name, words in (
        ("path.kml", r"path.kml: expected a name that ends in .csv or .geojson, found '.kml'"),
        ("path", "found no ending"),
        ("none/path.csv", r"path.csv: cannot be written \(No such file"),
    ):
        refuses(DataError, words, export_path, out, tmp_path / name)
    with pytest.raises(DataError, match=r"ends in .csv, found '.geojson'"):
        export_rates(out, tmp_path / "rates.geojson")
    assert {each.name for each in tmp_path.iterdir()} == {"map.tif", "p.toml", "out.nc"}
    taken = tmp_path / "out.csv"
    out.rename(taken)
    refuses(DataError, "expected a separate file, found the result file", export_path, taken, taken)

    netcdf.write(out, replace(found, columns={"x": found.columns["x"]}))
    with pytest.raises(DataError, match="expected rates of driven wheels or"):
        export_rates(out, tmp_path / "rates.csv")
    with pytest.raises(DataError, match=r"expected a motion with .*, found no 'y'"):
        export_path(out, tmp_path / "path.csv")
    netcdf.write(out, found.part(slice(1)))
    with pytest.raises(DataError, match="at least two samples for a LineString, found one"):
        export_path(out, tmp_path / "path.geojson")
    damaged = {**found.attributes, "map_transform": "[[1]]"}
    with pytest.raises(DataError, match="expected rows of name, offset, factor and axis as JSON"):
        netcdf.write(out, replace(found, attributes=damaged))
    del damaged["map_crs"]
    netcdf.write(out, replace(found, attributes=damaged))
    with pytest.raises(DataError, match="expected rows of name, offset, factor and axis as JSON"):
        export_path(out, tmp_path / "path.geojson")


def test_without_a_reference_system_geojson_says_so(tmp_path):
    found = _utm(tmp_path)
    attributes = {k: v for k, v in found.attributes.items() if k != "map_crs"}
    netcdf.write(tmp_path / "out.nc", replace(found, attributes=attributes))
    content = _geojson(tmp_path)
    assert "crs" not in content
    assert content["features"][0]["properties"]["reference_system"].startswith("not given")
