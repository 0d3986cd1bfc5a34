"""Integration of a DAE with SUNDIALS, IDAS or CVODES, through CasADi."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import replace
from io import StringIO
from typing import Any, Literal, NamedTuple, get_args

import casadi as ca
import numpy as np

from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.forks import computing
from slipfree.interrupt import InterruptGuard
from slipfree.records import Array
from slipfree.solve.equations import scaled_jacobian
from slipfree.solve.events import Event, WatchedEvent, crossings_of, values_of, watch_events
from slipfree.solve.initial_conditions import consistent
from slipfree.solve.sampling import UNSOLVED_RESIDUAL, Samples, correct_samples, to_trajectory
from slipfree.solve.settle import first_violation
from slipfree.solve.stop_diagnosis import ending
from slipfree.solve.system import System, with_inputs
from slipfree.trajectory import SolverError, Stop, Trajectory, joined

COUNTS = {"steps": "nsteps", "residuals": "nfevals", "set_ups": "nlinsetups"}
REFINED = 64  # sub-intervals in which a crossing is sought at a time
CROSSING = 1e-6  # to which a crossing is bracketed [s]
FINEST = 1e-14  # tolerance below which rounding rules
LEEWAY = 100.0  # tolerances by which an eased model's equations may be missed at a sample
BEYOND = 1e-6  # of a limit's unit or size; what is nearer is left to the samples
STEPS = 10_000  # of the integrator between two samples
STARTS = 20  # anew after failures of the integrator, for each interval of the inputs
ROUNDING = 1e-13  # of an input's terms, up to which it does not jump
NO_START = "no consistent start was found"
CHUNK = 2000  # samples looked at together, for the sake of memory
Progress = Callable[[float], bool | None]
Method = Literal["idas", "cvodes"]


@computing
def simulate(
    dae: Dae,
    start: Trajectory,
    inputs: Any,
    t: Array,
    *,
    tolerance: float = 1e-8,
    method: Method | None = None,
    events: Sequence[Event] = (),
    progress: Progress | None = None,
) -> Trajectory:
    """Return the motion from a start under given inputs.

    The integrator takes one call from jump to jump of the inputs; at every sample the algebraic
    unknowns then get one Newton step, and the limits and checks of the model are looked at. The
    first violation ends the motion: the crossing is located between the samples and the rest is
    cut off.

    Parameters
    ----------
    dae : Dae
        The model.
    start : Trajectory
        Its last sample is where the motion starts, whatever its time.
    inputs : record
        From ``dae.inputs(...)``: constants, one value for each interval, or expressions of the
        model's symbols. The integrator restarts at every jump of an input, but not at kinks.
    t : ndarray, shape (n,)
        Ascending times of the samples. [s]
    tolerance : float
        Relative and absolute tolerance of the integrator; the absolute one of lengths is in sizes
        of the vehicle (``dae.size``). [size, rad]
    method : {"idas", "cvodes"}, optional
        CVODES by default where the motion has no algebraic unknowns, which it cannot solve for;
        its error test then includes the quadratures. IDAS otherwise.
    events : sequence of Event, optional
        Zero crossings to locate. A crossing is found by a change of sign between two samples, so
        an even number of crossings between them is missed; its time is then located to the
        accuracy of the integration, by three short integrations or so. An expression that is zero
        at the start, to the tolerance, has no sign there.
    progress : callable, optional
        Called with the time reached, ascending, once for each step or so. It does not change the
        motion, except that it ends there with the stop ``"interrupted"`` if the callable returns
        False. An exception of the callable comes through.

    Returns
    -------
    Trajectory
        ``stop`` says why it ended early, if it did; ``events`` has the times of the events.

    Raises
    ------
    ModelError
        If times, tolerance, method, events or inputs are not usable or the start is not valid
        under the inputs.
    SolverError
        If the integrator fails; ``trajectory`` holds what was reached.
    """
    t = usable_times(t)
    if not FINEST <= tolerance < 1:
        raise ModelError(
            f"tolerance: expected a number from {FINEST:g} to below 1, found {tolerance}"
        )
    watched = watch_events(dae, events)
    stops = tuple(each for each in watched if each.event.stop)
    with InterruptGuard() as guard:
        system = with_inputs(dae, inputs, t.size - 1)
        solver = _Solver(system, tolerance, _method(system, method), guard)
        first = _state(system, start, t[0])
        clock = time.process_time()
        spy = _Spy(guard, progress, guarded=True)
        samples, counts, end = _march(solver, spy, first, t, system.u)
        whole, samples, found = _looked_at(solver, samples, stops)
        left = t > samples.t[-1]
        if isinstance(end, _BeyondError) and found is None and left.any():
            spy.guarded = False  # a limit was only grazed: go on without looking
            rest = np.append(samples.t[-1], t[left])
            at, u = _column(samples, -1), system.u[:, 1 - rest.size :]
            more, cost, end = _march(solver, spy, at, rest, u)
            counts = _sum(counts, cost)
            whole, samples, found = _looked_at(solver, _chained([samples, more]), stops)
        run = whole if found is None else _cut(solver, whole, samples, found, stops)
        times = {each.event.name: _times(solver, whole, samples, each, run) for each in watched}
        statistics = {"tolerance": tolerance, "cpu_seconds": time.process_time() - clock}
        run = replace(run, statistics=counts | statistics, events=times)
        return _ended(system, run, samples, found, end)


def usable_times(t: Array) -> Array:
    """Return times as they are, or refuse what are no ascending times."""
    t = np.asarray(t, dtype=float)
    if t.ndim != 1 or t.size < 2 or not np.isfinite(t).all() or not (np.diff(t) > 0).all():
        raise ModelError(
            "t: expected two or more ascending times in seconds, found "
            f"{np.array2string(t, threshold=6)}"
        )
    return t


def _method(system: System, method: Method | None) -> Method:
    """Return how to integrate, or refuse what cannot be."""
    if method is None:
        return "idas" if system.moving else "cvodes"
    if method not in get_args(Method):
        raise ModelError(f"method: expected one of {', '.join(get_args(Method))}, found {method!r}")
    if method == "cvodes" and system.moving:
        raise ModelError(
            f"method: 'cvodes' cannot solve for the {system.moving} algebraic unknowns of this "
            "model; use 'idas'"
        )
    return method


def _state(system: System, start: Trajectory, t: float) -> Samples:
    """Return the last sample of a trajectory, made consistent with the inputs."""
    dae = system.dae
    x, z = dae.rows("x", start, -1), dae.rows("z", start, -1)
    z = consistent(system, t, x, z, system.u[:, 0])
    q = dae.rows("q", start, -1)
    return Samples(np.array([t]), x[:, None], z[:, None], q[:, None], system.u[:, :1])


class _Solver(NamedTuple):
    """How to integrate."""

    system: System
    tolerance: float
    method: Method
    guard: InterruptGuard


class _BeyondError(Exception):
    """A step of the integrator went beyond a limit of the model."""


class _RefusedError(Exception):
    """The progress callable ended the motion."""


End = SolverError | _BeyondError | _RefusedError


def _march(
    solver: _Solver, spy: _Spy, first: Samples, t: Array, u: Array
) -> tuple[Samples, dict[str, float], End | None]:
    """Integrate from jump to jump of the inputs.

    Returns the samples reached, what they cost, and why they end before the last time, if they do.
    """
    parts, counts, left = [first], dict.fromkeys(COUNTS, 0.0), 0
    for right in (*_jumps(solver.system, t, u), t.size - 1):
        at = _restarted(solver.system, parts[-1], u[:, left])
        span, inputs = t[left : right + 1], u[:, left:right]
        part, cost, end = _reached(solver, spy, at, span, inputs)
        if isinstance(end, SolverError):
            part, more, end = _continued(solver, spy, part, end, span, inputs)
            cost = _sum(cost, more)
        parts.append(part)
        counts, left = _sum(counts, cost), right
        if end is not None:
            break
    return _chained(parts), counts, end


def _jumps(system: System, t: Array, u: Array) -> list[int]:
    """Return the indices of the times at which an input jumps.

    The integrator passes a kink of inputs that are linear in time without a new start.
    """
    n = system.dae.columns()[2].numel()
    base, rise = u[:n], u[n:] if len(u) > n else np.zeros_like(u)
    times = t[1:-1]
    terms = np.array([base[:, 1:], -base[:, :-1], rise[:, 1:] * times, -rise[:, :-1] * times])
    jumps = np.abs(terms.sum(axis=0)) > ROUNDING * np.abs(terms).sum(axis=0)
    return (1 + np.flatnonzero(jumps.any(axis=0))).tolist()


def _continued(
    solver: _Solver, spy: _Spy, part: Samples, end: SolverError, t: Array, u: Array
) -> tuple[Samples, dict[str, float], End | None]:
    """Go on over ``t`` from the last step before a failure of the integrator, by new starts.

    A new start has a small step and a Jacobian of its own, with which it often passes. The motion
    ends where no new start gets on.
    """
    counts, last = dict.fromkeys(COUNTS, 0.0), end
    intervals = 1 + int((np.diff(u, axis=1) != 0).any(axis=0).sum())
    for _ in range(STARTS * intervals):
        rest = np.append(part.t[-1], t[t > part.t[-1]])
        left = u[:, 1 - rest.size :]
        at = _consistent(solver.system, _column(part, -1), left[:, 0], eased=False)
        if part.t.size == 1 or at is None:
            return part, counts, last
        more, cost, reason_of_end = _reached(solver, spy, at, rest, left)
        counts = _sum(counts, cost)
        if more.t.size == 1:
            return part, counts, last
        kept = np.isin(part.t, t)
        part = Samples(
            *(
                np.concatenate([before[..., kept], after[..., 1:]], axis=-1)
                for before, after in zip(part, more, strict=True)
            )
        )
        if not isinstance(reason_of_end, SolverError):
            return part, counts, reason_of_end
        last = reason_of_end
    return part, counts, last


def _reached(
    solver: _Solver, spy: _Spy, at: Samples, t: Array, u: Array
) -> tuple[Samples, dict[str, float], End | None]:
    """Integrate over ``t``; if that ends at a step before the last time, again up to that step.

    If the integrator fails there as well, up to one of the steps before, which are the fewer the
    more often it fails.
    """
    spy.times.clear()
    try:
        return *_solved(solver, spy, at, t, u), None
    except (SolverError, _BeyondError, _RefusedError) as error:
        end = error
    seen, left_out = sorted({each for each in spy.times if each > t[0]}), 1
    while seen:
        span = np.append(t[t < seen[-1]], seen[-1])
        try:
            return *_solved(solver, _Spy(solver.guard), at, span, u[:, : span.size - 1]), end
        except SolverError:
            seen, left_out = seen[:-left_out], 2 * left_out
    return at, dict.fromkeys(COUNTS, 0.0), end


def _solved(
    solver: _Solver, spy: _Spy, at: Samples, t: Array, u: Array
) -> tuple[Samples, dict[str, float]]:
    """Integrate over all of ``t``, where no input jumps, in one call, or raise.

    IDAS's own search may find no consistent start because the one given is consistent to rounding.
    Then that one is made so and taken.
    """
    system, given = solver.system, dict[str, Any]()
    x_size, m_size = (size[:, None] for size in _sizes(system))
    while True:
        integrator = _integrator(solver, spy, t, given)
        states = {"x0": at.x / x_size, "z0": at.z[: system.moving] / m_size}
        try:
            # one column for each output time, that of the interval which it ends
            with hushed():
                found = integrator(**states, u=np.column_stack([u[:, :1], u]))
            break
        except RuntimeError as error:
            solver.guard.check()
            words = reason(str(error))
            taken = None if given or NO_START not in words else _taken(system, at, u[:, 0])
            if taken is None:
                raise SolverError(words) from error
            at, given = taken
    solver.guard.check()
    x, z, q = (np.array(found[key]) for key in ("xf", "zf", "qf"))
    x, z = x * x_size, z * m_size
    z = np.concatenate([z, np.full((len(at.z) - len(z), t.size), np.nan)])
    x[:, :1], z[:, :1] = at.x, at.z
    statistics = integrator.stats()
    counts = {name: float(statistics[key]) for name, key in COUNTS.items()}
    inputs = np.column_stack([u, u[:, -1:]])
    return Samples(t, x, z, q[: at.q.shape[0]] + at.q, inputs), counts


def _taken(system: System, at: Samples, u: Array) -> tuple[Samples, dict[str, Any]] | None:
    """Return a start made consistent, and the options by which IDAS takes it, if it can be."""
    t, x = float(at.t[0]), at.x[:, 0]
    try:
        z = consistent(system, t, x, at.z[:, 0], u, eased=False)
    except ModelError:
        return None
    rates = np.array(system.core(t, x, z[: system.moving], u)[0]).ravel()
    slopes = rates / system.dae.sizes.x
    return at._replace(z=z[:, None]), {"calc_ic": False, "init_xdot": slopes.tolist()}


def _restarted(system: System, samples: Samples, u: Array) -> Samples:
    """Return the last sample, made consistent with the inputs that come if they jump there."""
    at = _column(samples, -1)
    if np.array_equal(at.u[:, -1], u):
        return at
    found = (_consistent(system, at, u, eased=eased) for eased in (False, True))
    return next((each for each in found if each is not None), at)  # else the integrator tells


def _consistent(system: System, at: Samples, u: Array, *, eased: bool) -> Samples | None:
    """Return a sample made consistent with inputs, None if it cannot be."""
    try:
        z = consistent(system, float(at.t[0]), at.x[:, 0], at.z[:, 0], u, eased=eased)
    except ModelError:
        return None
    return at._replace(z=z[:, None], u=u[:, None])


def _column(samples: Samples, k: int) -> Samples:
    """Return one sample."""
    return Samples(*(row[..., [k]] for row in samples))


def _chained(parts: Sequence[Samples]) -> Samples:
    """Return samples as one, of which each part goes on from the last sample of the one before."""
    rows = zip(*(part.head(-1) for part in parts[:-1]), parts[-1], strict=True)
    return Samples(*(np.concatenate(row, axis=-1) for row in rows))


def _sum(counts: dict[str, float], more: dict[str, float]) -> dict[str, float]:
    return {name: counts[name] + more[name] for name in counts}


class _Found(NamedTuple):
    """The first sample at or beyond a limit or an event, and the stop that it means."""

    k: int
    stop: Stop
    event: WatchedEvent | None


def _looked_at(
    solver: _Solver, samples: Samples, watched: Sequence[WatchedEvent], *, limited: bool = True
) -> tuple[Trajectory, Samples, _Found | None]:
    """Return the corrected samples, and the first that breaks a limit or lies beyond an event.

    Samples long after one that breaks a limit are left out. Without limits, which take most of the
    time, the trajectory has times only.
    """
    system, runs, parts = solver.system, list[Trajectory](), list[Samples]()
    # Where all friction is used, states within the tolerance may have no exact equilibrium.
    unsolved = (
        max(UNSOLVED_RESIDUAL, LEEWAY * solver.tolerance)
        if system.dae.continuation
        else UNSOLVED_RESIDUAL
    )
    found = list[_Found]()
    for left in range(0, samples.t.size, CHUNK):
        part = Samples(*(row[..., left : left + CHUNK] for row in samples))
        part, report = correct_samples(system, part)
        runs.append(to_trajectory(system, part, report) if limited else Trajectory(part.t, {}))
        parts.append(part)
        fault = first_violation(system, runs[-1], part, unsolved) if limited else None
        if fault is not None:
            found.append(_Found(left + fault[0], fault[1], None))
            break
    rows = zip(*parts, strict=True)
    run, samples = joined(*runs), Samples(*(np.concatenate(row, axis=-1) for row in rows))
    for each in watched:
        for k in crossings_of(each, system, samples, solver.tolerance)[:1]:
            name = each.event.name
            stop = Stop(name, float(run.t[k]), f"the event {name!r} occurred")
            found.append(_Found(k, stop, each))
    return run, samples, min(found, key=lambda one: one.k, default=None)


def _integrator(solver: _Solver, spy: _Spy, t: Array, given: dict[str, Any]) -> ca.Function:
    """Return the integrator over all of ``t``, of states and unknowns divided by their sizes."""
    system, dae = solver.system, solver.system.dae
    x_size, m_size = _sizes(system)
    counts = [x_size.size, m_size.size, system.u.shape[0]]
    symbols = [ca.MX.sym("t"), *(ca.MX.sym(name, n) for name, n in zip("xzu", counts, strict=True))]
    t_0, x, m, u = symbols
    point = [t_0, x * ca.DM(x_size), m * ca.DM(m_size), u]
    ode, alg = system.core(*point)
    quad = ca.vertcat(system.quad(*point), spy(ca.vertcat(t_0, system.margin(*point))))
    problem = dict(zip("txzu", symbols, strict=True))
    problem |= {"ode": ode / ca.DM(x_size), "alg": alg, "quad": quad}
    options: dict[str, Any] = {
        "reltol": solver.tolerance,
        "abstol": solver.tolerance,
        "max_num_steps": STEPS,
        "show_eval_warnings": False,
        "disable_internal_warnings": True,
    }
    if solver.method == "idas":
        options |= {"suppress_algebraic": dae.suppress_algebraic, **given}
        options |= {"cache": {"jacF": scaled_jacobian(system.jacobian, x_size, m_size)}}
    else:
        options["quad_err_con"] = True
    return ca.integrator("motion", solver.method, problem, float(t[0]), t, options)


def _sizes(system: System) -> tuple[Array, Array]:
    """Return the units in which the integrator has the states and the unknowns of the motion."""
    return system.dae.sizes.x, system.dae.sizes.z[: system.moving]


@contextmanager
def hushed() -> Iterator[None]:
    """Keep off the screen what an exception says anyway: SUNDIALS's words, the spy's traceback."""
    hook, sys.excepthook = sys.excepthook, lambda *_: None
    try:
        with redirect_stderr(StringIO()):
            yield
    finally:
        sys.excepthook = hook


def reason(message: str) -> str:
    """Return what the integrator said, out of CasADi's message, in words."""
    words = {
        "CV_CONV_FAILURE": "the equations of a step could not be solved",
        "CV_ERR_FAILURE": "the error test failed at the smallest step",
        "CV_TOO_MUCH_WORK": "too many steps between two samples",
        "CV_TOO_CLOSE": "the samples are too close for the digits of the time",
        "RHSFUNC": "the rates have no finite value",
        "IDA_CONV_FAIL": "the algebraic equations could not be solved",
        "IDA_ERR_FAIL": "the error test failed at the smallest step",
        "IDA_TOO_MUCH_WORK": "too many steps between two samples",
        "IDA_LSETUP_FAIL": "the Jacobian is singular",
        "IDA_LSOLVE_FAIL": "the Jacobian is singular",
        "IDA_REP_RES_ERR": "the equations have no finite value",
        "IDA_LINESEARCH_FAIL": NO_START,
        "IDA_NO_RECOVERY": NO_START,
        "IDA_ILL_INPUT": "the equations are not usable at the start",
    }
    for flag, meaning in words.items():
        if flag in message:
            return f"{meaning} ({flag})"
    return message.strip().splitlines()[-1]


