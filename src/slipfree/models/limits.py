"""Limits of a vehicle's motion, their registry, and the tip-over margin.

A limit function takes the quantities of a model and yields its limits. It yields none if it does
not apply to the vehicle or the ground.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache

import casadi as ca
import numpy as np

from slipfree.contact.closure import ContactFrame, has_exact_closure
from slipfree.contact.closure import relative_curvature as curvature_of
from slipfree.core.dae import Limit
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Label
from slipfree.laws.protocols import wheel_limits
from slipfree.models.base import Quantities, State, masses_of, values_of

DISTANCE_ROUNDING = 1e-9  # smaller distances count as zero [distance of two wheels]
Domain = tuple[float, float, float, float]
MIN_AXLE_SINE = 0.1  # a wheel whose axle is within asin(0.1) = 6 degrees of the normal lies flat
MIN_INCLINATION_COSINE = 0.1  # a platform with its up axis 6 degrees from horizontal has overturned
UPRIGHT = "upright"  # name of the limit of the platform's inclination
MIN_FRICTION = 1e-6  # smaller values of a friction formula count as zero


def tip_over_margin(state: State, contacts: Sequence[ContactFrame]) -> ca.SX:
    """Return the least angle by which gravity may turn before the vehicle tips over [rad].

    The vehicle tips over an edge, the line through two neighbouring contact points of the support
    polygon, when the line of gravity through its centre of mass meets the edge. The angle is that
    between gravity and the half-plane from the centre of mass through the edge. It is negative if
    the line of gravity passes outside the polygon, -pi if all contacts lie on a line in plan view,
    and infinite for a vehicle without mass. For a planar vehicle, the edges are the contacts of the
    first and the last wheel. Joints are considered locked.
    """
    vehicle = state.vehicle
    if not vehicle.mass:
        return ca.SX.inf()
    center = sum(mass * at for _, mass, at in masses_of(state)) / vehicle.mass
    if vehicle.planar:
        arms = [contact.point - center for contact in contacts]
        ends = ([sign * ca.atan2(arm[1], -arm[2]) for arm in arms] for sign in (1, -1))
        return ca.mmin(ca.vertcat(*(ca.mmax(ca.vertcat(*each)) for each in ends)))
    points = [contact.point for contact in contacts]
    down, least = ca.SX([0, 0, -1]), ca.SX.inf()
    here, farthest = points[0], ca.SX(0)
    for point in points[1:]:  # the first corner is the point farthest from the first one
        away = ca.sumsqr((point - points[0])[:2])
        here, farthest = ca.if_else(away > farthest, point, here), ca.fmax(away, farthest)
    is_polygon, next_corner = ca.SX(0), _next_corner(len(points))
    for _ in points:
        there, turns = next_corner(here, ca.horzcat(*points))
        is_polygon = ca.logic_or(is_polygon, turns)
        edge = there - here
        edge /= ca.norm_2(edge)
        arm = here - center
        arm -= ca.dot(arm, edge) * edge
        arm /= ca.norm_2(arm)
        # the corners run counter-clockwise: the normal component is positive inside the polygon
        along, toward, inside = (ca.dot(each, down) for each in (edge, arm, ca.cross(edge, arm)))
        angle = ca.atan2(inside, ca.hypot(along, toward))
        # gravity away from the edge, of a low centre of mass, first reaches the edge's direction
        away = ca.atan2(ca.sign(inside) * ca.hypot(inside, toward), ca.fabs(along))
        least, here = ca.fmin(least, ca.if_else(toward < 0, away, angle)), there
    return ca.if_else(is_polygon, least, -ca.pi)


@cache
def _next_corner(count: int) -> ca.Function:
    """Return the function of the next corner of the support polygon.

    Its arguments are a corner ``here`` and a number of points in its columns. Results are the
    rightmost point as seen from this corner in plan view, the last one if several lie on a line,
    and whether not all points are on one line. A test of every pair of points against all others
    would need a number of operations that grows with the cube of the number of wheels.
    """
    here, points = ca.SX.sym("here", 3), ca.SX.sym("points", 3, count)
    there, edge, length, turns = here, ca.SX(2, 1), ca.SX(0), ca.SX(0)
    for point in ca.horzsplit(points):
        arrow = (point - here)[:2]
        reach = ca.sumsqr(arrow)
        aside = edge[0] * arrow[1] - edge[1] * arrow[0]
        zero = DISTANCE_ROUNDING * ca.fmax(length, reach)
        is_last = ca.logic_and(aside <= zero, reach > length)
        # a point to the right of the edge so far, or the last one on it
        is_chosen = ca.logic_or(aside < -zero, is_last)
        turns = ca.logic_or(turns, ca.fabs(aside) > zero)
        chosen = (point, there), (arrow, edge), (reach, length)
        there, edge, length = (ca.if_else(is_chosen, new, old) for new, old in chosen)
    return ca.Function("next_corner", [here, points], [there, turns])


def joint_stops(q: Quantities) -> Iterator[Limit]:
    """Yield the limits of all joints with rigid stops."""
    values = values_of(q)
    for c in q.vehicle.coordinates:
        if not c.bump and (np.isfinite(c.lower) or np.isfinite(c.upper)):
            words = f"joint {c.name} ({c.words}) reaches its stop"
            label = Label(f"{c.name}_stop", q.vehicle.unit(c.name), words)
            yield Limit(label, values[c.name], c.lower, c.upper)


def upright(q: Quantities) -> Iterator[Limit]:
    """Yield the limit of the cosine of the platform's inclination."""
    cosine = ca.cos(q.position.roll) * ca.cos(q.position.pitch)
    label = quantity_label(UPRIGHT, degrees=np.rad2deg(np.arccos(MIN_INCLINATION_COSINE)))
    yield Limit(label, cosine, MIN_INCLINATION_COSINE, np.inf)


