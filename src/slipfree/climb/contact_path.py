"""Climbs of an articulated vehicle over a profile: contact path, friction demand, planned climbs.

All three axles stay on the ground, so that one degree of freedom remains: the path parameter s,
whose increment is the root mean square of the path increments of the three axles. Configurations
are ``(x, z, rear tilt, front tilt)`` of the joint and the bodies. A leg begins where a wheel meets
another solid: there the path has a kink, which a vehicle in motion passes only with an impact.

The ground acts on an axle with the normal force N and the tangential force T, positive forward.
Equilibrium has four equations: both components of force, and for each body with its wheels the
moment about the joint, in which motor torques are internal. With six contact forces, two degrees of
freedom remain. The least coefficient of friction is the minimum of the largest ``|T| / N``.

Planned climbs are a time scaling along the contact path without slip, and are tracked. With s' the
speed along a leg of the path, ``a = s''`` and ``b = s'^2``, accelerations are ``q' a + q'' b``, and
the equations of motion are linear in a, b and the contact forces:

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

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import inf
from typing import Annotated, Any, NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt
from annotated_types import Gt

from slipfree.catalog import AXLES
from slipfree.control.step_climbing import Commands, ControlState, Motors, PerAxle, Sensed, limited
from slipfree.core.arguments import checked
from slipfree.core.dae import Nlp
from slipfree.core.errors import ModelError
from slipfree.core.lookups import evaluate
from slipfree.core.records import Array
from slipfree.models.force_distribution import least_utilisation
from slipfree.terrain.solids import Profile
from slipfree.vehicle.tree import Vehicle

Solids = tuple[int, ...]  # index of the solid below each axle
FLOOR: Solids = (0, 0, 0)
TILT_INDICES = (2, 2, 3)  # index of the tilt of the body that carries each axle
MIN_CLOSING_SPEED = 1e-12  # a wheel that approaches a solid more slowly does not meet it
LEVEL_SLOPE = 1e-3  # a wheel with a smaller slope of its path has reached the top [rad]
MIN_TILT_COSINE = 0.05  # cosine of the largest tilt of a body
MAX_CONTACT_GAP = 1e-6  # a wheel with a smaller gap touches [m]
END_MARGIN = 1e-3  # a climb ends a radius and this distance behind the last corner [m]
MAX_LEG_LENGTH = 50.0  # largest length of a leg [m]
TOLERANCE = 1e-8  # tolerance of the configurations along the path [m, rad]
MIN_STEPS_PER_RADIUS = 4  # smallest number of steps per wheel radius, so that no solid is missed
CONTACT_STEPS = 3  # Newton steps to the ground, from gaps of at most MAX_CONTACT_GAP
MAX_FRICTION = 10.0  # climbs that need a larger coefficient count as impossible
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
    """Configurations on a leg at n path parameters ``s`` [m], and the mechanics there.

    ``q``, ``first`` and ``second`` (n, 4) are configurations [m, rad] and their derivatives with
    respect to s; ``axles`` and ``normals`` (n, 3, 2) the positions of the axles [m] and the unit
    normals of the ground at their contacts, ``speeds`` (n, 3) the speeds of the axles along the
    ground divided by the rate of s [1], and ``slopes`` their derivatives with respect to s [1/m].

    The equations of motion are ``A f = load + linear s'' + square s'^2``. Their rows are forward
    force, upward force, and the nose-up moments of the rear and the front body with their wheels
    about the joint. The columns of ``matrix``, A (n, 4, 6) [1, m], are the normal forces on the
    rear, middle and front axle, and the tangential forces on them. ``load`` (n, 4) is the negative
    load of gravity [N, N m]; ``linear`` and ``square`` (n, 4) are the inertia of bodies and wheels
    [N s2/m, N s2].
    """

    s: Array
    q: Array
    first: Array
    second: Array
    axles: Array
    normals: Array
    speeds: Array
    slopes: Array
    matrix: Array
    load: Array
    linear: Array
    square: Array


class _Path(NamedTuple):
    """Functions of a configuration (4,) in which the axles touch given solids.

    ``closest`` is a Newton step to the ground. ``march`` returns the derivative of the
    configuration with respect to s, the gaps of all axles to all solids [m], infinite to those
    below them, the rates of these gaps [1], and the normals (2, 3). ``sample`` returns the fields
    of `PathSamples` from ``first`` on, as columns.
    """

    closest: ca.Function
    march: ca.Function
    sample: ca.Function

    def touching(self, q: Array) -> Array:
        """Return configurations (4, n) near q in which all axles touch their solids."""
        for _ in range(CONTACT_STEPS):
            (q,) = evaluate(self.closest, q)
        return q

    def at(self, q: Array) -> tuple[Array, ...]:
        """Return the results of ``march`` at a configuration (4,)."""
        return tuple(np.array(each) for each in self.march(q))


@lru_cache(maxsize=64)
def _path(climber: Vehicle, profile: Profile, solids: Solids) -> _Path:
    """Return the functions of a path on which the axles touch solids with given indices."""
    q, radius = ca.SX.sym("q", 4), climber.wheels[0].radius
    tilts = [q[k] for k in TILT_INDICES]

    def place(at: tuple[float, ...], tilt: ca.SX) -> ca.SX:
        turning = ca.vertcat(ca.cos(tilt), ca.sin(tilt))
        return q[:2] + at[1] * turning + at[2] * ca.vertcat(-turning[1], turning[0])

    axles = [place(wheel.at, tilt) for wheel, tilt in zip(climber.wheels, tilts, strict=True)]
    near = [[solid.gap(*ca.vertsplit(axle)) for solid in profile.solids] for axle in axles]
    normals = [of_axle[k][1] for of_axle, k in zip(near, solids, strict=True)]
    pairs = [*zip(normals, axles, strict=True)]
    across = ca.vertcat(*(normal.T @ ca.jacobian(axle, q) for normal, axle in pairs))
    contact = ca.vertcat(*(of_axle[k][0] for of_axle, k in zip(near, solids, strict=True))) - radius
    # the Newton step of least change to the three contact conditions
    closest = q - across.T @ ca.solve(across @ across.T, contact)
    # null vector of the three contact conditions; its sign is that of forward motion
    columns = [[k for k in range(4) if k != left] for left in range(4)]
    null = ca.vertcat(*((-1) ** k * ca.det(across[:, kept]) for k, kept in enumerate(columns)))
    tangents = [ca.vertcat(n[1], -n[0]) for n in normals]
    speeds = ca.vertcat(
        *(ca.dot(t, ca.jtimes(axle, q, null)) for t, axle in zip(tangents, axles, strict=True))
    )
    # per metre of the root mean square of the axles: no axle may stand still on the path
    size = ca.sqrt(ca.sumsqr(speeds) / 3) * ca.sign(ca.sum1(speeds))
    first, speeds = null / size, speeds / size

    def along(expression: ca.SX) -> ca.SX:
        return ca.jtimes(expression, q, first)

    slopes, ahead = along(speeds), [along(axle) for axle in axles]
    bodies = [climber.body, climber.joints[0].body]
    masses = [(each, place(each.at, q[2 + k]), q[2 + k]) for k, each in enumerate(bodies)]
    load, linear, square = (ca.SX.zeros(4) for _ in range(3))
    for body, center, tilt in masses:
        forces, moments = body.mass * ca.jacobian(center, q).T, ca.jacobian(tilt, q).T
        turning = (body.inertia or (0.0,))[0] * moments
        load += climber.gravity * forces[:, 1]
        linear += forces @ along(center) + turning * along(tilt)
        square += forces @ along(along(center)) + turning * along(along(tilt))
    spins = spin_inertia(climber)
    for k, tilt in enumerate(tilts):  # wheels that roll forward rotate nose-down
        moment = spins[k] * ca.jacobian(tilt, q).T
        linear, square = linear - moment * speeds[k], square - moment * slopes[k]
    upward = [ca.jacobian(axle, q).T @ n for axle, n in zip(axles, normals, strict=True)]
    forward = [
        ca.jacobian(axle, q).T @ tangent + radius * ca.jacobian(tilt, q).T
        for axle, tangent, tilt in zip(axles, tangents, tilts, strict=True)
    ]
    matrix = ca.horzcat(*upward, *forward)
    values = first, along(first), ca.horzcat(*axles), ca.horzcat(*normals), speeds, slopes
    rows = [ca.densify(ca.vec(each)) for each in (*values, matrix.T, load, linear, square)]
    gaps, rates = ca.SX(3, len(profile.solids)), ca.SX(3, len(profile.solids))
    for i, of_axle in enumerate(near):
        for k, (distance, normal) in enumerate(of_axle):
            gaps[i, k] = np.inf if k == solids[i] else distance - radius
            rates[i, k] = ca.dot(normal, ahead[i])
    march = [first, gaps, rates, ca.horzcat(*normals)]
    return _Path(
        ca.Function("closest", [q], [ca.densify(closest)]),
        ca.Function("march", [q], [ca.densify(each) for each in march], {"cse": True}),
        ca.Function("sample", [q], rows, {"cse": True}),
    )


def spin_inertia(climber: Vehicle) -> Array:
    """Return the torque on an axle's wheels per acceleration of the axle, shape (3,) [N m s2/m]."""
    return np.array([(each.inertia or (0.0,))[0] / each.radius for each in climber.wheels])


