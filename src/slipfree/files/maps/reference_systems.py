"""Reference systems of map files: names, units of lengths, and scales of projections."""

from __future__ import annotations

import math
import re
from typing import Any, NoReturn

import numpy as np

from slipfree.core.errors import DataError
from slipfree.core.records import Array
from slipfree.files.tables import UNIT_FACTORS

STRETCH, SPAN = 0.01, 1000.0  # largest scale error [1], and length over which it is measured [m]
SPHEROID = re.compile(r'SPHEROID\["[^"]*",([\d.]+),([\d.]+)')
SEMI_MAJOR, ROUND = 6378137.0, 0.01  # semi-major axis of the earth [m], and its relative tolerance
UTM = -80.0, 84.0  # latitudes at which UTM is used, UPS beyond [deg]
COMPOUND = re.compile(r'AUTHORITY\["EPSG","(\d+)"\]\],VERT_CS')
UNKNOWN_ZONE = "EPSG:326xx (xx: the UTM zone)"
LOCAL = ("LOCAL_CS", "ENGCRS")
LENGTHS = {"": 1.0, **UNIT_FACTORS["m"], **UNIT_FACTORS["heights"]}  # units of heights [m]


def refuse(expected: str, found: str, remedy: str) -> NoReturn:
    """Raise DataError with the descriptions of expected and found content, and a remedy."""
    raise DataError(f"expected {expected}, found {found}; {remedy}")


def system_name(crs: Any, command: str, x: float, y: float) -> tuple[str, bool]:
    """Return the name of a coordinate reference system, and whether its unit is the degree.

    ``x``, ``y`` is a point of the map, for which the remedy in an error names a metric system;
    ``command`` is the program that reprojects the file. Systems that maps cannot have are refused.
    """
    if crs is None:
        return "", False
    wkt, code = crs.to_wkt(), crs.to_epsg()
    if code is None and (part := COMPOUND.search(wkt)):  # horizontal part of a compound system
        code = int(part[1])
    name = crs.to_string() if code is None else f"EPSG:{code}"
    remedy = reprojection(crs, command, x, y)
    if not (crs.is_geographic or crs.is_projected or wkt.startswith(LOCAL)):
        refuse("a projected or a geographic reference system", name, remedy)
    if crs.is_geographic and not _is_earth(crs):
        radius = f"a body of radius {_ellipsoid(crs)[0]:.9g} m ({name})"
        refuse("degrees on the earth", radius, remedy)
    if ",WEST]" in wkt:  # of an axis: the map would be turned or mirrored
        refuse("coordinates to the east and to the north", f"axes to the west of {name}", remedy)
    unit, size = crs.units_factor
    wanted, expected = (math.radians(1), "degrees") if crs.is_geographic else (1.0, "metres")
    if abs(size / wanted - 1) > 1e-9:
        if wkt.startswith(LOCAL):
            remedy = (
                f"multiply the coordinates by {size:.9g} and remove the system: gdal_translate "
                '-a_srs "" -a_ullr ULX ULY LRX LRY in.tif out.tif'
            )
        refuse(f"coordinates in {expected}", f"the unit {unit!r} of {name}", remedy)
    return name, bool(crs.is_geographic)


