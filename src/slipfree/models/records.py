"""Records of a vehicle's motion, states, unknowns, inputs and outputs, and their labels."""

from __future__ import annotations

from typing import Any, Generic, NamedTuple

import casadi as ca

from slipfree.core.dae import Dae, Labels
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Label, T, leaves, pack
from slipfree.core.trajectory import heading_column
from slipfree.laws.protocols import component_labels, quantity_labels, wheel_labels
from slipfree.laws.rolling import rolling_counts
from slipfree.vehicle.tree import Coordinate, Vehicle

HEADING = heading_column(0.0, "paper").label
ROLL, PITCH = quantity_label("roll"), quantity_label("pitch")


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
    distribute them (`slipfree.models.friction_feasibility.contact_force_residuals`). [1, 1/m]
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
    """Quadratures: rotation angles of the wheels [rad], work of the drives and lost energy [J].

    ``work`` is empty if the vehicle has no mass; ``lost`` is empty but in dynamic models, where the
    sum of kinetic, potential and contact energy, minus ``work`` and plus ``lost``, is constant.
    """

    wheels: tuple[T, ...]
    work: tuple[T, ...]
    lost: tuple[T, ...] = ()


class ForceOutputs(NamedTuple, Generic[T]):
    """Forces, powers and stability margin of a vehicle with mass.

    ``along`` and ``across`` are the tangential forces, empty if these are unknowns of the model.
    Units are those of the labels (`slipfree.models.records`).
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
    Distance ``drift_position`` [m] and angle ``drift_rotation`` [rad], outputs of Montana's model
    alone, are those between the wheel's poses from its contact coordinates and from the joints.
    Units are those of the labels (`slipfree.models.records`).
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
    drift_position: tuple[T, ...] = ()
    drift_rotation: tuple[T, ...] = ()


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
    count, needed = rolling_counts(vehicle)
    return count == needed


def labels_of(vehicle: Vehicle, law: Any = (), *, follow: bool = True) -> Labels:
    """Return the labels of a closure model, except those of the equations of its rates.

    ``law`` are the labels of the unknowns of the slip law or wheel-ground law. With ``follow`` the
    contact forces of a vehicle with mass are unknowns of the model; otherwise the wheel-ground law
    gives them, and tangential forces are outputs.
    """
    velocity = [
        Label(f"velocity_{axis}", "m s-1", f"velocity of the platform's centre along {axis}")
        for axis in "xyz"
    ]
    angles = [_turning(label.name, label.words) for label in (HEADING, ROLL, PITCH)]
    free = [wheel.name for wheel in vehicle.wheels if not wheel.driven]
    rates = Rates(
        velocity[0],
        velocity[1],
        velocity[2],
        angles[0],
        angles[1],
        angles[2],
        tuple(_rate(vehicle, c) for c in vehicle.of("suspension")),
        tuple(_rate(vehicle, c) for c in vehicle.of("passive")),
        tuple(_turning(name, f"the free wheel {name}") for name in free),
        law,
    )
    x = Configuration(
        quantity_label("x"),
        quantity_label("y"),
        HEADING,
        tuple(_coordinate(vehicle, c) for c in vehicle.coordinates if c.kind != "suspension"),
    )
    contacts = zip(
        quantity_labels(vehicle, "contact_x"),
        quantity_labels(vehicle, "contact_y"),
        strict=True,
    )
    position = Dependent(
        quantity_label("z"),
        ROLL,
        PITCH,
        tuple(_coordinate(vehicle, c) for c in vehicle.of("suspension")),
        tuple(ContactPoint(*pair) for pair in contacts),
    )
    driven = [wheel.name for wheel in vehicle.wheels if wheel.driven]
    u = Inputs(
        tuple(_turning(name, f"the driven wheel {name}, positive forward") for name in driven),
        tuple(_rate(vehicle, c) for c in vehicle.of("commanded")),
    )
    work = (quantity_label("work"),) if vehicle.mass else ()
    q = Totals(quantity_labels(vehicle, "wheel_angle"), work)
    closures = component_labels(vehicle, "closure", "m", "contact condition")
    forces, equations = _force_labels(vehicle, rates) if follow else (Forces(), ())
    are_unknown = any(label.name == "force_along" for label in leaves((law, forces)))
    y = _output_labels(vehicle, follow=are_unknown)
    z = Algebraic(position, rates, forces)
    return Labels(x, z, q, u, y, (closures, (), equations))


def pressed_labels(vehicle: Vehicle) -> dict[str, tuple[Label, ...]]:
    """Return the labels of the outputs of wheels that press into the ground, by field."""
    names = ("depth", "load_share", *(["force_normal"] if vehicle.mass else []))
    return {name: quantity_labels(vehicle, name) for name in names}


def _turning(name: str, words: str) -> Label:
    return Label(f"{name}_rate", "rad s-1", f"rate of {words}")


def _coordinate(vehicle: Vehicle, c: Coordinate) -> Label:
    return Label(c.name, vehicle.unit(c.name), c.words)


def _rate(vehicle: Vehicle, c: Coordinate) -> Label:
    return Label(f"{c.name}_rate", f"{vehicle.unit(c.name)} s-1", f"rate of {c.words}")


def _force_labels(vehicle: Vehicle, rates: Rates) -> tuple[Forces, tuple[Label, ...]]:
    """Return the labels of the forces that follow from a motion, and of their equations."""
    if not vehicle.mass:
        return Forces(), ()
    equilibrium = equilibrium_labels(rates)
    along, across, normal = (
        quantity_labels(vehicle, f"force_{name}") for name in ("along", "across", "normal")
    )
    if is_determinate(vehicle):
        return Forces(along, across, normal), equilibrium
    virtual = tuple(
        Label(
            f"virtual_{each.name}", "1" if "m s-1" in each.unit else "m-1", f"virtual {each.words}"
        )
        for each in leaves(rates.motion)
    )
    words = "normal velocity of the contact for the virtual rates"
    kept = wheel_labels(vehicle, "distribution", "1", words)
    return Forces(normal=normal, virtual=virtual), (*equilibrium, *kept)


def equilibrium_labels(rates: Rates) -> tuple[Label, ...]:
    """Return the labels of the equilibrium equations, one for each rate, divided by the weight."""
    return tuple(
        Label(
            f"equilibrium_{label.name.removesuffix('_rate')}",
            "1" if label.unit == "m s-1" else "m",
            f"{'force' if label.unit == 'm s-1' else 'moment'} divided by weight, equilibrium with "
            f"respect to {label.words.removeprefix('rate of ')}",
        )
        for label in leaves(rates.motion)
    )


def _output_labels(vehicle: Vehicle, *, follow: bool) -> Outputs:
    names = Outputs._fields[: Outputs._fields.index("yaw")]
    wheels: dict[str, Any] = {name: quantity_labels(vehicle, name) for name in names}
    words = "{} of the platform's quaternion (x forward)"
    return Outputs(
        **wheels,
        yaw=quantity_label("yaw"),
        quaternion=tuple(Label(f"quaternion_{k}", "1", words.format(k)) for k in "xyzw"),
        forces=_force_output_labels(vehicle, follow=follow) if vehicle.mass else (),
    )


def effort_label(vehicle: Vehicle, c: Coordinate) -> Label:
    """Return the label of the torque or force of the actuator of a commanded coordinate."""
    kind, unit = ("torque", "N m") if vehicle.unit(c.name) == "rad" else ("force", "N")
    return Label(f"{c.name}_{kind}", unit, f"{kind} of the actuator of {c.words}")


def _force_output_labels(vehicle: Vehicle, *, follow: bool) -> ForceOutputs:
    return ForceOutputs(
        () if follow else quantity_labels(vehicle, "force_along"),
        () if follow else quantity_labels(vehicle, "force_across"),
        quantity_labels(vehicle, "friction_needed"),
        quantity_labels(vehicle, "utilisation"),
        quantity_labels(vehicle, "drive_torque"),
        tuple(effort_label(vehicle, c) for c in vehicle.of("commanded")),
        quantity_label("power"),
        quantity_label("dissipation"),
        quantity_label("potential_energy"),
        quantity_label("tip_over_margin"),
    )
