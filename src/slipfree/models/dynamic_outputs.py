"""Outputs of a dynamic model, and the quantities from which its limits are computed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.closure import ContactFrame
from slipfree.contact.solid_touch import tube_radii
from slipfree.contact.touch import Touch
from slipfree.core.dae import Limit
from slipfree.core.lookups import LookupTable
from slipfree.core.records import Label, leaves, unpack
from slipfree.laws.protocols import ContactLaw, GroundForce
from slipfree.models.base import outputs, slip_ratios
from slipfree.models.dynamic_records import (
    DynamicOutputs,
    DynamicState,
    OnSolid,
    output_efforts,
)
from slipfree.models.multibody import Multibody, kinetic_energy
from slipfree.models.quantities import Mechanics, Quantities
from slipfree.models.records import (
    Configuration,
    Dependent,
    ForceOutputs,
    Forces,
    Inputs,
    Rates,
)
from slipfree.models.tip_over import tip_over_margin
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import GRAVITY, Vehicle


class Contact(NamedTuple):
    """Contact of a wheel, and the force of the ground on it.

    Attributes
    ----------
    touch : Touch
        Contact with the ground.
    slip : SX, shape (3, 1)
        Velocity of the wheel's material point at the contact. [m/s]
    spin : SX, shape (1, 1)
        Angular velocity about the axle relative to fixed axes, positive forward. [rad/s]
    force : GroundForce
        Force and moment of the ground on the wheel.
    """

    touch: Touch
    slip: ca.SX
    spin: ca.SX
    force: GroundForce

    @property
    def total(self) -> ca.SX:
        """Force of the ground on the wheel, shape (3, 1) [N]."""
        return self.force.normal * self.touch.frame.normal + self.force.tangential

    def moment(self, center: ca.SX) -> ca.SX:
        """Return the moment of the ground on the wheel about a point, shape (3, 1) [N m]."""
        arm = self.touch.frame.point - center
        return ca.cross(arm, self.total) + self.force.moment * self.touch.frame.axle

    @property
    def energy(self) -> ca.SX:
        """Elastic energy of the contact [J]."""
        return self.force.elastic * ca.fmax(-self.touch.gap, 0) / 2

    @property
    def dissipation(self) -> ca.SX:
        """Power that the contact dissipates [W]."""
        away = ca.dot(self.touch.frame.normal, self.slip)
        braking = self.force.moment * self.spin
        return self.force.elastic * away - ca.dot(self.total, self.slip) + braking


def deepest(contacts: Sequence[Contact]) -> Contact:
    """Return the contact of a wheel that has the smallest gap."""
    found, *others = contacts
    for other in others:
        pairs = zip(leaves(found), leaves(other), strict=True)
        nearer = other.touch.gap < found.touch.gap
        found = unpack(found, [ca.if_else(nearer, new, old) for old, new in pairs])
    return found


class Effort(NamedTuple):
    """Torques of the drives of all wheels [N m], and efforts of commanded coordinates [N m, N]."""

    torques: tuple[ca.SX, ...]
    actuators: tuple[ca.SX, ...]


def quantities(
    vehicle: Vehicle,
    terrain: Terrain,
    x: DynamicState,
    u: Inputs,
    body: Multibody,
    contacts: Sequence[Contact],
    lookups: LookupTable,
) -> Quantities:
    """Return the quantities from which limits and outputs are computed."""
    r = body.parts["platform"].pose.rotation
    values = [(c.kind, value) for c, value in zip(vehicle.coordinates, x.joints, strict=True)]
    place = Configuration(
        x.x,
        x.y,
        ca.atan2(r[1, 0], r[0, 0]),
        tuple(value for kind, value in values if kind != "suspension"),
    )
    position = Dependent(
        x.z,
        ca.asin(ca.fmax(-1, ca.fmin(1, -r[2, 0]))),
        ca.atan2(r[2, 1], r[2, 2]),
        tuple(value for kind, value in values if kind == "suspension"),
        (),
    )
    frames = tuple(each.touch.frame for each in contacts)
    along, across = (
        tuple(ca.dot(axis, c.force.tangential) for axis, c in zip(axes, contacts, strict=True))
        for axes in ([f.along for f in frames], [f.across for f in frames])
    )
    return Quantities(
        vehicle,
        terrain,
        place,
        position,
        _rates(vehicle, x, place, position.roll),
        Forces(along, across, tuple(each.force.normal for each in contacts)),
        u,
        tuple(wheel.motion.pose for wheel in body.wheels),
        frames,
        tuple(each.slip for each in contacts),
        tuple(wheel.rate for wheel in body.wheels),
        _mechanics(vehicle, x, body, contacts),
        tip_over_margin(vehicle, place, position, frames),
        lookups,
    )


def _mechanics(
    vehicle: Vehicle, x: DynamicState, body: Multibody, contacts: Sequence[Contact]
) -> Mechanics:
    """Return friction, weight, energy and damping; the terms of the equilibrium are empty."""
    height = sum(each.mass * each.motion.pose.origin[2] for each in body.bodies)
    loaded = [
        (c, value, rate)
        for c, value, rate in zip(vehicle.coordinates, x.joints, x.joint_speeds, strict=True)
        if c.is_loaded
    ]
    springs = sum(c.potential(value) for c, value, _ in loaded)
    damped = sum(c.damping * rate**2 for c, _, rate in loaded)
    none, friction = ca.SX(0, 0), tuple(each.touch.friction for each in contacts)
    energy = ca.SX(GRAVITY * height + springs)
    return Mechanics(none, none, none, none, friction, vehicle.weight, energy, ca.SX(damped))


def _rates(vehicle: Vehicle, x: DynamicState, place: Configuration, roll: ca.SX) -> Rates:
    """Return the rates of the coordinates of kinematic models."""
    across, along = ca.cos(place.heading), ca.sin(place.heading)
    omega_x, omega_y, omega_z = x.omega
    pitch_rate = (across * omega_x + along * omega_y) / ca.cos(roll)
    kinds = list(zip(vehicle.coordinates, x.joint_speeds, strict=True))
    return Rates(
        x.velocity[0],
        x.velocity[1],
        x.velocity[2],
        omega_z + ca.sin(roll) * pitch_rate,
        across * omega_y - along * omega_x,
        pitch_rate,
        tuple(rate for c, rate in kinds if c.kind == "suspension"),
        tuple(rate for c, rate in kinds if c.kind == "passive"),
        (),
        (),
    )


def limit_quantities(q: Quantities, contacts: Sequence[Contact]) -> Quantities:
    """Return the quantities for limits: wheels in the air satisfy every limit on contacts."""
    frames = list[ContactFrame]()
    for each in contacts:
        frame, on_ground = each.touch.frame, each.touch.gap < 0
        upright = ca.if_else(on_ground, frame.uprightness, 1)
        hessian = ca.if_else(on_ground, frame.hessian, ca.SX.zeros(2, 2))
        frames.append(frame._replace(uprightness=upright, hessian=hessian))
    return q._replace(contacts=tuple(frames))


def dynamic_outputs(
    q: Quantities,
    body: Multibody,
    shown: Sequence[Contact],
    contacts: Sequence[tuple[Contact, ...]],
    forces: ForceOutputs,
) -> DynamicOutputs:
    """Return the outputs of the model; the slip of a wheel in the air is zero.

    ``shown`` is the contact of each wheel with the least gap, ``contacts`` are all contacts.
    """
    o_x, o_y, _ = q.terrain.origin
    normal = q.forces.normal
    slips = tuple(ca.if_else(each.touch.gap < 0, each.slip, 0) for each in shown)
    q = q._replace(slips=slips)
    planar = q.vehicle.planar
    return DynamicOutputs(
        q.x.x if planar else (),
        q.x.heading,
        q.position.roll,
        () if planar else q.position.pitch,
        q.rates.heading,
        q.rates.roll,
        q.rates.pitch,
        tuple(each.point[0] + o_x for each in q.contacts),
        tuple(each.point[1] + o_y for each in q.contacts),
        outputs(q, forces)._replace(
            depth=tuple(-each.touch.gap for each in shown),
            load_share=tuple(each * len(normal) / q.vehicle.weight for each in normal),
            force_normal=normal,
            slip_ratio=slip_ratios(q),
        ),
        kinetic_energy(body),
        sum((each.energy for touching in contacts for each in touching), ca.SX(0)),
        tuple(map(_on_solid, zip(*contacts, strict=True))) if len(contacts[0]) > 1 else (),
    )


def _on_solid(contacts: Sequence[Contact]) -> OnSolid:
    """Return gap, forces and slip of all wheels at one solid."""
    along = [each.touch.frame.along for each in contacts]
    return OnSolid(
        tuple(each.touch.gap for each in contacts),
        tuple(each.force.normal for each in contacts),
        tuple(ca.dot(a, c.force.tangential) for a, c in zip(along, contacts, strict=True)),
        tuple(ca.dot(a, c.slip) for a, c in zip(along, contacts, strict=True)),
    )


def solid_limits(vehicle: Vehicle, contacts: Sequence[tuple[Contact, ...]]) -> Iterator[Limit]:
    """Yield the limit of the depth of each wheel in solids; none without solids."""
    for wheel, (_, *on_solids) in zip(vehicle.wheels, contacts, strict=True):
        if on_solids:
            words = (
                f"wheel {wheel.name} has penetrated a solid by more than the radius of its tube, "
                "where its contact is not defined; a start must not be inside a solid (gap)"
            )
            gap = ca.mmin(ca.vertcat(*(each.touch.gap for each in on_solids)))
            label = Label("solid_gap", "m", words, wheel.name)
            yield Limit(label, gap, -tube_radii(wheel)[0], np.inf)


def depth_limits(
    vehicle: Vehicle, law: ContactLaw, contacts: Sequence[tuple[Contact, ...]]
) -> Iterator[Limit]:
    """Yield the limit of each wheel's depth up to which a law is valid, if the law has one."""
    for wheel, touching in zip(vehicle.wheels, contacts, strict=True):
        most = law.max_depth(wheel)
        if most < np.inf:
            words = f"wheel {wheel.name} has sunk to its axle (depth)"
            depth = -ca.mmin(ca.vertcat(*(each.touch.gap for each in touching)))
            yield Limit(Label("sunk", "m", words, wheel.name), depth, -np.inf, most)


def dynamic_forces(
    q: Quantities,
    contacts: Sequence[tuple[Contact, ...]],
    x: DynamicState,
    effort: Effort,
) -> ForceOutputs:
    """Return forces, powers and energies; a wheel in the air needs no friction."""
    along, across, normal, _ = q.forces
    needed = tuple(
        ca.if_else(n > 0, ca.hypot(a, c) / n, 0)
        for a, c, n in zip(along, across, normal, strict=True)
    )
    used = tuple(each / mu for each, mu in zip(needed, q.mechanics.friction, strict=True))
    commanded = [
        rate
        for c, rate in zip(q.vehicle.coordinates, x.joint_speeds, strict=True)
        if c.kind == "commanded"
    ]
    efforts, rates = ca.vertcat(*effort.torques, *effort.actuators), (*q.spins, *commanded)
    return ForceOutputs(
        along,
        across,
        needed,
        used,
        effort.torques,
        output_efforts(q.vehicle, effort.actuators),
        ca.dot(efforts, ca.vertcat(*rates)),
        q.mechanics.damped + sum(each.dissipation for touching in contacts for each in touching),
        q.mechanics.potential,
        q.tip_over_margin,
    )
