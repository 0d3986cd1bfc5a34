"""Tests of slow climbs: configurations, contact forces, and friction demand.

Values with three digits are those of a separate study with its own code, which samples the climb
at fewer points and uses bisection.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import linprog

from helpers.climb_cases import dimensions
from slipfree.climb.contact_path import (
    LEVEL_SLOPE,
    HoldingForces,
    axle_arms,
    equilibrium,
    least_friction,
    least_friction_forces,
    legs,
    sample,
    tangents,
)
from slipfree.core.errors import ModelError
from slipfree.terrain.solids import Profile, Solid, flat, kerb, ramp, stairs, step

RADIUS, LINKS = 0.066, (0.215, 0.255)
SLOPE = np.pi / 4
PROFILES = {"ramp": ramp(SLOPE, 0.09), **{f"{mm} mm": step(mm / 1000) for mm in (30, 50, 90, 128)}}
ORDER = ("front", "middle", "rear")


@cache
def ways(name, joint=0.0, count=201):
    """Return legs and their configurations."""
    climber, profile = dimensions(joint), PROFILES[name]
    found = legs(climber, profile)
    return [
        (leg, sample(climber, profile, leg, np.linspace(0, leg.length, count))) for leg in found
    ]


@cache
def friction(name, joint=0.0):
    return least_friction(dimensions(joint), PROFILES[name], 25)


def places(way, joint):
    return way.q[:, None, :2] + axle_arms(dimensions(joint), way.q)


@pytest.mark.slow
@pytest.mark.parametrize("joint", [0.0, 0.06])
@pytest.mark.parametrize("name", ["ramp", "50 mm", "90 mm"])
def test_wheels_stay_on_the_ground(name, joint):
    """Rims touch the outline of the ground: its nearest point is a radius away."""
    edge, height = PROFILES[name].summit
    corners = np.array([(-0.7, 0), (0, 0), (edge, height), (0.7, height)])
    outline = np.concatenate(
        [a + np.linspace(0, 1, 20001)[:, None] * (b - a) for a, b in pairwise(corners)]
    )
    for _, way in ways(name, joint):
        for center in places(way, joint)[::20].reshape(-1, 2):
            assert abs(np.hypot(*(outline - center).T).min() - RADIUS) < 3e-6


@pytest.mark.parametrize("joint", [0.0, 0.06])
def test_speeds_meet_the_law_of_the_links(joint):
    """Speeds along either link agree; the tilt's rate is that of the axles across the rear one."""
    for _, way in ways("90 mm", joint):
        along = np.arctan2(tangents(way.normals)[..., 1], tangents(way.normals)[..., 0])
        rear, front = way.q[:, 2:].T
        turn = way.first[:, 2]
        v = way.speeds
        assert_allclose(
            v[:, 0] * np.cos(along[:, 0] - rear), v[:, 1] * np.cos(along[:, 1] - rear), atol=1e-9
        )
        assert_allclose(
            LINKS[0] * turn,
            v[:, 1] * np.sin(along[:, 1] - rear) - v[:, 0] * np.sin(along[:, 0] - rear),
            atol=1e-9,
        )
        assert_allclose(
            v[:, 2] * np.cos(along[:, 2] - front),
            v[:, 1] * np.cos(along[:, 1] - front) + joint * turn * np.sin(front - rear),
            atol=1e-9,
        )
        assert_allclose((v**2).mean(axis=1), 1, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("joint", [0.0, 0.06])
@pytest.mark.parametrize("name", ["ramp", "90 mm"])
def test_derivatives_along_the_way(name, joint):
    climber, profile, small = dimensions(joint), PROFILES[name], 1e-5
    for leg in legs(climber, profile):
        s = np.linspace(0.1, 0.9, 23) * leg.top
        before, here, after = (sample(climber, profile, leg, s + k * small) for k in (-1, 0, 1))
        smooth = np.abs(after.second - before.second).max(axis=1) < 0.5  # not where arcs begin
        assert smooth.sum() > 17
        for slope, value in (("first", "q"), ("second", "first"), ("slopes", "speeds")):
            change = (getattr(after, value) - getattr(before, value)) / (2 * small)
            error = np.abs(change - getattr(here, slope))[smooth].max()
            assert error < 1e-3 * max(1, np.abs(change[smooth]).max())


def test_the_front_wheel_climbs_the_wall_and_the_edge():
    climber, profile = dimensions(), PROFILES["90 mm"]
    leg = legs(climber, profile)[0]
    s = np.linspace(0, leg.top, 2001)
    speed = sample(climber, profile, leg, s).speeds[:, 2]
    way = ((speed[1:] + speed[:-1]) / 2 * np.diff(s)).sum()
    assert_allclose(way, 0.09 - RADIUS + RADIUS * (np.pi / 2 - LEVEL_SLOPE), rtol=1e-5)


@pytest.mark.slow
def test_order_of_the_legs():
    assert [leg.axle for leg, _ in ways("90 mm")] == list(ORDER)
    over = legs(dimensions(), kerb(0.05, 0.3))
    assert [(leg.axle, leg.solids) for leg in over] == [
        ("front", (0, 0, 1)),
        ("middle", (0, 1, 1)),
        ("front", (0, 1, 0)),
        ("rear", (1, 1, 0)),
        ("middle", (1, 0, 0)),
        ("rear", (0, 0, 0)),
    ]
    up = legs(dimensions(), stairs(0.09, 0.3, 2))
    assert [leg.axle for leg in up] == ["front", "middle", "front", "rear", "middle", "rear"]


@pytest.mark.slow
def test_wheels_that_meet_solids_together():
    """Stairs as deep as front and middle axle are apart there, or nearly so; a solid twice."""
    together = stairs(0.09, np.sqrt(LINKS[1] ** 2 - 0.09**2), 2)
    assert [(leg.axle, leg.solids) for leg in legs(dimensions(), together)] == [
        ("front", (0, 0, 1)),
        ("middle", (0, 1, 2)),
        ("rear", (1, 1, 2)),
        ("middle", (1, 2, 2)),
        ("rear", (2, 2, 2)),
    ]
    soon = legs(dimensions(), stairs(0.09, 0.215, 3))
    assert [leg.axle for leg in soon] == [
        "front",
        "front",
        "middle",
        "front",
        "rear",
        "middle",
        "rear",
        "middle",
        "rear",
    ]
    assert min(leg.length for leg in soon) < 0.01
    once, twice = step(0.05), Profile((*step(0.05).solids, step(0.05).solids[1]))
    lengths = [[leg.length for leg in legs(dimensions(), each)] for each in (once, twice)]
    assert_allclose(*lengths, atol=1e-5)


def test_what_cannot_be_climbed_is_refused():
    with pytest.raises(ModelError, match=r"front wheels climbing.*upright.*lower obstacle"):
        legs(dimensions(), step(0.3))
    with pytest.raises(ModelError, match=r"middle wheels climbing.*upright"):
        legs(dimensions(), step(0.26))
    overhang = Solid(((0.2, 0.0), (1.0, 0.0), (1.0, 0.3), (-0.1, 0.3)))
    with pytest.raises(ModelError, match=r"front wheels.*caught between two solids"):
        legs(dimensions(), Profile((*flat().solids, overhang)))
    with pytest.raises(
        ModelError, match="expected an obstacle that begins before the end of the floor"
    ):
        legs(dimensions(), flat())
    slanted = Solid(((-5.0, -1.0), (5.0, -1.0), (5.0, 0.5), (-5.0, 0.0)))
    block = Solid(((0.0, -1.0), (1.0, -1.0), (1.0, 0.5), (0.0, 0.5)))
    with pytest.raises(ModelError, match="expected a level floor"):
        legs(dimensions(), Profile((slanted, block)))


def test_loads_at_rest():
    climber = dimensions()
    leg, way = ways("90 mm")[-1]
    up = sample(climber, PROFILES["90 mm"], leg, way.s[-1:])
    hold = least_friction_forces(*equilibrium(climber, up))
    assert_allclose(hold.normal[0], [51.00, 93.83, 67.07], rtol=2e-3)
    assert_allclose(hold.tangential, 0, atol=1e-9)
    moments = 9.81 * np.array([13.8 * 0.081 / 0.215, 7.8 * 0.2235 / 0.255])
    assert_allclose(hold.normal[0, [0, 2]], moments, rtol=1e-9)
    assert_allclose(hold.normal.sum(), 9.81 * 21.6, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.1, 0.4, 0.8])
