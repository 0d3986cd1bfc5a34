"""Pareto front of a planning problem: slip against the duration or a term of the cost."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.errors import DataError, ModelError
from slipfree.core.facts import Lines, TableColumn, table
from slipfree.core.trajectory import Outcome, SolverError, outcome_words
from slipfree.files.netcdf import write
from slipfree.files.toml import Fault
from slipfree.plan.constraints import unit_words
from slipfree.plan.pareto import FrontPoint, FrontTask, check_count, is_better, pareto_front
from slipfree.plan.polynomial_motion import SavedPlan, from_arrays
from slipfree.plan.problem import costs_of
from slipfree.problem.inputs import ProblemParts, Recipe, recipe_of
from slipfree.problem.load import verb_of
from slipfree.problem.problem import Problem
from slipfree.problem.result import build, open_result, run_problem
from slipfree.problem.verbs.base import Result
from slipfree.problem.verbs.plan_setup import PlanKeys
from slipfree.system.parts import PartsWatch, study

SLIP, TIME, DURATION, ENERGY = "slip", "time", "duration", "energy"
USUAL = (DURATION, "effort", ENERGY)  # second objectives of every planning problem
SHORTEST = 0.01  # lower bound of the least duration, relative to the largest duration
LineCallback = Callable[[str, str], None]
SettingTexts = tuple[str, ...]
GIVEN = -1  # number of the plan of the problem, with its own costs


class FrontPlan(NamedTuple):
    """Plan of a point of a front, simulated and verified, with the plan for other warm starts."""

    result: Result | None
    saved: SavedPlan | None
    slip: float  # per wheel and metre of path [m/m]
    squared_slip: float  # integral over all wheels [m2/s]
    duration: float  # [s]


class PlanFront(NamedTuple):
    """Pareto front of a planning problem.

    The first objective of the points is the integral of the squared slip of all wheels in m2/s,
    plus the smoothness of the inputs with its weight relative to that of the slip. The solution of
    each solved point is a `FrontPlan`.
    """

    against: str  # second objective
    unit: str
    given: FrontPoint  # plan of the problem with its own costs
    least: FrontPoint  # plan of least second objective
    points: tuple[FrontPoint, ...]  # by increasing bound on the second objective
    is_interrupted: bool = False

    @property
    def outcome(self) -> Outcome:
        """Outcome: interrupted if a point is, otherwise that of the first unsolved point."""
        unsolved = [point.outcome for point in self.points if not point.is_solved]
        if self.is_interrupted:
            return Outcome.INTERRUPTED
        return next(iter(unsolved), Outcome.COMPLETE)


class _PointTask(NamedTuple):
    """Search for the plan of a point, for this process or another one."""

    recipe: Recipe
    against: str
    name: str  # of the point, in reports
    bound: float  # on the second objective; NaN without one
    resume: SavedPlan | None


class FrontFolder(ProblemParts[FrontPoint]):
    """Folder beside an output with the points that the searches for a front found, in their order.

    A front of ``count`` points takes four searches, two for each point, and one more for each
    dominated point.
    """

    def __init__(self, out: Path, problem: Problem[Any], against: str, count: int) -> None:
        self._against, size = against, 4 + 3 * count
        super().__init__(out, "front", size, problem, ".nc", against=against, points=count)

    def store(self, number: int, result: FrontPoint) -> None:
        """Store the result of a search."""
        solved = result.solution and result.solution.result
        fill = solved and (lambda part: write(part, solved.trajectory, solved.arrays))
        self.add(number, {"point": (result.bound, result.outcome.name, result.words)}, fill)

    def load(self, number: int) -> FrontPoint:
        """Return the result of a search."""
        bound, outcome, words = self.record(number)["point"]
        if outcome != Outcome.COMPLETE.name:
            return FrontPoint(bound, outcome=Outcome[outcome], words=words)
        return _point(open_result(self.file(number)), bound, self._against)


def plan_front(
    problem: Problem[PlanKeys],
    against: str = DURATION,
    count: int = 7,
    *,
    processes: int = 1,
    report: LineCallback | None = None,
    keep: Callable[[int, FrontPoint], None] = lambda *_: None,
    parts: FrontFolder | None = None,
) -> PlanFront:
    """Return the Pareto front of slip against the duration or a term of the cost.

    The duration is fixed, or the integral of the term limited, at each point, and the slip is
    minimised. Other costs of the problem are omitted; its limits, bounds and weight of smoothness
    remain. The longest duration is that of the problem. The result does not depend on the number of
    processes.

    ``report`` is called with the phase of the search and a line; it may raise KeyboardInterrupt,
    after which unsolved points are ``INTERRUPTED``. ``keep`` is called with the number of a point
    (from 0; `GIVEN` for the plan of the problem) and the point, for each solution that is better
    than earlier ones. Searches whose results are in ``parts`` are not repeated.

    ProblemError is raised if the problem cannot be built, is not a planning problem, or has no
    weight of the slip; DataError if the second objective is unknown; ModelError if fewer than two
    points are requested; SolverError if the plan of the problem, the plan of least slip or that of
    least second objective is not solved; KeyboardInterrupt if ``report`` raises it before the plan
    of the problem is solved.
    """
    check_count(count)
    unit = _checked(problem, against)
    weight = f"{_key('costs', against)}={problem.spec.costs.get(against, 0.0)!r}"
    measured = () if against == DURATION else (weight,)  # by which the plan reports the objective
    searches, kept, is_interrupted = 0, dict[int, FrontPoint](), False

    def poll() -> None:
        if report is not None and kept:
            report("points", f"{len(kept)} of {count} points are solved")

    def better(number: int, point: FrontPoint) -> None:
        if is_better(point, kept.get(number, FrontPoint(point.bound))):
            kept[number] = point
            keep(number, point)

    here = partial(_solve_point, report=report)
    with (
        study(_solve_point, parts, processes, here=here, watch=PartsWatch(poll)) as run,
        study(_solve_point, parts, here=here) as run_here,
    ):

        def find(tasks: Sequence[_PointTask], run: Any = run) -> Iterator[tuple[int, FrontPoint]]:
            """Yield the indices and points of tasks, in the order of completion."""
            nonlocal searches
            first = searches + 1
            searches += len(tasks)
            numbered = run(
                range(first, searches + 1),
                lambda number: tasks[number - first],
                lambda number: "\n".join(tasks[number - first].recipe.settings),
            )
            yield from ((number - first, point) for number, point in numbered)

        def one(
            name: str, settings: SettingTexts, start: FrontPoint | None, *, is_needed: bool = True
        ) -> FrontPoint:
            """Return one of the points that a front needs before its own points."""
            resume = start and start.solution.saved
            task = _PointTask(recipe_of(problem, *settings), against, name, np.nan, resume)
            ((_, point),) = find([task], run_here)
            if is_needed and not point.is_solved:
                raise SolverError(
                    f"expected a solved and verified plan ({name}), which the front needs before "
                    f"its points, found: {point.words}"
                )
            return point

        def solve(tasks: Sequence[FrontTask]) -> list[FrontPoint]:
            """Return the points of tasks in their order; ``INTERRUPTED`` points after Ctrl-C."""
            nonlocal is_interrupted
            solved = dict[int, FrontPoint]()
            planned = [
                _PointTask(
                    recipe_of(problem, *_slip_settings(problem, against, task.bound)),
                    against,
                    f"point {task.number + 1} of {count}",
                    task.bound,
                    task.start.solution.saved,
                )
                for task in tasks
            ]
            try:
                for k, point in () if is_interrupted else find(planned):
                    solved[k] = point
                    better(tasks[k].number, point)
            except KeyboardInterrupt:
                is_interrupted = True
            return [solved.get(k, FrontPoint(task.bound)) for k, task in enumerate(tasks)]

        given = one("plan of the problem", measured, None)
        keep(GIVEN, given)
        # the smallest and the largest duration of the plans of a front [s]
        low, high = problem.spec.plan.duration or 2 * (given.solution.duration,)
        durations = (low, high) if low < high else (SHORTEST * high, high)
        least = best = FrontPoint(np.nan)
        try:
            name = TIME if against == DURATION else against
            own = [f"{_key('costs', against)}={problem.spec.costs.get(against) or 1.0!r}"]
            if against == DURATION:
                own = [f"costs.{TIME}=1.0", f"plan.duration=[{durations[0]!r}, {durations[1]!r}]"]
            # smoothness would increase the second objective
            of_least = (*_without(problem, name), *own, "plan.smooth=0.0")
            least = one(f"least {against}", of_least, given)
            keep(0, least)
            slip = _slip_settings(problem, against, durations[1] if against == DURATION else None)
            best = one("least slip", slip, given)
            better(count - 1, best)
            better(count - 1, one("least slip from the initial guess", slip, None, is_needed=False))
        except KeyboardInterrupt:
            points = (least, *[FrontPoint(np.nan)] * (count - 2), best)
            return PlanFront(against, unit, given, least, points, is_interrupted=True)
        points = pareto_front(solve, least, kept[count - 1], count)
    keep(len(points) - 1, points[-1])
    return PlanFront(against, unit, given, least, points, is_interrupted)


def _checked(problem: Problem[Any], against: str) -> str:
    """Return the unit of the second objective, after a check of problem and objective."""
    spec = problem.spec
    if not isinstance(spec, PlanKeys):
        found = f"{spec.verb!r}; give a planning problem"
        problem.refuse(Fault(("verb",), "'plan' for slipfree pareto", found))
    if not spec.costs.get(SLIP):
        found = ", ".join(f"{name} = {weight:g}" for name, weight in spec.costs.items())
        found = f"{found or 'no costs'}; set it, for example with --set costs.slip=1e4"
        problem.refuse(Fault(("costs",), "a positive weight costs.slip", found))
    if against == DURATION:
        return "s"
    known = f"expected {', '.join(USUAL)} or the name of a quantity of the model"
    if against in (SLIP, TIME):
        remedy = "slip is the first objective: choose another"
        remedy = "use 'duration'" if against == TIME else remedy
        raise DataError(f"--against {against}: {known}, found {against!r}; {remedy}")
    try:
        (cost,) = costs_of(build(problem).dae, {against: 1.0})
    except ModelError as error:
        why = str(error).partition("; ")[2]
        if against == ENERGY:
            why = "the energy needs drive torques: give the masses of the vehicle"
        raise DataError(f"--against {against}: {known}, found {against!r}; {why}") from error
    return cost.unit


def _key(table: str, name: str) -> str:
    return f"{table}.{json.dumps(name)}"


def _without(problem: Problem[PlanKeys], *kept: str) -> SettingTexts:
    """Return the settings that remove all costs except those named in ``kept``."""
    return tuple(f"{_key('costs', name)}=" for name in problem.spec.costs if name not in kept)


def _slip_settings(problem: Problem[PlanKeys], against: str, bound: float | None) -> SettingTexts:
    """Return the settings of the plan of least slip, with a bound on the second objective."""
    if against == DURATION:
        return (*_without(problem, SLIP), f"plan.duration={bound!r}")
    kept = (*_without(problem, SLIP, against), f"{_key('costs', against)}=0.0")
    return kept if bound is None else (*kept, f"{_key('cost_limits', against)}={bound!r}")


def _solve_point(task: _PointTask, report: LineCallback | None = None) -> FrontPoint:
    """Return the point of a task; raise KeyboardInterrupt if its search is interrupted."""

    def named(phase: str, line: str) -> None:
        if report is not None:
            report(f"{task.name}, {phase}", f"{task.name}, {line}")

    try:
        result = run_problem(task.recipe.load(), None, report and named, task.resume)
    except SolverError as error:
        return FrontPoint(task.bound, outcome=Outcome.SOLVER_FAILURE, words=str(error))
    except (ModelError, DataError) as error:  # such as limits that contradict the bound
        return FrontPoint(task.bound, outcome=Outcome.INFEASIBLE, words=str(error))
    if result.outcome is Outcome.INTERRUPTED:
        raise KeyboardInterrupt
    # The set-up and the problem's loader do not fit into a pipe; the set-up is rebuilt on request.
    return _point(replace(result, setup=None, load=task.recipe.load), task.bound, task.against)


def _point(result: Result, bound: float, against: str) -> FrontPoint:
    """Return the point of a result."""
    run = result.trajectory
    if result.outcome is not Outcome.COMPLETE:
        return FrontPoint(bound, outcome=result.outcome, words=outcome_words(run))
    spec, facts = result.problem.spec, verb_of(result.problem).facts(run)

    def value(name: str, default: float = 0.0) -> float:
        return float(facts[name].value) if name in facts else default

    weight, squared = spec.costs.get(SLIP, np.nan), value("plan_cost_slip", np.nan)
    smooth = spec.plan.smooth * value("plan_cost_smoothness") / weight
    second = value("duration" if against == DURATION else f"plan_cost_{against}")
    saved = from_arrays(result.arrays, str(result.problem.source.path))
    plan = FrontPlan(result, saved, value("slip_per_path", np.nan), squared, value("duration"))
    return FrontPoint(
        second if np.isnan(bound) else bound,
        squared + smooth,
        second,
        value(f"plan_price_{against}") / weight,
        result.outcome,
        solution=plan,
    )


def front_facts(front: PlanFront) -> Lines:
    """Return the facts about the given plan, the least second objective, and the front's points."""
    unit, given = unit_words(front.unit), front.given
    solved = sum(each.is_solved for each in front.points)
    dominated = sum(each.is_dominated for each in front.points)
    slip = f"slip {1e3 * given.solution.slip:.3g} mm per wheel and metre"
    return [
        ("costs of the problem", f"{front.against} {given.second:.4g} {unit}, {slip}"),
        (f"least {front.against}", f"{front.least.second:.4g} {unit}, slip not minimised"),
        ("front", f"{len(front.points)} points, {solved} solved, {dominated} dominated"),
    ]


