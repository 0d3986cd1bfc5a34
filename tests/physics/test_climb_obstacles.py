"""Tests of obstacles: distances to convex solids, endings of climbs, and random climbs."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.commands import refuses
from slipfree.catalog import AXLES, step_climber
from slipfree.core.errors import ModelError
from slipfree.core.records import Label
from slipfree.core.trajectory import Column, Outcome, Stop, Trajectory
from slipfree.models.samples import obstacle_ending
from slipfree.terrain.solids import Profile, Solid, flat, kerb, placed, ramp, stairs, step

SQUARE = Solid(((0, 0), (1, 0), (1, 1), (0, 1)))
KITE = Solid(((0.0, -0.3), (0.8, 0.1), (0.5, 0.9), (-0.2, 0.6), (-0.4, 0.1)))


def symbolic(solid):
    place = ca.SX.sym("place", 2)
    return ca.Function("gap", [place], list(solid.gap(place[0], place[1])))


def nearest(solid, place):
    """Distance to the boundary, by projection on every face."""
    corners = np.array(solid.points)
    ends = np.roll(corners, -1, axis=0)
    part = ((place - corners) * (ends - corners)).sum(1) / ((ends - corners) ** 2).sum(1)
    feet = corners + np.clip(part, 0, 1)[:, None] * (ends - corners)
    k = np.linalg.norm(place - feet, axis=1).argmin()
    return np.linalg.norm(place - feet[k]), feet[k]


def test_the_distance_is_that_to_the_nearest_point():
    rng = np.random.default_rng(0)
    for solid in (SQUARE, KITE):
        function = symbolic(solid)
        for place in rng.uniform(-1.5, 2.5, (300, 2)):
            distance, normal = (np.array(out).ravel() for out in function(place))
            away, foot = nearest(solid, place)
            assert_allclose(np.abs(distance[0]), away, atol=1e-13)
            assert_allclose(place - distance * normal, foot, atol=1e-12)
            assert_allclose(np.linalg.norm(normal), 1, atol=1e-12)
            inside = solid.normals @ (place - np.array(solid.points)).T
            assert (distance[0] < 0) == (np.diag(inside) < 0).all()


def test_the_normal_is_the_gradient_and_continuous():
    place = ca.SX.sym("place", 2)
    distance, normal = KITE.gap(place[0], place[1])
    slope = ca.Function("slope", [place], [ca.gradient(distance, place), normal])
    angle = np.linspace(0, 2 * np.pi, 4001)
    around = np.array([0.2, 0.3]) + 1.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    gradient, normals = (np.array(out) for out in slope.map(angle.size)(around.T))
    assert_allclose(gradient, normals, atol=1e-10)
    assert np.linalg.norm(np.diff(normals, axis=1), axis=0).max() < 3 * 1.5 * np.diff(angle)[0]


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (((0, 0), (1, 0)), "three or more"),
        (((0, 0), (1, 0), (np.nan, 1)), "from -10000 to 10000 m"),
        (((0, 0), (1, 0), (1, 0), (0, 1)), "points 1 and 2 coincide"),
        (((0, 0), (1, 0), (2, 0), (0, 1)), "point 1, .* is not a corner"),
        (((0, 0), (1, 0), (0.2, 0.2), (0, 1)), "not convex at point 2"),
        (((0, 0), (1, 1), (1, 0), (0, 1)), "not convex"),
        ([(np.cos(0.8 * np.pi * k), np.sin(0.8 * np.pi * k)) for k in range(5)], "cross"),
    ],
)
def test_what_is_no_convex_polygon_is_refused(points, words):
    refuses(ModelError, words, Solid, tuple(points))


def test_corners_are_stored_counter_clockwise():
    assert Solid(SQUARE.points[::-1]).points == SQUARE.points
    assert_allclose(SQUARE.normals, [(0, -1), (1, 0), (0, 1), (-1, 0)])


def test_a_wheel_on_the_floor_against_a_step_touches_both():
    found = [solid.distance(-0.066, 0.066) for solid in step(0.09).solids]
    assert_allclose([distance for distance, _ in found], 0.066, atol=1e-15)
    assert_allclose([normal for _, normal in found], [(0, 1), (-1, 0)])


def test_a_wheel_rolls_over_the_edge_of_a_ramp():
    """On the slope, round the corner and on the plateau its center keeps its distance."""
    profile, r = ramp(np.pi / 4, 0.09), 0.066
    slope = np.array([-1, 1]) / np.sqrt(2)
    arc = [np.array([0.09, 0.09]) + r * np.array([-np.sin(a), np.cos(a)]) for a in (0.1, 0.4, 0.7)]
    for place in (np.array([0.05, 0.05]) + r * slope, *arc, np.array([0.3, 0.09 + r])):
        distance, normal = profile.solids[1].distance(*place)
        assert distance == pytest.approx(r, abs=1e-12)
        assert_allclose(place - r * normal, nearest(profile.solids[1], place)[1], atol=1e-12)


def test_makers():
    assert len(flat().solids) == 1
    assert step(0.09).summit == (0, 0.09)
    assert_allclose(ramp(np.pi / 4, 0.09).summit, (0.09, 0.09))
    assert_allclose(ramp(np.pi / 2, 0.09).summit, (0, 0.09), atol=1e-15)
    assert kerb(0.1, 0.5).summit == (0, 0.1)
    assert kerb(0.1, 0.5).end == 0.5
    assert flat().end == np.inf
    flight = stairs(0.15, 0.3, 3)
    assert len(flight.solids) == 4
    assert_allclose(flight.summit, (0.6, 0.45))
    place = 0.3 - 0.066, 0.15 + 0.066
    assert_allclose([solid.distance(*place)[0] for solid in flight.solids[1:3]], 0.066, atol=1e-15)


def test_what_hangs_above_is_no_summit():
    """A ceiling does not stand on the floor; on a pillar it does."""
    ceiling = Solid(((-1, 1), (2, 1), (2, 1.1), (-1, 1.1)))
    assert Profile((*step(0.05).solids, ceiling)).summit == (0, 0.05)
    pillar = Solid(((0.4, -0.1), (0.5, -0.1), (0.5, 1), (0.4, 1)))
    assert Profile((*step(0.05).solids, ceiling, pillar)).summit == (-1, 1.1)
    bump = Solid(((0, -0.1), (0.6, -0.1), (0.6, 0.0), (0.3, 0.05), (0, 0.0)))
    profile = Profile((*flat().solids, bump))
    assert profile.summit == (0.3, 0.05)
    assert profile.end == 0.3
    blocks = [
        Solid(((x, -0.1), (x + 1, -0.1), (x + 1, z), (x, z)))
        for x, z in ((0, 0.05), (1, 0.05 + 1e-7))
    ]
    assert Profile((*flat().solids, *blocks)).summit == (0, 0.05 + 1e-7)


def test_solids_that_meet(rng):
    square = Solid(((0, 0), (1, 0), (1, 1), (0, 1)))
    for angle in rng.uniform(0, 2 * np.pi, 50):
        turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        other = np.array([(1, 0), (1.5, 0.4), (1.5, -0.4)]) @ turned.T + 0.5
        gap = min(float(square.distance(*other[0])[0]), 0.9)
        near = Solid(tuple(map(tuple, other - (gap - 1e-3) * (turned @ [1, 0]))))
        assert square.meets(Solid(tuple(map(tuple, other)))) == (gap < 1e-4)
        assert square.meets(near) == near.meets(square)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: step(0.0), "height"),
        (lambda: kerb(0.1, -1), "length"),
        (lambda: stairs(0.1, 0.3, 0), "count"),
        (lambda: ramp(2.0, 0.1), "angle"),
        (lambda: ramp(1e-3, 0.1), "steeper"),
        (lambda: Profile(()), "none"),
    ],
)
def test_unusable_sizes_are_refused(make, words):
    refuses(ModelError, words, make)


# Endings, of samples computed by hand

N, RADIUS = 401, 0.066  # a sample every 10 ms
T = np.arange(N) * 0.01


def motion(y, z=None, stop=None, touching=True, x=0 * T):
    """The vehicle on the floor, and at a step from 0.5 s on, with its axles at a height z.

    The step is 1 m ahead.
    """
    z = np.full(N, RADIUS) if z is None else z
    columns = {
        **{"x": x, "y": y, "z": z},
        "center_x": np.tile(x[:, None], (1, 3)),
        "center_y": np.tile(y[:, None] - 1.0, (1, 3)),
        "center_z": np.tile(z[:, None], (1, 3)),
        "wheel_rate": np.full((N, 3), 0.1 / RADIUS),
        "solid_load_1": np.where(touching & (T > 0.5), 70.0, 0.0)[:, None] * np.ones(3),
    }
    return Trajectory(T, {k: Column(Label(k, "m", k), v) for k, v in columns.items()}, AXLES, stop)


def ending(*args, **options):
    run = motion(*args, **options)
    return obstacle_ending(run, step_climber(), placed(step(0.09)))


def test_what_comes_up_climbs():
    found = ending(0.25 * T, np.where(T < 2.5, RADIUS, RADIUS + 0.09))
    assert found.name == "climbs"
    assert_allclose(found.t, 2.5)


def test_wheels_on_the_floor_are_not_on_a_low_step():
    """Neither on one that is lower than 0.2 radii."""
    low = placed(step(0.1 * RADIUS))
    assert obstacle_ending(motion(0.1 * T), step_climber(), low).name == "unfinished"
    up = motion(0.1 * T, np.where(T < 2.5, RADIUS, 1.1 * RADIUS))
    found = obstacle_ending(up, step_climber(), low)
    assert (found.name, found.t) == ("climbs", pytest.approx(2.5))


def test_what_gets_no_farther_stalls():
    assert ending(np.minimum(0.1 * T, 0.15)).name == "stalls"
    assert ending(np.minimum(0.1 * T, 0.15) + 0.004 * T).name == "stalls"
    assert ending(0.1 * T).name == "unfinished"


def test_what_slides_at_an_obstacle_moves_along():
    stuck = np.minimum(0.1 * T, 0.15)
    assert ending(stuck, x=0.05 * T).name == "moves along"
    assert ending(stuck, x=0.05 * T, z=RADIUS + 0.01 * T).name == "unfinished"
    assert ending(stuck, x=0.05 * T, touching=False).name == "unfinished"


def test_beside_an_obstacle_it_passes():
    found = ending(0.5 * T)
    assert (found.name, found.t) == ("passes", pytest.approx(2.01))
    assert "crossed the line of the front edge; 0 of 3 wheels had reached" in found.words
    found = ending(0.5 * T, touching=False)
    assert found.name == "passes"
    assert found.words.endswith("no wheel touched an obstacle")
    assert ending(1.5 + 0 * T).name == "stalls"


def test_what_falls_over_tips():
    stop = Stop("rear_upright", 4.0, "the rear body overturns: its tilt: 1.4", Outcome.LIMIT)
    up = 0.25 * T, np.full(N, RADIUS + 0.09)
    assert ending(*up).name == "climbs"
    found = ending(*up, stop=stop)
    assert (found.name, found.t) == ("tips over", 4.0)
    assert "at t = 4 s the rear body overturns" in found.words


def test_a_floor_is_no_obstacle():
    found = ending(0.25 * T, touching=False)
    assert (found.name, found.words) == ("unfinished", "no wheel touched an obstacle")
