"""Random climbs over steps, kerbs, stairs and ramps, by index, and how they end.

Climbs come in groups with the same vehicle and obstacle, so that one model serves a group: its
ground has lanes of different friction across the obstacle.
"""

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import casadi as ca
import numpy as np

import slipfree as sf
from helpers.random_dynamics import VEHICLES as DRIVEN
from helpers.random_dynamics import ending as ending_of
from slipfree.core.trajectory import joined
from slipfree.models.samples import ObstacleEnding, obstacle_ending
from slipfree.terrain.solids import Profile, kerb, placed, ramp, stairs, step

VEHICLES = (*DRIVEN, "seven_wheels")
OBSTACLES = ("step", "kerb", "stairs", "ramp")
GROUP = 5  # climbs with the same vehicle and obstacle
LANE = 10.0  # width of a lane of constant friction [m]
FRICTIONS = np.linspace(0.2, 1.2, 11)  # of the lanes
TOLERANCE = 1e-5
SAMPLES = 41
LEGS = 6  # of a drive at most: a vehicle that has not ended by name drives on
CLEARANCE = 0.2  # of the first wheel from the obstacle at the start [radii]


@dataclass(frozen=True)
class World:
    """A vehicle, an obstacle that rises along y, and its half-width [m]."""

    words: str
    vehicle: sf.Vehicle
    profile: Profile
    half_width: float

    @property
    def radius(self) -> float:
        """Largest radius of the wheels [m]."""
        return max(wheel.radius for wheel in self.vehicle.wheels)


@dataclass(frozen=True)
class Climb:
    """A climb in a world: lane, speed [m/s], heading [rad] and leg [lengths along y]."""

    words: str
    group: int
    lane: int
    speed: float
    heading: float
    leg: float


def world(group: int) -> World:
    """Return the world of a group of climbs."""
    rng = np.random.default_rng([24, group])
    name, kind = VEHICLES[group % len(VEHICLES)], str(rng.choice(OBSTACLES))
    masses = {"wheel_mass": 0.4} if name == "seven_wheels" else {}
    vehicle = getattr(sf.catalog, name)(**masses)
    radius = min(wheel.radius for wheel in vehicle.wheels)
    height = radius * float(rng.uniform(0.2, 1.6))
    profile = {
        "step": lambda: step(height),
        "kerb": lambda: kerb(height, radius * float(rng.uniform(0.5, 6))),
        "stairs": lambda: stairs(height / 2, radius * float(rng.uniform(1, 5)), 2),
        "ramp": lambda: ramp(float(rng.uniform(0.2, 1.4)), height),
    }[kind]()
    half_width = float(rng.choice([np.inf, radius * rng.uniform(1, 8)], p=[0.7, 0.3]))
    return World(f"{name}, {kind} of {height:.2g} m", vehicle, profile, half_width)


def draw(index: int) -> Climb:
    """Return the climb of an index."""
    group, rng = index // GROUP, np.random.default_rng([25, index])
    its = world(group)
    speed, heading = float(np.exp(rng.uniform(np.log(0.1), np.log(1.5)))), rng.uniform(-1.2, 1.2)
    # a narrow obstacle is in one lane
    lanes = FRICTIONS.size if its.half_width == np.inf else 1
    lane = int(rng.integers(lanes)) + (0 if lanes > 1 else group % FRICTIONS.size)
    words = f"{index}: {its.words}, {heading:.2f} rad, mu {FRICTIONS[lane]:.1f}, {speed:.2g} m/s"
    return Climb(words, group, lane, speed, float(heading), float(rng.uniform(1.0, 2.0)))


@lru_cache(maxsize=2)
def model(group: int) -> tuple[sf.Dae, sf.Solids]:
    """Return the model of a group, and its ground; the obstacle begins at y = 0."""
    its = world(group)

    def mu(x: Any, _: Any) -> Any:
        return FRICTIONS[0] + (FRICTIONS[1] - FRICTIONS[0]) * ca.floor(x / LANE)

    x = LANE * (group % FRICTIONS.size + 0.5)  # of narrow obstacles
    level = sf.Analytic(lambda x, y: 0 * (x + y), mu=mu)
    ground = sf.Solids(level, placed(its.profile, x=x, half_width=its.half_width))
    return sf.dynamics(its.vehicle, ground), ground


@lru_cache(maxsize=len(VEHICLES))
def level_model(group: int) -> sf.Dae:
    """Return the model of a group's vehicle on level ground."""
    return sf.dynamics(world(group).vehicle, sf.Analytic(lambda x, y: 0 * (x + y), mu=1.0))


def start(case: Climb) -> sf.Trajectory:
    """Return the vehicle at rest before the obstacle."""
    its, level = world(case.group), level_model(case.group % len(VEHICLES))
    rest = sf.settle(level, x=0.0, y=0.0, heading=case.heading)
    y = -rest["center_y"].max() - (1 + CLEARANCE) * its.radius
    shifts = {"x": LANE * (case.lane + 0.5), "y": y}
    moved = {
        name: rest.columns[name]._replace(values=rest[name] + shift)
        for name, shift in shifts.items()
    }
    return replace(rest, columns={**rest.columns, **moved})


def run(case: Climb, tolerance: float = TOLERANCE) -> sf.Trajectory:
    """Return the motion of a climb, from rest at the rates of its speed, until it has an ending."""
    dae, _ = model(case.group)
    rates = {label.full: 0.0 for part in dae.labels.u for label in part}
    for wheel in world(case.group).vehicle.wheels:
        if wheel.driven and wheel.axle == "x":
            rates[f"{wheel.name}_rate"] = case.speed / wheel.radius
    first = start(case)
    length = np.ptp(first["center_y"]) + 2 * world(case.group).radius
    duration = case.leg * length / np.cos(case.heading) / case.speed
    t, options = np.linspace(0, duration, SAMPLES), sf.SolverOptions(tolerance)
    motion = sf.simulate(dae, first, dae.inputs(**rates), t, options=options)
    for k in range(1, LEGS):
        if motion.stop is not None or over_obstacle(case, motion).name != "unfinished":
            break
        more = sf.simulate(dae, motion, dae.inputs(**rates), t + k * duration, options=options)
        motion = joined(motion, more.part(slice(1, None), more.stop))
    return motion


def over_obstacle(case: Climb, motion: sf.Trajectory) -> ObstacleEnding:
    """Return the ending of a motion by `obstacle_ending`."""
    found = obstacle_ending(motion, world(case.group).vehicle, model(case.group)[1].prisms)
    assert found is not None
    return found


def told(case: Climb, motion: sf.Trajectory) -> tuple[str, str]:
    """Return kind and words of an ending: as by `obstacle_ending`, or at another limit."""
    found = over_obstacle(case, motion)
    is_limit = motion.stop is not None and found.name == "unfinished"
    return motion.outcome.name.lower() if is_limit else str(found.name), found.words


ending = partial(ending_of, run=run, told=told, tolerance=TOLERANCE)  # of a climb
