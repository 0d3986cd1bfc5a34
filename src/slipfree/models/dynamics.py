"""Dynamics: motion of a vehicle at any speed, with inertia and compliant contact.

The model is an explicit ODE. Contact points are found by lookups (`slipfree.contact.touch`), and
the accelerations by an LDL factorisation of the mass matrix in the expression graph. The spin of a
wheel has its own equation: with the spin ``sigma`` relative to fixed axes, the axle ``a``, the
drive's torque ``tau`` and the ground force ``F`` on the point ``P``,
``I_a sigma' = tau - a . ((P - C) x F)``. The carrier bears the rest of the moment.

A prescribed rate of a wheel or a joint is a state with a prescribed acceleration
``(u - rate) / LAG`` (hybrid dynamics); the torque that it needs is an output. Other drives exert an
effort on a wheel or a coordinate that is free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.certify import SecondContact, second_contacts
from slipfree.contact.closure import has_exact_closure, support_fault, without_rolling
from slipfree.contact.touch import Touch, plane_of, search_function, solid_touch, touch
from slipfree.core.arguments import checked
from slipfree.core.dae import HeldTerms, Labels, Standing
from slipfree.core.errors import ModelError
from slipfree.core.lookups import LookupTable
from slipfree.core.records import leaves, pack, symbols
from slipfree.geometry.frame import Pose, rotation_of, turn
from slipfree.laws.compliant import Compliant
from slipfree.laws.protocols import BodyLaw, ContactLaw, WheelContact
from slipfree.models.base import Inputs, body_checks, check_mass, extent, raised_poses, vehicle_dae
from slipfree.models.dynamic_outputs import (
    Contact,
    Contacts,
    DynamicDae,
    DynamicState,
    Effort,
    MovingVehicle,
    body_contacts,
    deepest,
    depth_limits,
    dynamic_forces,
    dynamic_labels,
    dynamic_outputs,
    in_space,
    limit_quantities,
    quantities,
    solid_limits,
)
from slipfree.models.limits import limits_of
from slipfree.models.multibody import (
    Load,
    Multibody,
    Speeds,
    WheelMotion,
    angular_acceleration,
    bias_forces,
    generalised_forces,
    mass_matrix,
    multibody,
)
from slipfree.models.standing import planar_start, standing_start
from slipfree.system.forks import computing
from slipfree.terrain.base import Terrain
from slipfree.terrain.solids import Prism, Solids
from slipfree.vehicle.tree import Vehicle

SPACE, PLANE = range(6), (1, 2, 3)  # free speeds of the platform: velocity, angular velocity
MIN_INERTIA = 1e-15  # smaller generalised masses count as zero [kg, kg m^2]
LAG = 1e-3  # time constant of prescribed rates [s]
NORMALISATION = 1.0  # rate at which the norm of the quaternion returns to one [1/s]
STEP_SHARE = 1 / 8  # largest distance that a wheel travels in a step of the integrator [radii]
EXACT_DEPTH = 1 / 250  # default static depth of vehicles with exact closure [rolling radii]


@checked
@computing
def dynamics(
    vehicle: Vehicle,
    ground: Terrain | Solids,
    *,
    law: ContactLaw = Compliant(),  # noqa: B008 - a frozen record
) -> DynamicDae:
    """Return the dynamic model of a vehicle on a ground.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle, with mass. Wheels may leave the ground.
    ground : Terrain or Solids
        The ground, with friction. A motion ends where a contact leaves its domain.
    law : ContactLaw
        Wheel-ground law: `Compliant`, or `Soil`, which needs no friction of the ground.

    Returns
    -------
    Dae
        Inputs are those of the drives of wheels and commanded coordinates: the rate of a `Rate` or
        `Motor`, the torque or force of a `Torque`.

    Raises
    ------
    ModelError
        If the vehicle has no mass, if a wheel whose rate is not prescribed has neither mass nor
        inertia, if a coordinate whose rate is not prescribed moves no mass, if the law cannot be
        used with the vehicle or the ground, or if a wheel on solids is not a torus, a disc or a
        sphere.

    Notes
    -----
    A prescribed rate is reached with a time constant of 1 ms. Settle the model for a start at
    rest: ``settle(model, x=..., y=..., heading=...)``. The vehicle then stands on the base of
    solids, and must not touch them.

    A wheel may touch the base and several solids at once. Its outputs are those of the contact with
    the least gap; the outputs of solid ``k`` are ``solid_gap_k``, ``solid_load_k`` and others, with
    ``k = 0`` for the base.

    For a planar vehicle, give `settle` the position ``y`` and the values of joints that are not
    suspension.

    Examples
    --------
    Accelerate a vehicle from rest on level ground:

    >>> import numpy as np
    >>> from slipfree import Analytic, catalog, dynamics, settle, simulate
    >>> model = dynamics(catalog.rigid_skid_steer(), Analytic(lambda x, y: 0 * x, mu=0.8))
    >>> inputs = {label.full: 4.0 for label in model.labels.u.wheels}
    >>> run = simulate(model, settle(model), model.inputs(**inputs), np.linspace(0, 1, 11))
    >>> print(run.stop)
    None
    """
    terrain, prisms = (ground.base, ground.prisms) if isinstance(ground, Solids) else (ground, ())
    check_dynamic(vehicle)
    law.check(vehicle, terrain)
    made_from = vehicle
    vehicle = with_depths(vehicle)
    share = vehicle.weight / len(vehicle.wheels)  # static depths of the law, under equal shares
    sunk = (replace(w, static_depth=law.static_depth(w, share)) for w in vehicle.wheels)
    vehicle = replace(vehicle, wheels=tuple(sunk))
    bears = isinstance(law, BodyLaw) and law.bears_bodies and bool(vehicle.shapes)
    labels = dynamic_labels(vehicle, len(prisms), bears=bears)
    moving = moving_vehicle(vehicle, terrain, labels)
    x, body = moving.x, moving.body
    wheels = _contacts(moving, prisms, law)
    contacts = Contacts(wheels, body_contacts(vehicle, terrain, law, body, moving.lookups))
    inertia = mass_matrix(body), bias_forces(body)
    check_inertia(vehicle, labels, x, inertia[0])
    ode, effort = equations_of_motion(moving, contacts, *inertia)
    shown = [deepest(each) for each in wheels]
    q = quantities(moving, shown)
    forces = dynamic_forces(q, contacts, x, effort)
    y = dynamic_outputs(q, body, shown, contacts, forces)
    on_base = [each[0] for each in wheels]
    frames = tuple(each.touch.frame for each in on_base)
    checks: tuple[SecondContact, ...] = ()
    if not plane_of(terrain):  # a wheel touches a plane only once
        raised = raised_poses(q.poses, frames, tuple(-each.touch.gap for each in on_base))
        checks = second_contacts(q._replace(contacts=frames), x, (), raised, extent(vehicle))
    pairs = [ca.SX.sym("held", each.sparsity()) for each in inertia], inertia
    held_ode, _ = equations_of_motion(moving, contacts, *pairs[0])
    standing: Standing | None = None  # where contacts and springs hold the vehicle
    if vehicle.planar:
        still = moving_vehicle(vehicle, terrain, labels)
        standing = planar_start(still, labels, _contacts(still, prisms, law))
    elif not support_fault(vehicle):
        standing = standing_start(vehicle, terrain, prisms, labels)
    return vehicle_dae(
        q,
        labels,
        x,
        (),
        (),
        forces,
        ode=ode,
        y=y,
        limits=(
            *limits_of(limit_quantities(q, on_base), static=False, overturns=bears),
            *solid_limits(vehicle, wheels),
            *depth_limits(vehicle, law, wheels),
        ),
        checks=checks if bears else (*checks, *body_checks(q, x, ())),
        guess=ca.SX(0, 1),
        pace=ca.SX(0) if plane_of(terrain) and not prisms else _pace(body, moving.u),
        standing=standing,
        held=HeldTerms(held_ode, *(ca.vertcat(*(each.nz[:] for each in pair)) for pair in pairs)),
        vehicle=made_from,
        ground=ground,
    )


def _pace(body: Multibody, u: Inputs) -> ca.SX:
    """Return the number of `STEP_SHARE` radii that the fastest wheel travels per second [1/s].

    The wanted rates of drives count as well, so that the pace is known at a start from rest.
    """
    inputs, fastest = iter(u.wheels), ca.SX(0)
    for each in body.wheels:
        wheel = each.wheel
        speed = ca.norm_2(each.motion.velocity) / wheel.radius
        wanted = next(inputs) if wheel.driven else ca.SX(0)
        rate = ca.SX(0) if wheel.acting_drive.takes_effort else ca.fabs(wanted)
        fastest = ca.fmax(fastest, ca.fmax(speed, rate))
    return fastest / STEP_SHARE


def check_dynamic(vehicle: Vehicle) -> None:
    """Raise ModelError if a vehicle cannot be used in dynamics."""
    check_mass(vehicle, "dynamics")
    for wheel in vehicle.wheels:
        if not (wheel.mass or wheel.inertia or wheel.acting_drive.prescribed):
            raise ModelError(
                f"dynamics: wheel {wheel.name!r}: expected a mass or a moment of inertia, since "
                "its rate is not prescribed, found neither; set its 'mass' or 'inertia'"
            )


def check_inertia(vehicle: Vehicle, labels: Labels, x: DynamicState, matrix: ca.SX) -> None:
    """Raise ModelError for a coordinate without inertia, with all coordinates at zero."""
    still = [float(label.name == "attitude_w") for label in leaves(labels.x)]
    values = np.diag(np.array(ca.Function("mass", [pack(x)], [matrix])(still)))[6:]
    for c, value in zip(vehicle.coordinates, values, strict=True):
        if not (c.acting_drive.prescribed or value > MIN_INERTIA):
            raise ModelError(
                f"dynamics: coordinate {c.name!r}: expected a part or a wheel with mass that it "
                "moves, found none; give a part or a wheel that it carries a mass"
            )


def with_depths(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle whose wheels have static depths."""
    exact = has_exact_closure(replace(vehicle, planar=False))
    wheels = (
        replace(wheel, static_depth=wheel.radius * EXACT_DEPTH)
        if exact and wheel.static_depth is None
        else replace(wheel, static_depth=wheel.depth)
        for wheel in vehicle.wheels
    )
    return replace(vehicle, wheels=tuple(wheels))


