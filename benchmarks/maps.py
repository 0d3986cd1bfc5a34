"""Measure windows of a map larger than memory, and plans on a real map with height errors.

``python benchmarks/maps.py`` prints

1. for a GeoTIFF of 20 000 x 20 000 cells of 0.25 m (tiled, only the tiles around the drive
   written), driven over for 20 s: times of reading and driving, and the peak memory of the process,
   by window; also the memory of a process that reads nothing, and the message without a window;
2. for plans up a slope of the Jacksboro fault, a hundred times smaller: the share of seeded
   elevation errors under which their replayed rates keep the limits, and the distance of the ends
   from the plan's end, for a plan that uses all the allowed friction, and for plans with a reserve.

``python benchmarks/maps.py FOLDER`` prints the report of `real_maps` on each map in a folder.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from real_maps import table

from slipfree import (
    Bicubic,
    SlipfreeError,
    SolverOptions,
    direct_kinematics,
    follow,
    settle,
    simulate,
)
from slipfree.catalog import three_wheeler
from slipfree.files.maps.elevation import read_map
from slipfree.geometry.path import Path as Way
from slipfree.plan.polynomial_motion import PolynomialMotion
from slipfree.plan.verification import simulate_plan
from slipfree.plan.warm_start import from_arrays
from slipfree.problem.build_common import Setup
from slipfree.problem.load import load_problem
from slipfree.problem.solve import run_problem
from slipfree.terrain.grid_ops import disturbed
from slipfree.trajectory import Trajectory

CELLS, CELL, TILE = 20000, 0.25, 256  # [1], [m], cells
WEST, SOUTH = 500000.0, 4495000.0  # [m]
PLACE = WEST + 2500.0, SOUTH + 2500.0  # where the drive begins [m]
WINDOWS = (20.0, 100.0, 400.0)  # widths around it [m]
WRITTEN = 512.0  # width of the part of the file that is written [m]
SPEED, DURATION = 0.25, 20.0  # [m/s], [s]
ERRORS = (0.005, 0.02, 0.05)  # rms of the elevation error [m]
CORRELATION, SEEDS = 2.0, 20  # [m], [1]
UTILISATION, RESERVES = 0.95, (0.0, 0.1)  # limit, and what plans leave of it [1]
ROOM = 1e-3  # what limits may be violated by, the accuracy of the plan, each in its unit
PLAN = """
verb = "plan"
[terrain]
sample = "jacksboro"
scale = 0.01
window = [230.0, 273.0, 230.0, 275.0]
friction = 0.5
[vehicle]
catalog = "three_wheeler"
axle = "fixed"
[start]
x = 262.0
y = 252.0
heading = 0.5
[goal]
x = 258.0
y = 258.0
[costs]
slip = 1e3
effort = 0.01
[limits]
steer = [-0.8, 0.8]
utilisation = [0.0, {limit}]
[bounds]
right_rate = [0.0, 2.0]
left_rate = [0.0, 2.0]
steer_rate = [-1.0, 1.0]
[plan]
intervals = 40
smooth = 0.002
[driver]
name = "route"
speed = 0.3
[time]
duration = 60.0
step = 0.5
"""


def write_map(path: Path) -> None:
    """Write the large map, with hills of 20 m in the middle and level ground elsewhere."""
    import rasterio
    from rasterio.transform import Affine

    first = round((2500.0 - WRITTEN / 2) / CELL) // TILE * TILE
    count = -(-round(WRITTEN / CELL) // TILE) * TILE + TILE
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=CELLS,
        height=CELLS,
        count=1,
        dtype="float32",
        crs="EPSG:32633",
        transform=Affine(CELL, 0, WEST, 0, -CELL, SOUTH + CELLS * CELL),
        tiled=True,
        blockxsize=TILE,
        blockysize=TILE,
        compress="deflate",
        SPARSE_OK=True,
    ) as file:
        s = 2 * np.pi * CELL * (first + np.arange(count)) / 20
        file.write(
            (0.3 * np.sin(s)[:, None] * np.cos(s)).astype(np.float32),
            1,
            window=((first, first + count), (first, first + count)),
        )


def drive(path: str, width: float) -> dict[str, float]:
    """Read a window of the map and drive over it; return times and the peak memory."""
    began = time.perf_counter()
    x, y = PLACE
    half = width / 2
    terrain = Bicubic(read_map(path, window=(x - half, x + half, y - half, y + half)).grid, PLACE)
    read_in = time.perf_counter() - began
    dae = direct_kinematics(three_wheeler(), terrain)
    start = settle(dae, x=x, y=y - 3)
    law = follow(dae, three_wheeler(), Way([(x, y - 3), (x, y + 4)]), speed=SPEED)
    found = simulate(dae, start, law, np.linspace(0, DURATION, 81))
    assert found.stop is None, found.stop  # noqa: S101
    return {
        "nodes": terrain.grid.z.size,
        "read": read_in,
        "all": time.perf_counter() - began,
        "end": float(found["y"][-1] - y),
        "memory": peak(),
    }


def peak() -> float:
    """Return the peak memory of this process since it was started. [MB]."""
    # Not getrusage: its figure includes the process that this one was forked from.
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def part(*words: str) -> dict[str, float]:
    """Return the output of a part of this file, run in a separate process."""
    done = subprocess.run([sys.executable, __file__, *words], check=True, capture_output=True)
    return dict(json.loads(done.stdout))


def windows() -> None:
    """Print time and memory by window."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.tif"
        write_map(path)
        whole = CELLS**2 * 8 / 2**20
        print(
            f"GeoTIFF of {CELLS} x {CELLS} cells of {CELL} m, {path.stat().st_size / 2**20:.1f} "
            f"MB on disk, {whole:.0f} MB in memory as doubles"
        )
        print(
            f"{'window [m]':>12}{'nodes':>10}{'read [s]':>10}{'in all [s]':>12}"
            f"{'peak [MB]':>11}{'end, north [m]':>16}"
        )
        print(f"{'none read':>12}{'':32}{part('nothing')['memory']:11.0f}")
        for width in WINDOWS:
            f = part(str(path), str(width))
            print(
                f"{width:12g}{f['nodes']:10.0f}{f['read']:10.2f}{f['all']:12.2f}"
                f"{f['memory']:11.0f}{f['end']:16.6f}"
            )
        try:
            read_map(path)
        except SlipfreeError as error:
            print(f"without a window: {str(error).replace(str(path), 'map.tif')}")