def test_a_long_ramp_needs_the_tangent_of_its_angle(angle):
    climber, profile = dimensions(), ramp(angle, 1.2 * np.sin(angle))
    leg = legs(climber, profile)[2]
    assert leg.axle == "rear"
    hold = least_friction_forces(
        *equilibrium(climber, sample(climber, profile, leg, leg.length * np.array([0.1])))
    )
    assert_allclose(hold.mu, np.tan(angle), rtol=1e-7)


def status(matrix, load, mu):
    """Return 0 if forces within friction hold the vehicle, 2 if none do."""
    cones = np.block([[-mu * np.eye(3), np.eye(3)], [-mu * np.eye(3), -np.eye(3)]])
    return linprog(np.zeros(6), cones, np.zeros(6), matrix, load, bounds=(None, None)).status


@pytest.mark.parametrize("name", ["ramp", "90 mm"])
def test_least_friction_is_what_bisection_finds(name):
    climber = dimensions()
    for leg, way in ways(name):
        few = sample(climber, PROFILES[name], leg, way.s[[0, 30, 60]])
        matrix, load = equilibrium(climber, few)
        hold = least_friction_forces(matrix, load)
        assert (np.abs(hold.tangential) <= hold.mu[:, None] * hold.normal + 1e-9).all()
        forces = np.hstack([hold.normal, hold.tangential])
        assert_allclose(np.einsum("nij,nj->ni", matrix, forces), load, atol=1e-8)
        for k, mu in enumerate(hold.mu):
            assert status(matrix[k], load[k], 1.0001 * mu) == 0
            assert status(matrix[k], load[k], 0.9999 * mu) == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "joint", "expected", "within"),
    [
        ("90 mm", 0.0, 0.71, 0.01),
        ("ramp", 0.0, 0.323, 0.005),
        ("50 mm", 0.0, 0.543, 0.002),
        ("90 mm", 0.06, 0.68, 0.01),
        ("90 mm", 0.126, 0.90, 0.01),
    ],
)
def test_friction_that_a_climb_needs(name, joint, expected, within):
    found = friction(name, joint)
    assert abs(found.mu - expected) < within
    assert found.mu == max(demand.mu for demand in found.demands)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "demands"),
    [
        ("50 mm", (0.460, 0.543, 0.540)),
        ("90 mm", (0.579, 0.630, 0.710)),
    ],
)
def test_friction_that_each_axle_needs(name, demands):
    found = friction(name)
    assert tuple(demand.leg.axle for demand in found.demands) == ORDER
    assert_allclose([demand.mu for demand in found.demands], demands, atol=2e-3)