class _Spy(ca.Callback):
    """A quadrature that is always zero and looks on: it remembers and reports the times of steps.

    It ends the call at a step beyond a limit, if it is guarded, or where the progress says so.
    Both integrators evaluate quadratures once a step, outside Newton's method, and zero passes
    every error test, so that looking on does not change the motion. It must live as long as the
    integrator.
    """

    def __init__(
        self, guard: InterruptGuard, progress: Progress | None = None, *, guarded: bool = False
    ) -> None:
        ca.Callback.__init__(self)
        self.guard, self.progress, self.guarded = guard, progress, guarded
        self.times: list[float] = []
        self.reported = -np.inf
        self.construct("spy", {})

    def get_sparsity_in(self, _index: int) -> ca.Sparsity:
        """Return the shape of the argument: time, and least distance to a limit."""
        return ca.Sparsity.dense(2, 1)

    def has_eval_buffer(self) -> bool:
        """Return that numbers come as they are in memory, which takes a fifth of the time."""
        return True

    def eval_buffer(self, arguments: Sequence[memoryview], results: Sequence[memoryview]) -> int:
        """Look at a step."""
        self.guard.call(self._look, *_doubles(arguments[0]))
        _doubles(results[0])[0] = 0.0
        return 0

    def _look(self, t: float, margin: float) -> None:
        self.times.append(t)
        if self.progress is not None and t > self.reported:
            self.reported = t
            answer = self.progress(t)
            if isinstance(answer, bool | np.bool_) and not answer:
                raise _RefusedError
        if self.guarded and not margin >= -BEYOND:
            raise _BeyondError


