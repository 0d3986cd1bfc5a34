"""Maps from single-file rasters, read with rasterio (GDAL); markers of missing heights.

A map file may have markers that it does not declare, such as -9999.
"""

from __future__ import annotations

import io
import math
import re
import shlex
import sys
import warnings
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, Literal, NamedTuple, TypeVar

import numpy as np
import scipy  # scipy.io is imported when it is used, since this takes 0.2 s

from slipfree.core.errors import DataError, read_table
from slipfree.core.records import Array
from slipfree.files.maps.reference_systems import LENGTHS, refuse, scale_facts, system_name
from slipfree.terrain.grid_ops import Heights, UniformAxis, Window, parts

CLASSIC = (b"CDF\1", b"CDF\2")
DAMAGED = (ValueError, LookupError, TypeError, OverflowError, MemoryError)
TABLE: dict[str, Any] = read_table(__file__, "rasters.toml")
FORMATS: dict[str, str] = {  # names of formats by their usual file endings
    each: name for endings, name in TABLE["endings"].items() for each in endings.split()
}
OPTIONS: dict[str, dict[str, str]] = {  # the default loses digits
    driver: {"DATATYPE": "Float64"} for driver in ("AAIGrid", "GRASSASCIIGrid")
}
KEYS: dict[str, str] = TABLE["keys"]  # of the headers of rasters as text, by driver
# drivers that open files only by name, by the first bytes of the files
BY_NAME = {head.encode("latin1"): driver for head, driver in TABLE["by_name"].items()}
UNKNOWN = "not recognized as being in a supported file format"  # in errors of GDAL
PICTURES = "GTiff", "JPEG", "PNG", "WEBP"  # formats with Exif tags
ORIENTATION = 274  # tag of Exif and TIFF
CACHE = 64  # GDAL's cache of blocks [MB]
EDITABLE = "GTiff", "HFA"  # formats whose missing value gdal_edit.py changes in the file
# P2 or P5, then width, height and maximum, with comments between them; one blank ends the header
PGM_HEADER = re.compile(rb"P([25])" + 3 * rb"(?:\s|#[^\r\n]*[\r\n])+(\d+)" + rb"(?:\r\n|\s)")
FEET = "; for feet set terrain.vertical_scale = 0.3048"
# axes of the coordinates in netCDF files, by their names, standard names and attributes axis
COORDINATES = {word: axis for axis, words in TABLE["coordinates"].items() for word in words.split()}
SHOWN = 20  # bytes of a damaged header in messages
NUMBER = re.compile(rb"[-+]?((\d+\.?\d*|\.\d+)(e[-+]?\d+)?|inf(inity)?|nan)", re.IGNORECASE)
DEGREE = 1.11e5  # approximate length of a degree [m]
OCCUPANCY = 205, 0, 254  # gray levels of map_server: unknown, occupied, free
TO_LEVELS = (
    "use the elevation model from which it was drawn, or, if its colours are gray levels of "
    "heights, convert it: gdal_translate {} in.png out.tif"
)
TO_GRAY = "keep only the band of heights: gdal_translate -b 1 in.tif out.tif"
TO_TURNED = "turn it, or, if its rows do so, omit the tag: gdal_translate in.tif out.tif"
TO_REAL = "convert them: gdal_translate -ot Float32 in.tif out.tif"
TO_HEIGHTS = (
    "change their sign and state the horizontal system alone: gdal_calc.py -A in.tif --calc=-A "
    "--outfile=out.tif, gdal_edit.py -a_srs EPSG:... out.tif"
)
DOWN = re.compile(r",\s*down\b", re.IGNORECASE)  # direction of an axis
VERTICAL_UNIT = re.compile(r'VERT_CS\[.*?UNIT\["([^"]*)"')
TO_BAND = "use the map of heights, or, if the band contains heights, describe it as 'height'"
# in names of bands
NOT_HEIGHTS = re.compile(r"(?<![a-z])(slope|aspect|hillshade|depth|roughness)", re.IGNORECASE)
TO_METRES = "gdalwarp -t_srs {} in.tif out.tif"
Registration = Literal["area", "point"]
T = TypeVar("T")
WORDS = {
    "area": "heights at the centres of cells (pixel is area)",
    "point": "heights at nodes (pixel is point)",
}


