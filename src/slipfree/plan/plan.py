"""Plan inputs that move a vehicle from a start to a goal at least cost within limits.

The model, which is also used for simulation, is transcribed by collocation into a program, and
IPOPT solves the program. The resulting inputs are verified by a simulation. The mesh is refined
where the simulation differs from the plan or violates a limit between collocation points; the
result contains the remaining differences and violations.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import attrgetter
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae, Limit
from slipfree.core.errors import ModelError
from slipfree.core.outcome import Outcome
from slipfree.core.records import Array, Record, field_overview, leaves, overview
from slipfree.core.trajectory import PLAN, PLAN_UNVERIFIED, Stop, Trajectory
from slipfree.plan.constraints import VIOLATION_TOLERANCE
from slipfree.plan.convergence import Convergence
from slipfree.plan.explanation import explanation
from slipfree.plan.ipopt import (
    OTHER_VIOLATION_GROWTH,
    STOPPED_STATUS,
    STUCK_STATUSES,
    Iterate,
    Solution,
    largest_violation,
    solve_program,
)
from slipfree.plan.optimality import Optimality, check_optimality
from slipfree.plan.polynomial_motion import (
    PolynomialMotion,
    guess_unknowns,
    motion_of,
    nearest_fraction,
    sample_plan,
    transfer_motion,
)
from slipfree.plan.prices import Price, limit_prices
from slipfree.plan.problem import Range, near_conditions, task_of
from slipfree.plan.stage import Cost
from slipfree.plan.starts import (
    INACCURATE,
    NOT_SOLVED,
    PATH_SAMPLES,
    SOLVED,
    VERIFIED,
    LocalOptimum,
    further_guesses,
)
from slipfree.plan.transcription import CollocationMesh, PlanTask, Program, transcribe
from slipfree.plan.verification import (
    Verification,
    inputs_along,
    largest_error,
    refine_mesh,
    verify_plan,
)
from slipfree.plan.warm_start import SavedPlan, local_motion, save_plan
from slipfree.solve.options import SolverOptions
from slipfree.system.forks import computing
from slipfree.system.interrupt import with_interrupt_guard

SLIP_STAGES = (0.0, 1.0)  # factors of the weight of the slip, one per stage
SLIP_COSTS = ("slip", "slip_along", "slip_across")  # costs whose weight is raised in stages
MAX_LIMIT_ROUNDS = 4  # largest number of times that violated limits are added
MAX_REFINEMENTS = 6  # largest number of refinements of the mesh
FUTILE_GROWTH = 4.0  # ratio of intervals after which an unchanged error has another cause
MIN_IMPROVEMENT = 0.8  # ratio of errors on a finer and a coarser mesh for a further refinement
LIMIT_CLEARANCE = 1e-5  # distance of plans from limits of the model, in their units
SAMPLE_STEP = 0.25  # largest time between samples of the simulation [s]
PlanProgress = Callable[[str, Iterate], bool]


class SolvedStage(NamedTuple):
    """Program that was solved during a search for a plan.

    Attributes
    ----------
    words : str
        Description of the program, such as ``"without slip cost"``.
    iterations : int
        Number of iterations.
    status : str
        Return status of IPOPT.
    seconds : dict of str to float
        Wall times: ``"total"``, ``"functions"`` (evaluations of the program) and ``"rest"``. [s]
    cost : float
        Final cost, with the weights of this stage.
    convergence : Convergence
        Cost, violation and barrier parameter of every iterate.
    """

    words: str
    iterations: int
    status: str
    seconds: dict[str, float]
    cost: float
    convergence: Convergence

    def __repr__(self) -> str:
        return field_overview(self)


@dataclass(frozen=True, eq=False)
class Plan:
    """A plan and its verification by simulation.

    Attributes
    ----------
    run : Trajectory
        Planned motion, sampled at the start and at all collocation points.
    inputs : record
        Planned inputs, for `simulate` at times ``motion.ends``.
    motion : PolynomialMotion
        Planned motion as polynomials of time.
    replay : Trajectory
        Simulated motion under these inputs, with several samples on every interval.
    difference : dict of str to float
        Largest difference between plan and replay for every state, in the unit of the state.
    violation : dict of str to float
        Violations of limits, goal and way-points by the replay, in the unit of the quantity.
    units : dict of str to str
        Units of differences and violations, by name.
    costs : dict of str to float
        Integral of each term of the cost, in its unit; ``"smoothness"`` is the integral of the
        squared rates of the inputs.
    success : bool
        Whether the program was solved; if not, the plan is an iterate of the search.
    accurate : bool
        Whether differences and violations are within the given accuracy, and the replay
        reaches the end of the plan.
    program, solution : Program, Solution
        Last program and its solution.
    stages : tuple of SolvedStage
        Programs that were solved, in order.
    saved : SavedPlan
        Unknowns and multipliers, for a warm start of another plan.
    optima : tuple of LocalOptimum
        Plans from all initial guesses, this plan first.
    """

    run: Trajectory
    inputs: Record
    motion: PolynomialMotion
    replay: Trajectory
    difference: dict[str, float]
    violation: dict[str, float]
    units: dict[str, str]
    costs: dict[str, float]
    success: bool
    accurate: bool
    program: Program
    solution: Solution
    stages: tuple[SolvedStage, ...]
    saved: SavedPlan
    optima: tuple[LocalOptimum, ...] = ()

    def __repr__(self) -> str:
        units = {cost.label.name: cost.label.unit for cost in self.program.task.costs}
        solved = "accurate" if self.accurate else "not accurate"
        iterations = sum(stage.iterations for stage in self.stages)
        return overview(
            f"Plan: {solved if self.success else 'not solved'}; {self.motion.duration:.6g} s on "
            f"{self.motion.ends.size - 1} intervals, {iterations} iterations",
            costs=(f"{name} {cost:.4g} {units.get(name, '')}" for name, cost in self.costs.items()),
            differences=(f"{name} {size:.1e}" for name, size in self.difference.items()),
            violations=(f"{name} {size:.1e}" for name, size in self.violation.items() if size),
            inputs=(label.full for label in leaves(self.program.task.dae.labels.u)),
        )

    @property
    def compiled(self) -> bool:
        """Whether the functions of the program are compiled."""
        return self.program.compiled

    @cached_property
    def optimality(self) -> Optimality | None:
        """Second-order conditions at the solution; None if the program was not solved."""
        if not self.success:
            return None
        return check_optimality(self.program, self.solution, _cost_weights(self.program, 1.0))

    @cached_property
    def prices(self) -> tuple[Price, ...]:
        """Shadow prices of active limits, largest saving first; empty if ``success`` is False."""
        return limit_prices(self.program, self.solution) if self.success else ()


class _SearchState(NamedTuple):
    """Last solved program of a search, its solution, its initial guess, and all stages so far.

    ``run`` is the sampled solution, or None if it has not been sampled; ``name`` and ``number`` are
    those of the initial guess.
    """

    program: Program
    found: Solution
    first: Array
    stages: tuple[SolvedStage, ...]
    run: Trajectory | None = None
    name: str = ""
    number: int = 0


@computing
@with_interrupt_guard
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
    cost_limits: Mapping[str, float] | None = None,
    initial_inputs: Mapping[str, float] | None = None,
    intervals: int = 40,
    degree: int = 3,
    accuracy: float = 1e-3,
    options: SolverOptions = SolverOptions(),
    step: float = SAMPLE_STEP,
    starts: int = 1,
    seed: int = 0,
    resume: SavedPlan | None = None,
    progress: PlanProgress | None = None,
    keep: Callable[[Plan], None] | None = None,
) -> Plan:
    """Return the inputs that reach a goal at least cost, with the resulting motion.

    Parameters
    ----------
    dae : Dae
        Model of the vehicle. The plan also satisfies the limits of the model: violated limits are
        added to the program, which is then solved again.
    start : Trajectory
        Trajectory whose last sample is the start of the plan.
    guess : Trajectory or sequence of Trajectory
        Motions of the model from the start roughly to the goal, as initial guesses. The result is
        the verified plan of least cost from all guesses, or, if the simulation verifies none, the
        plan of least cost.
    goal : mapping of str to float or (low, high), or sequence of Limit
        Values or ranges of states and algebraic unknowns at the end, by name, in map coordinates;
        or conditions in the model's symbols. A heading, or a joint without stop and spring, is the
        same after a whole turn: a value more than half a turn from the start and the first guess
        is replaced by the one nearest to the start. [m, rad]
    costs : mapping of str to float, or sequence of Cost
        Weights by name: ``"slip"``, ``"effort"`` (squared inputs), ``"time"``, ``"energy"`` (work
        of the wheels' drives; braking recovers no energy), or any quantity of the model, whose
        square is integrated over time and summed over the wheels (positions in local coordinates,
        see `Dae`). Alternatively, terms with other expressions: `Cost`.
    duration : float or (shortest, longest)
        Duration of the plan. [s]
    smooth : float
        Weight of the squared rates of the inputs, integrated over time.
    continuous : bool
        Whether inputs are continuous and linear on every interval; otherwise they are constant.
    limits : mapping of str to (low, high), or sequence of Limit
        Ranges of quantities by name during the whole plan, in map coordinates; or limits in the
        model's symbols.
    way_points : mapping of float to mapping, optional
        Conditions like those of the goal at fractions of the duration.
    inputs, accelerations : mapping of str to (low, high), optional
        Bounds of inputs and of their rates by name. [1/s, 1/s2]
    cost_limits : mapping of str to float, optional
        Largest integrals of terms of the cost, by name as in ``costs``, in the units of the terms;
        terms without a weight are only limited.
    initial_inputs : mapping of str to float, optional
        Values of inputs at the beginning by name, for example zero for a vehicle at rest; the
        others are free within their bounds. [1/s]
    intervals, degree : int
        Initial number of intervals, and number of collocation points per interval.
    accuracy : float
        Largest admissible difference of the simulation from the plan, in the unit of the quantity.
        The admissible violation of a limit is the smaller of ``accuracy`` and 1 % of its range; for
        equal bounds it is ``accuracy``. The mesh is refined where they are exceeded.
    options : SolverOptions
        Options of the solvers; the plan is simulated with a hundredth of the tolerance.
    step : float
        Largest time between samples of the simulation. [s]
    starts : int
        Number of initial guesses to try if ``guess`` has fewer. Further guesses are simulated with
        the inputs of the first guess: first with negated inputs if the bounds allow it, then with
        randomly perturbed inputs. A guess whose motion ends too early is omitted. ``Plan.optima``
        lists the plans from all guesses.
    seed : int
        Seed of the random perturbations.
    resume : SavedPlan, optional
        Plan from which the search starts instead of from ``guess``. Its mesh, ground and goal may
        differ. If it starts in another state, only its part after the nearest state is used.
    progress : callable, optional
        Function called with a description of the program and every iterate. If it returns False,
        the search ends, and the plan is the iterate with the smallest violation.
    keep : callable, optional
        Function called with each plan before the simulation that verifies it. ``replay`` is then
        the planned motion, whose stop says that it is not verified.

    Returns
    -------
    Plan
        Plan with ``inputs``, the planned motion ``run``, and its simulation ``replay``. A search
        that finds no solution returns an iterate: see ``success``, ``accurate`` and ``run.stop``.

    Raises
    ------
    ModelError
        If a name is unknown, a number is not valid, start, goal and limits contradict each other,
        no goal or guess is given, ``resume`` is a plan of another model, or a lookup of the model
        lacks derivatives.
    SolverError
        If a further guess or the plan cannot be simulated from the start.

    Examples
    --------
    A cart drives to a goal 1 m ahead and 5 cm to the right. The squared roll rate is an additional
    cost.

    >>> import casadi as ca
    >>> import numpy as np
    >>> from slipfree import Analytic, Cost, catalog, direct_kinematics
    >>> from slipfree import plan, settle, simulate, straight
    >>> vehicle = catalog.three_wheeler(axle="fixed")
    >>> model = direct_kinematics(vehicle, Analytic(lambda x, y: 0.1 * x * y))
    >>> start = settle(model)
    >>> law = straight(model, vehicle, start, speed=0.25)
    >>> guess = simulate(model, start, law, np.linspace(0, 4, 9))
    >>> costs = [
    ...     Cost("rolling", model.z.rates.roll**2, "rad2 s-1", "squared roll rate"),
    ...     Cost("effort", ca.sumsqr(ca.vertcat(*model.u.wheels)), "rad2 s-1", "squared inputs"),
    ... ]
    >>> found = plan(
    ...     model, start, guess, goal={"x": 0.05, "y": 1.0}, costs=costs, duration=4.0, intervals=4
    ... )
    >>> found.success, found.accurate
    (True, True)
    >>> print(f"ends at ({found.replay['x'][-1]:.3f}, {found.replay['y'][-1]:.3f})")
    ends at (0.050, 1.000)
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
        cost_limits=cost_limits,
        initial_inputs=initial_inputs,
    )
    for name, number in (("intervals", intervals), ("starts", starts)):
        if number < 1:
            raise ModelError(f"plan: {name}: expected 1 or more, found {number}; increase it")
    ends = np.union1d(np.linspace(0, 1, intervals + 1), list(way_points or ()))
    mesh = CollocationMesh(ends[np.append(True, np.diff(ends) > 1e-9)], degree)
    given = [guess] if isinstance(guess, Trajectory) else list(guess)
    task = _with_near_conditions(task, given, resume)
    if resume is None:
        guesses = _named_guesses(task, start, given, starts, seed)
        searches = _solve_guesses(transcribe(task, mesh, options), guesses, progress)
    else:
        searches = [_solve_resumed(task, mesh, resume, options, progress)]

    def verify(search: _SearchState) -> Verification:
        program, unknowns = search.program, search.found.unknowns
        if keep is not None:
            keep(_unverified(search))
        return verify_plan(program, unknowns, start, accuracy=accuracy, step=step)

    search, verification, optima = _best_verified(searches, verify, progress)
    result = replace(_to_plan(search, verification), optima=optima)
    iterations = sum(stage.iterations for stage in search.stages)
    statistics = {
        "cpu_seconds": time.process_time() - clock,
        "iterations": float(iterations),
        "compiled": float(search.program.compiled),
    }
    return replace(result, run=replace(result.run, statistics=statistics))


