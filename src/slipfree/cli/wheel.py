"""``slipfree wheel``: single-wheel test on soil."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slipfree.cli.common import Settings, about, print_facts, reported
from slipfree.cli.messages import add_json_file, print_line
from slipfree.cli.outputs import check_outputs, default_table, save


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
