"""Tasks of a sweep, and their results."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.files.netcdf import NOTHING
from slipfree.sweep.log import Row

COMPLETE = "complete"  # figure of every run: 1 if it reached its end


class Task(NamedTuple):
    """Task for a process: one run, with the text of the problem but not its input files.

    Attributes
    ----------
    run : int
        Number of the run.
    file : str
        Path of the problem file; input files are read relative to its folder.
    text : str
        Text of the problem file.
    settings : tuple of str
        Settings as ``key=value``.
    own : int
        Number of settings that are specific to this run; they are the last ones.
    keep : bool
        Whether to return the motion.
    files : str
        Identifier of the content of the input files. Runs of one process share maps and models if
        it is the same.
    trusted : frozenset of str
        Paths of xacro files that the command line trusts.
    """

    run: int
    file: str
    text: str
    settings: tuple[str, ...]
    own: int
    keep: bool
    files: str
    trusted: frozenset[str] = frozenset()


class Done(NamedTuple):
    """The result of a task.

    Attributes
    ----------
    row : Row
        Row for log and table.
    trajectory : Trajectory or None
        The motion, if it is requested and exists.
    arrays : mapping of str to ndarray
        Arrays of a plan for a warm start; empty for other motions.
    """

    row: Row
    trajectory: Trajectory | None = None
    arrays: Mapping[str, Array] = NOTHING


def without_motion(task: Task, outcome: str, words: str, seconds: float = 0.0) -> Done:
    """Return the result of a failed or lost run, with the reason; it has no motion."""
    return Done(
        Row(task.run, own_settings(task), outcome, words, None, {COMPLETE: (0.0, "1")}, seconds)
    )


def own_settings(task: Task) -> tuple[str, ...]:
    """Return the settings of a task that are specific to its run."""
    return task.settings[len(task.settings) - task.own :]
