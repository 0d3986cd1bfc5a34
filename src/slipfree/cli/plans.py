"""Several plans: ``slipfree pareto`` computes a front, ``slipfree track`` follows a plan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slipfree.cli.common import (
    MAX_PROCESSES,
    File,
    InputFolder,
    Settings,
    Trust,
    about,
    print_facts,
    read_problem,
    reported,
)
from slipfree.cli.messages import (
    INTERRUPTED,
    add_json,
    add_json_file,
    detail,
    print_error,
    print_line,
    reporting,
    written,
)
from slipfree.cli.outputs import check_outputs, save
from slipfree.system.interrupt import held_interrupt, interrupt_requested
from slipfree.system.regular_files import regular_file

if TYPE_CHECKING:
    from slipfree.plan.pareto import FrontPoint

TABLE, FIGURE = "pareto.csv", "pareto.png"


def pareto(
    file: File,
    against: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Second objective: duration, effort, energy, or the square of any quantity.",
        ),
    ] = "duration",
    points: Annotated[
        int, typer.Option(min=2, max=1000, metavar="N", help="Number of points of the front.")
    ] = 7,
    settings: Settings = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="DIR",
            help="Folder of table, plans and figure; default: the problem's name with _pareto.",
        ),
    ] = None,
    processes: Annotated[
        int,
        typer.Option(
            "-j", "--processes", min=1, max=MAX_PROCESSES, metavar="P", help="Number of processes."
        ),
    ] = 1,
    draw: Annotated[bool, typer.Option("--draw/--no-draw", help="Draw the figure.")] = True,
    trust: Trust = None,
) -> None:
    """Plan motions of least slip for several durations, efforts or energies.

    Print the Pareto front, and write its table, its figure and the plan of every point.
    """
    with reported():
        from slipfree.files.netcdf import write
        from slipfree.files.tables import write_rows
        from slipfree.problem.inputs import files_read
        from slipfree.problem.pareto import (
            front_facts,
            front_plot,
            front_rows,
            plan_front,
            table_lines,
        )

        problem = read_problem(file, settings, trust)
        folder = out or Path(f"{problem.source.path.stem}_pareto")
        outputs = [TABLE, FIGURE, *(_plan_name(k) for k in range(points))]
        check_outputs([], files_read(problem), folder=folder, names=outputs)

        def keep(number: int, point: FrontPoint) -> None:
            result, path = point.solution.result, folder / _plan_name(number)
            folder.mkdir(parents=True, exist_ok=True)
            save(path, lambda path: write(path, result.trajectory, result.arrays))
            detail(f"wrote {path}")

        with reporting(None) as reports:
            front = plan_front(
                problem,
                against,
                points,
                processes=processes,
                report=reports.search,
                keep=keep,
            )
            names, rows = front_rows(front)
            save(folder / TABLE, lambda path: write_rows(path, names, rows))
            is_interrupted = interrupt_requested()
        print_facts(front_facts(front))
        print_line("\n".join(["", *table_lines(front)]))
        add_json("points", lambda: [dict(zip(names, row, strict=True)) for row in rows])
        draw = draw and not is_interrupted
        if draw:
            from slipfree.show.plots import save as save_plots

            for path in save_plots([front_plot(front)], folder):
                add_json_file(path)
        print_line(f"wrote table, plans{' and figure' if draw else ''} in {folder}")
        if front.outcome.exit_code:
            unsolved = sum(not each.is_solved for each in front.points)
            verb, what = ("is", "the reason is") if unsolved == 1 else ("are", "the reasons are")
            print_error(
                f"{unsolved} of {len(front.points)} points {verb} not solved; {what} in the last "
                f"column of {folder / TABLE}"
            )
            raise typer.Exit(INTERRUPTED if is_interrupted else front.outcome.exit_code)


def _plan_name(number: int) -> str:
    return f"point_{number + 1:02}.nc"


def track(
    file: Annotated[Path, typer.Argument(metavar="PLAN.nc", help="Result file of a plan.")],
    settings: Settings = None,
    period: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Time between updates of the plan; default: a twentieth of the window.",
        ),
    ] = None,
    window: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="Duration of the replanned window; default: a fifth of the plan's duration.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="OUT.nc", help="File for the replanned motion; default: none."
        ),
    ] = None,
    folder: InputFolder = None,
) -> None:
    """Follow a plan in a changed world, by replanning.

    Print the final error and the slip, and compare them with those of two other controllers: the
    plan's inputs without feedback, and the driving law. The inputs are simulated with three models:
    that of the plan, quasi-statics and dynamics. Changes of the world are given by --set, as
    in terrain.error.rms=0.02.
    """
    with reported(), about(file):
        from slipfree.files.netcdf import write
        from slipfree.problem.result import result_files
        from slipfree.problem.verbs.plan_tracking import (
            follow_plan,
            tracking_lines,
            tracking_rows,
        )

        with regular_file(file, "a result file of slipfree"):
            check_outputs([out], result_files(file, folder))
        with held_interrupt():
            test = follow_plan(
                file,
                settings or [],
                period=period,
                window=window,
                folder=folder,
                progress=lambda t: detail(f"replanned at {t:.4g} s"),
            )
            run = test.motions[-1].run
            if out is not None and run is not None:
                out = save(out, lambda path: write(path, run))
            is_interrupted = interrupt_requested()
        rows = tracking_rows(test)
        print_facts(list(tracking_lines(rows)))
        add_json("motions", lambda: rows)
        if out is not None and run is not None:
            print_line(f"wrote {out}")
        if is_interrupted:
            print_error("; ".join(["interrupted", *written()]))
            raise typer.Exit(INTERRUPTED)
        if run is not None and run.outcome.exit_code:
            raise typer.Exit(run.outcome.exit_code)