def sample(climber: Vehicle, profile: Profile, leg: Leg, s: Array) -> PathSamples:
    """Return the configurations of a leg at path parameters ``s``, (n,), and the mechanics."""
    path = _path(climber, profile, leg.solids)
    q = path.touching(leg.curve(s))
    shapes = (4,), (4,), (3, 2), (3, 2), (3,), (3,), (4, 6), (4,), (4,), (4,)
    values = zip(evaluate(path.sample, q), shapes, strict=True)
    return PathSamples(s, q.T, *(rows.T.reshape(-1, *shape) for rows, shape in values))


def legs(climber: Vehicle, profile: Profile) -> tuple[Leg, ...]:
    """Return the legs of the path, from the first contact of the front wheels to the end.

    ``climber`` is a vehicle like `slipfree.catalog`. ModelError is raised if the floor
    is not level, if there is no obstacle, or if the vehicle gets stuck: a body would have to stand
    upright, a wheel is caught between two solids, or a leg is longer than 50 m.
    """
    corners = [x for solid in profile.solids[1:] for x, _ in solid.points]
    ends = [x for x in corners if x < max(x for x, _ in profile.solids[0].points)]
    if not ends:
        raise ModelError(
            "climb: expected an obstacle that begins before the end of the floor, the first solid, "
            "found none; add an obstacle, such as a step"
        )
    radius, ahead = climber.wheels[0].radius, climber.wheels[2].at[1]
    level = max(z for _, z in profile.solids[0].points) + radius
    q, solids, axle = np.array([min(ends) - 2 * radius - ahead, level, 0.0, 0.0]), FLOOR, ""
    places = q[:2] + [(wheel.at[1], 0.0) for wheel in climber.wheels]
    gap = np.abs(profile.solids[0].distance(*places.T)[0] - radius).max()
    if gap > MAX_CONTACT_GAP:
        raise ModelError(
            f"climb: expected a level floor for the vehicle around x = {q[0]:.3g} m, found a gap "
            f"of {gap:.3g} m between wheels and floor; extend or level the first solid"
        )
    found: list[Leg] = []
    while True:
        leg, met = _march(climber, profile, q, solids, axle, max(ends) + radius + END_MARGIN)
        found += [leg] if axle else []
        if met is None:
            return tuple(found)
        q = leg.curve(np.array([leg.length]))[:, 0]
        for _ in range(len(AXLES) * len(profile.solids)):  # several wheels may meet at a kink
            axle, solid = AXLES[met[0]], met[1]
            solids = tuple(solid if i == met[0] else below for i, below in enumerate(solids))
            path = _path(climber, profile, solids)
            q = path.touching(q[:, None])[:, 0]
            _, gaps, rates, _ = path.at(q)
            meeting = (gaps < MAX_CONTACT_GAP) & (rates < -MIN_CLOSING_SPEED)
            if not meeting.any():
                break
            i, k = np.argwhere(meeting)[0]
            met = int(i), int(k)
        else:
            caught = "a wheel is caught between two solids"
            raise ModelError(_stuck_words(AXLES[met[0]], q, caught))


