"""Tests of a ramp that friction does not allow to climb straight: errors, and the plan.

The ramp, 20 degrees between two terraces, and its reference values are those of an independent
study, a path search with its own equations of contact and equilibrium: straight up, the required
friction is 1.123 times that of the ground with the best distribution of forces; the shortest path
that it found within 95 % is 13.13 m long. Lengths are those of the path of the axle's middle.
"""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import slipfree as sf
from helpers.cases import PROBLEMS
from slipfree.catalog import three_wheeler
from slipfree.models.friction_feasibility import best_utilisation
from slipfree.plan.plan import Plan

pytestmark = pytest.mark.slow
FILE = PROBLEMS / "plan_climb_ramp.toml"
SLOPE, MU, MOST, CREEP = np.radians(20), 0.5, 0.95, 1e-4
AXLE = 0.5  # from the middle of the axle to the platform's centre [m]
STEER = np.arctan(1.5 * 0.6)  # curvature of 0.6 /m of the way of the axle's middle
VEHICLE = three_wheeler(axle="fixed", center_of_mass=(0.0, 0.2, 0.0))
START, GOAL = {"x": 0.0, "y": -2.0 + AXLE}, {"x": 0.0, "y": 10.0 + AXLE, "heading": 0.0}
DURATION = 24.0


def terraces(x, y):
    """Two terraces, a ramp of 20 degrees between them, and small waves."""
    edges = (ca.log(1 + ca.exp((y - edge) / 0.4)) for edge in (2.0, 6.0))
    return np.tan(SLOPE) * 0.4 * (next(edges) - next(edges)) + 0.01 * ca.sin(
        2.1 * x + 0.4
    ) * ca.cos(1.9 * y)


GROUND = sf.Analytic(terraces, mu=MU)


@cache
def model(of=sf.direct_kinematics):
    return of(VEHICLE, GROUND)


def bow(aside):
    """Return a way from start to goal that lies to the right in its middle."""
    part, start, end = np.linspace(0, 1, 13), START["y"], GOAL["y"]
    return sf.Path(
        np.stack([aside * np.sin(np.pi * part) ** 2, start + (end - start) * part], axis=1)
    )


@cache
def climbed() -> Plan:
    """Return the better plan of those from a bow to the right and from the straight way."""
    dae = model()
    start, t = sf.settle(dae, **START), np.linspace(0, DURATION, 61)
    ways = (bow(2.0), bow(0.0))
    guesses = [
        sf.simulate(dae, start, sf.follow(dae, way, speed=way.length / DURATION), t) for way in ways
    ]
    return sf.plan(
        dae,
        start,
        guesses,
        goal=GOAL,
        costs={"effort": 1.0, "slip": 1e4},
        duration=DURATION,
        smooth=0.02,
        limits={"utilisation": (0.0, MOST), "steer": (-STEER, STEER)},
        inputs={"right_rate": (0.0, 4.0), "left_rate": (0.0, 4.0), "steer_rate": (-1.5, 1.5)},
        mesh=sf.Mesh(24, degree=3, accuracy=0.01),
    )


def length(run):
    """Return the length of the way of the axle's middle in plan. [m]."""
    heading = run["heading"]
    x, y = run["x"] + AXLE * np.sin(heading), run["y"] - AXLE * np.cos(heading)
    return np.hypot(np.diff(x), np.diff(y)).sum()


# The straight way


def test_the_straight_way_needs_more_friction_than_there_is():
    places = [sf.settle(model(), x=0.0, y=y) for y in np.linspace(3.0, 6.0, 16)]
    weighted = max(place["utilisation"].max() for place in places)
    best = max(best_utilisation(VEHICLE, GROUND, place)["utilisation_best"][0] for place in places)
    assert_allclose(best, 1.123, atol=2e-3)
    assert 1.05 < best < weighted < best + 0.01


# The plan


def test_the_plan_keeps_within_friction_on_a_short_way():
    found = climbed()
    assert found.success
    assert found.run["utilisation"].max() < MOST + 1e-6
    assert len({stage.words.partition(",")[0] for stage in found.stages}) == 2
    # From the bow alone it is 13.8 m.
    assert 12.0 < length(found.replay) < 13.5
    assert np.degrees(np.abs(found.replay["heading"]).max()) > 35


def test_the_simulation_of_the_plan_keeps_within_friction_and_reaches_the_goal():
    """The utilisation is taken from the forces here."""
    run = climbed().replay
    assert run.stop is None
    used = np.hypot(run["force_along"], run["force_across"]) / (MU * run["force_normal"])
    assert used.max() < MOST + 3e-3
    assert run["force_normal"].min() > 50
    assert_allclose([run[name][-1] for name in GOAL], list(GOAL.values()), atol=1e-3)
    assert np.abs(run["steer"]).max() < STEER + 0.01


def test_friction_holds_the_vehicle_at_every_node_of_the_plan():
    """Standing there under Coulomb friction, it creeps by ``eps U / sqrt(1 - U^2)``."""
    run, dae = climbed().run, model(sf.quasi_statics)
    names = ("x", "y", "heading", "steer")
    held = [sf.settle(dae, **{name: run[name][k] for name in names}) for k in range(run.t.size)]
    used = np.array([place["utilisation"][0] for place in held])
    slip = np.array([np.hypot(place["slip_along"], place["slip_across"])[0] for place in held])
    assert used.max() < 0.96
    assert slip.max() < 4 * CREEP
    assert_allclose(slip, CREEP * used / np.sqrt(1 - used**2), rtol=1e-3)


def test_the_file_plans_its_climb():
    way = "driver.paths=[[[0.0, -1.5], [2.0, 4.5], [0.0, 10.5]]]"
    run = sf.run_problem(
        sf.load_problem(
            FILE, [way, "plan.intervals=20", "plan.accuracy=0.05", "solver.tolerance=1e-6"]
        )
    ).trajectory
    assert run.stop is None
    assert run["utilisation"].max() < MOST + 0.02
    assert_allclose([run["x"][-1], run["y"][-1]], [0.0, 10.5], atol=0.01)
    assert run["x"].max() > 1.5
