"""Maps from rasters: GeoTIFF by rasterio, common TIFF and PNG by Pillow, with what they lack."""

from __future__ import annotations

import math
import re
import struct
import warnings
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple, NoReturn

import numpy as np

from slipfree.errors import DataError
from slipfree.records import Array
from slipfree.terrain.grid_ops import Axis, Heights, Window, parts

GDAL_NAME = "raster.tif"  # name under which GDAL reads the file
CACHE = 64  # of GDAL for blocks that a window touches [MB]
GEO = "install the reader for every GeoTIFF: pip install 'slipfree[geo]'"
TO_GRAY = "keep the heights alone: gdal_translate -b 1 in.tif out.tif"
TO_METRES = "reproject it to metres: gdalwarp -t_srs EPSG:326xx in.tif out.tif (xx: the UTM zone)"
STRETCH, SPAN = 0.01, 100.0  # by which a metre may be off, and along what it is measured [1], [m]
SPHEROID = re.compile(r'SPHEROID\["[^"]*",([\d.]+),([\d.]+)')
SEMI_MAJOR, ROUND = 6378137.0, 0.01  # of the earth's ellipsoids [m], and how near they are
COMPOUND = re.compile(r'AUTHORITY\["EPSG","(\d+)"\]\],VERT_CS')
LOCAL = ("LOCAL_CS", "ENGCRS")
METRES = {"", "m", "metre", "meter", "metres", "meters"}
Registration = Literal["area", "point"]
WORDS = {
    "area": "heights at the middles of cells (pixel is area)",
    "point": "heights at nodes (pixel is point)",
}
# Tags of TIFF 6.0 and of the GeoTIFF standard, OGC 19-008.
BITS, PHOTOMETRIC, ORIENTATION, SAMPLES, FORMAT = 258, 262, 274, 277, 339
SCALE, TIEPOINT, TRANSFORM, KEYS, METADATA, NODATA = 33550, 33922, 34264, 34735, 42112, 42113
MODEL, RASTER, PROJECTED, GEOGRAPHIC, UNITS, ANGLES, VERTICAL = (
    1024,
    1025,
    3072,
    2048,
    3076,
    2054,
    4099,
)
USER_DEFINED, METRE, DEGREE = 32767, 9001, 9102
UTM = (range(32601, 32661), range(32701, 32761), range(25828, 25839), range(26901, 26924))
EXACT = {(1, 8), (1, 16), (2, 16), (2, 32), (3, 32)}  # sample formats and bits that Pillow keeps
PNG_KINDS = {
    2: "colours",
    3: "a palette of colours",
    4: "grey and transparency",
    6: "colours and transparency",
}


class Reading(NamedTuple):
    """What a user says about a raster.

    Attributes
    ----------
    window : tuple of 4 floats or None
        The part that is wanted: x_min, x_max, y_min, y_max, as in the file. [m] or [deg]
    cell : float or None
        Width of a cell of a raster that does not say it. [m]
    registration : {"area", "point"} or None
        Of such a raster: whether its outer border is that of its cells, half a cell outside the
        first node, or goes through its first node.
    """

    window: Window | None = None
    cell: float | None = None
    registration: Registration | None = None


class _Place(NamedTuple):
    """Where the nodes of a raster lie, and whether its first row is the southernmost."""

    x: Axis
    y: Axis
    upward: bool
    registration: str
    crs: str
    geographic: bool
    placed: bool


def read_tiff(path: Path, ask: Reading) -> Heights:
    """Return the map in a TIFF file: by rasterio if it is there, else by Pillow.

    Raises
    ------
    DataError
        If the file is damaged, does not hold one band of heights on an upright grid in metres or
        degrees, or cannot be read exactly.
    """
    if find_spec("rasterio") is not None:
        return _by_rasterio(path, ask)
    with _opened(path, "TIFF") as image:
        place, nodata = _tiff_place(image, ask)
        return _from_picture(image, place, ask, "TIFF read by Pillow", nodata)


