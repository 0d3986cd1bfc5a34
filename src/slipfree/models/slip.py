"""Slip velocities of the wheels, in a model's symbols and along a motion."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from slipfree.contact.closure import ContactFrame
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, pack
from slipfree.core.trajectory import Trajectory
from slipfree.geometry.frame import Pose
from slipfree.models.base import carriers, joint_rates, spins
from slipfree.models.poses import wheel_poses
from slipfree.models.records import Configuration, Dependent, Inputs, Rates
from slipfree.vehicle.tree import Vehicle
from slipfree.vehicle.wheel import Wheel


def slip_velocity(
    wheel: Wheel, carrier: Pose, contact: ContactFrame, q: ca.SX, q_dot: ca.SX, wheel_rate: ca.SX
) -> ca.SX:
    """Return the velocity over the ground of a wheel's material point at its contact.

    Parameters
    ----------
    wheel : Wheel
        The wheel. If it has rollers, its contact point has no velocity across the wheel.
    carrier : Pose
        Pose of the part that carries the wheel, at the wheel's centre, as a function of ``q``.
    contact : ContactFrame
        Contact frame of the wheel.
    q, q_dot : SX, shape (n, 1)
        Coordinates of the vehicle, and their rates. [m, rad, m/s, rad/s]
    wheel_rate : SX, shape (1, 1)
        Rate of the wheel about its axle, positive for forward motion. [rad/s]

    Returns
    -------
    SX, shape (3, 1)
        Slip velocity in fixed axes; its normal component vanishes if the wheel keeps contact. [m/s]
    """
    twist = carrier.twist(q, q_dot)
    omega = twist.omega - wheel_rate * carrier.rotation[:, 0]  # wheel frame R Rx(-theta)
    slip = twist.v + ca.cross(omega, contact.point - carrier.origin)
    return slip - contact.across * ca.dot(contact.across, slip) if wheel.rollers else slip


def slip_velocities(
    vehicle: Vehicle,
    x: Configuration,
    position: Dependent,
    contacts: Sequence[ContactFrame],
    rates: Rates,
    u: Inputs,
) -> tuple[ca.SX, ...]:
    """Return the slip velocities of all wheels of a vehicle [m/s].

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    x, position : Configuration and Dependent
        Coordinates of platform and joints. [m, rad]
    contacts : sequence of ContactFrame
        Contact frames of the wheels.
    rates, u : Rates and Inputs
        Rates of these coordinates and of the wheels. [m/s, rad/s]

    Returns
    -------
    tuple of SX, shape (3, 1)
        Slip velocities in fixed axes, one for each wheel. [m/s]
    """
    q, q_dot = _coordinates(vehicle, x, position, rates, u)
    poses, turning = carriers(vehicle, x, position), spins(vehicle, rates, u)
    return tuple(
        slip_velocity(wheel, pose, contact, q, q_dot, spin)
        for wheel, pose, contact, spin in zip(vehicle.wheels, poses, contacts, turning, strict=True)
    )


def absolute_spins(
    vehicle: Vehicle, x: Configuration, position: Dependent, rates: Rates, u: Inputs
) -> tuple[ca.SX, ...]:
    """Return the angular velocities of the wheels about their axles, relative to fixed axes.

    They are positive for forward motion. Parameters are those of `slip_velocities`. [rad/s]
    """
    q, q_dot = _coordinates(vehicle, x, position, rates, u)
    poses, turning = carriers(vehicle, x, position), spins(vehicle, rates, u)
    return tuple(
        rate - ca.dot(pose.rotation[:, 0], pose.twist(q, q_dot).omega)
        for pose, rate in zip(poses, turning, strict=True)
    )


def _coordinates(
    vehicle: Vehicle, x: Configuration, position: Dependent, rates: Rates, u: Inputs
) -> tuple[ca.SX, ca.SX]:
    """Return the coordinates of a vehicle and their rates, as columns of equal order."""
    joints = joint_rates(vehicle, rates, u)
    inclination = rates.z, rates.roll, rates.pitch
    q_dot = pack((rates.x, rates.y, rates.heading, joints, *inclination, rates.suspension))
    return pack((*x, *position[:4])), q_dot


def measured_slip(vehicle: Vehicle, run: Trajectory) -> Array:
    """Return the slip velocities of a motion, from finite differences of its poses.

    The material point that touches the ground at a sample moves with the wheel through the
    neighbouring samples; its velocity is a difference quotient over five samples. The result is
    independent of the model's rates. It includes the motion that rollers permit.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    run : Trajectory
        Motion of the vehicle with at least five equally spaced samples.

    Returns
    -------
    ndarray, shape (n - 4, n_wheels, 3)
        Slip velocities in fixed axes, without the first two and the last two samples. [m/s]

    Raises
    ------
    ModelError
        If there are fewer than five samples, if they are not equally spaced, or if the motion lacks
        the poses or contact points of the wheels.
    """
    steps = np.diff(run.t)
    if steps.size < 4:
        raise ModelError(
            f"measured_slip: expected at least five samples, found {run.t.size}; sample the motion "
            "at more times"
        )
    if not np.allclose(steps, steps[0], rtol=1e-6, atol=0):
        raise ModelError(
            f"measured_slip: expected equally spaced samples, found steps of {steps.min():.4g} to "
            f"{steps.max():.4g} s; sample the motion at constant steps"
        )
    centers, rotations = wheel_poses(vehicle, run)
    contacts = np.stack([run[f"contact_{axis}"] for axis in "xyz"], -1)
    places = np.einsum("nwji,nwj->nwi", rotations, contacts - centers)[2:-2]
    n = run.t.size

    def carried(k: int) -> Array:
        span = slice(2 + k, n - 2 + k)
        return np.asarray(centers[span] + np.einsum("nwij,nwj->nwi", rotations[span], places))

    differences = carried(-2) - 8 * carried(-1) + 8 * carried(1) - carried(2)
    return np.asarray(differences / (12 * steps[0]))
