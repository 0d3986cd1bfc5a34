"""Planned climbs driven: the plan's torques ahead, and its rates back.

Where a climb is, is told by how far the vehicle has come, not by time, so that a vehicle that lags
behind gets the torques of the place where it is. The measure of it is

    p = mean over the axles of x + z,

which grows along every way that does not lead steeply down, at least as fast as the mean axle goes.
The torques are those of the plan, which share friction among the wheels as no control of rates
does. What is missing, each wheel gets from its rate; its reference is that of the plan, but never
more than what its axle goes, and a little. A wheel that is left behind regains its grip in this
way, even if it rolls back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import casadi as ca
import numpy as np

from slipfree.climb.contact_path import axle_arms
from slipfree.climb.control import Commands, limited
from slipfree.climb.records import State
from slipfree.climb.reference import PerAxle
from slipfree.climb.time_scaling import Climb, history
from slipfree.climb.vehicle import Climber
from slipfree.errors import ModelError
from slipfree.records import Array

SLOWEST = 0.01  # reference where the plan rests, so that it gets away from there [m/s]
BRAKING = 0.3  # before the plan begins, and of the speeding up behind it [m/s2]
APART = 1e-7  # of legs that meet, whose torques differ there [m]


@dataclass(frozen=True, eq=False)
class Course:
    """A planned climb over the progress p, linear between n places.

    Attributes
    ----------
    p : ndarray, shape (n,)
        Progress, increasing. [m]
    square : ndarray, shape (n,)
        Square of the speed along the way. [m2/s2]
    speeds : ndarray, shape (n, 3)
        Speeds of the axles over that along the way.
    directions : ndarray, shape (n, 3)
        Of the axles' motion, up from the horizontal. [rad]
    torques : ndarray, shape (n, 3)
        Of a wheel's motor. [N m]
    """

    p: Array
    square: Array
    speeds: Array
    directions: Array
    torques: Array


class _Place(NamedTuple):
    """The row of a course where the vehicle is, and whether that is before or behind it."""

    square: ca.SX
    speeds: PerAxle
    directions: PerAxle
    torques: PerAxle
    before: ca.SX
    behind: ca.SX


@dataclass(frozen=True, eq=False)
class Tracking:
    """How a planned climb is driven; `slipfree.climb.dynamics.climbing` takes it for a control.

    It knows places and speeds of the axles, which only a simulation does.

    Attributes
    ----------
    course : Course
        The plan.
    proportional : float
        Gain of the wheels' rates. [N m s/rad]
    spare : float
        Slip that the references allow a wheel: about where friction is largest. [m/s]
    lead : float
        By which the plan is read ahead: more than wheels sink into the ground, lest they be held
        in front of what they are to push against. [m]

    Raises
    ------
    ModelError
        If a number is not positive.
    """

    course: Course
    proportional: float = 20.0
    spare: float = 3e-3
    lead: float = 1e-3
    # It has no states of its own.
    senses: ClassVar[bool] = False
    integral: ClassVar[float] = 0.0
    derivative: ClassVar[float] = 0.0
    lag: ClassVar[float] = 1.0

    def __post_init__(self) -> None:
        for name in ("proportional", "spare", "lead"):
            if not getattr(self, name) > 0:
                raise ModelError(f"tracking: {name} must be positive, found {getattr(self, name)}")


def course(plans: Sequence[tuple[Climb, Array]]) -> Course:
    """Return planned legs, one after the other, over the progress.

    Parameters
    ----------
    plans : sequence of (Climb, ndarray)
        Every leg's program from `slipfree.climb.time_scaling.climb`, and its solution; all but the
        last one planned with a halt.

    Raises
    ------
    ModelError
        If a way leads down so steeply that the progress does not grow.
    """
    p, *rest = (np.concatenate(each) for each in zip(*map(_leg, plans), strict=True))
    joints = np.cumsum([2 * plan.nodes.s.size - 1 for plan, _ in plans])[:-1]
    p[joints] = np.maximum(p[joints], p[joints - 1] + APART)
    if not (np.diff(p) > 0).all():
        k = int(np.argmin(np.diff(p)))
        raise ModelError(
            "course: expected a way on which the mean of place and height of the axles grows, "
            f"found that it falls at {p[k]:.3g} m: take a plan that does not lead steeply down"
        )
    return Course(p, *rest)


def _leg(plan_and_unknowns: tuple[Climb, Array]) -> tuple[Array, ...]:
    """Return the fields of a leg's course, at its nodes and in their middles."""
    plan, unknowns = plan_and_unknowns
    nodes, middles, torque = plan.nodes, plan.middles, history(plan, unknowns)["torque"]
    square = np.maximum(unknowns[plan.nlp.where["b"]], 0)
    at_nodes = np.column_stack([np.interp(nodes.s, middles.s, each) for each in torque.T])
    parts = []
    for way, squares, torques in (
        (nodes, square, at_nodes),
        (middles, (square[1:] + square[:-1]) / 2, torque),
    ):
        axles = way.q[:, None, :2] + axle_arms(plan.climber, way.q)
        directions = np.arctan2(-way.normals[..., 0], way.normals[..., 1])
        progress = axles.sum(axis=2).mean(axis=1)
        parts.append((progress, squares, way.speeds, directions, torques))
    order = np.argsort(np.concatenate([nodes.s, middles.s]))
    return tuple(np.concatenate(pair)[order] for pair in zip(*parts, strict=True))


