"""Integrate a DAE with IDAS or CVODES of SUNDIALS, through CasADi, until it ends, and say why.

A motion ends early by violated limits, events and failures of the solver. Under a sampled
controller, the outputs of which are constant between samples, CVODES restarts at each of them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.batch.evaluator import evaluator_of
from slipfree.batch.many import assemble_state
from slipfree.batch.motion import ORDER, RELAXING_ORDER, integrate_lanes
from slipfree.core.arguments import checked
from slipfree.core.dae import LIMIT_ROUNDING, Dae, PiecewiseLinear, invalid_start
from slipfree.core.errors import ModelError
from slipfree.core.lookups import evaluate
from slipfree.core.records import Array, Mask, Record, leaves, with_overview
from slipfree.core.trajectory import Column, Outcome, SolverError, Stop, Trajectory, joined
from slipfree.solve.integrator import (
    COUNTS,
    EarlyEnd,
    LimitError,
    MotionSolver,
    Progress,
    ProgressError,
    StepObserver,
    add_counts,
    integrate,
    integrate_held,
)
from slipfree.solve.sampling import (
    UNSOLVED_RESIDUAL,
    Samples,
    correct_samples,
    join_samples,
    to_trajectory,
)
from slipfree.solve.system import (
    SolverOptions,
    System,
    UnsolvedError,
    check_symbols,
    solve_initial_conditions,
    with_held_inputs,
    with_inputs,
)
from slipfree.system.forks import computing
from slipfree.system.interrupt import InterruptGuard

FIRST_STEP = 0.5  # length of the steps of the first try [size of the vehicle]
SAFETY, MIN_RATIO = 0.8, 0.02  # of the step that an estimated error suggests; of two steps
MAX_TRIES = 12


def integrate_explicitly(
    system: System, inputs: Record, first: Samples, t: Array, options: SolverOptions
) -> tuple[Samples, dict[str, float]]:
    """Return the samples that a motion reaches, and counts of the integrator.

    The whole motion is repeated with smaller steps until the estimated error of ``x`` and ``y`` at
    its end is below the tolerance, times the size of the vehicle. Quadratures that depend on forces
    are integrated from the samples by the trapezoidal rule. Beyond a limit there are no samples.
    ModelError is raised if the batch does not take the model or an input, or the tolerance is not
    reached.
    """
    dae = system.dae
    for label, value in zip(leaves(dae.labels.u), leaves(inputs), strict=True):
        if isinstance(value, ca.SX | PiecewiseLinear):
            raise ModelError(
                f"input {label.full}: expected numbers for the method 'explicit', found "
                f"{type(value).__name__}; give a value for each interval, or use the method 'idas'"
            )
    evaluator = evaluator_of(dae, compiled=options.compiled)
    state = assemble_state(evaluator.graphs, first.x[:, 0], first.z[:, 0], first.q[:, 0])
    order = ORDER if dae.lag is None else RELAXING_ORDER
    step, wanted = FIRST_STEP * dae.size, options.tolerance * dae.size
    total, inputs_of_lane = 0, system.u[..., None]
    for _ in range(MAX_TRIES):
        run = integrate_lanes(evaluator, state[:, None], inputs_of_lane, t, step, certify=False)
        total += int(run.steps[0])
        error = float(np.hypot(*run.errors[list(evaluator.graphs.places[:2]), 0]))
        if error <= wanted or np.isnan(error):  # NaN: the first interval is not solved
            break
        step *= float(np.clip(SAFETY * (wanted / error) ** (1 / order), MIN_RATIO, SAFETY))
    else:
        raise ModelError(
            f"method: 'explicit' did not reach the tolerance {options.tolerance:g} in {MAX_TRIES} "
            f"refinements, the last with steps of {step:.2g} m; use a larger tolerance, or 'idas'"
        )
    counts = {"steps": float(run.steps[0]), "residuals": 9.0 * total, "set_ups": 0.0}
    states = run.samples[..., 0]
    count = int(np.isfinite(states[:, 0]).sum())
    if count < 2:  # no interval to integrate over
        return first, counts
    graphs, t, columns = evaluator.graphs, t[:count], states[:count].T
    rows, u = graphs.rows, np.append(system.u, system.u[:, -1:], axis=1)[:, :count]
    z = np.concatenate([np.arange(len(columns))[part] for part in rows.z])
    motion = z[: system.motion_size]

    def rates(t: Array, columns: Array, u: Array) -> Array:
        return evaluate(system.watch, t[None], columns[rows.x], columns[motion], u)[0]

    before = columns[:, 1:].copy()  # with the inputs of the interval that ends at a sample
    before[rows.u] = u[:, :-1]
    before[rows.w] = evaluator(graphs.motion, before)[graphs.motion.parts[2]]
    mean = (rates(t[:-1], columns[:, :-1], u[:, :-1]) + rates(t[1:], before, u[:, :-1])) / 2
    q = first.q + np.cumsum(np.append(0 * first.q, np.diff(t) * mean, axis=1), axis=1)
    q[list(graphs.quadratures)] = columns[rows.q]
    return Samples(t, columns[rows.x], columns[z], q, u), counts


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
        if _jump(system, t, x, z, u, continuation=False) >= MIN_JUMP:
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
    # After a tenth of the prediction time, a jump is as large as after the whole time; continuous
    # changes are smaller.
    sooner = x + SHARE * (soon - x)
    may_last = violation is None and jump[k] >= MIN_LASTING_JUMP
    lasts = may_last and _jump(system, t, sooner, z, u) >= jump[k] / 2
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


def _jump(
    system: System, t: float, x: Array, z: Array, u: Array, *, continuation: bool = True
) -> float:
    """Return the largest change to a solution, in typical sizes; NaN if Newton's method fails."""
    try:
        solution = solve_initial_conditions(system, t, x, z, u, continuation=continuation)
    except ModelError:
        return np.nan  # nothing to compare with
    return float(_change(system, z, solution).max())


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
        check_symbols(f"event {name!r}", dae, expression, symbols)
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