def _with_near_conditions(
    task: PlanTask, guesses: Sequence[Trajectory], resume: SavedPlan | None
) -> PlanTask:
    """Return a task whose angles at goal and way-points are within half a turn of start or guess.

    A guess that turns around keeps a goal that asks for it; otherwise the short way is taken.
    """
    dae = task.dae
    motions: list[Callable[[float], Array]] = [lambda _: task.start]
    if resume is not None:
        former = local_motion(resume, dae)
        motions.append(lambda fraction: former.states(np.array([fraction]))[:, 0])
    elif guesses:
        t = guesses[0].t
        motions.append(
            lambda part: dae.rows(
                "x", guesses[0], int(np.abs(t - t[0] - part * np.ptp(t)).argmin())
            )
        )
    return replace(task, conditions=near_conditions(dae, task.conditions, task.periodic, motions))


def _named_guesses(
    task: PlanTask, start: Trajectory, given: Sequence[Trajectory], starts: int, seed: int
) -> list[tuple[str, Trajectory]]:
    """Return names and motions of initial guesses: those given, then further ones up to ``starts``.

    Raises
    ------
    ModelError
        If no guess is given.
    """
    if not given:
        raise ModelError(
            "plan: guess: expected at least one motion as initial guess, found none; give one, "
            "such as a simulated motion"
        )
    named = [(f"guess {number}", each) for number, each in enumerate(given, 1)]
    missing = max(starts - len(given), 0)
    return [*named, *further_guesses(task.dae, start, given[0], task.inputs, missing, seed)]


