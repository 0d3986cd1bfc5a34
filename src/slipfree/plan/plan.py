"""Plan inputs that move a vehicle from a start to a goal at least cost within limits.

The model, which is also used for simulation, is transcribed by collocation into a program, and
IPOPT solves the program. The resulting inputs are verified by a simulation. The mesh is refined
where the simulation differs from the plan or violates a limit between collocation points; the
result contains the remaining differences and violations.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.dae import Dae
from slipfree.core.records import Array, Record, overview
from slipfree.core.schema import NonNegative, Positive
from slipfree.core.trajectory import (
    PLAN,
    PLAN_UNVERIFIED,
    Drawable,
    Outcome,
    Stop,
    Trajectory,
    path_length,
)
from slipfree.plan import problem
from slipfree.plan.constraints import with_first_limits
from slipfree.plan.explanation import explanation, more_time
from slipfree.plan.guess import initial_guess
from slipfree.plan.ipopt import NOT_LEAST, STOPPED_STATUS, TIME_STATUS, NlpSolution
from slipfree.plan.optimality import Optimality, Price, check_optimality, limit_prices
from slipfree.plan.polynomial_motion import (
    PolynomialMotion,
    SavedPlan,
    local_motion,
    motion_of,
    sample_plan,
    save_plan,
)
from slipfree.plan.search import (
    LocalOptimum,
    Search,
    SearchState,
    SolvedStage,
    best_verified,
    cost_terms,
    cost_weights,
    further_guesses,
    solve_guesses,
    solve_relaxed,
    solve_resumed,
)
from slipfree.plan.stage import Cost
from slipfree.plan.transcription import CollocationMesh, Mesh, PlanTask, Program
from slipfree.plan.verification import Verification, inputs_along, verify_plan
from slipfree.solve.system import SolverOptions
from slipfree.system.forks import cached_property, computing
from slipfree.system.interrupt import with_interrupt_guard

MIN_INTERVALS = 40  # least default number of intervals
INTERVAL_SIZES = 2.0  # largest length of a default interval, in sizes of the vehicle
FAILED_TOLERANCE = 1e-4  # as `options.tolerance`, for the iterate of a failed search
SEARCH_SHARE = 0.8  # of the time limit; the rest is for the verification or the explanation


@dataclass(frozen=True, eq=False)
class SimulatedPlan:
    """A planned motion and its verification by simulation.

    Attributes
    ----------
    motion : PolynomialMotion
        Planned motion as polynomials of time.
    replay : Trajectory
        Simulated motion under its inputs, with several samples on every interval.
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
    stages : tuple of SolvedStage
        Programs that were solved, in order.
    saved : SavedPlan
        Unknowns and multipliers, for a warm start of another plan.
    """

    motion: PolynomialMotion
    replay: Trajectory
    difference: dict[str, float]
    violation: dict[str, float]
    units: dict[str, str]
    costs: dict[str, float]
    success: bool
    accurate: bool
    stages: tuple[SolvedStage, ...]
    saved: SavedPlan

    def described(self, extent: str, units: Mapping[str, str], **further: Iterable[str]) -> str:
        """Return the `repr` of a plan with its extent in words and the units of its costs."""
        solved = "accurate" if self.accurate else "not accurate"
        return overview(
            f"{type(self).__name__}: {solved if self.success else 'not solved'}; "
            f"{self.motion.duration:.6g} s {extent}",
            costs=(
                f"{name} {cost:.4g} {units.get(name, '')}".rstrip()
                for name, cost in self.costs.items()
            ),
            differences=(f"{name} {size:.1e}" for name, size in self.difference.items()),
            violations=(f"{name} {size:.1e}" for name, size in self.violation.items() if size),
            **further,
        )


@dataclass(frozen=True, eq=False, repr=False)
class Plan(SimulatedPlan, Drawable):
    """A plan and its verification by simulation; see `SimulatedPlan` for further attributes.

    Attributes
    ----------
    run : Trajectory
        Planned motion, sampled at the start and at all collocation points.
    inputs : record
        Planned inputs, for `simulate` at times ``motion.ends``.
    program, solution : Program, NlpSolution
        Last program and its solution.
    optima : tuple of LocalOptimum
        Plans from all initial guesses, this plan first.
    """

    run: Trajectory
    inputs: Record
    program: Program
    solution: NlpSolution
    optima: tuple[LocalOptimum, ...] = ()

    def __repr__(self) -> str:
        units = {cost.label.name: cost.label.unit for cost in self.program.task.costs}
        iterations = sum(stage.iterations for stage in self.stages)
        why = "" if self.success or self.run.stop is None else f"{self.run.stop.words}\n"
        extent = f"on {self.motion.ends.size - 1} intervals, {iterations} iterations"
        return why + self.described(extent, units, inputs=self.program.task.dae.input_names)

    @property
    def ground(self) -> object:
        """Ground of the plan."""
        return self.program.task.dae.ground

    @property
    def compiled(self) -> bool:
        """Whether the functions of the program are compiled."""
        return self.program.compiled

    @cached_property
    def optimality(self) -> Optimality | None:
        """Second-order conditions at the solution; None if the program was not solved."""
        if not self.success or self.solution.status in NOT_LEAST:
            return None
        return check_optimality(self.program, self.solution, cost_weights(self.program, 1.0))

    @cached_property
    def prices(self) -> tuple[Price, ...]:
        """Shadow prices of active limits, largest saving first; empty if ``success`` is False."""
        is_optimal = self.success and self.solution.status not in NOT_LEAST
        return limit_prices(self.program, self.solution) if is_optimal else ()


@checked
def plan(
    model: Dae,
    start: Trajectory,
    guess: Trajectory | Sequence[Trajectory] | None = None,
    *,
    goal: problem.Conditions,
    costs: Mapping[str, NonNegative] | Sequence[Cost],
    duration: float | problem.Range | None = None,
    smooth: NonNegative = 0.0,
    limits: problem.Conditions = (),
    way_points: Mapping[float, problem.Conditions] | None = None,
    inputs: Mapping[str, problem.Range] | None = None,
    accelerations: Mapping[str, problem.Range] | None = None,
    cost_limits: Mapping[str, Positive] | None = None,
    initial_inputs: Mapping[str, float] | None = None,
    mesh: Mesh = Mesh(),
    search: Search = Search(),
    options: SolverOptions = SolverOptions(),
) -> Plan:
    """Return the inputs that reach a goal at least cost, with the resulting motion.

    Parameters
    ----------
    model : Dae
        Model of the vehicle. The plan also satisfies the limits of the model: violated limits are
        added to the program, which is then solved again.
    start : Trajectory
        Trajectory whose last sample is the start of the plan.
    guess : Trajectory or sequence of Trajectory, optional
        Motions of the model from the start roughly to the goal, as initial guesses. The result is
        the verified plan of least cost from all guesses, or, if the simulation verifies none, the
        plan of least cost. By default one guess is made: the vehicle drives directly to the goal,
        or along a route over a map where that is cheaper; in reverse gear, too, to a goal that it
        cannot reach by turning forwards (`slipfree.plan.guess`).
    goal : mapping of str to float or (low, high), or sequence of Limit
        Values or ranges of states and algebraic unknowns at the end, by name, in map coordinates;
        or conditions in the model's symbols. A heading, or a joint without stop and spring, is the
        same after a whole turn: a value more than half a turn from the start and the first guess
        is replaced by the one nearest to the start. [m, rad]
    costs : mapping of str to float, or sequence of Cost
        Weights by name: ``"slip"``, ``"effort"`` (squared inputs), ``"time"``, ``"energy"`` (work
        of the wheels' drives; braking recovers no energy), ``"clearance_body"`` (its inverse
        square), or any quantity of the model, whose square is integrated over time and summed over
        the wheels (positions in local coordinates, see `Dae`). Alternatively, terms with other
        expressions: `Cost`.
    duration : float or (shortest, longest), optional
        Duration of the plan; by default from half to twice that of the initial guess. [s]
    smooth : float
        Weight of the squared rates of the inputs, integrated over time.
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
    mesh : Mesh
        Intervals of the first mesh, form of the inputs, accuracy and sampling of the simulation.
    search : Search
        Further initial guesses, an earlier plan to start from, and functions that observe the
        search.
    options : SolverOptions
        Options of the solvers; the plan is simulated with 0.003 times the tolerance.

    Returns
    -------
    Plan
        Plan with ``inputs``, the planned motion ``run``, and its simulation ``replay``. A search
        that finds no solution returns an iterate, and the explanation in ``run.stop``; see also
        ``success`` and ``accurate``.

    Raises
    ------
    ModelError
        If an argument has a wrong type, a name is unknown, a number is not valid, start, goal and
        limits contradict each other, no goal is given, no guess is given for a model whose vehicle
        is unknown or is not driven by rates, ``search.resume`` is a plan of another model, or a
        lookup of the model lacks derivatives.
    SolverError
        If a guess that is made or the plan cannot be simulated from the start.

    Examples
    --------
    A cart drives to a goal 1 m ahead and 5 cm to the right.

    >>> from slipfree import Analytic, catalog, direct_kinematics, plan, settle
    >>> ground = Analytic(lambda x, y: 0.1 * x * y)
    >>> model = direct_kinematics(catalog.three_wheeler(axle="fixed"), ground)
    >>> start = settle(model)
    >>> found = plan(model, start, goal={"x": 0.05, "y": 1.0}, costs={"slip": 1e3, "effort": 0.01})
    >>> found.success, found.accurate
    (True, True)
    >>> print(f"ends at ({found.replay['x'][-1]:.3f}, {found.replay['y'][-1]:.3f})")
    ends at (0.050, 1.000)

    The squared roll rate as the cost, in 4 s, on a coarse mesh:

    >>> from slipfree import Cost, Mesh
    >>> rolling = Cost("rolling", model.z.rates.roll**2, "rad2 s-1", "squared roll rate")
    >>> goal = {"x": 0.05, "y": 1.0}
    >>> found = plan(
    ...     model, start, goal=goal, costs=[rolling], smooth=0.01, duration=4.0, mesh=Mesh(4)
    ... )
    >>> found.success
    True
    """
    task = problem.task_of(
        model,
        start,
        goal=goal,
        costs=costs,
        duration=duration,
        smooth=smooth,
        continuous=mesh.continuous,
        limits=limits,
        way_points=way_points,
        inputs=inputs,
        accelerations=accelerations,
        cost_limits=cost_limits,
        initial_inputs=initial_inputs,
    )
    guesses = [guess] if isinstance(guess, Trajectory) else list(guess or ())
    return solve_task(task, start, guesses, mesh=mesh, search=search, options=options)


@computing
@with_interrupt_guard
def solve_task(
    task: PlanTask,
    start: Trajectory,
    guesses: Sequence[Trajectory],
    *,
    mesh: Mesh = Mesh(),
    search: Search = Search(),
    options: SolverOptions = SolverOptions(),
    verified: bool = True,
) -> Plan:
    """Return the plan of an optimal control problem; arguments, result and errors as in `plan`.

    A solution that is not ``verified`` is neither simulated nor refined; its ``replay`` is the
    planned motion.
    """
    clock, begun = time.process_time(), time.monotonic()
    problem.check_task(task, start)
    model, former, motions = task.dae, search.resume, list(guesses)
    task = replace(with_first_limits(task), deadline=begun + SEARCH_SHARE * search.seconds)
    nominal = [float(motion.t[-1] - motion.t[0]) for motion in motions]
    if not motions and former is None:
        motion, length = initial_guess(task, start, options)
        motions, nominal = [motion], [length]
    # a guess that turns around keeps a goal that asks for it; otherwise the short way is taken
    near: list[Callable[[float], Array]] = [lambda _: task.start]
    if former is not None:
        motion_before = local_motion(former, model)
        near.append(lambda fraction: motion_before.states(np.array([fraction]))[:, 0])
        length = former.motion.duration
        default, intervals = (length, length), former.motion.mesh.ends.size - 1
    else:
        t = motions[0].t - motions[0].t[0]
        near.append(
            lambda part: model.rows("x", motions[0], int(np.abs(t - part * t[-1]).argmin()))
        )
        length = path_length(motions[0]) if {"x", "y"} <= motions[0].columns.keys() else 0.0
        default = problem.free_durations(nominal)
        intervals = max(MIN_INTERVALS, math.ceil(length / (INTERVAL_SIZES * model.size)))
    if not task.duration[1] < math.inf:
        task = replace(task, duration=problem.duration_of(default))
    fractions = [condition.fraction for condition in task.conditions]
    ends = np.union1d(np.linspace(0, 1, (mesh.intervals or intervals) + 1), fractions)
    first = CollocationMesh(ends[np.append(True, np.diff(ends) > 1e-9)], mesh.degree)
    task = replace(
        task, conditions=problem.near_conditions(model, task.conditions, task.periodic, near)
    )
    if former is None:
        named = [(f"guess {number}", each) for number, each in enumerate(motions, 1)]
        missing = max(search.starts - len(motions), 0)
        named += further_guesses(model, start, motions[0], task.inputs, missing, search.seed)
        searches = solve_guesses(task, first, options, named, search.progress)
    else:
        searches = [solve_resumed(task, first, former, options, search.progress)]

    def verify(state: SearchState) -> Verification:
        """Return the simulated plan, or its samples if no verification is requested."""
        if search.keep is not None:
            search.keep(_unverified(state))
        if state.found.success and not verified:
            return Verification(sample_plan(state.program, state.found.unknowns), {}, {}, {})
        how = {"accuracy": mesh.accuracy, "step": mesh.step, "deadline": begun + search.seconds}
        tolerance = options.tolerance if state.found.success else FAILED_TOLERANCE
        program = replace(state.program, options=replace(options, tolerance=tolerance))
        return verify_plan(program, state.found.unknowns, start, **how)

    if not (searches[0].found.success or searches[0].found.status == STOPPED_STATUS):
        searches[0] = solve_relaxed(searches[0], begun + search.seconds, search.progress)
    best, verification, optima = best_verified(searches, verify, mesh.accuracy, search.progress)
    program, solution = best.program, best.found
    run = sample_plan(program, solution.unknowns) if best.run is None else best.run
    iterations = sum(stage.iterations for stage in best.stages)
    if not solution.success:
        outcome, words = explanation(program, solution, best.first, best.relaxation)
        outcome = Outcome.TIME_LIMIT if solution.status == TIME_STATUS else outcome
        if outcome is Outcome.TIME_LIMIT and not solution.iterations:
            words = (
                f"the time limit ended the search {best.stages[-1].words!r} before its first "
                f"iteration: the set-up and {iterations} iterations of earlier searches left the "
                f"solver {solution.seconds['total']:.2g} s; {more_time(program)}"
            )
        run = replace(run, stop=Stop(PLAN, float(run.t[-1]), words, outcome))
    statistics = {
        "cpu_seconds": time.process_time() - clock,
        "iterations": float(iterations),
        "compiled": float(program.compiled),
    }
    return replace(_as_plan(best, replace(run, statistics=statistics), verification), optima=optima)


def _unverified(search: SearchState) -> Plan:
    """Return a plan without verification; its stop says so."""
    program, solution = search.program, search.found
    run = sample_plan(program, solution.unknowns) if search.run is None else search.run
    name, words = PLAN, "the search for a plan was interrupted"
    if solution.status == STOPPED_STATUS:
        words = explanation(program, solution, search.first).words
    elif solution.success:
        name = PLAN_UNVERIFIED
        words = "the plan is solved, but the simulation that verifies it did not end"
    run = replace(run, stop=Stop(name, float(run.t[-1]), words, Outcome.INTERRUPTED))
    return _as_plan(search, run, Verification(run, {}, {}, {}))


def _as_plan(search: SearchState, run: Trajectory, verification: Verification) -> Plan:
    """Return the plan of a search with its samples ``run`` and its verification."""
    program, solution = search.program, search.found
    motion = motion_of(program, solution.unknowns)
    return Plan(
        motion,
        *verification[:4],
        cost_terms(program, solution.unknowns),
        solution.success,
        verification.accurate,
        search.stages,
        save_plan(program, solution),
        run,
        inputs_along(program.task.dae, motion, motion.ends),
        program,
        solution,
    )
