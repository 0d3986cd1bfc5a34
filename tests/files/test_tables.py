"""Tests of tables in text files: every layout of the same numbers is the same table."""

import gzip

import numpy as np
import pytest

from helpers.commands import refuses
from slipfree.core.errors import DataError
from slipfree.core.records import Label
from slipfree.core.trajectory import Column, Trajectory
from slipfree.files.netcdf import write_csv
from slipfree.files.tables import read_columns, read_names

ROWS = np.array([[0.0, 1.5, -2.0], [0.5, 2.25, 1e3], [1.0, 3.0, 0.125]])


def _read(folder, text, columns=("t", "x", "heading")):
    path = folder / "a.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_columns(path, columns)  # type: ignore[arg-type]


def _text(separator=",", head="t,x,heading", factors=1.0):
    lines = [separator.join(map(repr, row)) for row in (ROWS / factors).tolist()]  # type: ignore[operator]
    return "\n".join([*([head.replace(",", separator)] if head else []), *lines, ""])


def _timed(*stamps, head="t"):
    """Return the table with other stamps in the place of its times."""
    text = _text(head=f"{head},x,heading")
    for time, stamp in zip(ROWS[:, 0].tolist(), stamps, strict=True):
        text = text.replace(f"\n{time}", f"\n{stamp}")
    return text


def test_a_result_is_a_path(tmp_path):
    """Its columns are found by name, ``time`` as ``t``, and others are skipped."""
    t = np.linspace(0, 1, 9001)  # more than a block
    columns = {
        name: Column(Label(name, "m", name), values)
        for name, values in {"y": t**2, "slip": np.ones((t.size, 2)), "x": 3 * t}.items()
    }
    write_csv(tmp_path / "run.csv", Trajectory(t, columns, ("left", "right")))
    assert (tmp_path / "run.csv").read_text().startswith("time,y,slip[left],slip[right],x\n0.0,")
    found = np.array(read_columns(tmp_path / "run.csv", ("t", "x", "y")).rows())
    np.testing.assert_array_equal(found, np.stack([t, 3 * t, t**2], axis=1))


DECIMAL_COMMAS = {
    f"decimal commas and {separator!r}": _text(separator).replace(".", ",")
    for separator in (";", "\t", " ", "|")
}
LAYOUTS = {
    **{
        f"separator {separator!r}": _text(separator)
        for separator in (",", ";", "\t", " ", "|", ", ", " ,\t")
    },
    **DECIMAL_COMMAS,
    "no names": _text(head=""),
    "names in a comment": _text(" ", "# t,x,heading"),
    "names in a comment of MATLAB": _text(head="%time,x,yaw"),
    "names of others": _text("\t", "Time (s),X [m],Yaw (rad)"),
    "quotes": '"' + _text('","').strip().replace("\n", '"\n"') + '"\n',
    "carriage returns": _text().replace("\n", "\r\n"),
    "byte order mark": b"\xef\xbb\xbf" + _text().encode(),
    "UTF-16": _text(";").encode("utf-16"),
    "separators at line ends": _text(";").replace("\n", ";\n"),
    "names repeated, empty lines": _text().replace("0.5,", "t,x,heading\n\n0.5,"),
    "comments": f"// a\n% b\n; c\n# d\n{_text()}# e\n",
    "title above the names": "Measured on Tuesday\n\n" + _text(";"),
    "line of units": _text(head="t,x,heading\ns,m,rad"),
    "further columns": "id," + _text().replace("\n", ",stone\na,").removesuffix("a,"),
    "milliseconds and degrees": _text(";", "t_ms,x [mm],yaw_mrad", [1e-3, 1e-3, 1e-3]).encode(
        "latin-1"
    ),
    "dates": _timed("2026-03-01 12:00:00", "2026-03-01T12:00:00.5", "2026-03-01T12:00:01Z"),
    "times of day over midnight": _timed("23:59:59.5", "00:00:00", "00:00:00.500"),
    "minutes and seconds": _timed("01:59.5", "02:00.0", "02:00.5"),
    "seconds and nanoseconds": _timed(
        *("1700000000,0", "1700000000,500000000", "1700000001,0"), head="stamp.sec,stamp.nanosec"
    ),
    "nanoseconds since 1970": _timed(
        *(f"17000000{each}00000000" for each in ("000", "005", "010")), head="stamp [ns]"
    ),
}


