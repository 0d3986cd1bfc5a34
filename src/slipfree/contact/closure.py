"""Contact of a wheel with the ground at position level.

The wheel touches the ground at ``G`` where its outward normal is opposite to the ground's unit
normal ``n``. With the wheel's centre ``C`` and axle ``a``, and the point ``s(-n, a)`` of its
surface with that normal (``Section.support``), contact means ``G = C + s(-n, a)``. For the torus
it is ``G + r1 n + r2 e = C`` with ``e`` the unit vector of ``n - (n.a) a``.
"""

from __future__ import annotations

from math import pi, sin
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.lookups import LookupTable
from slipfree.geometry.frame import Pose, platform
from slipfree.terrain.base import Terrain
from slipfree.vehicle.formula import evaluate
from slipfree.vehicle.tree import Vehicle, Wheel

ROOT_OFFSET = 1e-30  # keeps a quotient finite [1]
MIN_PART = 0.05  # smallest entry of a free motion that is named
FREE = 1e-9  # smaller singular values are those of free motions [largest one]


class ContactFrame(NamedTuple):
    """Contact point of a wheel and the directions there, in the terrain's local coordinates."""

    point: ca.SX  # contact point ``G``, shape (3, 1) [m]
    normal: ca.SX  # unit normal of the ground, upward, shape (3, 1) [1]
    # unit tangents: forward, ``n x a / |n x a|``, and to the right, shape (3, 1) [1]
    along: ca.SX
    across: ca.SX
    axle: ca.SX  # unit vector of the wheel's axle, to the right, shape (3, 1) [1]
    # ``|n x a|``: one for a wheel that stands on the ground, zero for one that lies flat [1]
    uprightness: ca.SX
    hessian: ca.SX  # second derivatives of the height, shape (2, 2) [1/m]


def has_exact_closure(vehicle: Vehicle) -> bool:
    """Return whether all wheels of a vehicle can touch a rigid ground in every configuration.

    Every wheel adds one constraint. Three constraints determine the pose of the platform; each
    further constraint requires a suspension coordinate. The result is false for a vehicle that is
    locked to a plane.
    """
    return not vehicle.planar and len(vehicle.of("suspension")) == len(vehicle.wheels) - 3


def check_couplings(vehicle: Vehicle) -> None:
    """Raise ModelError if an angle is free: by couplings, or since all wheels are on one line.

    On level ground, the heights of the wheels' centres determine height, roll, pitch and all
    suspension coordinates of a vehicle with exact closure. Two rockers that turn alike leave the
    pitch of the platform between them free.
    """
    suspension = vehicle.of("suspension")
    places = np.column_stack([vehicle.centers[:, :2], np.ones(len(vehicle.wheels))])
    if not vehicle.planar and np.linalg.matrix_rank(places, FREE) < 3:
        listed = ", ".join(wheel.name for wheel in vehicle.wheels)
        raise ModelError(
            f"vehicle {vehicle.name!r}: expected wheels that are not all on one line, so that it "
            f"can stand, found {listed} on one; correct their places, or add a wheel beside it"
        )
    moved = {
        c.name: [joint.name for joint in vehicle.joints if c.name in joint.coordinates]
        for c in suspension
    }
    is_sprung = any(c.stiffness for c in suspension)
    if not has_exact_closure(vehicle) or is_sprung or max(map(len, moved.values()), default=0) < 2:
        return
    names = ["z", "roll", "pitch", *moved]
    q = ca.SX.sym("q", len(names))
    zero = {c.name: ca.SX(0) for c in vehicle.coordinates}
    values = dict(zip(moved, ca.vertsplit(q)[3:], strict=True))
    level = ca.SX(0)
    poses = vehicle.carriers(platform(level, level, q[0], level, q[1], q[2]), values)
    heights = [pose.origin[2] for pose in poses]
    slopes = ca.Function("slopes", [q], [ca.jacobian(ca.vertcat(*heights), q)])
    _, sizes, right = np.linalg.svd(np.array(slopes(0)))
    free = [name for name, part in zip(names, right[-1], strict=True) if abs(part) > MIN_PART]
    coupled = [name for name in free if len(moved.get(name, ())) > 1]
    if sizes[-1] > FREE * sizes[0] or not coupled:
        return
    first, second, *_ = moved[coupled[0]]
    turning = [joint.value for joint in vehicle.joints if joint.name in (first, second)]
    symbol = ca.SX.sym("q")
    formulas = (evaluate(value, {**zero, coupled[0]: symbol}) for value in turning)
    ahead, behind = (float(ca.evalf(ca.jacobian(each, symbol))) for each in formulas)
    raise ModelError(
        f"{vehicle.name!r}: expected coupled joints with which the ground determines all angles, "
        f"found that {' and '.join(free)} are free, since {first!r} and {second!r} turn so that no "
        f"wheel moves against the others; write couple = {{ {first} = {behind / ahead:g}, "
        f"{second} = 1 }}, with which {second!r} turns the other way"
    )


