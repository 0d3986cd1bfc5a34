"""Quasi-statics: slow motion of a vehicle determined by gravity, drives and the ground.

The vehicle is in equilibrium at every instant under the forces of a wheel-ground law; inertia is
neglected. Beyond the friction limit there is no equilibrium, and therefore no motion.
"""

from __future__ import annotations

import casadi as ca

from slipfree.contact.closure import check_exact_closure
from slipfree.core.arguments import checked
from slipfree.core.records import pack
from slipfree.laws.coulomb import Coulomb
from slipfree.laws.protocols import Equations, GroundLaw, SlidingContacts, quantity_labels
from slipfree.models.base import (
    Forces,
    KinematicDae,
    check_mass,
    equilibrium_labels,
    labels_of,
)
from slipfree.models.friction_feasibility import closure_quantities, diagnosis, equilibrium
from slipfree.models.kinematics import check_rollers, closure_dae
from slipfree.models.samples import absolute_spins
from slipfree.system.forks import computing
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle


@checked
@computing
def quasi_statics(
    vehicle: Vehicle,
    ground: Terrain,
    *,
    law: GroundLaw = Coulomb(),  # noqa: B008 - a frozen record
) -> KinematicDae:
    """Return the quasi-static model of a vehicle at given rates of its wheels and joints.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle, with mass.
    ground : Terrain
        The ground, with friction. A motion ends where a contact leaves its domain.
    law : GroundLaw
        Wheel-ground law, such as `Coulomb` or `Soil`. Wheels in soil have a sinkage, but the pose
        of the vehicle is that on rigid ground.

    Returns
    -------
    Dae
        Inputs are the rates of the driven wheels and of the commanded coordinates.

    Raises
    ------
    ModelError
        If ``law`` is not a wheel-ground law, the vehicle has no mass, not all of its wheels can
        touch a rigid ground, the law cannot be used with the vehicle or the ground, or its rollers
        resist one of its motions hardly or not at all.

    Examples
    --------
    Compute the largest friction utilisation of a cart on a side slope of 0.2:

    >>> import numpy as np
    >>> from slipfree import Analytic, catalog, quasi_statics, settle, simulate
    >>> slope = Analytic(lambda x, y: 0.2 * x, mu=0.6)
    >>> model = quasi_statics(catalog.three_wheeler(axle="fixed"), slope)
    >>> inputs = model.inputs(right_rate=0.5, left_rate=0.5, steer_rate=0.0)
    >>> run = simulate(model, settle(model), inputs, np.linspace(0, 2, 3))
    >>> print(f"{run['utilisation'].max():.2f}")
    0.33
    """
    check_mass(vehicle, "quasi-statics")
    check_exact_closure(vehicle, "quasi-static model")
    check_rollers(vehicle)
    law.check(vehicle, ground)
    labels = labels_of(vehicle, law.unknowns(vehicle), follow=False)
    labels = labels._replace(y=labels.y._replace(slip_ratio=quantity_labels(vehicle, "slip_ratio")))
    z, q = closure_quantities(vehicle, ground, labels)
    parts, turning = q.mechanics, absolute_spins(q)
    slip = ca.vertsplit(parts.free @ pack(q.rates.motion) + parts.driven @ pack(q.u))
    sliding = SlidingContacts(
        vehicle,
        tuple(slip[::3]),
        tuple(slip[1::3]),
        tuple(slip[2::3]),
        parts.friction,
        q.u.wheels,
        turning,
        tuple(each.point[:2] + ca.DM(ground.origin[:2]) for each in q.contacts),
        (lambda _x, _z: "") if vehicle.nominal else diagnosis(z, q),
    )
    reaction = law.reaction(sliding, q.rates.law)
    q = q._replace(forces=Forces(reaction.along, reaction.across, reaction.normal))
    if reaction.torques:
        # The difference between the moment of the ground about an axle and that of the forces at
        # the contact point acts on the rates in proportion to the wheel's angular velocity.
        more = list[ca.SX]()
        columns = q.forces.along, q.forces.across, q.forces.normal, reaction.torques
        for pose, at, *forces, torque in zip(q.poses, q.contacts, *columns, strict=True):
            along, across, normal = forces
            total = along * at.along + across * at.across + normal * at.normal
            lever = ca.cross(at.point - pose.origin, total)
            more.append(torque - ca.dot(pose.rotation[:, 0], lever))
        moments, speeds = ca.vertcat(*more), ca.vertcat(*turning)
        parts = parts._replace(
            load=parts.load - ca.jacobian(speeds, pack(q.rates.motion)).T @ moments,
            held=parts.held - ca.jacobian(speeds, pack(q.u)).T @ moments,
            damped=parts.damped + ca.dot(moments, speeds),
        )
        q = q._replace(mechanics=parts)
    balance = Equations(
        (*equilibrium_labels(labels.z.rates), *reaction.equations.labels),
        ca.vertcat(equilibrium(q.mechanics, q.forces.column), reaction.equations.rows),
    )
    return closure_dae(
        labels,
        z,
        q,
        balance,
        ca.SX(0, 1),
        limits=reaction.limits,
        suppress_algebraic=True,  # rates under friction change too fast for an error test
        continuation=reaction.continuation,
        discs=reaction.discs,
    )
