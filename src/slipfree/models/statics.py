"""Forces on a vehicle that moves slowly: equilibrium, friction, the work of its drives.

By virtual power: with the slip velocities ``s_i`` of the wheels' contact points linear in the rates
of all coordinates and wheels, contact forces ``lambda_i`` act on a coordinate with the coefficient
of its rate in ``sum lambda_i . s_i``. Where the rate is free, this balances gravity, springs and
dampers; where it is commanded, the difference is what the drive has to bear. Inertia is left out:
all figures are quasi-static.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.closure import ContactFrame
from slipfree.dae import Limit
from slipfree.geometry.frame import platform
from slipfree.lookups import LookupTable
from slipfree.models.base import carriers, joint_rates, margin_to, reach, spins, values_of
from slipfree.models.records import (
    Configuration,
    Dependent,
    ForceOutputs,
    Forces,
    Inputs,
    Rates,
    is_determinate,
)
from slipfree.models.slip import slip_velocity
from slipfree.models.tip_over import tip_over_margin
from slipfree.records import Label, pack
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import GRAVITY, Vehicle

LEAST_FRICTION = 1e-6  # a formula's coefficient below this is none


class Mechanics(NamedTuple):
    """What equilibrium of a vehicle is made of, as expressions of a model's symbols.

    Rows and columns that belong to rates are in the order of ``Rates.motion``, those that belong
    to inputs in the order of ``Inputs``.

    Attributes
    ----------
    free, driven : SX, shapes (3 n_wheels, n_rates) and (3 n_wheels, n_inputs)
        Slip velocities along, across and normal to every wheel, by the rates and by the inputs:
        ``A`` and ``B``. [1, m]
    load : SX, shape (n_rates, 1)
        Generalised force of gravity, springs and dampers. [N, N m]
    held : SX, shape (n_inputs, 1)
        The same on what is commanded. [N, N m]
    friction : tuple of SX
        Coefficient of friction at every wheel. [1]
    weight : float
        Of the whole vehicle. [N]
    potential, damped : SX, shape (1, 1)
        Potential energy [J] and power that the dampers take [W].
    """

    free: ca.SX
    driven: ca.SX
    load: ca.SX
    held: ca.SX
    friction: tuple[ca.SX, ...]
    weight: float
    potential: ca.SX
    damped: ca.SX


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
    """Return what equilibrium is made of, for a vehicle in the given places at the given rates."""
    q = pack((*x, *position[:4]))
    joints = joint_rates(vehicle, rates, u)
    moving = (*rates[:2], rates.heading, joints, rates.z, rates.roll, rates.pitch)
    q_dot, turning = pack((*moving, rates.suspension)), spins(vehicle, rates, u)
    poses = carriers(vehicle, x, position)
    slips = [
        ca.horzcat(touch.along, touch.across, touch.normal).T
        @ slip_velocity(wheel, pose, touch, q, q_dot, spin)
        for wheel, pose, touch, spin in zip(vehicle.wheels, poses, contacts, turning, strict=True)
    ]
    unknown, given = pack(rates.motion), pack(u)
    potential = _potential(vehicle, x, position)
    damped = _damping(vehicle, rates)
    power = ca.jtimes(potential, q, q_dot)
    # Dampers lose twice the gradient of their dissipation function, half their power.
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
    """Return the energy of gravity and springs; heights count from the ground's origin. [J]."""
    base = platform(x.x, x.y, position.z, x.heading, position.roll, position.pitch)
    values = values_of(vehicle, x, position)
    height = sum(mass * center[2] for _, mass, center in vehicle.masses(base, values))
    springs = sum(c.potential(values[c.name]) for c in vehicle.coordinates if c.is_loaded)
    return ca.SX(GRAVITY * height + springs)


def _damping(vehicle: Vehicle, rates: Rates) -> ca.SX:
    """Return the power that the dampers take. [W]."""
    pairs = zip(vehicle.of("passive"), rates.passive, strict=True)
    others = zip(vehicle.of("suspension"), rates.suspension, strict=True)
    return ca.SX(sum(c.damping * rate**2 for c, rate in (*pairs, *others)))


def equilibrium(parts: Mechanics, forces: ca.SX) -> ca.SX:
    """Return what is left of ``A' lambda + Q``, over the weight, shape (n_rates, 1). [1, m]."""
    return (parts.free.T @ forces + parts.load) / parts.weight


def following_forces(vehicle: Vehicle, parts: Mechanics, forces: Forces) -> ca.SX:
    """Return the equations of the forces that a given motion needs.

    Where equilibrium does not determine them, they are those of least ``sum |f_t|^2 / (mu N)`` for
    weights ``mu N`` that are their own loads: ``f_t = -mu N S y``, ``n . A y = 0`` with virtual
    rates ``y``. That is the limit of Coulomb friction, regularised, for small slip. (Of least norm
    regardless of the loads they would be unsound: a wheel that bears little cannot push much.)
    """
    balanced = equilibrium(parts, forces.column)
    if is_determinate(vehicle):
        return balanced
    slip = parts.free @ pack(forces.virtual)
    law = []
    for k, mu in enumerate(parts.friction):
        bearing = mu * forces.normal[k] / parts.weight
        law += [
            forces.along[k] / parts.weight + bearing * slip[3 * k],
            forces.across[k] / parts.weight + bearing * slip[3 * k + 1],
            slip[3 * k + 2],
        ]
    return ca.vertcat(balanced, *law)


