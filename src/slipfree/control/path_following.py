"""Path following: feedback laws and timed inputs in the symbols of a model, and arcs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import pi, tan
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.rearrange import substitute, with_outputs
from slipfree.core.records import Array, Label, Record, leaves, unpack
from slipfree.core.schema import Finite, Positive
from slipfree.core.trajectory import Trajectory
from slipfree.geometry.path import Path, spline_function
from slipfree.models.given_rates import COMMANDS, PLANAR, turning_effects
from slipfree.vehicle.tree import Vehicle, Wheel

MAX_STEER_ANGLE = 0.5  # largest steering angle of the law [rad]
STEER_GAIN = 4.0  # decay of the steering error per base length driven
ZERO_TOLERANCE = 1e-9  # smaller lengths and derivatives count as zero [m, 1]
LOW_SPEED_RATIO = 0.1  # fraction of the speed below which the steering angle is blended to zero
TILT_GAIN = 2.0  # decay of the mean tilt per base length driven
STEERING_STEPS = 20  # number of steps of the fixed-point iteration for the steering
SAME_ANGLE = 1e-9  # smaller changes of commanded coordinates are omitted [rad, m]
Piecewise = tuple[tuple[float, float], ...]


class _PlanarWheel(NamedTuple):
    """A wheel in the plan view of the vehicle, as expressions of the commanded coordinates.

    Position relative to the middle of the turning axis [m]; heading in the platform's plan, left
    positive [rad], and its derivatives with respect to commanded coordinates by name; ``leans`` is
    the passive coordinate that tilts a driven wheel sideways, None without one.
    """

    wheel: Wheel
    right: ca.SX
    forward: ca.SX
    angle: ca.SX
    effects: dict[str, ca.SX]
    leans: str | None


class _PlanarGeometry(NamedTuple):
    """Plan view of a vehicle.

    ``steered`` are the wheels whose steering turns the vehicle. ``base`` is the distance of the
    farthest of them from the turning axis, or, without steering, the largest distance of a wheel
    from the centre line [m]; ``ahead`` that of the platform's centre ahead of the turning axis [m].
    ``gain`` is the difference of the wheel speeds relative to that of a vehicle that turns without
    slip; above one if unsteered wheels must slip sideways.
    """

    wheels: tuple[_PlanarWheel, ...]
    steered: tuple[_PlanarWheel, ...]
    base: float
    ahead: float
    gain: float


@checked
def straight(model: Dae, start: Trajectory, *, speed: Finite) -> Record:
    """Return inputs that drive a vehicle straight along its heading at the start.

    The law, its parameters and its errors are those of `follow`. The path is the line ahead of the
    last sample of ``start``, or behind it if the speed is negative.
    """
    x, y, heading = (start.in_frame("paper")[name][-1] for name in ("x", "y", "heading"))
    sign = -1.0 if speed < 0 else 1.0
    ahead = (x - sign * np.sin(heading), y + sign * np.cos(heading))
    return follow(model, Path(np.array([(x, y), ahead])), speed=speed)


@checked
def follow(model: Dae, path: Path, *, speed: Finite) -> Record:
    """Return inputs that keep the platform's centre on a path.

    A reference point moves along the path at the given speed, from its beginning at t = 0, and
    straight on beyond its end. The heading, cross-track and along-track errors decay over a
    distance of the size of the vehicle; farther from the path, the vehicle turns to it as sharply
    as its steering allows, and catches up at no more than twice the speed.
    The wheel rates are those of planar motion with the current steering angles. On uneven ground
    these rates do not fit each other exactly, and passive tilt joints take up the difference; a
    correction lets the mean tilt decay. Without it, the tilt would drift until the wheels lie flat.

    Parameters
    ----------
    model : Dae
        Direct kinematics of a vehicle with steered wheels, or with driven wheels on both sides.
    path : Path
        Path of the platform's centre.
    speed : float
        Speed over the map; negative drives backwards along the path. [m/s]

    Returns
    -------
    record
        Inputs as expressions of the symbols of ``model``. Commanded coordinates that steer no wheel
        stay constant.

    Raises
    ------
    ModelError
        If the speed is zero or not finite, if the input of a driven wheel or a commanded coordinate
        is not its rate, or if the vehicle has neither steered wheels nor driven wheels on both
        sides.

    Examples
    --------
    >>> import numpy as np
    >>> from slipfree import Analytic, Path, catalog, direct_kinematics, follow, settle, simulate
    >>> vehicle, ground = catalog.three_wheeler(), Analytic(lambda x, y: 0.02 * x * y)
    >>> model = direct_kinematics(vehicle, ground)
    >>> path = Path(np.array([[0.0, 0.0], [0.2, 2.0], [0.0, 4.0]]))
    >>> law = follow(model, path, speed=0.4)
    >>> run = simulate(model, settle(model), law, np.linspace(0, 10, 51))
    >>> print(f"ends at ({run['x'][-1]:.2f}, {run['y'][-1]:.2f})")
    ends at (-0.01, 3.98)
    """
    if speed == 0:
        raise ModelError(
            f"speed: expected a finite speed other than zero, found {speed} m/s; give a positive "
            "speed, or a negative one to drive backwards"
        )
    states, plan = _joints_and_geometry(model, "follow")
    sign, base, origin = np.sign(speed), plan.base, (model.shift[0][0], model.shift[0][1])
    reference = path.symbolic(abs(speed) * model.t, origin, fade=base)
    curvature = sign * reference.curvature
    direction = reference.heading + (0 if sign > 0 else np.pi)
    forward = (-ca.sin(direction), ca.cos(direction))
    d_x, d_y = model.x.x - reference.x, model.x.y - reference.y
    along, left = d_x * forward[0] + d_y * forward[1], d_y * forward[0] - d_x * forward[1]
    # the centre lies ahead of the turning axis: its velocity points to the left of the heading
    turned = model.named("heading")[0] - direction + ca.atan(plan.ahead * curvature)
    # far from the path the errors saturate, so that the law neither rushes nor leaves the path
    behind, aside = (ca.fmax(ca.fmin(each / base, 1), -1) for each in (along, left))
    v = speed * ca.fmax(ca.cos(turned), 0) - abs(speed) * behind
    # with left' = v sin(turned) and turned' = turning - v curvature, errors are critically damped
    # near the path; the sine is smooth where the angle wraps around
    turning = speed * curvature - (2 * abs(speed) * ca.sin(turned) + speed * aside) / base
    return _planar_inputs(model, states, plan, (v, turning, speed))


@checked
def commanded(model: Dae, *, speed: Positive) -> Dae:
    """Return a model whose inputs are the commands of a robot: forward velocity and yaw rate.

    The wheel rates are those of planar motion with the current steering angles, and the steering
    angles approach those of the command over a fraction of the size of the vehicle, as in
    `follow`: the law of a robot that drives without a map. On uneven ground the vehicle slips, and
    its motion differs from the command. Steering angles are limited smoothly to half a radian, so
    that a car turns by some percent less than commanded.

    Parameters
    ----------
    model : Dae
        Direct kinematics, quasi-statics or dynamics of a vehicle with steered wheels, or with
        driven wheels on both sides.
    speed : float
        Typical speed, which decides how fast wheels are steered. [m/s]

    Returns
    -------
    Dae
        The model with the inputs ``forward`` [m/s] and ``yaw_rate``, counter-clockwise. [rad/s]

    Raises
    ------
    ModelError
        If the speed is not positive and finite, or for vehicles that `follow` refuses.

    Examples
    --------
    >>> import numpy as np
    >>> from slipfree import Analytic, catalog, commanded, direct_kinematics, settle, simulate
    >>> vehicle, ground = catalog.skid_steer(), Analytic(lambda x, y: 0.02 * x * y)
    >>> model = commanded(direct_kinematics(vehicle, ground), speed=0.4)
    >>> inputs = model.inputs(forward=0.4, yaw_rate=0.1)
    >>> run = simulate(model, settle(model), inputs, np.linspace(0, 5, 26))
    >>> print(f"turns by {run['heading'][-1]:.2f} rad")
    turns by 0.50 rad
    """
    states, plan = _joints_and_geometry(model, "commanded")
    forward, yaw_rate = ca.SX.sym("forward"), ca.SX.sym("yaw_rate")
    inputs = _planar_inputs(model, states, plan, (forward, yaw_rate, speed))
    driven = substitute(model, list(leaves(model.u)), list(leaves(inputs)))
    labels = driven.labels._replace(u=(COMMANDS["forward"], COMMANDS["yaw_rate"]))
    return replace(driven, u=(forward, yaw_rate), labels=labels)


def driven_vehicle(model: Dae) -> Vehicle:
    """Return the vehicle of a model, with numbers in place of parameters.

    ModelError is raised for a model without a vehicle.
    """
    if not isinstance(model.vehicle, Vehicle):
        raise ModelError(
            "model: expected the model of a vehicle, found equations without a vehicle; give "
            "inputs instead"
        )
    return model.vehicle.numeric


def _joints_and_geometry(model: Dae, name: str) -> tuple[dict[str, ca.SX], _PlanarGeometry]:
    """Return the joints' symbols and the plan view of a vehicle; its inputs must be rates."""
    wrong = [label.full for label in leaves(model.labels.u) if not label.unit.endswith("s-1")]
    if wrong:
        raise ModelError(
            f"{name}: expected the rates of all driven wheels and commanded coordinates as inputs, "
            f"found {', '.join(wrong)}; use drives of the kind 'rate' or 'motor'"
        )
    vehicle = driven_vehicle(model)
    states = dict(zip((label.name for label in model.labels.x.joints), model.x.joints, strict=True))
    plan = planar_geometry(vehicle, {c.name: states[c.name] for c in vehicle.of("commanded")})
    return states, plan


