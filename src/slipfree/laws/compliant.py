"""Compliant contact: normal force by Hunt and Crossley, regularised Coulomb friction.

With the depth ``d`` of a wheel below the ground, the normal force is
``N = k max(d, 0) max(0, 1 + c d')``, and the friction force is
``f = -mu N s / sqrt(|s|^2 + eps^2 + (mu / K)^2)`` for the slip velocity ``s``. A wheel at rest on a
slope therefore creeps.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, sqrt
from typing import Annotated

import casadi as ca
from annotated_types import Ge, Gt, Le, Lt, Unit

from slipfree.core.arguments import checked
from slipfree.laws.coulomb import SlipStiffness, check_friction, squared_creep
from slipfree.laws.protocols import BodyTouch, GroundForce, WheelContact
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle, Wheel

SMALLEST_SPEED = 1e-12  # added to speeds under a root, whose derivative is then finite [m/s]


@checked
@dataclass(frozen=True)
class Compliant:
    """Compliant contact of wheels with the ground, for dynamics.

    The stiffness of a wheel's contact is its share ``W / n`` of the vehicle's weight over its
    static depth ``d_0`` (``Wheel.static_depth``); the damping constant is
    ``c = 2 damping_ratio / sqrt(g d_0)``.

    Attributes
    ----------
    damping_ratio : float
        Damping ratio of the vertical oscillation of the vehicle on its wheels. [1]
    creep : float
        Slip velocity ``eps`` at which a wheel transmits 71 % of the friction limit. [m/s]
    sliding : float
        Ratio of the friction at fast slip to the friction at slow slip (Stribeck effect). [1]
    stribeck_speed : float
        Slip velocity at which friction has made 63 % of the change from slow to fast slip. [m/s]
    body_depth : float
        Depth of a point of a body, such as a corner of a box, in the ground under the weight of the
        vehicle; zero to end the motion where a body touches the ground. [m]
    slip_stiffness : float
        Slip stiffness ``K``: force over normal force and slip velocity, at slow slip. [s/m]

    Raises
    ------
    ModelError
        If a number is outside its bounds.
    """

    damping_ratio: Annotated[float, Ge(0), Le(10), Unit("1")] = 0.5
    creep: Annotated[float, Gt(0), Le(1), Unit("m/s")] = 1e-3
    sliding: Annotated[float, Gt(0), Le(1), Unit("1")] = 1.0
    stribeck_speed: Annotated[float, Gt(0), Unit("m/s")] = 0.01
    body_depth: Annotated[float, Ge(0), Lt(inf), Unit("m")] = 0.0
    slip_stiffness: SlipStiffness = inf

    def check(self, vehicle: Vehicle, terrain: Terrain) -> None:  # noqa: ARG002 - of the protocol
        """Check that the law suits a vehicle and a ground.

        Raises
        ------
        ModelError
            If the ground has no coefficient of friction.
        """
        check_friction("dynamics", terrain)

    def static_depth(self, wheel: Wheel, load: float) -> float:  # noqa: ARG002 - of the protocol
        """Return the depth of a wheel at rest, which determines the stiffness of its contact.

        Parameters
        ----------
        wheel : Wheel
            The wheel, with its own static depth.
        load : float
            Not used: the stiffness is that which bears the load at this depth. [N]

        Returns
        -------
        float
            The wheel's ``depth``. [m]
        """
        return wheel.depth

    def max_depth(self, wheel: Wheel) -> float:  # noqa: ARG002 - of the protocol
        """Return the depth up to which the law is valid.

        Returns
        -------
        float
            Infinity, for every wheel. [m]
        """
        return inf

    def force(self, contact: WheelContact) -> GroundForce:
        """Return the force of the ground on a wheel.

        Parameters
        ----------
        contact : WheelContact
            Contact and motion of the wheel.
        """
        touch, slip, depth = contact.touch, contact.slip, contact.wheel.depth
        at = BodyTouch(
            touch.gap, touch.frame.normal, slip, touch.friction, contact.share, contact.gravity
        )
        return self._force(at, depth)

    @property
    def bears_bodies(self) -> bool:
        """Whether bodies bear load."""
        return self.body_depth > 0

    def body_force(self, touch: BodyTouch) -> GroundForce:
        """Return the force of the ground on a point of a body.

        Parameters
        ----------
        touch : BodyTouch
            Contact and motion of the point.
        """
        return self._force(touch, self.body_depth)

    def _force(self, touch: BodyTouch, depth: float) -> GroundForce:
        """Return the force on a point that is at a depth under the weight of its contact."""
        stiffness = touch.weight / depth
        damping = 2 * self.damping_ratio / sqrt(touch.gravity * depth)
        separating = ca.dot(touch.normal, touch.slip)
        elastic = stiffness * ca.fmax(-touch.gap, 0)
        load = elastic * ca.fmax(0, 1 - damping * separating)
        tangential = touch.slip - separating * touch.normal
        squared_slip = ca.sumsqr(tangential)
        friction = touch.friction
        squared_creep_speed = squared_creep(self.creep, self.slip_stiffness, friction)
        if self.sliding < 1:
            speed = ca.sqrt(squared_slip + SMALLEST_SPEED**2)
            slow = ca.exp(-((speed / self.stribeck_speed) ** 2))
            friction *= self.sliding + (1 - self.sliding) * slow
        friction_force = -friction * load / ca.sqrt(squared_slip + squared_creep_speed) * tangential
        return GroundForce(load, friction_force, elastic, ca.SX(0))
