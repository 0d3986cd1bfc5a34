"""Body motion of a vehicle on level ground, and its derivatives with respect to parameters.

On level, homogeneous ground the velocity of a vehicle relative to its platform does not depend on
position and heading. It follows from the rates of wheels and joints and the values of the joints;
the parameters change it through the implicit function theorem.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.records import Array, Mask, leaves

MAX_STEPS = 30  # of Newton's method
MAX_HALVINGS = 6  # of a step that does not reduce the residual
SOLVED_RESIDUAL = 1e-11  # without unit
BATCHES = (1, 4, 16, 64, 256, 1024)  # numbers of samples that are evaluated at once
POSE = ("x", "y", "heading")


class BodyMotion(NamedTuple):
    """A model on level ground as a function of inputs, joints and parameters.

    Attributes
    ----------
    names : tuple of str
        Names of the given quantities: inputs, then values of the joints that are states.
    parameters : tuple of str
        Names of the parameters. If the model has a continuation parameter that is none of them, it
        is the last argument ``p``, without a name.
    newton : casadi Function
        ``(z, given, p) -> (residual, its Jacobian by z)``.
    slopes : casadi Function
        ``(z, given, p) -> (residual by p, velocity, velocity by z, velocity by p)``.
    guess : casadi Function
        ``(given, p) -> z``.
    stages : tuple of float
        Values of the continuation parameter, in the order of solution; empty for none.
    stage : int
        Index of the continuation parameter in ``p``.
    """

    names: tuple[str, ...]
    parameters: tuple[str, ...]
    newton: ca.Function
    slopes: ca.Function
    guess: ca.Function
    stages: tuple[float, ...]
    stage: int


class Velocities(NamedTuple):
    """Velocities of the platform's centre at n samples.

    Attributes
    ----------
    values : ndarray, shape (n, 3)
        Velocity to the right and forward [m/s], and yaw rate [rad/s].
    slopes : ndarray, shape (n, 3, n_p)
        Derivatives with respect to the parameters of the model.
    p : ndarray, shape (n_p,)
        Values of the parameters.
    z, z_slopes : ndarray, shape (n, n_z) and (n, n_z, n_p)
        Unknowns of the model, and their derivatives with respect to the parameters.
    """

    values: Array
    slopes: Array
    p: Array
    z: Array
    z_slopes: Array


def body_motion(dae: Dae) -> BodyMotion:
    """Return the body motion of a kinematic or quasi-static model on level ground.

    Parameters
    ----------
    dae : Dae
        Model with parameters ``p``.

    Raises
    ------
    ModelError
        If the model has inertia.
    """
    if dae.standing is not None:
        raise ModelError(
            "body_motion: expected a kinematic or quasi-static model, found one with inertia; use "
            "direct_kinematics or quasi_statics"
        )
    x, z, u = dae.columns()
    names = [label.full for label in leaves(dae.labels.x)]
    first = len(names) - dae.rest.numel()
    joints = [k for k in range(first) if names[k] not in POSE]
    at = ca.SX.zeros(len(names))
    for k in (*joints, *range(first, len(names))):
        at[k] = x[k]
    symbols, stages, stage = _parameters(dae)
    count = _motion_size(dae)
    equations = ca.vertcat(*dae.residuals)[:count]
    velocity, still = dae.ode[[names.index(name) for name in POSE]], dae.ode[first:]
    first_guess = ca.substitute(dae.rest, x, at)
    rows = [ca.vertcat(equations, still), velocity, ca.vertcat(first_guess, dae.guess[:count])]
    alg, velocity, guess = ca.substitute(rows, [x], [at])
    guess = ca.substitute(guess, x[first:], first_guess) if dae.rest.numel() else guess
    p, given = ca.vertcat(ca.SX(0, 1), *symbols), ca.vertcat(u, x[joints])
    unknown = ca.vertcat(x[first:], z[:count])
    arguments = [unknown, given, p]
    slopes = [
        ca.jacobian(alg, p),
        velocity,
        ca.jacobian(velocity, unknown),
        ca.jacobian(velocity, p),
    ]
    full = {"cse": True}
    return BodyMotion(
        (*(label.full for label in leaves(dae.labels.u)), *(names[k] for k in joints)),
        tuple(each.label.name for each in dae.p),
        ca.Function("newton", arguments, [alg, ca.densify(ca.jacobian(alg, unknown))], full),
        ca.Function("slopes", arguments, [ca.densify(each) for each in slopes], full),
        ca.Function("guess", [given, p], [ca.densify(guess)]),
        stages,
        stage,
    )


def _parameters(dae: Dae) -> tuple[list[ca.SX], tuple[float, ...], int]:
    """Return the symbols of the parameters, stages of the continuation, and index of its symbol.

    The symbol of the continuation is appended if it is no parameter; without one, the index is -1.
    """
    symbols = [each.symbol for each in dae.p]
    if dae.continuation is None:
        return symbols, (), -1
    own = dae.continuation.symbol.element_hash()
    if own not in [symbol.element_hash() for symbol in symbols]:
        symbols.append(dae.continuation.symbol)
    index = [symbol.element_hash() for symbol in symbols].index(own)
    return symbols, dae.continuation.values, index


def _motion_size(dae: Dae) -> int:
    """Return the number of unknowns in the blocks of equations that determine the motion."""
    z, end, size = dae.columns()[1], 0, 0
    for rows, _ in zip(dae.alg, dae.z, strict=True):
        end += rows.numel()
        if rows.numel() and ca.depends_on(dae.ode, z[end - rows.numel() : end]):
            size = end
    return size


def velocities(
    motion: BodyMotion, given: Array, p: Array, near: Velocities | None = None
) -> Velocities:
    """Return the velocities of a vehicle and their derivatives.

    Parameters
    ----------
    motion : BodyMotion
        The model.
    given : ndarray, shape (n, n_given)
        Inputs and joints at n samples. [rad/s, m/s, rad, m]
    p : ndarray, shape (n_p,)
        Values of the parameters, in their units.
    near : Velocities, optional
        Result at the same samples for other parameters, from which Newton's method starts.

    Raises
    ------
    ModelError
        If the equations have no solution at a sample.
    """
    guess = None if near is None else near.z + near.z_slopes @ (p - near.p)
    parts = [slice(k, k + BATCHES[-1]) for k in range(0, len(given), BATCHES[-1])]
    found = [
        _velocities(motion, given[part], p, None if guess is None else guess[part])
        for part in parts
    ]
    values, slopes, z, z_slopes = (np.concatenate(each) for each in zip(*found, strict=True))
    return Velocities(values, slopes, p, z, z_slopes)


def _velocities(
    motion: BodyMotion, given: Array, p: Array, guess: Array | None
) -> tuple[Array, Array, Array, Array]:
    """Return values, slopes, unknowns and their slopes at samples that are solved at once."""
    named = len(motion.parameters)
    full = p if motion.stage < named else np.append(p, motion.stages[-1])
    if guess is None:
        z, jac = _solve_cold(motion, given, full)
    else:
        z, jac, solved = _solve(motion, given, full, guess)
        if not solved.all():
            z[~solved], jac[~solved] = _solve_cold(motion, given[~solved], full)
    by_p, value, by_z, direct = evaluate(motion.slopes, z, given, _repeated(full, len(given)))
    z_slopes = np.asarray(-np.linalg.solve(jac, by_p))
    slopes = direct + by_z @ z_slopes
    return value[..., 0], slopes[..., :named], z, z_slopes[..., :named]


def _solve_cold(motion: BodyMotion, given: Array, p: Array) -> tuple[Array, Array]:
    """Return unknowns and Jacobians from the model's initial guess, through the continuation.

    Raises
    ------
    ModelError
        If Newton's method does not converge.
    """
    z = evaluate(motion.guess, given, _repeated(p, len(given)))[0][..., 0]
    end = p[motion.stage] if motion.stages else 0.0
    for stage in (*(each for each in motion.stages[:-1] if each > end), end):
        now = p.copy()
        if motion.stages:
            now[motion.stage] = stage
        z, jac, good = _solve(motion, given, now, z)
    if not good.all():
        words = _words(motion.names, given[~good][0])
        raise ModelError(
            f"body_motion: no solution was found at {words}, with "
            f"{_words(motion.parameters, p)}; narrow the bounds of the unknowns, or use a model "
            "that can follow these rates"
        )
    return z, jac


def _words(names: Sequence[str], values: Array) -> str:
    """Return names with their values, for messages."""
    return ", ".join(f"{name} = {each:.4g}" for name, each in zip(names, values, strict=False))


def _solve(motion: BodyMotion, given: Array, p: Array, z: Array) -> tuple[Array, Array, Mask]:
    """Return unknowns and Jacobians after Newton's method, and the mask of solved samples.

    A step that does not reduce the largest residual is halved.
    """
    z, many = z.copy(), _repeated(p, len(given))
    residual, jac = (each.copy() for each in evaluate(motion.newton, z, given, many))
    size = _size(residual)
    for _ in range(MAX_STEPS):
        rows = np.flatnonzero(~(size < SOLVED_RESIDUAL))
        if not rows.size:
            break
        step = np.linalg.solve(jac[rows], residual[rows])[..., 0]
        damping = np.ones(rows.size)
        for _ in range(MAX_HALVINGS):
            trial = z[rows] - damping[:, None] * step
            new, new_jac = evaluate(motion.newton, trial, given[rows], many[rows])
            worse = ~(_size(new) < size[rows])
            if not worse.any():
                break
            damping[worse] /= 2
        z[rows], residual[rows], jac[rows], size[rows] = trial, new, new_jac, _size(new)
    return z, jac, size < SOLVED_RESIDUAL


def _repeated(p: Array, count: int) -> Array:
    """Return a row repeated for each sample."""
    return np.broadcast_to(p, (count, p.size))


def _size(residual: Array) -> Array:
    return np.asarray(np.abs(residual).max(axis=(1, 2)))


def evaluate(function: ca.Function, *arguments: Array) -> tuple[Array, ...]:
    """Return the results of a function at n samples, each of shape (n, rows, columns).

    Arguments have one row per sample. A buffer avoids CasADi's slow conversion of matrices.
    """
    count = len(arguments[0])
    size = next(each for each in BATCHES if each >= count)
    buffer: Any
    buffer, run = _mapped(function, size).buffer()
    inputs: list[Any] = [np.zeros((size, each.shape[1])) for each in arguments]
    results: list[Any] = [
        np.zeros((size, *reversed(function.size_out(k)))) for k in range(function.n_out())
    ]
    for k, (values, each) in enumerate(zip(inputs, arguments, strict=True)):
        values[:] = each[-1]
        values[:count] = each
        buffer.set_arg(k, memoryview(values))
    for k, values in enumerate(results):
        buffer.set_res(k, memoryview(values))
    run()
    return tuple(values[:count].transpose(0, 2, 1) for values in results)


@lru_cache(maxsize=64)
def _mapped(function: ca.Function, size: int) -> ca.Function:
    """Return a function for several samples, in columns."""
    return function.map(size)
