"""Model-predictive control: update a plan while the vehicle moves, one Newton step per cycle.

A window of fixed length goes ahead of the vehicle along a plan, and ends where the plan is then, in
the quantities of the goal. From cycle to cycle only bounds of its program change; its solution
is shifted, the measured state put in, and one iteration taken (Diehl, Bock, Schloeder, A real-time
iteration scheme for nonlinear optimization in optimal feedback control, SIAM J. Control Optim. 43,
2005). Behind the end of the plan the window shrinks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.errors import ModelError
from slipfree.forks import computing
from slipfree.interrupt import with_interrupt_guard
from slipfree.plan.ipopt import MAX_ITERATIONS, largest_violation, warm_solver
from slipfree.plan.plan import Plan
from slipfree.plan.polynomial_motion import PolynomialMotion, motion_of
from slipfree.plan.transcription import (
    CollocationMesh,
    Index,
    PlanTask,
    Program,
    completed,
    transcribe,
)
from slipfree.plan.verification import inputs_along
from slipfree.records import Array, field_overview
from slipfree.solver_codes import ipopt_words
from slipfree.trajectory import SolverError

TIME_TOLERANCE = 1e-6  # times at a smaller distance count as equal [s]
USABLE_STATUSES = ("Solve_Succeeded", "Solved_To_Acceptable_Level", "Maximum_Iterations_Exceeded")
MIN_WINDOW_FRACTION = 0.25  # near the end of the plan, shorter windows are not updated [window]


@dataclass(frozen=True, eq=False)
class Horizon:
    """A window ahead of the vehicle.

    Attributes
    ----------
    program : Program
        Of the window.
    plan : PolynomialMotion
        The motion along which it goes.
    targets : casadi Function
        ``(x, z, u) ->`` the quantities that the goal constrains.
    span : float
        Length of the window. [s]
    weights : ndarray, shape (n_costs + 1,)
        Of the costs, the smoothness last.
    rows : casadi Function
        ``(w, p) ->`` the rows of the program.
    solver : casadi Function
        Takes the iterations of a cycle.
    """

    program: Program
    plan: PolynomialMotion
    targets: ca.Function
    span: float
    weights: Array
    rows: ca.Function
    solver: ca.Function

    def __repr__(self) -> str:
        return field_overview(self)


class Cycle(NamedTuple):
    """Solution of one cycle, from which the next one starts.

    Attributes
    ----------
    t : float
        When. [s]
    motion : PolynomialMotion
        The motion from then on.
    row_multipliers, bound_multipliers : ndarray, shape (n_g,) and (n_w,)
        Of rows and bounds.
    violation : float
        Largest violation of the equations and bounds by the motion.
    """

    t: float
    motion: PolynomialMotion
    row_multipliers: Array
    bound_multipliers: Array
    violation: float

    def __repr__(self) -> str:
        return field_overview(self)


@computing
def horizon(
    plan: Plan, *, span: float, intervals: int = 20, degree: int = 3, iterations: int = 1
) -> Horizon:
    """Return a window of a plan.

    Parameters
    ----------
    plan : Plan
        Its costs, limits, goal and solver options hold in the window, its way-points only by the
        plan itself.
    span : float
        Length of the window. [s]
    intervals, degree : int
        Of the window's collocation.
    iterations : int
        Of a cycle at most.

    Raises
    ------
    ModelError
        If the window is longer than the plan, numbers are not positive, or the model or its
        costs and limits depend on time, which a window would count from its own beginning.
    """
    length, task = plan.motion.duration, plan.program.task
    _check_task(task, {"intervals": intervals, "degree": degree, "iterations": iterations})
    if not 0 < span <= length:
        raise ModelError(
            f"horizon: expected a window of at most the duration of the plan, {length:g} s, found "
            f"{span} s"
        )
    own = replace(task, conditions=task.conditions[-1:], duration=(span, span))
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
        warm_solver(program, iterations),
    )


def _check_task(task: PlanTask, numbers: dict[str, int]) -> None:
    for name, number in numbers.items():
        if number < 1:
            raise ModelError(f"horizon: {name}: expected 1 or more, found {number}")
    dae = task.dae
    asked = (limit.expression for limit in (*task.limits, *dae.limits, *task.conditions[-1].limits))
    costs = (cost.expression for cost in task.costs)
    everything = ca.vertcat(dae.ode, *dae.alg, *asked, *costs)
    if ca.depends_on(everything, dae.t):
        raise ModelError(
            "horizon: expected a model, costs and limits that do not depend on time, found some "
            "that do; plan the whole motion instead"
        )


def first_cycle(window: Horizon) -> Cycle:
    """Return the cycle before the first one: the beginning of the plan, solved for the window."""
    program, layout = window.program, window.program.layout
    first = _sample_motions(window, [(window.plan, 0.0)], 0.0, window.span)
    blank = Cycle(
        0.0,
        motion_of(program, first),
        np.zeros(program.g_lower.size),
        np.zeros(program.scale.size),
        np.inf,
    )
    patient = replace(window, solver=warm_solver(program, MAX_ITERATIONS))
    return replan(patient, blank, 0.0, first[layout.first])


@computing
@with_interrupt_guard
def replan(window: Horizon, former: Cycle, t: float, x: Array) -> Cycle:
    """Update a plan while the vehicle moves: return the next cycle.

    Parameters
    ----------
    window : Horizon
        The window.
    former : Cycle
        The last one.
    t : float
        Time since the plan began. [s]
    x : ndarray, shape (n_x,)
        States that were measured then, local.

    Returns
    -------
    Cycle
        Near the end of the plan, the rest of the former one.

    Raises
    ------
    ModelError
        If time or states are none.
    SolverError
        If the iterations fail, as from a state far from the window; the former cycle may be driven
        on.

    Examples
    --------
    >>> import numpy as np
    >>> from slipfree import Analytic, catalog, direct_kinematics, plan, replan, settle, simulate
    >>> from slipfree import straight
    >>> from slipfree.plan.mpc import first_cycle, horizon
    >>> vehicle = catalog.three_wheeler(axle="fixed")
    >>> model = direct_kinematics(vehicle, Analytic(lambda x, y: 0.1 * x * y))
    >>> start = settle(model)
    >>> law = straight(model, vehicle, start, speed=0.25)
    >>> guess = simulate(model, start, law, np.linspace(0, 4, 9))
    >>> wish = {"goal": {"y": 1.0}, "costs": {"effort": 1.0}, "duration": 4.0}
    >>> window = horizon(plan(model, start, guess, intervals=4, **wish), span=2.0, intervals=2)
    >>> measured = window.plan.states(np.array([0.1])).ravel() + 1e-3  # at 0.4 s, local
    >>> cycle = replan(window, first_cycle(window), 0.4, measured)
    >>> cycle.violation < 1e-3
    True
    """
    program, plan, scale = window.program, window.plan, window.program.scale
    x = np.asarray(x, dtype=float)
    if x.shape != program.layout.first.shape or not np.isfinite([t, *x]).all():
        raise ModelError(
            f"horizon: expected a time and {program.layout.first.size} states, all finite, found "
            f"t = {t} and {x}"
        )
    if t < former.t - TIME_TOLERANCE:
        raise ModelError(f"horizon: expected a time from {former.t:g} s on, found {t:g} s")
    span = min(window.span, plan.duration - t)
    if span < MIN_WINDOW_FRACTION * window.span:
        return former
    first = _sample_motions(window, [(former.motion, former.t), (plan, 0.0)], t, span)
    first[program.layout.first] = x
    first = completed(program, first)
    lower, upper = program.lower.copy(), program.upper.copy()
    lower[program.layout.first] = upper[program.layout.first] = x
    lower[program.layout.duration] = upper[program.layout.duration] = span
    g_lower, g_upper = _row_bounds(window, t + span)
    rows, bounds = _shift_multipliers(program, former, t, span)
    found = window.solver(
        x0=first / scale,
        p=window.weights,
        lbx=lower / scale,
        ubx=upper / scale,
        lbg=g_lower,
        ubg=g_upper,
        lam_g0=rows,
        lam_x0=bounds,
    )
    status = str(window.solver.stats()["return_status"])
    # IPOPT's own rows are those of its last accepted iterate, which may differ from those returned.
    g = np.array(window.rows(found["x"], window.weights)).ravel()
    if status not in USABLE_STATUSES or not np.isfinite(g).all():
        raise SolverError(
            f"horizon: no step at t = {t:g} s from the state {x}: {ipopt_words(status)}; "
            "the inputs of the former cycle may still be used"
        )
    unknowns, rows, bounds = (np.array(found[name]).ravel() for name in ("x", "lam_g", "lam_x"))
    asked = replace(program, g_lower=g_lower, g_upper=g_upper)
    return Cycle(t, motion_of(program, unknowns * scale), rows, bounds, largest_violation(asked, g))


def cycle_inputs(
    window: Horizon, cycle: Cycle, first_cycle: float, end: float
) -> tuple[Any, Array]:
    """Return the inputs of a cycle from one time since the plan began to another, for ``simulate``.

    Returns
    -------
    record, ndarray
        The inputs, and the times at which to simulate under them, since the cycle; the last one is
        the end of the cycle's motion if that comes first. [s]

    Raises
    ------
    ModelError
        If there is nothing left to drive, or the times are before the cycle.
    """
    ends = cycle.motion.ends
    first, last = first_cycle - cycle.t, min(end - cycle.t, ends[-1])
    if not -TIME_TOLERANCE <= first < last:
        raise ModelError(
            f"horizon: expected times from {cycle.t:g} to {cycle.t + ends[-1]:g} s, the second "
            f"after the first, found {first_cycle:g} and {end:g} s"
        )
    inside = ends[(ends > first + TIME_TOLERANCE) & (ends < last - TIME_TOLERANCE)]
    times = np.concatenate([[first], inside, [last]])
    return inputs_along(window.program.task.dae, cycle.motion, times), times


def _sample_motions(
    window: Horizon, motions: list[tuple[PolynomialMotion, float]], t: float, span: float
) -> Array:
    """Return unknowns sampled from motions, the first that covers each time."""
    program = window.program
    mesh, layout = program.mesh, program.layout
    unknowns = np.zeros(program.scale.size)
    unknowns[layout.duration] = span
    nodes, n_z = t + span * mesh.nodes, layout.unknowns.shape[2]
    ends = t + span * (
        mesh.ends if len(layout.inputs) == mesh.ends.size else (mesh.ends[1:] + mesh.ends[:-1]) / 2
    )
    states = _join_values(motions, nodes, PolynomialMotion.states)
    unknown = _join_values(motions, nodes, PolynomialMotion.algebraic)
    inputs = _join_values(motions, ends, PolynomialMotion.inputs)
    unknowns[layout.first] = states[:, 0]
    unknowns[layout.states] = states[:, 1:].T.reshape(layout.states.shape)
    unknowns[layout.unknowns] = unknown[:n_z, 1:].T.reshape(layout.unknowns.shape)
    unknowns[layout.inputs] = inputs.T
    return completed(program, unknowns)


def _join_values(motions: list[tuple[PolynomialMotion, float]], at: Array, read: Any) -> Array:
    """Return values of the first motion that goes as far as each time."""
    values = read(motions[-1][0], _to_fractions(motions[-1], at))
    for motion in reversed(motions[:-1]):
        inside = at <= motion[1] + motion[0].duration
        values[:, inside] = read(motion[0], _to_fractions(motion, at[inside]))
    return np.asarray(values)


def _to_fractions(motion: tuple[PolynomialMotion, float], at: Array) -> Array:
    """Return times as fractions of a motion."""
    return np.clip((at - motion[1]) / motion[0].duration, 0.0, 1.0)


def _row_bounds(window: Horizon, end: float) -> tuple[Array, Array]:
    """Return bounds of the rows for a window that ends at a time: there it meets the plan."""
    program, plan = window.program, window.plan
    lower, upper = program.g_lower.copy(), program.g_upper.copy()
    if end < plan.duration - TIME_TOLERANCE:  # sums of times may be off by rounding
        at = np.array([end / plan.duration])
        values = window.targets(plan.states(at), plan.algebraic(at), plan.inputs(at))
        count = len(program.row_blocks[-1].labels)
        lower[-count:] = upper[-count:] = np.array(values).ravel()
    return lower, upper


def _shift_multipliers(
    program: Program, former: Cycle, t: float, span: float
) -> tuple[Array, Array]:
    """Return the multipliers of a cycle for the next one, interval by interval."""
    ends, layout = program.mesh.ends, program.layout
    middles = (t - former.t + span * (ends[1:] + ends[:-1]) / 2) / former.motion.duration
    which: Index = np.clip(np.searchsorted(ends, middles) - 1, 0, ends.size - 2)
    row_block = program.row_blocks[0]
    count = len(row_block.where) * len(row_block.labels)
    rows, bounds = former.row_multipliers.copy(), np.zeros(program.scale.size)
    rows[:count] = rows[:count].reshape(len(row_block.where), -1)[which].ravel()
    for where in (layout.inputs[: which.size], layout.states, layout.unknowns, layout.roots):
        bounds[where] = former.bound_multipliers[where[which]]
    bounds[layout.inputs[which.size :]] = former.bound_multipliers[layout.inputs[which.size :]]
    return rows, bounds
