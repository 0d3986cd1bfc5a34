"""Planned climbs: time scaling along the contact path without slip, and tracking of the plan.

With s' the speed along a leg of the path, ``a = s''`` and ``b = s'^2``, accelerations are
``q' a + q'' b``, and the equations of motion are linear in a, b and the contact forces:

    A f = load + G a + H b

with the contact forces f, the equilibrium terms A and load, and the inertia G and H of bodies and
wheels. On every interval a is constant and b linear in s; equations, Coulomb's law ``|T| <= mu N``
and torque limits hold at its midpoint. Intervals are short where a leg begins at rest, since the
friction demand is often largest there.

A tracked plan is a function of the progress of the vehicle, not of time: a delayed vehicle receives
the torques planned for its position. The progress is

    p = mean over the axles of x + z.

It increases along every path that does not descend steeply. The feedforward torques of the plan
distribute the friction among the wheels better than control of the rates could. Feedback corrects
the rate of each wheel; its reference is that of the plan, but at most slightly more than the speed
of its axle, so that a wheel that slips regains its grip.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf
from typing import Annotated

import casadi as ca
import numpy as np
import numpy.typing as npt
import scipy
from annotated_types import Gt

from slipfree.catalog.step_climber import AXLES, Climber
from slipfree.climb.contact_path import (
    MAX_FRICTION,
    Leg,
    PathSamples,
    axle_arms,
    center,
    cross,
    equilibrium,
    least_friction_forces,
    rotate_nose_up,
    sample,
)
from slipfree.control.reference_speeds import PerAxle
from slipfree.control.step_climbing import Commands, ControlState, Motors, Sensed, limited
from slipfree.core.errors import ModelError
from slipfree.core.nlp import Nlp
from slipfree.core.records import Array, Label
from slipfree.core.trajectory import Column, Trajectory, joined
from slipfree.terrain.solids import Profile

COSTS = ("time", "friction", "slip")
TIME_WEIGHT = 1e-4  # weight of the time in costs that do not determine the speed [1/s]
ROOT_OFFSET = 1e-8  # added to b under roots, for finite derivatives at rest [largest b]
MIN_ACCELERATION = 1e-3  # slope of the lower bound of b near points of rest [m/s2]
MAX_LOWER_BOUND = 1e-4  # largest lower bound of b between points of rest [largest b]
LOAD_OFFSET = 1e-3  # added to N in the cost of slip, for finite derivatives without load [weight]
GUESS_SQUARE = 0.01  # b of the initial guess [largest b]
MAX_GUESS_LOAD = 3.0  # largest normal force of the initial guess [weight]

MIN_SPEED = 0.01  # smallest reference speed, so that the vehicle leaves points of rest [m/s]
ACCELERATION = 0.3  # deceleration before the plan's start, acceleration after its end [m/s2]
LEG_DISTANCE = 1e-7  # distance between consecutive legs, whose torques differ where they meet [m]

LABELS = (
    Label("s", "m", "path parameter on the leg"),
    Label("path_speed", "m s-1", "first derivative of the path parameter"),
    Label("path_acceleration", "m s-2", "second derivative of the path parameter"),
    Label("y", "m", "forward position of the joint"),
    Label("z", "m", "height of the joint"),
    Label("tilt_rear", "rad", "tilt of the rear body, positive with the nose up"),
    Label("tilt_front", "rad", "tilt of the front body, positive with the nose up"),
    Label("wheel_rate", "rad s-1", "rate of the wheels over the ground, positive forward"),
    Label("torque", "N m", "total torque of the axle's motors"),
    Label("load", "N", "normal force of the ground on the axle's wheels"),
    Label("friction", "N", "tangential force of the ground on the axle's wheels, forward"),
)


@dataclass(frozen=True, eq=False)
class Climb:
    """Nonlinear program of the time scaling along one leg, a smooth section of the contact path.

    ``nodes`` and ``middles`` are the configurations at the ends and midpoints of its n intervals.
    The unknowns are the squared path speed ``b`` (n + 1,) [m2 s-2], the contact forces ``normal``
    and ``tangential`` (n, 3) [N] and the coefficient of friction ``mu`` (1,).
    """

    climber: Climber
    nodes: PathSamples
    middles: PathSamples
    nlp: Nlp


def inertia(climber: Climber, path: PathSamples) -> tuple[Array, Array]:
    """Return the coefficients (n, 4) of a [N s2/m] and b [N s2] in the rows of `equilibrium`."""
    linear, square = np.zeros((2, len(path.q), 4))
    bodies = (climber.rear_body, climber.front_body)
    for k, body in enumerate(bodies):
        arm, tilt = center(body, path.q[:, 2 + k]), 2 + k
        centripetal = path.first[:, tilt, None] ** 2 * arm
        for rows, rates in ((linear, path.first), (square, path.second)):
            change = rates[:, :2] + rates[:, tilt, None] * rotate_nose_up(arm)
            if rows is square:
                change = change - centripetal
            rows[:, :2] += body.mass * change
            rows[:, tilt] += body.mass * cross(arm, change) + body.inertia * rates[:, tilt]
    spin = spin_inertia(climber)
    for rows, values in ((linear, path.speeds), (square, path.slopes)):
        rows[:, 2] -= values[:, :2] @ spin[:2]  # wheels that roll forward rotate nose-down
        rows[:, 3] -= values[:, 2] * spin[2]
    return linear, square


def spin_inertia(climber: Climber) -> Array:
    """Return the torque on an axle's wheels per acceleration of the axle, shape (3,) [N m s2/m]."""
    return np.array([axle.inertia for axle in climber.axles]) / climber.radius


