"""Symbolic quantities of a vehicle on a ground, from which models and limits are built."""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from slipfree.contact.closure import ContactFrame
from slipfree.core.lookups import LookupTable
from slipfree.geometry.frame import Pose
from slipfree.models.records import Configuration, Dependent, Forces, Inputs, Rates
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle


class Mechanics(NamedTuple):
    """Terms of the quasi-static equilibrium of a vehicle, in the symbols of a model.

    Rates are in the order of ``Rates.motion``, inputs in the order of ``Inputs``.

    Attributes
    ----------
    free, driven : SX, shapes (3 n_wheels, n_rates) and (3 n_wheels, n_inputs)
        Derivatives of the slip velocities along, across and normal to every wheel with respect to
        rates and inputs: ``A`` and ``B``. [1, m]
    load : SX, shape (n_rates, 1)
        Generalised force of gravity, springs and dampers for each rate. [N, N m]
    held : SX, shape (n_inputs, 1)
        Generalised force of gravity, springs and dampers for each input. [N, N m]
    friction : tuple of SX
        Coefficient of friction at every wheel. [1]
    weight : float
        Weight of the whole vehicle. [N]
    potential, damped : SX, shape (1, 1)
        Potential energy [J] and power of the dampers [W].
    """

    free: ca.SX
    driven: ca.SX
    load: ca.SX
    held: ca.SX
    friction: tuple[ca.SX, ...]
    weight: float
    potential: ca.SX
    damped: ca.SX


class Quantities(NamedTuple):
    """Expressions of a model, from which its limits are computed.

    Attributes
    ----------
    vehicle : Vehicle
        The vehicle.
    terrain : Terrain
        The ground.
    x : Configuration
        Position, heading and joints. [m, rad]
    position : Dependent
        Height, inclination and suspension. [m, rad]
    rates : Rates
        Rates that are not commanded. [m/s, rad/s]
    forces : Forces
        Forces of the ground on the wheels; empty if the vehicle has no mass. [N]
    u : Inputs
        Commanded rates. [rad/s, m/s]
    poses : tuple of Pose
        Poses of the wheels' carriers, at the wheels' centres.
    contacts : tuple of ContactFrame
        Contact frames of the wheels.
    slips : tuple of SX, shape (3, 1)
        Slip velocities of the wheels in fixed axes. [m/s]
    spins : tuple of SX
        Rates of all wheels. [rad/s]
    mechanics : Mechanics
        Terms of the equilibrium.
    tip_over_margin : SX, shape (1, 1)
        Tip-over margin (`slipfree.models.tip_over`); infinite if the vehicle has no mass. [rad]
    lookups : LookupTable
        Lookups of the ground in these expressions.
    """

    vehicle: Vehicle
    terrain: Terrain
    x: Configuration
    position: Dependent
    rates: Rates
    forces: Forces
    u: Inputs
    poses: tuple[Pose, ...]
    contacts: tuple[ContactFrame, ...]
    slips: tuple[ca.SX, ...]
    spins: tuple[ca.SX, ...]
    mechanics: Mechanics
    tip_over_margin: ca.SX
    lookups: LookupTable
