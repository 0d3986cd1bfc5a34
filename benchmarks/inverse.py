"""Inverse kinematics: condition numbers, duration of motions, and round trips.

``python benchmarks inverse`` prints the condition numbers of all choices of three platform
velocities, with the steering rate or the steering angle unknown, on flat ground and over a seeded
set of poses on hills; the time after which the paper's inverse input tilts a rear wheel by
0.35 rad, on four grounds; and the errors of the rates of direct runs, recovered from their motion.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from itertools import combinations
from typing import Any

import casadi as ca
import common  # noqa: F401 - finds the helpers of tests
import numpy as np

from slipfree import (
    Analytic,
    ModelError,
    Rolling,
    SolverError,
    SolverOptions,
    Trajectory,
    direct_kinematics,
    settle,
    simulate,
)
from slipfree.catalog import three_wheeler
from slipfree.control.path_following import path_inputs
from slipfree.models.given_rates import EULER, PLANAR, VELOCITY, conditions
from slipfree.models.inverse import inverse_kinematics, steering_note
from slipfree.solve.collocation import drive
from slipfree.solve.replay import replay, spline_inputs
from slipfree.solve.sampling import Samples, to_trajectory
from slipfree.solve.system import solve_initial_conditions, with_inputs

VEHICLE = three_wheeler(mass=0.0, wheel_mass=0.0)  # no forces: the motion alone
SEED, POSES = 20261121, 150
PAPER_MOTION = {"velocity_x": 0.01255, "velocity_y": 0.12865, "heading_rate": 0.0159}
TILT = 0.35  # [rad]
DETERMINED = 1e-3  # margin from which on rates must come back
WHEEL_RATES = ("right_rate", "left_rate", "steer_rate")
Height = Callable[[Any, Any], Any]


def hills(x: Any, y: Any) -> Any:
    """Return smooth hills. [m]."""
    return 0.15 * ca.sin(0.9 * x + 0.3) * ca.cos(0.7 * y) + 0.05 * ca.sin(1.7 * y + 0.2 * x)


def rough(x: Any, y: Any) -> Any:
    """Return the hills with ripples. [m]."""
    return hills(x, y) + 0.03 * ca.sin(3.1 * x + 2.3 * y + 0.7) + 0.02 * ca.cos(4.3 * x - 2.9 * y)


GROUNDS: dict[str, Height] = {
    "hills": hills,
    "hills / 3": lambda x, y: hills(x, y) / 3,
    "flat": lambda x, _: 0 * x,
    "mirrored hills": lambda x, y: -hills(x, y),
}


def moving(dae: Any, poses: list[dict[str, float]]) -> Trajectory:
    """Return one sample per pose at which the vehicle can stand, with equal rear wheel rates."""
    system, x, z = (
        with_inputs(dae, dae.inputs(right_rate=0.45, left_rate=0.45, steer_rate=0.0), 0),
        [],
        [],
    )
    for pose in poses:
        try:
            begin = settle(dae, **pose)
        except ModelError:
            continue  # a second touch
        x.append(dae.rows("x", begin, 0))
        z.append(
            solve_initial_conditions(system, 0.0, x[-1], dae.rows("z", begin, 0), system.u[:, 0])
        )
    n = len(x)
    u = np.repeat(system.u[:, :1], n, axis=1)
    samples = Samples(
        np.arange(float(n)), np.column_stack(x), np.column_stack(z), np.zeros((3, n)), u
    )
    return to_trajectory(system, samples, {})


def quantiles(values: Any) -> Any:
    """Return median, 90 % quantile and maximum, of values that may be infinite."""
    return np.quantile(values, [0.5, 0.9, 1.0], method="nearest")


def condition_table() -> None:
    """Print the condition numbers of all choices, on flat ground and on hills."""
    rng = np.random.default_rng(SEED)
    names = ("x", "y", "heading", "tilt_right", "tilt_left", "steer")
    poses = [
        dict(zip(names, rng.uniform(-1, 1, 6) * [3, 3, 3.1, 0.2, 0.2, 0.4], strict=True))
        for _ in range(POSES)
    ]
    found: dict[str, Any] = {}
    for ground, height, where in (("flat", GROUNDS["flat"], [{}]), ("hills", rough, poses)):
        direct = direct_kinematics(VEHICLE, Analytic(height), slip=Rolling())
        run = moving(direct, where)
        for solve_for in ("rates", "angles"):
            found[f"{ground}, {solve_for}"] = conditions(direct, run, solve_for)
    print(f"\ncondition numbers; on rough hills over {run.t.size} poses: median, 90 %, largest")
    print(f"{'':36}{'steering rate unknown':^39}{'steering angle unknown':^39}")
    print(f"{'given':36}" + 2 * f"{'flat':>9}{'median':>10}{'90 %':>10}{'largest':>10}")
    for given in found["flat, rates"]:
        cells = [
            number
            for solve_for in ("rates", "angles")
            for number in (
                found[f"flat, {solve_for}"][given][0],
                *np.quantile(
                    found[f"hills, {solve_for}"][given], [0.5, 0.9, 1.0], method="nearest"
                ),
            )
        ]
        row = "".join(
            f"{'singular' if np.isinf(cell) else f'{cell:.3g}':>{9 if k % 4 == 0 else 10}}"
            for k, cell in enumerate(cells)
        )
        print(f"{', '.join(given):36}{row}")


def until_the_tilt(height: Height, solve_for: Any) -> str:
    """Return the time at which the paper's inverse input reaches a tilt, or the stop reason."""
    vehicle = three_wheeler(tilt_stop=TILT, mass=0.0, wheel_mass=0.0)
    terrain = Analytic(height)
    dae = inverse_kinematics(vehicle, terrain, given=PLANAR, solve_for=solve_for)
    begin = settle(direct_kinematics(vehicle, terrain))
    note = ""
    try:
        run = simulate(dae, begin, dae.inputs(**PAPER_MOTION), np.linspace(0, 8, 161))
    except ModelError as error:
        return "no start: " + str(error).partition("(")[0]
    except SolverError as error:
        if error.trajectory is None:
            return f"no motion: {error}"
        run = error.trajectory
    if solve_for == "rates":
        note = "; " + steering_note(run).partition(":")[0] if steering_note(run) else ""
    if run.stop is None:
        return f"no tilt of {TILT} rad in {run.t[-1]:g} s{note}"
    tilted = run.stop.name.startswith("tilt")
    return f"{'' if tilted else 'ended by ' + run.stop.name + ' at '}{run.stop.t:.3f} s{note}"