def read_png(path: Path, ask: Reading) -> Heights:
    """Return the map in a PNG file of one grey channel: its values are heights in metres.

    Raises
    ------
    DataError
        If the file is damaged or holds anything but grey values of 8 or 16 bits, or if cell or
        registration are missing.
    """
    with path.open("rb") as file:
        head = file.read(29)
    if head[:8] != b"\x89PNG\r\n\x1a\n" or len(head) < 29:
        _refuse("a PNG file", "something else or its first bytes only", "check the file")
    width, height, bits, kind = struct.unpack(">IIBB", head[16:26])
    if kind != 0 or bits not in (8, 16):
        found = PNG_KINDS.get(kind, f"grey of {bits} bits")
        _refuse("a PNG of grey values of 8 or 16 bits as heights", found, TO_GRAY)
    place = _unplaced(width, height, ask)
    with _opened(path, "PNG") as image:
        if "transparency" in image.info:
            _refuse("grey values alone", "a transparent one", TO_GRAY)
        return _from_picture(image, place, ask, f"PNG of {bits} bits")


def _refuse(expected: str, found: str, remedy: str) -> NoReturn:
    raise DataError(f"expected {expected}, found {found}; {remedy}")


def _unplaced(width: int, height: int, ask: Reading) -> _Place:
    """Return where the nodes of a raster lie that does not say so."""
    if ask.cell is None or ask.registration is None:
        lacking = [
            name
            for name, value in zip(("cell", "registration"), ask[1:], strict=True)
            if value is None
        ]
        _refuse(
            f"{' and '.join(lacking)} for a raster that does not say where it lies",
            "none",
            'give cell, the width of a cell in metres, and registration: "area" if the values '
            'belong to the middles of cells, "point" if the outermost ones lie on the border; a '
            "world file (such as .tfw) is not read: write its content into the raster by "
            "gdal_translate in.tif out.tif",
        )
    first = ask.cell / 2 if ask.registration == "area" else 0.0
    x, y = Axis(first, ask.cell, width), Axis(first, ask.cell, height)
    return _Place(x, y, False, ask.registration, "", False, False)


def _check_unasked(ask: Reading) -> None:
    """Refuse what a raster that lies somewhere says itself."""
    for name, value in zip(("cell", "registration"), ask[1:], strict=True):
        if value is not None:
            _refuse(
                f"no {name} for a file that says it itself",
                f"{name} = {value!r}",
                f"take {name} out, or correct the file by gdal_edit",
            )


def _placed(
    transform: tuple[float, float, float, float, float, float],
    size: tuple[int, int],
    registration: str,
    crs: str,
    *,
    geographic: bool,
) -> _Place:
    """Return where nodes lie by the affine map from the corners of pixels to coordinates.

    ``x = a column + b row + c`` and ``y = d column + e row + f``, columns and rows counted from the
    outer corner of the first pixel, as GDAL does for both registrations.
    """
    a, b, c, d, e, f = transform
    if abs(b) + abs(d) > 1e-12 * (abs(a) + abs(e)) or a <= 0 or e == 0:
        _refuse(
            "rows that run along x, from west to east",
            f"a raster that is rotated, sheared or mirrored (x = {a:g} column + {b:g} row + ..., "
            f"y = {d:g} column + {e:g} row + ...)",
            "resample it upright: gdalwarp in.tif out.tif",
        )
    width, height = size
    south = f + (e / 2 if e > 0 else e * (height - 0.5))
    return _Place(
        Axis(c + a / 2, a, width),
        Axis(south, abs(e), height),
        e > 0,
        registration,
        crs,
        geographic,
        True,
    )


def _turned(rows: Array, place: _Place) -> Array:
    """Return ``z[i, j]`` at x[i], y[j] from the rows of a raster."""
    return np.ascontiguousarray((rows if place.upward else rows[::-1]).T)


