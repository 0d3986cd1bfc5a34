"""Solve for the pose of a vehicle at rest on the ground, as the start of a motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae, Standing
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, leaves, unpack
from slipfree.core.trajectory import SolverError, Trajectory
from slipfree.solve.initial_conditions import solve_initial_conditions
from slipfree.solve.options import SolverOptions
from slipfree.solve.sampling import Samples, correct_samples, to_trajectory
from slipfree.solve.simulate import simulate
from slipfree.solve.system import with_inputs
from slipfree.solve.violations import first_violation, invalid_start
from slipfree.system.forks import computing

RELAXATION_TIME = 20.0  # duration of the relaxation to the equilibrium of a start [s]
RELAXATION_TOLERANCE = 1e-4  # integration tolerance of the relaxation
INCLINATIONS = (("roll", 0.2), ("roll", -0.2), ("pitch", 0.2), ("pitch", -0.2))  # [rad]
DIFFERENT_ANGLE = 1e-4  # smallest difference of roll or pitch of two stable poses [rad]
SPEED = "speed"  # name of the initial speed of a dynamic model
REST_RATE = 1e-5  # largest rate of the relaxing states at rest [size/s]


@computing
def settle(
    dae: Dae,
    *,
    guess: Mapping[str, float] | None = None,
    options: SolverOptions = SolverOptions(),
    **start: float,
) -> Trajectory:
    """Return the vehicle at rest at a position, as a trajectory of one sample.

    Parameters
    ----------
    dae : Dae
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
    if dae.standing is not None:
        speed = start.pop(SPEED, 0.0)
        first = _exact_pose(dae.standing, start, options) | dict(guess or {})
        run = settle(dae.standing.model, guess=first, options=options, **start)
        x = _moving_states(dae.standing, run, speed)
        return _one_sample(dae, x, first_guess(dae, x, {}), options)
    x, guess = dae.start(**start), dict(guess or {})
    if not dae.rest.numel():
        return _one_sample(dae, x, first_guess(dae, x, guess), options)
    return _settle_by_relaxation(dae, x, start, guess, options)


def _exact_pose(
    standing: Standing, start: dict[str, Any], options: SolverOptions
) -> dict[str, float]:
    """Return the pose of a vehicle in exact contact by name, empty if there is no such pose."""
    if standing.guess is None:
        return {}
    wanted = [label.full for label in leaves(standing.model.labels.x)]
    names = [label.full for label in leaves(standing.guess.labels.x)]
    try:
        run = settle(standing.guess, options=options, **start)
    except ModelError:  # a wrong start is reported by the model at rest
        return {}
    return {name: float(run[name][0]) for name in wanted if name not in names}


def _moving_states(standing: Standing, run: Trajectory, speed: float) -> Array:
    """Return the local states of a dynamic model for a vehicle at rest and a speed [m/s]."""
    model = standing.model
    symbols = [*model.columns()[:2], standing.speed]
    states = model.function("states", symbols, [standing.x])
    return np.array(states(*(model.rows(record, run, -1) for record in "xz"), speed)).ravel()


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
    found = [settle(dae, options=options, **values)]
    standing = dae.standing
    relaxes = bool(dae.rest.numel()) if standing is None else standing.guess is None
    for name, angle in INCLINATIONS if relaxes else ():
        try:
            other = settle(dae, options=options, **(values | {name: angle}))
        except ModelError:  # it overturns from there
            continue
        apart = [max(abs(other[n][0] - run[n][0]) for n in ("roll", "pitch")) for run in found]
        if min(apart) > DIFFERENT_ANGLE:
            found.append(other)
    return tuple(found)


