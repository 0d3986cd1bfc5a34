"""Read published maps and drive over them; part of `benchmarks/maps.py`.

For each file of a folder it prints whether the file is read unchanged or refused, the keys or the
command that follow the advice of the message, size, reference system, holes, the largest difference
from rasterio at all nodes and at the corners, and a drive of 100 m on a spiral around the position
that is farthest from holes and border, without a window.
"""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
import rasterio

from slipfree import SlipfreeError
from slipfree.files.maps.elevation import Map, read_map
from slipfree.problem.load import load_problem
from slipfree.problem.solve import run_problem
from slipfree.terrain.grid_ops import hole_distance

LENGTH, SPEED = 100.0, 1.0  # [m], [m/s]
SMALLEST = 10.0  # distance from holes and border that the spiral needs [m]
REMEDIES = {  # keys that a message asks for
    "set geographic": {"geographic": "local"},
    "set cell": {"cell": 5.0, "registration": "area"},
    "per gray level": {"vertical_scale": 5e-5},
    "per unit of the heights": {"vertical_scale": 0.01},
}
COMMANDS = {"gdal_translate -b 1": ["gdal_translate", "-q", "-b", "1"]}
PROBLEM = """
verb = "direct"
[terrain]
file = "{file}"
{keys}
[vehicle]
catalog = "three_wheeler"
[start]
x = {x!r}
y = {y!r}
heading = {heading!r}
[driver]
name = "follow"
speed = {speed!r}
path = {path!r}
[time]
duration = {duration!r}
step = 1.0
[solver]
tolerance = {tolerance!r}
"""


def table(folder: Path) -> None:
    """Print one paragraph for each map in a folder."""
    warnings.simplefilter("ignore")
    for path in sorted(folder.iterdir()):
        print(f"\n{path.name}")
        with tempfile.TemporaryDirectory() as work:
            try:
                _report(path, Path(work), {})
            except SlipfreeError as error:
                print(f"  refused: {str(error).replace(f'{path}: ', '')}")


def _report(path: Path, work: Path, keys: dict[str, object]) -> None:
    """Read a map, following the remedies of messages, and drive on it."""
    try:
        options = {name: value for name, value in keys.items() if name != "vertical_scale"}
        began = time.perf_counter()
        found = read_map(path, **options)  # type: ignore[arg-type]
        spent = time.perf_counter() - began
        motion = _driven(path, work, found, keys, 1e-8)
    except SlipfreeError as error:
        words = str(error)
        more = next((new for text, new in REMEDIES.items() if text in words), None)
        if more is not None and not more.keys() & keys.keys():
            print(f"  remedy of the message: {more}")
            return _report(path, work, keys | more)
        if "grid_map message" in words:
            print("  remedy of the message: arrays x, y, z as .npz, by rosbags")
            return _report(_grid_map(path, work / "out.npz"), work, keys)
        command = next((each for text, each in COMMANDS.items() if text in words), None)
        if command is None:
            raise
        print(f"  remedy of the message: {' '.join(command)}")
        subprocess.run([*command, str(path), str(work / "out.tif")], check=True)
        return _report(work / "out.tif", work, keys)
    grid = found.grid
    holes = 0.0 if grid.holes is None else 100 * grid.holes.mean()
    print(
        f"  read in {spent:.2f} s: {' x '.join(map(str, grid.z.shape))} nodes, "
        f"{np.ptp(grid.x):.6g} x {np.ptp(grid.y):.6g} m, heights {grid.values.min():.6g} to "
        f"{grid.values.max():.6g} m, {holes:.1f} % holes, {found.crs[:20] or 'no CRS'}"
    )
    for name, words in found.facts:
        if name == "ground points":
            print(f"  {words}")
    print(f"  against rasterio: {_differences(path, found)}")
    run, finer = motion, _driven(path, work, found, keys, 1e-10)
    apart = math.dist(*([each[name][-1] for name in "xyz"] for each in (run, finer)))
    length = float(np.hypot(np.diff(run["x"]), np.diff(run["y"])).sum())
    print(
        f"  driven {length:.1f} m without a window: {run.outcome.name}"
        f"{'' if run.stop is None else f' ({run.stop.words})'}, heights {run['z'].min():.2f} to "
        f"{run['z'].max():.2f} m; end at 1e-8 and 1e-10: {apart:.1e} m apart"
    )
    return None


