"""Compare the soil law with measured wheels, and measure its cost.

``python benchmarks/soil.py`` compares `single_wheel` with the points in ``measured_wheels.csv``,
and prints the error of the eight Gauss points on each side of the largest stress, the number of
operations per wheel, and the time of a motion in sand. No constant is fitted to these points. It
also compares the plan of ``problems/plan_sandy_slope.toml`` with the plan on the straight path.
"""

from __future__ import annotations

import csv
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np
from reference import heading

from slipfree import (
    Analytic,
    Compliant,
    Soil,
    SolverOptions,
    catalog,
    dynamics,
    load_problem,
    run_problem,
    settle,
    simulate,
)
from slipfree.laws import soil as law
from slipfree.laws.soil import WheelSize, forces_at_slip
from slipfree.laws.soils import SOILS, known_soil
from slipfree.models.single_wheel import single_wheel
from slipfree.trajectory import path_length

SLOPE = Path(__file__).parents[1] / "problems" / "plan_sandy_slope.toml"
TABLE = Path(__file__).with_name("measured_wheels.csv")
PAPER_LOAD = 64.68  # of Ishigami's wheels, as codes that cite them assume [N]
SIMULANT = known_soil("regolith_simulant")
CONSTANT = replace(SIMULANT, shear_along_rate=0.0, shear_across_rate=0.0)


class Case(NamedTuple):
    """A wheel of the table with the soil, dimensions and load [N] of a computation."""

    words: str
    wheel: str
    soil: Soil
    size: WheelSize
    load: float
    most_slip: float


DING, DING_SIZE = known_soil("planetary_simulant"), WheelSize(0.15735, 0.165)
CASES = (
    *(
        Case(f"{wheel}, {words}", wheel, soil, size, PAPER_LOAD, 0.5)
        for wheel in ("ishigami_paddles", "ishigami_smooth")
        for words, soil, size in (
            ("radius 90, width 110 mm", SIMULANT, WheelSize(0.09, 0.11)),
            ("constant shear moduli, 92, 107 mm", CONSTANT, WheelSize(0.092, 0.107)),
            ("bulldozing by cohesion only", replace(SIMULANT, density=0.0), WheelSize(0.09, 0.11)),
        )
    ),
    Case("ding_smooth", "ding_smooth", DING, DING_SIZE, 80.0, 0.6),
    Case("ding_lugs", "ding_lugs", replace(DING, grouser_height=0.01), DING_SIZE, 80.0, 0.6),
)


def measured() -> dict[tuple[str, str], list[tuple[float, float, float]]]:
    """Return slip angle [rad], slip ratio and value of the points, by wheel and quantity."""
    lines = (line for line in TABLE.read_text().splitlines() if not line.startswith("#"))
    points = defaultdict(list)
    for row in csv.DictReader(lines):
        angle = np.deg2rad(float(row["slip_angle_deg"]))
        point = (float(angle), float(row["slip"]), float(row["value"]))
        points[row["wheel"], row["quantity"]].append(point)
    return points


def misses(case: Case, quantity: str, points: list[tuple[float, float, float]]) -> np.ndarray:
    """Return computed minus measured values up to the largest slip ratio of a case."""
    found = []
    for angle, slip, value in points:
        if slip <= case.most_slip:
            curves = single_wheel(case.soil, case.size, case.load, [slip], [angle])
            found.append(getattr(curves, quantity)[0, 0] - value)
    return np.array(found)


def comparison() -> Iterator[str]:
    """Yield the differences from the measured wheels."""
    table = measured()
    yield f"{'wheel':56} {'quantity':9} {'points':>6} {'rms':>9} {'mean':>9}  measured range"
    for case in CASES:
        for (wheel, quantity), points in table.items():
            if wheel != case.wheel:
                continue
            away = misses(case, quantity, points)
            values = [value for _, slip, value in points if slip <= case.most_slip]
            yield (
                f"{case.words:56} {quantity:9} {away.size:6} {np.sqrt(np.mean(away**2)):9.4g} "
                f"{away.mean():9.4g}  {min(values):.4g} to {max(values):.4g}"
            )


