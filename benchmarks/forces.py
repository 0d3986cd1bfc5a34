"""Forces: energy, limits of friction, and axles at rest on slopes.

``python benchmarks forces [PART ...]`` prints the values of docs/accuracy.md and docs/papers.md:
the work of the drives against the energy gained; the convergence towards three limits of friction;
the least coefficient of friction with which four axles can
stand, from the best distribution of forces and from the existence of an equilibrium; and the
friction that the paper's direct run needs.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from common import PROBLEMS, run_parts

from helpers.cases import hills
from helpers.dynamics import slope
from helpers.friction_cases import PLACE, RATES, dissipation, flat, from_linear, from_rolling, order
from slipfree import (
    Analytic,
    Coulomb,
    ModelError,
    SolverOptions,
    direct_kinematics,
    quasi_statics,
    settle,
    simulate,
)
from slipfree.catalog import three_wheeler
from slipfree.models.friction_feasibility import best_utilisation
from slipfree.problem.load import load_problem
from slipfree.problem.result import run_problem

RISE, LENGTH = 0.3, 1.5  # height of the centre of mass, wheelbase [m]
PLACES = ((10, 90), (20, 90), (20, 45), (20, 0), (20, 180))  # slope, heading from uphill [degrees]
LAB = {
    "tilting": (0.529, 1.092, 0.936, 0.492, 0.613),
    "two prismatic": (0.529, 1.092, 0.936, 0.492, 0.613),
    "one prismatic": (0.258, 0.509, 0.457, 0.492, 0.613),
    "fixed": (0.177, 0.364, 0.432, 0.492, 0.613),
}
DISC = {"r1": 0.005, "r2": 0.295}
AXLES: dict[str, dict[str, Any]] = {
    "tilting": {"axle": "tilting"},
    "two prismatic": {"axle": "sliding", **DISC},
    "one prismatic": {"axle": "prismatic", **DISC},
    "fixed": {"axle": "fixed"},
}


def energy() -> None:
    """Print the difference of work and energy gained on the way up hills."""
    ground = Analytic(lambda x, y: hills(x, y) + 0.15 * y)
    dae = direct_kinematics(three_wheeler(), ground)
    begin, t = settle(dae, **PLACE), np.linspace(0, 20, 201)
    for tolerance in (1e-6, 1e-8, 1e-10):
        run = simulate(
            dae, begin, dae.inputs(**RATES), t, options=SolverOptions(tolerance=tolerance)
        )
        gained = run["potential_energy"] - run["potential_energy"][0]
        missed = np.abs(run["work"] - gained).max()
        print(
            f"20 s of hills, tolerance {tolerance:g}: energy gained {gained[-1]:.4f} J, work "
            f"differs by {missed:.1e} J, {missed / gained[-1]:.1e} of it"
        )


def limits() -> None:
    """Print the convergence towards the limits of friction."""
    sizes = np.array([1e-3, 1e-4, 1e-5, 1e-6])
    for axle in ("tilting", "sliding"):
        apart, _ = zip(*from_rolling(axle, sizes), strict=True)
        words = ", ".join(f"{each:.1e}" for each in apart)
        print(
            f"{axle}: from rolling after 10 s of hills, eps 1e-3 to 1e-6: {words} m or rad; "
            f"order {order(sizes, apart):.3f}"
        )
    scale = np.array([1.0, 10.0, 100.0])
    for name, ground in (("level ground", flat), ("hills", hills)):
        errors = [from_linear(ground, mu) for mu in scale]
        words = ", ".join(f"{each:.1e}" for each in errors)
        law = "least slip by load" if ground is flat else "linear law with gravity"
        print(
            f"fixed axle, {name}: from the {law}, mu 1, 10, 100 at fixed eps/mu: {words}; "
            f"order {order(1 / scale, errors):.2f}"
        )
    found = [dissipation(eps) for eps in sizes[1:]]
    words = ", ".join(f"{each.gap / each.cost(each.rates):.1e}" for each in found)
    print(
        f"fixed axle: above the least dissipation at most, eps 1e-4 to 1e-6: {words} of it; "
        f"order {order(sizes[1:], [each.gap for each in found]):.2f}"
    )


def standing() -> None:
    """Print the least coefficient of friction with which each axle can stand on a slope."""
    print("least friction to stand on: best distribution / equilibrium exists / lab")
    print(f"{'':22}" + "".join(f"{f'{slope} deg, heading {way}':24}" for slope, way in PLACES))
    for (name, options), wheel_mass in product(AXLES.items(), (0.0, 2.0)):
        vehicle = three_wheeler(wheel_mass=wheel_mass, **options)
        cells = []
        for (degrees, way), lab in zip(PLACES, LAB[name], strict=True):
            start = {"heading": np.radians(way)}
            ground = slope(degrees)
            run = settle(direct_kinematics(vehicle, ground), **start)
            best = best_utilisation(vehicle, ground, run)["utilisation_best"][0]
            exists = least_mu(vehicle, degrees, start)
            known = "-" if wheel_mass else f"{lab:.3f}"  # the lab's wheels have no mass
            cells.append(f"{best:.4f} / {exists:.4f} / {known}")
        print(f"{name:14} {wheel_mass:g} kg   " + "".join(f"{cell:24}" for cell in cells))


def least_mu(vehicle: Any, degrees: float, start: dict[str, float]) -> float:
    """Return the least coefficient at which an equilibrium with friction is found."""
    low, high = 0.0, 3.0
    for _ in range(14):
        mu = (low + high) / 2
        dae = quasi_statics(vehicle, slope(degrees, mu), law=Coulomb(1e-3))
        try:
            settle(dae, **start)
            high = mu
        except ModelError:
            low = mu
    return high


def paper() -> None:
    """Print the friction that the paper's direct run needs over time."""
    problem = load_problem(PROBLEMS / "paper_direct.toml")
    run = run_problem(problem).trajectory
    print("friction needed by problems/paper_direct.toml (right, left, front), tilt right [rad]")
    for t in range(7):
        k = int(np.argmin(np.abs(run.t - t)))
        needed = ", ".join(f"{each:.3f}" for each in run["friction_needed"][k])
        print(f"  {run.t[k]:g} s: {needed}; {run['tilt_right'][k]:.3f}")


def main() -> None:
    """Print the parts."""
    parts = (energy, limits, standing, paper)
    run_parts({part.__name__: part for part in parts})
