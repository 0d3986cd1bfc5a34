"""Tests of keep-out regions: distances against independent references."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from matplotlib.path import Path as Outline
from numpy.testing import assert_allclose

from slipfree.core.errors import ModelError
from slipfree.geometry.regions import Region

UTM = (400_000.0, 5_500_000.0)
STAR = ((0, 0), (4, 1), (8, 0), (6, 3), (8, 7), (4, 5), (0, 7), (2, 3))
ELL = ((0, 0), (0, 6), (2, 6), (2, 2), (5, 2), (5, 0))  # clockwise
WITH_STRAIGHT = ((0, 0), (2, 0), (4, 0), (4, 3), (2, 3), (0, 3))
POLYGONS = [((0, 0), (5, 1), (2, 4)), STAR, ELL, WITH_STRAIGHT]


def at_utm(points):
    return Region.polygon(tuple((x + UTM[0], y + UTM[1]) for x, y in points))


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
    disc = Region.disc(1.0, 2.0, 0.5)
    assert_allclose(disc.distance(np.array([1.0, 4.0]), np.array([2.0, 6.0])), [-0.5, 4.5])
    assert disc.bounds == (0.5, 1.5, 1.5, 2.5)
    assert disc.words == "disc at (1, 2) of 0.5 m radius"
    _, gradient, hessian = expression(disc)(np.array([[1.0, 2.0]]))
    assert_allclose(gradient, 0)
    assert np.isfinite(hessian).all()
    disc = Region.disc(400_001.0, 5_500_002.0, 3.0)
    points = rng.uniform(-9, 9, (300, 2)) + np.array([disc.x, disc.y])
    value, gradient, _ = expression(disc)(points)
    distance = disc.distance(*points.T)
    far = distance > -0.9 * disc.radius
    assert_allclose(value[0, far], distance[far], atol=2e-5)
    assert (np.linalg.norm(gradient, axis=0) <= 1).all()


@pytest.mark.parametrize("points", POLYGONS)
def test_distance_to_a_polygon(rng, points):
    region = Region.polygon(points)
    x, y = rng.uniform(-3, 10, (2, 400))
    distance = region.distance(x, y)
    inside = Outline(np.array(points)).contains_points(np.stack([x, y], axis=1))
    assert_allclose(np.abs(distance), brute_distance(points, x, y), atol=4e-3)
    assert ((distance < 0) == inside).all()
    assert_allclose(Region.polygon(points[::-1]).distance(x, y), distance, atol=1e-14)
    a, b = rng.uniform(-3, 10, (2, 2, 1000))  # it grows no faster than the way
    gap = np.abs(region.distance(*a) - region.distance(*b))
    assert (gap <= np.hypot(*(a - b)) + 1e-12).all()


@pytest.mark.parametrize("points", POLYGONS)
@pytest.mark.parametrize("make", [Region.polygon, at_utm])
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
    value, gradient, hessian = expression(Region.polygon(WITH_STRAIGHT))(on_edges)
    assert_allclose(value[0], 0, atol=1e-15)
    assert_allclose(gradient.T, [(0, -1), (1, 0), (0, -1)], atol=1e-15)
    assert_allclose(hessian, 0, atol=1e-12)


def test_polygon_describes_itself():
    region = Region.polygon([[0, 0], [3, 0], [0, 3]])
    assert region.words == "polygon of 3 points about (1, 1)"
    assert region.bounds == (0, 3, 0, 3)
    assert hash(region) == hash(Region.polygon(((0, 0), (3, 0), (0, 3))))


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
    with pytest.raises(ModelError, match=message):
        Region.polygon(points)


def test_bad_discs_are_refused():
    for radius in (0.0, np.nan):
        with pytest.raises(ModelError, match="radius: expected a"):
            Region.disc(0.0, 0.0, radius)
    with pytest.raises(ModelError, match=r"x: expected a number, found float nan"):
        Region.disc(np.nan, 0.0, 1.0)
