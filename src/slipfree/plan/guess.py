"""Initial guesses of plans: motions of a driving law along routes, paths or arcs to the goal.

This is the only module of the planner that knows vehicles and grounds, those of `Dae.vehicle` and
`Dae.ground`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.control.path_following import (
    arc_inputs,
    driven_vehicle,
    follow,
    straight,
    turning_axis_offset,
    turning_radius,
)
from slipfree.core.arguments import checked
from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Record, leaves
from slipfree.core.schema import Positive
from slipfree.core.trajectory import Trajectory
from slipfree.geometry.path import Path
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.rigid_dynamics import dynamic_guess
from slipfree.plan.constraints import GOAL, role_of
from slipfree.plan.problem import Range, spelled
from slipfree.plan.transcription import SAMPLE_STEP, PlanTask
from slipfree.plan.verification import GUESS_TOLERANCE
from slipfree.routing.search import path_cost, route, routes
from slipfree.routing.traversability import Traversability, traversability
from slipfree.solve.sampling import input_samples
from slipfree.solve.settle import settle
from slipfree.solve.simulate import simulate_to_failure
from slipfree.solve.system import SolverOptions
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.tree import Vehicle

PACE = 0.5  # default speed, in sizes of the vehicle per second
FROUDE = 0.5  # default speed with inertia, relative to the root of gravity times size
BOUND_SHARE = 0.5  # default speed relative to that at the bounds of the wheel rates
AHEAD = 3.0  # distance driven to a goal without a place, in sizes of the vehicle
DETOUR = 1.1  # cost of a direct path, relative to a route, up to which it is preferred
SAME_PLACE = 1e-6  # distance of places that count as one [m]


@dataclass(frozen=True, eq=False)
class Trip:
    """Vehicle at its start, the places that it passes, and the heading at the last one."""

    dae: Dae  # model with the rates of wheels and commanded coordinates as inputs
    vehicle: Vehicle
    start: Trajectory
    places: Array  # shape (n, 2): start, way-points and goal, in map coordinates [m]
    heading: float | None  # at the goal, from the y axis [rad]
    has_inertia: bool = False  # whether the plan has

    @property
    def pose(self) -> tuple[float, float, float]:
        """Position and heading from the y axis at the start [m, rad]."""
        run = self.start.in_frame("paper")
        return float(run["x"][-1]), float(run["y"][-1]), float(run["heading"][-1])


class Guide(NamedTuple):
    """Driving law of initial guesses."""

    name: str  # "route", "follow", "straight" or "reeds-shepp"
    speed: float  # [m/s]
    turning_radius: float  # smallest one of a route or of arcs [m]
    paths: tuple[Array, ...] = ()  # to follow, shape (n, 2) each [m]


Drive = tuple[Record, Array]  # inputs, and times of the samples [s]


def trip_of(task: PlanTask, dae: Dae, start: Trajectory) -> Trip:
    """Return the trip of a task, driven by a model ``dae`` from its own ``start``.

    A place is the middle of its ranges on the map. Way-points without x or y are omitted; at the
    goal, a coordinate without a range is that of the place before.
    """
    labels = task.dae.state_names
    symbols = list(leaves(task.dae.x))
    where = {name: labels.index(name) for name in ("x", "y", "heading") if name in labels}
    # in map coordinates, the heading from the y axis
    places = [np.array([start[axis][-1] for axis in "xy"])]
    for condition in task.conditions:  # the goal is the last one
        ranges, role = dict[str, Range](), role_of(condition.fraction)
        for limit in condition.limits:
            for name, k in where.items():
                if ca.is_equal(limit.expression, symbols[k]):
                    away = task.dae.shift[0][k]
                    ranges[name] = limit.lower + away, limit.upper + away
        if len({"x", "y"} & ranges.keys()) > (role != GOAL):
            places.append(_middle(role, ranges, places[-1], dae.ground.domain))
    heading = sum(ranges["heading"]) / 2 if "heading" in ranges else None
    has_inertia = task.dae.replay is not None
    return Trip(dae, driven_vehicle(dae), start, np.array(places), heading, has_inertia)


def on_map(name: str, axis: str, bounds: Range, domain: tuple[float, ...]) -> Range:
    """Return the part of a range of x or y that lies on the map [m].

    ``name`` is that of the goal or way-point, for the ModelError if no part does; ``domain`` has
    the ends of the map in x, then in y [m].
    """
    west, east = domain[:2] if axis == "x" else domain[2:]
    low, high = max(bounds[0], west), min(bounds[1], east)
    if low > high:
        raise ModelError(
            f"{GOAL if name == GOAL else 'way_points'}: expected a {name} on the map, which "
            f"extends from {west:.10g} to {east:.10g} m in {axis}, found {axis} = "
            f"{spelled(bounds)} m; move the {name}"
        )
    return low, high


def _middle(
    name: str, ranges: Mapping[str, Range], before: Array, domain: tuple[float, ...]
) -> Array:
    """Return the middle of ranges on the map; that of an infinite range is near the one before."""
    place = before.copy()
    for k, axis in enumerate("xy"):
        if axis in ranges:
            low, high = on_map(name, axis, ranges[axis], domain)
            is_finite = np.isfinite([low, high]).all()
            place[k] = (low + high) / 2 if is_finite else np.clip(before[k], low, high)
    return place


def choose_guide(
    trip: Trip, bounds: Mapping[str, Range], layers: Traversability | None, *, count: int = 1
) -> Guide:
    """Return the driving law that suits a trip, with the default speed and turning radius.

    The vehicle reverses along arcs to a goal that it cannot reach by turning forwards, if the
    ``bounds`` of its inputs allow it. Otherwise it drives along at most ``count`` routes over the
    map; directly along the places if there is no map or no route, or where the first route is
    hardly cheaper; or straight ahead without a place to reach.
    """
    radius, size = turning_radius(trip.vehicle), trip.dae.size
    speed = FROUDE * math.sqrt(trip.vehicle.gravity * size) if trip.has_inertia else PACE * size
    fastest = [
        wheel.radius * bounds[name][1]
        for wheel in trip.vehicle.wheels
        if (name := f"{wheel.name}_rate") in bounds and 0 < bounds[name][1] < np.inf
    ]
    if fastest:
        speed = BOUND_SHARE * min(fastest)
    can_reverse = all(bounds.get(f"{w.name}_rate", (-1.0, 1.0))[0] < 0 for w in trip.vehicle.wheels)
    length = np.hypot(*np.diff(trip.places, axis=0).T).sum()
    if can_reverse and len(trip.places) == 2 and _needs_cusps(trip, radius):
        return Guide("reeds-shepp", speed, radius)
    if length < SAME_PLACE:
        return Guide("straight", speed, radius)
    if layers is not None:
        with suppress(ModelError):  # a plan may exist: a route needs space for every heading
            most = count if len(trip.places) == 2 else 1
            first, *others = ground_routes(layers, trip.places, turning_radius=radius, count=most)
            # a search succeeds more often from a path with fewer turns
            if path_cost(layers, trip.places) > DETOUR * path_cost(layers, first):
                return Guide("route", speed, radius, (first, *others))
            return Guide("follow", speed, radius, (trip.places, *others))
    return Guide("follow", speed, radius, (trip.places,))


def _needs_cusps(trip: Trip, radius: float) -> bool:
    """Return whether the goal is behind the vehicle or beside it, within its turning circles."""
    x, y, heading = trip.pose
    east, north = trip.places[-1] - (x, y)
    distance, bearing = np.hypot(east, north), np.arctan2(-east, north)
    turns = [bearing - heading] if distance > SAME_PLACE else []
    if trip.heading is not None:
        turns.append(trip.heading - (bearing if turns else heading))
    # a circle through both places that is tangent to a heading has the radius d / (2 sin(turn))
    return any(
        np.cos(turn) < 0 or distance < 2 * radius * abs(np.sin(turn)) - SAME_PLACE for turn in turns
    )


def ground_routes(
    layers: Traversability, places: Array, *, turning_radius: float, count: int = 1
) -> tuple[Array, ...]:
    """Return routes along places, shape (n, 2) each [m]; ``count`` is at most 1 with way-points."""
    if len(places) == 2:
        candidates = routes(layers, places[0], places[1], count, turning_radius=turning_radius)
        return tuple(each.points for each in candidates)
    if count > 1:
        raise ModelError(
            f"driver: expected count = 1 with way-points, found {count}; set count = 1, or remove "
            "the way-points"
        )
    legs = [route(layers, *pair, turning_radius=turning_radius) for pair in pairwise(places)]
    return (np.concatenate([legs[0], *(leg[1:] for leg in legs[1:])]),)


def guide_drives(
    trip: Trip, guide: Guide, *, step: float, longest: float = np.inf
) -> tuple[Drive, ...]:
    """Return inputs and sample times of the guesses of a guide, one per path.

    ``step`` is the time between samples, ``longest`` the longest duration of a drive straight ahead
    or along a path [s].
    """
    if guide.name == "reeds-shepp":
        goal = (*trip.places[-1].tolist(), trip.heading)
        ahead = turning_axis_offset(trip.vehicle)
        arcs = reeds_shepp(trip.pose, goal, guide.turning_radius, ahead)
        if not arcs:
            raise ModelError(
                "driver: expected a goal apart from the start, found one at the start; move the "
                "goal"
            )
        values = {c.name: float(trip.start[c.name][-1]) for c in trip.vehicle.of("commanded")}
        pieces, duration = arc_inputs(trip.dae, arcs, values, speed=guide.speed)
        t, rates = input_samples(duration, step, pieces)
        return ((trip.dae.inputs(**rates), t),)
    if guide.name == "straight":
        length = np.hypot(*(trip.places[-1] - trip.places[0])) or AHEAD * trip.dae.size
        laws = [(straight(trip.dae, trip.start, speed=guide.speed), length)]
    else:
        paths = [Path(points) for points in guide.paths]
        laws = [(follow(trip.dae, path, speed=guide.speed), path.length) for path in paths]
    return tuple(
        (law, input_samples(min(length / abs(guide.speed), longest), step, {})[0])
        for law, length in laws
    )


def guess_motion(
    dae: Dae, start: Trajectory, trip: Trip, guide: Guide, drive: Drive, options: SolverOptions
) -> Trajectory:
    """Return the motion of a guess with a model from its start, simulated with a loose tolerance.

    Along a path to a goal, it ends at its sample nearest to the goal. If the integrator fails after
    the first sample, it ends there.
    """
    rough = replace(options, tolerance=GUESS_TOLERANCE)
    run = simulate_to_failure(trip.dae, trip.start, *drive, rough, sampled_work=None)
    if guide.paths and len(trip.places) > 1:
        x, y = trip.places[-1]
        away = np.hypot(run["x"] - x, run["y"] - y)
        run = run.part(slice(max(int(away.argmin()), 1) + 1))
    return run if trip.dae is dae else dynamic_guess(dae, start, run)


def settled_start(dae: Dae, start: Trajectory, options: SolverOptions) -> Trajectory:
    """Return the start of a plan, settled for another model ``dae`` of the vehicle."""
    values: dict[str, Any] = {each.full: float(start.of(each)[-1]) for each in leaves(dae.labels.x)}
    return settle(dae, options=options, **values)


def initial_guess(
    task: PlanTask, start: Trajectory, options: SolverOptions
) -> tuple[Trajectory, float]:
    """Return a motion of a task's model from the start roughly to the goal, and its duration [s].

    The duration is that of the whole path, even if the motion ends before.
    """
    dae, ground = task.dae, task.dae.ground
    if dae.vehicle is None:
        raise ModelError(
            "plan: guess: expected at least one motion as initial guess for a model whose vehicle "
            "is not known, found none; give one, such as a simulated motion"
        )
    vehicle, driven, begin = driven_vehicle(dae), dae, start
    if dae.replay is not None:  # with inertia
        driven = direct_kinematics(vehicle, ground)
        begin = settled_start(driven, start, options)
    trip = trip_of(task, driven, begin)
    layers = None
    if isinstance(ground, Bicubic):
        left = task.deadline - time.monotonic()
        layers = traversability(ground, vehicle, places=trip.places, seconds=left)
    bounds = dict(zip(dae.input_names, task.inputs.tolist(), strict=True))
    guide = choose_guide(trip, bounds, layers)
    drive = guide_drives(trip, guide, step=SAMPLE_STEP)[0]
    return guess_motion(dae, start, trip, guide, drive, options), float(drive[1][-1])


HEADINGS = 24  # number of final headings that are tried if none is given
MIN_LENGTH = 1e-6  # shorter arcs are omitted, in turning radii
PlanarPose = tuple[float, float, float]


class Arc(NamedTuple):
    """Arc of a circle or straight line."""

    length: float  # length, negative if the vehicle drives backwards [m]
    curvature: float  # change of the heading per metre driven forwards, positive to the left [1/m]


@checked
def reeds_shepp(
    start: PlanarPose,
    goal: tuple[float, float, float | None],
    turning_radius: Positive,
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
