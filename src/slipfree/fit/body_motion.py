"""Body motion of a vehicle on level ground, and its derivatives with respect to parameters.

On level, homogeneous ground the velocity of a vehicle relative to its platform does not depend on
position and heading. It follows from the rates of wheels and joints and the values of the joints;
the parameters change it through the implicit function theorem.

A vehicle may have several poses in which its equations hold, such as one on two wheels. Its pose is
therefore computed first, at rest, from the model's initial guess, as `slipfree.settle` does; rates
are then solved for in this pose. So a velocity depends on rates and parameters only, never on the
parameters that were tried before.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from slipfree.core.dae import Dae, Limit, limit_message, power_of_length
from slipfree.core.errors import ModelError
from slipfree.core.evaluation import evaluate as evaluate_columns
from slipfree.core.newton import solve_equations, solve_linear
from slipfree.core.records import Array, Mask, leaves
from slipfree.solve.initial_conditions import MAX_DIVISIONS, MAX_STEP

MAX_STEPS = 30  # of Newton's method
MAX_STANDING_STEPS = 100  # of the relaxation to the pose at rest
FIRST_TIME_STEP, GROWTH = 1e-3, 1.5  # of the relaxation: first time step [s], ratio of consecutive
SOLVED_RESIDUAL = 1e-11  # without unit
STAGE_RATIO = 0.2  # smallest ratio of consecutive values of the continuation parameter
BATCHES = (1, 4, 16, 64, 256, 1024)  # numbers of samples that are evaluated at once
POSE = ("x", "y", "heading")


class MotionError(ModelError):
    """Failure to find the motion of a vehicle at a sample; ``sample`` is its index."""

    def __init__(self, message: str, sample: int) -> None:
        super().__init__(message)
        self.sample = sample


class BodyMotion(NamedTuple):
    """A model on level ground as a function of inputs, joints and parameters."""

    names: tuple[str, ...]  # of the inputs, then of the joints that are states
    inputs: int  # number of inputs
    parameters: tuple[str, ...]  # a continuation parameter may be the last ``p``, without name
    pose: int  # number of unknowns of the pose; they are the first ones
    relaxing: int  # number of first pose unknowns with rates, which are the last equations
    scale: Array  # shape (n_z,): typical sizes of the unknowns
    size: float  # unit of length of the model [m]
    newton: ca.Function  # ``(z, given, p) -> (residual, its Jacobian by z)``
    slopes: ca.Function  # ``(z, given, p) -> (residual_p, velocity, velocity_z, velocity_p)``
    guess: ca.Function  # ``(given, p) -> z``
    limits: tuple[Limit, ...]  # limits of the model that the unknowns may violate
    limited: ca.Function  # ``(z, given, p) -> values of the limits``
    stages: tuple[float, ...]  # values of the continuation parameter in order; else empty
    stage: int  # index of the continuation parameter in ``p``


class Velocities(NamedTuple):
    """Velocities of the platform's centre at n samples."""

    values: Array  # shape (n, 3): velocity to the right and forward [m/s], and yaw rate [rad/s]
    slopes: Array  # shape (n, 3, n_p): derivatives with respect to the parameters of the model
    p: Array  # shape (n_p,): values of the parameters
    z: Array  # shape (n, n_z): unknowns of the model
    z_slopes: Array  # shape (n, n_z, n_p): their derivatives


