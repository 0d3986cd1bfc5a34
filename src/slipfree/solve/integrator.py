"""Integrate with IDAS or CVODES, through CasADi: jumps, failures, steps, reuse of integrators."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr
from io import StringIO
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.lookups import evaluate, run_buffered
from slipfree.core.records import Array
from slipfree.core.trajectory import NO_START, SolverError, sundials_words
from slipfree.solve.sampling import Samples, integrate_samples, join_samples
from slipfree.solve.system import Method, System, scaled_jacobian, solve_initial_conditions
from slipfree.system.interrupt import InterruptGuard, check_interrupt

ARGUMENTS, RESULTS = ("x0", "z0", "u"), ("xf", "zf", "qf")  # names of CasADi
COUNTS = {"steps": "nsteps", "residuals": "nfevals", "set_ups": "nlinsetups"}
LIMIT_TOLERANCE = 1e-6  # violation of a limit at which a step ends the call [unit or scale]
MAX_STEPS = 10_000  # maximum number of steps of the integrator between two samples
NEWTON_SHARE = 0.01  # fraction of a step's allowed error at which CVODES ends Newton's method
MAX_RESTARTS = 20  # maximum number of restarts after failures, per interval of the inputs
PACE_TIMES = 9  # times in a motion whose inputs bound its pace
MAX_COVERED = 2.0  # a step that covers more causes a repetition [allowed distances]
ROUNDING = 1e-13  # smaller relative changes of an input are not jumps; a step is longer than this
STALLED_STEPS = 100  # number of successive steps without progress at which a call ends
MAX_IDLE = 64  # integrators kept for later calls; inputs that jump use one for each interval
Progress = Callable[[float], bool | None]


class MotionSolver(NamedTuple):
    """Model, interrupt guard, and options of an integrator, which is reused for equal options."""

    system: System
    guard: InterruptGuard
    tolerance: float
    method: Method
    watch: ca.Function  # of the system; see ``make_watch``
    late: ca.Function | None  # the same with all rates, to sample those that ``watch`` leaves out
    suppress_algebraic: bool  # whether IDAS's error test ignores the unknowns


class LimitError(Exception):
    """End of an integration by a step beyond a limit of the model."""


class ProgressError(Exception):
    """End of an integration by the progress callable."""


EarlyEnd = SolverError | LimitError | ProgressError


def integrate(
    solver: MotionSolver, observer: StepObserver, first: Samples, t: Array, u: Array
) -> tuple[Samples, dict[str, float], EarlyEnd | None]:
    """Integrate over all intervals between jumps of the inputs.

    Returns the samples reached, the counts of the integrator, and the reason of an early end or
    None.
    """
    parts, counts, left = [first], dict.fromkeys(COUNTS, 0.0), 0
    # where an input is discontinuous; a change of its slope is not
    n = solver.system.dae.columns()[2].numel()
    base, rise = u[:n], u[n:] if len(u) > n else np.zeros_like(u)
    terms = [base[:, 1:], -base[:, :-1], rise[:, 1:] * t[1:-1], -rise[:, :-1] * t[1:-1]]
    jumps = np.abs(np.sum(terms, axis=0)) > ROUNDING * np.abs(terms).sum(axis=0)
    for right in (*(1 + np.flatnonzero(jumps.any(axis=0))).tolist(), t.size - 1):
        at = parts[-1].at([-1])
        if not np.array_equal(at.u[:, -1], u[:, left]):
            # after a jump, the unknowns that the new inputs require; else the integrator fails
            starts = (
                _make_consistent(solver.system, at, u[:, left], continuation=each)
                for each in (False, True)
            )
            at = next(filter(None, starts), at)
        span, inputs = t[left : right + 1], u[:, left:right]
        part, cost, end = _integrate_between_jumps(solver, observer, at, span, inputs)
        # A restart from the last step before a failure uses a small step and a new Jacobian, and
        # often succeeds. The motion ends if a restart makes no progress.
        restarts = MAX_RESTARTS * (1 + int((np.diff(inputs, axis=1) != 0).any(axis=0).sum()))
        while isinstance(end, SolverError) and restarts and part.t.size > 1:
            restarts -= 1
            rest = np.append(part.t[-1], span[span > part.t[-1]])
            later = inputs[:, 1 - rest.size :]
            start = _make_consistent(solver.system, part.at([-1]), later[:, 0], continuation=False)
            if start is None:
                break
            more, further, next_end = _integrate_between_jumps(solver, observer, start, rest, later)
            cost = add_counts(cost, further)
            if more.t.size == 1:
                break
            part, end = join_samples([part, more]), next_end
            part = part.at(np.isin(part.t, [*span, part.t[-1]]))
        parts.append(part)
        counts, left = add_counts(counts, cost), right
        if end is not None:
            break
    return join_samples(parts), counts, end


def _integrate_between_jumps(
    solver: MotionSolver, observer: StepObserver, at: Samples, t: Array, u: Array
) -> tuple[Samples, dict[str, float], EarlyEnd | None]:
    """Integrate over ``t``, where no input jumps, and keep the part before a failure or stop.

    CasADi returns no results of a call that ends early. The call is therefore repeated up to the
    last step that it reached and, if the integrator fails again, up to earlier steps.
    """
    observer.times.clear()
    observer.paces.clear()
    try:
        return *_call_integrator(solver, observer, at, t, u), None
    except (SolverError, LimitError, ProgressError) as error:
        end = error
    seen, left_out = sorted({each for each in observer.times if each > t[0]}), 1
    while seen:
        span = np.append(t[t < seen[-1]], seen[-1])
        try:
            return *_call_integrator(
                solver, StepObserver(solver.guard), at, span, u[:, : span.size - 1]
            ), end
        except SolverError:
            # The number of steps to leave out is doubled, so that few calls are needed.
            seen, left_out = seen[:-left_out], 2 * left_out
    return at, dict.fromkeys(COUNTS, 0.0), end


def _call_integrator(
    solver: MotionSolver, observer: StepObserver, at: Samples, t: Array, u: Array
) -> tuple[Samples, dict[str, float]]:
    """Integrate over all of ``t``, where no input jumps, by one call.

    IDAS may fail to compute a consistent start if the given start already is consistent to rounding
    accuracy. Newton's method then computes the start, and IDAS skips its own computation.

    Steps are bounded by the pace that the start has under later inputs. If the motion becomes
    faster and a step covers too large a distance, the call is repeated with the largest pace.
    """
    system, given, pace = solver.system, dict[str, Any](), 0.0
    if not system.dae.pace.is_zero():  # the largest pace of the start under later inputs
        times = np.linspace(t[0], t[-1], PACE_TIMES)
        later = u[:, np.searchsorted(t[1:-1], times, side="right")]
        m = at.z[: system.motion_size, 0]
        pace = float(np.array(solver.watch(times[None], at.x[:, 0], m, later)[2]).max())
    x_size, m_size = (size[:, None] for size in motion_scales(system))
    columns = np.column_stack([u[:, :1], u])  # that of an interval at the time that it ends
    while True:
        arguments = at.x / x_size, at.z[: system.motion_size] / m_size, columns
        first = len(observer.times)
        try:
            with suppress_messages(), _integrator(solver, observer, t, given, pace) as integrator:
                arrays = [np.empty((t.size, integrator.size1_out(name))) for name in RESULTS]
                sources = dict(zip(map(integrator.index_in, ARGUMENTS), arguments, strict=True))
                targets = dict(zip(map(integrator.index_out, RESULTS), arrays, strict=True))
                statistics = run_buffered(integrator, sources, targets).stats()
            faster = observer.pace_of_long_steps(first)
            if not faster:
                break
            pace = faster
        except RuntimeError as error:
            solver.guard.check()
            words, start = sundials_words(str(error)), None
            if NO_START in words and not given:
                start = _make_consistent(system, at, u[:, 0], continuation=False)
            if start is None:
                raise SolverError(words) from error
            at, m = start, start.z[: system.motion_size]
            rates = np.array(system.core(at.t, at.x, m, at.u)[0]) / x_size
            given = {"calc_ic": False, "init_xdot": rates.ravel().tolist()}
    solver.guard.check()
    x, found, q = (each.T for each in arrays)
    x = x * x_size
    z = np.full((len(at.z), t.size), np.nan)
    z[: len(found)] = found * m_size
    # Scaling and the consistent start of IDAS change the first sample: restore it.
    x[:, :1], z[:, :1] = at.x, at.z
    if solver.late is not None:
        where = t[None], x, z[: len(found)], columns
        every, own = (evaluate(f, *where)[0] for f in (solver.late, solver.watch))
        q[: len(own)] += integrate_samples(t, every - own)
    counts = {name: float(statistics[key]) for name, key in COUNTS.items()}
    inputs = np.column_stack([u, u[:, -1:]])
    return Samples(t, x, z, q[: at.q.shape[0]] + at.q, inputs), counts


def _make_consistent(
    system: System, at: Samples, u: Array, *, continuation: bool
) -> Samples | None:
    """Return the sample with inputs ``u`` and their unknowns; None without a solution."""
    try:
        z = solve_initial_conditions(
            system, float(at.t[0]), at.x[:, 0], at.z[:, 0], u, continuation=continuation
        )
    except ModelError:
        return None
    return at._replace(z=z[:, None], u=u[:, None])


def add_counts(counts: dict[str, float], more: dict[str, float]) -> dict[str, float]:
    """Return the sums of the counts of two calls of the integrator."""
    return {name: counts[name] + more[name] for name in counts}


def integrate_held(
    solver: MotionSolver,
    observer: StepObserver,
    first: Samples,
    t: Array,
    u: Array,
    law: ca.Function,
) -> tuple[Samples, dict[str, float], EarlyEnd | None]:
    """Integrate over intervals with the inputs of a law at their beginnings, as `integrate`.

    ``u`` are the numeric inputs of the intervals. CVODES restarts at every sample.
    """
    system, n = solver.system, t.size
    integrator = _period_integrator(system, float(t[-1] - t[0]) / (n - 1), solver.tolerance)
    symbols = law.mx_in()
    values = law(*symbols)
    watched = system.watch(*symbols[:2], ca.MX(0, 1), values)
    sample = ca.Function("sample", symbols, [values, watched[1]])  # inputs, distance to a limit
    names = [integrator.index_in("x0"), integrator.index_in("p")]
    results = [integrator.index_out("xf"), integrator.index_out("qf")]
    x, q = np.zeros((n, first.x.size)), np.zeros((n, first.q.size))
    x[0], q[0] = first.x[:, 0], first.q[:, 0]
    held, margin, counts = np.zeros((n, len(u))), np.empty(1), dict.fromkeys(COUNTS, 0.0)
    end: EarlyEnd | None = None
    for last in range(n):
        numbers = u[:, min(last, n - 2)]
        sources = {0: t[last : last + 1], 1: x[last], 2: numbers}
        run_buffered(sample, sources, {0: held[last], 1: margin})
        if last == n - 1:
            break
        try:
            observer.observe(float(t[last]), float(margin[0]), 0.0)
            sources = dict(zip(names, (x[last], np.append(held[last], t[last])), strict=True))
            targets = dict(zip(results, (x[last + 1], q[last + 1]), strict=True))
            with suppress_messages():
                buffer = run_buffered(integrator, sources, targets)
        except (LimitError, ProgressError) as error:
            end = error
            break
        except RuntimeError as error:
            solver.guard.check()
            end = SolverError(sundials_words(str(error)))
            break
        solver.guard.check()
        q[last + 1] += q[last]
        statistics = buffer.stats()
        counts = {name: counts[name] + statistics[key] for name, key in COUNTS.items()}
    samples = Samples(t, x.T, np.zeros((0, n)), q.T, held.T).at(slice(last + 1))
    return samples, counts, end


def _period_integrator(system: System, period: float, tolerance: float) -> ca.Function:
    """Return the integrator over one period; parameters are inputs and start time."""
    t, x = ca.MX.sym("t"), ca.MX.sym("x", system.dae.ode.numel())
    p, none = ca.MX.sym("p", system.u.shape[0] + 1), ca.MX.sym("none", 0)
    at, u, jacobian = (p[-1] + t, x, none), p[:-1], system.jacobian
    ode, quad = system.core(*at, u)[0], system.watch(*at, u)[0]
    names = jacobian.name_in(), jacobian.name_out()
    slopes = ca.Function(
        "jacF", [t, x, none, p, ca.MX.sym("u", 0)], list(jacobian(*at, none, u)), *names
    )
    equations: dict[str, Any] = {"t": t, "x": x, "p": p, "ode": ode, "quad": quad}
    options = sundials_options(tolerance, slopes) | {"quad_err_con": True}
    return ca.integrator("period", "cvodes", equations, 0.0, period, options)


@contextmanager
def _integrator(
    solver: MotionSolver, observer: StepObserver, t: Array, given: dict[str, Any], pace: float
) -> Iterator[ca.Function]:
    """Yield the integrator over ``t``, for states and unknowns divided by their sizes.

    Steps last at most one over the pace, unless it is zero. Integrators are reused, since the
    construction of one takes as long as a short motion, and deleted with the functions of their
    model, without which no call can find them. Only one call at a time uses an integrator.
    """
    system = solver.system
    key = *solver[2:], t.tobytes(), str(given), pace
    with _LOCK:
        idle = _IDLE.get(system.core, {}).pop(key, None)
    if idle is None:
        relay = _Relay()
        idle = relay, _new_integrator(solver, relay, t, given, pace)
    relay, integrator = idle
    relay.observer = observer
    yield integrator
    relay.observer = None
    with _LOCK:
        own = _IDLE.pop(system.core, {})
        own[key] = idle
        _IDLE[system.core] = own  # last
        for model, kept in list(_IDLE.items()):
            while kept and count_idle() > MAX_IDLE:
                del kept[next(iter(kept))]
            if not kept:
                del _IDLE[model]


def count_idle() -> int:
    """Return the number of integrators kept for later calls."""
    return sum(len(kept) for kept in list(_IDLE.values()))


_LOCK = threading.Lock()
_IDLE: WeakKeyDictionary[ca.Function, dict[tuple[Any, ...], tuple[_Relay, ca.Function]]]
_IDLE = WeakKeyDictionary()  # by ``core``, least recently used first


def _new_integrator(
    solver: MotionSolver, relay: _Relay, t: Array, given: dict[str, Any], pace: float
) -> ca.Function:
    """Return the integrator of a motion in scaled states and unknowns."""
    system = solver.system
    x_size, m_size = motion_scales(system)
    counts = [x_size.size, m_size.size, system.u.shape[0]]
    symbols = [ca.MX.sym("t"), *(ca.MX.sym(name, n) for name, n in zip("xzu", counts, strict=True))]
    t_0, x, m, u = symbols
    point = [t_0, x * ca.DM(x_size), m * ca.DM(m_size), u]
    ode, alg = system.core(*point)
    quad, *observed = solver.watch(*point)
    quad = ca.vertcat(quad, relay(ca.vertcat(t_0, *observed)))
    problem = dict(zip("txzu", symbols, strict=True))
    problem |= {"ode": ode / ca.DM(x_size), "alg": alg, "quad": quad}
    jacobian = scaled_jacobian(system.jacobian, x_size, m_size)
    options = sundials_options(solver.tolerance, jacobian)
    if solver.method == "idas":
        options |= {"suppress_algebraic": solver.suppress_algebraic, **given}
    else:
        # CVODES infers the error of Newton's method from an earlier rate of convergence, and mostly
        # ends it after one iteration. With an old Jacobian, CVODES's default share of 0.1 then
        # leaves errors of many tolerances, which its error test misses.
        options |= {"quad_err_con": True, "nonlin_conv_coeff": NEWTON_SHARE}
    if pace > 0:
        options["max_step_size"] = 1 / pace
    return ca.integrator("motion", solver.method, problem, float(t[0]), t, options)


def sundials_options(tolerance: float, jacobian: ca.Function) -> dict[str, Any]:
    """Return the options of an integrator that do not depend on the method."""
    return {
        "reltol": tolerance,
        "abstol": tolerance,
        "max_num_steps": MAX_STEPS,
        "show_eval_warnings": False,
        "disable_internal_warnings": True,
        "cache": {"jacF": jacobian},
    }


def motion_scales(system: System) -> tuple[Array, Array]:
    """Return the sizes of the states and of the motion's unknowns."""
    return system.dae.sizes.x, system.dae.sizes.z[: system.motion_size]


