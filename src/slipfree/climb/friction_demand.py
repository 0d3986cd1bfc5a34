"""Slow climbs: which contact forces hold the vehicle, and how much friction they need.

The ground pushes an axle with N along its normal and T along the ground, forward. Equilibrium has
four equations: both components of force, and the moments about the joint of either body with its
wheels, so that torques of the motors are internal. Six forces leave two of them to choose. The
least coefficient of friction, the least of the largest ``|T| / N`` over all choices, comes from
Newton's iteration on linear programs (Dinkelbach's, for many ratios): at a coefficient mu the
program finds the forces of largest least reserve ``mu N - |T|``, relative to the last N; their own
largest ratio is the next mu. It falls until no reserve is left; where wheels nearly jam it falls
slowly, and bisection ends it. The programs of all configurations are one, of separate blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy.sparse

from slipfree.climb.contact_path import Leg, Way, axle_arms, legs, sample, tangents
from slipfree.climb.profile import Profile, step
from slipfree.climb.vehicle import Body, Climber
from slipfree.errors import ModelError
from slipfree.records import Array
from slipfree.trajectory import SolverError
from slipfree.vehicle.tree import GRAVITY

MOST = 10.0  # a larger coefficient of friction counts as none
UNLOADED = 1e-9  # normal force that counts as none in a ratio [weight]
REACH = 1e3  # normal forces stay below this, so that jammed wheels have an optimum [weight]
CLOSE = 1e-9  # reserve of friction, relative, that counts as none
ROUNDS = 20  # most of Newton's iterations; 5 to 9 are usual
HALVES = 34  # of the bracket of what is not found by then
ZOOMS = 5  # times that the neighborhood of the worst place is sampled more closely: it may be
CLOSER = 3  # where a wheel comes to an edge, with a steep fall behind; places between two old ones
HEIGHTS = 8  # heights that are tried before the first that is too high is narrowed down
NARROW = 1e-4  # how exactly [m]


class Hold(NamedTuple):
    """Contact forces that need the least friction, for n configurations.

    Attributes
    ----------
    mu : ndarray, shape (n,)
        The least coefficient of friction; ``inf`` where no forces hold the vehicle. [1]
    normal, tangential : ndarray, shape (n, 3)
        Forces of the ground on the rear, the middle and the front axle; NaN where none hold it. [N]
    """

    mu: Array
    normal: Array
    tangential: Array


class Demand(NamedTuple):
    """What a leg of a slow climb demands of the ground.

    Attributes
    ----------
    leg : Leg
        Which one.
    s : ndarray, shape (n,)
        Path parameters on it. [m]
    hold : Hold
        Friction and forces there.
    """

    leg: Leg
    s: Array
    hold: Hold

    @property
    def mu(self) -> float:
        """The largest demand on the leg. [1]."""
        return float(self.hold.mu.max())


class Friction(NamedTuple):
    """How much friction a slow climb needs.

    Attributes
    ----------
    mu : float
        The least coefficient with which it can be climbed; ``inf`` if none will do. [1]
    axle : str
        Which wheels climb where so much is needed.
    s : float
        Where, in the path parameter of that leg. [m]
    q : ndarray, shape (4,)
        The configuration there. [m, rad]
    demands : tuple of Demand
        Leg by leg.
    """

    mu: float
    axle: str
    s: float
    q: Array
    demands: tuple[Demand, ...]


def equilibrium(climber: Climber, way: Way) -> tuple[Array, Array]:
    """Return the equations ``A f = b`` of equilibrium.

    Returns
    -------
    A : ndarray, shape (n, 4, 6)
        Forward and upward force and the moments, nose-up, about the joint, of the rear and the
        front body with their wheels; for N of the rear, middle and front axle, then for T.
    b : ndarray, shape (n, 4)
        What carries the weight. [N], [N m]
    """
    points = axle_arms(climber, way.q) - climber.radius * way.normals
    directions = np.concatenate([way.normals, tangents(way.normals)], axis=1)
    moments = cross(np.concatenate([points, points], axis=1), directions)
    matrix = np.zeros((len(way.q), 4, 6))
    matrix[:, :2] = directions.transpose(0, 2, 1)
    matrix[:, 2, [0, 1, 3, 4]] = moments[:, [0, 1, 3, 4]]
    matrix[:, 3, [2, 5]] = moments[:, [2, 5]]
    bodies = (climber.rear_body, climber.front_body)
    levers = [body.mass * center(body, way.q[:, 2 + k])[:, 0] for k, body in enumerate(bodies)]
    weight = np.full(len(way.q), climber.mass)
    return matrix, GRAVITY * np.stack([0 * weight, weight, *levers], axis=1)


def center(body: Body, tilt: Array) -> Array:
    """Return where the center of mass of a body is from the joint, shape (n, 2). [m]."""
    forward, up = np.cos(tilt), np.sin(tilt)
    return np.stack(
        [body.ahead * forward - body.above * up, body.ahead * up + body.above * forward], axis=1
    )


def cross(a: Array, b: Array) -> Array:
    """Return the moments of vectors b (..., 2) at places a (..., 2), nose-up."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def least(matrix: Array, load: Array) -> Hold:
    """Return the forces that solve equations of equilibrium with the least friction.

    Parameters
    ----------
    matrix, load : ndarray, shape (n, 4, 6) and (n, 4)
        The equations, in the form of `equilibrium`.
    """
    count = len(load)
    even = np.full((count, 3), load[:, 1:2] / 3)
    mu, relative = np.full(count, MOST), even.copy()
    best = np.full((count, 6), np.nan)
    open_ = np.arange(count)
    for _ in range(ROUNDS):
        forces, reserve = _reserve(matrix[open_], load[open_], mu[open_], relative[open_])
        better = reserve > CLOSE
        open_, forces = open_[better], forces[better]
        if not open_.size:
            break
        best[open_], relative[open_] = forces, forces[:, :3]
        bearing = np.maximum(forces[:, :3], UNLOADED * load[open_, 1:2])
        mu[open_] = (np.abs(forces[:, 3:]) / bearing).max(axis=1)
    if open_.size:
        low, high = np.zeros(open_.size), mu[open_]
        for _ in range(HALVES):
            middle = (low + high) / 2
            forces, reserve = _reserve(matrix[open_], load[open_], middle, even[open_])
            held = reserve > 0
            best[open_[held]] = forces[held]
            low, high = np.where(held, low, middle), np.where(held, middle, high)
        mu[open_] = high
    mu[np.isnan(best[:, 0])] = np.inf
    return Hold(mu, best[:, :3], best[:, 3:])


