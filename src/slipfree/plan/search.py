"""Search for a plan from initial guesses: stages, added limits, finer meshes, local optima."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Gt, Le, Unit

from slipfree.core.arguments import checked
from slipfree.core.dae import Dae, Limit
from slipfree.core.records import Array, with_overview
from slipfree.core.trajectory import Trajectory
from slipfree.plan import ipopt
from slipfree.plan.constraints import LIMIT_CLEARANCE, VIOLATION_TOLERANCE, with_clearance
from slipfree.plan.explanation import Relaxation, relax
from slipfree.plan.polynomial_motion import (
    SavedPlan,
    guess_unknowns,
    local_motion,
    mesh_along,
    motion_of,
    nearest_fraction,
    sample_plan,
    transfer_motion,
)
from slipfree.plan.transcription import CollocationMesh, PlanTask, Program, completed, transcribe
from slipfree.plan.verification import GUESS_TOLERANCE, Verification, largest_error, refine_mesh
from slipfree.solve.simulate import simulate_to_failure
from slipfree.solve.system import SolverOptions

PERTURBATION = 0.3  # standard deviation of a perturbation, relative to the rms of the input
MODES = 4  # number of cosines in a perturbation
MAX_HALVINGS = 4  # of a perturbation whose motion ends early
SHORTEST = 0.5  # shortest motion that is used as a guess, relative to the duration
PATH_SAMPLES = 201  # samples at which the paths of two plans are compared
SAME_PATH = 1e-3  # largest distance of paths that count as one optimum [m]
VERIFIED, INACCURATE, SOLVED, NOT_SOLVED = "verified", "inaccurate", "solved", "not solved"
RANKS = (VERIFIED, SOLVED, INACCURATE, NOT_SOLVED)
SLIP_COSTS = ("slip", "slip_along", "slip_across")  # costs whose weight is raised in stages
MOST_AT_ONCE = 80  # largest number of intervals of a program that is solved from a mere guess
MAX_LIMIT_ROUNDS = 4  # largest number of times that violated limits are added
MAX_REFINEMENTS = 6  # largest number of refinements of the mesh
FUTILE_GROWTH = 4.0  # ratio of intervals after which an unchanged error has another cause
MAX_REFINED_ITERATIONS = 100  # of a search on a refined mesh, which starts near its solution
MAX_CORRECTIONS = 5  # largest number of times that a goal or a mesh is adapted to a simulation
MIN_IMPROVEMENT = 0.8  # ratio of errors on a finer and a coarser mesh for a further refinement
PlanProgress = Callable[[str, ipopt.Iterate], bool]


@checked
@dataclass(frozen=True, eq=False)
class Search:
    """Initial guesses of a search for a plan, and its observation.

    Attributes
    ----------
    starts : int
        Number of starts, in parallel processes: routes, the guess, reversed gears, perturbed
        inputs; the verified plan of least cost is returned. Guesses beyond those that are given are
        simulated with the inputs of the first one: first with negated inputs if the bounds allow
        it, then with randomly perturbed inputs. A guess whose motion ends too early is omitted.
        ``Plan.optima`` lists the plans from all guesses.
    seed : int
        Seed of the random perturbations.
    resume : SavedPlan or None
        Plan from which the search starts instead of from a guess. Its mesh, ground and goal may
        differ. If it starts in another state, only its part after the nearest state is used.
    seconds : float
        Time limit of the whole search, by default none. A fifth of it is for the verification or
        the explanation of the result. When the search has used its share, the plan is the cheapest
        motion found that meets all constraints; its cost may not be minimal. If there is none, the
        plan is the iterate with the smallest violation. The limit also ends the simulation that
        verifies the plan, which is then not verified. [s]
    progress : callable or None
        Function called with a description of the program and every iterate. If it returns False,
        the search ends, and the plan is the iterate with the smallest violation.
    keep : callable or None
        Function called with each plan before the simulation that verifies it. ``replay`` is then
        the planned motion, whose stop says that it is not verified.

    Raises
    ------
    ModelError
        If a number is out of its range.
    """

    starts: Annotated[int, Ge(1), Le(1000)] = 1
    seed: Annotated[int, Ge(0)] = 0
    seconds: Annotated[float, Gt(0), Unit("s")] = math.inf
    resume: SavedPlan | None = None
    progress: PlanProgress | None = None
    keep: Callable[..., None] | None = None


@with_overview
class LocalOptimum(NamedTuple):
    """Result of the search from one initial guess.

    Attributes
    ----------
    start : str
        Name of the initial guess, such as ``"guess 1"``, ``"reversed"`` or ``"perturbed 2"``.
    outcome : str
        ``"verified"`` (the simulation agrees with the plan), ``"inaccurate"`` (it does not),
        ``"solved"`` (not simulated) or ``"not solved"``.
    cost : float
        Cost of the plan, the sum of all weighted terms.
    terms : dict of str to float
        Unweighted integrals of the terms of the cost, in their units, by name.
    duration : float
        Duration of the plan. [s]
    seconds : float
        Wall time of the search. [s]
    path : ndarray, shape (2, n)
        Positions ``x``, ``y`` at n equally spaced times, in local coordinates; shape (0, n) if the
        model has no such states. [m]
    """

    start: str
    outcome: str
    cost: float
    terms: dict[str, float]
    duration: float
    seconds: float
    path: Array

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key, smallest for the best plan: rank of the outcome, then cost."""
        return RANKS.index(self.outcome), self.cost


