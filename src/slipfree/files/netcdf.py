r"""Result files: netCDF with CF metadata, CSV, and exports of paths and rates.

A result file is netCDF-3 (64-bit offsets), which xarray, MATLAB, R, Julia, Panoply and ncdump open
directly. It has the dimensions ``wheel`` and ``time``, and one variable for each quantity with
``units`` and ``long_name``. A motion over terrain is a trajectory of the CF conventions. Global
attributes contain versions, date, the complete problem file, and the reason for an early stop.
Attributes are UTF-8; a byte of a file name that is not UTF-8, such as 0xff, is written as
``\udcff``.
"""

from __future__ import annotations

import json
import math
import os
import platform
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple
from weakref import finalize

import casadi as ca
import numpy as np
import numpy.typing as npt
import scipy

from slipfree.core.errors import DataError, ModelError
from slipfree.core.facts import decode
from slipfree.core.quantities import QUANTITIES, quantity_label
from slipfree.core.records import Array, Label
from slipfree.core.trajectory import (
    FACTS,
    FRAME,
    OUTCOME,
    STATISTICS,
    STOP,
    TIME,
    WHEELS,
    Column,
    Outcome,
    Stop,
    Trajectory,
)
from slipfree.core.version import __version__
from slipfree.files.tables import write_rows
from slipfree.system import regular_files

DEGREES = ("longitude", "latitude")
MAP_TRANSFORM = "map_transform"  # attribute of a result: its map coordinates as JSON
MAP_CRS = "map_crs"  # attribute of a result: EPSG code or WKT of the map file
TIME_ATTRIBUTES = TIME | {
    "units": "seconds since 2000-01-01 00:00:00",
    "calendar": "standard",
    "units_metadata": "leap_seconds: none",
    "comment": "seconds since the start of the motion; the date is arbitrary",
}
FEATURE = {"featureType": "trajectory"}
TRAJECTORY = "trajectory"  # variable that identifies the motion
TRAJECTORY_ATTRIBUTES = {"long_name": "number of the motion", "cf_role": "trajectory_id"}
CRS = "crs"  # variable with the reference system of the map
CONVENTIONS = "CF-1.11"
ORIGIN = "slipfree_version"  # attribute that identifies a result file
ATLAS = "atlas_conditions"  # attribute with the conditions of a mobility map, as JSON
FIT = "fit"  # attribute with the contents of a fit, as JSON
# attributes of results without a motion: description, and commands that read them
NO_MOTION = {
    ATLAS: ("a mobility map", "use slipfree info or slipfree report"),
    FIT: ("a fit", "use slipfree info, or slipfree fit with --predict"),
}
ORDER = "quantities"  # attribute with the names of the quantities in their order
RESERVED = {"time", "wheel", "Conventions", ORDER, OUTCOME, FACTS, *STOP, *FEATURE, CRS, TRAJECTORY}
REMEDY = "run the problem again to write a complete file"
# exceptions of scipy's reader for a damaged file
DAMAGED = (ValueError, LookupError, TypeError, OverflowError, MemoryError)
MAX_VALUE = 1e100  # larger numbers in a result file mean that it is damaged
BLOCK = 65536  # number of samples processed at once
SIZE = "_size"  # suffix of the dimensions of a further array, before the number of the axis
NOTHING: Mapping[str, Array] = {}
Attribute = str | float
ANGLES = ("heading", "pitch", "roll", "yaw")
WGS84 = "EPSG:4326"  # default reference system of GeoJSON
RUN_AGAIN = "give a result of slipfree run with the verb 'direct', 'inverse' or 'plan'"


class MapCoordinate(NamedTuple):
    """A coordinate of the map file as a linear function of a coordinate of the motion."""

    name: str  # ``"x"``, ``"y"``, ``"z"``, ``"longitude"`` or ``"latitude"``
    offset: float  # value at the origin of the motion's coordinates [m] or [deg]
    factor: float  # change per metre of the motion [1] or [deg/m]
    axis: str  # coordinate of the motion: ``"x"``, ``"y"`` or ``"z"``


