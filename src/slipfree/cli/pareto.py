"""``slipfree pareto``: front of slip against duration, effort or energy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slipfree.cli.common import (
    MAX_PROCESSES,
    File,
    Settings,
    Trust,
    check_output,
    check_writable,
    print_facts,
    read_problem,
    reported,
)
from slipfree.cli.messages import add_json, add_json_file, detail, print_error, print_line
from slipfree.cli.progress import reporting
from slipfree.errors import DataError
from slipfree.regular_files import check_name

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
        from slipfree.problem.pareto import plan_front
        from slipfree.problem.pareto_table import front_facts, front_plot, front_rows, table_lines

        problem = read_problem(file, settings, trust)
        folder = out or Path(f"{problem.source.path.stem}_pareto")
        _check_folder(folder, points)

        def keep(number: int, point: FrontPoint) -> None:
            result, path = point.solution.result, folder / _plan_name(number)
            folder.mkdir(parents=True, exist_ok=True)
            write(path, result.trajectory, result.arrays)
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
        write_rows(folder / TABLE, names, rows)
        print_facts(front_facts(front))
        print_line("\n".join(["", *table_lines(front)]))
        add_json("points", lambda: [dict(zip(names, row, strict=True)) for row in rows])
        written = [folder / TABLE]
        written += [folder / _plan_name(k) for k, each in enumerate(front.points) if each.is_solved]
        if draw:
            from slipfree.show.plots import save

            written += save([front_plot(front)], folder)
        for path in written:
            add_json_file(path)
        print_line(f"wrote table, plans{' and figure' if draw else ''} in {folder}")
        if front.outcome.exit_code:
            unsolved = sum(not each.is_solved for each in front.points)
            verb, what = ("is", "the reason is") if unsolved == 1 else ("are", "the reasons are")
            print_error(
                f"{unsolved} of {len(front.points)} points {verb} not solved; {what} in the last "
                f"column of {folder / TABLE}"
            )
            raise typer.Exit(front.outcome.exit_code)


def _plan_name(number: int) -> str:
    return f"point_{number + 1:02}.nc"


def _check_folder(folder: Path, count: int) -> None:
    """Raise DataError if the results cannot be written to a folder, before any computation."""
    check_name(folder)
    if folder.is_dir():
        for name in (TABLE, FIGURE, *(_plan_name(k) for k in range(count))):
            check_output(folder / name)
    elif folder.exists():
        raise DataError(
            f"{folder}: expected a folder for the results, found a file; choose another folder "
            "with -o"
        )
    else:
        above = next(each for each in folder.absolute().parents if each.exists())
        check_writable(folder, above)
