"""Time height, gradient and Hessian of a ground: compiled, interpreted, and CasADi's spline.

``python benchmarks/kernel.py`` prints the CPU time per point in nanoseconds, the least of many runs
over 1000 points, along a driven path and at random points of the map, for maps of 20 x 20 to
4000 x 4000 nodes. It compares a loop over the C code without CasADi; the cells that this code looks
up for CasADi, as in `Bicubic.jet`; cells from CasADi's tables, which are used without a compiler;
and CasADi's own B-spline, differentiated by CasADi; each also with the Jacobian of the six numbers,
which Newton's method needs.
"""

from __future__ import annotations

import ctypes
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
from direct import Stock
from reference import heading

from slipfree import Bicubic, Grid
from slipfree.lookups import LookupTable, lookup_function
from slipfree.terrain import bicubic, kernel

SIZES = (20, 200, 1000, 4000)
STOCK = 200  # nodes a side up to which the stock spline is fitted
SPACING, COUNT, REPEATS, SECONDS = 0.1, 1000, 200, 1.0
SOURCE = Path(kernel.__file__).with_name("kernel.c")
LOOP = f"""#include "{SOURCE}"
API double loop(long long n, const double *at) {{
  double found[18], point[3], a, b, line[3][4], sum = 0, *d;
  const double *arg[] = {{point}};
  long long k;
  int i, j;
  for (k = 0; k < n; k++) {{
    point[0] = at[2 * k], point[1] = at[2 * k + 1], point[2] = 0;
    polynomial(&grounds[0], arg, found);
    a = point[0] - found[0], b = point[1] - found[1];
    for (j = 0; j < 4; j++) {{
      d = found + 2 + 4 * j;
      line[0][j] = d[0] + a * (d[1] + a / 2 * (d[2] + a / 3 * d[3]));
      line[1][j] = d[1] + a * (d[2] + a / 2 * d[3]);
      line[2][j] = d[2] + a * d[3];
    }}
    for (i = 0; i < 3; i++) {{
      d = line[i];
      sum += d[0] + b * (d[1] + b / 2 * (d[2] + b / 3 * d[3]));
      if (i < 2) sum += d[1] + b * (d[2] + b / 2 * d[3]);
      if (i < 1) sum += d[2] + b * d[3];
    }}
  }}
  return sum;
}}
"""


def least(task: Callable[[], object]) -> float:
    """Return the least CPU time of a task per point. [ns]."""
    best, begin = np.inf, time.perf_counter()
    for _ in range(REPEATS):
        clock = time.process_time_ns()
        task()
        best = min(best, time.process_time_ns() - clock)
        if time.perf_counter() - begin > SECONDS:
            break
    return best / COUNT


def plain(ground: Bicubic, folder: str) -> Callable[[np.ndarray], Callable[[], object]]:
    """Return a function that evaluates points in a C loop."""
    code, file = Path(folder, "loop.c"), Path(folder, f"loop{ground.grid.x.size}.so")
    code.write_text(LOOP)
    subprocess.run(["cc", "-O2", "-fPIC", "-shared", code, "-o", file, "-lm"], check=True)
    library = ctypes.CDLL(str(file))
    library.loop.restype = ctypes.c_double
    table = ground._table
    (i, last_i), (j, last_j) = ground._cells
    place = ground.grid.x[i] - ground.origin[0], ground.grid.y[j] - ground.origin[1]
    numbers = np.array([0, *place, *ground.grid.spacing, i, j, last_i, last_j], dtype=float)
    library.kernel_open(
        0,
        table.ctypes.data_as(ctypes.c_void_p),
        ctypes.c_longlong(table.shape[1]),
        numbers.ctypes.data_as(ctypes.c_void_p),
    )

    def over(at: np.ndarray) -> Callable[[], object]:
        points = np.ascontiguousarray(at.T)
        held = points.ctypes.data_as(ctypes.c_void_p)
        return lambda: (library.loop(ctypes.c_longlong(COUNT), held), points)

    return over


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
    opened, bicubic.opened = bicubic.opened, lambda *_: None
    try:
        ground = Bicubic(grid)
        ground.jet(ca.SX.sym("x"), ca.SX.sym("y"), LookupTable())
    finally:
        bicubic.opened = opened
    return ground


def main() -> None:
    """Print the table."""
    heading()
    if kernel.library() is None:
        sys.exit("slipfree was installed without a C compiler; install it again where there is one")
    print("ns a point                    jet: path  random    with Jacobian: path  random")
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        for size in SIZES:
            axis = SPACING * np.arange(size)
            waves = 0.3 * np.sin(0.7 * axis)[:, None] * np.cos(0.5 * axis)
            grid = Grid(axis, axis, waves + 0.002 * rng.standard_normal((size, size)))
            ground = Bicubic(grid)
            way = np.linspace(-0.9, 0.9, COUNT)  # 1.8 m, a few mm a step, as an integrator goes
            half = 0.499 * SPACING * (size - 1)
            kinds = {
                "a loop in C": (plain(ground, folder), None),
                "compiled": tuple(called(ground, slopes=slopes) for slopes in (False, True)),
                "interpreted": tuple(
                    called(without_kernel(grid), slopes=slopes) for slopes in (False, True)
                ),
            }
            if size <= STOCK:
                stock = Stock(grid)
                kinds["CasADi's B-spline"] = tuple(
                    called(stock, slopes=slopes) for slopes in (False, True)
                )
            for name, (values, slopes) in kinds.items():
                corner = ground.origin[:2] if name == "CasADi's B-spline" else (0.0, 0.0)
                places = [np.array([way, way]), rng.uniform(-half, half, (2, COUNT))]
                times = [
                    least(make(at + np.reshape(corner, (2, 1))))
                    for make in (values, slopes)
                    if make
                    for at in places
                ]
                row = "".join(f"{each:10.0f}" for each in times)
                print(f"{size:5d}^2  {name:18s}{row}", flush=True)


if __name__ == "__main__":
    main()