def moving_vehicle(vehicle: Vehicle, terrain: Terrain, labels: Labels) -> MovingVehicle:
    """Return the vehicle as a system of rigid bodies, with symbols for states and inputs."""
    x: DynamicState = symbols(labels.x)
    whole = in_space(vehicle, x)
    attitude = ca.vertcat(*x.attitude)
    rotation = turn("x", attitude).rotation if vehicle.planar else rotation_of(attitude)
    base = Pose(rotation, ca.vertcat(whole.x, x.y, x.z))
    rates = ca.vertcat(ca.SX(0, 1), *x.joint_speeds)
    speeds = Speeds(ca.vertcat(*whole.velocity), ca.vertcat(*whole.omega), rates, x.spins)
    names = [c.name for c in vehicle.coordinates]
    body = multibody(vehicle, base, dict(zip(names, x.joints, strict=True)), speeds)
    return MovingVehicle(vehicle, terrain, LookupTable(), x, symbols(labels.u), body)


def _contacts(
    moving: MovingVehicle, prisms: Sequence[Prism], law: ContactLaw
) -> list[tuple[Contact, ...]]:
    """Return the contacts of each wheel: with the terrain, then with each solid.

    Wheels with equal sections share a search on the terrain.
    """
    vehicle, terrain, lookups = moving[:3]
    radii = {wheel.section: wheel.radius for wheel in vehicle.wheels}
    searches = {each: search_function(terrain, each, radius) for each, radius in radii.items()}
    found, share = list[tuple[Contact, ...]](), vehicle.weight / len(vehicle.wheels)
    origin = ca.DM(terrain.origin[:2])
    for each in moving.body.wheels:
        wheel, pose = each.wheel, each.motion.pose
        touches = [
            touch(terrain, wheel, pose, searches[wheel.section], lookups),
            *(solid_touch(prism, terrain, wheel, pose, lookups) for prism in prisms),
        ]
        on_wheel = list[Contact]()
        for at in touches:
            slip = slip_velocity(each, at)
            place = at.frame.point[:2] + origin
            motion = slip, each.spin, pose.origin, place
            state = WheelContact(wheel, at, *motion, share, vehicle.gravity)
            on_wheel.append(Contact(at, slip, each.spin, law.force(state)))
        found.append(tuple(on_wheel))
    return found


