"""Tests that invalid positions on a map are reported by name before a search."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from slipfree import Bicubic, Grid
from slipfree.catalog import three_wheeler
from slipfree.core.errors import ModelError
from slipfree.geometry.regions import Region
from slipfree.routing.reachability import unreachable
from slipfree.routing.search import route
from slipfree.routing.traversability import traversability
from slipfree.terrain.synthetic import blank, power_law

ROVER = three_wheeler(axle="fixed")  # its wheels reach 1.418 m
START = ("start", 5.0, 5.0)


def flat(**options):
    return traversability(Bicubic(blank((0, 30), (0, 30), 0.25), mu=0.6), ROVER, **options)


def box(x_min, x_max, y_min, y_max):
    return Region.polygon(((x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)))


def terraces(friction, degrees=20.0, gap=None):
    """Return a plateau in the south, one in the north, and a plane ramp right across between them.

    The ramp is flatter, of 5 degrees, in the gap.
    """
    grid = blank((0, 40), (0, 40), 0.25)
    rise = np.full(grid.x.size, math.tan(math.radians(degrees)))
    if gap is not None:
        rise[(grid.x > gap[0]) & (grid.x < gap[1])] = math.tan(math.radians(5))
    ramp = rise[:, None] * np.clip(grid.y - 15, 0, 10)
    return traversability(Bicubic(Grid(grid.x, grid.y, ramp + grid.z), mu=friction), ROVER)


def told(layers, *places):
    return [(each.name, each.words, each.sure) for each in unreachable(layers, places)]


def test_all_that_is_wrong_is_told():
    """In some headings there is room at the edge: it is not sure that no motion passes there."""
    layers = flat(keep_out=[Region.disc(20.0, 20.0, 2.0)])
    edge, inside, outside = told(
        layers, START, ("way-point 1", 0.5, 10.0), ("way-point 2", 20.0, 20.0), ("goal", 33.5, 10.0)
    )
    assert edge[::2] == ("way-point 1", False)
    assert "0.5 m from the edge of the map, and wheels reach 1.42 m" in edge[1]
    assert inside[::2] == ("way-point 2", True)
    assert outside == (
        "goal",
        "the vehicle cannot be at the goal (33.5, 10): 3.5 m outside the map; move the goal or "
        "use a larger map",
        True,
    )


def test_the_distance_to_a_place_to_keep_out_of_is_that_of_the_point_not_of_its_node():
    layers = flat(keep_out=[Region.disc(20.0, 20.0, 2.0), Region.disc(25.0, 10.0, 1.0)])
    reach = layers.limits.reach
    ((_, words, sure),) = told(layers, START, ("goal", 20.0 + 2.0 + reach - 0.01, 20.0))
    assert sure
    assert "1.41 m from the keep-out disc at (20, 20) of 2 m radius, and wheels" in words
    for each in unreachable(layers, [START, ("goal", 20.0 + 2.0 + reach + 0.01, 20.0)]):
        assert not each.sure
    assert told(layers, ("start", 19.0, 20.0), ("goal", 5.0, 5.0)) == [
        (
            "start",
            "the vehicle cannot be at the start (19, 20): inside the keep-out disc at (20, 20) of "
            "2 m radius; move the start or make the keep-out region smaller",
            True,
        )
    ]


def test_a_ramp_across_the_map_that_friction_cannot_hold_divides_it():
    layers = terraces(0.3)
    (first, *_) = told(layers, ("start", 20.0, 20.0), ("goal", 20.0, 5.0))
    assert first == (
        "start",
        "the vehicle cannot be at the start (20, 20): slope of 20 degrees needs a friction "
        "coefficient of 0.364, the ground offers 0.3; move the start or give the ground more "
        "friction",
        True,
    )
    ((place, words, sure),) = told(layers, ("start", 20.0, 5.0), ("goal", 22.0, 35.0))
    assert (place, sure) == ("goal", True)
    assert words.startswith("the goal (22, 35) cannot be reached from the start (20, 5): even the")
    assert "needs a friction coefficient of 0.36" in words
    assert "the ground offers 0.3; move the goal, or give the ground more friction" in words


def test_places_that_can_be_reached_are_not_objected_to():
    assert unreachable(flat(), [START, ("way-point 1", 15.0, 20.0), ("goal", 25.0, 25.0)]) == []
    low, high = ("start", 20.0, 5.0), ("goal", 32.0, 35.0)
    for layers in (terraces(0.5), terraces(0.3, gap=(28, 36))):
        assert unreachable(layers, [low, high]) == []


def test_the_narrowest_place_is_named():
    """Two ramps, one less steep than the other: the less steep one is what must be held."""
    layers = terraces(0.3, degrees=30.0)
    slope = np.where((layers.x > 28) & (layers.x < 36), math.radians(18), math.radians(30))[:, None]
    slope = np.where((layers.y > 15) & (layers.y < 25), slope, 0.0)
    used = np.tan(slope) / 0.3
    cost = np.where(used < 1, layers.cost, np.inf)
    layers = layers._replace(slope=slope, friction=used, cost=cost)
    ((_, words, _),) = told(layers, ("start", 20.0, 5.0), ("goal", 22.0, 35.0))
    place = re.search(r"crosses a slope of 18 degrees at \((.*?), (.*?)\),", words)
    assert place is not None
    x, y = map(float, place.groups())
    assert 28 < x < 36
    assert 15 < y < 25
    assert "needs a friction coefficient of 0.325, and the ground offers 0.3" in words


def test_places_to_keep_out_of_that_divide_the_map():
    disc, ends = Region.disc(5.0, 25.0, 1.0), [START, ("goal", 25.0, 25.0)]
    ((place, words, sure),) = told(flat(keep_out=[disc, box(0, 30, 14, 16)]), *ends)
    assert (place, sure) == ("goal", True)
    assert words.endswith(
        "the keep-out polygon of 4 points about (15, 15) lies between them, and no route leads "
        "around it; make it smaller or move it"
    )
    together = flat(keep_out=[box(0, 16, 14, 16), disc, box(17, 30, 14, 16)])
    ((_, words, sure),) = told(together, *ends)
    assert sure
    assert (
        "several keep-out regions together separate them: polygon of 4 points about (8, 15), "
        "polygon" in words
    )
    assert "disc" not in words


def test_ground_that_is_only_too_steep_for_a_route_is_no_sure_objection():
    """Without friction nothing says what can be held: 30 degrees are a rule for routes."""
    grid = blank((0, 40), (0, 40), 0.25)
    ramp = math.tan(math.radians(35)) * np.clip(grid.y - 15, 0, 10)[None, :] + 0 * grid.x[:, None]
    layers = traversability(Bicubic(Grid(grid.x, grid.y, ramp)), ROVER)
    ((place, words, sure),) = told(layers, ("start", 20.0, 5.0), ("goal", 20.0, 35.0))
    assert (place, sure) == ("goal", False)
    assert (
        "no route leads from (20, 5) to (20, 35): the ground that can be reached ends at" in words
    )
    assert "degrees, steeper than the 30 degrees" in words
    with pytest.raises(ModelError, match="no route leads"):
        route(layers, (20.0, 5.0), (20.0, 35.0))


def test_rough_and_hollow_ground_is_named():
    grid = blank((0, 30), (0, 30), 0.25)
    rough = power_law(grid, rms=1.0, hurst=0.2, longest=1.5, shortest=0.7, seed=3)
    patch = np.hypot(grid.x[:, None] - 20, grid.y - 20) < 5
    layers = traversability(
        Bicubic(Grid(grid.x, grid.y, np.where(patch, rough.z, 0))), ROVER, steepest=1.5
    )
    ((place, words, sure),) = told(layers, START, ("goal", 20.0, 20.0))
    assert (place, sure) == ("goal", False)
    assert "roughness of " in words
    assert " m, not less than the wheel radius of 0.3 m" in words
    assert " m radius, too narrow for the wheel radius of 0.3 m; move the goal" in words


def test_routes_keep_out_of_holes():
    grid = blank((0, 30), (0, 30), 0.25)
    holes = np.hypot(grid.x[:, None] - 15, grid.y - 15) < 4
    layers = traversability(Bicubic(Grid(grid.x, grid.y, grid.z, holes=holes)), ROVER)
    ((place, words, sure),) = told(layers, START, ("goal", 15.0, 19.5))
    assert (place, sure) == ("goal", False)
    assert "m from a hole in the map, where heights are missing, and wheels reach" in words
    points = route(layers, (5, 5), (25, 25))
    assert np.hypot(*(points - 15).T).min() > 4 + layers.limits.reach - 0.25