def _solve_guesses(
    program: Program, guesses: Sequence[tuple[str, Trajectory]], progress: PlanProgress | None
) -> list[_SearchState]:
    """Solve the program from each guess, and return the solutions, best first."""
    found: list[_SearchState] = []
    for number, (name, guess) in enumerate(guesses, 1):
        of = f"guess {number} of {len(guesses)}, " if len(guesses) > 1 else ""
        search = _solve_in_stages(program, guess_unknowns(program, guess), of, progress)
        found.append(search._replace(name=name, number=number))
        if search.found.status == STOPPED_STATUS:
            break
    return sorted(found, key=partial(_rank, program))


def _best_verified(
    searches: Sequence[_SearchState],
    verify: Callable[[_SearchState], Verification],
    progress: PlanProgress | None,
) -> tuple[_SearchState, Verification, tuple[LocalOptimum, ...]]:
    """Return the best search with its verification, and a table of all searches.

    The solutions of the searches are refined and simulated in order, until a simulation is
    accurate, a program is not solved or the user stops the search. The best search is the accurate
    one, or the first one if none is accurate.
    """
    tried: list[tuple[_SearchState, Verification]] = []
    for search in searches:
        tried.append(_refine(_add_limits(search, progress), verify, progress))
        last, verification = tried[-1]
        stopped = last.stages[-1].status == STOPPED_STATUS
        if verification.accurate or not last.found.success or stopped:
            break
    best = tried[-1] if tried[-1][1].accurate and tried[-1][0].found.success else tried[0]
    kept = [each for each, _ in tried] + list(searches[len(tried) :])
    rows = [
        _local_optimum(each, tried[k][1].accurate if k < len(tried) else None)
        for k, each in enumerate(kept)
    ]
    first = next(k for k, each in enumerate(kept) if each is best[0])
    others = sorted((row for k, row in enumerate(rows) if k != first), key=lambda row: row.rank)
    stages = [stage for each in sorted(searches, key=attrgetter("number")) for stage in each.stages]
    pairs = [(one[0], before) for one, before in zip(tried, searches, strict=False)]
    for after, before in sorted(pairs, key=lambda pair: pair[0] is best[0]):
        stages += after.stages[len(before.stages) :]
    return best[0]._replace(stages=tuple(stages)), best[1], (rows[first], *others)


