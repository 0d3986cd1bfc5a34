"""Reachability of positions on a map, checked before a route or plan is computed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from slipfree.core.records import Array, Mask
from slipfree.geometry.regions import Region
from slipfree.routing.smoothing import resample_polyline
from slipfree.routing.traversability import (
    Traversability,
    blocked_by,
    blocking_reasons,
    node_at,
    point_text,
    reasons_by_kind,
    to_edge,
)

REMEDIES = {
    "edge": "use a larger map",
    "hole": 'interpolate small holes by terrain.fill = "linear"',
    "friction": "give the ground more friction",
    "keep_out": "make the keep-out region smaller",
}
SURE = ("friction", "keep_out")
Ends = tuple[tuple[int, int], tuple[int, int]]  # nodes


class Objection(NamedTuple):
    """Reason why a position cannot be part of a motion."""

    name: str  # name of the position, such as ``"goal"``
    words: str  # the reason with numbers, and a remedy
    # whether the position is an error: off the map, within reach of a keep-out region or on a slope
    # that friction cannot hold, or one of these two separates it from the start. Otherwise only the
    # search for a route fails, since it requires space for every heading; a motion may still exist
    sure: bool


def unreachable(
    layers: Traversability, positions: Sequence[tuple[str, float, float]]
) -> list[Objection]:
    """Return the objections to named positions, the first of which is the start."""
    objections = [
        each for position in positions if (each := _position_objection(layers, *position))
    ]
    off = {each.name: each.sure for each in objections}
    first, *others = positions
    if off.get(first[0], False):
        return objections
    for other in others:
        if not off.get(other[0], False):
            each = _separation_objection(
                layers, first, other, is_judged=not {first[0], other[0]} & set(off)
            )
            objections += [each] if each else []
    return objections


def no_route_words(layers: Traversability, start: Array, goal: Array) -> str:
    """Return the text of an error for a goal that cannot be reached."""
    regions = _labels(np.isfinite(layers.cost))
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


def _position_objection(layers: Traversability, name: str, x: float, y: float) -> Objection | None:
    """Return the reason why the vehicle cannot be at a position or its nearest node, or None."""
    wrong = reasons_by_kind(layers, x, y)
    why = "; ".join(wrong.values()) or blocking_reasons(layers, x, y)
    if not why:
        return None
    remedies = [f"move the {name}", *(REMEDIES[kind] for kind in wrong if kind in REMEDIES)]
    words = (
        f"the vehicle cannot be at the {name} {point_text((x, y))}: {why}; {' or '.join(remedies)}"
    )
    is_off = to_edge(layers.limits, np.asarray(x), np.asarray(y)) < 0
    return Objection(name, words, bool(is_off) or any(kind in wrong for kind in SURE))


def _separation_objection(
    layers: Traversability,
    first: tuple[str, float, float],
    last: tuple[str, float, float],
    is_judged: bool,
) -> Objection | None:
    """Return the reason why ``last`` cannot be reached from ``first``, or None.

    Keep-out regions and slopes that friction cannot hold are always considered, missing routes only
    if ``is_judged``.
    """
    ends = node_at(layers, *first[1:]), node_at(layers, *last[1:])
    if _are_connected(np.isfinite(layers.cost), ends):
        return None
    masks, used = blocked_by(layers), layers.friction
    start, goal = np.array(first[1:]), np.array(last[1:])
    why = _keep_out_words(layers, ends)
    if (
        not why
        and used is not None
        and not _are_connected(~(masks["friction"] | masks["keep_out"]), ends)
    ):
        why = _steepest_words(layers, np.where(masks["keep_out"], math.inf, used), ends)
    if why:
        words = (
            f"the {last[0]} {point_text(goal)} cannot be reached from the {first[0]} "
            f"{point_text(start)}: {why}"
        )
        return Objection(last[0], words, True)
    if not is_judged:
        return None
    return Objection(last[0], no_route_words(layers, start, goal), False)


def _keep_out_words(layers: Traversability, ends: Ends) -> str:
    """Return a text about the keep-out regions that separate two nodes; empty if none do."""
    if _are_connected(~blocked_by(layers)["keep_out"], ends):
        return ""
    regions = layers.limits.keep_out
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
    return not _are_connected(~blocked_by(layers._replace(limits=limits))["keep_out"], ends)


def _steepest_words(layers: Traversability, used: Array, ends: Ends) -> str:
    """Return a text about the steepest slope on the route of least largest ``used`` friction."""
    levels = np.unique(used[np.isfinite(used) & (used >= 1)])
    low, high = 0, levels.size - 1
    while low < high:
        middle = (low + high) // 2
        low, high = (
            (low, middle) if _are_connected(used <= levels[middle], ends) else (middle + 1, high)
        )
    i, j = np.nonzero(used == levels[low])
    from_ends = sum(np.hypot(i - end[0], j - end[1]) for end in ends)
    k = int(np.argmin(from_ends))
    slope = float(layers.slope[i[k], j[k]])
    at = point_text((layers.x[i[k]], layers.y[j[k]]))
    return (
        f"even the easiest route crosses a slope of {math.degrees(slope):.3g} degrees at {at}, "
        f"which needs a friction coefficient of {math.tan(slope):.3g}, and the ground offers "
        f"{math.tan(slope) / levels[low]:.3g}; move the goal, or give the ground more friction"
    )


def _labels(free: Mask) -> Array:
    """Return labels of the connected regions of free nodes, from 1; 0 for blocked nodes."""
    return np.asarray(scipy.ndimage.label(free)[0])


def _are_connected(free: Mask, ends: Ends) -> bool:
    """Return whether free ground connects two nodes; the two nodes count as free."""
    free = free.copy()
    free[ends[0]] = free[ends[1]] = True
    labels = _labels(free)
    return bool(labels[ends[0]] == labels[ends[1]])
