"""Inertia tensors of the parts and wheels of a vehicle, given or estimated."""

from __future__ import annotations

import numpy as np

from slipfree.core.records import Array
from slipfree.geometry.tensor import tensor
from slipfree.vehicle.tree import Body, Vehicle
from slipfree.vehicle.wheel import Wheel


def body_inertia(vehicle: Vehicle, part: str) -> Array:
    """Return the inertia tensor of a part about its centre of mass, shape (3, 3) [kg m^2].

    The tensor is in the part's axes, without the wheels. If the part has no given inertia, it is
    that of a homogeneous box with the extent of the part: its origin, its centre of mass, the
    joints and the wheels that it carries. No side is shorter than the smallest wheel radius.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    part : str
        Name of a joint, or ``"platform"``.
    """
    body = body_of(vehicle, part)
    if body.inertia is not None:
        return tensor(body.inertia)
    places = [(0.0, 0.0, 0.0), body.at]
    places += [joint.at for joint in vehicle.joints if joint.parent == part]
    places += [wheel.at for wheel in vehicle.wheels if wheel.parent == part]
    sides = np.maximum(np.ptp(places, axis=0), min(wheel.radius for wheel in vehicle.wheels))
    return np.asarray(body.mass / 12 * np.diag((sides**2).sum() - sides**2))


def body_of(vehicle: Vehicle, part: str) -> Body:
    """Return the body of a joint, or of the platform."""
    if part == "platform":
        return vehicle.body
    return next(joint.body for joint in vehicle.joints if joint.name == part)


def wheel_inertia(wheel: Wheel) -> tuple[float, float]:
    """Return the moments of inertia of a wheel about its axle and across it [kg m^2].

    Without given numbers they are those of a homogeneous cylinder of the wheel's radius and width.
    """
    if wheel.inertia is not None:
        return wheel.inertia
    axial = wheel.mass * wheel.radius**2 / 2
    return axial, axial / 2 + wheel.mass * wheel.half_width**2 / 3