def _local_optimum(search: _SearchState, accurate: bool | None) -> LocalOptimum:
    """Return the row of a search in the table of optima; ``accurate`` is None if not simulated."""
    program, found = search.program, search.found
    outcomes = {None: SOLVED, True: VERIFIED, False: INACCURATE}
    motion, names = motion_of(program, found.unknowns), ["x", "y"]
    states = [label.full for label in leaves(program.task.dae.labels.x)]
    rows = [states.index(name) for name in names if name in states]
    return LocalOptimum(
        search.name,
        outcomes[accurate] if found.success else NOT_SOLVED,
        found.cost,
        cost_terms(program, found.unknowns),
        motion.duration,
        sum(stage.seconds["total"] for stage in search.stages),
        motion.states(np.linspace(0, 1, PATH_SAMPLES))[rows],
    )


def _rank(program: Program, search: _SearchState) -> tuple[bool, float]:
    """Return the sort key of a search: solved programs by cost, then others by violation."""
    found = search.found
    return not found.success, found.cost if found.success else largest_violation(
        program, found.rows
    )


def _solve_in_stages(
    program: Program, first: Array, of: str, progress: PlanProgress | None
) -> _SearchState:
    """Solve the program; if slip is a cost, first solve the program without this cost.

    The search with all costs starts from the solution without slip cost.
    """
    slips = any(cost.label.name in SLIP_COSTS and cost.weight for cost in program.task.costs)
    words = f"{of}without slip cost" if slips else f"{of}all costs"
    search = _solve_stage(program, first, words, SLIP_STAGES[0] if slips else 1.0, progress)
    for part in SLIP_STAGES[1:] if slips else ():
        if not search.found.success:
            break
        found = search.found
        more = _solve_stage(program, found.unknowns, f"{of}with slip cost", part, progress, found)
        stages = search.stages + more.stages
        if (
            not more.found.success
            and largest_violation(program, more.found.rows) > VIOLATION_TOLERANCE
        ):
            # The previous plan meets all constraints, although its slip is not minimal.
            kept = found._replace(success=False, status=more.found.status)
            return search._replace(found=kept, first=first, stages=stages)
        search = more._replace(stages=stages)
    return search._replace(first=first)


