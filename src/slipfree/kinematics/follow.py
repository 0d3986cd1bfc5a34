"""Driving laws: feedback in the model's own symbols that keeps a vehicle on its way."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.geometry.frame import Pose
from slipfree.geometry.path import Path
from slipfree.named import unpack
from slipfree.trajectory import Trajectory
from slipfree.vehicle.chain import Vehicle
from slipfree.vehicle.wheel import Wheel

LARGEST_STEER = 0.5  # steering angle that the law asks for at most [rad]
STEER_GAIN = 4.0  # rate of the steering per base length driven
SLOW = 0.1  # part of the speed below which the steering no longer follows the turning wanted
TILT_GAIN = 2.0  # decay of the mean tilt per base length driven


class _Foot(NamedTuple):
    """A wheel in the plan of the vehicle: offsets from the middle of its turning axis. [m]."""

    wheel: Wheel
    right: float
    forward: float
    steer: str | None
    tilt: str | None


class _Plan(NamedTuple):
    """The plan of a vehicle: its wheels, its base length, and where its centre lies. [m]."""

    feet: tuple[_Foot, ...]
    base: float
    ahead: float

    @property
    def steered(self) -> tuple[_Foot, ...]:
        """The wheels whose steering makes the vehicle turn."""
        return tuple(f for f in self.feet if f.steer and abs(f.forward) > 1e-9)


def straight(
    dae: Dae[Any, Any, Any, Any, Any], vehicle: Vehicle, start: Trajectory, *, speed: float
) -> Any:
    """Return inputs that drive a vehicle straight on, along its heading at the start.

    Parameters, errors and law are those of `follow`, on the line ahead of the last sample of
    ``start``, or behind it if the speed is negative.
    """
    x, y, heading = (start[name][-1] for name in ("x", "y", "heading"))
    way = -1.0 if speed < 0 else 1.0
    ahead = (x - way * np.sin(heading), y + way * np.cos(heading))
    return follow(dae, vehicle, Path(np.array([(x, y), ahead])), speed=speed)


def follow(dae: Dae[Any, Any, Any, Any, Any], vehicle: Vehicle, path: Path, *, speed: float) -> Any:
    """Return inputs that keep the platform's centre on a path.

    A point runs along the path at the given speed, from its beginning at t = 0. Heading,
    cross-track and along-track errors against it decay within a base length. The wheels turn at
    the rates that fit the steering on a plane, corrected so that the mean of passive tilts
    decays: tilts take up whatever does not fit, and would else drift until the wheels lie down.

    Parameters
    ----------
    dae : Dae
        The vehicle's direct kinematics.
    vehicle : Vehicle
        With steered wheels, or with driven wheels left and right.
    path : Path
        Where to go.
    speed : float
        Speed over the map; negative drives backwards along the path. [m/s]

    Returns
    -------
    record
        Inputs as expressions of the symbols of ``dae``. Commanded coordinates that steer nothing
        are held.

    Raises
    ------
    ModelError
        If the speed is zero or not finite, or the vehicle can be made to turn by neither.
    """
    if not np.isfinite(speed) or speed == 0:
        raise ModelError(f"driver: the speed must be finite and not zero, found {speed} m/s")
    plan = _plan(vehicle)
    v, wanted = _guidance(dae, path, plan, speed)
    states = dict(zip((label.name for label in dae.labels.x.joints), dae.x.joints, strict=True))
    pace, rates, turning = abs(speed) / plan.base, {}, wanted
    if plan.steered:
        turning = _turning(plan, states, v)
        for foot in plan.steered:
            way = v + foot.right * wanted
            # the slope wanted / way, but smooth where the way changes its sign
            slope = foot.forward * wanted * way / (way**2 + (SLOW * speed) ** 2)
            angle = ca.atan(slope)
            angle = LARGEST_STEER * ca.tanh(angle / LARGEST_STEER)
            rates[foot.steer] = STEER_GAIN * pace * (angle - states[str(foot.steer)])
    tilts = [states[foot.tilt] for foot in plan.feet if foot.tilt]
    if tilts:
        radius = float(np.mean([foot.wheel.radius for foot in plan.feet if foot.tilt]))
        turning -= TILT_GAIN * pace * radius / plan.base * sum(tilts) / len(tilts)
    wheels = [_rate(foot, v, turning, states) for foot in plan.feet if foot.wheel.driven]
    joints = [rates.get(c.name, ca.SX(0)) for c in vehicle.of("commanded")]
    return unpack(dae.u, [*wheels, *joints])


def _guidance(
    dae: Dae[Any, Any, Any, Any, Any], path: Path, plan: _Plan, speed: float
) -> tuple[ca.SX, ca.SX]:
    """Return the speed and the turning rate that lead to the point that runs along the path."""
    place = path.symbolic(abs(speed) * dae.t, (dae.shift[0][0], dae.shift[0][1]))
    way, base = np.sign(speed), plan.base
    curvature = way * place.curvature
    direction = place.heading + (0 if way > 0 else np.pi)
    forward = (-ca.sin(direction), ca.cos(direction))
    d_x, d_y = dae.x.x - place.x, dae.x.y - place.y
    along, left = d_x * forward[0] + d_y * forward[1], d_y * forward[0] - d_x * forward[1]
    # the centre moves to the left of the vehicle's heading, by its distance from the turning axis
    turned = dae.x.heading - direction + ca.atan(plan.ahead * curvature)
    v = speed * ca.cos(turned) - abs(speed) / base * along
    # left' = v sin, turned' = turning - v curvature: critically damped over a base length
    error = ca.sin(turned)  # smooth, where an angle would jump
    turning = speed * curvature - (2 * abs(speed) * error + speed * left / base) / base
    return v, turning


def _turning(plan: _Plan, states: dict[str, ca.SX], v: ca.SX) -> ca.SX:
    """Return the rate at which the steered wheels make the vehicle turn on a plane. [rad/s]."""
    total = ca.SX(0)
    for foot in plan.steered:
        slope = ca.tan(states[str(foot.steer)])
        total += v * slope / (foot.forward - foot.right * slope)
    return total / len(plan.steered)


def _rate(foot: _Foot, v: ca.SX, turning: ca.SX, states: dict[str, ca.SX]) -> ca.SX:
    """Return the rate of a driven wheel that fits a plane motion. [rad/s]."""
    v_forward, v_left = v + foot.right * turning, foot.forward * turning
    if foot.steer is None:
        return v_forward / foot.wheel.radius
    angle = states[foot.steer]
    return (ca.cos(angle) * v_forward + ca.sin(angle) * v_left) / foot.wheel.radius


def _plan(vehicle: Vehicle) -> _Plan:
    """Return the plan of a vehicle in its zero configuration, or say why it cannot be driven.

    The vehicle turns about an axis through the wheels that are neither steered nor castors; if
    there are none, through its centre.
    """
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    poses = vehicle.carriers(rest, {c.name: ca.SX(0) for c in vehicle.coordinates})
    places = [np.array(ca.evalf(pose.origin)).ravel() for pose in poses]
    turned = [_turned(vehicle, wheel) for wheel in vehicle.wheels]
    passive = {c.name for c in vehicle.of("passive")}
    fixed = [place[1] for place, by in zip(places, turned, strict=True) if "z" not in by]
    axis = float(np.mean(fixed)) if fixed else 0.0
    feet = []
    for wheel, place, by in zip(vehicle.wheels, places, turned, strict=True):
        steer, tilt = by.get("z"), by.get("y")
        feet.append(
            _Foot(
                wheel,
                float(place[0]),
                float(place[1]) - axis,
                steer if steer not in passive else None,
                tilt if tilt in passive and wheel.driven else None,
            )
        )
    sides = {np.sign(f.right) for f in feet if f.wheel.driven and f.steer is None}
    plan = _Plan(tuple(feet), 1.0, -axis)
    if not plan.steered and not {-1.0, 1.0} <= sides:
        raise ModelError(
            f"driver: {vehicle.name} has no steered wheel, nor driven wheels on both sides"
        )
    lengths = [abs(f.forward) for f in plan.steered] or [abs(f.right) for f in feet]
    return plan._replace(base=float(max(lengths)))


def _turned(vehicle: Vehicle, wheel: Wheel) -> dict[str, str]:
    """Return the coordinates that turn a wheel, by axis."""
    joints = {joint.name: joint for joint in vehicle.joints}
    turned: dict[str, str] = {}
    part = wheel.parent
    while part in joints:
        joint = joints[part]
        if joint.motion == "turn":
            turned.setdefault(joint.axis, joint.coordinate)
        part = joint.parent
    return turned
