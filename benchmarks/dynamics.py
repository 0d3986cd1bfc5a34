"""Motions with inertia: cost.

``python benchmarks dynamics [PART ...]``:

three_wheeler, car, rocky7
           a vehicle at four speeds, on a formula and on its bicubic map: steps, evaluations of the
           equations and of their Jacobian, and CPU time of the integration per metre, interpreted
           and compiled. The tolerance is the loosest of 1e-7 to 1e-4 for which, as for all tighter
           ones, the error against 1e-10 is below 0.1 mm.

The time of the integration is that of `simulate` with two samples, the least of a few runs, minus
that of a run with a thousandth of the duration.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from common import run_parts

from slipfree import Analytic, Bicubic, Grid, SolverOptions, catalog, dynamics, settle, simulate
from slipfree.core.trajectory import Trajectory, path_length
from slipfree.laws.compliant import Compliant
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

SPEEDS = (0.1, 0.3, 1.0, 3.0)  # [m/s]
TOLERANCES = (1e-7, 1e-6, 1e-5, 3e-5, 1e-4)
EXACT, ALLOWED = 1e-10, 1e-4  # tolerance of the reference [1]; error [m]
MU, RISE = 0.8, 0.3  # friction [1]; time in which the rates rise [s]
REPEATS = 10  # runs of which the least time counts
SPACING, HALF = 0.1, 9.0  # of maps, and half their side [m]
ORIGIN, SOFT = {"x": 0.0, "y": 0.0, "heading": 0.0}, Compliant()  # start; default law of contacts


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


def nodes(height: Height, spacing: float = SPACING) -> Grid:
    """Return the heights of a formula at the nodes of a map."""
    axis = np.arange(-HALF, HALF + spacing / 2, spacing)
    return Grid(axis, axis, height(axis[:, None], axis[None, :], np))


def grounds(height: Height) -> dict[str, Terrain]:
    """Return a formula and its map."""
    return {
        "formula": Analytic(lambda x, y: height(x, y, ca), mu=MU),
        "map": Bicubic(nodes(height), mu=MU),
    }


class Cost(NamedTuple):
    """Counts and CPU time [ms] of an integration per metre, and its error [m]."""

    steps: float
    evaluations: float
    jacobians: float
    cpu: float
    error: float
    tolerance: float


class Drive:
    """Vehicle that accelerates to a speed from rest, over 3 m, for at least 1.5 s."""

    def __init__(
        self, vehicle: Vehicle, ground: Terrain, speed: float, law: Compliant = SOFT, **place: float
    ) -> None:
        self.model = dynamics(vehicle, ground, law=law)
        self.start = settle(self.model, **(ORIGIN | place))
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
        if error > ALLOWED:
            break
        counts = [run.statistics[name] / length for name in ("steps", "residuals", "set_ups")]
        cost = Cost(*counts, 0.0, error, tolerance)
    return cost._replace(cpu=1e3 * drive.cpu(cost.tolerance) / length), length


def vehicle_costs(name: str) -> None:
    """Print the costs of a vehicle."""
    vehicle, height = VEHICLES[name]
    counts = "steps + evaluations + Jacobians per metre"
    print(f"{name}: speed; formula, map: tolerance, error, {counts}, ms/m, compiled ms/m")
    for speed in SPEEDS:
        words = []
        for kind, ground in grounds(height).items():
            drive = Drive(vehicle, ground, speed)
            cost, length = loosest(drive)
            compiled = 1e3 * drive.cpu(cost.tolerance, compiled=True) / length
            words.append(
                f"{kind} {cost.tolerance:.0e} {1e3 * cost.error:.3f} mm {cost.steps:3.0f} + "
                f"{cost.evaluations:3.0f} + {cost.jacobians:2.0f} {cost.cpu:5.1f} {compiled:5.1f}"
            )
        print(f"  {speed:3g} m/s: " + "; ".join(words), flush=True)


def main() -> None:
    """Print the parts."""
    run_parts({name: partial(vehicle_costs, name) for name in VEHICLES})