def metric_system(longitude: float, latitude: float) -> str:
    """Return the projection of UTM or UPS that is used at a position on the earth [deg]."""
    if not math.isfinite(longitude + latitude):
        return UNKNOWN_ZONE
    if not UTM[0] <= latitude <= UTM[1]:
        return "EPSG:5041" if latitude > 0 else "EPSG:5042"
    zone = int((longitude + 180) // 6) % 60 + 1
    return f"EPSG:{326 if latitude >= 0 else 327}{zone:02d}"


def reprojection(crs: Any, command: str, x: float, y: float) -> str:
    """Return the advice to project a map to metres of its own body.

    ``command`` has ``{}`` for the new system; the centre (x, y) of the map is in units of the
    system, NaN if unknown.
    """
    longitude, latitude = (float(each[0]) for each in _degrees(crs, [x], [y]))
    system = metric_system(longitude, latitude)
    if not _is_earth(crs):
        centre = f"+lat_0={latitude:.6g} +lon_0={longitude:.6g}"
        if not math.isfinite(longitude + latitude):
            centre = "+lat_0=... +lon_0=..."
        a, b = _ellipsoid(crs)
        system = f"'+proj=stere {centre} +a={a:.10g} +b={b:.10g} +units=m'"
    return f"reproject it to metres: {command.format(system)}"


def semi_major_axis(name: str) -> float:
    """Return the semi-major axis of the body of a reference system, NaN if unknown [m]."""
    if not name:
        return math.nan
    from rasterio.crs import CRS

    return _ellipsoid(CRS.from_string(name))[0]


def _ellipsoid(crs: Any) -> tuple[float, float]:
    """Return the semi-axes of the ellipsoid of a reference system, NaN without one [m]."""
    sizes = SPHEROID.search(crs.to_wkt())
    if sizes is None:
        return math.nan, math.nan
    a, inverse = float(sizes[1]), float(sizes[2])
    return a, a * (1 - 1 / inverse) if inverse else a


def _is_earth(crs: Any) -> bool:
    """Return whether the ellipsoid of a reference system is one of the earth, or unknown."""
    return not abs(_ellipsoid(crs)[0] / SEMI_MAJOR - 1) > ROUND


def _degrees(crs: Any, x: list[float], y: list[float]) -> Array:
    """Return longitudes and latitudes, shape (2, n), NaN outside the domain of the system [deg]."""
    a, b = _ellipsoid(crs)
    return _transformed(crs, f"+proj=longlat +a={a!r} +b={b!r} +no_defs", x, y)


def _transformed(source: Any, target: str, x: list[float], y: list[float]) -> Array:
    """Return coordinates in another reference system, shape (2, n), NaN outside its domain."""
    from rasterio.crs import CRS
    from rasterio.warp import transform

    try:
        return np.array(transform(source, CRS.from_user_input(target), x, y))
    except Exception:  # PROJ raises various exceptions outside the projection's domain
        return np.full((2, len(x)), np.nan)


def from_degrees(crs: str, longitude: float, latitude: float) -> tuple[float, float]:
    """Return a WGS 84 position [deg] in a reference system; not finite outside its domain."""
    (x,), (y,) = _transformed("EPSG:4326", crs, [longitude], [latitude]).tolist()
    return x, y


def scale_facts(crs: Any, x: float, y: float, command: str) -> tuple[tuple[str, str], ...]:
    """Return the scale of a projected map as facts; refuse maps with an error of more than 1 %.

    ``x``, ``y`` is the middle of the map, at which the scale is measured; ``command`` is the
    program of the remedy. In the Mercator projection of map tiles, one metre of the map is
    cos(latitude) metres.
    """
    if crs is None or not crs.is_projected:
        return ()
    half = SPAN / 2
    places = _degrees(crs, [x - half, x + half, x, x], [y, y, y - half, y + half])
    longitude, latitude = np.radians(places)
    a, b = _ellipsoid(crs)
    normal = a**2 / np.hypot(a * np.cos(latitude), b * np.sin(latitude))
    radius, height = normal * np.cos(latitude), (b / a) ** 2 * normal * np.sin(latitude)
    positions = np.column_stack([radius * np.cos(longitude), radius * np.sin(longitude), height])
    steps = np.asarray((positions[1::2] - positions[::2]) / SPAN)
    if not np.isfinite(steps).all():
        refuse(
            "a map inside the domain of its projection",
            f"no scale at x = {x:.9g}, y = {y:.9g} ({crs.to_string()})",
            "correct the coordinates or the reference system of the file",
        )
    along_x, along_y = np.linalg.norm(steps, axis=1)
    extremes = np.linalg.svd(steps, compute_uv=False)
    if not np.allclose(extremes, 1.0, rtol=0, atol=STRETCH):
        refuse(
            f"a map with a scale error of at most {100 * STRETCH:g} %",
            f"that 1 m of the map is {along_x:.4g} m along x and {along_y:.4g} m along y on the "
            f"ground at x = {x:.9g}, y = {y:.9g}, {extremes[1]:.4g} to {extremes[0]:.4g} m in all "
            f"directions ({crs.to_string()})",
            reprojection(crs, command, x, y),
        )
    scale = f"{along_x:.7f} m along x and {along_y:.7f} m along y"
    return (("ground map scale", f"1 m of the map is {scale} on the ellipsoid"),)
