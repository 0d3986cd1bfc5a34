"""Plans: inputs that lead a vehicle from a start to a goal at the least cost, within limits.

The same model that is simulated is transcribed by collocation and solved by IPOPT; the inputs that
come out are simulated again, and how far that is from the plan belongs to the result.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.dae import Limit
from slipfree.errors import ModelError, SolverError
from slipfree.named import Array, Label, leaves
from slipfree.plan.explain import conflicts, explanation
from slipfree.plan.solver import Iterate, Solution, solve
from slipfree.plan.transcribe import Cost, Mesh, Model, Place, Program, Task, transcribe
from slipfree.solve.inverse import basis
from slipfree.solve.loop import close
from slipfree.solve.sample import Samples, followed, table
from slipfree.solve.simulate import simulate
from slipfree.trajectory import Stop, Trajectory

STAGES = (0.0, 1.0)  # parts of the slip's weight, one after the other
SLIP = ("slip", "slip_along", "slip_across")  # costs whose weight is raised in stages
ROUNDS = 4  # of adding limits that a plan violates
WITHIN = 1e-6  # violation of a limit that is rounding, in its unit
Range = tuple[float, float]
Progress = Callable[[str, Iterate], bool]


class Stage(NamedTuple):
    """One program that was solved on the way to a plan.

    Attributes
    ----------
    words : str
        What was solved.
    iterations : int
        How many it took.
    status : str
        IPOPT's words.
    seconds : dict of str to float
        Wall time in all, in functions, in the rest. [s]
    """

    words: str
    iterations: int
    status: str
    seconds: dict[str, float]


@dataclass(frozen=True, eq=False)
class Plan:
    """A plan and its proof.

    Attributes
    ----------
    run : Trajectory
        The plan, sampled at the beginning and at all points of collocation.
    inputs : record
        What drives the model along it, for ``simulate`` at times ``run.t[::degree]``.
    replay : Trajectory
        The model's motion under these inputs, integrated, at the same times as ``run``.
    difference : dict of str to float
        Largest difference between the two in every state. [m, rad]
    costs : dict of str to float
        Integrals of the terms of the cost, in their units.
    success : bool
        Whether the program was solved; a plan that was not is the best iterate.
    program, solution : Program, Solution
        What was solved last.
    stages : tuple of Stage
        All that was solved.
    """

    run: Trajectory
    inputs: Any
    replay: Trajectory
    difference: dict[str, float]
    costs: dict[str, float]
    success: bool
    program: Program
    solution: Solution
    stages: tuple[Stage, ...]


def plan(
    dae: Model,
    start: Trajectory,
    guess: Trajectory,
    *,
    goal: Mapping[str, float | Range] | Sequence[Limit],
    costs: Mapping[str, float] | Sequence[Cost],
    duration: float | Range,
    smooth: float = 0.0,
    limits: Mapping[str, Range] | Sequence[Limit] = (),
    way_points: Mapping[float, Mapping[str, float | Range]] | None = None,
    inputs: Mapping[str, Range] | None = None,
    accelerations: Mapping[str, Range] | None = None,
    intervals: int = 40,
    degree: int = 3,
    tolerance: float = 1e-8,
    progress: Progress | None = None,
) -> Plan:
    """Return the inputs that reach a goal at the least cost, with the motion they lead to.

    Parameters
    ----------
    dae : Dae
        The model; its own limits hold as well: those that a plan would violate are added until none
        is.
    start : Trajectory
        Its last sample is where the plan begins.
    guess : Trajectory
        A motion of the model from there, roughly to the goal: its path and inputs start the search.
    goal : mapping of str to float or (low, high), or sequence of Limit
        Values or ranges of states and unknowns by name at the end, in map coordinates; or
        conditions in the model's symbols. [m, rad]
    costs : mapping of str to float, or sequence of Cost
        Weights by name: ``"slip"``, ``"effort"`` (squared inputs), ``"time"``, or the name of any
        quantity of the model, whose square is integrated over time and summed over the wheels.
    duration : float or (least, largest)
        How long it takes. [s]
    smooth : float
        Weight of the squared rates of the inputs, integrated over time.
    limits : mapping of str to (low, high), or sequence of Limit
        Along the way.
    way_points : mapping of float to mapping, optional
        Conditions like those of the goal at fractions of the duration.
    inputs, accelerations : mapping of str to (low, high), optional
        Bounds of inputs and of their rates. [1/s, 1/s2]
    intervals, degree : int
        Of the collocation.
    tolerance : float
        Of the integrator that replays the plan.
    progress : callable, optional
        Called with words and every iterate; returning False ends the search, the best iterate kept.

    Raises
    ------
    ModelError
        If a name is not known, or start, goal and limits contradict each other.
    """
    clock = time.process_time()
    task = Task(
        dae, dae.rows("x", start, -1), _range(duration), _costs(dae, costs),
        tuple(_all_places(dae, goal, way_points or {})), limits_of(dae, limits),
        _bounds_of(dae, inputs or {}), _bounds_of(dae, accelerations or {}), smooth,
    )  # fmt: skip
    if wrong := conflicts(task, start):
        raise ModelError("plan: " + "; ".join(wrong))
    mesh = Mesh(np.linspace(0, 1, intervals + 1), degree)
    program = transcribe(task, mesh)
    first = unknowns_of(program, guess)
    found, stages = _staged(program, first, progress)
    program, found, first, more = _within_limits(program, found, first, progress)
    stages += more
    result = _result(program, found, stages, start, tolerance)
    if not found.success:
        words = f"the plan is not solved; this is its last iterate: " \
                f"{explanation(program, found, first)}"  # fmt: skip
        stop = Stop("plan", float(result.run.t[-1]), words)
        result = replace(result, run=replace(result.run, stop=stop))
    statistics = {"cpu_seconds": time.process_time() - clock,
                  "iterations": float(sum(stage.iterations for stage in stages))}  # fmt: skip
    return replace(result, run=replace(result.run, statistics=statistics))


def _within_limits(
    program: Program, found: Solution, first: Array, progress: Progress | None
) -> tuple[Program, Solution, Array, tuple[Stage, ...]]:
    """Return program and solution with those of the model's limits that a plan would violate."""
    stages: tuple[Stage, ...] = ()
    for _ in range(ROUNDS):
        missed = _missed(program, found)
        if not (missed and found.success):
            break
        task = replace(program.task, limits=(*program.task.limits, *missed))
        program, former = transcribe(task, program.mesh), program
        first = _carried(former, program, found.unknowns)
        words = f"with {', '.join(limit.label.full for limit in missed)}"
        found, more = _solved(program, first, words, 1.0, progress)
        stages += more
    return program, found, first, stages