def _doubles(memory: memoryview) -> memoryview[float]:
    return memory.cast("b").cast("d")


def _cut(
    solver: _Solver,
    run: Trajectory,
    samples: Samples,
    found: _Found,
    stops: Sequence[WatchedEvent],
) -> Trajectory:
    """Return the motion up to the limit or event that ends it."""
    if found.k == 0:
        raise ModelError(f"the start is not valid: {found.stop.words}")
    kept, tail = run.part(slice(found.k)), _located(solver, run, samples, found, stops)
    return joined(kept, tail) if tail.t[0] > kept.t[-1] else replace(kept, stop=tail.stop)


def _ended(
    system: System, run: Trajectory, samples: Samples, found: _Found | None, end: End | None
) -> Trajectory:
    """Return the motion with the reason for its end, or raise that the integrator failed."""
    t, failed = float(run.t[-1]), isinstance(end, SolverError) and found is None
    if failed or (run.stop and run.stop.name.endswith("_residual")):
        why = ending(system, samples, found.k if found else None)
        if why is not None:
            return replace(run, stop=why._replace(t=t))
    if failed:
        words = f"the integrator stopped at t = {t:.6g} s: {end}"
        run = replace(run, stop=Stop("solver", t, words))
        raise SolverError(words, run)
    if isinstance(end, _RefusedError) and found is None:
        words = "the progress callable ended the motion by returning False"
        run = replace(run, stop=Stop("interrupted", t, words))
    return run


