"""Inverse kinematics: which wheel and steering rates give three rates of the platform.

Of a vehicle that rolls without slip and has three inputs, any three of the platform's rates may be
given [1]_. As there, the rate of the steering is unknown, and that is delicate: it acts on the
ground only through the lever of the contact about the steering axis. Where the contact lies on the
axis, as on flat ground, nothing determines it; where the contact trails, the steering follows the
platform; where it leads, the steering runs away from it. The steering angle, in contrast, is well
determined as long as the vehicle moves.

References
----------
.. [1] N. Chakraborty and A. Ghosal, "Kinematics of wheeled mobile robots on uneven terrain",
       section 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import casadi as ca
import numpy as np

from slipfree.dae import Dae, Limit
from slipfree.errors import ModelError
from slipfree.laws.rolling import Rolling
from slipfree.models.determinacy import angle_slopes, rolling_determinacy
from slipfree.models.given_rates import EULER, OMEGA, VELOCITY, derived_rates, impose
from slipfree.models.kinematics import direct_kinematics
from slipfree.rearrange import blocks, rearrange, substitute, variables, with_outputs
from slipfree.records import Array, Label, leaves, pack
from slipfree.terrain.base import Terrain
from slipfree.trajectory import Column, Trajectory
from slipfree.vehicle.tree import Vehicle

SolveFor = Literal["rates", "angles"]
PLANAR = ("velocity_x", "velocity_y", "heading_rate")
LEAST_MARGIN = 1e-3  # smallest singular value at which the given rates still count as determining
ELSEWHERE = 1e-6  # distance of path and start that counts [size, rad]
STANDING = 1e-6  # speed below which a steering angle has no effect [size/s]


def inverse_kinematics(
    vehicle: Vehicle,
    terrain: Terrain,
    *,
    given: Sequence[str] = PLANAR,
    solve_for: SolveFor = "rates",
    least_margin: float = LEAST_MARGIN,
) -> Dae:
    """Return the motion of a vehicle that rolls without slip under given rates of its platform.

    Parameters
    ----------
    vehicle : Vehicle
        Rolls without slip, and has three inputs: driven wheels and commanded coordinates.
    terrain : Terrain
        The ground; contacts keep to its domain.
    given : sequence of three str
        Of ``velocity_x``, ``velocity_y``, ``velocity_z`` and of either ``omega_x``, ``omega_y``,
        ``omega_z`` or ``heading_rate``, ``roll_rate``, ``pitch_rate``.
    solve_for : {"rates", "angles"}
        Unknowns of the steering. With the rates, the vehicle rolls exactly, but the model is
        singular on flat ground and the steering may run away: see ``steering_growth`` and
        `steering_note`. With the angles, the contact of a steered wheel slips by its lever times
        the rate of the steering: see `steering_slip`. A start then comes from the direct model,
        since a vehicle at rest may be steered anyhow.
    least_margin : float
        Smallest singular value down to which the rates count as determined; zero to go through
        crossings, as collocation can.

    Returns
    -------
    Dae
        Inputs are the three given rates. It starts from any sample of the direct model.

    Raises
    ------
    ModelError
        If the three are not three different known rates, or the vehicle does not suit.
    """
    _check_given(given)
    _check_vehicle(vehicle, solve_for)
    if not least_margin >= 0:
        raise ModelError(f"least_margin: expected zero or more, found {least_margin}")
    direct = direct_kinematics(vehicle, terrain, slip=Rolling())
    build = _solved_for_angles if solve_for == "angles" else _solved_for_rates
    dae = build(vehicle, direct, given)
    rest = [each for name, each in derived_rates(direct).items() if name not in given]
    check = rolling_determinacy(vehicle, direct, dae, given, solve_for, least_margin)
    return with_outputs(replace(dae, checks=(*dae.checks, check)), rest)


def _check_given(given: Sequence[str]) -> None:
    known = (*VELOCITY, *OMEGA, *EULER)
    if isinstance(given, str) or len(given) != 3 or len(set(given)) != 3:
        raise ModelError(f"given: expected three different rates, found {given!r}")
    for name in given:
        if name not in known:
            raise ModelError(f"given: {name!r} is not known; known: {', '.join(known)}")
    if set(given) & set(OMEGA) and set(given) & set(EULER):
        raise ModelError(
            f"given: expected components of the angular velocity ({', '.join(OMEGA)}) or Euler "
            f"rates ({', '.join(EULER)}), not both, found {', '.join(given)}"
        )


def _check_vehicle(vehicle: Vehicle, solve_for: str) -> None:
    if solve_for not in ("rates", "angles"):
        raise ModelError(f"solve_for: expected 'rates' or 'angles', found {solve_for!r}")
    free = [wheel.name for wheel in vehicle.wheels if not wheel.driven]
    have, need = len(vehicle.of("passive")) + len(free), 2 * len(vehicle.wheels) - 3
    if have != need:
        raise ModelError(
            f"{vehicle.name} cannot roll without slip, as inverse kinematics needs: {need} "
            f"conditions ask for as many passive joints and free wheels, found {have}"
        )
    commanded = [c.name for c in vehicle.of("commanded")]
    inputs = [wheel.name for wheel in vehicle.wheels if wheel.driven] + commanded
    if len(inputs) != 3:
        raise ModelError(
            f"{vehicle.name}: three rates of the platform determine three inputs, found "
            f"{len(inputs)} ({', '.join(inputs)})"
        )
    if solve_for == "angles" and not commanded:
        raise ModelError(f"{vehicle.name} has no commanded coordinate whose angle could be unknown")


def _solved_for_rates(vehicle: Vehicle, direct: Dae, given: Sequence[str]) -> Dae:
    """Return the model whose unknowns are rates: the direct model with other inputs."""
    (x, z, u), imposed = variables(direct), impose(direct, given)
    rates = (*imposed.rates, *leaves(u))
    closure, _, forces = blocks(direct)
    equations = closure, (imposed.rows, imposed.labels), forces
    dae = rearrange(direct, x, (z.position, rates, z.forces), imposed.inputs, equations)
    slopes = angle_slopes(vehicle, direct, imposed.rows)
    if not slopes:
        return dae
    unknowns = pack(tuple(each.symbol for each in rates))
    change = -ca.solve(ca.jacobian(imposed.rows, unknowns), ca.horzcat(*slopes.values()))
    names = [each.label.full for each in rates]
    growth = [change[names.index(f"{name}_rate"), k] for k, name in enumerate(slopes)]
    words = "rate at which the steering runs away from the given motion, if positive"
    return with_outputs(
        dae, [(Label("steering_growth", "s-1", words), ca.mmax(ca.vertcat(*growth)))]
    )


def _solved_for_angles(vehicle: Vehicle, direct: Dae, given: Sequence[str]) -> Dae:
    """Return the model whose unknowns are steering angles, as if they were at rest."""
    joints = direct.u.joints
    still = substitute(direct, joints, [ca.SX(0)] * len(joints))
    (x, z, u), imposed = variables(still), impose(still, given)
    turned = {c.name for c in vehicle.of("commanded")}
    angles = tuple(each for each in x.joints if each.label.full in turned)
    x = x._replace(joints=tuple(each for each in x.joints if each.label.full not in turned))
    motion = z.position, angles, (*imposed.rates, *u.wheels)
    (closure, names), _, forces = blocks(still)
    equations = (ca.vertcat(closure, imposed.rows), (*names, *imposed.labels)), forces
    dae = rearrange(still, x, (motion, z.forces), imposed.inputs, equations)
    slow = Label("steering_speed", "m s-1", "the vehicle stands, so that it may be steered anyhow")
    speed = ca.sqrt(direct.z.rates.x**2 + direct.z.rates.y**2)
    limit = Limit(slow, speed, STANDING * direct.size, np.inf)
    words = "slip of steered contacts for each unit of the steering rate"
    lever = ca.sqrt(ca.sumsqr(ca.jacobian(direct.alg[1], pack(joints))))
    dae = replace(dae, limits=(*dae.limits, limit))
    return with_outputs(dae, [(Label("steering_lever", "m", words), lever)])


def along(
    dae: Dae,
    start: Trajectory,
    x: Any,
    y: Any,
    heading: Any,
    *,
    t: Array | None = None,
    begin: float = 0.0,
) -> tuple[Any, ...]:
    """Return the inputs of an inverse model that lead along a path in time.

    Parameters
    ----------
    dae : Dae
        The inverse model, with the given rates velocity_x, velocity_y and heading_rate.
    start : Trajectory
        Its last sample is where the path must start.
    x, y, heading : SX, or ndarray of shape (n,)
        Place and heading of the platform's centre as expressions of ``dae.t``, or their values at
        the times ``t``, through which a spline of degree five is laid. [m, rad]
    t : ndarray, shape (n,), optional
        Six or more ascending times of the values; beyond them the rates keep their last values. [s]
    begin : float
        Time at which the path starts, if it is not given by values. [s]

    Raises
    ------
    ModelError
        If the model has other inputs, the path depends on more than time or has too few or
        unsuitable values, or it starts elsewhere than the start.
    """
    names = tuple(label.full for label in leaves(dae.labels.u))
    if set(names) != set(PLANAR):
        raise ModelError(
            f"path: the model must be given {', '.join(PLANAR)}, found {', '.join(names)}"
        )
    if t is not None:
        begin = float(np.ravel(t)[0])
    rates, wrong = {}, []
    for name, rate, value in zip(("x", "y", "heading"), PLANAR, (x, y, heading), strict=True):
        first, rates[rate] = _path_rate(name, value, dae.t, t, begin)
        there = float(start[name][-1])
        gap = (first - there) / dae.size
        if name == "heading":
            gap = (first - there + np.pi) % (2 * np.pi) - np.pi
        if not abs(gap) < ELSEWHERE:
            wrong.append(f"{name} = {first:.6g}, the vehicle stands at {there:.6g}")
    if wrong:
        raise ModelError(f"path: it starts elsewhere than the start: {'; '.join(wrong)}")
    inputs: tuple[Any, ...] = dae.inputs(**rates)
    return inputs


def _path_rate(
    name: str, value: Any, time: ca.SX, t: Array | None, begin: float
) -> tuple[float, ca.SX]:
    """Return one coordinate of a path at its beginning, and its rate."""
    if isinstance(value, ca.SX):
        if not all(ca.is_equal(symbol, time) for symbol in ca.symvar(value)):
            raise ModelError(f"path: {name} may depend on the model's time alone, found {value}")
        return float(ca.Function("first", [time], [value])(begin)), ca.jacobian(value, time)
    from scipy.interpolate import make_interp_spline  # imported where it is used: it takes 0.2 s

    t = np.asarray([] if t is None else t, dtype=float)
    value = np.asarray(value, dtype=float)
    if t.ndim != 1 or t.size < 6 or value.shape != t.shape:
        raise ModelError(
            f"path: {name} needs six or more values, one for each of the times t, found shape "
            f"{value.shape} for {t.size} times"
        )
    if not (np.isfinite(value).all() and np.isfinite(t).all() and (np.diff(t) > 0).all()):
        raise ModelError(f"path: values of {name} must be finite and their times ascend")
    spline = make_interp_spline(t, value, k=5).derivative()
    at = ca.MX.sym("t")
    weights = spline.c[: spline.t.size - spline.k - 1].tolist()  # the rest is padding
    rate = ca.Function.bspline(name, [spline.t.tolist()], weights, [spline.k], 1)
    law = ca.Function(f"{name}_rate", [at], [rate(at)], {"never_inline": True})
    return float(value[0]), law(ca.fmin(ca.fmax(time, t[0]), t[-1]))


def steering_note(run: Trajectory) -> str:
    """Return the warning that the steering of an inverse motion is unstable; empty if it is not.

    Parameters
    ----------
    run : Trajectory
        From the inverse model with ``solve_for="rates"``, whole or what was reached.
    """
    growth = run["steering_growth"]
    bad = growth > 0
    if not bad.any():
        return ""
    first, worst = float(run.t[int(bad.argmax())]), int(np.nanargmax(growth))
    return (
        f"steering mode unstable from t = {first:.4g} s: errors of the steering grow at up to "
        f"{growth[worst]:.3g} 1/s (t = {run.t[worst]:.4g} s), since the steered contact leads the "
        "steering axis; take steering = 'angle', or a path"
    )


def steering_slip(run: Trajectory) -> Trajectory:
    """Return an inverse motion with the rate of its steering angle and the slip that costs.

    Parameters
    ----------
    run : Trajectory
        From the inverse model with ``solve_for="angles"``; the rate is the derivative of the cubic
        spline through the samples.

    Returns
    -------
    Trajectory
        With ``steer_rate`` and ``steering_slip``, lever times rate, in addition.
    """
    from scipy.interpolate import CubicSpline  # imported where it is used: it takes 0.2 s

    lever = run["steering_lever"]
    rate = np.zeros_like(lever)
    if run.t.size > 1:
        rate = CubicSpline(run.t, run["steer"])(run.t, 1)
    found = (
        (Label("steer_rate", "rad s-1", "rate of the steering angle"), rate),
        (Label("steering_slip", "m s-1", "slip of the steered contact"), lever * np.abs(rate)),
    )
    return replace(
        run, columns={**run.columns, **{label.name: Column(label, v) for label, v in found}}
    )
