"""Records of a climb: what its model holds, and what each of it is called."""

from __future__ import annotations

from typing import Any, NamedTuple

from slipfree.climb.control import Driver
from slipfree.climb.profile import Profile
from slipfree.climb.reference import PerAxle, Tilts
from slipfree.climb.vehicle import AXLES
from slipfree.dae import Labels
from slipfree.records import Label


class State(NamedTuple):
    """States of the motion.

    Attributes
    ----------
    x, z : scalar
        Place of the joint. [m]
    tilts : Tilts
        Of the bodies, nose up. [rad]
    velocity_x, velocity_z : scalar
        Of the joint. [m/s]
    rates : Tilts
        Of the tilts. [rad/s]
    spins : PerAxle
        Rates of the wheels, forward positive. [rad/s]
    integrals : PerAxle or ()
        Of the errors of these. [rad]
    directions : PerAxle or ()
        Of the axles, as the sensors see them, smoothed. [rad]
    lagging : PerAxle or ()
        Errors of the rates behind the filter of a derivative. [rad/s]
    """

    x: Any
    z: Any
    tilts: Tilts
    velocity_x: Any
    velocity_z: Any
    rates: Tilts
    spins: PerAxle
    integrals: PerAxle | tuple[()]
    directions: PerAxle | tuple[()]
    lagging: PerAxle | tuple[()]


class Totals(NamedTuple):
    """What sums up over time: turns of the wheels [rad], and energies [J]."""

    wheel_angles: PerAxle
    work: Any
    rubbed: Any
    damped: Any


class Inputs(NamedTuple):
    """Reference speed of the vehicle [m/s], and torques held by a sampled controller [N m]."""

    speed: Any
    torques: PerAxle | tuple[()]


class OnSolid(NamedTuple):
    """What one solid does to the wheels of each axle; see `slipfree.climb.contact.Pressed`."""

    gap: PerAxle
    load: PerAxle
    friction: PerAxle
    slip: PerAxle


class Outputs(NamedTuple):
    """What is sampled along a motion."""

    axle_x: PerAxle
    axle_z: PerAxle
    axle_velocity_x: PerAxle
    axle_velocity_z: PerAxle
    directions: PerAxle
    references: PerAxle
    torques: PerAxle
    scale: Any
    solids: tuple[OnSolid, ...]
    energy: Any


def _each(name: str, unit: str, words: str) -> PerAxle:
    return PerAxle(*(Label(name, unit, words, axle) for axle in AXLES))


def labels_of(profile: Profile, control: Driver, *, sampled: bool) -> Labels:
    """Return names, units and words of all that a climb's model holds."""
    joint, tilt = "of the joint", "tilt of the {} body, nose up positive"
    x = State(
        Label("x", "m", f"place {joint}, forward"),
        Label("z", "m", f"height {joint}"),
        Tilts(*(Label(f"tilt_{name}", "rad", tilt.format(name)) for name in ("rear", "front"))),
        Label("velocity_x", "m s-1", f"forward velocity {joint}"),
        Label("velocity_z", "m s-1", f"upward velocity {joint}"),
        Tilts(
            *(
                Label(f"tilt_{name}_rate", "rad s-1", f"rate of the {tilt.format(name)}")
                for name in ("rear", "front")
            )
        ),
        _each("wheel_rate", "rad s-1", "rate of the wheels, forward positive"),
        _each("error_sum", "rad", "integral of the error of the wheels' rate")
        if control.integral
        else (),
        _each("direction_seen", "rad", "direction of the axle that the sensors see, smoothed")
        if control.senses
        else (),
        _each("error_lag", "rad s-1", "error of the wheels' rate behind the derivative's filter")
        if control.derivative
        else (),
    )
    q = Totals(
        _each("wheel_angle", "rad", "angle through which the wheels have turned"),
        Label("work", "J", "work of the motors"),
        Label("rubbed", "J", "energy lost to friction"),
        Label("damped", "J", "energy lost to damping"),
    )
    held = _each("torque_held", "N m", "torque of a wheel's motor, held") if sampled else ()
    u = Inputs(Label("speed", "m s-1", "reference speed of the vehicle"), held)
    y = Outputs(
        _each("axle_x", "m", "place of the axle, forward"),
        _each("axle_z", "m", "height of the axle"),
        _each("axle_velocity_x", "m s-1", "forward velocity of the axle"),
        _each("axle_velocity_z", "m s-1", "upward velocity of the axle"),
        _each("direction", "rad", "direction in which the contacts let the axle go"),
        _each("reference", "rad s-1", "reference of the wheels' rate"),
        _each("torque", "N m", "torque that a wheel's motor is asked for"),
        Label("torque_scale", "1", "scale of all torques that keeps them within the motors' limit"),
        tuple(_solid_labels(k) for k in range(len(profile.solids))),
        Label(
            "energy", "J", "kinetic and potential energy, that of the contacts' springs included"
        ),
    )
    return Labels(x, (), q, u, y, ())


def _solid_labels(k: int) -> OnSolid:
    solid = f"solid {k}" if k else "the floor"
    return OnSolid(
        _each(f"gap_{k}", "m", f"gap of the wheels to {solid}, negative where they reach into it"),
        _each(f"load_{k}", "N", f"normal force of {solid} on the axle's wheels"),
        _each(f"friction_{k}", "N", f"tangential force of {solid} on the axle's wheels, forward"),
        _each(f"slip_{k}", "m s-1", f"slip of the wheels over {solid}, negative when they spin"),
    )
