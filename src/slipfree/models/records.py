"""Records of a vehicle's motion: states, unknowns, inputs, outputs and their labels."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca

from slipfree.laws.rolling import rolling_counts
from slipfree.records import pack
from slipfree.vehicle.tree import Vehicle


class Configuration(NamedTuple):
    """Differential states in exact contact: position, heading, and joints except suspension.

    ``x`` and ``y`` are local coordinates [m], ``heading`` is an angle [rad]; ``joints`` are the
    commanded and the passive coordinates in the vehicle's order [rad or m].
    """

    x: Any
    y: Any
    heading: Any
    joints: tuple[Any, ...]


class RelaxedState(NamedTuple):
    """Differential states of a vehicle with pressed wheels: platform, joints and suspension.

    Lengths are in m, angles in rad; ``joints`` are the commanded and the passive coordinates.
    """

    x: Any
    y: Any
    heading: Any
    joints: tuple[Any, ...]
    z: Any
    roll: Any
    pitch: Any
    suspension: tuple[Any, ...]


class PressedContacts(NamedTuple):
    """Unknowns at position level of a model with pressed wheels: the contact points [m]."""

    contacts: tuple[ContactPoint, ...]


class ContactPoint(NamedTuple):
    """Local coordinates of a contact point on the ground, ``u_g`` and ``v_g`` [m]."""

    x: Any
    y: Any


class Dependent(NamedTuple):
    """Coordinates that contact with the ground determines for a given configuration [m, rad].

    These are height, attitude and suspension of the vehicle, and the contact points of the wheels.
    """

    z: Any
    roll: Any
    pitch: Any
    suspension: tuple[Any, ...]
    contacts: tuple[ContactPoint, ...]


class Rates(NamedTuple):
    """Rates that are not commanded, and the unknowns of the slip law or wheel-ground law.

    ``passive`` are the rates of the passive coordinates, ``free`` the rates of the wheels without
    drive. ``law`` is the record of the law's unknowns, empty if it has none. [m/s, rad/s]
    """

    x: Any
    y: Any
    z: Any
    heading: Any
    roll: Any
    pitch: Any
    suspension: tuple[Any, ...]
    passive: tuple[Any, ...]
    free: tuple[Any, ...]
    law: Any

    @property
    def motion(self) -> tuple[Any, ...]:
        """Rates of the coordinates and free wheels, without the unknowns of the law."""
        return tuple(self[:-1])


class Forces(NamedTuple):
    """Forces of the ground on the wheels, one per wheel; empty without mass [N].

    If equilibrium alone does not determine the forces, ``virtual`` are the virtual rates that
    distribute them (`slipfree.models.statics.following_forces`). [1, 1/m]
    """

    along: tuple[Any, ...] = ()
    across: tuple[Any, ...] = ()
    normal: tuple[Any, ...] = ()
    virtual: tuple[Any, ...] = ()

    @property
    def column(self) -> ca.SX:
        """Forces as a column, shape (3 n_wheels, 1): along, across, normal, wheel by wheel [N]."""
        wheels = zip(self.along, self.across, self.normal, strict=True)
        return pack(tuple(wheels))


class Algebraic(NamedTuple):
    """Algebraic unknowns, grouped by the equations that determine them."""

    position: Any  # Dependent in exact contact, else PressedContacts
    rates: Rates
    forces: Forces


class Inputs(NamedTuple):
    """Rates of the driven wheels and commanded coordinates, in vehicle order [rad/s, m/s]."""

    wheels: tuple[Any, ...]
    joints: tuple[Any, ...]


class Totals(NamedTuple):
    """Quadratures: rotation angles of the wheels [rad], work of drives and actuators [J].

    ``work`` is empty if the vehicle has no mass.
    """

    wheels: tuple[Any, ...]
    work: tuple[Any, ...]


class ForceOutputs(NamedTuple):
    """Forces, powers and stability margin of a vehicle with mass.

    ``along`` and ``across`` are the tangential forces, empty if these are unknowns of the model.
    Units are those of the labels (`slipfree.models.labels`).
    """

    along: tuple[Any, ...]
    across: tuple[Any, ...]
    friction_needed: tuple[Any, ...]
    utilisation: tuple[Any, ...]
    drive_torque: tuple[Any, ...]
    joint_effort: tuple[Any, ...]
    power: Any
    dissipation: Any
    potential_energy: Any
    tip_over_margin: Any


class Outputs(NamedTuple):
    """Outputs of a model along a motion; positions in map coordinates.

    ``quaternion`` (x, y, z, w) and ``yaw`` describe the platform by axes x forward, y left, z up.
    Units are those of the labels (`slipfree.models.labels`).
    """

    contact_z: tuple[Any, ...]
    center_x: tuple[Any, ...]
    center_y: tuple[Any, ...]
    center_z: tuple[Any, ...]
    slip_along: tuple[Any, ...]
    slip_across: tuple[Any, ...]
    wheel_rate: tuple[Any, ...]
    wheel_u: tuple[Any, ...]
    wheel_v: tuple[Any, ...]
    psi: tuple[Any, ...]
    yaw: Any
    quaternion: tuple[Any, ...]
    forces: ForceOutputs | tuple[()]
    depth: tuple[Any, ...] = ()
    load_share: tuple[Any, ...] = ()
    force_normal: tuple[Any, ...] = ()
    slip_ratio: tuple[Any, ...] = ()


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
