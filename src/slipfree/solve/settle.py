"""A consistent start: the pose in which a vehicle stands on the ground."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from slipfree.dae import Dae, Limit
from slipfree.errors import ModelError
from slipfree.named import Array, Mask, leaves, unpack
from slipfree.solve.loop import Block, Loop, close
from slipfree.solve.sample import UNSOLVED, Samples, corrected, table
from slipfree.trajectory import Stop, Trajectory

LARGEST_STEP = 0.25  # of an unknown's typical size, in one Newton step
STEPS = 100
CONVERGED = 1e-13
SINGULAR = 1e-10  # smallest singular value of a block, relative to the largest


class UnsolvedError(ModelError):
    """Equations were not solved; ``z`` is where Newton's method ended."""

    def __init__(self, message: str, z: Array) -> None:
        super().__init__(message)
        self.z = z


def settle(
    dae: Dae[Any, Any, Any, Any, Any], *, guess: Mapping[str, float] | None = None, **start: float
) -> Trajectory:
    """Return the vehicle standing at rest at a place, as a trajectory of one sample.

    Parameters
    ----------
    dae : Dae
        The model.
    guess : mapping of str to float, optional
        First guesses for what the ground decides, by name, such as ``{"z": 2.0}``; the model has
        its own for the rest. [m, rad]
    **start : float
        Differential states by name, such as ``x``, ``y``, ``heading``; others are zero. [m, rad]

    Raises
    ------
    ModelError
        If a name is unknown, the vehicle cannot stand there, a limit is violated, or a motion is
        left undetermined.
    """
    x = dae.start(**start)
    loop = close(dae, unpack(dae.u, [0.0] * len(list(leaves(dae.u)))), 0)
    z = consistent(loop, 0.0, x, first_guess(dae, x, guess or {}), loop.u[:, 0])
    samples = Samples(np.zeros(1), x[:, None], z[:, None], np.zeros((dae.quad.numel(), 1)), loop.u)
    samples, report = corrected(loop, samples)
    run = table(loop, samples, report)
    fault = first_violation(loop, run, samples)
    if fault is not None:
        raise ModelError(f"the start is not valid: {fault[1].words}")
    return run


def first_guess(dae: Dae[Any, Any, Any, Any, Any], x: Array, given: Mapping[str, float]) -> Array:
    """Return a first guess of ``z``, local, with what is given by name in map coordinates."""
    z = np.array(ca.Function("guess", [dae.columns()[0]], [dae.guess])(x)).ravel()
    names = [label.full for label in leaves(dae.labels.z)]
    for name, value in given.items():
        if name not in names:
            raise ModelError(f"guess: {name!r} is not known; known: {', '.join(names)}")
        index = names.index(name)
        z[index] = value - dae.shift[1][index]
    return z


def consistent(loop: Loop, t: float, x: Array, z: Array, u: Array) -> Array:
    """Return ``z`` that satisfies all algebraic equations at ``t``, ``x`` and ``u``.

    Block by block: a block that is linear in its unknowns is solved at once, another by damped
    Newton steps of limited size, since far from the ground the closure is strongly curved.

    Raises
    ------
    ModelError
        If Newton's method does not converge or a Jacobian is singular; it names the equation that
        misses most, or the motion that no contact determines.
    """
    z = z.copy()
    for block in loop.blocks:
        if block.linear:
            z[block.span] = 0.0
            z[block.span] -= _solve(loop, block, (t, x, z, u, block.stages[-1]), check=True)
            continue
        for easing in block.stages:
            z = _newton(loop, block, (t, x, z, u, easing))
    return z


def _newton(loop: Loop, block: Block, point: tuple[float, Array, Array, Array, float]) -> Array:
    t, x, z, u, easing = point
    scale = loop.dae.scale[block.span]

    def size(z: Array) -> float:
        return float(np.linalg.norm(np.array(block.residual(t, x, z, u, easing))))

    first, now = z, size(z)
    for _ in range(STEPS):
        if now < CONVERGED:
            break
        step = _solve(loop, block, (t, x, z, u, easing), check=False)
        damping = min(1.0, LARGEST_STEP / max(float(np.abs(step / scale).max()), 1e-300))
        for _ in range(12):
            trial = z.copy()
            trial[block.span] -= damping * step
            new = size(trial)
            if new < now or not now > 0:
                break
            damping /= 2
        else:
            break  # no descent: rounding, or a dead end
        z, now = trial, new
    if not now < 1e3 * CONVERGED:
        raise UnsolvedError(_unsettled(loop, block, (t, x, z, u, easing), first), z)
    _solve(loop, block, (t, x, z, u, easing), check=True)
    return z


