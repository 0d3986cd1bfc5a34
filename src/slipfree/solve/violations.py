"""Find the first sample of a motion that violates a limit, a check or an equation."""

from __future__ import annotations

from typing import Any

import numpy as np

from slipfree.core.dae import LIMIT_ROUNDING, Limit
from slipfree.core.errors import ModelError
from slipfree.core.outcome import Outcome
from slipfree.core.records import Array, Mask
from slipfree.core.trajectory import Stop, Trajectory
from slipfree.solve.initial_conditions import limit_message
from slipfree.solve.sampling import UNSOLVED_RESIDUAL, Samples
from slipfree.solve.system import System

NEARLY_REACHED = 1e-3  # margin at a failure [largest margin of the motion]


def _limit_message(limit: Limit, value: float, x: Array, z: Array) -> str:
    if limit.describe is not None and (words := limit.describe(x, z)):
        return words
    label = limit.label
    return limit_message(label.words, value, limit.lower, limit.upper, label.unit)


def invalid_start(words: str) -> ModelError:
    """Return the error of a start that violates a limit, check or equation, from its message."""
    return ModelError(
        f"start: expected a sample within the limits of the model, found a violation: {words}; "
        "choose another start or other inputs"
    )


def first_violation(
    system: System, run: Trajectory, samples: Samples, unsolved: float = UNSOLVED_RESIDUAL
) -> tuple[int, Stop] | None:
    """Return the index of the first sample with a violation, and its stop; None without one.

    Violations are of limits, checks and equations. The equations of the motion are violated if
    their residual, without unit, exceeds ``unsolved``.
    """
    found: tuple[int, Stop] | None = None

    def consider(bad: Mask, name: str, words: Any, outcome: Outcome = Outcome.LIMIT) -> None:
        nonlocal found
        if bad.any() and (found is None or int(bad.argmax()) < found[0]):
            k = int(bad.argmax())
            found = k, Stop(name, float(run.t[k]), words(k), outcome)

    for limit in system.dae.limits:
        label = limit.label
        values = run.of(label)
        consider(
            limit.violated_by(values, system.dae.size_of(label)),
            label.full,
            lambda k, v=values, of=limit: _limit_message(
                of, float(v[k]), samples.x[:, k], samples.z[:, k]
            ),
            limit.outcome,
        )
    for block in (*system.blocks, *system.dependent_blocks):
        if not block.linear or block in system.dependent_blocks:
            label = run.columns[f"{block.labels[0].name}_residual"].label
            most = UNSOLVED_RESIDUAL if block in system.dependent_blocks else unsolved
            values, most = run.of(label), most * system.dae.size_of(block.labels[0])
            consider(
                ~(values <= most),
                label.name,
                lambda k, v=values, lb=label, most=most: (
                    f"no exact solution of the equations was found: {lb.name} {v[k]:.1e} "
                    f"{lb.unit}, allowed at most {most:g}; try a smaller tolerance of the solver"
                ),
                Outcome.SOLVER_FAILURE,
            )
    for check in system.dae.checks:
        label = check.label
        values = run.of(label)
        consider(
            ~(values >= 0),
            label.full,
            lambda k, c=check, v=values: (
                f"{c.label.full}: expected a margin of at least 0, found NaN, since its linear "
                "algebra failed"
                if np.isnan(v[k])
                else c.describe(samples.x[:, k], samples.z[:, k])
            ),
        )
    return found


def limit_at_failure(
    system: System, run: Trajectory, samples: Samples, violation: int | None
) -> Stop | None:
    """Return the stop at the limit that explains a failure of the solver; None without one.

    Equations may become singular at a limit: the contact of a wheel moves infinitely fast where the
    ground becomes as concave as the wheel, and a distribution of forces by loads fails where a
    wheel lifts off. The motion then ends shortly before the limit.

    Parameters
    ----------
    system : System
        The model under inputs.
    run : Trajectory
        The motion up to the failure.
    samples : Samples
        Samples that the integrator reached.
    violation : int or None
        Index of the sample that does not satisfy the equations; None if the integrator failed.
    """
    nearest, least = None, NEARLY_REACHED
    for limit in system.dae.limits:
        values = run.of(limit.label)
        margins = np.minimum(values - limit.lower, limit.upper - values)
        largest = margins.max()
        if largest <= LIMIT_ROUNDING * system.dae.size_of(limit.label):
            continue  # at rest at the limit
        if margins[-1] < least * largest and margins[-1] < margins[-2]:
            nearest, least = limit, margins[-1] / largest
    if nearest is None:
        return None
    value = float(run.of(nearest.label)[-1])
    k = -1 if violation is None else violation
    words = _limit_message(nearest, value, samples.x[:, k], samples.z[:, k])
    return Stop(nearest.label.full, float(run.t[-1]), words, nearest.outcome)
