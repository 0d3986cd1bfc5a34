"""Why a motion ends: violated limits, events, failures of the solver."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.dae import LIMIT_ROUNDING, Dae, invalid_start
from slipfree.core.errors import ModelError
from slipfree.core.evaluation import evaluate
from slipfree.core.lookups import found_column
from slipfree.core.outcome import Outcome
from slipfree.core.records import Array, Mask, leaves, with_overview
from slipfree.core.trajectory import Stop, Trajectory
from slipfree.solve.initial_conditions import UnsolvedError, solve_initial_conditions
from slipfree.solve.sampling import UNSOLVED_RESIDUAL, Samples, correct_samples, to_trajectory
from slipfree.solve.system import System

NEARLY_REACHED = 1e-3  # margin at a failure [largest margin of the motion]
PREDICTION_TIME = 1e-3  # time of prediction after the last sample of the integrator [s]
SHARE = 0.1  # fraction of the prediction time after which a small jump is tested again
MIN_JUMP = 0.05  # smallest jump of an unknown in the prediction time [its typical size]
MIN_LASTING_JUMP = 5e-3  # the same, if at least half of the jump occurs in the fraction `SHARE`


def consistent_start(system: System, x: Array, z: Array) -> Trajectory:
    """Return one sample at states and at unknowns solved from a guess.

    ModelError is raised if the equations have no solution there, or a limit is violated.
    """
    u = system.u[:, :1]
    z = solve_initial_conditions(system, 0.0, x, z, u[:, 0])
    still = np.zeros((system.dae.quad.numel(), 1))
    found, report = correct_samples(system, Samples(np.zeros(1), x[:, None], z[:, None], still, u))
    run = to_trajectory(system, found, report)
    violation = first_violation(system, run, found)
    if violation is not None:
        raise invalid_start(violation[1].words)
    return run


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
            lambda k, v=values, of=limit: of.message(float(v[k]), samples.x[:, k], samples.z[:, k]),
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
    wheel lifts off. The motion then ends shortly before the limit. ``violation`` is the index of
    the sample that does not satisfy the equations, or None if the integrator failed.
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
    words = nearest.message(value, samples.x[:, k], samples.z[:, k])
    return Stop(nearest.label.full, float(run.t[-1]), words, nearest.outcome)


def diagnose_stop(system: System, samples: Samples, violation: int | None) -> Stop | None:
    """Return the stop explained by the equations of the model; None if they do not explain it.

    ``violation`` is the index of the sample that does not satisfy the equations. If it is None, the
    states shortly after the last sample are predicted and tested.
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
        solution = solve_initial_conditions(system, t, soon, z, u)
    except ModelError as error:
        reached = error.z if isinstance(error, UnsolvedError) else z  # z if a block is singular
        for limit in system.dae.limits:
            words = limit.describe(soon, reached) if limit.describe else ""
            if words:
                return Stop(limit.label.full, t, words, limit.outcome)
        return None
    jump = _change(system, z, solution)
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
        f"example of {label.full} from {z[k]:.3g} to {solution[k]:.3g}{unit}, which depends on "
        "inertia",
        Outcome.NO_EQUILIBRIUM,
    )


def _is_solved(system: System, t: float, x: Array, z: Array, u: Array) -> bool:
    """Return whether a sample solves the equations; also True if Newton's method fails."""
    try:
        solution = solve_initial_conditions(system, t, x, z, u, continuation=False)
    except ModelError:
        return True  # nothing to compare with
    return bool(_change(system, z, solution).max() < MIN_JUMP)


def _jump_persists(system: System, t: float, x: Array, z: Array, u: Array, *, least: float) -> bool:
    """Return whether an unknown jumps by at least ``least`` typical sizes at the states ``x``.

    The states ``x`` are reached after a tenth of the prediction time. A jump is then as large as
    after the whole time; continuous changes are smaller. A change below `MIN_LASTING_JUMP` is not
    a jump.
    """
    if 2 * least < MIN_LASTING_JUMP:
        return False
    try:
        solution = solve_initial_conditions(system, t, x, z, u)
    except ModelError:
        return False
    return bool(_change(system, z, solution).max() >= least)


def _change(system: System, z: Array, found: Array) -> Array:
    """Return the absolute changes of the motion's unknowns, divided by their typical sizes."""
    return np.asarray(np.abs((found - z) / system.dae.scale)[: system.motion_size])


@with_overview
class Event(NamedTuple):
    """A zero crossing of an expression along a motion, in either direction.

    Attributes
    ----------
    expression : SX, shape (1, 1)
        Expression in the symbols of the model; positions in it are local
        (:ref:`local-and-map-coordinates`).
    stop : bool
        Whether the motion ends at the first crossing, with a stop called ``name``.
    name : str
        Key of the times in `Trajectory.events`.
    """

    expression: ca.SX
    stop: bool = False
    name: str = "event"


class WatchedEvent(NamedTuple):
    """An event, and its expression as a function of ``t, x, z`` and the values of the inputs."""

    event: Event
    function: ca.Function


def watch_events(dae: Dae, events: Sequence[Event]) -> tuple[WatchedEvent, ...]:
    """Return the events with their expressions as functions.

    Raises ModelError if a name is used by two events or by a limit of the model, or an expression
    is not a scalar in the symbols of the model.
    """
    symbols, watched = (dae.t, *dae.columns()), list[WatchedEvent]()
    names = {limit.label.full for limit in dae.limits}
    for event in events:
        name, expression = event.name, event.expression
        if name in names:
            raise ModelError(
                f"events: expected a different name for each event and limit, found {name!r} "
                "twice; rename the event"
            )
        names.add(name)
        if not isinstance(expression, ca.SX) or expression.shape != (1, 1):
            raise ModelError(
                f"event {name!r}: expected a scalar SX, found {expression!r}; use one expression "
                "in the symbols of the model"
            )
        (expression,) = dae.without_continuation([expression])
        known = [*symbols, found_column(dae.lookups)]
        if free := ca.Function("event", known, [expression], {"allow_free": True}).free_sx():
            raise ModelError(
                f"event {name!r}: expected symbols of the model, found {free[0]}; use "
                "the symbols of its Dae"
            )
        watched.append(
            WatchedEvent(event, dae.function("event", symbols, [ca.densify(expression)]))
        )
    return tuple(watched)


def event_values(watched: WatchedEvent, system: System, samples: Samples) -> Array:
    """Return the values of an event's expression, shape (n,), at samples."""
    at = samples.t[None], samples.x, samples.z
    inputs = evaluate(system.outputs, *at, samples.u)[2]
    (values,) = evaluate(watched.function, *at, inputs)
    return values.reshape(-1)


def crossing_indices(
    watched: WatchedEvent, system: System, samples: Samples, tolerance: float
) -> list[int]:
    """Return the indices of the first samples at or after the zero crossings of an event.

    A first value within the tolerance of zero counts as zero and begins no crossing.
    """
    values = event_values(watched, system, samples)
    if abs(values[0]) <= tolerance:
        values[0] = 0.0
    before, after = values[:-1], values[1:]
    crossed = ((before < 0) & (after >= 0)) | ((before > 0) & (after <= 0))
    return [int(k) + 1 for k in np.flatnonzero(crossed)]
