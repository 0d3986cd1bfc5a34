"""Verify plans by simulation: differences, violated limits, and intervals to refine."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae, Limit, PiecewiseLinear
from slipfree.core.errors import SlipfreeError
from slipfree.core.records import Array, Mask, Record, leaves
from slipfree.core.trajectory import PLAN_UNVERIFIED, Outcome, Stop, Trajectory
from slipfree.plan import constraints
from slipfree.plan.polynomial_motion import (
    FRACTION_TOLERANCE,
    PolynomialMotion,
    motion_of,
    sample_plan,
)
from slipfree.plan.transcription import CollocationMesh, Index, PlanTask, Program
from slipfree.solve.sampling import same_turn
from slipfree.solve.simulate import simulate_to_failure
from slipfree.solve.system import MIN_TOLERANCE, SolverOptions

Key = TypeVar("Key")
GUESS_TOLERANCE = 1e-5  # tolerance of the simulation of guesses [m, rad]
LIMIT_WIDTH_FRACTION = 0.01  # largest tolerance of a limit, relative to its range
REFINED_FRACTION = 0.25  # neighbours with this fraction of a violation are also refined
VERIFICATION_TOLERANCE = 0.003  # of the states in the simulation, relative to the options
POSITION_UNITS = ("m", "rad", "1")  # of states that a simulation with another model must reproduce
MIN_INTERVAL_SAMPLES = 8  # samples per interval, denser near its ends


class TimeLimitError(SlipfreeError):
    """End of a simulation by the time limit of its plan."""


class Verification(NamedTuple):
    """Comparison of a plan with the simulation of its inputs.

    Attributes
    ----------
    replay : Trajectory
        Simulated motion, with at least 8 samples on every interval.
    difference : dict of str to float
        Largest difference of each state from the plan, in its unit, by name.
    violation : dict of str to float
        Largest violation of each limit, goal and way-point by the simulation, in its unit, by name.
    units : dict of str to str
        Units of differences and violations, by name.
    worse : ndarray of bool, shape (n,)
        True for the n intervals of the mesh that must be refined to reach the accuracy.
    accurate : bool
        Whether states, limits, way-points and goal are within the accuracy and the simulation
        reaches the end of the plan.
    misses : tuple of ndarray
        Excess of the simulation over each limit of each way-point and of the goal, in its unit:
        positive above the upper bound, negative below the lower one, otherwise zero. Empty if the
        simulation ends early, violates another limit, or is one with another model.
    limits : tuple of Limit
        Limits of the next program: that at which the simulation ended has as much more clearance as
        the plan exceeds it between its points, but at least its tolerance (`tolerated_excess`).
    """

    replay: Trajectory
    difference: dict[str, float]
    violation: dict[str, float]
    units: dict[str, str]
    worse: Mask = np.zeros(0, dtype=bool)
    accurate: bool = False
    misses: tuple[Array, ...] = ()
    limits: tuple[Limit, ...] = ()


def verify_plan(
    program: Program,
    unknowns: Array,
    start: Trajectory,
    *,
    accuracy: float,
    step: float,
    deadline: float = math.inf,
) -> Verification:
    """Simulate the inputs of a plan and compare the simulation with the plan.

    ``accuracy`` is the largest admissible difference and violation, each in its unit; for a limit
    at most 1 % of its range (`tolerated_excess`). If another model simulates the plan
    (``dae.replay``), only positions and angles must agree. If the simulation does not end before
    ``deadline``, a value of `time.monotonic`, ``replay`` is the planned motion, with a stop.
    """
    task, motion = program.task, motion_of(program, unknowns)
    dae, other, further = task.dae, task.dae.replay, [*task.limits]
    exact = {limit.label: limit for limit in dae.all_limits}  # without clearance
    limits = tuple(exact.get(limit.label, limit) for limit in task.limits)
    model, options = dae if other is None else other.model, program.options
    # The error test of the unknowns, which follow from the states, would triple the steps. Rounding
    # can end the first steps of wheels that press into the ground, but not at the given tolerance.
    for share in (VERIFICATION_TOLERANCE, 1.0):
        how = replace(options, tolerance=max(options.tolerance * share, MIN_TOLERANCE))
        given: dict[str, Any] = {"step": step, "states_only": share < 1, "deadline": deadline}
        try:
            replay = simulate_plan(model, start, motion, options=how, **given)
        except TimeLimitError as error:
            run = sample_plan(program, unknowns)
            stop = Stop(PLAN_UNVERIFIED, float(run.t[-1]), str(error), Outcome.TIME_LIMIT)
            return Verification(replace(run, stop=stop), {}, {}, {})
        if replay.outcome is not Outcome.SOLVER_FAILURE:
            break
    fractions = np.minimum(replay.t / motion.duration, 1.0)
    planned, states = motion.states(fractions), list(leaves(dae.labels.x))
    x = same_turn(model.rows("x", replay), planned, task.periodic)
    gaps = x - planned
    over = np.abs(_excess(task, limits, replay, x))
    judged, misses = [("", limits, over)], list[Array]()
    for fraction, asked in task.conditions:
        k = int(np.abs(fractions - fraction).argmin())
        one, own = slice(k, k + 1), np.zeros((len(asked), 1))
        if abs(fractions[k] - fraction) <= 1e-6:  # the simulation reaches it
            own = _excess(task, asked, replay.part(one), x[:, one])
        misses.append(own[:, 0])
        judged.append((f" at the {constraints.role_of(fraction)}", asked, np.abs(own)))
    units, violation = {label.full: label.unit for label in states}, dict[str, float]()
    for suffix, asked, own in judged:
        for limit, most in zip(asked, own.max(axis=1).tolist(), strict=True):
            name = limit_name(limit) + suffix
            units[name] = limit.label.unit
            if most > 0:
                violation[name] = max(violation.get(name, 0.0), most)
    ends, count = program.mesh.ends, program.mesh.ends.size - 1
    where = np.clip(np.searchsorted(ends, fractions - FRACTION_TOLERANCE) - 1, 0, count - 1)
    allowed = tolerated_excess(limits, accuracy)[:, None]
    exceeds = bool((over > allowed).any())
    # Speeds differ by vibrations that the planned model omits; they are only reported.
    placed = [other is None or label.unit in POSITION_UNITS for label in states]
    worse = _error_sources(gaps[placed], where, accuracy, count)
    if other is not None:
        met = bool(np.abs(gaps[placed]).max() <= accuracy)
    else:
        if exceeds:  # refinement moves violations to neighbours
            worse[where[(over > allowed * REFINED_FRACTION).any(axis=0)]] = True
        if replay.stop is not None:
            # A finer mesh helps only if the simulation ended at a limit that the program contains.
            for k, limit in enumerate(task.limits):
                if limit.label.full == replay.stop.name:
                    between = excess_between(program, motion, limit)
                    worse |= between > constraints.VIOLATION_TOLERANCE
                    worse[where[-1]] = True
                    # a joint that stays near its stop exceeds it elsewhere on every finer mesh, and
                    # the simulation may differ from the plan by the accuracy
                    slack = max(between.max(), tolerated_excess([limit], accuracy)[0])
                    further[k] = constraints.with_clearance(limit, float(slack))
        met = not worse.any() and all(own.max(initial=0) <= accuracy for *_, own in judged[1:])
    differences = np.abs(gaps).max(axis=1).tolist()
    return Verification(
        replay,
        dict(zip((label.full for label in states), differences, strict=True)),
        violation,
        units,
        worse,
        met and replay.stop is None,
        () if exceeds or other or replay.stop else tuple(misses),
        tuple(further),
    )


def largest_error(program: Program, verification: Verification) -> float:
    """Return the largest difference or violation, in its unit; speeds only of the plan's model."""
    is_same = program.task.dae.replay is None
    differences = (
        size
        for name, size in verification.difference.items()
        if is_same or verification.units[name] in POSITION_UNITS
    )
    violations = verification.violation.values() if is_same else ()
    return max((*differences, *violations), default=0.0)