def _planar_inputs(
    model: Dae, states: dict[str, ca.SX], plan: _PlanarGeometry, motion: tuple[ca.SX, ca.SX, float]
) -> Record:
    """Return the inputs of the planar law: wheel rates and steering rates of a desired motion."""
    v, required, speed = motion
    pace, turning = abs(speed) / plan.base, required
    rates = dict.fromkeys((c.name for c in driven_vehicle(model).of("commanded")), ca.SX(0))
    if plan.steered:
        slopes = [ca.tan(each.angle) for each in plan.steered]
        pairs = zip(plan.steered, slopes, strict=True)
        # the rate on a plane with the current steering angles
        turning = sum((v * s / (each.forward - each.right * s) for each, s in pairs), ca.SX(0))
        turning /= len(slopes)

        def target(each: _PlanarWheel) -> ca.SX:
            # the centre of the turn lies beside the wheels, not between them
            ahead = v + ca.fmax(ca.fmin(each.right * required, ca.fabs(v) / 2), -ca.fabs(v) / 2)
            # sideways over forward velocity, regularised where the latter changes its sign
            slope = each.forward * required * ahead / (ahead**2 + (LOW_SPEED_RATIO * speed) ** 2)
            return MAX_STEER_ANGLE * ca.tanh(ca.atan(slope) / MAX_STEER_ANGLE)

        errors = _steering_errors(plan, target)
        rates |= {name: STEER_GAIN * pace * error for name, error in errors.items()}
    tilts = [states[each.leans] for each in plan.wheels if each.leans]
    if tilts:
        radius = float(np.mean([each.wheel.radius for each in plan.wheels if each.leans]))
        turning -= TILT_GAIN * pace * radius / plan.base * sum(tilts) / len(tilts)
    moving = {states[name]: rate for name, rate in rates.items()}
    wheels = [
        wheel_rate(each, v, plan.gain * turning, moving)
        for each in plan.wheels
        if each.wheel.driven
    ]
    return unpack(model.u, [*wheels, *rates.values()])


