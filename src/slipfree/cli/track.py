"""``slipfree track``: follow a plan in a changed world."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slipfree.cli.common import (
    InputFolder,
    Settings,
    about,
    print_facts,
    reported,
)
from slipfree.cli.messages import INTERRUPTED, add_json, detail, print_error, print_line, written
from slipfree.cli.outputs import check_outputs, save
from slipfree.system.interrupt import held_interrupt, interrupt_requested
from slipfree.system.regular_files import regular_file


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
