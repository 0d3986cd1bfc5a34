"""``slipfree sweep``: many runs of one problem, their table and figures."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slipfree.cli.common import (
    STOPPED,
    Draw,
    File,
    Processes,
    Scheduler,
    Settings,
    Trust,
    add_json_file,
    counted,
    duration,
    output_option,
    print_facts,
    print_line,
    studying,
    warn,
    workers_of,
)
from slipfree.cli.outputs import check_outputs

if TYPE_CHECKING:
    from slipfree.sweep.grid import Sweep
    from slipfree.sweep.runs import Rows

MAX_KEYS = 2  # largest number of varied keys in figures
FIGURES = "figures"


def sweep(
    file: File,
    vary: Annotated[list[str] | None, typer.Option(metavar="KEY=VALUES")] = None,
    repeat: Annotated[int | None, typer.Option(min=1, max=100000, metavar="N")] = None,
    seed: Annotated[int, typer.Option(metavar="SEED", min=0)] = 1,
    settings: Settings = None,
    out: Annotated[Path | None, output_option("DIR")] = None,
    processes: Processes = None,
    scheduler: Scheduler = None,
    keep: Annotated[bool, typer.Option("--keep")] = False,
    again: Annotated[bool, typer.Option("--again")] = False,
    figures: Annotated[list[str] | None, typer.Option("--figure", metavar="NAME")] = None,
    draw: Draw = True,
    dry_run: Annotated[bool, typer.Option("--dry-run")] = False,
    trust: Trust = None,
) -> None:
    """Run a problem for many values and seeds.

    Write one table, print a summary and draw figures. Repeat the command to continue a sweep that
    was interrupted or killed.

    Parameters
    ----------
    vary : list of str, optional
        Vary a key: KEY=a:b:n for n numbers from a to b, or KEY=v1,v2,...; repeatable, all
        combinations are run.
    repeat : int, optional
        Run each combination N times with different seeds.
    seed : int
        First seed of --repeat.
    out : path, optional
        Folder of the results; default: the problem's name with _sweep. Runs of this sweep that
        it already contains are not repeated.
    keep : bool
        Write the result of every run: DIR/run_0001.nc.
    again : bool
        Repeat runs that failed.
    figures : list of str, optional
        Metric of the runs to print and draw; repeatable.
    dry_run : bool
        Print the runs and the estimated time, without running them.
    """
    from slipfree.problem.inputs import files_read
    from slipfree.show.sweep_figures import save_sweep_figures
    from slipfree.sweep.grid import sweep_of
    from slipfree.sweep.runs import (
        FAILED,
        LOST,
        TABLE,
        Rows,
        choose_figures,
        drawn_grids,
        grids,
        run_sweep,
        sweep_facts,
    )
    from slipfree.system.codegen_cache import obstacle
    from slipfree.system.parts import LOG
    from slipfree.system.processes import available_cores

    with counted("checking values") as checked:
        plan = sweep_of(file, vary or [], settings or [], repeat, seed, checked, trust or [])
    folder = out or Path(f"{plan.problem.source.path.stem}_sweep")
    if dry_run:
        _print_plan(plan, folder, processes or available_cores())
        return
    reads = [*plan.files.stamps, *files_read(plan.problem)]
    check_outputs([], reads, folder=folder, names=("table.csv", "run_*.nc", LOG))
    if draw:
        check_outputs([], reads, folder=folder / FIGURES, names=("*",))
    if plan.problem.spec.solver.compiled and (why := obstacle()):
        warn(
            f"solver.compiled is true, but functions cannot be compiled: {why}; until then, "
            "equations that are not in the cache are interpreted, which is slower"
        )
    workers = workers_of(processes, scheduler)

    def words() -> str:
        wrong = rows.outcomes[FAILED] + rows.outcomes[LOST]
        last = f": {rows.last.run}, {rows.last.outcome}" if rows.last else ""
        return ("runs" + f", {wrong} failed" * bool(wrong)) + last

    rows = Rows(folder, plan.count, plan.head, again=again, check=plan.files.check)
    with rows, studying("runs", rows, words) as watch:
        run_sweep(plan, rows, workers, keep=keep, watch=watch)
    names = choose_figures(plan, rows, figures or [])
    tables = grids(plan, rows, names)
    print_facts(sweep_facts(plan, rows, tables, names))
    add_json_file(folder / TABLE)
    print_line(f"wrote {folder / TABLE}")
    if keep:
        _warn_missing(plan, rows)
    if draw:
        if len(plan.axes) > MAX_KEYS:
            print_line(
                f"no figures: {len(plan.axes)} keys are varied, and figures show at most {MAX_KEYS}"
            )
        elif plan.count > 1:
            paths = save_sweep_figures(drawn_grids(rows, tables, names), folder / FIGURES)
            for path in paths:
                add_json_file(path)
            print_line(f"drew {len(paths)} files in {folder / FIGURES}")
    if rows.ended(FAILED, LOST):
        raise typer.Exit(STOPPED)


def _print_plan(plan: Sweep, folder: Path, processes: int) -> None:
    """Print the size of a sweep and the time that its remaining runs will take."""
    from slipfree.sweep.runs import Rows, plan_facts
    from slipfree.system.parts import LOG

    facts = plan_facts(plan)
    left, words = plan.count, "not known before the first run"
    if (folder / LOG).is_file():
        with Rows(folder, plan.count, plan.head) as rows:
            left -= len(rows)
            facts.append(("finished", f"{len(rows)} in {folder}"))
            if len(rows):
                each = sum(row.seconds for row in rows) / len(rows)
                about_all = duration(left * each / processes)
                count = "1 process" if processes == 1 else f"{processes} processes"
                words = f"about {about_all}: {each:.3g} s per run on {count}"
    print_facts([*facts, ("time", words if left else "all runs are finished")])


def _warn_missing(plan: Sweep, rows: Rows) -> None:
    """Warn about finished runs without a result file, such as those run without ``--keep``."""
    from slipfree.sweep.runs import missing_results

    if missing := missing_results(rows):
        (first,) = rows.read(missing[:1])
        sets = [word for each in (*plan.settings, *first.settings) for word in ("--set", each)]
        sets += [word for each in plan.problem.trusted for word in ("--trust", each)]
        file = str(rows.result_path(first.run))
        words = ["slipfree", "run", str(plan.problem.source.path), *sets, "-o", file]
        runs, have = ("run", "has") if len(missing) == 1 else ("runs", "have")
        warn(
            f"--keep: {len(missing)} finished {runs} {have} no result file; to write all, sweep "
            f"into another folder with -o; to write the first: {shlex.join(words)}"
        )