def body_motion(dae: Dae) -> BodyMotion:
    """Return the body motion of a kinematic or quasi-static model on level ground."""
    if dae.standing is not None:
        raise ModelError(
            "expected a kinematic or quasi-static model, found one with inertia; use model = "
            "'kinematics' or 'quasi-static'"
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
    limits = _limits_of_unknowns(dae, first, count)
    equations = ca.vertcat(*dae.residuals)[:count]
    velocity, still = dae.ode[[names.index(name) for name in POSE]], dae.ode[first:]
    first_guess = ca.substitute(dae.rest, x, at)
    rows = [
        ca.vertcat(equations, still),
        velocity,
        ca.vertcat(first_guess, dae.guess[:count]),
        ca.vertcat(ca.SX(0, 1), *(limit.expression for limit in limits)),
    ]
    alg, velocity, guess, limited = ca.substitute(rows, [x], [at])
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
        u.numel(),
        tuple(each.label.name for each in dae.p),
        dae.rest.numel() + len(list(leaves(dae.z[0]))),
        dae.rest.numel(),
        np.append(dae.sizes.x[first:], dae.scale[:count]),
        dae.size,
        ca.Function("newton", arguments, [alg, ca.densify(ca.jacobian(alg, unknown))], full),
        ca.Function("slopes", arguments, [ca.densify(each) for each in slopes], full),
        ca.Function("guess", [given, p], [ca.densify(guess)]),
        limits,
        ca.Function("limited", arguments, [ca.densify(limited)], full),
        stages,
        stage,
    )


def _limits_of_unknowns(dae: Dae, first: int, count: int) -> tuple[Limit, ...]:
    """Return the limits that depend on unknowns of the motion, and on no others."""
    x, z, _ = dae.columns()
    own, others = ca.vertcat(x[first:], z[:count]), z[count:]
    return tuple(
        limit
        for limit in dae.limits
        if ca.depends_on(limit.expression, own)
        and not (others.numel() and ca.depends_on(limit.expression, others))
    )


def _parameters(dae: Dae) -> tuple[list[ca.SX], tuple[float, ...], int]:
    """Return parameter symbols, stages of the continuation, and index of its symbol or -1."""
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
    """Return the velocities of a vehicle and their derivatives; MotionError if there is no motion.

    ``given`` are inputs and joints, shape (n, n_given); ``near``, a result at the same samples for
    other parameters, is the initial guess of the rates.
    """
    guess = None if near is None else near.z + near.z_slopes @ (p - near.p)
    full = p if motion.stage < len(motion.parameters) else np.append(p, motion.stages[-1])
    pose = _standing_poses(motion, given, full)
    blocks = list[tuple[Array, ...]]()
    for k in range(0, len(given), BATCHES[-1]):
        part = slice(k, k + BATCHES[-1])
        at = (given[part], full, pose[part], None if guess is None else guess[part])
        try:
            blocks.append(_velocities(motion, *at))
        except MotionError as error:
            raise MotionError(str(error), k + error.sample) from error
    values, slopes, z, z_slopes = (np.concatenate(each) for each in zip(*blocks, strict=True))
    return Velocities(values, slopes, p, z, z_slopes)


def _standing_poses(motion: BodyMotion, given: Array, p: Array) -> Array:
    """Return the unknowns of the vehicle at rest with the joints of each sample, shape (n, n_z)."""
    joints, first, inverse = np.unique(
        given[:, motion.inputs :], axis=0, return_index=True, return_inverse=True
    )
    still = np.concatenate([np.zeros((len(joints), motion.inputs)), joints], axis=1)
    unknowns = np.empty((len(joints), motion.scale.size))
    for k in range(0, len(joints), BATCHES[-1]):
        part = slice(k, k + BATCHES[-1])
        here, many = still[part], _repeated(p, len(still[part]))
        z, jac, solved = _relax(motion, here, many)
        _check(solved, first[part], "the vehicle has no pose in which it stands on level ground")
        words = "the vehicle would fall from the pose in which its wheels bear it"
        _check(_is_stable(jac, motion.relaxing), first[part], words)
        unknowns[part] = z
    return unknowns[inverse.ravel()]


