"""Integration of a DAE with SUNDIALS IDAS through CasADi."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from dataclasses import replace
from io import StringIO
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.dae import Dae
from slipfree.errors import ModelError, SolverError
from slipfree.named import Array
from slipfree.solve.loop import Loop, Samples, close, corrected, table
from slipfree.solve.settle import consistent, first_violation
from slipfree.trajectory import Stop, Trajectory, joined

COUNTS = {"steps": "nsteps", "residuals": "nfevals", "set_ups": "nlinsetups"}
REFINED = 64  # sub-intervals in which a crossing is sought at a time
CROSSING = 1e-6  # to which a crossing is located [s]
FINEST = 1e-14  # tolerance below which rounding rules
STEPS = 10_000  # of the integrator between two samples
CHUNK = 2000  # samples looked at together, for the sake of memory
Progress = Callable[[float], None]


def simulate(
    dae: Dae[Any, Any, Any, Any, Any],
    start: Trajectory,
    inputs: Any,
    t: Array,
    *,
    tolerance: float = 1e-8,
    progress: Progress | None = None,
) -> Trajectory:
    """Return the motion from a start under given inputs.

    IDAS integrates in one call; at every sample the algebraic unknowns then get one Newton step,
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
        Relative and absolute tolerance of IDAS. [m, rad]
    progress : callable, optional
        Called with the time reached, once for each step or so. It does not change the motion.

    Returns
    -------
    Trajectory
        ``stop`` says why it ended early, if it did.

    Raises
    ------
    ModelError
        If times, tolerance or inputs are not usable or the start is not valid under the inputs.
    SolverError
        If IDAS fails; ``trajectory`` holds what was reached.
    """
    t = _times(t)
    if not FINEST <= tolerance < 1:
        raise ModelError(
            f"tolerance: expected a number from {FINEST:g} to below 1, found {tolerance}"
        )
    loop = close(dae, inputs, t.size - 1)
    first = _state(loop, start, t[0])
    clock = time.process_time()
    march = _integrate(loop, first, t, loop.u, tolerance, progress)
    run, samples, fault = _looked_at(loop, march.samples, progress)
    if fault is not None:
        run = _cut(loop, run, samples, fault, tolerance)
    statistics = march.statistics | {
        "tolerance": tolerance,
        "cpu_seconds": time.process_time() - clock,
    }
    run = replace(run, statistics=statistics)
    if march.failure and fault is None:
        words = f"the integrator stopped at t = {run.t[-1]:.6g} s: {march.failure}"
        run = replace(run, stop=Stop("solver", float(run.t[-1]), words))
        raise SolverError(words, run)
    return run


def _times(t: Array) -> Array:
    t = np.asarray(t, dtype=float)
    if t.ndim != 1 or t.size < 2 or not np.isfinite(t).all() or not (np.diff(t) > 0).all():
        raise ModelError(
            "t: expected two or more ascending times in seconds, found "
            f"{np.array2string(t, threshold=6)}"
        )
    return t


def _state(loop: Loop, start: Trajectory, t: float) -> Samples:
    """Return the last sample of a trajectory, made consistent with the inputs."""
    dae = loop.dae
    x, z = dae.rows("x", start, -1), dae.rows("z", start, -1)
    z = consistent(loop, t, x, z, loop.u[:, 0])
    q = dae.rows("q", start, -1)
    return Samples(np.array([t]), x[:, None], z[:, None], q[:, None], loop.u[:, :1])


class March(NamedTuple):
    """What the integrator reached, what it cost, and why it stopped, if it did."""

    samples: Samples
    statistics: dict[str, float]
    failure: str


def _integrate(
    loop: Loop,
    first: Samples,
    t: Array,
    u: Array,
    tolerance: float,
    progress: Progress | None,
    depth: int = 2,
) -> March:
    """Integrate in one call; if that fails, in windows, so that what was reached is kept.

    After a failure the window is halved until a part succeeds, down to a single interval; that
    interval is then divided in the same way, ``depth`` times at most.
    """
    samples, counts, failure = first, dict.fromkeys(COUNTS, 0.0), ""
    left, window, last = 0, t.size - 1, t.size - 1
    while left < last and window:
        right = min(left + window, last)
        at = Samples(*(part[..., -1:] for part in samples))
        try:
            part, cost = _call(loop, at, t[left : right + 1], u[:, left:right], tolerance, progress)
        except SolverError as error:
            failure, window = str(error), window // 2
            continue
        samples, left = _chained(samples, part), right
        counts = {name: counts[name] + cost[name] for name in counts}
    if left < last and depth:
        at = Samples(*(part[..., -1:] for part in samples))
        fine = np.linspace(t[left], t[left + 1], REFINED + 1)
        rest = _integrate(
            loop, at, fine, np.repeat(u[:, left : left + 1], REFINED, axis=1), tolerance, progress,
            depth - 1,
        )  # fmt: skip
        samples = _chained(samples, rest.samples)
        counts = {name: counts[name] + rest.statistics[name] for name in counts}
    return March(samples, counts, failure if left < last else "")


def _chained(first: Samples, second: Samples) -> Samples:
    """Return samples and those that go on from their last one as one."""
    pairs = zip(first.head(-1), second, strict=True)
    return Samples(*(np.concatenate(pair, axis=-1) for pair in pairs))


def _looked_at(
    loop: Loop, samples: Samples, progress: Progress | None
) -> tuple[Trajectory, Samples, tuple[int, Stop] | None]:
    """Return the corrected samples up to the first that breaks a limit, and which one that is."""
    runs: list[Trajectory] = []
    parts: list[Samples] = []
    fault = None
    for left in range(0, samples.t.size, CHUNK):
        part = Samples(*(row[..., left : left + CHUNK] for row in samples))
        part, report = corrected(loop, part)
        runs.append(table(loop, part, report))
        parts.append(part)
        found = first_violation(loop, runs[-1], part)
        if progress is not None:
            progress(float(part.t[-1]))
        if found is not None:
            fault = left + found[0], found[1]
            break
    rows = zip(*parts, strict=True)
    return joined(*runs), Samples(*(np.concatenate(row, axis=-1) for row in rows)), fault


def _call(
    loop: Loop, at: Samples, t: Array, u: Array, tolerance: float, progress: Progress | None
) -> tuple[Samples, dict[str, float]]:
    """Integrate over all of ``t`` in one call, or raise."""
    dae, spy = loop.dae, _Spy(progress) if progress else None
    sizes = [dae.ode.numel(), sum(b.numel() for b in dae.alg), loop.u.shape[0]]
    symbols = [ca.MX.sym("t"), *(ca.MX.sym(name, n) for name, n in zip("xzu", sizes, strict=True))]
    ode, alg, quad = loop.core(*symbols)
    if spy is not None:
        quad = ca.vertcat(quad, spy(symbols[0]))
    system = dict(zip("txzu", symbols, strict=True)) | {"ode": ode, "alg": alg, "quad": quad}
    options = {
        "reltol": tolerance,
        "abstol": tolerance,
        "max_num_steps": STEPS,
        "suppress_algebraic": dae.suppress_algebraic,
        "show_eval_warnings": False,
        "disable_internal_warnings": True,
    }
    integrator = ca.integrator("motion", "idas", system, float(t[0]), t, options)
    try:
        # one column for each output time, that of the interval which it ends
        with redirect_stderr(StringIO()):  # IDAS repeats there what the exception says
            found = integrator(x0=at.x, z0=at.z, u=np.column_stack([u[:, :1], u]))
    except RuntimeError as error:
        if spy is not None and spy.raised is not None:
            raise spy.raised from None
        raise SolverError(_reason(str(error))) from error
    x, z, q = (np.array(found[key]) for key in ("xf", "zf", "qf"))
    x[:, :1], z[:, :1] = at.x, at.z
    statistics = integrator.stats()
    cost = {name: float(statistics[key]) for name, key in COUNTS.items()}
    given = np.column_stack([u, u[:, -1:]])
    return Samples(t, x, z, q[: at.q.shape[0]] + at.q, given), cost


def _reason(message: str) -> str:
    """Return what IDAS said, out of CasADi's message, in words."""
    words = {
        "IDA_CONV_FAIL": "the algebraic equations could not be solved",
        "IDA_ERR_FAIL": "the error test failed at the smallest step",
        "IDA_TOO_MUCH_WORK": "too many steps between two samples",
        "IDA_LSETUP_FAIL": "the Jacobian is singular",
        "IDA_LSOLVE_FAIL": "the Jacobian is singular",
        "IDA_REP_RES_ERR": "the equations have no finite value",
        "IDA_LINESEARCH_FAIL": "no consistent start was found",
        "IDA_NO_RECOVERY": "no consistent start was found",
        "IDA_ILL_INPUT": "the equations are not usable at the start",
    }
    for flag, meaning in words.items():
        if flag in message:
            return f"{meaning} ({flag})"
    return message.strip().splitlines()[-1]


