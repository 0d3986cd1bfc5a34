"""Maps from raster files, read by rasterio (GDAL): GeoTIFF, ASCII grid, SRTM, DTED, IMG, PNG."""

from __future__ import annotations

import math
import re
import warnings
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, Literal, NamedTuple, NoReturn

import numpy as np

from slipfree.errors import DataError
from slipfree.terrain.grid_ops import Axis, Heights, Window, parts

DRIVERS = {  # GDAL drivers of files that are whole by themselves, by the ending of the file
    ".tif": "GTiff",
    ".tiff": "GTiff",
    ".asc": "AAIGrid",
    ".hgt": "SRTMHGT",
    ".dt0": "DTED",
    ".dt1": "DTED",
    ".dt2": "DTED",
    ".img": "HFA",
    ".png": "PNG",
    ".gpkg": "GPKG",
    ".nc": "netCDF",
    ".grd": "GSBG",
    ".bt": "BT",
    ".ter": "Terragen",
    ".dem": "USGSDEM",
    ".gtx": "GTX",
    ".jp2": "JP2OpenJPEG",
    ".hf2": "HF2",
    ".ntf": "NITF",
    ".pix": "PCIDSK",
    ".map": "PCRaster",
}
FORMATS = {
    "GTiff": "GeoTIFF",
    "AAIGrid": "ESRI ASCII grid",
    "SRTMHGT": "SRTM tile",
    "DTED": "DTED",
    "HFA": "ERDAS IMG",
    "PNG": "PNG",
    "GPKG": "GeoPackage",
}
NAMED = {"SRTMHGT": "name the file after its position, as in N45E006.hgt; if it has such a name, "}
OPTIONS = {"AAIGrid": {"DATATYPE": "Float64"}}  # the default loses digits
GRIDS = {  # drivers of .grd files by their first four bytes
    b"DSBB": "GSBG",
    b"DSRB": "GS7BG",
    b"DSAA": "GSAG",
    b"HGPC": "NWT_GRD",
    b"CDF\x01": "netCDF",
    b"CDF\x02": "netCDF",
    b"CDF\x05": "netCDF",
    b"\x89HDF": "netCDF",
}
CACHE = 64  # GDAL's cache of blocks [MB]
TO_GRAY = "keep the heights alone: gdal_translate -b 1 in.tif out.tif"
TO_METRES = "reproject it to metres: gdalwarp -t_srs EPSG:326xx in.tif out.tif (xx: the UTM zone)"
STRETCH, SPAN = 0.01, 100.0  # largest relative error of lengths, and length of its test [1], [m]
SPHEROID = re.compile(r'SPHEROID\["[^"]*",([\d.]+),([\d.]+)')
SEMI_MAJOR, ROUND = 6378137.0, 0.01  # semi-major axis of the earth [m], and its relative tolerance
COMPOUND = re.compile(r'AUTHORITY\["EPSG","(\d+)"\]\],VERT_CS')
LOCAL = ("LOCAL_CS", "ENGCRS")
METRES = {"", "m", "metre", "meter", "metres", "meters"}
LENGTHS = {  # units of heights [m]
    **dict.fromkeys(METRES, 1.0),
    **dict.fromkeys(("ft", "foot", "feet", "international foot", "international feet"), 0.3048),
    **dict.fromkeys(("us survey foot", "us survey feet", "us-ft", "ftus"), 1200 / 3937),
    **dict.fromkeys(("cm", "centimetre", "centimeter", "centimetres", "centimeters"), 0.01),
    **dict.fromkeys(("dm", "decimetre", "decimeter"), 0.1),
    **dict.fromkeys(("mm", "millimetre", "millimeter"), 0.001),
    **dict.fromkeys(("km", "kilometre", "kilometer"), 1000.0),
}
Registration = Literal["area", "point"]
WORDS = {
    "area": "heights at the middles of cells (pixel is area)",
    "point": "heights at nodes (pixel is point)",
}


class Reading(NamedTuple):
    """Information that the user gives about a map file.

    Attributes
    ----------
    window : tuple of 4 floats or None
        Part to read: x_min, x_max, y_min, y_max in coordinates of the file. [m] or [deg]
    cell : float or None
        Width of a cell of a raster without coordinates. [m]
    registration : {"area", "point"} or None
        Position of the values of a raster without coordinates. ``"area"``: at the centres of cells,
        so that the border is half a cell outside the first node. ``"point"``: at nodes, so that the
        border passes through the first node.
    spacing : float or None
        Distance between nodes for scattered points. [m]
    """

    window: Window | None = None
    cell: float | None = None
    registration: Registration | None = None
    spacing: float | None = None