def _steering_errors(
    plan: _PlanarGeometry, target: Callable[[_PlanarWheel], ca.SX]
) -> dict[str, ca.SX]:
    """Return least-squares changes of the coordinates that steer wheels to target angles [rad]."""
    errors, sizes = dict[str, ca.SX](), dict[str, ca.SX]()
    for each in plan.steered:
        error = target(each) - each.angle
        for name, effect in each.effects.items():
            errors[name] = errors.get(name, 0) + effect * error
            sizes[name] = sizes.get(name, 0) + effect**2
    return {name: error / sizes[name] for name, error in errors.items()}


def wheel_rate(each: _PlanarWheel, v: ca.SX, turning: ca.SX, moving: dict[ca.SX, ca.SX]) -> ca.SX:
    """Return the rate of a driven wheel in a plane motion [rad/s]."""
    position = ca.vertcat(each.right, each.forward)
    shift = ca.SX.zeros(2)
    for coordinate, rate in moving.items():
        shift += ca.jacobian(position, coordinate) * rate
    v_forward, v_left = v + each.right * turning + shift[1], each.forward * turning - shift[0]
    along = ca.cos(each.angle) * v_forward + ca.sin(each.angle) * v_left
    if each.wheel.rollers:  # no velocity along the axle of the roller on the ground
        left = ca.cos(each.angle) * v_left - ca.sin(each.angle) * v_forward
        along -= tan(pi / 2 - each.wheel.rollers) * left  # zero for omni wheels
    return along / each.wheel.radius


