"""Friction demand of slow climbs: contact forces in equilibrium that need the least friction.

The ground acts on an axle with the normal force N and the tangential force T, positive forward.
Equilibrium has four equations: both components of force, and for each body with its wheels the
moment about the joint, in which motor torques are internal. With six contact forces, two degrees of
freedom remain. The least coefficient of friction is the minimum of the largest ``|T| / N``. It
follows from a Newton iteration on linear programs (Dinkelbach's algorithm for several ratios): for
a coefficient mu, the program maximises the smallest reserve ``mu N - |T|``, relative to the last N;
the largest ratio of these forces is the next mu. The iteration ends when no reserve is left. It is
slow where wheels nearly jam; bisection then completes it. The programs of all configurations are
solved as one block-diagonal program.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import scipy

from slipfree.climb.contact_path import Leg, PathSamples, axle_arms, legs, sample, tangents
from slipfree.core.records import Array
from slipfree.core.trajectory import SolverError
from slipfree.terrain.solids import Profile
from slipfree.vehicle.climber import Body, Climber
from slipfree.vehicle.tree import GRAVITY

MAX_FRICTION = 10.0  # climbs that need a larger coefficient count as impossible
MIN_NORMAL_FORCE = 1e-9  # smaller normal forces count as zero in a ratio [weight]
MAX_NORMAL_FORCE = 1e3  # makes the optimum of jammed wheels bounded [weight]
MIN_RESERVE = 1e-9  # smaller relative reserves of friction count as zero
MAX_NEWTON_STEPS = 20  # usual numbers are 5 to 9
BISECTIONS = 34  # bisections after Newton steps that do not converge
REFINEMENTS = 5  # refinements of the sampling around the worst configuration, often at an edge
REFINED_POINTS = 3  # new points between two samples


class HoldingForces(NamedTuple):
    """Contact forces that need the least friction, for n configurations.

    Attributes
    ----------
    mu : ndarray, shape (n,)
        Least coefficient of friction; ``inf`` where no forces hold the vehicle. [1]
    normal, tangential : ndarray, shape (n, 3)
        Normal and tangential (positive forward) forces of the ground on the rear, middle and front
        axle; NaN where no forces hold the vehicle. [N]
    """

    mu: Array
    normal: Array
    tangential: Array


class Demand(NamedTuple):
    """Friction demand of a leg of a slow climb.

    Attributes
    ----------
    leg : Leg
        Leg of the contact path.
    s : ndarray, shape (n,)
        Path parameters on the leg. [m]
    hold : HoldingForces
        Least coefficient of friction and contact forces at these path parameters.
    """

    leg: Leg
    s: Array
    hold: HoldingForces

    @property
    def mu(self) -> float:
        """Largest coefficient needed on the leg [1]."""
        return float(self.hold.mu.max())


class Friction(NamedTuple):
    """Friction demand of a slow climb.

    Attributes
    ----------
    mu : float
        Least coefficient of friction of the whole climb; ``inf`` if no coefficient suffices. [1]
    axle : str
        Name of the climbing axle on the leg with the largest demand.
    s : float
        Path parameter of the largest demand on that leg. [m]
    q : ndarray, shape (4,)
        Configuration of the largest demand. [m, rad]
    demands : tuple of Demand
        Demands of all legs.
    """

    mu: float
    axle: str
    s: float
    q: Array
    demands: tuple[Demand, ...]


def equilibrium(climber: Climber, path: PathSamples) -> tuple[Array, Array]:
    """Return the equilibrium equations ``A f = b`` of the contact forces ``f``.

    Returns
    -------
    A : ndarray, shape (n, 4, 6)
        Rows are forward force, upward force, and the nose-up moments of the rear and the front
        body with their wheels about the joint. Columns are the normal forces on the rear, middle
        and front axle, and the tangential forces on them, positive forward. [1, m]
    b : ndarray, shape (n, 4)
        Negative load of gravity. [N, N m]
    """
    points = axle_arms(climber, path.q) - climber.radius * path.normals
    directions = np.concatenate([path.normals, tangents(path.normals)], axis=1)
    moments = cross(np.concatenate([points, points], axis=1), directions)
    matrix = np.zeros((len(path.q), 4, 6))
    matrix[:, :2] = directions.transpose(0, 2, 1)
    matrix[:, 2, [0, 1, 3, 4]] = moments[:, [0, 1, 3, 4]]
    matrix[:, 3, [2, 5]] = moments[:, [2, 5]]
    bodies = (climber.rear_body, climber.front_body)
    levers = [body.mass * center(body, path.q[:, 2 + k])[:, 0] for k, body in enumerate(bodies)]
    weight = np.full(len(path.q), climber.mass)
    return matrix, GRAVITY * np.stack([0 * weight, weight, *levers], axis=1)


def center(body: Body, tilt: Array) -> Array:
    """Return the centre of mass of a body relative to the joint, shape (n, 2) [m]."""
    forward, up = np.cos(tilt), np.sin(tilt)
    return np.stack(
        [body.ahead * forward - body.above * up, body.ahead * up + body.above * forward], axis=1
    )


def cross(a: Array, b: Array) -> Array:
    """Return the nose-up moments of forces b (..., 2) at positions a (..., 2), shape (...)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def least_friction_forces(matrix: Array, load: Array) -> HoldingForces:
    """Return the forces in equilibrium that need the least friction.

    Parameters
    ----------
    matrix, load : ndarray, shape (n, 4, 6) and (n, 4)
        The equations, in the form of `equilibrium`.
    """
    count = len(load)
    even = np.full((count, 3), load[:, 1:2] / 3)
    mu, relative = np.full(count, MAX_FRICTION), even.copy()
    best = np.full((count, 6), np.nan)
    open_ = np.arange(count)
    for _ in range(MAX_NEWTON_STEPS):
        forces, reserve = _reserve(matrix[open_], load[open_], mu[open_], relative[open_])
        better = reserve > MIN_RESERVE
        open_, forces = open_[better], forces[better]
        if not open_.size:
            break
        best[open_], relative[open_] = forces, forces[:, :3]
        bearing = np.maximum(forces[:, :3], MIN_NORMAL_FORCE * load[open_, 1:2])
        mu[open_] = (np.abs(forces[:, 3:]) / bearing).max(axis=1)
    if open_.size:
        low, high = np.zeros(open_.size), mu[open_]
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            forces, reserve = _reserve(matrix[open_], load[open_], middle, even[open_])
            held = reserve > 0
            best[open_[held]] = forces[held]
            low, high = np.where(held, low, middle), np.where(held, middle, high)
        mu[open_] = high
    mu[np.isnan(best[:, 0])] = np.inf
    return HoldingForces(mu, best[:, :3], best[:, 3:])