@contextmanager
def suppress_messages() -> Iterator[None]:
    """Suppress messages of SUNDIALS and tracebacks, whose text the exceptions contain."""
    hook, sys.excepthook = sys.excepthook, lambda *_: None
    try:
        with redirect_stderr(StringIO()):
            yield
    finally:
        sys.excepthook = hook


class StepObserver:
    """Observer of the steps of an integrator.

    The observer records the times of the steps and calls ``progress`` with each [s]. It ends the
    integration

    * if ``progress`` returns False,
    * if ``guarded``: at a step beyond a limit,
    * if ``polled``: at a Ctrl-C that `held_interrupt` held back,
    * after `STALLED_STEPS` steps that do not advance, of which CVODES would take `MAX_STEPS`.

    The ``guard`` keeps exceptions of ``progress`` while SUNDIALS runs.
    """

    def __init__(
        self,
        guard: InterruptGuard,
        progress: Progress | None = None,
        *,
        guarded: bool = False,
        polled: bool = False,
    ) -> None:
        self.guard, self.progress, self.guarded, self.polled = guard, progress, guarded, polled
        self.times: list[float] = []
        self.paces: list[float] = []
        self.reported = -np.inf
        self.stalled = 0

    def pace_of_long_steps(self, first: int) -> float:
        """Return the largest pace if a step covers twice the allowed distance or more, else zero.

        ``first`` is the index of the first observation. Steps that were rejected do not count.
        """
        steps = list[tuple[float, float]]()
        for step in zip(self.times[first:], self.paces[first:], strict=True):
            while steps and steps[-1][0] >= step[0]:
                steps.pop()
            steps.append(step)
        t, paces = np.array(steps).reshape(-1, 2).T
        covered = np.diff(t) * np.maximum(paces[1:], paces[:-1])
        return float(np.nanmax(paces)) if (covered >= MAX_COVERED).any() else 0.0

    def observe(self, t: float, margin: float, pace: float) -> None:
        """Record an accepted step; raise an error if the motion has to end there.

        A step has a time, the least distance to a limit, and the pace.
        """
        advances = not self.times or abs(t - self.times[-1]) > ROUNDING * abs(t)
        self.stalled = 0 if advances else self.stalled + 1
        self.times.append(t)
        self.paces.append(pace)
        if self.stalled > STALLED_STEPS:
            raise SolverError("steps have become shorter than the rounding of the time")
        if self.progress is not None and t > self.reported:
            self.reported = t
            answer = self.progress(t)
            if isinstance(answer, bool | np.bool_) and not answer:
                raise ProgressError
        if self.polled:
            check_interrupt()
        if self.guarded and not margin >= -LIMIT_TOLERANCE:
            raise LimitError


class _Relay(ca.Callback):
    """Quadrature that is identically zero and calls the present observer of an integrator.

    Both integrators evaluate quadratures once per step, outside Newton's method. Zero passes every
    error test, so that the motion does not change. The relay must exist as long as the integrator.
    """

    def __init__(self) -> None:
        ca.Callback.__init__(self)
        self.observer: StepObserver | None = None
        self.construct("observer", {})

    def get_sparsity_in(self, _index: int) -> ca.Sparsity:
        """Return the shape of the argument: time, least distance to a limit, and pace."""
        return ca.Sparsity.dense(3, 1)

    def has_eval_buffer(self) -> bool:
        """Return True: arguments are passed as memory buffers, which is five times as fast."""
        return True

    def eval_buffer(self, arguments: Sequence[memoryview], results: Sequence[memoryview]) -> int:
        """Observe a step of the integrator; return zero, CasADi's code for success."""
        if (observer := self.observer) is not None:
            observer.guard.call(observer.observe, *arguments[0].cast("b").cast("d"))
        results[0].cast("b").cast("d")[0] = 0.0
        return 0
