"""Random climbs: vehicle, ground, contact and control, including sampled control."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple, get_args

import numpy as np

from helpers.climb_cases import Grip, gripped
from slipfree import SolverOptions
from slipfree.catalog.step_climber import step_climber
from slipfree.climb.dynamics import held_torques, standing
from slipfree.control.reference_speeds import Law
from slipfree.control.sensor_noise import Noise
from slipfree.control.step_climbing import Control, largest_period
from slipfree.solve.settle import settle
from slipfree.solve.simulate import simulate
from slipfree.solve.zero_order_hold import simulate_sampled
from slipfree.terrain.solids import Profile, kerb, ramp, stairs, step
from slipfree.trajectory import Trajectory
from slipfree.vehicle.climber import AXLES, Climber

AHEAD, EVERY, TOLERANCE = 0.02, 0.01, 1e-6
WAY, EXTRA = 2.0, 2.0  # of a run, with the way that stairs add [m], and its time beyond that [s]


class Drawn(NamedTuple):
    """What climbs what, and how; ``period`` is that of a sampled controller [s] or None."""

    climber: Climber
    profile: Profile
    contact: Grip
    control: Control
    speed: float
    period: float | None


def drawn(seed: int) -> Drawn:
    """Return the climb of a seed."""
    rng = np.random.default_rng([20091, seed])
    climber, profile, contact = _climber(rng), _profile(rng), _contact(rng)
    control = _control(rng)
    sampled = rng.uniform() < 0.25
    part = rng.uniform(0.3, 0.8)
    period = part * largest_period(control, climber) if sampled else None
    return Drawn(climber, profile, contact, control, rng.uniform(0.1, 0.4), period)


def drive(case: Drawn) -> Trajectory:
    """Return its motion."""
    climber, dae = gripped(
        case.climber, case.profile, case.control, case.contact, period=case.period
    )
    front = -case.climber.radius - AHEAD
    start = settle(dae, **standing(climber, front, case.speed))
    until = WAY / case.speed + EXTRA
    if case.period is None:
        t = np.linspace(0, until, round(until / EVERY) + 1)
        return simulate(
            dae, start, dae.inputs(speed=case.speed), t, options=SolverOptions(tolerance=TOLERANCE)
        )
    t = np.arange(round(until / case.period) + 1) * case.period
    held = held_torques(case.climber, dae)
    return simulate_sampled(
        dae,
        start,
        dae.inputs(speed=case.speed, **held),
        t,
        options=SolverOptions(tolerance=TOLERANCE),
    )


def finite(run: Trajectory) -> bool:
    """Return whether all that was sampled is a number."""
    return all(np.isfinite(run[name]).all() for name in run)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number whose logarithm is even."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _climber(rng: np.random.Generator) -> Climber:
    base = step_climber(rng.choice([0.0, rng.uniform(0, 0.126)]))
    changes: dict[str, Any] = {
        name: getattr(base, name)._replace(
            mass=getattr(base, name).mass * _between(rng, 0.6, 1.6),
            ahead=getattr(base, name).ahead + rng.uniform(-0.02, 0.02),
            above=rng.uniform(0.0, 0.12),
            inertia=getattr(base, name).inertia * _between(rng, 0.5, 2.0),
        )
        for name in ("rear_body", "front_body")
    }
    changes |= {
        name: getattr(base, name)._replace(
            inertia=getattr(base, name).inertia * _between(rng, 0.5, 2.0)
        )
        for name in AXLES
    }
    torque = rng.choice([math.inf, _between(rng, 2.0, 16.0)], p=[0.2, 0.8])
    return replace(base, radius=rng.uniform(0.05, 0.08), torque=float(torque), **changes)


def _profile(rng: np.random.Generator) -> Profile:
    kinds = {
        "ramp": lambda: ramp(rng.uniform(0.3, 1.2), rng.uniform(0.03, 0.12)),
        "step": lambda: step(rng.uniform(0.02, 0.14)),
        "kerb": lambda: kerb(rng.uniform(0.02, 0.1), rng.uniform(0.3, 1.0)),
        "stairs": lambda: stairs(
            rng.uniform(0.02, 0.05), rng.uniform(0.25, 0.5), int(rng.integers(2, 4))
        ),
    }
    return kinds[rng.choice(list(kinds))]()


def _contact(rng: np.random.Generator) -> Grip:
    static = rng.uniform(0.3, 1.2)
    return Grip(
        stiffness=_between(rng, 5e4, 2e6),
        damping=_between(rng, 1.0, 30.0),
        static=static,
        dynamic=static * rng.uniform(0.6, 1.0),
        creep=_between(rng, 2e-4, 2e-3),
        stribeck=_between(rng, 5e-3, 5e-2),
    )


def _control(rng: np.random.Generator) -> Control:
    # Laws as printed seldom climb, so that most draws are of the others.
    law = rng.choice(list(get_args(Law)), p=[0.5, 0.2, 0.1, 0.1, 0.1])
    derivative, unwinding = rng.uniform(size=2) < 0.3
    return Control(
        law=str(law),
        directions=str(rng.choice(["sensors", "contact"])),
        smoothing=_between(rng, 5e-3, 0.1),
        share=rng.uniform(0.8, 1.05),
        cap=rng.uniform(1.0, 2.0),
        proportional=rng.uniform(1.0, 8.0),
        integral=_between(rng, 5.0, 80.0),
        derivative=0.01 * derivative,
        unwinding=20.0 * unwinding,
        noise=_noise(rng),
    )


def _noise(rng: np.random.Generator) -> Noise | None:
    if rng.uniform() < 0.7:
        return None
    return Noise(
        tilt=_between(rng, 1e-3, 2e-2),
        tilt_rate=_between(rng, 1e-2, 0.3),
        wheel_rate=_between(rng, 1e-2, 0.3),
        band=rng.uniform(10, 60),
        seed=int(rng.integers(1000)),
    )
