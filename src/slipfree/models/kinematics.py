"""Direct kinematics: motion of a vehicle over the ground for given wheel and joint rates.

In the closure model, every wheel touches the ground at position level: each wheel adds two unknown
contact coordinates and three equations, which also contain the pose of the platform. Kinematics and
quasi-statics add equations of the rates.

A rigid vehicle stands on three wheels; a fourth one over-determines its pose. In the pressed-wheel
model, each wheel presses on the ground with a load that grows with its depth below the ground, and
the height and inclination of the platform and the suspension are states that relax to the
equilibrium of these loads. As the depths tend to zero, the motion tends to that of the closure
model if the wheels of the vehicle can all touch a rigid ground.

With the depth ``delta_i`` of a wheel, its static depth ``d0``, the weight ``W`` and ``n`` wheels:

- Load: ``N_i = W / (2 n d0) (delta_i + sqrt(delta_i^2 + w^2))``, with a small width ``w``.
- Friction is proportional to the loads: ``f_t = -N_i s_t``, with the tangential slip velocity
  ``s_t`` for virtual rates of position, heading, passive joints and free wheels. The virtual rates
  follow from the equilibrium of these coordinates.
- The unbalanced force ``F`` on height, inclination and suspension moves them against viscous
  contacts: ``J' diag(c) s_n = F``, with the normal velocities ``s_n = J r`` of the wheels for
  relaxing rates ``r``, and the viscosities ``c``; springs of the suspension have viscosities with
  the same time constant. Under an unbalanced force ``W / n``, a wheel on the ground moves at
  `CONTACT_SPEED` and a wheel in the air at `AIR_SPEED`.

A vehicle rocks where the wheel with the least load changes. There the equilibrium has folds, and
the relaxation from one equilibrium to the next takes a finite time.

In quasi-statics, the vehicle is in equilibrium at every instant under the forces of a wheel-ground
law; inertia is neglected. Beyond the friction limit there is no equilibrium, and therefore no
motion.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.closure import check_exact_closure, check_support, closure, has_exact_closure
from slipfree.core.arguments import checked
from slipfree.core.dae import Continuation, Dae, Holding, Labels, Limit
from slipfree.core.errors import ModelError
from slipfree.core.lookups import LookupTable
from slipfree.core.records import Label, leaves, pack, symbols
from slipfree.core.schema import Positive
from slipfree.geometry.frame import Pose
from slipfree.laws.coulomb import Coulomb
from slipfree.laws.least_slip import LeastSlip, linear_form
from slipfree.laws.protocols import (
    Equations,
    GroundLaw,
    Motion,
    SlidingContacts,
    SlipLaw,
    quantity_labels,
    wheel_labels,
)
from slipfree.models import base
from slipfree.models.friction_feasibility import (
    closure_quantities,
    contact_force_residuals,
    diagnosis,
    equilibrium,
    force_outputs,
    mechanics,
)
from slipfree.models.limits import limits_of, tip_over_margin
from slipfree.models.samples import absolute_spins, slip_velocities
from slipfree.system.forks import computing
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Body, Vehicle


def closure_dae(
    labels: Labels,
    z: base.Algebraic,
    q: base.Quantities,
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
    y = base.outputs(q, sampled)
    heights, centers = base.level_heights(q)
    pose = ca.vertcat(ca.sum1(heights) / len(centers), ca.SX.zeros(2 + len(q.position.suspension)))
    others = base.at_rest(q.vehicle, labels.z[1:])
    # relative to the platform's centre: to subtract large coordinates first avoids loss of digits
    level, zero = q.x._replace(x=ca.SX(0), y=ca.SX(0)), q.position._replace(z=ca.SX(0))
    arms = [pose.origin for pose in base.carriers(q._replace(x=level, position=zero))]
    center = ca.vertcat(q.x.x, q.x.y, q.position.z)
    closures = [
        closure(wheel, Pose(carrier.rotation, arm), each._replace(point=each.point - center))
        for wheel, carrier, arm, each in zip(
            q.vehicle.wheels, q.poses, arms, q.contacts, strict=True
        )
    ]
    return base.vehicle_dae(
        q,
        labels,
        q.x,
        z,
        (Equations(labels.alg[0], ca.vertcat(*closures)), law, Equations(labels.alg[2], forces)),
        sampled,
        ode=ca.vertcat(q.rates.x, q.rates.y, q.rates.heading, *base.joint_rates(q)),
        y=y._replace(slip_ratio=base.slip_ratios(q)) if labels.y.slip_ratio else y,
        limits=(*limits_of(q), *limits),
        checks=base.contact_checks(q, q.x, z, q.poses),
        guess=ca.densify(ca.vertcat(pose, *(center[:2] for center in centers), others)),
        suppress_algebraic=suppress_algebraic,
        continuation=continuation,
        linear=law.linear,
        discs=discs,
        holding=holding if q.vehicle.mass else None,
        leading_rates=ca.vertcat(rates.z, rates.roll, rates.pitch, *rates.suspension),
    )


CONTACT_SPEED = 1.0  # speed of a wheel on the ground under an unbalanced force W / n [m/s]
AIR_SPEED = 3.0  # speed of a wheel in the air under an unbalanced force W / n [m/s]
SMOOTHING = 0.1  # width of the load law [static depths]
MIN_RESISTANCE = 0.01  # least singular value of the slip along rollers' axles [1]
AIR_WEIGHT = 1e-6  # weight of the slip of a wheel in the air, so that its rate is determined [1]


class Press(NamedTuple):
    """Wheels pressed against the ground, as columns of shape (n_wheels, 1).

    Depth below the ground along its normal, negative in the air [m]; normal force divided by the
    weight of the vehicle [1]; degree of contact ``touch``, the derivative of the load with respect
    to the depth divided by its value at large depths: one under load, zero in the air [1];
    viscosity in the relaxation: normal force per unit of normal velocity, divided by the weight
    [s/m]; and stiffness, the derivative of the load with respect to the depth [1/m].
    """

    depth: ca.SX
    load: ca.SX
    touch: ca.SX
    viscosity: ca.SX
    stiffness: ca.SX


class Balance(NamedTuple):
    """Friction forces under given loads and the remaining unbalanced force, per unit weight.

    ``imbalance`` is the generalised force on height [1], inclination [m] and suspension [1 or m].
    """

    imbalance: ca.SX
    along: ca.SX
    across: ca.SX


def press(vehicle: Vehicle, depth: ca.SX, smoothing: float) -> Press:
    """Return loads and viscosities of wheels at given depths (n_wheels, 1) [m].

    ``smoothing`` is the width of the transition of the load law at depth zero [static depths].
    """
    count, static = len(vehicle.wheels), ca.DM([wheel.depth for wheel in vehicle.numeric.wheels])
    root = ca.sqrt(depth**2 + (smoothing * static) ** 2)
    touch = (1 + depth / root) / 2
    viscosity = (touch / CONTACT_SPEED + (1 - touch) / AIR_SPEED) / count
    load = (depth + root) / (2 * count * static)
    return Press(depth, load, touch, viscosity, touch / (count * static))


def balance(parts: base.Mechanics, press: Press, groups: tuple[list[int], list[int]]) -> Balance:
    """Return the friction forces under given loads and the remaining unbalanced force.

    ``groups`` are the indices of the rates that friction balances, and of the rates that relax.
    """
    sliding, relaxing = groups
    along, across, normal = (parts.free[k::3, :] for k in range(3))
    slips = [rows[:, sliding] for rows in (along, across)]
    weighted = [press.load * rows for rows in slips]
    total = normal.T @ press.load + parts.load / parts.weight
    matrix = sum((a.T @ b for a, b in zip(slips, weighted, strict=True)), ca.SX(0))
    virtual = ca.ldl_solve(total[sliding], *ca.ldl(matrix))
    forces = [-rows @ virtual for rows in weighted]
    total += along.T @ forces[0] + across.T @ forces[1]
    return Balance(total[relaxing], *forces)


def relaxation(
    vehicle: Vehicle,
    parts: base.Mechanics,
    press: Press,
    imbalance: ca.SX,
    rates: ca.SX,
    inputs: ca.SX,
    relaxing: list[int],
    lag: ca.SX | float = 0.0,
) -> ca.SX:
    """Return the residual of the relaxation equations, one row per relaxing rate [1, m].

    The viscous normal forces of the contacts, projected on the relaxing rates, balance the
    unbalanced force ``imbalance``. With a ``lag`` in s they balance the force after that time, to
    first order: the stiffness of contacts and springs, times the lag, adds to their viscosity.
    """
    normal, driven = parts.free[2::3, :], parts.driven[2::3, :]
    velocity = normal @ rates + driven @ inputs
    stiff = [
        (relaxation_time(vehicle) + lag) * c.stiffness / parts.weight
        for c in vehicle.of("suspension")
    ]
    springs = ca.vertcat(ca.SX.zeros(3), *stiff) * rates[relaxing]
    viscosity = press.viscosity + lag * press.stiffness
    return normal[:, relaxing].T @ (viscosity * velocity) + springs - imbalance


def relaxation_time(vehicle: Vehicle) -> float:
    """Return the time constant of the relaxation of a loaded wheel [s]."""
    return float(max(wheel.depth for wheel in vehicle.numeric.wheels)) / CONTACT_SPEED


def pressed_dae(vehicle: Vehicle, terrain: Terrain, slip: SlipLaw, smoothing: float) -> Dae:
    """Return the kinematic model of a vehicle with pressed wheels; see `direct_kinematics`."""
    check_support(vehicle)
    labels = _labels(vehicle, slip)
    x, z, u = symbols(labels.x), symbols(labels.z), symbols(labels.u)
    position = base.Dependent(x.z, x.roll, x.pitch, x.suspension, z.position.contacts)
    place = base.Configuration(x.x, x.y, x.heading, x.joints)
    state = base.VehicleState(vehicle, terrain, LookupTable(), place, position, z.rates, u)
    poses = base.carriers(state)
    contacts = base.contact_frames(state, poses, z.position.contacts)
    misses = [closure(*each) for each in zip(vehicle.wheels, poses, contacts, strict=True)]
    surface = tuple(  # the points of the wheels
        contact._replace(point=contact.point - miss)
        for contact, miss in zip(contacts, misses, strict=True)
    )
    slips = slip_velocities(state, surface)
    parts = mechanics(state._replace(vehicle=with_mass(vehicle)), surface, slips)
    moving = ca.vertcat(pack(z.rates.motion), pack(u))  # at rest, dampers have no force
    still = ca.substitute([parts.load, parts.held], [moving], [ca.SX.zeros(moving.shape)])
    parts = parts._replace(load=still[0], held=still[1])
    depths = [ca.dot(contact.normal, miss) for contact, miss in zip(contacts, misses, strict=True)]
    pressed = press(vehicle, ca.vertcat(*depths), smoothing)
    relaxed = {labels.z.rates.z, labels.z.rates.roll, labels.z.rates.pitch}
    relaxed |= {*labels.z.rates.suspension}
    groups = list[int](), list[int]()  # rates that friction balances, and that relax
    for k, label in enumerate(leaves(labels.z.rates.motion)):
        groups[label in relaxed].append(k)
    balanced = balance(parts, pressed, groups)
    columns = (balanced.along, balanced.across, pressed.load)
    forces = base.Forces(*(tuple(ca.vertsplit(vehicle.weight * each)) for each in columns))
    of_wheels = forces, poses, contacts, slips, base.spins(state)
    q = base.Quantities(*state, *of_wheels, parts, tip_over_margin(state, contacts))
    rates, lag = pack(z.rates.motion), ca.SX.sym("lag")
    terms = vehicle, parts, pressed, balanced.imbalance, rates, pack(u), groups[1]
    lagging = linear_form(relaxation(*terms, lag), rates)
    rest = Equations(_relaxation_labels(vehicle), relaxation(*terms), lagging)
    tangential = tuple(
        velocity - contact.normal * ca.dot(contact.normal, velocity)
        for contact, velocity in zip(q.contacts, q.slips, strict=True)
    )
    weights = tuple(ca.vertsplit(pressed.touch + AIR_WEIGHT))
    law = _law_equations(slip, labels, q._replace(slips=tangential), rest, weights)
    # Offsets along the fixed axes, wheel by wheel: with the axes of the contacts, an elimination in
    # a fixed order would fail at headings of right angles.
    pairs = zip(contacts, misses, strict=True)
    aligned = ca.vertcat(*((miss - c.normal * ca.dot(c.normal, miss))[:2] for c, miss in pairs))
    sampled, r = force_outputs(q, labels.y.forces), z.rates
    level = [*r[:2], r.heading, *base.joint_rates(q)]
    holding: Holding | None = None
    if vehicle.mass:  # the equilibrium of the sliding rates, whose normal forces are given
        along, across, normal = (parts.free[k::3, groups[0]] for k in range(3))
        rows = zip(ca.vertsplit(along), ca.vertsplit(across), strict=True)
        matrix = ca.vertcat(*(row for pair in rows for row in pair))
        load = normal.T @ pressed.load + parts.load[groups[0]] / parts.weight
        holding = Holding(matrix, load, ca.vertcat(*parts.friction), pressed.load)
    lowest = ca.mmin(base.level_heights(q)[0]) - max(
        wheel.depth for wheel in vehicle.numeric.wheels
    )
    below = [pose.origin[:2] for pose in q.poses]
    others = len(list(leaves(labels.z))) - 2 * len(below)
    return base.vehicle_dae(
        q,
        labels,
        x,
        z,
        (Equations(labels.alg[0], aligned), law, Equations((), ca.SX(0, 1))),
        sampled,
        ode=ca.vertcat(*level, r.z, r.roll, r.pitch, *r.suspension),
        y=base.outputs(q, sampled)._replace(
            depth=tuple(ca.vertsplit(pressed.depth)),
            load_share=tuple(ca.vertsplit(len(depths) * pressed.load)),
            force_normal=q.forces.normal if vehicle.mass else (),
        ),
        limits=limits_of(q),
        checks=base.contact_checks(
            q, x, z, base.raised_poses(poses, contacts, ca.vertsplit(pressed.depth))
        ),
        guess=ca.densify(ca.vertcat(*below, ca.SX.zeros(others))),
        suppress_algebraic=True,  # contacts and rates follow from the states
        rest=ca.vertcat(lowest, ca.SX.zeros(2 + len(position.suspension))),
        linear=law.linear,
        holding=holding,
        lag=lag,
        relaxation_time=relaxation_time(vehicle),
    )


def with_mass(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle with mass; if it has none, with unit weight at the wheels' centroid."""
    if vehicle.mass:
        return vehicle
    x, y, z = vehicle.centers.mean(axis=0).tolist()
    return replace(vehicle, body=Body(1 / vehicle.gravity, (x, y, z)))