def replayed(setup: Setup, course: PolynomialMotion, rms: float, seed: int) -> Trajectory:
    """Return the motion by the rates of a plan on a ground with height errors."""
    x, y = setup.terrain.origin[:2]
    grid = disturbed(setup.ground.grid, rms, CORRELATION, seed) if rms else setup.ground.grid
    dae = direct_kinematics(setup.vehicle, Bicubic(grid, (x, y), setup.ground.mu))
    start = settle(dae, **{name: setup.start[name][0] for name in ("x", "y", "heading")})
    return simulate_plan(dae, start, course, step=0.5, options=SolverOptions(tolerance=1e-8))


def keeps(found: Trajectory, limits: dict[str, tuple[float, float]]) -> bool:
    """Return whether a motion reaches its end within limits."""
    inside = [
        low - ROOM <= found[name].min() and found[name].max() <= high + ROOM
        for name, (low, high) in limits.items()
    ]
    return found.stop is None and all(inside)


def errors() -> None:
    """Print the share of elevation errors under which the rates of plans keep the limits."""
    limits = {"steer": (-0.8, 0.8), "utilisation": (0.0, UTILISATION)}
    print(
        f"\nplans on the Jacksboro fault at 1:100, replayed under {SEEDS} elevation errors each, "
        f"correlated over {CORRELATION:g} m; limit of the utilisation {UTILISATION:g}"
    )
    print(
        f"{'reserve':>8}{'error rms [m]':>14}{'within limits':>15}{'stopped':>9}"
        f"{'utilisation*':>14}{'end off, rms [m]':>18}{'largest [m]':>13}{'time [s]':>10}"
    )
    for reserve in RESERVES:
        plan, setup, course = planned(UTILISATION - reserve)
        for rms in (0.0, *ERRORS):
            began = time.perf_counter()
            runs = [replayed(setup, course, rms, seed) for seed in range(SEEDS if rms else 1)]
            good = sum(keeps(each, limits) for each in runs)
            ended = [each for each in runs if each.stop is None]
            off = [np.hypot(*(each[name][-1] - plan[name][-1] for name in "xy")) for each in ended]
            used = np.median([each["utilisation"].max() for each in runs])
            print(
                f"{reserve:8g}{rms:14g}{f'{good} of {len(runs)}':>15}{len(runs) - len(ended):9}"
                f"{used:14.3f}{np.sqrt(np.mean(np.square(off))):18.4f}{max(off):13.4f}"
                f"{time.perf_counter() - began:10.1f}",
                flush=True,
            )
    print("* largest of a motion, median over the errors")


def planned(limit: float) -> tuple[Trajectory, Setup, PolynomialMotion]:
    """Return a plan, its model, and its rates."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plan.toml"
        path.write_text(PLAN.format(limit=limit))
        outcome = run_problem(load_problem(path))
    if outcome.trajectory.stop is not None:
        sys.exit(f"no plan: {outcome.trajectory.stop.words}")
    return outcome.trajectory, outcome.setup, from_arrays(outcome.arrays, "plan").motion


if __name__ == "__main__":
    if sys.argv[1:] == ["nothing"]:
        print(json.dumps({"memory": peak()}))
    elif len(sys.argv) == 2:
        table(Path(sys.argv[1]))
    elif len(sys.argv) > 1:
        print(json.dumps(drive(sys.argv[1], float(sys.argv[2]))))
    else:
        windows()
        errors()
