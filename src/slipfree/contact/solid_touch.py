"""Contact of a wheel with a convex solid.

A torus is the set of points within the distance ``r1``, the radius of its tube, of a disc with
radius ``r2`` about the axle. Its distance from a convex solid therefore is that of two convex sets,
the disc and the solid, less ``r1``. Alternating projections find their nearest points: ``Q`` on the
solid and ``P`` on the disc, from the centre. They converge if the disc is outside the solid, that
is, if the wheel is pressed in by less than ``r1``. On a face a single projection is exact; at edges
convergence is linear, so that every second projection is extrapolated at its rate (Aitken).

A disc has no tube: on solids, its edge is rounded with a tenth of its radius. The radius in its
plane is unchanged.
"""

from __future__ import annotations

import casadi as ca

from slipfree.contact.closure import ContactFrame
from slipfree.contact.touch import Touch
from slipfree.errors import ModelError
from slipfree.geometry.frame import Pose
from slipfree.lookups import LookupTable
from slipfree.terrain.base import Terrain
from slipfree.terrain.solids import Prism
from slipfree.vehicle.wheel import Wheel

ROUNDS = 8  # of Newton's method for the nearest point
MULTIPLIER_STEPS = 3
SLACK = 1e-12
LARGE = 1e9
LEAST_MULTIPLIER = 1e-9
EDGE_RADIUS = 0.1  # radius of the edge of discs [radii]
ROOT_OFFSET = 1e-18  # keeps the derivatives of square roots finite [m2 or 1]


def tube_radii(wheel: Wheel) -> tuple[float, float]:
    """Return the radii of the tube and of the circle of tube centres of a wheel on solids [m].

    Raises
    ------
    ModelError
        If the wheel is not a torus, a disc or a sphere.
    """
    radii = wheel.section.torus_radii
    if radii is None:
        raise ModelError(
            f"solids: expected a torus, a disc or a sphere as section of wheel {wheel.name!r}, "
            f"found {wheel.section}; change its section"
        )
    tube, circle = radii
    return (tube, circle) if tube else (EDGE_RADIUS * circle, (1 - EDGE_RADIUS) * circle)


def solid_touch(
    prism: Prism, terrain: Terrain, wheel: Wheel, carrier: Pose, lookups: LookupTable
) -> Touch:
    """Return the contact of a wheel with a solid.

    Parameters
    ----------
    prism : Prism
        The solid.
    terrain : Terrain
        The ground under it, which determines the local origin and the friction.
    wheel : Wheel
        The wheel.
    carrier : Pose
        Pose of the wheel's carrier, at the wheel's centre, in local coordinates.
    lookups : LookupTable
        Lookups of the model.

    Raises
    ------
    ModelError
        If the wheel is not a torus, a disc or a sphere.
    """
    tube, circle = tube_radii(wheel)
    center, axle, origin = carrier.origin, carrier.rotation[:, 0], ca.DM(terrain.origin)

    distance, normal = prism.gap(center + origin)
    if ca.sparsify(ca.dot(normal, axle)).nnz() == 0:
        # the solid's faces and edges are parallel to the axle: distance from a circle
        spot, distance = center - circle * normal, distance - circle
    else:
        spot = _nearest_on_disc(prism, origin, carrier, circle)
        distance, normal = prism.gap(spot + origin)
    forward = ca.cross(normal, axle)
    uprightness = ca.sqrt(ca.sumsqr(forward) + ROOT_OFFSET)
    along, point = forward / uprightness, spot - tube * normal
    across, flat = ca.cross(along, normal), ca.SX.zeros(2, 2)
    frame = ContactFrame(point, normal, along, across, axle, uprightness, flat)
    friction = wheel.grip * terrain.friction(point[0], point[1], lookups)
    return Touch(distance - tube, frame, friction)


def _nearest_on_disc(prism: Prism, origin: ca.DM, carrier: Pose, circle: float) -> ca.SX:
    """Return the point of a disc about the axle that is nearest to a solid, shape (3, 1) [m]."""
    center, plane = carrier.origin, carrier.rotation[:, 1:]
    if not circle:
        return center
    best, trial, step = ca.SX.zeros(2), ca.SX.zeros(2), ca.SX.zeros(2)
    least, multiplier, slack = ca.SX(LARGE), ca.SX(0), ca.SX(SLACK)
    for _ in range(ROUNDS):
        distance, normal, hessian = prism.expansion(center + plane @ trial + origin, plane)
        linear = hessian @ trial - distance * (plane.T @ normal)
        newton, own = _minimum(hessian, linear, circle, multiplier)
        is_better = distance < least + slack
        is_first = ca.logic_and(ca.logic_not(is_better), slack > 0)  # rejected for the first time
        best, least = ca.if_else(is_better, trial, best), ca.if_else(is_better, distance, least)
        step = ca.if_else(is_better, newton - trial, ca.if_else(is_first, step, step / 2))
        multiplier = ca.if_else(is_better, own, multiplier)
        trial = ca.if_else(is_first, newton, best + step)
        slack = ca.if_else(is_first, -SLACK, SLACK)
    return center + plane @ trial


def _minimum(
    hessian: ca.SX, linear: ca.SX, radius: float, multiplier: ca.SX
) -> tuple[ca.SX, ca.SX]:
    """Return the minimum of ``p' hessian p / 2 - linear' p`` in a disc, shape (2, 1).

    The multiplier of the radius is found by Newton's method.
    """
    a, b, c = hessian[0, 0], hessian[0, 1], hessian[1, 1]
    largest = (a + c + ca.sqrt((a - c) ** 2 + 4 * b**2 + ROOT_OFFSET)) / 2
    size = ca.sqrt(ca.sumsqr(linear) + ROOT_OFFSET)
    bound = ca.fmax(LEAST_MULTIPLIER, size / radius - largest)
    multiplier = ca.fmax(multiplier, bound)
    for _ in range(MULTIPLIER_STEPS):
        first, last = a + multiplier, c + multiplier
        det = first * last - b**2
        x, z = last * linear[0] - b * linear[1], first * linear[1] - b * linear[0]  # times det
        square = x**2 + z**2 + ROOT_OFFSET**2
        slope = (last * x**2 - 2 * b * x * z + first * z**2) + ROOT_OFFSET**2
        multiplier = ca.fmax(
            bound, multiplier + square / slope * (ca.sqrt(square) / radius - det) 
        )
    first, last = a + multiplier, c + multiplier
    det = first * last - b**2
    x, z = last * linear[0] - b * linear[1], first * linear[1] - b * linear[0]
    point = ca.vertcat(x, z)
    return point / ca.fmax(det, ca.sqrt(ca.sumsqr(point) + ROOT_OFFSET**2) / radius), multiplier
