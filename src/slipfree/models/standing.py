"""Equilibrium of a vehicle at rest on the ground, as the start of a dynamic model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.closure import has_exact_closure
from slipfree.contact.touch import solid_touch
from slipfree.core.dae import Dae, Labels, Standing
from slipfree.core.lookups import LookupTable
from slipfree.core.records import Label, leaves
from slipfree.geometry.frame import platform, quaternion, turn
from slipfree.laws.least_slip import LeastSlip
from slipfree.laws.protocols import wheel_limits
from slipfree.models.base import (
    Configuration,
    Dependent,
    VehicleState,
    extent,
    level_heights,
    sizes,
)
from slipfree.models.dynamic_outputs import Contact, MovingVehicle
from slipfree.models.kinematics import exact_dae, pressed_dae
from slipfree.models.multibody import Load, bias_forces, generalised_forces
from slipfree.terrain.base import Terrain
from slipfree.terrain.solids import Prism
from slipfree.vehicle.tree import Vehicle

STANDING_SMOOTHING = 0.01  # width of the load law of the vehicle at rest [static depths]


class PlanarPlace(NamedTuple):
    """Given position of a planar vehicle at rest: y, and joints that are not suspension."""

    y: Any
    joints: tuple[Any, ...]


class PlanarPose(NamedTuple):
    """Unknowns of a planar vehicle at rest: share of friction, z, pitch and suspension."""

    balance: tuple[Any, ...]


def planar_start(
    moving: MovingVehicle, labels: Labels, contacts: Sequence[tuple[Contact, ...]]
) -> Standing:
    """Return the equilibrium of a planar vehicle, and the states of the dynamic model there.

    The driven wheels hold the vehicle on a slope, with friction in proportion to their loads.
    """
    vehicle, terrain, lookups, x, _, body = moving
    share = ca.SX.sym("share")
    holds_all, loads = not any(wheel.driven for wheel in vehicle.wheels), list[Load]()
    for each, (at, *_) in zip(body.wheels, contacts, strict=True):
        frame, pull = at.touch.frame, share if each.wheel.driven or holds_all else 0
        force = at.force.normal * (frame.normal + pull * frame.along)
        loads.append(Load(each.wheel.parent, force, ca.cross(frame.point - body.origin, force)))
    forces = generalised_forces(body, loads) - bias_forces(body)
    for k, c in enumerate(vehicle.coordinates):
        if c.is_loaded:
            forces[6 + k] -= ca.gradient(c.potential(x.joints[k]), x.joints[k])
    free = [k for k, c in enumerate(vehicle.coordinates) if c.kind == "suspension"]
    held = [k for k in range(len(vehicle.coordinates)) if k not in free]
    speeds = ca.vertcat(*leaves(x[5:]))  # with the integrals
    least_gaps = (ca.mmin(ca.vertcat(np.inf, *(at.touch.gap for at in c[1:]))) for c in contacts)
    rows, gaps = ca.substitute(
        [forces[[1, 2, 3, *(6 + k for k in free)]] / vehicle.weight, ca.vertcat(*least_gaps)],
        [speeds],
        [ca.SX.zeros(speeds.shape)],
    )
    place = PlanarPlace(x.y, tuple(x.joints[k] for k in held))
    pose = PlanarPose((share, x.z, *x.attitude, *(x.joints[k] for k in free)))
    names: Any = labels.x
    unknowns = (
        Label("friction_share", "1", "friction of the wheels at rest over their loads"),
        names.z,
        *names.attitude,
        *(names.joints[k] for k in free),
    )
    balance = tuple(
        Label(f"balance_{each.name}", "1", f"balance of {each.name}") for each in unknowns
    )
    known = PlanarPlace(names.y, tuple(names.joints[k] for k in held))
    still = Labels(known, PlanarPose(unknowns), (), (), (), (balance,))
    (scale, shift), speed = sizes(vehicle, terrain, still), ca.SX.sym("speed")
    given = Configuration(ca.SX(0), x.y, ca.SX(0), place.joints)
    position = Dependent(x.z, ca.SX(0), x.attitude[0], tuple(x.joints[k] for k in free), ())
    heights, _ = level_heights(VehicleState(vehicle, terrain, lookups, given, position))
    lowest = ca.mmin(heights) - max(wheel.depth for wheel in vehicle.wheels)
    limits = wheel_limits(vehicle, "start_gap", ca.vertsplit(gaps), 0.0, np.inf)
    model = Dae(
        ca.SX.sym("t"),
        place,
        pose,
        (),
        (),
        ode=ca.SX.zeros(1 + len(held)),
        alg=(rows,),
        quad=ca.SX(0, 1),
        y=(),
        labels=still,
        limits=tuple(limits) if len(contacts[0]) > 1 else (),
        checks=(),
        guess=ca.vertcat(0, lowest, ca.SX.zeros(1 + len(free))),
        scale=scale,
        shift=shift,
        size=extent(vehicle),
        lookups=lookups.lookups,
    )
    forward = turn("x", x.attitude[0]).rotation[1:, 1]
    states = _rolling_states(vehicle, labels, [*leaves(x[:5])], forward, speed)
    return Standing(model, None, speed, states)


def _rolling_states(
    vehicle: Vehicle, labels: Labels, pose: Sequence[ca.SX], forward: ca.SX, speed: ca.SX
) -> ca.SX:
    """Return the states of a vehicle in a pose that rolls straight ahead at a speed."""
    rest = ca.SX.zeros((1 if vehicle.planar else 3) + len(vehicle.coordinates))
    rolling = [speed / wheel.radius for wheel in vehicle.wheels]
    motors = ca.SX.zeros(len(labels.x.drives) + len(labels.x.joint_drives))
    return ca.vertcat(*pose, speed * forward, rest, *rolling, motors)


def standing_start(
    vehicle: Vehicle, terrain: Terrain, prisms: Sequence[Prism], labels: Labels
) -> Standing:
    """Return the model of the vehicle at rest, and the states of the dynamic model there.

    At rest, no wheel touches a solid.
    """
    model = pressed_dae(vehicle, terrain, LeastSlip(), STANDING_SMOOTHING)
    still: Any = model.x
    values = {
        label.name: value
        for label, value in zip(leaves(model.labels.x), leaves(model.x), strict=True)
    }
    base = platform(still.x, still.y, still.z, still.heading, still.roll, still.pitch)
    x, y, z, w = ca.vertsplit(quaternion(base.rotation))
    poses = vehicle.carriers(base, {c.name: values[c.name] for c in vehicle.coordinates})
    if prisms:
        pairs = zip(vehicle.wheels, poses, strict=True)
        gaps = [
            [solid_touch(each, terrain, *pair, LookupTable()).gap for each in prisms]
            for pair in pairs
        ]
        least = (ca.mmin(ca.vertcat(*each)) for each in gaps)
        clear = wheel_limits(vehicle, "start_gap", least, 0.0, np.inf)
        model = replace(model, limits=(*model.limits, *clear))
    joints, speed = [values[c.name] for c in vehicle.coordinates], ca.SX.sym("speed")
    guess = None
    if has_exact_closure(vehicle):
        guess = replace(exact_dae(vehicle, terrain, LeastSlip()), limits=(), checks=())
    pose = [still.x, still.y, still.z, w, x, y, z, *joints]
    states = _rolling_states(vehicle, labels, pose, base.rotation[:, 1], speed)
    return Standing(model, guess, speed, states)
