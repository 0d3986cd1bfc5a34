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
from dataclasses import dataclass
from math import inf
from typing import Annotated, NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt
from annotated_types import Gt

from slipfree.climb.contact_path import (
    MAX_FRICTION,
    Leg,
    PathSamples,
    demand,
    sample,
    spin_inertia,
)
from slipfree.control.step_climbing import Commands, ControlState, Motors, PerAxle, Sensed, limited
from slipfree.core.arguments import checked
from slipfree.core.dae import Nlp
from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.terrain.solids import Profile
from slipfree.vehicle.tree import Vehicle

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


@dataclass(frozen=True, eq=False)
class Climb:
    """Nonlinear program of the time scaling along one leg, a smooth section of the contact path.

    ``nodes`` and ``middles`` are the configurations at the ends and midpoints of its n intervals.
    The unknowns are the squared path speed ``b`` (n + 1,) [m2 s-2], the contact forces ``normal``
    and ``tangential`` (n, 3) [N] and the coefficient of friction ``mu`` (1,).
    """

    climber: Vehicle
    nodes: PathSamples
    middles: PathSamples
    nlp: Nlp


def climb(
    climber: Vehicle,
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
    if isinstance(s, int):
        # from rest b grows like s: nodes at equal steps of time are quadratic in s
        part = np.linspace(0, 1, s)
        s = leg.length * np.sin(np.pi / 2 * part) ** 2 if halt else leg.top * part**2
    ends = np.asarray(s, dtype=float)
    if ends.ndim != 1 or ends.size < 3 or (np.diff(ends) <= 0).any():
        raise ModelError(
            f"climb: expected three or more increasing nodes as 's', found {ends}; give more "
            "nodes, in increasing order"
        )
    nodes = sample(climber, profile, leg, ends)
    middles = sample(climber, profile, leg, (ends[:-1] + ends[1:]) / 2)
    steps, fastest, weight = np.diff(ends), speed**2, climber.weight
    count = steps.size
    parts = np.cumsum([0, count + 1, 6 * count, 1]).tolist()
    scale = np.repeat([fastest, weight / 3, 1.0], np.diff(parts))
    # IPOPT sees unknowns of size one
    x = ca.MX.sym("x", parts[-1])
    b, forces, friction = ca.vertsplit(x * scale, parts)
    a, mean = (b[1:] - b[:-1]) / ca.DM(2 * steps), (b[1:] + b[:-1]) / 2
    normal, tangential = (ca.vec(each) for each in ca.vertsplit(ca.reshape(forces, 6, count), 3))

    def moving(linear: Array, square: Array) -> ca.MX:
        return _blocks(linear[:, :, None]) @ a + _blocks(square[:, :, None]) @ mean

    load, cone = (middles.load / weight).ravel(), 3 / weight
    held = _blocks(middles.matrix) @ forces - moving(middles.linear, middles.square)
    rows = [held / weight, *(cone * (friction * normal + k * tangential) for k in (1, -1))]
    low, high = [load, np.zeros(6 * count)], [load, np.full(6 * count, np.inf)]
    if np.isfinite(torques).all():
        spins, most = spin_inertia(climber), np.tile(torques, count)
        spinning = moving(spins * middles.speeds, spins * middles.slopes)
        rows.append(climber.wheels[0].radius * tangential + spinning)
        low, high = [*low, -most], [*high, most]
    roots = ca.sqrt(b + ROOT_OFFSET * fastest)
    f = ca.sum1(ca.DM(2 * steps) / (roots[1:] + roots[:-1]))
    if cost != "time":
        ratios = tangential**2 / (normal + LOAD_OFFSET * weight) / weight
        creep = ca.dot(ca.DM(np.repeat(steps, 3)), ratios)
        f = (friction if cost == "friction" else creep) + TIME_WEIGHT * f
    # the minimisation of friction is quasi-convex: from guesses other than the forces of a slow
    # climb, IPOPT may stop elsewhere
    hold = demand(climber, leg, middles)
    found, most_load = np.isfinite(hold.mu)[:, None], MAX_GUESS_LOAD * weight
    loads = np.where(found, np.clip(hold.normal, 0, most_load), weight / 3)
    pushes = np.where(found, hold.tangential, 0.0)
    pushes = np.where(np.abs(pushes) <= MAX_FRICTION * loads, pushes, 0.0)
    most = fastest / (nodes.speeds**2).max(axis=1)  # bounds of b
    most[[0, -1] if halt else [0]] = 0.0
    away = ends - ends[0]
    away = np.minimum(away, away[-1] - away) if halt else away
    least = np.minimum(2 * MIN_ACCELERATION * away, MAX_LOWER_BOUND * fastest)
    least = np.minimum(least, most)
    given = hold.mu[found[:, 0]].max(initial=0.0) if mu is None else mu
    slow = np.minimum(GUESS_SQUARE * fastest, most)
    guess = [slow, np.hstack([loads, pushes]).ravel(), np.array([given])]
    limits = (0.0, MAX_FRICTION) if mu is None else (mu, mu)
    pushing = np.tile(np.repeat([0.0, -np.inf], 3), count)
    places = np.split(np.arange(parts[-1]), parts[1:-1])
    nlp = Nlp(
        x,
        f,
        ca.vertcat(*rows),
        np.concatenate(guess),
        scale,
        np.concatenate([least, pushing, limits[:1]]),
        np.concatenate([most, np.full(6 * count, np.inf), limits[1:]]),
        np.concatenate(low),
        np.concatenate(high),
        {
            "b": places[0],
            "normal": places[1].reshape(-1, 6)[:, :3],
            "tangential": places[1].reshape(-1, 6)[:, 3:],
            "mu": places[2],
        },
    )
    return Climb(climber, nodes, middles, nlp)


def _blocks(matrices: Array) -> ca.DM:
    return ca.sparsify(ca.diagcat(*(ca.DM(each) for each in matrices)))


class ClimbHistory(NamedTuple):
    """A planned climb as a function of time, at the midpoints of its n intervals.

    Times ``t`` (n,) [s]; path speed (n,) [m/s] and acceleration (n,) [m/s2]; rates of the wheels
    over the ground (n, 3), positive forward [rad/s]; total torques of the axles' motors (n, 3)
    [N m]; normal and tangential forces of the ground on the axles' wheels (n, 3) [N]; the
    coefficient of friction ``mu`` [1], and the ``duration`` [s].
    """

    t: Array
    path_speed: Array
    path_acceleration: Array
    wheel_rate: Array
    torque: Array
    load: Array
    friction: Array
    mu: float
    duration: float


def history(plan: Climb, unknowns: Array) -> ClimbHistory:
    """Return a planned climb as a function of time.

    ``unknowns`` is the solution of the program (n_x,).
    """
    where, middles, climber = plan.nlp.where, plan.middles, plan.climber
    b = np.maximum(unknowns[where["b"]], 0.0)
    steps, means = np.diff(plan.nodes.s), (b[:-1] + b[1:]) / 2
    speed, acceleration = np.sqrt(means), np.diff(b) / (2 * steps)
    # exact for the constant acceleration of an interval, also from rest
    durations = 2 * steps / (np.sqrt(b[:-1]) + np.sqrt(b[1:]))
    friction, radius = unknowns[where["tangential"]], climber.wheels[0].radius
    spinning = middles.speeds * acceleration[:, None] + middles.slopes * means[:, None]
    return ClimbHistory(
        np.cumsum(durations) - durations + steps / (np.sqrt(b[:-1]) + speed),
        speed,
        acceleration,
        middles.speeds * speed[:, None] / radius,
        radius * friction + spin_inertia(climber) * spinning,
        unknowns[where["normal"]],
        friction,
        float(unknowns[where["mu"]][0]),
        float(durations.sum()),
    )


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


@checked
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
        climber: Vehicle,
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
        before, behind = ca.fmax(plan.p[0] - p, 0), ca.fmax(p - plan.p[-1], 0)
        square, *row = _plan_row(plan, p)
        # outside the plan the speed changes with constant acceleration
        pace = ca.sqrt(square + 2 * ACCELERATION * (before + behind) + MIN_SPEED**2)
        pace = ca.if_else(before + behind > 0, ca.fmin(speed, pace), pace)
        references, wanted, radius = [], [], climber.wheels[0].radius
        columns = row[:3], row[3:6], row[6:], at.velocities, at.spins, self.motors
        for ratio, angle, torque, velocity, spin, count in zip(*columns, strict=True):
            actual = velocity[0] * ca.cos(angle) + velocity[1] * ca.sin(angle)
            references.append(ca.fmin(pace * ratio, actual + self.spare) / radius)
            wanted.append(torque / count + self.proportional * (references[-1] - spin))
        return Commands(PerAxle(*references), *limited(self.torque, PerAxle(*wanted)), ())


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
    nodes, middles, torque = plan.nodes, plan.middles, history(plan, unknowns).torque
    square = np.maximum(unknowns[plan.nlp.where["b"]], 0)
    at_nodes = np.column_stack([np.interp(nodes.s, middles.s, each) for each in torque.T])
    parts = []
    for path, squares, torques in (
        (nodes, square, at_nodes),
        (middles, (square[1:] + square[:-1]) / 2, torque),
    ):
        directions = np.arctan2(-path.normals[..., 0], path.normals[..., 1])
        parts.append((progress(path), squares, path.speeds, directions, torques))
    order = np.argsort(np.concatenate([nodes.s, middles.s]))
    return tuple(np.concatenate(pair)[order] for pair in zip(*parts, strict=True))


def progress(path: PathSamples) -> Array:
    """Return the progress at samples of a path, the mean of x + z over the axles, (n,) [m]."""
    return np.asarray(path.axles.sum(axis=2).mean(axis=1))


def _plan_row(plan: TrackedPlan, p: ca.SX) -> list[ca.SX]:
    """Return square, speeds, directions and torques of a plan at a progress.

    Outside the plan the square is that of its ends, speeds are one, directions and torques zero.
    """
    rows = np.column_stack([plan.square, plan.speeds, plan.directions, plan.torques])
    outside = np.repeat([[0.0, 1.0, 0.0]], [1, 3, 6], axis=1)
    rows = np.vstack([outside, rows, outside])
    rows[[0, -1], 0] = plan.square[[0, -1]]
    places = [plan.p[0] - LEG_DISTANCE, *plan.p, plan.p[-1] + LEG_DISTANCE]
    table = ca.interpolant("table", "linear", [places], rows.ravel().tolist())
    at = ca.MX.sym("p")
    # a function call: an interpolant cannot be expanded into the SX graph of the model
    lookup = ca.Function("plan", [at], [table(at)], {"never_inline": True})
    return list(ca.vertsplit(lookup(ca.fmin(ca.fmax(p, places[0]), places[-1]))))
