"""Whether a vehicle can be at places of a map and get from one to another, before it is sought."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from slipfree.records import Array, Mask
from slipfree.routing.regions import Region
from slipfree.routing.smoothing import evenly
from slipfree.routing.traversability import (
    Traversability,
    blocked_by,
    faults,
    node_at,
    placed,
    reasons,
    to_edge,
)

REMEDIES = {
    "edge": "take a larger map",
    "friction": "give the ground more friction",
    "keep_out": "make the keep-out smaller",
}
SURE = ("friction", "keep_out")
Ends = tuple[tuple[int, int], tuple[int, int]]  # nodes


class Objection(NamedTuple):
    """Why a place cannot be part of a motion.

    Attributes
    ----------
    place : str
        Its name.
    words : str
        What is wrong, with numbers, and what to do.
    sure : bool
        Whether no motion can be there in any heading: it is off the map, in a place to keep out
        of, or on a slope or behind one that friction cannot hold. Else a route cannot be found,
        because that asks for room in every heading and for ground that is not too steep, rough or
        hollow for the footprint; single motions may still pass.
    """

    place: str
    words: str
    sure: bool


def unreachable(
    layers: Traversability, places: Sequence[tuple[str, float, float]]
) -> list[Objection]:
    """Return what is wrong with places that a motion should pass; nothing if a route passes them.

    Parameters
    ----------
    layers : Traversability
        The map.
    places : sequence of (str, float, float)
        Name, and ``x`` and ``y`` in map coordinates; the first is where the vehicle begins. [m]

    Returns
    -------
    list of Objection
        Those about places by themselves, then those about places that cannot be reached from the
        first one.
    """
    found = [each for place in places if (each := _standing(layers, *place))]
    off = {each.place: each.sure for each in found}
    first, *others = places
    if off.get(first[0], False):
        return found
    for place in others:
        if not off.get(place[0], False):
            each = _divided(layers, first, place, is_judged=not {first[0], place[0]} & set(off))
            found += [each] if each else []
    return found


def no_way(layers: Traversability, reached: Mask, start: Array, goal: Array) -> str:
    """Return in words how far towards a goal the ground that can be reached goes.

    Parameters
    ----------
    layers : Traversability
        The map.
    reached : ndarray of bool, shape (n_x, n_y)
        Where one gets to from the start.
    start, goal : ndarray, shape (2,)
        Map coordinates. [m]
    """
    i, j = np.nonzero(reached)
    gaps = np.hypot(layers.x[i] - goal[0], layers.y[j] - goal[1])
    best = int(gaps.argmin())
    nearest = np.array([layers.x[i[best]], layers.y[j[best]]])
    ahead = evenly(np.stack([nearest, goal]), 0.5 * min(layers.spacing))
    why = next((w for w in (reasons(layers, *point) for point in ahead.tolist()) if w), "")
    return (
        f"no way leads from {placed(start)} to {placed(goal)}: the ground that can be reached "
        f"ends at {placed(nearest)}, {gaps[best]:.3g} m from the goal"
        + (f"; beyond it: {why}" if why else "")
    )


def _standing(layers: Traversability, name: str, x: float, y: float) -> Objection | None:
    """Return what keeps the vehicle from a place, or a route from the node next to it."""
    wrong = faults(layers, x, y)
    why = "; ".join(wrong.values()) or reasons(layers, x, y)
    if not why:
        return None
    remedies = [f"move the {name}", *(REMEDIES[kind] for kind in wrong if kind in REMEDIES)]
    words = f"the vehicle cannot be at the {name} {placed((x, y))}: {why}; {' or '.join(remedies)}"
    is_off = to_edge(layers.limits, np.asarray(x), np.asarray(y)) < 0
    return Objection(name, words, bool(is_off) or any(kind in wrong for kind in SURE))


def _divided(
    layers: Traversability,
    first: tuple[str, float, float],
    last: tuple[str, float, float],
    is_judged: bool,
) -> Objection | None:
    """Return what lies between two places, each of which is possible."""
    ends = node_at(layers, *first[1:]), node_at(layers, *last[1:])
    if _joined(np.isfinite(layers.cost), ends):
        return None
    masks, used = blocked_by(layers), layers.friction
    start, goal = np.array(first[1:]), np.array(last[1:])
    why = _keep_outs(layers, ends)
    if not why and used is not None and not _joined(~(masks["friction"] | masks["keep_out"]), ends):
        why = _steepest(layers, np.where(masks["keep_out"], math.inf, used), ends)
    if why:
        words = (
            f"the {last[0]} {placed(goal)} cannot be reached from the {first[0]} {placed(start)}: "
            f"{why}"
        )
        return Objection(last[0], words, True)
    if not is_judged:
        return None
    reached = _labels(np.isfinite(layers.cost))
    words = no_way(layers, reached == reached[ends[0]], start, goal)
    return Objection(last[0], words, False)


def _keep_outs(layers: Traversability, ends: Ends) -> str:
    """Return which places to keep out of divide the map, empty if they do not."""
    if _joined(~blocked_by(layers)["keep_out"], ends):
        return ""
    regions = layers.limits.keep_out
    alone = [region for region in regions if _divides(layers, (region,), ends)]
    if alone:
        words = " and ".join(region.words for region in alone)
        verb, it = ("lie", "them") if len(alone) > 1 else ("lies", "it")
        return f"the keep-out {words} {verb} between them, and the map has no way around {it}"
    needed = [
        region
        for region in regions
        if not _divides(layers, tuple(other for other in regions if other is not region), ends)
    ]
    words = ", ".join(region.words for region in needed or regions)
    return f"keep-outs together close the way between them: {words}"


def _divides(
    layers: Traversability,
    regions: tuple[Region, ...],
    ends: Ends,
) -> bool:
    """Return whether some places to keep out of are enough to divide the map."""
    limits = layers.limits._replace(keep_out=regions)
    return not _joined(~blocked_by(layers._replace(limits=limits))["keep_out"], ends)


def _steepest(layers: Traversability, used: Array, ends: Ends) -> str:
    """Return where the easiest way between two places needs most friction, and how much.

    That is where the part of friction that is ``used`` is least among the levels below which the
    ground is in one piece.
    """
    levels = np.unique(used[np.isfinite(used) & (used >= 1)])
    low, high = 0, levels.size - 1
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if _joined(used <= levels[middle], ends) else (middle + 1, high)
    i, j = np.nonzero(used == levels[low])
    from_ends = sum(np.hypot(i - end[0], j - end[1]) for end in ends)
    k = int(np.argmin(from_ends))
    slope = float(layers.slope[i[k], j[k]])
    place = placed((layers.x[i[k]], layers.y[j[k]]))
    return (
        f"even the easiest way crosses a slope of {math.degrees(slope):.3g} degrees at {place}, "
        f"which needs a friction coefficient of {math.tan(slope):.3g}, and the ground offers "
        f"{math.tan(slope) / levels[low]:.3g}; move the goal, or give the ground more friction"
    )


def _labels(free: Mask) -> Array:
    """Return a number for each piece of ground; the moves of a route do not cut corners."""
    return np.asarray(ndimage.label(free)[0])


def _joined(free: Mask, ends: Ends) -> bool:
    """Return whether free ground leads from a node to another; these two count as free."""
    free = free.copy()
    free[ends[0]] = free[ends[1]] = True
    labels = _labels(free)
    return bool(labels[ends[0]] == labels[ends[1]])
