"""Compute the friction needed to climb the 90 mm step, by controller; sensitivity and noise.

``python benchmarks/climb.py thresholds robustness noise`` prints all of it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from slipfree.climb.plan_tracking import Tracking
from slipfree.control.sensor_noise import Noise
from slipfree.control.step_climbing import Control
from slipfree.terrain.solids import Profile, step
from slipfree.trajectory import SolverError
from slipfree.vehicle.climber import Climber

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from helpers.climb_cases import (
    CLIMBER,
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

FINE, LOWEST, HIGHEST = 0.005, 0.5, 1.2
MORE = (0.01, 0.02, 0.05, 0.1, 0.2)
Driver = Callable[[float, float], Control | Tracking]
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
    return climbed(STEP, control, contact, speed=case.speed, until=until, every=0.01)


def climbed(profile: Profile, control: Control | Tracking, contact: Grip, **how: Any) -> bool:
    """Return whether it climbs; what the integrator gives up on does not."""
    try:
        return climb(profile, control, contact, **how).metrics.window.climbed
    except SolverError:
        return False


def robustness() -> None:
    """Print the friction range of tracked plans for mu_s 0.69, and of least friction."""
    for name, course in (("plan for 0.69", planned(STEP, 0.69)), ("least mu", planned(STEP))):
        base = Tracking(course)
        print(f"\n{name}: what climbs, and what does not")
        _line(
            "true mu_s",
            ((mu, base, STEP, mu, CLIMBER) for mu in (0.70, 0.72, 0.74, 0.8, 0.9, 1.0, 1.2)),
        )
        for field, factor, values in (
            ("lead", 1e-3, (0.2, 0.5, 1, 2, 3, 5)),
            ("spare", 1e-3, (1, 2, 3, 4, 6, 8, 20)),
            ("proportional", 1, (2, 4, 8, 20, 60)),
        ):
            _line(
                f"{field} [{factor:g}], mu_s .74",
                (
                    (value, replace(base, **{field: factor * value}), STEP, 0.74, CLIMBER)
                    for value in values
                ),
            )
        heights = ((mm, base, step(mm / 1000), 0.76, CLIMBER) for mm in (80, 85, 88, 92, 95))
        _line("height [mm], mu_s .76", heights)
        centers = ((mm, base, STEP, 0.76, _shifted(mm / 1000)) for mm in (-20, -10, 10, 20))
        _line("place of the rear body's center [mm], mu_s .76", centers)


def _line(what: str, cases: Iterable[tuple[float, Tracking, Profile, float, Climber]]) -> None:
    ends: dict[bool, list[str]] = {True: [], False: []}
    for value, control, profile, mu, climber in cases:
        contact = Grip(mu, 0.75 * mu)
        up = climbed(profile, control, contact, climber=climber, until=16.0, every=0.01)
        ends[up].append(f"{value:g}")
    print(f"  {what:48} {' '.join(ends[True]):36} not {' '.join(ends[False]) or '-'}", flush=True)


def _shifted(ahead: float) -> Climber:
    body = CLIMBER.rear_body
    return replace(CLIMBER, rear_body=body._replace(ahead=body.ahead + ahead))


def noise() -> None:
    """Print the slip with sensor noise."""
    print(
        "\nnoise of tilts [rad], their rates, wheels' rates [rad/s]: slip, true slip, disturbance"
    )
    sizes = (
        (0.0, 0.0, 0.0),
        (0.0, 0.03, 0.0),
        (0.0, 0.1, 0.0),
        (0.0, 0.3, 0.0),
        (0.0, 0.0, 0.1),
        (0.0, 0.0, 0.3),
        (0.01, 0.1, 0.1),
    )
    for name, profile, contact in (("ramp", RAMP, TABLE_I), ("step", STEP, TWICE)):
        for control in (FIXED, SENSED):
            for each in sizes:
                rows = [
                    climb(profile, replace(control, noise=Noise(*each, seed=seed)), contact).metrics
                    for seed in range(3)
                ]
                words = [
                    f"{100 * min(values):5.1f} - {100 * max(values):4.1f}"
                    for values in zip(
                        *(
                            (row.slip.mean(), row.true_slip.mean(), row.disturbance.mean())
                            for row in rows
                        ),
                        strict=True,
                    )
                ]
                up = sum(row.window.climbed for row in rows)
                print(
                    f"  {name} {control.law:10} {each!s:18} {'  '.join(words)}  {up} of 3 climb",
                    flush=True,
                )
