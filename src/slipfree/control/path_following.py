"""Driving laws: feedback in the model's own symbols that keeps a vehicle on its way."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.geometry.frame import Pose
from slipfree.geometry.path import Path
from slipfree.records import Array, unpack
from slipfree.trajectory import Trajectory
from slipfree.vehicle.tree import Vehicle
from slipfree.vehicle.wheel import Wheel

LARGEST_STEER = 0.5  # steering angle that the law asks for at most [rad]
STEER_GAIN = 4.0  # rate of the steering per base length driven
NEAR = 1e-9  # lengths and effects below this are none [m, 1]
SLOW = 0.1  # part of the speed below which the steering no longer follows the turning wanted
TILT_GAIN = 2.0  # decay of the mean tilt per base length driven


class _Foot(NamedTuple):
    """A wheel in the plan of the vehicle, as expressions of the commanded coordinates.

    Attributes
    ----------
    wheel : Wheel
        The wheel.
    right, forward : SX
        Where it is, from the middle of the turning axis. [m]
    angle : SX
        Heading of the wheel in the platform's plan, left positive. [rad]
    effects : mapping of str to SX
        How much each commanded coordinate turns it. [rad/rad, rad/m]
    leans : str or None
        The passive coordinate that leans it sideways, if it is driven.
    """

    wheel: Wheel
    right: ca.SX
    forward: ca.SX
    angle: ca.SX
    effects: dict[str, ca.SX]
    leans: str | None


class _Plan(NamedTuple):
    """The plan of a vehicle.

    Attributes
    ----------
    feet, steered : tuple of _Foot
        Its wheels, and those whose steering makes it turn.
    base : float
        Its base length. [m]
    ahead : float
        How far its centre lies ahead of the turning axis. [m]
    gain : float
        Difference of the wheels' speeds for that of a vehicle that turns without slip: above one
        where unsteered wheels have to slip across. [1]
    """

    feet: tuple[_Foot, ...]
    steered: tuple[_Foot, ...]
    base: float
    ahead: float
    gain: float


def straight(dae: Dae, vehicle: Vehicle, start: Trajectory, *, speed: float) -> Any:
    """Return inputs that drive a vehicle straight on, along its heading at the start.

    Parameters, errors and law are those of `follow`, on the line ahead of the last sample of
    ``start``, or behind it if the speed is negative.
    """
    x, y, heading = (start[name][-1] for name in ("x", "y", "heading"))
    way = -1.0 if speed < 0 else 1.0
    ahead = (x - way * np.sin(heading), y + way * np.cos(heading))
    return follow(dae, vehicle, Path(np.array([(x, y), ahead])), speed=speed)


def follow(dae: Dae, vehicle: Vehicle, path: Path, *, speed: float) -> Any:
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

    Examples
    --------
    >>> import numpy as np
    >>> from slipfree import Analytic, Path, catalog, direct_kinematics, follow, settle, simulate
    >>> vehicle, ground = catalog.three_wheeler(), Analytic(lambda x, y: 0.02 * x * y)
    >>> model = direct_kinematics(vehicle, ground)
    >>> path = Path(np.array([[0.0, 0.0], [0.2, 2.0], [0.0, 4.0]]))
    >>> law = follow(model, vehicle, path, speed=0.4)
    >>> run = simulate(model, settle(model), law, np.linspace(0, 10, 51))
    >>> print(f"ends at ({run['x'][-1]:.2f}, {run['y'][-1]:.2f})")
    ends at (-0.01, 3.98)
    """
    if not np.isfinite(speed) or speed == 0:
        raise ModelError(f"driver: the speed must be finite and not zero, found {speed} m/s")
    states = dict(zip((label.name for label in dae.labels.x.joints), dae.x.joints, strict=True))
    plan = _plan(vehicle, {c.name: states[c.name] for c in vehicle.of("commanded")})
    v, wanted = _guidance(dae, path, plan, speed)
    pace, turning = abs(speed) / plan.base, wanted
    rates = dict.fromkeys((c.name for c in vehicle.of("commanded")), ca.SX(0))
    if plan.steered:
        turning = _turning(plan, v)
        rates |= _steering(plan, v, wanted, speed)
    tilts = [states[foot.leans] for foot in plan.feet if foot.leans]
    if tilts:
        radius = float(np.mean([foot.wheel.radius for foot in plan.feet if foot.leans]))
        turning -= TILT_GAIN * pace * radius / plan.base * sum(tilts) / len(tilts)
    moving = {states[name]: rate for name, rate in rates.items()}
    wheels = [
        _rate(foot, v, plan.gain * turning, moving) for foot in plan.feet if foot.wheel.driven
    ]
    return unpack(dae.u, [*wheels, *rates.values()])


def _guidance(dae: Dae, path: Path, plan: _Plan, speed: float) -> tuple[ca.SX, ca.SX]:
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


def _steering(plan: _Plan, v: ca.SX, wanted: ca.SX, speed: float) -> dict[str, ca.SX]:
    """Return rates that turn the steered wheels to where the turning wanted needs them."""
    errors: dict[str, ca.SX] = {}
    sizes: dict[str, ca.SX] = {}
    for foot in plan.steered:
        way = v + foot.right * wanted
        # the slope wanted / way, but smooth where the way changes its sign
        slope = foot.forward * wanted * way / (way**2 + (SLOW * speed) ** 2)
        angle = ca.atan(slope)
        error = LARGEST_STEER * ca.tanh(angle / LARGEST_STEER) - foot.angle
        for name, effect in foot.effects.items():
            errors[name] = errors.get(name, 0) + effect * error
            sizes[name] = sizes.get(name, 0) + effect**2
    pace = abs(speed) / plan.base
    return {name: STEER_GAIN * pace * error / sizes[name] for name, error in errors.items()}


