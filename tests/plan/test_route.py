"""Tests of traversability, routes and regions to keep out of, and of paths with cusps."""

import math
import re
import subprocess
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from matplotlib.path import Path as Outline
from numpy.testing import assert_allclose

import slipfree as sf
from helpers.cases import box
from helpers.commands import refuses
from slipfree.catalog import three_wheeler
from slipfree.control.path_following import arc_inputs, turning_axis_offset
from slipfree.plan.guess import HEADINGS, reeds_shepp
from slipfree.routing import search as search
from slipfree.routing.search import (
    SLIDING,
    homotopy_class,
    obstacle_points,
    route,
    routes,
    separation_words,
    unheld_words,
    unreachable,
)
from slipfree.routing.traversability import STEEP, blocking_reasons, free_space, traversability
from slipfree.solve.sampling import input_samples
from slipfree.system import codegen_cache
from slipfree.terrain.base import Terrain
from slipfree.terrain.synthetic import blank, craters

ROVER = three_wheeler(axle="fixed")  # half width 1.05 m, half length 1.05 m, reach 1.42 m
SMALL = three_wheeler(axle="fixed", half_track=0.3, wheelbase=0.5, r1=0.02, r2=0.08)
REACH = math.hypot(1.0, 0.5) + 0.3
UTM = (400_000.0, 5_500_000.0)


def corridor(width=2.0):
    """A right-angled corridor for the small rover, its walls in keep-out regions."""
    low, high = 8.0, 8.0 + width
    walls = [
        box(0, high + 0.5, low - 0.5, low),
        box(high, high + 0.5, low, 20),
        box(0, low, high, high + 0.5),
        box(low - 0.5, low, high, 20),
    ]
    terrain = sf.Bicubic(blank((0, 20), (0, 20), 0.1))
    return free_space(terrain, SMALL, keep_out=walls, spacing=0.1), low + width / 2


def plain(size=20, spacing=0.5, **options):
    """Layers of level ground."""
    return free_space(sf.Bicubic(blank((0, size), (0, size), spacing)), ROVER, **options)


def length(points):
    return np.linalg.norm(np.diff(points, axis=0), axis=1).sum()


def driven(points):
    """Return places along the path through the points, and their curvature."""
    path = sf.Path(points)
    place = path.at(np.linspace(0, path.length, 2000))
    return np.stack([place.x, place.y], axis=1), place.curvature


def costs_at(layers, places):
    i = np.rint((places[:, 0] - layers.x[0]) / layers.spacing[0]).astype(int)
    j = np.rint((places[:, 1] - layers.y[0]) / layers.spacing[1]).astype(int)
    return layers.least_cost[i, j]


# Layers


