"""Solution of problems, their results, and result files."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from slipfree.core.arguments import checked
from slipfree.core.errors import DataError, SlipfreeError
from slipfree.core.facts import Fact
from slipfree.core.outcome import Outcome
from slipfree.core.records import Array
from slipfree.core.trajectory import Stop, Trajectory, thin
from slipfree.files.export import check_motion, check_name
from slipfree.files.netcdf import read, read_arrays
from slipfree.files.toml.source import ProblemError
from slipfree.plan.polynomial_motion import SavedPlan
from slipfree.problem.build_ground import at
from slipfree.problem.inputs import (
    DRAWN,
    STORED,
    digest,
    files_read,
    input_names,
    read_stored,
    restored_vehicle,
    stored_inputs,
)
from slipfree.problem.load import check_option, find_motion_verb, load_problem, verb_of
from slipfree.problem.problem import Problem
from slipfree.problem.schema import MotionKeys, Runnable
from slipfree.problem.verbs.base import (
    CROSS_CHECK,
    VERB_ATTRIBUTE,
    CrossCheck,
    Lines,
    MotionVerb,
    Result,
    VerbSetup,
    VerbSolution,
    Watch,
    plain_facts,
)
from slipfree.system.forks import computing
from slipfree.system.regular_files import escape_name, resolve_links, unescape_name


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

    def store(solution: VerbSolution) -> None:
        kept[:] = [_result(problem, verb, solution, stored)]
        keep(kept[-1])

    setup = build(problem)
    stored = stored_inputs(problem)  # before a long search, in which files may change
    try:
        with at(problem, ("start",)):
            solution = verb.solve(problem, setup, Watch(progress, tell, path, store), resume)
        return _result(problem, verb, solution, stored)
    except KeyboardInterrupt:
        if not kept:
            raise
    except Exception as error:
        if not kept:
            raise
        kept[-1] = _failed(kept[-1], error)
    return kept[-1]


def _result(
    problem: Problem[Runnable], verb: MotionVerb, solution: VerbSolution, stored: str
) -> Result:
    run, setup, arrays = solution
    own = _attributes(problem, verb, setup)
    run = replace(run, attributes={**run.attributes, **own, STORED: stored})
    if isinstance(problem.spec, MotionKeys):
        run = run.in_frame(problem.spec.frame)
    return Result(verb.name, run, verb.verification(run), setup, arrays, lambda: problem)


def _failed(result: Result, error: Exception) -> Result:
    run = result.trajectory
    before = f"{run.stop.words}; " if run.stop else ""
    words = f"{before}{type(error).__name__}: {error}"
    stop = Stop("solver", float(run.t[-1]), words, Outcome.SOLVER_FAILURE)
    return replace(result, trajectory=replace(run, stop=stop))


@computing
def cross_check(result: Result) -> CrossCheck:
    """Solve the problem of a result in the other formulation of contact and compare the motions.

    ProblemError is raised if the verb of the problem does not offer a cross-check.
    """
    problem = result.problem
    check_option(problem, CROSS_CHECK)
    return verb_of(problem).cross_check(result)


def _attributes(problem: Problem[Any], verb: MotionVerb, setup: VerbSetup) -> dict[str, str]:
    source = problem.source
    settings = {"settings": "\n".join(dict.fromkeys(source.settings.values()))}
    attributes = {
        "title": problem.spec.title or source.path.stem,
        VERB_ATTRIBUTE: verb.name,
        "problem_file": source.path.name,
        "problem_folder": str(source.path.parent),  # as given
        "problem": source.text,
        **(settings if source.settings else {}),
        **verb.attributes(problem, setup),
        **{name.replace(" ", "_"): words for name, words in setup.facts},
    }
    return {name: escape_name(text) for name, text in attributes.items()}


@checked
def open_result(
    path: str | os.PathLike[str], folder: Path | None = None, *, samples: int | None = None
) -> Result:
    """Return the result in a file of ``slipfree run``.

    Parameters
    ----------
    path : path
        The result file.
    folder : Path, optional
        Folder of the input files of the problem. By default the problem's folder, the result's
        folder and the current folder are searched, in this order.
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
    problem = cache(partial(problem_of, file, run, folder))
    return Result(kind, run, verification, None, read_arrays(file), problem)


def motion_facts(run: Trajectory) -> Lines:
    """Return the summary of a stored motion, pairs of name and text.

    DataError is raised if facts of the result file have other types than those of its verb.
    """
    verb = find_motion_verb(run.attributes.get(VERB_ATTRIBUTE))
    with _readable_facts():
        return plain_facts(run) if verb is None else verb.summary(run)


def facts_of(run: Trajectory) -> Mapping[str, Fact]:
    """Return the facts of a stored motion, by name; errors are those of `motion_facts`."""
    verb = find_motion_verb(run.attributes.get(VERB_ATTRIBUTE))
    with _readable_facts():
        return run.facts if verb is None else verb.facts(run)