SUBINTERVALS = 64  # parts of an interval with a crossing, in each refinement
CROSSING_TOLERANCE = 1e-6  # width of the final bracket of a crossing [s]
RESIDUAL_FACTOR = 100.0  # residual allowed at samples of models with a continuation [tolerance]
CHUNK_SIZE = 2000  # samples checked together, to bound the memory


@checked
@computing
def simulate(
    model: Dae,
    start: Trajectory,
    inputs: Record,
    t: Array,
    *,
    options: SolverOptions = SolverOptions(),
    events: Sequence[Event] = (),
    progress: Progress | None = None,
    sampled: bool = False,
    sampled_work: bool | None = False,
    states_only: bool = False,
) -> Trajectory:
    """Integrate the motion from a start under given inputs.

    Each call of the integrator covers the time between two jumps of the inputs. At every sample the
    algebraic unknowns are then corrected by Newton's method, and the limits and checks of the model
    are evaluated. The motion ends at the first violation, whose time is located between samples.

    Parameters
    ----------
    model : Dae
        The model.
    start : Trajectory
        Trajectory whose last sample is the start; the time of this sample is ignored.
    inputs : record
        From ``model.inputs(...)``: constants, one value for each interval, or expressions of the
        model's symbols. The integrator restarts at every jump of an input, but not where
        only the slope of an input changes.
    t : ndarray, shape (n,)
        Ascending times of the samples. [s]
    options : SolverOptions
        Tolerance and method of the integrator, and whether to compile the equations.
    events : sequence of Event, optional
        Zero crossings to locate. A crossing is detected by a change of sign between two samples,
        so that an even number of crossings between them is missed. Its time is located to the
        accuracy of the integration, by about three short integrations. An expression that is zero
        at the start, within the tolerance, has no crossing there.
    progress : callable, optional
        Called with the time reached, in ascending order, about once per step. If it returns False,
        the motion ends with the stop ``"interrupted"``. Exceptions of the callable are raised.
    sampled : bool
        Whether inputs are constant between samples, as those of a sampled controller: expressions
        of time, states and inputs that are numbers are evaluated at evenly spaced samples, where
        CVODES restarts. For models without algebraic unknowns. With periods of 10 and 20 ms, the
        motion of a dynamic model takes 3 to 40 times as long as with continuous inputs.
    sampled_work : bool or None
        Whether the work of drives whose forces follow from the motion is integrated from its power
        at the samples, by cubic polynomials. A motion with rigid wheels then takes half of the
        time. The error falls with the fourth power of the time between samples, but is not
        controlled: use it for dense samples. With None, this work is not computed, and zero in
        the result.
    states_only : bool
        Whether IDAS's error test ignores the algebraic unknowns, which follow from the states at
        every sample. It then takes half to a fifth of the steps, but at equal tolerance the error
        of the states is up to 30 times larger: use it for tight tolerances.

    Returns
    -------
    Trajectory
        The motion. ``stop`` is the reason of an early end, or None; ``events`` contains the times
        of the events by name.

    Raises
    ------
    ModelError
        If times, method, events or inputs are invalid, or if the start has no solution or violates
        a limit under the inputs.
    SolverError
        If the integrator fails; ``trajectory`` is the motion up to the failure.

    Examples
    --------
    >>> import numpy as np
    >>> from slipfree import Analytic, catalog, direct_kinematics, settle, simulate
    >>> model = direct_kinematics(catalog.three_wheeler(), Analytic(lambda x, y: 0.02 * x * y))
    >>> inputs = model.inputs(right_rate=0.5, left_rate=0.4, steer_rate=0.0)
    >>> run = simulate(model, settle(model), inputs, np.linspace(0, 2, 41))
    >>> run
    Trajectory: 41 samples from 0 to 2 s; complete
      quantities: x, y, heading, tilt_right, tilt_left, steer, z, roll, pitch, contact_x, ...
      wheels: right, left, front
    >>> print(f"{run['y'][-1]:.4f} m, heading {run['heading'][-1]:.4f} rad")
    0.2703 m, heading 0.0300 rad
    """
    t = check_times(t)
    watched = watch_events(model, events)
    stops = tuple(each for each in watched if each.event.stop)
    with InterruptGuard() as guard:
        law: ca.Function | None = None
        if sampled:
            system, law = with_held_inputs(model, inputs, t, options)
        else:
            system = with_inputs(model, inputs, t.size - 1, options)
        watch = system.make_watch(sampled_work is False)
        late = system.watch if sampled_work and watch is not system.watch else None
        method = options.method or ("idas" if system.motion_size else "cvodes")
        if method == "cvodes" and system.motion_size:
            raise ModelError(
                f"method: 'cvodes' cannot solve for the {system.motion_size} algebraic unknowns of "
                "this model; use 'idas'"
            )
        method = "idas" if method == "explicit" else method  # for the location of ends
        ignored = model.suppress_algebraic or states_only
        solver = MotionSolver(system, guard, options.tolerance, method, watch, late, ignored)
        samples, counts = _initial_sample(system, start, t[0]), dict.fromkeys(COUNTS, 0.0)
        end: EarlyEnd | None = None
        clock = time.process_time()
        observer = StepObserver(guard, progress, guarded=True, polled=True)
        if options.method == "explicit":
            samples, counts = integrate_explicitly(system, inputs, samples, t, options)
        while (left := t > samples.t[-1]).any():
            # IDAS also integrates the interval of an explicit end, which it locates
            span = np.append(samples.t[-1], t[left])
            at, u = samples.at([-1]), system.u[:, 1 - span.size :]
            motion = solver, observer, at, span, u
            rest, cost, end = integrate(*motion) if law is None else integrate_held(*motion, law)
            counts, samples = add_counts(counts, cost), join_samples([samples, rest])
            whole, samples, found = _check_samples(solver, samples, stops)
            if not (isinstance(end, LimitError) and found is None and observer.guarded):
                break
            observer.guarded = False  # no sample violates the limit
        else:
            whole, samples, found = _check_samples(solver, samples, stops)
        run = whole
        if found is not None:
            if found.k == 0:
                raise invalid_start(found.stop.words)
            kept, tail = whole.part(slice(found.k)), _locate(solver, whole, samples, found, stops)
            is_later = tail.t[0] > kept.t[-1]
            run = joined(kept, tail) if is_later else replace(kept, stop=tail.stop)
        times = dict[str, Array]()
        for each in watched:
            name, stop = each.event.name, Stop(each.event.name, 0.0, "", Outcome.COMPLETE)
            if each.event.stop:
                times[name] = run.t[-1:] if run.stop and run.stop.name == name else run.t[:0]
                continue
            located = list[float]()
            for k in crossing_indices(each, system, samples, solver.tolerance):
                if whole.t[k - 1] < run.t[-1]:
                    crossing = _Crossing(k, stop, each)
                    tail = _locate(solver, whole, samples, crossing, [each], limited=False)
                    located.extend(tail.t)
            times[name] = np.array([at for at in located if at <= run.t[-1]])
        cost = {"tolerance": options.tolerance, "cpu_seconds": time.process_time() - clock}
        run = replace(run, statistics=counts | cost, events=times)
        t_end, failed = float(run.t[-1]), isinstance(end, SolverError) and found is None
        if failed or (run.stop and run.stop.name.endswith("_residual")):
            last = found.k if found else None
            why = diagnose_stop(system, samples, last)
            why = why or limit_at_failure(system, run, samples, last)
            if why is not None:
                return replace(run, stop=why._replace(t=t_end))
        if failed:
            words = f"the integrator stopped at t = {t_end:.6g} s: {end}"
            run = replace(run, stop=Stop("solver", t_end, str(end), Outcome.SOLVER_FAILURE))
            raise SolverError(words, run)
        is_ended = isinstance(end, ProgressError) and found is None
        return replace(run, stop=interrupted_at(t_end)) if is_ended else run


