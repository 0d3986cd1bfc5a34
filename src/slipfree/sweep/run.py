"""Execution of a sweep, or of its remaining runs."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

from slipfree.core.errors import DataError
from slipfree.files.netcdf import write
from slipfree.sweep.grid import Sweep
from slipfree.sweep.log import FAILED, LOST, NAME, Log, Rows
from slipfree.sweep.pools import Pool
from slipfree.sweep.table import NAME as TABLE
from slipfree.sweep.table import write_table
from slipfree.sweep.task import Task
from slipfree.system.processes import Poll, finish_tasks
from slipfree.system.regular_files import check_name


def run_sweep(
    sweep: Sweep,
    folder: Path,
    pool: Callable[[], Pool],
    *,
    keep: bool = False,
    again: bool = False,
    poll: Poll = lambda: None,
    progress: Callable[[Rows], None] = lambda _: None,
) -> Rows:
    """Execute the unfinished runs of a sweep; return the results of all runs.

    Tasks are created when the pool accepts them, and results are kept on disk. The required memory
    does not depend on the number of metrics.

    Parameters
    ----------
    sweep : Sweep
        The sweep.
    folder : Path
        Folder of the results. A line of ``runs.jsonl`` is written when a run is finished,
        ``table.csv`` at the end and after an interruption.
    pool : callable
        Function that returns the pool, such as ``lambda: ProcessPool(2)``; called only if there are
        unfinished runs.
    keep : bool
        Whether to write the motion of every run, to ``run_0001.nc`` and so on.
    again : bool
        Whether to repeat runs that failed; lost runs are always repeated.
    poll : callable
        Called several times per second; an exception that it raises interrupts the sweep.
    progress : callable
        Called with the finished runs at the beginning and after every run.

    Raises
    ------
    DataError
        If the folder cannot be written, or contains the results of another sweep.
    SlipfreeError
        If the pool fails.
    """
    check_name(folder)
    if folder.exists() and not folder.is_dir():
        raise DataError(
            f"{folder}: expected a folder for the sweep, found a file; choose another folder with "
            "-o"
        )
    with Log(folder / NAME, sweep.head, again=again) as log:
        try:
            progress(log.rows)
            if len(log.rows) < sweep.count:
                with closing(pool()) as opened:
                    for done in finish_tasks(_tasks(sweep, log.rows, keep), opened, poll):
                        if done.trajectory is not None:
                            file = result_path(folder, sweep, done.row.run)
                            write(file, done.trajectory, done.arrays)
                        log.append(done.row)
                        progress(log.rows)
        finally:
            write_table(folder / TABLE, sweep, log.rows)
        return log.rows


def _tasks(sweep: Sweep, rows: Rows, keep: bool) -> Iterator[Task]:
    """Yield the tasks of all runs that are not finished."""
    path, text = str(sweep.problem.source.path.resolve()), sweep.problem.source.text
    files = json.dumps(dict(sweep.files))
    for run in sweep.runs():
        if run.number not in rows:
            own, trusted = len(sweep.keys), sweep.problem.trusted
            yield Task(run.number, path, text, run.settings, own, keep, files, trusted)


def result_path(folder: Path, sweep: Sweep, number: int) -> Path:
    """Return the path of the result file of a run."""
    return folder / f"run_{number:0{max(4, len(str(sweep.count)))}d}.nc"


def missing_results(folder: Path, sweep: Sweep, rows: Rows) -> list[int]:
    """Return the numbers of the runs that have a motion but no result file in a folder."""
    moved = rows.ended(*(set(rows.outcomes) - {FAILED, LOST}))
    return [run for run in moved if not result_path(folder, sweep, run).exists()]