def slip_velocity(wheel: WheelMotion, at: Touch) -> ca.SX:
    """Return the velocity of the wheel's material point at its contact, shape (3, 1) [m/s].

    On rollers, it has no component across their axles.
    """
    omega = wheel.motion.omega - wheel.rate * wheel.axle
    slip = wheel.motion.velocity + ca.cross(omega, at.frame.point - wheel.motion.pose.origin)
    return without_rolling(wheel.wheel, at.frame, slip)


class _Wheel(NamedTuple):
    """Moments on a wheel, and its contributions to the equations of motion.

    Moment of the ground about the axle, torque of the drive, zero if the rate is prescribed [N m],
    time derivative of a prescribed rate [rad/s^2], rate of the integral of the drive's controller,
    empty without one [N m/s], and the load on the wheel's carrier.
    """

    resisting: ca.SX
    torque: ca.SX
    acceleration: ca.SX
    integral_rate: tuple[ca.SX, ...]
    load: Load


def equations_of_motion(
    moving: MovingVehicle, contacts: Contacts, matrix: ca.SX, bias: ca.SX
) -> tuple[ca.SX, Effort]:
    """Return the rates of the states, and the efforts of drives and actuators.

    ``matrix`` is the mass matrix, ``bias`` are the inertial forces at constant speeds less gravity.
    """
    vehicle, x, body = moving.vehicle, moving.x, moving.body
    wheels = _wheels(moving, contacts.wheels)
    loads = [each.load for each in wheels] + [each.load for each in contacts.bodies]
    forces = generalised_forces(body, loads) - bias
    accelerations, actuators, joint_integrals = _accelerations(moving, matrix, forces)
    spins, torques, integrals = list[ca.SX](), list[ca.SX](), list[ca.SX]()
    for wheel, on in zip(body.wheels, wheels, strict=True):
        if wheel.prescribed:
            alpha = angular_acceleration(body, wheel.wheel.parent, accelerations)
            spins.append(on.acceleration)
            spin_rate = on.acceleration - ca.dot(alpha, wheel.axle)
            torques.append(wheel.axial * spin_rate + on.resisting)
        else:
            spins.append((on.torque - on.resisting) / (wheel.axial + wheel.rotor))
            torques.append(on.torque)
        integrals.extend(on.integral_rate)
    attitude = ca.vertcat(*x.omega)
    if not vehicle.planar:  # the rate of the quaternion
        quaternion, omega = ca.vertcat(*x.attitude), attitude
        scalar, vector = quaternion[0], quaternion[1:]
        change = ca.vertcat(-ca.dot(omega, vector), scalar * omega + ca.cross(omega, vector)) / 2
        attitude = change + NORMALISATION * (1 - ca.sumsqr(quaternion)) * quaternion
    speeds = *x.velocity, attitude, *x.joint_speeds
    free = accelerations[[*_free_speeds(vehicle), *range(6, accelerations.numel())]]
    ode = ca.vertcat(*speeds, free, *spins, *integrals, *joint_integrals)
    return ode, Effort(tuple(torques), actuators)


