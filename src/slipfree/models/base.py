"""Symbolic quantities of a vehicle on a ground, and the parts that models in closure form share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.certify import second_contacts
from slipfree.contact.clearance import BodyClearance, body_clearance
from slipfree.contact.closure import ContactFrame, contact_frame, wheel_coordinates
from slipfree.core.dae import Dae, Labels
from slipfree.core.errors import ModelError
from slipfree.core.lookups import LookupTable
from slipfree.core.records import Array, leaves, pack, symbols
from slipfree.geometry.frame import Pose, platform, quaternion
from slipfree.laws.protocols import Equations
from slipfree.models.records import (
    Configuration,
    ContactPoint,
    Dependent,
    ForceOutputs,
    Forces,
    Inputs,
    Outputs,
    Rates,
    state_coordinates,
)
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

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
    names = (*state_coordinates(vehicle), *(c.name for c in vehicle.of("suspension")))
    return dict(zip(names, joints, strict=True))


def masses_of(state: State) -> list[tuple[str, float, ca.SX]]:
    """Return the masses of a vehicle, as `Vehicle.masses` does."""
    return list(state.vehicle.masses(platform_pose(state), values_of(state)))


def check_mass(vehicle: Vehicle, model: str) -> None:
    """Raise ModelError if a vehicle has no mass; the message begins with the model."""
    if not vehicle.mass:
        raise ModelError(
            f"{model}: expected a vehicle with mass, found none in {vehicle.name!r}; give its "
            "platform or its wheels a mass"
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
    place = dict(zip(("x", "y", "z"), terrain.origin, strict=True))
    place |= {f"contact_{axis}": place[axis] for axis in ("x", "y")}
    shift = tuple(
        np.array([place.get(each.name, 0.0) for each in leaves(record)])
        for record in (labels.x, labels.z)
    )
    return scale, (shift[0], shift[1])


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