class Reading(NamedTuple):
    """Information that the user gives about a map file."""

    window: Window | None = None  # x_min, x_max, y_min, y_max of the part to read [m] or [deg]
    cell: float | None = None  # width of a cell of a raster without coordinates [m]
    # of a raster without coordinates: values at the centres of cells, so that the border is half a
    # cell outside the first node (``"area"``), or at nodes (``"point"``)
    registration: Registration | None = None
    spacing: float | None = None  # distance between nodes for scattered points and point clouds [m]
    vertical_scale: float | None = None  # metres per unit of the heights; None if gray or metres


class _Place(NamedTuple):
    """Georeferencing of a raster: positions of its nodes."""

    x: UniformAxis  # uniform coordinates of the nodes [m or deg]
    y: UniformAxis
    upward: bool  # whether the first row of the raster is the southernmost
    registration: str  # as in `Reading`
    crs: str  # name of the coordinate reference system; empty if unknown
    geographic: bool  # whether the coordinates are degrees
    placed: (
        bool  # whether the file contains the coordinates; else the user gives cell, registration
    )


def read_raster(path: Path, ask: Reading) -> Heights:
    """Return the heights in a raster file of a format that GDAL reads from one file."""
    return _use_dataset(path, lambda file, placed: _from_dataset(file, path, ask, placed))


class RasterParts(NamedTuple):
    """A raster of which parts are read: its axes, and the slices of nodes in a window."""

    path: Path
    ask: Reading
    axes: tuple[UniformAxis, UniformAxis]
    inside: tuple[slice, slice]

    @property
    def nodes(self) -> tuple[Array, Array]:
        """Coordinates of the nodes in the window [m or deg]."""
        x, y = (axis.nodes(part) for axis, part in zip(self.axes, self.inside, strict=True))
        return x, y

    def heights(self, i: slice, j: slice) -> Heights:
        """Return the heights of slices of the nodes in the window; at least four are read."""
        ends, cuts = [], []
        for axis, whole, part in zip(self.axes, self.inside, (i, j), strict=True):
            start = max(whole.start, min(whole.start + part.start, whole.stop - 4))
            stop = max(whole.start + part.stop, start + 4)
            ends += [axis.first + axis.step * (k + 0.5) for k in (start - 1, stop - 1)]
            cuts.append(slice(whole.start + part.start - start, whole.start + part.stop - start))
        with naming(self.path):
            heights = read_raster(self.path, self.ask._replace(window=tuple(ends)))
        a, b = cuts
        return heights._replace(x=heights.x[a], y=heights.y[b], z=heights.z[a, b])


def raster_parts(path: Path, ask: Reading) -> RasterParts:
    """Return a raster of which parts are read; its window may have any number of nodes."""

    def measure(file: Any, is_placed: bool) -> RasterParts:
        _check_band(path, file)
        x, y, *_ = _place(file, ask, is_placed)
        return RasterParts(path, ask, (x, y), parts(x, y, ask.window, most=math.inf))

    with naming(path):
        return _use_dataset(path, measure)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Put the name of a file before messages of the block."""
    try:
        yield
    except DataError as error:
        if str(error).startswith(f"{path}:"):
            raise
        raise type(error)(f"{path}: {error}") from error


def _use_dataset(path: Path, use: Callable[[Any, bool], T]) -> T:
    """Return the result of a function of an open raster, and of whether it has coordinates."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    ending = path.suffix.lower()
    with path.open("rb") as file:
        head = file.read(4)  # raises I/O errors, which GDAL would hide
    content = b""
    if head.startswith((b"P2", b"P5")):
        content = _raw_pgm(path.read_bytes())
    elif head.startswith(BOM_UTF8):  # text of editors of Windows
        content = path.read_bytes()[len(BOM_UTF8) :]
    # the name of an SRTM tile gives its position; others may have characters that GDAL rejects
    name = path.name if ending == ".hgt" else f"raster{ending if ending.isascii() else ''}"

    def open_alone(asked: str, mode: str = "rb") -> BinaryIO:
        # GDAL looks for masks, world files, .aux.xml and other files beside a raster, which can
        # change heights and coordinates, or refer to network addresses
        if Path(asked).name != name or not mode.startswith("r"):
            raise FileNotFoundError(asked)
        return io.BytesIO(content) if content else opened.enter_context(path.open("rb"))

    try:
        # the stack closes the streams of files that GDAL cannot read
        with ExitStack() as opened, _quiet_log(), rasterio.Env(GDAL_CACHEMAX=CACHE):
            noted = opened.enter_context(warnings.catch_warnings(record=True))
            warnings.simplefilter("always", NotGeoreferencedWarning)
            if head in BY_NAME:  # link it in a folder without other files, which GDAL would read
                if head in CLASSIC:  # whose library allocates as much memory as a header claims
                    try:
                        with path.open("rb") as stream, scipy.io.netcdf_file(stream, mmap=True):
                            pass
                    except DAMAGED as error:
                        raise DataError(
                            "expected a readable netCDF file, found a damaged header; copy or "
                            "download it again"
                        ) from error.with_traceback(None)
                folder = Path(opened.enter_context(TemporaryDirectory()))
                (folder / name).symlink_to(path.resolve())
                dataset = rasterio.open(folder / name, driver=BY_NAME[head])
            else:
                dataset = _first_dataset(name, open_alone)
            with dataset:
                # without georeferencing some drivers return an uninitialized transform
                is_warned = any(each.category is NotGeoreferencedWarning for each in noted)
                is_placed = not is_warned and not dataset.transform.is_identity
                return use(dataset, is_placed)
    except DataError:
        raise
    except Exception as error:  # GDAL raises various exceptions for damaged files
        words = re.sub(rf"[^\s']*{re.escape(name)}", path.name, str(error.__cause__ or error))
        hint = TABLE["beginnings"].get(ending, "") if UNKNOWN in words else ""
        raise DataError(
            f"expected a readable {FORMATS.get(ending, 'raster')}, found {words.rstrip('.')}; "
            f"{hint}copy or download it again: it may be truncated or damaged"
        ) from error