def planar_geometry(vehicle: Vehicle, states: dict[str, ca.SX]) -> _PlanarGeometry:
    """Return the plan view of a vehicle in its zero configuration.

    The vehicle turns about an axis through the wheels that are neither steered nor casters nor have
    rollers; without such wheels, about an axis through its centre. ``states`` are the symbols of
    its commanded coordinates by name. ModelError is raised if the vehicle has neither steered
    wheels nor driven wheels on both sides.
    """
    passive, planar, fixed = {c.name: ca.SX.sym(c.name) for c in vehicle.of("passive")}, [], []
    effects = turning_effects(vehicle, states, "commanded")
    swivels = {k for each in turning_effects(vehicle, passive, "passive").values() for k in each}
    column = ca.vertcat(ca.SX(0, 1), *passive.values())
    axles = ca.vertcat(*(pose.rotation[2, 0] for pose in vehicle.carriers(values=passive)))
    slopes = ca.substitute(ca.jacobian(axles, column), column, ca.DM.zeros(len(passive)))
    tilts = np.abs(np.array(ca.evalf(slopes))) > ZERO_TOLERANCE  # sideways, of every wheel
    poses = vehicle.carriers(values=states)
    for k, (wheel, pose) in enumerate(zip(vehicle.wheels, poses, strict=True)):
        angle = ca.atan2(pose.rotation[1, 0], pose.rotation[0, 0])
        own = {name: of_wheels[k] for name, of_wheels in effects.items() if k in of_wheels}
        leaning = [name for name, is_tilted in zip(passive, tilts[k], strict=True) if is_tilted]
        leans = leaning[0] if leaning and wheel.driven else None
        each = _PlanarWheel(wheel, pose.origin[0], pose.origin[1], angle, own, leans)
        planar.append(each)
        if not (own or k in swivels or wheel.rollers):
            fixed.append(each)
    zeros = ca.vertcat(ca.SX(0, 1), *states.values()), ca.DM.zeros(len(states))

    def now(value: ca.SX) -> float:
        return float(ca.evalf(ca.substitute(value, *zeros)))

    axis = float(np.mean([now(each.forward) for each in fixed])) if fixed else 0.0
    planar = [each._replace(forward=each.forward - axis) for each in planar]
    steered = tuple(f for f in planar if f.effects and abs(now(f.forward)) > ZERO_TOLERANCE)
    sides = {np.sign(now(f.right)) for f in planar if f.wheel.driven and not f.effects}
    if not steered and not {-1.0, 1.0} <= sides:
        raise ModelError(
            "driver: expected a vehicle with steered wheels, or with driven wheels on both sides, "
            f"found neither in {vehicle.name!r}; give inputs instead"
        )
    lengths = [abs(now(f.forward)) for f in steered] or [abs(now(f.right)) for f in planar]
    gain = 1.0
    if not steered and fixed:
        fixed = [each._replace(forward=each.forward - axis) for each in fixed]
        rights = sum(now(f.right) ** 2 for f in fixed)
        gain = (rights + sum(now(f.forward) ** 2 for f in fixed)) / rights
    return _PlanarGeometry(tuple(planar), steered, float(max(lengths)), -axis, gain)


def turning_axis_offset(vehicle: Vehicle) -> float:
    """Return the distance of the platform's centre ahead of the vehicle's turning axis [m]."""
    return planar_geometry(vehicle, _symbols(vehicle)).ahead


