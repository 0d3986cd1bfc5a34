"""Measure error against CPU time per metre, for both formulations and several integrators.

``python benchmarks/work_precision.py --plot work_precision.png``

Two drives of the paper's three-wheeler: the reference motion (its rates, smooth ground), and a
straight drive over a rough map with cells of 0.1 m. Three formulations: closure with least slip,
closure with rolling, and Montana's contact equations. Three integrators: IDAS on the DAE as in
``simulate``; IDAS with the opposite choice of algebraic unknowns in its error test; and CVODES on
the differential equations with the algebraic blocks eliminated - rates by a linear solve, positions
by Newton's method. ``simulate`` uses the first; the others show the possible gain. CPU time is that
of the integrator's call alone, the least of a few; the error is the largest of any sample of pose
and tilts, in m and rad, against closure at 1e-12.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import matplotlib as mpl
import numpy as np
from direct import wrapped
from reference import heading

from slipfree import (
    Bicubic,
    Grid,
    Rolling,
    SolverOptions,
    direct_kinematics,
    settle,
    simulate,
    straight,
)
from slipfree.catalog import three_wheeler
from slipfree.models.montana import montana_kinematics
from slipfree.records import leaves
from slipfree.solve.initial_conditions import solve_initial_conditions
from slipfree.solve.system import System, _solve_symbolically, with_inputs
from slipfree.terrain.synthetic import blank, power_law
from slipfree.trajectory import Trajectory, path_length

DATA = Path(__file__).parent.parent / "tests" / "data"
TOLERANCES = 10.0 ** -np.arange(4, 11)
EXACT = 1e-12
REPEATS = 3
COMPARED = ("x", "y", "heading", "tilt_right", "tilt_left", "steer")
EQUAL = 1e-6  # error at which lines are compared [m, rad]
VEHICLE = three_wheeler(mass=0.0, wheel_mass=0.0)  # no forces: the motion alone


class Drive(NamedTuple):
    """Ground, start, times, and a function that returns the inputs of a model."""

    ground: Bicubic
    start: dict[str, float]
    t: np.ndarray
    inputs: Callable[[Any, Any, Trajectory], Any]


def drives() -> dict[str, Drive]:
    """Return the drives by name."""
    nodes = np.load(DATA / "case1.npz")
    smooth = Bicubic(Grid(nodes["x"], nodes["y"], nodes["z"]))
    rough = power_law(
        blank((-4, 4), (-2, 10), 0.1), rms=0.04, hurst=0.8, longest=6.0, shortest=1.2, seed=3
    )
    return {
        "case1": Drive(
            smooth,
            {},
            np.linspace(0, 6, 61),
            lambda dae, *_: dae.inputs(right_rate=0.5, left_rate=0.4, steer_rate=0.0),
        ),
        "rough 0.1 m": Drive(
            Bicubic(rough),
            {"steer": 0.05},
            np.linspace(0, 12, 121),
            lambda dae, vehicle, start: straight(dae, vehicle, start, speed=0.5),
        ),
    }


def formulations(ground: Bicubic) -> dict[str, Any]:
    """Return the models by name."""
    vehicle = VEHICLE
    return {
        "closure least": direct_kinematics(vehicle, ground),
        "closure rolling": direct_kinematics(vehicle, ground, slip=Rolling()),
        "Montana least": montana_kinematics(vehicle, ground),
        "Montana rolling": montana_kinematics(vehicle, ground, slip=Rolling()),
    }


def cvodes(system: System) -> dict[str, ca.MX]:
    """Return the differential equations with the algebraic blocks eliminated."""
    sizes = {name: system.core.size1_in(k) for k, name in enumerate("txzu") if name != "z"}
    symbols = {name: ca.MX.sym(name, size) for name, size in sizes.items()}
    t, x, u = symbols.values()
    z = system.dae.function("guess", [system.dae.columns()[0]], [system.dae.guess])(x)
    for block in system.blocks:
        z = _solve_symbolically(block, [t, x, z, u])
    return symbols | {"ode": system.core(t, x, z[: system.motion_size], u)[0]}


INTEGRATORS = ("idas", "idas test", "cvodes")


class Point(NamedTuple):
    """Cost and error of one integration."""

    tolerance: float
    error: float
    cpu: float
    steps: float


def line(kind: str, dae: Any, drive: Drive, stand: Trajectory, exact: Trajectory) -> list[Point]:
    """Return the points of one curve; tolerances at which the integrator fails are omitted."""
    system = with_inputs(dae, drive.inputs(dae, VEHICLE, stand), drive.t.size - 1)
    x, u = dae.rows("x", stand, -1), system.u[:, 0]
    begin = {"x0": x, "u": u}
    if kind != "cvodes":
        rest = dae.rows("z", stand, -1)
        begin["z0"] = solve_initial_conditions(system, 0.0, x, rest, u)
    equations, own = (cvodes(system), {}) if kind == "cvodes" else wrapped(system)
    points = []
    for tolerance in TOLERANCES:
        options = {"reltol": tolerance, "abstol": tolerance, "max_num_steps": 100_000, **own}
        if kind != "cvodes":
            options["suppress_algebraic"] = dae.suppress_algebraic ^ (kind == "idas test")
        solver = ca.integrator("motion", kind.split()[0], equations, 0.0, drive.t, options)
        try:
            cpu, found = _timed(solver, begin)
        except RuntimeError as error:
            print(f"  {kind} at {tolerance:.0e}: {str(error).strip().splitlines()[-1]}")
            continue
        found = np.array(found["xf"]) + dae.shift[0][:, None]
        points.append(Point(tolerance, _error(dae, found, exact), cpu, solver.stats()["nsteps"]))
    return points


def _timed(solver: ca.Function, begin: dict[str, Any]) -> tuple[float, Any]:
    times = []
    for _ in range(REPEATS):
        clock = time.process_time()
        found = solver(**begin)
        times.append(time.process_time() - clock)
    return min(times), found


def _error(dae: Any, found: np.ndarray, exact: Trajectory) -> float:
    names = [label.full for label in leaves(dae.labels.x)]
    return max(
        float(np.abs(found[names.index(name), 1:] - exact[name][1:]).max()) for name in COMPARED
    )


def at_equal_error(points: list[Point]) -> float:
    """Return the CPU time at the common error, interpolated on a curve. [s]."""
    errors, times = (np.log([getattr(p, k) for p in points]) for k in ("error", "cpu"))
    order = np.argsort(errors)
    if not errors[order[0]] <= np.log(EQUAL) <= errors[order[-1]]:
        return np.nan
    return float(np.exp(np.interp(np.log(EQUAL), errors[order], times[order])))


def measure(name: str, drive: Drive) -> tuple[dict[tuple[str, str], list[Point]], float]:
    """Return all curves of a drive and its length, and print them."""
    models, lines = formulations(drive.ground), {}
    closure, vehicle = models["closure least"], VEHICLE
    stand = settle(closure, **drive.start)
    laws = drive.inputs(closure, vehicle, stand)
    exact = simulate(closure, stand, laws, drive.t, options=SolverOptions(tolerance=EXACT))
    metres = path_length(exact)
    print(f"\n{name}: {metres:.2f} m in {drive.t[-1]:g} s")
    print("formulation      integrator     tol  steps  ms CPU/m    error")
    for formulation, dae in models.items():
        for kind in INTEGRATORS:
            points = lines[formulation, kind] = line(kind, dae, drive, stand, exact)
            for p in points:
                print(
                    f"{formulation:16} {kind:10} {p.tolerance:7.0e} {p.steps:6.0f} "
                    f"{1e3 * p.cpu / metres:9.2f}  {p.error:.1e}"
                )
    return lines, metres


def gains(name: str, lines: dict[tuple[str, str], list[Point]]) -> str:
    """Return as text the time of every curve at equal error divided by that of the first."""
    times = {key: at_equal_error(points) for key, points in lines.items() if points}
    first = next(iter(times.values()))
    ratios = [f"{' '.join(key)} {value / first:.2g}" for key, value in times.items()]
    return f"{name}, CPU at error {EQUAL:.0e} over that of the first: " + ", ".join(ratios)


def plot(found: dict[str, Any], file: Path) -> None:
    """Draw all curves, one panel per drive, with ratios in the titles."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, len(found), figsize=(11, 5.2), layout="constrained")
    for panel, (name, (lines, metres)) in zip(panels, found.items(), strict=True):
        for (formulation, kind), points in lines.items():
            colour = f"C{[*dict.fromkeys(key[0] for key in lines)].index(formulation)}"
            panel.loglog(
                [1e3 * p.cpu / metres for p in points],
                [p.error for p in points],
                {"idas": "o-", "idas test": "^:", "cvodes": "s--"}[kind],
                color=colour,
                label=f"{formulation}, {kind}",
            )
        cost = {key: at_equal_error(points) for key, points in lines.items() if points}
        best = min((key for key in cost if np.isfinite(cost[key])), key=lambda key: cost[key])
        gain = cost["closure least", "idas"] / cost[best]
        panel.set(xlabel="CPU time per metre [ms/m]", ylabel="largest error [m, rad]")
        panel.set_title(
            f"{name}: at {EQUAL:.0e}, {' '.join(best)} is {gain:.1f} x as fast\n"
            "as closure least idas, the default",
            fontsize=9,
        )
        panel.grid(visible=True, which="major", alpha=0.3)
    panels[0].legend(fontsize=7)
    figure.savefig(file, dpi=150)


def main() -> None:
    """Print the table and draw the plot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="where to draw the lines")
    file = parser.parse_args().plot
    heading()
    found = {name: measure(name, drive) for name, drive in drives().items()}
    print()
    for name, (lines, _) in found.items():
        print(gains(name, lines))
    if file:
        plot(found, file)


if __name__ == "__main__":
    main()
