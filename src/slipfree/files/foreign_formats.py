"""Formats that are not read, recognized by the ending or the first bytes of a file; converters."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, NamedTuple

from slipfree.core.errors import DataError

HEAD = 512  # bytes that are compared
AGAIN = "download the file itself ('raw') again"
TO_XYZ = "write its points as text with x y z of one point per line, with the ending .xyz"
TO_CSV = "write its columns as CSV, with their names in the first line"
TO_PANDAS = "python -c \"import pandas; pandas.read_{}('{{}}').to_csv('out.csv')\""
TO_TIF = "convert it: gdal_translate {} out.tif"
TO_MCAP = "convert it to MCAP: rosbags-convert --src {} --dst out --dst-storage mcap"
TO_LAYER = (
    "write the layer of heights of a grid_map message as .npz with arrays x, y, z, for example "
    "with the Python package rosbags"
)
TO_RASTER = (
    "interpolate its points or contours to a raster: gdal_grid -txe ... -tye ... -tr ... {} out.tif"
)
TO_ONE_FILE = (
    "header and heights are in separate files, of which only one is read: write them as one file: "
    "gdal_translate {} out.tif"
)

Purpose = Literal["map", "table"]


class Format(NamedTuple):
    """A format that is not read: remedies have ``{}`` for the name of the file."""

    name: str
    endings: str  # of the names of such files, separated by blanks
    magic: tuple[bytes, ...]  # first bytes; empty if they are not characteristic
    map: str  # remedy where a map is expected; empty for formats that GDAL reads
    table: str = TO_CSV  # remedy where a table is expected


PACKED = (  # name, endings, first bytes, and remedy
    ("a pointer of Git LFS", "", b"version https://git-lfs", "fetch it: git lfs pull"),
    ("a web page", ".html .htm", b"<!DOCTYPE html", AGAIN),
    ("a web page", "", b"<!doctype html", AGAIN),
    ("a web page", "", b"<html", AGAIN),
    ("a zip archive", ".zip .kmz .npz .xlsx", b"PK\x03\x04", "unpack it: unzip {}"),
    ("a gzip file", ".gz", b"\x1f\x8b", "unpack it: gunzip {}"),
    ("a bzip2 file", ".bz2", b"BZh", "unpack it: bunzip2 {}"),
    ("an xz file", ".xz", b"\xfd7zXZ", "unpack it: unxz {}"),
    ("a zstd file", ".zst", b"\x28\xb5\x2f\xfd", "unpack it: unzstd {}"),
    ("a 7z archive", ".7z", b"7z\xbc\xaf", "unpack it: 7z x {}"),
    ("a rar archive", ".rar", b"Rar!", "unpack it: unrar x {}"),
    ("a tar archive", ".tar .tgz", b"", "unpack it: tar xf {}"),
)
FORMATS = (
    Format("an Excel workbook", ".xlsx .xls .ods", (b"\xd0\xcf\x11\xe0",), TO_XYZ),
    Format("a numpy archive", ".npz", (), "", f"{TO_CSV} (numpy.savetxt)"),
    *(
        Format(name, endings, (magic,) if magic else (), remedy, remedy)
        for name, endings, magic, remedy in PACKED
    ),
    Format("a bag of ROS 1", ".bag", (b"#ROSBAG",), TO_LAYER, TO_MCAP),
    Format("a bag of ROS 2 in SQLite", ".db3", (), TO_LAYER, TO_MCAP),
    Format("an MCAP file", ".mcap", (b"\x89MCAP",), TO_LAYER, "rename it to end in .mcap"),
    Format("a MATLAB file", ".mat", (b"MATLAB",), "write arrays x, y, z as .npz (numpy.savez)"),
    Format("an HDF5 file", ".h5 .hdf5", (), TO_TIF),
    Format("binary data", "", (b"\x89HDF", b"CDF\1", b"CDF\2", b"CDF\5", b"SQLite format 3"), ""),
    Format("a Parquet file", ".parquet", (b"PAR1",), TO_XYZ, f"use {TO_PANDAS.format('parquet')}"),
    Format(
        "a Feather file", ".feather", (b"ARROW1",), TO_XYZ, f"use {TO_PANDAS.format('feather')}"
    ),
    Format("a log of PX4 (ULog)", ".ulg .ulog", (b"ULog\x01",), TO_XYZ, "use ulog2csv {}"),
    Format(
        "a log of ArduPilot",
        "",
        (b"\xa3\x95\x80",),
        TO_XYZ,
        "use mavlogdump.py --format csv --types ... {} > out.csv",
    ),
    Format("a pickle of Python", ".pkl .pickle", (b"\x80\x04\x95", b"\x80\x05\x95"), TO_XYZ),
    Format(
        "a single array of numpy",
        ".npy",
        (b"\x93NUMPY",),
        "write it with numpy.savez('out.npz', x=x, y=y, z=z)",
        f"{TO_CSV} (numpy.savetxt)",
    ),
    Format("a mesh", ".obj .stl .dae .glb", (), TO_XYZ),
    Format("a mesh or a point cloud", ".ply", (b"ply\n", b"ply\r"), "rename it to end in .ply"),
    Format(
        "a point cloud of PCL",
        ".pcd",
        (b"# .PCD", b"VERSION .7", b"VERSION 0.7"),
        "rename it to end in .pcd",
    ),
    Format("a point cloud", ".las .laz", (b"LASF",), "rename it to end in .las or .laz"),
    Format("a point cloud", ".e57", (b"ASTM-E57",), "convert it: pdal translate {} out.laz"),
    Format(
        "settings of an occupancy map of ROS",
        ".yaml .yml",
        (),
        "its picture contains probabilities of obstacles, not heights: use an elevation map",
    ),
    Format("JSON", ".json", (), TO_XYZ),
    Format("vector data", ".shp .geojson .kml .dxf .gpx", (), TO_RASTER),
    Format(
        "a virtual raster",
        ".vrt",
        (),
        "write the rasters that it refers to as one file: gdal_translate {} out.tif",
    ),
    Format("a part of a map", ".bil .flt .sdat .ers .rst .adf", (), TO_ONE_FILE),
    Format(
        "information about a map",
        ".hdr .sgrd .rdc .prj .tfw .pgw .xml",
        (),
        "give the name of the file with the heights",
    ),
    Format("a picture or a document", ".ecw .sid .pdf", (b"%PDF",), TO_TIF),
    Format("an ESRI ASCII grid", "", (b"ncols", b"NCOLS"), "", "rename it to end in .asc"),
    Format("a grid of Surfer", "", (b"DSAA", b"DSBB", b"DSRB"), "", "rename it to end in .grd"),
    Format("a picture", "", (b"\x89PNG", b"\xff\xd8\xff", b"II*\0", b"MM\0*"), ""),
)


def check_ending(path: Path, purpose: Purpose, expected: str, read: tuple[str, ...] = ()) -> None:
    """Raise DataError if a file ends as a known format; files with endings in ``read`` are read."""
    ending = path.suffix.lower()
    for known in FORMATS:
        remedy = getattr(known, purpose)
        if remedy and ending in known.endings.split() and ending not in read:
            found = f"{ending!r}, {known.name}"
            raise DataError(
                f"{path}: expected {expected}, found {found}; {remedy.format(path.name)}"
            )


def check_contents(path: Path, purpose: Purpose, expected: str) -> None:
    """Raise DataError if a file begins as a known format that is not read; see `check_ending`."""
    with path.open("rb") as file:
        head = file.read(HEAD)
    for known in FORMATS:
        remedy = getattr(known, purpose)
        if remedy and head.startswith(known.magic):
            raise DataError(
                f"{path}: expected {expected}, found {known.name}; {remedy.format(path.name)}"
            )
    if purpose == "table" and b"\0" in head and not head.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise DataError(f"{path}: expected {expected}, found binary data; {TO_CSV}")
