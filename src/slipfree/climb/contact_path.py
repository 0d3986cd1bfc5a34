"""Contact path and friction demand of slow climbs of an articulated vehicle over a profile.

All three axles stay on the ground, so that one degree of freedom remains: the path parameter s,
whose increment is the root mean square of the path increments of the three axles. Configurations
are ``(x, z, rear tilt, front tilt)`` of the joint and the bodies. A leg begins where a wheel meets
another solid: there the path has a kink, which a vehicle in motion passes only with an impact.

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

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy

from slipfree.catalog.step_climber import AXLES, Climber, ClimberLink
from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.core.trajectory import SolverError
from slipfree.terrain.solids import Profile

Solids = tuple[int, ...]  # index of the solid below each axle
FLOOR: Solids = (0, 0, 0)
TILT_INDICES = (2, 2, 3)  # index of the tilt of the body that carries each axle
NORMAL_TOLERANCE = 1e-12  # a normal belongs to a face if 1 minus their cosine is smaller
LEVEL_SLOPE = 1e-3  # a wheel with a smaller slope of its path has reached the top [rad]
MIN_TILT_COSINE = 0.05  # cosine of the largest tilt of a body
MAX_CONTACT_GAP = 1e-6  # a wheel with a smaller gap touches [m]
END_MARGIN = 1e-3  # a climb ends a radius and this distance behind the last corner [m]
MAX_LEG_LENGTH = 50.0  # largest length of a leg [m]
TOLERANCE = 1e-8  # tolerance of the configurations along the path [m, rad]
MIN_STEPS_PER_RADIUS = 4  # smallest number of steps per wheel radius, so that no solid is missed
MAX_FRICTION = 10.0  # climbs that need a larger coefficient count as impossible
MIN_NORMAL_FORCE = 1e-9  # smaller normal forces count as zero in a ratio [weight]
MAX_NORMAL_FORCE = 1e3  # makes the optimum of jammed wheels bounded [weight]
MIN_RESERVE = 1e-9  # smaller relative reserves of friction count as zero
MAX_NEWTON_STEPS = 20  # usual numbers are 5 to 9
BISECTIONS = 34  # bisections after Newton steps that do not converge
REFINEMENTS = 5  # refinements of the sampling around the worst configuration, often at an edge
REFINED_POINTS = 3  # new points between two samples


class Leg(NamedTuple):
    """Smooth section of the path, from where a wheel meets a solid to the next one, or to the end.

    The wheels of ``axle`` meet a solid at its start, and then climb it; ``solids`` are the indices
    in ``Profile.solids`` of the solids below the rear, the middle and the front axle. The path
    parameter is zero at the start, ``length`` at the end and ``top`` where the climbing wheels move
    horizontally again, or ``length`` if they do not [m]. ``curve`` maps path parameters (n,) [m] to
    configurations (4, n) [m, rad].
    """

    axle: str
    solids: Solids
    length: float
    top: float
    curve: Callable[[Array], Array]


class PathSamples(NamedTuple):
    """Configurations on a leg at n path parameters ``s`` [m].

    ``q``, ``first`` and ``second`` (n, 4) are configurations [m, rad] and their derivatives with
    respect to s, ``normals`` (n, 3, 2) the unit normals of the ground at the contacts of the axles,
    ``speeds`` (n, 3) the speeds of the axles along the ground divided by the rate of s [1], and
    ``slopes`` their derivatives with respect to s [1/m].
    """

    s: Array
    q: Array
    first: Array
    second: Array
    normals: Array
    speeds: Array
    slopes: Array


def legs(climber: Climber, profile: Profile) -> tuple[Leg, ...]:
    """Return the legs of the path, from the first contact of the front wheels to the end.

    ModelError is raised if the floor is not level, if there is no obstacle, or if the vehicle gets
    stuck: a body would have to stand upright, a wheel is caught between two solids, or a leg is
    longer than 50 m.
    """
    corners = [x for solid in profile.solids[1:] for x, _ in solid.points]
    ends = [x for x in corners if x < max(x for x, _ in profile.solids[0].points)]
    if not ends:
        raise ModelError(
            "climb: expected an obstacle that begins before the end of the floor, the first solid, "
            "found none; add an obstacle, such as a step"
        )
    end = max(ends) + climber.radius + END_MARGIN
    q, solids = _start(climber, profile, min(ends)), FLOOR
    path: list[Leg] = []
    axle = ""
    while True:
        curve, length, top, met = _march(climber, profile, q, solids, axle, end)
        if axle:
            path.append(Leg(axle, solids, length, top, curve))
        if met is None:
            return tuple(path)
        q = curve(np.array([length]))[:, 0]
        axle, solids, q = _configuration_behind_kink(climber, profile, q, solids, met)


def sample(climber: Climber, profile: Profile, leg: Leg, s: Array) -> PathSamples:
    """Return the configurations of a leg, and their derivatives, at path parameters ``s``, (n,)."""
    q = _closest_configurations(climber, profile, leg.curve(s).T, leg.solids)
    arms = axle_arms(climber, q)
    _, normals, curvature = _contacts(climber, profile, q, leg.solids)
    along = tangents(normals)
    first = _direction(normals, arms)
    across_rows, along_rows = _speed_jacobian(normals, arms), _speed_jacobian(along, arms)
    speeds = (along_rows @ first[:, :, None])[..., 0]
    centripetal = -(first[:, TILT_INDICES] ** 2)[..., None] * arms
    matrix = np.concatenate([across_rows, (speeds[:, None] @ along_rows)], axis=1)
    bend = -curvature * speeds**2 - (normals * centripetal).sum(axis=-1)
    even = -(speeds[..., None] * along * centripetal).sum(axis=(1, 2))
    # the gaps stay zero, and the mean square of the axles' speeds stays one
    right = np.concatenate([bend, even[:, None]], axis=1)
    second = np.linalg.solve(matrix, right[..., None])[..., 0]
    slopes = (along_rows @ second[:, :, None])[..., 0] + (along * centripetal).sum(axis=-1)
    return PathSamples(s, q, first, second, normals, speeds, slopes)


def axle_arms(climber: Climber, q: Array) -> Array:
    """Return the axles' positions relative to the joint in fixed axes, shape (n, 3, 2) [m]."""
    tilts = q[:, TILT_INDICES]
    ahead = np.array([axle.ahead for axle in climber.axles])
    return np.asarray(ahead[:, None] * np.stack([np.cos(tilts), np.sin(tilts)], axis=-1))