def _first_dataset(name: str, opener: Callable[..., BinaryIO]) -> Any:
    """Return the open dataset of the first driver that can read a file, or raise its error."""
    import rasterio
    from rasterio.errors import RasterioIOError

    known: RasterioIOError | None = None
    for driver in TABLE["drivers"]:
        try:
            return rasterio.open(name, driver=driver, opener=opener, **OPTIONS.get(driver, {}))
        except RasterioIOError as error:
            words = str(error.__cause__ or error)
            if known is None or (UNKNOWN in str(known.__cause__ or known) and UNKNOWN not in words):
                known = error
    raise known or RasterioIOError(UNKNOWN)


@contextmanager
def _quiet_log() -> Iterator[None]:
    """Hide errors of rasterio's log, which cannot decode all messages of GDAL.

    They are raised in a callback of GDAL, where no code can catch them; reading goes on.
    """
    hooks = sys.excepthook, sys.unraisablehook

    def quiet(hook: Callable[..., Any], *found: Any) -> None:  # a type, or an object that has it
        if not issubclass(getattr(found[0], "exc_type", found[0]), UnicodeDecodeError):
            hook(*found)

    sys.excepthook, sys.unraisablehook = (partial(quiet, hook) for hook in hooks)
    try:
        yield
    finally:
        sys.excepthook, sys.unraisablehook = hooks


