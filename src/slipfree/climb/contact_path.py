"""Contact path: the sequence of configurations of an articulated vehicle over a profile.

All three axles stay on the ground, so that one degree of freedom remains: the path parameter s,
whose increment is the root mean square of the path increments of the three axles. Configurations
are ``(x, z, rear tilt, front tilt)`` of the joint and the bodies. A leg begins where a wheel meets
another solid: there the path has a kink, which a vehicle in motion passes only with an impact.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.terrain.solids import Profile
from slipfree.vehicle.climber import AXLES, Climber

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


class Leg(NamedTuple):
    """Smooth section of the path, from where a wheel meets a solid to the next one, or to the end.

    Attributes
    ----------
    axle : {"rear", "middle", "front"}
        Axle whose wheels meet a solid at the start of the leg, and then climb it.
    solids : tuple of 3 int
        Index in ``Profile.solids`` of the solid on which the rear, the middle and the front axle
        stand.
    length : float
        Path parameter s at the end of the leg; s is zero at its start. [m]
    top : float
        Path parameter at which the climbing wheels move horizontally again; equal to ``length`` if
        they do not. [m]
    curve : callable
        Function from path parameters, shape (n,) [m], to configurations (x, z, rear tilt, front
        tilt), shape (4, n) [m, rad].
    """

    axle: str
    solids: Solids
    length: float
    top: float
    curve: Callable[[Array], Array]


class PathSamples(NamedTuple):
    """Configurations on a leg at n path parameters.

    Attributes
    ----------
    s : ndarray, shape (n,)
        Path parameter. [m]
    q, first, second : ndarray, shape (n, 4)
        Configurations (x, z, rear tilt, front tilt) [m, rad], and their first and second
        derivatives with respect to s.
    normals : ndarray, shape (n, 3, 2)
        Unit normals of the ground at the contacts of the rear, middle and front axle.
    speeds, slopes : ndarray, shape (n, 3)
        Speeds of the axles along the ground divided by the rate of s [1], and their derivatives
        with respect to s [1/m].
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

    Raises
    ------
    ModelError
        If the floor is not level, if there is no obstacle, or if the vehicle gets stuck: a body
        would have to stand upright, a wheel is caught between two solids, or a leg is longer than
        50 m.
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
    found: list[Leg] = []
    axle = ""
    while True:
        curve, length, top, met = _march(climber, profile, q, solids, axle, end)
        if axle:
            found.append(Leg(axle, solids, length, top, curve))
        if met is None:
            return tuple(found)
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
    found = np.linalg.svd(_speed_jacobian(normals, arms))[2][:, -1]
    speeds = (_speed_jacobian(tangents(normals), arms) @ found[:, :, None])[..., 0]
    size = np.copysign(np.sqrt((speeds**2).mean(axis=1)), speeds.sum(axis=1))
    return np.asarray(found / size[:, None])


def _contacts(
    climber: Climber, profile: Profile, q: Array, solids: Solids
) -> tuple[Array, Array, Array]:
    """Return gaps (n, 3) [m], normals (n, 3, 2) and path curvatures (n, 3) [1/m] of the axles."""
    places = q[:, None, :2] + axle_arms(climber, q)
    gaps, curvature = np.empty(places.shape[:2]), np.empty(places.shape[:2])
    normals = np.empty(places.shape)
    for index in set(solids):
        solid = profile.solids[index]
        on_it = [i for i, each in enumerate(solids) if each == index]
        distance, normal = solid.distance(places[:, on_it, 0], places[:, on_it, 1])
        gaps[:, on_it], normals[:, on_it] = distance - climber.radius, normal
        on_face = (normal @ solid.normals.T).max(axis=-1) > 1 - NORMAL_TOLERANCE
        curvature[:, on_it] = np.where(on_face, 0.0, 1 / climber.radius)
    return gaps, normals, curvature


def _closest_configurations(climber: Climber, profile: Profile, q: Array, solids: Solids) -> Array:
    """Return configurations near q, shape (n, 4), in which all axles touch their solids."""
    for _ in range(3):
        gaps, normals, _ = _contacts(climber, profile, q, solids)
        rows = _speed_jacobian(normals, axle_arms(climber, q))
        q = q - (np.linalg.pinv(rows) @ gaps[..., None])[..., 0]
    return q


def _start(climber: Climber, profile: Profile, first: float) -> Array:
    """Return a configuration on the floor, shape (4,), with all wheels before x = ``first``."""
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
        solids = tuple(solid if i == axle else each for i, each in enumerate(solids))
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
    found = [solid.distance(x, z) for solid in profile.solids]
    gaps, normals = (np.stack(each, axis=1) for each in zip(*found, strict=True))
    gaps -= climber.radius
    gaps[np.arange(3), solids] = np.inf
    return gaps, normals


def _other_gaps(
    climber: Climber, profile: Profile, q: Array, solids: Solids
) -> tuple[Array, Array]:
    """Return the gaps of `_gaps_and_normals`, and their derivatives with respect to s [1]."""
    gaps, normals = _gaps_and_normals(climber, profile, q, solids)
    arms = axle_arms(climber, q[None])
    first = _direction(normals[np.arange(3), solids][None], arms)[0]
    slopes = [_speed_jacobian(each[None], arms)[0] @ first for each in normals.swapaxes(0, 1)]
    return gaps, np.stack(slopes, axis=1)


def _stuck_words(axle: str, q: Array, why: str) -> str:
    where = f"with the {axle or 'front'} wheels climbing, the joint at x = {q[0]:.3g} m"
    tilts = f"rear body {np.degrees(q[2]):.0f}, front body {np.degrees(q[3]):.0f} degrees nose-up"
    return f"climb: the vehicle gets stuck {where}: {why} ({tilts}); use a lower obstacle"