def largest(sizes: Iterable[tuple[Key, float]]) -> dict[Key, float]:
    """Return the largest of the sizes with each key."""
    most = dict[Key, float]()
    for key, size in sizes:
        most[key] = max(size, most.get(key, -np.inf))
    return most


def limit_name(limit: Limit) -> str:
    """Return the name of the limited quantity with its wheel, such as ``utilisation[left]``."""
    return limit.label.full.replace("_limit", "")


def tolerated_excess(limits: Sequence[Limit], accuracy: float) -> Array:
    """Return the tolerance of each limit: the smaller of ``accuracy`` and 1 % of a range."""
    widths = np.array([limit.upper - limit.lower for limit in limits])
    return np.where(
        widths > 0, np.minimum(accuracy, LIMIT_WIDTH_FRACTION * np.abs(widths)), accuracy
    )


def _excess(task: PlanTask, limits: Sequence[Limit], run: Trajectory, x: Array) -> Array:
    """Return the excess over limits of a simulation with n states x, shape (n_limits, n).

    In a simulation with another model, a limit on unknowns of the planned model applies to the
    quantity of the same name, if any.
    """
    dae, u = task.dae, task.dae.rows("u", run)
    is_same, z = dae.replay is None, np.zeros((dae.scale.size, run.t.size))
    z = dae.rows("z", run) if is_same else z
    values = limit_values(dae, limits, (run.t, x, z, u))
    for row, limit in zip(values, limits, strict=True):
        if not is_same and ca.depends_on(limit.expression, dae.columns()[1]):
            label = constraints.constraint(task, limit, "").label
            shift = constraints.shift_of(task, limit.expression) - dae.reported.get(label.full, 0.0)
            row[:] = run.of(label) - shift if label.name in run.columns else np.nan
    return np.nan_to_num(_beyond(limits, values))


