"""Mobility maps in files: GeoTIFF of maps over the headings, and netCDF of all poses.

The pixels of a GeoTIFF are centred at the nodes of the atlas, in the coordinates and the reference
system of the map file; rows run from north to south. It is written tile by tile, so that its size
is not limited by the memory. A netCDF file has all bands at all headings.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy

from slipfree.atlas import atlas
from slipfree.core.errors import DataError, WriteError
from slipfree.core.records import Array, Label
from slipfree.core.trajectory import FRAME, Column, heading_column
from slipfree.core.version import __version__
from slipfree.files import netcdf
from slipfree.system.regular_files import replacing
from slipfree.terrain.bicubic import Elevation

MAX_BYTES = 2**32 - 4  # of a variable of netCDF-3
CACHE = 64  # GDAL's cache of blocks [MB]; fixed, so that files do not depend on the machine
DIMENSIONS = "heading", "y", "x"
CONDITIONS = "friction", "within", "coordinates", "crs"  # of a site, in the attribute
EMPTY: Mapping[str, Any] = {}
REASONS = "reasons"  # attribute of the band of reasons
NO_ATLAS = "repeat slipfree atlas with -o OUT.nc"


class Site(NamedTuple):
    """The ground of an atlas, and the conditions for its summary.

    Attributes
    ----------
    elevation : ndarray, shape (n_x, n_y), or Elevation
        Heights of the nodes. [m]
    friction : float, optional
        Coefficient of friction that must hold the vehicle, as for `verdicts`. [1]
    within : mapping of str to tuple of 2 floats
        Smallest and largest value of bands by name, as for `verdicts`.
    frame : {"paper", "rep103"}
        Headings in degrees count from the y axis, or from the x axis.
    coordinates : tuple of MapCoordinate
        Coordinates of the map file, if they differ from those of the atlas.
    crs : str
        Reference system of the map file; empty if unknown.
    attributes : mapping of str to str
        Description: title, ground, vehicle and problem.
    """

    elevation: Array | Elevation
    friction: float | None = None
    within: atlas.Bounds = EMPTY
    frame: str = "paper"
    coordinates: tuple[netcdf.MapCoordinate, ...] = ()
    crs: str = ""
    attributes: Mapping[str, str] = EMPTY

    def summary_of(
        self, poses: atlas.Atlas, i: slice, j: slice
    ) -> tuple[dict[str, atlas.Band], atlas.Verdicts]:
        """Return maps over the headings and verdicts of a part of the atlas.

        Parameters
        ----------
        poses : Atlas
            Poses at the nodes of the part, with headings from the y axis.
        i, j : slice
            Nodes of the part along x and y, for their heights.

        Returns
        -------
        dict of Band
            Maps of shape (n_x, n_y) by name; headings count from the axis of ``frame``.
        Verdicts
            Why the vehicle may not stay, by the conditions ``friction`` and ``within``.
        """
        decided = atlas.verdicts(poses, friction=self.friction, within=self.within)
        return atlas.summary(poses, decided, self.elevation[i, j], self.frame), decided

    def on_map(self, axis: str, values: Array) -> Array:
        """Return x or y in the coordinates of the map file.

        Parameters
        ----------
        axis : {"x", "y"}
            Name of the coordinate.
        values : ndarray, any shape
            Its values in coordinates of motions. [m]

        Returns
        -------
        ndarray, of the same shape
            Values in the reference system ``crs``. [m] or [deg]
        """
        for each in self.coordinates:
            if each.axis == axis:
                values = each.offset + each.factor * values
        return values


Tiles = Iterable[tuple[slice, slice, atlas.Atlas]]


def tiles_in(poses: atlas.Atlas) -> Iterator[tuple[slice, slice, atlas.Atlas]]:
    """Yield an atlas in the tiles of `tiles_of`, in the order of files.

    Parameters
    ----------
    poses : Atlas
        Poses at (n_x, n_y) nodes.

    Yields
    ------
    tuple of slice, slice and Atlas
        Nodes of the tile along x and y, and its poses, whose bands are views.
    """
    for i, j in atlas.tiles_of(poses.x.size, poses.y.size):
        parts = {
            name: atlas.Band(label, each[:, i, j]) for name, (label, each) in poses.bands.items()
        }
        yield i, j, atlas.Atlas(poses.x[i], poses.y[j], poses.heading, parts, poses.reasons)


def write_geotiff(
    path: str | os.PathLike[str], x: Array, y: Array, site: Site, tiles: Tiles
) -> None:
    """Write the maps over the headings of an atlas as a GeoTIFF.

    ``tiles`` are those of `tiles_of`, in this order. Tiles are blocks of the file, each written
    once: equal maps give equal files. The file is read again before it replaces an earlier one,
    since GDAL reports no error if the disk is full. WriteError is raised if it cannot be written,
    DataError if the reference system is unknown or places are not evenly spaced.
    """
    import rasterio
    from rasterio import Affine
    from rasterio.crs import CRS as SYSTEM
    from rasterio.errors import CRSError, RasterioError

    try:
        system = SYSTEM.from_user_input(site.crs) if site.crs else None
    except CRSError as error:
        raise DataError(
            f"atlas: expected a known reference system, found {site.crs!r}; correct that of the map"
        ) from error
    for name, axis in (("x", x), ("y", y)):
        if axis.size < 2 or not np.allclose(np.diff(axis), axis[1] - axis[0]):
            raise DataError(
                f"{path}: expected at least two evenly spaced places along {name}, found others; "
                "write a netCDF file (.nc) instead"
            )
    east, north = site.on_map("x", x), site.on_map("y", y)
    d_x, d_y = ((axis[-1] - axis[0]) / (axis.size - 1) for axis in (east, north))
    side = atlas.tile_side(x.size * y.size)
    transform = Affine(d_x, 0, east[0] - d_x / 2, 0, -d_y, north[-1] + d_y / 2)
    profile = {"driver": "GTiff", "dtype": "float32", "nodata": np.nan, "BIGTIFF": "IF_SAFER"}
    profile |= {"compress": "deflate", "predictor": 3, "interleave": "band"}
    profile |= {"width": x.size, "height": y.size, "crs": system, "transform": transform}
    profile |= {"tiled": True, "blockxsize": side, "blockysize": side}
    with replacing(Path(path)) as part, rasterio.Env(GDAL_CACHEMAX=CACHE):
        try:
            with ExitStack() as stack:
                file: Any = None
                for i, j, poses in tiles:
                    maps, found = site.summary_of(poses, i, j)
                    if file is None:  # the first tile has the bands
                        file = rasterio.open(part, "w", count=len(maps), **profile)
                        stack.enter_context(file)
                        labels = [band.label for band in maps.values()]
                        file.descriptions = tuple(f"{each.name} [{each.unit}]" for each in labels)
                        file.units = tuple(each.unit for each in labels)
                        codes = [f"{n}: {words}" for n, words in enumerate(found.reasons) if n]
                        for k, label in enumerate(labels, 1):
                            more = [*codes] if label.name == atlas.LIMIT else []
                            file.update_tags(k, long_name="; ".join([label.words, *more]))
                        own = {"TIFFTAG_SOFTWARE": f"slipfree {__version__}", FRAME: site.frame}
                        file.update_tags(AREA_OR_POINT="Point", **own, **site.attributes)
                    window = (y.size - j.stop, y.size - j.start), (i.start, i.stop)
                    for k, band in enumerate(maps.values(), 1):
                        image = np.ascontiguousarray(band.values.T[::-1], dtype=np.float32)
                        file.write(image, k, window=window)
            with rasterio.open(part) as written:
                for k in written.indexes:
                    written.checksum(k)  # reads all blocks
        except RasterioError as error:
            raise WriteError(
                f"{path}: cannot be written ({error.__cause__ or error}); free disk space or "
                "choose another folder"
            ) from error


def write_atlas(path: str | os.PathLike[str], poses: atlas.Atlas, site: Site) -> None:
    """Write all bands of an atlas as a netCDF file, which `open_atlas` reads.

    Variables have the dimensions ``heading``, ``y`` and ``x``, with metadata of the CF conventions.

    Raises
    ------
    DataError
        If the file cannot be written, or a band exceeds 4 GB.
    """
    largest = 4 * poses.heading.size * poses.x.size * poses.y.size
    if largest > MAX_BYTES:
        raise DataError(
            f"{path}: expected bands of at most {MAX_BYTES / 1e9:.3g} GB, found "
            f"{largest / 1e9:.3g} GB; write a GeoTIFF instead, or use fewer headings or nodes"
        )
    conditions = {name: getattr(site, name) for name in CONDITIONS}
    own = {"Conventions": netcdf.CONVENTIONS, netcdf.ORIGIN: __version__, FRAME: site.frame}
    own[netcdf.ATLAS] = json.dumps({**conditions, "bands": [*poses.bands]})
    with replacing(Path(path)) as part, scipy.io.netcdf_file(str(part), "w", version=2) as file:
        netcdf.annotate(file, {**site.attributes, **own})

        def add(label: Label, dimensions: Sequence[str], values: Array, kind: str) -> Any:
            variable = file.createVariable(label.name, kind, tuple(dimensions))
            variable[:] = values
            netcdf.annotate(variable, {"units": label.unit, "long_name": label.words})
            return variable

        places = (
            Column(Label(n, "m", f"{n} of the platform's centre"), getattr(poses, n)) for n in "yx"
        )
        for label, values in (heading_column(poses.heading, site.frame), *places):
            file.createDimension(label.name, values.size)
            variable = add(label, [label.name], values, "f8")
            if label.unit == "m":
                variable.axis = label.name.upper()
        mapped = {}
        if site.crs:
            netcdf.add_scalar(file, netcdf.CRS, netcdf.grid_mapping(site.crs))
            named = {each.axis: each.name for each in site.coordinates}
            labels = [netcdf.map_label(named.get(axis, axis), site.crs) for axis in "xy"]
            for axis, label in zip("xy", labels, strict=True):
                variable = add(label, [axis], site.on_map(axis, getattr(poses, axis)), "f8")
                netcdf.annotate(variable, netcdf.standard_name(label.name))
            names = " ".join(label.name for label in labels)
            mapped = {"coordinates": names, "grid_mapping": netcdf.CRS}
        netcdf.annotate(add(atlas.ELEVATION, DIMENSIONS[1:], site.elevation[:, :].T, "f8"), mapped)
        for name, (label, values) in poses.bands.items():
            kind = "i2" if name == atlas.REASON.name else "f4"
            variable = add(label, DIMENSIONS, values.swapaxes(1, 2), kind)
            netcdf.annotate(variable, {**netcdf.standard_name(name), **mapped})
        reason, codes = file.variables[atlas.REASON.name], np.arange(len(poses.reasons), dtype="i2")
        slugs = (re.sub(r"[^\w.+@-]+", "_", words).strip("_") for words in poses.reasons)
        meanings = {"flag_meanings": " ".join(slugs), REASONS: json.dumps(poses.reasons)}
        netcdf.annotate(reason, meanings)
        reason.flag_values = codes


def open_atlas(path: str | os.PathLike[str]) -> tuple[atlas.Atlas, Site]:
    """Return the atlas in a netCDF file, and the ground on which it was computed.

    Raises
    ------
    DataError
        If the file cannot be read, or has no atlas.
    """
    file = netcdf.open_netcdf(Path(path))
    with file.stream:
        if netcdf.ATLAS not in file.attributes:
            raise netcdf.result_fault(file.path, "a result without an atlas", NO_ATLAS)
        try:
            return _stored(file)
        except (ValueError, LookupError, TypeError, ArithmeticError, RecursionError) as error:
            raise netcdf.result_fault(file.path, f"a damaged atlas ({error})", NO_ATLAS) from error


def is_atlas(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a netCDF file of an atlas."""
    return netcdf.ATLAS in netcdf.attributes_of(path)


