"""Tip-over margin of a vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

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
    down, least = ca.SX([0, 0, -1]), ca.SX.inf()
    for i, j in permutations(range(len(contacts)), 2):
        edge = contacts[j].point - contacts[i].point
        outer = _is_outer(contacts, i, j)
        edge /= ca.norm_2(edge)
        arm = contacts[i].point - center
        arm -= ca.dot(arm, edge) * edge
        lean = ca.atan2(ca.dot(edge, ca.cross(arm, down)), ca.dot(arm, down))
        least = ca.fmin(least, ca.if_else(outer, lean, ca.SX.inf()))
    return ca.if_else(least > ca.pi, -ca.pi, least)  # contacts on one line: no support polygon


def _is_outer(contacts: Sequence[ContactFrame], i: int, j: int) -> ca.SX:
    """Return whether the line from contact i to contact j is an edge of the support polygon.

    All other contacts then lie left of the line in plan view, or on it between its ends.
    """
    here = contacts[i].point[:2]
    edge = contacts[j].point[:2] - here
    length, outer, aside = ca.sumsqr(edge), ca.SX(1), ca.SX(0)
    for k, other in enumerate(contacts):
        if k in (i, j):
            continue
        off = (edge[0] * (other.point[1] - here[1]) - edge[1] * (other.point[0] - here[0])) / length
        ahead = ca.dot(other.point[:2] - here, edge) / length
        left = off > DISTANCE_ROUNDING
        between = ca.logic_and(
            ca.fabs(off) <= DISTANCE_ROUNDING, ca.logic_and(ahead > 0, ahead < 1)
        )
        outer = ca.logic_and(outer, ca.logic_or(left, between))
        aside = ca.logic_or(aside, left)
    return ca.logic_and(outer, aside)
