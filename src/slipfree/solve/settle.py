"""Starts of a motion: at given positions, exchanged for other quantities, or near a wish."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from typing import Annotated, Any

import casadi as ca
import numpy as np

from slipfree.batch import many
from slipfree.batch.evaluator import evaluator_of
from slipfree.core.arguments import BY_NAME, checked
from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError, check_known
from slipfree.core.lookups import evaluate
from slipfree.core.newton import solve_linear
from slipfree.core.records import Array, leaves
from slipfree.core.trajectory import SolverError, Trajectory
from slipfree.solve.sampling import guess_function
from slipfree.solve.simulate import consistent_start, simulate
from slipfree.solve.system import WEAK_SINGULAR_VALUE, SolverOptions, linearized, with_inputs
from slipfree.system.forks import computing

RELAXATION_TIME = 20.0  # duration of the relaxation to the equilibrium of a start [s]
RELAXATION_TOLERANCE = 1e-4  # integration tolerance of the relaxation
INCLINATIONS = (("roll", 0.2), ("roll", -0.2), ("pitch", 0.2), ("pitch", -0.2))  # [rad]
DIFFERENT_ANGLE = 1e-4  # smallest difference of roll or pitch of two stable poses [rad]
SPEED = "speed"  # name of the initial speed of a dynamic model
TIPPING = 0.03  # tip-over margin on the plane under the wheels of a vehicle that tips over [rad]
ALMOST_LEVEL = 1.0  # slope on which only a wrong centre of mass lets a vehicle tip over [deg]
CONTACT_TOLERANCE = 1e-15  # relative change of a position at which a contact point is found
MAX_CONTACT_MISS = 1e-9  # largest distance from a given contact point [size]
REST_RATE = 1e-5  # largest rate of the relaxing states at rest [size/s]


@checked
@computing
def settle(
    model: Dae,
    *,
    guess: Annotated[Mapping[str, float], BY_NAME] | None = None,
    options: SolverOptions = SolverOptions(),
    **start: Annotated[float, BY_NAME],
) -> Trajectory:
    """Return the vehicle at rest at a position, as a trajectory of one sample.

    Parameters
    ----------
    model : Dae
        The model.
    guess : mapping of str to float, optional
        Initial guesses of unknowns by name, such as ``{"z": 2.0}``; the model provides the others.
        With compliant contact, the pose from which the vehicle relaxes to rest. [m, rad]
    options : SolverOptions
        Options of the solvers.
    **start : float
        Differential states by name, such as ``x``, ``y``, ``heading``; others are zero. [m, rad]
        A dynamic model takes ``x``, ``y``, ``heading`` and joints, and the ``speed`` [m/s] of the
        platform along its forward axis, with wheels that roll at this speed.

    Returns
    -------
    Trajectory
        One sample at time zero, in map coordinates; a start for `simulate` and `plan`.

    Raises
    ------
    ModelError
        If a name is unknown, the vehicle cannot stand there, a limit is violated, or no equation
        determines one of the unknowns.

    Examples
    --------
    >>> from slipfree import Analytic, catalog, direct_kinematics, settle
    >>> model = direct_kinematics(catalog.three_wheeler(), Analytic(lambda x, y: 0.2 * y))
    >>> start = settle(model, x=1.0, y=2.0, heading=0.0)
    >>> print(f"z = {start['z'][0]:.3f} m, pitch = {start['pitch'][0]:.3f} rad")
    z = 0.706 m, pitch = 0.197 rad
    """
    if (standing := model.standing) is not None:
        speed, pose, still = start.pop(SPEED, 0.0), dict[str, float](), standing.model
        if standing.guess is not None:
            with suppress(ModelError):  # a wrong start is reported by the model at rest
                run = settle(standing.guess, guess=None, options=options, **start)
                wanted = {*still.state_names} - {*standing.guess.state_names}
                pose = {name: float(run[name][0]) for name in wanted}
        run = settle(still, guess=pose | dict(guess or {}), options=options, **start)
        symbols = [*still.columns()[:2], standing.speed]
        moving = still.function("states", symbols, [standing.x])
        x = np.array(moving(*(still.rows(record, run, -1) for record in "xz"), speed)).ravel()
        return _one_sample(model, x, first_guess(model, x, {}), options)
    x, guess = model.start(**start), dict(guess or {})
    if not model.rest.numel():
        return _one_sample(model, x, first_guess(model, x, guess), options)
    # At rest the vehicle relaxes to its equilibrium from the guessed pose; the model's initial pose
    # completes it. If that fails or the vehicle overturns, it does so from the model's initial
    # pose, and at last from a pose on the plane under the wheels, since from a level pose it
    # overturns on steep ground.
    states, relaxing = model.state_names, _relaxation_model(model)
    level = np.array(model.function("rest", [model.columns()[0]], [model.rest])(x)).ravel()
    rest = x.size - level.size
    given = [(start | guess).get(name, np.nan) for name in states[rest:]] - model.shift[0][rest:]
    others = {name: value for name, value in guess.items() if name not in states[rest:]}
    failure, margin, on_plane = ModelError(""), np.inf, _pose_on_plane(model, x)
    inclined = np.array([on_plane.get(name, 0.0) for name in states[rest:]])
    for first in (np.where(np.isnan(given), level, given), level, inclined):
        at = np.concatenate([x[:rest], first])
        try:
            begin = _one_sample(relaxing, at, first_guess(relaxing, at, others), options)
            if "tip_over_margin" in begin:  # of a vehicle with a mass
                margin = float(begin["tip_over_margin"][0])
            run = _relax(relaxing, begin, options)
            at[rest:] = relaxing.rows("x", run, -1)[rest:]
            return _one_sample(model, at, relaxing.rows("z", run, -1), options)
        except SolverError as error:
            failure = ModelError(
                f"no equilibrium of the vehicle was found at the start: {error}; choose another "
                "start"
            )
        except ModelError as error:
            failure = error
    if margin < TIPPING:
        slope = np.degrees(np.arccos(np.cos(on_plane["pitch"]) * np.cos(on_plane["roll"])))
        remedy = "choose a start on a gentler slope, or another heading"
        if slope < ALMOST_LEVEL:
            remedy = "correct the centre of mass, which is not above the area between the wheels"
        raise ModelError(
            f"the vehicle tips over at the start, where the ground under its wheels is inclined by "
            f"{slope:.3g} degrees; {remedy}"
        )
    # on ground that is rougher than its wheels, it is lowered from above, as in `settle_many`
    with suppress(ModelError):  # of a model without lanes, or of a pose beyond a limit
        lanes = evaluator_of(model, compiled=False)
        lane = many.start_states(lanes.graphs, {name: np.array([start[name]]) for name in start})
        if many.stand(lanes, lane).has_pose[0]:
            x, z, _ = map(np.ravel, many.columns_of(lanes.graphs, lane))
            return _one_sample(model, x, z, options)
    raise failure


@computing
def stable_poses(
    dae: Dae, *, options: SolverOptions = SolverOptions(), **start: float
) -> tuple[Trajectory, ...]:
    """Return the different poses in which a vehicle can stand at a position.

    A rigid vehicle with more than three wheels may stand on different sets of wheels. It relaxes
    from a level pose and from poses inclined in four directions; other stable poses may exist.

    Parameters
    ----------
    dae : Dae
        The model. A model with exact contact has one pose.
    options : SolverOptions
        Options of the solvers.
    **start : float
        Differential states by name, as for `settle`. [m, rad]

    Returns
    -------
    tuple of Trajectory
        Trajectories of one sample; the first is the result of `settle`. Two poses are
        different if an angle differs by more than `DIFFERENT_ANGLE`.

    Raises
    ------
    ModelError
        If `settle` fails for the level pose; for the reasons see `settle`.
    """
    values: dict[str, Any] = dict(start)
    poses = [settle(dae, options=options, **values)]
    standing = dae.standing
    relaxes = bool(dae.rest.numel()) if standing is None else standing.guess is None
    for name, angle in INCLINATIONS if relaxes else ():
        try:
            other = settle(dae, options=options, **(values | {name: angle}))
        except ModelError:  # it overturns from there
            continue
        apart = [max(abs(other[n][0] - run[n][0]) for n in ("roll", "pitch")) for run in poses]
        if min(apart) > DIFFERENT_ANGLE:
            poses.append(other)
    return tuple(poses)


def _pose_on_plane(dae: Dae, x: Array) -> dict[str, float]:
    """Return height [m], roll and pitch [rad] on the plane under the wheels, in local coordinates.

    The plane is fitted to the heights under the wheels of a level vehicle.
    """
    vehicle, (x_0, y_0, z_0) = dae.vehicle.numeric, dae.ground.origin
    right, forward, up = vehicle.centers.T
    at = np.exp(1j * x[2]) * (right + 1j * forward)
    heights = dae.ground.elevation(x[0] + x_0 + at.real, x[1] + y_0 + at.imag) - z_0
    plane = np.column_stack([right, forward, np.ones_like(up)])
    to_right, ahead, middle = np.linalg.lstsq(plane, heights)[0]
    above = np.mean([wheel.radius - wheel.depth for wheel in vehicle.wheels] - up)
    return {
        "z": middle + above * np.sqrt(1 + to_right**2 + ahead**2),
        "roll": -np.arctan2(to_right, np.hypot(1, ahead)),
        "pitch": np.arctan(ahead),
    }


@lru_cache(maxsize=8)
def _relaxation_model(dae: Dae) -> Dae:
    """Return a model in which only states that relax change, without limits and checks."""
    moving = dae.rest.numel()
    still = ca.SX.zeros(dae.ode.numel() - moving)
    ode = ca.vertcat(still, dae.ode[still.numel() :])
    return replace(dae, ode=ode, held=None, limits=(), checks=(), rest=ca.SX(0, 1))


def _relax(model: Dae, first: Trajectory, options: SolverOptions) -> Trajectory:
    """Return the motion to rest of a model with lag, whose equilibrium has no equations."""
    # The equilibrium is a fixed point, which does not depend on the accuracy of the path to it.
    rough = replace(options, tolerance=RELAXATION_TOLERANCE)
    run = simulate(model, first, model.zero_inputs, np.array([0.0, RELAXATION_TIME]), options=rough)
    system = with_inputs(model, model.zero_inputs, 0, options)
    x, z = (model.rows(record, run, -1) for record in "xz")
    rates = np.array(system.core(0.0, x, z[: system.motion_size], system.u[:, 0])[0]).ravel()
    rates /= system.dae.sizes.x
    if not np.abs(rates).max() < REST_RATE:
        name = model.state_names[int(np.abs(rates).argmax())]
        raise ModelError(
            f"no equilibrium was found at the start: after {RELAXATION_TIME:g} s of relaxation, "
            f"expected all rates below {REST_RATE:g} 1/s (lengths divided by the vehicle's size), "
            f"found {np.abs(rates).max():.1e} 1/s for {name!r}; choose another start"
        )
    return run


def _one_sample(dae: Dae, x: Array, first: Array, options: SolverOptions) -> Trajectory:
    """Return the vehicle at rest; wheels whose contacts are unknowns are lowered to the ground."""
    system = with_inputs(dae, dae.zero_inputs, 0, options)
    n, wheels = x.size, many.wheel_checks(dae)
    if not wheels:
        return consistent_start(system, x, first)
    block, p = system.blocks[0], slice(n, n + system.blocks[0].span.stop)

    def step(states: Array) -> tuple[Array, Array]:
        point = 0.0, states[:n], states[n:], system.u[:, 0], block.stages[-1]
        residual, jacobian = linearized(block, point)
        change = solve_linear(jacobian[None], residual[None], WEAK_SINGULAR_VALUE).T
        lengths = np.abs(change / dae.scale[block.span, None]).sum(axis=0)
        return states[p] - change, lengths

    def placed(states: Array) -> list[Array]:
        return [evaluate(check.pose, states[:n], states[n:])[0] for check in wheels]

    states = np.concatenate([x, first])[:, None]
    with np.errstate(all="ignore"):
        rests = many.find_rests(many.Placement(dae, p, step, placed), states)
    if not rests.has_pose[0]:
        raise ModelError(many.obstacles(dae, states[:n], states[n:])[0])
    return consistent_start(system, x, states[n:, 0])


def first_guess(dae: Dae, x: Array, given: Mapping[str, float]) -> Array:
    """Return an initial guess of ``z`` in local coordinates; ``given`` is in map coordinates."""
    z = np.array(guess_function(dae)(x)).ravel()
    names = [label.full for label in leaves(dae.labels.z)]
    check_known("guess", given, names, "names of unknowns of the model,")
    for name, value in given.items():
        index = names.index(name)
        z[index] = value - dae.shift[1][index]
    return z


def settle_at(dae: Dae, found: Trajectory, options: SolverOptions) -> Trajectory:
    """Return a model settled at the states of the first sample, with its pose as initial guess."""
    states, pose = (
        {label.full: float(found.of(label)[0]) for label in leaves(record)}
        for record in (dae.labels.x, dae.labels.z[0])
    )
    return settle(dae, guess=pose, options=options, **states)


def settle_contact(
    dae: Dae,
    wheel: str,
    *,
    contact_x: float,
    contact_y: float,
    options: SolverOptions = SolverOptions(),
    **start: float,
) -> Trajectory:
    """Return the vehicle at rest with a given contact point of one wheel.

    The contact point of one wheel, the heading and the joints are given. The nine closure equations
    of a three-wheeler then determine position, height, roll and pitch of its platform and the other
    two contact points.

    Parameters
    ----------
    dae : Dae
        A closure model: its states include ``x`` and ``y``, its first unknowns are the contacts.
    wheel : str
        Name of the wheel.
    contact_x, contact_y : float
        Contact point of the wheel, in map coordinates. [m]
    options : SolverOptions
        Options of the solvers.
    **start : float
        Heading and joints by name; others are zero. [rad, m]

    Raises
    ------
    ModelError
        If ``dae`` is not a closure model, the wheel or a name is unknown, ``x`` or ``y`` is given,
        or the vehicle cannot stand with this contact point.
    """
    contacts = (label for label in leaves(dae.labels.z[0]) if label.name == "contact_x")
    known = sorted(label.wheel for label in contacts if label.wheel)
    if not known:
        raise ModelError(
            "settle_contact: expected a model whose first unknowns are contact points, found no "
            "unknown 'contact_x'; use a closure model"
        )
    check_known("settle_contact", [wheel], known, "one of the wheels")
    fixed = {name: start.pop(name) for name in ("x", "y") if name in start}
    if fixed:
        raise ModelError(
            "settle_contact: expected no x and y, which follow from the contact point, found "
            f"{' and '.join(fixed)}; remove {'it' if len(fixed) == 1 else 'them'}"
        )
    from scipy.optimize import root  # imported where it is used: it takes 0.2 s

    def stand(place: Array) -> Trajectory:
        return settle(dae, guess=None, options=options, x=place[0], y=place[1], **start)

    def miss(place: Array) -> Array:
        run = stand(place)
        return np.asarray([run[f"contact_{axis}", wheel][0] for axis in "xy"] - wanted)

    wanted, vehicle = np.array([contact_x, contact_y]), dae.vehicle.numeric
    k = [each.name for each in vehicle.wheels].index(wheel)
    away = np.exp(1j * start.get("heading", 0.0)) * complex(*vehicle.centers[k, :2])
    found = root(miss, wanted - [away.real, away.imag], options={"xtol": CONTACT_TOLERANCE})
    if not np.abs(found.fun).max() < MAX_CONTACT_MISS * dae.size:
        raise ModelError(
            f"settle_contact: no position of the vehicle was found at which wheel {wheel!r} stands "
            f"at ({contact_x:g}, {contact_y:g}) m; choose another contact point"
        )
    return stand(found.x)
