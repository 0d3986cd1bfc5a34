"""Editing of the places of a planning problem: start, goal and keep-out regions.

Comments and layout of the problem file are preserved.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import tomlkit

from slipfree.errors import DataError
from slipfree.problem.problem import Problem
from slipfree.problem.verbs.plan_goals import way_points_of
from slipfree.problem.verbs.plan_schema import Plan

SAME = 1e-9  # smaller changes are rounding [m, rad]
DIGITS = 4  # decimals of changed values [m, rad]
MAX_REGIONS, MAX_CORNERS = 500, 500  # largest numbers of regions, and of corners of a region
DEGREES = {"x": "longitude", "y": "latitude"}
Point = tuple[float, float]


class Region(NamedTuple):
    """A keep-out region: a disc, or a polygon without ``radius``.

    Attributes
    ----------
    row : int or None
        Index of the region in the problem file; None for a new region.
    points : tuple of (x, y)
        Corners of the polygon, or the centre of the disc. [m]
    radius : float or None
        Radius of the disc. [m]
    """

    row: int | None
    points: tuple[Point, ...]
    radius: float | None = None


class Places(NamedTuple):
    """Start, goal and keep-out regions of a planning problem, in map coordinates.

    Attributes
    ----------
    start : tuple of float
        x, y and heading in the frame of the problem. [m, m, rad]
    goal : tuple of float or None
        x and y, the middles of ranges; None if the goal has no x or no y. [m]
    goal_heading : float or None
        Heading at the goal; None if the goal gives no heading or a range. [rad]
    regions : tuple of Region
        Keep-out regions.
    """

    start: tuple[float, float, float]
    goal: Point | None
    goal_heading: float | None
    regions: tuple[Region, ...]


def places_in(problem: Problem[Plan]) -> Places:
    """Return the places of a problem."""
    spec, goal = problem.spec, None
    start = (*(float(spec.start.get(name, 0.0)) for name in ("x", "y", "heading")),)
    bounds: Mapping[str, Any] = spec.goal
    if {"x", "y"} <= set(bounds):
        goal = (sum(bounds["x"]) / 2, sum(bounds["y"]) / 2)
    turn = bounds.get("heading")
    heading = float(turn[0]) if turn is not None and turn[0] == turn[1] else None
    regions = []
    for index, each in enumerate(spec.keep_out):
        if each.points is not None:
            regions.append(Region(index, tuple((float(x), float(y)) for x, y in each.points)))
        elif None not in (each.x, each.y, each.radius):
            center = (float(each.x or 0.0), float(each.y or 0.0))
            regions.append(Region(index, (center,), float(each.radius or 0.0)))
    return Places((start[0], start[1], start[2]), goal, heading, tuple(regions))


def way_points_in(problem: Problem[Plan]) -> tuple[tuple[str, float, float], ...]:
    """Return name, x and y of the way-points that have both, the middles of ranges [m].

    Raises
    ------
    ProblemError
        If a fraction of the duration is missing or not valid.
    """
    return tuple(
        (f"way-point at {part:g}", sum(wanted["x"]) / 2, sum(wanted["y"]) / 2)
        for part, wanted in way_points_of(problem, problem.spec).items()
        if {"x", "y"} <= wanted.keys()
    )


def places_from(data: object) -> Places:
    """Return the places in a JSON object of the page.

    Raises
    ------
    DataError
        If the object does not have the form of `Places` or contains numbers that are not finite.
    """
    try:
        if not isinstance(data, Mapping):
            raise TypeError
        x, y, heading = map(_number, data["start"])
        goal = None if data["goal"] is None else _point(data["goal"])
        turn = None if data["goal_heading"] is None else _number(data["goal_heading"])
        if len(data["regions"]) > MAX_REGIONS:
            raise ValueError
        return Places((x, y, heading), goal, turn, tuple(map(_region, data["regions"])))
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(
            "expected start, goal, goal_heading and regions with finite numbers, found other "
            "values; reload the page"
        ) from error


def _region(data: Mapping[str, Any]) -> Region:
    row, points = data["row"], tuple(map(_point, data["points"]))
    radius = None if data["radius"] is None else _number(data["radius"])
    if not (row is None or (type(row) is int and row >= 0)):
        raise ValueError
    if radius is None and not 3 <= len(points) <= MAX_CORNERS:
        raise ValueError
    if radius is not None and (len(points) != 1 or radius <= 0):
        raise ValueError
    return Region(row, points, radius)


def _point(data: Sequence[Any]) -> Point:
    x, y = map(_number, data)
    return x, y


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError
    return float(value)


def edited_text(text: str, old: Places, new: Places) -> str:
    """Return the text of a problem file with changed places.

    Values that have not changed keep their text. A range of the goal is moved as a whole.

    Parameters
    ----------
    text : str
        Text of the problem file.
    old : Places
        Places in the text.
    new : Places
        Places in the result.
    """
    document: Any = tomlkit.parse(text)
    start = document.setdefault("start", tomlkit.table())
    for name, before, after in zip(("x", "y", "heading"), old.start, new.start, strict=True):
        _move(start, name, before, after)
    if old.goal is not None and new.goal is not None:
        for name, before, after in zip(("x", "y"), old.goal, new.goal, strict=True):
            _move(document["goal"], name, before, after)
    if old.goal_heading is not None and new.goal_heading is not None:
        _move(document["goal"], "heading", old.goal_heading, new.goal_heading)
    if old.regions != new.regions:
        _edit_regions(document, old.regions, new.regions)
    found: str = document.as_string()
    return found


def _move(table: Any, name: str, before: float, after: float) -> None:
    """Change a value, or the ends of a range, by the difference of two numbers."""
    if abs(after - before) <= SAME:
        return
    value = table.get(name)
    if isinstance(value, list):
        table[name] = [round(float(end) + after - before, DIGITS) for end in value]
    else:
        table[name] = round(after, DIGITS)
    table.pop(DEGREES.get(name, ""), None)


def _edit_regions(document: Any, old: Sequence[Region], new: Sequence[Region]) -> None:
    """Change, remove and add tables of keep-out regions."""
    kept = {each.row: each for each in new if each.row is not None}
    if not new:
        document.pop("keep_out", None)
        return
    tables = document.setdefault("keep_out", tomlkit.aot())
    former = {each.row: each for each in old}
    for index in reversed(range(len(tables))):
        if index not in former:
            continue
        if index not in kept:
            del tables[index]
        elif kept[index] != former[index]:
            _edit_region(tables[index], former[index], kept[index])
    is_inline = not isinstance(tables, tomlkit.items.AoT)
    for each in (each for each in new if each.row is None):
        table: Any = tomlkit.inline_table() if is_inline else tomlkit.table()
        table.update(dict(_values(each)))
        tables.append(table)


def _edit_region(table: Any, old: Region, new: Region) -> None:
    """Change the values of a region that differ."""
    before = dict(_values(old))
    for name, value in _values(new):
        if value != before.get(name):
            table[name] = value
            table.pop(DEGREES.get(name, ""), None)


def _values(region: Region) -> Iterator[tuple[str, Any]]:
    """Yield the keys of a region in a problem file, with values."""
    if region.radius is None:
        yield "points", [[round(x, DIGITS), round(y, DIGITS)] for x, y in region.points]
        return
    ((x, y),) = region.points
    yield from (("x", round(x, DIGITS)), ("y", round(y, DIGITS)))
    yield "radius", round(region.radius, DIGITS)