def _solve(loop: Loop, block: Block, point: tuple[Any, ...], *, check: bool) -> Array:
    residual = np.array(block.residual(*point)).ravel()
    jacobian = np.array(block.jacobian(*point))
    if not np.isfinite(jacobian).all() or not np.isfinite(residual).all():
        return np.full(residual.shape, np.nan)
    if check:
        _, values, right = np.linalg.svd(jacobian)
        if values[-1] < SINGULAR * values[0]:
            labels = list(leaves(loop.dae.labels.z))[block.span]
            weakest = labels[int(np.abs(right[-1]).argmax())]
            raise ModelError(
                f"the model is singular here: nothing determines {weakest.full} ({weakest.words}), "
                f"singular value {values[-1]:.1e} of {values[0]:.1e}"
            )
    return np.asarray(np.linalg.lstsq(jacobian, residual, rcond=1e-12)[0])


def _unsettled(loop: Loop, block: Block, point: tuple[Any, ...], first: Array) -> str:
    _, x, z, u, _ = point
    if len(block.stages) > 1:  # what took easing may have no solution, for reasons the model knows
        for limit in loop.dae.limits:
            if limit.describe is not None:
                words = limit.describe(x, z)
                if words:
                    return f"the vehicle cannot stand at the start: {words}"
    residual = np.nan_to_num(np.abs(np.array(block.residual(*point)).ravel()), nan=np.inf)
    worst = block.labels[int(residual.argmax())]
    message = (
        f"the vehicle cannot stand at the start: {worst.full}, the {worst.words}, misses by "
        f"{residual.max():.2g} {worst.unit}"
    )
    for state in (first, z):
        samples = Samples(np.zeros(1), x[:, None], state[:, None], np.zeros((0, 1)), u[:, None])
        words = _violated(loop, samples)
        if words:
            return f"{message}; {words}"
    return message


def _violated(loop: Loop, samples: Samples) -> str:
    _, values, _ = loop.outputs(samples.t, samples.x, samples.z, samples.u)
    for limit, value in zip(loop.dae.limits, np.array(values).ravel(), strict=True):
        if not limit.lower <= value <= limit.upper:
            return limit_words(limit.label.words, value, limit.lower, limit.upper, limit.label.unit)
    return ""


def limit_words(words: str, value: float, lower: float, upper: float, unit: str) -> str:
    """Return the sentence that says which limit was left and by how much."""
    if np.isfinite(lower) and np.isfinite(upper):
        allowed = f"{lower:g} to {upper:g}"
    else:
        allowed = f"at least {lower:g}" if np.isfinite(lower) else f"at most {upper:g}"
    unit = "" if unit == "1" else f" {unit.replace('m-1', '1/m')}"
    return f"{words}: {round(value, 6) + 0.0:.4g}, allowed {allowed}{unit}"


def _said(limit: Limit, value: float, x: Array, z: Array) -> str:
    if limit.describe is not None and (words := limit.describe(x, z)):
        return words
    label = limit.label
    return limit_words(label.words, value, limit.lower, limit.upper, label.unit)


def first_violation(loop: Loop, run: Trajectory, samples: Samples) -> tuple[int, Stop] | None:
    """Return the first sample that breaks a limit or fails a check, and the stop it means."""
    found: tuple[int, Stop] | None = None

    def consider(bad: Mask, name: str, words: Any) -> None:
        nonlocal found
        if bad.any() and (found is None or int(bad.argmax()) < found[0]):
            k = int(bad.argmax())
            found = k, Stop(name, float(run.t[k]), words(k))

    for limit in loop.dae.limits:
        label, lower, upper = limit.label, limit.lower, limit.upper
        values = run.of(label)
        consider(
            ~((values >= lower) & (values <= upper)),
            label.full,
            lambda k, v=values, of=limit: _said(of, float(v[k]), samples.x[:, k], samples.z[:, k]),
        )
    for block in (*loop.blocks, *loop.after):
        if not block.linear or block in loop.after:
            label = run.columns[f"{block.labels[0].name}_residual"].label
            values = run.of(label)
            consider(
                ~(values <= UNSOLVED),
                label.name,
                lambda k, v=values, lb=label: (
                    f"the equations have no exact solution here: {lb.name} {v[k]:.1e} {lb.unit}, "
                    f"allowed at most {UNSOLVED:g}; a smaller tolerance may help"
                ),
            )
    for check in loop.dae.checks:
        label = check.label
        values = run.of(label)
        consider(
            ~(values >= 0),
            label.full,
            lambda k, c=check: c.describe(samples.x[:, k], samples.z[:, k]),
        )
    return found