def _solve_resumed(
    task: PlanTask,
    mesh: CollocationMesh,
    resume: SavedPlan,
    options: SolverOptions,
    progress: PlanProgress | None,
) -> _SearchState:
    """Solve from a saved plan, with its multipliers if the programs have equal sizes."""
    former = local_motion(resume, task.dae)
    after = nearest_fraction(former, task.start)
    if former.mesh.degree == mesh.degree and set(mesh.ends) <= set(former.mesh.ends):
        mesh = former.mesh
    program = transcribe(task, mesh, options)
    first = transfer_motion(former, program, after)
    if reached := _violated_limits(
        task, sample_plan(program, first), -2 * LIMIT_CLEARANCE
    ):  # limits that are active in the saved plan
        program = transcribe(replace(task, limits=(*task.limits, *reached)), mesh, options)
        first = transfer_motion(former, program, after)
    alike = (first.size, program.g_lower.size, after) == (
        former.unknowns.size,
        resume.row_multipliers.size,
        0.0,
    )
    warm = _warm_guess(program, first)
    if alike:
        warm = warm._replace(
            row_multipliers=resume.row_multipliers, bound_multipliers=resume.bound_multipliers
        )
    return _solve_stage(program, first, "resumed", 1.0, progress, warm)


def _solve_stage(
    program: Program,
    first: Array,
    words: str,
    part: float,
    progress: PlanProgress | None,
    warm: Solution | None = None,
) -> _SearchState:
    on_iterate = None if progress is None else lambda iterate: progress(words, iterate)
    weights = _cost_weights(program, part)
    found = solve_program(program, weights, first, warm=warm, on_iterate=on_iterate)
    stages = [_stage_of(words, found)]
    if found.status in STUCK_STATUSES:  # rounding decides whether searches for long plans succeed
        again = solve_program(
            program,
            weights,
            first,
            warm=warm,
            on_iterate=on_iterate,
            growth=OTHER_VIOLATION_GROWTH,
        )
        words = f"{words}, again"
        stages.append(_stage_of(words, again))
        if again.success or largest_violation(program, again.rows) < largest_violation(
            program, found.rows
        ):
            found = again
    return _SearchState(program, found, first, tuple(stages))