def _march(
    climber: Vehicle, profile: Profile, q: Array, solids: Solids, axle: str, end: float
) -> tuple[Leg, tuple[int, int] | None]:
    """Return a leg, and the axle and solid that meet at its end."""
    from scipy.integrate import solve_ivp  # imported here: the import takes 0.2 s

    path = _path(climber, profile, solids)
    rear, climbing = climber.wheels[0].at[1], AXLES.index(axle) if axle else None
    # met at a gap of minus the tolerance: after a kink, wheels that just part have a gap of zero
    stops: list[Any] = [
        lambda _s, q: float(path.at(q)[1].min() + MAX_CONTACT_GAP),
        lambda _s, q: float(end - q[0] - rear * np.cos(q[2])),
        lambda _s, q: float(np.cos(q[2:]).min() - MIN_TILT_COSINE),
        lambda _s, q: -1.0 if climbing is None else -path.at(q)[3][0, climbing] - LEVEL_SLOPE,
    ]
    for k, stop in enumerate(stops):
        stop.direction, stop.terminal = -1, k < 3
    run = solve_ivp(
        lambda _s, q: path.at(q)[0].ravel(),
        (0.0, MAX_LEG_LENGTH),
        q,
        rtol=TOLERANCE,
        atol=TOLERANCE,
        max_step=climber.wheels[0].radius / MIN_STEPS_PER_RADIUS,
        events=stops,
        dense_output=True,
    )
    met, arrived, tipped, level = run.t_events
    length = float(run.t[-1])
    if not (met.size or arrived.size):
        too_long = f"a leg of the path is longer than {MAX_LEG_LENGTH:g} m"
        why = "a body would stand upright" if tipped.size else too_long
        raise ModelError(_stuck_words(axle, run.y[:, -1], why))
    leg = Leg(axle, solids, length, float(level[0]) if level.size else length, run.sol)
    gaps = path.at(run.y[:, -1])[1]
    nearest = np.unravel_index(gaps.argmin(), gaps.shape)
    return leg, None if arrived.size else (int(nearest[0]), int(nearest[1]))


