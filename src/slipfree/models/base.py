"""Models of a vehicle on a ground: records and their labels, symbols, and parts in closure form.

The records are those of a vehicle's motion, states, unknowns, inputs and outputs. The symbolic
quantities and parts are those that models in closure form share.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Generic, NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.certify import second_contacts
from slipfree.contact.closure import ContactFrame, contact_frame, wheel_coordinates
from slipfree.contact.nearest_points import BodyClearance, body_clearance
from slipfree.core.dae import Dae, Labels
from slipfree.core.errors import ModelError
from slipfree.core.lookups import LookupTable
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Array, Label, T, leaves, pack, symbols
from slipfree.core.trajectory import heading_column
from slipfree.geometry.frame import Pose, platform, quaternion
from slipfree.laws.protocols import Equations, component_labels, quantity_labels, wheel_labels
from slipfree.laws.rolling import rolling_counts
from slipfree.terrain.base import Terrain
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
    Units are those of the labels (`slipfree.models.base`).
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
    Units are those of the labels (`slipfree.models.base`).
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
    of_motion: list[Any] = [
        *velocity,
        *angles,
        tuple(_rate(vehicle, c) for c in vehicle.of("suspension")),
        tuple(_rate(vehicle, c) for c in vehicle.of("passive")),
        tuple(_turning(name, f"the free wheel {name}") for name in free),
        law,
    ]
    rates = Rates(*of_motion)
    x = Configuration(
        quantity_label("x"),
        quantity_label("y"),
        HEADING,
        tuple(_coordinate(vehicle, c) for c in vehicle.coordinates if c.kind != "suspension"),
    )
    contacts = (quantity_labels(vehicle, f"contact_{axis}") for axis in "xy")
    position = Dependent(
        quantity_label("z"),
        ROLL,
        PITCH,
        tuple(_coordinate(vehicle, c) for c in vehicle.of("suspension")),
        tuple(map(ContactPoint, *contacts)),
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
    names, of_forces = Outputs._fields[: Outputs._fields.index("yaw")], ForceOutputs._fields
    wheels: dict[str, Any] = {name: quantity_labels(vehicle, name) for name in names}
    words = "{} of the platform's quaternion (x forward)"
    y = Outputs(
        **wheels,
        yaw=quantity_label("yaw"),
        quaternion=tuple(Label(f"quaternion_{k}", "1", words.format(k)) for k in "xyzw"),
        forces=(),
    )
    if vehicle.mass:
        tangential = [quantity_labels(vehicle, f"force_{axis}") for axis in ("along", "across")]
        of_mass: list[Any] = [
            *([(), ()] if are_unknown else tangential),
            *(quantity_labels(vehicle, name) for name in of_forces[2:5]),
            tuple(effort_label(vehicle, c) for c in vehicle.of("commanded")),
            *map(quantity_label, of_forces[6:]),
        ]
        y = y._replace(forces=ForceOutputs(*of_mass))
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
            f"balance of {'forces' if label.unit == 'm s-1' else 'moments'} over the weight, for "
            f"the {label.words.removeprefix('rate of ')}",
        )
        for label in leaves(rates.motion)
    )


def effort_label(vehicle: Vehicle, c: Coordinate) -> Label:
    """Return the label of the torque or force of the actuator of a commanded coordinate."""
    kind, unit = ("torque", "N m") if vehicle.unit(c.name) == "rad" else ("force", "N")
    return Label(f"{c.name}_{kind}", unit, f"{kind} of the actuator of {c.words}")


LEAST_SPEED = 1e-6  # of a wheel or its rim, below which a slip ratio is reduced [m/s]


class Mechanics(NamedTuple):
    """Terms of the quasi-static equilibrium of a vehicle, in the symbols of a model.

    Rates are in the order of ``Rates.motion``, inputs in the order of ``Inputs``. ``free`` and
    ``driven`` are the derivatives ``A`` and ``B`` of the slip velocities along, across and normal
    to every wheel with respect to them, with 3 n_wheels rows [1, m]; ``load`` and ``held`` the
    generalised forces of gravity, springs and dampers on them [N, N m]. ``friction`` are the
    coefficients at the wheels; ``weight`` [N], ``potential`` energy [J] and power of the dampers
    ``damped`` [W] are those of the vehicle.
    """

    free: ca.SX
    driven: ca.SX
    load: ca.SX
    held: ca.SX
    friction: tuple[ca.SX, ...]
    weight: float
    potential: ca.SX
    damped: ca.SX


class VehicleState(NamedTuple):
    """A vehicle on a ground at coordinates and rates in the symbols of a model.

    ``x`` and ``position`` hold the local coordinates of the platform and the values of the joints;
    ``lookups`` collects the lookups of the ground.
    """

    vehicle: Vehicle
    terrain: Terrain
    lookups: LookupTable
    x: Configuration
    position: Dependent
    rates: Rates = Rates(*(ca.SX(0),) * 6, (), (), (), ())
    u: Inputs = Inputs((), ())


class Quantities(NamedTuple):
    """Expressions of a model, from which its limits are computed.

    The first fields are those of `VehicleState`. ``forces`` are those of the ground on the wheels,
    empty if the vehicle has no mass; the tip-over margin is then infinite. ``poses`` are those of
    the wheels' carriers at the wheels' centres, ``slips`` (3, 1) are in fixed axes, ``spins`` the
    rates of all wheels. Units are those of the labels.
    """

    vehicle: Vehicle
    terrain: Terrain
    lookups: LookupTable
    x: Configuration
    position: Dependent
    rates: Rates
    u: Inputs
    forces: Forces
    poses: tuple[Pose, ...]
    contacts: tuple[ContactFrame, ...]
    slips: tuple[ca.SX, ...]
    spins: tuple[ca.SX, ...]
    mechanics: Mechanics
    tip_over_margin: ca.SX


State = VehicleState | Quantities


def platform_pose(state: State) -> Pose:
    """Return the pose of the platform, in local coordinates."""
    x, position = state.x, state.position
    return platform(x.x, x.y, position.z, x.heading, position.roll, position.pitch)


def carriers(state: State) -> tuple[Pose, ...]:
    """Return the poses of the wheels' carriers, with origins at the wheels' centres."""
    return state.vehicle.carriers(platform_pose(state), values_of(state))


def contact_frames(
    state: State, poses: Sequence[Pose], points: Sequence[ContactPoint]
) -> tuple[ContactFrame, ...]:
    """Return the contacts of the wheels, whose carriers have the given poses, at ground points."""
    return tuple(
        contact_frame(state.terrain, at.x, at.y, pose.rotation[:, 0], state.lookups)
        for at, pose in zip(points, poses, strict=True)
    )


def values_of(state: State) -> dict[str, ca.SX]:
    """Return the values of all coordinates of a vehicle, by name [rad, m]."""
    vehicle, joints = state.vehicle, (*state.x.joints, *state.position.suspension)
    names = [c.name for c in sorted(vehicle.coordinates, key=lambda c: c.kind == "suspension")]
    return dict(zip(names, joints, strict=True))


def masses_of(state: State) -> list[tuple[str, float, ca.SX]]:
    """Return the masses of a vehicle, as `Vehicle.masses` does."""
    return list(state.vehicle.masses(platform_pose(state), values_of(state)))


def check_mass(vehicle: Vehicle, model: str) -> None:
    """Raise ModelError if a vehicle has no mass; the message begins with the model."""
    if not vehicle.mass:
        raise ModelError(
            f"{model}: expected a vehicle with mass, found none in {vehicle.name!r}; give its "
            "platform or its wheels a mass, with the key 'mass'"
        )


def body_checks(q: Quantities, x: Any, z: Any) -> tuple[BodyClearance, ...]:
    """Return the check of the clearance of a vehicle's bodies; none without shapes.

    ``x`` and ``z`` are the records of states and unknowns of the model.
    """
    parts = q.vehicle.parts(platform_pose(q), values_of(q))
    return body_clearance(
        q.vehicle, parts, q.terrain, q.lookups, (pack(x), pack(z)), extent(q.vehicle)
    )


def contact_checks(q: Quantities, x: Any, z: Any, poses: Sequence[Pose]) -> tuple[Any, ...]:
    """Return the checks of second contacts of wheels at poses, and of the clearance of bodies."""
    return *second_contacts(q, x, z, poses, extent(q.vehicle)), *body_checks(q, x, z)


def vehicle_dae(
    q: Quantities,
    labels: Labels,
    x: Any,
    z: Any,
    equations: Sequence[Equations],
    forces: ForceOutputs | tuple[()],
    **others: Any,
) -> Dae:
    """Return the DAE of a model from its quantities.

    ``equations`` determine the fields of ``z``, ``forces`` are the powers of the quadratures, and
    ``others`` the remaining fields of `Dae`.
    """
    scale, shift = sizes(q.vehicle, q.terrain, labels)
    powers = () if not forces else (forces.power, forces.dissipation)
    usual: dict[str, Any] = {
        "labels": labels._replace(alg=tuple(each.labels for each in equations)),
        "alg": tuple(each.rows for each in equations),
        "quad": ca.vertcat(*q.spins, *powers[: len(labels.q.work + labels.q.lost)]),
        "scale": scale,
        "shift": shift,
        "size": extent(q.vehicle),
        "lookups": q.lookups.lookups,
        "vehicle": q.vehicle,
        "ground": q.terrain,
    }
    return Dae(ca.SX.sym("t"), x, z, symbols(labels.q), q.u, **(usual | others))


def level_heights(state: State) -> tuple[ca.SX, list[ca.SX]]:
    """Return, for each wheel, the height of a level platform at which it touches the ground.

    Heights of the platform's centre (n_wheels, 1) [m], with all suspension coordinates zero, and
    the centres of the wheels in local coordinates for a platform at height zero [m].
    """
    level = Dependent(0, 0, 0, tuple(0 for _ in state.vehicle.of("suspension")), ())
    centers = [carrier.origin for carrier in carriers(state._replace(position=level))]
    heights = [
        state.terrain.height(c[0], c[1], state.lookups) + wheel.radius - c[2]
        for c, wheel in zip(centers, state.vehicle.wheels, strict=True)
    ]
    return ca.vertcat(*heights), centers


def spins(state: State) -> tuple[ca.SX, ...]:
    """Return the rates of all wheels, driven or free [rad/s]."""
    driven, free = iter(state.u.wheels), iter(state.rates.free)
    return tuple(next(driven) if wheel.driven else next(free) for wheel in state.vehicle.wheels)


def joint_rates(state: State) -> tuple[ca.SX, ...]:
    """Return the rates of the joints that are states, commanded or passive [rad/s, m/s]."""
    commanded, passive = iter(state.u.joints), iter(state.rates.passive)
    kinds = [c.kind for c in state.vehicle.coordinates if c.kind != "suspension"]
    return tuple(next(commanded) if kind == "commanded" else next(passive) for kind in kinds)


def outputs(q: Quantities, forces: ForceOutputs | tuple[()]) -> Outputs:
    """Return the outputs of a model as expressions, with positions in map coordinates."""
    o_x, o_y, o_z = q.terrain.origin
    poses, contacts, base = q.poses, q.contacts, platform_pose(q).rotation
    on_wheels = zip(
        *(wheel_coordinates(*each) for each in zip(poses, contacts, strict=True)), strict=True
    )
    wheel_u, wheel_v, psi = (tuple(values) for values in on_wheels)
    slip_along, slip_across = tangential_components(contacts, q.slips)
    forward_left_up = ca.horzcat(base[:, 1], -base[:, 0], base[:, 2])
    return Outputs(
        contact_z=tuple(c.point[2] + o_z for c in contacts),
        center_x=tuple(c.origin[0] + o_x for c in poses),
        center_y=tuple(c.origin[1] + o_y for c in poses),
        center_z=tuple(c.origin[2] + o_z for c in poses),
        slip_along=slip_along,
        slip_across=slip_across,
        wheel_rate=q.spins,
        wheel_u=wheel_u,
        wheel_v=wheel_v,
        psi=psi,
        yaw=ca.atan2(base[1, 1], base[0, 1]),
        quaternion=tuple(ca.vertsplit(quaternion(forward_left_up))),
        forces=forces,
    )


def tangential_components(
    contacts: Sequence[ContactFrame], vectors: Sequence[ca.SX]
) -> tuple[tuple[ca.SX, ...], tuple[ca.SX, ...]]:
    """Return the components along and across the wheels of vectors (3, 1) at their contacts."""
    pairs = list(zip(contacts, vectors, strict=True))
    across = tuple(ca.dot(contact.across, each) for contact, each in pairs)
    return tuple(ca.dot(contact.along, each) for contact, each in pairs), across


def slip_ratios(q: Quantities) -> tuple[ca.SX, ...]:
    """Return the slip ratios of the wheels, positive if the rim is faster than the wheel [1]."""
    ratios = list[ca.SX]()
    for wheel, contact, slip, rate in zip(
        q.vehicle.wheels, q.contacts, q.slips, q.spins, strict=True
    ):
        along, rim = ca.dot(contact.along, slip), rate * wheel.radius
        fastest = ca.fmax(ca.fabs(rim), ca.fabs(rim + along))
        ratios.append(-along / ca.fmax(fastest, LEAST_SPEED))
    return tuple(ratios)


def raised_poses(
    poses: Sequence[Pose], contacts: Sequence[ContactFrame], depths: Sequence[ca.SX]
) -> tuple[Pose, ...]:
    """Return the poses of wheels raised until none presses into the ground at its contact.

    The certificate of a single contact then finds second contacts only.
    """
    return tuple(
        pose._replace(origin=pose.origin + ca.fmax(depth, 0) * contact.normal)
        for pose, contact, depth in zip(poses, contacts, depths, strict=True)
    )


def sizes(vehicle: Vehicle, terrain: Terrain, labels: Labels) -> tuple[Array, tuple[Array, Array]]:
    """Return typical sizes of the unknowns ``z``, and offsets of ``x`` and ``z``.

    Adding the offsets converts ``x`` and ``z`` from local to map coordinates.
    """
    radius = min(wheel.radius for wheel in vehicle.numeric.wheels)
    weight = vehicle.weight
    typical = {"m": radius, "m s-1": radius, "N": weight, "N m": radius * weight}
    scale = np.array([typical.get(each.unit, 1.0) for each in leaves(labels.z)])
    return scale, (map_offsets(terrain, labels.x), map_offsets(terrain, labels.z))


def map_offsets(terrain: Terrain, labels: Any) -> Array:
    """Return the offsets that convert variables from local to map coordinates."""
    place = dict(zip(("x", "y", "z"), terrain.origin, strict=True))
    place |= {f"contact_{axis}": place[axis] for axis in ("x", "y")}
    return np.array([place.get(each.name, 0.0) for each in leaves(labels)])


def extent(vehicle: Vehicle) -> float:
    """Return the size of a vehicle, which scales the lengths of its models [m].

    It is the largest coordinate of a wheel's centre relative to the platform's centre, and at
    least the largest wheel radius.
    """
    vehicle = vehicle.numeric
    return max(float(np.abs(vehicle.centers).max()), *(wheel.radius for wheel in vehicle.wheels))


def at_rest(vehicle: Vehicle, labels: Any) -> ca.SX:
    """Return the initial guess of rates, forces and sinkage.

    Normal forces are equal, wheels in soil have their static depth; other values are zero.
    """
    share = vehicle.weight / len(vehicle.wheels)
    depths = {wheel.name: wheel.depth for wheel in vehicle.numeric.wheels}
    guess = {"force_normal": dict.fromkeys(depths, share), "sinkage": depths}
    return ca.SX([guess.get(each.name, {}).get(each.wheel, 0.0) for each in leaves(labels)])
