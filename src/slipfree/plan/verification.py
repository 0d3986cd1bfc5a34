"""Verify plans by simulation: differences, violated limits, and intervals to refine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae, Limit, PiecewiseLinear
from slipfree.core.records import Array, Mask, Record, leaves
from slipfree.core.trajectory import SolverError, Trajectory
from slipfree.plan.constraints import quantity_label, role_of, shift_of
from slipfree.plan.polynomial_motion import FRACTION_TOLERANCE, PolynomialMotion, motion_of
from slipfree.plan.transcription import (
    CollocationMesh,
    Index,
    PlanTask,
    Program,
    TimedCondition,
)
from slipfree.solve.options import MIN_TOLERANCE, SolverOptions
from slipfree.solve.sampling import TURN, same_turn
from slipfree.solve.simulate import simulate

LIMIT_WIDTH_FRACTION = 0.01  # largest tolerance of a limit, relative to its range
REFINED_FRACTION = 0.25  # neighbours with this fraction of a violation are also refined
VERIFICATION_TOLERANCE = 0.01  # tolerance of the simulation, relative to the plan's accuracy
POSITION_UNITS = ("m", "rad", "1")  # of states that a simulation with another model must reproduce
SWUNG = 0.05  # largest difference at the end of the swing of a caster to either side [rad]
MIN_INTERVAL_SAMPLES = 8  # samples per interval, denser near its ends


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
    """

    replay: Trajectory
    difference: dict[str, float]
    violation: dict[str, float]
    units: dict[str, str]
    worse: Mask
    accurate: bool


def verify_plan(
    program: Program, unknowns: Array, start: Trajectory, *, accuracy: float, step: float
) -> Verification:
    """Simulate the inputs of a plan and compare the simulation with the plan.

    ``accuracy`` is the largest admissible difference and violation, each in its unit; for a limit
    at most 1 % of its range (`tolerated_excess`).
    """
    motion = motion_of(program, unknowns)
    if program.task.dae.replay is not None:
        return _verify_on_replay(program, motion, start, accuracy=accuracy, step=step)
    dae, limits = program.task.dae, program.task.limits
    replay = simulate_plan(dae, start, motion, step=step, options=_precise(program))
    fractions = np.minimum(replay.t / motion.duration, 1.0)
    x, z, u = (local_rows(dae, record, replay) for record in "xzu")
    x, gaps = _compare(x, motion.states(fractions), program.task.periodic, accuracy)
    samples = replay.t, x, z, u
    over, allowed = _limit_excess(dae, limits, samples), tolerated_excess(limits, accuracy)[:, None]
    where, count = _intervals(program, fractions), program.mesh.ends.size - 1
    worse = np.zeros(count, dtype=bool)
    if (over > allowed).any():  # refinement moves violations to neighbours
        worse[where[(over > allowed * REFINED_FRACTION).any(axis=0)]] = True
    worse |= _error_sources(gaps, where, accuracy, count)
    if replay.stop is not None:
        # A finer mesh helps only if the simulation ended at a limit that the program contains.
        worse[where[-1]] |= replay.stop.name in {limit.label.full for limit in limits}
    missed = dict[str, float]()
    for condition, k in _met_conditions(program.task, fractions):
        one = slice(k, k + 1)
        at = replay.t[one], x[:, one], z[:, one], u[:, one]
        missed |= {
            f"{name} at the {role_of(condition.fraction)}": size
            for name, size in _excess_by_name(
                condition.limits, _limit_excess(dae, condition.limits, at)[:, 0]
            ).items()
        }
    violation = _excess_by_name(limits, over.max(axis=1)) | missed
    names = [label.full for label in leaves(dae.labels.x)]
    met = max(missed.values(), default=0.0) <= accuracy
    return Verification(
        replay,
        dict(zip(names, np.abs(gaps).max(axis=1).tolist(), strict=True)),
        violation,
        _units(program.task),
        worse,
        met and replay.stop is None and not worse.any(),
    )


def _compare(x: Array, planned: Array, periodic: Mask, accuracy: float) -> tuple[Array, Array]:
    """Return simulated states within half a turn of the planned ones, and their differences.

    A caster that is driven backwards is unstable: by rounding alone it swings to the left in the
    plan and to the right in the simulation, on any mesh, and arrives at the same position a turn
    apart. The difference during such a swing is no error; it counts as zero.
    """
    near = same_turn(x, planned, periodic)
    gaps, last = near - planned, x.shape[1] - 1
    for k in np.flatnonzero(periodic):
        turns = np.round((x[k] - near[k]) / TURN)
        inside = np.flatnonzero(np.abs(gaps[k]) <= accuracy)
        for before, after in pairwise([*inside, last]):
            has_swung = turns[before] != turns[after] and abs(gaps[k, after]) <= SWUNG
            if has_swung:
                gaps[k, before + 1 : after + 1] = 0.0
    return near, gaps