def slope_of(degrees, vehicle, **options):
    """Return the map of a vehicle on a plane that rises to the north, and a node inside."""
    grid, rise = blank((0, 4), (0, 4), 0.5), math.tan(math.radians(degrees))
    terrain = sf.Bicubic(sf.Grid(grid.x, grid.y, rise * grid.y[None, :] + grid.z), **options)
    layers = traversability(terrain, vehicle)
    return terrain, layers, (layers.x.size // 2, layers.y.size // 2)


def test_costs_are_those_of_poses():
    """On a plane they follow from the pose of settle at each heading."""
    terrain, layers, at = slope_of(10, ROVER, mu=0.6)
    model = sf.direct_kinematics(ROVER, terrain)
    for k in (0, 3, 6):
        pose = sf.settle(model, x=layers.x[at[0]], y=layers.y[at[1]], heading=layers.heading[k])
        margin, used = pose["tip_over_margin"][0].min(), pose["utilisation"][0].max()
        tilt = math.acos(math.cos(pose["roll"][0]) * math.cos(pose["pitch"][0]))
        expected = 1 + 4 * (tilt / STEEP) ** 2 + 4 * used**2 + 4 * (tilt / (tilt + margin)) ** 2
        assert used < 1
        assert layers.cost[k][at] == pytest.approx(expected, rel=5e-4)


def test_headings_across_a_slope_are_blocked_where_only_they_slide():
    """Across, the front wheel of a tilting three-wheeler needs three times the slope's tangent."""
    _, layers, at = slope_of(15, three_wheeler(), mu=0.5)
    used = layers.poses["utilisation"][2][layers.poses.x.size // 2, layers.poses.y.size // 2]
    assert used == pytest.approx(3 * math.tan(math.radians(15)) / 0.5, rel=1e-5)
    north, west = layers.cost[0][at], layers.cost[2][at]
    assert math.isfinite(north)
    assert math.isinf(west)
    assert layers.least_cost[at] <= north
    assert layers.cost_toward(math.pi)[at] == layers.cost[4][at]
    assert layers.cost_toward(0.1)[at] > north


def test_backwards_the_front_points_the_other_way():
    terrain, ahead, at = slope_of(11, ROVER, mu=0.6)
    back = traversability(terrain, ROVER, backwards=True)
    assert_allclose(back.cost[0][at], ahead.cost[4][at])
    assert abs(back.cost[0][at] - ahead.cost[0][at]) > 0.01


def test_axes_are_a_third_of_the_smaller_half_extent_apart():
    layers = free_space(sf.Bicubic(blank((0, 20), (0, 30), 0.1)), ROVER)
    assert_allclose(layers.spacing, 1.05 / 3, rtol=0.02)
    assert layers.cost.shape == (1, layers.x.size, layers.y.size)
    assert (layers.x[0], layers.x[-1], layers.y[0], layers.y[-1]) == (0, 20, 0, 30)
    assert_allclose(plain(40, 2.0).x, np.arange(0, 41, 2.0))  # a coarse grid keeps its nodes


def test_wheels_stay_on_the_map():
    layers = plain()
    assert_allclose(layers.limits.reach, REACH)
    assert blocking_reasons(layers, 1.0, 10.0) == (
        "1 m from the edge of the map, and wheels reach 1.42 m"
    )
    assert blocking_reasons(layers, -2.1, 10.0) == "2.1 m outside the map"
    assert blocking_reasons(layers, 10.0, 10.0) == ""


@pytest.mark.parametrize("kind", ["formula", "map"])
def test_friction_that_cannot_hold_blocks(kind):
    grid, nodes = blank((0, 12), (0, 8), 0.5), blank((0, 12), (0, 8), 1.0)
    uphill = sf.Grid(grid.x, grid.y, 0.3 * grid.y + grid.z)
    mu = {
        "formula": lambda x, y: ca.if_else(x < 6, 0.1, 0.6) + 0 * y,
        "map": sf.Grid(nodes.x, nodes.y, np.where(nodes.x < 6, 0.1, 0.6)[:, None] + nodes.z),
    }[kind]
    layers = traversability(sf.Bicubic(uphill, mu=mu), ROVER)
    words = blocking_reasons(layers, 3.0, 4.0)
    assert words.startswith("no heading is possible: the vehicle needs at least ")
    assert 2.9 < float(re.search(r"least ([\d.]+) times the friction", words).group(1)) < 6
    assert blocking_reasons(layers, 9.0, 4.0) == ""
    words = r"cannot be at the start \(3, 4\): no heading is possible"
    refuses(sf.ModelError, words, route, layers, (3.0, 4.0), (9.0, 4.0))


def test_keep_out_is_blocked_as_far_as_wheels_reach():
    disc, wall = sf.Region.disc(5.0, 5.0, 1.0), box(12, 14, 10, 14)
    terrain = sf.Bicubic(blank((0, 20), (0, 20), 0.25))
    layers = free_space(terrain, ROVER, keep_out=[disc, wall], spacing=0.25)
    x, y = np.meshgrid(layers.x, layers.y, indexing="ij")
    near = (disc.distance(x, y) < REACH) | (wall.distance(x, y) < REACH)
    edge = np.minimum(np.minimum(x, 20 - x), np.minimum(y, 20 - y)) < REACH
    assert (np.isinf(layers.cost[0]) == (near | edge)).all()
    assert blocking_reasons(layers, 5.25, 5.0) == "inside the keep-out disc at (5, 5) of 1 m radius"
    assert blocking_reasons(layers, 13.0, 9.0) == (
        "1 m from the keep-out polygon of 4 points about (13, 12), and wheels reach 1.42 m"
    )


def test_bad_options_are_refused():
    terrain = sf.Bicubic(blank((0, 20), (0, 20), 0.5))
    for options, message in (
        ({"spacing": 0.0}, "spacing: expected a number > 0, found 0.0"),
        ({"spacing": 11.0}, r"half the smaller side of the map, 10 m, found 11 m"),
    ):
        refuses(sf.ModelError, message, free_space, terrain, ROVER, **options)
    ends, words = ((10.0, 5.0), (15.0, 5.0)), r"turning_radius: expected a (numb|fin)"
    for radius in (-1.0, np.inf):
        refuses(sf.ModelError, words, route, plain(), *ends, turning_radius=radius)
    refuses(sf.ModelError, "count: expected a number >= 1, found 0", routes, plain(), *ends, 0)


# Search and smoothing


def test_grid_search_is_at_most_2_8_percent_long():
    layers = plain(spacing=0.5)._replace(cost=np.ones((1, 41, 41)))
    for angle in np.linspace(0, np.pi / 2, 7):
        i, j = round(40 * math.cos(angle)), round(40 * math.sin(angle))
        ends = np.array([[layers.x[0], layers.y[0]], [layers.x[i], layers.y[j]]])
        assert 1 - 1e-6 <= length(search._search(layers, *ends)) / length(ends) <= 1.028


@pytest.mark.parametrize("angle", [0.0, 1.1])
@pytest.mark.parametrize("origin", [(0.0, 0.0), UTM])
def test_straight_on_flat_ground(angle, origin):
    x, y = origin
    layers = free_space(sf.Bicubic(blank((x, x + 40), (y, y + 40), 0.5)), ROVER)
    start = (x + 20 - 15.03 * math.cos(angle), y + 20 - 15.01 * math.sin(angle))
    goal = (x + 20 + 14.0 * math.cos(angle), y + 20 + 14.0 * math.sin(angle))
    points = route(layers, start, goal)
    assert (tuple(points[0]), tuple(points[-1])) == (start, goal)
    assert_allclose(length(points), math.dist(start, goal), rtol=2e-3)
    assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), 1.05, rtol=0.05)
    cell = [(x + 10.0, y + 10.0), (x + 10.1, y + 10.05)]
    assert_allclose(route(layers, *cell), cell)