@pytest.mark.slow
def test_worst_configuration_is_found_between_the_samples():
    fine, coarse = (least_friction(dimensions(), PROFILES["90 mm"], n) for n in (161, 15))
    assert_allclose(coarse.mu, fine.mu, rtol=1e-3)
    assert fine.axle == "rear"
    assert fine.demands[2].leg.top / 20 < fine.s < fine.demands[2].leg.top / 2
    assert -0.4 < fine.q[2] - fine.q[3] < 0.6


def test_no_friction_is_enough_where_the_front_body_stands_up():
    found = friction("128 mm", 0.126)
    hold = found.demands[0].hold
    assert np.isinf(found.mu)
    assert found.axle == "front"
    assert np.isnan(hold.normal[np.isinf(hold.mu)]).all()


@pytest.mark.slow
def test_highest_step_for_a_friction():
    """About 29 mm with the friction of the paper's table; 90 mm is out of its reach."""
    assert (
        least_friction(dimensions(), step(0.028)).mu
        < 0.4
        < least_friction(dimensions(), step(0.030)).mu
    )


def test_heavier_vehicles_need_the_same_friction():
    """Friction is a ratio of forces: it does not depend on the scale of the masses."""
    light = dimensions()
    heavy = light._replace(
        **{
            name: getattr(light, name)._replace(mass=7 * getattr(light, name).mass)
            for name in ("rear_body", "front_body")
        }
    )
    leg, way = ways("90 mm")[1]
    holds = [
        least_friction_forces(*equilibrium(each, sample(each, PROFILES["90 mm"], leg, way.s[::40])))
        for each in (light, heavy)
    ]
    assert isinstance(holds[0], HoldingForces)
    assert_allclose(holds[1].mu, holds[0].mu, rtol=1e-7)


@pytest.mark.slow
def test_wheels_that_nearly_jam_are_not_given_up():
    """Newton's iteration alone takes hundreds of rounds here; the LP's answer is bisected."""
    plain = dimensions(joint=0.097)
    climber = plain._replace(radius=0.068, rear_body=plain.rear_body._replace(ahead=-0.199))
    found = least_friction(climber, step(0.098), 15)
    worst = max(found.demands, key=lambda each: each.mu)
    k = int(worst.hold.mu.argmax())
    matrix, load = equilibrium(climber, sample(climber, step(0.098), worst.leg, worst.s[k : k + 1]))
    weight = load[0] / np.abs(load[0]).max()
    assert status(matrix[0], weight, found.mu * (1 + 1e-6)) == 0
    assert status(matrix[0], weight, found.mu * (1 - 1e-4)) == 2
