"""What the models of a vehicle's motion share: poses, rates, outputs, limits and sizes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import casadi as ca
import numpy as np

from slipfree.contact.closure import ContactFrame, relative_curvature, wheel_coordinates
from slipfree.dae import Labels, Limit
from slipfree.geometry.frame import Pose, platform, quaternion
from slipfree.lookups import LookupTable, lookup_function
from slipfree.models.records import (
    Algebraic,
    Configuration,
    Dependent,
    ForceOutputs,
    Inputs,
    Outputs,
    Rates,
    SlipLaw,
    kept,
)
from slipfree.models.slip import least_slip
from slipfree.records import Array, Label, leaves, pack
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

Domain = tuple[float, float, float, float]
FLAT = 0.1  # a wheel whose axle is within asin(0.1) = 6 degrees of the normal lies flat
OVERTURNED = 0.1  # likewise for the platform's up axis and the horizontal


def carriers(vehicle: Vehicle, x: Configuration, position: Dependent) -> tuple[Pose, ...]:
    """Return the poses of the wheels' carriers, at the wheels' centres."""
    base = platform(x.x, x.y, position.z, x.heading, position.roll, position.pitch)
    return vehicle.carriers(base, values_of(vehicle, x, position))


def values_of(vehicle: Vehicle, x: Configuration, position: Dependent) -> dict[str, ca.SX]:
    """Return the values of all coordinates by name. [rad, m]."""
    names = (*kept(vehicle), *(c.name for c in vehicle.of("suspension")))
    return dict(zip(names, (*x.joints, *position.suspension), strict=True))


def spins(vehicle: Vehicle, rates: Rates, u: Inputs) -> list[ca.SX]:
    """Return the rates of all wheels, driven or free. [rad/s]."""
    driven, free = iter(u.wheels), iter(rates.free)
    return [next(driven) if wheel.driven else next(free) for wheel in vehicle.wheels]


def joint_rates(vehicle: Vehicle, rates: Rates, u: Inputs) -> tuple[ca.SX, ...]:
    """Return the rates of the joints that are states, commanded or passive. [rad/s, m/s]."""
    commanded, passive = iter(u.joints), iter(rates.passive)
    kinds = [c.kind for c in vehicle.coordinates if c.kind != "suspension"]
    return tuple(next(commanded) if kind == "commanded" else next(passive) for kind in kinds)


def outputs(
    terrain: Terrain,
    poses: tuple[Pose, ...],
    contacts: list[ContactFrame],
    slips: list[ca.SX],
    wheel_rates: list[ca.SX],
    x: Configuration,
    z: Algebraic,
    forces: ForceOutputs | tuple[()],
) -> Outputs:
    """Return what is sampled along a motion, in map coordinates."""
    o_x, o_y, o_z = terrain.origin
    base = platform(x.x, x.y, z.position.z, x.heading, z.position.roll, z.position.pitch).rotation
    on_wheels = zip(
        *(wheel_coordinates(*each) for each in zip(poses, contacts, strict=True)), strict=True
    )
    wheel_u, wheel_v, psi = (tuple(values) for values in on_wheels)
    forward_left_up = ca.horzcat(base[:, 1], -base[:, 0], base[:, 2])
    return Outputs(
        contact_z=tuple(c.point[2] + o_z for c in contacts),
        center_x=tuple(c.origin[0] + o_x for c in poses),
        center_y=tuple(c.origin[1] + o_y for c in poses),
        center_z=tuple(c.origin[2] + o_z for c in poses),
        slip_along=tuple(ca.dot(c.along, s) for c, s in zip(contacts, slips, strict=True)),
        slip_across=tuple(ca.dot(c.across, s) for c, s in zip(contacts, slips, strict=True)),
        wheel_rate=tuple(wheel_rates),
        wheel_u=wheel_u,
        wheel_v=wheel_v,
        psi=psi,
        yaw=ca.atan2(base[1, 1], base[0, 1]),
        quaternion=tuple(ca.vertsplit(quaternion(forward_left_up))),
        forces=forces,
    )


def touch_function(
    x: Configuration,
    z: Algebraic,
    poses: tuple[Pose, ...],
    contacts: list[ContactFrame],
    lookups: LookupTable,
) -> list[ca.Function]:
    """Return, for every wheel, centre, rotation and contact point as functions of the states."""
    inputs, found = [pack(x), pack(z)], lookups.lookups
    return [
        lookup_function(
            found, "wheel", inputs, [carrier.origin, ca.vec(carrier.rotation), contact.point]
        )
        for carrier, contact in zip(poses, contacts, strict=True)
    ]


def stops(vehicle: Vehicle, x: Configuration, z: Algebraic) -> Iterator[Limit]:
    """Yield the limits that concern the vehicle alone."""
    values = values_of(vehicle, x, z.position)
    for c in vehicle.coordinates:
        if not c.bump and (np.isfinite(c.lower) or np.isfinite(c.upper)):
            words = f"the stop of {c.name} ({c.words}) is reached"
            yield Limit(
                Label(f"{c.name}_stop", vehicle.unit(c.name), words),
                values[c.name],
                c.lower,
                c.upper,
            )
    upright = ca.cos(z.position.roll) * ca.cos(z.position.pitch)
    words = "the platform is overturned (cosine of its inclination)"
    yield Limit(Label("upright", "1", words), upright, OVERTURNED, np.inf)


def contact_limits(
    vehicle: Vehicle, terrain: Terrain, contacts: list[ContactFrame]
) -> Iterator[Limit]:
    """Yield the limits of every wheel on the ground."""
    for wheel, contact in zip(vehicle.wheels, contacts, strict=True):
        if np.isfinite(terrain.domain).all():
            inside = margin_to(terrain, terrain.domain, contact)
            words = f"wheel {wheel.name} leaves the map, which reaches {reach(terrain.domain)}"
            yield Limit(Label("map_margin", "m", words, wheel.name), inside, 0.0, np.inf)
        words = f"wheel {wheel.name} lies flat on the ground (sine of axle to normal)"
        label = Label("uprightness", "1", words, wheel.name)
        yield Limit(label, contact.uprightness, FLAT, np.inf)
        words = (
            f"the ground under wheel {wheel.name} is more concave than the wheel, so that its "
            "contact is not unique; terrain.rolled(radius) gives the ground as the wheel feels it "
            "(relative curvature)"
        )
        label = Label("relative_curvature", "m-1", words, wheel.name)
        yield Limit(label, relative_curvature(wheel, contact), 0.0, np.inf)


def margin_to(terrain: Terrain, domain: Domain, contact: ContactFrame) -> ca.SX:
    """Return the distance of a contact to the edge of a domain in map coordinates. [m]."""
    west, east, south, north = domain
    o_x, o_y, _ = terrain.origin
    u_g, v_g = contact.point[0], contact.point[1]
    return ca.fmin(
        ca.fmin(u_g - (west - o_x), (east - o_x) - u_g),
        ca.fmin(v_g - (south - o_y), (north - o_y) - v_g),
    )


def reach(domain: Domain) -> str:
    """Return from where to where a domain reaches, in words."""
    west, east, south, north = domain
    return (
        f"from {west:.2f} to {east:.2f} m in x and from {south:.2f} to {north:.2f} m in y "
        "(distance to its edge)"
    )


def sizes(vehicle: Vehicle, terrain: Terrain, labels: Labels) -> tuple[Array, tuple[Array, Array]]:
    """Return typical sizes of z, and what leads from local to map coordinates."""
    radius = min(wheel.radius for wheel in vehicle.wheels)
    typical = {"m": radius, "m s-1": radius, "N": vehicle.weight}
    scale = np.array([typical.get(each.unit, 1.0) for each in leaves(labels.z)])
    place = dict(zip(("x", "y", "z"), terrain.origin, strict=True))
    place |= {f"contact_{axis}": place[axis] for axis in ("x", "y")}
    shift = tuple(
        np.array([place.get(each.name, 0.0) for each in leaves(record)])
        for record in (labels.x, labels.z)
    )
    return scale, (shift[0], shift[1])


def extent(vehicle: Vehicle) -> float:
    """Return the largest coordinate of a wheel's centre from the platform's; at least a radius.

    It is the size of the vehicle, in which its models count lengths. [m]
    """
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    poses = vehicle.carriers(rest, {c.name: ca.SX(0) for c in vehicle.coordinates})
    arms = [float(np.abs(np.array(ca.evalf(pose.origin))).max()) for pose in poses]
    return max(*arms, *(wheel.radius for wheel in vehicle.wheels))


def at_rest(vehicle: Vehicle, labels: Any) -> ca.SX:
    """Return a first guess of rates and forces: none, but that every wheel bears its share."""
    share = vehicle.weight / len(vehicle.wheels)
    return ca.SX([share if each.name == "force_normal" else 0.0 for each in leaves(labels)])


def balance(law: SlipLaw, slips: list[ca.SX], contacts: list[ContactFrame], rates: Rates) -> ca.SX:
    """Return the equations for the rates: least slip, or none."""
    if law == "rolling":
        return ca.vertcat(*slips)
    normals = [contact.normal for contact in contacts]
    return least_slip(slips, normals, pack(rates.motion), pack(rates.multipliers))
