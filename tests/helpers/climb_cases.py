"""Climbs shared by tests and benchmarks: ramp and step of the study, controllers, friction."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from slipfree import SolverOptions
from slipfree.catalog.step_climber import step_climber
from slipfree.climb.contact_path import legs
from slipfree.climb.dynamics import climbing, standing
from slipfree.climb.metrics import Metrics, metrics
from slipfree.climb.plan_tracking import TrackedPlan, Tracking, tracked_plan
from slipfree.climb.time_scaling import climb as program
from slipfree.control.step_climbing import Control
from slipfree.laws.compliant import Compliant
from slipfree.plan.external_nlp import solve_nlp
from slipfree.solve.settle import settle
from slipfree.solve.simulate import simulate
from slipfree.terrain.solids import Profile, ramp, step
from slipfree.trajectory import Trajectory
from slipfree.vehicle.climber import Climber
from slipfree.vehicle.tree import GRAVITY

AMPLE = 8.0  # torque of the lab's motors that "never" limits; on the step it does, 1 % of the time
SPEED, HEIGHT, EVERY, AHEAD = 0.25, 0.09, 2e-3, 0.05
CLIMBER = step_climber(torque=AMPLE)
MARGIN = 0.96  # part of the friction that a plan may use
RAMP, STEP = ramp(np.pi / 4, HEIGHT), step(HEIGHT)
FIXED = Control("fixed")
EXACT, EXACT_95 = Control(directions="contact"), Control(directions="contact", share=0.95)
SENSED = Control()
PRINTED_6_8 = Control("printed_6_8", directions="contact")
PRINTED_14 = Control("printed_14", directions="contact")
PRINTED_16 = Control("printed_16", directions="contact")


class Grip(NamedTuple):
    """Friction and contacts in the lab's numbers [1, 1, N/m, s/m, m/s, m/s]."""

    static: float = 0.4
    dynamic: float = 0.3
    stiffness: float = 1.5e5
    damping: float = 10.0
    creep: float = 5e-4
    stribeck: float = 0.01


TABLE_I, TWICE = Grip(), Grip(0.9, 0.675)


class Climb(NamedTuple):
    """A motion and what it is of."""

    climber: Climber
    profile: Profile
    run: Trajectory

    @property
    def metrics(self) -> Metrics:
        """Averages over the climb."""
        return metrics(self.run, self.climber, self.profile)

    @property
    def imbalance(self) -> float:
        """Largest error of the energy's balance [J]."""
        run = self.run
        given = run["work"] - run["lost_energy"]
        return float(np.abs(run["energy"] - run["energy"][0] - given).max())


def foot(profile):
    """Place of the front axle just before the ramp or step. [m]."""
    radius = step_climber().radius
    edge, top = profile.summit
    angle = np.arctan2(top, edge)
    return -AHEAD - radius * np.tan(angle / 2)


def gripped(climber, profile, control, grip, **options):
    """The vehicle with the stiffness of its contacts, and its model."""
    climber = replace(climber, stiffness=grip.stiffness)
    ratio = grip.damping * np.sqrt(GRAVITY * climber.static_depth) / 2
    law = Compliant(ratio, grip.creep, grip.dynamic / grip.static, grip.stribeck)
    return climber, climbing(climber, profile, control, law, friction=grip.static, **options)


def begin(climber, profile, control, grip, speed=SPEED, **options):
    """The model, and its start rolling towards the climb."""
    climber, dae = gripped(climber, profile, control, grip, **options)
    return dae, settle(dae, **standing(climber, foot(profile), speed))


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
    climber=None,
) -> Climb:
    climber = climber or step_climber(torque=torque)
    dae, start = begin(climber, profile, control, contact, speed)
    t = np.arange(round(until / every) + 1) * every
    run = simulate(
        dae, start, dae.inputs(speed=speed), t, options=SolverOptions(tolerance=tolerance)
    )
    return Climb(climber, profile, run)


@lru_cache(maxsize=32)
def planned(profile, mu=None, speed=SPEED, climber=CLIMBER) -> TrackedPlan:
    """The climb of least slip within a friction, or that of least friction, all legs in one."""
    cost = "friction" if mu is None else "slip"
    ways, found = legs(climber, profile), []
    for leg in ways:
        plan = program(climber, profile, leg, cost, mu=mu, speed=speed, halt=leg is not ways[-1])
        found.append((plan, solve_nlp(plan.nlp).unknowns))
    return tracked_plan(found)


def tracking(profile, mu, speed=SPEED) -> Tracking:
    """A plan for a little less friction than there is."""
    return Tracking(planned(profile, round(MARGIN * mu, 6), speed))
