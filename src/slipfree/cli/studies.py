"""Studies: ``compare`` vehicles, ``pareto``, ``track`` a plan, ``sweep`` a problem."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slipfree.cli import console
from slipfree.cli.outputs import check_outputs, draw_figures, save
from slipfree.cli.outputs import draw as draw_plots
from slipfree.core.errors import ModelError
from slipfree.core.facts import TableColumn
from slipfree.system.interrupt import interrupt_requested
from slipfree.system.regular_files import regular_file

if TYPE_CHECKING:
    from slipfree.plan.pareto import FrontPoint
    from slipfree.show.plots import Swept

FRONT = "pareto.csv", "pareto.png"  # table and figure of a Pareto front
GO_ON = "repeat the command to continue"
MAX_KEYS = 2  # largest number of varied keys in figures
FIGURES = "figures"  # folder of the figures of a sweep


def compare(
    file: console.File, settings: console.Settings = None, trust: console.Trust = None
) -> None:
    """Compare the slip of several vehicles on one ground.

    Print whether each vehicle can roll without slip, and the slip that remains otherwise. A problem
    to begin with: slipfree new compare NAME.
    """
    from slipfree.problem.build_ground import ground_facts
    from slipfree.problem.verbs.compare import compare as solve

    problem = console.read_problem(file, settings, trust, "compare")
    with console.studying("vehicles") as watch:
        ground, rows = solve(problem, watch)
        is_interrupted = interrupt_requested()
    console.print_facts(ground_facts(ground))
    console.add_json("vehicles", lambda: rows)
    drives = {"same_rates": "same rates", "driving_law": "rates of the driving law"}
    for drive in (each for each in drives if each in rows[0]):
        names = {", ".join(row["wheels"]) for row in rows}
        wheels = names.pop() if len(names) == 1 else "of each vehicle in their order"
        console.print_line(f"\nat the {drives[drive]}: largest slip of the wheels {wheels} [mm/s]")
        shown = list[dict[str, Any]]()
        for row in rows:
            motion = row[drive]
            values = {name: each["max"] for name, each in motion.items() if name != "stop"}
            axle, stop = "{min:.3f} to {max:.3f}".format_map(motion["axle"]), motion["stop"]
            stopped = "stopped at {time:.3g} s by {name}".format_map(stop) if stop else ""
            rolls = "yes" if row["rank"] == row["conditions"] else "no"
            more = {"axle": axle, "stop": stopped, "name": row["name"], "rolls": rolls}
            shown.append({**values, **more})
        console.print_table(COMPARED, shown)
    console.print_line(
        "\n* whether the vehicle can roll without slip at suitable rates\n** largest friction "
        "coefficient that a wheel requires, with load-weighted contact forces"
    )
    kept = f"the table contains {len(rows)} of {len(problem.spec.vehicles)} vehicles"
    _exit(kept, is_interrupted=is_interrupted)


COMPARED = (
    TableColumn("", "name"),
    TableColumn("rolls*", "rolls"),
    TableColumn("along", "slip_along", ".2f", "mm/s", 1),
    TableColumn("across", "slip_across", ".2f", "mm/s", 1),
    TableColumn("friction**", "friction_needed", ".3f", "", 1),
    TableColumn("tilt [deg]", "tilt", ".2f", "deg"),
    TableColumn("axle [m]", "axle"),
    TableColumn("", "stop"),
)


def _exit(*kept: str, is_interrupted: bool, code: int = 0) -> None:
    """Exit with a code if a study is interrupted or incomplete, and name the kept files."""
    if is_interrupted:
        console.print_error("; ".join(["interrupted", *kept]))
        raise typer.Exit(console.INTERRUPTED)
    if code:
        raise typer.Exit(code)


def pareto(
    file: console.File,
    against: Annotated[str, typer.Option(metavar="NAME")] = "duration",
    points: Annotated[int, typer.Option(min=2, max=1000, metavar="N")] = 7,
    settings: console.Settings = None,
    out: Annotated[Path | None, console.output_option("DIR")] = None,
    processes: Annotated[
        int, typer.Option("-j", "--processes", min=1, max=console.MAX_PROCESSES, metavar="P")
    ] = 1,
    draw: console.Draw = True,
    trust: console.Trust = None,
) -> None:
    """Plan motions of least slip against duration, effort or energy.

    Print the Pareto front, and write its table, its figure and the plan of every point.

    Parameters
    ----------
    against : str
        Second objective: duration, effort, energy, or the square of any quantity.
    points : int
        Number of points of the front.
    out : path, optional
        Folder of table, plans and figure; default: the problem's name with _pareto.
    processes : int
        Number of processes.
    """
    from slipfree.files.netcdf import write
    from slipfree.files.tables import write_records
    from slipfree.problem import pareto as fronts
    from slipfree.problem.inputs import files_read

    problem = console.read_problem(file, settings, trust)
    folder = out or Path(f"{problem.source.path.stem}_pareto")
    files = {k: f"point_{k + 1:02}.nc" for k in range(points)} | {fronts.GIVEN: "plan.nc"}
    check_outputs([], files_read(problem), folder=folder, names=[*FRONT, *files.values()])

    def keep(number: int, point: FrontPoint) -> None:
        result, path = point.solution.result, folder / files[number]
        folder.mkdir(parents=True, exist_ok=True)
        save(path, lambda path: write(path, result.trajectory, result.arrays))
        console.detail(f"wrote {path}")

    begun = fronts.FrontFolder(folder, problem, against, points)
    with begun as parts, console.reporting(None) as reports:
        solve = partial(fronts.plan_front, processes=processes, report=reports.search, keep=keep)
        front = solve(problem, against, points, parts=parts)
        rows = fronts.front_rows(front)
        save(folder / FRONT[0], lambda path: write_records(path, rows))
        code = front.outcome.exit_code
        is_interrupted = interrupt_requested() or code == console.INTERRUPTED
        if not is_interrupted:
            parts.remove()
    console.print_facts(fronts.front_facts(front))
    console.print_line("\n".join(["", *fronts.table_lines(front)]))
    console.add_json("points", lambda: rows)
    if draw := draw and not is_interrupted:
        from slipfree.show.study_figures import front_plot

        drawn = front_plot(front.against, front.unit, front.points, front.given)
        draw_plots([drawn], folder)
    console.print_line(f"wrote table, plans{' and figure' if draw else ''} in {folder}")
    if code:
        unsolved = sum(not each.is_solved for each in front.points)
        verb, what = ("is", "the reason is") if unsolved == 1 else ("are", "the reasons are")
        console.print_error(
            f"{unsolved} of {len(front.points)} points {verb} not solved; {what} in the last "
            f"column of {folder / FRONT[0]}"
        )
    _exit(GO_ON, is_interrupted=is_interrupted, code=code)


def track(
    file: Annotated[Path, typer.Argument(metavar="PLAN.nc")],
    settings: console.Settings = None,
    by: Annotated[list[str] | None, typer.Option(metavar="WAY")] = None,
    disturb: Annotated[list[str] | None, typer.Option(metavar="NAME=SIZE")] = None,
    seeds: Annotated[int, typer.Option(metavar="COUNT", min=1)] = 1,
    period: Annotated[float | None, typer.Option(metavar="SECONDS")] = None,
    window: Annotated[float | None, typer.Option(metavar="SECONDS")] = None,
    out: Annotated[Path | None, console.output_option("OUT.nc")] = None,
    draw: console.Draw = True,
) -> None:
    """Follow a plan in a changed world, in several ways.

    Print the distance of the end from that of the plan, the slip, and the CPU time of a cycle: with
    the inputs of the plan, the driving law along its path, replanning, and sampling. The
    controllers know the ground and the vehicle of the plan. Changes of the world are given by
    --set, as in model=quasi-static, and drawn at random by --disturb; every way meets the same
    worlds.

    Parameters
    ----------
    file : path
        Result file of a plan.
    by : list of str, optional
        Way to follow the plan: inputs, follow, replan or sampling; may be repeated. Default:
        all.
    disturb : list of str, optional
        Random disturbance of the world: heights (rms) [m]; friction, radii, inputs, relative;
        latency [s]. May be repeated.
    seeds : int
        Number of worlds, seeds 1, 2, ...
    period : float, optional
        Time between decisions, rounded to a part of the plan's duration; default: a twentieth
        of the window.
    window : float, optional
        Horizon of replan and sampling; default: a fifth of the plan's duration.
    out : path, optional
        File for the last motion, by the last way with the last seed; the figure has the same
        name with .png. Default: neither.
    """
    check_outputs([out], endings=(".nc",))
    with console.about(file):
        from slipfree.files.netcdf import write
        from slipfree.problem.result import result_files
        from slipfree.problem.verbs import plan_tracking

        with regular_file(file, "a result file of slipfree"):
            picture = out.with_suffix(".png") if out is not None and draw else None
            check_outputs([out, picture], result_files(file))
        with console.studying("motions") as watch:
            test = plan_tracking.follow_plan(
                file,
                settings or [],
                by=tuple(dict.fromkeys(by or plan_tracking.WAYS)),
                disturb=_disturbances(disturb or []),
                seeds=seeds,
                period=period,
                window=window,
                time=lambda name, seed, t: console.detail(f"{name}, seed {seed}: {t:.4g} s"),
                beside=out or Path(file.name),
                watch=watch,
            )
            results = test.results
            if out is not None and results:
                last = results[-1][1]
                out = save(out, lambda path: write(path, last.trajectory, last.arrays))
            is_interrupted = interrupt_requested()
            if test.parts is not None and not is_interrupted:
                test.parts.remove()
        rows = plan_tracking.tracking_rows(test)
        console.print_line("\n".join(plan_tracking.tracking_lines(rows)))
        console.add_json("motions", lambda: rows)
        if picture is not None and results and not is_interrupted:
            from slipfree.problem.verbs.plan import PlanVerb
            from slipfree.show.plan_figures import tracking_plot

            named = [(name, result.trajectory) for name, result in results]
            problem, setup = results[-1][1].problem, results[-1][1].setup
            marks = PlanVerb().marks(problem, setup.terrain.domain)
            plot = tracking_plot(picture.stem, test.plan, named, setup.ground.grid, marks)
            draw_plots([plot], picture.parent)
        for words in console.written():
            console.print_line(words)
        code = max((result.outcome.exit_code for _, result in results), default=0)
        _exit(*console.written(), GO_ON, is_interrupted=is_interrupted, code=code)


def _disturbances(words: Sequence[str]) -> dict[str, float]:
    """Return the sizes of disturbances by name, from words such as ``heights=0.02``."""
    sizes = dict[str, float]()
    for each in words:
        name, _, size = each.partition("=")
        try:
            sizes[name] = float(size)
        except ValueError:
            sizes[name] = float("nan")
        if not 0 <= sizes[name] < float("inf"):
            raise ModelError(
                f"--disturb: expected NAME=SIZE with a size of at least 0, as in heights=0.02, "
                f"found {each!r}; correct it"
            )
    return sizes


def sweep(
    file: console.File,
    vary: Annotated[list[str] | None, typer.Option(metavar="KEY=VALUES")] = None,
    repeat: Annotated[int | None, typer.Option(min=1, max=100000, metavar="N")] = None,
    seed: Annotated[int, typer.Option(metavar="SEED", min=0)] = 1,
    settings: console.Settings = None,
    out: Annotated[Path | None, console.output_option("DIR")] = None,
    processes: console.Processes = None,
    scheduler: console.Scheduler = None,
    keep: Annotated[bool, typer.Option("--keep")] = False,
    again: Annotated[bool, typer.Option("--again")] = False,
    figures: Annotated[list[str] | None, typer.Option("--figure", metavar="NAME")] = None,
    draw: console.Draw = True,
    dry_run: Annotated[bool, typer.Option("--dry-run")] = False,
    trust: console.Trust = None,
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
    from slipfree import sweep as study
    from slipfree.problem.inputs import files_read
    from slipfree.show.study_figures import sweep_plots
    from slipfree.system.codegen_cache import obstacle
    from slipfree.system.parts import LOG
    from slipfree.system.processes import available_cores

    with console.counted("checking values") as checked:
        plan = study.sweep_of(file, vary or [], settings or [], repeat, seed, checked, trust or [])
    folder = out or Path(f"{plan.problem.source.path.stem}_sweep")
    if dry_run:
        facts, left, needed = study.plan_facts(plan), plan.count, "not known before the first run"
        if (folder / LOG).is_file():
            with study.Rows(folder, plan.count, plan.head) as rows:
                left -= len(rows)
                facts.append(("finished", f"{len(rows)} in {folder}"))
                if len(rows):
                    each = sum(row.seconds for row in rows) / len(rows)
                    at_once = processes or available_cores()
                    about_all = console.duration(left * each / at_once)
                    count = "1 process" if at_once == 1 else f"{at_once} processes"
                    needed = f"about {about_all}: {each:.3g} s per run on {count}"
        console.print_facts([*facts, ("time", needed if left else "all runs are finished")])
        return
    reads = [*plan.files.stamps, *files_read(plan.problem)]
    check_outputs([], reads, folder=folder, names=("table.csv", "run_*.nc", LOG))
    if draw:
        check_outputs([], reads, folder=folder / FIGURES, names=("*",))
    if plan.problem.spec.solver.compiled and (why := obstacle()):
        console.warn(
            f"solver.compiled is true, but functions cannot be compiled: {why}; until then, "
            "equations that are not in the cache are interpreted, which is slower"
        )
    workers = console.workers_of(processes, scheduler)

    def words() -> str:
        wrong = rows.outcomes[study.FAILED] + rows.outcomes[study.LOST]
        last = f": {rows.last.run}, {rows.last.outcome}" if rows.last else ""
        return ("runs" + f", {wrong} failed" * bool(wrong)) + last

    rows = study.Rows(folder, plan.count, plan.head, again=again, check=plan.files.check)
    with rows, console.studying("runs", rows, words) as watch:
        study.run_sweep(plan, rows, workers, keep=keep, watch=watch)
    names = study.choose_figures(plan, rows, figures or [])
    tables = study.grids(plan, rows, names)
    console.print_facts(study.sweep_facts(plan, rows, tables))
    if names:
        _print_metrics([tables[name] for name in names])
    console.print_written(folder / study.TABLE)
    # finished runs without a result file, such as those run without --keep
    moved = rows.ended(*(set(rows.outcomes) - {study.FAILED, study.LOST})) if keep else []
    if missing := [run for run in moved if not rows.file(run).exists()]:
        console.warn(
            f"--keep: finished runs without a result file: {len(missing)}; sweep into another "
            "folder with -o to write all"
        )
    if draw:
        if len(plan.axes) > MAX_KEYS:
            console.print_line(
                f"no figures: {len(plan.axes)} keys are varied, and figures show at most {MAX_KEYS}"
            )
        elif plan.count > 1:
            draw_figures(sweep_plots(study.drawn_grids(rows, tables, names)), folder / FIGURES)
    if rows.ended(study.FAILED, study.LOST):
        raise typer.Exit(console.STOPPED)


def _print_metrics(tables: Sequence[Swept]) -> None:
    """Print a table for each varied key of a sweep, with metrics at its first values."""
    from slipfree.show.plots import Varied
    from slipfree.show.study_figures import labelled, risk
    from slipfree.sweep import MAX_VALUES, TABLE, sweep_rows

    rows = sweep_rows(tables)
    console.add_json("metrics", lambda: rows)
    columns = [TableColumn(labelled(e.name, e.unit), e.name, "", "", risk(e.name)) for e in tables]
    for axis in tables[0].axes or (Varied("", ()),):
        shown = [row for row in rows if row["key"] in (axis.name, "")]
        if (more := len(shown) - 1 - MAX_VALUES) > 0:
            shown[MAX_VALUES:-1] = [{"value": f"{more} more, see {TABLE}"}]
        console.print_line()
        console.print_table([TableColumn(labelled(axis.name, axis.unit), "value"), *columns], shown)
