"""Planned climbs: how to go along the way, and which forces to use, without slip.

With s' the speed along a leg of the way, ``a = s''`` and ``b = s'^2``, accelerations are
``q' a + q'' b``, and the equations of motion are linear in a, b and the contact forces:

    A f = load + G a + H b

A and the load are those of equilibrium, G and H hold inertia: of the bodies, and of the wheels,
which turn at the rates ``speeds s' / radius``. On every interval a is constant, so that b is linear
in s; equations and limits hold in its middle. A leg begins where a wheel meets a solid: at rest,
and often where friction is needed most, so that the intervals are short there. The forces stay in
Coulomb's cone ``|T| <= mu N``, and the motors within their torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import casadi as ca
import numpy as np
import numpy.typing as npt
import scipy.sparse

from slipfree.climb.contact_path import Leg, Way, sample, turned
from slipfree.climb.friction_demand import MOST, center, cross, equilibrium, least
from slipfree.climb.profile import Profile
from slipfree.climb.vehicle import AXLES, Climber
from slipfree.errors import ModelError
from slipfree.nlp import Nlp
from slipfree.records import Array, Label
from slipfree.trajectory import Column, Trajectory, joined
from slipfree.vehicle.tree import GRAVITY

COSTS = ("time", "friction", "slip")
PACE = 1e-4  # of the time in costs that would leave the motion open in part [1/s]
ROUND = 1e-8  # in roots of squared speeds, so that they have slopes at rest [largest squared]
MOVING = 1e-3  # between rests no standstill: least acceleration away from them [m/s2]
CREEP = 1e-4  # and what is fast enough, squared [largest squared]
UNLOADED = 1e-3  # added to N in the cost of slip, so that it has slopes without load [weight]
SLOW = 0.01  # b of the guess [largest squared]
JAMMED = 3.0  # normal forces of the guess stay below this [weight]


LABELS = (
    Label("s", "m", "path parameter on the leg"),
    Label("path_speed", "m s-1", "its first derivative"),
    Label("path_acceleration", "m s-2", "its second derivative"),
    Label("x", "m", "place of the joint, forward"),
    Label("z", "m", "height of the joint"),
    Label("tilt_rear", "rad", "tilt of the rear body, nose up positive"),
    Label("tilt_front", "rad", "tilt of the front body, nose up positive"),
    Label("wheel_rate", "rad s-1", "rate of the wheels over the ground, forward positive"),
    Label("torque", "N m", "torque of a wheel's motor"),
    Label("load", "N", "normal force of the ground on the axle's wheels"),
    Label("friction", "N", "tangential force of the ground on the axle's wheels, forward"),
)


@dataclass(frozen=True, eq=False)
class Climb:
    """A leg to be climbed, and the program that finds how.

    Attributes
    ----------
    climber : Climber
        The vehicle.
    nodes, middles : Way
        Configurations at the ends of the intervals and in their middles.
    nlp : Nlp
        With the unknowns ``b`` (n + 1,) [m2 s-2], ``normal`` and ``tangential`` (n, 3) [N] and
        ``mu`` (1,) for n intervals.
    """

    climber: Climber
    nodes: Way
    middles: Way
    nlp: Nlp


def inertia(climber: Climber, way: Way) -> tuple[Array, Array]:
    """Return what inertia asks of the forces in the equations of `equilibrium`.

    Returns
    -------
    G, H : ndarray, shape (n, 4)
        For the second derivative of s, and for the square of its first.
    """
    linear, square = np.zeros((2, len(way.q), 4))
    bodies = (climber.rear_body, climber.front_body)
    for k, body in enumerate(bodies):
        arm, tilt = center(body, way.q[:, 2 + k]), 2 + k
        centripetal = way.first[:, tilt, None] ** 2 * arm
        for rows, rates in ((linear, way.first), (square, way.second)):
            change = rates[:, :2] + rates[:, tilt, None] * turned(arm)
            if rows is square:
                change = change - centripetal
            rows[:, :2] += body.mass * change
            rows[:, tilt] += body.mass * cross(arm, change) + body.inertia * rates[:, tilt]
    spin = spin_inertia(climber)
    for rows, values in ((linear, way.speeds), (square, way.slopes)):
        rows[:, 2] -= values[:, :2] @ spin[:2]  # wheels that roll forward turn nose-down
        rows[:, 3] -= values[:, 2] * spin[2]
    return linear, square


def spin_inertia(climber: Climber) -> Array:
    """Return the torques that spin up the axles' wheels, over the axles' acceleration, (3,)."""
    return np.array([axle.inertia for axle in climber.axles]) / climber.radius


def climb(
    climber: Climber,
    profile: Profile,
    leg: Leg,
    cost: str = "time",
    *,
    mu: float | None = None,
    speed: float = 0.25,
    s: int | npt.ArrayLike = 60,
    halt: bool = False,
) -> Climb:
    """Return the program that finds how to climb a leg.

    Parameters
    ----------
    climber : Climber
        The vehicle.
    profile, leg : Profile, Leg
        What is climbed; see `slipfree.climb.contact_path.legs`.
    cost : {"time", "friction", "slip"}
        What is to be least: the duration; the coefficient of friction that suffices; or the work
        that is lost to creep if wheels slip in proportion to T / N.
    mu : float, optional
        Coefficient of friction; an unknown for the cost "friction", needed for the others. [1]
    speed : float
        Largest of an axle. [m/s]
    s : int or array_like, shape (n + 1,)
        Nodes on the leg, the ends of the intervals, the first of them at rest; or their number: of
        nodes up to where the climbing wheels are up, or, with a halt, to the end of the leg. [m]
    halt : bool
        Whether the vehicle is at rest at the last, as it must be where the next leg begins.

    Raises
    ------
    ModelError
        If the cost is unknown, the coefficient of friction is missing or superfluous, it or the
        speed is not positive, or the nodes are fewer than three or not in order.
    """
    if cost not in COSTS:
        raise ModelError(f"climb: expected a cost of {', '.join(COSTS)}, found {cost!r}")
    if (mu is None) != (cost == "friction"):
        raise ModelError(
            "climb: expected the coefficient of friction mu for the costs time and slip, and none "
            f"for friction, which finds it; found mu = {mu} for {cost}"
        )
    if not (speed > 0 and (mu is None or mu > 0)):
        raise ModelError(f"climb: expected positive speed and mu, found {speed} m/s and {mu}")
    ends = _mesh(leg, s, halt=halt) if isinstance(s, int) else np.asarray(s, dtype=float)
    if ends.ndim != 1 or ends.size < 3 or (np.diff(ends) <= 0).any():
        raise ModelError(f"climb: expected three or more increasing nodes s, found {ends}")
    nodes = sample(climber, profile, leg, ends)
    middles = sample(climber, profile, leg, (ends[:-1] + ends[1:]) / 2)
    nlp = _program(climber, nodes, middles, cost, mu, speed, halt=halt)
    return Climb(climber, nodes, middles, nlp)


def _mesh(leg: Leg, count: int, *, halt: bool) -> Array:
    """Return nodes whose distances grow evenly from where the vehicle is at rest."""
    part = np.linspace(0, 1, count)
    return leg.length * np.sin(np.pi / 2 * part) ** 2 if halt else leg.top * part**2


def _program(
    climber: Climber,
    nodes: Way,
    middles: Way,
    cost: str,
    mu: float | None,
    speed: float,
    *,
    halt: bool,
) -> Nlp:
    steps, fastest, weight = np.diff(nodes.s), speed**2, GRAVITY * climber.mass
    count = steps.size
    ends = np.cumsum([0, count + 1, 3 * count, 3 * count, 1]).tolist()
    b_at, n_at, t_at, mu_at = (np.arange(i, j) for i, j in pairwise(ends))
    scale = np.repeat([fastest, weight / 3, weight / 3, 1.0], np.diff(ends))
    x = ca.MX.sym("x", ends[-1])
    b, normal, tangential, friction = ca.vertsplit(x * scale, ends)
    rows, low, high = _rows(climber, middles, steps, (b, normal, tangential, friction))
    f = _cost(cost, (b, normal, tangential, friction), steps, fastest, weight)
    lower, upper = np.full((2, ends[-1]), [[-np.inf], [np.inf]])
    lower[b_at], upper[b_at] = _speeds(nodes, fastest, halt=halt)
    lower[n_at] = 0.0
    lower[mu_at], upper[mu_at] = (0.0, MOST) if mu is None else (mu, mu)
    slow = np.minimum(SLOW * fastest, upper[b_at])
    guess = np.concatenate([slow, *_slow_climb(climber, middles, mu)])
    shaped = {
        "b": b_at,
        "normal": n_at.reshape(count, 3),
        "tangential": t_at.reshape(count, 3),
        "mu": mu_at,
    }
    return Nlp(
        x,
        f,
        ca.vertcat(*rows),
        guess,
        scale,
        lower,
        upper,
        np.concatenate(low),
        np.concatenate(high),
        shaped,
    )


def _cost(
    cost: str, unknowns: Sequence[ca.MX], steps: Array, fastest: float, weight: float
) -> ca.MX:
    b, normal, tangential, friction = unknowns
    roots = ca.sqrt(b + ROUND * fastest)
    time: ca.MX = ca.sum1(ca.DM(2 * steps) / (roots[1:] + roots[:-1]))
    ratios = tangential**2 / (normal + UNLOADED * weight) / weight
    creep: ca.MX = ca.sum1(ca.DM(np.repeat(steps, 3)) * ratios)
    costs: dict[str, ca.MX] = {
        "time": time,
        "friction": friction + PACE * time,
        "slip": creep + PACE * time,
    }
    return costs[cost]


def _slow_climb(climber: Climber, middles: Way, mu: float | None) -> tuple[Array, Array, Array]:
    """Return forces and friction of a slow climb.

    The least friction is a quasi-convex problem, not a convex one: from a guess that is far off,
    IPOPT may end at a point that is no minimum.
    """
    hold, weight = least(*equilibrium(climber, middles)), GRAVITY * climber.mass
    held = np.isfinite(hold.mu)
    normal = np.where(held[:, None], np.clip(hold.normal, 0, JAMMED * weight), weight / 3)
    tangential = np.where(held[:, None], hold.tangential, 0.0)
    most = np.abs(tangential) <= MOST * normal
    friction = hold.mu[held].max(initial=0.0) if mu is None else mu
    return normal.ravel(), np.where(most, tangential, 0.0).ravel(), np.array([friction])


def _speeds(nodes: Way, fastest: float, *, halt: bool) -> tuple[Array, Array]:
    """Return bounds of b at the nodes."""
    upper = fastest / (nodes.speeds**2).max(axis=1)
    upper[[0, -1] if halt else [0]] = 0.0
    away = nodes.s - nodes.s[0]
    away = np.minimum(away, away[-1] - away) if halt else away
    return np.minimum(np.minimum(2 * MOVING * away, CREEP * fastest), upper), upper


def _rows(
    climber: Climber, middles: Way, steps: Array, unknowns: Sequence[ca.MX]
) -> tuple[list[ca.MX], list[Array], list[Array]]:
    """Return equations of motion, cones of friction and torques, with lower and upper bounds."""
    b, normal, tangential, mu = unknowns
    count, weight = steps.size, GRAVITY * climber.mass
    matrix, load = equilibrium(climber, middles)
    to_a, to_b = _differences(steps), _means(count)
    inert = [_diagonal(each[:, :, None]) for each in inertia(climber, middles)]
    moving = _sparse((inert[0] @ to_a + inert[1] @ to_b) / weight) @ b
    held = (
        _sparse(_diagonal(matrix[:, :, :3]) / weight) @ normal
        + _sparse(_diagonal(matrix[:, :, 3:]) / weight) @ tangential
    )
    torque = _torques(climber, middles, steps, b, tangential)
    most = np.tile([climber.torque * axle.wheels for axle in climber.axles], count)
    cone, nothing, above = 3 / weight, np.zeros(3 * count), np.full(3 * count, np.inf)
    rows = [held - moving, *(cone * (mu * normal + sign * tangential) for sign in (1, -1))]
    low, high = [(load / weight).ravel(), nothing, nothing], [(load / weight).ravel(), above, above]
    if np.isfinite(climber.torque):
        rows, low, high = [*rows, torque], [*low, -most], [*high, most]
    return rows, low, high


def _torques(climber: Climber, middles: Way, steps: Array, b: ca.MX, tangential: ca.MX) -> ca.MX:
    """Return the torques of all motors of every axle in the middles, shape (3 n, 1). [N m]."""
    spin = spin_inertia(climber)
    linear, square = (
        _diagonal((each * spin)[:, :, None]) for each in (middles.speeds, middles.slopes)
    )
    spinning = linear @ _differences(steps) + square @ _means(steps.size)
    return climber.radius * tangential + _sparse(spinning) @ b


def _differences(steps: Array) -> scipy.sparse.csr_matrix:
    """Return what b at the nodes is multiplied by to get a."""
    factors = 1 / (2 * steps)
    return scipy.sparse.diags([-factors, factors], [0, 1], (steps.size, steps.size + 1)).tocsr()


def _means(count: int) -> scipy.sparse.csr_matrix:
    """Return what b at the nodes is multiplied by to get it in the middles."""
    return scipy.sparse.diags([0.5, 0.5], [0, 1], (count, count + 1)).tocsr()


def _diagonal(blocks: Array) -> scipy.sparse.csr_matrix:
    return scipy.sparse.block_diag(list(blocks), format="csr")


def _sparse(matrix: scipy.sparse.csr_matrix) -> ca.DM:
    return ca.DM(matrix.tocsc())


def history(plan: Climb, unknowns: Array) -> Trajectory:
    """Return a planned climb over time, in the middles of its intervals.

    Parameters
    ----------
    plan : Climb
        From `climb`.
    unknowns : ndarray, shape (n_x,)
        Of its program: the solution.

    Returns
    -------
    Trajectory
        Of all `LABELS`. Statistics: ``mu`` and ``duration``.
    """
    where, middles, climber = plan.nlp.where, plan.middles, plan.climber
    b = np.maximum(unknowns[where["b"]], 0.0)
    steps, means = np.diff(plan.nodes.s), (b[:-1] + b[1:]) / 2
    speed, acceleration = np.sqrt(means), np.diff(b) / (2 * steps)
    durations = 2 * steps / (np.sqrt(b[:-1]) + np.sqrt(b[1:]))
    t = np.cumsum(durations) - durations + steps / (np.sqrt(b[:-1]) + speed)
    friction = unknowns[where["tangential"]]
    spinning = middles.speeds * acceleration[:, None] + middles.slopes * means[:, None]
    wheels = np.array([axle.wheels for axle in climber.axles])
    values = dict(zip(("x", "z", "tilt_rear", "tilt_front"), middles.q.T, strict=True)) | {
        "s": middles.s,
        "path_speed": speed,
        "path_acceleration": acceleration,
        "wheel_rate": middles.speeds * speed[:, None] / climber.radius,
        "torque": (climber.radius * friction + spin_inertia(climber) * spinning) / wheels,
        "load": unknowns[where["normal"]],
        "friction": friction,
    }
    columns = {label.name: Column(label, values[label.name]) for label in LABELS}
    statistics = {"mu": float(unknowns[where["mu"]][0]), "duration": float(durations.sum())}
    return Trajectory(t, columns, AXLES, statistics=statistics)


def in_sequence(parts: Sequence[Trajectory]) -> Trajectory:
    """Return planned climbs of legs, one after the other, as one.

    Times go on; path parameters begin anew with every leg. Statistics: the largest ``mu``, and the
    sum of the durations.

    Parameters
    ----------
    parts : sequence of Trajectory
        From `history`; all but the last one planned with a halt.
    """
    durations = [part.statistics["duration"] for part in parts]
    begins = np.cumsum([0.0, *durations[:-1]])
    later = [replace(part, t=part.t + begin) for part, begin in zip(parts, begins, strict=True)]
    statistics = {"mu": max(part.statistics["mu"] for part in parts), "duration": sum(durations)}
    return replace(joined(*later), statistics=statistics)
