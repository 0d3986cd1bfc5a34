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
from slipfree.solve.initial_conditions import consistent
from slipfree.solve.sampling import UNSOLVED, Samples, corrected, table
from slipfree.solve.settle import first_violation
from slipfree.solve.stop_diagnosis import ending
from slipfree.solve.system import System, with_inputs
from slipfree.trajectory import SolverError, Stop, Trajectory, joined

COUNTS = {"steps": "nsteps", "residuals": "nfevals", "set_ups": "nlinsetups"}
REFINED = 64  # sub-intervals in which a crossing is sought at a time
CROSSING = 1e-6  # to which a crossing is located [s]
FINEST = 1e-14  # tolerance below which rounding rules
LEEWAY = 100.0  # tolerances by which an eased model's equations may be missed at a sample
BEYOND = 1e-6  # of a limit's unit or size; what is nearer is left to the samples
STEPS = 10_000  # of the integrator between two samples
NO_START = "no consistent start was found"
CHUNK = 2000  # samples looked at together, for the sake of memory
Progress = Callable[[float], None]
Method = Literal["idas", "cvodes"]


@computing
def simulate(
    dae: Dae[Any, Any, Any, Any, Any],
    start: Trajectory,
    inputs: Any,
    t: Array,
    *,
    tolerance: float = 1e-8,
    method: Method | None = None,
    progress: Progress | None = None,
) -> Trajectory:
    """Return the motion from a start under given inputs.

    The integrator takes one call; at every sample the algebraic unknowns then get one Newton step,
    and the limits and checks of the model are looked at. The first violation ends the motion: the
    crossing is located between the samples and the rest is cut off.

    Parameters
    ----------
    dae : Dae
        The model.
    start : Trajectory
        Its last sample is where the motion starts, whatever its time.
    inputs : record
        From ``dae.inputs(...)``: constants, one value for each interval, or expressions of the
        model's symbols. Every jump of an input restarts the integrator; smooth ones are cheaper.
    t : ndarray, shape (n,)
        Ascending times of the samples. [s]
    tolerance : float
        Relative and absolute tolerance of the integrator; the absolute one of lengths is in sizes
        of the vehicle (``dae.size``). [size, rad]
    method : {"idas", "cvodes"}, optional
        CVODES by default where the motion has no algebraic unknowns, which it cannot solve for;
        its error test then includes the quadratures. IDAS otherwise.
    progress : callable, optional
        Called with the time reached, once for each step or so. It does not change the motion.

    Returns
    -------
    Trajectory
        ``stop`` says why it ended early, if it did.

    Raises
    ------
    ModelError
        If times, tolerance, method or inputs are not usable or the start is not valid under the
        inputs.
    SolverError
        If the integrator fails; ``trajectory`` holds what was reached.
    """
    with InterruptGuard() as heed:
        return _simulated(dae, start, inputs, t, tolerance, method, progress, heed)


def _simulated(
    dae: Dae[Any, Any, Any, Any, Any],
    start: Trajectory,
    inputs: Any,
    t: Array,
    tolerance: float,
    method: Method | None,
    progress: Progress | None,
    heed: InterruptGuard,
) -> Trajectory:
    """Return the motion, what gets lost of interruptions kept."""
    t = usable_times(t)
    if not FINEST <= tolerance < 1:
        raise ModelError(
            f"tolerance: expected a number from {FINEST:g} to below 1, found {tolerance}"
        )
    loop = with_inputs(dae, inputs, t.size - 1)
    task = _Task(loop, tolerance, _method(loop, method), progress, heed, guarded=True)
    first = _state(loop, start, t[0])
    clock = time.process_time()
    march = _integrate(task, first, t, loop.u)
    run, samples, fault = _looked_at(task, march.samples, progress)
    if march.beyond and fault is None:  # a limit was only grazed: go on without looking
        at, left = Samples(*(row[..., -1:] for row in samples)), t > samples.t[-1]
        if left.any():
            rest = np.append(samples.t[-1], t[left])
            more = _integrate(task._replace(guarded=False), at, rest, loop.u[:, 1 - rest.size :])
            march = _after(samples, march.statistics, more)
            run, samples, fault = _looked_at(task, march.samples, progress)
    if fault is not None:
        run = _cut(task, run, samples, fault)
    statistics = march.statistics | {
        "tolerance": tolerance,
        "cpu_seconds": time.process_time() - clock,
    }
    run = replace(run, statistics=statistics)
    if (march.failure and fault is None) or (run.stop and run.stop.name.endswith("_residual")):
        why = ending(loop, samples, fault[0] if fault else None)
        if why is not None:
            return replace(run, stop=why._replace(t=float(run.t[-1])))
    if march.failure and fault is None:
        words = f"the integrator stopped at t = {run.t[-1]:.6g} s: {march.failure}"
        run = replace(run, stop=Stop("solver", float(run.t[-1]), words))
        raise SolverError(words, run)
    return run


