"""Compute the friction needed by slow and planned climbs, and the times of planned climbs.

``python benchmarks/climb_path.py`` prints four tables beside the values of a separate study: the
least friction of slow climbs, and the highest step for a given friction; the least friction of
planned climbs, leg by leg; the least time on the 90 mm step, with and without the inertia of the
wheels, over the whole leg and over that of the study, which omits 0.2 % of the height at both ends;
and the effect of the number of nodes. Solver times are the least of three.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import brentq

from slipfree.catalog.step_climber import step_climber
from slipfree.climb.contact_path import Leg, axle_arms, legs, sample
from slipfree.climb.friction_demand import (
    equilibrium,
    highest_obstacle,
    least_friction,
    least_friction_forces,
)
from slipfree.climb.time_scaling import climb, history
from slipfree.plan.external_nlp import solve_nlp
from slipfree.records import Array
from slipfree.terrain.solids import Profile, ramp, step
from slipfree.trajectory import Trajectory
from slipfree.vehicle.climber import AXLES, Climber

HEIGHT, NODES, MARGIN = 0.09, 60, 1.03
PROFILES = {
    "ramp": ramp(np.pi / 4, HEIGHT),
    **{f"{mm} mm": step(mm / 1000) for mm in (50, 90, 128)},
}
SLOW = {
    ("ramp", 0.0): 0.323,
    ("50 mm", 0.0): 0.543,
    ("90 mm", 0.0): 0.71,
    ("128 mm", 0.0): 0.71,
    ("90 mm", 0.06): 0.68,
    ("90 mm", 0.126): 0.90,
}
LEAST = {
    "ramp": (0.251, 0.323, 0.249),
    "50 mm": (0.460, 0.542, 0.539),
    "90 mm": (0.579, 0.630, 0.677),
    "128 mm": (0.579, 0.608, 0.624),
}
SECONDS = (0.63, 0.73, 0.89)


def solved(climber: Climber, profile: Profile, leg: Leg, cost: str, **options: Any) -> Trajectory:
    """Return the plan of a leg over time; its statistics contain the solver time."""
    took, iterations = [], 0
    for _ in range(3):
        start = time.perf_counter()
        plan = climb(climber, profile, leg, cost, **options)
        solution = solve_nlp(plan.nlp)
        took.append(time.perf_counter() - start)
        iterations = solution.iterations
    run = history(plan, solution.unknowns)
    return replace(run, statistics={**run.statistics, "took": min(took), "count": iterations})


def slow() -> Iterator[str]:
    """Yield the least friction of slow climbs."""
    yield "slow climbs: joint [m], least mu (study), by leg"
    for (name, joint), expected in SLOW.items():
        found = least_friction(step_climber(joint), PROFILES[name])
        by_leg = ", ".join(f"{each.leg.axle} {each.mu:.4f}" for each in found.demands)
        yield f"  {name:7s} {joint:5.3f}  {found.mu:.4f} ({expected})  {by_leg}"
    leg = legs(step_climber(), PROFILES["90 mm"])[-1]
    way = sample(step_climber(), PROFILES["90 mm"], leg, np.array([leg.length]))
    loads = least_friction_forces(*equilibrium(step_climber(), way)).normal[0]
    yield "  loads at rest, rear to front: " + ", ".join(f"{load:.2f} N" for load in loads)
    tallest = highest_obstacle(step_climber(), 0.4, 0.1)
    yield f"  highest step for mu 0.4: {1e3 * tallest:.1f} mm (about 29)"


def planned() -> Iterator[str]:
    """Yield the least friction of planned climbs."""
    yield f"planned climbs, {NODES} nodes: least mu (study), difference, time of solving"
    climber = step_climber()
    for name, profile in PROFILES.items():
        for leg, expected in zip(legs(climber, profile), LEAST[name], strict=True):
            told = solved(climber, profile, leg, "friction", s=NODES).statistics
            yield (
                f"  {name:7s} {leg.axle:6s}  {told['mu']:.4f} ({expected:.3f})  "
                f"{told['mu'] - expected:+.4f}  {told['took']:.2f} s, "
                f"{told['count']:.0f} iterations"
            )


def risen(climber: Climber, profile: Profile, leg: Leg) -> Array:
    """Return nodes from 0.2 to 99.8 % of the climbing axle's rise."""

    def over(s: float, part: float) -> float:
        q = sample(climber, profile, leg, np.array([s])).q
        height = q[0, 1] + axle_arms(climber, q)[0, AXLES.index(leg.axle), 1] - climber.radius
        return float(height - part * HEIGHT)

    low, high = (brentq(over, 0, leg.length, (part,)) for part in (0.002, 0.998))
    return np.asarray(low + (high - low) * np.linspace(0, 1, NODES) ** 2)


def fastest() -> Iterator[str]:
    """Yield the least times of the step's legs at 1.03 times the least friction of each."""
    yield f"least time [s] on the 90 mm step at {MARGIN} of the least mu (study)"
    full, profile = step_climber(), PROFILES["90 mm"]
    light = replace(full, **{name: getattr(full, name)._replace(inertia=1e-12) for name in AXLES})
    for k, leg in enumerate(legs(full, profile)):
        found = []
        for climber in (full, light):
            for s in (NODES, risen(climber, profile, leg)):
                mu = solved(climber, profile, leg, "friction", s=s).statistics["mu"]
                run = solved(climber, profile, leg, "time", mu=MARGIN * mu, s=s)
                found.append(run.statistics["duration"])
        yield (
            f"  {leg.axle:6s} ({SECONDS[k]})  wheels with inertia {found[0]:.3f}, on the "
            f"study's part {found[1]:.3f}; without {found[2]:.3f}, {found[3]:.3f}"
        )


def meshes() -> Iterator[str]:
    """Yield the effect of the number of nodes, and of the speed."""
    yield "90 mm step, rear leg: nodes, largest speed [m/s], least mu; least time [s] at mu 0.7"
    climber, profile = step_climber(), PROFILES["90 mm"]
    leg = legs(climber, profile)[-1]
    for nodes in (30, 60, 120, 480):
        told = [
            solved(climber, profile, leg, "friction", s=nodes, speed=speed).statistics["mu"]
            for speed in (0.25, 0.001)
        ]
        run = solved(climber, profile, leg, "time", mu=0.7, s=nodes)
        yield (
            f"  {nodes:3d}  at 0.25: {told[0]:.4f}, at 0.001: {told[1]:.4f};  "
            f"{run.statistics['duration']:.4f}"
        )


if __name__ == "__main__":
    for table in (slow, planned, fastest, meshes):
        print(*table(), sep="\n")