def _range(value: float | Range) -> Range:
    low, high = (value, value) if isinstance(value, int | float) else value
    if not 0 < low <= high < np.inf:
        raise ModelError(f"plan: expected a positive duration or a range of them, found {value} s")
    return float(low), float(high)


def _costs(dae: Model, given: Mapping[str, float] | Sequence[Cost]) -> tuple[Cost, ...]:
    if not isinstance(given, Mapping):
        return tuple(given)
    costs = []
    for name, weight in given.items():
        if not weight >= 0:
            raise ModelError(f"plan: the weight of {name} must not be negative, found {weight}")
        costs.append(Cost(*_term(dae, name), weight))
    return tuple(costs)


def _term(dae: Model, name: str) -> tuple[Label, ca.SX]:
    """Return label and expression of a term of the cost."""
    if name == "time":
        return Label(name, "s", "duration"), ca.SX(1)
    if name == "effort":
        return Label(name, "rad2 s-1", "squared inputs"), ca.sumsqr(ca.vertcat(*leaves(dae.u)))
    if name == "slip":
        parts = [*dae.named("slip_along"), *dae.named("slip_across")]
        return Label(name, "m2 s-1", "squared slip of all wheels"), ca.sumsqr(ca.vertcat(*parts))
    expression = ca.sumsqr(ca.vertcat(*dae.named(name)))
    return Label(name, "", f"squared {name}, integrated over time"), expression


def limits_of(dae: Model, given: Mapping[str, Range] | Sequence[Limit]) -> tuple[Limit, ...]:
    """Return limits on quantities of a model by name, in map coordinates; others as they are."""
    if not isinstance(given, Mapping):
        return tuple(given)
    return tuple(limit for name, bounds in given.items()
                 for limit in _conditions(dae, name, bounds))  # fmt: skip


def _conditions(dae: Model, name: str, bounds: float | Range) -> Iterator[Limit]:
    """Yield limits on a quantity, in map coordinates; one a wheel if it belongs to wheels."""
    low, high = (bounds, bounds) if isinstance(bounds, int | float) else bounds
    if not low <= high:
        raise ModelError(f"plan: bounds of {name} must ascend, found {low} to {high}")
    found = False
    for record, shift in (("x", dae.shift[0]), ("z", dae.shift[1]), ("u", None), ("y", None)):
        labels = list(leaves(getattr(dae.labels, record)))
        for k, (label, expression) in enumerate(
            zip(labels, leaves(getattr(dae, record)), strict=True)
        ):
            if name in (label.name, label.full):
                away = 0.0 if shift is None else float(shift[k])
                words = f"{label.words} is limited by the plan"
                own = replace(label, name=f"{label.name}_limit", words=words)
                yield Limit(own, expression, low - away, high - away)
                found = True
    if not found:
        dae.named(name)  # says which names there are