def turning_radius(vehicle: Vehicle) -> float:
    """Return the radius of the sharpest turns of `follow` with steered wheels [m].

    Without steered wheels it is the largest distance of a wheel from the centre line.
    """
    plan = planar_geometry(vehicle, _symbols(vehicle))
    return plan.base / tan(MAX_STEER_ANGLE) if plan.steered else plan.base


def arc_inputs(
    model: Dae,
    arcs: Sequence[tuple[float, float]],
    coordinates: Mapping[str, float],
    *,
    speed: float,
) -> tuple[dict[str, Piecewise], float]:
    """Return inputs that drive along consecutive arcs, and the duration [s].

    The vehicle, with steered wheels or with driven wheels on both sides, stops before every arc
    until its wheels are steered for it. On even ground the middle of the turning axis then follows
    the arc without slip. An arc is a length, negative to drive backwards [m], and a curvature,
    positive to the left [1/m]; ``coordinates`` are the commanded ones at the beginning [rad, m].
    The result for each input is pairs of a time [s] and the rate from this time on [rad/s, m/s].
    """
    vehicle = driven_vehicle(model)
    states = _symbols(vehicle)
    plan, column = planar_geometry(vehicle, states), ca.vertcat(ca.SX(0, 1), *states.values())
    bend, v = ca.SX.sym("bend"), ca.SX.sym("v")
    turned = _steering_errors(
        plan, lambda each: ca.atan2(each.forward * bend, 1 + each.right * bend)
    )
    change = [turned.get(name, ca.SX(0)) for name in states]
    wheels = [
        wheel_rate(each, v, plan.gain * v * bend, {}) for each in plan.wheels if each.wheel.driven
    ]
    step = ca.Function("step", [column, bend], [ca.vertcat(ca.SX(0, 1), *change)])
    rates = ca.Function("rates", [column, bend, v], [ca.vertcat(*wheels)])
    now = np.array([coordinates[name] for name in states])
    times, rows = [0.0], list[Array]()
    for length, curvature in arcs:
        steered = now
        for _ in range(STEERING_STEPS):
            steered = steered + np.array(step(steered, curvature)).ravel()
        turn = np.abs(steered - now).max(initial=0.0)
        if turn > SAME_ANGLE:
            pause = turn * plan.base / speed
            times.append(times[-1] + pause)
            rows.append(np.concatenate([np.zeros(len(wheels)), (steered - now) / pause]))
        turning = np.array(rates(steered, curvature, np.copysign(speed, length))).ravel()
        times.append(times[-1] + abs(length) / speed)
        rows.append(np.concatenate([turning, np.zeros(now.size)]))
        now = steered
    values = np.array(rows).T.tolist()
    pieces = {
        name: tuple(zip(times[:-1], row, strict=True))
        for name, row in zip(model.input_names, values, strict=True)
    }
    return pieces, times[-1]


def _symbols(vehicle: Vehicle) -> dict[str, ca.SX]:
    return {c.name: ca.SX.sym(c.name) for c in vehicle.of("commanded")}


GAIN = 1.0  # decay rate of the errors of position and heading [1/s]
DEGREE = 5  # degree of the splines through the way-points
MAX_START_DISTANCE = 1e-6  # largest distance of the path from the start [vehicle sizes, rad]


def path_inputs(
    model: Dae, start: Trajectory, t: Array, x: Array, y: Array, heading: Array
) -> Record:
    """Return the inputs of an inverse model along a timed path.

    The model has the given rates velocity_x, velocity_y and heading_rate. A spline of degree five
    interpolates position and heading of the platform's centre at the times ``t``, at least six
    [m, rad]; beyond them the rates stay constant. The path begins at the last sample of ``start``.

    ModelError is raised if the model has other inputs; if there are fewer than six times, if their
    number is not that of the values, if a value is not finite, or if the times do not increase; or
    if the path does not begin at the start.
    """
    names = tuple(model.input_names)
    if set(names) != set(PLANAR):
        raise ModelError(
            f"path: expected an inverse model with the inputs {', '.join(PLANAR)}, found "
            f"{', '.join(names)}; build it with inverse_kinematics(..., given={PLANAR})"
        )
    t, points = check_way_points(t, x, y, heading)
    first, velocity = points[:, 0], _splines(t, points.T, model.t)[1]
    there = np.array([start.in_frame("paper")[name][-1] for name in ("x", "y", "heading")])
    gaps = (first - there) / [model.size, model.size, 1.0]
    gaps[2] = (gaps[2] + np.pi) % (2 * np.pi) - np.pi
    wrong = [
        f"{name} = {value:.6g} instead of {at:.6g}"
        for name, value, at, gap in zip(("x", "y", "heading"), first, there, gaps, strict=True)
        if not abs(gap) < MAX_START_DISTANCE
    ]
    if wrong:
        raise ModelError(
            "path: expected a path that begins at the position and heading of the start, found "
            f"{', '.join(wrong)}; move the path or the start"
        )
    return model.inputs(**dict(zip(PLANAR, ca.vertsplit(velocity), strict=True)))


