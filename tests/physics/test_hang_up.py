"""Hang-up against closed forms: where a belly touches first, and how much of the weight it bears.

A car with a keel, which is a single point, on a ridge between its wheels is a beam on three
springs; a car with a flat belly stands on a crest. Stiffnesses in N/m are the same on the moon.
"""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import brentq

import slipfree as sf
from helpers.dynamics import four_wheels, moved, states
from helpers.rounding import root
from slipfree.vehicle.shapes import Box, Hull

EARTH, MOON, MASS = 9.81, 1.62, 48.0  # [m/s2], [kg]
RADIUS, LENGTH = 0.15, 0.7  # of the wheels; between the axles [m]
CENTER = 0.35, 0.1 * 40 / MASS  # of mass: ahead of the rear axle, above it [m]
AXLE, POINT = MASS * EARTH / 2 / 1e-3, MASS * EARTH / 2e-3  # stiffness of two wheels, a point [N/m]
KEEL, BELLY = 0.02, 0.08  # below the axles [m]


def model_of(shape, heights, gravity=EARTH, make=sf.dynamics, **law):
    """Return a model of a car with a shape; gravity does not change the stiffness of its wheels."""
    vehicle = four_wheels(static_depth=MASS * EARTH / 2 / AXLE)
    vehicle = replace(vehicle, body=replace(vehicle.body, shapes=(shape,)))
    return make(sf.in_gravity(vehicle, gravity), sf.Analytic(heights, mu=0.3), **law)


def at_rest(shape, heights, height, gravity):
    """Return the rest of a car that is dropped from a height of its axles."""
    law = sf.Compliant(body_depth=MASS * gravity / POINT)
    model = model_of(shape, heights, gravity, law=law)
    run = moved(model, states(model, z=height), np.linspace(0, 6, 3), 1e-8)
    assert run["kinetic_energy"][-1] < 1e-12
    return run


def on_ridge(place, rise, gravity):
    """Return the rest of a car on a ridge along it that is ``rise`` above its level keel."""
    keel, top = Hull(((0.0, place, -KEEL),)), RADIUS - KEEL + rise
    height = RADIUS + max(rise, 0) + 1e-3
    return at_rest(keel, lambda x, y: top * ca.exp(-((x / 0.05) ** 2)) + 0 * y, height, gravity)


def onset(place, gravity):
    """Rise at which the keel touches first, negative, since the wheels' springs give way [m]."""
    b, c = place / LENGTH, CENTER[0] / LENGTH
    return -MASS * gravity / AXLE * ((1 - b) * (1 - c) + b * c)


def keel_load(place, rise, gravity):
    """Load of the keel while all wheels touch, of a beam on three springs [N]."""
    b = place / LENGTH
    return (rise - onset(place, gravity)) / (1 / POINT + ((1 - b) ** 2 + b**2) / AXLE)


def rest_loads(place, rise, gravity):
    """Loads of rear axle, front axle and keel by own balances, with the arms of a pitched car."""

    def forces_and_arms(unknowns):
        z, pitch = 1e-3 * unknowns  # from level wheels that just touch
        c, s = np.cos(pitch), np.sin(pitch)
        depths = [-z, -z - LENGTH * s, rise - z - place * s + KEEL * (c - 1)]
        arms = [0, LENGTH * c, place * c + KEEL * s]
        return np.maximum(depths, 0) * [AXLE, AXLE, POINT], arms, CENTER[0] * c - CENTER[1] * s

    def unbalance(unknowns):
        forces, arms, middle = forces_and_arms(unknowns)
        return np.array([forces.sum(), forces @ arms]) / (MASS * gravity) - [1, middle]

    # leaning on the keel and on the axle on the other side of the weight, all a little pressed
    lean, up = 1e3 * max(rise, 0), place < CENTER[0]
    start = (
        [lean * LENGTH / (LENGTH - place), -lean / (LENGTH - place)] if up else [0, lean / place]
    )
    return forces_and_arms(root(unbalance, start - np.array([0.1, 0]))[0])[0]


@pytest.mark.parametrize("gravity", [EARTH, MOON])
@pytest.mark.parametrize("place", [0.2, 0.45])
def test_a_keel_touches_a_ridge_first_where_the_springs_give_way_to_it(place, gravity):
    """Ten micrometres decide."""
    first = onset(place, gravity)
    assert on_ridge(place, first - 1e-5, gravity)["body_load"][-1] == 0
    load = on_ridge(place, first + 1e-5, gravity)["body_load"][-1]
    assert load == pytest.approx(keel_load(place, first + 1e-5, gravity), rel=1e-2)