def test_through_the_gap_of_a_wall():
    x, y = UTM
    terrain = sf.Bicubic(blank((x, x + 40), (y, y + 40), 0.5))
    walls = [box(x, x + 25, y + 19.5, y + 20.5), box(x + 31, x + 40, y + 19.5, y + 20.5)]
    layers = free_space(terrain, ROVER, keep_out=walls)
    points = route(layers, (x + 10, y + 10), (x + 10, y + 30), turning_radius=2.0)
    places, curvature = driven(points)
    assert np.isfinite(costs_at(layers, places)).all()
    assert all((wall.distance(*places.T) > REACH - layers.spacing[0]).all() for wall in walls)
    assert np.abs(curvature).max() <= 1 / 2.0 * 1.02
    # the taut string around the corners of the wall grown by the reach
    taut = 2 * math.hypot(15 + REACH, 9.5) + 1
    assert taut * 0.98 < length(points) < taut * 1.06


def test_around_a_disc():
    layers, radius = plain(40, 0.25, keep_out=[sf.Region.disc(20.0, 20.0, 6.0)]), 6 + REACH
    points = route(layers, (5.0, 20.0), (35.0, 20.0))
    arc = radius * (math.pi - 2 * math.acos(radius / 15))
    assert_allclose(length(points), 2 * math.sqrt(15**2 - radius**2) + arc, rtol=0.02)


@pytest.mark.parametrize(("width", "turning_radius"), [(2.0, 0.0), (2.0, 2.0), (1.2, 8.0)])
def test_a_corridor_is_kept_and_its_bend_rounded_where_there_is_room(width, turning_radius):
    layers, middle = corridor(width)
    ends = (2.0, middle), (middle, 18.0)
    places, curvature = driven(route(layers, *ends, turning_radius=turning_radius))
    assert np.isfinite(costs_at(layers, places)).all()
    if width == 2.0:
        assert np.abs(curvature).max() * turning_radius <= 1.02
    else:
        assert len(routes(layers, *ends, 3)) == 1


def battlement(layers, height):
    """Return the layers with a way one node wide that goes up and down every other node."""
    cost = np.full_like(layers.to_hole, np.inf)
    for k in range(5):
        i = 20 + 4 * k
        cost[i : i + 5, 20] = cost[i + 2 : i + 5, 20 + height] = 1.0
        cost[i + 3, 20] = np.inf
        cost[i + 2, 20 : 21 + height] = cost[i + 4, 20 : 21 + height] = 1.0
    return layers._replace(cost=cost[None])


@pytest.mark.parametrize("half", [1.05, 8.0])
def test_where_there_is_no_room_for_smoothness_the_search_is_followed(half):
    flat = plain(21, 0.35)
    layers = battlement(flat, 4)._replace(limits=flat.limits._replace(half=half))
    start, goal = (layers.x[20], layers.y[20]), (layers.x[40], layers.y[20])
    points = route(layers, start, goal)
    assert np.isfinite(costs_at(layers, search.resample_polyline(points, 0.01))).all()
    along = 0.35 * (20 + 5 * 2 * 4)
    assert 0.9 * along < length(points) <= along * (1 + 1e-9)
    if half > 0.35 * 4:  # even the nodes' distance is a fraction of the vehicle's
        assert_allclose(length(points), along)