def support_fault(vehicle: Vehicle) -> str:
    """Return an error message if contacts and springs do not determine a vehicle's pose, else "".

    The text follows the word "expected" in messages.
    """
    wheels = len(vehicle.wheels)
    given = len(vehicle.of("suspension"))
    loose = [repr(c.name) for c in vehicle.of("suspension") if not c.stiffness]
    if vehicle.planar:
        return "a vehicle that moves in space, found one locked to a plane; use dynamics"
    if wheels < 3:
        return f"at least 3 wheels, found {wheels}; add wheels, or use dynamics"
    if loose and given > wheels - 3:
        it = "it" if len(loose) == 1 else "them"
        return (
            f"no more suspension coordinates than wheels beyond three ({wheels - 3}), or a spring "
            f"at each, found {given} and no spring at {', '.join(loose)}; give {it} a stiffness, "
            f"make {it} passive or commanded, or remove {it}"
        )
    return ""


def check_support(vehicle: Vehicle, model: str = "") -> None:
    """Raise ModelError if contacts and springs do not determine a vehicle's pose.

    The message begins with ``model``.
    """
    if fault := support_fault(vehicle):
        raise ModelError(f"{model}{vehicle.name!r}: expected {fault}")


def check_exact_closure(
    vehicle: Vehicle,
    model: str,
    remedy: str = "use the model 'dynamics', which also answers with friction, or 'kinematics' "
    "with least slip, which press the wheels into the ground",
) -> None:
    """Raise ModelError if not all wheels of a vehicle can touch a rigid ground.

    The message begins with ``model``, the model or law that requires it. It ends
    with ``remedy`` if the vehicle can be modelled with pressed wheels.
    """
    check_support(vehicle, f"{model}: ")
    if not has_exact_closure(vehicle):
        wheels, given = len(vehicle.wheels), len(vehicle.of("suspension"))
        raise ModelError(
            f"{model}: expected a vehicle whose wheels can all touch a rigid ground, that is, a "
            f"suspension coordinate for each wheel beyond three ({wheels - 3}), found {given} in "
            f"{vehicle.name!r}; {remedy}"
        )


def contact_frame(
    terrain: Terrain, x: ca.SX, y: ca.SX, axle: ca.SX, lookups: LookupTable
) -> ContactFrame:
    """Return the contact frame at a local ground point for a wheel with a given axle."""
    height, gradient, hessian = terrain.jet(x, y, lookups)
    normal = ca.vertcat(-gradient, 1) / ca.sqrt(1 + ca.sumsqr(gradient))
    return frame_at(ca.vertcat(x, y, height), normal, axle, hessian)


def frame_at(
    point: ca.SX, normal: ca.SX, axle: ca.SX, hessian: ca.SX, offset: float = 0.0
) -> ContactFrame:
    """Return the contact frame at a point; ``offset`` keeps derivatives finite at zero."""
    # the axle points to the right and the normal up, so that n x a points forward
    forward = ca.cross(normal, axle)
    uprightness = ca.sqrt(ca.sumsqr(forward) + offset)
    along = forward / uprightness
    across = ca.cross(along, normal)
    return ContactFrame(point, normal, along, across, axle, uprightness, hessian)


def closure(wheel: Wheel, carrier: Pose, contact: ContactFrame) -> ca.SX:
    """Return the contact residual ``G - s(-n, a) - C`` of a wheel, shape (3, 1) [m].

    ``G`` is the ground point with normal ``n``, ``s`` the point of the wheel with the opposite
    normal relative to its centre ``C``, and ``a`` the axle. The residual is zero in contact.
    """
    return contact.point - wheel.section.support(-contact.normal, contact.axle) - carrier.origin


