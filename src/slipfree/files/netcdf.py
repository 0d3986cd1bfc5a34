r"""Results on disk: netCDF with CF metadata, and CSV.

A result file is netCDF-3 (64-bit offsets), which xarray, MATLAB, R, Julia, Panoply and ncdump open
without further ado. It has the dimensions ``time`` and ``wheel``, one variable for each quantity
with ``units`` and ``long_name``, and global attributes that say where it comes from: versions,
date, the whole problem file, and why the motion ended if it ended early. Attributes are UTF-8; a
byte of a file name that is not, such as 0xff, is written as ``\udcff``.
"""

from __future__ import annotations

import csv
import math
import os
import platform
import struct
from collections.abc import Container, Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.io import netcdf_file

from slipfree.atomic_files import replace_file
from slipfree.errors import DataError, ModelError
from slipfree.frames import to_problem_frame
from slipfree.records import Label
from slipfree.regular_files import escape_name, read_bytes
from slipfree.trajectory import STATISTICS, STOP, TIME, WHEELS, Column, Stop, Trajectory
from slipfree.version import __version__

CONVENTIONS = "CF-1.11"
ORIGIN = "slipfree_version"  # the attribute by which a result file is recognised
ORDER = "quantities"  # the attribute with the order of the quantities, which netCDF does not keep
RESERVED = {"time", "wheel", "Conventions", ORDER, *STOP}
REMEDY = "run the problem again to get a whole file"
TYPES = {1: ">i1", 2: "S1", 3: ">i2", 4: ">i4", 5: ">f4", 6: ">f8"}  # of the netCDF standard
TEXT = 2
DIMENSIONS, VARIABLES, ATTRIBUTES = 10, 11, 12  # tags of the lists in a header
LARGEST = 1e100  # number of a motion; beyond, bits were flipped
SIZE = "_size"  # suffix of the dimension of an array that is no sample
NOTHING: Mapping[str, npt.NDArray[Any]] = {}
Attribute = str | float


def write(
    path: str | os.PathLike[str], run: Trajectory, arrays: Mapping[str, npt.NDArray[Any]] = NOTHING
) -> None:
    """Write a trajectory as a netCDF file.

    The file appears under its name when it is complete; until then an existing file of that name
    stays as it is.

    Parameters
    ----------
    path : path
        The file, usually ending in ``.nc``.
    run : Trajectory
        The motion. Versions and date are added to its attributes, unless it has them already
        because it was read from a file.
    arrays : mapping of str to ndarray of shape (n,), optional
        What else to keep, for `read_arrays`: not samples, so each has a dimension of its own.

    Raises
    ------
    ModelError
        If the trajectory is empty, or uses a name that means something else in the file.
    DataError
        If the file cannot be written.
    """
    _check(run)

    def fill(part: Path) -> None:
        with netcdf_file(str(part), "w", version=2) as file:
            _fill(file, run)
            for name, values in arrays.items():
                file.createDimension(f"{name}{SIZE}", values.size)
                file.createVariable(name, "f8", (f"{name}{SIZE}",))[:] = values

    replace_file(Path(path), fill)


def write_csv(path: str | os.PathLike[str], run: Trajectory) -> None:
    """Write a trajectory as a table of comma-separated values, one row a sample.

    The first row names the columns with their units, as in ``slip_along[front] (m s-1)``. Headings
    are in the frame of the problem.

    Raises
    ------
    ModelError
        If the trajectory is empty.
    DataError
        If the file cannot be written.
    """
    _check(run)
    run = to_problem_frame(run)
    names, columns = ["time (s)"], [run.t]
    for name, column in run.columns.items():
        wheels = [""] if column.values.ndim == 1 else [f"[{wheel}]" for wheel in run.wheels]
        names += [f"{name}{wheel} ({column.label.unit})" for wheel in wheels]
        columns += [*np.atleast_2d(column.values.T)]

    def fill(part: Path) -> None:
        with part.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(names)
            writer.writerows(zip(*(values.tolist() for values in columns), strict=True))

    replace_file(Path(path), fill)


def read(path: str | os.PathLike[str]) -> Trajectory:
    """Return the trajectory in a result file.

    Values, names, units and attributes come back as they were written.

    Raises
    ------
    DataError
        If the file is missing, is not netCDF-3, is not whole, or was not written by ``write``.
    """
    return _trajectory(_reader(Path(path)))