def further_guesses(
    dae: Dae, start: Trajectory, guess: Trajectory, bounds: Array, count: int, seed: int
) -> Iterator[tuple[str, Trajectory]]:
    """Yield names and motions of further guesses: reversed inputs, then perturbed inputs.

    A reversed guess beyond the bounds is left out, and a perturbed one if its motion ends before
    half of the duration, even with the perturbation halved four times.
    """
    t = guess.t - guess.t[0]
    inputs = dae.rows("u", guess)
    sides = bounds[np.abs(inputs).max(axis=1) > 0]
    if count and ((sides[:, 0] < 0) & (sides[:, 1] > 0)).all():
        run = _simulated(dae, start, np.clip(-inputs, bounds[:, :1], bounds[:, 1:]), t)
        if run.t[-1] > 0:
            count -= 1
            yield "reversed", run
    sizes = np.sqrt((inputs**2).mean(axis=1, keepdims=True))
    sizes = np.where(sizes > 0, sizes, np.sqrt((inputs**2).mean()))
    for number in range(1, count + 1):
        rng = np.random.default_rng([seed, number])
        weights = rng.standard_normal((len(inputs), MODES)) / np.sqrt(MODES)
        waves = np.cos(np.pi * np.outer(np.arange(MODES), t / t[-1]))
        change = PERTURBATION * sizes * (weights @ waves)
        for k in range(MAX_HALVINGS + 1):
            values = np.clip(inputs + change / 2**k, bounds[:, :1], bounds[:, 1:])
            run = _simulated(dae, start, values, t)
            if run.t[-1] >= SHORTEST * t[-1]:
                yield f"perturbed {number}", run
                break


def _simulated(dae: Dae, start: Trajectory, inputs: Array, t: Array) -> Trajectory:
    middles = (inputs[:, 1:] + inputs[:, :-1]) / 2
    law = dae.inputs(**dict(zip(dae.input_names, middles, strict=True)))
    return simulate_to_failure(dae, start, law, t, SolverOptions(tolerance=GUESS_TOLERANCE))


def count_distinct(optima: Sequence[LocalOptimum]) -> int:
    """Return the number of solved plans whose paths differ by more than 1 mm."""
    kept: list[Array] = []
    for each in optima:
        apart = (np.linalg.norm(each.path - path, axis=0).max(initial=0.0) for path in kept)
        if each.outcome != NOT_SOLVED and all(gap > SAME_PATH for gap in apart):
            kept.append(each.path)
    return len(kept)


def distances(optima: Sequence[LocalOptimum]) -> list[float]:
    """Return the largest distance of each path from the first in m, at equal fractions of time."""
    first = optima[0].path
    return [float(np.linalg.norm(each.path - first, axis=0).max(initial=0.0)) for each in optima]


