"""Results of problems, and result files."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from slipfree.core.errors import DataError, SlipfreeError
from slipfree.core.facts import Fact
from slipfree.core.trajectory import Trajectory, thin
from slipfree.files.export import check_motion, check_name
from slipfree.files.netcdf import read, read_arrays
from slipfree.files.toml.source import ProblemError
from slipfree.problem.input_files import DRAWN, digest, files_read, input_names
from slipfree.problem.load import load_problem
from slipfree.problem.problem import Problem
from slipfree.problem.schema import Runnable
from slipfree.problem.stored_inputs import STORED, read_stored, restored_vehicle
from slipfree.problem.summary import Lines, plain_facts
from slipfree.problem.verbs.base import VERB_ATTRIBUTE
from slipfree.problem.verbs.base import Result as Result
from slipfree.problem.verbs.registry import find_motion_verb, verb_of
from slipfree.system.regular_files import resolve_links, unescape_name


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
    """Return the summary of a motion, pairs of name and text."""
    verb = find_motion_verb(run.attributes.get(VERB_ATTRIBUTE))
    return plain_facts(run) if verb is None else verb.summary(run)


def facts_of(run: Trajectory) -> Mapping[str, Fact]:
    """Return the facts of a motion, by name."""
    verb = find_motion_verb(run.attributes.get(VERB_ATTRIBUTE))
    return run.facts if verb is None else verb.facts(run)


def shown(file: Path, name: str, folder: Path | None = None) -> Any:
    """Return the motion in a result file with ground and vehicle, as input of the viewer.

    Parameters
    ----------
    file, folder : Path
        As for `open_result`.
    name : str
        Name of the motion in the viewer.

    Raises
    ------
    DataError
        If the file cannot be read or contains no problem, or if input files of its problem are
        missing or have changed.
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
    from slipfree.files.mcap_writer import write_mcap
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
    found = [file]
    with suppress(SlipfreeError):  # the command reports it if it needs the problem
        found += files_read(problem_of(file, read(file, lazy=True), folder))
    return found


def problem_of(
    file: Path, run: Trajectory, folder: Path | None = None, changes: Sequence[str] = ()
) -> Problem[Any]:
    """Return the problem stored in a result.

    Parameters
    ----------
    file, folder : Path
        As for `open_result`.
    run : Trajectory
        The motion in the file.
    changes : sequence of str
        Further settings, such as ``"terrain.friction=0.4"``.

    Raises
    ------
    DataError
        If the result contains no problem, or input files of the problem are missing.
    ProblemError
        If the problem is not valid in this version.
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

    Raises
    ------
    DataError
        If no folder contains them all, or files have changed.
    """
    needed = input_names(spec, DRAWN)
    here, beside = Path.cwd(), file.absolute().parent
    usual = [*(resolve_links(each / recorded) for each in (here, beside) if recorded), beside, here]
    tried = [folder] if folder is not None else list(dict.fromkeys(usual))
    complete = [each for each in tried if all(_is_file(each / name) for name in needed)]
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


def _is_file(path: Path) -> bool:
    return os.path.isfile(path)  # noqa: PTH113 - False for names that are too long