def _stored(file: netcdf.NetcdfFile) -> tuple[atlas.Atlas, Site]:
    """Return the atlas in an open file; raise an error of one of many classes without one."""
    conditions = json.loads(str(file.attributes[netcdf.ATLAS]))
    bands = {}
    for name in conditions["bands"]:
        words = file.variables[name].attributes
        label = Label(name, str(words["units"]), str(words["long_name"]))
        bands[name] = atlas.Band(label, file.values(name).swapaxes(1, 2).astype(np.float32))
    heading, y, x = (file.values(name).astype(float) for name in DIMENSIONS)
    shape = heading.size, x.size, y.size
    if wrong := [name for name, band in bands.items() if band.values.shape != shape]:
        raise ValueError(f"expected the shape {shape} of the band {wrong[0]!r}")
    if not all(np.isfinite(axis).all() and (np.diff(axis) > 0).all() for axis in (heading, y, x)):
        raise ValueError("expected ascending headings and places")
    reasons = json.loads(str(file.variables[atlas.REASON.name].attributes[REASONS]))
    frame = str(file.attributes[FRAME])
    if not np.isin(bands[atlas.REASON.name].values, np.arange(len(reasons))).all():
        raise ValueError(f"expected numbers of {len(reasons)} reasons in {atlas.REASON.name!r}")
    site = Site(
        file.values(atlas.ELEVATION.name).T.astype(float),
        None if conditions["friction"] is None else float(conditions["friction"]),
        {name: (float(low), float(high)) for name, (low, high) in conditions["within"].items()},
        frame,
        tuple(netcdf.MapCoordinate(*each) for each in conditions["coordinates"]),
        str(conditions["crs"]),
        {
            name: str(value)
            for name, value in file.attributes.items()
            if name not in ("Conventions", netcdf.ORIGIN, netcdf.ATLAS, FRAME)
        },
    )
    heading = heading_column(heading, "paper", own=frame).values
    return atlas.Atlas(x, y, heading, bands, tuple(map(str, reasons))), site
