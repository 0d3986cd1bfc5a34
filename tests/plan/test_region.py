"""Tests of regions and ways: keep-out distances, valid places, holes of maps, paths with cusps."""

import math
import re
from dataclasses import replace
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
from slipfree.routing.search import route, unheld_words, unreachable
from slipfree.routing.traversability import free_space
from slipfree.solve.sampling import input_samples
from slipfree.terrain.base import Terrain
from slipfree.terrain.synthetic import blank

UTM = (400_000.0, 5_500_000.0)
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
    ("points", "message"),
    [
        (((0, 0), (1, 1)), r"three points \(x, y\), found 2"),
        (((0, 0), (1, 0), (np.nan, 1)), "points.2..0.: expected a number, found float nan"),
        (((0, 0), (1, 0), (1, 1), (0, 0)), "points 4 and 1 coincide"),
        (((0, 0), (2, 2), (2, 0), (0, 2)), "edge 1-2 crosses or touches edge 3-4"),
        (((0, 0), (4, 0), (4, 4), (2, 0), (0, 4)), "edge 1-2 crosses or touches edge 3-4"),
        (((0, 0), (4, 0), (1, 1), (3, 1), (0, -2)), "edge 1-2 crosses or touches edge 4-5"),
        (((0, 0), (4, 0), (2, 0), (0, 3)), "edges at point 2 fold back"),
    ],
)
def test_bad_polygons_are_refused(points, message):
    refuses(sf.ModelError, message, sf.Region.polygon, points)


def test_bad_discs_are_refused():
    for radius in (0.0, np.nan):
        refuses(sf.ModelError, "radius: expected a", sf.Region.disc, 0.0, 0.0, radius)
    refuses(
        sf.ModelError, r"x: expected a number, found float nan", sf.Region.disc, np.nan, 0.0, 1.0
    )


# Invalid positions on a map are reported by name before a search

ROVER = three_wheeler(axle="fixed")  # its wheels reach 1.418 m
START = ("start", 5.0, 5.0)


def flat(**options):
    return free_space(sf.Bicubic(blank((0, 30), (0, 30), 0.25), mu=0.6), ROVER, **options)


def told(layers, *places):
    return [*unreachable(layers, places).items()]


def test_all_that_is_wrong_is_told():
    """In some headings there is room at the edge: it is not sure that no motion passes there."""
    layers = flat(keep_out=[sf.Region.disc(20.0, 20.0, 2.0)])
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
    layers = flat(keep_out=[sf.Region.disc(20.0, 20.0, 2.0), sf.Region.disc(25.0, 10.0, 1.0)])
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
    ((place, words),) = told(flat(keep_out=[disc, box(0, 30, 14, 16)]), *ends)
    assert place == "goal"
    assert words.endswith(
        "the keep-out polygon of 4 points about (15, 15) lies between them, and no route leads "
        "around it; make it smaller or move it"
    )
    together = flat(keep_out=[box(0, 16, 14, 16), disc, box(17, 30, 14, 16)])
    ((_, words),) = told(together, *ends)
    assert (
        "several keep-out regions together separate them: polygon of 4 points about (8, 15), "
        "polygon" in words
    )
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
    with pytest.raises(sf.ModelError, match="positive, finite 'turning_radius'"):
        reeds_shepp((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.0)


def driven(vehicle, arcs, speed=0.5):
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
    run, duration = driven(vehicle, arcs)
    assert (run["x"][-1], run["y"][-1]) == pytest.approx((1.0, -1.0), abs=1e-6)
    if heading is not None:
        assert run["heading"][-1] == pytest.approx(heading, abs=1e-6)
    assert np.abs(run["slip_across"]).max() < 1e-6
    assert duration > length_of(arcs) / 0.5  # and the time to steer


def test_skid_steer_vehicle_drives_the_arcs_roughly():
    vehicle = sf.catalog.rigid_skid_steer()
    run, _ = driven(vehicle, [(1.0, 0.8), (-0.5, -0.8)])
    x, y, heading = end_of((0.0, 0.0, 0.0), [(1.0, 0.8), (-0.5, -0.8)])
    assert (run["x"][-1], run["y"][-1]) == pytest.approx((x, y), abs=0.05)
    assert run["heading"][-1] == pytest.approx(heading, abs=0.05)