def without_rolling(wheel: Wheel, contact: ContactFrame, velocity: ca.SX) -> ca.SX:
    """Return a velocity at the contact without the component in which rollers turn freely [m/s].

    Rollers with an axle at the angle ``phi`` from the wheel's axle ``a`` turn in the direction
    ``sin(phi) l - cos(phi) |n x a| t`` of the ground, for the unit tangents ``t`` along and ``l``
    across the wheel: it is perpendicular to the roller's axle ``cos(phi) a + sin(phi) t``, since
    the component of ``a`` along ``l`` is ``|n x a|``.
    """
    if wheel.rollers is None:
        return velocity
    sine, cosine = sin(wheel.rollers), sin(pi / 2 - wheel.rollers)  # exactly 0 for omni wheels
    shortened = cosine * contact.uprightness
    free = sine * contact.across - shortened * contact.along
    return velocity - free * (ca.dot(free, velocity) / (sine**2 + shortened**2))


def wheel_coordinates(carrier: Pose, contact: ContactFrame) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the contact coordinates ``u_w, v_w, psi`` of a wheel, in its carrier's frame [rad].

    ``u_w`` and ``v_w`` are the parameters of ``Section.point`` (for the torus those of
    Chakraborty and Ghosal, eq. 1) at the point with the outward normal ``-n``, where ``n`` is the
    ground's upward normal; ``v_w`` is 3 pi/2 for a wheel upright on level ground. ``psi`` is the
    angle from the wheel's Gauss x axis to the ground's Gauss x axis.
    """
    down = -carrier.rotation.T @ contact.normal
    u = ca.atan2(ca.norm_2(down[1:]), down[0])
    # counted from the lowest point, at which the paper's v is 3 pi/2
    v = 1.5 * ca.pi + ca.atan2(down[1], -down[2])
    x_w = carrier.rotation @ ca.vertcat(-ca.sin(u), ca.cos(v) * ca.cos(u), ca.sin(v) * ca.cos(u))
    n = contact.normal
    x_g = ca.vertcat(n[2], 0, -n[0])  # along (1, 0, h_x); zero at a vertical face across y
    x_g /= ca.sqrt(ca.sumsqr(x_g) + ROOT_OFFSET)
    # the sine is (x_w x x_g) . n: psi is positive counter-clockwise about the ground's normal
    return u, v, ca.atan2(-ca.dot(x_w, ca.cross(n, x_g)), ca.dot(x_w, x_g))


def relative_curvature(wheel: Wheel, contact: ContactFrame) -> ca.SX:
    """Return the margin of local uniqueness of a contact, positive for a unique contact [1/m].

    The contact is locally unique if Montana's relative curvature form, the sum of the curvatures of
    wheel and ground, is positive definite. The curvature of the wheel is ``k = m / rho`` along the
    wheel and ``1 / r`` across it, with the uprightness ``m``, the distance ``rho`` of the contact
    point from the axle and the radius ``r`` of the tread. The curvature ``K`` of the ground has
    components along (``t``) and across (``l``) the wheel and is negative in valleys. The form is
    positive definite if ``1 + r K_ll`` and ``k + K_tt - r K_tl^2 / (1 + r K_ll)`` are positive,
    also for the edge of a disc (``r = 0``). The margin is the smaller of these two numbers, the
    first divided by the rolling radius.
    """
    second = contact.hessian * contact.normal[2]  # second fundamental form, in (x, y)
    # horizontal components suffice: the form of a height map is in its parameters x and y
    t, s = contact.along[:2], contact.across[:2]
    k_tt, k_tl, k_ll = -t.T @ second @ t, -t.T @ second @ s, -s.T @ second @ s
    outward = -ca.dot(contact.normal, contact.axle), contact.uprightness
    r, (_, rho) = wheel.section.tread_radius(*outward), wheel.section.profile(*outward)
    across = 1 + r * k_ll
    k_wheel = contact.uprightness / rho
    return ca.fmin(k_wheel + k_tt - r * k_tl**2 / across, across / wheel.radius)
