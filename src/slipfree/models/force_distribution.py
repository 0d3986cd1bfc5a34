"""Distribute contact forces with least utilisation where equilibrium does not determine them."""

from __future__ import annotations

from math import prod
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from slipfree.core.records import Array, Mask

Index = npt.NDArray[np.intp]

NORMAL_FORCE_ROUNDING = 1e-9  # smaller negative normal forces count as zero [weight]
RANK_TOLERANCE = 1e-9  # smaller singular values count as zero [largest singular value]
BALANCE_TOLERANCE = 1e-8  # largest residual of an equilibrium that has a solution [weight]
MAX_INTERNAL_FORCE = 1e3  # makes the optimum of a jammed vehicle bounded [weight]
PHASE_ONE_FORCE = 0.02  # friction times normal force at which the search for a start ends [weight]
MAX_UTILISATION = 1e6  # beyond it, a wheel without normal force would have to bear a force
CENTRAL_DECREMENT = 0.7  # Newton decrement below which full steps converge and the level may move
MAX_NEWTON_STEPS = 400  # usual numbers are 50 to 130
ABSOLUTE, RELATIVE = 1e-9, 1e-8  # tolerances of the least utilisation
STEPS = np.array([8.0, 4.0, 2.0, 1.0, 0.5, 0.25, 0.1, 0.03, 0.01])  # trial steps to the centre
ADVANCES = 1 - np.array([0.02, 0.04, 0.08, 0.15, 0.3, 0.5, 0.7, 0.85, 0.93, 0.97, 0.99, 1.0])
RETREAT = 0.9  # used fraction of the farthest feasible advance


class Best(NamedTuple):
    """Distributions of the contact forces with the least utilisation, for n samples.

    ``utilisation`` (n,) is the least possible value of the largest ratio of tangential force to
    friction limit among the wheels; ``inf`` where no distribution exists, NaN where the
    optimisation does not converge [1]. ``force`` (n, 3 m) are contact forces with this utilisation
    (along, across, normal for each of m wheels), not always unique; NaN without a finite
    utilisation [weight].
    """

    utilisation: Array
    force: Array


class _Contacts(NamedTuple):
    """Contact forces of n samples on m wheels as affine functions of k internal forces ``y``.

    Forces (along, across, normal) at ``y = 0`` (n, 3, m) [weight] and their derivatives
    (n, 3, m, k) [1]. The normal forces are multiplied by the coefficients of friction, so that
    ``hypot(along, across) <= s normal`` is Coulomb's law at utilisation ``s``.
    """

    values: Array
    slopes: Array

    def pick(self, index: Index | Mask) -> _Contacts:
        return _Contacts(self.values[index], self.slopes[index])

    def at(self, y: Array) -> Array:
        """Return the three components for internal forces (..., n, k), shape (3, ..., n, m)."""
        n, _, m = self.values.shape
        trials = y.reshape(prod(y.shape[:-2]), n, y.shape[-1]).transpose(1, 2, 0)
        moved = self.slopes.reshape(n, 3 * m, y.shape[-1]) @ trials
        forces = self.values + moved.transpose(2, 0, 1).reshape(*y.shape[:-1], 3, m)
        return np.moveaxis(forces, -2, 0)


class _Goal(NamedTuple):
    """Objective of an optimisation: the least level p at which the contact forces meet a condition.

    The condition is ``hypot(along, across) <= (fixed + factor p) normal + shift p``. The tolerances
    are those of the least level; below ``enough`` the optimisation stops early.
    """

    fixed: float
    factor: float
    shift: float
    absolute: float
    relative: float
    enough: float


class _Newton(NamedTuple):
    """Newton step of the unknowns at a fixed level, for n samples.

    ``tangent`` (n, k) is the derivative of the central path with respect to the level, ``gap`` (n,)
    the estimated excess of the level over the least level.
    """

    step: Array
    tangent: Array
    decrement: Array
    gap: Array