def simulate_to_failure(
    dae: Dae, start: Trajectory, inputs: Record, t: Array, options: SolverOptions, **how: Any
) -> Trajectory:
    """Simulate to the last time or to the first failure, which has samples before it.

    ``how`` are further options of `simulate`.
    """
    try:
        return simulate(dae, start, inputs, t, options=options, **how)
    except SolverError as error:
        if error.trajectory is None:
            raise
        return error.trajectory


def check_times(t: Array) -> Array:
    """Return the times as an array; raise ModelError unless they are finite and increase."""
    t = np.asarray(t, dtype=float)
    if t.ndim != 1 or t.size < 2:
        raise ModelError(
            f"t: expected a one-dimensional array of at least two times in seconds, found shape "
            f"{t.shape}; give the times of all samples"
        )
    wrong = ~np.isfinite(t) | np.append(False, ~(np.diff(t) > 0))
    if wrong.any():
        k = int(wrong.argmax())
        before = f" after {t[k - 1]:g} s" if k else ""
        raise ModelError(
            f"t: expected finite, increasing times in seconds, found t[{k}] = {t[k]:g} s{before}; "
            "correct or remove this time"
        )
    return t


def _initial_sample(system: System, start: Trajectory, t: float) -> Samples:
    """Return the last sample of a trajectory at time ``t``, with consistent unknowns."""
    x, z, q = (system.dae.rows(record, start, -1)[:, None] for record in "xzq")
    z = solve_initial_conditions(system, t, x[:, 0], z[:, 0], system.u[:, 0])[:, None]
    return Samples(np.array([t]), x, z, q, system.u[:, :1])


