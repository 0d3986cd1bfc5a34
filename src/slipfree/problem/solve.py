"""From a validated problem to a motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from slipfree.files.netcdf import NOTHING
from slipfree.files.toml.errors import ProblemError
from slipfree.forks import computing
from slipfree.frames import STORED, WANTED
from slipfree.models.friction_feasibility import BEST, best_utilisation
from slipfree.models.montana import Difference, cross_check
from slipfree.models.records import is_determinate
from slipfree.plan.warm_start import SavedPlan
from slipfree.problem import schema
from slipfree.problem.build_common import Setup, vehicle_facts
from slipfree.problem.build_ground import at, filled_words, ground_facts
from slipfree.problem.build_model import law_name
from slipfree.problem.load import Problem, climbs
from slipfree.problem.summary import Facts
from slipfree.problem.verbs.climb import Climbing, build_climb, climbed
from slipfree.problem.verbs.direct import build_direct
from slipfree.problem.verbs.inverse import build_inverse, solve_inverse
from slipfree.problem.verbs.plan import Planning, build_plan, planned
from slipfree.records import Array, leaves
from slipfree.regular_files import escape_name
from slipfree.solve.options import SolverOptions
from slipfree.solve.simulate import simulate
from slipfree.terrain.base import Grid
from slipfree.trajectory import SolverError, Trajectory

Progress = Callable[[float], None]


class Outcome(NamedTuple):
    """What came of a problem.

    Attributes
    ----------
    trajectory : Trajectory
        The motion, whole or to where it stopped.
    setup : Setup or Climbing
        What it ran on.
    arrays : mapping of str to ndarray
        From which another plan may start, for the result file; empty if it is none.
    """

    trajectory: Trajectory
    setup: Setup | Climbing
    arrays: Mapping[str, Array] = NOTHING


@computing
def build(problem: Problem[schema.Motion]) -> Setup:
    """Return the model, the start and the inputs of a problem.

    Raises
    ------
    ProblemError
        If the ground cannot be read or made, names are unknown, the vehicle cannot stand at the
        start, or cannot move from there as is asked for.
    """
    spec = problem.spec
    if isinstance(spec, schema.Inverse):
        return build_inverse(problem, spec)
    if isinstance(spec, schema.Direct):
        return build_direct(problem, spec)
    if isinstance(spec, schema.Plan):
        return build_plan(problem, spec)
    raise TypeError(f"expected a problem of a motion, found {spec.verb!r}")


@computing
def run_problem(
    problem: Problem[schema.Motion] | Problem[schema.Climb],
    progress: Progress | None = None,
    tell: Callable[[str], None] | None = None,
    resume: SavedPlan | None = None,
) -> Outcome:
    """Return the motion that a problem asks for.

    Parameters
    ----------
    problem : Problem
        From `load_problem`.
    progress : callable, optional
        Called with the time reached. [s]
    tell : callable, optional
        Called with one line about every iterate of a plan.
    resume : SavedPlan, optional
        The plan from which to start.

    Raises
    ------
    ProblemError
        If the problem cannot be built.
    SolverError
        If the integrator fails before the first sample; later failures are a stop of the
        trajectory.
    """
    if climbs(problem):
        return _climbed(problem, progress)
    setup, options = build(problem), problem.spec.solver.options
    arrays = NOTHING
    with at(problem, ("start",)):
        if isinstance(problem.spec, schema.Plan) and isinstance(setup, Planning):
            found, arrays = planned(problem, problem.spec, setup, tell, resume)
        elif isinstance(problem.spec, schema.Inverse):
            found = solve_inverse(problem.spec, setup, options, progress)
        else:
            found = _integrated(setup, options, progress)
    found = _diagnosed(setup, found)
    attributes = {**found.attributes, **_attributes(problem, setup)}
    return Outcome(replace(found, attributes=attributes), setup, arrays)


def _diagnosed(setup: Setup, run: Trajectory) -> Trajectory:
    """Return a motion with its diagnostics; those that fail are named in its attributes."""
    diagnostics: dict[str, Callable[[Trajectory], Trajectory]] = {
        "filled_ground": partial(_filled, setup.ground.grid),
    }
    if setup.vehicle.mass and not is_determinate(setup.vehicle):
        diagnostics[BEST.name] = partial(best_utilisation, setup.vehicle, setup.terrain)
    failures = []
    for name, diagnose in diagnostics.items():
        try:
            run = diagnose(run)
        except Exception as error:  # whatever it is, the motion is not lost with it
            failures.append(f"{name}: {type(error).__name__}: {error}")
    if not failures:
        return run
    return replace(run, attributes={**run.attributes, "failed_diagnostics": "; ".join(failures)})


def _filled(grid: Grid, run: Trajectory) -> Trajectory:
    """Return a motion that states how far its wheels roll on filled ground, if they do."""
    words = filled_words(grid, run)
    return replace(run, attributes={**run.attributes, "filled_ground": words}) if words else run


def _climbed(problem: Problem[schema.Climb], progress: Progress | None) -> Outcome:
    setup = build_climb(problem)
    with at(problem, ("start",)):
        run, setup, arrays = climbed(problem, setup, progress)
    attributes = {**run.attributes, **_attributes(problem, setup)}
    return Outcome(replace(run, attributes=attributes), setup, arrays)


def _integrated(setup: Setup, options: SolverOptions, progress: Progress | None) -> Trajectory:
    """Return the motion, or what the integrator reached of it."""
    try:
        return simulate(
            setup.dae, setup.start, setup.inputs, setup.t, options=options, progress=progress
        )
    except SolverError as error:
        if error.trajectory is None:
            raise
        return error.trajectory


def check_cross(problem: Problem[schema.Motion] | Problem[schema.Climb]) -> schema.Direct:
    """Return the problem's record if there is another formulation of it; else say so."""
    if not isinstance(problem.spec, schema.Direct):
        where = problem.source.where(("verb",))
        raise ProblemError(
            f"{where}: expected 'direct' for --cross-check, found {problem.spec.verb!r}"
        )
    return problem.spec