@pytest.mark.parametrize("size", [5, 6])
def test_where_way_points_half_an_extent_apart_cut_a_corner_more_are_given(size):
    flat = plain(21, 0.35)
    cost = np.full_like(flat.to_hole, np.inf)
    cost[20 : 20 + size, 20] = cost[20 + size, 20:40] = cost[19 + size : 21 + size, 20] = 1.0
    layers = flat._replace(cost=cost[None])
    start, goal = (layers.x[20], layers.y[20]), (layers.x[20 + size], layers.y[39])
    places, _ = driven(route(layers, start, goal))
    assert np.isfinite(costs_at(layers, places)).all()


@pytest.fixture(scope="module")
def cratered():
    """A ground with craters and its layers for a vehicle."""
    grid = craters(blank((0, 24), (0, 24), 0.25), count=9, diameters=(2, 5), seed=6)
    terrain = sf.Bicubic(grid, mu=0.6)
    return terrain, traversability(terrain, three_wheeler(), spacing=1.0)


def test_a_vehicle_follows_its_route_through_craters(cratered):
    terrain, layers = cratered
    path = sf.Path(route(layers, (4.0, 4.0), (20.0, 20.0), turning_radius=2.0))
    dae = sf.direct_kinematics(three_wheeler(), terrain)
    start = sf.settle(dae, x=4.0, y=4.0, heading=float(path.at(np.zeros(1)).heading[0]))
    law = sf.follow(dae, path, speed=0.5)
    run = sf.simulate(dae, start, law, np.linspace(0, path.length / 0.5, 40))
    assert run.stop is None
    assert math.dist((run["x"][-1], run["y"][-1]), (20.0, 20.0)) < 0.05


def test_the_cost_of_a_route_is_the_integral_of_the_cost_along_it(cratered):
    (found,) = routes(cratered[1], (4.0, 4.0), (20.0, 20.0), 1)
    total = 0.0
    for start, end in pairwise(found.points):
        step = end - start
        k, part = divmod(math.atan2(-step[0], step[1]) / math.tau * 8, 1)
        at = start + step * (np.arange(4000)[:, None] + 0.5) / 4000
        i, j = np.rint(at).astype(int).T  # nodes are 1 m apart
        costs = [cratered[1].cost[int(m) % 8, i, j] for m in (k, k + 1)]
        total += math.hypot(*step) * np.mean((1 - part) * costs[0] + part * costs[1])
    assert total > 1.05 * found.length
    assert found.cost == pytest.approx(total, rel=1e-3)


# Several routes


def discs(*each):
    return plain(40, keep_out=[sf.Region.disc(*disc) for disc in each])


