"""Solution of problems, their results, and result files."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from slipfree.core.arguments import checked
from slipfree.core.errors import DataError, SlipfreeError
from slipfree.core.facts import Fact, Lines, lines
from slipfree.core.outcome import Outcome
from slipfree.core.records import Array
from slipfree.core.trajectory import Stop, Trajectory, thin
from slipfree.files.netcdf import check_motion, check_name, read, read_arrays
from slipfree.files.toml.source import ProblemError
from slipfree.plan.polynomial_motion import SavedPlan
from slipfree.problem.build import Setup
from slipfree.problem.build_ground import at, ground_table
from slipfree.problem.inputs import DIGESTS, digests
from slipfree.problem.load import check_option, find_motion_verb, load_again, verb_of
from slipfree.problem.problem import Problem
from slipfree.problem.schema import MotionKeys, Runnable
from slipfree.problem.stored_world import STORED, read_world, store_world
from slipfree.problem.verbs.base import (
    CROSS_CHECK,
    PLAIN_ROWS,
    VERB_ATTRIBUTE,
    CrossCheck,
    Result,
    Watch,
    values_of,
)
from slipfree.problem.verbs.driving import DriveVerb
from slipfree.system.forks import computing
from slipfree.system.regular_files import escape_name, unescape_name


@computing
def build(problem: Problem[Runnable]) -> Any:
    """Return the set-up of a problem; raise ProblemError if it cannot be built."""
    return verb_of(problem).build(problem)


@checked
@computing
def run_problem(
    problem: Problem[Runnable],
    progress: Callable[[float], None] | None = None,
    tell: Callable[[str, str], None] | None = None,
    resume: SavedPlan | None = None,
    path: Callable[[Array], None] | None = None,
    keep: Callable[[Result], None] = lambda _: None,
    beside: Path | None = None,
) -> Result:
    """Solve a problem and return its motion.

    After Ctrl-C, or after an error in a diagnostic, the result is what was computed before.

    Parameters
    ----------
    problem : Problem
        Result of `load_problem`.
    progress : callable, optional
        Called with the time reached by the integrator. [s]
    tell : callable, optional
        Called for every iterate of a plan with the phase of the search and a line of text.
    resume : SavedPlan, optional
        Plan for a warm start; only for planning problems.
    path : callable, optional
        Called for every iterate of a plan with the path of the platform, shape (n, 2). [m]
    keep : callable, optional
        Called with what is computed so far, such as a solved plan that is not verified.
    beside : Path, optional
        Output, next to which a folder keeps the drawn worlds of a robust plan until it is found:
        after Ctrl-C, they are not simulated again.

    Returns
    -------
    Result
        The motion, complete or up to its stop.

    Raises
    ------
    ProblemError
        If the problem cannot be built, or cannot be solved from its start, for example because
        start, goal and limits of a plan contradict each other.
    SolverError
        If the integrator fails before the first sample; a later failure is the stop of
        the trajectory.
    KeyboardInterrupt
        After Ctrl-C before anything is computed.
    """
    verb, kept = verb_of(problem), list[Result]()

    def store(run: Trajectory, arrays: Mapping[str, Array]) -> None:
        kept[:] = [result_of(problem, verb, setup, run, arrays, files)]
        keep(kept[-1])

    setup = build(problem)
    watch = Watch(progress, tell, path, store, beside)
    files = digests(problem)  # before a long search, in which files may change
    try:
        with at(problem, ("start",)):
            run, arrays = verb.solve(problem, setup, watch, resume)
        return result_of(problem, verb, setup, run, arrays, files)
    except KeyboardInterrupt:
        if not kept:
            raise
    except Exception as error:
        if not kept:
            raise
        run = kept[-1].trajectory
        before = f"{run.stop.words}; " if run.stop else ""
        words = f"{before}{type(error).__name__}: {error}"
        stop = Stop("solver", float(run.t[-1]), words, Outcome.SOLVER_FAILURE)
        kept[-1] = replace(kept[-1], trajectory=replace(run, stop=stop))
    return kept[-1]


def result_of(
    problem: Problem[Any],
    verb: DriveVerb,
    setup: Setup,
    run: Trajectory,
    arrays: Mapping[str, Array],
    further: dict[str, str],
) -> Result:
    """Return the result of a problem with all that its file contains, and further attributes."""
    world, world_arrays = store_world(problem, setup, run, arrays)
    source = problem.source
    settings = {"settings": "\n".join(dict.fromkeys(source.settings.values()))}
    own = {
        "title": problem.spec.title or source.path.stem,
        VERB_ATTRIBUTE: verb.name,
        "problem_file": source.path.name,
        "problem_folder": str(source.path.parent),  # as given
        "problem": source.text,
        **(settings if source.settings else {}),
        **verb.attributes(problem, setup),
        **{name.replace(" ", "_"): words for name, words in setup.facts},
    }
    own = {name: escape_name(text) for name, text in own.items()} | {STORED: world} | further
    run = replace(run, attributes={**run.attributes, **own})
    table, friction = ground_table(problem.spec.terrain), problem.spec.terrain.friction
    problem = replace(problem, grounds={table: (friction, setup.ground)})
    arrays = {**arrays, **world_arrays}
    if isinstance(problem.spec, MotionKeys):
        run = run.in_frame(problem.spec.frame)
    return Result(verb.name, run, verb.verification(run), setup, arrays, lambda: problem)


@computing
def cross_check(result: Result) -> CrossCheck:
    """Solve the problem of a result in the other formulation of contact and compare the motions.

    ProblemError is raised if the verb of the problem does not offer a cross-check.
    """
    problem = result.problem
    check_option(problem, CROSS_CHECK)
    return verb_of(problem).cross_check(result)


@checked
def open_result(path: str | os.PathLike[str], *, samples: int | None = None) -> Result:
    """Return the result in a file of ``slipfree run``; no other file is read.

    Parameters
    ----------
    path : path
        The result file.
    samples : int, optional
        Approximate number of samples to keep, in addition to all extremes (see
        `slipfree.core.trajectory.thin`); by default all are kept.

    Raises
    ------
    DataError
        If the file cannot be read or is not a result.
    """
    file = Path(path)
    run = read(file) if samples is None else thin(read(file, lazy=True), samples)
    verb = find_motion_verb(run.attributes.get(VERB_ATTRIBUTE))
    kind, verification = (verb.name, verb.verification(run)) if verb else ("", {})
    arrays = read_arrays(file)
    problem = cache(partial(problem_of, file, run, arrays))
    return Result(kind, run, verification, None, arrays, problem)


def motion_facts(run: Trajectory) -> Lines:
    """Return the summary of a stored motion, pairs of name and text; see `facts_of` for errors."""
    return _facts_and_summary(run)[1]


def facts_of(run: Trajectory) -> Mapping[str, Fact]:
    """Return the facts of a stored motion, by name.

    DataError is raised if facts of the result file have other types than those of its verb.
    """
    return _facts_and_summary(run)[0]


def _facts_and_summary(run: Trajectory) -> tuple[Mapping[str, Fact], Lines]:
    verb = find_motion_verb(run.attributes.get(VERB_ATTRIBUTE))
    try:
        facts = verb.facts(run) if verb else run.facts
        return facts, lines(verb.rows if verb else PLAIN_ROWS, values_of(run, facts))
    except (AttributeError, TypeError, ValueError) as error:
        if isinstance(error, SlipfreeError):
            raise
        raise DataError(
            f"expected facts as slipfree run writes them, found others ({error}); run the problem "
            "again"
        ) from error


def export_mcap(file: Path, out: Path) -> None:
    """Write the motion in a result file as an MCAP file of ROS 2 messages; see `write_mcap`.

    Parameters
    ----------
    file : Path
        The result file.
    out : Path
        File to write, ending in ``.mcap``.

    Raises
    ------
    DataError
        If the result cannot be read, is not a motion over terrain or does not contain problem and
        vehicle, or if ``out`` cannot be written.
    """
    from slipfree.files.mcap import write_mcap
    from slipfree.problem.build_vehicle import vehicle_file
    from slipfree.problem.verbs.driving import world_of

    check_name(out, file, (".mcap",))
    check_motion(file, read(file, lazy=True), ("x", "y", "z", "wheel_angle", "slip_along"))
    result = open_result(file)
    vehicle, problem = world_of(result).vehicle, result.problem
    robot = vehicle_file(problem.spec.vehicle, problem).robot
    write_mcap(out, result.trajectory, vehicle, robot)


def result_files(file: Path) -> list[Path]:
    """Return a result file and the files from which it was computed, as far as it names them."""
    files = [file]
    with suppress(SlipfreeError, ValueError, TypeError):  # the command reports unreadable results
        attributes = read(file, lazy=True).attributes
        folder = Path(unescape_name(attributes.get("problem_folder", "")))
        names = [attributes["problem_file"], *json.loads(attributes.get(DIGESTS, "{}"))]
        files += [folder / name for name in names]
    return files


def problem_of(
    file: Path, run: Trajectory, arrays: Mapping[str, Array], changes: Sequence[str] = ()
) -> Problem[Any]:
    """Return the problem stored in a result, with further settings ``changes``.

    Ground and vehicle are those in the result, unless a setting changes them; names of files in
    ``changes`` are relative to the current folder. DataError is raised if the result does not
    contain its problem, ground and vehicle; ProblemError if the problem is not valid in this
    version.
    """
    text = run.attributes.get("problem")
    if text is None:
        raise DataError(
            f"{file}: expected a result that contains its problem, found none; use a file written "
            "by slipfree run"
        )
    grounds, vehicles = read_world(file, run, arrays)
    settings = run.attributes.get("settings", "").splitlines()
    name = Path(Path(run.attributes.get("problem_file", "problem.toml")).name)
    try:
        problem = load_again(name, text, settings, grounds=grounds)
        stored, spec = {None, *vehicles}, problem.spec
        if spec.vehicle.file not in stored or ground_table(spec.terrain) not in grounds:
            raise DataError(
                f"{file}: expected a result with the ground and vehicle of its problem, found "
                "others; run the problem again"
            )
        if changes:
            problem = load_again(name, text, [*settings, *changes], grounds=grounds)
    except ProblemError as error:
        raise ProblemError(
            f"{file}: its problem is not valid in this version of slipfree; correct these "
            "errors and run the problem again:",
            *error.faults,
        ) from error
    return replace(problem, vehicles=vehicles)
