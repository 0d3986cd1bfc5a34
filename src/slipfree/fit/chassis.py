"""Wheels of a vehicle for the force balance, and vehicles with fitted numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import casadi as ca
import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.fit.force_balance import Chassis
from slipfree.geometry.frame import Vector, elements, unit_vector
from slipfree.vehicle.sections import Disc, Omni, Section, Sphere, Torus
from slipfree.vehicle.tree import Vehicle, body_inertia
from slipfree.vehicle.wheel import Wheel, wheel_inertia


def chassis_of(vehicle: Vehicle, signals: Sequence[int], joints: Mapping[str, Array]) -> Chassis:
    """Return positions and rolling directions of the wheels of a vehicle on level ground.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle. Wheels on passive joints swivel without friction; other joints are at zero.
    signals : sequence of int
        Index of the input that drives each wheel; -1 for wheels that roll freely.
    joints : mapping of arrays, shape (r,)
        Values of commanded joints, by name. [rad or m]
    """
    names = [each.name for each in vehicle.coordinates]
    values = ca.SX.sym("values", len(names))
    poses = vehicle.carriers(values={name: values[k] for k, name in enumerate(names)})
    axles = [unit_vector(wheel.axle) for wheel in vehicle.wheels]
    rows = [
        ca.vertcat(pose.origin[:2], (pose.rotation @ ca.DM(list(axle)))[:2])
        for pose, axle in zip(poses, axles, strict=True)
    ]
    suspension = [k for k, each in enumerate(vehicle.coordinates) if each.kind == "suspension"]
    heights = ca.vertcat(*(pose.origin[2] for pose in poses))
    lift = ca.densify(ca.jacobian(heights, values)[:, suspension])
    function = ca.Function("wheels", [values], [ca.horzcat(*rows)])
    passive = [k for k, each in enumerate(vehicle.coordinates) if each.kind == "passive"]
    count = max((each.size for each in joints.values()), default=1)
    table = np.zeros((len(names), count))
    for name, own in joints.items():
        table[names.index(name)] = own
    x, y, ax, ay = np.array([function(column).full() for column in table.T]).transpose(1, 2, 0)
    moving = ca.which_depends(ca.vertcat(*rows), values[passive], 1, True) if passive else ()
    swivels = np.reshape(moving, (-1, 4)).any(axis=1) if passive else np.zeros(len(rows), bool)
    # The axle points to the right: the rolling direction is the axle turned by 90 degrees.
    direction = (ax + 1j * ay) / np.hypot(ax, ay)
    place = y - 1j * x
    is_driven = np.array(signals) >= 0
    rollers = np.array([wheel.section.rollers or 0.0 for wheel in vehicle.wheels])
    turned = direction * np.exp(1j * rollers)[:, None]
    is_free = (rollers != 0) | ~is_driven
    return Chassis(
        place,
        direction,
        np.where(is_free[:, None], turned, 0),
        np.maximum(signals, 0),
        np.where(swivels, 0.0, [float(wheel.grip) for wheel in vehicle.wheels]),
        ca.DM(ca.Function("lift", [values], [lift])(table[:, 0])).full(),
    )


def track(vehicle: Vehicle) -> float:
    """Return the lateral distance between the outermost wheels' centres, joints at zero [m]."""
    return float(np.ptp(vehicle.centers[:, 0]))


def with_dimensions(
    vehicle: Vehicle,
    radii: Mapping[str, float],
    width: float | None = None,
    center: Mapping[int, float] = MappingProxyType({}),
    gyration: float | None = None,
) -> Vehicle:
    """Return a vehicle with other dimensions.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle.
    radii : mapping of float
        Rolling radii, by wheel. [m]
    width : float, optional
        Track; all lateral distances between joints and wheels grow with it. [m]
    center : mapping of float
        Coordinates 0 and 1 of the centre of all masses, to which the platform's is moved. [m]
    gyration : float, optional
        Moment of inertia about the vertical over mass, of which the platform has what other parts
        leave; its other moments are scaled alike. [m^2]

    Raises
    ------
    ModelError
        If a wheel has no radius that can be changed, or other parts exceed the moment of inertia.
    """
    factor = 1.0 if width is None else width / track(vehicle)

    def wider(at: Vector) -> Vector:
        return at[0] * factor, at[1], at[2]

    def changed(wheel: Wheel) -> Wheel:
        own = replace(wheel, at=wider(wheel.at))
        if wheel.name not in radii:
            return own
        return replace(own, section=_section(wheel.section, radii[wheel.name], wheel.name))

    found = replace(
        vehicle,
        joints=tuple(replace(joint, at=wider(joint.at)) for joint in vehicle.joints),
        wheels=tuple(map(changed, vehicle.wheels)),
    )
    body, own = found.body, found.body.mass
    if not own or not (center or gyration):
        return found
    others = [*replace(found, body=replace(body, mass=0.0)).masses()]
    masses = np.array([own, *(mass for _, mass, _ in others)])
    places = np.array([body.at, *(ca.evalf(place).full().ravel() for *_, place in others)])
    wanted = masses @ places / masses.sum()
    for k, value in center.items():
        places[0, k] += (value - wanted[k]) * masses.sum() / own
        wanted[k] = value
    found = replace(found, body=replace(body, at=tuple(places[0].tolist())))
    if gyration is None:
        return found
    squares = ((places - wanted)[:, :2] ** 2).sum(axis=1)
    spins = [body_inertia(found, joint.name)[2, 2] for joint in found.joints if joint.body.mass]
    spins += [wheel_inertia(wheel)[1] for wheel in found.wheels]
    spin = gyration * masses.sum() - masses @ squares - sum(spins)
    if spin <= 0:
        raise ModelError(
            f"vehicle: expected a moment of inertia over mass above "
            f"{gyration - spin / masses.sum():.3g} "
            f"m^2, that of the other parts, found {gyration:.3g} m^2; reduce their masses, or set "
            "'constants.gyration'"
        )
    old = body_inertia(found, "platform")  # a body can have moments of the same shape
    return replace(found, body=replace(found.body, inertia=elements(old * (spin / old[2, 2]))))


def _section(section: Section, radius: float, name: str) -> Section:
    """Return a section with another rolling radius and the same tube."""
    if isinstance(section, Omni):
        return replace(section, rim=_section(section.rim, radius, name))
    if section.torus_radii is None:
        raise ModelError(
            f"wheel {name!r}: expected a torus, disc or sphere, whose radius can be fitted, found "
            f"{section}"
        )
    tube, circle = section.torus_radii
    if tube and circle:
        return Torus(tube, radius - tube)
    return Disc(radius) if circle else Sphere(radius)
