"""Random height maps: valid, nearly valid, and damaged."""

import io
import struct
import warnings
import zipfile
from functools import cache
from itertools import product
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import rasterio.shutil
from PIL import Image

from helpers.fuzz_damage import NUMBERS, ODD, Case, damaged, perhaps_damaged
from helpers.rasters import from_origin, geotiff


def ascii_grid(kind: str, rng: Random) -> Case:
    """Return an ESRI ASCII grid by its grammar, or a damaged one."""
    columns, rows = rng.choice([1, 3, 4, 5, 7, 9]), rng.choice([1, 3, 4, 5, 7, 9])
    heads = [
        ("ncols", columns),
        ("nrows", rows),
        (rng.choice(["xllcorner", "xllcenter"]), 3.5),
        (rng.choice(["yllcorner", "yllcenter"]), 4),
        ("cellsize", 0.5),
        ("NODATA_value", -9999),
        ("dx", 0.5),
        ("dy", 0.25),
    ]
    heads = heads[: rng.choice([5, 6, 6, 6, 8])]
    if rng.random() < 0.3:
        k = rng.randrange(len(heads))
        heads[k] = heads[k][0], rng.choice([*NUMBERS, 10**9, "1e9", "x"])
    values = (0, 1.5, -2, -9999, "nan", "inf", "1e308", "1e999", "x", "")
    odd = rng.random() < 0.4
    lines = [
        " ".join(
            str(rng.choice(values if odd and rng.random() < 0.05 else values[:3]))
            for _ in range(columns)
        )
        for _ in range(rows)
    ]
    raw = ("\n".join([*(f"{k} {v}" for k, v in heads), *lines]) + "\n").encode()
    return perhaps_damaged(kind, "ground.asc", raw, rng, 0.3)


def points(kind: str, rng: Random) -> Case:
    sign, count = rng.choice([" ", ",", ";", "\t"]), rng.randint(0, 30)
    odd = (*NUMBERS, "x", "", "#", '"1"')
    rows = [[rng.uniform(0, 5), rng.uniform(0, 5), rng.random()] for _ in range(count)]
    if rng.random() < 0.6:
        rows = [[i / 2, j / 2, rng.random()] for i in range(5) for j in range(6)]
        count = len(rows)
    if count and rng.random() < 0.5:
        rows[rng.randrange(count)][rng.randrange(3)] = rng.choice(odd)
    lines = [sign.join(map(str, row)) for row in rows]
    if rng.random() < 0.3:
        lines.insert(0, sign.join(rng.sample(["x", "y", "z", "X", "h"], 3)))
    raw = "\n".join(lines).encode()
    name = rng.choice(["ground.csv", "ground.xyz", "ground.txt"])
    return perhaps_damaged(kind, name, raw, rng, 0.4)