def climb(
    climber: Climber,
    profile: Profile,
    leg: Leg,
    cost: str = "time",
    *,
    mu: float | None = None,
    speed: float = 0.25,
    torques: Sequence[float] = (inf, inf, inf),
    s: int | npt.ArrayLike = 60,
    halt: bool = False,
) -> Climb:
    """Return the nonlinear program of the climb of a leg.

    The cost is the duration, the required coefficient of friction, or the work of creep if wheels
    slip in proportion to T / N. The coefficient ``mu`` is an unknown for the cost "friction" and
    required for the others. ``speed`` is the largest speed of an axle [m/s], ``torques`` the
    largest total torques of the axles' motors [N m]. ``s`` are the nodes on the leg (n + 1,) [m],
    or their number; then the last one is ``leg.top`` or, with ``halt``, the end of the leg. The
    vehicle is at rest at the first node, and with ``halt``, as required before another leg, at the
    last one.

    ModelError is raised if cost and coefficient do not fit each other, a number is not positive, or
    there are fewer than three nodes or they do not increase.
    """
    if cost not in COSTS or (mu is None) != (cost == "friction"):
        raise ModelError(
            "climb: expected the cost 'time' or 'slip' with a coefficient of friction 'mu', or the "
            f"cost 'friction', which minimises it, without one; found the cost {cost!r} with mu = "
            f"{mu}; change one of them"
        )
    if not (speed > 0 and (mu is None or mu > 0)):
        raise ModelError(
            f"climb: expected positive numbers for 'speed' and 'mu', found {speed} m/s and {mu}; "
            "increase them"
        )
    ends = _mesh(leg, s, halt=halt) if isinstance(s, int) else np.asarray(s, dtype=float)
    if ends.ndim != 1 or ends.size < 3 or (np.diff(ends) <= 0).any():
        raise ModelError(
            f"climb: expected three or more increasing nodes as 's', found {ends}; give more "
            "nodes, in increasing order"
        )
    nodes = sample(climber, profile, leg, ends)
    middles = sample(climber, profile, leg, (ends[:-1] + ends[1:]) / 2)
    nlp = _program(climber, nodes, middles, cost, mu, speed, torques, halt=halt)
    return Climb(climber, nodes, middles, nlp)


def _mesh(leg: Leg, count: int, *, halt: bool) -> Array:
    """Return nodes along a leg, closer near its start and, with ``halt``, its end at rest."""
    # from rest b grows like s: nodes at equal steps of time are quadratic in s
    part = np.linspace(0, 1, count)
    return leg.length * np.sin(np.pi / 2 * part) ** 2 if halt else leg.top * part**2