@contextmanager
def _readable_facts() -> Iterator[None]:
    try:
        yield
    except (AttributeError, TypeError, ValueError) as error:
        if isinstance(error, SlipfreeError):
            raise
        raise DataError(
            f"expected facts as slipfree run writes them, found others ({error}); run the problem "
            "again"
        ) from error


def shown(file: Path, name: str, folder: Path | None = None) -> Any:
    """Return the motion in a result file with ground and vehicle, as input of the viewer.

    ``name`` is that of the motion in the viewer. DataError is raised if the file cannot be read or
    contains no problem, or if input files of its problem are missing or have changed.
    """
    result = open_result(file, folder)
    return verb_of(result.problem).shown(result, name)


def export_mcap(file: Path, out: Path, folder: Path | None = None) -> None:
    """Write the motion in a result file as an MCAP file of ROS 2 messages; see `write_mcap`.

    Parameters
    ----------
    file, folder : Path
        As for `open_result`.
    out : Path
        File to write, ending in ``.mcap``.

    Raises
    ------
    DataError
        If the result cannot be read, is not a motion over terrain or contains no problem, if input
        files of its problem are missing or have changed, or if ``out`` cannot be written.
    """
    from slipfree.files.mcap import write_mcap
    from slipfree.problem.build_vehicle import read_robot
    from slipfree.problem.verbs.driving import vehicle_of

    check_name(out, file, (".mcap",))
    check_motion(file, read(file, lazy=True), ("x", "y", "z", "wheel_angle", "slip_along"))
    result = open_result(file, folder)
    vehicle, problem = vehicle_of(result), result.problem
    robot = read_robot(problem.spec.vehicle, problem)
    write_mcap(out, result.trajectory, vehicle, robot)


def result_files(file: Path, folder: Path | None = None) -> list[Path]:
    """Return a result file and the files of its problem, if these are found; see `open_result`."""
    files = [file]
    with suppress(SlipfreeError):  # the command reports it if it needs the problem
        files += files_read(problem_of(file, read(file, lazy=True), folder))
    return files


def problem_of(
    file: Path, run: Trajectory, folder: Path | None = None, changes: Sequence[str] = ()
) -> Problem[Any]:
    """Return the problem stored in a result, with further settings ``changes``.

    DataError is raised if the result contains no problem, or input files of the problem are
    missing; ProblemError if the problem is not valid in this version.
    """
    text = run.attributes.get("problem")
    if text is None:
        raise DataError(
            f"{file}: expected a result that contains its problem, found none; use a file written "
            "by slipfree run"
        )
    settings = run.attributes.get("settings", "").splitlines()
    name = Path(run.attributes.get("problem_file", "problem.toml")).name
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(scratch) / "problem.toml"  # a name from a file is not trusted
        copy.write_text(text, encoding="utf-8")
        try:
            original = load_problem(copy, settings)
            problem = load_problem(copy, [*settings, *changes]) if changes else original
        except ProblemError as error:
            faults = (fault.replace(str(copy), name) for fault in error.faults)
            raise ProblemError(
                f"{file}: its problem is not valid in this version of slipfree; correct these "
                "errors and run the problem again:",
                *faults,
            ) from error
    recorded = unescape_name(run.attributes.get("problem_folder", ""))
    stored = read_stored(file, run.attributes.get(STORED), original)
    place = _folder(file, problem.spec, recorded, folder, stored.files)
    source = replace(problem.source, path=place / name)
    vehicles = {}
    if stored.vehicle is not None:
        vehicles[stored.vehicle.file] = restored_vehicle(file, stored.vehicle, place)
    return replace(problem, source=source, vehicles=vehicles)


def _folder(
    file: Path, spec: Runnable, recorded: str, folder: Path | None, digests: Mapping[str, str]
) -> Path:
    """Return the first of several folders that contains all input files of a problem.

    ``recorded`` is the folder in the result file; ``folder``, if given, is the only one tried.
    ``digests`` are the SHA-256 of the files with which the result was computed.
    """
    needed = input_names(spec, DRAWN)
    here, beside = Path.cwd(), file.absolute().parent
    usual = [*(resolve_links(each / recorded) for each in (here, beside) if recorded), beside, here]
    tried = [folder] if folder is not None else list(dict.fromkeys(usual))
    # Path.is_file raises an error for names that are too long
    complete = [each for each in tried if all(os.path.isfile(each / name) for name in needed)]  # noqa: PTH113
    known = [name for name in needed if name in digests]  # the others are in the changed settings
    for place in complete:
        if all(digest(place / name) == digests[name] for name in known):
            return place
    if complete:
        raise DataError(
            f"{file}: expected the ground with which the result was computed, found a different "
            f"one ({', '.join(known)}) in {' and '.join(map(str, complete))}; restore the file, "
            "give its folder with --folder DIR, or run the problem again"
        )
    raise DataError(
        f"{file}: expected the input file{'s' * (len(needed) > 1)} {' and '.join(needed)} of its "
        f"problem in {' or '.join(map(str, tried))}, found "
        f"{'no folder with all of them' if len(needed) > 1 else 'no such file'}; give the folder "
        "of the problem file with --folder DIR"
    )
