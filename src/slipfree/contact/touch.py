"""Contact of a wheel that may press into the ground or leave it.

The ground point ``G`` nearest to the wheel satisfies ``(P - G) . t = 0`` for both tangents ``t`` of
the ground. ``P = C + s(-n, a)`` is the point of the wheel with the outward normal ``-n``, for the
centre ``C``, the axle ``a`` and the unit normal ``n`` of the ground at ``G``. The gap is
``(P - G) . n``.

Newton's method finds ``G`` in a lookup function, so that a model contains no unknowns and no
iteration. The result also contains the inverse Jacobian, height, gradient and Hessian at ``G``. In
the model one further Newton step, of length zero, has the exact first derivatives of ``G``;
derivatives of higher order are not exact. On a plane no search is needed.

Solids: a torus is the set of points within the distance ``r1``, the radius of its tube, of a disc
with radius ``r2`` about the axle. Its distance from a convex solid therefore is that of two convex
sets, the disc and the solid, less ``r1``. The nearest point ``P`` of the disc minimises half the
squared distance from the solid, which is convex and piecewise quadratic if the disc is outside the
solid, that is, if the wheel is pressed in by less than ``r1``. Newton's method minimises it exactly
in the disc, for one quadratic piece after another. At the minimum the normal is the gradient of the
gap; at any other point, the work of the contact would differ from the change of its elastic energy.

A disc has no tube: on solids, its edge is rounded with a tenth of its radius. Its outer radius is
unchanged.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.closure import ContactFrame, frame_at
from slipfree.core.errors import ModelError
from slipfree.core.lookups import LookupTable, lookup_function
from slipfree.geometry.frame import Pose
from slipfree.terrain.base import Terrain
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.solids import Prism
from slipfree.vehicle.sections import Section
from slipfree.vehicle.tree import Wheel

STEPS = 2  # number of Newton steps from the wheel's lowest point; doubled if these do not converge
DAMPED_STEPS = 30  # number of damped Newton steps if the previous ones do not converge
LONGEST_STEP = 0.2  # largest length of a damped step [rolling radii]
TOLERANCE = 1e-9  # residual of a converged search [m]
CLEARLY_ABOVE = 0.1  # vertical gap above which a search need not converge [rolling radii]
LARGE = 1e9  # larger than every squared residual [m^2]
DIRECTIONS = np.deg2rad([0, -20, 20, -40, 40, -60, 60])  # tread normals, from the vertical [rad]
ROUNDS = 6  # number of Newton steps for the nearest point
MULTIPLIER_STEPS = 4  # number of Newton steps for the multiplier of the radius, in each round
MIN_MULTIPLIER = 1e-9  # smallest multiplier [1]
DISTANCE_TOLERANCE = 1e-12  # a step may increase the distance by this, due to rounding [m]
MAX_DISTANCE = 1e9  # larger than every distance [m]
EDGE_RADIUS = 0.1  # radius of the edge of discs [radii]
ROOT_OFFSET = 1e-18  # keeps the derivatives of square roots finite [m2 or 1]


class Plane(NamedTuple):
    """A plane ground: height at the local origin [m], and gradient, shape (2, 1)."""

    height: ca.DM
    gradient: ca.DM


class Touch(NamedTuple):
    """Contact of a wheel with the ground; positions are local.

    The gap is negative if the wheel presses into the ground [m]; the point of the frame is that of
    the wheel's surface.
    """

    gap: ca.SX
    frame: ContactFrame
    friction: ca.SX


def touch(
    terrain: Terrain, wheel: Wheel, carrier: Pose, search: ca.Function | Plane, lookups: LookupTable
) -> Touch:
    """Return the contact of a wheel with a ground.

    ``search`` is the result of `search_function` for this ground and the wheel's section.
    """
    center, axle = carrier.origin, carrier.rotation[:, 0]
    if isinstance(search, Plane):
        spot, hessian = ca.SX.zeros(2), ca.SX.zeros(2, 2)
        height, slope = ca.SX(search.height), ca.SX(search.gradient)
    else:
        nearest = lookups.find(search, ca.vertcat(center, axle), order=1)
        spot, inverse, height, gradient, hessian = ca.vertsplit(nearest, [0, 2, 6, 7, 9, 13])
        inverse, hessian = ca.reshape(inverse, 2, 2), ca.reshape(hessian, 2, 2)
        off = _miss(wheel.section, spot, center, axle, height, gradient)
        step = -inverse @ off.residual  # zero, with the derivatives of the ground point
        slope, spot = gradient + hessian @ step, spot + step
        height += ca.dot(gradient + slope, step) / 2
    at = _miss(wheel.section, spot, center, axle, height, slope)
    frame = frame_at(at.point, at.normal, axle, hessian)
    friction = wheel.grip * terrain.friction(at.point[0], at.point[1], lookups)
    return Touch(at.gap, frame, friction)


class _Miss(NamedTuple):
    """Trial of the contact search: residual (2, 1) [m], ground normal, tread point and gap [m]."""

    residual: ca.SX
    normal: ca.SX
    point: ca.SX
    gap: ca.SX


def _miss(
    section: Section, spot: ca.SX, center: ca.SX, axle: ca.SX, height: ca.SX, gradient: ca.SX
) -> _Miss:
    """Return the trial at the ground point ``spot``, with the tread point facing its normal."""
    normal = ca.vertcat(-gradient, 1) / ca.sqrt(1 + ca.sumsqr(gradient))
    point = center + section.support(-normal, axle)
    away = point - ca.vertcat(spot, height)
    return _Miss(away[:2] + away[2] * gradient, normal, point, ca.dot(away, normal))


def search_function(terrain: Terrain, section: Section, radius: float) -> ca.Function | Plane:
    """Return a function that finds the ground point nearest to a wheel, or a plane ground.

    The function maps centre and axle (6, 1) to the nearest point, the inverse Jacobian of the
    residual, height, gradient and Hessian there (13, 1). If Newton's method does not converge, the
    result is NaN, or, for a wheel clearly above the ground, the ground point below it with a zero
    inverse Jacobian.
    """
    radii, plane = section.torus_radii, plane_of(terrain)
    if plane is not None:
        return plane
    if isinstance(terrain, Bicubic) and radii is not None:
        compiled = terrain.nearest_point(*radii, radius)
        if compiled is not None:
            return compiled
    return _search_graph(terrain, section, radius)


def plane_of(terrain: Terrain) -> Plane | None:
    """Return a ground as a plane; None if it is not a plane, or an inclined one on a map."""
    if isinstance(terrain, Bicubic) and terrain.is_level:
        return Plane(ca.DM(terrain.grid.values.flat[0] - terrain.origin[2]), ca.DM.zeros(2))
    spot, lookups = ca.SX.sym("spot", 2), LookupTable()
    jet = terrain.jet(spot[0], spot[1], lookups)
    if lookups.lookups or ca.sparsify(jet.hessian).nnz():
        return None
    height, gradient = ca.Function("plane", [spot], [jet.height, jet.gradient])([0, 0])
    return Plane(height, ca.densify(gradient))


def _search_graph(terrain: Terrain, section: Section, radius: float) -> ca.Function:
    """Return the search as a CasADi graph, equivalent to `nearest` of `kernel.c` for maps.

    Its argument is centre and axle of the wheel (6), its result that of `search_function` (13).
    Newton's method begins below the tread point nearest to the ground; if it does not converge, it
    goes on from its end, and then begins again with damped steps. Later attempts are evaluated only
    if the earlier ones fail.
    """
    jet, newton = jet_function(terrain), _newton_function(section)
    symbol: Any = ca.SX if jet.is_a("SXFunction") else ca.MX
    asked, begin, gap = symbol.sym("asked", 6), symbol.sym("begin", 2), symbol.sym("gap")
    place, above = _lowest_point(section, jet, asked)
    root = _result(jet, newton, _newton_steps(jet, newton, place, asked), asked)
    results = [place, above, root[:13], _converged(root)]
    first = ca.Function("first", [asked], results, {"cse": True})

    root = _result(jet, newton, _newton_steps(jet, newton, begin, asked), asked)
    second = ca.Function("second", [begin, asked], [root[:13], _converged(root)], {"cse": True})

    root = _result(jet, newton, _damped_steps(jet, newton, begin, asked, radius), asked)
    in_air = ca.vertcat(begin, ca.DM.zeros(4), jet(begin))
    missing = ca.if_else(gap > CLEARLY_ABOVE * radius, in_air, ca.DM.nan(13))
    result = ca.if_else(_converged(root), root[:13], missing)
    kept = symbol.sym("kept", 13)
    given = [begin, gap, asked, kept]
    damped = ca.Function("damped", given, [result], {"cse": True})
    # not `ca.if_else`, whose branches would evaluate `first` again
    keep = ca.Function("keep", given, [kept])
    last = ca.Function.if_else("last", keep, damped)

    place, above, question, kept = keep.mx_in()
    root, done = second(kept[:2], question)
    result = last(done, place, above, question, root)
    more = ca.Function("more", [place, above, question, kept], [result])
    choose = ca.Function.if_else("choose", keep, more)
    question = ca.MX.sym("asked", 6)
    place, above, root, done = first(question)
    return ca.Function("search", [question], [choose(done, place, above, question, root)])


def _lowest_point(section: Section, jet: ca.Function, asked: Any) -> list[Any]:
    """Return x and y of the tread point nearest to the ground below, and its height above it.

    The tread points compared have normals in the vertical plane along the direction of travel, at
    the angles `DIRECTIONS` from the vertical.
    """
    center, axle = asked[:3], asked[3:]
    forward = ca.vertcat(-axle[1], axle[0], 0) / ca.sqrt(ca.sumsqr(axle[:2]) + TOLERANCE**2)
    best: Any = None
    least: Any = None
    for angle in DIRECTIONS:
        down = ca.vertcat(0, 0, -np.cos(angle)) + np.sin(angle) * forward
        point = center + section.support(down, axle)
        height = point[2] - jet(point[:2])[0]
        if best is None:
            best, least = point[:2], height
        else:
            best = ca.if_else(height < least, point[:2], best)
            least = ca.fmin(height, least)
    return [best, least]


def _newton_steps(jet: ca.Function, newton: ca.Function, spot: Any, asked: Any) -> Any:
    for _ in range(STEPS):
        spot = spot + newton(spot, asked, jet(spot))[0][:2]
    return spot


def _result(jet: ca.Function, newton: ca.Function, spot: Any, asked: Any) -> Any:
    """Return the result of a search that ends at a point, and its residual, shape (15, 1)."""
    end = jet(spot)
    step = newton(spot, asked, end)[0]
    return ca.vertcat(spot, step[2:6], end, step[6:])


def _converged(result: Any) -> Any:
    x, y = ca.vertsplit(ca.fabs(result[13:]))
    return ca.logic_and(x < TOLERANCE, y < TOLERANCE)  # the maximum would ignore NaN


def _damped_steps(
    jet: ca.Function, newton: ca.Function, spot: Any, asked: Any, radius: float
) -> Any:
    """Return the point with the least residual after Newton steps of limited length.

    ``spot`` is the first ground point, ``asked`` centre and axle of the wheel, ``radius`` its
    radius [m]. A step is halved until it reduces the residual.
    """
    best, least, step = spot, LARGE, 0 * spot
    for _ in range(DAMPED_STEPS):
        correction = newton(spot, asked, jet(spot))[0]
        size, full = ca.sumsqr(correction[6:]), correction[:2]
        limited = full * ca.fmin(1, LONGEST_STEP * radius / (ca.norm_2(full) + TOLERANCE))
        # false for NaN too: a step to where the residual is undefined is halved
        better = size < least
        best, least = ca.if_else(better, spot, best), ca.if_else(better, size, least)
        step = ca.if_else(better, limited, step / 2)
        spot = best + step
    return best


def jet_function(terrain: Terrain) -> ca.Function:
    """Return height, gradient and Hessian of a ground as a function of a point, shape (7, 1)."""
    spot, lookups = ca.SX.sym("spot", 2), LookupTable()
    jet = (ca.vec(each) for each in terrain.jet(spot[0], spot[1], lookups))
    return lookup_function(lookups.lookups, "jet", [spot], [ca.densify(ca.vertcat(*jet))])


def _newton_function(section: Section) -> ca.Function:
    """Return one step of Newton's method for the nearest ground point.

    The function maps a ground point, the wheel's centre and axle (6, 1), and height, gradient and
    Hessian at the ground point (7, 1) to the step, the inverse Jacobian and the residual, shape
    (8, 1), and to the point of the wheel, shape (3, 1).
    """
    spot, asked, jet = ca.SX.sym("spot", 2), ca.SX.sym("asked", 6), ca.SX.sym("jet", 7)
    at = _miss(section, spot, asked[:3], asked[3:], jet[0], jet[1:3])
    hessian = ca.reshape(jet[3:], 2, 2)
    # derivative of point, height and gradient with respect to the point: the jet contains it, so
    # that no lookup of the ground is differentiated
    by_jet = ca.vertcat(ca.SX.eye(2), jet[1:3].T, hessian)
    jacobian = ca.jacobian(at.residual, ca.vertcat(spot, jet[:3])) @ by_jet
    inverse = ca.inv(jacobian)
    results = ca.vertcat(-inverse @ at.residual, ca.vec(inverse), at.residual)
    return ca.Function("newton", [spot, asked, jet], [ca.densify(results), at.point], {"cse": True})


def tube_radii(wheel: Wheel) -> tuple[float, float]:
    """Return the radii of the tube and of the circle of tube centres of a wheel on solids [m].

    ModelError is raised for a wheel that is not a torus, a disc or a sphere.
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
    """Return the contact of a wheel with a solid; ModelError as `tube_radii`.

    ``terrain`` is the ground under the solid, which determines the local origin and the friction.
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
    point = spot - tube * normal
    frame = frame_at(point, normal, axle, ca.SX.zeros(2, 2), ROOT_OFFSET)
    friction = wheel.grip * terrain.friction(point[0], point[1], lookups)
    return Touch(distance - tube, frame, friction)


def _nearest_on_disc(prism: Prism, origin: ca.DM, carrier: Pose, circle: float) -> ca.SX:
    """Return the point of a disc about the axle that is nearest to a solid, shape (3, 1) [m].

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
    # shares of the linear term along the principal axes; eigenvectors would have no derivative
    # where the eigenvalues are equal
    total = ca.sumsqr(linear) / radius**2
    product = ca.dot(linear, hessian @ linear) / radius**2
    first = ca.fmax(0, ca.fmin(total, (product - smaller * total) / spread))
    last = total - first
    # each share alone bounds the multiplier from below; Newton's method starts from the larger one
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