def ply(
    points: Any,
    kind: str,
    *,
    real: str = "float",
    newline: str = "\n",
    faces: int = 0,
    before: int = 0,
    classes: Any = None,
) -> bytes:
    """Return a PLY file of points, of a kind such as ``"binary_big_endian"``."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[kind]
    types = [(name, order + {"float": "f4", "double": "f8"}[real]) for name in "xyz"]
    head = ["ply", f"format {kind} 1.0", "comment made for tests"]
    head += [f"element camera {before}", "property double at"] * bool(before)
    head += [f"element vertex {len(points)}", *(f"property {real} {name}" for name in "xyz")]
    table = [*np.asarray(points).T]
    if classes is not None:
        head.append("property uchar scalar_Classification")
        types.append(("c", order + "u1"))
        table.append(classes)
    head += [f"element face {faces}", "property list uchar int vertex_indices"] * bool(faces)
    raw = newline.join([*head, "end_header", ""]).encode()
    rows = np.array([*zip(*table, strict=True)], types)
    if order:
        first = np.arange(before, dtype=f"{order}f8").tobytes()
        last = struct.pack(f"{order}Biii", 3, 0, 1, 2) * faces
        return raw + first + rows.tobytes() + last
    lines = [*map(str, range(before)), *(" ".join(map(str, row)) for row in rows.tolist())]
    return raw + newline.join([*lines, *["3 0 1 2"] * faces, ""]).encode()


def pcd(points: Any, kind: str, *, real: str = "F 4") -> bytes:
    """Return a PCD file of points, of a kind such as ``"binary_compressed"``."""
    letter, size = real.split()
    head = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS x y z",
        f"SIZE {size} {size} {size}",
        f"TYPE {letter} {letter} {letter}",
        "COUNT 1 1 1",
        f"WIDTH {len(points)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(points)}",
        f"DATA {kind}",
    ]
    raw, rows = "\n".join([*head, ""]).encode(), np.asarray(points, f"<f{size}")
    if kind == "ascii":
        return raw + "".join(" ".join(map(str, row)) + "\n" for row in rows.tolist()).encode()
    if kind == "binary":
        return raw + rows.tobytes()
    plain = rows.T.tobytes()
    packed = compress_lzf(plain)
    return raw + struct.pack("<II", len(packed), len(plain)) + packed


def compress_lzf(plain: bytes) -> bytes:
    """Return LZF without copies: literals of at most 32 bytes, after their number less one."""
    parts = (plain[k : k + 32] for k in range(0, len(plain), 32))
    return b"".join(bytes([len(part) - 1]) + part for part in parts)


def cloud(kind: str, rng: Random) -> Case:
    """Return a PLY or PCD file, valid, with another number in its header, or damaged."""
    points = np.random.default_rng(rng.randrange(99)).uniform(0, 5, (rng.choice([2, 40, 200]), 3))
    if rng.random() < 0.3:
        points[rng.randrange(len(points)), rng.randrange(3)] = rng.choice([np.nan, np.inf, 1e30])
    if kind == "ply":
        encoding = rng.choice(["ascii", "binary_little_endian", "binary_big_endian"])
        raw = ply(points, encoding, faces=rng.choice([0, 2]), before=rng.choice([0, 0, 3]))
    else:
        raw = pcd(points, rng.choice(["ascii", "binary", "binary_compressed"]))
    if rng.random() < 0.4:
        old = rng.choice(
            [b"float", b"vertex", b"F F F", b"4 4 4", b"1 1 1", str(len(points)).encode()]
        )
        raw = raw.replace(old, str(rng.choice([*NUMBERS, 10**9, "1e9", "x", "double"])).encode(), 1)
    return perhaps_damaged(kind, f"ground.{kind}", raw, rng, 0.4)


def archive(kind: str, rng: Random) -> Case:
    """Return a numpy archive of odd arrays, of lying headers, or a damaged one."""
    how, stream = rng.random(), io.BytesIO()
    x, y = np.linspace(0, 3, rng.randint(2, 8)), np.linspace(0, 4, rng.randint(2, 8))
    arrays: dict[str, Any] = {"x": x, "y": y, "z": np.zeros((x.size, y.size))}
    if how < 0.4:
        odd = (
            x[::-1], x.astype(complex), x.astype("S3"), np.array(3.0), np.zeros((2, 2, 2)),
            x * np.nan, x > 1, x.astype("f2"), x.astype("M8[s]"), np.array([{}], object), x**3,
            x * 1e300, np.zeros(0), np.zeros((0, 5)), np.array([("a", 1)], "U1,i4"),
            x.astype(">i8"),
        )  # fmt: skip
        arrays[rng.choice("xyzw")] = rng.choice(odd)
        if rng.random() < 0.3:
            del arrays[rng.choice([*arrays])]
    np.savez(stream, **arrays) if rng.random() < 0.5 else np.savez_compressed(stream, **arrays)
    raw = stream.getvalue()
    if how > 0.75:
        raw = damaged(raw, rng)
    elif how > 0.5:
        raw = _lying(rng)
    if how > 0.98:
        np.save(stream := io.BytesIO(), x)
        raw = stream.getvalue()
    return Case(kind, {"ground.npz": raw}, "ground.npz")


def _lying(rng: Random) -> bytes:
    """Return an archive whose headers claim more than it holds, or are no headers."""
    head = rng.choice(
        [
            "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 1000000000), }",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (3000000000,), }",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (-4,), }",
            "{'descr': '<f8', 'fortran_order': False, 'shape': (4L,), }",
            "{'descr': '|O', 'fortran_order': False, 'shape': (4,), }",
            "{'descr': 'x', 'fortran_order': 1, 'shape': 4, }",
            "(" * 300,
            "{" * 90,
            "",
            "\0",
            "__import__('os')",
            "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (4,), }",
        ]
    )
    stream, version = io.BytesIO(), rng.choice([1, 2, 3, 9])
    size = struct.pack("<H" if version == 1 else "<I", len(head))
    with zipfile.ZipFile(
        stream, "w", rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
    ) as file:
        for name in ("x.npy", "y.npy", "z.npy"):
            file.writestr(
                name, b"\x93NUMPY" + bytes([version, 0]) + size + head.encode() + b"\0" * 64
            )
    return stream.getvalue()


RASTERS: dict[str, tuple[str, str, list[dict[str, Any]]]] = {  # driver, type of heights, options
    "tif": (
        "GTiff",
        "float32",
        [{}, {"compress": "deflate", "predictor": 3}, {"compress": "lzw", "tiled": True}],
    ),
    "asc": ("AAIGrid", "float32", [{}]),
    "png": ("PNG", "uint16", [{}]),
    "img": ("HFA", "float32", [{}]),
    "nc": ("netCDF", "float32", [{}]),
    "gpkg": ("GPKG", "float32", [{}]),
    "grd": ("GSBG", "float32", [{}]),
    "bt": ("BT", "float32", [{}]),
}
UNPLACED = {"tif": ("f4", "u2", "u1"), "png": ("u2", "u1")}  # types of samples of pictures
SPARSE = {"driver": "GTiff", "tiled": True, "sparse_ok": True, "bigtiff": "YES"}
SPARSE |= {"blockxsize": 8192, "blockysize": 8192}


@cache
def pictures(ending: str) -> tuple[bytes, ...]:
    """Return sound rasters: in metres, in degrees, without a place, and sparse of a giant size."""
    heights, found = np.random.default_rng(3).uniform(1, 4, (8, 8)), []
    places = {"EPSG:32633": from_origin(5e5, 5e6, 2), "EPSG:4326": from_origin(15, 45, 1e-4)}
    driver, dtype, options = RASTERS[ending]
    with TemporaryDirectory() as folder, warnings.catch_warnings(action="ignore"):
        whole, copy = Path(folder, "whole.tif"), Path(folder, f"copy.{ending}")
        for option, (crs, place) in product(options, places.items()):
            geotiff(whole, heights, place, crs=crs, dtype=dtype, nodata=0)
            rasterio.shutil.copy(whole, copy, driver=driver, **option)
            found.append(copy.read_bytes())
        for kind in UNPLACED.get(ending, ()):
            Image.fromarray((40 * heights).astype(kind)).save(copy)
            found.append(copy.read_bytes())
        if ending == "tif":
            size = {"width": 200_000, "height": 200_000, "count": 1, "dtype": "float32"}
            with rasterio.open(copy, "w", transform=from_origin(5e5, 5e6, 1), **size, **SPARSE):
                found.append(copy.read_bytes())
    return tuple(found)


def picture(kind: str, rng: Random) -> Case:
    """Return a raster of a kind that is its ending, mostly damaged."""
    return perhaps_damaged(kind, f"ground.{kind}", rng.choice(pictures(kind)), rng, 0.9)


def raster(_: str, rng: Random) -> Case:
    """Return a raster of any format, or an archive of arrays, mostly damaged."""
    if rng.random() < 0.85:
        return picture(rng.choice([*RASTERS]), rng)
    case = archive("npz", rng)
    return case._replace(files={name: damaged(raw, rng) for name, raw in case.files.items()})


SIDECARS = {
    ".tif.aux.xml": b"<PAMDataset><SRS>EPSG:3857</SRS><GeoTransform>0,9,0,0,0,-9</GeoTransform>"
    b'<Metadata><MDI key="AREA_OR_POINT">Point</MDI></Metadata><PAMRasterBand band="1">'
    b"<Scale>1000</Scale><Offset>7</Offset><NoDataValue>0.5</NoDataValue></PAMRasterBand>"
    b"</PAMDataset>",
    ".tif.msk": b'<VRTDataset rasterXSize="8" rasterYSize="8"><Metadata><MDI key="'
    b'INTERNAL_MASK_FLAGS_1">2</MDI></Metadata><VRTRasterBand dataType="Byte" band="1">'
    b'<SimpleSource><SourceFilename relativeToVRT="1">ground.tif</SourceFilename>'
    b"<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>",
    ".tif.ovr": b"II*\0\x08\0\0\0\0\0",
    ".tfw": b"0.5\n0\n0\n-0.5\n1000\n2000\n",
    ".wld": b"0.5\n0\n0\n-0.5\n1000\n2000\n",
    ".tab": b'!table\n!version 300\nDefinition Table\n  File "ground.tif"\n  Type "RASTER"\n'
    b'  (9,9) (0,0) Label "1",\n  (20,9) (8,0) Label "2",\n  (20,2) (8,8) Label "3"\n',
    ".prj": b"EPSG:3857",
    ".hdr": b"BYTEORDER I\nLAYOUT BIL\nNROWS 8\nNCOLS 8\n",
    ".RPB": b'satId = "x";\nbandId = "P";\n',
    "_RPC.TXT": b"LINE_OFF: 1\nSAMP_OFF: 2\n",
    ".aux": b"EHFA_HEADER_TAG\0" + bytes(40),
    ".xml": b"<metadata><idinfo/></metadata>",
}


def beside(_: str, rng: Random) -> Case:
    """Return a GeoTIFF, and what other programs write beside it, damaged or not."""
    case = picture("tif", rng)
    names = rng.sample([*SIDECARS], rng.choice([1, 2, 4]))
    files = {f"ground{name}": SIDECARS[name] for name in names}
    for name in files:
        if rng.random() < 0.2:
            files[name] = rng.choice(pictures("tif"))
        if rng.random() < 0.6:
            files[name] = damaged(files[name], rng)
    odd = {name: rng.choice(ODD) for name in files if rng.random() < 0.1}
    return case._replace(files={**case.files, **files}, odd=odd)