def _all_places(
    dae: Model,
    goal: Mapping[str, float | Range] | Sequence[Limit],
    way_points: Mapping[float, Mapping[str, float | Range]],
) -> Iterator[Place]:
    for fraction, wanted in sorted(way_points.items()):
        if not 0 < fraction < 1:
            raise ModelError(f"plan: way-points lie between 0 and 1, found {fraction}")
        yield Place(fraction, _place(dae, wanted))
    yield Place(1.0, _place(dae, goal))


def _place(dae: Model, wanted: Mapping[str, float | Range] | Sequence[Limit]) -> tuple[Limit, ...]:
    if not isinstance(wanted, Mapping):
        return tuple(wanted)
    return tuple(limit for name, value in wanted.items()
                 for limit in _conditions(dae, name, value))  # fmt: skip


def _bounds_of(dae: Model, given: Mapping[str, Range]) -> Array:
    names = [label.full for label in leaves(dae.labels.u)]
    bounds = np.tile([-np.inf, np.inf], (len(names), 1))
    for name, (low, high) in given.items():
        if name not in names:
            raise ModelError(f"plan: {name!r} is no input; inputs are {', '.join(names)}")
        if not low <= high:
            raise ModelError(f"plan: bounds of {name} must ascend, found {low} to {high}")
        bounds[names.index(name)] = low, high
    return bounds


def unknowns_of(program: Program, guess: Trajectory) -> Array:
    """Return the unknowns of a motion, stretched over the mesh."""
    task, layout = program.task, program.layout
    dae, degree = task.dae, program.mesh.degree
    unknowns = np.zeros(program.scale.size)
    length = float(np.clip(guess.t[-1] - guess.t[0], *task.duration))
    part = program.mesh.nodes * (guess.t[-1] - guess.t[0]) + guess.t[0]

    def at(record: str, count: int) -> Array:
        labels = list(leaves(getattr(dae.labels, record)))[:count]
        return np.array([np.interp(part, guess.t, guess.of(label)) for label in labels])

    n_z = layout.unknowns.shape[2]
    x, z = at("x", layout.first.size), at("z", n_z)
    x, z = x - dae.shift[0][:, None], z - dae.shift[1][:n_z, None]
    count = len(layout.inputs)
    unknowns[layout.first] = task.start
    unknowns[layout.states] = x[:, 1:].T.reshape(count, degree, -1)
    unknowns[layout.unknowns] = z[:, 1:].T.reshape(count, degree, -1)
    u = at("u", layout.inputs.shape[1])[:, 1:].reshape(-1, count, degree).mean(axis=2).T
    unknowns[layout.inputs] = np.clip(u, task.inputs[:, 0], task.inputs[:, 1])
    unknowns[layout.duration] = length
    return unknowns


def _weights(program: Program, part: float) -> Array:
    """Return the weights of the program with a part of that of the slip."""
    weights = [cost.weight * (part if cost.label.name in SLIP else 1.0)
               for cost in program.task.costs]  # fmt: skip
    return np.array([*weights, program.task.smooth])


def _staged(
    program: Program, first: Array, progress: Progress | None
) -> tuple[Solution, tuple[Stage, ...]]:
    """Return the solution, reached by raising the weight of the slip in stages."""
    slips = any(cost.label.name in SLIP and cost.weight for cost in program.task.costs)
    found, stages = _solved(program, first, "slip left out" if slips else "all",
                            STAGES[0] if slips else 1.0, progress)  # fmt: skip
    for part in STAGES[1:] if slips else ():
        if not found.success:
            break
        found, more = _solved(program, found.unknowns, "with slip", part, progress, found)
        stages += more
    return found, stages


def _solved(
    program: Program,
    first: Array,
    words: str,
    part: float,
    progress: Progress | None,
    warm: Solution | None = None,
) -> tuple[Solution, tuple[Stage, ...]]:
    look = None if progress is None else lambda iterate: progress(words, iterate)
    found = solve(program, _weights(program, part), first, warm=warm, look=look)
    return found, (Stage(words, found.iterations, found.status, found.seconds),)


def _missed(program: Program, found: Solution) -> list[Limit]:
    """Return the model's own limits that a plan violates and that are not in the program yet."""
    have = {limit.label.full for limit in program.task.limits}
    run = _sampled(program, found.unknowns)[0]
    missed = []
    for limit in program.task.dae.limits:
        values = run.of(limit.label)
        over = np.maximum(limit.lower - values, values - limit.upper).max()
        if over > WITHIN and limit.label.full not in have:
            missed.append(limit)
    return missed


