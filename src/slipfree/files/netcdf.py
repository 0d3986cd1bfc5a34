r"""Results on disk: netCDF with CF metadata, and CSV.

A result file is netCDF-3 (64-bit offsets), which xarray, MATLAB, R, Julia, Panoply and ncdump open
directly. It has the dimensions ``time`` and ``wheel``, one variable for each quantity with
``units`` and ``long_name``, and global attributes on its origin: versions, date, the complete
problem file, and the reason of an early stop. Attributes are UTF-8; a byte of a file name that is
not UTF-8, such as 0xff, is written as ``\udcff``.
"""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Container, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple
from weakref import finalize

import numpy as np
import numpy.typing as npt
import scipy

from slipfree.atomic_files import replace_file
from slipfree.errors import DataError, ModelError
from slipfree.files.tables import write_rows
from slipfree.files.upgrade import upgrade_0_1, upgrade_column_0_1
from slipfree.frames import to_problem_frame
from slipfree.outcome import Outcome
from slipfree.records import Label
from slipfree.regular_files import escape_name, regular_file
from slipfree.trajectory import (
    OUTCOME,
    STATISTICS,
    STOP,
    TIME,
    WHEELS,
    Column,
    Stop,
    Trajectory,
)
from slipfree.version import __version__

CONVENTIONS = "CF-1.11"
ORIGIN = "slipfree_version"  # attribute that identifies a result file
OLD = "0.1."  # beginning of versions whose results are upgraded
ORDER = "quantities"  # attribute with the order of the quantities, which netCDF does not keep
RESERVED = {"time", "wheel", "Conventions", ORDER, OUTCOME, *STOP}
REMEDY = "run the problem again to get a whole file"
DAMAGED = (ValueError, LookupError, TypeError, OverflowError, MemoryError)  # of scipy's reader
MAX_VALUE = 1e100  # larger numbers in a result file mean that it is damaged
BLOCK = 65536  # samples at once
SIZE = "_size"  # suffix of the dimension of an array that is no sample
NOTHING: Mapping[str, npt.NDArray[Any]] = {}
Attribute = str | float


def write(
    path: str | os.PathLike[str], run: Trajectory, arrays: Mapping[str, npt.NDArray[Any]] = NOTHING
) -> None:
    """Write a trajectory as a netCDF file.

    The file is replaced only when the new one is complete.

    Parameters
    ----------
    path : path
        The file, usually ending in ``.nc``.
    run : Trajectory
        The motion. Versions and date are added to its attributes, unless it has them already
        because it was read from a file.
    arrays : mapping of str to ndarray of shape (n,), optional
        Further arrays, for `read_arrays`; each has a dimension of its own.

    Raises
    ------
    ModelError
        If the trajectory is empty, or uses a reserved name.
    DataError
        If the file cannot be written.
    """
    _check(run)

    def fill(part: Path) -> None:
        with scipy.io.netcdf_file(str(part), "w", version=2) as file:
            _fill(file, run)
            for name, values in arrays.items():
                file.createDimension(f"{name}{SIZE}", values.size)
                file.createVariable(name, "f8", (f"{name}{SIZE}",))[:] = values

    replace_file(Path(path), fill)


def write_csv(path: str | os.PathLike[str], run: Trajectory) -> None:
    """Write a trajectory as comma-separated values, one row per sample.

    The first row names the columns, as in ``slip_along[front]``; values are in SI units, which a
    netCDF file names. Headings are in the frame of the problem.

    Raises
    ------
    ModelError
        If the trajectory is empty.
    DataError
        If the file cannot be written.
    """
    _check(run)
    run = to_problem_frame(run)
    names, columns = ["time"], [run.t]
    for name, column in run.columns.items():
        wheels = [""] if column.values.ndim == 1 else [f"[{wheel}]" for wheel in run.wheels]
        names += [f"{name}{wheel}" for wheel in wheels]
        columns += [*np.atleast_2d(column.values.T)]
    blocks = (slice(k, k + BLOCK) for k in range(0, run.t.size, BLOCK))
    rows = (row for part in blocks for row in np.column_stack([c[part] for c in columns]).tolist())
    write_rows(Path(path), names, rows)