def _precise(program: Program) -> SolverOptions:
    tolerance = max(program.options.tolerance * VERIFICATION_TOLERANCE, MIN_TOLERANCE)
    return replace(program.options, tolerance=tolerance)


def _verify_on_replay(
    program: Program, motion: PolynomialMotion, start: Trajectory, *, accuracy: float, step: float
) -> Verification:
    """Compare a plan with the simulation of its inputs by another model, ``dae.replay``.

    Positions and angles must agree within the accuracy. Speeds differ by vibrations that the
    planned model omits; their differences are only reported.
    """
    task, dae = program.task, program.task.dae
    model = dae if dae.replay is None else dae.replay.model
    replay = simulate_plan(model, start, motion, step=step, options=_precise(program))
    fractions = np.minimum(replay.t / motion.duration, 1.0)
    planned = motion.states(fractions)
    x, gaps = _compare(local_rows(model, "x", replay), planned, task.periodic, accuracy)
    labels = list(leaves(dae.labels.x))
    placed = gaps[[label.unit in POSITION_UNITS for label in labels]]
    over = np.array([_replay_excess(task, limit, replay, x) for limit in task.limits])
    violation = _excess_by_name(task.limits, over)
    missed = dict[str, float]()
    for condition, k in _met_conditions(task, fractions):
        for limit in condition.limits:
            excess = _replay_excess(task, limit, replay.part(slice(k, k + 1)), x[:, k : k + 1])
            if excess > 0:
                missed[f"{limit_name(limit)} at the {role_of(condition.fraction)}"] = excess
    return Verification(
        replay,
        dict(zip((label.full for label in labels), np.abs(gaps).max(axis=1).tolist(), strict=True)),
        violation | missed,
        _units(task),
        _error_sources(
            placed, _intervals(program, fractions), accuracy, program.mesh.ends.size - 1
        ),
        bool(np.abs(placed).max() <= accuracy) and replay.stop is None,
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


def _intervals(program: Program, fractions: Array) -> Index:
    """Return the index of the mesh interval of each sample, at fractions of the duration."""
    ends = program.mesh.ends
    where = np.searchsorted(ends, fractions - FRACTION_TOLERANCE) - 1
    return np.asarray(np.clip(where, 0, ends.size - 2))


def _replay_excess(task: PlanTask, limit: Limit, run: Trajectory, x: Array) -> float:
    """Return the largest violation of a limit in a simulation with another model, with states x.

    A limit on unknowns of the planned model applies to the quantity of the same name, if any.
    """
    dae, label = task.dae, quantity_label(limit.label)
    if not ca.depends_on(limit.expression, dae.columns()[1]):
        u = local_rows(dae, "u", run)
        unknowns = np.zeros((dae.scale.size, run.t.size))
        values = limit_values(dae, [limit], (run.t, x, unknowns, u))[0]
    elif label.name in run.columns:
        shift = shift_of(task, limit.expression) - task.dae.reported.get(label.full, 0.0)
        values = run.of(label) - shift
    else:
        return 0.0
    return float(np.maximum(np.maximum(limit.lower - values, values - limit.upper), 0.0).max())


def _units(task: PlanTask) -> dict[str, str]:
    return (
        {label.full: label.unit for label in leaves(task.dae.labels.x)}
        | {limit_name(limit): limit.label.unit for limit in task.limits}
        | {
            f"{limit_name(limit)} at the {role_of(condition.fraction)}": limit.label.unit
            for condition in task.conditions
            for limit in condition.limits
        }
    )


def limit_name(limit: Limit) -> str:
    """Return the name of the limited quantity with its wheel, such as ``utilisation[left]``."""
    return limit.label.full.replace("_limit", "")


def _excess_by_name(limits: Sequence[Limit], most: Array) -> dict[str, float]:
    """Return the positive violations by name of the limit, the largest for each name."""
    sizes: dict[str, float] = {}
    for limit, size in zip(limits, most, strict=True):
        if size > 0:
            name = limit_name(limit)
            sizes[name] = max(sizes.get(name, 0.0), float(size))
    return sizes


def _met_conditions(task: PlanTask, fractions: Array) -> Iterator[tuple[TimedCondition, int]]:
    """Yield the conditions whose time a simulation reaches, and the index of their sample."""
    for condition in task.conditions:
        k = int(np.abs(fractions - condition.fraction).argmin())
        if abs(fractions[k] - condition.fraction) <= 1e-6:
            yield condition, k


def tolerated_excess(limits: Sequence[Limit], accuracy: float) -> Array:
    """Return the tolerance of each limit: the smaller of ``accuracy`` and 1 % of a range."""
    widths = np.array([limit.upper - limit.lower for limit in limits])
    return np.where(
        widths > 0, np.minimum(accuracy, LIMIT_WIDTH_FRACTION * np.abs(widths)), accuracy
    )


def local_rows(dae: Dae, record: str, run: Trajectory) -> Array:
    """Return a record (x, z or u) of all samples in local coordinates, one column per sample."""
    shift = {"x": dae.shift[0], "z": dae.shift[1]}.get(record)
    rows = np.array([run.of(label) for label in leaves(getattr(dae.labels, record))])
    return rows if shift is None else rows - shift[:, None]


def _limit_excess(
    dae: Dae, limits: Sequence[Limit], samples: tuple[Array, Array, Array, Array]
) -> Array:
    values = limit_values(dae, limits, samples)
    low, high = (
        np.array([getattr(limit, side) for limit in limits]).reshape(-1, 1)
        for side in ("lower", "upper")
    )
    return np.asarray(np.maximum(np.maximum(low - values, values - high), 0.0))


def limit_values(
    dae: Dae, limits: Sequence[Limit], samples: tuple[Array, Array, Array, Array]
) -> Array:
    """Return the limited quantities at n samples of t, x, z and u, shape (n_limits, n)."""
    t, x, z, u = samples
    rows = ca.vertcat(ca.SX(0, 1), *(limit.expression for limit in limits))
    f = dae.function("limits", [dae.t, *dae.columns()], [rows])
    return np.array(f.map(t.size)(t[None], x, z, u)).reshape(len(limits), t.size)


def _error_sources(gaps: Array, where: Index, accuracy: float, count: int) -> Mask:
    """Return the mask of intervals that cause a difference above the accuracy.

    A difference persists after the interval that causes it. Therefore an interval is marked if the
    difference changes on it by more than its share, the accuracy over the number of intervals. The
    interval with the largest change is always marked.
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
    names = [label.full for label in leaves(dae.labels.u)]
    ends, values = motion.ends, motion.unknowns[motion.layout.inputs].T
    k = np.searchsorted(ends, (times[1:] + times[:-1]) / 2) - 1
    if not motion.continuous:
        return dae.inputs(**dict(zip(names, values[:, k], strict=True)))
    slopes = np.diff(values) / np.diff(ends)
    bases = values[:, :-1] - slopes * ends[:-1]
    lines = [PiecewiseLinear(base[k], slope[k]) for base, slope in zip(bases, slopes, strict=True)]
    return dae.inputs(**dict(zip(names, lines, strict=True)))


def simulate_plan(
    dae: Dae,
    start: Trajectory,
    motion: PolynomialMotion,
    *,
    step: float,
    options: SolverOptions = SolverOptions(),
) -> Trajectory:
    """Simulate a model under the inputs of a plan, to its end or to the first failure."""
    # Limits are often violated just after kinks of the inputs: Chebyshev points are dense there.
    lengths = np.diff(motion.ends)
    counts = np.maximum(np.ceil(np.pi / 2 * lengths / step - 1e-9), MIN_INTERVAL_SAMPLES)
    inside = [(1 - np.cos(np.pi * np.arange(n) / n)) / 2 for n in counts]
    times = [a + h * part for a, h, part in zip(motion.ends[:-1], lengths, inside, strict=True)]
    t = np.append(np.concatenate(times), motion.ends[-1])
    return simulate_to_failure(dae, start, inputs_along(dae, motion, t), t, options)


def simulate_to_failure(
    dae: Dae, start: Trajectory, inputs: Record, t: Array, options: SolverOptions
) -> Trajectory:
    """Simulate to the last time or to the first failure, which has samples before it."""
    try:
        return simulate(dae, start, inputs, t, options=options)
    except SolverError as error:
        if error.trajectory is None:
            raise
        return error.trajectory