def tangents(normals: Array) -> Array:
    """Return the forward tangents of the ground for normals of shape (..., 2)."""
    return np.stack([normals[..., 1], -normals[..., 0]], axis=-1)


def rotate_nose_up(vectors: Array) -> Array:
    """Return vectors (..., 2) rotated by a right angle, nose-up."""
    return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)


def _speed_jacobian(directions: Array, arms: Array) -> Array:
    """Return the derivatives of speeds along directions (n, 3, 2) by the rates of q, (n, 3, 4)."""
    rows = np.zeros((*directions.shape[:2], 4))
    rows[..., :2] = directions
    lever = (directions * rotate_nose_up(arms)).sum(axis=-1)
    rows[:, np.arange(3), TILT_INDICES] = lever
    return rows


def _direction(normals: Array, arms: Array) -> Array:
    """Return the derivative of the configuration with respect to s, shape (n, 4)."""
    # null vector of the three contact conditions; its sign is that of forward motion
    rates = np.linalg.svd(_speed_jacobian(normals, arms))[2][:, -1]
    speeds = (_speed_jacobian(tangents(normals), arms) @ rates[:, :, None])[..., 0]
    size = np.copysign(np.sqrt((speeds**2).mean(axis=1)), speeds.sum(axis=1))
    return np.asarray(rates / size[:, None])


