"""Direct kinematics: how given wheel and joint rates move a vehicle over the ground."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.certify import SecondTouch
from slipfree.contact.closure import (
    Touch,
    closure,
    relative_curvature,
    touch,
    wheel_coordinates,
)
from slipfree.dae import Dae, Labels, Limit
from slipfree.errors import ModelError
from slipfree.geometry.frame import Pose, platform, quaternion
from slipfree.kinematics.slip import least_slip, slip_velocity
from slipfree.named import Label, leaves, pack, symbols
from slipfree.terrain.base import Terrain
from slipfree.vehicle.chain import Coordinate, Vehicle

SlipLaw = Literal["least", "rolling"]
FLAT = 0.1  # a wheel whose axle is within asin(0.1) = 6 degrees of the normal lies flat
OVERTURNED = 0.1  # likewise for the platform's up axis and the horizontal


class Configuration(NamedTuple):
    """Differential states: place, heading, and the joints that do not yield to the ground.

    ``joints`` are the commanded and the passive coordinates in the vehicle's order. [m, rad]
    """

    x: Any
    y: Any
    heading: Any
    joints: tuple[Any, ...]


class Contact(NamedTuple):
    """Ground coordinates of a contact point, ``u_g`` and ``v_g``. [m]."""

    x: Any
    y: Any


class Dependent(NamedTuple):
    """What the ground decides, given a configuration. [m, rad]."""

    z: Any
    roll: Any
    pitch: Any
    suspension: tuple[Any, ...]
    contacts: tuple[Contact, ...]


class Rates(NamedTuple):
    """Rates of all that is not commanded, and the multipliers of the contacts. [m/s, rad/s].

    ``passive`` are those of the passive coordinates, ``free`` those of the wheels without drive.
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
    multipliers: tuple[Any, ...]


class Algebraic(NamedTuple):
    """Algebraic unknowns in the two blocks that determine them."""

    position: Dependent
    rates: Rates


class Inputs(NamedTuple):
    """Rates of the driven wheels and of the commanded coordinates, in their order. [rad/s]."""

    wheels: tuple[Any, ...]
    joints: tuple[Any, ...]


class Angles(NamedTuple):
    """Quadratures: the angles through which the wheels have turned. [rad]."""

    wheels: tuple[Any, ...]


class Outputs(NamedTuple):
    """What else is sampled along a motion; positions in map coordinates.

    ``quaternion`` (x, y, z, w) and ``yaw`` are those of the platform with x forward, y left, z up.
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


def direct_kinematics(
    vehicle: Vehicle, terrain: Terrain, *, slip: SlipLaw = "least"
) -> Dae[Configuration, Algebraic, Angles, Inputs, Outputs]:
    """Return the motion of a vehicle over a ground under given rates, with the least slip.

    Positions follow from closure: every wheel touches the ground, three equations in its two
    contact coordinates and the pose. Rates follow from the least slip that closure allows; if the
    vehicle can roll without slip, as the tilting three-wheeler can, that is its motion.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    terrain : Terrain
        The ground; contacts keep to its domain.
    slip : {"least", "rolling"}
        Least slip, for every vehicle; or none at all, for those whose passive joints and free
        wheels are as many as the conditions, ``2 n_wheels - 3``.

    Returns
    -------
    Dae
        Inputs are the rates of the driven wheels and of the commanded coordinates.

    Raises
    ------
    ModelError
        If the vehicle has too few or too many freedoms to roll without slip and that is asked.
    """
    labels = _labels(vehicle, slip)
    x, z, u, t = symbols(labels.x), symbols(labels.z), symbols(labels.u), ca.SX.sym("t")
    carriers = _carriers(vehicle, x, z.position)
    contacts = [
        touch(terrain, place.x, place.y, carrier.rotation[:, 0])
        for place, carrier in zip(z.position.contacts, carriers, strict=True)
    ]
    spins = _spins(vehicle, z.rates, u)
    joint_rates = _joint_rates(vehicle, z.rates, u)
    q = pack((*x, z.position[:4]))
    q_dot = pack((*z.rates[:2], z.rates.heading, joint_rates, z.rates.z, *z.rates[4:7]))
    slips = [slip_velocity(carrier, contact, q, q_dot, spin)
             for carrier, contact, spin in zip(carriers, contacts, spins, strict=True)]  # fmt: skip
    position = _closures(vehicle, x, z.position, carriers, contacts)
    normals = [contact.normal for contact in contacts]
    if slip == "least":
        balance = least_slip(slips, normals, pack(z.rates[:-1]), pack(z.rates.multipliers))
    else:
        balance = ca.vertcat(*slips)
    pose_of = _touch_function(x, z, carriers, contacts)
    scale, shift = _sizes(vehicle, terrain, labels)
    return Dae(
        t, x, z, symbols(labels.q), u,
        ode=ca.vertcat(z.rates.x, z.rates.y, z.rates.heading, *joint_rates),
        alg=(position, balance),
        quad=ca.vertcat(*spins),
        y=_outputs(terrain, carriers, contacts, slips, spins, x, z),
        labels=labels,
        limits=(*_stops(vehicle, x, z), *_contact_limits(vehicle, terrain, contacts)),
        checks=tuple(
            SecondTouch(terrain, wheel, pose_of[index])
            for index, wheel in enumerate(vehicle.wheels)
        ),
        guess=_guess(vehicle, terrain, x, labels),
        scale=scale,
        shift=shift,
    )  # fmt: skip


def _kept(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the names of the coordinates that are differential states."""
    return tuple(c.name for c in vehicle.coordinates if c.kind != "suspension")