def _labels(vehicle: Vehicle, slip: SlipLaw) -> Labels:
    """Return the labels of the model, except those of the law's equations."""
    law = slip.unknowns(vehicle, _relaxation_labels(vehicle))
    labels = base.labels_of(vehicle, law, follow=False)
    position, rates = labels.z.position, labels.z.rates
    x = base.RelaxedState(*labels.x, *position[:4])
    y = labels.y._replace(**base.pressed_labels(vehicle))
    words = "offset of ground point and wheel point {} the wheel"
    offsets = tuple(
        Label("closure", "m", words.format(axis), wheel.name)
        for wheel in vehicle.wheels
        for axis in ("along", "across")
    )
    z = base.Algebraic(base.PressedContacts(position.contacts), rates, base.Forces())
    return Labels(x, z, labels.q, labels.u, y, (offsets, (), ()))


def _relaxation_labels(vehicle: Vehicle) -> tuple[Label, ...]:
    """Return the labels of the relaxation equations of height, inclination and suspension."""
    names = [("z", "1"), ("roll", "m"), ("pitch", "m")]
    names += [
        (c.name, "m" if vehicle.unit(c.name) == "rad" else "1") for c in vehicle.of("suspension")
    ]
    return tuple(Label(f"relaxation_{name}", unit, f"relaxation of {name}") for name, unit in names)


