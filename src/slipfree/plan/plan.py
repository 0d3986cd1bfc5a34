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
from functools import cached_property

import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.dae import Dae
from slipfree.core.outcome import Outcome
from slipfree.core.records import Array, Record, overview
from slipfree.core.schema import NonNegative, Positive
from slipfree.core.trajectory import PLAN, PLAN_UNVERIFIED, Drawable, Stop, Trajectory, path_length
from slipfree.plan.explanation import explanation
from slipfree.plan.guess import initial_guess
from slipfree.plan.ipopt import STOPPED_STATUS, TIME_STATUS, NlpSolution
from slipfree.plan.optimality import Optimality, Price, check_optimality, limit_prices
from slipfree.plan.polynomial_motion import (
    PolynomialMotion,
    SavedPlan,
    local_motion,
    motion_of,
    sample_plan,
    save_plan,
)
from slipfree.plan.problem import (
    Conditions,
    Range,
    duration_of,
    free_durations,
    near_conditions,
    range_of,
    task_of,
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
    solve_resumed,
)
from slipfree.plan.stage import Cost
from slipfree.plan.transcription import CollocationMesh, Mesh, PlanTask, Program, transcribe
from slipfree.plan.verification import Verification, inputs_along, verify_plan
from slipfree.solve.options import SolverOptions
from slipfree.system.forks import computing
from slipfree.system.interrupt import with_interrupt_guard

MIN_INTERVALS = 40  # least default number of intervals
INTERVAL_SIZES = 2.0  # largest length of a default interval, in sizes of the vehicle
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
        if not self.success or self.solution.status == TIME_STATUS:
            return None
        return check_optimality(self.program, self.solution, cost_weights(self.program, 1.0))

    @cached_property
    def prices(self) -> tuple[Price, ...]:
        """Shadow prices of active limits, largest saving first; empty if ``success`` is False."""
        is_optimal = self.success and self.solution.status != TIME_STATUS
        return limit_prices(self.program, self.solution) if is_optimal else ()


@checked
@computing
@with_interrupt_guard
def plan(
    model: Dae,
    start: Trajectory,
    guess: Trajectory | Sequence[Trajectory] | None = None,
    *,
    goal: Conditions,
    costs: Mapping[str, NonNegative] | Sequence[Cost],
    duration: float | Range | None = None,
    smooth: NonNegative = 0.0,
    limits: Conditions = (),
    way_points: Mapping[float, Conditions] | None = None,
    inputs: Mapping[str, Range] | None = None,
    accelerations: Mapping[str, Range] | None = None,
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
        Options of the solvers; the plan is simulated with a hundredth of the tolerance.

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
    clock, begun = time.process_time(), time.monotonic()
    guess = () if guess is None else guess
    motions = [guess] if isinstance(guess, Trajectory) else list(guess)
    task = task_of(
        model,
        start,
        goal=goal,
        costs=costs,
        duration=1.0 if duration is None else duration,
        smooth=smooth,
        continuous=mesh.continuous,
        limits=limits,
        way_points=way_points,
        inputs=inputs,
        accelerations=accelerations,
        cost_limits=cost_limits,
        initial_inputs=initial_inputs,
    )
    task = replace(task, deadline=begun + SEARCH_SHARE * search.seconds)
    former = search.resume
    nominal = [float(motion.t[-1] - motion.t[0]) for motion in motions]
    if not motions and former is None:
        ranges = {name: range_of(value) for name, value in (inputs or {}).items()}
        motion, length = initial_guess(task, start, ranges, options)
        motions, nominal = [motion], [length]
    if duration is None:
        length = former.motion.duration if former is not None else 0.0
        default = (length, length) if former is not None else free_durations(nominal)
        task = replace(task, duration=duration_of(default))
    intervals = mesh.intervals or _default_intervals(model, motions, former)
    ends = np.union1d(np.linspace(0, 1, intervals + 1), list(way_points or ()))
    first = CollocationMesh(ends[np.append(True, np.diff(ends) > 1e-9)], mesh.degree)
    task = _with_near_conditions(task, motions, former)
    if former is None:
        named = [(f"guess {number}", each) for number, each in enumerate(motions, 1)]
        missing = max(search.starts - len(motions), 0)
        named += further_guesses(model, start, motions[0], task.inputs, missing, search.seed)
        searches = solve_guesses(transcribe(task, first, options), named, search.progress)
    else:
        searches = [solve_resumed(task, first, former, options, search.progress)]

    def verify(state: SearchState) -> Verification:
        if search.keep is not None:
            search.keep(_unverified(state))
        return verify_plan(
            state.program, state.found.unknowns, start, accuracy=mesh.accuracy, step=mesh.step
        )

    best, verification, optima = best_verified(searches, verify, search.progress)
    program, solution = best.program, best.found
    run = sample_plan(program, solution.unknowns) if best.run is None else best.run
    if not solution.success:
        longer = replace(program, task=replace(program.task, deadline=begun + search.seconds))
        why = explanation(longer, solution, best.first)
        outcome = Outcome.TIME_LIMIT if solution.status == TIME_STATUS else why.outcome
        run = replace(run, stop=Stop(PLAN, float(run.t[-1]), why.words, outcome))
    iterations = sum(stage.iterations for stage in best.stages)
    statistics = {
        "cpu_seconds": time.process_time() - clock,
        "iterations": float(iterations),
        "compiled": float(program.compiled),
    }
    run = replace(run, statistics=statistics)
    return replace(_as_plan(best, run, verification), optima=optima)


def _default_intervals(dae: Dae, guesses: Sequence[Trajectory], resume: SavedPlan | None) -> int:
    """Return the number of intervals of a saved plan, or of a guess by the length of its path."""
    if resume is not None:
        return resume.motion.mesh.ends.size - 1
    length = path_length(guesses[0]) if {"x", "y"} <= guesses[0].columns.keys() else 0.0
    return max(MIN_INTERVALS, math.ceil(length / (INTERVAL_SIZES * dae.size)))


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
    nothing = np.zeros(program.mesh.ends.size - 1, dtype=bool)
    verification = Verification(run, {}, {}, {}, nothing, accurate=False)
    return _as_plan(search, run, verification)


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
