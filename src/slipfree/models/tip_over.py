"""Tip-over margin of a vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import casadi as ca

from slipfree.contact.closure import ContactFrame
from slipfree.geometry.frame import platform
from slipfree.models.base import values_of
from slipfree.models.records import Configuration, Dependent
from slipfree.vehicle.tree import Vehicle

DISTANCE_ROUNDING = 1e-9  # smaller distances count as zero [distance of two wheels]


def tip_over_margin(
    vehicle: Vehicle, x: Configuration, position: Dependent, contacts: Sequence[ContactFrame]
) -> ca.SX:
    """Return the smallest angle between gravity and an edge of the support polygon [rad].

    For an edge, the line through two neighbouring contact points, it is the angle between the
    vertical and the perpendicular from the vehicle's centre of mass to the line (the force-angle
    measure of Papadopoulos and Rey for gravity alone). It is negative if the line of gravity
    passes outside the polygon, -pi if all contacts lie on a line in plan view, and infinite for a
    vehicle without mass. For a planar vehicle, the edges are the contacts of the first and the last
    wheel.
    """
    if not vehicle.mass:
        return ca.SX.inf()
    base = platform(x.x, x.y, position.z, x.heading, position.roll, position.pitch)
    masses = list(vehicle.masses(base, values_of(vehicle, x, position)))
    center = sum(mass * at for _, mass, at in masses) / vehicle.mass
    if vehicle.planar:
        arms = [contact.point - center for contact in contacts]
        ends = ([sign * ca.atan2(arm[1], -arm[2]) for arm in arms] for sign in (1, -1))
        return ca.mmin(ca.vertcat(*(ca.mmax(ca.vertcat(*each)) for each in ends)))
    points = [contact.point for contact in contacts]
    down, least = ca.SX([0, 0, -1]), ca.SX.inf()
    here, is_polygon, next_corner = _farthest(points), ca.SX(0), _next_corner(len(points))
    for _ in points:
        there, turns = next_corner(here, ca.horzcat(*points))
        is_polygon = ca.logic_or(is_polygon, turns)
        edge = there - here
        edge /= ca.norm_2(edge)
        arm = here - center
        arm -= ca.dot(arm, edge) * edge
        lean = ca.atan2(ca.dot(edge, ca.cross(arm, down)), ca.dot(arm, down))
        least, here = ca.fmin(least, lean), there
    return ca.if_else(is_polygon, least, -ca.pi)


def _farthest(points: Sequence[ca.SX]) -> ca.SX:
    """Return the point farthest from the first one in plan view: a corner of the polygon."""
    best, most = points[0], ca.SX(0)
    for point in points[1:]:
        away = ca.sumsqr((point - points[0])[:2])
        best, most = ca.if_else(away > most, point, best), ca.fmax(away, most)
    return best


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
        is_chosen = ca.logic_or(aside < -zero, is_last)
        turns = ca.logic_or(turns, ca.fabs(aside) > zero)
        chosen = (point, there), (arrow, edge), (reach, length)
        there, edge, length = (ca.if_else(is_chosen, new, old) for new, old in chosen)
    return ca.Function("next_corner", [here, points], [there, turns])