def cross(problem: Problem[schema.Motion], outcome: Outcome) -> tuple[Difference, ...]:
    """Return where the same problem in the other formulation of contact ends up differently."""
    spec = check_cross(problem)
    other = spec.model_copy(update={"formulation": other_formulation(spec)})
    return cross_check(outcome.trajectory, run_problem(replace(problem, spec=other)).trajectory)


def other_formulation(spec: schema.Direct) -> str:
    """Return the formulation of contact that a problem does not ask for."""
    return "montana" if spec.formulation == "closure" else "closure"


def setup_facts(setup: Setup | Climbing) -> Facts:
    """Return what to tell about ground, vehicle and what drives it."""
    if isinstance(setup, Climbing):
        return setup.facts
    facts = ground_facts(setup.ground) + vehicle_facts(setup.vehicle)
    return [*facts, ("driven by", setup.driven)]


def _attributes(
    problem: Problem[schema.Motion] | Problem[schema.Climb], setup: Setup | Climbing
) -> dict[str, str]:
    """Return what a result must know about its problem."""
    source = problem.source
    settings = {"settings": "\n".join(dict.fromkeys(source.settings.values()))}
    inputs, spec = {}, problem.spec
    if isinstance(setup, Setup):
        inputs["inputs"] = " ".join(label.full for label in leaves(setup.model.labels.u))
    if not isinstance(spec, schema.Climb):
        inputs |= {STORED: "paper", WANTED: spec.frame}
    if isinstance(spec, schema.Modelled):
        inputs |= {"model": spec.model, "law": law_name(spec)}
    found = {
        "title": problem.spec.title or source.path.stem,
        "problem_file": source.path.name,
        "problem_folder": str(source.path.parent),  # as it was given
        "problem": source.text,
        **(settings if source.settings else {}),
        **inputs,
        **{name.replace(" ", "_"): words for name, words in setup_facts(setup)},
    }
    return {name: escape_name(words) for name, words in found.items()}