def tilt_table() -> None:
    """Print the durations of motions with the paper's inverse input."""
    given = ", ".join(f"{name} {value}" for name, value in PAPER_MOTION.items())
    print(f"\n{given}: time at which a rear wheel tilts by {TILT} rad")
    for name, height in GROUNDS.items():
        for solve_for in ("rates", "angles"):
            print(f"{name:16}steering {solve_for:8}{until_the_tilt(height, solve_for)}")
    print(f"{'the paper':16}{'':17}not printed; runs to the end of its figures")


def direct_run(t: Any, tolerance: float, **start: float) -> tuple[Any, Trajectory, Trajectory]:
    """Return model, start and motion of a drive with smoothly changing rates on the hills."""
    dae = direct_kinematics(VEHICLE, Analytic(hills), slip=Rolling())
    right = 0.45 + 0.05 * ca.sin(0.5 * dae.t)
    left = 0.45 - 0.05 * ca.sin(0.5 * dae.t + 0.3)
    rates = dae.inputs(right_rate=right, left_rate=left, steer_rate=0.05 * ca.cos(0.6 * dae.t))
    begin = settle(dae, **start)
    return dae, begin, simulate(dae, begin, rates, t, options=SolverOptions(tolerance=tolerance))


def pointwise() -> None:
    """Print the errors of rates recovered from recorded states, by choice of Euler rates."""
    _, _, run = direct_run(np.linspace(0, 6, 7), 1e-10, x=0.3, heading=0.2)
    worst, returned, left_out = 0.0, 0, 0
    free: Any = {"solve_for": "rates", "least_margin": 0.0}
    for given in combinations((*VELOCITY, *EULER), 3):
        dae = inverse_kinematics(VEHICLE, Analytic(hills), given=given, **free)
        for k in range(run.t.size):
            system = with_inputs(dae, dae.inputs(**{name: run[name][k] for name in given}), 0)
            x, z = dae.rows("x", run, k), dae.rows("z", run, k)
            if dae.checks[-1].margin(x[:, None], z[:, None])[0] < DETERMINED:
                left_out += 1
                continue
            back = solve_initial_conditions(
                system, 0.0, x, np.where(np.arange(z.size) < 9, z, 0.0), system.u[:, 0]
            )
            worst, returned = max(worst, float(np.abs(back - z).max())), returned + 1
    print(
        f"{'pointwise':28}{worst:.1e} m/s, rad/s: {returned} of all choices at states whose "
        f"margin exceeds {DETERMINED:g}, {left_out} below it left out"
    )


def in_time() -> None:
    """Print the errors of rates recovered by integration, and along a path across the axis."""
    for words, start, sought in (
        ("in time, steering stable", {"x": 0.3, "heading": 0.2}, False),
        ("along a path that crosses", {"x": 1.0, "y": 0.5}, True),
    ):
        t = np.linspace(0, 8, 161)
        direct, begin, run = direct_run(t, 1e-13 if sought else 1e-11, **start)
        least = {"least_margin": 0.0} if sought else {}
        dae = inverse_kinematics(VEHICLE, Analytic(hills), given=PLANAR, solve_for="rates", **least)
        inputs = path_inputs(dae, begin, t, run["x"], run["y"], run["heading"])
        repeated = ""
        if sought:
            found = drive(dae, begin, inputs, t, free_states=["steer"])
            back = found.run
            _, gaps = replay(direct, back, spline_inputs(direct, found.t, found.unknowns))
            repeated = f", replay within {max(gaps.values()):.1e} m, rad"
        else:
            back = simulate(dae, begin, inputs, t, options=SolverOptions(tolerance=1e-10))
        error = max(float(np.abs(back[name] - run[name]).max()) for name in WHEEL_RATES)
        growth = back["steering_growth"]
        print(
            f"{words:28}{error:.1e} rad/s over {t[-1]:g} s; steering growth "
            f"{growth.min():.3g} to {growth.max():.3g} 1/s{repeated}"
        )


def main() -> None:
    """Print everything."""
    warnings.simplefilter("error")
    clock = time.perf_counter()
    condition_table()
    tilt_table()
    print("\nlargest error of the rates that come back from a direct run")
    pointwise()
    in_time()
    print(f"\n{time.perf_counter() - clock:.0f} s")