def _contacts(
    climber: Climber, profile: Profile, q: Array, solids: Solids
) -> tuple[Array, Array, Array]:
    """Return gaps (n, 3) [m], normals (n, 3, 2) and path curvatures (n, 3) [1/m] of the axles."""
    places = q[:, None, :2] + axle_arms(climber, q)
    gaps, curvature = np.empty(places.shape[:2]), np.empty(places.shape[:2])
    normals = np.empty(places.shape)
    for index in set(solids):
        solid = profile.solids[index]
        on_it = [i for i, below in enumerate(solids) if below == index]
        distance, normal = solid.distance(places[:, on_it, 0], places[:, on_it, 1])
        gaps[:, on_it], normals[:, on_it] = distance - climber.radius, normal
        on_face = (normal @ solid.normals.T).max(axis=-1) > 1 - NORMAL_TOLERANCE
        # round a corner the axle's path is a circle about it; along a face it is straight
        curvature[:, on_it] = np.where(on_face, 0.0, 1 / climber.radius)
    return gaps, normals, curvature


def _closest_configurations(climber: Climber, profile: Profile, q: Array, solids: Solids) -> Array:
    """Return configurations near q, shape (n, 4), in which all axles touch their solids."""
    for _ in range(3):  # Newton's method, from gaps of at most MAX_CONTACT_GAP
        gaps, normals, _ = _contacts(climber, profile, q, solids)
        rows = _speed_jacobian(normals, axle_arms(climber, q))
        q = q - (np.linalg.pinv(rows) @ gaps[..., None])[..., 0]
    return q


def _start(climber: Climber, profile: Profile, first: float) -> Array:
    level = max(z for _, z in profile.solids[0].points) + climber.radius
    x = first - 2 * climber.radius - climber.front.ahead
    q = np.array([x, level, 0.0, 0.0])
    gaps = _contacts(climber, profile, q[None], FLOOR)[0]
    if np.abs(gaps).max() > MAX_CONTACT_GAP:
        raise ModelError(
            f"climb: expected a level floor for the vehicle around x = {x:.3g} m, found a gap of "
            f"{np.abs(gaps).max():.3g} m between wheels and floor; extend or level the first solid"
        )
    return q


def _configuration_behind_kink(
    climber: Climber, profile: Profile, q: Array, solids: Solids, met: tuple[int, int]
) -> tuple[str, Solids, Array]:
    """Return climbing axle, solids and configuration behind a kink; several wheels may meet."""
    for _ in range(len(AXLES) * len(profile.solids)):
        axle, solid = met
        solids = tuple(solid if i == axle else below for i, below in enumerate(solids))
        q = _closest_configurations(climber, profile, q[None], solids)[0]
        gaps, closing = _other_gaps(climber, profile, q, solids)
        meeting = (gaps < MAX_CONTACT_GAP) & (closing < -NORMAL_TOLERANCE)
        if not meeting.any():
            return AXLES[axle], solids, q
        i, k = np.argwhere(meeting)[0]
        met = int(i), int(k)
    raise ModelError(_stuck_words(AXLES[met[0]], q, "a wheel is caught between two solids"))


def _march(
    climber: Climber, profile: Profile, q: Array, solids: Solids, axle: str, end: float
) -> tuple[Callable[[Array], Array], float, float, tuple[int, int] | None]:
    """Return curve, length and top of a leg, and the axle and solid that meet at its end."""
    from scipy.integrate import solve_ivp  # imported here: the import takes 0.2 s

    climbing = AXLES.index(axle) if axle else None

    def direction(_s: float, q: Array) -> Array:
        normals = _contacts(climber, profile, q[None], solids)[1]
        return np.asarray(_direction(normals, axle_arms(climber, q[None]))[0])

    # met at a gap of minus the tolerance: after a kink, wheels that just part have a gap of zero
    def meets(_s: float, q: Array) -> float:
        return float(_gaps_and_normals(climber, profile, q, solids)[0].min() + MAX_CONTACT_GAP)

    def arrives(_s: float, q: Array) -> float:
        return float(end - q[0] - axle_arms(climber, q[None])[0, 0, 0])

    def tips(_s: float, q: Array) -> float:
        return float(np.cos(q[2:]).min() - MIN_TILT_COSINE)

    def levels(_s: float, q: Array) -> float:
        normals = _contacts(climber, profile, q[None], solids)[1]
        return float(-normals[0, climbing, 0] - LEVEL_SLOPE) if climbing is not None else -1.0

    stops: list[Any] = [meets, arrives, tips, levels]
    for stop in stops:
        stop.direction, stop.terminal = -1, stop is not levels
    run = solve_ivp(
        direction,
        (0.0, MAX_LEG_LENGTH),
        q,
        rtol=TOLERANCE,
        atol=TOLERANCE,
        max_step=climber.radius / MIN_STEPS_PER_RADIUS,
        events=stops,
        dense_output=True,
    )
    met, arrived, tipped, level = run.t_events
    length = float(run.t[-1])
    if not (met.size or arrived.size):
        too_long = f"a leg of the path is longer than {MAX_LEG_LENGTH:g} m"
        why = "a body would stand upright" if tipped.size else too_long
        raise ModelError(_stuck_words(axle, run.y[:, -1], why))
    top = float(level[0]) if level.size else length
    if arrived.size:
        return run.sol, length, top, None
    gaps, _ = _gaps_and_normals(climber, profile, run.y[:, -1], solids)
    i, k = np.unravel_index(gaps.argmin(), gaps.shape)
    return run.sol, length, top, (int(i), int(k))