class _Place(NamedTuple):
    """Positions of the nodes of a raster.

    Attributes
    ----------
    x, y : Axis
        Uniform coordinates of the nodes. [m] or [deg]
    upward : bool
        Whether the first row of the raster is the southernmost.
    registration : {"area", "point"}
        Position of the values, as in `Reading`.
    crs : str
        Name of the coordinate reference system; empty if unknown.
    geographic : bool
        Whether the coordinates are degrees.
    placed : bool
        Whether the file contains the coordinates; otherwise the user gives cell and registration.
    """

    x: Axis
    y: Axis
    upward: bool
    registration: str
    crs: str
    geographic: bool
    placed: bool


def read_raster(path: Path, ask: Reading) -> Heights:
    """Return the heights in a raster file, only inside ``ask.window`` if it is not None.

    Raises
    ------
    DataError
        If the file is damaged, if it does not have one band of heights on an upright grid in metres
        or degrees, or if it has no coordinates and cell or registration is missing.
    """
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    driver = _driver(path)
    # the name of an SRTM tile gives its position; others may have characters that GDAL rejects
    name = path.name if driver == "SRTMHGT" else f"raster{path.suffix.lower()}"
    try:
        # the stack closes the streams of files that GDAL cannot read
        with (
            ExitStack() as opened,
            warnings.catch_warnings(),
            rasterio.Env(GDAL_CACHEMAX=CACHE),
        ):
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            options: dict[str, Any] = dict(OPTIONS.get(driver, {}))
            if driver == "netCDF":  # its library opens files by name only; no file is beside it
                folder = Path(opened.enter_context(TemporaryDirectory()))
                (folder / name).symlink_to(path.resolve())
                source = str(folder / name)
            else:
                source, options["opener"] = name, partial(_open_only, path, name, opened)
            with rasterio.open(source, driver=driver, **options) as dataset:
                return _from_dataset(dataset, path, ask)
    except DataError:
        raise
    except Exception as error:  # GDAL raises various exceptions for damaged files
        words = re.sub(r"/vsi\w+/", "", str(error.__cause__ or error)).replace(name, path.name)
        raise DataError(
            f"expected a readable {FORMATS.get(driver, driver)}, found {words.rstrip('.')}; "
            f"{NAMED.get(driver, '')}copy or download it again: it may be cut off or damaged"
        ) from error


def _driver(path: Path) -> str:
    """Return the GDAL driver of a file, by its ending and, of a .grd file, its first bytes."""
    driver = DRIVERS[path.suffix.lower()]
    with path.open("rb") as file:
        head = file.read(4)  # raises I/O errors, which GDAL would hide
    return GRIDS.get(head, driver) if path.suffix.lower() == ".grd" else driver


def _open_only(path: Path, known: str, opened: ExitStack, name: str, mode: str = "rb") -> BinaryIO:
    """Open the raster file for GDAL; raise FileNotFoundError for all other files.

    GDAL looks for masks, world files, ``.aux.xml`` and other files beside a raster, which can
    change heights and coordinates, or refer to network addresses.
    """
    if Path(name).name != known or not mode.startswith("r"):
        raise FileNotFoundError(name)
    return opened.enter_context(path.open("rb"))


def _refuse(expected: str, found: str, remedy: str) -> NoReturn:
    """Raise DataError with the descriptions of expected and found content, and a remedy."""
    raise DataError(f"expected {expected}, found {found}; {remedy}")


def _from_dataset(file: Any, path: Path, ask: Reading) -> Heights:
    """Return the heights in an open raster."""
    _check_band(file)
    place = _place(file, ask)
    part = i, j = parts(place.x, place.y, ask.window)
    top = j.start if place.upward else place.y.size - j.stop
    rows = range(top, top + j.stop - j.start)
    if file.driver == "AAIGrid":
        _check_numbers(path, file.shape, rows)
    crs = place.crs or ("CRS not given" if place.placed else "placed by cell and registration")
    source = f"{FORMATS.get(file.driver, file.driver)} of {file.dtypes[0]}"
    facts = (
        ("ground map", f"{source}, {crs}, {WORDS[place.registration]}"),
        *_scale_facts(file),
        *_lengths(file.crs, place, part),
    )
    values = file.read(
        1,
        window=((rows.start, rows.stop), (i.start, i.stop)),
        masked=True,
        out_dtype=np.float64,
    )
    heights = (values.filled(np.nan) * file.scales[0] + file.offsets[0]) * _unit(file)
    return Heights(
        place.x.nodes(i),
        place.y.nodes(j),
        np.ascontiguousarray((heights if place.upward else heights[::-1]).T),
        facts,
        place.crs,
        place.geographic,
        place.placed,
        gray=file.driver == "PNG",
    )