def _reserve(matrix: Array, load: Array, mu: Array, relative: Array) -> tuple[Array, Array]:
    """Return the contact forces that maximise the smallest friction reserve, and this reserve.

    The forces (n, 6) [N] satisfy ``matrix @ f = load``. The reserve of an axle, shape (n,), is
    ``(mu N - |T|) / relative``, with the normal force N and the tangential force T.
    """
    from scipy.optimize import linprog  # imported here: the import takes 0.2 s

    count, size = len(load), load[:, 1].mean()
    rows, axles = np.zeros((count, 2, 3, 7)), np.arange(3)  # of T and of -T, for each axle
    rows[:, :, axles, axles] = -mu[:, None, None]
    rows[:, :, axles, 3 + axles] = [[1.0], [-1.0]]
    rows[..., 6] = (relative / size)[:, None]
    equations = np.concatenate([matrix, np.zeros((count, 4, 1))], axis=2)
    bounds = [*[(None, MAX_NORMAL_FORCE)] * 3, *[(None, None)] * 4]
    found = linprog(
        np.tile([0.0] * 6 + [-1.0], count),
        scipy.sparse.block_diag(rows.reshape(count, 6, 7), format="csc"),
        np.zeros(6 * count),
        scipy.sparse.block_diag(equations, format="csc"),
        (load / size).ravel(),
        bounds=bounds * count,
        method="highs",
    )
    if found.status != 0:
        raise SolverError(
            "climb: expected forces in equilibrium with the least friction, found none: "
            f"{found.message} (linear program); check masses and dimensions of the vehicle"
        )
    values = found.x.reshape(count, 7)
    return values[:, :6] * size, values[:, 6]


def least_friction(climber: Climber, profile: Profile, samples: int = 41) -> Friction:
    """Return the friction demand of a slow climb of a profile.

    Parameters
    ----------
    climber : Climber
        The vehicle.
    profile : Profile
        The ground.
    samples : int
        Number of configurations on every leg; more are added around the one with the largest
        demand.

    Raises
    ------
    ModelError
        If there is no contact path over the profile, see `slipfree.climb.contact_path.legs`.
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
    """Return the demands of all legs, at equally spaced samples and around the largest demand."""
    found = legs(climber, profile)
    places = [np.linspace(0, leg.length, samples) for leg in found]
    holds = _holds(climber, profile, found, places)
    for _ in range(REFINEMENTS):
        near = [
            _points_around(s, int(hold.mu.argmax())) for s, hold in zip(places, holds, strict=True)
        ]
        more = _holds(climber, profile, found, near)
        orders = [np.argsort(np.append(*pair)) for pair in zip(places, near, strict=True)]
        places = [
            np.append(s, new)[order] for s, new, order in zip(places, near, orders, strict=True)
        ]
        holds = [
            HoldingForces(*(np.concatenate(pair)[order] for pair in zip(old, new, strict=True)))
            for old, new, order in zip(holds, more, orders, strict=True)
        ]
    return tuple(Demand(*each) for each in zip(found, places, holds, strict=True))


def _points_around(s: Array, k: int) -> Array:
    """Return more path parameters, between sample ``k`` and its neighbours [m]."""
    between = [
        np.linspace(a, b, REFINED_POINTS + 2)[1:-1] for a, b in pairwise(s[max(k - 1, 0) : k + 2])
    ]
    return np.concatenate(between)


def _holds(
    climber: Climber, profile: Profile, found: Sequence[Leg], places: Sequence[Array]
) -> list[HoldingForces]:
    """Return the least-friction forces on several legs, from one linear program.

    ``places`` are the path parameters of each leg [m].
    """
    equations = [
        equilibrium(climber, sample(climber, profile, leg, s))
        for leg, s in zip(found, places, strict=True)
    ]
    hold = least_friction_forces(*(np.concatenate(part) for part in zip(*equations, strict=True)))
    ends = np.cumsum([0, *(s.size for s in places)]).tolist()
    return [HoldingForces(*(part[a:b] for part in hold)) for a, b in pairwise(ends)]