class Loads(NamedTuple):
    """What the forces add to a model.

    Attributes
    ----------
    equations : SX, shape (n, 1)
        Of the forces that follow from the motion.
    outputs : ForceOutputs or ()
        Empty if the vehicle has no mass.
    limits : tuple of Limit
        Tip-over, lift-off, and the edge of a map of friction.
    work : tuple of SX
        Rate of the quadrature, if there is one. [W]
    """

    equations: ca.SX
    outputs: ForceOutputs | tuple[()]
    limits: tuple[Limit, ...]
    work: tuple[ca.SX, ...]


def loads(
    vehicle: Vehicle,
    terrain: Terrain,
    parts: Mechanics,
    forces: Forces,
    slips: Sequence[ca.SX],
    contacts: Sequence[ContactFrame],
    state: tuple[Configuration, Dependent, Inputs],
) -> Loads:
    """Return the equations, outputs and limits of the forces along a motion.

    Parameters
    ----------
    vehicle, terrain : Vehicle, Terrain
        What bears them, and what it stands on.
    parts : Mechanics
        From `mechanics`.
    forces : Forces
        The unknowns; or, without virtual rates, expressions of others.
    slips : sequence of SX, shape (3, 1)
        Slip velocities in fixed axes. [m/s]
    contacts : sequence of ContactFrame
        Where the wheels touch the ground.
    state : tuple of Configuration, Dependent and Inputs
        Where the vehicle is and what drives it.
    """
    if not vehicle.mass:
        return Loads(ca.SX(0, 1), (), (), ())
    outputs = _outputs(vehicle, parts, forces, slips, contacts, state)
    limits = (
        *_friction_limits(vehicle, terrain, parts, contacts),
        *_limits(vehicle, outputs, forces.normal),
    )
    unknown = _are_unknown(forces)
    equations = following_forces(vehicle, parts, forces) if unknown else ca.SX(0, 1)
    return Loads(equations, outputs, limits, (outputs.power,))


def _outputs(
    vehicle: Vehicle,
    parts: Mechanics,
    forces: Forces,
    slips: Sequence[ca.SX],
    contacts: Sequence[ContactFrame],
    state: tuple[Configuration, Dependent, Inputs],
) -> ForceOutputs:
    """Return what is sampled of the forces."""
    along, across, normal, _ = forces
    x, position, u = state
    wheels = list(zip(along, across, normal, parts.friction, strict=True))
    efforts = -(parts.driven.T @ forces.column + parts.held)
    torques, drives = iter(ca.vertsplit(efforts) if efforts.numel() else []), []
    for wheel in vehicle.wheels:
        drives.append(next(torques) if wheel.driven else ca.SX(0))
    rubbed = [
        a * ca.dot(touch.along, s) + c * ca.dot(touch.across, s)
        for a, c, touch, s in zip(along, across, contacts, slips, strict=True)
    ]
    return ForceOutputs(
        () if _are_unknown(forces) else along,
        () if _are_unknown(forces) else across,
        tuple(_used(a, c, n) for a, c, n, _ in wheels),
        tuple(_used(a, c, mu * n) for a, c, n, mu in wheels),
        tuple(drives),
        tuple(torques),
        ca.dot(efforts, pack(u)),
        parts.damped - sum(rubbed),
        parts.potential,
        tip_over_margin(vehicle, x, position, contacts),
    )


def _are_unknown(forces: Forces) -> bool:
    """Return whether the tangential forces are symbols, and not expressions of others."""
    return all(each.is_symbolic() for each in (*forces.along, *forces.across))


def _used(along: ca.SX, across: ca.SX, offered: ca.SX) -> ca.SX:
    """Return a tangential force over what is offered; infinite on a wheel that does not press.

    The root is taken last: who limits it can do without, since it has no derivative at zero force.
    """
    return ca.sqrt(ca.if_else(offered > 0, (along**2 + across**2) / offered**2, ca.SX.inf()))


def _limits(vehicle: Vehicle, outputs: ForceOutputs, normal: Sequence[ca.SX]) -> Iterator[Limit]:
    """Yield the limits that concern the forces."""
    words = "the vehicle tips over: gravity passes an edge of its support (angle to it)"
    yield Limit(Label("tip_over", "rad", words), outputs.tip_over_margin, 0.0, np.inf)
    for wheel, force in zip(vehicle.wheels, normal, strict=True):
        words = (
            f"wheel {wheel.name} lifts off: equilibrium would need the ground to pull it "
            "(normal force)"
        )
        yield Limit(Label("lift_off", "N", words, wheel.name), force, 0.0, np.inf)


def _friction_limits(
    vehicle: Vehicle, terrain: Terrain, parts: Mechanics, contacts: Sequence[ContactFrame]
) -> Iterator[Limit]:
    domain = terrain.friction_domain
    for wheel, touch, mu in zip(vehicle.wheels, contacts, parts.friction, strict=True):
        if domain is not None:
            words = f"wheel {wheel.name} leaves the map of friction, which reaches {reach(domain)}"
            label = Label("friction_margin", "m", words, wheel.name)
            yield Limit(label, margin_to(terrain, domain, touch), 0.0, np.inf)
        elif not mu.is_constant():
            words = f"the coefficient of friction under wheel {wheel.name} is not positive"
            yield Limit(Label("friction", "1", words, wheel.name), mu, LEAST_FRICTION, np.inf)
