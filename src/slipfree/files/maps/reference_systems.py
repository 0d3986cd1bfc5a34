"""Reference systems of map files: names, units of lengths, and scales of projections."""

from __future__ import annotations

import math
import re
from typing import Any, NoReturn

import numpy as np

from slipfree.errors import DataError

STRETCH, SPAN = 0.01, 100.0  # largest scale error [1], and length over which it is measured [m]
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


def refuse(expected: str, found: str, remedy: str) -> NoReturn:
    """Raise DataError with the descriptions of expected and found content, and a remedy."""
    raise DataError(f"expected {expected}, found {found}; {remedy}")


def system_name(crs: Any, remedy: str) -> tuple[str, bool]:
    """Return the name of a coordinate reference system, and whether its unit is the degree.

    Parameters
    ----------
    crs : rasterio.crs.CRS or None
        Reference system of a file.
    remedy : str
        Command that reprojects such a file to metres, for messages.

    Raises
    ------
    DataError
        If the system is neither projected, geographic nor local, or if its coordinates are neither
        metres nor degrees on the earth.
    """
    if crs is None:
        return "", False
    wkt, code = crs.to_wkt(), crs.to_epsg()
    if code is None and (part := COMPOUND.search(wkt)):  # horizontal part of a compound system
        code = int(part[1])
    name = crs.to_string() if code is None else f"EPSG:{code}"
    if not (crs.is_geographic or crs.is_projected or wkt.startswith(LOCAL)):
        refuse("a projected or a geographic reference system", name, remedy)
    globe = SPHEROID.search(wkt)
    if crs.is_geographic and globe and abs(float(globe[1]) / SEMI_MAJOR - 1) > ROUND:
        refuse(
            "degrees on the earth",
            f"a body of radius {float(globe[1]):.9g} m ({name})",
            "project it to metres first: gdalwarp -t_srs '+proj=eqc +lat_ts=... +R=...'",
        )
    unit, size = crs.units_factor
    wanted, expected = (math.radians(1), "degrees") if crs.is_geographic else (1.0, "metres")
    if abs(size / wanted - 1) > 1e-9:
        refuse(f"coordinates in {expected}", f"the unit {unit!r} of {name}", remedy)
    return name, bool(crs.is_geographic)


def from_degrees(crs: str, longitude: float, latitude: float) -> tuple[float, float]:
    """Return a position in coordinates of a reference system [m or deg].

    Parameters
    ----------
    crs : str
        EPSG code or WKT of the system.
    longitude, latitude : float
        WGS 84 coordinates. [deg]

    Returns
    -------
    tuple of 2 floats
        Coordinates to the east and to the north; not finite outside the domain of the projection.
    """
    from rasterio.crs import CRS
    from rasterio.warp import transform

    try:
        x, y = transform(CRS.from_epsg(4326), CRS.from_string(crs), [longitude], [latitude])
    except Exception:  # PROJ raises various exceptions outside the projection's domain
        return math.nan, math.nan
    return x[0], y[0]


def scale_facts(crs: Any, x: float, y: float, remedy: str) -> tuple[tuple[str, str], ...]:
    """Return the scale of a projected map as facts for summaries.

    In the Mercator projection of map tiles, one metre of the map is cos(latitude) metres.

    Parameters
    ----------
    crs : rasterio.crs.CRS or None
        Reference system of the map; without one, or with degrees, there are no facts.
    x, y : float
        Position where the scale is computed. [m]
    remedy : str
        Command that reprojects such a file to metres, for messages.

    Raises
    ------
    DataError
        If the scale differs from 1 by more than 1 %, or the position is outside the domain of the
        projection.
    """
    if crs is None or not crs.is_projected:
        return ()
    found = _metres(crs, x, y)
    if not np.isfinite(found).all():
        refuse(
            "a map inside the domain of its projection",
            f"no scale at x = {x:.9g}, y = {y:.9g} ({crs.to_string()})",
            "correct the coordinates or the reference system of the file",
        )
    if not np.allclose(found, 1.0, rtol=0, atol=STRETCH):
        refuse(
            f"a map with a scale error of at most {100 * STRETCH:g} %",
            f"that 1 m of the map is {found[0]:.4g} m along x and {found[1]:.4g} m along y on the "
            f"ground at x = {x:.9g}, y = {y:.9g} ({crs.to_string()})",
            remedy,
        )
    return (
        (
            "ground map scale",
            f"1 m of the map is {found[0]:.5f} m along x and {found[1]:.5f} "
            "m along y on the ellipsoid",
        ),
    )


def _metres(crs: Any, x: float, y: float) -> tuple[float, float]:
    """Return the lengths on the ellipsoid of one map metre along x and along y at (x, y) [m].

    They are NaN outside the domain of the projection.
    """
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
