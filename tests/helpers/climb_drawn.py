"""Random climbs: vehicle, ground, contact and control, including sampled control."""

import math
from dataclasses import replace
from typing import NamedTuple, get_args

import numpy as np

import slipfree as sf
from helpers.climb_cases import Grip, gripped
from slipfree.catalog import step_climber
from slipfree.control.step_climbing import Law, StepClimbing, held_torques, largest_period
from slipfree.solve.simulate import simulate_sampled
from slipfree.terrain.solids import Profile, kerb, ramp, stairs, step
from slipfree.vehicle.sections import Disc

AHEAD, EVERY, TOLERANCE = 0.02, 0.01, 1e-6
WAY, EXTRA = 2.0, 2.0  # of a run, with the way that stairs add [m], and its time beyond that [s]


class Drawn(NamedTuple):
    """What climbs what, and how; ``period`` is that of a sampled controller [s] or None."""

    vehicle: sf.Vehicle
    profile: Profile
    contact: Grip
    control: StepClimbing
    speed: float
    period: float | None


def drawn(seed: int) -> Drawn:
    """Return the climb of a seed."""
    rng = np.random.default_rng([20091, seed])
    (vehicle, torque), profile, contact = _vehicle(rng), _profile(rng), _contact(rng)
    control = replace(_control(rng), torque=torque)
    sampled = rng.uniform() < 0.25
    part = rng.uniform(0.3, 0.8)
    period = part * largest_period(control, vehicle) if sampled else None
    return Drawn(vehicle, profile, contact, control, rng.uniform(0.1, 0.4), period)


def drive(case: Drawn) -> sf.Trajectory:
    """Return its motion."""
    sampled = case.period is not None
    vehicle, dae = gripped(case.vehicle, case.profile, case.control, case.contact, sampled=sampled)
    front = vehicle.wheels[2]
    start = sf.settle(dae, y=-front.radius - AHEAD - front.at[1], speed=case.speed)
    until, options = WAY / case.speed + EXTRA, sf.SolverOptions(tolerance=TOLERANCE)
    if case.period is None:
        t = np.linspace(0, until, round(until / EVERY) + 1)
        return sf.simulate(dae, start, dae.inputs(reference_speed=case.speed), t, options=options)
    t = np.arange(round(until / case.period) + 1) * case.period
    held = held_torques(dae, case.control)
    inputs = dae.inputs(reference_speed=case.speed, **held)
    return simulate_sampled(dae, start, inputs, t, options=options)


def finite(run: sf.Trajectory) -> bool:
    """Return whether all that was sampled is a number."""
    return all(np.isfinite(run[name]).all() for name in run)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number whose logarithm is even."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _vehicle(rng: np.random.Generator) -> tuple[sf.Vehicle, float]:
    """Return a vehicle, and the largest torque of its motors."""
    base = step_climber(joint=rng.choice([0.0, rng.uniform(0, 0.126)]))
    bodies = []
    for body in (base.body, base.joints[0].body):
        mass, ahead = body.mass * _between(rng, 0.6, 1.6), body.at[1] + rng.uniform(-0.02, 0.02)
        above, inertia = rng.uniform(0.0, 0.12), body.inertia[0] * _between(rng, 0.5, 2.0)
        bodies.append(sf.Body(mass, (0.0, ahead, above), 3 * (inertia,) + 3 * (0.0,)))
    spins = [wheel.inertia[0] * _between(rng, 0.5, 2.0) for wheel in base.wheels]
    torque = float(rng.choice([math.inf, _between(rng, 2.0, 16.0)], p=[0.2, 0.8]))
    section = Disc(rng.uniform(0.05, 0.08))
    wheels = tuple(
        replace(wheel, section=section, inertia=(spin, spin))
        for wheel, spin in zip(base.wheels, spins, strict=True)
    )
    joint = replace(base.joints[0], body=bodies[1])
    return replace(base, body=bodies[0], joints=(joint,), wheels=wheels), torque


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


def _control(rng: np.random.Generator) -> StepClimbing:
    # Laws as printed seldom climb, so that most draws are of the others.
    law = rng.choice(list(get_args(Law)), p=[0.5, 0.2, 0.1, 0.1, 0.1])
    return StepClimbing(
        law=str(law),
        directions=str(rng.choice(["sensors", "contact"])),
        share=rng.uniform(0.8, 1.05),
        cap=rng.uniform(1.0, 2.0),
        proportional=rng.uniform(1.0, 8.0),
        integral=_between(rng, 5.0, 80.0),
    )