@checked
@computing
def direct_kinematics(
    vehicle: Vehicle,
    ground: Terrain,
    *,
    slip: SlipLaw = LeastSlip(),  # noqa: B008 - a frozen record
    smoothing: Positive = SMOOTHING,
) -> base.KinematicDae:
    """Return the kinematic model of a vehicle on a ground for given rates.

    Positions follow from closure: every wheel touches the ground, which gives three equations in
    its two contact coordinates and the pose. If not all wheels can touch a rigid ground, they are
    pressed into it (`slipfree.models.kinematics`). Rates follow from the slip law.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    ground : Terrain
        The ground. A motion ends where a contact leaves its domain.
    slip : SlipLaw
        `LeastSlip`, for every vehicle; or `Rolling`, for vehicles that can roll without slip.
    smoothing : float
        Width of the transition in which the load of a pressed wheel vanishes as it leaves the
        ground; only for vehicles whose wheels cannot all touch a rigid ground. [static depths]

    Returns
    -------
    Dae
        Inputs are the rates of the driven wheels and of the commanded coordinates.

    Raises
    ------
    ModelError
        If ``slip`` is not a slip law or cannot be used with the vehicle, if ``smoothing`` is not
        positive, if the vehicle has fewer than three wheels, if contacts and springs do not
        determine its pose, or if its rollers resist one of its motions less than `MIN_RESISTANCE`.

    See Also
    --------
    slipfree.models.kinematics.quasi_statics : Motion determined by gravity and friction.

    Notes
    -----
    For a vehicle with mass, the forces that the motion needs are outputs. Where equilibrium does
    not determine them, they are the load-weighted forces of
    `slipfree.models.friction_feasibility.contact_force_residuals`.

    Examples
    --------
    >>> from slipfree import Analytic, catalog, direct_kinematics
    >>> direct_kinematics(catalog.three_wheeler(), Analytic(lambda x, y: 0.02 * x * y))
    Dae: 6 states, 30 unknowns, 3 inputs, 13 limits, size 1 m
      states: x, y, heading, tilt_right, tilt_left, steer
      unknowns: z, roll, pitch, contact_x, contact_y, velocity_x, velocity_y, velocity_z, ...
      inputs: right_rate, left_rate, steer_rate
      outputs: wheel_angle, work, contact_z, center_x, center_y, center_z, slip_along, ...
    """
    slip.check(vehicle)
    check_rollers(vehicle)
    if not has_exact_closure(vehicle):
        return pressed_dae(vehicle, ground, slip, smoothing)
    return exact_dae(vehicle, ground, slip)