def _told(place: _Place, source: str) -> tuple[tuple[str, str], ...]:
    crs = place.crs or ("CRS not given" if place.placed else "placed by cell and registration")
    return (("ground map", f"{source}, {crs}, {WORDS[place.registration]}"),)


def _heights(place: _Place, part: tuple[slice, slice], rows: Array, source: str) -> Heights:
    x, y = place.x.nodes(part[0]), place.y.nodes(part[1])
    told = _told(place, source)
    return Heights(
        x, y, _turned(rows, place), told, place.crs, place.geographic, placed=place.placed
    )


# ------------------------------------------------------------------------------------- by rasterio


def _by_rasterio(path: Path, ask: Reading) -> Heights:
    """Return the map in a GeoTIFF; only blocks that the window touches are read."""
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    try:
        # GDAL does not close what it opened of a file that it cannot read.
        with (
            ExitStack() as opened,
            warnings.catch_warnings(),
            rasterio.Env(GDAL_CACHEMAX=CACHE),
        ):
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            opener = partial(_open_only, path, opened)
            with rasterio.open(GDAL_NAME, driver="GTiff", opener=opener) as file:
                return _from_dataset(file, ask)
    except DataError:
        raise
    except Exception as error:  # of a damaged file GDAL raises what it happens on
        words = re.sub(rf"/vsi\w+/{GDAL_NAME}", path.name, str(error.__cause__ or error))
        raise DataError(
            f"expected a TIFF file, found one that cannot be read ({words}); is it cut off or "
            "damaged? Copy or download it again"
        ) from error


def _open_only(path: Path, opened: ExitStack, name: str, mode: str = "rb") -> BinaryIO:
    """Open the raster for GDAL, which knows it as `GDAL_NAME` and finds no other file.

    Beside a raster GDAL looks for masks, world files, ``.aux.xml`` and more, which can change
    heights and coordinates, or name an address in the network.
    """
    if Path(name).name != GDAL_NAME or not mode.startswith("r"):
        raise FileNotFoundError(name)
    return opened.enter_context(path.open("rb"))


def _from_dataset(file: Any, ask: Reading) -> Heights:
    _check_band(file)
    place = _dataset_place(file, ask)
    part = i, j = parts(place.x, place.y, ask.window)
    lengths = _lengths(file.crs, place, part)
    top = j.start if place.upward else place.y.size - j.stop
    rows = file.read(
        1,
        window=((top, top + j.stop - j.start), (i.start, i.stop)),
        masked=True,
        out_dtype=np.float64,
    )
    heights = rows.filled(np.nan) * file.scales[0] + file.offsets[0]
    found = _heights(place, part, heights, f"GeoTIFF of {file.dtypes[0]}")
    return found._replace(told=found.told + _scale_facts(file) + lengths)


def _scale_facts(file: Any) -> tuple[tuple[str, str], ...]:
    """Return the scale and the offset that the file applies to its heights, if it has any."""
    scale, offset = file.scales[0], file.offsets[0]
    if (scale, offset) == (1, 0):
        return ()
    return (("ground map heights", f"values of the file x {scale:.9g} + {offset:.9g} m"),)


def _check_band(file: Any) -> None:
    """Refuse what is no single band of heights in metres."""
    if file.count != 1:
        _refuse("one band of heights", f"{file.count} bands", TO_GRAY)
    kind = np.dtype(file.dtypes[0]).kind
    if kind not in "iuf":
        _refuse("heights that are numbers", file.dtypes[0], TO_GRAY)
    if file.colorinterp[0].name == "palette":
        _refuse("heights", "numbers of colours in a palette", "use the map it was drawn from")
    unit = (file.units[0] or "").lower()
    if unit not in METRES:
        _refuse(
            "heights in metres",
            f"the unit {file.units[0]!r}",
            "convert them, for example from feet: gdal_calc.py -A in.tif --calc='A*0.3048' "
            "--type=Float64 --outfile=out.tif",
        )