@pytest.mark.parametrize("is_turned", [False, True])
def test_a_disc_makes_two_classes(is_turned):
    y = 20.7
    layers = discs((y, 20.0, 6.0) if is_turned else (20.0, y, 6.0))
    start, goal = ((20.0, 5.0), (20.0, 35.0)) if is_turned else ((5.0, 20.0), (35.0, 20.0))
    found = routes(layers, start, goal, 5, turning_radius=2.0)
    assert len(found) == 2
    assert found[0].cost <= found[1].cost
    sides = {bool(each.points[len(each.points) // 2, int(not is_turned)] > y) for each in found}
    assert sides == {True, False}
    assert_allclose(found[0].points, route(layers, start, goal, turning_radius=2.0))
    for each in found:
        assert_allclose(each.length, length(each.points))
        assert each.cost == pytest.approx(each.length, rel=1e-3)  # flat ground


@pytest.mark.parametrize(
    ("places", "expected"),
    [
        ((), 1),
        (((13.0, 20.5, 3.0), (27.0, 19.5, 3.0)), 4),  # one after the other
        (((20.0, 13.0, 3.0), (20.0, 27.0, 3.0)), 3),  # side by side
        (((20.0, 33.0, 5.0),), 1),  # joined to the border
        (((20.0, 20.0, 14.0),), 1),  # no route around it on the map
    ],
)
def test_classes_are_those_of_the_obstacles(places, expected):
    layers = discs(*places)
    ends = ((3.0, 20.0), (37.0, 20.0)) if expected > 1 else ((3.0, 3.0), (37.0, 3.0))
    found = routes(layers, *ends, 6)
    assert len(found) == expected
    classes = {homotopy_class(each.points, obstacle_points(layers)) for each in found}
    assert len(classes) == expected


def test_a_class_does_not_change_with_the_path_between_obstacles(rng):
    obstacles = np.array([(1.0, 0.0), (2.0, 0.5), (3.0, -0.3)])
    around = np.array([(0.0, 0.0), (1.0, 1.0), (2.0, -1.0), (3.0, 1.0), (4.0, 0.0)])
    assert homotopy_class(around, obstacles) == (1, 3)
    for _ in range(20):
        there = around[:3] + 0.2 * rng.standard_normal((3, 2))  # a dead end that turns back
        detour = np.concatenate([around[:3], there[::-1], there, around[2:]])
        assert homotopy_class(detour, obstacles) == (1, 3)
    loop = np.array([(0.0, 0.0), (1.5, 1.0), (1.5, -1.0), (0.0, -1.0), (0.5, 1.0), (4.0, 1.0)])
    assert homotopy_class(loop, obstacles) == (1, 1, 2, 3)
    assert homotopy_class(np.array([(0.0, 0.0), (4.0, -1.0)]), obstacles) == ()


# Errors


@pytest.mark.parametrize(
    ("start", "goal", "message"),
    [
        ((-1.0, 5.0), (10.0, 5.0), r"cannot be at the start \(-1, 5\): 1 m outside the map"),
        ((10.0, 5.0), (5.0, 5.0), r"at the goal \(5, 5\): inside the keep-out disc at \(5, 5\)"),
        ((np.nan, 5.0), (10.0, 5.0), r"start\[0\]: expected a number, found float nan"),
        ((10.0, 5.0), (10.0, 5.0), r"different start and goal, found both at \(10, 5\)"),
        (
            (10.0, 5.0),
            (10.0, 25.0),
            r"no route leads from \(10, 5\) to \(10, 25\): the ground that can be reached ends at "
            r"\(10, 12.5\), 12.5 m from the goal; beyond it: 1 m from the keep-out polygon",
        ),
    ],
)
def test_questions_without_an_answer(start, goal, message):
    layers = plain(30, keep_out=[box(0, 30, 14, 16), sf.Region.disc(5.0, 5.0, 1.0)])
    for ask in (route, lambda *question: routes(*question, 2)):
        refuses(sf.ModelError, message, ask, layers, start, goal)


def test_ground_that_friction_does_not_hold_separates_places():
    layers, ends = plain(30), [(10.0, 5.0), (10.0, 25.0)]
    steep = layers._replace(cost=np.where(np.abs(layers.y - 15) < 1, SLIDING, layers.cost))
    found = separation_words(steep, ends, by_friction=True)
    assert found.startswith("no route leads from (10, 5) to (10, 25): the ground")
    assert "ends at (10, 14), 11 m from the goal" in found
    assert separation_words(steep, ends, by_friction=False) == ""


def test_gradient_of_the_effort(rng):
    layers, middle = corridor()
    rough = np.array([(2.0, middle), (middle, middle), (middle, 18.0)])
    field = search._field(layers, rough, 1.0)
    field = field._replace(cost=field.cost + rng.random(field.cost.shape))
    aim = search._Objective(stiff=0.3, clear=0.2, sharpest=0.8, weight=10.0, step=0.1)
    points = search.resample_polyline(rough, 0.1) - field.origin
    points += 0.03 * rng.standard_normal(points.shape)
    gradient = search._objective(field, points, aim)[1]
    for k, axis in ((0, 0), (7, 1), (60, 0), (90, 1), (len(points) - 1, 1)):
        values = []
        for step in (1e-7, -1e-7):
            moved = points.copy()
            moved[k, axis] += step
            values.append(search._objective(field, moved, aim)[0])
        assert_allclose(gradient[k, axis], (values[0] - values[1]) / 2e-7, rtol=1e-4, atol=1e-3)


def test_fewer_poses_if_equations_are_not_compiled_in_time(monkeypatch, tmp_path, cratered):
    def run(command):
        raise subprocess.TimeoutExpired(command, codegen_cache._LIMIT.get())

    monkeypatch.setenv("SLIPFREE_CACHE", str(tmp_path))
    monkeypatch.setattr(codegen_cache, "_run", run)
    monkeypatch.setattr("slipfree.routing.traversability.INTERPRETED", 500)
    with pytest.warns(UserWarning, match="took more than 2 s, its share .*; raise plan"):
        layers = traversability(cratered[0], ROVER, seconds=10.0)
    assert 250 < layers.poses["roll"].size < 750


@pytest.mark.slow
def test_a_large_map_is_coarsened(monkeypatch, tmp_path):
    monkeypatch.setenv("SLIPFREE_CACHE", str(tmp_path))  # so many poses are compiled
    axis = np.arange(2000) * 0.25
    grid = sf.Grid(axis, axis, 0.1 * np.sin(0.1 * axis)[:, None] * np.cos(0.07 * axis))
    layers = traversability(sf.Bicubic(grid), ROVER)
    assert layers.cost.shape == (8, 1429, 1429)
    inner = np.minimum(layers.x, axis[-1] - layers.x) >= REACH
    assert (np.isfinite(layers.cost) == inner[:, None] & inner).all()


# Regions to keep out of

STAR = ((0, 0), (4, 1), (8, 0), (6, 3), (8, 7), (4, 5), (0, 7), (2, 3))
ELL = ((0, 0), (0, 6), (2, 6), (2, 2), (5, 2), (5, 0))  # clockwise
WITH_STRAIGHT = ((0, 0), (2, 0), (4, 0), (4, 3), (2, 3), (0, 3))
POLYGONS = [((0, 0), (5, 1), (2, 4)), STAR, ELL, WITH_STRAIGHT]


def at_utm(points):
    return sf.Region.polygon(tuple((x + UTM[0], y + UTM[1]) for x, y in points))


def expression(region):
    """Return numeric functions of the expression and of its gradient."""
    p = ca.SX.sym("p", 2)
    value = region.outside(p[0], p[1])
    f = ca.Function("f", [p], [value, ca.gradient(value, p), ca.hessian(value, p)[0]])
    return lambda points: [np.array(out) for out in f.map(len(points))(points.T)]


def brute_distance(points, x, y):
    """Return the least distance to many points of the border."""
    t = np.linspace(0, 1, 2001)[:, None]
    corners = np.array(points, dtype=float)
    border = np.concatenate(
        [a + t * (b - a) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
    )
    return np.hypot(x[:, None] - border[:, 0], y[:, None] - border[:, 1]).min(axis=1)


def test_distance_to_a_disc(rng):
    disc = sf.Region.disc(1.0, 2.0, 0.5)
    assert_allclose(disc.distance(np.array([1.0, 4.0]), np.array([2.0, 6.0])), [-0.5, 4.5])
    assert (disc.bounds, disc.words) == ((0.5, 1.5, 1.5, 2.5), "disc at (1, 2) of 0.5 m radius")
    _, gradient, hessian = expression(disc)(np.array([[1.0, 2.0]]))
    assert_allclose(gradient, 0)
    assert np.isfinite(hessian).all()
    disc = sf.Region.disc(400_001.0, 5_500_002.0, 3.0)
    points = rng.uniform(-9, 9, (300, 2)) + np.array([disc.x, disc.y])
    value, gradient, _ = expression(disc)(points)
    distance = disc.distance(*points.T)
    far = distance > -0.9 * disc.radius
    assert_allclose(value[0, far], distance[far], atol=2e-5)
    assert (np.linalg.norm(gradient, axis=0) <= 1).all()


@pytest.mark.parametrize("points", POLYGONS)
def test_distance_to_a_polygon(rng, points):
    region = sf.Region.polygon(points)
    x, y = rng.uniform(-3, 10, (2, 400))
    distance = region.distance(x, y)
    inside = Outline(np.array(points)).contains_points(np.stack([x, y], axis=1))
    assert_allclose(np.abs(distance), brute_distance(points, x, y), atol=4e-3)
    assert ((distance < 0) == inside).all()
    assert_allclose(sf.Region.polygon(points[::-1]).distance(x, y), distance, atol=1e-14)
    a, b = rng.uniform(-3, 10, (2, 2, 1000))  # it grows no faster than the way
    gap = np.abs(region.distance(*a) - region.distance(*b))
    assert (gap <= np.hypot(*(a - b)) + 1e-12).all()


@pytest.mark.parametrize("points", POLYGONS)
@pytest.mark.parametrize("make", [sf.Region.polygon, at_utm])
def test_expression_of_a_polygon_is_its_distance(rng, points, make):
    region = make(points)
    shift = region.points[0][0] - points[0][0], region.points[0][1] - points[0][1]
    places = rng.uniform(-3, 10, (400, 2)) + shift
    value, gradient, hessian = expression(region)(places)
    assert_allclose(value[0], region.distance(*places.T), atol=1e-8)
    assert_allclose(np.linalg.norm(gradient, axis=0), 1, atol=1e-9)
    assert np.isfinite(hessian).all()


def test_gradient_on_an_edge_is_its_normal():
    on_edges = np.array([[3.0, 0.0], [4.0, 1.0], [2.0, 0.0]])  # the last on a point, no corner
    value, gradient, hessian = expression(sf.Region.polygon(WITH_STRAIGHT))(on_edges)
    assert_allclose(value[0], 0, atol=1e-15)
    assert_allclose(gradient.T, [(0, -1), (1, 0), (0, -1)], atol=1e-15)
    assert_allclose(hessian, 0, atol=1e-12)


def test_polygon_describes_itself():
    region = sf.Region.polygon([[0, 0], [3, 0], [0, 3]])
    assert (region.words, region.bounds) == ("polygon of 3 points about (1, 1)", (0, 3, 0, 3))
    assert hash(region) == hash(sf.Region.polygon(((0, 0), (3, 0), (0, 3))))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (((0, 0), (1, 1)), r"three points \(x, y\), found 2"),
        (((0, 0), (1, 0), (np.nan, 1)), "points.2..0.: expected a number, found float nan"),
        (((0, 0), (1, 0), (1, 1), (0, 0)), "points 4 and 1 coincide"),
        (((0, 0), (2, 2), (2, 0), (0, 2)), "edge 1-2 crosses or touches edge 3-4"),
        (((0, 0), (4, 0), (4, 4), (2, 0), (0, 4)), "edge 1-2 crosses or touches edge 3-4"),
        (((0, 0), (4, 0), (1, 1), (3, 1), (0, -2)), "edge 1-2 crosses or touches edge 4-5"),
        (((0, 0), (4, 0), (2, 0), (0, 3)), "edges at point 2 fold back"),
        ((0.0, 0.0, 0.0), "radius: expected a"),
        ((0.0, 0.0, np.nan), "radius: expected a"),
        ((np.nan, 0.0, 1.0), "x: expected a number, found float nan"),
    ],
)
def test_bad_regions_are_refused(given, message):
    """Polygons of their points, and discs of numbers."""
    make = sf.Region.disc if isinstance(given[0], float) else sf.Region.polygon
    refuses(sf.ModelError, message, make, *(given if make is sf.Region.disc else [given]))


# Invalid positions on a map are reported by name before a search

START = ("start", 5.0, 5.0)


def told(layers, *places):
    return [*unreachable(layers, places).items()]


def test_all_that_is_wrong_is_told():
    """In some headings there is room at the edge: it is not sure that no motion passes there."""
    layers = plain(30, 0.25, keep_out=[sf.Region.disc(20.0, 20.0, 2.0)])
    inside, outside = told(
        layers, START, ("way-point 1", 0.5, 10.0), ("way-point 2", 20.0, 20.0), ("goal", 33.5, 10.0)
    )
    assert inside[0] == "way-point 2"
    assert outside == (
        "goal",
        "the vehicle cannot be at the goal (33.5, 10): 3.5 m outside the map; move the goal or "
        "use a larger map",
    )


def test_the_distance_to_a_place_to_keep_out_of_is_that_of_the_point_not_of_its_node():
    keep_out = [sf.Region.disc(20.0, 20.0, 2.0), sf.Region.disc(25.0, 10.0, 1.0)]
    layers = plain(30, 0.25, keep_out=keep_out)
    reach = layers.limits.reach
    ((_, words),) = told(layers, START, ("goal", 20.0 + 2.0 + reach - 0.01, 20.0))
    assert "1.41 m from the keep-out disc at (20, 20) of 2 m radius, and wheels" in words
    assert not told(layers, START, ("goal", 20.0 + 2.0 + reach + 0.01, 20.0))
    assert told(layers, ("start", 19.0, 20.0), ("goal", 5.0, 5.0)) == [
        (
            "start",
            "the vehicle cannot be at the start (19, 20): inside the keep-out disc at (20, 20) of "
            "2 m radius; move the start or make the keep-out region smaller",
        )
    ]


def test_friction_that_holds_no_heading_is_told_with_its_factor():
    """Straight up a slope of 20 degrees, all weight on the driven wheels needs its tangent."""
    grid, tangent = blank((0, 8), (0, 8), 0.5), math.tan(math.radians(20))
    terrain = sf.Bicubic(sf.Grid(grid.x, grid.y, tangent * grid.y + grid.z), mu=0.2)
    words = unheld_words(terrain, ROVER, 4.0, 4.0)
    factor = float(re.search(r"needs at least ([\d.]+) times the friction", words).group(1))
    assert tangent / 0.2 < factor < 1.6 * tangent / 0.2
    assert not unheld_words(replace(terrain, mu=0.6), ROVER, 4.0, 4.0)
    assert not unheld_words(sf.Bicubic(grid, mu=0.2), ROVER, 4.0, 4.0)


def test_places_to_keep_out_of_that_divide_the_map():
    disc, ends = sf.Region.disc(5.0, 25.0, 1.0), [START, ("goal", 25.0, 25.0)]
    ((place, words),) = told(plain(30, 0.25, keep_out=[disc, box(0, 30, 14, 16)]), *ends)
    assert place == "goal"
    assert "the keep-out polygon of 4 points about (15, 15) separates them; make it" in words
    together = plain(30, 0.25, keep_out=[box(0, 16, 14, 16), disc, box(17, 30, 14, 16)])
    ((_, words),) = told(together, *ends)
    assert "(8, 15) and polygon of 4 points about (23.5, 15) together separate them" in words
    assert "disc" not in words


def test_routes_keep_out_of_holes():
    grid = blank((0, 30), (0, 30), 0.25)
    holes = np.hypot(grid.x[:, None] - 15, grid.y - 15) < 4
    layers = free_space(sf.Bicubic(sf.Grid(grid.x, grid.y, grid.z, holes=holes)), ROVER)
    words = "m from a hole in the map, where heights are missing, and wheels reach"
    refuses(sf.ModelError, words, route, layers, (5, 5), (15.0, 19.5))
    points = route(layers, (5, 5), (25, 25))
    assert np.hypot(*(points - 15).T).min() > 4 + layers.limits.reach - 0.25


# A plan around a hole in a ragged map without a window

PROBLEM = """
verb = "plan"
terrain.file = "site.npz"
vehicle = { catalog = "three_wheeler", axle = "fixed" }
start = { x = 10.0, y = 4.0 }
goal = { x = 10.0, y = 16.0 }
costs = { effort = 0.01 }
limits = { steer = [-0.8, 0.8] }
bounds = { right_rate = [0, 3], left_rate = [0, 3], steer_rate = [-1, 1] }
plan = { intervals = 20, smooth = 0.002 }
driver = { name = "route", speed = 0.5, turning_radius = 2.5 }
time = { duration = 60.0, step = 0.25 }
solver = { tolerance = 1e-6 }
"""


@pytest.mark.slow
def test_a_plan_leads_around_the_hole(folder: Path) -> None:
    """On hills in a ragged diamond around a hole."""
    x = 0.25 * np.arange(81)
    z = 0.1 * np.sin(0.6 * x)[:, None] * np.cos(0.5 * x)
    border = 12.5 + 0.6 * np.sin(3 * x)[:, None]
    ragged = np.abs(x[:, None] - 10) + np.abs(x - 10) > border
    pit = np.hypot(x[:, None] - 10.3, x - 10) < 1.2
    np.savez("site.npz", x=x, y=x, z=np.where(ragged | pit, np.nan, z))
    (folder / "p.toml").write_text(PROBLEM)
    found = sf.run_problem(sf.load_problem("p.toml"))
    run, grid = found.trajectory, found.setup.ground.grid
    assert run.outcome is sf.Outcome.COMPLETE
    assert np.hypot(run["x"][-1] - 10, run["y"][-1] - 16) < 0.01
    assert not grid.touches(grid.holes, run["contact_x"], run["contact_y"]).any()
    assert np.abs(run["x"] - 10.3).max() > 1.2 + 0.5  # around it, by half the track


# Paths with cusps: lengths in closed form, end poses, symmetries, and inputs

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
    with pytest.raises(sf.ModelError, match="turning_radius: expected a number > 0, found 0"):
        reeds_shepp((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0)


def driven_along(vehicle, arcs, speed=0.5):
    """Return the motion of a vehicle along arcs on a plane."""
    ground: Terrain = sf.Analytic(lambda x, y: 0 * x * y)
    dae = sf.direct_kinematics(vehicle, ground)
    start = sf.settle(dae)
    values = {c.name: 0.0 for c in vehicle.of("commanded")}
    pieces, duration = arc_inputs(dae, arcs, values, speed=speed)
    t, rates = input_samples(duration, 0.2, pieces)
    return sf.simulate(dae, start, dae.inputs(**rates), t), duration


@pytest.mark.parametrize("heading", [0.4, None])
def test_steered_vehicle_drives_the_arcs_without_slip(heading):
    vehicle = sf.catalog.three_wheeler(axle="fixed")
    ahead = turning_axis_offset(vehicle)
    assert ahead == pytest.approx(0.5)
    arcs = reeds_shepp((0.0, 0.0, 0.0), (1.0, -1.0, heading), 1.2, ahead)
    assert min(arc.length for arc in arcs) < 0 < max(arc.length for arc in arcs)
    run, duration = driven_along(vehicle, arcs)
    assert (run["x"][-1], run["y"][-1]) == pytest.approx((1.0, -1.0), abs=1e-6)
    if heading is not None:
        assert run["heading"][-1] == pytest.approx(heading, abs=1e-6)
    assert np.abs(run["slip_across"]).max() < 1e-6
    assert duration > length_of(arcs) / 0.5  # and the time to steer


def test_skid_steer_vehicle_drives_the_arcs_roughly():
    vehicle = sf.catalog.rigid_skid_steer()
    run, _ = driven_along(vehicle, [(1.0, 0.8), (-0.5, -0.8)])
    x, y, heading = end_of((0.0, 0.0, 0.0), [(1.0, 0.8), (-0.5, -0.8)])
    assert (run["x"][-1], run["y"][-1]) == pytest.approx((x, y), abs=0.05)
    assert run["heading"][-1] == pytest.approx(heading, abs=0.05)
