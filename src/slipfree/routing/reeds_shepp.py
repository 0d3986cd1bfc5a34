"""Shortest paths of cars that drive forwards and backwards, without regard to the ground."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from slipfree.core.errors import ModelError

HEADINGS = 24  # number of final headings that are tried if none is given
MIN_LENGTH = 1e-6  # shorter arcs are omitted, in turning radii
PlanarPose = tuple[float, float, float]


class Arc(NamedTuple):
    """Arc of a circle or straight line."""

    length: float  # length, negative if the vehicle drives backwards [m]
    curvature: float  # change of the heading per metre driven forwards, positive to the left [1/m]


def reeds_shepp(
    start: PlanarPose,
    goal: tuple[float, float, float | None],
    turning_radius: float,
    ahead: float = 0.0,
) -> tuple[Arc, ...]:
    """Return the shortest path of a car between two poses, with cusps where it reverses.

    Poses are x, y and heading of the car's centre, which is ``ahead`` of the rear axle; the arcs
    are those of the middle of the rear axle. Without a final heading, the result is the shortest of
    the paths to 24 evenly spaced ones.

    J. A. Reeds and L. A. Shepp, "Optimal paths for a car that goes both forwards and backwards",
    Pacific Journal of Mathematics 145 (1990), 367-393.
    """
    from rsplan import planner  # imported here: only this function uses the package

    if not 0 < turning_radius < math.inf:
        raise ModelError(
            "reeds_shepp: expected a positive, finite 'turning_radius', found "
            f"{turning_radius:g} m; give that of the middle of the rear axle"
        )
    x, y, heading = goal
    spread = 2 * np.pi * np.arange(HEADINGS) / HEADINGS + start[2]
    paths = [
        planner.path(
            _rear(start, ahead),
            _rear((x, y, float(final)), ahead),
            turning_radius,
            0.0,
            turning_radius,
            length_tolerance=0.0,
        )
        for final in (spread if heading is None else [heading])
    ]
    best = min(paths, key=lambda path: float(path.total_length))
    bends = {"left": 1 / turning_radius, "right": -1 / turning_radius, "straight": 0.0}
    arcs = [
        Arc(segment.direction * abs(float(segment.length)), bends[segment.type])
        for segment in best.segments
    ]
    return tuple(arc for arc in arcs if abs(arc.length) > MIN_LENGTH * turning_radius)


def _rear(pose: PlanarPose, ahead: float) -> PlanarPose:
    """Return x, y and yaw from the x axis of the rear axle, for the pose of the centre."""
    x, y, heading = pose
    return x + math.sin(heading) * ahead, y - math.cos(heading) * ahead, heading + math.pi / 2
