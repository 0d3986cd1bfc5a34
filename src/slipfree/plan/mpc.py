"""Model-predictive control: update a plan while the vehicle moves, one step per cycle.

A window of fixed duration moves ahead of the vehicle. At its end, the quantities of the goal must
equal those of the plan at that time. Only the bounds of its program change from cycle to cycle. In
each cycle the previous solution is shifted in time, the measured state is imposed, and one step of
sequential quadratic programming is made (Diehl, Bock, Schloeder, A real-time iteration scheme for
nonlinear optimization in optimal feedback control, SIAM J. Control Optim. 43, 2005). Near the end
of the plan the window becomes shorter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.lookups import evaluate, run_buffered
from slipfree.core.records import Array, Record, field_overview, with_overview
from slipfree.core.schema import Count, Finite
from slipfree.core.trajectory import SolverError, Trajectory, ipopt_words
from slipfree.plan.ipopt import MAX_ITERATIONS, largest_violation, warm_solver
from slipfree.plan.plan import Plan
from slipfree.plan.polynomial_motion import (
    PolynomialMotion,
    input_fractions,
    motion_of,
    unknowns_of,
)
from slipfree.plan.sqp import StepSolver
from slipfree.plan.transcription import CollocationMesh, PlanTask, Program, completed, transcribe
from slipfree.plan.verification import inputs_along
from slipfree.solve.sampling import same_turn
from slipfree.solve.simulate import simulate
from slipfree.system.forks import computing
from slipfree.system.interrupt import with_interrupt_guard

TIME_TOLERANCE = 1e-6  # largest difference of times that count as equal [s]
USABLE_STATUSES = ("Solve_Succeeded", "Solved_To_Acceptable_Level", "Maximum_Iterations_Exceeded")
MAX_CYCLE_VIOLATION = 0.1  # of a row of a cycle, in its unit; full steps from there diverge
STEP_VIOLATION = 0.01  # of a row after full steps, in its unit; above it, another step is made
MORE_STEPS = 2  # full steps that may follow before a line search
SEARCH_ITERATIONS = 30  # maximum number of iterations with a line search
CONVERGED_STEP = 1e-9  # largest change of a scaled unknown after which no further step is made
MIN_WINDOW_FRACTION = 0.25  # shorter windows, at the end of a plan, are not updated


@dataclass(frozen=True, eq=False)
class Horizon:
    """Moving window of a plan, with its nonlinear program and solver."""

    program: Program  # nonlinear program of the window
    plan: PolynomialMotion  # planned motion that the window follows
    targets: ca.Function  # function ``(x, z, u) ->`` quantities that the goal constrains
    span: float  # length of the window [s]
    weights: Array  # shape (n_costs + 1,): of the costs and, last, the smoothness
    rows: ca.Function  # function ``(w, p) ->`` rows of the program, of scaled unknowns and weights
    solver: StepSolver  # of the steps of sequential quadratic programming
    steps: int  # maximum number of steps per cycle
    careful: ca.Function  # IPOPT with a line search, for cycles in which full steps fail

    __repr__ = field_overview


@with_overview
class Cycle(NamedTuple):
    """Solution of one cycle, the initial guess of the next cycle."""

    t: float  # time of the cycle since the beginning of the plan [s]
    motion: PolynomialMotion  # planned motion from this time to the end of the window
    multipliers: Array  # shape (n_g,): Lagrange multipliers of the rows
    violation: float  # largest violation of a row of the program, in its unit


@checked
@computing
def horizon(
    plan: Plan, *, span: float, intervals: Count = 20, degree: Count = 3, iterations: Count = 1
) -> Horizon:
    """Return a moving window of a plan, for `replan`.

    Parameters
    ----------
    plan : Plan
        Plan to follow. The window has its costs, limits, goal and solver options, not its
        way-points and cost limits.
    span : float
        Length of the window. [s]
    intervals : int
        Number of collocation intervals in the window.
    degree : int
        Degree of the polynomials on each interval, 1 to 5.
    iterations : int
        Maximum number of steps per cycle, at their full length. If a row is wrong by more than 0.01
        after them, up to two further steps follow; then the cycle is repeated by IPOPT with a line
        search, in at most 30 iterations.

    Raises
    ------
    ModelError
        If ``span`` is not positive or exceeds the duration of the plan, ``intervals``, ``degree``
        or ``iterations`` is out of range, or the model, costs, limits or goal depend on time,
        since times of a window begin at zero.
    """
    length, task = plan.motion.duration, plan.program.task
    _check_task(task)
    check_duration("horizon: span: expected a window", span, length)
    own = replace(
        task,
        conditions=task.conditions[-1:],
        duration=(span, span),
        cost_limits=(),
        initial_inputs=None,
    )
    mesh = CollocationMesh(np.linspace(0, 1, intervals + 1), degree)
    program = transcribe(own, mesh, plan.program.options)
    x, z, u = task.dae.columns()
    n_z = plan.motion.layout.unknowns.shape[2]
    asked = ca.vertcat(*(limit.expression for limit in own.conditions[0].limits))
    weights = np.array([*(cost.weight for cost in task.costs), task.smooth])
    names = [program.problem[name] for name in "xp"]
    return Horizon(
        program,
        plan.motion,
        task.dae.function("targets", [x, z[:n_z], u], [asked]),
        span,
        weights,
        ca.Function("rows", names, [program.problem["g"]]),
        StepSolver(program),
        iterations,
        warm_solver(program, SEARCH_ITERATIONS),
    )


def check_duration(expected: str, duration: float, longest: float) -> None:
    """Raise ModelError unless a duration is positive and at most that of the plan [s]."""
    if not 0 < duration <= longest:
        raise ModelError(
            f"{expected} above 0 and at most {longest:g} s, the duration of the plan, found "
            f"{duration:g} s; choose one in this range"
        )


def _check_task(task: PlanTask) -> None:
    """Raise ModelError unless the problem does not depend on time.

    A window moves: its program is the same at all times.
    """
    dae = task.dae
    limits = *task.limits, *dae.all_limits, *task.conditions[-1].limits
    terms = [*(each.expression for each in limits), *(each.expression for each in task.costs)]
    everything = ca.vertcat(dae.ode, *dae.alg, *terms)
    if ca.depends_on(everything, dae.t):
        raise ModelError(
            "horizon: expected a model, costs, limits and a goal that do not depend on time, found "
            "at least one that does; use `plan` for the whole motion instead"
        )


def first_cycle(window: Horizon) -> Cycle:
    """Return the cycle at the beginning of the plan, iterated to convergence, at most 500 times.

    Parameters
    ----------
    window : Horizon
        Moving window, from `slipfree.plan.mpc.horizon`.

    Raises
    ------
    SolverError
        If the iterations fail.
    """
    program, layout = window.program, window.program.layout
    first = _sample_motions(window, [(window.plan, 0.0)], 0.0, window.span)
    none = np.zeros(program.g_lower.size)
    blank = Cycle(0.0, motion_of(program, first), none, np.inf)
    patient = replace(window, steps=0, careful=warm_solver(program, MAX_ITERATIONS))
    return replan(patient, blank, 0.0, first[layout.first] + program.task.dae.shift[0])


@checked
@computing
@with_interrupt_guard
def replan(window: Horizon, former: Cycle, t: Finite, x: Array) -> Cycle:
    """Update a plan from a measured state while the vehicle moves.

    Parameters
    ----------
    window : Horizon
        Moving window, from `slipfree.plan.mpc.horizon`.
    former : Cycle
        Result of the previous cycle, or of `slipfree.plan.mpc.first_cycle`.
    t : float
        Time of the measurement since the beginning of the plan. [s]
    x : ndarray, shape (n_x,)
        Measured states, in map coordinates. Height, roll and pitch of a vehicle with pressed
        wheels must be those of rest on the ground of the plan: see `slipfree.settle_many`.

    Returns
    -------
    Cycle
        Solution of the new cycle. If less than a quarter of the window is left before the end of
        the plan, ``former`` is returned.

    Raises
    ------
    ModelError
        If ``t`` or ``x`` is not finite, ``x`` has the wrong shape, or ``t`` is before the
        previous cycle.
    SolverError
        If the iterations fail, for example for a state far from the plan. The inputs of the
        previous cycle may still be used.

    Examples
    --------
    >>> import numpy as np
    >>> from slipfree import Analytic, Mesh, catalog, direct_kinematics, plan, replan, settle
    >>> from slipfree.plan.mpc import first_cycle, horizon
    >>> vehicle = catalog.three_wheeler(axle="fixed")
    >>> model = direct_kinematics(vehicle, Analytic(lambda x, y: 0.1 * x * y))
    >>> start = settle(model)
    >>> wish = {"goal": {"y": 1.0}, "costs": {"effort": 1.0}, "duration": 4.0, "mesh": Mesh(4)}
    >>> window = horizon(plan(model, start, **wish), span=2.0, intervals=2)
    >>> measured = window.plan.states(np.array([0.1])).ravel() + model.shift[0]  # at 0.4 s
    >>> cycle = replan(window, first_cycle(window), 0.4, measured + 1e-3)
    >>> cycle.violation < 1e-3
    True
    """
    program, plan = window.program, window.plan
    x = program.task.dae.local_state(x)
    if t < former.t - TIME_TOLERANCE:
        raise ModelError(
            f"replan: expected a time t of at least {former.t:g} s, the time of the previous "
            f"cycle, found {t:g} s; replan at increasing times"
        )
    span = min(window.span, plan.duration - t)
    if span < MIN_WINDOW_FRACTION * window.span:
        return former
    first = _sample_motions(window, [(former.motion, former.t), (plan, 0.0)], t, span)
    at = program.layout.first
    first[at] = same_turn(x[:, None], first[at][:, None], program.task.periodic)[:, 0]
    multipliers = _shift_multipliers(program, former, t, span)
    return _iterated(window, t, first, _row_bounds(window, t + span), multipliers)


@computing
@with_interrupt_guard
def refine(window: Horizon, start: Trajectory, inputs: Array) -> Cycle:
    """Return inputs that were found by sampling, improved by the iterations of a window.

    The quantities of the goal at the end of the window keep their values under the given inputs,
    while the costs of the window decrease and its limits are met.

    Parameters
    ----------
    window : Horizon
        Window of a plan of the same model, whose span is the horizon of the sampling.
    start : Trajectory
        Motion of the model, whose last sample is the measured state.
    inputs : ndarray, shape (n_u, n)
        Inputs in n equal intervals of the window, as in `slipfree.plan.sampling.SampledPlan`.

    Returns
    -------
    Cycle
        Cycle at time zero; `slipfree.plan.mpc.cycle_inputs` returns its inputs.

    Raises
    ------
    SolverError
        If the motion under the inputs ends before the window does, or the iterations fail.
    """
    program, dae, span = window.program, window.program.task.dae, window.span
    edges = np.linspace(0.0, span, inputs.shape[1] + 1)
    nodes = span * program.mesh.nodes
    times = np.unique(np.round(np.concatenate([edges, nodes]), 9))
    rates = inputs[:, np.searchsorted(edges, (times[1:] + times[:-1]) / 2) - 1]
    run = simulate(dae, start, dae.inputs(**dict(zip(dae.input_names, rates, strict=True))), times)
    if run.stop is not None:
        raise SolverError(
            f"refine: expected a motion over the window of {span:g} s, found one that ends at "
            f"{run.t[-1]:.4g} s: {run.stop.words}; apply the sampled inputs without refining them",
            run,
        )
    at = np.abs(times[:, None] - nodes).argmin(axis=0)
    x, z = (dae.rows(record, run, at) for record in "xz")
    middle = span * input_fractions(program)
    u = inputs[:, np.clip(np.searchsorted(edges, middle) - 1, 0, inputs.shape[1] - 1)]
    first = unknowns_of(program, x, z, u, span)
    n_z = window.plan.layout.unknowns.shape[2]
    asked = np.array(window.targets(x[:, -1], z[:n_z, -1], u[:, -1])).ravel()
    return _iterated(window, 0.0, first, _with_goal(program, asked), np.zeros(program.g_lower.size))


def _iterated(
    window: Horizon, t: float, first: Array, row_bounds: tuple[Array, Array], multipliers: Array
) -> Cycle:
    """Return the cycle after the iterations of a window, from unknowns with the measured state.

    ``first`` are the unknowns, ``row_bounds`` bounds of the constraint functions with the goal of
    this cycle, ``multipliers`` those of the last one.
    """
    program, scale = window.program, window.program.scale
    lower, upper = program.lower.copy(), program.upper.copy()
    fixed = np.append(program.layout.first, program.layout.duration)
    lower[fixed] = upper[fixed] = first[fixed]
    start, bounds, p = first / scale, (lower / scale, upper / scale), window.weights
    asked = replace(program, g_lower=row_bounds[0], g_upper=row_bounds[1])

    def violation(unknowns: Array) -> float:
        (g,) = evaluate(window.rows, unknowns[:, None], p[:, None])
        return largest_violation(asked, g.ravel()) if np.isfinite(g).all() else np.inf

    unknowns = start
    for k in range(window.steps + MORE_STEPS * bool(window.steps)):
        try:
            step = window.solver.step(unknowns, p, bounds, row_bounds, multipliers)
        except np.linalg.LinAlgError:
            break
        unknowns, multipliers = unknowns + step.change, step.multipliers
        is_last = k >= window.steps - 1 or np.abs(step.change).max() < CONVERGED_STEP
        if is_last and (over := violation(unknowns)) < STEP_VIOLATION:
            return Cycle(t, motion_of(program, unknowns * scale), multipliers, over)
    # The equations of roots are linear in them, so that steps do not depend on roots, unlike IPOPT.
    start = completed(program, first) / scale
    # Arguments in the order of ``casadi.nlpsol``; CasADi matrices would take a tenth of the time.
    columns = {k: each[:, None] for k, each in enumerate((start, p, *bounds, *row_bounds))}
    unknowns, rows = np.empty(scale.size), np.empty(multipliers.size)
    buffer = run_buffered(window.careful, columns, {0: unknowns, 4: rows})
    status, over = str(buffer.stats()["return_status"]), violation(unknowns)
    if status not in USABLE_STATUSES or over >= MAX_CYCLE_VIOLATION:
        raise SolverError(
            f"replan: the iterations failed at t = {t:g} s, state {first[program.layout.first]}: "
            f"{ipopt_words(status)}; the inputs of the previous cycle may still be used"
        )
    return Cycle(t, motion_of(program, unknowns * scale), rows, over)


def cycle_inputs(window: Horizon, cycle: Cycle, begin: float, end: float) -> tuple[Record, Array]:
    """Return the inputs of a cycle between two times, and sample times for ``simulate``.

    Parameters
    ----------
    window : Horizon
        Moving window.
    cycle : Cycle
        Cycle whose inputs are returned.
    begin, end : float
        First and last time, since the beginning of the plan; inputs end with the motion of the
        cycle if it is shorter. [s]

    Returns
    -------
    inputs : record
        Inputs for ``simulate``.
    times : ndarray
        Both times and the ends of the intervals between them, since the time of the cycle. [s]

    Raises
    ------
    ModelError
        If the first time is before the cycle, after its motion, or not before the last time.
    """
    ends = cycle.motion.ends
    first, last = begin - cycle.t, min(end - cycle.t, ends[-1])
    if not -TIME_TOLERANCE <= first < last:
        raise ModelError(
            f"cycle_inputs: expected 'begin' from {cycle.t:g} to below {cycle.t + ends[-1]:g} s, "
            f"the times of the cycle, and a later 'end', found {begin:g} and {end:g} s; correct "
            "these times"
        )
    inside = ends[(ends > first + TIME_TOLERANCE) & (ends < last - TIME_TOLERANCE)]
    times = np.concatenate([[first], inside, [last]])
    return inputs_along(window.program.task.dae, cycle.motion, times), times


def _sample_motions(
    window: Horizon, motions: list[tuple[PolynomialMotion, float]], t: float, span: float
) -> Array:
    """Return unknowns of the window at time ``t``, of the first motion that has not ended yet."""
    program, (first, begin), (last, since) = window.program, motions[0], motions[-1]

    def values(fractions: Array, read: Callable[[PolynomialMotion, Array], Array]) -> Array:
        at = t + span * fractions
        k = np.searchsorted(at, begin + first.duration, side="right")
        parts = (first, (at[:k] - begin) / first.duration), (last, (at[k:] - since) / last.duration)
        return np.hstack([read(motion, np.clip(part, 0.0, 1.0)) for motion, part in parts])

    nodes = program.mesh.nodes
    x, z = values(nodes, PolynomialMotion.states), values(nodes, PolynomialMotion.algebraic)
    u = values(input_fractions(program), PolynomialMotion.inputs)
    return unknowns_of(program, x, z, u, span)


def _row_bounds(window: Horizon, end: float) -> tuple[Array, Array]:
    """Return bounds of the rows; at ``end`` the plan's values replace the goal of later windows."""
    program, plan = window.program, window.plan
    if end >= plan.duration - TIME_TOLERANCE:
        return program.g_lower, program.g_upper
    at = np.array([end / plan.duration])
    (values,) = evaluate(window.targets, plan.states(at), plan.algebraic(at), plan.inputs(at))
    return _with_goal(program, values.ravel())


def _with_goal(program: Program, values: Array) -> tuple[Array, Array]:
    """Return bounds of the rows with values for the quantities of the goal."""
    lower, upper = program.g_lower.copy(), program.g_upper.copy()
    count = len(program.row_blocks[-1].labels)
    lower[-count:] = upper[-count:] = values
    return lower, upper


def _shift_multipliers(program: Program, former: Cycle, t: float, span: float) -> Array:
    """Return the multipliers of the rows, shifted to the next window."""
    ends = program.mesh.ends
    middles = (t - former.t + span * (ends[1:] + ends[:-1]) / 2) / former.motion.duration
    which = np.clip(np.searchsorted(ends, middles) - 1, 0, ends.size - 2)
    count = ends.size - 1
    own, last = np.split(former.multipliers, [count * len(program.row_blocks[0].labels)])
    return np.concatenate([own.reshape(count, -1)[which].ravel(), last])
