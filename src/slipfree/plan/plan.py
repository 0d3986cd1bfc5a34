"""Plans: inputs that lead a vehicle from a start to a goal at the least cost, within limits.

The same model that is simulated is transcribed by collocation and solved by IPOPT. The inputs that
come out are simulated again; where that misses the plan, or a limit between its points, the mesh is
refined, and what remains belongs to the result.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.dae import Dae, Limit
from slipfree.errors import ModelError
from slipfree.forks import computing
from slipfree.interrupt import heeded
from slipfree.plan.constraints import WITHIN
from slipfree.plan.explanation import explanation
from slipfree.plan.ipopt import CAUTIOUS, STUCK, Iterate, Solution, solve, violation
from slipfree.plan.polynomial_motion import (
    PolynomialMotion,
    carried,
    course,
    nearest,
    sampled,
    unknowns_of,
)
from slipfree.plan.problem import Range, task_of
from slipfree.plan.transcription import Cost, Mesh, Program, Task, transcribe
from slipfree.plan.verification import Proof, inputs_along, prove, refined
from slipfree.plan.warm_start import Saved, local, saved
from slipfree.records import Array
from slipfree.trajectory import Stop, Trajectory

STAGES = (0.0, 1.0)  # parts of the slip's weight, one after the other
SLIP = ("slip", "slip_along", "slip_across")  # costs whose weight is raised in stages
ROUNDS = 4  # of adding limits that a plan violates
REFINEMENTS = 6  # of the mesh at most
STOPPED = "User_Requested_Stop"  # IPOPT's words when progress returns False
CLEAR = 1e-5  # by which plans keep clear of the model's limits, which end a simulation
STEP = 0.25  # between samples of the simulation at most [s]
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
    cost : float
        What it reached, all terms weighted as in this stage.
    """

    words: str
    iterations: int
    status: str
    seconds: dict[str, float]
    cost: float


@dataclass(frozen=True, eq=False)
class Plan:
    """A plan and its proof.

    Attributes
    ----------
    run : Trajectory
        The plan, sampled at the beginning and at all points of collocation.
    inputs : record
        What drives the model along it, for ``simulate`` at times ``course.ends``.
    course : PolynomialMotion
        The plan as polynomials of time.
    replay : Trajectory
        The model's motion under these inputs, integrated, several samples on every interval.
    difference : dict of str to float
        Largest difference between plan and replay in every state. [m, rad]
    violation : dict of str to float
        By how much the replay violates limits of the plan and what is asked for at goal and
        way-points, by name, each in its unit.
    costs : dict of str to float
        Integrals of the terms of the cost, in their units; that of the squared rates of the
        inputs as ``"smoothness"``.
    success : bool
        Whether the program was solved; a plan that was not is the best iterate.
    accurate : bool
        Whether differences and violations are within the accuracy asked for, and the replay
        reaches the end.
    program, solution : Program, Solution
        What was solved last.
    stages : tuple of Stage
        All that was solved.
    saved : Saved
        From which another plan may start.
    """

    run: Trajectory
    inputs: Any
    course: PolynomialMotion
    replay: Trajectory
    difference: dict[str, float]
    violation: dict[str, float]
    costs: dict[str, float]
    success: bool
    accurate: bool
    program: Program
    solution: Solution
    stages: tuple[Stage, ...]
    saved: Saved


class _Search(NamedTuple):
    """What has been solved so far, from which unknowns last, and on the way to it.

    ``run`` is the solution at its points, once it has been looked at.
    """

    program: Program
    found: Solution
    first: Array
    stages: tuple[Stage, ...]
    run: Trajectory | None = None


