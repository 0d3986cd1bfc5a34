"""Driving laws: feedback in the model's own symbols that keeps a vehicle on its way."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.geometry.frame import Pose
from slipfree.named import Array, unpack
from slipfree.trajectory import Trajectory
from slipfree.vehicle.chain import Vehicle
from slipfree.vehicle.wheel import Wheel

LARGEST_STEER = 0.5  # steering angle that the law asks for at most [rad]
STEER_GAIN = 4.0  # rate of the steering per wheelbase driven
TILT_GAIN = 2.0  # decay of the mean tilt per wheelbase driven


class _Plan(NamedTuple):
    """Plan view of a vehicle with one steered wheel: offsets from the driven axle, and tilts."""

    wheelbase: float
    lateral: Array
    radius: Array
    tilts: tuple[str, ...]


def straight(
    dae: Dae[Any, Any, Any, Any, Any], vehicle: Vehicle, start: Trajectory, *, speed: float
) -> Any:
    """Return inputs that drive a vehicle straight on, along its heading at the start.

    The steering follows heading and cross-track error. The driven wheels turn at the rates that
    fit the steering on a plane, corrected so that the mean of the passive tilts decays: tilts take
    up whatever does not fit, and would otherwise drift until the wheels lie down.

    Parameters
    ----------
    dae : Dae
        The vehicle's direct kinematics.
    vehicle : Vehicle
        One steered free wheel, and driven wheels on one axle.
    start : Trajectory
        Where it starts.
    speed : float
        Speed of the middle of the driven axle over level ground, forward positive. [m/s]

    Returns
    -------
    record
        Inputs as expressions of the symbols of ``dae``.

    Raises
    ------
    ModelError
        If the speed is zero or not finite or the vehicle is of another kind.
    """
    if not np.isfinite(speed) or speed == 0:
        raise ModelError(f"driver straight: speed must not be zero, found {speed} m/s")
    plan = _plan(vehicle)
    x_0, y_0, heading_0 = dae.rows("x", start, -1)[:3]
    states = dict(zip((label.name for label in _joint_labels(dae)), dae.x.joints, strict=True))
    steer = states[vehicle.of("commanded")[0].name]
    forward = (-np.sin(heading_0), np.cos(heading_0))
    left_of_line = -(dae.x.x - x_0) * forward[1] + (dae.x.y - y_0) * forward[0]
    pace = speed / plan.wheelbase  # wheelbases a second
    # Offset d and distance in wheelbases: d' = sign e, d'' = steer = -2 d' - d, critically damped.
    error = np.sign(speed) * (dae.x.heading - heading_0) * 2 + left_of_line / plan.wheelbase
    wanted = -LARGEST_STEER * ca.tanh(error / LARGEST_STEER)
    turning = pace * ca.tan(steer)
    if plan.tilts:
        tilt = sum(states[name] for name in plan.tilts) / len(plan.tilts)
        turning -= TILT_GAIN * abs(pace) * plan.radius.mean() / plan.wheelbase * tilt
    wheels = [(speed + turning * x) / r for x, r in zip(plan.lateral, plan.radius, strict=True)]
    return unpack(dae.u, [*wheels, STEER_GAIN * abs(pace) * (wanted - steer)])


def _joint_labels(dae: Dae[Any, Any, Any, Any, Any]) -> tuple[Any, ...]:
    joints: tuple[Any, ...] = dae.labels.x.joints
    return joints


def _plan(vehicle: Vehicle) -> _Plan:
    """Return the plan view in the zero configuration, or say why the law does not fit."""
    commanded = vehicle.of("commanded")
    if len(commanded) != 1:
        raise ModelError(
            f"driver straight: needs one steered wheel, {vehicle.name} has {len(commanded)} "
            "commanded coordinates"
        )
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    poses = vehicle.carriers(rest, {c.name: ca.SX(0) for c in vehicle.coordinates})
    places = [np.array(ca.evalf(pose.origin)).ravel() for pose in poses]
    joint_of = {joint.name: joint for joint in vehicle.joints}

    def turned_by(wheel: Wheel) -> str:
        return joint_of[wheel.parent].coordinate if wheel.parent in joint_of else ""

    pairs = list(zip(vehicle.wheels, places, strict=True))
    steered = [p for w, p in pairs if turned_by(w) == commanded[0].name]
    driven = [(w, p) for w, p in pairs if w.driven]
    if len(steered) != 1 or not driven:
        raise ModelError(f"driver straight: {vehicle.name} has no single steered wheel")
    wheelbase = float(steered[0][1] - np.mean([p[1] for _, p in driven]))
    passive = {c.name for c in vehicle.of("passive")}
    return _Plan(
        wheelbase,
        np.array([p[0] for _, p in driven]),
        np.array([w.radius for w, _ in driven]),
        tuple(turned_by(w) for w, _ in driven if turned_by(w) in passive),
    )
