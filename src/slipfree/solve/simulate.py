"""Integrate a DAE with IDAS or CVODES of SUNDIALS, through CasADi."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.dae import Dae, invalid_start
from slipfree.core.errors import ModelError
from slipfree.core.outcome import Outcome
from slipfree.core.records import Array, Record
from slipfree.core.trajectory import Column, SolverError, Stop, Trajectory, joined
from slipfree.solve.explicit import integrate_explicitly
from slipfree.solve.initial_conditions import solve_initial_conditions
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
)
from slipfree.solve.options import Method, SolverOptions
from slipfree.solve.sampling import (
    UNSOLVED_RESIDUAL,
    Samples,
    correct_samples,
    join_samples,
    to_trajectory,
)
from slipfree.solve.stops import (
    Event,
    WatchedEvent,
    crossing_indices,
    diagnose_stop,
    event_values,
    first_violation,
    limit_at_failure,
    watch_events,
)
from slipfree.solve.system import System, with_inputs
from slipfree.system.forks import computing
from slipfree.system.interrupt import InterruptGuard

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
    sampled_work: bool = False,
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
    sampled_work : bool
        Whether the work of drives whose forces follow from the motion is integrated from its power
        at the samples, by cubic polynomials. A motion with rigid wheels then takes half of the
        time. The error falls with the fourth power of the time between samples, but is not
        controlled: use it for dense samples.

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
        system = with_inputs(model, inputs, t.size - 1, options)
        watch = system.motion_watch if sampled_work else system.watch
        method = _method(system, options.method)
        solver = MotionSolver(system, options.tolerance, method, guard, watch)
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
            rest, cost, end = integrate(solver, observer, at, span, u)
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


def _method(system: System, method: Method | None) -> Method:
    if method is None:
        return "idas" if system.motion_size else "cvodes"
    if method == "explicit":  # for the location of ends
        return "idas"
    if method == "cvodes" and system.motion_size:
        raise ModelError(
            f"method: 'cvodes' cannot solve for the {system.motion_size} algebraic unknowns of "
            "this model; use 'idas'"
        )
    return method


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
        run = run if run.columns else _unfilled(chunk, samples.t)
        for name, column in chunk.columns.items():
            run[name][span] = column.values
        violation = first_violation(system, chunk, part, unsolved)
        if violation is not None:
            found.append(_Crossing(left + violation[0], violation[1], None))
            count = left + part.t.size
            break
    run, samples = run.part(slice(count)), samples._replace(z=z).head(count)
    for each in watched:
        for k in crossing_indices(each, system, samples, solver.tolerance)[:1]:
            name = each.event.name
            words = f"the event {name!r} occurred"
            stop = Stop(name, float(run.t[k]), words, Outcome.COMPLETE)
            found.append(_Crossing(k, stop, each))
    return run, samples, min(found, key=lambda one: one.k, default=None)


def _unfilled(chunk: Trajectory, t: Array) -> Trajectory:
    """Return a trajectory with the quantities of a chunk and uninitialised values at all times."""
    columns = {
        name: Column(label, np.empty((t.size, *values.shape[1:])))
        for name, (label, values) in chunk.columns.items()
    }
    return Trajectory(t, columns, chunk.wheels, ground=chunk.ground)


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
