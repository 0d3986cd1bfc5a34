"""Inverse kinematics: wheel rates and steering for given rates of the platform.

All inverse models are direct models with given rates of the platform as inputs; the inputs of the
direct model become unknowns.

**Vehicles that roll without slip** and have three inputs: any three rates of the platform may be
given [1]_. As in that paper, the rate of the steering may be the unknown, but this is delicate: the
steering acts on the ground only through the lever of the contact about the steering axis. Where the
contact lies on the axis, as on flat ground, the rate is not determined. Where the contact trails
the axis, the steering follows the platform; where it leads the axis, the steering is unstable. If
the steering angle is the unknown instead, it is well determined as long as the vehicle moves.

**All other vehicles** cannot roll without slip, or have more inputs than the platform has degrees
of freedom. They take commands: some of the platform's rates in its heading frame. Commands are met
exactly or, on request, with the least error where the steering angles do not allow them. The
steering follows a guiding motion (`slipfree.models.given_rates`).

Exact commands: the rates of the driven wheels are those of least slip among all rates with which
the direct model has the given motion. The equations of the direct model (least slip under its
inputs) are constraints. Therefore the direct model with these rates reproduces the commands
exactly, for any steering: the lag of the steering causes slip, not errors of the given rates. The
constraints are necessary: the wheel rates of least slip for a given motion do not in general
produce this motion in the direct model.

Nearest commands: the rates of the driven wheels minimise the squared slip along the wheels in the
guiding motion plus `ERROR_WEIGHT` times the squared errors of the given rates, subject to the same
equations. Both terms vanish where the wheels can roll along the guiding motion. Elsewhere the
weight is a compromise: the Open Source Rover, whose middle wheels do not steer, misses 0.3 m/s
forward and 0.1 m/s to the right by 0.031, 0.023 and 0.007 m/s for weights 10, 100 and 1000, and its
wheels slip by 0.05, 0.08 and 0.18 m/s.

References
----------
.. [1] N. Chakraborty and A. Ghosal, "Kinematics of wheeled mobile robots on uneven terrain",
       section 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.dae import Dae, Limit
from slipfree.core.quantities import quantity_label
from slipfree.core.rearrange import blocks, rearrange, substitute, variables, with_outputs
from slipfree.core.records import Label, leaves, pack
from slipfree.core.schema import NonNegative
from slipfree.core.trajectory import Column, Trajectory
from slipfree.laws.least_slip import slip_unit
from slipfree.models import given_rates
from slipfree.models.kinematics import direct_kinematics
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

MIN_STEERABLE_SPEED = 1e-6  # speed below which a steering angle has no effect [size/s]
ERROR_WEIGHT = 10.0  # weight of the errors of given rates relative to slip along the wheels [1]


@checked
def inverse_kinematics(
    vehicle: Vehicle,
    ground: Terrain,
    *,
    given: Sequence[str],
    solve_for: given_rates.SolveFor = "angles",
    exact: bool = True,
    least_margin: NonNegative = given_rates.LEAST_MARGIN,
) -> Dae:
    """Return the model of a vehicle's motion under given rates of its platform.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    ground : Terrain
        The ground. A motion ends where a contact leaves its domain.
    given : sequence of str
        Either commands, for any vehicle: some of ``forward``, ``right`` and ``yaw_rate``, the
        velocity of the platform's centre along its heading and across it, and the rate of the
        heading. All three together usually cause slip if a wheel is not steered. Or three rates,
        for vehicles that roll without slip and have three inputs (driven wheels and commanded
        coordinates): some of ``velocity_x``, ``velocity_y``, ``velocity_z`` and of either
        ``omega_x``, ``omega_y``, ``omega_z`` or ``heading_rate``, ``roll_rate``, ``pitch_rate``.
    solve_for : {"angles", "rates"}
        Unknowns of the steering. Under commands these are angles: commanded coordinates that turn
        wheels about the platform's up axis are steered towards angles of little slip, within their
        stops and rates; other coordinates are fixed. Under three rates, ``"angles"`` neglects the
        slip that the steering rate causes at a steered wheel (`steering_slip`). The start must
        then come from the direct model, since the steering angles of a vehicle at rest are
        arbitrary. With ``"rates"`` the vehicle rolls exactly, but the model is singular on flat
        ground and the steering may be unstable: see the output ``steering_growth`` and
        `steering_note`.
    exact : bool
        Whether commands are met exactly. Otherwise their errors, given minus actual, are the
        outputs ``forward_error`` and so on; the wheel rates minimise them together with the slip
        along the wheels. Vehicles with neither steering nor rollers meet all commands exactly
        except ``right``.
    least_margin : float
        Smallest singular value at which three rates determine the unknowns; a motion ends below
        it. Zero allows motions through singular configurations, which collocation can compute.

    Returns
    -------
    Dae
        Its inputs are the given rates. A motion ends where the wheels can no longer impose exact
        commands, or where three rates do not determine the unknowns: see
        `slipfree.models.given_rates.Determinacy`. With ``solve_for="angles"`` and three rates it
        also ends where the vehicle stands still.

    Raises
    ------
    ModelError
        If no rate is given, or a rate is unknown or given twice; if commands and rates in map axes,
        or both kinds of angular rates, are mixed; if there are more exact commands than driven
        wheels, or ``right`` is missing though all driven wheels have rollers; if the number of
        rates in map axes is not three, or the vehicle cannot roll without slip or does not have
        three inputs for them; if ``solve_for`` does not suit the rates or the vehicle; or if
        ``least_margin`` is negative or NaN.

    Examples
    --------
    Compute the wheel rates of a differential drive in a turn:

    >>> import numpy as np
    >>> from slipfree import Analytic, catalog, inverse_kinematics, settle, simulate
    >>> ground = Analytic(lambda x, y: 0.02 * x * y)
    >>> vehicle = catalog.differential_drive()
    >>> model = inverse_kinematics(vehicle, ground, given=["forward", "yaw_rate"])
    >>> run = simulate(
    ...     model, settle(model), model.inputs(forward=0.2, yaw_rate=0.1), np.linspace(0, 2, 3)
    ... )
    >>> run["wheel_rate"][-1].round(3)
    array([1.498, 1.164, 2.025])
    """
    rates = given_rates.GivenRates(given, solve_for, exact, least_margin)
    rates.check(vehicle)
    return invert(direct_kinematics(vehicle, ground, slip=rates.slip), rates)


def invert(direct: Dae, given: given_rates.GivenRates) -> Dae:
    """Return the inverse of a direct model with the slip law of the given rates, in its symbols.

    The rates must be checked before (`GivenRates.check`).
    """
    if given.are_commands:
        return _commanded(direct, tuple(given.names), exact=given.exact)
    build = _solved_for_angles if given.solve_for == "angles" else _solved_for_rates
    dae, derived = build(direct, given.names), given_rates.derived_rates(direct)
    rest = [derived[name] for name in given_rates.OMEGA if name not in given.names]
    check = given_rates.rolling_determinacy(direct, dae, *given[:2], given.least_margin)
    return with_outputs(replace(dae, checks=(*dae.checks, check)), rest)


def _solved_for_rates(direct: Dae, given: Sequence[str]) -> Dae:
    """Return the inverse model for three given rates, with steering rates as unknowns."""
    (x, z, u), imposed = variables(direct), given_rates.impose(direct, given)
    rates = (*imposed.rates, *leaves(u))
    closure, _, forces = blocks(direct)
    equations = closure, (imposed.rows, imposed.labels), forces
    dae = rearrange(direct, x, (z.position, rates, z.forces), imposed.inputs, equations)
    slopes = given_rates.angle_slopes(direct, imposed.rows)
    if not slopes:
        return dae
    unknowns = pack(tuple(each.symbol for each in rates))
    # from an error of each angle to the change of all rates; where that of the angle's own rate is
    # positive, the error grows [1/s]
    change = -ca.solve(ca.jacobian(imposed.rows, unknowns), ca.horzcat(*slopes.values()))
    names = [each.label.full for each in rates]
    growth = [change[names.index(f"{name}_rate"), k] for k, name in enumerate(slopes)]
    return with_outputs(dae, [(quantity_label("steering_growth"), ca.mmax(ca.vertcat(*growth)))])


def _solved_for_angles(direct: Dae, given: Sequence[str]) -> Dae:
    """Return the inverse model for three given rates, with steering angles as unknowns.

    The model neglects the slip that the steering rates cause.
    """
    joints = direct.u.joints
    still = substitute(direct, joints, [ca.SX(0)] * len(joints))
    (x, z, u), imposed = variables(still), given_rates.impose(still, given)
    turned = {c.name for c in direct.vehicle.of("commanded")}
    angles = tuple(each for each in x.joints if each.label.full in turned)
    x = x._replace(joints=tuple(each for each in x.joints if each.label.full not in turned))
    motion = z.position, angles, (*imposed.rates, *u.wheels)
    (closure, names), _, forces = blocks(still)
    equations = (ca.vertcat(closure, imposed.rows), (*names, *imposed.labels)), forces
    dae = rearrange(still, x, (motion, z.forces), imposed.inputs, equations)
    speed = ca.sqrt(direct.z.rates.x**2 + direct.z.rates.y**2)
    limit = Limit(
        quantity_label("steering_speed"), speed, MIN_STEERABLE_SPEED * direct.size, np.inf
    )
    lever = ca.sqrt(ca.sumsqr(ca.jacobian(direct.alg[1], pack(joints))))
    dae = replace(dae, limits=(*dae.limits, limit))
    return with_outputs(dae, [(quantity_label("steering_lever"), lever)])


def _commanded(direct: Dae, given: tuple[str, ...], *, exact: bool) -> Dae:
    """Return the inverse model of any vehicle for commands of its platform."""
    vehicle = direct.vehicle
    (x, z, u), imposed = variables(direct), given_rates.impose(direct, given)
    inputs, plane = imposed.inputs, given_rates.derived_rates(direct)
    conditions, guide = given_rates.guiding_motion(direct, inputs)
    errors = given_rates.steering_errors(direct, guide)
    off = [each.symbol - plane[each.label.name].expression for each in inputs]
    met = given
    if not exact:
        # without steering and rollers, the wheels impose all commands except right, by slipping
        wheels = [wheel for wheel in vehicle.wheels if wheel.driven]
        met = tuple(name for name in given if name != "right")
        if errors or any(wheel.rollers for wheel in wheels) or len(met) > len(wheels):
            met = ()
    goal, rows = (
        ca.SX(0.5 * ca.sumsqr(ca.vertcat(*direct.y.slip_along, *direct.y.slip_across))),
        [direct.alg[1]],
    )
    rows += [-error for name, error in zip(given, off, strict=True) if name in met]
    if not met:
        # Half the squared slip of the guiding motion along driven wheels plus half the weighted
        # squared errors. Where wheels cannot be steered along this motion, they rotate faster than
        # in rolling; the slip is at most sqrt(ERROR_WEIGHT) / 2 times the error.
        along, driving = ca.vertcat(*direct.y.slip_along), ca.vertcat(*direct.u.wheels)
        turning = ca.jacobian(along, driving)
        driven = [k for k in range(along.numel()) if turning[k, :].nnz()]
        (moving,) = given_rates.guided(direct, guide, [along])
        slip = (moving + turning @ driving)[driven]
        sizes = given_rates.command_sizes(vehicle, given)
        misses = ca.vertcat(*(size * error for size, error in zip(sizes, off, strict=True)))
        goal = ca.SX(0.5 * (ca.sumsqr(slip) + ERROR_WEIGHT * ca.sumsqr(misses)))
    multipliers = [
        replace(rate.label, name=f"response_{rate.label.name}") for rate in imposed.rates
    ]
    multipliers += [
        Label(
            f"multiplier_{name}",
            slip_unit(given_rates.COMMANDS[name].unit),
            f"multiplier of the given rate '{name}'; large where the wheels cannot impose it "
            "together with the others: then remove it",
        )
        for name in met
    ]
    motion = given_rates.minimum(
        direct,
        goal,
        ca.vertcat(*rows),
        (*imposed.rates, *u.wheels),
        multipliers,
        Label("inverse", "", "least slip at the given rates"),
    )
    closure, _, forces = blocks(direct)
    parts = [(z.position, *closure), (motion.unknowns, *motion[1:]), (z.forces, *forces)]
    if errors or not met:
        parts.insert(1, (conditions.unknowns, *conditions[1:]))
    unknowns = tuple(part[0] for part in parts)
    dae = rearrange(direct, x, unknowns, inputs, [part[1:] for part in parts])
    joints = {each.name: each for each in direct.labels.x.joints}
    extra: list[tuple[Label, ca.SX]] = [
        plane[name] for name in given_rates.COMMANDS if name not in given
    ]
    extra += zip(direct.labels.u.joints, direct.u.joints, strict=True)
    for name, error in errors.items():
        words = f"target minus actual {joints[name].words}"
        extra.append((Label(f"{name}_error", joints[name].unit, words), error))
    for name, error in () if exact else zip(given, off, strict=True):
        words = f"error of the given {name}"
        extra.append(
            (replace(given_rates.COMMANDS[name], name=f"{name}_error", words=words), error)
        )
    dae = with_outputs(dae, extra)
    dae = substitute(dae, direct.u.joints, given_rates.steering_laws(vehicle, errors))
    if not met:  # rates jump where a wheel reverses, and the integrator's error test would fail
        return replace(dae, suppress_algebraic=True)
    check = given_rates.command_determinacy(direct, dae, met)
    return replace(dae, checks=(*dae.checks, check))


def steering_note(run: Trajectory) -> str:
    """Return a warning if the steering of an inverse motion is unstable, otherwise an empty text.

    The motion, complete or partial, is one of the inverse model with ``solve_for="rates"``.
    """
    growth = run["steering_growth"]
    bad = growth > 0
    if not bad.any():
        return ""
    first, worst = float(run.t[int(bad.argmax())]), int(np.nanargmax(growth))
    return (
        f"unstable steering from t = {first:.4g} s: errors of the steering angle grow at up to "
        f"{growth[worst]:.3g} 1/s (at t = {run.t[worst]:.4g} s), since the steered contact leads "
        "the steering axis; solve for the steering angle (steering = 'angle'), or give a path"
    )


def steering_slip(vehicle: Vehicle, run: Trajectory) -> Trajectory:
    """Return an inverse motion with the steering rates and the slip that they cause.

    The motion is one of the inverse model with ``solve_for="angles"``; the rates, such as
    ``steer_rate``, are derivatives of cubic splines through its samples. ``steering_slip`` is the
    lever times the root sum of squares of the rates [m/s].
    """
    from scipy.interpolate import CubicSpline  # imported here: the import takes 0.2 s

    columns, square = dict(run.columns), np.zeros(run.t.size)
    for c in vehicle.of("commanded"):
        angle, rate = run.columns[c.name], np.zeros(run.t.size)
        if run.t.size > 1:
            rate = CubicSpline(run.t, angle.values)(run.t, 1)
        label = Label(f"{c.name}_rate", f"{angle.label.unit} s-1", f"rate of {angle.label.words}")
        columns[label.name] = Column(label, rate)
        square += rate**2
    label = quantity_label("steering_slip")
    columns[label.name] = Column(label, run["steering_lever"] * np.sqrt(square))
    return replace(run, columns=columns)