def _beyond(limits: Sequence[Limit], values: Array) -> Array:
    """Return how far limited quantities are beyond their limits, shape (n_limits, n).

    The excess is positive above the upper bound, negative below the lower one, otherwise zero.
    """
    low = np.array([limit.lower for limit in limits]).reshape(-1, 1)
    high = np.array([limit.upper for limit in limits]).reshape(-1, 1)
    return np.asarray(values - np.clip(values, low, high))


def obstacle_words(task: PlanTask, run: Trajectory, accuracy: float) -> str:
    """Return the largest violation of a limit by a simulation, and its place; empty if none.

    The largest violation is that with the largest ratio to `tolerated_excess`.
    """
    if not task.limits:
        return ""
    over = np.abs(_excess(task, task.limits, run, task.dae.rows("x", run)))
    ratio = over / tolerated_excess(task.limits, accuracy)[:, None]
    i, k = np.unravel_index(np.argmax(ratio), ratio.shape)
    if not ratio[i, k] > 1:
        return ""
    label = constraints.constraint(task, task.limits[i], constraints.LIMIT).label
    at = [f"t = {run.t[k]:.4g} s", *(f"{axis} = {run[axis][k]:.2f} m" for axis in "xy")]
    by = constraints.number(label, over[i, k])
    return f"{constraints.subject(label, constraints.LIMIT)} by {by} at {', '.join(at)}"


def limit_values(
    dae: Dae, limits: Sequence[Limit], samples: tuple[Array, Array, Array, Array]
) -> Array:
    """Return the limited quantities at n samples of t, x, z and u, shape (n_limits, n)."""
    t, x, z, u = samples
    rows = ca.vertcat(ca.SX(0, 1), *(limit.expression for limit in limits))
    f = dae.function("limits", [dae.t, *dae.columns()], [rows])
    return np.array(f.map(t.size)(t[None], x, z, u)).reshape(len(limits), t.size)