def _carried(former: Program, program: Program, unknowns: Array) -> Array:
    """Return the unknowns of one program for another that may have more of them."""
    carried = np.zeros(program.scale.size)
    for old, new in zip(former.layout[:3], program.layout[:3], strict=True):
        carried[new] = unknowns[old]
    carried[program.layout.duration] = unknowns[former.layout.duration]
    old_count, count = former.layout.unknowns.shape[2], program.layout.unknowns.shape[2]
    carried[program.layout.unknowns[..., :old_count]] = unknowns[former.layout.unknowns]
    if count > old_count:
        z = _sampled(former, unknowns)[1].z
        fuller = z[old_count:count, 1:].T.reshape(*program.layout.unknowns.shape[:2], -1)
        carried[program.layout.unknowns[..., old_count:]] = fuller
    return carried


def _sampled(program: Program, unknowns: Array) -> tuple[Trajectory, Samples]:
    """Return the plan at the beginning and at all points."""
    layout, w, dae = program.layout, unknowns, program.task.dae
    degree, n_z = program.mesh.degree, layout.unknowns.shape[2]
    loop = close(dae, dae.inputs(**{label.full: 0.0 for label in leaves(dae.labels.u)}), 0)
    t = program.mesh.nodes * w[layout.duration]
    x = np.column_stack([w[layout.first], w[layout.states].reshape(-1, layout.first.size).T])
    inner = w[layout.unknowns].reshape(-1, n_z).T
    z = np.full((dae.scale.size, t.size), np.nan)
    z[:n_z] = np.column_stack([inner[:, :1], inner])
    u = np.repeat(w[layout.inputs].T, degree, axis=1)
    u = np.column_stack([u[:, :1], u])
    rates = np.array(loop.quad.map(t.size)(t[None], x, z[: loop.moving], u))[:, 1:]
    q = _integrated(rates.reshape(len(rates), -1, degree), np.diff(program.mesh.ends)
                    * w[layout.duration])  # fmt: skip
    samples, report = followed(loop, Samples(t, x, z, q, u))
    return table(loop, samples, report), samples


def _integrated(rates: Array, lengths: Array) -> Array:
    """Return integrals from zero to all points of rates at the points, shape (n_q, 1 + n k)."""
    count, degree = rates.shape[1:]
    inside = basis(degree).integrals(basis(degree).points)
    parts = np.einsum("pj,qij->qip", inside, rates) * lengths[:, None]
    before = np.cumsum(parts[:, :, -1], axis=1) - parts[:, :, -1]
    total = (parts + before[:, :, None]).reshape(len(rates), count * degree)
    return np.column_stack([np.zeros(len(rates)), total])


def _result(
    program: Program, found: Solution, stages: tuple[Stage, ...], start: Trajectory,
    tolerance: float,
) -> Plan:  # fmt: skip
    """Return the plan with the motion that its inputs lead to."""
    run, _ = _sampled(program, found.unknowns)
    values = ca.Function("f", [program.problem["x"], program.problem["p"]],
                         [program.problem["f"]])  # fmt: skip
    units = np.eye(program.problem["p"].numel())
    costs = {cost.label.name: float(values(found.unknowns / program.scale, unit))
             for cost, unit in zip(program.task.costs, units, strict=False)}  # fmt: skip
    inputs = _inputs(program, found)
    replay = _replayed(program, start, inputs, run, tolerance)
    n = replay.t.size if replay.stop is None else replay.t.size - 1
    names = list(leaves(program.task.dae.labels.x))
    difference = {label.full: float(np.abs(replay.of(label)[:n] - run.of(label)[:n]).max())
                  for label in names}  # fmt: skip
    return Plan(run, inputs, replay, difference, costs, found.success, program, found, stages)


def _inputs(program: Program, found: Solution) -> Any:
    names = [label.full for label in leaves(program.task.dae.labels.u)]
    values = found.unknowns[program.layout.inputs].T
    return program.task.dae.inputs(**dict(zip(names, values, strict=True)))


def _replayed(
    program: Program, start: Trajectory, inputs: Any, run: Trajectory, tolerance: float
) -> Trajectory:
    dae, degree = program.task.dae, program.mesh.degree
    names = [label.full for label in leaves(dae.labels.u)]
    finer = dae.inputs(**{name: np.repeat(value, degree)
                          for name, value in zip(names, leaves(inputs), strict=True)})  # fmt: skip
    try:
        return simulate(dae, start, finer, run.t, tolerance=tolerance)
    except SolverError as error:
        if error.trajectory is None:
            raise
        return error.trajectory