def _carriers(vehicle: Vehicle, x: Configuration, position: Dependent) -> tuple[Pose, ...]:
    names = (*_kept(vehicle), *(c.name for c in vehicle.of("suspension")))
    values = dict(zip(names, (*x.joints, *position.suspension), strict=True))
    base = platform(x.x, x.y, position.z, x.heading, position.roll, position.pitch)
    return vehicle.carriers(base, values)


def _closures(
    vehicle: Vehicle,
    x: Configuration,
    position: Dependent,
    carriers: tuple[Pose, ...],
    contacts: list[Touch],
) -> ca.SX:
    """Return the closures of all wheels, from the platform's centre.

    Subtracted before anything is added to them, large coordinates cost no digits.
    """
    level = x._replace(x=ca.SX(0), y=ca.SX(0))
    arms = [pose.origin for pose in _carriers(vehicle, level, position._replace(z=ca.SX(0)))]
    center = ca.vertcat(x.x, x.y, position.z)
    return ca.vertcat(
        *(
            closure(wheel, Pose(carrier.rotation, arm), each._replace(point=each.point - center))
            for wheel, carrier, arm, each in zip(
                vehicle.wheels, carriers, arms, contacts, strict=True
            )
        )
    )


def _spins(vehicle: Vehicle, rates: Rates, u: Inputs) -> list[ca.SX]:
    driven, free = iter(u.wheels), iter(rates.free)
    return [next(driven) if wheel.driven else next(free) for wheel in vehicle.wheels]


def _joint_rates(vehicle: Vehicle, rates: Rates, u: Inputs) -> tuple[ca.SX, ...]:
    commanded, passive = iter(u.joints), iter(rates.passive)
    kinds = [c.kind for c in vehicle.coordinates if c.kind != "suspension"]
    return tuple(next(commanded) if kind == "commanded" else next(passive) for kind in kinds)


def _outputs(
    terrain: Terrain,
    carriers: tuple[Pose, ...],
    contacts: list[Touch],
    slips: list[ca.SX],
    spins: list[ca.SX],
    x: Configuration,
    z: Algebraic,
) -> Outputs:
    o_x, o_y, o_z = terrain.origin
    base = platform(x.x, x.y, z.position.z, x.heading, z.position.roll, z.position.pitch).rotation
    on_wheels = zip(*(wheel_coordinates(*each) for each in zip(carriers, contacts, strict=True)),
                    strict=True)  # fmt: skip
    wheel_u, wheel_v, psi = (tuple(values) for values in on_wheels)
    forward_left_up = ca.horzcat(base[:, 1], -base[:, 0], base[:, 2])
    return Outputs(
        contact_z=tuple(c.point[2] + o_z for c in contacts),
        center_x=tuple(c.origin[0] + o_x for c in carriers),
        center_y=tuple(c.origin[1] + o_y for c in carriers),
        center_z=tuple(c.origin[2] + o_z for c in carriers),
        slip_along=tuple(ca.dot(c.along, s) for c, s in zip(contacts, slips, strict=True)),
        slip_across=tuple(ca.dot(c.across, s) for c, s in zip(contacts, slips, strict=True)),
        wheel_rate=tuple(spins),
        wheel_u=wheel_u,
        wheel_v=wheel_v,
        psi=psi,
        yaw=ca.atan2(base[1, 1], base[0, 1]),
        quaternion=tuple(ca.vertsplit(quaternion(forward_left_up))),
    )


