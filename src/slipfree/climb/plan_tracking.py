"""Tracking of planned climbs: feedforward of the torques and feedback of the wheel rates.

The plan is a function of the progress of the vehicle, not of time: a delayed vehicle receives the
torques planned for its position. The progress is

    p = mean over the axles of x + z.

It increases along every path that does not descend steeply. The feedforward torques of the plan
distribute the friction among the wheels better than control of the rates could. Feedback corrects
the rate of each wheel; its reference is that of the plan, but at most slightly more than the speed
of its axle, so that a wheel that slips regains its grip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import Annotated, NamedTuple

import casadi as ca
import numpy as np
from annotated_types import Gt

from slipfree.climb.contact_path import axle_arms
from slipfree.climb.time_scaling import Climb, history
from slipfree.control.reference_speeds import PerAxle
from slipfree.control.step_climbing import Commands, ControlState, Motors, Sensed, limited
from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.core.schema import check_bounds
from slipfree.vehicle.climber import Climber

MIN_SPEED = 0.01  # smallest reference speed, so that the vehicle leaves points of rest [m/s]
ACCELERATION = 0.3  # deceleration before the plan's start, acceleration after its end [m/s2]
LEG_DISTANCE = 1e-7  # distance between consecutive legs, whose torques differ where they meet [m]


@dataclass(frozen=True, eq=False)
class TrackedPlan:
    """A planned climb as a function of the progress p, linear between n points.

    Attributes
    ----------
    p : ndarray, shape (n,)
        Progress, increasing. [m]
    square : ndarray, shape (n,)
        Square of the speed along the path. [m2/s2]
    speeds : ndarray, shape (n, 3)
        Speeds of the axles divided by the speed along the path. [1]
    directions : ndarray, shape (n, 3)
        Directions of the axles' motion, upward from the horizontal. [rad]
    torques : ndarray, shape (n, 3)
        Total torques of the axles' motors. [N m]
    """

    p: Array
    square: Array
    speeds: Array
    directions: Array
    torques: Array


class _PlanPoint(NamedTuple):
    """Values of a `TrackedPlan` at a progress, and whether it is outside the plan (0 or 1)."""

    square: ca.SX
    speeds: PerAxle
    directions: PerAxle
    torques: PerAxle
    before: ca.SX
    behind: ca.SX


@dataclass(frozen=True, eq=False)
class Tracking:
    """Controller that tracks a planned climb, for `slipfree.control.step_climbing.climbing`.

    It uses true positions and speeds of the axles, which are known only in simulations.

    Attributes
    ----------
    plan : TrackedPlan
        Planned speeds, directions and torques as functions of the progress.
    proportional : float
        Proportional gain of the wheel-rate control. [N m s/rad]
    spare : float
        Largest excess of a wheel's reference rim speed over the speed of its axle. A good value is
        the slip speed at which friction is largest. [m/s]
    lead : float
        Distance added to the progress when the plan is evaluated. It must exceed the depth of the
        contacts; otherwise the plan stops a wheel before it touches the next solid. [m]
    torque : float
        Largest torque of a motor. [N m]
    motors : tuple of 3 int
        Numbers of motors of the axles.

    Raises
    ------
    ModelError
        If a number is not positive.
    """

    plan: TrackedPlan
    proportional: Annotated[float, Gt(0)] = 20.0
    spare: Annotated[float, Gt(0)] = 3e-3
    lead: Annotated[float, Gt(0)] = 1e-3
    torque: Annotated[float, Gt(0)] = inf
    motors: Motors = (2, 1, 2)

    def __post_init__(self) -> None:
        check_bounds(self)

    def labels(self, wheels: Sequence[str]) -> ControlState:  # noqa: ARG002 - of the protocol
        """Return empty labels: the controller has no states."""
        return ControlState()

    def commands(
        self,
        climber: Climber,
        at: Sensed,
        x: ControlState,  # noqa: ARG002 - of the protocol
        speed: ca.SX,
    ) -> Commands:
        """Return reference rates of the wheels and motor torques.

        The plan is evaluated at the progress p of the vehicle. Below the first and above the last p
        of the plan, all wheels have the same reference speed, at most ``speed`` [m/s]. Below the
        first p, it decreases to zero towards the plan's start, since plans begin at rest.
        """
        p = sum(place[0] + place[1] for place in at.axles) / 3 + self.lead
        point = _plan_at(self.plan, p)
        pace = _reference_speed(self.plan, p, point, speed)
        references, wanted = [], []
        columns = (*point[1:4], at.velocities, at.spins, self.motors)
        for ratio, angle, torque, velocity, spin, count in zip(*columns, strict=True):
            actual = velocity[0] * ca.cos(angle) + velocity[1] * ca.sin(angle)
            references.append(ca.fmin(pace * ratio, actual + self.spare) / climber.radius)
            wanted.append(torque / count + self.proportional * (references[-1] - spin))
        return Commands(PerAxle(*references), limited(self.torque, PerAxle(*wanted)), ())


def tracked_plan(plans: Sequence[tuple[Climb, Array]]) -> TrackedPlan:
    """Return the plan of consecutive legs as a function of the progress.

    Parameters
    ----------
    plans : sequence of (Climb, ndarray)
        Program of each leg, from `slipfree.climb.time_scaling.climb`, and its solution; all legs
        except the last must be planned with ``halt=True``.

    Raises
    ------
    ModelError
        If a path leads down so steeply that the progress does not increase.
    """
    p, *rest = (np.concatenate(each) for each in zip(*map(_leg, plans), strict=True))
    joints = np.cumsum([2 * plan.nodes.s.size - 1 for plan, _ in plans])[:-1]
    p[joints] = np.maximum(p[joints], p[joints - 1] + LEG_DISTANCE)
    if not (np.diff(p) > 0).all():
        k = int(np.argmin(np.diff(p)))
        raise ModelError(
            "plan: expected a path on which the mean of x + z over the axles increases, found a "
            f"decrease at {p[k]:.3g} m; use a plan that does not lead steeply down"
        )
    return TrackedPlan(p, *rest)


def _leg(plan_and_unknowns: tuple[Climb, Array]) -> tuple[Array, ...]:
    """Return the fields of `TrackedPlan` for one leg, at its nodes and interval midpoints."""
    plan, unknowns = plan_and_unknowns
    nodes, middles, torque = plan.nodes, plan.middles, history(plan, unknowns)["torque"]
    square = np.maximum(unknowns[plan.nlp.where["b"]], 0)
    at_nodes = np.column_stack([np.interp(nodes.s, middles.s, each) for each in torque.T])
    parts = []
    for path, squares, torques in (
        (nodes, square, at_nodes),
        (middles, (square[1:] + square[:-1]) / 2, torque),
    ):
        axles = path.q[:, None, :2] + axle_arms(plan.climber, path.q)
        directions = np.arctan2(-path.normals[..., 0], path.normals[..., 1])
        progress = axles.sum(axis=2).mean(axis=1)
        parts.append((progress, squares, path.speeds, directions, torques))
    order = np.argsort(np.concatenate([nodes.s, middles.s]))
    return tuple(np.concatenate(pair)[order] for pair in zip(*parts, strict=True))


def _plan_at(plan: TrackedPlan, p: ca.SX) -> _PlanPoint:
    columns = [plan.square, plan.speeds, plan.directions, plan.torques]
    rows, inside = np.column_stack(columns), ca.fmin(ca.fmax(p, plan.p[0]), plan.p[-1])
    table = ca.interpolant("table", "linear", [plan.p.tolist()], rows.ravel().tolist())
    at = ca.MX.sym("p")
    row = ca.vertsplit(ca.Function("plan", [at], [table(at)], {"never_inline": True})(inside))
    before, behind = p < plan.p[0], p > plan.p[-1]
    off = ca.logic_or(before, behind)
    speeds, directions, torques = (
        PerAxle(*(ca.if_else(off, value, each) for each in row[k : k + 3]))
        for k, value in ((1, 1.0), (4, 0.0), (7, 0.0))
    )
    return _PlanPoint(row[0], speeds, directions, torques, before, behind)


def _reference_speed(plan: TrackedPlan, p: ca.SX, at: _PlanPoint, speed: ca.SX) -> ca.SX:
    """Return the reference speed along the path at progress ``p`` [m/s].

    Outside the plan, the speed changes with constant acceleration and does not exceed ``speed``.
    """
    arriving = 2 * ACCELERATION * ca.fmax(plan.p[0] - p, 0)
    leaving = at.square + 2 * ACCELERATION * ca.fmax(p - plan.p[-1], 0)
    square = ca.if_else(at.before, arriving, ca.if_else(at.behind, leaving, at.square))
    pace = ca.sqrt(square + MIN_SPEED**2)
    found: ca.SX = ca.if_else(ca.logic_or(at.before, at.behind), ca.fmin(speed, pace), pace)
    return found