@with_overview
class SolvedStage(NamedTuple):
    """Program that was solved during a search for a plan."""

    words: str  # description of the program, such as ``"without slip cost"``
    iterations: int  # number of iterations
    status: str  # return status of IPOPT
    seconds: dict[str, float]  # wall times, as in `NlpSolution` [s]
    cost: float  # final cost, with the weights of this stage


class SearchState(NamedTuple):
    """Last solved program of a search, its solution and initial guess, and all stages so far."""

    program: Program
    found: ipopt.NlpSolution
    first: Array
    stages: tuple[SolvedStage, ...]
    run: Trajectory | None = None
    name: str = ""
    number: int = 0
    relaxation: Relaxation | None = None  # of a search that failed


def solve_guesses(
    task: PlanTask,
    mesh: CollocationMesh,
    options: SolverOptions,
    guesses: Sequence[tuple[str, Trajectory]],
    progress: PlanProgress | None,
) -> list[SearchState]:
    """Solve the program of a task from each guess, and return the solutions, best first.

    With more than `MOST_AT_ONCE` intervals, each guess is first solved on meshes of half and, if
    need be, of a quarter and fewer of them; a failure on the coarsest one is the result. After a
    failure on a finer mesh, the search begins again there, from the guess.
    """
    programs = [transcribe(task, mesh, options)]
    while mesh.ends.size - 1 > max(MOST_AT_ONCE, 4 * len(task.conditions)):
        kept = np.arange(mesh.ends.size) % 2 == 0
        kept[[np.abs(mesh.ends - each.fraction).argmin() for each in task.conditions]] = True
        mesh = mesh._replace(ends=mesh.ends[kept])
        programs.insert(0, transcribe(task, mesh, options))
    searches: list[SearchState] = []
    for number, (name, guess) in enumerate(guesses, 1):
        of = f"guess {number} of {len(guesses)}, " if len(guesses) > 1 else ""
        program, *others = programs
        search = _solve_in_stages(program, guess_unknowns(program, guess), of, progress)
        for program in others:
            if search.found.success and search.found.status != ipopt.TIME_STATUS:
                words = f"{of}{program.mesh.ends.size - 1} intervals"
                finer = _solve_anew(search, program, words, progress, near=True)
                if not (finer.found.success or finer.found.status in ipopt.ENDED_STATUSES):
                    before, first = finer.stages, guess_unknowns(program, guess)
                    finer = _solve_in_stages(program, first, f"{words}, ", progress)
                    finer = finer._replace(stages=before + finer.stages)
                search = finer
        searches.append(search._replace(name=name, number=number))
        if search.found.status in ipopt.ENDED_STATUSES:
            break
    return sorted(searches, key=_rank)


def solve_relaxed(
    search: SearchState, deadline: float, progress: PlanProgress | None
) -> SearchState:
    """Solve a failed search again from the motion of its smallest relaxation.

    This is tried if no bound has to be relaxed: the motion then meets all constraints, which a
    search that also reduces the costs may miss. The relaxation ends at ``deadline``, later than the
    searches: after their deadline, the motion is the result.
    """
    longer = replace(search.program.task, deadline=deadline)
    relaxation = relax(replace(search.program, task=longer), search.first)
    if not relaxation.success or relaxation.relaxed:
        return search._replace(relaxation=relaxation)
    of = "from a motion without costs, "
    again = _solve_in_stages(search.program, relaxation.solution, of, progress)
    stages = search.stages + again.stages
    if again.found.success:
        search = again._replace(name=search.name, number=search.number)
    return search._replace(relaxation=relaxation, stages=stages)


