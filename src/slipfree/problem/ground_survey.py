"""Survey of a ground for ``slipfree ground``: slopes, hollows, doubtful heights, and a start."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import degrees
from typing import Any

import numpy as np
from scipy.ndimage import binary_dilation, correlate, maximum_filter, minimum_filter, uniform_filter

from slipfree.atlas.atlas import Atlas, Band
from slipfree.core.errors import ModelError
from slipfree.core.facts import Fact, Lines, lines, named_rows
from slipfree.core.records import Array, Mask
from slipfree.core.trajectory import heading_column
from slipfree.problem.build_ground import GroundMap
from slipfree.problem.problem import Problem
from slipfree.problem.verbs.atlas import AtlasKeys, AtlasTable, build_atlas
from slipfree.routing.traversability import extents
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import basis, coefficients_of
from slipfree.vehicle.tree import Vehicle

STEEP = 20.0, 30.0  # slopes that are counted [deg]
SPIKE = 3.0  # height of spikes above all neighbours, in differences between these [1]
HIGH = 0.5  # smallest height of a spike [cells]
ROUND = 1.0, 0.5, 0.25, 0.1, 0.05, 0.01  # steps to which heights may be rounded [m]
COARSE = 0.01  # rounded heights matter if their step exceeds this share of the cell [1]
WHOLE = 1e-6  # heights within this share of a step are multiples of it [1]
PLACES, HEADINGS = 12, 4  # places along an axis, and headings, at which the vehicle is put
LARGEST_RADIUS = 1e3  # of a wheel that is printed [m]
AHEAD = 6.0  # distance of a suggested goal [reach of the vehicle]
TOUCHING = 0.99  # share of the nodes at which a wheel touches once

SURVEY_ROWS = named_rows("survey")


def survey(ground: GroundMap) -> dict[str, Fact]:
    """Return the statistics of a ground: slopes, hollows and doubtful heights.

    A height is doubtful if it is above or below all its neighbours by more than three times the
    difference between these and more than half a cell.
    """
    grid = ground.grid
    known = _known(grid)
    table, weights = coefficients_of(grid.z, through=True), basis(0.0)[:, :3]

    def derivative(m: int, n: int) -> Array:  # of the surface at the nodes
        each = correlate(table, np.outer(weights[m], weights[n]))[1:-1, 1:-1]
        return np.asarray(each / (grid.spacing[0] ** m * grid.spacing[1] ** n))

    slope = np.degrees(np.arctan(np.hypot(derivative(1, 0), derivative(0, 1))))[known]
    xx, xy, yy = derivative(2, 0), derivative(1, 1), derivative(0, 2)
    concave = np.asarray((xx + yy) / 2 + np.hypot((xx - yy) / 2, xy))[known]
    ends = zip(("west", "east", "south", "north"), grid.domain, strict=True)
    facts = {
        **{side: Fact(float(value), "m", "edge of the map") for side, value in ends},
        "slope_median": Fact(float(np.median(slope)), "degree", "median slope"),
        "slope_high": Fact(float(np.percentile(slope, 95)), "degree", "95th percentile of slopes"),
        "slope_largest": Fact(float(slope.max()), "degree", "largest slope"),
        "hole_share": Fact(float(1 - known.mean()), "1", "share of the nodes in or beside holes"),
        "wheel_radius": Fact(
            1 / max(float(np.quantile(concave, TOUCHING)), 1e-9),
            "m",
            f"radius of wheels that touch once at {100 * TOUCHING:g} % of the nodes",
        ),
    }
    for each in STEEP:
        words = f"share of the nodes steeper than {each:g} deg"
        facts[f"share_above_{each:.0f}"] = Fact(float(np.mean(slope > each)), "1", words)
    ring = np.ones((3, 3), dtype=bool)
    ring[1, 1] = False
    high, low = (
        each(grid.z, footprint=ring, mode="nearest") for each in (maximum_filter, minimum_filter)
    )
    away = np.maximum(grid.z - high, 0.0) - np.maximum(low - grid.z, 0.0)
    least = np.maximum(SPIKE * (high - low), HIGH * min(grid.spacing))
    away = np.where(known & (np.abs(away) > least), away, 0.0)
    facts["spikes"] = Fact(np.count_nonzero(away), "1", "heights unlike those of the neighbours")
    if away.any():
        i, j = np.unravel_index(np.abs(away).argmax(), away.shape)
        facts["spike_x"] = Fact(float(grid.x[i]), "m", "place of the largest spike")
        facts["spike_y"] = Fact(float(grid.y[j]), "m", "place of the largest spike")
        facts["spike_size"] = Fact(float(away[i, j]), "m", "largest spike or pit")
    values = grid.values
    uneven = (np.abs(values / each - np.rint(values / each)).max() for each in ROUND)
    step = next((each for each, most in zip(ROUND, uneven, strict=True) if most < WHOLE), 0.0)
    if step > COARSE * min(grid.spacing) and np.ptp(values) > 0:
        facts["rounded_to"] = Fact(step, "m", "heights are multiples of it")
    return facts


def survey_lines(facts: dict[str, Fact], rolled: float | None = None) -> Lines:
    """Return the lines that show the facts of `survey`, of a ground with hollows filled or not."""
    radius = facts["wheel_radius"].value
    values: dict[str, Any] = {k: v for k, v in facts.items() if k != "hole_share" or v.value}
    values["wheels"] = f"up to {radius:.3g} m" if radius < LARGEST_RADIUS else "any"
    filled = f"terrain.rolled has filled those that a wheel of {rolled} m cannot touch"
    values["remedy"] = filled if rolled else "terrain.rolled fills narrower hollows"
    return lines(SURVEY_ROWS, values | {"touching": f"{100 * TOUCHING:g} %"})


def stand(
    problem: Problem[Any], grid: Grid, progress: Callable[[int, int], object]
) -> tuple[Mapping[str, float], Lines]:
    """Return where the vehicle of a problem stands on its ground, and lines of the summary.

    On a coarse grid of places and headings it is the most level pose where the vehicle also stands
    around: x, y, heading in the frame of the problem, roll and pitch [m, rad]; empty without one.
    ``progress`` is called with the number of poses so far, and of all.
    """
    _known(grid)  # a vehicle stands nowhere among holes
    spec, (few, many) = problem.spec, sorted(grid.z.shape)
    every = max(1, min(many // PLACES, few - 1))
    table = AtlasTable(headings=HEADINGS, every=every, compiled=False)
    keys = {name: getattr(spec, name) for name in ("frame", "terrain", "vehicle")}
    setup = build_atlas(replace(problem, spec=AtlasKeys(verb="atlas", atlas=table, **keys)))
    x, y, heading = setup.x, setup.y, setup.heading
    strips, count = list[dict[str, Array]](), heading.size * y.size
    for column in range(x.size):
        progress(column * count, x.size * count)
        strips.append(setup.bands(slice(column, column + 1), slice(0, y.size)))
    bands = {
        name: Band(label, np.concatenate([each[name] for each in strips], axis=1))
        for name, label in setup.labels().items()
    }
    poses = Atlas(x, y, heading, bands, setup.poses().reasons)
    _, found = setup.site.summary_of(poses, slice(0, x.size), slice(0, y.size))
    allowed = found.codes == 0
    places = allowed.any(axis=0)
    words = (
        f"at {places.sum()} of {places.size} places that were tried, {len(allowed)} headings each"
    )
    if not allowed.all():
        often = np.bincount(found.codes[~allowed]).argmax()
        words += f"; elsewhere mostly: {found.reasons[often]}"
    facts, size = [(f"{setup.vehicle.name} stands", words)], 2 * extents(setup.vehicle)[2]
    if min(grid.spacing) > size:
        words = f"larger than the vehicle ({size:.2g} m): roughness of its size is not in the map"
        facts.append(("cells of the map", words))
    if not allowed.any():
        return {}, facts
    # beside holes and borders, a motion would soon end
    room = uniform_filter(allowed.mean(axis=0), 3, mode="constant").round(9)
    is_free = allowed & (room == room[allowed.any(axis=0)].max())
    tilt = np.where(is_free, np.hypot(poses["roll"], poses["pitch"]), np.inf)
    k, i, j = np.unravel_index(tilt.argmin(), tilt.shape)
    turned = float(heading_column(heading[k], spec.frame).values)
    tilts = {name: float(poses[name][k, i, j]) for name in ("roll", "pitch")}
    shown = ", ".join(f"{name} {degrees(value):.3g} deg" for name, value in tilts.items())
    start = f'x = {x[i]:.10g}, y = {y[j]:.10g}, heading = "{degrees(turned):.4g} deg"'
    pose = {"x": float(x[i]), "y": float(y[j]), "heading": turned, **tilts}
    return pose, [*facts, ("start", f"{start} ({spec.frame}; {shown})")]


def distant_goal(grid: Grid, vehicle: Vehicle, x: float, y: float, heading: float) -> list[float]:
    """Return x and y of a goal for a vehicle: ahead, left, right or behind, as far as on the map.

    ``heading`` is counted from the x axis [rad].
    """
    here, reach, (west, east, south, north) = np.array([x, y]), extents(vehicle)[2], grid.domain
    low, high = np.array([west, south]), np.array([east, north])
    margin = np.minimum(reach, (high - low) / 2)
    turns = heading + np.pi * np.array([0.0, 0.5, -0.5, 1.0])
    goals = here + AHEAD * reach * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    goals = np.clip(goals, low + margin, high - margin)
    distances = np.linalg.norm(goals - here, axis=1).round(2)
    return [round(float(each), 3) for each in goals[np.argmax(distances)]]


def _known(grid: Grid) -> Mask:
    """Return the mask of nodes that have heights, as have their eight neighbours."""
    if grid.holes is None:
        return np.ones(grid.z.shape, dtype=bool)
    known = np.asarray(~binary_dilation(grid.holes, np.ones((3, 3), dtype=bool)))
    if not known.any():
        raise ModelError(
            "expected at least one node whose eight neighbours have heights, found a hole at or "
            f"beside every node ({100 * float(grid.holes.mean()):.3g} % of the nodes have no "
            "height); fill them: --set terrain.fill=linear"
        )
    return known
