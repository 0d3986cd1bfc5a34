"""Simulate a sampled controller whose outputs are constant between samples."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.lookups import run_buffered
from slipfree.core.records import Array, Record, leaves, unpack
from slipfree.core.trajectory import Outcome, SolverError, Stop, Trajectory, sundials_words
from slipfree.solve.integrator import COUNTS, Progress, sundials_options, suppress_messages
from slipfree.solve.options import SolverOptions
from slipfree.solve.sampling import Samples, to_trajectory
from slipfree.solve.simulate import check_times, first_violation, interrupted_at
from slipfree.solve.system import System, check_law, with_inputs
from slipfree.system.interrupt import InterruptGuard, check_interrupt

PERIOD_TOLERANCE = 1e-6  # largest relative difference between sampling periods that count as equal


def simulate_sampled(
    dae: Dae,
    start: Trajectory,
    inputs: Record,
    t: Array,
    *,
    options: SolverOptions = SolverOptions(),
    progress: Progress | None = None,
) -> Trajectory:
    """Return the motion under inputs that are constant between samples.

    CVODES restarts at every sample. With periods of 10 and 20 ms, a simulation of a dynamic model
    takes 3 to 40 times as long as with continuous inputs. The motion ends with the first sample
    that violates a limit of the model.

    The arguments are those of `simulate`, with evenly spaced times at which the controller samples;
    expressions of time, states and those inputs that are numbers are evaluated there. ``progress``
    is called with the time of every sample, and ends the motion if it returns False.

    ModelError is raised if the model has algebraic unknowns, or times, inputs or method are
    invalid; SolverError, with the motion up to the failure, if CVODES fails.
    """
    t = check_times(t)
    period = float(t[1] - t[0])
    if np.abs(np.diff(t) - period).max() > PERIOD_TOLERANCE * period:
        raise ModelError(
            "t: expected evenly spaced times for a sampled controller, found steps from "
            f"{np.diff(t).min():.9g} to {np.diff(t).max():.9g} s; use a constant step"
        )
    if dae.guess.numel():
        raise ModelError(
            "dae: expected a model without algebraic unknowns for a sampled controller, found "
            f"{dae.guess.numel()} of them; use simulate with one value of the inputs for each "
            "interval"
        )
    if options.method in ("idas", "explicit"):
        raise ModelError(
            "method: expected 'cvodes' for a sampled controller, found "
            f"{options.method!r}; omit the method"
        )
    given = list(leaves(inputs))
    laws = [isinstance(value, ca.SX) for value in given]
    constants = [0.0 if is_law else value for value, is_law in zip(given, laws, strict=True)]
    system = with_inputs(dae, unpack(dae.u, constants), t.size - 1, options)
    state, _, driven = dae.columns()
    if system.u.shape[0] != driven.numel():
        raise ModelError(
            "inputs: expected constants or expressions for a sampled controller, found inputs that "
            "are linear in time; give them as expressions of dae.t"
        )
    own = ca.vertsplit(driven)
    numeric = ca.vertcat(ca.SX(0, 1), *(own[k] for k, is_law in enumerate(laws) if not is_law))
    for label, value in zip(leaves(dae.labels.u), given, strict=True):
        if isinstance(value, ca.SX):  # of time, states and numeric inputs
            check_law(dae, label, ca.substitute(value, numeric, ca.SX.zeros(numeric.shape)))
    column = ca.vertcat(*(given[k] if is_law else own[k] for k, is_law in enumerate(laws)))
    law = dae.function("law", [dae.t, state, driven], [column])
    clock = time.process_time()
    n, integrator = t.size, _period_integrator(system, period, options.tolerance)
    symbols = law.mx_in()
    values = law(*symbols)
    watched = system.watch(*symbols[:2], ca.MX(0, 1), values)
    sample = ca.Function("sample", symbols, [values, watched[1]])  # inputs, distance to a limit
    names = [integrator.index_in("x0"), integrator.index_in("p")]
    results = [integrator.index_out("xf"), integrator.index_out("qf")]
    x, q = np.zeros((n, dae.ode.numel())), np.zeros((n, dae.quad.numel()))
    x[0], q[0] = dae.rows("x", start, -1), dae.rows("q", start, -1)
    u, margin = np.zeros((n, system.u.shape[0])), np.empty(1)
    cost, failure, last, is_ended = dict.fromkeys(COUNTS, 0.0), "", 0, False
    with InterruptGuard() as guard:
        for k in range(n):
            numbers = system.u[:, min(k, n - 2)]
            run_buffered(sample, {0: t[k : k + 1], 1: x[k], 2: numbers}, {0: u[k], 1: margin})
            last = k
            if k == n - 1 or margin[0] < 0:  # the samples end with the first beyond a limit
                break
            is_ended = progress is not None and progress(float(t[k])) is False
            if is_ended:
                break
            check_interrupt()
            sources = dict(zip(names, (x[k], np.append(u[k], t[k])), strict=True))
            targets = dict(zip(results, (x[k + 1], q[k + 1]), strict=True))
            try:
                with suppress_messages():
                    buffer = run_buffered(integrator, sources, targets)
            except RuntimeError as error:
                guard.check()
                failure = sundials_words(str(error))
                break
            guard.check()
            q[k + 1] += q[k]
            statistics = buffer.stats()
            cost = {name: cost[name] + statistics[key] for name, key in COUNTS.items()}
    samples = Samples(t, x.T, np.zeros((0, n)), q.T, u.T).at(slice(last + 1))
    run = to_trajectory(system, samples, {})
    fault = first_violation(system, run, samples)
    if fault is not None:
        run = run.part(slice(fault[0] + 1), fault[1])
    elif failure:
        words = f"the integrator stopped at t = {run.t[-1]:.6g} s: {failure}"
        run = replace(run, stop=Stop("solver", float(run.t[-1]), failure, Outcome.SOLVER_FAILURE))
        raise SolverError(words, run)
    elif is_ended:
        run = replace(run, stop=interrupted_at(float(run.t[-1])))
    cost |= {"tolerance": options.tolerance, "cpu_seconds": time.process_time() - clock}
    return replace(run, statistics=cost)


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
