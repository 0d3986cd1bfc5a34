"""Tests of result files: exact round trip, other readers, and damaged files."""

from __future__ import annotations

import csv
import struct
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray
from scipy.io import netcdf_file

from slipfree.core.errors import DataError, ModelError
from slipfree.core.outcome import Outcome
from slipfree.core.records import Label
from slipfree.core.trajectory import Column, Stop, Trajectory, thin
from slipfree.files import netcdf

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
        with pytest.raises(
            DataError, match=r"cut\.nc: .* netCDF file that is truncated or damaged"
        ):
            netcdf.read(cut)


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
    with pytest.raises(DataError, match=words):
        netcdf.read(tmp_path / "a.nc")


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
    with pytest.raises(DataError, match="the empty or unlimited dimension 'time'"):
        netcdf.read(path)
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
        with pytest.raises(DataError, match=words):
            netcdf.read(path)


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
    assert {outcome.name: outcome.exit_code for outcome in Outcome if outcome.exit_code != 1} == {
        "COMPLETE": 0,
        "INTERRUPTED": 130,
    }


def test_unknown_outcomes_are_refused(outcome_files: list[Path]) -> None:
    data = outcome_files[1].read_bytes()
    assert b"limit\0\0\0" in data
    outcome_files[1].write_bytes(data.replace(b"limit\0\0\0", b"limbo\0\0\0"))
    with pytest.raises(DataError, match="the unknown outcome 'limbo'"):
        netcdf.read(outcome_files[1])


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
