"""Contact of a wheel with a convex solid.

A torus is the set of points within the distance ``r1``, the radius of its tube, of a disc with
radius ``r2`` about the axle. Its distance from a convex solid therefore is that of two convex sets,
the disc and the solid, less ``r1``. The nearest point ``P`` of the disc minimises half the squared
distance from the solid, which is convex and piecewise quadratic if the disc is outside the solid,
that is, if the wheel is pressed in by less than ``r1``. Newton's method minimises it exactly in the
disc, for one quadratic piece after another. At the minimum the normal is the gradient of the gap;
at any other point, the work of the contact would differ from the change of its elastic energy.

A disc has no tube: on solids, its edge is rounded with a tenth of its radius. Its outer radius is
unchanged.
"""

from __future__ import annotations

import casadi as ca

from slipfree.contact.closure import ContactFrame
from slipfree.contact.touch import Touch
from slipfree.core.errors import ModelError
from slipfree.core.lookups import LookupTable
from slipfree.geometry.frame import Pose
from slipfree.terrain.base import Terrain
from slipfree.terrain.solids import Prism
from slipfree.vehicle.wheel import Wheel

ROUNDS = 6  # number of Newton steps for the nearest point
MULTIPLIER_STEPS = 4  # number of Newton steps for the multiplier of the radius, in each round
MIN_MULTIPLIER = 1e-9  # smallest multiplier [1]
DISTANCE_TOLERANCE = 1e-12  # a step may increase the distance by this, due to rounding [m]
MAX_DISTANCE = 1e9  # larger than every distance [m]
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
    """Return the point of a disc about the axle that is nearest to a solid, shape (3, 1) [m].

    Notes
    -----
    A step that increases the distance is rejected. The next trial is the minimum of the quadratic
    piece at the rejected point, then half the step.
    """
    center, plane = carrier.origin, carrier.rotation[:, 1:]
    if not circle:
        return center
    best, trial, step = ca.SX.zeros(2), ca.SX.zeros(2), ca.SX.zeros(2)  # in the disc's plane
    least, slack = ca.SX(MAX_DISTANCE), ca.SX(DISTANCE_TOLERANCE)
    for _ in range(ROUNDS):
        distance, normal, hessian = prism.expansion(center + plane @ trial + origin, plane)
        linear = hessian @ trial - distance * (plane.T @ normal)
        newton = _minimum_in_disc(hessian, linear, circle)
        is_better = distance < least + slack
        is_first = ca.logic_and(ca.logic_not(is_better), slack > 0)  # first rejection
        best, least = ca.if_else(is_better, trial, best), ca.if_else(is_better, distance, least)
        step = ca.if_else(is_better, newton - trial, ca.if_else(is_first, step, step / 2))
        trial = ca.if_else(is_first, newton, best + step)
        slack = ca.if_else(is_first, -DISTANCE_TOLERANCE, DISTANCE_TOLERANCE)
    return center + plane @ trial


def _minimum_in_disc(hessian: ca.SX, linear: ca.SX, radius: float) -> ca.SX:
    """Return the minimum of a convex quadratic function in a disc about zero, shape (2, 1).

    The function is ``p' hessian p / 2 - linear' p``. With the multiplier ``m`` of the radius, the
    minimum ``p`` satisfies ``(hessian + m) p = linear``. Newton's method for the reciprocal of its
    norm finds ``m`` in principal axes; the last step is in the given axes, where it has no
    cancellation.
    """
    a, b, c = hessian[0, 0], hessian[0, 1], hessian[1, 1]
    spread = ca.sqrt((a - c) ** 2 + 4 * b**2 + ROOT_OFFSET)
    larger, smaller = (a + c + spread) / 2, ca.fmax(0, (a + c - spread) / 2)
    total = ca.sumsqr(linear) / radius**2
    product = ca.dot(linear, hessian @ linear) / radius**2
    first = ca.fmax(0, ca.fmin(total, (product - smaller * total) / spread))
    last = total - first
    bound = ca.fmax(MIN_MULTIPLIER, ca.sqrt(first + ROOT_OFFSET) - larger)
    multiplier = ca.fmax(bound, ca.sqrt(last + ROOT_OFFSET) - smaller)
    for _ in range(MULTIPLIER_STEPS):
        one, two = 1 / (larger + multiplier), 1 / (smaller + multiplier)
        shares = first * one**2, last * two**2
        square = sum(shares) + ROOT_OFFSET
        slope = shares[0] * one + shares[1] * two + ROOT_OFFSET
        multiplier = ca.fmax(bound, multiplier + square / slope * (ca.sqrt(square) - 1))

    def solve() -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Return the solution times the determinant, the determinant, and the diagonal."""
        one, two = a + multiplier, c + multiplier
        x, y = two * linear[0] - b * linear[1], one * linear[1] - b * linear[0]
        return ca.vertcat(x, y), one * two - b**2, one, two

    point, determinant, one, two = solve()
    square = ca.sumsqr(point) + ROOT_OFFSET**2
    slope = two * point[0] ** 2 - 2 * b * point[0] * point[1] + one * point[1] ** 2
    excess = ca.sqrt(square) / radius - determinant
    multiplier = ca.fmax(bound, multiplier + square / (slope + ROOT_OFFSET**2) * excess)
    point, determinant, _, _ = solve()
    norm = ca.sqrt(ca.sumsqr(point) + ROOT_OFFSET**2)
    return point / ca.fmax(determinant, norm / radius)
