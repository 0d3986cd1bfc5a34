"""A consistent start: the pose in which a vehicle stands on the ground."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from slipfree.dae import Dae, Limit
from slipfree.errors import ModelError
from slipfree.forks import computing
from slipfree.records import Array, Mask, leaves, unpack
from slipfree.solve.initial_conditions import consistent, limit_words
from slipfree.solve.sampling import UNSOLVED_RESIDUAL, Samples, correct_samples, to_trajectory
from slipfree.solve.system import System, with_inputs
from slipfree.trajectory import Stop, Trajectory


@computing
def settle(dae: Dae, *, guess: Mapping[str, float] | None = None, **start: float) -> Trajectory:
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
    loop = with_inputs(dae, unpack(dae.u, [0.0] * len(list(leaves(dae.u)))), 0)
    z = consistent(loop, 0.0, x, first_guess(dae, x, guess or {}), loop.u[:, 0])
    samples = Samples(np.zeros(1), x[:, None], z[:, None], np.zeros((dae.quad.numel(), 1)), loop.u)
    samples, report = correct_samples(loop, samples)
    run = to_trajectory(loop, samples, report)
    fault = first_violation(loop, run, samples)
    if fault is not None:
        raise ModelError(f"the start is not valid: {fault[1].words}")
    return run


def first_guess(dae: Dae, x: Array, given: Mapping[str, float]) -> Array:
    """Return an initial guess of ``z``, local, from values by name in map coordinates."""
    z = np.array(dae.function("guess", [dae.columns()[0]], [dae.guess])(x)).ravel()
    names = [label.full for label in leaves(dae.labels.z)]
    for name, value in given.items():
        if name not in names:
            raise ModelError(f"guess: {name!r} is not known; known: {', '.join(names)}")
        index = names.index(name)
        z[index] = value - dae.shift[1][index]
    return z


def _said(limit: Limit, value: float, x: Array, z: Array) -> str:
    if limit.describe is not None and (words := limit.describe(x, z)):
        return words
    label = limit.label
    return limit_words(label.words, value, limit.lower, limit.upper, label.unit)


def first_violation(
    loop: System, run: Trajectory, samples: Samples, unsolved: float = UNSOLVED_RESIDUAL
) -> tuple[int, Stop] | None:
    """Return the first sample that breaks a limit or fails a check, and the stop it means.

    ``unsolved`` is the residual, without unit, of the motion's equations from which on they count
    as not solved.
    """
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
            most = UNSOLVED_RESIDUAL if block in loop.after else unsolved
            values, most = run.of(label), most * loop.dae.size_of(block.labels[0])
            consider(
                ~(values <= most),
                label.name,
                lambda k, v=values, lb=label, most=most: (
                    f"the equations have no exact solution here: {lb.name} {v[k]:.1e} {lb.unit}, "
                    f"allowed at most {most:g}; a smaller tolerance may help"
                ),
            )
    for check in loop.dae.checks:
        label = check.label
        values = run.of(label)
        consider(
            ~(values >= 0),
            label.full,
            lambda k, c=check, v=values: (
                f"{c.label.full}: no value could be computed"
                if np.isnan(v[k])
                else c.describe(samples.x[:, k], samples.z[:, k])
            ),
        )
    return found