def _stage_of(words: str, found: Solution) -> SolvedStage:
    return SolvedStage(
        words, found.iterations, found.status, found.seconds, found.cost, found.convergence
    )


def _cost_weights(program: Program, part: float) -> Array:
    """Return the weights of the program; those of slip are multiplied by ``part``."""
    weights = [
        cost.weight * (part if cost.label.name in SLIP_COSTS else 1.0)
        for cost in program.task.costs
    ]
    return np.array([*weights, program.task.smooth])


def _add_limits(search: _SearchState, progress: PlanProgress | None) -> _SearchState:
    """Add violated limits of the model to the program and solve it, until none is violated.

    The program is solved again at most `MAX_LIMIT_ROUNDS` times.
    """
    for _ in range(MAX_LIMIT_ROUNDS):
        program, found = search.program, search.found
        if not found.success:
            return search
        run = sample_plan(program, found.unknowns)
        missed = _violated_limits(program.task, run, VIOLATION_TOLERANCE)
        if not missed:
            return search._replace(run=run)
        words = f"with {', '.join(limit.label.full for limit in missed)}"
        fuller = replace(program.task, limits=(*program.task.limits, *missed))
        search = _solve_anew(search, fuller, program.mesh, words, progress)
    return search


def _solve_anew(
    search: _SearchState,
    task: PlanTask,
    mesh: CollocationMesh,
    words: str,
    progress: PlanProgress | None,
) -> _SearchState:
    """Solve with another task or mesh, starting from the solution of the search."""
    former = motion_of(search.program, search.found.unknowns)
    program = transcribe(task, mesh, search.program.options)
    first = transfer_motion(former, program)
    more = _solve_stage(program, first, words, 1.0, progress, _warm_guess(program, first))
    stages = search.stages + more.stages
    return more._replace(stages=stages, name=search.name, number=search.number)


def _warm_guess(program: Program, first: Array) -> Solution:
    """Return a solution with the given unknowns and zero multipliers, for a warm start."""
    rows, bounds = np.zeros(program.g_lower.size), np.zeros(first.size)
    return Solution(first, rows, np.nan, rows, bounds, "", True, 0, {})


def _violated_limits(task: PlanTask, run: Trajectory, beyond: float) -> list[Limit]:
    """Return the limits of the model that a plan violates and that its task lacks.

    A violation counts if it is larger than ``beyond``, which is negative to include limits that
    the plan almost reaches. The returned limits are narrower by `LIMIT_CLEARANCE` on both sides.
    """
    have = {limit.label.full for limit in task.limits}
    missed = []
    for limit in task.dae.limits:
        values = run.of(limit.label)
        over = np.maximum(limit.lower - values, values - limit.upper).max()
        if over > beyond and limit.label.full not in have:
            missed.append(
                limit._replace(
                    lower=limit.lower + LIMIT_CLEARANCE, upper=limit.upper - LIMIT_CLEARANCE
                )
            )
    return missed