def _dataset_place(file: Any, ask: Reading) -> _Place:
    if file.gcps[0]:
        _refuse(
            "a raster on an upright grid",
            f"{len(file.gcps[0])} ground control points",
            "resample it: gdalwarp in.tif out.tif",
        )
    if file.transform.is_identity:
        return _unplaced(file.width, file.height, ask)
    _check_unasked(ask)
    registration = file.tags().get("AREA_OR_POINT", "Area").lower()
    crs, geographic = _crs(file.crs)
    size = file.width, file.height
    return _placed(tuple(file.transform)[:6], size, registration, crs, geographic=geographic)


def _crs(crs: Any) -> tuple[str, bool]:
    """Return the name of a coordinate reference system, and whether it has degrees."""
    if crs is None:
        return "", False
    wkt, code = crs.to_wkt(), crs.to_epsg()
    if code is None and (part := COMPOUND.search(wkt)):  # with heights: the one of x and y
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
    """Return how long a metre of a projected map is on the ground; refuse what is far from one.

    In Mercator's projection, that of map tiles, a metre is cos(latitude) metres.
    """
    if crs is None or not crs.is_projected:
        return ()
    x, y = (
        (axis.nodes(each)[0] + axis.nodes(each)[-1]) / 2
        for axis, each in zip((place.x, place.y), part, strict=True)
    )
    found = _metres(crs, x, y)
    if not np.allclose(found, 1.0, rtol=0, atol=STRETCH):  # NaN outside the projection's reach
        _refuse(
            f"a map whose metres are metres on the ground, to {100 * STRETCH:g} %",
            f"that one metre is {found[0]:.4g} m along x and {found[1]:.4g} m along y at "
            f"x = {x:.9g}, y = {y:.9g} ({place.crs})",
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
    """Return how long a metre of a projected map along x and along y is on its ellipsoid. [m]."""
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
    except Exception:  # of places beyond its reach PROJ raises what GDAL happens to wrap
        return math.nan, math.nan
    longitude, latitude = (np.radians(each) for each in places)
    w2 = 1 - e2 * math.sin(latitude[0]) ** 2
    east = a / math.sqrt(w2) * np.cos(latitude[0]) * np.diff(longitude)[::2]
    north = a * (1 - e2) / w2**1.5 * np.diff(latitude)[::2]
    along_x, along_y = (np.hypot(east, north) / SPAN).tolist()
    return along_x, along_y


# --------------------------------------------------------------------------------------- by Pillow


@contextmanager
def _opened(path: Path, kind: str) -> Iterator[Any]:
    """Open a picture; turn what Pillow raises into an error with a remedy."""
    from PIL import Image

    remedy = f"is it damaged? If not, {GEO}" if kind == "TIFF" else "is it damaged?"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)  # of damaged tags
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path, formats=[kind]) as image:
                yield image
    except DataError:
        raise
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise DataError(
            f"expected a {kind} that fits into memory, found a larger one ({error}); cut it to a "
            f"window, or make it a GeoTIFF and {GEO}"
        ) from error
    except Exception as error:  # of a damaged file Pillow raises what it happens on
        raise DataError(
            f"expected a {kind} that Pillow can read, found none ({type(error).__name__}: {error})"
            f"; {remedy}"
        ) from error


def _from_picture(
    image: Any, place: _Place, ask: Reading, source: str, nodata: float | None = None
) -> Heights:
    part = i, j = parts(place.x, place.y, ask.window)
    rows = np.asarray(image).astype(np.float64)
    if nodata is not None:
        rows[rows == nodata] = np.nan
    if not place.upward:
        j = slice(place.y.size - j.stop, place.y.size - j.start)
    return _heights(place, part, rows[j, i], source)