PHASE_ONE_GOAL = _Goal(1.0, 0.0, 1.0, 1e-11, 0.2, -PHASE_ONE_FORCE)  # missing normal force
UTILISATION_GOAL = _Goal(0.0, 1.0, 0.0, ABSOLUTE, RELATIVE, -np.inf)  # utilisation


def least_utilisation(matrix: Array, load: Array, friction: Array) -> Best:
    """Return the contact forces in equilibrium that minimise the largest utilisation.

    Among all forces with ``matrix @ force + load = 0`` and nonnegative normal forces, it finds
    those that minimise ``max_i hypot(along_i, across_i) / (friction_i normal_i)``. By the limit
    theorems of plasticity, a minimum above one means that no distribution of the contact forces can
    hold the vehicle by Coulomb friction. A minimum below one means only that a suitable
    distribution exists, not that it occurs. The forces at a fixed utilisation form a convex set.
    Newton's method follows its analytic centre while the utilisation decreases (Boyd and El Ghaoui,
    Method of centers for minimizing generalized eigenvalues, Linear Algebra and its Applications
    188, 1993), for all samples at once. Internal forces are bounded by a thousand weights: for a
    vehicle braced between two walls, the minimum exists only under this bound.

    ``matrix`` (n, w, 3 m) has columns (along, across, normal) for every wheel, and any rank;
    ``load`` (n, w) is in units of the vehicle's weight, and ``friction`` (n, m) positive. Normal
    forces of the result are at least -1e-9 weights.
    """
    particular, free, solvable = _solutions(matrix, load)
    n, m = friction.shape
    size = np.stack([np.ones((n, m)), np.ones((n, m)), friction], 1)
    values = particular.reshape(n, m, 3).swapaxes(1, 2)
    slopes = free.reshape(n, m, 3, -1).swapaxes(1, 2)
    rounding = np.array([[0.0], [0.0], [NORMAL_FORCE_ROUNDING]])
    contacts = _Contacts(size * (values + rounding), size[..., None] * slopes)
    y = np.zeros((len(free), free.shape[2]))
    least = contacts.at(y)[2].min(1)
    poor = np.flatnonzero(solvable & (least < PHASE_ONE_FORCE))
    # positive normal forces to start from, where these exist
    normal = np.array([[0.0], [0.0], [1.0]])
    upright = _Contacts(contacts.values * normal, contacts.slopes * normal[..., None]).pick(poor)
    y[poor] = _follow_center(upright, y[poor], 1.0 - least[poor], PHASE_ONE_GOAL)
    held = np.flatnonzero(solvable & (contacts.at(y)[2].min(1) > 0))
    y[held] = _follow_center(
        contacts.pick(held),
        y[held],
        2.0 * _utilisation(contacts.pick(held), y[held]) + 0.001,
        UTILISATION_GOAL,
    )
    utilisation = np.full(len(y), np.inf)
    utilisation[held] = _utilisation(contacts.pick(held), y[held])
    utilisation[utilisation > MAX_UTILISATION] = np.inf
    utilisation[np.isnan(y).any(1)] = np.nan
    force = particular + _apply(free, y)
    force[~np.isfinite(utilisation)] = np.nan
    return Best(utilisation, force)


def _solutions(matrix: Array, load: Array) -> tuple[Array, Array, Mask]:
    """Return least-norm forces, a basis of internal forces, and a mask of solvable samples.

    The basis has at least one column, and as many as the largest null space of any sample has
    dimensions; columns beyond the null space of a sample are zero.
    """
    size = np.linalg.norm(matrix, axis=2)
    size = np.where(size > 0, size, 1.0)  # scales equations of different units alike
    rows, right = matrix / size[..., None], load / size
    u, values, vt = np.linalg.svd(rows)
    count = values.shape[1]
    used = values > RANK_TOLERANCE * values[:, :1]
    inverse = np.divide(1.0, values, out=np.zeros_like(values), where=used)
    part = inverse * np.einsum("nwr,nw->nr", u[:, :, :count], right)
    particular = -np.einsum("nrf,nr->nf", vt[:, :count], part)
    internal = np.ones(vt.shape[:2])
    internal[:, :count] = ~used
    first = min(int(used.sum(1).min()), vt.shape[1] - 1)
    free = np.swapaxes(vt * internal[..., None], 1, 2)[:, :, first:]
    residual = np.abs(_apply(rows, particular) + right).max(1)
    return particular, np.ascontiguousarray(free), residual < BALANCE_TOLERANCE