def gauss_errors() -> Iterator[str]:
    """Yield the largest difference of the forces from those with 80 points, over the load."""
    few = law.POINTS, law.WEIGHTS
    states = [
        (depth, slip, beta)
        for depth in (0.003, 0.01, 0.03)
        for slip in (-0.9, -0.3, 0.0, 0.1, 0.3, 0.9)
        for beta in (0.0, 0.2, 0.6)
    ]
    for name, (soil, _) in SOILS.items():
        tables = []
        for points in (few, np.polynomial.legendre.leggauss(80)):
            law.POINTS, law.WEIGHTS = points
            forces = [
                [float(each) for each in forces_at_slip(soil, WheelSize(0.092, 0.107), *state)]
                for state in states
            ]
            tables.append(np.array(forces))
        law.POINTS, law.WEIGHTS = few
        away = np.abs(tables[0] - tables[1])[:, :3] / tables[1][:, :1]
        yield f"8 + 8 Gauss points, {name}: {away.max():.1e} of the normal force"


def cost() -> Iterator[str]:
    """Yield the operations of a wheel, and times of motions on sand and on compliant contacts."""
    arguments = [ca.SX.sym(name) for name in ("depth", "slip", "angle")]
    forces = forces_at_slip(SIMULANT, WheelSize(0.092, 0.107), *arguments)
    count = ca.Function("forces", arguments, [*forces]).n_instructions()
    yield f"operations of the forces on a wheel: {count}"
    vehicle = catalog.skid_steer(mass=20.0, wheel_mass=1.0, r1=0.0535, r2=0.0965)
    ground = Analytic(lambda x, y: 0.1405 * y + 0 * x, mu=0.6)
    for contact in (Compliant(), SIMULANT):
        began = time.process_time()
        model = dynamics(vehicle, ground, law=contact)
        start = settle(model)
        built = time.process_time()
        inputs = model.inputs(**{label.full: 0.2 / 0.15 for label in model.labels.u.wheels})
        times = np.linspace(0, 20, 101)
        run = simulate(model, start, inputs, times, options=SolverOptions(1e-6))
        took = time.process_time() - built
        yield (
            f"cart on 8 degrees, 20 s, {type(contact).__name__}: model and start "
            f"{built - began:.2f} s, motion {took:.2f} s, slip ratio "
            f"{run['slip_ratio'][-1].mean():.4f}"
        )


STRAIGHT = (
    "limits.slip_ratio=",
    "limits.sinkage=",
    "limits.x=[-0.05, 0.05]",
    "driver.path=[[0.0, -1.0], [0.0, 5.3]]",
)


def sandy_slope() -> Iterator[str]:
    """Yield slip, sinkage, reserve and work of a plan over a sandy slope, and on the straight path.

    The last part of a line is the simulation with inertia on the same soil.
    """
    for name, settings in (("plan", ()), ("straight", STRAIGHT)):
        began = time.process_time()
        run = run_problem(load_problem(SLOPE, settings)).trajectory
        took, reserve = time.process_time() - began, run["drawbar_reserve"].sum(axis=1).min()
        yield (
            f"{name:9} path {path_length(run):.3g} m, slip ratio {run['slip_ratio'].max():.3f}, "
            f"sinkage {1e3 * run['sinkage'].max():.1f} mm, reserve {reserve:.1f} N, work "
            f"{run['work'][-1]:.0f} J, {run.statistics['plan_iterations']:.0f} iterations, "
            f"{took:.1f} s CPU; with inertia: {run.attributes['in_soil']}"
        )


if __name__ == "__main__":
    heading()
    for part in (comparison, gauss_errors, cost, sandy_slope):
        for line in part():
            print(line)