class _Crossing(NamedTuple):
    """Index of the first sample at or beyond a limit or an event, its stop, and the event."""

    k: int
    stop: Stop
    event: WatchedEvent | None


def _check_samples(
    solver: MotionSolver, samples: Samples, watched: Sequence[WatchedEvent], *, limited: bool = True
) -> tuple[Trajectory, Samples, _Crossing | None]:
    """Correct the samples, and find the first that violates a limit or lies beyond an event.

    Samples are processed in chunks; chunks after a violation are omitted. Results are stored in
    arrays for all samples, so that a million samples do not exist twice. With ``limited`` false,
    limits are not evaluated, which saves most of the time, and the trajectory has only times.
    """
    system, z, count = solver.system, np.empty_like(samples.z), samples.t.size
    run = Trajectory(samples.t, {})
    # Where all friction is used, states within the tolerance may have no exact equilibrium.
    unsolved = (
        max(UNSOLVED_RESIDUAL, RESIDUAL_FACTOR * solver.tolerance)
        if system.dae.continuation
        else UNSOLVED_RESIDUAL
    )
    found = list[_Crossing]()
    for left in range(0, count, CHUNK_SIZE):
        span = slice(left, left + CHUNK_SIZE)
        part, report = correct_samples(system, samples.at(span))
        z[:, span] = part.z
        if not limited:
            continue
        chunk = to_trajectory(system, part, report)
        if not run.columns:
            columns = {
                name: Column(label, np.empty((samples.t.size, *values.shape[1:])))
                for name, (label, values) in chunk.columns.items()
            }
            run = Trajectory(samples.t, columns, chunk.wheels, ground=chunk.ground)
        for name, column in chunk.columns.items():
            run[name][span] = column.values
        violation = first_violation(system, chunk, part, unsolved)
        if violation is not None:
            found.append(_Crossing(left + violation[0], violation[1], None))
            count = left + part.t.size
            break
    run, samples = run.part(slice(count)), samples._replace(z=z).at(slice(count))
    for each in watched:
        for k in crossing_indices(each, system, samples, solver.tolerance)[:1]:
            name = each.event.name
            words = f"the event {name!r} occurred"
            stop = Stop(name, float(run.t[k]), words, Outcome.COMPLETE)
            found.append(_Crossing(k, stop, each))
    return run, samples, min(found, key=lambda one: one.k, default=None)


