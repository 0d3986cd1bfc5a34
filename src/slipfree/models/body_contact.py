"""Contact of a vehicle's bodies with the ground in dynamics, at points of their shapes.

The corners of a box and the middles of its edges and faces, the points of a hull and the lowest
point of a ball may press into the ground, with the normal force and the friction of the law. Ground
that rises between these points is not felt; the clearance of the body then is negative.

The gap of a point is its height above the ground below it times the vertical component of the
ground's normal there: the distance on a plane, and in general up to a relative error of the order
of gap times curvature.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import product
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.nearest_points import frame_of
from slipfree.core.errors import ModelError
from slipfree.core.lookups import LookupTable
from slipfree.geometry.frame import Pose, translation
from slipfree.laws.protocols import BodyLaw, BodyTouch, ContactLaw, GroundForce
from slipfree.models.multibody import Load, Multibody
from slipfree.terrain.base import Terrain
from slipfree.vehicle.shapes import Ball, BodyShape, Box, Hull
from slipfree.vehicle.tree import Vehicle

MAX_POINTS = 200  # each adds a lookup of the ground


class BodyContact(NamedTuple):
    """Contact of a point of a body; ``arm`` is from the platform's origin [m]."""

    part: str
    touch: BodyTouch
    arm: ca.SX
    force: GroundForce

    @property
    def load(self) -> Load:
        """Force of the ground on the part, and its moment about the platform's origin."""
        force = self.force.normal * self.touch.normal + self.force.tangential
        return Load(self.part, force, ca.cross(self.arm, force))

    @property
    def energy(self) -> ca.SX:
        """Elastic energy of the contact [J]."""
        return self.force.elastic * ca.fmax(-self.touch.gap, 0) / 2

    @property
    def dissipation(self) -> ca.SX:
        """Power that the contact dissipates [W]."""
        away = ca.dot(self.touch.normal, self.touch.slip)
        return self.force.elastic * away - ca.dot(self.load.force, self.touch.slip)


def body_contacts(
    vehicle: Vehicle, terrain: Terrain, law: ContactLaw, body: Multibody, lookups: LookupTable
) -> tuple[BodyContact, ...]:
    """Return the contacts of a vehicle's bodies; none if the law lets them end the motion."""
    if not (isinstance(law, BodyLaw) and law.bears_bodies):
        return ()
    points = [(part, *each) for part, shape in vehicle.shapes for each in _points(shape)]
    if len(points) > MAX_POINTS:
        raise ModelError(
            f"dynamics: expected shapes with at most {MAX_POINTS} points, 26 of each box, found "
            f"{len(points)} in {vehicle.name!r}; simplify the shapes, or set 'body_depth' of the "
            "law to 0, with which the motion ends where a body touches the ground"
        )
    contacts = list[BodyContact]()
    for part, frame, radius in points:
        motion = body.parts[part].at(body.parts[part].pose @ frame)
        x, y, z = ca.vertsplit(motion.pose.origin)
        height, gradient, _ = terrain.jet(x, y, lookups)
        normal = ca.vertcat(-gradient, 1) / ca.sqrt(1 + ca.sumsqr(gradient))
        gap = (z - height) * normal[2] - radius
        place = motion.pose.origin - radius * normal
        slip = motion.at(Pose(motion.pose.rotation, place)).velocity
        friction = terrain.friction(x, y, lookups)
        touch = BodyTouch(gap, normal, slip, friction, vehicle.weight, vehicle.gravity)
        contacts.append(BodyContact(part, touch, place - body.origin, law.body_force(touch)))
    return tuple(contacts)


def _points(shape: BodyShape) -> Sequence[tuple[Pose, float]]:
    """Return the poses of the points of a shape in its part, and the radius about them [m]."""
    still = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    frame = frame_of(shape, still)
    if isinstance(shape, Ball):
        return [(frame, shape.radius)]
    points: Iterable[Sequence[float]] = shape.points if isinstance(shape, Hull) else []
    if isinstance(shape, Box):
        half = np.array(shape.size) / 2
        points = [(half * signs).tolist() for signs in product((-1, 0, 1), repeat=3) if any(signs)]
    return [(frame @ translation(*point), 0.0) for point in points]