def _times(
    solver: _Solver,
    whole: Trajectory,
    samples: Samples,
    each: WatchedEvent,
    run: Trajectory,
) -> Array:
    """Return the times at which an event occurred in a motion, of which ``run`` is kept."""
    if each.event.stop:
        return run.t[-1:] if run.stop and run.stop.name == each.event.name else run.t[:0]
    stop, times = Stop(each.event.name, 0.0, ""), list[float]()
    for k in crossings_of(each, solver.system, samples, solver.tolerance):
        if whole.t[k - 1] < run.t[-1]:
            found = _Found(k, stop, each)
            times.extend(_located(solver, whole, samples, found, [each], limited=False).t)
    return np.array([each for each in times if each <= run.t[-1]])


def _located(
    solver: _Solver,
    run: Trajectory,
    samples: Samples,
    found: _Found,
    watched: Sequence[WatchedEvent],
    *,
    limited: bool = True,
) -> Trajectory:
    """Return the sample at which a limit or an event is reached, sought on ever finer samples.

    It is the last valid one at a limit, and between the last two at an event.
    """
    k, stop, event = found
    while run.t[k] - run.t[k - 1] > CROSSING:
        t = np.linspace(run.t[k - 1], run.t[k], REFINED + 1)
        u = np.repeat(samples.u[:, k - 1 : k], REFINED, axis=1)
        march, *_ = _march(solver, _Spy(solver.guard), _column(samples, k - 1), t, u)
        fine, finer, nearer = _looked_at(solver, march, watched, limited=limited)
        if nearer is None or nearer.k == 0:  # it lies on one of the two samples
            past = nearer is not None
            if event is not None and nearer is None:
                last = values_of(event, solver.system, finer)[-1]
                past = last * values_of(event, solver.system, samples)[k] > 0
            if not past:
                run, k = fine, fine.t.size
            event = None
            break
        (k, stop, event), run, samples = nearer, fine, finer
    tail = run.part(slice(k - 1, k))
    if event is not None:
        before, after = values_of(event, solver.system, samples)[k - 1 : k + 1]
        share = before / (before - after)
        pairs = zip(_column(samples, k - 1), _column(samples, k), strict=True)
        at = Samples(*(one + share * (other - one) for one, other in pairs))
        at = at._replace(u=samples.u[:, [k - 1]])
        tail = _looked_at(solver, at, (), limited=limited)[0]
    return replace(tail, stop=stop._replace(t=float(tail.t[0])))