def usable_times(t: Array) -> Array:
    """Return times as they are, or refuse what are no ascending times."""
    t = np.asarray(t, dtype=float)
    if t.ndim != 1 or t.size < 2 or not np.isfinite(t).all() or not (np.diff(t) > 0).all():
        raise ModelError(
            "t: expected two or more ascending times in seconds, found "
            f"{np.array2string(t, threshold=6)}"
        )
    return t


def _method(loop: System, method: Method | None) -> Method:
    """Return how to integrate, or refuse what cannot be."""
    if method is None:
        return "idas" if loop.moving else "cvodes"
    if method not in get_args(Method):
        raise ModelError(f"method: expected one of {', '.join(get_args(Method))}, found {method!r}")
    if method == "cvodes" and loop.moving:
        raise ModelError(
            f"method: 'cvodes' cannot solve for the {loop.moving} algebraic unknowns of this "
            "model; use 'idas'"
        )
    return method


def _state(loop: System, start: Trajectory, t: float) -> Samples:
    """Return the last sample of a trajectory, made consistent with the inputs."""
    dae = loop.dae
    x, z = dae.rows("x", start, -1), dae.rows("z", start, -1)
    z = consistent(loop, t, x, z, loop.u[:, 0])
    q = dae.rows("q", start, -1)
    return Samples(np.array([t]), x[:, None], z[:, None], q[:, None], loop.u[:, :1])


class March(NamedTuple):
    """What the integrator reached, what it cost, and why it stopped, if it did.

    ``beyond`` says that it stopped since a step had gone beyond a limit.
    """

    samples: Samples
    statistics: dict[str, float]
    failure: str
    beyond: bool = False


class _BeyondError(Exception):
    """A step of the integrator went beyond a limit of the model."""

    def __init__(self, t: float) -> None:
        super().__init__(t)
        self.t = t


class _Task(NamedTuple):
    """How to integrate: what does not change from call to call."""

    loop: System
    tolerance: float
    method: Method
    progress: Progress | None
    heed: InterruptGuard
    guarded: bool


def _integrate(task: _Task, first: Samples, t: Array, u: Array, depth: int = 2) -> March:
    """Integrate in one call; if that fails, in windows, so that what was reached is kept.

    After a failure the inputs' jumps end the calls, since the integrator may not find a consistent
    start behind one. Then the window is halved until a part succeeds, down to a single interval;
    that interval is divided in the same way, ``depth`` times at most. A call that goes beyond a
    limit is made again up to there, and is the last.
    """
    samples, counts, failure = first, dict.fromkeys(COUNTS, 0.0), ""
    left, window, last = 0, t.size - 1, t.size - 1
    jumps, split = 1 + np.flatnonzero((np.diff(u, axis=1) != 0).any(axis=0)), False
    while left < last and window:
        right = min(left + window, last)
        if split:
            right = min(right, *jumps[jumps > left], last)
        at = _at(task.loop, samples, u[:, left])
        span = t[left : right + 1]
        try:
            part, cost = _call(task, at, span, u[:, left:right])
        except _BeyondError as end:
            span = np.append(span[span < end.t], end.t)
            rest = March(at, dict.fromkeys(COUNTS, 0.0), "")
            if span.size > 1:
                given = u[:, left : left + span.size - 1]
                rest = _integrate(task._replace(guarded=False), at, span, given, depth)
            return _after(samples, counts, rest)._replace(beyond=not rest.failure)
        except SolverError as error:
            failure = str(error)
            if split or not (jumps > left).any():
                window = (right - left) // 2
            split = True
            continue
        samples, left = _chained(samples, part), right
        counts = {name: counts[name] + cost[name] for name in counts}
    march = March(samples, counts, failure if left < last else "")
    if left < last and depth:
        at = Samples(*(part[..., -1:] for part in samples))
        fine = np.linspace(t[left], t[left + 1], REFINED + 1)
        given = np.repeat(u[:, left : left + 1], REFINED, axis=1)
        rest = _integrate(task, at, fine, given, depth - 1)
        march = _after(samples, counts, rest)
        if not rest.beyond:
            march = march._replace(failure=failure)
    return march