def best_verified(
    searches: Sequence[SearchState],
    verify: Callable[[SearchState], Verification],
    accuracy: float,
    progress: PlanProgress | None,
) -> tuple[SearchState, Verification, tuple[LocalOptimum, ...]]:
    """Return the best search with its verification, and a table of all searches.

    The solutions of the searches are refined and simulated in order, until a simulation is
    accurate, a program is not solved or the user stops the search. The best search is the accurate
    one, or the first one if none is accurate.
    """
    tried: list[tuple[SearchState, Verification]] = []
    for search in searches:
        refined = _refine(_add_limits(search, progress), verify, progress)
        last, verification = _simulated_plan(*refined, verify, accuracy, progress)
        tried.append((last, verification))
        ended = last.stages[-1].status in ipopt.ENDED_STATUSES
        if verification.accurate or not last.found.success or ended:
            break
    best = tried[-1] if tried[-1][1].accurate and tried[-1][0].found.success else tried[0]
    kept = [each for each, _ in tried] + list(searches[len(tried) :])
    rows = [
        _local_optimum(each, tried[k][1].accurate if k < len(tried) else None)
        for k, each in enumerate(kept)
    ]
    order = sorted(range(len(rows)), key=lambda k: (kept[k] is not best[0], *rows[k].rank))
    stages = [stage for each in sorted(searches, key=attrgetter("number")) for stage in each.stages]
    pairs = [(one[0], before) for one, before in zip(tried, searches, strict=False)]
    for after, before in sorted(pairs, key=lambda pair: pair[0] is best[0]):
        stages += after.stages[len(before.stages) :]
    return best[0]._replace(stages=tuple(stages)), best[1], tuple(rows[k] for k in order)


def _local_optimum(search: SearchState, accurate: bool | None) -> LocalOptimum:
    """Return the row of a search in the table of optima; ``accurate`` is None if not simulated."""
    program, solution = search.program, search.found
    outcomes = {None: SOLVED, True: VERIFIED, False: INACCURATE}
    motion = motion_of(program, solution.unknowns)
    rows = [k for k, name in enumerate(program.task.dae.state_names) if name in ("x", "y")]
    return LocalOptimum(
        search.name,
        outcomes[accurate] if solution.success else NOT_SOLVED,
        solution.cost,
        cost_terms(program, solution.unknowns),
        motion.duration,
        sum(stage.seconds["total"] for stage in search.stages),
        motion.states(np.linspace(0, 1, PATH_SAMPLES))[rows],
    )


def _rank(search: SearchState) -> tuple[bool, float]:
    """Return the sort key of a search: solved programs by cost, then others by violation."""
    solution = search.found
    size = (
        solution.cost
        if solution.success
        else ipopt.largest_violation(search.program, solution.rows)
    )
    return not solution.success, size


def _solve_in_stages(
    program: Program, first: Array, of: str, progress: PlanProgress | None
) -> SearchState:
    """Solve the program; if slip is a cost, start from the solution without this cost."""
    slips = any(cost.label.name in SLIP_COSTS and cost.weight for cost in program.task.costs)
    words = f"{of}without slip cost" if slips else f"{of}all costs"
    part, most = (0.0, ipopt.MAX_FIRST_ITERATIONS) if slips else (1.0, ipopt.MAX_ITERATIONS)
    search = _solve_stage(program, first, words, part, progress, None, most)
    best = search.found
    # a motion that meets all constraints is enough to start from
    is_met = ipopt.largest_violation(program, best.rows) <= VIOLATION_TOLERANCE
    if slips and (best.success or (is_met and best.status == ipopt.ITERATIONS_STATUS)):
        more = _solve_stage(program, best.unknowns, f"{of}with slip cost", 1.0, progress, best)
        stages, status = search.stages + more.stages, more.found.status
        worst = ipopt.largest_violation(program, more.found.rows)
        if not more.found.success and worst > VIOLATION_TOLERANCE:
            # The previous plan meets all constraints, although its slip is not minimal.
            best = best._replace(success=status == ipopt.TIME_STATUS, status=status)
            more = search._replace(found=best)
        search = more._replace(stages=stages)
    return search._replace(first=first)