def map_positions(run: Trajectory) -> dict[str, tuple[str, Array]]:
    """Return units and values, shape (n,), of the map coordinates by name."""
    text = run.attributes.get(MAP_TRANSFORM)
    coordinates = [MapCoordinate(name, 0.0, 1.0, name) for name in "xyz"]
    try:
        if text is not None:
            coordinates = [MapCoordinate(*row) for row in json.loads(text)]
    except (ValueError, TypeError, RecursionError) as error:
        raise DataError(
            f"attribute {MAP_TRANSFORM!r} of the result: expected rows of name, offset, factor and "
            f"axis as JSON, found {text!r}; run the problem again"
        ) from error
    return {
        name: ("degree" if name in DEGREES else "m", offset + factor * run[axis])
        for name, offset, factor, axis in coordinates
    }


def is_trajectory(run: Trajectory) -> bool:
    """Return whether a motion has positions x, y, z in space."""
    return {"x", "y", "z"} <= {*run.columns}


def map_label(name: str, crs: str) -> Label:
    """Return the label of a horizontal coordinate of a map in its reference system."""
    return quantity_label(name if name in DEGREES else f"map_{name}", crs=crs)


def standard_name(name: str) -> dict[str, str]:
    """Return the attribute with the CF standard name of a quantity; empty if it has none."""
    standard = QUANTITIES[name].standard_name if name in QUANTITIES else ""
    return {"standard_name": standard} if standard else {}


def position_columns(run: Trajectory) -> dict[str, Column]:
    """Return columns with the position in the reference system of the map; empty without either."""
    crs = run.attributes.get(MAP_CRS)
    if not crs or not is_trajectory(run):
        return {}
    places = map_positions(run).items()
    columns = (Column(map_label(name, crs), values) for name, (_, values) in places if name != "z")
    return {column.label.name: column for column in columns}


def coordinate_attributes(run: Trajectory, on_map: Sequence[str], name: str) -> dict[str, str]:
    """Return the CF attributes of a variable: standard name, axis, coordinates, grid mapping.

    ``on_map`` are the names of the two horizontal coordinates in the reference system of the map;
    empty if the file has none.
    """
    attributes = standard_name(name)
    if not is_trajectory(run):
        return attributes
    axes = dict(zip([*on_map, "z"], "XYZ" if on_map else "Z", strict=True))
    if name in axes:
        return attributes | {"axis": axes[name]} | ({"positive": "up"} if name == "z" else {})
    horizontal = on_map or "xy"  # without an axis, since CF reserves X for longitude and map_x
    if name in horizontal:
        return attributes
    attributes["coordinates"] = " ".join(["time", *horizontal, "z"])
    return attributes | ({"grid_mapping": CRS} if on_map else {})


def grid_mapping(crs: str) -> dict[str, Any]:
    """Return the attributes of the variable ``crs``: WKT for CF and GDAL, and the CF projection."""
    import pyproj

    try:
        system = pyproj.CRS.from_user_input(crs)
    except pyproj.exceptions.CRSError as error:
        raise DataError(
            f"attribute {MAP_CRS!r} of the result: expected an EPSG code or WKT, found {crs!r}; "
            "run the problem again"
        ) from error
    return system.to_cf() | {"spatial_ref": system.to_wkt("WKT1_GDAL")}


