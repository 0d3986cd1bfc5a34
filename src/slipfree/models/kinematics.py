"""Direct kinematics: how given wheel and joint rates move a vehicle over the ground."""

from __future__ import annotations

from typing import get_args

import casadi as ca

from slipfree.contact.certify import SecondTouch
from slipfree.contact.closure import ContactFrame, closure, contact_frame
from slipfree.dae import Dae, Labels
from slipfree.errors import ModelError
from slipfree.forks import computing
from slipfree.geometry.frame import Pose
from slipfree.lookups import LookupTable
from slipfree.models.base import (
    at_rest,
    balance,
    carriers,
    contact_limits,
    extent,
    joint_rates,
    outputs,
    sizes,
    spins,
    stops,
    touch_function,
)
from slipfree.models.labels import labels_of
from slipfree.models.records import (
    Configuration,
    Dependent,
    SlipLaw,
)
from slipfree.models.slip import slip_velocity
from slipfree.models.statics import loads, mechanics
from slipfree.models.traction import Traction, check_traction, friction_law
from slipfree.records import pack, symbols
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle


@computing
def direct_kinematics(
    vehicle: Vehicle,
    terrain: Terrain,
    *,
    slip: SlipLaw = "least",
    traction: Traction = Traction(),  # noqa: B008 - a frozen record
) -> Dae:
    """Return the motion of a vehicle over a ground under given rates.

    Positions follow from closure: every wheel touches the ground, three equations in its two
    contact coordinates and the pose. Rates follow from the least slip that closure allows; if the
    vehicle can roll without slip, as the tilting three-wheeler can, that is its motion.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    terrain : Terrain
        The ground; contacts keep to its domain.
    slip : {"least", "rolling", "traction"}
        Least slip, for every vehicle; or none at all, for those whose passive joints and free
        wheels are as many as the conditions, ``2 n_wheels - 3``; or what friction makes of gravity
        and drives, quasi-statically, for vehicles with mass on ground with friction.
    traction : Traction
        The law of friction for the last of them.

    Returns
    -------
    Dae
        Inputs are the rates of the driven wheels and of the commanded coordinates.

    Raises
    ------
    ModelError
        If the vehicle has too few or too many freedoms to roll without slip and that is asked, or
        traction of a vehicle without mass or on a ground without friction.

    Notes
    -----
    Of a vehicle with mass, forces are outputs. In the first two laws they follow from the motion;
    where equilibrium leaves some of them open, they are the load-weighted ones of
    `slipfree.models.statics.following_forces`.
    """
    _check(vehicle, terrain, slip, traction)
    labels = labels_of(vehicle, slip)
    x, z, u, t = symbols(labels.x), symbols(labels.z), symbols(labels.u), ca.SX.sym("t")
    poses, lookups = carriers(vehicle, x, z.position), LookupTable()
    contacts = [
        contact_frame(terrain, place.x, place.y, pose.rotation[:, 0], lookups)
        for place, pose in zip(z.position.contacts, poses, strict=True)
    ]
    turning, joints = spins(vehicle, z.rates, u), joint_rates(vehicle, z.rates, u)
    q = pack((*x, z.position[:4]))
    q_dot = pack((*z.rates[:2], z.rates.heading, joints, z.rates.z, *z.rates[4:7]))
    slips = [
        slip_velocity(wheel, pose, contact, q, q_dot, spin)
        for wheel, pose, contact, spin in zip(vehicle.wheels, poses, contacts, turning, strict=True)
    ]
    touching = touch_function(x, z, poses, contacts, lookups)
    (scale, shift), size = sizes(vehicle, terrain, labels), extent(vehicle)
    parts = mechanics(vehicle, terrain, x, z.position, contacts, z.rates, u, lookups)
    law = None
    if slip == "traction":
        law = friction_law(vehicle, traction, parts, contacts, slips, (x, z, u), lookups)
    forces = law.forces if law else z.forces
    bears = loads(vehicle, terrain, parts, forces, slips, contacts, (x, z.position, u))
    guess = _guess(vehicle, terrain, x, labels, lookups)
    return Dae(
        t,
        x,
        z,
        symbols(labels.q),
        u,
        ode=ca.vertcat(z.rates.x, z.rates.y, z.rates.heading, *joints),
        alg=(
            _closures(vehicle, x, z.position, poses, contacts),
            law.equations if law else balance(slip, slips, contacts, z.rates),
            bears.equations,
        ),
        quad=ca.vertcat(*turning, *bears.work),
        y=outputs(terrain, poses, contacts, slips, turning, x, z, bears.outputs),
        labels=labels,
        limits=(
            *stops(vehicle, x, z),
            *contact_limits(vehicle, terrain, contacts),
            *bears.limits,
            *(law.limits if law else ()),
        ),
        checks=tuple(
            SecondTouch(terrain, wheel, pose, size)
            for wheel, pose in zip(vehicle.wheels, touching, strict=True)
        ),
        guess=guess,
        scale=scale,
        shift=shift,
        size=size,
        suppress_algebraic=law is not None,  # rates with friction are too steep for an error test
        continuation=law.continuation if law else None,
        lookups=lookups.lookups,
    )


def _check(vehicle: Vehicle, terrain: Terrain, slip: SlipLaw, traction: Traction) -> None:
    if slip not in get_args(SlipLaw):
        raise ModelError(f"slip: expected one of {', '.join(get_args(SlipLaw))}, found {slip!r}")
    if slip == "traction":
        check_traction(vehicle, terrain, traction)


def _closures(
    vehicle: Vehicle,
    x: Configuration,
    position: Dependent,
    poses: tuple[Pose, ...],
    contacts: list[ContactFrame],
) -> ca.SX:
    """Return the closures of all wheels, from the platform's centre.

    Subtracted before anything is added to them, large coordinates cost no digits.
    """
    level = x._replace(x=ca.SX(0), y=ca.SX(0))
    arms = [pose.origin for pose in carriers(vehicle, level, position._replace(z=ca.SX(0)))]
    center = ca.vertcat(x.x, x.y, position.z)
    return ca.vertcat(
        *(
            closure(wheel, Pose(carrier.rotation, arm), each._replace(point=each.point - center))
            for wheel, carrier, arm, each in zip(vehicle.wheels, poses, arms, contacts, strict=True)
        )
    )


def _guess(
    vehicle: Vehicle, terrain: Terrain, x: Configuration, labels: Labels, lookups: LookupTable
) -> ca.SX:
    """Return a level platform at the mean height of its wheels, contacts below their centres."""
    level = Dependent(0, 0, 0, tuple(0 for _ in vehicle.of("suspension")), ())
    centers = [carrier.origin for carrier in carriers(vehicle, x, level)]
    lifts = [
        terrain.height(c[0], c[1], lookups) + wheel.radius - c[2]
        for c, wheel in zip(centers, vehicle.wheels, strict=True)
    ]
    places = [c[:2] for c in centers]
    rest = ca.SX.zeros(len(level.suspension) + 2)
    others = at_rest(vehicle, labels.z[1:])
    return ca.densify(ca.vertcat(sum(lifts) / len(lifts), rest, *places, others))