def map_margin(q: Quantities) -> Iterator[Limit]:
    """Yield the limits that keep each wheel on the map."""
    if np.isfinite(q.terrain.domain).all():
        yield from _inside(q, q.terrain.domain, "map_margin")


def hole_margin(q: Quantities) -> Iterator[Limit]:
    """Yield the limits that keep each wheel off ground without heights."""
    for wheel, contact in zip(q.vehicle.wheels, q.contacts, strict=True):
        margin = q.terrain.hole_margin(contact.point[0], contact.point[1], q.lookups)
        if margin is not None:
            yield Limit(quantity_label("hole_margin", wheel.name), margin, 0.0, np.inf)


def lies_flat(q: Quantities) -> Iterator[Limit]:
    """Yield the limits of the angle between each axle and the ground's normal."""
    sines = [contact.uprightness for contact in q.contacts]
    yield from wheel_limits(q.vehicle, "uprightness", sines, MIN_AXLE_SINE, np.inf)


def relative_curvature(q: Quantities) -> Iterator[Limit]:
    """Yield the limits of the ground's curvature relative to that of each wheel."""
    values = map(curvature_of, q.vehicle.wheels, q.contacts)
    yield from wheel_limits(q.vehicle, "relative_curvature", values, 0.0, np.inf)


def friction_map_margin(q: Quantities) -> Iterator[Limit]:
    """Yield the limits that keep each wheel on the friction map."""
    domain = q.terrain.friction_domain
    if q.vehicle.mass and domain is not None:
        yield from _inside(q, domain, "friction_margin")


def positive_friction(q: Quantities) -> Iterator[Limit]:
    """Yield the limits of the friction coefficient at each wheel, if a formula gives it."""
    if not q.vehicle.mass or q.terrain.friction_domain is not None:
        return
    for wheel, mu in zip(q.vehicle.wheels, q.mechanics.friction, strict=True):
        if not mu.is_constant():
            yield Limit(quantity_label("friction", wheel.name), mu, MIN_FRICTION, np.inf)


def tip_over(q: Quantities) -> Iterator[Limit]:
    """Yield the limit of the tip-over margin of a vehicle with mass."""
    if q.vehicle.mass:
        yield Limit(quantity_label("tip_over"), q.tip_over_margin, 0.0, np.inf)


def lift_off(q: Quantities) -> Iterator[Limit]:
    """Yield the lower limit, zero, of each wheel's normal force.

    There is none for a vehicle without mass, or with wheels that are pressed into the ground.
    """
    if q.vehicle.mass and has_exact_closure(q.vehicle):
        why = "equilibrium would need a negative normal force"
        yield from wheel_limits(q.vehicle, "lift_off", q.forces.normal, 0.0, np.inf, why=why)


LIMITS: tuple[Callable[[Quantities], Iterator[Limit]], ...] = (
    joint_stops,
    upright,
    map_margin,
    hole_margin,
    lies_flat,
    relative_curvature,
    friction_map_margin,
    positive_friction,
)
STATIC_LIMITS = (tip_over, lift_off)  # of models without inertia


def limits_of(q: Quantities, *, static: bool = True, overturns: bool = False) -> tuple[Limit, ...]:
    """Return all limits of a model with the given quantities.

    ``static`` is whether the model neglects inertia, ``overturns`` whether the motion continues if
    the vehicle does, since its bodies bear load.
    """
    functions = (*LIMITS, *STATIC_LIMITS) if static else LIMITS
    kept = (each for each in functions if each is not upright or not overturns)
    return tuple(limit for limits in kept for limit in limits(q))


def _inside(q: Quantities, domain: Domain, name: str) -> Iterator[Limit]:
    """Yield the limits that keep each wheel in a domain in map coordinates."""
    west, east, south, north = domain
    extent = f"from {west:.2f} to {east:.2f} m in x and from {south:.2f} to {north:.2f} m in y"
    o_x, o_y, _ = q.terrain.origin
    margins = list[ca.SX]()
    for contact in q.contacts:
        u_g, v_g = contact.point[0], contact.point[1]  # local
        east_west = ca.fmin(u_g - (west - o_x), (east - o_x) - u_g)
        margins.append(ca.fmin(east_west, ca.fmin(v_g - (south - o_y), (north - o_y) - v_g)))
    yield from wheel_limits(q.vehicle, name, margins, 0.0, np.inf, extent=extent)