def _at(loop: System, samples: Samples, u: Array) -> Samples:
    """Return the last sample, made consistent with the inputs that come if they jump there."""
    at = Samples(*(part[..., -1:] for part in samples))
    if np.array_equal(at.u[:, -1], u):
        return at
    for eased in (False, True):
        try:
            z = consistent(loop, float(at.t[0]), at.x[:, 0], at.z[:, 0], u, eased=eased)
        except ModelError:  # the integrator tells
            continue
        return at._replace(z=z[:, None], u=u[:, None])
    return at


def _after(samples: Samples, counts: dict[str, float], rest: March) -> March:
    """Return a march with what went before it."""
    together = {name: counts[name] + rest.statistics[name] for name in counts}
    return rest._replace(samples=_chained(samples, rest.samples), statistics=together)


def _chained(first: Samples, second: Samples) -> Samples:
    """Return samples and those that go on from their last one as one."""
    pairs = zip(first.head(-1), second, strict=True)
    return Samples(*(np.concatenate(pair, axis=-1) for pair in pairs))


def _looked_at(
    task: _Task, samples: Samples, progress: Progress | None
) -> tuple[Trajectory, Samples, tuple[int, Stop] | None]:
    """Return the corrected samples up to the first that breaks a limit, and which one that is."""
    loop, runs = task.loop, list[Trajectory]()
    # Where all friction is used, states within the tolerance may have no exact equilibrium.
    unsolved = max(UNSOLVED, LEEWAY * task.tolerance) if loop.dae.continuation else UNSOLVED
    parts: list[Samples] = []
    fault = None
    for left in range(0, samples.t.size, CHUNK):
        part = Samples(*(row[..., left : left + CHUNK] for row in samples))
        part, report = corrected(loop, part)
        runs.append(table(loop, part, report))
        parts.append(part)
        found = first_violation(loop, runs[-1], part, unsolved)
        if progress is not None:
            task.heed.call(progress, float(part.t[-1]))
        if found is not None:
            fault = left + found[0], found[1]
            break
    rows = zip(*parts, strict=True)
    return joined(*runs), Samples(*(np.concatenate(row, axis=-1) for row in rows)), fault


def _call(task: _Task, at: Samples, t: Array, u: Array) -> tuple[Samples, dict[str, float]]:
    """Integrate over all of ``t`` in one call, or raise.

    IDAS's own search may find no consistent start because the one given is consistent to rounding.
    Then that one is made so and taken; not behind jumps of the inputs, which change it.
    """
    try:
        return _attempted(task, at, t, u, {})
    except SolverError as error:
        if NO_START not in str(error) or (np.diff(u, axis=1) != 0).any():
            raise
        loop, begin, x = task.loop, float(t[0]), at.x[:, 0]
        try:
            z = consistent(loop, begin, x, at.z[:, 0], u[:, 0], eased=False)
        except ModelError:
            raise error from None
    rates = loop.core(begin, x, z[: loop.moving], u[:, 0])[0]
    slopes = np.array(rates).ravel() / loop.dae.sizes.x
    kept = {"calc_ic": False, "init_xdot": slopes.tolist()}
    return _attempted(task, at._replace(z=z[:, None]), t, u, kept)


def _attempted(
    task: _Task, at: Samples, t: Array, u: Array, given: dict[str, Any]
) -> tuple[Samples, dict[str, float]]:
    """Integrate with options for the start."""
    loop, spy = task.loop, _Spy(task)  # which lives as long as the integrator
    integrator = _integrator(task, spy, t, given)
    x_size, m_size = (size[:, None] for size in _sizes(loop))
    try:
        # one column for each output time, that of the interval which it ends
        with hushed():
            found = integrator(
                x0=at.x / x_size, z0=at.z[: loop.moving] / m_size, u=np.column_stack([u[:, :1], u])
            )
    except RuntimeError as error:
        task.heed.check()
        raise SolverError(reason(str(error))) from error
    task.heed.check()
    x, z, q = (np.array(found[key]) for key in ("xf", "zf", "qf"))
    x, z = x * x_size, z * m_size
    z = np.concatenate([z, np.full((len(at.z) - len(z), t.size), np.nan)])
    x[:, :1], z[:, :1] = at.x, at.z
    statistics = integrator.stats()
    cost = {name: float(statistics[key]) for name, key in COUNTS.items()}
    inputs = np.column_stack([u, u[:, -1:]])
    return Samples(t, x, z, q[: at.q.shape[0]] + at.q, inputs), cost


