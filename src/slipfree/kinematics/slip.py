"""Slip of the wheels, and the rates that make it least."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from slipfree.contact.closure import Touch
from slipfree.geometry.frame import Pose


def slip_velocity(
    carrier: Pose, contact: Touch, q: ca.SX, q_dot: ca.SX, wheel_rate: ca.SX
) -> ca.SX:
    """Return the velocity of a wheel's material contact point over the ground, shape (3, 1).

    Parameters
    ----------
    carrier : Pose
        Pose of the part that carries the wheel, at the wheel's centre, as a function of ``q``.
    contact : Touch
        Where the wheel touches the ground.
    q, q_dot : SX, shape (n, 1)
        Coordinates of the vehicle and their rates.
    wheel_rate : SX, shape (1, 1)
        Rate of the wheel about its axle, positive drives forward. [rad/s]

    Returns
    -------
    SX, shape (3, 1)
        In fixed axes; its normal part vanishes on the holonomic constraint. [m/s]
    """
    twist = carrier.twist(q, q_dot)
    omega = twist.omega - wheel_rate * carrier.rotation[:, 0]  # wheel frame R Rx(-theta)
    return twist.v + ca.cross(omega, contact.point - carrier.origin)


def least_slip(
    slips: Sequence[ca.SX], normals: Sequence[ca.SX], rates: ca.SX, multipliers: ca.SX
) -> ca.SX:
    """Return the conditions for the least slip that the contacts allow, shape (n + m, 1).

    The rates are the stationary point of ``L = 1/2 sum s.s + sum lambda n.s``: the slip
    velocities ``s`` are least in the mean square while no wheel leaves or enters the ground. Since
    ``n.s`` vanishes, only the tangential slip counts. What a vehicle does on real ground also
    depends on friction: this is the least slip that kinematics allows, not a prediction.

    Parameters
    ----------
    slips, normals : sequence of SX, shape (3, 1)
        Slip velocity and unit normal at every wheel. [m/s, 1]
    rates, multipliers : SX, shapes (n, 1) and (m, 1)
        The unknowns.
    """
    lagrangian = sum(0.5 * ca.sumsqr(s) for s in slips)
    for s, n, multiplier in zip(slips, normals, ca.vertsplit(multipliers), strict=True):
        lagrangian += multiplier * ca.dot(n, s)
    return ca.gradient(lagrangian, ca.vertcat(rates, multipliers))