def _program(
    climber: Climber,
    nodes: PathSamples,
    middles: PathSamples,
    cost: str,
    mu: float | None,
    speed: float,
    torques: Sequence[float],
    *,
    halt: bool,
) -> Nlp:
    steps, fastest, weight = np.diff(nodes.s), speed**2, climber.weight
    count = steps.size
    ends = np.cumsum([0, count + 1, 3 * count, 3 * count, 1]).tolist()
    b_at, n_at, t_at, mu_at = (np.arange(i, j) for i, j in pairwise(ends))
    scale = np.repeat([fastest, weight / 3, weight / 3, 1.0], np.diff(ends))
    # IPOPT sees unknowns of size one
    x = ca.MX.sym("x", ends[-1])
    b, normal, tangential, friction = ca.vertsplit(x * scale, ends)
    unknowns = b, normal, tangential, friction
    rows, low, high = _constraint_rows(climber, middles, steps, unknowns, torques)
    f = _cost(cost, unknowns, steps, fastest, weight)
    lower, upper = np.full((2, ends[-1]), [[-np.inf], [np.inf]])
    lower[b_at], upper[b_at] = _speeds(nodes, fastest, halt=halt)
    lower[n_at] = 0.0
    lower[mu_at], upper[mu_at] = (0.0, MAX_FRICTION) if mu is None else (mu, mu)
    slow = np.minimum(GUESS_SQUARE * fastest, upper[b_at])
    guess = np.concatenate([slow, *_slow_climb(climber, middles, mu)])
    shaped = {
        "b": b_at,
        "normal": n_at.reshape(count, 3),
        "tangential": t_at.reshape(count, 3),
        "mu": mu_at,
    }
    bounds = lower, upper, np.concatenate(low), np.concatenate(high)
    return Nlp(x, f, ca.vertcat(*rows), guess, scale, *bounds, shaped)


def _cost(
    cost: str, unknowns: Sequence[ca.MX], steps: Array, fastest: float, weight: float
) -> ca.MX:
    b, normal, tangential, friction = unknowns
    roots = ca.sqrt(b + ROOT_OFFSET * fastest)
    time: ca.MX = ca.sum1(ca.DM(2 * steps) / (roots[1:] + roots[:-1]))
    if cost == "time":
        return time
    ratios = tangential**2 / (normal + LOAD_OFFSET * weight) / weight
    creep = ca.sum1(ca.DM(np.repeat(steps, 3)) * ratios)
    return (friction if cost == "friction" else creep) + TIME_WEIGHT * time


def _slow_climb(
    climber: Climber, middles: PathSamples, mu: float | None
) -> tuple[Array, Array, Array]:
    """Return normal and tangential forces [N] and the friction coefficient [1] of a slow climb.

    They are the initial guess of a plan, forces wheel by wheel at each sample, shape (3 n,): the
    minimisation of friction is quasi-convex, and from a poor guess IPOPT may stop elsewhere.
    """
    hold, weight = least_friction_forces(*equilibrium(climber, middles)), climber.weight
    held = np.isfinite(hold.mu)
    normal = np.where(held[:, None], np.clip(hold.normal, 0, MAX_GUESS_LOAD * weight), weight / 3)
    tangential = np.where(held[:, None], hold.tangential, 0.0)
    most = np.abs(tangential) <= MAX_FRICTION * normal
    friction = hold.mu[held].max(initial=0.0) if mu is None else mu
    return normal.ravel(), np.where(most, tangential, 0.0).ravel(), np.array([friction])


def _speeds(nodes: PathSamples, fastest: float, *, halt: bool) -> tuple[Array, Array]:
    """Return lower and upper bounds of the squared path speed b at the nodes, (n + 1,) [m2/s2]."""
    upper = fastest / (nodes.speeds**2).max(axis=1)
    upper[[0, -1] if halt else [0]] = 0.0
    away = nodes.s - nodes.s[0]
    away = np.minimum(away, away[-1] - away) if halt else away
    return np.minimum(
        np.minimum(2 * MIN_ACCELERATION * away, MAX_LOWER_BOUND * fastest), upper
    ), upper