def _integrator(task: _Task, spy: _Spy, t: Array, given: dict[str, Any]) -> ca.Function:
    """Return the integrator over all of ``t``, of states and unknowns divided by their sizes."""
    loop, dae = task.loop, task.loop.dae
    x_size, m_size = _sizes(loop)
    counts = [x_size.size, m_size.size, loop.u.shape[0]]
    symbols = [ca.MX.sym("t"), *(ca.MX.sym(name, n) for name, n in zip("xzu", counts, strict=True))]
    t_0, x, m, u = symbols
    point = [t_0, x * ca.DM(x_size), m * ca.DM(m_size), u]
    ode, alg = loop.core(*point)
    quad = ca.vertcat(loop.quad(*point), spy(ca.vertcat(t_0, loop.margin(*point))))
    system = dict(zip("txzu", symbols, strict=True))
    system |= {"ode": ode / ca.DM(x_size), "alg": alg, "quad": quad}
    options: dict[str, Any] = {
        "reltol": task.tolerance,
        "abstol": task.tolerance,
        "max_num_steps": STEPS,
        "show_eval_warnings": False,
        "disable_internal_warnings": True,
    }
    if task.method == "idas":
        options |= {"suppress_algebraic": dae.suppress_algebraic, **given}
        options |= {"cache": {"jacF": scaled_jacobian(loop.jacobian, x_size, m_size)}}
    else:
        options["quad_err_con"] = True
    return ca.integrator("motion", task.method, system, float(t[0]), t, options)


def _sizes(loop: System) -> tuple[Array, Array]:
    """Return the units in which the integrator has the states and the unknowns of the motion."""
    return loop.dae.sizes.x, loop.dae.sizes.z[: loop.moving]


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
    """A quadrature that is always zero and looks on: it tells the time and stops beyond limits.

    Both integrators evaluate quadratures once a step, outside Newton's method, and zero passes
    every error test, so that looking on does not change the motion.
    """

    def __init__(self, task: _Task) -> None:
        ca.Callback.__init__(self)
        self.task = task
        self.construct("spy", {})

    def get_sparsity_in(self, _index: int) -> ca.Sparsity:
        """Return the shape of the argument: time, and least distance to a limit."""
        return ca.Sparsity.dense(2, 1)

    def has_eval_buffer(self) -> bool:
        """Return that numbers come as they are in memory, which takes a fifth of the time."""
        return True

    def eval_buffer(self, arguments: Sequence[memoryview], results: Sequence[memoryview]) -> int:
        """Look at a step."""
        self.task.heed.call(self._look, *_doubles(arguments[0]))
        _doubles(results[0])[0] = 0.0
        return 0

    def _look(self, t: float, margin: float) -> None:
        if self.task.progress is not None:
            self.task.progress(t)
        if self.task.guarded and not margin >= -BEYOND:
            raise _BeyondError(t)


def _doubles(memory: memoryview) -> memoryview[float]:
    return memory.cast("b").cast("d")


def _cut(task: _Task, run: Trajectory, samples: Samples, fault: tuple[int, Stop]) -> Trajectory:
    """Return the motion up to the crossing, located on ever finer samples between two."""
    k, stop = fault
    if k == 0:
        raise ModelError(f"the start is not valid: {stop.words}")
    kept, quiet = run.part(slice(k)), task._replace(progress=None, guarded=False)
    while run.t[k] - run.t[k - 1] > CROSSING:
        at = Samples(*(part[..., k - 1 : k] for part in samples))
        t = np.linspace(run.t[k - 1], run.t[k], REFINED + 1)
        u = np.repeat(samples.u[:, k - 1 : k], REFINED, axis=1)
        march = _integrate(quiet, at, t, u, depth=0)
        fine, finer, found = _looked_at(task, march.samples, None)
        if found is None or found[0] == 0:  # the crossing lies on a sample, within the tolerance
            run, k = (fine, fine.t.size) if found is None else (run, k)
            break
        (k, stop), run, samples = found, fine, finer
    stop = stop._replace(t=float(run.t[k - 1]))
    tail = run.part(slice(k - 1, k), stop)
    return joined(kept, tail) if tail.t[0] > kept.t[-1] else replace(kept, stop=stop)
