"""``slipfree track``: follow a plan in a changed world."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slipfree.cli.common import (
    InputFolder,
    Settings,
    about,
    check_apart,
    check_output,
    print_facts,
    reported,
)
from slipfree.cli.messages import add_json_file, detail, print_line
from slipfree.regular_files import regular_file


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
        from slipfree.problem.verbs.plan_tracking import follow_plan, tracking_rows

        with regular_file(file, "a result file of slipfree"):
            if out is not None:
                check_output(out)
                check_apart(out, [file])
        test = follow_plan(
            file,
            settings or [],
            period=period,
            window=window,
            folder=folder,
            progress=lambda t: detail(f"replanned at {t:.4g} s"),
        )
        print_facts(list(tracking_rows(test)))
        run = test.motions[-1].run
        if out is not None and run is not None:
            write(out, run)
            add_json_file(out)
            print_line(f"wrote {out}")
        if run is not None and run.outcome.exit_code:
            raise typer.Exit(run.outcome.exit_code)
