"""Tests of rolled ground, on which hollows narrower than a wheel are filled."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from slipfree.core.errors import ModelError
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.rolled import _close_by_ball, rolled
from slipfree.terrain.synthetic import blank, place_rocks, power_law

RADIUS = 0.3


def rough_ground(spacing=0.05):
    ground = power_law(
        blank((0, 6), (0, 5), spacing),
        rms=0.06,
        hurst=0.6,
        longest=3,
        shortest=2 * spacing,
        seed=1,
    )
    return place_rocks(ground, [(2.0, 2.0, 0.5, 0.2), (4.0, 3.0, 0.3, 0.15)])


def brute_closing(z, step, radius):
    """Lower envelope of all positions of the ball above the ground, node by node."""
    i, j = np.indices(z.shape)
    centre = np.full(z.shape, -np.inf)
    for p, q in np.ndindex(z.shape):
        s = radius**2 - step**2 * ((i - p) ** 2 + (j - q) ** 2)
        near = s >= 0
        centre[near] = np.maximum(centre[near], z[p, q] + np.sqrt(s[near]))
    closed = np.full(z.shape, np.inf)
    for p, q in np.ndindex(z.shape):
        s = radius**2 - step**2 * ((i - p) ** 2 + (j - q) ** 2)
        near = s >= 0
        closed[near] = np.minimum(closed[near], centre[p, q] - np.sqrt(s[near]))
    return closed


def test_closing_is_what_the_ball_leaves_free():
    z = 0.1 * np.random.default_rng(0).standard_normal((30, 26))
    closed = _close_by_ball(z, (0.1, 0.1), 0.35)
    inner = (slice(7, -7), slice(7, -7))  # the border is continued, the ball's reach is 2 x 3 nodes
    assert_allclose(closed[inner], brute_closing(z, 0.1, 0.35)[inner], atol=1e-14)


def test_closing_only_raises_and_repeats_nothing():
    z = rough_ground().z
    once = _close_by_ball(z, (0.05, 0.05), 0.45)
    assert (once >= z - 1e-12).all()
    assert (once > z + 1e-3).any()
    twice = _close_by_ball(once, (0.05, 0.05), 0.45)
    inner = (slice(20, -20), slice(20, -20))
    assert_allclose(twice[inner], once[inner], atol=1e-12)


def test_a_plane_is_unchanged_up_to_its_edges():
    flat = blank((0, 4), (-1, 2), 0.1)
    plane = Grid(flat.x, flat.y, 5 + 0.4 * flat.x[:, None] - 0.3 * flat.y)
    result = rolled(plane, RADIUS)
    assert result.largest < 1e-12
    assert_allclose(result.grid.z, Bicubic(plane).elevation(result.grid.x[:, None], result.grid.y))


def test_nodes_and_ends():
    result = rolled(rough_ground(), RADIUS)
    assert max(result.grid.spacing) <= RADIUS / 8
    assert_allclose(result.grid.x[[0, -1]], [0, 6])
    assert_allclose(result.grid.y[[0, -1]], [0, 5])
    old = Bicubic(rough_ground()).elevation(result.grid.x[:, None], result.grid.y)
    assert_allclose(result.grid.z - result.change.z, old, atol=1e-14)
    assert_allclose(result.largest, np.abs(result.change.z).max())
    assert_allclose(result.rms, np.sqrt(np.mean(result.change.z**2)))


def test_smooth_ground_hardly_changes():
    step = 0.05
    flat = blank((0, 8), (0, 8), step)
    # Valleys of radius 1/(0.2 * 1.2**2) = 3.5 m: the wheel reaches every point.
    hills = Grid(flat.x, flat.y, 0.2 * np.sin(1.2 * flat.x)[:, None] * np.cos(1.2 * flat.y))
    result = rolled(hills, RADIUS)
    # A Gaussian lowers a wave by (k sigma)**2 / 2 in each direction: 0.2 * (1.2 * 0.075)**2.
    assert result.largest < 1.1 * 0.2 * (1.2 * 0.075) ** 2
    # A ball of nodes misses the point it would touch by up to half a diagonal.
    closed = _close_by_ball(hills.z, (step, step), 0.45)
    assert_allclose(closed, hills.z, atol=step**2 / (4 * 0.45))


def test_a_wheel_touches_once():
    rng = np.random.default_rng(3)

    def double_contacts(grid):
        ground, found = Bicubic(grid), 0
        s = np.linspace(-0.999 * RADIUS, 0.999 * RADIUS, 801)
        for x, y, heading in rng.uniform([0.5, 0.5, 0], [5.5, 4.5, 7], (500, 3)):
            # A disc set down from above rests where this is largest.
            rests = ground.elevation(x + s * np.cos(heading), y + s * np.sin(heading))
            rests = rests + np.sqrt(RADIUS**2 - s**2)
            found += np.count_nonzero((rests[1:-1] > rests[:-2]) & (rests[1:-1] > rests[2:])) > 1
        return found

    ground = rough_ground()
    assert double_contacts(ground) > 50
    assert double_contacts(rolled(ground, RADIUS).grid) == 0


def test_a_radius_that_is_not_positive_or_larger_than_the_ground_is_refused():
    with pytest.raises(ModelError, match="radius must be a positive number"):
        rolled(blank((0, 1), (0, 1), 0.1), np.nan)
    with pytest.raises(ModelError, match=r"radius must be at most 0\.6667"):
        rolled(blank((0.0, 2.0), (0.0, 4.0), 0.1), 1e9)
