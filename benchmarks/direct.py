"""Compare direct kinematics on this package's terrain with CasADi's own spline node.

``python benchmarks/direct.py`` drives the paper's three-wheeler 10 m straight over one surface,
given on maps of 20 x 20, 200 x 200 and 2000 x 2000 nodes. Every row runs in a separate process, so
that its peak memory can be measured. *ours*: ``Bicubic``, and the options of ``simulate`` for IDAS.
*stock*: the same equations with ``casadi.interpolant('bspline')``, and IDAS with its default
options. CPU time is that of the integrator call alone, the least of five; the error is that of the
last configuration against *ours* at 1e-12. Ratios at equal error interpolate the work-precision
curves.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from typing import Any

import casadi as ca
import numpy as np
from reference import heading

from slipfree import Bicubic, Grid, direct_kinematics, settle, straight
from slipfree.catalog import three_wheeler
from slipfree.lookups import LookupTable
from slipfree.records import leaves
from slipfree.solve.initial_conditions import solve_initial_conditions
from slipfree.solve.system import System, with_inputs
from slipfree.terrain.base import Jet, jet_of

SIZES = (20, 200, 2000)
TOLERANCES = (1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
EXTENT = 20.0  # side of the map [m]
DISTANCE, SPEED = 10.0, 0.5  # [m], [m/s]
PATIENCE = 60  # seconds for a row


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


def surface(nodes: int) -> Grid:
    """Return hills with shorter waves on them, relief about 0.7 m, on a square map."""
    axis = np.linspace(0, EXTENT, nodes)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    z = 0.3 * np.sin(0.7 * x) * np.cos(0.5 * y) + 0.05 * np.sin(2.1 * x + 1.3 * y)
    return Grid(axis, axis, z)


def wrapped(system: System) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the DAE that ``simulate`` passes to IDAS, and the option with its Jacobian."""
    symbols = [ca.MX.sym(name, system.core.size1_in(k)) for k, name in enumerate("txzu")]
    ode, alg = system.core(*symbols)
    equations = dict(zip("txzu", symbols, strict=True)) | {"ode": ode, "alg": alg}
    return equations, {"cache": {"jacF": system.jacobian}}


def written_out(system: System, law: Any) -> dict[str, Any]:
    """Return the DAE as one SX graph, which CasADi differentiates."""
    dae = system.dae
    x, z, u = dae.columns()
    rows = [dae.ode, ca.vertcat(*dae.alg)[: system.motion_size]]
    ode, alg = ca.substitute(rows, [u], [ca.vertcat(*leaves(law))])
    given = ca.SX.sym("given", u.numel())
    return {"t": dae.t, "x": x, "z": z[: system.motion_size], "u": given, "ode": ode, "alg": alg}


def row(kind: str, nodes: int) -> dict[str, Any]:
    """Build one terrain and model, drive, and return the costs."""
    grid = surface(nodes)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.perf_counter()
    terrain: Any = Bicubic(grid) if kind == "ours" else Stock(grid)
    vehicle = three_wheeler(mass=0.0, wheel_mass=0.0)  # no forces: the motion alone
    dae = direct_kinematics(vehicle, terrain)
    built = time.perf_counter() - begin
    start = settle(dae, x=5.0, y=4.0, heading=-0.2)
    law = straight(dae, vehicle, start, speed=SPEED)
    system = with_inputs(dae, law, 100)
    x = dae.rows("x", start, -1)
    z = solve_initial_conditions(system, 0.0, x, dae.rows("z", start, -1), system.u[:, 0])
    equations, own = wrapped(system) if kind == "ours" else (written_out(system, law), {})
    t = np.linspace(0, DISTANCE / SPEED, 101)
    runs = {}
    for tolerance in (*TOLERANCES, 1e-12):
        options = {"reltol": tolerance, "abstol": tolerance, "max_num_steps": 10**6, **own}
        solver = ca.integrator("motion", "idas", equations, 0.0, t, options)
        times = []
        for _ in range(5):
            begin = time.process_time()
            found = solver(x0=x, z0=z, u=system.u[:, 0])
            times.append(time.process_time() - begin)
        counts = solver.stats()
        end = (np.array(found["xf"])[:, -1] + dae.shift[0]).tolist()
        runs[tolerance] = (min(times), counts["nsteps"], counts["nfevals"], end)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"built": built, "peak": peak / 1024, "map": (peak - before) / 1024, "runs": runs}


def ratio(ours: list[tuple[float, float]], stock: list[tuple[float, float]]) -> str:
    """Return the range of CPU time ratios, stock over ours, at the errors that both reach."""
    (error, cpu), (error_s, cpu_s) = (np.log(np.array(sorted(line))).T for line in (ours, stock))
    low, high = max(error[0], error_s[0]), min(error[-1], error_s[-1])
    at = np.linspace(low, high, 9)
    ratios = np.exp(np.interp(at, error_s, cpu_s) - np.interp(at, error, cpu))
    return (
        f"{ratios.min():.1f} to {ratios.max():.1f} times, at errors {np.exp(low):.0e} to "
        f"{np.exp(high):.0e} m"
    )


def main() -> None:
    """Print the table."""
    heading()
    print("map          terrain  build s  peak MB  tol    steps  residuals  ms CPU/m   error")
    for nodes in SIZES:
        lines, exact = {}, None
        for kind in ("ours", "stock"):
            command = [sys.executable, __file__, kind, str(nodes)]
            try:
                done = subprocess.run(command, capture_output=True, timeout=PATIENCE, check=True)
            except subprocess.TimeoutExpired:
                print(f"{nodes}^2{'':8} {kind:8} no result in {PATIENCE} s")
                continue
            found = json.loads(done.stdout)
            runs = {float(key): value for key, value in found["runs"].items()}
            exact = exact or runs[1e-12][3]
            lines[kind] = []
            for tolerance in TOLERANCES:
                cpu, steps, residuals, end = runs[tolerance]
                error = float(np.abs(np.subtract(end, exact)).max())
                lines[kind].append((error, cpu))
                print(
                    f"{nodes:4}^2       {kind:8} {found['built']:7.2f} {found['peak']:8.0f}  "
                    f"{tolerance:.0e} {steps:5} {residuals:10} {1e3 * cpu / DISTANCE:9.2f} "
                    f"  {error:.1e}"
                )
        if len(lines) == 2:
            print(f"{nodes:4}^2  stock takes {ratio(lines['ours'], lines['stock'])}")


if __name__ == "__main__":
    if len(sys.argv) == 3:
        print(json.dumps(row(sys.argv[1], int(sys.argv[2]))))
    else:
        main()