def _follow_center(contacts: _Contacts, y: Array, level: Array, goal: _Goal) -> Array:
    """Return the unknowns at the least level, from feasible ones at ``level``; or NaN."""
    y, level = y.copy(), level.copy()
    active = np.arange(len(y))
    for _ in range(MAX_NEWTON_STEPS):
        if active.size == 0:
            return y
        now = contacts.pick(active)
        newton = _newton(now, y[active], level[active], goal)
        central = newton.decrement < CENTRAL_DECREMENT
        near = newton.gap <= np.maximum(goal.absolute, goal.relative * np.abs(level[active]))
        lost = ~np.isfinite(newton.decrement)
        y[active[lost]] = np.nan
        done = (central & near) | (level[active] <= goal.enough) | lost
        for rows, move in ((~central & ~done, _center), (central & ~done, _advance)):
            if rows.any():
                some, index = _Newton(*(item[rows] for item in newton)), active[rows]
                y[index], level[index] = move(now.pick(rows), y[index], level[index], some, goal)
        active = active[~done]
    y[active] = np.nan
    return y


def _newton(contacts: _Contacts, y: Array, level: Array, goal: _Goal) -> _Newton:
    """Return the Newton step of the barrier ``-sum log(c^2 - t^2) - log(y_max^2 - y^2)``.

    ``c`` is the radius of a wheel's friction disc, ``t`` its tangential force and ``y_max`` the
    largest internal force. With ``a = c - t``, ``b = c + t`` and e the direction of t, the Hessian
    is a sum of squares of the relative slopes of a and b, and of the component of t across e;
    there is no cancellation near the cone. It is factorised without being formed, as ``R' R`` with
    the rows R (n, 3 m, k): a wheel with almost no load has slopes 1e9 times those of the others,
    whose squares would vanish in the sum.
    """
    along, across, normal = contacts.at(y)
    along_slope, across_slope, normal_slope = contacts.slopes.swapaxes(0, 1)
    factor = goal.fixed + goal.factor * level[:, None]
    radius = factor * normal + goal.shift * level[:, None]
    slope = factor[..., None] * normal_slope
    size = np.hypot(along, across)
    some = size > 0
    e_along = np.divide(along, size, out=np.ones_like(size), where=some)[..., None]
    e_across = np.divide(across, size, out=np.zeros_like(size), where=some)[..., None]
    outward = e_along * along_slope + e_across * across_slope
    sideways = e_along * across_slope - e_across * along_slope
    k, m = y.shape[1], size.shape[1]
    with np.errstate(divide="ignore", invalid="ignore"):  # where rounding has left the cone: NaN
        inverse = 1 / np.concatenate([radius - size, radius + size], 1)  # 1 / a and 1 / b
        bend = np.sqrt(2 * inverse[:, :m] * inverse[:, m:])
    radial = np.concatenate([slope - outward, slope + outward], 1) * inverse[..., None]
    rows = np.concatenate([radial, bend[..., None] * sideways], 1)
    # derivatives of the friction discs' radii and of their slopes with respect to the level
    radius_rate = goal.factor * normal + goal.shift
    normal_rate = goal.factor * normal_slope
    room = MAX_INTERNAL_FORCE**2 - (y * y).sum(1)
    edge = 2 * y / room[:, None]
    ball = np.sqrt(2 / room)[:, None, None] * np.eye(k)
    q, r = np.linalg.qr(np.concatenate([rows, edge[:, None], ball], 1))
    radial = np.swapaxes(rows[:, : 2 * m], 1, 2)
    gradient = edge - radial.sum(2)
    weight = inverse[:, :m] + inverse[:, m:]
    change = _apply(radial, np.tile(radius_rate, 2) * inverse)
    change -= _apply(np.swapaxes(normal_rate, 1, 2), weight)
    first = q[:, : 2 * m].sum(1) - q[:, 3 * m]  # negative gradient, in terms of the same rows
    second = np.linalg.solve(np.swapaxes(r, 1, 2), -change[..., None])[..., 0]
    solved = np.linalg.solve(r, np.stack([first, second], -1))
    step = solved[..., 0]
    decrement = np.sqrt(np.maximum(-(gradient * step).sum(1), 0.0))
    gap = 2 * m / (weight * radius_rate).sum(1)  # parameter of the barrier divided by its rate
    return _Newton(step, solved[..., 1], decrement, gap)


