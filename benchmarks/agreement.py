"""Compare kinematics, quasi-statics and dynamics of vehicles on the same ground, by speed.

``python benchmarks/agreement.py`` prints

1. for four vehicles that turn over about 1 m of hills from rest: the distance between the ends of
   dynamics and of quasi-statics, by speed; the creep of both laws is 1 % of the speed, so that
   quasi-statics has the same path at every speed. The next line contains the change from column to
   column divided by the change of the squared speed, which is constant for a second-order
   difference. The last line contains the distance between the ends of kinematics with least slip
   and of quasi-statics. Ends of dynamics are taken 1 ms later, the time constant of its rates;
2. for a rigid four-wheeler, straight on over rough ground at 0.1 m/s: the distance of dynamics from
   kinematics with wheels pressed into the ground, and the wheels in the air in both.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
from reference import heading

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
from slipfree.dae import Dae
from slipfree.laws.compliant import Compliant
from slipfree.laws.coulomb import Coulomb
from slipfree.models.dynamics import LAG
from slipfree.terrain.synthetic import power_law
from slipfree.trajectory import Trajectory
from slipfree.vehicle.tree import Vehicle

SPEEDS = (0.8, 0.4, 0.2, 0.1, 0.05)  # [m/s]
OPTIONS = SolverOptions(1e-8)
HILLS = Analytic(
    lambda x, y: (
        0.12 * ca.sin(2 * np.pi * x / 7) * ca.cos(2 * np.pi * y / 9)
        + 0.05 * ca.sin(2 * np.pi * (x + 0.6 * y) / 4.3)
    ),
    mu=0.8,
)
VEHICLES = {
    "skid_steer": catalog.skid_steer(),
    "ackermann": catalog.ackermann(),
    "rocky7": catalog.rocky7(),
    "open_source_rover": catalog.open_source_rover(),
}
ROUGH = (0.01, 0.02)  # rms of the heights below a rigid four-wheeler [m]


def main() -> None:
    """Print both tables."""
    heading()
    print("\ndynamics from quasi-statics, ends apart [m], by speed [m/s]; kinematics, the same")
    print(f"{'vehicle':18}" + "".join(f"{speed:>10g}" for speed in SPEEDS) + f"{'kinematics':>12}")
    for name, vehicle in VEHICLES.items():
        gaps = []
        for speed in SPEEDS:
            still = _turn(quasi_statics(vehicle, HILLS, law=Coulomb(0.01 * speed)), vehicle, speed)
            law = Compliant(creep=0.01 * speed)
            moved = _turn(dynamics(vehicle, HILLS, law=law), vehicle, speed, LAG)
            gaps.append(moved - still)
        least = _turn(direct_kinematics(vehicle, HILLS), vehicle, SPEEDS[-1]) - still
        ends = "".join(f"{np.linalg.norm(gap):10.1e}" for gap in gaps)
        print(f"{name:18}{ends}{np.linalg.norm(least):12.1e}")
        steps = np.linalg.norm(np.diff(gaps, axis=0), axis=1) / -np.diff(np.square(SPEEDS))
        rates = "".join(f"{rate:10.1e}" for rate in steps)
        print(f"{'  / v^2 [s^2/m]':18}{'':10}{rates}", flush=True)
    print("\nrigid four-wheeler, straight on, 2.3 m at 0.1 m/s")
    for rms in ROUGH:
        _rock(rms)


def _turn(model: Dae, vehicle: Vehicle, speed: float, delay: float = 0.0) -> np.ndarray:
    """Return the end of a turn from rest, x and y, after a delay [m]."""
    ramp = ca.tanh(model.t * speed / 0.3) ** 2
    given = {label.full: 0.0 for part in model.labels.u for label in part}
    for wheel in vehicle.wheels:
        side = 1.2 if wheel.at[0] > 0 else 0.8
        if wheel.driven:
            given[f"{wheel.name}_rate"] = side * speed / wheel.radius * ramp
    t = np.linspace(0, 1.3 / speed + delay, 3)
    run = simulate(model, settle(model), model.inputs(**given), t, options=OPTIONS)
    if run.stop is not None:
        raise SystemExit(f"{vehicle.name}: {run.stop.words}")
    return np.array([run["x"][-1], run["y"][-1]])


def _rock(rms: float) -> None:
    """Print the agreement of dynamics and kinematics of a rigid four-wheeler on rough ground."""
    vehicle = catalog.rigid_skid_steer()
    axis = np.arange(-3, 5.05, 0.1)
    flat = Grid(axis, axis, np.zeros((axis.size, axis.size)))
    rough = power_law(flat, rms=rms, hurst=0.8, longest=3.0, shortest=0.6, seed=7)
    ground = Bicubic(rough, mu=0.8)
    wheels = tuple(replace(wheel, static_depth=wheel.radius / 250) for wheel in vehicle.wheels)
    vehicle = replace(vehicle, wheels=wheels)
    moving, still = (
        _straight(model, vehicle)
        for model in (dynamics(vehicle, ground), direct_kinematics(vehicle, ground))
    )
    apart = np.hypot(*(moving[key] - still[key] for key in "xy"))
    high = np.abs(moving["z"] - still["z"])
    air, raised = moving["depth"] <= 0, still["depth"] <= 0
    agree = (air == raised).all(1).mean()
    names = [
        ", ".join(w.name for k, w in enumerate(vehicle.wheels) if each[:, k].any())
        for each in (air, raised)
    ]
    print(
        f"  heights of {1e3 * rms:g} mm rms: end {1e3 * apart[-1]:.2f} mm apart, at most "
        f"{1e3 * apart.max():.2f} mm, heights {1e3 * high.max():.2f} mm; in the air with inertia: "
        f"{names[0] or 'none'}; without: {names[1] or 'none'}; the same wheels at "
        f"{100 * agree:.0f} % of the samples"
    )


def _straight(model: Dae, vehicle: Vehicle) -> Trajectory:
    """Return the motion straight on over 2.3 m at 0.1 m/s."""
    rates = {f"{wheel.name}_rate": 0.1 / wheel.radius for wheel in vehicle.wheels}
    t = np.linspace(0, 23, 231)
    return simulate(model, settle(model), model.inputs(**rates), t, options=OPTIONS)


if __name__ == "__main__":
    main()
