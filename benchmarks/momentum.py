"""Plan over a bump on a slope: refused quasi-statically, planned with inertia, simulated.

``python benchmarks/momentum.py`` plans with `rigid_dynamics` and simulates the torques of each
plan with `dynamics` on compliant contacts. A car with four torque drives drives over a ridge; a
skid-steered cart drives over a bump beside its path, first with wheels that roll within the limits
of friction, then with wheels that slide, by searches with decreasing creep speeds.
"""

from __future__ import annotations

import time
from dataclasses import replace

import casadi as ca
import numpy as np
from reference import heading

from slipfree import (
    Analytic,
    Coulomb,
    LinearCreep,
    SolverOptions,
    Torque,
    Trajectory,
    Vehicle,
    catalog,
    direct_kinematics,
    plan,
    quasi_statics,
    rigid_dynamics,
    settle,
    simulate,
)
from slipfree.laws.protocols import GroundLaw
from slipfree.models.dynamic_guess import dynamic_guess
from slipfree.plan.plan import Plan

FRICTION, SLOPE = 0.8, np.tan(np.radians(20))
SPEED = 1.15  # of the kinematic motion of the initial guess [m/s]
ROUGH = SolverOptions(tolerance=1e-5)


def slope(y: ca.SX) -> ca.SX:
    """Return heights of a slope of 20 degrees that begins at y = 1.2 m."""
    return SLOPE * 0.15 * ca.log(1 + ca.exp((y - 1.2) / 0.15))


RIDGE = Analytic(
    lambda x, y: 0 * x + slope(y) + 0.13 * ca.exp(-(((y - 3.2) / 0.35) ** 2)), mu=FRICTION
)
BUMP = Analytic(
    lambda x, y: slope(y) + 0.12 * ca.exp(-(((y - 3.0) / 0.35) ** 2) - ((x - 0.2) / 0.8) ** 2),
    mu=FRICTION,
)


def with_torques(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle with a torque as the input of every wheel."""
    wheels = tuple(replace(wheel, drive=Torque()) for wheel in vehicle.wheels)
    return replace(vehicle, wheels=wheels)


CAR = with_torques(catalog.skid_steer(wheelbase=0.7, mass=40.0, center_of_mass=(0.0, 0.0, 0.07)))
CART = with_torques(catalog.skid_steer())


def slow(vehicle: Vehicle, ground: Analytic) -> Trajectory:
    """Return the quasi-static motion straight on at equal wheel rates."""
    model = quasi_statics(vehicle, ground)
    rates = {label.full: SPEED / 0.15 for label in model.labels.u.wheels}
    times = np.linspace(0, 4, 201)
    return simulate(model, settle(model), model.inputs(**rates), times, options=ROUGH)


def planned(
    vehicle: Vehicle,
    ground: Analytic,
    law: GroundLaw,
    bounds: tuple[float, float, int],
    before: Plan | None = None,
    *,
    last: bool = True,
) -> Plan:
    """Return a plan; ``bounds`` are the torque of a wheel [N m], the goal's y [m] and intervals.

    Only the last of several plans has to agree with its simulation.
    """
    torque, goal, intervals = bounds
    model = rigid_dynamics(vehicle, ground, law=law)
    start = settle(model)
    still = direct_kinematics(vehicle, ground)
    rates = {label.full: SPEED / 0.15 for label in still.labels.u.wheels}
    times = np.linspace(0, 4, 41)
    run = simulate(still, settle(still), still.inputs(**rates), times, options=ROUGH)
    run = run.part(slice(0, int(np.abs(run["y"] - goal).argmin()) + 1))
    return plan(
        model,
        start,
        dynamic_guess(model, vehicle, start, run),
        goal={"y": (goal, goal + 1)},
        costs={"time": 1.0, "effort": 1e-3},
        duration=(0.5, 20.0),
        smooth=2e-5,
        continuous=False,
        inputs={label.full: (-torque, torque) for label in model.labels.u.wheels},
        intervals=intervals,
        accuracy=0.01 if last else np.inf,
        resume=None if before is None else before.saved,
    )


def report(name: str, found: Plan, seconds: float) -> None:
    """Print a row about a plan and its simulation."""
    iterations = " + ".join(str(stage.iterations) for stage in found.stages)
    search = sum(stage.seconds["total"] for stage in found.stages)
    away = max(found.difference[axis] for axis in "xyz")
    used = np.hypot(found.run["friction_used_along"], found.run["friction_used_across"])
    least = [run["force_normal"].min() for run in (found.run, found.replay)]
    print(
        f"{name}: {found.stages[-1].status}, {iterations} iterations, {search:.1f} s of "
        f"search, {seconds:.1f} s CPU in all; {found.motion.duration:.4f} s, least N {least[0]:.1f}"
        f" N, simulated {least[1]:.1f} N, friction used {used.max():.3f}; simulation "
        f"{1e3 * away:.2f} mm apart, end y {found.replay['y'][-1]:.4f} m",
        flush=True,
    )


def main() -> None:
    """Print all rows."""
    heading()
    run = slow(CAR, RIDGE)
    needed = run["drive_torque"].sum(axis=1)
    k = int(needed.argmax())
    print(f"car, driven slowly: {needed[k]:.1f} N m at y = {run['y'][k]:.2f} m; drives give 26 N m")
    clock = time.process_time()
    found = planned(CAR, RIDGE, LinearCreep(), (6.5, 4.6, 50))
    report("car, rolling", found, time.process_time() - clock)
    fast = np.hypot(found.replay["velocity_y"], found.replay["velocity_z"])
    print(
        f"  {np.interp(2.8, found.replay['y'], fast):.2f} m/s at the foot of the ridge, y = 2.8 m"
    )
    clock = time.process_time()
    report(
        "cart, rolling",
        planned(CART, BUMP, LinearCreep(), (5.3, 4.4, 40)),
        time.process_time() - clock,
    )
    before = None
    for creep in (0.3, 0.1, 0.03):
        clock = time.process_time()
        before = planned(CART, BUMP, Coulomb(creep), (5.3, 4.4, 40), before, last=creep == 0.03)
        report(f"cart, sliding, creep {creep} m/s", before, time.process_time() - clock)


if __name__ == "__main__":
    main()