def table_lines(front: PlanFront) -> Iterator[str]:
    """Yield the lines of the table of a front."""
    unit = unit_words(front.unit)
    columns = (
        TableColumn("point", "point"),
        TableColumn(f"{front.against} [{unit}]", front.against, ".4g"),
        TableColumn(f"at most [{unit}]", "bound", ".4g"),
        TableColumn("slip* [mm/m]", "slip_per_path", ".4g", "mm/m"),
        TableColumn("slip^2 [mm2/s]", "squared_slip", ".4g", "mm2/s"),
        TableColumn("smoothing [%]", "smoothness_share", ".4g", "%"),
        TableColumn(f"slope [mm2/s per {unit}]", "slope", ".4g", "mm2/s"),
        TableColumn("outcome", "outcome"),
    )
    rows = front_rows(front)
    for point, row in zip(front.points, rows, strict=True):
        row["outcome"] = (point.words or point.outcome.title).splitlines()[0]
        if point.is_solved:
            row["outcome"] = "dominated" if point.is_dominated else "solved"
    yield from table(columns, rows)
    yield "* per wheel and metre of path"


def front_rows(front: PlanFront) -> list[dict[str, Any]]:
    """Return the rows of the table of a front, with numbers in SI units."""
    none = FrontPlan(None, None, np.nan, np.nan, np.nan)
    return [
        {
            "point": number,
            "bound": point.bound,
            front.against: point.second,
            "slip_per_path": (plan := (point.solution if point.is_solved else none)).slip,
            "squared_slip": plan.squared_slip,
            "smoothness_share": 1 - plan.squared_slip / point.first,
            "slope": point.slope,
            "outcome": point.outcome.name.lower(),
            "dominated": int(point.is_dominated),
            "reason": point.words,
        }
        for number, point in enumerate(front.points, 1)
    ]
