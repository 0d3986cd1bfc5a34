"""Forces on a slow vehicle: equilibrium, friction and the work of its drives.

The equations follow from the principle of virtual power. The slip velocities ``s_i`` of the contact
points are linear in the rates of all coordinates and wheels; the contact forces ``lambda_i`` act on
a coordinate with the coefficient of its rate in ``sum lambda_i . s_i``. For a free rate, this force
balances gravity, springs and dampers; for a commanded rate, the drive bears the difference. Inertia
is neglected: all results are quasi-static.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from slipfree.contact.closure import ContactFrame
from slipfree.core.lookups import LookupTable
from slipfree.core.records import pack
from slipfree.geometry.frame import platform
from slipfree.models.base import joint_rates, values_of
from slipfree.models.quantities import Mechanics, Quantities
from slipfree.models.records import (
    Configuration,
    Dependent,
    ForceOutputs,
    Forces,
    Inputs,
    Rates,
    is_determinate,
)
from slipfree.models.slip import slip_velocities
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import GRAVITY, Vehicle


def mechanics(
    vehicle: Vehicle,
    terrain: Terrain,
    x: Configuration,
    position: Dependent,
    contacts: Sequence[ContactFrame],
    rates: Rates,
    u: Inputs,
    lookups: LookupTable,
) -> Mechanics:
    """Return the terms of the equilibrium of a vehicle at the given coordinates and rates."""
    q = pack((*x, *position[:4]))
    joints = joint_rates(vehicle, rates, u)
    moving = (*rates[:2], rates.heading, joints, rates.z, rates.roll, rates.pitch)
    q_dot = pack((*moving, rates.suspension))
    velocities = slip_velocities(vehicle, x, position, contacts, rates, u)
    slips = [
        ca.horzcat(touch.along, touch.across, touch.normal).T @ velocity
        for touch, velocity in zip(contacts, velocities, strict=True)
    ]
    unknown, given = pack(rates.motion), pack(u)
    potential = _potential(vehicle, x, position)
    damped = _damping(vehicle, rates, u)
    power = ca.jtimes(potential, q, q_dot)
    # the damper force is the gradient of the dissipation function, which is half the power
    lost = power + damped / 2
    slip = ca.vertcat(*slips)
    return Mechanics(
        ca.jacobian(slip, unknown),
        ca.jacobian(slip, given),
        -ca.gradient(lost, unknown),
        -ca.gradient(lost, given),
        tuple(
            wheel.grip * terrain.friction(touch.point[0], touch.point[1], lookups)
            for wheel, touch in zip(vehicle.wheels, contacts, strict=True)
        ),
        vehicle.weight,
        potential,
        damped,
    )


def _potential(vehicle: Vehicle, x: Configuration, position: Dependent) -> ca.SX:
    """Return the potential energy of gravity and springs, zero at the ground's origin [J]."""
    base = platform(x.x, x.y, position.z, x.heading, position.roll, position.pitch)
    values = values_of(vehicle, x, position)
    height = sum(mass * center[2] for _, mass, center in vehicle.masses(base, values))
    springs = sum(c.potential(values[c.name]) for c in vehicle.coordinates if c.is_loaded)
    return ca.SX(GRAVITY * height + springs)


def _damping(vehicle: Vehicle, rates: Rates, u: Inputs) -> ca.SX:
    """Return the power of the dampers [W]."""
    pairs = [
        *zip(vehicle.of("passive"), rates.passive, strict=True),
        *zip(vehicle.of("suspension"), rates.suspension, strict=True),
        *zip(vehicle.of("commanded"), u.joints, strict=True),
    ]
    return ca.SX(sum(c.damping * rate**2 for c, rate in pairs))


def equilibrium(parts: Mechanics, forces: ca.SX) -> ca.SX:
    """Return the equilibrium residual divided by the weight, shape (n_rates, 1) [1, m]."""
    return (parts.free.T @ forces + parts.load) / parts.weight


def following_forces(q: Quantities) -> ca.SX:
    """Return the residuals that determine the contact forces of a motion; empty without mass.

    Where equilibrium does not determine the forces, the tangential forces ``f_t`` minimise ``sum
    |f_t|^2 / (mu N)``, with the friction limits ``mu N`` of the wheels as fixed weights. The
    conditions are ``f_t = -mu N s_t`` (`with_tangential`) and ``s_n = 0``, where ``s_t`` and
    ``s_n`` are the tangential and normal velocities of a contact for the virtual rates. This is the
    limit of regularised Coulomb friction for small slip. Forces of least norm would not be
    plausible, since a wheel with a small load cannot bear a large force.
    """
    if not q.vehicle.mass:
        return ca.SX(0, 1)
    balanced = equilibrium(q.mechanics, q.forces.column)
    if is_determinate(q.vehicle):
        return balanced
    slip = q.mechanics.free @ pack(q.forces.virtual)
    return ca.vertcat(balanced, slip[2::3])


def with_tangential(forces: Forces, parts: Mechanics) -> Forces:
    """Return forces with the tangential ones that follow from virtual rates: ``-mu N s_t``."""
    if not forces.virtual:
        return forces
    slip = parts.free @ pack(forces.virtual)
    along, across = (
        tuple(
            -mu * normal * s
            for mu, normal, s in zip(
                parts.friction, forces.normal, ca.vertsplit(slip[k::3]), strict=True
            )
        )
        for k in range(2)
    )
    return forces._replace(along=along, across=across)


def force_outputs(q: Quantities, labels: ForceOutputs | tuple[()]) -> ForceOutputs | tuple[()]:
    """Return the output forces, efforts and energies; empty if the vehicle has no mass.

    Parameters
    ----------
    q : Quantities
        Expressions of the model.
    labels : ForceOutputs or ()
        Labels of the outputs; they include tangential forces that are not unknowns.
    """
    if not labels:
        return ()
    along, across, normal, _ = q.forces
    parts = q.mechanics
    wheels = list(zip(along, across, normal, parts.friction, strict=True))
    efforts = -(parts.driven.T @ q.forces.column + parts.held)
    torques, drives = iter(ca.vertsplit(efforts) if efforts.numel() else []), []
    for wheel in q.vehicle.wheels:
        drives.append(next(torques) if wheel.driven else ca.SX(0))
    rubbed = [
        a * ca.dot(touch.along, s) + c * ca.dot(touch.across, s)
        for a, c, touch, s in zip(along, across, q.contacts, q.slips, strict=True)
    ]
    return ForceOutputs(
        along if labels.along else (),
        across if labels.across else (),
        tuple(_used(a, c, n) for a, c, n, _ in wheels),
        tuple(_used(a, c, mu * n) for a, c, n, mu in wheels),
        tuple(drives),
        tuple(torques),
        ca.dot(efforts, pack(q.u)),
        parts.damped - sum(rubbed),
        parts.potential,
        q.tip_over_margin,
    )


def _used(along: ca.SX, across: ca.SX, offered: ca.SX) -> ca.SX:
    """Return the ratio of tangential force to available friction; infinite without load [1].

    The square root is the last operation: limits use the square, since the root has no derivative
    at zero force.
    """
    return ca.sqrt(ca.if_else(offered > 0, (along**2 + across**2) / offered**2, ca.SX.inf()))
