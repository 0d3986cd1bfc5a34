"""Motions with inertia: cost, and agreement with slow models.

``python benchmarks dynamics [PART ...]``:

search     CPU time of a search for the ground point nearest to a wheel: on a formula, on a map with
           the compiled search, and on a map without it
three_wheeler, car, rocky7
           a vehicle at four speeds, on a formula and on its bicubic map: steps, evaluations of the
           equations and of their Jacobian, and CPU time of the integration per metre, interpreted
           and compiled. The tolerance is the loosest of 1e-7 to 1e-4 for which, as for all tighter
           ones, the error against 1e-10 is below 0.1 mm.
turns      four vehicles that turn over about 1 m of hills from rest: the distance between the ends
           of dynamics and of quasi-statics by speed, with a creep of 1 % of the speed in both laws,
           so that quasi-statics has the same path at every speed; its change divided by that of the
           squared speed; the distance between kinematics with least slip and quasi-statics. Ends of
           dynamics are taken 1 ms later, the time constant of its rates.

The time of the integration is that of `simulate` with two samples, the least of a few runs, minus
that of a run with a thousandth of the duration.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from common import run_parts

from slipfree import (
    Analytic,
    Bicubic,
    Grid,
    SolverOptions,
    catalog,
    direct_kinematics,
    dynamics,
    quasi_statics,
    settle,
    simulate,
)
from slipfree.contact import touch
from slipfree.core.dae import Dae
from slipfree.core.trajectory import Trajectory, path_length
from slipfree.laws.compliant import Compliant
from slipfree.laws.coulomb import Coulomb
from slipfree.models.dynamics import LAG
from slipfree.terrain.base import Terrain
from slipfree.vehicle.sections import Torus
from slipfree.vehicle.tree import Vehicle

SPEEDS = (0.1, 0.3, 1.0, 3.0)  # [m/s]
TOLERANCES = (1e-7, 1e-6, 1e-5, 3e-5, 1e-4)
EXACT, ALLOWED = 1e-10, 1e-4  # tolerance of the reference [1]; error [m]
MU, RISE = 0.8, 0.3  # friction [1]; time in which the rates rise [s]
REPEATS = 10  # runs of which the least time counts
SPACING, HALF = 0.1, 9.0  # of maps, and half their side [m]
QUESTIONS = 2000
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


SLOW_SPEEDS = (0.8, 0.4, 0.2, 0.1, 0.05)  # [m/s]
FINE = SolverOptions(1e-8)
SLOW_HILLS = Analytic(lambda x, y: hills(x, y, ca), mu=MU)
TURNING = {
    "skid_steer": catalog.skid_steer(),
    "ackermann": catalog.ackermann(),
    "rocky7": catalog.rocky7(),
    "open_source_rover": catalog.open_source_rover(),
}


def turns() -> None:
    """Print the distance between the ends of turns in three models."""
    print("dynamics from quasi-statics, ends apart [m], by speed [m/s]; kinematics, the same")
    print(
        f"{'vehicle':18}"
        + "".join(f"{speed:>10g}" for speed in SLOW_SPEEDS)
        + f"{'kinematics':>12}"
    )
    for name, vehicle in TURNING.items():
        gaps = []
        for speed in SLOW_SPEEDS:
            still = _turn(
                quasi_statics(vehicle, SLOW_HILLS, law=Coulomb(0.01 * speed)), vehicle, speed
            )
            law = Compliant(creep=0.01 * speed)
            moved = _turn(dynamics(vehicle, SLOW_HILLS, law=law), vehicle, speed, LAG)
            gaps.append(moved - still)
        least = _turn(direct_kinematics(vehicle, SLOW_HILLS), vehicle, SLOW_SPEEDS[-1]) - still
        ends = "".join(f"{np.linalg.norm(gap):10.1e}" for gap in gaps)
        print(f"{name:18}{ends}{np.linalg.norm(least):12.1e}")
        steps = np.linalg.norm(np.diff(gaps, axis=0), axis=1) / -np.diff(np.square(SLOW_SPEEDS))
        rates = "".join(f"{rate:10.1e}" for rate in steps)
        print(f"{'  / v^2 [s^2/m]':18}{'':10}{rates}", flush=True)


def _turn(model: Dae, vehicle: Vehicle, speed: float, delay: float = 0.0) -> np.ndarray:
    """Return the end of a turn from rest, x and y, after a delay [m]."""
    ramp = ca.tanh(model.t * speed / 0.3) ** 2
    given = {label.full: 0.0 for part in model.labels.u for label in part}
    for wheel in vehicle.wheels:
        side = 1.2 if wheel.at[0] > 0 else 0.8
        if wheel.driven:
            given[f"{wheel.name}_rate"] = side * speed / wheel.radius * ramp
    t = np.linspace(0, 1.3 / speed + delay, 3)
    run = simulate(model, settle(model), model.inputs(**given), t, options=FINE)
    if run.stop is not None:
        raise SystemExit(f"{vehicle.name}: {run.stop.words}")
    return np.array([run["x"][-1], run["y"][-1]])


def main() -> None:
    """Print the parts."""
    vehicles = {name: partial(vehicle_costs, name) for name in VEHICLES}
    run_parts({"search": search_times, **vehicles, "turns": turns})