def _constraint_rows(
    climber: Climber,
    middles: PathSamples,
    steps: Array,
    unknowns: Sequence[ca.MX],
    torques: Sequence[float],
) -> tuple[list[ca.MX], list[Array], list[Array]]:
    """Return equations of motion, cones and torque limits, and their lower and upper bounds."""
    b, normal, tangential, mu = unknowns
    count, weight = steps.size, climber.weight
    matrix, load = equilibrium(climber, middles)
    to_a, to_b = _from_nodes(steps)
    inert = [_diagonal(each[:, :, None]) for each in inertia(climber, middles)]
    moving = _sparse((inert[0] @ to_a + inert[1] @ to_b) / weight) @ b
    held = (
        _sparse(_diagonal(matrix[:, :, :3]) / weight) @ normal
        + _sparse(_diagonal(matrix[:, :, 3:]) / weight) @ tangential
    )
    spin = spin_inertia(climber)
    linear, square = (
        _diagonal((each * spin)[:, :, None]) for each in (middles.speeds, middles.slopes)
    )
    torque = climber.radius * tangential + _sparse(linear @ to_a + square @ to_b) @ b
    most = np.tile(torques, count)
    cone, nothing, above = 3 / weight, np.zeros(3 * count), np.full(3 * count, np.inf)
    rows = [held - moving, *(cone * (mu * normal + sign * tangential) for sign in (1, -1))]
    low, high = [(load / weight).ravel(), nothing, nothing], [(load / weight).ravel(), above, above]
    if np.isfinite(most).all():
        rows, low, high = [*rows, torque], [*low, -most], [*high, most]
    return rows, low, high


def _from_nodes(steps: Array) -> tuple[scipy.sparse.csr_matrix, scipy.sparse.csr_matrix]:
    """Return the matrices that map b at the n + 1 nodes to a and b on the n intervals."""
    shape, factors = (steps.size, steps.size + 1), 1 / (2 * steps)
    # a = (db/ds) / 2, since b is the square of the speed; b at the midpoint is the mean
    pairs = (-factors, factors), (0.5, 0.5)
    to_a, to_b = (scipy.sparse.diags(each, [0, 1], shape).tocsr() for each in pairs)
    return to_a, to_b


def _diagonal(blocks: Array) -> scipy.sparse.csr_matrix:
    return scipy.sparse.block_diag(list(blocks), format="csr")


def _sparse(matrix: scipy.sparse.csr_matrix) -> ca.DM:
    return ca.DM(matrix.tocsc())


def history(plan: Climb, unknowns: Array) -> Trajectory:
    """Return a planned climb as a function of time, at the midpoints of its intervals.

    ``unknowns`` is the solution of the program (n_x,). Columns are those of `LABELS`, statistics
    ``mu`` [1] and ``duration`` [s].
    """
    where, middles, climber = plan.nlp.where, plan.middles, plan.climber
    b = np.maximum(unknowns[where["b"]], 0.0)
    steps, means = np.diff(plan.nodes.s), (b[:-1] + b[1:]) / 2
    speed, acceleration = np.sqrt(means), np.diff(b) / (2 * steps)
    # exact for the constant acceleration of an interval, also from rest
    durations = 2 * steps / (np.sqrt(b[:-1]) + np.sqrt(b[1:]))
    t = np.cumsum(durations) - durations + steps / (np.sqrt(b[:-1]) + speed)
    friction = unknowns[where["tangential"]]
    spinning = middles.speeds * acceleration[:, None] + middles.slopes * means[:, None]
    values = dict(zip(("y", "z", "tilt_rear", "tilt_front"), middles.q.T, strict=True)) | {
        "s": middles.s,
        "path_speed": speed,
        "path_acceleration": acceleration,
        "wheel_rate": middles.speeds * speed[:, None] / climber.radius,
        "torque": climber.radius * friction + spin_inertia(climber) * spinning,
        "load": unknowns[where["normal"]],
        "friction": friction,
    }
    columns = {label.name: Column(label, values[label.name]) for label in LABELS}
    statistics = {"mu": float(unknowns[where["mu"]][0]), "duration": float(durations.sum())}
    return Trajectory(t, columns, AXLES, statistics=statistics)


def in_sequence(parts: Sequence[Trajectory]) -> Trajectory:
    """Return the planned climbs of consecutive legs as one trajectory.

    Times continue; path parameters restart with every leg. Statistics: the largest ``mu`` and the
    sum of the durations. All legs except the last must be planned with ``halt=True``.
    """
    durations = [part.statistics["duration"] for part in parts]
    begins = np.cumsum([0.0, *durations[:-1]])
    later = [replace(part, t=part.t + begin) for part, begin in zip(parts, begins, strict=True)]
    statistics = {"mu": max(part.statistics["mu"] for part in parts), "duration": sum(durations)}
    return replace(joined(*later), statistics=statistics)


