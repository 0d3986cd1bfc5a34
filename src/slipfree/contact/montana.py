"""Contact of a wheel with the ground at rate level: Montana's contact equations [1]_.

Five contact coordinates determine the pose of a wheel that touches the ground: the contact point on
the ground ``u_g, v_g``, the contact point on the wheel ``u_w, v_w``, and the angle ``psi`` between
the two Gauss frames. The equations give their rates from the twist of the wheel [2]_. They need the
curvature of the tread, hence a wheel section without edges.

References
----------
.. [1] D. J. Montana, "The kinematics of contact and grasp", Int. J. Robotics Research 7(3), 1988.
.. [2] N. Chakraborty and A. Ghosal, "Kinematics of wheeled mobile robots on uneven terrain",
       section 2.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca

from slipfree.core.lookups import LookupTable
from slipfree.geometry.frame import Pose
from slipfree.geometry.surface import Forms, Patch, inverse, patch, patch_of
from slipfree.terrain.base import Jet, Terrain
from slipfree.vehicle.wheel import Wheel


class ContactCoordinates(NamedTuple):
    """Coordinates of a contact on both surfaces, and the angle between their Gauss frames.

    Attributes
    ----------
    x, y : SX
        Coordinates ``u_g, v_g`` of the contact on the ground. [m]
    u, v : SX
        Coordinates ``u_w, v_w`` of the contact on the wheel, see ``Section.point``. [rad]
    psi : SX
        Angle from the wheel's Gauss x axis to the ground's, about the ground's normal. [rad]
    """

    x: Any
    y: Any
    u: Any
    v: Any
    psi: Any


class Pair(NamedTuple):
    """Surfaces of a wheel and of the ground at their contact point.

    Attributes
    ----------
    wheel, ground : Patch
        The wheel's surface in the axes of the wheel, and the ground in fixed axes.
    psi : SX, shape (1, 1)
        Angle from the wheel's Gauss x axis to the ground's. [rad]
    """

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
    """Return the ground ``c(x, y) = (x, y, h)`` as a surface patch at a point."""
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
    """Time derivatives of the contact coordinates.

    Attributes
    ----------
    wheel, ground : SX, shape (2, 1)
        Rates of the parameters of the two surfaces. [1/s times their unit]
    psi : SX, shape (1, 1)
        Rate of the angle between the Gauss frames. [rad/s]
    """

    wheel: ca.SX
    ground: ca.SX
    psi: ca.SX


def contact_rates(wheel: Forms, ground: Forms, psi: ca.SX, v: ca.SX, omega: ca.SX) -> ContactRates:
    """Return the rates of the contact coordinates by eq. 2 of Chakraborty and Ghosal.

    The forms differ from those in the paper: its ``K`` and ``T`` lack the factors ``1/|c_u|`` and
    ``1/|c_v|``, and its diagonal ``M`` is wrong on a height map
    (``test_surface.py``: ``test_printed_forms_fail``).

    Parameters
    ----------
    wheel, ground : Forms
        Forms of the two surfaces at the contact point.
    psi : SX, shape (1, 1)
        Angle from the wheel's Gauss x axis to the ground's. [rad]
    v, omega : SX, shape (3, 1)
        Velocity of the wheel's material point at the contact, and angular velocity of the wheel,
        relative to the ground and in the wheel's Gauss frame; ``v[2]`` is zero. [m/s, rad/s]
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