def _check_numbers(path: Path, shape: tuple[int, int], used: range) -> None:
    """Raise DataError for an ASCII grid with missing, surplus or non-numeric words.

    GDAL reads ``abc`` as 0 and ``1,2`` as 1.2, and ignores text behind the last height.
    """
    keys, found, columns = set(), 0, shape[1]
    with path.open("rb") as file:
        for n, words in enumerate(map(bytes.split, file), start=1):
            rows = range(found // columns, (found + len(words)) // columns + 1)
            is_used = not found or (rows.start < used.stop and used.start < rows.stop)
            wrong = _wrong_word(words) if is_used else None
            if wrong is None:
                found += len(words)
            elif not found and len(words) == 2:  # a line of the header: a key and a number
                keys.add(words[0].lower()[:4])
            else:
                _refuse(f"numbers in line {n}", repr(wrong.decode(errors="replace")), "correct it")
    if missing := {b"xllc", b"yllc"} - keys:
        key = min(missing).decode()
        _refuse(f"{key}enter or {key}orner in the header", "none", "add it")
    if found != math.prod(shape):
        _refuse(
            f"{math.prod(shape)} heights, ncols times nrows",
            f"{found}",
            "correct the header, or copy the file again",
        )


def _wrong_word(words: list[bytes]) -> bytes | None:
    """Return the first word that is not a number; None if all words are numbers."""
    word = b""
    try:
        for word in words:
            float(word)
    except ValueError:
        return word
    return None


def _scale_facts(file: Any) -> tuple[tuple[str, str], ...]:
    """Return the scale and offset of the heights as facts; empty if the file has none."""
    scale, offset, unit = file.scales[0], file.offsets[0], file.units[0]
    words = "in metres" if unit else "unit not stated: taken as metres"
    if _unit(file) != 1:
        words = f"converted from {unit} ({_unit(file):.9g} m)"
    if (scale, offset) != (1, 0):
        words = f"values of the file x {scale:.9g} + {offset:.9g}, {words}"
    return (("ground map heights", words),)


def _unit(file: Any) -> float:
    """Return the unit of the heights of a raster [m]."""
    return LENGTHS[(file.units[0] or "").lower()]


def _check_band(file: Any) -> None:
    """Raise DataError unless the file has a single band of heights in metres."""
    if file.count != 1:
        _refuse("one band of heights", f"{file.count} bands", TO_GRAY)
    kind = np.dtype(file.dtypes[0]).kind
    if kind not in "iuf":
        _refuse("heights that are numbers", file.dtypes[0], TO_GRAY)
    if file.colorinterp[0].name == "palette":
        _refuse(
            "heights",
            "colours of a palette",
            "use the elevation model from which the image was drawn",
        )
    if (file.units[0] or "").lower() not in LENGTHS:
        _refuse(
            "heights in a unit of length",
            f"the unit {file.units[0]!r}",
            f"correct it with gdal_edit.py -units; known are {', '.join(sorted(LENGTHS)[1:])}",
        )


def _place(file: Any, ask: Reading) -> _Place:
    """Return the positions of the nodes of a raster.

    They follow from the coordinates in the file, else from ``ask.cell`` and ``ask.registration``.
    """
    if file.gcps[0]:
        _refuse(
            "a raster on an upright grid",
            f"{len(file.gcps[0])} ground control points",
            "resample it: gdalwarp in.tif out.tif",
        )
    if file.transform.is_identity:
        return _place_by_user(file.width, file.height, ask)
    for name in ("cell", "registration"):
        if (value := getattr(ask, name)) is not None:
            _refuse(
                f"no {name} for a raster that contains coordinates",
                f"{name} = {value!r}",
                f"remove {name}, or correct the coordinates in the file with gdal_edit",
            )
    registration = file.tags().get("AREA_OR_POINT", "Area").lower()
    x, y, upward = _axes(file)
    return _Place(x, y, upward, registration, *_crs(file.crs), placed=True)


def _place_by_user(width: int, height: int, ask: Reading) -> _Place:
    """Return the positions of the nodes of a raster without coordinates."""
    if ask.cell is None or ask.registration is None:
        given = {"cell": ask.cell, "registration": ask.registration}
        _refuse(
            f"{' and '.join(name for name, value in given.items() if value is None)} for a raster "
            "without coordinates",
            "none",
            'set cell, the width of a cell in metres, and registration: "area" if the values '
            'belong to the centres of cells, "point" if the outermost values are on the border; '
            "world files (such as .tfw) are not read: write their contents into the raster by "
            "gdal_translate in.tif out.tif",
        )
    first = ask.cell / 2 if ask.registration == "area" else 0.0
    x, y = Axis(first, ask.cell, width), Axis(first, ask.cell, height)
    return _Place(x, y, False, ask.registration, "", False, placed=False)


def _axes(file: Any) -> tuple[Axis, Axis, bool]:
    """Return the axes along x and y, and whether the first row is the southernmost.

    GDAL's transform maps corners of pixels to coordinates for both registrations:
    ``x = a column + b row + c`` and ``y = d column + e row + f``.
    """
    a, b, c, d, e, f = tuple(file.transform)[:6]
    if abs(b) + abs(d) > 1e-12 * (abs(a) + abs(e)) or a <= 0 or e == 0:
        _refuse(
            "rows that run along x, from west to east",
            f"a raster that is rotated, sheared or mirrored (x = {a:g} column + {b:g} row + ..., "
            f"y = {d:g} column + {e:g} row + ...)",
            "resample it upright: gdalwarp in.tif out.tif",
        )
    south = f + (e / 2 if e > 0 else e * (file.height - 0.5))
    return Axis(c + a / 2, a, file.width), Axis(south, abs(e), file.height), e > 0


def _crs(crs: Any) -> tuple[str, bool]:
    """Return the name of a coordinate reference system, and whether its unit is the degree."""
    if crs is None:
        return "", False
    wkt, code = crs.to_wkt(), crs.to_epsg()
    if code is None and (part := COMPOUND.search(wkt)):  # horizontal part of a compound system
        code = int(part[1])
    name = crs.to_string() if code is None else f"EPSG:{code}"
    if not (crs.is_geographic or crs.is_projected or wkt.startswith(LOCAL)):
        _refuse("a projected or a geographic reference system", name, TO_METRES)
    globe = SPHEROID.search(wkt)
    if crs.is_geographic and globe and abs(float(globe[1]) / SEMI_MAJOR - 1) > ROUND:
        _refuse(
            "degrees on the earth",
            f"a body of radius {float(globe[1]):.9g} m ({name})",
            "project it to metres first: gdalwarp -t_srs '+proj=eqc +lat_ts=... +R=...'",
        )
    unit, size = crs.units_factor
    wanted, expected = (math.radians(1), "degrees") if crs.is_geographic else (1.0, "metres")
    if abs(size / wanted - 1) > 1e-9:
        _refuse(f"coordinates in {expected}", f"the unit {unit!r} of {name}", TO_METRES)
    return name, bool(crs.is_geographic)


def _lengths(crs: Any, place: _Place, part: tuple[slice, slice]) -> tuple[tuple[str, str], ...]:
    """Return the scale of a projected map as facts; raise DataError if it is more than 1 % from 1.

    In the Mercator projection of map tiles, one metre of the map is cos(latitude) metres.
    """
    if crs is None or not crs.is_projected:
        return ()
    x, y = (
        (axis.nodes(each)[0] + axis.nodes(each)[-1]) / 2
        for axis, each in zip((place.x, place.y), part, strict=True)
    )
    found = _metres(crs, x, y)
    if not np.allclose(found, 1.0, rtol=0, atol=STRETCH):  # NaN outside the projection's domain
        _refuse(
            f"a map with a scale error of at most {100 * STRETCH:g} %",
            f"that 1 m of the map is {found[0]:.4g} m along x and {found[1]:.4g} m along y on the "
            f"ground at x = {x:.9g}, y = {y:.9g} ({place.crs})",
            TO_METRES,
        )
    return (
        (
            "ground map scale",
            f"1 m of the map is {found[0]:.5f} m along x and {found[1]:.5f} "
            "m along y on the ellipsoid",
        ),
    )


def _metres(crs: Any, x: float, y: float) -> tuple[float, float]:
    """Return the lengths on the ellipsoid of one map metre along x and along y at (x, y) [m]."""
    from rasterio.crs import CRS
    from rasterio.warp import transform

    sizes = SPHEROID.search(crs.to_wkt())
    if sizes is None:
        return math.nan, math.nan
    a, inverse = float(sizes[1]), float(sizes[2])
    e2 = (2 - 1 / inverse) / inverse if inverse else 0.0
    globe = CRS.from_proj4(f"+proj=longlat +a={a!r} +b={a * math.sqrt(1 - e2)!r} +no_defs")
    half = SPAN / 2
    try:
        places = transform(crs, globe, [x - half, x + half, x, x], [y, y, y - half, y + half])
    except Exception:  # PROJ raises various exceptions outside the projection's domain
        return math.nan, math.nan
    longitude, latitude = (np.radians(each) for each in places)
    w2 = 1 - e2 * math.sin(latitude[0]) ** 2
    east = a / math.sqrt(w2) * np.cos(latitude[0]) * np.diff(longitude)[::2]
    north = a * (1 - e2) / w2**1.5 * np.diff(latitude)[::2]
    along_x, along_y = (np.hypot(east, north) / SPAN).tolist()
    return along_x, along_y