def interrupted_at(t: float) -> Stop:
    """Return the stop of a motion that is interrupted at a time in s."""
    words = "Ctrl-C or the progress callable ended the integration"
    return Stop("interrupted", t, words, Outcome.INTERRUPTED)


def _locate(
    solver: MotionSolver,
    run: Trajectory,
    samples: Samples,
    found: _Crossing,
    watched: Sequence[WatchedEvent],
    *,
    limited: bool = True,
) -> Trajectory:
    """Locate the crossing of a limit or an event on successively finer samples.

    Returns one sample: for a limit the last valid sample, for an event the interpolated sample at
    the crossing.
    """
    k, stop, event = found
    while run.t[k] - run.t[k - 1] > CROSSING_TOLERANCE:
        t = np.linspace(run.t[k - 1], run.t[k], SUBINTERVALS + 1)
        u = np.repeat(samples.u[:, k - 1 : k], SUBINTERVALS, axis=1)
        refined, *_ = integrate(solver, StepObserver(solver.guard), samples.at([k - 1]), t, u)
        fine, finer, nearer = _check_samples(solver, refined, watched, limited=limited)
        if nearer is None or nearer.k == 0:  # the crossing is at one of the two samples
            past = nearer is not None
            if event is not None and nearer is None:
                last = event_values(event, solver.system, finer)[-1]
                past = last * event_values(event, solver.system, samples)[k] > 0
            if not past:
                run, k = fine, fine.t.size
            event = None
            break
        (k, stop, event), run, samples = nearer, fine, finer
    tail = run.part(slice(k - 1, k))
    if event is not None:
        before, after = event_values(event, solver.system, samples)[k - 1 : k + 1]
        share = before / (before - after)
        pairs = zip(samples.at([k - 1]), samples.at([k]), strict=True)
        at = Samples(*(one + share * (other - one) for one, other in pairs))
        at = at._replace(u=samples.u[:, [k - 1]])
        tail = _check_samples(solver, at, (), limited=limited)[0]
    return replace(tail, stop=stop._replace(t=float(tail.t[0])))
