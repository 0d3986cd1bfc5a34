"""Solids of a problem: obstacles on the ground, for dynamics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from slipfree.files.toml.errors import Fault, problem_error
from slipfree.problem.build_common import heading_offset
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem, S
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.solids import (
    Prism,
    Profile,
    Solid,
    flat,
    kerb,
    placed,
    ramp,
    stairs,
    step,
)

OBSTACLES: Mapping[str, Callable[..., Profile]] = {
    "ramp": ramp,
    "step": step,
    "kerb": kerb,
    "stairs": stairs,
}
KINDS = (*OBSTACLES, "points")


def build_solids(problem: Problem[S], terrain: Bicubic) -> tuple[Prism, ...]:
    """Return the obstacles of a ground as prisms that stand on it.

    Height zero of an obstacle's profile is the height of the ground where the profile begins.

    Raises
    ------
    ProblemError
        If an obstacle is not of exactly one kind, its numbers are invalid, or it begins off the
        map.
    """
    found = list[Prism]()
    for k, spec in enumerate(problem.spec.terrain.obstacles):
        place = ("terrain", "obstacles", k)
        given = [name for name in KINDS if getattr(spec, name) is not None]
        if len(given) != 1:
            expected = f"one of {', '.join(KINDS)}"
            words = f"{', '.join(given) or 'none'}; give one of them"
            raise problem_error(problem.source, [Fault(place, expected, words)])
        with at(problem, (*place, given[0])):
            profile = _profile(given[0], getattr(spec, given[0]))
        west, east, south, north = terrain.domain
        if not (west <= spec.x <= east and south <= spec.y <= north):
            expected = f"x from {west:g} to {east:g} m and y from {south:g} to {north:g} m"
            words = f"x = {spec.x:g} m, y = {spec.y:g} m, off the map; move the obstacle"
            raise problem_error(problem.source, [Fault(place, expected, words)])
        heading = spec.heading + heading_offset(problem)
        z = float(terrain.elevation(np.array(spec.x), np.array(spec.y)))
        where: dict[str, Any] = {"x": spec.x, "y": spec.y, "z": z, "heading": heading}
        found += placed(profile, **where, half_width=spec.half_width)
    return tuple(found)


def _profile(name: str, spec: Any) -> Profile:
    """Return the profile of an obstacle of a given kind, with a floor as its first solid."""
    if name == "points":
        return Profile((*flat().solids, Solid(spec)))
    return OBSTACLES[name](**dict(spec))