def _settle_by_relaxation(
    dae: Dae,
    x: Array,
    start: dict[str, float],
    guess: dict[str, float],
    options: SolverOptions,
) -> Trajectory:
    """Return the vehicle at the equilibrium to which it relaxes at rest.

    The relaxation starts from the guessed pose; the model's initial pose completes it. If that
    fails or the vehicle overturns, the relaxation starts from the model's initial pose.
    """
    states, model = [label.full for label in leaves(dae.labels.x)], _relaxation_model(dae)
    level = np.array(dae.function("rest", [dae.columns()[0]], [dae.rest])(x)).ravel()
    still, shift = x.size - level.size, dae.shift[0][x.size - level.size :]
    given = [(start | guess).get(name, np.nan) for name in states[still:]] - shift
    others = {name: value for name, value in guess.items() if name not in states[still:]}
    failure = ModelError("")
    for first in (np.where(np.isnan(given), level, given), level):
        at = np.concatenate([x[:still], first])
        try:
            begin = _one_sample(model, at, first_guess(model, at, others), options)
            run = _relax(model, begin, options)
            at[still:] = model.rows("x", run, -1)[still:]
            return _one_sample(dae, at, model.rows("z", run, -1), options)
        except SolverError as error:
            failure = ModelError(
                f"no equilibrium of the vehicle was found at the start: {error}; choose another "
                "start"
            )
        except ModelError as error:
            failure = error
    raise failure


@lru_cache(maxsize=8)
def _relaxation_model(dae: Dae) -> Dae:
    """Return a model in which only states that relax change, without limits and checks."""
    moving = dae.rest.numel()
    still = ca.SX.zeros(dae.ode.numel() - moving)
    ode = ca.vertcat(still, dae.ode[still.numel() :])
    return replace(dae, ode=ode, held=None, limits=(), checks=(), rest=ca.SX(0, 1))


def _relax(model: Dae, first: Trajectory, options: SolverOptions) -> Trajectory:
    """Return the motion of a vehicle from a first pose to its equilibrium, with zero inputs."""
    rest = unpack(model.u, [0.0] * len(list(leaves(model.u))))
    # The equilibrium is a fixed point, which does not depend on the accuracy of the path to it.
    rough = replace(options, tolerance=RELAXATION_TOLERANCE)
    run = simulate(model, first, rest, np.array([0.0, RELAXATION_TIME]), options=rough)
    system = with_inputs(model, rest, 0, options)
    x, z = (model.rows(record, run, -1) for record in "xz")
    rates = np.array(system.core(0.0, x, z[: system.motion_size], system.u[:, 0])[0]).ravel()
    rates /= system.dae.sizes.x
    if not np.abs(rates).max() < REST_RATE:
        name = list(leaves(model.labels.x))[int(np.abs(rates).argmax())].full
        raise ModelError(
            f"no equilibrium was found at the start: after {RELAXATION_TIME:g} s of relaxation, "
            f"expected all rates below {REST_RATE:g} 1/s (lengths divided by the vehicle's size), "
            f"found {np.abs(rates).max():.1e} 1/s for {name!r}; choose another start"
        )
    return run


def _one_sample(dae: Dae, x: Array, first: Array, options: SolverOptions) -> Trajectory:
    """Return a start at given states as one sample; ``first`` is a guess of the unknowns."""
    system = with_inputs(dae, unpack(dae.u, [0.0] * len(list(leaves(dae.u)))), 0, options)
    z = solve_initial_conditions(system, 0.0, x, first, system.u[:, 0])
    samples = Samples(
        np.zeros(1), x[:, None], z[:, None], np.zeros((dae.quad.numel(), 1)), system.u
    )
    samples, report = correct_samples(system, samples)
    run = to_trajectory(system, samples, report)
    violation = first_violation(system, run, samples)
    if violation is not None:
        raise invalid_start(violation[1].words)
    return run


def first_guess(dae: Dae, x: Array, given: Mapping[str, float]) -> Array:
    """Return an initial guess of ``z`` in local coordinates; ``given`` is in map coordinates."""
    z = np.array(dae.function("guess", [dae.columns()[0]], [dae.guess])(x)).ravel()
    names = [label.full for label in leaves(dae.labels.z)]
    for name, value in given.items():
        if name not in names:
            raise ModelError(
                f"guess: expected names of unknowns of the model, {', '.join(names)}, found "
                f"{name!r}; correct the name"
            )
        index = names.index(name)
        z[index] = value - dae.shift[1][index]
    return z