@dataclass(frozen=True, eq=False)
class TrackedPlan:
    """A planned climb as a function of the progress p, linear between n points.

    Increasing progress (n,) [m], square of the path speed (n,) [m2/s2], speeds of the axles divided
    by it (n, 3) [1], directions of their motion, upward from the horizontal (n, 3) [rad], and total
    torques of their motors (n, 3) [N m].
    """

    p: Array
    square: Array
    speeds: Array
    directions: Array
    torques: Array


@dataclass(frozen=True, eq=False)
class Tracking:
    """Controller that tracks a planned climb, for `slipfree.control.step_climbing.climbing`.

    It uses true positions and speeds of the axles, which are known only in simulations. ``spare``
    is the largest excess of a wheel's reference rim speed over the speed of its axle; a good value
    is the slip speed at which friction is largest [m/s]. ``lead`` is added to the progress when the
    plan is evaluated; it must exceed the depth of the contacts, otherwise the plan stops a wheel
    before it touches the next solid [m]. Gain, torque and motors are those of `StepClimbing`.
    """

    plan: TrackedPlan
    proportional: Annotated[float, Gt(0)] = 20.0
    spare: Annotated[float, Gt(0)] = 3e-3
    lead: Annotated[float, Gt(0)] = 1e-3
    torque: Annotated[float, Gt(0)] = inf
    motors: Motors = (2, 1, 2)

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
        plan, p = self.plan, sum(place[0] + place[1] for place in at.axles) / 3 + self.lead
        before, behind = p < plan.p[0], p > plan.p[-1]
        off = ca.logic_or(before, behind)
        square, *row = _plan_row(plan, p)
        ratios, angles, torques = (
            [ca.if_else(off, outside, value) for value in row[k : k + 3]]
            for k, outside in ((0, 1.0), (3, 0.0), (6, 0.0))
        )
        # outside the plan the speed changes with constant acceleration
        arriving = 2 * ACCELERATION * ca.fmax(plan.p[0] - p, 0)
        leaving = square + 2 * ACCELERATION * ca.fmax(p - plan.p[-1], 0)
        square = ca.if_else(before, arriving, ca.if_else(behind, leaving, square))
        pace = ca.sqrt(square + MIN_SPEED**2)
        pace = ca.if_else(off, ca.fmin(speed, pace), pace)
        references, wanted = [], []
        columns = ratios, angles, torques, at.velocities, at.spins, self.motors
        for ratio, angle, torque, velocity, spin, count in zip(*columns, strict=True):
            actual = velocity[0] * ca.cos(angle) + velocity[1] * ca.sin(angle)
            references.append(ca.fmin(pace * ratio, actual + self.spare) / climber.radius)
            wanted.append(torque / count + self.proportional * (references[-1] - spin))
        return Commands(PerAxle(*references), limited(self.torque, PerAxle(*wanted)), ())


def tracked_plan(plans: Sequence[tuple[Climb, Array]]) -> TrackedPlan:
    """Return the plan of consecutive legs as a function of the progress.

    ``plans`` are the program of each leg and its solution; all legs except the last must be planned
    with ``halt=True``. ModelError is raised if a path leads down so steeply that the progress does
    not increase.
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


def _plan_row(plan: TrackedPlan, p: ca.SX) -> list[ca.SX]:
    """Return square, speeds, directions and torques of a plan at a progress, or at its ends."""
    columns = [plan.square, plan.speeds, plan.directions, plan.torques]
    rows, inside = np.column_stack(columns), ca.fmin(ca.fmax(p, plan.p[0]), plan.p[-1])
    table = ca.interpolant("table", "linear", [plan.p.tolist()], rows.ravel().tolist())
    at = ca.MX.sym("p")
    # a function call: an interpolant cannot be expanded into the SX graph of the model
    lookup = ca.Function("plan", [at], [table(at)], {"never_inline": True})
    return list(ca.vertsplit(lookup(inside)))