def _gaps_and_normals(
    climber: Climber, profile: Profile, q: Array, solids: Solids
) -> tuple[Array, Array]:
    """Return gaps (3, n_solids) [m], infinite to the solid below, and normals (3, n_solids, 2)."""
    x, z = (q[:2] + axle_arms(climber, q[None])[0]).T
    distances = [solid.distance(x, z) for solid in profile.solids]
    gaps, normals = (np.stack(values, axis=1) for values in zip(*distances, strict=True))
    gaps -= climber.radius
    gaps[np.arange(3), solids] = np.inf
    return gaps, normals


def _other_gaps(
    climber: Climber, profile: Profile, q: Array, solids: Solids
) -> tuple[Array, Array]:
    gaps, normals = _gaps_and_normals(climber, profile, q, solids)
    arms = axle_arms(climber, q[None])
    first = _direction(normals[np.arange(3), solids][None], arms)[0]
    slopes = [_speed_jacobian(axes[None], arms)[0] @ first for axes in normals.swapaxes(0, 1)]
    return gaps, np.stack(slopes, axis=1)


def _stuck_words(axle: str, q: Array, why: str) -> str:
    where = f"with the {axle or 'front'} wheels climbing, the joint at x = {q[0]:.3g} m"
    tilts = f"rear body {np.degrees(q[2]):.0f}, front body {np.degrees(q[3]):.0f} degrees nose-up"
    return f"climb: the vehicle gets stuck {where}: {why} ({tilts}); use a lower obstacle"


class HoldingForces(NamedTuple):
    """Contact forces that need the least friction, for n configurations.

    ``mu`` (n,) is the least coefficient of friction, ``inf`` where no forces hold the vehicle [1];
    there the normal and tangential (positive forward) forces on the axles (n, 3) are NaN [N].
    """

    mu: Array
    normal: Array
    tangential: Array


class Demand(NamedTuple):
    """Friction demand at path parameters (n,) [m] on a leg."""

    leg: Leg
    s: Array
    hold: HoldingForces

    @property
    def mu(self) -> float:
        """Largest coefficient needed on the leg [1]."""
        return float(self.hold.mu.max())


class Friction(NamedTuple):
    """Friction demand of a slow climb.

    ``mu`` is the least coefficient of friction of the whole climb, ``inf`` if none suffices [1];
    ``axle``, ``s`` and ``q`` are the climbing axle, the path parameter [m] and the configuration
    (4,) [m, rad] of the largest demand; ``demands`` those of all legs.
    """

    mu: float
    axle: str
    s: float
    q: Array
    demands: tuple[Demand, ...]


