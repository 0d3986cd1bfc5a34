"""Experiments: ``slipfree fit`` calibrates on a log, ``slipfree wheel`` tests a wheel on soil."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from slipfree.cli.common import (
    STOPPED,
    File,
    Settings,
    Trust,
    about,
    print_facts,
    read_problem,
    reported,
)
from slipfree.cli.messages import INTERRUPTED, add_json, add_json_file, print_error, print_line
from slipfree.cli.new import write_new_file
from slipfree.cli.outputs import check_outputs, default_table, save
from slipfree.system.interrupt import held_interrupt, interrupt_requested


def fit(
    file: File,
    settings: Settings = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="OUT.csv",
            help="Table of the estimates; the table of the windows and the figure have the same "
            "name with _windows.csv and .png. Default: the name of the file, in the current "
            "folder; with _fit if that is an input.",
        ),
    ] = None,
    write: Annotated[
        Path | None,
        typer.Option("--write", metavar="VEHICLE.toml", help="Write the fitted vehicle."),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace an existing vehicle file.")
    ] = False,
    draw: Annotated[bool, typer.Option("--draw/--no-draw", help="Draw the figure.")] = True,
    trust: Trust = None,
) -> None:
    """Fit numbers of a vehicle and of a law to a log of wheel rates and poses.

    Print the estimates with 95 % intervals, the combinations of unknowns that the log does not
    determine, and the errors of predictions over windows that were not used for the fit. If the log
    does not determine an unknown, the exit code is 1 and no vehicle is written.
    """
    with reported(), about(file):
        from slipfree.files.tables import write_rows
        from slipfree.files.vehicle_draft import vehicle_text
        from slipfree.problem.inputs import files_read
        from slipfree.problem.verbs.fit import (
            error_rows,
            estimate_rows,
            facts,
            vehicle_comments,
            window_rows,
        )
        from slipfree.problem.verbs.fit import fit as solve

        problem: Any = read_problem(file, settings, trust, "fit")
        inputs = files_read(problem)
        table = out or default_table(file, "fit", inputs)
        others = table.with_name(f"{table.stem}_windows.csv")
        picture = table.with_suffix(".png") if draw else None
        check_outputs([table, others, picture, write], inputs)
        with held_interrupt():
            fitted = solve(problem)
            rows, lost = estimate_rows(fitted), fitted.calibration.estimate.undetermined
            written = [
                save(table, lambda path: write_rows(path, *rows)),
                save(others, lambda path: write_rows(path, *window_rows(fitted))),
            ]
            if write is not None and not lost:
                write_new_file(vehicle_text(fitted.vehicle, vehicle_comments(fitted)), write, force)
                written.append(write)
            is_interrupted = interrupt_requested() or fitted.calibration.estimate.is_interrupted
        print_facts(facts(fitted))
        add_json("errors", lambda: error_rows(fitted))
        add_json("estimates", lambda: [dict(zip(rows[0], row, strict=True)) for row in rows[1]])
        if picture is not None and not is_interrupted:
            from slipfree.show.fit_figures import fit_plot
            from slipfree.show.plots import save as save_plots

            plots = [fit_plot(picture.stem, fitted.calibration)]
            for path in save_plots(plots, picture.parent):
                add_json_file(path)
                written.append(path)
        print_line(f"wrote {' and '.join(map(str, written))}")
        if is_interrupted:
            print_error(f"interrupted; {written[0]} contains the estimates so far")
            raise typer.Exit(INTERRUPTED)
        if lost:
            print_error(
                f"{file}: expected a log that determines all unknowns, found no information on "
                f"{', '.join(lost)}{'; no vehicle was written' if write else ''}; give priors, fit "
                "fewer unknowns, or use a log with other manoeuvres"
            )
            raise typer.Exit(STOPPED)


def wheel(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Wheel file (TOML): wheel, load, soil and test.")
    ],
    settings: Settings = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="OUT.csv",
            help="Table of the curves; the figure has the same name with .png. "
            "Default: the name of the file, in the current folder; with _wheel if that is an "
            "input.",
        ),
    ] = None,
    draw: Annotated[bool, typer.Option("--draw/--no-draw", help="Draw the figure.")] = True,
) -> None:
    """Compute the forces on a single wheel in soil over slip ratio and slip angle.

    Print a summary, and write drawbar pull, side force, torque and sinkage as a table and a figure.
    Measured points of a CSV file are drawn over the curves, and compared with them.
    """
    with reported(), about(file):
        from slipfree.files.tables import write_rows
        from slipfree.problem.wheel_test import QUANTITIES, run_wheel_file, wheel_facts, wheel_rows

        test = run_wheel_file(file, settings or [])
        table = out or default_table(file, "wheel", test.files)
        picture = table.with_suffix(".png") if draw else None
        check_outputs([table, picture], test.files)
        names, rows = wheel_rows(test.curves)
        written = [save(table, lambda path: write_rows(path, names, rows))]
        print_facts(wheel_facts(test))
        if picture is not None:
            from slipfree.show.plots import save as save_plots
            from slipfree.show.sweep_figures import DrawnWheel, wheel_plot

            values = {name: getattr(test.curves, name) for name in QUANTITIES}
            drawn = DrawnWheel(*test.curves[:2], test.load, values, test.measured)
            for path in save_plots([wheel_plot(picture.stem, drawn)], picture.parent):
                add_json_file(path)
                written.append(path)
        print_line(f"wrote {' and '.join(map(str, written))}")
