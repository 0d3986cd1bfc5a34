"""Climbs shared by tests and benchmarks: ramp and step of the study, controllers, friction."""

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

import slipfree as sf
from slipfree.catalog import step_climber
from slipfree.climb.contact_path import TrackedPlan, Tracking, legs, tracked_plan
from slipfree.climb.contact_path import climb as program
from slipfree.climb.metrics import Metrics, climb_metrics
from slipfree.control.step_climbing import StepClimbing, climbing
from slipfree.plan.ipopt import solve_nlp
from slipfree.terrain.solids import Profile, placed, ramp, step
from slipfree.vehicle.tree import EARTH_GRAVITY

AMPLE = 8.0  # torque of the lab's motors that "never" limits; on the step it does, 1 % of the time
SPEED, HEIGHT, EVERY, AHEAD = 0.25, 0.09, 2e-3, 0.05
MOTORS = (2, 1, 2)
MARGIN = 0.96  # part of the friction that a plan may use
RAMP, STEP = ramp(np.pi / 4, HEIGHT), step(HEIGHT)
FIXED = StepClimbing("fixed")
EXACT = StepClimbing(directions="contact")
EXACT_95 = StepClimbing(directions="contact", share=0.95)
SENSED = StepClimbing()
PRINTED_6_8 = StepClimbing("printed_6_8", directions="contact")
PRINTED_14 = StepClimbing("printed_14", directions="contact")
PRINTED_16 = StepClimbing("printed_16", directions="contact")


class Grip(NamedTuple):
    """Friction and contacts in the lab's numbers [1, 1, N/m, s/m, m/s, m/s]."""

    static: float = 0.4
    dynamic: float = 0.3
    stiffness: float = 1.5e5
    damping: float = 10.0
    creep: float = 5e-4
    stribeck: float = 0.01


TABLE_I, TWICE = Grip(), Grip(0.9, 0.675)


CLIMBER = step_climber()


class Climb(NamedTuple):
    """A motion and what it is of."""

    vehicle: sf.Vehicle
    profile: Profile
    run: sf.Trajectory

    @property
    def metrics(self) -> Metrics:
        """Averages over the climb."""
        return climb_metrics(self.run, self.vehicle, self.profile)


def foot(profile):
    """Place of the front axle just before the ramp or step. [m]."""
    edge, top = profile.summit
    angle = np.arctan2(top, edge)
    return -AHEAD - CLIMBER.wheels[0].radius * np.tan(angle / 2)


def stiff(vehicle, grip):
    """The vehicle with the stiffness of its contacts, and their law."""
    depth = vehicle.mass * EARTH_GRAVITY / 3 / grip.stiffness
    wheels = tuple(replace(wheel, static_depth=depth) for wheel in vehicle.wheels)
    ratio = grip.damping * np.sqrt(EARTH_GRAVITY * depth) / 2
    law = sf.Compliant(ratio, grip.creep, grip.dynamic / grip.static, grip.stribeck)
    return replace(vehicle, wheels=wheels), law


def gripped(vehicle, profile, control, grip, *, sampled=False):
    """The vehicle with the stiffness of its contacts, and its model."""
    vehicle, law = stiff(vehicle, grip)
    floor = sf.Analytic(lambda x, _y: 0 * x, mu=grip.static)
    prisms = placed(profile)
    model = sf.dynamics(vehicle, sf.Solids(floor, prisms) if prisms else floor, law=law)
    return vehicle, climbing(model, control, profile, sampled=sampled)


def begin(vehicle, profile, control, grip, speed=SPEED, **options):
    """The model, and its start rolling towards the climb."""
    vehicle, dae = gripped(vehicle, profile, control, grip, **options)
    joint = foot(profile) - vehicle.wheels[2].at[1]
    return dae, sf.settle(dae, y=joint, speed=speed)


@lru_cache(maxsize=32)
def climb(
    profile,
    control,
    contact,
    *,
    torque=AMPLE,
    until=3.6,
    tolerance=1e-6,
    speed=SPEED,
    every=EVERY,
    vehicle=None,
) -> Climb:
    vehicle = vehicle or step_climber()
    dae, start = begin(vehicle, profile, replace(control, torque=torque), contact, speed)
    t = np.arange(round(until / every) + 1) * every
    options = sf.SolverOptions(tolerance=tolerance)
    run = sf.simulate(dae, start, dae.inputs(reference_speed=speed), t, options=options)
    return Climb(vehicle, profile, run)


@lru_cache(maxsize=32)
def solved_legs(profile, mu=None, speed=SPEED, climber=CLIMBER):
    """Programs and solutions of legs, of least slip within a friction, or of least friction."""
    cost = "friction" if mu is None else "slip"
    ways, found, torques = legs(climber, profile), [], AMPLE * np.array(MOTORS)
    for leg in ways:
        halt = leg is not ways[-1]
        plan = program(climber, profile, leg, cost, mu=mu, speed=speed, torques=torques, halt=halt)
        found.append((plan, solve_nlp(plan.nlp).unknowns))
    return found


def planned(profile, mu=None, speed=SPEED, climber=CLIMBER) -> TrackedPlan:
    """The climb of `solved_legs`, all legs in one."""
    return tracked_plan(solved_legs(profile, mu, speed, climber))


def tracking(profile, mu, speed=SPEED) -> Tracking:
    """A plan for a little less friction than there is."""
    return Tracking(planned(profile, round(MARGIN * mu, 6), speed))
