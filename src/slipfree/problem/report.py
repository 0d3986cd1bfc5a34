"""Report of a result file: facts, checks, figures, problem and versions."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from slipfree.core.trajectory import Trajectory, outcome_words
from slipfree.core.version import __version__
from slipfree.files.cf import MAP_TRANSFORM
from slipfree.files.netcdf import ORIGIN, read
from slipfree.files.toml.source import ProblemError
from slipfree.problem.inputs import STORED, digest
from slipfree.problem.load import find_motion_verb, verb_of
from slipfree.problem.result import motion_facts, open_result
from slipfree.problem.verbs.base import Lines, MotionVerb, Result, outcome_fact, ranges
from slipfree.show.html_report import Report
from slipfree.show.plots import Plot
from slipfree.show.thinning import FIGURE_SAMPLES

VERSION = "_version"
ELSEWHERE = (  # attributes reported in other sections
    "problem",
    "settings",
    "history",
    "title",
    "date_created",
    "problem_folder",
    STORED,
    MAP_TRANSFORM,
)


class _ReportFigures(NamedTuple):
    """Figures of a result, and a note on omitted samples or the reason for missing figures."""

    figures: Sequence[Plot]
    note: str


def report(file: Path, folder: Path | None = None) -> Report:
    """Return the report of a result file.

    DataError is raised if the file cannot be read, or input files of its problem are missing.

    Parameters
    ----------
    file : Path
        A result file.
    folder : Path, optional
        Folder of the input files of its problem; see `open_result`.
    """
    result = open_result(file, folder, samples=FIGURE_SAMPLES)
    run, verb = read(file, lazy=True), find_motion_verb(result.kind)
    facts, names = [outcome_fact(run), *motion_facts(run)], verb.checks if verb else ()
    found = run.attributes
    rest = [(name, words) for name, words in facts if name not in names]
    checks = [(name, words) for name, words in facts if name in names]
    spans = [(name, words, run.columns[name].label.words) for name, words in ranges(run)]
    tables: dict[str, Sequence[tuple[str, ...]]] = {
        "Result": rest,
        "Checks": checks,
        "Set-up": _set_up(found),
        "Quantities": spans,
        "Versions": _versions(file, found),
    }
    return Report(
        found["title"],
        _lead(run, verb),
        run.stop is None,
        tables,
        *_drawn(result, run.t.size),
        _texts(file, found),
    )


def _lead(run: Trajectory, verb: MotionVerb | None) -> str:
    """Return a sentence on the outcome of a motion, as lead of its report."""
    words = outcome_words(run)
    if run.stop is None and verb is not None:
        words = verb.describe_end(run) or words
    return f"{words[0].upper()}{words[1:]}."


def _set_up(found: Mapping[str, str]) -> Lines:
    """Return the facts of a result about ground, vehicle and inputs."""
    return [
        (name.replace("_", " "), words)
        for name, words in found.items()
        if name not in ELSEWHERE and not name.endswith(VERSION)
    ]


def _versions(file: Path, found: Mapping[str, str]) -> Lines:
    """Return the facts about versions, date and digest of a result file."""
    parts = [
        (name.removesuffix(VERSION), words)
        for name, words in found.items()
        if name.endswith(VERSION)
    ]
    return [
        ("computed", found.get("date_created", "date unknown")),
        *parts,
        ("result file", file.name),
        ("SHA-256 of the file", digest(file)),
        ("this page", f"written by slipfree {__version__}"),
    ]


def _texts(file: Path, found: Mapping[str, str]) -> dict[str, str]:
    """Return the texts of the problem file and of the commands to repeat the run, by title."""
    if "problem" not in found:
        return {}
    name = f"{Path(found.get('problem_file', 'problem.toml')).stem}_again.toml"
    settings = found.get("settings", "").splitlines()
    words = ["slipfree", "run", name, *(part for each in settings for part in ("--set", each))]
    again = f"slipfree info {shlex.quote(file.name)} --problem > {shlex.quote(name)}\n"
    again += f"{shlex.join(words)}   # with slipfree {found[ORIGIN]}\n"
    return {"Problem": found["problem"], "To repeat the run": again}


def _drawn(result: Result, count: int) -> _ReportFigures:
    """Return the figures of ``slipfree run``, or the reason why they cannot be drawn."""
    if "problem" not in result.trajectory.attributes:
        return _ReportFigures(
            (), "No figures: the result contains no problem file, so that its ground is unknown."
        )
    try:
        shown = result.trajectory.t.size
        note = f"The figures show {shown} of {count} samples, including the extremes of all "
        note += "quantities; the tables use all samples."
        figures = verb_of(result.problem).figures(result)
        return _ReportFigures(figures, note if shown < count else "")
    except ProblemError as error:
        return _ReportFigures((), f"No figures: {error}")