def _grid_map(path: Path, out: Path) -> Path:
    """Write the first layer of the first grid_map message of a ROS bag as arrays x, y, z."""
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        connection, _, raw = next(reader.messages())
        message = reader.deserialize(raw, connection.msgtype)
    info, data = message.info, message.data[0]
    columns, rows = (each.size for each in data.layout.dim)
    z = data.data.reshape(columns, rows).T  # row 0 and column 0 are at the largest x and y
    z = np.roll(z, (-message.outer_start_index, -message.inner_start_index), (0, 1))[::-1, ::-1]
    place = info.pose.position
    x = place.x + info.resolution * (np.arange(rows) - (rows - 1) / 2)
    y = place.y + info.resolution * (np.arange(columns) - (columns - 1) / 2)
    np.savez(out, x=x, y=y, z=z)
    return out


def _differences(path: Path, found: Map) -> str:
    """Return the largest differences of heights from those of rasterio."""
    try:
        with rasterio.open(path) as file:
            rows = file.read(1, masked=True).astype(float).filled(np.nan)
            upward = file.transform.e > 0
    except rasterio.RasterioIOError:
        return "no raster"
    z = found.grid.z.copy()
    if found.grid.holes is not None:
        z[found.grid.holes] = np.nan
    expected = (rows if upward and not file.transform.is_identity else rows[::-1]).T
    same_holes = np.array_equal(np.isnan(z), np.isnan(expected))
    gaps = np.abs(z - expected)
    corners = gaps[[0, 0, -1, -1], [0, -1, 0, -1]]
    bare = int(np.isnan(corners).sum())
    largest = "-" if bare == 4 else f"{np.nanmax(corners):.1e} m"
    return (
        f"corners {largest}{f' ({bare} are holes)' if bare else ''}, all nodes "
        f"{np.nanmax(gaps):.1e} m, holes {'equal' if same_holes else 'differ'}"
    )


def _enlargement(room: float) -> float:
    """Return the factor by which a map is enlarged that is too small for 100 m [1]."""
    return 1.0 if room > SMALLEST else float(np.ceil(2 * SMALLEST / room))


def _driven(path: Path, work: Path, found: Map, keys: dict[str, object], tolerance: float):
    """Return the motion along a spiral of 100 m around the place farthest from holes."""
    grid = found.grid
    border = np.minimum.outer(
        np.minimum(grid.x - grid.x[0], grid.x[-1] - grid.x),
        np.minimum(grid.y - grid.y[0], grid.y[-1] - grid.y),
    )
    room = np.minimum(border, hole_distance(grid))
    i, j = np.unravel_index(room.argmax(), room.shape)
    scale = _enlargement(room[i, j])
    inner, outer = (
        min(part * scale * room[i, j], most) for part, most in ((0.35, 15.0), (0.75, 30.0))
    )
    angles = [0.0]
    while (turned := angles[-1]) * (inner + outer) / 2 < 1.2 * LENGTH:
        angles.append(turned + 1.0 / inner)
    share = np.array(angles) / angles[-1]
    radius = inner + (outer - inner) * share
    x = scale * grid.x[i] + radius * np.cos(angles)
    y = scale * grid.y[j] + radius * np.sin(angles)
    points = np.column_stack([x, y]).tolist()
    heading = math.atan2(points[1][1] - points[0][1], points[1][0] - points[0][0]) - math.pi / 2
    keys = keys if scale == 1 else keys | {"scale": scale}
    lines = [f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v!r}" for k, v in keys.items()]
    (work / "p.toml").write_text(
        PROBLEM.format(
            file=path.resolve(),
            keys="\n".join(lines),
            x=points[0][0],
            y=points[0][1],
            heading=heading,
            speed=SPEED,
            path=points,
            duration=LENGTH / SPEED,
            tolerance=tolerance,
        )
    )
    return run_problem(load_problem(work / "p.toml")).trajectory


if __name__ == "__main__":
    table(Path(sys.argv[1]))