def exact_dae(vehicle: Vehicle, terrain: Terrain, slip: SlipLaw) -> base.KinematicDae:
    """Return the kinematic model of a vehicle in exact contact; see `direct_kinematics`."""
    labels = base.labels_of(vehicle, slip.unknowns(vehicle, contact_labels(vehicle)))
    z, q = closure_quantities(vehicle, terrain, labels)
    return closure_dae(labels, z, q, slip_equations(slip, labels, q), contact_force_residuals(q))


def check_rollers(vehicle: Vehicle) -> None:
    """Raise ModelError if all wheels have rollers, and these resist a motion hardly or not at all.

    The motion is one on level ground, with all coordinates at zero. Vehicles that steer are not
    checked.
    """
    coordinates = vehicle.of("commanded") + vehicle.of("passive")
    if coordinates or not all(wheel.rollers for wheel in vehicle.wheels):
        return
    vehicle = vehicle.numeric
    size, poses = base.extent(vehicle), vehicle.carriers()
    rows = np.zeros((len(poses), 3))
    for row, wheel, pose in zip(rows, vehicle.wheels, poses, strict=True):
        (x, y), (right, forward) = (
            np.array(ca.evalf(each[:2])).ravel() for each in (pose.origin, pose.rotation[:, 0])
        )
        angle = np.arctan2(forward, right) + (wheel.rollers or 0.0)  # of the roller's axle
        if wheel.driven:  # a free wheel resists nothing
            row[:] = np.cos(angle), np.sin(angle), (x * np.sin(angle) - y * np.cos(angle)) / size
    _, values, motions = np.linalg.svd(rows)
    if values[-1] > MIN_RESISTANCE:
        return
    right, forward, turning = motions[-1] * np.copysign(1, motions[-1, 1])
    motion = f"{np.degrees(np.arctan2(abs(right), forward)):.0f} degrees to the "
    motion += f"{'right' if right > 0 else 'left'} of forward, across the axles of all rollers"
    if abs(turning) > MIN_RESISTANCE:
        x, y = size * np.round([-forward / turning, right / turning], 6) + 0.0
        motion = f"about a point {x:.3g} m to the right of its centre and {y:.3g} m ahead, to "
        motion += "which the axles of all rollers point"
    raise ModelError(
        f"{vehicle.name!r}: expected rollers that, on the ground, resist every motion of the "
        f"platform, found none that resists its motion {motion}; change the angles of the rollers: "
        "of four mecanum wheels, positive in front on the left and in the rear on the right, "
        "negative at the other two"
    )


