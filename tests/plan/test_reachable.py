"""Tests that invalid positions on a map are reported by name before a search."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from slipfree import Bicubic, Grid
from slipfree.catalog import three_wheeler
from slipfree.core.errors import ModelError
from slipfree.geometry.regions import Region
from slipfree.routing.reachability import unheld_words, unreachable
from slipfree.routing.search import route
from slipfree.routing.traversability import free_space
from slipfree.terrain.synthetic import blank

ROVER = three_wheeler(axle="fixed")  # its wheels reach 1.418 m
START = ("start", 5.0, 5.0)


def flat(**options):
    return free_space(Bicubic(blank((0, 30), (0, 30), 0.25), mu=0.6), ROVER, **options)


def box(x_min, x_max, y_min, y_max):
    return Region.polygon(((x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)))


def told(layers, *places):
    return [(each.name, each.words) for each in unreachable(layers, places)]


def test_all_that_is_wrong_is_told():
    """In some headings there is room at the edge: it is not sure that no motion passes there."""
    layers = flat(keep_out=[Region.disc(20.0, 20.0, 2.0)])
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
    layers = flat(keep_out=[Region.disc(20.0, 20.0, 2.0), Region.disc(25.0, 10.0, 1.0)])
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
    terrain = Bicubic(Grid(grid.x, grid.y, tangent * grid.y + grid.z), mu=0.2)
    words = unheld_words(terrain, ROVER, 4.0, 4.0)
    factor = float(re.search(r"needs at least ([\d.]+) times the friction", words).group(1))
    assert tangent / 0.2 < factor < 1.6 * tangent / 0.2
    assert not unheld_words(replace(terrain, mu=0.6), ROVER, 4.0, 4.0)
    assert not unheld_words(Bicubic(grid, mu=0.2), ROVER, 4.0, 4.0)


def test_places_to_keep_out_of_that_divide_the_map():
    disc, ends = Region.disc(5.0, 25.0, 1.0), [START, ("goal", 25.0, 25.0)]
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
    layers = free_space(Bicubic(Grid(grid.x, grid.y, grid.z, holes=holes)), ROVER)
    words = "m from a hole in the map, where heights are missing, and wheels reach"
    with pytest.raises(ModelError, match=words):
        route(layers, (5, 5), (15.0, 19.5))
    points = route(layers, (5, 5), (25, 25))
    assert np.hypot(*(points - 15).T).min() > 4 + layers.limits.reach - 0.25
