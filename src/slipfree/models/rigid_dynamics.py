"""Rigid dynamics: motion with inertia of a vehicle on rigid ground, for plans.

The equations of motion are those of `slipfree.models.dynamics`. The normal forces are multipliers
of the contact constraints instead of functions of the depths, so that a plan need not resolve the
fast vibrations of a compliant contact. With the depth ``d`` of a wheel and its normal force ``N``,
the constraint is

    ``d + d' / RELAXATION_RATE = d_0 N / (W / n)``,

where ``d_0`` is the static depth of the wheel and ``W / n`` its share of the vehicle's weight. At
rest a wheel therefore is as deep as on a compliant contact; for ``d_0 = 0`` it touches a rigid
ground, with the stabilisation of Baumgarte. Contact points are unknowns too: their equations have
exact derivatives of every order, unlike the searches of `slipfree.contact.touch`.

A plan is valid while no wheel lifts off, ``N >= 0``. It is verified by the simulation of the
compliant model (``Dae.replay``).

A vehicle with fewer suspension coordinates than wheels beyond three, such as a rigid four-wheeler,
rocks: its wheels leave uneven ground. Its normal forces are statically indeterminate on a rigid
ground, but not with static depths. With ``r`` the left-hand side of the constraint, less
``d_0 / 4``, they are those of a soft contact that only presses,

    ``(r + sqrt(r^2 + d_0^2)) / 2 = d_0 N / (W / n)``,

with the same load at the static depth. There is no limit on lift-off.

The initial guess of a plan follows from the motion of a kinematic model (`dynamic_guess`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy  # scipy.spatial is imported when it is used

from slipfree.contact.closure import check_support, contact_frame
from slipfree.contact.touch import Touch
from slipfree.core.arguments import checked
from slipfree.core.dae import Dae, Replay
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Label, leaves, symbols
from slipfree.core.trajectory import Column, Outcome, Trajectory
from slipfree.laws.compliant import Compliant
from slipfree.laws.linear_creep import LinearCreep
from slipfree.laws.protocols import Equations, GroundForce, GroundLaw, SlidingContacts, wheel_limits
from slipfree.models import dynamics
from slipfree.models.base import (
    ContactPoint,
    Inputs,
    at_rest,
    contact_checks,
    raised_poses,
    sizes,
    tangential_components,
    vehicle_dae,
)
from slipfree.models.limits import limits_of
from slipfree.models.multibody import bias_forces, mass_matrix
from slipfree.system.forks import computing
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

RELAXATION_RATE = 10.0  # rate at which depths follow the loads [1/s]
EASE_IN = 1.3  # exponent of the time in the progress of a motion that begins at rest


class RigidUnknowns(NamedTuple):
    """Unknowns of rigid dynamics: contact points [m], and normal forces and friction of the law."""

    contacts: tuple[ContactPoint, ...]
    law: Any


RigidDae = Dae[
    dynamics.DynamicState[ca.SX], RigidUnknowns, Inputs[ca.SX], dynamics.DynamicOutputs[ca.SX]
]


@checked
@computing
def rigid_dynamics(
    vehicle: Vehicle,
    ground: Terrain,
    *,
    law: GroundLaw = LinearCreep(),  # noqa: B008 - a frozen record
    contact: Compliant = Compliant(),  # noqa: B008 - a frozen record
) -> RigidDae:
    """Return the dynamic model of a vehicle on rigid ground, for plans.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle, with mass. If it has a suspension coordinate for each wheel beyond three, all
        wheels stay on the ground; otherwise wheels may lift off.
    ground : Terrain
        The ground, with friction.
    law : GroundLaw
        Friction: `LinearCreep` for wheels that roll, `Coulomb` with a creep speed of 0.03 m/s or
        more for wheels that slide, as in a turn of a skid-steered vehicle.
    contact : Compliant
        Wheel-ground law of the simulation that verifies a plan.

    Returns
    -------
    Dae
        Model with the states and inputs of `dynamics`, which is its ``replay``. Plans on this model
        contain its limits on normal forces (``lift_off``, if all wheels stay on the ground) and of
        the law from the beginning.

    Raises
    ------
    ModelError
        If the vehicle has fewer than three wheels or is locked to a plane, if contacts and springs
        do not determine its pose, or the vehicle, the ground or the law does not suit dynamics.

    Examples
    --------
    >>> from slipfree import Analytic, catalog, rigid_dynamics, settle
    >>> model = rigid_dynamics(catalog.skid_steer(), Analytic(lambda x, y: 0 * x, mu=0.8))
    >>> start = settle(model)
    >>> print(f"{start['load_share'].sum():.2f}")
    4.00
    """
    dynamics.check_dynamic(vehicle)
    contact.check(vehicle, ground)
    law.check(vehicle, ground)
    check_support(vehicle, "rigid-body dynamics: ")
    vehicle = dynamics.with_depths(vehicle)
    # with contact points and the law's unknowns as unknowns
    labels = dynamics.dynamic_labels(vehicle)
    points = tuple(map(ContactPoint, labels.y.contact_x, labels.y.contact_y))
    unknowns = RigidUnknowns(points, law.unknowns(vehicle))
    labels = labels._replace(z=unknowns, y=_without_unknowns(labels.y))
    moving, z = dynamics.moving_vehicle(vehicle, ground, labels), symbols(labels.z)
    x, body, lookups = moving.x, moving.body, moving.lookups
    matrix = mass_matrix(body)
    dynamics.check_inertia(vehicle, labels, x, matrix)
    touches = list[Touch]()  # at the ground points, with the points of the wheels
    for motion, at in zip(body.wheels, z.contacts, strict=True):
        frame = contact_frame(ground, at.x, at.y, motion.axle, lookups)
        section = motion.wheel.section
        point = motion.motion.pose.origin + section.support(-frame.normal, motion.axle)
        gap = ca.dot(frame.normal, point - frame.point)
        mu = motion.wheel.grip * ground.friction(at.x, at.y, lookups)
        touches.append(Touch(gap, frame._replace(point=point), mu))
    slips = [dynamics.slip_velocity(*each) for each in zip(body.wheels, touches, strict=True)]
    spins = tuple(wheel.spin for wheel in body.wheels)
    frames, share = tuple(each.frame for each in touches), vehicle.weight / len(vehicle.wheels)
    constraints = list[ca.SX]()  # of the contacts, as normal velocities
    for wheel, each, slip, n in zip(vehicle.wheels, touches, slips, z.law.normal, strict=True):
        pressed = -each.gap - ca.dot(each.frame.normal, slip) / RELAXATION_RATE
        if not _stays_on_ground(vehicle):
            pressed -= wheel.depth / 4  # the load at the static depth is the share of the weight
            pressed = (pressed + ca.sqrt(pressed**2 + wheel.depth**2)) / 2
        constraints.append(RELAXATION_RATE * (wheel.depth * n / share - pressed))
    friction, origin = tuple(each.friction for each in touches), ca.DM(ground.origin[:2])
    places = tuple(frame.point[:2] + origin for frame in frames)
    components = *tangential_components(frames, slips), tuple(constraints)
    of_wheels = *components, friction, moving.u.wheels, spins, places
    reaction = law.reaction(SlidingContacts(vehicle, *of_wheels, lambda _x, _z: ""), z.law)
    if reaction.torques:
        raise ModelError(
            "rigid-body dynamics: expected a law whose forces act at the contact points, such as "
            f"LinearCreep(), found {type(law).__name__}; use another law, or model = 'quasi-static'"
        )
    forces_on = (
        GroundForce(n, a * at.frame.along + c * at.frame.across, ca.SX(0), ca.SX(0))
        for at, n, a, c in zip(
            touches, reaction.normal, reaction.along, reaction.across, strict=True
        )
    )
    contacts = [
        dynamics.Contact(*each) for each in zip(touches, slips, spins, forces_on, strict=True)
    ]
    alone = dynamics.Contacts([(each,) for each in contacts])
    ode, effort = dynamics.equations_of_motion(moving, alone, matrix, bias_forces(body))
    q = dynamics.quantities(moving, contacts)
    forces = dynamics.dynamic_forces(q, alone, x, effort)
    y = dynamics.dynamic_outputs(q, body, contacts, alone, forces)
    raised = raised_poses(q.poses, frames, tuple(-each.gap for each in touches))
    scale, _ = sizes(vehicle, ground, labels)
    units = [label.unit for label in leaves(labels.z)]
    scale[[unit == "N" for unit in units]] = share
    own = tuple(each for each in reaction.limits if each.outcome is not Outcome.NO_EQUILIBRIUM)
    if _stays_on_ground(vehicle):
        why = "the ground would have to pull it"
        lifts = wheel_limits(vehicle, "lift_off", reaction.normal, 0.0, np.inf, why=why)
        own = (*lifts, *own)
    # the line from the contact point of the ground to that of the wheel is normal to the ground
    nearest, names = list[ca.SX](), list[Label]()
    words = "distance of the wheel from its contact point on the ground, {} the wheel"
    for wheel, at, frame in zip(vehicle.wheels, z.contacts, frames, strict=True):
        away = frame.point - ca.vertcat(at.x, at.y, ground.height(at.x, at.y, lookups))
        for axis, line in (("along", frame.along), ("across", frame.across)):
            nearest.append(ca.dot(line, away))
            names.append(Label(f"nearest_{axis}", "m", words.format(axis), wheel.name))
    below = [each.motion.pose.origin[:2] for each in body.wheels]
    return vehicle_dae(
        q,
        labels,
        x,
        z,
        (Equations(tuple(names), ca.vertcat(*nearest)), reaction.equations),
        forces,
        ode=ode,
        y=_without_unknowns(y),
        limits=(*limits_of(q, static=False), *own),
        checks=contact_checks(q._replace(contacts=frames), x, z, raised),
        guess=ca.densify(ca.vertcat(*below, at_rest(vehicle, labels.z.law))),
        scale=scale,
        suppress_algebraic=True,
        continuation=reaction.continuation,
        standing=dynamics.standing_start(vehicle, ground, (), labels),
        replay=Replay(dynamics.dynamics(vehicle, ground, law=contact), own),
    )


def _stays_on_ground(vehicle: Vehicle) -> bool:
    """Return whether all wheels of a vehicle can stay on an uneven rigid ground."""
    return len(vehicle.of("suspension")) >= len(vehicle.wheels) - 3


def _without_unknowns(y: dynamics.DynamicOutputs) -> dynamics.DynamicOutputs:
    """Return the outputs of dynamics without those that are unknowns of rigid dynamics."""
    common = y.common._replace(force_normal=())
    return y._replace(contact_x=(), contact_y=(), common=common)


def dynamic_guess(model: Dae, start: Trajectory, run: Trajectory) -> Trajectory:
    """Return the motion of a dynamic model along the path of a kinematic model's motion.

    Parameters
    ----------
    model : Dae
        Result of `slipfree.models.rigid_dynamics.rigid_dynamics`.
    start : Trajectory
        Trajectory of ``model`` whose last sample is the start of the plan.
    run : Trajectory
        Motion of a kinematic model of the vehicle, from the same position.

    Returns
    -------
    Trajectory
        States, unknowns and inputs of ``model`` at the times of ``run``. A motion that begins at
        rest accelerates gradually. Speeds are finite differences. The driven wheels share equally
        the force along the path that inertia and gravity require.
    """
    t = run.t - run.t[0]
    at_rest = not any(start.of(label)[-1] for label in model.labels.x.velocity)
    progress = t[-1] * (t / t[-1]) ** EASE_IN if at_rest else t
    resampled = dict[str, Column]()
    for name, (label, samples) in run.columns.items():
        rows = [np.interp(progress, t, row) for row in samples.reshape(t.size, -1).T]
        resampled[name] = Column(label, np.column_stack(rows).reshape(samples.shape))
    moved = Trajectory(t, resampled, run.wheels)
    known = dict(_states(model, moved, np.gradient(progress, t)))
    known |= _inputs(model, moved, np.gradient(progress, t))
    columns = dict[str, Column]()
    for label in leaves((model.labels.x, model.labels.z, model.labels.u)):
        values = known.get(label.full)
        if values is None:
            values = np.full(t.size, start.of(label)[-1])  # loads and friction
        if label.wheel is None:
            columns[label.name] = Column(label, values)
            continue
        count = len(run.wheels)
        column = columns.setdefault(label.name, Column(label, np.zeros((t.size, count))))
        column.values[:, run.wheels.index(label.wheel)] = values
    return Trajectory(t, columns, run.wheels, ground=run.ground)


def _states(model: Dae, run: Trajectory, pace: Array) -> Iterator[tuple[str, Array]]:
    """Yield the states and contact points by name; ``pace`` is the rate of the progress [1]."""
    labels = model.labels.x
    for label in (labels.x, labels.y, labels.z, *labels.joints):
        yield label.full, run[label.name]
    angles = np.column_stack([run[name] for name in ("heading", "roll", "pitch")])
    turned = scipy.spatial.transform.Rotation.from_euler("ZYX", angles)
    attitude = np.roll(turned.as_quat(), 1, axis=1).T  # (w, x, y, z)
    rates = np.gradient(attitude, run.t, axis=1)
    omega = attitude[0] * rates[1:] - rates[0] * attitude[1:]
    omega = 2 * (omega - np.cross(rates[1:], attitude[1:], axis=0))
    for names, rows in ((labels.attitude, attitude), (labels.omega, omega)):
        yield from zip((label.full for label in names), rows, strict=True)
    for label, name in zip(labels.velocity, "xyz", strict=True):
        yield label.full, np.gradient(run[name], run.t)
    for label, coordinate in zip(labels.joint_speeds, model.vehicle.coordinates, strict=True):
        yield label.full, np.gradient(run[coordinate.name], run.t)
    for k, label in enumerate(labels.spins):
        yield label.full, run["wheel_rate"][:, k] * pace
    for contact in model.labels.z.contacts:
        for label in contact:
            yield label.full, run.of(label)


def _inputs(model: Dae, run: Trajectory, pace: Array) -> dict[str, Array]:
    """Return the inputs by name: rates of the motion, or the torques that it requires."""
    vehicle: Vehicle = model.vehicle
    place = np.stack([run[name] for name in "xyz"])
    path = np.cumsum(np.append(0.0, np.linalg.norm(np.diff(place), axis=0)))
    speed = np.gradient(path, run.t)
    climb = np.gradient(run["z"], run.t) / np.maximum(speed, np.finfo(float).eps)
    force = vehicle.mass * (np.gradient(speed, run.t) + vehicle.gravity * climb)
    driven = [wheel for wheel in vehicle.wheels if wheel.driven]
    inputs = dict[str, Array]()
    for label, wheel in zip(model.labels.u.wheels, driven, strict=True):
        rate = run["wheel_rate"][:, run.wheels.index(wheel.name)] * pace
        torque = force * wheel.radius / len(driven) * np.sign(rate)
        inputs[label.full] = torque if wheel.drive.takes_effort else rate
    joints: list[Label] = list(model.labels.u.joints)
    for label, coordinate in zip(joints, vehicle.of("commanded"), strict=True):
        change = np.gradient(run[coordinate.name], run.t)
        inputs[label.full] = np.zeros_like(change) if coordinate.drive.takes_effort else change
    return inputs
