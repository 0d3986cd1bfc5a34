"""``slipfree wheel``: single-wheel test on soil."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slipfree.cli.common import Settings, about, check_output, print_facts, reported
from slipfree.cli.messages import add_json_file, print_line


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
            "Default: the name of the file, in the current folder.",
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

        table = out or Path(f"{file.stem}.csv")
        picture = table.with_suffix(".png")
        check_output(table)
        check_output(picture)
        test = run_wheel_file(file, settings or [])
        names, rows = wheel_rows(test.curves)
        write_rows(table, names, rows)
        written = [table]
        print_facts(wheel_facts(test))
        if draw:
            from slipfree.show.plots import save
            from slipfree.show.wheel_figures import DrawnWheel, wheel_plot

            values = {name: getattr(test.curves, name) for name in QUANTITIES}
            drawn = DrawnWheel(*test.curves[:2], test.load, values, test.measured)
            written += save([wheel_plot(picture.stem, drawn)], picture.parent)
        for path in written:
            add_json_file(path)
        print_line(f"wrote {' and '.join(map(str, written))}")