@computing
@heeded
def plan(
    dae: Dae,
    start: Trajectory,
    guess: Trajectory | Sequence[Trajectory],
    *,
    goal: Mapping[str, float | Range] | Sequence[Limit],
    costs: Mapping[str, float] | Sequence[Cost],
    duration: float | Range,
    smooth: float = 0.0,
    continuous: bool = True,
    limits: Mapping[str, Range] | Sequence[Limit] = (),
    way_points: Mapping[float, Mapping[str, float | Range]] | None = None,
    inputs: Mapping[str, Range] | None = None,
    accelerations: Mapping[str, Range] | None = None,
    intervals: int = 40,
    degree: int = 3,
    accuracy: float = 1e-3,
    tolerance: float = 1e-8,
    step: float = STEP,
    resume: Saved | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Return the inputs that reach a goal at the least cost, with the motion they lead to.

    Parameters
    ----------
    dae : Dae
        The model; its own limits hold as well: those that a plan would violate are added until none
        is. If it is to be compiled, the functions of the program are, too.
    start : Trajectory
        Its last sample is where the plan begins.
    guess : Trajectory or sequence of Trajectory
        Motions of the model from there, roughly to the goal, whose paths and inputs start the
        search; of several the one that leads to the least cost counts.
    goal : mapping of str to float or (low, high), or sequence of Limit
        Values or ranges of states and unknowns by name at the end, in map coordinates; or
        conditions in the model's symbols. [m, rad]
    costs : mapping of str to float, or sequence of Cost
        Weights by name: ``"slip"``, ``"effort"`` (squared inputs), ``"time"``, ``"energy"`` (work
        of the wheels' drives; what braking would give back is not counted), or the name of any
        quantity of the model, whose square is integrated over time and summed over the wheels
        (places in local coordinates).
    duration : float or (least, largest)
        How long it takes. [s]
    smooth : float
        Weight of the squared rates of the inputs, integrated over time.
    continuous : bool
        Whether inputs are continuous and linear on every interval; else they are constant on it.
    limits : mapping of str to (low, high), or sequence of Limit
        Along the way.
    way_points : mapping of float to mapping, optional
        Conditions like those of the goal at fractions of the duration.
    inputs, accelerations : mapping of str to (low, high), optional
        Bounds of inputs and of their rates; the inputs may begin with any value. [1/s, 1/s2]
    intervals, degree : int
        Of the collocation, to begin with.
    accuracy : float
        By how much the simulation may miss states of the plan and its limits, in their units; the
        mesh is refined where it misses them by more.
    tolerance, step : float
        Of the integrator that simulates the plan, and between its samples at most. [s]
    resume : Saved, optional
        A plan from which to start instead, on another mesh, ground or goal as well; from another
        place, what comes after the nearest one on its way counts.
    progress : callable, optional
        Called with words and every iterate; returning False ends the search, the best iterate kept.

    Raises
    ------
    ModelError
        If a name is not known, or start, goal and limits contradict each other.
    """
    clock = time.process_time()
    task = task_of(
        dae,
        start,
        goal=goal,
        costs=costs,
        duration=duration,
        smooth=smooth,
        continuous=continuous,
        limits=limits,
        way_points=way_points,
        inputs=inputs,
        accelerations=accelerations,
    )
    if intervals < 1:
        raise ModelError(f"plan: expected one interval or more, found {intervals}")
    ends = np.union1d(np.linspace(0, 1, intervals + 1), list(way_points or ()))
    mesh = Mesh(ends[np.append(True, np.diff(ends) > 1e-9)], degree)
    guesses = [guess] if isinstance(guess, Trajectory) else list(guess)
    if resume is None:
        search = _best(transcribe(task, mesh), guesses, progress)
    else:
        search = _resumed(task, mesh, resume, progress)

    def proved(search: _Search) -> Proof:
        return prove(
            search.program,
            search.found.unknowns,
            start,
            accuracy=accuracy,
            step=step,
            tolerance=tolerance,
        )

    search, proof = _refined(_within_limits(search, progress), proved, progress)
    result = _result(search, proof)
    iterations = sum(stage.iterations for stage in search.stages)
    statistics = {
        "cpu_seconds": time.process_time() - clock,
        "iterations": float(iterations),
        "compiled": float(search.program.compiled),
    }
    return replace(result, run=replace(result.run, statistics=statistics))


def _best(program: Program, guesses: Sequence[Trajectory], progress: Progress | None) -> _Search:
    """Return the solution of least cost of those that the guesses lead to."""
    best: _Search | None = None
    stages: tuple[Stage, ...] = ()
    for number, guess in enumerate(guesses, 1):
        of = f"start {number} of {len(guesses)}, " if len(guesses) > 1 else ""
        search = _staged(program, unknowns_of(program, guess), of, progress)
        stages += search.stages
        if best is None or _is_better(program, search.found, best.found):
            best = search
        if search.found.status == STOPPED:
            break
    if best is None:
        raise ModelError("plan: expected at least one motion to start from, found none")
    return best._replace(stages=stages)


def _is_better(program: Program, one: Solution, other: Solution) -> bool:
    if one.success != other.success:
        return one.success
    if not one.success:
        return violation(program, one.rows) < violation(program, other.rows)
    return one.cost < other.cost


def _staged(program: Program, first: Array, of: str, progress: Progress | None) -> _Search:
    """Return the solution, reached by raising the weight of the slip in stages."""
    slips = any(cost.label.name in SLIP and cost.weight for cost in program.task.costs)
    words = f"{of}slip left out" if slips else f"{of}all"
    search = _solved(program, first, words, STAGES[0] if slips else 1.0, progress)
    for part in STAGES[1:] if slips else ():
        if not search.found.success:
            break
        found = search.found
        more = _solved(program, found.unknowns, f"{of}with slip", part, progress, found)
        stages = search.stages + more.stages
        if not more.found.success and violation(program, more.found.rows) > WITHIN:
            # The plan of the stage before keeps to everything; only its slip is not the least.
            kept = found._replace(success=False, status=more.found.status)
            return search._replace(found=kept, first=first, stages=stages)
        search = more._replace(stages=stages)
    return search._replace(first=first)


def _resumed(task: Task, mesh: Mesh, resume: Saved, progress: Progress | None) -> _Search:
    """Return the solution, sought from another plan: with its multipliers if they are as many."""
    former = local(resume, task.dae)
    after = nearest(former, task.start)
    if former.mesh.degree == mesh.degree and set(mesh.ends) <= set(former.mesh.ends):
        mesh = former.mesh
    program = transcribe(task, mesh)
    first = carried(former, program, after)
    if reached := _missed(task, sampled(program, first), -2 * CLEAR):  # that plan may rest on them
        program = transcribe(replace(task, limits=(*task.limits, *reached)), mesh)
        first = carried(former, program, after)
    alike = (first.size, program.g_lower.size, after) == (
        former.unknowns.size,
        resume.row_multipliers.size,
        0.0,
    )
    warm = _without_multipliers(program, first)
    if alike:
        warm = warm._replace(
            row_multipliers=resume.row_multipliers, bound_multipliers=resume.bound_multipliers
        )
    return _solved(program, first, "resumed", 1.0, progress, warm)


def _solved(
    program: Program,
    first: Array,
    words: str,
    part: float,
    progress: Progress | None,
    warm: Solution | None = None,
) -> _Search:
    look = None if progress is None else lambda iterate: progress(words, iterate)
    weights = _weights(program, part)
    found = solve(program, weights, first, warm=warm, look=look)
    stages = [Stage(words, found.iterations, found.status, found.seconds, found.cost)]
    if found.status in STUCK:  # which rounding decides on long plans: it may have gone astray
        again = solve(program, weights, first, warm=warm, look=look, growth=CAUTIOUS)
        words = f"{words}, again"
        stages.append(Stage(words, again.iterations, again.status, again.seconds, again.cost))
        if again.success or violation(program, again.rows) < violation(program, found.rows):
            found = again
    return _Search(program, found, first, tuple(stages))


def _weights(program: Program, part: float) -> Array:
    """Return the weights of the program with a part of that of the slip."""
    weights = [
        cost.weight * (part if cost.label.name in SLIP else 1.0) for cost in program.task.costs
    ]
    return np.array([*weights, program.task.smooth])


def _within_limits(search: _Search, progress: Progress | None) -> _Search:
    """Return the search with those of the model's limits that a plan would violate."""
    for _ in range(ROUNDS):
        program, found = search.program, search.found
        if not found.success:
            return search
        run = sampled(program, found.unknowns)
        missed = _missed(program.task, run, WITHIN)
        if not missed:
            return search._replace(run=run)
        words = f"with {', '.join(limit.label.full for limit in missed)}"
        fuller = replace(program.task, limits=(*program.task.limits, *missed))
        search = _again(search, fuller, program.mesh, words, progress)
    return search


def _again(
    search: _Search, task: Task, mesh: Mesh, words: str, progress: Progress | None
) -> _Search:
    """Return the search gone on with another task or mesh."""
    former, program = course(search.program, search.found.unknowns), transcribe(task, mesh)
    first = carried(former, program)
    more = _solved(program, first, words, 1.0, progress, _without_multipliers(program, first))
    return more._replace(stages=search.stages + more.stages)


def _without_multipliers(program: Program, first: Array) -> Solution:
    """Return unknowns of another program as a solution to start from."""
    rows, bounds = np.zeros(program.g_lower.size), np.zeros(first.size)
    return Solution(first, rows, np.nan, rows, bounds, "", True, 0, {})


def _missed(task: Task, run: Trajectory, beyond: float) -> list[Limit]:
    """Return the model's own limits that a plan violates and that are not in its task yet.

    They come somewhat narrower.
    """
    have = {limit.label.full for limit in task.limits}
    missed = []
    for limit in task.dae.limits:
        values = run.of(limit.label)
        over = np.maximum(limit.lower - values, values - limit.upper).max()
        if over > beyond and limit.label.full not in have:
            missed.append(limit._replace(lower=limit.lower + CLEAR, upper=limit.upper - CLEAR))
    return missed


def _refined(
    search: _Search, proved: Callable[[_Search], Proof], progress: Progress | None
) -> tuple[_Search, Proof]:
    """Return the search on a mesh that is fine enough, and its proof; what it reached if none is.

    A program on a finer mesh that cannot be solved, or is stopped, leaves the solution before it.
    """
    proof = proved(search)
    for _ in range(REFINEMENTS):
        if not (search.found.success and proof.worse.any()):
            break
        mesh = refined(search.program.mesh, proof.worse)
        words = f"{mesh.ends.size - 1} intervals"
        finer = _within_limits(_again(search, search.program.task, mesh, words, progress), progress)
        if not finer.found.success:
            return search._replace(stages=finer.stages), proof
        search, proof = finer, proved(finer)
    return search, proof


def _result(search: _Search, proof: Proof) -> Plan:
    program, found, first, stages, run = search
    values = ca.Function("f", [program.problem["x"], program.problem["p"]], [program.problem["f"]])
    units = np.eye(program.problem["p"].numel())
    costs = {
        cost.label.name: float(values(found.unknowns / program.scale, unit))
        for cost, unit in zip(program.task.costs, units, strict=False)
    }
    if program.task.smooth:
        costs["smoothness"] = float(values(found.unknowns / program.scale, units[-1]))
    run = sampled(program, found.unknowns) if run is None else run
    if not found.success:
        words = (
            f"the plan is not solved; this is its last iterate: "
            f"{explanation(program, found, first)}"
        )
        run = replace(run, stop=Stop("plan", float(run.t[-1]), words))
    way = course(program, found.unknowns)
    return Plan(
        run,
        inputs_along(program.task.dae, way, way.ends),
        way,
        proof.replay,
        proof.difference,
        proof.violation,
        costs,
        found.success,
        proof.accurate,
        program,
        found,
        stages,
        saved(program, found),
    )