def _refine(
    search: _SearchState,
    verify: Callable[[_SearchState], Verification],
    progress: PlanProgress | None,
) -> tuple[_SearchState, Verification]:
    """Return the solution on a refined mesh, and its verification.

    The mesh is refined until no interval has to be refined, or until a mesh with `FUTILE_GROWTH`
    times the intervals has not reduced the error: it then has another cause, such as an unstable
    motion (a caster driven backwards), and the most accurate solution is returned. If another
    model is simulated, one refinement without success suffices. The mesh is refined at most
    `MAX_REFINEMENTS` times. If the program on a finer mesh is not solved, the solution on the
    coarser mesh is returned.
    """
    verification = verify(search)
    solved = [(search, verification)]
    for _ in range(MAX_REFINEMENTS):
        if not (search.found.success and verification.worse.any()):
            break
        mesh = refine_mesh(search.program.mesh, verification.worse)
        words = f"{mesh.ends.size - 1} intervals"
        finer = _add_limits(
            _solve_anew(search, search.program.task, mesh, words, progress), progress
        )
        if not finer.found.success:
            return search._replace(stages=finer.stages), verification
        search, verification = finer, verify(finer)
        solved.append((search, verification))
        errors = [largest_error(each.program, found) for each, found in solved]
        counts = [each.program.mesh.ends.size - 1 for each, _ in solved]
        growth = 1.0 if search.program.task.dae.replay else FUTILE_GROWTH
        before = [e for e, n in zip(errors[:-1], counts, strict=False) if growth * n <= counts[-1]]
        if before and errors[-1] > MIN_IMPROVEMENT * before[-1]:
            best, verification = solved[errors.index(min(errors))]
            return best._replace(stages=search.stages), verification
    return search, verification


def _to_plan(search: _SearchState, verification: Verification) -> Plan:
    program, found, first, _, run, *_ = search
    run = sample_plan(program, found.unknowns) if run is None else run
    if not found.success:
        why = explanation(program, found, first)
        run = replace(run, stop=Stop(PLAN, float(run.t[-1]), why.words, why.outcome))
    return _as_plan(search, run, verification)


def _unverified(search: _SearchState) -> Plan:
    """Return a plan without verification; its stop says so."""
    program, found = search.program, search.found
    run = sample_plan(program, found.unknowns) if search.run is None else search.run
    name, words = PLAN, "the search for a plan was interrupted"
    if found.status == STOPPED_STATUS:
        words = explanation(program, found, search.first).words
    elif found.success:
        name = PLAN_UNVERIFIED
        words = "the plan is solved, but the simulation that verifies it did not end"
    run = replace(run, stop=Stop(name, float(run.t[-1]), words, Outcome.INTERRUPTED))
    nothing = np.zeros(program.mesh.ends.size - 1, dtype=bool)
    verification = Verification(run, {}, {}, {}, nothing, accurate=False)
    return _as_plan(search, run, verification)


def _as_plan(search: _SearchState, run: Trajectory, verification: Verification) -> Plan:
    """Return the plan of a search with its samples ``run`` and its verification."""
    program, found, stages = search.program, search.found, search.stages
    motion = motion_of(program, found.unknowns)
    return Plan(
        run,
        inputs_along(program.task.dae, motion, motion.ends),
        motion,
        verification.replay,
        verification.difference,
        verification.violation,
        verification.units,
        cost_terms(program, found.unknowns),
        found.success,
        verification.accurate,
        program,
        found,
        stages,
        save_plan(program, found),
    )


def cost_terms(program: Program, unknowns: Array) -> dict[str, float]:
    """Return the integrals of the terms of the cost by name, in their units.

    The unknowns are not scaled.
    """
    values = ca.Function("f", [program.problem["x"], program.problem["p"]], [program.problem["f"]])
    units = np.eye(program.problem["p"].numel())
    costs = {
        cost.label.name: float(values(unknowns / program.scale, unit))
        for cost, unit in zip(program.task.costs, units, strict=False)
    }
    if program.task.smooth:
        costs["smoothness"] = float(values(unknowns / program.scale, units[-1]))
    return costs
