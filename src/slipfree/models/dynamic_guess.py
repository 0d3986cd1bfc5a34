"""Initial guess of a plan with inertia, from the motion of a kinematic model."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.records import Array, Label, leaves
from slipfree.core.trajectory import Column, Trajectory
from slipfree.vehicle.tree import GRAVITY, Vehicle

EASE_IN = 1.3  # exponent of the time in the progress of a motion that begins at rest


def dynamic_guess(model: Dae, vehicle: Vehicle, start: Trajectory, run: Trajectory) -> Trajectory:
    """Return the motion of a dynamic model along the path of a kinematic model's motion.

    Parameters
    ----------
    model : Dae
        Result of `slipfree.models.rigid_dynamics.rigid_dynamics`.
    vehicle : Vehicle
        Vehicle of both models.
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
    moved = Trajectory(
        t,
        {
            name: Column(column.label, _resampled(column.values, t, progress))
            for name, column in run.columns.items()
        },
        run.wheels,
    )
    known = dict(_states(model, vehicle, moved, np.gradient(progress, t)))
    known |= _inputs(model, vehicle, moved, np.gradient(progress, t))
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
    return Trajectory(t, columns, run.wheels)


def _resampled(values: Array, t: Array, at: Array) -> Array:
    """Return samples at times ``t`` interpolated at times ``at``, along the first axis."""
    rows = values.reshape(t.size, -1)
    return np.column_stack([np.interp(at, t, row) for row in rows.T]).reshape(values.shape)


def _states(
    model: Dae, vehicle: Vehicle, run: Trajectory, pace: Array
) -> Iterator[tuple[str, Array]]:
    """Yield the states and contact points by name; ``pace`` is the rate of the progress [1]."""
    labels = model.labels.x
    for label in (labels.x, labels.y, labels.z, *labels.joints):
        yield label.full, run[label.name]
    attitude = _attitude(run)
    rates = np.gradient(attitude, run.t, axis=1)
    omega = 2 * _product(rates, attitude * np.array([[1.0], [-1.0], [-1.0], [-1.0]]))[1:]
    vectors = (labels.attitude, attitude), (labels.omega, omega)
    for names, rows in vectors:
        yield from zip((label.full for label in names), rows, strict=True)
    for label, name in zip(labels.velocity, "xyz", strict=True):
        yield label.full, np.gradient(run[name], run.t)
    for label, coordinate in zip(labels.joint_speeds, vehicle.coordinates, strict=True):
        yield label.full, np.gradient(run[coordinate.name], run.t)
    for k, label in enumerate(labels.spins):
        yield label.full, run["wheel_rate"][:, k] * pace
    for contact in model.labels.z.contacts:
        for label in contact:
            yield label.full, run.of(label)


def _inputs(model: Dae, vehicle: Vehicle, run: Trajectory, pace: Array) -> dict[str, Array]:
    """Return the inputs by name: rates of the motion, or the torques that it requires."""
    place = np.stack([run[name] for name in "xyz"])
    path = np.cumsum(np.append(0.0, np.linalg.norm(np.diff(place), axis=0)))
    speed = np.gradient(path, run.t)
    climb = np.gradient(run["z"], run.t) / np.maximum(speed, np.finfo(float).eps)
    force = vehicle.mass * (np.gradient(speed, run.t) + GRAVITY * climb)
    driven = [wheel for wheel in vehicle.wheels if wheel.driven]
    found = dict[str, Array]()
    for label, wheel in zip(model.labels.u.wheels, driven, strict=True):
        rate = run["wheel_rate"][:, run.wheels.index(wheel.name)] * pace
        torque = force * wheel.radius / len(driven) * np.sign(rate)
        found[label.full] = torque if wheel.drive.takes_effort else rate
    joints: list[Label] = list(model.labels.u.joints)
    for label, coordinate in zip(joints, vehicle.of("commanded"), strict=True):
        change = np.gradient(run[coordinate.name], run.t)
        found[label.full] = np.zeros_like(change) if coordinate.drive.takes_effort else change
    return found


def _attitude(run: Trajectory) -> Array:
    """Return the quaternion (w, x, y, z) of the platform, shape (4, n)."""
    found = np.vstack([np.ones(run.t.size), np.zeros((3, run.t.size))])
    for name, axis in (("heading", 3), ("roll", 2), ("pitch", 1)):
        turn = np.zeros_like(found)
        turn[0], turn[axis] = np.cos(run[name] / 2), np.sin(run[name] / 2)
        found = _product(found, turn)
    return found


def _product(p: Array, q: Array) -> Array:
    """Return the products of quaternions (w, x, y, z), shape (4, n)."""
    scalar = p[0] * q[0] - (p[1:] * q[1:]).sum(axis=0)
    vector = p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:], axis=0)
    return np.vstack([scalar, vector])
