"""Labels of the unknowns, equations, inputs and outputs of a vehicle's models."""

from __future__ import annotations

from typing import Any

from slipfree.core.dae import Labels
from slipfree.core.records import Label, leaves
from slipfree.laws.protocols import ACROSS, ALONG, NORMAL, component_labels, wheel_labels
from slipfree.models.records import (
    Algebraic,
    Configuration,
    ContactPoint,
    Dependent,
    ForceOutputs,
    Forces,
    Inputs,
    Outputs,
    Rates,
    Totals,
    is_determinate,
)
from slipfree.vehicle.tree import Coordinate, Vehicle

HEADING = Label("heading", "rad", "counter-clockwise angle of the right axis from the x axis")
ROLL = Label("roll", "rad", "angle about the forward axis, positive with the right side down")
PITCH = Label("pitch", "rad", "angle about the right axis, positive with the nose up")


def labels_of(vehicle: Vehicle, law: Any = (), *, follow: bool = True) -> Labels:
    """Return the labels of a closure model, except those of the equations of its rates.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    law : record of Label
        Labels of the unknowns of the slip law or wheel-ground law.
    follow : bool
        Whether the contact forces of a vehicle with mass are unknowns of the model. Otherwise the
        wheel-ground law gives them, and tangential forces are outputs.
    """
    rates = _rate_labels(vehicle, law)
    x = Configuration(
        Label("x", "m", "easting of the platform's centre"),
        Label("y", "m", "northing of the platform's centre"),
        HEADING,
        tuple(_coordinate(vehicle, c) for c in vehicle.coordinates if c.kind != "suspension"),
    )
    contacts = zip(
        wheel_labels(vehicle, "contact_x", "m", "easting of the contact point"),
        wheel_labels(vehicle, "contact_y", "m", "northing of the contact point"),
        strict=True,
    )
    position = Dependent(
        Label("z", "m", "height of the platform's centre"),
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
    words = "angle through which the wheel has turned"
    work = Label("work", "J", "work of the drives and actuators")
    q = Totals(wheel_labels(vehicle, "wheel_angle", "rad", words), (work,) if vehicle.mass else ())
    closures = component_labels(vehicle, "closure", "m", "contact condition")
    forces, equations = _force_labels(vehicle, rates) if follow else (Forces(), ())
    are_unknown = any(label.name == ALONG[0] for label in leaves((law, forces)))
    y = _output_labels(vehicle, follow=are_unknown)
    z = Algebraic(position, rates, forces)
    return Labels(x, z, q, u, y, (closures, (), equations))


def pressed_labels(vehicle: Vehicle) -> dict[str, tuple[Label, ...]]:
    """Return the labels of the outputs of wheels that press into the ground, by field."""
    return {
        "depth": wheel_labels(vehicle, "depth", "m", "depth below the ground; negative in the air"),
        "load_share": wheel_labels(
            vehicle, "load_share", "1", "normal force divided by an equal share of the weight"
        ),
        "force_normal": wheel_labels(vehicle, *NORMAL) if vehicle.mass else (),
    }


def slip_ratio_labels(vehicle: Vehicle) -> tuple[Label, ...]:
    """Return the labels of the slip ratios of the wheels."""
    words = "rim speed minus speed of the wheel's centre, divided by the larger of the two"
    return wheel_labels(vehicle, "slip_ratio", "1", words)


def _turning(name: str, words: str) -> Label:
    return Label(f"{name}_rate", "rad s-1", f"rate of {words}")


def _coordinate(vehicle: Vehicle, c: Coordinate) -> Label:
    return Label(c.name, vehicle.unit(c.name), c.words)


def _rate(vehicle: Vehicle, c: Coordinate) -> Label:
    return Label(f"{c.name}_rate", f"{vehicle.unit(c.name)} s-1", f"rate of {c.words}")


def _rate_labels(vehicle: Vehicle, law: Any) -> Rates:
    velocity = [
        Label(f"velocity_{axis}", "m s-1", f"velocity of the platform's centre along {axis}")
        for axis in "xyz"
    ]
    angles = [_turning(label.name, label.words) for label in (HEADING, ROLL, PITCH)]
    free = [wheel.name for wheel in vehicle.wheels if not wheel.driven]
    return Rates(
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


def _force_labels(vehicle: Vehicle, rates: Rates) -> tuple[Forces, tuple[Label, ...]]:
    """Return the labels of the forces that follow from a motion, and of their equations."""
    if not vehicle.mass:
        return Forces(), ()
    equilibrium = equilibrium_labels(rates)
    normal = wheel_labels(vehicle, *NORMAL)
    if is_determinate(vehicle):
        along, across = wheel_labels(vehicle, *ALONG), wheel_labels(vehicle, *ACROSS)
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
    def each(name: str, unit: str, words: str) -> tuple[Label, ...]:
        return wheel_labels(vehicle, name, unit, words)

    return Outputs(
        each("contact_z", "m", "height of the contact point"),
        each("center_x", "m", "easting of the wheel's centre"),
        each("center_y", "m", "northing of the wheel's centre"),
        each("center_z", "m", "height of the wheel's centre"),
        each("slip_along", "m s-1", "slip along the wheel, negative if it turns too fast"),
        each("slip_across", "m s-1", "slip across the wheel, positive to the right"),
        each("wheel_rate", "rad s-1", "rate of the wheel, positive forward"),
        each(
            "wheel_u", "rad", "contact coordinate u of the wheel, pi/2 at the middle of the tread"
        ),
        each("wheel_v", "rad", "contact coordinate v of the wheel in its carrier"),
        each("psi", "rad", "angle from the wheel's Gauss x axis to the ground's Gauss x axis"),
        Label("yaw", "rad", "angle of the forward axis from the x axis, counter-clockwise"),
        tuple(
            Label(f"quaternion_{axis}", "1", f"{axis} of the platform's quaternion (x forward)")
            for axis in "xyzw"
        ),
        _force_output_labels(vehicle, follow=follow) if vehicle.mass else (),
    )


def effort_label(vehicle: Vehicle, c: Coordinate) -> Label:
    """Return the label of the torque or force of the actuator of a commanded coordinate."""
    kind, unit = ("torque", "N m") if vehicle.unit(c.name) == "rad" else ("force", "N")
    return Label(f"{c.name}_{kind}", unit, f"{kind} of the actuator of {c.words}")


def _force_output_labels(vehicle: Vehicle, *, follow: bool) -> ForceOutputs:
    return ForceOutputs(
        () if follow else wheel_labels(vehicle, *ALONG),
        () if follow else wheel_labels(vehicle, *ACROSS),
        wheel_labels(vehicle, "friction_needed", "1", "ratio of tangential to normal force"),
        wheel_labels(
            vehicle, "utilisation", "1", "friction needed divided by the friction coefficient"
        ),
        wheel_labels(
            vehicle, "drive_torque", "N m", "torque of the wheel's drive, positive forward"
        ),
        tuple(effort_label(vehicle, c) for c in vehicle.of("commanded")),
        Label("power", "W", "power of the drives and actuators"),
        Label("dissipation", "W", "power dissipated in contacts and dampers"),
        Label(
            "potential_energy",
            "J",
            "energy of gravity, relative to the ground's origin, and of springs",
        ),
        Label(
            "tip_over_margin", "rad", "angle by which gravity may tilt before the vehicle tips over"
        ),
    )
