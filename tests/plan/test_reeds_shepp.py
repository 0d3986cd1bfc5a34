"""Tests of paths with cusps: lengths in closed form, end poses, symmetries, and inputs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from slipfree import Analytic, catalog, direct_kinematics, settle, simulate
from slipfree.control.path_following import arc_inputs, turning_axis_offset
from slipfree.core.errors import ModelError
from slipfree.routing.reeds_shepp import HEADINGS, reeds_shepp
from slipfree.solve.sampling import input_samples
from slipfree.terrain.base import Terrain

RADIUS = 0.8
POSES = np.random.default_rng(5).uniform(-3, 3, (30, 3))


def end_of(pose, arcs):
    """Return the pose at the end of arcs, in closed form."""
    place, heading = complex(*pose[:2]), pose[2]
    for length, curvature in arcs:
        turn = length * curvature
        chord = length * np.sinc(turn / 2 / np.pi)
        place += chord * 1j * np.exp(1j * (heading + turn / 2))
        heading += turn
    return place.real, place.imag, heading


def length_of(arcs):
    return sum(abs(arc.length) for arc in arcs)


def test_single_arcs():
    for goal, arcs in (
        ((0.0, -3.0, 0.0), [(-3.0, 0.0)]),
        ((RADIUS, RADIUS, -math.pi / 2), [(math.pi / 2 * RADIUS, -1 / RADIUS)]),
        ((RADIUS, -RADIUS, math.pi / 2), [(-math.pi / 2 * RADIUS, -1 / RADIUS)]),
        ((0.0, 0.0, 0.0), []),
    ):
        found = reeds_shepp((0.0, 0.0, 0.0), goal, RADIUS)
        assert np.reshape(found, (-1, 2)) == pytest.approx(np.reshape(arcs, (-1, 2)), abs=1e-9)


def test_paths_end_at_the_goal_and_are_reversible():
    for start, goal, other in zip(POSES, POSES[1:], POSES[2:], strict=False):
        arcs = reeds_shepp(start, goal, RADIUS)
        x, y, heading = end_of(start, arcs)
        assert (x, y) == pytest.approx(goal[:2], abs=1e-9)
        assert math.sin((heading - goal[2]) / 2) == pytest.approx(0, abs=1e-9)
        assert {abs(arc.curvature) for arc in arcs} <= {0.0, 1 / RADIUS}
        assert length_of(arcs) >= math.dist(start[:2], goal[:2]) - 1e-9
        assert length_of(reeds_shepp(goal, start, RADIUS)) == pytest.approx(length_of(arcs))
        mirrored = (start * [-1, 1, -1], goal * [-1, 1, -1])
        assert length_of(reeds_shepp(*mirrored, RADIUS)) == pytest.approx(length_of(arcs))
        detour = length_of(reeds_shepp(start, other, RADIUS))
        detour += length_of(reeds_shepp(other, goal, RADIUS))
        assert length_of(arcs) <= detour + 1e-9


@pytest.mark.parametrize("sideways", [0.01, 0.3, 1.6])
def test_parking_takes_four_arcs(sideways):
    """Arcs a, b, b, a: 2 sin a = sin(a + b), 4 cos a - 2 - 2 cos(a + b) radii sideways."""
    shift = 2 + sideways / RADIUS
    first = math.acos((shift**2 + 12) / (8 * shift))
    both = math.acos(2 * math.cos(first) - shift / 2)
    arcs = reeds_shepp((0.0, 0.0, 0.0), (sideways, 0.0, 0.0), RADIUS)
    assert [abs(arc.length) / RADIUS for arc in arcs] == pytest.approx(
        [first, both - first, both - first, first]
    )
    assert [arc.length > 0 for arc in arcs] == [True, False, False, True]


def test_free_heading_takes_the_shortest_path():
    start, goal = (0.0, 0.0, 0.3), (1.0, -0.5)
    free = reeds_shepp(start, (*goal, None), RADIUS)
    assert end_of(start, free)[:2] == pytest.approx(goal, abs=1e-9)
    headings = start[2] + 2 * np.pi * np.arange(HEADINGS) / HEADINGS
    lengths = [length_of(reeds_shepp(start, (*goal, each), RADIUS)) for each in headings]
    assert length_of(free) == pytest.approx(min(lengths))
    with pytest.raises(ModelError, match="positive, finite 'turning_radius'"):
        reeds_shepp((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0)


def driven(vehicle, arcs, speed=0.5):
    """Return the motion of a vehicle along arcs on a plane."""
    ground: Terrain = Analytic(lambda x, y: 0 * x * y)
    dae = direct_kinematics(vehicle, ground)
    start = settle(dae)
    values = {c.name: 0.0 for c in vehicle.of("commanded")}
    pieces, duration = arc_inputs(dae, arcs, values, speed=speed)
    t, rates = input_samples(duration, 0.2, pieces)
    return simulate(dae, start, dae.inputs(**rates), t), duration


@pytest.mark.parametrize("heading", [0.4, None])
def test_steered_vehicle_drives_the_arcs_without_slip(heading):
    vehicle = catalog.three_wheeler(axle="fixed")
    ahead = turning_axis_offset(vehicle)
    assert ahead == pytest.approx(0.5)
    arcs = reeds_shepp((0.0, 0.0, 0.0), (1.0, -1.0, heading), 1.2, ahead)
    assert min(arc.length for arc in arcs) < 0 < max(arc.length for arc in arcs)
    run, duration = driven(vehicle, arcs)
    assert (run["x"][-1], run["y"][-1]) == pytest.approx((1.0, -1.0), abs=1e-6)
    if heading is not None:
        assert run["heading"][-1] == pytest.approx(heading, abs=1e-6)
    assert np.abs(run["slip_across"]).max() < 1e-6
    assert duration > length_of(arcs) / 0.5  # and the time to steer


def test_skid_steer_vehicle_drives_the_arcs_roughly():
    vehicle = catalog.rigid_skid_steer()
    run, _ = driven(vehicle, [(1.0, 0.8), (-0.5, -0.8)])
    x, y, heading = end_of((0.0, 0.0, 0.0), [(1.0, 0.8), (-0.5, -0.8)])
    assert (run["x"][-1], run["y"][-1]) == pytest.approx((x, y), abs=0.05)
    assert run["heading"][-1] == pytest.approx(heading, abs=0.05)