def _relax(motion: BodyMotion, given: Array, p: Array) -> tuple[Array, Array, Mask]:
    """Return unknowns, Jacobians and mask of solved samples of a vehicle that comes to rest.

    The steps are those of the linearly implicit Euler method for the coordinates that relax, with
    growing time steps; without such coordinates they are Newton's.
    """
    z, relaxing = evaluate(motion.guess, given, p)[0][..., 0], motion.relaxing
    time_step, rates = FIRST_TIME_STEP, range(motion.scale.size - relaxing, motion.scale.size)
    for _ in range(MAX_STANDING_STEPS):
        residual, jac = evaluate(motion.newton, z, given, p)
        rows = np.flatnonzero(_is_unsolved(residual, jac))
        if not rows.size:
            break
        matrix = jac[rows].copy()
        matrix[:, rates, range(relaxing)] -= 1 / time_step
        step = solve_linear(matrix, residual[rows])[..., 0]
        size = np.abs(step / motion.scale).max(axis=1)
        z[rows] -= step * (MAX_STEP / np.maximum(size, MAX_STEP))[:, None]
        time_step *= GROWTH
    residual, jac = evaluate(motion.newton, z, given, p)
    return z, jac, _size(residual) < SOLVED_RESIDUAL


def _is_unsolved(residual: Array, jac: Array) -> Mask:
    """Return whether samples need further steps, and can take them."""
    return ~(_size(residual) < SOLVED_RESIDUAL) & np.isfinite(jac).all(axis=(1, 2))


def _is_stable(jac: Array, relaxing: int) -> Mask:
    """Return whether the coordinates that relax return to equilibrium after a small displacement.

    The rates of these coordinates, the last equations, are linear in them near the equilibrium, if
    the other unknowns follow from the other equations.
    """
    if not relaxing:
        return np.ones(len(jac), dtype=bool)
    equations, rates = jac[:, :-relaxing], jac[:, -relaxing:]
    others = -solve_linear(equations[:, :, relaxing:], equations[:, :, :relaxing])
    reduced = rates[:, :, :relaxing] + rates[:, :, relaxing:] @ others
    return np.asarray((np.linalg.eigvals(reduced).real < 0).all(axis=1))


def _check(good: Mask, samples: npt.NDArray[np.intp], words: str) -> None:
    """Raise MotionError for the first sample that is not good."""
    if not good.all():
        raise MotionError(words, int(samples[~good].min()))


def _velocities(
    motion: BodyMotion, given: Array, p: Array, pose: Array, guess: Array | None
) -> tuple[Array, Array, Array, Array]:
    """Return values, slopes, unknowns and their slopes at samples that are solved at once."""
    many, named = _repeated(p, len(given)), len(motion.parameters)
    cold = np.ones(len(given), dtype=bool)
    z, jac = pose.copy(), np.zeros((*pose.shape, pose.shape[1]))
    if guess is not None:
        z[:, motion.pose :] = guess[:, motion.pose :]
        z, jac, solved = _solve(motion, given, many, z)
        cold = ~solved
    if cold.any():
        z[cold], jac[cold], solved = _solve_cold(motion, given[cold], many[cold], pose[cold])
        _check(solved, np.flatnonzero(cold), "the equations of the model have no solution")
    _check_limits(motion, z, given, many)
    by_p, value, by_z, direct = evaluate(motion.slopes, z, given, many)
    z_slopes = -solve_linear(jac, by_p)
    slopes = direct + by_z @ z_slopes
    return value[..., 0], slopes[..., :named], z, z_slopes[..., :named]


def _check_limits(motion: BodyMotion, z: Array, given: Array, many: Array) -> None:
    """Raise MotionError at the first sample that violates a limit of the model."""
    if not motion.limits:
        return
    values = evaluate(motion.limited, z, given, many)[0][..., 0]
    for limit, column in zip(motion.limits, values.T, strict=True):
        label = limit.label
        size = motion.size ** power_of_length(label.unit)
        inside = ~limit.violated_by(column, size)
        for value in column[~inside][:1]:
            words = limit_message(label.words, value, limit.lower, limit.upper, label.unit)
            _check(inside, np.arange(len(column)), words)