def _raw_pgm(content: bytes) -> bytes:
    """Return a PGM picture with binary levels and a short header, all of which GDAL reads.

    GDAL does not read levels as text, and replaces missing levels by 0.
    """
    again = "copy or download it again"
    header = PGM_HEADER.match(content)
    if header is None:
        refuse("width, height and maximum of a PGM picture", repr(content[:SHOWN]), again)
    width, height, most = (int(word) for word in header.groups()[1:])
    kind, data = np.dtype(">u2" if most > 255 else "u1"), content[header.end() :]
    if header[1] == b"5":
        levels = np.frombuffer(data, kind, len(data) // kind.itemsize)
    else:
        words = re.sub(rb"#[^\r\n]*", b"", data).split()
        if wrong := next((word for word in words if not word.isdigit()), None):
            refuse("whole numbers as levels of a PGM picture", repr(wrong.decode("latin1")), again)
        levels = np.array([int(word) for word in words])
    if levels.size != width * height or not levels.max(initial=0) <= most < 2**16:
        refuse(
            f"{width * height} levels from 0 to {most}, at most 65535",
            f"{levels.size} levels to {levels.max(initial=0)}",
            again,
        )
    return b"P5\n%d %d\n%d\n" % (width, height, most) + levels.astype(kind).tobytes()


def _from_dataset(file: Any, path: Path, ask: Reading, is_placed: bool) -> Heights:
    """Return the heights in a window of an open raster, in metres and with rising y."""
    _check_band(path, file)
    place = _place(file, ask, is_placed)
    i, j = parts(place.x, place.y, ask.window)
    x, y = place.x.nodes(i), place.y.nodes(j)
    top = j.start if place.upward else place.y.size - j.stop
    rows = range(top, top + j.stop - j.start)
    window = (rows.start, rows.stop), (i.start, i.stop)
    if file.count > 1 and np.ptp(file.read((1, 2, 3), window=window), axis=0).any():
        refuse("heights", "the colours of a picture", TO_LEVELS.format("-b 1"))
    if file.driver in KEYS:
        _check_numbers(path, file.driver, file.shape, rows)
    crs = place.crs or ("CRS not given" if place.placed else "placed by cell and registration")
    source = f"{TABLE['names'].get(file.driver, file.driver)} of {file.dtypes[0]}"
    scale, offset, unit = file.scales[0], file.offsets[0], _unit_name(file)
    factor = f", times terrain.vertical_scale = {ask.vertical_scale or 1:g}"
    factor = FEET if ask.vertical_scale is None else factor
    words = "in metres" if unit else f"unit not stated: taken as metres{factor}"
    if _unit(file) != 1:
        words = f"converted from {unit} ({_unit(file):.9g} m)"
    if (scale, offset) != (1, 0):
        words = f"values of the file x {scale:.9g} + {offset:.9g}, {words}"
    facts = (
        ("ground map", f"{source}, {crs}, {WORDS[place.registration]}"),
        ("ground map heights", words),
        *scale_facts(file.crs, x.mean(), y.mean(), TO_METRES),
    )
    values = file.read(1, window=window, masked=True, out_dtype=np.float64)
    # a picture has gray levels: unsigned numbers, of 8 bits or without coordinates
    kind = np.dtype(file.dtypes[0])
    is_picture = kind.kind == "u" and (scale, offset) == (1, 0) and not unit
    is_picture &= kind.itemsize == 1 or (file.crs is None and not is_placed)
    if is_picture and OCCUPANCY[0] in values and not np.setdiff1d(values, OCCUPANCY).size:
        refuse(
            "heights",
            f"only the levels {', '.join(map(str, OCCUPANCY))} of an occupancy map of ROS",
            "use an elevation map",
        )
    if is_picture and file.tags(ns="IMAGE_STRUCTURE").get("MINISWHITE"):
        invert = f"gdal_calc.py -A in.tif --calc={np.iinfo(kind).max}-A --outfile=out.tif"
        refuse("gray levels that rise to white", "levels that fall (MINISWHITE)", invert)
    marker = float(file.tags(1).get("missing_value", "nan"))  # in netCDF besides _FillValue
    raw = np.where(np.isclose(values.data, marker, 1e-6, 0), np.nan, values.filled(np.nan))
    raw = np.ascontiguousarray((raw if place.upward else raw[::-1]).T)
    if not is_picture or ask.vertical_scale is not None:
        degree = DEGREE if place.geographic else 1.0
        check_values(
            raw,
            lambda k: f"x = {x[k[0]]:.9g}, y = {y[k[1]]:.9g}",
            partial(_declaration, file, path.name),
            metres=abs(scale) * _unit(file) * (ask.vertical_scale or 1.0),
            steps=(degree * place.x.step, degree * place.y.step),
        )
    return Heights(
        x,
        y,
        (raw * scale + offset) * _unit(file),
        facts,
        place.crs,
        place.geographic,
        place.placed,
        gray=is_picture,
    )


def _declaration(file: Any, name: str, _: Marker, value: str) -> str:
    """Return the command that declares a value of a raster as missing."""
    declared = file.nodata
    if declared is not None and np.isfinite(declared):
        return (
            f"replace it by the declared value: gdal_calc.py -A {name} --outfile=out.tif "
            f'--calc="numpy.where(A == {value}, {declared:.15g}, A)" --NoDataValue={declared:.15g}'
        )
    if file.driver == "AAIGrid":
        return f"declare it by the line NODATA_value {value} at the end of the header"
    if file.driver in EDITABLE:
        return f"declare it: gdal_edit.py -a_nodata {value} {name}"
    return f"declare it: gdal_translate -a_nodata {value} {name} out.tif"


def _check_numbers(path: Path, driver: str, shape: tuple[int, int], used: range) -> None:
    """Raise DataError for a raster as text with other words than its driver expects.

    GDAL reads ``abc`` as 0, ``1,2`` as 1.2 and ``1D3`` as 1, takes a comment for heights, and
    ignores text behind the last height.
    """
    known, keys, found, lines = KEYS[driver].encode().split(), set[bytes](), 0, 0.0
    # after its key, a grid of Surfer has sizes and limits, and rows from the south
    first, used = (8, range(shape[0])) if driver == "GSAG" else (0, used)
    total = first + math.prod(shape)
    with path.open("rb") as file:
        for n, words in enumerate(map(bytes.split, file), start=1):
            key = b"".join(words[:1]).lower().removeprefix(BOM_UTF8)
            is_key = not found and key in known and len(words) == (1 if first else 2)
            if is_key and key in keys:
                refuse(f"one {key.decode()!r} in the header", f"another in line {n}", "remove one")
            rows = range((found - first) // shape[1], (found - first + len(words)) // shape[1] + 1)
            is_used = not found or (rows.start < used.stop and used.start < rows.stop)
            numbers = words[is_key:] if is_used else []
            wrong = next((word for word in numbers if not NUMBER.fullmatch(word)), None)
            if wrong is not None:
                # separators of columns, of thousands, or decimals
                change = "', ' ' '" if wrong.count(b".") > 1 else "-d ," if b"." in wrong else ", ."
                command = f": tr {change} < {shlex.quote(path.name)} > points.asc" * (b"," in wrong)
                others = "" if found else f", or a key with its number ({KEYS[driver]})"
                refuse(
                    f"numbers in line {n}{others}",
                    repr(wrong.decode(errors="replace")[:SHOWN]),
                    f"write numbers with decimal points, separated by blanks{command}",
                )
            if is_key:
                keys.add(key)
                continue
            if first <= found < total:
                lines += 1 if len(words) == shape[0] else -math.inf
            found += len(words)
    if driver == "AAIGrid" and not (
        keys >= {b"xllcorner", b"yllcorner"} or keys >= {b"xllcenter", b"yllcenter"}
    ):
        refuse(
            "xllcorner and yllcorner, or xllcenter and yllcenter, in the header",
            b", ".join(sorted(key for key in keys if key[1:4] == b"llc")).decode() or "none",
            "add or correct them",
        )
    if found != total:
        refuse(
            f"{total - first} heights, ncols times nrows",
            f"{found - first}",
            "correct the header, or copy the file again",
        )
    if shape[0] != shape[1] == lines:
        refuse(
            f"{shape[0]} rows of {shape[1]} heights",
            f"{shape[1]} rows of {shape[0]}",
            "exchange the numbers of columns and rows in the header",
        )


def _unit_name(file: Any) -> str:  # of the heights, else of the vertical reference system
    vertical = VERTICAL_UNIT.search(file.crs.to_wkt()) if file.crs else None
    return file.units[0] or (vertical[1] if vertical else "")


def _unit(file: Any) -> float:  # of the heights, NaN if it is not known [m]
    return LENGTHS.get(_unit_name(file).strip("[]() ").lower(), math.nan)


def _check_band(path: Path, file: Any) -> None:
    """Raise DataError unless a file has one band of heights, upward in a known unit of length.

    GDAL ignores the tag by which programs turn or mirror a picture.
    """
    colours = [band.name for band in file.colorinterp[:3]]
    if file.subdatasets:
        names = [re.sub(r'[^:]*\braster(\.\w+)?"?', r"in\1", each) for each in file.subdatasets]
        remedy = f"keep one: gdal_translate {names[0]} out.tif"
        refuse("one raster of heights", ", ".join(names), remedy)
    if file.count != 1 and colours != ["red", "green", "blue"]:
        refuse("one band of heights", f"{file.count} bands", TO_GRAY)
    name = file.descriptions[0] or file.tags(1).get("NETCDF_VARNAME", "")
    if NOT_HEIGHTS.search(name):
        refuse("a band of heights, positive upward", f"one named {name!r}", TO_BAND)
    kind = np.dtype(file.dtypes[0]).kind
    if kind not in "iuf":
        refuse("heights that are real numbers", f"the type {file.dtypes[0]}", TO_REAL)
    palette = file.colormap(1) if colours[0] == "palette" else {}
    if any((k, k, k) != colour[:3] for k, colour in palette.items()):
        refuse("heights", "colours of a palette", TO_LEVELS.format("-expand gray"))
    if not math.isfinite(file.offsets[0]) or not 0 < abs(file.scales[0]) < math.inf:
        refuse(
            "a scale of the heights other than 0, and an offset, both finite",
            f"the scale {file.scales[0]:g} and the offset {file.offsets[0]:g}",
            "correct them: gdal_translate -a_scale 1 -a_offset 0 in.tif out.tif",
        )
    if math.isnan(_unit(file)):
        refuse(
            "heights in a unit of length",
            f"the unit {_unit_name(file)!r}",
            f"correct it with gdal_edit.py -units; known units: {', '.join(sorted(LENGTHS)[1:])}",
        )
    wkt = file.crs.to_wkt() if file.crs else ""
    tags = file.tags(1)
    is_depth = tags.get("positive") == "down" or "depth" in tags.get("standard_name", "")
    if is_depth or DOWN.search(wkt):
        refuse("heights that are positive upward", "depths, positive downward", TO_HEIGHTS)
    if file.driver in PICTURES:
        from PIL import Image, UnidentifiedImageError

        # Pillow does not read all rasters of GIS
        with suppress(UnidentifiedImageError, Image.DecompressionBombError), Image.open(path) as im:
            if (turned := im.getexif().get(ORIENTATION, 1)) != 1:
                found = f"the orientation {turned} of a picture"
                refuse("rows from north to south", found, TO_TURNED)


def _place(file: Any, ask: Reading, is_placed: bool) -> _Place:
    """Return the node positions by the file, else by ``ask.cell`` and ``ask.registration``."""
    if file.gcps[0]:
        refuse(
            "a raster on a grid along x and y",
            f"{len(file.gcps[0])} ground control points",
            "resample it: gdalwarp in.tif out.tif",
        )
    if not is_placed and file.driver == "netCDF":
        refuse(
            "uniform coordinates x and y, with an attribute axis or standard_name",
            "none",
            "name them with xarray: d.x.attrs['axis'] = 'X'; d.y.attrs['axis'] = 'Y'",
        )
    if not is_placed:
        if ask.cell is None or ask.registration is None:
            missing = [key for key in ("cell", "registration") if getattr(ask, key) is None]
            refuse(
                f"{' and '.join(missing)} for a raster without coordinates",
                "none",
                'set cell, the width of a cell in metres, and registration: "area" if values '
                'are at centres of cells, "point" if the outermost values are on the border, '
                "and for a picture vertical_scale, the metres per gray level, as in --set "
                "terrain.cell=0.5 --set terrain.registration=area; world files (such as .tfw) are "
                "not read: gdal_translate in.tif out.tif writes them into the raster",
            )
        first = ask.cell / 2 if ask.registration == "area" else 0.0
        x, y = UniformAxis(first, ask.cell, file.width), UniformAxis(first, ask.cell, file.height)
        return _Place(x, y, False, ask.registration, "", False, placed=False)
    for name in ("cell", "registration"):
        if (value := getattr(ask, name)) is not None:
            refuse(
                f"no {name!r} for a raster that contains coordinates",
                f"{name} = {value!r}",
                f"remove {name!r}, or correct the coordinates in the file with gdal_edit",
            )
    # the hemisphere of the zone is in a file beside it
    crs = None if file.driver == "BT" and file.crs and file.crs.is_projected else file.crs
    registration = file.tags().get("AREA_OR_POINT", "Area").lower()
    # GDAL's transform maps corners of pixels to coordinates for both registrations:
    # x = a column + b row + c, y = d column + e row + f
    a, b, c, d, e, f = tuple(file.transform)[:6]
    # rotation and shear may move the last row and column by a thousandth of a cell
    if abs(b) * file.height + abs(d) * file.width > 1e-3 * min(a, abs(e)) or a <= 0 or e == 0:
        refuse(
            "rows that run along x, from west to east",
            f"a raster that is rotated, sheared or mirrored (x = {a:g} column + {b:g} row + ..., "
            f"y = {d:g} column + {e:g} row + ...)",
            "resample it along x and y: gdalwarp in.tif out.tif",
        )
    south = f + (e / 2 if e > 0 else e * (file.height - 0.5))
    x, y = UniformAxis(c + a / 2, a, file.width), UniformAxis(south, abs(e), file.height)
    middle = (axis.first + axis.step * (axis.size - 1) / 2 for axis in (x, y))
    name, geographic = system_name(crs, TO_METRES, *middle)
    geographic |= file.driver == "netCDF" and _in_degrees(file, x, y)
    return _Place(x, y, e > 0, registration, name, geographic, placed=True)


def _in_degrees(file: Any, x: UniformAxis, y: UniformAxis) -> bool:
    """Return whether coordinates of a netCDF file are degrees; DataError if they are not the axes.

    GDAL takes the last dimension for x, trusts copies of the coordinates, and ignores their units.
    """
    import rasterio

    tags, is_degrees = file.tags(), False
    for name in sorted({key.partition("#")[0] for key in tags if "#" in key}):
        unit, *words = (tags.get(f"{name}#{key}", "") for key in ("units", "axis", "standard_name"))
        roles = (COORDINATES.get(word) for word in (name.lower(), *words))
        role = next(filter(None, roles), "")
        if not role:
            continue
        with rasterio.open(f"netcdf:{file.name}:{name}") as column:
            values = column.read(1)
        if len(values) > 1:  # of each node
            continue
        axis = x if role == "x" else y
        part = slice(None) if values.size == axis.size else [0, -1]
        wrong = np.sort(values[0])[part] - axis.nodes(slice(0, axis.size))[part]
        if unit.startswith("degree"):
            is_degrees = True
            wrong = (wrong + 180) % 360 - 180
        elif LENGTHS.get(unit.lower()) != 1:
            refuse(f"coordinates {name} in metres or degrees", f"the unit {unit!r}", "convert them")
        if values.size != axis.size or np.abs(wrong).max() > axis.step / 4:
            refuse(
                f"heights along uniform {name} from {values[0, 0]:.9g} to {values[0, -1]:.9g}",
                f"heights at {role} = {axis.first:.9g} to "
                f"{axis.first + axis.step * (axis.size - 1):.9g} by their dimensions or attributes",
                "write them at uniform places, as by d.interp of xarray, with the dimensions y, x, "
                "without actual_range and GeoTransform",
            )
    return is_degrees


NINES = re.compile(r"-?9{3,}(\.[09]+)?")  # -999, -9999, 99999.9
BEYOND_EARTH = 1e4  # values above it are no heights of the ground [units of the file]
MAX_SORTED = 500_000  # largest number of heights that are sorted
MARKERS = 4  # largest number of different markers in a file
RATIO = 10.0  # least distance of a marker from other heights, relative to the gaps among these
# least distances of a value from all other heights that relief cannot explain [m]
NAMED_GAP, LOW_GAP, MIDDLE_GAP, DEEP_GAP, HIGH_GAP = 30.0, 50.0, 100.0, 300.0, 1000.0
MAX_SHARE = 0.1  # largest share of nodes with a marker near other heights [1]
# least difference of neighbouring nodes [m], slope [1] and ratio to the median of interpolated
# markers, and heights between which there are none [m]
JUMP, SLOPE, STEEPER, PLAUSIBLE = 100.0, 10.0, 50.0, (-1000.0, 10000.0)


class Marker(NamedTuple):
    """A value that is probably a marker of missing heights, in units of the file."""

    value: float  # the extreme one of interpolated markers
    low: float  # range of the other values
    high: float
    is_exact: bool  # repeated exactly, not interpolated between markers and heights


def check_values(
    z: Array,
    place: Callable[[tuple[int, ...]], str],
    remedy: Callable[[Marker, str], str],
    *,
    metres: float = 1.0,
    steps: tuple[float, float] | None = None,
) -> None:
    """Raise DataError if heights contain markers of missing heights.

    ``place(index)`` returns the position of a height as text, ``remedy(marker, text)`` what to do
    with a marker whose value is ``text``. ``metres`` are those of a unit of z. ``steps`` are the
    distances of nodes along x and y [m]; without them, interpolated markers are not found.
    """
    z = np.where(np.isfinite(z), z, np.nan)
    if np.isnan(z).all():
        return
    with np.errstate(over="ignore"):  # differences of the largest numbers
        marker = _repeated_marker(z, metres)
        if marker is None and steps is not None:
            marker = _interpolated_marker(z, metres, steps)
    if marker is None:
        return
    value, low, high, is_exact = marker
    marked = z == value if is_exact else z < low if value < low else z > high
    text = f"{value:.0f}" if value.is_integer() and abs(value) < 1e15 else repr(value)
    first = tuple(int(k[0]) for k in np.nonzero(marked))
    count = f"{np.count_nonzero(marked)} of {z.size} {'nodes' if z.ndim > 1 else 'points'}"
    where = f"at {count}, first at {place(first)}"
    others = f"the others are from {low:.6g} to {high:.6g}"
    if not is_exact:
        raise DataError(
            f"expected heights, found steps between neighbours too steep for ground, and {text} "
            f"{where}, while {others}: probably markers of missing heights that were interpolated; "
            "declare their value before resampling, as in gdal_edit.py -a_nodata -9999 original.tif"
        )
    raise DataError(
        f"expected heights, found the value {text} {where}, while {others}: probably missing "
        f"heights that the file does not declare; {remedy(marker, text)}"
    )


def _repeated_marker(z: Array, metres: float) -> Marker | None:
    """Return a value that is far from all others; None without one.

    Distances are judged in metres, of which a unit of z has ``metres``, and relative to the gaps
    among the other heights: maps of few nodes have large gaps. Deep pits without walls are rarer
    than towers.
    """
    finite = z[np.isfinite(z)]
    if np.ptp(finite) * metres < NAMED_GAP:
        return None
    values = _distinct_values(finite)
    gaps = np.diff(values)
    # the largest gap that is not beside a marker, if there are as many markers as there may be
    inner = float(np.sort(gaps)[-MARKERS - 1]) if gaps.size > MARKERS else 0.0
    ends = np.flatnonzero(gaps >= max(NAMED_GAP / metres, RATIO * inner)) + 1
    groups = np.split(np.arange(values.size), ends)
    body = max(  # the ground: not a single usual marker, then most values, then most nodes
        groups,
        key=lambda group: (
            group.size > 1 or not _is_named(values[group[0]]),
            group.size,
            group.size == 1 and np.count_nonzero(finite == values[group[0]]),
        ),
    )
    low, high = float(values[body[0]]), float(values[body[-1]])
    for group in groups:
        value = float(values[group[0]])
        gap = max(low - value, value - high)
        is_one = group.size == 1 or all(_is_named(float(each)) for each in values[group])
        # Distance from the ground from which relief cannot explain a value: it grows with the ratio
        # of the relief to the distance. Of many nodes it is large: the sea below a cliff.
        relief = (high - low) / (low - value) if value < low else np.inf
        required = LOW_GAP if relief <= 1 / RATIO else MIDDLE_GAP if relief <= 1 else DEEP_GAP
        if np.count_nonzero(finite == value) > MAX_SHARE * finite.size:
            required = DEEP_GAP
        required = HIGH_GAP if value > high else required
        required = NAMED_GAP if _is_named(value) else required
        if is_one and gap > 0 and gap * metres >= required:
            return Marker(value, low, high, is_exact=True)
    return None


def _distinct_values(z: Array) -> Array:
    """Return the distinct heights in ascending order, of large maps all extremes and a part."""
    if z.size <= MAX_SORTED:
        return np.unique(z)
    parts = [z[:: z.size // MAX_SORTED]]
    for sign, end in zip((1, -1), np.quantile(parts[0], (0.01, 0.99)), strict=True):
        rest = sign * z[sign * z <= sign * end]
        for _ in range(2 * MARKERS):
            least = rest.min()
            parts.append(sign * least[None])
            rest = rest[rest > least]
            if not rest.size:
                break
    return np.unique(np.concatenate(parts))


def _is_named(value: float) -> bool:
    """Return whether a value is one that programs use for missing heights."""
    return abs(value) >= BEYOND_EARTH or NINES.fullmatch(f"{value:.7g}") is not None


def _interpolated_marker(z: Array, metres: float, steps: tuple[float, float]) -> Marker | None:
    """Return the extreme of values between markers and heights; None without steep steps."""
    lowest, highest = float(np.nanmin(z)), float(np.nanmax(z))
    if PLAUSIBLE[0] <= lowest * metres <= highest * metres <= PLAUSIBLE[1]:
        return None
    rises = [np.abs(np.diff(z, axis=axis)) for axis in (0, 1)]
    steep = any(
        np.nanmax(rise, initial=0.0) * metres >= max(JUMP, SLOPE * step)
        for rise, step in zip(rises, steps, strict=True)
    )
    if not steep:
        return None
    every = np.concatenate([rise[np.isfinite(rise)] for rise in rises])
    jump = float(every.max())
    if jump < STEEPER * np.median(every):
        return None
    plausible = (z * metres >= PLAUSIBLE[0]) & (z * metres <= PLAUSIBLE[1])
    middle = float(np.nanmedian(z[plausible] if plausible.any() else z))  # markers may be most
    near = z[np.abs(z - middle) < jump / 2]
    value = lowest if middle - lowest > highest - middle else highest
    return Marker(value, float(near.min()), float(near.max()), is_exact=False)