def _free_speeds(vehicle: Vehicle) -> Sequence[int]:
    """Return the indices of the platform's generalised speeds that are not fixed at zero."""
    return PLANE if vehicle.planar else SPACE


def _wheels(moving: MovingVehicle, contacts: Sequence[tuple[Contact, ...]]) -> list[_Wheel]:
    """Return the loads of each wheel: contact forces, drive torque and reaction of the drive."""
    inputs, integrals = iter(moving.u.wheels), iter(moving.x.drives)
    loads, body, zero = list[_Wheel](), moving.body, ca.SX(0)
    for wheel, touching in zip(body.wheels, contacts, strict=True):
        drive = wheel.wheel.acting_drive
        wanted = next(inputs) if wheel.wheel.driven else zero
        integral = next(integrals) if drive.has_integral else zero
        torque, rate = drive.effort(wanted, wheel.rate, integral)
        center = wheel.motion.pose.origin
        force = sum((each.total for each in touching), ca.SX.zeros(3))
        moment = sum((each.moment(center) for each in touching), ca.SX.zeros(3))
        resisting, acceleration = ca.dot(wheel.axle, moment), zero
        about = torque - resisting  # the reaction of the drive instead of the axial moment
        if wheel.prescribed:
            acceleration = (wanted - wheel.speed) / LAG
            about = wheel.axial * acceleration
        arm = ca.cross(center - body.origin, force)
        load = Load(wheel.wheel.parent, force, arm + moment + about * wheel.axle)
        rates = (rate,) if drive.has_integral else ()
        loads.append(_Wheel(resisting, torque, acceleration, rates, load))
    return loads


