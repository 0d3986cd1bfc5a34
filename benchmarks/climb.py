"""Step climber: friction needed on the 90 mm step, and slip against rigid time stepping.

``python benchmarks climb [PART ...]``:

thresholds  least static friction with which controllers and plans climb the 90 mm step
rigid       slip with stiff contacts against rigid time stepping
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from common import run_parts

from helpers import climb_stepping as stepping
from helpers.climb_cases import (
    EXACT,
    EXACT_95,
    FIXED,
    MARGIN,
    RAMP,
    SENSED,
    STEP,
    TABLE_I,
    TWICE,
    Grip,
    climb,
    planned,
    tracking,
)
from slipfree.climb.contact_path import Tracking
from slipfree.control.step_climbing import StepClimbing
from slipfree.core.trajectory import SolverError

FINE, LOWEST, HIGHEST = 0.005, 0.5, 1.2
MORE = (0.01, 0.02, 0.05, 0.1, 0.2)
Driver = Callable[[float, float], StepClimbing | Tracking]
DRIVERS: dict[str, Driver] = {
    "fixed": lambda _mu, _speed: FIXED,
    "exact": lambda _mu, _speed: EXACT,
    "exact .95": lambda _mu, _speed: EXACT_95,
    "sensed": lambda _mu, _speed: SENSED,
    f"plan for {MARGIN:g} mu": lambda mu, speed: tracking(STEP, mu, speed),
    "plan of least mu": lambda _mu, speed: Tracking(planned(STEP, None, speed)),
}


class Threshold(NamedTuple):
    """Controller, ratio of kinetic to static friction, and speed."""

    driver: Driver
    part: float
    speed: float


def thresholds() -> None:
    """Print the least static friction with which the 90 mm step is climbed, by controller.

    Plans use the given friction, except that of least friction; both are at rest between their
    legs. A vehicle that climbs with some friction may fail with more, which the last column tests.
    """
    print(f"\nleast mu_s on the 90 mm step to {FINE:g}; what of mu_s + {MORE} does not climb")
    for part, speed in ((0.75, 0.25), (0.75, 0.05), (1.0, 0.25), (1.0, 0.05)):
        for name, driver in DRIVERS.items():
            case = Threshold(driver, part, speed)
            what = f"  mu_d = {part:g} mu_s, {speed:g} m/s, {name:18}"
            low, high = LOWEST, HIGHEST
            if not holds(case, high):
                print(f"{what} not even {high:g}", flush=True)
                continue
            while high - low > FINE:
                mu = (low + high) / 2
                low, high = (low, mu) if holds(case, mu) else (mu, high)
            fails = [f"{more:g}" for more in MORE if not holds(case, high + more)]
            print(f"{what} {high:.3f}   {', '.join(fails) or 'none'}", flush=True)


def holds(case: Threshold, mu: float) -> bool:
    """Return whether the 90 mm step is climbed with a coefficient of friction."""
    try:
        control = case.driver(mu, case.speed)
    except SolverError:  # no plan
        return False
    contact = Grip(mu, case.part * mu)
    # With little left at the wall, the exact law climbs at a fraction of the speed.
    until = 1.0 / case.speed + 14 if isinstance(control, Tracking) else 4.0 / case.speed
    try:
        run = climb(STEP, control, contact, speed=case.speed, until=until, every=0.01)
    except SolverError:  # the integrator gives up
        return False
    return run.metrics.window.climbed


def rigid() -> None:
    """Print the comparison of stiff contacts with rigid time stepping."""
    for name, profile, contact in (("ramp", RAMP, TABLE_I), ("step", STEP, TWICE)):
        stiff = contact._replace(stiffness=1e7, damping=50.0, creep=2e-4)
        for exact in (False, True):
            law = StepClimbing("projective" if exact else "fixed", "contact", share=0.9, cap=2.0)
            run = climb(profile, law, stiff, torque=np.inf)
            mine = 100 * float(run.metrics.slip.mean())
            angle = float(np.arctan2(*profile.summit[::-1]))
            case = stepping.Case(angle, contact.static, contact.dynamic, exact)
            for h in (5e-4, 2e-4, 1e-4):
                theirs = 100 * stepping.climb(case, h)[0].mean()
                print(
                    f"  {name} {law.law}: slip, rigid at {1e3 * h:g} ms {theirs:.2f} %, this at "
                    f"1e7 N/m {mine:.2f} %: {100 * (mine / theirs - 1):+.1f} %",
                    flush=True,
                )


def main() -> None:
    """Print the parts."""
    run_parts({"thresholds": thresholds, "rigid": rigid})
