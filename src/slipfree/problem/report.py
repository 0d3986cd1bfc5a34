"""From a result file to a report of it: facts, checks, figures, the problem, versions."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from slipfree.files.netcdf import ORIGIN, read, read_arrays
from slipfree.files.toml.errors import ProblemError
from slipfree.problem import schema
from slipfree.problem.build_ground import build_ground
from slipfree.problem.load import Problem, climbs
from slipfree.problem.reload import problem_of
from slipfree.problem.solve import build
from slipfree.problem.summary import Facts, motion_facts, ranges
from slipfree.problem.verbs.climb import build_climb
from slipfree.problem.verbs.climb_plan import PROGRESS
from slipfree.problem.verbs.plan import Planning, figure_options
from slipfree.records import Array, Label
from slipfree.show.climb_figures import climb_figures
from slipfree.show.html_report import Report
from slipfree.show.motion_figures import figures
from slipfree.show.plan_figures import plan_figures
from slipfree.trajectory import Column, Trajectory
from slipfree.version import __version__

CHECKS = (  # the facts that tell how far a result is to be trusted
    "closure residual",
    "Newton step",
    "drift of the assembly",
    "singular value",
    "contact certificate",
    "not converged",
    "diagnostics failed",
    "margin",
    "simulated",
    "round trip",
    "replay by the direct model",
    "replay stopped early",
    "driven by friction",
    "friction",
    "  best distribution",
    "energy",
    "slow climb",
    "integrator",
    "collocation",
)
OF_AXLES = {"wheel_rate": "rad s-1", "friction": "N", "load": "N"}  # what figures show of a plan
VERSION = "_version"
ELSEWHERE = (  # attributes that are told in other places
    "problem",
    "settings",
    "history",
    "title",
    "climb",
    "slow_climb",
    "by_friction",
    "replay_stopped",
    "failed_diagnostics",
    "date_created",
    "problem_folder",
)


class _Drawn(NamedTuple):
    """Figures by name, or why there are none."""

    figures: Mapping[str, Figure]
    note: str


def report(file: Path, folder: Path | None = None) -> Report:
    """Return the report of a result file.

    Parameters
    ----------
    file : Path
        A result file.
    folder : Path, optional
        Where names of files in its problem start; see `slipfree.problem.reload`.

    Raises
    ------
    DataError
        If the file cannot be read, or files that its problem names are missing.
    """
    run = read(file)
    drawn, facts = _drawn(file, run, folder), motion_facts(run)
    found = run.attributes
    told = [(name, words) for name, words in facts if name not in CHECKS]
    checks = [(name, words) for name, words in facts if name in CHECKS]
    spans = [(name, words, run.columns[name].label.words) for name, words in ranges(run)]
    tables: dict[str, Sequence[tuple[str, ...]]] = {
        "What came of it": told,
        "Checks": checks,
        "Set-up": _set_up(found),
        "Quantities": spans,
        "Versions": _versions(file, found),
    }
    return Report(found["title"], _lead(run), run.stop is None, tables, *drawn, _texts(file, found))


def _lead(run: Trajectory) -> str:
    """Return how a motion ended in a sentence."""
    if run.stop is not None:
        return f"Stopped early at t = {run.stop.t:.6g} s: {run.stop.words}."
    if "climb" in run.attributes:
        return f"{run.attributes['climb'].capitalize()}."
    return f"Reached the time asked for, {run.t[-1]:g} s."


def _set_up(found: Mapping[str, str]) -> Facts:
    """Return what a result says about ground, vehicle and drive."""
    return [
        (name.replace("_", " "), words)
        for name, words in found.items()
        if name not in ELSEWHERE and not name.endswith(VERSION)
    ]


def _versions(file: Path, found: Mapping[str, str]) -> Facts:
    """Return what computed a result, and what identifies its file."""
    parts = [
        (name.removesuffix(VERSION), words)
        for name, words in found.items()
        if name.endswith(VERSION)
    ]
    return [
        ("computed", found.get("date_created", "unknown when")),
        *parts,
        ("result file", file.name),
        ("its SHA-256", sha256(file.read_bytes()).hexdigest()),
        ("this page", f"written by slipfree {__version__}"),
    ]


def _texts(file: Path, found: Mapping[str, str]) -> dict[str, str]:
    """Return the problem file, and how to run it again."""
    if "problem" not in found:
        return {}
    name = f"{Path(found.get('problem_file', 'problem.toml')).stem}_again.toml"  # theirs is kept
    settings = found.get("settings", "").splitlines()
    words = ["slipfree", "run", name, *(part for each in settings for part in ("--set", each))]
    again = f"slipfree info {shlex.quote(file.name)} --problem > {shlex.quote(name)}\n"
    again += f"{shlex.join(words)}   # with slipfree {found[ORIGIN]}\n"
    return {"Problem": found["problem"], "To run it again": again}


def _drawn(file: Path, run: Trajectory, folder: Path | None) -> _Drawn:
    """Return the figures that ``slipfree run`` draws, or why they cannot be drawn again."""
    if "problem" not in run.attributes:
        return _Drawn({}, "None: the result holds no problem file, so its ground is not known.")
    try:
        return _Drawn(_figures(run, problem_of(file, run, folder), read_arrays(file)), "")
    except ProblemError as error:
        return _Drawn({}, f"None: {error}")


def _figures(
    run: Trajectory,
    problem: Problem[schema.Motion] | Problem[schema.Climb],
    arrays: Mapping[str, Array],
) -> dict[str, Figure]:
    """Return the figures of a motion, on the ground that its problem makes again."""
    if climbs(problem):
        setup = build_climb(problem)
        return climb_figures(run, setup.climber, setup.profile, _plan(run, arrays))
    if not isinstance(problem.spec, schema.Plan):
        return figures(run, build_ground(problem).grid)
    planning = build(problem)
    if not isinstance(planning, Planning):
        raise TypeError(f"expected what a plan needs, found {type(planning).__name__}")
    grid = planning.ground.grid
    return plan_figures(run, grid, planning.layers, **figure_options(planning)) | figures(run, grid)


def _plan(run: Trajectory, arrays: Mapping[str, Array]) -> Trajectory | None:
    """Return the plan of a climb from what its result keeps of it; None if it has none."""
    if "plan_time" not in arrays:
        return None
    columns = {PROGRESS.name: Column(PROGRESS, arrays[f"plan_{PROGRESS.name}"])}
    for name, unit in OF_AXLES.items():
        values = np.stack([arrays[f"plan_{name}_{axle}"] for axle in run.wheels], axis=1)
        columns[name] = Column(Label(name, unit, f"{name} of the plan"), values)
    statistics = {"mu": run.statistics["climb_plan_friction"]}
    return Trajectory(arrays["plan_time"], columns, run.wheels, statistics=statistics)