@pytest.mark.parametrize("text", LAYOUTS.values(), ids=LAYOUTS)
def test_layouts_of_one_table(tmp_path, text):
    found = _read(tmp_path, text)
    np.testing.assert_allclose(np.array(found.rows()), ROWS, rtol=1e-14, atol=1e-12)
    has_units = b"mm" in (tmp_path / "a.csv").read_bytes()
    assert any("converted from ms to s" in note for note in found.notes) == has_units


def test_columns_named_by_the_user(tmp_path):
    """A name may have the unit of the column; numbers count columns without names."""
    found = _read(
        tmp_path, "stamp,yaw\n0,180\n500,90\n", {"t": "stamp [ms]", "heading": "yaw [deg]"}
    )
    np.testing.assert_allclose(found.rows(), [(0, np.pi), (0.5, np.pi / 2)])
    assert _read(tmp_path, "0;7;8\n1;9;8\n", {"t": "1", "x": "2"}).rows() == [(0, 7), (1, 9)]
    (tmp_path / "a.csv").write_text("time_ms;v_x [mm/s]\n0;1\n")
    assert read_names(tmp_path / "a.csv", "commands") == ["t", "v_x"]


@pytest.mark.parametrize("row", ["1,2", "1,2,3,4", "1,2,x", "1,2,nan", "1,2,"])
def test_rows_as_long_as_the_first_line(tmp_path, row):
    words = "a.csv:3: expected 3 values as in the first row, with numbers for x,y, found '1,2"
    refuses(DataError, words, _read, tmp_path, f"y,other,x\n0,0,0\n{row}\n", "xy")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t,x\n0,1\n", "expected the columns t, x, heading, found no column 'heading' among t, x;"),
        ("t,x [deg],yaw\n0,1,2\n", "values in m in the column 'x .deg.', found deg; project"),
        ("a.sec,a.nsec,b.sec,b.nsec,x,yaw\n1,2,3,4,0,0\n", "no column 't' among a.sec, a"),
        ("a,b,c\n0,1,2\n", "no column 'x', no column 'heading' among a, b, c"),
        ("t,x,yaw\n1,1,1\n2.500,0.000,\n", ":3: expected .* found '2.500,0.000,'; correct or"),
        ("t,X [in],yaw\n0,1,2\n", "no column 'x' .the unit of 'X .in.' is unknown: convert it"),
        ("x,t,x,yaw\n0,1,2,3\n", "found 2 columns 'x' among x, t, x, yaw; name the columns in"),
        ("1.234,5;2,5;3\n1.234,5;2,5;3\n", ":1: expected .* found '1.234,5;2,5;3'"),
        ("1.5;2,5;3\n", ":1: expected one decimal sign, found '1.5;2,5;3'; write all numbers"),
        ("0.5;0;0\n" * 300 + "0.5;1,000;0\n", ":301: expected one decimal sign, found '0.5;1,0"),
        ("t,x,yaw\n17e17,0,0\n17.1e17,0,0\n", r"up to 1.71e\+18 .*nanoseconds; name it 't \[ns\]'"),
        ("t,x,yaw\n0,1,5,0,5,1\n1,5,2,5,2,5\n", ":2: .* probably decimals of numbers; write deci"),
        ("t,x,yaw\n1:00:00 AM,0,0\n", ":2: .* found '1:00:00 AM,0,0'; write dates as in 2026"),
        (gzip.compress(b"t,x,yaw\n", mtime=0), "found a gzip file; unpack it: gunzip a.csv"),
        (b"#ROSBAG V2.0\n", "found a bag of ROS 1; convert it to MCAP: rosbags-convert --src a.cs"),
        (b"\x00\x01\x02", "expected way-points as text, found binary data; write its columns"),
    ],
)
def test_tables_refused(tmp_path, text, words):
    refuses(DataError, words, _read, tmp_path, text)