def excess_between(program: Program, motion: PolynomialMotion, limit: Limit) -> Array:
    """Return by how much a plan exceeds a limit between its points, shape (n_intervals,)."""
    dae, ends = program.task.dae, program.mesh.ends
    inside = np.linspace(0, 1, MIN_INTERVAL_SAMPLES)
    at = (ends[:-1, None] + np.diff(ends)[:, None] * inside).ravel()
    planned = motion.algebraic(at)
    z = np.zeros((dae.scale.size, at.size))
    z[: len(planned)] = planned
    samples = at * motion.duration, motion.states(at), z, motion.inputs(at)
    over = np.abs(_beyond([limit], limit_values(dae, [limit], samples)))
    return np.asarray(over.reshape(ends.size - 1, -1).max(axis=1))


def _error_sources(gaps: Array, where: Index, accuracy: float, count: int) -> Mask:
    """Return the mask of intervals that cause a difference above the accuracy.

    ``gaps`` are differences at n samples (n_quantities, n), ``where`` the intervals of the samples,
    ``count`` the number of intervals. A difference persists after the interval that causes it.
    Therefore an interval is marked if the difference changes on it by more than its share, the
    accuracy over the number of intervals. The interval with the largest change is always marked.
    """
    if np.abs(gaps).max(initial=0.0) <= accuracy:
        return np.zeros(count, dtype=bool)
    change = np.zeros(count)
    for k in np.unique(where):
        first = int(np.argmax(where == k))
        before = gaps[:, max(first - 1, 0)]
        change[k] = np.abs(gaps[:, where == k] - before[:, None]).max()
    return np.asarray(change >= min(accuracy / count, change.max()))


def refine_mesh(mesh: CollocationMesh, worse: Mask) -> CollocationMesh:
    """Return a mesh with the intervals marked in ``worse`` halved."""
    middles = (mesh.ends[1:] + mesh.ends[:-1]) / 2
    return mesh._replace(ends=np.sort(np.concatenate([mesh.ends, middles[worse]])))


def inputs_along(dae: Dae, motion: PolynomialMotion, times: Array) -> Record:
    """Return inputs of a plan for ``simulate`` at times, which include all ends of intervals."""
    ends, values = motion.ends, motion.unknowns[motion.layout.inputs].T
    k = np.searchsorted(ends, (times[1:] + times[:-1]) / 2) - 1
    if not motion.continuous:
        return dae.inputs(**dict(zip(dae.input_names, values[:, k], strict=True)))
    lines = [PiecewiseLinear.through(ends, each) for each in values]
    lines = [PiecewiseLinear(each.base[k], each.slope[k]) for each in lines]
    return dae.inputs(**dict(zip(dae.input_names, lines, strict=True)))


def simulate_plan(
    dae: Dae,
    start: Trajectory,
    motion: PolynomialMotion,
    *,
    step: float,
    options: SolverOptions = SolverOptions(),
    states_only: bool = False,
    deadline: float = math.inf,
) -> Trajectory:
    """Simulate a model under the inputs of a plan, to its end or to the first failure.

    ``step`` is the largest time between samples [s]. TimeLimitError is raised at ``deadline``, a
    value of `time.monotonic`.
    """

    def check_time(reached: float) -> None:
        if time.monotonic() > deadline:
            raise TimeLimitError(
                f"the time limit ended the simulation of the plan at t = {reached:.4g} s of "
                f"{motion.duration:.4g} s; raise plan.seconds"
            )

    # Limits are often violated just after kinks of the inputs: Chebyshev points are dense there.
    lengths = np.diff(motion.ends)
    counts = np.maximum(np.ceil(np.pi / 2 * lengths / step - 1e-9), MIN_INTERVAL_SAMPLES)
    inside = [(1 - np.cos(np.pi * np.arange(n) / n)) / 2 for n in counts]
    times = [a + h * part for a, h, part in zip(motion.ends[:-1], lengths, inside, strict=True)]
    t = np.append(np.concatenate(times), motion.ends[-1])
    how = {"sampled_work": True, "states_only": states_only, "progress": check_time}
    return simulate_to_failure(dae, start, inputs_along(dae, motion, t), t, options, **how)