def solve_resumed(
    task: PlanTask,
    mesh: CollocationMesh,
    resume: SavedPlan,
    options: SolverOptions,
    progress: PlanProgress | None,
) -> SearchState:
    """Solve from a saved plan, with its multipliers if the programs have equal sizes."""
    former = local_motion(resume, task.dae)
    after = nearest_fraction(former, task.start)
    if former.mesh.degree == mesh.degree and set(mesh.ends) <= set(former.mesh.ends):
        mesh = former.mesh
    program = transcribe(task, mesh, options)
    first = transfer_motion(former, program, after)
    # limits that are active in the saved plan
    if reached := _violated_limits(task, sample_plan(program, first), -2 * LIMIT_CLEARANCE):
        program = transcribe(replace(task, limits=(*task.limits, *reached)), mesh, options)
        first = transfer_motion(former, program, after)
    warm, sizes = _warm_guess(program, first), (first.size, program.g_lower.size)
    if not after and sizes == (former.unknowns.size, resume.row_multipliers.size):
        warm = warm._replace(
            row_multipliers=resume.row_multipliers, bound_multipliers=resume.bound_multipliers
        )
    return _solve_stage(program, first, "from the previous plan", 1.0, progress, warm)


def _solve_stage(
    program: Program,
    first: Array,
    words: str,
    part: float,
    progress: PlanProgress | None,
    warm: ipopt.NlpSolution | None = None,
    most: int = ipopt.MAX_ITERATIONS,
) -> SearchState:
    """Return the state of the search after a program is solved from the unknowns ``first``.

    ``words`` names the stage, ``part`` is the weight of the costs (1 in the last stage), ``warm`` a
    solution with multipliers, ``most`` the maximum number of iterations.
    """
    on_iterate = None if progress is None else lambda iterate: progress(words, iterate)
    weights = cost_weights(program, part)
    solution = ipopt.solve_program(
        program, weights, first, warm=warm, iterations=most, on_iterate=on_iterate
    )
    stage = SolvedStage(words, *attrgetter("iterations", "status", "seconds", "cost")(solution))
    return SearchState(program, solution, first, (stage,))


def cost_weights(program: Program, part: float) -> Array:
    """Return the weights of the program; those of slip are multiplied by ``part``."""
    weights = [
        cost.weight * (part if cost.label.name in SLIP_COSTS else 1.0)
        for cost in program.task.costs
    ]
    return np.array([*weights, program.task.smooth])


def _add_limits(search: SearchState, progress: PlanProgress | None) -> SearchState:
    """Add violated limits of the model and solve again, at most `MAX_LIMIT_ROUNDS` times.

    If the search then fails, it continues from a motion without costs, if there is one.
    """
    for _ in range(MAX_LIMIT_ROUNDS):
        program, solution = search.program, search.found
        if not solution.success:
            return search
        run = sample_plan(program, solution.unknowns)
        missed = _violated_limits(program.task, run, VIOLATION_TOLERANCE)
        if not missed:
            return search._replace(run=run)
        words = f"with {', '.join(limit.label.full for limit in missed)}"
        fuller = replace(program.task, limits=(*program.task.limits, *missed))
        fuller_program = transcribe(fuller, program.mesh, program.options)
        search = _solve_anew(search, fuller_program, words, progress)
        if not (search.found.success or search.found.status in ipopt.ENDED_STATUSES):
            search = solve_relaxed(search, program.task.deadline, progress)
    return search


def _solve_anew(
    search: SearchState,
    program: Program,
    words: str,
    progress: PlanProgress | None,
    *,
    near: bool = False,
    most: int = ipopt.MAX_ITERATIONS,
) -> SearchState:
    """Solve another program from a solution, which is ``near`` if the whole mesh is finer."""
    first = transfer_motion(motion_of(search.program, search.found.unknowns), program)
    warm = _warm_guess(program, first)._replace(iterations=int(near))
    more = _solve_stage(program, first, words, 1.0, progress, warm, most)
    return more._replace(stages=search.stages + more.stages, name=search.name, number=search.number)


def _warm_guess(program: Program, first: Array) -> ipopt.NlpSolution:
    """Return a solution with the given unknowns and zero multipliers, for a warm start."""
    rows, bounds = np.zeros(program.g_lower.size), np.zeros(first.size)
    return ipopt.NlpSolution(first, rows, np.nan, rows, bounds, "", True, 0, {})