def track_path(model: Dae, t: Array, x: Array, y: Array, heading: Array) -> tuple[Dae, Record]:
    """Return a model with tracking errors as outputs, and the commands that track a path.

    Commands are the velocity of the path in the platform's heading frame plus `GAIN` times the
    errors of position and heading, so that transients of the steering do not accumulate.

    Parameters
    ----------
    model : Dae
        Inverse model with the given rates ``forward``, ``right`` and ``yaw_rate``.
    t : ndarray, shape (n,)
        Times of the way-points, at least six, increasing. [s]
    x, y, heading : ndarray, shape (n,)
        Position and heading of the platform's centre in map coordinates, heading from the y axis.
        A spline of degree five interpolates them. [m, rad]

    Returns
    -------
    Dae
        The model with the outputs ``path_error``, the distance from the current point of the path
        [m], and ``heading_error`` [rad].
    record
        Inputs of the model.

    Raises
    ------
    ModelError
        If there are fewer than six way-points, if the numbers of times and values differ, if a
        value is not finite, or if the times do not increase.
    """
    t, points = check_way_points(t, x, y, heading)
    place, velocity = _splines(t, points.T, model.t)
    east, north = (
        place[k] - model.shift[0][k] - each for k, each in enumerate((model.x.x, model.x.y))
    )
    turn = place[2] - model.x.heading
    turn = ca.atan2(ca.sin(turn), ca.cos(turn))
    v_x, v_y = velocity[0] + GAIN * east, velocity[1] + GAIN * north
    c, s = ca.cos(model.x.heading), ca.sin(model.x.heading)
    inputs = model.inputs(
        forward=c * v_y - s * v_x, right=c * v_x + s * v_y, yaw_rate=velocity[2] + GAIN * turn
    )
    apart = Label("path_error", "m", "distance of the platform's centre from its path")
    turned = Label("heading_error", "rad", "heading of the path minus that of the platform")
    return with_outputs(model, [(apart, ca.hypot(east, north)), (turned, turn)]), inputs


def check_way_points(t: Array, x: Array, y: Array, heading: Array) -> tuple[Array, Array]:
    """Return times and values of way-points, shapes (n,) and (3, n).

    ModelError is raised unless these are six or more finite way-points with increasing times.
    """
    t = np.asarray(t, dtype=float)
    values = [np.asarray(each, dtype=float) for each in (x, y, heading)]
    if t.size <= DEGREE:
        raise ModelError(
            f"path: expected at least {DEGREE + 1} way-points, found {t.size}; add way-points"
        )
    if any(each.shape != (t.size,) for each in values):
        raise ModelError(
            f"path: expected {t.size} values each of x, y and heading, one per time, found the "
            f"shapes {', '.join(str(v.shape) for v in values)}; give one value of each for every "
            "time"
        )
    if not (np.isfinite(values).all() and np.isfinite(t).all()):
        raise ModelError(
            "path: expected finite times and values, found NaN or infinity; remove such way-points"
        )
    if not (np.diff(t) > 0).all():
        k = int((np.diff(t) <= 0).argmax())
        raise ModelError(
            f"path: expected increasing times, found {t[k]:.6g} s followed by {t[k + 1]:.6g} s; "
            "sort the way-points by time, and remove repeated times"
        )
    return t, np.array(values)


def _splines(t: Array, values: Array, time: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return interpolating splines of columns of values, and their time derivatives."""
    inside = ca.fmin(ca.fmax(time, t[0]), t[-1])
    rate = spline_function("path_velocity", t, values, DEGREE, order=1)
    return spline_function("path", t, values, DEGREE)(inside), rate(inside)