def _stuck_words(axle: str, q: Array, why: str) -> str:
    where = f"with the {axle or 'front'} wheels climbing, the joint at x = {q[0]:.3g} m"
    tilts = f"rear body {np.degrees(q[2]):.0f}, front body {np.degrees(q[3]):.0f} degrees nose-up"
    return f"climb: the vehicle gets stuck {where}: {why} ({tilts}); use a lower obstacle"


class Demand(NamedTuple):
    """Friction demand at path parameters ``s`` (n,) [m] on a leg.

    ``mu`` (n,) is the least coefficient of friction, ``inf`` where no forces hold the vehicle [1];
    there the normal and tangential (positive forward) forces on the axles (n, 3) are NaN [N].
    """

    leg: Leg
    s: Array
    mu: Array
    normal: Array
    tangential: Array


class Friction(NamedTuple):
    """Friction demands of a slow climb, leg by leg."""

    demands: tuple[Demand, ...]

    @property
    def mu(self) -> float:
        """Least coefficient of friction of the whole climb, infinite if none suffices [1]."""
        return float(max(each.mu.max() for each in self.demands))


def demand(climber: Vehicle, leg: Leg, path: PathSamples) -> Demand:
    """Return the friction demand of a slow climb at samples of a leg."""
    count, load = len(path.s), -path.load / climber.weight
    # across, the third direction of a contact, has no part in the plane's equilibrium
    matrix = np.zeros((count, 4, 3, 3))
    matrix[..., 2], matrix[..., 0] = path.matrix[..., :3], path.matrix[..., 3:]
    best = least_utilisation(matrix.reshape(count, 4, 9), load, np.ones((count, 3)))
    none = ~(best.utilisation < MAX_FRICTION)
    forces = np.where(none[:, None, None], np.nan, best.force.reshape(count, 3, 3))
    mu = np.where(none, np.inf, best.utilisation)
    return Demand(leg, path.s, mu, *(climber.weight * forces[..., k] for k in (2, 0)))


def least_friction(climber: Vehicle, profile: Profile, samples: int = 41) -> Friction:
    """Return the friction demand of a slow climb of a profile.

    ``samples`` is the number of configurations on every leg; more are added around the one with the
    largest demand. If there is no contact path over the profile, ModelError is raised as by `legs`.
    """
    demands = list[Demand]()
    for leg in legs(climber, profile):
        whole = sample(climber, profile, leg, np.linspace(0, leg.length, samples))
        here = demand(climber, leg, whole)
        for _ in range(REFINEMENTS):
            k = int(here.mu.argmax())  # new samples between the worst one and its neighbours
            sides = pairwise(here.s[max(k - 1, 0) : k + 2])
            near = [np.linspace(*side, REFINED_POINTS + 2)[1:-1] for side in sides]
            more = demand(climber, leg, sample(climber, profile, leg, np.concatenate(near)))
            order = np.argsort(np.append(here.s, more.s))
            pairs = zip(here[1:], more[1:], strict=True)
            here = Demand(leg, *(np.concatenate(pair)[order] for pair in pairs))
        demands.append(here)
    return Friction(tuple(demands))


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
    rows = list[tuple[Array, ...]]()  # the fields of each leg, at its nodes and midpoints
    for plan, unknowns in plans:
        nodes, middles, torque = plan.nodes, plan.middles, history(plan, unknowns).torque
        square = np.maximum(unknowns[plan.nlp.where["b"]], 0)
        at_nodes = np.column_stack([np.interp(nodes.s, middles.s, each) for each in torque.T])
        parts, between = [], (square[1:] + square[:-1]) / 2
        for path, squares, torques in (nodes, square, at_nodes), (middles, between, torque):
            directions = np.arctan2(-path.normals[..., 0], path.normals[..., 1])
            parts.append((progress(path), squares, path.speeds, directions, torques))
        order = np.argsort(np.concatenate([nodes.s, middles.s]))
        rows.append(tuple(np.concatenate(pair)[order] for pair in zip(*parts, strict=True)))
    p, *rest = (np.concatenate(each) for each in zip(*rows, strict=True))
    joints = np.cumsum([2 * plan.nodes.s.size - 1 for plan, _ in plans])[:-1]
    p[joints] = np.maximum(p[joints], p[joints - 1] + LEG_DISTANCE)
    if not (np.diff(p) > 0).all():
        k = int(np.argmin(np.diff(p)))
        raise ModelError(
            "plan: expected a path on which the mean of x + z over the axles increases, found a "
            f"decrease at {p[k]:.3g} m; use a plan that does not lead steeply down"
        )
    return TrackedPlan(p, *rest)


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
