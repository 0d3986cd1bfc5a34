"""Why a motion whose start takes a continuation stops: no solution, or one a jump away."""

from __future__ import annotations

import numpy as np

from slipfree.errors import ModelError
from slipfree.records import Array, leaves
from slipfree.solve.initial_conditions import UnsolvedError, consistent
from slipfree.solve.sampling import Samples
from slipfree.solve.system import System
from slipfree.trajectory import Stop

SOON = 1e-3  # after the last sample that an integrator reached [s]
JUMP = 0.05  # change of an unknown, in its typical size, that no motion makes in that time


def ending(loop: System, samples: Samples, fault: int | None) -> Stop | None:
    """Return why a motion ends, if the model's equations say so.

    Parameters
    ----------
    loop : System
        The model under inputs.
    samples : Samples
        What the integrator reached.
    fault : int or None
        The sample at which the equations do not hold, looked at first; else what comes soon after
        the last one.
    """
    if loop.dae.continuation is None:
        return None
    k = -1 if fault is None else fault
    t, x, z, u = float(samples.t[k]), samples.x[:, k], samples.z[:, k], samples.u[:, k]
    if fault is None:
        if not _is_solved(loop, t, x, z, u):
            return None  # the inputs jump there: what the integrator failed at is its start
        x = x + SOON * np.array(loop.core(t, x, z[: loop.moving], u)[0]).ravel()
    try:
        found = consistent(loop, t, x, z, u)
    except ModelError as error:
        reached = error.z if isinstance(error, UnsolvedError) else z  # else they are singular
        for limit in loop.dae.limits:
            words = limit.describe(x, reached) if limit.describe else ""
            if words:
                return Stop(limit.label.full, t, words)
        return None
    jump = np.abs((found - z) / loop.dae.scale)[: loop.moving]
    k = int(jump.argmax())
    if jump[k] < JUMP:
        return None
    label = list(leaves(loop.dae.labels.z))[k]
    unit = "" if label.unit == "1" else f" {label.unit}"
    return Stop(
        "fold",
        t,
        "the motion that friction allows ends in a fold: it would go on with a jump, such as "
        f"{label.full} from {z[k]:.3g} to {found[k]:.3g}{unit}, which inertia decides",
    )


def _is_solved(loop: System, t: float, x: Array, z: Array, u: Array) -> bool:
    """Return whether the unknowns of a sample are those that its states and inputs lead to."""
    try:
        found = consistent(loop, t, x, z, u, eased=False)
    except ModelError:
        return True  # nothing to compare with
    return bool(np.abs((found - z) / loop.dae.scale)[: loop.moving].max() < JUMP)