def check_driven(vehicle: Vehicle) -> None:
    """Raise ModelError if a vehicle has no input, so that in kinematics nothing moves it."""
    if vehicle.of("commanded") or any(wheel.driven for wheel in vehicle.wheels):
        return
    raise ModelError(
        f"{vehicle.name!r}: expected a driven wheel or a commanded coordinate, without which "
        "kinematics determines no motion, found none; set driven = true for some of the wheels "
        f"{', '.join(wheel.name for wheel in vehicle.wheels)}, or use model = 'dynamics', in which "
        "gravity moves the vehicle"
    )


def slip_equations(slip: SlipLaw, labels: Labels, q: base.Quantities) -> Equations:
    """Return the equations that a slip law gives for the rates, for wheels in exact contact."""
    normal = [
        ca.dot(contact.normal, velocity)
        for contact, velocity in zip(q.contacts, q.slips, strict=True)
    ]
    rest = Equations(contact_labels(q.vehicle), ca.vertcat(*normal))
    return _law_equations(slip, labels, q, rest, (1.0,) * len(q.slips))


def _law_equations(
    slip: SlipLaw,
    labels: Labels,
    q: base.Quantities,
    rest: Equations,
    weights: tuple[ca.SX | float, ...],
) -> Equations:
    """Return the equations of a slip law beside others, for the slips with the given weights."""
    motion = Motion(
        q.vehicle,
        q.contacts,
        q.slips,
        pack(q.rates.motion),
        tuple(leaves(labels.z.rates.motion)),
        rest,
        weights,
        (q.mechanics.free, q.mechanics.driven @ pack(q.u)),
    )
    return slip.equations(motion, q.rates.law)


def contact_labels(vehicle: Vehicle) -> tuple[Label, ...]:
    """Return the labels of the normal velocities of the wheels, which vanish in exact contact."""
    return wheel_labels(vehicle, "contact", "m s-1", "contact in the least-slip condition")


@checked
@computing
def quasi_statics(
    vehicle: Vehicle,
    ground: Terrain,
    *,
    law: GroundLaw = Coulomb(),  # noqa: B008 - a frozen record
) -> base.KinematicDae:
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
    base.check_mass(vehicle, "quasi-statics")
    check_exact_closure(vehicle, "quasi-static model")
    check_rollers(vehicle)
    law.check(vehicle, ground)
    labels = base.labels_of(vehicle, law.unknowns(vehicle), follow=False)
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
    q = q._replace(forces=base.Forces(reaction.along, reaction.across, reaction.normal))
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
        (*base.equilibrium_labels(labels.z.rates), *reaction.equations.labels),
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
