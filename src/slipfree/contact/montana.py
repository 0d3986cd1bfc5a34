"""Contact of a wheel with the ground at rate level: Montana's contact equations [1]_.

Five contact coordinates determine the pose of a wheel that touches the ground: the contact point on
the ground ``u_g, v_g``, the contact point on the wheel ``u_w, v_w``, and the angle ``psi`` between
the two Gauss frames. The equations give their rates from the twist of the wheel [2]_. They need the
curvature of the tread, hence a wheel section without edges.

The forms of a parametrised surface ``c(u, v)`` are those of [1]_, section 2, for a Gauss frame from
Gram-Schmidt orthogonalisation; they also hold where ``c_u`` and ``c_v`` are not orthogonal, as on a
height map.

References
----------
.. [1] D. J. Montana, "The kinematics of contact and grasp", Int. J. Robotics Research 7(3), 1988,
       pp. 17-32.
.. [2] N. Chakraborty and A. Ghosal, "Kinematics of wheeled mobile robots on uneven terrain",
       section 2.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca

from slipfree.core.lookups import LookupTable
from slipfree.geometry.frame import Pose
from slipfree.terrain.base import Jet, Terrain
from slipfree.vehicle.wheel import Wheel


class Forms(NamedTuple):
    """Metric, curvature and torsion forms of a surface at a point.

    Upper triangular ``M`` in ``[c_u c_v] = [x y] M`` [m per unit of u, v], ``K = [x y]' [n_u n_v]
    M^-1``, positive where the surface bends away from ``n`` [1/m], and ``T = y' [x_u x_v] M^-1``
    [1/m].
    """

    metric: ca.SX
    curvature: ca.SX
    torsion: ca.SX


class Patch(NamedTuple):
    """Point of a surface, its Gauss frame ``[x y n]`` and its forms in that frame.

    ``x`` is along ``c_u``, ``n`` along ``c_u x c_v``.
    """

    point: ca.SX
    frame: ca.SX
    forms: Forms


def patch(c: ca.SX, uv: ca.SX) -> Patch:
    """Return the Gauss frame and the forms of a regular surface at its point ``c(uv)``."""
    c_u, c_v = ca.horzsplit(ca.densify(ca.jacobian(c, uv)))
    c_uu, c_uv = ca.horzsplit(ca.densify(ca.jacobian(c_u, uv)))
    c_vv = ca.densify(ca.jacobian(c_v, uv[1]))
    return patch_of(c, (c_u, c_v), (c_uu, c_uv, c_vv))


def patch_of(c: ca.SX, tangents: tuple[ca.SX, ca.SX], seconds: tuple[ca.SX, ca.SX, ca.SX]) -> Patch:
    """Return the Gauss frame and the forms of a surface from its derivatives at a point.

    ``tangents`` are ``c_u, c_v``, ``seconds`` are ``c_uu, c_uv, c_vv``. The frame is not
    differentiated, since ``n`` is normal to ``c_u`` and ``c_v``, and ``y`` to ``c_u``: ``K = -M^-T
    II M^-1`` with the second fundamental form ``II = n . [c_uu c_uv; c_uv c_vv]``, and ``y . x_u =
    y . c_uu / |c_u|``.
    """
    (c_u, c_v), (c_uu, c_uv, c_vv) = tangents, seconds
    area = ca.cross(c_u, c_v)
    x, n = c_u / ca.norm_2(c_u), area / ca.norm_2(area)
    y = ca.cross(n, x)
    metric = ca.blockcat([[ca.norm_2(c_u), ca.dot(x, c_v)], [0, ca.dot(y, c_v)]])
    to_arc = inverse(metric)
    across = ca.dot(n, c_uv)
    second = ca.blockcat([[ca.dot(n, c_uu), across], [across, ca.dot(n, c_vv)]])
    turning = ca.horzcat(ca.dot(y, c_uu), ca.dot(y, c_uv)) / metric[0, 0]
    forms = Forms(metric, -to_arc.T @ second @ to_arc, turning @ to_arc)
    return Patch(c, ca.horzcat(x, y, n), forms)


def inverse(matrix: ca.SX) -> ca.SX:
    """Return the inverse of a matrix of shape (2, 2)."""
    (a, b), (c, d) = (ca.horzsplit(row) for row in ca.vertsplit(matrix))
    return ca.blockcat([[d, -b], [-c, a]]) / (a * d - b * c)


class ContactCoordinates(NamedTuple):
    """Coordinates of a contact on both surfaces, and the angle between their Gauss frames.

    ``x, y`` are ``u_g, v_g`` on the ground [m], ``u, v`` are ``u_w, v_w`` on the wheel, see
    ``Section.point`` [rad], ``psi`` is the angle from the wheel's Gauss x axis to the ground's,
    about the ground's normal [rad].
    """

    x: Any
    y: Any
    u: Any
    v: Any
    psi: Any


class Pair(NamedTuple):
    """Surfaces of a wheel, in its axes, and of the ground at their contact, and the angle psi."""

    wheel: Patch
    ground: Patch
    psi: ca.SX

    @property
    def frame(self) -> ca.SX:
        """The wheel's Gauss frame in fixed axes, shape (3, 3)."""
        return self.ground.frame @ alignment(self.psi)

    @property
    def pose(self) -> Pose:
        """Pose of the wheel, with coincident contact points and opposite normals."""
        rotation = self.frame @ self.wheel.frame.T
        return Pose(rotation, self.ground.point - rotation @ self.wheel.point)


