"""Labels of everything that a vehicle's models hold: names, units and words."""

from __future__ import annotations

from slipfree.dae import Labels
from slipfree.errors import ModelError
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
    SlipLaw,
    Totals,
    is_determinate,
)
from slipfree.records import Label, leaves
from slipfree.vehicle.tree import Coordinate, Vehicle

HEADING = Label("heading", "rad", "counter-clockwise angle of the right axis from the x axis")
ROLL = Label("roll", "rad", "angle about the forward axis, right side down positive")
PITCH = Label("pitch", "rad", "angle about the right axis, nose up positive")
ALONG = "force_along", "N", "force of the ground on the wheel along it, forward positive"
ACROSS = "force_across", "N", "force of the ground on the wheel across it, to the right positive"
NORMAL = "force_normal", "N", "force of the ground on the wheel along the normal"
TRACTION = (
    NORMAL,
    ("friction_used_along", "1", "part of the friction that is used along the wheel"),
    ("friction_used_across", "1", "part of the friction that is used across the wheel"),
)


def labels_of(vehicle: Vehicle, slip: SlipLaw) -> Labels:
    """Return names, units and words of all unknowns and equations of the closure model.

    Raises
    ------
    ModelError
        If ``slip`` is rolling and the vehicle has too few or too many freedoms for it, or traction
        and it has no mass.
    """
    rates = _rate_labels(vehicle, slip)
    x = Configuration(
        Label("x", "m", "easting of the platform's centre"),
        Label("y", "m", "northing of the platform's centre"),
        HEADING,
        tuple(_coordinate(vehicle, c) for c in vehicle.coordinates if c.kind != "suspension"),
    )
    contacts = zip(
        _each(vehicle, "contact_x", "m", "easting of the contact point"),
        _each(vehicle, "contact_y", "m", "northing of the contact point"),
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
        tuple(_turning(name, f"the driven wheel {name}, forward positive") for name in driven),
        tuple(_rate(vehicle, c) for c in vehicle.of("commanded")),
    )
    words = "angle through which the wheel has turned"
    work = Label("work", "J", "work of the drives and actuators")
    q = Totals(_each(vehicle, "wheel_angle", "rad", words), (work,) if vehicle.mass else ())
    closures = _components(vehicle, "closure", "m", "contact condition")
    balance = _balance_labels(vehicle, rates, slip)
    y = _output_labels(vehicle, slip)
    forces, equilibrium = _force_labels(vehicle, rates, slip)
    z = Algebraic(position, rates, forces)
    return Labels(x, z, q, u, y, (closures, balance, equilibrium))


def _each(vehicle: Vehicle, name: str, unit: str, words: str) -> tuple[Label, ...]:
    return tuple(Label(name, unit, words, wheel.name) for wheel in vehicle.wheels)


def _components(vehicle: Vehicle, name: str, unit: str, words: str) -> tuple[Label, ...]:
    return tuple(
        Label(name, unit, f"{axis} component of the {words}", wheel.name)
        for wheel in vehicle.wheels
        for axis in "xyz"
    )


def _turning(name: str, words: str) -> Label:
    return Label(f"{name}_rate", "rad s-1", f"rate of {words}")


def _coordinate(vehicle: Vehicle, c: Coordinate) -> Label:
    return Label(c.name, vehicle.unit(c.name), c.words)


def _rate(vehicle: Vehicle, c: Coordinate) -> Label:
    return Label(f"{c.name}_rate", f"{vehicle.unit(c.name)} s-1", f"rate of {c.words}")


def _rate_labels(vehicle: Vehicle, slip: SlipLaw) -> Rates:
    velocity = [
        Label(f"velocity_{axis}", "m s-1", f"velocity of the platform's centre along {axis}")
        for axis in "xyz"
    ]
    angles = [_turning(label.name, label.words) for label in (HEADING, ROLL, PITCH)]
    free = [wheel.name for wheel in vehicle.wheels if not wheel.driven]
    words = "multiplier of the contact in the least-slip condition"
    multipliers = _each(vehicle, "multiplier", "m s-1", words) if slip == "least" else ()
    forces = [_each(vehicle, *each) for each in TRACTION] if slip == "traction" else []
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
        multipliers,
        *forces,
    )


def _force_labels(
    vehicle: Vehicle, rates: Rates, slip: SlipLaw
) -> tuple[Forces, tuple[Label, ...]]:
    """Return the labels of the forces that follow from a motion, and of their equations."""
    if not vehicle.mass or slip == "traction":
        return Forces(), ()
    equilibrium = _equilibrium_labels(rates)
    along, across, normal = (_each(vehicle, *each) for each in (ALONG, ACROSS, NORMAL))
    if is_determinate(vehicle):
        return Forces(along, across, normal), equilibrium
    virtual = tuple(
        Label(
            f"virtual_{each.name}", "1" if "m s-1" in each.unit else "m-1", f"virtual {each.words}"
        )
        for each in leaves(rates.motion)
    )
    shared = _components(vehicle, "distribution", "1", "law that distributes the forces")
    return Forces(along, across, normal, virtual), (*equilibrium, *shared)