def _center(
    contacts: _Contacts, y: Array, level: Array, newton: _Newton, goal: _Goal
) -> tuple[Array, Array]:
    """Return the point of least barrier along the Newton step, and the unchanged level."""
    safe = 1 / (1 + newton.decrement)  # stays inside: the barrier is self-concordant
    steps = np.vstack([np.repeat(STEPS[:, None], len(y), 1), safe])
    barrier = _barrier(contacts, y + steps[..., None] * newton.step, level + 0 * steps, goal)
    chosen = steps[barrier.argmin(0), np.arange(len(y))]
    return y + chosen[:, None] * newton.step, level


def _advance(
    contacts: _Contacts, y: Array, level: Array, newton: _Newton, goal: _Goal
) -> tuple[Array, Array]:
    """Return the farthest feasible point along the central path, and its level."""
    falls = -ADVANCES[:, None] * newton.gap
    centre = y + newton.step

    def inside(move: Array) -> Mask:
        points = centre + move[..., None] * newton.tangent
        return np.isfinite(_barrier(contacts, points, level + move, goal))

    held = inside(falls) & inside(RETREAT * falls)  # points and levels together are not convex
    first = held.argmax(0)
    samples = np.arange(len(y))
    move = RETREAT * falls[first, samples]
    ok = held[first, samples]
    return (
        np.where(ok[:, None], centre + move[:, None] * newton.tangent, y),
        np.where(ok, level + move, level),
    )


def _barrier(contacts: _Contacts, y: Array, level: Array, goal: _Goal) -> Array:
    """Return the barrier of j trials for n poses, shape (j, n), infinite outside the cones.

    The k internal forces ``y`` of a trial have shape (j, n, k), its utilisation ``level`` (j, n).
    The cone of a contact is ``|tangential| <= (fixed + factor level) normal + shift level``.
    """
    along, across, normal = contacts.at(y)
    radius = (goal.fixed + goal.factor * level[..., None]) * normal + goal.shift * level[..., None]
    size = np.hypot(along, across)
    room = MAX_INTERNAL_FORCE**2 - (y * y).sum(-1, keepdims=True)
    # a negative utilisation would invert the cone: level times factor must stay positive
    sign = np.where(goal.factor * level < 0, -1.0, 1.0)[..., None]
    slack = np.concatenate([radius - size, radius + size, room, sign], -1)
    held = (slack > 0).all(-1)
    return np.where(held, -np.log(np.where(slack > 0, slack, 1.0)).sum(-1), np.inf)


def _utilisation(contacts: _Contacts, y: Array) -> Array:
    along, across, normal = contacts.at(y)
    return np.asarray((np.hypot(along, across) / normal).max(1))


def _apply(matrices: Array, vectors: Array) -> Array:
    return np.asarray((matrices @ vectors[..., None])[..., 0])
