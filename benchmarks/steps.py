"""Least friction with which vehicles climb a step, in three dimensions, with inertia.

``python benchmarks/steps.py [VEHICLE ...]`` prints, for vehicles, heights and headings, the least
coefficient of friction with which all wheels get onto the step, to 0.02, by bisection of
simulations: all wheels turn at the rate of 0.2 m/s, and the vehicle starts 50 mm before the step.
The friction is that of floor and step. At a dash no coefficient up to 1.5 suffices. A climb is not
monotonic in the coefficient, so that the bound is one of the tried values, not a proof.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import casadi as ca
import numpy as np
from reference import heading as print_heading

from slipfree import Analytic, ModelError, SolverError, SolverOptions, catalog, dynamics, settle
from slipfree.solve.simulate import simulate
from slipfree.terrain.solids import Solids, placed, step
from slipfree.vehicle.tree import Vehicle

SPEED, TOLERANCE = 0.2, 1e-5  # [m/s]
HIGHEST, RESOLUTION = 1.5, 0.02  # of the coefficient of friction [1]
CLEARANCE = 0.05  # of the first wheel from the step at the start [m]
WAY = 3.5  # way of the wheels' rims [lengths of the vehicle]
HEADINGS = (0.0, 20.0)  # [degrees]
VEHICLES: dict[str, tuple[Vehicle, tuple[float, ...]]] = {
    "rocky7": (catalog.rocky7(), (0.05, 0.065, 0.09)),
    "skid_steer": (catalog.rigid_skid_steer(), (0.05, 0.1, 0.14)),
    "seven_wheels": (catalog.seven_wheels(wheel_mass=0.4), (0.03, 0.06, 0.09)),
}


def reach(vehicle: Vehicle, heading: float) -> tuple[float, float]:
    """Return how far the wheels reach ahead of the platform's centre, and behind it [m]."""
    model = dynamics(vehicle, Analytic(lambda x, y: 0 * (x + y), mu=1.0))
    start = settle(model, x=0.0, y=0.0, heading=heading)
    y, radius = start["center_y"][-1], max(wheel.radius for wheel in vehicle.wheels)
    return float(y.max() + radius), float(radius - y.min())


def climbs(vehicle: Vehicle, height: float, heading: float, mu: float) -> bool:
    """Return whether all wheels get onto a step."""
    ahead, behind = reach(vehicle, heading)
    floor = Analytic(lambda x, y: 0 * (x + y), mu=mu)
    model = dynamics(vehicle, Solids(floor, placed(step(height), y=ahead + CLEARANCE)))
    inputs: dict[str, Any] = {label.full: 0.0 for part in model.labels.u for label in part}
    for wheel in vehicle.wheels:
        if wheel.axle == "x":
            inputs[f"{wheel.name}_rate"] = SPEED / wheel.radius * ca.tanh(model.t / 0.3)
    t = np.linspace(0, WAY * (ahead + behind) / SPEED / np.cos(heading), 41)
    try:
        start = settle(model, x=0.0, y=0.0, heading=heading)
        options = SolverOptions(tolerance=TOLERANCE)
        run = simulate(model, start, model.inputs(**inputs), t, options=options)
    except (SolverError, ModelError) as error:
        print(f"  ({height:g} m, {mu:g}: {error})", file=sys.stderr)
        return False
    radii = np.array([wheel.radius for wheel in vehicle.wheels])
    return bool((run["center_z"][-1] > height + radii / 2).all())


def least(vehicle: Vehicle, height: float, heading: float) -> float | None:
    """Return the least coefficient of friction that suffices; None if none does."""
    low, high = 0.0, HIGHEST
    if not climbs(vehicle, height, heading, high):
        return None
    while high - low > RESOLUTION:
        middle = (low + high) / 2
        if climbs(vehicle, height, heading, middle):
            high = middle
        else:
            low = middle
    return high


if __name__ == "__main__":
    print_heading()
    for name in sys.argv[1:] or VEHICLES:
        vehicle, heights = VEHICLES[name]
        begin = time.perf_counter()
        for height in heights:
            found = [least(vehicle, height, np.deg2rad(each)) for each in HEADINGS]
            words = ["  - " if each is None else f"{each:.2f}" for each in found]
            pairs = zip(HEADINGS, words, strict=True)
            print(
                f"{name:13} {1e3 * height:4.0f} mm: "
                + ", ".join(f"{value} at {degrees:g} degrees" for degrees, value in pairs),
                flush=True,
            )
        print(f"  {time.perf_counter() - begin:.0f} s")