@pytest.mark.parametrize("gravity", [EARTH, MOON])
@pytest.mark.parametrize(
    ("place", "rise", "lifts"),
    [(0.2, -5e-5, False), (0.45, 1e-5, False), (0.2, 0.02, True), (0.5, 0.03, True)],
)
def test_a_keel_on_a_ridge_bears_its_share(place, rise, lifts, gravity):
    """Loads by statics; after an axle has lifted off, the lever rule holds on earth and moon."""
    run, weight = on_ridge(place, rise, gravity), MASS * gravity
    rear, front, keel = rest_loads(place, rise, gravity)
    loads = run["force_normal"][-1]
    assert run["body_load"][-1] == pytest.approx(keel, abs=1e-5 * weight)
    assert [loads[2:].sum(), loads[:2].sum()] == pytest.approx([rear, front], abs=1e-5 * weight)
    assert (min(rear, front) == 0) == lifts
    if lifts:  # of a car that is almost level
        axle = 0 if place > CENTER[0] else LENGTH
        assert keel / weight == pytest.approx((CENTER[0] - axle) / (place - axle), rel=0.02)
    else:
        assert keel == pytest.approx(keel_load(place, rise, gravity), rel=1e-3)


def crest(radius):
    """Return the heights of a crest along x, a cylinder whose top is at zero."""
    return lambda x, y: ca.sqrt(radius**2 - (y - CENTER[0]) ** 2) - radius + 0 * x


FLAT_BELLY = Box((0.4, 0.5, 0.2), at=(0.0, CENTER[0], 0.1 - BELLY))
# (radius + RADIUS)^2 = (LENGTH / 2)^2 + (radius + BELLY)^2, if axles and belly touch the crest
LEAST = ((LENGTH / 2) ** 2 + BELLY**2 - RADIUS**2) / (2 * (RADIUS - BELLY))  # radius [m]


def crest_loads(z, radius):
    """Loads of wheels and belly with the axles at a height, three points of the belly on top."""
    away = np.hypot(LENGTH / 2, z + radius)
    wheels = 2 * AXLE * max(radius + RADIUS - away, 0) * (z + radius) / away
    return np.array([wheels, 3 * POINT * max(BELLY - z, 0)])


def crest_height(radius, gravity, bearing):
    """Height of the axles over a crest at rest, with or without the load of the belly [m]."""
    weight = MASS * gravity
    return brentq(lambda z: crest_loads(z, radius) @ [1, bearing] - weight, 0, RADIUS, xtol=1e-12)


@pytest.mark.parametrize("gravity", [EARTH, MOON])
@pytest.mark.parametrize(
    ("make", "share"),
    [
        (sf.dynamics, 2e-4),
        (sf.direct_kinematics, 1e-2),
    ],  # the law of the load is smoother in the second
)
def test_the_breakover_of_a_crest_has_its_closed_form(make, share, gravity):
    """The clearance over the top up to a share of the depth, and the radius at which it is zero."""
    first = brentq(lambda r: crest_height(r, gravity, False) - BELLY, LEAST, 2 * LEAST)
    depth = MASS * gravity / AXLE / 2
    for radius in (first + 1e-4, 1.0, 3.0):
        start = sf.settle(model_of(FLAT_BELLY, crest(radius), gravity, make))
        clearance = crest_height(radius, gravity, False) - BELLY
        assert start["clearance_body"][0] == pytest.approx(clearance, abs=share * depth)
    assert first == pytest.approx(LEAST, rel=0.02)
    with pytest.raises(sf.ModelError, match="the platform touches the ground"):
        sf.settle(model_of(FLAT_BELLY, crest(first - 1e-4), gravity, make))


@pytest.mark.parametrize("gravity", [EARTH, MOON])
@pytest.mark.parametrize("beyond", [-1e-3, 0.0, 0.05])
def test_a_belly_on_a_crest_bears_its_share(beyond, gravity):
    """The wheels push obliquely from both sides."""
    radius = LEAST + beyond
    run, z = at_rest(FLAT_BELLY, crest(radius), 0.1, gravity), crest_height(radius, gravity, True)
    load = crest_loads(z, radius)[1]
    assert run["z"][-1] == pytest.approx(z, abs=1e-7)
    assert run["body_load"][-1] == pytest.approx(load, abs=1e-4 * MASS * gravity)
    assert (load > 0) == (beyond < 0.01)
