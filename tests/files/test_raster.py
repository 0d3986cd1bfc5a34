"""Tests of raster files: equal grounds from all formats, and the error of each refused file."""

from __future__ import annotations

import http.server
import re
import struct
import threading
import warnings
import zlib

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image
from rasterio.control import GroundControlPoint
from rasterio.transform import Affine
from rasterio.warp import transform
from scipy.io import netcdf_file

from helpers import rasters
from helpers.fuzz_maps import SIDECARS
from helpers.rasters import from_origin, refuses
from slipfree import DataError, ModelError
from slipfree.files.maps.elevation import read_map
from slipfree.files.maps.raster import FEET

UTM = "EPSG:32633"
WEST, NORTH, CELL = 500000.0, 4.5e6, 0.25
ROWS = (
    np.round(  # heights that a float32 holds exactly; rows from the north
        1024 * (0.3 + 0.15 * np.sin(0.5 * np.arange(32.0))[:, None] * np.cos(0.4 * np.arange(40.0)))
    )
    / 1024
)


def geotiff(path, rows=ROWS, *, transform=None, tags=None, name="", **options):
    rasters.geotiff(path, rows, transform or from_origin(WEST, NORTH, CELL), **options)
    if tags or name:
        with rasterio.open(path, "r+") as file:
            file.update_tags(**(tags or {}))
            file.set_band_description(1, name)
    return path


AREA = {"cell": 1.0, "registration": "area"}  # of a raster without a place
TILED = {"tiled": True, "blockxsize": 64, "blockysize": 64}


def plain(path, rows=ROWS, mode="F"):
    Image.fromarray(np.asarray(rows, np.float32 if mode == "F" else np.uint16)).save(path)
    return path


def test_nodes_are_the_middles_of_pixels_whatever_their_registration(tmp_path):
    for registration in ("Area", "Point"):
        path = geotiff(tmp_path / "map.tif", tags={"AREA_OR_POINT": registration})
        found = read_map(path)
        assert_array_equal(found.grid.x, WEST + CELL * (np.arange(40) + 0.5))
        assert_array_equal(found.grid.y, NORTH - CELL * (np.arange(32) + 0.5)[::-1])
        assert_array_equal(found.grid.z, ROWS[::-1].T)
        assert found.crs == UTM
        words = dict(found.facts)["ground map"]
        assert f"pixel is {registration.lower()}" in words
        assert UTM in words


def test_one_ground_from_every_file(tmp_path):
    """Of nodes, and of pixels that are compressed, or whose rows begin in the south."""
    x, y = WEST + CELL * (np.arange(40) + 0.5), NORTH - 8 + CELL * (np.arange(32) + 0.5)
    np.savez(tmp_path / "nodes.npz", x=x, y=y, z=ROWS[::-1].T)
    files = [
        tmp_path / "nodes.npz",
        geotiff(tmp_path / "lzw.tif", compress="lzw"),
        geotiff(tmp_path / "deflate.tif", compress="deflate", tags={"AREA_OR_POINT": "Point"}),
        geotiff(tmp_path / "double.tif", dtype="float64", compress="lzw"),
        geotiff(
            tmp_path / "up.tif", ROWS[::-1], transform=Affine(CELL, 0, WEST, 0, CELL, NORTH - 8)
        ),
        geotiff(tmp_path / "map.img", dtype="float64", driver="HFA"),
    ]
    first, *others = (read_map(file).grid for file in files)
    for grid in others:
        assert_allclose(grid.x, first.x, rtol=0, atol=1e-9)
        assert_allclose(grid.y, first.y, rtol=0, atol=1e-9)
        assert_array_equal(grid.z, first.z)