def _solve_cold(motion: BodyMotion, given: Array, p: Array, z: Array) -> tuple[Array, Array, Mask]:
    """Return unknowns, Jacobians and mask of solved samples, from poses at rest.

    The continuation begins at the largest velocity of a sample, where it exceeds the model's first
    value: friction with this creep speed is nearly viscous.
    """
    if not motion.stages:
        return _solve(motion, given, p, z)
    end = p[:, motion.stage]
    fastest = motion.size * np.abs(given[:, : motion.inputs]).max(axis=1, initial=0.0)
    begin = np.maximum(np.maximum(motion.stages[0], fastest), end)
    count = int(np.ceil(np.log((end / begin).min()) / np.log(STAGE_RATIO))) + 1
    values = begin * (end / begin) ** np.linspace(0, 1, count)[:, None]
    z, jac, good = _solve(motion, given, _with_stage(motion, p, values[0]), z)
    for pair in pairwise(values):
        if not good.all():  # no motion is found
            break
        z, jac, good = _solve_stage(motion, given, p, z, pair, MAX_DIVISIONS)
    return z, jac, good


def _solve_stage(
    motion: BodyMotion, given: Array, p: Array, z: Array, pair: tuple[Array, Array], depth: int
) -> tuple[Array, Array, Mask]:
    """Return the result of `_solve` at the end of a stage, divided at most ``depth`` times."""
    solved, jac, good = _solve(motion, given, _with_stage(motion, p, pair[1]), z)
    if depth and not good.all():
        bad = ~good
        begin, end = (each[bad] for each in pair)
        at = motion, given[bad], p[bad]
        middle = np.sqrt(begin * end)
        half = _solve_stage(*at, z[bad], (begin, middle), depth - 1)
        if half[2].all():
            solved[bad], jac[bad], good[bad] = _solve_stage(*at, half[0], (middle, end), depth - 1)
    return solved, jac, good


def _with_stage(motion: BodyMotion, p: Array, values: Array) -> Array:
    """Return parameters with other values of the continuation parameter, for each sample."""
    p = p.copy()
    p[:, motion.stage] = values
    return p


def _solve(motion: BodyMotion, given: Array, p: Array, z: Array) -> tuple[Array, Array, Mask]:
    """Return unknowns and Jacobians after damped Newton steps, and the mask of solved samples."""

    def equations(z: Array, rows: npt.NDArray[np.intp]) -> tuple[Array, Array]:
        residual, jacobian = evaluate(motion.newton, z, given[rows], p[rows])
        return residual[..., 0], jacobian

    solution = solve_equations(equations, z, tolerance=SOLVED_RESIDUAL, steps=MAX_STEPS)
    return solution.z, solution.jacobian, solution.size < SOLVED_RESIDUAL


def _repeated(p: Array, count: int) -> Array:
    """Return a row repeated for each sample."""
    return np.broadcast_to(p, (count, p.size))


def _size(residual: Array) -> Array:
    return np.asarray(np.abs(residual).max(axis=(1, 2)))


def evaluate(function: ca.Function, *arguments: Array) -> tuple[Array, ...]:
    """Return the results of a function at n samples, each of shape (n, rows, columns)."""
    count = len(arguments[0])
    size = next((each for each in BATCHES if each >= count), BATCHES[-1])
    # few sizes of batches, so that few functions of several samples are made
    rows = np.minimum(np.arange(count + -count % size), count - 1)
    columns = [each[rows].T for each in arguments]
    blocks = [
        evaluate_columns(function, *(each[:, k : k + size] for each in columns))
        for k in range(0, rows.size, size)
    ]
    shapes = [(count, *reversed(function.size_out(k))) for k in range(function.n_out())]
    return tuple(
        np.concatenate(parts, axis=1)[:, :count].T.reshape(shape).transpose(0, 2, 1)
        for parts, shape in zip(zip(*blocks, strict=True), shapes, strict=True)
    )
