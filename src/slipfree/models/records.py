"""Records of a vehicle's motion: states, unknowns, inputs, outputs and their labels."""

from __future__ import annotations

from typing import Any, Generic, NamedTuple

import casadi as ca

from slipfree.core.dae import Dae
from slipfree.core.records import T, pack
from slipfree.laws.rolling import rolling_counts
from slipfree.vehicle.tree import Vehicle


class Configuration(NamedTuple, Generic[T]):
    """Differential states in exact contact: position, heading, and joints except suspension.

    ``x`` and ``y`` are local coordinates [m], ``heading`` is an angle [rad]; ``joints`` are the
    commanded and the passive coordinates in the vehicle's order [rad or m].
    """

    x: T
    y: T
    heading: T
    joints: tuple[T, ...]


class RelaxedState(NamedTuple, Generic[T]):
    """Differential states of a vehicle with pressed wheels: platform, joints and suspension.

    Lengths are in m, angles in rad; ``joints`` are the commanded and the passive coordinates.
    """

    x: T
    y: T
    heading: T
    joints: tuple[T, ...]
    z: T
    roll: T
    pitch: T
    suspension: tuple[T, ...]


class PressedContacts(NamedTuple, Generic[T]):
    """Unknowns at position level of a model with pressed wheels: the contact points [m]."""

    contacts: tuple[ContactPoint[T], ...]


class ContactPoint(NamedTuple, Generic[T]):
    """Local coordinates of a contact point on the ground, ``u_g`` and ``v_g`` [m]."""

    x: T
    y: T


class Dependent(NamedTuple, Generic[T]):
    """Coordinates that contact with the ground determines for a given configuration [m, rad].

    These are height, attitude and suspension of the vehicle, and the contact points of the wheels.
    """

    z: T
    roll: T
    pitch: T
    suspension: tuple[T, ...]
    contacts: tuple[ContactPoint[T], ...]


class Rates(NamedTuple, Generic[T]):
    """Rates that are not commanded, and the unknowns of the slip law or wheel-ground law.

    ``passive`` are the rates of the passive coordinates, ``free`` the rates of the wheels without
    drive. ``law`` is the record of the law's unknowns, empty if it has none. [m/s, rad/s]
    """

    x: T
    y: T
    z: T
    heading: T
    roll: T
    pitch: T
    suspension: tuple[T, ...]
    passive: tuple[T, ...]
    free: tuple[T, ...]
    law: Any

    @property
    def motion(self) -> tuple[T | tuple[T, ...], ...]:
        """Rates of the coordinates and free wheels, without the unknowns of the law."""
        return tuple(self[:-1])


class Forces(NamedTuple, Generic[T]):
    """Forces of the ground on the wheels, one per wheel; empty without mass [N].

    If equilibrium alone does not determine the forces, ``virtual`` are the virtual rates that
    distribute them (`slipfree.models.statics.following_forces`). [1, 1/m]
    """

    along: tuple[T, ...] = ()
    across: tuple[T, ...] = ()
    normal: tuple[T, ...] = ()
    virtual: tuple[T, ...] = ()

    @property
    def column(self) -> ca.SX:
        """Forces as a column, shape (3 n_wheels, 1): along, across, normal, wheel by wheel [N]."""
        wheels = zip(self.along, self.across, self.normal, strict=True)
        return pack(tuple(wheels))


class Algebraic(NamedTuple, Generic[T]):
    """Algebraic unknowns, grouped by the equations that determine them."""

    position: Any  # Dependent in exact contact, else PressedContacts
    rates: Rates[T]
    forces: Forces[T]


class Inputs(NamedTuple, Generic[T]):
    """Rates of the driven wheels and commanded coordinates, in vehicle order [rad/s, m/s]."""

    wheels: tuple[T, ...]
    joints: tuple[T, ...]


class Totals(NamedTuple, Generic[T]):
    """Quadratures: rotation angles of the wheels [rad], work of drives and actuators [J].

    ``work`` is empty if the vehicle has no mass.
    """

    wheels: tuple[T, ...]
    work: tuple[T, ...]


class ForceOutputs(NamedTuple, Generic[T]):
    """Forces, powers and stability margin of a vehicle with mass.

    ``along`` and ``across`` are the tangential forces, empty if these are unknowns of the model.
    Units are those of the labels (`slipfree.models.labels`).
    """

    along: tuple[T, ...]
    across: tuple[T, ...]
    friction_needed: tuple[T, ...]
    utilisation: tuple[T, ...]
    drive_torque: tuple[T, ...]
    joint_effort: tuple[T, ...]
    power: T
    dissipation: T
    potential_energy: T
    tip_over_margin: T


class Outputs(NamedTuple, Generic[T]):
    """Outputs of a model along a motion; positions in map coordinates.

    ``quaternion`` (x, y, z, w) and ``yaw`` describe the platform by axes x forward, y left, z up.
    Units are those of the labels (`slipfree.models.labels`).
    """

    contact_z: tuple[T, ...]
    center_x: tuple[T, ...]
    center_y: tuple[T, ...]
    center_z: tuple[T, ...]
    slip_along: tuple[T, ...]
    slip_across: tuple[T, ...]
    wheel_rate: tuple[T, ...]
    wheel_u: tuple[T, ...]
    wheel_v: tuple[T, ...]
    psi: tuple[T, ...]
    yaw: T
    quaternion: tuple[T, ...]
    forces: ForceOutputs[T] | tuple[()]
    depth: tuple[T, ...] = ()
    load_share: tuple[T, ...] = ()
    force_normal: tuple[T, ...] = ()
    slip_ratio: tuple[T, ...] = ()


# Model in the rates of wheels and commanded coordinates.
KinematicDae = Dae[
    Configuration[ca.SX] | RelaxedState[ca.SX], Algebraic[ca.SX], Inputs[ca.SX], Outputs[ca.SX]
]


def state_coordinates(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the names of the coordinates that are differential states."""
    return tuple(c.name for c in vehicle.coordinates if c.kind != "suspension")


def is_determinate(vehicle: Vehicle) -> bool:
    """Return whether equilibrium alone determines the contact forces, three per wheel.

    The result is False for vehicles with rollers, since such wheels bear no force along their
    axles.
    """
    if any(wheel.rollers for wheel in vehicle.wheels):
        return False
    found, needed = rolling_counts(vehicle)
    return found == needed