def test_only_the_window_is_read(tmp_path, monkeypatch):
    rows = np.add.outer(np.arange(512.0), np.arange(512.0)) / 8
    path = geotiff(tmp_path / "map.tif", rows, transform=from_origin(0, 512, 1), **TILED)
    asked = []
    read = rasterio.io.DatasetReader.read

    def spied(self, *given, window, **options):
        asked.append(window)
        return read(self, *given, window=window, **options)

    monkeypatch.setattr(rasterio.io.DatasetReader, "read", spied)
    found = read_map(path, window=(100, 120.5, 40.5, 60))  # borders among them
    assert asked == [((452, 472), (100, 121))]  # rows from the top, columns
    assert found.grid.z.shape == (21, 20) == (120 - 100 + 1, 60 - 40)
    assert_array_equal(found.grid.x, np.arange(100, 121) + 0.5)
    assert_array_equal(found.grid.z[0, -1], rows[452, 100])


def _serve(hits):
    """Return a server on this machine that records what is fetched from it."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            hits.append(self.path)
            self.send_error(404)

        do_HEAD = do_GET  # noqa: N815

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server


def test_a_virtual_mask_beside_a_raster_fetches_nothing(tmp_path):
    hits = []
    with _serve(hits) as server:
        url = f"/vsicurl/http://127.0.0.1:{server.server_port}/mask.tif"
        virtual = (
            '<VRTDataset rasterXSize="40" rasterYSize="32"><Metadata>'
            '<MDI key="INTERNAL_MASK_FLAGS_1">2</MDI></Metadata><VRTRasterBand dataType="Byte" '
            f'band="1"><SimpleSource><SourceFilename relativeToVRT="0">{url}</SourceFilename>'
            "<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
        )
        path = geotiff(tmp_path / "map.tif")
        for ending in (".msk", ".ovr", ".aux.xml"):
            (tmp_path / f"map.tif{ending}").write_text(virtual)
        assert_array_equal(read_map(path).grid.z, ROWS[::-1].T)
        path = geotiff(tmp_path / "inside.tif")
        with rasterio.open(path, "r+") as file:
            file.update_tags(ns="OVERVIEWS", OVERVIEW_FILE=url)
        assert_array_equal(read_map(path).grid.z, ROWS[::-1].T)
        server.shutdown()
    assert hits == []


def test_heights_kept_outside_an_image_are_not_fetched(tmp_path):
    """An ERDAS image names the file of its heights; here a place in the network."""
    hits, path = [], tmp_path / f"{'x' * 60}.img"
    geotiff(path, driver="HFA", USE_SPILL="YES")
    spill, whole = path.with_suffix(".ige"), path.read_bytes()
    refuses(path, "expected a readable ERDAS IMG")
    with _serve(hits) as server:
        url = f"/vsicurl/http://127.0.0.1:{server.server_port}/"
        name = f"{url}{'y' * (len(spill.name) - len(url) - 4)}.ige"
        assert spill.name.encode() in whole
        path.write_bytes(whole.replace(spill.name.encode(), name.encode()))
        spill.unlink()
        refuses(path, "expected a readable ERDAS IMG")
        server.shutdown()
    assert hits == []


def test_files_beside_a_raster_do_not_change_it(tmp_path):
    """Scales, places, systems and masks of other files; world files of an unplaced raster."""
    path = geotiff(tmp_path / "map.tif")
    alone = read_map(path)
    (tmp_path / "map.tif.aux.xml").write_bytes(SIDECARS[".tif.aux.xml"])
    mask = geotiff(
        tmp_path / "mask.tif", 0 * ROWS, dtype="uint8", tags={"INTERNAL_MASK_FLAGS_1": 2}
    )
    mask.rename(tmp_path / "map.tif.msk")
    found = read_map(path)
    assert_array_equal(found.grid.x, alone.grid.x)
    assert_array_equal(found.grid.z, alone.grid.z)
    assert (found.crs, found.facts) == (alone.crs, alone.facts)
    path = plain(tmp_path / "bare.tif")
    (tmp_path / "bare.tfw").write_bytes(SIDECARS[".tfw"])
    refuses(path, r"expected cell and registration .* world files .*not read")


def test_a_mask_inside_a_raster_makes_holes(tmp_path):
    path, mask = geotiff(tmp_path / "map.tif"), np.ones(ROWS.shape, bool)
    mask[10:13, 10:14] = False
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(path, "r+") as file:
        file.write_mask(mask)
    assert [each.name for each in tmp_path.iterdir()] == ["map.tif"]
    assert_array_equal(read_map(path).grid.holes, ~mask[::-1].T)


def test_holes_scales_and_offsets_of_a_geotiff(tmp_path):
    rows = np.round(100 * ROWS).astype("int16")
    rows[5, 7] = -32768
    path = geotiff(tmp_path / "map.tif", rows, dtype="int16", nodata=-32768)
    with rasterio.open(path, "r+") as file:
        file.scales, file.offsets = (0.01,), (3.0,)
    found = read_map(path)
    assert np.argwhere(found.grid.holes).tolist() == [[7, 26]]
    assert dict(found.facts)["ground holes"].startswith("1 of 1280 nodes have no height")
    found = read_map(path, fill="linear")
    assert found.grid.holes is None
    facts = dict(found.facts)
    assert "1 nodes in 1 holes, the largest 0.25 x 0.25 m" in facts["ground holes filled"]
    assert_allclose(found.grid.z[0], 3 + 0.01 * rows[::-1, 0], rtol=1e-15)
    words = "values of the file x 0.01 + 3, unit not stated: taken as metres"
    assert facts["ground map heights"] == words + FEET


def test_tiles_in_degrees(tmp_path):
    """SRTM and DTED: nodes on whole degrees, holes, an SRTM tile placed by its name."""
    heights = np.random.default_rng(3).integers(0, 3000, (1201, 1201)).astype(">i2")
    heights[300, 700] = -32768
    path = tmp_path / "S12W071.hgt"
    path.write_bytes(heights.tobytes())
    path, window = path.rename(tmp_path / "S12W071.HGT"), (-70.5, -70.4, -11.3, -11.2)
    refuses(path, r"found degrees \(EPSG:4326\): x from -71 to -70, y from -12")
    found = read_map(path, geographic="local", window=window, fill="linear")
    assert "SRTM tile of int16, EPSG:4326, heights at nodes" in dict(found.facts)["ground map"]
    assert dict(found.facts)["ground holes filled"].startswith("1 nodes in 1 holes")
    hole = found.grid.filled
    assert np.argwhere(hole).tolist() == [[100, 60]]
    whole = heights[240:361, 600:721][::-1].T
    assert_array_equal(found.grid.z[~hole], whole[~hole])
    path.with_name("site.hgt").write_bytes(heights.tobytes())
    refuses(
        path.with_name("site.hgt"), r"SRTM tile, .*name the file after its position, as in N45E006"
    )
    half = 1 / 240
    tile = heights[:121, :121].astype("int16")
    place = {"crs": "EPSG:4326", "transform": from_origin(6 - half, 46 + half, 2 * half)}
    with warnings.catch_warnings(action="ignore"):
        rasterio.shutil.copy(
            geotiff(tmp_path / "map.tif", tile, dtype="int16", **place),
            tmp_path / "map.dt0",
            driver="DTED",
        )
    found = read_map(tmp_path / "map.dt0", geographic="local")
    assert_allclose((found.frame.x0, found.frame.y0), (6, 45), rtol=1e-15)
    assert_array_equal(found.grid.z, tile[::-1].T)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"rows": [ROWS, ROWS, ROWS]}, "one band of heights, found 3 bands; .*gdal_translate -b 1"),
        ({"dtype": "complex64"}, "real numbers, found the type complex64; .*-ot Float32"),
        (
            {"crs": "EPSG:4326", "transform": from_origin(15, 47, 1e-4)},
            r"found degrees \(EPSG:4326\): x from 15.0+5.*geographic = \"local\"",
        ),
        ({"crs": 'LOCAL_CS["site",UNIT["foot",0.3048]]'}, "metres, found the unit 'foot'"),
        (
            {"crs": "+proj=longlat +a=1737400 +b=1737400 +no_defs"},
            "degrees on the earth, found a body of radius 1737400 m .*gdalwarp",
        ),
        ({"transform": from_origin(1e9, 1e9, 0.5)}, "domain of its projection, found no scale"),
        ({"transform": Affine(0.2, 1e-5, 5, 1e-5, -0.2, 7)}, "rotated, sheared or mir.*gdalwarp"),
        ({"crs": None, "transform": from_origin(15, 47, 1e-4)}, "seems to be in degrees"),
        ({"crs": "EPSG:5513"}, "to the north, found axes to the west of EPSG:5513; .*gdalwarp"),
        (
            {"name": "slope_deg"},
            "band of heights, .* found one named 'slope_deg'; use the map of hei",
        ),
        ({"name": "Depth"}, "positive upward, found one named 'Depth'; .*describe it as 'height'"),
        ({"crs": f"{UTM}+5715"}, "positive upward, found depths, positive downward; .*--calc=-A"),
    ],
)
def test_geotiffs_refused(tmp_path, options, words):
    path = geotiff(tmp_path / "map.tif", **options)
    refuses(path, f"map.tif: expected .*{words}")


def test_a_metre_of_the_map_is_one_on_the_ground(tmp_path):
    """UTM shrinks its central meridian by 0.9996; Mercator stretches by 1 / cos(latitude)."""
    told = dict(read_map(geotiff(tmp_path / "map.tif")).facts)["ground map scale"]
    assert told.startswith(f"1 m of the map is {1 / 0.9996:.7f} m along x and {1 / 0.9996:.7f} m")
    north = 6378137 * np.arctanh(np.sin(np.pi / 3))  # of 60 degrees
    path = geotiff(tmp_path / "map.tif", crs="EPSG:3857", transform=from_origin(0, north, 0.25))
    east = 0.5 / np.sqrt(1 - 6.69437999e-3 * 0.75)  # N cos(60 degrees) / a on the ellipsoid
    refuses(path, rf"1 m of the map is {east:.4g} m along x and .*EPSG:3857")


MOON, MARS = "+a=1737400 +b=1737400", "+a=3396190 +b=3376200"


@pytest.mark.parametrize(
    ("crs", "x", "y", "scale"),
    [
        *(
            (f"+proj=stere +lat_0=-90 {MOON}", x, x, 1 / (1 + x**2 / (2 * 1737400.0**2)))
            for x in (0.0, 100.0, 2000.0, 1e5)
        ),
        ("EPSG:5041", 2e6, 2e6, 1 / 0.994),  # UPS at the north pole
        ("EPSG:32660", 8.7e5, 0.0, None),  # nodes on both sides of the antimeridian
        # northing is the first axis of the system
        ("EPSG:32633+6360", 5e5, 5e6, 1 / 0.9996),  # heights in feet
    ],
)
def test_scale_from_chords(tmp_path, crs, x, y, scale):
    """Right at poles and at the antimeridian, where longitudes jump, and on other bodies."""
    place = from_origin(x - 5, y + 4, CELL)
    told = dict(read_map(geotiff(tmp_path / "map.tif", crs=crs, transform=place)).facts)
    words = told["ground map scale"].split()
    if scale is None:  # transverse Mercator at the equator
        scale = 1 / (0.9996 * np.cosh((x - 5e5) / 0.9996 / 6378137))
        assert_allclose([float(words[6]), float(words[11])], scale, rtol=2e-5)
    else:
        assert_allclose([float(words[6]), float(words[11])], scale, rtol=0, atol=6e-7 * scale)


@pytest.mark.parametrize(
    ("crs", "x", "y", "words"),
    [
        (f"+proj=sinu {MARS}", 2e6, 1e6, r"directions .*'(\+proj=stere .*)' in.tif"),  # sheared
        (f"+proj=longlat {MOON}", 30, -85, r"radius 1737400 m .*'(\+proj=stere .*)' in.tif"),
        ("EPSG:3031", 0, 0, r"1.028 m along x .*-t_srs (EPSG:5042) in.tif"),
        ("EPSG:4326", 179.9, -30, r"degrees .*-t_srs (EPSG:32760) in out"),
    ],
)
def test_projections_refused_with_one_of_their_body(tmp_path, crs, x, y, words):
    """The projection of the message is accepted at the same place."""
    path = geotiff(tmp_path / "map.tif", crs=crs, transform=from_origin(x, y, 1e-4))
    with pytest.raises(DataError, match=words) as error:
        read_map(path)
    new = re.search(words, str(error.value))[1]
    (place,) = zip(*transform(crs, new, [x], [y]), strict=True)
    read_map(geotiff(path, crs=new, transform=from_origin(*place, CELL)))


def test_more_geotiffs_refused(tmp_path):
    path = geotiff(tmp_path / "feet.tif")
    with rasterio.open(path, "r+") as file:
        file.units = ("kelvin",)
    refuses(path, r"unit of length, found the unit 'kelvin'; .* -units")
    path = geotiff(tmp_path / "palette.tif", 40 * ROWS, dtype="uint8", photometric="palette")
    with rasterio.open(path, "r+") as file:
        file.write_colormap(1, {0: (1, 2, 3, 255)})
    refuses(path, "colours of a palette")
    points = [GroundControlPoint(r, c, 10 + c, 20 - r) for r, c in ((0, 0), (0, 9), (9, 0))]
    path = tmp_path / "gcp.tif"
    profile = {"width": 40, "height": 32, "count": 1, "dtype": "float32", "crs": UTM}
    with rasterio.open(path, "w", driver="GTiff", gcps=points, **profile) as file:
        file.write(ROWS.astype("float32"), 1)
    refuses(path, "3 ground control points; resample it: gdalwarp")
    path = geotiff(tmp_path / "map.tif")
    refuses(path, r"no 'cell' for a raster that contains coordinates, found", cell=0.25)
    refuses(path, "expected a map in degrees, found EPSG:32633", geographic="local")
    with pytest.raises(ModelError, match="geographic: expected 'local' or Frame, found bool True"):
        read_map(path, geographic=True)


def test_a_picture_needs_cell_and_registration(tmp_path):
    heights = np.arange(20).reshape(4, 5) * 300
    path = plain(tmp_path / "map.png", heights, "I;16")
    for keys, lacking in (
        ({}, "cell and registration"),
        ({"cell": 2.0}, "registration"),
        ({"registration": "area"}, "cell"),
    ):
        refuses(path, f"map.png: expected {lacking} for a raster .*set cell", **keys)
    area, point = (read_map(path, cell=2.0, registration=each).grid for each in ("area", "point"))
    assert_array_equal(area.x, [1, 3, 5, 7, 9])
    assert_array_equal(point.x, [0, 2, 4, 6, 8])
    assert_array_equal(point.y, [0, 2, 4, 6])
    assert_array_equal(point.z, heights[::-1].T)  # the first row is the northernmost
    assert_array_equal(
        read_map(path, cell=1.0, registration="point", window=(1, 4, 0, 3)).grid.z,
        heights[::-1].T[1:],
    )
    path = plain(tmp_path / "map.tif", ROWS)
    refuses(path, "expected cell and registration")
    found = read_map(path, cell=0.5, registration="area")
    assert_array_equal(found.grid.z, ROWS[::-1].T)
    assert found.grid.x[0] == 0.25


LEVELS = np.arange(35).reshape(5, 7) * 7
BYTES = LEVELS.astype(np.uint8)
COLOURS = {"colours.png": np.stack([BYTES] * 3, -1)}
TEXT = "\n".join(map(str, LEVELS.ravel().tolist())).encode()
GRAY = {  # the same levels in other formats
    **dict.fromkeys(["map.png", "map.bmp", "map.tga", "colours.png"], b""),
    "map.pgm": b"P5\n# by a camera\n7 5\n# most\n255\n" + BYTES.tobytes(),
    "crlf.pgm": b"P5\r\n7 5\r\n255\r\n" + BYTES.tobytes(),
    "16.pgm": b"P5 7 5 1000\n" + LEVELS.astype(">u2").tobytes(),
    "text.pgm": b"P2 # by hand\n7 5\n250\n" + TEXT.replace(b"\n", b" "),
    "16_text.pgm": b"P2\n7 5 65535\n" + TEXT,
}


@pytest.mark.parametrize("ending", ["tif", "jpg", "png", "webp"])
def test_pictures_that_programs_turn_are_refused(tmp_path, ending):
    """GDAL takes rows as they are stored, and levels, with white as zero, too."""
    tags, path = Image.Exif(), tmp_path / f"map.{ending}"
    tags[274] = 4
    Image.fromarray(BYTES).save(path, exif=tags)
    refuses(path, "rows from north to south, found the orientation 4", **AREA)
    with warnings.catch_warnings(action="ignore"):
        options = {"photometric": "miniswhite", "crs": None, "transform": Affine.identity()}
        path = geotiff(tmp_path / "map.tif", 40 * ROWS, dtype="uint8", **options)
    refuses(path, "levels that rise to white, .* --calc=255-A", **AREA)


@pytest.mark.parametrize("name", GRAY)
def test_gray_pictures_of_all_formats(tmp_path, name):
    """GDAL returns an uninitialized transform for PGM, which must not be used as coordinates."""
    if content := GRAY[name]:
        (tmp_path / name).write_bytes(content)
    else:
        Image.fromarray(COLOURS.get(name, BYTES)).save(tmp_path / name)
    refuses(tmp_path / name, "expected cell and registration for a raster without")
    found = read_map(tmp_path / name, cell=0.5, registration="point")
    assert found.gray
    assert_array_equal(found.grid.z, LEVELS[::-1].T)
    assert_array_equal(found.grid.x, 0.5 * np.arange(7))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("map.pgm", b"P2\n7 5\n255\n1 2 3", "expected 35 levels from 0 to 255.*found 3 levels"),
        ("map.pgm", b"P5 6 6 255\n" + bytes([205, 0, 254] * 12), "an occupancy map of ROS; use"),
        ("map.tif", b"version https://git-lfs.github.com/spec/v1\n", "Git LFS; fetch it: git lfs"),
        ("map.sdat", b"", r"in .npz, .tif, .* found '.sdat', a part of a map; header and .*transl"),
        ("map.tif", None, "map.tif: expected a map, found that it cannot be read"),
        ("map.asc", "ncols 4".encode("utf-16"), "UTF-16; convert it: iconv -f utf-16 -t utf-8 ma"),
        ("a.zip", b"", "unpack it: unzip a.zip"),
        ("a.shp", b"", "contours to a raster: gdal_grid .* a.shp out.tif"),
    ],
)
def test_other_contents_are_named(tmp_path, name, content, words):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    refuses(tmp_path / name, words, **AREA)


def test_damaged_files_lead_to_one_error(tmp_path):
    path = plain(tmp_path / "map.png", np.arange(400).reshape(20, 20), "I;16")
    for file, more in ((geotiff(tmp_path / "map.tif", compress="deflate"), {}), (path, AREA)):
        whole = file.read_bytes()
        for content in (b"", b"no TIFF", whole[:20], whole[:-60], b"GIF89a" + whole[6:]):
            file.write_bytes(content)
            refuses(file, rf"{file.name}: expected a readable (GeoTIFF|PNG), .*damaged", **more)
    Image.fromarray(np.arange(36, dtype="uint8").reshape(6, 6)).save(path, transparency=9)
    found = read_map(path, **AREA).grid
    assert np.argwhere(found.holes).tolist() == [[3, 4]]


def test_a_picture_larger_than_memory_is_refused_unread(tmp_path):
    def chunk(kind, data):
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 30000, 30000, 16, 0, 0, 0, 0))
    path = tmp_path / "map.png"
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", b"") + chunk(b"IEND", b""))
    refuses(path, r"at most 5e\+07 nodes, found 9e\+08 .* window = \[x_min", **AREA)


@pytest.mark.parametrize(
    ("driver", "ending", "dtype", "options"),
    [
        ("AAIGrid", "asc", "int16", {}),
        ("GPKG", "gpkg", "int16", {}),
        ("GPKG", "gpkg", "float32", {"TILE_FORMAT": "TIFF"}),
        ("netCDF", "nc", "float32", {}),
        ("netCDF", "grd", "int16", {}),
        ("GS7BG", "grd", "int16", {}),
        ("HFA", "img", "float64", {}),
        ("JP2OpenJPEG", "jp2", "int16", {"REVERSIBLE": "YES", "QUALITY": "100"}),
        ("NITF", "ntf", "int16", {}),
        ("PCIDSK", "pix", "int16", {}),
        ("PCRaster", "map", "float32", {"PCRASTER_VALUESCALE": "VS_SCALAR"}),
        ("GRIB", "grb2", "float32", {}),
        ("GTiff", "", "float64", {}),
    ],
)
def test_rasters_that_are_one_file(tmp_path, driver, ending, dtype, options):
    """Corner heights and their positions are those of rasterio, whatever the ending."""
    rows = np.round(1000 * ROWS)
    whole = geotiff(tmp_path / "whole.tif", rows, dtype=dtype)
    (tmp_path / "alone").mkdir()
    path, written = tmp_path / "alone" / f"map.{ending}", tmp_path / f"map.{ending}"
    rasterio.shutil.copy(whole, written, driver=driver, **options)
    written.rename(path)
    found = read_map(path)
    assert found.crs in ("", UTM)
    with warnings.catch_warnings(action="ignore"):
        dataset = rasterio.open(path)
    with dataset:
        heights = dataset.read(1)
        for row in (0, -1):
            for column in (0, -1):
                x, y = dataset.xy(row % dataset.height, column % dataset.width)
                i, j = np.abs(found.grid.x - x).argmin(), np.abs(found.grid.y - y).argmin()
                assert_allclose((found.grid.x[i], found.grid.y[j]), (x, y), rtol=0, atol=1e-6)
                assert_allclose(found.grid.z[i, j], heights[row, column], rtol=0, atol=1e-3)
    assert_allclose(found.grid.z, rows[::-1].T, rtol=0, atol=1e-3)


def test_formats_that_refer_to_other_files_are_not_opened(tmp_path):
    whole = geotiff(tmp_path / "whole.tif")
    for driver in ("VRT", "ISIS3"):
        path = tmp_path / f"{driver}.dem"
        rasterio.shutil.copy(whole, path, driver=driver)
        refuses(path, "not recognized as being in a supported file format")


@pytest.mark.parametrize(
    ("dtype", "options", "gray"),
    [
        ("uint8", {}, True),
        ("uint16", {"crs": None, "transform": Affine.identity()}, True),
        ("uint16", {}, False),
        ("float32", {"crs": None, "transform": Affine.identity()}, False),
    ],
)
def test_gray_levels_are_told_from_heights(tmp_path, dtype, options, gray):
    """Gray levels have 8 bits, or are unsigned without a position: as PNGs that were converted."""
    with warnings.catch_warnings(action="ignore"):
        path = geotiff(tmp_path / "map.tif", np.round(100 * ROWS), dtype=dtype, **options)
    keys = AREA if "transform" in options else {}
    assert read_map(path, **keys).gray is gray
    with warnings.catch_warnings(action="ignore"), rasterio.open(path, "r+") as file:
        file.scales = (0.1,)
    assert not read_map(path, **keys).gray


def test_heights_in_other_units_are_converted(tmp_path):
    path = geotiff(tmp_path / "map.tif")
    assert dict(read_map(path).facts)["ground map heights"].endswith(FEET)
    for unit, length in (("ft", 0.3048), ("US survey foot", 1200 / 3937), ("[cm]", 0.01)):
        with rasterio.open(path, "r+") as file:
            file.units = (unit,)
        found = read_map(path)
        assert_allclose(found.grid.z, length * ROWS[::-1].T, rtol=1e-15)
        assert f"converted from {unit}" in dict(found.facts)["ground map heights"]
    # GDAL states the unit of a vertical reference system for GeoTIFF only
    path = geotiff(tmp_path / "map.gpkg", driver="GPKG", crs=f"{UTM}+6360")
    assert_allclose(read_map(path).grid.z, 1200 / 3937 * ROWS[::-1].T, rtol=1e-15)


def netcdf(path, order="yx", names="z", bend=0.0, **changes):
    """Write ``ROWS`` from the south, with attributes of x, y and z; return the path."""
    attributes = {"x": {"axis": "X", "units": "m"}, "y": {"axis": "Y"}, "z": {}} | changes
    values = {"x": WEST + CELL * np.arange(40), "y": NORTH + CELL * np.arange(32)}
    values["x"][5] += bend
    with netcdf_file(path, "w") as file:
        for name, axis in values.items():
            file.createDimension(name, axis.size)
            file.createVariable(name, "d", (name,))[:] = axis
        for name in names:
            file.createVariable(name, "f", tuple(order))[:] = ROWS if order == "yx" else ROWS.T
        for name, pairs in attributes.items():
            file.variables[name].__dict__["_attributes"].update(pairs)
    return path


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"x": {}, "y": {}}, r"uniform coordinates x and y, .*none; .*attrs\['axis'\] = 'X'"),
        ({"x": {"axis": "X", "units": "km"}}, "coordinates x in metres or deg.*the unit 'km'"),
        ({"order": "xy"}, "heights along uniform x from 500000 to 500009.75, found"),
        ({"x": {"axis": "X", "actual_range": np.array([0.0, 9.75])}}, "heights at x = 0.* to 9"),
        ({"x": {"axis": "X", "units": "degrees_east"}}, "a map in metres, found degrees"),
        ({"z": {"positive": "down"}}, "heights that are positive upward, found depths"),
        ({"z": {"standard_name": "depth"}}, "heights that are positive upward, found depths"),
        ({"bend": 0.1}, "uniform x from 500000 to 500009.75, found heights at x = 500000 to"),
        ({"names": "zs"}, "one raster of heights, found .*keep one: .*netcdf:in.nc:z out.tif"),
    ],
)
def test_coordinates_of_netcdf_files(tmp_path, changes, words):
    """GDAL takes the last dimension for x, and ignores units and the direction of heights."""
    markers = {"missing_value": np.float32(ROWS[3, 4]), "_FillValue": np.float32(-6)}
    z = {"units": "m", "positive": "up", **markers}
    found = read_map(netcdf(tmp_path / "map.nc", z=z)).grid
    assert_allclose((found.x[0], found.y[0]), (WEST, NORTH), rtol=0, atol=1e-6)
    assert_array_equal(found.holes, ROWS[3, 4] == ROWS.T)
    assert_array_equal(np.where(found.holes, 0, found.z - ROWS.T), 0)
    refuses(netcdf(tmp_path / "map.nc", **changes), f"map.nc: expected .*{words}")
    if not changes.get("x", True):
        refuses(tmp_path / "map.nc", words, **AREA)


def test_a_damaged_header_of_netcdf_claims_no_memory(tmp_path):
    """The netCDF library would allocate what the length of the attribute claims, gigabytes."""
    head = b"CDF\1" + bytes(4) + bytes(8)  # no records, no dimensions
    attribute = struct.pack(">II4sII", 12, 1, b"", 2**31 - 4, 2**31 - 4)
    (tmp_path / "g.nc").write_bytes(head + attribute + bytes(64))
    refuses(tmp_path / "g.nc", "readable netCDF file, found a damaged header")