def _accelerations(
    moving: MovingVehicle, matrix: ca.SX, forces: ca.SX
) -> tuple[ca.SX, tuple[ca.SX, ...], tuple[ca.SX, ...]]:
    """Return the rates of the generalised speeds, and efforts and integrals' rates of actuators.

    ``forces`` are those of contacts, drives of wheels, gravity and inertia at constant speeds.
    Springs, dampers and efforts of drives act on the coordinates whose rates are not prescribed.
    """
    vehicle, x = moving.vehicle, moving.x
    found, efforts = ca.SX.zeros(matrix.shape[0]), ca.SX.zeros(matrix.shape[0])
    inputs, integrals, integral_rates = iter(moving.u.joints), iter(x.joint_drives), list[ca.SX]()
    fixed, free = list[int](), [*_free_speeds(vehicle)]
    for k, c in enumerate(vehicle.coordinates):
        value, rate, drive = x.joints[k], x.joint_speeds[k], c.acting_drive
        (fixed if drive.prescribed else free).append(6 + k)
        wanted = next(inputs) if c.kind == "commanded" else ca.SX(0)
        if drive.prescribed:
            found[6 + k] = (wanted - rate) / LAG
        integral = next(integrals) if drive.has_integral else ca.SX(0)
        efforts[6 + k], integral_rate = drive.effort(wanted, rate, integral)
        if drive.has_integral:
            integral_rates.append(integral_rate)
        if c.is_loaded:
            forces[6 + k] -= ca.gradient(c.potential(value), value) + c.damping * rate
    right = forces[free] + efforts[free] - matrix[free, fixed] @ found[fixed]
    found[free] = ca.ldl_solve(right, *ca.ldl(matrix[free, free]))
    efforts[fixed] = matrix[fixed, :] @ found - forces[fixed]
    pairs = zip(vehicle.coordinates, ca.vertsplit(efforts)[6:], strict=True)
    actuators = tuple(effort for c, effort in pairs if c.kind == "commanded")
    return found, actuators, tuple(integral_rates)
