"""Records of a climbing vehicle's model, and their labels."""

from __future__ import annotations

from typing import Any, NamedTuple

from slipfree.climb.control import Driver
from slipfree.climb.reference import PerAxle, Tilts
from slipfree.climb.vehicle import AXLES
from slipfree.dae import Labels
from slipfree.records import Label
from slipfree.terrain.solids import Profile


class State(NamedTuple):
    """States of the motion.

    Attributes
    ----------
    x, z : scalar
        Position of the joint. [m]
    tilts : Tilts
        Tilts of the bodies, nose up. [rad]
    velocity_x, velocity_z : scalar
        Velocity of the joint. [m/s]
    rates : Tilts
        Rates of the tilts. [rad/s]
    spins : PerAxle
        Rates of the wheels, forward positive. [rad/s]
    integrals : PerAxle or ()
        Integrals of the errors of the wheel rates. [rad]
    directions : PerAxle or ()
        Smoothed estimates of the axles' directions. [rad]
    lagging : PerAxle or ()
        Filtered errors of the wheel rates, for the derivative gain. [rad/s]
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
    """Time integrals along a motion.

    Attributes
    ----------
    wheel_angles : PerAxle
        Rotation angles of the wheels. [rad]
    work : scalar
        Work of the motors. [J]
    rubbed, damped : scalar
        Energy dissipated by friction and by damping of the contacts. [J]
    """

    wheel_angles: PerAxle
    work: Any
    rubbed: Any
    damped: Any


class Inputs(NamedTuple):
    """Reference speed of the vehicle [m/s], and torques of a sampled controller [N m]."""

    speed: Any
    torques: PerAxle | tuple[()]


class OnSolid(NamedTuple):
    """Contacts of all axles with one solid; fields as those of `SolidContact` with their names."""

    gap: PerAxle
    load: PerAxle
    friction: PerAxle
    slip: PerAxle


class Outputs(NamedTuple):
    """Outputs of the model along a motion.

    Attributes
    ----------
    axle_x, axle_z, axle_velocity_x, axle_velocity_z : PerAxle
        Positions and velocities of the axles. [m, m/s]
    directions : PerAxle
        Angles of the directions in which the axles can move over their contacts. [rad]
    references : PerAxle
        Reference rates of the wheels. [rad/s]
    torques : PerAxle
        Torques of the motors. [N m]
    scale : SX
        Factor by which the limit of the motors scales all torques. [1]
    solids : tuple of OnSolid
        Contacts with each solid.
    energy : SX
        Kinetic and potential energy. [J]
    """

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
    """Return the labels of all records of a climb's model."""
    joint, tilt = "of the joint", "tilt of the {} body, nose up positive"
    x = State(
        Label("x", "m", f"forward position {joint}"),
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
        _each("direction_seen", "rad", "smoothed estimate of the axle's direction from sensors")
        if control.senses
        else (),
        _each("error_lag", "rad s-1", "filtered error of the wheels' rate, for the derivative gain")
        if control.derivative
        else (),
    )
    q = Totals(
        _each("wheel_angle", "rad", "angle through which the wheels have turned"),
        Label("work", "J", "work of the motors"),
        Label("rubbed", "J", "energy dissipated by friction"),
        Label("damped", "J", "energy dissipated by damping"),
    )
    held = (
        _each("torque_held", "N m", "torque of a wheel's motor, held between samples")
        if sampled
        else ()
    )
    u = Inputs(Label("speed", "m s-1", "reference speed of the vehicle"), held)
    y = Outputs(
        _each("axle_x", "m", "forward position of the axle"),
        _each("axle_z", "m", "height of the axle"),
        _each("axle_velocity_x", "m s-1", "forward velocity of the axle"),
        _each("axle_velocity_z", "m s-1", "upward velocity of the axle"),
        _each("direction", "rad", "direction in which the axle can move over its contacts"),
        _each("reference", "rad s-1", "reference of the wheels' rate"),
        _each("torque", "N m", "commanded torque of a wheel's motor"),
        Label("torque_scale", "1", "scale factor of all torques due to the motors' limit"),
        tuple(_solid_labels(k) for k in range(len(profile.solids))),
        Label(
            "energy", "J", "kinetic and potential energy, that of the contacts' springs included"
        ),
    )
    return Labels(x, (), q, u, y, ())


def _solid_labels(k: int) -> OnSolid:
    solid = f"solid {k}" if k else "the floor"
    return OnSolid(
        _each(f"gap_{k}", "m", f"gap of the wheels to {solid}, negative where they penetrate it"),
        _each(f"load_{k}", "N", f"normal force of {solid} on the axle's wheels"),
        _each(f"friction_{k}", "N", f"tangential force of {solid} on the axle's wheels, forward"),
        _each(
            f"slip_{k}", "m s-1", f"slip of the wheels over {solid}, negative if they turn too fast"
        ),
    )
