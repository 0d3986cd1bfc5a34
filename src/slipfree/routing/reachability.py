"""Reachability of positions on a map, checked before a route or plan is computed."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy

from slipfree.atlas.atlas import atlas, least_bounds
from slipfree.core.records import Array, Mask
from slipfree.geometry.regions import Region
from slipfree.models.kinematics import direct_kinematics
from slipfree.routing.smoothing import resample_polyline
from slipfree.routing.traversability import (
    HEADINGS,
    SLIDING,
    Point,
    Traversability,
    blocking_reasons,
    extents,
    more_friction_words,
    node_at,
    out_of_bounds,
    point_text,
    reasons_by_kind,
    to_edge,
)
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.tree import Vehicle

REMEDIES = {
    "edge": "use a larger map",
    "keep_out": "make the keep-out region smaller",
}
Ends = tuple[tuple[int, int], tuple[int, int]]  # nodes


class Objection(NamedTuple):
    """Reason why a position cannot be part of a motion."""

    name: str  # name of the position, such as ``"goal"``
    words: str  # the reason with numbers, and a remedy


def unreachable(
    layers: Traversability, positions: Sequence[tuple[str, float, float]]
) -> list[Objection]:
    """Return the objections to named positions, the first of which is the start.

    Positions are off the map or within reach of a keep-out region, or such regions separate them
    from the start. No other reason is sure: a route requires space for every heading, a motion does
    not.
    """
    objections = [
        each for position in positions if (each := _position_objection(layers, *position))
    ]
    off = {each.name for each in objections}
    first, *others = positions
    if first[0] in off:
        return objections
    for name, x, y in others:
        if name not in off and (why := _keep_out_words(layers, first[1:], (x, y))):
            words = (
                f"the {name} {point_text((x, y))} cannot be reached from the {first[0]} "
                f"{point_text(first[1:])}: {why}"
            )
            objections.append(Objection(name, words))
    return objections


def unheld_words(terrain: Bicubic, vehicle: Vehicle, x: float, y: float) -> str:
    """Return a text if friction certainly holds the vehicle at no heading at a point; else empty.

    Poses are computed only where the mean slope of the ground exceeds the friction.
    """
    if terrain.mu is None or not vehicle.mass:
        return ""
    half = extents(vehicle)[2] / 2
    ends = terrain.elevation(x + half * np.array([1, -1, 0, 0]), y + half * np.array([0, 0, 1, -1]))
    slope = np.hypot(*(ends[::2] - ends[1::2])) / (2 * half)
    grip = max(wheel.grip for wheel in vehicle.wheels)
    limit = float(terrain.mu) * grip if isinstance(terrain.mu, float | int) else 0.0
    if slope <= limit:
        return ""
    model = direct_kinematics(vehicle, terrain)
    poses = atlas(model, headings=HEADINGS, x=np.array([x]), y=np.array([y]), compiled=False)
    bounds = least_bounds(poses)
    if bounds is None or not poses.stands.any():
        return ""
    factor = float(np.nanmin(poses[bounds[0].name])) / (limit or 1.0)
    return more_friction_words(factor) if factor > 1 else ""


def no_route_words(layers: Traversability, start: Array, goal: Array) -> str:
    """Return the text of an error for a goal that cannot be reached."""
    regions = _labels(np.isfinite(layers.least_cost))
    i, j = np.nonzero(regions == regions[node_at(layers, *start)])
    gaps = np.hypot(layers.x[i] - goal[0], layers.y[j] - goal[1])
    best = int(gaps.argmin())
    nearest = np.array([layers.x[i[best]], layers.y[j[best]]])
    ahead = resample_polyline(np.stack([nearest, goal]), 0.5 * min(layers.spacing))
    why = next((w for w in (blocking_reasons(layers, *point) for point in ahead.tolist()) if w), "")
    return (
        f"no route leads from {point_text(start)} to {point_text(goal)}: the ground that can be "
        f"reached ends at {point_text(nearest)}, {gaps[best]:.3g} m from the goal"
        + (f"; beyond it: {why}" if why else "")
        + "; move the start or the goal"
    )


def separation_words(layers: Traversability, places: Sequence[Point], *, by_friction: bool) -> str:
    """Return where the ground that can be reached ends between places; empty if it connects them.

    Blocked are poses that friction does not hold, or else only positions where in some heading a
    wheel could reach over the edge of the map, into a hole or into a keep-out region.
    """
    if len(places) < 2:
        return ""
    blocked = layers.cost >= SLIDING
    if not by_friction:
        blocked = np.logical_or.reduce([*out_of_bounds(layers).values()])[None]
    held = layers._replace(cost=np.where(blocked, np.inf, layers.cost))
    regions = _labels(np.isfinite(held.least_cost))
    for start, goal in pairwise(np.asarray(places)):
        if regions[node_at(held, *start)] != regions[node_at(held, *goal)]:
            return no_route_words(held, start, goal)
    return ""


def _position_objection(layers: Traversability, name: str, x: float, y: float) -> Objection | None:
    """Return the reason why the vehicle cannot be at a position, or None."""
    is_off = to_edge(layers.limits, np.asarray(x), np.asarray(y)) < 0
    kinds = ("edge", "keep_out") if is_off else ("keep_out",)
    reasons = reasons_by_kind(layers, x, y)
    why = {kind: reasons[kind] for kind in kinds if kind in reasons}
    if not why:
        return None
    remedies = " or ".join([f"move the {name}", *(REMEDIES[kind] for kind in why)])
    place = point_text((x, y))
    words = f"the vehicle cannot be at the {name} {place}: {'; '.join(why.values())}; {remedies}"
    return Objection(name, words)


def _keep_out_words(layers: Traversability, start: Point, goal: Point) -> str:
    """Return which keep-out regions separate start and goal; empty if they do not."""
    ends = node_at(layers, *start), node_at(layers, *goal)
    regions = layers.limits.keep_out
    if not _divides(layers, regions, ends):
        return ""
    alone = [region for region in regions if _divides(layers, (region,), ends)]
    if alone:
        words = " and ".join(region.words for region in alone)
        if len(alone) > 1:
            return (
                f"each of the keep-out regions {words} separates them; make these regions smaller "
                "or move them"
            )
        return (
            f"the keep-out {words} lies between them, and no route leads around it; make "
            "it smaller or move it"
        )
    needed = [
        region
        for region in regions
        if not _divides(layers, tuple(other for other in regions if other is not region), ends)
    ]
    words = ", ".join(region.words for region in needed or regions)
    return f"several keep-out regions together separate them: {words}; make one smaller or move it"


def _divides(layers: Traversability, regions: tuple[Region, ...], ends: Ends) -> bool:
    """Return whether keep-out regions separate two nodes."""
    limits = layers.limits._replace(keep_out=regions)
    free = ~out_of_bounds(layers._replace(limits=limits))["keep_out"]
    free[ends[0]] = free[ends[1]] = True
    labels = _labels(free)
    return bool(labels[ends[0]] != labels[ends[1]])


def _labels(free: Mask) -> Array:
    """Return labels of the connected regions of free nodes, from 1; 0 for blocked nodes."""
    return np.asarray(scipy.ndimage.label(free)[0])