def equilibrium(climber: Climber, path: PathSamples) -> tuple[Array, Array]:
    """Return the equilibrium equations ``A f = b`` of the contact forces ``f``.

    Rows of ``A`` (n, 4, 6) [1, m] are forward force, upward force, and the nose-up moments of the
    rear and the front body with their wheels about the joint. Columns are the normal forces on the
    rear, middle and front axle, and the tangential forces on them. ``b`` (n, 4) is the negative
    load of gravity [N, N m].
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
    return matrix, climber.gravity * np.stack([0 * weight, weight, *levers], axis=1)


def center(body: ClimberLink, tilt: Array) -> Array:
    """Return the centre of mass of a body relative to the joint, shape (n, 2) [m]."""
    forward, up = np.cos(tilt), np.sin(tilt)
    return np.stack(
        [body.ahead * forward - body.above * up, body.ahead * up + body.above * forward], axis=1
    )


def cross(a: Array, b: Array) -> Array:
    """Return the nose-up moments of forces b (..., 2) at positions a (..., 2), shape (...)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def least_friction_forces(matrix: Array, load: Array) -> HoldingForces:
    """Return the forces that need the least friction, for equations as those of `equilibrium`."""
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
    """Return the forces (n, 6) [N] that maximise the smallest reserve, and this reserve (n,).

    The forces satisfy ``matrix @ f = load``; the reserve of an axle is ``(mu N - |T|) / relative``.
    """
    from scipy.optimize import linprog  # imported here: the import takes 0.2 s

    count, size = len(load), load[:, 1].mean()
    rows, axles = np.zeros((count, 2, 3, 7)), np.arange(3)  # of T and of -T, for each axle
    rows[:, :, axles, axles] = -mu[:, None, None]
    rows[:, :, axles, 3 + axles] = [[1.0], [-1.0]]
    rows[..., 6] = (relative / size)[:, None]
    equations = np.concatenate([matrix, np.zeros((count, 4, 1))], axis=2)
    bounds = [*[(None, MAX_NORMAL_FORCE)] * 3, *[(None, None)] * 4]
    answer = linprog(
        np.tile([0.0] * 6 + [-1.0], count),
        scipy.sparse.block_diag(rows.reshape(count, 6, 7), format="csc"),
        np.zeros(6 * count),
        scipy.sparse.block_diag(equations, format="csc"),
        (load / size).ravel(),
        bounds=bounds * count,
        method="highs",
    )
    if answer.status != 0:
        raise SolverError(
            "climb: expected forces in equilibrium with the least friction, found none: "
            f"{answer.message} (linear program); check masses and dimensions of the vehicle"
        )
    values = answer.x.reshape(count, 7)
    return values[:, :6] * size, values[:, 6]


def least_friction(climber: Climber, profile: Profile, samples: int = 41) -> Friction:
    """Return the friction demand of a slow climb of a profile.

    ``samples`` is the number of configurations on every leg; more are added around the one with the
    largest demand. If there is no contact path over the profile, ModelError is raised as by `legs`.
    """
    demands = _demands(climber, profile, samples)
    worst = max(demands, key=lambda demand: demand.mu)
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
    path = legs(climber, profile)
    places = [np.linspace(0, leg.length, samples) for leg in path]
    holds = _holds(climber, profile, path, places)
    for _ in range(REFINEMENTS):
        worst = [int(hold.mu.argmax()) for hold in holds]
        near = [  # between the sample with the largest demand and its neighbours
            np.concatenate(
                [
                    np.linspace(a, b, REFINED_POINTS + 2)[1:-1]
                    for a, b in pairwise(s[max(k - 1, 0) : k + 2])
                ]
            )
            for s, k in zip(places, worst, strict=True)
        ]
        more = _holds(climber, profile, path, near)
        orders = [np.argsort(np.append(*pair)) for pair in zip(places, near, strict=True)]
        places = [
            np.append(s, new)[order] for s, new, order in zip(places, near, orders, strict=True)
        ]
        holds = [
            HoldingForces(*(np.concatenate(pair)[order] for pair in zip(old, new, strict=True)))
            for old, new, order in zip(holds, more, orders, strict=True)
        ]
    return tuple(Demand(*of_leg) for of_leg in zip(path, places, holds, strict=True))


def _holds(
    climber: Climber, profile: Profile, path: Sequence[Leg], places: Sequence[Array]
) -> list[HoldingForces]:
    """Return the forces at path parameters of several legs [m], from one linear program."""
    equations = [
        equilibrium(climber, sample(climber, profile, leg, s))
        for leg, s in zip(path, places, strict=True)
    ]
    hold = least_friction_forces(*(np.concatenate(part) for part in zip(*equations, strict=True)))
    ends = np.cumsum([0, *(s.size for s in places)]).tolist()
    return [HoldingForces(*(part[a:b] for part in hold)) for a, b in pairwise(ends)]