def read(path: str | os.PathLike[str], *, lazy: bool = False) -> Trajectory:
    """Return the trajectory in a result file.

    Values, names, units and attributes are equal to those that were written.

    Parameters
    ----------
    path : path
        The file.
    lazy : bool
        Whether to read a quantity each time it is asked for, so that no two need be in memory.

    Raises
    ------
    DataError
        If the file is missing, is not netCDF-3, is incomplete, or was not written by ``write``.
    """
    file = _open(Path(path))
    with ExitStack() as stack:
        stack.enter_context(file.stream)
        run = _trajectory(file)
        if not lazy:
            return replace(run, columns=dict(run.columns))
        finalize(run.columns, stack.pop_all().close)
        return run


def read_arrays(path: str | os.PathLike[str]) -> dict[str, npt.NDArray[np.float64]]:
    """Return the arrays of a result file that are not samples, by name.

    Raises
    ------
    DataError
        As in `read`.
    """
    file = _open(Path(path))
    names = [k for k, each in file.variables.items() if each.dimensions == (f"{k}{SIZE}",)]
    with file.stream:
        return {name: file.values(name).astype(np.float64) for name in names}


def is_result(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a result file of slipfree that can be read."""
    try:
        _open(Path(path)).stream.close()
    except DataError:
        return False
    return True


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
    """A variable of a netCDF file, without its values."""

    dimensions: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    start: int  # byte of the file
    attributes: dict[str, Attribute]


class _File(NamedTuple):
    """Header of a netCDF file, and the open file."""

    path: Path
    stream: BinaryIO
    attributes: dict[str, Attribute]
    variables: dict[str, _Variable]

    def values(self, name: str) -> npt.NDArray[Any]:
        """Return the values of a variable."""
        variable = self.variables[name]
        self.stream.seek(variable.start)
        size = math.prod(variable.shape)
        return np.fromfile(self.stream, variable.dtype, size).reshape(variable.shape)

    def number(self, attribute: str) -> float:
        value = self.attributes[attribute]
        if isinstance(value, str):
            raise _fault(self.path, f"the attribute {attribute} = {value!r}, not a number")
        return value


def _fault(path: Path, found: str, remedy: str = REMEDY) -> DataError:
    return DataError(f"{path}: expected a result file of slipfree, found {found}; {remedy}")


def _open(path: Path) -> _File:
    """Return the header of a result file, which is whole."""
    with regular_file(path, "a result file of slipfree"):
        with path.open("rb") as stream:
            head = stream.read(4)
        if head in (b"\x89HDF", b"CDF\5"):
            raise _fault(path, "another kind of netCDF", "convert it: nccopy -k cdf2 IN.nc OUT.nc")
        if not b"CDF".startswith(head[:3]):
            raise _fault(path, "a file that is not netCDF", "give one that slipfree run wrote")
        try:
            with scipy.io.netcdf_file(path.open("rb"), mmap=True) as file:
                attributes, dimensions = _attributes_of(file), dict(file.dimensions)
                variables = {name: _variable(each) for name, each in file.variables.items()}
        except DAMAGED as error:
            # Its traceback holds arrays, without which alone the file can be unmapped.
            found = "a netCDF file that is cut off or damaged"
            raise _fault(path, found) from error.with_traceback(None)
    if ORIGIN not in attributes:
        remedy = "give a file that slipfree run wrote"
        raise _fault(path, "a netCDF file of something else", remedy)
    if str(attributes[ORIGIN]).startswith(OLD):
        attributes = upgrade_0_1(attributes)
    if not all(dimensions.values()):
        raise _fault(path, "an empty or unlimited dimension")
    return _File(path, path.open("rb"), attributes, variables)


def _variable(found: Any) -> _Variable:
    data = root = found.data
    while isinstance(root.base, np.ndarray):
        root = root.base
    start = data.ctypes.data - root.ctypes.data
    return _Variable(found.dimensions, data.shape, data.dtype, start, _attributes_of(found))


def _attributes_of(node: Any) -> dict[str, Attribute]:
    """Return the attributes of a file or a variable; scipy has no public list of them."""
    return {
        name: value.decode(errors="replace")
        if isinstance(value, bytes)
        else float(np.append(value, math.nan)[0])
        for name, value in node._attributes.items()
    }


def _trajectory(file: _File) -> Trajectory:
    """Return the trajectory in the contents of a result file."""
    found, variables = file.attributes, file.variables
    order = str(found.get(ORDER, "")).split()
    missing = {"time", *order} - set(variables)
    if missing:
        raise _fault(file.path, f"no variable {min(missing)}")
    t = file.values("time").astype(np.float64)
    wheels = file.values("wheel") if "wheel" in variables else np.empty((0, 4), "S1")
    if t.ndim != 1 or not np.isfinite(t).all() or (np.diff(t) < 0).any():
        raise _fault(file.path, "times that do not ascend")
    if wheels.ndim != 2 or wheels.dtype != "S1":
        raise _fault(file.path, "names of wheels that are none")
    names = tuple(row.tobytes().rstrip(b"\0").decode(errors="replace") for row in wheels)
    sizes = {(t.size,), (t.size, len(names))}
    stop = None
    if set(STOP) <= set(found):
        name, words = (str(found[key]) for key in (STOP[0], STOP[2]))
        stop = Stop(name, file.number(STOP[1]), words, _outcome(file))
    attributes = {
        name: str(value)
        for name, value in found.items()
        if name not in RESERVED and not name.startswith(STATISTICS)
    }
    return Trajectory(
        t,
        _Columns(file, {name: _label(file, name, sizes) for name in order}),
        names,
        stop,
        {k.removeprefix(STATISTICS): file.number(k) for k in found if k.startswith(STATISTICS)},
        attributes,
    )


def _outcome(file: _File) -> Outcome:
    """Return the outcome stored in a result file."""
    name = str(file.attributes.get(OUTCOME, "")).upper()
    if name not in Outcome.__members__:
        raise _fault(file.path, f"the attribute {OUTCOME} = {name.lower()!r}, which is no outcome")
    return Outcome[name]


def _label(file: _File, name: str, sizes: Container[tuple[int, ...]]) -> Label:
    """Return the label of a quantity; raise DataError if it is invalid."""
    dimensions, shape, dtype, _, words = file.variables[name]
    if dimensions not in (("time",), ("time", "wheel")) or shape not in sizes:
        raise _fault(file.path, f"{name} over the dimensions ({', '.join(dimensions)})")
    if dtype == "S1":
        raise _fault(file.path, f"text in {name}")
    if not {"units", "long_name"} <= set(words):
        raise _fault(file.path, f"{name} without units or long_name")
    return Label(name, str(words["units"]), str(words["long_name"]))


class _Columns(Mapping[str, Column]):
    """Quantities of a file, each read when it is asked for."""

    def __init__(self, file: _File, labels: Mapping[str, Label]) -> None:
        self._file, self._labels = file, labels

    def __getitem__(self, name: str) -> Column:
        label = self._labels[name]
        found = self._file.values(name)
        values = np.empty(found.shape)
        for k in range(0, len(found), BLOCK):
            values[k : k + BLOCK] = block = found[k : k + BLOCK]
            if (np.abs(block[np.isfinite(block)]) > MAX_VALUE).any():
                raise _fault(self._file.path, f"numbers in {name} that no motion has")
        column = Column(label, values)
        is_old = str(self._file.attributes[ORIGIN]).startswith(OLD)
        return upgrade_column_0_1(column) if is_old else column

    def __contains__(self, name: object) -> bool:
        return name in self._labels

    def __iter__(self) -> Iterator[str]:
        return iter(self._labels)

    def __len__(self) -> int:
        return len(self._labels)