def _touch_function(
    x: Configuration, z: Algebraic, carriers: tuple[Pose, ...], contacts: list[Touch]
) -> list[ca.Function]:
    """Return, for every wheel, centre, rotation and contact point as functions of the states."""
    inputs = [pack(x), pack(z)]
    return [
        ca.Function("wheel", inputs, [carrier.origin, ca.vec(carrier.rotation), contact.point])
        for carrier, contact in zip(carriers, contacts, strict=True)
    ]


def _stops(vehicle: Vehicle, x: Configuration, z: Algebraic) -> Iterator[Limit]:
    """Yield the limits that concern the vehicle alone."""
    values = dict(zip(_kept(vehicle), x.joints, strict=True))
    values |= {
        c.name: value
        for c, value in zip(vehicle.of("suspension"), z.position.suspension, strict=True)
    }
    for c in vehicle.coordinates:
        if np.isfinite(c.lower) or np.isfinite(c.upper):
            words = f"the stop of {c.name} ({c.words}) is reached"
            yield Limit(
                Label(f"{c.name}_stop", vehicle.unit(c.name), words),
                values[c.name],
                c.lower,
                c.upper,
            )
    upright = ca.cos(z.position.roll) * ca.cos(z.position.pitch)
    words = "the platform is overturned (cosine of its inclination)"
    yield Limit(Label("upright", "1", words), upright, OVERTURNED, np.inf)


def _contact_limits(vehicle: Vehicle, terrain: Terrain, contacts: list[Touch]) -> Iterator[Limit]:
    """Yield the limits of every wheel on the ground."""
    west, east, south, north = terrain.domain
    o_x, o_y, _ = terrain.origin
    for wheel, contact in zip(vehicle.wheels, contacts, strict=True):
        u_g, v_g = contact.point[0], contact.point[1]
        if np.isfinite(terrain.domain).all():
            inside = ca.fmin(
                ca.fmin(u_g - (west - o_x), (east - o_x) - u_g),
                ca.fmin(v_g - (south - o_y), (north - o_y) - v_g),
            )
            words = (
                f"wheel {wheel.name} leaves the map, which reaches from {west:.2f} to {east:.2f} m "
                f"in x and from {south:.2f} to {north:.2f} m in y (distance to its edge)"
            )
            yield Limit(Label("map_margin", "m", words, wheel.name), inside, 0.0, np.inf)
        words = f"wheel {wheel.name} lies flat on the ground (sine of axle to normal)"
        label = Label("uprightness", "1", words, wheel.name)
        yield Limit(label, contact.uprightness, FLAT, np.inf)
        words = (
            f"the ground under wheel {wheel.name} is more concave than the wheel, so that its "
            "contact is not unique; terrain.rolled(radius) gives the ground as the wheel feels it "
            "(relative curvature)"
        )
        label = Label("relative_curvature", "m-1", words, wheel.name)
        yield Limit(label, relative_curvature(wheel, contact), 0.0, np.inf)


def _guess(vehicle: Vehicle, terrain: Terrain, x: Configuration, labels: Labels) -> ca.SX:
    """Return a level platform at the mean height of its wheels, contacts below their centres."""
    level = Dependent(0, 0, 0, tuple(0 for _ in vehicle.of("suspension")), ())
    centers = [carrier.origin for carrier in _carriers(vehicle, x, level)]
    lifts = [
        terrain.height(c[0], c[1]) + wheel.radius - c[2]
        for c, wheel in zip(centers, vehicle.wheels, strict=True)
    ]
    places = [c[:2] for c in centers]
    rest = ca.SX.zeros(len(level.suspension) + 2)
    rates = ca.SX.zeros(len(list(leaves(labels.z.rates))))
    return ca.densify(ca.vertcat(sum(lifts) / len(lifts), rest, *places, rates))


