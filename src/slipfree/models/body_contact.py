"""Contact of a vehicle's bodies with the ground in dynamics, at points of their shapes.

The corners of a box and the middles of its edges and faces, the points of a hull and the lowest
point of a ball may press into the ground, with the normal force and the friction of the law. Ground
that rises between these points is not felt; the clearance of the body then is negative.

The gap of a point is its height above the ground below it times the vertical component of the
ground's normal there: the distance on a plane, and in general up to a relative error of the order
of gap times curvature. For the centre of a ball the error is of the order of
curvature times squared radius times squared slope.

The normal force acts along the gradient of the gap, which differs from the ground's normal by as
much: its work is the change of the elastic energy. A force along the normal would gain or lose
energy where a point slides over curved ground.
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
from slipfree.geometry.frame import FIXED, Pose, translation
from slipfree.laws.protocols import BodyLaw, BodyTouch, ContactLaw, GroundForce
from slipfree.models.multibody import Load, Multibody
from slipfree.terrain.base import Terrain
from slipfree.vehicle.shapes import Ball, BodyShape, Box, Hull
from slipfree.vehicle.tree import Vehicle

MAX_POINTS = 200  # each adds a lookup of the ground


class BodyContact(NamedTuple):
    """Contact of a point of a body: arm from the platform's origin [m], and elastic energy [J]."""

    part: str
    touch: BodyTouch
    arm: ca.SX
    force: GroundForce
    energy: ca.SX

    @property
    def load(self) -> Load:
        """Force of the ground on the part, and its moment about the platform's origin."""
        force = self.force.normal * self.touch.normal + self.force.tangential
        return Load(self.part, force, ca.cross(self.arm, force))

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
        height, gradient, hessian = terrain.jet(x, y, lookups)
        upright = 1 / ca.sqrt(1 + ca.sumsqr(gradient))
        gap = (z - height) * upright - radius
        turning = (z - height) * upright**2 * hessian @ gradient
        slope = upright * ca.vertcat(-gradient - turning, 1)  # gradient of the gap
        steepness = ca.norm_2(slope)
        normal = slope / steepness
        place = motion.pose.origin - radius * normal
        slip = motion.at(Pose(motion.pose.rotation, place)).velocity
        friction = terrain.friction(x, y, lookups)
        # force k d |slope| along the gradient of the elastic energy k d^2 / 2
        weight = steepness * vehicle.weight
        touch = BodyTouch(gap, normal, slip, friction, weight, vehicle.gravity)
        force = law.body_force(touch)
        energy = force.elastic / steepness * ca.fmax(-gap, 0) / 2
        contacts.append(BodyContact(part, touch, place - body.origin, force, energy))
    return tuple(contacts)


def _points(shape: BodyShape) -> Sequence[tuple[Pose, float]]:
    """Return the poses of the points of a shape in its part, and the radius about them [m]."""
    frame = frame_of(shape, FIXED)
    if isinstance(shape, Ball):
        return [(frame, shape.radius)]
    points: Iterable[Sequence[float]] = shape.points if isinstance(shape, Hull) else []
    if isinstance(shape, Box):
        half = np.array(shape.size) / 2
        points = [(half * signs).tolist() for signs in product((-1, 0, 1), repeat=3) if any(signs)]
    return [(frame @ translation(*point), 0.0) for point in points]
