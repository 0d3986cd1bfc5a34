"""Cost of dynamic motions on formulas and maps, interpreted and compiled.

``python benchmarks/dynamics.py`` prints

1. microseconds of CPU of a search for the ground point nearest to a wheel: on a formula, on a map
   with the compiled search, on a map without it;
2. for three vehicles at four speeds, on a formula and on its bicubic map: steps and CPU time of the
   integration per metre, at the loosest tolerance of 1e-5 to 1e-7 with an error below 0.1 mm
   against 1e-10; interpreted and compiled.

The time of the integration is that of `simulate` with two samples, the least of a few runs, less
that of a run whose duration is a thousandth. ``python
benchmarks/dynamics.py search`` prints the first part alone, ``... rocky7`` (or ``car``,
``three_wheeler``) one vehicle.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from reference import heading

from slipfree import Analytic, Bicubic, Grid, SolverOptions, catalog, dynamics, settle, simulate
from slipfree.contact import touch
from slipfree.terrain.base import Terrain
from slipfree.trajectory import Trajectory, path_length
from slipfree.vehicle.sections.torus import Torus
from slipfree.vehicle.tree import Vehicle

SPEEDS = (0.1, 0.3, 1.0, 3.0)  # [m/s]
TOLERANCES = (1e-5, 1e-6, 1e-7)  # 1e-4 is not reliable
EXACT, ALLOWED = 1e-10, 1e-4  # tolerance of the reference [1]; error [m]
MU, RISE, REPEATS = 0.8, 0.3, 3  # friction [1]; time in which the rates rise [s]; runs
SPACING, HALF = 0.1, 9.0  # of maps, and half their side [m]
QUESTIONS = 2000


def hills(x: Any, y: Any, lib: Any) -> Any:
    """Return the heights of smooth hills [m]."""
    long = 0.12 * lib.sin(2 * np.pi * x / 7) * lib.cos(2 * np.pi * y / 9)
    return long + 0.05 * lib.sin(2 * np.pi * (x + 0.6 * y) / 4.3)


def waves(x: Any, y: Any, lib: Any) -> Any:
    """Return the heights of waves of 20 mm, 0.8 m long, on longer ones [m]."""
    short = 0.02 * lib.sin(2 * np.pi * y / 0.8) * lib.cos(2 * np.pi * x / 1.1)
    return short + 0.05 * lib.sin(2 * np.pi * y / 3 + x)


Height = Callable[[Any, Any, Any], Any]
VEHICLES: dict[str, tuple[Vehicle, Height]] = {
    "three_wheeler": (catalog.three_wheeler(stiffness=150.0, damping=10.0), hills),
    "car": (catalog.ackermann(), hills),
    "rocky7": (catalog.rocky7(), waves),
}


def grounds(height: Height) -> dict[str, Terrain]:
    """Return a formula and its map."""
    axis = np.arange(-HALF, HALF + SPACING / 2, SPACING)
    z = height(axis[:, None], axis[None, :], np)
    return {
        "formula": Analytic(lambda x, y: height(x, y, ca), mu=MU),
        "map": Bicubic(Grid(axis, axis, z), mu=MU),
    }


def search_times() -> None:
    """Print microseconds of CPU of one search, least of several runs over random poses."""
    section, radius = Torus(0.03, 0.12), 0.15
    formula, grid = grounds(hills).values()
    rng = np.random.default_rng(0)
    place, axle = rng.uniform(-8, 8, (2, QUESTIONS)), rng.standard_normal((3, QUESTIONS))
    axle[2] *= 0.2
    center = hills(*place, np) + radius + rng.uniform(-0.01, 0.01, QUESTIONS)
    asked = np.vstack([place, center, axle / np.linalg.norm(axle, axis=0)])
    searches = {
        "formula": (touch.search_function(formula, section, radius), 0.0),
        "map, compiled search": (touch.search_function(grid, section, radius), grid.origin[2]),
        "map, graph": (touch._search_graph(grid, section, radius), grid.origin[2]),
    }
    for name, (search, base) in searches.items():
        print(f"  {name:22} {least(search, asked - np.eye(6)[:, [2]] * base):6.2f} us a search")


def least(search: ca.Function, asked: np.ndarray) -> float:
    """Return the least CPU time of one search over several rounds [us]."""
    buffer, run = search.buffer()
    at, found = np.zeros(6), np.zeros(13)
    buffer.set_arg(0, memoryview(at))
    buffer.set_res(0, memoryview(found))
    times = []
    for _ in range(10):
        begin = time.process_time()
        for column in asked.T:
            at[:] = column
            run()
        times.append(time.process_time() - begin)
    return 1e6 * min(times) / asked.shape[1]


class Cost(NamedTuple):
    """Steps and CPU time [ms] of an integration per metre, and its error [m]."""

    steps: float
    cpu: float
    error: float
    tolerance: float


class Drive:
    """A vehicle that accelerates to a speed from rest, over 3 m, or 1.5 s at least."""

    def __init__(self, vehicle: Vehicle, ground: Terrain, speed: float) -> None:
        self.model = dynamics(vehicle, ground)
        self.start = settle(self.model, x=0.0, y=0.0, heading=0.0)
        rate = ca.tanh(self.model.t / RISE) * speed
        rates = {f"{wheel.name}_rate": rate / wheel.radius for wheel in vehicle.wheels}
        names = [label.full for part in self.model.labels.u for label in part]
        self.inputs = self.model.inputs(**{name: rates.get(name, 0.0) for name in names})
        self.duration = max(3.0 / speed, 1.5)

    def run(self, tolerance: float, samples: int = 2, part: float = 1.0, **more: Any) -> Trajectory:
        """Return the motion over a part of the duration."""
        t = np.linspace(0, self.duration * part, samples)
        options = SolverOptions(tolerance=tolerance, **more)
        return simulate(self.model, self.start, self.inputs, t, options=options)

    def cpu(self, tolerance: float, **more: Any) -> float:
        """Return the CPU time of the integration [s], without preparation and samples."""
        times = [
            [self.run(tolerance, 2, part, **more).statistics["cpu_seconds"] for part in (1.0, 1e-3)]
            for _ in range(REPEATS)
        ]
        whole, short = np.min(times, axis=0)
        return float(whole - short)


def loosest(drive: Drive) -> tuple[Cost, float]:
    """Return the cost at the loosest tolerance with an allowed error, and the path length [m]."""
    exact = drive.run(EXACT, 41)
    length = path_length(exact)
    for tolerance in TOLERANCES:
        run = drive.run(tolerance, 41)
        error = max(np.abs(run[name] - exact[name]).max() for name in "xyz")
        if error < ALLOWED:
            break
    cpu = drive.cpu(tolerance)
    return Cost(run.statistics["steps"] / length, 1e3 * cpu / length, error, tolerance), length


def vehicle_costs(name: str) -> None:
    """Print the costs of a vehicle."""
    vehicle, height = VEHICLES[name]
    print(f"{name}: speed; formula, map: tolerance, error, steps/m, ms/m, compiled ms/m")
    for speed in SPEEDS:
        words = []
        for kind, ground in grounds(height).items():
            drive = Drive(vehicle, ground, speed)
            cost, length = loosest(drive)
            compiled = 1e3 * drive.cpu(cost.tolerance, compiled=True) / length
            words.append(
                f"{kind} {cost.tolerance:.0e} {1e3 * cost.error:.3f} mm {cost.steps:4.0f} "
                f"{cost.cpu:5.1f} {compiled:5.1f}"
            )
        print(f"  {speed:3g} m/s: " + "; ".join(words), flush=True)


if __name__ == "__main__":
    heading()
    chosen = sys.argv[1:] or ["search", *VEHICLES]
    if "search" in chosen:
        search_times()
    for each in VEHICLES:
        if each in chosen:
            vehicle_costs(each)