def _sizes(
    vehicle: Vehicle, terrain: Terrain, labels: Labels
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return typical sizes of z, and what leads from local to map coordinates."""
    radius = min(wheel.radius for wheel in vehicle.wheels)
    scale = np.array([radius if each.unit in ("m", "m s-1") else 1.0 for each in leaves(labels.z)])
    place = dict(zip(("x", "y", "z"), terrain.origin, strict=True))
    place |= {f"contact_{axis}": place[axis] for axis in ("x", "y")}
    shift = tuple(
        np.array([place.get(each.name, 0.0) for each in leaves(record)])
        for record in (labels.x, labels.z)
    )
    return scale, (shift[0], shift[1])


def _labels(vehicle: Vehicle, slip: SlipLaw) -> Labels:
    def each(name: str, unit: str, words: str) -> tuple[Label, ...]:
        return tuple(Label(name, unit, words, wheel.name) for wheel in vehicle.wheels)

    def turning(name: str, words: str) -> Label:
        return Label(f"{name}_rate", "rad s-1", f"rate of {words}")

    def angle(name: str, words: str) -> Label:
        return Label(name, "rad", words)

    def coordinate(c: Coordinate) -> Label:
        return Label(c.name, vehicle.unit(c.name), c.words)

    def rate(c: Coordinate) -> Label:
        return Label(f"{c.name}_rate", f"{vehicle.unit(c.name)} s-1", f"rate of {c.words}")

    free = [w.name for w in vehicle.wheels if not w.driven]
    driven = [w.name for w in vehicle.wheels if w.driven]
    heading, roll, pitch = (
        angle("heading", "counter-clockwise angle of the forward axis from the y axis"),
        angle("roll", "angle about the forward axis, right side down positive"),
        angle("pitch", "angle about the right axis, nose up positive"),
    )
    x = Configuration(
        Label("x", "m", "easting of the platform's centre"),
        Label("y", "m", "northing of the platform's centre"),
        heading,
        tuple(coordinate(c) for c in vehicle.coordinates if c.kind != "suspension"),
    )
    contacts = zip(
        each("contact_x", "m", "easting of the contact point"),
        each("contact_y", "m", "northing of the contact point"),
        strict=True,
    )
    position = Dependent(
        Label("z", "m", "height of the platform's centre"),
        roll, pitch,
        tuple(coordinate(c) for c in vehicle.of("suspension")),
        tuple(Contact(*pair) for pair in contacts),
    )  # fmt: skip
    velocity = {
        axis: Label(f"velocity_{axis}", "m s-1", f"velocity of the platform's centre along {axis}")
        for axis in "xyz"
    }
    rates = Rates(
        velocity["x"], velocity["y"], velocity["z"],
        turning(heading.name, heading.words),
        turning(roll.name, roll.words),
        turning(pitch.name, pitch.words),
        tuple(rate(c) for c in vehicle.of("suspension")),
        tuple(rate(c) for c in vehicle.of("passive")),
        tuple(turning(name, f"the free wheel {name}") for name in free),
        each("multiplier", "m s-1", "multiplier of the contact in the least-slip condition")
        if slip == "least" else (),
    )  # fmt: skip
    u = Inputs(
        tuple(turning(name, f"the driven wheel {name}, forward positive") for name in driven),
        tuple(rate(c) for c in vehicle.of("commanded")),
    )
    q = Angles(each("wheel_angle", "rad", "angle through which the wheel has turned"))
    closures = tuple(
        Label("closure", "m", f"{axis} component of the contact condition", wheel.name)
        for wheel in vehicle.wheels
        for axis in "xyz"
    )
    return Labels(
        x,
        Algebraic(position, rates),
        q,
        u,
        _output_labels(each),
        (closures, _balance_labels(vehicle, rates, slip)),
    )


def _balance_labels(vehicle: Vehicle, rates: Rates, slip: SlipLaw) -> tuple[Label, ...]:
    """Return the labels of the equations for the rates; refuse what cannot roll."""
    if slip == "least":
        return tuple(
            Label("least_slip", "m s-1", f"least slip with respect to {label.full}")
            for label in leaves(rates)
        )
    given, needed = len(rates.passive) + len(rates.free), 2 * len(vehicle.wheels) - 3
    if given != needed:
        raise ModelError(
            f"{vehicle.name} cannot be made to roll: {needed} conditions of no slip need as many "
            f"passive joints and free wheels, found {given}; use slip = 'least'"
        )
    return tuple(
        Label("no_slip", "m s-1", f"{axis} component of the slip", wheel.name)
        for wheel in vehicle.wheels
        for axis in "xyz"
    )


def _output_labels(each: Any) -> Outputs:
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
    )