class _Spy(ca.Callback):
    """A quadrature that is always zero and tells how far the integrator has come.

    IDAS evaluates quadratures once a step, outside Newton's method and the error test, so that
    looking on does not change the motion.
    """

    raised: BaseException | None

    def __init__(self, progress: Progress) -> None:
        ca.Callback.__init__(self)
        self.progress, self.raised = progress, None
        self.construct("spy", {})

    def eval(self, arguments: Sequence[ca.DM]) -> list[ca.DM]:
        """Report the time; what is raised there is kept, since it gets lost on its way."""
        try:
            self.progress(float(arguments[0]))
        except BaseException as error:
            self.raised = error
            raise
        return [ca.DM(0)]


def _cut(
    loop: Loop, run: Trajectory, samples: Samples, fault: tuple[int, Stop], tolerance: float
) -> Trajectory:
    """Return the motion up to the crossing, located on ever finer samples between two."""
    k, stop = fault
    if k == 0:
        raise ModelError(f"the start is not valid: {stop.words}")
    kept = run.part(slice(k))
    while run.t[k] - run.t[k - 1] > CROSSING:
        at = Samples(*(part[..., k - 1 : k] for part in samples))
        t = np.linspace(run.t[k - 1], run.t[k], REFINED + 1)
        u = np.repeat(samples.u[:, k - 1 : k], REFINED, axis=1)
        march = _integrate(loop, at, t, u, tolerance, None, depth=0)
        fine, finer, found = _looked_at(loop, march.samples, None)
        if found is None or found[0] == 0:  # the crossing lies on a sample, within the tolerance
            run, k = (fine, fine.t.size) if found is None else (run, k)
            break
        (k, stop), run, samples = found, fine, finer
    stop = stop._replace(t=float(run.t[k - 1]))
    tail = run.part(slice(k - 1, k), stop)
    return joined(kept, tail) if tail.t[0] > kept.t[-1] else replace(kept, stop=stop)
