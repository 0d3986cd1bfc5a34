"""Do a sweep, or what is left of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

from slipfree.errors import DataError
from slipfree.files.netcdf import write
from slipfree.regular_files import check_name
from slipfree.sweep.grid import Sweep
from slipfree.sweep.log import NAME, Log, Row
from slipfree.sweep.pools import Poll, Pool
from slipfree.sweep.table import NAME as TABLE
from slipfree.sweep.table import write_table
from slipfree.sweep.task import Task


def swept(
    sweep: Sweep,
    folder: Path,
    pool: Pool,
    *,
    keep: bool = False,
    again: bool = False,
    poll: Poll = lambda: None,
    progress: Callable[[Sequence[Row]], None] = lambda _: None,
) -> list[Row]:
    """Return what came of all runs; those that the folder has already are not done again.

    Parameters
    ----------
    sweep : Sweep
        What to run.
    folder : Path
        Where ``runs.jsonl`` gets a line as soon as a run is finished, and ``table.csv`` is written
        at the end, be that an interruption.
    pool : Pool
        Where the runs are done: ``processes(2)``, ``cluster("tcp://...")``.
    keep : bool
        Whether to write every motion as ``run_0001.nc`` and so on.
    again : bool
        Whether to repeat runs that failed; those that were lost are always done again.
    poll : callable
        Called several times a second; what it raises interrupts the sweep.
    progress : callable
        Called with the finished runs, at the beginning and after every run.

    Raises
    ------
    DataError
        If the folder cannot be written, or holds the results of another sweep.
    SlipfreeError
        If a cluster goes away.
    """
    path = str(sweep.problem.source.path.resolve())
    check_name(folder)
    if folder.exists() and not folder.is_dir():
        raise DataError(f"{folder}: expected a folder for the sweep, found a file")
    with Log(folder / NAME, sweep.head, again=again) as log:
        finished = {row.run for row in log.rows}
        tasks = [
            Task(run.number, path, sweep.problem.source.text, run.settings, len(sweep.keys), keep)
            for run in sweep.runs()
            if run.number not in finished
        ]
        try:
            progress(log.rows)
            with closing(pool(tasks, poll)) as results:
                for done in results:
                    if done.trajectory is not None:
                        file = result_path(folder, sweep, done.row.run)
                        write(file, done.trajectory, done.arrays)
                    log.append(done.row)
                    progress(log.rows)
        finally:
            write_table(folder / TABLE, sweep, log.rows)
        return log.rows


def result_path(folder: Path, sweep: Sweep, number: int) -> Path:
    """Return where the result of a run is written, if results are."""
    return folder / f"run_{number:0{max(4, len(str(sweep.count)))}d}.nc"


def not_kept(folder: Path, sweep: Sweep, rows: Sequence[Row]) -> list[Row]:
    """Return the runs that have a motion, but no result file in a folder."""
    return [
        row
        for row in rows
        if row.t is not None and not result_path(folder, sweep, row.run).exists()
    ]
