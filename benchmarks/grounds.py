"""Grounds: evaluation of maps and of CasADi's spline; windows of a map larger than memory.

``python benchmarks grounds [PART ...]``:

evaluation  CPU time per point of height, gradient and Hessian in nanoseconds, alone and with the
            Jacobian that Newton's method needs: the least of many runs over 1000 points, along a
            driven path and at random points, for maps of 20 x 20 to 4000 x 4000 nodes: compiled, as
            in `Bicubic.jet`; interpreted, as without a compiler; CasADi's own B-spline,
            differentiated by CasADi
windows     a GeoTIFF of 20 000 x 20 000 cells of 0.25 m (tiled, only the tiles around the drive
            written), driven over for 20 s: times of reading and driving, and the peak memory of the
            process, by window; also the memory of a process that reads nothing, and the message
            without a window
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
from common import apart, cpu, run_parts

from slipfree import Bicubic, Grid, SlipfreeError, direct_kinematics, follow, settle, simulate
from slipfree.catalog import three_wheeler
from slipfree.core.lookups import LookupTable, lookup_function
from slipfree.files.maps.elevation import read_map
from slipfree.geometry.path import Path as Way
from slipfree.terrain import bicubic, kernel
from slipfree.terrain.base import Jet, jet_of

SIZES = (20, 200, 1000, 4000)
STOCK = 200  # nodes a side up to which the stock spline is fitted
SPACING, COUNT = 0.1, 1000
CELLS, CELL, TILE = 20000, 0.25, 256  # [1], [m], cells
WEST, SOUTH = 500000.0, 4495000.0  # [m]
PLACE = WEST + 2500.0, SOUTH + 2500.0  # where the drive begins [m]
WINDOWS = (20.0, 100.0, 400.0)  # widths around it [m]
WRITTEN = 512.0  # width of the part of the file that is written [m]
EXTENT = 20.0  # side of the map of the stock spline [m]
SPEED, DURATION = 0.25, 20.0  # [m/s], [s]


class Stock:
    """Terrain with CasADi's own spline: a fitted B-spline as one node of the graph."""

    origin = (0.0, 0.0, 0.0)
    has_friction, friction_domain = False, None

    def __init__(self, grid: Grid) -> None:
        nodes = [list(grid.x), list(grid.y)]
        spline = ca.interpolant("spline", "bspline", nodes, grid.z.ravel(order="F"))
        place = ca.MX.sym("place", 2)
        self.function = ca.Function("height", [place], [spline(place)], {"never_inline": True})
        self.domain = (0.0, EXTENT, 0.0, EXTENT)
        self.elevation = Bicubic(grid).elevation  # for the check of the start only

    def height(self, x: ca.SX, y: ca.SX, _lookups: LookupTable | None = None) -> ca.SX:
        """Return the height as a call of the node. [m]."""
        return self.function(ca.vertcat(x, y))

    def jet(self, x: ca.SX, y: ca.SX, _lookups: LookupTable | None = None) -> Jet:
        """Return height, gradient and Hessian, by CasADi's differentiation of the node."""
        return jet_of(self.height(x, y), x, y)

    def friction(self, _x: ca.SX, _y: ca.SX, _lookups: LookupTable) -> ca.SX:
        """Return a coefficient of friction of one, which is never used. [1]."""
        return ca.SX(1)

    def hole_margin(self, _x: ca.SX, _y: ca.SX, _lookups: LookupTable) -> None:
        """Return no distance: the map has no holes."""


def called(
    ground: Bicubic | Stock, *, slopes: bool
) -> Callable[[np.ndarray], Callable[[], object]]:
    """Return a function that evaluates a jet or its Jacobian at points by CasADi."""
    x, y, lookups = ca.SX.sym("x"), ca.SX.sym("y"), LookupTable()
    jet = ground.jet(x, y, lookups)
    values = ca.vertcat(jet.height, jet.gradient, *(jet.hessian[k] for k in (0, 1, 3)))
    found = [values, ca.jacobian(values, ca.vertcat(x, y))] if slopes else [values]
    function = lookup_function(lookups.lookups, "jet", [x, y], found).map(COUNT)

    def over(at: np.ndarray) -> Callable[[], object]:
        buffer, run = function.buffer()
        held = [np.ascontiguousarray(row) for row in at]
        held += [np.zeros(function.nnz_out(k)) for k in range(function.n_out())]
        for k in range(2):
            buffer.set_arg(k, memoryview(held[k]))
        for k in range(function.n_out()):
            buffer.set_res(k, memoryview(held[2 + k]))
        return lambda: (run(), held, buffer)

    return over


def without_kernel(grid: Grid) -> Bicubic:
    """Return a ground that does not use the kernel."""
    register, bicubic.register_ground = bicubic.register_ground, lambda *_: None
    try:
        ground = Bicubic(grid)
        ground.jet(ca.SX.sym("x"), ca.SX.sym("y"), LookupTable())
    finally:
        bicubic.register_ground = register
    return ground


def evaluation() -> None:
    """Print the table."""
    if kernel.library() is None:
        raise SystemExit(
            "slipfree was installed without a C compiler; install it again where there is one"
        )
    print("ns a point                    jet: path  random    with Jacobian: path  random")
    rng = np.random.default_rng(0)
    for size in SIZES:
        axis = SPACING * np.arange(size)
        waves = 0.3 * np.sin(0.7 * axis)[:, None] * np.cos(0.5 * axis)
        grid = Grid(axis, axis, waves + 0.002 * rng.standard_normal((size, size)))
        way = np.linspace(-0.9, 0.9, COUNT)  # 1.8 m, a few mm a step, as an integrator goes
        half = 0.499 * SPACING * (size - 1)
        places = [np.array([way, way]), rng.uniform(-half, half, (2, COUNT))]
        kinds = {"compiled": Bicubic(grid), "interpreted": without_kernel(grid)}
        if size <= STOCK:
            kinds["CasADi's B-spline"] = Stock(grid)
        middle = np.reshape(kinds["compiled"].origin[:2], (2, 1))
        for name, ground in kinds.items():
            corner = middle if isinstance(ground, Stock) else 0.0
            both = [called(ground, slopes=slopes) for slopes in (False, True)]
            times = [1e9 / COUNT * cpu(make(at + corner))[0] for make in both for at in places]
            row = "".join(f"{each:10.0f}" for each in times)
            print(f"{size:5d}^2  {name:18s}{row}", flush=True)


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
    law = follow(dae, Way([(x, y - 3), (x, y + 4)]), speed=SPEED)
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
        print(f"{'none read':>12}{'':32}{apart(peak):11.0f}")
        for width in WINDOWS:
            f = apart(drive, str(path), width)
            print(
                f"{width:12g}{f['nodes']:10.0f}{f['read']:10.2f}{f['all']:12.2f}"
                f"{f['memory']:11.0f}{f['end']:16.6f}"
            )
        try:
            read_map(path)
        except SlipfreeError as error:
            print(f"without a window: {str(error).replace(str(path), 'map.tif')}")


def main() -> None:
    """Print the parts."""
    run_parts({"evaluation": evaluation, "windows": windows})
