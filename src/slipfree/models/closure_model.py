"""Closure model: every wheel touches the ground at position level.

Each wheel adds two unknown contact coordinates and three equations, which also contain the pose of
the platform.
`slipfree.models.kinematics` and `slipfree.models.quasi_statics` add equations of the rates.
"""

from __future__ import annotations

import casadi as ca

from slipfree.contact.closure import closure
from slipfree.core.dae import Continuation, Dae, Holding, Labels, Limit
from slipfree.core.lookups import LookupTable
from slipfree.core.records import symbols
from slipfree.geometry.frame import Pose
from slipfree.laws.protocols import Equations
from slipfree.models.base import (
    Algebraic,
    Quantities,
    VehicleState,
    at_rest,
    carriers,
    contact_checks,
    contact_frames,
    joint_rates,
    level_heights,
    outputs,
    slip_ratios,
    spins,
    vehicle_dae,
)
from slipfree.models.friction_feasibility import force_outputs, mechanics, with_tangential
from slipfree.models.limits import limits_of, tip_over_margin
from slipfree.models.samples import slip_velocities
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle


def closure_quantities(
    vehicle: Vehicle, terrain: Terrain, labels: Labels
) -> tuple[Algebraic, Quantities]:
    """Return the algebraic unknowns of a closure model and the expressions that contain them."""
    x, z, u = symbols(labels.x), symbols(labels.z), symbols(labels.u)
    state = VehicleState(vehicle, terrain, LookupTable(), x, z.position, z.rates, u)
    poses = carriers(state)
    contacts = contact_frames(state, poses, z.position.contacts)
    slips = slip_velocities(state, contacts)
    parts = mechanics(state, contacts, slips)
    of_wheels = with_tangential(z.forces, parts), poses, contacts, slips, spins(state)
    return z, Quantities(*state, *of_wheels, parts, tip_over_margin(state, contacts))


def closure_dae(
    labels: Labels,
    z: Algebraic,
    q: Quantities,
    law: Equations,
    forces: ca.SX,
    *,
    limits: tuple[Limit, ...] = (),
    suppress_algebraic: bool = False,
    continuation: Continuation | None = None,
    discs: tuple[tuple[ca.SX, ca.SX], ...] = (),
) -> Dae:
    """Return the DAE of a closure model from its quantities and the equations of its rates.

    ``labels`` lack those of the law's equations; ``law`` and ``forces`` are the equations of the
    rates, and of the forces that follow from them. Other arguments are those of `Dae`.
    """
    rates, sampled = q.rates, force_outputs(q, labels.y.forces)
    parts = q.mechanics
    holding = Holding(parts.free, parts.load / parts.weight, ca.vertcat(*parts.friction))
    y = outputs(q, sampled)
    heights, centers = level_heights(q)
    pose = ca.vertcat(ca.sum1(heights) / len(centers), ca.SX.zeros(2 + len(q.position.suspension)))
    others = at_rest(q.vehicle, labels.z[1:])
    return vehicle_dae(
        q,
        labels,
        q.x,
        z,
        (Equations(labels.alg[0], _closures(q)), law, Equations(labels.alg[2], forces)),
        sampled,
        ode=ca.vertcat(q.rates.x, q.rates.y, q.rates.heading, *joint_rates(q)),
        y=y._replace(slip_ratio=slip_ratios(q)) if labels.y.slip_ratio else y,
        limits=(*limits_of(q), *limits),
        checks=contact_checks(q, q.x, z, q.poses),
        guess=ca.densify(ca.vertcat(pose, *(center[:2] for center in centers), others)),
        suppress_algebraic=suppress_algebraic,
        continuation=continuation,
        linear=law.linear,
        discs=discs,
        holding=holding if q.vehicle.mass else None,
        leading_rates=ca.vertcat(rates.z, rates.roll, rates.pitch, *rates.suspension),
    )


def _closures(q: Quantities) -> ca.SX:
    """Return the contact residuals of all wheels, computed relative to the platform's centre.

    Subtracting large coordinates first avoids loss of digits.
    """
    level, zero = q.x._replace(x=ca.SX(0), y=ca.SX(0)), q.position._replace(z=ca.SX(0))
    arms = [pose.origin for pose in carriers(q._replace(x=level, position=zero))]
    center = ca.vertcat(q.x.x, q.x.y, q.position.z)
    return ca.vertcat(
        *(
            closure(wheel, Pose(carrier.rotation, arm), each._replace(point=each.point - center))
            for wheel, carrier, arm, each in zip(
                q.vehicle.wheels, q.poses, arms, q.contacts, strict=True
            )
        )
    )