def read_arrays(path: str | os.PathLike[str]) -> dict[str, npt.NDArray[np.float64]]:
    """Return what a result file keeps besides samples, by name.

    Raises
    ------
    DataError
        As `read`.
    """
    variables = _reader(Path(path)).variables
    return {
        name: variable.values.astype(np.float64)
        for name, variable in variables.items()
        if variable.dimensions == (f"{name}{SIZE}",)
    }


def is_result(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a result file of slipfree that can be read."""
    try:
        _reader(Path(path))
    except DataError:
        return False
    return True


def _reader(path: Path) -> _Reader:
    return _Reader(path, read_bytes(path, "a result file of slipfree"))


def _check(run: Trajectory) -> None:
    if run.t.size == 0:
        raise ModelError("the trajectory has no samples: there is nothing to write")
    taken = RESERVED & {*run.columns, *run.attributes}
    taken |= {name for name in run.attributes if name.startswith(STATISTICS)}
    if taken:
        raise ModelError(f"{min(taken)!r} has a meaning of its own in a result file: rename it")


def _fill(file: Any, run: Trajectory) -> None:
    _annotate(file, _attributes(run))
    file.createDimension("time", run.t.size)
    time = file.createVariable("time", "f8", ("time",))
    time[:] = run.t
    _annotate(time, TIME)
    if run.wheels:
        names = [name.encode() for name in run.wheels]
        length = -(-max(map(len, names)) // 4) * 4  # a multiple of 4: the file needs no padding
        file.createDimension("wheel", len(names))
        file.createDimension("strlen", length)
        wheel = file.createVariable("wheel", "c", ("wheel", "strlen"))
        wheel[:] = np.array(names, f"S{length}").view("S1").reshape(len(names), length)
        _annotate(wheel, {**WHEELS, "_Encoding": "utf-8"})
    for name, column in run.columns.items():
        variable = file.createVariable(name, "f8", column.dimensions)
        variable[:] = column.values
        _annotate(variable, column.metadata)


def _annotate(node: Any, attributes: Mapping[str, Attribute]) -> None:
    for name, value in attributes.items():
        if hasattr(node, name):
            raise ModelError(f"attribute {name!r} has another meaning in netCDF: rename it")
        text = escape_name(value).encode() if isinstance(value, str) else None
        setattr(node, name, np.float64(value) if text is None else text)


def _attributes(run: Trajectory) -> dict[str, Attribute]:
    """Return the global attributes of a result."""
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return {
        "Conventions": CONVENTIONS,
        "title": "Motion of a wheeled vehicle over uneven ground",
        "date_created": now,
        "history": f"{now} computed by slipfree {__version__}",
        ORIGIN: __version__,
        "python_version": platform.python_version(),
        **{f"{name}_version": version(name) for name in ("casadi", "numpy", "scipy")},
        ORDER: " ".join(run.columns),
        **run.metadata,
    }


class _Variable(NamedTuple):
    """Where a file keeps a variable."""

    dimensions: tuple[str, ...]
    attributes: dict[str, Attribute]
    values: npt.NDArray[Any]


class _Reader:
    """A netCDF-3 file in memory, every byte of it accounted for.

    scipy's reader tells neither a truncated file from a damaged one nor the last from a whole one,
    so the header is read here. The format is that of the NetCDF Users' Guide, appendix B.
    """

    def __init__(self, path: Path, data: bytes) -> None:
        self.path, self.data, self.at = path, data, 4
        self._check_magic()
        self.offset = ">I" if data[3] == 1 else ">Q"
        self._integer()  # number of records: there is no record dimension
        self.dimensions = [(self._name(), self._integer()) for _ in self._list(DIMENSIONS)]
        self.attributes = self._attributes()
        if ORIGIN not in self.attributes:
            raise self.fault(
                "a netCDF file of something else", "give a file that slipfree run wrote"
            )
        self.variables = {self._name(): self._variable() for _ in self._list(VARIABLES)}

    def fault(self, found: str, remedy: str = REMEDY) -> DataError:
        return DataError(
            f"{self.path}: expected a result file of slipfree, found {found}; {remedy}"
        )

    def number(self, attribute: str) -> float:
        value = self.attributes[attribute]
        if isinstance(value, str):
            raise self.fault(f"the attribute {attribute} = {value!r}, not a number")
        return value

    def _check_magic(self) -> None:
        head = self.data[:4]
        if head in (b"CDF\1", b"CDF\2"):
            return
        if not head or b"CDF\1".startswith(head) or b"CDF\2".startswith(head):
            raise self._truncated(32)
        if head == b"\x89HDF" or head == b"CDF\5":
            raise self.fault("another kind of netCDF", "convert it: nccopy -k cdf2 IN.nc OUT.nc")
        raise self.fault(f"a file that begins with {head!r}, not netCDF", "check the name")

    def _truncated(self, needed: int) -> DataError:
        return self.fault(
            f"only the first {len(self.data)} of at least {needed} bytes: the file is truncated"
        )

    def _take(self, count: int) -> bytes:
        end = self.at + count
        if end > len(self.data):
            raise self._truncated(end)
        part, self.at = self.data[self.at : end], end + -count % 4
        return part

    def _integer(self) -> int:
        return int(struct.unpack(">I", self._take(4))[0])

    def _name(self) -> str:
        return self._take(self._integer()).decode(errors="replace")

    def _list(self, expected: int) -> range:
        at, tag, count = self.at, self._integer(), self._integer()
        if tag != expected and (tag or count):
            raise self.fault(f"a damaged header at byte {at}")
        return range(count)

    def _type(self) -> int:
        at, code = self.at, self._integer()
        if code not in TYPES:
            raise self.fault(f"a damaged header at byte {at}")
        return code

    def _attributes(self) -> dict[str, Attribute]:
        return {self._name(): self._attribute() for _ in self._list(ATTRIBUTES)}

    def _attribute(self) -> Attribute:
        code, count = self._type(), self._integer()
        raw = self._take(count * np.dtype(TYPES[code]).itemsize)
        if code == TEXT:
            return raw.rstrip(b"\0").decode(errors="replace")
        values = np.frombuffer(raw, TYPES[code])
        return float(values[0]) if values.size else math.nan

    def _variable(self) -> _Variable:
        at, places = self.at, [self._integer() for _ in range(self._integer())]
        if not all(place < len(self.dimensions) for place in places):
            raise self.fault(f"a damaged header at byte {at}")
        names = tuple(self.dimensions[place][0] for place in places)
        shape = tuple(self.dimensions[place][1] for place in places)
        attributes, kind, _ = self._attributes(), np.dtype(TYPES[self._type()]), self._integer()
        (begin,) = struct.unpack(self.offset, self._take(struct.calcsize(self.offset)))
        if not all(shape):
            raise self.fault("an empty or unlimited dimension")
        count = math.prod(shape)
        if begin + count * kind.itemsize > len(self.data):
            raise self._truncated(begin + count * kind.itemsize)
        values = np.frombuffer(self.data, kind, count, begin).reshape(shape)
        return _Variable(names, attributes, values)


def _trajectory(file: _Reader) -> Trajectory:
    """Return what a result file holds."""
    found, variables = file.attributes, file.variables
    order = str(found.get(ORDER, "")).split()
    missing = {"time", *order} - set(variables)
    if missing:
        raise file.fault(f"no variable {min(missing)}")
    t = variables["time"].values.astype(np.float64)
    wheels = variables["wheel"].values if "wheel" in variables else np.empty((0, 4), "S1")
    if t.ndim != 1 or not np.isfinite(t).all() or (np.diff(t) < 0).any():
        raise file.fault("times that do not ascend")
    if wheels.ndim != 2 or wheels.dtype != "S1":
        raise file.fault("names of wheels that are none")
    names = tuple(row.tobytes().rstrip(b"\0").decode(errors="replace") for row in wheels)
    sizes = {(t.size,), (t.size, len(names))}
    stop = None
    if set(STOP) <= set(found):
        name, words = (str(found[key]) for key in (STOP[0], STOP[2]))
        stop = Stop(name, file.number(STOP[1]), words)
    attributes = {
        name: str(value)
        for name, value in found.items()
        if name not in RESERVED and not name.startswith(STATISTICS)
    }
    return Trajectory(
        t,
        {name: _column(file, name, sizes) for name in order},
        names,
        stop,
        {k.removeprefix(STATISTICS): file.number(k) for k in found if k.startswith(STATISTICS)},
        attributes,
    )


def _column(file: _Reader, name: str, sizes: Container[tuple[int, ...]]) -> Column:
    dimensions, words, values = file.variables[name]
    if dimensions not in (("time",), ("time", "wheel")) or values.shape not in sizes:
        raise file.fault(f"{name} over the dimensions ({', '.join(dimensions)})")
    if values.dtype == "S1":
        raise file.fault(f"text in {name}")
    if not {"units", "long_name"} <= set(words):
        raise file.fault(f"{name} without units or long_name")
    label = Label(name, str(words["units"]), str(words["long_name"]))
    values = values.astype(np.float64)
    if (np.abs(values[np.isfinite(values)]) > LARGEST).any():
        raise file.fault(f"numbers in {name} that no motion has")
    return Column(label, values)
