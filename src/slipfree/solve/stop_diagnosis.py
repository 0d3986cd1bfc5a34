"""Diagnose a stop of a quasi-static motion: no solution exists, or only one after a jump."""

from __future__ import annotations

import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.outcome import Outcome
from slipfree.core.records import Array, leaves
from slipfree.core.trajectory import Stop
from slipfree.solve.initial_conditions import UnsolvedError, solve_initial_conditions
from slipfree.solve.sampling import Samples
from slipfree.solve.system import System

PREDICTION_TIME = 1e-3  # time of prediction after the last sample of the integrator [s]
SHARE = 0.1  # fraction of the prediction time after which a small jump is tested again
MIN_JUMP = 0.05  # smallest jump of an unknown in the prediction time [its typical size]
MIN_LASTING_JUMP = 5e-3  # the same, if at least half of the jump occurs in the fraction `SHARE`


def diagnose_stop(system: System, samples: Samples, violation: int | None) -> Stop | None:
    """Return the stop explained by the equations of the model; None if they do not explain it.

    Parameters
    ----------
    system : System
        The model under inputs.
    samples : Samples
        Samples that the integrator reached.
    violation : int or None
        Index of the sample that does not satisfy the equations. If None, the states shortly after
        the last sample are predicted and tested.
    """
    if system.dae.continuation is None:
        return None
    k = -1 if violation is None else violation
    t, x, z, u = float(samples.t[k]), samples.x[:, k], samples.z[:, k], samples.u[:, k]
    soon = x
    if violation is None:
        if not _is_solved(system, t, x, z, u):
            return None  # the integrator failed at its start after a jump of the inputs
        rates = np.array(system.core(t, x, z[: system.motion_size], u)[0]).ravel()
        soon = x + PREDICTION_TIME * rates
    try:
        found = solve_initial_conditions(system, t, soon, z, u)
    except ModelError as error:
        reached = error.z if isinstance(error, UnsolvedError) else z  # z if a block is singular
        for limit in system.dae.limits:
            words = limit.describe(soon, reached) if limit.describe else ""
            if words:
                return Stop(limit.label.full, t, words, limit.outcome)
        return None
    jump = _change(system, z, found)
    k = int(jump.argmax())
    sooner = x + SHARE * (soon - x)
    lasts = violation is None and _jump_persists(system, t, sooner, z, u, least=float(jump[k]) / 2)
    if jump[k] < MIN_JUMP and not lasts:
        return None
    label = list(leaves(system.dae.labels.z))[k]
    unit = "" if label.unit == "1" else f" {label.unit}"
    return Stop(
        "fold",
        t,
        "the motion that friction allows ends in a fold: it can continue only with a jump, for "
        f"example of {label.full} from {z[k]:.3g} to {found[k]:.3g}{unit}, which depends on "
        "inertia",
        Outcome.NO_EQUILIBRIUM,
    )


def _is_solved(system: System, t: float, x: Array, z: Array, u: Array) -> bool:
    """Return whether a sample solves the equations; also True if Newton's method fails."""
    try:
        found = solve_initial_conditions(system, t, x, z, u, continuation=False)
    except ModelError:
        return True  # nothing to compare with
    return bool(_change(system, z, found).max() < MIN_JUMP)


def _jump_persists(system: System, t: float, x: Array, z: Array, u: Array, *, least: float) -> bool:
    """Return whether an unknown jumps by at least ``least`` typical sizes at the states ``x``.

    The states ``x`` are reached after a tenth of the prediction time. A jump is then as large as
    after the whole time; continuous changes are smaller. A change below `MIN_LASTING_JUMP` is not
    a jump.
    """
    if 2 * least < MIN_LASTING_JUMP:
        return False
    try:
        found = solve_initial_conditions(system, t, x, z, u)
    except ModelError:
        return False
    return bool(_change(system, z, found).max() >= least)


def _change(system: System, z: Array, found: Array) -> Array:
    """Return the absolute changes of the motion's unknowns, divided by their typical sizes."""
    return np.asarray(np.abs((found - z) / system.dae.scale)[: system.motion_size])
