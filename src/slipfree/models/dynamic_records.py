"""Records of a dynamic model: states, quadratures and outputs, and their labels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Generic, NamedTuple

import casadi as ca

from slipfree.core.dae import Dae, Labels
from slipfree.core.records import Label, T
from slipfree.laws.protocols import wheel_labels
from slipfree.models.labels import effort_label, labels_of, pressed_labels, slip_ratio_labels
from slipfree.models.records import Inputs, Outputs
from slipfree.vehicle.tree import Coordinate, Vehicle
from slipfree.vehicle.wheel import Wheel


class DynamicState(NamedTuple, Generic[T]):
    """Differential states: pose and speeds of platform, joints and wheels.

    ``attitude`` is the unit quaternion (w, x, y, z) of the platform. A planar vehicle has no ``x``,
    its ``attitude`` is the pitch angle, ``velocity`` has the components y and z, and ``omega`` the
    component x. ``joints`` are all coordinates, ``joint_speeds`` their rates, and ``spins`` the
    speeds of the wheels
    (`slipfree.models.multibody.WheelMotion`). ``drives`` and ``joint_drives`` are the
    integrals of the speed controllers of wheels and of commanded coordinates.
    [m, rad, m/s, rad/s, N m, N]
    """

    x: T
    y: T
    z: T
    attitude: tuple[T, ...]
    joints: tuple[T, ...]
    velocity: tuple[T, ...]
    omega: tuple[T, ...]
    joint_speeds: tuple[T, ...]
    spins: tuple[T, ...]
    drives: tuple[T, ...]
    joint_drives: tuple[T, ...]


class DynamicTotals(NamedTuple, Generic[T]):
    """Quadratures: rotation angles of the wheels [rad], work of the drives and lost energy [J].

    The sum of kinetic, potential and contact energy, minus ``work`` and plus ``lost``, is constant.
    """

    wheels: tuple[T, ...]
    work: T
    lost: T


class OnSolid(NamedTuple, Generic[T]):
    """Contacts of all wheels with one solid, or with the ground below the solids.

    Gap [m], normal force, friction force along the direction of travel [N], and slip velocity along
    it [m/s].
    """

    gap: tuple[T, ...]
    load: tuple[T, ...]
    friction: tuple[T, ...]
    slip: tuple[T, ...]


class DynamicOutputs(NamedTuple, Generic[T]):
    """Outputs of a dynamic model; positions are map coordinates.

    ``x`` is empty if it is a state, and ``pitch`` if it is a state, that is, for planar vehicles.
    """

    x: T
    heading: T
    roll: T
    pitch: T
    heading_rate: T
    roll_rate: T
    pitch_rate: T
    contact_x: tuple[T, ...]
    contact_y: tuple[T, ...]
    common: Outputs[T]
    kinetic_energy: T
    contact_energy: T
    solids: tuple[OnSolid[T], ...]


DynamicDae = Dae[DynamicState[ca.SX], tuple[()], Inputs[ca.SX], DynamicOutputs[ca.SX]]


def dynamic_labels(vehicle: Vehicle, solids: int = 0) -> Labels:
    """Return the labels of the dynamic model of a vehicle with mass, for a number of solids."""
    still = labels_of(vehicle, follow=False)
    words = "energy lost in contacts and dampers"
    q = DynamicTotals(still.q.wheels, still.q.work[0], Label("lost_energy", "J", words))
    joints = zip(vehicle.of("commanded"), still.u.joints, strict=True)
    u = Inputs(
        tuple(_wheel_input(wheel) for wheel in vehicle.wheels if wheel.driven),
        tuple(effort_label(vehicle, c) if c.drive.takes_effort else rate for c, rate in joints),
    )
    return Labels(
        _state_labels(vehicle, still), (), q, u, _output_labels(vehicle, still, solids), ()
    )


def _wheel_input(wheel: Wheel) -> Label:
    """Return the label of the input of a driven wheel."""
    words = f"wheel {wheel.name}, positive forward"
    if wheel.drive.takes_effort:
        return Label(f"{wheel.name}_torque", "N m", f"torque on {words}")
    return Label(f"{wheel.name}_rate", "rad s-1", f"rate of {words}")


def _integral(name: str, unit: str) -> Label:
    """Return the label of the integral of the controller of a wheel or a coordinate."""
    return Label(f"{name}_motor_integral", unit, f"integral of the controller of {name}")


def _state_labels(vehicle: Vehicle, still: Labels) -> DynamicState:
    """Return the labels of the states, from those of a model without inertia."""
    joints = {label.name: label for label in (*still.x.joints, *still.z.position.suspension)}
    spin = (
        "rate of the wheel, relative to its carrier where the rate is an input, otherwise to fixed "
        "axes"
    )
    words = "{} of the platform's quaternion (x right)"
    attitude = tuple(Label(f"attitude_{k}", "1", words.format(k)) for k in "wxyz")
    velocity = _vector("velocity", "m s-1", "velocity of the platform's centre")
    omega = _vector("omega", "rad s-1", "angular velocity of the platform")
    planar = vehicle.planar
    return DynamicState(
        () if planar else still.x.x,
        still.x.y,
        still.z.position.z,
        (still.z.position.pitch,) if planar else attitude,
        tuple(joints[c.name] for c in vehicle.coordinates),
        velocity[1:] if planar else velocity,
        omega[:1] if planar else omega,
        tuple(_joint_speed(vehicle, c) for c in vehicle.coordinates),
        wheel_labels(vehicle, "spin", "rad s-1", spin),
        tuple(
            _integral(each.name, "N m") for each in vehicle.wheels if each.acting_drive.has_integral
        ),
        tuple(
            _integral(c.name, effort_label(vehicle, c).unit)
            for c in vehicle.coordinates
            if c.acting_drive.has_integral
        ),
    )


def _output_labels(vehicle: Vehicle, still: Labels, solids: int) -> DynamicOutputs:
    """Return the labels of the outputs, from those of a model without inertia."""
    position, rates = still.z.position, still.z.rates
    forces: Any = still.y.forces
    forces = forces._replace(joint_effort=output_efforts(vehicle, forces.joint_effort))
    return DynamicOutputs(
        still.x.x if vehicle.planar else (),
        still.x.heading,
        position.roll,
        () if vehicle.planar else position.pitch,
        rates.heading,
        rates.roll,
        rates.pitch,
        tuple(each.x for each in position.contacts),
        tuple(each.y for each in position.contacts),
        still.y._replace(
            forces=forces, **pressed_labels(vehicle), slip_ratio=slip_ratio_labels(vehicle)
        ),
        Label("kinetic_energy", "J", "kinetic energy"),
        Label("contact_energy", "J", "elastic energy of the contacts"),
        tuple(_solid_labels(vehicle, k) for k in range(solids + 1 if solids else 0)),
    )


def _solid_labels(vehicle: Vehicle, k: int) -> OnSolid:
    """Return the labels of the contacts with solid ``k``; 0 is the ground below the solids."""
    along, name = "along the direction of travel", f"solid {k}" if k else "the ground"
    return OnSolid(
        wheel_labels(vehicle, f"solid_gap_{k}", "m", f"gap between the wheel and {name}"),
        wheel_labels(vehicle, f"solid_load_{k}", "N", f"normal force of {name} on the wheel"),
        wheel_labels(
            vehicle, f"solid_friction_{k}", "N", f"friction of {name} on the wheel {along}"
        ),
        wheel_labels(vehicle, f"solid_slip_{k}", "m s-1", f"slip of the wheel on {name} {along}"),
    )


def output_efforts(vehicle: Vehicle, efforts: Sequence[T]) -> tuple[T, ...]:
    """Return the efforts of those commanded coordinates whose efforts are outputs, not inputs."""
    pairs = zip(vehicle.of("commanded"), efforts, strict=True)
    return tuple(effort for c, effort in pairs if not c.drive.takes_effort)


def _joint_speed(vehicle: Vehicle, c: Coordinate) -> Label:
    """Return the label of a joint's rate: ``_speed`` if commanded, since its input is ``_rate``."""
    name, words = ("speed", "actual rate") if c.kind == "commanded" else ("rate", "rate")
    return Label(f"{c.name}_{name}", f"{vehicle.unit(c.name)} s-1", f"{words} of {c.words}")


def _vector(name: str, unit: str, words: str) -> tuple[Label, ...]:
    return tuple(
        Label(f"{name}_{axis}", unit, f"{axis} component of the {words}") for axis in "xyz"
    )