def pair(wheel: Wheel, terrain: Terrain, at: ContactCoordinates, lookups: LookupTable) -> Pair:
    """Return the surfaces of wheel and ground at a contact, in local coordinates."""
    tread = patch(wheel.section.point(at.u, at.v), ca.vertcat(at.u, at.v))
    return Pair(tread, _ground(terrain.jet(at.x, at.y, lookups), at.x, at.y), at.psi)


def _ground(jet: Jet, x: ca.SX, y: ca.SX) -> Patch:
    h, (h_x, h_y), hessian = jet.height, ca.vertsplit(jet.gradient), jet.hessian
    tangents = ca.vertcat(1, 0, h_x), ca.vertcat(0, 1, h_y)
    h_xx, h_xy, h_yy = (ca.vertcat(0, 0, hessian[k]) for k in (0, 1, 3))
    return patch_of(ca.vertcat(x, y, h), tangents, (h_xx, h_xy, h_yy))


def alignment(psi: ca.SX) -> ca.SX:
    """Return the wheel's Gauss frame in the axes of the ground's Gauss frame, shape (3, 3).

    The matrix is symmetric.
    """
    c, s = ca.cos(psi), ca.sin(psi)
    return ca.blockcat([[c, -s, 0], [-s, -c, 0], [0, 0, -1]])


class ContactRates(NamedTuple):
    """Time derivatives of the parameters of the two surfaces (2, 1), and of psi [rad/s]."""

    wheel: ca.SX
    ground: ca.SX
    psi: ca.SX


def contact_rates(wheel: Forms, ground: Forms, psi: ca.SX, v: ca.SX, omega: ca.SX) -> ContactRates:
    """Return the rates of the contact coordinates by eq. 2 of Chakraborty and Ghosal.

    The forms differ from those in the paper: its ``K`` and ``T`` lack the factors ``1/|c_u|`` and
    ``1/|c_v|``, and its diagonal ``M`` is wrong on a height map (``test_surface.py``:
    ``test_printed_forms_fail``). ``v`` and ``omega`` are the velocity of the wheel's material point
    at the contact and the angular velocity of the wheel, relative to the ground and in the wheel's
    Gauss frame; ``v[2]`` is zero [m/s, rad/s].
    """
    turn = alignment(psi)[:2, :2]
    from_ground = turn @ ground.curvature @ turn
    relative = inverse(wheel.curvature + from_ground)
    rolling = ca.vertcat(-omega[1], omega[0])
    arc_w = relative @ (rolling - from_ground @ v[:2])
    arc_g = turn @ relative @ (rolling + wheel.curvature @ v[:2])
    return ContactRates(
        inverse(wheel.metric) @ arc_w,
        inverse(ground.metric) @ arc_g,
        omega[2] + wheel.torsion @ arc_w + ground.torsion @ arc_g,
    )