def write(
    path: str | os.PathLike[str], run: Trajectory, arrays: Mapping[str, Array] = NOTHING
) -> None:
    """Write a trajectory as a netCDF file.

    An existing file is replaced only when the new one is complete.

    Parameters
    ----------
    path : path
        File to write, usually ending in ``.nc``.
    run : Trajectory
        The motion. Versions and date are added to its attributes, unless it was read from a result
        file and has them.
    arrays : mapping of str to ndarray, optional
        Further arrays by name, which `read_arrays` returns; their shapes may differ. Arrays whose
        values are exact in single precision are stored in it.

    Raises
    ------
    ModelError
        If the trajectory has no samples or uses a reserved name.
    DataError
        If the file cannot be written, or if the attributes of the trajectory contain invalid map
        coordinates or an unknown reference system.
    """
    _check(run)
    on_map = position_columns(run)
    columns = {**on_map, **run.columns}
    with regular_files.replacing(Path(path)) as part:
        with scipy.io.netcdf_file(str(part), "w", version=2) as file:
            now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
            own = {
                "Conventions": CONVENTIONS,
                **(FEATURE if is_trajectory(run) else {}),
                "title": "Motion of a wheeled vehicle over uneven ground",
                "date_created": now,
                "history": f"{now} computed by slipfree {__version__}",
                ORIGIN: __version__,
                "python_version": platform.python_version(),
                **{f"{each.__name__}_version": each.__version__ for each in (ca, np, scipy)},
                ORDER: " ".join(run.columns),
                **({FRAME: "paper"} if "heading" in run.columns else {}),
            }
            annotate(file, own | run.metadata)
            file.createDimension("time", run.t.size)
            time = file.createVariable("time", "f8", ("time",))
            time[:] = run.t
            annotate(time, TIME_ATTRIBUTES)
            if run.wheels:
                names = [name.encode() for name in run.wheels]
                # a multiple of 4: the file needs no padding
                length = -(-max(map(len, names)) // 4) * 4
                file.createDimension("wheel", len(names))
                file.createDimension("strlen", length)
                wheel = file.createVariable("wheel", "c", ("wheel", "strlen"))
                wheel[:] = np.array(names, f"S{length}").view("S1").reshape(len(names), length)
                annotate(wheel, {**WHEELS, "_Encoding": "utf-8"})
            if is_trajectory(run):
                add_scalar(file, TRAJECTORY, TRAJECTORY_ATTRIBUTES, 1)
            if on_map:
                add_scalar(file, CRS, grid_mapping(run.attributes[MAP_CRS]))
            for name, column in columns.items():
                variable = file.createVariable(name, "f8", column.dimensions[::-1])
                annotate(variable, column.metadata | coordinate_attributes(run, [*on_map], name))
            for name, values in arrays.items():
                dimensions = [f"{name}{SIZE}{axis or ''}" for axis in range(values.ndim)]
                for dimension, size in zip(dimensions, values.shape, strict=True):
                    file.createDimension(dimension, size)
                with np.errstate(over="ignore"):
                    is_single = np.array_equal(values.astype("f4"), values, equal_nan=True)
                variable = file.createVariable(name, "f4" if is_single else "f8", dimensions)
                variable[:] = values
                variable.long_name = name.replace("_", " ")
        # values in blocks: scipy's writer would hold a copy of all quantities in memory
        written = open_netcdf(part)
        written.stream.close()
        with part.open("rb+") as stream:
            for name, column in columns.items():
                stream.seek(written.variables[name].start)
                for row in np.atleast_2d(column.values.T):
                    for k in range(0, row.size, BLOCK):
                        stream.write(row[k : k + BLOCK].astype(">f8").data)


def write_csv(path: str | os.PathLike[str], run: Trajectory) -> None:
    """Write a trajectory as comma-separated values, one row per sample.

    The first row contains the names of the columns, as in ``slip_along[front]``. Values are in SI
    units and angles in radians. Headings are in the frame of the problem; beside them, ``yaw``
    counts from the x axis in every file.

    Raises
    ------
    ModelError
        If the trajectory has no samples or uses a reserved name.
    DataError
        If the file cannot be written.
    """
    _check(run)
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

    Values, names, units and attributes are those of the written trajectory.

    Parameters
    ----------
    path : path
        The result file.
    lazy : bool
        Whether to read each quantity from the file whenever it is accessed, to save memory. Access
        to a quantity with damaged values then raises DataError.

    Raises
    ------
    DataError
        If the file is missing, is not netCDF-3, is incomplete or damaged, or was not written by
        ``write``.
    """
    file = open_netcdf(Path(path))
    with ExitStack() as stack:
        stack.enter_context(file.stream)
        run = _trajectory(file)
        if not lazy:
            return replace(run, columns=dict(run.columns))
        finalize(run.columns, stack.pop_all().close)
        return run


def read_arrays(path: str | os.PathLike[str]) -> dict[str, npt.NDArray[np.float64]]:
    """Return the arrays that `write` stored in addition to the trajectory, by name."""
    file = open_netcdf(Path(path))
    names = [k for k, each in file.variables.items() if each.dimensions[:1] == (f"{k}{SIZE}",)]
    with file.stream, np.errstate(invalid="ignore"):  # NaN in a damaged file
        return {name: file.values(name).astype(np.float64) for name in names}


def attributes_of(path: str | os.PathLike[str]) -> Mapping[str, Attribute]:
    """Return the attributes of a result file; empty for any other file."""
    try:
        file = open_netcdf(Path(path))
    except DataError:
        return {}
    file.stream.close()
    return file.attributes


def _check(run: Trajectory) -> None:
    """Raise ModelError for a trajectory without samples or with a reserved name."""
    if run.t.size == 0:
        raise ModelError(
            "expected a trajectory with at least one sample, found none; do not write an empty "
            "motion"
        )
    taken = RESERVED & {*run.columns, *run.attributes}
    taken |= {name for name in run.attributes if name.startswith(STATISTICS)}
    if taken:
        raise ModelError(
            f"expected names other than those reserved in result files, found {min(taken)!r}; "
            "rename the quantity or attribute"
        )


def annotate(node: Any, attributes: Mapping[str, Any]) -> None:
    """Set attributes of a netCDF file or variable; raise ModelError for a name that scipy uses."""
    for name, value in attributes.items():
        if hasattr(node, name):
            raise ModelError(
                f"expected an attribute name that scipy's netCDF writer does not use, found "
                f"{name!r}; rename the attribute"
            )
        text = regular_files.escape_name(value).encode() if isinstance(value, str) else None
        setattr(node, name, np.float64(value) if text is None else text)


def add_scalar(file: Any, name: str, attributes: Mapping[str, Any], value: int = 0) -> None:
    """Add a whole number with attributes to a netCDF file that is written."""
    variable = file.createVariable(name, "i4", ())
    variable[...] = value  # without a value, what memory contained is written
    annotate(variable, attributes)


class _Variable(NamedTuple):
    """Header of a variable in a netCDF file: offset of its values [bytes], attributes."""

    dimensions: tuple[str, ...]
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    start: int
    attributes: dict[str, Attribute]


class NetcdfFile(NamedTuple):
    """An open netCDF file: path, stream, global attributes and headers of variables by name."""

    path: Path
    stream: BinaryIO
    attributes: dict[str, Attribute]
    variables: dict[str, _Variable]

    def values(self, name: str) -> npt.NDArray[Any]:
        """Return the values of a variable, read from the file."""
        variable = self.variables[name]
        self.stream.seek(variable.start)
        size = math.prod(variable.shape)
        return np.fromfile(self.stream, variable.dtype, size).reshape(variable.shape)

    def number(self, attribute: str) -> float:
        """Return the value of a numeric global attribute; raise DataError if it is text."""
        value = self.attributes[attribute]
        if isinstance(value, str):
            raise result_fault(
                self.path, f"the text {value!r} instead of a number in the attribute {attribute!r}"
            )
        return value


def result_fault(path: Path, found: str, remedy: str = REMEDY) -> DataError:
    """Return the error for a file that is not a usable result file."""
    return DataError(f"{path}: expected a result file of slipfree, found {found}; {remedy}")


def open_netcdf(path: Path) -> NetcdfFile:
    """Return a result file opened for reading; raise DataError for any other or a damaged file."""
    with regular_files.regular_file(path, "a result file of slipfree"):
        with path.open("rb") as stream:
            head = stream.read(4)
        if head in (b"\x89HDF", b"CDF\5"):
            found = "a netCDF file in a format other than netCDF-3"
            raise result_fault(path, found, "convert it: nccopy -k cdf2 IN.nc OUT.nc")
        if not b"CDF".startswith(head[:3]):
            raise result_fault(
                path, "a file that is not netCDF", "give a file that slipfree run wrote"
            )
        try:
            with scipy.io.netcdf_file(path.open("rb"), mmap=True) as file:
                attributes, dimensions = _attributes_of(file), dict(file.dimensions)
                variables = {name: _variable(each) for name, each in file.variables.items()}
        except DAMAGED as error:
            # The traceback refers to arrays that would keep the file open.
            found = "a netCDF file that is truncated or damaged"
            raise result_fault(path, found) from error.with_traceback(None)
    if ORIGIN not in attributes:
        remedy = "give a file that slipfree run wrote"
        raise result_fault(path, "a netCDF file of another program", remedy)
    if not all(dimensions.values()):
        name = next(name for name, size in dimensions.items() if not size)
        raise result_fault(path, f"the empty or unlimited dimension {name!r}")
    return NetcdfFile(path, path.open("rb"), attributes, variables)


def _variable(variable: Any) -> _Variable:  # which ends all references to the mapped file
    data = root = variable.data
    while isinstance(root.base, np.ndarray):
        root = root.base
    start = data.ctypes.data - root.ctypes.data
    return _Variable(variable.dimensions, data.shape, data.dtype, start, _attributes_of(variable))


def _attributes_of(node: Any) -> dict[str, Attribute]:
    """Return attributes as text or numbers, NaN for empty ones."""
    return {
        name: value.decode(errors="replace")
        if isinstance(value, bytes)
        else float(np.append(value, math.nan)[0])
        for name, value in node._attributes.items()
    }


def _trajectory(file: NetcdfFile) -> Trajectory:
    """Return the trajectory in an open result file; its quantities are read on access."""
    stored, variables = file.attributes, file.variables
    order = str(stored.get(ORDER, "")).split()
    missing = {"time", *order} - set(variables)
    for name in NO_MOTION.keys() & stored.keys():
        found, remedy = NO_MOTION[name]
        raise result_fault(file.path, f"{found}, which has no motion", remedy)
    if missing:
        raise result_fault(file.path, f"no variable {min(missing)!r}")
    t = file.values("time").astype(np.float64)
    wheels = file.values("wheel") if "wheel" in variables else np.empty((0, 4), "S1")
    if t.ndim != 1:
        raise result_fault(file.path, "a variable 'time' that does not have one dimension")
    if not np.isfinite(t).all():
        raise result_fault(file.path, "times that are not finite")
    if (np.diff(t) < 0).any():
        raise result_fault(file.path, "times that decrease")
    if wheels.ndim != 2 or wheels.dtype != "S1":
        raise result_fault(file.path, "a variable 'wheel' that does not contain names")
    names = tuple(row.tobytes().rstrip(b"\0").decode(errors="replace") for row in wheels)
    n, k = t.size, len(names)
    sizes = {("time",): (n,), ("wheel", "time"): (k, n)}
    stop = None
    if set(STOP) <= set(stored):
        name, words, outcome = (str(stored.get(key, "")) for key in (STOP[0], STOP[2], OUTCOME))
        if outcome.upper() not in Outcome.__members__:
            found = f"the unknown outcome {outcome!r}" if outcome else f"no attribute {OUTCOME!r}"
            raise result_fault(file.path, found)
        stop = Stop(name, file.number(STOP[1]), words, Outcome[outcome.upper()])
    try:
        facts = decode(str(stored.get(FACTS, "{}")))
    except ValueError as error:
        raise result_fault(file.path, f"an unreadable attribute {FACTS!r}") from error
    attributes = {
        name: str(value)
        for name, value in stored.items()
        if name not in RESERVED and not name.startswith(STATISTICS)
    }
    labels = dict[str, Label]()
    for name in order:
        dimensions, shape, dtype, _, texts = variables[name]
        found = ""
        if sizes.get(dimensions) != shape:
            found = (
                f"the variable {name!r} with dimensions ({', '.join(dimensions)}) and shape {shape}"
            )
        elif dtype == "S1":
            found = f"text in the variable {name!r}"
        elif absent := [key for key in ("units", "long_name") if key not in texts]:
            found = f"the variable {name!r} without the attribute {absent[0]!r}"
        if found:
            raise result_fault(file.path, found)
        labels[name] = Label(name, str(texts["units"]), str(texts["long_name"]))
    return Trajectory(
        t,
        _Columns(file, labels),
        names,
        stop,
        {k.removeprefix(STATISTICS): file.number(k) for k in stored if k.startswith(STATISTICS)},
        attributes,
        facts,
    )


class _Columns(Mapping[str, Column]):
    """Mapping of the quantities in a result file; each access reads the values from the file."""

    def __init__(self, file: NetcdfFile, labels: Mapping[str, Label]) -> None:
        self._file, self._labels = file, labels

    def __getitem__(self, name: str) -> Column:
        label = self._labels[name]
        stored = self._file.values(name).T
        values = np.empty(stored.shape)
        for k in range(0, len(stored), BLOCK):
            values[k : k + BLOCK] = block = stored[k : k + BLOCK]
            if (np.abs(block[np.isfinite(block)]) > MAX_VALUE).any():
                raise result_fault(
                    self._file.path, f"absolute values above {MAX_VALUE:g} in the variable {name!r}"
                )
        return Column(label, values)

    def __contains__(self, name: object) -> bool:
        return name in self._labels

    def __iter__(self) -> Iterator[str]:
        return iter(self._labels)

    def __len__(self) -> int:
        return len(self._labels)


def export_path(file: Path, out: Path) -> None:
    """Write the path of the platform in the coordinates of the map file.

    Parameters
    ----------
    file : Path
        A result file.
    out : Path
        File to write. ``.csv``: one row per sample with time [s], x, y, z [m] or longitude,
        latitude [degrees], z [m], and the attitude [rad]. ``.geojson``: a LineString of the
        positions, with times; the member ``crs`` of GeoJSON 2008 names a reference system other
        than WGS 84.

    Raises
    ------
    DataError
        If the result cannot be read or has no x, y, z, if ``out`` has another ending or is the
        result file, if a GeoJSON path has a single sample, or if ``out`` cannot be written.
    """
    run = read(file)
    check_motion(file, run, "xyz")
    check_name(out, file, (".csv", ".geojson"))
    crs, places = run.attributes.get("map_crs", ""), map_positions(run)
    if out.suffix.lower() == ".csv":
        words = f"of the platform's centre on the map ({crs or 'no reference system given'})"
        columns = {
            name: Column(Label(name, unit, f"{name} {words}"), values)
            for name, (unit, values) in places.items()
        }
        columns |= {name: run.columns[name] for name in ANGLES if name in run.columns}
        write_csv(out, replace(run, columns=columns))
        return
    if run.t.size < 2:
        raise DataError(
            f"{out}: expected a motion of at least two samples for a LineString, found one; "
            "write a .csv file instead"
        )
    positions = [values.tolist() for _, values in places.values()]
    feature = {
        "type": "Feature",
        "properties": {
            "title": run.attributes.get("title", "path"),
            "reference_system": crs or "not given: coordinates of the map file",
            "time_s": run.t.tolist(),
            FRAME: run.attributes.get(FRAME, "paper"),
            **{f"{n}_rad": run[n].tolist() for n in ANGLES if n in run.columns},
        },
        "geometry": {"type": "LineString", "coordinates": [*zip(*positions, strict=True)]},
    }
    content: dict[str, Any] = {"type": "FeatureCollection", "features": [feature]}
    if crs not in ("", WGS84):
        code = re.fullmatch(r"EPSG:(\d+)", crs)
        name = f"urn:ogc:def:crs:EPSG::{code[1]}" if code else crs
        content["crs"] = {"type": "name", "properties": {"name": name}}
    with regular_files.replacing(out) as part:
        part.write_text(json.dumps(content) + "\n", encoding="utf-8")


def export_rates(file: Path, out: Path) -> None:
    """Write the rates of driven wheels and of joints with actuators as CSV, one row per sample.

    Rates are linear between samples; a jump has two rows with the same time. Units are rad/s and
    m/s.

    Parameters
    ----------
    file : Path
        A result file.
    out : Path
        File to write, ending in ``.csv``.

    Raises
    ------
    DataError
        If the result cannot be read or has no such rates, or if ``out`` has another ending, is the
        result file, or cannot be written.
    """
    run = read(file)
    check_name(out, file, (".csv",))
    inputs = {name: run.columns.get(name) for name in run.attributes.get("inputs", "").split()}
    rates = {n: c for n, c in inputs.items() if c and c.label.unit in ("rad s-1", "m s-1")}
    if not rates:
        raise DataError(
            f"{file}: expected rates of driven wheels or actuated joints, found none; {RUN_AGAIN}"
        )
    write_csv(out, replace(run, columns=rates))


def check_motion(file: Path, run: Trajectory, needed: Iterable[str]) -> None:
    """Raise DataError if the motion in a result file lacks a needed quantity."""
    names = list(needed)
    if missing := [name for name in names if name not in run.columns]:
        listed = ", ".join(names)
        raise DataError(
            f"{file}: expected a motion with {listed}, found no {missing[0]!r}; {RUN_AGAIN}"
        )


def check_name(out: Path, file: Path, endings: Collection[str]) -> None:
    """Raise DataError unless ``out`` has one of the endings and is not the result file."""
    regular_files.check_ending(out, endings)
    if regular_files.resolve_links(out) == regular_files.resolve_links(file):
        raise DataError(
            f"{out}: expected a separate file, found the result file; choose another name"
        )
