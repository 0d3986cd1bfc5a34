"""``slipfree sweep``: many runs of one problem, their table and figures."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slipfree.cli.common import STOPPED, File, Settings, interruptible, reported, tell
from slipfree.cli.messages import detail, has_bar, put_file, say, warn
from slipfree.errors import DataError
from slipfree.regular_files import check_name

if TYPE_CHECKING:
    from slipfree.sweep.grid import Sweep
    from slipfree.sweep.log import Row
    from slipfree.sweep.pools import Pool

MOST_KEYS = 2  # that are drawn
FIGURES = "figures"


def sweep(
    file: File,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUES",
            help="A key and its values: KEY=a:b:n for n numbers from a to b, or KEY=v1,v2,...; "
            "repeatable: all combinations are run.",
        ),
    ] = None,
    repeat: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="N", help="Run each combination N times, with other seeds everywhere."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="The first seed of --repeat.")] = 1,
    settings: Settings = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="DIR",
            help="Folder of the results; default: the problem's name with _sweep, here. "
            "If it has some of this sweep, the others are done.",
        ),
    ] = None,
    processes: Annotated[
        int | None, typer.Option(min=1, metavar="P", help="Processes; default: one a core.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Run on the workers of this Dask scheduler."),
    ] = None,
    keep: Annotated[
        bool, typer.Option("--keep", help="Write the result of every run: DIR/run_0001.nc.")
    ] = False,
    again: Annotated[bool, typer.Option("--again", help="Repeat runs that failed.")] = False,
    figures: Annotated[
        list[str] | None,
        typer.Option(
            "--figure", metavar="NAME", help="A figure of the runs to tell and draw; repeatable."
        ),
    ] = None,
    draw: Annotated[bool, typer.Option("--draw/--no-draw", help="Draw figures.")] = True,
) -> None:
    """Run a problem for many values and seeds: write one table, print a summary, draw figures.

    The same command goes on with a sweep that was interrupted or killed.
    """
    with reported():
        from slipfree.codegen_cache import obstacle
        from slipfree.sweep.grid import sweep_of
        from slipfree.sweep.log import FAILED, LOST
        from slipfree.sweep.table import NAME, chosen, facts

        plan = sweep_of(file, vary or [], settings or [], repeat, seed)
        folder = out or Path(f"{plan.problem.source.path.stem}_sweep")
        if draw:
            _check_figures(folder / FIGURES)
        if plan.problem.spec.solver.compiled and (why := obstacle()):
            warn(f"equations that are not kept yet are interpreted, not compiled: {why}")
        rows = _done(plan, folder, _pool(processes, scheduler), keep, again)
        names = chosen(plan, rows, figures or [])
        tell(facts(plan, rows, names))
        put_file(folder / NAME)
        say(f"wrote {folder / NAME}")
        if keep:
            _tell_missing(plan, rows, folder)
        if draw:
            _draw(plan, rows, names, folder / FIGURES)
        if any(row.outcome in (FAILED, LOST) for row in rows):
            raise typer.Exit(STOPPED)


def _check_figures(folder: Path) -> None:
    """Refuse a place for figures that is none, before anything runs."""
    check_name(folder)
    if folder.exists() and not folder.is_dir():
        raise DataError(
            f"{folder}: expected a folder for figures, found a file; move it, or draw none: "
            "--no-draw"
        )


def _tell_missing(plan: Sweep, rows: Sequence[Row], folder: Path) -> None:
    """Warn of runs that were finished before their results were to be kept."""
    from slipfree.sweep.run import not_kept, result_path

    if missing := not_kept(folder, plan, rows):
        first = missing[0]
        sets = [word for each in (*plan.settings, *first.settings) for word in ("--set", each)]
        file = result_path(folder, plan, first.run)
        words = ["slipfree", "run", str(plan.problem.source.path), *sets, "-o", str(file)]
        warn(
            f"--keep: {len(missing)} runs were finished without it and have no result file; for "
            f"all of them sweep into another folder with -o, for one: {shlex.join(words)}"
        )


def _pool(count: int | None, scheduler: str | None) -> Pool:
    from slipfree.sweep.pools import cluster, processes

    if scheduler is None:
        return processes(count or _cores())
    if count is not None:
        raise DataError(
            "--scheduler: expected it without --processes, found both; a cluster has as many "
            "processes as workers"
        )
    return cluster(scheduler)


def _cores() -> int:
    """Return how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _done(plan: Sweep, folder: Path, pool: Pool, keep: bool, again: bool) -> Sequence[Row]:
    """Return the rows of all runs; show a bar meanwhile if somebody is looking."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    from slipfree.sweep.run import swept

    console = Console(stderr=True)
    with interruptible() as poll:
        if not (console.is_terminal and has_bar()):
            show = _detailed(plan.count)
            return swept(plan, folder, pool, keep=keep, again=again, poll=poll, progress=show)
        columns = "{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
        with Progress(*columns, console=console, transient=True) as bar:
            task = bar.add_task("runs", total=plan.count)
            show = _shown(lambda done, words: bar.update(task, completed=done, description=words))
            return swept(plan, folder, pool, keep=keep, again=again, poll=poll, progress=show)


def _detailed(count: int) -> Callable[[Sequence[Row]], None]:
    """Return what tells every run that is finished as a detail."""

    def told(rows: Sequence[Row]) -> None:
        if rows:
            last = rows[-1]
            detail(f"{len(rows)} of {count} runs, the last: {last.run}, {last.outcome}")

    return told


def _shown(update: Callable[[int, str], None]) -> Callable[[Sequence[Row]], None]:
    """Return what tells how many runs are done, and how many of them failed."""

    def show(rows: Sequence[Row]) -> None:
        wrong = sum(row.t is None for row in rows)
        update(len(rows), f"runs, {wrong} failed" if wrong else "runs")

    return show


def _draw(plan: Sweep, rows: Sequence[Row], names: Sequence[str], folder: Path) -> None:
    from slipfree.show.sweep_figures import save_sweep_figures
    from slipfree.sweep.table import drawn

    if len(plan.axes) > MOST_KEYS:
        say(f"no figures: {len(plan.axes)} keys are varied, and figures have at most two")
        return
    if plan.count > 1:
        paths = save_sweep_figures(drawn(plan, rows, names), folder)
        for path in paths:
            put_file(path)
        say(f"drew {len(paths)} files in {folder}")
