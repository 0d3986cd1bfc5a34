"""Rocky 7 on the rover-scale grid of wmrde: accuracy, time, and a plan.

``python benchmarks rovers [PART ...]``:

drive  10 s and 5 m: error of the end and CPU over the tolerance, against the end at 1e-10,
       interpreted and compiled
plan   2.3 m in 8 s: iterations, slip, and its simulation

CPU time is that of `simulate`, the least of a few runs. Part of it prepares model and samples,
independent of the duration; the time of the integration is the difference from a run a tenth as
long, made in alternation.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from itertools import product

import casadi as ca
import numpy as np
from common import run_parts

from helpers.cases import LIGHT, rocky_case, rocky_run, rover_ground
from slipfree import Bicubic, Mesh, SolverOptions, direct_kinematics, settle, simulate
from slipfree.catalog import rocky7
from slipfree.core.trajectory import Trajectory
from slipfree.plan.plan import plan
from slipfree.plan.stage import Cost

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-8)
TURNS = 8
TOLD = 3e-3  # difference of CPU below which it is noise [s]
GOAL, DURATION, INTERVALS = {"x": 3.4, "y": 0.6}, 8.0, 40
WEIGHTS = {"slip": 100.0, "effort": 0.01}


def quickest(*tasks: Callable[[], Trajectory]) -> list[Trajectory]:
    """Return the run with the least CPU time of each task, of several alternating rounds."""
    runs = [[task() for task in tasks] for _ in range(TURNS)]
    return [
        min(each, key=lambda run: run.statistics["cpu_seconds"]) for each in zip(*runs, strict=True)
    ]


def cost(run: Trajectory, short: Trajectory) -> str:
    """Return the CPU time of a run, and its excess over a run a tenth as long."""
    cpu = run.statistics["cpu_seconds"]
    way = (cpu - short.statistics["cpu_seconds"]) / 0.9
    told = (
        f"{1e3 * way:.1f} ms, {run.t[-1] / way:.0f} times real time"
        if way > TOLD
        else f"below {1e3 * TOLD:g} ms"
    )
    return f"{run.statistics['steps']:.0f} steps, {1e3 * cpu:.0f} ms; the way {told}"


def gap(run: Trajectory, exact: Trajectory) -> float:
    """Return the distance of two ends. [m]."""
    return float(np.linalg.norm([run[name][-1] - exact[name][-1] for name in "xyz"]))


def rocky() -> None:
    """Print errors and times of Rocky 7 over the tolerance."""
    for steer in (0.0, 0.1):
        exact = rocky_run(rover_ground(), 0.0, steer, tolerance=1e-10)
        end = ", ".join(f"{exact[name][-1]:.6f}" for name in "xyz")
        print(f"  discs, steering {steer:g} rad: ends at {end} m")
        dae, start, inputs = rocky_case(rover_ground(), 0.0, steer)
        for tolerance, compiled in product(TOLERANCES, (False, True)):
            options = SolverOptions(tolerance=tolerance, compiled=compiled)
            drive = partial(simulate, dae, start, inputs, options=options)
            run, short = quickest(
                *(partial(drive, np.linspace(0, each, 101)) for each in (10.0, 1.0))
            )
            words = "compiled" if compiled else f"{tolerance:.0e}"
            print(f"    {words:8}: error {gap(run, exact):.1e} m, {cost(run, short)}")


def planned(continuous: bool) -> None:
    """Print a plan of least slip for Rocky 7 with its corner wheels steered."""
    vehicle = rocky7(steered="corners", **LIGHT)
    dae = direct_kinematics(vehicle, Bicubic(rover_ground()))
    start = settle(dae, x=1.1, y=0.0, heading=-np.pi / 2)
    wheels = [f"{wheel.name}_rate" for wheel in vehicle.wheels]
    steering = [c.name for c in vehicle.of("commanded")]
    given = dict.fromkeys(wheels, 2.3 / DURATION / 0.065)
    given |= {f"{name}_rate": 0.0 for name in steering}
    guess = simulate(
        dae,
        start,
        dae.inputs(**given),
        np.linspace(0, DURATION, 41),
        options=SolverOptions(tolerance=1e-6),
    )
    slip = sum(ca.sumsqr(ca.vertcat(*part)) for part in (dae.y.slip_along, dae.y.slip_across))
    effort = ca.sumsqr(ca.vertcat(*dae.u.joints)) + 0.02 * ca.sumsqr(ca.vertcat(*dae.u.wheels))
    costs = [
        Cost("slip", slip, "m2 s-1", "squared slip", WEIGHTS["slip"]),
        Cost("effort", effort, "rad2 s-1", "weighed effort", WEIGHTS["effort"]),
    ]
    begin = time.process_time()
    found = plan(
        dae,
        start,
        guess,
        goal=GOAL,
        costs=costs,
        duration=DURATION,
        smooth=1e-3,
        mesh=Mesh(INTERVALS, continuous=continuous, accuracy=1e-2),
        limits=dict.fromkeys(steering, (-0.8, 0.8)),
        inputs=dict.fromkeys(wheels, (-10.0, 10.0))
        | {f"{name}_rate": (-0.5, 0.5) for name in steering},
    )
    cpu = time.process_time() - begin
    below = [
        motion["center_z"]
        - Bicubic(rover_ground()).elevation(motion["center_x"], motion["center_y"])
        for motion in (found.run, found.replay)
    ]
    rms = np.sqrt(found.costs["slip"] / DURATION / len(vehicle.wheels))
    counts = " + ".join(f"{stage.iterations}" for stage in found.stages)
    seconds = sum(stage.seconds["total"] for stage in found.stages)
    print(
        f"  inputs {'continuous' if continuous else 'that jump'}: {counts} iterations in "
        f"{seconds:.1f} s, {cpu:.1f} s CPU in all; slip {rms:.2e} m/s, effort "
        f"{found.costs['effort']:.2f}; simulation within "
        f"{max(found.difference[name] for name in ('x', 'y')):.1e} m; "
        f"{sum(int((part < 0).sum()) for part in below)} wheels below ground"
    )


def plans() -> None:
    """Print plans with inputs that jump and with continuous inputs."""
    for continuous in (False, True):
        planned(continuous)


def main() -> None:
    """Print the parts."""
    run_parts({"drive": rocky, "plan": plans})