def tracked(
    control: Tracking,
    climber: Climber,
    x: State,
    axles: PerAxle,
    velocities: PerAxle,
    speed: ca.SX,
) -> Commands:
    """Return references and torques of a planned climb.

    Before the plan begins, and behind its end, all wheels are driven at the vehicle's speed; before
    it they brake, since plans begin at rest.

    Parameters
    ----------
    control : Tracking
        The plan, and how it is tracked.
    climber : Climber
        The vehicle.
    x : State
        Of its motion.
    axles, velocities : PerAxle of SX, shape (2, 1)
        Places and velocities of its axles. [m, m/s]
    speed : SX
        Of the vehicle off the plan. [m/s]
    """
    p = sum(place[0] + place[1] for place in axles) / 3 + control.lead
    at = _place(control.course, p)
    pace = _pace(control.course, p, at, speed)
    references, wanted = [], []
    for ratio, angle, torque, velocity, spin in zip(
        at.speeds, at.directions, at.torques, velocities, x.spins, strict=True
    ):
        gone = velocity[0] * ca.cos(angle) + velocity[1] * ca.sin(angle)
        references.append(ca.fmin(pace * ratio, gone + control.spare) / climber.radius)
        wanted.append(torque + control.proportional * (references[-1] - spin))
    return Commands(PerAxle(*references), limited(climber.torque, PerAxle(*wanted)), ())


def _place(course: Course, p: ca.SX) -> _Place:
    columns = [course.square, course.speeds, course.directions, course.torques]
    rows, inside = np.column_stack(columns), ca.fmin(ca.fmax(p, course.p[0]), course.p[-1])
    table = ca.interpolant("table", "linear", [course.p.tolist()], rows.ravel().tolist())
    at = ca.MX.sym("p")
    row = ca.vertsplit(ca.Function("course", [at], [table(at)], {"never_inline": True})(inside))
    before, behind = p < course.p[0], p > course.p[-1]
    off = ca.logic_or(before, behind)
    speeds, directions, torques = (
        PerAxle(*(ca.if_else(off, value, each) for each in row[k : k + 3]))
        for k, value in ((1, 1.0), (4, 0.0), (7, 0.0))
    )
    return _Place(row[0], speeds, directions, torques, before, behind)


def _pace(course: Course, p: ca.SX, at: _Place, speed: ca.SX) -> ca.SX:
    """Return the reference of the speed along the way, on the plan and off it. [m/s]."""
    arriving = 2 * BRAKING * ca.fmax(course.p[0] - p, 0)
    leaving = at.square + 2 * BRAKING * ca.fmax(p - course.p[-1], 0)
    square = ca.if_else(at.before, arriving, ca.if_else(at.behind, leaving, at.square))
    pace = ca.sqrt(square + SLOWEST**2)
    found: ca.SX = ca.if_else(ca.logic_or(at.before, at.behind), ca.fmin(speed, pace), pace)
    return found