def _reserve(matrix: Array, load: Array, mu: Array, relative: Array) -> tuple[Array, Array]:
    """Return the forces of largest least reserve of friction, and that, for each configuration."""
    from scipy.optimize import linprog  # imported where it is used: it takes 0.2 s

    count, size = len(load), load[:, 1].mean()
    eye, blocks = np.eye(3), []
    for friction, part in zip(mu, relative, strict=True):
        column = (part / size)[:, None]
        blocks.append(np.block([[-friction * eye, eye, column], [-friction * eye, -eye, column]]))
    equations = np.concatenate([matrix, np.zeros((count, 4, 1))], axis=2)
    bounds = [*[(None, REACH)] * 3, *[(None, None)] * 4]
    found = linprog(
        np.tile([0.0] * 6 + [-1.0], count),
        scipy.sparse.block_diag(blocks, format="csc"),
        np.zeros(6 * count),
        scipy.sparse.block_diag(equations, format="csc"),
        (load / size).ravel(),
        bounds=bounds * count,
        method="highs",
    )
    if found.status != 0:
        raise SolverError(f"climb: the equations of equilibrium have no solution: {found.message}")
    values = found.x.reshape(count, 7)
    return values[:, :6] * size, values[:, 6]


def least_friction(climber: Climber, profile: Profile, samples: int = 41) -> Friction:
    """Return how much friction a slow climb of a profile needs.

    Parameters
    ----------
    climber : Climber
        The vehicle.
    profile : Profile
        What it climbs.
    samples : int
        Configurations on every leg; around the worst one as many again, more and more closely.

    Raises
    ------
    ModelError
        If the vehicle gets stuck.
    """
    demands = _demands(climber, profile, samples)
    worst = max(demands, key=lambda each: each.mu)
    k = int(worst.hold.mu.argmax())
    return Friction(
        worst.mu,
        worst.leg.axle,
        float(worst.s[k]),
        sample(climber, profile, worst.leg, worst.s[k : k + 1]).q[0],
        demands,
    )


def _demands(climber: Climber, profile: Profile, samples: int) -> tuple[Demand, ...]:
    """Return the demands of all legs at even distances and around the worst place of each."""
    found = legs(climber, profile)
    places = [np.linspace(0, leg.length, samples) for leg in found]
    holds = _holds(climber, profile, found, places)
    for _ in range(ZOOMS):
        near = [_around(s, int(hold.mu.argmax())) for s, hold in zip(places, holds, strict=True)]
        more = _holds(climber, profile, found, near)
        orders = [np.argsort(np.append(*pair)) for pair in zip(places, near, strict=True)]
        places = [
            np.append(s, new)[order] for s, new, order in zip(places, near, orders, strict=True)
        ]
        holds = [
            Hold(*(np.concatenate(pair)[order] for pair in zip(old, new, strict=True)))
            for old, new, order in zip(holds, more, orders, strict=True)
        ]
    return tuple(Demand(*each) for each in zip(found, places, holds, strict=True))


def _around(s: Array, k: int) -> Array:
    """Return places between a place and its neighbors."""
    between = [np.linspace(a, b, CLOSER + 2)[1:-1] for a, b in pairwise(s[max(k - 1, 0) : k + 2])]
    return np.concatenate(between)


def _holds(
    climber: Climber, profile: Profile, found: Sequence[Leg], places: Sequence[Array]
) -> list[Hold]:
    """Return the holds of legs at their own places, from one program."""
    equations = [
        equilibrium(climber, sample(climber, profile, leg, s))
        for leg, s in zip(found, places, strict=True)
    ]
    hold = least(*(np.concatenate(part) for part in zip(*equations, strict=True)))
    ends = np.cumsum([0, *(s.size for s in places)]).tolist()
    return [Hold(*(part[a:b] for part in hold)) for a, b in pairwise(ends)]


def highest(
    climber: Climber, mu: float, tallest: float, make: Callable[[float], Profile] = step
) -> float:
    """Return up to which height all obstacles of a kind can be climbed slowly. [m].

    Higher ones may need less friction than lower ones; what counts is the first that needs more.

    Parameters
    ----------
    climber : Climber
        The vehicle.
    mu : float
        Coefficient of friction. [1]
    tallest : float
        Height beyond which nothing is tried, and returned if nothing below is too high. [m]
    make : callable
        Height to profile; steps by default.
    """
    from scipy.optimize import brentq  # imported where it is used: it takes 0.2 s

    def excess(height: float) -> float:
        try:
            return min(least_friction(climber, make(height), 15).mu, MOST) - mu
        except ModelError:
            return MOST

    low = NARROW
    if excess(low) > 0:
        return 0.0
    for height in np.linspace(0, tallest, HEIGHTS + 1)[1:].tolist():
        if excess(height) > 0:
            return float(brentq(excess, low, height, xtol=NARROW))
        low = height
    return tallest