def _violated_limits(task: PlanTask, run: Trajectory, beyond: float) -> list[Limit]:
    """Return the limits of the model that a plan violates and that its task lacks.

    A violation counts if it is larger than ``beyond``, which is negative to include limits that
    the plan almost reaches. The returned limits are narrower by `LIMIT_CLEARANCE` on both sides.
    """
    have = {limit.label.full for limit in task.limits}
    missed = []
    for limit in task.dae.all_limits:
        values = run.of(limit.label)
        over = np.maximum(limit.lower - values, values - limit.upper).max()
        if over > beyond and limit.label.full not in have:
            missed.append(with_clearance(limit))
    return missed


def _refine(
    search: SearchState,
    verify: Callable[[SearchState], Verification],
    progress: PlanProgress | None,
) -> tuple[SearchState, Verification]:
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
        task = replace(search.program.task, limits=verification.limits)
        program = transcribe(task, mesh, search.program.options)
        finer = _solve_anew(search, program, words, progress, most=MAX_REFINED_ITERATIONS)
        finer = _add_limits(finer, progress)
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


def _simulated_plan(
    search: SearchState,
    verification: Verification,
    verify: Callable[[SearchState], Verification],
    accuracy: float,
    progress: PlanProgress | None,
) -> tuple[SearchState, Verification]:
    """Return a plan that misses its simulation as that simulation, and its verification.

    A vehicle without suspension tips onto other wheels within some tenths of a second. A finer mesh
    does not help: its plan tips where the mesh is still coarse, at a speed that the model does not
    have. The goal of the plan is moved by the miss of its simulation, until the simulation reaches
    the goal; polynomials on a mesh that follows it are the plan. Its cost may not be minimal. The
    arguments are returned if this fails.
    """
    asked, now, shown = search.program.task, search, verification
    for _ in range(MAX_CORRECTIONS):
        ended = now.stages[-1].status in ipopt.ENDED_STATUSES
        if shown.accurate or ended or not (now.found.success and shown.misses):
            return search._replace(stages=now.stages), verification
        if all(np.abs(miss).max(initial=0.0) <= accuracy for miss in shown.misses):
            break
        aims = tuple(
            condition._replace(
                limits=tuple(
                    limit._replace(lower=limit.lower - size, upper=limit.upper - size)
                    for limit, size in zip(condition.limits, miss.tolist(), strict=True)
                )
            )
            for condition, miss in zip(now.program.task.conditions, shown.misses, strict=True)
        )
        program = transcribe(replace(asked, conditions=aims), now.program.mesh, now.program.options)
        now = _solve_anew(now, program, "moved goal", progress, near=True)
        shown = verify(now._replace(program=replace(program, task=asked)))
    else:
        return search._replace(stages=now.stages), verification
    for _ in range(MAX_CORRECTIONS):
        run = shown.replay
        states = asked.dae.rows("x", run)
        mesh = mesh_along(now.program.mesh, run.t / run.t[-1], states, accuracy / 2)
        program = transcribe(asked, mesh, now.program.options)
        first = completed(program, guess_unknowns(program, run))
        cost = float(program.gradient(first / program.scale, cost_weights(program, 1.0))[0])
        found = _warm_guess(program, first)._replace(cost=cost, status=ipopt.SIMULATED_STATUS)
        now = now._replace(program=program, found=found, run=None)
        shown = verify(now)
        if shown.accurate:
            no_time = {"total": 0.0, "functions": 0.0}
            stage = SolvedStage("simulation", 0, ipopt.SIMULATED_STATUS, no_time, cost)
            return now._replace(stages=(*now.stages, stage)), shown
    return search._replace(stages=now.stages), verification


def cost_terms(program: Program, unknowns: Array) -> dict[str, float]:
    """Return the integrals of the terms of the cost by name, in their units."""
    units = np.eye(program.problem["p"].numel())
    names = [cost.label.name for cost in program.task.costs]
    names += ["smoothness"] if program.task.smooth else []
    w = unknowns / program.scale
    pairs = zip(names, units, strict=False)
    return {name: float(program.gradient(w, unit)[0]) for name, unit in pairs}