def _tiff_place(image: Any, ask: Reading) -> tuple[_Place, float | None]:
    """Return where the pixels of a TIFF lie, and its value of holes; refuse what is not exact."""
    tags: Mapping[int, Any] = image.tag_v2
    _check_tiff(image, tags)
    size = image.size
    nodata = float(str(tags[NODATA]).strip("\0 ")) if NODATA in tags else None
    if nodata is not None and tags.get(FORMAT, (1,))[0] == 3:
        nodata = float(np.float32(nodata))
    if TRANSFORM in tags:
        _refuse("a TIFF with one tie point and the size of its pixels", "a transformation", GEO)
    if SCALE not in tags or TIEPOINT not in tags:
        return _unplaced(size[0], size[1], ask), nodata
    _check_unasked(ask)
    keys = _geokeys(tags)
    area = keys.get(RASTER, 1) == 1
    crs, geographic = _geokey_crs(keys)
    (d_x, d_y, *_), tie = tags[SCALE], tags[TIEPOINT]
    if len(tie) != 6:
        _refuse("one tie point", f"{len(tie) // 6}", GEO)
    half = 0.0 if area else 0.5  # from the corner of a pixel to what its tie point means
    west, north = tie[3] - (tie[0] + half) * d_x, tie[4] + (tie[1] + half) * d_y
    transform = d_x, 0.0, west, 0.0, -d_y, north
    registration = "area" if area else "point"
    return _placed(transform, size, registration, crs, geographic=geographic), nodata


def _check_tiff(image: Any, tags: Mapping[int, Any]) -> None:
    """Refuse what Pillow does not read exactly, or what is no band of heights."""
    bands = tags.get(SAMPLES, 1)
    if bands != 1:
        _refuse("one band of heights", f"{bands} bands", TO_GRAY)
    if tags.get(PHOTOMETRIC) == 3:
        _refuse("heights", "numbers of colours in a palette", "use the map it was drawn from")
    kind = tags.get(FORMAT, (1,))[0], tags.get(BITS, (1,))[0]
    wrong = {
        f"samples of {kind[1]} bits and format {kind[0]}": kind not in EXACT,
        "white as zero": tags.get(PHOTOMETRIC) != 1,
        "turned rows": tags.get(ORIENTATION, 1) != 1,
        "several pictures": getattr(image, "n_frames", 1) != 1,
        "heights with a scale or an offset": any(
            word in str(tags.get(METADATA, "")).lower() for word in ('"scale"', '"offset"')
        ),
    }
    found = [words for words, is_so in wrong.items() if is_so]
    if found:
        _refuse("a plain TIFF that Pillow reads exactly", " and ".join(found), GEO)


def _geokeys(tags: Mapping[int, Any]) -> dict[int, int]:
    """Return the short values of the directory of geographic keys."""
    words = tags.get(KEYS, ())
    entries = [words[k : k + 4] for k in range(4, len(words) - 3, 4)]
    return {key: value for key, place, _, value in entries if place == 0}


def _geokey_crs(keys: Mapping[int, int]) -> tuple[str, bool]:
    """Return the name of a reference system by its keys, and whether it has degrees."""
    if not {MODEL, PROJECTED, GEOGRAPHIC} & set(keys):
        return "", False
    geographic = keys.get(MODEL) == 2
    code = keys.get(GEOGRAPHIC if geographic else PROJECTED, USER_DEFINED)
    unit = keys.get(ANGLES) == DEGREE if geographic else keys.get(UNITS) == METRE
    known = geographic or any(code in family for family in UTM)
    if not known or code == USER_DEFINED or not unit or keys.get(VERTICAL, METRE) != METRE:
        _refuse(
            "a UTM reference system in metres, or one in degrees, with a number",
            f"code {code}, unit {keys.get(ANGLES if geographic else UNITS, 'none')}, height "
            f"unit {keys.get(VERTICAL, 'none')}",
            GEO,
        )
    return f"EPSG:{code}", geographic