def _turning(plan: _Plan, v: ca.SX) -> ca.SX:
    """Return the rate at which the steered wheels make the vehicle turn on a plane. [rad/s]."""
    total = ca.SX(0)
    for foot in plan.steered:
        slope = ca.tan(foot.angle)
        total += v * slope / (foot.forward - foot.right * slope)
    return total / len(plan.steered)


def _rate(foot: _Foot, v: ca.SX, turning: ca.SX, moving: dict[ca.SX, ca.SX]) -> ca.SX:
    """Return the rate of a driven wheel that fits a plane motion. [rad/s]."""
    place = ca.vertcat(foot.right, foot.forward)
    shift = ca.SX.zeros(2)
    for coordinate, rate in moving.items():
        shift += ca.jacobian(place, coordinate) * rate
    v_forward, v_left = v + foot.right * turning + shift[1], foot.forward * turning - shift[0]
    along = ca.cos(foot.angle) * v_forward + ca.sin(foot.angle) * v_left
    return along / foot.wheel.radius


def _plan(vehicle: Vehicle, states: dict[str, ca.SX]) -> _Plan:
    """Return the plan of a vehicle in its zero configuration, or say why it cannot be driven.

    The vehicle turns about an axis through the wheels that are neither steered nor castors nor
    have rollers; if there are none, through its centre.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    states : dict of str to SX
        Symbols of its commanded coordinates.
    """
    feet, fixed = [], []
    for wheel, (pose, effects, leans, swivels) in zip(
        vehicle.wheels, _placed(vehicle, states), strict=True
    ):
        angle = ca.atan2(-pose.rotation[0, 1], pose.rotation[1, 1])
        foot = _Foot(wheel, pose.origin[0], pose.origin[1], angle, effects, leans)
        feet.append(foot)
        if not (effects or swivels or wheel.rollers):
            fixed.append(foot)
    zeros = ca.vertcat(ca.SX(0, 1), *states.values()), ca.DM.zeros(len(states))

    def now(value: ca.SX) -> float:
        return float(ca.evalf(ca.substitute(value, *zeros)))

    axis = float(np.mean([now(foot.forward) for foot in fixed])) if fixed else 0.0
    feet = [foot._replace(forward=foot.forward - axis) for foot in feet]
    steered = tuple(f for f in feet if f.effects and abs(now(f.forward)) > NEAR)
    sides = {np.sign(now(f.right)) for f in feet if f.wheel.driven and not f.effects}
    if not steered and not {-1.0, 1.0} <= sides:
        raise ModelError(
            f"driver: {vehicle.name} has no steered wheel, nor driven wheels on both sides"
        )
    lengths = [abs(now(f.forward)) for f in steered] or [abs(now(f.right)) for f in feet]
    gain = 1.0
    if not steered and fixed:
        fixed = [foot._replace(forward=foot.forward - axis) for foot in fixed]
        rights = sum(now(f.right) ** 2 for f in fixed)
        gain = (rights + sum(now(f.forward) ** 2 for f in fixed)) / rights
    return _Plan(tuple(feet), steered, float(max(lengths)), -axis, gain)


def _placed(
    vehicle: Vehicle, states: dict[str, ca.SX]
) -> Iterator[tuple[Pose, dict[str, ca.SX], str | None, bool]]:
    """Yield, for every wheel, its pose in the level platform's frame and what turns it.

    What commanded coordinates turn it by; the passive coordinate that leans it, if it is driven;
    and whether it swivels about the vertical by a passive one.
    """
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    passive = {c.name: ca.SX.sym(c.name) for c in vehicle.of("passive")}
    values = {c.name: ca.SX(0) for c in vehicle.coordinates} | states | passive
    symbols = ca.vertcat(ca.SX(0, 1), *states.values(), *passive.values())
    level = ca.vertcat(ca.SX(0, 1), *passive.values())
    for wheel, pose in zip(vehicle.wheels, vehicle.carriers(rest, values), strict=True):
        angle = ca.atan2(-pose.rotation[0, 1], pose.rotation[1, 1])

        def at_zero(value: ca.SX) -> Array:
            return np.array(ca.evalf(ca.substitute(value, symbols, ca.DM.zeros(symbols.numel()))))

        turns = at_zero(ca.jacobian(angle, symbols)).ravel()
        tilts = at_zero(ca.jacobian(pose.rotation[0, 2], level)).ravel()
        leaning = [name for name, tilt in zip(passive, tilts, strict=True) if abs(tilt) > NEAR]
        upright = Pose(*ca.substitute(list(pose), [level], [ca.SX.zeros(level.numel())]))
        angle = ca.atan2(-upright.rotation[0, 1], upright.rotation[1, 1])
        effects = {
            name: ca.jacobian(angle, symbol)
            for (name, symbol), turn in zip(states.items(), turns[: len(states)], strict=True)
            if abs(turn) > NEAR
        }
        leans = leaning[0] if leaning and wheel.driven else None
        yield upright, effects, leans, bool((np.abs(turns[len(states) :]) > NEAR).any())