def _equilibrium_labels(rates: Rates) -> tuple[Label, ...]:
    """Return the labels of the equations of equilibrium, one for each rate."""
    return tuple(
        Label(
            f"equilibrium_{label.name.removesuffix('_rate')}",
            "1" if label.unit == "m s-1" else "m",
            f"equilibrium with respect to {label.words.removeprefix('rate of ')}",
        )
        for label in leaves(rates.motion)
    )


def slip_unit(unit: str) -> str:
    """Return the unit of the derivative of a squared slip velocity in a rate of another unit."""
    return {"m s-1": "m s-1", "rad s-1": "m2 s-1", "m2 s-1": "rad s-1"}[unit]


def _balance_labels(vehicle: Vehicle, rates: Rates, slip: SlipLaw) -> tuple[Label, ...]:
    """Return the labels of the equations for the rates; refuse what cannot roll."""
    if slip == "least":
        return tuple(
            Label("least_slip", slip_unit(label.unit), f"least slip with respect to {label.full}")
            for label in leaves(rates)
        )
    if slip == "traction":
        touching = _each(vehicle, "touching", "m s-1", "normal velocity of the contact point")
        friction = [
            _each(vehicle, f"friction_{axis}", "m s-1", f"law of friction {axis} the wheel")
            for axis in ("along", "across")
        ]
        return (*_equilibrium_labels(rates), *touching, *friction[0], *friction[1])
    given, needed = len(rates.passive) + len(rates.free), 2 * len(vehicle.wheels) - 3
    if any(wheel.rollers for wheel in vehicle.wheels):
        raise ModelError(
            f"{vehicle.name} has wheels with rollers, whose motion is that of least slip: use "
            "slip='least'"
        )
    if given != needed:
        raise ModelError(
            f"{vehicle.name} cannot be made to roll: {needed} conditions of no slip need as many "
            f"passive joints and free wheels, found {given}; use slip = 'least'"
        )
    return _components(vehicle, "no_slip", "m s-1", "slip")


def _output_labels(vehicle: Vehicle, slip: SlipLaw) -> Outputs:
    def each(name: str, unit: str, words: str) -> tuple[Label, ...]:
        return _each(vehicle, name, unit, words)

    return Outputs(
        each("contact_z", "m", "height of the contact point"),
        each("center_x", "m", "easting of the wheel's centre"),
        each("center_y", "m", "northing of the wheel's centre"),
        each("center_z", "m", "height of the wheel's centre"),
        each("slip_along", "m s-1", "slip along the wheel, negative when it spins"),
        each("slip_across", "m s-1", "slip across the wheel, to the right positive"),
        each("wheel_rate", "rad s-1", "rate of the wheel, forward positive"),
        each(
            "wheel_u", "rad", "contact coordinate u of the torus, pi/2 in the middle of the tread"
        ),
        each("wheel_v", "rad", "contact coordinate v of the torus in its carrier"),
        each("psi", "rad", "angle that takes the wheel's Gauss x axis to the ground's"),
        Label("yaw", "rad", "angle of the forward axis from the x axis, counter-clockwise"),
        tuple(
            Label(f"quaternion_{axis}", "1", f"{axis} of the platform's quaternion (x forward)")
            for axis in "xyzw"
        ),
        _force_output_labels(vehicle, slip) if vehicle.mass else (),
    )


def _force_output_labels(vehicle: Vehicle, slip: SlipLaw) -> ForceOutputs:
    def effort(name: str, words: str) -> Label:
        turns = vehicle.unit(name) == "rad"
        kind, unit = ("torque", "N m") if turns else ("force", "N")
        return Label(f"{name}_{kind}", unit, f"{kind} of the actuator of {words}")

    return ForceOutputs(
        _each(vehicle, *ALONG) if slip == "traction" else (),
        _each(vehicle, *ACROSS) if slip == "traction" else (),
        _each(vehicle, "friction_needed", "1", "tangential over normal force"),
        _each(vehicle, "utilisation", "1", "friction that is needed over what the ground offers"),
        _each(vehicle, "drive_torque", "N m", "torque of the wheel's drive, forward positive"),
        tuple(effort(c.name, c.words) for c in vehicle.of("commanded")),
        Label("power", "W", "power of the drives and actuators"),
        Label("dissipation", "W", "power that contacts and dampers take from the drives"),
        Label(
            "potential_energy", "J", "energy of height, from the ground's origin, and of springs"
        ),
        Label(
            "tip_over_margin", "rad", "angle by which gravity may lean before the vehicle tips over"
        ),
    )
