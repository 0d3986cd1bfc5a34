"""Tests of the figures of plans: cost map, blocked nodes, routes, and planned quantities."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.figure import Figure

import slipfree as sf
from helpers.figures import assert_inside
from slipfree.core.facts import Fact
from slipfree.core.trajectory import Trajectory
from slipfree.geometry.regions import Region
from slipfree.routing.traversability import blocked_by, free_space, traversability
from slipfree.show import ground_drawing, plan_figures, plots
from slipfree.terrain.synthetic import blank, craters

START, GOAL = ("start", 6.0, 8.0), ("goal", 24.0, 20.0)
BOUNDS = {"right_rate": (-1.0, 3.0), "left_rate": (-1.0, 3.0), "steer_rate": (-0.5, np.inf)}
LIMITS = {"steer": (-0.8, 0.8), "slip_across[front]": (-0.1, 0.1)}


@pytest.fixture(scope="module")
def grid() -> sf.Grid:
    hilly = craters(blank((0, 40), (0, 40), 0.5), count=6, diameters=(4, 8), seed=2)
    return sf.Grid(hilly.x, hilly.y, 2 * hilly.z)


@pytest.fixture(scope="module")
def layers(grid):
    triangle = ((30.0, 30.0), (34.0, 30.0), (32.0, 35.0))
    keep_out = [Region.disc(14.0, 16.0, 1.5), Region.polygon(triangle)]
    vehicle = sf.catalog.three_wheeler(axle="fixed")
    return traversability(sf.Bicubic(grid, mu=0.5), vehicle, keep_out=keep_out, spacing=2.0)


@pytest.fixture(scope="module")
def run(grid) -> Trajectory:
    dae = sf.direct_kinematics(sf.catalog.three_wheeler(axle="fixed"), sf.Bicubic(grid, mu=0.5))
    start = sf.settle(dae, x=6.0, y=8.0, heading=-0.9)
    inputs = dae.inputs(right_rate=0.5, left_rate=0.45, steer_rate=0.01)
    run = sf.simulate(dae, start, inputs, np.arange(0.0, 6.05, 0.2))
    return run.with_facts(
        {"plan_difference_x": Fact(1.2e-4, "m"), "plan_difference_heading": Fact(3e-5, "rad")}
    )


@pytest.fixture
def ax():
    return Figure(layout="constrained").subplots()


def labels(ax) -> list[str]:
    return ax.get_legend_handles_labels()[1]


def way() -> np.ndarray:
    return np.array([[6.0, 8.0], [14.0, 20.0], [24.0, 20.0]])


def figures(*args, **options) -> dict[str, Figure]:
    return plots.draw(plan_figures.plan_plots(*args, **options))


def test_costs_and_what_blocks_lie_where_they_belong(layers, grid, ax):
    plan_figures.cost_map(layers, grid, ax, ground_drawing.whole(grid))
    costs, blocked = (image.get_array() for image in ax.images[:2])
    assert costs.T.shape == layers.cost.shape[1:]
    free = np.isfinite(layers.least_cost)
    np.testing.assert_array_equal(np.ma.getmaskarray(costs).T, ~free)
    np.testing.assert_allclose(costs.T[free], layers.least_cost[free])
    # what blocks a node has a colour, what is free has none
    np.testing.assert_array_equal(blocked[..., 3].T > 0, ~free)
    assert ax.get_aspect() == 1.0
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("east $x$ [m]", "north $y$ [m]")
    assert len(ax.patches) == 2  # the outlines of what to keep out of


def test_the_legend_names_only_what_blocks_in_the_part_that_is_drawn(layers, grid, ax):
    plan_figures.cost_map(layers, grid, ax, ground_drawing.whole(grid))
    assert "friction holds no heading" in labels(ax)
    assert "keep-out region" in labels(ax)
    blocked = [each for each in labels(ax) if each.startswith("too close")]
    assert blocked == ["too close to a keep-out region", "too close to the edge of the map"]
    assert blocked_by(layers)["friction"].any()
    away = Figure().subplots()
    plan_figures.cost_map(layers, grid, away, (20.0, 24.0, 4.0, 8.0))
    assert labels(away) == []


def test_missing_heights_are_hatched_in_the_part_that_is_drawn(grid, ax):
    holes = np.zeros(grid.z.shape, dtype=bool)
    holes[40:44, 40:44] = True  # at x, y from 20 to 21.5 m
    ragged = sf.Grid(grid.x, grid.y, grid.z, holes=holes)
    found = free_space(sf.Bicubic(ragged, mu=0.5), sf.catalog.three_wheeler(axle="fixed"))
    plan_figures.cost_map(found, ragged, ax, (15.0, 25.0, 15.0, 25.0))
    assert {"no heights", "too close to a hole in the map"} <= {*labels(ax)}
    away = Figure().subplots()
    plan_figures.cost_map(found, ragged, away, (25.0, 30.0, 25.0, 30.0))
    assert "no heights" not in labels(away)


def test_an_initial_guess_is_drawn_under_the_plan(run, grid, layers):
    guess = np.array([[6.0, 8.0], [9.0, 12.0], [np.nan, np.nan], [6.0, 8.0], [8.0, 12.0]])
    ax = figures(run, grid, layers, guess=guess)["traversability"].axes[0]
    lines = {line.get_label(): line for line in ax.lines}
    np.testing.assert_array_equal(lines["initial guess"].get_xydata(), guess)
    assert lines["initial guess"].zorder < lines["planned motion"].zorder
    assert lines["initial guess"].get_linewidth() < lines["planned motion"].get_linewidth()


def test_places_are_marked_by_name(run, ax):
    plan_figures.motion(run, (START, ("way-point 1", 14.0, 20.0), GOAL), ax)
    assert labels(ax) == ["planned motion", "start", "way-point 1", "goal"]
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), run["x"])
    assert ax.lines[-1].get_xydata()[0] == pytest.approx(GOAL[1:])


def test_a_range_is_drawn_as_an_area(run, ax):
    area = (10.0, 14.0, 20.0, 26.0)
    plan_figures.motion(run, (START, GOAL), ax, {"goal": area})
    assert {*labels(ax)} == {"planned motion", "start", "goal"}
    (patch,) = ax.patches
    assert (*patch.get_xy(), patch.get_width(), patch.get_height()) == (10.0, 20.0, 4.0, 6.0)


def test_room_is_the_distance_less_what_the_wheels_reach(run, layers, ax):
    plan_figures.keep_out_distance(run, layers, ax)
    expected = np.hypot(run["x"] - 14, run["y"] - 16) - 1.5 - layers.limits.reach
    np.testing.assert_allclose(ax.lines[0].get_ydata(), expected)
    assert labels(ax)[0] == "disc at (14, 16) of 1.5 m radius"


def test_figures_of_a_plan_are_complete_and_fit(run, grid, layers):
    drawn = figures(
        run, grid, layers, places=(START, GOAL), found=[way()], bounds=BOUNDS, limits=LIMITS
    )
    assert list(drawn) == ["plan", "traversability"]
    assert len(drawn["plan"].axes) == 1 + 2 + 1 + 2
    note = " ".join(text.get_text() for text in drawn["plan"].texts).replace("\n", " ")
    assert "deviates from the plan by x 1.2e-04 m, heading 3.0e-05 rad." in note
    for figure in drawn.values():
        figure.draw_without_rendering()
        axes = [axis for ax in figure.axes for axis in (ax.xaxis, ax.yaxis)]
        assert_inside(figure, [*figure.texts, *(axis.label for axis in axes)])


@pytest.mark.slow
def test_labels_of_the_panels_do_not_meet(run, grid, layers):
    columns = {f"steer_rear_right_{k}_rate": run.columns["steer_rate"] for k in range(9)}
    many = replace(run, columns={**run.columns, **columns})
    bounds = BOUNDS | dict.fromkeys(columns, (-np.inf, np.inf))
    figure = figures(many, grid, layers, bounds=bounds, limits={})["plan"]
    figure.draw_without_rendering()
    boxes = [ax.yaxis.label.get_window_extent() for ax in figure.axes]
    assert all(upper.y0 > lower.y1 for upper, lower in pairwise(boxes))
